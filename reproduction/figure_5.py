"""Reproduces figure 5 of the paper: four instants of falling bodies, and their force fields (section 5.1,
scene 1).

Above, the bodies and what a probe feels that has entered them: the force at points a little below their
surfaces, as arrows from the surface. Below, |F| on a vertical slice of the same instant.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from reproduction.body_surfaces import polygons
from reproduction.experiment import Experiment, Finding, Inputs, require_drawing
from reproduction.progress import Steps
from reproduction.section_5_1 import PaperScene, scene_1
from touchfield.medium import Grid
from touchfield.sources.shapes.analytic_scene import AnalyticScene

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from touchfield.sources.laws import ForceProfile
    from touchfield.sources.scene import Body

    Float64s = NDArray[np.float64]

__all__ = ["EXPERIMENT", "draw_scene"]

INSTANTS: Final = (0.0, 0.15, 0.3, 1.0)
"""Shares of the two seconds: before the fall, in it, among bounces, at rest."""

DEPTH_MM: Final = 2.0
"""Of the hand: how deep below the surface the force of an arrow is taken."""

_COLOURS = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377", "#bbbbbb")  # Tol, bright
_LIGHT = np.array([-0.4, -0.7, 0.6]) / np.linalg.norm([-0.4, -0.7, 0.6])
_VIEW_DEG = (18.0, -68.0)  # elevation, azimuth
_TOWARDS = np.array(
    [
        math.cos(math.radians(_VIEW_DEG[0])) * math.cos(math.radians(_VIEW_DEG[1])),
        math.cos(math.radians(_VIEW_DEG[0])) * math.sin(math.radians(_VIEW_DEG[1])),
        math.sin(math.radians(_VIEW_DEG[0])),
    ]
)
_SIDE = 220  # samples along the longer side of a slice
_ARROW_M_PER_N = 0.03


def run(inputs: Inputs) -> Finding:
    """Draw scene 1 with four and with seven bodies."""
    require_drawing("figure 5")
    steps = Steps(inputs.report, 2)
    pictures, parts, data = [], [], {}
    for count in (4, 7):
        with steps.step() as report:
            scene = scene_1(count)
            path = inputs.folder / f"fig5_{count}.png"
            frames = [round(share * (scene.scene.frame_count - 1)) for share in INSTANTS]
            draw_scene(path, scene, frames, report)
        names = ", ".join(body.name for body in scene.scene.bodies())
        parts.append(f"![{scene.title}, four instants]({path.name})\n\n{scene.title}: {names}.\n")
        data[scene.name] = {"frames": frames, "bodies": [body.name for body in scene.scene.bodies()]}
        pictures.append(path)
    parts.append(
        "The text has four objects and the figure seven; both are here. Arrows show the force "
        f"{DEPTH_MM:g} mm of the hand below the surface, F = min(500 N/m x depth, 3.3 N) along the normal. "
        "Below "
        "them |F| on the vertical slice with the most forces. The ground is not felt.\n"
    )
    return Finding("\n".join(parts), data, tuple(pictures))


def draw_scene(
    path: Path, scene: PaperScene, frames: list[int], report: Any = lambda done, total: None
) -> None:
    """Write the picture of some frames, PNG.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    from touchfield.viewer.page import titled_figure, write_png

    figure = titled_figure(
        "the picture of scene 1", f"{scene.title}: bodies, forces, and |F| on a slice", 15.0, 5.6
    )
    low, high = scene.scene.bounds_m()
    grid = figure.add_gridspec(2, len(frames), height_ratios=(1.35, 1.0))
    for column, frame in enumerate(frames):
        panel = figure.add_subplot(grid[0, column], projection="3d", computed_zorder=False)
        _draw_bodies(panel, scene, frame)
        _frame_3d(panel, low, high, f"t = {frame / scene.scene.rate_hz:.2f} s")
        below = figure.add_subplot(grid[1, column])
        image = _draw_slice(below, scene, frame)
        report(column + 1, len(frames))
    bar = figure.colorbar(image, ax=figure.axes, shrink=0.6, aspect=35, pad=0.01)
    bar.set_label("|F| / N")
    write_png(figure, path)


def _draw_bodies(panel: Any, scene: PaperScene, frame: int) -> None:
    """The bodies and their arrows, the farthest first."""
    from mpl_toolkits.mplot3d.art3d import Poly3DCollection

    bodies = scene.scene.bodies()
    towards = [float(body.track.positions_m[frame] @ _TOWARDS) for body in bodies]
    for order, number in enumerate(np.argsort(towards).tolist()):
        faces = polygons(bodies[number].scene)
        if faces is None:
            continue
        moved = bodies[number].track.to_scene(faces, frame)
        normals = _normals(moved)
        shade = 0.55 + 0.45 * np.clip(normals @ _LIGHT, -0.3, 1)[:, None]
        colour = np.clip(shade * _rgb(_COLOURS[number % len(_COLOURS)]), 0, 1)
        drawn = Poly3DCollection(
            moved, facecolors=colour, edgecolors=colour, linewidths=0.2, zorder=2 * order + 1
        )
        panel.add_collection3d(drawn)
        points, outward = _spread(moved, normals)
        below = points - outward * DEPTH_MM / 1e3 / scene.placement.scale
        felt = _felt(bodies[number], frame, below, scene.profile) * _ARROW_M_PER_N
        arrows = panel.quiver(
            *points.T, *felt.T, color="0.1", linewidth=0.6, arrow_length_ratio=0.3, zorder=2 * order + 2
        )
        for one in (drawn, arrows):
            one.set_clip_on(False)  # of the panel, which a wide scene leaves


def _spread(faces: Float64s, normals: Float64s) -> tuple[Float64s, Float64s]:
    """About forty points of the surface that a viewer sees, and the normals there."""
    seen = np.flatnonzero(normals @ _TOWARDS > 0.1)
    if faces.shape[1] == 4 or len(faces) < 20:  # few large faces: points within each
        weights = np.array([(a, b) for a in (0.2, 0.5, 0.8) for b in (0.2, 0.5, 0.8)])
        a, b, last = faces[seen, 0], faces[seen, 1], faces[seen, -1]
        points = a[:, None] + weights[:, :1] * (b - a)[:, None] + weights[:, 1:] * (last - a)[:, None]
        if faces.shape[1] == 3:
            inside = weights.sum(axis=1) <= 1
            points = points[:, inside]
        return points.reshape(-1, 3), np.repeat(normals[seen], points.shape[1], axis=0)
    some = seen[:: max(1, len(seen) // 40)]
    return faces[some].mean(axis=1), normals[some]


def _felt(body: Body, frame: int, points_m: Float64s, profile: ForceProfile) -> Float64s:
    """What the body alone does at points of the scene, newtons, float64 [n, 3]."""
    own = body.track.to_body(points_m, frame)
    if isinstance(body.scene, AnalyticScene):
        forces = body.scene.forces_n(own, profile)
    else:  # a lattice of one sample for each point
        forces = np.zeros((len(own), 3))
        for force, (x, y, z) in zip(forces, own.tolist()):
            part = body.scene.field(0, Grid((1, 1, 1), (1e-6, 1e-6, 1e-6), (x, y, z)), profile)
            force += part.forces_n[0, 0, 0, 0] if len(part.bricks) else 0
    return np.asarray(forces @ body.track.rotation(frame).T)


def _frame_3d(panel: Any, low: Float64s, high: Float64s, title: str) -> None:
    panel.set_title(title, fontsize=10, y=0.98)
    panel.set_xlim(low[0], high[0])
    panel.set_ylim(low[1], high[1])
    panel.set_zlim(0, high[2])
    panel.set_box_aspect((high - np.array([low[0], low[1], 0.0])), zoom=1.4)
    panel.view_init(*_VIEW_DEG)
    for axis, name in ((panel.xaxis, "x / m"), (panel.yaxis, "y / m"), (panel.zaxis, "z / m")):
        axis.set_label_text(name)
        axis.label.set_size(7)
        axis.labelpad = -9
        axis.set_major_locator(_few_ticks())
    panel.tick_params(labelsize=6, pad=-2)


def _few_ticks() -> Any:
    from matplotlib.ticker import MaxNLocator

    return MaxNLocator(3)


def _draw_slice(panel: Any, scene: PaperScene, frame: int) -> Any:
    """|F| on the plane y = constant with the most forces."""
    low, high = scene.scene.bounds_m()
    coarse = scene.field(frame, Grid.over_box(low, high, (48, 48, 48))).positions()
    row = int(np.bincount(coarse[:, 1], minlength=48).argmax())
    y = low[1] + (row + 0.5) / 48 * (high[1] - low[1])
    step = max(high[0] - low[0], high[2] - low[2]) / _SIDE
    nx, nz = (int(np.ceil((high[a] - low[a]) / step)) for a in (0, 2))
    grid = Grid(
        (nx, 1, nz), (step, step, step), (float(low[0] + step / 2), float(y), float(low[2] + step / 2))
    )
    force = np.linalg.norm(scene.field(frame, grid).to_dense()[:, 0], axis=-1)
    extent = (low[0], low[0] + nx * step, low[2], low[2] + nz * step)
    felt = np.where(force > 0, force, np.nan)
    image = panel.imshow(
        felt.T, origin="lower", extent=extent, cmap="cividis", vmin=0, vmax=3.3, interpolation="nearest"
    )
    panel.axhline(0, color="0.4", linewidth=1)
    panel.set_facecolor("0.93")
    panel.set_title(f"y = {y:.3f} m", fontsize=9)
    panel.set_xlabel("x / m", fontsize=8)
    panel.set_ylabel("z / m", fontsize=8)
    panel.tick_params(labelsize=7)
    return image


def _normals(faces: Float64s) -> Float64s:
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    return np.asarray(normal / np.linalg.norm(normal, axis=1, keepdims=True))


def _rgb(colour: str) -> Float64s:
    return np.array([int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)])


EXPERIMENT = Experiment("fig5", "Figure 5: bodies that fall, and their force fields", run)

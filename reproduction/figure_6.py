"""Reproduces figure 6 of the paper: a frame of scene 2, its depth map, and the forces on a device (section
5.1)."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np

from reproduction.experiment import Experiment, Finding, Inputs, require_drawing
from reproduction.progress import Steps
from reproduction.section_5_1 import DepthHeights, PaperScene, depth_scenes
from touchfield.devices import device
from touchfield.errors import MissingExtra
from touchfield.medium import Grid

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["EXPERIMENT", "draw_frame"]

_SIDE: Final = 400  # samples across the slice
_LINE = "#ee6677"


def run(inputs: Inputs) -> Finding:
    """Draw the first frame of each depth sequence."""
    require_drawing("figure 6")
    chosen = depth_scenes(inputs)
    steps = Steps(inputs.report, len(chosen))
    pictures, parts, data = [], [], []
    for number, scene in enumerate(chosen):
        with steps.step():
            path = inputs.folder / ("fig6.png" if number == 0 else f"fig6_{number + 1}.png")
            draw_frame(path, scene, _motorcycle_picture() if number == 0 else None)
        parts.append(f"![{scene.title}]({path.name})\n")
        pictures.append(path)
        data.append({"scene": scene.name, "frames": scene.scene.frame_count})
    parts.append(
        "The paper's 20 frames are not published. Each depth map is read as a height map: pixels are x and "
        "y, depth "
        "is the height, and all behind the surface is solid. The slice is taken along the line in the depth "
        "map; its "
        "force is F = min(500 N/m x depth, 3.3 N) in the metres of the hand. Grey is free space, and what "
        "the frame "
        "has not seen. The picture is the one that the real depth map belongs to; the frame is seen from a "
        "step "
        "beside it.\n"
    )
    return Finding("\n".join(parts), {"scenes": data}, tuple(pictures))


def draw_frame(path: Path, scene: PaperScene, picture: NDArray[Any] | None = None) -> None:
    """Write the first frame of scene 2, PNG: the picture where there is one, the depth map, and |F| on a
    slice.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    from touchfield.viewer.page import titled_figure, write_png

    assert isinstance(scene.scene, DepthHeights)
    depth = scene.scene.sequence.depth_m(0)
    columns = 3 if picture is not None else 2
    low, high = scene.scene.bounds_m()
    widths = [depth.shape[1] / depth.shape[0]] * (columns - 1) + [
        max(0.5, (high[0] - low[0]) / (high[2] - low[2]))
    ]
    widths = [width + 0.35 for width in widths]  # room for axes and scales
    figure = titled_figure("the picture of scene 2", scene.title, 3.1 * sum(widths), 3.9)
    panels = list(figure.subplots(1, columns, width_ratios=widths))
    if picture is not None:
        _draw_picture(panels.pop(0), picture)
    row = depth.shape[0] // 2
    shown = panels[0].imshow(np.where(depth > 0, depth, np.nan), cmap="cividis_r", interpolation="nearest")
    panels[0].axhline(row, color=_LINE, linewidth=1.5)
    panels[0].set_facecolor("0.86")
    _label(panels[0], "depth map", "x / pixels", "y / pixels")
    figure.colorbar(shown, ax=panels[0], shrink=0.75).set_label("depth / m")
    _draw_slice(figure, panels[1], scene, row)
    write_png(figure, path)


def _draw_picture(panel: Any, picture: NDArray[Any]) -> None:
    panel.imshow(picture)
    _label(panel, "picture", "x / pixels", "y / pixels")


def _draw_slice(figure: Any, panel: Any, scene: PaperScene, row: int) -> None:
    """|F| on the plane of one row of pixels, as seen from above: the viewer is below."""
    low, high = scene.scene.bounds_m()
    assert isinstance(scene.scene, DepthHeights)
    y = low[1] + (high[1] - low[1]) * row / (scene.scene.sequence.height - 1)
    nx = nz = _SIDE
    step_x, step_z = (high[0] - low[0]) / nx, (high[2] - low[2]) / nz
    first = (float(low[0] + step_x / 2), float(y), float(low[2] + step_z / 2))
    grid = Grid((nx, 1, nz), (float(step_x), float(step_x), float(step_z)), first)
    force = np.linalg.norm(scene.field(0, grid).to_dense()[:, 0], axis=-1)
    felt = np.where(force > 0, force, np.nan)
    extent = (low[0], high[0], low[2], high[2])
    top = device("phantom-omni").force_max_n
    shown = panel.imshow(
        felt.T, origin="lower", extent=extent, cmap="cividis", vmin=0, vmax=top, interpolation="nearest"
    )
    panel.set_facecolor("0.86")
    for side in panel.spines.values():
        side.set_color(_LINE)
    _label(panel, "|F| along the line, from above", "x / m", "depth / m")
    figure.colorbar(shown, ax=panel, shrink=0.75).set_label("|F| / N")


def _label(panel: Any, title: str, x: str, y: str) -> None:
    panel.set_title(title, fontsize=10)
    panel.set_xlabel(x, fontsize=8)
    panel.set_ylabel(y, fontsize=8)
    panel.tick_params(labelsize=7)


def _motorcycle_picture() -> NDArray[Any]:
    """The left picture of the stereo pair that the depth map without download belongs to."""
    try:
        from skimage.data import stereo_motorcycle
    except ImportError:
        raise MissingExtra("the picture of scene 2", "scikit-image", "motorcycle") from None
    pictures: Any = stereo_motorcycle
    left: NDArray[Any] = pictures()[0]
    return left


EXPERIMENT = Experiment("fig6", "Figure 6: a frame of scene 2, its depth map and its force field", run)

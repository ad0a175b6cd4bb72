"""Media of growing sizes for `bench_scaling`, each along one axis.

Samples are 1 mm apart in metres of the hand, and walls are 8 mm thick, so that forces follow the surface:

* frames: five bodies that tumble on a circle, for more and more frames.
* surface: concentric sections of the Jacksboro fault (matplotlib's elevation model), one frame each.
* box: one such section, in a workspace that grows in all directions.
* bodies: more and more rows of three tumbling bodies, 18 mm apart. The error bound is checked at each voxel
  that several bodies reach. In a square the fraction of bodies with eight neighbours would grow; each further
  row of three adds the same shapes and as many pairs of neighbours as the one before.
* bodies in a box: fifteen such bodies, in a workspace that grows.
* views: a room that a depth camera sees from more and more places on an arc.
* room: larger and larger copies of the room, seen from 24 places.
* corridor: a wall with balls that a depth camera passes; surface and pictures grow together.
* room in a box: the room seen from 24 places, in a workspace that grows.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from touchfield.errors import import_extra
from touchfield.medium import PoseTrack
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.fused_scene import FusedScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Shape, Sphere, Superquadric
from touchfield.sources.terrain.height_scene import HeightScene

Float64s = NDArray[np.float64]
Sides = tuple[int, int, int]
Balls = tuple[tuple[tuple[float, float, float], float], ...]

SPACING_MM: Final = 1.0
THICKNESS_M: Final = 0.008
MARGIN: Final = 12
"""Samples of the workspace beyond the surface."""
RATE_HZ: Final = 30.0
TURN_FRAMES: Final = 120
"""Frames in which a body turns once, and goes around its circle once."""
HALF_M: Final = 0.006
CIRCLE_M: Final = 0.018
PITCH_M: Final = 0.018
TERRAIN_PX, TERRAIN_CELL_M = (344, 403), (92.66, 73.66)
"""Rows and columns of the elevation model, and the distances between them."""
SAMPLES_PER_CELL: Final = 1.0
TERRAIN_SCALE: Final = 1e-3 * SAMPLES_PER_CELL / TERRAIN_CELL_M[1]
BOX_SECTION: Final = 1 / 8
"""Part of the elevation model that lies in a growing box."""
CIRCLE_WORKSPACE: Final = (64, 64, 32)
BODY_FRAMES, BOX_BODIES = 60, 15
BODIES_PER_ROW: Final = 3
"""One of each shape."""
VIEWS: Final = 24
ROOM_WORKSPACE: Final = (136, 88, 104)
ROOM_SCALE: Final = 0.03
"""Metres of the hand for a metre of the smallest room."""
PICTURE_PX: Final = (240, 320)
BALLS: Final = (((-0.3, 0.2, 1.6), 0.35), ((0.45, 0.3, 1.9), 0.3), ((0.1, -0.35, 1.4), 0.2))
CORRIDOR_STEP_M: Final = 0.25
"""Way of the camera along a corridor from one picture to the next; a ball stands at every third place."""


@dataclass(frozen=True)
class Setting:
    """A scene in a workspace.

    `workspace` are the samples along x, y and z; `scale` are metres of the hand for a metre of the scene.
    """

    scene: Callable[[], Scene]
    workspace: Sides
    scale: float = 1.0
    representation: str = "voxel"

    def spec(self, folder: Path) -> EncodeSpec:
        """Return the options that make the medium; a device with this workspace is written into `folder`."""
        device = folder / f"{'x'.join(map(str, self.workspace))}.toml"
        device.write_text(_profile(self.workspace), encoding="utf-8")
        return EncodeSpec(
            device=str(device), nw=None, mapping=self.scale, thickness_m=THICKNESS_M, thin="keep",
            representation=self.representation,
        )  # fmt: skip


def _profile(workspace: Sides) -> str:
    """Return the profile of a device with a lattice of this shape, samples `SPACING_MM` apart."""
    values = {
        "axes": '"x right, y up, z towards the user"',
        "workspace_mm": [SPACING_MM * side for side in workspace],
        "resolution_mm": SPACING_MM,
        "nominal_lattice": list(workspace),
        "force_max_n": 3.3,
        "rate_hz": 1000.0,
    }
    tables = (f'[{key}]\nvalue = {value}\nsource = "of this benchmark"' for key, value in values.items())
    return "\n".join(['name = "scaling"\ntitle = "scaling"\ntype = 1', *tables])


def grown(workspace: Sides, times: float) -> Sides:
    """Return a workspace with `times` as many samples, which grows alike along x, y and z."""
    exponents = [math.log2(times) / 3] * 3
    x, y, z = (8 * round(side * 2**e / 8) for side, e in zip(workspace, exponents, strict=True))
    return x, y, z


# -- bodies ------------------------------------------------------------------------------------------------


def _shape(n: int) -> Shape:
    """Return one of a ball, a box and a superquadric around the origin."""
    origin = (0.0, 0.0, 0.0)
    shapes = (
        Sphere(origin, HALF_M),
        Box(origin, (HALF_M, 0.8 * HALF_M, 0.6 * HALF_M)),
        Superquadric(origin, (HALF_M,) * 3, (0.5, 1.0)),
    )
    return shapes[n % len(shapes)]


def _body(n: int, positions_m: Float64s) -> Body:
    """Return body `n`, which turns about an axis of its own at these positions, float64 [frames, 3]."""
    axis = np.random.default_rng(n).normal(size=3)
    angles = 2 * np.pi / TURN_FRAMES * np.arange(len(positions_m))
    turns = Rotation.from_rotvec(angles[:, None] * (axis / np.linalg.norm(axis)))
    track = PoseTrack(turns.as_quat()[:, [3, 0, 1, 2]], positions_m)
    return Body(f"body {n}", AnalyticScene([_shape(n)]), track)


def circling_bodies(frames: int) -> BodyScene:
    """Return five bodies that tumble around a circle."""
    bodies = []
    for n in range(5):
        angles = 2 * np.pi * (n / 5 + np.arange(frames) / TURN_FRAMES)
        circle = np.stack([np.cos(angles), np.sin(angles), np.zeros(frames)], axis=1)
        bodies.append(_body(n, CIRCLE_M * circle))
    return BodyScene(bodies, RATE_HZ)


def bodies_in_rows(count: int, frames: int) -> BodyScene:
    """Return `count` bodies that tumble in place, `PITCH_M` apart in rows."""
    bodies = []
    for n in range(count):
        place = PITCH_M * np.array([n % BODIES_PER_ROW, n // BODIES_PER_ROW, 0.0])
        bodies.append(_body(n, np.tile(place, (frames, 1))))
    return BodyScene(bodies, RATE_HZ)


def _rows_workspace(count: int) -> Sides:
    rows = -(-count // BODIES_PER_ROW)
    pitch = round(1e3 * PITCH_M / SPACING_MM)
    return BODIES_PER_ROW * pitch + 2 * MARGIN, rows * pitch + 2 * MARGIN, pitch + 2 * MARGIN


# -- terrain -----------------------------------------------------------------------------------------------


def section(part: float) -> HeightScene:
    """Return the middle of the elevation model: this part of its area."""
    cbook = import_extra("matplotlib.cbook", "the elevation model", "matplotlib", "report")
    with np.load(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as model:
        heights = model["elevation"].astype(np.float64)
    (top, rows), (left, columns) = (_middle(n, part) for n in heights.shape)
    return HeightScene(heights[top : top + rows, left : left + columns], TERRAIN_CELL_M)


def _middle(count: int, part: float) -> tuple[int, int]:
    """Return the start and the number of samples in the middle of an axis, for a part of an area."""
    number = round(count * math.sqrt(part))
    return (count - number) // 2, number


def _section_workspace(part: float) -> Sides:
    """Return the workspace of a section; its heights span at most 840 m."""
    sides = [SAMPLES_PER_CELL * _middle(n, part)[1] for n in TERRAIN_PX]
    relief = 840 / TERRAIN_CELL_M[1] * SAMPLES_PER_CELL
    y, x, z = (8 * math.ceil((side + 2 * MARGIN) / 8) for side in (*sides, relief))
    return x, math.ceil(y * TERRAIN_CELL_M[0] / TERRAIN_CELL_M[1] / 8) * 8, z


# -- rooms -------------------------------------------------------------------------------------------------


class Room(DepthSequence):
    """A wall, a floor and balls before a depth camera at the given poses, float64 [frames, 4, 4].

    Depths have the axial noise of Nguyen, Izadi and Lovell (2012).
    """

    width, height, rate_hz, notes, name = PICTURE_PX[1], PICTURE_PX[0], RATE_HZ, (), "room"

    def __init__(self, poses: Float64s, balls: Balls) -> None:
        self.frame_count, self.poses, self._balls = len(poses), poses, balls
        focal_px = 0.82 * self.width
        self.intrinsics = Intrinsics(focal_px, focal_px, (self.width - 1) / 2, (self.height - 1) / 2)
        rng = np.random.default_rng(1)
        self._depths = [self._measured(pose, rng) for pose in poses]

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence`."""
        return self._depths[frame]

    def _measured(self, pose: Float64s, rng: np.random.Generator) -> NDArray[np.float32]:
        depth = self._rendered(pose)
        noise = rng.standard_normal(depth.shape) * (0.0012 + 0.0019 * (depth - 0.4) ** 2)
        return (depth + noise).astype(np.float32)

    def _rendered(self, pose: Float64s) -> Float64s:
        """Return the depth of the nearest surface along the ray of each pixel."""
        k, start = self.intrinsics, pose[:3, 3]
        v, u = np.mgrid[: self.height, : self.width]
        rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], -1) @ pose[:3, :3].T
        depth = (2.6 - start[2]) / np.maximum(rays[..., 2], 1e-6)
        depth = np.minimum(
            depth, np.where(rays[..., 1] > 0, (0.8 - start[1]) / np.maximum(rays[..., 1], 1e-6), np.inf)
        )
        square = (rays**2).sum(axis=-1)
        for centre, radius in self._balls:
            away = np.asarray(centre) - start
            along = rays @ away
            inside = along**2 - square * (away @ away - radius**2)
            hit = (along - np.sqrt(np.maximum(inside, 0))) / square
            depth = np.where((inside > 0) & (hit > 0), np.minimum(depth, hit), depth)
        return np.asarray(depth)


def arc(count: int) -> Float64s:
    """Return poses, camera to world, on an arc before the room, float64 [count, 4, 4]."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    for pose, angle in zip(poses, np.linspace(-0.3, 0.3, count), strict=True):
        c, s = math.cos(angle), math.sin(angle)
        pose[:3, :3] = [[c, 0, -s], [0, 1, 0], [s, 0, c]]
        pose[:3, 3] = 1.2 * s, -0.1, 0.25 * (1 - c)
    return poses


def way(count: int) -> Float64s:
    """Return poses, camera to world, along a corridor, float64 [count, 4, 4]."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = CORRIDOR_STEP_M * np.arange(count)
    return poses


def room(views: int) -> Scene:
    """Return the room from `views` places on an arc, fused."""
    return FusedScene(Room(arc(views), BALLS))


def corridor(views: int) -> Scene:
    """Return a corridor along which the camera takes `views` pictures, fused."""
    balls = tuple(((3 * CORRIDOR_STEP_M * n, 0.5, 2.2), 0.25) for n in range(-2, views // 3 + 3))
    return FusedScene(Room(way(views), balls))


# -- settings by axis --------------------------------------------------------------------------------------


def _of_frames(size: float) -> Setting:
    return Setting(lambda: circling_bodies(round(size)), CIRCLE_WORKSPACE)


def _of_surface(size: float) -> Setting:
    return Setting(lambda: section(size), _section_workspace(size), TERRAIN_SCALE)


def _of_box(size: float) -> Setting:
    return Setting(lambda: section(BOX_SECTION), grown(_section_workspace(BOX_SECTION), size), TERRAIN_SCALE)


def _of_objects(size: float) -> Setting:
    return Setting(lambda: circling_bodies(round(size)), CIRCLE_WORKSPACE, representation="object")


def _of_bodies(size: float) -> Setting:
    count = round(size)
    scene, workspace = (lambda: bodies_in_rows(count, BODY_FRAMES)), _rows_workspace(count)
    return Setting(scene, workspace, representation="object")


def _of_bodies_in_box(size: float) -> Setting:
    count, workspace = BOX_BODIES, grown(_rows_workspace(BOX_BODIES), size)
    return Setting(lambda: bodies_in_rows(count, BODY_FRAMES), workspace, representation="object")


def _of_views(size: float) -> Setting:
    return Setting(lambda: room(round(size)), ROOM_WORKSPACE, ROOM_SCALE)


def _of_room(size: float) -> Setting:
    factor = math.sqrt(size)
    x, y, z = (8 * math.ceil(side * factor / 8) for side in ROOM_WORKSPACE)
    return Setting(lambda: room(VIEWS), (x, y, z), ROOM_SCALE * factor)


def _of_room_in_box(size: float) -> Setting:
    return Setting(lambda: room(VIEWS), grown(ROOM_WORKSPACE, size), ROOM_SCALE)


def _of_corridor(size: float) -> Setting:
    x, y, z = ROOM_WORKSPACE
    x += 8 * math.ceil(1e3 * ROOM_SCALE * CORRIDOR_STEP_M * size / 8)
    return Setting(lambda: corridor(round(size)), (x, y, z), ROOM_SCALE)


SETTINGS: Final[dict[str, Callable[[float], Setting]]] = {
    "frames": _of_frames, "surface": _of_surface, "box": _of_box, "objects": _of_objects,
    "bodies": _of_bodies, "bodies in a box": _of_bodies_in_box, "views": _of_views, "room": _of_room,
    "room in a box": _of_room_in_box, "corridor": _of_corridor,
}  # fmt: skip
"""A medium of a size, by axis.

The size is a number of frames, of bodies or of pictures; a part of the elevation model; or how many times
larger than the smallest the room's surface or the workspace is.
"""

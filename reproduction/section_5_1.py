"""Makes the two scenes of the paper's section 5.1, and the lattices on which its tables 1 and 2 count
samples.

Scene 1: bodies that fall, four as the text has them and seven as figure 5 shows; the ground is not felt.
Scene 2: 20 depth maps, by linear interpolation 800 frames, read as a height map with all behind the surface
solid. Neither of the paper's own is published.

*literal*: 10^4 samples along each axis of the scene's own box, and the device's lattice over the same box,
which stretches it onto the workspace. *corrected*: both lattices over the device's workspace, in which the
scene lies with its aspect kept. The force law is that of the hand, F = min(K d, F_max), in both.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.experiment import Inputs
from touchfield.devices import device
from touchfield.filters.device_spec import device_grid
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import Placement
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.laws import profile_of
from touchfield.sources.scene import Body, Scene

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.sources.camera import DepthSequence
    from touchfield.sources.laws import ForceProfile

__all__ = [
    "NOMINAL",
    "READINGS",
    "DepthHeights",
    "PaperScene",
    "depth_scenes",
    "height_scene",
    "scene_1",
    "scenes",
]

NOMINAL: Final = 10_000
"""Samples along each axis of the paper's "uniform 3D workspace"."""

DEPTH_FRAMES, DEPTH_RATE_HZ, RATE_HZ = 20, 25.0, 1000.0
"""Of scene 2: 20 frames at 25 Hz are 800 at 1 kHz."""

READINGS: Final = ("literal", "corrected")


@dataclass(frozen=True)
class PaperScene:
    """A scene as section 5.1 counts it.

    Attributes
    ----------
    key : str
        "scene1" or "scene2": whose printed figures stand beside it.
    name, title : str
    scene : Scene
    """

    key: str
    name: str
    title: str
    scene: Scene

    @cached_property
    def placement(self) -> Placement:
        """In the workspace of the Phantom Omni, aspect kept."""
        return Placement.fit(self.scene.bounds_m(), device("phantom-omni").workspace_m)

    @cached_property
    def profile(self) -> ForceProfile:
        """The force law of a solid, in scene metres."""
        spec = EncodeSpec()
        law = spec.law_spec(device(spec.device).force_max_n)
        return profile_of(law, math.inf).rescaled(self.placement.scale)

    def lattice(self, reading: str, is_nominal: bool) -> Grid:
        """The nominal lattice or the Omni's, over the scene's box or over the workspace; scene metres."""
        omni = device("phantom-omni")
        shape = (NOMINAL, NOMINAL, NOMINAL) if is_nominal else omni.lattice
        if reading == "literal":
            low, high = self.scene.bounds_m()
            return Grid.over_box(low, high, shape)
        half = np.asarray(omni.workspace_m) / 2
        return self.placement.to_scene(Grid.over_box(-half, half, shape) if is_nominal else device_grid(omni))

    def field(self, frame: int, part: Grid) -> ForceField:
        """The scene's own field on a part of a lattice."""
        return self.scene.field(frame, part, self.profile)

    def volume_m3(self) -> float | None:
        """Of all bodies, by formula, where each has one."""
        volumes = [_volume_m3(body) for body in self.scene.bodies()]
        return None if None in volumes else math.fsum(v for v in volumes if v is not None)

    @property
    def cycle_frames(self) -> int | None:
        """Of a depth sequence: frames from one depth map to the next."""
        return round(RATE_HZ / DEPTH_RATE_HZ) if isinstance(self.scene, DepthHeights) else None

    def segmented(self) -> tuple[int, float] | None:
        """Of a depth sequence: objects of the first frame, and the share of its known pixels that they
        hold.
        """
        if not isinstance(self.scene, DepthHeights):
            return None
        from reproduction.scenes import FirstFrames
        from touchfield.sources.camera import noise_step_per_m
        from touchfield.sources.depth.segmentation import Segmentation, SegmentRule

        first = FirstFrames(self.scene.sequence, 1)
        found = Segmentation(first, SegmentRule(), noise_step_per_m(first.depth_m(0)))
        return found.object_count, float(found.pixels[0, 1:].sum() / found.pixels[0].sum())


def scenes(inputs: Inputs) -> list[PaperScene]:
    """Scene 1 with four and with seven bodies, and each of scene 2.

    Raises
    ------
    MissingExtra
        If MuJoCo or scikit-image is not installed.
    SourceError
        If a depth sequence cannot be read.
    """
    return [scene_1(4), scene_1(7), *depth_scenes(inputs)]


def depth_scenes(inputs: Inputs) -> list[PaperScene]:
    """Scene 2 without download, then of the user's depth sequences: the first 20 frames of each, as at 25 Hz.

    Raises
    ------
    MissingExtra
        If scikit-image is not installed.
    SourceError
        If a depth sequence cannot be read.
    """
    from reproduction.scenes import depth_inputs

    found = []
    for depth in depth_inputs(inputs):
        scene = height_scene(depth.first(DEPTH_FRAMES).sequence)
        found.append(PaperScene("scene2", depth.name, f"Scene 2, depth maps of {depth.name}", scene))
    return found


def scene_1(bodies: int) -> PaperScene:
    """Bodies that fall on the ground: 4 or 7."""
    from touchfield.sources.samples import sample

    name, words = f"falling-{bodies}", {4: "four", 7: "seven"}[bodies]
    return PaperScene("scene1", name, f"Scene 1, {words} bodies (sample:{name})", sample(name))


def height_scene(sequence: DepthSequence) -> DepthHeights:
    """Depth maps at 25 Hz as a height map at 1 kHz, by linear interpolation, all behind the surface solid."""
    from touchfield.sources.camera import InterpolatedSequence
    from touchfield.sources.terrain.height_scene import HeightScene

    slow = copy.copy(sequence)
    slow.rate_hz = DEPTH_RATE_HZ
    box = HeightScene.from_depth_sequence(slow).bounds_m()
    return DepthHeights(slow, HeightScene.from_depth_sequence(InterpolatedSequence(slow, RATE_HZ)), box)


class DepthHeights(Scene):
    """Depth maps interpolated in time, as a height map; the box is that of the maps themselves.

    What lies between two maps lies within theirs, and need not be read for it.

    Parameters
    ----------
    sequence : DepthSequence
        Before the interpolation.
    scene : HeightScene
    box_m : float64 [2, 3]
    """

    is_solid = True

    def __init__(self, sequence: DepthSequence, scene: Scene, box_m: NDArray[np.float64]) -> None:
        self.sequence, self.scene, self._box_m = sequence, scene, box_m
        self.frame_count, self.rate_hz = scene.frame_count, scene.rate_hz
        self.axes, self.notes = scene.axes, scene.notes

    def bounds_m(self) -> NDArray[np.float64]:
        """See `Scene.bounds_m`."""
        return self._box_m

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """See `Scene.field`."""
        return self.scene.field(frame, grid, profile)


def _volume_m3(body: Body) -> float | None:
    from touchfield.sources.mesh.mesh_scene import MeshScene
    from touchfield.sources.shapes.analytic_scene import AnalyticScene
    from touchfield.sources.shapes.shapes import Box, Capsule, Cylinder, Ellipsoid, Sphere

    if isinstance(body.scene, MeshScene) and body.scene.is_closed:
        return abs(body.scene.surface.volume_m3())
    if not isinstance(body.scene, AnalyticScene) or len(body.scene.shapes) != 1:
        return None
    match body.scene.shapes[0]:
        case Box(half_extents_m=half):
            return 8 * math.prod(half)
        case Sphere(radius_m=r):
            return 4 / 3 * math.pi * r**3
        case Ellipsoid(half_extents_m=half):
            return 4 / 3 * math.pi * math.prod(half)
        case Cylinder(radius_m=r, half_length_m=h):
            return 2 * math.pi * r**2 * h
        case Capsule(radius_m=r, half_length_m=h):
            return math.pi * r**2 * (2 * h + 4 / 3 * r)
    return None

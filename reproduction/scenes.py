"""Opens the depth sequences on which experiments run: one that needs no download, and those of the user.

The paper's section 5.2 takes consecutive depth frames of SUN3D, a hand-held camera in a hotel. What comes
with the libraries is a single real depth map (`sample:motorcycle`). `MovingView` shows it to a moving camera:
the surface is drawn as triangles from nearby viewpoints, through a depth buffer. Where the camera sees past
an edge nothing is known, and nothing is made up.

What such a sequence lacks is the noise of a sensor from frame to frame: the noise of the one map sticks to
the surface and moves with it. `NoisyPair` adds what is missing, of the size that the map itself shows, so
that an experiment can tell how much of a change is motion and how much is noise.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.experiment import SEEDS
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.camera import DepthSequence
from touchfield.sources.options import SourceOptions

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from reproduction.experiment import Inputs

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]

__all__ = [
    "DepthInput",
    "FirstFrames",
    "MovingView",
    "NoisyPair",
    "depth_inputs",
    "inverse_depth_noise_per_m",
    "user_inputs",
]

SAMPLE: Final = "motorcycle"
"""What pages call the sequence that needs no download."""

FRAMES: Final = 20
"""Frames of the sequence that needs no download: as many as the paper's scene 2 has depth maps."""

RATE_HZ: Final = 25.0
"""Its frames a second: 20 frames make the paper's 800 at 1 kHz."""

STEP_M, TURN_DEG = 0.0015, 0.3
"""How far a hand-held camera moves and turns from one frame to the next; as slow as a careful scan."""

_SQUARE_STEP_PX = 7.5
"""A square of pixels is one surface up to this slope, footprints of a pixel in depth per pixel."""


class MovingView(DepthSequence):
    """One depth map as a moving camera sees it, frame by frame.

    No frame is seen from where the map was taken, so that all of them have been sampled anew alike.

    Parameters
    ----------
    source : DepthSequence
        Its first frame is shown.
    frame_count : int
    """

    def __init__(self, source: DepthSequence, frame_count: int = FRAMES) -> None:
        if frame_count < 1:
            raise InvalidArgument("frame_count", repr(frame_count), "1 or more")
        self.source, self.frame_count, self.rate_hz = source, frame_count, RATE_HZ
        self.name = f"{source.name}, seen by a moving camera"
        self.width, self.height, self.intrinsics = source.width, source.height, source.intrinsics
        self.poses = hand_held_poses(frame_count)
        self.poses.flags.writeable = False
        self.notes = (
            f"one real depth map, drawn from {frame_count} viewpoints {1e3 * STEP_M:g} mm and {TURN_DEG:g} "
            "degrees "
            "apart; its noise moves with the surface",
        )

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        from reproduction.kernels.depth_view import draw_quads

        _check_frame(self, frame)
        assert self.poses is not None
        points, whole = self._surface
        turn, shift = self.poses[frame, :3, :3], self.poses[frame, :3, 3]
        seen = (points - shift) @ turn  # the inverse of a rigid motion
        z = np.maximum(seen[..., 2], 1e-6)
        camera = self.intrinsics
        corners = np.stack(
            [camera.fx * seen[..., 0] / z + camera.cx, camera.fy * seen[..., 1] / z + camera.cy, 1 / z],
            axis=-1,
        )
        inverse = np.zeros((self.height, self.width))
        draw_quads(corners, whole & _all_corners(seen[..., 2] > 0), inverse)
        return np.divide(1, inverse, out=np.zeros_like(inverse), where=inverse > 0).astype(np.float32)

    @cached_property
    def _surface(self) -> tuple[Float64s, NDArray[np.bool_]]:
        """The points of the pixels, metres, [height, width, 3], and which squares of four are one surface."""
        from touchfield.sources.camera import noise_step_per_m

        depth = self.source.depth_m(0)
        camera = self.intrinsics
        v, u = np.mgrid[: self.height, : self.width].astype(np.float64)
        z = depth.astype(np.float64)
        points = np.stack([(u - camera.cx) / camera.fx * z, (v - camera.cy) / camera.fy * z, z], axis=-1)
        known = depth > 0
        w = np.divide(1, z, out=np.zeros_like(z), where=known)
        four = np.stack([w[:-1, :-1], w[:-1, 1:], w[1:, :-1], w[1:, 1:]])
        slope = _SQUARE_STEP_PX / min(camera.fx, camera.fy)
        step = np.maximum(noise_step_per_m(depth), slope * four.max(axis=0))
        return points, _all_corners(known) & (np.ptp(four, axis=0) <= step)


class FirstFrames(DepthSequence):
    """The first frames of another sequence.

    Parameters
    ----------
    source : DepthSequence
    frame_count : int
        As many, or all where there are fewer.
    """

    def __init__(self, source: DepthSequence, frame_count: int) -> None:
        self.source, self.frame_count = source, min(frame_count, source.frame_count)
        self.name, self.notes, self.rate_hz = source.name, source.notes, source.rate_hz
        self.width, self.height, self.intrinsics = source.width, source.height, source.intrinsics
        self.poses = None if source.poses is None else source.poses[: self.frame_count]

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        _check_frame(self, frame)
        return self.source.depth_m(frame)


class NoisyPair(DepthSequence):
    """A view that stands still, twice: as it is, and again with the noise of a sensor.

    Inverse depth differs by white noise of sqrt(2) standard deviations, as two readings of one scene do:
    disparity sensors err alike in disparity wherever they look.

    Parameters
    ----------
    source : DepthSequence
        Its first frame is taken.
    noise_per_m : float
        Standard deviation of the inverse depth, 1/m; 0 shows the same frame twice.
    """

    def __init__(self, source: DepthSequence, noise_per_m: float) -> None:
        self.source, self.noise_per_m, self.frame_count = source, noise_per_m, 2
        self.name, self.rate_hz = source.name, source.rate_hz
        self.width, self.height, self.intrinsics = source.width, source.height, source.intrinsics

    def depth_m(self, frame: int) -> NDArray[np.float32]:
        """See `DepthSequence.depth_m`."""
        _check_frame(self, frame)
        depth = self.source.depth_m(0)
        if frame == 0 or not self.noise_per_m:
            return depth
        known = depth > 0
        noise = (
            np.random.default_rng(SEEDS["sensor_noise"]).standard_normal(depth.shape)
            * self.noise_per_m
            * np.sqrt(2)
        )
        inverse = np.divide(1.0, depth, out=np.ones(depth.shape), where=known) + noise
        shown: Float32s = np.where(known & (inverse > 0), 1 / np.maximum(inverse, 1e-9), 0).astype(np.float32)
        return shown


@dataclass(frozen=True)
class DepthInput:
    """A depth sequence of an experiment.

    Attributes
    ----------
    name : str
        What pages call it; the same on every machine.
    sequence : DepthSequence
    """

    name: str
    sequence: DepthSequence

    def first(self, frame_count: int) -> DepthInput:
        """The same, with its first frames alone."""
        return replace(self, sequence=FirstFrames(self.sequence, frame_count))


def depth_inputs(inputs: Inputs) -> tuple[DepthInput, ...]:
    """The sequence that needs no download, then the user's, in their order.

    Raises
    ------
    MissingExtra
        If scikit-image, which carries the depth map, is not installed.
    SourceError
        If a folder of the user is no depth sequence, or cannot be read.
    """
    from touchfield.sources.depth.inverse_depth import motorcycle_sequence

    return (DepthInput(SAMPLE, MovingView(motorcycle_sequence())), *user_inputs(inputs.depth))


def user_inputs(folders: tuple[Path, ...]) -> tuple[DepthInput, ...]:
    """The user's depth sequences alone; where a name is taken, a number follows it.

    Raises
    ------
    SourceError
        If a folder is no depth sequence, or cannot be read.
    """
    from touchfield.sources.depth.depth_scene import DepthScene
    from touchfield.sources.registry import open_source

    found: list[DepthInput] = []
    taken = [SAMPLE]
    for folder in folders:
        scene = open_source(folder, SourceOptions())
        if not isinstance(scene, DepthScene):
            raise SourceError(str(folder), "a source that is no depth sequence", "depth frames of one camera")
        name = folder.resolve().name
        found.append(
            DepthInput(f"{name} ({taken.count(name) + 1})" if name in taken else name, scene.sequence)
        )
        taken.append(name)
    return tuple(found)


def hand_held_poses(frame_count: int) -> Float64s:
    """Camera-to-world poses of a camera that wanders and turns at an even pace, float64 [frame_count, 4, 4].

    The first is one step away from the identity.
    """
    from scipy.spatial.transform import Rotation

    i = np.arange(frame_count)
    ways = np.stack([np.cos(0.35 * i), 0.6 * np.sin(0.5 * i + 1), 0.5 * np.sin(0.3 * i + 0.5)], axis=1)
    axes = np.stack([np.sin(0.4 * i + 0.5), np.cos(0.4 * i), np.full(frame_count, 0.3)], axis=1)
    ways *= STEP_M / np.linalg.norm(ways, axis=1, keepdims=True)
    axes *= np.radians(TURN_DEG) / np.linalg.norm(axes, axis=1, keepdims=True)
    poses = np.tile(np.eye(4), (frame_count, 1, 1))
    turn = Rotation.identity()
    for frame in range(frame_count):
        turn = turn * Rotation.from_rotvec(axes[frame])
        poses[frame, :3, :3] = turn.as_matrix()
    poses[:, :3, 3] = np.cumsum(ways, axis=0)
    return poses


def inverse_depth_noise_per_m(depth_m: Float32s) -> float:
    """Standard deviation of the noise of inverse depth, 1/m, from one frame.

    From the second differences along the rows, which vanish on a plane and are sqrt(6) as wide as white
    noise: their upper quartile, over that of a normal distribution's modulus, so that edges do not count.
    """
    known = depth_m > 0
    inverse = np.divide(1.0, depth_m, out=np.zeros(depth_m.shape), where=known)
    inside = known[:, :-2] & known[:, 1:-1] & known[:, 2:]
    bends = np.abs(inverse[:, :-2] - 2 * inverse[:, 1:-1] + inverse[:, 2:])[inside]
    return float(np.quantile(bends, 0.75) / (1.1503 * np.sqrt(6))) if bends.size else 0.0


def _all_corners(held: NDArray[np.bool_]) -> NDArray[np.bool_]:
    corners: NDArray[np.bool_] = held[:-1, :-1] & held[:-1, 1:] & held[1:, :-1] & held[1:, 1:]
    return corners


def _check_frame(sequence: DepthSequence, frame: int) -> None:
    if not 0 <= frame < sequence.frame_count:
        raise InvalidArgument(f"{sequence.name}, frame", str(frame), f"0 to {sequence.frame_count - 1}")

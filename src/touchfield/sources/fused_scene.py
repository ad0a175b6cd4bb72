"""A depth sequence as a world that stands still: the fused field of all frames, or of those seen so far.

    fused    The medium is computed ahead, and so is its world: every frame knows what all frames saw, and what stands
             does not tremble. What has not been seen yet may already be there.
    causal   A frame knows what was seen up to it: what a live sender can do. What stands is renewed eight times a
             second, and not shaken by every look; bricks in which something changes follow every frame.

In a fused world some samples changed (`touchfield.sources.fusion`). Where a frame sees whole patches of them, what
lies at and behind its surface there is *moving*: it follows the frames, as a causal world does, and the rest stands.
Narrower changes are noise, or a pose that is a little off at the edge of a thing.
"""

from __future__ import annotations

from threading import Lock
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.sources.depth_scene import DepthScene, noise_step_per_m
from touchfield.sources.fusion import FusedVolume

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid
    from touchfield.sources.camera import DepthSequence
    from touchfield.sources.kernels.planes import SurfacePlanes
    from touchfield.sources.profile import ForceProfile

__all__ = ["WORLDS", "FusedScene"]

WORLDS: Final = ("fused", "causal")

FIRST_LOOK: Final = 16.0
"""What the first look at a surface counts in a causal world: a seventh fewer samples (of a Kinect's) then change
beyond the mask from frame to frame (docs/decisions/0013)."""

RENEWALS_HZ: Final = 8.0
"""So often a second a causal world shows what was seen meanwhile of what stands: a third of the bytes go, and most of
the steps that a hand would feel (docs/decisions/0013)."""

CHANGING: Final = 8
"""A brick of 512 samples follows every frame once so many of them changed: an eighth of a plane through it."""

PATCH_SHARE: Final = 1 / 12
"""What moves is seen as a patch at least so high and wide, of the picture's height; a pose that is off by a degree or
two makes seams along edges, which are narrower."""

PATCH_DENSITY: Final = 0.7
"""Of the pixels of a patch, so many see a sample that changed."""

STANDS_SHARE: Final = 0.7
"""Of the pixels that are seen in two frames, so many must agree for a camera without poses to stand."""

DRIFT_TIMES: Final = 2.0
"""Poses drift if the residual of the last quarter is so many times that of the first, and above the noise."""

_KEPT_PLANES_BYTES = 256 << 20
_KEPT_WORLDS = 16  # an array asks for its depth in slabs


class FusedScene(DepthScene):
    """A depth sequence as one world, thin walls in metres.

    Parameters
    ----------
    sequence : DepthSequence
        With poses, or of a camera that stands.
    world : str
        "fused" or "causal".
    segment : str, optional
        As of `DepthScene`; bodies are taken from single frames.

    Raises
    ------
    InvalidArgument
        If `world` is neither.
    SourceError
        If the poses are not rigid motions.
    """

    def __init__(self, sequence: DepthSequence, world: str = "fused", segment: str | None = None) -> None:
        if world not in WORLDS:
            raise InvalidArgument("world", repr(world), " or ".join(WORLDS))
        super().__init__(sequence, "world", segment)
        self.world = world
        self.notes = (*self.notes, _told(sequence, world))
        self.take(0, self.frame_count)
        self._lock = Lock()

    def take(self, start: int, stop: int) -> None:
        """See `Scene.take`: the world is fused from these frames."""
        keys = [key for key in self.sequence.key_frames() if start <= key < stop] or [start]
        self._keys = np.asarray(keys)
        self._planes = _Planes(self, self._keys)
        self._worlds: dict[tuple[Grid, ForceProfile], _Fused | _Causal] = {}

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """The force field of one frame at the points of `grid`; the same object where nothing moves.

        Every lattice and law that is asked for first goes through all frames (a causal world: through those up to
        `frame`).

        Raises
        ------
        SourceError
            If a frame cannot be read.
        InvalidArgument
            If there is no such frame, or the volume is too large for the memory.
        """
        if not 0 <= frame < self.frame_count:
            raise InvalidArgument("frame", str(frame), f"0 to {self.frame_count - 1}")
        with self._lock:
            world = self._worlds.get((grid, profile))
            if world is None:
                kind = _Fused if self.world == "fused" else _Causal
                world = kind(grid, profile, self._noise_step_per_m(), self._planes)
                while len(self._worlds) >= _KEPT_WORLDS:
                    del self._worlds[next(iter(self._worlds))]
                self._worlds[grid, profile] = world
            return world.field(max(1, int(np.searchsorted(self._keys, frame, side="right"))))

    def learnt(self) -> tuple[str, ...]:
        """See `Scene.learnt`: what moves, and whether the poses drift."""
        told = {note: None for world in self._worlds.values() for note in world.notes()}
        return tuple(told)


class _Planes:
    """The planes and poses of the key frames by number, kept as far as memory is small."""

    def __init__(self, scene: DepthScene, keys: NDArray[np.int64]) -> None:
        self.scene, self.keys = scene, keys
        self._kept: dict[int, SurfacePlanes] = {}
        self._room = _KEPT_PLANES_BYTES // (16 * scene.sequence.width * scene.sequence.height)

    def report(self, done: int, total: int) -> None:
        """Tell who waits for the first field."""
        self.scene.report(done, total)

    def __len__(self) -> int:
        return len(self.keys)

    def at_rate(self, rate_hz: float) -> NDArray[np.bool_]:
        """True for the first key frame and for those that begin another period, whole frames long, bool [n]."""
        frames = max(1, round(self.scene.rate_hz / rate_hz))
        return np.asarray(np.diff((self.keys - self.keys[0]) // frames, prepend=-1) > 0)

    def __getitem__(self, i: int) -> tuple[SurfacePlanes, NDArray[np.float64]]:
        frame = int(self.keys[i])
        planes = self._kept.get(i)
        if planes is None:
            planes = self.scene.planes(frame)
            if len(self._kept) < self._room:
                self._kept[i] = planes
        return planes, self.scene.pose(frame)


class _Causal:
    """A world of what was seen so far."""

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes) -> None:
        self._planes = planes
        self._asked = grid, profile, step_per_m
        self._residuals_m: list[float | None] = []
        self._renewals = planes.at_rate(RENEWALS_HZ)
        self._begin()

    def _begin(self) -> None:
        """Nothing seen yet."""
        self._volume, self._seen = FusedVolume(*self._asked, FIRST_LOOK), 0
        self._renew()

    def _renew(self) -> None:
        """Show what is known now."""
        self._stands_n = self._volume.forces_n()
        self._latest = self._stands = self._volume.field(self._stands_n)

    def _see(self, i: int) -> None:
        """Tell the volume what one more key frame sees."""
        surface, pose = self._planes[i]
        self._volume.cover(surface, pose)
        residual = self._volume.integrate(surface, pose)
        if i == len(self._residuals_m):
            self._residuals_m.append(residual)

    def field(self, seen: int) -> ForceField:
        """What the first `seen` frames tell where something changes, and of the rest those up to the renewal."""
        if seen < self._seen:
            self._begin()
        if seen != self._seen:
            for i in range(self._seen, seen):
                self._see(i)
                if self._renewals[i]:
                    self._renew()
            self._seen = seen
            self._latest = self._stands if self._renewals[seen - 1] else self._now()
        return self._latest

    def _now(self) -> ForceField:
        """The latest renewal, but for bricks that follow every frame."""
        follows = np.count_nonzero(self._volume.samples.changes, axis=1) >= CHANGING
        if not follows.any():
            return self._stands
        forces = self._volume.forces_n()
        forces[~follows] = 0.0
        stands = np.flatnonzero(~follows[: len(self._stands_n)])
        forces[stands] = self._stands_n[stands]
        return self._volume.field(forces)

    def notes(self) -> tuple[str, ...]:
        return _drift(self._residuals_m)


class _Fused:
    """A world of all frames; what moves in it follows them."""

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes) -> None:
        self._planes = planes
        self._volume = FusedVolume(grid, profile, step_per_m)
        self._residuals_m: list[float | None] = []
        for i in range(len(planes)):
            self._volume.cover(*planes[i])
            planes.report(i + 1, 2 * len(planes))
        for i in range(len(planes)):
            self._residuals_m.append(self._volume.integrate(*planes[i]))
            planes.report(len(planes) + i + 1, 2 * len(planes))
        self._forces_n = self._volume.forces_n()
        self._still = self._volume.field(self._forces_n)
        self._moving = self._found_moving()
        self._rows = np.flatnonzero(self._moving.any(axis=1))
        self._asked = grid, profile, step_per_m
        self._begin()

    def _begin(self) -> None:
        """The moving bricks before the first frame."""
        self._part, self._seen = FusedVolume(*self._asked), 0
        self._part.add(self._volume.bricks[self._rows])

    def _found_moving(self) -> NDArray[np.bool_]:
        """What lies at and behind the patches that changed, in any frame, bool [bricks, 512]."""
        changed = self._volume.samples.changes > 0
        moving = np.zeros(changed.shape, np.bool_)
        if changed.any():
            for i in range(len(self._planes)):
                self._volume.mark(*self._planes[i], changed, _patches, moving)
        return moving

    def field(self, seen: int) -> ForceField:
        """What stands, and what moves as the first `seen` frames tell."""
        if not len(self._rows):
            return self._still
        if seen < self._seen:
            self._begin()
        for i in range(self._seen, seen):
            self._part.integrate(*self._planes[i])
        self._seen = seen
        forces = self._forces_n.copy()
        moving = self._moving[self._rows].reshape(-1, 8, 8, 8, 1)
        forces[self._rows] = np.where(moving, self._part.forces_n(), forces[self._rows])
        return self._volume.field(forces)

    def notes(self) -> tuple[str, ...]:
        found = _drift(self._residuals_m)
        if not len(self._rows):
            return found
        held = self._forces_n.any(axis=-1).reshape(-1, 512)
        share = float((self._moving & held).sum()) / max(1, int(held.sum()))
        return (*found, f"{100 * share:.2g} % of the world moves, and follows the frames; the rest stands")


def _patches(seen: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Of the pixels that see a change, uint8 [height, width], those in patches wider than a pose is off."""
    from scipy.ndimage import maximum_filter, uniform_filter

    size = max(3, round(PATCH_SHARE * seen.shape[0]))
    dense = uniform_filter(seen.astype(np.float32), size, mode="constant") >= PATCH_DENSITY
    patches: NDArray[np.uint8] = maximum_filter(dense.astype(np.uint8), size, mode="constant")
    return patches


def _told(sequence: DepthSequence, world: str) -> str:
    of = "" if sequence.poses is not None else "; no poses, so the camera is taken to stand"
    seen = "all frames" if world == "fused" else "what was seen so far"
    return f"The world is fused from {seen} (--world {world}{of})"


def _drift(residuals_m: list[float | None]) -> tuple[str, ...]:
    """A note where what the last frames see lies farther and farther from what was known."""
    known = [r for r in residuals_m if r is not None]
    quarter = len(known) // 4
    if quarter < 2:
        return ()
    begin, end = float(np.mean(known[:quarter])), float(np.mean(known[-quarter:]))
    if end < DRIFT_TIMES * begin or end < 2e-3:
        return ()
    told = f"{1e3 * begin:.2g} mm in the first quarter of the frames and {1e3 * end:.2g} mm in the last"
    return (f"The poses seem to drift: surfaces miss those known by {told}; --world frames does without",)


def stands(sequence: DepthSequence) -> bool:
    """True if a camera without poses sees the same picture in the first frame as in some others.

    Raises
    ------
    SourceError
        If a frame cannot be read.
    """
    keys = np.asarray(sequence.key_frames())
    first = sequence.depth_m(0)
    step_per_m = noise_step_per_m(first)
    for key in keys[np.unique(np.linspace(0, len(keys) - 1, 5).astype(int))[1:]]:
        other = sequence.depth_m(int(key))
        both = (first > 0) & (other > 0)
        w, v = (np.divide(1.0, z, out=np.zeros_like(z), where=both) for z in (first, other))
        if not both.any() or float((np.abs(w - v)[both] <= 2 * step_per_m).mean()) < STANDS_SHARE:
            return False
    return True

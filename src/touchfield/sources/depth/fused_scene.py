"""A depth sequence as a world that stands still: the fused field of all frames, or of those seen so far.

    fused    The medium is computed ahead, and so is its world: every frame knows what all frames saw, and what stands
             does not tremble. Where a frame sees whole patches of samples that changed, what lies at and
             behind its surface there is *moving* and follows the frames, as in a causal world. Narrower
             changes are noise, or a pose that is a little off at the edge of a thing.
    causal   A frame knows what was seen up to it: what a live sender can do. What stands is renewed eight times a
             second, and not shaken by every look; bricks in which something changes follow every frame.

The fused volume (`FusedVolume`) is the mean of what posed depth maps tell each sample (Curless and Levoy
1996, KinectFusion 2011), in bricks that a surface passes. A view says of a sample how far it lies from the
tangent plane of its pixel (phi, negative behind), which is nearer to the truth than the distance along the
ray (docs/decisions/0013). With the surface's *neighbourhood* |phi| <= 2 noise(z), at least a sample wide,
three things can be said:

near   |phi| is within it: the mean of phi and of the plane's normal moves, weighted by 1 / noise^2 and by the
       squared cosine between ray and normal.
guess  the sample lies behind it, as far as the wall reaches: nobody has seen that it is solid. It counts the less the
       farther behind, gives way to a surface seen near the sample, and does not return once rays have passed.
free   the ray passed in front. Two in a row carve what stood there.

A surface carved, a surface in known free space, and one that shifts by more than its neighbourhood count as
*changes* of the sample; its mean begins anew. Behind a surface in formerly free space the guess is allowed
again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from threading import Lock
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.errors import require_one_of
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import require_memory
from touchfield.sources.camera import noise_step_per_m, require_frame
from touchfield.sources.depth.depth_scene import RAY_LIMIT, DepthScene, force_bricks, query_of
from touchfield.sources.depth.kernels import fusion as kernels
from touchfield.sources.depth.kernels.fusion import Rules, Samples, View

if TYPE_CHECKING:
    from touchfield.sources.camera import DepthSequence
    from touchfield.sources.depth.kernels.planes import SurfacePlanes
    from touchfield.sources.laws import ForceProfile


WORLDS: Final = ("fused", "causal")

# of a causal world, measured in docs/decisions/0013:
FIRST_LOOK: Final = (
    16.0  # what the first look at a surface counts: a seventh fewer samples then change with a frame
)
RENEWALS_HZ: Final = (
    8.0  # so often what stands is shown anew: a third of the bytes go, and most steps a hand feels
)
CHANGING: Final = (
    8  # a brick of 512 samples follows every frame once so many of them changed: an eighth of a plane
)

PATCH_SHARE: Final = (
    1 / 12
)  # of the picture's height: what moves is a patch so wide; a pose off makes narrow seams
PATCH_DENSITY: Final = 0.7  # of the pixels of a patch, so many see a sample that changed
STANDS_SHARE: Final = 0.7  # of the pixels seen in two frames, so many agree if a camera without poses stands
DRIFT_TIMES: Final = 2.0  # poses drift if the residual of the last quarter is so many times that of the first
SLACK: Final = (
    3.0  # a neighbourhood is at least so many mean residuals of a view: poses are off more than the sensor
)
OFF_TIMES: Final = 1.5  # a view is off whose residual is so many times the median of those so far
_BYTES_PER_BRICK = 512 * (5 * 4 + 4)
_KEPT_PLANES_BYTES = 256 << 20
_KEPT_WORLDS = 16  # an array asks for its depth in slabs


class FusedVolume:
    """All that a depth sequence has told the samples of a lattice so far, in bricks int32 [n, 3] as they were
    added.

    `step_per_m` is the noise of the sensor, of inverse depth; the first look at a surface counts `first`
    times: above 1, what is felt early moves less while the mean settles. `residuals_m` are the mean residuals
    of the views.
    """

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, first: float = 1.0) -> None:
        self.grid, self.profile = grid, profile
        self.bricks = np.empty((0, 3), np.int32)
        self._slots = np.full(grid.brick_shape, -1, np.int32)
        self._samples = kernels.no_samples(64)
        self.residuals_m: list[float] = []
        least = max(float(np.mean(grid.spacing_m)), profile.high_m)
        behind = min(max(-profile.low_m, 0.0), float(np.ptp(grid.box_m, axis=0).sum()))
        self._rules = Rules(*(np.float32(x) for x in (step_per_m, least, behind, RAY_LIMIT, first)))

    @property
    def samples(self) -> Samples:
        """The memory of the samples of `bricks`."""
        return self._samples.first(len(self.bricks))

    def cover(self, surface: SurfacePlanes, pose: Float64s) -> None:
        """Have bricks wherever this view's surface may push."""
        bricks = force_bricks(query_of(surface, pose, self.grid, self.profile), self.grid)
        self.add(bricks[self._slots[tuple(bricks.T)] < 0])

    def add(self, bricks: Int32s) -> None:
        """Have these bricks, int32 [n, 3], none of which the volume has, if there is memory for them."""
        count = len(self.bricks) + len(bricks)
        if count > len(self._samples.weight):
            room = max(count, len(self._samples.weight) * 3 // 2)
            require_memory("fused volume", f"{room} bricks", room * _BYTES_PER_BRICK)
            grown = kernels.no_samples(room)
            grown.first(len(self.bricks)).take(self.samples)
            self._samples = grown
        self._slots[tuple(bricks.T)] = np.arange(len(self.bricks), count)
        self.bricks = np.concatenate([self.bricks, bricks])

    def integrate(self, surface: SurfacePlanes, pose: Float64s) -> None:
        """Tell the samples what a view says, its pose being scene from camera, float64 [4, 4].

        A view that misses what was known by much more than those before it (a pose that is off) tells of no
        changes.
        """
        of, before = self.samples, None
        view, residual_m = self._view(surface, pose, (of.near == 0) & (of.free == kernels.CLEAR))
        if residual_m is not None:
            self.residuals_m.append(residual_m)
            if residual_m > OFF_TIMES * float(np.median(self.residuals_m)):
                before = of.changes.copy()
        least = max(self._rules.least_m, np.float32(SLACK * (residual_m or 0.0)))
        kernels.integrate(self.bricks, view, self._rules._replace(least_m=least), of)
        if before is not None:
            of.changes[...] = before

    def mark_patches(self, surface: SurfacePlanes, pose: Float64s, changed: Bools, out: Bools) -> None:
        """Set in `out` what lies at and behind patches of this view that see samples of `changed`, bool [n,
        512].

        Patches are wider than a pose is off.
        """
        from scipy.ndimage import maximum_filter, uniform_filter

        view, _ = self._view(surface, pose, changed)
        sees = view.marked[:-1].reshape(surface.size_px)
        size = max(3, round(PATCH_SHARE * surface.size_px[0]))
        dense = uniform_filter(sees.astype(np.float32), size, mode="constant") >= PATCH_DENSITY
        sees[...] = maximum_filter(dense.astype(np.uint8), size, mode="constant")
        if sees.any():
            kernels.mark(self.bricks, view, self._rules, out)

    def forces_n(self) -> Float32s:
        """The forces of what is known, newtons, float32 [n, 8, 8, 8, 3], in the order of `bricks`."""
        pieces = self.profile.table().astype(np.float32)
        return kernels.brick_forces(self.samples, pieces, self.grid.shape, self.bricks)

    def field(self, forces_n: Float32s) -> ForceField:
        """The force field of these forces of `bricks`."""
        order = np.lexsort(self.bricks.T[::-1])
        order = order[np.asarray(forces_n.any(axis=(1, 2, 3, 4)))[order]]
        return ForceField(self.grid, self.bricks[order], forces_n[order])

    def _view(self, surface: SurfacePlanes, pose: Float64s, wanted: Bools) -> tuple[View, float | None]:
        """The view, its pixels marked whose surface lies at a sample of `wanted`; its residual, metres."""
        from scipy.ndimage import maximum_filter

        query = query_of(surface, pose, self.grid, self.profile)
        nearest_per_m = np.asarray(maximum_filter(surface.tiles[..., 0], 3), np.float32)
        view = View(query, np.empty(len(surface.planes) // 4, np.uint8), nearest_per_m)
        return view, kernels.surfaces_in(view, self._slots, self._samples, wanted)


class FusedScene(DepthScene):
    """A depth sequence, with poses or of a camera that stands, as one world, "fused" or "causal"."""

    def __init__(self, sequence: DepthSequence, world: str = "fused", segment: str | None = None) -> None:
        require_one_of("world", world, WORLDS)
        super().__init__(sequence, "world", segment)
        self.world = world
        of = "" if sequence.poses is not None else "; no poses, so the camera is taken to stand"
        seen = "all frames" if world == "fused" else "what was seen so far"
        self.notes = (*self.notes, f"The world is fused from {seen} (--world {world}{of})")
        self.take(0, self.frame_count)
        self._lock = Lock()

    def take(self, start: int, stop: int) -> None:
        """See `Scene.take`: the world is fused from these frames."""
        keys = [key for key in self.sequence.key_frames() if start <= key < stop] or [start]
        self._planes = _Planes(self, np.asarray(keys))
        self._worlds: dict[tuple[Grid, ForceProfile], _World] = {}

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """The force field of one frame at the points of `grid`; the same object where nothing moves.

        Every lattice and law that is asked for first goes through all frames (a causal world: through those
        up to `frame`).
        """
        require_frame(frame, self.frame_count)
        with self._lock:
            world = self._worlds.get((grid, profile))
            if world is None:
                kind = _Fused if self.world == "fused" else _Causal
                world = kind(grid, profile, self._noise_step_per_m(), self._planes)
                while len(self._worlds) >= _KEPT_WORLDS:
                    del self._worlds[next(iter(self._worlds))]
                self._worlds[grid, profile] = world
            return world.field(max(1, int(np.searchsorted(self._planes.keys, frame, side="right"))))

    def learnt(self) -> tuple[str, ...]:
        """See `Scene.learnt`: what moves, and whether the poses drift."""
        return tuple(dict.fromkeys(note for world in self._worlds.values() for note in world.notes()))


class _Planes:
    """The planes and poses of the key frames by number, kept as far as memory is small."""

    def __init__(self, scene: DepthScene, keys: Int64s) -> None:
        self.scene, self.keys = scene, keys
        self._kept: dict[int, SurfacePlanes] = {}
        of = scene.sequence
        self._room = 0 if of.is_captured else _KEPT_PLANES_BYTES // (16 * of.width * of.height)

    def __getitem__(self, i: int) -> tuple[SurfacePlanes, Float64s]:
        frame = int(self.keys[i])
        planes = self._kept.get(i) or self.scene.planes(frame)
        if len(self._kept) < self._room:
            self._kept[i] = planes
        return planes, self.scene.pose(frame)


class _World(ABC):
    """A world on one lattice, after the first key frames."""

    _volume: FusedVolume

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes) -> None:
        self._planes, self._asked, self._seen = planes, (grid, profile, step_per_m), 0
        self._begin()

    @abstractmethod
    def _begin(self) -> None:
        """Nothing seen yet."""

    @abstractmethod
    def field(self, seen: int) -> ForceField:
        """The world as the first `seen` frames tell."""

    def notes(self) -> tuple[str, ...]:
        """A note where what the last frames see lies farther and farther from what was known."""
        known = self._volume.residuals_m
        quarter = len(known) // 4
        if quarter < 2:
            return ()
        begin, end = float(np.mean(known[:quarter])), float(np.mean(known[-quarter:]))
        if end < DRIFT_TIMES * begin or end < 2e-3:
            return ()
        growth = f"{1e3 * begin:.2g} mm in the first quarter of the frames and {1e3 * end:.2g} mm in the last"
        return (
            f"The poses seem to drift: surfaces miss those known by {growth}; --world frames does without",
        )


class _Causal(_World):
    """A world of what was seen so far."""

    def _begin(self) -> None:
        frames = max(1, round(self._planes.scene.rate_hz / RENEWALS_HZ))
        keys = self._planes.keys
        self._renewals = np.asarray(np.diff((keys - keys[0]) // frames, prepend=-1) > 0)
        self._volume = FusedVolume(*self._asked, FIRST_LOOK)
        self._stands_n = self._volume.forces_n()
        self._latest = self._stands = self._volume.field(self._stands_n)

    def field(self, seen: int) -> ForceField:
        """The world of the first `seen` frames where something changes, of those up to the renewal elsewhere."""
        if seen == self._seen:
            return self._latest
        if seen < self._seen:
            self._seen = 0
            self._begin()
        volume = self._volume
        for i in range(self._seen, seen):
            volume.cover(*self._planes[i])
            volume.integrate(*self._planes[i])
            if self._renewals[i]:
                self._stands_n = volume.forces_n()
                self._stands = volume.field(self._stands_n)
        self._seen, self._latest = seen, self._stands
        follows = np.count_nonzero(volume.samples.changes, axis=1) >= CHANGING
        if not self._renewals[seen - 1] and follows.any():
            forces = volume.forces_n()
            forces[~follows] = 0.0
            stands = np.flatnonzero(~follows[: len(self._stands_n)])
            forces[stands] = self._stands_n[stands]
            self._latest = volume.field(forces)
        return self._latest


class _Fused(_World):
    """A world of all frames; what moves in it follows them."""

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes) -> None:
        self._volume, count = FusedVolume(grid, profile, step_per_m), len(planes.keys)
        for i in range(count):
            self._volume.cover(*planes[i])
            planes.scene.report(i + 1, 2 * count)
        for i in range(count):
            self._volume.integrate(*planes[i])
            planes.scene.report(count + i + 1, 2 * count)
        self._forces_n = self._volume.forces_n()
        self._still = self._volume.field(self._forces_n)
        changed = self._volume.samples.changes > 0
        self._moving = np.zeros(changed.shape, np.bool_)
        for i in range(count if changed.any() else 0):
            self._volume.mark_patches(*planes[i], changed, self._moving)
        self._rows = np.flatnonzero(self._moving.any(axis=1))
        super().__init__(grid, profile, step_per_m, planes)

    def _begin(self) -> None:
        self._part = FusedVolume(*self._asked)
        self._part.add(self._volume.bricks[self._rows])

    def field(self, seen: int) -> ForceField:
        """The world: it stands, but for what moves as the first `seen` frames tell."""
        if not len(self._rows):
            return self._still
        if seen < self._seen:
            self._seen = 0
            self._begin()
        for i in range(self._seen, seen):
            self._part.integrate(*self._planes[i])
        self._seen = seen
        forces = self._forces_n.copy()
        moving = self._moving[self._rows].reshape(-1, 8, 8, 8, 1)
        forces[self._rows] = np.where(moving, self._part.forces_n(), forces[self._rows])
        return self._volume.field(forces)

    def notes(self) -> tuple[str, ...]:
        if not len(self._rows):
            return super().notes()
        pushes = self._forces_n.any(axis=-1).reshape(-1, 512)
        share = float((self._moving & pushes).sum()) / max(1, int(pushes.sum()))
        return (
            *super().notes(),
            f"{100 * share:.2g} % of the world moves, and follows the frames; the rest stands",
        )


def stands(sequence: DepthSequence) -> bool:
    """True if a camera without poses sees the same picture in the first frame as in some others."""
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

"""`FusedScene`: fuses the depth images of a sequence into one world, so that static surfaces do not flicker.
It uses all frames, or only those so far.

    fused    Computed offline: every frame uses the observations of all frames, so that static surfaces do not
             flicker. Where a frame sees whole patches of samples that changed, the samples at and behind its
             surface there are *moving* and follow the frames, as in a causal world. Narrower changes are
             noise, or a pose error at the edge of an object.
    causal   A frame uses the observations up to it, as a live sender must. Static parts are renewed eight
             times a second instead of with every view; bricks in which something changes follow every frame.

The fused volume (`FusedVolume`) is the mean of the observations of posed depth maps in each sample (Curless
and Levoy 1996, KinectFusion 2011), in bricks that contain a surface. A view measures the distance of a sample
to the tangent plane of its pixel (phi, negative behind), which is more accurate than the distance along the
ray (docs/decisions/0013). The *neighbourhood* of the surface is |phi| <= max(2 noise(z), one sample). A view
classifies each sample as one of three:

near   |phi| is within the neighbourhood: the means of phi and of the plane's normal are updated, weighted by
       1 / noise^2 and by the squared cosine between ray and normal.
guess  The sample lies behind the surface, within the depth of the wall, but was not seen to be solid. The
       weight decreases with the distance behind. A surface near the sample replaces a guess, and no guess is
       made again once rays have passed.
free   The ray passed in front of the surface. Two such views in a row carve the surface.

A carved surface, a surface in known free space, and one that shifts by more than its neighbourhood count as
*changes* of the sample, and its mean is restarted. Behind a surface in formerly free space the guess is
allowed again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from threading import Lock
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Bools, Float32s, Float64s, Int32s, Int64s
from touchfield.compute.threads import Progress
from touchfield.errors import require_one_of
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import require_memory
from touchfield.medium.updates import FieldUpdate
from touchfield.sources.camera import noise_step_per_m, require_frame
from touchfield.sources.depth.depth_scene import RAY_LIMIT, DepthScene, force_bricks, query_of
from touchfield.sources.depth.kernels import fusion as kernels
from touchfield.sources.depth.kernels.field import nodes_in_view
from touchfield.sources.depth.kernels.fusion import Rules, Samples, View

if TYPE_CHECKING:
    from touchfield.sources.camera import DepthSequence
    from touchfield.sources.depth.kernels.field import Query
    from touchfield.sources.depth.kernels.planes import SurfacePlanes
    from touchfield.sources.laws import ForceProfile


WORLDS: Final = ("fused", "causal")

# constants of a causal world, measured in docs/decisions/0013
FIRST_WEIGHT: Final = 16.0
"""Weight of the first observation of a surface: a seventh fewer samples change between frames than with 1.
"""
RENEWALS_HZ: Final = 8.0
"""Rate at which static parts are updated; it saves a third of the bytes and most steps above the mask."""
CHANGED_SAMPLES: Final = 8
"""A brick (512 samples) follows every frame once this many of its samples changed: an eighth of a plane."""

PATCH_FRACTION: Final = 1 / 12
"""Width of a moving patch as a fraction of the picture's height; seams of pose errors are narrower.
"""
PATCH_DENSITY: Final = 0.7  # fraction of the pixels of a patch that see a changed sample
STATIC_FRACTION: Final = 0.7  # minimum fraction of pixels that agree between two frames of a static camera
DRIFT_FACTOR: Final = 2.0  # poses drift if the residual of the last quarter is this many times the first's
RESIDUAL_FACTOR: Final = 3.0
"""A neighbourhood is at least this many mean residuals of a view: pose errors exceed those of the sensor."""
OUTLIER_FACTOR: Final = 1.5  # a view is an outlier if its residual is this many times the median so far
_BLOCK = 4  # bricks along each edge of a block
_BYTES_PER_BRICK = 512 * (5 * 4 + 4)
_MAX_PLANES_BYTES = 256 << 20
_MAX_WORLDS = 16  # the depth of an actuator array is requested in slabs, each with its own grid


class FusedVolume:
    """Fused observations of the samples of a lattice.

    `step_per_m` is the noise of the sensor in inverse depth. `first_weight` is the weight of the first
    observation of a surface: a weight above 1 makes forces vary less while the mean settles. `residuals_m`
    are the mean residuals of the views.
    """

    def __init__(
        self, grid: Grid, profile: ForceProfile, step_per_m: float, first_weight: float = 1.0
    ) -> None:
        self.grid, self.profile = grid, profile
        self._count, self._bricks = 0, np.empty((64, 3), np.int32)
        blocks = tuple(-(-count // _BLOCK) for count in grid.brick_shape)
        self._slots = np.full(tuple(_BLOCK * count for count in blocks), -1, np.int32)
        self._is_block, self._blocks = np.zeros(blocks, np.bool_), np.empty((0, 3), np.int32)
        self._samples = kernels.empty_samples(64)
        self.residuals_m: list[float] = []
        min_near_m = max(float(np.mean(grid.spacing_m)), profile.high_m)
        wall_depth_m = min(max(-profile.low_m, 0.0), float(np.ptp(grid.box_m, axis=0).sum()))
        self._rules = Rules(
            *(np.float32(x) for x in (step_per_m, min_near_m, wall_depth_m, RAY_LIMIT, first_weight))
        )

    @property
    def bricks(self) -> Int32s:
        """The bricks in the order in which they were added, int32 [n, 3]."""
        return self._bricks[: self._count]

    @property
    def samples(self) -> Samples:
        """The state of the samples of `bricks`."""
        return self._samples.first(self._count)

    def cover(self, surface: SurfacePlanes, pose: Float64s) -> None:
        """Add bricks wherever the surface of this view may exert a force."""
        bricks = force_bricks(query_of(surface, pose, self.grid, self.profile), self.grid)
        self.add(bricks[self._slots[tuple(bricks.T)] < 0])

    def add(self, bricks: Int32s) -> None:
        """Add bricks, int32 [n, 3], that the volume does not have yet.

        Raises `InvalidArgument` if they would exceed the memory budget.
        """
        count = self._count + len(bricks)
        if count > len(self._bricks):
            self._grow(max(count, len(self._bricks) * 3 // 2))
        self._slots[tuple(bricks.T)] = np.arange(self._count, count)
        self._bricks[self._count : count] = bricks
        self._count = count
        blocks = bricks // _BLOCK
        blocks = np.unique(blocks[~self._is_block[tuple(blocks.T)]], axis=0)
        if len(blocks):
            self._is_block[tuple(blocks.T)] = True
            self._blocks = np.concatenate([self._blocks, blocks])

    def _grow(self, capacity: int) -> None:
        require_memory("fused volume", f"{capacity} bricks", capacity * _BYTES_PER_BRICK)
        samples, bricks = kernels.empty_samples(capacity), np.empty((capacity, 3), np.int32)
        samples.first(self._count).copy_from(self.samples)
        bricks[: self._count] = self.bricks
        self._samples, self._bricks = samples, bricks

    def rows_in_view(self, query: Query) -> Int64s:
        """Return the indices of the bricks that the camera may see, int64 [m], ascending.

        Blocks are tested before their bricks, so that the cost follows the bricks in view.
        """
        x, y, z = self._blocks[nodes_in_view(self._blocks, _BLOCK, query)].T
        bx, by, bz = self._is_block.shape
        slots = self._slots.reshape(bx, _BLOCK, by, _BLOCK, bz, _BLOCK)[x, :, y, :, z]
        rows = np.sort(slots[slots >= 0]).astype(np.int64)
        return rows[nodes_in_view(self.bricks[rows], 1, query)]

    def integrate(self, surface: SurfacePlanes, pose: Float64s) -> None:
        """Update the samples with a view; `pose` is scene from camera, float64 [4, 4].

        The cost follows the bricks in view, not those of the volume. A view whose residual is far above that
        of the views before it, which indicates a pose error, marks no changes.
        """
        samples, changes = self.samples, None
        query = query_of(surface, pose, self.grid, self.profile)
        rows = self.rows_in_view(query)
        is_free = np.zeros(samples.free.shape, np.bool_)
        is_free[rows] = (samples.has_surface[rows] == 0) & (samples.free[rows] == kernels.CLEAR)
        view, residual_m = self._view(query, is_free)
        if residual_m is not None:
            self.residuals_m.append(residual_m)
            if residual_m > OUTLIER_FACTOR * float(np.median(self.residuals_m)):
                changes = samples.changes[rows]
        min_near_m = max(self._rules.min_near_m, np.float32(RESIDUAL_FACTOR * (residual_m or 0.0)))
        kernels.integrate(rows, self.bricks, view, self._rules._replace(min_near_m=min_near_m), samples)
        if changes is not None:
            samples.changes[rows] = changes

    def mark_patches(self, surface: SurfacePlanes, pose: Float64s, is_changed: Bools, out: Bools) -> None:
        """Mark the samples at and behind patches of this view that see changed samples.

        They are set to True in `out`.

        `is_changed` and `out` are bool [n, 512]. Patches are wider than pose errors.
        """
        from scipy.ndimage import maximum_filter, uniform_filter

        query = query_of(surface, pose, self.grid, self.profile)
        view, _ = self._view(query, is_changed)
        is_marked = view.marked[:-1].reshape(surface.size_px)
        size = max(3, round(PATCH_FRACTION * surface.size_px[0]))
        is_dense = uniform_filter(is_marked.astype(np.float32), size, mode="constant") >= PATCH_DENSITY
        is_marked[...] = maximum_filter(is_dense.astype(np.uint8), size, mode="constant")
        if is_marked.any():
            kernels.mark(self.rows_in_view(query), self.bricks, view, self._rules, out)

    def forces_n(self, rows: Int64s | None = None) -> Float32s:
        """Return the forces of the bricks `rows`, newtons, float32 [n, 8, 8, 8, 3]; by default of all."""
        pieces = self.profile.table().astype(np.float32)
        samples, bricks = self.samples, self.bricks
        if rows is not None:
            samples, bricks = samples.rows(rows), bricks[rows]
        return kernels.brick_forces(samples, pieces, self.grid.shape, bricks)

    def field(self, forces_n: Float32s, rows: Int64s | None = None) -> ForceField:
        """Return the force field with these forces of the bricks `rows`; by default of all."""
        bricks = self.bricks if rows is None else self.bricks[rows]
        order = np.lexsort(bricks.T[::-1])
        order = order[np.asarray(forces_n.any(axis=(1, 2, 3, 4)))[order]]
        return ForceField(self.grid, bricks[order], forces_n[order])

    def _view(self, query: Query, is_selected: Bools) -> tuple[View, float | None]:
        """Return a view, with pixels at selected samples marked, and its residual, metres."""
        from scipy.ndimage import maximum_filter

        surface = query.surface
        nearest_per_m = np.asarray(maximum_filter(surface.tiles[..., 0], 3), np.float32)
        view = View(query, np.empty(len(surface.planes) // 4, np.uint8), nearest_per_m)
        return view, kernels.mark_surfaces(view, self._slots, self._samples, is_selected)


class FusedScene(DepthScene):
    """A depth sequence with poses, or of a static camera, as one world.

    `world` is "fused" or "causal" (see the module).
    """

    def __init__(self, sequence: DepthSequence, world: str = "fused", segment: str | None = None) -> None:
        require_one_of("world", world, WORLDS)
        super().__init__(sequence, "world", segment)
        self.world = world
        poses_note = "" if sequence.poses is not None else "; no poses, so the camera is assumed to be static"
        fused_frames = "all frames" if world == "fused" else "what was seen so far"
        self.notes = (*self.notes, f"The world is fused from {fused_frames} (--world {world}{poses_note})")
        self.restrict_frames(0, self.frame_count)
        self._lock = Lock()

    def restrict_frames(self, start: int, stop: int) -> None:
        """See `Scene.restrict_frames`: the world is fused from these frames."""
        keys = [key for key in self.sequence.key_frames() if start <= key < stop] or [start]
        self._planes = _Planes(self, np.asarray(keys))
        self._worlds: dict[tuple[Grid, ForceProfile], _World] = {}

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        """Return the force field of one frame at the points of `grid`.

        It is the same object if nothing moves.

        The first request for a lattice and profile processes all frames; in a causal world, the frames up to
        `frame`.
        """
        return self.field_update(frame, grid, profile).field

    def field_update(self, frame: int, grid: Grid, profile: ForceProfile) -> FieldUpdate:
        """See `Scene.field_update`: the base is the static world, and what moves replaces bricks of it."""
        require_frame(frame, self.frame_count)
        with self._lock:
            world = self._worlds.get((grid, profile))
            if world is None:
                step_per_m = self._noise_step_per_m()
                if self.world == "fused":
                    world = _Fused(grid, profile, step_per_m, self._planes, self.report)
                else:
                    world = _Causal(grid, profile, step_per_m, self._planes)
                while len(self._worlds) >= _MAX_WORLDS:
                    del self._worlds[next(iter(self._worlds))]
                self._worlds[grid, profile] = world
            return world.update(max(1, int(np.searchsorted(self._planes.keys, frame, side="right"))))

    def late_notes(self) -> tuple[str, ...]:
        """See `Scene.late_notes`: the moving fraction, and whether the poses drift."""
        return tuple(dict.fromkeys(note for world in self._worlds.values() for note in world.notes()))


class _Planes:
    """The planes and poses of the key frames by number, cached up to a memory limit."""

    def __init__(self, scene: DepthScene, keys: Int64s) -> None:
        self.scene, self.keys = scene, keys
        self._cache: dict[int, SurfacePlanes] = {}
        sequence = scene.sequence
        self._capacity = (
            0 if sequence.is_captured else _MAX_PLANES_BYTES // (16 * sequence.width * sequence.height)
        )

    def __getitem__(self, i: int) -> tuple[SurfacePlanes, Float64s]:
        frame = int(self.keys[i])
        planes = self._cache.get(i) or self.scene.planes(frame)
        if len(self._cache) < self._capacity:
            self._cache[i] = planes
        return planes, self.scene.pose(frame)


def _unchanged(field: ForceField) -> FieldUpdate:
    """Return the update that replaces nothing of a field."""
    return FieldUpdate(field, np.empty((0, 3), np.int32), ForceField.empty(field.grid))


class _World(ABC):
    """A world on one lattice after a number of key frames."""

    _volume: FusedVolume

    def __init__(self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes) -> None:
        self._planes, self._arguments, self._frame_count = planes, (grid, profile, step_per_m), 0
        self._reset()

    @abstractmethod
    def _reset(self) -> None:
        """Return to the state before the first frame."""

    @abstractmethod
    def update(self, frame_count: int) -> FieldUpdate:
        """Return the world after the first `frame_count` frames."""

    def notes(self) -> tuple[str, ...]:
        """Return a note if residuals grow, which indicates that the poses drift."""
        residuals_m = self._volume.residuals_m
        quarter = len(residuals_m) // 4
        if quarter < 2:
            return ()
        first_m, last_m = float(np.mean(residuals_m[:quarter])), float(np.mean(residuals_m[-quarter:]))
        if last_m < DRIFT_FACTOR * first_m or last_m < 2e-3:
            return ()
        growth = (
            f"{1e3 * first_m:.2g} mm in the first quarter of the frames and {1e3 * last_m:.2g} mm in the last"
        )
        return (
            f"The poses seem to drift: surfaces miss those known by {growth}; --world frames does without",
        )


class _Causal(_World):
    """A world of the frames so far."""

    def _reset(self) -> None:
        period = max(1, round(self._planes.scene.rate_hz / RENEWALS_HZ))
        keys = self._planes.keys
        self._renewals = np.asarray(np.diff((keys - keys[0]) // period, prepend=-1) > 0)
        self._volume = FusedVolume(*self._arguments, FIRST_WEIGHT)
        self._latest = self._static = self._all()

    def _all(self) -> FieldUpdate:
        """Return the world as it is now; nothing is replaced."""
        volume = self._volume
        return _unchanged(volume.field(volume.forces_n()))

    def update(self, frame_count: int) -> FieldUpdate:
        """Return the world after `frame_count` frames, renewed where it changes."""
        if frame_count == self._frame_count:
            return self._latest
        if frame_count < self._frame_count:
            self._frame_count = 0
            self._reset()
        volume, first = self._volume, self._frame_count
        if self._planes.scene.sequence.is_captured:  # the pictures of frames that are left out are gone
            first = frame_count - 1
        for i in range(first, frame_count):
            volume.cover(*self._planes[i])
            volume.integrate(*self._planes[i])
            if self._renewals[self._frame_count : i + 1].any():
                self._static = self._all()
            self._frame_count = i + 1
        self._latest = self._static
        following = np.flatnonzero(np.count_nonzero(volume.samples.changes, axis=1) >= CHANGED_SAMPLES)
        if not self._renewals[frame_count - 1] and len(following):
            part = volume.field(volume.forces_n(following), following)
            self._latest = FieldUpdate(self._static.base, volume.bricks[following], part)
        return self._latest


class _Fused(_World):
    """A world of all frames; its moving parts follow them."""

    def __init__(
        self, grid: Grid, profile: ForceProfile, step_per_m: float, planes: _Planes, report: Progress
    ) -> None:
        self._volume, count = FusedVolume(grid, profile, step_per_m), len(planes.keys)
        for i in range(count):
            self._volume.cover(*planes[i])
            report(i + 1, 2 * count)
        for i in range(count):
            self._volume.integrate(*planes[i])
            report(count + i + 1, 2 * count)
        forces_n = self._volume.forces_n()
        self._static = _unchanged(self._volume.field(forces_n))
        is_changed = self._volume.samples.changes > 0
        self._is_moving = np.zeros(is_changed.shape, np.bool_)
        for i in range(count if is_changed.any() else 0):
            self._volume.mark_patches(*planes[i], is_changed, self._is_moving)
        self._rows = np.flatnonzero(self._is_moving.any(axis=1))
        self._moving_forces_n = forces_n[self._rows]
        super().__init__(grid, profile, step_per_m, planes)

    def _reset(self) -> None:
        self._part = FusedVolume(*self._arguments)
        self._part.add(self._volume.bricks[self._rows])

    def update(self, frame_count: int) -> FieldUpdate:
        """Return the static world with its moving parts after the first `frame_count` frames."""
        if not len(self._rows):
            return self._static
        if frame_count < self._frame_count:
            self._frame_count = 0
            self._reset()
        for i in range(self._frame_count, frame_count):
            self._part.integrate(*self._planes[i])
        self._frame_count = frame_count
        is_moving = self._is_moving[self._rows].reshape(-1, 8, 8, 8, 1)
        forces_n = np.where(is_moving, self._part.forces_n(), self._moving_forces_n)
        return FieldUpdate(self._static.base, self._part.bricks, self._part.field(forces_n))

    def notes(self) -> tuple[str, ...]:
        if not len(self._rows):
            return super().notes()
        is_moving = self._is_moving[self._rows] & self._moving_forces_n.any(axis=-1).reshape(-1, 512)
        fraction = np.count_nonzero(is_moving) / max(1, self._static.base.support_count)
        if self._planes.scene.sequence.has_wrong_poses:
            reason = "differs between the frames, since poses and depth disagree, and follows the frames"
        else:
            reason = "moves, and follows the frames; the rest is static"
        return (*super().notes(), f"{100 * fraction:.2g} % of the world {reason}")


def is_static(sequence: DepthSequence) -> bool:
    """Return True if a sequence without poses seems to be of a static camera.

    Its first frame and some others then show the same depth.
    """
    keys = np.asarray(sequence.key_frames())
    first = sequence.depth_m(0)
    step_per_m = noise_step_per_m(first)
    for key in keys[np.unique(np.linspace(0, len(keys) - 1, 5).astype(int))[1:]]:
        other = sequence.depth_m(int(key))
        is_known = (first > 0) & (other > 0)
        w, v = (np.divide(1.0, z, out=np.zeros_like(z), where=is_known) for z in (first, other))
        if not is_known.any() or float((np.abs(w - v)[is_known] <= 2 * step_per_m).mean()) < STATIC_FRACTION:
            return False
    return True

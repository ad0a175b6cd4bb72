"""`FieldSampler`: computes the force of a decoded medium at any point and time, for programs that need no
servo process.

The servo evaluates the same function at each tick. It is trilinear in space, zero outside, and exact at the
samples. Between two frames, a moving body is at the interpolated pose and a changing field is blended
linearly; at the frames the function is exact.
"""

from __future__ import annotations

import os
import sys
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from functools import cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.compute.native import native
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_not_negative
from touchfield.medium.field import numbers_of
from touchfield.medium.medium import HapticScene
from touchfield.render.block import Memory, layout
from touchfield.render.block.frames import FieldName, FrameParts, field_bytes, write_fields

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from touchfield.medium import HapticMedium
    from touchfield.medium.cells import CellPool
    from touchfield.medium.deformation import Deformation


_CHUNK_POINTS: Final = 8192
_UNBOUNDED: Final = sys.float_info.max
_EMPTY_INTERVAL: Final = (1.0, -1.0, 0.0)
_FIRST_OFFSET: Final = 64  # offset 0 means "none", so that the first bytes stay unused
_AT_FRAME: Final = 1e-9  # TOUCH_AT_FRAME of c/touch_query.h: times this near to a frame are that frame's


class FieldSampler:
    """The force at a point and a time.

    Frame i is at i / rate_hz. Before the first and after the last frame, the field is that of the first or
    the last. Only one thread may use a sampler at a time; a batch itself runs on all cores.

    `memory_bytes` bounds the cache of fields. A block of two frames for `at`, one that is prepared for it and
    one for all other queries take up to as much each. A `deformation` bends a medium of voxels by its tracks.
    A query raises `InvalidArgument` if a time is not finite, shapes do not match, or two frames do not fit
    into the memory.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        memory_bytes: int = 256 << 20,
        deformation: Deformation | None = None,
    ) -> None:
        self._parts = FrameParts(medium, deformation)
        self._pairs = Pairs(self._parts, memory_bytes)
        self._has_voxels = not isinstance(medium, HapticScene) and deformation is None
        self._rate_hz = self._parts.rate_hz
        self._latest: Pair | None = None
        # memory and frames for which `at` is prepared; the interval, in frames, and its first frame
        self._buffer, self._first, self._second = memoryview(b""), 0, 0
        self._low, self._high, self._base = _EMPTY_INTERVAL

    def force_n(self, time_s: ArrayLike, points_m: ArrayLike) -> Float32s:
        """Return the force, newtons, float32 [..., 3], at points float [..., 3], metres.

        The force at a point that is not finite is zero. `time_s`, seconds, is one time for all points or one
        for each point.
        """
        times = numbers_of("time_s", time_s)
        if not times.ndim and self._has_voxels:
            return self._voxel_forces_n(float(times), _points(points_m, np.float32))
        return self._evaluate(native.forces_at, times, points_m, 3, np.float32)

    def gradient_n_per_m(self, time_s: ArrayLike, points_m: ArrayLike) -> Float64s:
        """Return dF_i/dx_j, N/m, float64 [..., 3, 3]: derivative of the interpolated force.

        It is zero where there can be no force. On a plane of the lattice it is the derivative towards greater
        indices.
        """
        rows: Float64s = self._evaluate(native.gradients_at, time_s, points_m, 9, np.float64)
        return rows.reshape(*rows.shape[:-1], 3, 3)

    def vibration(self, time_s: ArrayLike, points_m: ArrayLike) -> tuple[Float32s, Float32s]:
        """Return amplitude, N, and frequency, Hz, of the vibration, each float32 [...].

        Both are zero where there is no vibration.
        """
        both: Float32s = self._evaluate(native.vibrations_at, time_s, points_m, 2, np.float32)
        return both[..., 0], both[..., 1]

    def at(self, time_s: float, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Return the force at one point, newtons, with as little overhead as possible.

        The following frames are prepared in the background, for times that increase like a clock.
        """
        force_n: tuple[float, float, float]
        try:
            position = time_s * self._rate_hz
            if not self._low <= position <= self._high:
                self._prepare(time_s)
            blend = position - self._base
            force_n = native.force_at(self._buffer, self._first, self._second, blend, x_m, y_m, z_m)
        except (TypeError, ValueError):
            arguments = time_s, x_m, y_m, z_m
            if all(type(argument) is float for argument in arguments):  # not an error of their types
                raise
            force_n = self.at(*numbers_of("time_s, x_m, y_m, z_m", arguments, shape=(4,)).tolist())
        return force_n

    def _prepare(self, time_s: float) -> None:
        """Prepare `at` for the frames around an instant."""
        a, _, _ = self._instant(time_s)
        b = min(a + 1, self._parts.frame_count - 1)
        self._low, self._high, self._base = _EMPTY_INTERVAL
        memory, first, second = self._pairs.take(a, b)[:3]
        self._pairs.prepare(b, b + 1)
        self._buffer, self._first, self._second = memory.bytes.data, first, second
        self._base = float(a)
        self._low = float(a) if a > 0 else -_UNBOUNDED
        self._high = float(b) if b < self._parts.frame_count - 1 else _UNBOUNDED

    def _instant(self, time_s: float) -> tuple[int, int, float]:
        """Return the two frames around an instant, and the blend between them."""
        firsts, blends = self._instants(time_s, ())
        a, blend = int(firsts[0]), float(blends[0])
        return a, a + (blend > 0.0), blend

    def _instants(self, time_s: ArrayLike, shape: tuple[int, ...]) -> tuple[Int64s, Float64s]:
        """Return first frames int64 [m] and blends [m] of one time, or of one time for each point."""
        times = numbers_of("time_s", time_s)
        if times.ndim and times.shape != shape:
            raise InvalidArgument("time_s", f"shape {times.shape}", f"one time, or {shape} as the points")
        with np.errstate(over="ignore"):
            positions = times.reshape(-1) * self._rate_hz
        if not np.isfinite(positions).all():
            raise InvalidArgument("time_s", "a time that is not finite", "finite numbers of seconds")
        positions = np.clip(positions, 0.0, self._parts.frame_count - 1.0)
        frames = (positions + _AT_FRAME).astype(np.int64)
        blends = positions - frames
        blends[blends <= _AT_FRAME] = 0.0
        return frames, blends

    def _pair(self, a: int, b: int) -> Pair:
        """Return two frames for all queries but `at`; the latest pair is cached."""
        if self._latest is None or self._latest.frames != (a, b):
            self._latest = self._pairs.take(a, b, self._latest)
        return self._latest

    def _voxel_forces_n(self, time_s: float, points: NDArray[Any]) -> Float32s:
        """Return the forces of one field, or of two blended ones, at many points of one instant."""
        a, b, blend = self._instant(time_s)
        pair = self._pair(a, b)
        out = np.empty(points.shape, np.float32)
        flat, forces = points.reshape(-1, 3), out.reshape(-1, 3)
        for n, (field, weight) in enumerate(pair.weighted_fields(blend)):
            arguments = (pair.memory.bytes, field, weight, n == 0, flat, forces)
            for_chunks(native.cell_forces, len(flat), *arguments, chunk=_CHUNK_POINTS)
        return out

    def _evaluate(
        self, function: Callable[..., None], time_s: ArrayLike, points_m: ArrayLike, columns: int, dtype: Any
    ) -> NDArray[Any]:
        """Call a batch function at all points, grouped by the pair of frames that they need."""
        points = _points(points_m)
        flat = points.reshape(-1, 3)
        out = np.empty((len(flat), columns), dtype)
        firsts, blends = self._instants(time_s, points.shape[:-1])
        groups: list[Any] = [slice(None)]
        if len(blends) != 1:
            order = np.argsort(firsts, kind="stable")
            groups = np.split(order, np.flatnonzero(np.diff(firsts[order])) + 1) if len(order) else []
        for group in groups:
            a, group_blends, result = int(firsts[group][0]), blends[group], out[group]
            memory, *frames = self._pair(a, a + bool(group_blends.any()))[:3]
            arguments = (memory.bytes, *frames, flat[group], group_blends, result)
            for_chunks(function, len(result), *arguments, chunk=_CHUNK_POINTS // 4)
            out[group] = result
        return out.reshape(*points.shape[:-1], columns)


def _points(points_m: ArrayLike, *accepted: type[np.float32]) -> NDArray[Any]:
    """Return points, contiguous: float64 or one of `accepted`."""
    dtype = np.float32 if getattr(points_m, "dtype", None) in accepted else np.float64
    points = np.ascontiguousarray(numbers_of("points_m", points_m, dtype))
    if points.ndim == 0 or points.shape[-1] != 3:
        raise InvalidArgument("points_m", f"shape {points.shape}", "points [..., 3] in metres")
    return points


class Pair(NamedTuple):
    """Two frames, possibly equal: their block, their offsets in it, and their fields."""

    memory: Memory
    first: int
    second: int
    frames: tuple[int, int]
    fields: dict[FieldName, int]

    def weighted_fields(self, blend: float) -> list[tuple[int, float]]:
        """Return offset and weight of the field of each frame, for frames of voxels."""
        weighted_frames = ((self.first, 1.0 - blend), (self.second, blend))[: 1 + (blend > 0.0)]
        return [(self._field_of(frame), weight) for frame, weight in weighted_frames]

    def _field_of(self, frame: int) -> int:
        """Return the offset of the field of a frame's only body."""
        return int(self.memory.view(layout.BODY_POSE, frame + layout.FRAME_HEADER.itemsize)["cells_offset"])


class Pairs:
    """Pairs (a, b) of frames, each in a block of its own, made on request or in advance.

    The cells of the latest fields are cached in `memory_bytes`, which is about twice the size of their
    bricks, and copied into the pairs that need them. One thread at a time makes frames, the caller's or one
    in the background.
    """

    def __init__(self, parts: FrameParts, memory_bytes: int) -> None:
        require_not_negative(memory_bytes=memory_bytes)
        self._parts, self._max_bytes = parts, int(memory_bytes)
        self._cells: dict[FieldName, CellPool] = {}  # least recently used first
        self._cached_bytes = 0  # size of all of them
        self._pending: Future[Pair] | None = None
        self._pending_frames = -1, -1

    def take(self, a: int, b: int, reusable: Pair | None = None) -> Pair:
        """Return the pair (a, b).

        It replaces the pair `reusable` in memory if that has all fields.

        `reusable` must not be used afterwards. Raises InvalidArgument if the pair does not fit into the
        memory.
        """
        pending, self._pending = self._pending, None
        if pending is not None and self._pending_frames == (a, b):
            return pending.result()
        if pending is not None and not pending.cancel():
            pending.exception()  # wait for it, so that only one thread makes frames
        return self._build(a, b, reusable)

    def prepare(self, a: int, b: int) -> None:
        """Make a pair in the background for the next `take`, which raises its errors."""
        if b < self._parts.frame_count:
            self._pending_frames, self._pending = (a, b), _pool().submit(self._build, a, b)

    def _build(self, a: int, b: int, reusable: Pair | None = None) -> Pair:
        names = dict.fromkeys(name for frame in (a, b) for name in self._parts.names(frame))
        first, second = _FIRST_OFFSET, _FIRST_OFFSET + self._parts.size_bytes * (a != b)
        if reusable is not None and names.keys() <= reusable.fields.keys():
            memory, fields = reusable.memory, reusable.fields
        else:
            pools = {name: self._cached_cells(name) for name in names}
            self._evict(names)
            start, fields = _FIRST_OFFSET + 2 * self._parts.size_bytes, dict[FieldName, int]()
            memory = Memory.empty(start + sum(map(field_bytes, pools.values())))
            write_fields(memory, start, pools, fields)
        for offset, frame in {first: a, second: b}.items():
            self._parts.write(memory, offset, frame, fields)
        return Pair(memory, first, second, (a, b), fields)

    def _cached_cells(self, name: FieldName) -> CellPool:
        pool = self._cells.pop(name, None)
        if pool is None:
            pool = self._parts.cells(name)
            self._cached_bytes += field_bytes(pool)
        self._cells[name] = pool
        return pool

    def _evict(self, needed: Container[FieldName]) -> None:
        """Drop the least recently used fields until the rest fits into the memory."""
        while self._cached_bytes > self._max_bytes:
            oldest = next(iter(self._cells))
            if oldest in needed:
                found = f"{self._cached_bytes / 2**20:.1f} MiB for the fields of one instant"
                allowed = f"at most {self._max_bytes / 2**20:.1f} MiB"
                raise InvalidArgument(
                    "memory_bytes", found, allowed, "Allow more memory, or take a coarser grid."
                )
            self._cached_bytes -= field_bytes(self._cells.pop(oldest))


@cache
def _pool() -> ThreadPoolExecutor:
    def lower_priority() -> None:
        """Use SCHED_BATCH, so that this thread does not preempt the requesting one (4 ms)."""
        if hasattr(os, "SCHED_BATCH"):
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))

    return ThreadPoolExecutor(1, thread_name_prefix="touchfield-pairs", initializer=lower_priority)


class DeviceSampler:
    """Forces of a medium or a scene at points in the memory of a GPU (extra ``cuda``).

    The frames around an instant are made by the processor and copied once; points and forces are not copied.
    `memory_bytes` is for frames, as in `FieldSampler`.
    """

    def __init__(self, medium: HapticMedium | HapticScene, memory_bytes: int = 256 << 20) -> None:
        self._sampler = FieldSampler(medium, memory_bytes)
        self._latest: Pair | None = None
        self._views: tuple[Any, ...] = ()

    def force_n(self, time_s: float, points_m: Any) -> Any:
        """Return the force, newtons, float32 [n, 3], in the memory of the GPU.

        It has a ``__cuda_array_interface__``.

        The points, float64 [n, 3] in metres, are an array on a GPU of any library (``__dlpack__`` or
        ``__cuda_array_interface__``), or a NumPy array, which is copied to the GPU. Raises `InvalidArgument`
        for others.
        """
        from touchfield.compute.cuda import empty, for_each, on_device
        from touchfield.render.kernels.points import field_at_points, forces_at_points

        if len(points_m.shape) != 2 or points_m.shape[1] != 3 or points_m.dtype != np.float64:
            found = f"{points_m.dtype}, shape {tuple(points_m.shape)}"
            raise InvalidArgument("points_m", found, "float64 [n, 3], metres")
        a, b, blend = self._sampler._instant(time_s)
        pair = self._sampler._pair(a, b)
        if self._latest is not pair:
            self._views, self._latest = on_device(_number_views(pair.memory)), pair
        count, points = points_m.shape[0], on_device(points_m)
        out = empty((count, 3), np.float32)
        if self._sampler._has_voxels:
            for n, (field, weight) in enumerate(pair.weighted_fields(blend)):
                for_each(field_at_points, count, points, *self._views, field // 8, weight, n == 0, out)
        else:
            blends = on_device(np.array([blend]))
            frames = pair.first // 8, pair.second // 8
            for_each(forces_at_points, count, points, blends, *self._views, *frames, out)
        return out


def _number_views(memory: Memory) -> tuple[NDArray[Any], ...]:
    """Return memory as int64, uint64, float64 and float32, as kernels for a GPU read it."""
    return tuple(memory.bytes.view(dtype) for dtype in (np.int64, np.uint64, np.float64, np.float32))

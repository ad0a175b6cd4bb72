"""F(x, t) of a decoded medium at any point and time: what the servo asks at each tick, for a program in one
process.

Trilinear in space, zero outside, exact at the samples. Between two frames, a body that moves is at the pose
between and a field that changes is blended linearly; exact at the frames.
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
from touchfield.compute.threads import for_chunks
from touchfield.errors import InvalidArgument, require_not_negative
from touchfield.medium.field import numbers_of
from touchfield.medium.medium import HapticScene
from touchfield.render.block import Memory
from touchfield.render.block import words as W
from touchfield.render.block.frames import FieldName, FrameParts, field_words, write_fields

if TYPE_CHECKING:
    from collections.abc import Callable, Container

    from touchfield.medium import HapticMedium
    from touchfield.medium.cells import CellPool
    from touchfield.medium.deformation import Deformation


_POINTS_AT_ONCE: Final = 8192
_ALWAYS: Final = sys.float_info.max
_NEVER: Final = (1.0, -1.0, 0.0)
_NOWHERE: Final = 8  # words in front that nothing takes: place 0 means none


class FieldSampler:
    """The force at a point and a time.

    Frame i lies at i / rate_hz. Before the first and after the last frame the field is that of the first and
    the last. One thread at a time; a batch itself runs on all cores.

    `memory_bytes` are for the latest fields, which are kept; blocks of two frames, one for `at`, one that it
    begins and one for all other queries, take as much each at most. A `deformation` bends a medium of voxels
    by its tracks. A query raises `InvalidArgument` if a time is not finite, shapes do not fit, or two frames
    do not fit there.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        memory_bytes: int = 256 << 20,
        deformation: Deformation | None = None,
    ) -> None:
        self._parts = FrameParts(medium, deformation)
        self._pairs = Pairs(self._parts, memory_bytes)
        self._is_voxels = not isinstance(medium, HapticScene) and deformation is None
        self._rate_hz = self._parts.rate_hz
        self._latest: Pair | None = None
        self._at = 0, 0
        self._words: Any = None
        self._low, self._high, self._base = (
            _NEVER  # between which instants, in frames, `at` has all that it needs
        )
        self._point: Any = None

    def force_n(self, time_s: ArrayLike, points_m: ArrayLike) -> Float32s:
        """Force, newtons, float32 [..., 3], at points float [..., 3], metres; one that is not finite has
        none.

        `time_s`, seconds, is one time for all points, or one for each.
        """
        from touchfield.render.kernels import points as kernels

        times = numbers_of("time_s", time_s)
        if not times.ndim and self._is_voxels:
            return self._voxels_n(float(times), _points(points_m, np.float32))
        return self._each(kernels.forces_at_points, times, points_m, 3, np.float32)

    def gradient_n_per_m(self, time_s: ArrayLike, points_m: ArrayLike) -> Float64s:
        """dF_i/dx_j, N/m, float64 [..., 3, 3]: the derivative of the interpolation; zeros where no force can
        be.

        On a plane of the lattice it is the one towards greater indices.
        """
        from touchfield.render.kernels import points as kernels

        rows: Float64s = self._each(kernels.gradients_at_points, time_s, points_m, 9, np.float64)
        return rows.reshape(*rows.shape[:-1], 3, 3)

    def vibration(self, time_s: ArrayLike, points_m: ArrayLike) -> tuple[Float32s, Float32s]:
        """Amplitudes, newtons, and frequencies, Hz, of the vibration, each float32 [...]; zeros where none
        is.
        """
        from touchfield.render.kernels import points as kernels

        both: Float32s = self._each(kernels.vibrations_at_points, time_s, points_m, 2, np.float32)
        return both[..., 0], both[..., 1]

    def at(self, time_s: float, x_m: float, y_m: float, z_m: float) -> tuple[float, float, float]:
        """Force at one point, newtons: one query a call, in float64, with as little around it as can be.

        The frames that follow are made in the background, for times that grow as the clock does.
        """
        force_n: tuple[float, float, float]
        try:
            place = time_s * self._rate_hz
            if not self._low <= place <= self._high:
                self._prepare(time_s)
            first, second = self._at
            force_n = self._point(self._words, first, second, place - self._base, x_m, y_m, z_m)
        except (TypeError, ValueError):
            given = time_s, x_m, y_m, z_m
            if all(type(one) is float for one in given):  # it is not for their types
                raise
            force_n = self.at(*numbers_of("time_s, x_m, y_m, z_m", given, shape=(4,)).tolist())
        return force_n

    def _prepare(self, time_s: float) -> None:
        """Make `at` ready for the frames about an instant."""
        from touchfield.render.kernels.points import force_at_once

        a, _, _ = self._instant(time_s)
        b = min(a + 1, self._parts.frame_count - 1)
        self._low, self._high, self._base = _NEVER
        memory, first, second = self._pairs.take(a, b)[:3]
        self._pairs.begin(b, b + 1)
        if not force_at_once.signatures:
            force_at_once(memory.u8, first, second, 0.0, 0.0, 0.0, 0.0)
            # a whole number becomes a float, and takes no compiled code of its own
            force_at_once.disable_compile()
        self._words, self._at, self._point = memory.u8, (first, second), force_at_once
        self._base = float(a)
        self._low = float(a) if a > 0 else -_ALWAYS
        self._high = float(b) if b < self._parts.frame_count - 1 else _ALWAYS

    def _instant(self, time_s: float) -> tuple[int, int, float]:
        """Two frames and the blend between them."""
        firsts, blends = self._instants(time_s, ())
        a, blend = int(firsts[0]), float(blends[0])
        return a, a + (blend > 0.0), blend

    def _instants(self, time_s: ArrayLike, shape: tuple[int, ...]) -> tuple[Int64s, Float64s]:
        """First frames int64 [m] and blends [m] of one time, or of one for each of the points."""
        times = numbers_of("time_s", time_s)
        if times.ndim and times.shape != shape:
            raise InvalidArgument("time_s", f"shape {times.shape}", f"one time, or {shape} as the points")
        with np.errstate(over="ignore"):
            place = times.reshape(-1) * self._rate_hz
        if not np.isfinite(place).all():
            raise InvalidArgument("time_s", "a time that is not finite", "finite numbers of seconds")
        place = np.clip(place, 0.0, self._parts.frame_count - 1.0)
        firsts = (place + W.AT_A_FRAME).astype(np.int64)
        blends = place - firsts
        blends[blends <= W.AT_A_FRAME] = 0.0
        return firsts, blends

    def _take(self, a: int, b: int) -> Pair:
        """Two frames for all queries but `at`; the latest are kept."""
        if self._latest is None or self._latest.frames != (a, b):
            self._latest = self._pairs.take(a, b, self._latest)
        return self._latest

    def _voxels_n(self, time_s: float, points: NDArray[Any]) -> Float32s:
        """One field, or two that are blended, at many points of one instant."""
        from touchfield.render.kernels import points as kernels

        a, b, blend = self._instant(time_s)
        pair = self._take(a, b)
        out = np.empty(points.shape, np.float32)
        flat, forces = points.reshape(-1, 3), out.reshape(-1, 3)
        for n, (field, share) in enumerate(pair.shares(blend)):
            arguments = (flat, *pair.memory.views, field, share, n == 0, forces)
            for_chunks(kernels.field_at_points, len(flat), *arguments, chunk=_POINTS_AT_ONCE)
        return out

    def _each(
        self, kernel: Callable[..., Any], time_s: ArrayLike, points_m: ArrayLike, columns: int, dtype: Any
    ) -> NDArray[Any]:
        """A kernel at all points; those between the same two frames together."""
        points = _points(points_m)
        flat = points.reshape(-1, 3)
        out = np.empty((len(flat), columns), dtype)
        firsts, blends = self._instants(time_s, points.shape[:-1])
        groups: list[Any] = [slice(None)]
        if len(blends) != 1:
            order = np.argsort(firsts, kind="stable")
            groups = np.split(order, np.flatnonzero(np.diff(firsts[order])) + 1) if len(order) else []
        for which in groups:
            a, shares, part = int(firsts[which][0]), blends[which], out[which]
            memory, *frames = self._take(a, a + bool(shares.any()))[:3]
            arguments = (flat[which], shares, *memory.views, *frames, part)
            for_chunks(kernel, len(part), *arguments, chunk=_POINTS_AT_ONCE // 4)
            out[which] = part
        return out.reshape(*points.shape[:-1], columns)


def _points(points_m: ArrayLike, *others: type[np.float32]) -> NDArray[Any]:
    """Points as the kernels take them: float64 or one of `others`, contiguous, writeable."""
    kind = np.float32 if getattr(points_m, "dtype", None) in others else np.float64
    points = np.ascontiguousarray(numbers_of("points_m", points_m, kind))
    if points.ndim == 0 or points.shape[-1] != 3:
        raise InvalidArgument("points_m", f"shape {points.shape}", "points [..., 3] in metres")
    return (
        points if points.flags.writeable else points.copy()
    )  # to the compiler read-only arrays are another type


class Pair(NamedTuple):
    """Two frames, perhaps the same: their block and their places in it, as the kernels take them; and its
    fields.
    """

    memory: Memory
    first: int
    second: int
    frames: tuple[int, int]
    fields: dict[FieldName, int]

    def shares(self, blend: float) -> list[tuple[int, float]]:
        """Of frames of voxels the place of the field of each, and its share between the two."""
        ends = ((self.first, 1.0 - blend), (self.second, blend))[: 1 + (blend > 0.0)]
        return [
            (int(self.memory.views[0][frame + W.FRAME_WORDS + W.PART_FIELD]), share) for frame, share in ends
        ]


class Pairs:
    """Pairs (a, b) of frames, each in a block of its own, made when asked for or begun before.

    Cells of the latest fields are kept in `memory_bytes`, about twice those of their bricks, and copied into
    the pairs that need them. Frames are made by one thread at a time, the caller's or a background one.
    """

    def __init__(self, parts: FrameParts, memory_bytes: int) -> None:
        require_not_negative(memory_bytes=memory_bytes)
        self._parts, self._most_words = parts, int(memory_bytes) // W.WORD
        self._cells: dict[FieldName, CellPool] = {}  # in the order of use
        self._words = 0  # of them
        self._coming: Future[Pair] | None = None
        self._coming_frames = -1, -1

    def take(self, a: int, b: int, before: Pair | None = None) -> Pair:
        """The pair; written over the one `before`, which is given up, where that has all fields.

        InvalidArgument where it does not fit into the memory allowed.
        """
        coming, self._coming = self._coming, None
        if coming is not None and self._coming_frames == (a, b):
            return coming.result()
        if coming is not None and not coming.cancel():
            coming.exception()  # both would make frames at once
        return self._make(a, b, before)

    def begin(self, a: int, b: int) -> None:
        """Make a pair in the background for the next `take`, where there is one; its error comes then."""
        if b < self._parts.frame_count:
            self._coming_frames, self._coming = (a, b), _pool().submit(self._make, a, b)

    def _make(self, a: int, b: int, before: Pair | None = None) -> Pair:
        names = dict.fromkeys(name for frame in (a, b) for name in self._parts.names(frame))
        first, second = _NOWHERE, _NOWHERE + self._parts.words * (a != b)
        if before is not None and names.keys() <= before.fields.keys():
            memory, fields = before.memory, before.fields
        else:
            pools = {name: self._cells_of(name) for name in names}
            self._let_go(names)
            begin, fields = _NOWHERE + 2 * self._parts.words, dict[FieldName, int]()
            memory = Memory.empty(begin + sum(map(field_words, pools.values())))
            write_fields(memory, begin, pools, fields)
        for at, frame in {first: a, second: b}.items():
            self._parts.write(memory, at, frame, fields)
        return Pair(memory, first, second, (a, b), fields)

    def _cells_of(self, name: FieldName) -> CellPool:
        pool = self._cells.pop(name, None)
        if pool is None:
            pool = self._parts.cells(name)
            self._words += field_words(pool)
        self._cells[name] = pool
        return pool

    def _let_go(self, needed: Container[FieldName]) -> None:
        """Drop what was not asked for since longest until the rest has room."""
        while self._words > self._most_words:
            oldest = next(iter(self._cells))
            if oldest in needed:
                found = f"{self._words * W.WORD / 2**20:.1f} MiB for the fields of one instant"
                allowed = f"at most {self._most_words * W.WORD / 2**20:.1f} MiB"
                raise InvalidArgument(
                    "memory_bytes", found, allowed, "Allow more memory, or take a coarser grid."
                )
            self._words -= field_words(self._cells.pop(oldest))


@cache
def _pool() -> ThreadPoolExecutor:
    def stand_back() -> None:  # when woken, not take the processor from the one that asks (4 ms of it, else)
        if hasattr(os, "SCHED_BATCH"):
            with suppress(OSError):
                os.sched_setscheduler(0, os.SCHED_BATCH, os.sched_param(0))

    return ThreadPoolExecutor(1, thread_name_prefix="touchfield-pairs", initializer=stand_back)


class DeviceSampler:
    """Forces of a medium or a scene of objects at points in the memory of a GPU (extra ``cuda``).

    The frames about an instant are made by the processor and copied once; points and forces are not copied.

    `memory_bytes` are for frames, as of `FieldSampler`.
    """

    def __init__(self, medium: HapticMedium | HapticScene, memory_bytes: int = 256 << 20) -> None:
        self._sampler = FieldSampler(medium, memory_bytes)
        self._latest: Pair | None = None
        self._views: tuple[Any, ...] = ()

    def force_n(self, time_s: float, points_m: Any) -> Any:
        """Force, newtons, float32 [n, 3], on the device, with a ``__cuda_array_interface__``.

        Points, float64 [n, 3] in metres, are an array on a GPU of any library (``__dlpack__`` or
        ``__cuda_array_interface__``), or one of NumPy, which is copied there; `InvalidArgument` for others.
        """
        from touchfield.compute.cuda import empty, for_each, on_device
        from touchfield.render.kernels.points import field_at_points, forces_at_points

        if len(points_m.shape) != 2 or points_m.shape[1] != 3 or points_m.dtype != np.float64:
            found = f"{points_m.dtype}, shape {tuple(points_m.shape)}"
            raise InvalidArgument("points_m", found, "float64 [n, 3], metres")
        a, b, blend = self._sampler._instant(time_s)
        pair = self._sampler._take(a, b)
        if self._latest is not pair:
            self._views, self._latest = on_device(tuple(pair.memory.views)), pair
        count, points = points_m.shape[0], on_device(points_m)
        out = empty((count, 3), np.float32)
        if self._sampler._is_voxels:
            for n, (field, share) in enumerate(pair.shares(blend)):
                for_each(field_at_points, count, points, *self._views, field, share, n == 0, out)
        else:
            blends = on_device(np.array([blend]))
            for_each(forces_at_points, count, points, blends, *self._views, pair.first, pair.second, out)
        return out

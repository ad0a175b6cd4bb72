"""The memory of a receiver, which player and servo share: the player writes frames and orders, the servo its
state and log. This file creates and opens it, and defines where its parts lie.

`layout` has the structs in it, generated from ``c/touch_receiver.h``. Offsets and sizes are in bytes; offset
0 means "none". A shared block is a file with a name of its own, which is deleted as soon as both processes
have opened it, so that nothing remains if one of them is killed. Space is reserved before it is written, so
that a full ``/dev/shm`` is an error and not a crash.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import tempfile
from collections import deque
from collections.abc import Sequence
from functools import cached_property
from itertools import accumulate
from multiprocessing import reduction
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int64s
from touchfield.compute.native import native
from touchfield.errors import InvalidArgument, TouchfieldError
from touchfield.render.block import layout

PREFIX: Final = "touchfield-servo-"
DEFAULT_BYTES: Final = 1 << 28  # for frames that are decoded ahead
LOG_ROWS: Final = 8192
SLOTS: Final = 256  # frames in the directory at one time, a power of two
_ALIGNMENT: Final = 64  # bytes of a cache line
_STEP_BYTES: Final = 1 << 22  # space is reserved in steps of this size


def check_layout(rows: Sequence[tuple[str, int]]) -> None:
    """Raise `TouchfieldError` unless the compiled module has the structs of `layout`.

    `rows` are its version, sizes and offsets in bytes, ``native.receiver_layout()``.
    """
    expected = {"version": layout.RECEIVER_VERSION}
    for name, dtype in layout.STRUCTS.items():
        expected[name] = dtype.itemsize
        expected |= {f"{name}.{field}": offset for field, (_, offset, *_) in (dtype.fields or {}).items()}
    differing = set(rows) ^ set(expected.items())
    if differing:
        raise TouchfieldError(
            "touchfield._native, the compiled part of touchfield",
            f"other structs of a receiver ({min(differing)[0]})",
            "those of c/touch_receiver.h",
            "Install touchfield again, or compile the module again (make module).",
        )


check_layout(native.receiver_layout())


def aligned(size_bytes: int) -> int:
    """Round a size up, so that the next part starts at a cache line."""
    return -(-int(size_bytes) // _ALIGNMENT) * _ALIGNMENT


class Memory:
    """Bytes of a receiver, `bytes` uint8 [n], and views of the structs in them.

    A view is writable: ``memory.receiver["state"]["force"]["output"][:] = 0``.
    """

    def __init__(self, buffer: Any) -> None:
        self.bytes: NDArray[np.uint8] = np.frombuffer(buffer, np.uint8)

    @classmethod
    def empty(cls, size_bytes: int) -> Memory:
        """Memory of zeros in this process; the system provides only what is written."""
        return cls(np.zeros(size_bytes, np.uint8))

    @property
    def size_bytes(self) -> int:
        return len(self.bytes)

    @cached_property
    def receiver(self) -> Any:
        """The `touch_receiver` at offset 0: settings, orders, state and counts."""
        return self.view(layout.RECEIVER, 0)

    def view(self, dtype: np.dtype[Any], offset: int) -> Any:
        """Return a struct at an offset."""
        return self.array(dtype, offset, 1)[0]

    def array(self, dtype: np.dtype[Any] | type[Any], offset: int, count: int) -> NDArray[Any]:
        """Return `count` items at an offset."""
        return np.frombuffer(self.bytes.data, dtype, count, offset)


def shared_folder() -> Path:
    """Return the folder of shared blocks, in memory if the system has such a folder."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir())


def free_bytes() -> int:
    """Return the free space for shared blocks; a large number if it is unknown."""
    if not hasattr(os, "statvfs"):
        return 1 << 40
    system = os.statvfs(shared_folder())
    return system.f_bavail * system.f_frsize


class Block:
    """A block of memory that processes share, by its file.

    As an argument of a process that is spawned, it is the same block, whether or not its file has a name.
    """

    def __init__(self, path: Path, descriptor: int, size_bytes: int) -> None:
        self.path, self._size_bytes = path, size_bytes
        self._descriptor, self._reserved_bytes = descriptor, 0
        self.memory = Memory(mmap.mmap(descriptor, size_bytes))

    @classmethod
    def create(cls, size_bytes: int) -> Block:
        """Create a block of zeros, whose space `reserve` reserves.

        Raises `InvalidArgument` if there is not enough space.
        """
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, dir=shared_folder())
        try:
            os.truncate(descriptor, size_bytes)
            return cls(Path(name), descriptor, size_bytes)
        except OSError as error:
            os.close(descriptor)
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise _no_space(size_bytes) from error

    @classmethod
    def attach(cls, path: Path) -> Block:
        """Open the block that another process created."""
        descriptor = os.open(path, os.O_RDWR)
        return cls(path, descriptor, os.fstat(descriptor).st_size)

    def __reduce__(self) -> tuple[Any, ...]:
        if os.name != "posix":  # the file keeps its name
            return Block.attach, (self.path,)
        return _attach_descriptor, (self.path, reduction.DupFd(self._descriptor))

    def reserve(self, size_bytes: int) -> None:
        """Make the first `size_bytes` bytes writable.

        Raises `InvalidArgument` if there is not enough space.
        """
        wanted = min(self._size_bytes, -(-size_bytes // _STEP_BYTES) * _STEP_BYTES)
        if wanted <= self._reserved_bytes or not hasattr(os, "posix_fallocate"):
            return
        try:
            os.posix_fallocate(self._descriptor, self._reserved_bytes, wanted - self._reserved_bytes)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.ENOMEM, errno.EFBIG):
                raise _no_space(wanted) from error
            # a file system that cannot reserve: it is written as it is
        self._reserved_bytes = wanted

    def unlink(self) -> None:
        """Delete the file's name; processes that have opened it still use it."""
        with contextlib.suppress(OSError):
            os.unlink(self.path)

    def close(self) -> None:
        """Close the file; the memory is freed with the last view of it. May be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            del self.memory


def _attach_descriptor(path: Path, duplicate: Any) -> Block:
    """Open a block by its descriptor, of which the process has a duplicate."""
    descriptor = duplicate.detach()
    return Block(path, descriptor, os.fstat(descriptor).st_size)


def _no_space(needed_bytes: int) -> InvalidArgument:
    return InvalidArgument(
        "shared memory",
        f"{free_bytes() / 2**20:.0f} MiB free in {shared_folder()}",
        f"{needed_bytes / 2**20:.0f} MiB",
        "Ask for less memory, or make that folder larger.",
    )


class Layout:
    """Offsets of the parts of a block: the receiver, then directory, log, tool, materials, yields and arena.

    The arena starts with what all frames share (fields of rigid bodies); the rest of it is a `Ring` of
    frames. All sizes and offsets are in bytes.
    """

    def __init__(
        self,
        arena_bytes: int,
        slots: int = SLOTS,
        log_rows: int = LOG_ROWS,
        tool_bytes: int = 0,
        material_bytes: int = 0,
        yield_bytes: int = 0,
    ) -> None:
        self.slots, self.log_rows = slots, log_rows
        directory_bytes, log_bytes = (
            slots * layout.DIRECTORY_ENTRY.itemsize,
            log_rows * layout.LOG_ROW.itemsize,
        )
        sizes = (
            *(layout.RECEIVER.itemsize, directory_bytes, log_bytes),
            *(tool_bytes, material_bytes, yield_bytes, arena_bytes),
        )
        _, self.directory, self.log, self.tool, self.materials, self.yields, self.arena, self.size_bytes = (
            accumulate(map(aligned, sizes), initial=0)
        )

    def write(
        self,
        memory: Memory,
        frame_count: int,
        frame_rate_hz: float,
        is_loop: bool,
        rate_hz: float,
        is_blended: bool = True,
    ) -> None:
        """Write what does not change during playback, and empty the directory.

        `rate_hz` is that of the ticks. With `is_blended` the force fades where the medium does not continue.
        """
        receiver = memory.receiver
        for name, value in (
            ("version", layout.RECEIVER_VERSION),
            ("size_bytes", memory.size_bytes),
            ("directory_offset", self.directory),
            ("directory_slots", self.slots),
            ("log_offset", self.log),
            ("log_rows", self.log_rows),
            ("arena_offset", self.arena),
            ("frame_count", frame_count),
            ("frame_rate_hz", frame_rate_hz),
            ("is_loop", is_loop),
            ("tick_ns", round(1e9 / rate_hz)),
            ("is_unblended", not is_blended),
        ):
            receiver["layout"][name] = value
        memory.array(layout.DIRECTORY_ENTRY, self.directory, self.slots)["tag"] = -1
        receiver["settings"]["rate_hz"] = rate_hz
        clock = receiver["clock"]
        clock["is_resting"], clock["sequence_seen"], clock["used"] = 1, -1, -1


class Ring:
    """Space for frames of any size, each in one piece, which is taken and freed in order. Sizes in bytes."""

    def __init__(self, start: int, size_bytes: int) -> None:
        self._start, self._stop, self.size_bytes = start, start + size_bytes, size_bytes
        self._frames: deque[tuple[int, int]] = deque()  # frame, offset
        self._head = start

    def clear(self) -> None:
        """Free everything."""
        self._frames.clear()
        self._head = self._start

    def free_before(self, frame: int) -> None:
        """Free the space of all frames before `frame`."""
        while self._frames and self._frames[0][0] < frame:
            self._frames.popleft()
        if not self._frames:
            self._head = self._start

    def hold(self, frame: int) -> bool:
        """Do not free the latest space before a later frame is past; False if it is already free."""
        if not self._frames:
            return False
        self._frames[-1] = max(frame, self._frames[-1][0]), self._frames[-1][1]
        return True

    def take(self, frame: int, size_bytes: int) -> int | None:
        """Return the offset of space for a frame; None if there is not enough now."""
        size_bytes = aligned(size_bytes)
        oldest = self._frames[0][1] if self._frames else self._stop
        is_wrapped = bool(self._frames) and self._head <= oldest
        if self._head + size_bytes <= (oldest if is_wrapped else self._stop):
            offset = self._head
        elif not is_wrapped and self._frames and self._start + size_bytes <= oldest:
            offset = self._start
        else:
            return None
        self._frames.append((frame, offset))
        self._head = offset + size_bytes
        return offset


def check_fits(size_bytes: int, capacity_bytes: int, what: str) -> None:
    """Raise `InvalidArgument` unless something fits into so many bytes."""
    if size_bytes > capacity_bytes:
        raise too_little(capacity_bytes, f"{size_bytes / 2**20:.2f} MiB for {what}")


def too_little(capacity_bytes: int, needed: str) -> InvalidArgument:
    """Return the error of a capacity for frames that is less than needed."""
    found = f"{capacity_bytes / 2**20:.2f} MiB of room for frames"
    hint = "Ask for more memory, or take a medium on a coarser lattice."
    return InvalidArgument("memory_bytes", found, needed, hint)


COLUMNS: Final = layout.LOG_ROW
"""A row of the log.

Times are in seconds since the first tick and of the medium. Positions, velocity, forces of the field and
friction are in the axes of the field; the force and torque that the device got, and the orientation of its
grip, are in those of the device.
"""

FLAGS: Final = {
    "running": layout.FLAG_RUNNING,
    "waiting": layout.FLAG_WAITING,
    "stalled": layout.FLAG_STALLED,
    "ended": layout.FLAG_ENDED,
    "stopping": layout.FLAG_STOPPING,
    "silent": layout.FLAG_SILENT,
    "paused": layout.FLAG_PAUSED,
}
"""Bits of `flags`: the media clock runs; waits for the first frames; underrun; at the end; on the way to zero
after a stop; no sign of life from the player; paused."""


class TickLog:
    """Rows of the log, read from its ring; at most the latest `max_rows` are stored.

    The servo never waits for a reader: rows that are not read in time are overwritten. `lost` counts these
    and the rows dropped here.
    """

    def __init__(self, memory: Memory, max_rows: int) -> None:
        self._memory: Memory | None = memory
        self._max_rows = max_rows
        self._read, self._row_count = 0, 0
        self._blocks: deque[NDArray[Any]] = deque()
        self.lost = 0

    def drain(self) -> None:
        """Read the rows written since the last call."""
        if self._memory is None or not self._max_rows:
            return
        receiver = self._memory.receiver
        row_count = int(receiver["layout"]["log_rows"])
        written = int(receiver["clock"]["log_written"])
        start = max(self._read, written - row_count)
        if start >= written:
            return
        ring = self._memory.array(layout.LOG_ROW, int(receiver["layout"]["log_offset"]), row_count)
        rows = ring[np.arange(start, written) % row_count]
        # the servo may have overwritten the oldest of them meanwhile, and may be writing over the next one
        safe = max(start, int(receiver["clock"]["log_written"]) + 1 - row_count)
        rows = rows[min(safe, written) - start :]
        self.lost += written - self._read - len(rows)
        self._read = written
        self._blocks.append(rows)
        self._row_count += len(rows)
        while self._row_count > self._max_rows and len(self._blocks) > 1:
            oldest = self._blocks.popleft()
            self._row_count -= len(oldest)
            self.lost += len(oldest)

    def rows(self) -> NDArray[Any]:
        """Return all stored rows in order, a structured array of `COLUMNS`."""
        if not self._blocks:
            return np.zeros(0, COLUMNS)
        joined = np.concatenate(list(self._blocks))
        self._blocks = deque([joined])
        return joined.copy()

    def take(self) -> NDArray[Any]:
        """Return the stored rows in order, and store them no longer."""
        rows = self.rows()
        self._blocks.clear()
        self._row_count = 0
        return rows

    def let_go(self) -> None:
        """Read the last rows, and release the memory."""
        self.drain()
        self._memory = None


_COUNTS: Final = {
    "late_ticks": "late",
    "missed_ticks": "missed",
    "underruns": "underruns",
    "stalled_ticks": "stalled_ticks",
    "waits": "waits",
    "waiting_ticks": "waiting_ticks",
    "frames_used": "frames_used",
}
"""Fields of the receiver's counts, by their keys in `statistics_of`."""


def statistics_of(memory: Memory) -> dict[str, Any]:
    """Return the counts so far as a dictionary with stable keys; times in seconds, jitter in microseconds."""
    counts = memory.receiver["counts"]
    ticks, seconds = int(counts["ticks"]), 1e-9 * float(counts["last_ns"] - counts["first_ns"])
    statistics: dict[str, Any] = {
        "ticks": ticks,
        "seconds": seconds,
        "rate_hz": float(memory.receiver["settings"]["rate_hz"]),
        "mean_rate_hz": (ticks - 1) / seconds if seconds > 0 else 0.0,
        **{key: int(counts[name]) for key, name in _COUNTS.items()},
        "stalled_share": float(counts["stalled_ticks"] / max(counts["played_ticks"], 1)),
    }
    for key, name, worst in (
        ("jitter", "periods", "worst_period_ns"),
        ("lateness", "latenesses", "worst_lateness_ns"),
    ):
        bins, worst_us = counts[name].copy(), 1e-3 * float(counts[worst])
        for percent, fraction in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            statistics[f"{key}_{percent}_us"] = _quantile_us(bins, fraction, worst_us)
        statistics[f"{key}_worst_us"] = worst_us
    return statistics


def _quantile_us(counts: Int64s, fraction: float, worst_us: float) -> float:
    """Return the upper edge of the bin that has the quantile; the worst time for the last, open bin."""
    total = int(counts.sum())
    if not total:
        return 0.0
    index = int(np.searchsorted(np.cumsum(counts), fraction * total))
    return min(float(index + 1), worst_us) if index < layout.TIME_BINS else worst_us

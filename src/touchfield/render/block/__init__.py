"""The *block* is the memory that the player's process and the servo's process share. This file creates and
opens it, defines where each part lies, and reads the log that the servo writes into it.

A file of its own name rather than `multiprocessing.shared_memory`: the name is taken away as soon as both
have opened it, so that nothing is left behind whichever process is killed; room is reserved before it is
written, so that a full ``/dev/shm`` is an error and not a crash; a view that somebody still holds keeps the
memory alive. A row of the log is written by every tick and never waits: where nobody drains, the oldest are
lost, and the loss is counted.
"""

from __future__ import annotations

import contextlib
import errno
import mmap
import os
import tempfile
from collections import deque
from dataclasses import dataclass
from itertools import accumulate
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.render.block import words as W

PREFIX: Final = "touchfield-servo-"
_STEP_BYTES: Final = 1 << 22  # Room is reserved in steps of this size
DEFAULT_BYTES: Final = 1 << 28  # what frames that are decoded ahead may take
LOG_ROWS: Final = 8192
SLOTS: Final = 256  # Frames in the directory, a power of two: those that are there at one time


@dataclass(frozen=True)
class Memory:
    """One block as four views of the same bytes, in the order in which every kernel takes them."""

    i8: Int64s
    u8: NDArray[np.uint64]
    f8: Float64s
    f4: Float32s

    @classmethod
    def of(cls, buffer: Any) -> Memory:
        """The views of a writeable buffer whose length is a multiple of eight bytes."""
        octets = np.frombuffer(buffer, np.uint8)
        return cls(
            octets.view(np.int64), octets.view(np.uint64), octets.view(np.float64), octets.view(np.float32)
        )

    @classmethod
    def empty(cls, words: int) -> Memory:
        """A block of zeros within this process, of which the system gives only what is used."""
        return cls.of(np.zeros(W.WORD * words, np.uint8))

    @property
    def views(self) -> tuple[Any, Any, Any, Any]:
        """i8, u8, f8, f4: what the kernels take."""
        return self.i8, self.u8, self.f8, self.f4

    @property
    def words(self) -> int:
        """Their number."""
        return len(self.i8)


def shared_folder() -> Path:
    """Where shared blocks lie: in memory where the system has such a folder."""
    folder = Path("/dev/shm")
    return folder if os.access(folder, os.W_OK) else Path(tempfile.gettempdir())


def free_bytes() -> int:
    """Room for shared blocks; a large number where the system does not tell."""
    if not hasattr(os, "statvfs"):
        return 1 << 40
    system = os.statvfs(shared_folder())
    return system.f_bavail * system.f_frsize


class Block:
    """A block of memory by its file."""

    def __init__(self, path: Path, descriptor: int, size: int) -> None:
        self.path, self._size = path, size
        self._descriptor, self._reserved = descriptor, 0
        self.memory = Memory.of(mmap.mmap(descriptor, size))

    @classmethod
    def create(cls, words: int) -> Block:
        """A new block of zeros; its room is reserved by `reserve`, and `InvalidArgument` if there is none for
        it.
        """
        descriptor, name = tempfile.mkstemp(prefix=PREFIX, dir=shared_folder())
        try:
            os.truncate(descriptor, W.WORD * words)
            return cls(Path(name), descriptor, W.WORD * words)
        except OSError as error:
            os.close(descriptor)
            with contextlib.suppress(OSError):
                os.unlink(name)
            raise _no_room(W.WORD * words) from error

    @classmethod
    def attach(cls, path: Path) -> Block:
        """The block that another process made."""
        descriptor = os.open(path, os.O_RDWR)
        return cls(path, descriptor, os.fstat(descriptor).st_size)

    def reserve(self, words: int) -> None:
        """See to it that the first `words` words can be written; `InvalidArgument` if there is no room for
        them.
        """
        wanted = min(self._size, -(-W.WORD * words // _STEP_BYTES) * _STEP_BYTES)
        if wanted <= self._reserved or not hasattr(os, "posix_fallocate"):
            return
        try:
            os.posix_fallocate(self._descriptor, self._reserved, wanted - self._reserved)
        except OSError as error:
            if error.errno in (errno.ENOSPC, errno.ENOMEM, errno.EFBIG):
                raise _no_room(wanted) from error
            # a file system that cannot reserve: it is written as it is
        self._reserved = wanted

    def unlink(self) -> None:
        """Take the name away; those who have opened it keep it."""
        with contextlib.suppress(OSError):
            os.unlink(self.path)

    def close(self) -> None:
        """Let it go; the memory is given back with the last view of it. May be called twice."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1
            del self.memory


def _no_room(needed: int) -> InvalidArgument:
    return InvalidArgument(
        "shared memory",
        f"{free_bytes() / 2**20:.0f} MiB free in {shared_folder()}",
        f"{needed / 2**20:.0f} MiB",
        "Ask for less memory, or make that folder larger.",
    )


class Layout:
    """Places of the parts of one block: behind `words.FREE` directory, log, tool, materials, yields, arena.

    The arena begins with what all frames share (fields of rigid bodies); the rest of it is a `Ring` of
    frames.
    """

    def __init__(
        self,
        arena_words: int,
        slots: int = SLOTS,
        log_rows: int = LOG_ROWS,
        tool_words: int = 0,
        material_words: int = 0,
        yield_words: int = 0,
    ) -> None:
        self.slots, self.log_rows = slots, log_rows
        sizes = (
            W.DIRECTORY_WORDS * slots,
            W.ROW_WORDS * log_rows,
            tool_words,
            material_words,
            yield_words,
            arena_words,
        )
        ends = accumulate(sizes, initial=W.FREE)
        _, self.log, self.tool, self.material, self.yields, self.arena, self.words = ends

    def write(
        self, memory: Memory, frame_count: int, frame_rate_hz: float, is_loop: bool, rate_hz: float
    ) -> None:
        """Fill the words of CONTROL that are set once, and empty the directory; `rate_hz` is that of the
        ticks.
        """
        i8, f8 = memory.i8, memory.f8
        i8[W.FREE : self.log : W.DIRECTORY_WORDS] = -1
        sizes = W.FREE, self.slots, self.log, self.log_rows, self.arena, frame_count
        i8[[W.DIRECTORY, W.SLOTS, W.LOG, W.LOG_ROWS, W.ARENA, W.FRAME_COUNT]] = sizes
        i8[[W.TICK_NS, W.IS_LOOP, W.RESTING]] = round(1e9 / rate_hz), is_loop, 1
        i8[[W.SEQUENCE_SEEN, W.USED]] = -1
        f8[W.FRAME_RATE_HZ], f8[W.RATE_HZ] = frame_rate_hz, rate_hz


class Ring:
    """Room for frames of any size, each in one piece, taken and given back in order."""

    def __init__(self, begin: int, words: int) -> None:
        self._begin, self._end, self.words = begin, begin + words, words
        self._frames: deque[tuple[int, int]] = deque()  # frame, first word
        self._head = begin

    def clear(self) -> None:
        """Give all back."""
        self._frames.clear()
        self._head = self._begin

    def free_before(self, frame: int) -> None:
        """Give back what lies before a frame."""
        while self._frames and self._frames[0][0] < frame:
            self._frames.popleft()
        if not self._frames:
            self._head = self._begin

    def hold(self, frame: int) -> bool:
        """Keep what was taken last until a later frame is past; False where it was given back."""
        if not self._frames:
            return False
        self._frames[-1] = max(frame, self._frames[-1][0]), self._frames[-1][1]
        return True

    def take(self, frame: int, words: int) -> int | None:
        """Room for a frame; None where there is none now."""
        oldest = self._frames[0][1] if self._frames else self._end
        is_wrapped = bool(self._frames) and self._head <= oldest
        if self._head + words <= (oldest if is_wrapped else self._end):
            at = self._head
        elif not is_wrapped and self._frames and self._begin + words <= oldest:
            at = self._begin
        else:
            return None
        self._frames.append((frame, at))
        self._head = at + words
        return at


def check_fits(words: int, room: int, what: str) -> None:
    """`InvalidArgument` unless something fits into so many words."""
    if words > room:
        raise too_little(room, f"{W.WORD * words / 2**20:.2f} MiB for {what}")


def too_little(room: int, needed: str) -> InvalidArgument:
    """The error of a room for frames, words, that is less than needed."""
    found = f"{W.WORD * room / 2**20:.2f} MiB of room for frames"
    mend = "Ask for more memory, or take a medium on a coarser lattice."
    return InvalidArgument("memory_bytes", found, needed, mend)


COLUMNS: Final = np.dtype(
    [
        *((name, np.float64) for name in ("time_s", "media_s")),
        *(
            (n, np.float64, (3,))
            for n in ("position_m", "velocity_m_s", "field_force_n", "friction_n", "force_n")
        ),
        ("flags", np.int64),
        ("orientation", np.float64, (4,)),
        ("field_torque_nm", np.float64, (3,)),
        ("torque_nm", np.float64, (3,)),
        ("buttons", np.int64),
        ("gripper_m", np.float64),
    ]
)
"""A row: time since the first tick; media time; position, velocity, field force and friction in the field's
axes; the force that the device got in its own; and `FLAGS`. Then how the grip is turned (w, x, y, z, the
device's axes), the torque of the field on the tool in the field's axes, the torque that the device got in its
own, buttons (bit n is button n), and how far the gripper is open."""

FLAGS: Final = {
    "running": 1,
    "waiting": 2,
    "stalled": 4,
    "ended": 8,
    "stopping": 16,
    "silent": 32,
    "paused": 64,
}
"""Bits of `flags`: the media clock runs; waits for first frames; underrun; over; on the way to zero after a
stop; no sign of life from the player; paused."""


class TickLog:
    """Rows taken out of the ring, the latest `rows` of them kept; `lost` are those overwritten or given up."""

    def __init__(self, memory: Memory, rows: int) -> None:
        self._memory: Memory | None = memory
        self._most = rows
        self._taken, self._kept = 0, 0
        self._blocks: deque[NDArray[Any]] = deque()
        self.lost = 0

    def drain(self) -> None:
        """Take what was written since."""
        if self._memory is None or not self._most:
            return
        i8 = self._memory.i8
        ring, at = int(i8[W.LOG_ROWS]), int(i8[W.LOG])
        written = int(i8[W.LOG_WRITTEN])
        begin = max(self._taken, written - ring)
        if begin >= written:
            return
        words = i8[at : at + ring * W.ROW_WORDS].reshape(ring, W.ROW_WORDS)
        rows = words[np.arange(begin, written) % ring]
        # what the servo has written meanwhile, and is writing now, may have gone over the oldest of them
        safe = max(begin, int(i8[W.LOG_WRITTEN]) + 1 - ring)
        rows = rows[min(safe, written) - begin :]
        self.lost += written - self._taken - len(rows)
        self._taken = written
        self._blocks.append(np.ascontiguousarray(rows).view(COLUMNS).reshape(-1))
        self._kept += len(rows)
        while self._kept > self._most and len(self._blocks) > 1:
            gone = self._blocks.popleft()
            self._kept -= len(gone)
            self.lost += len(gone)

    def rows(self) -> NDArray[Any]:
        """All rows that are kept, in order, as one structured array of `COLUMNS`."""
        if not self._blocks:
            return np.zeros(0, COLUMNS)
        joined = np.concatenate(list(self._blocks))
        self._blocks = deque([joined])
        return joined.copy()

    def let_go(self) -> None:
        """Take what there is, and hold on to the block no longer."""
        self.drain()
        self._memory = None


_COUNTS: Final = {
    "late_ticks": W.LATE,
    "missed_ticks": W.MISSED,
    "underruns": W.UNDERRUNS,
    "stalled_ticks": W.STALLED_TICKS,
    "waits": W.WAITS,
    "waiting_ticks": W.WAITING_TICKS,
    "frames_used": W.FRAMES_USED,
}


def statistics_of(memory: Memory) -> dict[str, Any]:
    """The counts so far as a dictionary with stable keys; times in seconds, those of jitter in microseconds."""
    i8 = memory.i8
    ticks = int(i8[W.TICKS])
    seconds = 1e-9 * float(i8[W.LAST_NS] - i8[W.FIRST_NS])
    counts: dict[str, Any] = {
        "ticks": ticks,
        "seconds": seconds,
        "rate_hz": float(memory.f8[W.RATE_HZ]),
        "mean_rate_hz": (ticks - 1) / seconds if seconds > 0 else 0.0,
        **{name: int(i8[place]) for name, place in _COUNTS.items()},
        "stalled_share": float(i8[W.STALLED_TICKS] / max(i8[W.PLAYED_TICKS], 1)),
    }
    histograms = ("jitter", W.PERIODS, W.WORST_PERIOD_NS), ("lateness", W.LATENESSES, W.WORST_LATENESS_NS)
    for name, at, worst in histograms:
        bins = i8[at : at + W.TIME_BINS + 1].copy()
        for percent, share in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            counts[f"{name}_{percent}_us"] = _quantile_us(bins, share, 1e-3 * float(i8[worst]))
        counts[f"{name}_worst_us"] = 1e-3 * float(i8[worst])
    return counts


def _quantile_us(counts: Int64s, share: float, worst_us: float) -> float:
    """The upper edge of the bin in which the quantile lies; the worst where that is the open one."""
    total = int(counts.sum())
    if not total:
        return 0.0
    at = int(np.searchsorted(np.cumsum(counts), share * total))
    return min(float(at + 1), worst_us) if at < W.TIME_BINS else worst_us

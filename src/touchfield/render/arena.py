"""How the block is laid out behind its fixed places, and the ring in which frames lie.

Behind `memory.FREE`: directory of frames, ring of the log, tool, arena. The arena begins with what all frames share
(fields of rigid bodies); the rest of it is a ring of frames of any size, each in one piece.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from touchfield.errors import InvalidArgument
from touchfield.render import control
from touchfield.render.log import ROW_WORDS
from touchfield.render.memory import FREE, WORD

if TYPE_CHECKING:
    from touchfield.render.memory import Memory
    from touchfield.render.spec import RenderSpec

__all__ = ["DEFAULT_BYTES", "SLOTS", "Layout", "Ring", "check_fits", "ramp_limit_s"]

DEFAULT_BYTES: Final = 1 << 28
"""What frames that are decoded ahead may take."""

LOG_ROWS: Final = 8192
SLOTS: Final = 256
"""Frames in the directory, a power of two: those that are there at one time."""

_RAMP_SPARE_S: Final = 1.0
_LONGEST_RAMP_S: Final = 10.0


@dataclass(frozen=True)
class Layout:
    """Sizes and places of the parts of one block.

    Parameters
    ----------
    arena_words : int
    slots : int
        Frames in the directory.
    log_rows : int
    tool_words : int
        Of the tool in the hand.
    """

    arena_words: int
    slots: int = SLOTS
    log_rows: int = LOG_ROWS
    tool_words: int = 0

    @property
    def directory(self) -> int:
        """Its first word."""
        return FREE

    @property
    def log(self) -> int:
        """Its first word."""
        return self.directory + control.DIRECTORY_WORDS * self.slots

    @property
    def tool(self) -> int:
        """Its first word."""
        return self.log + ROW_WORDS * self.log_rows

    @property
    def arena(self) -> int:
        """Its first word."""
        return self.tool + self.tool_words

    @property
    def words(self) -> int:
        """Of the whole block."""
        return self.arena + self.arena_words

    def write(self, memory: Memory, frame_count: int, frame_rate_hz: float, is_loop: bool, spec: RenderSpec) -> None:
        """Fill the words of CONTROL that are set once, and empty the directory."""
        i8, f8 = memory.i8, memory.f8
        i8[self.directory : self.log : control.DIRECTORY_WORDS] = -1
        for place, value in (
            (control.DIRECTORY, self.directory),
            (control.SLOTS, self.slots),
            (control.LOG, self.log),
            (control.LOG_ROWS, self.log_rows),
            (control.ARENA, self.arena),
            (control.ARENA_WORDS, self.arena_words),
            (control.FRAME_COUNT, frame_count),
            (control.TICK_NS, round(1e9 / spec.rate_hz)),
            (control.IS_LOOP, is_loop),
            (control.SEQUENCE_SEEN, -1),
            (control.USED, -1),
            (control.RESTING, 1),
        ):
            i8[place] = value
        f8[control.FRAME_RATE_HZ], f8[control.RATE_HZ] = frame_rate_hz, spec.rate_hz


class Ring:
    """Room for frames, taken and given back in order.

    Parameters
    ----------
    begin, words : int
        Words of the block that it may use.
    """

    def __init__(self, begin: int, words: int) -> None:
        self._begin, self._end = begin, begin + words
        self._held: deque[tuple[int, int]] = deque()  # frame, first word
        self._head = begin

    @property
    def words(self) -> int:
        """All of them, free or not."""
        return self._end - self._begin

    def clear(self) -> None:
        """Give all back."""
        self._held.clear()
        self._head = self._begin

    def free_before(self, frame: int) -> None:
        """Give back what lies before a frame."""
        while self._held and self._held[0][0] < frame:
            self._held.popleft()
        if not self._held:
            self._head = self._begin

    def hold(self, frame: int) -> bool:
        """Keep what was taken last until a later frame is past; False where it was given back."""
        if not self._held:
            return False
        self._held[-1] = max(frame, self._held[-1][0]), self._held[-1][1]
        return True

    def take(self, frame: int, words: int) -> int | None:
        """Room for a frame, in one piece; None where there is none now."""
        if not self._held:
            at = self._begin if words <= self.words else None
        else:
            oldest = self._held[0][1]
            if self._head > oldest:
                if self._head + words <= self._end:
                    at = self._head
                else:
                    at = self._begin if self._begin + words <= oldest else None
            else:
                at = self._head if self._head + words <= oldest else None
        if at is not None:
            self._held.append((frame, at))
            self._head = at + words
        return at


def ramp_limit_s(peak_n: float, slew_n_per_s: float, ramp_s: float) -> float:
    """The longest that a force may take to go to zero, with time to spare, seconds."""
    return min(_RAMP_SPARE_S + ramp_s + 2 * peak_n / slew_n_per_s, _LONGEST_RAMP_S)


def check_fits(words: int, room: int, what: str) -> None:
    """Whether something fits into so many words.

    Raises
    ------
    InvalidArgument
        If it does not.
    """
    if words > room:
        raise InvalidArgument(
            "memory_bytes",
            f"{WORD * room / 2**20:.2f} MiB of room for frames",
            f"{WORD * words / 2**20:.2f} MiB for {what}",
            "Ask for more memory, or take a medium on a coarser lattice.",
        )

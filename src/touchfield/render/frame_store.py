"""The latest frames of a medium in one block of this process, within a bound of memory.

Two frames can be written at a time, those between which a query lies. Behind them lie fields, those that were used
least recently in front; when the block is full, the older half of them goes and the rest moves forward.
"""

from __future__ import annotations

from collections import OrderedDict
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.render.frame_block import field_words, write_field
from touchfield.render.memory import WORD, Memory

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from touchfield.medium.cells import CellPool
    from touchfield.render.frame_parts import FieldName, FrameParts

__all__ = ["FrameStore"]

_NOWHERE: Final = 8
"""Words in front that nothing takes: place 0 means none."""

_FIRST_WORDS: Final = 1 << 17


class FrameStore:
    """Frames that are made when asked for, and kept while there is room.

    Parameters
    ----------
    parts : FrameParts
    memory_bytes : int
        That fields may take, as cells: about twice the bytes of their bricks.
    cells_of : callable, optional
        Cells of a field, where they are made for others as well. Fields are then kept for one instant only.

    Attributes
    ----------
    memory : Memory
        The block; another one whenever it had to grow.
    """

    def __init__(
        self, parts: FrameParts, memory_bytes: int, cells_of: Callable[[FieldName], CellPool] | None = None
    ) -> None:
        self._parts = parts
        self._cells_of, self._is_brief = cells_of or parts.cells, cells_of is not None
        self._slots = (_NOWHERE, _NOWHERE + parts.words)
        self._begin = self._top = _NOWHERE + 2 * parts.words
        self._bound = self._begin + memory_bytes // WORD
        self._fields: OrderedDict[FieldName, tuple[int, int]] = OrderedDict()
        self._written = [-1, -1]
        self.memory = _block(min(self._bound, self._begin + _FIRST_WORDS))

    def places(self, a: int, b: int) -> tuple[int, int]:
        """Words of two frames, perhaps the same, valid until the next call.

        Raises
        ------
        InvalidArgument
            If the bound does not hold both.
        """
        names = {name: None for frame in (a, b) for name in self._parts.names(frame)}
        missing = [name for name in names if name not in self._fields]
        for name in names:
            if name in self._fields:
                self._fields.move_to_end(name)
        if missing and self._is_brief:
            self._pack({name: place for name, place in self._fields.items() if name in names})
        for name in missing:
            pool = self._cells_of(name)
            words = field_words(pool)
            at = self._room(words, names)
            write_field(self.memory, at, pool)
            self._fields[name] = at, words
            self._top = at + words
        first = self._written.index(a) if a in self._written else int(self._written[0] == b != a)
        second = first if a == b else 1 - first
        for slot, frame in ((first, a), (second, b)):
            if self._written[slot] != frame:
                places = {name: self._fields[name][0] for name in self._parts.names(frame)}
                self._parts.write(self.memory, self._slots[slot], frame, places)
                self._written[slot] = frame
        return self._slots[first], self._slots[second]

    @property
    def kept(self) -> list[FieldName]:
        """The fields that are there, the least recently used first."""
        return list(self._fields)

    def _room(self, words: int, needed: dict[FieldName, None]) -> int:
        """A place for so many words: free, or made by growing, or by letting older fields go."""
        if self._top + words > self.memory.words < self._bound:
            self._grow(min(self._bound, max(2 * self.memory.words, self._top + words)))
        if self._top + words > self.memory.words:
            self._let_go(words, needed)
        return self._top

    def _grow(self, words: int) -> None:
        grown = _block(words)
        grown.i8[: self._top] = self.memory.i8[: self._top]
        self.memory = grown

    def _let_go(self, words: int, needed: dict[FieldName, None]) -> None:
        """Drop old fields until half of the room is free and `words` fit, and move what is kept to the front."""
        held = self._top - self._begin
        half = max((self._bound - self._begin) // 2, words)
        for name in [name for name in self._fields if name not in needed]:
            if self._bound - self._begin - held >= half:
                break
            held -= self._fields.pop(name)[1]
        if self._begin + held + words > self._bound:
            found = f"{(held + words) * WORD / 2**20:.1f} MiB for the fields of one instant"
            allowed = f"at most {(self._bound - self._begin) * WORD / 2**20:.1f} MiB"
            raise InvalidArgument("memory_bytes", found, allowed, "Allow more memory, or take a coarser grid.")
        self._pack(self._fields)

    def _pack(self, kept: Mapping[FieldName, tuple[int, int]]) -> None:
        """Move what is kept to the front, and forget the rest."""
        self._fields = OrderedDict(kept)
        self._top = self._begin
        for name, (at, size) in sorted(kept.items(), key=lambda item: item[1][0]):
            self.memory.i8[self._top : self._top + size] = self.memory.i8[at : at + size]
            self._fields[name] = self._top, size  # in its place in the order of use
            self._top += size
        self._written = [-1, -1]


def _block(words: int) -> Memory:
    """A block of zeros of which the system gives only what is used."""
    return Memory.of(np.zeros(WORD * words, np.uint8))

"""A medium through Q: its frames as symbols, made when they are asked for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from touchfield.measure.field_symbols import FieldSymbols

if TYPE_CHECKING:
    from touchfield.codec.paper.field_quantiser import FieldQuantiser
    from touchfield.medium import HapticMedium

__all__ = ["FrameRange", "SymbolFrames"]


class SymbolFrames(Sequence[FieldSymbols]):
    """The frames of a medium through Q, each made when it is asked for; the last two are kept."""

    def __init__(self, medium: HapticMedium, quantiser: FieldQuantiser) -> None:
        self.medium, self.quantiser = medium, quantiser
        self._kept: dict[int, FieldSymbols] = {}

    def __len__(self) -> int:
        return len(self.medium)

    def __getitem__(self, index: Any) -> Any:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        i = index + len(self) if index < 0 else index
        if not 0 <= i < len(self):
            raise IndexError(index)
        if i not in self._kept:
            while len(self._kept) > 1:
                self._kept.pop(next(iter(self._kept)))
            self._kept[i] = self.quantiser(self.medium[i])
        return self._kept[i]

    def __iter__(self) -> Iterator[FieldSymbols]:
        return (self[i] for i in range(len(self)))


class FrameRange(Sequence[FieldSymbols]):
    """Some of the frames, without making them twice."""

    def __init__(self, frames: SymbolFrames, begin: int, end: int) -> None:
        self._frames, self._range = frames, range(begin, end)

    def __len__(self) -> int:
        return len(self._range)

    def __getitem__(self, index: Any) -> Any:
        return self._frames[self._range[index]]

"""What a record holds, as a frozen dataclass whose every field carries its own row of the format table.

The row (type, bounds, unit, meaning) stands where the field is declared; the fields lie in the file in the order in
which they are declared. A test holds the tables of docs/format/container.md against the rows.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

from touchfield.container.fields import Cursor, FieldType, shown
from touchfield.errors import InvalidArgument

__all__ = ["Row", "Struct", "row", "rows_of"]

ROW: Final = "touchfield row"


@dataclass(frozen=True)
class Row:
    """One field of the format.

    Attributes
    ----------
    name : str
    kind : FieldType
        Its bytes and its bounds.
    unit : str
        Physical unit, or "" where there is none.
    meaning : str
    """

    name: str
    kind: FieldType
    unit: str
    meaning: str


def row(kind: FieldType, meaning: str, unit: str = "") -> Any:
    """Declare a dataclass field together with its row of the format table."""
    return dataclasses.field(metadata={ROW: (kind, unit, meaning)})


@cache
def rows_of(layout: type) -> tuple[Row, ...]:
    """The rows of a layout, in file order."""
    return tuple(
        Row(field.name, kind, unit, meaning)
        for field in dataclasses.fields(layout)
        for kind, unit, meaning in [field.metadata[ROW]]
    )


@dataclass(frozen=True)
class Struct(FieldType):
    """The fields of a layout, one after the other; an instance of the dataclass in Python."""

    layout: type

    @property
    def wire(self) -> str:
        return ", ".join(f"`{row.name}` {row.kind.wire}" for row in rows_of(self.layout))

    @property
    def bounds(self) -> str:
        return "; ".join(f"`{row.name}` {row.kind.bounds}" for row in rows_of(self.layout))

    @property
    def smallest(self) -> int:
        return sum(row.kind.smallest for row in rows_of(self.layout))

    @property
    def largest(self) -> int:
        return sum(row.kind.largest for row in rows_of(self.layout))

    def encode(self, value: Any, where: str) -> bytes:
        if not isinstance(value, self.layout):
            raise InvalidArgument(where, shown(value), f"a {self.layout.__name__}")
        parts = [row.kind.encode(getattr(value, row.name), f"{where}.{row.name}") for row in rows_of(self.layout)]
        return b"".join(parts)

    def decode(self, cursor: Cursor, where: str) -> Any:
        return self.layout(
            **{row.name: row.kind.decode(cursor, f"{where}.{row.name}") for row in rows_of(self.layout)}
        )

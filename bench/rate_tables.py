"""The tables of `rate.py`: rows of cells with bars beside the figures, and the figures themselves."""

from __future__ import annotations

import sys
from dataclasses import dataclass, field
from typing import Any

import numpy as np


@dataclass
class Table:
    """Rows of cells, printed in columns; the same rows as numbers for the file."""

    title: str
    head: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    kept: list[dict[str, Any]] = field(default_factory=list)

    def add(self, cells: tuple[str, ...], **figures: Any) -> None:
        """One row, said on the standard error at once."""
        self.rows.append(cells)
        self.kept.append(figures)
        print("   ", " | ".join(cells), file=sys.stderr, flush=True)

    def __str__(self) -> str:
        widths = [max(len(row[i]) for row in (self.head, *self.rows)) for i in range(len(self.head))]
        lines = [
            "  ".join(c.ljust(w) if i == 0 else c.rjust(w) for i, (c, w) in enumerate(zip(row, widths)))
            for row in (self.head, *self.rows)
        ]
        return "\n".join(["", self.title, lines[0].rstrip(), "-" * len(lines[0]), *(x.rstrip() for x in lines[1:])])


def met(value: float | None, bar: float | None, *, most: bool = False) -> str:
    """Whether `value` reaches `bar`; with `most`, whether it stays at or below. "-" where there is no bar."""
    if bar is None or value is None or not np.isfinite(value):
        return "-"
    return "yes" if (value <= bar if most else value >= bar) else "NO"


def times(value: float | None, bar: float | None = None) -> str:
    """A ratio, and its bar behind it."""
    told = "-" if value is None or not np.isfinite(value) else f"{value:.2f}x"
    return told if bar is None else f"{told} ({bar:g}x)"


def best(sizes: dict[str, float]) -> tuple[str, float]:
    """The smallest that is a number."""
    known = {name: size for name, size in sizes.items() if np.isfinite(size)}
    name = min(known, key=lambda n: known[n])
    return name, known[name]

"""How the command line meets its user: tables, notes, one JSON object, progress bars; and no source overwritten."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from touchfield.errors import InvalidArgument

__all__ = ["is_same_file", "keep_source", "progress", "show", "show_rows"]


def is_same_file(a: str | Path, b: str | Path) -> bool:
    """Whether two names stand for one file that is there."""
    return os.path.exists(a) and os.path.exists(b) and os.path.samefile(a, b)


def keep_source(source: str | Path, out: Path) -> None:
    """Refuse to write over what is read.

    Raises
    ------
    InvalidArgument
        If both are one file.
    """
    if is_same_file(source, out):
        raise InvalidArgument(str(out), "the file that is read", "another name", "Name a new file for the result.")


def show(values: Mapping[str, Any], title: str, as_json: bool, notes: tuple[str, ...] = ()) -> None:
    """Print `values` as one JSON object, or as a table with its notes."""
    if as_json:
        sys.stdout.write(json.dumps({**values, "notes": list(notes)}, default=_plain, allow_nan=False) + "\n")
        return
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(title, markup=False, highlight=False, style="bold", soft_wrap=True)
    table = Table(show_header=False, box=None, pad_edge=False)
    for name, value in values.items():
        table.add_row(name, _text(value))
    console.print(table)
    for note in notes:
        console.print(f"note: {note}", markup=False, highlight=False, soft_wrap=True)


def show_rows(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print rows of the same keys as a table, turned: one line for each key, one column for each row."""
    from rich.console import Console
    from rich.table import Table

    console = Console()
    console.print(title, markup=False, highlight=False, style="bold", soft_wrap=True)
    table = Table(show_header=False, box=None, pad_edge=False)
    for key in rows[0]:
        table.add_row(key, *(_text(row[key]) for row in rows))
    console.print(table)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    return str(value)


def _text(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple):
        return " x ".join(_text(v) for v in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return "-" if value is None else str(value)


@contextmanager
def progress(what: str, unit: str = "frame") -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and time left on a terminal, nothing elsewhere; yields ``report(done, total)``."""
    if not sys.stderr.isatty():
        yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, ProgressColumn, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:.2f} {unit}s/s" if task.speed else "")

    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=None)
        yield lambda done, total: bar.update(task, completed=done, total=total)

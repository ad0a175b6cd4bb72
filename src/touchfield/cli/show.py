"""The command line as its user meets it: tables, notes, one JSON object, progress bars; and no source
overwritten.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from touchfield.errors import InvalidArgument
from touchfield.files import keep_sources

if TYPE_CHECKING:
    from rich.console import Console


_GAP = 2  # blanks between columns


def check_results(reads: Sequence[str | Path | None], *results: Path | None) -> None:
    """Check before the work that results can be written, or InvalidArgument.

    The folder of each must be there, and it must be none of the files that are read; None is no file.
    """
    for out in results:
        if out is None:
            continue
        if not out.parent.is_dir():
            raise InvalidArgument(str(out), f"no folder {out.parent}", "a folder that is there")
        keep_sources(out, *(read for read in reads if read is not None))


def literal_console() -> Console:
    """A console that prints names as they are: no emoji for ``:name:``, no styles for ``[name]``."""
    from rich.console import Console

    return Console(emoji=False, markup=False, highlight=False)


@dataclass(frozen=True)
class Answer:
    """Answer of a command: for programs values by stable keys and notes, as one object; for people under a
    title.

    Of `tables` each is the key of rows that people see beside each other, and the words above them; where
    `people` is given it prints in place of all this.
    """

    values: Mapping[str, Any]
    title: str
    notes: Sequence[str] = ()
    tables: Mapping[str, str] = field(default_factory=dict)
    people: Callable[[], None] | None = None

    def show(self, as_json: bool = False, warnings: Sequence[str] = ()) -> None:
        """Print it as one JSON object, with `warnings` if there are any, or for people, who have seen those."""
        if as_json:
            warned = {"warnings": list(warnings)} if warnings else {}
            answer = _unsigned_zeros({**self.values, "notes": list(self.notes), **warned})
            sys.stdout.write(json.dumps(answer, default=_plain, allow_nan=False) + "\n")
        elif self.people is not None:
            self.people()
        else:
            literal_console().print(self.title, style="bold", soft_wrap=True)
            lines = [
                (name, _text(value, name)) for name, value in self.values.items() if name not in self.tables
            ]
            if lines:
                show_table(lines)
            show_notes(self.notes)
            for key, title in self.tables.items():
                part = self.values.get(key)
                if part:
                    show_rows([part] if isinstance(part, Mapping) else part, title)


def show_notes(notes: Sequence[str]) -> None:
    """Print notes, one a line."""
    console = literal_console()
    for note in notes:
        console.print(f"note: {note}", soft_wrap=True)


def show_rows(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print rows of the same keys as a table, turned: one line for each key, one column for each row.

    Where the page is too narrow for all of them, further columns follow below, beside the keys again.
    """
    console = literal_console()
    if title:
        console.print(title, style="bold", soft_wrap=True)
    keys = [key for key in rows[0] if key != "error_thirds_mn"]  # 39 numbers for programs
    columns = [[_text(row[key], key) for key in keys] for row in rows]
    room = console.width - max(map(len, keys))
    while columns:
        ends = accumulate(_GAP + max(map(len, column)) for column in columns)
        count = max(1, sum(end <= room for end in ends))
        show_table(list(zip(keys, *columns[:count], strict=True)))
        columns = columns[count:]
        if columns:
            console.print()


def show_table(
    lines: Sequence[Sequence[str]],
    headings: Sequence[str] = (),
    title: str | None = None,
    right: Sequence[int] = (),
    whole: int = 1,
) -> None:
    """Print lines of cells; what is too long goes on below, and nothing is cut off.

    Columns `right`, counted from 0, are flush right; the first `whole` are not broken.
    """
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, _GAP, 0, 0))
    table.show_header = bool(headings)
    for place, heading in enumerate(headings or [""] * len(lines[0] if lines else ())):
        justify: Literal["left", "right"] = "right" if place in right else "left"
        table.add_column(heading, justify=justify, overflow="fold", no_wrap=place < whole)
    for line in lines:
        table.add_row(*line)
    literal_console().print(table)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return _unsigned_zeros(value.tolist())
    return str(value)


def _unsigned_zeros(value: Any) -> Any:
    """The same with 0 for each -0, which differs from it for nobody who reads it."""
    if isinstance(value, float):
        return float(value) + 0.0
    if isinstance(value, Mapping):
        return {key: _unsigned_zeros(v) for key, v in value.items()}
    if isinstance(value, list | tuple):
        return [_unsigned_zeros(v) for v in value]
    return value


def _text(value: Any, name: str = "") -> str:
    if isinstance(value, float):
        return f"{value + 0.0:.6g}" if math.isfinite(value) else str(value)
    if isinstance(value, list | tuple) and any(isinstance(v, Mapping) for v in value):
        return f"{len(value)}, told by --json"
    if isinstance(value, list | tuple):
        is_size = name.endswith(("shape", "spacing_mm", "points"))  # a place is none
        return (" x " if is_size else ", ").join(_text(v) for v in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v, k)}" for k, v in value.items())
    return "-" if value is None else str(value)


@contextmanager
def progress(
    what: str, later: Sequence[str] = (), compiles: bool = True
) -> Iterator[Callable[[int, int], None]]:
    """A bar with the time left on a terminal, nothing elsewhere; yields ``report(done, total)``.

    `later` are the kernels that helpers compile ahead, if any need be compiled; without `compiles` none does.
    """

    def compilation(tell: Callable[[str], None]) -> AbstractContextManager[None]:
        return compilation_told(tell, later) if compiles else nullcontext()

    if not sys.stderr.isatty():
        with compilation(lambda line: None):
            yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress

    columns = *Progress.get_default_columns(), MofNCompleteColumn()
    with Progress(*columns, console=Console(stderr=True, emoji=False), transient=True) as bar:
        task = bar.add_task(what, total=None)
        with compilation(lambda line: bar.console.print(line, highlight=False)):
            yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def compilation_told(tell: Callable[[str], None], later: Sequence[str] = ()) -> Iterator[None]:
    """Tell, in one line, that kernels are compiled, and have helpers compile those of `later`.

    Where all come from the cache nothing is told, and no helper started.
    While they are, no garbage is collected: a compiler makes little of it, and a seventh of its time went
    there. An interrupt that comes where a compiler lets none out, and would go on or fail, ends the job like
    any other.
    """
    import gc

    from numba.core.event import Event, Listener, install_listener

    from touchfield.cli.ahead import helpers

    class First(Listener):
        told = False
        depth = 0

        def on_start(self, event: Event) -> None:
            self.depth += 1
            if not self.told:
                self.told = True
                tell(
                    "compiling kernels, once: some 10 to 30 s, kept for later runs (touchfield warmup "
                    "compiles all)"
                )
                start_helpers()
            gc.disable()

        def on_end(self, event: Event) -> None:
            self.depth -= 1
            if not self.depth:
                gc.enable()
            if lost:
                raise KeyboardInterrupt

    usual, lost = sys.unraisablehook, []

    def unraisable(event: sys.UnraisableHookArgs) -> None:
        if event.exc_type is KeyboardInterrupt:
            lost.append(True)
        else:
            usual(event)

    sys.unraisablehook = unraisable
    try:
        with helpers(later) as start_helpers, install_listener("numba:compile", First()):
            yield
    finally:
        sys.unraisablehook = usual

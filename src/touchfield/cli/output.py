"""Prints the results of all commands: tables, notes, one JSON object, progress bars. It also checks, before
the work starts, that output files can be written."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Literal

import typer

from touchfield._version import __version__
from touchfield.errors import InvalidArgument, printable, require_ending
from touchfield.files import refuse_overwriting
from touchfield.viewer.page import require_matplotlib

if TYPE_CHECKING:
    from rich.console import Console


_GAP = 2  # blanks between columns


def check_results(
    reads: Sequence[str | Path | None], *results: Path | None, plot: Path | None = None
) -> None:
    """Raise InvalidArgument before the work if a result cannot be written.

    The folder of each result must exist, and no result may be one of the files that are read, or another
    result. `plot` is a result that is drawn, and ends in .png: MissingExtra if matplotlib is not installed.
    None is ignored.
    """
    if plot is not None:
        require_matplotlib(f"the picture {plot}")
    named = [out for out in (*results, plot) if out is not None]
    for n, out in enumerate(named):
        if out.absolute() in (other.absolute() for other in named[:n]):
            raise InvalidArgument(str(out), "the name of two results", "a name for each")
        if not out.parent.is_dir():
            raise InvalidArgument(
                str(out), f"no folder {out.parent}", "a folder that is there", "Make it first."
            )
        refuse_overwriting(out, *(read for read in reads if read is not None))
    if plot is not None:
        require_ending(plot, "PICTURE.png")


def echo(text: str, *, to_stderr: bool = False) -> None:
    """Print a text that may contain names from files, with its `printable` characters only."""
    typer.echo(printable(text), err=to_stderr)


def literal_console() -> Console:
    """A console that prints names as they are: no emoji for ``:name:``, no styles for ``[name]``.

    Of all texts, cells of tables too, it prints `printable` characters only.
    """
    from rich.console import Console
    from rich.text import Text

    class LiteralConsole(Console):
        def render_str(self, text: str, **options: Any) -> Text:
            """Render a text, which may contain names from files."""
            return super().render_str(printable(text), **options)

    return LiteralConsole(emoji=False, markup=False, highlight=False)


@dataclass(frozen=True)
class Answer:
    """Result of a command, printed as one JSON object or as text.

    values : results by stable keys.
    title : heading of the text.
    notes : printed after the values, and the key "notes" of the JSON object.
    tables : key of each value that the text shows as a table of rows, and the table's title.
    print_text : prints the whole text in place of the default.
    """

    values: Mapping[str, Any]
    title: str
    notes: Sequence[str] = ()
    tables: Mapping[str, str] = field(default_factory=dict)
    print_text: Callable[[], None] | None = None

    def show(self, as_json: bool = False, warnings: Sequence[str] = (), sources: Sequence[str] = ()) -> None:
        """Print it as one JSON object with `warnings`, if any, or as text, after warnings were printed.

        The object has the version of touchfield under the key "touchfield". `sources`, if any, are those
        behind the figures.
        """
        if as_json:
            added = {"warnings": list(warnings), "sources": list(sources)}
            added = {key: texts for key, texts in added.items() if texts}
            answer = {**self.values, "touchfield": __version__, "notes": list(self.notes), **added}
            sys.stdout.write(json.dumps(_unsigned_zeros(answer), default=_plain, allow_nan=False) + "\n")
            return
        self._print()
        for source in sources:
            literal_console().print(f"source: {source}", soft_wrap=True)

    def _print(self) -> None:
        if self.print_text is not None:
            self.print_text()
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


HAND_TABLES: Final = {
    "slides": "a hand that slides at |F| = 1 N, 40 to 400 Hz",
    "hold": "a hand that holds still, frame to frame and 40 to 400 Hz",
}
"""Tables of what a hand feels of a coding."""


def show_notes(notes: Sequence[str]) -> None:
    """Print notes, one a line."""
    console = literal_console()
    for note in notes:
        console.print(f"note: {note}", soft_wrap=True)


def show_rows(rows: Sequence[Mapping[str, Any]], title: str) -> None:
    """Print rows of the same keys as a transposed table: one line for each key, one column for each row.

    If the terminal is too narrow, the remaining columns follow below with the keys repeated.
    """
    console = literal_console()
    if title:
        console.print(title, style="bold", soft_wrap=True)
    keys = [key for key in rows[0] if key != "error_thirds_mn"]  # 39 numbers for programs
    columns = [[_text(row[key], key) for key in keys] for row in rows]
    width = console.width - max(map(len, keys))
    while columns:
        right_edges = accumulate(_GAP + max(map(len, column)) for column in columns)
        count = max(1, sum(end <= width for end in right_edges))
        show_table(list(zip(keys, *columns[:count], strict=True)))
        columns = columns[count:]
        if columns:
            console.print()


def show_table(
    lines: Sequence[Sequence[str]],
    headings: Sequence[str] = (),
    title: str | None = None,
    right: Sequence[int] = (),
    unbroken: int = 1,
) -> None:
    """Print lines of cells; long cells are wrapped, never truncated.

    Columns `right`, counted from 0, are right-aligned; the first `unbroken` columns are not wrapped.
    """
    from rich.table import Table

    table = Table(title=title, title_justify="left", box=None, pad_edge=False, padding=(0, _GAP, 0, 0))
    table.show_header = bool(headings)
    for column, heading in enumerate(headings or [""] * len(lines[0] if lines else ())):
        justify: Literal["left", "right"] = "right" if column in right else "left"
        table.add_column(heading, justify=justify, overflow="fold", no_wrap=column < unbroken)
    for line in lines:
        table.add_row(*line)
    literal_console().print(table)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return _unsigned_zeros(value.tolist())
    return str(value)


def _unsigned_zeros(value: Any) -> Any:
    """Return `value` with each -0.0 replaced by 0.0."""
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
        return f"{len(value)}, see --json"
    if isinstance(value, list | tuple):
        is_size = name.endswith(("shape", "spacing_mm", "points"))  # a place is none
        return (" x " if is_size else ", ").join(_text(v) for v in value)
    if isinstance(value, Mapping):
        return ", ".join(f"{k} {_text(v, k)}" for k, v in value.items())
    return "-" if value is None else str(value)


@contextmanager
def progress(
    label: str, later: Sequence[str] = (), compiles: bool = True
) -> Iterator[Callable[[int, int], None]]:
    """Show a progress bar on a terminal, nothing elsewhere; yield ``report(done, total)``.

    `later` are the groups of kernels that helpers compile ahead if anything has to be compiled. Without
    `compiles` the job compiles nothing.
    """

    def compilation(announce: Callable[[str], None]) -> AbstractContextManager[None]:
        return announce_compilation(announce, later) if compiles else nullcontext()

    if not sys.stderr.isatty():
        with compilation(lambda line: None):
            yield lambda done, total: None
        return
    from rich.console import Console
    from rich.progress import MofNCompleteColumn, Progress

    columns = *Progress.get_default_columns(), MofNCompleteColumn()
    with Progress(*columns, console=Console(stderr=True, emoji=False), transient=True) as bar:
        task = bar.add_task(label, total=None)
        with compilation(lambda line: bar.console.print(line, highlight=False)):
            yield lambda done, total: bar.update(task, completed=done, total=total)


@contextmanager
def announce_compilation(announce: Callable[[str], None], later: Sequence[str] = ()) -> Iterator[None]:
    """Announce in one line that kernels are compiled, and let helpers compile those of `later`.

    If all kernels come from the cache, nothing is announced and no helper is started. Garbage collection is
    off during compilation: it took a seventh of the time and found little. An interrupt that the compiler
    swallows still ends the job.
    """
    import gc

    from touchfield.cli.compile_ahead import helpers
    from touchfield.compute.compilation import compilation_events

    depth, is_announced = 0, False

    def on_start() -> None:
        nonlocal depth, is_announced
        depth += 1
        if not is_announced:
            is_announced = True
            announce(
                "compiling kernels, once: some 10 to 30 s, stored for later runs (touchfield warmup "
                "compiles all)"
            )
            start_helpers()
        gc.disable()

    def on_end() -> None:
        nonlocal depth
        depth -= 1
        if not depth:
            gc.enable()
        if interrupts:
            raise KeyboardInterrupt

    usual, interrupts = sys.unraisablehook, []

    def unraisable(event: sys.UnraisableHookArgs) -> None:
        if event.exc_type is KeyboardInterrupt:
            interrupts.append(True)
        else:
            usual(event)

    sys.unraisablehook = unraisable
    try:
        with helpers(later) as start_helpers, compilation_events(on_start, on_end):
            yield
    finally:
        sys.unraisablehook = usual

"""Code that all benchmarks share: command line, tables, pass or fail of limits (*bars*), stored results."""

from __future__ import annotations

import argparse
import json
import math
import os
import platform
import sys
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from fnmatch import fnmatch
from importlib import import_module, metadata
from pathlib import Path
from typing import Any, NoReturn

import provenance
from timing import timed as timed
from touchfield.errors import MissingExtra

RESULTS = Path(__file__).parent / "results"
SHARED = Path(__file__).resolve().parents[2] / "shared" / "data"
"""Optional folder of real inputs."""
WIDEST = 9
"""Largest number of columns of a table; wider rows are printed one by one."""
REASONS = Path(__file__).parent / "reasons.toml"
"""Why bars are not met, by benchmark and name of the bar."""
SKIPPED = 77
"""Exit status of a benchmark whose requirements are missing."""
ABOUT = ("machine", "run", "code", "bars")
"""Keys of a stored result that are not figures."""
QUICK = Path(__file__).parent / "reference" / "quick"
"""Exact figures of quick runs by their path, a file for each benchmark."""
STORE_QUICK = "TOUCHFIELD_BENCH_STORE_QUICK"
EXACT = (
    *("*bytes*", "*voxels*", "*support*", "*bricks*", "*triangles*", "*tiles*", "*cases*"),
    *("*db", "*ratio*", "*worst*"),
)
"""Patterns of the paths of figures that are equal in every run."""
NOT_EXACT = (
    *("*peer*", "*/numpy/*", "*/warp/*", "*_ms*", "*_us*", "*_s", "*seconds", "*_mb", "*per_s*", "*_hz*"),
    "absent*",
)
"""Patterns of the paths that are left out of these, such as times and peers."""
SAME = 0.02
"""Tolerated relative difference of exact figures between machines.

The order of summation depends on the processor, and choices of an encoder depend on it. On one machine the
figures are equal.
"""
NOT_MEASURED = "not measured: "
"""Begins the text that stands for figures whose requirements are missing; the reason follows."""
VERDICTS = {True: "met", False: "NOT MET", None: "not measured"}

Figures = dict[str, Any]
Bar = dict[str, Any]
"""A limit on a figure.

Keys: "bar" (its name), "measured", "way" ("at most" or "at least"), "limit", "unit", "met".
"""


# -- the machine -------------------------------------------------------------------------------------------


def machine() -> Figures:
    """Return processor, cores and versions."""
    model = platform.processor() or platform.machine()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [
            line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line
        ]
        model = names[0] if names else model
    versions = {}
    for name in ("numpy", "numba", "touchfield"):
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "from source"
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {"processor": model, "cores": cores, "python": sys.version.split()[0], **versions}


# -- bars --------------------------------------------------------------------------------------------------


def at_most(name: str, measured: float | None, limit: float, unit: str = "") -> Bar:
    """Return a bar for a figure that may not be larger; None is not measured."""
    return _bar(name, measured, "at most", limit, unit)


def at_least(name: str, measured: float | None, limit: float, unit: str = "") -> Bar:
    """Return a bar for a figure that may not be smaller; None is not measured."""
    return _bar(name, measured, "at least", limit, unit)


def _bar(name: str, measured: float | None, way: str, limit: float, unit: str) -> Bar:
    measured = None if measured is None or math.isnan(measured) else measured
    met = None if measured is None else bool(measured <= limit if way == "at most" else measured >= limit)
    return {"bar": name, "measured": measured, "way": way, "limit": limit, "unit": unit, "met": met}


def figure(figures: Any, *keys: Any) -> Any:
    """Return the figure under nested keys; None if a run did not measure it."""
    for key in keys:
        if not isinstance(figures, Mapping) or key not in figures:
            return None
        figures = figures[key]
    return figures


def column(rows: Mapping[str, Figures] | Iterable[Figures], key: str) -> list[Any]:
    """Return the values of `key` in the rows that have it."""
    every = rows.values() if isinstance(rows, Mapping) else rows
    return [row[key] for row in every if row.get(key) is not None]


def bar_line(bar: Bar, why: str = "") -> str:
    """Format a bar as a line: verdict, name, measured, limit; another one says why it is not met."""
    measured, limit = (f"{text(bar[key])} {bar['unit']}".strip() for key in ("measured", "limit"))
    line = f"{VERDICTS[bar['met']]:12} {bar['bar']}: {measured} ({bar['way']} {limit})"
    return f"{line}\n{'':12} {why}" if why and not bar["met"] else line


def reasons(name: str) -> dict[str, str]:
    """Return why bars of a benchmark are not met or not measured, by the pattern of their names."""
    return dict(tomllib.loads(REASONS.read_text(encoding="utf-8")).get(name, {}))


def reason(name: str, bar: Bar) -> str:
    """Return why a bar is not met; empty if it is met, or if nobody has said why."""
    found = (why for pattern, why in reasons(name).items() if fnmatch(bar["bar"], pattern))
    return "" if bar["met"] else next(found, "")


# -- printing ----------------------------------------------------------------------------------------------


def text(value: Any) -> str:
    """Format a cell of a table."""
    if value is None or isinstance(value, bool):
        return {None: "-", True: "yes", False: "no"}[value]
    if isinstance(value, float) or hasattr(value, "dtype"):
        if not math.isfinite(value):
            return "-"
        return f"{value:,.0f}" if abs(value) >= 1e4 else f"{value:.4g}"
    if isinstance(value, (list, tuple)):
        return f"[{', '.join(map(text, value))}]"
    return f"{value:,}" if isinstance(value, int) else str(value)


def table(title: str, head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Format rows in columns; the first column is aligned to the left."""
    widths = [max(map(len, each)) for each in zip(head, *rows, strict=True)]
    lines = ["  ".join([r[0].ljust(widths[0]), *map(str.rjust, r[1:], widths[1:])]) for r in (head, *rows)]
    return "\n".join(["", title, lines[0], "-" * len(lines[0]), *lines[1:]])


def show(figures: Figures, title: str = "") -> None:
    """Print figures: single numbers as lines, rows as a table."""
    single = {
        key: value for key, value in figures.items() if not isinstance(value, dict) and not _is_rows(value)
    }
    if single:
        print(f"{title}: " * bool(title) + ", ".join(f"{key} {text(value)}" for key, value in single.items()))
    for key, value in figures.items():
        name = f"{title}, {key}" if title else key
        if key in single or not value:
            continue
        if _is_rows(value):
            rows = [{"": str(n), **_flat(row)} for n, row in enumerate(value)]
        elif all(isinstance(row, dict) for row in value.values()):
            rows = [{"": row_name, **_flat(row)} for row_name, row in value.items()]
        else:
            show(value, name)
            continue
        head = list(dict.fromkeys(key for row in rows for key in row))
        if len(head) <= WIDEST:
            print(table(name, head, [[text(row.get(key)) for key in head] for row in rows]))
        else:
            for row in rows:
                cells = ", ".join(f"{key} {text(cell)}" for key, cell in row.items() if key)
                print(f"{name}, {row['']}: {cells}")


def _is_rows(value: Any) -> bool:
    return isinstance(value, list) and len(value) > 0 and isinstance(value[0], dict)


def _flat(row: Figures) -> Figures:
    """A row with nested rows flattened."""
    flat: Figures = {}
    for key, value in row.items():
        flat |= (
            {f"{key} {k}": v for k, v in _flat(value).items()} if isinstance(value, dict) else {key: value}
        )
    return flat


# -- the command -------------------------------------------------------------------------------------------


def arguments(doc: str | None, options: Mapping[str, tuple[Any, Any]]) -> tuple[Figures, bool]:
    """Parse the options; return their values, and whether the run is quick.

    Each option has a value, and a smaller one for quick runs.
    """
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small settings; no result is kept")
    for name, (value, small) in options.items():
        if value is False:
            parser.add_argument(f"--{name}", action="store_true", default=None)
        else:
            parser.add_argument(f"--{name}", type=type(value), help=f"{value}; quickly {small}")
    parsed = vars(parser.parse_args())
    is_quick = parsed.pop("quick")
    values = {name: (small if is_quick else value) for name, (value, small) in options.items()}
    return values | {name: value for name, value in parsed.items() if value is not None}, is_quick


def leave_out(reason: str) -> NoReturn:
    """End a benchmark that cannot run here: print the reason, exit with `SKIPPED`."""
    print(f"left out: {reason}", flush=True)
    sys.exit(SKIPPED)


def need_module(name: str) -> None:
    """Skip a benchmark if a library that it measures cannot be imported."""
    try:
        import_module(name)
    except Exception as error:  # zarr raises a ValueError next to zfpy 1.0.1.post0
        leave_out(f"{name} does not import: {type(error).__name__}: {error}")


def keep(
    name: str,
    figures: Figures,
    bars: list[Bar],
    is_quick: bool = False,
    run: Figures | None = None,
    code: dict[str, str] | None = None,
) -> None:
    """Print a verdict for each bar; write ``results/NAME.json``.

    The file has machine, run, code, figures and bars. A quick run is not stored.
    """
    print()
    for bar in bars:
        print(bar_line(bar, reason(name, bar)))
    print(f"{sum(bar['met'] is True for bar in bars)} of {len(bars)} bars met", flush=True)
    if not is_quick:
        figures = {key: value for key, value in figures.items() if key not in ABOUT}
        about = {"machine": machine(), "run": run, "code": None if code is None else provenance.overall(code)}
        write(name, {**about, **figures, "bars": bars})
        if code is not None:
            provenance.write_code(code_path(name), code)


def code_path(name: str) -> Path:
    """Return the path of the hashes of the files that a result was measured with."""
    return RESULTS / "code" / f"{name}.txt"


def write(name: str, content: Figures) -> None:
    """Write ``results/NAME.json``."""
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / f"{name}.json").write_text(json.dumps(content, indent=1, default=float) + "\n")


def stored(name: str) -> Figures:
    """Return the result of the last run; empty if there was none."""
    path = RESULTS / f"{name}.json"
    return dict(json.loads(path.read_text())) if path.exists() else {}


def stale(name: str) -> list[str]:
    """Return files that have changed since the stored result was measured.

    Empty if the result is up to date.
    """
    return provenance.changed(code_path(name), stored(name).get("code"))


# -- exact figures -----------------------------------------------------------------------------------------


def exact_figures(figures: Figures, without: Iterable[str] = ()) -> dict[str, float]:
    """Return reproducible numbers by their path: bytes, counts, errors of touchfield.

    Figures of peers and times are left out, and those that match a pattern of `without`.
    """
    patterns = [*NOT_EXACT, *without]
    return {
        path: value
        for path, value in _numbers(figures)
        if any(fnmatch(path, pattern) for pattern in EXACT)
        and not any(fnmatch(path, pattern) for pattern in patterns)
    }


def _numbers(value: Any, path: str = "") -> Iterator[tuple[str, float]]:
    """Yield every finite number in `value`, with its path of keys."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from _numbers(part, f"{path}/{key}" if path else str(key))
    elif isinstance(value, (list, tuple)):
        for index, part in enumerate(value):
            yield from _numbers(part, f"{path}/{_name_of(part) or index}")
    elif value is not None and not isinstance(value, str) and math.isfinite(value):
        yield path, float(value)


def _name_of(row: Any) -> str:
    """Join the texts of a row, which identify it independently of its position."""
    texts = [cell for cell in row.values() if isinstance(cell, str)] if isinstance(row, Mapping) else []
    return ", ".join(texts)


def not_measured(reason: str) -> str:
    """Return the text that stands in place of figures which cannot be measured here."""
    return NOT_MEASURED + reason


def is_not_measured(figures: Any, path: str) -> bool:
    """Return whether a figure, or the group of figures that it belongs to, says why it was not measured."""
    if isinstance(figures, str):
        return figures.startswith(NOT_MEASURED)
    if not isinstance(figures, Mapping):
        return False
    return any(
        is_not_measured(part, path[len(str(key)) + 1 :])
        for key, part in figures.items()
        if path == str(key) or path.startswith(f"{key}/")
    )


def stored_quick(name: str) -> dict[str, float]:
    """Return the exact figures of a quick run; empty if none are stored."""
    path = QUICK / f"{name}.json"
    return dict(json.loads(path.read_text())) if path.exists() else {}


def quick_differences(name: str, figures: Figures, without: Iterable[str] = ()) -> list[str]:
    """Return a line for each exact figure of a quick run that differs from the stored.

    Missing figures do not count where the optional folder of inputs is absent, nor those that say why they
    were not measured (`not_measured`).
    """
    found, lines = exact_figures(figures, without), []
    for path, before in stored_quick(name).items():
        now = found.get(path)
        if now is None and (not SHARED.is_dir() or is_not_measured(figures, path)):
            continue
        if now is None or abs(now - before) > SAME * abs(before):
            lines.append(f"{path}: {text(now)} (stored {text(before)})")
    return lines


def check_quick(name: str, figures: Figures, without: Iterable[str] = ()) -> None:
    """Compare a quick run with the stored exact figures.

    Stores them instead if `STORE_QUICK` is set. SystemExit, with the figures, if any differs.
    """
    if os.environ.get(STORE_QUICK):
        QUICK.mkdir(parents=True, exist_ok=True)
        content = json.dumps(exact_figures(figures, without), indent=1, sort_keys=True)
        (QUICK / f"{name}.json").write_text(content + "\n")
        return
    if lines := quick_differences(name, figures, without):
        hint = "If the change is meant, store them anew: bench/run_all.py --store-quick"
        sys.exit("\n".join(["exact figures differ from bench/reference/quick:", *lines, hint]))


# -- a benchmark -------------------------------------------------------------------------------------------


def bench(
    name: str,
    doc: str | None,
    measure: Callable[..., Figures],
    bars: Callable[[Figures], list[Bar]],
    *,
    reads: Iterable[str] = (),
    without: Iterable[str] = (),
    **options: tuple[Any, Any],
) -> list[Bar]:
    """Run a benchmark: measure, print and store its figures and their bars.

    Parameters
    ----------
    measure : callable
        Called with the options as keywords; returns the figures.
    bars : callable
        Returns the bars of the figures.
    reads : iterable of str
        Patterns of files that are measured and not imported by Python.
    without : iterable of str
        Patterns of figures that differ between runs although they are named like exact ones.
    options : (value, value)
        The value of each option, and that of quick runs.
    """
    values, is_quick = arguments(doc, options)
    trace, run = provenance.Trace(), provenance.Run()
    try:
        figures = measure(**values)
    except MissingExtra as error:
        leave_out(str(error))
    show(figures)
    verdicts = bars(figures)
    keep(name, figures, verdicts, is_quick, run.summary(), provenance.code_of(trace.files(reads)))
    if is_quick:
        check_quick(name, figures, without)
    return verdicts

"""Damages valid files of every format that strangers send, reads them, and counts what is no clear refusal.

    python bench/bench_parsers.py [--quick] [--runs N] [--seconds S] [--seed S] [--only NAME]

Each format of `parser_formats` gets `runs` cases, or as many as end in `seconds` seconds; a full run takes an
hour or two. With `--only`, the rows of other formats stay as they are stored, with the commit of each. A case
is "read" or "refused" in a line that names the file; anything else is a fault: another exception, a warning,
a process that dies or hangs, more time or memory than the bytes allow, a file that is opened outside the
folder (`parser_worker`). Inputs of faults are found again by ``fuzz_parsers.py --replay NAME SEED NUMBER``.

Time is that of the processor, in which a library may be imported and loops be compiled. Memory is the growth
of the resident memory. A quick run is a few cases of each format. Whether a case is read or refused depends
on the versions of the libraries, and so these counts are no exact figures.
"""

from __future__ import annotations

from typing import Any

import provenance
from fuzz_parsers import Child, Tally, fuzz
from machine import Bar, Figures, at_least, at_most, bench, column, stored
from parser_formats import formats

RUNS = 10_000
QUICK_RUNS = 3


def row_of(tally: Tally, seed: int, commit: str) -> dict[str, Any]:
    """Return the row of a format."""
    counts = tally.counts
    return {
        "commit": commit,
        "runs": counts.total(),
        "read": counts["read"],
        "refused": counts["refused"],
        "faults": counts["FAULT"],
        "slowest_s": round(tally.slowest_s, 3),
        "peak_mb": round(tally.peak_mib, 1),
        "replay": [f"{tally.name} {seed} {numbers[0]}" for numbers in tally.faults.values()],
    }


def stored_rows() -> dict[str, dict[str, Any]]:
    """Return the rows of the stored result."""
    before = stored("parsers")
    return {name: {"commit": before["run"]["commit"], **row} for name, row in before.get("rows", {}).items()}


def measure(runs: int, seconds: float, seed: int, only: str) -> Figures:
    """Run the cases of every format, or those of one, whose row of the stored result is replaced."""
    child, commit = Child(), provenance.Run().summary()["commit"]
    rows = stored_rows() if only else {}
    for entry in formats():
        if only in ("", entry.name):
            tally = fuzz(child, entry.name, runs, seconds, seed)
            row = rows[entry.name] = row_of(tally, seed, commit)
            print(f"{entry.name}: {row['runs']} cases, {row['faults']} faults", flush=True)
    child.end()
    return {
        "runs": sum(column(rows, "runs")),
        "requested_runs": runs,
        "seed": seed,
        "rows": rows,
    }


def bars(figures: Figures) -> list[Bar]:
    """Require that every format is run, without a fault."""
    rows = figures["rows"]
    return [
        at_least("formats", len(rows), 40),
        at_least(
            "runs of the format with the fewest",
            min(column(rows, "runs"), default=None),
            figures["requested_runs"],
        ),
        at_most("faults", sum(column(rows, "faults")), 0),
    ]


if __name__ == "__main__":
    bench(
        "parsers",
        __doc__,
        measure,
        bars,
        runs=(RUNS, QUICK_RUNS),
        seconds=(900.0, 20.0),
        seed=(0, 0),
        only=("", ""),
    )

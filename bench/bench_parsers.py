"""Damages valid files of every format that strangers send, reads them, and counts what is no clear refusal.

    python bench/bench_parsers.py [--quick] [--runs N] [--seconds S] [--seed S] [--only NAME]
                                   [--again N]

Each format of `parser_formats` gets `runs` cases, or as many as end in `seconds` seconds; a full run takes an
hour or two. With `--only`, the rows of other formats stay as they are stored, with the commit of each. With
`--again N`, all rows stay, and each format gets N other cases, or those of `seconds`, with today's readers:
their commit, number and faults are stored beside. A case is "read" or "refused" in a line that names the
file; anything else is a fault: another exception, a warning, a process that dies or hangs, more time or
memory than the bytes allow, a file that is opened outside the folder (`parser_worker`). Inputs of faults are
found again by ``fuzz_parsers.py --replay NAME SEED NUMBER``.

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


def again_of(tally: Tally, seed: int, commit: str) -> dict[str, Any]:
    """Return what a row states of cases that were run again."""
    row = row_of(tally, seed, commit)
    return {f"again_{key}": row[key] for key in ("commit", "runs", "faults", "replay")}


def measure(runs: int, seconds: float, seed: int, only: str, again: int) -> Figures:
    """Run the cases of every format, or of one; other rows, or the older cases, are the stored ones."""
    child, commit = Child(), provenance.Run().summary()["commit"]
    rows = stored_rows() if only or again else {}
    for entry in formats():
        if only not in ("", entry.name):
            continue
        if again:
            tally = fuzz(child, entry.name, again, seconds, seed + 1, first=runs)
            rows[entry.name] |= again_of(tally, seed + 1, commit)
        else:
            tally = fuzz(child, entry.name, runs, seconds, seed)
            rows[entry.name] = row_of(tally, seed, commit)
        cases, faults = tally.counts.total(), tally.counts["FAULT"]
        print(f"{entry.name}: {cases} cases, {faults} faults", flush=True)
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
    found = [
        at_least("formats", len(rows), 40),
        at_least(
            "runs of the format with the fewest",
            min(column(rows, "runs"), default=None),
            figures["requested_runs"],
        ),
        at_most("faults", sum(column(rows, "faults")), 0),
    ]
    if again := column(rows, "again_faults"):
        found.append(at_most(f"faults of cases run again, {len(again)} formats", sum(again), 0))
    return found


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
        again=(0, 0),
    )

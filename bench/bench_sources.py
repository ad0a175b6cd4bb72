"""Brings inputs of many kinds in as a user would, right ones and wrong ones, and checks what comes in.

    python bench/bench_sources.py [--quick] [--nw N] [--only NAME]

Each input of `tests/source_corpus.py` is written by a function and encoded with what a user would type first.
It is right if it goes in at the first try, or is refused in one line, or read with a note, that names a fix
which works: `tests/source_trial.py` runs the fix once, and checks again. Conversions by programs that are not
installed here are counted apart. Inputs whose writers need a missing library are left out and named.

What comes in is measured in the decoded ``.touch`` file, against truths known by construction: where a hand
meets the surface (at most 1.5 spacings of the lattice off, along its normal), the force at points, the
actuator that is driven, the number of frames. `error` is relative to what is allowed.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path
from typing import Any

from machine import Bar, Figures, at_least, at_most, bench, column

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))
from source_corpus import CORPUS, Input
from source_trial import try_input

NOT_RUN = "fix not run here"


def row_of(entry: Input, nw: int) -> dict[str, Any]:
    """Bring one input in; return its row."""
    with tempfile.TemporaryDirectory() as folder:
        outcome = try_input(entry, Path(folder), nw)
    typed = " ".join([entry.command, "X", "out.touch", *entry.options])
    if not outcome.is_right:
        print(f"{entry.name}: {outcome.text}\n{outcome.message}", flush=True)
    return {
        "kind": entry.kind,
        "typed": typed,
        "outcome": outcome.text,
        "error": outcome.error,
        "checked": outcome.comment,
    }


def measure(nw: int, only: str) -> Figures:
    """Bring every input in; return the table, and counts by outcome."""
    chosen = [entry for entry in CORPUS if not only or entry.name == only]
    absent = [f"{entry.name} ({', '.join(entry.needs)})" for entry in chosen if not entry.is_available]
    rows = {entry.name: row_of(entry, nw) for entry in chosen if entry.is_available}
    texts = column(rows, "outcome")
    return {
        "inputs": len(rows),
        "kinds": len(set(column(rows, "kind"))),
        "read_at_once": sum(text == "read" for text in texts),
        "noted_with_a_fix": sum(text.startswith("noted") for text in texts),
        "refused_with_a_fix": sum(text.startswith("refused") and NOT_RUN not in text for text in texts),
        "fixes_not_run_here": sum(NOT_RUN in text for text in texts),
        "wrong": sum(text.startswith("WRONG") for text in texts),
        "rows": rows,
        "absent": absent,
    }


def bars(figures: Figures) -> list[Bar]:
    """Require 40 inputs of 25 kinds, all of which go in or are refused with a fix that works."""
    return [
        at_least("inputs", figures["inputs"], 40),
        at_least("kinds of input", figures["kinds"], 25),
        at_most("inputs that go in wrong, or without a fix that works", figures["wrong"], 0),
        at_most("largest error of what came in", max(column(figures["rows"], "error"), default=None), 1.0),
    ]


if __name__ == "__main__":
    bench("sources", __doc__, measure, bars, nw=(6, 5), only=("", ""))

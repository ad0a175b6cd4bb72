"""Fuzzes every reader of files that strangers send: damages valid files by their structure, and reads them.

    python bench/fuzz_parsers.py [--runs N] [--seconds S] [--seed S] [--first N] [--only NAME ...]
        [--folder DIR] [--replay NAME SEED NUMBER]

A case is named by format, seed and number, and is the same in every run. What makes a fault is in
`parser_worker`. Each distinct fault is printed once, and its input is saved below `--folder`. A process that
dies or hangs is a fault of its case, and another one goes on. `--runs` and `--seconds` limit each format;
`--first` goes on where a run ended. `--replay` runs one case here, with the whole traceback.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import re
import sys
import tempfile
import time
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from parser_formats import formats
from parser_worker import MEBI, Bench, Outcome, rewrite, serve

WAIT_SECONDS: Final = 120.0
"""Wall seconds without an answer after which a process is ended."""
START_SECONDS: Final = 600.0


@dataclass
class Tally:
    """Outcomes of the cases of a format."""

    name: str
    counts: Counter[str] = field(default_factory=Counter)
    faults: dict[str, list[int]] = field(default_factory=dict)
    slowest_s: float = 0.0
    peak_mib: float = 0.0

    def add(self, number: int, outcome: Outcome) -> bool:
        """Count a case; return True if it is the first of its fault."""
        self.counts[outcome.kind] += 1
        self.slowest_s = max(self.slowest_s, outcome.seconds)
        self.peak_mib = max(self.peak_mib, outcome.peak_bytes / MEBI)
        if outcome.kind != "FAULT":
            return False
        kind = re.sub(r"/tmp/\S+|\d+", "#", outcome.text)[:60]
        numbers = self.faults.setdefault(f"{outcome.site} {kind}", [])
        numbers.append(number)
        return len(numbers) == 1


class Child:
    """A process that runs cases, and is started anew after one that ended it."""

    def __init__(self) -> None:
        self.name, self.pipe, self.process = "", *self._started()

    def _started(self) -> tuple[Any, Any]:
        # threads that wait for a core take processor time, which a case has little of
        os.environ |= {"TOUCHFIELD_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
        context = multiprocessing.get_context("spawn")
        pipe, other = context.Pipe()
        process = context.Process(target=serve, args=(other,), daemon=True)
        process.start()
        other.close()
        return pipe, process

    def prepare(self, name: str) -> None:
        """Warm a format up; RuntimeError if a valid input cannot be read."""
        if not self.process.is_alive():
            self.pipe, self.process = self._started()
        self.name = name
        answer = self._answer((name,), START_SECONDS)
        if answer is None:  # as on a machine that had no time for it
            self.process.kill()
            self.pipe, self.process = self._started()
            answer = self._answer((name,), START_SECONDS)
        if answer != "ready":
            silent = f"{name}: the process ended, or read valid inputs for over {START_SECONDS:g} s"
            raise RuntimeError(answer or silent)

    def run(self, name: str, seed: int, number: int) -> Outcome:
        """Run a case; its outcome if the process dies or hangs."""
        if name != self.name or not self.process.is_alive():
            self.prepare(name)
        found = self._answer((name, seed, number), WAIT_SECONDS)
        if isinstance(found, Outcome):
            return found
        self.process.join(5)
        code = self.process.exitcode
        self.process.kill()
        return Outcome("FAULT", "the process hung" if code is None else f"the process died, status {code}")

    def save(self, name: str, seed: int, number: int, folder: Path) -> None:
        """Write the input of a case below `folder`."""
        if name != self.name or not self.process.is_alive():
            self.prepare(name)
        folder.mkdir(parents=True, exist_ok=True)
        target = folder.resolve() / f"{name} {seed} {number}".replace(" ", "-")
        self._answer((name, seed, number, target), WAIT_SECONDS)

    def _answer(self, message: tuple[Any, ...], patience_s: float) -> Any:
        try:
            self.pipe.send(message)
            return self.pipe.recv() if self.pipe.poll(patience_s) else None
        except (EOFError, OSError):
            return None

    def end(self) -> None:
        """End the process; one that answers ends by itself."""
        with suppress(OSError):
            self.pipe.send(None)
        self.process.join(10)
        self.process.kill()
        self.process.join()


def fuzz(
    child: Child,
    name: str,
    runs: int,
    seconds: float,
    seed: int = 0,
    first: int = 0,
    folder: Path | None = None,
) -> Tally:
    """Run cases of a format, and save the first input of each fault below `folder`."""
    tally, number = Tally(name), first
    child.prepare(name)
    end_s = time.monotonic() + seconds
    while number < first + runs and time.monotonic() < end_s:
        outcome = child.run(name, seed, number)
        if tally.add(number, outcome):
            print(f"{name} {seed} {number}: {outcome.text} ({outcome.site})", flush=True)
            if folder is not None:
                child.save(name, seed, number, folder)
        number += 1
    return tally


def _format(name: str) -> Any:
    return next(entry for entry in formats() if entry.name == name)


def replay(name: str, seed: int, number: int) -> None:
    """Run one case in this process; its traceback is shown."""
    root = Path(tempfile.mkdtemp()).resolve()
    bench, chosen = Bench(root), _format(name)
    index, damaged, content = bench.damage(chosen, seed, number)
    path, _ = bench.input_of(chosen, index)
    rewrite(damaged, content)
    options = chosen.seeds[index].options
    print(f"{path} {options}, damaged {damaged}")
    chosen.read(path, bench.temporary / "out.touch", options)


def main() -> int:
    """Run cases of each format; return 1 if one is a fault."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--runs", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", nargs="*", default=[], help="formats, by name")
    parser.add_argument("--folder", type=Path, default=Path(tempfile.gettempdir()) / "parser-faults")
    parser.add_argument("--replay", nargs=3, metavar=("NAME", "SEED", "NUMBER"))
    options = parser.parse_args()
    if options.replay:
        replay(options.replay[0], int(options.replay[1]), int(options.replay[2]))
        return 0
    faults, child = 0, Child()
    for name in options.only or [entry.name for entry in formats()]:
        start_s = time.monotonic()
        tally = fuzz(child, name, options.runs, options.seconds, options.seed, options.first, options.folder)
        faults += tally.counts["FAULT"]
        print(
            f"{name}: {dict(tally.counts)}, {len(tally.faults)} distinct faults, "
            f"slowest {tally.slowest_s:.2f} s, peak {tally.peak_mib:.0f} MiB, "
            f"{time.monotonic() - start_s:.0f} s",
            flush=True,
        )
    child.end()
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())

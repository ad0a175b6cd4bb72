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
import re
import shutil
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from parser_formats import formats
from parser_worker import MEBI, Bench, Outcome, serve

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
    """A process that runs cases of one format."""

    def __init__(self, name: str) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.process = context.Process(target=serve, args=(other, name), daemon=True)
        self.process.start()
        other.close()
        self.is_alive = self._answer(START_SECONDS) == "ready"

    def run(self, seed: int, number: int) -> Outcome:
        """Run a case; its outcome if the process dies or hangs."""
        try:
            self.pipe.send((seed, number))
            found = self._answer(WAIT_SECONDS)
        except OSError:
            found = None
        if isinstance(found, Outcome):
            return found
        self.end()
        code = self.process.exitcode
        return Outcome("FAULT", "the process hung" if code in (None, -9, -15) else f"the process died, status {code}")

    def _answer(self, patience_s: float) -> Any:
        try:
            return self.pipe.recv() if self.pipe.poll(patience_s) else None
        except (EOFError, OSError):
            return None

    def end(self) -> None:
        """End the process."""
        self.is_alive = False
        self.process.join(0.5)
        self.process.kill()
        self.process.join()


def fuzz(
    name: str, runs: int, seconds: float, seed: int = 0, first: int = 0, folder: Path | None = None
) -> Tally:
    """Run cases of a format, and save the first input of each fault below `folder`."""
    tally, number, child = Tally(name), first, Child(name)
    end_s = time.monotonic() + seconds
    if not child.is_alive:
        child.end()
        raise RuntimeError(f"{name}: a valid input cannot be read; see --replay")
    while number < first + runs and (time.monotonic() < end_s or number == first):
        if not child.is_alive:
            child = Child(name)
        outcome = child.run(seed, number)
        if tally.add(number, outcome):
            print(f"{name} {seed} {number}: {outcome.text} ({outcome.site})", flush=True)
            if folder is not None:
                save(name, seed, number, folder)
        number += 1
    child.end()
    return tally


def save(name: str, seed: int, number: int, folder: Path) -> None:
    """Write the input of a case below `folder`."""
    target = folder / f"{name} {seed} {number}".replace(" ", "-")
    shutil.rmtree(target, ignore_errors=True)
    target.parent.mkdir(parents=True, exist_ok=True)
    context = multiprocessing.get_context("spawn")
    process = context.Process(target=_save, args=(name, seed, number, target))
    process.start()
    process.join()


def _save(name: str, seed: int, number: int, target: Path) -> None:
    with tempfile.TemporaryDirectory() as root:
        bench, chosen = Bench(Path(root).resolve()), _format(name)
        _, path, damaged, content, _ = bench.damage(chosen, seed, number)
        damaged.unlink() if content is None else damaged.write_bytes(content)
        shutil.copytree(bench.folder / damaged.relative_to(bench.folder).parts[0], target)


def _format(name: str) -> Any:
    return next(entry for entry in formats() if entry.name == name)


def replay(name: str, seed: int, number: int) -> None:
    """Run one case in this process; its traceback is shown."""
    root = Path(tempfile.mkdtemp()).resolve()
    bench, chosen = Bench(root), _format(name)
    source, path, damaged, content, _ = bench.damage(chosen, seed, number)
    damaged.unlink() if content is None else damaged.write_bytes(content)
    print(f"{path} {source.options}, damaged {damaged}")
    chosen.read(path, bench.temporary / "out.touch", source.options)


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
    faults = 0
    for name in options.only or [entry.name for entry in formats()]:
        start_s = time.monotonic()
        tally = fuzz(name, options.runs, options.seconds, options.seed, options.first, options.folder)
        faults += tally.counts["FAULT"]
        print(
            f"{name}: {dict(tally.counts)}, {len(tally.faults)} distinct faults, slowest {tally.slowest_s:.2f} s, "
            f"peak {tally.peak_mib:.0f} MiB, {time.monotonic() - start_s:.0f} s",
            flush=True,
        )
    return int(faults > 0)


if __name__ == "__main__":
    sys.exit(main())

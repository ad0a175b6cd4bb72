"""Measures how time and memory of each operation grow with frames, surface and empty box.

    python bench/bench_scaling.py [--quick] [--doublings N] [--part P] [--rounds N] [--operations NAME,NAME]
    python bench/bench_scaling.py --draw

Each row is an operation on media whose size is doubled four times (`--doublings`) along one axis
(`scaling_media`): frames, surface, the empty box around it, or what an operation grows with besides: bodies,
pictures, media. A row runs in a process of its own, on one thread (`scaling_work`): two threads that share a
core take more processor time for the same work, and only long operations keep two busy.

* exponent: the slope of the straight line through log time, or log memory, over log size (least squares). 1
  is linear, 0 constant.
* Time is that of the processor, the least of `--rounds` rounds over all rows, minutes apart: what else runs
  only adds to it. A constant part would lower the exponent; a small medium is therefore measured first, and
  its size and its time are subtracted from those of the others. Of an empty box nothing is subtracted: the
  surface in it is the constant part.
* Memory is the peak above that before the operation; nothing is subtracted, and less than 1 MB counts as 1.
* `play` is the time of a number of ticks of a looped medium, without opening it: it must not grow at all.

The size of surfaces is the number of samples with a force. `--part` multiplies all sizes but those of boxes;
`--operations` measures some of the operations. `--draw` measures nothing, and draws the stored result as
docs/pictures/scaling.png.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from machine import Bar, Figures, at_most, bench, figure, stored, text
from scaling_picture import draw

HERE: Final = Path(__file__).resolve().parent
PICTURE: Final = HERE.parent / "docs" / "pictures" / "scaling.png"
THREADS: Final = 1
LEAST_MB: Final = 1.0
"""Less memory is not told from none."""
LINEAR, CONSTANT = 1.1, 0.1
"""Limits of exponents."""
SURFACE, BOX = (1 / 256, 1 / 18), (None, 1.0)
"""Small and first size. From 1/36 on, `encode` tries a spline for each doubled section; 1/16 is not smooth
enough for it, and takes two thirds of the time for a sample."""


@dataclass(frozen=True)
class Row:
    """An operation on the media of an axis of `scaling_media`.

    `small` is the size whose time is subtracted; None subtracts nothing. `first` is doubled. `what` names the
    axis in tables, and `limit` is that of the exponent of time.
    """

    operation: str
    what: str
    axis: str
    small: float | None
    first: float
    limit: float = LINEAR

    @property
    def name(self) -> str:
        """The name of the row."""
        return f"{self.operation}, {self.what}"

    @property
    def memory_limit(self) -> float:
        """The limit of the exponent of memory."""
        return CONSTANT if self.what == "box" else LINEAR

    def sizes(self, doublings: int, part: float) -> list[float]:
        """Return the small size, if there is one, and those that are measured, times `part` but for boxes."""
        small = [] if self.small is None else [self.small]
        first = self.first if self.what == "box" else part * self.first
        return [*small, *(first * 2**n for n in range(doublings + 1))]


ROWS: Final = (
    Row("encode", "frames", "frames", 1, 8),
    Row("encode", "surface", "surface", *SURFACE),
    Row("encode", "box", "box", *BOX, CONSTANT),
    Row("decode", "frames", "frames", 1, 8),
    Row("decode", "surface", "surface", *SURFACE),
    Row("decode", "box", "box", *BOX, CONSTANT),
    Row("compare", "frames", "frames", 1, 8),
    Row("compare", "surface", "surface", *SURFACE),
    Row("compare", "box", "box", *BOX, CONSTANT),
    Row("measure", "frames", "frames", 1, 8),
    Row("measure", "surface", "surface", *SURFACE),
    Row("measure", "box", "box", *BOX, CONSTANT),
    Row("index", "media", "media", 10, 40),
    Row("index", "surface", "surface", *SURFACE),
    Row("index", "box", "box", *BOX, CONSTANT),
    Row("search", "media", "media", 640, 2560),
    Row("fuse", "pictures", "views", 2, 8),
    Row("fuse", "surface", "room", 1 / 4, 1),
    Row("fuse", "pictures and surface", "corridor", 2, 16),
    Row("fuse", "box", "room in a box", *BOX, CONSTANT),
    Row("objects", "frames", "objects", 2, 32),
    Row("objects", "bodies", "bodies", 3, 12),
    Row("objects", "box", "bodies in a box", *BOX, CONSTANT),
    Row("play", "frames", "frames", None, 8, CONSTANT),
    Row("play", "surface", "surface", None, SURFACE[1], CONSTANT),
    Row("play", "box", "box", *BOX, CONSTANT),
)


def run_row(row: Row, sizes: list[float], folder: Path) -> list[Figures]:
    """Run a row in a process of its own; return the figures of each size."""
    script = HERE / "scaling_work.py"
    threads = {"TOUCHFIELD_THREADS": str(THREADS), "OPENBLAS_NUM_THREADS": str(THREADS)}
    done = subprocess.run(
        [sys.executable, str(script), row.operation, row.axis, str(folder), *map(str, sizes)],
        env={**os.environ, **threads},
        stdout=subprocess.PIPE,
        text=True,
        check=True,
    )
    return [json.loads(line) for line in done.stdout.splitlines()]


def slope(sizes: list[float], values: list[float]) -> float | None:
    """Return the slope of the line of least squares through log values over log sizes.

    None where the small medium took no less than another.
    """
    if min(*sizes, *values) <= 0:
        return None
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def figures_of(row: Row, cases: list[Figures]) -> Figures:
    """Return sizes, times, memory and exponents of a row."""
    sizes = [case["supported_voxels" if row.what == "surface" else "size"] for case in cases]
    seconds, peaks_mb = [case["cpu_s"] for case in cases], [case["peak_mb"] for case in cases]
    subtracted = {"size": 0.0, "cpu_s": 0.0}
    if row.small is not None:
        subtracted = {"size": sizes[0], "cpu_s": seconds[0]}
        sizes, seconds, peaks_mb = sizes[1:], seconds[1:], peaks_mb[1:]
    beyond = [size - subtracted["size"] for size in sizes]
    beyond_s = [second - subtracted["cpu_s"] for second in seconds]
    return {
        "sizes": sizes,
        "cpu_s": seconds,
        "peak_mb": peaks_mb,
        "subtracted": subtracted,
        "time_exponent": slope(beyond, beyond_s),
        "memory_exponent": slope(sizes, [max(peak_mb, LEAST_MB) for peak_mb in peaks_mb]),
        "supported_voxels": [case["supported_voxels"] for case in cases if "supported_voxels" in case],
    }


def least(rounds: list[list[Figures]]) -> list[Figures]:
    """Return the figures of each size, with the least time and memory of all rounds."""
    return [
        {**cases[0], **{name: min(case[name] for case in cases) for name in ("cpu_s", "peak_mb")}}
        for cases in zip(*rounds, strict=True)
    ]


def measure(doublings: int, part: float, rounds: int, operations: str) -> Figures:
    """Measure the rows of some operations, or of all."""
    selected = [
        row for row in ROWS if operations in ("all", row.operation) or row.operation in operations.split(",")
    ]
    runs: dict[str, list[list[Figures]]] = {row.name: [] for row in selected}
    for n in range(rounds):
        with tempfile.TemporaryDirectory() as folder:
            for row in selected:
                runs[row.name].append(run_row(row, row.sizes(doublings, part), Path(folder)))
                exponent = figures_of(row, least(runs[row.name]))["time_exponent"]
                print(f"round {n + 1}, {row.name}: {text(exponent)}", flush=True)
    rows = {row.name: figures_of(row, least(runs[row.name])) for row in selected}
    return {"doublings": doublings, "part": part, "rounds": rounds, "threads": THREADS, "rows": rows}


def bars(figures: Figures) -> list[Bar]:
    """Limit the exponents of time and memory of each row."""
    found = []
    for row in ROWS:
        time, memory = (figure(figures, "rows", row.name, f"{name}_exponent") for name in ("time", "memory"))
        found.append(at_most(f"{row.name}: exponent of time", time, row.limit))
        found.append(at_most(f"{row.name}: exponent of memory", memory, row.memory_limit))
    return found


if __name__ == "__main__":
    if "--draw" in sys.argv[1:]:
        draw(stored("scaling")["rows"], PICTURE)
    else:
        bench(
            "scaling", __doc__, measure, bars, doublings=(4, 1), part=(1.0, 0.5), rounds=(2, 1),
            operations=("all", "encode,decode,search"),
        )  # fmt: skip

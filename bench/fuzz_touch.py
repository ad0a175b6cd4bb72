"""Fuzzes the decoder of coder `touch`: decodes damaged segments, and checks errors, memory and time.

    python bench/fuzz_touch.py [--seconds N] [--seed S] [--only NAME ...] [--bounds] [--replay SEED CASE]

Valid segments of every mode, effort and base layer are damaged at random bytes, or in one part with
consistent lengths. A child process decodes them. A case fails if another error than `FormatError` occurs, if
it uses more memory or time than the number of bytes allows (measured by `tracemalloc` and limited for the
process), or if the process dies.

A case is identified by the seed and its number; `--replay` runs it again. `--only` selects the segments.
`--bounds` checks every index in the compiled loops, which is slow. `run_all.py` does not run this file,
because it has no figures.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import resource
import sys
import tempfile
import time
import traceback
import tracemalloc
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from touchfield.codec.touch.body import BodyReader, FrameRecord, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid

MEBI = 1 << 20
PROCESS_BYTES = 6 << 30
"""Address space of a child, some of which compiled code and its heap take."""

FREE_BYTES = 24 * MEBI
"""Memory allowed for any case.

The models of a frame take 3 MiB, several times at once, and the table of a lattice 2 MiB.
"""

BYTES_PER_BYTE = 512 << 10
"""Memory allowed for each byte of a body.

A byte may list sixteen bricks, each of 6 KiB with cells of 16 KiB, several times at once.
"""

FREE_SECONDS = 1.0
SECONDS_PER_BYTE = 4e-3
PATIENCE = 90.0
"""Wall seconds without an answer after which a child is ended."""

MAX_BRICKS = 1 << 27
"""Largest grid that a file may have."""

GRID = Grid((22, 19, 26), (0.0025, 0.002, 0.001), (-0.01, -0.008, -0.004))


@dataclass(frozen=True)
class Good:
    """A valid segment, as the encoder wrote it."""

    name: str
    grid: Grid
    parameters: bytes
    body: bytes
    frames: int

    @property
    def decoder(self) -> TouchDecoder:
        """The decoder of its stream."""
        return TouchDecoder(self.grid, self.parameters)


# -- good bodies -------------------------------------------------------------------------------------------


def wall(grid: Grid, t: float, saturated: bool = False) -> ForceField:
    """Return a bent wall that pushes outward, and moves with t."""
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    depth = z - 9 - 2.5 * np.sin((x + t) / 5) * np.cos((y - t) / 4)
    inside = (depth > 0) & (saturated | (depth < 5))
    force = np.minimum(depth / 4, 1) * inside * 3
    normal = np.stack([0.3 * np.cos((x + t) / 5), 0.25 * np.sin((y - t) / 4), -np.ones(grid.shape)], axis=-1)
    return ForceField.from_dense(grid, (force[..., None] * normal).astype(np.float32))


def makers() -> dict[str, Callable[[], Good]]:
    """Return functions that encode the segments to damage, by name."""
    walls = [wall(GRID, t) for t in range(3)]
    solid = [wall(GRID, t, saturated=True) for t in range(2)]
    step = wall(GRID, 0, saturated=True).to_dense()
    step[:, 10:, 2:] = step[:, 10:, :-2]
    rough = np.random.default_rng(1).normal(size=(*GRID.shape, 3)).astype(np.float32)
    noise = ForceField.from_dense(GRID, rough * (np.indices(GRID.shape).sum(0) < 20)[..., None])
    flat = [ForceField(GRID, f.bricks, (np.rint(f.forces_n * 4) / 4).astype(np.float32)) for f in walls]
    cases: dict[str, tuple[list[ForceField], TouchSpec]] = {
        "plain": (walls, TouchSpec(guess="off")),
        "follows": (walls, TouchSpec(effort="fast", guess="off", interframe="on")),
        "direction": (walls[:2], TouchSpec(mode="mask-direction", guess="off")),
        "nmse": (walls[:2], TouchSpec(mode="nmse", guess="off")),
        "exact-support": ([noise], TouchSpec(support="exact", guess="off", k=0.5, f0_n=0.5)),
        "spline": (solid, TouchSpec()),
        "columns": ([ForceField.from_dense(GRID, step)], TouchSpec()),
        "empty": ([ForceField.empty(GRID), walls[0], ForceField.empty(GRID)], TouchSpec(guess="off")),
        "lossless": (flat, TouchSpec(mode="lossless")),
        "lossless-noise": ([noise], TouchSpec(mode="lossless")),
    }
    return {name: partial(encoded, name, frames, spec) for name, (frames, spec) in cases.items()}


def encoded(name: str, frames: list[ForceField], spec: TouchSpec) -> Good:
    """Encode a segment of frames.

    Outliers are rare, so the last frame gets one if it has none.
    """
    encoder = TouchEncoder(GRID, spec)
    good = Good(name, GRID, encoder.parameters, encoder.encode_segment(frames).body, len(frames))
    if spec.mode not in ("mask", "mask-direction"):
        return good
    reader = BodyReader(good.body, GRID, exact=False)
    records = reader.records(len(frames))
    records[-1] = replace(records[-1], outliers=records[-1].outliers or bytes([1, 1, 1, 2]) + bytes(12))
    return replace(good, body=write_body(reader.lattice, records, reader.max_error))


# -- damage ------------------------------------------------------------------------------------------------


def damaged(data: bytes, rng: np.random.Generator, others: list[bytes]) -> bytes:
    """Damage bytes in one of nine ways."""
    out = bytearray(data)
    n = len(out)
    kind = int(rng.integers(9))
    at = int(rng.integers(n)) if n else 0
    early = min(at, int(rng.integers(1, 24)))  # the head of a code has sizes
    if kind == 0 or n == 0:
        for _ in range(int(rng.integers(1, 6))):
            if n:
                out[int(rng.integers(n))] ^= 1 << int(rng.integers(8))
        return bytes(out)
    if kind == 1:
        return bytes(out[:at])
    if kind == 2:
        out[early] = int(rng.integers(256))
    elif kind == 3:
        new = rng.integers(256, size=int(rng.integers(0, 40)), dtype="u1")
        out[at : at + int(rng.integers(1, 40))] = new.tobytes()
    elif kind == 4:
        out[early : early + 1] = bytes([255] * int(rng.integers(1, 7))) + bytes([int(rng.integers(1, 128))])
    elif kind == 5:
        other = others[int(rng.integers(len(others)))]
        start = int(rng.integers(len(other) or 1))
        size = int(rng.integers(1, 200))
        out[at : at + size] = other[start : start + size]
    elif kind == 6:
        out[at:] = bytes([int(rng.choice([0, 255]))]) * (n - at)
    elif kind == 7:
        out += rng.integers(256, size=int(rng.integers(1, 400)), dtype="u1").tobytes()
    else:
        out[at:] = rng.integers(256, size=n - at, dtype="u1").tobytes()
    return bytes(out)


def damaged_record(record: FrameRecord, rng: np.random.Generator, others: list[bytes]) -> FrameRecord:
    """Return a frame with one of its parts changed."""
    kind = int(rng.integers(8))
    if kind < 4:
        return replace(record, payload=damaged(record.payload, rng, others))
    if kind == 4 and record.base_layer:
        return replace(record, base_layer=damaged(record.base_layer, rng, others))
    if kind == 5 and record.outliers:
        return replace(record, outliers=damaged(record.outliers, rng, others) or b"\0")
    if kind == 6:
        return replace(record, inter=not record.inter)
    return replace(record, base_layer=b"" if record.base_layer else others[int(rng.integers(len(others)))])


def case_of(pool: list[Good], seed: int, number: int) -> Good:
    """Return case `number`, which is the same for the same segments and seed."""
    rng = np.random.default_rng([seed, number])
    good = pool[int(rng.integers(len(pool)))]
    others = [segment.body for segment in pool]
    body, parameters, grid, frames = good.body, good.parameters, good.grid, good.frames
    if rng.random() < 0.3:
        for _ in range(int(rng.integers(1, 3))):
            body = damaged(body, rng, others)
    else:
        reader = BodyReader(body, grid, exact=good.name.startswith("lossless"))
        records = reader.records(frames)
        at = int(rng.integers(len(records)))
        records[at] = damaged_record(records[at], rng, others)
        lattice = reader.lattice
        if lattice is not None and rng.random() < 0.1:
            floor, cross = (int(2 ** rng.uniform(0, 16)) - 1 or 1 for _ in range(2))
            rate, cross_rate = (int(2 ** rng.uniform(0, 17)) - 1 for _ in range(2))
            lattice = replace(lattice, floor=floor, rate=rate, cross_floor=cross, cross_rate=cross_rate)
        body = write_body(lattice, records, reader.max_error)
    chance = rng.random()
    if chance < 0.05:
        shape = tuple(int(2 ** rng.uniform(0, 20)) for _ in range(3))
        if np.prod([-(-n // 8) for n in shape]) <= MAX_BRICKS:
            grid = Grid((shape[0], shape[1], shape[2]), grid.spacing_m, grid.origin_m)
    elif chance < 0.08:
        frames = int(rng.integers(1, 1 << 16))
    elif chance < 0.1:
        parameters = damaged(parameters, rng, others)
    return Good(good.name, grid, parameters, body, frames)


def bytes_allowed(case: Good) -> float:
    """Return the memory that a case may take at once."""
    return FREE_BYTES + BYTES_PER_BYTE * len(case.body)


def run(case: Good) -> str:
    """Decode a case; return the outcome."""
    try:
        for frame in case.decoder.frames(case.body, case.frames):
            if not np.isfinite(frame.forces_n).all():
                return "FAULT: a force that is not finite"
    except FormatError as error:
        return type(error).__name__
    except Exception as error:
        last = traceback.extract_tb(error.__traceback__)[-1]
        return f"FAULT: {type(error).__name__}: {error} ({Path(last.filename).name}:{last.lineno})"
    return "decoded"


# -- the child, and who watches it -------------------------------------------------------------------------


POOL: list[Good] = []
"""The valid segments of the child process."""


def start_child(names: list[str], seed: int) -> None:
    """Encode the valid segments, compile the decoder, and limit the process."""
    for name, make in makers().items():
        if names and name not in names:
            continue
        try:
            POOL.append(make())
            run(case_of([POOL[-1]], seed, 0))
        except Exception as error:  # faults of the encoder are out of scope
            print(f"left out: {name}: {type(error).__name__}: {error}", flush=True)
    resource.setrlimit(resource.RLIMIT_AS, (PROCESS_BYTES, PROCESS_BYTES))
    tracemalloc.start()


def work(seed: int, number: int) -> tuple[str, str, float, float]:
    """Run a case in the child.

    Returns name and outcome, and the fractions used of the allowed memory and time.
    """
    case = case_of(POOL, seed, number)
    tracemalloc.reset_peak()
    before, began = tracemalloc.get_traced_memory()[0], time.process_time()
    outcome = run(case)
    seconds, peak = time.process_time() - began, tracemalloc.get_traced_memory()[1] - before
    fractions = peak / bytes_allowed(case), seconds / (FREE_SECONDS + SECONDS_PER_BYTE * len(case.body))
    if max(fractions) > 1 and not outcome.startswith("FAULT"):
        took = f"{peak / MEBI:.0f} MiB" if fractions[0] > 1 else f"{seconds:.1f} s"
        outcome = f"FAULT: {took} for {len(case.body)} bytes, grid {case.grid.shape}; {outcome}"
    return case.name, outcome, *fractions


@dataclass
class Tally:
    """Outcomes of all cases."""

    counts: Counter[str]
    faults: dict[str, list[str]]
    peak: float = 0.0
    slowest: float = 0.0

    def add(self, number: int, name: str, outcome: str, peak: float, seconds: float) -> None:
        """Count one case."""
        self.counts["FAULT" if outcome.startswith("FAULT") else outcome] += 1
        self.peak, self.slowest = max(self.peak, peak), max(self.slowest, seconds)
        if outcome.startswith("FAULT"):
            found = self.faults.setdefault(f"{name}: {outcome}"[:300], [])
            found.append(str(number))
            if len(found) == 1:
                print(f"case {number}, {name}: {outcome}", flush=True)


def watch(arguments: argparse.Namespace) -> Tally:
    """Run cases until the time is over; restart the child after a case that killed it."""
    tally, number, spent = Tally(Counter(), {}), arguments.first, 0.0
    while spent < arguments.seconds:
        with multiprocessing.get_context("spawn").Pool(
            1, start_child, (arguments.only, arguments.seed)
        ) as child:
            child.apply_async(os.getpid).get(1200)  # wait until all is compiled
            patient = True
            while patient and spent < arguments.seconds:
                began = time.monotonic()
                try:
                    tally.add(number, *child.apply_async(work, (arguments.seed, number)).get(PATIENCE))
                except multiprocessing.TimeoutError:
                    tally.add(
                        number, "?", f"FAULT: the process died, or said nothing for {PATIENCE:.0f} s", 0, 0
                    )
                    patient = False
                spent += time.monotonic() - began
                number += 1
    return tally


def replayed(names: list[str], seed: int, number: int) -> None:
    """Run one case in this process, with the whole traceback."""
    pool = [make() for name, make in makers().items() if not names or name in names]
    case = case_of(pool, seed, number)
    print(f"{case.name}: {len(case.body)} bytes, {case.frames} frames, grid {case.grid.shape}")
    for frame in case.decoder.frames(case.body, case.frames):
        print(f"a frame of {len(frame.bricks)} bricks")


def main() -> int:
    """Run cases and print their outcomes; return 1 if one failed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=60.0, help="time of decoding, of one process")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--first", type=int, default=0, help="number of the first case")
    parser.add_argument("--only", nargs="+", default=[], metavar="NAME", help="good bodies to begin with")
    parser.add_argument("--bounds", action="store_true", help="check every index in compiled loops")
    parser.add_argument("--replay", type=int, nargs=2, metavar=("SEED", "CASE"))
    options = parser.parse_args()
    if options.bounds and "NUMBA_BOUNDSCHECK" not in os.environ:
        folder = Path(tempfile.gettempdir()) / "touchfield-fuzz-bounds"
        settings = {"NUMBA_BOUNDSCHECK": "1", "NUMBA_CACHE_DIR": str(folder)}
        os.execve(sys.executable, [sys.executable, *sys.argv], {**os.environ, **settings})
    if options.replay:
        replayed(options.only, *options.replay)
        return 0
    tally = watch(options)
    print(f"seed {options.seed}: {sum(tally.counts.values())} cases: {dict(sorted(tally.counts.items()))}")
    print(f"largest share of the memory allowed {tally.peak:.2f}, of the time {tally.slowest:.2f}")
    for fault, numbers in tally.faults.items():
        print(f"{len(numbers)} x {fault}; cases {' '.join(numbers[:8])}")
    return 1 if tally.faults else 0


if __name__ == "__main__":
    sys.exit(main())

"""Fuzzes reader and writer of coder `touch`, and the renderer, in C, under address and behaviour sanitizers.

    python bench/fuzz_c.py [--writes N] [--reads N] [--renders N] [--seed S]

`--writes` round trips of random small fields through `c/touch_fuzz_write.c`: every mode, inter frames, base
layers; each voxel is compared with the error bound. `--reads` decodings of mutated files by `c/touch_fuzz.c`:
the files are those of round trips and the small golden files, and checksums are not checked, so that the code
behind them runs. `--renders` rounds of random media, settings and hands through `c/touch_fuzz_render.c`: each
force is compared with its limits. One process runs on each core.

Prints the counts; exits with status 1 and the sanitizer's report if one process fails. `run_all.py` does not
run this file. With N of 1,000,000 and 10,000,000 it takes about 70 core minutes.
"""

from __future__ import annotations

import argparse
import os
import re
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory
from time import monotonic

ROOT = Path(__file__).resolve().parent.parent
GOLDEN = ROOT / "conformance" / "v1"
OPTIONS = ("-O2", "-g", "-std=c99", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
NO_CHECKSUMS = "-DFUZZING_BUILD_MODE_UNSAFE_FOR_PRODUCTION"
LARGEST_BYTES = 2048
"""Files above this size are no inputs: small ones are decoded more often in the same time."""

FILES_A_SEED = 256
"""As many files of a run does `touch_fuzz_write` store."""

BATCH_MEGABYTES = 20
"""Mutated bytes of one process of `touch_fuzz`."""

BATCH_WRITES = 20_000
BATCH_RENDERS = 50_000


def built(folder: Path, name: str, *options: str) -> Path:
    """Compile one of the programs in c/; return its path."""
    compiler = (
        os.environ.get("CC") or which("cc") or sys.exit("no C compiler: set CC, or install gcc or clang")
    )
    program = folder / name
    source = ROOT / "c" / f"{name}.c"
    command = [compiler, *OPTIONS, *options, f"-I{ROOT / 'c'}", "-o", str(program), str(source), "-lm"]
    if subprocess.run(command, check=False).returncode:
        sys.exit(f"{compiler} does not compile {source.name} with the sanitizers")
    return program


def output_of(command: list[str]) -> str:
    """Run a program; return what it prints, or exit with its report if it fails."""
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        print(" ".join(command[:3]), done.stderr, sep="\n")
        os._exit(1)
    return done.stdout


def fuzz_rounds(program: Path, seed: int, rounds: int, workers: int, batch: int = BATCH_WRITES) -> int:
    """Run rounds of a program, `batch` in a process; return their number."""
    counts = [min(batch, rounds - start) for start in range(0, rounds, batch)]
    with ThreadPoolExecutor(workers) as pool:
        commands = [[str(program), str(seed + n), str(count)] for n, count in enumerate(counts)]
        return sum(int(text.split()[0]) for text in pool.map(output_of, commands))


def inputs(program: Path, seed: int, folder: Path) -> list[str]:
    """Write files of round trips; return the paths of the small ones, and of small golden files."""
    folder.mkdir()
    output_of([str(program), str(seed), str(FILES_A_SEED), str(folder)])
    paths = [*folder.glob("*.touch"), *(p for p in GOLDEN.glob("*.touch") if not p.name.startswith("paper"))]
    return [str(path) for path in sorted(paths) if path.stat().st_size <= LARGEST_BYTES]


def fuzz_reader(
    reader: Path, writer: Path, seed: int, reads: int, workers: int, folder: Path
) -> Counter[str]:
    """Decode mutated files until there are so many; return the number of inputs by error code."""
    counts: Counter[str] = Counter()

    def batch(n: int) -> None:
        files = inputs(writer, seed + n, folder / str(n))
        text = output_of([str(reader), str(seed + n), str(BATCH_MEGABYTES), *files])
        counts.update({code: int(count) for code, count in re.findall(r"code (\d): (\d+)", text)})

    with ThreadPoolExecutor(workers) as pool:
        n = 0
        while counts.total() < reads:
            list(pool.map(batch, range(n, n + workers)))
            n += workers
    return counts


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--writes", type=int, default=10_000)
    parser.add_argument("--reads", type=int, default=100_000)
    parser.add_argument("--renders", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="processes at once: one a core")
    options = parser.parse_args()
    with TemporaryDirectory() as name:
        folder = Path(name)
        writer, reader = built(folder, "touch_fuzz_write"), built(folder, "touch_fuzz", NO_CHECKSUMS)
        start = monotonic()
        writes = fuzz_rounds(writer, options.seed, options.writes, options.jobs)
        print(f"{writes:,} round trips, {monotonic() - start:.0f} s", flush=True)
        start = monotonic()
        counts = fuzz_reader(reader, writer, options.seed, options.reads, options.jobs, folder)
        codes = ", ".join(f"{count:,} code {code}" for code, count in sorted(counts.items()) if count)
        print(f"{counts.total():,} mutated files, {monotonic() - start:.0f} s: {codes}", flush=True)
        renderer, start = built(folder, "touch_fuzz_render"), monotonic()
        rounds = fuzz_rounds(renderer, options.seed, options.renders, options.jobs, BATCH_RENDERS)
        print(f"{rounds:,} rounds of the renderer, {monotonic() - start:.0f} s")


if __name__ == "__main__":
    main()

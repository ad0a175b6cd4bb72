"""Runs every benchmark; each prints its tables and stores its last run.

    python bench/run_all.py [--quick] [--only NAME,NAME] [--jobs N] [--limit-s SECONDS]
    python bench/run_all.py --stale | --rerun-stale | --verdicts | --store-quick

`--quick` runs each benchmark with its smallest settings, stores nothing, and compares its exact figures
(bytes, counts, errors) with ``reference/quick``, which `--store-quick` writes. `--stale` only lists the
results whose code has changed, and exits with status 1 if one of them can be measured here; `--rerun-stale`
measures these. `--verdicts` runs nothing either: it evaluates the bars on the stored figures and stores the
verdicts.

Results are stored in bench/results. A benchmark that fails or exceeds its time is named at the end, and the
others run. One whose requirements (a GPU, a compiler, a browser) are missing is skipped with the reason.
"""

from __future__ import annotations

import argparse
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from shutil import which
from tempfile import TemporaryFile

from machine import RESULTS, SKIPPED, STORE_QUICK, bar_line, reason, stale, stored, table, write
from touchfield.compute.threads import worker_count

HERE = Path(__file__).parent
QUICK_LIMIT_S, LIMIT_S = 600.0, 3600.0
"""Seconds after which a script is ended."""
GUARD = "guard"
NEEDS = {
    "cuda": ("an NVIDIA GPU", ("nvidia-smi",)),
    "page": ("node and Chromium", ("node", "chromium")),
    "timeline": ("node and Chromium", ("node", "chromium")),
}
"""Requirements that not every machine meets, and the programs that indicate them."""


@dataclass(frozen=True)
class Outcome:
    """How a script ended."""

    name: str
    verdict: str
    seconds: float
    processor_s: float

    @property
    def is_failure(self) -> bool:
        """Neither finished nor left out."""
        return self.verdict not in ("finished", "left out")


def scripts() -> dict[str, str]:
    """Return the script of each result, by the result's name."""
    paths = [*sorted(HERE.glob("bench_*.py")), HERE / "rate.py"]
    return {path.stem.removeprefix("bench_"): path.stem for path in paths}


def selected(only: str | None) -> list[str]:
    """Return the names of the benchmarks to run; SystemExit for an unknown name."""
    names = list(scripts())
    requested = names if only is None else [name for name in only.split(",") if name]
    if unknown := [name for name in requested if name not in names]:
        sys.exit(f"no benchmark {', '.join(unknown)}; there are {', '.join(names)}")
    return requested


# -- running -----------------------------------------------------------------------------------------------


def run(name: str, is_quick: bool, limit_s: float, is_live: bool = True) -> Outcome:
    """Run one script in its own process group.

    After `limit_s` the script is ended with all its processes. Its output appears immediately if `is_live`,
    and otherwise when it has ended.
    """
    script = HERE / f"{scripts()[name]}.py"
    command = [sys.executable, str(script), *["--quick"] * is_quick]
    title, start = f"\n== {script.name}", time.monotonic()
    with TemporaryFile() as output:
        if is_live:
            print(title, flush=True)
        where = {} if is_live else {"stdout": output, "stderr": subprocess.STDOUT}
        process = subprocess.Popen(command, start_new_session=True, **where)  # type: ignore[call-overload]
        status, processor_s = _waited(process.pid, start + limit_s)
        process.returncode = -signal.SIGKILL if status is None else status
        if not is_live:
            output.seek(0)
            print(title, output.read().decode(errors="replace"), sep="\n", flush=True)
    verdict = {0: "finished", SKIPPED: "left out", None: f"exceeded {limit_s:.0f} s"}
    return Outcome(
        name, verdict.get(status, f"failed, status {status}"), time.monotonic() - start, processor_s
    )


def _waited(pid: int, until_s: float) -> tuple[int | None, float]:
    """Return the exit status, and processor seconds including children.

    At `until_s` the process group is killed, and the status is None.
    """
    is_late = False
    while True:
        ended, status, used = os.wait4(pid, os.WNOHANG)
        if ended:
            seconds = used.ru_utime + used.ru_stime
            return None if is_late else os.waitstatus_to_exitcode(status), seconds
        if not is_late and time.monotonic() > until_s:
            is_late = True
            os.killpg(pid, signal.SIGKILL)
        time.sleep(0.05)


def run_each(names: list[str], is_quick: bool, limit_s: float, jobs: int) -> bool:
    """Run benchmarks, `jobs` at once, and print a table; return True if none failed.

    The regression guard runs first and alone.
    """
    alone = [name for name in names if jobs == 1 or name == GUARD]
    outcomes = [run(name, is_quick, limit_s) for name in alone]
    with ThreadPoolExecutor(jobs) as pool:
        rest = [name for name in names if name not in alone]
        outcomes += pool.map(lambda name: run(name, is_quick, limit_s, is_live=False), rest)
    rows = [
        [outcome.name, outcome.verdict, f"{outcome.seconds:.1f}", f"{outcome.processor_s:.1f}"]
        for outcome in outcomes
    ]
    total = [
        "all",
        "",
        *(f"{sum(values):.1f}" for values in zip(*((o.seconds, o.processor_s) for o in outcomes))),
    ]
    print(table("benchmarks", ["", "verdict", "seconds", "processor s"], [*rows, total]))
    failed = [outcome.name for outcome in outcomes if outcome.is_failure]
    if failed:
        print(f"\nfailed: {', '.join(failed)}", flush=True)
    return not failed


# -- kept results ------------------------------------------------------------------------------------------


def missing_need(name: str) -> str | None:
    """Return the requirement of a benchmark that this machine lacks; None if none."""
    need, programs = NEEDS.get(name, ("", ()))
    return None if all(map(which, programs)) else need


def stale_results() -> dict[str, list[str]]:
    """Return the changed files of each result that is not up to date."""
    found = {name: stale(name) for name in scripts()}
    return {name: files for name, files in found.items() if files}


def show_stale() -> bool:
    """List stale results with commit and changed files.

    Returns True if none of them can be measured here.
    """
    elsewhere = []
    for name, files in (every := stale_results()).items():
        need = missing_need(name)
        elsewhere += [name] * (need is not None)
        commit = (stored(name).get("run") or {}).get("commit", "an unknown commit")
        more = f" and {len(files) - 5} more" if len(files) > 5 else ""
        print(f"{name} ({commit}): {', '.join(files[:5])}{more}" + (f" [needs {need}]" if need else ""))
    print(f"{len(every)} of {len(scripts())} results are stale, {len(elsewhere)} of them not measurable here")
    return len(every) == len(elsewhere)


def verdicts() -> None:
    """Evaluate the bars of all stored figures, and print those not met, with the reason."""
    unmet = []
    for name, stem in scripts().items():
        if (RESULTS / f"{name}.json").exists():
            figures = stored(name)
            figures["bars"] = import_module(stem).bars(figures)
            write(name, figures)
            unmet += [
                f"{name:12} {bar_line(bar, reason(name, bar))}" for bar in figures["bars"] if not bar["met"]
            ]
            print(
                f"{name:12} {sum(bool(bar['met']) for bar in figures['bars'])} of {len(figures['bars'])} "
                "bars met"
            )
    print("\n".join(["", *unmet]))


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--quick", action="store_true", help="small settings; no result is kept")
    parser.add_argument("--only", metavar="NAME,NAME", help="these benchmarks")
    parser.add_argument(
        "--jobs", type=int, help="scripts at once: 1; quickly, where times do not count, one a core"
    )
    parser.add_argument(
        "--limit-s", type=float, help=f"for each script: {LIMIT_S:g}; quickly {QUICK_LIMIT_S:g}"
    )
    group = parser.add_mutually_exclusive_group()
    group.add_argument("--stale", action="store_true", help="results older than the code that they measured")
    group.add_argument(
        "--rerun-stale", action="store_true", help="measure these anew, as far as this machine can"
    )
    group.add_argument("--verdicts", action="store_true", help="bars against the figures that are kept")
    group.add_argument("--store-quick", action="store_true", help="write the exact figures of quick runs")
    options = parser.parse_args()
    if options.verdicts:
        verdicts()
        return
    if options.stale:
        sys.exit(not show_stale())
    names = selected(options.only)
    if options.rerun_stale:
        names = [name for name in names if name in stale_results() and missing_need(name) is None]
    if options.store_quick:
        os.environ[STORE_QUICK] = "1"
    is_quick = options.quick or options.store_quick
    limit_s = options.limit_s or (QUICK_LIMIT_S if is_quick else LIMIT_S)
    jobs = options.jobs or (worker_count() if is_quick else 1)
    sys.exit(not run_each(names, is_quick, limit_s, jobs))


if __name__ == "__main__":
    main()

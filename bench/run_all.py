"""Run every benchmark in turn; each prints its tables and keeps its last run in bench/results.

    python bench/run_all.py [--quick] [--verdicts]

`--quick` runs each with its smallest settings and keeps nothing. `--verdicts` runs none: the bars are held against
the figures that are kept, `rate.py`'s too, and written beside them.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from importlib import import_module
from pathlib import Path

from machine import RESULTS, stored, told, write

HERE = Path(__file__).parent


def modules() -> dict[str, str]:
    """The script of each result, by the result's name."""
    return {
        path.stem.removeprefix("bench_"): path.stem for path in [*sorted(HERE.glob("bench_*.py")), HERE / "rate.py"]
    }


def verdicts() -> None:
    """Bars of all kept figures, those not met by name."""
    unmet = []
    for name, stem in modules().items():
        if (RESULTS / f"{name}.json").exists():
            figures = stored(name)
            figures["bars"] = import_module(stem).bars(figures)
            write(name, figures)
            unmet += [f"{name:12} {told(bar)}" for bar in figures["bars"] if not bar["met"]]
            print(f"{name:12} {sum(bool(bar['met']) for bar in figures['bars'])} of {len(figures['bars'])} bars met")
    print("\n".join(["", *unmet]))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--quick", action="store_true", help="small settings; no result is kept")
    parser.add_argument("--verdicts", action="store_true", help="bars against the figures that are kept")
    asked = parser.parse_args()
    if asked.verdicts:
        verdicts()
        return
    failed = []
    for script in sorted(HERE.glob("bench_*.py")):
        print(f"\n== {script.name}", flush=True)
        if subprocess.run([sys.executable, script, *["--quick"] * asked.quick], check=False).returncode:
            failed.append(script.name)
    if failed:
        sys.exit(f"failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()

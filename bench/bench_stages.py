"""What each stage of the paper's coder is worth: bytes and NMSE of ``--coder paper --stage X``, and beside none.

    python bench/bench_stages.py [--nw 6] [--keep FOLDER] [--data FOLDER]

One frame of each field as a segment, as it stands in a file, support and all. First every stage at its default step
and the coder without one; then the bytes of every stage at the NMSE of the coder without one, its step searched for.
Fields are those of `rate.py`.
"""

from __future__ import annotations

import argparse
import math
import tempfile
from pathlib import Path
from time import perf_counter

from machine import keep
from rate_fields import SHARED, cases
from rate_ours import Search
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import STAGES, PaperSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField

NAMES = ("tum band", "icl height", "motorcycle band", "terrain height", "falling")
TRIALS = 9


def measured(field: ForceField, spec: PaperSpec) -> tuple[float, int]:
    """NMSE in dB, and bytes of a segment of one frame."""
    encoder = PaperEncoder(field.grid, spec)
    body = encoder.encode_segment([field]).body
    (decoded,) = PaperDecoder(field.grid, encoder.parameters).frames(body, 1)
    meter = FidelityMeter(0.1, 0.05)
    meter.add(field, decoded)
    return meter.nmse_db if meter.nmse_db is not None else -math.inf, len(body)


def rows_of(field: ForceField) -> dict[str, dict[str, float]]:
    """Every stage on one frame: as asked by default, and at the error of the coder without a stage."""
    wanted_db, plain = measured(field, PaperSpec())
    rows = {"none": {"bytes": plain, "nmse_db": wanted_db}}
    for stage in STAGES[1:]:

        def code(step_n: float, stage: str = stage) -> tuple[float, float]:
            return measured(field, PaperSpec(stage=stage, step_n=step_n))

        nmse_db, size = code(PaperSpec.step_n)
        search = Search(code, wanted_db, 8 * PaperSpec.step_n, trials=TRIALS).run()
        equal = {"equal_error_bytes": search.size(), "equal_error_step_n": search.step()}
        rows[stage] = {"bytes": size, "nmse_db": nmse_db, **equal}
    return rows


def main() -> None:
    """Print and keep the figures."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--nw", type=int, nargs="+", default=[6])
    parser.add_argument("--keep", type=Path, help="a folder of fields, made by an earlier run or to be")
    parser.add_argument(
        "--data", type=Path, default=SHARED, help="the optional real inputs, by default ../shared/data"
    )
    asked, results = parser.parse_args(), {}
    began = perf_counter()
    with tempfile.TemporaryDirectory() as scratch:
        for case in cases(tuple(asked.nw), NAMES, asked.data):
            rows = rows_of(case.frames(asked.keep or Path(scratch))[0])
            results[case.title] = rows
            print(f"{case.title}: stage, bytes, NMSE dB, bytes at the NMSE of none (times those of none)")
            for stage, row in rows.items():
                equal = row.get("equal_error_bytes", row["bytes"])
                told = f"{row['bytes']:>10,.0f} {row['nmse_db']:7.1f} {equal:>10,.0f}"
                print(f"  {stage:8s}{told} ({equal / rows['none']['bytes']:.2f})", flush=True)
    keep("stages", {"fields": results, "seconds": perf_counter() - began})


if __name__ == "__main__":
    main()

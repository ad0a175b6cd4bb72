"""Measures bytes and NMSE of each variant of coder `paper` (``--coder paper --stage X``).

    python bench/bench_stages.py [--quick] [--nw N]

The stages are dpcm, adpcm, dct, wavelet and runs. One frame of each field of `rate.py` is coded as a segment,
with its support. First every stage is measured at its default step, and the coder without a stage. Then the
bytes of every stage are measured at the NMSE of the coder without a stage, for which the step is searched.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from machine import Bar, Figures, at_most, bench, column
from rate_fields import cases
from rate_ours import Search
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import STAGES, PaperSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField

NAMES = ("tum band", "icl height", "motorcycle band", "terrain height", "falling")
TRIALS = 9


def measured(field: ForceField, spec: PaperSpec) -> tuple[float, int]:
    """Return NMSE in dB, and the bytes of a segment of one frame."""
    encoder = PaperEncoder(field.grid, spec)
    body = encoder.encode_segment([field]).body
    (decoded,) = PaperDecoder(field.grid, encoder.parameters).frames(body, 1)
    meter = FidelityMeter(0.1, 0.05)
    meter.add(field, decoded)
    return meter.nmse_db if meter.nmse_db is not None else -math.inf, len(body)


def rows_of(field: ForceField) -> dict[str, dict[str, float]]:
    """Measure every stage on one frame, at its default step and at equal error.

    The error is that of the coder without a stage.
    """
    target_db, plain = measured(field, PaperSpec())
    rows = {"none": {"bytes": plain, "nmse_db": target_db}}
    for stage in STAGES[1:]:

        def code(step_n: float, stage: str = stage) -> tuple[float, float]:
            return measured(field, PaperSpec(stage=stage, step_n=step_n))

        nmse_db, size = code(PaperSpec.step_n)
        search = Search(code, target_db, 8 * PaperSpec.step_n, trials=TRIALS).run()
        equal = {"equal_error_bytes": search.size(), "equal_error_step_n": search.step()}
        rows[stage] = {"bytes": size, "nmse_db": nmse_db, **equal}
    return rows


def measure(nw: int) -> Figures:
    """Measure every stage on every field."""
    with tempfile.TemporaryDirectory() as scratch:
        return {"fields": {c.title: rows_of(c.frames(Path(scratch))[0]) for c in cases((nw,), NAMES)}}


def bars(figures: Figures) -> list[Bar]:
    """Require that dpcm, and the best stage, save bytes on every field."""
    over = []
    for rows in figures["fields"].values():
        if "none" in rows:
            plain = rows["none"]["bytes"]
            stages = {stage: row for stage, row in rows.items() if stage != "none"}
            over.append({stage: row["equal_error_bytes"] / plain for stage, row in stages.items()})
    dpcm, best = max(column(over, "dpcm"), default=None), max((min(o.values()) for o in over), default=None)
    return [
        at_most("bytes of dpcm over those of no stage, worst", dpcm, 1.0),
        at_most("bytes of the best stage over those of none, worst", best, 1.0),
    ]


if __name__ == "__main__":
    bench("stages", __doc__, measure, bars, nw=(6, 4))

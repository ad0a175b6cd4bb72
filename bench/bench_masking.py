"""Measures what spatial masking, by which strong forces raise the bound nearby, changes in coder `touch`
(paper section 4.2): bytes and vibration.

    python bench/bench_masking.py [--nw N ...] [--quick]

One frame of each field of `rate_fields` is coded with the error bound max(F_0, k |F| + beta m), where m is
the mean of |F| within 2.5 mm, k = 0.1 and F_0 = 0.05 N. No value of beta is established in the literature;
three are tried. For comparison, the frame is coded with k + beta in place of k, which allows at least as much
error wherever the surrounding force is no stronger.

The vibration is the error that a hand meets which slides at 100 mm/s, from 40 to 400 Hz. As for every
mechanism of the coder, the bar is 3 % of the bytes on the mean of the fields.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

from machine import Bar, Figures, at_most, bench, column, figure, text
from rate_fields import cases
from rate_symbols import F0_N, K
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.perception.hand_motion import slides

BETAS = (0.02, 0.05, 0.1)


def mean(ratios: list[float]) -> float:
    """Return the geometric mean."""
    return math.exp(sum(map(math.log, ratios)) / len(ratios))


def coded(frame: ForceField, k: float, masking: float = 0.0) -> tuple[int, FidelityMeter, float]:
    """Return bytes, fidelity, and vibration of the error of a coded frame, mN rms."""
    spec = TouchSpec(k=k, f0_n=F0_N, masking=masking)
    encoder = TouchEncoder(frame.grid, spec)
    body = encoder.encode_segment([frame]).body
    (back,) = TouchDecoder(frame.grid, encoder.parameters).frames(body, 1)
    meter = FidelityMeter(k, F0_N, (masking, spec.masking_radius_m) if masking else None)
    meter.add(frame, back)
    slide = slides(frame, back)[1]  # at 100 mm/s
    return len(body) + len(encoder.parameters), meter, slide.error_mn


def measure(nw: tuple[int, ...]) -> Figures:
    """Measure each field."""
    rows: dict[str, Figures] = {}
    with tempfile.TemporaryDirectory() as name:
        for case in cases(nw):
            frame = case.frames(Path(name))[0]
            plain, meter, hum_mn = coded(frame, K)
            row: Figures = {"bytes": plain, "hum_mn": hum_mn}
            beyond = meter.mask_violations
            for beta in BETAS:
                masked, meter, hum_mn = coded(frame, K, beta)
                row |= {f"beta {beta}": masked / plain, f"hum_mn {beta}": hum_mn}
                row[f"k {K + beta:.2f}"] = coded(frame, K + beta)[0] / plain
                beyond += meter.mask_violations
            rows[case.title] = {**row, "beyond": beyond}
            print(case.title, {key: text(value) for key, value in rows[case.title].items()}, flush=True)
    ratios = [f"beta {beta}" for beta in BETAS] + [f"k {K + beta:.2f}" for beta in BETAS]
    return {"fields": rows, "mean": {key: mean(column(rows, key)) for key in ratios}}


def bars(figures: Figures) -> list[Bar]:
    """Require 3 % fewer bytes with masking, and no violation of the error bound."""
    return [
        at_most(
            "masking: bytes with beta 0.05 over those without, mean of the fields",
            figure(figures, "mean", "beta 0.05"),
            0.97,
        ),
        at_most("masking: voxels beyond the promise", sum(column(figures["fields"], "beyond")), 0),
    ]


if __name__ == "__main__":
    bench("masking", __doc__, measure, bars, nw=((6, 7), (6,)))

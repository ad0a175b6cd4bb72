"""Reproduces figure 2 of the paper: a haptic signal, its quantised version, the error, and the perceptual
mask (eq. 6).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from reproduction.experiment import Experiment, Finding, Inputs, markdown_table
from touchfield.perception.weber import WeberLadder, jnd_gain, quantise_fixed_step, within_mask_from_n
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.options import SourceOptions
from touchfield.viewer.plots import draw_masked_signal

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float64s = NDArray[np.float64]

__all__ = ["EXPERIMENT"]

K, STEP_N, FORCE_MIN_N, FORCE_MAX_N = 0.25, 0.5, 0.03, 3.3


def run(inputs: Inputs) -> Finding:
    """Quantise a real signal in three readings of eq. 6, and check the condition that the figure states."""
    t_s, x_n = stroke()
    ladder = WeberLadder.spanning(K, FORCE_MIN_N, FORCE_MAX_N)
    readings = {
        f"as printed: a gain of {jnd_gain(K):g}": jnd_gain(K) * x_n,
        f"fixed step of {STEP_N:g} N": quantise_fixed_step(x_n, STEP_N),
        f"Weber ladder, {ladder.steps} levels": np.asarray(
            ladder.levels_n[np.searchsorted(ladder.thresholds_n, x_n, side="right")], np.float64
        ),
    }
    picture = inputs.folder / "fig2.png"
    draw_masked_signal(picture, t_s, x_n, readings, K)
    why = (
        f"|x| / Delta = 1/k whatever x is: Q multiplies by k floor(1/k + 1/2) = {jnd_gain(K):g} and is no "
        "quantiser",
        "an error up to Delta / 2 keeps the mask for certain only from Delta / (2 k) = "
        f"{within_mask_from_n(STEP_N, K):g} N on",
        f"borders that grow by (1 + k) / (1 - k) = {ladder.ratio:.3f} keep the relative error within k",
    )
    labels = ("literal: Delta = k x", "literal: one fixed Delta", "corrected: Weber ladder")
    rows, data = [], {}
    for label, q, reason in zip(labels, readings.values(), why, strict=True):
        error = np.abs(q - x_n)
        felt = float((error > K * x_n * (1 + 1e-9)).mean())
        worst = float((error / x_n).max())
        data[label] = {"values": len(np.unique(q)), "beyond_mask": felt, "worst_relative_error": worst}
        rows.append(["never", label, f"{felt:.1%}", f"{worst:.3f}", len(np.unique(q)), reason])
    head = [
        "beyond the mask, printed",
        "reading of eq. 6",
        "beyond, ours",
        "worst error / x",
        "values",
        "why",
    ]
    text = (
        'The paper\'s figure is "qualitative": a signal x(t), Q(x), the error and the mask Delta(x) = k x '
        "with k = "
        f"{K:g}, and the condition that the error never leaves the mask. Here the signal is what a hand "
        "feels that "
        "strokes 9 cm over a real mountain in one second (the Jacksboro fault, Tennessee, heights times 5, "
        "for a "
        f"Phantom Omni): {x_n.min():.2f} to {x_n.max():.2f} N, {len(x_n)} samples.\n\n"
        "![signal, Q(x), error and mask](fig2.png)\n\n"
    )
    return Finding(text + markdown_table(head, rows), _told(data, x_n), (picture,))


def stroke() -> tuple[Float64s, Float64s]:
    """Times, s, and the force of a straight stroke over the mountain, newtons; float64 [1000] each."""
    prepared = prepare("sample:terrain", EncodeSpec(mapping="fill", source=SourceOptions(exaggeration=5.0)))
    t = np.linspace(0, 1, 1000)
    path_m = np.stack([-0.045 + 0.09 * t, np.full_like(t, -0.02), np.full_like(t, -0.007)], axis=1)
    return t, np.linalg.norm(prepared.medium[0].sample_n(path_m), axis=1).astype(np.float64)


def _told(data: dict[str, Any], x_n: Float64s) -> dict[str, Any]:
    return {"k": K, "signal_n": {"min": float(x_n.min()), "max": float(x_n.max())}, "readings": data}


EXPERIMENT = Experiment("fig2", "Figure 2: quantisation within the perceptual mask", run)

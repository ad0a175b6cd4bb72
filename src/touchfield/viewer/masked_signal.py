"""The picture of a quantised signal and its perceptual mask (paper figure 2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path


_QUANTISED, _FELT = "#0072b2", "#d55e00"


def draw_masked_signal(path: Path, t_s: Float64s, x_n: Float64s, readings: Mapping[str, Float64s], k: float) -> None:
    """Write a PNG with a column for each reading: above the signal and Q of it, below the error and its mask.

    Parameters
    ----------
    path : Path
    t_s : float64 [n]
        Times, s.
    x_n : float64 [n]
        The signal, newtons, not negative.
    readings : mapping of str to float64 [n]
        Q(x) by the name that stands above it, newtons.
    k : float
        Weber fraction: the mask is k x. What a hand could feel, an error beyond it, is drawn in orange.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    title = f"a force, quantised; its error, and the mask of {k:g} x"
    figure = titled_figure("the picture of a quantised signal", title, 4.3 * len(readings), 6.0)
    axes = figure.subplots(2, len(readings), sharex=True, sharey="row", squeeze=False)
    for (name, q), (top, bottom) in zip(readings.items(), axes.T, strict=True):
        top.plot(t_s, x_n, color="0.55", lw=2.5, label="signal x")
        top.plot(t_s, q, color=_QUANTISED, lw=1.2, label="Q(x)")
        top.set_title(name, fontsize=10, parse_math=False)
        error, mask = np.abs(q - x_n), k * x_n
        bottom.fill_between(t_s, mask, color="0.85", lw=0, label=f"mask, {k:g} x")
        bottom.plot(t_s, error, color=_QUANTISED, lw=1.2, label="error |Q(x) - x|")
        beyond = np.where(error > mask * (1 + 1e-9), error, np.nan)
        bottom.plot(t_s, beyond, color=_FELT, lw=2.2, label="beyond the mask")
        bottom.set_xlabel("time / s")
    axes[0, 0].set_ylabel("force / N")
    axes[1, 0].set_ylabel("error / N")
    axes[0, 0].legend(loc="upper left", fontsize=8)
    axes[1, -1].legend(loc="upper right", fontsize=8)
    write_png(figure, path)

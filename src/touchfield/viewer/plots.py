"""Draws curves: a quantised signal with its perceptual mask (paper figure 2), and the vibration of materials.

Each picture is written as PNG. The functions raise `MissingExtra` if matplotlib is not installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

_QUANTISED, _BEYOND = "#0072b2", "#d55e00"


def draw_masked_signal(
    path: Path, t_s: Float64s, x_n: Float64s, readings: Mapping[str, Float64s], k: float
) -> None:
    """Draw each reading Q(x) of a signal x, its error, and the mask k x.

    Each reading has a column, with its name as title. Times are in seconds, the signal and its readings in
    newtons, float64 [n]. An error outside the mask is drawn in orange.
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
        bottom.plot(t_s, beyond, color=_BEYOND, lw=2.2, label="beyond the mask")
        bottom.set_xlabel("time / s")
    axes[0, 0].set_ylabel("force / N")
    axes[1, 0].set_ylabel("error / N")
    axes[0, 0].legend(loc="upper left", fontsize=8)
    axes[1, -1].legend(loc="upper right", fontsize=8)
    write_png(figure, path)


def draw_textures(
    path: Path, bands_hz: tuple[float, ...], rows: dict[str, Float64s], threshold_n: Float64s
) -> None:
    """Draw vibrations in bands, and the perception threshold.

    `rows` are newtons rms [bands] by label, `threshold_n` newtons [bands].
    """
    figure = titled_figure("the picture of a texture", "vibration in thirds of an octave", 8.0, 4.5)
    axis = figure.subplots()
    for n, (label, levels_n) in enumerate(rows.items()):
        levels_mn = np.where(levels_n > 0, 1e3 * levels_n, np.nan)
        axis.loglog(bands_hz, levels_mn, "o-", ms=3, lw=1.2, color=f"C{n % 10}", label=label)
    axis.fill_between(
        bands_hz,
        1e3 * threshold_n,
        1e3 * threshold_n.min() / 10,
        color="0.9",
        lw=0,
        label="below the threshold",
    )
    axis.set(xlabel="frequency / Hz", ylabel="force / mN rms")
    axis.legend(fontsize=8)
    write_png(figure, path)

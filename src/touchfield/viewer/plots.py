"""Draws curves: a quantised signal with its perceptual mask (paper figure 2), and the vibration of materials.

Each picture is written as PNG. The functions raise `MissingExtra` if matplotlib is not installed.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

_QUANTISED, _BEYOND = "#0072b2", "#d55e00"
_MAX_NAMED: Final = 8  # colours that a legend names


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


class TextureCurve(NamedTuple):
    """Vibration of a material at a speed and a force: newtons rms, float64 [bands]."""

    material: str
    speed_m_s: float
    force_n: float
    levels_n: Float64s


def draw_textures(
    path: Path, bands_hz: tuple[float, ...], curves: Sequence[TextureCurve], threshold_n: Float64s
) -> None:
    """Draw vibrations in bands, and the perception threshold, `threshold_n` newtons [bands].

    A model has 24 curves. The legend therefore names colours: those of the materials or, of a single one, of
    its speeds. Curves of greater forces are wider.
    """
    materials = dict.fromkeys(curve.material for curve in curves)
    by_speed, forces = len(materials) == 1, sorted({curve.force_n for curve in curves})
    labels = [f"{1e3 * c.speed_m_s:.4g} mm/s" if by_speed else c.material for c in curves]
    groups = {label: f"C{n % 10}" for n, label in enumerate(dict.fromkeys(labels))}
    subject = f"{', '.join(materials)}: vibration" if by_speed else "vibration"
    title = f"{subject} in thirds of an octave"
    if forces:  # materials may have friction alone
        title += f", at {forces[0]:.4g} N"
    if len(forces) > 1:
        title += f" (thin) to {forces[-1]:.4g} N (wide)"
    figure = titled_figure("the picture of a texture", title, 8.0, 4.5)
    axis = figure.subplots()
    named = set[str]()
    for curve, label in zip(curves, labels, strict=True):
        levels_mn = np.where(curve.levels_n > 0, 1e3 * curve.levels_n, np.nan)
        width = 1.2 if len(forces) == 1 else 0.6 + 1.8 * forces.index(curve.force_n) / (len(forces) - 1)
        (line,) = axis.loglog(bands_hz, levels_mn, "o-", ms=3, lw=width, color=groups[label])
        if label not in named and len(named) < _MAX_NAMED:
            line.set_label(label)
            named.add(label)
    axis.fill_between(
        bands_hz,
        1e3 * threshold_n,
        1e3 * threshold_n.min() / 10,
        color="0.9",
        lw=0,
        label="below the threshold",
    )
    axis.set(xlabel="frequency / Hz", ylabel="force / mN rms")
    more = len(groups) - len(named)
    legend = axis.legend(fontsize=8, title=f"and {more} more" if more else None, title_fontsize=8)
    for text in legend.get_texts():
        text.set_parse_math(False)  # names from files
    write_png(figure, path)

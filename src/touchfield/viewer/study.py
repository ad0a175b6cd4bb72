"""Draws the psychometric functions of a study."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.study.analysis import Fit


def draw_fits(
    path: Path, title: str, unit: str, fits: Mapping[str, Fit], levels: Sequence[Mapping[str, Any]]
) -> None:
    """Draw rates of correct answers, fitted functions and intervals of thresholds, PNG.

    `fits` are by participant; `levels` are rows of `touchfield.study.analysis.level_tests` with the key
    "participant". `MissingExtra` if matplotlib is not installed.
    """
    figure = titled_figure("the picture of a study", title, 8.0, 5.0)
    axis = figure.subplots()
    ends = [row["level"] for row in levels]
    x = np.geomspace(min(ends) / 1.5, max(ends) * 1.5, 200)
    for n, (label, fit) in enumerate(fits.items()):
        colour, rows = f"C{n % 10}", [row for row in levels if row["participant"] == label]
        at, rates = np.array([row["level"] for row in rows]), np.array([row["rate"] for row in rows])
        low, high = (np.array([row[key] for row in rows]) for key in ("low", "high"))
        spread = [np.maximum(rates - low, 0), np.maximum(high - rates, 0)]
        axis.errorbar(at, rates, spread, fmt="o", ms=4, lw=1, color=colour)
        axis.plot(
            x, fit.function(x), color=colour, lw=1.5, label=f"{label}: {fit.function.threshold:.3g} {unit}"
        )
        interval = fit.low or x[0], fit.high or x[-1]
        height = float(fit.function(fit.function.threshold))
        axis.plot(interval, [height, height], color=colour, lw=3, alpha=0.5, solid_capstyle="butt")
    chance = next(iter(fits.values())).function.chance
    axis.axhline(chance, color="0.6", lw=1, ls="--")
    axis.set(xscale="log", xlabel=f"level / {unit}", ylabel="correct answers", ylim=(0, 1.03))
    axis.legend(fontsize=8, title="threshold")
    write_png(figure, path)

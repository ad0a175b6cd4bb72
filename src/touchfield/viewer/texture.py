"""The picture of what surfaces are made of: spectra of their vibration beside the threshold of a hand."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path


def draw_textures(path: Path, bands_hz: tuple[float, ...], rows: dict[str, Float64s], threshold_n: Float64s) -> None:
    """Write a PNG with a line for each row, newtons rms [bands] by its label, and the threshold, likewise.

    Raises `MissingExtra` if matplotlib is not installed.
    """
    figure = titled_figure("the picture of a texture", "vibration in thirds of an octave", 8.0, 4.5)
    axis = figure.subplots()
    for n, (label, levels_n) in enumerate(rows.items()):
        shown = np.where(levels_n > 0, 1e3 * levels_n, np.nan)
        axis.loglog(bands_hz, shown, "o-", ms=3, lw=1.2, color=f"C{n % 10}", label=label)
    axis.fill_between(bands_hz, 1e3 * threshold_n, 1e3 * threshold_n.min() / 10, color="0.9", lw=0, label="not felt")
    axis.set_xlabel("frequency / Hz")
    axis.set_ylabel("force / mN rms")
    axis.legend(fontsize=8)
    write_png(figure, path)

"""The picture of what a medium can be reduced to: the spectrum of its modes, a section with what no hand feels."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.medium import ForceField


def draw_reduction(path: Path, values: Float64s, field: ForceField, felt: Bools, title: str) -> None:
    """Write a PNG: the error after so many modes, by singular values; |F| on the section across z that most is left
    out of, in red what is not `felt`, bool [nx, ny, nz]. Raises `MissingExtra` if matplotlib is not installed.
    """
    figure = titled_figure("the picture of a reduction", title, 11.0, 4.5)
    left, right = figure.subplots(1, 2)
    squares = values**2
    tail = np.append(np.cumsum(squares[::-1])[::-1], 0.0) / max(float(squares.sum()), 1e-300)
    left.plot(10 * np.log10(np.maximum(tail, 1e-10)), color="#0072b2")
    left.set(xlabel="modes kept", ylabel="error / dB of the energy", ylim=(-60, 3))
    size = np.linalg.norm(field.to_dense(), axis=-1)
    at = int(np.argmax((size > 0).sum(axis=(0, 1)) + 1000 * ((size > 0) & ~felt).sum(axis=(0, 1))))
    extent = 1e3 * np.stack(field.grid.box_m)[:, :2].T.ravel()
    image = right.imshow(size[:, :, at].T, origin="lower", extent=extent, cmap="cividis")
    gone = np.where((size[:, :, at] > 0) & ~felt[:, :, at], 1.0, np.nan)
    right.imshow(gone.T, origin="lower", extent=extent, cmap="Reds", vmin=0, vmax=1.4)
    right.set(xlabel="x / mm", ylabel="y / mm")
    figure.colorbar(image, ax=right, label="|F| / N; red: never felt", shrink=0.85)
    write_png(figure, path)

"""Pictures of curves and places: a masked signal (paper figure 2), textures, a reduction, the fewest points.

Each is written as PNG; `MissingExtra` where matplotlib is not installed.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.arrays import Bools, Float64s
from touchfield.perception.mask import mask_n
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.medium import ForceField

_QUANTISED, _FELT = "#0072b2", "#d55e00"


def draw_masked_signal(path: Path, t_s: Float64s, x_n: Float64s, readings: Mapping[str, Float64s], k: float) -> None:
    """Draw a column for each reading Q(x): above the signal and Q of it, below the error and its mask k x.

    Times are in seconds, the signal and its readings, by the names above them, in newtons, float64 [n]. An error
    beyond the mask, which a hand could feel, is drawn in orange.
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


def draw_textures(path: Path, bands_hz: tuple[float, ...], rows: dict[str, Float64s], threshold_n: Float64s) -> None:
    """Draw a line for each row, newtons rms [bands] by its label, and the threshold of a hand, likewise."""
    figure = titled_figure("the picture of a texture", "vibration in thirds of an octave", 8.0, 4.5)
    axis = figure.subplots()
    for n, (label, levels_n) in enumerate(rows.items()):
        shown = np.where(levels_n > 0, 1e3 * levels_n, np.nan)
        axis.loglog(bands_hz, shown, "o-", ms=3, lw=1.2, color=f"C{n % 10}", label=label)
    axis.fill_between(bands_hz, 1e3 * threshold_n, 1e3 * threshold_n.min() / 10, color="0.9", lw=0, label="not felt")
    axis.set(xlabel="frequency / Hz", ylabel="force / mN rms")
    axis.legend(fontsize=8)
    write_png(figure, path)


def draw_reduction(path: Path, values: Float64s, field: ForceField, felt: Bools, title: str) -> None:
    """Draw the error after so many modes, by singular values; |F| on the section across z that most is left out of.

    In red is what is not `felt`, bool [nx, ny, nz].
    """
    figure = titled_figure("the picture of a reduction", title, 11.0, 4.5)
    left, right = figure.subplots(1, 2)
    squares = values**2
    tail = np.append(np.cumsum(squares[::-1])[::-1], 0.0) / max(float(squares.sum()), 1e-300)
    left.plot(10 * np.log10(np.maximum(tail, 1e-10)), color="#0072b2")
    left.set(xlabel="modes kept", ylabel="error / dB of the energy", ylim=(-60, 3))
    left.xaxis.get_major_locator().set_params(integer=True)
    size = np.linalg.norm(field.to_dense(), axis=-1)
    at = int(np.argmax((size > 0).sum(axis=(0, 1)) + 1000 * ((size > 0) & ~felt).sum(axis=(0, 1))))
    extent = 1e3 * np.stack(field.grid.box_m)[:, :2].T.ravel()
    image = right.imshow(size[:, :, at].T, origin="lower", extent=extent, cmap="cividis")
    gone = np.where((size[:, :, at] > 0) & ~felt[:, :, at], 1.0, np.nan)
    right.imshow(gone.T, origin="lower", extent=extent, cmap="Reds", vmin=0, vmax=1.4)
    right.set(xlabel="x / mm", ylabel="y / mm")
    figure.colorbar(image, ax=right, label="|F| / N; red: never felt", shrink=0.85)
    write_png(figure, path)


def draw_points(
    path: Path,
    points_m: Float64s,
    places_m: Float64s,
    forces_n: Float64s,
    rebuilt_n: Float64s | None,
    mask: tuple[float, float],
) -> None:
    """Draw forces, newtons [m, 3], at places, metres [m, 3], seen along the axis of least extent.

    Points [n, 3] are rings. Without `rebuilt_n` they are yet to be measured; with it a panel of it follows, and one
    of the error over the `mask` max(F_0, k |F|), (k, F_0), the worst on top.
    """
    across, up = np.sort(np.argsort(np.ptp(places_m, axis=0), kind="stable")[1:])
    size = np.linalg.norm(forces_n, axis=1)
    top = {"vmin": 0.0, "vmax": float(size.max()), "cmap": "cividis"}
    panels: list[tuple[str, str, Float64s, dict[str, Any]]] = [("the field", "|F| / N", size, top)]
    if rebuilt_n is not None:
        off = np.linalg.norm(rebuilt_n - forces_n, axis=1) / mask_n(size, *mask)
        label = f"|error| / max({mask[1]:g} N, {mask[0]:g} |F|)"
        panels.append(("rebuilt from the points", "|F| / N", np.linalg.norm(rebuilt_n, axis=1), top))
        panels.append(("what is missed", label, off, {"vmin": 0.0, "vmax": 2.0, "cmap": "PuOr_r"}))
    title = f"{len(points_m)} points of {len(places_m)}" if rebuilt_n is not None else f"{len(points_m)} points next"
    figure = titled_figure("the picture of the fewest points", title, 5.0 * len(panels), 4.4)
    for axis, (name, label, values, style) in zip(np.ravel(figure.subplots(1, len(panels))), panels, strict=True):
        order = np.argsort(values, kind="stable")
        dots = axis.scatter(*1e3 * places_m[order][:, [across, up]].T, c=values[order], s=6, lw=0, **style)
        axis.scatter(*1e3 * points_m[:, [across, up]].T, s=40, facecolors="none", edgecolors="C3", lw=1.3)
        axis.set_title(name, fontsize=10)
        axis.set(xlabel=f"{'xyz'[across]} / mm", ylabel=f"{'xyz'[up]} / mm", aspect="equal")
        figure.colorbar(dots, ax=axis, shrink=0.8).set_label(label, fontsize=9)
    write_png(figure, path)

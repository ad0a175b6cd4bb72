"""Draws what a reduction found (paper section 6): the error by the number of modes with the samples that no
hand reaches, and a few points with the field that is rebuilt from them.

Each picture is written as PNG. The functions raise `MissingExtra` if matplotlib is not installed.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from touchfield.arrays import Bools, Float64s, lengths_of
from touchfield.perception.grip import WeberCurve
from touchfield.perception.mask import Weber, mask_n
from touchfield.viewer.page import titled_figure, write_png
from touchfield.viewer.slices import choose_slice, largest_slice, supported_span

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.medium import ForceField

_RING: Final = "#d55e00"
_MAX_NUMBERED: Final = 30
_LOWEST_DB: Final = -60.0


def draw_reduction(
    path: Path, values: Float64s, field: ForceField, is_reachable: Bools, title: str, axes: str = ""
) -> None:
    """Draw the error that is left after so many modes, and |F| of a field on a slice.

    `values` are the singular values of the modes, float64 [n]. `is_reachable`, bool [nx, ny, nz], are the
    samples that are not left out; the slice is the one with the most samples left out, which are drawn in
    grey, and is cropped to the samples with forces.
    """
    figure = titled_figure("the picture of a reduction", title, 11.0, 4.7)
    left, right = figure.subplots(1, 2)
    squares = values**2
    tail = np.append(np.cumsum(squares[::-1])[::-1], 0.0) / max(float(squares.sum()), 1e-300)
    left.plot(10 * np.log10(np.maximum(tail, 10 ** (_LOWEST_DB / 10 - 1))), "o-", ms=3, color="#0072b2")
    left.set(xlabel="modes", ylabel="error / dB of the energy", ylim=(_LOWEST_DB, 3))
    left.xaxis.get_major_locator().set_params(integer=True)
    left.spines[["top", "right"]].set_visible(False)
    _draw_left_out(figure, right, field, is_reachable, axes)
    write_png(figure, path)


def _draw_left_out(figure: Any, panel: Any, field: ForceField, is_reachable: Bools, axes: str) -> None:
    dense = field.to_dense()
    size_n = lengths_of(dense)
    left_out = (size_n > 0) & ~is_reachable
    spacing_m = field.grid.spacing_m
    cut = largest_slice(left_out, spacing_m, axes) if left_out.any() else choose_slice(dense, spacing_m, axes)
    own_n, own_left_out = cut.of(size_n), cut.of(left_out)
    window = supported_span(own_n > 0, 0), supported_span(own_n > 0, 1)
    extent = []
    for axis, span in zip((cut.across, cut.up), window, strict=True):
        low_m, step_m = field.grid.box_m[0][axis], spacing_m[axis]
        extent += [1e3 * (low_m + span.start * step_m), 1e3 * (low_m + span.stop * step_m)]
    style: dict[str, Any] = {"origin": "lower", "extent": extent, "interpolation": "nearest"}
    image = panel.imshow(np.where(own_n > 0, own_n, np.nan)[window].T, cmap="viridis", vmin=0, **style)
    panel.imshow(np.where(own_left_out, 1.0, np.nan)[window].T, cmap="Greys", vmin=0, vmax=2, **style)
    at_mm = 1e3 * field.grid.axis_m(cut.axis)[cut.index]
    what = "grey: left out" if left_out.any() else "nothing is left out"
    panel.set_title(f"slice at {'xyz'[cut.axis]} = {at_mm:.1f} mm; {what}", fontsize=10)
    _label(panel, cut.across, cut.up, axes)
    figure.colorbar(image, ax=panel, label="|F| / N", shrink=0.85)


def draw_points(
    path: Path,
    points_m: Float64s,
    positions_m: Float64s,
    forces_n: Float64s,
    rebuilt_n: Float64s | None,
    mask: tuple[Weber, float],
    axes: str = "",
) -> None:
    """Draw |F| of forces, newtons [m, 3], at positions, metres [m, 3], seen along their shortest side.

    `points_m` [n, 3] are rings, numbered by the order of selection if there are few. With `rebuilt_n`, the
    forces that are rebuilt from them, follow a panel of these and one of the error in units of the mask
    max(F_0, k |F|), `mask` (k, F_0), the largest on top. Without, the points are yet to be measured, and a
    panel is seen along the next side.
    """
    short, middle, _ = (int(n) for n in np.argsort(np.ptp(positions_m, axis=0), kind="stable"))
    size_n = lengths_of(forces_n)
    scale: dict[str, Any] = {"vmin": 0.0, "vmax": max(float(size_n.max()), 1e-9), "cmap": "cividis"}
    field = _Dots("|F| / N", size_n, scale)
    if rebuilt_n is None:
        title = f"the next {len(points_m)} points, after {len(positions_m)} samples"
        panels = [(f"seen along {'xyz'[axis]}", axis, field) for axis in (short, middle)]
    else:
        title = f"{len(points_m)} points of {len(positions_m)} samples"
        rebuilt = _Dots("|F| / N", lengths_of(rebuilt_n), scale)
        error = lengths_of(rebuilt_n - forces_n) / mask_n(size_n, *mask)
        k, f0_n = mask
        label = f"|error| / max({f0_n:g} N, {'k(|F|)' if isinstance(k, WeberCurve) else f'{k:g}'} |F|)"
        errors = _Dots(label, error, {"vmin": 0.0, "vmax": 2.0, "cmap": "PuOr_r"})
        names = "the field", "rebuilt from the points", "error"
        panels = [(name, short, dots) for name, dots in zip(names, (field, rebuilt, errors), strict=True)]
    figure = titled_figure("the picture of the fewest points", title, 5.0 * len(panels), 4.6)
    for panel, (name, sight, dots) in zip(
        figure.subplots(1, len(panels), squeeze=False)[0], panels, strict=True
    ):
        panel.set_title(name, fontsize=10)
        _draw_dots(figure, panel, dots, positions_m, points_m, sight, axes)
    write_png(figure, path)


class _Dots(NamedTuple):
    """Values of the dots of a panel, [m], with the label and the style of their colours."""

    label: str
    values: Float64s
    style: dict[str, Any]


def _draw_dots(
    figure: Any, panel: Any, dots: _Dots, positions_m: Float64s, points_m: Float64s, sight: int, axes: str
) -> None:
    """Draw the dots seen along the axis `sight`, the largest on top, and a ring at each point."""
    across, up = (n for n in range(3) if n != sight)
    if any(f"{'xyz'[across]} {way}" in axes for way in ("up", "down")):
        across, up = up, across
    order = np.argsort(dots.values, kind="stable")
    at_mm, rings_mm = (1e3 * positions[:, [across, up]] for positions in (positions_m[order], points_m))
    drawn = panel.scatter(*at_mm.T, c=dots.values[order], s=8, lw=0, **dots.style)
    panel.scatter(*rings_mm.T, s=50, facecolors="none", edgecolors=_RING, lw=1.4)
    numbers: dict[tuple[float, ...], list[str]] = {}  # of the points that this view shows as one
    for n, ring_mm in enumerate(rings_mm if len(rings_mm) <= _MAX_NUMBERED else ()):
        numbers.setdefault(tuple(ring_mm.round(2).tolist()), []).append(str(n + 1))
    for place_mm, texts in numbers.items():
        text, style = ", ".join(texts), {"fontsize": 7, "color": _RING}
        panel.annotate(text, place_mm, (5, 5), textcoords="offset points", **style)
    panel.set_aspect("equal")
    _label(panel, across, up, axes)
    figure.colorbar(drawn, ax=panel, shrink=0.8).set_label(dots.label, fontsize=9)


def _label(panel: Any, across: int, up: int, axes: str) -> None:
    panel.set(xlabel=f"{'xyz'[across]} / mm", ylabel=f"{'xyz'[up]} / mm")
    if f"{'xyz'[up]} down" in axes:
        panel.invert_yaxis()

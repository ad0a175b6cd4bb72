"""The picture of the fewest points: the field with the points on it, the field rebuilt, and what is missed."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.arrays import Float64s
from touchfield.perception.mask import mask_n
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path


def draw_points(
    path: Path,
    points_m: Float64s,
    places_m: Float64s,
    forces_n: Float64s,
    rebuilt_n: Float64s | None,
    mask: tuple[float, float],
) -> None:
    """Write a PNG of forces, newtons [m, 3], at places, metres [m, 3], seen along the axis of least extent.

    Points [n, 3] are rings. Without `rebuilt_n` they are yet to be measured; with it a panel of it follows, and one
    of the error over the `mask` max(F_0, k |F|), (k, F_0), the worst on top.

    Raises `MissingExtra` if matplotlib is not installed.
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
        axis.set_xlabel(f"{'xyz'[across]} / mm")
        axis.set_ylabel(f"{'xyz'[up]} / mm")
        axis.set_aspect("equal")
        figure.colorbar(dots, ax=axis, shrink=0.8).set_label(label, fontsize=9)
    write_png(figure, path)

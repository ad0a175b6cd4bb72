"""The picture of a comparison: source, decoded, and error in units of the mask, side by side.

Colours are perceptually even and safe for the colour-blind (cividis, and purple to orange for signs); source
and decoded share one scale; every scale carries its unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.errors import MissingExtra
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from touchfield.medium import ForceField, Grid

__all__ = ["PictureSpec", "draw_comparison"]

_ARROWS = 26  # along the longer side of the direction panels


@dataclass(frozen=True)
class PictureSpec:
    """What stands around the panels.

    Attributes
    ----------
    title : str
    caption : str
        The figures of the comparison, one or two lines.
    axes : str
        The medium's wording of its axes, "x right, y down, z forward".
    k, f0_n : float
        The mask max(F_0, k |F|).
    """

    title: str
    caption: str
    axes: str
    k: float
    f0_n: float


def draw_comparison(path: Path, original: ForceField, decoded: ForceField, spec: PictureSpec) -> None:
    """Write a PNG that compares two fields on one grid.

    Rows: the strongest force along the line of sight (the scene as the device's user faces it); |F| on a
    slice across the line of sight's other axis; direction on the same slice. Columns: source, decoded, error.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra("the picture of a comparison", "matplotlib", "report") from None
    panels = _Panels(original, decoded, spec)
    figure = Figure(figsize=(13.5, 12.6), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(3, 3)
    panels.draw_amplitudes(figure, axes[0], panels.front)
    panels.draw_amplitudes(figure, axes[1], panels.slice)
    panels.draw_directions(figure, axes[2])
    figure.suptitle(f"{spec.title}\n{spec.caption}", fontsize=11)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        figure.savefig(file, format="png")


@dataclass(frozen=True)
class _View:
    """A flat image of the field: which axes it spans and what is seen on it."""

    name: str
    across: int
    up: int
    source: NDArray[np.float32]  # [across, up] newtons
    decoded: NDArray[np.float32]
    error: NDArray[np.float32]  # [across, up] in units of the mask


class _Panels:
    def __init__(self, original: ForceField, decoded: ForceField, spec: PictureSpec) -> None:
        self.spec = spec
        self.grid: Grid = original.grid
        x, y = original.to_dense(), decoded.to_dense()
        force, got = np.linalg.norm(x, axis=-1), np.linalg.norm(y, axis=-1)
        error = np.linalg.norm(y - x, axis=-1) / np.maximum(spec.f0_n, spec.k * force)
        error[(force == 0) & (got == 0)] = -1  # empty space: drawn as background
        sight = 1 if "z up" in spec.axes else 2
        across, up = (a for a in range(3) if a != sight)
        self.front = _View(
            f"strongest along {'xyz'[sight]}", across, up, force.max(sight), got.max(sight), error.max(sight)
        )
        # the slice is looked at from the side, so that depth is seen: it spans `across` and the line of sight
        self.cut_axis = up
        self.cut = int(np.argmax((force > 0).sum(axis=tuple(a for a in range(3) if a != up))))
        taken = [np.take(a, self.cut, axis=up) for a in (force, got, error)]
        self.slice = _View(f"slice at {'xyz'[up]} = {self._mm(up, self.cut)}", across, sight, *taken)
        self.vectors = [np.take(a, self.cut, axis=up) for a in (x, y)]
        self.top_n = float(max(force.max(), got.max(), 1e-6))

    def _mm(self, axis: int, index: int) -> str:
        return f"{1e3 * (self.grid.origin_m[axis] + index * self.grid.spacing_m[axis]):.1f} mm"

    def _flips(self, axis: int) -> bool:
        """Whether the axis points down the page in the medium's own wording."""
        return f"{'xyz'[axis]} down" in self.spec.axes

    def _frame(self, panel: Any, view: _View, title: str) -> list[float]:
        low, high = (1e3 * c for c in self.grid.box_m)
        panel.set_title(title, fontsize=9)
        panel.set_xlabel(f"{'xyz'[view.across]} / mm", fontsize=8)
        panel.set_ylabel(f"{'xyz'[view.up]} / mm", fontsize=8)
        panel.tick_params(labelsize=7)
        return [low[view.across], high[view.across], low[view.up], high[view.up]]

    def _image(self, panel: Any, view: _View, values: NDArray[Any], title: str, **style: Any) -> Any:
        extent = self._frame(panel, view, title)
        image = panel.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **style)
        if self._flips(view.up):
            panel.invert_yaxis()
        return image

    def draw_amplitudes(self, figure: Any, row: Any, view: _View) -> None:
        scale = {"vmin": 0.0, "vmax": self.top_n, "cmap": "cividis"}
        self._image(row[0], view, view.source, f"source |F|, {view.name}", **scale)
        shown = self._image(row[1], view, view.decoded, f"decoded |F|, {view.name}", **scale)
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label("|F| / N", fontsize=8)
        held = np.where(view.error >= 0, view.error, np.nan)
        row[2].set_facecolor("0.85")
        worst = self._image(row[2], view, held, "error / mask (above 1 can be felt)", vmin=0, vmax=2, cmap="PuOr_r")
        figure.colorbar(worst, ax=row[2], shrink=0.85, extend="max").set_label(
            f"|error| / max({self.spec.f0_n:g} N, {self.spec.k:g}|F|)", fontsize=8
        )

    def draw_directions(self, figure: Any, row: Any) -> None:
        view = self.slice
        units = [self._unit(v) for v in self.vectors]
        for panel, unit, name in zip(row, units, ("source", "decoded"), strict=False):
            shown = self._quiver(panel, unit, f"{name} direction, {view.name}")
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label(
            f"part of the force along {'xyz'[self.cut_axis]} (out of the page)", fontsize=8
        )
        held = np.logical_and(*((u != 0).any(-1) for u in units))
        cosine = np.clip((units[0] * units[1]).sum(-1), -1, 1)
        angle = np.where(held, np.degrees(np.arccos(cosine)), np.nan)
        worst = self._image(row[2], view, angle, "direction error", vmin=0, vmax=20, cmap="cividis")
        row[2].set_facecolor("0.92")
        figure.colorbar(worst, ax=row[2], shrink=0.85, extend="max").set_label("angle / degrees", fontsize=8)

    @staticmethod
    def _unit(vectors: NDArray[np.float32]) -> NDArray[np.float32]:
        length = np.linalg.norm(vectors, axis=-1, keepdims=True)
        return np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)

    def _quiver(self, panel: Any, unit: NDArray[np.float32], title: str) -> Any:
        view = self.slice
        extent = self._frame(panel, view, title)
        step = max(1, max(unit.shape[:2]) // _ARROWS)
        # the first supported sample of each step x step cell, so that thin walls are not jumped over
        places = np.argwhere((unit != 0).any(-1))
        _, first = np.unique(places // step, axis=0, return_index=True)
        i, j = places[first].T
        x = 1e3 * self.grid.axis_m(view.across)[i]
        y = 1e3 * self.grid.axis_m(view.up)[j]
        u = unit[i, j]
        length = max(extent[1] - extent[0], extent[3] - extent[2]) / _ARROWS * 1.3
        arrows = panel.quiver(
            x, y, u[:, view.across] * length, u[:, view.up] * length, u[:, self.cut_axis],
            angles="xy", scale_units="xy", scale=1, cmap="berlin", width=0.005, clim=(-1, 1),
        )  # fmt: skip
        panel.set_xlim(extent[:2])
        panel.set_ylim(extent[2:])
        panel.set_aspect("equal")
        panel.set_facecolor("0.92")
        if self._flips(view.up):
            panel.invert_yaxis()
        return arrows

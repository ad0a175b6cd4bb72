"""The picture of a comparison: source, decoded, and error in units of the mask, side by side.

Colours are perceptually even and safe for the colour-blind; source and decoded share one scale; every scale
carries its unit.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s
from touchfield.perception.mask import mask_n
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.medium import ForceField


_X, _Y, _Z = 0, 1, 2
_ARROWS = 30  # along the longer side of the direction panels
_EMPTY = "0.86"


@dataclass(frozen=True)
class PictureSpec:
    """Texts around the panels.

    Attributes
    ----------
    title : str
    caption : str
        The figures of the comparison, one or two lines.
    axes : str
        The medium's wording of its axes, "x right, y down, z forward".
    k, f0_n : float
        The mask max(F_0, k |F|).
    columns : (str, str)
        What the two fields are called.
    """

    title: str
    caption: str
    axes: str
    k: float
    f0_n: float
    columns: tuple[str, str] = ("source", "decoded")


def draw_comparison(path: Path, original: ForceField, decoded: ForceField, spec: PictureSpec) -> None:
    """Write a PNG that compares two fields on one grid.

    Rows: where a hand that comes from the viewer's side first feels a force; |F| on a slice along the line of
    sight; the direction on the same slice; of an array of actuators, |F| of each. Columns: source, decoded, error.

    Raises MissingExtra if matplotlib is not installed.
    """
    panels = _Panels(original, decoded, spec)
    # an array of actuators is one sample deep: all there is to see is the force of each
    rows = (
        (panels.draw_contact, panels.draw_amplitudes, panels.draw_directions)
        if original.grid.shape[_Z] > 1
        else (panels.draw_actuators,)
    )
    heights = panels.row_heights()[: len(rows)]
    title = f"{spec.title}\n{spec.caption}"
    figure = titled_figure("the picture of a comparison", title, 14.0, 1.2 + 4.3 * sum(heights))
    axes = figure.subplots(len(rows), 3, squeeze=False, gridspec_kw={"height_ratios": heights})
    for draw, row in zip(rows, axes, strict=True):
        draw(figure, row)
    write_png(figure, path)


class _Panels:
    """Both fields cropped to the box that holds forces, and how to draw them."""

    def __init__(self, original: ForceField, decoded: ForceField, spec: PictureSpec) -> None:
        self.spec = spec
        grid = original.grid
        x, y = original.to_dense(), decoded.to_dense()
        held = (x != 0).any(-1) | (y != 0).any(-1)
        crop = [_span(held.any(axis=tuple(b for b in range(3) if b != a)), grid.shape[a]) for a in range(3)]
        x, y, held = x[tuple(crop)], y[tuple(crop)], held[tuple(crop)]
        self.low_mm = [1e3 * (grid.box_m[0][a] + crop[a].start * grid.spacing_m[a]) for a in range(3)]
        self.step_mm = [1e3 * h for h in grid.spacing_m]
        self.shape = held.shape
        self.vectors = (x, y)
        self.forces = tuple(np.linalg.norm(v, axis=-1) for v in self.vectors)
        error = np.linalg.norm(y - x, axis=-1) / mask_n(self.forces[0], spec.k, spec.f0_n)
        self.error = np.where(held, error, np.nan)
        self.cut = int(np.argmax(self.forces[0].sum(axis=(_X, _Z), dtype=np.float64)))
        self.top_n = float(max(*(f.max(initial=0) for f in self.forces), 1e-6))
        # whoever looks along +z meets the lowest z first; whoever has z towards the eye, the highest
        self.from_low_z = "z forward" in spec.axes

    # -- geometry of the page -----------------------------------------------------------------------------

    def row_heights(self) -> list[float]:
        """Height over width of the front view and of the slice, twice; within reason."""
        width, height, depth = (n * h for n, h in zip(self.shape, self.step_mm, strict=True))
        return [float(np.clip(side / width, 0.35, 1.3)) for side in (height, depth, depth)]

    def _frame(self, panel: Any, up: int, title: str) -> list[float]:
        high = [lo + n * h for lo, n, h in zip(self.low_mm, self.shape, self.step_mm, strict=True)]
        panel.set_title(title, fontsize=9, parse_math=False)
        panel.set_xlabel("x / mm", fontsize=8)
        panel.set_ylabel(f"{'xyz'[up]} / mm", fontsize=8)
        panel.tick_params(labelsize=7)
        panel.set_facecolor(_EMPTY)
        return [self.low_mm[_X], high[_X], self.low_mm[up], high[up]]

    def _image(self, panel: Any, up: int, values: NDArray[Any], title: str, **style: Any) -> Any:
        extent = self._frame(panel, up, title)
        image = panel.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **style)
        if f"{'xyz'[up]} down" in self.spec.axes:
            panel.invert_yaxis()
        return image

    def _mask_bar(self, figure: Any, panel: Any, up: int, values: NDArray[Any], title: str) -> None:
        worst = self._image(panel, up, values, title, vmin=0, vmax=2, cmap="PuOr_r")
        figure.colorbar(worst, ax=panel, shrink=0.85, extend="max").set_label(
            f"|error| / max({self.spec.f0_n:g} N, {self.spec.k:g} |F|)", fontsize=8
        )

    # -- rows ---------------------------------------------------------------------------------------------

    def draw_contact(self, figure: Any, row: Any) -> None:
        """Where a hand first feels a force, and the worst error behind each point of that surface."""
        depths = [self._contact_mm(force) for force in self.forces]
        both = np.concatenate([d[np.isfinite(d)] for d in depths])
        scale: dict[str, Any] = {"cmap": "cividis" if self.from_low_z is False else "cividis_r"}
        if len(both):
            # a few samples at the rim, felt only deep behind it, must not take the whole scale
            low, high = np.percentile(both, (1, 99))
            if low == high:  # a flat scene, and what little stands out of it is what there is to see
                low, high = both.min(), both.max()
            scale |= {"vmin": low, "vmax": high}
        for panel, depth, name in zip(row, depths, self.spec.columns, strict=False):
            shown = self._image(panel, _Y, depth, f"{name}: first contact along z", **scale)
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label("z of first contact / mm", fontsize=8)
        worst = np.nanmax(np.where(np.isnan(self.error), -1, self.error), axis=_Z)
        self._mask_bar(figure, row[2], _Y, np.where(worst < 0, np.nan, worst), "worst error along z")

    def draw_actuators(self, figure: Any, row: Any) -> None:
        """|F| of each actuator of an array."""
        for panel, force, name in zip(row, self.forces, self.spec.columns, strict=False):
            felt = np.where(force[:, :, 0] > 0, force[:, :, 0], np.nan)
            shown = self._image(panel, _Y, felt, f"{name} |F|", vmin=0, vmax=self.top_n, cmap="cividis")
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label("|F| / N", fontsize=8)
        self._mask_bar(figure, row[2], _Y, self.error[:, :, 0], "error, in units of the mask")

    def _contact_mm(self, force: Float32s) -> Float64s:
        felt = force > self.spec.f0_n
        index = felt.argmax(axis=_Z) if self.from_low_z else felt.shape[_Z] - 1 - felt[:, :, ::-1].argmax(axis=_Z)
        z = self.low_mm[_Z] + (index + 0.5) * self.step_mm[_Z]
        return np.where(felt.any(axis=_Z), z, np.nan)

    def _slice_name(self) -> str:
        y_mm = round(self.low_mm[_Y] + (self.cut + 0.5) * self.step_mm[_Y], 1) + 0.0  # never -0
        return f"slice at y = {y_mm:.1f} mm"

    def draw_amplitudes(self, figure: Any, row: Any) -> None:
        """|F| on the slice with the most force."""
        for panel, force, name in zip(row, self.forces, self.spec.columns, strict=False):
            cut = np.where(force[:, self.cut] > 0, force[:, self.cut], np.nan)
            title = f"{name} |F|, {self._slice_name()}"
            shown = self._image(panel, _Z, cut, title, vmin=0, vmax=self.top_n, cmap="cividis")
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label("|F| / N", fontsize=8)
        self._mask_bar(figure, row[2], _Z, self.error[:, self.cut], "error, in units of the mask")

    def draw_directions(self, figure: Any, row: Any) -> None:
        """Direction on the same slice, and by how many degrees it is off."""
        units = [_unit(v[:, self.cut]) for v in self.vectors]
        for panel, unit, name in zip(row, units, self.spec.columns, strict=False):
            shown = self._quiver(panel, unit, f"{name} direction, {self._slice_name()}")
        figure.colorbar(shown, ax=list(row[:2]), shrink=0.85).set_label("part of the force along y", fontsize=8)
        held = np.logical_and(*((u != 0).any(-1) for u in units))
        across = np.linalg.norm(np.cross(units[0], units[1]), axis=-1)
        angle = np.where(held, np.degrees(np.arctan2(across, (units[0] * units[1]).sum(-1))), np.nan)
        worst = self._image(row[2], _Z, angle, "direction error", vmin=0, vmax=20, cmap="cividis")
        figure.colorbar(worst, ax=row[2], shrink=0.85, extend="max").set_label("angle / degrees", fontsize=8)

    def _quiver(self, panel: Any, unit: Float32s, title: str) -> Any:
        extent = self._frame(panel, _Z, title)
        cell_mm = max(extent[1] - extent[0], extent[3] - extent[2]) / _ARROWS
        # the first supported sample of each cell of the page, so that thin walls are not jumped over
        places = np.argwhere((unit != 0).any(-1))
        cells = np.floor(places * [self.step_mm[_X] / cell_mm, self.step_mm[_Z] / cell_mm])
        _, first = np.unique(cells, axis=0, return_index=True)
        i, j = places[first].T
        u = unit[i, j]
        arrows = panel.quiver(
            self.low_mm[_X] + (i + 0.5) * self.step_mm[_X], self.low_mm[_Z] + (j + 0.5) * self.step_mm[_Z],
            u[:, _X] * 1.3 * cell_mm, u[:, _Z] * 1.3 * cell_mm, u[:, _Y],
            angles="xy", scale_units="xy", scale=1, cmap="berlin", width=0.005, clim=(-1, 1),
        )  # fmt: skip
        panel.set_xlim(extent[:2])
        panel.set_ylim(extent[2:])
        panel.set_aspect("equal")
        return arrows


def _span(held: Bools, count: int) -> slice:
    """The range that is held, with a margin of a twentieth; all if nothing is."""
    places = np.flatnonzero(held)
    if not len(places):
        return slice(0, count)
    margin = 1 + (places[-1] - places[0]) // 20
    return slice(max(0, int(places[0] - margin)), min(count, int(places[-1] + margin + 1)))


def _unit(vectors: Float32s) -> Float32s:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float32s = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit

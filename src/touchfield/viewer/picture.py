"""Draws fields: two fields with the error between them, or one field in the workspace of a device.

A comparison shows the source, the decoded field, and the error in units of the mask. Colours are perceptually
uniform and safe for colour-blind readers; compared panels share a scale with a unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Bools, Float32s, Float64s, lengths_of
from touchfield.perception.mask import mask_n
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from touchfield.medium import ForceField


_X, _Y, _Z = 0, 1, 2
_ARROWS = 30  # along the longer side of the direction panels
_EMPTY = "0.86"
_COLUMNS = ("source", "decoded")


def draw_comparison(
    path: Path,
    original: ForceField,
    decoded: ForceField,
    title: str,
    axes: str,
    mask: tuple[float, float],
) -> None:
    """Write a PNG that compares two fields on one grid.

    The rows show the first contact of a hand that comes from the viewer's side, |F| on a slice along the line
    of sight, and the direction on the same slice; for an array of actuators, the single row shows |F| of
    each. The columns are source, decoded and error. `axes` are those of the medium, such as "x right, y down,
    z forward"; `mask` is (k, F_0) of max(F_0, k |F|). `MissingExtra` if matplotlib is not installed.
    """
    panels = _Panels(original, decoded, axes, mask)
    rows = [panels.draw_amplitudes]
    if not panels.is_array:
        rows = [panels.draw_contact, *rows, panels.draw_directions]
    heights = panels.row_heights()[: len(rows)]
    figure = titled_figure("the picture of a comparison", title, 14.0, 1.2 + 4.3 * sum(heights))
    subplots = figure.subplots(len(rows), 3, squeeze=False, gridspec_kw={"height_ratios": heights})
    for draw, row in zip(rows, subplots, strict=True):
        draw(figure, row)
    write_png(figure, path)


class _Panels:
    """The panels of a comparison: both fields, cropped to the box with forces."""

    def __init__(
        self,
        original: ForceField,
        decoded: ForceField,
        axes: str,
        mask: tuple[float, float],
    ) -> None:
        self.axes, self.mask = axes, mask
        grid = original.grid
        # an array of actuators is one sample deep: only the force of each is shown
        self.is_array = grid.shape[_Z] == 1
        x, y = original.to_dense(), decoded.to_dense()
        supported = (x != 0).any(-1) | (y != 0).any(-1)
        crop = [
            _span(supported.any(axis=tuple(b for b in range(3) if b != a)), grid.shape[a]) for a in range(3)
        ]
        x, y, supported = x[tuple(crop)], y[tuple(crop)], supported[tuple(crop)]
        self.low_mm = [1e3 * (grid.box_m[0][a] + crop[a].start * grid.spacing_m[a]) for a in range(3)]
        self.step_mm = [1e3 * h for h in grid.spacing_m]
        self.shape = supported.shape
        self.vectors = (x, y)
        self.forces = tuple(lengths_of(v) for v in self.vectors)
        error = lengths_of(y - x) / mask_n(self.forces[0], *mask)
        self.error = np.where(supported, error, np.nan)
        self.cut = int(np.argmax(self.forces[0].sum(axis=(_X, _Z), dtype=np.float64)))
        self.top_n = float(max(*(f.max(initial=0) for f in self.forces), 1e-6))
        # a viewer along +z meets the lowest z first; with z towards the viewer, the highest
        self.from_low_z = "z forward" in axes

    # -- geometry of the page -------------------------------------------------------------------------------

    def row_heights(self) -> list[float]:
        """Return height over width of the front view and of the slice (twice), limited."""
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
        if f"{'xyz'[up]} down" in self.axes:
            panel.invert_yaxis()
        return image

    def _mask_bar(self, figure: Any, panel: Any, up: int, values: NDArray[Any], title: str) -> None:
        worst = self._image(panel, up, values, title, vmin=0, vmax=2, cmap="PuOr_r")
        _bar(figure, worst, panel, f"|error| / max({self.mask[1]:g} N, {self.mask[0]:g} |F|)", extend="max")

    # -- rows -----------------------------------------------------------------------------------------------

    def draw_contact(self, figure: Any, row: Any) -> None:
        """Draw the first contact of a hand along z, and the largest error along z."""
        depths = [self._contact_mm(force) for force in self.forces]
        both = np.concatenate([d[np.isfinite(d)] for d in depths])
        scale: dict[str, Any] = {"cmap": "cividis" if not self.from_low_z else "cividis_r"}
        if len(both):
            # a few deep samples at the rim must not use the whole scale
            low, high = np.percentile(both, (1, 99))
            if low == high:  # a flat scene: show the small parts that stand out
                low, high = both.min(), both.max()
            scale |= {"vmin": low, "vmax": high}
        for panel, depth, name in zip(row, depths, _COLUMNS, strict=False):
            image = self._image(panel, _Y, depth, f"{name}: first contact along z", **scale)
        _bar(figure, image, list(row[:2]), "z of first contact / mm")
        worst = np.nanmax(np.where(np.isnan(self.error), -1, self.error), axis=_Z)
        self._mask_bar(figure, row[2], _Y, np.where(worst < 0, np.nan, worst), "worst error along z")

    def _contact_mm(self, force: Float32s) -> Float64s:
        perceptible = force > self.mask[1]
        index = (
            perceptible.argmax(axis=_Z)
            if self.from_low_z
            else perceptible.shape[_Z] - 1 - perceptible[:, :, ::-1].argmax(axis=_Z)
        )
        z = self.low_mm[_Z] + (index + 0.5) * self.step_mm[_Z]
        return np.where(perceptible.any(axis=_Z), z, np.nan)

    def _slice_name(self) -> str:
        y_mm = round(self.low_mm[_Y] + (self.cut + 0.5) * self.step_mm[_Y], 1) + 0.0  # never -0
        return f"slice at y = {y_mm:.1f} mm"

    def draw_amplitudes(self, figure: Any, row: Any) -> None:
        """Draw |F| on the slice with the most force, or of each actuator of an array."""
        up, slice_text = _Z, f", {self._slice_name()}"
        cut: tuple[Any, ...] = (slice(None), self.cut)
        if self.is_array:
            up, cut, slice_text = _Y, (..., 0), ""
        for panel, force, name in zip(row, self.forces, _COLUMNS, strict=False):
            supported_n = np.where(force[cut] > 0, force[cut], np.nan)
            image = self._image(
                panel, up, supported_n, f"{name} |F|{slice_text}", vmin=0, vmax=self.top_n, cmap="cividis"
            )
        _bar(figure, image, list(row[:2]), "|F| / N")
        self._mask_bar(figure, row[2], up, self.error[cut], "error, in units of the mask")

    def draw_directions(self, figure: Any, row: Any) -> None:
        """Draw the direction on the same slice, and its error in degrees."""
        units = [_unit(v[:, self.cut]) for v in self.vectors]
        for panel, unit, name in zip(row, units, _COLUMNS, strict=False):
            image = self._quiver(panel, unit, f"{name} direction, {self._slice_name()}")
        _bar(figure, image, list(row[:2]), "part of the force along y")
        supported = np.logical_and(*((u != 0).any(-1) for u in units))
        across = lengths_of(np.cross(units[0], units[1]))
        angle = np.where(supported, np.degrees(np.arctan2(across, (units[0] * units[1]).sum(-1))), np.nan)
        worst = self._image(row[2], _Z, angle, "direction error", vmin=0, vmax=20, cmap="cividis")
        _bar(figure, worst, row[2], "angle / degrees", extend="max")

    def _quiver(self, panel: Any, unit: Float32s, title: str) -> Any:
        extent = self._frame(panel, _Z, title)
        cell_mm = max(extent[1] - extent[0], extent[3] - extent[2]) / _ARROWS
        # the first supported sample of each cell of the page, so that thin walls are not skipped
        positions = np.argwhere((unit != 0).any(-1))
        cells = np.floor(positions * [self.step_mm[_X] / cell_mm, self.step_mm[_Z] / cell_mm])
        _, first = np.unique(cells, axis=0, return_index=True)
        i, j = positions[first].T
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


def _bar(figure: Any, image: Any, panels: Any, label: str, **style: Any) -> None:
    figure.colorbar(image, ax=panels, shrink=0.85, **style).set_label(label, fontsize=8)


def _span(has_force: Bools, count: int) -> slice:
    """Return the range with forces and a margin of a twentieth; without forces, the whole range."""
    indices = np.flatnonzero(has_force)
    if not len(indices):
        return slice(0, count)
    margin = 1 + (indices[-1] - indices[0]) // 20
    return slice(max(0, int(indices[0] - margin)), min(count, int(indices[-1] + margin + 1)))


def _unit(vectors: Float32s) -> Float32s:
    length = np.linalg.norm(vectors, axis=-1, keepdims=True)
    unit: Float32s = np.divide(vectors, length, out=np.zeros_like(vectors), where=length > 0)
    return unit


# -- a field in its workspace ------------------------------------------------------------------------------

_PANELS: Final = (
    ("from the viewer", (1, 0, 0), (0, 1, 0)),
    ("from the side", (0, 0, -1), (0, 1, 0)),
    ("from above", (1, 0, 0), (0, 0, -1)),
)
"""Each view and its horizontal and vertical direction, in x right, y up, z towards the viewer."""

_MARGIN: Final = 0.12  # around the workspace, of its largest side


def shadows(fields: Sequence[ForceField], title: str, permutation: Float64s) -> Figure:
    """Draw three projections of fields on one grid, with its box, in millimetres.

    `permutation` is the signed permutation [3, 3] from x right, y up, z towards the viewer to their axes.
    """
    grid = fields[0].grid
    low_mm, high_mm = (1e3 * corner for corner in grid.box_m)
    sides = high_mm - low_mm
    margin = _MARGIN * float(sides.max())
    panels_of = [
        (name, *_seen_axis(permutation, across), *_seen_axis(permutation, up)) for name, across, up in _PANELS
    ]
    widths = [float(sides[across] + 2 * margin) for _, across, _, _, _ in panels_of]
    heights = [float(sides[up] + 2 * margin) for *_, up, _ in panels_of]
    height_inch = 1.6 + 13.0 * max(heights) / sum(widths)
    figure = titled_figure("the preview of a field", title, 15.0, height_inch)
    from matplotlib.patches import Rectangle

    panels = figure.subplots(1, 3, gridspec_kw={"width_ratios": widths})
    top_n = max(max(float(f.support().amplitudes_n.max(initial=0.0)) for f in fields), 1e-6)
    for panel, (name, across, is_mirrored, up, is_upside_down) in zip(panels, panels_of, strict=True):
        shadow = shadow_n(fields, across, up)
        image = panel.imshow(
            np.where(shadow > 0, shadow, np.nan).T, origin="lower", interpolation="nearest", aspect="equal",
            extent=(low_mm[across], high_mm[across], low_mm[up], high_mm[up]),
            cmap="viridis_r", vmin=0, vmax=top_n,
        )  # fmt: skip
        corner, size = (low_mm[across], low_mm[up]), (sides[across], sides[up])
        panel.add_patch(Rectangle(corner, *size, fill=False, edgecolor="0.2", linewidth=1.2, linestyle="--"))
        panel.set_xlim(low_mm[across] - margin, high_mm[across] + margin)
        panel.set_ylim(low_mm[up] - margin, high_mm[up] + margin)
        panel.set_title(name, fontsize=10)
        panel.set_xlabel(f"{'xyz'[across]} / mm", fontsize=9)
        panel.set_ylabel(f"{'xyz'[up]} / mm", fontsize=9)
        panel.tick_params(labelsize=8)
        if is_mirrored:
            panel.invert_xaxis()
        if is_upside_down:
            panel.invert_yaxis()
    style = {"xycoords": "axes fraction", "fontsize": 9, "color": "#d55e00", "fontweight": "bold"}
    panels[1].annotate(
        "viewer \N{DOWNWARDS ARROW}", (0.01, 0.5), rotation=90, va="center", ha="left", **style
    )
    panels[2].annotate("viewer \N{UPWARDS ARROW}", (0.5, 0.01), va="bottom", ha="center", **style)
    figure.colorbar(image, ax=list(panels), shrink=0.8, pad=0.01).set_label(
        "greatest |F| along the sight / N", fontsize=9
    )
    return figure


def _seen_axis(permutation: Float64s, direction: tuple[int, int, int]) -> tuple[int, bool]:
    """Return the axis of the fields along a direction of the viewer, and whether it is reversed."""
    along = permutation @ np.array(direction, np.float64)
    axis = int(np.argmax(np.abs(along)))
    return axis, bool(along[axis] < 0)


def shadow_n(fields: Sequence[ForceField], across: int, up: int) -> Float64s:
    """Return the largest |F| along the third axis, newtons [shape[across], shape[up]]."""
    shape = fields[0].grid.shape
    shadow = np.zeros((shape[across], shape[up]))
    for field in fields:
        support = field.support()
        columns_rows = support.positions[:, across], support.positions[:, up]
        np.maximum.at(shadow, columns_rows, support.amplitudes_n)
    return shadow

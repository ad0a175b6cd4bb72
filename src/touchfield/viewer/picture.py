"""Draws fields: two fields with the error between them, or one field in the workspace of a device.

A comparison shows the source, the decoded field, and the error in units of the mask. Colours are perceptually
uniform and safe for colour-blind readers; compared panels share a scale with a unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float32s, Float64s, lengths_of
from touchfield.perception.grip import WeberCurve
from touchfield.perception.mask import Weber, mask_n
from touchfield.viewer.page import titled_figure, write_png
from touchfield.viewer.slices import choose_slice, supported_span

if TYPE_CHECKING:
    from pathlib import Path

    from matplotlib.figure import Figure

    from touchfield.medium import ForceField

_X, _Y, _Z = 0, 1, 2
_ARROWS = 30  # along the longer side of the direction panels
_EMPTY = "0.86"


def draw_comparison(
    path: Path,
    original: ForceField,
    decoded: ForceField,
    title: str,
    axes: str,
    mask: tuple[Weber, float],
    names: tuple[str, str, str] = ("source", "decoded", "error"),
) -> None:
    """Write a PNG that compares two fields on one grid.

    The rows show the first contact of a hand that comes from the viewer's side, |F| on the slice that shows
    the most (`choose_slice`), and the direction on the same slice, as arrows of the part in the plane; for an
    array of actuators, the single row shows |F| of each. Each row is cropped to the samples with forces. The
    columns are the two fields and their difference, by `names`. `axes` are those of the medium, such as "x
    right, y down, z forward"; `mask` is (k, F_0) of max(F_0, k |F|). `MissingExtra` if matplotlib is not
    installed.
    """
    panels = _Panels(original, decoded, axes, mask, names)
    rows = [panels.draw_amplitudes]
    if not panels.is_array:
        rows = [panels.draw_contact, *rows, panels.draw_directions]
    heights = panels.row_heights()[-len(rows) :]
    figure = titled_figure("the picture of a comparison", title, 14.0, 1.2 + 4.3 * sum(heights))
    subplots = figure.subplots(len(rows), 3, squeeze=False, gridspec_kw={"height_ratios": heights})
    for draw, row in zip(rows, subplots, strict=True):
        draw(figure, row)
    write_png(figure, path)


class _View(NamedTuple):
    """The horizontal and vertical axis of a panel, and its box [across, up], millimetres."""

    across: int
    up: int
    low_mm: tuple[float, float]
    high_mm: tuple[float, float]


class _Panels:
    """The panels of a comparison: both fields, cropped to the box with forces, and one slice of them."""

    def __init__(
        self,
        original: ForceField,
        decoded: ForceField,
        axes: str,
        mask: tuple[Weber, float],
        names: tuple[str, str, str] = ("source", "decoded", "error"),
    ) -> None:
        self.axes, self.mask, self.names = axes, mask, names
        grid = original.grid
        # an array of actuators is one sample deep: only the force of each is shown
        self.is_array = grid.shape[_Z] == 1
        x, y = original.to_dense(), decoded.to_dense()
        supported = (x != 0).any(-1) | (y != 0).any(-1)
        crop = tuple(supported_span(supported, axis) for axis in range(3))
        x, y, supported = x[crop], y[crop], supported[crop]
        self.low_mm = [1e3 * (grid.box_m[0][a] + crop[a].start * grid.spacing_m[a]) for a in range(3)]
        self.step_mm = [1e3 * h for h in grid.spacing_m]
        self.shape = supported.shape
        self.vectors = (x, y)
        self.forces = tuple(lengths_of(v) for v in self.vectors)
        error = lengths_of(y - x) / mask_n(self.forces[0], *mask)
        self.error = np.where(supported, error, np.nan)
        self.cut = choose_slice(x if x.any() else y, grid.spacing_m, axes)
        in_slice = self.cut.of(supported)
        self.window = (supported_span(in_slice, 0), supported_span(in_slice, 1))
        self.top_n = float(max(*(f.max(initial=0) for f in self.forces), 1e-6))
        # a viewer along +z meets the lowest z first; with z towards the viewer, the highest
        self.from_low_z = "z forward" in axes

    # -- geometry of the page -------------------------------------------------------------------------------

    def row_heights(self) -> list[float]:
        """Return height over width of the front view and of the slice (twice), limited."""
        views = self._front_view(), self._slice_view(), self._slice_view()
        sides = [[hi - lo for lo, hi in zip(v.low_mm, v.high_mm, strict=True)] for v in views]
        return [float(np.clip(height / width, 0.35, 1.3)) for width, height in sides]

    def _view(self, across: int, up: int, window: tuple[slice, ...]) -> _View:
        ends = [
            [self.low_mm[axis] + end * self.step_mm[axis] for axis, end in ((across, i), (up, j))]
            for i, j in ((window[0].start, window[1].start), (window[0].stop, window[1].stop))
        ]
        (left, bottom), (right, top) = ends
        return _View(across, up, (left, bottom), (right, top))

    def _front_view(self) -> _View:
        return self._view(_X, _Y, (slice(0, self.shape[_X]), slice(0, self.shape[_Y])))

    def _slice_view(self) -> _View:
        return self._view(self.cut.across, self.cut.up, self.window)

    def _in_slice(self, values: NDArray[Any]) -> NDArray[Any]:
        """Return the part of an array [x, y, z, ...] that the panels of the slice show, [across, up, ...]."""
        return self.cut.of(values)[self.window]

    def _frame(self, panel: Any, view: _View, title: str) -> list[float]:
        panel.set_title(title, fontsize=9, parse_math=False)
        panel.set_xlabel(f"{'xyz'[view.across]} / mm", fontsize=8)
        panel.set_ylabel(f"{'xyz'[view.up]} / mm", fontsize=8)
        panel.tick_params(labelsize=7)
        panel.set_facecolor(_EMPTY)
        return [view.low_mm[0], view.high_mm[0], view.low_mm[1], view.high_mm[1]]

    def _turn(self, panel: Any, view: _View) -> None:
        """Draw a vertical axis that points down downwards."""
        if f"{'xyz'[view.up]} down" in self.axes:
            panel.invert_yaxis()

    def _image(self, panel: Any, view: _View, values: NDArray[Any], title: str, **style: Any) -> Any:
        extent = self._frame(panel, view, title)
        image = panel.imshow(values.T, origin="lower", extent=extent, interpolation="nearest", **style)
        self._turn(panel, view)
        return image

    def _mask_bar(self, figure: Any, panel: Any, view: _View, values: NDArray[Any], title: str) -> None:
        worst = self._image(panel, view, values, title, vmin=0, vmax=2, cmap="PuOr_r")
        k, f0_n = self.mask
        weber = "k(|F|)" if isinstance(k, WeberCurve) else f"{k:g}"
        label = f"|{self.names[2]}| / max({f0_n:g} N, {weber} |F|)"
        _bar(figure, worst, panel, label, extend="max")

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
        view = self._front_view()
        for panel, depth, name in zip(row, depths, self.names, strict=False):
            image = self._image(panel, view, depth, f"{name}: first contact along z", **scale)
        _bar(figure, image, list(row[:2]), "z of first contact / mm")
        worst = np.nanmax(np.where(np.isnan(self.error), -1, self.error), axis=_Z)
        self._mask_bar(
            figure, row[2], view, np.where(worst < 0, np.nan, worst), f"largest {self.names[2]} along z"
        )

    def _contact_mm(self, force: Float32s) -> Float64s:
        is_above = force > self.mask[1]
        index = (
            is_above.argmax(axis=_Z)
            if self.from_low_z
            else is_above.shape[_Z] - 1 - is_above[:, :, ::-1].argmax(axis=_Z)
        )
        z = self.low_mm[_Z] + (index + 0.5) * self.step_mm[_Z]
        return np.where(is_above.any(axis=_Z), z, np.nan)

    def _slice_name(self) -> str:
        axis, index = self.cut.axis, self.cut.index
        at_mm = round(self.low_mm[axis] + (index + 0.5) * self.step_mm[axis], 1) + 0.0  # never -0
        return f"slice at {'xyz'[axis]} = {at_mm:.1f} mm"

    def draw_amplitudes(self, figure: Any, row: Any) -> None:
        """Draw |F| on the slice, or of each actuator of an array."""
        view, slice_text = self._slice_view(), "" if self.is_array else f", {self._slice_name()}"
        for panel, force, name in zip(row, self.forces, self.names, strict=False):
            force_n = self._in_slice(force)
            supported_n = np.where(force_n > 0, force_n, np.nan)
            image = self._image(
                panel, view, supported_n, f"{name} |F|{slice_text}", vmin=0, vmax=self.top_n, cmap="cividis"
            )
        _bar(figure, image, list(row[:2]), "|F| / N")
        self._mask_bar(
            figure, row[2], view, self._in_slice(self.error), f"{self.names[2]}, in units of the mask"
        )

    def draw_directions(self, figure: Any, row: Any) -> None:
        """Draw the direction on the same slice, and its error in degrees."""
        units = [_unit(self._in_slice(vectors)) for vectors in self.vectors]
        for panel, unit, name in zip(row, units, self.names, strict=False):
            image = self._quiver(panel, unit, f"{name} direction, {self._slice_name()}")
        _bar(figure, image, list(row[:2]), f"part of the force along {'xyz'[self.cut.axis]}")
        supported = np.logical_and(*((u != 0).any(-1) for u in units))
        across = lengths_of(np.cross(units[0], units[1]))
        angle = np.where(supported, np.degrees(np.arctan2(across, (units[0] * units[1]).sum(-1))), np.nan)
        view = self._slice_view()
        worst = self._image(
            row[2], view, angle, f"direction {self.names[2]}", vmin=0, vmax=20, cmap="cividis"
        )
        _bar(figure, worst, row[2], "angle / degrees", extend="max")

    def _quiver(self, panel: Any, unit: Float32s, title: str) -> Any:
        view = self._slice_view()
        extent = self._frame(panel, view, title)
        step_mm = np.array([self.step_mm[view.across], self.step_mm[view.up]])
        cell_mm = max(extent[1] - extent[0], extent[3] - extent[2]) / _ARROWS
        # the first supported sample of each cell of the page, so that thin walls are not skipped
        positions = np.argwhere((unit != 0).any(-1))
        _, first = np.unique(np.floor(positions * step_mm / cell_mm), axis=0, return_index=True)
        drawn = positions[first]
        u = unit[tuple(drawn.T)]
        arrows = panel.quiver(
            *(np.array(view.low_mm) + (drawn + 0.5) * step_mm).T,
            u[:, view.across] * 1.3 * cell_mm, u[:, view.up] * 1.3 * cell_mm, u[:, self.cut.axis],
            angles="xy", scale_units="xy", scale=1, cmap="berlin", width=0.005, clim=(-1, 1),
        )  # fmt: skip
        panel.set_xlim(extent[:2])
        panel.set_ylim(extent[2:])
        panel.set_aspect("equal")
        self._turn(panel, view)
        return arrows


def _bar(figure: Any, image: Any, panels: Any, label: str, **style: Any) -> None:
    figure.colorbar(image, ax=panels, shrink=0.85, **style).set_label(label, fontsize=8)


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
_CROPPED_MARGIN: Final = 0.05  # likewise, around the samples with forces


def shadows(
    fields: Sequence[ForceField], title: str, permutation: Float64s, *, is_cropped: bool = False
) -> Figure:
    """Draw three projections of fields on one grid, with its box, in millimetres.

    `permutation` is the signed permutation [3, 3] from x right, y up, z towards the viewer to their axes.
    The panels show the box of the grid, or, if `is_cropped`, the box of the samples with forces.
    """
    grid = fields[0].grid
    low_mm, high_mm = (1e3 * corner for corner in grid.box_m)
    shown_low_mm, shown_high_mm = _supported_box_mm(fields) if is_cropped else (low_mm, high_mm)
    sides, shown_sides = high_mm - low_mm, shown_high_mm - shown_low_mm
    margin = (_CROPPED_MARGIN if is_cropped else _MARGIN) * float(shown_sides.max())
    panels_of = [
        (name, *_seen_axis(permutation, across), *_seen_axis(permutation, up)) for name, across, up in _PANELS
    ]
    widths = [float(shown_sides[across] + 2 * margin) for _, across, _, _, _ in panels_of]
    heights = [float(shown_sides[up] + 2 * margin) for *_, up, _ in panels_of]
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
        panel.set_xlim(shown_low_mm[across] - margin, shown_high_mm[across] + margin)
        panel.set_ylim(shown_low_mm[up] - margin, shown_high_mm[up] + margin)
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


def _supported_box_mm(fields: Sequence[ForceField]) -> tuple[Float64s, Float64s]:
    """Return the corners of the box of the samples with forces; without forces, those of the grid."""
    grid = fields[0].grid
    corners = [end for field in fields if len(field.bricks) for end in _supported_ends(field)]
    if not corners:
        return 1e3 * grid.box_m[0], 1e3 * grid.box_m[1]
    half = np.asarray(grid.spacing_m) / 2
    return 1e3 * (np.min(corners, axis=0) - half), 1e3 * (np.max(corners, axis=0) + half)


def _supported_ends(field: ForceField) -> tuple[Float64s, Float64s]:
    positions = field.positions()
    return field.grid.to_m(positions.min(axis=0)), field.grid.to_m(positions.max(axis=0))


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

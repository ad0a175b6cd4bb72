"""Draws how many bits a medium contains, how many files take, and how many each device renders, as bars
(paper section 3.1).

Limits have one hue and file sizes another; every value is printed, and intervals are drawn.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from touchfield.measure.capacity import Capacity


_LIMIT, _ACTUAL, _RENDERED, _LOST = "#0072b2", "#d55e00", "#0072b2", "0.82"
_WIDTH_INCH = 9.5
_MAX_LABEL = 40  # characters of the end of a path, its most specific part


@dataclass(frozen=True)
class Bar:
    """A value and its interval, if any.

    `is_actual` marks a real size, as opposed to a limit.
    """

    label: str
    value: float
    interval: tuple[float, float] | None = None
    is_actual: bool = False


def draw_information(
    path: Path, title: str, unit: str, bars: Sequence[Bar], capacities: Mapping[str, Capacity] | None = None
) -> None:
    """Write the picture of bars and devices as PNG.

    Bars are in `unit` and drawn from the top down; devices are given by name.

    `MissingExtra` if matplotlib is not installed.
    """
    # a device has a line of text and a bar below it
    rows = [0.7 + height * len(part) for part, height in ((bars, 0.36), (capacities, 0.5)) if part]
    figure = titled_figure("the picture of a measurement", title, _WIDTH_INCH, 0.9 + sum(rows))
    panels = figure.subplots(len(rows), 1, squeeze=False, gridspec_kw={"height_ratios": rows})[:, 0]
    if bars:
        _draw_bars(panels[0], bars, unit)
    if capacities:
        _draw_devices(panels[-1], capacities)
    write_png(figure, path)


def _draw_bars(panel: Any, bars: Sequence[Bar], unit: str) -> None:
    """Draw points on a logarithmic scale, since values may differ by a factor of a thousand."""
    values = [v for b in bars for v in (b.value, *(b.interval or ())) if v > 0]
    low, high = min(values, default=0.1), max(values, default=1.0)
    low_edge, high_edge = low / 1.6, high * 1.6 * (high / low) ** 0.15  # margin for the last number
    for row, bar in enumerate(bars):
        colour = _ACTUAL if bar.is_actual else _LIMIT
        edge = max(bar.value, low_edge)
        if bar.interval is not None:
            interval = [max(end, low_edge) for end in bar.interval]
            panel.plot(interval, [row, row], color=colour, lw=5, alpha=0.3, solid_capstyle="butt")
            edge = max(edge, interval[1])
        # a logarithmic scale has no 0: an arrow at its lower end stands for it
        shape = "o" if bar.value > 0 else "<"
        panel.plot(max(bar.value, low_edge), row, shape, ms=7, color=colour, clip_on=False)
        number = "none" if bar.value != bar.value else f"{bar.value + 0.0:.4g}"  # no sign on 0
        panel.annotate(number, (edge, row), (7, 0), textcoords="offset points", va="center",
                       fontsize=8, parse_math=False)  # fmt: skip
    panel.set_xscale("log")
    panel.set_xlim(low_edge, high_edge)
    panel.grid(axis="y", color="0.9")
    _finish(panel, [b.label for b in bars], unit)


def _draw_devices(panel: Any, capacities: Mapping[str, Capacity]) -> None:
    """Draw a bar of length 1 for each device, divided into WMR (rendered) and HIL (lost), and its numbers."""
    for row, c in enumerate(capacities.values()):
        wmr = c.wmr.value
        if wmr != wmr:  # NaN: H(W) = 0
            panel.text(0.005, row, "no information to render", va="center", fontsize=8)
            continue
        low = row + 0.18
        panel.barh(low, 1.0, color=_LOST, height=0.36)
        panel.barh(low, wmr, color=_RENDERED, height=0.36)
        i = c.wmr.interval
        if i is not None and c.rendered.interval is not None:
            panel.plot([i.low, i.high], [low, low], color="black", lw=1.6, solid_capstyle="butt", marker="|",
                       clip_on=False)  # fmt: skip
        text = (
            f"C = {c.capacity.value + 0.0:,.0f} bit/frame   WMR {wmr + 0.0:.3g}   HIL {c.hil.value + 0.0:.5g}"
        )
        panel.text(0.005, row - 0.22, text, va="center", fontsize=8, parse_math=False)
    panel.set_xlim(0, 1)
    label = "share of the medium's information: rendered (WMR, blue) and lost (HIL, grey)"
    _finish(panel, list(capacities), label)


def _finish(panel: Any, names: Sequence[str], label: str) -> None:
    """Label a row for each name, from the top down."""
    panel.set_ylim(len(names) - 0.5, -0.5)
    panel.set_yticks(range(len(names)), [n[-_MAX_LABEL:] for n in names], fontsize=8, parse_math=False)
    panel.set_xlabel(label, fontsize=8, parse_math=False)
    panel.tick_params(labelsize=8)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)

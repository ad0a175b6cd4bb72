"""The picture of a measurement: what a medium holds in bits, and what each device renders of it (paper section 3.1).

One hue for limits, another for what a file takes; every value carries its number, and intervals are drawn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from touchfield.errors import MissingExtra
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["Bar", "DeviceBars", "InformationView", "draw_information"]

_LIMIT, _ACTUAL, _KEPT, _LOST = "#0072b2", "#d55e00", "#0072b2", "0.82"


@dataclass(frozen=True)
class Bar:
    """One bar: a value, and its interval where there is one.

    Attributes
    ----------
    label : str
    value : float
    interval : (float, float) or None
    is_actual : bool
        What something takes, rather than a limit to it.
    """

    label: str
    value: float
    interval: tuple[float, float] | None = None
    is_actual: bool = False


@dataclass(frozen=True)
class DeviceBars:
    """Equations 1 to 3 for one device.

    Attributes
    ----------
    name : str
    capacity_bits : float
        C, bits a frame.
    wmr, hil : float
        NaN where they do not exist.
    wmr_interval : (float, float) or None
    """

    name: str
    capacity_bits: float
    wmr: float
    hil: float
    wmr_interval: tuple[float, float] | None = None


@dataclass(frozen=True)
class InformationView:
    """What `draw_information` shows.

    Attributes
    ----------
    title : str
    unit : str
        Of the bars.
    bars : sequence of Bar
        From the top down.
    devices : sequence of DeviceBars
    """

    title: str
    unit: str
    bars: Sequence[Bar]
    devices: Sequence[DeviceBars] = ()


def draw_information(path: Path, view: InformationView) -> None:
    """Write the picture as PNG.

    Raises
    ------
    MissingExtra
        If matplotlib is not installed.
    """
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError:
        raise MissingExtra("the picture of a measurement", "matplotlib", "report") from None
    rows = [0.7 + 0.36 * len(part) for part in (view.bars, view.devices) if part]
    figure = Figure(figsize=(9.5, 0.9 + sum(rows)), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    panels = figure.subplots(len(rows), 1, squeeze=False, gridspec_kw={"height_ratios": rows})[:, 0]
    if view.bars:
        _draw_bars(panels[0], view)
    if view.devices:
        _draw_devices(panels[-1], view.devices)
    figure.suptitle(view.title, fontsize=11)
    with atomic_path(path) as temporary, temporary.open("wb") as file:
        figure.savefig(file, format="png")


def _draw_bars(panel: Any, view: InformationView) -> None:
    """Points on a scale of powers: raw numbers and the best limit may lie a factor of a thousand apart."""
    values = [v for b in view.bars for v in (b.value, *(b.interval or ())) if v > 0]
    low, high = min(values, default=0.1), max(values, default=1.0)
    for place, bar in enumerate(view.bars):
        colour = _ACTUAL if bar.is_actual else _LIMIT
        if bar.interval is not None:
            panel.plot(bar.interval, [place, place], color=colour, lw=5, alpha=0.3, solid_capstyle="butt")
        panel.plot(bar.value, place, "o", ms=7, color=colour)
        edge = max(bar.value, bar.interval[1] if bar.interval else 0.0)
        panel.text(edge * 1.12, place, f"{bar.value:.4g}", va="center", fontsize=8)
    panel.set_xscale("log")
    panel.xaxis.set_major_formatter("{x:g}")
    panel.set_xlim(low / 1.6, high * 2.2)
    panel.set_ylim(len(view.bars) - 0.5, -0.5)
    panel.set_yticks(range(len(view.bars)), [b.label for b in view.bars], fontsize=8)
    panel.grid(axis="y", color="0.9")
    panel.set_xlabel(view.unit, fontsize=8)
    _plain(panel)


def _draw_devices(panel: Any, devices: Sequence[DeviceBars]) -> None:
    """WMR and HIL share a bar of length 1: what of the medium is rendered, and what is lost."""
    for place, d in enumerate(devices):
        if d.wmr != d.wmr:  # NaN: H(W) = 0
            panel.text(0.01, place, "no information to render", va="center", fontsize=8)
            continue
        panel.barh(place, 1.0, color=_LOST, height=0.62)
        panel.barh(place, d.wmr, color=_KEPT, height=0.62)
        if d.wmr_interval is not None:
            panel.plot(d.wmr_interval, [place, place], color="black", lw=1.6, solid_capstyle="butt", marker="|")
        text = f"C = {d.capacity_bits:,.0f} bit/frame   WMR {d.wmr:.3g}   HIL {d.hil:.5g}"
        inside = d.wmr > 0.62
        panel.text(0.01 if inside else max(d.wmr, (d.wmr_interval or (0, 0))[1]) + 0.01, place, text, va="center",
                   fontsize=8, color="white" if inside else "black")  # fmt: skip
    panel.set_yticks(range(len(devices)), [d.name for d in devices], fontsize=8)
    panel.invert_yaxis()
    panel.set_xlim(0, 1)
    panel.set_xlabel("share of the medium's information: rendered (WMR, blue) and lost (HIL, grey)", fontsize=8)
    _plain(panel)


def _plain(panel: Any) -> None:
    panel.tick_params(labelsize=8)
    for side in ("top", "right"):
        panel.spines[side].set_visible(False)

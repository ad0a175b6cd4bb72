"""Draws the picture of `bench_scaling`: time and memory over size, a panel for each operation."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

COLOURS: Final = {
    "frames": "#0072B2", "media": "#0072B2", "pictures": "#0072B2", "surface": "#D55E00", "bodies": "#D55E00",
    "box": "#009E73", "pictures and surface": "#CC79A7",
}  # fmt: skip
"""Of what is doubled; those of Okabe and Ito, which the colour-blind can distinguish."""
COLUMNS: Final = 3


def draw(rows: Mapping[str, Mapping[str, Any]], out: Path) -> None:
    """Write the PNG of the rows of a result.

    Each line is relative to the smallest size: points for time, dashes for memory; linear and constant growth
    are grey.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    panels: dict[str, dict[str, Mapping[str, Any]]] = {}
    for name, row in rows.items():
        operation, what = name.split(", ")
        panels.setdefault(operation, {})[what] = row
    lines = -(-len(panels) // COLUMNS)
    with plt.rc_context({"font.size": 9, "text.color": "#222222", "axes.labelcolor": "#222222"}):
        figure, axes = plt.subplots(
            lines, COLUMNS, figsize=(3.4 * COLUMNS, 2.9 * lines), dpi=130, sharex=True, sharey=True,
            squeeze=False, layout="constrained",
        )  # fmt: skip
        for axis, (operation, of_operation) in zip(axes.flat, panels.items()):
            _panel(axis, operation, of_operation)
        for axis in axes.flat[len(panels) :]:
            axis.set_axis_off()
        for axis in axes[-1]:
            axis.set_xlabel("size over the smallest")
        for axis in axes[:, 0]:
            axis.set_ylabel("over the smallest")
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out, facecolor="white")
        plt.close(figure)


def _panel(axis: Any, operation: str, rows: Mapping[str, Mapping[str, Any]]) -> None:
    ends = [1, 2 ** (len(next(iter(rows.values()))["sizes"]) - 1)]
    for values in (ends, [1, 1]):
        axis.plot(ends, values, color="0.72", lw=1, zorder=1)
    for what, row in rows.items():
        colour = COLOURS[what]
        sizes = [size / row["sizes"][0] for size in row["sizes"]]
        seconds = [value / row["cpu_s"][0] for value in row["cpu_s"]]
        peaks = [value / row["peak_mb"][0] for value in row["peak_mb"]]
        axis.plot(sizes, peaks, "--", color=colour, lw=1.2, zorder=2)
        label = f"{what}: {row['time_exponent']:.2f}, {row['memory_exponent']:.2f}".replace("-0.00", "0.00")
        axis.plot(sizes, seconds, "o-", color=colour, lw=1.8, ms=3.5, zorder=3, label=label)
    axis.set_xscale("log", base=2)
    axis.set_yscale("log", base=2)
    axis.set_title(operation, loc="left", fontweight="bold", fontsize=10)
    axis.xaxis.set_major_formatter("{x:g}")
    axis.yaxis.set_major_formatter("{x:g}")
    axis.legend(fontsize=8, frameon=False, loc="upper left", handlelength=1.4)
    axis.tick_params(which="both", length=0)
    axis.grid(visible=True, which="major", color="0.93", lw=0.6)
    axis.spines[["top", "right"]].set_visible(False)

"""The picture of `rate.py`: size against error for all coders, and below it the sizes under the promise."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

Curves = Mapping[str, Sequence[Sequence[float]]]
"""Points (NMSE in dB, bytes) of each coder, by falling error."""

STYLES = {
    # Okabe and Ito's colours, which the colour-blind tell apart, with dashes beside them; ours is thick
    "touch": ("#000000", 3.4, "-"),
    "paper": ("#D55E00", 2.2, "-"),
    "zpaq -m5": ("#0072B2", 1.6, "-"),
    "xz": ("#56B4E9", 1.4, "-"),
    "zstd -19": ("#56B4E9", 1.2, "--"),
    "brotli": ("#0072B2", 1.2, ":"),
    "JPEG XL": ("#009E73", 1.6, "-"),
    "SZ3": ("#CC79A7", 1.4, "-"),
    "SPERR": ("#CC79A7", 1.4, "--"),
    "zfp": ("#C88A00", 1.4, "-"),
    "Draco": ("#7A5C14", 1.4, "--"),
}
NAMES = {"touch": "touch max (ours)", "paper": "the paper's coder"}
SHOWN_DB = (-12.0, -40.0)
LABELS_DB = 18.5
"""Room for the names, right of what is shown."""
SEQUENCES = {"tum": "TUM desk", "icl": "ICL living room"}
KINDS = {"band": "as a wall", "height": "as a solid"}
INK, GREY = "#222222", "#8A8A8A"


def told(title: str) -> str:
    """A field's name in words: "icl band, nw 6" is "ICL living room as a wall"."""
    name = title.split(",")[0].split()
    if len(name) == 2 and name[0] in SEQUENCES and name[1] in KINDS:
        return f"{SEQUENCES[name[0]]} {KINDS[name[1]]}"
    return title.split(",")[0]


def draw(curves: Mapping[str, Curves], promised: Mapping[str, Mapping[str, Any]], out: Path) -> None:
    """Write the PNG.

    Parameters
    ----------
    curves : dict
        Of each field; two in a row, those of a wall left of those of a solid.
    promised : dict
        Rows of table 2 of the same fields; one without a row has no second panel.
    out : Path
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    titles = list(curves)
    across, down = min(2, len(titles)), -(-len(titles) // 2)
    with plt.rc_context({"font.size": 10, "font.family": "DejaVu Sans", "text.color": INK, "axes.labelcolor": INK}):
        figure = plt.figure(figsize=(5.6 * across, (6.3 * down) + 0.75), dpi=160, facecolor="white")
        grid = figure.add_gridspec(
            2 * down, across, height_ratios=[1.0, 0.48] * down, hspace=0.4, wspace=0.17,
            left=0.075 if across == 2 else 0.14, right=0.985, top=1 - 0.75 / (6.3 * down + 0.75), bottom=0.05 / down,
        )  # fmt: skip
        for i, title in enumerate(titles):
            row, column = 2 * (i // 2), i % 2
            upper = figure.add_subplot(grid[row, column])
            _curves(upper, title, curves[title], column == 0)
            if title in promised:
                _promised(figure.add_subplot(grid[row + 1, column]), promised[title])
        side = titles[0].rpartition(" ")[2]
        figure.text(
            0.012, 1 - 0.2 / figure.get_figheight(),
            f"Bytes of one frame, {2 ** int(side)}³ samples" + ", everything counted: fewer is better" * (across > 1),
            fontsize=13, fontweight="bold", va="top",
        )  # fmt: skip
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out, facecolor="white")
        plt.close(figure)


def _bytes(size: float, _: object = None) -> str:
    return f"{size / 1000:g} kB" if size >= 1000 else f"{size:g} B"


def _curves(axis, title: str, of: Curves, is_left: bool) -> None:  # type: ignore[no-untyped-def]
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    ends = {}
    for name, curve in sorted(of.items(), key=lambda item: STYLES[item[0]][1]):
        shown = _within([(float(db), float(size)) for db, size in curve])
        if len(shown) < 2:
            continue
        colour, width, style = STYLES[name]
        axis.plot(*zip(*shown), style, color=colour, lw=width, zorder=2 + width, solid_capstyle="round")
        ends[name] = shown[-1]
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(FuncFormatter(_bytes))
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_xlim(SHOWN_DB[0] + 1, SHOWN_DB[1] - LABELS_DB)
    axis.set_xticks([-15, -20, -25, -30, -35, -40])
    _label(axis, ends)
    axis.set_title(f"{told(title)}: size against mean error", loc="left", fontsize=11, fontweight="bold", pad=8)
    axis.set_xlabel("error, NMSE in dB: finer to the right", x=0.02, ha="left")
    axis.grid(visible=True, which="major", color="0.9", lw=0.7)
    axis.tick_params(which="both", length=0, labelcolor=INK)
    axis.spines[["top", "right", "left"]].set_visible(False)


def _within(curve: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """The part of a curve that is shown, cut on its way to the next point."""
    coarse, fine = SHOWN_DB
    inside = [(db, size) for db, size in curve if fine <= db <= coarse]
    for edge, first in ((coarse, True), (fine, False)):
        for (a_db, a), (b_db, b) in zip(curve, curve[1:]):
            if a_db > edge > b_db:
                share = (edge - a_db) / (b_db - a_db)
                inside.insert(0 if first else len(inside), (edge, a ** (1 - share) * b**share))
    return inside


def _label(axis, ends: Mapping[str, tuple[float, float]]) -> None:  # type: ignore[no-untyped-def]
    """Names right of all lines, pushed apart until none covers another, a thin line to the end of each."""
    low, high = np.log10(axis.get_ylim())
    gap = (high - low) / 18
    names = sorted(ends, key=lambda name: ends[name][1])
    places = [float(np.log10(ends[name][1])) for name in names]
    for _ in range(400):
        for i in range(len(places) - 1):
            short = gap - (places[i + 1] - places[i])
            if short > 0:
                places[i] -= short / 2
                places[i + 1] += short / 2
        for i in range(len(places)):  # and all of them beside the panel
            places[i] = min(max(places[i], low + (i + 0.5) * gap), high - (len(places) - i - 0.5) * gap)
    for name, place in zip(names, places):
        colour, _, style = STYLES[name]
        axis.annotate(
            NAMES.get(name, name), xy=ends[name], xytext=(SHOWN_DB[1] - 2.6, 10**place),
            fontsize=12 if name == "touch" else 10, color=colour, va="center",
            fontweight="bold" if name == "touch" else "normal", annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": colour, "lw": 0.7, "ls": style, "shrinkA": 0, "shrinkB": 2,
                        "alpha": 0.8, "relpos": (0, 0.5)},
        )  # fmt: skip


def _promised(axis, row: Mapping[str, Any]) -> None:  # type: ignore[no-untyped-def]
    """Bars of bytes: our efforts, and the five best peers, with how many times the smallest of ours they are."""
    known = {name: size for name, size in row["peers"].items() if math.isfinite(size)}
    peers = sorted(known.items(), key=lambda item: item[1])[:5]
    efforts = [(f"touch {effort}", size) for effort, size in reversed(row["touch"].items())]
    rows = [*efforts, *peers]
    best = min(size for _, size in efforts)
    for place, (name, size) in enumerate(rows):
        is_ours = name.startswith("touch")
        colour = "#000000" if is_ours else GREY
        axis.barh(place, size, 0.72, color=colour, alpha=1.0 if is_ours and size == best else 0.55)
        over = "" if size == best else f"   {size / best:.2f}x"
        axis.text(size, place, f" {size:,.0f}{over}", va="center", fontsize=9.5, color=INK)
        axis.text(0, place, f"{name} ", va="center", ha="right", fontsize=10, color=INK,
                  fontweight="bold" if is_ours and size == best else "normal")  # fmt: skip
    axis.set_ylim(len(rows) - 0.4, -0.6)
    axis.set_xlim(0, 1.3 * max(size for _, size in rows))
    axis.set_yticks([])
    axis.set_xticks([])
    axis.spines[["top", "right", "bottom"]].set_visible(False)
    axis.spines["left"].set_color("0.6")
    box = axis.get_position()
    share = 0.17  # of the width, for the names
    axis.set_position((box.x0 + share * box.width, box.y0, (1 - share) * box.width, box.height))
    axis.text(
        -share / (1 - share), 1.04, "Under the promise, no error beyond max(0.05 N, 0.1 |F|)",
        transform=axis.transAxes, fontsize=11, fontweight="bold", va="bottom",
    )  # fmt: skip

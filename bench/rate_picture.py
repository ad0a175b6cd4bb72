"""Draws the picture of `rate.py`: bytes against error, and bytes at the error bound."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

STYLES = {
    # the colours of Okabe and Ito, which the colour-blind can distinguish, and dashes; touchfield is thick
    "touch": ("#000000", 3.4, "-"), "paper": ("#D55E00", 2.2, "-"), "zpaq -m5": ("#0072B2", 1.6, "-"),
    "xz": ("#56B4E9", 1.4, "-"), "zstd -19": ("#56B4E9", 1.2, "--"), "brotli": ("#0072B2", 1.2, ":"),
    "JPEG XL": ("#009E73", 1.6, "-"), "SZ3": ("#CC79A7", 1.4, "-"), "SPERR": ("#CC79A7", 1.4, "--"),
    "zfp": ("#C88A00", 1.4, "-"), "Draco": ("#7A5C14", 1.4, "--"),
}  # fmt: skip
NAMES = {"touch": "touch (ours)", "paper": "the paper's coder"}
PHRASES = {"tum": "TUM desk", "icl": "ICL living room", "band": "as a wall", "height": "as a solid"}
RANGE_DB = (-12.0, -40.0)
LABELS_DB = 18.5
"""Width of the names to the right of the curves, dB."""
PEERS = 5


def draw(curves: Mapping[str, Any], promised: Mapping[str, Mapping[str, Any]], out: Path) -> None:
    """Write the PNG.

    Parameters
    ----------
    curves : dict
        For each field, the points (NMSE in dB, bytes) of each coder; at most two fields, side by side.
    promised : dict
        Rows of one frame at the error bound, of the same fields. A field without a row has no second panel.
    out : Path
        File to write.
    """
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    with plt.rc_context({"font.size": 10, "text.color": "#222222", "axes.labelcolor": "#222222"}):
        figure, axes = plt.subplots(
            2, len(curves), figsize=(5.6 * len(curves), 7.2), dpi=160, squeeze=False, layout="constrained",
            height_ratios=(1.0, 0.48),
        )  # fmt: skip
        for (title, of), (upper, lower) in zip(curves.items(), axes.T, strict=True):
            field, _, nw = title.partition(", nw ")
            side = 2 ** int(nw)
            _curves(upper, of)
            phrase = " ".join(PHRASES.get(word, word) for word in field.split())
            upper.set_title(
                f"{phrase}, {side}³: bytes of one frame", loc="left", fontweight="bold", fontsize=11
            )
            if promised.get(title, {}).get("touch"):
                _promised(lower, promised[title])
            else:
                lower.set_axis_off()
        out.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(out, facecolor="white")
        plt.close(figure)


def _curves(axis: Any, of: Mapping[str, Any]) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    coarse, fine = RANGE_DB
    last_points = {}
    for name, points in sorted(of.items(), key=lambda item: STYLES[item[0]][1]):
        db, size = np.array(sorted((-d, s) for d, s in points if math.isfinite(s) and s > 0)).T
        inside = db[(db > -coarse) & (db < -fine)]
        sampled_db = np.unique(np.concatenate([inside, np.clip([-coarse, -fine], db[0], db[-1])]))
        if len(sampled_db) < 2:
            continue
        sizes = np.exp(np.interp(sampled_db, db, np.log(size)))
        colour, width, style = STYLES[name]
        axis.plot(-sampled_db, sizes, style, color=colour, lw=width, zorder=2 + width, solid_capstyle="round")
        last_points[name] = (-sampled_db[-1], math.log10(sizes[-1]))
    axis.set_yscale("log")
    axis.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axis.yaxis.set_major_formatter(
        FuncFormatter(lambda s, _: f"{s / 1000:g} kB" if s >= 1000 else f"{s:g} B")
    )
    axis.yaxis.set_minor_formatter(NullFormatter())
    axis.set_xlim(coarse + 1, fine - LABELS_DB)
    axis.set_xticks([-15, -20, -25, -30, -35, -40])
    low, high = np.log10(axis.get_ylim())
    gap, top = (high - low) / 18, low  # labels from below, at least one line apart
    for remaining, (name, (db, height)) in zip(
        range(len(last_points), 0, -1), sorted(last_points.items(), key=lambda item: item[1][1])
    ):
        top = min(max(height, top + gap), high - (remaining - 0.5) * gap)
        axis.annotate(
            NAMES.get(name, name),
            xy=(db, 10**height),
            xytext=(fine - 2.6, 10**top),
            color=STYLES[name][0],
            va="center",
            fontweight="bold" if name == "touch" else "normal",
            annotation_clip=False,
            arrowprops={
                "arrowstyle": "-",
                "color": STYLES[name][0],
                "lw": 0.7,
                "relpos": (0, 0.5),
                "shrinkA": 0,
            },
        )
    axis.set_xlabel("error, NMSE in dB: finer to the right", x=0.02, ha="left")
    axis.grid(visible=True, which="major", color="0.9", lw=0.7)
    axis.tick_params(which="both", length=0)
    axis.spines[["top", "right", "left"]].set_visible(False)


def _promised(axis: Any, row: Mapping[str, Any]) -> None:
    """Draw the bytes of touchfield's efforts and of the best peers as bars.

    Each has its ratio to the smallest bytes of touchfield.
    """
    finite = sorted((size, name) for name, size in row["peers"].items() if math.isfinite(size))[:PEERS]
    ours = sorted((size, f"touch {effort}") for effort, size in row["touch"].items())
    sizes, names = zip(*ours, *finite)
    colours = ["#707070"] * len(ours) + ["#A8A8A8"] * len(finite)
    colours = ["#000000" if size == ours[0][0] else grey for size, grey in zip(sizes, colours)]
    bars = axis.barh(range(len(sizes)), sizes, 0.72, color=colours)
    axis.bar_label(
        bars, [f"{s:,.0f}" + f"   {s / ours[0][0]:.2f}x" * (s > ours[0][0]) for s in sizes], padding=4
    )
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlim(0, 1.3 * max(sizes))
    axis.set_xticks([])
    axis.tick_params(length=0)
    axis.spines[["top", "right", "bottom"]].set_visible(False)
    axis.set_title("No error beyond max(0.05 N, 0.1 |F|)", loc="left", fontweight="bold", fontsize=10)

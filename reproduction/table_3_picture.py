"""Draws the picture of table 3: what coding m frames together costs, relative to a single frame, with the
region that no coder can reach."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from reproduction.table_3_printed import PRINTED
from reproduction.trends import Case
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from reproduction.table_3_runs import SequenceRuns

__all__ = ["draw_gain"]

_COLOURS = {"literal": "#d55e00", "corrected": "#0072b2"}
_LINES = {"wall, world": ("-", "o"), "wall, camera": ("--", "s"), "solid, camera": (":", "^")}


def draw_gain(path: Path, found: tuple[SequenceRuns, ...]) -> Path:
    """CR(m) over CR(1), one panel for each sequence and k, high directions; the path of the PNG."""
    first = found[0].variants[0].coded["literal"]
    counts, fractions = sorted({c.m for c in first}), sorted({c.k for c in first})
    every = np.linspace(counts[0], counts[-1], 81)
    title = "bits of m frames over those of m single frames (C_a + C_d, high directions)"
    figure = titled_figure("the picture of table 3", title, 4.2 * len(fractions), 1.0 + 3.3 * len(found))
    axes = figure.subplots(len(found), len(fractions), squeeze=False, sharex=True, sharey=True)
    for one, row in zip(found, axes, strict=True):
        for k, panel in zip(fractions, row, strict=True):
            panel.fill_between(every, 1 / every, color="0.88", lw=0, label="below CR(1)/m: impossible")
            printed = [PRINTED[Case(m, k, True)].cr / PRINTED[Case(1, k, True)].cr for m in counts]
            panel.plot(counts, printed, "k-D", ms=5, lw=1.5, label="printed")
            for runs in one.variants:
                style, marker = _LINES[runs.variant]
                for reading, coded in runs.coded.items():
                    ratio = [
                        coded[Case(m, k, True)].cr_literal / coded[Case(1, k, True)].cr_literal
                        for m in counts
                    ]
                    panel.plot(
                        counts, ratio, style, marker=marker, ms=4, lw=1.4, color=_COLOURS[reading],
                        label=f"{reading}: {runs.variant}",
                    )  # fmt: skip
            panel.set_title(f"{one.name}, k = {k:g}", fontsize=9, parse_math=False)
            panel.set_xticks(counts)
            panel.grid(color="0.92")
        row[0].set_ylabel("CR(m) / CR(1)")
    axes[0, 0].set_ylim(bottom=0)  # all panels share it
    for panel in axes[-1]:
        panel.set_xlabel("m, frames")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=8)
    write_png(figure, path)
    return path

"""Reproduces figure 3 of the paper: amplitudes and directions quantised by concentric tessellated icosahedra
(eq. 7)."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from reproduction.experiment import Experiment, Finding, Inputs, markdown_table, require_drawing
from reproduction.polyhedron_picture import Shell, draw_shells
from touchfield.codec.paper.directions import Codebook
from touchfield.perception.weber import WeberLadder
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

__all__ = ["EXPERIMENT"]

K, FORCE_MIN_N, FORCE_MAX_N, DIRECTIONS = 0.25, 0.8, 3.3, "ico2"
"""A coarse product codebook, so that its shells can be told apart."""

OPENED_TO: Final = (0.8, -0.2, 0.55)

LABEL: Final = {"facecolor": "white", "edgecolor": "none", "pad": 1.5}

COLOURS: Final = ("#0072b2", "#56b4e9", "#009e73", "#e69f00", "#d55e00")


def run(inputs: Inputs) -> Finding:
    """Draw a product codebook, and count what the paper's ranges would take."""
    require_drawing("the picture of figure 3")
    ladder = WeberLadder.spanning(K, FORCE_MIN_N, FORCE_MAX_N)
    codebook = Codebook.get(DIRECTIONS)
    picture = _draw(inputs.folder / "fig3.png", ladder, codebook)
    rows = []
    for k, name in ((0.25, "ico3"), (0.1, "ico5"), (0.05, "ico20")):
        steps = WeberLadder.spanning(k, 0.03, FORCE_MAX_N).steps
        directions = Codebook.get(name)
        bound = k**2 + 2 * (1 + k) * (1 - math.cos(math.radians(directions.covering_radius_deg)))
        words = steps * len(directions) + 1
        rows.append([
            f"{k:g}", steps, f"{name}, {len(directions)}", words, f"{math.log2(words):.1f}",
            f"{directions.covering_radius_deg:.2f}", f"{math.sqrt(bound):.3f}",
        ])  # fmt: skip
    head = [
        "k",
        "levels, 0.03 to 3.3 N",
        "directions",
        "codewords with zero",
        "bits",
        "covering angle, degrees",
    ]
    head += ["worst relative error"]
    radii = ", ".join(f"{r:.2f}" for r in ladder.levels_n[1:])
    text = (
        f"Eq. 7 takes the product codebook {{r_i g_j}}: radii r_i times the vertices g_j of a polyhedron. "
        "Drawn are "
        f"the {ladder.steps} levels of a Weber ladder with k = {K:g} from {FORCE_MIN_N:g} to {FORCE_MAX_N:g} "
        "N "
        f"({radii} N; each {ladder.ratio:.3f} times the one before, as the perceptual mask grows) and the "
        f"{len(codebook)} vertices of {DIRECTIONS}. A mask that grows with the force asks for equal ratios "
        "of "
        "neighbouring radii, not for equal distances.\n\n![concentric tessellated icosahedra](fig3.png)\n\n"
        "The same over the range of a Phantom Omni, with the greatest error of amplitude and direction "
        "together, "
        "sqrt(k^2 + 2 (1 + k)(1 - cos theta)) of the force, theta the covering angle:\n\n"
    )
    data: dict[str, Any] = {
        "radii_n": ladder.levels_n[1:],
        "directions": len(codebook),
        "ratio": ladder.ratio,
    }
    return Finding(text + markdown_table(head, rows), data, (picture,))


def _draw(path: Path, ladder: WeberLadder, codebook: Codebook) -> Path:
    radii = ladder.levels_n[1:]
    title = f"{len(radii)} radii of a Weber ladder (k = {ladder.k:g}) times {len(codebook)} directions"
    figure = titled_figure("figure 3", title, 11.0, 5.6)
    grid = figure.add_gridspec(1, 2)
    solid = figure.add_subplot(grid[0], projection="3d")
    # the outer ones are opened, so that those within can be seen
    shells = [
        Shell(codebook, float(radius), colour, OPENED_TO if i else None)
        for i, (radius, colour) in enumerate(zip(radii, COLOURS, strict=False))
    ]
    draw_shells(solid, shells)
    reach = float(radii[-1])
    solid.set(xlim=(-reach, reach), ylim=(-reach, reach), zlim=(-reach, reach))
    solid.set_xlabel("F_x / N")
    solid.set_ylabel("F_y / N")
    solid.set_zlabel("F_z / N")
    solid.set_box_aspect((1, 1, 1))
    solid.view_init(elev=24, azim=30)
    flat = figure.add_subplot(grid[1])
    turn = np.linspace(0, 2 * np.pi, 241)
    for radius, edge, colour in zip(radii, ladder.thresholds_n, COLOURS, strict=False):
        flat.plot(radius * np.cos(turn), radius * np.sin(turn), color=colour, lw=2)
        flat.plot(edge * np.cos(turn), edge * np.sin(turn), color="0.5", lw=1, ls="--")
        flat.text(
            0, radius, f"r = {radius:.2f} N", ha="center", va="center", fontsize=8, color=colour, bbox=LABEL
        )
        flat.text(0, -edge, f"{edge:.2f} N", ha="center", va="center", fontsize=8, color="0.4", bbox=LABEL)
    flat.set_aspect("equal")
    flat.set_xlabel("F_x / N")
    flat.set_ylabel("F_y / N")
    flat.set_title("cut through the origin: radii, and borders of the cells (dashed)", fontsize=9)
    write_png(figure, path)
    return path


EXPERIMENT = Experiment("fig3", "Figure 3: concentric tessellated icosahedra", run)

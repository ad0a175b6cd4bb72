"""Reproduces figure 8 of the paper: the polyhedra with 258 and 92 vertices, and how well their directions
cover the sphere."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from reproduction.experiment import SEEDS, Experiment, Finding, Inputs, markdown_table, require_drawing
from reproduction.polyhedron_picture import Shell, draw_shells, face_angles_deg
from touchfield.codec.paper.directions import Codebook
from touchfield.viewer.page import titled_figure, write_png

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

__all__ = ["EXPERIMENT"]

CODEBOOKS: Final = {
    "octa3": "octahedron, split in four three times",
    "ico5": "icosahedron, edges in five",
    "ico3": "icosahedron, edges in three",
}

DRAWS = 200_000
ELEVATION_DEG, AZIMUTH_DEG = 22.0, 25.0


def run(inputs: Inputs) -> Finding:
    """Draw the polyhedra, and compute how many bits they take and how well they cover."""
    require_drawing("the picture of figure 8")
    rows, data = [], {}
    for name, wording in CODEBOOKS.items():
        codebook = Codebook.get(name)
        count, angle = len(codebook), codebook.covering_radius_deg
        error_db = mean_square_chord_db(codebook, 20_000 if inputs.quick else DRAWS)
        bits = math.ceil(math.log2(count))
        data[name] = {
            "vertices": count,
            "bits": bits,
            "covering_deg": angle,
            "mean_square_chord_db": error_db,
        }
        reading = {"octa3": "literal, high", "ico5": "corrected, high", "ico3": "both, low"}[name]
        chord = 2 * math.sin(math.radians(angle) / 2)
        rows.append([name, wording, reading, count, bits, f"{angle:.2f}", f"{chord:.3f}", f"{error_db:.2f}"])
    near = [10 * t + 2 for t in icosahedral_numbers(40)]
    below, above = max(n for n in near if n < 258), min(n for n in near if n > 258)
    picture = _draw(inputs.folder / "fig8.png")
    text = (
        "The paper calls both polyhedra tessellated icosahedra with 258 and 92 vertices. An icosahedron has "
        f"10 T + 2 vertices, T = h^2 + h k + k^2: 92 for T = 9, but never 258; the nearest are {below} and "
        f"{above}. "
        "258 = 4 x 8^2 + 2 is an octahedron, each triangle split in four three times. Both are here: the "
        "octahedron "
        "is the literal count, the icosahedron the corrected reading, which takes one bit less when written "
        "plainly "
        "and covers better.\n\n![the three polyhedra](fig8.png)\n\n"
    )
    head = [
        "codebook",
        "made of",
        "reading",
        "vertices",
        "bits",
        "covering angle, degrees",
        "worst chord / |F|",
    ]
    head += ["mean square chord, dB"]
    text += markdown_table(head, rows)
    text += (
        "\nThe covering angle is the largest between any direction and its vertex. The mean square chord is "
        "the NMSE "
        "(10 log10) of directions that point anywhere with amplitudes kept: no coder with these directions "
        "does "
        "better than that on such a field.\n"
    )
    return Finding(text, data, (picture,))


def mean_square_chord_db(codebook: Codebook, draws: int) -> float:
    """10 log10 of the mean squared distance of random unit vectors to their vertices; seeded."""
    vectors = np.random.default_rng(SEEDS["directions"]).standard_normal((draws, 3))
    unit = (vectors / np.linalg.norm(vectors, axis=1, keepdims=True)).astype(np.float32)
    chord = unit - codebook.vertices[codebook.nearest(unit)]
    return float(10 * np.log10((chord * chord).sum(axis=1).mean()))


def icosahedral_numbers(most: int) -> list[int]:
    """T = h^2 + h k + k^2 up to `most`, ascending."""
    steps = range(most + 1)
    found = {h * h + h * k + k * k for h in steps for k in steps}
    return sorted(t for t in found if 0 < t <= most)


def _draw(path: Path) -> Path:
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    figure = titled_figure(
        "figure 8", "direction codebooks, each face in the colour of its worst angle", 12.0, 4.6
    )
    panels = figure.subplots(1, 3, subplot_kw={"projection": "3d"})
    scale = ScalarMappable(Normalize(7.0, 14.0), "YlOrRd")
    for panel, (name, wording) in zip(panels, CODEBOOKS.items(), strict=True):
        codebook = Codebook.get(name)
        draw_shells(panel, [Shell(codebook, colours=scale.to_rgba(face_angles_deg(codebook)))])
        panel.scatter(*(1.005 * visible(codebook.vertices)).T, s=5, color="k", depthshade=False)
        panel.set(xlim=(-1, 1), ylim=(-1, 1), zlim=(-1, 1))
        panel.set_box_aspect((1, 1, 1), zoom=1.45)
        panel.view_init(ELEVATION_DEG, AZIMUTH_DEG)
        panel.set_axis_off()
        angle = f"no direction farther than {codebook.covering_radius_deg:.2f} degrees"
        panel.set_title(f"{len(codebook)} vertices: {wording}\n{angle}", fontsize=9)
    bar = figure.colorbar(scale, ax=list(panels), shrink=0.8, pad=0.01)
    bar.set_label("farthest direction of the face / degrees", fontsize=8)
    write_png(figure, path)
    return path


def visible(vertices: NDArray[np.float64]) -> NDArray[np.float64]:
    """The vertices on the side of the eye; the library does not hide those behind."""
    across = np.cos(np.radians(ELEVATION_DEG))
    turn = np.radians(AZIMUTH_DEG)
    eye = np.array([across * np.cos(turn), across * np.sin(turn), np.sin(np.radians(ELEVATION_DEG))])
    seen: NDArray[np.float64] = vertices[vertices @ eye > 0.08]
    return seen


EXPERIMENT = Experiment("fig8", "Figure 8: polyhedra for the directions of forces", run)

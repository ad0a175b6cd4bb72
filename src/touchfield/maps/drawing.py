"""Draws pins as a relief for printers and force-feedback devices, as STL, and as a picture for a report."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

import numpy as np
from scipy import ndimage

from touchfield.arrays import Bools, Float64s
from touchfield.atomic import atomic_path
from touchfield.maps.board import FREE, Layout
from touchfield.maps.guidelines import guidelines
from touchfield.maps.joins import joined, of_relief
from touchfield.maps.labels import LegendLine

MARGIN_MM: Final = float(guidelines()["margin_mm"].value)
"""Around the pins on paper and on a plate."""
SAMPLES_PER_PIN: Final = 6
"""Of a relief, along a row: 0.4 mm on a pitch of 2.5 mm, the nozzle of a usual printer."""


def plate_mm(
    layout: Layout, height_mm: float, land_mm: Float64s | None = None, margin_mm: float = MARGIN_MM
) -> tuple[Float64s, float]:
    """Return heights of a plate with the raised pins on it, float64 [rows, columns], and their spacing.

    Pins are domes and joined pins ridges of the same width, `height_mm` high; row 0 is the top. They stand on
    `land_mm`, the height of the land under each pin, [rows, columns], which takes the place of contour lines.
    """
    dot_mm, pitch_mm = float(guidelines()["dot_mm"].value), layout.rules.pitch_mm
    spacing_mm, factor = pitch_mm / SAMPLES_PER_PIN, SAMPLES_PER_PIN
    margin = round(margin_mm / spacing_mm)
    shape = tuple(factor * (n - 1) + 1 + 2 * margin for n in layout.raised.shape)
    core = np.zeros(shape, np.bool_)
    up = margin + factor * np.argwhere(layout.raised & ~of_relief(layout))
    core[tuple(up.T)] = True
    for (r0, c0), (r1, c1) in joined(layout):
        for step in range(factor + 1):
            core[margin + factor * r0 + step * (r1 - r0), margin + factor * c0 + step * (c1 - c0)] = True
    ground_mm = np.zeros(shape) if land_mm is None else _ground_mm(land_mm, shape, margin)
    if not core.any():
        return ground_mm, spacing_mm
    distance_mm = spacing_mm * ndimage.distance_transform_edt(~core)
    return ground_mm + height_mm * np.sqrt(np.maximum(1 - (2 * distance_mm / dot_mm) ** 2, 0)), spacing_mm


def _ground_mm(land_mm: Float64s, shape: tuple[int, ...], margin: int) -> Float64s:
    """Interpolate the height under the pins on the samples of a plate; its margin is that of its edge."""
    at = (np.indices(shape) - margin) / SAMPLES_PER_PIN
    return np.asarray(ndimage.map_coordinates(land_mm, at, order=1, mode="nearest"))


def write_stl(path: Path, layout: Layout, land_mm: Float64s | None = None) -> int:
    """Write the map as a plate for 3-D printers, binary STL in millimetres; returns the triangles.

    `land_mm` is the height of the land under each pin, [rows, columns]. The surface is closed: the relief,
    its walls and a flat bottom. Raises `SourceError` if it cannot be written; no file is then left.
    """
    heights_mm, spacing_mm = plate_mm(layout, float(guidelines()["print_height_mm"].value), land_mm)
    triangles = _solid(heights_mm + float(guidelines()["plate_mm"].value), spacing_mm)
    edges = triangles[:, 1:] - triangles[:, :1]
    normals = np.cross(edges[:, 0], edges[:, 1])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    record = np.dtype([("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")])
    records = np.zeros(len(triangles), record)
    records["normal"], records["corners"] = normals, triangles
    with atomic_path(path) as temporary:
        header = b"tactile map, millimetres".ljust(80, b" ")
        temporary.write_bytes(header + struct.pack("<I", len(records)) + records.tobytes())
    return len(triangles)


def _solid(heights_mm: Float64s, spacing_mm: float) -> Float64s:
    """Return the triangles of a closed solid below heights, float64 [n, 3, 3], outwards."""
    rows, columns = heights_mm.shape
    x, y = np.meshgrid(spacing_mm * np.arange(columns), spacing_mm * np.arange(rows)[::-1])
    top = np.stack([x, y, heights_mm], axis=-1)
    sides = [top[:, 0], top[-1], top[::-1, -1], top[0, ::-1]]
    border = np.concatenate([side[:-1] for side in sides])  # anticlockwise, from the top left
    border = np.concatenate([border, border[:1]])
    floor = border * (1, 1, 0)
    walls = _sheet(np.stack([floor, border]))[:, ::-1]
    centre = np.broadcast_to(floor[:-1].mean(axis=0), floor[1:].shape)
    bottom = np.stack([centre, floor[1:], floor[:-1]], axis=1)
    return np.concatenate([_sheet(top), walls, bottom])


def _sheet(points: Float64s) -> Float64s:
    """Return the two triangles of each cell of a lattice of points [rows, columns, 3]."""
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, :-1], points[1:, 1:]
    return np.concatenate(
        [np.stack(corners, axis=-2).reshape(-1, 3, 3) for corners in ((a, c, b), (b, c, d))]
    )


def draw_report(
    path: Path, layout: Layout, pages: Sequence[Bools], lines: Sequence[LegendLine], title: str
) -> None:
    """Draw the pins of the map, coloured by class, and the pages of the legend, as PNG (extra `report`)."""
    from matplotlib.figure import Figure

    rows, columns = layout.raised.shape
    panels = 1 + len(pages)
    figure: Any = Figure(
        figsize=(0.13 * columns + 3.2, 0.13 * rows * panels + 0.4 * panels), layout="constrained"
    )
    axes = figure.subplots(panels, 1, squeeze=False)[:, 0]
    _draw_pins(axes[0], layout.raised, title)
    kinds = list(dict.fromkeys(symbol.kind for symbol in layout.symbols))
    owner_kind = np.array([kinds.index(symbol.kind) for symbol in layout.symbols] + [FREE])[layout.owner]
    for n, kind in enumerate(kinds):
        r, c = np.nonzero(layout.raised & (owner_kind == n))
        axes[0].scatter(c, r, s=14, color=f"C{n % 10}", label=kind, zorder=2)
    if kinds:
        axes[0].legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=7, frameon=False)
    for n, page in enumerate(pages):
        _draw_pins(axes[1 + n], page, f"legend, page {n + 1}")
        r, c = np.nonzero(page)
        axes[1 + n].scatter(c, r, s=14, color="black", zorder=2)
    texts = [f"{line.key}  {line.text}" if line.key else line.text for line in lines]
    if texts and pages:
        shown = "\n".join(text if len(text) <= 28 else f"{text[:27]}…" for text in texts[:30])
        axes[1].text(1.01, 1.0, shown, transform=axes[1].transAxes, va="top", fontsize=7, parse_math=False)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=110, format="png")


def _draw_pins(axis: Any, pins: Bools, title: str) -> None:
    rows, columns = pins.shape
    r, c = np.nonzero(~pins)
    axis.scatter(c, r, s=1, color="0.8", zorder=1)
    axis.set(xlim=(-1, columns), ylim=(rows, -1), aspect="equal", xticks=[], yticks=[])
    axis.set_title(title, fontsize=9, parse_math=False)

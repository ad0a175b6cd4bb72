"""Writes a map and its legend as SVG for swell paper, on sheets that a printer takes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final
from xml.sax.saxutils import escape

import numpy as np

from touchfield.arrays import Bools, Int32s
from touchfield.atomic import atomic_path
from touchfield.errors import InvalidArgument
from touchfield.maps.board import FREE, Layout, Placed
from touchfield.maps.drawing import MARGIN_MM
from touchfield.maps.guidelines import PinRules, guidelines
from touchfield.maps.joins import contours, joined, of_relief
from touchfield.maps.labels import SWATCH_PINS, LegendLine
from touchfield.maps.symbols import RELIEF, symbol_of

PAPERS_MM: Final = {
    "A4": (210, 297), "A4 across": (297, 210), "A3": (297, 420), "A3 across": (420, 297),
}  # fmt: skip
"""Width and height of the paper for which sheets are made; the first that takes the map."""


def paper_of(layout: Layout) -> tuple[str, int]:
    """Return the paper on which a map fits, "" if on none, and the pages of pins on a sheet of it."""
    width_mm, page_mm = _size_mm(layout)
    for name, (paper_width_mm, paper_height_mm) in PAPERS_MM.items():
        if width_mm <= paper_width_mm and page_mm <= paper_height_mm:
            return name, int(paper_height_mm // page_mm)
    return "", 1


def sheet_path(path: Path, sheet: int) -> Path:
    """Return the file of a further sheet, counted from 2, beside that of the first."""
    return path.with_name(f"{path.stem}.sheet-{sheet}{path.suffix}")


def sheet_paths(path: Path, layout: Layout, page_count: int) -> tuple[Path, ...]:
    """Return the files of the sheets for a map and pages of its legend: the first is `path` itself."""
    count = -(-(1 + page_count) // paper_of(layout)[1])
    return (path, *(sheet_path(path, n) for n in range(2, count + 1)))


def write_svg(
    path: Path, layout: Layout, pages: Sequence[Bools], lines: Sequence[LegendLine], title: str, credit: str
) -> tuple[Path, ...]:
    """Write the map and below it the pages of its legend, black, in millimetres; returns the files.

    What does not fit on the paper of the first sheet is on further ones, ``OUT.sheet-2.svg`` and so on.
    Contour lines are thin lines without pins, in the legend too.

    Raises `SourceError` if a sheet cannot be written.
    """
    blocks = [layout, *_legend_layouts(pages, lines, layout.rules)]
    paths, per_sheet = sheet_paths(path, layout, len(pages)), paper_of(layout)[1]
    description = "; ".join(filter(None, (credit, *(line.text for line in lines))))
    for n, file in enumerate(paths):
        name = title if n == 0 else f"{title}, sheet {n + 1}"
        _write_sheet(file, blocks[n * per_sheet : (n + 1) * per_sheet], name, description)
    return paths


def refuse_sheets_over(source: str | Path, paths: Sequence[Path]) -> None:
    """Raise `InvalidArgument` if a sheet would take the place of the drawing that is read."""
    for path in paths[1:]:
        if path.absolute() == Path(source).absolute():
            raise InvalidArgument(str(path), "the file that is read, and a sheet of --svg", "another name")


def _size_mm(layout: Layout) -> tuple[float, float]:
    """Return width and height of a page of pins with its margins."""
    rows, columns = layout.raised.shape
    pitch_mm = layout.rules.pitch_mm
    return pitch_mm * (columns - 1) + 2 * MARGIN_MM, pitch_mm * (rows - 1) + 2 * MARGIN_MM


def _legend_layouts(pages: Sequence[Bools], lines: Sequence[LegendLine], rules: PinRules) -> list[Layout]:
    """Return the pages of the legend with the symbols of their samples, which feel as those of the map."""
    rest, layouts = iter(lines), []
    for page in pages:
        owner: Int32s = np.full(page.shape, FREE, np.int32)
        placed: list[Placed] = []
        for top in range(0, page.shape[0] - 2, rules.braille_line_pins):
            band = np.s_[top : top + 3, :SWATCH_PINS]
            if not page[band].any():
                continue  # the text of the line above goes on
            symbol = symbol_of(next(rest).kind)
            if symbol is not None:
                sample = page[band].any(axis=1, keepdims=True) if symbol.name == RELIEF else page[band]
                owner[band] = np.where(sample, len(placed), FREE)
                placed.append(Placed(symbol.name, symbol.shape))
        layouts.append(Layout(page, owner, tuple(placed), rules))
    return layouts


def _write_sheet(path: Path, blocks: Sequence[Layout], title: str, description: str) -> None:
    width_mm, page_mm = _size_mm(blocks[0])
    height_mm = page_mm * len(blocks)
    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_mm:g}mm" height="{height_mm:g}mm" '
        f'viewBox="0 0 {width_mm:g} {height_mm:g}">',
        f"<title>{escape(title)}</title>",
        f"<desc>{escape(description)}</desc>",
    ]
    for n, block in enumerate(blocks):
        out += _block(block, MARGIN_MM + n * page_mm)
    with atomic_path(path) as temporary:
        temporary.write_text("\n".join([*out, "</svg>", ""]), "utf-8")


def _block(layout: Layout, top_mm: float) -> list[str]:
    """Return the elements of a page of pins."""
    pitch_mm, dot_mm = layout.rules.pitch_mm, float(guidelines()["dot_mm"].value)
    return [
        f'<g transform="translate({MARGIN_MM:g} {top_mm:g})" stroke="#000" stroke-linecap="round">',
        f'<g stroke-width="{dot_mm:g}">',
        *_paths(joined(layout), pitch_mm),
        "</g>",
        f'<g stroke-width="{float(guidelines()["contour_line_mm"].value):g}">',
        *_paths(contours(layout), pitch_mm),
        "</g>",
        "</g>",
        f'<g transform="translate({MARGIN_MM:g} {top_mm:g})">',
        *(
            f'<circle cx="{column * pitch_mm:g}" cy="{row * pitch_mm:g}" r="{dot_mm / 2:g}"/>'
            for row, column in np.argwhere(layout.raised & ~of_relief(layout))
        ),
        "</g>",
    ]


def _paths(pairs: Sequence[tuple[tuple[int, int], tuple[int, int]]], pitch_mm: float) -> list[str]:
    return [
        f'<path d="M{c0 * pitch_mm:g} {r0 * pitch_mm:g}L{c1 * pitch_mm:g} {r1 * pitch_mm:g}"/>'
        for (r0, c0), (r1, c1) in pairs
    ]

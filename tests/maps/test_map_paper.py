"""The map on swell paper: what is joined, the samples of the legend, and the sheets that a printer takes."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from map_makers import LetterBraille, block, town, write_geojson
from touchfield.errors import InvalidArgument
from touchfield.maps import paper
from touchfield.maps.board import Layout, Placed
from touchfield.maps.drawing import MARGIN_MM
from touchfield.maps.guidelines import PinRules
from touchfield.maps.joins import joined
from touchfield.tasks import map as task
from touchfield.tasks.map import MadeMap, MapSpec, make_map

SVG = "{http://www.w3.org/2000/svg}"
LETTER_NAMES = [f"{first}{second}ville" for first in "abcdefgh" for second in "aeiou"]
CLOUDS = "".join(
    f'<text x="{40 + 90 * (n % 8)}" y="{50 + 90 * (n // 8)}">{name}</text>'
    for n, name in enumerate(LETTER_NAMES)
)
SKY = (
    f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 800 500">{CLOUDS}'
    '<path d="M0 0H800V500H0Z" fill="none" stroke="black"/></svg>'
)
"""A drawing with 40 names, of which each gets a key."""


@pytest.fixture(autouse=True)
def letters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Braille without liblouis, which writes these names by the same letters."""
    monkeypatch.setattr(task, "Braille", lambda language: LetterBraille())


@dataclass
class Block:
    """A page of pins on a sheet: the pins of its circles, and the ends of its strokes, (row, column)."""

    pins: set[tuple[int, int]]
    ends: np.ndarray


def blocks_of(path: Path, pitch_mm: float) -> list[Block]:
    groups = ElementTree.parse(path).getroot().findall(f"{SVG}g")
    assert len(groups) % 2 == 0
    found = []
    for strokes, dots in zip(groups[::2], groups[1::2]):
        centres = [(float(c.get("cy")), float(c.get("cx"))) for c in dots.findall(f"{SVG}circle")]
        numbers = [
            list(map(float, re.findall(r"[\d.]+", path.get("d")))) for path in strokes.iter(f"{SVG}path")
        ]
        ends = np.rint(np.array(numbers).reshape(-1, 2, 2)[..., ::-1] / pitch_mm).astype(int)
        found.append(Block({(round(y / pitch_mm), round(x / pitch_mm)) for y, x in centres}, ends))
    return found


def pins_of(mask: np.ndarray) -> set[tuple[int, int]]:
    return {(int(r), int(c)) for r, c in np.argwhere(mask)}


def sheets_of(made: MadeMap) -> list[Path]:
    return [file for file in made.files if file.suffix == ".svg"]


def test_each_pin_has_a_circle_and_no_two_symbols_are_joined(tmp_path: Path) -> None:
    made = make_map(
        write_geojson(tmp_path / "a.geojson", *town()), tmp_path / "a.touch", svg=tmp_path / "a.svg"
    )
    layout = made.drawn.layout
    blocks = blocks_of(tmp_path / "a.svg", layout.rules.pitch_mm)
    assert blocks[0].pins == pins_of(layout.raised)
    assert [found.pins for found in blocks[1:]] == [pins_of(page) for page in made.pages]
    owners = layout.owner[blocks[0].ends[..., 0], blocks[0].ends[..., 1]]
    assert len(owners) > 50 and (owners[:, 0] == owners[:, 1]).all() and (owners >= 0).all()
    assert {layout.symbols[n].role for n in owners[:, 0]} == {"line", "area"}


def test_samples_of_the_legend_are_joined_as_on_the_map(tmp_path: Path) -> None:
    made = make_map(
        write_geojson(tmp_path / "a.geojson", *town()), tmp_path / "a.touch", svg=tmp_path / "a.svg"
    )
    legend = blocks_of(tmp_path / "a.svg", 2.5)[1]
    kinds = [line.kind for line in made.lines]
    rows = {kind: 4 * kinds.index(kind) for kind in ("road", "path", "stop", "building")}

    def strokes(kind: str) -> int:
        return int(((legend.ends[:, 0, 0] >= rows[kind]) & (legend.ends[:, 0, 0] < rows[kind] + 3)).sum())

    assert strokes("road") == 8, "nine pins in a row"
    assert strokes("path") == strokes("stop") == 0
    assert strokes("building") == 3 * 8 + 2 * 9 + 2 * 2 * 8, "three rows, nine columns, and the diagonals"
    assert legend.ends[..., 1].max() < 9, "no letter of Braille is joined"


def test_a_junction_is_not_filled_and_a_corner_is_joined() -> None:
    raised = np.zeros((5, 5), np.bool_)
    raised[2, :], raised[3:, 2], raised[1, 4] = True, True, False
    raised[0, 0], raised[1, 1] = True, True
    owner = np.where(raised, 0, -1).astype(np.int32)
    pairs = joined(Layout(raised, owner, (Placed("road", "line"),), PinRules(2.5)))
    assert ((2, 1), (3, 2)) not in pairs and ((2, 3), (3, 2)) not in pairs
    assert ((0, 0), (1, 1)) in pairs and ((2, 2), (3, 2)) in pairs


@pytest.mark.parametrize(("kind", "pairs"), [("path", 0), ("road", 1)])
def test_dots_that_meet_are_no_dash(kind: str, pairs: int) -> None:
    raised, owner = np.zeros((2, 3), np.bool_), np.full((2, 3), -1)
    raised[0, :2], owner[0, :2] = True, 0
    assert len(joined(Layout(raised, owner, (Placed(kind, "line"),), PinRules(2.5)))) == pairs


@pytest.mark.parametrize(
    ("display", "name", "per_sheet"), [("graphiti", "A4", 2), ("hyperbraille", "A4 across", 1)]
)
def test_the_legend_goes_on_further_sheets(tmp_path: Path, display: str, name: str, per_sheet: int) -> None:
    pytest.importorskip("svgelements")
    source = tmp_path / "sky.svg"
    source.write_text(SKY)
    made = make_map(source, tmp_path / "a.touch", MapSpec(display, zooms=1), svg=tmp_path / "a.svg")
    sheets = sheets_of(made)
    assert made.figures["paper"] == name and len(made.pages) > 1
    assert len(sheets) == -(-(1 + len(made.pages)) // per_sheet) > 1
    assert [sheet.name for sheet in sheets[:2]] == ["a.svg", "a.sheet-2.svg"]
    limit_mm = {"A4": (210, 297), "A4 across": (297, 210)}[name]
    blocks = []
    for sheet in sheets:
        root = ElementTree.parse(sheet).getroot()
        size_mm = [float(root.get(side).removesuffix("mm")) for side in ("width", "height")]
        assert size_mm[0] <= limit_mm[0] and size_mm[1] <= limit_mm[1]
        found = blocks_of(sheet, 2.5)
        assert len(found) <= per_sheet
        assert size_mm[1] == (2.5 * (made.pages[0].shape[0] - 1) + 2 * MARGIN_MM) * len(found)
        blocks += found
    assert [found.pins for found in blocks[1:]] == [pins_of(page) for page in made.pages]


def test_parts_of_an_earlier_map_are_noted(tmp_path: Path) -> None:
    source = write_geojson(tmp_path / "a.geojson", *town())
    out, svg = tmp_path / "a.touch", tmp_path / "a.svg"
    made = make_map(source, out, MapSpec(zooms=1), svg=svg)
    assert not any("earlier map" in note for note in made.notes)
    more = [tmp_path / f"a.legend-{len(made.pages) + n}.touch" for n in (1, 2)]
    more.append(tmp_path / f"a.sheet-{len(sheets_of(made)) + 1}.svg")
    for path in more:
        path.write_bytes(b"")
    made = make_map(source, out, MapSpec(zooms=1), svg=svg)
    notes = [note for note in made.notes if "earlier map" in note]
    assert (
        len(notes) == 2 and more[0].name in notes[0] and more[1].name in notes[0] and more[2].name in notes[1]
    )
    assert all(path.read_bytes() == b"" for path in more)


def test_the_drawing_that_is_read_is_no_part_of_an_earlier_map(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    source = tmp_path / "sky.svg"
    source.write_text(SKY)
    sheets = sheets_of(make_map(source, tmp_path / "a.touch", MapSpec(zooms=1), svg=tmp_path / "a.svg"))
    further = source.rename(tmp_path / f"a.sheet-{len(sheets) + 1}.svg")
    made = make_map(further, tmp_path / "a.touch", MapSpec(zooms=1), svg=tmp_path / "a.svg")
    assert not any("earlier map" in note for note in made.notes)


def test_a_map_that_no_paper_takes_is_noted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(paper, "PAPERS_MM", {"A7": (74, 105)})
    source = write_geojson(tmp_path / "a.geojson", *town())
    made = make_map(source, tmp_path / "a.touch", MapSpec(zooms=1), svg=tmp_path / "a.svg")
    assert made.figures["paper"] is None and any("larger than A3" in note for note in made.notes)
    assert len(sheets_of(made)) == 1 + len(made.pages)


def test_a_sheet_does_not_take_the_place_of_the_drawing(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    source = tmp_path / "a.sheet-2.svg"
    source.write_text(SKY)
    before = source.read_bytes()
    with pytest.raises(InvalidArgument, match="a sheet of --svg"):
        make_map(source, tmp_path / "a.touch", MapSpec(zooms=1), svg=tmp_path / "a.svg")
    assert source.read_bytes() == before and [path.name for path in tmp_path.iterdir()] == [source.name]


def test_houses_are_black_on_paper(tmp_path: Path) -> None:
    """Every pin of a solid area is joined to all its neighbours of the area, diagonals included."""
    house = block(0, 0, 0.001, 0.0005, building="yes")
    made = make_map(write_geojson(tmp_path / "a.geojson", house), tmp_path / "a.touch")
    raised = made.drawn.layout.raised
    expected = (raised[:, :-1] & raised[:, 1:]).sum() + (raised[:-1] & raised[1:]).sum()
    expected += (raised[:-1, :-1] & raised[1:, 1:]).sum() + (raised[:-1, 1:] & raised[1:, :-1]).sum()
    assert len(joined(made.drawn.layout)) == expected

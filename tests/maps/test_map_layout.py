"""Maps on pins: real extracts and diagrams keep the distances of the guidelines; the check finds faults."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_makers import INPUTS, LetterBraille, block, feature, street, town, write_geojson
from touchfield.devices import device
from touchfield.maps.board import Layout
from touchfield.maps.check import check
from touchfield.maps.guidelines import PinRules, guidelines
from touchfield.maps.labels import class_titles, legend_lines, legend_pages
from touchfield.maps.layout import Drawn, draw
from touchfield.maps.lines import dashes
from touchfield.maps.pins import Window, fill, trace
from touchfield.maps.reader import box_of, on_level, read_map
from touchfield.maps.symbols import symbols

LIBRARIES = {".pbf": "osmium", ".svg": "svgelements"}
FLOOR_BOX = (8.67669, 49.41849, 8.67706, 49.41883)
CASES = {
    "crossing.osm.pbf": None,
    "park.osm.pbf": None,
    "floor_plan.geojson": FLOOR_BOX,
    "triangle.svg": None,
    "parabola.svg": None,
    "cell.svg": None,
}


def drawn(path: Path, display: str = "graphiti", box: Any = None) -> Drawn:
    if path.suffix in LIBRARIES:
        pytest.importorskip(LIBRARIES[path.suffix])
    source, profile = read_map(path), device(display)
    columns, rows, _ = profile.lattice
    window = Window.around(*box_of(source, box), rows, columns)
    return draw(source.features, window, PinRules(profile.pitch_mm), LetterBraille())


def closest_mm(layout: Layout) -> float:
    """Least distance between the centres of raised pins of two symbols, by brute force."""
    pins = np.argwhere(layout.raised)
    owners = layout.owner[tuple(pins.T)]
    apart = np.hypot(*(pins[:, None] - pins[None]).transpose(2, 0, 1)) * layout.rules.pitch_mm
    return float(apart[owners[:, None] != owners[None]].min())


@pytest.mark.parametrize("display", ["graphiti", "hyperbraille"])
@pytest.mark.parametrize("name", CASES)
def test_no_two_symbols_are_closer_than_the_guideline(name: str, display: str) -> None:
    made = drawn(INPUTS / name, display, CASES[name])
    checked = check(made.layout)
    assert checked.violations == ()
    least_mm = guidelines()["gap_mm"].value + guidelines()["dot_mm"].value
    assert closest_mm(made.layout) >= least_mm
    assert checked.min_gap_mm == pytest.approx(closest_mm(made.layout) - guidelines()["dot_mm"].value)
    assert made.layout.raised.sum() > 50 and len(made.layout.symbols) > 2


def test_the_crossing_shows_its_streets_its_crossings_and_their_names() -> None:
    made = drawn(INPUTS / "crossing.osm.pbf")
    assert {label.name for label in made.labels} == {
        "East Lynn Street",
        "22nd Avenue East",
        "23rd Avenue East",
    }
    seen, count = made.counts["crossing"]
    assert count >= 5 <= seen
    road = np.isin(made.layout.owner, [n for n, s in enumerate(made.layout.symbols) if s.kind == "road"])
    assert road.any(axis=0).sum() > 55 and road.any(axis=1).sum() > 35


def test_rooms_are_walls_with_gaps_at_their_doors() -> None:
    source = read_map(INPUTS / "floor_plan.geojson")
    window = Window.around(*box_of(source, FLOOR_BOX), 40, 60)
    rules = PinRules(2.5)
    open_plan = draw(source.features, window, rules, None)
    closed = draw([f for f in source.features if f.kind != "door"], window, rules, None)
    doors = [f for f in source.features if f.kind == "door"]
    assert open_plan.counts["door"] == (len(doors), len(doors)) and len(doors) > 15
    assert open_plan.layout.raised.sum() < closed.layout.raised.sum() - len(doors)
    assert not (open_plan.layout.raised & ~closed.layout.raised).any()


def test_a_town_has_every_symbol_where_it_lies(tmp_path: Path) -> None:
    made = drawn(write_geojson(tmp_path / "town.geojson", *town()))
    kinds = {symbol.kind for symbol in made.layout.symbols}
    assert kinds == {"road", "path", "stop", "building", "water", "green", "label"}
    assert {label.name for label in made.labels} == {
        "High Street",
        "Mill Lane",
        "Town Hall",
        "Green Park",
        "Mill",
    }
    assert next(label for label in made.labels if label.name == "Mill").text == "Mill"
    assert next(label for label in made.labels if label.name == "High Street").text == "hs"
    number = next(n for n, symbol in enumerate(made.layout.symbols) if symbol.kind == "building")
    rows, columns = np.nonzero(made.layout.owner == number)
    assert rows.max() < 20 and columns.max() < 20  # north west, row 0 is north
    assert check(made.layout).violations == ()


def test_streets_that_meet_are_joined_and_a_bridge_is_a_gap(tmp_path: Path) -> None:
    east_west = [[0, 0.0005], [0.0007, 0.0005], [0.0015, 0.0005]]
    joined = feature("LineString", [[0.0007, 0], [0.0007, 0.0005], [0.0007, 0.001]], highway="primary")
    bridge = feature("LineString", [[0.0007, 0], [0.0007, 0.001]], highway="primary")
    parts = []
    for other in (joined, bridge):
        street = feature("LineString", east_west, highway="primary")
        layout = drawn(write_geojson(tmp_path / "a.geojson", street, other)).layout
        parts.append(len(layout.symbols))
        assert check(layout).violations == ()
    assert parts == [1, 3]  # one network; the street, and the bridge on both sides of it


def test_two_carriageways_are_one_line(tmp_path: Path) -> None:
    ends = [[0, 0.0], [0.0015, 0.0]]
    beside = [[0, 0.0], [0.0003, 0.00003], [0.0012, 0.00003], [0.0015, 0.0]]
    lines = [feature("LineString", part, highway="primary") for part in (ends, beside)]
    frame = feature("Point", [0.0007, 0.0009], highway="bus_stop")
    layout = drawn(write_geojson(tmp_path / "a.geojson", *lines, frame)).layout
    roads = np.isin(layout.owner, [n for n, s in enumerate(layout.symbols) if s.kind == "road"])
    assert check(layout).violations == () and (roads.sum(axis=0) == 1).mean() > 0.95


def test_what_is_too_small_is_left_out_and_counted(tmp_path: Path) -> None:
    hut = [[0.0001, 0.0008], [0.00011, 0.0008], [0.00011, 0.00081], [0.0001, 0.0008]]
    small = feature("Polygon", [hut], building="yes")
    made = drawn(write_geojson(tmp_path / "a.geojson", *town(), small))
    assert made.counts["building"] == (2, 1)


def test_a_label_without_room_is_reported(tmp_path: Path) -> None:
    paths = [
        feature("LineString", [[0, y], [0.001, y]], highway="footway", name=f"path {'abcdefghijklmno'[n]}")
        for n, y in enumerate(np.linspace(-0.0003, 0.0003, 15))
    ]
    made = drawn(write_geojson(tmp_path / "a.geojson", *paths))
    assert made.counts["path"] == (15, 15)
    assert len(made.unlabelled) > 8 and len(made.unlabelled) + len(made.labels) == 15


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("beside", "apart"), ("stray", "belong to no symbol"), ("label", "is covered"), ("double", "merge"),
        ("alike", "same symbol"), ("small", "mm across"),
    ],
)  # fmt: skip
def test_the_check_finds_a_fault(tmp_path: Path, fault: str, message: str) -> None:
    layout = drawn(write_geojson(tmp_path / "town.geojson", *town())).layout
    assert check(layout).violations == ()
    raised, owner, symbols = layout.raised.copy(), layout.owner.copy(), list(layout.symbols)
    number = {symbol.kind: n for n, symbol in enumerate(symbols)}
    if fault == "beside":
        row, column = np.argwhere(raised & (owner == number["building"]))[0]
        raised[row - 1, column], owner[row - 1, column] = True, number["stop"]
    elif fault == "stray":
        row, column = np.argwhere(owner < 0)[0]
        raised[row, column] = True
    elif fault == "label":
        row, column = np.argwhere(owner == number["label"])[0]
        raised[row, column] ^= True
    elif fault == "double":
        row, column = np.argwhere(raised & (owner == number["road"]))[30]
        raised[row : row + 2, column : column + 2], owner[row : row + 2, column : column + 2] = (
            True,
            number["road"],
        )
    elif fault == "alike":
        symbols[number["building"]] = replace(symbols[number["building"]], kind="fill4")
        symbols[number["water"]] = replace(symbols[number["water"]], kind="building")
    else:
        row, column = np.argwhere(owner == number["stop"])[0]
        gone = owner == number["stop"]
        gone[row, column] = False
        raised[gone], owner[gone] = False, -1
    checked = check(Layout(raised, owner, tuple(symbols), layout.rules))
    assert any(message in text for text in checked.violations), checked.violations


def test_the_legend_has_every_symbol_and_key(tmp_path: Path) -> None:
    made = drawn(write_geojson(tmp_path / "town.geojson", *town()))
    lines = legend_lines(made.layout, made.labels, class_titles("de"))
    assert [line.text for line in lines][:3] == ["Straße", "Weg", "Haltestelle"]
    assert {line.text for line in lines if not line.kind} == {
        label.name for label in made.labels if label.is_key
    }
    pages, notes = legend_pages(lines, LetterBraille(), 40, 60, PinRules(2.5))
    assert len(pages) == -(-len(lines) // 10) and notes == () and all(page.any() for page in pages)
    for page in pages:
        rows = np.flatnonzero(page.any(axis=1))
        assert (rows % 4 != 3).all()  # a free row between two lines
    assert legend_pages(lines, LetterBraille(), 8, 12, PinRules(2.5))[1]


def names_of(made: Drawn) -> dict[str, str]:
    return {label.name: label.text for label in made.labels}


def test_a_house_that_fills_the_map_has_its_name_in_an_opening(tmp_path: Path) -> None:
    house = block(0, 0, 0.001, 0.0005, building="school", name="High School")
    made = drawn(write_geojson(tmp_path / "a.geojson", house))
    checked = check(made.layout)
    assert names_of(made) == {"High School": "hs"} and made.unlabelled == ()
    assert checked.violations == () and checked.min_gap_mm is not None
    label = made.labels[0]
    box = np.s_[label.row - 1 : label.row + 4, label.column - 1 : label.column + 6]
    assert made.layout.raised[box].sum() == sum(cell.bit_count() for cell in label.cells)
    around = made.layout.raised[label.row - 4 : label.row + 7, label.column - 4 : label.column + 9].copy()
    around[3:-3, 3:-3] = True
    assert around.all(), "three pins of the house on every side: the size of an area"


def test_a_house_with_room_beside_it_stays_whole(tmp_path: Path) -> None:
    house = block(0.0004, 0.0002, 0.0007, 0.0004, building="yes", name="Hall")
    edges = [street(0, y, 0.001, y, highway="primary") for y in (0, 0.0006)]
    made = drawn(write_geojson(tmp_path / "a.geojson", house, *edges))
    solid = made.layout.owner == next(n for n, s in enumerate(made.layout.symbols) if s.kind == "building")
    assert names_of(made) == {"Hall": "Hall"}
    rows, columns = np.nonzero(solid)
    assert solid[rows.min() : rows.max() + 1, columns.min() : columns.max() + 1].all()


def test_a_house_too_narrow_for_an_opening_stays_whole(tmp_path: Path) -> None:
    """An opening for a key takes 13 columns; this house has 12, and no room beside it."""
    house = block(0, 0, 0.0002, 0.0006, building="yes", name="High School")
    path = write_geojson(tmp_path / "a.geojson", house)
    for columns, count in ((12, 0), (13, 1)):
        window = Window(0.0, 0.0, 1.0, 40, columns)
        features = [
            replace(read_map(path).features[0], parts=(np.array([[-1, 1], [99, 1], [99, -99], [-1, -99]]),))
        ]
        made = draw(features, window, PinRules(2.5), LetterBraille())
        assert len(made.labels) == count and len(made.unlabelled) == 1 - count
        assert made.layout.raised.all() == (not count) and check(made.layout).violations == ()


def test_a_text_upon_a_black_shape_stands_in_an_opening(tmp_path: Path) -> None:
    pytest.importorskip("svgelements")
    path = tmp_path / "a.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 600 400"><g id="building">'
        '<rect width="600" height="400" fill="#000"/></g><text x="300" y="200">Hall</text></svg>'
    )
    made = drawn(path)
    assert names_of(made) == {"Hall": "Hall"} and check(made.layout).violations == ()


def test_no_textured_area_is_a_single_row(tmp_path: Path) -> None:
    """A row of pins would be felt as a street."""
    for height in np.linspace(0.00005, 0.0002, 16):
        lake = block(0, 0, 0.001, float(height), natural="water")
        frame = [street(0, y, 0.001, y, highway="footway") for y in (-0.0003, 0.0006)]
        made = drawn(write_geojson(tmp_path / "a.geojson", lake, *frame))
        for n, symbol in enumerate(made.layout.symbols):
            if symbol.role == "area":
                felt = made.layout.raised & (made.layout.owner == n)
                assert felt.any(axis=1).sum() > 1 < felt.any(axis=0).sum()


@pytest.mark.parametrize("length", range(6, 40))
def test_no_dash_is_shorter_than_its_style(length: int) -> None:
    line = np.zeros((3, 45), np.bool_)
    line[1, 2 : 2 + length] = True
    raised = dashes(line, 3, 1)
    runs = [len(run) for run in "".join("01"[int(up)] for up in raised[1]).split("0") if run]
    assert set(runs) == {3} and len(runs) == (length + 1) // 4
    assert not (raised & ~line).any()


def test_what_a_pitch_allows() -> None:
    assert PinRules(2.5).too_close.tolist() == np.ones((3, 3)).tolist()
    assert PinRules(2.0).too_close.sum() == 21  # 4.6 mm: two pins away, but not along both axes
    assert (PinRules(2.5).symbol_pins, PinRules(2.5).line_pins, PinRules(2.5).cell_pins) == (3, 6, 3)
    assert PinRules(2.5).can_write_braille and not PinRules(2.0).can_write_braille
    for row in guidelines().values():
        assert row.verified in ("read", "secondary", "unverified") and row.source and row.unit
        assert (row.verified != "secondary") or row.read_in
        assert (row.verified == "unverified") == (not row.where)


def test_dashes_have_the_length_of_the_guideline() -> None:
    dot_mm, pitch_mm = guidelines()["dot_mm"].value, 2.5
    for symbol in symbols().values():
        if symbol.shape == "line" and symbol.on > 1:
            dash_mm, space_mm = pitch_mm * (symbol.on - 1) + dot_mm, pitch_mm * (symbol.off + 1) - dot_mm
            assert guidelines()["dash_mm"].value <= dash_mm <= 10
            assert space_mm / dash_mm == pytest.approx(guidelines()["dash_gap_fraction"].value, abs=0.1)


def test_an_area_that_crosses_itself_has_its_odd_parts() -> None:
    bow = np.array([[0, 0], [8, 8], [8, 0], [0, 8]], float)
    inside = fill([bow], 9, 9)
    assert inside[1, 4] and inside[7, 4] and not inside[4, 1] and not inside[4, 7]
    hole = np.array([[0.5, 2.5], [0.5, 5.5], [2.5, 5.5], [2.5, 2.5]])
    with_hole = fill([bow, hole], 9, 9)
    assert np.array_equal(with_hole[1:3, 3:6], ~inside[1:3, 3:6]) and with_hole[7, 4]


@pytest.mark.parametrize("seed", range(5))
def test_a_line_is_traced_within_the_display_by_neighbours(seed: int) -> None:
    rng = np.random.default_rng(seed)
    line = rng.uniform(-40, 80, (60, 2))
    line[rng.integers(60, size=4)] = 1e9
    paths = trace(line, 40, 60)
    assert paths
    for path in paths:
        assert (path >= 0).all() and (path < (40, 60)).all()
        assert (np.abs(np.diff(path, axis=0)).max(axis=1) == 1).all()


def test_a_floor_is_cut_out(tmp_path: Path) -> None:
    rooms = [
        feature("Polygon", [[[0, 0], [0.0001, 0], [0.0001, 0.0001], [0, 0]]], indoor="room", level=level)
        for level in ("0", "1;2", "0-3")
    ]
    source = read_map(write_geojson(tmp_path / "a.geojson", *rooms))
    assert [len(on_level(source, level).features) for level in ("0", "1", "3")] == [2, 2, 1]
    with pytest.raises(Exception, match="found floors 0, 1, 2, 3"):
        on_level(source, "9")

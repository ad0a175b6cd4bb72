"""Relief beneath maps: contour lines on pins and paper, height on plates and point devices, and errors."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from height_makers import geotiff
from map_makers import INPUTS, LetterBraille, block, street, town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.container import TouchReader
from touchfield.maps.board import FREE
from touchfield.maps.guidelines import guidelines
from touchfield.maps.symbols import RELIEF
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.stored_map import Position, StoredMap
from touchfield.tasks import map as task
from touchfield.tasks.map import MapSpec, make_map

pytest.importorskip("tifffile")
pytest.importorskip("contourpy")

CELL_DEG = 2e-5
WEST, NORTH, SAMPLES = -0.0005, 0.0015, 128
WGS84 = (34735, (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326))
SCALE = (33550, (CELL_DEG, CELL_DEG, 0.0))
TIE = (33922, (0.0, 0.0, 0.0, WEST, NORTH, 0.0))


def positions_deg() -> tuple[np.ndarray, np.ndarray]:
    """Longitudes and latitudes of the samples, [rows, columns]."""
    steps = CELL_DEG * (np.arange(SAMPLES) + 0.5)
    return np.broadcast_to(WEST + steps, (SAMPLES,) * 2), np.broadcast_to(
        (NORTH - steps)[:, None], (SAMPLES,) * 2
    )


def slope(low_m: float = 400.0, high_m: float = 460.0) -> np.ndarray:
    """Land that rises evenly from the west of the town to its east, float32."""
    x, _ = positions_deg()
    return (low_m + (high_m - low_m) * x / 0.0015).astype(np.float32)


def dem(path: Path, heights: np.ndarray | None = None, *tags: tuple[int, Any]) -> Path:
    return geotiff(path, slope() if heights is None else heights, SCALE, TIE, *(tags or (WGS84,)))


def plain(path: Path) -> Path:
    """Two short streets in the north and a long one in the south; much room between."""
    return write_geojson(
        path,
        street(0, 0.00095, 0.0015, 0.00095, highway="primary", name="North Road"),
        street(0, 0.00005, 0.0015, 0.00005, highway="primary", name="South Road"),
    )


@pytest.fixture
def letters(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(task, "Braille", lambda language: LetterBraille())


def contour_owners(layout: Any) -> np.ndarray:
    """Pins that belong to a contour line, up or down."""
    is_relief = np.array([symbol.kind == RELIEF for symbol in layout.symbols] + [False])
    return is_relief[layout.owner]


def stored(path: Path) -> StoredMap:
    with TouchReader(path) as reader:
        record = reader.read_map()
    assert record is not None
    return StoredMap(record, path.name)


# -- on the pins -------------------------------------------------------------------------------------------
@pytest.mark.usefixtures("letters")
def test_contour_lines_lie_at_their_heights(tmp_path: Path) -> None:
    """On an even slope the line of 430 m is half way across, and each line is where its name says."""
    made = make_map(
        plain(tmp_path / "a.geojson"), tmp_path / "a.touch", MapSpec(relief=dem(tmp_path / "dem.tif"))
    )
    assert made.figures["relief"]["interval_m"] == 10.0
    drawn, columns_of = made.drawn, {}
    for n, (kind, name) in enumerate(drawn.named):
        if kind == RELIEF:
            rows, columns = np.nonzero((drawn.name_at == n) & contour_owners(drawn.layout))
            columns_of[float(name.removesuffix(" m"))] = (len(rows), columns.mean(), np.ptp(columns))
    assert set(columns_of) >= {410.0, 420.0, 430.0, 440.0, 450.0}
    for height_m, (count, column, spread) in columns_of.items():
        assert count > 20 and spread <= 1
        assert column == pytest.approx(59 * (height_m - 400) / 60, abs=0.75)


@pytest.mark.parametrize("name", ["town", "hills"])
@pytest.mark.usefixtures("letters")
def test_every_view_keeps_the_guidelines_with_relief(tmp_path: Path, name: str) -> None:
    x, y = positions_deg()
    rough = 400 + 30 * np.sin(x / 1.1e-4) * np.cos(y / 0.9e-4) + 40 * np.hypot(x - 7e-4, y - 4e-4) / 5e-4
    heights = slope() if name == "town" else rough.astype(np.float32)
    source = write_geojson(tmp_path / "town.geojson", *town())
    spec = MapSpec(zooms=2, relief=dem(tmp_path / "dem.tif", heights), interval_m=10)
    made = make_map(source, tmp_path / "town.touch", spec)
    assert made.figures["violations"] == 0 and made.figures["zoom_levels"] == 2
    map_of_file, levels_with_relief = stored(tmp_path / "town.touch"), set()
    for n, level in enumerate(map_of_file.record.levels):
        for row in range(level.view_rows):
            for column in range(level.view_columns):
                layout = map_of_file.layout(Position(n, row, column))
                up = contour_owners(layout) & layout.raised
                if up.any():
                    levels_with_relief.add(n)
                    others = np.argwhere(layout.raised & ~contour_owners(layout))
                    away = np.argwhere(up)[:, None] - others[None]
                    gaps_mm = 2.5 * np.hypot(away[..., 0], away[..., 1]) - guidelines()["dot_mm"].value
                    assert gaps_mm.size == 0 or gaps_mm.min() >= guidelines()["gap_mm"].value
    assert levels_with_relief == {0, 1}
    assert any("of the contour lines are left out" in note for note in made.notes)


@pytest.mark.usefixtures("letters")
def test_symbols_and_labels_are_those_of_the_map_without_relief(tmp_path: Path) -> None:
    source = write_geojson(tmp_path / "town.geojson", *town())
    bare = make_map(source, tmp_path / "bare.touch", MapSpec(zooms=1))
    made = make_map(source, tmp_path / "a.touch", MapSpec(zooms=1, relief=dem(tmp_path / "dem.tif")))
    is_relief = contour_owners(made.drawn.layout)
    assert is_relief.any() and made.drawn.labels == bare.drawn.labels
    assert np.array_equal(made.drawn.layout.raised & ~is_relief, bare.drawn.layout.raised)
    assert (bare.drawn.layout.owner[is_relief] == FREE).all()


@pytest.mark.usefixtures("letters")
def test_the_legend_states_the_interval_in_the_report_and_in_every_view(tmp_path: Path) -> None:
    source = plain(tmp_path / "a.geojson")
    spec = MapSpec(language="de", zooms=2, relief=dem(tmp_path / "dem.tif"), interval_m=12.5)
    made = make_map(source, tmp_path / "a.touch", spec)
    assert {"shows": RELIEF, "text": "Höhenlinie, alle 12.5 m"} in made.figures["legend"]
    map_of_file = stored(tmp_path / "a.touch")
    titles = {kind.name: kind for kind in map_of_file.record.kinds}
    assert titles[RELIEF].title == "Höhenlinie, alle 12.5 m"
    assert tuple(titles[RELIEF].cells) == LetterBraille().cells("Höhenlinie, alle 12.5 m")
    for page, shown in zip(map_of_file.legend(map_of_file.start), made.pages, strict=True):
        assert np.array_equal(page, shown)
    assert "425 m (Höhenlinie, alle 12.5 m)" in map_of_file.describe(map_of_file.start)
    assert [map_of_file.record.names[place.name].text for place in map_of_file.record.places] == [
        "North Road",
        "South Road",
    ]


def test_a_lake_has_a_shore_and_no_noise(tmp_path: Path) -> None:
    """A lake at the height of a contour line: means of 400 differ from it in their last bit."""
    x, y = positions_deg()
    radius_deg = np.hypot(x - 7.5e-4, y - 5e-4)
    heights = 400 + np.maximum(radius_deg - 3e-4, 0) * 1e5
    spec = MapSpec(has_labels=False, zooms=1, relief=dem(tmp_path / "dem.tif", heights), interval_m=20)
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec)
    (n,) = (n for n, named in enumerate(made.drawn.named) if named == (RELIEF, "400 m"))
    rows, columns = np.nonzero(made.drawn.name_at == n)
    radius_pins = np.hypot(columns - 29.5, rows - 19.5)
    assert len(rows) > 50 and np.abs(radius_pins - 3e-4 / (0.0015 / 59)).max() < 2


# -- what is reported --------------------------------------------------------------------------------------
def test_areas_without_data_have_no_lines_and_are_reported(tmp_path: Path) -> None:
    x, _ = positions_deg()
    heights = slope()
    heights[x > 0.00075] = -9999
    tags = (WGS84, (42113, "-9999"))
    spec = MapSpec(has_labels=False, zooms=1, relief=dem(tmp_path / "dem.tif", heights, *tags))
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec, stl=tmp_path / "a.stl")
    _, columns = np.nonzero(contour_owners(made.drawn.layout))
    assert len(columns) > 20 and columns.max() <= 30
    assert made.figures["relief"]["known_fraction"] == pytest.approx(0.5, abs=0.02)
    assert any(
        re.match(r"The relief is unknown under 50 % .* level with its edge", note) for note in made.notes
    )


def test_flat_land_is_reported(tmp_path: Path) -> None:
    spec = MapSpec(has_labels=False, relief=dem(tmp_path / "dem.tif", slope(400.2, 400.7)))
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec)
    assert not contour_owners(made.drawn.layout).any()
    assert any(re.match(r"No contour line: heights of 400\.\d+ to 400\.\d+ m, an", n) for n in made.notes)


def run(*words: object) -> int:
    return _exit_code([str(word) for word in words])


def projected(path: Path) -> Path:
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 25832)
    tie = (33922, (0.0, 0.0, 0.0, 5e5, 4.2e6, 0.0))
    return geotiff(path, slope(), (33550, (10.0, 10.0, 0.0)), tie, (34735, keys))


def other_datum(path: Path) -> Path:
    return dem(path, None, (34735, (1, 1, 0, 3, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4314)))


def elsewhere(path: Path) -> Path:
    return geotiff(path, slope(), SCALE, (33922, (0.0, 0.0, 0.0, 10.0, 48.0, 0.0)), WGS84)


def without_positions(path: Path) -> Path:
    return geotiff(path, slope())


def unknown(path: Path) -> Path:
    return dem(path, np.full((SAMPLES,) * 2, np.nan, np.float32))


def cut(path: Path) -> Path:
    data = dem(path).read_bytes()
    path.write_bytes(data[: len(data) // 2])
    return path


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (projected, r"a projected system \(EPSG:25832\); expected degrees .*gdalwarp -t_srs EPSG:4326 dem"),
        (other_datum, r"degrees of another system \(EPSG:4314\); expected degrees"),
        (elsewhere, r"heights of 10,47\.99\d*,10\.00\d*,48 .*expected heights beneath the map, -?[\de.-]+,"),
        (without_positions, "heights without positions"),
        (unknown, "no known height"),
        (cut, "a TIFF"),
        (lambda path: path, "No such file|found no"),
    ],
)
def test_relief_that_cannot_be_used_is_one_error_without_a_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], make: Any, message: str
) -> None:
    source, heights = plain(tmp_path / "a.geojson"), make(tmp_path / "dem.tif")
    before = sorted(path.name for path in tmp_path.iterdir())
    assert run("map", source, tmp_path / "a.touch", "--no-labels", "--relief", heights) in (1, 2)
    error = capsys.readouterr().err
    assert re.search(message, error) and error.count("\n") == 1 and "dem.tif" in error
    assert sorted(path.name for path in tmp_path.iterdir()) == before


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--interval-m", "5"], "--interval-m: found 5 m without a relief"),
        (["--relief", "{dem}", "--interval-m", "0.01"], r"--interval-m: found 0.01 m for heights of 40"),
        (["--relief", "{dem}", "--interval-m", "nan"], "--interval-m: found nan m"),
        (["--relief", "{dem}", "--svg", "{dem}"], "dem.tif"),
    ],
)
def test_options_of_relief_are_checked(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    heights = dem(tmp_path / "dem.tif")
    options = [word.replace("{dem}", str(heights)) for word in words]
    assert run("map", plain(tmp_path / "a.geojson"), tmp_path / "a.touch", "--no-labels", *options) == 2
    error = capsys.readouterr().err
    assert re.search(message, error) and error.count("\n") == 1
    assert not (tmp_path / "a.touch").exists()


def test_a_drawing_has_no_relief(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("svgelements")
    heights, out = dem(tmp_path / "dem.tif"), tmp_path / "a.touch"
    assert run("map", INPUTS / "triangle.svg", out, "--no-labels", "--relief", heights) == 1
    assert "a drawing, which has no place on the earth" in capsys.readouterr().err


def test_the_command_reports_the_relief(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, heights = plain(tmp_path / "a.geojson"), dem(tmp_path / "dem.tif")
    assert run("map", source, tmp_path / "a.touch", "--no-labels", "--relief", heights, "--json") == 0
    report = json.loads(capsys.readouterr().out)["relief"]
    assert report["interval_m"] == 10 and report["known_fraction"] == 1
    assert report["low_m"] == pytest.approx(400, abs=1) and report["high_m"] == pytest.approx(460, abs=1)


# -- positions and units -----------------------------------------------------------------------------------
def contours_of(tmp_path: Path, relief: Path) -> np.ndarray:
    spec = MapSpec(has_labels=False, zooms=1, relief=relief, interval_m=10)
    return make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec).drawn.layout.raised


def test_rows_from_the_south_feet_and_longitudes_to_360_give_the_same_lines(tmp_path: Path) -> None:
    expected = contours_of(tmp_path, dem(tmp_path / "a.tif"))
    matrix = (CELL_DEG, 0, 0, WEST, 0, CELL_DEG, 0, NORTH - SAMPLES * CELL_DEG, 0, 0, 0, 0, 0, 0, 0, 1)
    keys = (1, 1, 0, 4, 1024, 0, 1, 2, 1025, 0, 1, 1, 2048, 0, 1, 4326, 4099, 0, 1, 9002)
    feet = (slope()[::-1] / 0.3048).astype(np.float64)
    south = geotiff(tmp_path / "b.tif", feet, (34264, tuple(map(float, matrix))), (34735, keys))
    assert np.array_equal(contours_of(tmp_path, south), expected)
    tie = (33922, (0.0, 0.0, 0.0, 360 + WEST, NORTH, 0.0))
    turned = geotiff(tmp_path / "c.tif", slope(), SCALE, tie, WGS84)
    assert np.array_equal(contours_of(tmp_path, turned), expected)


def test_an_ascii_grid_is_a_relief_too(tmp_path: Path) -> None:
    expected = contours_of(tmp_path, dem(tmp_path / "a.tif"))
    head = f"ncols {SAMPLES}\nnrows {SAMPLES}\nxllcorner {WEST}\nyllcorner {NORTH - SAMPLES * CELL_DEG}\n"
    rows = "\n".join(" ".join(f"{value:.9g}" for value in row) for row in slope())
    path = tmp_path / "b.asc"
    path.write_text(f"{head}cellsize {CELL_DEG}\n{rows}\n")
    assert np.array_equal(contours_of(tmp_path, path), expected)


@pytest.mark.usefixtures("letters")
def test_the_sample_of_relief_on_paper_is_a_thin_line(tmp_path: Path) -> None:
    svg, space = tmp_path / "a.svg", "{http://www.w3.org/2000/svg}"
    spec = MapSpec(zooms=1, relief=dem(tmp_path / "dem.tif"))
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec, svg=svg)
    row = 4 * [line.kind for line in made.lines].index(RELIEF)
    groups = ElementTree.parse(svg).getroot().findall(f"{space}g")
    strokes, dots = groups[2:4]  # of the first page of the legend
    width_mm = f"{guidelines()['contour_line_mm'].value:g}"
    thin = strokes.findall(f"{space}g[@stroke-width='{width_mm}']/{space}path")
    assert len(thin) == 8 and all(f" {2.5 * (row + 1):g}L" in path.get("d", "") for path in thin)
    heights = [float(dot.get("cy", "")) for dot in dots if float(dot.get("cx", "")) < 9 * 2.5]
    assert heights and not any(2.5 * row <= height <= 2.5 * (row + 2) for height in heights)


# -- paper, plates and point devices -----------------------------------------------------------------------
def test_swell_paper_has_thin_contour_lines_that_join_no_symbol(tmp_path: Path) -> None:
    svg = tmp_path / "a.svg"
    spec = MapSpec(has_labels=False, zooms=1, relief=dem(tmp_path / "dem.tif"))
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec, svg=svg)
    layout, space = made.drawn.layout, "{http://www.w3.org/2000/svg}"
    width_mm = f"{guidelines()['contour_line_mm'].value:g}"
    thin = ElementTree.parse(svg).getroot().findall(f".//{space}g[@stroke-width='{width_mm}']/{space}path")
    numbers = [list(map(float, re.findall(r"[\d.]+", path.get("d")))) for path in thin]
    ends = np.rint(np.array(numbers).reshape(-1, 2, 2) / 2.5).astype(int)
    owners = layout.owner[ends[..., 1], ends[..., 0]]
    assert len(ends) > 100 and (owners[:, 0] == owners[:, 1]).all()
    assert {layout.symbols[n].kind for n in owners[:, 0]} == {RELIEF}
    circles = ElementTree.parse(svg).getroot().findall(f".//{space}circle")
    assert len(circles) == (layout.raised & ~contour_owners(layout)).sum()


def test_a_plate_rises_with_the_land_and_has_no_contour_lines(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    stl = tmp_path / "a.stl"
    spec = MapSpec(has_labels=False, zooms=1, relief=dem(tmp_path / "dem.tif"))
    made = make_map(plain(tmp_path / "a.geojson"), tmp_path / "a.touch", spec, stl=stl)
    assert contour_owners(made.drawn.layout).any()
    mesh = trimesh.load(stl)
    assert mesh.is_watertight and mesh.volume > 0
    plate_mm, symbol_mm, land_mm = (
        guidelines()[name].value for name in ("plate_mm", "print_height_mm", "print_relief_mm")
    )
    assert mesh.bounds[1, 2] == pytest.approx(plate_mm + symbol_mm + land_mm, abs=0.05)
    top = mesh.vertices[mesh.vertices[:, 2] > 0]
    across = top[np.abs(top[:, 1] - mesh.bounds[1, 1] / 2) < 1]  # between the streets, without a symbol
    fraction = np.clip((across[:, 0] - 10) / (2.5 * 59), 0, 1)
    np.testing.assert_allclose(across[:, 2], plate_mm + land_mm * fraction, atol=0.25)


def test_a_point_device_feels_the_land_beneath_the_symbols(tmp_path: Path) -> None:
    pytest.importorskip("numba")
    source, out = plain(tmp_path / "a.geojson"), tmp_path / "a.touch"
    make_map(source, out, MapSpec("phantom-omni", has_labels=False, relief=dem(tmp_path / "dem.tif")))
    with open_file(out) as stream:
        field = stream.medium[0]
    low, high = (np.array(corner) for corner in field.grid.box_m)
    reach, heights_m = field.grid.axis_m(2), []
    for x in np.linspace(low[0] + 0.02, high[0] - 0.02, 9):
        points = np.stack(np.broadcast_arrays(x, (low[1] + high[1]) / 2, reach), axis=-1)
        felt = np.flatnonzero(np.abs(field.sample_n(points)).max(axis=-1) > 0.05)
        heights_m.append(reach[felt[-1]])
    assert (np.diff(heights_m) >= 0).all()
    expected_m = guidelines()["point_relief_mm"].value / 1000
    assert 0.5 * expected_m < heights_m[-1] - heights_m[0] <= 1.2 * expected_m


# -- the index ---------------------------------------------------------------------------------------------
def test_far_places_of_one_name_have_boxes_of_their_own(tmp_path: Path) -> None:
    source = write_geojson(
        tmp_path / "a.geojson",
        street(0, 0.0001, 0.0004, 0.0001, highway="primary", name="Mill Lane"),
        block(0.0006, 0.0006, 0.0009, 0.0009, leisure="park", name="Park"),
        street(0.0004, 0.0001, 0.0006, 0.0001, highway="primary", name="Mill Lane"),
        street(0.0011, 0.0009, 0.0015, 0.0009, highway="primary", name="Mill Lane"),
        block(0.00091, 0.0006, 0.001, 0.0009, leisure="park", name="Park"),
    )
    make_map(source, tmp_path / "a.touch", MapSpec(has_labels=False, zooms=2))
    found = stored(tmp_path / "a.touch")
    widths_m = {}
    for place in found.record.places:
        widths_m.setdefault(found.record.names[place.name].text, []).append(place.box[2] - place.box[0])
    metre = 111_195
    assert widths_m["Mill Lane"] == pytest.approx([0.0006 * metre, 0.0004 * metre], rel=1e-3)
    assert widths_m["Park"] == pytest.approx([0.0004 * metre], rel=1e-3)
    views = {found.position_of(place) for place in found.find("Mill Lane").places}
    assert len(found.find("Mill Lane").places) == 2 and all(
        any(s.names for s in found.view(v).symbols) for v in views
    )

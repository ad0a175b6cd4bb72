"""The command `map`: what the pins of a display get, the legend, swell paper, plates, and errors."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_makers import INPUTS, LetterBraille, letter_cell, street, town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.devices import device
from touchfield.devices.drivers.registry import steps_of
from touchfield.errors import InvalidArgument
from touchfield.maps import braille
from touchfield.maps.guidelines import guidelines
from touchfield.maps.labels import keys_of
from touchfield.pipeline.array_medium import array_drives
from touchfield.pipeline.decoding import open_file
from touchfield.tasks import map as task
from touchfield.tasks.map import MapSpec, legend_path, make_map


@pytest.fixture
def source(tmp_path: Path) -> Path:
    return write_geojson(tmp_path / "town.geojson", *town())


@pytest.fixture
def letters(monkeypatch: pytest.MonkeyPatch) -> None:
    """Braille without liblouis, which writes these names by the same letters."""
    monkeypatch.setattr(task, "Braille", lambda language: LetterBraille())


def steps(path: Path, display: str) -> Any:
    """Heights of the pins that the driver sends, [rows, columns]."""
    profile = device(display)
    with open_file(path) as stream:
        drives = array_drives(stream, profile).drives(0)
    return steps_of(profile, drives, profile.levels or 36)[0]


@pytest.mark.parametrize("display", ["graphiti", "dotpad", "hyperbraille"])
@pytest.mark.usefixtures("letters")
def test_the_display_gets_the_pins_that_were_checked(source: Path, tmp_path: Path, display: str) -> None:
    out = tmp_path / "town.touch"
    made = make_map(source, out, MapSpec(display))
    highest = (device(display).levels or 36) - 1
    assert np.array_equal(steps(out, display), highest * made.drawn.layout.raised)
    assert made.checked.violations == () and made.figures["violations"] == 0
    assert made.pages
    for n, page in enumerate(made.pages):
        assert np.array_equal(steps(legend_path(out, n + 1), display), highest * page)
    assert [str(file) for file in made.files] == made.figures["files"] and all(
        f.is_file() for f in made.files
    )


@pytest.mark.usefixtures("letters")
def test_a_point_device_feels_the_symbols(source: Path, tmp_path: Path) -> None:
    pytest.importorskip("numba")
    out = tmp_path / "town.touch"
    made = make_map(source, out, MapSpec("phantom-omni"))
    raised = made.drawn.layout.raised
    with open_file(out) as stream:
        field = stream.medium[0]
        low, high = (np.array(corner) for corner in field.grid.box_m)
        z_m = high[2] - 0.25 * (high[2] - low[2])
        reach = field.grid.axis_m(2)
        heights = np.full(raised.shape, -np.inf)
        rows, columns = raised.shape
        middle = (low + high) / 2
        for row, column in np.argwhere(np.ones_like(raised))[::7]:
            x, y = (np.array([column - (columns - 1) / 2, (rows - 1) / 2 - row]) * 0.0025) + middle[:2]
            forces = field.sample_n(np.stack(np.broadcast_arrays(x, y, reach), axis=-1))
            felt = np.flatnonzero(np.abs(forces).max(axis=-1) > 0.05)
            heights[row, column] = reach[felt[-1]] if len(felt) else -np.inf
    known = np.isfinite(heights)
    assert known.sum() > 100 and z_m > low[2]
    assert heights[known & raised].mean() > heights[known & ~raised].mean() + 0.001
    assert any("point device" in note for note in made.notes) == bool(made.pages)


@pytest.mark.usefixtures("letters")
def test_a_plate_is_a_closed_solid_with_the_pins_on_it(source: Path, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    stl = tmp_path / "town.stl"
    made = make_map(source, tmp_path / "town.touch", stl=stl)
    mesh = trimesh.load(stl)
    assert mesh.is_watertight and mesh.is_winding_consistent and mesh.volume > 0
    plate_mm, height_mm = (guidelines()[name].value for name in ("plate_mm", "print_height_mm"))
    rows, columns = made.drawn.layout.raised.shape
    assert mesh.bounds[0].tolist() == [0, 0, 0]
    np.testing.assert_allclose(
        mesh.bounds[1, :2], [2.5 * (columns - 1) + 20, 2.5 * (rows - 1) + 20], atol=0.5
    )
    assert mesh.bounds[1, 2] == pytest.approx(plate_mm + height_mm)
    up = mesh.vertices[mesh.vertices[:, 2] > plate_mm + 0.99 * height_mm]
    row, column = np.argwhere(made.drawn.layout.raised)[0]
    margin_mm = 2.5 / 6 * round(10 / (2.5 / 6))
    at = [margin_mm + 2.5 * column, margin_mm + 2.5 * (rows - 1 - row)]
    assert np.hypot(*(up[:, :2] - at).T).min() < 0.01


def run(*words: object) -> int:
    return _exit_code([str(word) for word in words])


def test_names_without_liblouis_are_an_error_and_leave_no_file(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv(braille.VARIABLE, str(tmp_path / "none.so"))
    braille._library.cache_clear()
    try:
        out, svg = tmp_path / "town.touch", tmp_path / "town.svg"
        assert run("map", source, out, "--svg", svg) == 2
        error = capsys.readouterr().err
        assert "liblouis" in error and "--no-labels" in error and "Traceback" not in error
        assert sorted(path.name for path in tmp_path.iterdir()) == ["town.geojson"]
        assert run("map", source, out, "--no-labels", "--json") == 0
        report = json.loads(capsys.readouterr().out)
        assert report["violations"] == 0 and report["labels"] == 0 and out.is_file()
        assert any("5 names are not shown: --no-labels" in note for note in report["notes"])
    finally:
        braille._library.cache_clear()


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--box", "1,2,3"], "--box: found '1,2,3'"),
        (["--box", "9,9,10,10"], "--box: found nothing in it"),
        (["--device", "tactsuit-x40"], "an array of motors"),
        (["--level", "7"], "no feature that states a floor"),
        (["--svg", "{out}"], "the name of two results"),
        (["--device", "nothing"], "found 'nothing'"),
    ],
)
def test_what_cannot_be_drawn_is_one_error_without_a_file(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    out = tmp_path / "town.touch"
    options = [word.replace("{out}", str(out)) for word in words]
    assert run("map", source, out, "--no-labels", *options) in (1, 2)
    error = capsys.readouterr().err
    assert message in error and error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["town.geojson"]


def test_the_picture_shows_the_pins(source: Path, tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    picture = tmp_path / "town.png"
    assert run("map", source, tmp_path / "town.touch", "--no-labels", "--plot", picture) == 0
    assert picture.stat().st_size > 10_000


# -- Braille -----------------------------------------------------------------------------------------------
def translator(language: str) -> braille.Braille:
    try:
        return braille.Braille(language)
    except InvalidArgument as error:
        pytest.skip(str(error))


@pytest.mark.parametrize("language", ["en", "de", "fr", "es", "it", "nl", "pl", "pt"])
def test_liblouis_writes_the_letters_of_braille(language: str) -> None:
    made = translator(language)
    for text in ("abcdefghij", "klmnopqrst", "uvxyz", "w"):
        assert made.cells(text) == tuple(letter_cell(letter) for letter in text)
    assert not made.unknown


def test_labels_agree_with_liblouis(tmp_path: Path) -> None:
    """The pins of each label on a real map, read back, are the cells that liblouis gives for its text."""
    made = translator("en")
    pytest.importorskip("osmium")
    done = make_map(INPUTS / "crossing.osm.pbf", tmp_path / "a.touch", MapSpec())
    raised, pitch = done.drawn.layout.raised, done.drawn.layout.rules.cell_pins
    assert len(done.drawn.labels) == 3
    for label in done.drawn.labels:
        width = pitch * (len(label.cells) - 1) + 2
        box = raised[label.row : label.row + 3, label.column : label.column + width]
        assert braille.cells_of(box, pitch) == made.cells(label.text)


def test_an_unknown_table_and_dots_7_and_8_are_refused() -> None:
    translator("en")
    with pytest.raises(InvalidArgument, match=r"expected one of en, de"):
        braille.Braille("klingon")
    with pytest.raises(InvalidArgument, match=r"no table nothing\.ctb"):
        braille.Braille("nothing.ctb")
    with pytest.raises(InvalidArgument, match="dots 7 and 8"):
        braille.Braille("en-us-comp8.ctb").cells("A")


def test_letters_that_a_table_lacks_are_reported() -> None:
    made = translator("en")
    assert made.cells("rue 公園") == made.cells("rue ") and made.unknown == {"rue 公園"}


def test_cells_become_pins_and_back() -> None:
    cells = (letter_cell("h"), 0, letter_cell("w"), 63)
    for cell_pins in (3, 4):
        pins = braille.pins_of(cells, cell_pins)
        assert pins.shape == (3, 3 * cell_pins + 2) and braille.cells_of(pins, cell_pins) == cells


def test_keys_recall_their_names_and_differ() -> None:
    assert next(keys_of("Queen Street")) == "qs" and next(keys_of("Ölweg")) == "ol"
    keys = list(keys_of("公園"))
    assert len(keys) == len(set(keys)) == 26**2


def test_a_key_has_a_dot_in_the_lowest_row_while_there_are_such_keys() -> None:
    assert next(keys_of("Bahnhof")) == "bn" and next(keys_of("Bad Hill")) == "bl"
    least = int(guidelines()["key_low_letters"].value)
    for name in ("Bahnhof", "Café Bad", "Ahead", "公園", "Queen Street", "High Field"):
        low = [
            sum(bool(letter_cell(letter) & (1 << 2 | 1 << 5)) for letter in key) >= least
            for key in keys_of(name)
        ]
        assert low == sorted(low, reverse=True) and sum(low) == 26**2 - 10**2


@pytest.mark.usefixtures("letters")
def test_a_name_without_a_letter_in_the_table_gets_no_key(tmp_path: Path) -> None:
    streets = [
        street(0, y, 0.003, y, highway="primary", name=n) for y, n in ((0.0004, "長安街"), (0.001, "Gate"))
    ]
    made = make_map(write_geojson(tmp_path / "a.geojson", *streets), tmp_path / "a.touch")
    assert [label.name for label in made.drawn.labels] == ["Gate"]
    assert made.drawn.unlabelled == ("長安街",)
    assert any("長安街" in note and "No label" in note for note in made.notes)


def test_a_drawing_and_a_plate_have_their_endings(
    source: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for option, wrong, expected in (("--svg", "a.png", ".svg"), ("--stl", "a.txt", ".stl")):
        assert run("map", source, tmp_path / "a.touch", "--no-labels", option, tmp_path / wrong) == 2
        assert expected in capsys.readouterr().err
    assert not list(tmp_path.glob("a.*"))


@pytest.mark.usefixtures("letters")
def test_a_picture_whose_font_lacks_letters_has_one_warning(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("matplotlib")
    source = write_geojson(tmp_path / "長安街.geojson", street(0, 0, 0.003, 0, highway="primary"))
    assert run("map", source, tmp_path / "a.touch", "--no-labels", "--plot", tmp_path / "a.png") == 0
    error = capsys.readouterr().err
    assert error.count("lacks letters") == 1 and "Glyph" not in error

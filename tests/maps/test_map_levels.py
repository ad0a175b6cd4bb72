"""Zoom levels, views and index of a map: what the file has, and what damaged and hostile files do."""

from __future__ import annotations

import io
import sys
import zlib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_makers import INPUTS, LetterBraille, town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.container import TouchReader
from touchfield.container.map_record import (
    ROLES,
    TAG,
    MapKind,
    MapLevel,
    MapName,
    MapPlace,
    TactileMap,
    ViewSymbol,
    decode_map,
    decode_view,
    encode_map,
    encode_view,
)
from touchfield.container.wire import framed
from touchfield.container.writer import with_map
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, UnsupportedVersion
from touchfield.maps import zooms
from touchfield.maps.check import check
from touchfield.maps.features import EARTH_RADIUS_M
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.stored_map import Position, StoredMap
from touchfield.tasks import map as task
from touchfield.tasks.editing import edit
from touchfield.tasks.map import MadeMap, MapSpec, make_map

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "conformance"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[MadeMap, Path]:
    """A map of three levels, labelled without liblouis."""
    folder = tmp_path_factory.mktemp("levels")
    source, out = write_geojson(folder / "town.geojson", *town()), folder / "town.touch"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, "Braille", lambda language: LetterBraille())
        return make_map(source, out, MapSpec(zooms=3)), out


@pytest.fixture
def stored(made: tuple[MadeMap, Path]) -> StoredMap:
    with TouchReader(made[1]) as reader:
        record = reader.read_map()
    assert record is not None
    return StoredMap(record, "town.touch")


def positions(stored: StoredMap) -> list[Position]:
    return [
        Position(n, row, column)
        for n, level in enumerate(stored.record.levels)
        for row in range(level.view_rows)
        for column in range(level.view_columns)
    ]


# -- what the file has -------------------------------------------------------------------------------------
def test_readers_without_the_record_get_the_same_frame(made: tuple[MadeMap, Path], stored: StoredMap) -> None:
    from second import decoder

    data = made[1].read_bytes()
    start = data.index(TAG.encode())
    size = int.from_bytes(data[start + 8 : start + 16], "little") + 20
    with TouchReader(io.BytesIO(data)) as reader:
        assert reader.has_map and reader.segments[-1].offset + reader.segments[-1].length == start
        plain = decoder.read_file(data)
        assert plain is not None
    stripped = data[:start] + data[start + size :]
    tail = bytearray(stripped[-24:])
    tail[0:8] = start.to_bytes(8, "little")
    tail[8:16] = len(stripped).to_bytes(8, "little")
    frame = stripped[-40:-24]
    crc = zlib.crc32(frame + tail[:-4]).to_bytes(4, "little")
    stripped = stripped[:-40] + frame + bytes(tail[:-4]) + crc
    with TouchReader(io.BytesIO(stripped)) as reader:
        assert not reader.has_map and reader.read_map() is None
    assert with_map(stripped, stored.record) == data
    with open_file(made[1]) as stream:
        support = stream.medium[0].support()
    assert len(support.positions) == stored.view(stored.start).raised.sum()


def test_every_view_keeps_the_guidelines_with_whole_labels(
    made: tuple[MadeMap, Path], stored: StoredMap
) -> None:
    assert stored.record.levels[0].view_rows == 1
    assert len(positions(stored)) == len(stored.record.views) == made[0].figures["views"] > 20
    labels = 0
    for position in positions(stored):
        layout = stored.layout(position)
        names = [placed for placed in layout.symbols if placed.role == "label"]
        merged = replace(layout, owner=_whole_symbols(layout))  # names divide a symbol, which is no gap
        assert check(merged).violations == ()
        labels += len(names)
    assert labels > 10 and made[0].figures["violations"] == 0


def _whole_symbols(layout: Any) -> Any:
    """Owners by connected symbols of one class."""
    from scipy import ndimage

    owner, first = np.full_like(layout.owner, -1), {}
    for n, placed in enumerate(layout.symbols):
        key = (placed.kind, placed.role) if placed.role != "label" else (n,)
        first.setdefault(key, []).append(n)
    for indices in first.values():
        parts, count = ndimage.label(np.isin(layout.owner, indices), np.ones((3, 3)))
        for part in range(1, count + 1):
            mask = parts == part
            owner[mask] = layout.owner[mask].min()
    return owner


def test_views_lie_where_the_record_says(stored: StoredMap) -> None:
    """The bus stop is on the pin of its coordinates, on every level that draws it, within a fingertip."""
    place = next(p for p in stored.record.places if stored.record.kinds[p.kind].name == "stop")
    x_y = np.array(place.box[:2])
    degrees = x_y / (EARTH_RADIUS_M * np.radians([np.cos(np.radians(stored.record.origin_deg[1])), 1.0]))
    assert np.allclose(degrees + stored.record.origin_deg, (0.0012, 0.00048), atol=1e-7)
    found = 0
    for position in positions(stored):
        level, view = stored.record.levels[position.level], stored.view(position)
        for n, symbol in enumerate(view.symbols):
            if symbol.role == ROLES.index("point") and stored.record.kinds[symbol.kind].name == "stop":
                row, column = np.argwhere(view.owner == n).mean(axis=0)
                x = level.west + (position.column * level.pan_columns + column) * level.pin_step
                y = level.north - (position.row * level.pan_rows + row) * level.pin_step
                assert max(abs(x - x_y[0]), abs(y - x_y[1])) < 5 * level.pin_step
                found += 1
    assert found >= 3
    steps = [level.pin_step for level in stored.record.levels]
    assert steps[0] / steps[1] == steps[1] / steps[2] == 2


def test_what_lies_under_a_pin_has_its_name(stored: StoredMap) -> None:
    view = stored.view(stored.start)
    names = {
        (stored.record.kinds[s.kind].name, stored.record.names[s.names[0]].text)
        for n, s in enumerate(view.symbols)
        if s.names and s.role != ROLES.index("label") and (view.owner == n).any()
    }
    assert {("road", "High Street"), ("road", "Mill Lane"), ("building", "Town Hall")} <= names
    for n, symbol in enumerate(view.symbols):
        if symbol.role == ROLES.index("line") and symbol.names:
            rows, columns = np.nonzero(view.owner == n)
            is_level = np.ptp(rows) < np.ptp(columns)
            assert is_level == (stored.record.names[symbol.names[0]].text == "High Street")


def test_moves_stop_at_the_edges_and_zoom_about_the_middle(stored: StoredMap) -> None:
    at = stored.start
    assert stored.moved(at, "left") == stored.moved(at, "out") == stored.moved(at, "up") == at
    inner = stored.moved(at, "in")
    assert inner.level == 1 and stored.moved(inner, "out") == at
    level = stored.record.levels[1]
    for move, axis, last in (("right", 2, level.view_columns - 1), ("down", 1, level.view_rows - 1)):
        for _ in range(10):
            inner = stored.moved(inner, move)
        assert inner[axis] == last
    deeper = stored.moved(inner, "in")
    away = np.subtract(stored.middle(deeper), stored.middle(inner))
    assert (np.abs(away) <= np.multiply(level.pin_step, (level.pan_columns, level.pan_rows)) / 2).all()
    assert stored.moved(deeper, "home") == at


def test_names_are_found_without_case_and_accents_and_near_misses_are_told(tmp_path: Path) -> None:
    features = town()
    features[1]["properties"]["name"] = "Möhlenweg"
    source = write_geojson(tmp_path / "town.geojson", *features)
    make_map(source, tmp_path / "town.touch", MapSpec(has_labels=False, zooms=2))
    with TouchReader(tmp_path / "town.touch") as reader:
        record = reader.read_map()
    assert record is not None
    stored = StoredMap(record, "town.touch")
    found = stored.find("mohlenWEG")
    (place,) = found.places
    position = stored.position_of(place)
    shown = [s for s in stored.view(position).symbols if place.name in s.names]
    assert shown and stored.describe_place(place).startswith("Möhlenweg (road)")
    many = stored.find("MIL")
    assert [record.names[p.name].text for p in many.places] == ["Mill"]
    missed = stored.find("Hihg Street")
    assert missed.places == () and "High Street" in missed.near
    with pytest.raises(InvalidArgument, match="a name"):
        stored.find("  ")
    assert stored.legend(stored.start) == ()


def test_the_legend_of_a_view_is_that_of_the_map(made: tuple[MadeMap, Path], stored: StoredMap) -> None:
    pages = stored.legend(stored.start)
    assert len(pages) == len(made[0].pages) > 0
    assert all(np.array_equal(*pair) for pair in zip(pages, made[0].pages))


def test_levels_end_where_all_is_shown_and_where_the_limits_are(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    square = make_map(INPUTS / "floor_plan.geojson", tmp_path / "a.touch", MapSpec(has_labels=False))
    assert square.figures["zoom_levels"] > 1
    source = write_geojson(tmp_path / "one.geojson", town()[0])
    assert make_map(source, tmp_path / "b.touch", MapSpec(has_labels=False)).figures["zoom_levels"] == 1
    assert make_map(source, tmp_path / "b.touch", MapSpec(has_labels=False, zooms=2)).figures["views"] == 4
    monkeypatch.setattr(zooms, "MAX_VIEWS", 4)
    bounded = make_map(INPUTS / "floor_plan.geojson", tmp_path / "a.touch", MapSpec(has_labels=False))
    assert bounded.figures["zoom_levels"] == 1 and any("more than 4 views" in n for n in bounded.notes)
    monkeypatch.setattr(zooms, "MAX_VIEWS", 1000)
    monkeypatch.setattr(zooms, "MAX_FEATURES_DRAWN", 10)
    bounded = make_map(INPUTS / "floor_plan.geojson", tmp_path / "a.touch", MapSpec(has_labels=False))
    assert bounded.figures["zoom_levels"] == 1 and any("--box" in n for n in bounded.notes)
    with pytest.raises(InvalidArgument, match="zooms"):
        MapSpec(zooms=0)


def test_info_lists_the_map(made: tuple[MadeMap, Path], capsys: pytest.CaptureFixture[str]) -> None:
    import json

    assert _exit_code(["info", str(made[1]), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["map"]["named_features"] == {"road": 2, "building": 1, "green": 1, "stop": 1}
    assert answer["map"]["language"] == "en" and len(answer["map_levels"]) == 3
    assert sum(row["new_names"] for row in answer["map_levels"]) + answer["map"]["not_drawn"] == 5
    assert _exit_code(["info", str(made[1])]) == 0
    assert "levels of the map" in capsys.readouterr().out


def test_editing_reports_that_the_levels_are_left_out(made: tuple[MadeMap, Path], tmp_path: Path) -> None:
    written = edit(made[1], tmp_path / "edited.touch", operators=["gain:1"])
    assert "town.touch: the zoom levels and names of the map are left out" in written.notes
    with TouchReader(tmp_path / "edited.touch") as reader:
        assert not reader.has_map
    again = edit(tmp_path / "edited.touch", tmp_path / "again.touch", operators=["gain:1"])
    assert not any("zoom levels" in note for note in again.notes)


# -- damaged and hostile records -----------------------------------------------------------------------------
def smallest(**changes: Any) -> TactileMap:
    """A map of 3 x 3 pins with one road."""
    owner = np.full((3, 3), -1, np.int32)
    owner[1] = 0
    symbol = ViewSymbol(role=0, kind=0, names=(0,), text="", cells=b"")
    level = MapLevel(
        pin_step=1.0, west=0.0, north=0.0, pan_rows=1, pan_columns=1, view_rows=1, view_columns=1
    )
    values: dict[str, Any] = {
        "version": 1, "title": "", "attribution": "", "language": "", "is_drawing": 1,
        "origin_deg": (0.0, 0.0),
        "rows": 3, "columns": 3, "pitch_mm": 2.5, "kinds": (MapKind(name="road", title="road", cells=b""),),
        "names": (MapName(text="A", cells=b""),),
        "places": (MapPlace(name=0, kind=0, first_level=0, box=(0.0, -1.0, 2.0, -1.0)),),
        "levels": (level,), "views": (encode_view((symbol,), owner == 0, owner),),
    }  # fmt: skip
    return TactileMap(**{**values, **changes})


def test_the_smallest_map_is_read_as_it_was_written() -> None:
    value = smallest()
    assert decode_map(encode_map(value), "a") == value
    view = decode_view(value, 0, "a")
    assert view.owner.tolist() == [[-1] * 3, [0] * 3, [-1] * 3] and view.raised.tolist()[1] == [True] * 3


LEVEL = smallest().levels[0]
PLACE = smallest().places[0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"levels": ()}, "no levels"),
        ({"levels": (replace(LEVEL, view_rows=2),)}, "views"),
        ({"rows": 1024, "columns": 1024}, "pins"),
        ({"places": (replace(PLACE, name=1),)}, "name or class"),
        ({"places": (replace(PLACE, kind=1),)}, "name or class"),
        ({"places": (replace(PLACE, first_level=2),)}, "level"),
        ({"places": (replace(PLACE, box=(1.0, 0.0, 0.0, 0.0)),)}, "reversed"),
    ],
)
def test_maps_that_contradict_themselves_are_refused(changes: dict[str, Any], message: str) -> None:
    from touchfield.container.records import Struct

    with pytest.raises(InvalidArgument, match=message):
        encode_map(smallest(**changes))
    with pytest.raises(CorruptFile, match=message):
        decode_map(Struct(TactileMap).encode(smallest(**changes), "map"), "a")


def _body(symbols: int, pins: bytes) -> bytes:
    symbol = b"\0" + b"\0\0" + b"\1\0" + b"\0\0\0\0" + b"\0\0" + b"\0\0\0\0"
    return zlib.compress(symbols.to_bytes(2, "little") + symbols * symbol + pins)


@pytest.mark.parametrize(
    ("view", "message"),
    [
        (b"", "stream|bytes"),
        (b"not zlib", "header"),
        (zlib.compress(bytes(1 << 26)), "more or fewer"),
        (_body(1, bytes(18))[:-3], "more or fewer"),
        (_body(1, bytes(18)) + b"x", "more or fewer"),
        (_body(1, bytes(16)), "bytes of pins"),
        (_body(1, b"\2\0" * 9), "symbol 1"),
        (_body(1, b"\1\0" * 9).replace(b"", b""), None),
    ],
)
def test_views_that_are_none_are_refused(view: bytes, message: str | None) -> None:
    value = smallest(views=(view,))
    assert decode_map(encode_map(value), "a") == value, "views are expanded when they are shown"
    if message is None:
        assert decode_view(value, 0, "a").owner.max() == 0
    else:
        with pytest.raises(CorruptFile, match=message):
            decode_view(value, 0, "a")


def test_symbols_of_names_that_are_not_there_are_refused() -> None:
    owner = np.zeros((3, 3), np.int32)
    for change in ({"names": (1,)}, {"kind": 1}, {"role": 3, "names": ()}):
        symbol = replace(ViewSymbol(role=0, kind=0, names=(0,), text="", cells=b""), **change)
        with pytest.raises(CorruptFile, match=r"symbol|label"):
            decode_view(smallest(views=(encode_view((symbol,), owner == 0, owner),)), 0, "a")


@pytest.mark.parametrize("seed", range(4))
def test_damaged_records_are_errors_and_nothing_else(stored: StoredMap, seed: int) -> None:
    rng, payload = np.random.default_rng(seed), encode_map(stored.record)
    read = 0
    for _ in range(60):
        damaged = bytearray(payload[: int(rng.integers(1, len(payload)))] if seed == 0 else payload)
        for at in rng.integers(0, min(len(damaged), 4000), size=3):
            damaged[at] = int(rng.integers(256))
        try:
            hostile = StoredMap(decode_map(bytes(damaged), "a"), "a")
            for position in positions(hostile)[:3]:
                hostile.describe(position)
            hostile.find("Street")
            read += 1
        except (FormatError, InvalidArgument):
            continue
    assert seed == 0 or read > 0


def test_a_faulty_map_does_not_keep_the_frame_from_being_read(made: tuple[MadeMap, Path]) -> None:
    data = made[1].read_bytes()
    start = data.index(TAG.encode())
    size = int.from_bytes(data[start + 8 : start + 16], "little") + 20
    for payload, error in ((b"\2later", UnsupportedVersion), (b"\1", CorruptFile), (b"", CorruptFile)):
        with TouchReader(
            io.BytesIO(_replaced(data, start, size, framed(TAG, payload, is_required=False)))
        ) as r:
            assert r.has_map and r.read_segment(0)
            with pytest.raises(error):
                r.read_map()
    twice = _replaced(data, start, size, 2 * data[start : start + size])
    with TouchReader(io.BytesIO(twice)) as reader, pytest.raises(CorruptFile, match="second"):
        reader.read_map()


def _replaced(data: bytes, start: int, size: int, record: bytes) -> bytes:
    """The file with another record in place of that of the map."""
    grown = len(record) - size
    end = data[-24:-16], data[-16:-8]
    moved = b"".join((int.from_bytes(value, "little") + grown).to_bytes(8, "little") for value in end)
    tail = data[-40:-24] + moved + data[-8:-4]
    index = data[start + size : -40]
    return data[:start] + record + index + tail + zlib.crc32(tail).to_bytes(4, "little")

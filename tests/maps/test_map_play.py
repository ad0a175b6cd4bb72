"""Playing a map: moves from a list, the keys of the terminal and those of a display, and the names."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from map_makers import LetterBraille, town, write_geojson
from touchfield.cli.main import _exit_code
from touchfield.container import TouchReader
from touchfield.container.map_record import TAG
from touchfield.devices import device
from touchfield.devices.drivers.pins import KEYS
from touchfield.devices.drivers.registry import array_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.pipeline.stored_map import StoredMap
from touchfield.tasks import map as task
from touchfield.tasks.map import MapSpec, make_map
from touchfield.tasks.map_keys import MOVES_OF_KEYS, QUIT, TerminalKeys, moves_of
from touchfield.tasks.map_play import ALL_MOVES, MapWalk, SimulatedDisplay, moves_in, play_map
from touchfield.tasks.play import PlaySpec, play

PIN_DISPLAY = Path(__file__).resolve().parents[2] / "integrations" / "pin_display.py"


@pytest.fixture(scope="module")
def town_map(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("map")
    source, out = write_geojson(folder / "town.geojson", *town()), folder / "town.touch"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(task, "Braille", lambda language: LetterBraille())
        make_map(source, out, MapSpec(zooms=3))
    return out


def walk_of(path: Path) -> MapWalk:
    with TouchReader(path) as reader:
        record = reader.read_map()
    assert record is not None
    return MapWalk(StoredMap(record, path.name))


def test_moves_show_the_views_and_the_pages_of_the_legend(town_map: Path) -> None:
    walk, notes = walk_of(town_map), list[str]()
    driver = SimulatedDisplay(device("graphiti"))
    shown = []
    put = driver.put_drives
    driver.put_drives = lambda drives, *more: (shown.append(drives[0] > 0), put(drives, *more))[1]  # type: ignore[method-assign]
    moves = ("in", "right", "legend", "left", "home", "left")
    figures = play_map(walk, driver, moves, seconds=0, wait_s=1, on_note=notes.append)
    stored, at = walk.stored, walk.stored.start
    expected = [stored.view(at).raised]
    for move in ("in", "right"):
        at = stored.moved(at, move)
        expected.append(stored.view(at).raised)
    expected += [stored.legend(at)[0], stored.view(stored.moved(at, "left")).raised]
    expected += 2 * [stored.view(stored.start).raised]
    assert len(shown) == len(expected) and all(np.array_equal(*pair) for pair in zip(shown, expected))
    assert figures["updates"] == 7 and [step["page"] for step in figures["moves"]] == [0, 0, 1, 0, 0, 0]
    assert notes[0].startswith("level 1 of 3") and "High Street (road)" in notes[0]
    assert "legend, page 1" in notes[3] and notes[-1] == "left: the map ends here"


def test_the_command_plays_a_list_of_moves(town_map: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["play", str(town_map), "--offline", "--find", "town h", "--pans", "in,down", "--json"]
    assert _exit_code(words) == 0
    printed = capsys.readouterr()
    answer = json.loads(printed.out)
    assert [step["move"] for step in answer["moves"]] == ["in", "down"] and answer["profile"] == "graphiti"
    assert "found: Town Hall (building), from level 1" in printed.err


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--find", "Hihg Street"], "Similar names: High Street"),
        (["--pans", "in,over"], "'over'"),
        (["--pans", "in", "--log", "log.csv"], "point device"),
        (["--profile", "hyperbraille"], "as the map"),
        (["--friction", "0.4"], "no forces"),
    ],
)
def test_what_cannot_be_done_is_one_error(
    town_map: Path, options: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _exit_code(["play", str(town_map), "--offline", *options]) in (1, 2)
    printed = capsys.readouterr().err
    assert message in printed and "Traceback" not in printed


def test_displays_and_lists_have_the_same_moves() -> None:
    assert set(ALL_MOVES) == KEYS and set(ALL_MOVES) | {QUIT} == set(MOVES_OF_KEYS.values())


def test_moves_are_checked() -> None:
    assert moves_in(" in, LEFT") == ("in", "left") and moves_in("") == ()
    with pytest.raises(InvalidArgument, match="moves"):
        moves_in("in," * 10_001)


def test_a_stream_without_a_map_has_no_places(town_map: Path) -> None:
    legend = next(town_map.parent.glob("*.legend-1.touch"))
    for spec in (PlaySpec(find="Mill", offline=True), PlaySpec(pans="in", offline=True)):
        with pytest.raises(
            InvalidArgument, match="no zoom levels and no names; expected a map for a pin display"
        ):
            play(legend, spec)


def test_a_map_that_cannot_be_read_is_reported_and_its_frame_is_shown(town_map: Path, tmp_path: Path) -> None:
    data, damaged = town_map.read_bytes(), tmp_path / "damaged.touch"
    start = data.index(TAG.encode())
    size = int.from_bytes(data[start + 8 : start + 16], "little") + 20
    payload = bytearray(data[start : start + size - 4])
    payload[16] = 9  # a later version of the record
    record = bytes(payload) + zlib.crc32(payload).to_bytes(4, "little")
    damaged.write_bytes(data[:start] + record + data[start + size :])
    notes: list[str] = []
    with pin_display() as (name, display):
        spec = PlaySpec(device=name, profile="graphiti", seconds=0.3)
        play(damaged, spec, on_note=notes.append)
    assert any("zoom levels cannot be read" in note for note in notes)
    assert any("1" in heights or "z" in heights for heights in display.shown)
    with pytest.raises(Exception, match="version 9"):
        play(damaged, PlaySpec(find="Mill", offline=True))


# -- the keys of a display ---------------------------------------------------------------------------------
@contextmanager
def pin_display(answer: Any = None) -> Iterator[tuple[str, Any]]:
    """The sample display, over TCP; `answer` replaces its answers to `keys`."""
    spec = spec_from_file_location("pin_display_of_maps", PIN_DISPLAY)
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)

    class Display(module.Display):  # type: ignore[misc, name-defined]
        def __init__(self) -> None:
            self.shown: list[str] = []
            super().__init__(lambda heights, columns: self.shown.append(heights))

        def answer(self, line: bytes) -> str:
            if answer is not None and line.startswith(b"keys"):
                return str(answer(int(line.split()[1])))
            return str(super().answer(line))

    display = Display()
    with socket.create_server(("127.0.0.1", 0)) as server:

        def run() -> None:
            line, _ = server.accept()
            with line:
                module.serve(display, line)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"pins:127.0.0.1:{server.getsockname()[1]}", display
        thread.join(10)
        assert not thread.is_alive()


def heights_of(pins: np.ndarray, levels: int) -> str:
    top = "0123456789abcdefghijklmnopqrstuvwxyz"[levels - 1]
    return "".join(top if up else "0" for up in pins.ravel())


def test_the_keys_of_a_display_pan_and_zoom(town_map: Path) -> None:
    walk = walk_of(town_map)
    profile, stored = device("graphiti"), walk.stored
    with pin_display() as (name, display):
        display.keys += ["in", "left"]
        driver = array_device(name, profile)
        figures = play_map(walk, driver, (), seconds=0.5, wait_s=1, on_note=lambda note: None)
    inner = stored.moved(stored.start, "in")
    views = [stored.start, inner, stored.moved(inner, "left")]
    levels = profile.levels or 36
    expected = [heights_of(stored.view(position).raised, levels) for position in views]
    assert [h for h in display.shown if set(h) != {"0"}] == expected
    assert set(display.shown[-1]) == {"0"}, "the pins are down at the end"
    assert [step["move"] for step in figures["moves"]] == ["in", "left"]


def test_a_display_without_keys_shows_the_map(town_map: Path) -> None:
    asked: list[int] = []

    def refuse(number: int) -> str:
        asked.append(number)
        return "err unknown line"

    with pin_display(refuse) as (name, display):
        driver = array_device(name, device("graphiti"))
        figures = play_map(walk_of(town_map), driver, ("in",), seconds=0.8, wait_s=1, on_note=lambda n: None)
    assert len(asked) == 1 and any("no keys" in note for note in figures["device_notes"])
    assert len([h for h in display.shown if set(h) != {"0"}]) == 2, "and it is kept alive"


@pytest.mark.parametrize("answer", ["ok 1 in", "ok {n} jump", "yes", "ok"])
def test_keys_that_are_none_end_with_one_error(town_map: Path, answer: str) -> None:
    with pin_display(lambda number: answer.format(n=number)) as (name, display):
        driver = array_device(name, device("graphiti"))
        with pytest.raises(DeviceError, match="answer"):
            play_map(walk_of(town_map), driver, ("in",), seconds=5, wait_s=1, on_note=lambda note: None)
    assert set(display.shown[-1]) == {"0"}


# -- the keys of the terminal ------------------------------------------------------------------------------
def test_arrows_come_in_pieces() -> None:
    assert moves_of("\x1b[A\x1bOB+-hlq=") == (("up", "down", "in", "out", "home", "legend", "quit", "in"), "")
    moves, rest = moves_of("x\x1b")
    assert moves == () and moves_of(rest + "[D") == (("left",), "")
    assert moves_of("\x1b[Z+") == (("in",), "")
    assert moves_of("\x1b" * 5)[0] == ()


def test_the_keys_of_the_terminal_pan_and_zoom(town_map: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("termios", reason="no terminals on this platform")
    outer, inner = os.openpty()
    notes: list[str] = []
    with os.fdopen(inner, "r") as terminal:
        monkeypatch.setattr("sys.stdin", terminal)

        def press() -> None:
            deadline_s = time.monotonic() + 10
            while not any("arrow keys" in note for note in notes) and time.monotonic() < deadline_s:
                time.sleep(0.01)
            os.write(outer, b"+\x1b[Cq")

        thread = threading.Thread(target=press, daemon=True)
        thread.start()
        figures = play(town_map, PlaySpec(seconds=20), on_note=notes.append).statistics
        thread.join(10)
    os.close(outer)
    assert [step["move"] for step in figures["moves"]] == ["in", "right"]


def test_a_file_is_no_terminal(tmp_path: Path) -> None:
    (tmp_path / "keys").write_text("+")
    with (tmp_path / "keys").open() as file, TerminalKeys(file) as keys:
        assert not keys.is_available and keys.pressed() == ()

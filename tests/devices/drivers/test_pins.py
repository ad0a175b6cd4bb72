"""Pin displays: a fake parses every line by the grammar, over TCP and over pseudo terminals."""

from __future__ import annotations

import os
import re
import select
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.devices import Device, device
from touchfield.devices.drivers import links, pins
from touchfield.devices.drivers.pins import Pins, checked_line
from touchfield.devices.drivers.registry import array_device, array_kinds, is_array_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.options import address
from touchfield.render.array_player import ArrayPlayer

PAD = device("dotpad")
SMALL = replace(PAD, name="small", lattice=(3, 2, 1), levels=4)


def crc(data: bytes) -> int:
    """CRC-16/CCITT-FALSE, bit by bit."""
    value = 0xFFFF
    for byte in data:
        value ^= byte << 8
        for _ in range(8):
            value = (value << 1 ^ 0x1021 if value & 0x8000 else value << 1) & 0xFFFF
    return value


class Display:
    """A fake display: answers each line and records the frames."""

    def __init__(self, answer: Callable[[int], bytes | None] = lambda number: b"ok %d\n" % number) -> None:
        self.answer = answer
        self.shape: tuple[int, int] | None = None
        self.levels, self.timeout_ms, self.keeps = 0, 0, 0
        self.frames: list[list[list[int]]] = []
        self.faults: list[str] = []
        self.disconnected = threading.Event()

    def take(self, line: bytes) -> bytes | None:
        found = re.fullmatch(rb"(.+) \*([0-9a-f]{4})", line)
        assert found, line
        assert int(found[2], 16) == crc(found[1])
        word, *values = found[1].split(b" ")
        if word == b"size":
            assert not self.frames and len(values) == 4
            rows, columns, self.levels, self.timeout_ms = map(int, values)
            assert 2 <= self.levels <= 36 and self.shape in (None, (rows, columns))
            self.shape = (rows, columns)
            return self.answer(0)
        assert self.shape is not None and int(values[0]) == len(self.frames) + self.keeps + 1
        if word == b"keep":
            assert len(values) == 1
            self.keeps += 1
            return self.answer(len(self.frames) + self.keeps)
        assert word == b"pins" and len(values) == 2
        rows, columns = self.shape
        heights = [int(chr(digit), 36) for digit in values[1]]
        assert (
            values[1] == values[1].lower() and len(heights) == rows * columns and max(heights) < self.levels
        )
        self.frames.append([heights[r * columns : (r + 1) * columns] for r in range(rows)])
        return self.answer(len(self.frames) + self.keeps)

    def serve(self, read: Callable[[], bytes], write: Callable[[bytes], object]) -> None:
        rest = b""
        try:
            while data := read():
                *complete, rest = (rest + data).split(b"\n")
                for line in complete:
                    answer = self.take(line)
                    if answer is not None:
                        write(answer)
        except OSError:
            pass
        except Exception as error:  # checked by the test that started it
            self.faults.append(repr(error))
        finally:
            self.disconnected.set()


@contextmanager
def over_tcp(display: Display) -> Iterator[str]:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def run() -> None:
            line, _ = server.accept()
            with line:
                display.serve(lambda: line.recv(4096), line.sendall)

        thread = threading.Thread(target=run, daemon=True)
        thread.start()
        yield f"pins:127.0.0.1:{server.getsockname()[1]}"
        thread.join(10)
    assert not thread.is_alive() and not display.faults


@contextmanager
def over_serial(display: Display) -> Iterator[str]:
    tty = pytest.importorskip("tty", reason="no pseudo terminals on this platform")
    outer, inner = os.openpty()
    tty.setraw(inner)
    stop = threading.Event()

    def read() -> bytes:
        while not stop.is_set():
            if select.select([outer], [], [], 0.02)[0]:
                return os.read(outer, 4096)
        return b""

    thread = threading.Thread(
        target=display.serve, args=(read, lambda data: os.write(outer, data)), daemon=True
    )
    thread.start()
    try:
        yield f"pins:{os.ttyname(inner)}@9600"
    finally:
        stop.set()
        thread.join(10)
        os.close(outer)
        os.close(inner)
    assert not display.faults


def drives(profile: Device, values: object) -> np.ndarray:
    columns, rows, _ = profile.lattice
    return np.broadcast_to(np.asarray(values, np.float32), (1, rows, columns))


@pytest.mark.parametrize("over", [over_tcp, over_serial])
def test_heights_by_rows_and_lowered_at_the_end(over: Callable[[Display], object]) -> None:
    with over(display := Display()) as device_text:
        pad = array_device(device_text, SMALL)
        pad.open()
        pad.put_drives(drives(SMALL, [[0, 0.3, 0.5], [0.8, 0.84, 1]]), None, 0.1)
        # no pin changes: nothing is sent
        pad.put_drives(drives(SMALL, [[0, 0.3, 0.5], [0.8, 0.84, 1]]), None, 0.1)
        pad.put_drives(drives(SMALL, 0.1), np.full((1, 2, 3), 80, np.float32), 0.1)
        pad.put_drives(drives(SMALL, 1.0), None, 0.1)
        pad.close()
        pad.close()
    assert display.shape == (2, 3) and display.levels == 4 and display.timeout_ms == 1000
    assert display.frames == [[[0, 1, 2], [2, 3, 3]], [[0] * 3] * 2, [[3] * 3] * 2, [[0] * 3] * 2]


def test_frame_is_sent_again_after_a_refusal() -> None:
    with over_tcp(
        display := Display(lambda number: b"err busy\n" if number == 2 else b"ok %d\n" % number)
    ) as device_text:
        pad = array_device(device_text, SMALL)
        pad.open()
        pad.put_drives(drives(SMALL, 1.0), None, 0.1)
        with pytest.raises(DeviceError, match="busy"):
            pad.put_drives(drives(SMALL, 0.0), None, 0.1)
        pad.put_drives(drives(SMALL, 1.0), None, 0.1)
        pad.close()
    assert [rows[0][0] for rows in display.frames] == [3, 0, 3, 0]


def test_reopened_display_gets_the_whole_frame() -> None:
    sent: list[bytes] = []

    class RecordingLine:
        def write(self, data: bytes) -> None:
            sent.append(data.partition(b" *")[0])

        def read_line(self, deadline_s: float, most_bytes: int) -> bytes:
            word, number, *_ = sent[-1].split()
            return b"ok " + (b"0" if word == b"size" else number)

        def close(self) -> None:
            pass

    pad = Pins(SMALL, "told", RecordingLine)
    for _ in range(2):
        pad.open()
        pad.put_drives(np.zeros((1, 2, 3), np.float32), None, 0.05)
        pad.close()
    assert sent == [b"size 2 3 4 1000", b"pins 1 000000"] * 2


def test_profile_is_taken_from_the_stream() -> None:
    graphiti, vest = device("graphiti"), device("tactsuit-pro")
    for device_text, stream_profile, expected in (
        ("pins:127.0.0.1:9", graphiti, "graphiti"), ("pins:127.0.0.1:9", vest, "dotpad"),
        ("pins:127.0.0.1:9", device("phantom-omni"), "dotpad"), ("osc:127.0.0.1:9", vest, "tactsuit-pro"),
        ("osc:127.0.0.1:9", graphiti, "tactile-vest-8x8"), ("bhaptics:127.0.0.1:9", vest, "tactsuit-x40"),
    ):  # fmt: skip
        assert array_device(device_text, stream_profile=stream_profile).profile.name == expected
    assert array_device("pins:127.0.0.1:9", device("hyperbraille"), graphiti).profile.name == "hyperbraille"


def test_displays_from_profiles() -> None:
    for profile, levels in (
        (PAD, 2),
        (device("graphiti"), 36),
        (device("hyperbraille"), 2),
        (device("tshirt-32x32"), 36),
    ):
        with over_tcp(display := Display()) as device_text:
            pad = array_device(device_text, profile)
            pad.open()
            pad.put_drives(drives(profile, 0.75), None, 0.1)
            pad.close()
        columns, rows, _ = profile.lattice
        assert (display.shape, display.levels) == ((rows, columns), levels)
        assert display.frames == [[[int(0.75 * (levels - 1) + 0.5)] * columns] * rows, [[0] * columns] * rows]


def test_board_that_starts_when_its_port_is_opened() -> None:
    sizes: list[bytes | None] = [None, b"ok 0\nok 0\n"]
    with over_tcp(
        display := Display(lambda number: b"ok %d\n" % number if number else sizes.pop(0))
    ) as device_text:
        pad = array_device(device_text, SMALL)
        pad._timeout_s = 0.1
        pad.open()
        pad.put_drives(drives(SMALL, 1.0), None, 0.1)
        pad.close()
    assert not sizes and [frame[0][0] for frame in display.frames] == [3, 0]
    sizes = [b"err no such size\n", b"ok 0\n"]  # a display that refuses is not asked again
    with over_tcp(Display(lambda number: b"ok %d\n" % number if number else sizes.pop(0))) as device_text:
        pad = array_device(device_text, SMALL)
        with pytest.raises(DeviceError, match="refuses line 0: no such size"):
            pad.open()
        pad.close()
    assert len(sizes) == 1


def test_lines_of_the_documentation_have_valid_checksums() -> None:
    found = re.findall(r"^    ((?:size|pins|keep) \d.*) \*([0-9a-f]{4})$", pins.__doc__ or "", re.MULTILINE)
    assert len(found) == 3
    for line, total in found:
        assert crc(line.encode()) == int(total, 16)
        assert checked_line(line.encode()) == f"{line} *{total}\n".encode()


@given(
    st.integers(1, 9),
    st.integers(1, 9),
    st.none() | st.integers(2, 100),
    st.lists(st.floats(width=32), min_size=1),
)
def test_lines_follow_the_grammar_for_any_drives(
    columns: int, rows: int, levels: int | None, values: list[float]
) -> None:
    class DisplayLine(links.Line):
        def __init__(self) -> None:
            pass

        def write(self, data: bytes) -> None:
            assert data.endswith(b"\n") and data.count(b"\n") == 1
            self.waiting = display.take(data[:-1])

        def _read(self, seconds: float) -> bytes:
            return self.waiting or b""

        def close(self) -> None:
            pass

    display, profile = Display(), replace(PAD, lattice=(columns, rows, 1), levels=levels)
    pad = Pins(profile, "told", DisplayLine)
    pad.open()
    pad.put_drives(np.resize(np.array(values, np.float32), (1, rows, columns)), None, 0.1)
    pad.close()
    assert display.frames[-1] == [[0] * columns] * rows and len(display.frames) <= 2


WRONG = {
    "another number": (b"ok 2\n", r"found the answer 'ok 2'; expected ok 1"),
    "no number": (b"ok\n", r"found the answer 'ok'"),
    "an empty line": (b"\n", r"found the answer ''"),
    "err": (
        b"err pin 3 is \x07stuck\xff\r\n",
        r"found that it refuses line 1: pin 3 is \?stuck\?; expected ok 1",
    ),
    "no line": (b"\x00\xff" * 3000, r"found the answer '[?]{80}'"),
    "silence": (None, r"found no answer within 0.2 s; expected ok 1\. Check that it is on"),
}


@pytest.mark.parametrize("case", WRONG)
def test_invalid_late_or_missing_answers_are_errors(case: str) -> None:
    answer, message = WRONG[case]
    with over_tcp(Display(lambda number: answer if number == 1 else b"ok %d\n" % number)) as device_text:
        pad = array_device(device_text, SMALL)
        pad._timeout_s = 0.2
        pad.open()
        with pytest.raises(DeviceError, match=f"^pins:127.0.0.1:[0-9]+: {message}"):
            pad.put_drives(drives(SMALL, 1.0), None, 0.1)
        pad.close()


def test_disconnecting_display_ends_the_playback_with_one_line() -> None:
    class Frames:
        frame_count, rate_hz = 1000, 100.0

        def drives(self, frame: int) -> np.ndarray:
            return drives(SMALL, frame % 2)

        def frequencies(self, frame: int) -> None:
            return None

    def answer(number: int) -> bytes:
        if number == 3:
            raise OSError  # the fake disconnects
        return b"ok %d\n" % number

    with over_tcp(Display(answer)) as device_text:
        pad = array_device(device_text, SMALL)
        with (
            ArrayPlayer(Frames(), pad, rate_hz=100) as player,
            pytest.raises(DeviceError, match="that it is gone"),
        ):
            player.wait(20)
    with pytest.raises(DeviceError, match="no connection"):
        pad.put_drives(drives(SMALL, 0.0), None, 0.1)


def test_pins_are_lowered_when_playback_ends() -> None:
    class Frames:
        frame_count, rate_hz = 5, 100.0

        def drives(self, frame: int) -> np.ndarray:
            return drives(SMALL, (frame + 1) / 5)

        def frequencies(self, frame: int) -> None:
            return None

    with (
        over_tcp(display := Display()) as device_text,
        ArrayPlayer(Frames(), array_device(device_text, SMALL)) as player,
    ):
        assert player.wait(20)
    assert len(display.frames) >= 2 and display.frames[-1] == [[0] * 3] * 2


def test_missing_displays_are_errors() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    pad = array_device(f"pins:127.0.0.1:{port}")
    with pytest.raises(
        DeviceError, match=rf"^pins:127.0.0.1:{port}: found no connection .*Check that it is on"
    ):
        pad.open()
    pad.close()
    for port in ("/dev/no-such-port", "/dev/no-such-port:1"):  # a path with a colon is no host
        with pytest.raises(DeviceError, match=rf"^pins:{port}: found that it cannot be opened"):
            array_device(f"pins:{port}").open()


def test_invalid_device_texts_are_refused() -> None:
    assert [kind.name for kind in array_kinds()] == ["bhaptics", "osc", "pins"]
    assert is_array_device("osc:anything") and is_array_device("pins") and not is_array_device("sim")
    assert is_array_device(" BHaptics:vest") and isinstance(array_device(" Pins:/dev/none", SMALL), Pins)
    with pytest.raises(
        InvalidArgument, match=r"bhaptics\[:HOST:PORT\], osc:HOST:PORT, pins:.*Did you mean bhaptics"
    ):
        array_device("bhaptic:1")
    with pytest.raises(InvalidArgument, match=r"^--device: found 'vest'; expected sim.*bhaptics.*PORT$"):
        array_device("vest")
    with pytest.raises(InvalidArgument, match="phantom-omni, a point"):
        array_device("osc:localhost:9000", device("phantom-omni"))
    with pytest.raises(InvalidArgument, match="one panel"):
        array_device("pins:/dev/ttyUSB0", device("tactsuit-x40"))
    for text in (
        "pins",
        "pins:",
        "pins:/dev/x@",
        "pins:/dev/x@0",
        "pins:/dev/x@fast",
        "pins:host:70000",
        "pins:\x07",
    ):
        with pytest.raises(InvalidArgument, match="pins:PORT"):
            array_device(text)
    for kind in array_kinds():
        assert device(kind.profile).is_array and kind.form.startswith(kind.name) and kind.summary


@given(st.text(max_size=30))
def test_any_text_is_a_device_or_a_one_line_error(text: str) -> None:
    for form in ("{}", "bhaptics:{}", "osc:{}", "pins:{}"):
        message = ""
        try:
            array_device(form.format(text))
        except InvalidArgument as error:
            message = str(error)
        assert "\n" not in message


def test_addresses() -> None:
    assert address("", "x", ("localhost", 1)) == ("localhost", 1)
    assert address("[fe80::1]:80", "x") == ("fe80::1", 80) and address("host:65535", "x") == ("host", 65535)


@pytest.mark.parametrize(
    ("text", "expected"), [("/dev/x", ("/dev/x", 115200)), ("/dev/x@9600", ("/dev/x", 9600))]
)
def test_default_rate_of_a_serial_port(
    text: str, expected: tuple[str, int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pins, "SerialLine", lambda *given: pytest.fail(f"{given[:2]}"))
    with pytest.raises(pytest.fail.Exception) as caught:
        array_device(f"pins:{text}", SMALL).open()
    assert str(caught.value) == f"{expected}"


def test_checks_list_the_ports(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pins, "serial_ports", list)
    library, port = pins.checks()
    assert library.is_there and not port.is_there and "Plug it in" in port.mend
    monkeypatch.setattr(pins, "serial_ports", lambda: ["/dev/ttyUSB0"])
    assert pins.checks()[1].found == "/dev/ttyUSB0"

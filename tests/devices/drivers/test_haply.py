"""The Inverse3 over loopback: exact forces, and one-line errors for every faulty message."""

from __future__ import annotations

import ctypes
import json
import math
import pickle
import socket
import sys
import threading
import time

import pytest
from hypothesis import given, strategies as st

from touchfield.devices.drivers import haply, links
from touchfield.devices.drivers.haply import Haply
from touchfield.devices.drivers.registry import point_device
from touchfield.errors import DeviceError, InvalidArgument, MissingExtra

pytest.importorskip("websockets")

from fake_haply import FakeHaply, fake_haply

STATE = FakeHaply.state(1)


def open_device(fake: FakeHaply, answer_s: float = 5.0) -> Haply:
    device = Haply(("127.0.0.1", fake.port), answer_s)
    device.open()
    return device


def position_after(first=None, answer=None, answer_s: float = 5.0) -> tuple[float, float, float]:
    """The result of one position reading when the service sends these messages."""
    with fake_haply(first=first, answer=answer) as fake:
        device = Haply(("127.0.0.1", fake.port), answer_s)
        try:
            device.open()
            return device.position_m()
        finally:
            device.close()


def test_forces_and_positions_alternate_and_the_last_force_is_zero() -> None:
    with fake_haply() as fake:
        device = open_device(fake)
        positions_m = []
        for n in range(50):
            positions_m.append(device.position_m())
            device.put_force_n(0.1 * n, -1e-9, 2.0)
        device.close()
        device.close()
        assert fake.disconnected.wait(5)
    assert positions_m == [(0.001 * n, -0.02, 0.1) for n in range(1, 51)]
    assert fake.forces == [(0, 0, 0), *((0.1 * n, -1e-9, 2.0) for n in range(50)), (0, 0, 0)]


def test_device_can_be_opened_again() -> None:
    with fake_haply() as fake:
        for _ in range(2):
            device = open_device(fake)
            assert device.position_m() == (0.001, -0.02, 0.1)
            device.close()
        device = open_device(fake)
        fake.disconnected.clear()
        device.open()  # closes the first connection
        assert fake.disconnected.wait(5) and device.position_m() == (0.001, -0.02, 0.1)
        device.close()


def send_limit_s(line: socket.socket) -> float:
    """The send timeout in the system's representation: seconds and microseconds in native byte order."""
    limit = line.getsockopt(socket.SOL_SOCKET, socket.SO_SNDTIMEO, 2 * ctypes.sizeof(ctypes.c_long))
    half = len(limit) // 2
    seconds, microseconds = (int.from_bytes(part, sys.byteorder) for part in (limit[:half], limit[half:]))
    return seconds + microseconds / 1e6


@pytest.mark.skipif(sys.platform == "win32", reason="the option is milliseconds there")
@pytest.mark.parametrize("answer_s", [0.25, 1.5])
def test_send_timeout_is_the_answer_time(answer_s: float) -> None:
    with fake_haply() as fake:
        device = open_device(fake, answer_s)
        assert send_limit_s(device._socket.socket) == pytest.approx(answer_s, abs=0.02)
        device.close()


@pytest.mark.skipif(sys.platform == "win32", reason="the option is milliseconds there")
@pytest.mark.parametrize("answer_s", [0.25, 1.2])
def test_unread_send_ends_in_time(answer_s: float) -> None:
    def send_on(line: socket.socket, flags: int = 0) -> None:
        while True:
            line.send(bytes(1 << 20), flags)

    with (
        socket.create_server(("127.0.0.1", 0)) as server,
        links.connect(server.getsockname(), "deaf", 3.0, "", answer_s) as line,
    ):
        assert send_limit_s(line) == pytest.approx(answer_s, abs=0.02)
        assert line.gettimeout() is None
        with pytest.raises(BlockingIOError):
            send_on(line, socket.MSG_DONTWAIT)  # until the buffers are full
        began = time.monotonic()
        with pytest.raises(BlockingIOError):
            send_on(line)
        assert answer_s - 0.05 <= time.monotonic() - began


def test_latest_of_many_states_is_used() -> None:
    sent = threading.Event()

    def flood(n, connection):
        for k in range(200):
            connection.send(json.dumps(FakeHaply.state(k)))
        sent.set()
        return FakeHaply.state(200)

    with fake_haply(answer=flood) as fake:
        device = open_device(fake)
        assert sent.wait(5)
        time.sleep(0.2)
        readings = 1
        while device.position_m()[0] < 0.2:
            readings += 1
        device.close()
    assert readings < 50


def test_endless_messages_end_the_connection() -> None:
    def endless(n, connection):
        while True:
            connection.send(json.dumps(STATE))

    with fake_haply(answer=endless) as fake:
        device = open_device(fake)
        assert device.position_m() == (0.001, -0.02, 0.1)
        device.close()
        assert fake.disconnected.wait(5)


def without(message: dict, *path: str) -> dict:
    """A copy of a state without one key, given as a path from the device."""
    copy = json.loads(json.dumps(message))
    at = copy["inverse3"][0]
    for key in path[:-1]:
        at = at[key]
    del at[path[-1]]
    return copy


def state_with_x(x) -> str:
    return json.dumps(STATE).replace('"x": 0.001', f'"x": {x}')


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        ("{", "no JSON"),
        ("[" * 20000, "no JSON"),
        (b"\xff\xfe\xfd", "no JSON"),
        ("null", "without device 04BA"),
        ('{"inverse3": 3}', "without device 04BA"),
        ('{"inverse3": [{"device_id": "other"}]}', "without device 04BA"),
        (without(STATE, "state"), "without cursor_position"),
        (without(STATE, "state", "cursor_position"), "without cursor_position"),
        (without(STATE, "state", "cursor_position", "y"), "y = None"),
        (state_with_x("NaN"), "x = nan"),
        (state_with_x("-Infinity"), "x = -inf"),
        (state_with_x("1e400"), "x = inf"),
        (state_with_x("9" * 400), "x = 999"),
        (state_with_x("true"), "x = True"),
        (state_with_x('"0.1"'), "x = '0.1'"),
        (state_with_x("2.5"), "x = 2.5"),
        (" " * links.MAX_MESSAGE_BYTES + "{}", "connection that broke"),
    ],
)
def test_invalid_states_are_one_clear_line(answer, message) -> None:
    with pytest.raises(DeviceError, match=message) as caught:
        position_after(answer=lambda n, _: answer)
    assert "\n" not in str(caught.value) and len(str(caught.value)) < 400


@pytest.mark.parametrize(
    ("first", "message"),
    [
        ("[]", "without inverse3"),
        ("{}", "without inverse3"),
        ('{"inverse3": [1]}', "without inverse3"),
        ('{"inverse3": []}', "no Inverse3"),
        ('{"inverse3": [{}]}', "device_id None"),
        ('{"inverse3": [{"device_id": "' + "a" * 65 + '"}]}', "device_id"),
        ('{"inverse3": [{"device_id": "%r"}]}', "device_id"),
        ("hello", "no JSON"),
    ],
)
def test_first_message_without_a_device_is_an_error(first, message) -> None:
    with fake_haply(first=first) as fake:
        with pytest.raises(DeviceError, match=message):
            Haply(("127.0.0.1", fake.port)).open()
        assert fake.disconnected.wait(5)


NUMBERS = st.integers() | st.floats(allow_nan=True)
CURSORS = st.dictionaries(st.sampled_from("xyz"), NUMBERS | st.none() | st.booleans() | st.text(max_size=5))
STATES = st.dictionaries(st.sampled_from(["cursor_position", "other"]), CURSORS | NUMBERS | st.lists(NUMBERS))


@given(STATES | NUMBERS | st.none() | st.lists(NUMBERS))
def test_any_state_gives_a_position_or_a_device_error(state) -> None:
    device = Haply()
    device._id = "a"
    device._message = lambda seconds: {"inverse3": [{"device_id": "a", "state": state}]}  # type: ignore[method-assign]

    def time_out(seconds: float) -> None:
        raise TimeoutError

    device._receive = time_out  # type: ignore[method-assign]
    try:
        position_m = device.position_m()
    except DeviceError:
        return
    assert all(abs(value) <= 2 for value in position_m)


def test_missing_answer_is_a_device_error() -> None:
    with pytest.raises(DeviceError, match=r"no answer within 0\.05 s"):
        position_after(answer=lambda n, _: None, answer_s=0.05)


def test_disconnection_is_a_device_error_and_close_does_not_raise() -> None:
    with fake_haply(answer=lambda n, connection: connection.close()) as fake:
        device = open_device(fake)
        with pytest.raises(DeviceError, match="connection that broke"):
            device.position_m()
        with pytest.raises(DeviceError, match="connection that broke"):
            device.put_force_n(0.0, 0.0, 0.0)
        device.close()
        with pytest.raises(DeviceError, match="not open"):
            device.put_force_n(0.0, 0.0, 0.0)


def test_missing_service_error_says_how_to_start_it() -> None:
    with socket.socket() as bound:
        bound.bind(("127.0.0.1", 0))  # bound and not listening: refuses
        with pytest.raises(DeviceError, match="Start the Haply Inverse Service"):
            Haply(bound.getsockname()).open()


@pytest.mark.parametrize(
    "answer", [b"", b"HTTP/1.1 200 OK\r\nContent-Length: 2\r\n\r\nhi", b"SSH-2.0-x\r\n" * 9]
)
def test_port_of_another_service_is_an_error(answer) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:

        def serve() -> None:
            with server.accept()[0] as connection:
                connection.recv(4096)
                connection.sendall(answer)

        thread = threading.Thread(target=serve)
        thread.start()
        device = Haply(server.getsockname())
        with pytest.raises(DeviceError, match="no WebSocket"):
            device.open()
        device.close()
        thread.join(5)


def test_forces_that_are_not_finite_are_not_sent() -> None:
    with fake_haply() as fake:
        device = open_device(fake)
        with pytest.raises(DeviceError, match="finite newtons"):
            device.put_force_n(float("nan"), 0.0, 0.0)
        device.close()


def test_missing_library_error_names_the_extra(monkeypatch) -> None:
    monkeypatch.setitem(sys.modules, "websockets.sync.client", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[devices\]"):
        Haply().open()


@pytest.mark.parametrize(
    ("text", "host", "port"),
    [
        ("haply", "127.0.0.1", 10001),
        ("haply:lab-3.local", "lab-3.local", 10001),
        ("haply:10.0.0.7:9000", "10.0.0.7", 9000),
        ("haply:[::1]:9000", "::1", 9000),
        ("haply::9000", "127.0.0.1", 9000),
    ],
)
def test_address_is_parsed_from_the_text(text, host, port) -> None:
    choice = point_device(text)
    device = pickle.loads(pickle.dumps(choice.opener))()
    assert (device._service, choice.profile) == ((host, port), "haply-inverse3")


@pytest.mark.parametrize(
    "text",
    ["haply:9000", "haply:a:0", "haply:a:65536", "haply:a b", "haply:a:b", "haply:a/", "haply:a/b\x07"],
)
def test_invalid_addresses_are_refused(text) -> None:
    with pytest.raises(InvalidArgument, match="haply:HOST:PORT"):
        point_device(text)


def test_checks_name_library_and_service() -> None:
    library, service = haply.checks()
    assert library.is_there and "websockets" in library.what
    assert "10001" in service.what and (service.is_there or service.mend)


def state_with_grip(n: int, **state) -> dict:
    """A state with a grip."""
    default_state = {
        "orientation": {"w": 0.6, "x": 0.0, "y": 0.8, "z": 0.0},
        "buttons": {"a": True, "b": False, "c": True},
    }
    grip = {"device_id": "61576", "state": {**default_state, **state}}
    return {**FakeHaply.state(n), "wireless_verse_grip": [grip]}


def test_grip_has_orientation_buttons_and_loss() -> None:
    def answer(n: int, _: object) -> dict:
        if n == 2:
            wired = {
                "device_id": 3,
                "state": {"orientation": {"w": 1, "x": 0, "y": 0, "z": 0}, "button": True},
            }
            return {**FakeHaply.state(n), "verse_grip": [wired]}
        return state_with_grip(n) if n == 1 else FakeHaply.state(n)

    readings = []
    with fake_haply(answer=answer) as fake:
        device = open_device(fake)
        assert device.orientation() == (1, 0, 0, 0) and device.buttons() == 0
        for _ in range(3):
            device.position_m()
            readings.append((device.orientation(), device.buttons()))
            device.put_wrench(0.0, 0.5, 0.0, 0.1, 0.1, 0.1)  # the device has no motors for the torque
        device.close()
        fake.answer = lambda n, _: FakeHaply.state(n)
        device.open()
        device.position_m()
        readings.append((device.orientation(), device.buttons()))  # a device without a grip, not a lost one
        device.close()
    assert readings[:2] == [((0.6, 0, 0.8, 0), 5), ((1, 0, 0, 0), 1)]
    assert math.isnan(readings[2][0][0]) and readings[2][1] == 0 and readings[3] == ((1, 0, 0, 0), 0)
    assert fake.forces[:5] == [(0, 0, 0), (0, 0.5, 0), (0, 0.5, 0), (0, 0.5, 0), (0, 0, 0)]


@pytest.mark.parametrize(
    "grip",
    [
        {},
        {"state": 3},
        {"state": {"orientation": [1, 0, 0, 0]}},
        {"state": {"orientation": {"w": 1, "x": 0, "y": 0}}},
        {"state": {"orientation": {"w": 7, "x": 0, "y": 0, "z": 0}}},
        {"state": {"orientation": {"w": "1", "x": 0, "y": 0, "z": 0}}},
    ],
)
def test_invalid_grips_are_an_error(grip) -> None:
    with pytest.raises(DeviceError, match="orientation"):
        position_after(answer=lambda n, _: {**FakeHaply.state(n), "wireless_verse_grip": [grip]})

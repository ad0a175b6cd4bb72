"""Arrays over Open Sound Control: every datagram is parsed by an independent library and checked."""

from __future__ import annotations

import socket
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, strategies as st

from osc_listener import Listener, listening
from touchfield.devices import Device, device
from touchfield.devices.drivers import osc
from touchfield.devices.drivers.osc import _FLOATS_PER_MESSAGE, MAX_BYTES, Osc
from touchfield.devices.drivers.registry import array_device
from touchfield.errors import DeviceError, InvalidArgument

VEST, X40 = device("tactile-vest-8x8"), device("tactsuit-x40")


def receive(line: socket.socket, profile: Device, frames: int) -> Listener:
    listener = Listener(profile)
    while len(listener.frames) < frames or listener._parts:
        listener.take(line.recv(1 << 16))
    return listener


def test_frame_is_one_datagram_and_the_end_is_sent_three_times() -> None:
    with listening() as line:
        array = array_device(f"osc:127.0.0.1:{line.getsockname()[1]}", X40)
        array.open()
        drives = np.linspace(0, 1, 40, dtype=np.float32).reshape(2, 5, 4)
        frequencies = np.where(drives > 0.5, np.float32(150), np.float32(0))
        array.put_drives(drives, None, 0.05)
        array.put_drives(drives, frequencies, 0.05)
        array.close()
        array.close()
        listener = receive(line, X40, 5)
        array.open()
        array.close()
        # frames are counted from the opening
        assert [int(f["number"]) for f in receive(line, X40, 3).frames] == [
            0,
            0,
            0,
        ]
    assert len(listener.sizes) == 5 and listener.seconds == sorted(listener.seconds)
    assert [int(f["number"]) for f in listener.frames] == [0, 1, 2, 2, 2]
    assert np.abs(listener.frames[0]["drives"] - drives).max() <= 0.005 + 1e-6  # 101 levels
    assert (
        "frequencies" not in listener.frames[0] and (listener.frames[1]["frequencies"] == frequencies).all()
    )
    assert not any(f["drives"].any() for f in listener.frames[2:])


def test_large_array_is_split_into_datagrams() -> None:
    pad = device("hyperbraille")
    with listening() as line:
        array = Osc(pad, line.getsockname())
        array.open()
        pins = (np.indices((1, 60, 104)).sum(axis=0) % 2).astype(np.float32)
        array.put_drives(pins, None, 0.05)
        listener = receive(line, pad, 1)
        array.close()
    assert (listener.frames[0]["drives"] == pins).all() and len(listener.sizes) == 4


@example(_FLOATS_PER_MESSAGE + 1, 1, 2, None, 0.5, True)  # one actuator starts a new datagram
@given(
    st.integers(1, 70),
    st.integers(1, 70),
    st.integers(1, 3),
    st.none() | st.integers(1, 300),
    st.floats(width=32),
    st.booleans(),
)
def test_any_array_fits_into_its_datagrams(
    columns: int, rows: int, panels: int, levels: int | None, value: float, vibrates: bool
) -> None:
    profile = replace(VEST, lattice=(columns, rows, 1), panels=panels, levels=levels)
    drives = np.full((panels, rows, columns), value, np.float32)
    listener = Listener(profile)
    array = Osc(profile, ("127.0.0.1", 9))

    class FakeLine:
        def send(self, datagram: bytes) -> None:
            listener.take(datagram)

        def close(self) -> None:
            pass

    array._line = FakeLine()
    array.put_drives(drives, drives if vibrates and np.isfinite(value) else None, 0.05)
    received = listener.frames[0]["drives"]
    expected = min(max(value, 0.0), 1.0) if value == value else 0.0
    assert np.abs(received - expected).max() <= (0.5 / max(levels - 1, 0.5) if levels else 0) + 1e-6
    payload_bytes = 5 * drives.size * (1 + (vibrates and np.isfinite(value)))
    # no datagram is unnecessarily half empty
    assert len(listener.sizes) <= payload_bytes // (MAX_BYTES // 2) + 1


def test_missing_listeners_and_invalid_addresses() -> None:
    with listening() as line:
        port = line.getsockname()[1]
    array = Osc(VEST, ("127.0.0.1", port))
    array.open()
    off = np.zeros((1, 8, 8), np.float32)
    message = ""
    for _ in range(100):  # the refusal arrives some time after the first datagram
        try:
            array.put_drives(off, None, 0.05)
        except DeviceError as error:
            message = str(error)
    assert (
        message.startswith(f"osc:127.0.0.1:{port}: found that nothing listens")
        and "Start what listens" in message
    )
    array.close()
    with pytest.raises(DeviceError, match="no connection"):
        array.put_drives(off, None, 0.05)
    with pytest.raises(DeviceError, match="no such host"):
        Osc(VEST, ("no-such-host.invalid", 9000)).open()
    for text in (
        "osc",
        "osc:9000",
        "osc:host:",
        "osc:host:0",
        "osc:host:65536",
        "osc::9000",
        "osc:a b:9",
        "osc:h:+9",
    ):
        with pytest.raises(InvalidArgument, match=r"^osc:HOST:PORT: found"):
            array_device(text)
    assert isinstance(array_device("osc:[::1]:9000"), Osc)


def test_drives_of_another_shape_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"drives of tactile-vest-8x8: found shape \(8, 8\)"):
        Osc(VEST, ("127.0.0.1", 9)).put_drives(np.zeros((8, 8), np.float32), None, 0.05)


def test_checks_need_no_library() -> None:
    assert [c.is_there for c in osc.KIND.checks()] == [True]

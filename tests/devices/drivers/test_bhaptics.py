"""bHaptics vests: a fake Player checks every message, and its failures are one-line errors."""

from __future__ import annotations

import json
import socket
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve

from touchfield.devices import device
from touchfield.devices.drivers import bhaptics
from touchfield.devices.drivers.bhaptics import BHaptics
from touchfield.devices.drivers.registry import array_device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.array_player import ArrayPlayer

X40, PRO = device("tactsuit-x40"), device("tactsuit-pro")


class Player:
    """A fake Player: checks every message against the protocol and answers with its state."""

    def __init__(self, answers: int = 1, closes_after: int | None = None) -> None:
        self.answers, self.closes_after = answers, closes_after
        self.frames: list[dict[str, np.ndarray]] = []
        self.durations_ms: set[int] = set()
        self.faults: list[str] = []
        self.disconnected = threading.Event()
        self.port = 0

    def __call__(self, line: ServerConnection) -> None:
        try:
            path = line.request.path if line.request else ""
            assert path.startswith("/v2/feedbacks?app_id=") and "app_name=" in path, path
            for message in line:
                self.check(message)
                with suppress(ConnectionClosed):  # earlier messages are still checked
                    for _ in range(self.answers):
                        line.send(
                            json.dumps({"RegisteredKeys": [], "ActiveKeys": [], "ConnectedDeviceCount": 1})
                        )
                if self.closes_after is not None and len(self.frames) >= self.closes_after:
                    return
        except ConnectionClosed:
            pass
        except Exception as error:  # checked by the test that started it
            self.faults.append(repr(error))
        finally:
            self.disconnected.set()

    def check(self, message: str | bytes) -> None:
        assert isinstance(message, str)
        root = json.loads(message)
        assert set(root) == {"Submit"}
        intensities = {}
        for command in root["Submit"]:
            assert set(command) == {"Type", "Key", "Frame"} and command["Type"] == "frame"
            frame = command["Frame"]
            assert set(frame) == {"Position", "DotPoints", "PathPoints", "DurationMillis"}
            assert frame["Position"] in ("VestFront", "VestBack") and frame["Position"] not in intensities
            assert command["Key"] == f"touchfield-{frame['Position']}" and frame["PathPoints"] == []
            assert type(frame["DurationMillis"]) is int and 50 <= frame["DurationMillis"] <= 10000
            self.durations_ms.add(frame["DurationMillis"])
            dots = frame["DotPoints"]
            assert [d["Index"] for d in dots] == list(range(20)) and all(
                set(d) == {"Index", "Intensity"} for d in dots
            )
            assert all(type(d["Intensity"]) is int and 0 <= d["Intensity"] <= 100 for d in dots)
            intensities[frame["Position"]] = np.array([d["Intensity"] for d in dots]).reshape(5, 4)
        self.frames.append(intensities)


@contextmanager
def running(player: Player) -> Iterator[Player]:
    # a closing handshake of one second: with the default of ten, it would take most of a test's time
    # an unbounded queue: with a bound, a server of websockets 17 that answers a closed connection hangs
    # ever
    with serve(player, "127.0.0.1", 0, max_queue=None, close_timeout=1) as server:
        player.port = server.socket.getsockname()[1]
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield player
        finally:
            server.shutdown()
            thread.join(10)
    assert not player.faults


def drives(profile: object, **at: float) -> np.ndarray:
    """Zeros except for named actuators: f00=0.5 is front, row 0, column 0."""
    columns, rows, _ = profile.lattice
    values = np.zeros((profile.panels, rows, columns), np.float32)
    for name, value in at.items():
        values["fb".index(name[0]), int(name[1]), int(name[2])] = value
    return values


def test_each_motor_of_an_x40_has_its_dot_and_all_are_off_at_the_end() -> None:
    with running(Player()) as player:
        vest = array_device(f"bhaptics:127.0.0.1:{player.port}")
        assert isinstance(vest, BHaptics) and vest.profile is X40
        vest.open()
        vest.put_drives(drives(X40, f00=0.5, f03=1.0, b40=0.253), None, 0.05)
        vest.close()
        vest.close()
        assert player.disconnected.wait(60)
    first, last = player.frames
    assert first["VestFront"][0].tolist() == [50, 0, 0, 100] and not first["VestFront"][1:].any()
    assert first["VestBack"][4].tolist() == [25, 0, 0, 0] and first["VestBack"].sum() == 25
    assert not last["VestFront"].any() and not last["VestBack"].any()
    assert player.durations_ms == {75, 50}  # one and a half frames


def test_pro_has_16_steps_and_four_rows() -> None:
    with running(Player()) as player:
        vest = array_device(f"bhaptics:127.0.0.1:{player.port}", PRO)
        vest.open()
        for step in range(16):
            vest.put_drives(
                drives(PRO, f00=step / 15 + 0.02, f31=step / 15, b11=step / 15 - 0.02), None, 0.02
            )
        vest.close()
        assert player.disconnected.wait(60)
    for step, frame in enumerate(player.frames[:16]):
        intensity = int(step * 100 / 15 + 0.5)
        assert frame["VestFront"][0, 0] == frame["VestFront"][3, 1] == frame["VestFront"][4, 1] == intensity
        assert frame["VestBack"][1, 1] == intensity and frame["VestBack"].sum() == intensity
    assert player.durations_ms == {50}


def test_an_x16_through_all_20_dots() -> None:
    x16 = device("tactsuit-x16")
    with running(Player(answers=0)) as player:
        vest = BHaptics(x16, ("127.0.0.1", player.port))
        vest.open()
        vest.put_drives(drives(x16, f02=1.0, b10=1.0), None, 1e9)
        vest.close()
        assert player.disconnected.wait(60)
    assert player.frames[0]["VestFront"][:, 2].tolist() == [100, 100, 0, 0, 0]
    assert player.frames[0]["VestBack"][:, 0].tolist() == [0, 0, 100, 100, 100]
    assert player.durations_ms == {500, 50}


@given(
    st.lists(st.floats(width=32), min_size=40, max_size=40), st.sampled_from([X40, replace(X40, levels=None)])
)
def test_intensities_are_bounded_integers(values: list[float], profile: object) -> None:
    class RecordingLine:
        sent, waits = "", 5

        def send(self, text: str) -> None:
            self.sent = text

        def recv(self, timeout: float) -> None:
            if not self.waits:
                raise TimeoutError
            self.waits -= 1

    vest, fake = BHaptics(profile), Player()
    vest._line = line = RecordingLine()
    vest.put_drives(np.array(values, np.float32).reshape(2, 5, 4), None, float("nan"))
    fake.check(line.sent)
    assert not line.waits and fake.durations_ms == {
        500
    }  # all pending messages are read; NaN gives the longest duration
    expected = [0 if not v > 0 else 100 if v >= 1 else int(np.floor(v * 100 + 0.5)) for v in values]
    assert (
        np.concatenate([fake.frames[0]["VestFront"], fake.frames[0]["VestBack"]]).reshape(-1).tolist()
        == expected
    )


def test_a_slow_player_submits_again_before_the_dots_end() -> None:
    class Frames:
        frame_count, rate_hz = 1, 1.0

        def drives(self, frame: int) -> np.ndarray:
            return drives(X40, f00=1.0)

        def frequencies(self, frame: int) -> None:
            return None

    with running(Player()) as player:
        vest = BHaptics(X40, ("127.0.0.1", player.port))
        with ArrayPlayer(Frames(), vest, rate_hz=0.1) as shown:
            shown.wait_started(60)
            time.sleep(1.0)
        assert player.disconnected.wait(60)
    assert 4 <= sum(frame["VestFront"].any() for frame in player.frames) <= 8
    assert max(player.durations_ms) == 500 >= 3e3 * vest.keep_alive_s, "two submissions may be lost"
    assert not player.frames[-1]["VestFront"].any()


def test_excess_messages_of_a_player_are_ignored() -> None:
    with running(Player(answers=200)) as player:
        vest = BHaptics(X40, ("127.0.0.1", player.port))
        vest.open()
        for _ in range(5):
            vest.put_drives(drives(X40, f00=1.0), None, 0.05)
        vest.close()
        assert player.disconnected.wait(60)
    assert len(player.frames) == 6 and not player.frames[-1]["VestFront"].any()


def test_disconnecting_player_ends_the_playback_with_one_line() -> None:
    class Frames:
        frame_count, rate_hz = 1000, 100.0

        def drives(self, frame: int) -> np.ndarray:
            return drives(X40, f00=1.0)

        def frequencies(self, frame: int) -> None:
            return None

    with running(Player(closes_after=3)) as player:
        vest = array_device(f"bhaptics:127.0.0.1:{player.port}")
        with (
            ArrayPlayer(Frames(), vest, rate_hz=100) as playing,
            pytest.raises(
                DeviceError, match=r"^bHaptics Player: found that it is gone .*Start the bHaptics Player"
            ),
        ):
            playing.wait(20)
        with pytest.raises(DeviceError, match="no connection"):
            vest.put_drives(drives(X40), None, 0.05)


def test_missing_or_silent_players_are_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bhaptics, "_TIMEOUT_S", 0.2)
    with socket.create_server(("127.0.0.1", 0)) as silent:
        port = silent.getsockname()[1]
        vest = BHaptics(X40, ("127.0.0.1", port))
        with pytest.raises(
            DeviceError, match=r"^bHaptics Player: found no WebSocket at 127.0.0.1:.*Start the bHaptics"
        ):
            vest.open()
        other, _ = silent.accept()
        other.close()

        def answer() -> None:
            line, _ = silent.accept()
            line.recv(4096)
            line.sendall(b"SSH-2.0-none\r\n\r\n")
            line.close()

        thread = threading.Thread(target=answer)
        thread.start()
        with pytest.raises(DeviceError, match="no WebSocket"):
            vest.open()
        thread.join(10)
    with pytest.raises(DeviceError, match=r"no connection to 127.0.0.1:.* \(.*refused"):
        vest.open()
    vest.close()


def test_unsupported_vests_are_refused() -> None:
    for profile in (
        device("tactile-vest-8x8"),
        device("dotpad"),
        replace(X40, panels=3),
        replace(X40, lattice=(4, 3, 1)),
    ):
        with pytest.raises(InvalidArgument, match=r"bhaptics: found .* expected one or two panels"):
            BHaptics(profile)


def test_checks_report_the_player(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        monkeypatch.setattr(bhaptics, "PLAYER", server.getsockname())
        library, service = bhaptics.checks()
        assert library.is_there and service.is_there and not service.mend
    library, service = bhaptics.checks()
    assert not service.is_there and "Start the bHaptics Player" in service.mend

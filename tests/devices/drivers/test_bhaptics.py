"""bHaptics vests: every message of a fake Player is checked, and a Player that fails is told in one line."""

from __future__ import annotations

import json
import socket
import threading
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
    """A fake Player: holds every message against the protocol and answers with its own state."""

    def __init__(self, answers: int = 1, closes_after: int | None = None) -> None:
        self.answers, self.closes_after = answers, closes_after
        self.frames: list[dict[str, np.ndarray]] = []
        self.lasts_ms: set[int] = set()
        self.faults: list[str] = []
        self.is_gone = threading.Event()
        self.port = 0

    def __call__(self, line: ServerConnection) -> None:
        try:
            path = line.request.path if line.request else ""
            assert path.startswith("/v2/feedbacks?app_id=") and "app_name=" in path, path
            for message in line:
                self.check(message)
                with suppress(ConnectionClosed):  # what came before is still to be checked
                    for _ in range(self.answers):
                        line.send(
                            json.dumps({"RegisteredKeys": [], "ActiveKeys": [], "ConnectedDeviceCount": 1})
                        )
                if self.closes_after is not None and len(self.frames) >= self.closes_after:
                    return
        except ConnectionClosed:
            pass
        except Exception as error:  # told by the test that started it
            self.faults.append(repr(error))
        finally:
            self.is_gone.set()

    def check(self, message: str | bytes) -> None:
        assert isinstance(message, str)
        root = json.loads(message)
        assert set(root) == {"Submit"}
        shown = {}
        for one in root["Submit"]:
            assert set(one) == {"Type", "Key", "Frame"} and one["Type"] == "frame"
            frame = one["Frame"]
            assert set(frame) == {"Position", "DotPoints", "PathPoints", "DurationMillis"}
            assert frame["Position"] in ("VestFront", "VestBack") and frame["Position"] not in shown
            assert one["Key"] == f"touchfield-{frame['Position']}" and frame["PathPoints"] == []
            assert type(frame["DurationMillis"]) is int and 50 <= frame["DurationMillis"] <= 10000
            self.lasts_ms.add(frame["DurationMillis"])
            dots = frame["DotPoints"]
            assert [d["Index"] for d in dots] == list(range(20)) and all(
                set(d) == {"Index", "Intensity"} for d in dots
            )
            assert all(type(d["Intensity"]) is int and 0 <= d["Intensity"] <= 100 for d in dots)
            shown[frame["Position"]] = np.array([d["Intensity"] for d in dots]).reshape(5, 4)
        self.frames.append(shown)


@contextmanager
def running(player: Player) -> Iterator[Player]:
    # a closing handshake of a second: on a busy machine the usual ten would be all that a test waits for
    # no bound of the queue: with one, a server of websockets 17 that answers a line just closed waits for
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
    """Zeros but for what is named, such as f00=0.5: front, row 0, column 0."""
    columns, rows, _ = profile.lattice
    made = np.zeros((profile.panels, rows, columns), np.float32)
    for name, value in at.items():
        made["fb".index(name[0]), int(name[1]), int(name[2])] = value
    return made


def test_each_motor_of_an_x40_at_its_dot_and_all_off_at_the_end() -> None:
    with running(Player()) as player:
        vest = array_device(f"bhaptics:127.0.0.1:{player.port}")
        assert isinstance(vest, BHaptics) and vest.profile is X40
        vest.open()
        vest.put_drives(drives(X40, f00=0.5, f03=1.0, b40=0.253), None, 0.05)
        vest.close()
        vest.close()
        assert player.is_gone.wait(60)
    first, last = player.frames
    assert first["VestFront"][0].tolist() == [50, 0, 0, 100] and not first["VestFront"][1:].any()
    assert first["VestBack"][4].tolist() == [25, 0, 0, 0] and first["VestBack"].sum() == 25
    assert not last["VestFront"].any() and not last["VestBack"].any()
    assert player.lasts_ms == {75, 50}  # half a frame more than it should last


def test_a_pro_has_16_steps_and_four_rows() -> None:
    with running(Player()) as player:
        vest = array_device(f"bhaptics:127.0.0.1:{player.port}", PRO)
        vest.open()
        for step in range(16):
            vest.put_drives(
                drives(PRO, f00=step / 15 + 0.02, f31=step / 15, b11=step / 15 - 0.02), None, 0.02
            )
        vest.close()
        assert player.is_gone.wait(60)
    for step, shown in enumerate(player.frames[:16]):
        intensity = int(step * 100 / 15 + 0.5)
        assert shown["VestFront"][0, 0] == shown["VestFront"][3, 1] == shown["VestFront"][4, 1] == intensity
        assert shown["VestBack"][1, 1] == intensity and shown["VestBack"].sum() == intensity
    assert player.lasts_ms == {50}


def test_an_x16_through_all_20_dots() -> None:
    x16 = device("tactsuit-x16")
    with running(Player(answers=0)) as player:
        vest = BHaptics(x16, ("127.0.0.1", player.port))
        vest.open()
        vest.put_drives(drives(x16, f02=1.0, b10=1.0), None, 1e9)
        vest.close()
        assert player.is_gone.wait(60)
    assert player.frames[0]["VestFront"][:, 2].tolist() == [100, 100, 0, 0, 0]
    assert player.frames[0]["VestBack"][:, 0].tolist() == [0, 0, 100, 100, 100]
    assert player.lasts_ms == {10000, 50}


@given(
    st.lists(st.floats(width=32), min_size=40, max_size=40), st.sampled_from([X40, replace(X40, levels=None)])
)
def test_whatever_the_drives_intensities_are_whole_and_bounded(values: list[float], profile: object) -> None:
    class Told:
        sent, waits = "", 5

        def send(self, text: str) -> None:
            self.sent = text

        def recv(self, timeout: float) -> None:
            if not self.waits:
                raise TimeoutError
            self.waits -= 1

    vest, fake = BHaptics(profile), Player()
    vest._line = told = Told()
    vest.put_drives(np.array(values, np.float32).reshape(2, 5, 4), None, float("nan"))
    fake.check(told.sent)
    assert not told.waits and fake.lasts_ms == {10000}  # all that waits is read; of a time that is no number
    expected = [0 if not v > 0 else 100 if v >= 1 else int(np.floor(v * 100 + 0.5)) for v in values]
    assert (
        np.concatenate([fake.frames[0]["VestFront"], fake.frames[0]["VestBack"]]).reshape(-1).tolist()
        == expected
    )


def test_a_player_that_talks_without_end_is_read_and_left_aside() -> None:
    with running(Player(answers=200)) as player:
        vest = BHaptics(X40, ("127.0.0.1", player.port))
        vest.open()
        for _ in range(5):
            vest.put_drives(drives(X40, f00=1.0), None, 0.05)
        vest.close()
        assert player.is_gone.wait(60)
    assert len(player.frames) == 6 and not player.frames[-1]["VestFront"].any()


def test_a_player_that_goes_ends_the_play_with_one_line() -> None:
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


def test_nobody_listens_or_no_websocket_or_silence(monkeypatch: pytest.MonkeyPatch) -> None:
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


def test_vests_that_the_protocol_does_not_know() -> None:
    for profile in (
        device("tactile-vest-8x8"),
        device("dotpad"),
        replace(X40, panels=3),
        replace(X40, lattice=(4, 3, 1)),
    ):
        with pytest.raises(InvalidArgument, match=r"bhaptics: found .* expected one or two panels"):
            BHaptics(profile)


def test_checks_tell_what_is_there(monkeypatch: pytest.MonkeyPatch) -> None:
    with socket.create_server(("127.0.0.1", 0)) as there:
        monkeypatch.setattr(bhaptics, "PLAYER", there.getsockname())
        library, service = bhaptics.checks()
        assert library.is_there and service.is_there and not service.mend
    library, service = bhaptics.checks()
    assert not service.is_there and "Start the bHaptics Player" in service.mend

"""A fake Haply Inverse Service that checks every message it receives.

As the real one it sends a first message, and then one state for each force.
"""

from __future__ import annotations

import json
import math
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from typing import Any

from websockets.exceptions import ConnectionClosed
from websockets.sync.server import ServerConnection, serve


class FakeHaply:
    """Records received forces and faults, and answers with states."""

    def __init__(
        self, first: Any = None, answer: Callable[[int, ServerConnection], Any] | None = None
    ) -> None:
        self.first = self.state(0) if first is None else first
        self.answer = answer or (lambda n, _: self.state(n))
        self.forces: list[tuple[float, float, float]] = []
        self.faults: list[str] = []
        self.ids: tuple[str, ...] = ("04BA",)
        self.commanded: list[str] = []
        self.port = 0
        self.disconnected = threading.Event()

    @staticmethod
    def state(n: int) -> dict[str, Any]:
        cursor = {"x": 0.001 * n, "y": -0.02, "z": 0.1}
        zero = {"x": 0.0, "y": 0.0, "z": 0.0}
        config = {"config": {"handedness": "right"}} if n == 0 else {}
        state = {"cursor_position": cursor, "cursor_velocity": zero}
        return {
            "session_id": 7,
            "inverse3": [{"device_id": "04BA", **config, "state": state}],
            "verse_grip": [],
        }

    def talk(self, connection: ServerConnection) -> None:
        """Serve one connection until it closes."""
        try:
            self.send(connection, self.first)
            for n, text in enumerate(connection, 1):
                self.check(text)
                self.send(connection, self.answer(n, connection))
        except ConnectionClosed:
            pass
        finally:
            self.disconnected.set()

    @staticmethod
    def send(connection: ServerConnection, message: Any) -> None:
        if message is not None:
            connection.send(message if isinstance(message, (str, bytes)) else json.dumps(message))

    def check(self, text: str | bytes) -> None:
        """A force is one device, one command and three finite numbers, and nothing else."""
        try:
            assert isinstance(text, str), "not text"
            (device,) = json.loads(text).pop("inverse3")
            assert set(json.loads(text)) == {"inverse3"} and set(device) == {"device_id", "commands"}, "keys"
            assert device["device_id"] in self.ids and set(device["commands"]) == {"set_cursor_force"}, (
                "command"
            )
            (values,) = device["commands"]["set_cursor_force"].values()
            assert list(device["commands"]["set_cursor_force"]) == ["values"] and set(values) == set("xyz"), (
                "values"
            )
            assert all(isinstance(v, float) and math.isfinite(v) for v in values.values()), "numbers"
            self.commanded.append(device["device_id"])
            self.forces.append((values["x"], values["y"], values["z"]))
        except Exception as error:
            self.faults.append(f"{error!r} in {text!r}")


@contextmanager
def fake_haply(**options: Any) -> Iterator[FakeHaply]:
    """A fake on its own port for the duration of the block; at its end, no message was invalid."""
    fake = FakeHaply(**options)
    with serve(fake.talk, "127.0.0.1", 0, compression=None) as server:
        fake.port = server.socket.getsockname()[1]
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield fake
        finally:
            server.shutdown()
            thread.join(5)
    assert not fake.faults, fake.faults


class Door:
    """The port of a service: takes settings by HTTP, and passes WebSockets on to a fake.

    A setting appears in the first message of the next connection, unless `is_deaf`. `status` is the answer.
    """

    def __init__(self, fake: FakeHaply, status: int, is_deaf: bool) -> None:
        self.fake, self.status, self.is_deaf = fake, status, is_deaf
        self.posts: list[tuple[str, Any]] = []
        self._socket = socket.create_server(("127.0.0.1", 0))
        self.port = self._socket.getsockname()[1]
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._socket.accept()
            except OSError:  # closed
                return
            threading.Thread(target=self._answer, args=(connection,), daemon=True).start()

    def _answer(self, connection: socket.socket) -> None:
        if connection.recv(4, socket.MSG_PEEK) == b"POST":
            with connection:
                self._take_setting(connection)
            return
        inside = socket.create_connection(("127.0.0.1", self.fake.port))
        threading.Thread(target=_copy, args=(inside, connection), daemon=True).start()
        _copy(connection, inside)

    def _take_setting(self, connection: socket.socket) -> None:
        with connection.makefile("rb") as request:
            path = request.readline().split()[1].decode()
            length = 0
            while line := request.readline().strip():
                name, _, value = line.decode().partition(":")
                length = int(value) if name.lower() == "content-length" else length
            content = json.loads(request.read(length))
        self.posts.append((path, content))
        _, _, unit, _, name = path.split("/")
        for entry in self.fake.first["inverse3"] if not self.is_deaf else ():
            if entry["device_id"] == unit:
                entry.setdefault("config", {})[name] = content.get(name, content)
        connection.sendall(f"HTTP/1.1 {self.status} OK\r\nContent-Length: 0\r\n\r\n".encode())

    def close(self) -> None:
        self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
        self._thread.join(5)


def _copy(source: socket.socket, target: socket.socket) -> None:
    """Copy bytes until one side closes."""
    try:
        while data := source.recv(1 << 16):
            target.sendall(data)
    except OSError:
        pass
    for end in (source, target):
        with suppress(OSError):
            end.shutdown(socket.SHUT_RDWR)


@contextmanager
def fake_haply_with_settings(status: int = 200, is_deaf: bool = False, **options: Any) -> Iterator[Door]:
    """A fake whose port takes settings, too."""
    with fake_haply(**options) as fake:
        door = Door(fake, status, is_deaf)
        try:
            yield door
        finally:
            door.close()

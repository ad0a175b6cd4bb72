"""A fake Haply Inverse Service that checks every message it receives.

As the real one it sends a first message, and then one state for each force.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
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

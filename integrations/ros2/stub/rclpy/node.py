"""As rclpy.node: a node whose clock stands until `turn`."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

__all__ = ["Node"]

PARAMETERS: dict[str, Any] = {}
"""What the launch file or the command line would say."""


class Publisher:
    """Keeps what is published."""

    def __init__(self, kind: type, topic: str) -> None:
        self.kind, self.topic, self.sent = kind, topic, []

    def publish(self, message: Any) -> None:
        """As rclpy's; a message of another type is refused."""
        if type(message) is not self.kind:
            raise TypeError(f"{self.topic}: found {type(message).__name__}, expected {self.kind.__name__}")
        self.sent.append(message)


class Logger:
    """Keeps what is logged."""

    def __init__(self) -> None:
        self.lines: list[str] = []

    def info(self, text: str, **_: Any) -> None:
        """As rclpy's."""
        self.lines.append(text)

    warning = info


class Node:
    """As rclpy's; `turn` lets its clock run, `give` brings it a message."""

    def __init__(self, name: str) -> None:
        self.name, self.now_ns, self.is_destroyed = name, 1_000_000_000, False
        self.publishers: dict[str, Publisher] = {}
        self.heard: dict[str, tuple[type, Callable[[Any], None]]] = {}
        self.timers: list[tuple[int, Callable[[], None]]] = []
        self.logger = Logger()

    def declare_parameter(self, name: str, value: Any) -> SimpleNamespace:
        """As rclpy's; what is given has the type of the value declared."""
        given = PARAMETERS.get(name, value)
        if type(given) is not type(value):
            raise TypeError(f"parameter {name}: found {given!r}, expected {type(value).__name__}")
        return SimpleNamespace(value=given)

    def create_publisher(self, kind: type, topic: str, qos: Any) -> Publisher:
        """As rclpy's."""
        self.publishers[topic] = Publisher(kind, topic)
        return self.publishers[topic]

    def create_subscription(self, kind: type, topic: str, callback: Callable[[Any], None], qos: Any) -> object:
        """As rclpy's."""
        self.heard[topic] = kind, callback
        return object()

    def create_timer(self, period_s: float, callback: Callable[[], None]) -> object:
        """As rclpy's."""
        self.timers.append((round(1e9 * period_s), callback))
        return object()

    def get_clock(self) -> SimpleNamespace:
        """As rclpy's."""
        return SimpleNamespace(now=self._now)

    def get_logger(self) -> Logger:
        """As rclpy's."""
        return self.logger

    def destroy_node(self) -> None:
        """As rclpy's."""
        self.is_destroyed = True

    def _now(self) -> SimpleNamespace:
        at = self.now_ns
        return SimpleNamespace(nanoseconds=at, to_msg=lambda: divmod(at, 1_000_000_000))

    def give(self, topic: str, message: Any) -> None:
        """Bring a message, as a publisher elsewhere would."""
        kind, callback = self.heard[topic]
        assert type(message) is kind
        callback(message)

    def turn(self, seconds: float) -> None:
        """Let the clock run; timers fire at their times."""
        end = self.now_ns + round(1e9 * seconds)
        for period, callback in self.timers:
            for at in range(self.now_ns + period, end + 1, period):
                self.now_ns = at
                callback()
        self.now_ns = end

"""A stand-in for rclpy: just what the node asks of it, with a clock and timers that a test turns by hand."""

from __future__ import annotations

from typing import Any

_is_up = False


def init(args: list[str] | None = None) -> None:
    """As rclpy's."""
    global _is_up
    _is_up = True


def ok() -> bool:
    """As rclpy's."""
    return _is_up


def try_shutdown() -> None:
    """As rclpy's."""
    global _is_up
    _is_up = False


def spin(node: Any) -> None:
    """Let one second of the node's clock go by; then, as if someone pressed Ctrl-C, it ends."""
    node.turn(1.0)
    raise KeyboardInterrupt

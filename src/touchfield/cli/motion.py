"""How `compare` and `encode --report` print what a hand feels: plain figures, and no word on what it cannot feel."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from touchfield.cli.show import show, show_rows

__all__ = ["show_motion"]

_UNSHOWN: Final = ("error_thirds_mn",)


def show_motion(values: Mapping[str, Any], title: str, as_json: bool, notes: tuple[str, ...]) -> None:
    """Print a summary; slides and hold as tables of their own, where they were measured."""
    if as_json or "slides" not in values:
        show(values, title, as_json, notes)
        return
    show({name: value for name, value in values.items() if name not in ("slides", "hold")}, title, False, notes)
    show_rows([_row(slide) for slide in values["slides"]], "a hand that slides at |F| = 1 N, 40 to 400 Hz")
    if values["hold"] is not None:
        show_rows([_row(values["hold"])], "a hand that holds still, frame to frame and 40 to 400 Hz")


def _row(part: Mapping[str, Any]) -> dict[str, Any]:
    return {name: value for name, value in part.items() if name not in _UNSHOWN}

"""Which frame model has which number, loaded when first asked for."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from touchfield.codec.touch.frame_model import FrameModel

__all__ = ["FAST", "LIGHT", "LOSSLESS", "MAX", "frame_model", "guess_provider", "lossless_model"]

FAST, LIGHT, MAX, LOSSLESS = 0, 1, 2, 3

_ROOM: Final = "touchfield.codec.touch"
MODELS: Final[dict[int, tuple[str, str]]] = {
    FAST: (f"{_ROOM}.quick_model", "QuickModel"),
    LIGHT: (f"{_ROOM}.light_model", "LightModel"),
    MAX: (f"{_ROOM}.max_model", "MaxModel"),
    LOSSLESS: (f"{_ROOM}.palette_model", "PaletteModel"),
}
"""Module and class by number."""


def frame_model(number: int) -> FrameModel:
    """The model of a number below 3."""
    model: FrameModel = _made(number)
    return model


def lossless_model() -> Any:
    """The model of mode "lossless", which takes fields and gives fields."""
    return _made(LOSSLESS)


def guess_provider(name: str) -> Any | None:
    """The module "motion" or "surface"; None where there is none."""
    try:
        return import_module(f"{_ROOM}.{name}")
    except ModuleNotFoundError as error:
        if error.name != f"{_ROOM}.{name}":
            raise
        return None


def _made(number: int) -> Any:
    module, attribute = MODELS[number]
    return getattr(import_module(module), attribute)()

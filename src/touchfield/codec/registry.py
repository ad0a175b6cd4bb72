"""Which class decodes the segments of which coder, by the name that a file gives."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final, Protocol

from touchfield.errors import UnsupportedVersion

if TYPE_CHECKING:
    from touchfield.codec.segment import FrameCost, FrameStats
    from touchfield.medium import ForceField, Grid

__all__ = ["FieldDecoder", "coder_names", "decoder_class", "field_decoder"]

_FIELD_CODERS: Final = {
    "paper": ("touchfield.codec.paper", "PaperDecoder"),
    "touch": ("touchfield.codec.touch.decoder", "TouchDecoder"),
}
_CODERS: Final = {**_FIELD_CODERS, "objects": ("touchfield.codec.objects.decoder", "ObjectsDecoder")}


class FieldDecoder(Protocol):
    """What decodes segments whose frames are fields on one lattice."""

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """The frames of a segment, one after another."""

    def costs(self, body: bytes, frame_count: int) -> Sequence[FrameCost]:
        """What each frame of a segment cost, without decoding it."""

    def stats(self, body: bytes, frame_count: int) -> list[FrameStats]:
        """What each frame of a segment cost, and how many samples it holds and sends."""

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""


def coder_names() -> tuple[str, ...]:
    """The coders of this touchfield."""
    return tuple(_CODERS)


def decoder_class(name: str, where: str = "HEAD.coder") -> Any:
    """The class that decodes coder `name`: `PaperDecoder`, `TouchDecoder` or `ObjectsDecoder`.

    Raises
    ------
    UnsupportedVersion
        If there is no such coder; `where` tells which field named it.
    """
    return _loaded(_CODERS, name, where)


def field_decoder(name: str, grid: Grid, parameters: bytes, where: str = "OBJT") -> FieldDecoder:
    """A decoder of the fields of an object, on its own lattice; `where` is its record.

    Raises
    ------
    UnsupportedVersion
        If there is no such coder of fields.
    CorruptFile
        If `parameters` are not those of the coder.
    """
    coder = _loaded(_FIELD_CODERS, name, f"{where} field_coder")
    made: FieldDecoder = coder(grid, parameters, f"{where} field_parameters")
    return made


def _loaded(coders: dict[str, tuple[str, str]], name: str, where: str) -> Any:
    if name not in coders:
        raise UnsupportedVersion(where, repr(name), " or ".join(map(repr, coders)), "A newer touchfield reads it.")
    module, attribute = coders[name]
    return getattr(import_module(module), attribute)

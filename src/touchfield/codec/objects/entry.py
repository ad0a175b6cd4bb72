"""The entry of the coder `objects`, which codes no fields itself."""

from __future__ import annotations

from touchfield.codec.registry import Coder

__all__ = ["CODER"]

_PLACE = "touchfield.codec.objects"

CODER = Coder("objects", f"{_PLACE}.encoder:ObjectsEncoder", f"{_PLACE}.decoder:ObjectsDecoder")

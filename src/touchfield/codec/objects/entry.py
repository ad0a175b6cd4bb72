"""The entry of the coder `objects`, which codes no fields itself."""

from __future__ import annotations

from touchfield.codec.registry import Coder

__all__ = ["CODER"]

CODER = Coder("objects", "touchfield.codec.objects.encoder:ObjectsEncoder", "touchfield.codec.objects:ObjectsDecoder")

"""What the older parts for coder `touch` and for objects share with the second decoder, under their names for it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import decoder as container
from decode_paper import Forces, codebook, decode_segment
from decoder import laid_out
from numpy.typing import NDArray
from reading import Cursor, need
from support import (
    CERTAIN,
    RATES,
    SQUASH,
    STRETCH,
    Coder,
    Models,
    Position,
    Support,
    brick_counts,
    decode_support,
    inside,
    samples_of,
)

__all__ = [
    "CERTAIN", "RATES", "SQUASH", "STRETCH", "Array", "Coder", "Cursor", "Forces", "Models", "Position", "Support",
    "brick_counts", "codebook", "decode_bodies", "decode_segment", "decode_support", "inside", "laid_out", "need",
    "read_file", "samples_of",
]  # fmt: skip

Array = NDArray[Any]


def read_file(data: bytes) -> tuple[dict[str, Any], list[tuple[int, bytes]]]:
    """The head as those parts know it, and frame count and body of every segment."""
    file = container.read_file(data)
    head = {"shape": file.head["grid_shape"], "parameters": file.head["coder_parameters"], **file.head}
    head["objects"] = [r.payload for r in container.read_records(data) if r.tag == "OBJT"]
    return head, [(segment.frame_count, segment.body) for segment in file.segments]


def decode_bodies(data: bytes) -> tuple[dict[str, Any], Iterator[Forces]]:
    """The head of a file of coder `paper` or `touch`, and its frames as sparse bricks."""
    file = container.read_file(data)
    return read_file(data)[0], container.frames_of(file)

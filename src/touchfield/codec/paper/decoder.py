"""The decoder of the paper's coder (figure 4): segments to fields."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.paper.body import BodyReader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.paper.quantisers import amplitudes_n
from touchfield.codec.paper.stages import PARTS, StageReader
from touchfield.codec.segment import FrameCost, FrameKind, FrameStats
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField, Grid


class PaperDecoder:
    """Decodes segments of one stream; needs nothing but the stream.

    `parameters` (`where` in a message) name a direction codebook or a stage, in ASCII, else CorruptFile.
    """

    name = "paper"

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid, self._called = grid, parameters.decode("ascii", "replace")
        if self._called not in PARTS and self._called not in codebook_names():
            raise CorruptFile(where, repr(parameters[:40]), "a direction codebook, or a stage")

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """The frames of a segment in turn; CorruptFile or TruncatedFile for other bytes than the encoder's."""
        for field, _ in self._reader(body).fields(frame_count):
            yield field

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""
        return list(self._reader(body).costs(frame_count))

    def stats(self, body: bytes, frame_count: int) -> list[FrameStats]:
        """Cost of each frame of a segment, and how many samples it holds and sends."""
        return [stats for _, stats in self._reader(body).fields(frame_count)]

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        if self._called in PARTS:
            return {"stage": self._called}
        return {"stage": "none", "directions": self._called, "direction_count": len(Codebook.get(self._called))}

    def quantiser(self, body: bytes) -> Callable[[ForceField], Int64s]:
        """Q of a segment: each supported force to a symbol, by its intra levels and directions, or its step."""
        reader = self._reader(body)
        if isinstance(reader, StageReader):
            return reader.quantise
        levels, codebook = reader.levels(FrameKind.INTRA), Codebook.get(self._called)

        def quantise(field: ForceField) -> Int64s:
            vectors = field.vectors_n()
            return levels.encode(amplitudes_n(vectors)).astype(np.int64) * len(codebook) + codebook.nearest(vectors)

        return quantise

    def _reader(self, body: bytes) -> BodyReader | StageReader:
        if self._called in PARTS:
            return StageReader(body, self._grid, self._called)
        return BodyReader(body, self._grid, Codebook.get(self._called))

"""The paper's coder (section 4.3, figure 4; section 5.2), the baseline for ever.

`PaperEncoder` turns frames into the body of a segment, `PaperDecoder` turns it back; see `PaperSpec` for the
literal and the corrected reading of each part.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.directions import Codebook
from touchfield.codec.paper_encoder import encode_segment
from touchfield.codec.paper_format import BodyReader
from touchfield.codec.paper_frames import DecodedFrame, amplitudes_n
from touchfield.codec.segment import CodedSegment, FrameCost, FrameKind, FrameStats
from touchfield.errors import CorruptFile, InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.paper_spec import PaperSpec
    from touchfield.medium import ForceField, Grid

__all__ = ["PaperDecoder", "PaperEncoder"]

NAME = "paper"


class PaperEncoder:
    """Codes segments of one stream."""

    name = NAME

    def __init__(self, grid: Grid, spec: PaperSpec) -> None:
        self._grid, self._spec = grid, replace(spec, directions=spec.codebook_name())
        Codebook.get(self._spec.directions)

    @property
    def parameters(self) -> bytes:
        """What the decoder must know beside the bodies: the direction codebook's name."""
        return self._spec.directions.encode("ascii")

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code one independent group of frames."""
        return encode_segment(self._grid, frames, self._spec)


class PaperDecoder:
    """Decodes segments of one stream; needs nothing but the stream."""

    name = NAME

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid = grid
        try:
            self._codebook_name = parameters.decode("ascii")
            self._codebook = Codebook.get(self._codebook_name)
        except (UnicodeDecodeError, InvalidArgument):
            raise CorruptFile(where, repr(parameters[:40]), "a direction codebook") from None

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """The frames of a segment, one after another."""
        reader = BodyReader(body, self._grid, self._codebook)
        state: DecodedFrame | None = None
        for symbols, _ in reader.frames(frame_count):
            state = reader.synthesis.rebuild(symbols, reader.amplitude(symbols.kind), state)
            yield state.field(self._grid)

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """What each frame of a segment cost, without decoding it."""
        return list(BodyReader(body, self._grid, self._codebook).costs(frame_count))

    def stats(self, body: bytes, frame_count: int) -> list[FrameStats]:
        """What each frame of a segment cost, and how many samples it holds and sends."""
        reader = BodyReader(body, self._grid, self._codebook)
        return [stats for _, stats in reader.frames(frame_count)]

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {"directions": self._codebook_name, "direction_count": len(self._codebook.vertices)}

    def quantiser(self, body: bytes) -> Callable[[ForceField], NDArray[np.int64]]:
        """Q of a segment: each supported force to a symbol, by the intra tables of the segment."""
        table = BodyReader(body, self._grid, self._codebook).amplitude(FrameKind.INTRA)

        def quantise(field: ForceField) -> NDArray[np.int64]:
            vectors = field.vectors_n()
            levels = table.encode(amplitudes_n(vectors)).astype(np.int64)
            return levels * len(self._codebook.vertices) + self._codebook.nearest(vectors)

        return quantise

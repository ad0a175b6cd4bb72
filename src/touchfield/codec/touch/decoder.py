"""Decoder of coder `touch`: turns the bytes of a segment back into force fields, by the C code in
`touchfield._native`."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from touchfield.codec.segment import FrameCost, MaxError
from touchfield.codec.touch.body import (
    MAX_FRAMES,
    WHERE,
    BodyReader,
    numbers_of,
    read_parameters,
    write_parameters,
)
from touchfield.compute.native import decoding_errors, native
from touchfield.medium import ForceField, Grid

NAME: Final = "touch"


class TouchDecoder:
    """Decoder of the segments of one stream; thread-safe.

    `parameters` are the bytes of the field named by `where`, by default `HEAD.coder_parameters`. CorruptFile
    or UnsupportedVersion if they are invalid.
    """

    name = NAME

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid, self.spec = grid, read_parameters(parameters, where)
        self._parameters = write_parameters(self.spec)

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """Yield the frames of a segment in order.

        CorruptFile or TruncatedFile if the bytes are invalid.
        """
        with decoding_errors(WHERE):
            fields = native.open_fields(self._grid.shape, self._parameters, body, frame_count)
        while True:
            with decoding_errors(WHERE):
                frame = native.next_field(fields)
            if frame is None:
                return
            bricks, forces = frame
            yield ForceField(
                self._grid,
                np.frombuffer(bricks, np.int32).reshape(-1, 3),
                np.frombuffer(forces, np.float32).reshape(-1, 8, 8, 8, 3),
            )

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""
        return [record.cost for record in self._reader(body, frame_count).records(frame_count)]

    def max_error(self, body: bytes) -> MaxError | None:
        """Largest error of a segment, read without decoding.

        None if the segment states none, as in mode "nmse", which has no error bound.
        """
        return self._reader(body).max_error

    def describe(self) -> dict[str, Any]:
        """Parameters of the stream, under stable keys."""
        return {
            name: getattr(self.spec, name) for name in ("mode", "effort", "support", *numbers_of(self.spec))
        }

    def _reader(self, body: bytes, frame_count: int = MAX_FRAMES) -> BodyReader:
        return BodyReader(body, self._grid, exact=self.spec.mode == "lossless", frame_count=frame_count)

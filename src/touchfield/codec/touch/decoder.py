"""Decoder of the coder `touch`: segments to fields, from the stream alone."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from touchfield.codec.segment import FrameCost, MaxError
from touchfield.codec.touch.body import BodyReader, apply_outliers, numbers_of, read_parameters
from touchfield.codec.touch.lattice import FixedField
from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from touchfield.codec.touch.frame import DecodedFrame

NAME: Final = "touch"


class TouchDecoder:
    """Decoder of the segments of one stream; thread-safe.

    `parameters` are the bytes of the field named by `where`, by default `HEAD.coder_parameters`. CorruptFile
    or UnsupportedVersion if they are invalid.
    """

    name = NAME

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid, self.spec = grid, read_parameters(parameters, where)

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """Yield the frames of a segment in order.

        CorruptFile or TruncatedFile if the bytes are invalid.
        """
        from touchfield.codec.touch.base_layer import decode_base_layer
        from touchfield.codec.touch.frame import decode_exact, decode_frame, new_memory

        reader = self._reader(body)
        lattice, memory = reader.lattice, new_memory()
        previous: FixedField | None = None
        decoded: DecodedFrame | None = None
        for record in reader.records(frame_count):
            if lattice is None:
                decoded = decode_exact(record.payload, self._grid, decoded if record.inter else None)
                yield decoded.field
                continue
            if not record.inter:
                memory = new_memory()
            reference = previous if record.inter else None
            if record.base_layer:
                reference = decode_base_layer(record.base_layer, self._grid)
            previous = decode_frame(record.payload, self._grid, lattice, reference, memory)
            field = previous.field(self._grid, lattice.unit_n)
            if record.outliers:
                field = apply_outliers(field, record.outliers)
            yield field

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""
        return [record.cost for record in self._reader(body).records(frame_count)]

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

    def _reader(self, body: bytes) -> BodyReader:
        return BodyReader(body, self._grid, exact=self.spec.mode == "lossless")

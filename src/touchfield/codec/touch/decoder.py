"""The decoder of the coder `touch`: segments to fields; needs nothing but the stream."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, Final

from touchfield.codec.segment import FrameCost, Worst
from touchfield.codec.touch.body import BodyReader, numbers_of, read_parameters, with_exceptions
from touchfield.codec.touch.lattice import FixedField
from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from touchfield.codec.touch.frame import Told

NAME: Final = "touch"


class TouchDecoder:
    """Decodes segments of one stream; any number of threads may use it at once.

    `parameters` are `HEAD.coder_parameters`, or what `where` calls them; CorruptFile or UnsupportedVersion
    for others.
    """

    name = NAME

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid, self.spec = grid, read_parameters(parameters, where)

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """The frames of a segment in turn; CorruptFile or TruncatedFile for other bytes than the encoder's."""
        from touchfield.codec.touch.frame import decode_exact, decode_frame, fresh_memory
        from touchfield.codec.touch.guess import synthesise

        reader = self._reader(body)
        lattice, memory = reader.lattice, fresh_memory()
        previous: FixedField | None = None
        told: Told | None = None
        for record in reader.records(frame_count):
            if lattice is None:
                told = decode_exact(record.payload, self._grid, told if record.inter else None)
                yield told.field
                continue
            if not record.inter:
                memory = fresh_memory()
            reference = previous if record.inter else None
            if record.guess:
                reference = synthesise(record.guess, self._grid)
            previous = decode_frame(record.payload, self._grid, lattice, reference, memory)
            field = previous.field(self._grid, lattice.unit_n)
            if record.exceptions:
                field = with_exceptions(field, record.exceptions)
            yield field

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""
        return [record.cost for record in self._reader(body).records(frame_count)]

    def worst(self, body: bytes) -> Worst | None:
        """Worst voxel of a segment, nothing decoded; None in mode "nmse", which promises nothing."""
        return self._reader(body).worst

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return {
            name: getattr(self.spec, name) for name in ("mode", "effort", "support", *numbers_of(self.spec))
        }

    def _reader(self, body: bytes) -> BodyReader:
        return BodyReader(body, self._grid, exact=self.spec.mode == "lossless")

"""The encoder of the coder `touch`: frames to the body of a segment, which is written only when it keeps its promise.

Each frame is coded in closed loop (`choice`); then the finished body is decoded as any receiver would, every voxel
of every frame is compared with the original, and what is beyond the promise is sent apart.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from touchfield.codec.segment import CodedSegment, FrameStats
from touchfield.codec.touch.body import FrameRecord, GuessKind, shares_of, write_body
from touchfield.codec.touch.choice import Chooser, Chosen
from touchfield.codec.touch.decoder import NAME, TouchDecoder
from touchfield.codec.touch.exceptions import Exceptions
from touchfield.codec.touch.models import LOSSLESS, lossless_model
from touchfield.codec.touch.parameters import write_parameters
from touchfield.codec.touch.promise import Worst, compared
from touchfield.codec.touch.scale import MOST_NEWTONS, lattice_for, rule_for
from touchfield.errors import FormatError, InvalidArgument
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from touchfield.codec.kernels.touch_promise import Compared
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField, Grid

__all__ = ["TouchEncoder"]

_ROUNDS = 4


class TouchEncoder:
    """Codes segments of one stream; any number of threads may use it at once.

    Parameters
    ----------
    grid : Grid
    spec : TouchSpec
    """

    name = NAME

    def __init__(self, grid: Grid, spec: TouchSpec) -> None:
        self._grid, self._spec = grid, spec

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters`: what was asked for."""
        return write_parameters(self._spec)

    def encode_segment(self, frames: Sequence[ForceField]) -> CodedSegment:
        """Code frames, at least one, as an independent segment.

        Raises
        ------
        InvalidArgument
            If a force is NaN, infinite or beyond 2^120 N, or a frame has another grid.
        """
        longest_n = max(self._longest_n(i, frame) for i, frame in enumerate(frames))
        if self._spec.mode == "lossless":
            return self._verified(frames, None, self._lossless(frames), [None] * len(frames))
        lattice = lattice_for(self._spec, longest_n)
        chooser = Chooser(self._grid, self._spec, lattice, rule_for(self._spec))
        chosen = [chooser.add(frame) for frame in frames]
        exceptions = [c.exceptions if len(c.exceptions) else None for c in chosen]
        return self._verified(frames, lattice, [c.record for c in chosen], exceptions, chosen)

    def _longest_n(self, index: int, frame: ForceField) -> float:
        from touchfield.codec.kernels.touch_promise import largest

        if frame.grid != self._grid:
            raise InvalidArgument(
                f"frame {index}", f"a grid of {frame.grid.shape}", f"that of the stream, {self._grid.shape}"
            )
        longest_n = largest(frame.forces_n)
        if math.isinf(longest_n):
            raise InvalidArgument(f"frame {index}", "a force that is NaN or infinite", "finite newtons")
        if longest_n > MOST_NEWTONS:
            raise InvalidArgument(f"frame {index}", f"a force of {longest_n:.3g} N", "2^120 N at most")
        return longest_n

    def _lossless(self, frames: Sequence[ForceField]) -> list[FrameRecord]:
        """The smaller of both ways for each frame: alone, or after the one before."""
        model, records = lossless_model(), []
        asked = self._spec.interframe
        for i, frame in enumerate(frames):
            ways: list[ForceField | None] = [] if i and asked == "on" else [None]
            if i and asked != "off":
                ways.append(frames[i - 1])
            made = []
            for previous in ways:
                payload, bits = model.encode(frame, previous)
                inter = previous is not None
                made.append(FrameRecord(LOSSLESS, inter, GuessKind.NONE, b"", payload, shares_of(bits)))
            records.append(min(made, key=lambda record: len(record.payload)))
        return records

    def _verified(
        self,
        frames: Sequence[ForceField],
        lattice: Lattice | None,
        records: list[FrameRecord],
        exceptions: list[Exceptions | None],
        chosen: Sequence[Chosen] = (),
    ) -> CodedSegment:
        """The body whose decoded frames keep the promise, and the worst voxel."""
        decoder = TouchDecoder(self._grid, self.parameters)
        for turn in range(_ROUNDS):
            body = write_body(lattice, records, None)
            found = []
            for i, made in enumerate(self._decoded(decoder, body, len(frames))):
                if lattice is not None and turn == 0:
                    _check_same(made, chosen[i], self._grid, lattice)
                found.append(compared(frames[i], made, self._spec))
            if not any(len(one.keys) for one in found):
                worst = None if self._spec.mode == "nmse" else self._worst(found)
                return CodedSegment(write_body(lattice, records, worst), _stats(records, [f.decoded for f in found]))
            for i, one in enumerate(found):
                if len(one.keys):
                    exceptions[i] = more = _more(frames[i], exceptions[i], one)
                    records[i] = replace(records[i], exceptions=more.to_bytes())
        raise AssertionError("a voxel that was sent as it is does not keep the promise")

    @staticmethod
    def _decoded(decoder: TouchDecoder, body: bytes, count: int) -> Iterator[ForceField]:
        try:
            yield from decoder.frames(body, count)
        except FormatError as error:
            raise AssertionError("a body that its own decoder refuses") from error

    def _worst(self, found: Sequence[Compared]) -> Worst:
        frame = max(range(len(found)), key=lambda i: found[i].worst)
        one = found[frame]
        if one.worst_key < 0:
            return Worst(0.0, 0, (0, 0, 0))
        brick = np.unravel_index(one.worst_key, self._grid.brick_shape)
        local = np.unravel_index(one.worst_place, (BRICK,) * 3)
        x, y, z = (BRICK * int(b) + int(n) for b, n in zip(brick, local, strict=True))
        return Worst(min(one.worst, 1.0), frame, (x, y, z))


def _check_same(made: ForceField, chosen: Chosen, grid: Grid, lattice: Lattice) -> None:
    """That the decoder arrives where the encoder predicts from: else the fault is this program's."""
    if made != chosen.exceptions.applied(chosen.decoded.field(grid, lattice.unit_n)):
        raise AssertionError(f"frame model {chosen.record.model} does not decode what it has encoded")


def _more(original: ForceField, known: Exceptions | None, found: Compared) -> Exceptions:
    keys, places = found.keys, found.places
    if known is not None:
        keys, places = np.concatenate([known.keys, keys]), np.concatenate([known.places, places])
    return Exceptions.of(original, keys, places)


def _stats(records: Sequence[FrameRecord], counts: Sequence[int]) -> tuple[FrameStats, ...]:
    return tuple(
        FrameStats(record.kind, count, count, record.cost.bits) for record, count in zip(records, counts, strict=True)
    )

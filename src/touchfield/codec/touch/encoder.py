"""Encoder of coder `touch`: turns force fields into the bytes of a segment, within the error bound. The C
code of ``c/touch_encode.h`` does the coding.

Each frame is coded in closed loop. Every decoded voxel is compared with the original, and those outside the
bound are sent as outliers. Then the finished body is decoded as a receiver would, and compared again (effort
"fast" compares what it has coded, and reads back the outliers alone).
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float32s, Int64s
from touchfield.codec.segment import CodedSegment, FrameStats, MaxError
from touchfield.codec.touch.base_layer_fit import fit_spline
from touchfield.codec.touch.body import BodyReader, write_parameters
from touchfield.codec.touch.decoder import NAME
from touchfield.codec.touch.error_bound import allowed_error_n, has_allowance
from touchfield.codec.touch.spec import MODES, TouchSpec
from touchfield.compute.native import argument_errors, native
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from touchfield._native import CodedBody, Frame, Options, Spline

MAX_NEWTONS: Final = 2.0**120  # largest force that can be coded; three times as much still fits in a float32
_INTERFRAME: Final = ("auto", "off", "on")


class TouchEncoder:
    """Encoder of the segments of one stream; thread-safe."""

    name = NAME

    def __init__(self, grid: Grid, spec: TouchSpec) -> None:
        self._grid, self._spec = grid, spec
        self._arguments = grid.shape, grid.spacing_m, _options(spec)

    @property
    def parameters(self) -> bytes:
        """`HEAD.coder_parameters` for the spec."""
        return write_parameters(self._spec)

    def encode_segment(
        self,
        frames: Iterable[ForceField],
        key_frame: ForceField | None = None,
        longest_n: float | None = None,
    ) -> CodedSegment:
        """Code frames, at least one, as an independent segment.

        `longest_n` is an upper limit of the length of all forces; if it is given, frames are coded as they
        arrive. `key_frame` is a field close to the first frame, coded in its place: segments of a static
        scene that share one start with the same bytes, and so with the same forces. The error bound
        nevertheless applies to the original frames. InvalidArgument if a force is NaN, infinite or above
        2^120 N, or a frame has another grid.
        """
        originals: list[ForceField] = []
        key = None if self._spec.mode == "lossless" else key_frame

        def arriving() -> Iterator[Frame]:
            for frame in frames:
                originals.append(frame)
                yield self._source(len(originals) - 1, frame)

        def fit(index: int, level: int, unit_n: float, k: float, f0: float) -> Spline | None:
            frame = originals[index] if key is None or index >= 0 else key
            return fit_spline(frame, level, unit_n, k, f0)

        key_source = None if key is None else self._source(0, key)
        with self._argument_errors(originals, key):
            coded = native.encode_segment(*self._arguments, arriving(), key_source, longest_n, fit)
        return self._coded(coded)

    def with_exact_samples(
        self, segment: CodedSegment, frames: Sequence[ForceField], samples: Sequence[Int64s]
    ) -> CodedSegment:
        """The segment, with the given samples of each frame made exact.

        `frames` are those that were coded. `samples`: int64 [m] for each frame; a sample is numbered 512
        times the key of its brick plus its index within the brick. These samples are sent as outliers, from
        which nothing is predicted, so that everything else decodes as before. InvalidArgument if one lies
        beyond the grid, and in mode "lossless", in which every sample is exact.
        """
        if self._spec.mode == "lossless":
            raise InvalidArgument("exact samples", "them in mode lossless", "a mode that loses something")
        sources = [self._source(i, frame) for i, frame in enumerate(frames)]
        numbers = [np.unique(own).astype(np.uint64) for own in samples]
        with self._argument_errors(frames, None):
            coded = native.add_exact_samples(*self._arguments, segment.body, sources, numbers)
        return self._coded(coded)

    def key_frame(self, frame: ForceField, previous: ForceField | None) -> ForceField:
        """`previous` if every force of `frame` is close to it, else `frame`.

        "Close" is a small fraction of the mask.
        """
        if previous is None or frame.grid != previous.grid:
            return frame
        with argument_errors("key frame"):
            is_static = native.is_static(*self._arguments, _arrays(frame), _arrays(previous))
        return previous if is_static else frame

    def _source(self, index: int, frame: ForceField) -> Frame:
        if frame.grid != self._grid:
            found = f"a grid of {frame.grid.shape}"
            raise InvalidArgument(f"frame {index}", found, f"that of the stream, {self._grid.shape}")
        return _arrays(frame, allowed_error_n(frame, self._spec) if has_allowance(self._spec) else None)

    @contextmanager
    def _argument_errors(self, frames: Sequence[ForceField], key: ForceField | None) -> Iterator[None]:
        """Errors of the module, with the frame whose forces cannot be coded."""
        try:
            with argument_errors("frames"):
                yield
        except InvalidArgument as error:
            for i, frame in enumerate([*([] if key is None else [key]), *frames]):
                longest_n = _longest_n(frame)
                if error.where == "frames" and not longest_n <= MAX_NEWTONS:  # also true for NaN
                    index = max(i - (key is not None), 0)
                    found = f"a force of {longest_n:.3g} N"
                    raise InvalidArgument(f"frame {index}", found, "finite newtons, 2^120 at most") from None
            raise

    def _coded(self, coded: CodedBody) -> CodedSegment:
        """The segment of a body, with the cost of each frame."""
        body, decoded, (ratio, frame, voxel) = coded
        reader = BodyReader(body, self._grid, exact=self._spec.mode == "lossless")
        costs = [record.cost for record in reader.records(len(decoded))]
        stats = (FrameStats(c.kind, c.bits, n, n) for c, n in zip(costs, decoded, strict=True))
        stated = None if self._spec.mode == "nmse" else MaxError(ratio, frame, voxel)
        return CodedSegment(body, tuple(stats), stated)


def _options(spec: TouchSpec) -> Options:
    """The fields of `touch_options` in their order."""
    is_exact, is_checked = spec.support == "exact", spec.effort == "default"
    modes = MODES.index(spec.mode), int(is_exact), _INTERFRAME.index(spec.interframe)
    numbers = spec.k, spec.f0_n, spec.direction_jnd_deg, spec.step_n
    return *modes, int(spec.guess == "auto"), int(is_checked), *numbers


def _arrays(frame: ForceField, hidden_n: Float32s | None = None) -> Frame:
    return (
        np.ascontiguousarray(frame.bricks, np.int32),
        np.ascontiguousarray(frame.forces_n, np.float32),
        None if hidden_n is None else np.ascontiguousarray(hidden_n, np.float32),
    )


def _longest_n(frame: ForceField) -> float:
    vectors = frame.forces_n.reshape(-1, 3)
    return math.sqrt(np.einsum("ni,ni->n", vectors, vectors, dtype=np.float64).max(initial=0.0))

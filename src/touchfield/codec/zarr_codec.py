"""The coder `touch` as a codec of zarr, version 3: any program with zarr reads a field whose promise holds.

A chunk [t, x, y, z, 3] of float32 newtons is one segment of t frames, with nothing around it; what a decoder
must know beside it is the codec's configuration. Found by zarr through the entry point ``touchfield.touch``.
"""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from typing import Any, Final

import numpy as np
from zarr.abc.codec import ArrayBytesCodec

from touchfield.codec.touch.body import write_parameters
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.spec import CODER, TouchSpec
from touchfield.compute.threads import worker_count
from touchfield.errors import CorruptFile, InvalidArgument, warn_unbounded
from touchfield.medium import ForceField, Grid

NAME: Final = "touchfield.touch"
_OPTIONS: Final = ("k", "f0_n", "mode", "effort")
_MOST_SAMPLES: Final = 1 << 25


_recorded: list[list[float | None]] = []


@contextmanager
def recorded_ratios() -> Iterator[list[float | None]]:
    """Largest errors, in units of the bound, of all chunks that are coded within the block; None of one
    without any.

    Chunks are coded in threads of zarr's, so a block has those of all threads.
    """
    ratios: list[float | None] = []
    _recorded.append(ratios)
    try:
        yield ratios
    finally:
        _recorded.remove(ratios)


def _unbounded_note(spec: TouchSpec) -> str | None:
    rule = CODER.bound_rule(spec)
    return None if rule.text else f"no error bound is proved: {rule.reason}"


@cache
def _threads() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(worker_count(), thread_name_prefix="touchfield-zarr")


def _in_thread(work: Callable[..., Any], *given: Any) -> Awaitable[Any]:
    """The work beside zarr's loop, on as many threads as touchfield may use: each holds a chunk."""
    return asyncio.get_running_loop().run_in_executor(_threads(), work, *given)


@dataclass(frozen=True)
class TouchCodec(ArrayBytesCodec):
    """Codes chunks so that every force is kept within max(F_0, k |F|); see `TouchSpec` for the options.

    `spacing_m` are the metres between samples, which help to predict.

    Raises `InvalidArgument` if an option, or the shape or type of an array, cannot be.
    """

    k: float = TouchSpec.k
    f0_n: float = TouchSpec.f0_n
    mode: str = TouchSpec.mode
    effort: str = TouchSpec.effort
    spacing_m: tuple[float, float, float] = (0.001, 0.001, 0.001)

    is_fixed_size = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "spacing_m", tuple(self.spacing_m))
        _ = self.spec, Grid((1, 1, 1), self.spacing_m, (0.0, 0.0, 0.0))

    @property
    def spec(self) -> TouchSpec:
        """Options of the coder `touch`."""
        return TouchSpec(**{name: getattr(self, name) for name in _OPTIONS})

    @classmethod
    def from_dict(cls, data: dict[str, Any]) -> TouchCodec:
        """From the metadata of an array."""
        told = data.get("configuration") or {}
        known = (*_OPTIONS, "spacing_m")
        if not isinstance(told, dict) or not set(told) <= set(known):
            raise InvalidArgument(
                f"codec {NAME}", f"a configuration {told!r}", f"values of {', '.join(known)}"
            )
        if told.get("effort") == "max":  # of older arrays, which decode as others do
            told = {**told, "effort": TouchSpec.effort}
        return cls(**told)

    def to_dict(self) -> dict[str, Any]:
        """As the metadata of an array keep it."""
        told = {name: getattr(self, name) for name in _OPTIONS}
        return {"name": NAME, "configuration": {**told, "spacing_m": list(self.spacing_m)}}

    def validate(self, *, shape: tuple[int, ...], dtype: Any, chunk_grid: Any) -> None:
        """Refuse an array that holds no forces."""
        if len(shape) != 5 or shape[-1] != 3 or np.dtype(dtype.to_native_dtype()) != np.float32:
            raise InvalidArgument(
                f"codec {NAME}", f"an array {dtype} {shape}", "float32 [t, x, y, z, 3], newtons"
            )

    def compute_encoded_size(self, input_byte_length: int, _chunk_spec: Any) -> int:
        """Not known beforehand."""
        raise NotImplementedError

    def _grid(self, shape: tuple[int, ...]) -> Grid:
        if len(shape) != 5 or shape[-1] != 3 or np.prod(shape) > 3 * _MOST_SAMPLES:
            raise InvalidArgument(
                f"codec {NAME}", f"a chunk {shape}", "[t, x, y, z, 3], of 2^25 forces at most"
            )
        x, y, z = shape[1:4]
        return Grid((x, y, z), self.spacing_m, (0.0, 0.0, 0.0))

    def encode_chunk(self, dense: np.ndarray[Any, Any]) -> bytes:
        """Bytes of newtons [t, x, y, z, 3]."""
        from touchfield.codec.touch.encoder import TouchEncoder

        grid = self._grid(dense.shape)
        warn_unbounded(_unbounded_note(self.spec))
        frames = [ForceField.from_dense(grid, one) for one in dense]
        segment = TouchEncoder(grid, self.spec).encode_segment(frames)
        for ratios in _recorded:
            ratios.append(segment.worst.ratio if segment.worst else None)
        return segment.body

    def decode_chunk(self, body: bytes, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
        """Newtons float32 [t, x, y, z, 3]; CorruptFile if they are not in these bytes."""
        decoder = TouchDecoder(self._grid(shape), write_parameters(self.spec))
        out = np.zeros(shape, np.float32)
        frames = decoder.frames(body, shape[0])
        for i, one in enumerate(frames):
            out[i] = one.to_dense()
        return out

    async def _encode_single(self, chunk_array: Any, chunk_spec: Any) -> Any:
        body = await _in_thread(self.encode_chunk, chunk_array.as_numpy_array())
        return chunk_spec.prototype.buffer.from_bytes(body)

    async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        if not len(chunk_bytes):
            raise CorruptFile(f"codec {NAME}", "a chunk without bytes", "a segment of the coder touch")
        dense = await _in_thread(self.decode_chunk, chunk_bytes.to_bytes(), chunk_spec.shape)
        return chunk_spec.prototype.nd_buffer.from_numpy_array(dense)

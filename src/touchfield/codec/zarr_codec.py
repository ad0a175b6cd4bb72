"""Lets zarr 3 store arrays of forces compressed by coder `touch`, so that any program that uses zarr can read
them. The error bound of the coder holds for every sample.

A chunk [t, x, y, z, 3] of float32 newtons is the body of one segment of t frames; the parameters of the
decoder are the codec's configuration. zarr finds the codec through the entry point ``touchfield.touch``.
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
_MAX_SAMPLES: Final = 1 << 25


_recorded: list[list[float | None]] = []


@contextmanager
def recorded_ratios() -> Iterator[list[float | None]]:
    """Collect the largest error ratio of each chunk that is coded within the block.

    The ratio is None for a chunk without an error bound. zarr codes chunks in threads of its own, so a block
    receives the ratios of all threads.
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


def _in_thread(function: Callable[..., Any], *arguments: Any) -> Awaitable[Any]:
    """Run a function outside zarr's event loop, in the threads of touchfield."""
    return asyncio.get_running_loop().run_in_executor(_threads(), function, *arguments)


@dataclass(frozen=True)
class TouchCodec(ArrayBytesCodec):
    """Zarr codec whose error is at most max(F_0, k |F|) at every sample.

    See `TouchSpec` for the options. `spacing_m`, the distance between samples in metres, improves the
    prediction. Raises `InvalidArgument` if an option, or the shape or type of an array, is invalid.
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
        """Create the codec from the metadata of an array."""
        options = data.get("configuration") or {}
        names = (*_OPTIONS, "spacing_m")
        if not isinstance(options, dict) or not set(options) <= set(names):
            raise InvalidArgument(
                f"codec {NAME}", f"a configuration {options!r}", f"values of {', '.join(names)}"
            )
        if options.get("effort") == "max":  # older arrays have this effort; they decode in the same way
            options = {**options, "effort": TouchSpec.effort}
        return cls(**options)

    def to_dict(self) -> dict[str, Any]:
        """The codec in the metadata of an array."""
        options = {name: getattr(self, name) for name in _OPTIONS}
        return {"name": NAME, "configuration": {**options, "spacing_m": list(self.spacing_m)}}

    def validate(self, *, shape: tuple[int, ...], dtype: Any, chunk_grid: Any) -> None:
        """InvalidArgument unless the array is float32 [t, x, y, z, 3]."""
        if len(shape) != 5 or shape[-1] != 3 or np.dtype(dtype.to_native_dtype()) != np.float32:
            raise InvalidArgument(
                f"codec {NAME}", f"an array {dtype} {shape}", "float32 [t, x, y, z, 3], newtons"
            )

    def compute_encoded_size(self, input_byte_length: int, _chunk_spec: Any) -> int:
        """Not supported: the size is not known in advance."""
        raise NotImplementedError

    def _grid(self, shape: tuple[int, ...]) -> Grid:
        if len(shape) != 5 or shape[-1] != 3 or np.prod(shape) > 3 * _MAX_SAMPLES:
            raise InvalidArgument(
                f"codec {NAME}", f"a chunk {shape}", "[t, x, y, z, 3], of 2^25 forces at most"
            )
        x, y, z = shape[1:4]
        return Grid((x, y, z), self.spacing_m, (0.0, 0.0, 0.0))

    def encode_chunk(self, dense: np.ndarray[Any, Any]) -> bytes:
        """Code newtons [t, x, y, z, 3]."""
        from touchfield.codec.touch.encoder import TouchEncoder

        grid = self._grid(dense.shape)
        warn_unbounded(_unbounded_note(self.spec))
        frames = [ForceField.from_dense(grid, vectors) for vectors in dense]
        segment = TouchEncoder(grid, self.spec).encode_segment(frames)
        for ratios in _recorded:
            ratios.append(segment.max_error.ratio if segment.max_error else None)
        return segment.body

    def decode_chunk(self, body: bytes, shape: tuple[int, ...]) -> np.ndarray[Any, Any]:
        """Decode newtons, float32 [t, x, y, z, 3]; CorruptFile if the bytes are invalid."""
        decoder = TouchDecoder(self._grid(shape), write_parameters(self.spec))
        out = np.zeros(shape, np.float32)
        frames = decoder.frames(body, shape[0])
        for i, frame in enumerate(frames):
            out[i] = frame.to_dense()
        return out

    async def _encode_single(self, chunk_array: Any, chunk_spec: Any) -> Any:
        body = await _in_thread(self.encode_chunk, chunk_array.as_numpy_array())
        return chunk_spec.prototype.buffer.from_bytes(body)

    async def _decode_single(self, chunk_bytes: Any, chunk_spec: Any) -> Any:
        if not len(chunk_bytes):
            raise CorruptFile(f"codec {NAME}", "a chunk without bytes", "a segment of the coder touch")
        dense = await _in_thread(self.decode_chunk, chunk_bytes.to_bytes(), chunk_spec.shape)
        return chunk_spec.prototype.nd_buffer.from_numpy_array(dense)

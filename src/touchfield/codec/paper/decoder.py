"""Decoder of coder `paper`: turns the bytes of a segment back into force fields. A *stage* is a variant of
the coder that replaces one of its steps.

A stage replaces levels and directions by predictive, spectral or run-length coding of a field. The paper
names these (sections 2 and 4.3) without defining them. Each stage rounds the components of the supported
samples to uniform steps, frame by frame, and produces whole numbers, which `codec.support.encode_numbers`
codes:

* ``dpcm``: the difference to the preceding sample. z is fastest, so that this is the neighbour in depth if
  there is one.
* ``adpcm``: two adaptive weights predict the next sample. The step grows where differences are large, up to
  four times the finest step, and shrinks again (Jayant; `_native.adpcm`).
* ``wavelet``: LeGall's 5/3 wavelet by integer lifting, as in JPEG 2000, three levels on each brick; exact.
* ``dct``: the orthonormal DCT (type 2) on each brick, with its coefficients in uniform steps. The inverse is
  in fixed point (18 bits for cosines, 8 bits below a step), so that every machine computes the same forces.
* ``runs``: vectors, each with the number of equal vectors that follow it.

Samples of a brick outside the support are known to have no force, so the value of a transform there is
arbitrary.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import Any, Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.paper.body import MAX_NEWTONS, BitStream, BodyReader, FrameParts, SegmentReader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.segment import FrameCost, FrameKind
from touchfield.codec.support import decode_numbers, decode_support
from touchfield.compute.native import native
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.medium.budget import memory_budget_bytes, zero_forces
from touchfield.medium.field import field_without_empty_bricks
from touchfield.medium.grid import BRICK
from touchfield.medium.samples import raster_slots

LEVELS: Final = 3  # levels of the wavelet: 8, 4 and 2 samples
GRAIN: Final = 16  # ADPCM values are in units of 1/16 of the finest step
_BYTES_PER_BRICK = 128 * BRICK**3  # peak memory of decoding
_FRACTION = 8  # bits below a step in the DCT
_COSINE_BITS = 18

# decoded whole numbers per step, by stage
PARTS: Final = {"dpcm": 1, "adpcm": GRAIN, "dct": 1 << _FRACTION, "wavelet": 1, "runs": 1}
BY_BRICK: Final = ("dct", "wavelet")  # stages whose numbers are coefficients of whole bricks
ORDER: Final = np.argsort(np.indices((BRICK,) * 3).sum(axis=0).reshape(-1), kind="stable")
"""Order of a brick's coefficients, low frequencies first: by the sum of the three indices."""


class StageReader(SegmentReader):
    """Reader of a segment of a stage."""

    def __init__(self, body: bytes, grid: Grid, stage: str) -> None:
        super().__init__(body, grid)
        self._stage = stage
        (self.step_n,) = struct.unpack("<d", self._parts.take(8, "step"))
        if not 1e-9 <= self.step_n <= MAX_NEWTONS:
            raise CorruptFile("SEGM.body step", f"{self.step_n!r} N", f"1e-9 to {MAX_NEWTONS:g} N")

    def field(self, frame: FrameParts) -> ForceField:
        """Decode a frame."""
        bricks, mask = decode_support(frame.support, self._grid)
        if len(bricks) * _BYTES_PER_BRICK > memory_budget_bytes():
            excess, allowed = f"{len(bricks)} bricks", f"{memory_budget_bytes() // _BYTES_PER_BRICK} at most"
            raise InvalidArgument("SEGM.body", excess, allowed, "Set TOUCHFIELD_MEMORY_GIB.")
        forces, slots = zero_forces(len(bricks)), raster_slots(bricks, mask)
        if frame.runs > len(slots):
            raise CorruptFile("SEGM.body runs", f"{frame.runs}", f"at most {len(slots)}, one for each sample")
        numbers, scale = frame.streams[0].data, np.float64(self.step_n) / PARTS[self._stage]
        vectors = _decode_stage(self._stage, numbers, (len(bricks), slots, frame.runs)) * scale
        if vectors.size and np.abs(vectors).max() > MAX_NEWTONS:
            raise CorruptFile("SEGM.body", "a force that is too large", f"at most {MAX_NEWTONS:g} N")
        forces.reshape(-1, 3)[slots] = vectors.astype(np.float32)
        return field_without_empty_bricks(self._grid, bricks, forces)

    def _next(self, *, first: bool) -> FrameParts:
        support = self._parts.chunk("support")
        runs = self._parts.varint("number of runs") if self._stage == "runs" else 0
        numbers = self._parts.chunk("numbers")
        return FrameParts(FrameKind.INTRA, support, (BitStream(numbers, 8 * len(numbers)),), runs)


def _decode_stage(stage: str, data: bytes, layout: tuple[int, Int64s, int]) -> Int64s:
    """Decode the supported samples of a frame, int64 [L, 3], in the order of `slots`.

    `layout` holds the number of bricks, the slots, and the number of runs. Values are in parts of a step
    (`PARTS`).
    """
    brick_count, slots, runs = layout
    if stage == "runs":
        numbers = decode_numbers(data, 4 * runs)
        lengths = numbers[:runs] + 1
        if (lengths < 1).any() or int(lengths.sum()) != len(slots):
            raise CorruptFile("SEGM.body runs", f"{int(lengths.sum())} samples", f"{len(slots)}")
        return np.repeat(numbers[runs:].reshape(3, runs).T, lengths, axis=0)
    if stage in BY_BRICK:
        vectors = np.empty((len(slots), 3), np.int64)
        coefficients = decode_numbers(data, 3 * BRICK**3 * brick_count).reshape(3, BRICK**3, brick_count)
        for component in range(3):
            bricks = np.empty((brick_count, BRICK**3), np.int64)
            bricks[:, ORDER] = coefficients[component].T
            vectors[:, component] = from_bricks(stage, bricks.reshape(-1, BRICK, BRICK, BRICK)).reshape(-1)[
                slots
            ]
        return vectors
    residuals = decode_numbers(data, 3 * len(slots)).reshape(3, -1)
    if stage == "dpcm":
        return np.cumsum(residuals, axis=1).T
    grains = np.zeros_like(residuals)
    for values, residual in zip(grains, residuals, strict=True):
        native.adpcm(values, residual, True)
    return grains.T


def from_bricks(stage: str, coefficients: Int64s) -> Int64s:
    """Inverse transform of the coefficients of bricks, int64 [n, 8, 8, 8]."""
    return _from_wavelet(coefficients) if stage == "wavelet" else _from_dct(coefficients)


def _from_wavelet(coefficients: Int64s) -> Int64s:
    out = coefficients.copy()
    for level in reversed(range(LEVELS)):
        half = BRICK >> (level + 1)
        part = out[:, : 2 * half, : 2 * half, : 2 * half]
        for axis in (3, 2, 1):
            x = np.moveaxis(part, axis, 0)
            coarse, detail = x[:half].copy(), x[half:].copy()
            x[0::2] = coarse - ((np.concatenate([detail[:1], detail[:-1]]) + detail + 2) >> 2)
            x[1::2] = detail + ((x[0::2] + np.concatenate([x[2::2], x[-2:-1]])) >> 1)
    return out


def _from_dct(coefficients: Int64s) -> Int64s:
    """Inverse DCT in units of 2^-8 of a step, rounded after each axis."""
    frequency, sample = np.indices((BRICK, BRICK))
    scale = np.where(frequency == 0, np.sqrt(1 / BRICK), np.sqrt(2 / BRICK))
    cosines = scale * np.cos(np.pi * (2 * sample + 1) * frequency / (2 * BRICK))
    basis, out = np.rint(cosines * (1 << _COSINE_BITS)).astype(np.int64), coefficients << _FRACTION
    for axis in (1, 2, 3):
        moved = np.moveaxis(out, axis, -1)
        total = sum(moved[..., f : f + 1] * basis[f] for f in range(BRICK))
        out = np.moveaxis((total + (1 << (_COSINE_BITS - 1))) >> _COSINE_BITS, -1, axis)
    return out


class PaperDecoder:
    """Decoder of the segments of one stream, from the stream alone.

    `parameters` is the name of a direction codebook or a stage, in ASCII; CorruptFile otherwise. `where`
    names the parameters in errors.
    """

    name = "paper"

    def __init__(self, grid: Grid, parameters: bytes, where: str = "HEAD.coder_parameters") -> None:
        self._grid, self._name = grid, parameters.decode("ascii", "replace")
        if self._name not in PARTS and self._name not in codebook_names():
            raise CorruptFile(where, repr(parameters[:40]), "a direction codebook, or a stage")

    def frames(self, body: bytes, frame_count: int) -> Iterator[ForceField]:
        """Yield the frames of a segment in order.

        CorruptFile or TruncatedFile if the bytes are invalid.
        """
        reader = self._reader(body)
        for frame, _ in reader.frames(frame_count):
            yield reader.field(frame)

    def costs(self, body: bytes, frame_count: int) -> list[FrameCost]:
        """Cost of each frame of a segment, without decoding it."""
        return [cost for _, cost in self._reader(body).frames(frame_count)]

    def describe(self) -> dict[str, Any]:
        """Parameters of the stream, under stable keys."""
        if self._name in PARTS:
            return {"stage": self._name}
        return {
            "stage": "none",
            "directions": self._name,
            "direction_count": len(Codebook.get(self._name)),
        }

    def _reader(self, body: bytes) -> SegmentReader:
        if self._name in PARTS:
            return StageReader(body, self._grid, self._name)
        return BodyReader(body, self._grid, Codebook.get(self._name))

"""Bytes of a segment of the coder `touch`, and `HEAD.coder_parameters`.

Outliers, voxels that would be outside the error bound, are sent separately as exact float32. Departure from
the paper, which has no such escape: accumulated rounding would make a few voxels in 10^5 violate the mask.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.segment import RATIO_STEPS, BitAccount, FrameCost, FrameKind, MaxError
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.spec import EFFORTS, MODES, SUPPORTS, TouchSpec
from touchfield.codec.varint import Parts, chunk, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys, bricks_of, field_without_empty_bricks

_WHERE: Final = "SEGM.body"
_OUTLIERS_WHERE: Final = "SEGM.body outliers"
_VERSION: Final = 1  # of the parameters
_SAMPLES: Final = 512
_VECTOR: Final = 12
_MAX_ERROR_FLAG: Final = 1
_INTER, _BASE_LAYER, _OUTLIERS = 1, 2, 4
_MASK: Final = ("k", "f0_n")
_NUMBERS: Final = {
    "mask": _MASK, "mask-direction": (*_MASK, "direction_jnd_deg"), "nmse": ("step_n",), "lossless": ()
}  # fmt: skip
# numbers that follow if `_MASKING_FLAG` is set (mode "mask")
_MASKING: Final = ("masking", "masking_radius_m")
_MASKING_FLAG: Final = 32


def numbers_of(spec: TouchSpec) -> tuple[str, ...]:
    """Names of the numeric options that the mode of a spec uses."""
    return _NUMBERS[spec.mode] + (_MASKING if spec.masking else ())


@dataclass(frozen=True)
class FrameRecord:
    """A frame as stored in a body."""

    # whether the frame uses the models of the frame before and, without a base layer, its forces
    inter: bool
    base_layer: bytes  # empty if there is none, like the outliers
    payload: bytes
    fractions: tuple[int, int]  # of the payload's bits, for support and amplitude, in 1/255
    outliers: bytes = b""

    def to_bytes(self) -> bytes:
        """The frame in a body (docs/format/touch.md, "Body")."""
        flags = _INTER * self.inter | _BASE_LAYER * bool(self.base_layer) | _OUTLIERS * bool(self.outliers)
        chunks = (
            [self.base_layer] * bool(self.base_layer) + [self.payload] + [self.outliers] * bool(self.outliers)
        )
        return bytes([flags, *self.fractions]) + b"".join(map(chunk, chunks))

    @property
    def cost(self) -> FrameCost:
        """Cost of the frame.

        Outliers and lengths count as side bits; ``bits.models`` are those of its base layer.
        """
        total, payload = 8 * len(self.to_bytes()), 8 * len(self.payload)
        support = payload * self.fractions[0] // 255
        amplitude = payload * self.fractions[1] // 255
        models = 8 * len(self.base_layer)
        bits = BitAccount(
            support, amplitude, payload - support - amplitude, total - payload - models, models=models
        )
        return FrameCost(FrameKind(self.inter), bits)


def bit_fractions(bits: tuple[float, float, float]) -> tuple[int, int]:
    """Fractions of a payload for support and amplitude, in 1/255.

    `bits` are the bits of support, amplitude and direction. The fractions are informative only, so any value
    is accepted: the bits are estimates, and for a payload of a few bytes they may sum to more than it has,
    which leaves a negative rest for one of the three.
    """
    total = sum(bits)
    if not 0 < total < math.inf:
        return 255, 0
    support = min(max(round(255 * bits[0] / total), 0), 255)
    return support, min(max(round(255 * bits[1] / total), 0), 255 - support)


def write_body(lattice: Lattice | None, records: Sequence[FrameRecord], max_error: MaxError | None) -> bytes:
    """Write the body of a segment; `lattice` is None in mode "lossless"."""
    parts = [bytes([_MAX_ERROR_FLAG if max_error else 0])]
    if lattice is not None:
        parts.append(lattice.to_bytes())
    if max_error is not None:
        parts += [
            struct.pack("<H", max_error.rounded_up),
            *map(write_varint, (max_error.frame, *max_error.voxel)),
        ]
    return b"".join([*parts, *(record.to_bytes() for record in records)])


class BodyReader:
    """Sequential reader of a segment's body.

    CorruptFile or TruncatedFile if the bytes are invalid.
    """

    def __init__(self, body: bytes, grid: Grid, *, exact: bool) -> None:
        self._parts, self._exact = Parts(body), exact
        (flags,) = self._parts.take(1, "flags")
        if flags & ~_MAX_ERROR_FLAG:
            raise CorruptFile(f"{_WHERE} flags", f"{flags:#x}", "bit 0 only")
        self.lattice = None if exact else Lattice.read(self._parts)
        self.max_error: MaxError | None = None
        if flags & _MAX_ERROR_FLAG:
            (ratio,) = struct.unpack("<H", self._parts.take(2, "worst ratio"))
            frame = self._parts.varint("worst frame", 1 << 16)
            x, y, z = (self._parts.varint("worst voxel", n) for n in grid.shape)
            self.max_error = MaxError(ratio / RATIO_STEPS, frame, (x, y, z))

    def records(self, frame_count: int) -> list[FrameRecord]:
        """The frames, not decoded; the body must end with the last one."""
        if self.max_error is not None and self.max_error.frame >= frame_count:
            raise CorruptFile(f"{_WHERE} worst frame", str(self.max_error.frame), f"below {frame_count}")
        where, records = f"{_WHERE} frame", list[FrameRecord]()
        for i in range(frame_count):
            flags, support, amplitude = self._parts.take(3, "frame")
            if flags > (_INTER if self._exact else _INTER | _BASE_LAYER | _OUTLIERS):
                raise CorruptFile(where, f"{flags:#x}", "bit 0 alone" if self._exact else "bits 0 to 2")
            if i == 0 and flags & _INTER:
                raise CorruptFile(where, "a first frame that needs the one before", "one that stands alone")
            if support + amplitude > 255:
                raise CorruptFile(f"{where} fractions", f"{support} and {amplitude}", "255 together at most")
            base_layer = self._parts.chunk("base layer", 1) if flags & _BASE_LAYER else b""
            payload = self._parts.chunk("payload")
            outliers = self._parts.chunk("outliers", 1) if flags & _OUTLIERS else b""
            records.append(
                FrameRecord(bool(flags & _INTER), base_layer, payload, (support, amplitude), outliers)
            )
        self._parts.check_end()
        return records


def write_parameters(spec: TouchSpec) -> bytes:
    """`HEAD.coder_parameters` for a spec."""
    options = MODES.index(spec.mode) | SUPPORTS.index(spec.support) << 2 | EFFORTS.index(spec.effort) << 3
    options |= _MASKING_FLAG if spec.masking else 0
    numbers = [getattr(spec, name) for name in numbers_of(spec)]
    return struct.pack(f"<BB{len(numbers)}d", _VERSION, options, *numbers)


def read_parameters(data: bytes, where: str) -> TouchSpec:
    """Read the options that a file stores.

    Options that it does not store have their defaults. UnsupportedVersion or CorruptFile for invalid bytes.
    """
    if len(data) < 2:
        raise CorruptFile(where, f"{len(data)} bytes", "2 or more")
    if data[0] != _VERSION:
        raise UnsupportedVersion(
            where, f"version {data[0]}", f"version {_VERSION}", "A newer touchfield reads it."
        )
    mode, support, effort, masking = data[1] & 3, data[1] >> 2 & 1, data[1] >> 3 & 3, data[1] >> 5
    if effort > 2 or masking > (mode == 0):
        expected = "an effort of 0 to 2, and masking in mode 0 only"
        raise CorruptFile(where, f"{data[1]:#x} for mode, support, effort and masking", expected)
    names = _NUMBERS[MODES[mode]] + (_MASKING if masking else ())
    if len(data) != 2 + 8 * len(names):
        raise CorruptFile(where, f"{len(data)} bytes", f"{2 + 8 * len(names)} bytes of mode {MODES[mode]}")
    numbers = dict(zip(names, struct.unpack_from(f"<{len(names)}d", data, 2), strict=True))
    if not all(map(math.isfinite, numbers.values())):
        raise CorruptFile(where, repr(numbers), "finite numbers")
    if masking and not numbers["masking"] > 0:
        raise CorruptFile(where, f"masking with a fraction of {numbers['masking']}", "one above 0")
    # older versions also had effort 2, whose files decode in the same way
    spec = TouchSpec(mode=MODES[mode], support=SUPPORTS[support], effort=EFFORTS[min(effort, 1)])
    try:
        return replace(spec, **numbers)
    except InvalidArgument as error:
        raise CorruptFile(where, f"{error.where} = {error.found}", error.expected) from None


def encode_outliers(original: ForceField, keys: Int64s, samples: Int64s) -> bytes:
    """Code the exact forces of a field at samples of bricks (docs/format/touch.md).

    `keys` and `samples`: int64 [m] each, ascending.
    """
    parts, previous = [], 0
    bricks, slot = np.unique(keys, return_inverse=True)
    vectors = original.forces_at(bricks).reshape(-1, _SAMPLES, 3)[slot, samples].astype("<f4")
    for key, sample, vector in zip(keys.tolist(), samples.tolist(), vectors, strict=True):
        data = vector.tobytes() if any(vector.tobytes()) else b""
        parts += [write_varint(key - previous), write_varint(2 * sample + (not data)), data]
        previous = key
    return b"".join(parts)


def outlier_numbers(grid: Grid, data: bytes) -> Int64s:
    """Numbers of the samples of coded outliers, int64 [m], ascending.

    A number is 512 times the key of the brick plus the index of the sample within it.
    """
    keys, samples, _ = _read_outliers(grid, data)
    return 512 * np.array(keys, np.int64) + np.array(samples, np.int64)


def apply_outliers(field: ForceField, data: bytes) -> ForceField:
    """Replace the forces of a field at coded outliers.

    Bricks without any force are removed. CorruptFile or TruncatedFile if the bytes are not those of
    `encode_outliers`.
    """
    grid = field.grid
    keys, samples, forces = _read_outliers(grid, data)
    vectors = np.frombuffer(forces, "<f4").reshape(-1, 3)
    if not np.isfinite(vectors).all():
        raise CorruptFile(_OUTLIERS_WHERE, "a force that is not finite", "finite newtons")
    local = np.stack(np.unravel_index(samples, (8, 8, 8)), axis=-1)
    if (8 * bricks_of(grid, np.array(keys, np.int64)) + local >= np.asarray(grid.shape)).any():
        raise CorruptFile(_OUTLIERS_WHERE, "a sample beyond the grid", f"samples below {grid.shape}")
    union = np.union1d(brick_keys(grid, field.bricks), keys)
    result = field.forces_at(union)
    result.reshape(-1, _SAMPLES, 3)[np.searchsorted(union, keys), samples] = vectors
    return field_without_empty_bricks(grid, bricks_of(grid, union), result)


def _read_outliers(grid: Grid, data: bytes) -> tuple[list[int], list[int], bytes]:
    """Keys of bricks, samples within them, and bytes of the forces.

    CorruptFile or TruncatedFile if the bytes are invalid.
    """
    keys, samples = list[int](), list[int]()
    parts, forces, key, sample = Parts(data, _OUTLIERS_WHERE), bytearray(), 0, -1
    while not parts.is_ended:
        gap = parts.varint("brick", math.prod(grid.brick_shape) - key)
        coded = parts.varint("sample", 2 * _SAMPLES)
        if keys and gap == 0 and coded >> 1 <= sample:
            raise CorruptFile(
                _OUTLIERS_WHERE, f"sample {coded >> 1} after sample {sample}", "ascending samples"
            )
        key, sample = key + gap, coded >> 1
        keys.append(key)
        samples.append(sample)
        forces += bytes(_VECTOR) if coded & 1 else parts.take(_VECTOR, "force")
    return keys, samples, bytes(forces)

"""Writes and reads the byte layout of a segment of coder `touch`, the default: one record for each frame,
with exact values for outliers; and the options that a file's head stores.

Outliers, voxels that would be outside the error bound, are sent separately as exact float32. Departure from
the paper, which has no such escape: accumulated rounding would make a few voxels in 10^5 violate the mask.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

from touchfield.codec.segment import RATIO_STEPS, BitAccount, FrameCost, FrameKind, MaxError
from touchfield.codec.touch.spec import EFFORTS, MODES, SUPPORTS, TouchSpec
from touchfield.codec.varint import Parts, chunk, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import Grid

WHERE: Final = "SEGM.body"
MIN_FLOOR: Final = 21
MIN_RATE: Final = 64
"""A lattice has a floor of at least `MIN_FLOOR` units or a rate of at least `MIN_RATE`.

This bounds its table of warped lengths to 200,000 entries for any file: 2^22 / floor where it is uniform, and
2^20 / rate (1 + ln(4 rate / floor)) where it is not.
"""

FLOOR_LIMIT: Final = 1 << 16
MAX_FRAMES: Final = (1 << 16) - 1  # of a segment
RATE_LIMIT: Final = 1 << 17

# smallest normal float32: products with it are exact also on machines that flush subnormal numbers to zero
SMALLEST_UNIT_N: Final = 2.0**-126
_MAX_UNIT_N: Final = 2.0**104

_VERSION: Final = 1  # of the parameters
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
class Lattice:
    """Steps of the residual along and across the prediction.

    At a force of `a` units the step along it is max(`floor`, `rate` * a / 65536), and across it
    max(`cross_floor`, `cross_rate` * a / 65536); at least 1. Rates of 0 make it uniform.
    """

    unit_n: float  # newtons of one unit; a float32
    floor: int  # units, 1 to 65535
    rate: int  # 0 to 131071: steps of up to twice the force
    cross_floor: int
    cross_rate: int

    def to_bytes(self) -> bytes:
        """The lattice in the body of a segment."""
        steps = self.floor, self.rate, self.cross_floor, self.cross_rate
        return struct.pack("<f", self.unit_n) + b"".join(map(write_varint, steps))

    @classmethod
    def read(cls, parts: Parts) -> Lattice:
        """Read what `to_bytes` writes; CorruptFile if a number is out of bounds."""
        (unit_n,) = struct.unpack("<f", parts.take(4, "unit"))
        if not SMALLEST_UNIT_N <= unit_n <= _MAX_UNIT_N:
            raise CorruptFile("SEGM.body unit", f"{unit_n} N", "2^-126 to 2^104 N")
        floor, rate = parts.varint("floor", FLOOR_LIMIT, 1), parts.varint("rate", RATE_LIMIT)
        cross_floor, cross_rate = (
            parts.varint("cross floor", FLOOR_LIMIT, 1),
            parts.varint("cross rate", RATE_LIMIT),
        )
        if floor < MIN_FLOOR and rate < MIN_RATE:
            found = f"a floor of {floor} with a rate of {rate}"
            raise CorruptFile("SEGM.body lattice", found, f"{MIN_FLOOR} or {MIN_RATE} at least")
        return cls(unit_n, floor, rate, cross_floor, cross_rate)


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
    """Sequential reader of a segment's body, of at most `frame_count` frames.

    CorruptFile or TruncatedFile if the bytes are invalid.
    """

    def __init__(self, body: bytes, grid: Grid, *, exact: bool, frame_count: int = MAX_FRAMES) -> None:
        self._parts, self._exact = Parts(body), exact
        (flags,) = self._parts.take(1, "flags")
        if flags & ~_MAX_ERROR_FLAG:
            raise CorruptFile(f"{WHERE} flags", f"{flags:#x}", "bit 0 only")
        self.lattice = None if exact else Lattice.read(self._parts)
        self.max_error: MaxError | None = None
        if flags & _MAX_ERROR_FLAG:
            (ratio,) = struct.unpack("<H", self._parts.take(2, "worst ratio"))
            frame = self._parts.varint("worst frame", frame_count)
            x, y, z = (self._parts.varint("worst voxel", n) for n in grid.shape)
            self.max_error = MaxError(ratio / RATIO_STEPS, frame, (x, y, z))

    def records(self, frame_count: int) -> list[FrameRecord]:
        """The frames, not decoded; the body must end with the last one."""
        if self.max_error is not None and self.max_error.frame >= frame_count:
            raise CorruptFile(f"{WHERE} worst frame", str(self.max_error.frame), f"below {frame_count}")
        where, records = f"{WHERE} frame", list[FrameRecord]()
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

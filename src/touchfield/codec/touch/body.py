"""How the coder `touch` lays a segment out in bytes, and `HEAD.coder_parameters`.

Voxels that a frame model left beyond the promise are sent apart: float32, exactly as they were. Departure
from the paper, which has no escape: single voxels in 10^5 would break the mask by accumulated rounding.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from touchfield.arrays import Int64s
from touchfield.codec.segment import RATIO_STEPS, BitAccount, FrameCost, FrameKind, Worst
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.spec import EFFORTS, MODES, SUPPORTS, TouchSpec
from touchfield.codec.varint import Parts, chunk, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys, bricks_of, field_that_holds

_WHERE: Final = "SEGM.body"
_APART: Final = "SEGM.body exceptions"
_VERSION: Final = 1  # of the parameters
_SAMPLES: Final = 512
_VECTOR: Final = 12
_WORST_FLAG: Final = 1
_INTER, _GUESS, _EXCEPTIONS = 1, 2, 4
_MASK: Final = ("k", "f0_n")
_NUMBERS: Final = {
    "mask": _MASK, "mask-direction": (*_MASK, "direction_jnd_deg"), "nmse": ("step_n",), "lossless": ()
}  # fmt: skip
_MASKING: Final = ("masking", "masking_radius_m")  # follow with this flag, in mode "mask" only
_MASKING_FLAG: Final = 32


def numbers_of(spec: TouchSpec) -> tuple[str, ...]:
    """Names of the numbers that a spec goes by."""
    return _NUMBERS[spec.mode] + (_MASKING if spec.masking else ())


@dataclass(frozen=True)
class FrameRecord:
    """A frame as a body holds it."""

    inter: bool  # whether the frame before is known: what it taught, and, unless there is a guess, its forces
    guess: bytes  # empty where there is none, as the exceptions
    payload: bytes
    shares: tuple[int, int]  # support and amplitude of the payload, 1/255
    exceptions: bytes = b""

    def to_bytes(self) -> bytes:
        """The frame in a body (docs/format/touch.md, "Body")."""
        how = _INTER * self.inter | _GUESS * bool(self.guess) | _EXCEPTIONS * bool(self.exceptions)
        chunks = [self.guess] * bool(self.guess) + [self.payload] + [self.exceptions] * bool(self.exceptions)
        return bytes([how, *self.shares]) + b"".join(map(chunk, chunks))

    @property
    def cost(self) -> FrameCost:
        """Cost of the frame; exceptions and lengths are side bits, ``bits.models`` those of its guess."""
        total, payload = 8 * len(self.to_bytes()), 8 * len(self.payload)
        support = payload * self.shares[0] // 255
        amplitude = payload * self.shares[1] // 255
        models = 8 * len(self.guess)
        bits = BitAccount(
            support, amplitude, payload - support - amplitude, total - payload - models, models=models
        )
        return FrameCost(FrameKind(self.inter), bits)


def shares_of(bits: tuple[float, float, float]) -> tuple[int, int]:
    """Support and amplitude of the bits of support, amplitude and direction, 1/255.

    For people only, so nothing is refused: prices are estimates, and in a payload of a few bytes they may add
    up to more bits than it has, which leaves less than none for one of the three.
    """
    total = sum(bits)
    if not 0 < total < math.inf:
        return 255, 0
    support = min(max(round(255 * bits[0] / total), 0), 255)
    return support, min(max(round(255 * bits[1] / total), 0), 255 - support)


def write_body(lattice: Lattice | None, records: Sequence[FrameRecord], worst: Worst | None) -> bytes:
    """The body of a segment; `lattice` is None in mode "lossless"."""
    parts = [bytes([_WORST_FLAG if worst else 0])]
    if lattice is not None:
        parts.append(lattice.to_bytes())
    if worst is not None:
        parts += [struct.pack("<H", worst.rounded_up), *map(write_varint, (worst.frame, *worst.voxel))]
    return b"".join([*parts, *(record.to_bytes() for record in records)])


class BodyReader:
    """Reads a segment's body from front to back; CorruptFile or TruncatedFile for other bytes than the
    encoder's.
    """

    def __init__(self, body: bytes, grid: Grid, *, exact: bool) -> None:
        self._parts, self._exact = Parts(body), exact
        (flags,) = self._parts.take(1, "flags")
        if flags & ~_WORST_FLAG:
            raise CorruptFile(f"{_WHERE} flags", f"{flags:#x}", "bit 0 only")
        self.lattice = None if exact else Lattice.read(self._parts)
        self.worst: Worst | None = None
        if flags & _WORST_FLAG:
            (ratio,) = struct.unpack("<H", self._parts.take(2, "worst ratio"))
            frame = self._parts.varint("worst frame", 1 << 16)
            x, y, z = (self._parts.varint("worst voxel", n) for n in grid.shape)
            self.worst = Worst(ratio / RATIO_STEPS, frame, (x, y, z))

    def records(self, frame_count: int) -> list[FrameRecord]:
        """The frames, not decoded; the last one must end the body."""
        if self.worst is not None and self.worst.frame >= frame_count:
            raise CorruptFile(f"{_WHERE} worst frame", str(self.worst.frame), f"below {frame_count}")
        where, records = f"{_WHERE} frame", list[FrameRecord]()
        for i in range(frame_count):
            how, support, amplitude = self._parts.take(3, "frame")
            if how > (_INTER if self._exact else _INTER | _GUESS | _EXCEPTIONS):
                raise CorruptFile(where, f"{how:#x}", "bit 0 alone" if self._exact else "bits 0 to 2")
            if i == 0 and how & _INTER:
                raise CorruptFile(where, "a first frame that needs the one before", "one that stands alone")
            if support + amplitude > 255:
                raise CorruptFile(f"{where} shares", f"{support} and {amplitude}", "255 together at most")
            guess = self._parts.chunk("guess", 1) if how & _GUESS else b""
            payload = self._parts.chunk("payload")
            exceptions = self._parts.chunk("exceptions", 1) if how & _EXCEPTIONS else b""
            records.append(FrameRecord(bool(how & _INTER), guess, payload, (support, amplitude), exceptions))
        self._parts.check_end()
        return records


def write_parameters(spec: TouchSpec) -> bytes:
    """The parameters of what was asked for."""
    asked = MODES.index(spec.mode) | SUPPORTS.index(spec.support) << 2 | EFFORTS.index(spec.effort) << 3
    asked |= _MASKING_FLAG if spec.masking else 0
    numbers = [getattr(spec, name) for name in numbers_of(spec)]
    return struct.pack(f"<BB{len(numbers)}d", _VERSION, asked, *numbers)


def read_parameters(data: bytes, where: str) -> TouchSpec:
    """Spec that was asked for, as far as a file tells; UnsupportedVersion or CorruptFile for other bytes."""
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
        raise CorruptFile(where, f"masking with a share of {numbers['masking']}", "one above 0")
    # 2 was an effort that tried more: its files decode as others do
    spec = TouchSpec(mode=MODES[mode], support=SUPPORTS[support], effort=EFFORTS[min(effort, 1)])
    try:
        return replace(spec, **numbers)
    except InvalidArgument as error:
        raise CorruptFile(where, f"{error.where} = {error.found}", error.expected) from None


def exceptions_of(original: ForceField, keys: Int64s, places: Int64s) -> bytes:
    """The forces of a field at samples of bricks, [m] each, ascending, to the bit (docs/format/touch.md)."""
    parts, before = [], 0
    bricks, slot = np.unique(keys, return_inverse=True)
    vectors = original.forces_at(bricks).reshape(-1, _SAMPLES, 3)[slot, places].astype("<f4")
    for key, place, vector in zip(keys.tolist(), places.tolist(), vectors, strict=True):
        data = vector.tobytes() if any(vector.tobytes()) else b""
        parts += [write_varint(key - before), write_varint(2 * place + (not data)), data]
        before = key
    return b"".join(parts)


def exception_numbers(grid: Grid, data: bytes) -> Int64s:
    """Numbers of the samples of `exceptions_of`, int64 [m], ascending: 512 key + place."""
    keys, places, _ = _read_exceptions(grid, data)
    return 512 * np.array(keys, np.int64) + np.array(places, np.int64)


def with_exceptions(field: ForceField, data: bytes) -> ForceField:
    """A field with the forces of `exceptions_of` in place of its own; bricks without any force are left out.

    CorruptFile or TruncatedFile where the bytes are not what that writes.
    """
    grid = field.grid
    keys, places, forces = _read_exceptions(grid, data)
    vectors = np.frombuffer(forces, "<f4").reshape(-1, 3)
    if not np.isfinite(vectors).all():
        raise CorruptFile(_APART, "a force that is not finite", "finite newtons")
    local = np.stack(np.unravel_index(places, (8, 8, 8)), axis=-1)
    if (8 * bricks_of(grid, np.array(keys, np.int64)) + local >= np.asarray(grid.shape)).any():
        raise CorruptFile(_APART, "a sample beyond the grid", f"samples below {grid.shape}")
    every = np.union1d(brick_keys(grid, field.bricks), keys)
    own = field.forces_at(every)
    own.reshape(-1, _SAMPLES, 3)[np.searchsorted(every, keys), places] = vectors
    return field_that_holds(grid, bricks_of(grid, every), own)


def _read_exceptions(grid: Grid, data: bytes) -> tuple[list[int], list[int], bytes]:
    """Keys of bricks, samples within them, and forces of `exceptions_of`; CorruptFile or TruncatedFile."""
    keys, places = list[int](), list[int]()
    parts, forces, key, place = Parts(data, _APART), bytearray(), 0, -1
    while not parts.is_ended:
        gap = parts.varint("brick", math.prod(grid.brick_shape) - key)
        coded = parts.varint("sample", 2 * _SAMPLES)
        if keys and gap == 0 and coded >> 1 <= place:
            raise CorruptFile(_APART, f"sample {coded >> 1} after sample {place}", "ascending samples")
        key, place = key + gap, coded >> 1
        keys.append(key)
        places.append(place)
        forces += bytes(_VECTOR) if coded & 1 else parts.take(_VECTOR, "force")
    return keys, places, bytes(forces)

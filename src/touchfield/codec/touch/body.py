"""How the coder `touch` lays a segment out in bytes, and `HEAD.coder_parameters`."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Final

from touchfield.codec.rate import BitAccount
from touchfield.codec.segment import FrameCost, FrameKind, Worst
from touchfield.codec.touch.lattice import Lattice
from touchfield.codec.touch.spec import EFFORTS, MODES, SUPPORTS, TouchSpec
from touchfield.codec.varint import Parts, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, UnsupportedVersion
from touchfield.medium import Grid

_WHERE: Final = "SEGM.body"
_WORST_FLAG: Final = 1
_RATIOS: Final = 65535
_INTER, _GUESS, _EXCEPTIONS = 1, 2, 4
_MASK: Final = ("k", "f0_n")
NUMBERS: Final = {"mask": _MASK, "mask-direction": (*_MASK, "direction_jnd_deg"), "nmse": ("step_n",), "lossless": ()}
"""Of a spec, what a mode goes by."""


@dataclass(frozen=True)
class Promise:
    """Promise of a segment, and its worst voxel, found by the encoder on the decoder's own output."""

    mode: str  # see `TouchSpec`
    # k, f0_n: Weber fraction, and F_0 in newtons; None in a mode without them
    k: float | None
    f0_n: float | None
    direction_jnd_deg: float | None
    worst: Worst | None  # None in mode "nmse", which promises nothing. In mode "lossless" its ratio is 0

    @classmethod
    def of(cls, spec: TouchSpec, worst: Worst | None) -> Promise:
        """The promise of a mode."""
        mine = {
            name: getattr(spec, name) if name in NUMBERS[spec.mode] else None for name in NUMBERS["mask-direction"]
        }
        return cls(spec.mode, **mine, worst=worst)

    @property
    def worst_ratio(self) -> float | None:
        """The largest |error| / allowed."""
        return None if self.worst is None else self.worst.ratio

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        ratio, frame, voxel = self.worst or (None, None, None)
        told = {name: getattr(self, name) for name in ("mode", *NUMBERS["mask-direction"])}
        return {**told, "worst_ratio": ratio, "worst_frame": frame, "worst_voxel": voxel and list(voxel)}


@dataclass(frozen=True)
class TouchCost(FrameCost):
    """Cost of a frame, and how it was coded."""

    # guess_bits, exception_bits: the bits of what makes the guess, `BitAccount.models`; and of the side bits those of
    # voxels sent apart
    guess_bits: int
    exception_bits: int


@dataclass(frozen=True)
class FrameRecord:
    """A frame as a body holds it."""

    inter: bool  # whether the frame before is known: what it taught, and, unless there is a guess, its forces
    # guess, payload, exceptions: the guess and the exceptions are empty where there are none
    guess: bytes
    payload: bytes
    shares: tuple[int, int]  # support and amplitude of the payload, 1/255
    exceptions: bytes = b""

    @property
    def kind(self) -> FrameKind:
        """Kind of the frame: alone, or after the one before."""
        return FrameKind.INTER if self.inter else FrameKind.INTRA

    def to_bytes(self) -> bytes:
        """The frame in a body (docs/format/touch.md, "Body")."""
        how = _INTER * self.inter | _GUESS * bool(self.guess) | _EXCEPTIONS * bool(self.exceptions)
        chunks = (self.guess, self.payload, self.exceptions)
        kept = (bool(self.guess), True, bool(self.exceptions))
        parts = [write_varint(len(chunk)) + chunk for chunk, there in zip(chunks, kept, strict=True) if there]
        return bytes([how, *self.shares]) + b"".join(parts)

    @property
    def cost(self) -> TouchCost:
        """Cost of the frame; exceptions and lengths are side bits."""
        total, payload = 8 * len(self.to_bytes()), 8 * len(self.payload)
        support = payload * self.shares[0] // 255
        amplitude = payload * self.shares[1] // 255
        models = 8 * len(self.guess)
        bits = BitAccount(support, amplitude, payload - support - amplitude, total - payload - models, models=models)
        return TouchCost(self.kind, bits, models, 8 * len(self.exceptions))


def shares_of(bits: tuple[float, float, float]) -> tuple[int, int]:
    """Support and amplitude of the bits of support, amplitude and direction, 1/255."""
    total = sum(bits)
    if not total > 0:
        return 255, 0
    support = round(255 * bits[0] / total)
    return support, min(round(255 * bits[1] / total), 255 - support)


# -- writing ----------------------------------------------------------------------------------------------


def write_body(lattice: Lattice | None, records: Sequence[FrameRecord], worst: Worst | None) -> bytes:
    """The body of a segment; `lattice` is None in mode "lossless"."""
    parts = [bytes([_WORST_FLAG if worst else 0])]
    if lattice is not None:
        parts.append(lattice.to_bytes())
    if worst is not None:
        ratio = min(_RATIOS, math.ceil(worst.ratio * _RATIOS))
        parts += [struct.pack("<H", ratio), *map(write_varint, (worst.frame, *worst.voxel))]
    return b"".join([*parts, *(record.to_bytes() for record in records)])


# -- reading ----------------------------------------------------------------------------------------------


class BodyReader:
    """Reads a segment's body from front to back; CorruptFile or TruncatedFile for other bytes than the encoder's."""

    def __init__(self, body: bytes, grid: Grid, *, exact: bool) -> None:
        self._parts, self._exact = Parts(body), exact
        (flags,) = self._parts.take(1, "flags")
        if flags & ~_WORST_FLAG:
            raise CorruptFile(f"{_WHERE} flags", f"{flags:#x}", "bit 0 only")
        self.lattice = None if exact else Lattice.read(self._parts)
        self.worst = self._worst(grid) if flags & _WORST_FLAG else None

    def records(self, frame_count: int) -> Iterator[FrameRecord]:
        """The frames in turn, not decoded; the last one must end the body."""
        if self.worst is not None and self.worst.frame >= frame_count:
            raise CorruptFile(f"{_WHERE} worst frame", str(self.worst.frame), f"below {frame_count}")
        for i in range(frame_count):
            yield self._record(first=i == 0)
        self._parts.check_end()

    def _record(self, *, first: bool) -> FrameRecord:
        how, support, amplitude = self._parts.take(3, "frame")
        if how > (_INTER if self._exact else _INTER | _GUESS | _EXCEPTIONS):
            raise CorruptFile(f"{_WHERE} frame", f"{how:#x}", "bit 0 alone" if self._exact else "bits 0 to 2")
        if first and how & _INTER:
            raise CorruptFile(f"{_WHERE} frame", "a first frame that needs the one before", "one that stands alone")
        if support + amplitude > 255:
            raise CorruptFile(f"{_WHERE} frame shares", f"{support} and {amplitude}", "255 together at most")
        guess = self._parts.chunk("guess") if how & _GUESS else b""
        payload = self._parts.chunk("payload")
        exceptions = self._parts.chunk("exceptions") if how & _EXCEPTIONS else b""
        for what, bit, chunk in (("guess", _GUESS, guess), ("exceptions", _EXCEPTIONS, exceptions)):
            if how & bit and not chunk:
                raise CorruptFile(f"{_WHERE} {what}", "an empty chunk", "a byte at least, or none named")
        return FrameRecord(bool(how & _INTER), guess, payload, (support, amplitude), exceptions)

    def _worst(self, grid: Grid) -> Worst:
        (ratio,) = struct.unpack("<H", self._parts.take(2, "worst ratio"))
        frame = self._parts.varint("worst frame", 1 << 16)
        x, y, z = (self._parts.varint("worst voxel", n) for n in grid.shape)
        return Worst(ratio / _RATIOS, frame, (x, y, z))


_VERSION: Final = 1


def write_parameters(spec: TouchSpec) -> bytes:
    """The parameters of what was asked for."""
    asked = MODES.index(spec.mode) | SUPPORTS.index(spec.support) << 2 | EFFORTS.index(spec.effort) << 3
    numbers = [getattr(spec, name) for name in NUMBERS[spec.mode]]
    return struct.pack(f"<BB{len(numbers)}d", _VERSION, asked, *numbers)


def read_parameters(data: bytes, where: str) -> TouchSpec:
    """Spec that was asked for, as far as a file tells; UnsupportedVersion or CorruptFile for other bytes."""
    if len(data) < 2:
        raise CorruptFile(where, f"{len(data)} bytes", "2 or more")
    if data[0] != _VERSION:
        raise UnsupportedVersion(where, f"version {data[0]}", f"version {_VERSION}", "A newer touchfield reads it.")
    mode, support, effort = data[1] & 3, data[1] >> 2 & 1, data[1] >> 3
    if effort >= len(EFFORTS):
        raise CorruptFile(where, f"{data[1]:#x} for mode, support and effort", "an effort of 0 to 2")
    names = NUMBERS[MODES[mode]]
    if len(data) != 2 + 8 * len(names):
        raise CorruptFile(where, f"{len(data)} bytes", f"{2 + 8 * len(names)} bytes of mode {MODES[mode]}")
    numbers = dict(zip(names, struct.unpack_from(f"<{len(names)}d", data, 2), strict=True))
    if not all(map(math.isfinite, numbers.values())):
        raise CorruptFile(where, repr(numbers), "finite numbers")
    spec = TouchSpec(mode=MODES[mode], support=SUPPORTS[support], effort=EFFORTS[effort])
    try:
        return replace(spec, **numbers)
    except InvalidArgument as error:
        raise CorruptFile(where, f"{error.where} = {error.found}", error.expected) from None

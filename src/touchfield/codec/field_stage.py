"""A stage that codes a whole field (paper figure 4): to whole numbers and back, its support known to both sides.

A spec's ``fit(field)`` gives a `FieldStage`; `encode_field` writes the stage, the support (`codec.support`) and the
numbers (`codec.numbers`), so that stages differ in nothing but what they do themselves. The plain uniform lattice
and run-length coding are here, prediction is in `predictive`, transforms are in `spectral`.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Protocol, Self

import numpy as np

from touchfield.codec.numbers import LARGEST, decode_numbers, encode_numbers
from touchfield.codec.stage import Claim, unpacked
from touchfield.codec.support import decode_support, encode_support
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import BRICK

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int32s = NDArray[np.int32]
    Float32s = NDArray[np.float32]
    Mask = NDArray[np.bool_]

__all__ = [
    "FieldStage",
    "PlainStage",
    "RunStage",
    "StepStage",
    "decode_field",
    "encode_field",
    "stage_kinds",
]

_WHERE = "stage"


class FieldStage(Protocol):
    """A resolved stage for fields."""

    kind: ClassVar[int]
    """Its number in `stage_kinds`."""

    @property
    def claim(self) -> Claim:
        """The promise about each component of each supported force, newtons."""

    def encode(self, field: ForceField) -> Int32s:
        """The numbers of a field, int32 [m]."""

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """m where the support tells it; None where the stage tells it."""

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """Forces in newtons, float32 [n, 8, 8, 8, 3]; what the mask does not hold is ignored.

        `CorruptFile` where the numbers do not fit the support.
        """

    def to_bytes(self) -> bytes:
        """All that the decoder needs, but for the kind."""


def encode_field(stage: FieldStage, field: ForceField) -> bytes:
    """A field by a stage: kind, sized bytes of the stage and of the support, varint m, and the code of m numbers."""
    told, support = stage.to_bytes(), encode_support(field.grid, field.bricks, field.mask)
    numbers = stage.encode(field)
    head = bytes([stage.kind]) + write_varint(len(told)) + told + write_varint(len(support)) + support
    return head + write_varint(len(numbers)) + encode_numbers(numbers)


def decode_field(data: bytes, grid: Grid) -> ForceField:
    """The inverse of `encode_field`; a force that became zero is no longer in the support.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not what it writes.
    """
    if not data:
        raise TruncatedFile(_WHERE, "no byte", "a kind")
    kinds = stage_kinds()
    if data[0] not in kinds:
        raise CorruptFile(_WHERE, f"kind {data[0]}", f"one of {sorted(kinds)}")
    told, at = _part(data, 1)
    stage = kinds[data[0]].from_bytes(told)
    support, at = _part(data, at)
    bricks, mask = decode_support(support, grid)
    count, at = read_varint(data, at, f"{_WHERE}, numbers", 2 * 3 * BRICK**3 * len(bricks) + 1)
    expected = stage.count(bricks, mask)
    if expected is not None and count != expected:
        raise CorruptFile(_WHERE, f"{count} numbers", f"{expected}")
    forces = stage.decode(decode_numbers(data[at:], count), bricks, mask)
    forces[~mask] = 0
    if not np.isfinite(forces).all():
        raise CorruptFile(_WHERE, "a force that is not finite", "finite newtons")
    held = (forces != 0).any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks[held], forces[held])


def _part(data: bytes, at: int) -> tuple[bytes, int]:
    size, at = read_varint(data, at, f"{_WHERE}, size of a part")
    if size > len(data) - at:
        raise TruncatedFile(_WHERE, f"{len(data) - at} bytes", f"{size}")
    return data[at : at + size], at + size


class _Stage(FieldStage, Protocol):
    @classmethod
    def from_bytes(cls, data: bytes) -> FieldStage:
        """The inverse of `to_bytes`."""


def stage_kinds() -> dict[int, type[_Stage]]:
    """Every stage by its kind."""
    from touchfield.codec.predictive import AdpcmStage, DpcmStage
    from touchfield.codec.spectral import DctStage, WaveletStage

    return {s.kind: s for s in (PlainStage, RunStage, DpcmStage, AdpcmStage, WaveletStage, DctStage)}


# -- what stages share ------------------------------------------------------------------------------------


def lattice_points(values_n: NDArray[np.floating], step_n: float) -> NDArray[np.int64]:
    """The nearest multiples of a step; `InvalidArgument` where one is beyond what numbers reach."""
    if not 0 < step_n < np.inf:
        raise InvalidArgument("step_n", repr(step_n), "newtons above 0")
    points = np.rint(values_n.astype(np.float64) / step_n)
    if points.size and not np.abs(points).max() <= LARGEST >> 6:
        raise InvalidArgument("step_n", f"{step_n:g} N", "at least 2^-24 of the largest component")
    return points.astype(np.int64)


def step_from_bytes(data: bytes, layout: str = "<d") -> tuple[float, ...]:
    """A step, and what follows it in `layout`; `CorruptFile` where the step is none."""
    values = unpacked(layout, data, _WHERE)
    if not 0 < values[0] < np.inf:
        raise CorruptFile(_WHERE, f"a step of {values[0]!r} N", "newtons above 0")
    return values


def newtons(points: NDArray[np.integer], step_n: float) -> Float32s:
    """Multiples of a step; a stranger's may overflow, which `decode_field` refuses."""
    with np.errstate(over="ignore", invalid="ignore"):
        forces: Float32s = (points * np.float64(step_n)).astype(np.float32)
    return forces


def spread(vectors: Float32s, mask: Mask) -> Float32s:
    """Vectors of the supported samples, in the order of the bricks, as forces [n, 8, 8, 8, 3]."""
    forces = np.zeros((*mask.shape, 3), np.float32)
    forces[mask] = vectors
    return forces


@dataclass(frozen=True)
class StepStage:
    """What stages of one step and nothing else share.

    Attributes
    ----------
    step_n : float
        Newtons.
    """

    step_n: float

    @property
    def claim(self) -> Claim:
        """Half a step."""
        return Claim("absolute", self.step_n / 2)

    def to_bytes(self) -> bytes:
        """The step."""
        return struct.pack("<d", self.step_n)

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """The inverse of `to_bytes`."""
        return cls(step_from_bytes(data)[0])


@dataclass(frozen=True)
class PlainStage(StepStage):
    """Quantisation alone: multiples of a step, component by component, in raster order within each brick."""

    kind: ClassVar[int] = 0

    def encode(self, field: ForceField) -> Int32s:
        """See `FieldStage`."""
        return lattice_points(field.forces_n[field.mask], self.step_n).T.reshape(-1).astype(np.int32)

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """Three numbers for each sample."""
        return 3 * int(np.count_nonzero(mask))

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`."""
        return spread(newtons(numbers.reshape(3, -1).T, self.step_n), mask)


@dataclass(frozen=True)
class RunStage(StepStage):
    """Run-length coding: quantised vectors, each with how many of the next are equal to it."""

    kind: ClassVar[int] = 1

    def encode(self, field: ForceField) -> Int32s:
        """Run lengths less one, then the vectors component by component."""
        points = lattice_points(field.forces_n[field.mask], self.step_n)
        if not len(points):
            return np.zeros(0, np.int32)
        begins = np.flatnonzero(np.append(True, (points[1:] != points[:-1]).any(axis=1)))
        runs = np.diff(begins, append=len(points)) - 1
        return np.concatenate([runs, points[begins].T.reshape(-1)]).astype(np.int32)

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """Four numbers for each run, which the support does not tell."""
        return None

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`."""
        count = int(np.count_nonzero(mask))
        if len(numbers) % 4:
            raise CorruptFile(_WHERE, f"{len(numbers)} numbers", "four for each run")
        runs = numbers[: len(numbers) // 4].astype(np.int64) + 1
        if (runs < 1).any() or int(runs.sum()) != count:
            raise CorruptFile(_WHERE, "runs of another length", f"{count} samples")
        points = numbers[len(runs) :].reshape(3, -1).T
        return spread(np.repeat(newtons(points, self.step_n), runs, axis=0), mask)

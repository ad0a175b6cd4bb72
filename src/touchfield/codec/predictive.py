"""Predictive coding of a field over its scanned support: DPCM and ADPCM (paper section 2; figure 4, "predictive").

The paper names both as what haptic coders do and tells neither. Samples are scanned in raster order, z fastest, so
that each is predicted from its neighbour in depth wherever there is one, component by component, in closed loop:
from what the decoder holds. DPCM has one step and one weight, fitted to the field. ADPCM follows the signal: two
weights learn from the signs of what they miss, and the step grows where residuals are large and shrinks again
(Jayant's one-word memory), up to four times the finest.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from touchfield.codec.field_stage import FieldStage, lattice_points, newtons, step_from_bytes
from touchfield.codec.stage import Claim
from touchfield.errors import CorruptFile, InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import ForceField

    Int32s = NDArray[np.int32]
    Float32s = NDArray[np.float32]
    Mask = NDArray[np.bool_]

__all__ = ["AdpcmSpec", "AdpcmStage", "DpcmSpec", "DpcmStage"]

_UNIT = 256  # of DPCM's weight


@dataclass(frozen=True)
class DpcmSpec:
    """DPCM as asked for.

    Parameters
    ----------
    step_n : float
        Step of the residual, newtons.
    """

    step_n: float

    def fit(self, field: ForceField) -> DpcmStage:
        """The weight that leaves the least energy, from 0 to 1 in 256 parts."""
        points = lattice_points(field.vectors_n(), self.step_n).astype(np.float64)
        energy = float((points[:-1] ** 2).sum())
        weight = float((points[1:] * points[:-1]).sum()) / energy if energy > 0 else 1.0
        return DpcmStage(self.step_n, round(_UNIT * min(max(weight, 0.0), 1.0)))


@dataclass(frozen=True)
class DpcmStage:
    """DPCM, resolved.

    Attributes
    ----------
    step_n : float
        Newtons.
    weight : int
        Of the sample before, 0 to 256 parts of 256.
    """

    step_n: float
    weight: int
    kind: ClassVar[int] = 2

    @property
    def claim(self) -> Claim:
        """Half a step: the loop is closed, errors do not add up."""
        return Claim("absolute", self.step_n / 2)

    def encode(self, field: ForceField) -> Int32s:
        """Residuals, component by component."""
        points = lattice_points(field.vectors_n(), self.step_n)
        # predictions are whole steps, so that the decoder's value is the lattice point nearest to the original
        before = np.concatenate([np.zeros((min(1, len(points)), 3), np.int64), points[:-1]])
        return (points - ((self.weight * before + _UNIT // 2) >> 8)).T.reshape(-1).astype(np.int32)

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """Three numbers for each sample."""
        return 3 * int(np.count_nonzero(mask))

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`."""
        from touchfield.codec.kernels import predictive as kernels

        residuals = numbers.reshape(3, -1).astype(np.int64)
        points = np.stack([kernels.dpcm_decoded(r, self.weight) for r in residuals], axis=1)
        return _scattered(newtons(points, self.step_n), bricks, mask)

    def to_bytes(self) -> bytes:
        """Step and weight."""
        return struct.pack("<dH", self.step_n, self.weight)

    @classmethod
    def from_bytes(cls, data: bytes) -> FieldStage:
        """The inverse of `to_bytes`."""
        step_n, weight = step_from_bytes(data, "<dH")
        if weight > _UNIT:
            raise CorruptFile("DPCM weight", f"{weight}", f"{_UNIT} at most")
        return cls(step_n, int(weight))


@dataclass(frozen=True)
class AdpcmSpec:
    """ADPCM as asked for.

    Parameters
    ----------
    step_n : float
        The finest step, newtons.
    """

    step_n: float

    def fit(self, field: ForceField) -> AdpcmStage:
        """Nothing is fitted: all adapts."""
        return AdpcmStage(self.step_n)


@dataclass(frozen=True)
class AdpcmStage:
    """ADPCM, resolved.

    Attributes
    ----------
    step_n : float
        The finest step, newtons.
    """

    step_n: float
    kind: ClassVar[int] = 3

    @property
    def claim(self) -> Claim:
        """Half the coarsest step, and half a grain (a sixteenth of the finest) of rounding."""
        from touchfield.codec.kernels import predictive as kernels

        return Claim("absolute", self.step_n * (int(kernels.ADPCM_STEPS[-1]) + 1) / (2 * kernels.GRAIN))

    def encode(self, field: ForceField) -> Int32s:
        """Residuals, component by component."""
        from touchfield.codec.kernels import predictive as kernels

        grains = lattice_points(field.vectors_n(), self.step_n / kernels.GRAIN)
        residuals = np.zeros((3, len(grains)), np.int64)
        for values, out in zip(np.ascontiguousarray(grains.T), residuals, strict=True):
            kernels.adpcm(values, out, kernels.ADPCM_STEPS, False)
        return residuals.reshape(-1).astype(np.int32)

    def count(self, bricks: Int32s, mask: Mask) -> int | None:
        """Three numbers for each sample."""
        return 3 * int(np.count_nonzero(mask))

    def decode(self, numbers: Int32s, bricks: Int32s, mask: Mask) -> Float32s:
        """See `FieldStage`."""
        from touchfield.codec.kernels import predictive as kernels

        residuals = numbers.reshape(3, -1).astype(np.int64)
        grains = np.zeros_like(residuals)
        for values, read in zip(grains, residuals, strict=True):
            kernels.adpcm(values, read, kernels.ADPCM_STEPS, True)
        return _scattered(newtons(grains.T, self.step_n / kernels.GRAIN), bricks, mask)

    def to_bytes(self) -> bytes:
        """The step."""
        return struct.pack("<d", self.step_n)

    @classmethod
    def from_bytes(cls, data: bytes) -> FieldStage:
        """The inverse of `to_bytes`."""
        return cls(step_from_bytes(data)[0])


def _scattered(vectors: Float32s, bricks: Int32s, mask: Mask) -> Float32s:
    """Vectors in raster order of the grid as forces [n, 8, 8, 8, 3]."""
    from touchfield.medium.kernels import raster_slots

    forces = np.zeros((*mask.shape, 3), np.float32)
    if len(vectors) != np.count_nonzero(mask):
        raise InvalidArgument("vectors", f"{len(vectors)}", f"{np.count_nonzero(mask)}")
    forces.reshape(-1, 3)[raster_slots(bricks, mask)] = vectors
    return forces

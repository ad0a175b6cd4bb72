"""Measures the error of a decoded field against its original: NMSE (paper eq. 10), and the number of samples
whose error exceeds the perceptual mask.

Eq. 10 as printed sums unsquared norms in the numerator and has no sum in the denominator. Three readings:

* ``nmse_db`` = 10 log10(sum |e|^2 / sum |F|^2), the usual one and our default;
* ``nmse_literal_db`` = 20 log10(sum |e| / sum |F|), the printed norms with the missing sum added;
* ``nmse_forensic_db`` = 20 log10(sum |e|^2 / sum |F|^2), which comes closest to the figures of table 3.

All sums run over every voxel where either field is not zero. The mask max(F_0, k |F|) gives the number of
voxels with a larger error, and the largest ratio of error to mask.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from touchfield.arrays import Float32s
from touchfield.errors import InvalidArgument
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK
from touchfield.perception.grip import WeberCurve
from touchfield.perception.mask import SpatialMasking, Weber, violations

if TYPE_CHECKING:
    from touchfield.medium import ForceField


_CHUNK = 4096  # bricks at a time: 25 MB of float32 forces


class FidelityMeter:
    """Accumulated error of decoded frames against their originals.

    `k`: Weber fraction of the mask, a number or a function of the force. `f0_n`: F_0, absolute threshold of
    the mask, newtons, positive.
    `masking`: for spatial masking (`perception.mask`), beta, the fraction of the surrounding forces, and the
    radius in metres.
    """

    def __init__(self, k: Weber, f0_n: float, masking: tuple[float, float] | None = None) -> None:
        self.weber, self.f0_n = k, f0_n
        self.k = k.largest if isinstance(k, WeberCurve) else k
        if not (self.k >= 0 and f0_n > 0):
            raise InvalidArgument("mask", f"k = {self.k}, F_0 = {f0_n} N", "k >= 0 and F_0 > 0")
        self._masking = None if masking is None else SpatialMasking(0.0, 0.0, *masking)
        self.supported_voxels = 0
        self.compared_voxels = 0
        self.mask_violations = 0
        self.worst_mask_ratio = 0.0
        self._error1 = self._force1 = self._error2 = self._force2 = 0.0

    def add(self, original: ForceField, decoded: ForceField) -> None:
        """Compare one frame; both fields on one grid."""
        if original.grid.shape != decoded.grid.shape:
            raise InvalidArgument(
                "decoded field", f"shape {decoded.grid.shape}", f"the source's shape {original.grid.shape}"
            )
        original_keys = brick_keys(original.grid, original.bricks)
        keys = np.union1d(original_keys, brick_keys(decoded.grid, decoded.bricks))
        hidden = None if self._masking is None else self._masking.hidden_n(original)
        for start in range(0, len(keys), _CHUNK):
            part = keys[start : start + _CHUNK]
            masking = np.zeros((len(part), BRICK, BRICK, BRICK), np.float32)
            if hidden is not None:  # nothing is hidden in bricks without a force
                masking[np.isin(part, original_keys)] = hidden[np.isin(original_keys, part)]
            self._add_bricks(original.forces_at(part), decoded.forces_at(part), masking)

    def _add_bricks(self, original: Float32s, decoded: Float32s, hidden: Float32s) -> None:
        x, y = original.reshape(-1, 3), decoded.reshape(-1, 3)
        is_supported = (x != 0).any(axis=1) | (y != 0).any(axis=1)
        x, y = np.ascontiguousarray(x[is_supported]), np.ascontiguousarray(y[is_supported])
        violation = violations(x, y, self.weber, self.f0_n, masking_n=hidden.reshape(-1)[is_supported])
        self.mask_violations += violation.count
        self.worst_mask_ratio = max(self.worst_mask_ratio, violation.worst_ratio or 0.0)
        force2 = (x.astype(np.float64) ** 2).sum(axis=1)
        error2 = ((y.astype(np.float64) - x) ** 2).sum(axis=1)
        force, error = np.sqrt(force2), np.sqrt(error2)
        self.compared_voxels += len(x)
        self.supported_voxels += int(np.count_nonzero(force2))
        self._error1 += float(error.sum())
        self._force1 += float(force.sum())
        self._error2 += float(error2.sum())
        self._force2 += float(force2.sum())

    @property
    def mask_violation_share(self) -> float:
        """Violations as a fraction of the compared voxels."""
        return self.mask_violations / max(1, self.compared_voxels)

    @property
    def nmse_db(self) -> float | None:
        """10 log10 of the energy ratio; None if there is no error or no force."""
        return _db(10, self._error2, self._force2)

    @property
    def nmse_literal_db(self) -> float | None:
        """20 log10(sum |e| / sum |F|); None if there is no error or no force."""
        return _db(20, self._error1, self._force1)

    @property
    def nmse_forensic_db(self) -> float | None:
        """20 log10 of the energy ratio; None if there is no error or no force."""
        return _db(20, self._error2, self._force2)


def _db(factor: float, error: float, force: float) -> float | None:
    return factor * math.log10(error / force) if error > 0 and force > 0 else None

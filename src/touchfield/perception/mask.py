"""The perceptual mask max(F_0, k |F|), a bound on the error of a force F. This file computes the mask and
counts the errors that exceed it.

The paper (section 4.2) draws Delta(x) = k x alone (figure 2), which allows no error where the force is zero.
Departure: an absolute threshold F_0 below which any error is allowed; F_0 = 0 gives the paper's mask. k is a
number or a function of the force (`WeberCurve`). k and F_0 are thresholds of people under the conditions of
their sources (docs: perception.md); an error within the mask is within a bound, which does not prove that
nobody notices it.

A stimulus masks others close by; the paper mentions this without a formula. Ours::

    Delta_i = max(F_0, k |F_i| + beta sum_j w_ij |F_j|),    w_ii = 0,  sum_j w_ij = 1

w_ij falls with the distance d as exp(-2 d^2 / R^2), where R is the two-point threshold, the distance within
which two points are reported as one. It is zero if the distance along any axis exceeds R; cutting it off at a
cube makes the sum separable. There is no agreed value of beta: the default 0 gives the plain mask to the last
bit.

The sum runs over all surrounding samples; space without a force, also beyond the grid, is a stimulus of 0 N.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float32s, Float64s, lengths_of
from touchfield.errors import InvalidArgument, require_not_negative, require_one_of, require_positive
from touchfield.medium.field import padded_blocks
from touchfield.medium.grid import BRICK
from touchfield.perception.grip import WeberCurve
from touchfield.perception.human import figure, human

if TYPE_CHECKING:
    from touchfield.medium import ForceField

ROUNDING = 1e-9
"""An error above mask * (1 + ROUNDING) is a violation; ROUNDING exceeds the rounding of the comparison."""

_CHUNK = 1 << 16


class Violations(NamedTuple):
    """Violations of the mask by a decoded field: count, fraction, and largest ratio.

    worst_ratio : float or None; the largest |error| / mask; the guarantee holds if it is 1 or less. None if a
        force was decoded where the mask is zero (F = 0 and F_0 = 0).
    """

    count: int  # type: ignore[assignment]
    fraction: float
    worst_ratio: float | None


Weber = float | WeberCurve
"""A Weber fraction: a number, or a function of the force."""


def proportional_n(amplitudes_n: ArrayLike, k: Weber) -> Float64s:
    """Return k |F|, newtons, float64 [...]; `k` may be a function of |F|.

    `InvalidArgument` if a number `k` is negative or not finite.
    """
    sizes_n = np.abs(np.asarray(amplitudes_n, np.float64))
    if isinstance(k, WeberCurve):
        return k(sizes_n) * sizes_n
    require_not_negative(k=k)
    product_n: Float64s = k * sizes_n
    return product_n


def excess_n(amplitudes_n: ArrayLike, curve: WeberCurve) -> Float32s:
    """Return how much larger k(|F|) |F| is than with the smallest k, newtons, float32 [...].

    Rounded down, so that smallest k times |F| plus the result never exceeds k(|F|) |F|.
    """
    exact_n = proportional_n(amplitudes_n, curve) - proportional_n(amplitudes_n, curve.least)
    rounded_n = exact_n.astype(np.float32)
    down_n = np.nextafter(rounded_n, np.float32(0))
    below_n: Float32s = np.where(rounded_n > exact_n, down_n, rounded_n)
    return np.maximum(below_n, np.float32(0))


def mask_n(amplitudes_n: ArrayLike, k: Weber, f0_n: float = 0.0, *, masking_n: ArrayLike = 0.0) -> Float64s:
    """Return the mask max(F_0, k |F| + masking), newtons, float64 [...].

    amplitudes_n : float [...]; amplitudes |F|, newtons.
    k : float or WeberCurve; Weber fraction.
    masking_n : float [...], optional; the masking by stimuli at other sites, newtons.
    Raises `InvalidArgument` if `k` or `f0_n` (newtons) is negative or not finite.
    """
    require_not_negative(f0_n=f0_n)
    mask: Float64s = np.maximum(f0_n, proportional_n(amplitudes_n, k) + np.asarray(masking_n, np.float64))
    return mask


def violations(
    original_n: Float32s, decoded_n: Float32s, k: Weber, f0_n: float = 0.0, *, masking_n: ArrayLike = 0.0
) -> Violations:
    """Compare two fields sample by sample, in float64.

    original_n, decoded_n : float32 [L, 3]; forces at the same samples, newtons, including samples without
        force.
    k, f0_n, masking_n : as in `mask_n`; `masking_n` may have one value for each sample.
    Raises `InvalidArgument` if the shapes differ, a force is not finite, or `k` or `f0_n` is out of range.
    """
    mask_n(0.0, k, f0_n)  # checks both, also without a sample
    if original_n.shape != decoded_n.shape or original_n.ndim != 2 or original_n.shape[1] != 3:
        raise InvalidArgument(
            "forces to compare", f"{original_n.shape} and {decoded_n.shape}", "twice [L, 3]"
        )
    hidden = np.broadcast_to(np.asarray(masking_n, np.float64), len(original_n))
    count, worst, is_unbounded = 0, 0.0, False
    for start in range(0, len(original_n), _CHUNK):
        x = original_n[start : start + _CHUNK].astype(np.float64)
        error = decoded_n[start : start + _CHUNK].astype(np.float64) - x
        size = lengths_of(error)
        if not np.isfinite(size).all():
            raise InvalidArgument("forces to compare", "a force that is not finite", "finite newtons")
        mask = np.maximum(f0_n, proportional_n(lengths_of(x), k) + hidden[start : start + _CHUNK])
        count += int(np.count_nonzero(size > mask * (1 + ROUNDING)))
        has_mask = mask > 0
        is_unbounded = is_unbounded or bool((size[~has_mask] > 0).any())
        worst = max(worst, float((size[has_mask] / mask[has_mask]).max(initial=0.0)))
    fraction = count / len(original_n) if len(original_n) else 0.0
    return Violations(count, fraction, None if is_unbounded else worst)


MAX_REACH: Final = 64


def site_radius_m(site: str) -> float:
    """Return the two-point threshold of a body site, metres.

    InvalidArgument if there is no such site.
    """
    thresholds = human()["two_point_threshold_mm"]
    radii_mm = dict(zip(thresholds.of, thresholds.values, strict=True))
    require_one_of("body site", site, radii_mm)
    return radii_mm[site] / 1000


@dataclass(frozen=True)
class SpatialMasking:
    """The mask of one kind of skin, with masking by surrounding stimuli.

    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    k: float  # Weber fraction, 0 or more
    f0_n: float = 0.0  # absolute threshold F_0, 0 or more
    # fraction of the mean surrounding stimulus added to the mask, 0 or more; no agreed value
    beta: float = 0.0
    # R, positive; by default the two-point threshold of a finger, 2.5 mm
    radius_m: float = field(default_factory=lambda: figure("two_point_threshold_mm") / 1000)

    def __post_init__(self) -> None:
        require_not_negative(k=self.k, f0_n=self.f0_n, beta=self.beta)
        require_positive(radius_m=self.radius_m)

    def hidden_n(self, field: ForceField) -> Float32s:
        """Return beta times the mean |F| around each stored sample.

        Newtons, float32 [n, 8, 8, 8].
        """
        return replace(self, k=0.0, f0_n=0.0).field_mask_n(field)

    def field_mask_n(self, field: ForceField) -> Float32s:
        """Return the mask Delta at each stored sample, newtons, float32 [n, 8, 8, 8].

        With beta = 0 no neighbour is read. Raises `InvalidArgument` if beta > 0 and R is below the spacing
        along every axis with more than one sample, or above 64 samples.
        """
        levels = lengths_of(field.forces_n.astype(np.float64))
        if not self.beta or max(field.grid.shape) == 1 or not len(levels):
            return mask_n(levels, self.k, self.f0_n).astype(np.float32)
        grid = field.grid
        reach = [
            math.floor(min(self.radius_m / spacing_m * (1 + 1e-9), 1e9)) if count > 1 else 0
            for spacing_m, count in zip(grid.spacing_m, grid.shape, strict=True)
        ]
        if max(reach) > MAX_REACH:
            found = f"{self.radius_m:g}, {max(reach)} samples"
            raise InvalidArgument("radius_m", found, f"at most {MAX_REACH} samples")
        if not any(reach):
            nearest_m = min(h for h, n in zip(grid.spacing_m, grid.shape, strict=True) if n > 1)
            expected = f"at least the distance between neighbours, {nearest_m:g} m"
            raise InvalidArgument("radius_m", f"{self.radius_m:g}", expected, "Or take beta = 0.")
        # exp(-2 d^2 / R^2) at 0, 1, .. samples along each axis
        steps = zip(reach, np.array(grid.spacing_m) / self.radius_m)
        factors = [np.exp(-2 * (np.arange(count + 1) * step) ** 2) for count, step in steps]
        weight = self.beta / float(np.prod([2 * row.sum() - 1 for row in factors]) - 1)
        masks = np.empty(levels.shape, np.float32)
        for span, blocks in padded_blocks(field, levels, field.bricks, reach, reach):
            hidden_n = (
                _neighbour_sums(blocks, factors)[(slice(None), *(slice(r, r + BRICK) for r in reach))]
                * weight
            )
            masks[span] = mask_n(levels[span], self.k, self.f0_n, masking_n=hidden_n)
        return masks


def _neighbour_sums(levels: Float64s, factors: Sequence[Float64s]) -> Float64s:
    """Return the weighted sum over each sample's neighbours.

    `factors` has a row for each of the last axes, with the factors at distances 0, 1, ... No weight is
    negative, and the sample itself is never added and then subtracted, so that the sum is monotonic in every
    level to the last bit.
    """
    from scipy import ndimage

    others, everything = np.zeros_like(levels), levels
    for axis, row in zip(range(-1, -len(factors) - 1, -1), reversed(factors)):
        both_sides = np.concatenate([row[:0:-1], [0.0], row[1:]])
        neighbours = ndimage.correlate1d(everything, both_sides, axis=axis, mode="constant")
        others, everything = others + neighbours, everything + neighbours
    return others

"""The perceptual mask max(F_0, k |F|), and where a decoded field leaves it (paper section 4.2, figure 2).

The paper draws Delta(x) = k x alone, which allows no error at all where the force is zero. Departure: an absolute
floor F_0 below which nothing is felt; F_0 = 0 gives the paper's mask. What other sites close by hide (section 4.2,
left open there) enters as newtons added to k |F|, beta sum_j w_ij |F_j|, which the caller sums.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["ROUNDING", "Violations", "mask_n", "violations"]

ROUNDING = 1e-9
"""An error counts as a violation beyond mask (1 + ROUNDING), which is above the rounding of the comparison."""

_CHUNK = 1 << 16


class Violations(NamedTuple):
    """How often and how far a decoded field leaves the mask.

    count : int; samples whose error is beyond the mask.
    share : float; ``count`` over the number of samples; 0 for no sample.
    worst_ratio : float or None; the largest |error| / mask; 1 or less means that the promise is kept. None where no
        finite ratio exists: a force was decoded where the mask is zero (F = 0 and F_0 = 0).
    """

    count: int  # type: ignore[assignment]
    share: float
    worst_ratio: float | None


def _check(k: float, f0_n: float) -> None:
    if not 0 <= k < math.inf:
        raise InvalidArgument("k", repr(k), "a Weber fraction, 0 or more")
    if not 0 <= f0_n < math.inf:
        raise InvalidArgument("f0_n", repr(f0_n), "an absolute threshold in newtons, 0 or more")


def mask_n(
    amplitudes_n: ArrayLike, k: float, f0_n: float = 0.0, *, masking_n: ArrayLike = 0.0
) -> NDArray[np.float64]:
    """The mask max(F_0, k |F| + masking) of amplitudes |F| [...], newtons, float64 [...].

    amplitudes_n : float [...]
    k : float; weber fraction.
    f0_n : float; absolute threshold, newtons.
    masking_n : float [...], optional; what stimuli at other sites hide here, newtons.
    Raises `InvalidArgument` if `k` or `f0_n` is negative or not finite.
    """
    _check(k, f0_n)
    result: NDArray[np.float64] = np.maximum(
        f0_n, k * np.abs(np.asarray(amplitudes_n, np.float64)) + np.asarray(masking_n, np.float64)
    )
    return result


def violations(
    original_n: NDArray[np.float32],
    decoded_n: NDArray[np.float32],
    k: float,
    f0_n: float = 0.0,
    *,
    masking_n: ArrayLike = 0.0,
) -> Violations:
    """Compare two fields sample by sample, in float64.

    original_n, decoded_n : float32 [L, 3]; forces at the same samples, newtons. Samples without force belong to it,
        too: their mask is `f0_n`.
    k : float; weber fraction.
    f0_n : float; absolute threshold, newtons.
    masking_n : float [L], optional; what stimuli at other sites hide here, newtons (`touchfield.perception.masking`).
    Raises `InvalidArgument` if the shapes differ, a force is not finite, or `k` or `f0_n` is out of range.
    """
    _check(k, f0_n)
    if original_n.shape != decoded_n.shape or original_n.ndim != 2 or original_n.shape[1] != 3:
        raise InvalidArgument("forces to compare", f"{original_n.shape} and {decoded_n.shape}", "twice [L, 3]")
    hidden = np.broadcast_to(np.asarray(masking_n, np.float64), len(original_n))
    count, worst, beyond = 0, 0.0, False
    for begin in range(0, len(original_n), _CHUNK):
        x = original_n[begin : begin + _CHUNK].astype(np.float64)
        error = decoded_n[begin : begin + _CHUNK].astype(np.float64) - x
        size = np.sqrt(_squares(error))
        if not np.isfinite(size).all():
            raise InvalidArgument("forces to compare", "a force that is not finite", "finite newtons")
        mask = np.maximum(f0_n, k * np.sqrt(_squares(x)) + hidden[begin : begin + _CHUNK])
        count += int(np.count_nonzero(size > mask * (1 + ROUNDING)))
        held = mask > 0
        beyond = beyond or bool((size[~held] > 0).any())
        worst = max(worst, float((size[held] / mask[held]).max(initial=0.0)))
    share = count / len(original_n) if len(original_n) else 0.0
    return Violations(count, share, None if beyond else worst)


def _squares(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    x, y, z = vectors.T
    total: NDArray[np.float64] = x * x + y * y + z * z
    return total

"""The paper's perceptual quantiser, eq. 6, in its two possible readings.

Q(x) = sgn(x) Delta [|x| / Delta + 1/2]. The bracket must be the floor, or Q changes nothing but an offset.

* Literal, Delta = k |x|: then |x| / Delta = 1 / k whatever x is, and Q(x) = k floor(1/k + 1/2) x: a constant gain,
  the identity for k = 0.25, 0.1 and 0.05, and no quantiser.
* Fixed Delta: a uniform quantiser. Its error is at most Delta / 2, so that the mask k |x| is kept for certain only
  from |x| = Delta / (2 k) on, and is left by everything that falls to zero, 0 < |x| < Delta / 2.

The corrected quantiser, and the default, is `touchfield.perception.weber`.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["jnd_gain", "mask_kept_from_n", "quantise_fixed_step", "quantise_literal"]


def _check_fraction(k: float) -> None:
    if not 0 < k < math.inf:
        raise InvalidArgument("k", repr(k), "a positive Weber fraction, such as 0.1")


def _check_step(step_n: float) -> None:
    if not 0 < step_n < math.inf:
        raise InvalidArgument("step_n", repr(step_n), "a positive step in newtons")


def jnd_gain(k: float) -> float:
    """k floor(1/k + 1/2), the gain that eq. 6 with Delta = k |x| comes to."""
    _check_fraction(k)
    return k * math.floor(1 / k + 0.5)


def quantise_literal(forces_n: ArrayLike, k: float) -> NDArray[np.float64]:
    """Eq. 6 with Delta = k |x|, of forces [...] in newtons, float64 [...].

    By the gain, not sample by sample: |x| / (k |x|) is 1 / k in exact arithmetic only, and its rounding would
    decide the floor where 1/k + 1/2 is whole (k = 0.4).
    """
    return jnd_gain(k) * np.asarray(forces_n, np.float64)


def quantise_fixed_step(forces_n: ArrayLike, step_n: float) -> NDArray[np.float64]:
    """Eq. 6 with one Delta = `step_n` for all forces [...] in newtons, float64 [...]."""
    _check_step(step_n)
    x = np.asarray(forces_n, np.float64)
    result: NDArray[np.float64] = np.sign(x) * step_n * np.floor(np.abs(x) / step_n + 0.5)
    return result


def mask_kept_from_n(step_n: float, k: float) -> float:
    """Delta / (2 k), newtons: from this amplitude on a fixed step keeps the mask k |x|."""
    _check_fraction(k)
    _check_step(step_n)
    return step_n / (2 * k)

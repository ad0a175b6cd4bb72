"""Quincunx multiresolution of images (paper section 3.2, "optimal quincunx sampling and filtering").

A stage keeps the sites with n1 + n2 even, the lattice of D = [[1, 1], [1, -1]]; it predicts the others from their
four neighbours (sum / 4) and updates the kept ones (sum / 8). The next stage does the same along the diagonals, and
after two the image is at half its resolution along both axes (`touchfield.filters.lifting`).

Dropping half of the samples like this takes the spectrum to 1/2 [X(w) + X(w + (pi, pi))]. What lies in the diamond
|w1| + |w2| <= pi can be told from its image: a pattern along an axis passes up to the full Nyquist rate pi, where
decimation by 2 along each axis ends at pi/2 and folds it to a slow one; a diagonal pattern passes up to pi/2 along
each axis, as there. The predictor is the shortest filter for that diamond, and far from steep: with
P = (cos w1 + cos w2) / 2 it is 2 H0, H0 = 1/2 + P/2, halfband (H0(w) + H0(w + (pi, pi)) = 1); the coarse signal is
seen through 1 + P/2 - P^2/2, which is 1 both at w = 0 and on the edge of the diamond, and 0 at (pi, pi).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.filters import lifting
from touchfield.filters.sublattices import QUINCUNX

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["quincunx_coarse", "quincunx_forward", "quincunx_inverse", "quincunx_passband", "quincunx_responses"]


def quincunx_forward(image: ArrayLike, stages: int) -> NDArray[Any]:
    """The quincunx coefficients of an image [n1, n2, ...], each at its site; see `lifting.forward`."""
    return lifting.forward(image, QUINCUNX, stages, "image")


def quincunx_inverse(coefficients: ArrayLike, stages: int, dtype: Any = None) -> NDArray[Any]:
    """The image of quincunx coefficients; bit-exact for whole numbers. See `lifting.inverse`."""
    return lifting.inverse(coefficients, QUINCUNX, stages, dtype)


def quincunx_coarse(coefficients: ArrayLike, stages: int) -> lifting.LatticeSamples:
    """The coarse signal of quincunx coefficients with its positions [m, 2]; see `lifting.coarse_samples`."""
    return lifting.coarse_samples(coefficients, QUINCUNX, stages)


def quincunx_responses(w1: ArrayLike, w2: ArrayLike) -> tuple[Float64s, Float64s]:
    """The filters of the first stage, seen as filters of the whole image, at frequencies in radians a sample.

    Returns (float64 [...], float64 [...]): Of the analysis, 1 + P/2 - P^2/2, before the sites are dropped; and of the
    synthesis, 1 + P = 2 H0.
    """
    p = (np.cos(np.asarray(w1, np.float64)) + np.cos(np.asarray(w2, np.float64))) / 2
    analysis: Float64s = 1 + p / 2 - p * p / 2
    synthesis: Float64s = 1 + p
    return analysis, synthesis


def quincunx_passband(w1: ArrayLike, w2: ArrayLike) -> NDArray[np.bool_]:
    """Whether frequencies (radians a sample, any real) lie in the diamond that one stage can keep apart."""
    folded = [np.abs((np.asarray(w, np.float64) + np.pi) % (2 * np.pi) - np.pi) for w in (w1, w2)]
    held: NDArray[np.bool_] = folded[0] + folded[1] <= np.pi
    return held

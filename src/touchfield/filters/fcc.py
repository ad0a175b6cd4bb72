"""Face-centred cubic multiresolution of volumes and of image sequences (paper section 3.2, in three dimensions).

The FCC lattice n1 + n2 + n3 even is to x-y-z, or x-y-t, what the quincunx is to the plane. A stage predicts the other
half from their six neighbours (sum / 6) and updates (sum / 12). The second stage keeps n1 + n2 even and n3 even
(eight neighbours, / 8 and / 16), the third all even (four, / 4 and / 8): an octave, densities 1/2, 1/4 and 1/8.
`touchfield.filters.sublattices` says why the second is not body-centred; put t on the third axis.

The first stage can keep apart what lies in the truncated octahedron |w1| + |w2| + |w3| <= 3 pi / 2 within
the cube, half of its volume. The predictor is 2 H0, H0 = 1/2 + (cos w1 + cos w2 + cos w3) / 6, halfband again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.filters import lifting
from touchfield.filters.sublattices import FCC

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]

__all__ = ["fcc_coarse", "fcc_forward", "fcc_inverse", "fcc_passband", "fcc_responses"]


def fcc_forward(volume: ArrayLike, stages: int) -> NDArray[Any]:
    """The FCC coefficients of a volume [n1, n2, n3, ...], each at its site; see `lifting.forward`."""
    return lifting.forward(volume, FCC, stages, "volume")


def fcc_inverse(coefficients: ArrayLike, stages: int, dtype: Any = None) -> NDArray[Any]:
    """The volume of FCC coefficients; bit-exact for whole numbers. See `lifting.inverse`."""
    return lifting.inverse(coefficients, FCC, stages, dtype)


def fcc_coarse(coefficients: ArrayLike, stages: int) -> lifting.LatticeSamples:
    """The coarse signal of FCC coefficients with its positions [m, 3]; see `lifting.coarse_samples`."""
    return lifting.coarse_samples(coefficients, FCC, stages)


def fcc_responses(w1: ArrayLike, w2: ArrayLike, w3: ArrayLike) -> tuple[Float64s, Float64s]:
    """The filters of the first stage, seen as filters of the whole volume, at frequencies in radians a sample.

    Returns (float64 [...], float64 [...]): With P = (cos w1 + cos w2 + cos w3) / 3, of the analysis, 1 + P/2 - P^2/2,
    before the sites are dropped; and of the synthesis, 1 + P = 2 H0.
    """
    cosines: list[Float64s] = [np.cos(np.asarray(w, np.float64)) for w in (w1, w2, w3)]
    p = (cosines[0] + cosines[1] + cosines[2]) / 3
    analysis: Float64s = 1 + p / 2 - p * p / 2
    synthesis: Float64s = 1 + p
    return analysis, synthesis


def fcc_passband(w1: ArrayLike, w2: ArrayLike, w3: ArrayLike) -> NDArray[np.bool_]:
    """Whether frequencies (radians a sample, any real) lie in the cell that one stage can keep apart."""
    folded = [np.abs((np.asarray(w, np.float64) + np.pi) % (2 * np.pi) - np.pi) for w in (w1, w2, w3)]
    held: NDArray[np.bool_] = folded[0] + folded[1] + folded[2] <= 1.5 * np.pi
    return held

"""The lifting of both chains by their dimensions, and its expected results, for the tests."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from touchfield.filters.lifting import (
    FCC,
    QUINCUNX,
    SublatticeChain,
    fcc_forward,
    fcc_inverse,
    quincunx_forward,
    quincunx_inverse,
)

FORWARD = {2: quincunx_forward, 3: fcc_forward}
INVERSE = {2: quincunx_inverse, 3: fcc_inverse}


def coarse_mask(shape: tuple[int, ...], stages: int) -> NDArray[np.bool_]:
    """The sites of the coarse signal after some stages."""
    splits = {2: QUINCUNX, 3: FCC}[len(shape)].splits(stages)
    mask = np.full(shape, not splits)
    for residue in splits[-1].coarse if splits else ():
        mask[tuple(slice(r * splits[-1].scale, None, 2 * splits[-1].scale) for r in residue)] = True
    return mask


def coarse_only(array: NDArray[Any], chain: SublatticeChain, stages: int) -> NDArray[Any]:
    """The array rebuilt from its coarse signal, with zero details."""
    coefficients = chain.forward(array, stages)
    coefficients[~coarse_mask(coefficients.shape[: chain.dimensions], stages)] = 0
    return chain.inverse(coefficients, stages)


def mean_squares(coefficients: NDArray[Any], chain: SublatticeChain, stages: int) -> NDArray[np.float64]:
    """The mean square of the details of each stage, and finally that of the coarse signal."""
    masks = [coarse_mask(coefficients.shape[: chain.dimensions], stage) for stage in range(stages + 1)]
    parts = [before & ~after for before, after in zip(masks, masks[1:], strict=False)] + masks[-1:]
    return np.array([np.square(coefficients[part], dtype=np.float64).mean() for part in parts])


def stage_responses(*omegas: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The filters of the first stage of both chains: analysis before the decimation, and synthesis."""
    p = np.asarray(sum(np.cos(np.asarray(w, np.float64)) for w in omegas) / len(omegas))
    return np.asarray(1 + p / 2 - p * p / 2), np.asarray(1 + p)


def stage_passband(*omegas: Any) -> NDArray[np.bool_]:
    """Whether test frequencies (radians a sample, any real) are in the passband of one stage of
    both chains.
    """
    folded = [np.abs((np.asarray(w, np.float64) + np.pi) % (2 * np.pi) - np.pi) for w in omegas]
    return np.asarray(sum(folded) <= len(omegas) * np.pi / 2)

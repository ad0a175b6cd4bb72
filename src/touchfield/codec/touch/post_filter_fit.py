"""Which terms of the post filter a frame is worth: one after another by least squares, while they pay.

At an equal error a coder's bytes fall by some 7.5 % for each dB that something else takes off the error (measured on
rooms and solids); a term takes two bytes.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.touch.post_filter import GROUPS, TERMS, Terms, clip_of, filtered, links_of, members
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.medium import ForceField

    Doubles = NDArray[np.float64]

__all__ = ["error_of", "fitted", "worth"]

_A_DB: Final = 0.075
"""The share of a frame's bytes that a dB is worth."""

_HEAD, _TERM = 1, 2
_SAMPLES: Final = 5000
_MOST: Final = 24
_NEIGHBOURS: Final = 26
_INDEPENDENT: Final = 1e-4
"""A term is another one's sum where less than this share of it is new."""


def fitted(
    frame: ForceField, decoded: FixedField, lattice: Lattice, size: int, neighbours: int = 26
) -> tuple[Terms, FixedField] | None:
    """The terms worth their bytes in a frame of `size` bytes, and the filtered field; None where there are none.

    At most so many `neighbours` have a weight: each takes the decoder some 8 ns for a sample.
    """
    if not len(decoded.bricks):
        return None
    original = frame.forces_at(brick_keys(frame.grid, decoded.bricks))
    scale = 1.0 / float(np.float32(lattice.unit_n))
    before = error_of(frame, decoded, lattice)
    gram, wanted, share = _equations(frame, original, decoded, lattice, scale)
    if not gram.any() or before <= 0:
        return None
    # each sample stands for several; what is lost where nothing was decoded stays
    terms = _chosen(gram * share, wanted * share, before, size, neighbours)
    if not terms.numbers:
        return None
    made = filtered(decoded, terms, frame.grid, lattice)
    after = error_of(frame, made, lattice)
    return (terms, made) if worth(size, before, after) > _HEAD + _TERM * len(terms.numbers) else None


def worth(size: int, before: float, after: float) -> float:
    """The bytes that a smaller error is worth in a frame of `size` bytes; below 0 where it is larger."""
    return _A_DB * size * 10 * math.log10(max(before, 1e-300) / max(after, 1e-300))


def error_of(frame: ForceField, decoded: FixedField, lattice: Lattice) -> float:
    """The squared error of a frame, square units; of bricks that were not decoded, too."""
    scale = 1.0 / float(np.float32(lattice.unit_n))
    keys, own = brick_keys(frame.grid, decoded.bricks), brick_keys(frame.grid, frame.bricks)
    lost = frame.forces_n[~np.isin(own, keys)].astype(np.float64) * scale
    return _error(frame.forces_at(keys), decoded, scale) + float((lost * lost).sum())


def _error(original: NDArray[np.float32], decoded: FixedField, scale: float) -> float:
    """The squared error, units, of the bricks that were decoded."""
    difference = original * np.float32(scale) - decoded.vectors.astype(np.float32)
    return float(np.einsum("i,i->", difference.reshape(-1), difference.reshape(-1), dtype=np.float64))


def _equations(
    frame: ForceField, original: NDArray[np.float32], decoded: FixedField, lattice: Lattice, scale: float
) -> tuple[Doubles, Doubles, float]:
    """Normal equations of all terms from some of the samples, and how many samples each of them stands for."""
    from touchfield.codec.kernels import touch_post_filter as kernels

    held = np.flatnonzero(decoded.vectors.any(axis=-1))
    places = held[:: max(1, len(held) // _SAMPLES)]
    features = np.empty((3 * len(places), kernels.FEATURES))
    errors = np.empty(3 * len(places))
    links = links_of(frame.grid, decoded.bricks)
    kernels.gather(decoded.vectors, links, original, places, scale, clip_of(lattice), features, errors)
    spread = np.zeros((TERMS, kernels.FEATURES))
    for kind in range(3):
        spread[kind * GROUPS : (kind + 1) * GROUPS, 26 * kind : 26 * (kind + 1)] = members()
    spread[-1, -1] = 1
    gram = spread @ (features.T @ features) @ spread.T
    return gram, spread @ (features.T @ errors), len(held) / max(1, len(places))


def _chosen(gram: Doubles, wanted: Doubles, before: float, size: int, neighbours: int) -> Terms:
    """Orthogonal matching pursuit: the term that lowers the error most, what it explains taken off all others."""
    own = np.diag(gram)
    rest, free = wanted.copy(), own.copy()
    rows: list[Doubles] = []
    chosen: list[int] = []
    error = before
    seen = np.zeros((TERMS, _NEIGHBOURS), np.bool_)
    seen[:-1] = np.tile(members(), (3, 1))
    used = np.zeros(_NEIGHBOURS, np.bool_)
    while len(chosen) < _MOST:
        usable = (free > _INDEPENDENT * own) & ((seen | used).sum(axis=1) <= neighbours)
        usable[chosen] = False
        gain = np.where(usable, rest * rest / np.where(usable, free, 1), 0)
        best = int(gain.argmax())
        left = error - float(gain[best])
        if left <= 0 or worth(size, error, left) <= _TERM:
            break
        row = gram[best] - sum((r[best] * r for r in rows), np.zeros(TERMS))
        row /= math.sqrt(free[best])
        rest -= row * (rest[best] / math.sqrt(free[best]))
        free -= row * row
        rows.append(row)
        chosen.append(best)
        used |= seen[best]
        error = left
    if not chosen:
        return Terms((), ())
    weights = np.linalg.lstsq(gram[np.ix_(chosen, chosen)], wanted[chosen], rcond=None)[0]
    kept = sorted((n, code) for n, w in zip(chosen, weights.tolist(), strict=True) if (code := _code(w)) is not None)
    return Terms(tuple(n for n, _ in kept), tuple(code for _, code in kept))


def _code(weight: float) -> int | None:
    """The byte nearest to a weight; None of one that is nearly 0."""
    size = abs(weight) * (1 << 14)
    if size < 7:
        return None
    exponent = max(0, math.frexp(size)[1] - 4)
    mantissa = round(size / (1 << exponent))
    if mantissa > 15:
        exponent, mantissa = exponent + 1, 8
    exponent, mantissa = (exponent, max(mantissa, 8)) if exponent < 16 else (15, 15)
    return 128 * (weight < 0) | exponent << 3 | (mantissa - 8)

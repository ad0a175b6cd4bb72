"""Many chances mixed into one: the model of a bit in effort `max` of the coder `touch`, whole numbers only.

Each context keeps a chance that the next bit is 1; their logits, and logits that the caller derives otherwise, are
mixed by two sets of weights, whose mean an adaptive probability map corrects (logistic mixing as in the PAQ family;
prototyped in floating point first). No product reaches 2^53.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import ALL, FLOOR, RATES, SQUASH, STRETCH, narrow

__all__ = [
    "BIAS",
    "DECODE",
    "ENCODE",
    "INPUTS",
    "LOGITS",
    "PRICE",
    "PRICED",
    "SLOTS",
    "Mixer",
    "code_bit",
    "cost_of",
    "fresh_mixer",
    "logit",
    "predict",
    "slot_of",
    "squashed",
]

INPUTS = 40
BIAS = 77  # a logit of 0.3
_SLOT_BITS = 16
_LIMIT = 160
_BUCKETS = 33
_HALF_DOMAIN = 3072

SLOTS, LOGITS, _SCRATCH = 0, 1, 2

ENCODE, DECODE, PRICE = 0, 1, 2
"""What `code_bit` does."""

PRICED = 7
_P1, _P2, _P, _LOGIT = 0, 1, 2, 3


class Mixer(NamedTuple):
    """What a mixer has learnt, and its scratch; see `fresh_mixer`."""

    chances: np.ndarray  # 256 times a chance of 2^22, plus the visits: one look at memory for both
    weights: np.ndarray
    maps: np.ndarray
    io: np.ndarray
    spent: np.ndarray


def fresh_mixer(contexts: int, sets: int, maps: int, weight: int) -> Mixer:
    """A mixer that has learnt nothing; `weight` of 65536 is each input's at first."""
    weights = np.full((sets, INPUTS), weight, np.int64)
    edges = SQUASH[np.clip((np.arange(_BUCKETS) - 16) * 128 + _HALF_DOMAIN, 0, 2 * _HALF_DOMAIN - 1)].astype(np.int32)
    return Mixer(
        np.full(contexts << _SLOT_BITS, 1 << 29, np.int32),
        weights,
        np.tile(edges, (maps, 1)),
        np.zeros((3, INPUTS), np.int64),
        np.zeros(8, np.float64),
    )


@njit(**LEAN, inline="always")
def _clamped(x, low, high):
    return min(max(x, low), high)


@njit(**LEAN, inline="always")
def slot_of(which, context):
    """Where the chance of context number `which` with value `context` lies; values alike but for their last four bits
    lie together, within one line of the cache."""
    c = context >> 4
    c = (c ^ (c >> 23)) & 0xFFFFFFFF
    return (np.int64(which) << 16) | ((((c * 0x9E3779B1) & 0xFFFFFFFF) >> 16) ^ (context & 15))


@njit(**LEAN, inline="always")
def logit(p):
    """The logit, in 1/256, of a chance of 65536."""
    return np.int64(STRETCH[min(max(p, 0), 65535) >> 4])


@njit(**LEAN, inline="always")
def squashed(x):
    """The chance of 65536 of a logit in 1/256."""
    return np.int64(SQUASH[min(max(x, -_HALF_DOMAIN), _HALF_DOMAIN - 1) + _HALF_DOMAIN])


@njit(**LEAN)
def predict(m, n, more, first, second, where):
    """The chance of 65536 of a one, by `n` contexts (``m.io[SLOTS]``) and `more` logits (``m.io[LOGITS, n:]``)."""
    x1 = np.int64(0)
    x2 = np.int64(0)
    for i in range(n):
        m.io[LOGITS, i] = STRETCH[m.chances[m.io[SLOTS, i]] >> 18]
    m.io[LOGITS, n + more] = BIAS
    for i in range(n + more + 1):
        x1 += m.weights[first, i] * m.io[LOGITS, i]
        x2 += m.weights[second, i] * m.io[LOGITS, i]
    x1 = _clamped(x1 >> 16, -_HALF_DOMAIN, _HALF_DOMAIN - 1)
    x2 = _clamped(x2 >> 16, -_HALF_DOMAIN, _HALF_DOMAIN - 1)
    x = (x1 + x2) >> 1
    m.io[_SCRATCH, _P1] = SQUASH[x1 + _HALF_DOMAIN]
    m.io[_SCRATCH, _P2] = SQUASH[x2 + _HALF_DOMAIN]
    m.io[_SCRATCH, _LOGIT] = x
    place = _clamped(x + 2048, 0, 4095)
    i = place >> 7
    w = place & 127
    mapped = (m.maps[where, i] * (128 - w) + m.maps[where, i + 1] * w) >> 7
    p = (np.int64(SQUASH[x + _HALF_DOMAIN]) * 154 + mapped * 102) >> 8
    p = min(max(p, FLOOR), 65536 - FLOOR)
    m.io[_SCRATCH, _P] = p
    return p


@njit(**LEAN)
def cost_of(p, bit):
    """Bits that coding `bit` takes; for encoders and accounts only."""
    return -np.log2((p if bit else 65536 - p) / 65536.0)


@njit(**LEAN)
def code_bit(m, n, more, first, second, where, kind, bit, mode, state, buffer):
    """Code one bit by `predict`, and learn from it; its cost goes to ``m.spent[kind]``.

    With `mode` ``PRICE`` nothing is coded or learnt, and the cost goes to ``m.spent[PRICED]``.
    """
    p = predict(m, n, more, first, second, where)
    if mode == PRICE:
        m.spent[PRICED] += cost_of(p, bit)
        return bit
    bit = narrow(p, bit, mode == DECODE, state, buffer)
    if mode == ENCODE:
        m.spent[kind] += cost_of(p, bit)
    whole = bit << 16
    e1 = whole - m.io[_SCRATCH, _P1]
    e2 = whole - m.io[_SCRATCH, _P2]
    for i in range(n + more + 1):
        x = m.io[LOGITS, i]
        m.weights[first, i] += (x * e1 + 8192) >> 14
        m.weights[second, i] += (x * e2 + 8192) >> 14
    place = min(max(m.io[_SCRATCH, _LOGIT] + 2048, 0), 4095)
    i = place >> 7
    w = place & 127
    m.maps[where, i] += ((whole - m.maps[where, i]) * (128 - w)) // 6400
    m.maps[where, i + 1] += ((whole - m.maps[where, i + 1]) * w) // 6400
    for i in range(n):
        s = m.io[SLOTS, i]
        seen = np.int64(m.chances[s]) & 255
        chance = np.int64(m.chances[s]) >> 8
        chance += (((-bit & ALL) - chance) * np.int64(RATES[seen])) >> 19
        m.chances[s] = chance << 8 | (seen + (seen < _LIMIT))
    return bit

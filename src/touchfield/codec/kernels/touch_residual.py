"""Coding one component of a residual with many mixed models; whole numbers only.

Beside contexts stand parametric models: each of several predictors says where the component should lie (`centre`)
and how widely it has erred lately (`spread`), and a logistic distribution about it gives the chance of each decision.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import narrow
from touchfield.codec.kernels.touch_mixing import (
    DECODE,
    LOGITS,
    PRICE,
    PRICED,
    SLOTS,
    code_bit,
    logit,
    slot_of,
    squashed,
)

__all__ = ["EXPERTS", "code_component", "half_octaves", "level16", "within"]

EXPERTS = 5
MOST_UNARY = 20


@njit(**LEAN, inline="always")
def half_octaves(x):
    """2 log2(x) + 2 of a whole number, about; 0 for 0."""
    n = np.int64(0)
    y = x
    while y > 0:
        y >>= 1
        n += 1
    return 0 if n == 0 else 2 * n + (((x >> (n - 2)) & 1) if n >= 2 else 0)


@njit(**LEAN, inline="always")
def level16(x):
    """A size in 1/256 steps on 16 levels, half an octave each, 12 at one step."""
    return min(max(half_octaves(x) - 6, 0), 15)


@njit(**LEAN, inline="always")
def below(edge, centre, spread):
    """The chance of 65536 that a logistic variable lies below `edge`; all in 1/256 steps."""
    return squashed(((edge - centre) << 8) // spread)


@njit(**LEAN, inline="always")
def within(centre, spread):
    """The chance of 65536 that a component is 0."""
    return max(below(128, centre, spread) - below(-128, centre, spread), 8)


@njit(**LEAN)
def code_component(
    m, base, kind, contexts, n, centre, spread, size, value, nonzero, mode, state, buffer, maps
):  # fmt: skip
    """Code one component; `nonzero`: it is known not to be 0.

    base : first set of weights, and first map / 1; `size`: 0 to 7, how large residuals are about here.
    """
    given = abs(value)
    if not nonzero:
        for i in range(n):
            m.io[SLOTS, i] = slot_of(i, contexts[i] * 32)
        for j in range(EXPERTS):
            m.io[LOGITS, n + j] = logit(65536 - within(centre[j], spread[j]))
        bit = code_bit(
            m,
            np.int64(n),
            np.int64(EXPERTS),
            base,
            base + 1 + size,
            maps + size,
            kind,
            np.int64(given > 0),
            mode,
            state,
            buffer,
        )
        if bit == 0:
            return np.int64(0)
    for i in range(n):
        m.io[SLOTS, i] = slot_of(i, contexts[i] * 32 + 1)
    for j in range(EXPERTS):
        up = 65536 - below(128, centre[j], spread[j])
        down = below(-128, centre[j], spread[j])
        m.io[LOGITS, n + j] = logit((up << 16) // max(np.int64(1), up + down))
    positive = code_bit(
        m,
        np.int64(n),
        np.int64(EXPERTS),
        base + 9,
        base + 10 + size,
        maps + 8 + size,
        kind,
        np.int64(value > 0),
        mode,
        state,
        buffer,
    )
    sign = np.int64(1) if positive else np.int64(-1)
    k = np.int64(1)
    while k < MOST_UNARY:
        for i in range(n):
            m.io[SLOTS, i] = slot_of(i, contexts[i] * 32 + 1 + k)
        for j in range(EXPERTS):
            middle = centre[j] * sign
            least = 65536 - below(256 * k - 128, middle, spread[j])
            more = 65536 - below(256 * k + 128, middle, spread[j])
            m.io[LOGITS, n + j] = logit((more << 16) // max(np.int64(1), least))
        kk = min(k, 6)
        bit = code_bit(
            m,
            np.int64(n),
            np.int64(EXPERTS),
            base + 17 + kk,
            base + 24 + size,
            maps + 16 + min(k, 7),
            kind,
            np.int64(given > k),
            mode,
            state,
            buffer,
        )
        if bit == 0:
            return sign * k
        k += 1
    if mode == PRICE:
        m.spent[PRICED] += 2.0 * np.log2(given - MOST_UNARY + 1.0) + 1.0
        return value
    decoding = mode == DECODE
    # Elias gamma of what is left, in even chances
    rest = given - MOST_UNARY + 1
    bits = np.int64(0)
    if not decoding:
        while (rest >> (bits + 1)) > 0:
            bits += 1
    more_bits = np.int64(0)
    while narrow(32768, np.int64(more_bits < bits), decoding, state, buffer):
        more_bits += 1
        if more_bits >= 20:
            break
    found = np.int64(1)
    for i in range(more_bits - 1, -1, -1):
        found = (found << 1) | narrow(32768, (rest >> i) & 1, decoding, state, buffer)
    return sign * (found + MOST_UNARY - 1)

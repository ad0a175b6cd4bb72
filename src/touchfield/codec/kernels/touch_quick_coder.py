"""The arithmetic coder of the quick model of coder `touch`: that of `touch_light_coder`, its state held in registers.

The same bits as there. Every function takes ``source``, None when decoding: the compiler makes two programs of one
text, neither of which asks at run time which it is.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import RATES

__all__ = ["ROOM", "magnitude", "plain", "price", "quick"]

quick = njit(**LEAN, forceinline=True)
"""Compiled into whatever calls it, so that numbers stay in registers and arrays are not handed over."""

ROOM = 1 << 14
"""Bytes that the code of a tile cannot fill; a decoder's buffer has as many zeros behind the code."""

_ONE = 1 << 48
_LEAST = 1 << 32
_LIMIT = 126
_FLOOR = 8  # the least chance, of 65536


@quick
def _shift(source, span, x, place, data):
    """Move a word of 16 bits: `x` is the code's distance from the low end, or when encoding that low end."""
    at = np.uint64(place)
    if source is None:
        x = (x << 16) | np.int64(data[at]) << 8 | np.int64(data[at + np.uint64(1)])
    else:
        if x >= _ONE:
            x -= _ONE
            back = place - 1
            while data[back] == 255:
                data[back] = 0
                back -= 1
            data[back] += 1
        data[at] = x >> 40
        data[at + np.uint64(1)] = (x >> 32) & 255
        x = (x & (_LEAST - 1)) << 16
    return span << 16, x, place + 2


@quick
def _narrow(p, bit, source, span, x, place, data):
    bound = (span >> 16) * p
    if source is None:
        bit = np.int64(x < bound)
        if bit:
            span = bound
        else:
            x -= bound
            span -= bound
    elif bit:
        span = bound
    else:
        x += bound
        span -= bound
    if span < _LEAST:
        span, x, place = _shift(source, span, x, place, data)
    return bit, span, x, place


@quick
def plain(context, bit, source, span, x, place, data, chances):
    """Code one bit by the chance of one context: the bit, and the state after it."""
    c = np.uint64(context)
    packed = np.int64(chances[c])
    bit, span, x, place = _narrow(min(max(packed >> 16, _FLOOR), 65536 - _FLOOR), bit, source, span, x, place, data)
    seen = packed & 1023
    chance = packed >> 10
    chance += (((-bit & 4194303) - chance) * np.int64(RATES[seen])) >> 19
    chances[c] = (chance << 10) | (seen + np.int64(seen < _LIMIT))
    return bit, span, x, place


@quick
def magnitude(size, context, source, span, x, place, data, chances):
    """A number from 1: up to 14 in unary by 14 chances from `context`, then by its length."""
    k = np.int64(0)
    more = np.int64(1)
    while more and k < 14:
        k += 1
        more, span, x, place = plain(context + k - 1, np.int64(size > k), source, span, x, place, data, chances)
    if more == 0:
        return k, span, x, place
    half = np.int64(32768)
    rest = size - 14  # 1 or more
    length = np.int64(0)
    while more and length < 17:
        more, span, x, place = _narrow(half, np.int64((rest >> (length + 1)) > 0), source, span, x, place, data)
        length += more
    out = np.int64(1)
    for n in range(length - 1, -1, -1):
        bit, span, x, place = _narrow(half, (rest >> n) & 1, source, span, x, place, data)
        out = out << 1 | bit
    return 14 + out, span, x, place


@quick
def price(span, place):
    """Bits written so far; for the encoder's account only."""
    return 8.0 * place + 48.0 - np.log2(np.float64(span))

"""The arithmetic coder of the light models of coder `touch`, and how they code one decision.

A binary range coder of 48 bits that moves words of 16: ``x`` is the low end of the interval (encoder, with a carry
into what is written) or the distance of the code from it (decoder). A chance has 22 bits and a count of what it
has seen in one number of 32 bits. Whole numbers below 2^53 only; the same functions encode and decode.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN
from touchfield.codec.kernels.mixer import RATES, SQUASH, STRETCH

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "FRESH",
    "PLACE",
    "RANGE",
    "X",
    "bypass",
    "chance_of",
    "lean",
    "magnitude",
    "mixed",
    "mixed_magnitude",
    "plain",
    "price",
    "start",
    "stop",
]

X, RANGE, PLACE = 0, 1, 2
FRESH = 1 << 31
"""A chance of one half that has seen nothing."""

lean = njit(**LEAN)
"""Compiled, and neither counting references to arrays nor allocating any."""
_lean_inline = njit(**LEAN, inline="always")

_ONE = 1 << 48
_LEAST = 1 << 32
_DOMAIN = 3072
_LIMIT = 126
_FLOOR = 8  # the least chance, of 65536


def start(data: NDArray[np.uint8] | None) -> NDArray[np.int64]:
    """The state at the begin of a code: to be written (None) or of these bytes."""
    state = np.array([0, _ONE, 0], np.int64)
    if data is not None:
        state[X] = int.from_bytes(data[:6].tobytes().ljust(6, b"\0"), "big")
        state[PLACE] = 6
    return state


def stop(state: NDArray[np.int64], buffer: NDArray[np.uint8]) -> bytes:
    """All bytes of the code: those written, and the fewest that end it, zeros left away."""
    low, span, place = state.tolist()
    for count in (0, 2, 4, 6):
        spare = (1 << (48 - 8 * count)) - 1
        end = (low + spare) & ~spare
        if end < low + span:
            break
    done = int.from_bytes(b"\0" + buffer[:place].tobytes(), "big") + (end >> 48)
    return done.to_bytes(place + 1, "big")[1:] + (end & (_ONE - 1)).to_bytes(6, "big").rstrip(b"\0")


@lean
def _shift(decoding, state, buffer):
    place = state[PLACE]
    if decoding:
        word = np.int64(0)
        if place + 1 < buffer.shape[0]:
            word = (np.int64(buffer[place]) << 8) | np.int64(buffer[place + 1])
        elif place < buffer.shape[0]:
            word = np.int64(buffer[place]) << 8
        state[X] = (state[X] << 16) | word
    else:
        low = state[X]
        if low >= _ONE:
            low -= _ONE
            at = place - 1
            while buffer[at] == 255:
                buffer[at] = 0
                at -= 1
            buffer[at] += 1
        buffer[place] = low >> 40
        buffer[place + 1] = (low >> 32) & 255
        state[X] = (low & (_LEAST - 1)) << 16
    state[RANGE] <<= 16
    state[PLACE] = place + 2


@_lean_inline
def _narrow(p, bit, decoding, state, buffer):
    span = state[RANGE]
    bound = (span >> 16) * p
    if decoding:
        bit = np.int64(state[X] < bound)
        if bit:
            span = bound
        else:
            state[X] -= bound
            span -= bound
    elif bit:
        span = bound
    else:
        state[X] += bound
        span -= bound
    state[RANGE] = span
    if span < _LEAST:
        _shift(decoding, state, buffer)
    return bit


@_lean_inline
def _learn(context, packed, bit, limit, chances):
    seen = packed & 1023
    chance = packed >> 10
    chance += (((-bit & 4194303) - chance) * np.int64(RATES[seen])) >> 19
    chances[context] = (chance << 10) | (seen + np.int64(seen < limit))


@lean
def plain(context, bit, decoding, state, buffer, chances):
    """Code one bit by the chance of one context."""
    context = np.uint64(context)
    packed = np.int64(chances[context])
    bit = _narrow(min(max(packed >> 16, _FLOOR), 65536 - _FLOOR), bit, decoding, state, buffer)
    _learn(context, packed, bit, _LIMIT, chances)
    return bit


@lean
def mixed(first, second, third, chosen, bit, decoding, state, buffer, chances, weights):
    """Code one bit by the chances of three contexts, mixed by the weights `chosen`."""
    first = np.uint64(first)
    second = np.uint64(second)
    third = np.uint64(third)
    chosen = np.uint64(chosen)
    packed_a = np.int64(chances[first])
    packed_b = np.int64(chances[second])
    packed_c = np.int64(chances[third])
    a = np.int64(STRETCH[np.uint64(packed_a >> 20)])
    b = np.int64(STRETCH[np.uint64(packed_b >> 20)])
    c = np.int64(STRETCH[np.uint64(packed_c >> 20)])
    weight_a = weights[chosen, 0]
    weight_b = weights[chosen, 1]
    weight_c = weights[chosen, 2]
    x = (weight_a * a + weight_b * b + weight_c * c) >> 16
    p = np.int64(SQUASH[np.uint64(min(max(x, -_DOMAIN), _DOMAIN - 1) + _DOMAIN)])
    bit = _narrow(p, bit, decoding, state, buffer)
    error = (bit << 16) - p
    weights[chosen, 0] = weight_a + ((a * error + 8192) >> 14)
    weights[chosen, 1] = weight_b + ((b * error + 8192) >> 14)
    weights[chosen, 2] = weight_c + ((c * error + 8192) >> 14)
    _learn(first, packed_a, bit, _LIMIT, chances)
    _learn(second, packed_b, bit, _LIMIT, chances)
    _learn(third, packed_c, bit, _LIMIT, chances)
    return bit


@lean
def chance_of(first, second, third, chosen, chances, weights):
    """The chance of a one, of 65536, that `mixed` would code with."""
    a = np.int64(STRETCH[np.uint64(chances[np.uint64(first)] >> 20)])
    b = np.int64(STRETCH[np.uint64(chances[np.uint64(second)] >> 20)])
    c = np.int64(STRETCH[np.uint64(chances[np.uint64(third)] >> 20)])
    chosen = np.uint64(chosen)
    x = (weights[chosen, 0] * a + weights[chosen, 1] * b + weights[chosen, 2] * c) >> 16
    return np.int64(SQUASH[np.uint64(min(max(x, -_DOMAIN), _DOMAIN - 1) + _DOMAIN)])


@lean
def bypass(value, count, decoding, state, buffer):
    """`count` even bits, the highest first."""
    out = np.int64(0)
    for n in range(count - 1, -1, -1):
        out = (out << 1) | _narrow(np.int64(32768), (value >> n) & 1, decoding, state, buffer)
    return out


@lean
def _long(rest, decoding, state, buffer):
    """A number from 1: its length in unary, and its binary digits."""
    length = np.int64(0)
    while length < 17 and _narrow(np.int64(32768), np.int64((rest >> (length + 1)) > 0), decoding, state, buffer):
        length += 1
    return (np.int64(1) << length) | bypass(rest, length, decoding, state, buffer)


@lean
def magnitude(size, context, decoding, state, buffer, chances):
    """A number from 1: up to 14 in unary by 14 chances from `context`, then by its length."""
    k = np.int64(1)
    while k < 15:
        if plain(context + k - 1, np.int64(size > k), decoding, state, buffer, chances) == 0:
            return k
        k += 1
    return 14 + _long(size - 14, decoding, state, buffer)


@lean
def mixed_magnitude(size, first, second, third, chosen, decoding, state, buffer, chances, weights):
    """The same by the chances of three contexts, mixed by 14 weights from `chosen`."""
    for n in range(14):
        more = mixed(
            first + n, second + n, third + n, chosen + n, np.int64(size > n + 1), decoding, state, buffer, chances,
            weights,
        )  # fmt: skip
        if more == 0:
            return np.int64(n + 1)
    return 14 + _long(size - 14, decoding, state, buffer)


@lean
def price(state):
    """Bits written so far; for the encoder's account only."""
    return 8.0 * state[PLACE] + 48.0 - np.log2(np.float64(state[RANGE]))

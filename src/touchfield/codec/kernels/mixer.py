"""Compiled heart of the support coder: two mixed models before a binary arithmetic coder, integers only.

A model gives each context a chance that the next bit is 1 and learns from each bit; two such chances are mixed
on the logistic scale by weights that learn as well; a carry-less coder of 48 bits spends what the mixed chance
says. Every sum, product and shift is of whole numbers below 2^63, and the tables of the logistic function are
made of whole numbers too: equal bytes on every machine.

`narrow`, `learn` and `mixed` serve both directions, so that encoder and decoder cannot drift apart. They are
inlined where they are called: after a change here, the caller's compiled cache must be deleted.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numba import njit

from touchfield.codec.kernels.lean import LEAN

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["ALL", "FLOOR", "PLACE", "Coder", "Coding", "learn", "length_of", "mixed", "narrow"]

_HALF_DOMAIN = 3072  # the logistic function's argument reaches to +-12, in steps of 1/256
FLOOR = 4  # the least probability, of 65536
_RATE_LIMIT = 160
ALL = (1 << 22) - 1  # probabilities are kept in 22 bits


def _logistic_tables():
    """65536 / (1 + e^-x), its inverse, and learning rates, all by whole numbers."""
    one = 1 << 96
    step = term = one
    for k in range(1, 20):  # e^(1/256) by its series
        term = term // (256 * k)
        step += term
    power, half = one, []
    for _ in range(_HALF_DOMAIN):
        half.append((65536 * power + (one + power) // 2) // (one + power))
        power = power * step >> 96
    below = [65536 - p for p in reversed(half[1:])]
    squash = np.array([below[0], *below, *half], np.int64)
    stretch = np.searchsorted(squash, 16 * np.arange(4096) + 8) - _HALF_DOMAIN
    rates = (1 << 20) // (2 * np.arange(_RATE_LIMIT + 1) + 3)
    return (
        np.clip(squash, FLOOR, 65536 - FLOOR).astype(np.int32),
        stretch.astype(np.int16),
        rates.astype(np.int32),
    )


SQUASH, STRETCH, RATES = _logistic_tables()

_TOP = 40  # the coder's interval has 48 bits
_MASK = (1 << 48) - 1

# coder state
LOW, HIGH, VALUE, PLACE = 0, 1, 2, 3


class Coding(NamedTuple):
    """The arrays that the loops work on, and where the second model begins; they are compiled as `lean` says."""

    state: NDArray[np.int64]
    buffer: NDArray[np.uint8]
    chances: NDArray[np.int32]
    visits: NDArray[np.uint8]
    weights: NDArray[np.int64]
    second: int
    decoding: bool


class Coder:
    """The state of an arithmetic coder over a buffer, and of the two models that drive it.

    Parameters
    ----------
    buffer : uint8 [size]
        Where the encoder writes, or what the decoder reads; behind its end there are zeros.
    decoding : bool
    contexts : (int, int)
        Sizes of the two models.
    sets : int
        Sets of mixing weights.
    """

    def __init__(self, buffer: NDArray[np.uint8], decoding: bool, contexts: tuple[int, int], sets: int) -> None:
        self.buffer, self.decoding = buffer, decoding
        self.state = np.array([0, _MASK, 0, 0], np.int64)
        if decoding:
            first = np.zeros(6, np.uint8)
            first[: min(6, len(buffer))] = buffer[:6]
            self.state[VALUE] = int.from_bytes(first.tobytes(), "big")
        self.fresh_models(contexts, sets)

    def fresh_models(self, contexts: tuple[int, int], sets: int) -> None:
        """Forget what was learnt."""
        self.second = contexts[0]
        self.chances = np.full(sum(contexts), 1 << 21, np.int32)  # probabilities of a one, of 2^22
        self.visits = np.zeros(sum(contexts), np.uint8)
        self.weights = np.full((sets, 2), 32768 + 8192, np.int64)

    @property
    def coding(self) -> Coding:
        """The arrays that the loops work on."""
        models = self.chances, self.visits, self.weights
        return Coding(self.state, self.buffer, *models, self.second, self.decoding)

    def tail(self) -> tuple[int, bytes]:
        """Bytes written or used up so far, and the fewest that must follow to end the stream here."""
        low, high, _, place = self.state.tolist()
        for count in range(7):
            spare = (1 << (48 - 8 * count)) - 1
            end = (low + spare) & ~spare
            if end <= high:
                return place, end.to_bytes(7, "big")[1 : 1 + count]
        raise AssertionError("an empty interval")


@njit(**LEAN)
def _shift_out(coding):
    state, buffer = coding.state, coding.buffer
    low, high, value, place = state[LOW], state[HIGH], state[VALUE], state[PLACE]
    while (low ^ high) >> _TOP == 0:
        if coding.decoding:
            byte = np.int64(buffer[place + 6]) if place + 6 < buffer.shape[0] else np.int64(0)
            value = ((value << 8) & _MASK) | byte
        else:
            buffer[place] = high >> _TOP
        place += 1
        low = (low << 8) & _MASK
        high = ((high << 8) & _MASK) | 255
    state[LOW] = low
    state[HIGH] = high
    state[VALUE] = value
    state[PLACE] = place


@njit(cache=True, nogil=True, inline="always")
def narrow(p, bit, coding):
    """Code one bit, given (encoder) or found (decoder), whose chance to be 1 is `p` of 65536."""
    state = coding.state
    low = state[LOW]
    high = state[HIGH]
    span = high - low
    middle = low + (span >> 16) * p + (((span & 65535) * p) >> 16)
    if coding.decoding:
        bit = np.int64(state[VALUE] <= middle)
    if bit:
        high = middle
    else:
        low = middle + 1
    state[LOW] = low
    state[HIGH] = high
    if (low ^ high) >> _TOP == 0:
        _shift_out(coding)
    return bit


@njit(cache=True, nogil=True, inline="always")
def length_of(number):
    """Binary digits of a number from zero up."""
    bits = 0
    while number > 0:
        number >>= 1
        bits += 1
    return bits


@njit(cache=True, nogil=True, inline="always")
def learn(context, chance, bit, coding):
    seen = coding.visits[context]
    coding.chances[context] = chance + ((((-bit & ALL) - chance) * np.int64(RATES[seen])) >> 19)
    coding.visits[context] = seen + np.uint8(seen < _RATE_LIMIT)


@njit(cache=True, nogil=True, inline="always")
def mixed(first, second, chosen, bit, coding):
    """Code one bit in two contexts, mixed by the weights `chosen`, and learn from it."""
    weights = coding.weights
    chance_a = np.int64(coding.chances[first])
    chance_b = np.int64(coding.chances[second])
    a = np.int64(STRETCH[np.uint64(chance_a >> 10)])
    b = np.int64(STRETCH[np.uint64(chance_b >> 10)])
    weight_a = weights[chosen, 0]
    weight_b = weights[chosen, 1]
    x = (weight_a * a + weight_b * b) >> 16
    p = np.int64(SQUASH[np.uint64(min(max(x, -_HALF_DOMAIN), _HALF_DOMAIN - 1) + _HALF_DOMAIN)])
    bit = narrow(p, bit, coding)
    error = (bit << 16) - p
    weights[chosen, 0] = weight_a + ((a * error + 8192) >> 14)
    weights[chosen, 1] = weight_b + ((b * error + 8192) >> 14)
    learn(first, chance_a, bit, coding)
    learn(second, chance_b, bit, coding)
    return bit

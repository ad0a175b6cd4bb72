"""Bits: a binary range coder, adaptive chances, and their mixing (docs/format/bits.md).

A range coder of 48 bits that moves words of 16: `X` is the low end of the interval (encoder, with a carry into what
is written) or the distance of the code from it (decoder). A chance has 22 bits and a count of what it has seen in
one number of 32 bits. Several chances are mixed on the logistic scale by weights that learn as well. All is of whole
numbers below 2^62, the tables too: equal bytes on every machine. The same functions write, read and price: a caller
gives the bit, or anything when reading, and takes what is returned.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Float64s, Int32s, Int64s
from touchfield.lean import entry, inlined, lean

X, RANGE, PLACE, TASK = range(4)  # places in the state, int64 [4]
# tasks. An encoder that prices adds up in ``Bits.cost`` what bits would take, and changes nothing else
WRITING, READING, PRICING = range(3)
INPUTS: Final = 12  # chances mixed at once, at most
_ONE: Final = 1 << 48
_LEAST: Final = 1 << 32
_FLOOR: Final = 4  # the least chance, of 65536
_REACH: Final = 3071  # of the logistic function's argument, in steps of 1/256
_DECAY: Final = 2139111403  # 2^31 e^(-1/256)
_LIMIT: Final = 255  # visits after which a chance learns no more slowly
_FRESH: Final = 1 << 31  # a chance of a half, never seen
_RATE: Final = 14
_WEIGHT: Final = 14000


def _logistic_tables() -> tuple[Int32s, Int32s, Int32s]:
    """65536 / (1 + e^-x), its inverse, and learning rates, all by whole numbers."""
    power, half = 1 << 31, []  # 2^31 e^-x
    for _ in range(_REACH + 1):
        whole = (1 << 31) + power
        half.append(((1 << 47) + (whole >> 1)) // whole)
        power = power * _DECAY >> 31
    squash = np.array([65536 - p for p in reversed(half[1:])] + half, np.int64)
    stretch = np.searchsorted(squash, 16 * np.arange(4096) + 8) - _REACH
    rates = (1 << 20) // (2 * np.arange(1024) + 3)
    return np.clip(squash, _FLOOR, 65536 - _FLOOR).astype(np.int32), stretch.astype(np.int32), rates.astype(np.int32)


SQUASH, STRETCH, RATES = _logistic_tables()


class Bits(NamedTuple):
    """A range coder with its models."""

    state: Int64s  # [4]
    buffer: NDArray[np.uint8]  # [n]; takes the code, or holds it
    chances: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]; of the inputs that are mixed, 1/65536
    inputs: Int64s  # [INPUTS]; contexts of the next mixed bit
    drawn: Int64s  # [INPUTS]; room for their logits
    cost: Float64s  # [1]; bits priced


class Models(NamedTuple):
    """Chances and weights as a frame left them, for the next frame of the segment."""

    chances: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]


def fresh(contexts: int, sets: int) -> Models:
    """Models that have seen nothing."""
    return Models(np.full(contexts, _FRESH, np.uint32), np.full((sets, INPUTS), _WEIGHT, np.int32))


def _bits(state: list[int], buffer: NDArray[np.uint8], models: Models) -> Bits:
    room = np.zeros(INPUTS, np.int64), np.zeros(INPUTS, np.int64)
    return Bits(np.array(state, np.int64), buffer, models.chances, models.weights, *room, np.zeros(1))


def writer(room: int, models: Models) -> Bits:
    """A coder that writes up to `room` bytes; it changes `models`."""
    return _bits([0, _ONE, 0, WRITING], np.empty(room, np.uint8), models)


def reader(data: bytes, models: Models) -> Bits:
    """A coder that reads `data`, behind whose end there are zeros; it changes `models`."""
    first = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
    return _bits([first, _ONE, 6, READING], np.frombuffer(data, np.uint8).copy(), models)


def end_of(bits: Bits) -> bytes:
    """All bytes of the code: those written, and the fewest that end it, trailing zeros left away."""
    low, span, place, _ = bits.state.tolist()
    end = low
    for count in (0, 2, 4, 6):
        spare = (1 << (48 - 8 * count)) - 1
        end = (low + spare) & ~spare
        if end < low + span:
            break
    done = int.from_bytes(b"\0" + bits.buffer[:place].tobytes(), "big") + (end >> 48)
    return done.to_bytes(place + 1, "big")[1:] + (end & (_ONE - 1)).to_bytes(6, "big").rstrip(b"\0")


@lean
def _shift(state, buffer):
    """Move one word of 16 bits out of, or into, the interval."""
    place = state[PLACE]
    if state[TASK] == READING:
        word = np.int64(0)
        if place + 1 < buffer.shape[0]:
            word = (np.int64(buffer[place]) << 8) | np.int64(buffer[place + 1])
        elif place < buffer.shape[0]:
            word = np.int64(buffer[place]) << 8
        state[X] = (state[X] << 16) | word
    else:
        low = state[X]
        if low >= _ONE:  # a carry
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


@inlined
def _narrow(state, buffer, p, bit):
    """One bit that is 1 with the chance `p`, of 65536."""
    span = state[RANGE]
    bound = (span >> 16) * p
    if state[TASK] == READING:
        bit = np.int64(state[X] < bound)
    if bit:
        span = bound
    else:
        span -= bound
        if state[TASK] == READING:
            state[X] -= bound
        else:
            state[X] += bound
    state[RANGE] = span
    if span < _LEAST:
        _shift(state, buffer)
    return bit


@inlined
def _learn(chances, context, packed, bit):
    seen = packed & 1023
    chance = packed >> 10
    chance += (((-bit & 4194303) - chance) * np.int64(RATES[seen])) >> 19
    chances[context] = (chance << 10) | (seen + np.int64(seen < _LIMIT))


@lean
def _priced(bits, p, bit):
    bits.cost[0] -= np.log2(np.float64(p if bit else 65536 - p) / 65536.0)
    return bit


@entry
def code(bits, context, bit):
    """One bit by the chance of one context."""
    packed = np.int64(bits.chances[context])
    p = min(max(packed >> 16, np.int64(_FLOOR)), np.int64(65536 - _FLOOR))
    if bits.state[TASK] == PRICING:
        return _priced(bits, p, bit)
    bit = _narrow(bits.state, bits.buffer, p, bit)
    _learn(bits.chances, context, packed, bit)
    return bit


@lean
def mixed_chance(bits, count, chosen):
    """The chance of a 1, of 65536, by `count` contexts in ``bits.inputs`` and the weights `chosen`."""
    total = np.int64(0)
    for n in range(count):
        logit = np.int64(STRETCH[np.int64(bits.chances[bits.inputs[n]]) >> 20])
        bits.drawn[n] = logit
        total += logit * np.int64(bits.weights[chosen, n])
    x = min(max(total >> 16, np.int64(-_REACH)), np.int64(_REACH))
    return np.int64(SQUASH[x + _REACH])


@lean
def mix(bits, count, chosen, bit):
    """One bit by `count` contexts in ``bits.inputs``, mixed by the weights `chosen`."""
    p = mixed_chance(bits, count, chosen)
    if bits.state[TASK] == PRICING:
        return _priced(bits, p, bit)
    bit = _narrow(bits.state, bits.buffer, p, bit)
    error = (bit << 16) - p
    for n in range(count):
        bits.weights[chosen, n] += (bits.drawn[n] * error + (1 << (_RATE - 1))) >> _RATE
        context = bits.inputs[n]
        _learn(bits.chances, context, np.int64(bits.chances[context]), bit)
    return bit


@lean
def even(bits, value, count):
    """`count` even bits, the highest first."""
    if bits.state[TASK] == PRICING:
        bits.cost[0] += count
        return value & ((np.int64(1) << count) - 1)
    out = np.int64(0)
    for n in range(count - 1, -1, -1):
        out = (out << 1) | _narrow(bits.state, bits.buffer, np.int64(32768), (value >> n) & 1)
    return out


@lean
def gamma(bits, value, most):
    """A number from 1 on in Elias' gamma code, of even bits: below 2^(most + 1)."""
    digits = np.int64(0)
    while digits < most and even(bits, np.int64(value >> (digits + 1) > 0), np.int64(1)):
        digits += 1
    return (np.int64(1) << digits) | even(bits, value, digits)


@entry
def price(bits):
    """Bits written so far; for an encoder's account only."""
    return 8.0 * bits.state[PLACE] + 48.0 - np.log2(np.float64(bits.state[RANGE]))

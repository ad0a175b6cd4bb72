"""Bits: a binary range coder, adaptive chances, and their mixing (docs/format/bits.md).

A range coder of 48 bits that moves words of 16: `X` is the low end of the interval (encoder, with a carry
into what is written) or the distance of the code from it (decoder). A chance has 22 bits and a count of what
it has seen in one number of 32 bits. Several chances are mixed on the logistic scale by weights that learn as
well. All is of whole numbers below 2^62, the tables too: equal bytes on every machine. The same functions
write and read: a caller gives the bit, or anything when reading, and takes what is returned.

On these stand the loops of the support (a bit for each box of the octree of bricks, and for each sample) and
of whole numbers, each told by its sign and its binary digits in contexts of the three before it.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s
from touchfield.compute.jit import entry, inlined, lean

X, RANGE, PLACE, TASK = range(4)  # places in the state, int64 [4]
WRITING, READING = range(2)  # tasks
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
    return (
        np.clip(squash, _FLOOR, 65536 - _FLOOR).astype(np.int32),
        stretch.astype(np.int32),
        rates.astype(np.int32),
    )


SQUASH, STRETCH, RATES = _logistic_tables()


class Bits(NamedTuple):
    """A range coder with its models."""

    state: Int64s  # [4]
    buffer: NDArray[np.uint8]  # [n]; takes the code, or holds it
    chances: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]; of the inputs that are mixed, 1/65536
    inputs: Int64s  # [INPUTS]; contexts of the next mixed bit
    drawn: Int64s  # [INPUTS]; room for their logits


class Models(NamedTuple):
    """Chances and weights as a frame left them, for the next frame of the segment."""

    chances: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]

    def copy(self) -> Models:
        """Models that may be changed without these."""
        return Models(self.chances.copy(), self.weights.copy())


def fresh(contexts: int, sets: int) -> Models:
    """Models that have seen nothing."""
    return Models(np.full(contexts, _FRESH, np.uint32), np.full((sets, INPUTS), _WEIGHT, np.int32))


def _bits(state: list[int], buffer: NDArray[np.uint8], models: Models) -> Bits:
    room = np.zeros(INPUTS, np.int64), np.zeros(INPUTS, np.int64)
    return Bits(np.array(state, np.int64), buffer, models.chances, models.weights, *room)


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


@entry
def code(bits, context, bit):
    """One bit by the chance of one context."""
    packed = np.int64(bits.chances[context])
    p = min(max(packed >> 16, np.int64(_FLOOR)), np.int64(65536 - _FLOOR))
    bit = _narrow(bits.state, bits.buffer, p, bit)
    _learn(bits.chances, context, packed, bit)
    return bit


@lean
def mix(bits, count, chosen, bit):
    """One bit by `count` contexts in ``bits.inputs``, mixed by the weights `chosen`."""
    total = np.int64(0)
    for n in range(count):
        logit = np.int64(STRETCH[np.int64(bits.chances[bits.inputs[n]]) >> 20])
        bits.drawn[n] = logit
        total += logit * np.int64(bits.weights[chosen, n])
    x = min(max(total >> 16, np.int64(-_REACH)), np.int64(_REACH))
    p = np.int64(SQUASH[x + _REACH])
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


# the six faces, those told first before the others, and the six edges told before
NEIGHBOURS: Final = (
    (-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1),
    (-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1),
)  # fmt: skip
UNKNOWN: Final = 2  # state of a box that may hold bricks, for its parent does
_EDGES: Final = 1 + 729
_CHANGED: Final = _EDGES + 512
_FOUND: Final = _CHANGED + 16
LIST_CONTEXTS: Final = _FOUND + 4
LIST_SETS: Final = 2


class Level(NamedTuple):
    """Boxes of one size whose parents hold bricks."""

    keys: Int64s  # [n]; their places, ascending
    parents: Int64s  # [n]; their parents' places in the level above
    left: Int64s  # left, found: [parents]; children not told yet, and those that hold bricks
    found: Int64s
    before: NDArray[np.uint8]  # [n + 1]; 1 where the list known before has bricks; the last is 0
    state: NDArray[
        np.uint8
    ]  # [n + 1]; `UNKNOWN`, and when told 1 or 0; the last, of all that is not listed, is 0
    steps: Int64s  # steps, places: [12]; from a key to its neighbours', and where in `keys` they are
    places: Int64s


@entry
def code_level(bits, level, contexts_at, sets_at, wanted):
    """Tell which boxes hold bricks, when writing those `wanted`, uint8 [n]; an only child does untold."""
    count = level.keys.shape[0]
    for n in range(count):
        faces, edges, changed = np.int64(0), np.int64(0), np.int64(0)
        for k in range(12):
            key, place = level.keys[n] + level.steps[k], level.places[k]
            while place < count and level.keys[place] < key:
                place += 1
            level.places[k] = place
            if place == count or level.keys[place] != key:
                place = count
            state = np.int64(level.state[place])
            if k >= 6:
                edges = edges << 1 | state
            else:
                faces = faces * 3 + state
            if k < 3:
                edges = edges << 1 | state
                changed = changed << 1 | (state ^ np.int64(level.before[place]))
        old, parent, bit = np.int64(level.before[n]), level.parents[n], np.int64(1)
        level.left[parent] -= 1
        found = np.int64(level.found[parent] > 0)
        if found or level.left[parent]:
            bits.inputs[0] = contexts_at + 1 + (0 if old else faces)
            bits.inputs[1] = contexts_at + _EDGES + edges
            bits.inputs[2] = contexts_at + _CHANGED + 8 * old + changed
            bits.inputs[3] = contexts_at + _FOUND + 2 * old + found
            bit = mix(bits, np.int64(4), sets_at + old, np.int64(wanted[n]))
        level.state[n] = bit
        level.found[parent] += bit


_OLD: Final = 4096
SAMPLE_CONTEXTS: Final = _OLD + 1024
SAMPLE_SETS: Final = 8

_NEAR: Final = (-144, -12, -1, -143, -13, -11, -156, -288, -24, -132, -131, -2)
_LATE: Final = (0, -1, 1, -12, 12, -144, 144)
"""Steps in a window of 12 x 12 x 12 samples: to those told before, and to those of the support before."""


class Samples(NamedTuple):
    """The samples of n bricks, beside m that both sides know."""

    # [n + 1, 512]; 1 where a sample is set, as far as it is told; the last brick, of all that are not listed,
    # is 0
    held: NDArray[np.uint8]
    before: NDArray[np.uint8]  # [m + 1, 512]; the same of the support before
    # around, around_before: [n, 27]; places in both of each brick and of those around it, x slowest; -1 of
    # those not listed
    around: Int64s
    around_before: Int64s
    inside: Int64s  # [n, 3]; samples of a brick within the grid
    # window, old: [1728]; room for a brick of both, whose first sample is at (2, 2, 2), and what is around it
    window: NDArray[np.uint8]
    old: NDArray[np.uint8]


@entry
def code_samples(bits, contexts_at, sets_at, samples, wanted):
    """Tell which samples are set, when writing those `wanted`, uint8 [n, 512]; a code that is too short ends
    it.
    """
    held, window, old = samples.held, samples.window, samples.old
    for brick in range(wanted.shape[0]):
        if bits.state[TASK] == READING and bits.state[PLACE] > bits.buffer.shape[0] + 6:
            return
        for n in range(1728):
            x, y, z = n // 144 + 6, n // 12 % 12 + 6, n % 12 + 6
            near, place = (x >> 3) * 9 + (y >> 3) * 3 + (z >> 3), (x & 7) << 6 | (y & 7) << 3 | (z & 7)
            window[n] = held[samples.around[brick, near], place]
            old[n] = samples.before[samples.around_before[brick, near], place]
        for x in range(samples.inside[brick, 0]):
            for y in range(samples.inside[brick, 1]):
                for z in range(samples.inside[brick, 2]):
                    here, place = ((x + 2) * 12 + y + 2) * 12 + z + 2, x << 6 | y << 3 | z
                    mask, late = np.int64(0), np.int64(0)
                    for k in range(12):
                        mask |= np.int64(window[here + _NEAR[k]]) << k
                    for k in range(7):
                        late |= np.int64(old[here + _LATE[k]]) << k
                    bits.inputs[0] = contexts_at + mask
                    bits.inputs[1] = contexts_at + _OLD + (late << 3 | mask & 7)
                    window[here] = mix(
                        bits, np.int64(2), sets_at + (mask & 7), np.int64(wanted[brick, place])
                    )
                    held[brick, place] = window[here]


_LONGEST: Final = 62  # binary digits of the largest
_SIGN, _MORE, _SECOND = 1, 1, 16  # bit 0 is "not zero", 2 to 15 are "more digits", 18 to 31 the second digit
NUMBER_SETS: Final = 32
_AROUND: Final = NUMBER_SETS
_SIZES: Final = _AROUND + 125 * NUMBER_SETS
NUMBER_CONTEXTS: Final = _SIZES + 21 * 7 * NUMBER_SETS
# bytes that a writer has for a number: a bit costs 14 bits at most, and 65 that learn at most
NUMBER_ROOM: Final = 128


@lean
def _near(number):
    return min(max(number, np.int64(-2)), np.int64(2)) + 2


@lean
def _size(number, most):
    """Binary digits, `most` at most, with the sign, from 0 on."""
    size, left = np.int64(0), abs(number)
    while left > 0 and size < most:
        left >>= 1
        size += 1
    return most - size if number < 0 else most + size


@lean
def _code(bits, at, which, bit):
    bits.inputs[0] = at[0] + which
    bits.inputs[1] = at[1] + which
    bits.inputs[2] = at[2] + which
    return mix(bits, np.int64(3), at[3] + which, bit)


@entry
def code_numbers(bits, contexts_at, sets_at, numbers):
    """Write or read whole numbers, int64 [n]; those behind the end of a code that is read stay as they are."""
    r1, r2, r3 = np.int64(0), np.int64(0), np.int64(0)
    for i in range(numbers.shape[0]):
        near = (_near(r1) * 5 + _near(r2)) * 5 + _near(r3)
        sizes = _size(r1, np.int64(10)) * 7 + _size(r2, np.int64(3))
        at = (
            contexts_at, contexts_at + _AROUND + NUMBER_SETS * near,
            contexts_at + _SIZES + NUMBER_SETS * sizes, sets_at,
        )  # fmt: skip
        size, number = abs(numbers[i]), np.int64(0)
        if _code(bits, at, np.int64(0), np.int64(size > 0)):
            sign = _code(bits, at, np.int64(_SIGN), np.int64(numbers[i] < 0))
            length, more = np.int64(0), np.int64(1)
            while more and length < _LONGEST:
                length += 1
                more = _code(bits, at, _MORE + min(length, np.int64(14)), np.int64(size >> length > 0))
            number = np.int64(1)
            if length > 1:
                number = 2 | _code(bits, at, _SECOND + min(length, np.int64(15)), (size >> (length - 2)) & 1)
            if length > 2:
                rest = (np.int64(1) << (length - 2)) - 1
                number = number << (length - 2) | even(bits, size & rest, length - 2)
            number = -number if sign else number
        numbers[i] = number
        r3, r2, r1 = r2, r1, number
        if bits.state[TASK] == READING and bits.state[PLACE] > bits.buffer.shape[0] + 6:
            return

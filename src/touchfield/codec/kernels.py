"""Binary range coder with adaptive, mixed probabilities (docs/format/bits.md).

The range coder keeps an interval of 48 bits and reads or writes 16 bits at a time. `X` is the low end of the
interval in the encoder, which may carry into bytes already written; in the decoder it is the distance of the
code from the low end. A probability has 22 bits and is stored in 32 bits together with the number of bits it
has learnt from. Several probabilities are mixed on the logistic scale by weights, which adapt as well. All
arithmetic, including the tables, uses integers below 2^62, so that every machine writes the same bytes. One
function serves both directions: the caller passes the bit (ignored when reading) and uses the returned one.

The module also contains the loops that code the support (one bit for each box of the octree of bricks, and
one for each sample) and whole numbers (a sign and binary digits, with the three preceding numbers as
context).
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from touchfield.arrays import Int32s, Int64s
from touchfield.compute.coder_jit import entry, inlined, lean

X, RANGE, POSITION, TASK = range(4)  # indices into the state, int64 [4]
WRITING, READING = range(2)  # values of TASK
INPUTS: Final = 12  # maximum number of probabilities mixed at once
_FULL_RANGE: Final = 1 << 48
_MIN_RANGE: Final = 1 << 32
_MIN_PROBABILITY: Final = 4  # in 1/65536
_MAX_LOGIT: Final = 3071  # largest argument of the logistic function, in steps of 1/256
_DECAY: Final = 2139111403  # 2^31 e^(-1/256)
_MAX_COUNT: Final = 255  # visits after which the learning rate of a probability stays constant
_INITIAL_PROBABILITY: Final = 1 << 31  # one half, count 0
_WEIGHT_SHIFT: Final = 14
_INITIAL_WEIGHT: Final = 14000


def _logistic_tables() -> tuple[Int32s, Int32s, Int32s]:
    """The tables 65536 / (1 + e^-x), its inverse, and learning rates.

    They are computed with integers.
    """
    power, half = 1 << 31, []  # 2^31 e^-x
    for _ in range(_MAX_LOGIT + 1):
        whole = (1 << 31) + power
        half.append(((1 << 47) + (whole >> 1)) // whole)
        power = power * _DECAY >> 31
    squash = np.array([65536 - p for p in reversed(half[1:])] + half, np.int64)
    stretch = np.searchsorted(squash, 16 * np.arange(4096) + 8) - _MAX_LOGIT
    rates = (1 << 20) // (2 * np.arange(1024) + 3)
    return (
        np.clip(squash, _MIN_PROBABILITY, 65536 - _MIN_PROBABILITY).astype(np.int32),
        stretch.astype(np.int32),
        rates.astype(np.int32),
    )


SQUASH, STRETCH, RATES = _logistic_tables()


class Bits(NamedTuple):
    """A range coder with its models."""

    state: Int64s  # [4]
    buffer: NDArray[np.uint8]  # [n]; the code, written or to be read
    probabilities: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]; mixing weights, in 1/65536
    inputs: Int64s  # [INPUTS]; contexts of the next mixed bit
    logits: Int64s  # [INPUTS]; workspace for their logits


class Models(NamedTuple):
    """Probabilities and weights after a frame, for the next frame of the segment."""

    probabilities: NDArray[np.uint32]  # [contexts]
    weights: Int32s  # [sets, INPUTS]

    def copy(self) -> Models:
        """Copy of both arrays."""
        return Models(self.probabilities.copy(), self.weights.copy())


def new_models(contexts: int, sets: int) -> Models:
    """Models in their initial state: probabilities of contexts, and sets of weights."""
    probabilities = np.full(contexts, _INITIAL_PROBABILITY, np.uint32)
    return Models(probabilities, np.full((sets, INPUTS), _INITIAL_WEIGHT, np.int32))


def _bits(state: list[int], buffer: NDArray[np.uint8], models: Models) -> Bits:
    workspace = np.zeros(INPUTS, np.int64), np.zeros(INPUTS, np.int64)
    return Bits(np.array(state, np.int64), buffer, models.probabilities, models.weights, *workspace)


def writer(capacity: int, models: Models) -> Bits:
    """Range coder that writes up to `capacity` bytes; it updates `models` in place."""
    return _bits([0, _FULL_RANGE, 0, WRITING], np.empty(capacity, np.uint8), models)


def reader(data: bytes, models: Models) -> Bits:
    """Range coder that reads `data`, then zeros; it updates `models` in place."""
    first = int.from_bytes(data[:6].ljust(6, b"\0"), "big")
    return _bits([first, _FULL_RANGE, 6, READING], np.frombuffer(data, np.uint8).copy(), models)


def finish(bits: Bits) -> bytes:
    """End the code; return the bytes written and the fewest that complete it.

    Trailing zeros are omitted.
    """
    low, span, position, _ = bits.state.tolist()
    end = low
    for count in (0, 2, 4, 6):
        spare = (1 << (48 - 8 * count)) - 1
        end = (low + spare) & ~spare
        if end < low + span:
            break
    whole = int.from_bytes(b"\0" + bits.buffer[:position].tobytes(), "big") + (end >> 48)
    return whole.to_bytes(position + 1, "big")[1:] + (end & (_FULL_RANGE - 1)).to_bytes(6, "big").rstrip(
        b"\0"
    )


@lean
def _shift(state, buffer):
    """Move one word of 16 bits out of the interval (writing) or into it (reading)."""
    position = state[POSITION]
    if state[TASK] == READING:
        word = np.int64(0)
        if position + 1 < buffer.shape[0]:
            word = (np.int64(buffer[position]) << 8) | np.int64(buffer[position + 1])
        elif position < buffer.shape[0]:
            word = np.int64(buffer[position]) << 8
        state[X] = (state[X] << 16) | word
    else:
        low = state[X]
        if low >= _FULL_RANGE:  # a carry
            low -= _FULL_RANGE
            byte = position - 1
            while buffer[byte] == 255:
                buffer[byte] = 0
                byte -= 1
            buffer[byte] += 1
        buffer[position] = low >> 40
        buffer[position + 1] = (low >> 32) & 255
        state[X] = (low & (_MIN_RANGE - 1)) << 16
    state[RANGE] <<= 16
    state[POSITION] = position + 2


@inlined
def _narrow(state, buffer, probability, bit):
    """Code one bit that is 1 with `probability`, in 1/65536."""
    span = state[RANGE]
    bound = (span >> 16) * probability
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
    if span < _MIN_RANGE:
        _shift(state, buffer)
    return bit


@inlined
def _learn(probabilities, context, packed, bit):
    count = packed & 1023
    probability = packed >> 10
    probability += (((-bit & 4194303) - probability) * np.int64(RATES[count])) >> 19
    probabilities[context] = (probability << 10) | (count + np.int64(count < _MAX_COUNT))


@entry
def code(bits, context, bit):
    """Code one bit with the probability of one context."""
    packed = np.int64(bits.probabilities[context])
    probability = min(max(packed >> 16, np.int64(_MIN_PROBABILITY)), np.int64(65536 - _MIN_PROBABILITY))
    bit = _narrow(bits.state, bits.buffer, probability, bit)
    _learn(bits.probabilities, context, packed, bit)
    return bit


@lean
def mix(bits, count, weight_set, bit):
    """Code one bit with several contexts, mixed by one set of weights.

    The contexts are the first `count` of ``bits.inputs``.
    """
    total = np.int64(0)
    for n in range(count):
        logit = np.int64(STRETCH[np.int64(bits.probabilities[bits.inputs[n]]) >> 20])
        bits.logits[n] = logit
        total += logit * np.int64(bits.weights[weight_set, n])
    x = min(max(total >> 16, np.int64(-_MAX_LOGIT)), np.int64(_MAX_LOGIT))
    probability = np.int64(SQUASH[x + _MAX_LOGIT])
    bit = _narrow(bits.state, bits.buffer, probability, bit)
    error = (bit << 16) - probability
    for n in range(count):
        bits.weights[weight_set, n] += (bits.logits[n] * error + (1 << (_WEIGHT_SHIFT - 1))) >> _WEIGHT_SHIFT
        context = bits.inputs[n]
        _learn(bits.probabilities, context, np.int64(bits.probabilities[context]), bit)
    return bit


@lean
def even(bits, value, count):
    """Code the lowest `count` bits of `value`, the highest first, without a context.

    Each bit has probability 1/2.
    """
    out = np.int64(0)
    for n in range(count - 1, -1, -1):
        out = (out << 1) | _narrow(bits.state, bits.buffer, np.int64(32768), (value >> n) & 1)
    return out


@lean
def gamma(bits, value, max_digits):
    """Code a number from 1 to below 2^(max_digits + 1) in Elias' gamma code.

    The bits have probability 1/2 each (`even`).
    """
    digits = np.int64(0)
    while digits < max_digits and even(bits, np.int64(value >> (digits + 1) > 0), np.int64(1)):
        digits += 1
    return (np.int64(1) << digits) | even(bits, value, digits)


@entry
def price(bits):
    """Bits written so far, as a float: for an encoder's estimates only."""
    return 8.0 * bits.state[POSITION] + 48.0 - np.log2(np.float64(bits.state[RANGE]))


# steps to the six face neighbours of a box (the three already coded first) and to the six edge neighbours
# that are already coded
NEIGHBOURS: Final = (
    (-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1),
    (-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1),
)  # fmt: skip
UNKNOWN: Final = 2  # state of a box not coded yet whose parent contains bricks
_EDGES: Final = 1 + 729
_CHANGED: Final = _EDGES + 512
_OCCUPIED: Final = _CHANGED + 16
LIST_CONTEXTS: Final = _OCCUPIED + 4
LIST_SETS: Final = 2


class Level(NamedTuple):
    """Boxes of one octree level whose parents contain bricks."""

    keys: Int64s  # [n]; raster indices of the boxes, ascending
    parents: Int64s  # [n]; index of each box's parent in the level above
    remaining: Int64s  # [parents]; children not coded yet
    occupied: Int64s  # [parents]; coded children that contain bricks
    # [n + 1]; 1 where the reference list has bricks; the last entry is 0
    previous: NDArray[np.uint8]
    # [n + 1]; `UNKNOWN` until a box is coded, then 1 or 0; the last entry, 0, stands for all boxes not listed
    state: NDArray[np.uint8]
    steps: Int64s  # [12]; differences from a key to the keys of its neighbours
    indices: Int64s  # [12]; positions of these neighbours in `keys`


@entry
def code_level(bits, level, contexts_at, sets_at, target):
    """Code which boxes of a level contain bricks.

    `target`, uint8 [n], is 1 for boxes that do; it is read only when writing. The last child of a parent
    whose other children are all empty must contain bricks, so no bit is coded for it.
    """
    count = level.keys.shape[0]
    for n in range(count):
        faces, edges, changed = np.int64(0), np.int64(0), np.int64(0)
        for k in range(12):
            key, index = level.keys[n] + level.steps[k], level.indices[k]
            while index < count and level.keys[index] < key:
                index += 1
            level.indices[k] = index
            if index == count or level.keys[index] != key:
                index = count
            state = np.int64(level.state[index])
            if k >= 6:
                edges = edges << 1 | state
            else:
                faces = faces * 3 + state
            if k < 3:
                edges = edges << 1 | state
                changed = changed << 1 | (state ^ np.int64(level.previous[index]))
        previous, parent, bit = np.int64(level.previous[n]), level.parents[n], np.int64(1)
        level.remaining[parent] -= 1
        occupied = np.int64(level.occupied[parent] > 0)
        if occupied or level.remaining[parent]:
            bits.inputs[0] = contexts_at + 1 + (0 if previous else faces)
            bits.inputs[1] = contexts_at + _EDGES + edges
            bits.inputs[2] = contexts_at + _CHANGED + 8 * previous + changed
            bits.inputs[3] = contexts_at + _OCCUPIED + 2 * previous + occupied
            bit = mix(bits, np.int64(4), sets_at + previous, np.int64(target[n]))
        level.state[n] = bit
        level.occupied[parent] += bit


_PREVIOUS: Final = 4096
SAMPLE_CONTEXTS: Final = _PREVIOUS + 1024
SAMPLE_SETS: Final = 8

_CODED_STEPS: Final = (-144, -12, -1, -143, -13, -11, -156, -288, -24, -132, -131, -2)
_PREVIOUS_STEPS: Final = (0, -1, 1, -12, 12, -144, 144)
"""Steps in a window of 12 x 12 x 12 samples, to the coded neighbours and within the reference support."""


class Samples(NamedTuple):
    """Samples of n bricks to be coded, and of m bricks of the reference support."""

    # [n + 1, 512]; 1 where a coded sample is supported; the last row, 0, stands for all bricks not listed
    supported: NDArray[np.uint8]
    previous: NDArray[np.uint8]  # [m + 1, 512]; the same for the reference support
    # both [n, 27]; rows of a brick and of those around it (x slowest) in the arrays above; -1 if not listed
    neighbours: Int64s
    previous_neighbours: Int64s
    inside: Int64s  # [n, 3]; samples of a brick within the grid, along each axis
    # both [1728]; workspace of 12^3 samples: a brick, whose first sample is at (2, 2, 2), and its
    # surroundings
    window: NDArray[np.uint8]
    previous_window: NDArray[np.uint8]


@entry
def code_samples(bits, contexts_at, sets_at, samples, target):
    """Code which samples of the bricks are supported.

    `target`, uint8 [n, 512], is 1 for supported samples; its values are read only when writing. When reading,
    the function returns early if the code is too short.
    """
    supported, window, previous = samples.supported, samples.window, samples.previous_window
    for brick in range(target.shape[0]):
        if bits.state[TASK] == READING and bits.state[POSITION] > bits.buffer.shape[0] + 6:
            return
        for n in range(1728):
            x, y, z = n // 144 + 6, n // 12 % 12 + 6, n % 12 + 6
            neighbour, sample = (x >> 3) * 9 + (y >> 3) * 3 + (z >> 3), (x & 7) << 6 | (y & 7) << 3 | (z & 7)
            window[n] = supported[samples.neighbours[brick, neighbour], sample]
            previous[n] = samples.previous[samples.previous_neighbours[brick, neighbour], sample]
        for x in range(samples.inside[brick, 0]):
            for y in range(samples.inside[brick, 1]):
                for z in range(samples.inside[brick, 2]):
                    centre, sample = ((x + 2) * 12 + y + 2) * 12 + z + 2, x << 6 | y << 3 | z
                    mask, previous_mask = np.int64(0), np.int64(0)
                    for k in range(12):
                        mask |= np.int64(window[centre + _CODED_STEPS[k]]) << k
                    for k in range(7):
                        previous_mask |= np.int64(previous[centre + _PREVIOUS_STEPS[k]]) << k
                    bits.inputs[0] = contexts_at + mask
                    bits.inputs[1] = contexts_at + _PREVIOUS + (previous_mask << 3 | mask & 7)
                    window[centre] = mix(
                        bits, np.int64(2), sets_at + (mask & 7), np.int64(target[brick, sample])
                    )
                    supported[brick, sample] = window[centre]


_LONGEST: Final = 62  # binary digits of the largest number
# context 0 codes "not zero", 1 the sign, 2 to 15 "more digits", 18 to 31 the second digit
_SIGN, _MORE, _SECOND = 1, 1, 16
NUMBER_SETS: Final = 32
_LAST_THREE: Final = NUMBER_SETS
_SIZES: Final = _LAST_THREE + 125 * NUMBER_SETS
NUMBER_CONTEXTS: Final = _SIZES + 21 * 7 * NUMBER_SETS
# upper limit of a number's code: at most 65 adaptive bits, each of at most 14 bits
BYTES_PER_NUMBER: Final = 128


@lean
def _limited(number):
    return min(max(number, np.int64(-2)), np.int64(2)) + 2


@lean
def _size(number, max_digits):
    """Signed number of binary digits, at most `max_digits`, shifted to start at 0."""
    size, rest = np.int64(0), abs(number)
    while rest > 0 and size < max_digits:
        rest >>= 1
        size += 1
    return max_digits - size if number < 0 else max_digits + size


@lean
def _code(bits, offsets, index, bit):
    bits.inputs[0] = offsets[0] + index
    bits.inputs[1] = offsets[1] + index
    bits.inputs[2] = offsets[2] + index
    return mix(bits, np.int64(3), offsets[3] + index, bit)


@entry
def code_numbers(bits, contexts_at, sets_at, numbers):
    """Write or read whole numbers, int64 [n], in place.

    When reading, the numbers after the end of the code stay unchanged.
    """
    r1, r2, r3 = np.int64(0), np.int64(0), np.int64(0)
    for i in range(numbers.shape[0]):
        recent = (_limited(r1) * 5 + _limited(r2)) * 5 + _limited(r3)
        sizes = _size(r1, np.int64(10)) * 7 + _size(r2, np.int64(3))
        offsets = (
            contexts_at, contexts_at + _LAST_THREE + NUMBER_SETS * recent,
            contexts_at + _SIZES + NUMBER_SETS * sizes, sets_at,
        )  # fmt: skip
        size, number = abs(numbers[i]), np.int64(0)
        if _code(bits, offsets, np.int64(0), np.int64(size > 0)):
            sign = _code(bits, offsets, np.int64(_SIGN), np.int64(numbers[i] < 0))
            length, more = np.int64(0), np.int64(1)
            while more and length < _LONGEST:
                length += 1
                more = _code(bits, offsets, _MORE + min(length, np.int64(14)), np.int64(size >> length > 0))
            number = np.int64(1)
            if length > 1:
                second = (size >> (length - 2)) & 1
                number = 2 | _code(bits, offsets, _SECOND + min(length, np.int64(15)), second)
            if length > 2:
                rest = (np.int64(1) << (length - 2)) - 1
                number = number << (length - 2) | even(bits, size & rest, length - 2)
            number = -number if sign else number
        numbers[i] = number
        r3, r2, r1 = r2, r1, number
        if bits.state[TASK] == READING and bits.state[POSITION] > bits.buffer.shape[0] + 6:
            return

"""A second decoder of ``.touch`` files, which follows docs/format.md step by step: plain Python and numpy, slow.

`reference_objects` and `reference_touch`, beside it, are the parts for files of coders `objects` and `touch`; the
container is in `decoder`.

It shares no line with the package and uses nothing that the document does not say, so that it can tell whether the
document is enough and whether the package keeps to it. It is meant to be read beside the document.

``python conformance/reference_decoder.py FILE.touch OUT.npz``
"""

from __future__ import annotations

import argparse
import math
import re
import struct
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from itertools import combinations, product
from pathlib import Path
from typing import Any

import decoder as container
import numpy as np
from numpy.typing import NDArray

__all__ = ["codebook", "decode", "decode_bodies", "decode_body", "decode_support"]

Array = NDArray[Any]
Position = tuple[int, int, int]
Support = dict[Position, Array]
"""Bricks, ascending, and which of their samples are set, bool [8, 8, 8]."""

MOST_DENSE = 1 << 28
"""Samples of all frames that `decode` lays out; `decode_bodies` has no such limit."""


def need(condition: object, message: str) -> None:
    """Refuse the file unless `condition` holds."""
    if not condition:
        raise ValueError(message)


class Cursor:
    """Bytes, read from the first to the last and not beyond."""

    def __init__(self, data: bytes) -> None:
        self.data, self.at = data, 0

    def take(self, size: int) -> bytes:
        need(size <= len(self.data) - self.at, f"{size} bytes wanted, {len(self.data) - self.at} left")
        self.at += size
        return self.data[self.at - size : self.at]

    def numbers(self, codes: str) -> tuple[Any, ...]:
        values = struct.unpack("<" + codes, self.take(struct.calcsize("<" + codes)))
        need(all(math.isfinite(v) for v in values if isinstance(v, float)), "a number that is not finite")
        return values

    def number(self, code: str) -> Any:
        return self.numbers(code)[0]

    def text(self, most: int, least: int = 0, control: str = r"[\x00-\x1f\x7f-\x9f]") -> str:
        size = self.number("H")
        need(least <= size <= most, f"a text of {size} bytes")
        text = self.take(size).decode("utf-8")  # a UnicodeDecodeError is a ValueError
        need(not re.search(control, text), "a control character in a text")
        return text

    def octets(self, most: int) -> bytes:
        size = self.number("I")
        need(size <= most, f"{size} bytes in a field")
        return self.take(size)

    def varint(self) -> int:
        value = 0
        for place in range(8):
            byte: int = self.number("B")
            value |= (byte & 127) << (7 * place)
            if byte < 128:
                need(byte or not place, "a varint that is not in its shortest form")
                return value
        raise ValueError("a varint of more than 8 bytes")

    def chunk(self) -> bytes:
        return self.take(self.varint())

    def bit_chunk(self) -> list[int]:
        size = self.varint()
        data = self.take(-(-size // 8))
        bits: list[int] = np.unpackbits(np.frombuffer(data, np.uint8)).tolist()
        need(not any(bits[size:]), "bits behind the end of a bit chunk")
        return bits[:size]

    def end(self) -> None:
        need(self.at == len(self.data), f"{len(self.data) - self.at} bytes too many")


# -- the container ----------------------------------------------------------------------------------------


def read_file(data: bytes) -> tuple[dict[str, Any], list[tuple[int, bytes]]]:
    """The head as the parts for objects and for coder `touch` know it, and frame count and body of every segment."""
    file = container.read_file(data)
    head = {"shape": file.head["grid_shape"], "parameters": file.head["coder_parameters"], **file.head}
    need(head["coder"] in ("paper", "objects", "touch"), f"coder {head['coder']!r}")
    head["objects"] = [r.payload for r in container.read_records(data) if r.tag == "OBJT"]
    return head, [(segment.frame_count, segment.body) for segment in file.segments]


# -- directions -------------------------------------------------------------------------------------------


def unit(points: Array) -> Array:
    """Points [..., 3] on the unit sphere."""
    projected: Array = points / np.sqrt((points * points).sum(axis=-1, keepdims=True))
    return projected


def codebook(name: str) -> Array:
    """The vertices of a direction codebook, float32 [n, 3]."""
    match = re.fullmatch(r"(ico|octa)([1-9][0-9]?)(-flat)?", name)
    need(match, f"the codebook {name!r}")
    assert match is not None
    count, flat = int(match[2]), match[3] is not None
    if match[1] == "octa":
        need(count <= 5 and not flat, f"the codebook {name!r}")
        points = octahedron(count)
    else:
        need(count <= 20 and (count > 2 or not flat), f"the codebook {name!r}")
        points = icosahedron(count, flat)
    rounded = np.unique(np.rint(points * 2.0**40).astype(np.int64), axis=0)  # also sorts by x, y, z
    return (rounded * 2.0**-40).astype(np.float32)


def octahedron(times: int) -> Array:
    """All corners of the triangles, split in four `times` times."""
    triangles = np.array([np.diag(signs) for signs in product((1.0, -1.0), repeat=3)])
    for _ in range(times):
        a, b, c = triangles.swapaxes(0, 1)
        ab, bc, ca = unit(a + b), unit(b + c), unit(c + a)
        quarters = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        triangles = np.concatenate([np.stack(q, axis=1) for q in quarters])
    return triangles.reshape(-1, 3)


def icosahedron(parts: int, flat: bool) -> Array:
    """All points of its faces, each edge in `parts`."""
    golden = (1 + math.sqrt(5)) / 2
    corners = unit(np.array([np.roll((0.0, a, b * golden), s) for s in range(3) for a in (1, -1) for b in (1, -1)]))
    faces = [
        t for t in combinations(range(12), 3) if all(corners[p] @ corners[q] > 0.4 for p, q in combinations(t, 2))
    ]
    weights = [i / parts if flat else math.sin(math.atan(2) * i / parts) for i in range(parts + 1)]
    points = [
        weights[i] * corners[a] + weights[j] * corners[b] + weights[parts - i - j] * corners[c]
        for a, b, c in faces
        for i in range(parts + 1)
        for j in range(parts + 1 - i)
    ]
    return unit(np.array(points))


# -- amplitudes and Huffman codes -------------------------------------------------------------------------

RUN_SYMBOLS = 21


def amplitude_levels(data: bytes) -> Array:
    """The levels of an amplitude table, newtons, float32 [n]."""
    c = Cursor(data)
    kind = c.number("B")
    if kind == 0:
        count = c.number("H") + 1
        levels = np.array(c.numbers(f"{count}f"), np.float32)
    elif kind == 1:
        k, force_min_n, steps, criterion = c.numbers("ddHB")
        need(1e-5 <= k < 1 and 1e-30 <= force_min_n <= 1e30 and steps >= 1 and criterion <= 1, "a Weber table")
        kappa = (k / (2 + k) if criterion else k) - 2.0**-22
        ratio = (1 + kappa) / (1 - kappa)
        doubles, threshold = [0.0], force_min_n
        for _ in range(steps):
            doubles.append((1 + kappa) * threshold)
            threshold *= ratio
        need(doubles[-1] < 1e30, "a Weber table beyond any force")
        levels = np.array(doubles).astype(np.float32)
    else:
        need(kind == 2, f"an amplitude table of kind {kind}")
        step_n, count = c.numbers("dI")
        need(1e-30 <= step_n <= 1e30 and 1 <= count <= 1 << 16, "a uniform table")
        need(step_n * (count - 1) < 1e30, "a uniform table beyond any force")
        levels = np.array([step_n * i for i in range(count)]).astype(np.float32)
    c.end()
    need(levels[0] >= 0 and (np.diff(levels) > 0).all() and levels[-1] <= 1e6, "the order or range of the levels")
    need(len(levels) + RUN_SYMBOLS <= 1 << 16, f"{len(levels)} levels")
    return levels


Code = dict[tuple[int, int], int]
"""(length, code) to symbol."""


def huffman_code(data: bytes, symbol_count: int) -> Code:
    """A canonical code from its table of lengths."""
    nibbles = [n for byte in data for n in (byte >> 4, byte & 15)]
    nibbles.reverse()

    def take() -> int:
        need(nibbles, "the end of a Huffman table")
        return nibbles.pop()

    lengths: list[int] = []
    last = 8
    while len(lengths) < symbol_count:
        token = take()
        need(token <= 11, f"token {token} in a Huffman table")
        if token <= 9:
            last = last + token - 4 if token < 9 else take() << 4 | take()
            need(1 <= last <= 24, f"a code of {last} bits")
            lengths.append(last)
        else:
            run = 1 if token == 10 else 2 + run_count(take)
            need(len(lengths) + run <= symbol_count, "a run beyond the symbols of a Huffman table")
            lengths += [0] * run
    need(len(lengths) == symbol_count and len(nibbles) < 2 and not any(nibbles), "the end of a Huffman table")
    present = sorted((bits, symbol) for symbol, bits in enumerate(lengths) if bits)
    total = sum(1 << (24 - bits) for bits, _ in present)
    need(total == 1 << 24 or not present or (len(present) == 1 and present[0][0] == 1), "an incomplete code")
    code: Code = {}
    value = before = 0
    for bits, symbol in present:
        value <<= bits - before
        code[bits, value] = symbol
        value, before = value + 1, bits
    return code


def run_count(take: Callable[[], int]) -> int:
    """A number in nibbles of three bits, the lowest first."""
    count = 0
    for place in range(6):
        nibble = take()
        count |= (nibble & 7) << (3 * place)
        if nibble < 8:
            return count
    raise ValueError("a run of more than 6 nibbles in a Huffman table")


class BitReader:
    """The bits of a bit chunk, and the codes in it."""

    def __init__(self, bits: list[int]) -> None:
        self.bits, self.at = bits, 0

    def raw(self, count: int) -> int:
        need(self.at + count <= len(self.bits), "the end of a bit chunk")
        self.at += count
        return int("0" + "".join(map(str, self.bits[self.at - count : self.at])), 2)

    def symbol(self, code: Code) -> int:
        value = 0
        for length in range(1, 25):
            value = value << 1 | self.raw(1)
            if (length, value) in code:
                return code[length, value]
        raise ValueError("bits that are no code")

    def end(self) -> None:
        need(self.at == len(self.bits), "bits that are left over")


def amplitude_stream(bits: list[int], code: Code, level_count: int, samples: int) -> list[int | None]:
    """For each sample its level, or None where it is held."""
    reader = BitReader(bits)
    out: list[int | None] = []
    while len(out) < samples:
        symbol = reader.symbol(code)
        if symbol < level_count:
            out.append(symbol)
            continue
        j = symbol - level_count
        run = (1 << j) + reader.raw(j)
        need(len(out) + run <= samples, "a run beyond the last sample")
        out += [None] * run
    reader.end()
    return out


# -- the support ------------------------------------------------------------------------------------------


def logistic_tables() -> tuple[list[int], list[int]]:
    """Squash of -3072 .. 3071, and stretch of 0 .. 4095, by whole numbers."""
    one = 1 << 96
    step = term = one
    for n in range(1, 20):
        term //= 256 * n
        step += term
    power, upper = one, []
    for _ in range(3072):
        upper.append((65536 * power + (one + power) // 2) // (one + power))
        power = power * step >> 96
    squash = [65536 - upper[max(1, min(-x, 3071))] if x < 0 else upper[x] for x in range(-3072, 3072)]
    stretch, x = [], -3072
    for n in range(4096):
        while squash[x + 3072] < 16 * n + 8:
            x += 1
        stretch.append(x)
    return [max(4, min(s, 65532)) for s in squash], stretch


SQUASH, STRETCH = logistic_tables()
RATES = [(1 << 20) // (2 * n + 3) for n in range(161)]
CERTAIN = (1 << 22) - 1


@dataclass
class Coder:
    """The arithmetic decoder: an interval of 48 bits."""

    data: bytes
    used: int = 0
    low: int = 0
    high: int = (1 << 48) - 1
    value: int = field(init=False)

    def __post_init__(self) -> None:
        self.value = int.from_bytes(self.data[:6].ljust(6, b"\0"), "big")

    def bit(self, p: int) -> int:
        """The next bit, whose chance to be 1 is p / 65536."""
        span = self.high - self.low
        middle = self.low + (span >> 16) * p + ((span & 65535) * p >> 16)
        bit = int(self.value <= middle)
        if bit:
            self.high = middle
        else:
            self.low = middle + 1
        while self.low >> 40 == self.high >> 40:
            byte = self.data[self.used + 6] if self.used + 6 < len(self.data) else 0
            need(self.used < len(self.data), "the end of a support")
            self.used += 1
            mask = (1 << 48) - 1
            self.value = (self.value << 8 & mask) | byte
            self.low = self.low << 8 & mask
            self.high = (self.high << 8 & mask) | 255
        return bit

    def ending(self) -> bytes:
        """The fewest bytes that name a number within the interval."""
        for count in range(7):
            unit_size = 1 << (48 - 8 * count)
            number = -(-self.low // unit_size) * unit_size
            if number <= self.high:
                return number.to_bytes(7, "big")[1 : 1 + count]
        raise AssertionError("an empty interval")


class Models:
    """Two models of chances that are mixed."""

    def __init__(self, coder: Coder) -> None:
        self.coder = coder
        self.chances: dict[tuple[int, int], int] = {}
        self.visits: dict[tuple[int, int], int] = {}
        self.weights: dict[int, list[int]] = {}

    def learn(self, context: tuple[int, int], bit: int) -> None:
        chance, seen = self.chances.get(context, 1 << 21), self.visits.get(context, 0)
        self.chances[context] = chance + ((CERTAIN * bit - chance) * RATES[seen] >> 19)
        self.visits[context] = min(seen + 1, 160)

    def sure(self, first: int) -> int | None:
        """A bit by the first model alone, where that is sure of itself."""
        chance = self.chances.get((0, first), 1 << 21)
        if self.visits.get((0, first), 0) < 30 or 8192 <= chance <= CERTAIN - 8192:
            return None
        bit = self.coder.bit(max(4, min(chance >> 6, 65532)))
        self.learn((0, first), bit)
        return bit

    def mixed(self, first: int, second: int, chosen: int) -> int:
        """A bit by both models."""
        a, b = (STRETCH[self.chances.get(c, 1 << 21) >> 10] for c in ((0, first), (1, second)))
        weights = self.weights.setdefault(chosen, [40960, 40960])
        x = weights[0] * a + weights[1] * b >> 16
        p = SQUASH[max(-3072, min(x, 3071)) + 3072]
        bit = self.coder.bit(p)
        error = 65536 * bit - p
        weights[0] += a * error + 8192 >> 14
        weights[1] += b * error + 8192 >> 14
        self.learn((0, first), bit)
        self.learn((1, second), bit)
        return bit


def brick_counts(shape: Position) -> Position:
    """Bricks along x, y, z."""
    x, y, z = (-(-n // 8) for n in shape)
    return x, y, z


def inside(brick: Position, shape: Position) -> Array:
    """Which samples of a brick lie within the grid, bool [8, 8, 8]."""
    x, y, z = (8 * b + np.arange(8) < n for b, n in zip(brick, shape))
    return x[:, None, None] & y[None, :, None] & z[None, None, :]


def samples_of(brick: Position, mask: Array) -> list[Position]:
    """The set samples of a brick as positions in the grid."""
    return [(x, y, z) for x, y, z in (np.argwhere(mask) + 8 * np.array(brick)).tolist()]


def decode_support(data: bytes, shape: Position, previous: Support) -> Support:
    """The support in `data`; `previous` is empty where none is given."""
    c = Cursor(data)
    count = c.varint()
    nx, ny, nz = brick_counts(shape)
    need(count <= nx * ny * nz and count <= 4 * len(data), f"{count} bricks")
    if count == 0:
        c.end()
        return {}
    listed = nx * ny * nz > 128 * count + 4096
    bricks = brick_list(c, (nx, ny, nz), count) if listed else {}
    coder = Coder(data[c.at :])
    if not listed:
        bricks = brick_states(coder, (nx, ny, nz), count, shape, previous)
    support = decode_samples(coder, bricks, shape, previous)
    code = data[c.at : c.at + coder.used] + coder.ending()
    need(data == (data[: c.at] + code).ljust(-(-count // 4), b"\0"), "the end of a support")
    return {brick: support[brick] for brick in sorted(support)}


def brick_list(c: Cursor, counts: Position, count: int) -> dict[Position, bool]:
    """Bricks by the gaps between them, and whether each is full."""
    bricks, key = {}, -1
    for _ in range(count):
        value = c.varint()
        key += (value >> 1) + 1
        need(key < math.prod(counts), "a brick beyond the grid")
        rest, z = divmod(key, counts[2])
        x, y = divmod(rest, counts[1])
        bricks[x, y, z] = bool(value & 1)
    return bricks


def brick_states(
    coder: Coder, counts: Position, count: int, shape: Position, previous: Support
) -> dict[Position, bool]:
    """Which bricks hold samples, and whether each is full."""
    models = Models(coder)
    before = {b: 2 if (mask == inside(b, shape)).all() else 1 for b, mask in previous.items()}
    states: dict[Position, int] = {}

    def state(x: int, y: int, z: int) -> int:
        return states.get((x, y, z), 0)

    for x, y, z in product(range(counts[0]), range(counts[1]), reversed(range(counts[2]))):
        if len(states) == count:
            break
        old = before.get((x, y, z), 0)
        near = 9 * state(x, y, z + 1) + 3 * state(x, y - 1, z) + state(x - 1, y, z)
        far = ((x, y - 1, z - 1), (x - 1, y, z - 1), (x - 1, y + 1, z), (x - 1, y - 1, z))
        wide = sum((state(*b) > 0) << i for i, b in enumerate(far))
        c = 2 * (3 * near + old)
        if models.mixed(c, 16 * c + wide, 2 * old):
            states[x, y, z] = 1 + models.mixed(c + 1, 16 * (c + 1) + wide, 2 * old + 1)
    need(len(states) == count, "fewer bricks than were counted")
    return {brick: s == 2 for brick, s in states.items()}


FIRST = (
    (-1, 0, 0), (-1, 0, -1), (0, -1, 1), (0, -1, 0), (0, -1, -1), (-1, -1, 0),
    (-2, 0, 2), (-1, 1, 0), (-1, 1, -1), (-2, -2, 0), (0, -2, 1), (0, 0, 1),
)  # fmt: skip
WEIGHTS = ((-1, 0, 0), (0, -1, 0), (0, 0, 1))
SECOND = (
    (-1, 0, 1), (-1, 0, 0), (-1, 0, -1), (-1, 0, -2), (0, -1, 1), (0, -1, 0), (0, -1, -1), (0, -1, -2),
    (0, 0, 4), (0, 0, 3), (0, 0, 2), (0, 0, 1), (-2, 0, 0), (0, -2, 0),
)  # fmt: skip
BEFORE = ((0, 0, 1), (0, 0, 0), (0, 0, -1), (-1, 0, 0), (1, 0, 0), (0, -1, 0), (0, 1, 0))


def decode_samples(coder: Coder, bricks: dict[Position, bool], shape: Position, previous: Support) -> Support:
    """The samples of all bricks."""
    models = Models(coder)
    support = {b: inside(b, shape) if full else np.zeros((8, 8, 8), bool) for b, full in bricks.items()}
    known = {s for b, mask in support.items() for s in samples_of(b, mask)}
    before = {s for b, mask in previous.items() for s in samples_of(b, mask)}

    def number(samples: set[Position], at: Position, offsets: tuple[Position, ...]) -> int:
        x, y, z = at
        return sum(((x + dx, y + dy, z + dz) in samples) << i for i, (dx, dy, dz) in enumerate(offsets))

    for brick in sorted(bricks, key=lambda b: (b[0], b[1], -b[2])):
        if bricks[brick]:
            continue
        places = sorted(samples_of(brick, inside(brick, shape)), key=lambda s: (s[0], s[1], -s[2]))
        for at in places:
            first = number(known, at, FIRST)
            bit = models.sure(first)
            if bit is None:
                chosen = number(known, at, WEIGHTS)
                if previous:
                    second = number(before, at, BEFORE) | chosen << len(BEFORE)
                else:
                    second = number(known, at, SECOND)
                bit = models.mixed(first, second, chosen)
            if bit:
                known.add(at)
                support[brick][tuple(i & 7 for i in at)] = True
        held = np.count_nonzero(support[brick])
        need(0 < held < len(places), "a brick that is empty or full and should not be")
    return support


# -- the body of a segment --------------------------------------------------------------------------------

Forces = dict[Position, Array]
"""Bricks and their forces, newtons, float32 [8, 8, 8, 3]."""


@dataclass
class TableSet:
    """The tables of one kind of frame."""

    levels_n: Array
    amplitude_code: Code
    direction_code: Code


def decode_body(body: bytes, frame_count: int, shape: Position, vertices: Array) -> Iterator[Forces]:
    """The frames of a segment, one after another."""
    c = Cursor(body)
    kinds = c.number("B")
    need(kinds < 8, f"kinds {kinds}")
    sets = {}
    for bit in (1, 2):
        if kinds & bit:
            levels_n = amplitude_levels(c.chunk())
            amplitude_code = huffman_code(c.chunk(), len(levels_n) + RUN_SYMBOLS)
            sets[bit] = TableSet(levels_n, amplitude_code, huffman_code(c.chunk(), len(vertices)))
    forces: Forces = {}
    previous: Support = {}
    for i in range(frame_count):
        kind = c.number("B")
        need(kind <= 2 and (i or kind == 0), f"kind {kind} of frame {i}")
        tables = sets.get(2 if kind else 1)
        need(tables, "a frame without its tables")
        assert tables is not None
        support = decode_support(c.chunk(), shape, previous if kind == 1 else {})
        made = synthesis(c, kind, tables, (support, bool(kinds & 4)), vertices, forces)
        forces = added(forces, made) if kind == 2 else made
        previous = previous if kind == 2 else support
        yield forces
    c.end()


def synthesis(
    c: Cursor, kind: int, tables: TableSet, scanned: tuple[Support, bool], vertices: Array, before: Forces
) -> Forces:
    """The forces of one frame from its two streams; of a difference frame, the differences."""
    support, z_fastest = scanned
    samples = [s for brick, mask in support.items() for s in samples_of(brick, mask)]
    samples.sort(key=None if z_fastest else lambda s: s[::-1])
    levels = amplitude_stream(c.bit_chunk(), tables.amplitude_code, len(tables.levels_n), len(samples))
    directions = BitReader(c.bit_chunk())
    forces = {brick: np.zeros((8, 8, 8, 3), np.float32) for brick in support}
    zeros = np.zeros((8, 8, 8, 3), np.float32)
    held = np.zeros(3, np.float32)
    for (x, y, z), level in zip(samples, levels):
        brick, local = (x >> 3, y >> 3, z >> 3), (x & 7, y & 7, z & 7)
        if kind == 1:
            held = before.get(brick, zeros)[local]
        if level is not None:
            sent = tables.levels_n[level] * vertices[directions.symbol(tables.direction_code)]
            held = held + sent if kind == 1 else sent
        forces[brick][local] = held
    directions.end()
    return forces


def added(a: Forces, b: Forces) -> Forces:
    """The sum of two frames."""
    zeros = np.zeros((8, 8, 8, 3), np.float32)
    return {brick: a.get(brick, zeros) + b.get(brick, zeros) for brick in sorted(a.keys() | b.keys())}


# -- whole files ------------------------------------------------------------------------------------------


def decode_bodies(data: bytes) -> tuple[dict[str, Any], Iterator[Forces]]:
    """The head of a file of coder `paper` or `touch`, and its frames as sparse bricks."""
    head, bodies = read_file(data)
    need(head["coder"] != "objects", "objects, not frames")
    if head["coder"] == "touch":
        import reference_touch

        known = head["shape"], head["spacing_m"], head["parameters"]
        return head, (f for count, body in bodies for f in reference_touch.decode_touch_body(body, count, *known))
    vertices = codebook(head["parameters"].decode("ascii"))
    return head, (f for count, body in bodies for f in decode_body(body, count, head["shape"], vertices))


def laid_out(bricks: Forces, shape: Position) -> Array:
    """Bricks as a dense array, newtons, float32 [nx, ny, nz, 3]."""
    dense = np.zeros((*(8 * n for n in brick_counts(shape)), 3), np.float32)
    for (x, y, z), forces in bricks.items():
        dense[8 * x : 8 * x + 8, 8 * y : 8 * y + 8, 8 * z : 8 * z + 8] = forces
    return dense[: shape[0], : shape[1], : shape[2]]


def decode(path: str | Path) -> dict[str, Any]:
    """All forces of a file; of objects, those at the points of its grid.

    Returns
    -------
    dict
        ``forces_n`` float32 [frame, nx, ny, nz, 3], newtons; ``origin_m`` and ``spacing_m`` float64 [3];
        ``rate_hz``.

    Raises
    ------
    ValueError
        If the file is not what docs/format.md describes, or too large to lay out.
    """
    data = Path(path).read_bytes()
    head, _ = read_file(data)
    shape, count = head["shape"], head["frame_count"]
    need(count * math.prod(shape) <= MOST_DENSE, f"{count} frames of {shape} samples are too many to lay out")
    if head["coder"] == "objects":
        import reference_objects

        forces_n = reference_objects.decode_scene(data).voxels()
    else:
        forces_n = np.zeros((count, *shape, 3), np.float32)
        for i, bricks in enumerate(decode_bodies(data)[1]):
            forces_n[i] = laid_out(bricks, shape)
    return {
        "forces_n": forces_n,
        "origin_m": np.array(head["origin_m"]),
        "spacing_m": np.array(head["spacing_m"]),
        "rate_hz": head["rate_hz"],
    }


def main() -> None:
    """Decode one file to one ``.npz``."""
    parser = argparse.ArgumentParser(description="Decode a .touch file by docs/format.md alone, slowly.")
    parser.add_argument("stream", metavar="FILE.touch")
    parser.add_argument("field", metavar="OUT.npz")
    asked = parser.parse_args()
    try:
        decoded = decode(asked.stream)
    except (ValueError, OSError) as error:
        parser.exit(1, f"{asked.stream}: {error}\n")
    np.savez_compressed(asked.field, **decoded)


if __name__ == "__main__":
    main()

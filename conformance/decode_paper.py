"""Decodes coder `paper` for the conformance decoder, step by step as docs/format/paper.md says, in plain
Python and numpy. `decoder.py` calls it.
"""

import math
from collections.abc import Iterator
from itertools import accumulate, combinations, product
from typing import Any, NamedTuple

import numpy as np
from reading import Array, Bricks, Cursor, Forces, Place, brick_of, in_bricks, inside, need
from support import NOTHING, support_alone, whole_numbers

RUN_SYMBOLS = 21
MOST_NEWTONS = 1e6
ZERO = np.zeros(3, np.float32)
PARTS = {"dpcm": 1, "adpcm": 16, "dct": 256, "wavelet": 1, "runs": 1}


def check_parameters(parameters: bytes) -> None:
    """Refuse a name that is neither a stage nor a codebook."""
    name = parameters.decode("ascii", "replace")
    if name not in PARTS:
        codebook(name)


def decode_segment(body: bytes, parameters: bytes, shape: Place, frame_count: int) -> Iterator[Bricks]:
    """The frames of a segment, one after another."""
    name = parameters.decode("ascii", "replace")
    if name in PARTS:
        return map(in_bricks, staged(Cursor(body), name, shape, frame_count))
    return map(in_bricks, frames(Cursor(body), codebook(name), shape, frame_count))


# -- directions --------------------------------------------------------------------------------------------


def unit(points: Array) -> Array:
    """Points [..., 3] on the unit sphere."""
    return np.asarray(points / np.linalg.norm(points, axis=-1, keepdims=True))


def codebook(name: str) -> Array:
    """The vertices of a direction codebook, float32 [n, 3]."""
    names = [f"octa{n}" for n in range(1, 6)] + [f"ico{n}" for n in range(1, 21)]
    need(name in names, f"the codebook {name!r}")
    points = octahedron(int(name[4:])) if name[0] == "o" else icosahedron(int(name[3:]))
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


def icosahedron(parts: int) -> Array:
    """All points of its faces, each edge in `parts`."""
    golden = (1 + math.sqrt(5)) / 2
    corners = unit(
        np.array([np.roll((0.0, a, b * golden), s) for s in range(3) for a in (1, -1) for b in (1, -1)])
    )
    near = corners @ corners.T > 0.4
    faces = [face for face in combinations(range(12), 3) if all(near[pair] for pair in combinations(face, 2))]
    weights = [math.sin(math.atan(2) * i / parts) for i in range(parts + 1)]
    shares = [(i, j, parts - i - j) for i in range(parts + 1) for j in range(parts + 1 - i)]
    return unit(np.array([sum(weights[n] * corners[p] for n, p in zip(s, f)) for f in faces for s in shares]))


# -- levels, directions and runs ---------------------------------------------------------------------------

Code = dict[str, int]
"""The digits of codes to symbols."""


class TableSet(NamedTuple):
    """The tables of one kind of frame."""

    levels_n: Array
    amplitude_code: Code
    direction_code: Code


def table_set(c: Cursor, direction_count: int) -> TableSet:
    """A table set."""
    payload = c.chunk()
    count = len(payload) // 4
    need(len(payload) % 4 == 0 and 1 <= count <= (1 << 16) - RUN_SYMBOLS, f"{len(payload)} bytes of levels")
    levels = np.frombuffer(payload, "<f4").astype(np.float32)
    need(levels[0] >= 0 and levels[-1] <= MOST_NEWTONS, "the range of the levels")
    need(all(a < b for a, b in zip(levels, levels[1:])), "the order of the levels")
    return TableSet(
        levels, huffman_code(c.chunk(), count + RUN_SYMBOLS), huffman_code(c.chunk(), direction_count)
    )


def huffman_code(data: bytes, symbol_count: int) -> Code:
    """A canonical code from the lengths of its codes."""
    lengths = whole_numbers(data, symbol_count)
    need(all(0 <= n <= 24 for n in lengths), "a code of another length")
    present = sorted((n, symbol) for symbol, n in enumerate(lengths) if n)
    kraft = sum(1 << (24 - n) for n, _ in present)
    need(kraft == 1 << 24 or not present or [n for n, _ in present] == [1], "lengths of no complete code")
    code, value, before = Code(), 0, 0
    for n, symbol in present:
        value <<= n - before
        code[f"{value:0{n}b}"] = symbol
        value, before = value + 1, n
    return code


class Bits:
    """A bit chunk, as digits."""

    def __init__(self, c: Cursor) -> None:
        self.size, self.at = c.varint(), 0
        self.digits = "".join(f"{byte:08b}" for byte in c.take(-(-self.size // 8)))

    def take(self, count: int) -> str:
        need(self.at + count <= self.size, "the end of a bit chunk")
        self.at += count
        return self.digits[self.at - count : self.at]

    def symbol(self, code: Code) -> int:
        word = ""
        while word not in code:
            need(len(word) < 24, "bits that are no code")
            word += self.take(1)
        return code[word]

    def end(self) -> None:
        need(self.at == self.size and "1" not in self.digits[self.size :], "bits that are left over")


def amplitude_stream(bits: Bits, code: Code, level_count: int, samples: int) -> list[int | None]:
    """For each sample its level, or None where it repeats the one before."""
    out: list[int | None] = []
    while len(out) < samples:
        symbol = bits.symbol(code)
        j = symbol - level_count
        out += [symbol] if j < 0 else [None] * ((1 << j) + int("0" + bits.take(j), 2))
    need(len(out) == samples, "a run beyond the last sample")
    bits.end()
    return out


def frames(c: Cursor, vertices: Array, shape: Place, frame_count: int) -> Iterator[Forces]:
    """The frames of a segment without a stage."""
    kinds = c.number("B")
    need(kinds < 4, f"kinds {kinds}")
    sets = {bit: table_set(c, len(vertices)) for bit in (1, 2) if kinds & bit}
    forces, previous = Forces(), NOTHING
    for i in range(frame_count):
        kind = c.number("B")
        need(kind <= 2 and (i or kind == 0), f"kind {kind} of frame {i}")
        tables = sets.get(2 if kind else 1)
        need(tables, "a frame without its tables")
        support = support_alone(c.chunk(), shape, previous if kind == 1 else NOTHING)
        made = synthesis(c, kind, tables, support.samples, vertices, forces)
        if kind == 2:
            made = {at: forces.get(at, ZERO) + made.get(at, ZERO) for at in forces.keys() | made.keys()}
        forces, previous = made, previous if kind == 2 else support
        yield forces
    c.end()


def synthesis(
    c: Cursor, kind: int, tables: Any, samples: list[Place], vertices: Array, before: Forces
) -> Forces:
    """The forces of one frame from its two streams; of a difference frame, the differences."""
    levels = amplitude_stream(Bits(c), tables.amplitude_code, len(tables.levels_n), len(samples))
    directions, force, forces = Bits(c), ZERO, Forces()
    for at, level in zip(samples, levels):
        if kind == 1:
            force = before.get(at, ZERO)
        if level is not None:
            sent = tables.levels_n[level] * vertices[directions.symbol(tables.direction_code)]
            force = force + sent if kind == 1 else sent
        forces[at] = force
    directions.end()
    return forces


# -- stages ------------------------------------------------------------------------------------------------


def staged(c: Cursor, stage: str, shape: Place, frame_count: int) -> Iterator[Forces]:
    """The frames of a segment of a stage."""
    step_n = c.number("d")
    need(1e-9 <= step_n <= MOST_NEWTONS, f"a step of {step_n} N")
    for _ in range(frame_count):
        support = support_alone(c.chunk(), shape, NOTHING)
        samples = support.samples
        runs = c.varint() if stage == "runs" else 0
        need(runs <= len(samples), f"{runs} runs of {len(samples)} samples")
        coefficients = 3 * 512 * len(support.bricks)
        counts = {"runs": 4 * runs, "dct": coefficients, "wavelet": coefficients}
        numbers = whole_numbers(c.chunk(), counts.get(stage, 3 * len(samples)))
        if stage in ("dct", "wavelet"):
            bricks = dict(zip(support.bricks, from_coefficients(numbers, stage, len(support.bricks))))
            points = [bricks[brick_of(at)][inside(at)] for at in samples]
        elif stage == "runs":
            lengths, values = (
                [n + 1 for n in numbers[:runs]],
                np.reshape(numbers[runs:], (3, runs)).T.tolist(),
            )
            need(min(lengths, default=1) > 0 and sum(lengths) == len(samples), "runs of another length")
            points = [value for n, value in zip(lengths, values) for _ in range(n)]
        else:
            rows = np.reshape(numbers, (3, -1)).tolist()
            points = list(zip(*map(adpcm if stage == "adpcm" else accumulate, rows)))
        newtons = np.reshape(points, (-1, 3)) * (step_n / PARTS[stage])
        need((abs(newtons) <= MOST_NEWTONS).all(), "a force that is too large")
        yield dict(zip(samples, newtons.astype(np.float32)))
    c.end()


STEPS = (16, 19, 23, 27, 32, 38, 45, 54, 64)


def adpcm(residuals: list[int]) -> list[int]:
    """ADPCM, in sixteenths of a step."""
    w0, w1, last, before, rung, out = 65536, 0, 0, 0, 0, []
    for q in residuals:
        slope = last - before
        value = (w0 * last + w1 * slope + 32768 >> 16) + q * STEPS[rung]
        value = max(-(1 << 40), min(value, 1 << 40))
        step = 48 * int(np.sign(q))
        w0 = max(57344, min(w0 + step * int(np.sign(last)), 73728))
        w1 = max(-16384, min(w1 + step * int(np.sign(slope)), 65536))
        rung = min(rung + 1, 8) if abs(q) >= 2 else max(rung - 1, 0) if q == 0 else rung
        before, last = last, value
        out.append(value)
    return out


ORDER = sorted(product(range(8), repeat=3), key=lambda place: (sum(place), place))
COSINES = (131072, 128553, 121095, 108982, 92682, 72820, 50159, 25571, 0)


def from_coefficients(numbers: list[int], stage: str, count: int) -> Array:
    """The samples of so many bricks, whole numbers [count, 8, 8, 8, 3], of their coefficients."""
    values = np.zeros((8, 8, 8, 3, count), np.int64)
    values[tuple(np.transpose(ORDER))] = np.reshape(numbers, (3, 512, count)).swapaxes(0, 1)
    return np.moveaxis(from_wavelet(values) if stage == "wavelet" else from_dct(values), -1, 0)


def from_wavelet(values: Array) -> Array:
    """The inverse of three levels of the 5/3 wavelet."""
    for m in (1, 2, 4):
        for axis in (2, 1, 0):
            x = np.moveaxis(values[: 2 * m, : 2 * m, : 2 * m], axis, 0)  # a view
            coarse, detail, t = x[:m], x[m:], np.arange(m)
            even = coarse - (detail[np.maximum(t - 1, 0)] + detail + 2 >> 2)
            odd = detail + (even + even[np.minimum(t + 1, m - 1)] >> 1)
            x[::2], x[1::2] = even, odd
    return values


def from_dct(values: Array) -> Array:
    """The inverse of the DCT, in 256ths of a step."""
    cosines = np.array([*COSINES, *(-n for n in COSINES[-2::-1])])
    cosines = np.array([*cosines, *cosines[-2:0:-1]])
    basis = cosines[(2 * np.arange(8) + 1) * np.arange(8)[:, None] % 32]
    basis[0] = COSINES[4]
    values = values << 8
    for axis in range(3):
        values = np.moveaxis(np.tensordot(basis, values, (0, axis)) + 131072 >> 18, 0, axis)
    return values

"""Codes a picture of planes: the surfaces that a depth camera sees, as a tree of squares that each hold one
plane.

It is the prototype of a base layer of coder `touch` that is made of the coded source (``source_layer.md``
defines its bytes). `fit_tree` chooses the tree of a depth map, `write_tree` and `read_tree` code it with the
arithmetic code of docs/format/bits.md.

A plane is linear in inverse depth: ``w = a u + b v + c`` at pixel (u, v), in 1/2^24 per metre. Squares
without a surface are holes.
"""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import Any, Final, NamedTuple, Protocol

import numpy as np
from numba import njit
from numpy.typing import NDArray

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "conformance"))

from touch_bits import RATES, Bits, limited_probability  # type: ignore[import-not-found]

UNIT: Final = 1 << 24
"""Units of inverse depth in 1/m."""
TOP: Final = 32
"""Pixels along a side of the largest square."""
LEVELS: Final = TOP.bit_length()
W_STEP: Final = 1 << 12
"""Step of the inverse depth of a plane, units."""
SLOPE_STEP: Final = 1 << 13
"""Step of the slopes of a plane times the side of its square, units; squares below `SLOPE_SIDE` have none."""
SLOPE_SIDE: Final = 4
FAR: Final = UNIT >> 1
"""The plane before any other: 2 m away."""
SPLIT, HOLE, NEW, OTHER, THIRD, NUMBER, SLOPE_A, SLOPE_B = 0, 32, 128, 192, 320, 400, 1000, 2000
"""First contexts of each kind of bit."""
CONTEXTS: Final = 3000
UNARY: Final = 14
"""Digits of a residual in unary; larger ones go on in Elias' gamma code."""
PASSES: Final = 3
"""Passes of the fit, each of which takes the costs of bits that the one before has found."""

HOLE_MODE, NEW_MODE = 0, 4
"""A square is a hole, takes plane `mode - 1` of its neighbours, or plane `mode - 4` with a residual."""

Integers = NDArray[np.int64]

compiled: Any = njit(cache=True, nogil=True)


class Tree(NamedTuple):
    """A tree of squares over a picture, by the first pixel of each.

    split : bool [levels, height, width]; whether a square of side 2^level is divided.
    modes : int8 [height, width]; of a square that is not divided.
    residuals : int32 [height, width, 3]; steps of inverse depth, slope along u, slope along v.
    """

    split: NDArray[np.bool_]
    modes: NDArray[np.int8]
    residuals: NDArray[np.int32]

    @classmethod
    def empty(cls, height: int, width: int) -> Tree:
        """Return a tree of undivided holes."""
        return cls(
            np.zeros((LEVELS, height, width), np.bool_),
            np.zeros((height, width), np.int8),
            np.zeros((height, width, 3), np.int32),
        )


class Planes(NamedTuple):
    """The decoded planes of a picture.

    coefficients : int64 [height, width, 3]; a, b, c.
    is_hole : bool [height, width].
    level : int8 [height, width]; of the square of each pixel.
    last : int64 [3]; the plane that was decoded last.
    """

    coefficients: Integers
    is_hole: NDArray[np.bool_]
    level: NDArray[np.int8]
    last: Integers

    @classmethod
    def empty(cls, height: int, width: int) -> Planes:
        """Return a picture of holes."""
        return cls(
            np.zeros((height, width, 3), np.int64),
            np.ones((height, width), np.bool_),
            np.zeros((height, width), np.int8),
            np.array([0, 0, FAR]),
        )


class Surface(NamedTuple):
    """What a picture is fitted to, float64 [height, width] each.

    inverse_m : inverse depth of the tangent plane at each pixel, 1/m; 0 where there is none.
    slope_u, slope_v : its slopes, 1/m per pixel.
    distance_m : distance of the tangent plane from the camera.
    weight : bits that a wrong pixel costs.
    """

    inverse_m: NDArray[np.float64]
    slope_u: NDArray[np.float64]
    slope_v: NDArray[np.float64]
    distance_m: NDArray[np.float64]
    weight: NDArray[np.float64]


class Tolerance(NamedTuple):
    """Errors at which a pixel is half wrong: a length, metres, and an angle, rad, and the focal lengths."""

    length_m: float
    angle: float
    fx: float
    fy: float


# -- shared by both directions -----------------------------------------------------------------------------


@compiled
def neighbours(planes, x, y, side, found):  # type: ignore[no-untyped-def]
    """Write the different planes left of, above and above right of a square to `found` [3, 3].

    Returns their number.
    """
    height, width = planes.is_hole.shape
    half, count = side // 2, 0
    for n in range(3):
        if n == 0:
            u, v = x - 1, y + (half if y + half < height else 0)
        elif n == 1:
            u, v = x + (half if x + half < width else 0), y - 1
        else:
            u, v = (x + side if x + side < width else x - 1), y - 1
        if u < 0 or v < 0 or planes.is_hole[v, u]:
            continue
        own, is_new = planes.coefficients[v, u], True
        for m in range(count):
            if found[m, 0] == own[0] and found[m, 1] == own[1] and found[m, 2] == own[2]:
                is_new = False
        if is_new:
            found[count] = own
            count += 1
    return count


@compiled
def plane_of(base, residual, x, y, side):  # type: ignore[no-untyped-def]
    """Return the plane of a square: `base` with a residual at its middle."""
    u, v = x + side // 2, y + side // 2
    middle = base[0] * u + base[1] * v + base[2] + residual[0] * W_STEP
    a = base[0] + residual[1] * (SLOPE_STEP // side)
    b = base[1] + residual[2] * (SLOPE_STEP // side)
    return a, b, middle - a * u - b * v


@compiled
def draw(planes, x, y, side, level, mode, plane):  # type: ignore[no-untyped-def]
    """Write the plane of a square to its pixels."""
    height, width = planes.is_hole.shape
    for v in range(y, min(y + side, height)):
        for u in range(x, min(x + side, width)):
            planes.is_hole[v, u] = mode == HOLE_MODE
            planes.level[v, u] = level
            for n in range(3):
                planes.coefficients[v, u, n] = plane[n]
    if mode != HOLE_MODE:
        for n in range(3):
            planes.last[n] = plane[n]


@compiled
def split_context(planes, x, y, level):  # type: ignore[no-untyped-def]
    """Return the context of whether a square is divided: how many of its neighbours are smaller."""
    smaller = int(x > 0 and planes.level[y, x - 1] < level) + int(y > 0 and planes.level[y - 1, x] < level)
    return SPLIT + 4 * level + smaller


@compiled
def hole_context(planes, x, y, level, count):  # type: ignore[no-untyped-def]
    """Return the context of whether a square is a hole."""
    left = int(x > 0 and planes.is_hole[y, x - 1])
    above = int(y > 0 and planes.is_hole[y - 1, x])
    return HOLE + 16 * level + 4 * min(count, 2) + 2 * left + above


# -- the bytes ---------------------------------------------------------------------------------------------


class Coder(Protocol):
    """An arithmetic code in one direction: bits that are read ignore the value that is given."""

    def bit(self, context: int, value: int) -> int:
        """Code a bit by a context."""

    def even(self, value: int, count: int) -> int:
        """Code a number of `count` even bits."""


class Writer:
    """Writes the arithmetic code of docs/format/bits.md."""

    def __init__(self) -> None:
        self._low, self._range, self._words = 0, 1 << 48, 0
        self._contexts: dict[int, list[int]] = {}

    def _narrow(self, p: int, value: int) -> None:
        bound = (self._range >> 16) * p
        if value:
            self._range = bound
        else:
            self._low, self._range = self._low + bound, self._range - bound
        if self._range < 1 << 32:
            self._low, self._range, self._words = self._low << 16, self._range << 16, self._words + 1

    def bit(self, context: int, value: int) -> int:
        """See `Coder`."""
        own = self._contexts.setdefault(context, [1 << 21, 0])
        self._narrow(limited_probability(own[0] >> 6), value)
        own[0] += (value * 4194303 - own[0]) * RATES[own[1]] >> 19
        own[1] = min(own[1] + 1, 255)
        return int(value)

    def even(self, value: int, count: int) -> int:
        """See `Coder`."""
        for n in reversed(range(count)):
            self._narrow(32768, value >> n & 1)
        return value

    def finish(self) -> bytes:
        """Return the bytes: the fewest whose number, with zeros behind, lies in the interval."""
        bits = 48 + 16 * self._words
        for size in range(2 * self._words, bits // 8 + 1):
            unit = 1 << (bits - 8 * size)
            number = -(-self._low // unit)
            if number * unit < self._low + self._range:
                return number.to_bytes(size, "big")
        raise AssertionError("the interval has no number")


class Reader:
    """Reads what `Writer` writes."""

    def __init__(self, data: bytes) -> None:
        self._bits = Bits(data)

    def bit(self, context: int, value: int = 0) -> int:
        """See `Coder`."""
        return int(self._bits.code(context))

    def even(self, value: int, count: int) -> int:
        """See `Coder`."""
        return int(self._bits.even(count))


def code_number(coder: Coder, context: int, value: int) -> int:
    """Code a residual."""
    if not coder.bit(context, value != 0):
        return 0
    is_negative = coder.bit(context + 1, value < 0)
    more, wanted = 0, abs(value) - 1
    while more < UNARY and coder.bit(context + 2 + more, wanted > more):
        more += 1
    if more == UNARY:
        rest, digits = wanted - UNARY + 1, 0
        while digits < 24 and coder.even(rest >> digits > 1, 1):
            digits += 1
        more = UNARY - 1 + (1 << digits | coder.even(rest & (1 << digits) - 1, digits))
    return -more - 1 if is_negative else more + 1


def code_leaf(coder: Coder, planes: Planes, tree: Tree, x: int, y: int, level: int) -> None:
    """Code a square that is not divided, and draw its plane."""
    found = np.zeros((3, 3), np.int64)
    count = neighbours(planes, x, y, 1 << level, found)
    mode, residual = int(tree.modes[y, x]), tree.residuals[y, x]
    if coder.bit(hole_context(planes, x, y, level, count), mode == HOLE_MODE):
        tree.modes[y, x] = HOLE_MODE
        draw(planes, x, y, 1 << level, level, HOLE_MODE, planes.last)
        return
    is_new, index = 1, 0
    if count:
        is_new = coder.bit(NEW + 8 * level + count, mode >= NEW_MODE)
        wanted = mode - (NEW_MODE if is_new else 1)
        if count > 1:
            index = coder.bit(OTHER + 16 * level + 8 * is_new + count, wanted > 0)
        if index and count > 2:
            index += coder.bit(THIRD + 2 * level + is_new, wanted > 1)
    if is_new:
        residual[0] = code_number(coder, NUMBER + 40 * level, int(residual[0]))
        if 1 << level >= SLOPE_SIDE:
            rough = 80 * level + 40 * (abs(int(residual[0])) > 1)
            residual[1] = code_number(coder, SLOPE_A + rough, int(residual[1]))
            rough = 80 * level + 40 * (abs(int(residual[1])) > 1)
            residual[2] = code_number(coder, SLOPE_B + rough, int(residual[2]))
        else:
            residual[1:] = 0
    tree.modes[y, x] = index + (NEW_MODE if is_new else 1)
    base = found[index] if count else planes.last
    plane = plane_of(base, residual, x, y, 1 << level) if is_new else tuple(base)
    draw(planes, x, y, 1 << level, level, 1, np.array(plane))


def code_tree(coder: Coder, tree: Tree) -> Planes:
    """Code a tree in raster order of its largest squares; returns its planes. A reader fills the tree."""
    height, width = tree.modes.shape
    planes = Planes.empty(height, width)

    def square(x: int, y: int, level: int) -> None:
        if x >= width or y >= height:
            return
        if level:
            context = split_context(planes, x, y, level)
            tree.split[level, y, x] = coder.bit(context, bool(tree.split[level, y, x]))
        if not level or not tree.split[level, y, x]:
            code_leaf(coder, planes, tree, x, y, level)
            return
        half = 1 << (level - 1)
        for n in range(4):
            square(x + half * (n & 1), y + half * (n >> 1), level - 1)

    for y in range(0, height, TOP):
        for x in range(0, width, TOP):
            square(x, y, LEVELS - 1)
    return planes


def write_tree(tree: Tree) -> tuple[bytes, Planes]:
    """Return the bytes of a tree, and its planes."""
    coder = Writer()
    planes = code_tree(coder, tree)
    return coder.finish(), planes


def read_tree(data: bytes, height: int, width: int) -> Planes:
    """Return the planes of the bytes of `write_tree`."""
    return code_tree(Reader(data), Tree.empty(height, width))


# -- the fit: the tree of the least bits and errors --------------------------------------------------------


@compiled
def _pay(costs, counts, context, value):  # type: ignore[no-untyped-def]
    """Return the bits of a bit, and count it."""
    counts[context, int(value)] += 1
    return costs[context, int(value)]


@compiled
def _number_bits(costs, counts, context, value):  # type: ignore[no-untyped-def]
    bits = _pay(costs, counts, context, value != 0)
    if value == 0:
        return bits
    bits += _pay(costs, counts, context + 1, value < 0)
    wanted, more = abs(value) - 1, 0
    while more < UNARY and wanted > more:
        bits += _pay(costs, counts, context + 2 + more, True)
        more += 1
    if more < UNARY:
        return bits + _pay(costs, counts, context + 2 + more, False)
    return bits + 2 * math.log2(wanted - UNARY + 1.0) + 1


@compiled
def _leaf_bits(costs, counts, planes, x, y, level, count, mode, residual):  # type: ignore[no-untyped-def]
    """Return the bits of a square that is not divided; see `code_leaf`."""
    bits = _pay(costs, counts, hole_context(planes, x, y, level, count), mode == HOLE_MODE)
    if mode == HOLE_MODE:
        return bits
    is_new = mode >= NEW_MODE
    index = mode - (NEW_MODE if is_new else 1)
    if count:
        bits += _pay(costs, counts, NEW + 8 * level + count, is_new)
        if count > 1:
            bits += _pay(costs, counts, OTHER + 16 * level + 8 * int(is_new) + count, index > 0)
        if index and count > 2:
            bits += _pay(costs, counts, THIRD + 2 * level + int(is_new), index > 1)
    if is_new:
        bits += _number_bits(costs, counts, NUMBER + 40 * level, residual[0])
        if 1 << level >= SLOPE_SIDE:
            rough = 80 * level + 40 * int(abs(residual[0]) > 1)
            bits += _number_bits(costs, counts, SLOPE_A + rough, residual[1])
            rough = 80 * level + 40 * int(abs(residual[1]) > 1)
            bits += _number_bits(costs, counts, SLOPE_B + rough, residual[2])
    return bits


@compiled
def _errors(surface, tolerance, plane, x, y, side, enough):  # type: ignore[no-untyped-def]
    """Return the bits that the wrong pixels of a square cost; from `enough` on, any larger number."""
    height, width = surface.weight.shape
    a, b, c = plane[0] / UNIT, plane[1] / UNIT, plane[2] / UNIT
    total = 0.0
    for v in range(y, min(y + side, height)):
        for u in range(x, min(x + side, width)):
            w = surface.inverse_m[v, u]
            if w == 0:
                total += surface.weight[v, u]
                continue
            distance = surface.distance_m[v, u]
            off = (a * u + b * v + c - w) * distance / w / tolerance.length_m
            tilt_u = (a - surface.slope_u[v, u]) * tolerance.fx
            tilt_v = (b - surface.slope_v[v, u]) * tolerance.fy
            tilt = (tilt_u * tilt_u + tilt_v * tilt_v) * (distance / tolerance.angle) ** 2
            total += surface.weight[v, u] * min(1.0, 0.5 * (off * off + tilt))
        if total > enough:
            return total
    return total


@compiled
def _fit_plane(surface, tolerance, x, y, side, plane):  # type: ignore[no-untyped-def]
    """Write the plane, 1/m, to which most pixels of a square belong; returns their number."""
    height, width = surface.weight.shape
    best = 0
    for seed in range(5 if side >= 4 else 1):
        u0 = x + side * (2 if seed == 0 else 1 if seed % 2 else 3) // 4
        v0 = y + side * (2 if seed == 0 else 1 if seed < 3 else 3) // 4
        if u0 >= width or v0 >= height or surface.inverse_m[v0, u0] == 0:
            continue
        a, b = surface.slope_u[v0, u0], surface.slope_v[v0, u0]
        c = surface.inverse_m[v0, u0] - a * u0 - b * v0
        for turn in range(2):
            n = su = sv = sw = suu = suv = svv = suw = svw = sa = sb = 0.0
            for v in range(y, min(y + side, height)):
                for u in range(x, min(x + side, width)):
                    w = surface.inverse_m[v, u]
                    if w == 0:
                        continue
                    off = (a * u + b * v + c - w) * surface.distance_m[v, u] / w / tolerance.length_m
                    if abs(off) > (3.0 if turn else 6.0):
                        continue
                    p, q = float(u - x), float(v - y)
                    n, su, sv, sw = n + 1, su + p, sv + q, sw + w
                    suu, suv, svv = suu + p * p, suv + p * q, svv + q * q
                    suw, svw = suw + p * w, svw + q * w
                    sa, sb = sa + surface.slope_u[v, u], sb + surface.slope_v[v, u]
            if n == 0:
                break
            suu, suv, svv = suu - su * su / n, suv - su * sv / n, svv - sv * sv / n
            suw, svw = suw - su * sw / n, svw - sv * sw / n
            det = suu * svv - suv * suv
            if n >= 12 and det > 1e-3 * n * n:
                a, b = (suw * svv - svw * suv) / det, (svw * suu - suw * suv) / det
            else:
                a, b = sa / n, sb / n
            c = (sw - a * su - b * sv) / n - a * x - b * y
            if turn and n > best:
                best = int(n)
                plane[0], plane[1], plane[2] = a, b, c
        if best >= 0.9 * side * side:
            break
    return best


@compiled
def _choose_leaf(job, x, y, level, leaf):  # type: ignore[no-untyped-def]
    """Choose mode, residual and plane of a square, int64 [7] to `leaf`; returns bits and errors."""
    planes, surface, tolerance, costs, spare = job
    height, width = surface.weight.shape
    side = 1 << level
    found, fitted = np.zeros((3, 3), np.int64), np.zeros(3)
    residual, best = np.zeros(3, np.int64), np.inf
    count = neighbours(planes, x, y, side, found)
    hidden, holes, pixels = 0.0, 0, 0
    for v in range(y, min(y + side, height)):
        for u in range(x, min(x + side, width)):
            if surface.inverse_m[v, u] == 0:
                holes += 1
            else:
                hidden, pixels = hidden + surface.weight[v, u], pixels + 1
    if holes or hidden < 1:
        best = hidden + _leaf_bits(costs, spare, planes, x, y, level, count, HOLE_MODE, residual)
        leaf[:] = 0
    for n in range(count):
        bits = _leaf_bits(costs, spare, planes, x, y, level, count, 1 + n, residual)
        bits += _errors(surface, tolerance, found[n], x, y, side, best - bits)
        if bits < best:
            best, leaf[0] = bits, 1 + n
            leaf[1:4], leaf[4:] = 0, found[n]
    if best < 1.5 or not pixels or not _fit_plane(surface, tolerance, x, y, side, fitted):
        return best
    u, v = x + side // 2, y + side // 2
    for n in range(max(count, 1)):
        base = found[n] if count else planes.last
        for is_flat in range(2 if side >= SLOPE_SIDE else 1):
            residual[:] = 0
            if side >= SLOPE_SIDE and not is_flat:
                step = SLOPE_STEP // side
                residual[1] = round((fitted[0] * UNIT - base[0]) / step)
                residual[2] = round((fitted[1] * UNIT - base[1]) / step)
            middle = (fitted[0] * u + fitted[1] * v + fitted[2]) * UNIT
            residual[0] = round((middle - base[0] * u - base[1] * v - base[2]) / W_STEP)
            bits = _leaf_bits(costs, spare, planes, x, y, level, count, NEW_MODE + n, residual)
            if not bits < best:
                continue
            plane = plane_of(base, residual, x, y, side)
            bits += _errors(surface, tolerance, plane, x, y, side, best - bits)
            if bits < best:
                best, leaf[0] = bits, NEW_MODE + n
                leaf[1:4] = residual
                leaf[4], leaf[5], leaf[6] = plane
    return best


@compiled
def _choose(job, tree, x, y, level):  # type: ignore[no-untyped-def]
    """Choose the tree below a square; returns its bits and errors."""
    planes, costs = job[0], job[3]
    height, width = planes.is_hole.shape
    if x >= width or y >= height:
        return 0.0
    leaf, last = np.zeros(7, np.int64), planes.last.copy()
    context = split_context(planes, x, y, level)
    whole = _choose_leaf(job, x, y, level, leaf) + (costs[context, 0] if level else 0.0)
    parts = costs[context, 1] if level else np.inf
    if parts + 1 < whole:
        half = 1 << (level - 1) if level else 0
        for n in range(4):
            parts += _choose(job, tree, x + half * (n & 1), y + half * (n >> 1), level - 1)
            if parts >= whole:
                break
        if parts < whole:
            tree.split[level, y, x] = True
            return parts
    planes.last[:] = last
    tree.split[level, y, x] = False
    tree.modes[y, x], tree.residuals[y, x] = leaf[0], leaf[1:4]
    draw(planes, x, y, 1 << level, level, leaf[0], leaf[4:])
    return whole


@compiled
def _fit_pass(job, tree):  # type: ignore[no-untyped-def]
    height, width = tree.modes.shape
    for y in range(0, height, TOP):
        for x in range(0, width, TOP):
            _choose(job, tree, x, y, LEVELS - 1)


class _Counts:
    """A coder that counts the bits of each context."""

    def __init__(self) -> None:
        self.counts = np.zeros((CONTEXTS, 2))

    def bit(self, context: int, value: int) -> int:
        self.counts[context, int(value)] += 1
        return int(value)

    def even(self, value: int, count: int) -> int:
        return value


def fit_tree(surface: Surface, tolerance: Tolerance) -> Tree:
    """Choose the tree of a picture: the least sum of its bits and the bits that its wrong pixels cost.

    The choice uses floating point; only its result is coded.
    """
    height, width = surface.weight.shape
    costs, tree = np.ones((CONTEXTS, 2)), Tree.empty(height, width)
    for _ in range(PASSES):
        job = Planes.empty(height, width), surface, tolerance, costs, np.zeros((CONTEXTS, 2))
        _fit_pass(job, tree)
        counter = _Counts()
        code_tree(counter, tree)
        counts = counter.counts + 0.5
        costs = -np.log2(counts / counts.sum(axis=1, keepdims=True))
    return tree

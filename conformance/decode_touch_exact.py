"""Decodes the exact (lossless) mode of coder `touch` for the conformance decoder, step by step as
docs/format/touch-exact.md says. `decode_touch.py` calls it.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
from decode_paper import codebook
from reading import Array, Cursor, Forces, Place, TruncatedFile, moved, need, samples_of
from touch_bits import Bits, Models, bricks

CODEBOOKS = [f"ico{n}" for n in range(1, 21)] + [f"octa{n}" for n in range(1, 6)]
BESIDE = [(0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, -1, -1), (-1, 0, -1), (-1, -1, 0), (0, -1, 1), (-1, 1, 0),
          (-1, 0, 1), (0, 0, -2), (0, -2, 0), (-2, 0, 0)]  # fmt: skip
NONE = 14

Symbols = tuple[int, ...]


class Known(NamedTuple):
    """A frame: forces, bricks, codebook, levels and vertices, symbols by place, and the models as it left
    them.
    """

    forces: Forces
    bricks: list[Place]
    book: int
    levels: Array
    vertices: Array
    symbols: dict[Place, Symbols]
    models: Models


def hashed(h: int, value: int) -> int:
    """One step of the hash of 22 bits."""
    t = ((h ^ value) & 4194303) * 0x2F0B4C47 + value
    return (t ^ (t >> 19)) & 4194303


@cache
def context(h: int, *values: int) -> int:
    """A context of the table, of few values, by the hash."""
    for value in values:
        h = hashed(h, value)
    return h & 262143


def about(kind: int, guess: int, node: int, left: int) -> int:
    """The context by how far the bits so far are from a guess."""
    ahead = min(max(node - (guess >> left + 1), -2), 2)
    return context(kind, ((ahead + 2) * 8 + (guess << 2 >> left & 7)) * 32 + left)


def symbol(bits: Bits, p: int, size: int, rows: list[int], last: int) -> int:
    """Read a symbol of plane p, given those of the plane before the sample, and its own of plane p - 1."""
    t, z, y, x, zy = rows
    guess = next((n for n in (z, y, x, t) if n >= 0), 0)
    if min(z, y, zy) >= 0:
        guess = min(max(z + y - zy, 0), size - 1)
    late, width, node = t if t >= 0 else guess, (size - 1).bit_length(), 0
    above, beside = hashed(40 + p, z), hashed(hashed(44 + p, last), x)
    for left in reversed(range(width)):
        contexts = [about(32 + p, guess, node, left), about(36 + p, late, node, left)]
        contexts += [hashed(h, node << 5 | left) & 262143 for h in (above, beside)]
        node = 2 * node + bits.mix(contexts, 32 * p + width - 1 - left)
    bits.need(node < size, "a symbol that there is not")
    return node


def sample(bits: Bits, sizes: list[int], rows: list[Symbols]) -> Symbols:
    """Read a sample, given the rows 1 to 14."""
    same = {c: sum((row == rows[c - 1]) << n for n, row in enumerate(rows)) for c in (NONE, 1, 2, 3, 4)}
    for c, alike in same.items():
        new = c == NONE or (rows[c - 1] != rows[-1] and not alike & (1 << c - 1) - 1)
        if new and bits.mix([context(c, alike), context(16 + c, alike & 31, same[2])], 96 + c):
            return rows[c - 1]
    own: list[int] = []
    for p, size in enumerate(sizes):
        own.append(symbol(bits, p, size, [row[p] for row in rows[:5]], own[-1] if p else 0))
    return tuple(own)


def in_order(words: Array) -> Array:
    """Bits of floats with a sign as whole numbers in the order of the floats, and back."""
    return np.where(words < 0, words ^ 0x7FFFFFFF, words)


def components(force: Array) -> Symbols:
    """The symbols of a force as it is."""
    return tuple((in_order(force.view(np.int32)).astype(int) + (1 << 31)).tolist())


def force_of(own: Symbols, levels: Array, vertices: Array) -> Array:
    """The force of symbols."""
    if len(own) == 2:
        return np.asarray(levels[own[0]] * vertices[own[1]])
    return in_order((np.array(own) - (1 << 31)).astype(np.int32)).view(np.float32)


def decode_exact(data: bytes, shape: Place, before: Known | None) -> Known:
    """A frame of a grid of so many samples, to the bit."""
    c = Cursor(data)
    book, (levels, vertices) = c.number("B"), np.zeros((2, 0, 3), np.float32)
    if before:
        need(book in (0, before.book), "a codebook that is not that of the frame before")
        levels, vertices = before.levels, before.vertices
    elif book:
        count = c.number("H")
        need(book <= 25 and count, "a codebook that there is not, or without levels")
        levels, vertices = np.array(c.numbers(f"{count}f"), np.float32), codebook(CODEBOOKS[book - 1])
        need(np.isfinite(levels).all(), "a level that is not finite")
    sizes = [len(levels), len(vertices)] if book else [1 << 32] * 3
    bits, known = Bits(c.rest(), before and before.models), before.symbols if before else {}
    if before and before.book != book:
        known = {at: components(force) for at, force in before.forces.items()}
    absent, symbols, forces = (-1,) * len(sizes), dict[Place, Symbols](), Forces()
    listed = bricks(bits, shape, before.bricks if before else ())
    need(4 * len(listed) <= bits.most, "more bricks than the bytes may tell", TruncatedFile)
    for brick in listed:
        for at in samples_of(brick, shape):
            rows = [known.get(at, absent), *(symbols.get(moved(at, step), absent) for step in BESIDE), absent]
            own = sample(bits, sizes, rows)
            if own != absent:
                symbols[at], forces[at] = own, force_of(own, levels, vertices)
                sound = np.isfinite(forces[at]).all() and forces[at].view(np.uint32).any()
                bits.need(sound, "a force of zero, or one that is not finite")
        bits.need(any(at in forces for at in samples_of(brick, shape)), "a brick without force")
    bits.end(4 * len(listed))
    return Known(forces, listed, book, levels, vertices, symbols, bits.models)

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
PLACES = [(0, 0, -1), (0, -1, 0), (-1, 0, 0), (0, -1, -1), (-1, 0, -1), (-1, -1, 0), (0, -1, 1), (-1, 1, 0),
          (-1, 0, 1), (0, 0, -2), (0, -2, 0), (-2, 0, 0)]  # fmt: skip
NOT_SUPPORTED = 14

Symbols = tuple[int, ...]


class ExactFrame(NamedTuple):
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


def about(kind: int, estimate: int, prefix: int, remaining: int) -> int:
    """The context by how far the bits so far are from an estimate."""
    distance = min(max(prefix - (estimate >> remaining + 1), -2), 2)
    return context(kind, ((distance + 2) * 8 + (estimate << 2 >> remaining & 7)) * 32 + remaining)


def symbol(bits: Bits, p: int, size: int, rows: list[int], last: int) -> int:
    """Decode a symbol of plane p, given those of rows 1 to 5 in it, and the sample's own of plane p - 1."""
    previous, left, up, deep, diagonal = rows
    spatial = next((n for n in (left, up, deep, previous) if n >= 0), 0)
    if min(left, up, diagonal) >= 0:
        spatial = min(max(left + up - diagonal, 0), size - 1)
    temporal, width, prefix = previous if previous >= 0 else spatial, (size - 1).bit_length(), 0
    by_left, by_last = hashed(40 + p, left), hashed(hashed(44 + p, last), deep)
    for remaining in reversed(range(width)):
        contexts = [
            about(32 + p, spatial, prefix, remaining),
            about(36 + p, temporal, prefix, remaining),
            *(hashed(h, prefix << 5 | remaining) & 262143 for h in (by_left, by_last)),
        ]
        prefix = 2 * prefix + bits.mix(contexts, 32 * p + width - 1 - remaining)
    bits.need(prefix < size, "a symbol that there is not")
    return prefix


def sample(bits: Bits, sizes: list[int], rows: list[Symbols]) -> Symbols:
    """Decode a sample, given the rows 1 to 14."""
    same = {
        c: sum((row == rows[c - 1]) << n for n, row in enumerate(rows)) for c in (NOT_SUPPORTED, 1, 2, 3, 4)
    }
    for c, equal_rows in same.items():
        is_candidate = c == NOT_SUPPORTED or (rows[c - 1] != rows[-1] and not equal_rows & (1 << c - 1) - 1)
        if is_candidate and bits.mix(
            [context(c, equal_rows), context(16 + c, equal_rows & 31, same[2])], 96 + c
        ):
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


def decode_exact(data: bytes, shape: Place, before: ExactFrame | None) -> ExactFrame:
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
    need(4 * len(listed) <= bits.max_bricks, "more bricks than the bytes may list", TruncatedFile)
    for brick in listed:
        for at in samples_of(brick, shape):
            rows = [known.get(at, absent), *(symbols.get(moved(at, step), absent) for step in PLACES), absent]
            own = sample(bits, sizes, rows)
            if own != absent:
                symbols[at], forces[at] = own, force_of(own, levels, vertices)
                sound = np.isfinite(forces[at]).all() and forces[at].view(np.uint32).any()
                bits.need(sound, "a force of zero, or one that is not finite")
        bits.need(any(at in forces for at in samples_of(brick, shape)), "a brick without force")
    bits.end(4 * len(listed))
    return ExactFrame(forces, listed, book, levels, vertices, symbols, bits.models)

"""The limits of coding a medium, so that a codec can be placed against its own data (theory sections 4 and 5).

Beside each other stand, of the same symbols S = Q(F) over all voxels of all frames: H(S) of the voxel and of the
object; block entropies and rates of the scan lines; H(S | causal neighbours), with and without the previous frame.
All are plug-in estimates of what an ideal coder with that context would need, too low where contexts are diluted.
What a real coder surely reaches is what one did: the bytes of a file of coder `touch` in its exact mode.

Time: one pass over the frames, which may be made when asked for. Memory: two frames and the different joint cells
(`CellCounter`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.measure.context import (
    NEIGHBOURHOODS,
    CellCounter,
    ContextCounter,
    ContextEntropy,
    scan_order,
    scan_relabelled,
)
from touchfield.measure.estimators import entropy_bits
from touchfield.measure.field_symbols import Fields, FieldSymbols, Frames
from touchfield.measure.quantity import Quantity
from touchfield.medium.field import brick_keys, bricks_of, slots_of
from touchfield.medium.grid import BRICK

MOST_IN_BLOCK = 64
_SAMPLES_AT_ONCE = 1 << 18
_TILE_SAMPLES = 1 << 20  # samples of scan lines laid out at once


@dataclass(frozen=True)
class BlockRates:
    """H(B_k) and h_k for k = 1 .. longest.

    `entropies` tuple of Quantity: H(B_k), bit. `rates` tuple of Quantity: h_k, bit/sample; the first is H(S).
    """

    entropies: tuple[Quantity, ...]
    rates: tuple[Quantity, ...]


class BlockCounter:
    """Counts the blocks of `longest` symbols of scan lines, which are rings.

    `alphabet`: symbols are below it. `longest`: 1 to 64, at most the samples along them. `quantiser`: as in
    `Quantity`.
    """

    def __init__(self, alphabet: int, longest: int, quantiser: str) -> None:
        if not (isinstance(longest, int | np.integer) and 1 <= longest <= MOST_IN_BLOCK):
            raise InvalidArgument("longest", repr(longest), f"a whole number from 1 to {MOST_IN_BLOCK}")
        self.longest, self._bits = int(longest), max(1, (alphabet - 1).bit_length())
        self._cells = CellCounter(self.longest, self._bits)
        self._of = quantiser, "voxel"

    def add_field(self, frame: FieldSymbols, axis: int) -> None:
        """Count the blocks of the scan lines of a sparse frame along an axis; empty space in closed form."""
        self._cells.zeros += frame.voxel_count
        per_word = 64 // self._bits
        for lines in _scan_lines(frame, axis, self.longest):
            held, begins = lines[lines.any(axis=1)], lines.shape[1] - self.longest + 1
            at_once = max(1, _SAMPLES_AT_ONCE // lines.shape[1])
            for row in range(0, len(held), at_once):
                some = held[row : row + at_once]
                words = np.zeros((len(some), begins, self._cells.words), np.uint64)
                for k in range(self.longest):
                    shift = np.uint64(k % per_word * self._bits)
                    words[:, :, k // per_word] |= some[:, k : k + begins].astype(np.uint64) << shift
                flat = words.reshape(-1, self._cells.words)
                filled = np.ascontiguousarray(flat[flat.any(axis=1)])
                self._cells.add(filled)
                self._cells.zeros -= len(filled)

    def result(self) -> BlockRates:
        """H(B_k) and h_k of what was counted."""
        entropies: list[Quantity] = []
        rates: list[Quantity] = []
        before = 0.0
        for k in range(1, self.longest + 1):
            blocks = self._cells.marginal(tuple(range(k)))
            counts, n = blocks.counts(), blocks.samples
            bits = entropy_bits(counts)
            informed = n - blocks.zeros
            notes: tuple[str, ...] = ()
            if informed < 10 * len(counts):
                notes = (f"{informed} blocks not all 0 for {len(counts)} kinds, fewer than ten each; too low",)
            of = Quantity(f"H(B_{k})", bits, "bit", *self._of, "plug-in", n, len(counts), None, notes)
            entropies.append(of)
            rates.append(of.of(name=f"h_{k}", value=max(0.0, bits - before), unit="bit/sample"))
            before = bits
        return BlockRates(tuple(entropies), tuple(rates))


def _scan_lines(frame: FieldSymbols, axis: int, longest: int) -> Iterator[Int32s]:
    """Pieces of the lines along an axis, int32 [m, b + longest - 1], some at a time.

    The first b samples of each piece are those of a brick; any block of the lines that is not all 0 begins at one of
    them, and at one only.
    """
    length = frame.grid.shape[axis]
    bricks = _begins(frame, axis, longest)
    last = bricks[:, axis] == frame.grid.brick_shape[axis] - 1
    of_last = length - (frame.grid.brick_shape[axis] - 1) * BRICK
    for some, begins in ((bricks[~last], BRICK), (bricks[last], of_last)):
        width = begins + longest - 1
        at_once = max(1, _TILE_SAMPLES // (BRICK * BRICK * width))
        for start in range(0, len(some), at_once):
            yield _lines_from(frame, axis, some[start : start + at_once], width)


def _begins(frame: FieldSymbols, axis: int, longest: int) -> Int64s:
    """The bricks at whose samples blocks begin that reach a symbol but 0, each once, int64 [n, 3]."""
    grid = frame.grid
    bricks = frame.bricks[frame.symbols.any(axis=(1, 2, 3))].astype(np.int64)
    there = np.repeat(bricks[:, None], longest, axis=1)
    # the first samples of blocks that end with the first of a brick, or later in it; lines are rings
    there[:, :, axis] = (bricks[:, None, axis] * BRICK - np.arange(longest)) % grid.shape[axis] // BRICK
    keys = np.unique(brick_keys(grid, there.reshape(-1, 3)))
    return bricks_of(grid, keys).astype(np.int64)


def _lines_from(frame: FieldSymbols, axis: int, bricks: Int64s, width: int) -> Int32s:
    """The 64 lines along an axis from each of some bricks on, int32 [n * 64, width], closed to rings."""
    grid = frame.grid
    keys = brick_keys(grid, frame.bricks)
    symbols = np.moveaxis(frame.symbols, axis + 1, 1)
    lines = np.zeros((len(bricks), BRICK, BRICK, width), np.int32)
    there = bricks.copy()
    for i in range(width):
        sample = (bricks[:, axis] * BRICK + i) % grid.shape[axis]
        there[:, axis] = sample // BRICK
        slot = slots_of(keys, brick_keys(grid, there))
        stored = slot >= 0
        lines[stored, :, :, i] = symbols[slot[stored], sample[stored] % BRICK]
    return lines.reshape(-1, width)


LINE_AXIS: Final = 2
"""Scan lines run along the fastest axis of the raster: z, or after `scan_relabelled` the one in its place."""


@dataclass(frozen=True)
class CodingLimits:
    """Rates that a coder of these frames can hope for.

    Of `voxels` in all frames `supported` are not 0. `voxel_entropy` and `object_entropy`: H(S) over all and over the
    supported voxels (NaN where there is none), bit/sample. `scan_lines`: of the lines along `scan_axis`, along which
    the one neighbour lies, too: "z", or the last axis that has more than one sample. `contexts`: 1, 3 and 7
    neighbours; and with the previous frame, where there is one, 0, 1, 3 and 7.
    """

    frame_count: int
    voxels: int
    supported: int
    voxel_entropy: Quantity
    object_entropy: Quantity
    scan_lines: BlockRates
    contexts: tuple[ContextEntropy, ...]
    scan_axis: str = "z"

    def context(self, neighbourhood: str, *, previous_frame: bool = False) -> ContextEntropy:
        """One of `contexts`; KeyError if it is not among them."""
        for one in self.contexts:
            if (one.neighbourhood, one.previous_frame) == (neighbourhood, previous_frame):
                return one
        raise KeyError((neighbourhood, previous_frame))

    def summary(self) -> dict[str, Any]:
        """Plain numbers under stable keys: bits a voxel, bits a supported voxel, bits a frame."""

        def plain(per_voxel: float) -> dict[str, float | None]:
            return {
                "bits_per_voxel": per_voxel,
                "bits_per_supported_voxel": per_voxel * self.voxels / self.supported if self.supported else None,
                "bits_per_frame": per_voxel * self.voxels / self.frame_count,
            }

        contexts = {
            c.per_voxel.name: {**plain(c.per_voxel.value), "contexts": c.contexts, "cells": c.cells,
                               "informed": c.informed, "once": c.once, "diluted": c.is_diluted}
            for c in self.contexts
        }  # fmt: skip
        return {
            "quantiser": self.voxel_entropy.quantiser,
            "frames": self.frame_count,
            "voxels": self.voxels,
            "supported_voxels": self.supported,
            "voxel_entropy": plain(self.voxel_entropy.value),
            "object_entropy_bits": self.object_entropy.value if self.supported else None,
            "scan_axis": self.scan_axis,
            "scan_lines": {q.name: plain(q.value) for q in self.scan_lines.rates},
            "contexts": contexts,
        }


def coding_limits(frames: Fields, *, longest: int = 4) -> CodingLimits:
    """The coding limits of quantised frames, of one grid and one Q, looked at once, in order.

    `longest`: the longest block of the scan lines; shortened to the samples along them. InvalidArgument if there is
    no frame, frames differ in grid or Q, or the joint cells outgrow the memory budget.

    Scan lines run along z, and the one neighbour lies there. Where z has a single sample, as on a flat array of
    actuators, both go along the last axis that has more, and the raster is that of an array without z: `scan_order`.
    """
    contexts, count, axis, last = None, 0, LINE_AXIS, None
    for given in Frames(frames, "frames"):
        frame = scan_relabelled(given)
        if contexts is None:
            axis = scan_order(given.grid)[LINE_AXIS]
            contexts = ContextCounter(frame.alphabet, frame.quantiser, previous_frame=True)
            blocks = BlockCounter(frame.alphabet, min(longest, frame.grid.shape[LINE_AXIS]), frame.quantiser)
        contexts.add(frame, last)
        blocks.add_field(frame, LINE_AXIS)
        count, last = count + 1, frame
    assert contexts is not None and last is not None  # Frames refuses none
    held, empty = contexts.symbol_counts()
    every, quantiser = np.append(held, empty) if empty else held, last.quantiser
    asked = [(name, False) for name in NEIGHBOURHOODS if name != "none"]
    if count > 1:
        asked += [(name, True) for name in NEIGHBOURHOODS]
    supported, unit = int(held.sum()), "bit/sample"
    bits, notes = (entropy_bits(held), ()) if supported else (math.nan, ("no voxel is supported",))
    return CodingLimits(
        count,
        supported + empty,
        supported,
        Quantity(
            "H(S)", entropy_bits(every), unit, quantiser, "voxel", samples=supported + empty, symbols=len(every)
        ),
        Quantity("H(S | S != 0)", bits, unit, quantiser, "object", samples=supported, symbols=len(held), notes=notes),
        blocks.result(),
        tuple(contexts.result(name, previous_frame=before) for name, before in asked),
        "xyz"[axis],
    )

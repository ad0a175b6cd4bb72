"""The exact mode: a field that is quantised already, to the bit of each float32 (docs/format/touch-exact.md).

A force is a few symbols, its planes: a level and a vertex of a direction codebook, whose float32 product it is, as
the coder `paper` makes them; or its components as they are. A frame after another goes on with what that has taught.
"""

from __future__ import annotations

from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float32s, Int32s, Int64s
from touchfield.codec.kernels.bits import Models, fresh, reader
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.support import check_end, code_bricks, padded
from touchfield.codec.touch.kernels import exact as kernels
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import slots_around

_WHERE: Final = "exact frame"


class Palette(NamedTuple):
    """How symbols become forces."""

    book: int  # 1 + the place of a codebook in `codebook_names`; 0: symbols are components
    levels: Float32s  # [k]; ascending, where there is a codebook

    @property
    def codebook(self) -> Codebook:
        """The codebook, if there is one."""
        return Codebook.get(codebook_names()[self.book - 1])

    @property
    def sizes(self) -> Int64s:
        """How many symbols each plane has, int64 [planes]."""
        return np.array([len(self.levels), len(self.codebook)] if self.book else [1 << 32] * 3)

    def forces(self, symbols: Int64s) -> Float32s:
        """Float32 [n, 3] of symbols, int64 [n, planes]."""
        if self.book:
            return self.levels[symbols[:, :1]] * self.codebook.vertices_float32[symbols[:, 1]]
        return _turned(symbols - (1 << 31)).astype(np.int32).view(np.float32)

    @classmethod
    def read(cls, data: bytes, before: Palette | None) -> tuple[Palette, bytes]:
        """The palette that a payload begins with, and the bytes behind it."""
        if data and before is not None:
            if data[0] not in (0, before.book):
                raise CorruptFile(_WHERE, f"codebook {data[0]}", f"0, or {before.book} as before")
            return before if data[0] else AS_THEY_ARE, data[1:]
        end = 3 + 4 * int.from_bytes(data[1:3], "little") if data[:1] != b"\0" else 1
        if len(data) < end:
            raise TruncatedFile(_WHERE, f"{len(data)} bytes", f"{end} bytes of a palette, or more")
        levels = np.frombuffer(data[3:end], "<f4").astype(np.float32)
        if data[0] > len(codebook_names()) or end == 3 or not np.isfinite(levels).all():
            raise CorruptFile(_WHERE, f"codebook {data[0]} of {len(levels)} levels", "finite levels of a codebook")
        return cls(data[0], levels), data[end:]


AS_THEY_ARE: Final = Palette(0, np.zeros(0, np.float32))  # the palette that has every force


class Told(NamedTuple):
    """A frame, and what the next one may know."""

    field: ForceField  # every brick holds a sample of which a bit is set
    palette: Palette
    symbols: Int64s  # [512 * bricks, planes]; -1 where there is no force
    models: Models


BRICK_COUNTS: Final = 4  # bricks of a payload that one of this mode counts for: it takes more memory than others


def _turned(numbers: Int64s) -> Int64s:
    """Float32 bits, int64 of their sign, as numbers that ascend with the value (-0.0 is -1); or back."""
    return np.where(numbers < 0, numbers ^ 0x7FFFFFFF, numbers)


def components(forces: Float32s) -> Int64s:
    """Symbols of forces, float32 [..., 3], as they are: int64 [any, 3]; -1 where there is none."""
    words = forces.reshape(-1, 3).view(np.int32)
    return np.where(words.any(axis=1, keepdims=True), _turned(words.astype(np.int64)) + (1 << 31), -1)


def models_after(before: Told | None) -> Models:
    """Models of a frame: they have seen what those before it have."""
    if before is None:
        return fresh(kernels.CONTEXTS, kernels.SETS)
    return Models(before.models.chances.copy(), before.models.weights.copy())


def decode_exact(data: bytes, grid: Grid, before: Told | None) -> Told:
    """Decode a frame that `exact_encoder.encode_exact` wrote.

    `before` is the frame before, unless the frame stands alone. TruncatedFile or CorruptFile if the bytes are not
    what that writes. Memory is taken for a quarter of the bricks that `codec.support` allows, some 32 KiB each, and 2
    MiB.
    """
    palette, data = Palette.read(data, before and before.palette)
    models = models_after(before)
    bits = reader(data, models)
    bricks = code_bricks(bits, 0, 0, grid.brick_shape, None, before and before.field.bricks)
    least = len(padded(b"", BRICK_COUNTS * len(bricks)))
    if len(data) < least:
        raise TruncatedFile(_WHERE, f"{len(data)} bytes for {len(bricks)} bricks", f"{least} or more")
    symbols = np.full((512 * len(bricks), len(palette.sizes)), -1)
    if not kernels.code_samples(bits, frame_of(grid, bricks, palette, symbols, before)):
        raise CorruptFile(_WHERE, "a symbol that there is not, or the end of the bytes", f"{len(bricks)} bricks")
    check_end(bits, BRICK_COUNTS * len(bricks), _WHERE)
    held, forces = symbols[:, 0] >= 0, np.zeros((len(bricks), 8, 8, 8, 3), np.float32)
    made = forces.reshape(-1, 3)[held] = palette.forces(symbols[held])
    if not np.isfinite(made).all() or not made.view(np.uint32).any(axis=1).all():
        raise CorruptFile(_WHERE, "a sample without force, or with one that is not finite", "forces")
    if not held.reshape(-1, 512).any(axis=1).all():
        raise CorruptFile(_WHERE, "a brick without force", "none")
    return Told(ForceField(grid, bricks, forces), palette, symbols, models)


def frame_of(grid: Grid, bricks: Int32s, palette: Palette, symbols: Int64s, before: Told | None) -> kernels.Frame:
    """The work of the pass over the samples; `symbols`, int64 [512 * bricks, planes], are told or filled in."""
    places = bricks.astype(np.int64)
    near, then = slots_around(places, places, grid.brick_shape), np.full_like(symbols, -1)
    near[:, 14:] = -1  # told later
    if before is not None:
        known = before.symbols if before.palette.book == palette.book else components(before.field.forces_n)
        slot = slots_around(places, before.field.bricks, grid.brick_shape, 14)[:, 13]
        brick = 512 * symbols.shape[1]
        then.reshape(-1, brick)[slot >= 0] = known.reshape(-1, brick)[slot[slot >= 0]]
    inside = np.minimum(np.array(grid.shape) - 8 * places, 8)
    rows = np.zeros((kernels.ROWS, symbols.shape[1]), np.int64)
    return kernels.Frame(near, inside, symbols, then, palette.sizes, rows, np.zeros(3))

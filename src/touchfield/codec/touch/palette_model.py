"""The lossless model: a field that is quantised already, exactly as it is, to the bit of each float32.

For a field decoded from a ``.touch`` file of any coder, or forces of a finite set. The support is coded as in
`codec.support`; the forces become symbols of a palette (`palette`), and the symbols are coded with the chances of
those beside them in space and in the frame before (`kernels.touch_palette`).

The bytes: varint size of the support's bytes, those bytes (`support.encode_support`, given the support of the frame
before), and nothing more where it is empty. Then a byte: 0, and the forces' float32 bits follow as they are,
little-endian, in raster order within each brick; or 1, and the palette and the code of the symbols follow.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.code_end import check_end
from touchfield.codec.support import decode_support, encode_support
from touchfield.codec.touch.palette import Palette, Products, read_palette
from touchfield.codec.touch.palette_fit import fitting_palettes
from touchfield.codec.varint import read_varint, write_varint
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK, Grid

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Bits = NDArray[np.uint32]
    Int32s = NDArray[np.int32]
    Slots = NDArray[np.int64]
    Bricks = tuple[NDArray[np.int32], NDArray[np.bool_]]
    Shares = tuple[float, float, float]

__all__ = ["PaletteModel"]

_PLAIN, _CODED = 0, 1
_INFINITY: Final = 0x7F800000
_MAGNITUDE: Final = 0x7FFFFFFF
_WHERE = "lossless frame"


class PaletteModel:
    """Codes a frame without any loss."""

    number = 3
    """What the file says for it."""

    def encode(self, frame: ForceField, previous: ForceField | None = None) -> tuple[bytes, Shares]:
        """Code one frame.

        Parameters
        ----------
        frame : ForceField
            A sample whose three components are all 0.0 holds no force; one of -0.0 does.
        previous : ForceField, optional
            The frame before, on the same grid; the decoder must be given the same.

        Returns
        -------
        payload : bytes
        bits : (float, float, float)
            Of support, amplitude and direction. A palette of vectors or components tells both at once: a third of
            its bits counts as amplitude, as one of three numbers is.

        Raises
        ------
        InvalidArgument
            If a force is not finite, or the grids are two.
        """
        if not np.isfinite(frame.forces_n).all():
            raise InvalidArgument("forces_n", "a force that is not finite", "finite newtons")
        grid = frame.grid
        bricks, mask, bits = _held(frame)
        support = encode_support(grid, bricks, mask, _support_before(grid, previous))
        head = write_varint(len(support)) + support
        if not len(bricks):
            return head, (8.0 * len(head), 0.0, 0.0)
        slots = np.flatnonzero(mask)
        vectors, before = bits[slots], _bits_before(grid, bricks, slots, previous)
        near = _near(grid, bricks, slots)
        plain = vectors.astype("<u4").tobytes()
        best, shares = bytes([_PLAIN]) + plain, (8.0 * len(plain) / 3, 16.0 * len(plain) / 3)
        for palette in fitting_palettes(vectors):
            body, split = _coded(palette, vectors, before, near)
            if len(body) < len(best):
                best, shares = body, split
        return head + best, (8.0 * len(head), *shares)

    def decode(self, payload: bytes, grid: Grid, previous: ForceField | None = None) -> ForceField:
        """The inverse.

        Memory is bounded by the support's (`decode_support`).

        Raises
        ------
        TruncatedFile, CorruptFile
            If the bytes are not what `encode` writes.
        """
        size, at = read_varint(payload, 0, f"{_WHERE}, bytes of the support")
        if size > len(payload) - at:
            raise TruncatedFile(_WHERE, f"{len(payload) - at} bytes", f"a support of {size}")
        bricks, mask = decode_support(payload[at : at + size], grid, _support_before(grid, previous))
        at += size
        if not len(bricks):
            if at < len(payload):
                raise CorruptFile(_WHERE, "bytes behind an empty support", f"{at} bytes")
            return ForceField.empty(grid)
        slots = np.flatnonzero(mask)
        if at >= len(payload):
            raise TruncatedFile(_WHERE, "the end of the bytes after the support", "its forces")
        if payload[at] == _PLAIN:
            vectors = _plain(payload[at + 1 :], len(slots))
        elif payload[at] == _CODED:
            before = _bits_before(grid, bricks, slots, previous)
            vectors = _decoded(payload, at + 1, before, _near(grid, bricks, slots))
        else:
            raise CorruptFile(_WHERE, f"kind {payload[at]} of forces", "0 (plain) or 1 (coded)")
        _check(vectors)
        forces = np.zeros((len(bricks), BRICK, BRICK, BRICK, 3), np.float32)
        forces.reshape(-1, 3)[slots] = vectors.view(np.float32)
        return ForceField(grid, bricks, forces)


def _coded(
    palette: Palette, vectors: Bits, before: Bits, near: NDArray[np.int32]
) -> tuple[bytes, tuple[float, float]]:
    from touchfield.codec.kernels import touch_palette as kernels

    symbols, previous = palette.encode(vectors), palette.encode(before)
    _, coder, spent = kernels.code_symbols(None, symbols, previous, near, palette.sizes)
    place, end = coder.tail()
    told = palette.to_bytes()
    body = bytes([_CODED]) + told + coder.buffer[:place].tobytes() + end
    whole = 8.0 * len(body)
    if isinstance(palette, Products):
        direction = float(spent[2]) + float(spent[0]) / 2
        return body, (whole - direction, direction)
    return body, (whole / 3, whole * 2 / 3)


def _decoded(payload: bytes, at: int, before: Bits, near: Int32s) -> Bits:
    from touchfield.codec.kernels import touch_palette as kernels

    palette, at = read_palette(payload, at, len(near))
    symbols = np.zeros((len(near), len(palette.sizes)), np.int32)
    code = np.frombuffer(payload, np.uint8, offset=at).copy()
    status, coder, _ = kernels.code_symbols(code, symbols, palette.encode(before), near, palette.sizes)
    check_end(status, coder.tail(), payload[at:], _WHERE)
    return palette.decode(symbols)


def _plain(data: bytes, count: int) -> Bits:
    if len(data) < 12 * count:
        raise TruncatedFile(_WHERE, f"{len(data)} bytes", f"{count} forces of 12")
    if len(data) > 12 * count:
        raise CorruptFile(_WHERE, f"{len(data)} bytes", f"{count} forces of 12")
    return np.frombuffer(data, "<u4").reshape(-1, 3).astype(np.uint32)


def _check(vectors: Bits) -> None:
    if ((vectors & np.uint32(_MAGNITUDE)) >= _INFINITY).any():
        raise CorruptFile(_WHERE, "a force that is not finite", "finite newtons")
    if not vectors.any(axis=1).all():
        raise CorruptFile(_WHERE, "a supported sample without force", "a force at each")


# -- what both sides make of the fields -------------------------------------------------------------------


def _held(field: ForceField) -> tuple[NDArray[np.int32], NDArray[np.bool_], Bits]:
    """Bricks that hold anything, the mask of their samples, and their float32 bits [n * 512, 3]."""
    bits: Bits = field.forces_n.view(np.uint32)
    mask: NDArray[np.bool_] = np.bitwise_or.reduce(bits, axis=-1) != 0
    held = np.logical_or.reduce(mask, axis=(1, 2, 3))
    if not held.all():
        return field.bricks[held], mask[held], bits[held].reshape(-1, 3)
    return field.bricks, mask, bits.reshape(-1, 3)


def _support_before(grid: Grid, previous: ForceField | None) -> Bricks | None:
    if previous is None:
        return None
    if previous.grid != grid:
        raise InvalidArgument("the frame before", "another grid", "the grid of the frame")
    bricks, mask, _ = _held(previous)
    return bricks, mask


def _bits_before(grid: Grid, bricks: Int32s, slots: Slots, previous: ForceField | None) -> Bits:
    """The float32 bits of the frame before at the samples, [n, 3]; [0, 3] without such a frame."""
    if previous is None:
        return np.zeros((0, 3), np.uint32)
    forces = previous.forces_at(brick_keys(grid, bricks))
    return forces.reshape(-1, 3)[slots].view(np.uint32)


def _near(grid: Grid, bricks: Int32s, slots: Slots) -> Int32s:
    from touchfield.codec.kernels import touch_palette as kernels

    keys = brick_keys(grid, bricks)
    before = np.full((len(bricks), 3), -1, np.int64)
    _, by, bz = grid.brick_shape
    for axis, stride in enumerate((by * bz, bz, 1)):
        wanted = keys - stride
        place = np.searchsorted(keys, wanted)
        there = (bricks[:, axis] > 0) & (keys[np.minimum(place, len(keys) - 1)] == wanted)
        before[there, axis] = place[there]
    assert math.prod(grid.brick_shape) < 1 << 62 and slots[-1] < len(bricks) * BRICK**3
    return kernels.neighbours(slots, before)

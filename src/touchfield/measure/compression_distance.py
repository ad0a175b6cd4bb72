"""Normalised compression distance of two haptic media (paper section 4: "similarity estimation").

Source: R. Cilibrasi and P. M. B. Vitanyi, "Clustering by compression", IEEE Trans. Inf. Theory 51, 2005::

    NCD(x, y) = (C(xy) - min(C(x), C(y))) / max(C(x), C(y))

with C the bytes that a compressor makes of the packed symbols. It sees what no count of symbols sees: a part of one
medium that comes back in the other at another place.

It is no metric. NCD(x, x) is small and not 0, for the second copy costs some bytes; the triangle inequality holds to
within the compressor's overhead, and only for a compressor that is "normal" in the sense of the source. What is exact
here is symmetry: the two are put in one order, whichever was given first.

A compressor that looks back over less than both media does not find the one in the other (M. Cebrian, M. Alfonseca
and A. Ortega, Communications in Information and Systems 5, 2005): "zlib" looks back over 32 KiB, which a note says
where it matters; "lzma" is given a dictionary of the size of both.
"""

from __future__ import annotations

import lzma
import zlib
from collections.abc import Callable
from typing import Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.measure.field_frames import Fields, Frames
from touchfield.measure.quantity import Quantity
from touchfield.medium.field import brick_keys
from touchfield.medium.grid import BRICK

__all__ = ["COMPRESSORS", "compression_distance", "packed"]

MOST_BYTES: Final = 1 << 25
"""Of the packed symbols of both media; lzma takes about twelve times as much memory."""

ZLIB_WINDOW_BYTES: Final = 1 << 15
_COUNT_BYTES: Final = 8
_NOT_A_METRIC: Final = "not a metric: NCD(x,x) is not 0, and the triangle inequality holds only nearly"


def compression_distance(first: Fields, second: Fields, compressor: str = "lzma") -> Quantity:
    """NCD of two media of one lattice and one Q; about 0 for equal ones, about 1 for unrelated ones.

    Parameters
    ----------
    first, second : FieldSymbols, or sequences of them
        They may differ in length. Each frame is asked for once.
    compressor : str
        One of `COMPRESSORS`.

    Returns
    -------
    Quantity
        "NCD(S,T)", unit "1", mu "voxel", the compressor as its estimator.

    Raises
    ------
    InvalidArgument
        If the compressor is unknown, lattice or Q differ, or both together take more than 32 MiB when packed.
    """
    if compressor not in COMPRESSORS:
        raise InvalidArgument("compressor", repr(compressor), f"one of {', '.join(COMPRESSORS)}")
    media = Frames(first, "first"), Frames(second, "second")
    a, b = media
    if (a.grid, a.quantiser, a.alphabet) != (b.grid, b.quantiser, b.alphabet):
        raise InvalidArgument("second", "another lattice or quantiser", "those of the first")
    voxels = a.grid.voxel_count * (a.count + b.count)
    data = [packed(media[0], MOST_BYTES)]
    data.append(packed(media[1], MOST_BYTES - len(data[0])))
    data.sort(key=lambda d: (len(d), d))  # so that the order does not matter
    x, y = data
    window = max(1 << 12, 1 << (len(x) + len(y)).bit_length())
    one, other, both = (COMPRESSORS[compressor](d, window) for d in (x, y, x + y))
    notes = [f"C is {compressor}", _NOT_A_METRIC]
    if compressor == "zlib" and len(x) + len(y) > ZLIB_WINDOW_BYTES:
        found = f"{(len(x) + len(y)) / 1024:.0f} KiB of symbols"
        notes.append(f"{found} are more than the 32 KiB that zlib looks back over: it may miss what is alike")
    value = (both - min(one, other)) / max(one, other)
    return Quantity(
        "NCD(S,T)", value, "1", a.quantiser, "voxel", compressor, samples=voxels, notes=tuple(notes)
    )  # fmt: skip


def packed(frames: Frames, most_bytes: int = MOST_BYTES) -> bytes:
    """The symbols of all frames as bytes, the same for the same symbols however they are stored.

    For each frame the number of bricks that hold a force, the place of each as the distance from the one before it,
    and its 512 symbols, in whole bytes, the low bytes of a brick before the high ones.

    Raises
    ------
    InvalidArgument
        If there are more than `most_bytes`.
    """
    width = max(1, -(-(frames.alphabet - 1).bit_length() // 8))
    parts: list[bytes] = []
    total = 0
    for n in range(frames.count):
        field = frames.take(n)
        held = field.symbols.any(axis=(1, 2, 3))
        total += _COUNT_BYTES + int(held.sum()) * (_COUNT_BYTES + BRICK**3 * width)
        if total > most_bytes:
            raise InvalidArgument(
                "symbols to compress", f"more than {MOST_BYTES >> 20} MiB of both media",
                f"up to {MOST_BYTES >> 20} MiB", "Take fewer frames, a coarser lattice, or no NCD.",
            )  # fmt: skip
        keys = brick_keys(field.grid, field.bricks[held])
        symbols = field.symbols[held].reshape(len(keys), BRICK**3).astype("<u4")
        planes = symbols.view(np.uint8).reshape(len(keys), BRICK**3, 4)[:, :, :width].transpose(0, 2, 1)
        parts += [len(keys).to_bytes(_COUNT_BYTES, "little"), np.diff(keys, prepend=0).astype("<u8").tobytes()]
        parts.append(planes.tobytes())
    return b"".join(parts)


def _lzma_bytes(data: bytes, window_bytes: int) -> int:
    filters = [{"id": lzma.FILTER_LZMA2, "preset": 6, "dict_size": window_bytes}]
    return len(lzma.compress(data, lzma.FORMAT_RAW, filters=filters))


def _zlib_bytes(data: bytes, window_bytes: int) -> int:
    return len(zlib.compress(data, 9))


COMPRESSORS: Final[dict[str, Callable[[bytes, int], int]]] = {"lzma": _lzma_bytes, "zlib": _zlib_bytes}
"""C, the bytes of compressed data, by name; the second argument is how far back it should look, bytes."""

"""Decoding by `touchfield._native` (``c/touch.h``), without compiling kernels first.

Its forces are equal to those of the Python decoder bit by bit. The Python decoder decodes, or rejects with a
message, whatever the compiled module rejects. A source install on a machine without a C compiler has no such
module.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.medium import ForceField, Grid

if TYPE_CHECKING:
    from touchfield.container import TouchReader


MAX_FILE_BYTES: Final = 1 << 28
"""Largest file that the compiled module decodes, as all of it is in memory."""


@cache
def native_module() -> Any:
    """The compiled module, or None if this install has none."""
    try:
        return import_module("touchfield._native")
    except ImportError:
        return None


def decoder(
    reader: TouchReader, grid: Grid, fallback: Callable[[int], Iterator[ForceField]]
) -> Callable[[int], Iterator[ForceField]] | None:
    """``decode(segment) -> iterator`` over its fields; `fallback` decodes what the module rejects.

    None if this install has no compiled module, or does not decode such a file.
    """
    native = native_module()
    if native is None or reader.head.coder != "touch" or reader.is_remote or reader.size > MAX_FILE_BYTES:
        return None
    file = cache(lambda: native.open(reader.read_all()))

    def fields(segment: int) -> Iterator[ForceField]:
        count = 0
        try:
            frames = native.frames(file(), segment)
            while (frame := native.next(frames)) is not None:
                yield _field(grid, *frame)
                count += 1
        except (TypeError, ValueError):  # not supported by the module, or inconsistent bytes
            python_fields = fallback(segment)
            for _ in range(count):
                next(python_fields)
            yield from python_fields

    return fields


def _field(grid: Grid, brick_numbers: bytes, forces: bytes) -> ForceField:
    """The field of bricks in any order, without the bricks whose forces are all zero bits."""
    raster = np.frombuffer(brick_numbers, np.uint32)
    forces_n = np.frombuffer(forces, np.float32).reshape(-1, 8, 8, 8, 3)
    with_force = np.flatnonzero(forces_n.view(np.uint32).any(axis=(1, 2, 3, 4)))
    order = with_force[np.argsort(raster[with_force])]
    positions = np.stack(np.unravel_index(raster[order], grid.brick_shape), axis=1).astype(np.int32)
    return ForceField(grid, positions, forces_n[order])

"""Frames by `touchfield_core`, where it is installed: ``c/touch.h`` in place of kernels that would first be
compiled.

Its forces are those of the decoder in Python to the bit. What it refuses that one decodes, or refuses in
words.
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


MOST_BYTES: Final = 1 << 28
"""Of a file: all of it lies in memory."""


@cache
def _core() -> Any:
    try:
        return import_module("touchfield_core")
    except ImportError:
        return None


def decoder(
    reader: TouchReader, grid: Grid, otherwise: Callable[[int], Iterator[ForceField]]
) -> Callable[[int], Iterator[ForceField]] | None:
    """``decode(segment) -> iterator`` over its fields; `otherwise` decodes what C refuses.

    None if `touchfield_core` is not there, or the file none that it decodes.
    """
    core = _core()
    if core is None or reader.head.coder != "touch" or reader.is_remote or reader.size > MOST_BYTES:
        return None
    file = cache(lambda: core.open(reader.read_all()))

    def fields(segment: int) -> Iterator[ForceField]:
        count = 0
        try:
            frames = core.frames(file(), segment)
            while (frame := core.next(frames)) is not None:
                yield _field(grid, *frame)
                count += 1
        except (TypeError, ValueError):  # no file for C, or bytes that contradict themselves
            coming = otherwise(segment)
            for _ in range(count):
                next(coming)
            yield from coming

    return fields


def _field(grid: Grid, numbers: bytes, forces: bytes) -> ForceField:
    """The field of bricks in any order; those without a force, to the bit, are left out."""
    raster = np.frombuffer(numbers, np.uint32)
    forces_n = np.frombuffer(forces, np.float32).reshape(-1, 8, 8, 8, 3)
    holds = np.flatnonzero(forces_n.view(np.uint32).any(axis=(1, 2, 3, 4)))
    order = holds[np.argsort(raster[holds])]
    places = np.stack(np.unravel_index(raster[order], grid.brick_shape), axis=1).astype(np.int32)
    return ForceField(grid, places, forces_n[order])

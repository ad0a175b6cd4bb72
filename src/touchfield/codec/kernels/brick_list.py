"""Compiled loop of the list of bricks: a bit for each box of a level of the octree."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, NamedTuple

import numpy as np

from touchfield.codec.kernels.bits import mix
from touchfield.lean import entry

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CONTEXTS", "NEIGHBOURS", "SETS", "UNKNOWN", "Level", "code_level"]

NEIGHBOURS: Final = (
    (-1, 0, 0), (0, -1, 0), (0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1),
    (-1, -1, 0), (-1, 1, 0), (-1, 0, -1), (-1, 0, 1), (0, -1, -1), (0, -1, 1),
)  # fmt: skip
"""The six faces, those told first before the others, and the six edges told before."""

UNKNOWN: Final = 2
"""State of a box that may hold bricks, for its parent does."""

_EDGES: Final = 1 + 729
_CHANGED: Final = _EDGES + 512
_FOUND: Final = _CHANGED + 16
CONTEXTS: Final = _FOUND + 4
SETS: Final = 2


class Level(NamedTuple):
    """Boxes of one size whose parents hold bricks.

    Attributes
    ----------
    keys : int64 [n]
        Their places, ascending.
    parents : int64 [n]
        Their parents' places in the level above.
    left, found : int64 [parents]
        Children not told yet, and those that hold bricks.
    before : uint8 [n + 1]
        1 where the list known before has bricks; the last is 0.
    state : uint8 [n + 1]
        `UNKNOWN`, and when told 1 or 0; the last, of all that is not listed, is 0.
    steps, places : int64 [12]
        From a key to its neighbours', and where in `keys` they are.
    """

    keys: NDArray[np.int64]
    parents: NDArray[np.int64]
    left: NDArray[np.int64]
    found: NDArray[np.int64]
    before: NDArray[np.uint8]
    state: NDArray[np.uint8]
    steps: NDArray[np.int64]
    places: NDArray[np.int64]


@entry
def code_level(bits, level, contexts_at, sets_at, wanted):
    """Tell which boxes hold bricks, when writing those `wanted`, uint8 [n]; an only child does untold."""
    count = level.keys.shape[0]
    for n in range(count):
        faces, edges, changed = np.int64(0), np.int64(0), np.int64(0)
        for k in range(12):
            key, place = level.keys[n] + level.steps[k], level.places[k]
            while place < count and level.keys[place] < key:
                place += 1
            level.places[k] = place
            if place == count or level.keys[place] != key:
                place = count
            state = np.int64(level.state[place])
            if k >= 6:
                edges = edges << 1 | state
            else:
                faces = faces * 3 + state
            if k < 3:
                edges = edges << 1 | state
                changed = changed << 1 | (state ^ np.int64(level.before[place]))
        old, parent, bit = np.int64(level.before[n]), level.parents[n], np.int64(1)
        level.left[parent] -= 1
        found = np.int64(level.found[parent] > 0)
        if found or level.left[parent]:
            bits.inputs[0] = contexts_at + 1 + (0 if old else faces)
            bits.inputs[1] = contexts_at + _EDGES + edges
            bits.inputs[2] = contexts_at + _CHANGED + 8 * old + changed
            bits.inputs[3] = contexts_at + _FOUND + 2 * old + found
            bit = mix(bits, 4, sets_at + old, np.int64(wanted[n]))
        level.state[n] = bit
        level.found[parent] += bit

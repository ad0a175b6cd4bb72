"""What the quick model of coder `touch` expects at a sample: one neighbour followed by the law, or the reference.

A single neighbour keeps its error, and so stays within a promise that is relative for long; and it is the least work.
"""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.touch_quick_cells import direction_of, losses, ready
from touchfield.codec.kernels.touch_quick_coder import quick

__all__ = ["SATURATED", "USUAL", "expect"]

USUAL, LEAST = 6, 7
"""Places in the law, int64 [8], behind the slopes and components of the axes: the way of the frame, and the least
amplitude expected."""

SATURATED = (1 << 16) - (1 << 10)
"""An amplitude from here on is at the top: it tells nothing of the law."""

_MOST = (1 << 18) - 1


@quick
def _ahead(cells, at, axis, law):
    """The amplitude that a cell makes likely one step on."""
    c = np.uint64(at * 8)
    a = np.int64(cells[c + np.uint64(3)])
    if a >= SATURATED:
        return a
    return min(max(a - np.int64(cells[c + np.uint64(5 + axis)]), a >> 3, law[LEAST]), _MOST)


@quick
def expect(way, at, up, deep, deep_up, deep_down, in_d, in_u, in_l, there, cells, own, vectors, slot, last,
           law):  # fmt: skip
    """Direction, amplitude and losses that are expected.

    Parameters
    ----------
    way : int
        0 the reference, where it has a force; 1 to 3 the neighbour along that axis of the scan.
    at, up, deep, deep_up, deep_down : int
        Cells of the sample and of its neighbours; the three across faces are ready where ``in_*`` says they hold.
    own : int
        Whether the reference has a force there, its vector at `slot` of `vectors`.
    last : int64 [4]
        Direction and amplitude decoded last.
    """
    near = in_d + in_u + in_l
    if own and (way == 0 or near == 0):
        s = np.uint64(slot)
        u0, u1, u2, a = direction_of(np.int64(vectors[s, 0]), np.int64(vectors[s, 1]), np.int64(vectors[s, 2]))
        l0, l1, l2 = losses(u0, u1, u2, law)
        return u0, u1, u2, a, l0, l1, l2
    if near == 0:
        u0, u1, u2, a = last[0], last[1], last[2], last[3]
        for n in range(6):
            if n < 2:
                other = deep_up if n == 0 else deep_down
            elif n < 4:
                other = deep + 5 - 2 * n
            else:
                other = up + 9 - 2 * n
            if there[np.uint64(other)] != 0:
                ready(other, there, cells, law)
                c = np.uint64(other * 8)
                u0, u1, u2 = np.int64(cells[c]), np.int64(cells[c + np.uint64(1)]), np.int64(cells[c + np.uint64(2)])
                a = np.int64(cells[c + np.uint64(3)])
                break
        l0, l1, l2 = losses(u0, u1, u2, law)
        return u0, u1, u2, a, l0, l1, l2
    if way == 0:
        way = law[USUAL]
    axis = way - 1
    in_way = in_d if axis == 0 else (in_u if axis == 1 else in_l)
    if in_way == 0:
        axis = np.int64(0) if in_d else (np.int64(1) if in_u else np.int64(2))
    other = deep if axis == 0 else (up if axis == 1 else at - 1)
    c = np.uint64(other * 8)
    a = np.int64(cells[c + np.uint64(3)])
    if a < SATURATED:
        a = _ahead(cells, other, axis, law)
    elif near > 1:
        # beside one at the top: it stays there, or comes down by the others
        total = np.int64(0)
        if in_d and axis != 0:
            total += _ahead(cells, deep, 0, law)
        if in_u and axis != 1:
            total += _ahead(cells, up, 1, law)
        if in_l and axis != 2:
            total += _ahead(cells, at - 1, 2, law)
        if near == 3:
            total >>= 1
        if total < SATURATED - 1024:
            a = total
    return (
        np.int64(cells[c]), np.int64(cells[c + np.uint64(1)]), np.int64(cells[c + np.uint64(2)]), a,
        np.int64(cells[c + np.uint64(5)]), np.int64(cells[c + np.uint64(6)]), np.int64(cells[c + np.uint64(7)]),
    )  # fmt: skip

"""One pass over a frame in the quick model of coder `touch`: one text, compiled to an encoder and to a decoder.

Planes from deep to shallow; in a plane the 8x8 tiles of the listed bricks, row by row; in a tile a state, and in a
coded tile the samples row by row: a bit of support, then the residual to what is expected. Where ``forces`` is None
it decodes. See `touch_quick_cells` for the working storage and `touch_quick_coder` for the bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.kernels.touch_light_choice import F0, MOVABLE, tolerance, units
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_quick_cells import HELD, ready, scaled
from touchfield.codec.kernels.touch_quick_choice import good
from touchfield.codec.kernels.touch_quick_coder import ROOM, plain, price
from touchfield.codec.kernels.touch_quick_predict import USUAL, expect
from touchfield.codec.kernels.touch_quick_residual import RESIDUALS, code_residual
from touchfield.codec.kernels.touch_quick_tiles import (
    CODED,
    EMPTY,
    choose_state,
    code_state,
    code_way,
    copy_tile,
    mark,
    turned,
    turned_back,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = ["CHANCES", "DONE", "ENDED", "FULL", "USUAL", "code_frame", "workspace"]

DONE, ENDED, FULL = 0, 1, 2

_BIT = RESIDUALS
CHANCES = _BIT + (1 << 14)
"""How many chances there are."""


@lean
def code_frame(
    forces, scale, rule, out, reference, reference_slot, where, tiles, low, high, layers, layer_at, stride, width,
    law, ways, lattice, border, first, state, data, chances, prices, there, was, cells, tile_state, tile_way, held_by,
    filled, last, found, f, made, old, asked,
):  # fmt: skip
    """Code or decode a frame.

    Parameters
    ----------
    forces : float32 [s, 3] or None
        The original by slots, newtons; None when decoding.
    scale : float
        Units of a newton.
    rule : float64 [6]
        See `touch_light_choice`.
    out : int32 [s, 3]
        Takes the decoded vectors by slots, units.
    reference : int32 [m, 3]
        Vectors of the reference by its slots.
    reference_slot : int64 [n]
        The first slot of each brick in it, or -1, turned as the scan is.
    where, tiles, low, high, layers, layer_at, stride, width
        See `touch_light.code_frame`.
    law : int64 [8]
        What the amplitude loses in a step along each axis of the scan where the force points along it, units; which
        component that is; and what `touch_quick_predict` names.
    ways : int64 [n]
        How each brick is predicted, in scan order; when decoding zeros. 4 is added once it is coded.
    lattice, border, first : int64
    state : int64 [3]
        The arithmetic coder's, as `touch_light_coder.start` makes it.
    data : uint8
        The code; when decoding with `ROOM` zeros behind it.
    chances : uint32 [CHANCES]
    prices : float64 [4]
        When encoding the bits of support, amplitude and direction of one tile in four; and how many samples are to be
        sent apart.
    there, was, cells, tile_state, tile_way, held_by, filled, last, found, f, made, old, asked
        Room to work in, from `workspace`.

    Returns
    -------
    status : int
        `ENDED`: the code ends early. `FULL`: the buffer does not hold it.
    """
    plane = 8 * width
    x, span, place = state[0], state[1], state[2]
    end = np.int64(data.shape[0]) - ROOM
    ring = np.int64(0)
    size = tol = paid = 0.0
    priced = False
    zero, one = np.int64(0), np.int64(1)
    last[0] = last[1] = 0
    last[2] = 65536
    last[3] = max(lattice[0], 1)
    begin_of_last = end_of_last = zero
    for layer in range(layer_at.shape[0]):
        gap = layer > 0 and layer_at[layer] != layer_at[layer - 1] + 1
        for n in range(layers[layer], layers[layer + 1]):
            held_by[np.uint64(tiles[n, 0])] = layer + 1
        for n in range(begin_of_last, end_of_last):
            column = tiles[n, 0]
            if gap or held_by[np.uint64(column)] != layer + 1:
                tile_state[np.uint64(column)] = 0
                filled[np.uint64(column)] = 0
        begin_of_last, end_of_last = layers[layer], layers[layer + 1]
        # a layer of bricks in the order of the scan, plane by plane: its samples lie side by side then
        base = layers[layer]
        for n in range(base, layers[layer + 1]):
            turned(made, n - base, where[n], stride, None)
            if reference_slot[n] >= 0:
                turned(old, n - base, reference_slot[n], stride, reference)
            if forces is not None:
                turned(asked, n - base, where[n], stride, forces)
        if gap:
            for at in range(3 * plane):
                there[at] = 0
                was[at] = 0
        for i in range(8):
            ring = ring + 1 if ring < 2 else zero
            here_plane = ring * plane
            back_plane = (ring - 1 if ring > 0 else np.int64(2)) * plane
            for at in range(here_plane, here_plane + plane):
                there[at] = 0
                was[at] = 0
            if i < low[layers[layer], 0] or i >= high[layers[layer], 0]:
                continue
            for n in range(layers[layer], layers[layer + 1]):
                column = np.uint64(tiles[n, 0])
                any_old = zero
                if reference_slot[n] >= 0:
                    any_old = mark(was, here_plane + tiles[n, 0], width, old, (n - base) * 512 + i * 64)
                filled[column] = (filled[column] & 1) | any_old << 1
            for n in range(layers[layer], layers[layer + 1]):
                column = tiles[n, 0]
                c_column = np.uint64(column)
                row = here_plane + column
                back = back_plane + column
                begin = (n - base) * 512 + i * 64
                listed = reference_slot[n] >= 0
                if forces is None:
                    if place > end + 14:
                        return ENDED
                else:
                    if place > end:
                        return FULL
                    priced = column & 24 == 8
                # -- the tile's state
                is_deep = filled[c_column] & 1
                is_old = filled[c_column] >> 1
                mode = np.int64(CODED)
                if forces is not None:
                    mode = choose_state(
                        is_deep, is_old, asked, scale, there, cells, was, old, row, back, width, begin, low[n],
                        high[n], rule, f, law,
                    )  # fmt: skip
                    if priced:
                        paid = price(span, place)
                context = tile_state[c_column] | tile_state[np.uint64(column - 8)] << 2
                context |= tile_state[np.uint64(tiles[n, 1])] << 4
                context = context * 3 + is_old + np.int64(listed)
                mode, span, x, place = code_state(
                    mode, context, is_deep, is_old, forces, span, x, place, data, chances
                )
                if forces is not None and priced:
                    prices[0] += price(span, place) - paid
                tile_state[c_column] = mode
                if mode != CODED:
                    filled[c_column] = np.int64(mode != EMPTY)
                    if mode == EMPTY:
                        continue
                    copy_tile(mode, there, cells, was, old, made, row, back, width, begin, low[n], high[n], law)
                    continue
                way = ways[n]
                if way < 4:
                    about = tile_way[c_column] * 5 + tile_way[np.uint64(column - 8)]
                    way, span, x, place = code_way(way, about, forces, span, x, place, data, chances)
                    way |= 4
                    ways[n] = way
                    tile_way[c_column] = way - 3
                way &= 3
                # -- its samples
                any_set = zero
                for j in range(low[n, 1], high[n, 1]):
                    row_up = row + (j - 1) * width if j > 0 else here_plane + 7 * width + tiles[n, 1]
                    row_deep = back + j * width
                    row_deep_up = row_deep - width if j > 0 else back_plane + 7 * width + tiles[n, 1]
                    row_deep_down = row_deep + width if j < 7 else back_plane + tiles[n, 2]
                    for k in range(low[n, 2], high[n, 2]):
                        at = row + j * width + k
                        up = row_up + k
                        deep = row_deep + k
                        # -- support
                        in_d = np.int64(there[np.uint64(deep)] != 0)
                        in_u = np.int64(there[np.uint64(up)] != 0)
                        in_l = np.int64(there[np.uint64(at - 1)] != 0)
                        near = in_d + in_u + in_l
                        context = in_d | in_u << 1 | in_l << 2
                        context |= np.int64(there[np.uint64(row_deep_down + k)] != 0) << 3
                        context |= np.int64(there[np.uint64(deep + 1)] != 0) << 4
                        context |= np.int64(there[np.uint64(up + 1)] != 0) << 5
                        sizes_0 = sizes_1 = signs = zero
                        if near:
                            total = zero
                            if in_d:
                                ready(deep, there, cells, law)
                                c = np.uint64(deep * 8)
                                total += np.int64(cells[c + np.uint64(3)]) - np.int64(cells[c + np.uint64(5)])
                                e = np.int64(cells[c + np.uint64(4)])
                                sizes_0 += e & 15
                                sizes_1 += e >> 4 & 31
                                signs += e >> 9
                            if in_u:
                                ready(up, there, cells, law)
                                c = np.uint64(up * 8)
                                total += np.int64(cells[c + np.uint64(3)]) - np.int64(cells[c + np.uint64(6)])
                                e = np.int64(cells[c + np.uint64(4)])
                                sizes_0 += e & 15
                                sizes_1 += e >> 4 & 31
                                signs += 3 * (e >> 9)
                            if in_l:
                                ready(at - 1, there, cells, law)
                                c = np.uint64(at * 8 - 8)
                                total += np.int64(cells[c + np.uint64(3)]) - np.int64(cells[c + np.uint64(7)])
                                e = np.int64(cells[c + np.uint64(4)])
                                sizes_0 += e & 15
                                sizes_1 += e >> 4 & 31
                                signs += 9 * (e >> 9)
                            if near == 2:
                                total >>= 1
                            elif near == 3:
                                total = (total * 21845) >> 16
                            ahead = min(max(((total * 28) >> 16) + 3, zero), np.int64(31))
                        else:
                            ahead = np.int64(there[np.uint64(row_deep_up + k)] != 0)
                            ahead |= np.int64(there[np.uint64(deep - 1)] != 0) << 1
                            ahead |= np.int64(there[np.uint64(up - 1)] != 0) << 2
                        context |= ahead << 6
                        then = own = zero
                        if listed:
                            own = np.int64(was[np.uint64(at)])
                            about = np.int64(was[np.uint64(at + 1)]) + np.int64(was[np.uint64(at - 1)])
                            about += np.int64(was[np.uint64(up)]) + np.int64(was[np.uint64(deep)])
                            if own:
                                then = np.int64(4) + np.int64(about == 4) + np.int64(about >= 3)
                            else:
                                then = one + np.int64(about >= 1) + np.int64(about >= 3)
                        context = context << 3 | then
                        s = np.uint64(begin + j * 8 + k)
                        bit = zero
                        unsure = False
                        if forces is not None:
                            size = units(asked, s, scale, f)
                            tol = tolerance(size, rule)
                            bit = np.int64(size > 0)
                            if rule[MOVABLE] > 0 and size <= rule[F0] and size <= tol:
                                chance = np.int64(chances[np.uint64(_BIT + context)]) >> 16
                                if bit and chance < 45000:
                                    bit = zero
                                elif chance > 55000:
                                    unsure = True
                        if forces is None:
                            bit, span, x, place = plain(_BIT + context, bit, forces, span, x, place, data, chances)
                            if bit == 0:
                                continue
                        elif bit == 0 and not unsure:
                            if priced:
                                paid = price(span, place)
                            bit, span, x, place = plain(_BIT + context, bit, forces, span, x, place, data, chances)
                            if priced:
                                prices[0] += price(span, place) - paid
                            continue
                        # -- what is expected
                        u0, u1, u2, a, l0, l1, l2 = expect(
                            way, at, up, deep, row_deep_up + k, row_deep_down + k, in_d, in_u, in_l, there, cells,
                            own, old, s, last, law,
                        )  # fmt: skip
                        still = zero
                        if forces is not None:
                            still = np.int64(
                                good(scaled(u0, a), scaled(u1, a), scaled(u2, a), f, size, tol, rule, lattice)
                            )
                            if unsure:
                                bit = still
                            if priced:
                                paid = price(span, place)
                            bit, span, x, place = plain(_BIT + context, bit, forces, span, x, place, data, chances)
                            if priced:
                                prices[0] += price(span, place) - paid
                            if bit == 0:
                                continue
                        # -- the residual
                        any_set = one
                        u0, u1, u2, a, l0, l1, l2, e, span, x, place = code_residual(
                            forces, f, size, tol, rule, still, u0, u1, u2, a, l0, l1, l2, near, then, sizes_0,
                            sizes_1, signs, law, lattice, border, first, found, priced, span, x, place, data, chances,
                            prices,
                        )  # fmt: skip
                        c = np.uint64(at * 8)
                        cells[c], cells[c + np.uint64(1)], cells[c + np.uint64(2)] = u0, u1, u2
                        cells[c + np.uint64(3)], cells[c + np.uint64(4)] = a, e
                        cells[c + np.uint64(5)], cells[c + np.uint64(6)], cells[c + np.uint64(7)] = l0, l1, l2
                        there[np.uint64(at)] = HELD
                        last[0], last[1], last[2], last[3] = u0, u1, u2, a
                        made[s, 0], made[s, 1], made[s, 2] = scaled(u0, a), scaled(u1, a), scaled(u2, a)
                filled[c_column] = any_set
        for n in range(base, layers[layer + 1]):
            turned_back(made, n - base, where[n], stride, out)
    state[0], state[1], state[2] = x, span, place
    return DONE


def workspace(width: int, most: int, encoding: bool) -> tuple[NDArray[Any], ...]:
    """Room for `code_frame`, whose rows have `width` cells, its layers `most` bricks at most."""
    planes = np.zeros(3 * 8 * width, np.uint8), np.zeros(3 * 8 * width, np.uint8), np.empty(3 * 64 * width, np.int32)
    rows = [np.zeros(width, np.int64) for _ in range(4)]
    layer = np.empty((512 * most, 3), np.int32), np.empty((512 * most, 3), np.int32)
    asked = np.empty((512 * most if encoding else 1, 3), np.float32)
    return (*planes, *rows, np.zeros(4, np.int64), np.zeros(3, np.int64), np.zeros(3), *layer, asked)

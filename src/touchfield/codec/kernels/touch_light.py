"""One pass over a frame in the light models of coder `touch`: the same compiled function encodes and decodes.

Planes from deep to shallow; in a plane the 8x8 tiles of the listed bricks, row by row; in a tile a state, and in a
coded tile the samples row by row: a bit of support, then the residual to what is expected. See
`touch_light_predict` for the working storage and `touch_light_coder` for the bits.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from touchfield.codec.kernels import touch_light_coder as coder
from touchfield.codec.kernels.touch_light_cells import amplitude, clear, held, length_of, load, store
from touchfield.codec.kernels.touch_light_choice import F0, MOVABLE, kept, tolerance, units
from touchfield.codec.kernels.touch_light_coder import lean
from touchfield.codec.kernels.touch_light_predict import CLASSES, FEATURES, FITTED, MIX, USUAL, gather, predict
from touchfield.codec.kernels.touch_light_residual import MIXED, RESIDUALS, code_residual
from touchfield.codec.kernels.touch_light_tiles import CODED, EMPTY, choose_state, code_state, code_way, copy_tile

if TYPE_CHECKING:
    from numpy.typing import NDArray

__all__ = [
    "CHANCES",
    "CLASSES",
    "DECODE",
    "DONE",
    "ENCODE",
    "ENDED",
    "FEATURES",
    "FIT",
    "FITTED",
    "FULL",
    "MIX",
    "MIXES",
    "SUMS",
    "USUAL",
    "code_frame",
    "workspace",
]

DECODE, ENCODE, FIT = 0, 1, 2
DONE, ENDED, FULL = 0, 1, 2

_BIT = RESIDUALS
_BIT_WIDE = _BIT + (1 << 14)
_BIT_AHEAD = _BIT_WIDE + (1 << 15)
CHANCES = _BIT_AHEAD + (1 << 14)
MIXES = MIXED
SUMS = (CLASSES, FEATURES + 1, FEATURES + 1)

_ROOM = 1 << 14  # bytes that a tile cannot fill


@lean
def _bin(t):
    """An amplitude in classes of a 28th of the largest."""
    return min(max(((t * 28) >> 16) + 3, 0), 31)


@lean
def code_frame(
    task, sampled, forces, scale, rule, out, reference, reference_slot, where, tiles, low, high, layers,
    layer_at, stride, width, law, weights, ways, lattice, border, first, state, buffer, chances, mixes, sums, prices,
    cells, old, tile_state, tile_way, held_by, filled, expected, probes, axes, vector, found, last, f, spread,
    feature, centre,
):  # fmt: skip
    """Code, decode, or gather the sums of a frame.

    Parameters
    ----------
    task : int
        `DECODE`, `ENCODE` or `FIT`.
    sampled : int
        One voxel in so many is gathered, when fitting or encoding; 0 for none.
    forces : float32 [s, 3]
        The original by slots, newtons; not read when decoding.
    scale : float
        Units of a newton.
    rule : float64 [6]
    out : int32 [s, 3]
        Takes the decoded vectors by slots, units.
    reference : int32 [m, 3]
        Vectors of the reference by its slots.
    reference_slot : int64 [n]
        The first slot of each brick in it, or -1, turned as the scan is.
    where : int64 [n]
        The first slot of each brick in scan order, turned as the scan is.
    tiles : int64 [n, 3]
        Where the tile, that before and that after it across the rows, begin in a row of cells.
    low, high : int64 [n, 3]
        The samples within the grid.
    layers : int64 [l + 1]
        Bricks of each layer across the slowest axis.
    layer_at : int64 [l]
        Its brick coordinate.
    stride : int64 [3]
        Slots from sample to sample along the axes of the scan.
    width : int
        Cells in a row.
    law : int64 [12]
        What the amplitude loses in a step along each axis of the scan where the force points along it, units; which
        component that is; and what `touch_light_predict` names.
    weights : int64 [16 * 13]
    ways : int64 [n]
        How each brick is predicted, in scan order; when decoding zeros. 4 is added once it is coded.
    lattice, border, first : int64
    state, buffer, chances, mixes
        The arithmetic coder.
    sums : float64 [16, 14, 14]
        Takes normal equations: of the original when fitting, of what the decoder holds when encoding.
    prices : float64 [3]
        Bits of support, amplitude and direction of one tile in four, when encoding.

    cells, old, tile_state, tile_way, held_by, filled, expected, probes, axes, vector, found, last, f, spread,
    feature, centre
        Room to work in, from `workspace`.

    Returns
    -------
    status : int
        `FULL`: the buffer does not hold the code.
    """
    decoding = task == DECODE
    encoding = task == ENCODE
    plane = 8 * width
    taken = 0
    last[0] = last[1] = np.int64(0)
    last[2] = max(lattice[0], 1)
    ring = 0
    size = 0.0
    tol = 0.0
    paid = 0.0
    priced = False
    begin_of_last = 0
    end_of_last = 0
    for layer in range(layer_at.shape[0]):
        gap = layer > 0 and layer_at[layer] != layer_at[layer - 1] + 1
        for i in range(8):
            ring = (ring + 1) % 3
            here_plane = ring * plane
            back_plane = ((ring + 2) % 3) * plane
            far_plane = ((ring + 1) % 3) * plane
            # what the layer before left in the ring
            if i == 0:
                for n in range(layers[layer], layers[layer + 1]):
                    held_by[tiles[n, 0]] = layer + 1
            if i < 3:
                for n in range(begin_of_last, end_of_last):
                    at = tiles[n, 0]
                    if i == 0 and (gap or held_by[at] != layer + 1):
                        tile_state[at] = 0
                        filled[at] = 0
                    clear(cells, here_plane + at, width)
                    load(old, here_plane + at, width, reference, -1, 0, stride)
                    if i == 0 and gap:
                        for other in (back_plane, far_plane):
                            clear(cells, other + at, width)
                            load(old, other + at, width, reference, -1, 0, stride)
            if i < low[layers[layer], 0] or i >= high[layers[layer], 0]:
                for n in range(layers[layer], layers[layer + 1]):
                    clear(cells, here_plane + tiles[n, 0], width)
                    load(old, here_plane + tiles[n, 0], width, reference, -1, 0, stride)
                continue
            for n in range(layers[layer], layers[layer + 1]):
                clear(cells, here_plane + tiles[n, 0], width)
                slot = reference_slot[n]
                there = load(old, here_plane + tiles[n, 0], width, reference, slot, slot + i * stride[0], stride)
                filled[tiles[n, 0]] = (filled[tiles[n, 0]] & 1) | there << 1
            for n in range(layers[layer], layers[layer + 1]):
                column = tiles[n, 0]
                row = here_plane + column
                back = back_plane + column
                begin = where[n] + i * stride[0]
                if decoding:
                    if state[coder.PLACE] > buffer.shape[0] + 14:
                        return ENDED
                elif encoding and state[coder.PLACE] + _ROOM > buffer.shape[0]:
                    return FULL
                # -- the tile's state
                is_deep = np.int64(filled[column] & 1)
                is_old = np.int64(filled[column] >> 1)
                mode = np.int64(CODED)
                if encoding:
                    priced = column & 24 == 8
                    mode = choose_state(
                        is_deep, is_old, cells, old, forces, scale, row, back, width, begin, stride, low[n], high[n],
                        rule, f,
                    )  # fmt: skip
                if task != FIT:
                    if priced:
                        paid = coder.price(state)
                    context = tile_state[column] | tile_state[column - 8] << 2 | tile_state[tiles[n, 1]] << 4
                    context = context * 3 + is_old + np.int64(reference_slot[n] >= 0)
                    mode = code_state(mode, context, is_deep, is_old, decoding, state, buffer, chances)
                    if priced:
                        prices[0] += coder.price(state) - paid
                tile_state[column] = mode
                if mode != CODED:
                    filled[column] = np.int64(mode != EMPTY)
                    if mode != EMPTY:
                        copy_tile(mode, cells, old, row, back, width, begin, stride, low[n], high[n], law, out)
                    continue
                way = np.int64(-1)
                if task != FIT and law[USUAL] > 0:
                    way = ways[n]
                    if way < 4:
                        about = tile_way[column] * 5 + tile_way[column - 8]
                        way = 4 | code_way(way, about, decoding, state, buffer, chances)
                        ways[n] = way
                        tile_way[column] = way - 3
                    way &= 3
                # -- its samples
                any_set = np.int64(0)
                for j in range(low[n, 1], high[n, 1]):
                    row_up = row + (j - 1) * width if j > 0 else here_plane + 7 * width + tiles[n, 1]
                    row_up_2 = row + (j - 2) * width if j > 1 else here_plane + (6 + j) * width + tiles[n, 1]
                    row_deep_up = back + (j - 1) * width if j > 0 else back_plane + 7 * width + tiles[n, 1]
                    row_deep_down = back + (j + 1) * width if j < 7 else back_plane + tiles[n, 2]
                    for k in range(low[n, 2], high[n, 2]):
                        at = row + j * width + k
                        up = row_up + k
                        deep = back + j * width + k
                        deep_up = row_deep_up + k
                        deep_down = row_deep_down + k
                        deeper = far_plane + column + j * width + k
                        slot = begin + j * stride[1] + k * stride[2]
                        # support
                        a_d, a_u, a_l = amplitude(cells, deep), amplitude(cells, up), amplitude(cells, at - 1)
                        in_d, in_u, in_l = np.int64(a_d > 0), np.int64(a_u > 0), np.int64(a_l > 0)
                        near = in_d + in_u + in_l
                        mask = in_d | in_u << 1 | in_l << 2 | held(cells, deep_down) << 3
                        mask |= held(cells, deep + 1) << 4 | held(cells, up + 1) << 5
                        wide = held(cells, deep_up) | held(cells, deep - 1) << 1 | held(cells, up - 1) << 2
                        t_d = t_u = t_l = np.int64(0)
                        if near:
                            if in_d:
                                t_d = np.int64(cells[np.uint64(deep * 8 + 5)])
                            if in_u:
                                t_u = np.int64(cells[np.uint64(up * 8 + 6)])
                            if in_l:
                                t_l = np.int64(cells[np.uint64(at * 8 - 1)])
                            ahead = t_d + t_u + t_l
                            if near == 2:
                                ahead >>= 1
                            elif near == 3:
                                ahead = (ahead * 21845) >> 16
                            ahead = _bin(ahead)
                        else:
                            ahead = wide | held(cells, deeper) << 3
                        then = np.int64(0)
                        if reference_slot[n] >= 0:
                            own = old[np.uint64(at * 4 + 3)] > 0
                            about = np.int64(old[np.uint64(at * 4 + 7)] > 0) + np.int64(
                                old[np.uint64(at * 4 - 1)] > 0
                            )
                            about += np.int64(old[np.uint64(up * 4 + 3)] > 0) + np.int64(
                                old[np.uint64(deep * 4 + 3)] > 0
                            )
                            if own:
                                then = np.int64(4) + np.int64(about == 4) + np.int64(about >= 3)
                            else:
                                then = np.int64(1) + np.int64(about >= 1) + np.int64(about >= 3)
                        context = (ahead << 6 | mask) << 3 | then
                        done = False
                        bit = np.int64(0)
                        if not decoding:
                            size = units(forces, slot, scale, f)
                            tol = tolerance(size, rule)
                            bit = np.int64(size > 0)
                            if task == FIT:
                                bit = np.int64(size > 0 and (rule[MOVABLE] == 0 or size > rule[F0]) and size >= 1)
                            elif rule[MOVABLE] > 0 and size <= rule[F0] and size <= tol:
                                chance = np.int64(chances[np.uint64(_BIT + context)]) >> 16
                                if bit and chance < 45000:
                                    bit = np.int64(0)
                                elif chance > 55000:
                                    predict(
                                        cells, old, at, up, deep, deep_up, deep_down, deeper, last, weights, way, law,
                                        expected,
                                    )  # fmt: skip
                                    done = True
                                    d0, d1, d2 = (
                                        np.float64(expected[0]),
                                        np.float64(expected[1]),
                                        np.float64(expected[2]),
                                    )
                                    bit = np.int64(kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule))
                        if priced:
                            paid = coder.price(state)
                        if task != FIT:
                            second = (
                                (
                                    wide
                                    | held(cells, deeper) << 3
                                    | held(cells, row_up_2 + k) << 4
                                    | held(cells, at - 2) << 5
                                )
                                << 6
                                | mask
                            ) << 3 | then
                            third = (_bin(t_d) * in_d << 4 | (_bin(t_u) * in_u >> 1)) << 4 | (_bin(t_l) * in_l >> 1)
                            third = third << 1 | np.int64(then >= 4)
                            bit = coder.mixed(
                                _BIT + context, _BIT_WIDE + second, _BIT_AHEAD + third, near << 3 | then, bit,
                                decoding, state, buffer, chances, mixes,
                            )  # fmt: skip
                            if priced:
                                prices[0] += coder.price(state) - paid
                        if bit == 0:
                            continue
                        any_set = np.int64(1)
                        if sampled > 0:
                            taken += 1
                            if taken % sampled == 0:
                                step = max(np.float64(lattice[0]), size * lattice[1] / 65536.0)
                                gather(
                                    cells, old, at, up, deep, deep_up, deep_down, deeper, last, probes, f, step, sums,
                                    expected, feature, law,
                                )  # fmt: skip
                                done = False
                        if not done:
                            predict(
                                cells, old, at, up, deep, deep_up, deep_down, deeper, last, weights, way, law,
                                expected,
                            )  # fmt: skip
                        if task == FIT:
                            # as the coder would: what may stand still does
                            d0, d1, d2 = np.float64(expected[0]), np.float64(expected[1]), np.float64(expected[2])
                            still = kept(d0, d1, d2, f[0], f[1], f[2], size, tol, rule)
                            for c in range(3):
                                vector[c] = expected[c] if still else np.int64(round(f[c]))
                                last[c] = vector[c]
                            a = max(np.int64(1), length_of(vector[0], vector[1], vector[2]))
                            store(cells, at, vector[0], vector[1], vector[2], a, 0, law)
                            continue
                        a, sizes = code_residual(
                            then, near, at, up, deep, cells, expected, f, size, tol, rule, lattice, border,
                            first, axes, found, spread, vector, centre, decoding, priced, state, buffer, chances,
                            mixes, prices,
                        )  # fmt: skip
                        store(cells, at, vector[0], vector[1], vector[2], a, sizes, law)
                        s = np.uint64(slot)
                        for c in range(3):
                            last[c] = vector[c]
                            out[s, c] = vector[c]
                filled[column] = any_set
        begin_of_last, end_of_last = layers[layer], layers[layer + 1]
    return DONE


def workspace(width: int) -> tuple[NDArray[Any], ...]:
    """Room for `code_frame`, whose rows have `width` cells: it takes no memory itself, nor counts references."""
    probes = np.zeros((FEATURES, CLASSES * FEATURES), np.int64)
    for n in range(FEATURES):
        probes[n, n::FEATURES] = 64
    whole = [np.zeros(shape, np.int64) for shape in (width, width, width, width, 16)]
    more = [np.zeros(shape, np.int64) for shape in ((3, 3), 3, 3, 3)]
    cells = np.zeros(3 * 8 * width * 8, np.int32), np.zeros(3 * 8 * width * 4, np.int32)
    return (*cells, *whole, probes, *more, np.zeros(3), np.zeros(2), np.zeros((FEATURES, 3)), np.zeros(3, np.int64))

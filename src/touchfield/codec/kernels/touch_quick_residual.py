"""The residual of a sample in the quick model of coder `touch`: still, or steps about what was expected."""

from __future__ import annotations

import numpy as np

from touchfield.codec.kernels.touch_lattice import step_at
from touchfield.codec.kernels.touch_quick_cells import across_axes, direction_of, losses, moved, scaled
from touchfield.codec.kernels.touch_quick_choice import choose
from touchfield.codec.kernels.touch_quick_coder import magnitude, plain, price, quick
from touchfield.codec.kernels.touch_quick_tiles import TILES

__all__ = ["RESIDUALS", "code_residual"]

_STILL = TILES
_ACROSS = _STILL + 256
_ZERO = _ACROSS + 64
_SIGN = _ZERO + 3 * 64
_SIZE = _SIGN + 32
RESIDUALS = _SIZE + 2 * 8 * 16
"""Contexts up to here are the tiles' and the residual's."""

_WIDEST = 1 << 20  # units; a step across that is longer leads nowhere

_CLASS = np.array(
    [0, 1, 2, 2, 3, 3, 3, 4, 4, 4, 4, 5, 5, 5, 5, 5, 6, 6, 6, 6, 6, 6, 6, 6] + [7] * 8, np.int64
)  # of a mean size of residuals, in quarters
_MEANS = np.array([0, 65536, 32768, 21846], np.int64)  # 65536 over so many


@quick
def code_residual(
    forces, f, size, tol, rule, still, u0, u1, u2, a, l0, l1, l2, near, then, sizes_0, sizes_1, signs, law, lattice,
    border, first, found, priced, span, x, place, data, chances, prices,
):  # fmt: skip
    """Code the residual to an expected direction, amplitude and losses.

    `near`, `then`, `sizes_0`, `sizes_1` and `signs` are contexts of the neighbours and of the reference; `f`, `size`,
    `tol` and `still` what only the encoder knows. Returns direction, amplitude, losses and sizes of the sample, and
    the state of the coder.
    """
    zero, one = np.int64(0), np.int64(1)
    loud = min(a >> 14, np.int64(3))
    mean_0 = (sizes_0 * _MEANS[np.uint64(near)]) >> 14
    mean_1 = (sizes_1 * _MEANS[np.uint64(near)]) >> 15
    class_0 = _CLASS[np.uint64(min(mean_0, np.int64(31)))] if near else np.int64(7)
    class_1 = _CLASS[np.uint64(min(mean_1, np.int64(31)))] if near else np.int64(7)
    quiet = _CLASS[np.uint64(min((mean_0 + 2 * mean_1) * 3 >> 2, np.int64(31)))]
    context = ((quiet << 2 | near) << 2 | loud) << 1 | np.int64(then >= 4)
    paid = 0.0
    if forces is not None and priced:
        paid = price(span, place)
    still, span, x, place = plain(_STILL + context, still, forces, span, x, place, data, chances)
    e = zero
    if still:
        if forces is not None and priced:
            prices[1] += price(span, place) - paid
    else:
        if forces is not None:
            chosen = choose(f, size, tol, rule, u0, u1, u2, a, border, first, lattice, found)
            prices[3] += np.float64(not chosen)
        r0, r1, r2 = found[0], found[1], found[2]
        aslant, span, x, place = plain(
            _ACROSS + (class_0 << 3 | class_1), np.int64(r1 != 0 or r2 != 0), forces, span, x,
            place, data, chances,
        )  # fmt: skip
        steps = one
        if aslant:
            steps, span, x, place = plain(
                _ZERO + (class_0 << 2 | loud), np.int64(r0 != 0), forces, span, x, place, data,
                chances,
            )  # fmt: skip
        if steps:
            sign, span, x, place = plain(_SIGN + signs, np.int64(r0 < 0), forces, span, x, place, data, chances)
            r0, span, x, place = magnitude(abs(r0), _SIZE + (class_0 << 4), forces, span, x, place, data, chances)
            e = min(r0, np.int64(15)) | (one + sign) << 9
            if sign:
                r0 = -r0
        else:
            r0 = zero
        if forces is not None and priced:
            prices[1] += price(span, place) - paid
            paid = price(span, place)
        a = moved(a, r0, border, first)
        if aslant:
            step = step_at(abs(a), lattice[2], lattice[3])
            h0, h1, h2, k0, k1, k2 = across_axes(u0, u1, u2)
            w0, w1, w2 = a * u0, a * u1, a * u2
            some = zero
            for q in range(2):
                r = r1 if q == 0 else r2
                before = min(abs(r0), np.int64(3)) if q == 0 else min(some, np.int64(3))
                steps = one
                if q == 0 or some > 0:
                    steps, span, x, place = plain(
                        _ZERO + 64 + 64 * q + (class_1 << 2 | before), np.int64(r != 0), forces,
                        span, x, place, data, chances,
                    )  # fmt: skip
                if steps == 0:
                    continue
                sign, span, x, place = plain(_SIGN + 27 + q, np.int64(r < 0), forces, span, x, place, data, chances)
                r, span, x, place = magnitude(
                    abs(r), _SIZE + 128 + (class_1 << 4), forces, span, x, place, data, chances
                )
                some += r
                if sign:
                    r = -r
                r = min(max(r * step, -_WIDEST), _WIDEST)
                if q == 0:
                    w0 += r * h0
                    w1 += r * h1
                    w2 += r * h2
                else:
                    w0 += r * k0
                    w1 += r * k1
                    w2 += r * k2
            e |= min(some, np.int64(31)) << 4
            w0, w1, w2 = scaled(w0, one), scaled(w1, one), scaled(w2, one)
            if w0 == 0 and w1 == 0 and w2 == 0:
                w2 = one
            u0, u1, u2, a = direction_of(w0, w1, w2)
            l0, l1, l2 = losses(u0, u1, u2, law)
            if forces is not None and priced:
                prices[2] += price(span, place) - paid
        elif a <= 0:
            u0, u1, u2, a = -u0, -u1, -u2, max(-a, one)
            l0, l1, l2 = losses(u0, u1, u2, law)
    return u0, u1, u2, a, l0, l1, l2, e, span, x, place

"""Encoding of a frame: the pass of `decode_pass`, with the choices that the decoder only hears of (floats)."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from touchfield.codec.kernels import PLACE, mix, mixed_chance, price
from touchfield.codec.touch.kernels import decode_pass as shared
from touchfield.codec.touch.kernels import voxel
from touchfield.codec.touch.kernels import workspace as ws
from touchfield.lean import entry, inlined, lean

_ROOM = 1 << 14  # bytes that a brick cannot fill
_AROUND = np.array([0, -1, 1], np.int64)
_ROUNDING = 2e-7  # of a force, lost where whole units become newtons of 32 bits
_LARGER = 0.43  # bits, about, of a component by each step that it is larger


class Limits(NamedTuple):
    """Bounds of the error, in units; see `touchfield.codec.touch.frame_encoder`."""

    k: float
    f0: float
    sine: float  # of the direction JND; 0 where only the mask rules
    exact: bool  # the support is kept


@lean
def _size_of(f):
    return np.sqrt(f[0] * f[0] + f[1] * f[1] + f[2] * f[2])


@lean
def tolerance(f, size, rule):
    """The mask at a force of `size` units, less what the last rounding may cost; below 0: hopeless.

    `f` is a force, float64 [3], or [4] with what forces around hide of its error.
    """
    hidden = f[3] if f.shape[0] == 4 else 0.0
    return max(rule.f0, rule.k * size + hidden) * (1 - 1e-6) - _ROUNDING * size


@lean
def kept(d0, d1, d2, f, size, rule):
    """True where a decoded vector, whole units, may stand for the force `f` of `size`."""
    tol = tolerance(f, size, rule)
    if tol < 0:
        return False
    e0, e1, e2 = d0 - f[0], d1 - f[1], d2 - f[2]
    if rule.sine > 0:
        if size * rule.sine > rule.f0:
            square = np.float64(d0 * d0 + d1 * d1 + d2 * d2)
            along = d0 * f[0] + d1 * f[1] + d2 * f[2]
            if along <= 0 or abs(np.sqrt(square) - size) > tol:
                return False
            across = square * size * size - along * along
            most = rule.sine * (1 - 1e-6) - 1e-6
            return across <= most * most * square * size * size
        tol = min(tol, rule.f0 * (1 - 1e-6) - _ROUNDING * size)
    return e0 * e0 + e1 * e1 + e2 * e2 <= tol * tol


@inlined
def fits(d0, d1, d2, f, rule):
    """True where the vector of the reference may stand for a force; (0, 0, 0) is none."""
    size = _size_of(f)
    there = d0 != 0 or d1 != 0 or d2 != 0
    if rule.exact and there != (size > 0):
        return False
    return kept(d0, d1, d2, f, size, rule)


@lean
def _guessed(r):
    """Likely bits of a component; only to compare candidates."""
    return 0.0 if r == 0 else 1.5 + abs(r) * _LARGER


@lean
def choose(law, work, f, size, rule):
    """Put the residual of the force `f`, units float64 [3], into the row `STEPS`; the centre is set.

    Of the points around the force the one that likely costs least; the nearest where none keeps the rule.
    """
    rows, level = work.rows, work.of[voxel.LEVEL]
    along = (f[0] * rows[ws.AXES + 0, 0] + f[1] * rows[ws.AXES + 0, 1] + f[2] * rows[ws.AXES + 0, 2]) / 16384.0
    across_1 = (f[0] * rows[ws.AXES + 1, 0] + f[1] * rows[ws.AXES + 1, 1] + f[2] * rows[ws.AXES + 1, 2]) / 16384.0
    across_2 = (f[0] * rows[ws.AXES + 2, 0] + f[1] * rows[ws.AXES + 2, 1] + f[2] * rows[ws.AXES + 2, 2]) / 16384.0
    reached = ws.level_of(min(np.int64(round(abs(along))), np.int64((1 << 18) - 1)), law.border, law.first)
    n0 = np.int64(round(((reached if along >= 0 else -reached) - level) / 256.0))
    reach = 4 if f.shape[0] == 4 else 3  # a wide mask often holds a point without a residual
    best = nearest = np.inf
    b0 = b1 = b2 = np.int64(0)
    for i in range(reach):
        r0 = n0 + _AROUND[i] if i < 3 else np.int64(0)
        length = ws.amplitude_of(level + 256 * r0, law.border)
        step = ws.step_at(abs(length), law.cross_floor, law.cross_rate)
        n1, n2 = np.int64(round(across_1 / step)), np.int64(round(across_2 / step))
        for j in range(reach * reach):
            j1, j2 = j // reach, j % reach
            r1 = n1 + _AROUND[j1] if j1 < 3 else np.int64(0)
            r2 = n2 + _AROUND[j2] if j2 < 3 else np.int64(0)
            cost = _guessed(r0) + _guessed(r1) + _guessed(r2)
            if cost >= best:
                continue
            if max(abs(r0), abs(r1), abs(r2)) < 1 << 18 and _allowed(law, work, r0, r1, r2, f, size, rule):
                best = cost
                b0, b1, b2 = r0, r1, r2
            elif best == np.inf:
                error = (along - length) ** 2 + (across_1 - r1 * step) ** 2 + (across_2 - r2 * step) ** 2
                if error < nearest:
                    nearest = error
                    b0, b1, b2 = r0, r1, r2
    rows[ws.STEPS, 0], rows[ws.STEPS, 1], rows[ws.STEPS, 2] = b0, b1, b2


@inlined
def _allowed(law, work, r0, r1, r2, f, size, rule):
    """True where a residual may be told, and makes a force that keeps the rule."""
    if r0 == 0 and r1 == 0 and r2 == 0 and not work.of[voxel.BASED]:
        return False
    voxel.place(law, work, r0, r1, r2)
    d0, d1, d2 = work.rows[ws.VECTOR, 0], work.rows[ws.VECTOR, 1], work.rows[ws.VECTOR, 2]
    if rule.exact and d0 == 0 and d1 == 0 and d2 == 0:
        return False
    return kept(d0, d1, d2, f, size, rule)


@entry
def encode_bricks(bits, scan, law, work, forces, rule, prices):
    """Code forces, units float64 [n, 512, 3] in scan order; False where the buffer is too short.

    With spatial masking they are [n, 512, 4], see `tolerance`. ``scan.cells`` takes what the decoder will hold, and
    `prices`, float64 [3], the bits of support, amplitude and direction.
    """
    last = np.int64(0)
    for n in range(scan.near.shape[0]):
        if bits.state[PLACE] + _ROOM > bits.buffer.shape[0]:
            return False
        known, state = shared.enter(scan, work, n), np.int64(0)
        if known:
            last = state = shared.code_brick(bits, last, _state_of(work.old, forces[n], rule))
        if state == 2:
            ws.copy_reference(work.window, work.old, law.slope)
            ws.keep(work.window, scan.cells, n)
            continue
        paid = price(bits)
        blocks = shared.code_blocks(bits, work, known, _blocks_of(forces[n], rule))
        prices[0] += price(bits) - paid
        for x in range(scan.low[n, 0], scan.high[n, 0]):
            for y in range(scan.low[n, 1], scan.high[n, 1]):
                for z in range(scan.low[n, 2], scan.high[n, 2]):
                    if blocks >> ((x >> 2) * 4 + (y >> 2) * 2 + (z >> 2)) & 1:
                        here = ((x + ws.LOW) * ws.SIDE + y + ws.LOW) * ws.SIDE + z + ws.LOW
                        f = forces[n, (x * 8 + y) * 8 + z]
                        _encode_voxel(bits, law, work, here, known, state, f, rule, prices)
        ws.keep(work.window, scan.cells, n)
    return True


@inlined
def _state_of(old, forces, rule):
    """The brick as the reference has it, if that keeps the rule everywhere; else the reference is followed."""
    for at in range(512):
        c = ((((at >> 6) + ws.LOW) * ws.SIDE + (at >> 3 & 7) + ws.LOW) * ws.SIDE + (at & 7) + ws.LOW) * 4
        f = forces[at]
        if old[c + 3] == 0 and f[0] == 0 and f[1] == 0 and f[2] == 0:
            continue
        d0, d1, d2 = np.int64(0), np.int64(0), np.int64(0)
        if old[c + 3] > 0:
            d0, d1, d2 = np.int64(old[c]), np.int64(old[c + 1]), np.int64(old[c + 2])
        if not fits(d0, d1, d2, f, rule):
            return np.int64(1)
    return np.int64(2)


@inlined
def _blocks_of(forces, rule):
    """Sub-blocks that hold a force that is to be kept."""
    blocks = np.int64(0)
    for at in range(512):
        f0, f1, f2 = forces[at, 0], forces[at, 1], forces[at, 2]
        square = f0 * f0 + f1 * f1 + f2 * f2
        if square > 0 and (rule.exact or square > rule.f0 * rule.f0):
            blocks |= np.int64(1) << ((at >> 8) * 4 + (at >> 5 & 1) * 2 + (at >> 2 & 1))
    return blocks


@inlined
def _held(bits, law, work, here, near, trusted, f, size, chosen, rule):
    """Support of a voxel; a force may be left away, or made, and is where its bit would cost too much."""
    if rule.exact or size > rule.f0 or size > tolerance(f, size, rule):
        return np.int64(size > 0)
    chance = mixed_chance(bits, 3, chosen)
    if chance <= 55000:
        return np.int64(size > 0 and chance >= 45000)
    voxel.expect(law, work, here, near, trusted)
    expected = work.rows[ws.EXPECTED]
    return np.int64(kept(expected[0], expected[1], expected[2], f, size, rule))


@inlined
def _encode_voxel(bits, law, work, here, known, state, f, rule, prices):
    near = shared.near_of(work.window, here)
    then = shared.then_of(work.old, here, known)
    size = _size_of(f)
    begun = price(bits)
    chosen = shared.look_at_support(bits, work, here, near, then)
    bit = mix(bits, 3, chosen, _held(bits, law, work, here, near, state == 1, f, size, chosen, rule))
    told = price(bits)
    prices[0] += told - begun
    if not bit:
        return
    voxel.expect(law, work, here, near, state == 1)
    voxel.look(law, work, here, near)
    expected = work.rows[ws.EXPECTED]
    still = np.int64(kept(expected[0], expected[1], expected[2], f, size, rule))
    voxel.code_still(bits, work, here, then, still)
    prices[1] += price(bits) - told
    told = price(bits)
    if not still:
        voxel.aim(law, work, here)
        choose(law, work, f, size, rule)
        for c in range(3):
            voxel.code_step(bits, work, c)
            if c == 0:
                prices[1] += price(bits) - told
                told = price(bits)
    prices[2] += price(bits) - told
    shared.settle(law, work, here, still)


@inlined
def _ratio2(x, y, z, u, v, w, limits, hidden):
    """The square of |error| / allowed, of an original (x, y, z) and a decoded (u, v, w)."""
    k, f0, sine, angle = limits
    size2 = x * x + y * y + z * z
    error2 = (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2
    if error2 == 0.0:
        return 0.0
    allowed2 = max(f0 * f0, k * k * size2)
    if hidden > 0.0:
        allowed2 = max(allowed2, (k * math.sqrt(size2) + hidden) ** 2)
    if sine > 0.0:
        size = math.sqrt(size2)
        if size * sine > f0:
            radial = abs(math.sqrt(u * u + v * v + w * w) - size) / math.sqrt(allowed2)
            a, b, c = y * w - z * v, z * u - x * w, x * v - y * u
            turn = math.atan2(math.sqrt(a * a + b * b + c * c), x * u + y * v + z * w) / angle
            return max(radial, turn) ** 2
        allowed2 = f0 * f0
    return error2 / allowed2 if allowed2 > 0.0 else np.inf


@entry
def compare(mine, forces, theirs, other, limits, exact, hidden, beyond):
    """An original beside what a decoder makes of it, voxel by voxel of both supports, in float64.

    `mine` and `theirs` are the places of the same bricks in both, int64 [n], -1 where one has none, so that all is
    zero; `limits` k, F_0, sine and angle of the direction JND, 0 where only the mask rules; `hidden` what forces
    around hide, newtons, float32 [bricks of the original, 512], or [0, 512]. `beyond`, bool [n, 512], False before,
    takes the voxels that break the rule. Returns the square of the largest share of what is allowed, where in
    `beyond` that is, and how many voxels there are with a force, such within the rule, and decoded ones with a force.
    """
    worst, where, supported, within, decoded = 0.0, -1, 0, 0, 0
    for n in range(mine.shape[0]):
        i, j = mine[n], theirs[n]
        for place in range(512):
            x, y, z, u, v, w = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            if i >= 0:
                x, y, z = 1.0 * forces[i, place, 0], 1.0 * forces[i, place, 1], 1.0 * forces[i, place, 2]
            if j >= 0:
                u, v, w = 1.0 * other[j, place, 0], 1.0 * other[j, place, 1], 1.0 * other[j, place, 2]
            held = x != 0.0 or y != 0.0 or z != 0.0
            sent = u != 0.0 or v != 0.0 or w != 0.0
            if not held and not sent:
                continue
            around = 1.0 * hidden[i, place] if i >= 0 and hidden.shape[0] else 0.0
            ratio2 = _ratio2(x, y, z, u, v, w, limits, around)
            if exact and held != sent:
                ratio2 = np.inf
            supported += held
            decoded += sent
            within += held and ratio2 <= 1.0
            beyond[n, place] = ratio2 > 1.0
            if ratio2 > worst:
                worst, where = ratio2, n << 9 | place
    return worst, where, supported, within, decoded


@entry
def largest(forces):
    """The longest |F| of float32 [n, 3]; infinite where one is not a finite number."""
    most = 0.0
    for i in range(forces.shape[0]):
        x, y, z = np.float64(forces[i, 0]), np.float64(forces[i, 1]), np.float64(forces[i, 2])
        size2 = x * x + y * y + z * z
        if not size2 < np.inf:
            return np.inf
        most = max(most, size2)
    return math.sqrt(most)

"""Compiled: what a surface is made of, where the hand is: its friction, and the vibration of a hand that slides.

A **texture** is a chord: four sines in each third of an octave, spread evenly, whose power is that of the table at
the speed of the hand along the surface and at the force that it presses with. Between the table's speeds and forces
amplitudes are linear, below the first they go to zero with the speed and the force, beyond the last they stay. So a
hand at rest feels none, a contact begins without a jump, and nothing is drawn by lot.

A band that the loop cannot show is not rendered; where all of them together would change the force faster than the
slew limit allows they are weaker, all by the same factor, so that the spectrum keeps its shape.

**Stick-slip** is a sawtooth of mu over the way along the surface, from kinetic to static friction. Where it would go
faster than the loop can show, its mean is left. It is friction, and takes energy out whatever mu does.
"""

from __future__ import annotations

import math

from numba import njit

from touchfield.render.block import words as W
from touchfield.render.kernels.frames import arm, ends, is_far, part_count, part_force
from touchfield.render.kernels.vectors import along, dot, length, three

_BAND_SINES = 4
_BANDS = W.MATERIAL_SINES // _BAND_SINES
_TO_EDGE = 10 ** (0.05 / _BAND_SINES)  # of a band, from its highest sine
_UNKNOWN = -2


@njit(cache=True, nogil=True)
def material_at(i8, u8, f8, f4, frame_a, frame_b, blend, p):
    """The word of the first material that a point is within; 0 for none. `FRICTION_NOW` becomes that of it."""
    if f8[W.WALL] > 0.0 and f8[W.IS_COUPLED] != 0.0 and f8[W.IS_HELD] != 0.0:
        p = three(f8, W.PROXY)  # behind a thin wall there may be none
    part, row = _UNKNOWN, i8[W.MATERIAL] + W.MATERIAL_ROWS
    for _ in range(i8[W.MATERIAL_COUNT]):
        box, own = row + W.MATERIAL_BOX, i8[row + W.MATERIAL_OBJECT]
        inside = f8[box] <= p[0] <= f8[box + 3] and f8[box + 1] <= p[1] <= f8[box + 4]
        inside = inside and f8[box + 2] <= p[2] <= f8[box + 5]
        if inside and own >= 0:
            if part == _UNKNOWN:
                part = _strongest(i8, u8, f8, f4, frame_a, frame_b, blend, p)
            inside = part == own
        if inside:
            f8[W.FRICTION_NOW] = _friction(f8, row)
            return row
        row += W.MATERIAL_WORDS
    f8[W.FRICTION_NOW] = f8[W.FRICTION]
    return 0


@njit(cache=True, nogil=True)
def _strongest(i8, u8, f8, f4, frame_a, frame_b, blend, p):
    """The part of the frame that pushes most at a point; -1 for none."""
    a, b, blend = ends(frame_a, frame_b, blend)
    parts = part_count(i8, a, b)
    a, b = a + W.FRAME_WORDS, b + W.FRAME_WORDS
    best, most = -1, 0.0
    for part in range(parts):
        d = arm(f8, a, b, blend, p)
        if not is_far(i8, f8, a, b, d):
            size = length(part_force(i8, u8, f8, f4, a, b, blend, d))
            if size > most:
                best, most = part, size
        a, b = a + W.PART_WORDS, b + W.PART_WORDS
    return best


@njit(cache=True, nogil=True)
def _friction(f8, row):
    """mu of a material, where the hand is on its way between two slips."""
    mu, static, slip = f8[row + W.MATERIAL_FRICTION], f8[row + W.MATERIAL_STATIC], f8[row + W.MATERIAL_SLIP]
    if math.isnan(mu):
        return f8[W.FRICTION]
    if not static > mu:
        return mu
    rate = f8[W.RATE_HZ]
    shown = min(max((rate / 4 - length(three(f8, W.VELOCITY)) / slip) / (rate / 8), 0.0), 1.0)
    return mu + (static - mu) * (0.5 + shown * (min(f8[W.SLID] / slip, 1.0) - 0.5))


@njit(cache=True, nogil=True)
def _between(f8, at, count, x):
    """The two places of a rising row that x lies between, and its share of the way; -1 is zero, before the first."""
    low, before = -1, 0.0
    for n in range(count):
        value = f8[at + n]
        if x < value:
            return low, n, (x - before) / (value - before)
        low, before = n, value
    return count - 1, count - 1, 0.0


@njit(cache=True, nogil=True)
def _level(f8, at, i, forces, press):
    """Newtons rms of a band at speed i of the table, and at a force as of `_between`."""
    if i < 0:
        return 0.0
    low, high, share = press
    first = f8[at + (i * forces + low) * _BANDS] if low >= 0 else 0.0
    return first + share * (f8[at + (i * forces + high) * _BANDS] - first)


@njit(cache=True, nogil=True)
def texture(i8, f8, row, force, velocity, dt):
    """The vibration of a material at word `row`, newtons, for a force of the field and a velocity of the hand."""
    size = length(force)
    if not size > 0.0:
        return 0.0
    normal = dot(velocity, force) / size
    slid = length(along(velocity, -normal / size, force))
    way, slip = f8[W.SLID] + slid * dt, f8[row + W.MATERIAL_SLIP]
    f8[W.SLID] = way - slip * math.floor(way / slip)
    forces = i8[row + W.MATERIAL_FORCES]
    if forces == 0:
        return 0.0
    speed = _between(f8, i8[row + W.MATERIAL_SPEEDS + 1], i8[row + W.MATERIAL_SPEEDS], slid)
    press = _between(f8, i8[row + W.MATERIAL_FORCES + 1], forces, size)
    sines, phases, levels = i8[W.MATERIAL], i8[W.MATERIAL] + W.MATERIAL_SINES, i8[row + W.MATERIAL_LEVELS]
    total, change, fastest = 0.0, 0.0, math.pi * f8[W.RATE_HZ] / _TO_EDGE
    for band in range(_BANDS):
        slow = _level(f8, levels + band, speed[0], forces, press)
        level = slow + speed[2] * (_level(f8, levels + band, speed[1], forces, press) - slow)
        level *= math.sqrt(2.0 / _BAND_SINES)
        first, stop = _BAND_SINES * band, _BAND_SINES * (band + 1)
        if not (level > 0.0 and f8[sines + stop - 1] < fastest):
            continue
        for n in range(first, stop):
            w = f8[sines + n]
            turns = (f8[phases + n] + w * dt) / (2 * math.pi)
            f8[phases + n] = 2 * math.pi * (turns - math.floor(turns))
            total += level * math.sin(f8[phases + n])
            change += 0.5 * (level * w) ** 2
    wanted = W.MATERIAL_CREST * math.sqrt(change) * f8[W.FORCE_SCALE]
    return total * min(1.0, f8[W.SLEW] / wanted) if wanted > 0.0 else 0.0

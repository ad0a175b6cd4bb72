"""Compiled: effects that the renderer adds to a field's force (paper 3.2), such as a virtual coupling,
damping, vibration and surface materials; the check of energy (passivity); and the limits of the force.

**Virtual coupling.** A field that is stiffer than the loop can hold is felt through a spring K: a *proxy* is
where F(q) + K (h - q) = 0, and the hand at h gets K (q - h). It goes there by one implicit step in each tick,
with the field's gradient J:: (c - J) dq = F(q) + K (h - q), c = K + max(0, greatest eigenvalue of (J + J') /
2). In a linear field it is there after one step. Where J changes within a step it could leap to and fro for
ever: when the field (not a hand that turned) pulls it back, the stiffness that it met on its way is added to
c, and fades within some ticks.

**Passivity.** The observer adds up what the hand did: a force F that acted while it went dx gave it F dx. If
the next step would give more than was taken before, a damper takes out what is lacking, F - a v (Hannaford
and Ryu 2002), no more than cancels what drives the hand and a hand of 50 g bears in a loop of this rate (m /
2T); the rest later.

**Limits.** Heat, peak and slew are what every force passes last, and a torque with numbers of its own. |F| <=
limit and |F - F_before| <= slew dt hold of the float64 that are handed out, because the limit itself sinks by
at most half of what the slew limit allows: the force before is shortened to the limit of now, and the rest of
the way leads straight towards what is wanted. Up to H = 3/4 C^2 of heat, which follows |F|^2, the peak is
allowed; from there to C^2 the limit sinks to the continuous one, C.

**Materials.** A texture is a chord: four sines in each third of an octave, whose power is that of the table
at the speed of the hand along the surface and the force that it presses with: linear between, to zero below
the first, the last beyond. A band that the loop cannot show is left out; what the slew limit forbids makes
all weaker by one factor. Stick-slip is a sawtooth of mu over the way, from kinetic to static; where it would
go too fast, its mean.
"""

from __future__ import annotations

import math

from touchfield.compute.jit import inner, kernel
from touchfield.render.block import words as W
from touchfield.render.kernels.frames import force_at, gradient_at, strongest, vibration_between
from touchfield.render.kernels.vectors import along, dot, is_finite, length, less, plus, put, three, times

_FORCE = (W.FORCE, W.HEAT, W.LIMIT, W.PEAK, W.CONTINUOUS, W.SLEW)
_TORQUE = (W.TORQUE, W.TORQUE_HEAT, W.TORQUE_LIMIT, W.TORQUE_PEAK, W.TORQUE_CONTINUOUS, W.TORQUE_SLEW)
"""Where each keeps what was handed out, its heat and its limit at present, and where its own limits stand."""

_INSIDE = 1 - 2.0**-40  # so much of a limit is used; the rest is for the rounding of those who look
_ROUNDING = 2.0**-49  # of the forces themselves: what their differences may be off by
_COOL_SHARE = 0.75  # of C^2: below this heat the peak is allowed
_LATEST_TICKS = 2.0
"""A tick that comes later may move the force no further than one that comes now: no leap after a stall."""

_STIFFNESS_KEPT = 0.8  # of the stiffness that a proxy met when it turned back, in each tick
_TOO_FAR = 0.25
"""Of the pull before: a proxy that is pulled back by less comes to rest, or feels how a number is rounded."""

_BEGINNING = 0.5  # of its softness: a coupling that has less has just come up
_PER_TICK = 0.02  # of the way to another damper in contact, and to another coupling, in each tick
_LEAST_HAND_KG = 0.05
_LEAST_SPEED = 1e-9  # m/s; slower than this nothing can be damped
_LEAST_WAY = 1e-18  # m; of the proxy, m^2


@inner(forceinline=True)
def has_passed(f8, dt):
    """True if dt is a time in which something may change; in a block without parameters nothing does."""
    return dt > 0.0 and dt < math.inf and f8[W.RATE_HZ] > 0.0


@inner(forceinline=True)
def clamped_dt(f8, dt):
    """The time for which forces and gains may move, seconds."""
    return min(dt, _LATEST_TICKS / f8[W.RATE_HZ])


@inner(forceinline=True)
def _heated(f8, at, dt):
    """Heat after a time in which the force before was held; the limit that goes with it."""
    place, heat_at, _, peak_at, continuous_at, _ = at
    force, heat = three(f8, place), f8[heat_at]
    heat += (dot(force, force) - heat) * -math.expm1(-dt / f8[W.THERMAL_S])
    f8[heat_at] = heat
    peak, continuous = f8[peak_at], f8[continuous_at]
    if continuous <= 0.0:
        return peak
    most = continuous * continuous
    cool = (most - heat) / ((1.0 - _COOL_SHARE) * most)
    return continuous + (peak - continuous) * min(max(cool, 0.0), 1.0)


@inner(forceinline=True)
def _within(f8, at, wanted, dt):
    """The most that may be handed out where `wanted` is; `at` is `_FORCE` or `_TORQUE`."""
    place, _, limit_at, peak_at, _, slew_at = at
    before = three(f8, place)
    if not has_passed(f8, dt):
        return before
    bound = _heated(f8, at, dt)
    if not is_finite(wanted):
        wanted = 0.0, 0.0, 0.0
    room = f8[slew_at] * clamped_dt(f8, dt) * _INSIDE - _ROUNDING * f8[peak_at]
    if room <= 0.0:
        return before  # the time was too short for any step that float64 can tell
    bound = max(bound, f8[limit_at] - 0.5 * room)
    f8[limit_at] = bound
    bound *= _INSIDE
    size = length(wanted)
    if size > bound:
        wanted = times(bound / size, wanted)
    size = length(before)
    if size > bound:
        before = times(bound / size, before)
        room = max(0.0, room - (size - bound))
    way = less(wanted, before)
    size = length(way)
    if size > room:
        wanted = along(before, room / size, way)
    wanted = plus(wanted, (0.0, 0.0, 0.0))  # -0.0 is 0.0
    put(f8, place, wanted)
    return wanted


@kernel
def limited(f8, wanted, dt):
    """The force that may be handed out where one is wanted, newtons; keeps it, heat and limit in the state."""
    return _within(f8, _FORCE, wanted, dt)


@inner
def limited_torque(f8, wanted, dt):
    """The same of a torque, newton metres; zero for ever where the device states none."""
    return _within(f8, _TORQUE, wanted, dt)


@inner(forceinline=True)
def moved(f8, way, since):
    """Keep the velocity in the field, m/s, after a way in `since` seconds."""
    share = -math.expm1(-f8[W.CUTOFF] * since)
    velocity = along(times(1 - share, three(f8, W.VELOCITY)), share / since, way)
    put(f8, W.VELOCITY, velocity if is_finite(velocity) else (0.0, 0.0, 0.0))


@inner(forceinline=True)
def _greatest_eigenvalue(a, b, c, d, e, f):
    """Of the symmetric matrix with diagonal a, b, c and, beside it, d = xy, e = xz, f = yz."""
    mean = (a + b + c) / 3
    a, b, c = a - mean, b - mean, c - mean
    spread = math.sqrt((a * a + b * b + c * c + 2 * (d * d + e * e + f * f)) / 6)
    if not spread > 0.0:
        return mean
    a, b, c, d, e, f = a / spread, b / spread, c / spread, d / spread, e / spread, f / spread
    half = (a * (b * c - f * f) - d * (d * c - f * e) + e * (d * f - b * e)) / 2
    return mean + 2 * spread * math.cos(math.acos(min(max(half, -1.0), 1.0)) / 3)


@inner(inline="always")
def coupled(i8, u8, f8, f4, frame_a, frame_b, blend, hand):
    """The force of the coupling on a hand, newtons, and the place of the proxy then, metres."""
    k, nothing = 1.0 / f8[W.SOFTNESS], (0.0, 0.0, 0.0)
    if f8[W.IS_COUPLED] == 0.0:
        f8[W.IS_COUPLED], f8[W.PROXY_STIFFNESS] = 1.0, 0.0
        q = hand
        if (
            f8[W.SOFTNESS] * f8[W.COUPLING] < _BEGINNING
        ):  # of a later frame: it takes over the force that is felt
            q = along(hand, 1.0 / k, force_at(i8, u8, f8, f4, frame_a, frame_b, blend, *hand))
        put(f8, W.PROXY, q)
        put(f8, W.PROXY_HAND, hand)
        put(f8, W.PROXY_STEP, nothing)
        put(f8, W.PROXY_PULL, nothing)
    q = three(f8, W.PROXY)
    force = force_at(i8, u8, f8, f4, frame_a, frame_b, blend, *q)
    j = gradient_at(i8, u8, f8, f4, frame_a, frame_b, blend, *q, force)
    pull = along(force, k, less(hand, q))
    c = k + _turned_back(f8, along(pull, -k, less(hand, three(f8, W.PROXY_HAND))))
    c += max(
        0.0, _greatest_eigenvalue(j[0], j[4], j[8], (j[1] + j[3]) / 2, (j[2] + j[6]) / 2, (j[5] + j[7]) / 2)
    )
    step = _solved((c - j[0], -j[1], -j[2]), (-j[3], c - j[4], -j[5]), (-j[6], -j[7], c - j[8]), pull)
    q = plus(q, step)
    if not is_finite(q):
        f8[W.IS_COUPLED] = 0.0
        return nothing, hand
    put(f8, W.PROXY, q)
    put(f8, W.PROXY_STEP, step)
    put(f8, W.PROXY_PULL, pull)
    put(f8, W.PROXY_HAND, hand)
    return times(k, less(q, hand)), q


@inner(forceinline=True)
def _turned_back(f8, pull):
    """Stiffness added to c because the proxy went too far in this tick or in those before, N/m."""
    step = three(f8, W.PROXY_STEP)
    added = f8[W.PROXY_STIFFNESS] * _STIFFNESS_KEPT
    way, before, now = dot(step, step), dot(three(f8, W.PROXY_PULL), step), dot(pull, step)
    if way > _LEAST_WAY and now < -_TOO_FAR * before:
        added = max(added, (before - now) / way)
    f8[W.PROXY_STIFFNESS] = added
    return added


@inner(forceinline=True)
def _solved(first, second, third, right):
    """x with M x = right, of a matrix by its rows; it pushes every vector forward, so it is regular."""
    (a, b, c), (d, e, f), (g, h, i) = first, second, third
    p, q, r = e * i - f * h, f * g - d * i, d * h - e * g
    whole = a * p + b * q + c * r
    if not whole > 0.0:  # lost below the least of float64, or not finite
        return 0.0, 0.0, 0.0
    x = dot((p, c * h - b * i, b * f - c * e), right) / whole
    y = dot((q, a * i - c * g, c * d - a * f), right) / whole
    return x, y, dot((r, b * g - a * h, a * e - b * d), right) / whole


@inner(forceinline=True)
def adapt(f8):
    """Go on towards the damper in contact and the coupling that are wanted; without a step but the first."""
    softness = 1.0 / f8[W.COUPLING] if f8[W.COUPLING] > 0.0 else 0.0
    share = _PER_TICK if f8[W.IS_STARTED] != 0.0 else 1.0
    f8[W.BRAKE_NOW] += share * (f8[W.BRAKE] - f8[W.BRAKE_NOW])
    if (
        abs(softness - f8[W.SOFTNESS]) > 1e-3 * softness
    ):  # the pull changes with it, and tells nothing of the field
        put(f8, W.PROXY_STEP, (0.0, 0.0, 0.0))
    f8[W.SOFTNESS] += share * (softness - f8[W.SOFTNESS])


@inner(forceinline=True)
def braked(f8, force, velocity):
    """A force of the field, newtons, with the damper in contact: along it alone, and never more than it."""
    size = length(force)
    if not (f8[W.BRAKE_NOW] > 0.0 and size > 0.0):
        return force
    outwards = force[0] / size, force[1] / size, force[2] / size
    share = f8[W.BRAKE_NOW] * dot(outwards, velocity) / size
    return times(1.0 - min(max(share, -1.0), 1.0), force)


@inner(forceinline=True)
def vibration(i8, u8, f8, f4, frame_a, frame_b, blend, p, dt):
    """The sine beside the force at a point of the field, newtons."""
    amplitude, frequency = vibration_between(i8, u8, f8, f4, frame_a, frame_b, blend, *p)
    if not (amplitude > 0.0 and frequency > 0.0 and 2 * frequency < f8[W.RATE_HZ]):
        return 0.0
    turns = f8[W.PHASE] / (2 * math.pi) + frequency * dt
    f8[W.PHASE] = 2 * math.pi * (turns - math.floor(turns))
    return amplitude * math.sin(f8[W.PHASE])


@inner(forceinline=True)
def remember(f8):
    """Keep the force before among those that are still to act, without the steady one for the handle's
    weight.
    """
    for n in range(14, -1, -1):
        f8[W.PAST_FORCES + n + 3] = f8[W.PAST_FORCES + n]
    put(f8, W.PAST_FORCES, along(three(f8, W.FORCE), -f8[W.GAIN], three(f8, W.GRAVITY)))


@inner(forceinline=True)
def observe(f8, way):
    """Add up the energy of a way of the hand, metres of the device, against the force of `DELAY` ticks
    before.
    """
    whole = int(f8[W.DELAY])
    work = dot(three(f8, W.PAST_FORCES + 3 * whole), way)
    if f8[W.DELAY] > whole:
        work += (f8[W.DELAY] - whole) * (dot(three(f8, W.PAST_FORCES + 3 * whole + 3), way) - work)
    if math.isfinite(work):
        f8[W.ENERGY] -= work


@inner(forceinline=True)
def passive(f8, force, velocity, dt):
    """The force (device's axes) with the damper of the passivity controller; what is on its way is foreseen."""
    speed = length(velocity)
    way = speed * dt
    if f8[W.PASSIVITY] == 0.0 or not (speed > _LEAST_SPEED and way > _LEAST_WAY):
        return force
    energy, left, n = f8[W.ENERGY], f8[W.DELAY], 0
    while left > 0.0:
        energy -= min(left, 1.0) * dot(three(f8, W.PAST_FORCES + 3 * n), times(dt, velocity))
        left, n = left - 1.0, n + 1
    onwards = velocity[0] / speed, velocity[1] / speed, velocity[2] / speed
    driving = dot(force, onwards)
    lacking = driving - energy / way
    if not lacking > 0.0:
        return force
    braking = min(lacking, max(driving, 0.0) + 0.5 * _LEAST_HAND_KG * f8[W.RATE_HZ] * speed)
    return along(force, -braking, onwards)


_BAND_SINES = 4
_BANDS = W.MATERIAL_SINES // _BAND_SINES
_TO_EDGE = 10 ** (0.05 / _BAND_SINES)  # of a band, from its highest sine
_UNKNOWN = -2


@inner
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
                part = strongest(i8, u8, f8, f4, frame_a, frame_b, blend, p)
            inside = part == own
        if inside:
            f8[W.FRICTION_NOW] = _friction(f8, row)
            return row
        row += W.MATERIAL_WORDS
    f8[W.FRICTION_NOW] = f8[W.FRICTION]
    return 0


@inner
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


@inner
def _between(f8, at, count, x):
    """The two places of a rising row that x lies between, and its share of the way; -1 is zero, before the
    first.
    """
    low, before = -1, 0.0
    for n in range(count):
        value = f8[at + n]
        if x < value:
            return low, n, (x - before) / (value - before)
        low, before = n, value
    return count - 1, count - 1, 0.0


@inner
def _level(f8, at, i, forces, press):
    """Newtons rms of a band at speed i of the table, and at a force as of `_between`."""
    if i < 0:
        return 0.0
    low, high, share = press
    first = f8[at + (i * forces + low) * _BANDS] if low >= 0 else 0.0
    return first + share * (f8[at + (i * forces + high) * _BANDS] - first)


@inner(inline="always")
def texture(i8, f8, row, force, velocity, dt):
    """The vibration of a material at word `row`, newtons, for a force of the field and a velocity of the
    hand.
    """
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

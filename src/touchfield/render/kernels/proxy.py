"""Compiled: the *proxy*, a point that stays on the surface while the hand is pressed into it; a spring pulls
the hand towards it (the god object of Zilles and Salisbury).

The **surface** lies where the stored force reaches a level, its normal is the force's direction (Salisbury
and Tarr 1997). In a tick the proxy goes towards the hand in steps of half a sample, or less where those of
the tick before went to and fro, so that it comes to rest; where one ends within a surface, the place where it
went in is sought, and it slides on across the normal, in a corner across two or three. The hand is pulled to
it by a spring, F = K (proxy - hand), longer by K x, with x the depth of the proxy below the surface of which
the ramp behind it tells: what is thick is felt as the field has it, what is thin holds. **Friction** lets it
stay as long as its spring pulls along the surface by less than mu times the pressure (Harwin and Melder
2002). **What moves** carries it, in the axes of the body; a surface that comes over it pushes it out, some
steps a tick.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

from touchfield.compute.coder_jit import uncounted
from touchfield.render.block import words as W
from touchfield.render.kernels.frames import ends, force_at, mixed, part_count, rotation, strongest
from touchfield.render.kernels.vectors import (
    along,
    cross,
    dot,
    less,
    plus,
    put,
    three,
    times,
    turned,
    turned_back,
)

_MOST_STEPS = 8  # of one tick: some four samples
_TINY = 1e-7  # m
_NEAR = 0.003  # of a step
_BACK = 0.25  # of the way that was left: so much of it turns back
_ALIKE = 0.9  # cosine of normals that are one surface's
_SLID = 6.0  # levels: a step along a surface that ends below so much is moved out along the normal
_OFF = 1.5  # levels
_LEVEL_SHARE = 0.01  # of the level: how well the proxy lies on the surface
_ROUNDS = 4
_BEHIND = 2.0  # samples: from there on the low-pass leaves a ramp as it is
_DOUBT = 0.05  # samples: so much more than is true a ramp tells within the low-pass


class _At(NamedTuple):
    """The field at this time, K in N/m, the level in N, the longest step and the spacing of the samples in m."""

    i8: Any
    u8: Any
    f8: Any
    f4: Any
    frame_a: int
    frame_b: int
    blend: float
    stiffness: float
    level: float
    step: float
    spacing: tuple[float, float, float]


@uncounted(forceinline=True)
def _size(a):
    return math.sqrt(dot(a, a))


@uncounted
def _look(at, q):
    """Size of the force at a point, newtons, and its direction."""
    force = force_at(at.i8, at.u8, at.f8, at.f4, at.frame_a, at.frame_b, at.blend, *q)
    size = _size(force)
    if not 0.0 < size < math.inf:
        return 0.0, (0.0, 0.0, 0.0)
    return size, times(1.0 / size, force)


@uncounted
def _settled(at, q, size, normal):
    """A point at a surface, moved onto it along the normal, by secants; size and direction of the force
    there.
    """
    slope = at.stiffness
    for _ in range(_ROUNDS):
        if abs(size - at.level) <= _LEVEL_SHARE * at.level:
            break
        way = min(max((size - at.level) / slope, -at.step), at.step)
        p = along(q, way, normal)
        strength, other = _look(at, p)
        if strength == 0.0:  # beyond where the field begins
            slope *= 4.0
            continue
        slope = min(max((size - strength) / way, 0.05 * at.stiffness), 4.0 * at.stiffness)
        q, size, normal = p, strength, other
    return q, size, normal


@uncounted
def _entered(at, q, size, p, strength):
    """Where the way from q, outside, to p, within, goes in, by false position; an end that stays counts half."""
    low, high, left, right, side = 0.0, 1.0, size - at.level, strength - at.level, 0
    way, normal, share = less(p, q), (0.0, 0.0, 0.0), 0.0
    for _ in range(2 * _ROUNDS):
        share = (low * right - high * left) / (right - left)
        strength, normal = _look(at, along(q, share, way))
        off = strength - at.level
        if abs(off) <= _LEVEL_SHARE * at.level:
            break
        if off > 0.0:
            high, right = share, off
            if side == 1:
                left *= 0.5
            side = 1
        else:
            low, left = share, off
            if side == -1:
                right *= 0.5
            side = -1
    return along(q, share, way), strength, normal


@uncounted
def _sample(at, normal):
    """Spacing of the samples along a direction, metres."""
    return _size((at.spacing[0] * normal[0], at.spacing[1] * normal[1], at.spacing[2] * normal[2]))


@uncounted
def _steadied(at, q, normal):
    """The normal at the surface as the force behind it tells, which is steadier; its own where the wall is
    thin.
    """
    _, other = _look(at, along(q, -_BEHIND * _sample(at, normal), normal))
    return other if dot(other, normal) > _ALIKE else normal


@uncounted(forceinline=True)
def _is_free(d, planes, count):
    into = 0
    for n in range(count):
        into += dot(d, planes[n]) < -1e-9 * _size(d)
    return into == 0


@uncounted
def _allowed(d, planes, count):
    """The rest of the way d in front of up to three planes: the nearest way that goes into none."""
    if _is_free(d, planes, count):
        return d
    best, most = (0.0, 0.0, 0.0), 0.0
    for n in range(count):
        e = along(d, -dot(d, planes[n]), planes[n])
        if _size(e) > most and _is_free(e, planes, count):
            best, most = e, _size(e)
    if most > 0.0:
        return best
    for n in range(count):
        for m in range(n):
            a, b = planes[n], planes[m]
            c = cross(a, b)
            square = dot(c, c)
            share = dot(d, c) / square if square > 1e-12 else 0.0
            e = times(share, c)
            if _size(e) > most and _is_free(e, planes, count):
                best, most = e, _size(e)
    return best


@uncounted
def _with(planes, count, normal):
    """Planes that stop the proxy, and how many of the first ones do, once it has met another one."""
    a, b, c = planes
    if dot(a, normal) > _ALIKE:
        return (normal, b, c), max(count, 1)
    if count <= 1:
        return (normal, a, c), 2 if dot(b, normal) > _ALIKE else 1
    if dot(b, normal) > _ALIKE:
        return (a, normal, c), count
    return (a, b, normal), 3


@uncounted
def _goal(at, q, hand):
    """Where a proxy at q comes to without friction, and whether it is held there by a surface."""
    none = (0.0, 0.0, 0.0)
    planes, count = (none, none, none), 0
    size, normal = _look(at, q)
    for _ in range(_MOST_STEPS):  # a surface came over it
        if size <= _SLID * at.level:
            break
        q = along(q, min((size - at.level) / at.stiffness, at.step), normal)
        size, normal = _look(at, q)
    if size > at.level:
        q, size, normal = _settled(at, q, size, normal)
    if size > 0.9 * at.level:
        planes, count = _with(planes, count, _steadied(at, q, normal))
    last, left, grows = none, 0, 2.0
    reach = max(at.f8[W.PROXY_REACH], 2.0 * _NEAR * at.step) if at.f8[W.IS_HELD] != 0.0 else at.step
    for _ in range(_MOST_STEPS):
        d = _allowed(less(hand, q), planes, count)
        length = _size(d)
        if dot(d, last) < -_BACK * dot(last, last):  # over an edge and back: it comes to rest between
            reach, grows = 0.4 * reach, 1.0
        elif dot(d, last) > _ALIKE * length * _size(last):
            reach = min(grows * reach, at.step)
        if length <= _TINY or reach < _NEAR * at.step:
            break
        last = d
        p = along(q, min(length, reach) / length, d)
        strength, other = _look(at, p)
        if strength <= at.level and (strength < 0.5 * at.level or dot(less(hand, p), other) >= 0.0):
            if count == 0 and length <= reach:
                return p, False
            left = max(left, count)  # off the planes; they hold on where no step is left to find out
            q, size, count = p, strength, 0
            continue
        if strength <= _SLID * at.level and dot(other, d) <= (0.5 * length if count > 0 else 0.0):
            p, strength, other = _settled(at, p, strength, other)
        elif strength > at.level:
            if size > at.level:  # no way in can be sought from within
                break
            p, strength, other = _entered(at, q, size, p, strength)
        farther = _size(less(hand, p)) - _size(less(hand, q))
        if (
            strength > _OFF * at.level or farther > at.step
        ):  # no surface was found: forces that turn within a sample
            break
        q, size, normal = p, strength, other
        planes, count = _with(planes, count, _steadied(at, q, normal))
    count = count if count > 0 else left
    at.f8[W.PROXY_REACH] = reach
    return q, count > 0 and dot(less(hand, q), planes[count - 1]) < 0.0


@uncounted
def _pose(at, part):
    """Rotation of a part of the frame, and where it lies."""
    a, b, blend = ends(at.frame_a, at.frame_b, at.blend)
    a, b = a + W.FRAME_WORDS + part * W.PART_WORDS, b + W.FRAME_WORDS + part * W.PART_WORDS
    return rotation(at.f8, a, b, blend), mixed(at.f8, a + W.PART_POSITION, b + W.PART_POSITION, blend)


@uncounted
def _carried(at):
    """Where the proxy of the tick before has been carried to."""
    part = int(at.f8[W.PROXY_PART])
    if part < 0 or part >= part_count(at.i8, at.frame_a, at.frame_b):
        return three(at.f8, W.PROXY)
    r, place = _pose(at, part)
    return plus(turned(r, three(at.f8, W.PROXY_LOCAL)), place)


@uncounted
def _keep(at, q, is_held):
    """Remember the place of the proxy, in the axes of the part that pushes most there."""
    f8 = at.f8
    f8[W.IS_COUPLED], f8[W.IS_HELD], f8[W.PROXY_PART] = 1.0, 1.0 if is_held else 0.0, -1.0
    put(f8, W.PROXY, q)
    if not is_held or at.i8[at.frame_a + W.FRAME_WORDS + W.PART_IS_IDENTITY]:
        return  # voxels carry nothing
    part = strongest(at.i8, at.u8, f8, at.f4, at.frame_a, at.frame_b, at.blend, q)
    if part >= 0:
        r, place = _pose(at, part)
        f8[W.PROXY_PART] = part
        put(f8, W.PROXY_LOCAL, turned_back(r, less(q, place)))


@uncounted
def _dragged(at, before, goal, most):
    """Where friction leaves a proxy on its way to the goal: at most so many metres from there."""
    way = less(before, goal)
    length = _size(way)
    if length <= most:
        return before
    q = along(goal, most / length, way)
    size, normal = _look(at, q)
    if most > 0.0 and size > 0.5 * at.level:
        q, _, _ = _settled(at, q, size, normal)
    return q


@uncounted
def _below(at, q, inwards, depth):
    """Depth of a proxy below the surface of which the ramp behind it tells, metres; negative above.

    Two samples in the low-pass is over. Where the force is at its greatest before that, or the wall ends, a
    place half as far tells it, which is believed a little less.
    """
    sample = _sample(at, inwards)
    far, _ = _look(at, along(q, _BEHIND * sample, inwards))
    near, _ = _look(at, along(q, sample, inwards))
    told = max(far / at.stiffness - _BEHIND * sample, near / at.stiffness - (1.0 + _DOUBT) * sample, -sample)
    return min(told, sample, 0.5 * depth)


@uncounted
def held(i8, u8, f8, f4, frame_a, frame_b, blend, x, y, z):
    """The force of the proxy on a hand at (x, y, z), newtons: without friction three numbers, and what this
    adds.
    """
    spacing = three(f8, W.WALL_SPACING)
    step = 0.5 * min(spacing)
    at = _At(i8, u8, f8, f4, frame_a, frame_b, blend, f8[W.WALL], f8[W.WALL_LEVEL], step, spacing)
    hand = (x, y, z)
    before = _carried(at) if f8[W.IS_COUPLED] != 0.0 else hand
    was_held = f8[W.IS_COUPLED] != 0.0 and f8[W.IS_HELD] != 0.0
    goal, is_held = _goal(at, before, hand)
    nothing = (0.0, 0.0, 0.0)
    if not is_held:
        _keep(at, goal, False)
        return nothing, nothing
    pull = less(goal, hand)
    k = 1.0 / (1.0 / at.stiffness + f8[W.SOFTNESS])  # softer where the device could not be still
    depth = _size(pull)
    outwards = times(1.0 / depth, pull)
    force = max(0.0, k * (depth + _below(at, goal, times(-1.0, outwards), depth)))
    q = _dragged(at, before, goal, f8[W.FRICTION_NOW] * force / k) if was_held else goal
    _keep(at, q, True)
    drag = less(q, goal)
    most = f8[W.FRICTION_NOW] * force / max(k * _size(drag), 1e-12)
    share = k * min(1.0, most)  # moved onto the surface it may be a little farther off
    return times(force, outwards), times(share, drag)

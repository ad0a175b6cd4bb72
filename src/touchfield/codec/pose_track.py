"""Pose tracks, quantised within the perceptual mask and coded (paper section 4.3, the "object" source model).

The paper's rigid objects need one field and a pose a frame, and it leaves the coding of these "parameters of the
source model" open. Here a pose is seven whole numbers, multiples of two steps; the steps are as coarse as a bound of
the force error at any point allows, so that "source model parameter quantization" stays below the masking
threshold. Each number is predicted from those before it, and the residuals are coded by the arithmetic coder of
the support, in contexts of the last residuals. The chapter `POSES_CHAPTER` tells the bytes.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.codec.pose_steps import PoseSteps, pose_steps
from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.pose_track import PoseTrack

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Int64s = NDArray[np.int64]
    Float64s = NDArray[np.float64]

__all__ = ["MOST_POSES", "POSES_CHAPTER", "PoseSteps", "decode_poses", "encode_poses", "pose_steps"]

MOST_POSES: Final = (1 << 16) - 1
"""Poses in one piece of code; a segment of a file has no more frames."""

_MOST_STEPS: Final = 1 << 50  # a position; seven of them, as the quadratic predictor adds, stay exact
_COARSEST_ORDER, _FINEST_ORDER = 1, 3  # 0 is for what never changes
_SAME_RAY = 2.0**-50  # float64 quaternions nearer than this are one
_CHANGED = "The file was changed or cut."


POSES_CHAPTER: Final = """\
### Poses

The chunk of poses tells `frame_count` poses, x_scene = R x_body + t, each as seven whole numbers n[i][c], i from 0:
c = 0, 1, 2 are t along x, y, z in steps s, and c = 3 to 6 the quaternion (w, x, y, z) of R in steps u. Both steps
are told beforehand, as i8 exponents: s = 2^-40 to 2^0 metres, u = 2^-30 to 2^-2.

All is one arithmetic code, whose decoder, tables, mixed bits and end are those of the support. The first table has
8000 contexts, the second 32928, and there are 32 sets of weights. A *raw bit* is decoded with p = 32768, and nothing
learns from it; a *raw number* of b bits is b raw bits, the highest first. In this order:

1. For c = 0 to 6 the order k[c]: a raw number of 2 bits.
2. For c = 0 to 6 the first number n[0][c]: a raw bit, and if it is 0 the number is 0. Otherwise a raw number m of 6
   bits, at most 54, then a raw number b of m bits, then a raw bit, "negative": the number is 2^m + b, or -(2^m + b).
3. For i = 1 to `frame_count` - 1 and, within each i, for c = 0 to 6: the residual r, unless k[c] is 0.

With p1 = n[i-1][c], p2 = n[i-2][c], p3 = n[i-3][c], where those of negative i are n[0][c]:

| k[c] | n[i][c] |
|---|---|
| 0 | p1 |
| 1 | p1 + r |
| 2 | 2 p1 - p2 + r |
| 3 | 3 (p1 - p2) + p3 + r |

Let r1, r2, r3 be the last three residuals of the same c, the latest first, and 0 as long as there are none. With
length(v) the number of binary digits of v, length(0) = 0,

```text
near(v)    = min(max(v, -2), 2) + 2
size(v, m) = m + min(length(|v|), m)      or, for v < 0, m - min(length(|v|), m)
A = (((c > 2 ? 1 : 0) 5 + near(r1)) 5 + near(r2)) 5 + near(r3)
B = (21 c + size(r1, 10)) 7 + size(r2, 3)
```

Bit number j of a residual is a mixed bit in contexts 32 A + j and 32 B + j, weights j:

```text
bit 0: is r not 0?   if it is 0, nothing follows
bit 1: is r < 0?
l = 1
while l <= 54 and bit 1 + min(l, 14) is 1:  l = l + 1        # |r| has l binary digits; 55 is an error
v = 1
if l > 1:  v = 2 + bit 16 + min(l, 15)
if l > 2:  v = 2^(l-2) v + a raw number of l - 2 bits
r = v, or -v if r < 0
```

Bounds, without which the file is invalid: |n| is at most 2^50 for c = 0 to 2, at any time, and at most 1/u for the
others; and the sum of the squares of a quaternion's four numbers lies from (1/u - 1)^2 to (1/u + 1)^2. The code
ends with the fewest bytes that tell where it is, as that of the support; no other bytes follow.

t is s n, exact in f64. q is n divided by its length in f64, and it is a rotation whatever its sign; receivers may
round differently here, as nothing else is made of it.
"""

# -- whole numbers ----------------------------------------------------------------------------------------


def _limits(steps: PoseSteps) -> Int64s:
    return np.array([_MOST_STEPS] * 3 + [round(1 / steps.quaternion)] * 4, np.int64)


def _rounded(track: PoseTrack, steps: PoseSteps) -> Int64s:
    """Multiples of the steps, int64 [n, 7]: the nearest, and those of a decoded track as they were."""
    farthest = float(np.abs(track.positions_m).max())
    if farthest > _MOST_STEPS * steps.position_m:
        expected = f"{_MOST_STEPS * steps.position_m:g} m at most with a step of {steps.position_m:g} m"
        raise InvalidArgument("pose track positions_m", f"{farthest:g} m from the origin", expected)
    positions = np.rint(track.positions_m / steps.position_m)
    turns = np.rint(track.quaternions / steps.quaternion)
    return np.concatenate([positions, _as_they_were(track.quaternions, turns, steps)], axis=1).astype(np.int64)


def _as_they_were(units: Float64s, turns: Float64s, steps: PoseSteps) -> Float64s:
    """`turns`, but for quaternions that a decoder made unit the numbers that it had made them of.

    Rounding a decoded quaternion again could give its neighbour: coding a second time would cost precision.
    """
    largest = np.abs(units).max(axis=1, keepdims=True)
    middle = np.rint(largest / steps.quaternion)
    open_ = ~_on_ray(turns, units)
    chosen = turns.copy()
    for near in (0, -1, 1):
        candidate = np.rint(units * ((middle + near) / largest))
        fits = open_ & _on_ray(candidate, units) & _is_unit(candidate.astype(np.int64), steps)
        chosen[fits] = candidate[fits]
        open_ &= ~fits
    return chosen


def _on_ray(turns: Float64s, units: Float64s) -> NDArray[np.bool_]:
    same: NDArray[np.bool_] = np.abs(_unit(turns) - units).max(axis=1) < _SAME_RAY
    return same


def _unit(turns: Float64s) -> Float64s:
    unit: Float64s = turns / np.sqrt((turns * turns).sum(axis=1, keepdims=True))
    return unit


def _is_unit(turns: Int64s, steps: PoseSteps) -> NDArray[np.bool_]:
    """Whether quaternions are within one step of length 1 and no component is above 1; rounding keeps to both."""
    one = round(1 / steps.quaternion)
    squares = (turns * turns).sum(axis=1)
    held: NDArray[np.bool_] = (squares >= (one - 1) ** 2) & (squares <= (one + 1) ** 2)
    held &= np.abs(turns).max(axis=1) <= one
    return held


def _track(numbers: Int64s, steps: PoseSteps) -> PoseTrack:
    positions_m = numbers[:, :3].astype(np.float64) * steps.position_m
    return PoseTrack(_unit(numbers[:, 3:].astype(np.float64)), positions_m)


# -- bytes ------------------------------------------------------------------------------------------------


def encode_poses(track: PoseTrack, steps: PoseSteps) -> bytes:
    """The code of a track; `decode_poses` makes of it a track within half a step of position, and c <= 2 u.

    That is checked on the decoded track before the bytes are returned. A decoded track is coded without any further
    loss.

    Parameters
    ----------
    track : PoseTrack
        `MOST_POSES` at most.
    steps : PoseSteps

    Raises
    ------
    InvalidArgument
        If there are too many poses, or a position is beyond 2^50 steps.
    """
    if len(track) > MOST_POSES:
        raise InvalidArgument("pose track", f"{len(track)} poses", f"{MOST_POSES} at most", "Split it.")
    numbers, limits = _rounded(track, steps), _limits(steps)
    orders = np.array([_best_order(numbers, c, limits) for c in range(numbers.shape[1])], np.int64)
    data = _written(numbers, orders, limits, (0, len(orders)))
    decoded = decode_poses(data, len(track), steps)
    if np.abs(decoded.positions_m - track.positions_m).max() > 0.5 * steps.position_m:
        raise AssertionError("a position off by more than half a step")
    q, along = track.quaternions, (decoded.quaternions * track.quaternions).sum(axis=1, keepdims=True)
    if np.linalg.norm(decoded.quaternions - along * q, axis=1).max() > steps.quaternion + 1e-15:
        raise AssertionError("a rotation off by more than its step allows")
    return data


def _best_order(numbers: Int64s, c: int, limits: Int64s) -> int:
    """The predictor with which component c is shortest, coded alone."""
    if (numbers[:, c] == numbers[0, c]).all():
        return 0
    digits = {}
    for order in range(_COARSEST_ORDER, _FINEST_ORDER + 1):
        differences = np.diff(numbers[:, c], order).astype(np.float64)
        digits[order] = int(np.frexp(differences)[1].sum())
    sizes = {}
    for order, total in digits.items():
        if total <= min(digits.values()) + len(numbers):  # one digit a residual more is too much to be the best
            orders = np.full(numbers.shape[1], order, np.int64)
            sizes[order] = len(_written(numbers, orders, limits, (c, c + 1)))
    return min(sizes, key=lambda order: sizes[order])


def _written(numbers: Int64s, orders: Int64s, limits: Int64s, components: tuple[int, int]) -> bytes:
    from touchfield.codec.kernels import pose_track as kernels

    # an adaptive bit costs 14 bits at most, and a number has 56 of them and 52 raw ones at most: 107 bytes
    room = (components[1] - components[0]) * len(numbers) * 107 + 64
    coder = kernels.pose_coder(np.empty(room, np.uint8), decoding=False)
    if kernels.code_poses(coder, numbers, orders, limits, components) != kernels.DONE:
        raise AssertionError("a number beyond its limit")
    place, end = coder.tail()
    return coder.buffer[:place].tobytes() + end


def decode_poses(data: bytes, frame_count: int, steps: PoseSteps, where: str = "poses") -> PoseTrack:
    """The inverse of `encode_poses`.

    Parameters
    ----------
    data : bytes
    frame_count : int
        Poses that were coded, 1 to `MOST_POSES`; some 120 bytes are taken for each.
    steps : PoseSteps
    where : str
        What to call the bytes in an error.

    Raises
    ------
    TruncatedFile, CorruptFile
        If the bytes are not the code of so many poses.
    """
    from touchfield.codec.kernels import pose_track as kernels

    if not 1 <= frame_count <= MOST_POSES:
        raise InvalidArgument("frame_count", repr(frame_count), f"1 to {MOST_POSES}")
    coder = kernels.pose_coder(np.frombuffer(data, np.uint8).copy(), decoding=True)
    numbers = np.zeros((frame_count, kernels.COMPONENTS), np.int64)
    status = kernels.code_poses(coder, numbers, np.zeros(kernels.COMPONENTS, np.int64), _limits(steps))
    place, end = coder.tail()
    if len(data) < place + (len(end) if status == kernels.DONE else 0):
        raise TruncatedFile(where, f"the end of the code after {len(data)} bytes", f"{frame_count} poses", _CHANGED)
    if status != kernels.DONE:
        raise CorruptFile(where, "a number beyond its limit", "positions to 2^50 steps, quaternions to 1", _CHANGED)
    if data[place:] != end:
        raise CorruptFile(where, "bytes behind the end of the code", f"{place + len(end)} bytes", _CHANGED)
    odd = np.flatnonzero(~_is_unit(numbers[:, 3:], steps))
    if len(odd):
        found = f"the quaternion {tuple(numbers[odd[0], 3:].tolist())} in steps"
        expected = f"one of length {round(1 / steps.quaternion)} within 1"
        raise CorruptFile(f"{where}, frame {odd[0]}", found, expected, _CHANGED)
    return _track(numbers, steps)

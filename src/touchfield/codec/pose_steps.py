"""How finely poses must be told: steps whose error stays within the perceptual mask (paper section 4.3).

"Source model parameter quantization can be easily omitted since the perceptual filtering already performs
quantization below the masking threshold": here the steps of the poses are made such that this stays so.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

import numpy as np

from touchfield.errors import CorruptFile, InvalidArgument, TruncatedFile
from touchfield.medium.field import ForceField
from touchfield.medium.neighbours import neighbour_slots
from touchfield.parallel import for_chunks

__all__ = ["PoseSteps", "field_bounds", "pose_steps"]

_POSITION_POWERS: Final = (-40, 0)
_QUATERNION_POWERS: Final = (-30, -2)


@dataclass(frozen=True)
class PoseSteps:
    """The steps whose multiples a coded track consists of.

    Parameters
    ----------
    position_m : float
        Metres, a power of two from 2^-40 to 1.
    quaternion : float
        Of each component of the quaternion, a power of two from 2^-30 to 2^-2.

    Raises
    ------
    InvalidArgument
        If a step is out of range or no power of two.
    """

    position_m: float
    quaternion: float

    def __post_init__(self) -> None:
        for name, (low, high) in (("position_m", _POSITION_POWERS), ("quaternion", _QUATERNION_POWERS)):
            step = float(getattr(self, name))
            if not (2.0**low <= step <= 2.0**high) or math.frexp(step)[0] != 0.5:
                raise InvalidArgument(f"pose step {name}", repr(step), f"a power of two from 2^{low} to 2^{high}")
            object.__setattr__(self, name, step)

    def to_bytes(self) -> bytes:
        """Two bytes: the exponents of both steps as int8."""
        return struct.pack("bb", *(math.frexp(step)[1] - 1 for step in (self.position_m, self.quaternion)))

    @classmethod
    def from_bytes(cls, data: bytes, where: str = "pose steps") -> PoseSteps:
        """The inverse of `to_bytes`; `where` is what to call the bytes in an error.

        Raises
        ------
        TruncatedFile, CorruptFile
            If there are not two bytes, or an exponent is out of range.
        """
        if len(data) != 2:
            error = TruncatedFile if len(data) < 2 else CorruptFile
            raise error(where, f"{len(data)} bytes", "2")
        powers = struct.unpack("bb", data)
        for power, (low, high) in zip(powers, (_POSITION_POWERS, _QUATERNION_POWERS), strict=True):
            if not low <= power <= high:
                raise CorruptFile(where, f"a step of 2^{power}", f"2^{low} to 2^{high}")
        return cls(2.0 ** powers[0], 2.0 ** powers[1])


def pose_steps(field: ForceField | Iterable[ForceField], *, f0_n: float, share: float = 0.5) -> PoseSteps:
    """The coarsest steps whose quantised poses keep the force of a moving field within ``share * f0_n``.

    Parameters
    ----------
    field : ForceField, or several
        The field of a rigid object in its own frame; of one that deforms, all its frames.
    f0_n : float
        F_0, the force below which nothing is felt, newtons.
    share : float, optional
        Of F_0, in (0, 1]. With 0.5 two objects that overlap stay within F_0 together. Clipping their sum to F_max
        adds nothing, as it takes no two forces farther apart.

    Raises
    ------
    InvalidArgument
        If a number is out of range, or the field so steep that steps of 2^-40 m and 2^-30 would be too coarse.

    Notes
    -----
    At a point x of the scene the force is F = R f(y), y = R^T (x - t), f trilinear between samples and falling to
    zero over one spacing beyond the lattice. Let the decoded pose be R', t', and let c be the norm of R' - R. Then

        F' - F = R' (f(y') - f(y)) + (R' - R) f(y),     y' - y = (R'^T R - I) y - R'^T (t' - t),
        |F' - F| <= L (|t' - t| + c |y|) + c |f(y)|.

    If f(y) is zero, the same holds with y' for y, R - R' for R' - R; if f(y') is zero too, F' = F. So |y| is at most
    r, the farthest that f reaches from the body's origin, one cell beyond the support. L is the Lipschitz constant
    of f: the Jacobian of a trilinear cell is a mean, with weights that are not negative, of the eight Jacobians at
    its corners, so that L is the largest norm among these, and it is attained.

    Positions are rounded to the step s: |t' - t| <= sqrt(3) s / 2. Quaternions q, four components rounded to a
    step u, become q + e with |e| <= u, and the decoder makes them unit again. The angle a between q and q + e has
    sin a <= u, the rotations differ by the angle 2 a, and a rotation by 2 a moves a unit vector by 2 sin(a) at
    most: c <= 2 u. Together

        |F' - F| <= (sqrt(3) / 2) L s + 2 (L r + max |f|) u.

    Of the pairs of powers of two that keep this within the share, the one with the largest s^3 u^4 is taken: it
    codes in the fewest bits.
    """
    if not (f0_n > 0 and math.isfinite(f0_n)):
        raise InvalidArgument("f0_n", repr(f0_n), "a positive number of newtons")
    if not 0 < share <= 1:
        raise InvalidArgument("share", repr(share), "a number above 0, at most 1")
    bounds = [field_bounds(one) for one in ([field] if isinstance(field, ForceField) else field)]
    if not np.isfinite(bounds).all():
        raise InvalidArgument("field", "forces that are not finite", "finite newtons")
    per_m = max((0.5 * math.sqrt(3) * steepest for steepest, _, _ in bounds), default=0.0)
    per_turn = max((2 * (steepest * reach + force) for steepest, reach, force in bounds), default=0.0)
    budget = share * f0_n
    best: tuple[int, int, int] | None = None
    for power in range(_POSITION_POWERS[0], _POSITION_POWERS[1] + 1):
        turn = _QUATERNION_POWERS[1]
        while turn >= _QUATERNION_POWERS[0] and per_m * 2.0**power + per_turn * 2.0**turn > budget:
            turn -= 1
        if turn >= _QUATERNION_POWERS[0]:
            found = (3 * power + 4 * turn, power, turn)
            best = found if best is None else max(best, found)
    if best is None:
        found_text = f"{f0_n:g} N, and a field that changes by {per_m:.3g} N/m"
        raise InvalidArgument("f0_n", found_text, "a force that poses can keep to", "Take a larger F_0.")
    return PoseSteps(2.0 ** best[1], 2.0 ** best[2])


def field_bounds(field: ForceField) -> tuple[float, float, float]:
    """How steep a field is, how far it reaches and how strong it is; 0, 0, 0 without support.

    Returns
    -------
    steepest_n_per_m : float
        L, the Lipschitz constant of the trilinear field.
    reach_m : float
        r, no less than the distance from (0, 0, 0) to any point with a force, one cell beyond the support.
    force_n : float
        The largest force.
    """
    from touchfield.codec.kernels import pose_steps as kernels

    if not len(field.bricks):
        return 0.0, 0.0, 0.0
    slots = neighbour_slots(field.grid, field.bricks)
    spacing, origin = np.array(field.grid.spacing_m), np.array(field.grid.origin_m)
    arrays = field.bricks, field.forces_n, slots, spacing, origin
    squares = for_chunks(kernels.field_bounds, len(field.bricks), *arrays, chunk=16)
    steepest, reach, force = np.sqrt(np.max(squares, axis=0)) * (1 + 1e-9)  # above all rounding
    return float(steepest), float(reach), float(force)

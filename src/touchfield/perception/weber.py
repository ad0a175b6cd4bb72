"""Quantisers and deadbands (changes too small to be sent) whose errors are bounded by the Weber fraction k
times the force (paper section 4.2).

Eq. 6 is Q(x) = sgn(x) Delta [|x| / Delta + 1/2], where the bracket must be the floor. As printed, with Delta
= k |x|, it is k floor(1/k + 1/2) x: a constant gain and no quantiser. With a fixed Delta the error is
guaranteed to be within the mask k |x| only from |x| = Delta / (2 k) on.

Figure 2 requires an error that never leaves the mask k |x|. A ladder of cells whose borders grow by a
constant ratio needs the fewest levels for that::

    t_i = F_min rho^i     rho = (1 + kappa) / (1 - kappa)     r_i = (1 + kappa) t_i

The relative error in a cell is at most kappa, reached at both of its ends. Since (r_i + r_{i+1}) / 2 =
t_{i+1}, the ladder is also a nearest-neighbour quantiser. (Geometric midpoints as borders violate the mask:
0.1055 at k = 0.1.) Below F_min is a zero bin; the sign belongs to the direction.

The paper has two criteria. "error" (figure 2, default) keeps the error within the mask, kappa = k.
"neighbours" (text of section 4.2) puts two neighbouring levels within the mask of each other, rho = 1 + k,
with about twice as many levels.

The deadband decides which samples are sent, and which repeat the last one. Eq. 8 compares a_i with a_{i-1}
and transmits 0 for "hold". It does not define a_{i-1}; a drift that stays below k per sample is never sent,
the 0 cannot be told from a true zero, and a change of direction alone is missed. The readings differ in the
value that a sample is compared with:

* ``previous`` (as printed): the amplitude of the preceding sample, sent or not. The drift is unbounded.
* ``zero``: the same, but the amplitude of a held sample is replaced by zero. A held sample is always followed
  by a sent one.
* ``last-sent``: the amplitude of the last sample that was sent. The error can reach k / (1 - k) of the true
  value.
* ``closed`` (default): the *vector*, compared with x_ref, the value that the decoder has after quantisation::

      send iff |x - x_ref| > k' |x_ref|,    k' = k / (1 + k)

  A held sample then has |x| >= |x_ref| (1 - k') = |x_ref| / (1 + k), and so |x - x_ref| <= k |x|.

The first three have the strict inequality of eq. 8: after a zero nothing is held, not even another zero.
``closed`` holds on equality. "Hold" is a separate flag here; the first sample is always sent; comparisons are
in float64. In time (`gate_in_time`) the reference is the decoded previous frame at the same voxel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Bools, Float32s, Float64s
from touchfield.compute.threads import for_chunks
from touchfield.errors import (
    InvalidArgument,
    require_between,
    require_one_of,
    require_positive,
    require_up_to,
)


def jnd_gain(k: float) -> float:
    """Return k floor(1/k + 1/2), the constant gain of eq. 6 with Delta = k |x|.

    Computed for each sample, |x| / (k |x|) would be rounded, and the rounding would decide the floor where
    1/k + 1/2 is whole (k = 0.4).
    """
    require_positive(k=k)
    return k * math.floor(1 / k + 0.5)


def quantise_fixed_step(forces_n: ArrayLike, step_n: float) -> Float64s:
    """Quantise forces [...] by eq. 6 with one Delta for all of them.

    `forces_n`, `step_n`: newtons. Returns newtons, float64 [...].
    """
    require_positive(step_n=step_n)
    x = np.asarray(forces_n, np.float64)
    result: Float64s = np.sign(x) * step_n * np.floor(np.abs(x) / step_n + 0.5)
    return result


def within_mask_from_n(step_n: float, k: float) -> float:
    """Return Delta / (2 k), newtons.

    From this amplitude on, a fixed step stays within the mask k |x|.
    """
    require_positive(k=k, step_n=step_n)
    return step_n / (2 * k)


CRITERIA = ("error", "neighbours")

MAX_STEPS = 65535
"""Maximum number of steps above the zero bin; together with it they fill 16-bit symbols."""

_NARROWING = 2.0**-22
"""Subtracted from kappa, so that rounding the levels to float32 cannot raise the error above k."""

_SMALLEST_K = 1e-5
_SMALLEST_FORCE_N = 1e-30
_LARGEST_FORCE_N = 1e30


@dataclass(frozen=True)
class WeberLadder:
    """Levels and borders that keep the relative error within k.

    Raises `InvalidArgument` if a number is out of range, or the ladder passes 1e30 N.
    """

    k: float  # Weber fraction, 1e-5 or more and less than 1
    force_min_n: float  # F_min, newtons: weaker forces become zero
    steps: int  # N, the number of levels above the zero bin, 1 to 65535
    criterion: str = "error"  # or "neighbours"

    def __post_init__(self) -> None:
        require_one_of("criterion", self.criterion, CRITERIA)
        if not _SMALLEST_K <= self.k < 1:
            raise InvalidArgument("k", repr(self.k), f"a Weber fraction from {_SMALLEST_K} to 1, such as 0.1")
        require_between(_SMALLEST_FORCE_N, _LARGEST_FORCE_N, force_min_n=self.force_min_n)
        if not 1 <= self.steps <= MAX_STEPS:
            mend = "Raise k or force_min_n."
            raise InvalidArgument("Weber ladder", f"{self.steps} steps", f"1 to {MAX_STEPS}", mend)
        if math.log(self.force_min_n) + self.steps * math.log(self.ratio) > math.log(2 * _LARGEST_FORCE_N):
            raise InvalidArgument("Weber ladder", f"{self.steps} steps", "levels below 1e30 N")

    @classmethod
    def spanning(
        cls, k: float, force_min_n: float, force_max_n: float, criterion: str = "error"
    ) -> WeberLadder:
        """The ladder with the fewest levels from `force_min_n` to `force_max_n`, newtons.

        N = ceil(ln(F_max / F_min) / ln rho), at least 1.
        """
        ratio = cls(k, force_min_n, 1, criterion).ratio
        require_up_to(_LARGEST_FORCE_N, force_max_n=force_max_n)
        octaves = (math.log(force_max_n) - math.log(force_min_n)) / math.log(ratio)
        return cls(k, force_min_n, max(1, math.ceil(octaves)), criterion)

    @property
    def kappa(self) -> float:
        """The largest relative error within the ladder, before float32 rounding."""
        kappa = self.k if self.criterion == "error" else self.k / (2 + self.k)
        return kappa - _NARROWING

    @property
    def ratio(self) -> float:
        """rho, the ratio of neighbouring borders, and of neighbouring levels."""
        return (1 + self.kappa) / (1 - self.kappa)

    @cached_property
    def thresholds_n(self) -> Float64s:
        """Borders t_0 .. t_{N-1}, newtons, float64 [N].

        An amplitude from t_i to below t_{i+1} has level i + 1. The borders are computed by successive
        multiplication, so that every machine has the same bits.
        """
        thresholds = np.cumprod(np.concatenate([[self.force_min_n], np.full(self.steps - 1, self.ratio)]))
        thresholds.flags.writeable = False
        return thresholds

    @cached_property
    def levels_n(self) -> Float32s:
        """Levels 0, r_0 .. r_{N-1}, newtons, float32 [N + 1]."""
        levels = np.concatenate([[0.0], (1 + self.kappa) * self.thresholds_n]).astype(np.float32)
        levels.flags.writeable = False
        return levels

    @property
    def force_max_n(self) -> float:
        """t_N, newtons; the relative error is bounded up to this force."""
        return float(self.thresholds_n[-1]) * self.ratio


READINGS = ("closed", "last-sent", "previous", "zero")


def guaranteeing_fraction(k: float) -> float:
    """Return k' = k / (1 + k).

    A deadband of k' relative to the reference guarantees k relative to the true value. Raises
    `InvalidArgument` if `k` is not in 0 <= k < 1.
    """
    if not 0 <= k < 1:
        raise InvalidArgument("k", repr(k), "a Weber fraction from 0 to 1, such as 0.1")
    return k / (1 + k)


def _vectors(name: str, array: Float32s, count: int | None = None) -> Float32s:
    expected = f"float32 [{'L' if count is None else count}, 3]"
    if array.dtype != np.float32 or array.ndim != 2 or array.shape[1] != 3:
        raise InvalidArgument(name, f"{array.dtype} {array.shape}", expected)
    if count is not None and len(array) != count:
        raise InvalidArgument(name, f"{len(array)} samples", expected)
    return np.ascontiguousarray(array)


def gate(vectors: Float32s, k: float, reading: str = "closed", decoded: Float32s | None = None) -> Bools:
    """Return which samples of a scan are sent.

    vectors : float32 [L, 3]; forces in scan order, newtons.
    k : float; deadband parameter, 0 <= k < 1.
    reading : str; one of `READINGS`.
    decoded : float32 [L, 3], optional; what each sample would decode to if it were sent. Used by "closed"
        alone; without it the quantiser is taken to be lossless.
    Returns bool [L]: True for a sample that is sent.
    Raises `InvalidArgument` for an unknown reading, a `k` out of range, or arrays of other shapes or types.
    """
    fraction = guaranteeing_fraction(k)
    require_one_of("deadband reading", reading, READINGS)
    x = _vectors("vectors", vectors)
    from touchfield.perception import kernels

    sent = np.empty(len(x), np.bool_)
    if reading == "closed":
        kernels.gate_closed(x, x if decoded is None else _vectors("decoded", decoded, len(x)), fraction, sent)
    else:
        kernels.gate_amplitudes(x, k, ("previous", "zero", "last-sent").index(reading), sent)
    return sent


def gate_in_time(vectors: Float32s, reference: Float32s, k: float) -> Bools:
    """Return which samples differ from the previous decoded frame by more than the deadband.

    vectors, reference : float32 [L, 3]; forces of this frame, and the decoded ones of the frame before (zero
        where there was none).
    k : float; deadband parameter, 0 <= k < 1: a held sample has |x - reference| <= k |x|.
    Returns bool [L]: True where |x - reference| > k / (1 + k) |reference|. Raises `InvalidArgument` for a `k`
    out of range, or arrays of other shapes or types.
    """
    fraction = guaranteeing_fraction(k)
    x = _vectors("vectors", vectors)
    ref = _vectors("reference", reference, len(x))
    from touchfield.perception import kernels

    sent = np.empty(len(x), np.bool_)
    for_chunks(kernels.gate_in_time, len(x), x, ref, fraction, sent, chunk=1 << 15)
    return sent

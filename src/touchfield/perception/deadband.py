"""The deadband: which samples are sent, and which repeat the last one (paper eq. 8, section 4.2).

Eq. 8 compares a_i with a_{i-1} and transmits 0 for "hold". It leaves open what a_{i-1} is; a drift that stays below k
a sample is never sent, the 0 collides with a true zero, and a change of direction alone goes unseen. The readings, by
what a sample is compared with:

* ``previous`` (as printed): the amplitude of the sample before, sent or not. The drift is unbounded.
* ``zero``: the same, where the zero has been written in place. After a held sample always comes a sent one.
* ``last-sent``: the amplitude of the last sample that was sent. The error can reach k / (1 - k) of the true value.
* ``closed`` (default): the *vector*, against what the decoder holds, x_ref after quantisation::

      send iff |x - x_ref| > k' |x_ref|,    k' = k / (1 + k)

  A held sample then has |x| >= |x_ref| (1 - k') = |x_ref| / (1 + k), and so |x - x_ref| <= k |x|.

The first three have the strict inequality of eq. 8: after a zero nothing is held, not even another zero. ``closed``
holds on equality. "Hold" is a flag of its own here; the first sample is always sent; comparisons are in float64. In
time (`gate_in_time`) the reference is the decoded frame before at the same voxel.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Bools = NDArray[np.bool_]

READINGS = ("closed", "last-sent", "previous", "zero")


def guaranteeing_fraction(k: float) -> float:
    """k' = k / (1 + k): the fraction of the reference that guarantees k of the true value.

    Raises `InvalidArgument` if `k` is not in 0 <= k < 1.
    """
    if not 0 <= k < 1:
        raise InvalidArgument("k", repr(k), "a Weber fraction from 0 to 1, such as 0.1")
    return k / (1 + k)


def _vectors(name: str, array: Float32s, count: int | None = None) -> Float32s:
    wanted = f"float32 [{'L' if count is None else count}, 3]"
    if array.dtype != np.float32 or array.ndim != 2 or array.shape[1] != 3:
        raise InvalidArgument(name, f"{array.dtype} {array.shape}", wanted)
    if count is not None and len(array) != count:
        raise InvalidArgument(name, f"{len(array)} samples", wanted)
    return np.ascontiguousarray(array)


def gate(vectors: Float32s, k: float, reading: str = "closed", decoded: Float32s | None = None) -> Bools:
    """The samples of a scan that are sent.

    vectors : float32 [L, 3]; forces in scan order, newtons.
    k : float; deadband parameter, 0 <= k < 1.
    reading : str; one of `READINGS`.
    decoded : float32 [L, 3], optional; what each sample would decode to if it were sent (quantisation has no memory,
        so that this is known beforehand). Used by "closed" alone; without it the quantiser is taken to be lossless.
    Returns bool [L]: True for a sample that is sent.
    Raises `InvalidArgument` for an unknown reading, a `k` out of range, or arrays of other shapes or types.
    """
    fraction = guaranteeing_fraction(k)
    if reading not in READINGS:
        raise InvalidArgument("deadband reading", repr(reading), f"one of {', '.join(READINGS)}")
    x = _vectors("vectors", vectors)
    from touchfield.perception import kernels

    sent = np.empty(len(x), np.bool_)
    if reading == "closed":
        kernels.gate_closed(x, x if decoded is None else _vectors("decoded", decoded, len(x)), fraction, sent)
    else:
        kernels.gate_amplitudes(x, k, ("previous", "zero", "last-sent").index(reading), sent)
    return sent


def gate_in_time(vectors: Float32s, reference: Float32s, k: float) -> Bools:
    """The samples that differ perceptibly from the decoded frame before.

    vectors : float32 [L, 3]; forces of this frame, newtons.
    reference : float32 [L, 3]; decoded forces of the frame before at the same voxels, zero where there was none.
    k : float; deadband parameter, 0 <= k < 1: a held sample has |x - reference| <= k |x|.
    Returns bool [L]: True where |x - reference| > k / (1 + k) |reference|.
    Raises `InvalidArgument` for a `k` out of range, or arrays of other shapes or types.
    """
    fraction = guaranteeing_fraction(k)
    x = _vectors("vectors", vectors)
    ref = _vectors("reference", reference, len(x))
    from touchfield.perception import kernels

    sent = np.empty(len(x), np.bool_)
    for_chunks(kernels.gate_in_time, len(x), x, ref, fraction, sent, chunk=1 << 15)
    return sent


def held_values(sent: Bools, decoded: Float32s) -> Float32s:
    """The decoder's values: the last sent sample at each place of the scan; zero before the first.

    sent : bool [L]
    decoded : float32 [L, 3]; decoded value of each sample; read only where it is sent.
    Returns float32 [L, 3].
    """
    values = _vectors("decoded", decoded)
    if sent.dtype != np.bool_ or sent.shape != (len(values),):
        raise InvalidArgument("sent", f"{sent.dtype} {sent.shape}", f"bool [{len(values)}]")
    latest = np.maximum.accumulate(np.where(sent, np.arange(len(sent)), -1))
    return np.where(latest[:, None] >= 0, values[latest], np.float32(0))

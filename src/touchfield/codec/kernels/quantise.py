"""The compiled loops of the amplitude quantisers: levels of amplitudes, and Lloyd's iteration."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numba import njit

from touchfield.parallel import for_chunks

if TYPE_CHECKING:
    from numpy.typing import NDArray

    Float32s = NDArray[np.float32]
    Float64s = NDArray[np.float64]

__all__ = ["LevelLookup", "lloyd"]

_PIECE = 1 << 15
_BUCKETS_PER_LEVEL = 16
_LARGEST_BITS = 0x7F7FFFFF  # the largest finite float32


@njit(cache=True, nogil=True)
def _shallow(begin, end, amplitudes, bits, lookup, thresholds, low, shift, out):
    """At most one threshold in a bucket: one comparison, no branch."""
    top = np.int64(lookup.shape[0] - 2)
    worst = np.int64(0)
    for i in range(begin, end):
        b = np.int64(bits[i])
        worst = max(worst, b & 0xFFFFFFFF)  # the sign bit makes it too large
        level = lookup[min(max((b - low) >> shift, 0), top)]
        out[i] = level + np.uint16(amplitudes[i] >= thresholds[level])
    return worst


@njit(cache=True, nogil=True)
def _deep(begin, end, amplitudes, bits, lookup, thresholds, low, shift, out):
    top = np.int64(lookup.shape[0] - 2)
    worst = np.int64(0)
    for i in range(begin, end):
        b = np.int64(bits[i])
        worst = max(worst, b & 0xFFFFFFFF)  # the sign bit makes it too large
        bucket = min(max((b - low) >> shift, 0), top)
        first, last = np.int64(lookup[bucket]), np.int64(lookup[bucket + 1])
        while first < last:
            middle = (first + last) >> 1
            if amplitudes[i] >= thresholds[middle]:
                first = middle + 1
            else:
                last = middle
        out[i] = first
    return worst


class LevelLookup:
    """How many thresholds are at or below an amplitude, by a table over the bits of positive float32.

    The bit patterns of positive floats ascend with their values. A bucket of patterns gives how many thresholds
    lie below all of it; the few inside it are compared, so that the answer is exact.

    Parameters
    ----------
    thresholds : float32 [n]
        Positive, finite, strictly ascending.
    """

    def __init__(self, thresholds: Float32s) -> None:
        bits = thresholds.view(np.int32).astype(np.int64)
        self.low = int(bits[0]) if len(bits) else 0
        span = int(bits[-1]) - self.low + 1 if len(bits) else 1
        wanted = min(1 << 16, max(256, _BUCKETS_PER_LEVEL * len(bits)))
        self.shift = max(0, (span - 1).bit_length() - (wanted - 1).bit_length())
        edges = self.low + (np.arange((span >> self.shift) + 2, dtype=np.int64) << self.shift)
        counts = np.searchsorted(bits, edges, "right")
        counts[0] = 0  # also for what is below the first threshold
        counts[-1] = len(bits)
        self.lookup = counts.astype(np.uint16)
        self.thresholds = np.append(thresholds, np.float32(np.inf))
        self.kernel: Any = _shallow if np.diff(counts).max() <= 1 else _deep

    def __call__(self, amplitudes: Float32s) -> tuple[NDArray[np.uint16], bool]:
        """The counts of contiguous float32 [m], uint16 [m], and whether all were finite and not negative."""
        out = np.empty(len(amplitudes), np.uint16)
        bits = amplitudes.view(np.int32)
        arguments = (amplitudes, bits, self.lookup, self.thresholds, np.int64(self.low), np.int64(self.shift), out)
        worst = for_chunks(self.kernel, len(amplitudes), *arguments, chunk=_PIECE)
        return out, max(worst, default=0) <= _LARGEST_BITS


@njit(cache=True, nogil=True)
def _first_not_below(values, begin, threshold):
    """The first place from `begin` on whose value is `threshold` or more."""
    step, low = 1, begin
    while low + step < values.shape[0] and values[low + step] < threshold:
        low += step
        step *= 2
    high = min(values.shape[0], low + step)
    while low < high:
        middle = (low + high) >> 1
        if values[middle] < threshold:
            low = middle + 1
        else:
            high = middle
    return low


@njit(cache=True, nogil=True)
def _cells(values, thresholds, n, edges):
    """Where the cells of the first `n` thresholds begin and end in the sorted values, without the empty ones.

    Returns the number of cells.
    """
    edges[0] = 0
    count, place = 0, 0
    for i in range(n):
        place = _first_not_below(values, place, thresholds[i]) if place < values.shape[0] else place
        if place > edges[count] and place < values.shape[0]:
            count += 1
            edges[count] = place
    count += 1
    edges[count] = values.shape[0]
    return count


@njit(cache=True, nogil=True)
def _lloyd(values, sums, thresholds, tolerance, iterations):
    n = thresholds.shape[0] + 1
    edges = np.empty(n + 1, np.int64)
    before = np.zeros(n + 1, np.int64)
    levels = np.empty(n, np.float64)
    explained = -np.inf
    count = n
    for _ in range(iterations):
        count = _cells(values, thresholds, count - 1, edges)
        total, moved = 0.0, False
        for i in range(count):
            a, b = edges[i], edges[i + 1]
            inside = sums[b] - sums[a]
            levels[i] = inside / (b - a)
            total += inside * levels[i]  # the squared error is sum x^2 - total
            moved = moved or b != before[i + 1]
            before[i + 1] = b
        for i in range(count - 1):
            thresholds[i] = (levels[i] + levels[i + 1]) / 2
        if not moved or total - explained <= tolerance * (sums[sums.shape[0] - 1] - total):
            break
        explained = total
    return count


def lloyd(
    values: Float64s, sums: Float64s, thresholds: Float64s, tolerance: float, iterations: int
) -> tuple[NDArray[np.int64], Float64s]:
    """Lloyd's iteration on sorted samples.

    Parameters
    ----------
    values : float64 [m]
        Ascending.
    sums : float64 [m + 2]
        ``sums[i]`` is the sum of the first i values, and the last entry the sum of all squares.
    thresholds : float64 [n - 1]
        Where to begin, ascending.
    tolerance : float
        End when an iteration lowers the squared error by less than this share.
    iterations : int
        End after so many.

    Returns
    -------
    edges : int64 [count + 1]
        Where the cells begin and end in `values`; none is empty.
    thresholds : float64 [count - 1]
        The midpoints of their means.
    """
    moving = thresholds.copy()
    count = _lloyd(values, sums, moving, tolerance, iterations)
    edges = np.empty(len(thresholds) + 2, np.int64)
    count = _cells(values, moving, count - 1, edges)
    return edges[: count + 1], moving[: count - 1]

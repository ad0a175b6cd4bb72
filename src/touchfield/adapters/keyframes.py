"""Keyframes of sampled signals: no more of them than the format's own resolution asks for.

A player draws straight lines between keyframes, so that a sample that lies on such a line need not be told.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

__all__ = ["thinned"]


def thinned(ticks: NDArray[np.int64], values: NDArray[np.float64], tolerances: ArrayLike) -> NDArray[np.int64]:
    """Which samples to keep so that straight lines between them miss no sample by more than the tolerance.

    The first and the last are always kept. Each line reaches as far as the tolerances allow (the cone of slopes that
    pass all samples on the way); one pass, in time proportional to the samples.

    Parameters
    ----------
    ticks : int64 [n]
        Ascending, n at least 1.
    values : float64 [n, m]
        Samples of m signals that share their keyframes.
    tolerances : float [m]
        Greatest distance of each signal from the lines.

    Returns
    -------
    int64 [k]
        Indices of the samples that are kept, ascending.
    """
    margin = np.asarray(tolerances, np.float64)
    inner = (values[1:-1] == values[:-2]).all(axis=1) & (values[1:-1] == values[2:]).all(axis=1)
    places = np.flatnonzero(np.concatenate([[True], ~inner, [True]])[: len(ticks)])
    if len(places) < 3:
        return places
    # a sample between two equal ones lies on any line that both tolerate
    times, points, kept = ticks[places].tolist(), values[places].tolist(), [0]
    margins = margin.tolist()
    signals = range(len(margins))
    low, high = [-np.inf] * len(margins), [np.inf] * len(margins)
    for i in range(1, len(times)):
        start = kept[-1]
        span = times[i] - times[start]
        rises = [(points[i][s] - points[start][s]) / span for s in signals]
        if not all(low[s] <= rises[s] <= high[s] for s in signals):
            start = i - 1
            kept.append(start)
            span = times[i] - times[start]
            rises = [(points[i][s] - points[start][s]) / span for s in signals]
            low, high = [-np.inf] * len(margins), [np.inf] * len(margins)
        for s in signals:
            low[s] = max(low[s], rises[s] - margins[s] / span)
            high[s] = min(high[s], rises[s] + margins[s] / span)
    kept.append(len(times) - 1)
    return places[kept]

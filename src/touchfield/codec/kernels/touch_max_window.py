"""Where effort `max` of the coder `touch` looks, and what it keeps of the samples near by."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from touchfield.codec.kernels.touch_planes import PAD
from touchfield.codec.kernels.touch_residual import EXPERTS

CODED, COPY_BELOW, COPY_PREVIOUS, COPY_GUESS, COLUMN = 0, 1, 2, 3, 4
"""States of a brick: coded from all around; a copy; `COLUMN` and up: coded along z, y, x, by the guess, by the
previous frame."""

SATURATED = (1 << 16) - (1 << 10)
"""A force from here on is taken for the device's largest, which does not change with the depth."""

NEAR = np.array(
    [(-1, y, x) for y in (-1, 0, 1) for x in (-1, 0, 1)] + [(0, -1, -1), (0, -1, 0), (0, -1, 1), (0, 0, -1)], np.int64
)
"""The 13 causal neighbours, (z, y, x)."""

_D2 = (NEAR**2).sum(axis=1)
NEAR_WEIGHT = (256 // _D2**2).astype(np.int64)
NEAR_ONCE = (256 // _D2).astype(np.int64)

WINDOW = np.array(
    sorted(
        (
            (z, y, x)
            for z in (-2, -1, 0)
            for y in range(-2, 3)
            for x in range(-2, 3)
            if (z, y, x) < (0, 0, 0) and abs(z) + abs(y) + abs(x) <= 4
        ),
        key=lambda o: sum(c * c for c in o),
    ),
    np.int64,
)
"""Where least squares looks, nearest first."""
SAMPLES = 24
"""No more samples are taken, for the time that they need: more would gain nothing."""
WINDOW_WEIGHT = np.maximum(1, 24 // (WINDOW**2).sum(axis=1)).astype(np.int64)

CANDIDATES = 20
ALONE = 16
"""Candidates without another frame."""

RESIDUAL_CONTEXTS = 10


class Work(NamedTuple):
    """What least squares has seen, and what the samples near by cost; see `fresh_work`. Few arrays: each costs the
    compiler dear at every call."""

    sums: np.ndarray
    d: np.ndarray
    kept: np.ndarray
    marks: np.ndarray


M = CANDIDATES - 1
ALL = M  # rows of `sums`: M of the sums near by, M of those over all, then
B, ALL_B, SLOW, X, RIDGE, NONE, GIVEN = range(2 * M, 2 * M + 7)
SIZES = 2 * EXPERTS  # columns of `marks`: squared errors of the experts along and across, then
ROW = SIZES + 3
PINNED = ROW + 1


def fresh_work(rows: int, columns: int, capacity: int, inter: bool) -> Work:
    """For planes of `rows` by `columns` bricks of which three hold `capacity` samples at most."""
    width = M if inter else ALONE - 1
    shape = (3, 8 * rows + 2 * PAD, 8 * columns + 2 * PAD)
    marks = np.zeros((*shape, PINNED + 1), np.int32)
    marks[..., ROW] = -1
    return Work(
        np.zeros((2 * M + 7, M), np.int64),
        np.zeros((2, M + 1, 3 * SAMPLES), np.int16),
        np.zeros((capacity, width + 1, 3), np.int32),
        marks,
    )

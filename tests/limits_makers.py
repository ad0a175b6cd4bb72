"""Chains, sparse fields and their symbols for the tests of the coding limits."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import ContextCounter, ContextEntropy
from touchfield.medium import Grid


def markov(n: int, seed: int = 0, a: float = 0.05, b: float = 0.2) -> np.ndarray:
    """A binary chain with known entropies: 0 -> 1 with probability a, 1 -> 0 with probability b."""
    rng = np.random.default_rng(seed)
    runs = np.stack([rng.geometric(a, n), rng.geometric(b, n)], axis=1).ravel()
    return np.repeat(np.arange(2 * n) % 2, runs)[:n] if runs.sum() >= n else np.zeros(n, int)


def sparse(shape: tuple[int, ...], alphabet: int, share: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return rng.integers(1, alphabet, shape) * (rng.random(shape) < share)


def fields_of(frames: np.ndarray, alphabet: int) -> list[FieldSymbols]:
    grid = Grid(frames.shape[1:], (1, 1, 1), (0, 0, 0))
    return [FieldSymbols.from_dense(grid, f, alphabet, "test") for f in frames]


def context_entropy(
    frames: Sequence[FieldSymbols], neighbourhood: str, *, previous_frame: bool = False
) -> ContextEntropy:
    """H(S | c) of one neighbourhood alone, without any other context."""
    counter = ContextCounter(frames[0], previous_frame=previous_frame)
    before = None
    for frame in frames:
        counter.add(frame, before)
        before = frame
    return counter.result(neighbourhood, previous_frame=previous_frame)

"""Chains, sparse fields and their symbols for the tests of the coding limits, and a measure of memory."""

from __future__ import annotations

import tracemalloc
from collections.abc import Callable, Sequence

import numpy as np

from touchfield.measure.context import ContextCounter, ContextEntropy, scan_relabelled
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.limits import BlockRates, coding_limits
from touchfield.medium import Grid


def markov(n: int, seed: int = 0, a: float = 0.05, b: float = 0.2) -> np.ndarray:
    """Chain of theory.md section 4: 0 -> 1 with chance a, 1 -> 0 with chance b."""
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
    """H(S | c) of one neighbourhood alone, counted with no context that is not asked for."""
    counter = ContextCounter(frames[0].alphabet, frames[0].quantiser, previous_frame=previous_frame)
    before = None
    for frame in map(scan_relabelled, frames):
        counter.add(frame, before)
        before = frame
    return counter.result(neighbourhood, previous_frame=previous_frame)


def block_rates(x: np.ndarray, longest: int) -> BlockRates:
    """Block entropies and rates of one sequence."""
    return coding_limits(fields_of(x.reshape(1, 1, 1, -1), int(x.max()) + 1), longest=longest).scan_lines


def most_mib(work: Callable[[], object]) -> float:
    """The most memory that arrays take at once while something is worked out, MiB."""
    work()  # once before: what is compiled, and imported, is not counted
    tracemalloc.start()
    try:
        work()
        return tracemalloc.get_traced_memory()[1] / 2**20
    finally:
        tracemalloc.stop()

"""Entropies given causal neighbours, compared with brute force and known sources."""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp

from limits_makers import context_entropy, fields_of, markov, sparse
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits
from touchfield.measure.limits import NEIGHBOURHOODS, CellCounter, ContextEntropy


def of_array(x: np.ndarray, neighbourhood: str, previous_frame: bool = False) -> ContextEntropy:
    """`context_entropy` of an array [x, y, z] or [t, x, y, z], or one of fewer axes."""
    frames = x if x.ndim == 4 else x.reshape(1, *(1,) * (3 - x.ndim), *x.shape)
    return context_entropy(fields_of(frames, int(x.max()) + 1), neighbourhood, previous_frame=previous_frame)


OFFSETS = {"none": [], "previous": [(0, 0, -1)], "axes": [(0, 0, -1), (0, -1, 0), (-1, 0, 0)]}
OFFSETS["corner"] = [d for d in itertools.product((-1, 0), repeat=3) if any(d)]


def conditional_by_brute_force(
    frames: np.ndarray, neighbourhood: str, previous: bool
) -> tuple[float, int, int]:
    joint: Counter[tuple[int, ...]] = Counter()
    for t, frame in enumerate(frames):
        padded = np.pad(frame, 1)
        for p in np.ndindex(frame.shape):
            row = [
                int(padded[tuple(i + 1 + e for i, e in zip(p, d, strict=True))])
                for d in OFFSETS[neighbourhood]
            ]
            row += [int(frames[t - 1][p]) if t else 0] * previous
            joint[(*row, int(frame[p]))] += 1
    contexts: Counter[tuple[int, ...]] = Counter()
    for row, n in joint.items():
        contexts[row[:-1]] += n
    bits = entropy_bits(list(joint.values())) - entropy_bits(list(contexts.values()))
    return bits, len(contexts), len(joint)


@pytest.mark.parametrize("previous", [False, True])
@pytest.mark.parametrize("neighbourhood", list(NEIGHBOURHOODS))
def test_contexts_of_fields_agree_with_brute_force(neighbourhood: str, previous: bool) -> None:
    frames = sparse((3, 10, 9, 11), 4, 0.1)
    bits, contexts, cells = conditional_by_brute_force(frames, neighbourhood, previous)
    for source in (fields_of(frames, 4), tuple(fields_of(frames, 4))):
        found = context_entropy(source, neighbourhood, previous_frame=previous)
        assert found.per_voxel.value == pytest.approx(bits, abs=1e-12)
        assert (found.contexts, found.cells) == (contexts, cells)
        assert found.per_voxel.samples == frames.size


@pytest.mark.parametrize("shape", [(50,), (7, 9), (6, 5, 4)])
@pytest.mark.parametrize("high", [2, 2**31 - 1])
def test_arrays_of_few_axes_and_large_symbols(shape: tuple[int, ...], high: int) -> None:
    """Nine symbols of 31 bits need five words of a key."""
    x = np.where(sparse(shape, 3, 0.6) > 0, sparse(shape, 3, 1.0, 1), 0)
    large = np.where(x == 2, high, x)
    full = x.reshape(1, *(1,) * (3 - len(shape)), *shape)
    for neighbourhood in NEIGHBOURHOODS:
        bits, contexts, cells = conditional_by_brute_force(full, neighbourhood, False)
        found = of_array(large, neighbourhood)
        assert (found.contexts, found.cells) == (contexts, cells)
        assert found.per_voxel.value == pytest.approx(bits, abs=1e-12)


@given(hnp.arrays(np.int16, hnp.array_shapes(min_dims=4, max_dims=4, max_side=5), elements=st.integers(0, 3)))
def test_more_context_never_increases_the_entropy(x: np.ndarray) -> None:
    """H(S|c) <= H(S), and each further neighbour reduces it: exact for the plug-in estimate."""
    found = {(n, p): of_array(x, n, previous_frame=p).per_voxel.value
             for n in NEIGHBOURHOODS for p in (False, True)}  # fmt: skip
    assert found["none", False] == pytest.approx(entropy_bits(np.bincount(x.ravel())), abs=1e-12)
    for wide, narrow in itertools.pairwise(reversed(NEIGHBOURHOODS)):
        assert found[wide, False] <= found[narrow, False] + 1e-12
        assert found[wide, True] <= found[narrow, True] + 1e-12
    assert all(found[n, True] <= found[n, False] + 1e-12 for n in NEIGHBOURHOODS)


def test_field_that_needs_all_axis_neighbours() -> None:
    """Each voxel is the parity of its three axis neighbours, except one in ten: H(S|axes) = h2(.1),
    H(S|one) = 1.
    """
    flips = (np.random.default_rng(3).random((40, 40, 40)) < 0.1).astype(np.int32)
    h = binary_entropy_bits(float(flips.mean()))
    x = np.pad(flips, ((1, 0),) * 3)
    for p in itertools.product(range(1, 41), repeat=3):
        i, j, k = p
        x[p] ^= x[i - 1, j, k] ^ x[i, j - 1, k] ^ x[i, j, k - 1]
    x = x[1:, 1:, 1:]
    assert of_array(x, "axes").per_voxel.value == pytest.approx(h, abs=1e-3)
    assert of_array(x, "previous").per_voxel.value == pytest.approx(1, abs=0.01)


def test_context_of_independent_voxels_has_no_information() -> None:
    x = np.random.default_rng(5).choice(4, (40, 40, 40), p=[0.7, 0.1, 0.1, 0.1])
    h = entropy_bits([7, 1, 1, 1])
    assert h - 0.01 < of_array(x, "axes").per_voxel.value < h
    assert of_array(x, "previous").per_voxel.value == pytest.approx(h, abs=0.01)


def test_previous_frame_reduces_the_entropy() -> None:
    rng = np.random.default_rng(6)
    first = rng.integers(0, 2, (24, 24, 24))
    flips = rng.random((7, *first.shape)) < 0.02
    frames = np.concatenate([first[None], first ^ np.cumsum(flips, axis=0) % 2])
    found = of_array(frames, "none", previous_frame=True).per_voxel.value
    # of 16 half frames, 9 follow a 0, including the two of the first frame; 7 follow a 1
    want = 9 / 16 * binary_entropy_bits((1 + 7 * 0.02) / 9) + 7 / 16 * binary_entropy_bits(0.02)
    assert found == pytest.approx(want, abs=0.01)
    assert of_array(frames, "corner").per_voxel.value > 0.95


def test_rate_of_a_markov_chain() -> None:
    """The chain of `limits_makers`: marginal .721928, rate .373504."""
    chain = markov(400_000)
    assert of_array(chain, "none").per_voxel.value == pytest.approx(0.721928, abs=0.006)
    assert of_array(chain, "previous").per_voxel.value == pytest.approx(0.373504, abs=0.003)


def test_dilution_is_noted() -> None:
    x = sparse((12, 12, 12), 200, 0.5)
    found = of_array(x, "corner")
    assert found.is_diluted and found.per_voxel.value < 0.2 and "diluted" in found.per_voxel.notes[1]
    assert found.once > 0.9 * found.cells
    assert not of_array(markov(10_000), "previous").is_diluted


def test_cells_with_equal_hashes_are_distinguished() -> None:
    """More cells than the initial table: counts agree with numpy's sort of whole rows."""
    rng = np.random.default_rng(7)
    rows = rng.integers(0, 60, (60_000, 3), dtype=np.uint64)
    counter = CellCounter(3, 32)  # two symbols per word
    packed = np.stack([rows[:, 0] | rows[:, 1] << np.uint64(32), rows[:, 2]], axis=1)
    nonzero = packed.any(axis=1)
    counter.add(packed[nonzero])
    counter.zeros += int((~nonzero).sum())
    for columns in ((0, 1, 2), (0, 2), (1,)):
        _, want = np.unique(rows[:, columns], axis=0, return_counts=True)
        assert sorted(counter.marginal(columns).counts()) == sorted(want)
    assert counter.samples == len(rows)


def test_names_and_dilution_notes_of_contexts() -> None:
    frames = fields_of(np.stack([sparse((6, 7, 8), 9, 0.5, seed) for seed in (0, 1)]), 9)
    names = {
        ("none", False): "H(S)",
        ("none", True): "H(S|previous frame)",
        ("previous", False): "H(S|1 neighbour)",
        ("axes", False): "H(S|3 neighbours)",
        ("corner", True): "H(S|7 neighbours, previous frame)",
    }
    for (neighbourhood, previous_frame), name in names.items():
        found = context_entropy(frames, neighbourhood, previous_frame=previous_frame)
        assert found.per_voxel.name == name
        assert found.per_voxel.notes[0] == f"{found.contexts} contexts"
        assert (found.per_voxel.samples, found.per_voxel.symbols) == (2 * 6 * 7 * 8, found.cells)
        note = (
            f"diluted: {found.informed} voxels not all 0 for {found.cells} cells, fewer than ten each; too "
            "low"
        )
        assert (note in found.per_voxel.notes) == found.is_diluted == (found.informed < 10 * found.cells)
    assert context_entropy(frames, "corner").is_diluted and not context_entropy(frames, "none").is_diluted
    edge = context_entropy(frames, "none")
    assert not replace(edge, informed=10 * edge.cells).is_diluted
    assert replace(edge, informed=10 * edge.cells - 1).is_diluted

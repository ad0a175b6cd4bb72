"""The multiresolution filter on fields: agreement with arrays, reach, claims and texts."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from lifting_makers import coarse_only
from touchfield.errors import InvalidArgument
from touchfield.filters.lifting import FCC, MultiresolutionFilter
from touchfield.filters.registry import FieldFilter
from touchfield.medium import ForceField, Grid


def field_of(forces_n: NDArray[Any]) -> ForceField:
    return ForceField.from_dense(Grid(forces_n.shape[:3], (0.001, 0.002, 0.003), (0.1, 0.2, 0.3)), forces_n)


def sparse(shape: tuple[int, int, int], density: float, seed: int = 0) -> NDArray[np.float32]:
    rng = np.random.default_rng(seed)
    supported = rng.random(shape) < density
    return (rng.normal(size=(*shape, 3)) * supported[..., None]).astype(np.float32)


def clear_of(claims_reach: tuple[int, int, int], margin: int = 3) -> tuple[int, int, int]:
    x, y, z = (2 * r + margin + 2 for r in claims_reach)
    return (x, y, z)


@pytest.mark.parametrize(
    "shape", [(40, 37, 50), (24, 20, 17), (5, 6, 7), (9, 16, 33), (90, 70, 1), (1, 64, 70), (1, 1, 130)]
)
@pytest.mark.parametrize("stages", [1, 2, 3, 4, 8, 12])
def test_bits_agree_with_the_array(shape: tuple[int, int, int], stages: int) -> None:
    for forces in (sparse(shape, 1.0), sparse(shape, 3 / math.prod(shape), seed=1)):
        filtered = MultiresolutionFilter(stages)(field_of(forces))
        assert np.array_equal(filtered.to_dense(), coarse_only(forces, FCC, stages))
        assert filtered.mask.any(axis=(1, 2, 3)).all()
        # no sample outside the grid
        assert ForceField.from_bricks(filtered.grid, filtered.bricks, filtered.forces_n) == filtered


@pytest.mark.parametrize("stages", [1, 2, 3, 7])
def test_no_sample_is_reached_beyond_the_claim(stages: int) -> None:
    middle = 40 if stages == 7 else 16
    wide = Grid((2 * middle + 4,) * 3, (1, 1, 1), (0, 0, 0))
    step = MultiresolutionFilter(stages)
    reach = np.array(step.claims(wide).reach)
    found = np.zeros(3, int)
    for offset in itertools.product((0, 1), repeat=3):  # each position relative to the first octave's lattice
        at = middle + np.array(offset)
        out = step(ForceField.from_support(wide, at[None], [[1.0, 2.0, 3.0]]))
        assert out.support_count > 1
        found = np.maximum(found, np.abs(out.positions() - at).max(axis=0))
    assert (found <= reach).all()
    if stages == 1:
        assert (found == reach).all()
    assert reach.tolist() == [[3, 3, 3], [6, 6, 6], [9, 9, 6], [39, 39, 30]][[1, 2, 3, 7].index(stages)]


@pytest.mark.parametrize("stages", [1, 3, 5])
def test_mean_constant_and_sum_are_as_claimed(stages: int) -> None:
    step = MultiresolutionFilter(stages)
    claims = step.claims(Grid((100, 100, 100), (1, 1, 1), (0, 0, 0)))
    middle = max(claims.reach) + 8
    wide = Grid((2 * middle,) * 3, (1, 1, 1), (0, 0, 0))
    assert claims.linear and claims.keeps_mean and claims.dc_gain == 1
    shape = clear_of(claims.reach)
    rng = np.random.default_rng(stages)
    positions = rng.integers(middle - 5, middle + 5, (40, 3))
    fields = [ForceField.from_support(wide, positions[i::2], rng.normal(size=(20, 3))) for i in range(2)]
    for field in fields:
        total = field.forces_n.sum(axis=(0, 1, 2, 3), dtype=np.float64)
        filtered_total = step(field).forces_n.sum(axis=(0, 1, 2, 3), dtype=np.float64)
        assert filtered_total == pytest.approx(total, abs=1e-5)
    both = step(fields[0].scaled(2.0) + fields[1])
    parts = step(fields[0]).scaled(2.0) + step(fields[1])
    assert np.abs((both + parts.scaled(-1.0)).forces_n).max(initial=0) < 2e-6
    constant = np.broadcast_to(np.float32([1, -2, 0.3]), (*(min(n, 48) for n in shape), 3))
    assert np.abs(step(field_of(constant)).to_dense() - constant).max() < 1e-6  # also at the border


def test_filter_is_a_projection() -> None:
    forces = sparse((33, 34, 35), 0.2)
    filtered = MultiresolutionFilter(3)(field_of(forces))
    filtered_twice = MultiresolutionFilter(3)(filtered)
    assert np.abs(filtered.to_dense() - forces).max() > 0.5
    assert np.abs(filtered_twice.to_dense() - filtered.to_dense()).max() < 1e-6  # a projection


def test_a_field_that_is_too_large_to_be_dense_is_refused() -> None:
    vast = ForceField.from_support(Grid((1 << 14,) * 3, (1e-5,) * 3, (0, 0, 0)), [[0, 0, 0]], [[1.0, 0, 0]])
    with pytest.raises(InvalidArgument, match=r"--multiresolution: found .* of dense samples"):
        MultiresolutionFilter(4)(vast)


def test_an_empty_field_and_one_sample() -> None:
    grid = Grid((40, 30, 20), (1, 1, 1), (0, 0, 0))
    for stages in (1, 12):
        assert MultiresolutionFilter(stages)(ForceField.empty(grid)) == ForceField.empty(grid)
    point = field_of(np.ones((1, 1, 1, 3), np.float32))
    assert MultiresolutionFilter(5)(point) == point
    assert MultiresolutionFilter(5).claims(point.grid).reach == (0, 0, 0)


def test_text_round_trip_and_invalid_texts() -> None:
    assert issubclass(MultiresolutionFilter, FieldFilter) and MultiresolutionFilter.name == "multiresolution"
    assert MultiresolutionFilter.parse("") == MultiresolutionFilter.parse("3") == MultiresolutionFilter(3)
    # the notation of older streams
    assert MultiresolutionFilter.parse("stages=5,keep=coarse") == MultiresolutionFilter(5)
    assert MultiresolutionFilter.parse(MultiresolutionFilter(7).text) == MultiresolutionFilter(7)
    for text in ("0", "13", "-1", "2.5", "stages=nan"):
        with pytest.raises(InvalidArgument, match="stages"):
            MultiresolutionFilter.parse(text)
    with pytest.raises(InvalidArgument, match="each of stages at most once"):
        MultiresolutionFilter.parse("keep=details")

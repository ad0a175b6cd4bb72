"""The quincunx, the FCC and later stages: the sites of each stage."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from lifting_makers import coarse_mask
from touchfield.filters.lifting import FCC, QUINCUNX, SublatticeChain


def test_quincunx_sites_are_those_of_its_matrix() -> None:
    matrix = np.array([[1, 1], [1, -1]])
    for stages in range(1, 7):
        sites = np.argwhere(coarse_mask((12, 16), stages))
        coordinates = np.linalg.solve(np.linalg.matrix_power(matrix, stages).astype(float), sites.T)
        assert np.allclose(coordinates, np.round(coordinates))  # every site is D^s k ...
    n1, n2 = np.indices((12, 16))
    assert np.array_equal(coarse_mask((12, 16), 1), (n1 + n2) % 2 == 0)  # ... and none is missing
    assert np.array_equal(coarse_mask((12, 16), 2), (n1 % 2 == 0) & (n2 % 2 == 0))


def test_fcc_and_later_stages() -> None:
    a, b, c = np.indices((8, 8, 8))
    assert np.array_equal(coarse_mask((8, 8, 8), 1), (a + b + c) % 2 == 0)
    assert np.array_equal(coarse_mask((8, 8, 8), 2), ((a + b) % 2 == 0) & (c % 2 == 0))
    assert np.array_equal(coarse_mask((8, 8, 8), 3), (a % 2 == 0) & (b % 2 == 0) & (c % 2 == 0))
    assert np.array_equal(coarse_mask((8, 8, 8), 5)[::2, ::2, ::2], coarse_mask((4, 4, 4), 2))


@pytest.mark.parametrize("chain", [QUINCUNX, FCC], ids=lambda c: c.name)
def test_each_stage_halves_a_lattice_and_uses_the_nearest_neighbours(
    chain: SublatticeChain,
) -> None:
    d = chain.dimensions
    centre = np.full(d, 16)
    for stage, split in enumerate(chain.splits(2 * d)):
        before, after = (coarse_mask((33,) * d, s) for s in (stage, stage + 1))
        assert not (after & ~before).any()
        assert coarse_mask((32,) * d, stage).sum() == 2 * coarse_mask((32,) * d, stage + 1).sum()
        sites = np.argwhere(after) - centre
        central_sites = sites[(np.abs(sites) <= 8).all(axis=1)]  # a lattice has all differences of its sites
        site_set = {tuple(s) for s in np.argwhere(after) - centre}
        assert all(
            tuple(p - q) in site_set for p, q in itertools.product(central_sites[::7], central_sites[::5])
        )
        neighbours = {tuple(o) for o in np.array(split.offsets) * split.scale}
        details = np.argwhere(before & ~after)
        for detail in details[(np.abs(details - centre) <= split.scale).all(axis=1)]:
            offsets = np.argwhere(after) - detail
            square = (offsets**2).sum(axis=1)
            assert {tuple(v) for v in offsets[square == square.min()]} == neighbours
        assert {tuple(-np.array(o)) for o in neighbours} == neighbours


def test_fcc_contains_no_body_centred_lattice() -> None:
    """Its smallest square distance would be 3 (its density being 1/4), and the FCC has no odd one."""
    sites = np.argwhere(coarse_mask((9, 9, 9), 1)) - 4
    assert not ((sites**2).sum(axis=1) % 2).any()
    body_centred = np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]])
    assert abs(np.linalg.det(body_centred)) == pytest.approx(4)
    assert (body_centred**2).sum(axis=1).tolist() == [3, 3, 3]


def test_masks_of_odd_shapes() -> None:
    assert coarse_mask((1, 5), 1).tolist() == [[True, False, True, False, True]]
    assert coarse_mask((1, 1, 1), 60).all()
    assert coarse_mask((3, 4), 0).all()
    assert coarse_mask((7, 5), 20).sum() == 1

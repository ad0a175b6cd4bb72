"""KSG mutual information: Gaussian values, scikit-learn as the oracle, invariances, intervals, refusals."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from sklearn.feature_selection import mutual_info_regression

from touchfield.errors import InvalidArgument
from touchfield.measure.information import _nearer, ksg_mutual_information

Floats = NDArray[np.float64]
THIRTY_MILLINATS = 0.03 / math.log(2)


def gaussian_pairs(rho: float, n: int, seed: int) -> tuple[Floats, Floats]:
    rng = np.random.default_rng(seed)
    x = rng.standard_normal(n)
    return x, rho * x + math.sqrt(1 - rho**2) * rng.standard_normal(n)


@pytest.mark.parametrize(("rho", "bits"), [(0.0, 0.0), (0.6, 0.321928), (0.9, 1.197964)])
def test_gaussian_pairs(rho: float, bits: float) -> None:
    assert -0.5 * math.log2(1 - rho**2) == pytest.approx(bits, abs=5e-7)
    found = [ksg_mutual_information(*gaussian_pairs(rho, 5000, seed)) for seed in range(12)]
    assert max(abs(q.value - bits) for q in found) < max(THIRTY_MILLINATS, 0.06)
    assert np.mean([q.value for q in found]) == pytest.approx(bits, abs=THIRTY_MILLINATS / 2)
    inside = [q.interval is not None and q.interval.low <= bits <= q.interval.high for q in found]
    assert sum(inside) >= 9


@pytest.mark.parametrize("k", [1, 3, 8])
@pytest.mark.parametrize("rho", [0.0, 0.6, 0.9])
def test_it_equals_scikit_learn(rho: float, k: int) -> None:
    x, y = gaussian_pairs(rho, 3000, 7)
    nats = mutual_info_regression(x[:, None], y, n_neighbors=k, random_state=0)[0]
    found = ksg_mutual_information(x, y, k).value * math.log(2)
    assert max(found, 0) == pytest.approx(nats, abs=1e-5)  # it cuts at 0


def test_vectors() -> None:
    rng = np.random.default_rng(5)
    x = rng.standard_normal((6000, 2))
    y = np.column_stack([0.6 * x[:, 0] + 0.8 * rng.standard_normal(6000), rng.standard_normal(6000)])
    joint = ksg_mutual_information(x, y)
    assert joint.value == pytest.approx(0.321928, abs=0.06)
    assert ksg_mutual_information(x, y[:, 0]).value == pytest.approx(0.321928, abs=0.05)
    assert ksg_mutual_information(x, y[:, 1]).value == pytest.approx(0, abs=0.05)


def test_symmetry_scale_shift_and_bits_that_repeat() -> None:
    x, y = gaussian_pairs(0.8, 1500, 1)
    base = ksg_mutual_information(x, y)
    assert ksg_mutual_information(x, y) == base
    assert ksg_mutual_information(y, x).value == pytest.approx(base.value, abs=1e-6)
    assert ksg_mutual_information(1e6 * x - 3e6, -1e-150 * y).value == pytest.approx(base.value, abs=1e-4)
    assert ksg_mutual_information(x * 1e300, y).value == pytest.approx(base.value, abs=1e-6)
    assert ksg_mutual_information(x, y, seed=5).value == pytest.approx(base.value, abs=1e-6)
    assert ksg_mutual_information(np.exp(x / 2), y**3).value == pytest.approx(base.value, abs=0.1)


def test_neighbours_on_a_line_are_counted_as_defined() -> None:
    rng = np.random.default_rng(2)
    line = rng.standard_normal((400, 1)) * 10.0 ** rng.integers(-3, 6, (400, 1))
    apart = np.abs(line - line.T)
    reach = np.sort(apart, axis=1)[:, 5]  # exactly at the rim stands one, which does not count
    expected = (apart < reach[:, None]).sum(axis=1)
    assert (expected == 5).all()
    assert np.array_equal(_nearer(line, reach), expected)
    assert np.array_equal(_nearer(np.hstack([line, line]), reach), expected)


def test_what_the_quantity_says() -> None:
    x, y = gaussian_pairs(0.6, 2000, 1)
    q = ksg_mutual_information(x, y, 4)
    assert (q.name, q.unit, q.estimator, q.samples) == ("I(X;Y)", "bit/sample", "ksg", 2000)
    assert q.notes == ("k = 4, maximum norm",)
    assert q.interval is not None and q.interval.low < q.value < q.interval.high
    few = ksg_mutual_information(x[:300], y[:300])
    assert few.interval is None and "no interval" in few.notes[-1]


def test_ties_are_parted_and_told() -> None:
    x, y = gaussian_pairs(0.6, 2000, 1)
    q = ksg_mutual_information(np.round(x, 1), y)
    assert any("repeat others" in note for note in q.notes)
    assert q.value == pytest.approx(ksg_mutual_information(x, y).value, abs=0.1)


def test_a_constant_tells_nothing() -> None:
    x, _ = gaussian_pairs(0.0, 100, 1)
    q = ksg_mutual_information(x, np.full(100, 3.0))
    assert q.value == 0 and "y is constant" in q.notes[0]
    half = np.column_stack([x, np.ones(100)])  # one constant column of two is no harm
    assert ksg_mutual_information(half, x).value > 1


def test_dependence_between_neighbours_widens_the_interval() -> None:
    rng = np.random.default_rng(3)
    slow = np.repeat(rng.standard_normal((2, 100)), 30, axis=1) + 0.3 * rng.standard_normal((2, 3000))
    order = rng.permutation(3000)
    widths = []
    for x, y in (slow, slow[:, order]):
        i = ksg_mutual_information(x, y).interval
        assert i is not None
        widths.append(i.high - i.low)
    assert widths[0] > 2 * widths[1]


@pytest.mark.parametrize(
    ("x", "y", "k", "words"),
    [
        ([1.0, 2.0, 3.0], [1.0, 2.0], 1, "y: found 2 samples; expected 3"),
        ([1.0, math.nan, 3.0], [1.0, 2.0, 3.0], 1, "x: found NaN"),
        ([1.0, 2.0, 3.0], [1.0, math.inf, 3.0], 1, "y: found NaN or infinity"),
        ([1.0, 2.0, 3.0], [1.0, 5.0, 3.0], 0, "k: found 0; expected a whole number from 1 to 2"),
        ([1.0, 2.0, 3.0], [1.0, 5.0, 3.0], 3, "k: found 3"),
        ([1.0, 2.0, 3.0], [1.0, 5.0, 3.0], 1.5, "k: found 1.5"),
        ([1.0, 2.0, 3.0], [1.0, 5.0, 3.0], math.nan, "k: found nan"),
        ([], [], 1, "x: found"),
        ([[[1.0]], [[2.0]]], [1.0, 2.0], 1, "x: found"),
        (["a", "b"], [1.0, 2.0], 1, "x: found"),
        ([[1.0], [2.0, 3.0]], [1.0, 2.0], 1, "x: found rows of different lengths"),
        ([1.0, 2.0], [[1.0], [2.0, 3.0]], 1, "y: found rows of different lengths"),
    ],
)
def test_what_cannot_be(x: list[object], y: list[object], k: int, words: str) -> None:
    with pytest.raises(InvalidArgument, match=words):
        ksg_mutual_information(x, y, k)  # type: ignore[arg-type]

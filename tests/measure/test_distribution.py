"""Exact quantities of given probabilities, compared with analytic values, scipy and dit."""

from __future__ import annotations

import math

import dit
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import distance

from touchfield.errors import InvalidArgument
from touchfield.measure import information as info
from touchfield.measure.counts import Counts
from touchfield.measure.quantity import Quantity

COVER_THOMAS = np.array([[4, 2, 1, 1], [2, 4, 1, 1], [2, 2, 2, 2], [8, 0, 0, 0]]).T / 32
"""Example 2.2.1 of Elements of Information Theory, x along axis 0."""

Vector = NDArray[np.float64]


class d:
    """Information quantities of given probabilities."""

    @staticmethod
    def entropy(p: object) -> Quantity:
        return info.entropy(Counts.of_probabilities(p))  # type: ignore[arg-type]

    joint_entropy = entropy

    @staticmethod
    def conditional_entropy(p: object, given: int = 1) -> Quantity:
        return info.conditional_entropy(Counts.of_probabilities(p), given=given)  # type: ignore[arg-type]

    @staticmethod
    def mutual_information(p: object) -> Quantity:
        return info.mutual_information(Counts.of_probabilities(p))  # type: ignore[arg-type]

    @staticmethod
    def variation_of_information(p: object) -> Quantity:
        return info.variation_of_information(Counts.of_probabilities(p))  # type: ignore[arg-type]

    @staticmethod
    def normalised_mutual_information(p: object) -> Quantity:
        return info.normalised_mutual_information(Counts.of_probabilities(p))  # type: ignore[arg-type]

    @staticmethod
    def jensen_shannon_distance(p: object, q: object) -> Quantity:
        return info.jensen_shannon_distance(Counts.of_probabilities(p), Counts.of_probabilities(q))  # type: ignore[arg-type]


def probabilities(shape: int | tuple[int, ...]) -> st.SearchStrategy[Vector]:
    """Distributions that include zeros and very small probabilities."""
    weights = st.one_of(st.just(0.0), st.floats(1e-6, 1), st.floats(1e-30, 1e-6))
    return (
        arrays(np.float64, shape, elements=weights).filter(lambda w: w.sum() > 0).map(lambda w: w / w.sum())
    )


def test_values_of_the_literature() -> None:
    assert float(d.entropy([1 / 2, 1 / 4, 1 / 8, 1 / 8])) == 1.75
    assert float(d.entropy([0.9, 0.1])) == pytest.approx(0.468996, abs=1e-6)
    assert float(d.entropy(COVER_THOMAS.sum(axis=1))) == pytest.approx(1.75, abs=1e-12)
    assert float(d.entropy(COVER_THOMAS.sum(axis=0))) == pytest.approx(2, abs=1e-12)
    assert float(d.joint_entropy(COVER_THOMAS)) == pytest.approx(3.375, abs=1e-12)
    assert float(d.mutual_information(COVER_THOMAS)) == pytest.approx(0.375, abs=1e-12)
    assert float(d.conditional_entropy(COVER_THOMAS)) == pytest.approx(1.375, abs=1e-12)
    assert float(d.conditional_entropy(COVER_THOMAS, given=0)) == pytest.approx(1.625, abs=1e-12)
    assert float(d.jensen_shannon_distance([0.5, 0.5], [0.9, 0.1])) ** 2 == pytest.approx(0.146793, abs=1e-6)
    assert float(d.variation_of_information(COVER_THOMAS)) == pytest.approx(3, abs=1e-12)


def test_markov_chain() -> None:
    """a = 0.05, b = 0.2: the stationary marginal, and the rate H(S'|S)."""
    step = np.array([[0.95, 0.05], [0.2, 0.8]])
    joint = np.array([0.8, 0.2])[:, None] * step
    assert float(d.entropy(joint.sum(axis=0))) == pytest.approx(0.721928, abs=1e-6)
    assert float(d.conditional_entropy(joint, given=0)) == pytest.approx(0.373504, abs=1e-6)


def test_metadata_of_a_quantity() -> None:
    q = d.jensen_shannon_distance([0.5, 0.5, 0], [0, 0.5, 0.5])
    assert (q.estimator, q.samples, q.symbols, q.unit, q.interval) == ("exact", 0, 3, "sqrt(bit)", None)
    assert d.entropy([1.0]).value == 0 and math.copysign(1, d.entropy([1.0]).value) == 1


@given(probabilities(7), probabilities(7))
def test_divergences_agree_with_scipy(p: Vector, q: Vector) -> None:
    assert float(d.entropy(p)) == pytest.approx(stats.entropy(p, base=2), abs=1e-12)
    assert float(d.jensen_shannon_distance(p, q)) ** 2 == pytest.approx(
        np.nan_to_num(distance.jensenshannon(p, q, 2)) ** 2,
        abs=1e-12,  # scipy: NaN for equal distributions, by rounding
    )


@given(probabilities((4, 3)))
def test_joint_quantities_agree_with_dit(table: Vector) -> None:
    joint = dit.Distribution([f"{x}{y}" for x in range(4) for y in range(3)], table.ravel())
    joint.set_rv_names("XY")
    x, y = dit.shannon.entropy(joint, "X"), dit.shannon.entropy(joint, "Y")
    both, mutual = dit.shannon.entropy(joint), dit.shannon.mutual_information(joint, "X", "Y")
    tolerance = {"abs": 1e-12, "rel": 0}
    assert float(d.joint_entropy(table)) == pytest.approx(both, **tolerance)
    assert float(d.mutual_information(table)) == pytest.approx(mutual, **tolerance)
    assert float(d.conditional_entropy(table, 1)) == pytest.approx(
        dit.shannon.conditional_entropy(joint, "X", "Y"), **tolerance
    )
    assert float(d.conditional_entropy(table, 0)) == pytest.approx(
        dit.shannon.conditional_entropy(joint, "Y", "X"), **tolerance
    )
    assert float(d.variation_of_information(table)) == pytest.approx(2 * both - x - y, **tolerance)
    denominator = math.sqrt(max(0.0, x * y))
    if denominator > 1e-3:  # a quotient of rounding errors is meaningless
        assert float(d.normalised_mutual_information(table)) == pytest.approx(mutual / denominator, abs=1e-9)


@given(probabilities((3, 2, 4)))
def test_chain_rule(table: Vector) -> None:
    joint_bits = float(d.joint_entropy(table))
    first = float(d.entropy(table.sum(axis=(1, 2))))
    second = float(d.conditional_entropy(table.sum(axis=2), given=0))
    pairs = float(d.conditional_entropy(table.reshape(6, 4), given=0))
    assert first + second + pairs == pytest.approx(joint_bits, abs=1e-12)
    assert first + float(d.conditional_entropy(table, given=0)) == pytest.approx(joint_bits, abs=1e-12)


@given(probabilities(5), probabilities(5), probabilities(5))
def test_root_of_jensen_shannon_is_a_metric(p: Vector, q: Vector, r: Vector) -> None:
    def jsd(a: Vector, b: Vector) -> float:
        return float(d.jensen_shannon_distance(a, b))

    assert jsd(p, p) == pytest.approx(0, abs=1e-7)
    assert jsd(p, q) == pytest.approx(jsd(q, p), abs=1e-15)
    assert 0 <= jsd(p, q) <= 1
    assert jsd(p, r) <= jsd(p, q) + jsd(q, r) + 1e-7


@given(probabilities((3, 3, 3)))
def test_variation_of_information_is_a_metric(table: Vector) -> None:
    def variation(rest: int) -> float:
        return float(d.variation_of_information(table.sum(axis=rest)))

    assert variation(1) <= variation(2) + variation(0) + 1e-12
    assert variation(2) == pytest.approx(float(d.variation_of_information(table.sum(axis=2).T)), abs=1e-12)
    assert float(d.variation_of_information(np.diag(table.sum(axis=(1, 2))))) == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("row", [[1.0, 0.0], [1 / 6, 4 / 6, 1 / 6], [1 / 7] * 7])
def test_constant_variables(row: list[float]) -> None:
    """Also where the probabilities of a certain event sum to 1 - 1e-16."""
    q = d.normalised_mutual_information([row, [0.0] * len(row)])
    assert math.isnan(float(q)) and "0/0" in q.notes[0]


@pytest.mark.parametrize(
    ("p", "found"),
    [
        ([0.5, 0.6], "a sum of 1.1"),
        ([0.5, 0.5 - 2e-9], "a sum of"),
        ([1.5, -0.5], "the probability -0.5"),
        ([0.5, math.nan], "NaN"),
        ([math.inf, 0.5], "a sum of inf"),
        ([], "shape"),
        (0.5, "shape"),
        (["a"], "no array of numbers"),
    ],
)
def test_invalid_distributions_are_refused(p: object, found: str) -> None:
    with pytest.raises(InvalidArgument, match=found):
        d.entropy(p)
    with pytest.raises(InvalidArgument, match=found):
        d.jensen_shannon_distance([0.5, 0.5], p)


def test_invalid_arguments_are_refused() -> None:
    assert float(d.entropy([0.5, 0.5 - 5e-10])) == pytest.approx(1, abs=1e-8)
    with pytest.raises(InvalidArgument, match="1 variable; expected 2"):
        d.mutual_information([0.5, 0.5])
    with pytest.raises(InvalidArgument, match="1 variable; expected 2"):
        d.conditional_entropy([0.5, 0.5], 0)
    with pytest.raises(InvalidArgument, match="given: found 2; expected 0 to 1"):
        d.conditional_entropy(COVER_THOMAS, 2)

"""Every implementation of each information quantity, compared with dit, scipy and scikit-learn to 1e-12."""

from __future__ import annotations

import math
from collections.abc import Callable

import dit
import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import stats
from sklearn import metrics

from limits_makers import context_entropy
from touchfield.measure import information as info
from touchfield.measure.counts import Counts, SymbolCounter
from touchfield.measure.estimators import entropy_bits, estimate_bits
from touchfield.measure.field_count import field_counts, field_entropy
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.quantity import Quantity
from touchfield.medium import Grid

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")

Symbols = NDArray[np.int64]
Floats = NDArray[np.float64]
Road = Callable[[Symbols, Symbols], float | Quantity]
KX, KY = 5, 3


def symbols(n: int, count: int) -> st.SearchStrategy[Symbols]:
    return arrays(np.int64, n, elements=st.integers(0, count - 1))


pairs = st.integers(1, 40).flatmap(lambda n: st.tuples(symbols(n, KX), symbols(n, KY)))


def table_of(x: Symbols, y: Symbols) -> Floats:
    """Relative frequency of each pair."""
    return np.bincount(KY * x + y, minlength=KX * KY).reshape(KX, KY) / len(x)


def distribution_of(table: Floats) -> dit.Distribution:
    cells = [tuple(index) for index in np.argwhere(table).tolist()]
    return dit.Distribution(["".join(map(str, h)) for h in cells], [table[h] for h in cells])


def distribution_of_one(p: Floats) -> dit.Distribution:
    return dit.Distribution([str(i) for i in range(len(p))], p)


def as_field(x: Symbols, count: int) -> FieldSymbols:
    """The samples on a lattice of one row."""
    grid = Grid((len(x), 1, 1), (0.001,) * 3, (0.0,) * 3)
    return FieldSymbols.from_dense(grid, x.reshape(grid.shape), count, f"Q of {count}")


def fields_of(x: Symbols, y: Symbols) -> tuple[FieldSymbols, FieldSymbols]:
    return as_field(x, KX), as_field(y, KY)


exact = Counts.of_probabilities


def joined(x: Symbols, y: Symbols) -> Counts:
    return field_counts(*fields_of(x, y), ("voxel",), interval=False)["voxel"]


def counter_bits(x: Symbols) -> float:
    counter = SymbolCounter()
    for part in np.array_split(x, 2):
        counter.add(part[part > 0], len(part))
    return counter.voxel_bits


def frequencies(x: Symbols) -> Floats:
    return np.bincount(x, minlength=KX) / len(x)


ROADS: dict[str, dict[str, Road]] = {
    "H(X)": {
        "samples": lambda x, y: info.entropy(x, interval=False),
        "samples in parts": lambda x, y: info.entropy(Counts.of_stream(np.array_split(x, 3))),
        "counts": lambda x, y: info.entropy(Counts.of(x)),
        "probabilities": lambda x, y: info.entropy(exact(table_of(x, y)), column=0),
        "estimator": lambda x, y: estimate_bits(Counts.of(x).weights),
        "plain counts": lambda x, y: entropy_bits(np.bincount(x)),
        "counter": lambda x, y: counter_bits(x),
        "field": lambda x, y: field_entropy(as_field(x, KX), interval=False),
        "fields": lambda x, y: info.entropy(joined(x, y), column=0),
        "context": lambda x, y: context_entropy([as_field(x, KX)], "none").per_voxel,
        "with itself": lambda x, y: info.mutual_information(x, x, interval=False),
    },
    "H(X,Y)": {
        "samples": lambda x, y: info.joint_entropy(x, y, interval=False),
        "one symbol a pair": lambda x, y: info.entropy(KY * x + y, interval=False),
        "probabilities": lambda x, y: info.joint_entropy(exact(table_of(x, y))),
        "estimator": lambda x, y: estimate_bits(Counts.of(x, y).weights),
        "fields": lambda x, y: info.entropy(joined(x, y)),
    },
    "H(X|Y)": {
        "samples": lambda x, y: info.conditional_entropy(x, y, interval=False),
        "probabilities": lambda x, y: info.conditional_entropy(exact(table_of(x, y)), given=1),
        "fields": lambda x, y: info.conditional_entropy(joined(x, y)),
    },
    "H(Y|X)": {
        "samples": lambda x, y: info.conditional_entropy(y, x, interval=False),
        "probabilities": lambda x, y: info.conditional_entropy(exact(table_of(x, y)), given=0),
        "fields": lambda x, y: info.conditional_entropy(joined(x, y), given=0),
    },
    "I(X;Y)": {
        "samples": lambda x, y: info.mutual_information(x, y, interval=False),
        "probabilities": lambda x, y: info.mutual_information(exact(table_of(x, y))),
        "fields": lambda x, y: info.mutual_information(joined(x, y)),
    },
    "VI(X,Y)": {
        "samples": lambda x, y: info.variation_of_information(x, y, interval=False),
        "probabilities": lambda x, y: info.variation_of_information(exact(table_of(x, y))),
        "fields": lambda x, y: info.variation_of_information(joined(x, y)),
    },
    "JSD(X,Y)": {
        "samples": lambda x, y: float(info.jensen_shannon_distance(x, y, interval=False)) ** 2,
        "probabilities": lambda x, y: (
            float(info.jensen_shannon_distance(exact(frequencies(x)), exact(frequencies(y)))) ** 2
        ),
        "fields": lambda x, y: float(info.jensen_shannon_distance(joined(x, y))) ** 2,
    },
}


def reference_values(quantity: str, x: Symbols, y: Symbols) -> list[float]:
    """The same from dit, and from scipy or scikit-learn where available, bits."""
    law = distribution_of(table_of(x, y))
    if quantity == "H(X)":
        return [dit.shannon.entropy(law, [0]), stats.entropy(np.bincount(x), base=2)]
    if quantity == "H(X,Y)":
        return [dit.shannon.entropy(law), stats.entropy(table_of(x, y).ravel(), base=2)]
    if quantity == "H(X|Y)":
        return [dit.shannon.conditional_entropy(law, [0], [1])]
    if quantity == "H(Y|X)":
        return [dit.shannon.conditional_entropy(law, [1], [0])]
    if quantity == "I(X;Y)":
        return [dit.shannon.mutual_information(law, [0], [1]), metrics.mutual_info_score(x, y) / math.log(2)]
    if quantity == "VI(X,Y)":
        return [dit.multivariate.residual_entropy(law)]
    return [
        dit.divergences.jensen_shannon_divergence(
            [distribution_of_one(frequencies(x)), distribution_of_one(frequencies(y))]
        )
    ]


@pytest.mark.parametrize("quantity", ROADS)
@given(samples=pairs)
def test_all_implementations_agree_with_the_reference(
    quantity: str, samples: tuple[Symbols, Symbols]
) -> None:
    found = {name: float(road(*samples)) for name, road in ROADS[quantity].items()}
    for expected in reference_values(quantity, *samples):
        assert found == pytest.approx(dict.fromkeys(found, expected), abs=1e-12, rel=0)


@given(samples=pairs)
def test_normalised_information_agrees_with_the_reference(samples: tuple[Symbols, Symbols]) -> None:
    x, y = samples
    found = [
        float(info.normalised_mutual_information(x, y, interval=False)),
        float(info.normalised_mutual_information(joined(x, y))),
    ]
    law = distribution_of(table_of(x, y))
    h_x, h_y = (dit.shannon.entropy(law, rvs) for rvs in ([0], [1]))
    denominator = math.sqrt(max(0.0, h_x * h_y))
    if denominator < 1e-6:  # no variation except rounding
        assert all(math.isnan(f) for f in found)
        return
    found.append(float(info.normalised_mutual_information(exact(table_of(x, y)))))
    expected = dit.shannon.mutual_information(law, [0], [1]) / denominator
    assert found == pytest.approx([expected] * 3, abs=1e-12, rel=0)
    if min(h_x, h_y) > 1e-9:  # scikit-learn gives 0 or 1, depending on the kind, if one variable is constant
        score = metrics.normalized_mutual_info_score(x, y, average_method="geometric")
        assert found == pytest.approx([score] * 3, abs=1e-12, rel=0)


@given(samples=pairs)
def test_conditional_entropy_of_a_sequence_agrees_with_the_reference(
    samples: tuple[Symbols, Symbols],
) -> None:
    """H(S'|S), with zero before the first, and the entropy of a field given the previous frame."""
    x, y = samples
    before = np.concatenate([[0], x[:-1]])
    pair = np.bincount(KX * x + before, minlength=KX * KX).reshape(KX, KX) / len(x)
    rate = dit.shannon.conditional_entropy(distribution_of(pair), [0], [1])
    assert float(context_entropy([as_field(x, KX)], "previous").per_voxel) == pytest.approx(
        rate, abs=1e-12, rel=0
    )
    frames = [as_field(y, KX), as_field(x, KX)]
    now, past = np.concatenate([y, x]), np.concatenate([0 * y, y])
    pair = np.bincount(KX * now + past, minlength=KX * KX).reshape(KX, KX) / len(now)
    rate = dit.shannon.conditional_entropy(distribution_of(pair), [0], [1])
    found = context_entropy(frames, "none", previous_frame=True).per_voxel
    assert float(found) == pytest.approx(rate, abs=1e-12, rel=0)


weights = st.one_of(st.just(0.0), st.floats(1e-6, 1))
tables = (
    arrays(np.float64, (3, 2, 3), elements=weights).filter(lambda w: w.sum() > 0).map(lambda w: w / w.sum())
)


@given(tables)
def test_three_variables_agree_with_the_reference(table: Floats) -> None:
    distribution = distribution_of(table)
    tolerance = {"abs": 1e-12, "rel": 0}
    assert float(info.joint_entropy(exact(table))) == pytest.approx(
        dit.shannon.entropy(distribution), **tolerance
    )
    for axis in range(3):
        expected = dit.shannon.conditional_entropy(distribution, [a for a in range(3) if a != axis], [axis])
        assert float(info.conditional_entropy(exact(table), given=axis)) == pytest.approx(
            expected, **tolerance
        )

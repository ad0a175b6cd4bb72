"""Information measures of symbol arrays, compared with analytic values, scipy and scikit-learn."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import stats
from scipy.spatial import distance
from sklearn import metrics

from touchfield.errors import InvalidArgument
from touchfield.measure import information as info
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import ESTIMATORS
from touchfield.measure.quantity import FewSamplesWarning, Interval, Quantity

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")
NATS = math.log(2)
PLAIN: dict[str, Any] = {"interval": False}
TWO = (
    info.joint_entropy,
    info.conditional_entropy,
    info.mutual_information,
    info.variation_of_information,
    info.normalised_mutual_information,
    info.jensen_shannon_distance,
)
Symbols = NDArray[np.int64]


def symbols(n: int, k: int = 5) -> st.SearchStrategy[Symbols]:
    return arrays(np.int64, n, elements=st.integers(-k, k))


def cover_thomas(times: int = 10) -> tuple[Symbols, Symbols]:
    """Samples with the frequencies of example 2.2.1 of Elements of Information Theory."""
    table = np.array([[4, 2, 1, 1], [2, 4, 1, 1], [2, 2, 2, 2], [8, 0, 0, 0]]).T * times
    x, y = np.indices(table.shape)
    return np.repeat(x.ravel(), table.ravel()), np.repeat(y.ravel(), table.ravel())


# -- values ------------------------------------------------------------------------------------------------


def test_values_of_the_literature() -> None:
    x, y = cover_thomas()
    tolerance = {"abs": 1e-12}
    assert float(info.entropy(x)) == pytest.approx(1.75, **tolerance)
    assert float(info.entropy(y)) == pytest.approx(2, **tolerance)
    assert float(info.joint_entropy(x, y)) == pytest.approx(3.375, **tolerance)
    assert float(info.mutual_information(x, y)) == pytest.approx(0.375, **tolerance)
    assert float(info.conditional_entropy(x, y)) == pytest.approx(1.375, **tolerance)
    assert float(info.conditional_entropy(y, x)) == pytest.approx(1.625, **tolerance)
    assert float(info.variation_of_information(x, y)) == pytest.approx(3, **tolerance)
    assert float(info.normalised_mutual_information(x, y)) == pytest.approx(
        0.375 / math.sqrt(3.5), **tolerance
    )
    coin, biased = np.arange(10) % 2, np.arange(20) < 2
    assert float(info.entropy(biased)) == pytest.approx(0.468996, abs=1e-6)
    assert float(info.jensen_shannon_distance(coin, biased)) ** 2 == pytest.approx(0.146793, abs=1e-6)


def test_markov_chain() -> None:
    """A chain with a = 0.05, b = 0.2: the marginal, and H(S'|S) as its rate."""
    rng = np.random.default_rng(0)
    stays = [rng.geometric(p, 100_000) for p in (0.05, 0.2)]
    chain = np.repeat(np.arange(200_000) % 2, np.stack(stays, axis=1).ravel()).astype(np.int8)
    h, rate = info.entropy(chain), info.conditional_entropy(chain[1:], chain[:-1])
    assert float(h) == pytest.approx(0.721928, abs=2e-3) and float(rate) == pytest.approx(0.373504, abs=2e-3)
    for q, truth in ((h, 0.721928), (rate, 0.373504)):
        assert q.interval is not None and q.interval.low < truth < q.interval.high
        assert q.interval.high - q.interval.low < 0.02


@given(st.integers(1, 60).flatmap(lambda n: st.tuples(symbols(n), symbols(n, 2))))
def test_agrees_with_scipy_and_scikit_learn(samples: tuple[Symbols, Symbols]) -> None:
    x, y = samples
    tolerance = {"abs": 1e-12, "rel": 0}
    counts = [np.unique(s, return_counts=True)[1] for s in samples]
    assert float(info.entropy(x, **PLAIN)) == pytest.approx(stats.entropy(counts[0], base=2), **tolerance)
    assert float(info.mutual_information(x, y, **PLAIN)) == pytest.approx(
        metrics.mutual_info_score(x, y) / NATS, **tolerance
    )
    q = info.normalised_mutual_information(x, y, **PLAIN)
    if math.isnan(float(q)):
        assert len(counts[0]) == 1 or len(counts[1]) == 1
        assert any("0/0" in n for n in q.notes) and q.interval is None
    else:
        expected = metrics.normalized_mutual_info_score(x, y, average_method="geometric")
        assert float(q) == pytest.approx(expected, abs=1e-11)


@given(st.integers(1, 40).flatmap(symbols), st.integers(1, 40).flatmap(symbols))
def test_distance_of_samples_of_any_two_sizes(x: Symbols, y: Symbols) -> None:
    p, q = (np.bincount(s + 5, minlength=11) / len(s) for s in (x, y))
    found = info.jensen_shannon_distance(x, y, **PLAIN)
    assert float(found) ** 2 == pytest.approx(distance.jensenshannon(p, q, 2) ** 2, abs=1e-12)
    exact = info.jensen_shannon_distance(Counts.of_probabilities(p), Counts.of_probabilities(q))
    assert float(found) == pytest.approx(float(exact), abs=1e-7)
    assert found.samples == len(x) + len(y) and found.symbols == len(set(x.tolist()) | set(y.tolist()))
    assert float(info.jensen_shannon_distance(Counts.of(x), Counts.of(y), **PLAIN)) == float(found)


def test_distance_of_counts_in_other_blocks_has_no_interval() -> None:
    found = info.jensen_shannon_distance(*(Counts.of(np.arange(400) % 4, blocks=n) for n in (8, 9)))
    assert (
        found.interval is None and "no interval: blocks of one do not match those of the other" in found.notes
    )


@given(st.integers(1, 40).flatmap(lambda n: st.tuples(symbols(n, 3), symbols(n, 3), symbols(n, 1))))
def test_identities_and_metrics(samples: tuple[Symbols, Symbols, Symbols]) -> None:
    x, y, z = samples
    h = {name: float(info.joint_entropy(*s, **PLAIN)) for name, s in {"xy": (x, y), "xyz": (x, y, z)}.items()}
    assert float(info.entropy(y, **PLAIN)) + float(info.conditional_entropy(x, y, **PLAIN)) == pytest.approx(
        h["xy"], abs=1e-12
    )
    assert h["xyz"] >= h["xy"] - 1e-12
    assert 0 <= float(info.conditional_entropy(x, y, **PLAIN)) <= float(info.entropy(x, **PLAIN)) + 1e-12
    for metric, slack in ((info.variation_of_information, 1e-12), (info.jensen_shannon_distance, 1e-7)):
        assert (
            float(metric(x, z, **PLAIN))
            <= float(metric(x, y, **PLAIN)) + float(metric(y, z, **PLAIN)) + slack
        )
        assert float(metric(x, y, **PLAIN)) == pytest.approx(float(metric(y, x, **PLAIN)), abs=1e-12)
        assert float(metric(x, x, **PLAIN)) == pytest.approx(0, abs=slack)


@given(
    st.integers(1, 40).flatmap(lambda n: st.tuples(symbols(n, 3), symbols(n, 3))),
    st.sampled_from([*ESTIMATORS]),
)
def test_combinations_use_one_estimator(samples: tuple[Symbols, Symbols], estimator: str) -> None:
    x, y = samples
    options: dict[str, Any] = {"estimator": estimator, "interval": False}
    hx, hy = float(info.entropy(x, **options)), float(info.entropy(y, **options))
    both = float(info.joint_entropy(x, y, **options))
    assert float(info.mutual_information(x, y, **options)) == pytest.approx(hx + hy - both, abs=1e-12)
    assert float(info.variation_of_information(x, y, **options)) == pytest.approx(
        2 * both - hx - hy, abs=1e-12
    )
    assert float(info.conditional_entropy(x, y, **options)) == pytest.approx(both - hy, abs=1e-12)
    q = info.mutual_information(x, y, **options)
    assert any("negative" in n for n in q.notes) == (float(q) < 0) and q.estimator == estimator


def test_negative_estimate_is_noted_and_not_clipped() -> None:
    x, y = np.tile([0, 1], 20), np.repeat([0, 1], 20)  # exactly independent
    q = info.mutual_information(x, y, estimator="miller-madow")
    assert float(q) == pytest.approx(-1 / (80 * NATS), abs=1e-12)
    assert any("negative" in n and "miller-madow" in n for n in q.notes)
    assert q.interval is None and "no interval" in q.notes[-1]  # every block is exactly independent
    same = info.normalised_mutual_information([0, 1] * 20, [1, 0] * 20, estimator="miller-madow")
    assert float(same) == pytest.approx(1)
    large = info.normalised_mutual_information(x * 0 + np.arange(40) % 3, np.arange(40) % 3)
    assert float(large) == 1 and large.notes == ("no interval: no block differs from another",)


def test_bias_corrected_estimates_have_a_centred_interval() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        x, y = rng.integers(0, 8, (2, 4096))  # independent: I = 0
        q = info.mutual_information(x, y, estimator="miller-madow")
        assert q.interval is not None
        assert q.interval.low <= float(q) <= q.interval.high
        assert q.interval.low <= 0 <= q.interval.high and q.interval.high - q.interval.low > 1e-3
    wide = info.mutual_information(*rng.integers(0, 100, (2, 5000)), estimator="chao-wang-jost", blocks=20)
    assert wide.interval is not None and wide.interval.low <= 0 < wide.interval.high
    plain = info.mutual_information(x, y)
    assert plain.interval is not None and plain.interval.low <= q.value <= plain.interval.high


@pytest.mark.parametrize("estimator", ESTIMATORS)
def test_interval_is_limited_by_the_alphabet(estimator: str) -> None:
    x = np.random.default_rng(4).choice(5, 500, p=[0.21, 0.21, 0.2, 0.19, 0.19])
    q = info.entropy(replace(Counts.of(x, blocks=64), alphabet=5), estimator=estimator)
    assert q.interval is not None and q.interval.low < q.interval.high == math.log2(5)
    unlimited = info.entropy(x, estimator=estimator).interval
    assert unlimited is not None and unlimited.high > math.log2(5)  # if the alphabet is unknown


def test_no_value_is_minus_zero() -> None:
    x = np.zeros(200, np.int64)
    for estimator in ESTIMATORS:
        for q in (info.entropy(x, estimator=estimator), *(two(x, x, estimator=estimator) for two in TWO[:4])):
            assert str(q).startswith(f"{q.name} = 0 bit/sample (")
            assert q.interval is None and q.dependence is None and "no interval" in q.notes[-1]


def test_any_type_and_shape() -> None:
    rng = np.random.default_rng(1)
    x = rng.integers(0, 6, (30, 20, 5))
    value = float(info.entropy(x))
    for kind in ("i1", ">i2", "u4", "i8"):
        assert float(info.entropy(x.astype(kind))) == value
    assert float(info.mutual_information(x > 2, x.astype(">u2"))) == pytest.approx(float(info.entropy(x > 2)))


# -- what is said of a value -------------------------------------------------------------------------------


def test_metadata_of_a_quantity() -> None:
    x, y = cover_thomas()
    q = info.mutual_information(x, y)
    assert (q.name, q.unit, q.weighting, q.quantiser) == ("I(X;Y)", "bit/sample", "samples", "as given")
    assert (q.samples, q.symbols, q.estimator, q.notes) == (320, 13, "plug-in", ())
    assert q.interval is not None and q.interval.low <= float(q) <= q.interval.high
    names = [two(x, y, interval=False) for two in TWO]
    assert [q.name for q in names] == [
        "H(X,Y)",
        "H(X|Y)",
        "I(X;Y)",
        "VI(X,Y)",
        "NMI_sqrt(X;Y)",
        "sqrt(JSD(X,Y))",
    ]
    assert [q.unit for q in names] == ["bit/sample"] * 4 + ["1", "sqrt(bit)"]
    assert all(q.interval is None and not q.notes for q in names)


@pytest.mark.parametrize("two", TWO)
def test_intervals_contain_the_value_and_are_reproducible(two: Callable[..., Quantity]) -> None:
    rng = np.random.default_rng(2)
    x = rng.integers(0, 4, 2000)
    y = (x + (rng.random(2000) < 0.3)) % 5
    q = two(x, y, blocks=20)
    assert q.interval is not None and "20 blocks" in q.interval.method
    assert q.interval.low < float(q) < q.interval.high
    assert two(x, y, blocks=20) == q
    repeated = two(np.repeat(x, 50), np.repeat(y, 50), blocks=20)  # 100,000 samples without more information
    assert repeated.interval is not None
    width, other = (i.high - i.low for i in (q.interval, repeated.interval))
    assert other == pytest.approx(width, rel=0.05)


def test_few_samples_give_a_warning() -> None:
    rng = np.random.default_rng(3)
    x = rng.integers(0, 30, 299) + np.arange(299) * 0
    x[:30] = np.arange(30)
    with pytest.warns(FewSamplesWarning, match="299 for 30 symbols"):
        q = info.entropy(x)
    assert any("few samples" in n for n in q.notes)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert not info.entropy(np.append(x, 0)).notes
    with pytest.warns(FewSamplesWarning):
        info.joint_entropy(np.arange(300) % 30, np.arange(300) % 7)
    with pytest.warns(FewSamplesWarning, match="90 for 10 symbols"):
        info.jensen_shannon_distance(np.arange(90) % 10, np.arange(9000) % 10)


def test_quantities_without_an_interval(monkeypatch: pytest.MonkeyPatch) -> None:
    x = np.arange(400) % 4
    q = info.entropy(Counts.of_stream([x[:200], x[200:]]))
    assert float(q) == 2 and q.interval is None and "order" in q.notes[0]
    assert info.entropy(Counts.of(x)).interval is None
    few = info.entropy(x[:7])
    assert few.interval is None and "fewer than 8 blocks" in few.notes[0]
    assert info.jensen_shannon_distance(x, x[:7]).interval is None
    assert info.jensen_shannon_distance(x, Counts.of(x)).interval is None
    uneven = info.jensen_shannon_distance(x, x[:12])
    assert uneven.dependence is not None and uneven.dependence.blocks == 12
    monkeypatch.setattr("touchfield.measure.counts.MAX_BLOCK_CELLS", 4 * 7)
    assert info.entropy(x).interval is None
    assert info.mutual_information(x, x).interval is None


def test_one_block_that_varies_has_no_interval() -> None:
    x = np.zeros(1000, np.int64)
    x[900:] = np.arange(100) % 2
    q = info.entropy(x, blocks=10)
    assert q.interval is None and "10 blocks count as 3." in q.notes[-1]
    assert q.dependence is not None and q.dependence.effective_blocks < 4
    same = info.normalised_mutual_information(x, x, blocks=10)  # 1 without a doubt
    assert float(same) == pytest.approx(1) and same.interval is None and same.dependence is None


# -- refusals ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("two", TWO)
def test_invalid_arguments_are_refused(two: Callable[..., Quantity]) -> None:
    x = np.arange(100) % 4
    for bad in (x / 2, np.full(100, np.nan)):
        with pytest.raises(InvalidArgument, match="Quantise them first"):
            two(x, bad)
        with pytest.raises(InvalidArgument, match="Quantise them first"):
            info.entropy(bad)
    if two is not info.jensen_shannon_distance:
        with pytest.raises(InvalidArgument, match="one shape"):
            two(x, x[:50])
    for nothing in ([], np.zeros((0, 3), np.int8)):
        with pytest.raises(InvalidArgument, match="no sample"):
            two(nothing, nothing)
        with pytest.raises(InvalidArgument, match="no sample"):
            info.entropy(nothing)
    with pytest.raises(InvalidArgument, match="blocks: found 7"):
        two(x, x, blocks=7)
    if two is not info.jensen_shannon_distance:
        with pytest.raises(InvalidArgument, match="estimator: found 'best'; expected one of plug-in"):
            two(x, x, estimator="best")


def test_other_invalid_arguments_are_refused() -> None:
    x = np.arange(100) % 4
    for ragged in ([[1, 2], [3]], [1, [2, 3]]):
        with pytest.raises(InvalidArgument, match=r"samples.*: found lists that differ in length"):
            info.entropy(ragged)
        for two in TWO:
            with pytest.raises(InvalidArgument, match=r"samples.*: found lists that differ in length"):
                two(ragged, ragged)
    with pytest.raises(InvalidArgument, match="1 variable; expected 2"):
        info.mutual_information(x)
    with pytest.raises(InvalidArgument, match="several Counts"):
        info.mutual_information(Counts.of(x), Counts.of(x))
    with pytest.raises(InvalidArgument, match="no array"):
        info.joint_entropy()
    with pytest.raises(InvalidArgument, match="blocks"):
        info.entropy(x, blocks=0)
    assert Counts.of(x, x).total == 100


def test_conversion_scales_the_interval_too() -> None:
    bits = Quantity("H(S)", 2.0, "bit/sample", "a Q", "voxel", interval=Interval(1.5, 2.75, 0.95, "by hand"))
    summary = bits.times(64, "bit/frame", "H(W)").summary()
    assert [summary[name] for name in ("name", "value", "unit", "quantiser")] == [
        "H(W)",
        128.0,
        "bit/frame",
        "a Q",
    ]
    assert summary["interval"] == {
        "low": 96.0, "high": 176.0, "level": 0.95, "method": "by hand", "population": Interval.population,
    }  # fmt: skip
    assert str(bits) == "H(S) = 2 [1.5, 2.75] bit/sample (Q a Q, mu voxel)"


# -- names and notes
# ------------------------------------------------------------------------------------------------


def test_names_of_quantities_of_several_variables() -> None:
    x, y, z = np.random.default_rng(0).integers(0, 3, (3, 400))
    names = [
        info.entropy(x, y, z, interval=False),
        info.entropy(x, y, z, column=2, interval=False),
        info.conditional_entropy(x, y, z, interval=False),
        info.conditional_entropy(x, y, z, given=0, interval=False),
        info.conditional_entropy(x, y, given=0, interval=False),
        info.entropy(x, y, column=1, interval=False),
        info.entropy(x, interval=False),
    ]
    expected = ["H(X1,X2,X3)", "H(X3)", "H(X1,X3|X2)", "H(X2,X3|X1)", "H(Y|X)", "H(Y)", "H(X)"]
    assert [q.name for q in names] == expected
    assert [(q.samples, q.symbols) for q in names] == [(400, k) for k in (27, 3, 27, 27, 9, 3, 3)]
    assert float(names[3]) == pytest.approx(
        float(names[0]) - float(info.entropy(x, interval=False)), abs=1e-12
    )
    for wrong in (-1, 2):
        with pytest.raises(InvalidArgument, match=f"given: found {wrong}; expected 0 to 1"):
            info.conditional_entropy(x, y, given=wrong)
    with pytest.raises(InvalidArgument, match="samples: found 1 variable; expected 2"):
        info.mutual_information(x)


@pytest.mark.parametrize(("samples", "is_warned"), [(29, True), (30, False)])
def test_warning_of_few_samples_states_both_numbers(samples: int, is_warned: bool) -> None:
    few_samples, many_samples = np.arange(samples) % 3, np.arange(300) % 3
    note = f"few samples: {samples} for 3 symbols, fewer than 10 to each"
    for name, make in (
        ("H(X)", lambda: info.entropy(few_samples, interval=False)),
        ("sqrt(JSD(X,Y))", lambda: info.jensen_shannon_distance(few_samples, many_samples, interval=False)),
        ("sqrt(JSD(X,Y))", lambda: info.jensen_shannon_distance(many_samples, few_samples, interval=False)),
    ):
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            found = make()
        assert [str(warning.message) for warning in caught] == ([f"{name}: {note}"] if is_warned else [])
        assert [n for n in found.notes if n.startswith("few")] == ([note] if is_warned else [])
    assert not info.entropy(Counts.of_probabilities([0.5, 0.5])).notes, (
        "of what is known no sample is missing"
    )


def test_counts_of_fewer_blocks_than_8_are_refused() -> None:
    blocks = np.array([[20, 30 + n] for n in range(7)])
    with pytest.raises(InvalidArgument, match="7 blocks; expected at least 8"):
        info.entropy(Counts(np.array([[0], [1]]), blocks.sum(axis=0), blocks))


def test_note_of_impossible_estimates() -> None:
    rng = np.random.default_rng(1)
    x, y = rng.permutation(np.arange(4000) % 4), np.arange(4000) // 1000
    found = [
        info.mutual_information(rng.permutation(x), y, estimator="miller-madow", interval=False)
        for _ in "abcdefgh"
    ]
    negative = [estimate for estimate in found if float(estimate) < 0]
    assert negative and len(negative) < len(found)
    note = "negative, which no true value is: the bias correction of miller-madow is larger"
    assert all((note in estimate.notes) == (float(estimate) < 0) for estimate in found)
    high = info.normalised_mutual_information(x, x, estimator="miller-madow", interval=False)
    assert float(high) == pytest.approx(1, abs=1e-9) and not high.notes

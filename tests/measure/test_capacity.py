"""Workspace capacity, WMR and HIL compared with enumerated frames and the numbers of the theory."""

from __future__ import annotations

import itertools
import json
import math
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, strategies as st
from numpy.typing import NDArray
from scipy import ndimage, stats

from touchfield.errors import InvalidArgument
from touchfield.measure.capacity import Capacity, capacity, codomain_bits
from touchfield.measure.quantity import Interval, Quantity

bits = st.floats(0, 1e12, allow_subnormal=False)
fractions = st.floats(0, 1)


def entropy(value: float, low: float | None = None, high: float | None = None, **more: object) -> Quantity:
    spread = None if low is None or high is None else Interval(low, high, 0.95, "block bootstrap")
    return Quantity("H", value, "bit/frame", interval=spread, **more)  # type: ignore[arg-type]


def joint_bits(shape: tuple[int, int], mapping: Callable[[NDArray[np.int64]], NDArray[np.int64]]) -> float:
    """H(M(W)) of all equally likely binary images of a shape: the joint entropy of the mapped images."""
    frames = itertools.product((0, 1), repeat=math.prod(shape))
    found = Counter(mapping(np.reshape(f, shape)).tobytes() for f in frames)
    return float(stats.entropy(list(found.values()), base=2))


def periodic_box(image: NDArray[np.int64]) -> NDArray[np.int64]:
    return ndimage.convolve(image, np.ones((3, 3), int), mode="wrap")


def valid_box(image: NDArray[np.int64]) -> NDArray[np.int64]:
    """3 x 3 sums of boxes inside a 4 x 4 image, 2 x 2 of them."""
    return sum(image[i : i + 2, j : j + 2] for i in range(3) for j in range(3))  # type: ignore[return-value]


# -- numbers of the theory ---------------------------------------------------------------------------------


def test_box_sum_of_a_periodic_image() -> None:
    rendered = joint_bits((3, 3), periodic_box)
    assert rendered == pytest.approx(2.629928, abs=5e-7)
    found = capacity(entropy(9.0), entropy(rendered), codomain_bits(9, 10))
    assert found.wmr.value == pytest.approx(0.292214, abs=5e-7)
    assert found.hil.value == pytest.approx(1 - 0.292214, abs=5e-7)
    assert found.notes == ()


def test_box_sum_within_an_image() -> None:
    rendered = joint_bits((4, 4), valid_box)
    assert rendered == pytest.approx(8.786455, abs=5e-7)
    found = capacity(entropy(16.0), entropy(rendered), codomain_bits(4, 10))
    assert found.wmr.value == pytest.approx(8.786455 / 16, abs=5e-8)


@pytest.mark.parametrize("per_sample", [1.2, 2.3, 18.0])
def test_omni_alone_renders_one_sample_in_125(per_sample: float) -> None:
    sample_count, device = 10**12, 8 * 10**9
    reference = Quantity("H(S)", per_sample, "bit/sample").times(sample_count, "bit/frame", "H(W)")
    rendered = Quantity("H(S)", per_sample, "bit/sample").times(device, "bit/frame", "H(M(W))")
    found = capacity(reference, rendered, codomain_bits(device, 1 << 18))
    assert found.wmr.value == pytest.approx(1 / 125, rel=1e-12)
    assert found.hil.value == pytest.approx(0.992, rel=1e-12)


# -- laws --------------------------------------------------------------------------------------------------


@given(bits, bits, bits)
def test_ratios_sum_to_one(h: float, d: float, codomain: float) -> None:
    assume(h > 1e-300)
    c = capacity(entropy(h), entropy(min(d, codomain)), codomain)
    assert c.wmr.value + c.hil.value == pytest.approx(1, abs=1e-15)
    assert 0 <= c.wmr.value <= 1 and 0 <= c.hil.value <= 1
    assert c.capacity.value == min(h, d, codomain)
    assert (c.capacity.unit, c.wmr.unit, c.hil.unit) == ("bit/frame", "1", "1")


@given(st.tuples(bits, bits, fractions), st.tuples(bits, bits, fractions), bits, fractions, fractions)
def test_interval_arithmetic_contains_all_pairs_of_entropies(
    h: tuple[float, float, float], d: tuple[float, float, float], codomain: float, at_h: float, at_d: float
) -> None:
    quantities, inside = [], []
    for (a, b, fraction), position, limit in ((h, at_h, math.inf), (d, at_d, codomain)):
        low, high = sorted((min(a, limit), min(b, limit)))
        point = min(high, low + fraction * (high - low))
        quantities.append(entropy(point, low, high))
        inside.append(min(high, low + position * (high - low)))
    assume(quantities[0].value > 1e-300 and inside[0] > 1e-300)
    found = capacity(*quantities, codomain)
    other = capacity(entropy(inside[0]), entropy(inside[1]), codomain)
    for name in ("capacity", "wmr", "hil"):
        spread = getattr(found, name).interval
        if spread is None:  # the ratio is the same everywhere
            assert name != "capacity" and found.wmr.value == pytest.approx(other.wmr.value)
            assert "no interval" in found.wmr.notes[-1]
            continue
        slack = 1e-12 * max(1.0, abs(spread.high))
        for c in (found, other):
            assert spread.low - slack <= getattr(c, name).value <= spread.high + slack
        assert spread.level == pytest.approx(0.90) and "interval arithmetic" in spread.method


def test_one_interval_has_its_level_and_none_gives_none() -> None:
    plain = capacity(entropy(8), entropy(4), 6)
    assert plain.wmr.interval is None and plain.hil.interval is None and plain.capacity.interval is None
    found = capacity(entropy(8, 5, 10), entropy(4), 6).wmr.interval
    assert found is not None
    assert (found.low, found.high, found.level) == (0.4, 0.8, pytest.approx(0.95))


def test_interval_is_widened_to_its_estimate() -> None:
    spread = capacity(entropy(8, 9, 10), entropy(4, -1, 3), 6).wmr.interval
    assert spread is not None
    assert (spread.low, spread.high) == (0.0, 0.5)


# -- guards ------------------------------------------------------------------------------------------------


def test_upsampling_is_limited_and_noted() -> None:
    found = capacity(entropy(10), entropy(12), 40)
    assert (found.capacity.value, found.wmr.value, found.hil.value) == (10, 1, 0)
    assert any("min() of eq. 1 acted" in n for n in found.notes)
    assert not capacity(entropy(10), entropy(10), 40).notes


def test_estimate_is_limited_to_the_codomain() -> None:
    found = capacity(entropy(10, estimator="chao-wang-jost"), entropy(7, estimator="chao-wang-jost"), 6)
    assert found.capacity.value == 6 and any("overshoots" in n for n in found.notes)
    with pytest.raises(InvalidArgument, match=r"codomain_bits: found 6, below H\(M\(W\)\) = 7"):
        capacity(entropy(10), entropy(7), 6)
    with pytest.raises(InvalidArgument, match="codomain_bits"):
        capacity(entropy(10, estimator="exact"), entropy(7, estimator="exact"), 6)
    cut = capacity(entropy(5, estimator="chao-wang-jost"), entropy(7, estimator="chao-wang-jost"), 4)
    assert cut.capacity.value == 4 and not any("min() of eq. 1" in n for n in cut.notes)


def test_a_medium_without_information_has_no_ratio() -> None:
    for rendered in (0.0, 3.0):
        found = capacity(entropy(0.0), entropy(rendered), 8)
        assert found.capacity.value == 0
        assert math.isnan(found.wmr.value) and math.isnan(found.hil.value)
        assert any("H(W) = 0" in n for n in found.wmr.notes)
        assert found.summary()["hil"]["value"] is None


def test_device_without_information() -> None:
    found = capacity(entropy(5), entropy(0), codomain_bits(100, 1))
    assert (found.wmr.value, found.hil.value) == (0, 1)


def test_metadata_of_the_ratios() -> None:
    a = entropy(5, quantiser="distinct", weighting="voxel", estimator="chao-wang-jost")
    b = entropy(3, quantiser="weber:0.1", weighting="voxel", samples=40, symbols=7)
    found = capacity(a, b, 8)
    assert found.wmr.quantiser == "W: distinct; M(W): weber:0.1"
    assert found.wmr.estimator == "W: chao-wang-jost; M(W): plug-in"
    assert (found.hil.weighting, found.hil.samples, found.hil.symbols) == ("voxel", 40, 7)
    assert any("two estimators" in n for n in found.notes)
    assert capacity(b, b, 8).wmr.quantiser == "weber:0.1"


def test_the_summary_is_json() -> None:
    table = json.loads(json.dumps(capacity(entropy(5, 4, 6), entropy(3), 8).summary()))
    assert set(table) == {
        "reference", "rendered", "codomain_bits", "capacity", "wmr", "hil", "notes"
    }  # fmt: skip
    assert table["wmr"]["value"] == 0.6 and table["hil"]["interval"]["low"] == pytest.approx(0.25)


# -- bad input ---------------------------------------------------------------------------------------------


def capacity_with(**changes: object) -> Capacity:
    arguments: dict[str, object] = {"reference": entropy(5), "rendered": entropy(3), "codomain_bits": 8.0}
    return capacity(**(arguments | changes))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        (
            {"reference": Quantity("H(S)", 1.2, "bit/sample")},
            "reference: found .* bit/sample; expected .*bit/frame",
        ),
        ({"rendered": Quantity("H(S)", 1.2, "bit")}, "rendered: found .* bit; expected .*bit/frame"),
        ({"reference": entropy(-0.1)}, "reference: found H = -0.1"),
        ({"rendered": entropy(math.nan, notes=("none",))}, "rendered: found H = nan"),
        ({"reference": entropy(math.inf)}, "reference: found H = inf"),
        ({"rendered": entropy(3, weighting="object")}, "weighting object; expected samples"),
        ({"codomain_bits": -1.0}, "codomain_bits: found -1"),
        ({"codomain_bits": math.nan}, "codomain_bits: found nan"),
    ],
)
def test_invalid_arguments_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        capacity_with(**wrong)


def test_codomain() -> None:
    assert codomain_bits(1024, 2) == 1024
    assert codomain_bits(8 * 10**9, 1 << 18) == 8e9 * 18
    for samples, alphabet in ((0, 2), (4, 0), (-1, 2), (2.5, 2), (True, 2), (4, 2.5), (4, math.nan)):
        with pytest.raises(InvalidArgument, match="whole number"):
            codomain_bits(samples, alphabet)  # type: ignore[arg-type]


def test_interval_limits_are_those_of_opposite_corners() -> None:
    found = capacity(entropy(8, 5, 10), entropy(4, 3, 7), 6)
    spreads = {name: getattr(found, name).interval for name in ("capacity", "wmr", "hil")}
    assert {name: (i.low, i.high) for name, i in spreads.items()} == {
        "capacity": (3, 6), "wmr": (pytest.approx(0.3), 1), "hil": (0, pytest.approx(0.7))
    }  # fmt: skip
    method = "interval arithmetic, H(W) in [5, 10] and H(M(W)) in [3, 6]; block bootstrap"
    assert {i.method for i in spreads.values()} == {method}
    of_wmr = capacity(entropy(8, 7, 10), entropy(4, 3, 5), 6).wmr.interval
    assert of_wmr is not None and (of_wmr.low, of_wmr.high) == pytest.approx((0.3, 5 / 7))
    both = Interval(1, 9, 0.9, "a"), Interval(1, 2, 0.8, "b")
    levels = capacity(
        replace(entropy(8), interval=both[0]), replace(entropy(2), interval=both[1]), 6
    ).wmr.interval
    assert levels is not None and levels.level == pytest.approx(0.7)
    empty = capacity(entropy(0, 0, 0), entropy(0, 0, 0), 6).capacity.interval
    assert empty is not None and (empty.low, empty.high) == (0, 0)


def test_notes_of_the_limits_have_their_numbers() -> None:
    (note,) = capacity(entropy(10), entropy(12), 40).notes
    assert "H(M(W)) = 12 bit/frame is above H(W) = 10," in note
    guessed = {"estimator": "chao-wang-jost"}
    (note,) = capacity(entropy(10, **guessed), entropy(7, **guessed), 6).notes
    assert "H(M(W)) was estimated as 7 bit/frame, more than the 6 that" in note
    two = capacity(entropy(5, estimator="miller-madow"), entropy(3), 8)
    assert two.notes == ("two estimators: miller-madow for H(W), plug-in for H(M(W))",)
    assert two.hil.notes == two.capacity.notes == two.notes

"""Tests of every registered haptic filter: each of its claims is measured; information never increases.

Paper section 3.2; the laws of information are the data-processing inequality and the chain rule.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import astuple
from typing import Any

import numpy as np
import pytest

from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.filters.registry import (
    Claims,
    FieldFilter,
    apply_filters,
    field_filters,
    filter_medium,
    filter_of,
)
from touchfield.measure.estimators import entropy_bits
from touchfield.medium import ForceField, Grid, HapticMedium

TEXTS: dict[str, list[str]] = {
    "gaussian": ["1.2mm", "0.7mm"],
    "fir": ["1/2/1", "1/3/3/3/1", "-1/2/-1,normalise=false", "1/1/1"],
    "lowpass": ["pitch=4mm", "pitch=2.5mm,kernel=sinc", "pitch=9mm,cutoff=literal"],
    "shading": ["1.5mm", "1mm,smooth=direction", "1mm,smooth=amplitude"],
    "perona-malik": ["steps=4,kappa=0.5", "0.4,steps=2", "kappa=inf"],
    "multiresolution": ["3", "2"],
    "texture": ["salt-pepper:seed=1", "salt-pepper:density=0.3,rms=0.3,grain=2mm"],
}
CASES = [pytest.param(name, text, id=f"{name}-{text}") for name, texts in TEXTS.items() for text in texts]
GRID = Grid((40, 36, 33), (0.001, 0.001, 0.0012), (-0.02, 0.0, 0.01))
SMALL = Grid((24, 23, 22), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
WIDE = Grid((64, 64, 64), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))


def cases_with_claims(*claims: str) -> list[Any]:
    """The cases of filters that make all of these claims."""
    return [c for c in CASES if all(getattr(filter_and_claims(*c.values)[1], claim) for claim in claims)]


def filter_and_claims(name: str, text: str) -> tuple[FieldFilter, Claims]:
    tested = filter_of(name, text)
    return tested, tested.claims(GRID)


def blob(seed: int, grid: Grid = GRID, clear: int = 12) -> ForceField:
    """Random forces in the centre of a grid, away from its border."""
    rng = np.random.default_rng(seed)
    forces = np.zeros((*grid.shape, 3), np.float32)
    inner = tuple(slice(min(clear, n // 2 - 1), max(n - clear, n // 2 + 1)) for n in grid.shape)
    shape = forces[inner].shape
    forces[inner] = rng.normal(size=shape) * (rng.random(shape[:3]) < 0.6)[..., None]
    return ForceField.from_dense(grid, forces)


def assert_close(a: ForceField, b: ForceField, tolerance: float = 2e-5) -> None:
    x, y = a.to_dense(), b.to_dense()
    np.testing.assert_allclose(x, y, atol=tolerance * max(1e-9, float(np.abs(y).max())))


def test_every_registered_filter_is_tested() -> None:
    assert set(field_filters()) == set(TEXTS)
    for name, kind in field_filters().items():
        assert kind.name == name and kind.summary and kind.__doc__
        assert kind.parse(kind.example).example == kind.example


@pytest.mark.parametrize(("name", "text"), CASES)
def test_text_of_a_filter_round_trips(name: str, text: str) -> None:
    tested, _ = filter_and_claims(name, text)
    assert filter_of(name, tested.text) == tested


@pytest.mark.parametrize(("name", "text"), CASES)
def test_empty_field_stays_empty_and_threads_change_no_bit(
    name: str, text: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    tested, _ = filter_and_claims(name, text)
    assert tested(ForceField.empty(GRID)) == ForceField.empty(GRID)
    field = blob(1)
    monkeypatch.setenv("TOUCHFIELD_THREADS", "1")
    single_threaded = tested(field)
    monkeypatch.setenv("TOUCHFIELD_THREADS", "5")
    assert tested(field) == single_threaded and single_threaded.grid == GRID


@pytest.mark.parametrize(("name", "text"), CASES)
def test_reach(name: str, text: str) -> None:
    tested, claims = filter_and_claims(name, text)
    field = blob(2)
    index = np.array([20, 17, 16])
    forces = field.to_dense()
    forces[tuple(index)] += np.float32([0.9, -0.4, 0.7])
    changed = np.argwhere(
        (tested(field).to_dense() != tested(ForceField.from_dense(GRID, forces)).to_dense()).any(-1)
    )
    assert len(changed), "the change is seen somewhere"
    assert (np.abs(changed - index).max(axis=0) <= claims.reach).all()
    before, after = field.positions(), tested(field).positions()
    low, high = before.min(axis=0) - claims.reach, before.max(axis=0) + claims.reach
    assert ((after >= low) & (after <= high)).all()
    if claims.keeps_support:
        assert {tuple(p) for p in after.tolist()} <= {tuple(p) for p in before.tolist()}


UNEQUAL = Grid((28, 26, 23), (0.0008, 0.001, 0.0014), (-0.008, 0.0, 0.01))
SWAPPED = (1, 0, 2)
ORDERS = {"lowpass": [SWAPPED], "multiresolution": [SWAPPED], "texture": []}
"""Orders of the axes for filters that treat z differently; others take any. Texture grains depend on the
position.
"""
PERMUTED = [
    pytest.param(*case.values, order, id=f"{case.id}-{order}")
    for case in CASES
    for order in ORDERS.get(str(case.values[0]), [(1, 2, 0), SWAPPED, (0, 2, 1)])
]


@pytest.mark.parametrize(("name", "text", "order"), PERMUTED)
def test_filters_commute_with_permutations_of_the_axes(name: str, text: str, order: tuple[int, ...]) -> None:
    """Each axis uses its own spacing."""

    def permuted(field: ForceField) -> ForceField:
        shape, spacing_m, origin_m = (tuple(row[axis] for axis in order) for row in astuple(field.grid))
        dense = field.to_dense().transpose(*order, 3)[..., order]
        return ForceField.from_dense(Grid(shape, spacing_m, origin_m), np.ascontiguousarray(dense))

    tested, _ = filter_and_claims(name, text)
    field = blob(5, UNEQUAL, 5)
    assert_close(permuted(tested(field)), tested(permuted(field)), 1e-4)


@pytest.mark.parametrize(("name", "text"), cases_with_claims("linear"))
def test_linear_filters_are_linear(name: str, text: str) -> None:
    tested, _ = filter_and_claims(name, text)
    x, y = blob(3), blob(4)
    assert_close(tested(x.scaled(2.0) + y), tested(x).scaled(2.0) + tested(y))


@pytest.mark.parametrize(
    ("name", "text"), [c for c in CASES if filter_and_claims(*c.values)[1].dc_gain is not None]
)
def test_constants_have_the_declared_gain(name: str, text: str) -> None:
    tested, claims = filter_and_claims(name, text)
    reach = tested.claims(WIDE).reach
    force = np.float32([0.3, -0.8, 0.5])
    field = ForceField.from_dense(WIDE, np.tile(force, (*WIDE.shape, 1)))
    inner = tuple(slice(r, n - r) for r, n in zip(reach, WIDE.shape))
    got = tested(field).to_dense()[inner]
    assert got.size, "the grid of this test is wide enough"
    np.testing.assert_allclose(got, np.broadcast_to(claims.dc_gain * force, got.shape), atol=2e-6)


@pytest.mark.parametrize(("name", "text"), CASES)
def test_claims_of_mean_maximum_direction_and_amplitude(name: str, text: str) -> None:
    tested, claims = filter_and_claims(name, text)
    field = blob(5, clear=max(claims.reach))
    x, y = field.to_dense().astype(float), tested(field).to_dense().astype(float)
    size, filtered_size = np.linalg.norm(x, axis=-1), np.linalg.norm(y, axis=-1)
    both = (size > 0) & (filtered_size > 0)
    across = np.linalg.norm(np.cross(x[both], y[both]), axis=-1)
    assert both.sum() > 100
    block = field.to_dense() * 0
    block[12:-12, 12:-12, 12:-12, 0] = 1  # a kernel with negative lobes overshoots at its edges
    filtered_block = tested(ForceField.from_dense(GRID, block)).to_dense()
    measured = {
        "keeps_mean": np.allclose(
            y.sum(axis=(0, 1, 2)), x.sum(axis=(0, 1, 2)), rtol=0, atol=1e-5 * size.sum()
        ),
        "max_principle": max(filtered_size.max() / size.max(), np.linalg.norm(filtered_block, axis=-1).max())
        <= 1 + 1e-6,
        "keeps_direction": (across <= 1e-5 * size[both] * filtered_size[both]).all(),
        "keeps_amplitude": np.allclose(filtered_size[both], size[both], rtol=1e-5, atol=0),
    }
    assert {claim: bool(is_true) for claim, is_true in measured.items()} == {
        claim: getattr(claims, claim) for claim in measured
    }


@pytest.mark.parametrize(("name", "text"), cases_with_claims("linear", "dc_gain"))
def test_impulse_response_is_centred(name: str, text: str) -> None:
    tested, _ = filter_and_claims(name, text)
    impulse = ForceField.from_support(GRID, [[18, 16, 14]], [[1.0, 0.0, 0.0]])
    weight = tested(impulse).to_dense()[..., 0].astype(float)
    centre = [(weight * i).sum() / weight.sum() for i in np.indices(GRID.shape)]
    np.testing.assert_allclose(centre, [18, 16, 14], atol=1e-4)


# -- information -------------------------------------------------------------------------------------------


def joint_bits(frames: list[ForceField], quantiser_text: str | None = None) -> float:
    """Entropy of the whole field, quantised or exact, with equally likely frames.

    Joint, as the inequality does not hold for sums of marginals.
    """
    quantise = FieldQuantiserSpec.parse(quantiser_text).fit(frames) if quantiser_text else None
    outcomes = [quantise(f).to_dense() if quantise else f.to_dense() for f in frames]
    return entropy_bits(list(Counter(outcome.tobytes() for outcome in outcomes).values()))


@pytest.mark.parametrize(("name", "text"), CASES)
def test_filters_and_requantisers_add_no_information(name: str, text: str) -> None:
    """All 2^6 fields with or without a force at six positions: 6 bits in, never more at any later step."""
    tested = filter_of(name, text)
    positions = np.add(9, [[2, 2, 2], [2, 2, 4], [4, 2, 2], [4, 4, 4], [5, 4, 4], [3, 3, 3]])
    force = np.float32([[1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 1, 1], [-1, 0, 0], [1, -1, 1]])
    inputs = []
    for bits in itertools.product((0, 1), repeat=6):
        selected = np.flatnonzero(bits)
        inputs.append(ForceField.from_support(SMALL, np.take(positions, selected, axis=0), force[selected]))
    assert joint_bits(inputs) == pytest.approx(6)
    filtered = [tested(x) for x in inputs]
    exact = joint_bits(filtered)
    assert exact <= 6 + 1e-12
    for quantiser_text in ("weber:0.25", "uniform:0.3/octa1", "components:0.5", "lloyd-max:1/none"):
        assert joint_bits(filtered, quantiser_text) <= exact + 1e-12
    filtered_twice = [tested(x) for x in filtered]
    assert joint_bits(filtered_twice) <= exact + 1e-12


def test_chain_is_applied_in_order_and_named() -> None:
    names = list(TEXTS)
    chain = [filter_of(n, TEXTS[n][0]) for n in names[:2]]
    field = blob(6)
    expected = field
    for step in chain:
        expected = step(expected)
    assert apply_filters(field, chain) == expected
    medium = filter_medium(HapticMedium.from_frames([field], 30.0), chain)
    assert medium[0] == expected
    assert medium.provenance["filters"].startswith(names[0])
    assert filter_medium(medium, []) is medium
    again = filter_medium(medium, chain[:1])
    assert again.provenance["filters"] == f"{medium.provenance['filters']}; {chain[0].name} {chain[0].text}"


@pytest.mark.parametrize(
    "text", ["", "2", "two mm", "2mm,2mm", "2mm,sigma=1mm", "2mm,depth=3", "nanmm", "-1mm"]
)
def test_invalid_texts_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument):
        filter_of("gaussian", text)
    with pytest.raises(InvalidArgument, match="one of"):
        filter_of("sharpen", text)


def test_length_without_a_unit_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="a length with its unit, such as 2mm"):
        filter_of("gaussian", "2")

"""The comparison that decides whether a segment may be written agrees with the definition of the bound."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from field_makers import GRID, KINDS, field_of
from hypothesis import given, strategies as st
from native_model import Layer, compare_frames, fraction_within_bound

from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.perception.mask import violations

MASK = TouchSpec(k=0.1, f0_n=0.05)


def disturbed(field: ForceField, seed: int, deviation: float) -> ForceField:
    """Each force with a relative error of about `deviation`; some removed, some added."""
    rng = np.random.default_rng(seed)
    dense = field.to_dense()
    size = np.sqrt((dense.astype(np.float64) ** 2).sum(-1, keepdims=True))
    dense += (size * rng.normal(0, deviation, dense.shape)).astype(np.float32)
    dense[rng.random(GRID.shape) < 0.01] = 0
    dense[rng.random(GRID.shape) < 0.003] = 0.03
    return ForceField.from_dense(GRID, dense)


@given(
    st.sampled_from(KINDS),
    st.integers(0, 1000),
    st.sampled_from([0.0, 0.02, 0.08]),
    st.sampled_from([0.0, 0.05]),
)
def test_mask_agrees_with_perception(kind: str, seed: int, deviation: float, f0_n: float) -> None:
    original, decoded = field_of(kind, seed), disturbed(field_of(kind, seed), seed, deviation)
    found = compare_frames(original, decoded, replace(MASK, f0_n=f0_n))
    a, b = (f.to_dense().reshape(-1, 3) for f in (original, decoded))
    expected = violations(a, b, MASK.k, f0_n)
    assert len(found.keys) == expected.count
    if expected.worst_ratio is None:
        assert math.isinf(found.max_error_ratio)
    else:
        assert found.max_error_ratio == pytest.approx(expected.worst_ratio, rel=1e-12, abs=1e-12)
    assert found.decoded == decoded.support_count
    assert original.support_count - len(found.keys) <= found.within_bound <= original.support_count
    order = found.keys * 512 + found.samples
    assert (np.diff(order) > 0).all()
    x, y, z = np.unravel_index(found.keys, GRID.brick_shape)
    i, j, k = np.unravel_index(found.samples, (8, 8, 8))
    error = original.to_dense().astype(np.float64) - decoded.to_dense()
    errors_n = np.sqrt((error[8 * x + i, 8 * y + j, 8 * z + k] ** 2).sum(-1))
    assert (errors_n > f0_n).all()


def test_direction_bound() -> None:
    spec = TouchSpec(mode="mask-direction", k=0.1, f0_n=0.05, direction_jnd_deg=18.0)
    force = np.array([0.0, 0.0, 1.0])

    def ratio(decoded: list[float], original: np.ndarray = force) -> float:
        fields = [ForceField.from_support(GRID, [[3, 9, 5]], [f]) for f in (original, decoded)]
        return compare_frames(fields[0], fields[1], spec).max_error_ratio

    for degrees in (0.0, 5.0, 17.9, 18.1, 90.0, 180.0):
        angle = math.radians(degrees)
        rotated = [math.sin(angle), 0.0, math.cos(angle)]
        assert ratio(rotated) == pytest.approx(degrees / 18, abs=1e-6)
    assert ratio([0.0, 0.0, 1.05]) == pytest.approx(0.5, abs=1e-6)
    assert ratio([0.0, 0.0, 0.85]) == pytest.approx(1.5, abs=1e-6)
    # up to F_0 / sin(JND) = 0.162 N the absolute error counts
    weak = np.array([0.0, 0.0, 0.16])
    assert ratio([0.04, 0.0, 0.16], weak) == pytest.approx(0.8, abs=1e-6)
    assert ratio([0.0, 0.0, 0.0], np.array([0.0, 0.0, 0.04])) == pytest.approx(0.8, abs=1e-6)


def test_exact_support_is_checked_if_requested() -> None:
    original = ForceField.from_support(GRID, [[1, 1, 1], [9, 9, 9]], [[0.01, 0, 0], [1, 0, 0]])
    reduced = ForceField.from_support(GRID, [[9, 9, 9]], [[1, 0, 0]])
    assert not len(compare_frames(original, reduced, MASK).keys)
    assert len(compare_frames(original, reduced, replace(MASK, support="exact")).keys) == 1
    assert len(compare_frames(reduced, original, replace(MASK, support="exact")).keys) == 1
    assert len(compare_frames(original, reduced, replace(MASK, mode="nmse", support="exact")).keys) == 1
    assert not len(compare_frames(original, reduced, replace(MASK, mode="nmse")).keys)


def test_lossless_means_every_bit() -> None:
    spec = replace(MASK, mode="lossless")
    a = np.zeros((1, 8, 8, 8, 3), np.float32)
    a[0, 1, 2, 3] = 1, 0, 2
    b = a.copy()
    b[0, 1, 2, 3, 1] = -0.0
    fields = [ForceField(GRID, np.zeros((1, 3), np.int32), f) for f in (a, b)]
    assert not compare_frames(fields[0], fields[0], spec).violations
    assert compare_frames(fields[0], fields[1], spec).violations
    assert compare_frames(fields[0], ForceField.empty(GRID), spec).violations
    assert compare_frames(ForceField.empty(GRID), fields[0], spec).violations
    assert compare_frames(fields[0], fields[0], spec).decoded == 1


def test_agreement_is_a_fraction_of_voxels() -> None:
    original = ForceField.from_support(
        GRID, [[1, 1, 1], [1, 1, 2], [9, 9, 9]], [[1, 0, 0], [2, 0, 0], [3, 0, 0]]
    )
    vectors = np.zeros((2, 8, 8, 8, 3), np.int32)
    vectors[0, 1, 1, 1] = 105, 0, 0
    vectors[0, 1, 1, 2] = 150, 0, 0
    vectors[1, 0, 0, 0] = 40, 0, 0
    bricks = np.array([[0, 0, 0], [0, 0, 1]], np.int32)
    prediction = Layer(bricks, vectors).field(GRID, 0.01)
    # of four voxels with a force in either field, only the first is within the mask
    assert fraction_within_bound(original, prediction, MASK) == 0.25
    assert fraction_within_bound(original, prediction, replace(MASK, mode="nmse", step_n=0.11)) == 0.25
    assert fraction_within_bound(ForceField.empty(GRID), ForceField.empty(GRID), MASK) == 1.0

"""Rotations as quaternions and matrices: against scipy, at zero and half turns, and invalid matrices."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation, Slerp

from touchfield.errors import InvalidArgument
from touchfield.medium.pose_track import (
    checked_rotation,
    quaternions_of,
    rotation_matrices,
    rotation_vectors,
    slerp,
)

seeds = st.integers(0, 2**32 - 1)
IDENTITY = np.array([[1.0, 0.0, 0.0, 0.0]])


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


@given(seeds)
def test_matrices_and_turns_are_those_of_scipy(seed: int) -> None:
    a, b = (Rotation.random(6, random_state=np.random.default_rng([seed, n])) for n in (0, 1))
    np.testing.assert_allclose(rotation_matrices(wxyz(a)), a.as_matrix(), atol=1e-14)
    turns = Rotation.from_rotvec(
        rotation_vectors(wxyz(a), -wxyz(b))
    )  # the same rotation, as the negated quaternion
    np.testing.assert_allclose((turns * a).as_matrix(), b.as_matrix(), atol=1e-14)


@given(seeds, st.sampled_from((0.0, 1e-9, 1e-4, 1.0)))
def test_quaternions_come_back_from_matrices(seed: int, short_of_half_a_turn: float) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=(5, 3))
    axis /= np.linalg.norm(axis, axis=1)[:, None]
    axis = np.concatenate([axis, np.eye(3)])  # half turns about the axes leave one product alone
    turns = rotation_matrices(wxyz(Rotation.from_rotvec((np.pi - short_of_half_a_turn) * axis)))
    found = quaternions_of(turns)
    np.testing.assert_allclose((found**2).sum(axis=1), 1.0, atol=1e-14)
    np.testing.assert_allclose(rotation_matrices(found), turns, atol=1e-14)
    np.testing.assert_allclose(np.abs(quaternions_of(rotation_matrices(IDENTITY))), IDENTITY)


@given(seeds, st.floats(0.0, 1.0))
def test_slerp_agrees_with_scipy(seed: int, weight: float) -> None:
    rotations = Rotation.random(2, random_state=np.random.default_rng(seed))
    first, second = wxyz(rotations)[:, None]
    found = slerp(first, second, np.array([weight]))
    expected = Slerp([0.0, 1.0], rotations)(weight).as_matrix()
    np.testing.assert_allclose(
        rotation_matrices(found)[0], expected, atol=1e-7
    )  # the accuracy of scipy near half turns
    to_negated = slerp(first, -second, np.array([weight]))  # the same rotation, as the negated quaternion
    np.testing.assert_allclose(rotation_matrices(to_negated), rotation_matrices(found), atol=1e-12)
    in_other_order = slerp(np.roll(first, -1, axis=1), np.roll(second, -1, axis=1), np.array([weight]))
    np.testing.assert_allclose(np.roll(in_other_order, 1, axis=1), found, atol=1e-12)


@given(st.floats(0.0, 1.0), st.floats(1e-12, 3.0))
def test_slerp_is_uniform_for_small_angles(weight: float, angle: float) -> None:
    end = np.array([[np.cos(angle / 2), 0.0, np.sin(angle / 2), 0.0]])
    found = slerp(IDENTITY, end, np.array([weight]))[0]
    assert 2 * np.arctan2(found[2], found[0]) == pytest.approx(weight * angle, rel=1e-9, abs=1e-15)


@pytest.mark.parametrize(
    "matrix",
    [np.eye(3)[::-1], 1.001 * np.eye(3), np.eye(4), np.full((3, 3), np.nan), np.diag([1.0, 1.0, -1.0])],
)
def test_matrices_that_are_no_rotation_are_refused(matrix: np.ndarray) -> None:
    with pytest.raises(InvalidArgument, match="rotation"):
        checked_rotation(matrix)

"""Pose tracks: rotations against scipy, round trips, velocities with a closed form, invalid poses."""

from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.errors import InvalidArgument
from touchfield.medium import PoseTrack

seeds = st.integers(0, 2**32 - 1)
lengths_m = st.floats(-10.0, 10.0)
vectors = st.tuples(lengths_m, lengths_m, lengths_m).map(np.array)


def wxyz(rotation: Rotation) -> np.ndarray:
    return rotation.as_quat()[..., [3, 0, 1, 2]]


def any_track(seed: int, count: int = 5) -> tuple[Rotation, PoseTrack]:
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(count, random_state=rng)
    return rotation, PoseTrack(wxyz(rotation), rng.normal(size=(count, 3)))


@given(seeds)
def test_rotations_are_those_of_the_quaternions(seed: int) -> None:
    rotation, track = any_track(seed)
    np.testing.assert_allclose(track.rotations(), rotation.as_matrix(), atol=1e-12)
    np.testing.assert_array_equal(track.rotation(3), track.rotations()[3])


@given(seeds, vectors)
def test_round_trip_to_the_scene(seed: int, point: np.ndarray) -> None:
    rotation, track = any_track(seed)
    in_scene = track.to_scene(point, 2)
    np.testing.assert_allclose(in_scene, rotation[2].apply(point) + track.positions_m[2], atol=1e-12)
    np.testing.assert_allclose(track.to_body(in_scene, 2), point, atol=1e-12)


@given(seeds)
def test_successive_quaternions_have_no_sign_flips(seed: int) -> None:
    _, track = any_track(seed)
    q = track.quaternions
    assert q[0, 0] >= 0
    assert ((q[1:] * q[:-1]).sum(axis=1) >= 0).all()
    signs = np.random.default_rng(seed).choice([-1.0, 1.0], len(q))
    np.testing.assert_allclose(PoseTrack(q * signs[:, None], track.positions_m).quaternions, q, atol=1e-15)


@given(vectors, st.floats(0.0, 300.0), st.floats(20.0, 1000.0), seeds)
def test_velocities_of_a_screw_motion_are_exact(
    velocity: np.ndarray, spin: float, rate_hz: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    spin = min(spin, 0.45 * math.pi * rate_hz)  # under half a turn between the frames before and after
    times = np.arange(6) / rate_hz
    turns = Rotation.from_rotvec(times[:, None] * spin * axis) * Rotation.random(random_state=rng)
    track = PoseTrack(wxyz(turns), times[:, None] * velocity)
    found, turning = track.velocities(rate_hz)
    np.testing.assert_allclose(found, np.tile(velocity, (6, 1)), atol=1e-9)
    np.testing.assert_allclose(turning, np.tile(spin * axis, (6, 1)), atol=1e-7 * rate_hz)


def test_velocity_at_both_ends_is_a_one_sided_difference() -> None:
    turns = wxyz(Rotation.from_rotvec(np.outer([0.0, 0.1, 0.4, 0.9], [0, 0, 1])))
    velocity, turning = PoseTrack(turns, np.outer([0.0, 0.1, 0.4, 0.9], [1, 0, 0])).velocities(10.0)
    for found in (velocity[:, 0], turning[:, 2]):
        np.testing.assert_allclose(found, [1, 2, 4, 5], atol=1e-9)


def test_single_and_constant_poses_have_no_velocity() -> None:
    for track in (PoseTrack.constant(1), PoseTrack.constant(4, (1.0, 2.0, 3.0))):
        velocity, turning = track.velocities(30.0)
        assert velocity.shape == turning.shape == (len(track), 3)
        assert not velocity.any() and not turning.any()
        assert track.is_constant
    assert not any_track(1)[1].is_constant
    round_trip = PoseTrack(PoseTrack.constant(3).quaternions, [[0, 0, 0], [0, 0, 1], [0, 0, 0]])
    spinning = PoseTrack([[1, 0, 0, 0], [0.6, 0.8, 0, 0]], np.zeros((2, 3)))
    assert not round_trip.is_constant and not spinning.is_constant


def test_scaling_the_scene_scales_the_body_and_its_position() -> None:
    _, track = any_track(4)
    point, offset = np.array([0.1, -0.4, 0.2]), np.array([1.0, 2.0, 3.0])
    np.testing.assert_allclose(
        track.scaled(0.5, offset).to_scene(0.5 * point, 1),
        0.5 * (track.to_scene(point, 1) - offset),
        atol=1e-12,
    )


def test_a_part_of_a_track() -> None:
    _, track = any_track(5)
    part = track.between(1, 4)
    assert len(part) == 3
    np.testing.assert_allclose(part.rotations(), track.rotations()[1:4], atol=1e-15)
    np.testing.assert_array_equal(part.positions_m, track.positions_m[1:4])
    assert part != track and track == PoseTrack(track.quaternions, track.positions_m)
    with pytest.raises(InvalidArgument, match="0:5"):
        track.between(2, 6)
    with pytest.raises(InvalidArgument, match="2:2"):
        track.between(2, 2)


def test_a_part_may_include_the_first_and_the_last_pose() -> None:
    track = PoseTrack(np.tile([1.0, 0.0, 0.0, 0.0], (5, 1)), np.arange(15.0).reshape(5, 3))
    assert track.between(0, 5) == track
    for start, stop in ((0, 1), (4, 5)):
        np.testing.assert_array_equal(track.between(start, stop).positions_m, track.positions_m[start:stop])
    for start, stop in ((-1, 3), (0, 6), (5, 5), (5, 6)):
        with pytest.raises(InvalidArgument, match=f"{start}:{stop}"):
            track.between(start, stop)


@pytest.mark.parametrize(
    ("quaternions", "positions", "message"),
    [
        (np.zeros((0, 4)), np.zeros((0, 3)), "at least 1"),
        ([[1, 0, 0]], [[0, 0, 0]], "shape"),
        ([[1, 0, 0, 0]], [[0, 0, 0], [0, 0, 0]], "positions_m"),
        ([[1, 0, 0, 0], [1, 0.1, 0, 0]], np.zeros((2, 3)), r"frame 1.*length"),
        ([[1, 0, 0, 0]], [[0, math.nan, 0]], "not finite"),
        ([[1, 0, 0, math.inf]], [[0, 0, 0]], "not finite"),
    ],
)
def test_invalid_poses_are_refused(quaternions: object, positions: object, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        PoseTrack(np.array(quaternions, float), np.array(positions, float))


@given(seeds, vectors, st.floats(1e-3, 1e3))
def test_a_scaled_track_shares_memory_and_has_the_same_numbers(
    seed: int, offset: np.ndarray, scale: float
) -> None:
    _, track = any_track(seed)
    scaled = track.scaled(scale, offset)
    expected = scale * (track.positions_m - offset)
    assert np.shares_memory(scaled.quaternions, track.quaternions)
    for frames in (2, slice(1, 4), np.array([3, 0])):
        np.testing.assert_array_equal(scaled.positions(frames), expected[frames])
    again, part = pickle.loads(pickle.dumps(scaled)).scaled(2.0), scaled.between(1, 3)
    np.testing.assert_array_equal(again.positions(slice(None)), 2.0 * expected)
    np.testing.assert_array_equal(part.positions_m, expected[1:3])
    assert "positions_m" not in vars(scaled)  # nothing above has made them
    np.testing.assert_array_equal(scaled.positions_m, expected)
    assert not scaled.positions_m.flags.writeable and scaled == pickle.loads(pickle.dumps(scaled))


def test_a_part_shares_memory_unless_its_signs_change() -> None:
    half_turns = np.outer(np.arange(5) * 1.5, [0.0, 0.0, 1.0])
    track = PoseTrack(wxyz(Rotation.from_rotvec(half_turns)), np.zeros((5, 3)))
    early, late = track.between(0, 2), track.between(4, 5)
    assert np.shares_memory(early.quaternions, track.quaternions)
    assert track.quaternions[4, 0] < 0 < late.quaternions[0, 0] and not late.quaternions.flags.writeable
    np.testing.assert_array_equal(late.rotations(), track.rotations(slice(4, 5)))


def test_motions_of_a_surface_are_damping_times_velocity() -> None:
    _, track = any_track(3)
    velocities = np.hstack(track.velocities(100.0))
    np.testing.assert_array_equal(track.surface_motions(100.0, 0.5), 0.5 * velocities)
    np.testing.assert_array_equal(track.surface_motions(100.0, 0.5, slice(2, 4)), 0.5 * velocities[2:4])
    assert not track.surface_motions(100.0, 0.0, slice(2, 9)).any()
    assert track.surface_motions(100.0, 0.0, slice(2, 9)).shape == (3, 6)
    assert np.isinf(track.surface_motions(100.0, 1e308)).any()


def test_scaling_beyond_all_numbers_is_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"frame 0.*not finite"):
        any_track(1)[1].scaled(1e308, (1e10, 0.0, 0.0))

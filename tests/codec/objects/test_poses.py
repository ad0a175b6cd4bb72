"""The pose coder: quantised poses keep the force within the mask, and the bytes follow the document."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.codec.objects.decoder import MAX_SEGMENT_POSES, PoseSteps, decode_poses
from touchfield.codec.objects.encoder import Damping, choose_pose_steps, encode_poses, round_poses
from touchfield.codec.objects.error_bound import displacement_m
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium.pose_track import PoseTrack

FINE = PoseSteps(2.0**-16, 2.0**-15)
"""Steps for a wall of 1 N/mm, 7 cm from the body's origin, with a threshold of 0.05 N."""

steps_of_all_sizes = st.builds(
    lambda p, q: PoseSteps(2.0**p, 2.0**q), st.integers(-40, 0), st.integers(-30, -2)
)  # fmt: skip


def random_track(rng: np.random.Generator, count: int, reach_m: float = 0.3) -> PoseTrack:
    return PoseTrack(rng_units(rng, count), rng.uniform(-reach_m, reach_m, (count, 3)))


def rng_units(rng: np.random.Generator, count: int) -> np.ndarray:
    q = rng.normal(size=(count, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def falling(count: int, seed: int = 0, rate_hz: float = 1000.0, every_s: float = 0.4) -> PoseTrack:
    """A tumbling body that bounces every `every_s`: parabolas, with a new spin of some 10 rad/s at each
    bounce.
    """
    rng = np.random.default_rng(seed)
    bounce, phase_s = np.divmod(np.arange(count) / rate_hz, every_s)
    height = 9.81 / 2 * phase_s * (every_s - phase_s)
    drift = rng.normal(0, 0.3, (len(set(bounce)), 2))[bounce.astype(int)] / rate_hz
    rotation, quaternions = Rotation.identity(), []
    for index in np.unique(bounce):
        spin = rng.normal(0, 6, 3)
        during = rotation * Rotation.from_rotvec(phase_s[bounce == index][:, None] * spin)
        quaternions.append(during.as_quat()[:, [3, 0, 1, 2]])
        rotation = rotation * Rotation.from_rotvec(every_s * spin)
    return PoseTrack(np.concatenate(quaternions), np.column_stack([np.cumsum(drift, axis=0), height]))


# -- steps -------------------------------------------------------------------------------------------------


@given(st.floats(1e-7, 1e-3), st.floats(0, 0.2), st.integers(0, 2**32 - 1))
def test_no_point_moves_by_more_than_the_tolerance(tolerance_m: float, radius_m: float, seed: int) -> None:
    rng = np.random.default_rng(seed)
    track = random_track(rng, 6)
    steps = choose_pose_steps(track, radius_m, tolerance_m)
    decoded = decode_poses(encode_poses(track, steps), 6, steps)
    points = radius_m * rng_units(rng, 50)[:, :3]
    differences_m = [track.to_scene(points, i) - decoded.to_scene(points, i) for i in range(6)]
    assert np.linalg.norm(differences_m, axis=2).max() <= tolerance_m + 1e-15


def test_the_steps_are_the_coarsest() -> None:
    """Doubling either step moves a point by more than the tolerance."""
    track, radius_m = falling(400), 0.03
    steps = choose_pose_steps(track, radius_m, 1e-5)
    for wider in (
        PoseSteps(2 * steps.position_m, steps.quaternion),
        PoseSteps(steps.position_m, 2 * steps.quaternion),
    ):
        assert displacement_m(track, wider.track(round_poses(track, wider)), radius_m).max() > 1e-5
    spinning = PoseTrack(track.quaternions, np.zeros((400, 3)))  # whose positions are exact at any step
    assert choose_pose_steps(spinning, radius_m, 1e-5).quaternion >= steps.quaternion


def test_surface_damping_needs_finer_steps() -> None:
    track = falling(100)
    damping = Damping(2.0, 1000.0, 0.0125)
    coarse, fine = choose_pose_steps(track, 0.03, 1e-5), choose_pose_steps(track, 0.03, 1e-5, damping)
    assert fine.position_m < coarse.position_m
    assert damping.is_within(track, fine, 0.03)
    assert not damping.is_within(track, coarse, 0.03)


def test_too_fine_steps_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="keep to 1e-06 um"):
        choose_pose_steps(falling(5), 1.0, 1e-12)


@given(steps_of_all_sizes)
def test_steps_are_two_bytes(steps: PoseSteps) -> None:
    assert len(steps.to_bytes()) == 2
    assert PoseSteps.from_bytes(steps.to_bytes()) == steps


def test_faulty_steps_are_refused() -> None:
    for data in (b"", b"\0", b"\0\0\0", b"\x01\xf0", b"\xf0\xff", b"\xf0\x80"):
        with pytest.raises(CorruptFile):
            PoseSteps.from_bytes(data)
    for pair in ((0.3, 0.25), (2.0, 0.25), (1.0, 0.5), (-1.0, 0.25), (np.nan, 0.25), (2.0**-41, 0.25)):
        with pytest.raises(InvalidArgument):
            PoseSteps(*pair)


# -- round trips -------------------------------------------------------------------------------------------


@given(steps_of_all_sizes, st.integers(1, 40), st.integers(0, 2**32 - 1), st.floats(0, 800))
def test_decoded_tracks_are_within_half_a_step(
    steps: PoseSteps, count: int, seed: int, reach_m: float
) -> None:
    track = random_track(np.random.default_rng(seed), count, reach_m)
    decoded = decode_poses(encode_poses(track, steps), count, steps)
    assert np.abs(decoded.positions_m - track.positions_m).max() <= steps.position_m / 2
    turn = np.linalg.norm(decoded.rotations() - track.rotations(), 2, axis=(1, 2))
    assert turn.max() <= 2 * steps.quaternion + 1e-14


@pytest.mark.parametrize("power", [-2, -3, -8, -15, -30])
def test_quarter_turns_and_sign_changes_round_trip(power: int) -> None:
    steps = PoseSteps(2.0**-10, 2.0**power)
    angles = np.concatenate([np.arange(9) * np.pi / 2, np.linspace(0, 20, 60)])
    for axis in np.eye(3):
        track = PoseTrack(
            Rotation.from_rotvec(angles[:, None] * axis).as_quat()[:, [3, 0, 1, 2]], np.zeros((69, 3))
        )
        decoded = decode_poses(encode_poses(track, steps), 69, steps)
        assert (
            np.linalg.norm(decoded.rotations() - track.rotations(), 2, axis=(1, 2)).max()
            <= 2 * 2.0**power + 1e-14
        )


def test_simple_tracks_take_few_bytes() -> None:
    assert len(encode_poses(PoseTrack.constant(2000), FINE)) <= 8
    assert len(encode_poses(PoseTrack.constant(MAX_SEGMENT_POSES, (0.1, -0.2, 0.3)), FINE)) <= 16
    tumbling = falling(2000)
    assert len(encode_poses(tumbling, FINE)) <= 3000
    assert len(encode_poses(tumbling.between(0, 300), FINE)) < 0.25 * len(encode_poses(tumbling, FINE))


def test_each_component_has_its_own_predictor_order() -> None:
    """Ramps and parabolas of whole steps have zero residuals after their first numbers."""
    i = np.arange(1000)
    for numbers in (3 * i, i * i, 2 * (i - 400) ** 2):
        track = PoseTrack(
            np.tile([1.0, 0, 0, 0], (1000, 1)), np.stack([numbers] * 3, axis=1) * FINE.position_m
        )
        assert len(encode_poses(track, FINE)) < 60


def test_tracks_beyond_the_limits_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="poses"):
        encode_poses(PoseTrack.constant(MAX_SEGMENT_POSES + 1), FINE)
    with pytest.raises(InvalidArgument, match="origin"):
        encode_poses(PoseTrack.constant(2, (0, 0, 2000.0)), PoseSteps(2.0**-40, 0.25))
    with pytest.raises(InvalidArgument):
        encode_poses(PoseTrack.constant(2, (0, 0, 1e300)), FINE)
    for count in (0, -1, MAX_SEGMENT_POSES + 1):
        with pytest.raises(InvalidArgument):
            decode_poses(b"", count, FINE)


def test_largest_jumps_round_trip() -> None:
    """Positions that alternate between both ends of the range: residuals with the most bits."""
    steps = PoseSteps(2.0**-40, 2.0**-30)
    corners_m = 1024.0 * np.array([[1, -1, 1], [-1, 1, -1], [-1, -1, 1], [1, 1, -1]] * 5)
    track = PoseTrack(rng_units(np.random.default_rng(0), 20), corners_m)
    assert np.array_equal(decode_poses(encode_poses(track, steps), 20, steps).positions_m, corners_m)


# -- faults ------------------------------------------------------------------------------------------------


def assert_fault_or_track(data: bytes, count: int, steps: PoseSteps) -> None:
    try:
        track = decode_poses(data, count, steps)
    except FormatError:
        return
    assert len(track) == count


def test_truncated_or_extended_bytes_do_not_decode_to_the_track() -> None:
    """The code has no end marker, so truncated bytes may decode to another track."""
    track = falling(100)
    data = encode_poses(track, FINE)
    decoded = decode_poses(data, 100, FINE)
    faults = set()
    for cut in range(len(data)):
        try:
            assert decode_poses(data[:cut], 100, FINE) != decoded
        except FormatError as fault:
            faults.add(type(fault))
    assert faults == {TruncatedFile, CorruptFile}
    with pytest.raises(CorruptFile, match="bytes behind a code"):
        decode_poses(data + bytes(8), 100, FINE)
    for count in (50, 200):
        with pytest.raises(FormatError):
            decode_poses(data, count, FINE)


def test_changed_bytes_are_a_fault_or_another_track() -> None:
    data = encode_poses(falling(60), FINE)
    for index in range(len(data)):
        for change in (1, 0x40, 0xFF):
            wrong = bytearray(data)
            wrong[index] ^= change
            assert_fault_or_track(bytes(wrong), 60, FINE)


@given(st.binary(max_size=200), st.integers(1, 300), steps_of_all_sizes)
def test_random_bytes_are_a_fault_or_a_track(data: bytes, count: int, steps: PoseSteps) -> None:
    assert_fault_or_track(data, count, steps)


def test_numbers_that_are_no_quaternion_are_corrupt() -> None:
    """Decoding with other steps gives quaternions of a wrong length, or numbers beyond the limit."""
    data = encode_poses(PoseTrack.constant(3), FINE)
    with pytest.raises(CorruptFile, match="not unit"):
        decode_poses(data, 3, PoseSteps(FINE.position_m, FINE.quaternion / 2))
    with pytest.raises(CorruptFile, match="limit"):
        decode_poses(data, 3, PoseSteps(FINE.position_m, FINE.quaternion * 2))
    with pytest.raises(FormatError):
        decode_poses(b"", 3, FINE)  # seven zeros would be the shortest code of all


def test_decoding_few_bytes_takes_memory_in_proportion_to_the_poses() -> None:
    data = encode_poses(PoseTrack.constant(MAX_SEGMENT_POSES), FINE)
    tracemalloc.start()
    decode_poses(data, MAX_SEGMENT_POSES, FINE)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 500 * MAX_SEGMENT_POSES

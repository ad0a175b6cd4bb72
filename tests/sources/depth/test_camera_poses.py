"""Poses of cameras as text: exact rotations, matching in time, and invalid poses refused by number."""

from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.errors import SourceError
from touchfield.sources import poses

unit = st.floats(-1, 1)


@given(st.tuples(unit, unit, unit, unit).filter(lambda q: np.linalg.norm(q) > 0.1))
def test_quaternions_agree_with_scipy(q: tuple[float, float, float, float]) -> None:
    normal = np.array([q]) / np.linalg.norm(q)
    ours = poses.poses_of_quaternions(normal, np.zeros((1, 3)), "q")[:, :3, :3]
    assert np.allclose(ours, Rotation.from_quat(normal).as_matrix(), atol=1e-12)


@given(st.tuples(unit, unit, unit), st.integers(0, 2**32 - 1))
def test_a_rounded_rotation_is_orthonormalised(turn: tuple[float, float, float], seed: int) -> None:
    exact = Rotation.from_rotvec(turn).as_matrix()
    noise = np.random.default_rng(seed).uniform(-1e-3, 1e-3, (3, 3))
    rounded_pose = np.column_stack([exact + noise, [1.0, 2.0, 3.0]])[None]
    exact_pose = poses.checked_poses(rounded_pose, "p")[0]
    assert np.allclose(exact_pose[:3, :3].T @ exact_pose[:3, :3], np.eye(3), atol=1e-12)
    assert np.abs(exact_pose[:3, :3] - exact).max() < 3e-3
    assert exact_pose[:3, 3].tolist() == [1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.1, 1, 1, 1]), "no rotation"),
        (np.diag([1.0, 1, -1, 1]), "mirrors"),
        (np.full((4, 4), np.nan), "not finite"),
        (np.diag([1.0, 1, 1, 2]), "last row"),
        (np.zeros((4, 4)), "last row"),
    ],
)
def test_an_invalid_pose_is_refused_by_number(matrix: np.ndarray, message: str) -> None:
    with pytest.raises(SourceError, match=rf"log, pose 1: .*{message}"):
        poses.checked_poses(np.stack([np.eye(4), matrix]), "log")


@given(
    st.lists(st.integers(0, 1000), max_size=20, unique=True), st.lists(st.integers(0, 1000), max_size=20),
    st.integers(0, 60),
)  # fmt: skip
def test_nearest_in_time_equals_brute_force(times: list[int], queries: list[int], tolerance: int) -> None:
    stored, requested = np.array(sorted(times), float), np.array(queries, float)
    found = poses.nearest_in_time(stored, requested, tolerance)
    for t, i in zip(requested, found):
        best = min(np.abs(stored - t), default=np.inf)
        assert (i == -1) if best > tolerance else abs(stored[i] - t) == best


@pytest.mark.parametrize("text", ["1 2 3", "1 2 3 4 5 6 7 x", "", "0 0 0 0 0 0 0 0", "nan 0 0 0 0 0 0 1"])
def test_a_bad_groundtruth_is_a_source_error(text: str) -> None:
    with pytest.raises(SourceError, match="truth"):
        poses.parse_poses(text, "truth")


@pytest.mark.parametrize("number", ["-1", "0.5", "nan", "1e300"])
def test_a_log_of_matrices_counts_its_frames_from_zero(number: str) -> None:
    rows = "\n".join(["1 0 0 0", "0 1 0 0", "0 0 1 0", "0 0 0 1"])
    assert poses.parse_poses(f"0 0 1\n{rows}\n", "log").numbers.tolist() == [0]
    with pytest.raises(SourceError, match=r"no frame number|not finite"):
        poses.parse_poses(f"{number} 0 1\n{rows}\n", "log")


@given(st.text(alphabet="0123456789.-+eE \n,#naif", max_size=80))
def test_any_text_of_poses_gives_poses_or_a_source_error(text: str) -> None:
    for parse in (poses.parse_poses, poses.parse_extrinsics):
        with pytest.raises(SourceError):
            parse(text, "where")


def test_names_of_depth_take_precedence_over_those_of_colour() -> None:
    frame = {"file_path": "a/1.jpg", "depth_file_path": "b/2.png", "transform_matrix": np.eye(4).tolist()}
    assert poses.parse_poses(json.dumps({"frames": [frame]}), "a").names == ("b/2.png",)


@pytest.mark.parametrize("unit", [1.0, 1e3, 1e6, 1e9])
def test_stamps_of_every_unit_are_seconds(unit: float) -> None:
    for since_1970 in (1.1e8, 1.7e9, 9e10):  # 1973 to the year 4800
        assert poses.seconds(np.array([0.0, since_1970 * unit])).tolist() == pytest.approx([0.0, since_1970])
    assert poses.seconds(np.array([-2e20])).tolist() == [-2e20]

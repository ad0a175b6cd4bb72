"""Depth at another rate: times, repeated frames, interpolated depth and poses, and its options."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra import numpy as hnp
from scipy.spatial.transform import Rotation

import depth_makers as make
from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources import camera
from touchfield.sources.camera import (
    INTERPOLATIONS,
    DepthSequence,
    InterpolatedSequence,
    Intrinsics,
    interpolate_depth,
)
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.depth.layouts import LAYOUTS as DEPTH_LAYOUTS, Layout
from touchfield.sources.options import SourceOptions
from touchfield.sources.terrain.height_scene import HeightScene

tum, redwood, sun3d, threedmatch, depth_folder, depth_map, *_ = DEPTH_LAYOUTS


class MemorySequence(DepthSequence):
    """Frames in memory with a count of decodings."""

    def __init__(self, frames: np.ndarray, rate_hz: float = 25.0, poses: np.ndarray | None = None) -> None:
        self.frames = np.asarray(frames, np.float32)
        self.name, self.rate_hz, self.poses, self.notes = "kept", rate_hz, poses, ("a note",)
        self.frame_count, self.height, self.width = self.frames.shape
        self.intrinsics = Intrinsics(20.0, 20.0, 2.0, 2.0)
        self.decoded: Counter[int] = Counter()

    def depth_m(self, frame: int) -> np.ndarray:
        self.decoded[frame] += 1
        return self.frames[frame].copy()


def ramp(count: int) -> np.ndarray:
    """Frame i at the depth 1 + i / 100 everywhere."""
    return np.tile((1 + np.arange(count) / 100)[:, None, None], (1, 3, 4))


depths = hnp.arrays(
    np.float32,
    (2, 3, 5),
    elements=st.one_of(st.just(0.0), st.floats(0.25, 8.0, width=32), st.sampled_from([1.0, 1.04])),
)
weights = st.floats(0.001, 0.999)


# -- times -------------------------------------------------------------------------------------------------


def test_the_papers_twenty_frames_become_eight_hundred() -> None:
    sequence = InterpolatedSequence(MemorySequence(ramp(20), 25.0), 1000.0)
    assert (sequence.frame_count, sequence.rate_hz) == (800, 1000.0)
    for j in (0, 1, 39, 40, 41, 399, 759):
        expected = 1 + j / 1000 * 25 / 100  # the depth of the source is linear in time
        assert np.allclose(sequence.depth_m(j), expected, atol=1e-6)
    for j in range(760, 800):
        assert np.array_equal(sequence.depth_m(j), np.float32(ramp(20)[19]))
    assert not np.array_equal(sequence.depth_m(759), sequence.depth_m(760))
    assert sequence.notes[0] == "a note"
    assert "20 depth frames at 25 Hz" in sequence.notes[1] and "last 40 repeat" in sequence.notes[1]
    for beyond in (-1, 800):
        with pytest.raises(InvalidArgument, match="0 to 799"):
            sequence.depth_m(beyond)


@given(st.integers(2, 30), st.floats(0.5, 120), st.floats(0.5, 2000), st.sampled_from(INTERPOLATIONS))
def test_each_frame_has_the_depth_of_its_time(
    count: int, source_hz: float, rate_hz: float, rule: str
) -> None:
    sequence = InterpolatedSequence(MemorySequence(ramp(count), source_hz), rate_hz, rule)
    assert abs(sequence.frame_count - count / source_hz * rate_hz) <= 0.5 or sequence.frame_count == 1
    for j in {0, sequence.frame_count // 3, sequence.frame_count - 1}:
        at = min(j / rate_hz * source_hz, count - 1)
        position = (sequence.depth_m(j)[0, 0] - 1) * 100
        assert abs(position - at) <= (0.5 if rule == "nearest" else 0) + 1e-3


@given(st.integers(1, 40), st.integers(1, 60), st.sampled_from([25.0, 1 / 0.033, 29.97, 30.2]))
def test_a_source_frame_is_unchanged_at_its_time(factor: int, count: int, source_hz: float) -> None:
    frames = np.full((count, 2, 2), 2.0, np.float32)
    frames[1::2, 0, 0] = 0  # linear interpolation makes it unknown except at the even frames
    sequence = InterpolatedSequence(MemorySequence(frames, source_hz), factor * source_hz)
    for i in range(count):
        assert np.array_equal(sequence.depth_m(i * factor), frames[i])


@pytest.mark.parametrize("rule", INTERPOLATIONS)
def test_a_pass_decodes_each_source_frame_once(rule: str) -> None:
    for order in (range(300), reversed(range(300))):
        source = MemorySequence(ramp(6), 20.0)
        sequence = InterpolatedSequence(source, 1000.0, rule)
        for j in order:
            sequence.depth_m(j)
        assert source.decoded == Counter(range(6))


def test_a_returned_frame_may_be_modified() -> None:
    sequence = InterpolatedSequence(MemorySequence(ramp(3), 10.0), 20.0)
    for j in range(6):
        before = sequence.depth_m(j)
        sequence.depth_m(j)[:] = -1
        assert np.array_equal(sequence.depth_m(j), before)


def test_a_lower_rate_takes_fewer_frames() -> None:
    sequence = InterpolatedSequence(MemorySequence(ramp(20), 20.0), 8.0)
    assert sequence.frame_count == 8 and list(sequence.key_frames()) == list(range(8))
    assert np.allclose([sequence.depth_m(j)[0, 0] for j in range(8)], 1 + 2.5 * np.arange(8) / 100)


def test_a_single_picture_stays_a_single_frame() -> None:
    sequence = InterpolatedSequence(MemorySequence(ramp(1), 30.0, poses=np.eye(4)[None]), 1000.0)
    assert (sequence.frame_count, sequence.rate_hz, sequence.notes) == (1, 1000.0, ("a note",))
    assert np.array_equal(sequence.poses, np.eye(4)[None])


# -- between two frames ------------------------------------------------------------------------------------


@given(depths, weights)
def test_linear_is_the_mean_by_time_and_unknown_with_either(pair: np.ndarray, weight: float) -> None:
    mixed = interpolate_depth(pair[0], pair[1], weight)
    is_known = (pair > 0).all(axis=0)
    exact = (1 - weight) * pair[0].astype(float) + weight * pair[1]
    assert mixed.dtype == np.float32 and mixed.flags.c_contiguous
    assert np.allclose(mixed[is_known], exact[is_known], rtol=1e-6)
    assert not mixed[~is_known].any()


@given(depths, weights)
def test_time_may_run_backwards(pair: np.ndarray, weight: float) -> None:
    forward, backward = (
        interpolate_depth(pair[0], pair[1], weight),
        interpolate_depth(pair[1], pair[0], 1 - weight),
    )
    assert np.allclose(forward, backward, rtol=1e-5)


def test_a_hand_before_a_wall() -> None:
    """A near strip moves over a distant wall: linear interpolation lets it float between them,
    nearest does not.
    """
    frames = np.full((2, 4, 8), 3.0, np.float32)
    frames[0, :, 2:4] = frames[1, :, 3:5] = 1.0
    depths = {
        rule: InterpolatedSequence(MemorySequence(frames, 10.0), 40.0, rule).depth_m(1)
        for rule in INTERPOLATIONS
    }
    assert np.allclose(depths["linear"][0, 2:5], [1.5, 1.0, 2.5])
    assert np.array_equal(depths["nearest"], frames[0])


# -- poses -------------------------------------------------------------------------------------------------


def test_interpolated_poses_rotate_and_move_uniformly() -> None:
    """A camera rotates about a fixed axis and moves along a line; all interpolated poses are on
    that motion.
    """
    axis = np.array([1.0, 2.0, -2.0]) / 3

    def pose(i: np.ndarray) -> np.ndarray:
        matrices = np.tile(np.eye(4), (len(i), 1, 1))
        matrices[:, :3, :3] = Rotation.from_rotvec(0.7 * i[:, None] * axis).as_matrix()
        matrices[:, :3, 3] = i[:, None] * [0.1, -0.2, 0.3] + [5, 6, 7]
        return matrices

    sequence = InterpolatedSequence(MemorySequence(ramp(6), 10.0, pose(np.arange(6))), 35.0)
    assert sequence.poses is not None and sequence.poses.shape == (21, 4, 4)
    assert np.allclose(sequence.poses, pose(np.minimum(np.arange(21) / 3.5, 5)), atol=1e-12)
    scene = DepthScene(sequence)
    assert np.allclose(scene.pose(0), np.eye(4))


def test_a_pose_that_is_no_motion_is_an_error() -> None:
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1, 0, 0] = 2
    with pytest.raises(SourceError, match="kept, poses, pose 1"):
        InterpolatedSequence(MemorySequence(ramp(3), poses=poses), 100.0)


# -- options -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("rate_hz", "rule", "message"),
    [
        (0.0, "linear", "positive"),
        (np.nan, "linear", "positive"),
        (np.inf, "linear", "positive"),
        (1e12, "linear", "at most 1048576 frames"),
        (100.0, "cubic", "linear or nearest"),
    ],
)
def test_invalid_options_are_refused(rate_hz: float, rule: str, message: str) -> None:
    with pytest.raises(InvalidArgument, match=message):
        InterpolatedSequence(MemorySequence(ramp(3)), rate_hz, rule)


@pytest.mark.parametrize("reading", ["camera", "height"])
def test_a_layout_with_a_known_rate_is_interpolated(tmp_path: Path, reading: str) -> None:
    folder = make.write_tum(tmp_path / "s", period_s=0.04)
    scene = tum.kind.open(folder, SourceOptions(rate_hz=500, source_rate_hz=3, reading=reading))
    assert isinstance(scene, HeightScene if reading == "height" else DepthScene)
    assert (scene.frame_count, scene.rate_hz) == (make.FRAMES * 20, 500.0)
    assert any("25 Hz are interpolated in time (linear) to 100" in note for note in scene.notes)
    if isinstance(scene, DepthScene):
        source = tum.read_sequence(folder, SourceOptions())
        halfway = (source.depth_m(1) + source.depth_m(2)) / 2
        assert np.allclose(scene.sequence.depth_m(30), halfway, atol=1e-6)
        shift_m = np.linalg.norm(scene.pose(30)[:3, 3])
        assert shift_m == pytest.approx(0.015, abs=1e-4)


@pytest.mark.parametrize(
    ("module", "write", "scale"),
    [
        (redwood, make.write_redwood, None),
        (threedmatch, make.write_threedmatch, None),
        (depth_folder, make.write_plain, 1000),
    ],
)
def test_a_layout_without_a_rate_uses_the_option(
    tmp_path: Path, module: Layout, write: Callable[[Path], Path], scale: float | None
) -> None:
    folder = write(tmp_path / "s")
    plain = module.kind.open(folder, SourceOptions(depth_scale=scale))
    assert plain.rate_hz == 30.0
    as_before = module.kind.open(folder, SourceOptions(depth_scale=scale, rate_hz=100))
    assert (as_before.frame_count, as_before.rate_hz) == (plain.frame_count, 100.0)
    options = SourceOptions(depth_scale=scale, rate_hz=100, source_rate_hz=20, interpolation="nearest")
    between = module.kind.open(folder, options)
    assert (between.frame_count, between.rate_hz) == (5 * plain.frame_count, 100.0)
    assert between.sequence.interpolation == "nearest"
    alone = module.kind.open(folder, SourceOptions(depth_scale=scale, source_rate_hz=20))
    assert (alone.frame_count, alone.rate_hz) == (plain.frame_count, 20.0)


def test_a_single_depth_map_has_the_rate_of_the_medium(tmp_path: Path) -> None:
    np.save(tmp_path / "depth.npy", np.float32(make.depths_mm()[0] / 1000))
    options = SourceOptions(intrinsics="20,20,5.5,4", rate_hz=1000, source_rate_hz=25)
    scene = depth_map.kind.open(tmp_path / "depth.npy", options)
    assert (scene.frame_count, scene.rate_hz) == (1, 1000.0)


# -- the paper's scene 2, with a real sequence -------------------------------------------------------------


class First(DepthSequence):
    """The first frames of a sequence, at another rate."""

    def __init__(self, source: DepthSequence, count: int, rate_hz: float) -> None:
        self.source, self.frame_count, self.rate_hz = source, count, rate_hz
        self.name, self.width, self.height = source.name, source.width, source.height
        self.intrinsics, self.poses = (
            source.intrinsics,
            None if source.poses is None else source.poses[:count],
        )

    def depth_m(self, frame: int) -> np.ndarray:
        return self.source.depth_m(frame)


@pytest.mark.shared
def test_twenty_real_frames_become_eight_hundred(shared_data: Path) -> None:
    source = First(tum.read_sequence(shared_data / "rgbd_tum_fr1_rpy", SourceOptions()), 20, 25.0)
    by_rule = {rule: InterpolatedSequence(source, 1000.0, rule) for rule in INTERPOLATIONS}
    flying, jumped = Counter[str](), 0
    for rule, sequence in by_rule.items():
        assert sequence.frame_count == 800
        assert sequence.poses is not None and np.allclose(
            sequence.poses[[0, 400, 799]], source.poses[[0, 10, 19]]
        )
        last = source.depth_m(19)
        assert np.array_equal(sequence.depth_m(760), last) and np.array_equal(sequence.depth_m(799), last)
        for i in (0, 9, 18):
            before, after = source.depth_m(i).astype(float), source.depth_m(i + 1).astype(float)
            assert np.array_equal(sequence.depth_m(40 * i), source.depth_m(i))
            nearer = np.minimum(before, after)
            jumps = (nearer > 0) & (np.abs(after - before) > 0.2 * nearer)
            jumped += int(jumps.sum())
            for j in (13, 20):
                depth = sequence.depth_m(40 * i + j)
                away = np.minimum(np.abs(depth - before), np.abs(depth - after))
                flying[rule] += int((away > 0.05 * nearer)[jumps & (depth > 0)].sum())
    assert flying == {"nearest": 0, "linear": jumped}  # jumped counts both rules, flying both moments
    assert jumped > 1000


def test_the_rules_are_those_of_the_options() -> None:
    for rule in camera.INTERPOLATIONS:
        assert SourceOptions(interpolation=rule).interpolation == rule

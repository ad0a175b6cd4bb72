"""F(x, t) in one process, against the frames of the medium."""

from __future__ import annotations

import numpy as np
import pytest
from block_makers import some_field
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.medium import VibrationFrame
from touchfield.render.sampler import FieldSampler

GRID = Grid((17, 12, 21), (0.01, 0.011, 0.009), (-0.08, -0.06, -0.1))
RATE_HZ = 50.0
seeds = st.integers(0, 2**32 - 1)


def some_medium(rng: np.random.Generator, count: int) -> HapticMedium:
    return HapticMedium.from_frames([some_field(rng, GRID) for _ in range(count)], RATE_HZ)


def some_scene(rng: np.random.Generator, count: int = 3, limit_n: float = 1.5) -> HapticScene:
    """A rigid body in motion, a deforming body in motion, and a static one."""
    rigid = HapticMedium.from_frames([full_field(rng)], RATE_HZ)
    soft = HapticMedium.from_frames([full_field(rng) for _ in range(count)], RATE_HZ)
    tracks = [
        PoseTrack(Rotation.random(count, random_state=rng).as_quat(), rng.normal(0, 0.02, (count, 3)))
    ] * 2
    objects = (
        HapticObject("rigid", rigid, tracks[0]),
        HapticObject("soft", soft, tracks[1]),
        HapticObject("still", rigid, PoseTrack.constant(count)),
    )
    return HapticScene(GRID, RATE_HZ, objects, limit_n, 0.2)


def full_field(rng: np.random.Generator) -> ForceField:
    return ForceField.from_dense(GRID, rng.normal(size=(*GRID.shape, 3)))


def some_points(rng: np.random.Generator, *shape: int) -> np.ndarray:
    low, high = GRID.box_m
    return rng.uniform(low - 0.02, high + 0.02, (*shape, 3))


SAMPLER = FieldSampler(
    HapticMedium.from_frames([full_field(np.random.default_rng(7)) for _ in range(3)], RATE_HZ)
)


def between(medium: HapticMedium, position: float, points: np.ndarray) -> np.ndarray:
    """The definition: two blended frames."""
    position = min(max(position, 0.0), len(medium) - 1.0)
    first, weight = int(position), position - int(position)
    found = (1 - weight) * medium[first].sample_n(points).astype(float)
    return found + weight * medium[first + 1].sample_n(points) if weight else found


@settings(max_examples=25)
@given(seeds, st.floats(-2, 6), st.integers(1, 4))
def test_voxels_at_one_instant(seed: int, position: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    medium, points = some_medium(rng, count), some_points(rng, 5, 8)
    found = FieldSampler(medium).force_n(position / RATE_HZ, points)
    assert found.dtype == np.float32 and found.shape == points.shape
    np.testing.assert_allclose(found, between(medium, position, points), atol=2e-6, rtol=0)


@settings(max_examples=15)
@given(seeds, st.integers(1, 4))
def test_each_point_has_its_time(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    medium, points, positions = some_medium(rng, count), some_points(rng, 30), rng.uniform(-2, 6, 30)
    positions[::5] = np.round(positions[::5])
    sampler = FieldSampler(medium)
    found = sampler.force_n(positions / RATE_HZ, points)
    expected = [between(medium, t, p[None])[0] for t, p in zip(positions, points)]
    np.testing.assert_allclose(found, expected, atol=2e-6, rtol=0)
    single = [sampler.at(t / RATE_HZ, *p) for t, p in zip(positions.tolist(), points.tolist())]
    np.testing.assert_allclose(single, expected, atol=2e-6, rtol=0)


def test_exact_at_samples_and_frames() -> None:
    medium = some_medium(np.random.default_rng(0), 3)
    sampler = FieldSampler(medium)
    index = np.argwhere(np.ones(GRID.shape))
    points = GRID.to_m(index)
    for i in (0, 2, 1):
        expected = medium[i].to_dense()[tuple(index.T)]
        assert np.array_equal(sampler.force_n(i / RATE_HZ, points), expected)
        assert np.array_equal(sampler.force_n(np.full(len(points), i / RATE_HZ), points), expected)
        for n in (5, 1000, 3000):
            assert sampler.at(i / RATE_HZ, *points[n].tolist()) == tuple(expected[n].astype(float))


@settings(max_examples=8)
@given(seeds)
def test_scenes_at_their_frames(seed: int) -> None:
    rng = np.random.default_rng(seed)
    scene, points = some_scene(rng), some_points(rng, 40)
    sampler = FieldSampler(scene)
    for i in (1, 0, 2):
        expected = scene.sample_n(i, points)
        np.testing.assert_allclose(sampler.force_n(i / RATE_HZ, points), expected, atol=5e-6, rtol=0)
    times = np.repeat([0, 2], 20) / RATE_HZ
    expected = np.concatenate([scene.sample_n(0, points[:20]), scene.sample_n(2, points[20:])])
    np.testing.assert_allclose(sampler.force_n(times, points), expected, atol=5e-6, rtol=0)
    middle = sampler.force_n(0.5 / RATE_HZ, points)
    assert (np.linalg.norm(middle, axis=1) <= scene.force_max_n).all()
    assert np.array_equal(middle, sampler.force_n(np.full(40, 0.5 / RATE_HZ), points))


def difference(sampler: FieldSampler, time_s: float, point: np.ndarray, step_m: float) -> np.ndarray:
    """One-sided differences [3, 3]; a negative step is backward."""
    base = np.array(sampler.at(time_s, *point))
    moved = [np.array(sampler.at(time_s, *(point + step_m * unit))) for unit in np.eye(3)]
    return (np.stack(moved, axis=1) - base[:, None]) / step_m


@settings(max_examples=8)
@given(seeds, st.sampled_from([0.0, 0.4, 1.0]), st.sampled_from(["voxels", "scene", "cut scene"]))
def test_gradient_is_the_slope(seed: int, position: float, kind: str) -> None:
    rng = np.random.default_rng(seed)
    low, high = GRID.box_m
    points = rng.uniform(0.6 * low + 0.4 * high, 0.4 * low + 0.6 * high, (12, 3))
    if kind == "voxels":
        sampler = FieldSampler(HapticMedium.from_frames([full_field(rng), full_field(rng)], RATE_HZ))
    else:
        sampler = FieldSampler(some_scene(rng, 3, 0.9 if kind == "cut scene" else 1e6))
    time_s = position / RATE_HZ
    found = sampler.gradient_n_per_m(time_s, points)
    assert np.array_equal(found, sampler.gradient_n_per_m(np.full(12, time_s), points))
    smooth = 0
    for gradient, point in zip(found, points):
        forward, backward = (difference(sampler, time_s, point, step) for step in (1e-7, -1e-7))
        if np.abs(forward - backward).max() < 0.02:  # no lattice plane and no edge of the limit in between
            smooth += 1
            np.testing.assert_allclose(gradient, (forward + backward) / 2, atol=0.02, rtol=1e-5)
    assert smooth >= 6


def test_gradient_on_a_lattice_plane_is_the_forward_one() -> None:
    sampler = FieldSampler(HapticMedium.from_frames([full_field(np.random.default_rng(5))], RATE_HZ))
    for index in ((3, 4, 5), (8, 8, 8), (7, 0, 15)):
        point = GRID.to_m(index)
        np.testing.assert_allclose(
            sampler.gradient_n_per_m(0, point), difference(sampler, 0, point, 1e-6), atol=1e-3
        )


def test_few_frames_are_cached_and_the_rest_recomputed() -> None:
    rng, computed = np.random.default_rng(1), []
    fields = [full_field(rng) for _ in range(9)]

    def make(i: int) -> ForceField:
        computed.append(i)
        return fields[i]

    medium = HapticMedium(GRID, RATE_HZ, 9, make)
    sampler = FieldSampler(medium, memory_bytes=5 << 20)  # one of these fields takes 0.4 MB
    points = some_points(rng, 20)
    for i in (*range(9), 8, 7, 6):
        sampler.force_n(i / RATE_HZ, points)
    assert computed == list(range(9))  # none was computed twice
    tight = FieldSampler(medium, memory_bytes=1_400_000)  # three
    order = [*range(9), 0, 0.5, 3.5, 2.5, 7.25, 8, 0]
    for position in order:
        np.testing.assert_allclose(
            tight.force_n(position / RATE_HZ, points), between(medium, position, points), atol=2e-6, rtol=0
        )
        np.testing.assert_allclose(
            [tight.at(position / RATE_HZ, *p) for p in points.tolist()],
            between(medium, position, points),
            atol=2e-6,
            rtol=0,
        )
        assert tight._pairs.take(0, 1).memory.size_bytes < 1_000_000
        assert tight._pairs._cached_bytes <= 1_400_000


def test_a_cache_too_small_is_an_error() -> None:
    rng = np.random.default_rng(1)
    sampler = FieldSampler(HapticMedium.from_frames([full_field(rng) for _ in range(3)], RATE_HZ), 600_000)
    points = some_points(rng, 4)
    before = sampler.force_n(0.0, points)
    with pytest.raises(InvalidArgument, match="memory_bytes"):
        sampler.force_n(0.5 / RATE_HZ, points)
    assert np.array_equal(sampler.force_n(0.0, points), before)


def test_a_band_of_vibration_between_frames() -> None:
    at = np.array([[3, 4, 5]], np.int32)
    values = [([2.0], [80.0]), ([4.0], [160.0]), ([], [])]
    frames = [
        VibrationFrame(GRID, at[: len(a)], np.array(a, np.float32), np.array(f, np.float32))
        for a, f in values
    ]
    fields = [ForceField.empty(GRID)] * 3
    medium = HapticMedium(GRID, RATE_HZ, 3, fields.__getitem__, vibration=frames.__getitem__)
    sampler, point = FieldSampler(medium), GRID.to_m(at[0])
    found = [sampler.vibration(position / RATE_HZ, point) for position in (0, 0.25, 0.4, 0.75, 1, 1.75, 2)]
    # the frequency is that of the dominant frame
    expected = [(2, 80), (2.5, 80), (2.8, 160), (3.5, 160), (4, 160), (1, 160), (0, 0)]
    np.testing.assert_allclose(found, expected, rtol=1e-6)
    amplitudes, frequencies = sampler.vibration(0.0, GRID.to_m([[3, 4, 5.5], [0, 0, 0]]))
    np.testing.assert_allclose(amplitudes, [1.0, 0.0], rtol=1e-6)
    np.testing.assert_allclose(frequencies, [80.0, 0.0])
    silent = FieldSampler(HapticMedium.from_frames(fields, RATE_HZ))
    assert [float(v) for v in silent.vibration(0.0, point)] == [0.0, 0.0]


@settings(max_examples=100)
@given(st.tuples(*[st.floats()] * 3), st.floats(allow_nan=False, allow_infinity=False))
def test_any_number_is_a_valid_position(point: tuple[float, float, float], time_s: float) -> None:
    """Any coordinates give a finite force, none outside the box; any finite time gives some frame."""
    found = SAMPLER.at(time_s / RATE_HZ, *point)
    assert np.isfinite(found).all()
    low, high = GRID.box_m
    spacing = np.array(GRID.spacing_m)
    if not ((point > low - spacing) & (point < high + spacing)).all():
        assert found == (0.0, 0.0, 0.0)


def test_points_of_any_type() -> None:
    rng = np.random.default_rng(2)
    sampler = FieldSampler(HapticMedium.from_frames([full_field(rng)], RATE_HZ))
    points = some_points(rng, 6, 6)
    found = sampler.force_n(0.0, points)
    frozen = points.copy()
    frozen.flags.writeable = False
    assert np.array_equal(sampler.force_n(0.0, frozen), found)
    assert np.array_equal(sampler.force_n(0.0, points[::2, ::3]), found[::2, ::3])
    assert np.array_equal(sampler.force_n(0.0, points.tolist()), found)
    np.testing.assert_allclose(sampler.force_n(0.0, points.astype(np.float32)), found, atol=1e-4)
    assert sampler.force_n(0.0, np.zeros((0, 3))).shape == (0, 3)
    assert sampler.force_n(np.zeros(0), np.zeros((0, 3))).shape == (0, 3)
    assert not sampler.force_n(0.0, [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e300]]).any()
    assert not sampler.force_n(np.zeros(3), [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e300]]).any()


def test_numbers_of_any_type_share_one_compiled_query() -> None:
    grid = Grid((3, 3, 3), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    field = ForceField.from_dense(grid, np.random.default_rng(3).normal(size=(3, 3, 3, 3)))
    sampler = FieldSampler(HapticMedium.from_frames([field] * 3, 1.0), 1e6)  # type: ignore[arg-type]
    found = sampler.at(0.5, 1.0, 2.0, 1.0)
    for arguments in (
        (0.5, 1, 2, 1),
        (0.5, np.float32(1), np.int8(2), True),
        (np.array(0.5), np.array(1), 2.0, "1"),
    ):
        assert sampler.at(*arguments) == found  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="time_s, x_m, y_m, z_m"):
        sampler.at(0.5, [1.0, 2.0], 2.0, 1.0)  # type: ignore[arg-type]


@pytest.mark.parametrize("point", [[np.nan, 0, 0], [0, np.inf, 0], [0, 0, 1e300]])
def test_the_gradient_is_zero_outside_the_box(point: list[float]) -> None:
    assert not SAMPLER.gradient_n_per_m(0.0, point).any()


@pytest.mark.parametrize("time_s", [np.nan, np.inf, [0.0, np.nan], [0.0], [[0.0, 0.0]]])
def test_invalid_times_are_refused(time_s: object) -> None:
    sampler = FieldSampler(some_medium(np.random.default_rng(0), 2))
    with pytest.raises(InvalidArgument, match="time_s"):
        sampler.force_n(time_s, np.zeros((2, 3)))
    if np.ndim(time_s) == 0:
        with pytest.raises(InvalidArgument, match="time_s"):
            sampler.at(time_s, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("points_m", [0.0, [1.0, 2.0], [[1.0, 2.0]]])
def test_points_without_three_coordinates_are_refused(points_m: object) -> None:
    with pytest.raises(InvalidArgument, match="points_m"):
        FieldSampler(some_medium(np.random.default_rng(0), 1)).force_n(0.0, points_m)


def test_the_next_pair_is_computed_in_advance() -> None:
    import threading

    from touchfield.render.block.frames import FrameParts
    from touchfield.render.sampler import Pairs

    computed = {n: threading.Event() for n in range(4)}
    grid = Grid((4, 4, 4), (0.01,) * 3, (0.0,) * 3)

    def make(frame: int) -> ForceField:
        computed[frame].set()
        return ForceField.from_dense(grid, np.full((4, 4, 4, 3), 1.0 + frame, np.float32))

    pairs = Pairs(FrameParts(HapticMedium(grid, 30.0, 4, make)), 1 << 24)
    pairs.take(0, 1)
    pairs.prepare(1, 2)
    assert computed[2].wait(20) and not computed[3].is_set()
    pairs.take(1, 2)
    pairs.prepare(2, 3)
    assert computed[3].wait(20)


def test_successive_pairs_compute_each_frame_once_and_store_two() -> None:
    from touchfield.render.block.frames import FrameParts
    from touchfield.render.sampler import Pairs

    grid = Grid((16, 16, 16), (0.01,) * 3, (0.0,) * 3)
    computed: list[int] = []

    def make(frame: int) -> ForceField:
        computed.append(frame)
        return ForceField.from_dense(grid, np.full((16, 16, 16, 3), 1.0 + frame, np.float32))

    pairs = Pairs(FrameParts(HapticMedium(grid, 30.0, 60, make)), 1 << 28)
    sizes = []
    for a in range(59):
        sizes.append(pairs.take(a, a + 1).memory.size_bytes)
        pairs.prepare(a + 1, a + 2)
    assert computed == list(range(60))
    assert max(sizes) == sizes[0]  # capacity for two frames, at the end as at the start

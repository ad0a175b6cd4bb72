"""Haptic scenes: the compiled query and the voxelised field against the sum of `ForceField.sample_n`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack

RATE_HZ = 50.0
FLOOR = 1e-9  # of F_max: a smaller force of an object counts as none
WORKSPACE = Grid((17, 12, 21), (0.01, 0.011, 0.009), (-0.08, -0.06, -0.1))

seeds = st.integers(0, 2**32 - 1)


def reference(scene: HapticScene, frame: int, positions_m: np.ndarray) -> np.ndarray:
    """The definition: the sum of the interpolated forces and the forces of the motion of each object, then
    the limit.
    """
    points = np.asarray(positions_m, np.float64)
    total = np.zeros(points.shape)
    for obj in scene.objects:
        force_n = obj.field(frame).sample_n(obj.track.to_body(points, frame)).astype(np.float64)
        velocity, spin = (v[frame] for v in obj.track.velocities(scene.rate_hz))
        surface = velocity + np.cross(spin, points - obj.track.positions_m[frame])
        touched = np.linalg.norm(force_n, axis=-1, keepdims=True) > FLOOR * scene.force_max_n
        total += force_n @ obj.track.rotation(frame).T + touched * scene.surface_damping_n_s_per_m * surface
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return total * np.minimum(1.0, scene.force_max_n / np.maximum(length, 1e-300))


def tracks(rng: np.random.Generator, count: int, spread_m: float = 0.05) -> PoseTrack:
    return PoseTrack(Rotation.random(count, random_state=rng).as_quat(), rng.normal(0, spread_m, (count, 3)))


def some_field(rng: np.random.Generator) -> ForceField:
    """A box or a blob of forces, possibly empty, on a small lattice of sides that are no multiples of a
    brick.
    """
    grid = Grid(
        tuple(rng.integers(1, 20, 3)), tuple(rng.uniform(0.003, 0.02, 3)), tuple(rng.normal(0, 0.05, 3))
    )
    dense = rng.normal(size=(*grid.shape, 3))
    dense[rng.random(grid.shape) > rng.choice([0.0, 0.02, 0.6, 1.0])] = 0
    return ForceField.from_dense(grid, dense)


@st.composite
def scenes(draw: st.DrawFn) -> HapticScene:
    rng = np.random.default_rng(draw(seeds))
    count, objects = 3, []
    for n in range(draw(st.integers(1, 3))):
        frames = [some_field(rng)]
        if draw(st.booleans()):
            dense = frames[0].to_dense()
            frames += [ForceField.from_dense(frames[0].grid, s * dense[::d]) for s, d in ((0.5, -1), (-2, 1))]
        track = PoseTrack.constant(count) if draw(st.booleans()) else tracks(rng, count)
        objects.append(HapticObject(f"object {n}", HapticMedium.from_frames(frames, RATE_HZ), track))
    damping = draw(st.sampled_from([0.0, 0.3]))
    return HapticScene(WORKSPACE, RATE_HZ, tuple(objects), draw(st.sampled_from([0.7, 50.0])), damping)


def close(found: np.ndarray, expected: np.ndarray) -> None:
    """Equal up to the rounding of a few float32 numbers of the size of these forces."""
    np.testing.assert_allclose(found, expected, atol=5e-6, rtol=0)


@settings(max_examples=30)
@given(scenes(), seeds)
def test_query_and_voxels_are_the_definition(scene: HapticScene, seed: int) -> None:
    points = np.random.default_rng(seed).normal(0, 0.1, (4, 25, 3))
    every = WORKSPACE.to_m(np.moveaxis(np.indices(WORKSPACE.shape), 0, -1))
    frames = scene.voxelise()
    for frame in (2, 0, 2):
        found = scene.sample_n(frame, points)
        assert found.dtype == np.float32 and found.shape == points.shape
        close(found, reference(scene, frame, points))
        field = frames[frame]
        assert field.grid == WORKSPACE and field.forces_n.any(axis=(1, 2, 3, 4)).all()
        close(field.to_dense(), reference(scene, frame, every))
        np.testing.assert_allclose(field.to_dense(), scene.sample_n(frame, every), atol=1e-6)


@settings(max_examples=30)
@given(scenes())
def test_no_force_is_longer_than_the_limit(scene: HapticScene) -> None:
    fields = list(scene.voxelise())
    assert len(fields) == scene.frame_count
    for field in fields:
        assert (np.linalg.norm(field.vectors_n().astype(np.float64), axis=1) <= scene.force_max_n).all()


@settings(max_examples=30)
@given(scenes())
def test_forces_of_several_objects_are_added(scene: HapticScene) -> None:
    unlimited = replace(scene, force_max_n=1e6)
    alone = [replace(unlimited, objects=(part,)) for part in scene.objects]
    points = np.random.default_rng(3).normal(0, 0.1, (60, 3))
    close(unlimited.sample_n(1, points), sum(part.sample_n(1, points).astype(np.float64) for part in alone))
    parts = sum(part.voxelise()[1].to_dense().astype(np.float64) for part in alone)
    close(unlimited.voxelise()[1].to_dense(), parts)


@settings(max_examples=30)
@given(scenes(), seeds)
def test_rotating_a_scene_rotates_its_forces(scene: HapticScene, seed: int) -> None:
    rng = np.random.default_rng(seed)
    turn, shift = Rotation.random(random_state=rng), rng.normal(size=3)
    objects = []
    for obj in scene.objects:
        q = turn * Rotation.from_matrix(obj.track.rotations())
        track = PoseTrack(q.as_quat()[:, [3, 0, 1, 2]], turn.apply(np.array(obj.track.positions_m)) + shift)
        objects.append(replace(obj, track=track))
    rotated = replace(scene, objects=tuple(objects), surface_damping_n_s_per_m=0.0)
    points = rng.normal(0, 0.1, (50, 3))
    original = replace(scene, surface_damping_n_s_per_m=0.0).sample_n(1, points)
    close(rotated.sample_n(1, turn.apply(points) + shift), turn.apply(original.astype(np.float64)))


def sphere(h: float = 0.002, radius_m: float = 0.02) -> ForceField:
    """A penalty wall of 1 N within 6 mm behind the surface of a ball."""
    grid = Grid.over_box((-1.2 * radius_m,) * 3, (1.2 * radius_m,) * 3, (round(2.4 * radius_m / h),) * 3)
    points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1))
    distance = np.linalg.norm(points, axis=-1, keepdims=True)
    depth = radius_m - distance
    return ForceField.from_dense(grid, np.where((depth > 0) & (depth < 0.006), points / distance, 0.0))


def moving(damping: float, velocity_m_s: float = 0.4, spin_rad_s: float = 9.0) -> HapticScene:
    """A ball that moves along x and spins about z."""
    times = np.arange(-2, 3) / RATE_HZ
    turns = Rotation.from_rotvec(times[:, None] * np.array([0.0, 0.0, spin_rad_s]))
    track = PoseTrack(turns.as_quat()[:, [3, 0, 1, 2]], times[:, None] * np.array([velocity_m_s, 0.0, 0.0]))
    ball = HapticObject("ball", HapticMedium.from_frames([sphere()], RATE_HZ), track)
    return HapticScene(WORKSPACE, RATE_HZ, (ball,), 100.0, damping)


def test_a_moving_surface_drags_a_resting_hand() -> None:
    on_top = [0.0, 0.0, 0.018]  # omega x r is zero there, and the wall pushes along z
    dragged, undamped = moving(2.0).sample_n(2, on_top), moving(0.0).sample_n(2, on_top)
    assert undamped[2] > 0.5
    np.testing.assert_allclose(dragged - undamped, [0.8, 0.0, 0.0], atol=1e-6)  # b v = 2 N s/m * 0.4 m/s
    at_side = [0.0, 0.018, 0.0]  # omega x r = 9 * 0.018 m/s backwards
    added = moving(2.0).sample_n(2, at_side) - moving(0.0).sample_n(2, at_side)
    np.testing.assert_allclose(added, [2 * (0.4 - 9 * 0.018), 0.0, 0.0], atol=1e-6)


def test_a_comoving_hand_feels_no_drag_with_the_damping_of_the_receiver() -> None:
    damping, points = 1.5, np.random.default_rng(7).normal(0, 0.012, (200, 3))
    touched = moving(0.0).sample_n(2, points).any(axis=-1)
    assert 20 < touched.sum() < 200
    hand_m_s = np.array([0.4, 0.0, 0.0]) + np.cross([0.0, 0.0, 9.0], points)
    total_n = moving(damping).sample_n(2, points) - damping * hand_m_s
    np.testing.assert_allclose(total_n[touched], moving(0.0).sample_n(2, points)[touched], atol=2e-6)
    assert not moving(damping).sample_n(2, points)[~touched].any()


def scene_of(field: ForceField, position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> HapticScene:
    obj = HapticObject("one", HapticMedium.from_frames([field], RATE_HZ), PoseTrack.constant(1, position_m))
    return HapticScene(WORKSPACE, RATE_HZ, (obj,), 3.0)


def test_an_empty_scene_and_one_outside_the_lattice_have_no_force() -> None:
    grid = Grid((9, 9, 9), (0.01,) * 3, (0.0,) * 3)
    for scene in (scene_of(ForceField.empty(grid)), scene_of(sphere(), (3.0, 0.0, 0.0))):
        assert scene.voxelise()[0] == ForceField.empty(WORKSPACE)
        assert not scene.sample_n(0, np.zeros((5, 3))).any()
    assert scene_of(sphere()).sample_n(0, np.zeros((0, 3))).shape == (0, 3)


def test_a_coinciding_lattice_returns_the_field_itself() -> None:
    field = sphere()
    scene = scene_of(field, (0.25, -1.0, 0.375))
    grid = replace(field.grid, origin_m=tuple(np.add(field.grid.origin_m, (0.25, -1.0, 0.375))))
    found = scene.voxelise(grid)[0]
    np.testing.assert_array_equal(
        found.positions(), field.positions()
    )  # rounding adds no force next to the support
    close(found.to_dense(), field.to_dense())


def test_memory_depends_on_bricks_not_on_their_distance() -> None:
    corners = np.array([[0, 0, 0], [2**20 - 1] * 3])
    grid = Grid((2**20,) * 3, (1e-3,) * 3, (0.0,) * 3)
    scene = scene_of(ForceField.from_support(grid, corners, [[1, 0, 0], [0, 2, 0]]))
    points = grid.to_m(corners + np.array([[-0.5, 0, 0], [0.25, 0, 0]]))
    close(scene.sample_n(0, points), np.array([[0.5, 0, 0], [0, 1.5, 0]]))
    window = Grid((16,) * 3, grid.spacing_m, tuple(grid.to_m(corners[1] - 8)))
    assert scene.voxelise(window)[0].positions().tolist() == [[8, 8, 8]]


def test_positions_that_are_not_finite_have_no_force() -> None:
    points = np.array([[np.nan, 0, 0], [np.inf, 0, 0], [0, -np.inf, 0], [1e300, 1e300, 0]])
    assert not scene_of(sphere()).sample_n(0, points).any()


def test_invalid_frames_points_and_objects_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_of(sphere())
    for frame in (-1, 1):
        with pytest.raises(InvalidArgument, match=f"frame: found {frame}; expected 0 to 0"):
            scene.sample_n(frame, [0.0, 0.0, 0.0])
    with pytest.raises(InvalidArgument, match="positions_m"):
        scene.sample_n(0, [0.0, 0.0])
    obj, point = scene.objects[0], scene.grid.to_m(scene.voxelise()[0].positions()[0])
    fine = replace(scene, grid=Grid((8 * 4097, 1, 1), (1e-9,) * 3, tuple(point)), file_bytes=0)
    with pytest.raises(CorruptFile, match="more than 4096 bricks"):
        fine.voxelise()[0]
    assert replace(scene, file_bytes=0).voxelise(fine.grid)[0].support_count == 8 * 4097
    for change, found in (
        ({"track": PoseTrack.constant(2)}, "object one: found 2 poses; expected 1"),
        (
            {"medium": HapticMedium.from_frames([sphere()] * 2, 1.0)},
            "object one: found 2 fields; expected 1 or 1",
        ),
    ):
        with pytest.raises(InvalidArgument, match=found):
            replace(scene, objects=(obj, replace(obj, **change)))  # type: ignore[arg-type]
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.0001")
    with pytest.raises(InvalidArgument, match=r"haptic objects.*GiB"):
        scene_of(sphere()).sample_n(0, [0.0, 0.0, 0.0])
    with pytest.raises(InvalidArgument, match=r"grid shape.*bricks"):
        scene_of(ForceField.empty(WORKSPACE)).voxelise(Grid((2**20,) * 3, (1e-3,) * 3, (0.0,) * 3))[0]


@pytest.mark.parametrize(
    "change",
    [
        {"surface_damping_n_s_per_m": -1.0},
        {"surface_damping_n_s_per_m": np.inf},
        {"rate_hz": 0.0},
        {"rate_hz": np.nan},
        {"force_max_n": 0.0},
        {"objects": ()},
    ],
)
def test_scenes_with_out_of_range_numbers_are_refused(change: dict[str, object]) -> None:
    with pytest.raises(InvalidArgument, match=next(iter(change))):
        replace(scene_of(sphere()), **change)


def test_extreme_damping_and_speed_never_give_a_nan_force() -> None:
    """A file may contain any finite damping and poses 2^50 m apart; no NaN may reach the receiver's motor."""
    track = PoseTrack(
        np.tile([1.0, 0.0, 0.0, 0.0], (2, 1)), np.array([[0.0, 0.0, 0.0], [2.0**50, -(2.0**50), 0.0]])
    )
    scene = scene_of(sphere())
    wild = replace(scene, objects=(replace(scene.objects[0], track=track),), surface_damping_n_s_per_m=1e300)
    force_n = wild.sample_n(0, scene.grid.to_m(scene.voxelise()[0].positions()))
    assert len(force_n) and np.isfinite(force_n).all() and np.isfinite(wild.voxelise()[0].forces_n).all()
    assert (np.linalg.norm(force_n, axis=1) <= scene.force_max_n).all()


@settings(max_examples=10)
@given(scenes())
def test_the_number_of_threads_does_not_matter(scene: HapticScene) -> None:
    with pytest.MonkeyPatch.context() as patch:
        fields = []
        for threads in ("1", "3"):
            patch.setenv("TOUCHFIELD_THREADS", threads)
            fields.append(replace(scene).voxelise()[1])
    assert fields[0] == fields[1]

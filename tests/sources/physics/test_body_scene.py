"""Moving bodies: against the formula at every sample, against transformed fields, and their properties."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.sources.laws import ForceProfile
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.scene import Body, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Plane, Sphere, Superquadric

RATE_HZ = 100.0
GRID = Grid((45, 50, 41), (0.004, 0.0035, 0.0045), (-0.09, -0.085, -0.095))
WALL = ForceProfile(((-0.012, -0.004, 2.0, 0.0), (-0.004, 0.0, 0.0, -500.0)))
"""500 N/m up to 2 N, 12 mm thick."""
SHELL = ForceProfile(((-0.008, 0.01, 1.0, -100.0),))
"""From 8 mm within the surface to 10 mm outside."""

BALL = AnalyticScene([Sphere((0.0, 0.0, 0.0), 0.03)])
BOX = AnalyticScene([Box((0.005, 0.0, -0.004), (0.03, 0.02, 0.025), (10.0, 40.0, -20.0))], combine="union")
PILL = AnalyticScene([Superquadric((0.0, 0.0, 0.0), (0.03, 0.02, 0.015), (1.4, 1.7))])
FLOOR = AnalyticScene([Plane((0.0, 0.0, -0.06), (0.0, 0.0, 1.0))])
TETRA = (
    np.array([[0, 0, 0], [0.06, 0, 0], [0.01, 0.05, 0], [0.02, 0.01, 0.055]]) - 0.02,
    np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]),
)

seeds = st.integers(0, 2**32 - 1)


def track(seed: int, count: int = 3, spread_m: float = 0.04) -> PoseTrack:
    rng = np.random.default_rng(seed)
    return PoseTrack(
        Rotation.random(count, random_state=rng).as_quat(), rng.uniform(-spread_m, spread_m, (count, 3))
    )


def samples(grid: Grid) -> np.ndarray:
    return grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)).reshape(-1, 3)


def by_formula(scene: AnalyticScene, poses: PoseTrack, frame: int, profile: ForceProfile) -> np.ndarray:
    """The forces of a body at all samples, evaluated in its frame and rotated."""
    forces_n = scene.forces_n(poses.to_body(samples(GRID), frame), profile)
    return (forces_n @ poses.rotation(frame).T).reshape(*GRID.shape, 3)


@settings(max_examples=6)
@given(seeds, st.sampled_from([WALL, SHELL]), st.integers(0, 2))
def test_the_field_is_the_sum_of_the_formulas(seed: int, profile: ForceProfile, frame: int) -> None:
    bodies = [
        Body(str(n), scene, track(seed + n, spread_m=0.08)) for n, scene in enumerate((BALL, BOX, PILL))
    ]
    bodies.append(Body("floor", FLOOR, PoseTrack.constant(3)))
    field = BodyScene(bodies, RATE_HZ).field(frame, GRID, profile)
    expected = sum(by_formula(body.scene, body.track, frame, profile) for body in bodies)  # type: ignore[arg-type]
    off = np.abs(field.to_dense() - expected).max(axis=-1) > 1e-5
    assert off.sum() <= 2  # samples on an edge of the law, or equally near to two faces of the box
    assert field.forces_n.any(axis=(1, 2, 3, 4)).all()


@settings(max_examples=15)
@given(seeds, st.sampled_from([WALL, SHELL]))
def test_a_mesh_as_a_body_equals_the_posed_mesh(seed: int, profile: ForceProfile) -> None:
    poses = track(seed, 1, 0.07)
    field = BodyScene([Body("tetra", MeshScene(*TETRA), poses)], RATE_HZ).field(0, GRID, profile)
    expected_field = MeshScene(poses.to_scene(TETRA[0], 0), TETRA[1]).field(0, GRID, profile)
    np.testing.assert_array_equal(field.positions(), expected_field.positions())
    np.testing.assert_allclose(field.to_dense(), expected_field.to_dense(), atol=1e-6)


@settings(max_examples=20)
@given(seeds, st.sampled_from([BALL, BOX, PILL, FLOOR]))
def test_a_moved_scene_of_shapes(seed: int, scene: AnalyticScene) -> None:
    poses = track(seed, 1)
    points = np.random.default_rng(seed).normal(0, 0.03, (100, 3))
    moved = scene.moved(poses.rotation(0), poses.positions_m[0])
    expected = scene.forces_n(points, SHELL) @ poses.rotation(0).T
    off = np.abs(moved.forces_n(poses.to_scene(points, 0), SHELL) - expected).max(axis=1) > 1e-9
    assert off.sum() <= 1
    again = moved.moved(poses.rotation(0), poses.positions_m[0])
    np.testing.assert_allclose(again.placed(points), poses.to_scene(poses.to_scene(points, 0), 0), atol=1e-12)
    assert (moved.combine, moved.axes, moved.rate_hz) == (scene.combine, scene.axes, scene.rate_hz)


@settings(max_examples=20)
@given(seeds, st.booleans())
def test_a_moved_mesh(seed: int, is_open: bool) -> None:
    vertices, faces = TETRA
    selected_faces = faces[1:] if is_open else faces
    scene, poses = MeshScene(vertices, selected_faces, name="tent"), track(seed, 1)
    scene.field(0, GRID, SHELL)  # cached data of the mesh at rest must not be used for the moved one
    moved = scene.moved(poses.rotation(0), poses.positions_m[0])
    rebuilt = MeshScene(poses.to_scene(vertices, 0), selected_faces)
    assert (moved.is_closed, moved.is_one_sided, moved.name) == (
        rebuilt.is_closed,
        rebuilt.is_one_sided,
        "tent",
    )
    np.testing.assert_allclose(moved.bounds_m(), rebuilt.bounds_m(), atol=1e-12)
    found, expected = (mesh_scene.field(0, GRID, SHELL).to_dense() for mesh_scene in (moved, rebuilt))
    off = np.abs(found - expected).max(axis=-1) > 1e-5
    assert off.sum() <= 2  # a sample equally near to two faces
    assert expected.any()


def test_an_invalid_motion_is_refused() -> None:
    for scene in (BALL, MeshScene(*TETRA)):
        for matrix in (np.diag([1.0, 1.0, -1.0]), np.eye(3) * 2, np.full((3, 3), np.nan), np.eye(2)):
            with pytest.raises(InvalidArgument, match="rotation"):
                scene.moved(matrix, np.zeros(3))


# -- the two representations -------------------------------------------------------------------------------

BODY_GRID = Grid.over_box((-0.048,) * 3, (0.048,) * 3, (48,) * 3)
"""The lattice of each body, 2 mm."""
DIAGONAL_M = 0.002 * 3**0.5


def carried(bodies: list[Body], profile: ForceProfile, force_max_n: float = 100.0) -> HapticScene:
    """The fields of the bodies, each on the lattice of its own frame."""
    objects = []
    for body in bodies:
        medium = HapticMedium.from_frames([body.scene.field(0, BODY_GRID, profile)], RATE_HZ)
        objects.append(HapticObject(body.name, medium, body.track))
    damping = profile.surface_damping_n_s_per_m
    return HapticScene(GRID, RATE_HZ, tuple(objects), force_max_n, damping)


@settings(max_examples=6)
@given(seeds, st.sampled_from([BALL, BOX]))
def test_both_representations_have_their_edges_within_one_voxel(seed: int, scene: AnalyticScene) -> None:
    """Interpolation has a force where a corner of the cell has one: at most a voxel's diagonal
    beyond the edge.
    """
    bodies = [Body("one", scene, track(seed, 2))]
    evaluated = BodyScene(bodies, RATE_HZ).field(1, GRID, WALL)
    points = samples(GRID)
    body_points = bodies[0].track.to_body(points, 1)
    phi, _ = scene.shapes[0].signed_distance_and_normal(body_points)
    has_ours, has_other = (
        dense.any(axis=-1).reshape(-1)
        for dense in (evaluated.to_dense(), carried(bodies, WALL).voxelise()[1].to_dense())
    )
    from_edge = np.minimum(np.abs(phi), np.abs(phi - WALL.low_m))
    assert has_ours.sum() > 1000
    assert from_edge[has_ours != has_other].max(initial=0.0) <= DIAGONAL_M


@settings(max_examples=6)
@given(seeds)
def test_both_representations_agree_to_the_voxel_size(seed: int) -> None:
    """Away from the edges they differ by at most L times a voxel's diagonal, L the Lipschitz
    constant of the law.
    """
    bodies = [Body("one", BALL, track(seed, 2))]
    evaluated = BodyScene(bodies, RATE_HZ).field(1, GRID, WALL).to_dense().reshape(-1, 3)
    composed = carried(bodies, WALL).voxelise()[1].to_dense().reshape(-1, 3)
    depth = 0.03 - np.linalg.norm(bodies[0].track.to_body(samples(GRID), 1), axis=-1)
    inside = (depth > DIAGONAL_M) & (depth < 0.012 - DIAGONAL_M)
    lipschitz = max(500.0, 2.0 / (0.03 - 0.012))  # the slope along the normal; F over the radius across it
    assert inside.sum() > 500
    assert np.linalg.norm(evaluated - composed, axis=1)[inside].max() <= lipschitz * DIAGONAL_M
    assert np.linalg.norm(evaluated, axis=1)[inside].min() > 0.5


def test_both_representations_converge_on_finer_lattices() -> None:
    """Away from edges and knee the difference is proportional to the squared spacing."""
    smooth = ForceProfile(((-0.025, 0.0, 0.0, -80.0),))
    poses = track(11, 1, 0.01)
    points = poses.to_scene(Rotation.random(400, random_state=1).apply([0.021, 0, 0]), 0)
    exact = BALL.moved(poses.rotation(0), poses.positions_m[0]).forces_n(points, smooth)
    worst = []
    for count in (24, 48, 96):
        grid = Grid.over_box((-0.048,) * 3, (0.048,) * 3, (count,) * 3)
        obj = HapticObject("ball", HapticMedium.from_frames([BALL.field(0, grid, smooth)], RATE_HZ), poses)
        worst.append(np.abs(HapticScene(GRID, RATE_HZ, (obj,), 50.0).sample_n(0, points) - exact).max())
    assert worst[0] > 3 * worst[1] > 9 * worst[2]


def test_surface_damping_is_equal_in_both_representations() -> None:
    profile = replace(WALL, surface_damping_n_s_per_m=0.7)
    bodies = [Body("ball", BALL, track(3)), Body("box", BOX, track(4))]
    for frame in range(3):
        fields = [BodyScene(bodies, RATE_HZ).field(frame, GRID, law).to_dense() for law in (profile, WALL)]
        added = (fields[0] - fields[1]).reshape(-1, 3)
        ways = [carried(bodies, law).voxelise()[frame].to_dense() for law in (profile, WALL)]
        others = (ways[0] - ways[1]).reshape(-1, 3)
        # away from edges, a body has a force in both representations or in none
        phis = [np.abs(_phi(body, frame)) for body in bodies]
        phis += [np.abs(_phi(body, frame) - WALL.low_m) for body in bodies]
        inside = np.min(phis, axis=0) > DIAGONAL_M
        np.testing.assert_allclose(added[inside], others[inside], atol=2e-4)
        assert np.abs(added[inside]).max() > 1


def _phi(body: Body, frame: int) -> np.ndarray:
    assert isinstance(body.scene, AnalyticScene)
    body_points = body.track.to_body(samples(GRID), frame)
    return body.scene.shapes[0].signed_distance_and_normal(body_points)[0]


# -- surface damping ---------------------------------------------------------------------------------------


def test_a_moving_body_drags_a_resting_hand() -> None:
    times = np.arange(3) / RATE_HZ
    turns = Rotation.from_rotvec(times[:, None] * np.array([0.0, 0.0, 6.0]))
    flight = PoseTrack(turns.as_quat()[:, [3, 0, 1, 2]], times[:, None] * np.array([0.5, 0.0, 0.0]))
    bodies = [Body("ball", BALL, flight), Body("floor", FLOOR, PoseTrack.constant(3))]
    damped = replace(WALL, surface_damping_n_s_per_m=3.0)
    at_rest, dragged = (BodyScene(bodies, RATE_HZ).field(1, GRID, law).to_dense() for law in (WALL, damped))
    ball = BodyScene([Body("ball", BALL, flight)], RATE_HZ).field(1, GRID, WALL).to_dense().any(axis=-1)
    from_origin = samples(GRID).reshape(*GRID.shape, 3) - flight.positions_m[1]
    surface_m_s = np.array([0.5, 0.0, 0.0]) + np.cross([0.0, 0.0, 6.0], from_origin)
    np.testing.assert_allclose((dragged - at_rest)[ball], 3.0 * surface_m_s[ball], atol=3e-6)
    np.testing.assert_array_equal(dragged[~ball], at_rest[~ball])  # the floor is static
    assert (dragged - at_rest)[ball][:, 0].mean() > 1


# -- bounds ------------------------------------------------------------------------------------------------


@settings(max_examples=20)
@given(seeds)
def test_the_bounds_contain_every_body_in_every_frame(seed: int) -> None:
    bodies = [Body("box", BOX, track(seed, 4)), Body("tetra", MeshScene(*TETRA), track(seed + 1, 4))]
    low, high = BodyScene(bodies, RATE_HZ).bounds_m()
    corners = np.stack(np.meshgrid(*[[0, 1]] * 3, indexing="ij"), axis=-1).reshape(8, 3)
    every = [
        body.track.to_scene(np.take_along_axis(body.scene.bounds_m(), corners, axis=0), frame)
        for body in bodies
        for frame in range(4)
    ]
    np.testing.assert_allclose(low, np.min(every, axis=(0, 1)), atol=1e-12)
    np.testing.assert_allclose(high, np.max(every, axis=(0, 1)), atol=1e-12)


def test_a_plane_counts_with_its_point_among_others() -> None:
    ball, floor = (
        Body("ball", BALL, PoseTrack.constant(2)),
        Body("floor", FLOOR, PoseTrack.constant(2, (0.1, 0.0, 0.0))),
    )
    bounds = BodyScene([ball, floor], RATE_HZ).bounds_m()
    np.testing.assert_allclose(bounds, [[-0.03, -0.03, -0.06], [0.1, 0.03, 0.03]])
    np.testing.assert_allclose(
        BodyScene([floor], RATE_HZ).bounds_m(), FLOOR.bounds_m() + np.array([0.1, 0.0, 0.0])
    )


# -- caches and invalid scenes -----------------------------------------------------------------------------


class Counted(Scene):
    """A ball that counts its evaluations; with several frames it grows. It cannot be moved."""

    def __init__(self, frame_count: int = 1) -> None:
        self.frame_count, self.evaluations = frame_count, 0

    def bounds_m(self) -> np.ndarray:
        return BALL.bounds_m()

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        self.evaluations += 1
        return AnalyticScene([Sphere((0.0, 0.0, 0.0), 0.02 + 0.01 * frame)]).field(0, grid, profile)


def test_static_bodies_are_evaluated_once() -> None:
    ball = Counted()
    bodies = [Body("still", ball, PoseTrack.constant(3)), Body("box", BOX, track(5))]
    scene = BodyScene(bodies, RATE_HZ)
    first = [scene.field(frame, GRID, WALL) for frame in (0, 1, 2, 0)]
    assert ball.evaluations == 1
    assert first[0] == first[3] != first[1]
    scene.field(0, GRID, SHELL)
    assert ball.evaluations == 2
    other = scene.field(0, GRID.refined(1).moved(1.0, (0.001, 0.0, 0.0)), SHELL)
    assert ball.evaluations == 3 and other.grid != GRID
    assert scene.field(0, GRID, WALL) == first[0]


def test_a_deforming_body_uses_its_frame() -> None:
    scene = BodyScene([Body("grows", Counted(3), PoseTrack.constant(3))], RATE_HZ)
    for frame in range(3):
        assert scene.field(frame, GRID, WALL) == Counted(3).field(frame, GRID, WALL)
    first, _, last = (scene.field(frame, GRID, WALL).support_count for frame in range(3))
    assert first < last
    with pytest.raises(InvalidArgument, match="rigid motion"):
        BodyScene([Body("grows", Counted(3), PoseTrack.constant(3, (0.1, 0, 0)))], RATE_HZ).field(
            1, GRID, WALL
        )


def test_bodies_beyond_the_lattice_and_on_its_border() -> None:
    away = Body("away", MeshScene(*TETRA), PoseTrack.constant(2, (1.0, 0.0, 0.0)))
    assert BodyScene([away], RATE_HZ).field(1, GRID, WALL) == ForceField.empty(GRID)
    low, high = GRID.box_m
    for corner in (low, high):
        poses = PoseTrack(track(8, 2).quaternions, np.stack([corner, corner]))
        field = BodyScene([Body("ball", BALL, poses)], RATE_HZ).field(1, GRID, WALL)
        np.testing.assert_allclose(field.to_dense(), by_formula(BALL, poses, 1, WALL), atol=1e-5)
        assert field.support_count > 100


def test_invalid_scenes_are_refused() -> None:
    ball = Body("ball", BALL, PoseTrack.constant(3))
    for frame in (-1, 3):
        with pytest.raises(InvalidArgument, match=f"frame: found {frame}; expected 0 to 2"):
            BodyScene([ball], RATE_HZ).field(frame, GRID, WALL)
    with pytest.raises(InvalidArgument, match="bodies"):
        BodyScene([], RATE_HZ)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        BodyScene([ball], 0.0)
    with pytest.raises(InvalidArgument, match="body short: found 2 poses"):
        BodyScene([ball, Body("short", BALL, PoseTrack.constant(2))], RATE_HZ)
    for count in (2, 4):
        with pytest.raises(InvalidArgument, match=f"body grows: found {count} frames"):
            BodyScene([ball, Body("grows", Counted(count), PoseTrack.constant(3))], RATE_HZ)

"""The metric reading of depth maps: normals, closed forms, invalid depth, moving cameras, any grid."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from PIL import Image

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import Grid
from touchfield.sources.camera import DepthSequence, Intrinsics, noise_step_per_m
from touchfield.sources.depth import depth_scene
from touchfield.sources.depth.depth_scene import DepthScene, plane_forces
from touchfield.sources.depth.kernels.planes import SurfacePlanes, surface_planes
from touchfield.sources.laws import ForceProfile

CAMERA = Intrinsics(131.0, 129.0, 80.3, 59.6)
SIZE = (120, 161)  # not whole tiles, not whole vectors
WALL = ForceProfile(((-0.1, -0.05, 2.5, 0.0), (-0.05, 0.0, 0.0, -50.0)))
SOLID = ForceProfile(((-np.inf, -0.05, 2.5, 0.0), (-0.05, 0.0, 0.0, -50.0)))
GUIDE = ForceProfile(((-0.02, 0.0, 0.0, -10.0), (0.0, 0.04, 0.8, -20.0), (0.04, 0.06, 0.1, 0.0)))
FINEST = 5e-4  # the noise step of exact depth


class Frames(DepthSequence):
    """Depth maps in memory, with a count of reads."""

    def __init__(
        self, frames: list[np.ndarray], camera: Intrinsics = CAMERA, poses: np.ndarray | None = None
    ) -> None:
        self.frames, self.intrinsics, self.poses = frames, camera, poses
        self.name, self.rate_hz, self.frame_count = "frames", 30.0, len(frames)
        self.height, self.width = frames[0].shape
        self.reads = 0

    def depth_m(self, frame: int) -> np.ndarray:
        self.reads += 1
        return self.frames[frame]


def rays(camera: Intrinsics = CAMERA, size: tuple[int, int] = SIZE) -> np.ndarray:
    """Directions with z = 1 through the pixel centres, [height, width, 3]."""
    v, u = np.mgrid[: size[0], : size[1]]
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(size)], axis=-1)


def plane_depth(normal: np.ndarray, offset_m: float, directions: np.ndarray) -> np.ndarray:
    """Depth of the plane n . p = offset, 0 where a ray does not meet it."""
    along = directions @ normal
    hit = along * np.sign(offset_m) > 1e-9
    return np.where(hit, offset_m / np.where(hit, along, 1), 0).astype(np.float32)


def sphere(centre: np.ndarray, radius_m: float, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth of a sphere (0 outside it) and its normals."""
    along, square = directions @ centre, (directions**2).sum(-1)
    inside = along**2 - square * (centre @ centre - radius_m**2)
    depth = np.where(inside > 0, (along - np.sqrt(np.maximum(inside, 0))) / square, 0)
    return depth.astype(np.float32), (directions * depth[..., None] - centre) / radius_m


def normals_of(surface: SurfacePlanes) -> np.ndarray:
    """Unit normals towards the camera, [height, width, 3]; zero where there is no plane."""
    return surface.planes[:-4].reshape(*surface.size_px, 4)[..., :3]


def offsets_m_of(surface: SurfacePlanes) -> np.ndarray:
    """c of n . p = c, metres, [height, width]; zero where there is no plane."""
    return surface.planes[3:-4:4].reshape(surface.size_px)


def rotation_about(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """A rotation matrix."""
    x, y, z = np.asarray(axis) / np.linalg.norm(axis)
    cross = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross


def pose_of(turn: np.ndarray, position_m: tuple[float, float, float]) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, :3], pose[:3, 3] = turn, position_m
    return pose


def angles_deg(surface: SurfacePlanes, normals: np.ndarray) -> np.ndarray:
    """Angle between the estimated and the true normals, degrees; nan where there is none."""
    chord = np.linalg.norm(normals_of(surface).astype(np.float64) - normals, axis=-1)
    return np.where(offsets_m_of(surface) < 0, np.degrees(2 * np.arcsin(np.minimum(chord / 2, 1))), np.nan)


def reference(
    surface: SurfacePlanes, pose: np.ndarray, grid: Grid, profile: ForceProfile
) -> tuple[np.ndarray, ...]:
    """The field on the complete grid in double precision, and where rounding may decide otherwise."""
    points = grid.to_m(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1))
    p = (points - pose[:3, 3]) @ pose[:3, :3]
    z = p[..., 2]
    front = z > 1e-12  # a pixel nearer than that may overflow; all such samples are uncertain below
    fx, fy, cx, cy = surface.camera_px.astype(np.float64)
    pixel = p[..., :2] / np.where(front, z, 1)[..., None] * (fx, fy) + (cx + 0.5, cy + 0.5)
    height, width = surface.size_px
    inside = front & (pixel >= 0).all(-1) & (pixel < (width, height)).all(-1)
    u, v = np.floor(np.where(inside[..., None], pixel, 0)).astype(int).transpose(3, 0, 1, 2)
    plane = surface.planes.reshape(-1, 4)[np.where(inside, v * width + u, height * width)].astype(np.float64)
    facing = (p * plane[..., :3]).sum(-1)
    phi = facing - plane[..., 3]
    limit = np.where(phi <= 0, max(-profile.low_m, 0), max(profile.high_m, 0))
    with np.errstate(invalid="ignore"):
        reach = np.where(facing < 0, -4 * facing * limit, -1)
    is_supported = (facing < 0) & (z * np.abs(phi) <= reach)
    force = np.where(is_supported, profile(phi), 0)[..., None] * plane[..., :3] @ pose[:3, :3].T
    edges = [e for piece in profile.pieces for e in piece[:2] if np.isfinite(e)]
    doubtful = np.abs(phi[..., None] - edges).min(-1) < 1e-5
    doubtful |= (np.abs(pixel - np.round(pixel)) < 1e-3).any(-1) | (np.abs(z) < 1e-4)
    doubtful |= np.abs(z * np.abs(phi) - reach) < 1e-5
    return force, doubtful


def room_depth(directions: np.ndarray, pose: np.ndarray) -> np.ndarray:
    """Depth of three walls and a floor for a camera at `pose`."""
    turn, position = pose[:3, :3], pose[:3, 3]
    best = np.full(directions.shape[:2], np.inf)
    for normal, offset in (
        ((0, 0, -1), -2.0),
        ((0, -1, 0), -0.6),
        ((-0.8, 0, -0.6), -1.5),
        ((0.8, 0, -0.6), -1.5),
    ):
        n = np.array(normal, float)
        depth = plane_depth(n @ turn, offset - n @ position, directions)
        best = np.where((depth > 0) & (depth < best), depth, best)
    return np.where(np.isfinite(best), best, 0).astype(np.float32)


# -- normals -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0, -1), (-0.3, 0.9, -1), (1.5, -1.0, -1)])
def test_planes_are_found_exactly_up_to_the_border(normal: tuple[float, ...]) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    depth = plane_depth(n, -0.8, rays())
    surface = surface_planes(depth, CAMERA, FINEST)
    steep = (rays() @ n) / np.linalg.norm(rays(), axis=-1) > -0.2
    assert (offsets_m_of(surface) < 0)[(depth > 0) & (depth < 4) & ~steep].all()
    assert np.nanmax(np.where(depth < 4, angles_deg(surface, n), np.nan)) < 0.02
    np.testing.assert_allclose(
        offsets_m_of(surface)[(offsets_m_of(surface) < 0) & (depth < 4)], -0.8, atol=1e-4
    )


@pytest.mark.parametrize(("sigma_per_m", "bound_deg"), [(0.001, 2.5), (0.0025, 6.0)])
@pytest.mark.parametrize("normal", [(0, 0, -1), (0.4, 0.5, -1), (-1.0, 0.3, -1)])
def test_noisy_planes(normal: tuple[float, ...], sigma_per_m: float, bound_deg: float) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    camera = Intrinsics(525, 525, 159.5, 119.5)
    exact = plane_depth(n, -1.0, rays(camera, (240, 320)))
    depth = (exact + sigma_per_m * exact**2 * np.random.default_rng(1).normal(size=exact.shape)).astype(
        np.float32
    )
    surface = surface_planes(depth, camera, noise_step_per_m(depth))
    error = angles_deg(surface, n)
    assert np.nanmean(error) < bound_deg
    assert np.isfinite(error).mean() > 0.98
    plain = np.arctan(525 * sigma_per_m / np.sqrt(2))  # the error of differences of single pixels
    assert np.nanmean(error) < 0.25 * np.degrees(plain)
    away = np.abs(depth - exact).mean()
    found = offsets_m_of(surface) / np.where(
        offsets_m_of(surface) < 0, (normals_of(surface) * rays(camera, (240, 320))).sum(-1), 1
    )
    assert (
        np.abs(found - exact)[offsets_m_of(surface) < 0].mean() < 0.4 * away
    )  # the surface is smoothed, too


def test_noisy_sphere_before_a_wall() -> None:
    camera = Intrinsics(525, 525, 159.5, 119.5)
    directions = rays(camera, (240, 320))
    ball, normals = sphere(np.array([0.02, -0.01, 1.0]), 0.15, directions)
    exact = np.where(ball > 0, ball, np.float32(1.6))
    depth = (exact + 0.001 * exact**2 * np.random.default_rng(2).normal(size=exact.shape)).astype(np.float32)
    surface = surface_planes(depth, camera, noise_step_per_m(depth))
    on_ball = np.where(ball > 0, angles_deg(surface, normals), np.nan)
    on_wall = np.where(ball > 0, np.nan, angles_deg(surface, np.array([0, 0, -1.0])))
    assert np.nanmean(on_ball) < 4.0 and np.nanmean(on_wall) < 4.0
    facing = (normals * directions).sum(-1) < -0.5 * np.linalg.norm(directions, axis=-1)
    assert np.isfinite(on_ball)[(ball > 0) & facing].mean() > 0.97
    assert np.nanpercentile(on_wall, 99.9) < 20  # no normal of the wall leans towards the ball


@given(st.floats(0.6, 3.0), st.floats(0.02, 1.0), st.integers(20, 140), st.booleans())
def test_a_step_tilts_no_normal(depth_m: float, relative_step: float, at: int, upright: bool) -> None:
    step = max(0.06 * depth_m, relative_step)  # more than 5 pixel footprints
    depth = np.full((161, 161), depth_m, np.float32)
    depth[:, at:] += np.float32(step)
    depth = np.ascontiguousarray(depth if upright else depth.T)
    surface = surface_planes(depth, CAMERA, FINEST)
    assert (offsets_m_of(surface) < 0).all()
    assert angles_deg(surface, np.array([0, 0, -1.0])).max() < 0.05
    np.testing.assert_allclose(offsets_m_of(surface), -depth, rtol=1e-5)


def test_a_step_between_slanted_planes_tilts_no_normal() -> None:
    near_normal, far_normal = (np.array(n) / np.linalg.norm(n) for n in ((0.5, 0.2, -1), (-0.8, 0.4, -1)))
    a, b = plane_depth(near_normal, -0.8, rays()), plane_depth(far_normal, -1.4, rays())
    is_left = (np.indices(SIZE)[1] + np.indices(SIZE)[0] / 3) < 90  # an oblique silhouette
    surface = surface_planes(np.where(is_left, a, b), CAMERA, FINEST)
    error = np.where(is_left, angles_deg(surface, near_normal), angles_deg(surface, far_normal))
    assert np.nanmax(error) < 0.1
    assert np.isfinite(error).mean() > 0.97


def test_too_little_support_gives_no_normal() -> None:
    depth = np.zeros(SIZE, np.float32)
    depth[60, 10:60] = 1  # a line one pixel high
    depth[10:50, 100:102] = 1  # a bar two pixels wide
    depth[100, 100] = 1
    depth[80:83, 120:123] = 1  # the smallest patch that has a normal
    surface = surface_planes(depth, CAMERA, FINEST)
    found = np.argwhere(offsets_m_of(surface) < 0)
    assert set(map(tuple, found)) <= {(v, u) for v in range(80, 83) for u in range(120, 123)}
    assert (81, 121) in set(map(tuple, found))


def test_depth_that_is_no_number_has_no_plane() -> None:
    depth = np.ones(SIZE, np.float32)
    depth[50, 50:55] = (np.nan, np.inf, -np.inf, -1, 0)
    surface = surface_planes(depth, CAMERA, FINEST)
    assert np.isfinite(surface.planes).all()
    assert (offsets_m_of(surface) == 0).sum() == 5 and (offsets_m_of(surface)[50, 50:55] == 0).all()


def test_the_noise_step_follows_the_noise_and_not_the_edges() -> None:
    exact = room_depth(rays(), np.eye(4))
    assert noise_step_per_m(exact) == pytest.approx(FINEST)
    noise = np.random.default_rng(0).normal(size=SIZE).astype(np.float32)
    steps = [noise_step_per_m(exact + np.float32(s) * exact**2 * noise) for s in (0.001, 0.002, 0.02)]
    assert steps[1] == pytest.approx(2 * steps[0], rel=0.05)
    assert 0.005 < steps[0] < 0.01 and steps[2] == pytest.approx(0.02)
    assert noise_step_per_m(np.zeros(SIZE, np.float32)) == pytest.approx(FINEST)
    assert noise_step_per_m(np.ones((1, 2), np.float32)) == pytest.approx(FINEST)
    frames = [
        exact,
        exact + np.float32(0.002) * exact**2 * noise,
    ]  # that of the first frame, in any order of requests
    late, both = DepthScene(Frames(frames)), DepthScene(Frames(frames))
    both.planes(0)
    np.testing.assert_array_equal(late.planes(1).planes, both.planes(1).planes)


# -- forces ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("normal", [(0, 0, -1), (0.5, 0.1, -1), (-0.3, 0.9, -1), (0.3, -2.4, -1)])
@pytest.mark.parametrize("profile", [WALL, GUIDE])
@pytest.mark.parametrize("is_fine", [False, True])
def test_a_plane_gives_the_closed_form(
    normal: tuple[float, ...], profile: ForceProfile, is_fine: bool
) -> None:
    n = np.array(normal) / np.linalg.norm(normal)
    scene = DepthScene(Frames([plane_depth(n, n[2], rays())]))  # through (0, 0, 1)
    grid = Grid((21, 19, 50), (0.01, 0.012, 0.0071), (-0.1, -0.11, 0.8))  # within the picture
    if is_fine:  # bricks deep behind the complete neighbouring surface
        grid = Grid((17, 17, 140), (0.002, 0.002, 0.0025), (-0.016, -0.016, 0.95))
    points = grid.to_m(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), -1))
    phi = points @ n - n[2]
    expected = profile(phi)[..., None] * n
    edges = [e for piece in profile.pieces for e in piece[:2]]
    sure = np.abs(phi[..., None] - edges).min(-1) > 2e-5
    assert (expected[sure] != 0).any(-1).mean() > 0.1
    force = scene.field(0, grid, profile).to_dense()
    np.testing.assert_allclose(force[sure], expected[sure], rtol=1e-4, atol=1e-4)


def test_a_solid_extends_to_the_end_of_the_grid() -> None:
    scene = DepthScene(Frames([np.full(SIZE, 0.5, np.float32)]))
    grid = Grid((9, 9, 40), (0.01, 0.01, 0.05), (-0.04, -0.04, 0.03))
    force = scene.field(0, grid, SOLID).to_dense()
    is_behind = grid.axis_m(2) > 0.55
    np.testing.assert_allclose(
        force[:, :, is_behind], np.broadcast_to((0, 0, -2.5), force[:, :, is_behind].shape), atol=1e-5
    )
    assert not force[:, :, grid.axis_m(2) < 0.5].any()


def test_no_force_where_depth_is_unknown() -> None:
    depth = np.full(SIZE, 0.8, np.float32)
    holes = np.zeros(SIZE, bool)
    holes[40:70, 60:100] = True
    holes[np.random.default_rng(3).random(SIZE) < 0.05] = True
    depth[holes] = 0
    grid = Grid((80, 60, 12), (0.01, 0.01, 0.01), (-0.4, -0.3, 0.78))
    for profile in (WALL, SOLID):
        force = DepthScene(Frames([depth])).field(0, grid, profile).to_dense()
        x, y, z = np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij")
        u = np.floor(x / z * CAMERA.fx + CAMERA.cx + 0.5).astype(int)
        v = np.floor(y / z * CAMERA.fy + CAMERA.cy + 0.5).astype(int)
        hidden = holes[v, u]
        assert hidden.mean() > 0.05
        assert not force[hidden].any()
        assert force[~hidden & (z > 0.8)].any(-1).mean() > 0.98


def test_no_bridge_is_built_across_a_silhouette() -> None:
    depth = np.full(SIZE, 0.6, np.float32)
    depth[:, 80:] = 1.4
    grid = Grid(
        (40, 20, 60), (0.01, 0.01, 0.01), (-0.2, -0.1, 0.75)
    )  # between the two surfaces, without the walls
    field = DepthScene(Frames([depth])).field(0, grid, WALL)
    used = np.unique(grid.axis_m(2)[field.support().positions[:, 2]])
    assert not ((used > 0.7 + 1e-6) & (used < 1.4)).any()


def test_a_grazing_normal_gives_no_force_deep_behind_the_surface() -> None:
    n = np.array([0, -1, -0.05]) / np.linalg.norm((0, -1, -0.05))  # a floor seen at a grazing angle
    depth = plane_depth(n, -0.15, rays())
    surface = surface_planes(depth, CAMERA, FINEST)
    grid = Grid((8, 40, 200), (0.02, 0.01, 0.01), (-0.08, -0.1, 0.05))
    p = plane_forces(surface, np.eye(4), grid, WALL).support().positions
    x, y, z = (grid.to_m(p)).T
    u, v = np.floor(x / z * CAMERA.fx + CAMERA.cx + 0.5), np.floor(y / z * CAMERA.fy + CAMERA.cy + 0.5)
    beyond = z - depth[v.astype(int), u.astype(int)]
    assert (
        len(p) and beyond.max() < 4 * 0.1 + 0.05
    )  # 0.05: from the centre of the pixel to the sample's own ray


@st.composite
def cases(draw: st.DrawFn) -> tuple[np.ndarray, Grid, ForceProfile]:
    angle, tip = draw(st.floats(0, 3.1)), draw(st.tuples(*[st.floats(-1, 1)] * 3))
    axis = tip if np.linalg.norm(tip) > 0.1 else (0, 1, 0)
    pose = pose_of(rotation_about(axis, angle), draw(st.tuples(*[st.floats(-0.7, 0.7)] * 3)))
    shape = draw(st.tuples(*[st.integers(1, 37)] * 3))
    spacing = draw(st.tuples(*[st.floats(0.01, 0.12)] * 3))
    middle = pose[:3, :3] @ (0, 0, draw(st.floats(-0.5, 2.5))) + pose[:3, 3]
    origin = tuple(middle - np.array(spacing) * np.array(shape) / 2)
    return pose, Grid(shape, spacing, origin), draw(st.sampled_from([WALL, SOLID, GUIDE]))


@settings(max_examples=120)
@given(cases())
def test_any_grid_and_pose_agree_with_the_definition(case: tuple[np.ndarray, Grid, ForceProfile]) -> None:
    pose, grid, profile = case
    surface = _busy_surface()
    force, doubtful = reference(surface, pose, grid, profile)
    found = plane_forces(surface, pose, grid, profile)
    assert (found.forces_n != 0).any(axis=(1, 2, 3, 4)).all()
    wrong = np.abs(found.to_dense() - force).max(-1) > 2e-3
    assert not (wrong & ~doubtful).any()


def _busy_surface() -> SurfacePlanes:
    """A room with a ball, noise and holes."""
    depth = room_depth(rays(), np.eye(4))
    ball, _ = sphere(np.array([-0.2, 0.1, 1.1]), 0.25, rays())
    depth = np.where(ball > 0, ball, depth)
    rng = np.random.default_rng(5)
    depth = (depth + 0.001 * rng.normal(size=SIZE) * depth**2).astype(np.float32)
    depth[rng.random(SIZE) < 0.03] = 0
    return surface_planes(depth, CAMERA, noise_step_per_m(depth))


@pytest.mark.parametrize("profile", [WALL, SOLID, GUIDE])
def test_halving_cubes_of_bricks_loses_none(profile: ForceProfile, monkeypatch: pytest.MonkeyPatch) -> None:
    surface, pose = _busy_surface(), pose_of(rotation_about((1, 2, 0), 0.4), (0.1, -0.2, 0.3))
    grid = Grid((117, 90, 75), (0.02, 0.03, 0.05), (-1.0, -1.2, -0.6))
    halved = plane_forces(surface, pose, grid, profile)
    assert len(halved.bricks) > 50
    every = np.indices(grid.brick_shape, np.int32).reshape(3, -1).T.copy()
    monkeypatch.setattr(depth_scene, "find_bricks_by_block", lambda may_hold, grid: every)
    assert plane_forces(surface, pose, grid, profile) == halved


def test_a_grid_of_a_thousand_per_axis_costs_as_much_as_its_surface() -> None:
    grid = Grid((1000, 1000, 1000), (0.002, 0.002, 0.002), (-1, -1, 0.4))
    profile = ForceProfile(((-0.004, 0.0, 0.0, -500.0),))
    depth = np.zeros(SIZE, np.float32)
    depth[50:70, 70:90] = 1.0
    field = DepthScene(Frames([depth])).field(0, grid, profile)
    assert 0 < len(field.bricks) < 1000
    assert np.abs(grid.axis_m(2)[field.support().positions[:, 2]] - 1.0).max() < 0.005


# -- scenes ------------------------------------------------------------------------------------------------


def test_a_static_world_is_static_for_a_moving_camera() -> None:
    first = pose_of(
        rotation_about((0.2, 1, 0.1), 2.0), (3.0, -1.0, 2.0)
    )  # the coordinates of the recording are arbitrary
    motion = pose_of(rotation_about((0.3, 1, 0.2), 0.12), (0.15, -0.05, 0.1))
    poses = np.stack([first, first @ motion])
    scene = DepthScene(Frames([room_depth(rays(), np.eye(4)), room_depth(rays(), motion)], poses=poses))
    grid = Grid((60, 50, 60), (0.011, 0.012, 0.01), (-0.35, -0.1, 1.45))
    a, b = (scene.field(i, grid, WALL).to_dense() for i in (0, 1))
    both = a.any(-1) & b.any(-1)
    assert both.sum() > 0.75 * max(a.any(-1).sum(), b.any(-1).sum())
    assert np.quantile(np.abs(a - b)[both].max(-1), 0.97) < 1e-2
    in_camera_frame = DepthScene(scene.sequence, "camera")
    moved = in_camera_frame.field(1, grid, WALL).to_dense()
    assert np.abs(moved - b).max() > 0.5
    np.testing.assert_allclose(in_camera_frame.field(0, grid, WALL).to_dense(), a, atol=1e-5)


def test_bounds_hold_the_surface_and_no_stray_reading() -> None:
    depth = np.full(SIZE, 1.0, np.float32)
    depth[:, 80:] = 2.0
    depth[8:12, 8:12] = 900.0
    depth[::9, ::7] = 0
    motion = np.stack([np.eye(4), pose_of(np.eye(3), (0.5, 0, 0))])
    frames = Frames([depth, depth], poses=motion)
    low, high = DepthScene(frames).bounds_m()
    assert low[2] == pytest.approx(1.0) and high[2] == pytest.approx(2.0)
    assert low[0] == pytest.approx(-80 / 131, abs=0.1) and high[0] == pytest.approx(
        0.5 + 2 * 80 / 131, abs=0.1
    )
    assert DepthScene(frames, "camera").bounds_m()[1][0] == pytest.approx(2 * 80 / 131, abs=0.1)
    tiny = DepthScene(Frames([np.ones((2, 3), np.float32)]))
    assert np.isfinite(tiny.bounds_m()).all()
    assert tiny.field(0, Grid((8, 8, 8), (0.1, 0.1, 0.1), (0, 0, 0.5)), WALL).support_count == 0


def test_two_grids_share_one_reading_of_a_frame() -> None:
    frames = Frames([room_depth(rays(), np.eye(4))] * 2)
    scene = DepthScene(frames)
    coarse, fine = (Grid((n, n, n), (1 / n,) * 3, (-0.5, -0.5, 1.2)) for n in (16, 32))
    scene.field(0, coarse, WALL)
    scene.field(0, fine, SOLID)
    assert frames.reads == 1
    late = DepthScene(frames)
    assert late.field(1, coarse, WALL) == scene.field(
        1, coarse, WALL
    )  # the order of requests does not matter
    assert scene.field(0, coarse, WALL) == DepthScene(frames).field(0, coarse, WALL)


def test_invalid_sequences_are_refused() -> None:
    depth = np.ones(SIZE, np.float32)
    grid = Grid((8, 8, 8), (0.1, 0.1, 0.1), (0, 0, 1))
    with pytest.raises(InvalidArgument, match="world or camera"):
        DepthScene(Frames([depth]), "moon")
    with pytest.raises(SourceError, match="one for each frame"):
        DepthScene(Frames([depth], poses=np.zeros((3, 4, 4))))
    for bad in (np.full((4, 4), np.nan), 2 * np.eye(4), np.diag([1.0, 1, -1, 1])):
        with pytest.raises(
            SourceError, match=r"pose 1: found (numbers that are not|a matrix that is no|a rotation that)"
        ):
            DepthScene(Frames([depth, depth], poses=np.stack([np.eye(4), bad])))
        DepthScene(Frames([depth, depth], poses=np.stack([np.eye(4), bad])), "camera")
    with pytest.raises(SourceError, match="no depth"):
        DepthScene(Frames([0 * depth])).bounds_m()
    assert DepthScene(Frames([0 * depth])).field(0, grid, WALL).support_count == 0
    with pytest.raises(InvalidArgument, match="0 to 0"):
        DepthScene(Frames([depth])).field(1, grid, WALL)
    with pytest.raises(SourceError, match="frame 1"):
        DepthScene(Frames([depth, depth[1:]])).field(1, grid, WALL)


# -- real input --------------------------------------------------------------------------------------------


def _picture(path: Path, units_per_m: float) -> np.ndarray:
    with Image.open(path) as picture:
        return (np.asarray(picture) / units_per_m).astype(np.float32)


@pytest.mark.shared
def test_real_depth(shared_data: Path) -> None:
    kinect = _picture(min((shared_data / "rgbd_tum_fr1_rpy" / "depth").glob("*.png")), 5000)
    drawn = _picture(min((shared_data / "rgbd_iclnuim_livingroom1" / "depth").glob("*.png")), 1000)
    assert 0.005 < noise_step_per_m(kinect) < 0.01
    assert noise_step_per_m(drawn) < 0.002
    for depth, camera in (
        (kinect, Intrinsics(517.3, 516.5, 318.6, 255.3)),
        (drawn, Intrinsics(525, 525, 319.5, 239.5)),
    ):
        surface = surface_planes(depth, camera, noise_step_per_m(depth))
        is_surface = offsets_m_of(surface) < 0
        assert not is_surface[depth == 0].any()
        assert is_surface[depth > 0].mean() > 0.9
        np.testing.assert_allclose(np.linalg.norm(normals_of(surface)[is_surface], axis=-1), 1, atol=1e-5)
        found = (
            offsets_m_of(surface)[is_surface]
            / (normals_of(surface) * rays(camera, depth.shape)).sum(-1)[is_surface]
        )
        assert (
            np.median(np.abs(found - depth[is_surface]) / depth[is_surface] ** 2) < 0.003
        )  # a Kinect's quantum
        scene = DepthScene(Frames([depth], camera))
        low, high = scene.bounds_m()
        field = scene.field(0, Grid.over_box(low, high, (64, 64, 64)), WALL)
        assert 0.01 < field.support_count / 64**3 < 0.4

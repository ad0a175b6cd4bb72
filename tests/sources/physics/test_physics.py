"""Falling and colliding bodies: physical laws, Scene 1 of the paper, and faults of its files."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from touchfield.errors import InvalidArgument, MissingExtra, SourceError
from touchfield.medium import PoseTrack
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics import simulation
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.simulation import _driven_state, model_of
from touchfield.sources.physics.toml_file import open_physics, read_physics
from touchfield.sources.registry import kinds, open_source
from touchfield.sources.samples import sample
from touchfield.sources.scene import Body
from touchfield.sources.shapes.shapes import Box, Plane

needs_mujoco = pytest.mark.skipif(
    __import__("importlib.util").util.find_spec("mujoco") is None,
    reason='needs the simulator: pip install "touchfield[physics]"',
)
G = 9.81

FALL = """
[physics]
seconds = 0.2
{physics}

{floor}

[[body]]
kind = "sphere"
name = "ball"
radius_m = 0.02
{body}
"""

Make = Callable[..., BodyScene]


@pytest.fixture
def fall(tmp_path: Path) -> Make:
    def make(
        physics: str = "", floor: str = "", body: str = "position_m = [0, 0, 0.5]", more: str = ""
    ) -> BodyScene:
        path = tmp_path / "scene.toml"
        path.write_text(FALL.format(physics=physics, floor=floor, body=body) + more)
        return open_physics(path, SourceOptions())

    return make


def surface_of(body: Body) -> np.ndarray:
    """Points on the surface of a body in its frame, including the outermost corners."""
    if isinstance(body.scene, MeshScene):
        return np.asarray(body.scene.surface.vertices_m)
    (shape,) = body.scene.shapes  # type: ignore[attr-defined]
    box = shape.box_m()
    if isinstance(shape, Box):
        return np.array(np.meshgrid(*box.T)).reshape(3, -1).T
    at = np.random.default_rng(0).normal(size=(500, 3)) * np.ptp(box, axis=0)
    for _ in range(30):  # a single pass is enough if the distance is exact
        phi, normal = shape.signed_distance_and_normal(at)
        at = at - phi[:, None] * normal
    return np.asarray(at[np.abs(shape.signed_distance_and_normal(at)[0]) < 1e-9])


@needs_mujoco
def test_free_fall_and_spin(fall: Make) -> None:
    body = """position_m = [0.1, 0, 0.5]
velocity_m_s = [0.3, 0, 1.0]
rotation_deg = [0, 90, 0]
spin_deg_s = [0, 0, 360]"""
    scene = fall(body=body)
    (ball,) = scene.bodies()
    assert (scene.frame_count, scene.rate_hz, len(ball.track)) == (200, 1000.0, 200)
    t = np.arange(200) / 1000
    np.testing.assert_allclose(ball.track.positions_m[:, 0], 0.1 + 0.3 * t, atol=1e-9)
    np.testing.assert_allclose(ball.track.positions_m[:, 2], 0.5 + t - G * t * t / 2, atol=G * 0.001 * 0.2)
    velocity, spin = ball.track.velocities(scene.rate_hz)
    np.testing.assert_allclose(spin[5:-5], np.tile([0, 0, 2 * np.pi], (190, 1)), atol=1e-6)
    np.testing.assert_allclose(velocity[0], [0.3, 0, 1.0], atol=0.02)
    np.testing.assert_allclose(ball.track.rotation(0) @ [0, 0, 1], [1, 0, 0], atol=1e-12)


@needs_mujoco
@pytest.mark.parametrize("restitution", [0.0, 0.3, 0.8])
def test_a_bounce_has_the_requested_restitution(fall: Make, restitution: float) -> None:
    world = f"restitution = {restitution}\nstep_s = 0.0001\ncontact_s = 0.002"
    (ball, floor) = fall(world, "[floor]", "position_m = [0, 0, 0.05]\nvelocity_m_s = [0, 0, -1]").bodies()
    velocity = ball.track.velocities(1000.0)[0][:, 2]
    arrived = int(ball.track.positions_m[:, 2].argmin())
    before, after = -velocity[arrived - 6], velocity[arrived + 6 : arrived + 12].max()
    assert after / before == pytest.approx(restitution, abs=0.06)
    assert (floor.name, floor.track.is_constant) == ("floor", True)


@needs_mujoco
def test_friction_stops_a_sliding_body(fall: Make) -> None:
    slab = """
[[body]]
kind = "box"
half_extents_m = [0.05, 0.05, 0.01]
position_m = [0.3, 0, 0.01]
velocity_m_s = [0.5, 0, 0]
"""

    def slide_m(friction: float) -> float:
        return float(
            np.ptp(fall(f"friction = {friction}", "[floor]", more=slab).bodies()[1].track.positions_m[:, 0])
        )

    assert slide_m(0.0) == pytest.approx(0.5 * 0.199, rel=0.02)
    assert slide_m(0.8) == pytest.approx(0.5**2 / (2 * 0.8 * G), rel=0.15)


@needs_mujoco
@pytest.mark.parametrize(("friction", "stops"), [("torsional", (True, False)), ("rolling", (False, True))])
def test_torsional_and_rolling_friction_stop_a_ball(
    fall: Make, friction: str, stops: tuple[bool, bool]
) -> None:
    """About the normal 20 rad/s, with 0.01 Nm per newton; it rolls at 0.2 m/s from the start."""
    motions = ("spin_deg_s = [0, 0, 1146]", "velocity_m_s = [0.2, 0, 0]\nspin_deg_s = [0, 573, 0]")
    for motion, is_stopped in zip(motions, stops, strict=True):
        scene = fall(f"{friction}_friction_m = 0.01", "[floor]", f"position_m = [0, 0, 0.02]\n{motion}")
        spin = np.linalg.norm(scene.bodies()[0].track.velocities(scene.rate_hz)[1], axis=1)
        assert (spin[-2] < 0.1 * spin[1]) == is_stopped


@needs_mujoco
@pytest.mark.parametrize(("name", "count"), [("falling-4", 4), ("falling-7", 7)])
def test_scene_1_of_the_paper(name: str, count: int) -> None:
    scene = sample(name)
    assert (scene.frame_count, scene.rate_hz, scene.axes) == (2000, 1000.0, "x east, y north, z up")
    assert scene.notes == () and not scene.is_solid
    bodies = scene.bodies()
    assert len(bodies) == len({body.name for body in bodies}) == count
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    for body in bodies:
        assert body.is_rigid
        rotations, positions = body.track.rotations()[::4], body.track.positions_m[::4]
        points = np.einsum("fij,nj->fni", rotations, surface_of(body)) + positions[:, None]
        low, high = np.minimum(low, points.min(axis=(0, 1))), np.maximum(high, points.max(axis=(0, 1)))
        assert points[0, :, 2].min() > 0.05, f"{body.name} begins in the air"
        assert points[..., 2].min() > -1e-3, f"{body.name} passes through the ground"
        assert points[-1, :, 2].min() < 0.1
        speed = np.linalg.norm(body.track.velocities(1000.0)[0], axis=1)
        assert speed.max() > 0.8 and speed[-20:].max() < 0.05, f"{body.name} falls, and comes to rest"
    x, y, z = high - low
    assert z < y < x and z > x / 4  # the workspace of a desktop device has 160 x 120 x 70 mm


@needs_mujoco
def test_energy_falls(tmp_path: Path) -> None:
    import mujoco

    from touchfield.sources.physics.simulation import model_of
    from touchfield.sources.physics.toml_file import read_physics

    path = Path(sys.modules["touchfield.sources"].__path__[0]) / "scenes" / "falling-4.toml"
    model, ids, _ = model_of(mujoco, read_physics(path), {}, "scene")
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, 0)
    energy = []
    for _ in range(100):
        mujoco.mj_step(model, data, 100)
        energy.append(float(data.energy.sum()))
    loss = np.array(energy[0] - np.array(energy)) / energy[0]
    assert (np.diff(loss) > -0.01).all() and loss[-1] > 0.5
    assert len(ids) == 4


@needs_mujoco
def test_poses_are_reproducible() -> None:
    first, second = (sample("falling-7", SourceOptions(seconds=0.5, rate_hz=500)).bodies() for _ in range(2))
    for first_body, second_body in zip(first, second, strict=True):
        assert len(first_body.track) == 250
        assert first_body.track.positions_m.tobytes() == second_body.track.positions_m.tobytes()
        assert first_body.track.quaternions.tobytes() == second_body.track.quaternions.tobytes()


@needs_mujoco
def test_every_kind_lands_on_its_surface(tmp_path: Path) -> None:
    (tmp_path / "wedge.obj").write_text(
        "v 0 0 0\nv 30 0 0\nv 0 30 0\nv 0 0 30\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"  # millimetres
    )
    sizes = {
        "box": "half_extents_m = [0.02, 0.03, 0.01]",
        "sphere": "radius_m = 0.02",
        "capsule": "radius_m = 0.02\nhalf_length_m = 0.01",
        "cylinder": "radius_m = 0.02\nhalf_length_m = 0.01",
        "ellipsoid": "half_extents_m = [0.03, 0.02, 0.01]",
        "superquadric": "half_extents_m = [0.03, 0.02, 0.01]\nexponents = [0.5, 1.5]",
        "mesh": 'file = "wedge.obj"\nunit_m = 0.001\nmass_kg = 0.1',
    }
    text = "[physics]\nseconds = 0.5\nstep_s = 0.0002\nrestitution = 0\n[floor]\nheight_m = 0.3\n"
    for i, (kind, size) in enumerate(sizes.items()):
        text += f'[[body]]\nkind = "{kind}"\n{size}\n'
        text += f"position_m = [{0.2 * i}, 0, 0.34]\nrotation_deg = [10, 5, 0]\n"
    (tmp_path / "all.toml").write_text(text)
    scene = open_source(tmp_path / "all.toml")
    assert isinstance(scene, BodyScene) and scene.notes == ()
    *bodies, floor = scene.bodies()
    (plane,) = floor.scene.shapes  # type: ignore[attr-defined]
    assert isinstance(plane, Plane) and plane.point_m[2] == 0.3
    for body in bodies:
        lowest = body.track.to_scene(surface_of(body), 499)[:, 2].min()
        assert lowest == pytest.approx(0.3, abs=1e-3), body.name


def test_the_unit_of_a_mesh_of_a_body_is_noted_unless_it_is_given(tmp_path: Path) -> None:
    (tmp_path / "wedge.obj").write_text(
        "v 0 0 0\nv 50 0 0\nv 0 30 0\nv 0 0 30\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    path = tmp_path / "scene.toml"
    for line in ("", "unit_m = 0.001"):
        body = f'kind = "mesh"\nfile = "wedge.obj"\n{line}\nposition_m = [0, 0, 0]\nfixed = true\n'
        path.write_text(f"[[body]]\n{body}")
        notes = open_physics(path, SourceOptions()).notes
        assert any("metres: 50 x 30 x 30 m; give unit_m" in note for note in notes) == (not line), notes


@needs_mujoco
def test_a_posed_body_pushes_and_a_fixed_one_resists(fall: Make, tmp_path: Path) -> None:
    (tmp_path / "push.csv").write_text(
        "t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,-0.2,0,0.05,1,0,0,0\n0.2,0.1,0,0.05,1,0,0,0\n"
    )
    others = """
[[body]]
kind = "box"
name = "piston"
half_extents_m = [0.05, 0.05, 0.05]
poses = "push.csv"

[[body]]
kind = "box"
name = "shelf"
half_extents_m = [0.05, 0.05, 0.01]
position_m = [0.5, 0, 0.2]
fixed = true

[[body]]
kind = "box"
name = "book"
half_extents_m = [0.02, 0.02, 0.02]
position_m = [0.5, 0, 0.231]
"""
    floor = "[floor]\ntouchable = false"
    ball, piston, shelf, book = fall("restitution = 0", floor, "position_m = [0, 0, 0.02]", others).bodies()
    np.testing.assert_allclose(piston.track.positions_m[:, 0], -0.2 + 1.5 * np.arange(200) / 1000, atol=1e-9)
    assert ball.track.positions_m[-1, 0] > 0.1 + 0.05  # it was hit, and is in front of the piston
    assert shelf.track.is_constant and np.ptp(book.track.positions_m[:, 2]) < 0.002


@needs_mujoco
def test_a_posed_body_does_not_fall_between_its_frames(fall: Make, tmp_path: Path) -> None:
    (tmp_path / "still.csv").write_text("t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0.1,1,0,0,0\n1,0,0,0.1,1,0,0,0\n")
    plate = '[[body]]\nkind = "box"\nname = "plate"\nhalf_extents_m = [0.1, 0.1, 0.01]\nposes = "still.csv"'
    ball, _ = fall("rate_hz = 20", body="position_m = [0, 0, 0.13]", more=plate).bodies()
    assert np.ptp(ball.track.positions_m[:, 2]) < 0.002
    (tmp_path / "still.csv").write_text("t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0.1,1,0,0,0\n1,0,0,0.3,1,0,0,0\n")
    # with a plate that rises from the first frame on
    rides = "position_m = [0, 0, 0.13]\nvelocity_m_s = [0, 0, 0.2]"
    ball, lift = fall("rate_hz = 20\nrestitution = 0", body=rides, more=plate).bodies()
    assert np.ptp((ball.track.positions_m - lift.track.positions_m)[:, 2]) < 0.002


@needs_mujoco
@pytest.mark.parametrize("tilt_deg", [0.0, 60.0, -90.0, 135.0])
def test_a_posed_body_rotates_between_frames_like_its_poses(
    fall: Make, tmp_path: Path, tilt_deg: float
) -> None:
    """MuJoCo's step of a body with the given velocities ends at the next pose."""
    import mujoco

    turn, tilt = Rotation.from_rotvec, Rotation.from_euler("xy", [tilt_deg, 20.0], degrees=True)
    t = np.arange(11) / 20
    poses = [turn([0, 0, 3.0 * now]) * tilt for now in t]  # about the z axis of the scene for any tilt
    track = PoseTrack(
        np.array([rotation.as_quat(scalar_first=True) for rotation in poses]),
        np.stack([t, 0.5 * t, 0.2 * t], axis=1),
    )
    plate = '[[body]]\nkind = "box"\nname = "plate"\nhalf_extents_m = [0.1, 0.05, 0.01]\nposes = "turn.csv"'
    (tmp_path / "turn.csv").write_text("t_s,x_m,y_m,z_m,qw,qx,qy,qz\n0,0,0,0,1,0,0,0\n1,0,0,0,1,0,0,0\n")
    fall(more=plate)
    table = read_physics(tmp_path / "scene.toml")
    model, ids, _ = model_of(mujoco, table, {"plate": track}, "here")
    position, motion, states, velocities = _driven_state(model, ids[1], track, 20.0)
    for frame in range(1, 9):
        state, velocity = np.zeros(model.nq), np.zeros(model.nv)
        state[3] = 1.0
        state[position], velocity[motion] = states[frame], velocities[frame]
        mujoco.mj_integratePos(model, state, velocity, 1 / 20)
        np.testing.assert_allclose(state[position][:3], track.positions_m[frame + 1], atol=1e-9)
        assert abs(state[position][3:] @ track.quaternions[frame + 1]) == pytest.approx(1.0, abs=1e-7)


@needs_mujoco
@pytest.mark.parametrize("turns_deg", [(0, 0, 0), (30, 0, 0), (0, 90, 0), (20, -40, 70), (180, 10, 0)])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_spin_is_about_the_axes_of_the_scene(
    fall: Make, turns_deg: tuple[int, int, int], axis: int
) -> None:
    spin_deg_s = [90.0 * (n == axis) for n in range(3)]
    body = f"position_m = [0, 0, 0.5]\nrotation_deg = {list(turns_deg)}\nspin_deg_s = {spin_deg_s}"
    (ball,) = fall(body=body).bodies()
    first, last = (Rotation.from_quat(ball.track.quaternions[n], scalar_first=True) for n in (0, 100))
    np.testing.assert_allclose(
        (last * first.inv()).as_rotvec(degrees=True), 0.1 * np.array(spin_deg_s), atol=1e-6
    )
    x, y, z = turns_deg  # about x, then y, then z of the scene
    expected = Rotation.from_euler("xyz", [x, y, z], degrees=True)
    assert (first * expected.inv()).magnitude() < 1e-9


@needs_mujoco
def test_notes(fall: Make) -> None:
    scene = fall("step_s = 0.0007", "[floor]", "position_m = [0, 0, 0.015]")
    assert any("0.0007 s does not divide" in note for note in scene.notes)
    assert any("ball begins 5 mm within the floor" in note for note in scene.notes)
    dented = """
[[body]]
kind = "mesh"
name = "dart"
vertices_m = [[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1], [0.02, 0.02, 0.02]]
triangles = [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 4], [2, 3, 4], [3, 1, 4]]
position_m = [0.5, 0, 0.5]
"""
    assert fall(more=dented).notes == ("dart is not convex: it collides as its convex hull.",)


BAD = [
    ("[physics]", "[physics]\nspeed = 1", "physics.speed"),
    ("[physics]", "[physics]\nseconds = 0", "physics.seconds"),
    ("[physics]", "[physics]\nrate_hz = nan", "physics.rate_hz"),
    ("[physics]", "[physics]\nrestitution = 1.5", "physics.restitution"),
    ("[physics]", "[physics]\nfriction = -1", "physics.friction"),
    ("[physics]", "[physics]\ncontact_s = 0.001", "physics.contact_s"),
    ("[physics]", "[physics]\ngravity_m_s2 = 9.81", "physics.gravity_m_s2"),
    ("[physics]", "physics = 3", "physics"),
    ("[floor]", "[floor]\ndepth_m = 1", "floor.depth_m"),
    ("[floor]", '[floor]\ntouchable = "no"', "floor.touchable"),
    ("[[body]]", "[body]", "body"),
    ('kind = "box"', 'kind = "brick"', "body 1.kind"),
    ('kind = "box"', 'kind = "plane"', "body 1.kind"),
    ('kind = "box"', 'kind = "box"\nradius_m = 1', "body 1.radius_m"),
    ('kind = "box"', 'kind = "box"\ncenter_m = [0, 0, 0]', "body 1.center_m"),
    ('kind = "box"', 'kind = "box"\nname = "floor"', "body 1.name"),
    ('kind = "box"', 'kind = "box"\nname = 3', "body 1.name"),
    ("half_extents_m = [1, 1, 1]", "", "body 1: found no 'half_extents_m'"),
    ("half_extents_m = [1, 1, 1]", "half_extents_m = [1, 1, 0]", "body 1.half_extents_m"),
    ("position_m = [0, 0, 2]", "", "body 1: found no 'position_m'"),
    ("position_m = [0, 0, 2]", "position_m = [0, 0]", "body 1.position_m"),
    ("position_m = [0, 0, 2]", "position_m = [0, 0, inf]", "body 1.position_m"),
    ("position_m = [0, 0, 2]", 'position_m = [0, 0, 2]\nposes = "a.csv"', "body 1.position_m"),
    ("position_m = [0, 0, 2]", "position_m = [0, 0, 2]\nfixed = 1", "body 1.fixed"),
    ("position_m = [0, 0, 2]", "position_m = [0, 0, 2]\nfixed = true\nmass_kg = 1", "body 1.mass_kg"),
    ("position_m = [0, 0, 2]", "position_m = [0, 0, 2]\nmass_kg = 0", "body 1.mass_kg"),
    (
        "position_m = [0, 0, 2]",
        "position_m = [0, 0, 2]\nmass_kg = 1\ndensity_kg_m3 = 1",
        "body 1.density_kg_m3",
    ),
    ('kind = "box"\nhalf_extents_m = [1, 1, 1]', 'kind = "mesh"', "body 1: found no 'vertices_m'"),
    ('kind = "box"\nhalf_extents_m = [1, 1, 1]', 'kind = "mesh"\nfile = "none.ply"', "none.ply"),
    (
        'kind = "box"\nhalf_extents_m = [1, 1, 1]',
        'kind = "mesh"\nvertices_m = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\ntriangles = [[0, 1, 3]]',
        "body 1.triangles",
    ),
    (
        'kind = "box"\nhalf_extents_m = [1, 1, 1]',
        'kind = "mesh"\nvertices_m = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\ntriangles = [[0, 1, 1.5]]',
        "body 1.triangles",
    ),
]


@pytest.mark.parametrize(("old", "new", "named"), BAD)
def test_faults_name_the_file_and_the_key(tmp_path: Path, old: str, new: str, named: str) -> None:
    good = '[physics]\n[floor]\n[[body]]\nkind = "box"\nhalf_extents_m = [1, 1, 1]\nposition_m = [0, 0, 2]\n'
    assert good.count(old) == 1
    path = tmp_path / "scene.toml"
    path.write_text(good.replace(old, new))
    with pytest.raises(SourceError) as caught:
        open_source(path)
    assert str(path) in str(caught.value) and named in str(caught.value) and "\n" not in str(caught.value)


@needs_mujoco
def test_a_mesh_without_volume_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "flat.toml"
    flat = "vertices_m = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]\ntriangles = [[0, 1, 2]]"
    path.write_text(f'[[body]]\nkind = "mesh"\n{flat}\nposition_m = [0, 0, 0]\n')
    with pytest.raises(SourceError, match=r"flat\.toml: body 1: size: .* as thick as it is long"):
        open_physics(path, SourceOptions())


def test_two_bodies_of_one_name_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"
    path.write_text('[[body]]\nkind = "sphere"\nradius_m = 1\nname = "a"\nposition_m = [0, 0, 0]\n' * 2)
    with pytest.raises(SourceError, match=r"body 2\.name"):
        open_physics(path, SourceOptions())


def test_other_toml_files_keep_their_kind(tmp_path: Path) -> None:
    path = tmp_path / "shapes.toml"
    path.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0, 0, 0]\nradius_m = 1\n')
    physics = next(kind for kind in kinds() if kind.name == "physics")
    assert not physics.recognise(path) and type(open_source(path)).__name__ == "AnalyticScene"
    path.write_bytes(b"\xff\x00 = ")
    assert not physics.recognise(path) and not physics.recognise(tmp_path)


def test_without_the_simulator_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mujoco", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[physics\]"):
        sample("falling-4")


def test_the_memory_of_poses_is_limited(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.5")
    assert simulation.frames_of("a.toml", 60.0, 1000.0, 100) == 60_000, "more than 2^22 poses"
    assert simulation.frames_of("a.toml", 2.0, 1000.0, 3) == 2000
    assert simulation.frames_of("a.toml", 1e-6, 1000.0) == 1
    assert simulation.frames_of("a.toml", 0.0126, 1000.0) == 13
    message = r"a\.toml: found 0\.8 GiB of poses, 5000 s at 1000 Hz for 3 bodies; expected at most 0\.5 GiB"
    with pytest.raises(InvalidArgument, match=message):
        simulation.frames_of("a.toml", 5000.0, 1000.0, 3)


def test_blocks_of_recorded_poses_lose_no_frame() -> None:
    """A count of frames that is no multiple of a block, so that the last block is partly filled."""
    frames, bodies = 2 * simulation._BLOCK_FRAMES + 3, 2
    rng = np.random.default_rng(0)
    turns, positions = rng.normal(size=(frames, bodies, 4)), rng.normal(size=(frames, bodies, 3))
    turns /= np.linalg.norm(turns, axis=2, keepdims=True)
    recorder = simulation._PoseRecorder(frames, bodies)
    for turn, position in zip(turns, positions, strict=True):
        recorder.add(turn, position)
    for body, track in enumerate(recorder.tracks()):
        expected = PoseTrack(turns[:, body], positions[:, body])
        assert track == expected


def test_names_and_contacts_of_a_table_are_checked_at_their_edges(tmp_path: Path) -> None:
    path = tmp_path / "scene.toml"

    def body(name: str) -> str:
        return f'[[body]]\nkind = "sphere"\nname = "{name}"\nradius_m = 0.1\nposition_m = [0, 0, 1]\n'

    path.write_text(body("a") + body("floor"))
    with pytest.raises(SourceError, match=r"body 2\.name: found 'floor', as the floor is called"):
        read_physics(path)
    path.write_text(body("a") + body("b") + body("a"))
    with pytest.raises(SourceError, match=r"body 3\.name: found 'a', as another body is called"):
        read_physics(path)
    for steps, is_accepted in ((7, True), (6.99, False)):
        path.write_text(f"[physics]\nstep_s = 0.002\ncontact_s = {steps * 0.002!r}\n" + body("a"))
        if is_accepted:
            assert read_physics(path).world.contact_s == steps * 0.002
        else:
            with pytest.raises(SourceError, match=r"contact_s: .*at least 7 steps of 0\.002 s"):
                read_physics(path)

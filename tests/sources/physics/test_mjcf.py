"""MuJoCo models as scenes: their touchable geoms, poses, durations and faults."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument, SourceError
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.mjcf import KIND, check_files
from touchfield.sources.registry import open_source
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Plane

mujoco = pytest.importorskip("mujoco", reason='needs the simulator: pip install "touchfield[physics]"')

WEDGE = 'vertex="0 0 0  .1 0 0  0 .1 0  0 0 .1" face="0 2 1  0 1 3  0 3 2  1 2 3"'
FLOOR = '<geom name="ground" type="plane" size="1 1 .1" pos="0 0 -.1"/>'
BALL = '<body name="ball" pos="0 0 .5"><freejoint/><geom size=".05"/></body>'


@pytest.fixture(autouse=True)
def in_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)  # MuJoCo writes its log there by default


def opened(world: str, rest: str = "", **options: float) -> BodyScene:
    path = Path("model.xml")
    path.write_text(
        f"<?xml version='1.0'?>\n<!-- a test -->\n<mujoco>{rest}<worldbody>{world}</worldbody></mujoco>"
    )
    scene = open_source(path, SourceOptions(**options))  # type: ignore[arg-type]
    assert isinstance(scene, BodyScene)
    return scene


def test_bodies_rate_and_duration() -> None:
    scene = opened(FLOOR + BALL, seconds=0.1)
    assert (scene.frame_count, scene.rate_hz, scene.axes) == (100, 1000.0, "x east, y north, z up")
    world, ball = scene.bodies()
    assert (world.name, ball.name) == ("world", "ball")
    assert world.track.is_constant and not ball.track.is_constant and len(ball.track) == 100
    assert ball.track.positions_m[0].tolist() == [0, 0, 0.5]
    t = np.arange(100) / 1000
    np.testing.assert_allclose(ball.track.positions_m[:, 2], 0.5 - 9.81 * t * t / 2, atol=9.81 * 0.001 * 0.1)
    (plane,) = world.scene.shapes  # type: ignore[attr-defined]
    assert isinstance(plane, Plane) and (plane.point_m, plane.normal) == ((0, 0, -0.1), (0, 0, 1))


def test_the_model_may_name_its_initial_state() -> None:
    key = '<keyframe><key name="touchfield" qpos="1 2 3 1 0 0 0" qvel="0 0 1 0 0 0"/></keyframe>'
    scene = opened(BALL, key, seconds=0.05)
    assert scene.frame_count == 50
    np.testing.assert_allclose(
        scene.bodies()[0].track.positions_m[[0, 10]], [[1, 2, 3], [1, 2, 3.0095]], atol=1e-4
    )
    assert opened(BALL, seconds=0.02, rate_hz=500).frame_count == 10
    assert opened(BALL).frame_count == 2000


def test_a_model_starts_from_its_first_keyframe() -> None:
    home, other = (f'<key {name} qpos="0 0 {z} 1 0 0 0"/>' for name, z in (('name="home"', 2), ("", 3)))
    scene = opened(BALL, f"<keyframe>{home}</keyframe>", seconds=0.05)
    assert scene.bodies()[0].track.positions_m[0].tolist() == [0, 0, 2]
    assert "The simulation starts from the keyframe 'home'." in scene.notes
    scene = opened(BALL, f"<keyframe>{other}{home}</keyframe>", seconds=0.05)
    assert scene.bodies()[0].track.positions_m[0].tolist() == [0, 0, 3]
    assert any("from the keyframe 0 of 2" in note for note in scene.notes)
    named = home.replace("home", "touchfield")
    scene = opened(BALL, f"<keyframe>{other}{named}</keyframe>", seconds=0.05)
    assert scene.bodies()[0].track.positions_m[0].tolist() == [0, 0, 2]
    assert not any("keyframe" in note for note in (*scene.notes, *opened(BALL, seconds=0.05).notes))


def test_controls_of_a_keyframe_are_used() -> None:
    joint = '<body name="cart"><joint name="j" type="slide" axis="1 0 0"/><geom size=".05"/></body>'
    rest = '<option gravity="0 0 0"/><actuator><motor joint="j"/></actuator>'
    key = '<keyframe><key name="go" qpos="1" ctrl="1"/></keyframe>'
    cart = opened(joint, rest + key, seconds=0.5).bodies()[0]
    assert cart.track.positions_m[0, 0] == 1 and cart.track.positions_m[-1, 0] > 1.05
    assert opened(joint, rest, seconds=0.1).bodies()[0].track.is_constant


@pytest.mark.parametrize(
    ("timestep", "rate_hz", "step_s"),
    [
        (0.002, 1000, 0.001),
        (0.0003, 1000, 1 / 3000),
        (0.0006, 1000, 0.0005),
        (0.002, 50, None),
        (0.001, 30, None),
    ],
)
def test_the_step_divides_the_frame(timestep: float, rate_hz: float, step_s: float | None) -> None:
    scene = opened(BALL, f'<option timestep="{timestep}"/>', seconds=0.1, rate_hz=rate_hz)
    step_notes = [note for note in scene.notes if "time step" in note]
    if rate_hz == 50:
        assert not step_notes  # ten steps of 2 ms
    else:
        assert len(step_notes) == 1 and f"{timestep:g} s does not divide" in step_notes[0]
    if step_s:
        assert f"it is {step_s:g} s" in step_notes[0]


def test_every_rigid_geom_is_posed_as_in_mujoco() -> None:
    assets = f'<asset><mesh name="wedge" {WEDGE}/></asset>'
    geoms = """
    <geom type="sphere" size=".05" pos="0 0 .1"/>
    <geom type="capsule" size=".03 .05" pos=".3 0 0" euler="20 30 40"/>
    <geom type="cylinder" size=".03 .05" pos=".6 0 0" euler="20 30 40"/>
    <geom type="box" size=".03 .05 .02" pos=".9 0 0"/>
    <geom type="ellipsoid" size=".03 .05 .02" pos="1.2 0 0" euler="0 0 30"/>
    <geom name="w" type="mesh" mesh="wedge" pos="1.5 .1 0" euler="20 30 40"/>"""
    scene = opened(f'<body name="all" pos=".1 .2 .3" euler="10 20 30">{geoms}</body>', assets, seconds=0.001)
    shapes, wedge = scene.bodies()
    assert (shapes.name, wedge.name) == ("all", "all/w") and shapes.track == wedge.track
    assert isinstance(shapes.scene, AnalyticScene) and shapes.scene.combine == "union"
    assert isinstance(wedge.scene, MeshScene) and wedge.scene.is_closed
    model = mujoco.MjModel.from_xml_path("model.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    rng = np.random.default_rng(0)
    hits = np.zeros(6, int)
    geom_id, normal = np.zeros(1, np.int32), np.zeros(3)
    for _ in range(300):  # a ray that meets a geom of MuJoCo ends on our surface, with our normal
        target = data.geom_xpos[rng.integers(6)] + rng.normal(size=3) * 0.01
        ray = rng.normal(size=3)
        ray /= np.linalg.norm(ray)
        start = target - ray
        length = mujoco.mj_ray(model, data, start, ray, None, 1, -1, geom_id, normal)
        if length <= 0 or geom_id[0] == 5:
            hits[5] += geom_id[0] == 5
            continue
        hits[geom_id[0]] += 1
        end = shapes.track.to_body(start + length * ray, 0)[None]
        phi, n = shapes.scene.shapes[geom_id[0]].signed_distance_and_normal(end)
        assert abs(phi[0]) < 1e-6
        np.testing.assert_allclose(shapes.track.rotation(0) @ n[0], normal, atol=1e-3)
    assert (hits > 10).all()
    corners = wedge.track.to_scene(wedge.scene.surface.vertices_m, 0)
    frame = data.geom_xmat[5].reshape(3, 3)
    expected = model.mesh_vert @ frame.T + data.geom_xpos[5]
    np.testing.assert_allclose(np.sort(corners, axis=0), np.sort(expected, axis=0), atol=1e-6)
    sides = np.linalg.norm(corners[:, None] - corners, axis=2)
    np.testing.assert_allclose(np.unique(sides.round(6)), [0, 0.1, np.sqrt(0.02).round(6)], atol=1e-5)


def test_a_height_field_is_closed_and_triangulated_as_in_mujoco() -> None:
    heights = "0 1 .3 .2  .5 .6 .1 .9  .3 .2 .8 0"
    asset = f'<asset><hfield name="h" nrow="3" ncol="4" size="1 2 .5 .1" elevation="{heights}"/></asset>'
    scene = opened('<geom type="hfield" hfield="h"/>', asset, seconds=0.001)
    (ground,) = scene.bodies()
    surface = ground.scene.surface  # type: ignore[attr-defined]
    assert ground.name == "world" and surface.is_closed and surface.volume_m3() > 8 * 0.1
    model = mujoco.MjModel.from_xml_path("model.xml")
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    corners = surface.vertices_m[surface.triangles]
    for x, y in np.random.default_rng(1).uniform((-0.99, -1.99), (0.99, 1.99), (100, 2)):
        length = mujoco.mj_ray(
            model, data, np.array([x, y, 3.0]), np.array([0, 0, -1.0]), None, 1, -1, np.zeros(1, np.int32)
        )
        assert length > 0
        edges = corners[..., :2] - (x, y)
        turns = edges[:, :, 0] * np.roll(edges[:, :, 1], -1, axis=1) - edges[:, :, 1] * np.roll(
            edges[:, :, 0], -1, axis=1
        )
        above = corners[(turns > 0).all(axis=1)]
        assert len(above) == 1
        weight = np.roll(turns[(turns > 0).all(axis=1)][0], -1)
        assert (weight @ above[0, :, 2]) / weight.sum() == pytest.approx(3.0 - length, abs=1e-6)


def test_a_pendulum_swings_with_its_period() -> None:
    rod = (
        '<body name="bob" pos="0 0 1"><joint axis="0 1 0" pos="0 0 0"/><geom size=".01" pos=".02 0 '
        '-1"/></body>'
    )
    scene = opened(rod, seconds=2.5)
    turn = scene.bodies()[0].track.quaternions[:, 2]
    middle = np.sign(turn - (turn.max() + turn.min()) / 2)
    crossings = np.flatnonzero(np.diff(middle)) / 1000
    assert 2 * (crossings[1] - crossings[0]) == pytest.approx(2 * np.pi * np.sqrt(1 / 9.81), rel=0.01)


def test_poses_are_reproducible() -> None:
    tracks = [opened(FLOOR + BALL, seconds=0.5).bodies()[1].track for _ in range(2)]
    assert tracks[0].positions_m.tobytes() == tracks[1].positions_m.tobytes()


def test_visual_geoms_are_omitted() -> None:
    looks = '<geom size=".2" contype="0" conaffinity="0"/>'
    scene = opened(
        f'<body name="a">{looks}<geom size=".1"/></body><body name="ghost">{looks}</body>', seconds=0.01
    )
    assert [body.name for body in scene.bodies()] == ["a"]
    assert scene.bodies()[0].scene.bounds_m().tolist() == [[-0.1] * 3, [0.1] * 3]
    assert any("only look" in note and "2 geoms" in note for note in scene.notes)
    with pytest.raises(SourceError, match="nothing that can be touched, and 1 geoms that only look"):
        opened(f'<body name="ghost">{looks}</body>', seconds=0.01)
    named = looks.replace("<geom", '<geom name="g"')
    paired = f'<body name="a">{named}</body><body name="b"><geom name="h" size=".1"/></body>'
    scene = opened(paired, '<contact><pair geom1="g" geom2="h"/></contact>', seconds=0.001)
    assert [body.name for body in scene.bodies()] == ["a", "b"]


def test_soft_bodies_are_omitted_and_noted() -> None:
    cloth = (
        '<flexcomp name="cloth" type="grid" count="3 3 1" spacing=".1 .1 .1" radius=".01" mass="1" pos="0 0 '
        '1"/>'
    )
    scene = opened(FLOOR + cloth, seconds=0.01)
    assert [body.name for body in scene.bodies()] == ["world"]
    assert any("Left out" in note and "flex" in note for note in scene.notes)


def test_bodies_without_names_and_several_meshes() -> None:
    asset = f'<asset><mesh name="wedge" {WEDGE}/></asset>'
    two = '<geom type="mesh" mesh="wedge"/><geom type="mesh" mesh="wedge" pos=".2 0 0"/>'
    scene = opened(f'<body>{two}</body><body><geom size=".1"/></body>', asset, seconds=0.001)
    assert [body.name for body in scene.bodies()] == ["body 1/geom 0", "body 1/geom 1", "body 2"]


@pytest.mark.parametrize(
    ("world", "rest", "message"),
    [
        ('<geom type="mesh" mesh="m"/>', '<asset><mesh name="m" file="gone.stl"/></asset>', "gone.stl"),
        ('<geom type="cube" size="1"/>', "", "cube"),
        ("<site/>", "", "nothing that can be touched"),
        (
            '<body><joint type="slide" stiffness="1e14" springref="1" /><geom size=".1"/></body>',
            "",
            "diverges",
        ),
        (BALL, '<option timestep="1e-300"/>', ""),
    ],
)
def test_errors_are_one_line_and_name_the_file(world: str, rest: str, message: str) -> None:
    stiff = '<option><flag eulerdamp="disable"/></option>' if message == "diverges" else ""
    with pytest.raises((SourceError, InvalidArgument)) as caught:
        opened(world, stiff + rest, seconds=0.1)
    assert "model.xml" in str(caught.value) and message in str(caught.value) and "\n" not in str(caught.value)
    assert not Path("MUJOCO_LOG.TXT").exists()


def test_too_long_a_simulation_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="poses"):
        opened(BALL, seconds=1e9)
    with pytest.raises(InvalidArgument, match="steps"):
        opened(BALL, '<option timestep="1e-7"/>', seconds=10.0)


@pytest.mark.parametrize(
    ("data", "is_model"),
    [
        (b"<mujoco/>", True),
        (b"\xef\xbb\xbf<?xml version='1.0'?>\n<!-- <b> -->\n<!DOCTYPE mujoco>\n <mujoco model='a'>", True),
        (b"<mujocoinclude/>", False),
        (b"<robot><mujoco/></robot>", False),
        (b"<!-- <mujoco>", False),
        (b"", False),
    ],
)
def test_recognised_by_the_root_element(data: bytes, is_model: bool) -> None:
    Path("a.xml").write_bytes(data)
    Path("a.txt").write_bytes(data)
    assert KIND.recognise(Path("a.xml")) is is_model and not KIND.recognise(Path("a.txt"))


@given(st.binary(max_size=60) | st.text("<mujoco/> =\"'!-?", max_size=60).map(str.encode))
def test_any_bytes_give_a_scene_or_a_touchfield_error(
    tmp_path_factory: pytest.TempPathFactory, data: bytes
) -> None:
    path = tmp_path_factory.mktemp("xml") / "x.xml"
    path.write_bytes(data)
    assert not KIND.recognise(path) or b"<mujoco" in data
    with pytest.raises(SourceError):
        KIND.open(path, SourceOptions(seconds=0.01))


def test_files_that_name_too_many_others_are_refused(tmp_path: Path) -> None:
    names, folders = (
        "".join(form.format(i) for i in range(300))
        for form in ('<mesh file="{}.stl"/>', '<compiler meshdir="{}"/>')
    )
    (tmp_path / "a.xml").write_text(f"<mujoco>{folders}<asset>{names}</asset></mujoco>")
    with pytest.raises(SourceError, match=r"a\.xml: found 300 files in 301 folders"):
        check_files(tmp_path / "a.xml")
    for i in range(257):
        (tmp_path / f"{i}.xml").write_text(f'<mujocoinclude><include file="{i + 1}.xml"/></mujocoinclude>')
    check_files(tmp_path / "1.xml")
    with pytest.raises(SourceError, match="more than 256 files that include others"):
        check_files(tmp_path / "0.xml")

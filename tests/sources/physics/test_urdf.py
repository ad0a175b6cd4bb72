"""Robots in URDF as scenes: their shapes and meshes, packages, first pose, and faults."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from hypothesis import given, strategies as st

from touchfield.errors import SourceError
from touchfield.medium.pose_track import rotation_matrices
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.urdf import KIND
from touchfield.sources.registry import open_source

pytest.importorskip("mujoco", reason='needs the simulator: pip install "touchfield[physics]"')

BOX = '<geometry><box size=".2 .1 .4"/></geometry>'
BALL = '<geometry><sphere radius=".05"/></geometry>'
INERTIA = (
    '<inertial><mass value="1"/><inertia ixx=".01" iyy=".01" izz=".01" ixy="0" ixz="0" iyz="0"/></inertial>'
)
HINGE = (
    '<joint name="elbow" type="continuous"><parent link="base"/><child link="arm"/>'
    '<origin xyz="0 0 .5" rpy="0 0 .3"/><axis xyz="0 1 0"/></joint>'
)


def link(name: str, *shapes: str, kind: str = "collision", origin: str = "0 0 0") -> str:
    inside = "".join(f'<{kind}><origin xyz="{origin}"/>{shape}</{kind}>' for shape in shapes)
    return f'<link name="{name}">{INERTIA}{inside}</link>'


def mesh(name: str, scale: str = "1 1 1") -> str:
    return f'<geometry><mesh filename="{name}" scale="{scale}"/></geometry>'


ARM = link("arm", BALL, origin=".3 0 0")


def opened(path: Path, *parts: str, head: str = "<robot name='r'>", **options: Any) -> BodyScene:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(f"<?xml version='1.0'?><!-- a test -->{head}{''.join(parts)}</robot>")
    scene = open_source(path, SourceOptions(**{"seconds": 0.001, **options}))
    assert isinstance(scene, BodyScene)
    return scene


def save_box(path: Path, size: tuple[float, float, float] = (0.2, 0.1, 0.4)) -> trimesh.Trimesh:
    path.parent.mkdir(parents=True, exist_ok=True)
    box = trimesh.creation.box(size)
    box.export(path)
    return box


def test_links_are_bodies_and_joints_start_at_zero(tmp_path: Path) -> None:
    arm = link("arm", BALL, origin=".3 0 0")
    scene = opened(tmp_path / "r.urdf", link("base", BOX), arm, HINGE, seconds=0.2)
    world, moving = scene.bodies()
    assert (scene.frame_count, world.track.is_constant, moving.name) == (200, True, "arm")
    np.testing.assert_allclose(world.scene.bounds_m(), [[-0.1, -0.05, -0.2], [0.1, 0.05, 0.2]])
    np.testing.assert_allclose(moving.track.positions_m[0], [0, 0, 0.5], atol=1e-9)
    turn = rotation_matrices(moving.track.quaternions[:1])[0]
    np.testing.assert_allclose(turn[0], [np.cos(0.3), -np.sin(0.3), 0], atol=1e-9)
    assert any("1 joint without a motor" in note for note in scene.notes)
    assert not any("time step" in note for note in scene.notes)


def test_a_heavy_arm_falls(tmp_path: Path) -> None:
    heavy = link("arm", BALL, origin=".3 0 0").replace("<inertial>", '<inertial><origin xyz=".3 0 0"/>')
    scene = opened(tmp_path / "r.urdf", link("base", BOX), heavy, HINGE, seconds=0.2)
    turns = rotation_matrices(scene.bodies()[1].track.quaternions)
    angles = np.arccos(np.clip(turns[:, 2, 2], -1, 1))
    assert angles[0] == pytest.approx(0, abs=1e-6)
    # angle of a rod that starts level: half of the acceleration m g r / (I + m r^2) times t^2
    expected = 9.81 * 0.3 / (0.01 + 0.09) * 0.1**2 / 2
    assert angles[100] == pytest.approx(expected, rel=0.05)


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply", ".off", ".glb"])
@pytest.mark.parametrize("scale", ["1 1 1", "2 -1 .5"])
def test_a_mesh_of_any_format_is_at_its_place(tmp_path: Path, ending: str, scale: str) -> None:
    box = save_box(tmp_path / f"meshes/b{ending}")
    scene = opened(tmp_path / "r.urdf", link("base", mesh(f"meshes/b{ending}", scale), origin="1 2 3"))
    (body,) = scene.bodies()
    half, middle = np.abs(np.array(box.extents) * np.array(scale.split(), float)) / 2, np.array([1, 2, 3])
    np.testing.assert_allclose(body.scene.bounds_m(), [middle - half, middle + half], atol=1e-6)
    assert isinstance(body.scene, MeshScene) and body.scene.is_closed


def test_a_package_is_the_folder_with_package_xml(tmp_path: Path) -> None:
    save_box(tmp_path / "ws/my_robot/meshes/a.stl")
    (tmp_path / "ws/my_robot/package.xml").write_text("<package/>")
    robot = tmp_path / "ws/my_robot/urdf/deep/r.urdf"
    for name in ("package://my_robot/meshes/a.stl", "package://renamed/meshes/a.stl", "../../meshes/a.stl"):
        assert len(opened(robot, link("base", mesh(name))).bodies()) == 1
    save_box(tmp_path / "ws/other/a.stl")
    with pytest.raises(SourceError, match=r"no such file in .*my_robot; .*--allow-outside"):
        opened(robot, link("base", mesh("package://other/a.stl")))
    with pytest.raises(SourceError, match="a file in the folder"):
        opened(robot, link("base", mesh("../../../other/a.stl")))
    assert opened(robot, link("base", mesh("package://other/a.stl")), allow_outside=True).bodies()


def test_without_a_package_a_mesh_lies_beside_the_robot(tmp_path: Path) -> None:
    save_box(tmp_path / "robots/a.stl")
    save_box(tmp_path / "meshes/b.stl")
    robot = tmp_path / "robots/r.urdf"
    assert opened(robot, link("base", mesh("package://somewhere/meshes/a.stl"))).bodies()
    with pytest.raises(SourceError, match=r"b\.stl'.*--allow-outside"):
        opened(robot, link("base", mesh("../meshes/b.stl")))
    with pytest.raises(SourceError, match="an address of kind 'https'"):
        opened(robot, link("base", mesh("https://example.org/a.stl")))
    with pytest.raises(SourceError, match=r"gone\.stl'.*no such file"):
        opened(robot, link("base", mesh("gone.stl")))


def test_a_link_outside_of_the_package_is_refused(tmp_path: Path) -> None:
    save_box(tmp_path / "secret/a.stl")
    (tmp_path / "robots").mkdir()
    (tmp_path / "robots/a.stl").symlink_to(tmp_path / "secret/a.stl")
    with pytest.raises(SourceError, match="a file in the folder"):
        opened(tmp_path / "robots/r.urdf", link("base", mesh("a.stl")))


def test_collision_shapes_are_touched_and_what_is_left_out_is_noted(tmp_path: Path) -> None:
    parts = [link("base", BOX), HINGE, link("arm", BALL, kind="visual"), "<gazebo/><gazebo/><material/>"]
    scene = opened(tmp_path / "r.urdf", *parts)
    assert [body.name for body in scene.bodies()] == ["world"]
    assert "Elements that are not used: 2 gazebo." in scene.notes
    assert "Links with a visual shape only, which are left out: 1." in scene.notes
    looks = opened(tmp_path / "r.urdf", link("base", BOX, kind="visual"))
    assert any("the visual ones are touched" in note for note in looks.notes)
    np.testing.assert_allclose(looks.bounds_m(), scene.bounds_m())


def test_links_that_overlap_do_not_push_each_other_away(tmp_path: Path) -> None:
    joint = HINGE.replace("continuous", "floating").replace('xyz="0 0 .5"', 'xyz="0 0 .1"')
    calm = '<mujoco><option gravity="0 0 0"/></mujoco>'
    scene = opened(tmp_path / "r.urdf", calm, link("base", BOX), link("arm", BALL), joint, seconds=0.1)
    np.testing.assert_allclose(scene.bodies()[1].track.positions_m, np.tile([0, 0, 0.1], (100, 1)), atol=1e-9)
    assert any("overlap at the start, and so do not collide: world and arm" in note for note in scene.notes)


def test_a_link_without_mass_is_changed_and_noted(tmp_path: Path) -> None:
    light = link("arm").replace('value="1"', 'value="0"')
    scene = opened(tmp_path / "r.urdf", link("base", BOX), light, HINGE)
    assert any("Masses and inertias are changed" in note for note in scene.notes)


def test_repairs_and_openings_of_meshes_are_noted(tmp_path: Path) -> None:
    box = save_box(tmp_path / "a.stl")
    trimesh.Trimesh(box.vertices, box.faces[:-4]).export(tmp_path / "open.stl")
    scene = opened(tmp_path / "r.urdf", link("base", mesh("a.stl"), mesh("open.stl")))
    assert any(note.startswith("world/") and "one-sided shell" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot><link name='a'/></robot>", "no link with a shape"),
        ("<robot", "no XML"),
        ("<sdf/>", "the element 'sdf'; expected robot"),
        ("<!DOCTYPE robot [<!ENTITY a 'b'>]><robot/>", "Remove the DOCTYPE"),
        (f"<robot>{link('a', BOX)}{HINGE}</robot>", "a robot that MuJoCo cannot read"),
        (f"<robot>{link('${prefix}', BOX)}</robot>", "an expression of xacro, '${prefix}'"),
        (
            f"<robot xmlns:xacro='http://www.ros.org/wiki/xacro'><xacro:arm/>{link('a', BOX)}</robot>",
            "xacro r.urdf -o expanded.urdf, then encode expanded.urdf",
        ),
        (f"<robot>{link('a', mesh('flat.obj'))}</robot>", "flat.obj: found a flat mesh"),
    ],
)
def test_faults_are_one_line_that_names_the_file(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    path = tmp_path / "r.urdf"
    path.write_text(text)
    with pytest.raises(SourceError) as caught:
        open_source(path, SourceOptions(seconds=0.001))
    assert message in str(caught.value) and "r.urdf" in str(caught.value) and "\n" not in str(caught.value)


def test_elements_within_elements_do_not_matter(tmp_path: Path) -> None:
    deep = "<a>" * 5000 + "</a>" * 5000
    nested = HINGE.replace("</joint>", deep + "</joint>")
    scene = opened(tmp_path / "r.urdf", link("base", BOX).replace("</link>", deep + "</link>"), nested, ARM)
    assert [body.name for body in scene.bodies()] == ["world", "arm"]


@given(st.binary(max_size=60) | st.text("<robot/link name=\"'!-?${>", max_size=60).map(str.encode))
def test_any_bytes_are_refused_by_one_error(tmp_path_factory: pytest.TempPathFactory, data: bytes) -> None:
    path = tmp_path_factory.mktemp("urdf") / "x.urdf"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"x\.urdf"):
        KIND.open(path, SourceOptions(seconds=0.001))


def test_a_robot_is_recognised_by_its_root_element(tmp_path: Path) -> None:
    for name, head, is_robot in (
        ("r.urdf", "<robot name='r'>", True),
        ("r.xml", "<robot>", True),
        ("r.xml", "<robots>", False),
        ("r.xml", "<mujoco>", False),
    ):
        (tmp_path / name).write_text(f"<!-- a -->\n{head}</robot>")
        assert KIND.recognise(tmp_path / name) is is_robot
    drake = "<robot xmlns='http://drake.mit.edu' name='r'>"
    assert opened(tmp_path / "d.urdf", link("base", BOX), head=drake).bodies()


def test_too_many_instances_of_a_mesh_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.sources.mesh.mesh_data._MAX_TRIANGLES", 100)
    save_box(tmp_path / "a.stl")
    parts = [link("base", *(mesh("a.stl", f"{n} 1 1") for n in range(1, 3)))]
    assert opened(tmp_path / "r.urdf", *parts).bodies()
    trimesh.creation.icosphere(subdivisions=4).export(tmp_path / "b.stl")
    with pytest.raises(SourceError, match="instances with"):
        opened(tmp_path / "r.urdf", link("base", *(mesh("b.stl", f"{n} 1 1") for n in range(1, 3))))

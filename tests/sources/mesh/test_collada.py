"""COLLADA files: their units, axes, instances and polygons, what is left out, and hostile ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mesh_makers import CUBE_FACES, cube
from touchfield.errors import SourceError
from touchfield.sources.mesh.mesh_files import KIND
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

pytest.importorskip("collada", reason='needs a reader: pip install "touchfield[meshes]"')

NODE = '<node id="n">{}<instance_geometry url="#cube"/></node>'


def numbers(values: np.ndarray) -> str:
    return " ".join(f"{value:g}" for value in np.asarray(values).reshape(-1))


TRIANGLES = (
    f'<triangles count="{len(CUBE_FACES)}"><input semantic="VERTEX" source="#v" offset="0"/>'
    f"<p>{numbers(CUBE_FACES)}</p></triangles>"
)


def geometry(faces: str = TRIANGLES, vertices: np.ndarray | None = None) -> str:
    points = cube()[0] if vertices is None else vertices
    return (
        f'<geometry id="cube"><mesh><source id="p"><float_array id="pa" count="{points.size}">'
        f'{numbers(points)}</float_array><technique_common><accessor source="#pa" count="{len(points)}" '
        'stride="3"><param name="X" type="float"/><param name="Y" type="float"/>'
        '<param name="Z" type="float"/></accessor></technique_common></source><vertices id="v">'
        '<input semantic="POSITION" source="#p"/>'
        f"</vertices>{faces}</mesh></geometry>"
    )


def save(
    path: Path, nodes: str = NODE.format(""), asset: str = "", geometries: str | None = None, more: str = ""
) -> Path:
    path.write_text(
        '<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">'
        f"<asset>{asset}</asset><library_geometries>{geometries or geometry()}</library_geometries>{more}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )
    return path


def opened(path: Path, **options: float) -> MeshScene:
    scene = open_source(path, SourceOptions(**options))  # type: ignore[arg-type]
    assert isinstance(scene, MeshScene)
    return scene


@pytest.mark.parametrize(
    ("asset", "axes"),
    [
        ("<up_axis>Z_UP</up_axis>", "x east, y north, z up"),
        ("<up_axis>Y_UP</up_axis>", "x right, y up, z towards the viewer"),
        ("", "x right, y up, z towards the viewer"),
    ],
)
def test_unit_and_axes_are_those_of_the_file(tmp_path: Path, asset: str, axes: str) -> None:
    path = save(tmp_path / "a.dae", asset=f'<unit meter="0.0254" name="inch"/>{asset}')
    scene = opened(path)
    assert scene.is_closed and scene.axes == axes and len(scene.surface.triangles) == 12
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [0.0254] * 3])
    assert scene.notes[0] == "One unit is 0.0254 m, as the file states: 0.0254 x 0.0254 x 0.0254 m."
    other = opened(path, unit_m=0.5)
    np.testing.assert_allclose(other.bounds_m(), [[0, 0, 0], [0.5] * 3])
    assert "0.5 m, although the file states 0.0254 m" in other.notes[0]
    bare = save(tmp_path / "b.dae")
    assert "taken as metres" in opened(bare).notes[0]


def test_instances_are_placed_by_their_nodes_and_mirrors_turn_them(tmp_path: Path) -> None:
    turned = "<rotate>0 0 1 90</rotate><translate>5 0 0</translate>"
    mirrored = "<matrix>-2 0 0 -1 0 1 0 0 0 0 1 0 0 0 0 1</matrix>"
    library = f"<library_nodes>{NODE.format(mirrored).replace('>', ' >', 1)}</library_nodes>"
    nodes = f'<node>{turned}<instance_geometry url="#cube"/></node><node><instance_node url="#n"/></node>'
    scene = opened(save(tmp_path / "a.dae", nodes, more=library))
    assert scene.is_closed and scene.surface.volume_m3() == pytest.approx(1 + 2)
    np.testing.assert_allclose(scene.bounds_m(), [[-3, 0, 0], [0, 6, 1]], atol=1e-6)


def test_concave_polygons_are_not_folded(tmp_path: Path) -> None:
    outline = np.array([[0, 0], [2, 0], [2, 2], [1, 0.5], [0, 2]], float)  # a notch from above
    points = np.concatenate([np.insert(outline, 2, z, axis=1) for z in (0.0, 1.0)])
    sides = [[i, (i + 1) % 5, 5 + (i + 1) % 5, 5 + i] for i in range(5)]
    polygons = [[4, 3, 2, 1, 0], [5, 6, 7, 8, 9], *sides]
    counts, corners = [len(p) for p in polygons], np.concatenate(polygons)
    faces = (
        f'<polylist count="{len(polygons)}"><input semantic="VERTEX" source="#v" offset="0"/>'
        f"<vcount>{numbers(np.array(counts))}</vcount><p>{numbers(corners)}</p></polylist>"
    )
    scene = opened(save(tmp_path / "a.dae", geometries=geometry(faces, points)))
    areas = np.linalg.norm(
        np.cross(*(scene.surface.vertices_m[scene.surface.triangles[:, i]] - scene.surface.vertices_m[
            scene.surface.triangles[:, 0]] for i in (1, 2))), axis=1) / 2  # fmt: skip
    around = np.linalg.norm(np.roll(outline, -1, axis=0) - outline, axis=1).sum()
    assert scene.is_closed and areas.sum() == pytest.approx(2 * 2.5 + around)
    assert scene.surface.volume_m3() == pytest.approx(2.5)


def test_what_is_not_read_is_noted(tmp_path: Path) -> None:
    more = "<library_animations><animation><animation/></animation></library_animations>"
    lines = '<lines count="1"><input semantic="VERTEX" source="#v" offset="0"/><p>0 1</p></lines>'
    nodes = NODE.format("") + '<node><instance_geometry url="#gone"/></node>'
    scene = opened(save(tmp_path / "a.dae", nodes, geometries=geometry(TRIANGLES + lines), more=more))
    notes = " ".join(scene.notes)
    assert "The file is animated; it is read at rest" in notes and "Left out: lines." in notes
    assert "1 elements that cannot be read are left out; the first: DaeBrokenRefError" in notes or (
        "1 elements that cannot be read" in notes and "gone" in notes
    )


def test_a_skin_is_read_in_its_bind_shape(tmp_path: Path) -> None:
    def floats(name: str, values: np.ndarray, param: str, stride: int, array: str = "float_array") -> str:
        texts = numbers(values) if array == "float_array" else " ".join(values)
        return (
            f'<source id="{name}"><{array} id="{name}a" count="{len(values)}">{texts}</{array}>'
            f'<technique_common><accessor source="#{name}a" count="{len(values) // stride}" '
            f'stride="{stride}">{param}</accessor></technique_common></source>'
        )

    joints = floats("j", np.array(["bone"]), '<param name="JOINT" type="name"/>', 1, "Name_array")
    binds = floats("b", np.eye(4).reshape(-1), '<param name="TRANSFORM" type="float4x4"/>', 16)
    weights = floats("w", np.array([1.0]), '<param name="WEIGHT" type="float"/>', 1)
    skin = (
        '<library_controllers><controller id="c"><skin source="#cube"><bind_shape_matrix>2 0 0 0 0 1 0 0 '
        f"0 0 1 0 0 0 0 1</bind_shape_matrix>{joints}{binds}{weights}"
        '<joints><input semantic="JOINT" source="#j"/><input semantic="INV_BIND_MATRIX" source="#b"/>'
        "</joints>"
        '<vertex_weights count="8"><input semantic="JOINT" source="#j" offset="0"/>'
        '<input semantic="WEIGHT" source="#w" offset="1"/><vcount>1 1 1 1 1 1 1 1</vcount>'
        "<v>0 0 0 0 0 0 0 0 0 0 0 0 0 0 0 0</v></vertex_weights></skin></controller></library_controllers>"
    )
    nodes = '<node id="bone" sid="bone" type="JOINT"/><node><instance_controller url="#c"/></node>'
    scene = opened(save(tmp_path / "a.dae", nodes, more=skin))
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [2, 1, 1]])
    assert any("skinned meshes are read in their bind shape" in note for note in scene.notes)


def nested(depth: int, count: int = 2) -> str:
    """Nodes of a library, of which each uses the next `count` times."""
    inside = "".join(
        f'<node id="k{n}">{f"""<instance_node url="#k{n + 1}"/>""" * count}</node>' for n in range(depth)
    )
    return (
        f'<library_nodes>{inside}<node id="k{depth}"><instance_geometry url="#cube"/></node></library_nodes>'
    )


@pytest.mark.parametrize(
    ("nodes", "more", "message"),
    [
        ('<node><instance_node url="#k0"/></node>', nested(40), "Export fewer instances"),
        ('<node><instance_node url="#k0"/></node>', nested(2).replace("#k2", "#k0"), "within itself"),
        ("<node/>", "", "no triangle"),
    ],
)
def test_hostile_instances_are_refused(tmp_path: Path, nodes: str, more: str, message: str) -> None:
    with pytest.raises(SourceError, match=message):
        opened(save(tmp_path / "a.dae", nodes, more=more))


def test_few_instances_are_read(tmp_path: Path) -> None:
    scene = opened(save(tmp_path / "a.dae", '<node><instance_node url="#k0"/></node>', more=nested(3)))
    assert len(scene.surface.triangles) == 12  # eight times at one place
    assert any("84 triangles removed" in note for note in scene.notes)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda text: text[: len(text) // 2], "no XML"),
        (lambda text: "<kml/>", "the element 'kml'; expected a COLLADA file"),
        (lambda text: "<!DOCTYPE a [<!ENTITY b 'c'>]>" + text.partition("?>")[2], "Remove the DOCTYPE"),
        (lambda text: "PK\3\4", "no XML"),
        (lambda text: text.replace("<p>0 1 3", "<p>0 1 99"), "no triangle that can be read"),
        (lambda text: text.replace('url="#cube"', 'url="#gone"'), "no triangle that can be read"),
    ],
)
def test_damaged_files_are_one_clear_error(tmp_path: Path, change, message: str) -> None:  # type: ignore[no-untyped-def]
    path = save(tmp_path / "a.dae")
    path.write_text(change(path.read_text()))
    assert KIND.recognise(path)
    with pytest.raises(SourceError) as caught:
        opened(path)
    assert message in str(caught.value) and "\n" not in str(caught.value)

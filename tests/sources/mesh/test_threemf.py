"""3MF files: their units, builds and components, what is left out, and hostile ones."""

from __future__ import annotations

import io
import zipfile
from pathlib import Path

import numpy as np
import pytest

from mesh_makers import Mesh, cube
from touchfield.errors import SourceError
from touchfield.sources.mesh.mesh_files import KIND
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source

pytest.importorskip("lib3mf", reason='needs a reader: pip install "touchfield[meshes]"')

TYPES = (
    '<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types"><Default Extension="rels" '
    'ContentType="application/vnd.openxmlformats-package.relationships+xml"/><Default Extension="model" '
    'ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/></Types>'
)
RELATIONS = (
    '<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships"><Relationship '
    'Target="/3D/3dmodel.model" Id="r" Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>'
    "</Relationships>"
)


def body(number: int, mesh: Mesh | None = None, kind: str = "model") -> str:
    vertices, faces = mesh or cube()
    points = "".join(f'<vertex x="{x}" y="{y}" z="{z}"/>' for x, y, z in vertices)
    corners = "".join(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in faces)
    inside = f"<mesh><vertices>{points}</vertices><triangles>{corners}</triangles></mesh>"
    return f'<object id="{number}" type="{kind}">{inside}</object>'


def group(number: int, *parts: tuple[int, str]) -> str:
    inside = "".join(f'<component objectid="{part}" {place}/>' for part, place in parts)
    return f'<object id="{number}" type="model"><components>{inside}</components></object>'


def at(*numbers: float) -> str:
    """A transform: three rows that multiply a row vector, and the shift."""
    return f'transform="{" ".join(map(str, numbers))}"'


def save(path: Path, objects: str, *items: tuple[int, str], unit: str = 'unit="millimeter"') -> Path:
    build = "".join(f'<item objectid="{number}" {place}/>' for number, place in items)
    model = (
        f'<?xml version="1.0"?><model {unit} '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">'
        f"<resources>{objects}</resources><build>{build}</build></model>"
    )
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("[Content_Types].xml", TYPES)
        archive.writestr("_rels/.rels", RELATIONS)
        archive.writestr("3D/3dmodel.model", model)
    return path


def opened(path: Path, **options: float) -> MeshScene:
    scene = open_source(path, SourceOptions(**options))  # type: ignore[arg-type]
    assert isinstance(scene, MeshScene)
    return scene


@pytest.mark.parametrize(
    ("unit", "unit_m"),
    [('unit="inch"', 0.0254), ('unit="micron"', 1e-6), ('unit="centimeter"', 0.01), ("", 0.001)],
)
def test_the_unit_is_that_of_the_file(tmp_path: Path, unit: str, unit_m: float) -> None:
    path = save(tmp_path / "a.3mf", body(1), (1, ""), unit=unit)
    scene = opened(path)
    assert scene.is_closed and scene.axes == "x east, y north, z up"
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [unit_m] * 3])
    assert f"One unit is {unit_m:g} m, as the file states" in scene.notes[0]
    np.testing.assert_allclose(opened(path, unit_m=2.0).bounds_m(), [[0, 0, 0], [2, 2, 2]])


def test_components_and_items_are_placed_and_mirrors_turn_them(tmp_path: Path) -> None:
    turn = at(0, 1, 0, -1, 0, 0, 0, 0, 1, 10, 0, 0)  # by 90 degrees about z, then along x
    mirror = at(-1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0, 0)
    objects = body(1) + group(2, (1, at(1, 0, 0, 0, 1, 0, 0, 0, 1, 3, 0, 0)), (1, mirror)) + body(7)
    scene = opened(save(tmp_path / "a.3mf", objects, (2, turn), unit='unit="meter"'))
    # cubes at x 3 to 4 and -1 to 0; a quarter turn makes y of x, and -x of y
    np.testing.assert_allclose(scene.bounds_m(), [[9, -1, 0], [10, 4, 1]], atol=1e-6)
    assert scene.is_closed and scene.surface.volume_m3() == pytest.approx(2)  # object 7 is not built


def test_supports_are_left_out_and_noted(tmp_path: Path) -> None:
    objects = body(1) + body(2, kind="support")
    moved = at(1, 0, 0, 0, 1, 0, 0, 0, 1, 5, 0, 0)
    scene = opened(save(tmp_path / "a.3mf", objects, (1, ""), (2, moved)))
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [0.001] * 3])
    assert any("Left out: 1 objects of type support." in note for note in scene.notes)
    with pytest.raises(SourceError, match="no triangle"):
        opened(save(tmp_path / "b.3mf", body(2, kind="support"), (2, "")))


def test_hostile_components_are_refused(tmp_path: Path) -> None:
    doubled = body(1) + "".join(group(n, (n - 1, ""), (n - 1, "")) for n in range(2, 42))
    with pytest.raises(SourceError, match="instances of"):
        opened(save(tmp_path / "a.3mf", doubled, (41, "")))
    deep = body(1) + "".join(group(n, (n - 1, "")) for n in range(2, 3000))
    with pytest.raises(SourceError, match="3000 deep"):
        opened(save(tmp_path / "b.3mf", deep, (2999, "")))


def test_an_archive_that_unpacks_to_far_more_is_refused(tmp_path: Path) -> None:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("3D/3dmodel.model", b" " * (1 << 25))
    (tmp_path / "a.3mf").write_bytes(stream.getvalue())
    with pytest.raises(SourceError, match="that declares 33554432"):
        opened(tmp_path / "a.3mf")


def test_damaged_files_are_one_clear_error(tmp_path: Path) -> None:
    whole = save(tmp_path / "a.3mf", body(1), (1, "")).read_bytes()
    faults = [b"", b"PK", whole[:200], whole[:-30], bytes(len(whole))]
    for data in (*faults, whole[:90] + bytes(40) + whole[130:]):
        (tmp_path / "b.3mf").write_bytes(data)
        assert KIND.recognise(tmp_path / "b.3mf")
        with pytest.raises(SourceError, match=r"b\.3mf: found"):
            opened(tmp_path / "b.3mf")
    vertices, faces = cube()
    with pytest.raises(SourceError):
        opened(save(tmp_path / "c.3mf", body(1, (vertices, faces + 4)), (1, "")))

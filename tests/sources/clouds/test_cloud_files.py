"""Files of points: every format gives the same cloud, and damage is one clear error."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from cloud_makers import RADIUS_M, pcd, plane, ply, sphere, text_of
from touchfield.errors import InvalidArgument, MissingExtra, SourceError, TouchfieldError
from touchfield.pipeline import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.clouds.cloud_files import KIND, open_cloud, read_cloud
from touchfield.sources.clouds.cloud_scene import CloudScene
from touchfield.sources.mesh.mesh_scene import MeshScene
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import CAMERA_AXES

POINTS, NORMALS, _ = sphere(300)


def write(folder: Path, name: str, with_normals: bool = False) -> Path:
    """Write the sphere in one of the formats."""
    normals, path = NORMALS if with_normals else None, folder / name
    if path.suffix == ".ply":
        return ply(path, POINTS, normals, {"a": "ascii", "l": "<", "b": ">"}[path.stem])
    if path.suffix == ".pcd":
        form = {"a": "ascii", "b": "binary", "c": "binary_compressed"}[path.stem]
        return pcd(path, POINTS, form, normals)
    rows = POINTS if normals is None else np.concatenate([POINTS, normals], axis=1)
    head = b"300\n" if path.suffix == ".pts" else b"# x y z\n"
    path.write_bytes(head + text_of(rows))
    return path


def refusal(path: Path) -> str | None:
    """The message of the error for a file; None if it is read."""
    try:
        open_cloud(path, SourceOptions())
    except TouchfieldError as error:
        return str(error)
    return None


FORMATS = ("a.ply", "l.ply", "b.ply", "a.pcd", "b.pcd", "c.pcd", "t.xyz", "t.pts")


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("with_normals", [False, True])
def test_every_format_gives_the_same_points(tmp_path: Path, name: str, with_normals: bool) -> None:
    path = write(tmp_path, name, with_normals)
    assert KIND.recognise(path)
    cloud = read_cloud(path)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-8)
    assert len(cloud.normals) == 300 * with_normals
    if with_normals:
        np.testing.assert_allclose(cloud.normals, NORMALS, atol=1e-6)
    assert ("not used: intensity" in " ".join(cloud.notes)) == (path.suffix == ".pcd")
    scene = open_source(path, SourceOptions(unit_m=0.001))
    assert isinstance(scene, CloudScene) and scene.bounds_m().max() < 1e-3 * (RADIUS_M + 0.01)
    assert ("those of the file" in " ".join(scene.notes)) == with_normals


@pytest.mark.parametrize("name", FORMATS)
def test_a_file_cut_anywhere_is_one_clear_error_or_fewer_points(tmp_path: Path, name: str) -> None:
    data = write(tmp_path, name).read_bytes()
    for length in (0, 3, 20, 150, len(data) // 3, len(data) // 2 + 7, len(data) - 30):
        path = tmp_path / f"cut{Path(name).suffix}"
        path.write_bytes(data[:length])
        text = refusal(path)
        assert path.suffix in (".xyz", ".pts") if text is None else path.name in text and "\n" not in text


@pytest.mark.parametrize(
    ("name", "old", "new"),
    [
        ("l.ply", b"vertex 300", b"vertex 99999999999999"),
        ("a.ply", b"vertex 300", b"vertex 400000000"),
        ("a.ply", b"vertex 300", b"vertex -1"),
        ("b.pcd", b"POINTS 300", b"POINTS 88888888888888"),
        ("a.pcd", b"POINTS 300", b"POINTS 400000000"),
        ("a.pcd", b"POINTS 300", b"POINTS -300"),
        ("c.pcd", b"POINTS 300", b"POINTS 400000000"),
        ("b.pcd", b"COUNT 1 1 1 4", b"COUNT 1 1 1 400000000"),
        ("b.pcd", b"SIZE 4", b"SIZE 9"),
        ("b.pcd", b"TYPE F", b"TYPE Q"),
        ("b.pcd", b"FIELDS x", b"FIELDS q"),
        ("b.pcd", b"WIDTH 300\n", b""),
        ("c.pcd", b"DATA binary_compressed", b"DATA binary_zipped"),
        ("t.pts", b"300\n", b"1 2\n"),
    ],
)
def test_hostile_headers_are_refused_within_bounds(tmp_path: Path, name: str, old: bytes, new: bytes) -> None:
    path = write(tmp_path, name)
    data = path.read_bytes()
    assert old in data
    path.write_bytes(data.replace(old, new, 1))
    with pytest.raises(TouchfieldError) as caught:
        open_cloud(path, SourceOptions(kind="cloud"))
    assert path.name in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize("position", range(0, 200, 13))
def test_damaged_compressed_data_is_refused_or_read(tmp_path: Path, position: int) -> None:
    path = write(tmp_path, "c.pcd")
    data = bytearray(path.read_bytes())
    data[data.index(b"compressed\n") + 11 + position] ^= 0xFF
    path.write_bytes(data)
    assert path.name in (refusal(path) or path.name)


def test_a_count_that_no_compression_reaches_is_refused(tmp_path: Path) -> None:
    path = write(tmp_path, "c.pcd")
    data = path.read_bytes().replace(b"POINTS 300", b"POINTS 9000000", 1)
    start = data.index(b"compressed\n") + 11
    sizes = np.array([100, 9_000_000 * 24], "<u4").tobytes()
    path.write_bytes(data[:start] + sizes + data[start + 8 :])
    with pytest.raises(SourceError, match="which no compression reaches"):
        read_cloud(path)


def test_invalid_and_repeated_points_are_counted(tmp_path: Path) -> None:
    points = np.concatenate([POINTS, POINTS[:50], np.full((7, 3), np.nan), [[np.inf, 0, 0]]])
    scene = open_cloud(pcd(tmp_path / "a.pcd", points, "binary"), SourceOptions())
    text = " ".join(scene.notes)
    assert "8 points without finite coordinates are left out" in text
    assert "50 points at the position of another are left out" in text
    assert "300 points, " in text


@pytest.mark.parametrize(
    "points", [np.zeros((0, 3)), np.full((40, 3), np.nan), np.zeros((40, 3)), POINTS[:5]]
)
@pytest.mark.parametrize("form", ["ascii", "binary"])
def test_clouds_with_hardly_a_point_are_refused(tmp_path: Path, points: np.ndarray, form: str) -> None:
    path = pcd(tmp_path / "few.pcd", points, form)
    with pytest.raises(SourceError, match=r"few\.pcd.*points"):
        open_source(path)


def test_a_ply_with_faces_stays_a_mesh(tmp_path: Path) -> None:
    head = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    faces = "element face 4\nproperty list uchar int vertex_indices\nend_header\n"
    corners = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n"
    path = tmp_path / "both.ply"
    path.write_text(f"{head}{faces}{corners}3 0 2 1\n3 0 1 3\n3 0 3 2\n3 1 2 3\n")
    assert isinstance(open_source(path), MeshScene)
    path.write_text(f"{head}{faces.replace('face 4', 'face 0')}{corners}")
    with pytest.raises(SourceError, match="4 points with different finite coordinates"):
        open_source(path)


def test_a_cloud_read_as_a_mesh_names_the_right_kind(tmp_path: Path) -> None:
    path = ply(tmp_path / "points.ply", POINTS)
    with pytest.raises(SourceError, match=r"300 points and no triangle.*--as cloud"):
        open_source(path, SourceOptions(kind="mesh"))
    assert isinstance(open_source(path, SourceOptions(kind="cloud")), CloudScene)


def test_other_columns_of_a_text_are_noted(tmp_path: Path) -> None:
    colours = np.random.default_rng(0).integers(0, 256, (300, 3))
    path = tmp_path / "a.xyz"
    path.write_bytes(text_of(np.concatenate([POINTS, colours, NORMALS], axis=1)))
    cloud = read_cloud(path)
    assert len(cloud.normals) == 300 and "Columns that are not used: 4, 5, 6." in cloud.notes
    path.write_bytes(
        b"x,y,z,r,g,b\n" + text_of(np.concatenate([POINTS, colours], axis=1)).replace(b" ", b",")
    )
    cloud = read_cloud(path)
    assert len(cloud.normals) == 0 and len(cloud.points) == 300
    path.write_bytes(text_of(POINTS).replace(b"\n", b"\n\n"))
    assert len(read_cloud(path).points) == 300
    path.write_text("3\nwater\nO 0 0 0\nH 1 0 0\nH 0 1 0\n")
    with pytest.raises(SourceError, match=r"a\.xyz"):
        read_cloud(path)


def test_the_viewpoint_of_a_pcd_tells_the_side(tmp_path: Path) -> None:
    points = plane(600)[0]
    for height_m in (1, -1):
        scene = open_cloud(
            pcd(tmp_path / "seen.pcd", points, viewpoint=f"0 0 {height_m} 1 0 0 0"), SourceOptions()
        )
        assert (np.sign(scene.surface.surfels.normals[:, 2]) == height_m).all()
    unset = open_cloud(pcd(tmp_path / "unset.pcd", points), SourceOptions())
    assert "face outward" in " ".join(unset.notes)
    rows = open_cloud(pcd(tmp_path / "rows.pcd", points + np.array([0, 0, 1]), height=20), SourceOptions())
    assert (rows.surface.surfels.normals[:, 2] < 0).all() and rows.axes == CAMERA_AXES


def test_a_side_that_the_file_does_not_tell_is_refused(tmp_path: Path) -> None:
    path = ply(tmp_path / "a.ply", POINTS)
    for side, missing in (("given", "no normals"), ("scanner", "no positions of a scanner")):
        with pytest.raises(InvalidArgument, match=rf"--normals.*a\.ply, which has {missing}"):
            open_cloud(path, SourceOptions(normals=side))


def test_coordinates_far_from_the_origin_become_relative(tmp_path: Path) -> None:
    points = POINTS * 1000 + np.array([500_000, 4_649_776, 0])
    scene = open_cloud(ply(tmp_path / "far.ply", points), SourceOptions())
    assert np.abs(scene.bounds_m()).max() < 60
    assert "Coordinates are relative to" in " ".join(scene.notes)
    assert scene.surface.spacing_m == pytest.approx(1000 * open_cloud(
        ply(tmp_path / "near.ply", POINTS), SourceOptions()
    ).surface.spacing_m, rel=0.02)  # fmt: skip


def test_a_cloud_becomes_a_medium_with_its_notes(tmp_path: Path) -> None:
    path = ply(tmp_path / "ball.ply", *sphere(2000)[:2])
    prepared = prepare(path, EncodeSpec(nw=5))
    text = " ".join(prepared.notes)
    assert "points, " in text and "Normals are those of the file" in text
    assert prepared.medium[0].sample_n(np.zeros(3)) == pytest.approx(np.zeros(3), abs=0.05)


def test_the_decoded_force_starts_within_half_the_spacing(tmp_path: Path) -> None:
    points, _, spacing_m = sphere(2000)
    tf.encode(ply(tmp_path / "ball.ply", points), tmp_path / "ball.touch", EncodeSpec(nw=6, mapping="1"))
    angles = np.linspace(0, 2 * np.pi, 24, endpoint=False)
    starts = []
    with tf.open_stream(tmp_path / "ball.touch") as stream:
        middle_m = stream.placement.offset_m
        for angle in angles:
            towards = np.array([np.cos(angle), np.sin(angle), 0.0])
            for radius_m in np.arange(1.2 * RADIUS_M, 0.8 * RADIUS_M, -1e-4):
                force_n = stream.medium[0].sample_n(radius_m * towards - middle_m)
                if np.linalg.norm(force_n) > 0.1:
                    starts.append(radius_m)
                    break
    assert len(starts) == len(angles)
    assert np.abs(np.array(starts) - RADIUS_M).max() < 0.5 * spacing_m


def thin_plate() -> tuple[np.ndarray, np.ndarray]:
    """Points on both sides of a plate of 100 x 100 x 1 mm, and their normals."""
    points, normals, _ = plane(4000, noise=0.0)
    return np.concatenate([points, points - np.array([0, 0, 1e-3])]), np.concatenate([normals, -normals])


def test_a_plate_too_thin_for_the_lattice_is_thickened(tmp_path: Path) -> None:
    path = ply(tmp_path / "plate.ply", *thin_plate())
    prepared = prepare(path, EncodeSpec(nw=6, mapping="1"))
    assert "thickened: plate.ply of 1 mm is now" in " ".join(prepared.notes)
    kept = prepare(path, EncodeSpec(nw=6, mapping="1", thin="keep"))
    assert "the hand may pass through" in " ".join(kept.notes)
    largest = []
    for medium in (prepared.medium, kept.medium):
        forces = [medium[0].sample_n([0.0, 0.0, z])[2] for z in np.linspace(-0.004, 0.004, 81)]
        largest.append(min(max(forces), -min(forces)))
    assert largest[0] > 2 * largest[1] > 0  # the force on either side, newtons
    thick = ply(tmp_path / "sphere.ply", *sphere(2000)[:2])
    assert "Too thin" not in " ".join(prepare(thick, EncodeSpec(nw=6, mapping="1")).notes)


# -- LAS and E57, which need libraries ----------------------------------------------------------------------
def las(path: Path, points: np.ndarray, classes: np.ndarray | None = None) -> Path:
    laspy = pytest.importorskip("laspy", reason="extra points: laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.offsets, header.scales = points.min(axis=0), [1e-3] * 3
    data = laspy.LasData(header)
    data.x, data.y, data.z = points.T
    if classes is not None:
        data.classification = classes
    data.write(path)
    return path


def hills(count: int = 1500) -> np.ndarray:
    """Ground in UTM coordinates, metres."""
    at = np.random.default_rng(2).uniform(0, 100, (count, 2))
    height = 5 * np.sin(at[:, 0] / 15) * np.cos(at[:, 1] / 20)
    return np.append(at, height[:, None], axis=1) + np.array([500_000, 4_649_776, 300])


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_ground_of_a_las_faces_up_and_noise_is_left_out(tmp_path: Path, suffix: str) -> None:
    points = np.concatenate([hills(), hills(40) + np.array([0, 0, 80])])
    classes = np.array([2] * 1500 + [18] * 20 + [7] * 20)
    if suffix == ".laz":
        pytest.importorskip("lazrs", reason="extra points: lazrs")
    scene = open_source(las(tmp_path / f"ground{suffix}", points, classes))
    assert isinstance(scene, CloudScene)
    text = " ".join(scene.notes)
    assert "40 points that are noise" in text and "face up" in text and "One unit is 1 m" in text
    assert (scene.surface.surfels.normals[:, 2] > 0.5).all()
    assert np.abs(scene.bounds_m()).max() < 60 and np.ptp(scene.bounds_m()[:, 2]) < 12


@pytest.mark.parametrize(("word", "unit_m"), [("US survey foot", 0.304800609601219), ("metre", 1.0)])
def test_the_unit_of_a_las_is_that_of_its_coordinate_system(tmp_path: Path, word: str, unit_m: float) -> None:
    laspy = pytest.importorskip("laspy", reason="extra points: laspy")
    path = las(tmp_path / "feet.las", hills())
    data = laspy.read(path)
    geographic = 'GEOGCS["NAD83",UNIT["degree",0.0174532925199433]]'
    data.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(
        f'PROJCS["Oregon",{geographic},UNIT["{word}",{unit_m}]]'
    ))  # fmt: skip
    data.write(path)
    scene = open_cloud(path, SourceOptions())
    assert np.ptp(scene.bounds_m()[:, 0]) == pytest.approx(100 * unit_m, rel=0.05)
    assert f"One unit is {unit_m:g} m" in scene.notes[0]
    data.header.vlrs.clear()
    data.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(geographic))
    data.write(path)
    with pytest.raises(SourceError, match="coordinates in degrees"):
        open_cloud(path, SourceOptions())


def test_damaged_las_is_one_clear_error(tmp_path: Path) -> None:
    data = las(tmp_path / "a.las", hills(200)).read_bytes()
    for length in (0, 4, 100, 300, len(data) // 2, len(data) - 1):
        path = tmp_path / "cut.las"
        path.write_bytes(data[:length])
        with pytest.raises(SourceError, match=r"cut\.las"):
            open_cloud(path, SourceOptions())
    path = tmp_path / "records.las"
    for at in (100, 243):  # numbers of records, each of which would be read
        path.write_bytes(data[:at] + (1 << 31).to_bytes(4, "little") + data[at + 4 :])
        with pytest.raises(SourceError, match="2147483648 records"):
            open_cloud(path, SourceOptions())
    path = tmp_path / "many.las"
    path.write_bytes(data[:247] + (1 << 60).to_bytes(8, "little") + data[255:])
    with pytest.raises(TouchfieldError, match=r"many\.las"):
        open_cloud(path, SourceOptions())


def test_a_chunk_table_that_cannot_be_is_refused(tmp_path: Path) -> None:
    """lazrs would allocate 16 bytes for each of its chunks, and abort."""
    pytest.importorskip("lazrs", reason="extra points: lazrs")
    data = bytearray(las(tmp_path / "a.laz", hills(200)).read_bytes())
    points_at = int.from_bytes(data[96:100], "little")
    table_at = int.from_bytes(data[points_at : points_at + 8], "little")
    data[table_at + 4 : table_at + 8] = b"\xff" * 4
    (tmp_path / "chunks.laz").write_bytes(data)
    with pytest.raises(SourceError, match="4294967295 chunks in a table"):
        open_cloud(tmp_path / "chunks.laz", SourceOptions())


def test_a_panic_of_lazrs_is_one_clear_error(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    """Its report, with a stack of Rust, would go to stderr past Python."""
    pytest.importorskip("lazrs", reason="extra points: lazrs")
    data = bytearray(las(tmp_path / "a.laz", hills(200)).read_bytes())
    items_at = data.index(b"laszip encoded") - 2 + 54 + 32  # of the record: the number of its items
    data[items_at : items_at + 2] = bytes(2)
    path = tmp_path / "items.laz"
    path.write_bytes(data)
    with pytest.raises(SourceError, match=r"items\.laz: found .*PanicException"):
        open_cloud(path, SourceOptions())
    assert capfd.readouterr().err == ""
    os.write(2, b"as before")
    assert capfd.readouterr().err == "as before"


def test_e57_joins_scans_and_faces_their_scanners(tmp_path: Path) -> None:
    pye57 = pytest.importorskip("pye57", reason="extra points: pye57")
    points, path = plane(800)[0], tmp_path / "two.e57"
    half = np.sqrt(0.5)
    with pye57.E57(str(path), mode="w") as file:
        for height_m in (1.0, 1.5):
            seen = points @ np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]]) - np.array([0, height_m, 0])
            columns = {f"cartesian{axis}": np.ascontiguousarray(seen[:, i]) for i, axis in enumerate("XYZ")}
            file.write_scan_raw(
                columns, rotation=np.array([half, half, 0, 0]), translation=np.array([0, 0, height_m])
            )
    cloud = read_cloud(path)
    assert len(cloud.points) == 1600 and [round(at[2], 6) for _, _, at in cloud.scanners] == [1.0, 1.5]
    np.testing.assert_allclose(cloud.points[:800], points, atol=1e-6)
    scene = open_cloud(path, SourceOptions())
    assert "face the scanner" in " ".join(scene.notes)
    assert (scene.surface.surfels.normals[:, 2] > 0.5).all()
    data = path.read_bytes()
    for length in (0, 40, len(data) // 2):
        path.write_bytes(data[:length])
        with pytest.raises(SourceError, match=r"two\.e57"):
            read_cloud(path)
    assert path.exists()


@pytest.mark.parametrize(("name", "library"), [("a.las", "laspy"), ("a.e57", "pye57")])
def test_a_missing_library_names_the_extra(
    tmp_path: Path, name: str, library: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, library, None)
    (tmp_path / name).write_bytes(b"LASF")
    with pytest.raises(MissingExtra, match=r"touchfield\[points\]"):
        open_source(tmp_path / name)

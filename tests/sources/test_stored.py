"""Stored fields: round trips, reading by other programs, and one-line errors for damage."""

from __future__ import annotations

import math
import struct
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.atomic import atomic_path
from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.stores.npz import NpzArchive, read_npz, write_npz
from touchfield.medium.stores.vti import write_vti
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.stored import KIND, StoredScene

PROFILE = profile_of(LawSpec(), 0.01)


@pytest.fixture
def medium(wavy_field: ForceField) -> HapticMedium:
    frames = [wavy_field, ForceField.empty(wavy_field.grid), wavy_field.scaled(-0.5)]
    return HapticMedium.from_frames(frames, 1000 / 3, "x east, y north, z up \N{GREEK SMALL LETTER PHI} <&>")


@st.composite
def fields(draw: st.DrawFn) -> ForceField:
    shape = draw(st.tuples(*[st.integers(1, 21)] * 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dense = rng.normal(size=(*shape, 3)).astype(np.float32)
    dense[rng.random(shape) > draw(st.sampled_from([0.0, 0.02, 1.0]))] = 0
    return ForceField.from_dense(Grid(shape, (0.001, 0.002, 0.003), (0.1, -0.2, 0.3)), dense)


# -- slabs and atomic files --------------------------------------------------------------------------------


@given(fields(), st.integers(0, 2))
def test_slabs_are_the_dense_field_in_pieces(field: ForceField, axis: int) -> None:
    slabs = list(field.slabs(axis))
    np.testing.assert_array_equal(np.concatenate(slabs, axis=axis), field.to_dense())
    assert max(slab.shape[axis] for slab in slabs) <= 8
    assert axis or ForceField.from_slabs(field.grid, iter(slabs)) == field


@pytest.mark.parametrize("error", [KeyboardInterrupt, ValueError, InvalidArgument])
def test_an_interrupted_write_leaves_nothing_new(tmp_path: Path, error: type[BaseException]) -> None:
    path = tmp_path / "a.npz"
    path.write_text("older")
    raised = error("x", "y") if error is InvalidArgument else error()
    with pytest.raises(error), atomic_path(path) as temporary:  # noqa: PT012
        assert temporary.parent == tmp_path
        assert temporary.suffix == ".npz"
        temporary.write_text("half")
        raise raised
    assert path.read_text() == "older"
    assert list(tmp_path.iterdir()) == [path]


def test_an_atomic_file_appears_complete_and_through_links(tmp_path: Path) -> None:
    path, link = tmp_path / "a.txt", tmp_path / "link.txt"
    path.write_text("older")
    link.symlink_to(path)
    with atomic_path(link) as temporary:
        temporary.write_text("newer")
        assert path.read_text() == "older"
    assert path.read_text() == "newer"
    assert link.is_symlink()
    (tmp_path / "fresh").touch()
    assert path.stat().st_mode == (tmp_path / "fresh").stat().st_mode
    assert len(list(tmp_path.iterdir())) == 3
    long = tmp_path / ("n" * 255)  # the longest name that systems accept
    with atomic_path(long) as temporary:
        temporary.write_text("long")
    assert long.read_text() == "long"


def test_a_reader_of_the_old_file_is_not_affected(tmp_path: Path) -> None:
    path = tmp_path / "a.txt"
    path.write_text("older")
    node = path.stat().st_ino
    with path.open() as older:
        with atomic_path(path) as temporary:
            temporary.write_text("newer, and longer")
            written = temporary.stat().st_ino
        assert older.read() == "older"  # a copy in place would be visible here
    assert path.read_text() == "newer, and longer"
    assert path.stat().st_ino == written != node


def test_an_unwritable_path_is_an_error(tmp_path: Path) -> None:
    for path in (tmp_path / "absent" / "a.npz", tmp_path):
        with pytest.raises(InvalidArgument, match=str(path)), atomic_path(path):
            pytest.fail("the block must not begin")
    with pytest.raises(SourceError, match="No space left"), atomic_path(tmp_path / "a.npz"):
        raise OSError(28, "No space left on device")
    with pytest.raises(SourceError, match="nnn"), atomic_path(tmp_path / ("n" * 300)):
        pytest.fail("the block must not begin")
    assert not list(tmp_path.iterdir())


# -- npz ---------------------------------------------------------------------------------------------------


def test_npz_keeps_the_medium_and_numpy_reads_it(tmp_path: Path, medium: HapticMedium) -> None:
    path, counted = tmp_path / "a.npz", []
    write_npz(path, medium, lambda done, of: counted.append(done))
    assert counted == [1, 2, 3]
    read = read_npz(path)
    assert (read.grid, read.rate_hz, read.axes, len(read)) == (medium.grid, medium.rate_hz, medium.axes, 3)
    for order in ([0, 1, 2], [2, 0, 0, 1], [1]):
        assert all(read[i] == medium[i] for i in order)
    assert read.tags == medium.tags == ("direct",)
    for tags in (("direct", "symbolic"), ()):
        write_npz(tmp_path / "tagged.npz", replace(medium, tags=tags, friction=0.3, damping_n_s_per_m=2.0))
        read = read_npz(tmp_path / "tagged.npz")
        assert (read.tags, read.friction, read.damping_n_s_per_m) == (tags, 0.3, 2.0)
    with np.load(path) as arrays:
        assert str(arrays["axes"]) == medium.axes
        np.testing.assert_array_equal(arrays["origin_m"], medium.grid.origin_m)
        np.testing.assert_array_equal(arrays["forces_n"], np.stack([f.to_dense() for f in medium]))
    again = tmp_path / "b.npz"
    write_npz(again, medium)
    assert again.read_bytes() == path.read_bytes()


def test_npz_of_other_programs(tmp_path: Path, wavy_field: ForceField) -> None:
    lattice = {"origin_m": wavy_field.grid.origin_m, "spacing_m": wavy_field.grid.spacing_m}
    for save in (np.savez, np.savez_compressed):
        save(tmp_path / "a.npz", forces_n=wavy_field.to_dense().astype(">f8"), **lattice)
        read = read_npz(tmp_path / "a.npz")
        assert (len(read), read.rate_hz, read.axes) == (1, 30.0, "x, y, z")
        assert read[0] == wavy_field


def test_invalid_npz_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    good = {
        "forces_n": np.zeros((2, 3, 4, 5, 3)),
        "origin_m": np.zeros(3),
        "spacing_m": np.ones(3),
        "rate_hz": 5.0,
    }
    faults = [
        {"forces_n": np.zeros((3, 4, 5))},
        {"forces_n": np.zeros((2, 3, 4, 5, 2))},
        {"forces_n": np.zeros((0, 3, 4, 5, 3))},
        {"forces_n": np.zeros((2, 3, 4, 5, 3), complex)},
        {"forces_n": np.asfortranarray(np.zeros((2, 3, 4, 5, 3)))},
        {"forces_n": np.full((2, 3, 4, 5, 3), None)},
        {"origin_m": np.zeros(2)},
        {"origin_m": np.array([0, np.nan, 0])},
        {"spacing_m": np.array([1.0, 0.0, 1.0])},
        {"rate_hz": -1.0},
        {"rate_hz": "fast"},
        {"axes": np.array(["x", "y"])},
        {"axes": np.array("x" * 20_000)},
    ]
    for fault in faults:
        np.savez(path, **{**good, **fault})
        with pytest.raises(SourceError, match=r"a\.npz"):
            read_npz(path)
    for absent in good:
        np.savez(path, **{k: v for k, v in good.items() if k != absent})
        with pytest.raises(SourceError, match=absent):
            read_npz(path)
    for value in (np.nan, np.inf, 1e300):
        good["forces_n"][1, 0, 0, 0, 0] = value
        np.savez(path, **good)
        read = read_npz(path)
        assert read[0].support_count == 0
        with pytest.raises(SourceError, match="not finite"):
            read[1]


def test_an_npz_with_a_too_large_header_is_refused(tmp_path: Path) -> None:
    header = repr(
        {"descr": "<f4", "fortran_order": False, "shape": (1, 1 << 20, 1 << 20, 1 << 20, 3)}
    ).encode()
    header = header.ljust(117) + b"\n"
    entry = b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header + b"\0" * 100
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("forces_n.npy", entry)
    with pytest.raises(SourceError, match="forces_n"):
        read_npz(tmp_path / "a.npz")


def test_an_npz_entry_beyond_the_ratio_of_deflate_is_refused(tmp_path: Path) -> None:
    path, shape = tmp_path / "a.npz", (1, 512, 512, 256, 3)
    header = repr({"descr": "<f4", "fortran_order": False, "shape": shape}).encode().ljust(117) + b"\n"
    entry = b"\x93NUMPY\x01\0" + struct.pack("<H", len(header)) + header + bytes(12000)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("forces_n.npy", entry)
        packed = archive.getinfo("forces_n.npy").compress_size
    claimed = 128 + 4 * math.prod(shape)  # in the central directory as in the header
    entries, signature, listed = path.read_bytes().partition(b"PK\x01\x02")
    for packed_size in (packed, claimed // 2):  # more than deflate can expand, or more than the file has
        directory = listed.replace(
            struct.pack("<II", packed, len(entry)), struct.pack("<II", packed_size, claimed)
        )
        path.write_bytes(entries + signature + directory)
        with pytest.raises(SourceError, match=f"found {claimed} bytes for float32"):
            NpzArchive(path).header("forces_n")


@pytest.mark.parametrize("order", ["C", "F"])
def test_arrays_of_either_order_round_trip(tmp_path: Path, order: str) -> None:
    values = np.arange(24, dtype=np.int16).reshape(2, 3, 4)
    np.savez(tmp_path / "a.npz", values=np.asarray(values, order=order))  # type: ignore[call-overload]
    np.testing.assert_array_equal(NpzArchive(tmp_path / "a.npz").read("values"), values)


# -- vti ---------------------------------------------------------------------------------------------------


def forces_in_vti(path: Path) -> np.ndarray:
    """The vectors of a file, float32 [nx, ny, nz, 3], by VTK's description of appended data in zlib
    blocks.
    """
    head, _, data = path.read_bytes().partition(b'<AppendedData encoding="raw">\n   _')
    root = ElementTree.fromstring(head + b"</VTKFile>")
    assert root.attrib["header_type"] == "UInt64" and root.attrib["compressor"] == "vtkZLibDataCompressor"
    image = root[0]
    *_, nx, _, ny, _, nz = (int(n) + 1 for n in image.attrib["WholeExtent"].split())
    [vectors] = [a.attrib for a in image.iter("DataArray") if a.attrib["format"] == "appended"]
    at = int(vectors["offset"])
    count, block, last = struct.unpack_from("<3Q", data, at)
    sizes = struct.unpack_from(f"<{count}Q", data, at + 24)
    at += 24 + 8 * count
    parts = [zlib.decompress(data[at + sum(sizes[:i]) :][:size]) for i, size in enumerate(sizes)]
    assert [len(part) for part in parts] == [block] * (count - 1) + [last or block]
    assert vectors["NumberOfComponents"] == "3"
    return np.frombuffer(b"".join(parts), "<f4").reshape(nz, ny, nx, 3).transpose(2, 1, 0, 3)


def test_vti_stores_one_frame_and_pvd_lists_several(tmp_path: Path, medium: HapticMedium) -> None:
    single = write_vti(tmp_path / "one.vti", medium.between(0, 1))
    assert single == tmp_path / "one.vti"
    counted: list[int] = []
    several = write_vti(tmp_path / "film.vti", medium, lambda done, of: counted.append(done))
    assert several == tmp_path / "film.pvd"
    assert counted == [1, 2, 3]
    files = [set_.attrib for set_ in ElementTree.parse(several).iter("DataSet")]
    assert [float(entry["timestep"]) for entry in files] == [i / medium.rate_hz for i in range(3)]
    for frame, path in enumerate([single, *(tmp_path / entry["file"] for entry in files)]):
        field, i = medium[max(frame - 1, 0)], max(frame - 1, 0)
        np.testing.assert_array_equal(forces_in_vti(path), field.to_dense())
        image = ElementTree.fromstring(path.read_bytes().partition(b"<AppendedData")[0] + b"</VTKFile>")[0]
        for name, value in (("Origin", medium.grid.origin_m), ("Spacing", medium.grid.spacing_m)):
            assert tuple(map(float, image.attrib[name].split())) == value
        notes = {a.attrib["Name"]: a.text or "" for a in image[0]}
        assert (float(notes["TimeValue"]), float(notes["rate_hz"])) == (i / medium.rate_hz, medium.rate_hz)
        assert bytes(map(int, notes["axes"].split()))[:-1].decode() == medium.axes


@given(st.data())
@settings(max_examples=150)
def test_damaged_files_give_a_field_or_a_source_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / "a.npz"
    rng = np.random.default_rng(0)
    field = ForceField.from_dense(
        Grid((3, 4, 2), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0)), rng.normal(size=(3, 4, 2, 3))
    )
    write_npz(path, HapticMedium.from_frames([field, field], 30.0))
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(0, 3))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw[: data.draw(st.one_of(st.just(len(raw)), st.integers(0, len(raw))))])
    KIND.recognise(path)
    try:
        scene = KIND.open(path, SourceOptions())
        assert isinstance(scene, StoredScene)
        outcome = "" if all(np.isfinite(f.forces_n).all() for f in scene.stored) else "not finite"
    except SourceError as error:
        outcome = "" if path.name in str(error) else str(error)
    assert outcome == ""


# -- the scene ---------------------------------------------------------------------------------------------


def test_a_stored_scene_returns_the_stored_field_on_its_grid(tmp_path: Path, medium: HapticMedium) -> None:
    write_npz(tmp_path / "a.npz", medium)
    assert KIND.recognise(tmp_path / "a.npz")
    scene = KIND.open(tmp_path / "a.npz", SourceOptions())
    assert isinstance(scene, StoredScene)
    assert (scene.frame_count, scene.rate_hz, scene.axes) == (3, medium.rate_hz, medium.axes)
    np.testing.assert_allclose(scene.bounds_m(), np.stack(medium.grid.box_m))
    assert scene.field(2, medium.grid, PROFILE) == medium[2]


@given(
    fields(),
    st.tuples(*[st.integers(1, 30)] * 3),
    st.tuples(*[st.floats(0.2, 6.0)] * 3),
    st.tuples(*[st.floats(-9, 9)] * 3),
)
def test_a_stored_scene_samples_every_other_grid_trilinearly(
    field: ForceField, shape: tuple[int, int, int], coarser: tuple[float, ...], moved: tuple[float, ...]
) -> None:
    spacing = np.multiply(field.grid.spacing_m, coarser)
    origin = np.array(field.grid.origin_m) + np.multiply(moved, field.grid.spacing_m)
    grid = Grid(shape, tuple(spacing), tuple(origin))
    got = StoredScene(HapticMedium.from_frames([field], 30.0)).field(0, grid, PROFILE)
    at = grid.to_m(np.stack(np.meshgrid(*map(np.arange, shape), indexing="ij"), axis=-1))
    np.testing.assert_array_equal(got.to_dense(), field.sample_n(at))


def test_other_files_are_not_recognised_as_stored_fields(tmp_path: Path) -> None:
    np.savez(tmp_path / "ground.npz", z=np.zeros((3, 3)))
    (tmp_path / "bad.npz").write_bytes(b"PK")
    for name in ("ground.npz", "bad.npz", "absent.vti", "absent.npz", "a.ply"):
        assert not KIND.recognise(tmp_path / name)
    with pytest.raises(SourceError, match=r"a\.ply"):
        KIND.open(tmp_path / "a.ply", SourceOptions())
    for name in ("absent.vti", "absent.npz"):
        with pytest.raises(SourceError, match="absent"):
            KIND.open(tmp_path / name, SourceOptions())

"""Fields as zarr stores, written and read; the coder `touch` as a codec; tiles of a huge lattice."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield import EncodeSpec, Grid, prepare
from touchfield.cli.main import _exit_code
from touchfield.codec import TouchSpec
from touchfield.errors import InvalidArgument, MissingExtra, SourceError, TouchfieldError
from touchfield.filters import pyramid
from touchfield.medium import ForceField, HapticMedium
from touchfield.medium.stores.zarr_store import boxes, read_zarr, write_zarr
from touchfield.pipeline import tiles
from touchfield.pipeline.source import decode
from touchfield.pipeline.tiles import encode_tiles
from touchfield.sources.registry import open_source

zarr = pytest.importorskip("zarr", reason="the extra zarr is not installed")

SHAPES = st.tuples(*[st.integers(1, 20)] * 3)
SPEC = EncodeSpec(nw=5, touch=TouchSpec(effort="fast"))


def medium(shape: tuple[int, int, int], frames: int = 2, seed: int = 0) -> HapticMedium:
    """Frames of a few hundred random forces."""
    draw = np.random.default_rng(seed)
    forces = draw.standard_normal((frames, *shape, 3)) * (draw.random((frames, *shape, 1)) < 0.2)
    grid = Grid(shape, (0.001, 0.002, 0.003), (0.1, 0.0, -0.1))
    created = HapticMedium.from_array(forces.astype(np.float32), grid, 50.0, "x right, y up, z near")
    return replace(created, friction=0.25, damping_n_s_per_m=3.0, tags=("symbolic", "direct"))


@given(SHAPES, st.integers(1, 3), st.integers(0, 99))
@settings(max_examples=15, deadline=None)
def test_a_store_round_trips(shape: tuple[int, int, int], frames: int, seed: int) -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        path, source = Path(folder) / "a.zarr", medium(shape, frames, seed)
        write_zarr(path, source)
        again = read_zarr(path)
        assert all(a == b for a, b in zip(again, source, strict=True))
        for name in ("grid", "rate_hz", "axes", "friction", "damping_n_s_per_m", "tags"):
            assert getattr(again, name) == getattr(source, name)
        assert [p.name for p in Path(folder).iterdir()] == ["a.zarr"]


PLAIN_READER = """
import json, sys
sys.modules["touchfield"] = None  # as if it were not installed
import zarr
group = zarr.open_group(sys.argv[1], mode="r")
force_n = group["forces_n"][1, 3, 4, 5].tolist()
position_m = [float(group[axis][index]) for axis, index in zip("xyz", (3, 4, 5))]
print(json.dumps([force_n, position_m, float(group["t"][1]), dict(group.attrs)["touchfield"]]))
"""


def test_plain_zarr_reads_forces_and_positions_without_touchfield(tmp_path: Path) -> None:
    source = medium((20, 9, 17))
    write_zarr(tmp_path / "a.zarr", source)
    command = [sys.executable, "-c", PLAIN_READER, str(tmp_path / "a.zarr")]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    force_n, position_m, time_s, attributes = json.loads(done.stdout)
    assert force_n == source[1].to_dense()[3, 4, 5].tolist()
    assert position_m == source.grid.to_m((3, 4, 5)).tolist() and time_s == 1 / source.rate_hz
    assert attributes["rate_hz"] == source.rate_hz and attributes["axes"] == source.axes


def test_xarray_selects_forces_by_metres_and_seconds(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray", reason="the extra xarray is not installed")
    source = medium((20, 9, 17))
    write_zarr(tmp_path / "a.zarr", source)
    forces = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False).forces_n
    assert forces.dims == ("t", "x", "y", "z", "component") and forces.units == "N"
    assert [forces[name].units for name in "txyz"] == ["s", "m", "m", "m"]
    x, y, z = source.grid.to_m((7, 2, 16))
    selected = forces.sel(t=1 / source.rate_hz, x=x, y=y, z=z, method="nearest").values
    assert np.array_equal(selected, source[1].to_dense()[7, 2, 16])


def test_foreign_chunks_need_not_be_bricks(tmp_path: Path) -> None:
    source, path = medium((20, 9, 17)), tmp_path / "a.zarr"
    write_zarr(path, source)
    array = zarr.create_array(
        path,
        name="forces_n",
        shape=(2, 20, 9, 17, 3),
        chunks=(2, 5, 4, 17, 3),
        dtype="float64",
        overwrite=True,
    )
    array[:] = np.stack([field.to_dense() for field in source])
    assert list(read_zarr(path)) == list(source)


def test_levels_of_detail_are_stored(tmp_path: Path) -> None:
    """Every level lies where `multiscales` says and equals the output of `pyramid`; xarray opens them all."""
    xarray = pytest.importorskip("xarray", reason="the extra xarray is not installed")
    assert _exit_code(["encode", "sample:shapes", str(tmp_path / "a.touch"), "--nw", "5"]) == 0
    assert _exit_code(["lod", str(tmp_path / "a.touch"), str(tmp_path / "a.zarr"), "--levels", "2"]) == 0
    field = decode(tmp_path / "a.touch")[0]
    store = xarray.open_zarr(tmp_path / "a.zarr", consolidated=False)
    (scales,) = store.attrs["multiscales"]
    for n, level in enumerate((field, *pyramid(field, 2)[1:])):
        dataset = scales["datasets"][n]
        assert np.array_equal(store[dataset["path"]][0], level.to_dense())
        scale, translation = (t[t["type"]] for t in dataset["coordinateTransformations"])
        assert np.allclose(scale[:4], [1 / read_zarr(tmp_path / "a.zarr").rate_hz, *level.grid.spacing_m])
        assert np.allclose(translation[1:4], level.grid.origin_m)
        for axis, name in enumerate(store[dataset["path"]].dims[1:4]):
            index = np.zeros((level.grid.shape[axis], 3))
            index[:, axis] = np.arange(len(index))
            assert np.array_equal(store[name], level.grid.to_m(index)[:, axis])
    assert read_zarr(tmp_path / "a.zarr")[0].support_count == field.support_count


def test_an_empty_part_takes_no_bytes(tmp_path: Path) -> None:
    dense = np.zeros((2, 300, 20, 20, 3), np.float32)
    dense[0, 3, 3, 3] = dense[1, 260, 3, 3] = 1
    write_zarr(
        tmp_path / "a.zarr", HapticMedium.from_array(dense, Grid((300, 20, 20), (0.001,) * 3, (0.0,) * 3))
    )
    forces = tmp_path / "a.zarr" / "forces_n"
    files = [p for p in forces.rglob("*") if p.is_file() and p.name != "zarr.json"]
    assert len(files) == 2 and max(file.stat().st_size for file in files) < 5000
    assert all(
        np.array_equal(read.to_dense(), frame) for read, frame in zip(read_zarr(tmp_path / "a.zarr"), dense)
    )


def test_parts_cover_a_lattice_once() -> None:
    for shape in ((1, 1, 1), (257, 8, 300), (128, 129, 512)):
        count = np.zeros(shape, np.int8)
        for low, size in boxes(Grid(shape, (1, 1, 1), (0, 0, 0))):
            count[tuple(slice(a, a + n) for a, n in zip(low, size))] += 1
        assert (count == 1).all()


@given(SHAPES, st.integers(0, 99), st.sampled_from([0.03, 0.1, 0.5]), st.sampled_from([0.0, 0.05]))
@settings(max_examples=10, deadline=None)
def test_the_codec_keeps_the_error_bound_in_every_chunk(
    shape: tuple[int, int, int], seed: int, k: float, f0_n: float
) -> None:
    dense = np.stack([f.to_dense() for f in medium(shape, 2, seed)])
    codec = {"name": "touchfield.touch", "configuration": {"k": k, "f0_n": f0_n}}
    store: dict[str, Any] = {}
    array = zarr.create_array(
        zarr.storage.MemoryStore(store), shape=dense.shape, chunks=(2, 8, 16, 8, 3), dtype="float32",
        serializer=codec, compressors=None, fill_value=0.0,
    )  # fmt: skip
    array[:] = dense
    again = zarr.open_array(zarr.storage.MemoryStore(store), mode="r")[:]
    error, size = (np.linalg.norm(v.astype(np.float64), axis=-1) for v in (again - dense, dense))
    assert (error <= np.maximum(f0_n, k * size) * (1 + 1e-6)).all()


@pytest.mark.parametrize(
    "configuration", [{"k": 2}, {"k": "x"}, {"mode": "other"}, {"strange": 1}, {"spacing_m": [0, 1, 1]}]
)
def test_an_invalid_codec_configuration_is_refused(configuration: dict[str, Any]) -> None:
    with pytest.raises((InvalidArgument, TypeError)):
        zarr.create_array(
            zarr.storage.MemoryStore(), shape=(1, 8, 8, 8, 3), chunks=(1, 8, 8, 8, 3), dtype="float32",
            serializer={"name": "touchfield.touch", "configuration": configuration}, compressors=None,
        )  # fmt: skip


def test_it_is_a_source_and_an_output(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = str(tmp_path / "a.zarr"), str(tmp_path / "b.touch")
    assert _exit_code(["field", "sample:shapes", a, "--nw", "4"]) == 0
    assert _exit_code(["encode", a, b, "--nw", "4", "--k", "0.2"]) == 0
    assert _exit_code(["decode", b, str(tmp_path / "c.zarr")]) == 0
    x, y = (read_zarr(tmp_path / name)[0].to_dense() for name in ("a.zarr", "c.zarr"))
    assert (np.linalg.norm(x - y, axis=-1) <= np.maximum(0.05, 0.2 * np.linalg.norm(x, axis=-1)) + 1e-6).all()
    assert _exit_code(["field", "sample:shapes", a, "--nw", "4"]) == 2
    assert "a.zarr: found something there already" in capsys.readouterr().err


def damaged(tmp_path: Path, name: str) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    path = tmp_path / name
    if not (tmp_path / "good.zarr").exists():
        write_zarr(tmp_path / "good.zarr", medium((20, 20, 20)))
    shutil.copytree(tmp_path / "good.zarr", path)
    files = path / "zarr.json", path / "forces_n" / "zarr.json"
    group, array = (json.loads(file.read_text()) for file in files)
    return path, group, array


def test_a_foreign_store_is_refused_in_one_line(tmp_path: Path) -> None:
    def change(key: str, value: Any) -> Any:
        def of(group: dict[str, Any], array: dict[str, Any]) -> None:
            array[key] = value

        return of

    def about(key: str, value: Any) -> Any:
        def of(group: dict[str, Any], array: dict[str, Any]) -> None:
            group["attributes"]["touchfield"][key] = value

        return of

    huge = {"name": "regular", "configuration": {"chunk_shape": [1, 4096, 4096, 4096, 3]}}
    cases = {
        "shape": change("shape", [2, 20, 20, 3]),
        "negative": change("shape", [2, -1, 20, 20, 3]),
        "endless": change("shape", [1 << 40, 20, 20, 20, 3]),
        "text": change("shape", "many"),
        "kind": change("data_type", "complex64"),
        "chunks": lambda group, array: array.update(chunk_grid=huge, codecs=[{"name": "bytes"}]),
        "codec": change("codecs", [{"name": "bytes"}, {"name": "numcodecs.pickle"}]),
        "codecs": change("codecs", {"a": 1}),
        "inner": lambda group, array: array["codecs"][0]["configuration"]["codecs"].append(
            {"name": "pickle"}
        ),
        "spacing": about("spacing_m", [0, 1, 1]),
        "missing": lambda group, array: group["attributes"]["touchfield"].pop("rate_hz"),
        "nan": about("rate_hz", "fast"),
        "foreign": lambda group, array: group["attributes"].clear(),
        "version": lambda group, array: group.update(zarr_format=2),
    }
    for name, of in cases.items():
        path, group, array = damaged(tmp_path, f"{name}.zarr")
        of(group, array)
        (path / "zarr.json").write_text(json.dumps(group))
        (path / "forces_n" / "zarr.json").write_text(json.dumps(array))
        with pytest.raises(
            TouchfieldError, match={"shape": "shape", "inner": "the codec 'pickle'"}.get(name, "zarr")
        ) as caught:
            open_source(path)
        assert "\n" not in str(caught.value) and str(path) in str(caught.value), name
    for name, text in (("empty", ""), ("bare", "[]"), ("deep", "[" * 100_000), ("long", "0" * 65537)):
        path, _, _ = damaged(tmp_path, f"{name}.zarr")
        (path / "zarr.json").write_text(text)
        with pytest.raises(SourceError, match="at most 65536" if name in ("deep", "long") else name):
            open_source(path)
    (tmp_path / "none.zarr").mkdir()
    with pytest.raises(SourceError):
        open_source(tmp_path / "none.zarr")


def test_error_of_a_damaged_chunk_names_its_frame(tmp_path: Path) -> None:
    path, _, _ = damaged(tmp_path, "chunk.zarr")
    file = next(p for p in (path / "forces_n" / "c" / "1").rglob("*") if p.is_file())
    data = bytearray(file.read_bytes())
    data[10] ^= 255
    file.write_bytes(data)
    found = read_zarr(path)
    assert found[0].support_count
    with pytest.raises(SourceError, match="frame 1"):
        found[1]
    intact = read_zarr(tmp_path / "good.zarr")
    nan = intact[0].to_dense()
    nan[3, 3, 3] = np.nan
    zarr.open_array(path, path="forces_n", mode="r+")[0] = nan
    with pytest.raises(SourceError, match="frame 0"):
        read_zarr(path)[0]


def test_an_interrupted_write_leaves_nothing(tmp_path: Path) -> None:
    def broken(i: int) -> ForceField:
        if i:
            raise RuntimeError("a fault of the source")
        return medium((9, 9, 9))[0]

    with pytest.raises(RuntimeError):
        write_zarr(tmp_path / "a.zarr", replace(medium((9, 9, 9)), make_frame=broken))
    assert not list(tmp_path.iterdir())
    shutil.copytree(damaged(tmp_path, "old.zarr")[0], tmp_path / "a.zarr.parts")  # left by an interrupted run
    write_zarr(tmp_path / "a.zarr", medium((9, 9, 9)))
    assert read_zarr(tmp_path / "a.zarr").grid.shape == (9, 9, 9) and not (tmp_path / "a.zarr.parts").exists()


def test_without_the_library_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(__import__("sys").modules, "zarr", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[zarr\]"):
        write_zarr(tmp_path / "a.zarr", medium((8, 8, 8)))


@pytest.fixture
def small_tiles(monkeypatch: pytest.MonkeyPatch) -> None:
    from touchfield.medium.stores import zarr_store

    monkeypatch.setattr(zarr_store, "_SHARD", 16)
    monkeypatch.setattr(zarr_store, "_CHUNK", 16)


def test_tiles_equal_the_field_within_the_error_bound(
    tmp_path: Path, small_tiles: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(tiles, "_BLOCK_SAMPLES", 8)  # a tile in eight parts
    done = encode_tiles("sample:shapes", tmp_path / "a.zarr", SPEC)
    field = prepare("sample:shapes", replace(SPEC, representation="voxel")).medium[0]
    again = read_zarr(tmp_path / "a.zarr")
    assert again.grid == field.grid and done.tiles == 8
    assert done.supported_voxels == pytest.approx(field.support_count, rel=1e-3)
    assert done.file_bytes == sum(map(len, tree(tmp_path / "a.zarr").values()))
    x, y = field.to_dense().astype(np.float64), again[0].to_dense()
    assert (np.linalg.norm(x - y, axis=-1) <= np.maximum(0.05, 0.1 * np.linalg.norm(x, axis=-1)) + 2e-6).all()


def tree(path: Path) -> dict[str, bytes]:
    return {str(p.relative_to(path)): p.read_bytes() for p in path.rglob("*") if p.is_file()}


def test_finished_tiles_are_not_computed_again(
    tmp_path: Path, small_tiles: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    complete = encode_tiles("sample:shapes", tmp_path / "whole.zarr", SPEC)
    make, tile_count = tiles.make_tile, 0

    def fragile(tile: Any) -> int:
        nonlocal tile_count
        if tile_count == 5:
            raise OSError("the disk is full")
        tile_count += 1
        return make(tile)

    monkeypatch.setattr(tiles, "make_tile", fragile)
    out = tmp_path / "a.zarr"
    with pytest.raises(SourceError, match="the disk is full"):
        encode_tiles("sample:shapes", out, SPEC)
    assert not out.exists()
    with (tmp_path / "a.zarr.parts.txt").open("a") as stream:
        stream.write("0,16,16,16 12")  # a truncated line of a killed run, perhaps of 1234
    tile_count = 0
    done = encode_tiles("sample:shapes", out, SPEC)
    assert tile_count == 3 and any("5 of 8 tiles" in note for note in done.notes)
    assert done.supported_voxels == complete.supported_voxels
    assert tree(out) == tree(tmp_path / "whole.zarr")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.zarr", "whole.zarr"]
    tile_count = 0
    with pytest.raises(SourceError):
        encode_tiles("sample:shapes", tmp_path / "b.zarr", SPEC)
    tile_count = -10
    done = encode_tiles("sample:shapes", tmp_path / "b.zarr", replace(SPEC, touch=TouchSpec(k=0.3)))
    assert tile_count == -2 and not any("earlier run" in note for note in done.notes)


def test_workers_write_the_same_store(tmp_path: Path, small_tiles: None) -> None:
    from concurrent.futures import ThreadPoolExecutor

    encode_tiles("sample:shapes", tmp_path / "a.zarr", SPEC)
    with ThreadPoolExecutor(3) as workers:
        encode_tiles("sample:shapes", tmp_path / "b.zarr", SPEC, executor=workers)
    assert tree(tmp_path / "a.zarr") == tree(tmp_path / "b.zarr")


def test_options_that_need_the_whole_field_are_refused(tmp_path: Path) -> None:
    for spec in (
        replace(SPEC, filters=(("gaussian", "sigma=2mm"),)),
        replace(SPEC, vibration="gain=0.1,frequency=150", representation="voxel"),
        replace(SPEC, coder="paper", touch=TouchSpec()),
        replace(SPEC, device="tshirt-32x32"),
    ):
        with pytest.raises(InvalidArgument, match=r"a\.zarr: found"):
            encode_tiles("sample:shapes", tmp_path / "a.zarr", spec)
    assert not list(tmp_path.iterdir())

"""Height maps of more than `MAX_PIXELS` samples: means of the known heights, whatever the file.

The limits are lowered, so that small maps are large.
"""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from height_makers import METRES, TIE, geotiff
from touchfield.errors import SourceError
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.terrain import (
    geotiff as tiff_reader,
    height_files,
    height_grids,
    large_maps,
    tiff_bands,
)
from touchfield.sources.terrain.height_files import scene_of_xarray
from touchfield.sources.terrain.height_scene import HeightScene

ROWS, COLS = 131, 170
HEIGHTS = (200.0 + 3 * np.arange(ROWS)[:, None] + np.arange(COLS)).astype(np.float32)
HEIGHTS[40:60, 50:90] = np.nan
HEIGHTS.flags.writeable = False
SCALE = (33550, (2.0, 2.0, 0.0))


@pytest.fixture(autouse=True)
def small_limits(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(large_maps, "REDUCED_SAMPLES", 40 * 40)
    monkeypatch.setattr(large_maps, "BAND_SAMPLES", 500)
    for module in (large_maps, tiff_bands, height_grids, height_files):
        monkeypatch.setattr(module, "MAX_PIXELS", 10_000)
    monkeypatch.setattr(tiff_reader, "_FINE_SAMPLES", 30 * 30)


def means(heights: np.ndarray, factor: int) -> np.ndarray:
    rows, cols = (n // factor for n in heights.shape)
    cells = heights[: rows * factor, : cols * factor].astype(float).reshape(rows, factor, cols, factor)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # about cells without a known height
        return np.asarray(np.nanmean(cells, axis=(1, 3)))


EXPECTED = means(HEIGHTS, 4)  # ceil(sqrt(131 * 170 / 1600))


def opened(path: Path, **options: Any) -> HeightScene:
    scene = open_source(path, SourceOptions(**options))
    assert isinstance(scene, HeightScene)
    return scene


def assert_is_reduced(scene: HeightScene, cell_m: float = 8.0) -> None:
    np.testing.assert_allclose(scene._heights(0), EXPECTED, rtol=1e-5)
    low, high = scene.bounds_m()
    np.testing.assert_allclose((high - low)[:2], [41 * cell_m, 31 * cell_m], rtol=1e-6)
    note = f"The map of {ROWS} x {COLS} samples, {cell_m / 4:g} x {cell_m / 4:g} m apart, is read as 32 x 42"
    assert any(n.startswith(note) and "4 x 4 samples" in n for n in scene.notes), scene.notes
    assert any("The last 3 rows and 2 columns of the file" in n for n in scene.notes)


@pytest.mark.parametrize(
    "options",
    [
        {}, {"bigtiff": True, "byteorder": ">"}, {"rowsperstrip": 7, "compression": "deflate"},
        {"tile": (16, 32)}, {"tile": (32, 16), "compression": "deflate"},
        {"tile": (48, 48), "compression": "deflate", "predictor": True},
    ],
)  # fmt: skip
def test_each_layout_of_a_tiff_is_reduced_alike(tmp_path: Path, options: dict[str, Any]) -> None:
    pytest.importorskip("imagecodecs") if "predictor" in options else None
    assert_is_reduced(opened(geotiff(tmp_path / "a.tif", HEIGHTS, SCALE, TIE, (34735, METRES), **options)))


@pytest.mark.parametrize("planar", ["contig", "separate"])
@pytest.mark.parametrize("is_tiled", [False, True])
def test_bands_and_masks_of_a_large_tiff(tmp_path: Path, planar: str, is_tiled: bool) -> None:
    alpha = np.isfinite(HEIGHTS).astype(np.float32)
    bands = np.stack([np.nan_to_num(HEIGHTS, nan=5.0), alpha], axis=-1 if planar == "contig" else 0)
    options = {"tile": (16, 16)} if is_tiled else {"rowsperstrip": 5, "compression": "deflate"}
    path = geotiff(
        tmp_path / "a.tif", bands, SCALE, TIE, planarconfig=planar, extrasamples=["unassalpha"], **options
    )
    assert_is_reduced(opened(path))
    with tifffile.TiffWriter(tmp_path / "b.tif") as tiff:
        tags = [(33550, 12, 3, SCALE[1], True)]
        tiff.write(bands.take(0, -1 if planar == "contig" else 0), extratags=tags, metadata=None, **options)
        tiff.write(alpha > 0, subfiletype=4, photometric=4, metadata=None, rowsperstrip=11)
    assert_is_reduced(opened(tmp_path / "b.tif"))


def test_an_overview_that_is_fine_enough_is_read(tmp_path: Path) -> None:
    full = np.pad(HEIGHTS, ((0, 1), (0, 2)), mode="edge")
    half, quarter, eighth = (means(full, n).astype(np.float32) for n in (2, 4, 8))
    with tifffile.TiffWriter(tmp_path / "cog.tif") as tiff:
        tags = [(33550, 12, 3, SCALE[1], True)]
        tiff.write(full, extratags=tags, tile=(16, 16), metadata=None)
        for overview in (half, quarter, eighth):
            tiff.write(overview, subfiletype=1, tile=(16, 16), metadata=None)
    scene = opened(tmp_path / "cog.tif")
    np.testing.assert_allclose(scene._heights(0), quarter)
    assert any("is read as 33 x 43, 8 x 8 m apart: an overview in the file." in n for n in scene.notes)


def test_every_other_file_of_heights_is_reduced_alike(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", HEIGHTS)
    assert_is_reduced(opened(tmp_path / "a.npy", cell_size_m=2.0))
    assert_is_reduced(opened(tmp_path / "a.npy"), cell_m=4.0)  # one metre is assumed in the file
    np.savez_compressed(tmp_path / "a.npz", z=HEIGHTS, dx=2.0)
    assert_is_reduced(opened(tmp_path / "a.npz"))
    positions = {"x": 2.0 * np.arange(COLS), "y": -2.0 * np.arange(ROWS)}
    for z in (np.asfortranarray(HEIGHTS), HEIGHTS.T, np.asfortranarray(HEIGHTS.T)):
        np.savez(tmp_path / "b.npz", z=z, **positions)
        assert_is_reduced(opened(tmp_path / "b.npz"))
    head = f"ncols {COLS}\nnrows {ROWS}\nxllcorner 0\nyllcorner 0\ncellsize 2\nNODATA_value -1\n"
    values = np.nan_to_num(HEIGHTS, nan=-1.0).ravel()
    (tmp_path / "a.asc").write_text(head + "\n".join(f"{v:.0f}" for v in values))
    assert_is_reduced(opened(tmp_path / "a.asc"))


@pytest.mark.parametrize("version", ["NETCDF3_64BIT", "NETCDF4"])
def test_large_maps_of_netcdf_and_xarray(tmp_path: Path, version: Any) -> None:
    xarray = pytest.importorskip("xarray")
    coordinates = {"y": 2.0 * np.arange(ROWS), "x": 2.0 * np.arange(COLS)}
    array = xarray.DataArray(HEIGHTS[::-1], coordinates, ("y", "x"), "ground")
    scene = scene_of_xarray(array)
    np.testing.assert_allclose(scene._heights(0), means(HEIGHTS[::-1], 4)[::-1], rtol=1e-6)
    if version == "NETCDF4":
        pytest.importorskip("h5netcdf")
    engine: Any = "h5netcdf" if version == "NETCDF4" else "scipy"
    array.transpose("x", "y").to_netcdf(tmp_path / "a.nc", format=version, engine=engine)
    from_file = opened(tmp_path / "a.nc")
    np.testing.assert_allclose(from_file._heights(0), scene._heights(0))
    np.testing.assert_allclose(from_file.bounds_m(), scene.bounds_m())
    assert any("is read as 32 x 42, 8 x 8 m apart" in note for note in from_file.notes)


def test_frames_share_the_limit() -> None:
    xarray = pytest.importorskip("xarray")
    series = np.stack([np.nan_to_num(HEIGHTS, nan=300.0) + 10 * i for i in range(30)])
    scene = scene_of_xarray(xarray.DataArray(series, dims=("time", "y", "x")))
    factor = 9  # 30 maps of 131 x 170 in 10,000 samples
    assert scene.frame_count == 30
    np.testing.assert_allclose(scene._heights(29), means(series[29], factor), rtol=1e-6)
    with pytest.raises(SourceError, match="found 5000 maps of 2 x 3 samples; expected at most 10000 samples"):
        scene_of_xarray(xarray.DataArray(np.zeros((5000, 2, 3)), dims=("time", "y", "x")))


@pytest.mark.parametrize("is_marked", [False, True])
@pytest.mark.parametrize("value", [-9999.0, -3.4028235e38, 32767.0])
def test_gaps_are_left_out_before_the_means(tmp_path: Path, value: float, is_marked: bool) -> None:
    stored = np.where(np.isfinite(HEIGHTS), HEIGHTS, np.float32(value))
    nodata = ((42113, f"{value:.9g}"),) if is_marked else ()
    scene = opened(geotiff(tmp_path / "a.tif", stored, SCALE, TIE, *nodata))
    assert_is_reduced(scene)
    gaps = [note for note in scene.notes if "taken for a gap" in note]
    assert bool(gaps) != is_marked and all("in 800 of " in note for note in gaps)


def test_a_value_among_heights_is_no_gap(tmp_path: Path) -> None:
    deep = np.nan_to_num(HEIGHTS, nan=300.0) - 10300.0
    assert -9999 in deep
    np.save(tmp_path / "a.npy", deep)
    np.testing.assert_allclose(opened(tmp_path / "a.npy")._heights(0), means(deep, 4), rtol=1e-6)


def test_what_the_bytes_do_not_justify_is_refused(tmp_path: Path) -> None:
    bomb = geotiff(
        tmp_path / "bomb.tif", np.zeros((16, 16), np.float32), tile=(16, 16), compression="deflate"
    )
    data = bytearray(bomb.read_bytes())
    with tifffile.TiffFile(bomb) as tiff:
        for name in ("ImageWidth", "ImageLength"):
            tag = tiff.pages[0].tags[name]
            size = 2 if tag.dtype == 3 else 4
            data[tag.valueoffset : tag.valueoffset + size] = (60_000).to_bytes(size, "little")
    bomb.write_bytes(data)
    with pytest.raises(SourceError, match=r"bomb\.tif: found a map of 60000 x 60000 samples in \d+ bytes"):
        opened(bomb)
    strip = geotiff(tmp_path / "strip.tif", HEIGHTS, compression="deflate", rowsperstrip=ROWS)
    with pytest.raises(SourceError, match=r"in pieces of 131 x 170.*gdal_translate -co TILED=YES"):
        opened(strip)
    (tmp_path / "a.asc").write_text("ncols 500\nnrows 500\ncellsize 1\n" + "1 " * 70)
    with pytest.raises(SourceError, match=r"a\.asc: found a map of 500 x 500 samples in 171 bytes"):
        opened(tmp_path / "a.asc")


def test_a_large_png_names_the_conversion(tmp_path: Path) -> None:
    from PIL import Image

    Image.fromarray(np.nan_to_num(HEIGHTS).astype(np.uint16)).save(tmp_path / "a.png")
    with pytest.raises(
        SourceError, match=r"a PNG of 170 x 131 pixels.*gdal_translate .* a\.png heights\.tif"
    ):
        opened(tmp_path / "a.png")

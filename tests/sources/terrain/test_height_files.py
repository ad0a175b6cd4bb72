"""What a file states about its heights is used, or named as unused: GeoTIFF, arrays, text and netCDF."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from PIL import Image

from height_makers import METRES, NORTH_UP, SCALE, SIZE_M, TIE, data_array, gdal, geotiff, matrix
from touchfield.errors import MissingExtra, SourceError
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.terrain.height_map import degree_m
from touchfield.sources.terrain.height_scene import HeightScene


def opened(path: Path, **options: Any) -> HeightScene:
    scene = open_source(path, SourceOptions(**options))
    assert isinstance(scene, HeightScene)
    return scene


def assert_is_north_up(scene: HeightScene, *, heights: np.ndarray = NORTH_UP, atol: float = 1e-4) -> None:
    low, high = scene.bounds_m()
    np.testing.assert_allclose((high - low)[:2], SIZE_M, rtol=1e-6)
    np.testing.assert_allclose(scene._heights(0), heights, atol=atol)


# -- GeoTIFF: directions -----------------------------------------------------------------------------------
@pytest.mark.parametrize(
    ("transform", "stored"),
    [
        (matrix(10, 0, 5e5, 0, -10, 4.2e6), NORTH_UP),
        (matrix(10, 0, 5e5, 0, 10, 4.2e6), NORTH_UP[::-1]),
        (matrix(-10, 0, 5e5, 0, -10, 4.2e6), NORTH_UP[:, ::-1]),
        (matrix(0, 10, 5e5, 10, 0, 4.2e6), NORTH_UP[::-1].T),  # columns run north, rows east
        (matrix(0, 10, 5e5, -10, 0, 4.2e6), NORTH_UP.T),
        (matrix(0, -10, 5e5, -10, 0, 4.2e6), NORTH_UP[:, ::-1].T),
        ((33550, (10.0, -10.0, 0.0)), NORTH_UP[::-1]),
        ((33550, (10.0, 10.0, 0.0)), NORTH_UP),
    ],
)
def test_rows_and_columns_may_run_in_any_direction(
    tmp_path: Path, transform: Any, stored: np.ndarray
) -> None:
    path = geotiff(tmp_path / "a.tif", np.ascontiguousarray(stored), transform, TIE, (34735, METRES))
    scene = opened(path)
    assert_is_north_up(scene)
    assert ("ScaleY is below 0" in "".join(scene.notes)) == (
        transform[1][1] == -10.0 and len(transform[1]) == 3
    )


def test_a_map_with_unequal_cells_is_turned_by_a_quarter(tmp_path: Path) -> None:
    stored = np.ascontiguousarray(NORTH_UP[:, :8].T)
    path = geotiff(tmp_path / "a.tif", stored, matrix(0, 20, 5e5, -10, 0, 4.2e6))
    scene = opened(path)
    np.testing.assert_allclose((scene.bounds_m()[1] - scene.bounds_m()[0])[:2], [7 * 20, 150])
    np.testing.assert_array_equal(scene._heights(0), NORTH_UP[:, :8])


def test_a_small_turn_is_noted_and_shear_is_refused(tmp_path: Path) -> None:
    c, s = 10 * np.cos(np.radians(30)), 10 * np.sin(np.radians(30))
    scene = opened(geotiff(tmp_path / "a.tif", NORTH_UP, matrix(c, s, 5e5, s, -c, 4.2e6)))
    assert_is_north_up(scene)
    assert any("turned by 30 degrees" in note and "gdalwarp" in note for note in scene.notes)
    with pytest.raises(SourceError, match=r"a\.tif: found sheared cells.*gdalwarp"):
        opened(geotiff(tmp_path / "a.tif", NORTH_UP, matrix(10, 5, 5e5, 0, -10, 4.2e6)))


# -- GeoTIFF: samples --------------------------------------------------------------------------------------
@pytest.mark.parametrize(
    "options",
    [
        {}, {"bigtiff": True}, {"tile": (16, 16)}, {"rowsperstrip": 3}, {"byteorder": ">"},
        {"compression": "deflate"}, {"compression": "deflate", "predictor": True}, {"compression": "zstd"},
    ],
)  # fmt: skip
@pytest.mark.parametrize("kind", [np.float32, np.float64, np.uint16, np.int32])
def test_each_layout_of_a_tiff(tmp_path: Path, kind: type, options: dict[str, Any]) -> None:
    pytest.importorskip("imagecodecs") if "predictor" in options or "zstd" in options.values() else None
    path = geotiff(tmp_path / "a.tif", NORTH_UP.astype(kind), SCALE, TIE, (34735, METRES), **options)
    assert_is_north_up(opened(path), heights=NORTH_UP.astype(kind).astype(float))


def test_whole_numbers_with_a_matrix_are_no_picture(tmp_path: Path) -> None:
    path = geotiff(tmp_path / "a.tif", NORTH_UP.astype(np.uint16), matrix(10, 0, 5e5, 0, -10, 4.2e6))
    low, high = opened(path).bounds_m()
    assert (low[2], high[2]) == (100, 115)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_the_first_of_several_bands_is_read_and_noted(tmp_path: Path, planar: str) -> None:
    bands = np.stack([NORTH_UP, 0 * NORTH_UP, 0 * NORTH_UP], axis=-1 if planar == "contig" else 0)
    path = geotiff(tmp_path / "a.tif", bands, SCALE, TIE, planarconfig=planar)
    scene = opened(path)
    assert_is_north_up(scene)
    assert "The file has 3 bands of numbers: the first is read." in scene.notes


def test_an_alpha_band_and_a_mask_are_gaps(tmp_path: Path) -> None:
    alpha = np.where(NORTH_UP > 110, 1.0, 0.0).astype(np.float32)
    expected = np.where(alpha > 0, NORTH_UP, np.nan)
    path = geotiff(
        tmp_path / "a.tif", np.stack([NORTH_UP, alpha], axis=-1), SCALE, TIE, extrasamples=["unassalpha"],
    )  # fmt: skip
    assert_is_north_up(opened(path), heights=expected)
    with tifffile.TiffWriter(tmp_path / "b.tif") as tiff:
        tags = [(33550, 12, 3, SCALE[1], True)]
        tiff.write(NORTH_UP, extratags=tags, metadata=None)
        tiff.write(alpha > 0, subfiletype=4, photometric=4, metadata=None)
    scene = opened(tmp_path / "b.tif")
    assert_is_north_up(scene, heights=expected)
    assert not any("several pages" in note for note in scene.notes)


def test_overviews_are_no_further_pages(tmp_path: Path) -> None:
    with tifffile.TiffWriter(tmp_path / "cog.tif") as tiff:
        tags = [(33550, 12, 3, SCALE[1], True)]
        tiff.write(NORTH_UP, extratags=tags, tile=(16, 16), metadata=None)
        tiff.write(NORTH_UP[::2, ::2], subfiletype=1, metadata=None)
    scene = opened(tmp_path / "cog.tif")
    assert_is_north_up(scene)
    assert not scene.notes


def test_a_compressed_tiff_without_codecs(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Pillow decodes what it can; for the rest the error names the extra."""
    pytest.importorskip("imagecodecs")
    lzw = geotiff(tmp_path / "lzw.tif", NORTH_UP, SCALE, compression="lzw", predictor=True)
    other = geotiff(tmp_path / "lerc.tif", NORTH_UP, SCALE, compression="lerc")

    def fail(page: Any, *_: Any, **__: Any) -> None:
        raise ValueError(f"{page.compression!r} requires the 'imagecodecs' package")

    monkeypatch.setattr(tifffile.TiffPage, "asarray", fail)
    assert_is_north_up(opened(lzw))
    with pytest.raises(
        SourceError, match=r'lerc\.tif: found a TIFF compressed by LERC.*"touchfield\[geotiff\]"'
    ):
        opened(other)


def test_without_tifffile_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = geotiff(tmp_path / "a.tif", NORTH_UP, SCALE)
    monkeypatch.setitem(__import__("sys").modules, "tifffile", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[sources\]"):
        opened(path)


def test_a_colour_tiff_is_no_height_map(tmp_path: Path) -> None:
    path = tmp_path / "a.tif"
    Image.fromarray(np.zeros((8, 8, 3), np.uint8)).save(path)
    with pytest.raises(SourceError, match=r"a picture in RGB colours"):
        opened(path, kind="height-map")


# -- GeoTIFF: heights --------------------------------------------------------------------------------------
def test_scale_offset_and_unit_of_gdal_are_used(tmp_path: Path) -> None:
    stored = np.round((NORTH_UP - 100) / 0.1).astype(np.uint16)
    scale = '<Item name="SCALE" sample="0" role="scale">0.1</Item>'
    offset = '<Item name="OFFSET" sample="0" role="offset">100</Item>'
    other = '<Item name="SCALE" sample="1" role="scale">7</Item>'
    scene = opened(geotiff(tmp_path / "a.tif", stored, SCALE, TIE, gdal(scale, offset, other)))
    assert_is_north_up(scene, atol=0.051)
    assert any("times 0.1 plus 100" in note for note in scene.notes)
    unit = '<Item name="UNITTYPE" sample="0" role="unittype">US survey foot</Item>'
    feet = opened(geotiff(tmp_path / "b.tif", NORTH_UP, SCALE, TIE, gdal(unit)))
    np.testing.assert_allclose(feet._heights(0), NORTH_UP.astype(float) * 1200 / 3937)
    odd = opened(
        geotiff(tmp_path / "c.tif", NORTH_UP, SCALE, TIE, gdal(unit.replace("US survey foot", "ell")))
    )
    assert any("'ell' of heights is unknown" in note for note in odd.notes)


def test_gaps_come_before_scale_and_offset(tmp_path: Path) -> None:
    stored = np.round((NORTH_UP - 100) / 0.1).astype(np.int16)
    stored[2, 3] = -32768
    item = '<Item name="SCALE" sample="0" role="scale">0.1</Item>'
    for nodata in ((), ((42113, "-32768"),)):
        scene = opened(geotiff(tmp_path / "a.tif", stored, SCALE, TIE, gdal(item), *nodata))
        assert np.isnan(scene._heights(0)[2, 3])
        assert np.isfinite(scene._heights(0)).sum() == stored.size - 1
        assert any("taken for a gap" in note for note in scene.notes) == (not nodata)


@pytest.mark.parametrize("value", [-3.4028235e38, 1e20, -9999, 9999, -32767, 32767, -32768, 32768, np.nan])
@pytest.mark.parametrize("suffix", [".tif", ".npy", ".npz"])
def test_usual_stand_ins_for_gaps_are_left_out(tmp_path: Path, value: float, suffix: str) -> None:
    values = NORTH_UP.copy()
    values[4:6, 4:6] = value
    path = tmp_path / f"a{suffix}"
    if suffix == ".tif":
        geotiff(path, values, SCALE, TIE)
    elif suffix == ".npy":
        np.save(path, values)
    else:
        np.savez(path, z=values, dx=10.0)
    scene = opened(path)
    assert np.isnan(scene._heights(0)).sum() == 4
    assert scene.bounds_m()[0][2] == pytest.approx(100)
    assert any("in 4 of 256 samples is taken for a gap" in note for note in scene.notes) == np.isfinite(value)


def test_heights_near_a_stand_in_keep_it(tmp_path: Path) -> None:
    np.save(tmp_path / "deep.npy", np.linspace(-10900, -9000, 1902).reshape(2, -1)[:, :950].round())
    values = np.load(tmp_path / "deep.npy")
    assert -9999 in values
    scene = opened(tmp_path / "deep.npy")
    assert np.isfinite(scene._heights(0)).all()


def test_units_of_geokeys(tmp_path: Path) -> None:
    own = (1, 1, 0, 3, 1024, 0, 1, 1, 3076, 0, 1, 32767, 3077, 34736, 1, 0)
    path = geotiff(tmp_path / "a.tif", NORTH_UP, SCALE, TIE, (34735, own), (34736, (0.5,)))
    scene = opened(path)
    np.testing.assert_allclose((scene.bounds_m()[1] - scene.bounds_m()[0])[:2], SIZE_M / 2)
    assert any("that of heights is not given" in note for note in scene.notes)
    odd = (1, 1, 0, 2, 3076, 0, 1, 9999, 4099, 0, 1, 9998)
    notes = opened(geotiff(tmp_path / "b.tif", NORTH_UP, SCALE, TIE, (34735, odd))).notes
    assert any("positions, EPSG 9999" in n for n in notes) and any("heights, EPSG 9998" in n for n in notes)


def test_a_z_scale_is_used_with_a_vertical_reference_and_named_without(tmp_path: Path) -> None:
    tags = ((33550, (10.0, 10.0, 0.5)), (33922, (0.0, 0.0, 0.0, 0.0, 0.0, 7.0)))
    keys = (34735, (1, 1, 0, 2, 1024, 0, 1, 1, 4096, 0, 1, 5773))
    scene = opened(geotiff(tmp_path / "a.tif", NORTH_UP, *tags, keys))
    np.testing.assert_allclose(scene._heights(0), NORTH_UP.astype(float) / 2 + 7)
    scene = opened(geotiff(tmp_path / "b.tif", NORTH_UP, *tags, (34735, METRES)))
    assert_is_north_up(scene)
    assert any("ScaleZ 0.5 is not used" in note for note in scene.notes)


def test_what_is_not_used_is_named(tmp_path: Path) -> None:
    ties = (33922, (0.0, 0.0, 0.0, 5e5, 4.2e6, 0.0, 15.0, 15.0, 0.0, 5.1e5, 4.1e6, 0.0))
    path = geotiff(tmp_path / "a.tif", NORTH_UP, ties)
    assert any("2 tie points are not used; gdalwarp" in note for note in opened(path).notes)
    beside = "<PAMDataset><PAMRasterBand><Offset>3</Offset><Scale>2</Scale></PAMRasterBand></PAMDataset>"
    path = geotiff(tmp_path / "b.tif", NORTH_UP, SCALE)
    path.with_name("b.tif.aux.xml").write_text(beside)
    assert any("b.tif.aux.xml is not used (Offset, Scale)" in note for note in opened(path).notes)


@pytest.mark.parametrize(
    ("picture", "world"), [("a.tif", "a.tfw"), ("a.tiff", "a.tfw"), ("b.tif", "b.tifw"), ("a.png", "a.pgw")]
)
def test_a_world_file_beside_a_picture_is_used(tmp_path: Path, picture: str, world: str) -> None:
    stored = NORTH_UP[::-1].astype(np.uint16)
    Image.fromarray(stored).save(tmp_path / picture)
    (tmp_path / world).write_text("10\n0\n0\n10\n500005\n4200005\n")
    scene = opened(tmp_path / picture, height_scale=1.0)
    assert_is_north_up(scene, heights=stored[::-1].astype(float))


# -- .npz --------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("dy", "is_south_first"), [(10.0, True), (-10.0, False), (None, False)])
def test_the_sign_of_dy_gives_the_direction_of_rows(
    tmp_path: Path, dy: float | None, is_south_first: bool
) -> None:
    path = tmp_path / "a.npz"
    steps = {"dx": 10.0} if dy is None else {"dx": 10.0, "dy": dy}
    np.savez(path, elevation=NORTH_UP[::-1] if is_south_first else NORTH_UP, **steps)
    assert_is_north_up(opened(path))
    np.savez(
        path, elevation=(NORTH_UP[::-1] if is_south_first else NORTH_UP)[:, ::-1], **{**steps, "dx": -10.0}
    )
    if dy is not None:
        assert_is_north_up(opened(path))


def test_edges_with_north_first_overrule_the_sign_of_dy(tmp_path: Path) -> None:
    edges = {"xmin": 0.0, "xmax": 160.0, "ymin": 160.0, "ymax": 0.0}  # as in matplotlib's sample
    np.savez(tmp_path / "a.npz", elevation=NORTH_UP, dx=10.0, dy=10.0, **edges)
    assert_is_north_up(opened(tmp_path / "a.npz"))


@pytest.mark.parametrize("names", [("x", "y"), ("lon", "lat"), ("easting", "northing")])
@pytest.mark.parametrize("is_grid", [False, True])
def test_arrays_of_positions_are_used(tmp_path: Path, names: tuple[str, str], is_grid: bool) -> None:
    x, y = 30.0 * np.arange(50), 40.0 * np.arange(40)
    heights = np.add.outer(y, x)
    lines = np.meshgrid(x, y) if is_grid else (x, y)
    np.savez(tmp_path / "a.npz", heights=heights, **dict(zip(names, lines, strict=True)))
    scene = opened(tmp_path / "a.npz")
    np.testing.assert_allclose((scene.bounds_m()[1] - scene.bounds_m()[0])[:2], [49 * 30, 39 * 40])
    np.testing.assert_array_equal(scene._heights(0), heights[::-1])  # y rises: row 0 is south
    assert not scene.notes


def test_heights_in_the_order_x_y_are_transposed(tmp_path: Path) -> None:
    heights = np.arange(12.0).reshape(3, 4)
    np.savez(tmp_path / "a.npz", z=heights.T, x=np.arange(4.0), y=-2 * np.arange(3.0))
    scene = opened(tmp_path / "a.npz")
    np.testing.assert_array_equal(scene._heights(0), heights)
    np.testing.assert_allclose(scene.bounds_m()[1][:2], [3, 4])


def test_an_affine_gaps_and_unused_arrays_of_an_npz(tmp_path: Path) -> None:
    values = NORTH_UP[::-1].copy()
    values[0, 0] = 77.0
    np.savez(tmp_path / "a.npz", dem=values, transform=[10.0, 0, 5e5, 0, 10, 4.2e6], nodata=77.0, spacing=3.0)
    scene = opened(tmp_path / "a.npz")
    assert np.isnan(scene._heights(0)[15, 0])
    np.testing.assert_allclose((scene.bounds_m()[1] - scene.bounds_m()[0])[:2], SIZE_M)
    assert scene.notes == ("Arrays of the file that are not used: spacing.",)


@pytest.mark.parametrize("x", [np.arange(3.0) ** 2, np.zeros(3), np.array([0, 1, np.nan]), np.arange(7.0)])
def test_positions_that_do_not_fit_are_refused(tmp_path: Path, x: np.ndarray) -> None:
    np.savez(tmp_path / "a.npz", z=np.eye(3), x=x, y=np.arange(3.0))
    with pytest.raises(SourceError, match=r"a\.npz, (array )?x: found"):
        opened(tmp_path / "a.npz")


# -- text, tiles, netCDF -----------------------------------------------------------------------------------
def test_an_ascii_grid(tmp_path: Path) -> None:
    head = "ncols 3\nnrows 2\nxllcorner 500000\nyllcorner 4200000\ncellsize 30\nNODATA_value -1\n"
    path = tmp_path / "a.asc"
    path.write_text(head + "1 2 3\n4 -1 6\n")
    scene = opened(path)
    np.testing.assert_array_equal(scene._heights(0), [[1, 2, 3], [4, np.nan, 6]])
    np.testing.assert_allclose(scene.bounds_m()[1], [60, 30, 6])
    path.write_text(head.replace("cellsize 30", "dx 30\ndy 10") + "1 2 3 4 5 6")
    np.testing.assert_allclose(opened(path).bounds_m()[1], [60, 10, 6])
    degrees = "ncols 3\nnrows 2\nxllcenter 8\nyllcenter 45\ncellsize 0.01\n1 2 3 4 5 6"
    path.write_text(degrees)
    along, across = degree_m(45.005)
    np.testing.assert_allclose(opened(path).bounds_m()[1][:2], [0.02 * across, 0.01 * along], rtol=1e-6)


@pytest.mark.parametrize(
    "text",
    [
        "ncols 3\nnrows 2\n1 2 3 4 5 6",
        "ncols 3\nnrows 2\ncellsize 1\n1 2 3",
        "ncols 3\nnrows x\n",
        "ncols 1e9\n",
        "ncols 2\nnrows 2\ncellsize 1\n1 2 3 4,5",
    ],
)
def test_a_broken_ascii_grid_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.asc").write_text(text)
    with pytest.raises(SourceError, match=r"a\.asc"):
        opened(tmp_path / "a.asc")


def test_a_tile_of_srtm(tmp_path: Path) -> None:
    heights = np.add.outer(1200 - np.arange(1201), np.zeros(1201, int)).astype(">i2")
    heights[5, 7] = -32768
    heights.tofile(tmp_path / "S13W072.hgt")
    scene = opened(tmp_path / "S13W072.hgt")
    along, across = degree_m(-12.5)
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [across, along, 1200]], rtol=1e-5)
    assert np.isnan(scene._heights(0)[5, 7]) and scene._heights(0)[0, 0] == 1200
    (tmp_path / "N00E000.hgt").write_bytes(b"\0" * 100)
    with pytest.raises(SourceError, match="found 100 bytes; expected 1201 x 1201"):
        opened(tmp_path / "N00E000.hgt")


@pytest.mark.parametrize("version", ["NETCDF3_64BIT", "NETCDF4"])
def test_heights_of_netcdf(tmp_path: Path, version: Any) -> None:
    pytest.importorskip("xarray")
    array = data_array(units="cm")
    array.values[3, 3] = np.nan
    if version == "NETCDF4":
        pytest.importorskip("h5netcdf")
    packed = {"ground": {"dtype": "int16", "scale_factor": 0.01, "add_offset": 100.0, "_FillValue": -7}}
    array.x.attrs["units"] = array.y.attrs["units"] = "km"
    engine: Any = "h5netcdf" if version == "NETCDF4" else "scipy"
    array.to_netcdf(tmp_path / "a.nc", format=version, encoding=packed, engine=engine)
    scene = opened(tmp_path / "a.nc")
    expected = NORTH_UP.astype(float) / 100
    expected[12, 3] = np.nan
    np.testing.assert_allclose(scene._heights(0), expected, atol=1e-4)
    np.testing.assert_allclose(scene.bounds_m()[1][:2], 1000 * SIZE_M)


def test_netcdf_of_degrees_time_and_depths(tmp_path: Path) -> None:
    xarray = pytest.importorskip("xarray")
    coordinates = {"time": [0, 1], "band": [1], "lat": [50.0, 50.01], "lon": [8.0, 8.01, 8.02]}
    values = np.arange(12, dtype=np.float32).reshape(2, 1, 2, 3)
    array = xarray.DataArray(
        values, coordinates, ("time", "band", "lat", "lon"), "bottom", {"positive": "down"}
    )
    array.lat.attrs["units"], array.lon.attrs["units"] = "degrees_north", "degrees_east"
    array.to_netcdf(tmp_path / "a.nc", engine="scipy")
    scene = opened(tmp_path / "a.nc")
    along, across = degree_m(50.005)
    np.testing.assert_allclose((scene.bounds_m()[1] - scene.bounds_m()[0])[:2], [0.02 * across, 0.01 * along])
    assert scene.frame_count == 2
    np.testing.assert_array_equal(scene._heights(1), -values[1, 0, ::-1])
    assert any("positive down" in note for note in scene.notes)


def test_a_damaged_netcdf_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("xarray")
    data_array().to_netcdf(tmp_path / "a.nc", engine="scipy")
    raw = (tmp_path / "a.nc").read_bytes()
    for size in range(4, len(raw) - 200, 97):
        (tmp_path / "b.nc").write_bytes(raw[:size])
        with pytest.raises(SourceError, match=r"b\.nc"):
            opened(tmp_path / "b.nc")


def test_netcdf_4_without_its_library_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(__import__("sys").modules, "h5netcdf", None)
    (tmp_path / "a.nc").write_bytes(b"\x89HDF\r\n\x1a\n")
    with pytest.raises(MissingExtra, match=r"touchfield\[netcdf\]"):
        opened(tmp_path / "a.nc")


def test_an_xarray_of_heights_is_a_source() -> None:
    pytest.importorskip("xarray")
    from touchfield.pipeline.source import scene_of
    from touchfield.pipeline.spec import EncodeSpec

    array = data_array(units="m")
    for source in (array, array.transpose("x", "y"), array.isel(y=slice(None, None, -1))):
        scene = scene_of(source, EncodeSpec())
        assert isinstance(scene, HeightScene)
        assert_is_north_up(scene)
    with pytest.raises(SourceError, match="dimensions a, x"):
        scene_of(array.rename(y="a"), EncodeSpec())

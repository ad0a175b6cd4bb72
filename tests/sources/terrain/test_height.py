"""Height maps: exact on planes, solid below, empty where unknown; files and their faults."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
import tifffile
from hypothesis import given, settings, strategies as st
from PIL import Image

from touchfield.errors import InvalidArgument, SourceError
from touchfield.medium import ForceField, Grid
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.options import SourceOptions
from touchfield.sources.registry import open_source
from touchfield.sources.scene import CAMERA_AXES, UP_Z_AXES
from touchfield.sources.terrain.height_files import KIND, jacksboro_scene
from touchfield.sources.terrain.height_map import degree_m
from touchfield.sources.terrain.height_scene import HeightLattice, HeightScene

SOLID = profile_of(LawSpec(), np.inf)
GUIDED = profile_of(LawSpec("penalty+proximity"), 0.008)


def mesh_m(grid: Grid) -> np.ndarray:
    return grid.to_m(np.stack(np.meshgrid(*map(np.arange, grid.shape), indexing="ij"), axis=-1))


slopes = st.floats(-3, 3)


@given(slopes, slopes, st.floats(-0.01, 0.01), st.sampled_from([1, -1]), st.sampled_from([SOLID, GUIDED]))
def test_a_plane_is_exact(a: float, b: float, c: float, facing: int, profile: object) -> None:
    lattice = HeightLattice(-0.05, 0.005, 0.05, -0.004, facing)
    x, y = -0.05 + 0.005 * np.arange(21), 0.05 - 0.004 * np.arange(26)
    scene = HeightScene(a * x + b * y[:, None] + c, lattice)
    grid = Grid.over_box([-0.049, -0.049, -0.03], [0.049, 0.049, 0.03], (13, 9, 18))
    dense = scene.field(0, grid, profile).to_dense()  # type: ignore[arg-type]
    at = mesh_m(grid)
    normal = facing * np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    phi = (at - [0, 0, c]) @ normal
    expected = profile(phi)[..., None] * normal  # type: ignore[operator]
    is_at_jump = np.min([np.abs(phi - e) for e in (0.0, -0.008, 0.004, -0.0066)], axis=0) < 1e-7
    np.testing.assert_allclose(dense[~is_at_jump], expected[~is_at_jump], atol=2e-4, rtol=1e-5)


@given(st.integers(0, 2**31), st.sampled_from([SOLID, GUIDED]), st.floats(0, 0.4))
def test_field_against_the_same_formula_in_numpy(seed: int, profile: object, holes: float) -> None:
    """Exactly the bricks with a force are stored; forces are f(phi) n of the interpolated surface."""
    rng = np.random.default_rng(seed)
    heights = 0.01 * rng.normal(size=(7, 6)) / 2
    heights[rng.random(heights.shape) < holes] = np.nan
    scene = HeightScene(heights, (0.01, 0.012))
    grid = Grid.over_box([-0.01, -0.02, -0.03], [0.07, 0.08, 0.03], (19, 21, 26))
    field = scene.field(0, grid, profile)  # type: ignore[arg-type]
    h, gradient = scene._surface(0)
    at = mesh_m(grid)
    u, v = at[..., 0] / 0.012, 6 - at[..., 1] / 0.01
    is_known = (u >= 0) & (u <= 5) & (v >= 0) & (v <= 6)
    c, r = np.clip(u.astype(int), 0, 4), np.clip(v.astype(int), 0, 5)
    fu, fv = u - c, v - r
    surface = np.zeros((*grid.shape, 3))
    for p in (0, 1):
        for q in (0, 1):
            weight = np.where(p, fv, 1 - fv) * np.where(q, fu, 1 - fu)
            corner = np.concatenate([h[..., None], gradient], axis=-1)[r + p, c + q]
            surface += weight[..., None] * corner
    is_known &= np.isfinite(surface[..., 0])
    surface[~is_known] = 0
    nz = 1 / np.sqrt(1 + surface[..., 1] ** 2 + surface[..., 2] ** 2)
    phi = (at[..., 2] - surface[..., 0]) * nz
    normal = np.stack([-surface[..., 1] * nz, -surface[..., 2] * nz, nz], axis=-1)
    expected = np.where(is_known, profile(phi), 0)[..., None] * normal  # type: ignore[operator]
    dense = field.to_dense()
    edge = np.min([np.abs(phi - e) for e in (0.0, -0.008, 0.004)], axis=0) < 1e-9
    np.testing.assert_allclose(dense[~edge], expected[~edge], atol=1e-6)
    assert ForceField.from_dense(grid, dense) == field


def test_terrain_is_solid_down_to_the_bottom_of_the_grid() -> None:
    scene = HeightScene(np.zeros((5, 5)), (0.01, 0.01))
    grid = Grid.over_box([0, 0, -1.0], [0.04, 0.04, 0.2], (8, 8, 60))
    dense = scene.field(0, grid, SOLID).to_dense()
    below = grid.axis_m(2) < 0
    assert (dense[:, :, below, 2] > 0).all()
    assert not dense[:, :, ~below].any()
    np.testing.assert_allclose(dense[:, :, grid.axis_m(2) < -0.1, 2], 3.3, rtol=1e-6)
    assert scene.is_solid


def test_row_zero_is_north_and_exaggeration_scales_heights() -> None:
    heights = np.zeros((4, 6))
    heights[0] = 2.0
    scene = HeightScene(heights, (10.0, 5.0), exaggeration=3.0)
    assert scene.axes == UP_Z_AXES
    np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [25, 30, 6]])
    field = scene.field(0, Grid((26, 31, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 1.0)), SOLID)
    assert field.positions()[:, 1].min() > 20  # only the north has ground at z = 1 m


def test_no_force_beyond_the_rim_and_no_bridge_over_a_hole() -> None:
    heights = np.zeros((9, 9))
    heights[4, 4] = np.nan
    scene = HeightScene(heights, (1.0, 1.0))
    grid = Grid((24, 24, 1), (0.5, 0.5, 1.0), (-1.75, -1.75, -1.0))
    is_supported = scene.field(0, grid, SOLID).to_dense()[..., 0, 2] > 0
    x, y = grid.axis_m(0)[:, None], grid.axis_m(1)[None, :]
    inside = (x >= 0) & (x <= 8) & (y >= 0) & (y <= 8)
    hole = (np.abs(x - 4) < 1) & (np.abs(y - 4) < 1)
    np.testing.assert_array_equal(is_supported, inside & ~hole)


def test_noise_hardly_turns_the_normal_and_a_step_does_not() -> None:
    rng = np.random.default_rng(0)
    noisy = HeightScene(0.001 * rng.normal(size=(60, 60)), (0.01, 0.01))
    single = np.std(np.diff(noisy._heights(0), axis=1) / 0.01)
    smooth = np.std(noisy._surface(0)[1][..., 0])
    assert smooth < single / 4
    cliff = np.where(np.arange(20) < 10, 0.0, 0.5) * np.ones((20, 1)) + 0.1 * 0.01 * np.arange(20)
    gated = HeightScene(cliff, HeightLattice(0.0, 0.01, 0.0, 0.01, step_m=0.1))
    np.testing.assert_allclose(gated._surface(0)[1][..., 0], 0.1, atol=1e-6)
    grid = Grid((190, 4, 1), (0.001, 0.01, 0.1), (0.0, 0.05, 0.25))
    is_supported = gated.field(0, grid, SOLID).to_dense()[:, 0, 0, 2] > 0
    np.testing.assert_array_equal(is_supported, np.arange(190) > 95)  # the wall is midway between the samples


@pytest.mark.parametrize("axis", ["columns", "rows"])
@pytest.mark.parametrize("facing", [1, -1])
@pytest.mark.parametrize(("dx_m", "dy_m"), [(0.01, 0.004), (0.004, -0.01), (0.006, -0.006)])
def test_next_to_a_step_the_nearest_plane_is_extrapolated(
    dx_m: float, dy_m: float, facing: int, axis: str
) -> None:
    """A plane on each side of a cliff, with unequal spacings of columns and rows in either direction."""
    a, b, cliff_m = 0.3, -0.2, 0.5
    lattice = HeightLattice(-9.5 * dx_m, dx_m, -9.5 * dy_m, dy_m, facing, step_m=0.1)
    x, y = (step_m * (np.arange(20) - 9.5) for step_m in (dx_m, dy_m))
    across = np.arange(20) >= 10
    raised = across if axis == "columns" else across[:, None]
    scene = HeightScene(a * x + b * y[:, None] + cliff_m * raised, lattice)
    normal = facing * np.array([-a, -b, 1.0]) / np.sqrt(1 + a * a + b * b)
    checked = 0
    for level_m in (0.0, cliff_m):
        low = [-2.0 * abs(dx_m), -2.0 * abs(dy_m), level_m - 0.004]
        grid = Grid.over_box(low, [-low[0], -low[1], level_m + 0.004], (24, 28, 18))
        dense, at = scene.field(0, grid, SOLID).to_dense(), mesh_m(grid)
        # in cells of the lattice from the centre of the cliff
        beyond = at[..., 0] / dx_m if axis == "columns" else at[..., 1] / dy_m
        height_m = a * at[..., 0] + b * at[..., 1] + cliff_m * (beyond > 0)
        phi = (at[..., 2] - height_m) * normal[2]
        is_clear = (np.abs(beyond) > 1e-6) & (np.min([np.abs(phi - e) for e in (0.0, 0.004)], axis=0) > 1e-6)
        expected = SOLID(phi)[..., None] * normal
        np.testing.assert_allclose(dense[is_clear], expected[is_clear], atol=2e-4, rtol=1e-5)
        checked += int((is_clear & (np.abs(beyond) < 0.5) & (np.abs(phi) < 0.004)).sum())
    assert checked > 500


def test_frames_over_time_lazy_or_not() -> None:
    stack = np.stack([np.full((3, 3), h) for h in (0.0, 1.0, 2.0)])
    requested = []

    def heights(frame: int) -> np.ndarray:
        requested.append(frame)
        return stack[frame]

    lazy = HeightScene(heights, (1.0, 1.0), frame_count=3, rate_hz=5.0)
    assert not requested
    grid = Grid((3, 3, 4), (1.0, 1.0, 1.0), (0.0, 0.0, -0.5))
    for scene in (lazy, HeightScene(stack, (1.0, 1.0)), HeightScene(list(stack), (1.0, 1.0))):
        assert scene.frame_count == 3
        assert [scene.field(i, grid, SOLID).support_count for i in range(3)] == [9, 18, 27]
        np.testing.assert_allclose(scene.bounds_m(), [[0, 0, 0], [2, 2, 2]])


@pytest.mark.parametrize(
    ("heights", "options"),
    [
        (np.zeros(4), {}),
        (np.zeros((1, 4)), {}),
        (np.zeros((0, 4, 4)), {}),
        ([np.zeros((3, 3)), np.zeros((3, 4))], {}),
        (np.zeros((3, 3)), {"exaggeration": 0.0}),
        (np.zeros((3, 3)), {"rate_hz": np.inf}),
    ],
)
def test_impossible_maps_are_refused(heights: object, options: dict[str, float]) -> None:
    with pytest.raises(InvalidArgument):
        HeightScene(heights, (1.0, 1.0), **options)  # type: ignore[arg-type]


class Stairs(DepthSequence):
    """A plane at z = 2 m with a nearer strip, one pixel unknown; the first frame is blank."""

    name, frame_count, width, height, rate_hz, notes = "stairs", 3, 40, 30, 25.0, ("a note",)
    intrinsics = Intrinsics(50.0, 40.0, 19.5, 14.5)

    def depth_m(self, frame: int) -> np.ndarray:
        depth = np.full((self.height, self.width), 2.0, np.float32)
        depth[:, 30:] = 1.5
        depth[5, 5] = 0
        return depth if frame else np.zeros_like(depth)


def test_a_depth_map_read_as_heights() -> None:
    scene = HeightScene.from_depth_sequence(Stairs())
    assert (scene.axes, scene.frame_count, scene.rate_hz) == (CAMERA_AXES, 3, 25.0)
    assert scene.notes[0] == "a note"
    low, high = scene.bounds_m()
    np.testing.assert_allclose(low, [-19.5 / 50 * 2, -14.5 / 40 * 2, 1.5])
    np.testing.assert_allclose(high, [19.5 / 50 * 2, 14.5 / 40 * 2, 2.0])
    grid = Grid.over_box(low, [*high[:2], 3.0], (32, 24, 40))
    assert scene.field(0, grid, SOLID).support_count == 0
    forces = scene.field(1, grid, SOLID).to_dense()
    at = mesh_m(grid)
    is_supported = forces.any(axis=-1)
    assert (forces[is_supported][:, 2] < 0).all()  # towards the viewer
    strip = at[..., 0] > 11.0 / 50 * 2
    np.testing.assert_array_equal(is_supported[strip], (at[..., 2] > 1.5)[strip])
    assert not is_supported[~strip & (at[..., 2] < 1.5)].any()


def test_an_exaggerated_slope_of_depth_stays_a_slope() -> None:
    class Slope(Stairs):
        def depth_m(self, frame: int) -> np.ndarray:
            return np.tile(np.linspace(1, 2, self.width, dtype=np.float32), (self.height, 1))

    scene = HeightScene.from_depth_sequence(Slope(), 4.0)  # steps of 7 % of the middle depth
    low, high = scene.bounds_m()
    forces = scene.field(1, Grid.over_box(low, high, (16, 16, 16)), SOLID).vectors_n()
    assert (np.abs(forces[:, 0]) > np.abs(forces[:, 2])).mean() > 0.9


def test_a_lattice_with_invalid_steps_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="step_m"):
        HeightLattice(0.0, 1.0, 0.0, 1.0, step_m=0.0)


def test_a_sequence_without_depth_is_refused() -> None:
    class Blank(Stairs):
        def depth_m(self, frame: int) -> np.ndarray:
            return np.zeros((self.height, self.width), np.float32)

    with pytest.raises(SourceError, match="stairs"):
        HeightScene.from_depth_sequence(Blank())


# -- files -------------------------------------------------------------------------------------------------


def opened(path: Path, **options: float) -> HeightScene:
    assert KIND.recognise(path), path.name
    scene = KIND.open(path, SourceOptions(**options))  # type: ignore[arg-type]
    assert isinstance(scene, HeightScene)
    return scene


def test_jacksboro() -> None:
    pytest.importorskip("matplotlib")
    scene = jacksboro_scene(2.0)
    low, high = scene.bounds_m()
    # 403 columns of 0.00083333 degrees at latitude 36.59, 344 rows
    assert high[0] - low[0] == pytest.approx(402 * 74.57, rel=1e-3)
    assert high[1] - low[1] == pytest.approx(343 * 92.47, rel=1e-3)
    assert (low[2], high[2]) == (472.0, 2152.0)
    assert any("36.59" in note for note in scene.notes)


def test_metres_of_a_degree() -> None:
    assert degree_m(0) == pytest.approx((110574.3, 111319.5), rel=1e-6)
    assert degree_m(45) == pytest.approx((111131.8, 78846.8), rel=1e-6)
    assert degree_m(-45) == degree_m(45)


MAP = np.arange(12, dtype=np.int16).reshape(3, 4)


def test_npz_of_metres_and_of_degrees(tmp_path: Path) -> None:
    path = tmp_path / "ground.npz"
    np.savez(path, z=MAP, other=np.zeros((2, 2)), dx=2.0, dy=-3.0)
    np.testing.assert_allclose(opened(path).bounds_m(), [[0, 0, 0], [6, 6, 11]])
    np.testing.assert_allclose(
        opened(path, cell_size_m=10, height_scale=0.1).bounds_m(), [[0, 0, 0], [30, 20, 1.1]]
    )
    extent = {"xmin": 10.0, "xmax": 10.2, "ymin": 60.1, "ymax": 59.9}
    np.savez(path, a=MAP, dx=0.05, **extent)
    along, across = degree_m(60)
    np.testing.assert_allclose(opened(path).bounds_m()[1], [0.15 * across, 0.1 * along, 11], rtol=1e-12)
    for step in (5.0, 0.5):  # local coordinates in metres, not degrees
        np.savez(path, a=MAP, dx=step, **extent)
        np.testing.assert_allclose(opened(path).bounds_m()[1], [3 * step, 2 * step, 11])


def test_npy_in_either_order_and_over_time(tmp_path: Path) -> None:
    path = tmp_path / "ground.npy"
    for stored in (MAP, np.asfortranarray(MAP.astype(np.float32)), MAP.astype(">f8")):
        np.save(path, stored)
        scene = opened(path)
        np.testing.assert_array_equal(scene._heights(0), MAP)
        assert any("one metre is assumed (--cell-size-m" in note for note in scene.notes)
        assert not any("taken for a height" in note for note in scene.notes)
    np.save(path, -9999.0 + MAP)  # other heights are near
    assert "-9999 is taken for a height" in opened(path).notes[0]
    np.save(path, np.stack([MAP, MAP]))
    assert KIND.open(path, SourceOptions(rate_hz=7)).frame_count == 2


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_grey_png(tmp_path: Path, dtype: type) -> None:
    path = tmp_path / "hills.png"
    values = (MAP * (np.iinfo(dtype).max // 11)).astype(dtype)
    Image.fromarray(values).save(path)
    scene = opened(path)
    np.testing.assert_allclose(scene.bounds_m()[1] - scene.bounds_m()[0], [3, 2, 0.2 * 3])
    assert len(scene.notes) == 2
    exact = opened(path, height_scale=0.01, cell_size_m=0.5)
    np.testing.assert_allclose(exact._heights(0), values * 0.01)
    assert not exact.notes


def tiff(path: Path, values: np.ndarray, tags: dict[int, tuple[int, tuple | str]]) -> None:
    """A minimal TIFF: one strip, little-endian; tags as (type, values), 3 short, 12 double, 2 text."""
    sample_format = {"u": 1, "i": 2, "f": 3}[values.dtype.kind]
    rows, cols = values.shape
    entries = {
        256: (3, (cols,)),
        257: (3, (rows,)),
        258: (3, (8 * values.dtype.itemsize,)),
        259: (3, (1,)),
        262: (3, (1,)),
        273: (4, (8,)),
        277: (3, (1,)),
        278: (3, (rows,)),
        279: (4, (values.nbytes,)),
        339: (3, (sample_format,)),
        **tags,
    }
    data = values.astype(values.dtype.newbyteorder("<")).tobytes()
    data += b"\0" * (len(data) % 2)
    codes, extra, table = {2: "s", 3: "H", 4: "I", 12: "d"}, b"", b""
    after = 8 + len(data) + 2 + 12 * len(entries) + 4
    for tag, (kind, content) in sorted(entries.items()):
        raw = (
            content.encode() + b"\0"
            if isinstance(content, str)
            else struct.pack(f"<{len(content)}{codes[kind]}", *content)
        )
        count = len(raw) if isinstance(content, str) else len(content)
        if len(raw) > 4:
            inline, extra = struct.pack("<I", after + len(extra)), extra + raw + b"\0" * (len(raw) % 2)
        else:
            inline = raw.ljust(4, b"\0")
        table += struct.pack("<HHI", tag, kind, count) + inline
    head = b"II*\0" + struct.pack("<I", 8 + len(data))
    path.write_bytes(head + data + struct.pack("<H", len(entries)) + table + b"\0" * 4 + extra)


@pytest.mark.parametrize(
    "dtype", [np.uint8, np.int8, np.uint16, np.int16, np.int32, np.uint32, np.float16, np.float32, np.float64]
)
def test_tiff_of_each_type(tmp_path: Path, dtype: type) -> None:
    values = MAP.astype(dtype) - (5 if np.dtype(dtype).kind != "u" else 0)
    tiff(tmp_path / "ground.tif", values.astype(dtype), {33550: (12, (2.0, 3.0, 0.0))})
    scene = opened(tmp_path / "ground.tif")
    np.testing.assert_array_equal(scene._heights(0), values)
    np.testing.assert_allclose(scene.bounds_m()[1][:2], [6, 6])


def test_a_tiff_of_another_form_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "ground.tif"
    tifffile.imwrite(path, MAP.astype(np.complex64))
    with pytest.raises(SourceError, match=r"samples complex64.*one number a pixel, whole or floating"):
        open_source(path)


def test_the_first_of_several_pages_is_read_and_noted(tmp_path: Path) -> None:
    path, note = tmp_path / "ground.tif", "The file has several pages of this size: the first is read."
    first, second, small = (
        Image.fromarray(np.full(shape, 3, np.uint16)) for shape in ((6, 8), (6, 8), (3, 4))
    )
    first.save(path, save_all=True, append_images=[second])
    assert note in opened(path).notes
    first.save(path, save_all=True, append_images=[small])  # a smaller copy is no further page
    assert note not in opened(path).notes


@pytest.mark.parametrize("values", [np.ones((3, 4), bool), np.ones((3, 4), complex), np.ones((0, 4))])
def test_error_of_an_npy_without_numbers_states_its_contents(tmp_path: Path, values: np.ndarray) -> None:
    np.save(tmp_path / "ground.npy", values)
    with pytest.raises(SourceError, match=rf"found {values.dtype} .*expected numbers, at least one"):
        opened(tmp_path / "ground.npy")


def test_geotiff_in_degrees_with_nodata(tmp_path: Path) -> None:
    values = MAP.astype(np.float32)
    values[1, 1] = -3.4028234663852886e38
    tags = {
        33550: (12, (0.001, 0.001, 0.0)),
        33922: (12, (0.0, 0.0, 0.0, 10.0, 50.0015, 0.0)),
        34735: (3, (1, 1, 0, 1, 1024, 0, 1, 2)),
        42113: (2, "-3.40282346638529e+38"),
    }
    tiff(tmp_path / "ground.tif", values, tags)
    scene = opened(tmp_path / "ground.tif")
    along, across = degree_m(50.0)
    np.testing.assert_allclose(scene.bounds_m()[1], [0.003 * across, 0.002 * along, 11])
    assert scene.bounds_m()[0][2] == 0
    assert np.isnan(scene._heights(0)[1, 1])
    tags[33922] = (12, (4.0, 3.0, 0.0, 10.004, 49.9985, 0.0))  # the other corner
    tiff(tmp_path / "ground.tif", values, tags)
    np.testing.assert_allclose(opened(tmp_path / "ground.tif").bounds_m(), scene.bounds_m())


def test_geotiff_in_feet(tmp_path: Path) -> None:
    keys = (1, 1, 0, 3, 1024, 0, 1, 1, 3076, 0, 1, 9002, 4099, 0, 1, 9002)
    tags = {33550: (12, (10.0, 10.0, 0.0)), 34735: (3, keys), 42113: (2, "nan")}
    tiff(tmp_path / "ground.tif", MAP, tags)
    np.testing.assert_allclose(opened(tmp_path / "ground.tif").bounds_m()[1], np.array([30, 20, 11]) * 0.3048)
    scaled = opened(tmp_path / "ground.tif", height_scale=0.1)  # an option overrides the file
    np.testing.assert_allclose(scaled.bounds_m()[1], [30 * 0.3048, 20 * 0.3048, 1.1])


class Trap:
    def __reduce__(self) -> tuple[object, tuple[str]]:
        raise AssertionError("never pickled back")


def _broken(path: Path) -> dict[str, Path]:
    """Invalid files by name."""
    files = {}

    def add(name: str, write: object) -> None:
        files[name] = path / name
        write(path / name)  # type: ignore[operator]

    add("nan.npy", lambda p: np.save(p, np.full((3, 3), np.nan)))
    add("line.npy", lambda p: np.save(p, np.zeros(5)))
    add("thin.npy", lambda p: np.save(p, np.zeros((1, 5))))
    add("words.npy", lambda p: np.save(p, np.array([["a", "b"]])))
    add("objects.npy", lambda p: np.save(p, np.array([[{}, {}], [{}, {}]]), allow_pickle=True))
    add("objects.npz", lambda p: np.savez(p, z=np.array([[None, None], [None, None]])))
    add("two.npz", lambda p: np.savez(p, a=np.zeros((3, 3)), b=np.zeros((3, 3))))
    add("none.npz", lambda p: np.savez(p, a=np.zeros(3)))
    add("dx.npz", lambda p: np.savez(p, z=np.zeros((3, 3)), dx=np.zeros(3)))
    add("pole.npz", lambda p: np.savez(p, z=np.zeros((3, 3)), dx=0.01, xmin=0, xmax=1, ymin=89.9, ymax=89.95))
    add(
        "south.npz",
        lambda p: np.savez(p, z=np.zeros((3, 3)), dx=0.01, xmin=0, xmax=1, ymin=-89.9, ymax=-89.95),
    )
    add("colour.png", lambda p: Image.fromarray(np.zeros((3, 3, 3), np.uint8)).save(p))
    add("empty.png", lambda p: p.write_bytes(b""))
    add("zip.npz", lambda p: p.write_bytes(b"PK\x05\x06" + b"\0" * 17))
    add("text.npy", lambda p: p.write_text("1 2 3"))
    add("huge.npy", lambda p: p.write_bytes(_header((1 << 40, 1 << 40))))
    add("nothing.tif", lambda p: tiff(p, np.full((3, 3), 7, np.int16), {42113: (2, "7")}))
    return files


def _header(shape: tuple[int, ...]) -> bytes:
    text = repr({"descr": "<f4", "fortran_order": False, "shape": shape}).ljust(117) + "\n"
    return b"\x93NUMPY\x01\0" + struct.pack("<H", len(text)) + text.encode()


def test_errors_of_invalid_files_are_one_line_with_the_name(tmp_path: Path) -> None:
    for name, path in _broken(tmp_path).items():
        KIND.recognise(path)
        with pytest.raises(SourceError) as caught:
            KIND.open(path, SourceOptions())
        assert name in str(caught.value)
        assert "\n" not in str(caught.value)


@given(st.data())
@settings(max_examples=80)
def test_damaged_files_give_a_scene_or_a_source_error(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("damaged")
    path = folder / data.draw(st.sampled_from(["a.npz", "a.npy", "a.png", "a.tif"]))
    if path.suffix == ".npz":
        np.savez_compressed(path, elevation=MAP, dx=2.0)
    elif path.suffix == ".npy":
        np.save(path, MAP)
    elif path.suffix == ".png":
        Image.fromarray(MAP.astype(np.uint16)).save(path)
    else:
        tiff(path, MAP, {33550: (12, (2.0, 3.0, 0.0)), 42113: (2, "3")})
    raw = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(0, 4))):
        raw[data.draw(st.integers(0, len(raw) - 1))] = data.draw(st.integers(0, 255))
    path.write_bytes(raw[: data.draw(st.integers(0, len(raw)))])
    KIND.recognise(path)
    try:
        outcome = str(KIND.open(path, SourceOptions()).bounds_m().shape)
    except SourceError as error:
        outcome = str(error)
    assert outcome == "(2, 3)" or path.name in outcome


def test_an_array_without_numbers_is_refused(tmp_path: Path) -> None:
    np.save(tmp_path / "map.npy", np.zeros((4, 5), bool))
    with pytest.raises(SourceError, match=r"found bool \[4, 5\]; expected numbers"):
        KIND.open(tmp_path / "map.npy", SourceOptions())


def test_files_that_are_no_height_maps_are_not_recognised(tmp_path: Path) -> None:
    np.savez(tmp_path / "field.npz", forces_n=np.zeros((1, 2, 2, 2, 3)), z=MAP)
    Image.fromarray(MAP.astype(np.uint16)).save(tmp_path / "depth_0001.png")
    Image.fromarray(MAP.astype(np.uint8)).save(tmp_path / "disp1.png")
    Image.fromarray(np.zeros((3, 3, 3), np.uint8)).save(tmp_path / "colour.png")
    (tmp_path / "bad.png").write_bytes(b"\x89PNG")
    for path in (*tmp_path.iterdir(), tmp_path, tmp_path / "absent.npy"):
        assert not KIND.recognise(path), path.name

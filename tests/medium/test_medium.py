"""Properties of the values: grids, sparse fields, media."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.budget import memory_budget_bytes, require_memory, zero_forces
from touchfield.medium.medium import Segments, VibrationFrame

shapes = st.tuples(*[st.integers(1, 21)] * 3)
metres = st.floats(-2.0, 2.0)
spacings = st.floats(1e-4, 0.5)


@st.composite
def grids(draw: st.DrawFn) -> Grid:
    return Grid(
        draw(shapes), draw(st.tuples(spacings, spacings, spacings)), draw(st.tuples(metres, metres, metres))
    )


@st.composite
def dense_fields(draw: st.DrawFn) -> tuple[Grid, np.ndarray]:
    grid = draw(grids())
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    dense = rng.normal(size=(*grid.shape, 3)).astype(np.float32)
    dense[rng.random(grid.shape) > draw(st.sampled_from([0.0, 0.05, 0.5, 1.0]))] = 0
    return grid, dense


@given(dense_fields())
def test_dense_and_sparse_round_trip(case: tuple[Grid, np.ndarray]) -> None:
    grid, dense = case
    field = ForceField.from_dense(grid, dense)
    np.testing.assert_array_equal(field.to_dense(), dense)
    assert ForceField.from_dense(grid, field.to_dense()) == field
    assert field.support_count == np.count_nonzero((dense != 0).any(-1))


@given(dense_fields())
def test_support_view_lists_the_forces_in_raster_order(case: tuple[Grid, np.ndarray]) -> None:
    grid, dense = case
    field = ForceField.from_dense(grid, dense)
    support = field.support()
    expected = np.argwhere((dense != 0).any(-1))
    np.testing.assert_array_equal(support.positions, expected)
    np.testing.assert_array_equal(field.vectors_n(), dense[tuple(expected.T)])
    rebuilt = support.amplitudes_n[:, None] * support.directions
    np.testing.assert_allclose(rebuilt, field.vectors_n(), rtol=1e-5, atol=1e-7)
    assert ForceField.from_support(grid, support.positions, field.vectors_n()) == field


@given(dense_fields(), st.floats(-4, 4, width=32))
def test_sum_and_scaling(case: tuple[Grid, np.ndarray], factor: float) -> None:
    grid, dense = case
    field = ForceField.from_dense(grid, dense)
    np.testing.assert_array_equal(field.scaled(factor).to_dense(), dense * np.float32(factor))
    other = ForceField.from_dense(grid, np.flip(dense, 0))
    assert field + other == other + field
    np.testing.assert_array_equal((field + other).to_dense(), dense + np.flip(dense, 0))
    assert field + field.scaled(-1) == ForceField.empty(grid)


@given(dense_fields(), st.integers(0, 2**32 - 1))
def test_trilinear_query(case: tuple[Grid, np.ndarray], seed: int) -> None:
    grid, dense = case
    field = ForceField.from_dense(grid, dense)
    rng = np.random.default_rng(seed)
    index = rng.uniform(-2, np.array(grid.shape) + 1, size=(50, 3))
    padded = np.pad(dense.astype(np.float64), [(3, 3)] * 3 + [(0, 0)])
    base = np.floor(index).astype(int)
    expected = np.zeros((50, 3))
    for corner in np.ndindex(2, 2, 2):
        weight = np.prod(np.where(corner, index - base, 1 - (index - base)), axis=1)
        expected += weight[:, None] * padded[tuple((base + corner + 3).T)]
    np.testing.assert_allclose(field.sample_n(grid.to_m(index)), expected, atol=2e-5)


@given(grids())
def test_grid_index_and_metres_are_inverse(grid: Grid) -> None:
    index = np.array([[0, 0, 0], [1.5, 2.25, -3], grid.shape])
    np.testing.assert_allclose(grid.to_index(grid.to_m(index)), index, atol=1e-6)
    low, high = grid.box_m
    np.testing.assert_allclose(grid.to_index(low), [-0.5] * 3, atol=1e-6)
    np.testing.assert_allclose(grid.to_index(high), np.array(grid.shape) - 0.5, atol=1e-6)
    refined = grid.refined(3)
    np.testing.assert_allclose(np.stack(refined.box_m), np.stack(grid.box_m), atol=1e-9)
    assert refined.voxel_count == 27 * grid.voxel_count


def test_bricks_in_any_order_become_canonical() -> None:
    grid = Grid((16, 16, 9), (1, 1, 1), (0, 0, 0))
    forces = np.ones((3, 8, 8, 8, 3), np.float32)
    forces[1] = 0  # an empty brick is not stored
    field = ForceField.from_bricks(grid, [[1, 1, 1], [0, 1, 0], [0, 0, 0]], forces)
    np.testing.assert_array_equal(field.bricks, [[0, 0, 0], [1, 1, 1]])
    assert field.support_count == 512 + 64  # nothing is stored beyond the ninth sample along z


def test_values_are_read_only(wavy_field: ForceField) -> None:
    with pytest.raises(ValueError, match="read-only"):
        wavy_field.forces_n[0, 0, 0, 0, 0] = 1
    with pytest.raises(AttributeError):
        wavy_field.grid = None  # type: ignore[misc,assignment]


@pytest.mark.parametrize(
    ("shape", "spacing", "origin"),
    [
        ((0, 1, 1), (1, 1, 1), (0, 0, 0)),
        ((1, 1, 2**21), (1, 1, 1), (0, 0, 0)),
        ((4, 4, 4), (1, -1, 1), (0, 0, 0)),
        ((4, 4, 4), (1, float("nan"), 1), (0, 0, 0)),
        ((4, 4, 4), (1, 1, 1), (0, float("inf"), 0)),
    ],
)
def test_bad_grids_are_refused(shape: tuple, spacing: tuple, origin: tuple) -> None:
    with pytest.raises(InvalidArgument, match="grid"):
        Grid(shape, spacing, origin)


def test_bad_fields_are_refused() -> None:
    grid = Grid((8, 8, 8), (1, 1, 1), (0, 0, 0))
    with pytest.raises(InvalidArgument, match="not finite"):
        ForceField.from_dense(grid, np.full((8, 8, 8, 3), np.nan))
    with pytest.raises(InvalidArgument, match="shape"):
        ForceField.from_dense(grid, np.zeros((8, 8, 7, 3)))
    with pytest.raises(InvalidArgument, match="outside"):
        ForceField.from_support(grid, [[8, 0, 0]], [[1, 0, 0]])
    with pytest.raises(InvalidArgument, match="twice"):
        ForceField.from_bricks(grid, [[0, 0, 0], [0, 0, 0]], np.ones((2, 8, 8, 8, 3)))


def test_medium_is_lazy_and_sliced(wavy_field: ForceField) -> None:
    computed_frames: list[int] = []

    def make(frame: int) -> ForceField:
        computed_frames.append(frame)
        return wavy_field.scaled(frame + 1)

    medium = HapticMedium(wavy_field.grid, 30.0, 10, make)
    assert not computed_frames
    part = medium.between(4, 7)
    assert len(part) == 3 and part[0] == wavy_field.scaled(5) and part[-1] == wavy_field.scaled(7)
    assert computed_frames == [4, 6]
    with pytest.raises(IndexError):
        part[3]
    np.testing.assert_allclose(part.at(0.7 / 30).to_dense(), 5.7 * wavy_field.to_dense(), rtol=1e-6)
    np.testing.assert_allclose(part.sample_n([[0.0, 0.0, 0.0]], 9.0), part[2].sample_n([[0.0, 0.0, 0.0]]))
    segmented = replace(medium, segments=Segments((0, 4, 6), 0.1, 0.0))
    cuts = [segmented.between(*frames).segments for frames in ((3, 9), (4, 6), (5, 7))]
    assert [cut.starts for cut in cuts if cut] == [(0, 1, 3), (0,), (0, 1)]
    with pytest.raises(InvalidArgument, match="0:10"):
        medium.between(4, 11)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        HapticMedium(wavy_field.grid, 0.0, 1, make)
    other = ForceField.empty(wavy_field.grid.moved(1.0, (0.001, 0, 0)))
    with pytest.raises(InvalidArgument, match="grids"):
        HapticMedium.from_frames([wavy_field, other], 30.0)
    with pytest.raises(InvalidArgument, match="another grid"):
        HapticMedium(wavy_field.grid, 30.0, 1, lambda _: other)[0]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"positions": np.zeros((2, 3), np.int64)}, "int32"),
        ({"positions": np.array([[0, 0, 0], [0, 0, 3]], np.int32)}, "outside"),
        ({"positions": np.array([[0, -1, 0], [0, 0, 1]], np.int32)}, "outside"),
        ({"positions": np.array([[0, 0, 1], [0, 0, 1]], np.int32)}, "twice"),
        ({"positions": np.array([[1, 0, 0], [0, 1, 0]], np.int32)}, "order"),
        ({"amplitudes_n": np.ones(3, np.float32)}, "amplitudes_n"),
        ({"amplitudes_n": np.array([1, 0], np.float32)}, "amplitudes_n"),
        ({"frequencies_hz": np.array([1, np.inf], np.float32)}, "frequencies_hz"),
        ({"frequencies_hz": np.array([1, 10001], np.float32)}, "up to 10000 Hz"),
    ],
)
def test_bad_vibrations_are_refused(change: dict[str, np.ndarray], message: str) -> None:
    indices, both = np.array([[0, 0, 1], [1, 0, 0]], np.int32), np.full(2, 10000, np.float32)
    frame = VibrationFrame(Grid((2, 2, 3), (1, 1, 1), (0, 0, 0)), indices, both, both)
    with pytest.raises(InvalidArgument, match=message):
        replace(frame, **change)


def test_a_field_stays_within_the_memory_budget(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.001")
    assert zero_forces(100).shape == (100, 8, 8, 8, 3)
    require_memory("a field", "bytes", memory_budget_bytes())
    with pytest.raises(InvalidArgument, match="a field"):
        require_memory("a field", "bytes", memory_budget_bytes() + 1)
    with pytest.raises(InvalidArgument, match="TOUCHFIELD_MEMORY_GIB"):
        zero_forces(200)


def test_a_medium_as_a_dataset(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xarray")
    grid = Grid((5, 4, 3), (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    forces = np.random.default_rng(1).normal(size=(2, 5, 4, 3, 3)).astype(np.float32)
    data = HapticMedium.from_array(forces, grid, rate_hz=50.0).to_xarray()
    assert data.forces_n.dims == ("t", "x", "y", "z", "component") and data.forces_n.units == "N"
    np.testing.assert_array_equal(data.forces_n, forces)
    nearest = data.forces_n.sel(component="y").sel(t=0.02, x=0.102, y=0.204, z=0.303, method="nearest")
    assert nearest == forces[1, 2, 2, 1, 1]
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.000001")  # 1073 bytes: one frame, of 720
    assert HapticMedium.from_array(forces[0], grid).to_xarray().forces_n.shape[0] == 1
    with pytest.raises(InvalidArgument, match="Take fewer frames"):
        HapticMedium.from_array(forces, grid, rate_hz=50.0).to_xarray()


def test_a_field_as_an_array_with_axes(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("xarray")
    grid = Grid((5, 4, 3), (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    forces = np.random.default_rng(1).normal(size=(5, 4, 3, 3)).astype(np.float32)
    field = ForceField.from_dense(grid, forces)
    data = field.to_xarray()
    assert data.dims == ("x", "y", "z", "component") and (data.name, data.units) == ("forces_n", "N")
    np.testing.assert_array_equal(data, forces)
    assert data.sel(component="y").sel(x=0.102, y=0.204, z=0.303, method="nearest") == forces[2, 2, 1, 1]
    assert data.z.units == "m"
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "0.0000001")  # 107 bytes, of 720
    with pytest.raises(InvalidArgument, match="a dense field"):
        field.to_xarray()


def test_descriptions_of_grid_and_field_list_every_axis() -> None:
    grid = Grid((3, 40, 500), (0.001, 0.0025, 0.04), (0.0, 0.0, 0.0))
    assert grid.description == "3 x 40 x 500 samples of 1 x 2.5 x 40 mm"
    dense = np.zeros((*grid.shape, 3), np.float32)
    dense[:, :, :10] = 1
    text = repr(ForceField.from_dense(grid, dense))
    assert text == f"<ForceField: 1,200 of 60,000 samples hold a force, {grid.description}>"
    medium = HapticMedium(grid, 25.0, 1, lambda _: ForceField.empty(grid), "x right, y up, z near")
    assert repr(medium) == f"<HapticMedium: 1 frame at 25 Hz on {grid.description}; x right, y up, z near>"
    text_with_vibration = repr(replace(medium, frame_count=2, vibration=lambda _: VibrationFrame.empty(grid)))
    assert "2 frames at" in text_with_vibration and "with vibration" in text_with_vibration


def test_error_of_refused_memory_states_both_sizes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", "1.5")
    assert memory_budget_bytes() == 3 << 29
    with pytest.raises(
        InvalidArgument, match=r"a thing: found 2\.0 GiB of bricks; expected at most 1\.5 GiB"
    ):
        require_memory("a thing", "bricks", 2 << 30)
    physical_bytes = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    for text in ("", "much", "inf"):
        monkeypatch.setenv("TOUCHFIELD_MEMORY_GIB", text)
        assert memory_budget_bytes() == physical_bytes // 2


@pytest.mark.parametrize(
    ("frames", "first", "second", "weight"),
    [
        (-1.0, 0, 0, 0.0),
        (0.25, 0, 1, 0.25),
        (1.0, 1, 1, 0.0),
        (1.9, 1, 2, 0.9),
        (2.0, 2, 2, 0.0),
        (7.3, 2, 2, 0.0),
    ],
)
def test_forces_between_two_frames_are_interpolated_linearly(
    wavy_field: ForceField, frames: float, first: int, second: int, weight: float
) -> None:
    fields = [wavy_field, wavy_field.scaled(-2.0), wavy_field.scaled(5.0)]
    medium = HapticMedium.from_frames(fields, 40.0)
    expected = (1 - weight) * fields[first].to_dense().astype(float) + weight * fields[second].to_dense()
    np.testing.assert_allclose(medium.at(frames / 40).to_dense(), expected, atol=1e-6)
    points = wavy_field.grid.to_m(np.random.default_rng(1).uniform(0, 15, (40, 3)))
    sampled = [fields[n].sample_n(points).astype(float) for n in (first, second)]
    np.testing.assert_allclose(
        medium.sample_n(points, frames / 40), (1 - weight) * sampled[0] + weight * sampled[1], atol=1e-6
    )
    with pytest.raises(InvalidArgument, match="time_s"):
        medium.at(float("nan"))


def test_voxels_of_a_scene_keep_its_metadata(wavy_field: ForceField) -> None:
    body_medium = HapticMedium.from_frames([wavy_field], 50.0)
    body = HapticObject("a", body_medium, PoseTrack.constant(3))
    metadata: dict[str, Any] = {
        "axes": "x right, y up, z near", "friction": 0.25, "damping_n_s_per_m": 3.0, "tags": ("symbolic",),
        "provenance": {"source": "a scene"},
    }  # fmt: skip
    scene = HapticScene(wavy_field.grid, 50.0, (body,), 3.3, **metadata)
    coarse = Grid.over_box(*wavy_field.grid.box_m, (5, 6, 7))
    for voxels, grid in ((scene.voxelise(), scene.grid), (scene.voxelise(coarse), coarse)):
        assert (voxels.grid, voxels.rate_hz, len(voxels)) == (grid, 50.0, 3)
        for name, value in metadata.items():
            assert getattr(voxels, name) == value, name
        assert (voxels.metadata["friction"], voxels.metadata["damping_n_s_per_m"]) == (0.25, 3.0)


def test_a_part_of_a_scene_has_the_fields_and_poses_of_its_frames(wavy_field: ForceField) -> None:
    fields = [wavy_field.scaled(n + 1.0) for n in range(4)]
    track = PoseTrack(PoseTrack.constant(4).quaternions, np.arange(12.0).reshape(4, 3))
    rigid = HapticObject("rigid", HapticMedium.from_frames(fields[:1], 50.0), track)
    soft = HapticObject("soft", HapticMedium.from_frames(fields, 50.0), PoseTrack.constant(4))
    part = HapticScene(wavy_field.grid, 50.0, (rigid, soft), 3.3).between(2, 4)
    assert len(part) == 2 and [obj.is_rigid for obj in part.objects] == [True, False]
    assert [part.objects[1].field(i) for i in range(2)] == fields[2:]
    assert part.objects[0].field(1) == fields[0]
    np.testing.assert_array_equal(part.objects[0].track.positions_m, track.positions_m[2:])


def test_vibration_is_sampled_as_amplitude_and_frequency() -> None:
    grid = Grid((9, 3, 20), (0.001, 0.002, 0.003), (0.1, 0.2, 0.3))
    indices = np.array([[0, 2, 17], [8, 0, 0], [8, 2, 19]], np.int32)
    amplitudes, frequencies = np.array([1, 2, 3], np.float32), np.array([40, 50, 60], np.float32)
    field = VibrationFrame(grid, indices, amplitudes, frequencies).as_field()
    assert field.grid == grid
    np.testing.assert_array_equal(field.positions(), indices)
    np.testing.assert_array_equal(
        field.vectors_n(), np.stack([amplitudes, frequencies, 0 * amplitudes], axis=1)
    )

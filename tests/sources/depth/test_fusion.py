"""The fused world: static parts do not tremble, moving parts are not smeared, and each mode is as
documented.
"""

from __future__ import annotations

from copy import copy
from pathlib import Path

import numpy as np
import pytest

import depth_makers as make
import fusion_makers as rooms
from touchfield.arrays import Int32s, Int64s
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.encoding import encode
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth import fused_scene
from touchfield.sources.depth.depth_scene import DepthScene, query_of
from touchfield.sources.depth.fused_scene import FusedScene, FusedVolume, is_static
from touchfield.sources.depth.kernels.field import Query, nodes_in_view
from touchfield.sources.depth.layouts import depth_scene
from touchfield.sources.laws import ForceProfile
from touchfield.sources.options import SourceOptions

WALL = ForceProfile(((-0.18, 0.0, 0.0, -18.0),))
STATIC_POSES = np.tile(np.eye(4), (12, 1, 1))
MOVED = [(-0.1 + 0.07 * max(0, i - 2), 0.3, 2.0) for i in range(12)]


def lattice(scene: DepthScene, side: int = 96) -> Grid:
    low, high = scene.bounds_m()
    return Grid.over_box(low - 0.05, high + 0.05, (side, side, side))


def is_supported(field: ForceField) -> np.ndarray:
    return np.asarray(field.to_dense().any(axis=-1))


@pytest.fixture(scope="module")
def standing() -> rooms.Room:
    return rooms.Room(rooms.arc(10))


@pytest.fixture(scope="module")
def moving() -> rooms.Room:
    return rooms.Room(STATIC_POSES, MOVED)


def test_a_static_world_is_a_single_more_accurate_field(standing: rooms.Room) -> None:
    fused, alone = FusedScene(standing), DepthScene(standing)
    grid = lattice(fused)
    first = fused.field(0, grid, WALL)
    assert all(fused.field(i, grid, WALL) is first for i in (9, 4, 0))
    errors = np.median(np.abs(standing.contact_errors_m(first, 18.0)))
    single = [
        np.median(np.abs(standing.contact_errors_m(alone.field(i, grid, WALL), 18.0))) for i in (0, 5, 9)
    ]
    assert errors <= 0.5 * np.median(single)
    assert fused.late_notes() == ()


def test_a_causal_world_depends_on_past_frames_only(standing: rooms.Room) -> None:
    causal = FusedScene(standing, "causal")
    grid = lattice(causal)
    fields = [causal.field(i, grid, WALL) for i in range(6)]
    fewer = FusedScene(standing, "causal")
    fewer.restrict_frames(0, 4)
    assert fewer.field(3, grid, WALL) == fields[3]
    assert causal.field(2, grid, WALL) == fields[2]  # the same in reverse order
    assert is_supported(fields[5]).sum() > is_supported(fields[0]).sum()


def test_a_causal_world_is_renewed_eight_times_a_second_and_changes_follow_every_frame(
    standing: rooms.Room, moving: rooms.Room
) -> None:
    causal = FusedScene(standing, "causal")
    grid = lattice(causal)
    forces = [causal.field(i, grid, WALL).to_dense() for i in range(10)]
    steps = [int((a != b).any(-1).sum()) for a, b in zip(forces[:-1], forces[1:])]
    every = round(standing.rate_hz / 8)
    renewed = [i % every == 0 for i in range(1, 10)]
    others = [n for n, is_renewed in zip(steps, renewed) if not is_renewed]
    assert min(n for n, is_renewed in zip(steps, renewed) if is_renewed) > 10 * max(others)
    causal = FusedScene(moving, "causal")
    grid = lattice(causal)
    positions_m = moving.world(np.asarray(grid.to_m(np.stack(np.indices(grid.shape), -1))))
    for i in range(3, 12):  # the box at its current position
        corner = np.abs(positions_m - np.array(MOVED[i])) - rooms.HALF_M
        inside = (
            (corner.max(-1) < -0.01)
            & (positions_m[..., 2] < 1.9)
            & (positions_m[..., 1] < 0.6)
            & (corner[..., 0] < -0.05)
        )
        inside &= positions_m[..., 0] > 0.0  # the ball occludes the part to its left
        assert is_supported(causal.field(i, grid, WALL))[inside].mean() > 0.8, i
    assert causal.field(11, grid, WALL) != causal.field(10, grid, WALL)


def test_frames_differ_less_than_when_each_is_alone(standing: rooms.Room) -> None:
    grid = lattice(DepthScene(standing))

    def change(scene: DepthScene) -> float:
        a, b = (scene.field(i, grid, WALL).to_dense() for i in (6, 7))
        both = a.any(-1) & b.any(-1)
        size = np.linalg.norm(a, axis=-1)
        return float((np.linalg.norm(a - b, axis=-1) > np.maximum(0.05, 0.1 * size))[both].mean())

    alone, causal = change(DepthScene(standing)), change(FusedScene(standing, "causal"))
    assert alone > 0.1
    assert causal < 0.5 * alone


def test_a_box_moves_before_a_static_wall(moving: rooms.Room) -> None:
    fused = FusedScene(moving)
    grid = lattice(fused)
    positions_m = moving.world(np.asarray(grid.to_m(np.stack(np.indices(grid.shape), -1))))
    fields = {i: fused.field(i, grid, WALL) for i in (0, 4, 8, 11)}
    for i, field in fields.items():
        corner = np.abs(positions_m - np.array(MOVED[i])) - rooms.HALF_M
        inside = (
            (corner.max(-1) < -0.01)
            & (positions_m[..., 2] < 1.9)
            & (positions_m[..., 1] < 0.6)
            & (corner[..., 0] < -0.05)
        )
        inside &= positions_m[..., 0] > 0.0  # the ball occludes the part to its left
        assert is_supported(field)[inside].mean() > 0.9, i
        outside = rooms.distance_m(positions_m, MOVED[i]) > 0.1
        is_visible = outside & (positions_m[..., 2] < 1.9) & (positions_m[..., 0] > MOVED[i][0] + 0.45)
        assert is_supported(field)[is_visible].mean() < 0.005, i
    wall = positions_m[..., 2] > 2.55
    wall &= (positions_m[..., 1] < -0.4) & (positions_m[..., 0] > -0.4)
    steady = [field.to_dense()[wall] for field in fields.values()]
    assert steady[0].any()
    for other in steady[1:]:
        np.testing.assert_array_equal(other, steady[0])
    (note,) = fused.late_notes()
    assert "moves" in note
    early = fused.field(0, grid, WALL)  # the moving part starts again
    assert early == fields[0]


class WholeFields(FusedScene):
    """A fused world that does not state what its fields have in common."""

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        return super().field_update(frame, grid, profile).field

    def field_update(self, frame: int, grid: Grid, profile: ForceProfile) -> None:  # type: ignore[override]
        return None


@pytest.mark.parametrize("world", ["fused", "causal"])
def test_a_moving_world_is_filtered_where_it_differs_to_the_same_bits(moving: rooms.Room, world: str) -> None:
    medium = prepare(FusedScene(moving, world), nw=5).medium
    whole = prepare(WholeFields(moving, world), nw=5).medium
    fields = {i: medium[i] for i in (0, 1, 2, 5, 6, 7, 3)}
    for i, field in fields.items():
        assert field == whole[i], i
    assert fields[1] != fields[5] != fields[6]


@pytest.mark.parametrize(("frames", "key_frames"), [((2, 5), range(2, 5)), ((7, None), range(7, 10))])
def test_a_world_is_fused_from_the_requested_frames(
    standing: rooms.Room, frames: tuple[int, int | None], key_frames: range
) -> None:
    alone = copy(standing)
    alone.key_frames = lambda: key_frames  # type: ignore[method-assign]
    some, expected = (
        prepare(FusedScene(sequence), EncodeSpec(nw=4, frames=frames)).medium
        for sequence in (standing, alone)
    )
    assert len(some) == 3 and some[0] == expected[0] and some[0].support_count > 100


def test_vacated_space_is_carved_from_a_causal_world(moving: rooms.Room) -> None:
    causal = FusedScene(moving, "causal")
    grid = lattice(causal)
    positions_m = moving.world(np.asarray(grid.to_m(np.stack(np.indices(grid.shape), -1))))
    is_vacated = (np.abs(positions_m - np.array([0.03, -0.02, 1.85])) < np.array([0.1, 0.04, 0.04])).all(-1)
    assert is_supported(causal.field(1, grid, WALL))[is_vacated].mean() > 0.9
    assert is_supported(causal.field(11, grid, WALL))[is_vacated].mean() < 0.02


def test_bricks_follow_the_surface(standing: rooms.Room) -> None:
    scene = FusedScene(standing)
    counts = []
    for side in (64, 128, 256):
        grid = lattice(scene, side)
        volume = FusedVolume(grid, ForceProfile(((-0.05, 0.0, 0.0, -18.0),)), 0.007)
        for i in range(0, 10, 3):
            volume.cover(scene.planes(i), scene.pose(i))
        counts.append(len(volume.bricks))
    assert counts[2] / counts[1] < 6.5  # a box would take eight times as many
    assert counts[2] < 0.3 * (256 // 8) ** 3


def test_bricks_that_a_view_does_not_see_are_left_out_without_any_change(
    standing: rooms.Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = DepthScene(standing)
    low, high = scene.bounds_m()
    grid = Grid.over_box(low - 1.5, high + 1.5, (96, 96, 96))
    every = np.argwhere(np.ones(grid.brick_shape)).astype(np.int32)

    def fused() -> FusedVolume:
        volume = FusedVolume(grid, WALL, 0.007)
        volume.add(every)
        for i in (0, 9, 5, 0):
            volume.integrate(scene.planes(i), scene.pose(i))
        return volume

    counts: list[int] = []
    rows_in_view = FusedVolume.rows_in_view

    def counted(volume: FusedVolume, query: Query) -> Int64s:
        rows = rows_in_view(volume, query)
        counts.append(len(rows))
        return rows

    monkeypatch.setattr(FusedVolume, "rows_in_view", counted)
    ours = fused()
    monkeypatch.setattr(FusedVolume, "rows_in_view", lambda volume, query: np.arange(len(volume.bricks)))
    reference = fused()
    assert 0 < max(counts) < 0.5 * len(every)
    assert all(np.array_equal(a, b) for a, b in zip(ours.samples, reference.samples, strict=True))
    assert ours.samples.has_surface.any() and ours.residuals_m == reference.residuals_m


def test_a_view_tests_the_bricks_near_it_and_finds_all_that_it_sees(
    standing: rooms.Room, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = DepthScene(standing)
    low, high = scene.bounds_m()
    grid = Grid.over_box(low - 10, high + 10, (250, 234, 218))  # 32 x 30 x 28 bricks: part of a block
    every = np.argwhere(np.ones(grid.brick_shape)).astype(np.int32)
    volume = FusedVolume(grid, WALL, 0.007)
    for part in np.array_split(np.random.default_rng(0).permutation(every), 7):
        volume.add(part)
    assert len(volume.bricks) == len(every)
    tested: list[int] = []

    def counted(nodes: Int32s, span: int, query: Query) -> Int64s:
        tested.append(len(nodes))
        return nodes_in_view(nodes, span, query)

    monkeypatch.setattr(fused_scene, "nodes_in_view", counted)
    for i in (0, 9):
        query = query_of(scene.planes(i), scene.pose(i), grid, WALL)
        rows = volume.rows_in_view(query)
        assert np.array_equal(rows, nodes_in_view(volume.bricks, 1, query))
        assert len(rows) > 500
        assert sum(tested) < 3 * len(rows) < len(every)
        tested.clear()


def test_the_requested_mode_is_used(standing: rooms.Room) -> None:
    assert isinstance(depth_scene(standing, SourceOptions()), FusedScene)
    assert not isinstance(depth_scene(standing, SourceOptions(world="frames")), FusedScene)
    assert not isinstance(depth_scene(standing, SourceOptions(frame="camera")), FusedScene)
    assert depth_scene(standing, SourceOptions(world="causal")).world == "causal"
    assert not isinstance(depth_scene(rooms.Room(STATIC_POSES[:1]), SourceOptions()), FusedScene)
    with pytest.raises(InvalidArgument, match="world"):
        SourceOptions(world="both")
    with pytest.raises(InvalidArgument, match="world"):
        FusedScene(standing, "frames")


def test_a_camera_without_poses_is_fused_only_if_static(moving: rooms.Room) -> None:
    turning = rooms.Room(rooms.arc(10))
    moving = rooms.Room(STATIC_POSES, MOVED)
    moving.poses = turning.poses = None
    assert is_static(moving)
    assert not is_static(turning)
    static = depth_scene(moving, SourceOptions())
    assert isinstance(static, FusedScene)
    assert any("assumed to be static" in note for note in static.notes)
    alone = depth_scene(turning, SourceOptions())
    assert not isinstance(alone, FusedScene)
    assert any("--world frames" in note for note in alone.notes)


def test_drifting_poses_are_noted() -> None:
    sequence = rooms.Room(np.tile(np.eye(4), (16, 1, 1)))
    sequence.poses = np.tile(np.eye(4), (16, 1, 1))
    sequence.poses[:, 2, 3] = 0.0004 * np.arange(16) ** 2
    scene = FusedScene(sequence)
    scene.field(0, lattice(scene, 64), WALL)
    assert any("drift" in note for note in scene.late_notes())


def test_a_static_world_takes_the_bytes_of_a_frame_and_is_noted(tmp_path: Path) -> None:
    folder = make.write_tum(tmp_path / "tum")
    sizes = {}
    for world in ("frames", "fused"):
        spec = EncodeSpec(nw=5, source=SourceOptions(world=world))
        sizes[world] = encode(folder, tmp_path / f"{world}.touch", spec)
    assert sizes["fused"].file_bytes < sizes["frames"].file_bytes
    assert any("--world fused" in note for note in sizes["fused"].notes)

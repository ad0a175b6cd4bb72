"""The force at a point between two frames of the block, against reference fields and scenes."""

from __future__ import annotations

import numpy as np
import pytest
from block_makers import Block, some_field
from hypothesis import given, settings, strategies as st
from scipy.spatial.transform import Rotation

from touchfield.compute.native import native
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.medium.cells import CellPool
from touchfield.medium.medium import VibrationFrame
from touchfield.render.block import Memory
from touchfield.render.block.frames import FramePart, field_bytes, write_field

GRID = Grid((17, 12, 21), (0.01, 0.011, 0.009), (-0.08, -0.06, -0.1))
seeds = st.integers(0, 2**32 - 1)


def forces(block: Block, a: int, b: int, blend: float, points: np.ndarray) -> np.ndarray:
    return np.array([native.force_at(block.memory.bytes, a, b, blend, *p) for p in points.tolist()])


def vibration(block: Block, frame: int, *point: float) -> tuple[float, float]:
    return native.vibration_at(block.memory.bytes, frame, frame, 0.0, *point)


@settings(max_examples=30)
@given(seeds)
def test_voxels_are_the_interpolated_field(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field, block = some_field(rng), Block()
    frame = block.voxels(field)
    low, high = field.grid.box_m
    points = rng.uniform(low - 0.03, high + 0.03, (60, 3))
    np.testing.assert_allclose(
        forces(block, frame, frame, 0.0, points), field.sample_n(points), atol=1e-6, rtol=0
    )


@settings(max_examples=20)
@given(seeds)
def test_lattice_points_are_exact(seed: int) -> None:
    rng = np.random.default_rng(seed)
    field, block = some_field(rng), Block()
    frame = block.voxels(field)
    index = np.argwhere(np.ones(field.grid.shape))[:: max(1, field.grid.voxel_count // 150)]
    found = forces(block, frame, frame, 0.0, field.grid.to_m(index))
    assert np.array_equal(found, field.to_dense()[tuple(index.T)].astype(np.float64))


@settings(max_examples=20)
@given(seeds, st.floats(0, 1))
def test_fields_that_change_are_blended(seed: int, blend: float) -> None:
    rng = np.random.default_rng(seed)
    first, second, block = some_field(rng, GRID), some_field(rng, GRID), Block()
    a, b = block.voxels(first), block.voxels(second)
    points = rng.uniform(*GRID.box_m, (40, 3))
    expected = (1 - blend) * first.sample_n(points).astype(float) + blend * second.sample_n(points)
    np.testing.assert_allclose(forces(block, a, b, blend, points), expected, atol=2e-6, rtol=0)
    for outside, frame in ((-0.5, a), (0.0, a), (1.0, b), (1.5, b), (np.nan, a)):
        assert np.array_equal(forces(block, a, b, outside, points), forces(block, frame, frame, 0.0, points))


@settings(max_examples=20)
@given(seeds, st.sampled_from([0.0, 0.3]), st.sampled_from([0.7, 50.0]))
def test_objects_are_the_scene_at_its_frames(seed: int, damping: float, limit_n: float) -> None:
    rng = np.random.default_rng(seed)
    fields = [some_field(rng) for _ in range(2)]
    tracks = [
        PoseTrack(Rotation.random(2, random_state=rng).as_quat(), rng.normal(0, 0.05, (2, 3))) for _ in fields
    ]
    objects = [
        HapticObject(str(n), HapticMedium.from_frames([f], 50.0), t)
        for n, (f, t) in enumerate(zip(fields, tracks))
    ]
    scene = HapticScene(GRID, 50.0, tuple(objects), limit_n, damping)
    block = Block()
    addresses = [block.field(f) for f in fields]
    frames = []
    for i in range(2):
        motions = [damping * np.concatenate([v[i] for v in t.velocities(50.0)]) for t in tracks]
        rows = zip(addresses, tracks, motions)
        frames.append(
            block.frame([FramePart(at, t.quaternions[i], t.positions_m[i], m) for at, t, m in rows], limit_n)
        )
    points = rng.normal(0, 0.1, (60, 3))
    for i, blend in ((0, 0.0), (1, 1.0)):
        np.testing.assert_allclose(
            forces(block, *frames, blend, points), scene.sample_n(i, points), atol=5e-6, rtol=0
        )
    assert (np.linalg.norm(forces(block, *frames, 0.4, points), axis=1) <= limit_n).all()


@settings(max_examples=20)
@given(seeds, st.floats(0.01, 0.99), st.booleans())
def test_a_body_moves_and_leaves_no_ghost(seed: int, blend: float, is_long_way: bool) -> None:
    """Between two poses the body has the interpolated pose; the sign of a quaternion does not matter."""
    rng = np.random.default_rng(seed)
    dense = rng.normal(size=(*GRID.shape, 3))
    field, block = ForceField.from_dense(GRID, dense), Block()
    address = block.field(field)
    quaternions = Rotation.random(2, random_state=rng).as_quat(scalar_first=True)
    shift = rng.normal(0, 0.05, (2, 3))
    sign = -1.0 if is_long_way else 1.0
    a, b = (block.frame([FramePart(address, s * q, t)]) for s, q, t in zip((1.0, sign), quaternions, shift))
    nearest = quaternions[1] * np.sign(quaternions[0] @ quaternions[1])
    turn = Rotation.from_quat((1 - blend) * quaternions[0] + blend * nearest, scalar_first=True)
    points = rng.uniform(*GRID.box_m, (40, 3))
    expected = turn.apply(field.sample_n(points).astype(float))
    at = turn.apply(points) + (1 - blend) * shift[0] + blend * shift[1]
    np.testing.assert_allclose(forces(block, a, b, blend, at), expected, atol=5e-6, rtol=0)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e30, -1e308])
@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("is_rotated", [False, True])
def test_an_invalid_position_gives_no_force(bad: float, axis: int, is_rotated: bool) -> None:
    block = Block()
    address = block.field(ForceField.from_dense(GRID, np.ones((*GRID.shape, 3))))
    quaternion = (0.6, 0.8, 0.0, 0.0) if is_rotated else (1.0, 0.0, 0.0, 0.0)
    frame = block.frame([FramePart(address, quaternion, is_identity=not is_rotated)])
    later = block.frame([FramePart(address, (1.0, 0.0, 0.0, 0.0), (0.1, 0.1, 0.1))])
    point = np.zeros(3)
    assert native.force_at(block.memory.bytes, frame, later, 0.0, *point) != (0.0, 0.0, 0.0)
    point[axis] = bad
    for blend in (0.0, 0.5):
        assert native.force_at(block.memory.bytes, frame, later, blend, *point) == (0.0, 0.0, 0.0)
    assert vibration(block, frame, *point) == (0.0, 0.0)


def test_vibration_has_the_frequency_of_the_dominant_corner() -> None:
    grid, block = Grid((4, 4, 4), (0.01, 0.01, 0.02), (0.0, 0.0, 0.0)), Block()
    band = VibrationFrame(
        grid,
        np.array([[1, 1, 1], [1, 1, 2], [2, 1, 1]], np.int32),
        np.array([1.0, 3.0, 2.0], np.float32),
        np.array([80.0, 250.0, 120.0], np.float32),
    )
    frame = block.frame([], vibration_at=block.field(band.as_field()))
    assert vibration(block, frame, 0.01, 0.01, 0.02) == (1.0, 80.0)
    assert vibration(block, frame, 0.01, 0.01, 0.035) == pytest.approx((2.5, 250.0))
    assert vibration(block, frame, 0.018, 0.01, 0.029) == pytest.approx(
        (1.0 * 0.11 + 3 * 0.09 + 2 * 0.44, 120.0)
    )
    assert vibration(block, frame, 0.001, 0.01, 0.02) == pytest.approx((0.1, 80.0))
    nearer = vibration(block, frame, 0.01, 0.01, 0.026)  # 0.7 N of the near corner, 0.9 N of the far one
    assert nearer == pytest.approx((1.6, 250.0))
    equal = vibration(block, frame, 0.01 + 0.01 / 3, 0.01, 0.02)  # 2/3 N of both: the first in raster order
    assert equal == pytest.approx((4 / 3, 80.0))
    assert vibration(block, frame, 0.0, 0.0, 0.0) == (0.0, 0.0)
    assert vibration(block, block.frame([]), 0.01, 0.01, 0.02) == (0.0, 0.0)


def test_a_written_field_can_be_moved() -> None:
    field = some_field(np.random.default_rng(3), GRID)
    pool, memory = CellPool.of(field), Memory.empty(800_000)
    size = field_bytes(pool)
    write_field(memory, 64, pool)
    before = memory.bytes[64 : 64 + size].copy()
    write_field(memory, 6400, pool)
    assert np.array_equal(memory.bytes[6400 : 6400 + size], before)


@settings(max_examples=10)
@given(seeds, st.sampled_from([0.0, 0.3]))
def test_the_strongest_body_is_that_of_the_largest_force(seed: int, blend: float) -> None:
    rng = np.random.default_rng(seed)
    block = Block()
    offsets = [block.field(some_field(rng, GRID)) for _ in range(3)]
    poses = [
        [(q, p) for q, p in zip(Rotation.random(3, random_state=rng).as_quat(), rng.normal(0, 0.03, (3, 3)))]
        for _ in range(2)
    ]
    bodies = [[FramePart(at, q, p) for at, (q, p) in zip(offsets, frame)] for frame in poses]
    frames = [block.frame(parts) for parts in bodies]
    alone = [[block.frame([frame[n]]) for frame in bodies] for n in range(3)]
    points = rng.uniform(*GRID.box_m, (60, 3))
    sizes = [np.linalg.norm(forces(block, *pair, blend, points), axis=1) for pair in alone]
    expected = np.where(np.max(sizes, axis=0) > 0, np.argmax(sizes, axis=0), -1)
    memory = block.memory.bytes
    found = [native.strongest_body(memory, *frames, blend, *p) for p in points.tolist()]
    assert found == expected.tolist()


def test_batches_are_single_queries_in_any_ranges() -> None:
    rng = np.random.default_rng(2)
    block = Block()
    a, b = (block.voxels(some_field(rng, GRID)) for _ in range(2))
    points, blends = rng.uniform(*GRID.box_m, (90, 3)), rng.choice([0.0, 0.3, 1.0], 90)
    points[::9] = np.nan
    out = np.full((90, 3), 7.0, np.float32)
    for start, stop in ((40, 90), (0, 1), (1, 40), (5, 5)):
        native.forces_at(start, stop, block.memory.bytes, a, b, points, blends, out)
    queries = zip(blends.tolist(), points.tolist())
    single = [native.force_at(block.memory.bytes, a, b, blend, *p) for blend, p in queries]
    assert np.array_equal(out, np.array(single, np.float32)) and out.any()


def test_wrong_arguments_are_refused() -> None:
    block = Block(64_000)
    frame = block.frame([])
    memory = block.memory.bytes
    for arguments, error in (
        ((memory, frame, frame, 0.0, 0.0, 0.0), "number of arguments"),
        ((memory, frame, frame + 4, 0.0, 0.0, 0.0, 0.0), "offset"),
        ((memory, -8, frame, 0.0, 0.0, 0.0, 0.0), "offset"),
        ((memory, frame, 64_000, 0.0, 0.0, 0.0, 0.0), "offset"),
        ((memory[4:], frame, frame, 0.0, 0.0, 0.0, 0.0), "offset"),
    ):
        with pytest.raises(ValueError, match=error):
            native.force_at(*arguments)
    with pytest.raises(TypeError):
        native.force_at(memory, frame, frame, 0.0, "0", 0.0, 0.0)
    points, blends, out = np.zeros((3, 3)), np.zeros(1), np.zeros((3, 3), np.float32)
    for wrong in (
        (0, 4, memory, frame, frame, points, blends, out),
        (0, 3, memory, frame, frame, points[:2], blends, out),
        (0, 3, memory, frame, frame, points, np.zeros(2), out),
        (0, 3, memory, frame, frame, points, blends, out[:2]),
        (0, 3, memory, frame, frame, points, blends, out.tobytes()),
    ):
        with pytest.raises(ValueError, match=r"array|range|blends"):
            native.forces_at(*wrong)

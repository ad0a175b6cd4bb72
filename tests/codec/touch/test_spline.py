"""The spline base layer: fit of smooth fields, round trip, and faulty bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from native_model import code_spline, decode_base_layer, fit_spline, lattice_of

from touchfield.codec.touch.base_layer_fit import Nodes, corner_weights
from touchfield.errors import CorruptFile, TouchfieldError, TruncatedFile
from touchfield.medium import ForceField, Grid

GRID = Grid((48, 40, 36), (0.001, 0.0012, 0.0008), (-0.0235, -0.0234, -0.014))


def positions() -> np.ndarray:
    along = (o + s * np.arange(n) for n, s, o in zip(GRID.shape, GRID.spacing_m, GRID.origin_m, strict=True))
    return np.stack(np.meshgrid(*along, indexing="ij"), axis=-1)


def ball(stiffness: float = 500.0, top_n: float = 2.0) -> ForceField:
    """A penalty field of a ball of 12 mm radius."""
    p = positions()
    r = np.linalg.norm(p, axis=-1, keepdims=True)
    forces = np.clip(stiffness * (0.012 - r), 0, top_n) * p / np.maximum(r, 1e-9)
    return ForceField.from_dense(GRID, forces.astype(np.float32))


@pytest.fixture(scope="module")
def coded_ball() -> tuple[ForceField, float, bytes, np.ndarray]:
    frame = ball()
    unit_n, found = lattice_of(frame).unit_n, fit_spline(frame)
    assert found is not None
    return frame, unit_n, found[0], found[1].field(GRID, unit_n).to_dense()


def test_ball_takes_few_bytes_and_is_mostly_within_the_mask(coded_ball):
    frame, _, data, predicted = coded_ball
    forces = frame.to_dense()
    length = np.linalg.norm(forces, axis=-1)
    within = np.linalg.norm(predicted - forces, axis=-1) <= np.maximum(0.05, 0.1 * length)
    assert within[length > 0].mean() > 0.94
    assert within[length == 0].mean() > 0.995
    assert len(data) < 0.05 * frame.support_count


def test_base_layer_error_is_smooth(coded_ball):
    """Along a line below the surface the second differences of the error are far below the mask."""
    frame, _, _, predicted = coded_ball
    error = predicted[30, :, 26] - frame.to_dense()[30, :, 26]
    inside = np.linalg.norm(frame.to_dense()[30, :, 26], axis=-1) > 0.3
    assert inside.sum() > 8
    bends = np.linalg.norm(np.diff(error, 2, axis=0), axis=-1)[inside[1:-1]]
    assert np.median(bends) < 0.02


def test_bytes_decode_to_the_fit(coded_ball):
    _, unit_n, data, predicted = coded_ball
    assert np.array_equal(decode_base_layer(data, GRID).field(GRID, unit_n).to_dense(), predicted)


@pytest.mark.parametrize("shifts", [(3, 2, 4), (5, 5, 5), (2, 4, 3)])
def test_affine_potential_is_exact(shifts):
    """A wall whose potential grows along x, with forces against x; also across cells of a coarse lattice."""
    bricks = np.array([[1, 0, 0], [1, 1, 0], [2, 0, 0], [3, 2, 4]], np.int32)
    nodes = Nodes(bricks, shifts)
    x = (bricks[:, 0, None] * 8 >> shifts[0]) - 1 + np.arange(nodes.per_brick.shape[1])
    values = np.broadcast_to((1000 * (x << shifts[0]) - 9000)[:, :, None, None], nodes.per_brick.shape)
    coefficients = np.zeros(len(nodes.predecessors))
    coefficients[nodes.per_brick] = values
    coded = code_spline(GRID, bricks, (shifts, 1, (1 << 15, 1 << 15, 1 << 15), coefficients))
    assert coded is not None
    data, decoded = coded
    assert np.array_equal(decode_base_layer(data, GRID).vectors, decoded.vectors)
    samples = 8 * bricks[:, 0, None] + np.arange(8)
    assert np.array_equal(decoded.vectors[:, :, 3, 3, 0], -np.clip(1000 * samples - 8500, 0, 1 << 16))
    assert not decoded.vectors[..., 1:].any()
    assert not decoded.vectors[3, :, :, 4:].any()  # beyond the grid


def test_nodes_index_the_previous_nodes():
    bricks = np.array([[0, 0, 0], [5, 0, 9]], np.int32)
    nodes = Nodes(bricks, (3, 3, 3))
    assert nodes.predecessors.shape == (128, 3)
    first, second = nodes.per_brick
    assert not set(first.ravel()) & set(second.ravel())
    assert (nodes.predecessors[first[0, 0, 0]] == -1).all()
    assert nodes.predecessors[first[2, 1, 3]].tolist() == [
        first[at] for at in ((1, 1, 3), (2, 0, 3), (2, 1, 2))
    ]


@pytest.mark.parametrize("shift", [2, 3, 4, 5])
def test_weights_are_those_of_a_cubic_spline(shift):
    """The weights reproduce straight lines and, by its blossom, a cubic."""
    h = 1 << shift
    for index, table in enumerate(corner_weights(shift)):
        nodes = h * np.arange(-1, len(table) - 1)
        corners = 8 * index + np.arange(9)
        assert (table.sum(axis=0) == 6 * h**3).all()
        assert np.array_equal(nodes @ table, 6 * h**3 * corners)
        assert np.array_equal((nodes - h) * nodes * (nodes + h) @ table, 6 * h**3 * corners**3)


@pytest.mark.parametrize("kind", ["noise", "nothing", "one voxel", "a wall of one voxel"])
def test_fields_that_are_not_smooth_have_no_base_layer(kind):
    forces = np.zeros((*GRID.shape, 3), np.float32)
    if kind == "noise":
        forces[...] = np.random.default_rng(1).normal(size=forces.shape)
    elif kind == "one voxel":
        forces[20, 20, 20] = 1
    elif kind == "a wall of one voxel":
        forces[:, :, 17, 2] = 1
    frame = ForceField.from_dense(GRID, forces)
    assert fit_spline(frame) is None


@pytest.mark.parametrize("f0_n", [0.0, 1e-9, 10.0])
def test_any_f0_is_accepted(f0_n):
    frame = ball()
    found = fit_spline(frame, f0_n=f0_n)
    assert (found is None) == (f0_n == 10.0)  # no force exceeds 10 N
    if found is not None:
        assert np.array_equal(decode_base_layer(found[0], GRID).vectors, found[1].vectors)


def test_truncated_bytes_are_refused(coded_ball):
    data = coded_ball[2]
    for size in (*range(13), len(data) // 4):
        with pytest.raises((TruncatedFile, CorruptFile)):
            decode_base_layer(data[:size], GRID)


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_changed_bytes_give_a_field_or_a_named_error(coded_ball, data):
    changed = bytearray(coded_ball[2])
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(1, len(changed) - 1))] = data.draw(st.integers(0, 255))
    try:
        decoded = decode_base_layer(bytes(changed), GRID)
    except TouchfieldError:
        return
    assert np.abs(decoded.vectors).max() <= (1 << 17)
    assert len(decoded.bricks) <= 64 + 16 * len(changed)


def test_distant_bricks_take_little_memory():
    """Two bricks at the far corners of a large grid must not allocate the box around them."""
    grid = Grid((4096, 4096, 4096), (0.001,) * 3, (0.0,) * 3)
    corners = np.array([[0, 0, 0], [511, 511, 511]], np.int32)
    coded = code_spline(grid, corners, ((3, 3, 3), 1, (1, 1, 1), np.zeros(128)))
    assert coded is not None
    assert np.array_equal(decode_base_layer(coded[0], grid, memory_bytes=1 << 22).bricks, corners)


@pytest.mark.parametrize(
    "head", [(1, 2, 2, 9, 9, 9, 9), (2, 2, 6, 9, 9, 9, 9), (2, 2, 2, 0, 9, 9, 9), (2, 2, 2, 9, 9, 9, 0)]
)
def test_a_head_beyond_its_limits_is_refused(coded_ball, head):
    with pytest.raises(CorruptFile, match="bounds"):
        decode_base_layer(b"\0" + bytes(head) + coded_ball[2][10:], GRID)

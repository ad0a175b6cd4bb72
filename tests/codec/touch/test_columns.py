"""The column base layer: fit of height maps along every axis, round trip, and faulty bytes."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from native_model import decode_base_layer, fit_columns as fit, lattice_of

from touchfield.codec.varint import write_varint
from touchfield.errors import CorruptFile, TouchfieldError, TruncatedFile
from touchfield.medium import ForceField, Grid

COLUMNS = b"\1"  # the kind
SHAPE, SPACING_M = (40, 36, 30), (0.001, 0.0012, 0.0008)
GRID = Grid(SHAPE, SPACING_M, (0.0, 0.0, 0.0))


def solid_hill(step: float = 0.0, blurred: bool = False) -> np.ndarray:
    """A hill, solid towards low z, with a step of `step` samples; `blurred` mixes both sides of it."""
    x, y, z = np.meshgrid(*(np.arange(n) for n in SHAPE), indexing="ij")
    height = 12 + 3 * np.sin(x / 9.0) + 2 * np.cos(y / 8.0) + step * (x > 21.5)
    normal = np.stack([-np.cos(x / 9.0) / 3 * 0.8, np.sin(y / 8.0) / 4 * 0.67, np.ones_like(x)], axis=-1)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    force = np.clip(500 * 0.0008 * (height - z), 0, 2.0)[..., None] * normal
    if blurred:
        force[1:-1] = (force[:-2] + 2 * force[1:-1] + force[2:]) / 4
    return force.astype(np.float32)


def permuted_field(forces: np.ndarray, axis: int, inverted: bool) -> ForceField:
    """The field with main axis `axis`, pushing towards larger or (if not `inverted`) smaller indices."""
    order = [*(c for c in range(3) if c != 2), 2]
    order.insert(axis, order.pop())
    out = np.ascontiguousarray(forces.transpose(*order, 3)[..., order])
    if not inverted:
        out = np.flip(out, axis).copy()
        out[..., axis] *= -1
    shape, spacing_m = (tuple(v[c] for c in order) for v in (SHAPE, SPACING_M))
    return ForceField.from_dense(Grid(shape, spacing_m, (0.0, 0.0, 0.0)), out)


def fraction_within_mask(frame: ForceField, data: bytes) -> float:
    """Fraction of forces at which the base layer decoded from `data` is within the mask."""
    forces, unit_n = frame.to_dense(), lattice_of(frame).unit_n
    predicted = decode_base_layer(data, frame.grid).field(frame.grid, unit_n).to_dense()
    length = np.linalg.norm(forces, axis=-1)
    return float(
        (np.linalg.norm(predicted - forces, axis=-1) <= np.maximum(0.05, 0.1 * length))[length > 0].mean()
    )


@pytest.fixture(scope="module")
def coded_hill() -> tuple[ForceField, bytes]:
    frame = permuted_field(solid_hill(), 2, True)
    found = fit(frame)
    assert found is not None
    return frame, found[0]


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_hill_has_a_base_layer_along_every_axis(axis, inverted):
    frame = permuted_field(solid_hill(), axis, inverted)
    found = fit(frame)
    assert found is not None
    data, fitted = found
    decoded = decode_base_layer(data, frame.grid)
    assert np.array_equal(decoded.bricks, fitted.bricks)
    assert np.array_equal(decoded.vectors, fitted.vectors)
    assert fraction_within_mask(frame, data) > 0.95
    assert len(data) < 0.05 * frame.support_count


def test_two_surfaces_predict_a_blurred_step():
    frame = permuted_field(solid_hill(step=9, blurred=True), 2, True)
    found = fit(frame)
    assert found is not None
    assert fraction_within_mask(frame, found[0]) > 0.95


@pytest.mark.parametrize("kind", ["noise", "nothing", "one voxel", "a wall", "a ball"])
def test_fields_that_are_not_solid_have_no_base_layer(kind):
    forces = np.zeros((*SHAPE, 3), np.float32)
    x, y, z = np.meshgrid(*(np.arange(n) - n / 2 for n in SHAPE), indexing="ij")
    if kind == "noise":
        forces[...] = np.random.default_rng(1).normal(size=forces.shape)
    elif kind == "one voxel":
        forces[20, 20, 20] = 1
    elif kind == "a wall":
        forces[:, :, 14:19, 2] = 1
    elif kind == "a ball":
        r = np.sqrt(x * x + y * y + z * z)
        forces[...] = np.where(r < 12, 1 / np.maximum(r, 1), 0)[..., None] * np.stack([x, y, z], axis=-1)
    assert fit(ForceField.from_dense(GRID, forces)) is None


@pytest.mark.parametrize("f0_n", [0.0, 1e-9, 10.0])
def test_any_f0_is_accepted(f0_n):
    frame = permuted_field(solid_hill(), 2, True)
    found = fit(frame, f0_n=f0_n)
    assert (found is None) == (f0_n == 10.0)  # no force exceeds 10 N
    if found is not None:
        assert np.array_equal(decode_base_layer(found[0], frame.grid).vectors, found[1].vectors)


def test_truncated_bytes_are_refused(coded_hill):
    frame, data = coded_hill
    for size in (*range(15), len(data) // 2):
        with pytest.raises((TruncatedFile, CorruptFile)):
            decode_base_layer(data[:size], frame.grid)


@settings(deadline=None, max_examples=60)
@given(data=st.data())
def test_changed_bytes_give_a_field_or_a_named_error(coded_hill, data):
    frame, code = coded_hill
    changed = bytearray(code)
    for _ in range(data.draw(st.integers(1, 4))):
        changed[data.draw(st.integers(1, len(changed) - 1))] = data.draw(st.integers(0, 255))
    try:
        decoded = decode_base_layer(bytes(changed), frame.grid)
    except TouchfieldError:
        return
    assert np.abs(decoded.vectors, dtype=np.int64).max(initial=0) < 1 << 17
    assert len(decoded.bricks) <= 64 + 16 * len(changed)


def test_a_box_of_more_tiles_than_bytes_is_refused():
    grid = Grid((512, 512, 8), (0.001,) * 3, (0.0,) * 3)
    head = b"".join(map(write_varint, (4, 0, 0, 63, 63, *(1,) * 7)))
    with pytest.raises(TruncatedFile, match="tiles"):
        decode_base_layer(COLUMNS + head + bytes(500), grid)


@pytest.mark.parametrize("box", [(5, 0, 0, 0), (4, 0, 1, 0), (0, 4, 0, 1)])
def test_a_box_beyond_the_grid_is_refused(box):
    head = b"".join(map(write_varint, (4, *box, *(1,) * 7)))
    with pytest.raises(CorruptFile):
        decode_base_layer(COLUMNS + head + bytes(50), GRID)


def test_columns_too_deep_are_refused():
    head = COLUMNS + b"".join(map(write_varint, (4, 0, 0, 0, 0, *(1,) * 7)))
    for depth, error, text in (
        (1 << 14, TruncatedFile, "code that ends"),
        ((1 << 14) + 1, CorruptFile, "columns of too many samples"),
    ):
        with pytest.raises(error, match=text):
            decode_base_layer(head + bytes(2000), Grid((8, 8, depth), (0.001,) * 3, (0.0,) * 3))


def test_more_bricks_than_bytes_are_refused():
    """A deep solid takes few bytes; padding zeros raise the number of bricks it may have."""
    forces = np.zeros((8, 8, 8000, 3), np.float32)
    forces[..., 2] = np.clip(0.04 * (7990 - np.arange(8000)), 0, 2)
    frame = ForceField.from_dense(Grid((8, 8, 8000), SPACING_M, (0.0,) * 3), forces)
    found = fit(frame)
    assert found is not None
    assert np.array_equal(decode_base_layer(found[0], frame.grid).vectors, found[1].vectors)
    with pytest.raises(TruncatedFile, match="bricks"):
        decode_base_layer(found[0].rstrip(b"\0"), frame.grid)

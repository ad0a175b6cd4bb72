"""The reference decoder decodes the same base layers from the same bytes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from native_model import COLUMNS, Layer, decode_base_layer, fit_columns, fit_spline
from test_columns import permuted_field, solid_hill
from test_spline import ball

from touchfield.codec.varint import write_varint
from touchfield.errors import TouchfieldError
from touchfield.medium import Grid

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "conformance"))

import decode_touch_base_layer as reference_base_layer
from reading import FaultyFile
from touch_frame import Units


def same_units(decoded: Layer, reference: Units) -> bool:
    assert [tuple(b) for b in decoded.bricks.tolist()] == reference.bricks
    supported = np.argwhere(decoded.vectors.any(axis=-1))
    positions = 8 * decoded.bricks[supported[:, 0]] + supported[:, 1:]
    vectors = {
        tuple(at): decoded.vectors[tuple(n)] for at, n in zip(positions.tolist(), supported, strict=True)
    }
    assert vectors.keys() == reference.vectors.keys()
    return all(np.array_equal(vectors[at], vector) for at, vector in reference.vectors.items())


@pytest.mark.parametrize("stiffness", [300.0, 900.0])
def test_a_spline(stiffness):
    frame = ball(stiffness)
    found = fit_spline(frame)
    assert found is not None
    assert same_units(
        decode_base_layer(found[0], frame.grid), reference_base_layer.spline(found[0][1:], frame.grid.shape)
    )


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_columns(axis, inverted):
    frame = permuted_field(solid_hill(step=9, blurred=True), axis, inverted)
    found = fit_columns(frame)
    assert found is not None
    assert same_units(
        decode_base_layer(found[0], frame.grid), reference_base_layer.columns(found[0][1:], frame.grid.shape)
    )


@pytest.mark.parametrize("seed", range(8))
def test_columns_of_any_bytes(seed):
    """Both decoders agree on random bytes, or both refuse them."""
    random = np.random.default_rng(seed)
    shape = tuple(random.permutation([21, 30, 44]).tolist())
    header = (4, 0, 0, 1, 1, 60000, 5000, 500, 400, 600, 70, 5000)
    data = b"".join(write_varint(int(n)) for n in header) + random.bytes(600)
    try:
        reference = reference_base_layer.columns(data, shape)
    except FaultyFile:
        with pytest.raises(TouchfieldError):
            decode_base_layer(bytes([COLUMNS]) + data, Grid(shape, (0.001,) * 3, (0.0,) * 3))
    else:
        decoded = decode_base_layer(bytes([COLUMNS]) + data, Grid(shape, (0.001,) * 3, (0.0,) * 3))
        assert same_units(decoded, reference)

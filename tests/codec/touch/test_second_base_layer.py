"""The reference decoder decodes the same base layers from the same bytes."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from lattice_makers import lattice_of, limits_of
from test_columns import permuted_field, solid_hill
from test_spline import ball

from touchfield.codec.touch.base_layer import decode_columns, decode_spline
from touchfield.codec.touch.base_layer_fit import fit_columns, fit_spline
from touchfield.codec.touch.lattice import FixedField
from touchfield.codec.varint import write_varint
from touchfield.errors import TouchfieldError
from touchfield.medium import Grid

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "conformance"))

import decode_touch_guess as reference_base_layer
from reading import FaultyFile
from touch_frame import Units


def same_units(decoded: FixedField, reference: Units) -> bool:
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
    found = fit_spline(frame, lattice_of(frame), limits_of(lattice_of(frame)))
    assert found is not None
    assert same_units(
        decode_spline(found[0], frame.grid), reference_base_layer.spline(found[0], frame.grid.shape)
    )


@pytest.mark.parametrize("inverted", [False, True])
@pytest.mark.parametrize("axis", [0, 1, 2])
def test_columns(axis, inverted):
    frame = permuted_field(solid_hill(step=9, blurred=True), axis, inverted)
    found = fit_columns(frame, lattice_of(frame), limits_of(lattice_of(frame)))
    assert found is not None
    assert same_units(
        decode_columns(found[0], frame.grid), reference_base_layer.columns(found[0], frame.grid.shape)
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
            decode_columns(data, Grid(shape, (0.001,) * 3, (0.0,) * 3))
    else:
        assert same_units(decode_columns(data, Grid(shape, (0.001,) * 3, (0.0,) * 3)), reference)

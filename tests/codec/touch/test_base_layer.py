"""The base layer of a frame: the selected kind, and invalid kinds."""

from __future__ import annotations

import numpy as np
import pytest
from native_model import (
    COLUMNS,
    SPLINE,
    Layer,
    decode_base_layer,
    fit_columns,
    fit_spline,
    fraction_within_bound,
    lattice_of,
)
from test_columns import permuted_field, solid_hill
from test_spline import ball

from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, TruncatedFile
from touchfield.medium import ForceField, Grid


def base_layer_of(frame: ForceField) -> bytes:
    """The base layer of a frame in its body, with its kind in front; empty if it has none."""
    body = TouchEncoder(frame.grid, TouchSpec()).encode_segment([frame]).body
    return BodyReader(body, frame.grid, exact=False).records(1)[0].base_layer


@pytest.mark.parametrize(
    ("frame", "kind"),
    [
        (ball(), SPLINE),
        (permuted_field(solid_hill(step=9, blurred=True), 2, True), COLUMNS),
    ],
)
def test_base_layer_kind_of_a_field(frame, kind):
    data = base_layer_of(frame)
    assert data and data[0] == kind
    predicted = decode_base_layer(data, frame.grid).field(frame.grid, lattice_of(frame).unit_n)
    assert fraction_within_bound(frame, predicted, TouchSpec()) > 0.9
    fitted = {SPLINE: [fit_spline(frame, 3), fit_spline(frame, 4)], COLUMNS: [fit_columns(frame)]}[kind]
    assert data in [layer[0] for layer in fitted if layer is not None]


def test_agreement_of_a_base_layer_with_a_field():
    frame = ball()
    lattice = lattice_of(frame)
    exact = np.rint(frame.forces_n / lattice.unit_n).astype(np.int32)
    half = len(frame.bricks) // 2
    counts = (frame.forces_n != 0).any(-1).sum(axis=(1, 2, 3))
    whole = Layer(frame.bricks, exact).field(frame.grid, lattice.unit_n)
    assert fraction_within_bound(frame, whole, TouchSpec()) == 1
    small = np.linalg.norm(frame.forces_n, axis=-1) <= 0.05
    expected = (counts[:half].sum() + (small & (frame.forces_n != 0).any(-1))[half:].sum()) / counts.sum()
    part = Layer(frame.bricks[:half], exact[:half]).field(frame.grid, lattice.unit_n)
    assert fraction_within_bound(frame, part, TouchSpec()) == pytest.approx(expected, abs=1e-3)


def test_inaccurate_base_layer_is_not_used():
    """Random heights: columns fit them, but predict few of the forces."""
    forces = np.zeros((40, 40, 24, 3), np.float32)
    heights = np.random.default_rng(2).uniform(4, 22, (40, 40))
    forces[..., 2] = np.clip(0.4 * (heights[..., None] - np.arange(24)), 0, 2)
    forces += np.random.default_rng(4).normal(scale=0.3, size=forces.shape) * (forces[..., 2:] > 0)
    frame = ForceField.from_dense(Grid((40, 40, 24), (0.001,) * 3, (0.0,) * 3), forces)
    assert fit_columns(frame) is not None
    assert not base_layer_of(frame)


def test_noise_has_no_base_layer():
    frame = ball()
    noise = np.random.default_rng(0).normal(size=frame.forces_n.shape).astype(np.float32)
    rough = ForceField.from_bricks(frame.grid, frame.bricks, noise)
    assert not base_layer_of(rough)


@pytest.mark.parametrize(
    ("data", "error"), [(b"", TruncatedFile), (b"\2abc", CorruptFile), (b"\0", TruncatedFile)]
)
def test_invalid_kinds_are_refused(data, error):
    with pytest.raises(error):
        decode_base_layer(data, ball().grid)


SHAPES_WITH_A_LAYER = {fit_spline: {(300, 9, 2), (17, 16, 15)}, fit_columns: {(17, 16, 15)}}


@pytest.mark.parametrize("provider", [fit_spline, fit_columns])
@pytest.mark.parametrize("shape", [(1, 1, 1), (1, 1, 1000), (300, 9, 2), (17, 16, 15)])
@pytest.mark.parametrize("kind", ["slope", "full", "ramp", "wide", "denormal", "checkers"])
def test_fit_of_any_field_terminates(kind, shape, provider):
    """For any field the fit terminates, and its bytes decode to the fitted layer; only a slope has one."""
    random = np.random.default_rng(3)
    i, j, k = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    forces = np.zeros((*shape, 3), np.float32)
    if kind == "slope":
        forces[..., 2] = 0.15 * np.maximum(0.6 * shape[2] - k, 0)
    elif kind == "full":
        forces[...] = (0.3, -0.2, 1.0)
    elif kind == "ramp":
        forces[..., 2] = np.minimum(k + 0.3 * i + 1, 9)
        forces[..., 0] = 0.3 * forces[..., 2]
    elif kind == "wide":
        forces[...] = 10.0 ** random.uniform(-30, 6, shape)[..., None]
    elif kind == "denormal":
        forces[..., 1] = 1e-42 * (j + k + 1)
    else:
        forces[(i + j + k) % 2 == 0] = 1
    frame = ForceField.from_dense(Grid(shape, (0.001, 0.002, 0.003), (0.0, 0.0, 0.0)), forces)
    for mode in ("mask", "nmse"):
        found = provider(frame, mode=mode)
        assert (found is not None) == (kind == "slope" and shape in SHAPES_WITH_A_LAYER[provider])
        if found is not None:
            decoded = decode_base_layer(found[0], frame.grid)
            assert np.array_equal(decoded.bricks, found[1].bricks)
            assert np.array_equal(decoded.vectors, found[1].vectors)


@pytest.mark.parametrize("provider", [fit_spline, fit_columns])
def test_a_few_bricks_of_a_large_grid_have_no_base_layer(provider):
    grid = Grid((1 << 12,) * 3, (0.001,) * 3, (0.0,) * 3)  # the box of its columns would have 2^18 tiles
    last = (1 << 9) - 1
    forces = np.zeros((3, 8, 8, 8, 3), np.float32)
    forces[..., 2] = np.arange(8) + 1.0
    bricks = np.array([[0, 0, 0], [0, 0, last], [last, last, last]], np.int32)
    assert provider(ForceField.from_bricks(grid, bricks, forces)) is None

"""The quick model names every fault, and its geometry is what its chapter says; for the rest see the light one."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from touchfield.codec.touch.frame_model import Known, Rule
from touchfield.codec.touch.quick_model import QuickModel

from touchfield.codec.touch.lattice import Lattice
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

LATTICE = Lattice(3 / 65536, 1229, 7400, 1229, 7400)


def whole() -> tuple[Known, bytes]:
    """A ball under a penalty law with some noise, coded."""
    grid = Grid((20, 20, 20), (1e-3, 1e-3, 1e-3), (0, 0, 0))
    x = np.stack(np.meshgrid(*(np.arange(20),) * 3, indexing="ij"), -1) - 10.3
    r = np.linalg.norm(x, axis=-1, keepdims=True) + 1e-9
    noise = np.random.default_rng(1).normal(0, 0.1, x.shape)
    forces = np.clip(8 - r, 0, 4) * (0.6 * x / r + noise)
    known = Known(grid, LATTICE)
    return known, QuickModel().encode(ForceField.from_dense(grid, forces.astype(np.float32)), known, RULE).payload


RULE = Rule(0.1, 0.05)


def test_truncated_frames_are_named() -> None:
    known, payload = whole()
    model = QuickModel()
    for size in (*range(60), *range(60, len(payload) - 8, 37)):
        with pytest.raises(FormatError):
            model.decode(payload[:size], known)
    with pytest.raises(TruncatedFile):
        model.decode(payload[: len(payload) // 2], known)
    with pytest.raises(CorruptFile, match="behind the end"):
        model.decode(payload + bytes(9), known)


@pytest.mark.parametrize("scan", [3 | 1 << 5, 0, 4 << 5])
def test_a_scan_that_is_none_is_named(scan: int) -> None:
    known, payload = whole()
    at = 1 + payload[0]
    assert payload[at] & 3 < 3
    with pytest.raises(CorruptFile, match="direction of the scan"):
        QuickModel().decode(payload[:at] + bytes([scan]) + payload[at + 1 :], known)


vectors = st.tuples(*(st.integers(-(1 << 17) + 1, (1 << 17) - 1),) * 3).filter(any)


@given(vectors)
def test_a_direction_and_its_axes_make_the_vector_again(vector: tuple[int, int, int]) -> None:
    from touchfield.codec.kernels.touch_quick_cells import across_axes, direction_of, scaled

    *u, a = direction_of(*map(np.int64, vector))
    length = np.linalg.norm(np.array(vector, np.float64))
    assert a == max(1, int(length))
    again = np.array([scaled(np.int64(c), np.int64(a)) for c in u])
    if length > 100:
        assert np.abs(again - vector).max() <= 3
        h0, h1, h2, k0, k1, k2 = across_axes(*map(np.int64, u))
        frame = np.array([u, (h0, h1, h2), (k0, k1, k2)]) / 65536
        assert np.abs(frame @ frame.T - np.eye(3)).max() < 0.02


@given(st.integers(0, (1 << 18) - 1), st.integers(-40, 40))
def test_steps_lead_up_and_down_a_relative_lattice(a: int, steps: int) -> None:
    from touchfield.codec.kernels.touch_quick_cells import moved
    from touchfield.codec.touch.warp import warp_of

    border, first = warp_of(LATTICE.floor, LATTICE.rate)
    reached = moved(np.int64(a), np.int64(steps), border, first)
    assert -(1 << 18) < reached < 1 << 18
    if steps == 0:
        assert reached == a
    if 0 < a < 1 << 17 and 0 < steps < 3:
        step = max(LATTICE.floor, a * LATTICE.rate >> 16)
        assert 0.9 * step * steps < reached - a < 1.5 * step * steps

"""Measures compared with their definitions."""

from __future__ import annotations

import math

import pytest
from hypothesis import given, strategies as st

from touchfield.codec.segment import BitAccount, compression_ratio
from touchfield.errors import InvalidArgument
from touchfield.measure import fidelity
from touchfield.measure.counts import SymbolCounter
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid


@pytest.mark.parametrize(
    ("counts", "bits"), [([4, 2, 1, 1], 1.75), ([9, 1], 0.468996), ([7], 0.0), ([], 0.0), ([0, 5, 5, 0], 1.0)]
)
def test_plug_in_entropy(counts: list[int], bits: float) -> None:
    assert entropy_bits(counts) == pytest.approx(bits, abs=1e-6)


@given(st.lists(st.integers(0, 15), min_size=1, max_size=200), st.integers(0, 1000))
def test_voxel_and_object_entropy_satisfy_their_identity(symbols: list[int], empty: int) -> None:
    counter = SymbolCounter()
    counter.add(symbols, len(symbols) + empty)
    p = len(symbols) / (len(symbols) + empty)
    assert counter.voxel_bits == pytest.approx(binary_entropy_bits(p) + p * counter.object_bits, abs=1e-9)


def test_fidelity_in_the_three_conventions() -> None:
    grid = Grid((16, 8, 8), (1, 1, 1), (0, 0, 0))
    original = ForceField.from_support(
        grid, [[0, 0, 0], [1, 0, 0], [9, 0, 0]], [[3, 0, 0], [0, 4, 0], [0, 0, 0.01]]
    )
    decoded = ForceField.from_support(
        grid, [[0, 0, 0], [1, 0, 0], [2, 0, 0]], [[3, 0.29, 0], [0, 5, 0], [0.04, 0, 0]]
    )
    meter = FidelityMeter(k=0.1, f0_n=0.05)
    meter.add(original, decoded)
    error2 = 0.29**2 + 1 + 0.01**2 + 0.04**2
    assert meter.nmse_db == pytest.approx(10 * math.log10(error2 / (25 + 0.01**2)), abs=1e-5)
    assert meter.nmse_forensic_db == pytest.approx(2 * meter.nmse_db, abs=1e-9)
    assert meter.nmse_literal_db == pytest.approx(20 * math.log10(1.34 / 7.01), abs=1e-5)
    assert (meter.supported_voxels, meter.compared_voxels) == (3, 4)
    assert meter.mask_violations == 1  # only the second voxel: 1 N against a mask of 0.4 N
    assert meter.mask_violation_share == 0.25
    assert meter.worst_mask_ratio == pytest.approx(2.5)


def test_no_error_has_no_decibels(wavy_field: ForceField) -> None:
    meter = FidelityMeter(k=0.1, f0_n=0.05)
    meter.add(wavy_field, wavy_field)
    assert meter.nmse_db is None and meter.mask_violations == 0 and meter.worst_mask_ratio == 0


def test_invalid_masks_and_shapes_are_refused() -> None:
    x, y = (ForceField.empty(Grid(shape, (1, 1, 1), (0, 0, 0))) for shape in ((8, 9, 10), (9, 8, 10)))
    with pytest.raises(InvalidArgument, match="F_0 > 0"):
        FidelityMeter(0.1, 0.0)
    with pytest.raises(InvalidArgument, match="decoded field: found shape"):
        FidelityMeter(0.0, 0.05).add(x, y)


def test_rate() -> None:
    account = BitAccount(support=10, amplitude=20, direction=30) + BitAccount(side=4)
    assert account.total == 64
    assert compression_ratio(account.total, 2, 4) == pytest.approx(64 / (2 * 4 * 96))


def test_fidelity_sums_over_frames_and_keeps_the_maximum(monkeypatch: pytest.MonkeyPatch) -> None:
    grid = Grid((40, 9, 8), (0.001, 0.002, 0.003), (0, 0, 0))
    positions = [[0, 0, 0], [9, 8, 0], [39, 0, 7]]
    sources = [
        ForceField.from_support(grid, positions, [[1.0, 0, 0], [0, 2.0, 0], [0, 0, size]])
        for size in (3.0, 4.0)
    ]
    errors = [[0.0, 0, 0.05], [0.5, 0, 0], [0, 0, 0]], [[0, 0, 0], [0, 0.1, 0], [0, 0, -1.4]]
    pairs = [
        (field, field + ForceField.from_support(grid, positions, error))
        for field, error in zip(sources, errors, strict=True)
    ]
    for order, bricks in ((pairs, 4096), (pairs[::-1], 4096), (pairs, 1)):
        monkeypatch.setattr(fidelity, "_CHUNK", bricks)  # bricks per chunk
        meter = FidelityMeter(k=0.1, f0_n=0.05)
        for pair in order:
            meter.add(*pair)
        assert meter.worst_mask_ratio == pytest.approx(1.4 / 0.4)
        assert (meter.mask_violations, meter.compared_voxels, meter.supported_voxels) == (2, 6, 6)
        assert meter.mask_violation_share == pytest.approx(2 / 6)
        error2, force2 = 0.05**2 + 0.5**2 + 0.1**2 + 1.4**2, 2 * (1 + 4) + 9 + 16
        assert meter.nmse_db == pytest.approx(10 * math.log10(error2 / force2), abs=1e-5)
        assert meter.nmse_literal_db == pytest.approx(20 * math.log10(2.05 / 13), abs=1e-5)

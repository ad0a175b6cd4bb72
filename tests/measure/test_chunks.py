"""Comparisons with spatial masking, chunk by chunk: the size of a chunk changes no result."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from touchfield.measure import fidelity
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.perception import mask
from touchfield.perception.mask import violations

GRID = Grid((24, 16, 16), (0.01,) * 3, (0.0,) * 3)


def fields() -> tuple[ForceField, ForceField]:
    """Two fields of twelve bricks that differ in each, by more than the mask in some samples."""
    rng = np.random.default_rng(4)
    original = rng.normal(size=(*GRID.shape, 3)).astype(np.float32)
    error = (0.2 * rng.normal(size=original.shape)).astype(np.float32)
    return ForceField.from_dense(GRID, original), ForceField.from_dense(GRID, original + error)


def violations_of_samples() -> Any:
    original, decoded = (field.forces_n.reshape(-1, 3) for field in fields())
    hidden = np.random.default_rng(5).random(len(original))
    return violations(original, decoded, 0.1, 0.01, masking_n=hidden)


def fidelity_of_fields() -> Any:
    meter = FidelityMeter(0.1, 0.01, (0.2, 0.02))
    meter.add(*fields())
    counts = (meter.supported_voxels, meter.compared_voxels, meter.mask_violations)
    return *counts, meter.worst_mask_ratio, round(meter.mask_violation_share, 12)


@pytest.mark.parametrize(
    ("module", "name", "size", "measured"),
    [
        (mask, "_CHUNK", 100, violations_of_samples),
        (fidelity, "_CHUNK", 5, fidelity_of_fields),
    ],
)
def test_the_size_of_a_chunk_changes_no_result(
    monkeypatch: pytest.MonkeyPatch, module: Any, name: str, size: int, measured: Callable[[], Any]
) -> None:
    whole = measured()
    assert getattr(module, name) > 10 * size
    monkeypatch.setattr(module, name, size)
    assert measured() == whole

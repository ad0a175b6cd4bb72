"""The error bound on random fields of every kind: no violations for any options.
``HYPOTHESIS_PROFILE=thorough`` runs 10,000 fields.
"""

from __future__ import annotations

import os

import numpy as np
import pytest
from field_makers import case_of, round_trip

from touchfield.codec.touch.error_bound import compare_frames, masked_error_n
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.perception.mask import violations

ROUNDS, A_ROUND = (100, 100) if os.environ.get("HYPOTHESIS_PROFILE") == "thorough" else (4, 20)


def support_mask(field: ForceField) -> np.ndarray:
    return field.to_dense().any(-1)


def check_bound(frames: list[ForceField], spec: TouchSpec) -> None:
    body, decoder, decoded = round_trip(frames, spec)
    max_ratio = 0.0
    for original, restored in zip(frames, decoded, strict=True):
        hidden_n = masked_error_n(original, spec)
        found = compare_frames(original, restored, spec, hidden_n=hidden_n)
        max_ratio = max(max_ratio, found.max_error_ratio)
        assert not len(found.keys)
        if spec.mode == "mask":
            a, b = (f.to_dense().reshape(-1, 3) for f in (original, restored))
            masking_by_voxel = np.zeros([8 * n for n in original.grid.brick_shape])
            for (x, y, z), brick_masking_n in zip(8 * original.bricks, hidden_n.reshape(-1, 8, 8, 8)):
                masking_by_voxel[x : x + 8, y : y + 8, z : z + 8] = brick_masking_n
            masking_n = masking_by_voxel[tuple(slice(n) for n in original.grid.shape)].reshape(-1)
            assert violations(a, b, spec.k, spec.f0_n, masking_n=masking_n).count == 0
        if spec.support == "exact":
            assert np.array_equal(support_mask(original), support_mask(restored))
    stored = decoder.max_error(body)
    assert stored is not None and max_ratio <= stored.ratio <= min(1.0, max_ratio + 1 / 65535 + 1e-12)


@pytest.mark.parametrize("first", range(ROUNDS))
def test_random_fields_have_no_violations(first: int) -> None:
    for seed in range(first * A_ROUND, (first + 1) * A_ROUND):
        frames, spec = case_of(seed)
        try:
            check_bound(frames, spec)
        except Exception as error:
            error.add_note(f"case_of({seed}): {spec}, grid {frames[0].grid.shape}")
            raise

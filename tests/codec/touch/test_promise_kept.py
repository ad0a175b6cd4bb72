"""The promise on random fields of every kind: no voxel beyond it, whatever is asked for.

``HYPOTHESIS_PROFILE=thorough`` runs 10,000 of them.
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


def held_of(field: ForceField) -> np.ndarray:
    return field.to_dense().any(-1)


def check(frames: list[ForceField], spec: TouchSpec) -> None:
    body, decoder, decoded = round_trip(frames, spec)
    worst = 0.0
    for original, made in zip(frames, decoded, strict=True):
        hidden_n = masked_error_n(original, spec)
        found = compare_frames(original, made, spec, hidden_n=hidden_n)
        worst = max(worst, found.max_error_ratio)
        assert not len(found.keys)
        if spec.mode == "mask":
            a, b = (f.to_dense().reshape(-1, 3) for f in (original, made))
            around = np.zeros([8 * n for n in original.grid.brick_shape])
            for (x, y, z), those in zip(8 * original.bricks, hidden_n.reshape(-1, 8, 8, 8)):
                around[x : x + 8, y : y + 8, z : z + 8] = those
            masking_n = around[tuple(slice(n) for n in original.grid.shape)].reshape(-1)
            assert violations(a, b, spec.k, spec.f0_n, masking_n=masking_n).count == 0
        if spec.support == "exact":
            assert np.array_equal(held_of(original), held_of(made))
    told = decoder.max_error(body)
    assert told is not None and worst <= told.ratio <= min(1.0, worst + 1 / 65535 + 1e-12)


@pytest.mark.parametrize("first", range(ROUNDS))
def test_no_voxel_of_a_random_field_is_beyond_the_promise(first: int) -> None:
    for seed in range(first * A_ROUND, (first + 1) * A_ROUND):
        frames, spec = case_of(seed)
        try:
            check(frames, spec)
        except Exception as error:
            error.add_note(f"case_of({seed}): {spec}, grid {frames[0].grid.shape}")
            raise

"""The error bound on random fields of every kind: no violations for any options.
``HYPOTHESIS_PROFILE=thorough`` runs 10,000 fields.
"""

from __future__ import annotations

import os

import pytest
from bound import error_ratios
from field_makers import case_of, round_trip

from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField

ROUNDS, A_ROUND = (100, 100) if os.environ.get("HYPOTHESIS_PROFILE") == "thorough" else (4, 20)


def check_bound(frames: list[ForceField], spec: TouchSpec) -> None:
    body, decoder, decoded = round_trip(frames, spec)
    ratios = [error_ratios(*fields, spec).max() for fields in zip(frames, decoded, strict=True)]
    assert max(ratios) <= 1 + 1e-12
    stored = decoder.max_error(body)
    assert stored is not None and max(ratios) - 1e-12 <= stored.ratio
    assert stored.ratio <= min(1.0, max(ratios) + 1 / 65535 + 1e-12)


@pytest.mark.parametrize("first", range(ROUNDS))
def test_random_fields_have_no_violations(first: int) -> None:
    for seed in range(first * A_ROUND, (first + 1) * A_ROUND):
        frames, spec = case_of(seed)
        try:
            check_bound(frames, spec)
        except Exception as error:
            error.add_note(f"case_of({seed}): {spec}, grid {frames[0].grid.shape}")
            raise

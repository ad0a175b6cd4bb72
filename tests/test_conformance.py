"""The conformance files decode to what they decoded to when they were written; the faulty ones are refused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from touchfield import errors
from touchfield.job import open_stream

CONFORMANCE = Path(__file__).resolve().parents[1] / "conformance"
FAULTY = json.loads((CONFORMANCE / "faulty" / "errors.json").read_text())


@pytest.mark.parametrize("stream", sorted((CONFORMANCE / "v0").glob("*.touch")), ids=lambda p: p.stem)
def test_golden_streams_decode_exactly(stream: Path) -> None:
    with open_stream(stream) as opened, np.load(stream.with_suffix(".npz")) as expected:
        medium = opened.medium
        assert len(medium) == len(expected["forces_n"])
        np.testing.assert_array_equal(medium.grid.origin_m, expected["origin_m"])
        np.testing.assert_array_equal(medium.grid.spacing_m, expected["spacing_m"])
        for i, frame in enumerate(medium):
            # voxels of objects are interpolated: their symbols are exact, the sums are not the same to the last bit
            slack = 2e-6 if stream.stem.startswith("objects-") else 0.0
            np.testing.assert_allclose(frame.to_dense(), expected["forces_n"][i], rtol=0, atol=slack)


def test_golden_vibration_decodes_exactly() -> None:
    stream = CONFORMANCE / "v0" / "vibration.touch"
    with open_stream(stream) as opened, np.load(stream.with_suffix(".vibration.npz")) as expected:
        band = opened.medium.vibration
        assert band is not None and len(band) == len(expected["amplitudes_n"])
        for i in range(len(band)):
            both = band[i].as_field().to_dense()
            np.testing.assert_array_equal(both[..., 0], expected["amplitudes_n"][i])
            np.testing.assert_array_equal(both[..., 1], expected["frequencies_hz"][i])
        assert [len(band[i]) > 0 for i in range(len(band))] == [True, True, False, False, False, True]


@pytest.mark.parametrize("name", FAULTY)
def test_faulty_streams_are_refused_by_name(name: str) -> None:
    kind = getattr(errors, FAULTY[name])
    with pytest.raises(kind), open_stream(CONFORMANCE / "faulty" / f"{name}.touch") as opened:  # noqa: PT012
        for i, frame in enumerate(opened.medium):
            frame.to_dense()
            if opened.medium.vibration is not None:
                opened.medium.vibration[i]

"""Every golden file decodes to what it decoded to when it was written, by both decoders."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, GOLDEN, decoder

from touchfield.medium import BRICK, ForceField
from touchfield.pipeline.decoding import open_stream

SAMPLE_ATOL_N = 2e-6
"""Of a file of objects, whose voxels are sums of interpolated forces: their order is free."""

Bricks = dict[tuple[int, ...], np.ndarray]


def slack(stream: Path) -> float:
    return SAMPLE_ATOL_N if stream.stem.startswith("objects") else 0.0


def sparse(dense: np.ndarray) -> Bricks:
    """The bricks of a dense field that are not all zero."""
    padded = np.pad(dense, [(0, -n % BRICK) for n in dense.shape[:3]] + [(0, 0)])
    places = {tuple(p) for p in (np.argwhere(padded.any(axis=-1)) // BRICK).tolist()}
    return {p: padded[tuple(slice(BRICK * i, BRICK * i + BRICK) for i in p)] for p in places}


def bricks_of(frame: Any) -> Bricks:
    """A frame as either decoder gives it."""
    if isinstance(frame, np.ndarray):
        return sparse(frame)
    if isinstance(frame, ForceField):
        frame = zip(map(tuple, frame.bricks.tolist()), frame.forces_n)
    return {place: forces for place, forces in dict(frame).items() if forces.any()}


def golden_frames(written: Any, count: int) -> list[Bricks]:
    """The frames as they were written: dense, or as bricks with the frame of each."""
    forces = written["forces_n"]
    if "bricks" not in written:
        return [sparse(dense) for dense in forces]
    places = list(map(tuple, written["bricks"].tolist()))
    return [{places[n]: forces[n] for n in np.flatnonzero(written["frames"] == i)} for i in range(count)]


def assert_alike(ours: Bricks, theirs: Bricks, atol: float) -> None:
    """The same forces; -0 is 0."""
    zeros = np.zeros((BRICK, BRICK, BRICK, 3), np.float32)
    for place in ours.keys() | theirs.keys():
        one, other = ours.get(place, zeros), theirs.get(place, zeros)
        assert one.dtype == other.dtype == np.float32
        np.testing.assert_allclose(one, other, rtol=0, atol=atol, err_msg=f"brick {place}")


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_forces(stream: Path) -> None:
    file = decoder.read_file(stream.read_bytes())
    with open_stream(stream) as opened, np.load(stream.with_suffix(".npz")) as expected:
        assert opened.grid.shape == file.head["grid_shape"]
        assert (
            opened.grid.spacing_m == file.head["spacing_m"] and opened.grid.origin_m == file.head["origin_m"]
        )
        written = golden_frames(expected, file.head["frame_count"])
        for ours, second, golden in zip(opened.medium, decoder.frames_of(file), written, strict=True):
            assert_alike(bricks_of(ours), golden, slack(stream))
            assert_alike(bricks_of(second), golden, slack(stream))


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_vibration(stream: Path) -> None:
    with open_stream(stream) as opened:
        band, found = opened.medium.vibration, decoder.vibration_of(decoder.read_file(stream.read_bytes()))
        if band is None:
            assert found == {}
            return
        with np.load(stream.with_suffix(".vibration.npz")) as expected:
            for name, part in (("amplitudes_n", 0), ("frequencies_hz", 1)):
                ours = np.stack([band(i).as_field().to_dense()[..., part] for i in range(len(opened.medium))])
                np.testing.assert_array_equal(ours, expected[name])
                np.testing.assert_array_equal(found[name], expected[name])


@pytest.mark.skipif(not GOLDEN, reason="there are no golden files: make golden")
def test_every_golden_file_is_one_that_is_made() -> None:
    made = importlib.import_module("make_golden")
    assert {path.stem for path in GOLDEN} == made.FIELDS.keys() | made.SCENES.keys()
    assert {path.name for path in CONFORMANCE.iterdir() if path.is_dir()} - {"__pycache__"} == {
        "v1",
        "faulty",
    }

"""Both decoders reproduce the stored fields of every golden file."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, GOLDEN, decoder

from touchfield.medium import BRICK, ForceField
from touchfield.pipeline.decoding import open_file

SAMPLE_ATOL_N = 2e-6
"""Tolerance for files of objects: voxels are sums of interpolated forces in any order."""

Bricks = dict[tuple[int, ...], np.ndarray]


def slack(stream: Path) -> float:
    return SAMPLE_ATOL_N if stream.stem.startswith("objects") else 0.0


def sparse(dense: np.ndarray) -> Bricks:
    """The bricks of a dense field that are not all zero."""
    padded = np.pad(dense, [(0, -n % BRICK) for n in dense.shape[:3]] + [(0, 0)])
    bricks = {tuple(p) for p in (np.argwhere(padded.any(axis=-1)) // BRICK).tolist()}
    return {p: padded[tuple(slice(BRICK * i, BRICK * i + BRICK) for i in p)] for p in bricks}


def bricks_of(frame: Any) -> Bricks:
    """The bricks of a frame of either decoder."""
    if isinstance(frame, np.ndarray):
        return sparse(frame)
    if isinstance(frame, ForceField):
        frame = zip(map(tuple, frame.bricks.tolist()), frame.forces_n)
    return {brick: forces for brick, forces in dict(frame).items() if forces.any()}


def golden_frames(golden: Any, count: int) -> list[Bricks]:
    """The stored frames: dense, or as bricks with the frame of each."""
    forces = golden["forces_n"]
    if "bricks" not in golden:
        return [sparse(dense) for dense in forces]
    bricks = list(map(tuple, golden["bricks"].tolist()))
    return [{bricks[n]: forces[n] for n in np.flatnonzero(golden["frames"] == i)} for i in range(count)]


def assert_alike(found: Bricks, expected: Bricks, atol: float) -> None:
    """Check equal forces; -0 equals 0."""
    zeros = np.zeros((BRICK, BRICK, BRICK, 3), np.float32)
    for brick in found.keys() | expected.keys():
        found_forces, expected_forces = found.get(brick, zeros), expected.get(brick, zeros)
        assert found_forces.dtype == expected_forces.dtype == np.float32
        np.testing.assert_allclose(found_forces, expected_forces, rtol=0, atol=atol, err_msg=f"brick {brick}")


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_forces(stream: Path) -> None:
    file = decoder.read_file(stream.read_bytes())
    with open_file(stream) as opened, np.load(stream.with_suffix(".npz")) as expected:
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
    with open_file(stream) as opened:
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
def test_golden_files_are_those_of_the_generator() -> None:
    generator = importlib.import_module("make_golden")
    assert {path.stem for path in GOLDEN} == generator.FIELDS.keys() | generator.SCENES.keys()
    folders = {path.name for path in CONFORMANCE.iterdir() if path.is_dir()}
    assert folders - {"__pycache__"} == {"v1", "faulty", "ticks", "queries"}

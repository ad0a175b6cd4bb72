"""The chapter of docs/format.md on frame model 2 is enough: a decoder that follows it gives the same forces."""

from __future__ import annotations

import numpy as np
import pytest

from test_reference_touch import GRID, OTHER, band, box, reference, solid, told_of, whole
from touchfield.codec.touch.body import BodyReader, FrameRecord, GuessKind
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

SMALL = Grid((5, 6, 9), GRID.spacing_m, GRID.origin_m)
LARGER = Grid((9, 8, 9), GRID.spacing_m, GRID.origin_m)


def assert_same(frames: list[ForceField], spec: TouchSpec) -> list[FrameRecord]:
    """Both decoders give the same forces; the records of the segment. Once only: the second decoder is slow."""
    grid = frames[0].grid
    encoder = TouchEncoder(grid, spec)
    body = encoder.encode_segment(frames).body
    ours = TouchDecoder(grid, encoder.parameters).frames(body, len(frames))
    theirs = reference.decode_touch_body(body, len(frames), grid.shape, grid.spacing_m, encoder.parameters)
    for i, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        dense = whole.laid_out(other, grid.shape)
        assert (one.to_dense() + np.float32(0)).tobytes() == (dense + np.float32(0)).tobytes(), f"frame {i}"
    return list(BodyReader(body, grid, lossless=False).records(len(frames)))


@pytest.mark.parametrize(("axis", "sense"), [(0, 1), (1, -1), (2, -1)])
def test_walls_along_each_axis(axis: int, sense: int) -> None:
    """A first frame and one given it, each of which teaches the next."""
    records = assert_same(
        [band(SMALL, 0.3 * t, axis=axis, sense=sense) for t in range(2)], TouchSpec(effort="max", interframe="on")
    )
    assert records[0].model == 2
    assert axis == 0 or [(record.model, record.inter) for record in records] == [(2, False), (2, True)]


@pytest.mark.parametrize("mode", ["mask", "mask-direction", "nmse"])
def test_modes(mode: str) -> None:
    spec = TouchSpec(effort="max", mode=mode, support="exact", f0_n=0.01, step_n=0.02)
    grid = Grid((5, 9, 4), OTHER.spacing_m, OTHER.origin_m)
    assert_same([band(grid, 0.3 * t, noise=0.3, axis=1) for t in range(2)], spec)


def test_moved_blocks_and_copied_bricks() -> None:
    records = assert_same(
        [box(LARGER, t) for t in (0, 1, 1)],
        TouchSpec(effort="max", motion="on", interframe="on", k=0.2),
    )
    assert any(record.guess_kind == GuessKind.MOTION for record in records)
    assert all(record.model == 2 for record in records)


def test_surfaces() -> None:
    records = assert_same(
        [solid(LARGER, 2, -1, 2.0)] * 2,
        TouchSpec(effort="max", surface="on", k=0.2),
    )
    assert records[0].guess_kind == GuessKind.SURFACE
    assert records[0].model == 2


def test_sparse_bricks_with_gaps_and_frames_of_nothing() -> None:
    grid = Grid((23, 17, 25), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
    rng = np.random.default_rng(3)
    frames = []
    for count in (4, 0, 3, 4):
        bricks = np.stack(np.unravel_index(rng.choice(3 * 3 * 4, count, replace=False), (3, 3, 4)), axis=-1)
        dense = np.zeros((24, 24, 32, 3), np.float32)
        for b in bricks * 8:
            held = rng.random((8, 8, 8, 1)) < 0.03
            dense[b[0] : b[0] + 8, b[1] : b[1] + 8, b[2] : b[2] + 8] = held * (rng.normal(size=(8, 8, 8, 3)) + 0.5)
        frames.append(ForceField.from_dense(grid, dense[:23, :17, :25]))
    assert_same(frames, TouchSpec(effort="max", k=0.3, f0_n=0.4, interframe="on"))


def test_damage_is_told_by_both_or_decoded_alike() -> None:
    assert told_of(16, Grid((5, 4, 7), GRID.spacing_m, GRID.origin_m), "max") > 2

"""The voxel pass: two decoders reproduce a frame from any reference, models, and order of the scan."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bound import error_ratios
from field_makers import KINDS, field_of, hills, round_trip
from hypothesis import given, settings, strategies as st

from touchfield.codec.touch.body import BodyReader, FrameRecord, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

sys.path.append(str(Path(__file__).resolve().parents[3] / "conformance"))
second_decoder: Any = importlib.import_module("decode_touch")

SMALL = Grid((10, 9, 7), (0.001, 0.002, 0.0015), (0.0, 0.01, -0.02))
CUBES = Grid((10, 9, 7), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
SPECS = (
    TouchSpec(guess="off", interframe="on"),
    TouchSpec(guess="off", interframe="on", f0_n=0.0, k=0.02),
    TouchSpec(guess="off", interframe="off", support="exact", k=0.25),
    TouchSpec(guess="off", interframe="on", mode="mask-direction"),
    TouchSpec(guess="off", interframe="on", mode="nmse", step_n=0.02),
    TouchSpec(guess="off", interframe="on", mode="nmse", step_n=0.3),
)


def bytes_of(bricks: Any) -> dict[tuple[int, ...], bytes]:
    """Bricks with a nonzero force, as bytes; -0 equals 0."""
    return {tuple(brick): (forces + np.float32(0)).tobytes() for brick, forces in bricks if forces.any()}


def records_of(frames: list[ForceField], spec: TouchSpec) -> list[FrameRecord]:
    """The coded frames of a segment, checked: both decoders give the same forces, within the bound."""
    grid, encoder = frames[0].grid, TouchEncoder(frames[0].grid, spec)
    body = encoder.encode_segment(frames).body
    decoded = list(TouchDecoder(grid, encoder.parameters).frames(body, len(frames)))
    again = second_decoder.decode_segment(body, encoder.parameters, grid.shape, len(frames))
    for original, field, bricks in zip(frames, decoded, again, strict=True):
        assert bytes_of(zip(field.bricks.tolist(), field.forces_n, strict=True)) == bytes_of(bricks.items())
        assert error_ratios(original, field, spec).max() <= 1 + 1e-12
        assert ForceField.from_dense(grid, field.to_dense()) == field  # no sample lies outside the grid
    return BodyReader(body, grid, exact=False).records(len(frames))


@settings(max_examples=12, deadline=None)
@given(st.sampled_from(KINDS), st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(SPECS))
def test_two_decoders_reproduce_the_encoder(first: str, second: str, seed: int, spec: TouchSpec) -> None:
    """Without a reference; with the previous field and its models; with a field of another kind."""
    fields = field_of(first, seed, SMALL), field_of(second, seed, SMALL), field_of(second, seed + 1, SMALL)
    records = records_of(list(fields), spec)
    assert [record.inter for record in records] == [False] + 2 * [spec.interframe == "on"]


@pytest.mark.parametrize("code", [code for code in range(32) if code & 3 < 3])
def test_every_scan_order(code: int) -> None:
    """On partial bricks at the edges of a grid; the order follows the sums of the force along each axis."""
    axes = [code & 3, *(n for n in range(3) if n != code & 3)]
    force = np.zeros(3)
    for n, axis in enumerate(axes):
        force[axis] = (3.0 if n == 0 else 1.0) * (-1 if code >> 2 + n & 1 else 1)
    i, j, k = np.indices(CUBES.shape)
    size = 1 + 0.3 * np.sin(i / 3 + j / 4) + 0.05 * k
    frame = ForceField.from_dense(CUBES, (size[..., None] * force).astype(np.float32))
    sparse = field_of("sparse", 2, CUBES)
    records = records_of([frame, sparse, frame], SPECS[0])
    assert records[0].payload[0] == records[2].payload[0] == code


def test_frame_equal_to_its_reference_costs_almost_nothing() -> None:
    body, _, (first, second) = round_trip([hills(24, 5)] * 2, SPECS[0])
    sizes = [len(record.payload) for record in BodyReader(body, first.grid, exact=False).records(2)]
    assert sizes[1] < 40 < sizes[0] // 10
    assert first == second


def test_models_and_reference_each_reduce_the_size() -> None:
    """What the previous frames taught, and the forces of the previous frame, each make a frame smaller."""
    first, last = (hills(24, 5, 0.1 * i) for i in range(2))
    empty = ForceField.empty(first.grid)

    def last_size(*frames: ForceField) -> int:
        body = round_trip(list(frames), SPECS[0])[0]
        return len(BodyReader(body, first.grid, exact=False).records(len(frames))[-1].payload)

    intra, with_models, with_reference = (
        last_size(last),
        last_size(first, empty, last),
        last_size(first, last),
    )
    assert with_reference < with_models < intra


def decode_payload(payload: bytes) -> list[ForceField]:
    """A frame of `hills` with another payload."""
    body, decoder, (field,) = round_trip([hills(17, 5)], SPECS[0])
    lattice = BodyReader(body, field.grid, exact=False).lattice
    return list(decoder.frames(write_body(lattice, [FrameRecord(False, b"", payload, (0, 0))], None), 1))


@settings(max_examples=60, deadline=None)
@given(st.data())
def test_a_damaged_frame_is_refused_or_is_another(data: st.DataObject) -> None:
    body, _, (original,) = round_trip([hills(17, 5)], SPECS[0])
    damaged = bytearray(BodyReader(body, original.grid, exact=False).records(1)[0].payload)
    for at in data.draw(st.sets(st.integers(0, len(damaged) - 1), min_size=1, max_size=3)):
        damaged[at] ^= data.draw(st.integers(1, 255))
    try:
        (field,) = decode_payload(bytes(damaged))
    except FormatError:
        return
    assert (field.bricks < field.grid.brick_shape).all() and np.isfinite(field.forces_n).all()


def test_invalid_frame_headers_are_refused() -> None:
    with pytest.raises(TruncatedFile, match="end too early"):
        decode_payload(b"")
    for head in (3, 7, 31, 1 << 5, 255):
        with pytest.raises(CorruptFile, match="scan order"):
            decode_payload(bytes([head, 0, 0, 0, 0]))
    with pytest.raises(CorruptFile, match="out of its bounds"):
        decode_payload(b"\0\xff\xff\xff\x7f\0\0\0")

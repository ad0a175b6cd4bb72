"""The voxel pass: the decoder reproduces the encoder's output for any reference and memory."""

from __future__ import annotations

import numpy as np
import pytest
from field_makers import GRID, KINDS, field_of, hills
from hypothesis import given, settings, strategies as st

from touchfield.codec.touch import frame_encoder
from touchfield.codec.touch.error_bound import masked_error_n
from touchfield.codec.touch.frame import Memory, ScanOrder, decode_frame, new_memory
from touchfield.codec.touch.frame_encoder import CodedFrame, encode_frame, lattice_for, limits_for
from touchfield.codec.touch.lattice import FixedField, Lattice
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField

SPECS = (
    TouchSpec(),
    TouchSpec(f0_n=0.0, k=0.02),
    TouchSpec(support="exact", k=0.25),
    TouchSpec(mode="mask-direction"),
    TouchSpec(mode="nmse", step_n=0.02),
    TouchSpec(mode="nmse", step_n=0.3),
)


def same(a: FixedField, b: FixedField) -> bool:
    return np.array_equal(a.bricks, b.bricks) and np.array_equal(a.vectors, b.vectors)


def learnt_alike(a: Memory, b: Memory) -> bool:
    pairs = zip((*a.models, a.weights), (*b.models, b.weights), strict=True)
    return all(np.array_equal(x, y) for x, y in pairs)


def encode_with_lattice(
    frame: ForceField, spec: TouchSpec, reference: FixedField | None, memory: Memory | None = None
) -> tuple[CodedFrame, Lattice]:
    """An encoded frame and its lattice."""
    lattice = lattice_for(spec, 4.0 if np.abs(frame.forces_n).max(initial=0) < 2 else 1e32)
    limits = limits_for(spec, lattice)
    return encode_frame(
        frame, lattice, reference, memory or new_memory(), limits, masked_error_n(frame, spec)
    ), lattice


def check_frame(
    frame: ForceField, spec: TouchSpec, reference: FixedField | None, memory: Memory
) -> tuple[FixedField, Memory]:
    """The decoded frame and the adapted memory; `memory` itself is unchanged."""
    before = memory.copy()
    encoded, lattice = encode_with_lattice(frame, spec, reference, memory)
    decoded = decode_frame(encoded.payload, frame.grid, lattice, reference, before)
    assert same(decoded, encoded.decoded)
    assert learnt_alike(encoded.memory, before)
    assert abs(sum(encoded.bits) - 8 * len(encoded.payload)) < 100 + 1.1 * 8 * len(frame.bricks) / 16
    # no sample outside the grid, and no component outside the range of a vector
    assert np.abs(decoded.vectors).max(initial=0) < 1 << 17
    field = decoded.field(frame.grid, 1.0)
    assert ForceField.from_dense(frame.grid, field.to_dense()) == field
    return decoded, encoded.memory


@settings(max_examples=40)
@given(st.sampled_from(KINDS), st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(SPECS))
def test_decoder_reproduces_the_encoder(first: str, second: str, seed: int, spec: TouchSpec) -> None:
    """Without a reference; with the previous field and its memory; with a field of another kind."""
    before, memory = check_frame(field_of(first, seed), spec, None, new_memory())
    _, memory = check_frame(field_of(second, seed), spec, before, memory)
    check_frame(field_of(second, seed + 1), spec, None, memory)


@pytest.mark.parametrize("code", [code for code in range(32) if code & 3 < 3])
def test_every_scan_order(code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """On partial bricks at the edges of a grid, for every scan order."""
    monkeypatch.setattr(frame_encoder, "_scan_order", lambda *_: ScanOrder(GRID, code))
    before, memory = check_frame(field_of("dense", 1), SPECS[0], None, new_memory())
    check_frame(field_of("sparse", 2), SPECS[0], before, memory)


def test_frame_equal_to_its_reference_costs_almost_nothing() -> None:
    frame = hills(24, 5)
    first, _ = encode_with_lattice(frame, SPECS[0], None)
    again, _ = encode_with_lattice(frame, SPECS[0], first.decoded, first.memory)
    assert len(again.payload) < 40 < len(first.payload) // 10
    assert same(again.decoded, first.decoded)


def test_memory_and_reference_each_reduce_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    """The memory and the forces of the previous frame each make the next one smaller."""
    frames = [hills(24, 5, 0.1 * i) for i in range(2)]
    first, _ = encode_with_lattice(frames[0], SPECS[0], None)
    intra, with_memory, with_reference = (
        len(encode_with_lattice(frames[1], SPECS[0], reference, memory)[0].payload)
        for reference, memory in ((None, None), (None, first.memory), (first.decoded, first.memory))
    )
    assert with_reference < with_memory < intra


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_frame_is_refused_or_is_another(data: st.DataObject) -> None:
    frame = hills(17, 5)
    encoded, lattice = encode_with_lattice(frame, SPECS[0], None)
    damaged = bytearray(encoded.payload)
    for at in data.draw(st.sets(st.integers(0, len(damaged) - 1), min_size=1, max_size=3)):
        damaged[at] ^= data.draw(st.integers(1, 255))
    try:
        decoded = decode_frame(bytes(damaged), frame.grid, lattice, None, new_memory())
    except FormatError:
        return
    assert (decoded.bricks < frame.grid.brick_shape).all() and np.abs(decoded.vectors).max(
        initial=0
    ) < 1 << 17


def test_invalid_frame_headers_are_refused() -> None:
    frame = hills(17, 5)
    context = frame.grid, encode_with_lattice(frame, SPECS[0], None)[1], None, new_memory()
    with pytest.raises(TruncatedFile, match="scan order"):
        decode_frame(b"", *context)
    for head in (3, 7, 31, 1 << 5, 255):
        with pytest.raises(CorruptFile, match="scan order"):
            decode_frame(bytes([head, 0, 0, 0, 0]), *context)
    with pytest.raises(CorruptFile, match="slope"):
        decode_frame(b"\0\xff\xff\xff\x7f\0\0\0", *context)

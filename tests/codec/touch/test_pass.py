"""The pass over a frame: the decoder makes of the bytes what the encoder says that it does, whatever is
known.
"""

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


def coded(
    frame: ForceField, spec: TouchSpec, reference: FixedField | None, memory: Memory | None = None
) -> tuple[CodedFrame, Lattice]:
    """A frame, and its lattice."""
    lattice = lattice_for(spec, 4.0 if np.abs(frame.forces_n).max(initial=0) < 2 else 1e32)
    limits = limits_for(spec, lattice)
    return encode_frame(
        frame, lattice, reference, memory or new_memory(), limits, masked_error_n(frame, spec)
    ), lattice


def check(
    frame: ForceField, spec: TouchSpec, reference: FixedField | None, memory: Memory
) -> tuple[FixedField, Memory]:
    """What is decoded, and learnt; the memory stays as it is."""
    before = memory.copy()
    made, lattice = coded(frame, spec, reference, memory)
    decoded = decode_frame(made.payload, frame.grid, lattice, reference, before)
    assert same(decoded, made.decoded)
    assert learnt_alike(made.memory, before)
    assert abs(sum(made.bits) - 8 * len(made.payload)) < 100 + 1.1 * 8 * len(frame.bricks) / 16
    # nothing beyond the grid, and no component beyond what a vector holds
    assert np.abs(decoded.vectors).max(initial=0) < 1 << 17
    field = decoded.field(frame.grid, 1.0)
    assert ForceField.from_dense(frame.grid, field.to_dense()) == field
    return decoded, made.memory


@settings(max_examples=40)
@given(st.sampled_from(KINDS), st.sampled_from(KINDS), st.integers(0, 999), st.sampled_from(SPECS))
def test_the_decoder_makes_what_the_encoder_says(first: str, second: str, seed: int, spec: TouchSpec) -> None:
    """Alone; given the field before, with what it has taught; given a field of another kind."""
    before, memory = check(field_of(first, seed), spec, None, new_memory())
    _, memory = check(field_of(second, seed), spec, before, memory)
    check(field_of(second, seed + 1), spec, None, memory)


@pytest.mark.parametrize("code", [code for code in range(32) if code & 3 < 3])
def test_every_course(code: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """On partial bricks at the edges of a grid: whatever the course, the bytes make what the encoder says."""
    monkeypatch.setattr(frame_encoder, "_scan_order", lambda *_: ScanOrder(GRID, code))
    before, memory = check(field_of("dense", 1), SPECS[0], None, new_memory())
    check(field_of("sparse", 2), SPECS[0], before, memory)


def test_a_frame_as_the_reference_has_it_takes_next_to_nothing() -> None:
    frame = hills(24, 5)
    first, _ = coded(frame, SPECS[0], None)
    again, _ = coded(frame, SPECS[0], first.decoded, first.memory)
    assert len(again.payload) < 40 < len(first.payload) // 10
    assert same(again.decoded, first.decoded)


def test_each_half_pays(monkeypatch: pytest.MonkeyPatch) -> None:
    """What a frame has taught, and its forces, each make the next one smaller."""
    frames = [hills(24, 5, 0.1 * i) for i in range(2)]
    first, _ = coded(frames[0], SPECS[0], None)
    alone, taught, given_it = (
        len(coded(frames[1], SPECS[0], reference, memory)[0].payload)
        for reference, memory in ((None, None), (None, first.memory), (first.decoded, first.memory))
    )
    assert given_it < taught < alone


@settings(max_examples=60)
@given(st.data())
def test_a_damaged_frame_is_refused_or_is_another(data: st.DataObject) -> None:
    frame = hills(17, 5)
    made, lattice = coded(frame, SPECS[0], None)
    bad = bytearray(made.payload)
    for at in data.draw(st.sets(st.integers(0, len(bad) - 1), min_size=1, max_size=3)):
        bad[at] ^= data.draw(st.integers(1, 255))
    try:
        decoded = decode_frame(bytes(bad), frame.grid, lattice, None, new_memory())
    except FormatError:
        return
    assert (decoded.bricks < frame.grid.brick_shape).all() and np.abs(decoded.vectors).max(
        initial=0
    ) < 1 << 17


def test_what_no_frame_begins_with() -> None:
    frame = hills(17, 5)
    known = frame.grid, coded(frame, SPECS[0], None)[1], None, new_memory()
    with pytest.raises(TruncatedFile, match="scan order"):
        decode_frame(b"", *known)
    for head in (3, 7, 31, 1 << 5, 255):
        with pytest.raises(CorruptFile, match="scan order"):
            decode_frame(bytes([head, 0, 0, 0, 0]), *known)
    with pytest.raises(CorruptFile, match="slope"):
        decode_frame(b"\0\xff\xff\xff\x7f\0\0\0", *known)

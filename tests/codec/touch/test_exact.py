"""The exact mode: the same bits back whatever the field, small where it repeats, and every fault named."""

from __future__ import annotations

import contextlib
import lzma
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.exact import decode_exact
from touchfield.codec.touch.exact_encoder import encode_exact
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, Grid

sys.path.insert(0, str(Path(__file__).parents[3] / "conformance"))
from decode_touch_exact import decode_exact as decode_again

ODD = np.array([0x80000000, 1, 0x80000001, 0x007FFFFF, 0x7F7FFFFF, 0xFF7FFFFF, 0, 0x3F800000], np.uint32)


def grid_of(*shape: int) -> Grid:
    return Grid(shape, (1e-3, 1e-3, 1e-3), (0, 0, 0))


def field_of(bits: np.ndarray) -> ForceField:
    """A field of dense float32 bits [nx, ny, nz, 3]; bricks of nothing but -0.0 stay."""
    shape = bits.shape[:3]
    bx, by, bz = (-(-n // 8) for n in shape)
    whole = np.zeros((8 * bx, 8 * by, 8 * bz, 3), np.uint32)
    whole[: shape[0], : shape[1], : shape[2]] = bits
    tiled = whole.reshape(bx, 8, by, 8, bz, 8, 3).transpose(0, 2, 4, 1, 3, 5, 6)
    bricks = np.argwhere(tiled.any(axis=(3, 4, 5, 6))).astype(np.int32)
    forces = np.ascontiguousarray(tiled[tuple(bricks.T)]).view(np.float32)
    return ForceField(grid_of(*shape), bricks, forces)


def bits_by_brick(field: ForceField) -> dict[tuple[int, ...], bytes]:
    return {tuple(b.tolist()): f.tobytes() for b, f in zip(field.bricks, field.forces_n) if f.view(np.uint32).any()}


def coded(frame: ForceField, previous: ForceField | None = None) -> bytes:
    """The payload, which decodes to the same bits, and whose shares are what it is long."""
    payload, bits = encode_exact(frame, previous)
    assert bits_by_brick(decode_exact(payload, frame.grid, previous)) == bits_by_brick(frame)
    assert sum(bits) == pytest.approx(8 * len(payload), abs=1e-6) and min(bits) >= -1e-6
    return payload


@st.composite
def fields(draw: st.DrawFn, shape: tuple[int, int, int] | None = None) -> ForceField:
    """Fields of every kind of palette, -0.0, denormals and the largest floats among them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = shape or draw(st.tuples(st.integers(1, 17), st.integers(1, 9), st.integers(1, 25)))
    kind = draw(st.sampled_from(["odd", "noise", "uniform", "vectors", "products", "constant", "none"]))
    held = rng.random(shape) < draw(st.sampled_from([0.01, 0.3, 1.0]))
    if kind == "odd":
        bits = rng.choice(ODD, (*shape, 3))
    elif kind == "noise":
        bits = rng.integers(0, 0x7F800000, (*shape, 3), np.uint32) | rng.integers(0, 2, (*shape, 3), np.uint32) << 31
    elif kind == "uniform":
        bits = (np.round(rng.normal(size=(*shape, 3))) * 0.3).astype(np.float32).view(np.uint32)
    elif kind == "vectors":
        bits = rng.normal(size=(9, 3)).astype(np.float32)[rng.integers(0, 9, shape)].view(np.uint32)
    elif kind == "products":
        levels = np.sort(rng.random(7).astype(np.float32))[rng.integers(0, 7, shape), None]
        bits = (levels * Codebook.get("ico2").vertices_float32[rng.integers(0, 42, shape)]).view(np.uint32)
    else:
        bits = np.full((*shape, 3), ODD[5] if kind == "constant" else 0, np.uint32)
    return field_of(np.where(held[..., None], bits, np.uint32(0)))


@given(fields())
@settings(max_examples=40)
def test_every_field_comes_back_to_the_bit(field):
    payload = coded(field)
    assert encode_exact(decode_exact(payload, field.grid, None), None)[0] == payload
    assert len(payload) < 12.5 * field.forces_n.view(np.uint32).any(axis=-1).sum() + 140 * len(field.bricks) + 8


@given(st.data())
@settings(max_examples=20)
def test_frame_before_may_be_anything(data):
    shape = data.draw(st.tuples(st.integers(1, 17), st.integers(1, 9), st.integers(1, 17)))
    coded(data.draw(fields(shape)), data.draw(fields(shape)))


@given(st.data())
@settings(max_examples=6)
def test_second_decoder_reads_the_same(data):
    shape = data.draw(st.tuples(st.integers(1, 10), st.integers(1, 9), st.integers(1, 9)))
    before, field = data.draw(fields(shape)), data.draw(fields(shape))
    for previous in (None, before):
        known = previous and {tuple(b.tolist()): np.array(f) for b, f in zip(previous.bricks, previous.forces_n)}
        read = decode_again(encode_exact(field, previous)[0], shape, known)
        assert {b: f.tobytes() for b, f in read.items()} == bits_by_brick(field)


def test_empty_bricks_of_the_frame_before_are_not_known(wavy_field):
    """The decoder's frame before has none, for they are not told."""
    bricks = np.argwhere(np.ones(wavy_field.grid.brick_shape)).astype(np.int32)
    before = ForceField(wavy_field.grid, bricks, wavy_field.forces_at(np.arange(len(bricks))))
    assert len(before.bricks) > len(wavy_field.bricks)
    assert encode_exact(wavy_field, before) == encode_exact(wavy_field, wavy_field)


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(value):
    forces = np.zeros((1, 8, 8, 8, 3), np.float32)
    forces[0, 0, 0, 0] = value
    with pytest.raises(InvalidArgument, match="not finite"):
        encode_exact(ForceField(grid_of(8, 8, 8), np.zeros((1, 3), np.int32), forces), None)


def test_frame_before_must_have_the_grid(wavy_field):
    with pytest.raises(InvalidArgument, match="frame before"):
        encode_exact(wavy_field, ForceField.empty(grid_of(8, 8, 8)))


# -- size -------------------------------------------------------------------------------------------------


def paper_frames(field: ForceField, count: int = 1) -> tuple[list[ForceField], int]:
    """What coder `paper` makes of a field, frame by frame, and the bytes of its segment."""
    encoder = PaperEncoder(field.grid, PaperSpec(deadband="none", interframe="none"))
    body = encoder.encode_segment([field] * count).body
    return list(PaperDecoder(field.grid, encoder.parameters).frames(body, count)), len(body)


def test_field_of_coder_paper_is_smaller_than_its_own_file_and_xz(wavy_field):
    (decoded,), size = paper_frames(wavy_field)
    payload = coded(decoded)
    assert len(payload) < size
    assert 2 * len(payload) < len(lzma.compress(decoded.vectors_n().T.tobytes(), preset=9))


def test_frame_like_the_one_before_costs_next_to_nothing(wavy_field):
    (decoded, again), _ = paper_frames(wavy_field, 2)
    assert 5 * len(coded(again, decoded)) < len(coded(decoded))


def test_few_distinct_forces_cost_little(wavy_field):
    steps = ForceField.from_bricks(wavy_field.grid, wavy_field.bricks, np.round(wavy_field.forces_n * 8) / 8)
    constant = ForceField.from_dense(grid_of(32, 32, 32), np.full((32, 32, 32, 3), np.float32(0.3)))
    assert 15 * len(coded(steps)) < len(coded(wavy_field))
    assert len(coded(constant)) < 40


# -- faults -----------------------------------------------------------------------------------------------


def test_cut_payload_is_named_or_another_field():
    """A code that ends early may be all of another field's: only its end tells, and a container's check."""
    rng = np.random.default_rng(4)
    field = field_of(rng.choice(ODD, (8, 8, 8, 3)) * (rng.random((8, 8, 8, 1)) < 0.1).astype(np.uint32))
    payload, silent = coded(field), 0
    for size in range(len(payload)):
        with contextlib.suppress(TruncatedFile, CorruptFile):
            silent += (
                1 + (bits_by_brick(decode_exact(payload[:size], field.grid, None)) == bits_by_brick(field)) * 1000
            )
    assert silent < len(payload) / 3
    with pytest.raises(CorruptFile):
        decode_exact(payload + bytes(9), field.grid, None)


@given(fields((9, 8, 16)), st.lists(st.tuples(st.integers(0, 4000), st.integers(0, 255)), min_size=1, max_size=4))
@settings(max_examples=40)
def test_changed_payload_is_named_or_another_field(field, changes):
    payload = bytearray(encode_exact(field, None)[0])
    for place, byte in changes:
        payload[place % len(payload)] = byte
    with contextlib.suppress(FormatError):
        assert np.isfinite(decode_exact(bytes(payload), field.grid, field).forces_n).all()


@given(st.binary(max_size=200), st.integers(0, 23))
@settings(max_examples=40)
def test_strange_bytes_are_named_and_take_little_memory(tail, table):
    grid = grid_of(1 << 20, 1 << 20, 1 << 20)
    tracemalloc.start()
    with contextlib.suppress(FormatError):
        decode_exact(bytes([table]) + tail, grid, None)
    assert tracemalloc.get_traced_memory()[1] < (24 << 20) + (64 + 16 * len(tail)) * 40_000
    tracemalloc.stop()

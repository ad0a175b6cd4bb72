"""The exact mode: the same bits back whatever the field, small where it repeats, and every fault named."""

from __future__ import annotations

import contextlib
import lzma
import sys
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.encoder import encode_exact
from touchfield.codec.touch.frame import decode_exact
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

sys.path.insert(0, str(Path(__file__).parents[3] / "conformance"))
from decode_touch_exact import decode_exact as decode_again
from reading import in_bricks

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
    return {
        tuple(b.tolist()): f.tobytes()
        for b, f in zip(field.bricks, field.forces_n)
        if f.view(np.uint32).any()
    }


def coded(*frames: ForceField) -> list[bytes]:
    """The payloads, which decode to the same bits, and whose shares are what they are long."""
    made, known = list(encode_exact(frames)), None
    for frame, (payload, bits) in zip(frames, made, strict=True):
        known = decode_exact(payload, frame.grid, known)
        assert bits_by_brick(known.field) == bits_by_brick(frame)
        assert sum(bits) == pytest.approx(8 * len(payload), abs=1e-6) and min(bits) >= -1e-6
    return [payload for payload, _ in made]


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
        bits = (
            rng.integers(0, 0x7F800000, (*shape, 3), np.uint32)
            | rng.integers(0, 2, (*shape, 3), np.uint32) << 31
        )
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
    (payload,) = coded(field)
    assert coded(decode_exact(payload, field.grid, None).field) == [payload]
    assert (
        len(payload) < 12.7 * field.forces_n.view(np.uint32).any(axis=-1).sum() + 140 * len(field.bricks) + 8
    )


@given(st.data())
@settings(max_examples=20)
def test_frame_before_may_be_anything(data):
    shape = data.draw(st.tuples(st.integers(1, 17), st.integers(1, 9), st.integers(1, 17)))
    coded(data.draw(fields(shape)), data.draw(fields(shape)), data.draw(fields(shape)))


def second(payloads: list[bytes], shape: tuple[int, int, int]) -> list[dict[tuple[int, ...], bytes]]:
    """The frames as the second decoder reads them."""
    known, out = None, []
    for payload in payloads:
        known = decode_again(payload, shape, known)
        out.append({b: f.tobytes() for b, f in in_bricks(known.forces).items()})
    return out


@given(st.data())
@settings(max_examples=6)
def test_second_decoder_reads_the_same(data):
    shape = data.draw(st.tuples(st.integers(1, 10), st.integers(1, 9), st.integers(1, 9)))
    frames = [data.draw(fields(shape)) for _ in range(2)]
    assert second([p for p, _ in encode_exact(frames)], shape) == [bits_by_brick(f) for f in frames]


def test_levels_and_directions_are_found_and_left_where_they_no_longer_do(wavy_field):
    """Frames of products share one palette; a frame of others behind them is told as components."""
    (decoded,), _ = paper_frames(wavy_field)
    books = [payload[0] for payload in coded(decoded, decoded)]
    assert books[0] == books[1] > 0
    assert [payload[0] for payload in coded(decoded, wavy_field, decoded)] == [books[0], 0, 0]
    assert [payload[0] for payload in coded(wavy_field, decoded)] == [0, 0]


def test_second_decoder_follows_from_products_to_components():
    rng = np.random.default_rng(5)
    places = rng.integers(0, 252, (9, 6, 10))
    products = (
        np.float32([0.1, 0.7, 2.5])[places % 3, None] * Codebook.get("ico5").vertices_float32[places]
    ).view(np.uint32)
    frames = [field_of(products), field_of(products[::-1]), field_of(products ^ 1), field_of(products)]
    payloads = coded(*frames)
    assert [p[0] for p in payloads] == [5, 0, 0, 0] and [p[0] for p in coded(*frames[:2])] == [5, 5]
    for told in (payloads, coded(*frames[:2])):
        assert second(told, (9, 6, 10)) == [bits_by_brick(f) for f in frames[: len(told)]]


def test_empty_bricks_of_the_frame_before_are_not_known(wavy_field):
    """The decoder's frame before has none, for they are not told."""
    bricks = np.argwhere(np.ones(wavy_field.grid.brick_shape)).astype(np.int32)
    before = ForceField(wavy_field.grid, bricks, wavy_field.forces_at(np.arange(len(bricks))))
    assert len(before.bricks) > len(wavy_field.bricks)
    assert coded(before, wavy_field) == coded(wavy_field, wavy_field)


# -- size --------------------------------------------------------------------------------------------------


def paper_frames(field: ForceField, count: int = 1) -> tuple[list[ForceField], int]:
    """What coder `paper` makes of a field, frame by frame, and the bytes of its segment."""
    encoder = PaperEncoder(field.grid, PaperSpec(deadband="none", interframe="none"))
    body = encoder.encode_segment([field] * count).body
    return list(PaperDecoder(field.grid, encoder.parameters).frames(body, count)), len(body)


def test_field_of_coder_paper_is_smaller_than_its_own_file_and_xz(wavy_field):
    (decoded,), size = paper_frames(wavy_field)
    (payload,) = coded(decoded)
    assert len(payload) < size
    assert 2 * len(payload) < len(lzma.compress(decoded.vectors_n().T.tobytes(), preset=9))


def test_frame_like_the_one_before_costs_next_to_nothing(wavy_field):
    (decoded, again), _ = paper_frames(wavy_field, 2)
    first, second = coded(decoded, again)
    assert 8 * len(second) < len(first)


def test_few_distinct_forces_cost_little(wavy_field):
    steps = ForceField.from_bricks(wavy_field.grid, wavy_field.bricks, np.round(wavy_field.forces_n * 8) / 8)
    constant = ForceField.from_dense(grid_of(32, 32, 32), np.full((32, 32, 32, 3), np.float32(0.3)))
    assert 10 * len(coded(steps)[0]) < len(coded(wavy_field)[0])
    assert len(coded(constant)[0]) < 60


# -- faults ------------------------------------------------------------------------------------------------


def test_cut_payload_is_named_or_another_field():
    """A code that ends early may be all of another field's: only its end tells, and a container's check."""
    rng = np.random.default_rng(4)
    field = field_of(rng.choice(ODD, (8, 8, 8, 3)) * (rng.random((8, 8, 8, 1)) < 0.1).astype(np.uint32))
    (payload,), silent = coded(field), 0
    for size in range(len(payload)):
        with contextlib.suppress(TruncatedFile, CorruptFile):
            read = decode_exact(payload[:size], field.grid, None).field
            silent += 1 + 1000 * (bits_by_brick(read) == bits_by_brick(field))
    assert silent < len(payload) / 3
    with pytest.raises(CorruptFile):
        decode_exact(payload + bytes(9), field.grid, None)


@given(st.data(), st.lists(st.tuples(st.integers(0, 4000), st.integers(0, 255)), min_size=1, max_size=4))
@settings(max_examples=40)
def test_changed_payload_is_named_or_another_field(data, changes):
    frames = [data.draw(fields((9, 8, 16))) for _ in range(2)]
    payloads = [bytearray(payload) for payload, _ in encode_exact(frames)]
    for place, byte in changes:
        payloads[place % 2][place // 2 % len(payloads[place % 2])] = byte
    known = None
    with contextlib.suppress(FormatError):
        for payload in payloads:
            known = decode_exact(bytes(payload), frames[0].grid, known)
            assert np.isfinite(known.field.forces_n).all()


def test_palettes_that_there_are_not_are_named():
    field = field_of(np.full((3, 3, 3, 3), ODD[-1]))
    ((payload, _),) = encode_exact([field])
    assert payload[0] != 5
    known = decode_exact(payload, field.grid, None)
    nan = np.float32([1, np.nan]).tobytes()
    for data, before in (
        (b"\x1a\1\0" + bytes(4), None),
        (b"\5\0\0", None),
        (b"\5\2\0" + nan, None),
        (b"\5", known),
    ):
        with pytest.raises(CorruptFile, match="codebook"):
            decode_exact(data, field.grid, before)
    for data in (b"", b"\5\1", b"\5\1\0\0"):
        with pytest.raises(TruncatedFile, match="palette"):
            decode_exact(data, field.grid, None)


@given(st.binary(max_size=200), st.sampled_from([b"\0", b"\5\1\0\0\0\0\x3f", b"\x14\2\0\0\0\0\0\0\0\0\x3f"]))
@settings(max_examples=40)
def test_strange_bytes_are_named_and_take_little_memory(tail, head):
    grid = grid_of(1 << 20, 1 << 20, 1 << 20)
    Codebook.get("ico20")
    tracemalloc.start()
    with contextlib.suppress(FormatError):
        decode_exact(head + tail, grid, None)
    assert tracemalloc.get_traced_memory()[1] < (24 << 20) + (64 + 16 * len(tail)) * 40_000
    tracemalloc.stop()

"""The exact mode: bit-exact round trip, size of repetitive fields, and named errors."""

from __future__ import annotations

import contextlib
import lzma
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.body import BodyReader, FrameRecord, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

sys.path.insert(0, str(Path(__file__).parents[3] / "conformance"))
from decode_touch_exact import decode_exact as decode_again
from reading import in_bricks

SPEC = TouchSpec(mode="lossless")
ODD = np.array([0x80000000, 1, 0x80000001, 0x007FFFFF, 0x7AFFFFFF, 0xFAFFFFFF, 0, 0x3F800000], np.uint32)


def grid_of(*shape: int) -> Grid:
    return Grid(shape, (1e-3, 1e-3, 1e-3), (0, 0, 0))


def field_of(bits: np.ndarray) -> ForceField:
    """A field from dense float32 bits [nx, ny, nz, 3]; bricks that hold only -0.0 are included."""
    shape = bits.shape[:3]
    bx, by, bz = (-(-n // 8) for n in shape)
    padded = np.zeros((8 * bx, 8 * by, 8 * bz, 3), np.uint32)
    padded[: shape[0], : shape[1], : shape[2]] = bits
    tiled = padded.reshape(bx, 8, by, 8, bz, 8, 3).transpose(0, 2, 4, 1, 3, 5, 6)
    bricks = np.argwhere(tiled.any(axis=(3, 4, 5, 6))).astype(np.int32)
    forces = np.ascontiguousarray(tiled[tuple(bricks.T)]).view(np.float32)
    return ForceField(grid_of(*shape), bricks, forces)


def bits_by_brick(field: ForceField) -> dict[tuple[int, ...], bytes]:
    return {
        tuple(b.tolist()): f.tobytes()
        for b, f in zip(field.bricks, field.forces_n)
        if f.view(np.uint32).any()
    }


def encode_exact(frames: Sequence[ForceField]) -> list[bytes]:
    """The payloads of a segment in mode "lossless"."""
    segment = TouchEncoder(frames[0].grid, SPEC).encode_segment(frames)
    records = BodyReader(segment.body, frames[0].grid, exact=True).records(len(frames))
    assert [record.inter for record in records] == [i > 0 for i in range(len(frames))]
    assert [frame.supported for frame in segment.frames] == [f.support_count for f in frames]
    return [record.payload for record in records]


def decode_exact(payloads: Sequence[bytes], grid: Grid) -> Iterator[ForceField]:
    """Decode the payloads of a segment."""
    records = [FrameRecord(i > 0, b"", payload, (0, 0)) for i, payload in enumerate(payloads)]
    decoder = TouchDecoder(grid, TouchEncoder(grid, SPEC).parameters)
    return decoder.frames(write_body(None, records, None), len(records))


def encode_checked(*frames: ForceField) -> list[bytes]:
    """The payloads, checked to decode to the same bits."""
    payloads = encode_exact(frames)
    for frame, decoded in zip(frames, decode_exact(payloads, frames[0].grid), strict=True):
        assert bits_by_brick(decoded) == bits_by_brick(frame)
    return payloads


@st.composite
def fields(draw: st.DrawFn, shape: tuple[int, int, int] | None = None) -> ForceField:
    """Fields with every kind of palette, -0.0, denormals, and lengths up to almost 2^120 N."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = shape or draw(st.tuples(st.integers(1, 17), st.integers(1, 9), st.integers(1, 25)))
    kind = draw(st.sampled_from(["odd", "noise", "uniform", "vectors", "products", "constant", "none"]))
    supported = rng.random(shape) < draw(st.sampled_from([0.01, 0.3, 1.0]))
    if kind == "odd":
        bits = rng.choice(ODD, (*shape, 3))
    elif kind == "noise":
        bits = (
            rng.integers(0, 0x7B000000, (*shape, 3), np.uint32)
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
    return field_of(np.where(supported[..., None], bits, np.uint32(0)))


@given(fields())
@settings(max_examples=40)
def test_every_field_round_trip_is_exact(field):
    (payload,) = encode_checked(field)
    assert encode_checked(*decode_exact([payload], field.grid)) == [payload]
    assert (
        len(payload) < 12.7 * field.forces_n.view(np.uint32).any(axis=-1).sum() + 140 * len(field.bricks) + 8
    )


@given(st.data())
@settings(max_examples=20)
def test_previous_frame_may_be_any_field(data):
    shape = data.draw(st.tuples(st.integers(1, 17), st.integers(1, 9), st.integers(1, 17)))
    encode_checked(data.draw(fields(shape)), data.draw(fields(shape)), data.draw(fields(shape)))


def decode_reference(
    payloads: list[bytes], shape: tuple[int, int, int]
) -> list[dict[tuple[int, ...], bytes]]:
    """The frames as the reference decoder reads them."""
    state, out = None, []
    for payload in payloads:
        state = decode_again(payload, shape, state)
        out.append({b: f.tobytes() for b, f in in_bricks(state.forces).items()})
    return out


@given(st.data())
@settings(max_examples=6)
def test_reference_decoder_agrees(data):
    shape = data.draw(st.tuples(st.integers(1, 10), st.integers(1, 9), st.integers(1, 9)))
    frames = [data.draw(fields(shape)) for _ in range(2)]
    assert decode_reference(encode_exact(frames), shape) == [bits_by_brick(f) for f in frames]


def test_levels_and_directions_are_detected_and_dropped(wavy_field):
    """Frames of products share a palette; a following frame of other forces is coded by components."""
    (decoded,), _ = paper_frames(wavy_field)
    books = [payload[0] for payload in encode_checked(decoded, decoded)]
    assert books[0] == books[1] > 0
    assert [payload[0] for payload in encode_checked(decoded, wavy_field, decoded)] == [books[0], 0, 0]
    assert [payload[0] for payload in encode_checked(wavy_field, decoded)] == [0, 0]


def test_reference_decoder_switches_from_products_to_components():
    rng = np.random.default_rng(5)
    palette_indices = rng.integers(0, 252, (9, 6, 10))
    products = (
        np.float32([0.1, 0.7, 2.5])[palette_indices % 3, None]
        * Codebook.get("ico5").vertices_float32[palette_indices]
    ).view(np.uint32)
    frames = [field_of(products), field_of(products[::-1]), field_of(products ^ 1), field_of(products)]
    payloads = encode_checked(*frames)
    assert [p[0] for p in payloads] == [5, 0, 0, 0] and [p[0] for p in encode_checked(*frames[:2])] == [5, 5]
    for sequence in (payloads, encode_checked(*frames[:2])):
        assert decode_reference(sequence, (9, 6, 10)) == [bits_by_brick(f) for f in frames[: len(sequence)]]


def test_empty_bricks_of_the_previous_frame_are_ignored(wavy_field):
    """The decoder's previous frame has no empty bricks, as they are not coded."""
    bricks = np.argwhere(np.ones(wavy_field.grid.brick_shape)).astype(np.int32)
    before = ForceField(wavy_field.grid, bricks, wavy_field.forces_at(np.arange(len(bricks))))
    assert len(before.bricks) > len(wavy_field.bricks)
    assert encode_checked(before, wavy_field) == encode_checked(wavy_field, wavy_field)


# -- size --------------------------------------------------------------------------------------------------


def paper_frames(field: ForceField, count: int = 1) -> tuple[list[ForceField], int]:
    """The decoded frames of coder `paper`, and the size of their segment in bytes."""
    encoder = PaperEncoder(field.grid, PaperSpec(deadband="none", interframe="none"))
    body = encoder.encode_segment([field] * count).body
    return list(PaperDecoder(field.grid, encoder.parameters).frames(body, count)), len(body)


def test_field_of_coder_paper_is_smaller_than_its_segment_and_xz(wavy_field):
    (decoded,), size = paper_frames(wavy_field)
    (payload,) = encode_checked(decoded)
    assert len(payload) < size
    assert 2 * len(payload) < len(lzma.compress(decoded.vectors_n().T.tobytes(), preset=9))


def test_repeated_frame_costs_almost_nothing(wavy_field):
    (decoded, repeated), _ = paper_frames(wavy_field, 2)
    first_payload, repeated_payload = encode_checked(decoded, repeated)
    assert 8 * len(repeated_payload) < len(first_payload)


def test_few_distinct_forces_cost_little(wavy_field):
    steps = ForceField.from_bricks(wavy_field.grid, wavy_field.bricks, np.round(wavy_field.forces_n * 8) / 8)
    constant = ForceField.from_dense(grid_of(32, 32, 32), np.full((32, 32, 32, 3), np.float32(0.3)))
    assert 10 * len(encode_checked(steps)[0]) < len(encode_checked(wavy_field)[0])
    assert len(encode_checked(constant)[0]) < 60


# -- faults ------------------------------------------------------------------------------------------------


def test_truncated_payload_is_an_error_or_another_field():
    """A truncated code may be another field's complete code; the container's checksum detects it."""
    rng = np.random.default_rng(4)
    field = field_of(rng.choice(ODD, (8, 8, 8, 3)) * (rng.random((8, 8, 8, 1)) < 0.1).astype(np.uint32))
    (payload,), silent = encode_checked(field), 0
    for size in range(len(payload)):
        with contextlib.suppress(TruncatedFile, CorruptFile):
            (read,) = decode_exact([payload[:size]], field.grid)
            silent += 1 + 1000 * (bits_by_brick(read) == bits_by_brick(field))
    assert silent < len(payload) / 3
    with pytest.raises(CorruptFile):
        list(decode_exact([payload + bytes(9)], field.grid))


@given(st.data(), st.lists(st.tuples(st.integers(0, 4000), st.integers(0, 255)), min_size=1, max_size=4))
@settings(max_examples=40)
def test_changed_payload_is_an_error_or_another_field(data, changes):
    frames = [data.draw(fields((9, 8, 16))) for _ in range(2)]
    payloads = [bytearray(payload) for payload in encode_exact(frames)]
    for position, byte in changes:
        payloads[position % 2][position // 2 % len(payloads[position % 2])] = byte
    with contextlib.suppress(FormatError):
        for field in decode_exact(list(map(bytes, payloads)), frames[0].grid):
            assert np.isfinite(field.forces_n).all()


def test_invalid_palettes_raise_named_errors():
    field = field_of(np.full((3, 3, 3, 3), ODD[-1]))
    (payload,) = encode_exact([field])
    assert payload[0] != 5
    nan = np.float32([1, np.nan]).tobytes()
    for payloads, text in (
        ([b"\x1a\1\0" + bytes(4)], "a codebook that there is not"),
        ([b"\5\0\0"], "a palette without levels"),
        ([b"\5\2\0" + nan], "a level that is not finite"),
        ([payload, b"\5"], "another codebook"),
    ):
        with pytest.raises(CorruptFile, match=text):
            list(decode_exact(payloads, field.grid))
    for data in (b"", b"\5\1", b"\5\1\0\0"):
        with pytest.raises(TruncatedFile, match="end too early"):
            list(decode_exact([data], field.grid))


@given(st.binary(max_size=200), st.sampled_from([b"\0", b"\5\1\0\0\0\0\x3f", b"\x14\2\0\0\0\0\0\0\0\0\x3f"]))
@settings(max_examples=40)
def test_random_bytes_raise_named_errors(tail, head):
    """Also on the largest grid that a file may have."""
    with contextlib.suppress(FormatError):
        for field in decode_exact([head + tail], grid_of(1 << 12, 1 << 12, 1 << 12)):
            assert len(field.bricks) <= 64 + 16 * len(head + tail)

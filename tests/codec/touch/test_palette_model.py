"""The lossless model: the same bits back whatever the field, small where it repeats, and every fault named."""

from __future__ import annotations

import contextlib
import lzma
import tracemalloc

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touchfield.codec.touch.palette import Components, Octets, Palette, Products, Vectors, read_palette
from touchfield.codec.touch.palette_fit import fitting_palettes
from touchfield.codec.touch.palette_model import PaletteModel
from touchfield.codec.touch.palette_values import common_unit, in_order, read_values, write_values

from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.support import encode_support
from touchfield.codec.varint import write_varint
from touchfield.errors import CorruptFile, FormatError, InvalidArgument, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys

MODEL = PaletteModel()
ODD = np.array([0x80000000, 1, 0x80000001, 0x007FFFFF, 0x7F7FFFFF, 0xFF7FFFFF, 0, 0x3F800000], np.uint32)


def grid_of(*shape: int) -> Grid:
    return Grid(shape, (1e-3, 1e-3, 1e-3), (0, 0, 0))


def field_of(bits: np.ndarray) -> ForceField:
    """A field of dense float32 bits [nx, ny, nz, 3], a multiple of 8 each; bricks of nothing but -0.0 stay."""
    bx, by, bz = (n // 8 for n in bits.shape[:3])
    tiled = bits.reshape(bx, 8, by, 8, bz, 8, 3).transpose(0, 2, 4, 1, 3, 5, 6)
    bricks = np.argwhere(tiled.any(axis=(3, 4, 5, 6))).astype(np.int32)
    forces = np.ascontiguousarray(tiled[tuple(bricks.T)]).view(np.float32)
    return ForceField(grid_of(*bits.shape[:3]), bricks, forces)


def same(a: ForceField, b: ForceField) -> bool:
    """To the bit; `==` takes -0.0 for 0.0."""
    alike = np.array_equal(a.forces_n.view(np.uint32), b.forces_n.view(np.uint32))
    return a.grid == b.grid and np.array_equal(a.bricks, b.bricks) and alike


def coded(frame: ForceField, previous: ForceField | None = None) -> bytes:
    """The payload, which decodes to the same bits, and whose shares are what it is long."""
    payload, bits = MODEL.encode(frame, previous)
    assert same(MODEL.decode(payload, frame.grid, previous), frame)
    assert sum(bits) == pytest.approx(8 * len(payload), abs=16) and min(bits) >= 0
    return payload


@st.composite
def quantised(draw: st.DrawFn) -> ForceField:
    """Fields of every kind of palette, -0.0, denormals and the largest floats among them."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    shape = (8 * draw(st.integers(1, 2)), 8, 8 * draw(st.integers(1, 3)))
    kind = draw(st.sampled_from(["odd", "noise", "units", "vectors", "products", "constant", "one", "none"]))
    held = rng.random(shape) < draw(st.sampled_from([0.01, 0.3, 1.0]))
    if kind == "odd":
        bits = rng.choice(ODD, (*shape, 3))
    elif kind == "noise":
        bits = rng.integers(0, 0x7F800000, (*shape, 3), np.uint32) | rng.integers(0, 2, (*shape, 3), np.uint32) << 31
    elif kind == "units":
        bits = (rng.integers(-(2**16), 2**16, (*shape, 3)).astype(np.float32) * np.float32(4.7e-5)).view(np.uint32)
    elif kind == "vectors":
        bits = rng.normal(size=(9, 3)).astype(np.float32)[rng.integers(0, 9, shape)].view(np.uint32)
    elif kind == "products":
        levels = np.sort(rng.random(7).astype(np.float32))[rng.integers(0, 7, shape), None]
        bits = (levels * Codebook.get("ico2").vertices_float32[rng.integers(0, 42, shape)]).view(np.uint32)
    else:
        bits = np.zeros((*shape, 3), np.uint32)
        bits[...] = ODD[5] if kind == "constant" else 0
        bits[3, 4, 5] = ODD[:3] if kind == "one" else bits[3, 4, 5]
        held |= kind == "one"
    return field_of(np.where(held[..., None], bits, np.uint32(0)))


@given(quantised())
@settings(max_examples=25)
def test_every_field_comes_back_to_the_bit(field):
    payload = coded(field)
    decoded = MODEL.decode(payload, field.grid)
    assert MODEL.encode(decoded)[0] == payload


@given(quantised(), quantised())
@settings(max_examples=15)
def test_frame_before_may_be_anything(before, field):
    if before.grid == field.grid:
        coded(field, before)


def test_samples_of_negative_zero_alone_are_kept():
    bits = np.zeros((8, 8, 8, 3), np.uint32)
    bits[1, 2, 3, 1] = 0x80000000
    field = field_of(bits)
    decoded = MODEL.decode(coded(field), field.grid)
    assert decoded.support_count == 0 and len(decoded.bricks) == 1


def test_field_on_a_grid_that_ends_within_a_brick(wavy_field):
    steps = ForceField.from_bricks(wavy_field.grid, wavy_field.bricks, np.round(wavy_field.forces_n * 8) / 8)
    assert len(coded(steps)) < len(coded(wavy_field))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_refused(value):
    forces = np.zeros((1, 8, 8, 8, 3), np.float32)
    forces[0, 0, 0, 0] = value
    with pytest.raises(InvalidArgument, match="not finite"):
        MODEL.encode(ForceField(grid_of(8, 8, 8), np.zeros((1, 3), np.int32), forces))


def test_frame_before_must_have_the_grid(wavy_field):
    with pytest.raises(InvalidArgument, match="frame before"):
        MODEL.encode(wavy_field, ForceField.empty(grid_of(8, 8, 8)))


# -- size -------------------------------------------------------------------------------------------------


def test_noise_costs_a_little_over_its_size():
    rng = np.random.default_rng(1)
    field = field_of(rng.integers(0x30000000, 0x50000000, (16, 16, 16, 3), np.uint32))
    assert len(coded(field)) < 12 * 16**3 + 64


def paper_frames(field: ForceField, count: int = 1) -> tuple[list[ForceField], int]:
    """What coder `paper` makes of a field, frame by frame, and the bytes of its segment."""
    encoder = PaperEncoder(field.grid, PaperSpec(deadband="none", interframe="none"))
    body = encoder.encode_segment([field] * count).body
    return list(PaperDecoder(field.grid, encoder.parameters).frames(body, count)), len(body)


def test_field_of_coder_paper_is_smaller_than_its_own_file_and_xz(wavy_field):
    (decoded,), size = paper_frames(wavy_field)
    (palette,) = fitting_palettes(decoded.vectors_n().view(np.uint32))
    assert isinstance(palette, Products) and palette.codebook == "ico5"
    payload = coded(decoded)
    assert len(payload) < size
    assert 2 * len(payload) < len(lzma.compress(decoded.vectors_n().T.tobytes(), preset=9))


def test_frame_like_the_one_before_costs_next_to_nothing(wavy_field):
    (decoded, again), _ = paper_frames(wavy_field, 2)
    assert 5 * len(coded(again, decoded)) < len(coded(decoded))


def test_constant_field_costs_next_to_nothing():
    field = ForceField.from_dense(grid_of(32, 32, 32), np.full((32, 32, 32, 3), np.float32(0.3)))
    assert len(coded(field)) < 100


def test_multiples_of_a_unit_are_told_as_whole_numbers():
    rng = np.random.default_rng(2)
    numbers = np.cumsum(rng.integers(1, 4, 5000))
    values = (numbers.astype(np.float32) * np.float32(3.1 / 65536)).view(np.uint32)
    data = write_values(values)
    assert len(data) < 5000 * 2.2 / 8 + 40
    assert np.array_equal(read_values(data, 0, 5000)[0], values)


@given(st.integers(1, 2**17), st.floats(2.0**-40, 2.0**20, width=32), st.integers(0, 2**32 - 1))
def test_unit_is_found_wherever_there_is_one(largest, unit, seed):
    numbers = np.unique(np.append(np.random.default_rng(seed).integers(1, largest + 1, 40), [1, largest]))
    values = numbers.astype(np.float32) * np.float32(unit)
    found = common_unit(values)
    if len(values) > 1:
        assert found is not None
        multiples = np.rint(values / np.float64(found)).astype(np.float32)
        assert np.array_equal(multiples * np.float32(found), values)


# -- palettes ---------------------------------------------------------------------------------------------


def palettes() -> list[tuple[Palette, np.ndarray]]:
    """One of each kind, with vectors that it has."""
    rng = np.random.default_rng(3)
    values = in_order(rng.normal(size=60).astype(np.float32).view(np.uint32))
    some = values[rng.integers(0, 60, (500, 3))]
    ranks = np.unique(rng.integers(0, 60, (80, 3)), axis=0).astype(np.int32)
    levels = np.sort(rng.random(5).astype(np.float32)).view(np.uint32)
    products = Products(levels, "octa2")
    symbols = np.stack([rng.integers(0, 5, 500), rng.integers(0, products.sizes[1], 500)], axis=1)
    return [
        (Octets(), some),
        (Components(values), some),
        (Vectors(values, ranks), values[ranks][rng.integers(0, len(ranks), 500)]),
        (products, products.decode(symbols)),
    ]


@pytest.mark.parametrize(("palette", "vectors"), palettes(), ids=lambda p: type(p).__name__)
def test_palette_of_each_kind(palette, vectors):
    data = palette.to_bytes()
    read, end = read_palette(b"xy" + data, 2, len(vectors))
    assert end == 2 + len(data) and type(read) is type(palette) and read.sizes == palette.sizes
    symbols = read.encode(vectors)
    assert (symbols >= 0).all() and (symbols < palette.sizes).all()
    assert np.array_equal(read.decode(symbols), vectors)
    foreign = np.array([[0x7E000001, 0x7E000002, 0x7E000003]], np.uint32)
    assert type(palette) is Octets or (read.encode(foreign) == -1).all()


@pytest.mark.parametrize(("palette", "vectors"), palettes(), ids=lambda p: type(p).__name__)
def test_palette_that_is_cut_or_larger_than_its_frame(palette, vectors):
    data = palette.to_bytes()
    for size in range(len(data)):
        with pytest.raises(FormatError):
            read_palette(data[:size], 0, len(vectors))
    if type(palette) is not Octets:
        with pytest.raises(CorruptFile):
            read_palette(data, 0, 1)


# -- faults -----------------------------------------------------------------------------------------------


def test_cut_payload_is_named_or_another_field():
    """A code that ends early may be all of another field's: only its end tells, and a container's check."""
    rng = np.random.default_rng(4)
    field = field_of(rng.choice(ODD, (8, 8, 8, 3)) * (rng.random((8, 8, 8, 1)) < 0.1).astype(np.uint32))
    payload, silent = coded(field), 0
    for size in range(len(payload)):
        with contextlib.suppress(TruncatedFile, CorruptFile):
            silent += 1 + same(MODEL.decode(payload[:size], field.grid), field) * len(payload)
    assert silent < len(payload) / 3
    with pytest.raises(CorruptFile):
        MODEL.decode(payload + b"\0", field.grid)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25)
def test_changed_payload_is_named_or_another_field(seed):
    rng = np.random.default_rng(seed)
    kind = rng.integers(3)
    _, vectors = palettes()[1 + kind]
    bits = np.zeros((8, 8, 16, 3), np.uint32)
    bits.reshape(-1, 3)[:500] = vectors[:500]
    field = field_of(bits)
    payload = bytearray(MODEL.encode(field)[0])
    for place in rng.integers(0, len(payload), rng.integers(1, 4)):
        payload[place] = rng.integers(256)
    with contextlib.suppress(FormatError):
        decoded = MODEL.decode(bytes(payload), field.grid)
        assert np.isfinite(decoded.forces_n).all() and (np.diff(brick_keys(field.grid, decoded.bricks)) > 0).all()


@given(st.binary(max_size=200), st.sampled_from([b"", b"\0", b"\1\0", b"\1\1", b"\1\2", b"\1\3\4ico5"]))
def test_strange_bytes_are_named(tail, kind):
    mask = np.ones((1, 8, 8, 8), np.bool_)
    support = encode_support(grid_of(8, 8, 8), np.zeros((1, 3), np.int32), mask)
    with contextlib.suppress(FormatError):
        MODEL.decode(write_varint(len(support)) + support + kind + tail, grid_of(8, 8, 8))


def test_few_bytes_never_take_much_memory():
    """A palette that says it has many entries, in a frame of few samples."""
    mask = np.ones((1, 8, 8, 8), np.bool_)
    support = encode_support(grid_of(8, 8, 8), np.zeros((1, 3), np.int32), mask)
    head = write_varint(len(support)) + support + b"\1\1" + bytes(4)
    MODEL.decode(coded(field_of(np.full((8, 8, 8, 3), 5, np.uint32))), grid_of(8, 8, 8))  # compiled
    for count in (1537, 1 << 40):
        tracemalloc.start()
        with pytest.raises(CorruptFile, match="count"):
            MODEL.decode(head + write_varint(count) + bytes(99), grid_of(8, 8, 8))
        assert tracemalloc.get_traced_memory()[1] < 4 << 20
        tracemalloc.stop()

"""Crafted bodies and parameters of coder `touch` at the limits of the format: three decoders agree."""

from __future__ import annotations

import io
import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import decoder, reading
from test_c import CODES, COMPILER, built, run

from live_makers import HEAD
from touchfield.codec.touch.body import FLOOR_LIMIT, RATE_LIMIT, BodyReader
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import chunk, write_varint
from touchfield.container import TouchWriter
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.decoding import open_file

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")

GRID = Grid((12, 9, 8), (0.01,) * 3, (0.0,) * 3)
ENCODER = TouchEncoder(GRID, TouchSpec(effort="fast"))
SMALL = ForceField.from_support(GRID, [[1, 2, 3], [1, 2, 4]], [[0, 0, 1], [0, 0.5, 2]])
BODY = ENCODER.encode_segment([SMALL]).body
VALID_BODY = BodyReader(BODY, GRID, exact=False)
(FRAME,) = VALID_BODY.records(1)
EXACT = TouchEncoder(GRID, TouchSpec(mode="lossless"))
(EXACT_FRAME,) = BodyReader(EXACT.encode_segment([SMALL]).body, GRID, exact=True).records(1)


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`touch_decode`, compiled without optimisation."""
    return built(tmp_path_factory.mktemp("c"), "touch_decode", "-O0")


def file_of(
    body: bytes, parameters: bytes = ENCODER.parameters, shape: tuple[int, int, int] = GRID.shape
) -> bytes:
    """A file of one frame."""
    file = io.BytesIO()
    head = replace(HEAD, grid_shape=shape, spacing_m=GRID.spacing_m, coder_parameters=parameters)
    with TouchWriter(file) as writer:
        writer.write_head(head)
        writer.write_segment(0, 1, body)
    return file.getvalue()


def body(
    flags: int = 1, lattice: bytes | None = None, max_error: tuple[int, ...] = (0, 0, 0, 0), kind: int = 0,
    fractions: tuple[int, int] = (0, 0), base_layer: bytes | None = None, payload: bytes = FRAME.payload,
    outliers: bytes | None = None, trailing: bytes = b"",
) -> bytes:  # fmt: skip
    """A body of one frame."""
    assert VALID_BODY.lattice is not None
    kind |= 2 * (base_layer is not None) | 4 * (outliers is not None)
    parts = [bytes([flags]), VALID_BODY.lattice.to_bytes() if lattice is None else lattice]
    parts += [b"\1\0", *map(write_varint, max_error)] if flags & 1 else []
    chunks = [chunk(data) for data in (base_layer, payload, outliers) if data is not None]
    return b"".join([*parts, bytes([kind, *fractions]), *chunks, trailing])


def lattice(*numbers: int) -> bytes:
    """A lattice of floor and rate, along and across."""
    return struct.pack("<f", VALID_BODY.lattice.unit_n) + b"".join(map(write_varint, numbers))  # type: ignore[union-attr]


def force(gap: int, sample: int, *newtons: float) -> bytes:
    """A force sent as an outlier, or none."""
    return (
        write_varint(gap)
        + write_varint(2 * sample + (not newtons))
        + struct.pack(f"<{len(newtons)}f", *newtons)
    )


def voxel(x: int, y: int, z: int) -> dict[str, Any]:
    return {"max_error": (0, x, y, z)}


SHAPE, BRICKS = GRID.shape, 4
BODIES: dict[str, tuple[dict[str, Any], str]] = {
    "as it is": ({}, ""),
    "no worst voxel": ({"flags": 0}, ""),
    "another flag": ({"flags": 3}, "CorruptFile"),
    "the last voxel": (voxel(11, 8, 7), ""),
    "x beyond": (voxel(SHAPE[0], 0, 0), "CorruptFile"),
    "y beyond": (voxel(0, SHAPE[1], 0), "CorruptFile"),
    "z beyond": (voxel(0, 0, SHAPE[2]), "CorruptFile"),
    "a worst frame behind the last": ({"max_error": (1, 0, 0, 0)}, "CorruptFile"),
    "the frame before is missing": ({"kind": 1}, "CorruptFile"),
    "an unknown bit of a frame": ({"kind": 8}, "CorruptFile"),
    "shares of all": ({"fractions": (200, 55)}, ""),
    "shares of more": ({"fractions": (200, 56)}, "CorruptFile"),
    "an empty guess": ({"base_layer": b""}, "CorruptFile"),
    "a guess of another kind": ({"base_layer": b"\2" + bytes(20)}, "CorruptFile"),
    "no exceptions": ({"outliers": b""}, "CorruptFile"),
    "a byte more": ({"trailing": b"\0"}, "CorruptFile"),
    "no axis": ({"payload": b"\3" + FRAME.payload[1:]}, "CorruptFile"),
    "another bit of the course": (
        {"payload": bytes([32 | FRAME.payload[0]]) + FRAME.payload[1:]},
        "CorruptFile",
    ),
    "too steep": ({"payload": FRAME.payload[:1] + write_varint(1 << 17) + FRAME.payload[2:]}, "CorruptFile"),
    "a payload cut": ({"payload": FRAME.payload[: len(FRAME.payload) // 2]}, "TruncatedFile"),
    "no floor": ({"lattice": lattice(0, 7000, 1, 7000)}, "CorruptFile"),
    "no floor across": ({"lattice": lattice(21, 7000, 0, 7000)}, "CorruptFile"),
    "a floor too high": ({"lattice": lattice(FLOOR_LIMIT, 0, 1, 0)}, "CorruptFile"),
    "a rate too high": ({"lattice": lattice(21, RATE_LIMIT, 1, 0)}, "CorruptFile"),
    "steps too fine": ({"lattice": lattice(20, 63, 20, 63)}, "CorruptFile"),
    "exceptions": ({"outliers": force(0, 0, 1, 2, 3) + force(0, 1) + force(1, 0, 1, 2, 3)}, ""),
    "the same sample twice": ({"outliers": force(0, 1, 1, 2, 3) + force(0, 1)}, "CorruptFile"),
    "samples that descend": ({"outliers": force(1, 1, 1, 2, 3) + force(0, 0)}, "CorruptFile"),
    "the last brick": ({"outliers": force(BRICKS - 1, 0, 1, 2, 3)}, ""),
    "a brick behind the last": ({"outliers": force(BRICKS, 0, 1, 2, 3)}, "CorruptFile"),
    "a sample beyond the grid": ({"outliers": force(2, 256)}, "CorruptFile"),
    "the last sample of the grid": ({"outliers": force(2, 192, 1, 2, 3)}, ""),
    "a sample that there is not": ({"outliers": force(0, 512)}, "CorruptFile"),
    "no number": ({"outliers": force(0, 0, 1, float("nan"), 3)}, "CorruptFile"),
    "no end": ({"outliers": force(0, 0, 1, 2, float("inf"))}, "CorruptFile"),
    "half a force": ({"outliers": force(0, 0, 1, 2)}, "TruncatedFile"),
}


def exact(payload: bytes = EXACT_FRAME.payload, **change: Any) -> dict[str, Any]:
    return {"lattice": b"", "payload": payload, **change}


LOSSLESS: dict[str, tuple[dict[str, Any], str]] = {
    "lossless": (exact(), ""),
    "lossless with a guess": (exact(base_layer=b"\0\0"), "CorruptFile"),
    "lossless with exceptions": (exact(outliers=force(0, 0, 1, 2, 3)), "CorruptFile"),
    "a codebook that there is not": (exact(b"\xc8\1\0" + bytes(40)), "CorruptFile"),
    "a codebook without levels": (exact(b"\5\0\0" + bytes(40)), "CorruptFile"),
    "a level without end": (exact(b"\5\1\0" + struct.pack("<f", float("inf")) + bytes(40)), "CorruptFile"),
    "a level cut": (exact(b"\5\1\0\0\0\0"), "TruncatedFile"),
    "nothing lossless": (exact(b""), "TruncatedFile"),
}


def parameters_of(mode: int, *numbers: float, version: int = 1) -> bytes:
    return struct.pack(f"<BB{len(numbers)}d", version, mode, *numbers)


HEADS: dict[str, tuple[bytes, str]] = {
    "the least": (parameters_of(0, 0.001, 0.0), ""),
    "too small a share": (parameters_of(0, 0.000999, 0.05), "CorruptFile"),
    "a share of all": (parameters_of(0, 1.0, 0.05), "CorruptFile"),
    "less than no force": (parameters_of(0, 0.1, -0.05), "CorruptFile"),
    "no number asked for": (parameters_of(0, 0.1, float("nan")), "CorruptFile"),
    "without end": (parameters_of(0, 0.1, float("inf")), "CorruptFile"),
    "a number less": (parameters_of(0, 0.1), "CorruptFile"),
    "a number more": (parameters_of(0, 0.1, 0.05, 0.1), "CorruptFile"),
    "an older effort": (parameters_of(16, 0.1, 0.05), ""),
    "no effort": (parameters_of(24, 0.1, 0.05), "CorruptFile"),
    "masking": (parameters_of(32, 0.1, 0.05, 1.0, 1.0), ""),
    "masking by nothing": (parameters_of(32, 0.1, 0.05, 0.0, 0.001), "CorruptFile"),
    "masking by more than all": (parameters_of(32, 0.1, 0.05, 1.1, 0.001), "CorruptFile"),
    "masking from afar": (parameters_of(32, 0.1, 0.05, 0.1, 1.1), "CorruptFile"),
    "masking of directions": (parameters_of(33, 0.1, 0.05, 18.0, 0.1, 0.001), "CorruptFile"),
    "another bit": (parameters_of(64, 0.1, 0.05, 0.1, 0.001), "CorruptFile"),
    "a right angle": (parameters_of(1, 0.1, 0.05, 90.0), "CorruptFile"),
    "no step": (parameters_of(2, 0.0), "CorruptFile"),
    "a later version": (parameters_of(0, 0.1, 0.05, version=2), "UnsupportedVersion"),
    "nothing": (b"\1", "CorruptFile"),
}


@pytest.mark.parametrize("name", [*BODIES, *LOSSLESS, *HEADS])
def test_three_decoders_agree(name: str, program: Path, tmp_path: Path) -> None:
    if name not in HEADS:
        change, expected = (BODIES | LOSSLESS)[name]
        data = file_of(body(**change), (EXACT if name in LOSSLESS else ENCODER).parameters)
    else:
        parameters, expected = HEADS[name]
        data = file_of(body(), parameters)
    check_outcome(data, expected, program, tmp_path)


EMPTY = b"\0\0\0\0\x80"  # payload of a frame without bricks
SPLINE = bytes([0, 2, 2, 2, 16, 1, 1, 1, *range(40, 240, 20)]) + random.Random(1).randbytes(50)
COLUMNS = bytes([1, 4, 0, 0, 8, 8, 1, 1, 0, 0, 1, 1, 1])  # along z, in all 9 x 9 tiles
BASE_LAYERS: dict[str, tuple[tuple[int, int, int], bytes, str]] = {
    "a spline": ((9, 8, 7), SPLINE, ""),
    "a spline, and another byte": ((9, 8, 7), SPLINE + b"\1", "CorruptFile"),
    "a spline, and a zero": ((9, 8, 7), SPLINE + b"\0", "CorruptFile"),
    "a spline cut": ((9, 8, 7), SPLINE[:-7], "TruncatedFile"),
    # no column has a surface, which takes 6 bytes; 81 tiles need 17
    "columns": ((72, 72, 8), COLUMNS + 6 * b"\xff" + bytes(11), ""),
    "columns, and other bytes": ((72, 72, 8), COLUMNS + 6 * b"\xff" + bytes(10) + b"\1", "CorruptFile"),
    "columns, and a zero": ((72, 72, 8), COLUMNS + 6 * b"\xff" + bytes(12), "CorruptFile"),
    "columns of too few bytes": ((72, 72, 8), COLUMNS + 6 * b"\xff" + bytes(10), "TruncatedFile"),
}


@pytest.mark.parametrize("name", BASE_LAYERS)
def test_base_layers_end_with_their_code(name: str, program: Path, tmp_path: Path) -> None:
    shape, layer, expected = BASE_LAYERS[name]
    check_outcome(file_of(body(base_layer=layer, payload=EMPTY), shape=shape), expected, program, tmp_path)


NOISE = ForceField.from_dense(
    GRID, np.random.default_rng(0).normal(0.0, 1.0, (*GRID.shape, 3)).astype(np.float32)
)


def test_a_cut_lossless_payload_is_cut_short(program: Path, tmp_path: Path) -> None:
    """Zeros follow a cut code; whatever they decode to, the error is that the bytes have ended."""
    (frame,) = BodyReader(EXACT.encode_segment([NOISE]).body, GRID, exact=True).records(1)
    check_outcome(file_of(body(**exact(frame.payload)), EXACT.parameters), "", program, tmp_path)
    for size in range(2, len(frame.payload), len(frame.payload) // 20):
        data = file_of(body(**exact(frame.payload[:size])), EXACT.parameters)
        check_outcome(data, "TruncatedFile", program, tmp_path)


def check_outcome(data: bytes, expected: str, program: Path, tmp_path: Path) -> None:
    """Check that three decoders raise the expected error, or none if it is ""."""
    path, errors = tmp_path / "crafted.touch", ["", ""]
    path.write_bytes(data)
    try:
        with open_file(path) as opened:
            opened.medium[len(opened.medium) - 1].to_dense()
            opened.summary()
    except FormatError as error:
        errors[0] = type(error).__name__
    try:
        decoder.decode(path)
    except reading.FaultyFile as error:
        errors[1] = type(error).__name__
    code, message = run(program, path, tmp_path / "raw")
    assert [*errors, CODES[code]] == [expected] * 3, message

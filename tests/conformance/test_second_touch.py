"""The decoder written from docs/format/touch.md alone agrees on forces and on refused bytes."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from second import reading

from touchfield.codec.touch.body import FrameRecord, Lattice, write_body
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.varint import write_varint
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid

part: Any = importlib.import_module("decode_touch")
bits: Any = importlib.import_module("touch_bits")
GRID = Grid((11, 9, 17), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))

Frames = list[dict[tuple[int, ...], bytes]]


def field(vectors: np.ndarray, mask: np.ndarray) -> ForceField:
    return ForceField.from_dense(GRID, np.where(mask[..., None], vectors, 0).astype(np.float32))


def ball(t: int) -> ForceField:
    """A penalty field around a point, saturated at its centre."""
    out = np.stack(np.indices(GRID.shape), axis=-1) - np.array([6.0 + t / 4, 4, 8])
    distance = np.sqrt((out * out).sum(axis=-1)) + 0.01
    return field(out * (np.minimum(7 - distance, 4) / distance)[..., None], distance < 7)


def noise(t: int) -> ForceField:
    rng = np.random.default_rng(t)
    return field(rng.normal(size=(*GRID.shape, 3)), rng.random(GRID.shape) < 0.2)


def solid(t: int) -> ForceField:
    """A solid behind a surface with a step."""
    i, j, k = np.indices(GRID.shape)
    depth = np.clip(k - 4.5 - 0.2 * i - 3 * (j > 4) - t / 8, 0, 4)
    return field(np.stack([0.3 * depth, 0.1 * depth, -depth], axis=-1), depth > 0)


def partly_still(t: int) -> ForceField:
    """The solid, of which one brick changes: those around it, also at the border, are copied."""
    forces_n = solid(0).to_dense()
    forces_n[:8, :8, 8:16] *= 1 + t / 2
    return ForceField.from_dense(GRID, forces_n)


def wide(t: int) -> ForceField:
    """Forces over forty decades, some of them subnormal in float32."""
    rng = np.random.default_rng(t)
    sizes = 10.0 ** rng.uniform(-41, 6, GRID.shape)
    return field(rng.normal(size=(*GRID.shape, 3)) * sizes[..., None], rng.random(GRID.shape) < 0.1)


def nothing(t: int) -> ForceField:
    return ForceField.empty(GRID)


CASES: dict[str, tuple[Callable[[int], ForceField], TouchSpec]] = {
    "ball": (ball, TouchSpec(guess="off", interframe="on")),
    "ball, guessed": (ball, TouchSpec(f0_n=0.01, interframe="off")),
    "ball, fast": (ball, TouchSpec(effort="fast", guess="off")),
    "directions": (ball, TouchSpec(mode="mask-direction", support="exact", f0_n=0.02)),
    "nmse": (ball, TouchSpec(mode="nmse", step_n=0.1)),
    "noise": (noise, TouchSpec(f0_n=0.0, interframe="on")),
    "noise, coarse": (noise, TouchSpec(k=0.9, f0_n=1.0)),
    "solid": (solid, TouchSpec()),
    "partly still": (partly_still, TouchSpec(guess="off", interframe="on")),
    "wide": (wide, TouchSpec(k=0.3, f0_n=0.0, support="exact")),
    "nothing": (nothing, TouchSpec()),
    "lossless": (solid, TouchSpec(mode="lossless")),
}


def bytes_of(bricks: Any) -> dict[tuple[int, ...], bytes]:
    """Bricks with a nonzero force, as bytes; -0 equals 0."""
    return {tuple(brick): (forces + 0.0).tobytes() for brick, forces in bricks if forces.any()}


def decode_with_package(parameters: bytes, body: bytes) -> Frames:
    fields = TouchDecoder(GRID, parameters).frames(body, 2)
    return [bytes_of(zip(map(tuple, f.bricks.tolist()), f.forces_n, strict=True)) for f in fields]


def decode_with_reference(parameters: bytes, body: bytes) -> Frames:
    return [bytes_of(frame.items()) for frame in part.decode_segment(body, parameters, GRID.shape, 2)]


def outcome(decode: Callable[[bytes, bytes], Frames], parameters: bytes, body: bytes) -> Frames | str:
    """Two frames, or the name of the error if the bytes are refused."""
    try:
        return decode(parameters, body)
    except (FormatError, reading.FaultyFile) as error:
        return type(error).__name__


def encoded(name: str) -> tuple[bytes, bytes]:
    """Parameters and body of two frames."""
    make, spec = CASES[name]
    encoder = TouchEncoder(GRID, spec)
    return encoder.parameters, encoder.encode_segment([make(0), make(1)]).body


@pytest.mark.parametrize("name", CASES)
def test_decoders_agree_on_forces(name: str) -> None:
    stream = encoded(name)
    assert decode_with_reference(*stream) == decode_with_package(*stream)
    assert any(map(len, decode_with_package(*stream))) == (name != "nothing")


@pytest.mark.parametrize("name", ["ball", "noise", "solid"])
def test_both_refuse_the_same_bytes(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # the reference decoder is slow
    monkeypatch.setitem(globals(), "GRID", Grid((9, 8, 10), GRID.spacing_m, GRID.origin_m))
    parameters, body = encoded(name)
    rng, refused = np.random.default_rng(len(body)), 0
    for _ in range(25):
        changed = bytearray(body)
        changed[int(rng.integers(len(body)) * rng.choice([0.1, 1]))] ^= 1 << rng.integers(8)
        cut = bytes(changed[: len(changed) - (rng.random() < 0.1)])
        expected = outcome(decode_with_package, parameters, cut)
        assert outcome(decode_with_reference, parameters, cut) == expected
        refused += isinstance(expected, str)
    assert refused > 6


def test_both_refuse_the_same_parameters() -> None:
    rng, refused = np.random.default_rng(7), 0
    for mode in ("mask", "mask-direction", "nmse"):
        encoder = TouchEncoder(GRID, TouchSpec(mode=mode))
        body = encoder.encode_segment([nothing(0), nothing(1)]).body
        for _ in range(100):
            changed = bytearray(encoder.parameters)
            changed[rng.choice([0, 1, rng.integers(len(changed))])] = rng.integers(256)
            cut = bytes(changed[: len(changed) - (rng.random() < 0.1)])
            expected = outcome(decode_with_package, cut, body)
            assert outcome(decode_with_reference, cut, body) == expected, cut.hex()
            refused += isinstance(expected, str)
    assert refused > 100


SMALL = Grid((8, 8, 10), GRID.spacing_m, GRID.origin_m)
LATTICES = ((65535, 131071, 65535, 131071), (1, 64, 1, 131071), (21, 0, 1, 0), (1, 131071, 65535, 0))


@pytest.mark.parametrize("steps", LATTICES)
def test_no_number_overflows(steps: tuple[int, ...], monkeypatch: pytest.MonkeyPatch) -> None:
    """Integers of 64 bits decode random codes as Python's do, with extreme lattices and slopes."""
    rng, parameters, used = np.random.default_rng(steps), TouchEncoder(SMALL, TouchSpec()).parameters, [0]
    lattice = Lattice(2.0**-16, *steps)

    def body_of(payloads: list[bytes]) -> bytes:
        records = [FrameRecord(i > 0, b"", payload, (0, 0)) for i, payload in enumerate(payloads)]
        return write_body(lattice, records, None)

    def decoded(payloads: list[bytes]) -> list[Any]:
        return list(part.decode_segment(body_of(payloads), parameters, SMALL.shape, len(payloads)))

    def extended(payloads: list[bytes]) -> list[bytes]:
        """A payload cut where its code ends; bytes of 0 decode to ones, which make large numbers."""
        code = rng.integers(256, size=32000).astype(np.uint8)
        code[rng.random(len(code) // 50).repeat(50) < 0.3] = code[0] = 0
        head = bytes([rng.integers(3) | rng.integers(8) << 2])
        head += b"".join(write_varint(int(n)) for n in rng.choice([0, (1 << 17) - 1], 3))
        with monkeypatch.context() as inner:
            inner.setattr(bits.Bits, "end", lambda own, _: used.append(own.place))
            frame = decoded([*payloads, head + code.tobytes()])[-1]
        full = any(forces.any() for forces in frame.values())
        return [*payloads, head + code[: used[-1]].tobytes()] if full else extended(payloads)

    payloads = extended(extended([]))
    fields = TouchDecoder(SMALL, parameters).frames(body_of(payloads), 2)
    expected = [bytes_of(zip(map(tuple, f.bricks.tolist()), f.forces_n, strict=True)) for f in fields]
    assert [bytes_of(frame.items()) for frame in decoded(payloads)] == expected

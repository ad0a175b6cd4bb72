"""The decoder written from docs/format/paper.md alone agrees exactly with the package."""

from __future__ import annotations

import importlib
import sys
import zlib
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.codec.paper.body import INTER_SET, INTRA_SET, FrameSymbols, set_of
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.paper.encoder import PaperEncoder, write_body
from touchfield.codec.paper.quantisers import uniform_levels, weber_ladder, weber_levels
from touchfield.codec.paper.spec import STAGES, PaperSpec
from touchfield.codec.segment import FrameKind
from touchfield.codec.support import decode_support, encode_support
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid

ROOT = Path(__file__).resolve().parents[3]
DOCUMENT = ROOT / "docs" / "format" / "paper.md"

sys.path.append(str(ROOT / "conformance"))  # the decoder imports its parts from here
reference_decoder: Any = importlib.import_module("decode_paper")
reference_support: Any = importlib.import_module("support")


def grid_of(*shape: int) -> Grid:
    return Grid((shape[0], shape[1], shape[2]), (0.001, 0.002, 0.0015), (-0.01, 0.0, 0.02))


def frames_as_bytes(bricks: Iterator[dict[Any, np.ndarray]]) -> list[list[tuple[Any, bytes]]]:
    """Bricks with a nonzero force, as bytes; the sign of a zero has no meaning."""
    return [
        [(b, (f + np.float32(0)).tobytes()) for b, f in sorted(frame.items()) if f.any()] for frame in bricks
    ]


def decode(grid: Grid, name: str, body: bytes, count: int) -> list[list[tuple[Any, bytes]]]:
    fields = PaperDecoder(grid, name.encode()).frames(body, count)
    return frames_as_bytes(
        {tuple(b): f for b, f in zip(x.bricks.tolist(), x.forces_n, strict=True)} for x in fields
    )


def decode_reference(grid: Grid, name: str, body: bytes, count: int) -> list[list[tuple[Any, bytes]]]:
    return frames_as_bytes(reference_decoder.decode_segment(body, name.encode(), grid.shape, count))


def moving_wall(shape: tuple[int, int, int], frames: int, seed: int) -> list[ForceField]:
    """A sheet of forces that moves, with noise; the third frame of five or more is empty."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    fields = []
    for t in range(frames):
        depth = z - shape[2] / 2 - 2 * np.sin((x + t) / 3) * np.cos(y / 4)
        amplitude = np.where((depth > 0) & (depth < 4), depth, 0) * (t != 2 or frames < 5)
        normal = np.stack([np.sin(x / 5), np.cos(y / 6), -np.ones(shape)], axis=-1)
        force = amplitude[..., None] * (normal + 0.1 * rng.normal(size=normal.shape))
        fields.append(ForceField.from_dense(grid_of(*shape), force.astype(np.float32)))
    return fields


def solid(shape: tuple[int, int, int], frames: int) -> list[ForceField]:
    """A growing block with full bricks, also at the far faces of the grid."""
    fields = []
    for t in range(frames):
        force = np.zeros((*shape, 3), np.float32)
        force[3 - t :, 4:, 2:] = (0.25, -0.5, 1 + t)
        fields.append(ForceField.from_dense(grid_of(*shape), force))
    return fields


WALL = (20, 17, 19)
STREAMS: dict[str, tuple[list[ForceField], PaperSpec]] = {
    "closed loop": (moving_wall(WALL, 5, 1), PaperSpec()),
    "no choice of the smaller": (moving_wall(WALL, 3, 2), PaperSpec(choose_by_size=False, nq=2)),
    "alone, ico1": (moving_wall(WALL, 2, 3), PaperSpec(interframe="none", directions="ico1")),
    "weber, octa3": (moving_wall(WALL, 3, 5), PaperSpec(amplitude="weber", directions="octa3", k=0.2)),
    "open": (moving_wall(WALL, 5, 7), PaperSpec(interframe="open", amplitude="uniform")),
    "literal": (moving_wall(WALL, 3, 8), PaperSpec.literal()),
    "no deadband, nq 12": (moving_wall(WALL, 2, 9), PaperSpec(deadband="none", nq=12)),
    "solid": (solid((24, 21, 19), 3), PaperSpec(k=0.3)),
    "single sample": ([ForceField.from_dense(grid_of(1, 1, 1), np.full((1, 1, 1, 3), 2.0))] * 2, PaperSpec()),
    "empty": ([ForceField.empty(grid_of(9, 8, 7))] * 3, PaperSpec()),
    **{stage: (moving_wall((11, 9, 10), 5, 10), PaperSpec(stage=stage)) for stage in STAGES[1:]},
    "a coarse dct": (solid((9, 8, 10), 1), PaperSpec(stage="dct", step_n=0.7)),
}


@pytest.mark.parametrize("name", STREAMS)
def test_streams_of_the_encoder(name: str) -> None:
    frames, spec = STREAMS[name]
    encoder = PaperEncoder(frames[0].grid, spec)
    body, codebook_name = encoder.encode_segment(frames).body, encoder.parameters.decode()
    frames_of_package = decode(frames[0].grid, codebook_name, body, len(frames))
    assert (
        len(frames_of_package) == len(frames)
        and decode_reference(frames[0].grid, codebook_name, body, len(frames)) == frames_of_package
    )


# -- what the format allows --------------------------------------------------------------------------------


def random_support(rng: np.random.Generator, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Some bricks full, some mixed, some absent."""
    bricks = np.argwhere(rng.random(np.array(grid.brick_shape)) < 0.6).astype(np.int32)
    mask = rng.random((len(bricks), 8, 8, 8)) < rng.choice([0.05, 0.5, 1.0], size=(len(bricks), 1, 1, 1))
    positions = 8 * bricks[:, None, None, None] + np.stack(np.indices((8, 8, 8)), axis=-1)
    mask &= (positions < grid.shape).all(axis=-1)
    nonempty = mask.any(axis=(1, 2, 3))
    return bricks[nonempty], mask[nonempty]


def random_body(seed: int, grid: Grid, directions: str, kinds: Sequence[FrameKind]) -> bytes:
    """A body of random symbols, with frame kinds in an order that the encoder would not choose."""
    rng = np.random.default_rng(seed)
    count = len(Codebook.get(directions))
    levels = {INTRA_SET: weber_levels(weber_ladder(0.3, 9.0)), INTER_SET: uniform_levels(0.37, 4.0)}
    frames, previous = [], None
    for kind in kinds:
        bricks, mask = random_support(rng, grid)
        sent = rng.random(np.count_nonzero(mask)) < rng.choice([0.01, 0.3, 1.0])
        level = (len(levels[set_of(kind)]) * rng.random(np.count_nonzero(sent)) ** 3).astype(np.uint16)
        vertices = (count * rng.random(len(level)) ** 2).astype(np.uint16)
        encoded_support = encode_support(grid, bricks, mask, previous if kind == FrameKind.INTER else None)
        frames.append(FrameSymbols(kind, encoded_support, bricks, mask, sent, level, vertices))
        previous = previous if kind == FrameKind.DIFFERENCE else (bricks, mask)
    return write_body(count, levels, frames, single_holds=seed % 3 == 0).body


@pytest.mark.parametrize("seed", range(4))
def test_any_order_of_kinds(seed: int) -> None:
    grid = grid_of(19, 12, 21)
    kinds = [FrameKind(0), *(FrameKind(k) for k in np.random.default_rng(seed).integers(0, 3, 5).tolist())]
    name = ("ico2", "octa1", "ico7")[seed % 3]
    body = random_body(seed, grid, name, kinds)
    assert decode(grid, name, body, 6) == decode_reference(grid, name, body, 6)


def test_brick_list_in_a_large_grid() -> None:
    """Few bricks in 4096^3 samples, full bricks among them, one at the far corner."""
    grid, rng = grid_of(4096, 4096, 4093), np.random.default_rng(5)
    bricks = np.array([[0, 0, 3], [0, 0, 4], [7, 300, 2], [7, 301, 2], [511, 511, 511]])
    fields = []
    for t in range(3):
        forces = rng.normal(size=(len(bricks), 8, 8, 8, 3)) * (rng.random((len(bricks), 8, 8, 8, 1)) < 0.4)
        forces[1] = forces[4] = (0, 1, 2 + t)
        fields.append(ForceField.from_bricks(grid, bricks[t == 1 :], forces[t == 1 :]))
    body = PaperEncoder(grid, PaperSpec(k=0.3)).encode_segment(fields).body
    assert decode(grid, "ico5", body, 3) == decode_reference(grid, "ico5", body, 3)


def outcome(decoded: Any, refusal: type[Exception]) -> Any:
    """The frames, or None if the bytes are refused."""
    try:
        return decoded()
    except refusal:
        return None


def test_both_refuse_the_same_bytes() -> None:
    """Changed bodies: both decoders refuse the same ones, and agree on the ones they accept."""
    grid = grid_of(9, 7, 10)
    cases = [("ico1", 3, random_body(s, grid, "ico1", [FrameKind(k) for k in (0, 1, 2)])) for s in range(3)]
    small = moving_wall((5, 4, 6), 1, 1)
    cases += [
        (s, 1, PaperEncoder(small[0].grid, PaperSpec(stage=s)).encode_segment(small).body) for s in STAGES[1:]
    ]
    rng = np.random.default_rng(2)
    accepted = refused = 0
    for i in range(240):
        name, count, good = cases[i % len(cases)]
        body = bytearray(good)
        for _ in range(rng.integers(1, 3)):
            body[rng.integers(len(body))] ^= 1 << rng.integers(8)
        bad = bytes(body[: len(body) - (rng.random() < 0.1)])
        at = grid if name == "ico1" else small[0].grid
        decoded = outcome(lambda: decode(at, name, bad, count), FormatError)  # noqa: B023
        assert outcome(lambda: decode_reference(at, name, bad, count), ValueError) == decoded, bad.hex()  # noqa: B023
        accepted, refused = accepted + (decoded is not None), refused + (decoded is None)
    assert accepted > 20 and refused > 20


def reference_support_of(bricks: np.ndarray, mask: np.ndarray) -> Any:
    """A support in the reference decoder's representation."""
    samples_in_bricks = np.argwhere(mask)
    samples = 8 * bricks[samples_in_bricks[:, 0]] + samples_in_bricks[:, 1:]
    return reference_support.Support(list(map(tuple, bricks.tolist())), sorted(map(tuple, samples.tolist())))


@pytest.mark.parametrize("seed", range(3))
def test_support_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_of(26, 23, 15)
    before, now = random_support(rng, grid), random_support(rng, grid)
    for previous in (None, before):
        data = encode_support(grid, *now, previous)
        decoded = reference_support.support_alone(
            data,
            grid.shape,
            reference_support.NOTHING if previous is None else reference_support_of(*previous),
        )
        assert decoded == reference_support_of(*decode_support(data, grid, previous))


def test_codebooks_have_the_checksums_of_the_document() -> None:
    document = DOCUMENT.read_text(encoding="utf-8")
    for name in codebook_names():
        vertices = reference_decoder.codebook(name).astype("<f4")
        assert vertices.tobytes() == Codebook.get(name).vertices_float32.astype("<f4").tobytes()
        assert f"{name} `{zlib.crc32(vertices.tobytes()):08x}`" in document
    for name in ("ico0", "ico21", "octa6", "cube1", ""):
        with pytest.raises(ValueError, match="codebook"):
            reference_decoder.codebook(name)

"""docs/format.md is enough: a decoder that follows it, and shares no code with the package, gives the same forces."""

from __future__ import annotations

import importlib
import subprocess
import sys
import zlib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.codec import format_chapters
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.kernels import mixer
from touchfield.codec.ladders import UniformSpec, WeberSpec
from touchfield.codec.paper.decoder import PaperDecoder
from touchfield.codec.paper.encoder import PaperEncoder
from touchfield.codec.paper_format import CodedFrame, SegmentTables, write_body
from touchfield.codec.paper_frames import FrameSymbols, Scan, Synthesis
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.segment import FrameKind
from touchfield.codec.support import decode_support, encode_support
from touchfield.container import Head
from touchfield.errors import FormatError
from touchfield.job import open_stream
from touchfield.medium import ForceField, Grid

ROOT = Path(__file__).resolve().parents[1]
CONFORMANCE = ROOT / "conformance"
SCRIPT = CONFORMANCE / "reference_decoder.py"
GOLDEN = [path for path in sorted((CONFORMANCE / "v0").glob("*.touch")) if not path.stem.startswith("objects-")]


sys.path.append(str(CONFORMANCE))  # where the decoder looks for its parts
reference: Any = importlib.import_module("reference_decoder")
golden: Any = importlib.import_module("make_golden")


def grid_of(*shape: int) -> Grid:
    return Grid((shape[0], shape[1], shape[2]), (0.001, 0.002, 0.0015), (-0.01, 0.0, 0.02))


def written(path: Path, grid: Grid, parameters: bytes, segments: Sequence[tuple[int, bytes]]) -> Path:
    """A file of bodies that are there already."""
    head = Head(
        grid_shape=grid.shape, spacing_m=grid.spacing_m, origin_m=grid.origin_m, rate_hz=25.0,
        frame_count=sum(count for count, _ in segments), axes="x right, y down, z forward", device_name="none",
        device_type=1, force_max_n=3.3, mapping_scale=1.0, mapping_offset_m=(0.0, 0.0, 0.0), weber_fraction=0.1,
        force_threshold_n=0.0, friction=0.2, damping_n_s_per_m=0.0, tags=("direct",), coder="paper",
        coder_parameters=parameters,
    )  # fmt: skip
    golden.write_segments(path, head, segments, "a test, größer als nichts")
    return path


def bits(forces_n: np.ndarray) -> bytes:
    """The forces as bytes; whether a zero is +0 or -0 has no meaning."""
    return (forces_n + np.float32(0)).tobytes()


def assert_same(path: Path) -> None:
    decoded = reference.decode(path)
    with open_stream(path) as opened:
        assert decoded["forces_n"].shape == (len(opened.medium), *opened.grid.shape, 3)
        assert decoded["forces_n"].dtype == np.float32
        np.testing.assert_array_equal(decoded["origin_m"], opened.grid.origin_m)
        np.testing.assert_array_equal(decoded["spacing_m"], opened.grid.spacing_m)
        assert decoded["rate_hz"] == opened.medium.rate_hz
        for i, frame in enumerate(opened.medium):
            assert bits(frame.to_dense()) == bits(decoded["forces_n"][i]), f"frame {i}"


@pytest.mark.parametrize("stream", GOLDEN, ids=lambda p: p.stem)
def test_golden_streams(stream: Path) -> None:
    assert_same(stream)
    with np.load(stream.with_suffix(".npz")) as expected:
        assert bits(reference.decode(stream)["forces_n"]) == bits(expected["forces_n"])


@pytest.mark.parametrize("stream", sorted((CONFORMANCE / "faulty").glob("*.touch")), ids=lambda p: p.stem)
def test_faulty_streams_are_refused(stream: Path) -> None:
    with pytest.raises(ValueError, match=r"\S"):
        reference.decode(stream)


# -- what the encoder makes -------------------------------------------------------------------------------


def moving_wall(shape: tuple[int, int, int], frames: int, seed: int) -> list[ForceField]:
    """A sheet of forces that moves, with noise, and with the third frame of five or more empty."""
    rng = np.random.default_rng(seed)
    x, y, z = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
    made = []
    for t in range(frames):
        depth = z - shape[2] / 2 - 2 * np.sin((x + t) / 3) * np.cos(y / 4)
        amplitude = np.where((depth > 0) & (depth < 4), depth, 0) * (t != 2 or frames < 5)
        normal = np.stack([np.sin(x / 5), np.cos(y / 6), -np.ones(shape)], axis=-1)
        force = amplitude[..., None] * (normal + 0.1 * rng.normal(size=normal.shape))
        made.append(ForceField.from_dense(grid_of(*shape), force.astype(np.float32)))
    return made


def solid(shape: tuple[int, int, int], frames: int) -> list[ForceField]:
    """A block with full bricks, also at the far faces of the grid; it grows."""
    made = []
    for t in range(frames):
        force = np.zeros((*shape, 3), np.float32)
        force[3 - t :, 4:, 2:] = (0.25, -0.5, 1 + t)
        made.append(ForceField.from_dense(grid_of(*shape), force))
    return made


WALL = (20, 17, 19)
STREAMS: dict[str, tuple[list[ForceField], PaperSpec]] = {
    "lloyd-max, closed": (moving_wall(WALL, 5, 1), PaperSpec(segment_frames=3)),
    "no choice of the smaller": (moving_wall(WALL, 3, 2), PaperSpec(choose_by_size=False, nq=2)),
    "alone, scan x, ico1": (moving_wall(WALL, 2, 3), PaperSpec(interframe="none", scan="x", directions="ico1")),
    "scan z, ico3": (moving_wall(WALL, 3, 4), PaperSpec(scan="z", directions="ico3")),
    "weber, octa3": (moving_wall(WALL, 3, 5), PaperSpec(amplitude="weber", directions="octa3", k=0.2)),
    "uniform, ico5-flat": (moving_wall(WALL, 3, 6), PaperSpec(amplitude="uniform", directions="ico5-flat")),
    "open": (moving_wall(WALL, 5, 7), PaperSpec(interframe="open", amplitude="uniform")),
    "literal": (moving_wall(WALL, 3, 8), PaperSpec.literal()),
    "no deadband, nq 12": (moving_wall(WALL, 2, 9), PaperSpec(deadband="none", nq=12)),
    "solid": (solid((24, 21, 19), 3), PaperSpec(k=0.3)),
    "flat grid": (moving_wall((40, 9, 5), 3, 10), PaperSpec(k=0.02, directions="ico3")),
    "single sample": ([ForceField.from_dense(grid_of(1, 1, 1), np.full((1, 1, 1, 3), 2.0))] * 2, PaperSpec()),
    "empty": ([ForceField.empty(grid_of(9, 8, 7))] * 3, PaperSpec()),
}


@pytest.mark.parametrize("name", STREAMS)
def test_streams_of_the_encoder(name: str, tmp_path: Path) -> None:
    frames, spec = STREAMS[name]
    encoder = PaperEncoder(frames[0].grid, spec)
    groups = [frames[i : i + spec.segment_frames] for i in range(0, len(frames), spec.segment_frames)]
    bodies = [(len(group), encoder.encode_segment(group).body) for group in groups]
    assert_same(written(tmp_path / "made.touch", frames[0].grid, encoder.parameters, bodies))


# -- what the format allows -------------------------------------------------------------------------------


def random_support(rng: np.random.Generator, grid: Grid) -> tuple[np.ndarray, np.ndarray]:
    """Some bricks full, some mixed, some absent."""
    shape = np.array(grid.brick_shape)
    chosen = np.argwhere(rng.random(shape) < 0.6).astype(np.int32)
    mask = rng.random((len(chosen), 8, 8, 8)) < rng.choice([0.05, 0.5, 1.0], size=(len(chosen), 1, 1, 1))
    places = 8 * chosen[:, None, None, None] + np.stack(np.indices((8, 8, 8)), axis=-1)
    mask &= (places < grid.shape).all(axis=-1)
    held = mask.any(axis=(1, 2, 3))
    return chosen[held], mask[held]


def random_body(seed: int, grid: Grid, directions: str, kinds: Sequence[FrameKind]) -> bytes:
    """A body of random symbols: kinds of frames in any order, which the encoder would not choose."""
    rng = np.random.default_rng(seed)
    synthesis = Synthesis(grid, Codebook.get(directions), Scan(seed % 2))
    tables = SegmentTables(
        WeberSpec(k=0.3, force_max_n=9.0, criterion="neighbours").fit(np.zeros(0, np.float32)),
        UniformSpec(0.37).fit(np.array([4.0], np.float32)),
    )
    frames, given = [], None
    for kind in kinds:
        bricks, mask = random_support(rng, grid)
        table = tables.intra if kind == FrameKind.INTRA else tables.inter
        assert table is not None
        sent = rng.random(np.count_nonzero(mask)) < rng.choice([0.01, 0.3, 1.0])
        levels = (len(table.levels_n) * rng.random(np.count_nonzero(sent)) ** 3).astype(np.uint16)
        vertices = (len(synthesis.codebook) * rng.random(len(levels)) ** 2).astype(np.uint16)
        support = encode_support(grid, bricks, mask, given if kind == FrameKind.INTER else None)
        frames.append(CodedFrame(FrameSymbols(kind, bricks, mask, sent, levels, vertices), support))
        given = given if kind == FrameKind.DIFFERENCE else (bricks, mask)
    return write_body(synthesis, tables, frames, single_holds=seed % 3 == 0)[0]


@pytest.mark.parametrize("seed", range(6))
def test_any_order_of_kinds(seed: int, tmp_path: Path) -> None:
    grid = grid_of(19, 12, 21)
    kinds = [FrameKind(0), *(FrameKind(k) for k in np.random.default_rng(seed).integers(0, 3, 5).tolist())]
    directions = ("ico2", "octa1", "ico7-flat")[seed % 3]
    body = random_body(seed, grid, directions, kinds)
    assert_same(written(tmp_path / "any.touch", grid, directions.encode(), [(len(kinds), body)]))


def test_a_list_of_bricks_in_a_large_grid() -> None:
    """Few bricks in 4096^3 samples: gaps instead of states, full bricks among them, one at the far corner."""
    grid = grid_of(4096, 4096, 4093)
    rng = np.random.default_rng(5)
    bricks = np.array([[0, 0, 3], [0, 0, 4], [7, 300, 2], [7, 301, 2], [511, 511, 511]])
    fields = []
    for t in range(3):
        forces = rng.normal(size=(len(bricks), 8, 8, 8, 3)) * (rng.random((len(bricks), 8, 8, 8, 1)) < 0.4)
        forces[1] = forces[4] = (0, 1, 2 + t)
        fields.append(ForceField.from_bricks(grid, bricks[t == 1 :], forces[t == 1 :]))
    encoder = PaperEncoder(grid, PaperSpec(k=0.3))
    body = encoder.encode_segment(fields).body
    mine = list(reference.decode_body(body, 3, grid.shape, reference.codebook("ico5")))
    theirs = list(PaperDecoder(grid, encoder.parameters).frames(body, 3))
    for own, field in zip(mine, theirs, strict=True):
        held = {brick: forces for brick, forces in own.items() if forces.any()}
        assert list(held) == [tuple(b) for b in field.bricks.tolist()]
        assert bits(np.stack(list(held.values()))) == bits(field.forces_n)


def test_a_file_too_large_to_lay_out_is_refused(tmp_path: Path) -> None:
    grid = grid_of(4096, 4096, 4096)
    encoder = PaperEncoder(grid, PaperSpec())
    body = encoder.encode_segment([ForceField.empty(grid)]).body
    path = written(tmp_path / "large.touch", grid, encoder.parameters, [(1, body)])
    with pytest.raises(ValueError, match="too many to lay out"):
        reference.decode(path)
    head, frames = reference.decode_bodies(path.read_bytes())
    assert head["shape"] == grid.shape and list(frames) == [{}]


def outcome(decoder: Any, refusal: type[Exception]) -> list[bytes] | None:
    """The frames as bytes, or None where the bytes are refused."""
    try:
        return [bits(forces) for forces in decoder()]
    except refusal:
        return None


def test_both_refuse_the_same_bytes() -> None:
    """Changed bodies: what one decoder refuses the other refuses, and what both take is the same."""
    grid = grid_of(9, 7, 10)
    bodies = [random_body(s, grid, "ico1", [FrameKind(k) for k in (0, 1, 2)]) for s in range(3)]
    rng = np.random.default_rng(2)
    taken = refused = 0
    for _ in range(250):
        body = bytearray(bodies[rng.integers(len(bodies))])
        for _ in range(rng.integers(1, 3)):
            body[rng.integers(len(body))] ^= 1 << rng.integers(8)
        changed = bytes(body[: len(body) - (rng.random() < 0.1)])

        def theirs(data: bytes = changed) -> list[np.ndarray]:
            return [f.to_dense() for f in PaperDecoder(grid, b"ico1").frames(data, 3)]

        def mine(data: bytes = changed) -> list[np.ndarray]:
            fields = []
            for own in reference.decode_body(data, 3, grid.shape, reference.codebook("ico1")):
                forces = np.zeros((0, 8, 8, 8, 3), np.float32) if not own else np.stack(list(own.values()))
                fields.append(ForceField.from_bricks(grid, list(own), forces).to_dense())
            return fields

        expected = outcome(theirs, FormatError)
        assert outcome(mine, ValueError) == expected, changed.hex()
        taken, refused = taken + (expected is not None), refused + (expected is None)
    assert taken > 20 and refused > 20


@pytest.mark.parametrize("seed", range(3))
def test_support_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = grid_of(26, 23, 15)
    before, now = random_support(rng, grid), random_support(rng, grid)
    for previous in (None, before):
        data = encode_support(grid, *now, previous)
        given = {} if previous is None else {tuple(b): m for b, m in zip(previous[0].tolist(), previous[1])}
        mine = reference.decode_support(data, grid.shape, given)
        bricks, mask = decode_support(data, grid, previous)
        assert list(mine) == [tuple(b) for b in bricks.tolist()]
        np.testing.assert_array_equal(np.stack(list(mine.values())), mask)


# -- document, code and reference hold the same tables ----------------------------------------------------


def test_the_tables_have_the_sums_that_the_document_gives() -> None:
    document = (ROOT / "docs" / "format.md").read_text(encoding="utf-8")
    checks = format_chapters.table_checks()
    made = {
        "squash": np.array(reference.SQUASH, "<i4"),
        "stretch": np.array(reference.STRETCH, "<i4"),
        "rates": np.array(reference.RATES, "<i4"),
    }
    assert [len(t) for t in made.values()] == [len(t) for t in (mixer.SQUASH, mixer.STRETCH, mixer.RATES)]
    for name, check in checks.items():
        table = made[name] if name in made else reference.codebook(name).astype("<f4")
        assert f"{zlib.crc32(table.tobytes()):08x}" == check, name
        assert f"`{check}`" in document, name


@pytest.mark.parametrize("name", ["ico0", "ico21", "ico2-flat", "octa6", "octa2-flat", "cube1", ""])
def test_no_other_codebooks(name: str) -> None:
    with pytest.raises(ValueError, match="codebook"):
        reference.codebook(name)


def test_the_neighbours_are_those_of_the_document() -> None:
    assert reference.FIRST == format_chapters.FIRST_OFFSETS
    assert reference.SECOND == format_chapters.SECOND_OFFSETS
    assert reference.BEFORE == format_chapters.BEFORE_OFFSETS
    assert reference.WEIGHTS == format_chapters.WEIGHT_OFFSETS


def test_the_command_line_needs_nothing_of_the_package(tmp_path: Path) -> None:
    body = PaperEncoder(grid_of(9, 8, 7), PaperSpec()).encode_segment(STREAMS["empty"][0]).body
    stream, field = written(tmp_path / "a.touch", grid_of(9, 8, 7), b"ico5", [(3, body)]), tmp_path / "a.npz"
    blocked = "import sys, runpy; sys.modules['touchfield'] = sys.modules['numba'] = None; "
    code = (
        f"{blocked}sys.argv[1:] = {[str(stream), str(field)]!r}; runpy.run_path({str(SCRIPT)!r}, run_name='__main__')"
    )
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)
    with np.load(field) as saved:
        assert saved["forces_n"].shape == (3, 9, 8, 7, 3)
    stream.write_bytes(stream.read_bytes()[:-1])
    failed = subprocess.run([sys.executable, SCRIPT, stream, field], capture_output=True, text=True, timeout=60)
    assert failed.returncode == 1 and failed.stderr.startswith(str(stream)) and "Traceback" not in failed.stderr

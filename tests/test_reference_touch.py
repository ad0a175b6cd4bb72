"""The chapters of docs/format.md on coder `touch` are enough: a decoder that follows them gives the same forces."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from touchfield.codec.touch.body import BodyReader, GuessKind
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import FormatError
from touchfield.medium import ForceField, Grid

CONFORMANCE = Path(__file__).resolve().parents[1] / "conformance"


def loaded(name: str) -> Any:
    """A module of the second decoder; they import each other by name."""
    if str(CONFORMANCE) not in sys.path:
        sys.path.append(str(CONFORMANCE))
    return importlib.import_module(name)


reference: Any = loaded("reference_touch")
whole: Any = loaded("reference_decoder")

GRID = Grid((9, 11, 17), (0.0025, 0.002, 0.001), (-0.01, 0.0, 0.02))
OTHER = Grid((10, 17, 9), (0.001, 0.001, 0.0015), (-0.01, 0.0, 0.02))


def band(grid: Grid, t: float, noise: float = 0.05, axis: int = 2, sense: int = -1) -> ForceField:
    """A wall four samples thick that pushes along an axis, and moves with t."""
    rng = np.random.default_rng(7)
    i = np.moveaxis(np.indices(grid.shape), 0, -1).astype(np.float64)
    a, b = (c for c in range(3) if c != axis)
    depth = i[..., axis] if sense < 0 else grid.shape[axis] - 1 - i[..., axis]
    depth = depth - 4.5 - 1.5 * np.sin((i[..., a] + t) / 3) * np.cos((i[..., b] - t) / 4)
    force = np.zeros((*grid.shape, 3))
    force[..., axis] = sense
    force[..., a] = 0.3 * np.cos((i[..., a] + t) / 3)
    force[..., b] = 0.2 * np.sin(i[..., b] / 4)
    force *= (np.minimum(depth, 4) * ((depth > 0) & (depth < 6)))[..., None] * 0.7
    force += (force != 0) * noise * rng.normal(size=force.shape)
    return ForceField.from_dense(grid, force.astype(np.float32))


def solid(grid: Grid, axis: int, sense: int, step: float = 0.0) -> ForceField:
    """A height map: all behind a bent surface, with a step in it."""
    i = np.moveaxis(np.indices(grid.shape), 0, -1).astype(np.float64)
    a, b = (c for c in range(3) if c != axis)
    depth = i[..., axis] if sense < 0 else grid.shape[axis] - 1 - i[..., axis]
    depth = depth - 3.2 - 1.5 * np.sin(i[..., a] / 5) - step * (i[..., b] > 6.5)
    force = np.zeros((*grid.shape, 3))
    force[..., axis] = sense
    force[..., a] = 0.3 * np.cos(i[..., a] / 5)
    force *= np.clip(depth / 3, 0, 1)[..., None] * 3
    return ForceField.from_dense(grid, force.astype(np.float32))


def box(grid: Grid, t: int) -> ForceField:
    """A small body that moves."""
    i = np.moveaxis(np.indices(grid.shape), 0, -1)
    apart = i - np.array([4 + t, 5, 7 - t]) - 0.5
    inside = (np.abs(apart) < (3, 3, 4)).all(axis=-1)
    return ForceField.from_dense(grid, (apart * inside[..., None] / 3).astype(np.float32))


def assert_same(frames: list[ForceField], spec: TouchSpec) -> list[Any]:
    """Both decoders give the same forces; the records of the segment."""
    grid = frames[0].grid
    encoder = TouchEncoder(grid, spec)
    body = encoder.encode_segment(frames).body
    known = grid.shape, grid.spacing_m, encoder.parameters
    ours = TouchDecoder(grid, encoder.parameters).frames(body, len(frames))
    theirs = reference.decode_touch_body(body, len(frames), *known)
    for i, (one, other) in enumerate(zip(ours, theirs, strict=True)):
        dense = whole.laid_out(other, grid.shape)
        if spec.mode == "lossless":
            assert one.to_dense().tobytes() == dense.tobytes(), f"frame {i}"
        assert (one.to_dense() + np.float32(0)).tobytes() == (dense + np.float32(0)).tobytes(), f"frame {i}"
    with pytest.raises(ValueError, match=r"\S"):
        list(reference.decode_touch_body(body[:-1], len(frames), *known))
    with pytest.raises(ValueError, match=r"\S"):
        list(reference.decode_touch_body(body + b"\0", len(frames), *known))
    return list(BodyReader(body, grid, lossless=spec.mode == "lossless").records(len(frames)))


LIGHT = ("fast", "default")
WAYS = [(0, 1), (0, -1), (1, 1), (1, -1), (2, 1), (2, -1)]


@pytest.mark.parametrize("effort", LIGHT)
@pytest.mark.parametrize(("axis", "sense"), WAYS)
def test_walls_along_each_axis(effort: str, axis: int, sense: int) -> None:
    records = assert_same([band(GRID, t, axis=axis, sense=sense) for t in range(2)], TouchSpec(effort=effort))
    assert all(record.model == LIGHT.index(effort) for record in records)


@pytest.mark.parametrize("effort", LIGHT)
@pytest.mark.parametrize("mode", ["mask", "mask-direction", "nmse"])
@pytest.mark.parametrize("interframe", ["on", "off"])
def test_modes(effort: str, mode: str, interframe: str) -> None:
    spec = TouchSpec(effort=effort, mode=mode, interframe=interframe, support="exact", f0_n=0.01, step_n=0.02)
    records = assert_same([band(OTHER, 0.3 * t, noise=0.3, axis=1) for t in range(3)], spec)
    assert [record.inter for record in records] == [False, interframe == "on", interframe == "on"]


@pytest.mark.parametrize("effort", LIGHT)
def test_sparse_bricks_with_gaps(effort: str) -> None:
    """Bricks that lie apart in all ways: layers left out, tiles beside none, a frame of nothing between others."""
    grid = Grid((41, 33, 40), (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))
    rng = np.random.default_rng(3)
    frames = []
    for count in (9, 0, 12):
        bricks = np.stack(np.unravel_index(rng.choice(6 * 5 * 5, count, replace=False), (6, 5, 5)), axis=-1)
        dense = np.zeros((48, 40, 40, 3), np.float32)
        for b in bricks * 8:
            dense[b[0] : b[0] + 8, b[1] : b[1] + 8, b[2] : b[2] + 8] = rng.normal(size=(8, 8, 8, 3)) * (
                rng.random((8, 8, 8, 1)) < 0.2
            ) + [0, 0, 0.6]
        frames.append(ForceField.from_dense(grid, dense[:41, :33, :40]))
    assert_same(frames, TouchSpec(effort=effort, k=0.3, f0_n=0.4))


@pytest.mark.parametrize("effort", LIGHT)
def test_moved_blocks(effort: str) -> None:
    records = assert_same([box(GRID, t) for t in range(3)], TouchSpec(effort=effort, motion="on", k=0.2))
    assert any(record.guess_kind == GuessKind.MOTION for record in records)


@pytest.mark.parametrize(("axis", "sense"), WAYS)
@pytest.mark.parametrize("step", [0.0, 5.0])
def test_surfaces(axis: int, sense: int, step: float) -> None:
    grid = Grid((18, 17, 11), GRID.spacing_m, GRID.origin_m)
    records = assert_same([solid(grid, axis, sense, step)], TouchSpec(effort="fast", surface="on", k=0.2))
    assert records[0].guess_kind == GuessKind.SURFACE


def lossless_cases() -> dict[str, list[ForceField]]:
    rng = np.random.default_rng(5)
    coarse = [
        ForceField.from_dense(GRID, np.rint(band(GRID, t, noise=0.0).to_dense() * 4) * np.float32(0.3))
        for t in range(2)
    ]
    few = np.array([[0.5, 0.25, -1], [0, -0.0, 2], [0.1, 0.7, 0.3], [-0.1, -0.7, 0.3]], np.float32)
    chosen = [few[rng.integers(4, size=GRID.shape)] * (rng.random((*GRID.shape, 1)) < 0.3) for _ in range(2)]
    octets = np.where(rng.random((9, 8, 5, 1)) < 0.4, 1 + rng.random((9, 8, 5, 3)), 0).astype(np.float32)
    small = Grid((9, 8, 5), GRID.spacing_m, GRID.origin_m)
    return {
        "components of a unit": coarse,
        "vectors": [ForceField.from_dense(GRID, frame.astype(np.float32)) for frame in chosen],
        "octets": [ForceField.from_dense(small, octets), ForceField.from_dense(small, octets[::-1].copy())],
        "empty": [coarse[0], ForceField.empty(GRID), coarse[1]],
        "plain": [ForceField.from_dense(small, octets * (np.arange(octets.size).reshape(octets.shape) < 30))],
    }


@pytest.mark.parametrize("name", lossless_cases())
def test_lossless(name: str) -> None:
    assert_same(lossless_cases()[name], TouchSpec(mode="lossless"))


def test_lossless_products() -> None:
    """A field as coder `paper` makes it."""
    vertices = whole.codebook("ico3")
    i = np.moveaxis(np.indices(GRID.shape), 0, -1)
    level = (np.clip(i[..., 2] - 5, 0, 6) * 0.37).astype(np.float32)
    force = level[..., None] * vertices[(i[..., 0] // 3 + i[..., 1] // 4) % len(vertices)]
    assert_same([ForceField.from_dense(GRID, force)], TouchSpec(mode="lossless"))


def told_of(damages: int, grid: Grid, effort: str) -> int:
    """Of so many damaged bodies, how many both decoders refuse; of the others both make the same fields."""
    encoder = TouchEncoder(grid, TouchSpec(effort=effort, k=0.25, f0_n=0.3))
    body = encoder.encode_segment([band(grid, 0.0, noise=0.0), band(grid, 0.4, noise=0.0)]).body
    rng = np.random.default_rng(11)
    known = grid.shape, grid.spacing_m, encoder.parameters
    decoder = TouchDecoder(grid, encoder.parameters)
    told = 0
    for _ in range(damages):
        data = bytearray(body)
        data[int(rng.integers(len(data)))] ^= 1 << int(rng.integers(8))
        try:
            ours = [frame.to_dense() for frame in decoder.frames(bytes(data), 2)]
        except FormatError:
            told += 1
            with pytest.raises(ValueError, match=r"\S"):
                list(reference.decode_touch_body(bytes(data), 2, *known))
            continue
        theirs = [whole.laid_out(f, grid.shape) for f in reference.decode_touch_body(bytes(data), 2, *known)]
        assert all((a == b).all() for a, b in zip(ours, theirs, strict=True))
    return told


@pytest.mark.parametrize("effort", LIGHT)
def test_damage_is_told_by_both_or_decoded_alike(effort: str) -> None:
    assert 5 < told_of(60, Grid((9, 10, 9), GRID.spacing_m, GRID.origin_m), effort) < 60


def test_lattice_and_geometry() -> None:
    from touchfield.codec.kernels import touch_lattice as kernels

    rng = np.random.default_rng(2)
    axes, out = np.zeros((3, 3), np.int64), np.zeros(3, np.int64)
    for floor, rate in ((21, 0), (1, 64), (1, 131071), (700, 7405), (65535, 0), (65535, 131071), (37, 1)):
        lattice = reference.Lattice(np.float32(1), floor, rate, floor, rate)
        border, first = kernels.warp_table(floor, rate)
        assert lattice.borders == border.tolist()
        for a in (0, 1, 5, 31, 32, 1000, 65536, (1 << 18) - 1, *rng.integers(1 << 18, size=20).tolist()):
            level = lattice.level_of(a)
            assert level == kernels.level_of(np.int64(a), border, first)
            for other in (level, -level, level + 256, level * 3):
                assert lattice.amplitude_of(other) == kernels.amplitude_of(np.int64(other), border)
            assert lattice.cross_step(a) == kernels.step_at(np.int64(a), floor, rate)
    for _ in range(200):
        p = [int(n) for n in rng.integers(-(1 << 17) + 1, 1 << 17, size=3) >> int(rng.integers(17))]
        length = max(1, reference.root(sum(n * n for n in p)))
        kernels.axes_along(*map(np.int64, p), np.int64(length), axes)
        assert np.array(reference.along_axes(tuple(p), length)).tolist() == axes.tolist()
        told = [int(n) for n in rng.integers(-(1 << 19), 1 << 19, size=3)]
        kernels.rebuild(*map(np.int64, told), axes, out)
        assert list(reference.rebuilt(*told, reference.along_axes(tuple(p), length))) == out.tolist()

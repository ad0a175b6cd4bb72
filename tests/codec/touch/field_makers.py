"""Random and smooth fields of every kind, for the tests of coder `touch`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid

__all__ = ["GRID", "KINDS", "SHAPES", "case_of", "field_of", "hills", "round_trip"]

GRID = Grid((20, 17, 13), (0.001, 0.002, 0.0015), (0.0, 0.01, -0.02))

KINDS = (
    "empty",
    "sparse",
    "dense",
    "constant",
    "noise",
    "one",
    "checkerboard",
    "denormal",
    "threshold",
    "huge",
    "full",
)

SHAPES = ((1, 1, 1), (1, 1, 1000), (700, 1, 2), (8, 8, 8), (9, 7, 10), (32, 32, 1), (20, 17, 13), (3, 150, 2))


def field_of(kind: str, seed: int, grid: Grid = GRID) -> ForceField:
    """A random field."""
    rng = np.random.default_rng(seed)
    shape, f = grid.shape, np.zeros((*grid.shape, 3), np.float32)
    if kind == "sparse":
        where = rng.random(shape) < 0.02
        f[where] = rng.normal(0, 1, (int(where.sum()), 3))
    elif kind == "dense":
        x, y, z = np.meshgrid(*(np.arange(n) for n in shape), indexing="ij")
        f[:] = np.stack([np.sin(x / 5 + seed), np.cos(y / 4), 1 + z / 9], -1)
    elif kind == "constant":
        f[:] = rng.normal(0, 1, 3)
    elif kind == "noise":
        f[:] = rng.normal(0, 0.1, f.shape)
    elif kind == "one":
        f[tuple(rng.integers(0, shape))] = rng.normal(0, 1, 3)
    elif kind == "checkerboard":
        f[np.indices(shape).sum(0) % 2 == 0] = rng.normal(0, 1, 3)
    elif kind == "denormal":
        where = rng.random(shape) < 0.03
        f[where] = (rng.normal(0, 1, (int(where.sum()), 3)) * 1e-40).astype(np.float32)
    elif kind == "threshold":  # |F| at F_0 and the adjacent float32 values
        where = rng.random(shape) < 0.05
        f[where, 2] = np.float32(0.05) + np.float32(2.0**-28) * rng.integers(-3, 4, int(where.sum()))
        f[0, 0, 0] = 2.0
    elif kind == "huge":  # 1e-30 N next to 1e30 N
        where = rng.random(shape) < 0.03
        size = 10 ** rng.uniform(-30, 30, (int(where.sum()), 1))
        f[where] = (rng.normal(0, 1, (int(where.sum()), 3)) * size).astype(np.float32)
    elif kind == "full":
        f[:] = rng.normal(0, 1, f.shape) * 10 ** rng.uniform(-3, 1, (*shape, 1))
    elif kind != "empty":
        raise ValueError(kind)
    return ForceField.from_dense(grid, f)


def hills(depth: int, wall: int | None = None, lift: float = 0.0) -> ForceField:
    """A penalty field towards -z below a wavy surface: `wall` voxels thick, or solid if None."""
    grid = Grid((40, 33, depth), (0.001, 0.001, 0.0007), (0.0, 0.0, 0.0))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    inside = z - (9 + lift + 3 * np.sin(x / 6) * np.cos(y / 7))
    supported = (inside > 0) & (True if wall is None else inside < wall)
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[..., 2] = -np.where(supported, np.minimum(0.35 * inside, 3.3), 0)
    forces[..., 0] = np.where(supported, 0.2 * forces[..., 2] * np.cos(x / 6), 0)
    return ForceField.from_dense(grid, forces)


def round_trip(frames: list[ForceField], spec: TouchSpec) -> tuple[bytes, TouchDecoder, list[ForceField]]:
    """A segment's body, its decoder, and the decoded frames."""
    encoder = TouchEncoder(frames[0].grid, spec)
    body = encoder.encode_segment(frames).body
    decoder = TouchDecoder(frames[0].grid, encoder.parameters)
    return body, decoder, list(decoder.frames(body, len(frames)))


def case_of(seed: int) -> tuple[list[ForceField], TouchSpec]:
    """Random frames on a random grid, and random options of the coder."""
    rng = np.random.default_rng(seed)
    shape = SHAPES[rng.integers(len(SHAPES))]
    grid = Grid(shape, (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))
    kinds = rng.choice(KINDS, int(rng.integers(1, 4)))
    frames = [field_of(str(kind), int(rng.integers(1 << 30)), grid) for kind in kinds]
    if rng.random() < 0.3:  # a copy of the previous frame
        frames.append(frames[-1].scaled(float(rng.choice([1.0, 1.03, 0.5, -1.0]))))
    spec = TouchSpec(
        k=float(rng.choice([0.001, 0.02, 0.1, 0.25, 0.9])),
        f0_n=float(rng.choice([0.0, 1e-30, 0.001, 0.05, 1.0, 100.0])),
        mode=str(rng.choice(["mask", "mask", "mask-direction"])),
        direction_jnd_deg=float(rng.choice([0.5, 18.4, 89.0])),
        effort=str(rng.choice(["fast", "default"])),
        support=str(rng.choice(["movable", "movable", "exact"])),
        guess=str(rng.choice(["auto", "auto", "off"])),
        interframe=str(rng.choice(["auto", "auto", "off", "on"])),
    )
    masking = float(rng.choice([0.0, 0.0, 0.05, 1.0]))
    return frames, replace(spec, masking=masking, masking_radius_m=0.0041) if spec.mode == "mask" else spec

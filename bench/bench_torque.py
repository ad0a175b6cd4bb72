"""Measures whether storing a torque at each sample is worth it: its bytes, and its error when the hand tilts
the tool.

    python bench/bench_torque.py [--nw N] [--quick]

A tool of points computes its torque from the force field, as the sum of r x F over its points
(`render.tool`), and turns with the hand. A torque stored at each sample would be valid for one tool in one
orientation only. This benchmark tests whether storing it would be accurate enough.

The torque is computed for a pen of 60 mm and a sphere of 5 mm, held upright, at all samples near a surface,
and coded by `touch` like a force (k 0.1; F_0 times 10 mm). Then the hand tilts, and the upright torque is
compared with the torque of the tilted points. A torque record in the medium would be worthwhile if, at the
tilt of a pen of a writing hand (20 degrees), at most a tenth of the positions were off by more than a tenth.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from machine import Bar, Figures, at_most, bench
from touchfield import EncodeSpec, prepare
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField
from touchfield.render.tool import Tool

SOURCES = ("sample:terrain", "sample:motorcycle", "sample:shapes")
TILTS_DEG = (5, 10, 20, 45)
K, F0_N, LEVER_M = 0.1, 0.05, 0.01
POSITIONS, REACH_M = 500, 0.005
Float64s = NDArray[np.float64]


def pen(length_m: float = 0.06, radius_m: float = 0.004, points: int = 200) -> Tool:
    """Return a cylinder that points towards the user (z is forward).

    Its far end, a round tip, is at the device's point.
    """
    n = np.arange(points)
    height, turn = (n + 0.5) / points * length_m, n * 2.399963
    radial = np.stack([np.cos(turn), np.sin(turn), np.zeros(points)], axis=-1)
    tip = Tool.sphere(radius_m, 50)
    low = tip.normals[:, 2] > 0
    shaft = radius_m * radial + height[:, None] * [0, 0, -1]
    return Tool(np.concatenate([tip.points_m[low], shaft]), np.concatenate([tip.normals[low], radial]), "pen")


def torque(field: ForceField, tool: Tool, at: Float64s, turns: Rotation | None = None) -> Float64s:
    """Return the torque about the device's point at `at` [n, 3], N m [n, 3].

    `turns` [n] rotate the tool.
    """
    total = np.zeros_like(at)
    for point, normal in zip(tool.points_m, tool.normals, strict=True):
        arm = np.broadcast_to(point, at.shape) if turns is None else turns.apply(np.array(point))
        out = np.broadcast_to(normal, at.shape) if turns is None else turns.apply(np.array(normal))
        force = field.sample_n(at + arm).astype(np.float64)
        length = np.linalg.norm(force, axis=-1, keepdims=True)
        facing = np.maximum(0, -(out * force).sum(axis=-1, keepdims=True) / np.maximum(length, 1e-12))
        total += np.cross(arm, facing * force)
    return total * 4 / len(tool)


def stored_torque(field: ForceField, tool: Tool) -> ForceField:
    """Return the torque at all samples of the bricks of a field, N m in place of N."""
    grid, bricks = field.grid, field.bricks
    local = np.stack(np.meshgrid(*(np.arange(8),) * 3, indexing="ij"), axis=-1)
    index = 8 * bricks[:, None, None, None, :].astype(np.int64) + local
    at = np.asarray(grid.origin_m) + index * np.asarray(grid.spacing_m)
    torques = torque(field, tool, at.reshape(-1, 3)).reshape(index.shape)
    torques[(index >= np.asarray(grid.shape)).any(axis=-1)] = 0
    some = torques.any(axis=(1, 2, 3, 4))
    return ForceField(grid, bricks[some], torques[some].astype(np.float32))


def measure(nw: int) -> Figures:
    """Measure each source and tool."""
    rows: dict[str, Figures] = {}
    for source in SOURCES:
        field = prepare(source, EncodeSpec(nw=nw, representation="voxel")).medium[0]
        force_bytes = len(TouchEncoder(field.grid, TouchSpec(k=K, f0_n=F0_N)).encode_segment([field]).body)
        rng = np.random.default_rng(1)
        for tool in (pen(), Tool.sphere(0.005, 200)):
            torque_field = stored_torque(field, tool)
            spec = TouchSpec(k=K, f0_n=F0_N * LEVER_M)
            torque_bytes = len(TouchEncoder(torque_field.grid, spec).encode_segment([torque_field]).body)
            at = np.asarray(field.grid.origin_m) + field.positions() * np.asarray(field.grid.spacing_m)
            at = at[rng.integers(0, len(at), POSITIONS)] + rng.uniform(-REACH_M, REACH_M, (POSITIONS, 3))
            upright = torque(field, tool, at)
            row: Figures = {"bytes_over_force": torque_bytes / force_bytes}
            for tilt in TILTS_DEG:
                axis = rng.normal(size=(POSITIONS, 2))
                axis = np.radians(tilt) * axis / np.linalg.norm(axis, axis=-1, keepdims=True)
                now = torque(field, tool, at, Rotation.from_rotvec(np.pad(axis, ((0, 0), (0, 1)))))
                error, size = np.linalg.norm(upright - now, axis=-1), np.linalg.norm(now, axis=-1)
                is_strong = np.maximum(size, np.linalg.norm(upright, axis=-1)) > F0_N * LEVER_M
                row[f"off_at_{tilt}"] = float(
                    (error > np.maximum(F0_N * LEVER_M, K * size))[is_strong].mean()
                )
            rows[f"{source}, {tool.name}"] = row
    return {"tools": rows}


def bars(figures: Figures) -> list[Bar]:
    """Test whether a stored torque is accurate enough."""
    worst = max(row["off_at_20"] for row in figures["tools"].values())
    return [
        at_most(
            "torque: places where what is stored is off by a tenth when the tool tilts by 20 degrees",
            worst,
            0.1,
        )
    ]


if __name__ == "__main__":
    bench("torque", __doc__, measure, bars, nw=(6, 5))

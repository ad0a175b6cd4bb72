"""The surface and the first slice of the page: closed around an object, open where only the source ends."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import drive, needs_browser, step

import touchfield as tf
from touchfield.codec.touch.spec import TouchSpec
from touchfield.pipeline.spec import EncodeSpec

pytestmark = needs_browser

STIFFNESS_N_PER_M, PEAK_N = 500.0, 3.3
SLOPES = (0.0, 0.0), (-0.5, 0.3), (0.8, 0.0)
DEPTHS_M = 0.022, 0.031
EXACT = EncodeSpec(touch=TouchSpec(mode="lossless"))


def block_of_terrain(depth_m: float, slope: tuple[float, float]) -> tf.ForceField:
    """A tilted plane over a rectangle, solid down to a depth; forces at the rim are those of the plane."""
    grid = tf.Grid((40, 36, 64), (0.002, 0.002, 0.001), (-0.039, -0.035, -0.0315))
    x, y, z = np.meshgrid(*[grid.axis_m(axis) for axis in range(3)], indexing="ij")
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope[0] ** 2 + slope[1] ** 2)
    depths_m = (0.012 + slope[0] * x + slope[1] * y - z) * normal[2]
    size_n = np.minimum(STIFFNESS_N_PER_M * depths_m, PEAK_N)
    is_inside = (depths_m > 0) & (abs(x) < 0.03) & (abs(y) < 0.026) & (z > -depth_m)
    return tf.ForceField.from_dense(
        grid, np.where(is_inside, size_n, 0)[..., None].astype(np.float32) * normal.astype(np.float32)
    )


def ball() -> tf.ForceField:
    grid = tf.Grid((40, 40, 40), (0.002, 0.0015, 0.001), (-0.039, -0.02925, -0.0195))
    x = np.stack(np.meshgrid(*[grid.axis_m(axis) for axis in range(3)], indexing="ij"), axis=-1)
    distance_m = np.linalg.norm(x, axis=-1, keepdims=True)
    size_n = np.minimum(STIFFNESS_N_PER_M * np.maximum(0.016 - distance_m, 0), PEAK_N)
    return tf.ForceField.from_dense(grid, (size_n * x / distance_m).astype(np.float32))


def abrupt_block() -> tf.ForceField:
    """A block whose force is full from its faces on, and oblique to most: it points away from a middle."""
    grid = tf.Grid((20, 20, 28), (0.002, 0.0015, 0.002), (-0.019, -0.01425, -0.027))
    x = np.stack(np.meshgrid(*[grid.axis_m(axis) for axis in range(3)], indexing="ij"), axis=-1)
    is_inside = (abs(x) < [0.012, 0.009, 0.022]).all(axis=-1, keepdims=True)
    directions = x / np.linalg.norm(x, axis=-1, keepdims=True)
    return tf.ForceField.from_dense(grid, np.where(is_inside, 2.0 * directions, 0).astype(np.float32))


def bars(wide: float) -> tf.ForceField:
    """Forces along y in a long bar along x, and, at `wide` of its length, many small ones across it."""
    grid = tf.Grid((50, 40, 16), (0.002,) * 3, (-0.049, -0.039, -0.015))
    dense = np.zeros((*grid.shape, 3), np.float32)
    dense[2:48, 18:22, 4:12, 1] = 1.0
    at = 2 + round(wide * 45)
    for y in range(4, 36, 4):
        dense[at - 1 : at + 2, y : y + 2, 4:12, 1] = 2.0
    return tf.ForceField.from_dense(grid, dense)


def boundary_faces(field: tf.ForceField, threshold_n: float) -> int:
    """Edges of the lattice between a sample above the threshold and one below."""
    is_above = np.pad(np.linalg.norm(field.to_dense(), axis=-1) > threshold_n, 1)
    return sum(int(np.count_nonzero(np.diff(is_above, axis=axis))) for axis in range(3))


def states(folder: Path, page: str, fields: dict[str, tf.ForceField]) -> dict[str, dict[str, Any]]:
    """The state of the page once it shows each field."""
    steps = [step("goto", url=page)]
    for name, field in fields.items():
        path = folder / f"{name}.touch"
        tf.encode(
            tf.HapticMedium.from_frames([field], 30.0, "x right, y up, z towards the viewer"), path, EXACT
        )
        steps += [step("open", file=path), step("state")]
    result = drive(folder, *steps)
    assert result.errors == []
    return dict(zip(fields, result.answers[2::2], strict=True))


def test_a_surface_is_closed_and_ends_where_its_source_does(page: str, tmp_path: Path) -> None:
    fields = {
        "ball": ball(),
        "pull": ball().scaled(-1.0),
        "abrupt": abrupt_block(),
        "left": bars(0.6),
        "right": bars(0.85),
    }
    for slope in SLOPES:
        fields |= {f"{slope} {depth_m}": block_of_terrain(depth_m, slope) for depth_m in DEPTHS_M}
    found = states(tmp_path, page, fields)
    for name in ("ball", "pull", "abrupt"):
        head = found[name]["head"]
        threshold_n = min(head["threshold"], 0.05 * head["peak"]) or 0.02 * head["peak"]  # as the page has it
        faces = boundary_faces(fields[name], threshold_n)
        assert found[name]["triangles"] == pytest.approx(2 * faces, rel=0.01), f"{name} has no hole"
    for name, wide in (("left", 0.6), ("right", 0.85)):
        x_m = fields[name].grid.axis_m(0)[2 + round(wide * 45)]
        assert found[name]["axis"] == 0 and found[name]["cut"] == pytest.approx(x_m, abs=0.0035)
    for slope in SLOPES:
        shallow, deep = (found[f"{slope} {depth_m}"]["triangles"] for depth_m in DEPTHS_M)
        assert 2 * 30 * 26 <= deep == shallow, "the sides are not drawn further down"

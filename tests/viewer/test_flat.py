"""The page in a browser without WebGL: a slice in place of the surface, and all else as before."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from browser import ROOT, WITHOUT_WEBGL, drive, needs_browser, step

import touchfield as tf

pytestmark = needs_browser

SOLID = ROOT / "conformance" / "v1" / "touch-solid.touch"
STRIDE = 8
NEWTONS_PER_M = 400.0


@pytest.fixture(scope="module")
def terrain(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, np.ndarray, tf.Grid]:
    """A file of the Jacksboro fault, its heights, metres, float64 [x, y], and its grid."""
    pytest.importorskip("matplotlib", reason="the elevation model is a sample of matplotlib")
    from matplotlib import cbook

    with np.load(cbook.get_sample_data("jacksboro_fault_dem.npz", asfileobj=False)) as sample:
        elevation = sample["elevation"][::-STRIDE, ::STRIDE].T.astype(float)  # from the west, from the south
    heights_m = 0.04 * (elevation - elevation.min()) / np.ptp(elevation)
    grid = tf.Grid((*heights_m.shape, 48), (0.003, 0.003, 0.001), (-0.074, -0.063, -0.024))
    z_m = grid.origin_m[2] + grid.spacing_m[2] * np.arange(48)
    depth_m = np.clip(heights_m[..., None] - 0.021 - z_m, 0, None)
    force_n = np.zeros((*grid.shape, 3), np.float32)
    force_n[..., 2] = np.minimum(NEWTONS_PER_M * depth_m, 3.0)
    medium = tf.HapticMedium.from_array(force_n, grid, axes="x east, y north, z up")
    path = tmp_path_factory.mktemp("terrain") / "terrain.touch"
    tf.encode(medium, path)
    return path, heights_m, grid


def test_highest_point_is_found_by_keys_and_speech(
    page: str, terrain: tuple[Path, np.ndarray, tf.Grid], tmp_path: Path
) -> None:
    path, heights_m, grid = terrain
    result = drive(
        tmp_path,
        step("goto", url=page),
        step("open", file=path),
        step("text", id="spoken"),
        step("climb"),
        step("state"),
        flags=WITHOUT_WEBGL,
    )
    assert result.errors == []
    opened, last, state = result.answers[2:5]
    assert "no WebGL" in opened and "f follows the surface" in opened
    assert "falls on all sides" in last
    height_mm, most_mm = map(float, re.findall(r"\d+\.\d+", last)[:2])
    assert height_mm == pytest.approx(most_mm, abs=0.05) and most_mm == pytest.approx(40, abs=1.5)
    x_mm, y_mm = (int(found) for found in re.findall(r"[xy] (-?\d+)", last))
    head = state["head"]
    middle_m = np.array(head["origin"][:2]) + 0.5 * np.array(head["spacing"][:2]) * (
        np.array(head["shape"][:2]) - 1
    )
    for found_m in (middle_m + np.array([x_mm, y_mm]) / 1e3, np.array(state["point"][:2])):
        column = np.rint((found_m - grid.origin_m[:2]) / grid.spacing_m[:2]).astype(int)
        # the error bound of the file may exchange two columns: the second highest is 0.15 mm lower
        assert heights_m[tuple(column)] > heights_m.max() - 0.0002

"""The picture of a comparison: the force at its position, in millimetres and in units of the mask."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.medium import ForceField, Grid
from touchfield.viewer.picture import _Panels

figure = pytest.importorskip("matplotlib.figure", reason="pictures need the extra report")

GRID = Grid((12, 10, 16), (0.002, 0.003, 0.001), (-0.01, 0.02, 0.005))
PLATE = (slice(3, 9), slice(4, 8), slice(6, 9))
K, F0_N = 0.1, 0.05


def plate(force_n: float) -> ForceField:
    """A plate of three samples along z."""
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[PLATE] = (0.0, 0.0, force_n)
    return ForceField.from_dense(GRID, forces)


def drawn(axes: str, decoded: ForceField) -> tuple[_Panels, list[np.ndarray], list[list[float]]]:
    """The panels, and the images of the first row with their extents."""
    panels = _Panels(plate(1.0), decoded, axes, (K, F0_N))
    page = figure.Figure()
    row = page.subplots(1, 3)
    panels.draw_contact(page, row)
    images = [panel.images[0] for panel in row]
    return (
        panels,
        [np.ma.filled(image.get_array(), np.nan) for image in images],
        [image.get_extent() for image in images],
    )


@pytest.mark.parametrize(
    ("axes", "index"), [("x right, y down, z forward", 6), ("x right, y up, z towards the user", 8)]
)
def test_a_hand_from_the_viewer_reaches_the_nearer_face(axes: str, index: int) -> None:
    _, (source, decoded, _), _ = drawn(axes, plate(1.0))
    expected_mm = 1e3 * (GRID.origin_m[2] + index * GRID.spacing_m[2])
    for depth in (source, decoded):
        assert np.isfinite(depth).sum() == 6 * 4
        assert depth[np.isfinite(depth)] == pytest.approx(expected_mm, abs=1e-6)


def test_a_picture_is_aligned_with_the_samples() -> None:
    panels, _, extents = drawn("x right, y up, z towards the user", plate(1.0))
    for low_mm, high_mm, axis in ((extents[0][0], extents[0][1], 0), (extents[0][2], extents[0][3], 1)):
        half_mm = PLATE[axis]
        first, last = (
            1e3 * (GRID.origin_m[axis] + i * GRID.spacing_m[axis]) for i in (half_mm.start, half_mm.stop - 1)
        )
        half = 500 * GRID.spacing_m[axis]
        assert low_mm == pytest.approx(first - 3 * half) and high_mm == pytest.approx(last + 3 * half), (
            "one around"
        )
    at_mm = 1e3 * (GRID.origin_m[1] + 6 * GRID.spacing_m[1])
    assert panels._slice_name() == f"slice at y = {at_mm:.1f} mm", "the middle one of equal slices"


def test_an_error_is_in_units_of_the_mask() -> None:
    _, (_, _, worst), _ = drawn("x right, y up, z towards the user", plate(1.25))
    assert worst[np.isfinite(worst)] == pytest.approx(2.5, rel=1e-6) and np.isfinite(worst).sum() == 6 * 4
    forces = plate(1.0).to_dense() * 0
    forces[0, 0, 0] = (0.02, 0.0, 0.0)
    panels = _Panels(ForceField.from_dense(GRID, forces), ForceField.empty(GRID), "", (K, F0_N))
    assert np.nanmax(panels.error) == pytest.approx(0.02 / F0_N, rel=1e-6), "below F_0 it is in units of that"

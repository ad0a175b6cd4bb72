"""The slice of a field that a picture shows: across which axis, where, how it is turned and cropped."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.medium import ForceField, Grid
from touchfield.viewer import picture
from touchfield.viewer.picture import draw_comparison
from touchfield.viewer.slices import FieldSlice, choose_slice, supported_span

STEP = (0.001, 0.001, 0.001)


def ball(shape: tuple[int, int, int], middle: tuple[int, int, int], radius: float) -> np.ndarray:
    """Forces that push out of a ball, 1 N at a tenth of its radius, float32 [x, y, z, 3]."""
    offset = np.stack(np.indices(shape), -1) - np.array(middle)
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    forces = np.where(distance < radius, (radius - distance) * offset / np.maximum(distance, 1e-9), 0)
    return (10 / radius * forces).astype(np.float32)


@pytest.mark.parametrize("axis", [0, 1, 2])
def test_a_disc_is_shown_from_its_face(axis: int) -> None:
    """A disc pushes outwards: its forces lie in the planes of its faces, and cross most of those across."""
    flat = ball((24, 24, 1), (12, 12, 0), 8)
    disc = np.repeat(flat, 8, axis=2)
    turned = np.moveaxis(disc, 2, axis)
    forces = np.zeros_like(turned)
    forces[..., [n for n in range(3) if n != axis]] = turned[..., :2]
    weak = np.arange(8) < 2
    forces[tuple(weak if n == axis else slice(None) for n in range(3))] *= 0.5
    chosen = choose_slice(forces, STEP)
    assert chosen.axis == axis and chosen.index == 5, "the middle one of six that are equal"


def test_a_level_section_of_a_tilted_block_is_not_shown() -> None:
    """Its area is the largest, and so is the energy of the parts in its plane, but the forces cross it."""
    forces = np.zeros((60, 60, 12, 3), np.float32)
    forces[2:58, 2:58, :10] = (1.2, 1.2, 3.0)
    in_plane = [
        (np.delete(forces, axis, -1) ** 2).sum(axis=(-1, *(n for n in range(3) if n != axis))).max()
        for axis in range(3)
    ]
    assert np.argmax(in_plane) == 2
    assert choose_slice(forces, STEP).axis == 1


def test_of_planes_across_one_axis_the_one_that_cuts_the_most_surface_is_shown() -> None:
    forces = np.zeros((40, 30, 30, 3), np.float32)
    forces[5:25, 3:27, 3:20, 2] = 3.0  # a block
    for y in range(4, 26, 4):  # and a comb beside it, of less force
        forces[30:36, y : y + 2, 3:20, 2] = 2.0
    assert choose_slice(forces, (0.001, 0.002, 0.001)).axis == 0
    assert choose_slice(forces, (0.001, 0.002, 0.001)).index in range(30, 36)


@pytest.mark.parametrize(
    ("axes", "across", "up"),
    [("x right, y down, z forward", 2, 1), ("x right, y up, z towards the viewer", 2, 1),
     ("x east, y north, z up", 1, 2), ("", 1, 2)],
)  # fmt: skip
def test_an_axis_that_points_up_or_down_is_drawn_vertically(axes: str, across: int, up: int) -> None:
    forces = np.zeros((8, 20, 20, 3), np.float32)
    forces[4, 2:18, 3:17] = (0, 1, 1)
    chosen = choose_slice(forces, STEP, axes)
    assert chosen == FieldSlice(0, 4, across, up)
    expected = forces[4] if across < up else forces[4].swapaxes(0, 1)
    np.testing.assert_array_equal(chosen.of(forces), expected)


def test_a_field_without_forces_and_an_array_have_a_slice() -> None:
    empty = choose_slice(np.zeros((6, 8, 10, 3), np.float32), STEP)
    assert (empty.axis, empty.index) == (1, 4)
    array = np.zeros((6, 8, 1, 3), np.float32)
    array[..., 2] = 1
    assert choose_slice(array, STEP) == FieldSlice(2, 0, 0, 1)


def test_a_span_has_a_margin_of_a_twentieth() -> None:
    has_force = np.zeros((100, 50), bool)
    has_force[20:61, 10] = True
    assert supported_span(has_force, 0) == slice(17, 64) and supported_span(has_force, 1) == slice(9, 12)
    assert supported_span(np.zeros((7, 3), bool), 0) == slice(0, 7)


def test_each_row_is_cropped_to_its_forces_with_arrows_in_the_plane(monkeypatch: pytest.MonkeyPatch) -> None:
    """A ball and a small plate far from its slice: the plate widens the front view, not the slice."""
    pytest.importorskip("matplotlib", reason="pictures need the extra report")
    from matplotlib.quiver import Quiver

    figures: list = []
    monkeypatch.setattr(picture, "write_png", lambda figure, path: figures.append(figure))
    grid = Grid((64, 48, 48), STEP, (0.0, 0.0, 0.0))
    forces = ball(grid.shape, (20, 24, 24), 12) * np.float32([0.5, 1, 1])  # less across the slice
    forces[60:62, 2:6, 24, 2] = 0.5
    field = ForceField.from_dense(grid, forces)
    draw_comparison(
        "x.png", field, field, "t", "x right, y down, z forward", (0.1, 0.05), ("before", "after", "change")
    )
    panels = [panel for panel in figures[0].axes if panel.get_label() != "<colorbar>"]
    front, amplitude, direction = panels[0], panels[3], panels[6]
    assert front.get_xlim()[1] > 61 and amplitude.get_title() == "before |F|, slice at x = 20.0 mm"
    assert panels[4].get_title().startswith("after |F|") and panels[5].get_title().startswith("change, in")
    for panel in (amplitude, direction):
        assert (panel.get_xlabel(), panel.get_ylabel()) == ("z / mm", "y / mm") and panel.yaxis_inverted()
        for limits in (panel.get_xlim(), panel.get_ylim()):
            assert sorted(limits) == pytest.approx([10.5, 37.5], abs=1.01)
    (arrows,) = direction.findobj(Quiver)
    drawn = np.stack([arrows.U, arrows.V], axis=1)
    outward = arrows.XY - 24
    is_far = np.linalg.norm(outward, axis=1) > 3
    along = (drawn * outward).sum(axis=1) / np.linalg.norm(drawn, axis=1) / np.linalg.norm(outward, axis=1)
    assert is_far.sum() > 50 and along[is_far] == pytest.approx(1, abs=1e-5), "they point outwards"
    assert abs(arrows.get_array()).max() < 1e-6, "and no force leaves the plane through the middle"

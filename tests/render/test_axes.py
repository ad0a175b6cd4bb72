"""Descriptions of axes: those of every shipped profile and every kind of source, round trips,
invalid texts.
"""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from player_makers import AXES, GRID, OMNI, Simulated, numbered_medium

from touchfield.devices import devices
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, HapticMedium
from touchfield.render.block import Memory
from touchfield.render.offline import run_offline
from touchfield.render.player import Session
from touchfield.render.point_device import (
    BOX_AXES,
    Point,
    axes_matrix,
    axes_notes,
    axes_of_text,
    signed_axes,
)
from touchfield.render.spec import RenderSpec
from touchfield.sources.scene import CAMERA_AXES, UP_Y_AXES, UP_Z_AXES

DIRECTIONS = (
    ("right", "left", "rightwards", "to the left"),
    ("up", "down", "upwards", "downwards"),
    ("towards the user", "away from the user", "back", "forward", "towards the viewer", "toward the user"),
)


@st.composite
def texts(draw: st.DrawFn) -> tuple[str, np.ndarray]:
    """A valid text and its matrix."""
    order = draw(st.permutations(range(3)))
    matrix, parts = np.zeros((3, 3)), []
    for n, axis in enumerate(order):
        word = draw(st.sampled_from(DIRECTIONS[axis]))
        sign = -1 if any(w in word for w in ("left", "down", "away", "forward")) else 1
        matrix[axis, n] = sign
        parts.append(f"{'xyz'[n]} {word}")
    text = ", ".join(draw(st.permutations(parts)))
    return draw(st.sampled_from([text, text.upper(), f" {text} "])), matrix


@given(texts(), texts())
def test_axes_of_a_device_round_trip(
    device_case: tuple[str, np.ndarray], field_case: tuple[str, np.ndarray]
) -> None:
    (text, matrix), (field_text, field) = device_case, field_case
    read = axes_of_text(text)
    assert read is not None
    assert (read == matrix).all()
    permuted = axes_matrix(text, field_text)
    assert (permuted @ permuted.T == np.eye(3)).all()
    assert abs(np.linalg.det(permuted)) == pytest.approx(1)
    if np.diagonal(field).all():  # along the box: the only axes that the text of a medium can describe
        assert (field @ permuted == matrix).all()
        assert axes_notes(text, field_text) == ()
    else:
        assert (permuted == matrix).all()
        assert len(axes_notes(text, field_text)) == 1


def test_axes_of_devices_and_sources() -> None:
    inverse3, omega = "x right, y away from the user, z up", "x towards the user, y right, z up"
    assert axes_matrix(BOX_AXES, UP_Y_AXES).tolist() == np.eye(3).tolist()
    assert axes_matrix(BOX_AXES, CAMERA_AXES).tolist() == np.diag([1.0, -1, -1]).tolist()
    assert (axes_matrix(inverse3, UP_Y_AXES) @ [1, 2, 3]).tolist() == [1, 3, -2]
    assert (axes_matrix(omega, UP_Y_AXES) @ [1, 2, 3]).tolist() == [2, 3, 1]
    assert (axes_matrix(omega, CAMERA_AXES) @ [1, 2, 3]).tolist() == [2, -3, -1]
    assert np.linalg.det(axes_matrix(BOX_AXES, "x right, y up, z forward")) == pytest.approx(-1)
    assert (axes_matrix(inverse3, UP_Z_AXES) == axes_matrix(inverse3, BOX_AXES)).all()
    assert "north" in axes_notes(inverse3, UP_Z_AXES)[0]


def test_up_is_up_for_the_hand() -> None:
    for up, vector in (
        ("x", [1, 0, 0]), ("-x", [-1, 0, 0]), ("y", [0, 1, 0]),
        ("-y", [0, -1, 0]), ("z", [0, 0, 1]), ("-z", [0, 0, -1]),
    ):  # fmt: skip
        matrix = axes_matrix(BOX_AXES, "of nobody's knowing", up)
        assert (matrix @ [0, 1, 0]).tolist() == vector and np.linalg.det(matrix) == pytest.approx(1)
        assert axes_notes(BOX_AXES, "of nobody's knowing", up) == ()
    for axes, vector in ((UP_Z_AXES, [0, 0, 1]), (UP_Y_AXES, [0, 1, 0]), (CAMERA_AXES, [0, -1, 0])):
        assert (axes_matrix(BOX_AXES, axes, "auto") @ [0, 1, 0]).tolist() == vector
        assert axes_notes(BOX_AXES, axes, "auto") == ()
    assert (axes_matrix(BOX_AXES, UP_Z_AXES, "auto") @ [1, 0, 0]).tolist() == [1, 0, 0]
    assert (axes_matrix(BOX_AXES, "x, y, z", "auto") == np.eye(3)).all()
    assert len(axes_notes(BOX_AXES, "x, y, z", "auto")) == 1
    with pytest.raises(InvalidArgument, match="up"):
        RenderSpec(up="w")


def test_axes_of_every_shipped_point_device_are_valid() -> None:
    points = [profile for profile in devices() if not profile.is_array]
    assert len(points) > 5
    for profile in points:
        assert axes_of_text(profile.axes) is not None, profile.name


UNREADABLE = (
    *(
        "",
        "x, y, z",
        "x right, y up",
        "x right, y left, z up",
        "x right, x up, z back",
        "x right, y up, z up",
    ),
    *(
        "x right, y up, z sideways",
        "x right up, y, z back",
        "x right, y up, z back, w down",
        "a right, y up, z back",
    ),
    "x" * 999,
)


@pytest.mark.parametrize("text", UNREADABLE)
def test_unknown_axes_are_those_of_the_box_with_a_note(text: str) -> None:
    assert axes_of_text(text) is None
    assert (axes_matrix(text, text) == np.eye(3)).all()
    notes = axes_notes(text, text)
    assert len(notes) == 2
    assert all(len(note) < 200 for note in notes)


@given(st.text(max_size=40))
def test_any_text_gives_a_signed_permutation_matrix(text: str) -> None:
    for matrix in (axes_matrix(text, BOX_AXES), axes_matrix(BOX_AXES, text)):
        assert sorted(np.abs(matrix).ravel().tolist()) == [0] * 6 + [1] * 3
        assert (matrix @ matrix.T == np.eye(3)).all()


def test_all_48_orientations_are_distinct() -> None:
    found = set()
    for order in itertools.permutations(range(3)):
        for signs in itertools.product((0, 1), repeat=3):
            parts = [
                f"{'xyz'[n]} {DIRECTIONS[axis][sign]}"
                for n, (axis, sign) in enumerate(zip(order, signs, strict=True))
            ]
            found.add(tuple(axes_matrix(", ".join(parts), BOX_AXES).ravel()))
    assert len(found) == 48


@pytest.mark.parametrize(
    ("text", "rows"),
    [
        ("x,y,z", [[1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        ("x,-z,y", [[1, 0, 0], [0, 0, -1], [0, 1, 0]]),
        (" -X , +y, Z ", [[-1, 0, 0], [0, 1, 0], [0, 0, 1]]),
    ],
)
def test_signed_axes_are_a_permutation(text: str, rows: list[list[int]]) -> None:
    matrix = signed_axes(text)
    assert matrix is not None and matrix.tolist() == rows


@pytest.mark.parametrize(
    "text", ["", "x,y", "x,y,y", "x,y,z,x", "--x,y,z", "-+x,y,z", "x y z", "a,b,c", "x," * 99]
)
def test_invalid_axes_are_one_clear_error(text: str) -> None:
    assert signed_axes(text) is None
    with pytest.raises(InvalidArgument, match=r"axes: found .* expected each of x, y, z once, such as"):
        RenderSpec(axes=text)


def matrix_of(spec: RenderSpec, profile_axes: str) -> np.ndarray:
    """The matrix from the device to the field in the settings of a session."""
    session = Session(numbered_medium(1), replace(OMNI, axes=profile_axes), spec)
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    settings = memory.receiver["settings"]
    matrix = np.array(settings["axes"].tolist()).reshape(3, 3)
    assert settings["handedness"] == np.linalg.det(matrix)
    return matrix


def test_axes_of_the_options_are_those_of_the_profile_or_replace_them() -> None:
    omega = "x towards the user, y right, z up"
    by_profile = matrix_of(RenderSpec(), omega)
    assert (by_profile == axes_matrix(omega, AXES)).all()
    mirrored = matrix_of(RenderSpec(axes="x,-y,z"), omega)  # right is left
    assert (mirrored @ [0, 1, 0] == -(by_profile @ [0, 1, 0])).all() and np.linalg.det(mirrored) == -1
    assert (mirrored @ [1, 0, 3] == by_profile @ [1, 0, 3]).all()
    mounted = matrix_of(RenderSpec(axes="x,-z,y"), BOX_AXES)
    assert (mounted @ [1, 2, 3] == [1, -3, 2]).all()
    assert (matrix_of(RenderSpec(axes=omega), BOX_AXES) == by_profile).all()


class Aside(Simulated):
    """Rests 4 mm to the device's right, and moves nowhere."""

    def position_m(self) -> Point:
        super().position_m()
        return 0.004, 0.0, 0.0


@pytest.mark.parametrize(("axes", "side"), [(None, 1.0), ("-x,y,z", -1.0)])
def test_position_and_force_are_mirrored_together(axes: str | None, side: float) -> None:
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[GRID.shape[0] // 2 :, ..., 0] = 0.5  # pushes on along x, in one half
    medium = HapticMedium.from_frames([ForceField.from_dense(GRID, forces)], 50.0, AXES)
    profile = replace(OMNI, axes=BOX_AXES)
    rows = run_offline(medium, profile, Aside, RenderSpec(render="field", axes=axes), seconds=0.3).log
    assert rows["position_m"][150, 0] == pytest.approx(side * 0.004)
    field_force_n, force_n = rows["field_force_n"][150], rows["force_n"][150]
    assert field_force_n[0] == pytest.approx(0.45 if side > 0 else 0.05)  # between samples at -5 and 5 mm
    assert force_n == pytest.approx(field_force_n * [side, 1, 1])

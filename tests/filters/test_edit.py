"""Editing: the effect of operators inside and outside a region, and splicing of media in time."""

from __future__ import annotations

import itertools
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from touchfield.errors import InvalidArgument
from touchfield.filters import (
    Ball,
    Box,
    Compose,
    EditOperator,
    Erase,
    Everywhere,
    ForceRange,
    Gain,
    HalfSpace,
    Limit,
    Move,
    Region,
    RigidMotion,
    Voxels,
    cross_fade,
    edit_field,
    edit_medium,
    field_filters,
    filter_of,
)
from touchfield.medium import ForceField, Grid, HapticMedium

GRID = Grid((20, 17, 12), (0.001, 0.0015, 0.002), (-0.01, 0.0, 0.02))
POINTS = np.stack(np.meshgrid(*(GRID.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
MIDDLE = GRID.to_m((9.5, 8.0, 5.5))


def random_field(seed: int, density: float = 0.4, grid: Grid = GRID) -> ForceField:
    rng = np.random.default_rng(seed)
    supported = rng.random(grid.shape) < density
    return ForceField.from_dense(grid, rng.normal(size=(*grid.shape, 3)) * supported[..., None])


FIELD, OTHER = random_field(1), random_field(2)

SMALLER = {"lowpass": "pitch=4.5mm"}
"""Arguments for filters whose example is wider than the grid."""

OPERATORS: list[EditOperator] = [
    Gain(-2.5),
    Erase(),
    Limit(0.5),
    Move(RigidMotion.turn((1.0, 2.0, 0.5), 33.0, MIDDLE)),
    Move(RigidMotion.mirror((1.0, 1.0, 0.0), MIDDLE)),
    *(Compose(OTHER, composition) for composition in ("replace", "over", "add", "max")),
    *(filter_of(name, SMALLER.get(name, kind.example)) for name, kind in field_filters().items()),
]
REGIONS: list[Region] = [
    Box((-0.006, 0.004, 0.025), (0.001, 0.016, 0.036)),
    Ball(tuple(MIDDLE.tolist()), 0.006),
    HalfSpace((1.0, -1.0, 0.3), tuple(MIDDLE.tolist())),
    Voxels(GRID, [[3, 4, 5], [3, 4, 6], [10, 2, 1]]),
    ForceRange(0.5, 1.5),
    ForceRange(0.0, 1.0),
    Ball(tuple(MIDDLE.tolist()), 0.006) & ~Box((-0.003, 0.0, 0.0), (0.0, 1.0, 1.0)) | ForceRange(2.0),
]


@pytest.mark.parametrize("operator", OPERATORS, ids=lambda o: f"{o.name}-{o.text[:12]}")
def test_edit_changes_the_inside_only(operator: EditOperator) -> None:
    before, after = FIELD.to_dense(), operator(FIELD).to_dense()
    changed = (before != after).any(axis=-1)
    outside_changes = 0
    for region, feather_m in itertools.product(REGIONS, (0.0, 0.0021)):
        edited = edit_field(FIELD, region, operator, feather_m).to_dense()
        region_on_field = region.on(FIELD)
        inside = region_on_field.holds(POINTS)
        outside = ~inside & (region_on_field.distance_m(POINTS) >= feather_m)
        assert np.array_equal(edited[outside], before[outside])
        assert np.array_equal(edited[inside], after[inside])
        outside_changes += int((changed & outside).sum())
        in_feather = ~inside & ~outside
        low, high = np.minimum(before, after)[in_feather], np.maximum(before, after)[in_feather]
        assert ((edited[in_feather] >= low) & (edited[in_feather] <= high)).all()
    assert outside_changes > 100  # samples that the operator without a region would have changed


def test_edits_give_valid_fields() -> None:
    for operator in OPERATORS:
        edited = edit_field(FIELD, REGIONS[1], operator, 0.002)
        assert ForceField.from_bricks(edited.grid, edited.bricks, edited.forces_n) == edited
    assert edit_field(FIELD, Everywhere(), Erase()) == ForceField.empty(GRID)
    assert edit_field(FIELD, ~Everywhere(), Erase(), 0.01) == FIELD
    empty = ForceField.empty(GRID)
    for region in REGIONS:
        assert edit_field(empty, region, Gain(2.0), 0.001) == empty


def test_feather_is_linear() -> None:
    flat = ForceField.from_dense(GRID, np.broadcast_to(np.float32([0, 0, 1]), (*GRID.shape, 3)))
    for feather_m in (0.004, 0.011):
        edited = edit_field(flat, Box((-1.0, -1.0, -1.0), (-0.0055, 1.0, 1.0)), Erase(), feather_m).to_dense()
        expected = np.clip((GRID.axis_m(0) + 0.0055) / feather_m, 0, 1)
        np.testing.assert_allclose(edited[:, 5, 5, 2], expected, atol=1e-6)
        assert not edited[..., :2].any()
    assert ((expected > 0) & (expected < 0.1)).any() and ((expected > 0.9) & (expected < 1)).any()


# -- regions -----------------------------------------------------------------------------------------------


def brute_distance(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    points = POINTS.reshape(-1, 3)
    inside = mask.ravel()
    out = np.empty(len(points))
    for from_mask, to_mask in ((inside, ~inside), (~inside, inside)):
        gap = points[from_mask][:, None] - points[to_mask][None]
        out[from_mask] = np.sqrt((gap**2).sum(axis=-1)).min(axis=1)
    return np.where(inside, -out, out).reshape(mask.shape)


def test_distance_of_voxels_agrees_with_brute_force() -> None:
    grid_mask = (np.random.default_rng(5).random(GRID.shape) < 0.02) | (POINTS[..., 0] > 0.004)
    region = Voxels(GRID, np.argwhere(grid_mask))
    assert np.array_equal(region.holds(POINTS), grid_mask)
    np.testing.assert_allclose(region.distance_m(POINTS), brute_distance(grid_mask), atol=1e-12)
    everything = Voxels(GRID, np.argwhere(np.ones(GRID.shape, bool)))
    assert (everything.distance_m(POINTS) == -np.inf).all()
    assert (Voxels(GRID, np.zeros((0, 3), int)).distance_m(POINTS) == np.inf).all()


def test_force_range_selects_samples_of_the_field() -> None:
    amplitude = np.linalg.norm(FIELD.to_dense().astype(float), axis=-1)
    for low, high in ((0.5, 1.5), (0.0, 1.0), (1.2, math.inf), (0.0, math.inf)):
        inside = ForceRange(low, high).on(FIELD).holds(POINTS)
        assert np.array_equal(inside, (amplitude >= low) & (amplitude <= high))
    with pytest.raises(InvalidArgument, match="no field to look at"):
        ForceRange(0.5).holds(POINTS)


def test_edges_belong_to_the_region() -> None:
    box, ball, half = Box((0, 0, 0), (1, 1, 1)), Ball((0, 0, 0), 0.5), HalfSpace((0, 0, 2), (0, 0, 1))
    assert box.holds(np.array([[0.0, 0, 0], [1, 1, 1], [1, 1, 1.01]])).tolist() == [True, True, False]
    assert ball.holds(np.array([[0.5, 0, 0], [0.51, 0, 0]])).tolist() == [True, False]
    assert half.holds(np.array([[7.0, 7, 1], [7, 7, 0.99]])).tolist() == [True, False]
    at = [[1, 1, 1], [2, 2, 2], [3, 3, 3]]
    field = ForceField.from_support(GRID, at, [[0.5, 0, 0], [0, 1.0, 0], [0, 0, 1.5]])
    for low, high, expected in ((0.5, 1.5, [1, 1, 1]), (0.5, 1.4, [1, 1, 0]), (1.0, 1.0, [0, 1, 0])):
        assert ForceRange(low, high).on(field).holds(GRID.to_m(np.array(at))).tolist() == expected
    assert (
        ~ball | Voxels(GRID, [[0, 0, 0], [0, 0, 0]])
    ).text == "(not (ball (0, 0, 0) radius 0.5 m)) or (1 voxels)"


coordinate = st.floats(-0.05, 0.05)
triple = st.tuples(coordinate, coordinate, coordinate)
shapes = st.one_of(
    st.builds(lambda a, b: Box(tuple(map(min, a, b)), tuple(map(max, a, b))), triple, triple),
    st.builds(Ball, triple, st.floats(0, 0.05)),
    st.builds(HalfSpace, triple.filter(any), triple),
)


@given(shapes, shapes, st.integers(0, 2**32 - 1))
def test_regions_are_sets_and_their_distances_lipschitz(a: Region, b: Region, seed: int) -> None:
    points = np.random.default_rng(seed).uniform(-0.08, 0.08, (200, 3))
    x, y = a.holds(points), b.holds(points)
    assert np.array_equal((a | b).holds(points), x | y)
    assert np.array_equal((a & b).holds(points), x & y)
    assert np.array_equal((~a).holds(points), ~x)
    assert np.array_equal((~(a | b)).holds(points), (~a & ~b).holds(points))
    for region in (a, b, a | b, a & b, ~a):
        distance = region.distance_m(points)
        clear = np.abs(distance) > 1e-12
        assert np.array_equal(distance[clear] <= 0, region.holds(points)[clear])
        step = np.linalg.norm(points[1:] - points[:-1], axis=1)
        assert (np.abs(np.diff(distance)) <= step + 1e-12).all()  # the distance has a slope of at most 1


def test_invalid_regions_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="low <= high"):
        Box((1, 0, 0), (0, 1, 1))
    for bad in ((math.nan, 0, 0), (0, 0), "abc", None):
        with pytest.raises((InvalidArgument, ValueError)):
            Box(bad, (1, 1, 1))  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match="radius"):
        Ball((0, 0, 0), -1.0)
    with pytest.raises(InvalidArgument, match="direction"):
        HalfSpace((0, 0, 0), (0, 0, 0))
    with pytest.raises(InvalidArgument, match="outside the grid"):
        Voxels(GRID, [[0, 0, 12]])
    with pytest.raises(InvalidArgument, match="outside the grid"):
        Voxels(GRID, [[0, -1, 0]])
    with pytest.raises(InvalidArgument, match="whole numbers"):
        Voxels(GRID, [[0.5, 0, 0]])
    with pytest.raises(InvalidArgument, match="force range"):
        ForceRange(2.0, 1.0)
    other = Grid(GRID.shape, GRID.spacing_m, (0, 0, 0))
    with pytest.raises(InvalidArgument, match="region of voxels"):
        edit_field(FIELD, Voxels(other, [[0, 0, 0]]), Erase())


# -- operators ---------------------------------------------------------------------------------------------


def test_compositions_agree_with_their_definitions() -> None:
    x, y = FIELD.to_dense(), OTHER.to_dense()
    supported = y.any(axis=-1, keepdims=True)
    longer = (y.astype(float) ** 2).sum(-1, keepdims=True) > (x.astype(float) ** 2).sum(-1, keepdims=True)
    expected = {"replace": y, "over": np.where(supported, y, x), "add": x + y, "max": np.where(longer, y, x)}
    for mode, forces in expected.items():
        assert np.array_equal(Compose(OTHER, mode)(FIELD).to_dense(), forces)
    assert Compose(FIELD.scaled(-1), "max")(FIELD) == FIELD  # the field wins ties


def test_whole_sample_moves_and_quarter_rotations_are_exact() -> None:
    cube = Grid((18, 18, 18), (0.001,) * 3, (0.1, 0.2, -0.3))
    field = random_field(3, 0.3, cube)
    dense, centre = field.to_dense(), cube.to_m((8.5, 8.5, 8.5))
    moved = Move(RigidMotion.move((0.003, -0.002, 0.0)))(field).to_dense()
    assert np.array_equal(moved[3:, :-2], dense[:-3, 2:]) and not moved[:3].any() and not moved[:, -2:].any()
    rotated = Move(RigidMotion.turn((0, 0, 1), 90.0, centre))(field).to_dense()
    assert np.array_equal(rotated, np.rot90(dense, axes=(0, 1))[..., [1, 0, 2]] * np.float32([-1, 1, 1]))
    mirrored = Move(RigidMotion.mirror((0, 1, 0), centre))(field).to_dense()
    assert np.array_equal(mirrored, dense[:, ::-1] * np.float32([1, -1, 1]))
    assert Move(RigidMotion())(field) == field
    assert RigidMotion.turn((0, 0, 1), 90.0).matrix == ((0, -1, 0), (1, 0, 0), (0, 0, 1))


@given(triple.filter(lambda t: math.hypot(*t) > 1e-6), st.floats(-360, 360), triple, triple)
def test_motions_are_rigid_and_invertible(axis: Any, angle_deg: float, about_m: Any, offset_m: Any) -> None:
    motion = RigidMotion.turn(axis, angle_deg, about_m).followed_by(RigidMotion.move(offset_m))
    motion = motion.followed_by(RigidMotion.mirror(axis, offset_m))
    points = np.random.default_rng(0).uniform(-0.1, 0.1, (20, 3))
    moved = motion.points_m(points)
    gaps = [np.linalg.norm(p[:, None] - p[None], axis=-1) for p in (points, moved)]
    np.testing.assert_allclose(*gaps, atol=1e-12)
    np.testing.assert_allclose(motion.inverse.points_m(moved), points, atol=1e-12)
    np.testing.assert_allclose(motion.followed_by(motion.inverse).points_m(points), points, atol=1e-12)


def test_moved_field_is_the_trilinear_query_at_the_inverse_motion() -> None:
    motion = RigidMotion.turn((1, 2, 3), 50.0, MIDDLE).followed_by(RigidMotion.move((0.002, 0.0, -0.001)))
    expected = motion.vectors(FIELD.sample_n(motion.inverse.points_m(POINTS)))
    np.testing.assert_allclose(Move(motion)(FIELD).to_dense(), expected, atol=1e-6)


def test_invalid_operators_are_refused() -> None:
    other = random_field(1, grid=Grid((8, 8, 8), (1, 1, 1), (0, 0, 0)))
    for bad in (math.nan, math.inf):
        with pytest.raises(InvalidArgument, match="gain"):
            Gain(bad)
    with pytest.raises(InvalidArgument, match="limit"):
        Limit(0.0)
    with pytest.raises(InvalidArgument, match="one of replace, over, add, max"):
        Compose(OTHER, "under")
    for mode in ("replace", "over", "add", "max"):
        with pytest.raises(InvalidArgument, match="compose"):
            edit_field(FIELD, Everywhere(), Compose(other, mode))
    for matrix in (np.ones((3, 3)), np.full((3, 3), np.nan), np.eye(2)):
        with pytest.raises(InvalidArgument, match="orthogonal"):
            RigidMotion(matrix)  # type: ignore[arg-type]
    for bad in (math.nan, math.inf):
        with pytest.raises(InvalidArgument, match="offset_m"):
            RigidMotion(offset_m=(0.0, bad, 0.0))
        with pytest.raises(InvalidArgument, match="mirror normal"):
            RigidMotion.mirror((0.0, bad, 0.0))
    for feather_m in (-1.0, math.nan, math.inf):
        with pytest.raises(InvalidArgument, match="feather_m"):
            edit_field(FIELD, Everywhere(), Erase(), feather_m)


# -- media -------------------------------------------------------------------------------------------------


def medium(frames: int, seed: int = 10, rate_hz: float = 25.0) -> HapticMedium:
    return HapticMedium.from_frames([random_field(seed + i, 0.05) for i in range(frames)], rate_hz)


def test_range_of_frames_is_edited_and_recorded_in_the_provenance() -> None:
    before = medium(6)
    edited = edit_medium(before, REGIONS[0], Gain(2.0), 0.001, frames=(2, 4))
    edited_twice = edit_medium(edited, REGIONS[1], Erase())
    for i, (x, y) in enumerate(zip(before, edited, strict=True)):
        assert y == (edit_field(x, REGIONS[0], Gain(2.0), 0.001) if 2 <= i < 4 else x)
    assert edited_twice[3] == edit_field(edited[3], REGIONS[1], Erase())
    first, second = edited_twice.provenance["edits"].split("; ")
    assert (
        first == "gain 2.0, box (-0.006, 0.004, 0.025) to (0.001, 0.016, 0.036), feather 0.001 m, frames 2:4"
    )
    assert second.startswith("erase, ball (") and "edits" not in before.provenance
    for frames in ((3, 3), (-1, 2), (2, 7)):
        with pytest.raises(InvalidArgument, match="frames to edit"):
            edit_medium(before, REGIONS[0], Erase(), frames=frames)


def test_composed_medium_starts_with_the_range() -> None:
    below, above = medium(5), medium(2, seed=50)
    composed = edit_medium(below, Everywhere(), Compose(above, "over"), frames=(3, None))
    assert composed[2] == below[2]
    assert composed[4] == Compose(above[1], "over")(below[4])
    assert composed.provenance["edits"] == "compose over another medium, everywhere, frames 3:5"
    with pytest.raises(InvalidArgument, match="at least the 3"):
        edit_medium(below, Everywhere(), Compose(above, "over"), frames=(2, None))
    with pytest.raises(InvalidArgument, match="2 frames"):
        Compose(above)(below[0])


def test_spliced_parts_equal_the_original() -> None:
    original, other = medium(6), medium(3, seed=40)
    joined = cross_fade(
        cross_fade(original.between(0, 2), original.between(2, 3), 0), original.between(3, 6), 0
    )
    assert list(joined) == list(original)
    both = cross_fade(original, other, 0)
    assert len(both) == 9 and both[5] == original[5] and both[6] == other[0] and both[-1] == other[2]
    cut = cross_fade(both.between(0, 1), both.between(4, 9), 0)
    assert list(cut) == [both[i] for i in (0, 4, 5, 6, 7, 8)]
    assert both.provenance["splices"] == "6 frames into 3 over 0"
    assert cut.provenance["splices"].endswith("1 frames into 5 over 0")


def test_cross_fade_has_equal_steps() -> None:
    first, second = medium(4), medium(5, seed=40)
    faded = cross_fade(first, second, 3)
    assert len(faded) == 6
    assert faded[0] == first[0] and faded[4] == second[3] and faded[5] == second[4]
    for i in range(3):
        weight = (i + 1) / 4
        expected = (1 - weight) * first[1 + i].to_dense() + weight * second[i].to_dense()
        np.testing.assert_allclose(faded[1 + i].to_dense(), expected, atol=1e-6)
    same = cross_fade(first, first, 4)  # a medium into itself, with all frames overlapping
    np.testing.assert_allclose(same[2].to_dense(), first[2].to_dense(), atol=1e-6)


def test_media_that_cannot_be_spliced_are_refused() -> None:
    first = medium(3)
    with pytest.raises(InvalidArgument, match=r"medium 1 to splice, rate_hz: found 30\.0; expected 25\.0"):
        cross_fade(first, medium(3, rate_hz=30.0), 0)
    foreign = HapticMedium.from_frames([ForceField.empty(Grid((8, 8, 8), (1, 1, 1), (0, 0, 0)))], 25.0)
    with pytest.raises(InvalidArgument, match="medium 1 to splice, grid"):
        cross_fade(first, foreign, 1)
    for frames in (-1, 4, True, 1.0):
        with pytest.raises(InvalidArgument, match="cross-fade"):
            cross_fade(first, first, frames)  # type: ignore[arg-type]


def test_texts_of_regions_and_edits_have_their_numbers() -> None:
    ball, half = Ball((0.001, 0.02, -0.3), 0.25), HalfSpace((0.0, 3.0, -4.0), (0.1, 0.2, 0.3))
    assert ball.text == "ball (0.001, 0.02, -0.3) radius 0.25 m"
    assert half.text == "half-space (0, 0.6, -0.8) from (0.1, 0.2, 0.3)"
    assert Box((0.0, 0.1, -math.inf), (1.0, 2.0, 3.0)).text == "box (0, 0.1, -inf) to (1, 2, 3)"
    assert Voxels(GRID, [[0, 0, 0], [1, 2, 3], [0, 0, 0]]).text == "2 voxels"
    assert ForceRange(0.5).text == "|F| of 0.5 to inf N" and ForceRange(0.0, 2.0).text == "|F| of 0 to 2 N"
    assert (ball & half).text == f"({ball.text}) and ({half.text})"
    assert Limit(2.5).text == "2.5 N" and Gain(-0.5).text == "-0.5"
    assert RigidMotion.move((0.1, -0.2, 0.3)).text.endswith(", t [0.1, -0.2, 0.3] m")

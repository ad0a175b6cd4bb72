"""Block motion of the coder `touch`: what moves is found, both sides agree, and no bytes break anything."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touchfield.codec.touch.frame_model import Known
from touchfield.codec.touch.motion import find, gain, replay

from touchfield.codec.touch.fixed_field import TOP, FixedField
from touchfield.codec.touch.lattice import Lattice
from touchfield.errors import CorruptFile, FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid
from touchfield.medium.field import brick_keys

LONGEST_N = 3.0
UNIT_N = float(np.float32(LONGEST_N / TOP))
FLOOR, RATE = round(1.13 * 0.05 / UNIT_N), round(1.13 * 0.1 * 65536)


def grid_of(*shape: int) -> Grid:
    return Grid(shape, (0.001, 0.001, 0.001), (0.0, 0.0, 0.0))


def ball(grid: Grid, centre: tuple[float, float, float], radius: float = 7.0) -> ForceField:
    """A solid ball: a force outwards that grows with the depth, as of a falling body."""
    offset = np.stack(np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij"), axis=-1) - np.array(centre)
    distance = np.linalg.norm(offset, axis=-1, keepdims=True)
    forces = np.where(distance < radius, 0.4 * (radius - distance) * offset / np.maximum(distance, 1e-9), 0)
    return ForceField.from_dense(grid, forces.astype(np.float32))


def fixed(field: ForceField) -> FixedField:
    return FixedField(field.bricks, np.rint(field.forces_n / UNIT_N).astype(np.int32))


def known_of(previous: ForceField) -> Known:
    return Known(previous.grid, Lattice(UNIT_N, FLOOR, RATE, FLOOR, RATE), fixed(previous))


def same(a: FixedField, b: FixedField) -> bool:
    return np.array_equal(a.bricks, b.bricks) and np.array_equal(a.vectors, b.vectors)


def dense(grid: Grid, guess: FixedField) -> np.ndarray:
    return guess.field(grid, UNIT_N).to_dense()


def falling(shift: tuple[float, float, float]) -> tuple[ForceField, Known]:
    grid = grid_of(45, 40, 48)
    return ball(grid, (22 + shift[0], 20 + shift[1], 22 + shift[2])), known_of(ball(grid, (22, 20, 22)))


def test_a_whole_displacement_is_found_and_nothing_is_left() -> None:
    frame, known = falling((2, -3, 7))
    found = find(frame, known)
    assert found is not None
    data, guess = found
    within = np.linalg.norm(dense(frame.grid, guess) - frame.to_dense(), axis=-1)
    assert (within[frame.to_dense().any(axis=-1)] < 0.05).mean() > 0.98
    assert len(data) < 60
    assert gain(frame, known, guess) > 5


def test_a_quarter_of_a_voxel_is_interpolated() -> None:
    frame, known = falling((0.25, 0.5, 3.75))
    found = find(frame, known)
    assert found is not None
    error = np.linalg.norm(dense(frame.grid, found[1]) - frame.to_dense(), axis=-1)
    before = np.linalg.norm(dense(frame.grid, known.previous) - frame.to_dense(), axis=-1)
    assert error.sum() < before.sum() / 8
    assert same(replay(found[0], known), found[1])


def test_a_leap_beyond_the_first_steps_is_found() -> None:
    frame, known = falling((0, 0, 14))
    found = find(frame, known)
    assert found is not None and gain(frame, known, found[1]) > 4


def test_the_edge_of_a_wall_stays_sharp() -> None:
    """A slab of one force, displaced by half a voxel: interpolation must not shrink forces at its faces."""
    grid = grid_of(32, 32, 32)
    forces = np.zeros((*grid.shape, 3), np.float32)
    forces[8:24, 8:24, 12:16] = (0, 0, 1.5)
    previous = ForceField.from_dense(grid, forces)
    known = known_of(previous)
    forces = np.roll(forces, 3, axis=2)
    found = find(ForceField.from_dense(grid, forces), known)
    assert found is not None
    lengths = np.linalg.norm(found[1].vectors, axis=-1)
    assert set(np.unique(lengths)) <= {0, round(1.5 / UNIT_N)}


def test_half_weights_decide_and_do_not_shrink() -> None:
    from touchfield.codec.kernels.touch_motion import fetch

    vectors = np.zeros((1, 8, 8, 8, 3), np.int32)
    vectors[0, 4, 4, 4] = (1000, -2001, 7)
    table, out = np.zeros((1, 1, 1), np.int32), np.zeros(3, np.int64)
    at = 4 * 4
    assert fetch(at, at, at + 2, table, vectors.reshape(-1), 0, out) and out.tolist() == [1000, -2001, 7]
    assert not fetch(at, at, at + 3, table, vectors.reshape(-1), 0, out)
    assert not fetch(at, at, at + 2, table, vectors.reshape(-1), 2500, out)
    vectors[0, 4, 4, 5] = (-1000, 2000, 6)
    assert fetch(at, at, at + 2, table, vectors.reshape(-1), 0, out) and out.tolist() == [0, 0, 7]  # halves go up


def test_what_stands_still_has_no_motion() -> None:
    frame, known = falling((0, 0, 0))
    assert find(frame, known) is None
    assert gain(frame, known, known.previous) == 0


def test_nothing_to_move_or_to_predict() -> None:
    frame, known = falling((1, 0, 0))
    empty = ForceField.empty(frame.grid)
    assert find(frame, replace(known, previous=None)) is None
    assert find(frame, known_of(empty)) is None
    assert find(empty, known) is None
    assert gain(frame, replace(known, previous=None), known.previous) > 0


def test_gain_is_below_zero_for_a_worse_guess() -> None:
    frame, known = falling((0, 0, 1))
    assert gain(frame, known, fixed(ball(frame.grid, (22, 20, 30)))) < 0


def test_read_only_arrays_and_the_arguments_stay_as_they_were() -> None:
    frame, known = falling((1, 0, 3))
    vectors = known.previous.vectors.copy()
    known.previous.vectors.flags.writeable = False
    data, guess = find(frame, known)
    assert same(replay(data, known), guess)
    assert np.array_equal(vectors, known.previous.vectors)


@st.composite
def motions(draw: st.DrawFn) -> tuple[ForceField, Known]:
    """Balls and noise in grids that are no multiple of a brick, some moved beyond the border."""
    shape = draw(st.tuples(*[st.integers(5, 37)] * 3))
    grid, rng = grid_of(*shape), np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    centre = rng.uniform(0, shape)
    step = draw(st.sampled_from([0.3, 2.0, 9.0]))
    fields = [ball(grid, centre), ball(grid, centre + rng.normal(size=3) * step)]
    if draw(st.booleans()):
        noise = rng.normal(size=(*shape, 3)) * (rng.random((*shape, 1)) < draw(st.sampled_from([0.01, 0.5])))
        fields = [field + ForceField.from_dense(grid, noise.clip(-1, 1).astype(np.float32)) for field in fields]
    return fields[1], known_of(fields[0])


@given(motions())
@settings(max_examples=25, deadline=None)
def test_replay_makes_the_same_guess(case: tuple[ForceField, Known]) -> None:
    frame, known = case
    found = find(frame, known)
    if found is None:
        return
    data, guess = found
    assert same(replay(data, known), guess)
    assert gain(frame, known, guess) > 0
    assert (np.diff(brick_keys(frame.grid, guess.bricks)) > 0).all()
    assert guess.bricks.dtype == guess.vectors.dtype == np.int32
    x = guess.bricks[:, :, None] * 8 + np.arange(8)
    beyond = x >= np.array(frame.grid.shape)[:, None]
    assert not guess.vectors[beyond[:, 0]].any()
    assert not np.moveaxis(guess.vectors, 2, 1)[beyond[:, 1]].any()
    assert not np.moveaxis(guess.vectors, 3, 1)[beyond[:, 2]].any()


@pytest.fixture(scope="module")
def coded() -> tuple[bytes, Known]:
    frame, known = falling((2, 1, 5))
    found = find(frame, known)
    assert found is not None
    return found[0], known


def test_a_truncation_is_named_or_is_other_motion(coded: tuple[bytes, Known]) -> None:
    """The code has no check sum, the file has: a few of its beginnings are code themselves, but never the same."""
    data, known = coded
    guess, named = replay(data, known), 0
    for size in range(len(data)):
        try:
            assert not same(replay(data[:size], known), guess)
        except FormatError:
            named += 1
    assert named > len(data) / 2


def test_code_in_which_nothing_moves_is_refused(coded: tuple[bytes, Known]) -> None:
    from touchfield.codec.touch import motion

    _, known = coded
    counts = motion._block_counts(known.grid, 3)
    held = motion._held(known.grid, known.previous.bricks, motion._before(known.grid, known.previous).rows, 3)
    data, _ = motion._written(held[:0], np.zeros((0, 3), np.int64), held, counts, 3)
    with pytest.raises(CorruptFile, match="no block"):
        replay(data, known)


def test_bytes_behind_the_end_are_refused(coded: tuple[bytes, Known]) -> None:
    data, known = coded
    with pytest.raises(CorruptFile):
        replay(data + b"\0", known)


@pytest.mark.parametrize("shape", [0x00, 0x01, 0x04, 0x33, 0xF2, 0xFF])
def test_unknown_shapes_are_refused(coded: tuple[bytes, Known], shape: int) -> None:
    with pytest.raises(CorruptFile):
        replay(bytes([shape]) + coded[0][1:], coded[1])


def test_motion_needs_a_frame_before(coded: tuple[bytes, Known]) -> None:
    with pytest.raises(CorruptFile):
        replay(coded[0], replace(coded[1], previous=None))
    with pytest.raises(TruncatedFile):
        replay(b"", coded[1])


@given(st.binary(min_size=1, max_size=400), st.sampled_from([0x02, 0x03, 0x12, 0x13, 0x22, 0x23]))
@settings(max_examples=60, deadline=None)
def test_strange_bytes_give_named_errors_or_a_bounded_guess(data: bytes, shape: int) -> None:
    _, known = falling((0, 0, 0))
    try:
        guess = replay(bytes([shape]) + data, known)
    except FormatError:
        return
    assert len(guess.bricks) <= 4 * len(known.previous.bricks) + 64


def test_few_bytes_do_not_fill_the_grid() -> None:
    """All candidates moved: one brick alone may not become all that are around it."""
    from touchfield.codec.touch import motion

    grid = grid_of(200, 200, 200)
    positions = np.stack(np.meshgrid(*[np.arange(4, 200, 40)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    known = known_of(ForceField.from_support(grid, positions, np.ones((len(positions), 3))))
    counts = motion._block_counts(grid, 3)
    before = motion._before(grid, known.previous)
    held = motion._held(grid, known.previous.bricks, before.rows, 3)
    everywhere = motion._candidates(held, counts, 2)
    data, _ = motion._written(everywhere, np.full((len(everywhere), 3), 4, np.int64), held, counts, 3)
    assert len(everywhere) > 4 * len(held) + 64
    with pytest.raises(CorruptFile, match="far and wide"):
        replay(data, known)

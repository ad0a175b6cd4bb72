"""The surface source model: what it makes of solids, that both sides agree, and what it does with bad bytes."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from touchfield.codec.touch.frame_model import Known, Rule

from touchfield.codec.touch import surface
from touchfield.codec.touch.fixed_field import TOP, FixedField
from touchfield.codec.touch.lattice import Lattice
from touchfield.errors import FormatError, TruncatedFile
from touchfield.medium import ForceField, Grid

RULE = Rule(k=0.1, f0_n=0.05)
F_MAX = 3.3
ORIGIN = (0.0, 0.0, 0.0)


def known_of(field: ForceField, rule: Rule = RULE) -> Known:
    longest = float(np.sqrt((field.forces_n.astype(np.float64) ** 2).sum(-1)).max()) if len(field.bricks) else 1.0
    unit = float(np.float32(max(longest, 1e-30) / TOP))
    floor = int(np.clip(1.13 * rule.f0_n / unit, 1, 65535))
    rate = round(1.13 * rule.k * 65536)
    return Known(field.grid, Lattice(unit, floor, rate, floor, rate))


def solid(
    heights: np.ndarray, depth: int, spacing: tuple[float, float, float], k_n_per_m: float = 500.0
) -> np.ndarray:
    """F = min(K d, F_max) n behind heights [a, b] (samples from outside along the third axis), newtons."""
    ga, gb = np.gradient(heights * spacing[2], spacing[0], spacing[1])
    out = 1 / np.sqrt(1 + ga**2 + gb**2)
    inside = (np.arange(depth) - heights[..., None]) * spacing[2]
    amplitude = np.clip(k_n_per_m * inside * out[..., None], 0, F_MAX)
    return np.stack([amplitude * (g * out)[..., None] for g in (ga, gb)] + [amplitude * out[..., None]], axis=-1)


def turned(forces: np.ndarray, spacing: tuple[float, ...], axis: int, inverted: bool) -> ForceField:
    """The field with its third axis along `axis`, outside at the far end where `inverted`."""
    f = forces.copy()
    f[..., 2] *= 1 if inverted else -1
    if inverted:
        f = f[:, :, ::-1]
    order = [c for c in range(3) if c != axis] + [axis]
    back = np.argsort(order)
    shape, steps = (tuple(np.array(x)[back].tolist()) for x in (f.shape[:3], spacing))
    grid = Grid(shape, steps, ORIGIN)
    return ForceField.from_dense(grid, f.transpose(*back, 3)[..., back])


def hills(shape: tuple[int, int], base: float = 9.0) -> np.ndarray:
    a, b = np.meshgrid(*(np.linspace(0, 6, n) for n in shape), indexing="ij")
    return base + 3 * np.sin(a) * np.cos(0.7 * b)


def missed(field: ForceField, guess: FixedField, known: Known) -> np.ndarray:
    """Which samples of the grid lie beyond the mask of the guess."""
    f = field.to_dense().astype(np.float64)
    g = guess.field(field.grid, known.lattice.unit_n).to_dense().astype(np.float64)
    allowed = np.maximum(RULE.f0_n, RULE.k * np.linalg.norm(f, axis=-1))
    return np.linalg.norm(f - g, axis=-1) > allowed


def same(a: FixedField, b: FixedField) -> bool:
    return np.array_equal(a.bricks, b.bricks) and np.array_equal(a.vectors, b.vectors)


SPACING = (0.00125, 0.0009375, 0.000546875)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("inverted", [False, True])
def test_a_smooth_solid_is_told_in_some_bits_a_column(axis: int, inverted: bool) -> None:
    heights = hills((48, 37))
    field = turned(solid(heights, 43, SPACING), SPACING, axis, inverted)
    known = known_of(field)
    found = surface.fit(field, known, RULE)
    assert found is not None
    data, guess = found
    assert 8 * len(data) < 5 * heights.size
    assert missed(field, guess, known).sum() < 0.005 * field.support_count
    assert same(surface.synthesise(data, known), guess)


def test_a_step_smeared_by_a_low_pass_is_two_surfaces() -> None:
    heights = np.full((40, 40), 6.0)
    heights[:, 20:] = 20.0
    forces = solid(np.full((40, 40), 6.0), 40, SPACING)
    far = solid(np.full((40, 40), 20.0), 40, SPACING)
    share = np.clip((np.arange(40) - 17) / 6, 0, 1)[None, :, None, None]
    field = turned((1 - share) * forces + share * far, SPACING, 2, False)
    known = known_of(field)
    found = surface.fit(field, known, RULE)
    assert found is not None
    columns = missed(field, found[1], known).sum(axis=2)
    assert columns[:, 18:23].mean() < 2.5  # of 34 samples; one ramp would miss some ten


@pytest.mark.parametrize("name", ["empty", "one voxel", "noise", "wall", "far below"])
def test_no_surface_where_there_is_none(name: str) -> None:
    forces = np.zeros((24, 24, 24, 3), np.float32)
    if name == "one voxel":
        forces[3, 4, 5] = 1, 2, 3
    elif name == "noise":
        forces = np.random.default_rng(1).normal(size=forces.shape).astype(np.float32)
    elif name == "wall":
        forces = solid(hills((24, 24), 6.0), 24, SPACING).astype(np.float32)
        forces[:, :, 14:] = 0
    elif name == "far below":
        forces[..., 23, 2] = 0.01  # a single layer has no ramp
    field = ForceField.from_dense(Grid((24, 24, 24), SPACING, ORIGIN), forces)
    assert surface.fit(field, known_of(field), RULE) is None


def test_an_array_of_actuators_is_no_fault() -> None:
    field = ForceField.from_dense(Grid((32, 32, 1), SPACING, ORIGIN), np.full((32, 32, 1, 3), 0.5, np.float32))
    assert surface.fit(field, known_of(field), RULE) is None


@settings(max_examples=25, deadline=None)
@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from([(9, 9, 30), (8, 17, 40), (20, 3, 25)]),
    st.floats(0, 4),
    st.sampled_from([0.0, 0.05, 1.0]),
    st.sampled_from([RULE, Rule(k=0.0, f0_n=0.0, free=True), Rule(k=0.25, f0_n=0.2, sine=0.3)]),
)
def test_both_sides_make_the_same_guess(
    seed: int, shape: tuple[int, int, int], rough: float, holes: float, rule: Rule
) -> None:
    rng = np.random.default_rng(seed)
    heights = hills(shape[:2], 8.0) + rough * rng.normal(size=shape[:2])
    forces = solid(heights, shape[2], SPACING)
    forces[rng.random(shape[:2]) < holes * 0.5] = 0
    forces *= 10.0 ** rng.integers(-30, 3)
    field = turned(forces, SPACING, int(rng.integers(3)), bool(rng.integers(2)))
    known = known_of(field, rule)
    found = surface.fit(field, known, rule)
    if found is None:
        return
    data, guess = found
    assert same(surface.synthesise(data, known), guess)
    assert np.abs(guess.vectors).max(initial=0) < 1 << 17
    keys = guess.bricks.astype(np.int64) @ [1 << 40, 1 << 20, 1]
    assert (np.diff(keys) > 0).all()
    outside = np.ones(tuple(8 * n for n in field.grid.brick_shape), np.bool_)
    outside[tuple(slice(n) for n in field.grid.shape)] = False
    tiles = outside.reshape([x for n in field.grid.brick_shape for x in (n, 8)]).transpose(0, 2, 4, 1, 3, 5)
    assert not guess.vectors[tiles[tuple(guess.bricks.T)]].any()


@pytest.fixture(scope="module")
def good() -> tuple[bytes, Known]:
    field = turned(solid(hills((21, 30)), 30, SPACING), SPACING, 2, True)
    known = known_of(field)
    found = surface.fit(field, known, RULE)
    assert found is not None
    return found[0], known


def test_a_cut_is_an_error(good: tuple[bytes, Known]) -> None:
    data, known = good
    whole = 0  # by chance what is left may be the code of another surface
    for size in range(len(data)):
        try:
            surface.synthesise(data[:size], known)
            whole += 1
        except FormatError:
            pass
    assert whole <= 2 + len(data) // 64
    with pytest.raises(FormatError):
        surface.synthesise(data + b"\0", known)


@settings(max_examples=150, deadline=None)
@given(place=st.integers(0, 10**6), value=st.integers(0, 255))
def test_a_changed_byte_is_an_error_or_another_field(good: tuple[bytes, Known], place: int, value: int) -> None:
    data, known = good
    bad = bytearray(data)
    bad[place % len(bad)] = value
    try:
        guess = surface.synthesise(bytes(bad), known)
    except FormatError:
        return
    assert len(guess.bricks) <= 4 * len(bad)


@settings(max_examples=100, deadline=None)
@given(st.binary(max_size=200))
def test_any_bytes_are_an_error_or_a_field(data: bytes) -> None:
    known = Known(Grid((64, 30, 4096), SPACING, ORIGIN), Lattice(1e-4, 1, 0, 1, 0))
    try:
        guess = surface.synthesise(data, known)
    except FormatError:
        return
    assert len(guess.bricks) <= 4 * len(data)


def test_few_bytes_ask_for_few_bricks(good: tuple[bytes, Known]) -> None:
    data, known = good
    deep = dataclasses.replace(known, grid=Grid((21, 30, 32768), SPACING, ORIGIN))
    with pytest.raises(TruncatedFile, match="bricks"):
        surface.synthesise(bytes([data[0] & 6]) + data[1:], deep)

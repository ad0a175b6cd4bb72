"""Descriptors of media: spherical-harmonic power, octree levels, and the invariances of each part."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import special
from scipy.spatial.transform import Rotation

from medium_corpus import GRID, KINDS, body
from touchfield.codec.paper.directions import Codebook
from touchfield.errors import InvalidArgument
from touchfield.measure.descriptors import (
    DESCRIPTOR_LENGTH,
    LEVELS,
    PARTS,
    Descriptor,
    DirectionSums,
    descriptor,
    icosahedral_directions,
    octree_levels,
    thresholds_n,
)
from touchfield.measure.estimators import binary_entropy_bits
from touchfield.measure.shells import DEGREE as SHELL_DEGREE, REACH, SHELLS, shell_power
from touchfield.medium import ForceField, Grid, HapticMedium

DEGREES = np.arange(1, 9)
Float64s = NDArray[np.float64]
seeds = st.integers(0, 10_000)


def direction_power(vectors_n: NDArray[np.float64], degree: int = 8) -> NDArray[np.float64]:
    sums = DirectionSums(degree)
    sums.add(vectors_n)
    return sums.power()


def harmonics(unit: Float64s, degree: int = 8) -> Float64s:
    sums = DirectionSums(degree)
    sums.add(unit[None])
    return sums.coefficients


def vectors(seed: int, count: int = 30) -> Float64s:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)) * rng.uniform(0.1, 3, (count, 1)) + rng.normal(size=3)


def rotation_of(seed: int) -> Float64s:
    return Rotation.random(random_state=seed).as_matrix()


# -- directions --------------------------------------------------------------------------------------------


@given(seeds)
def test_addition_theorem_and_power_as_a_sum_over_pairs(seed: int) -> None:
    f = vectors(seed)
    w = np.linalg.norm(f, axis=1)
    cosines = np.clip((f / w[:, None]) @ (f / w[:, None]).T, -1, 1)
    y = np.array([harmonics(unit) for unit in f / w[:, None]])
    for degree, found in zip(DEGREES, direction_power(f), strict=True):
        legendre = special.eval_legendre(degree, cosines)
        part = y[:, degree**2 : (degree + 1) ** 2]
        assert np.abs((part @ part.T) * 4 * math.pi / (2 * degree + 1) - legendre).max() < 1e-10
        assert found == pytest.approx(w @ legendre @ w / w.sum() ** 2, abs=1e-10)


@given(seeds, st.floats(0.01, 100))
def test_power_is_invariant_to_rotation_and_scale(seed: int, factor: float) -> None:
    f = vectors(seed)
    assert direction_power(factor * f @ rotation_of(seed).T) == pytest.approx(direction_power(f), abs=1e-10)


@given(seeds, st.floats(1e-3, 0.5))
def test_power_changes_are_bounded_by_those_of_directions(seed: int, angle: float) -> None:
    """sqrt(P_l) changes by at most sqrt(l (l + 1) / 2) times the angle."""
    f = vectors(seed)
    axes = np.random.default_rng(seed).normal(size=f.shape)
    axes *= angle / np.linalg.norm(axes, axis=1, keepdims=True)
    moved = Rotation.from_rotvec(axes).apply(f)
    change = np.abs(np.sqrt(direction_power(moved)) - np.sqrt(direction_power(f)))
    assert (change <= np.sqrt(DEGREES * (DEGREES + 1) / 2) * angle + 1e-7).all()


def test_power_of_a_wall_a_cube_and_nothing() -> None:
    assert direction_power(np.array([[0, 3.0, 4.0]] * 5)) == pytest.approx(np.ones(8))
    cube = direction_power(np.concatenate([np.eye(3), -np.eye(3)]))
    assert cube[[0, 1, 2]] == pytest.approx(0, abs=1e-12)
    assert cube[3] == pytest.approx(7 / 12), "the mean of Legendre_4 at 1, -1 and four times 0"
    assert not direction_power(np.zeros((4, 3))).any()
    with pytest.raises(InvalidArgument, match="degree"):
        DirectionSums(0)


def test_directions_are_those_of_the_coder() -> None:
    assert icosahedral_directions() == pytest.approx(Codebook.get("ico2").vertices, abs=1e-9)


def test_a_sphere_on_a_lattice_within_the_bound_of_the_lattice() -> None:
    """A sample represents points up to half a cell diagonal away, which bounds the change of the normal."""
    for n in (24, 48):
        grid = Grid.over_box(*GRID.box_m, (n, n, n))
        r, wall_m = 0.055, 0.01
        angle = math.sqrt(3) / 2 * grid.spacing_m[0] / (r - wall_m)
        for seed in range(3):
            shift = np.random.default_rng(seed).uniform(-0.01, 0.01, 3)
            found = descriptor(body("sphere", r, np.eye(3), shift, grid))["direction_power"]
            assert (found <= np.sqrt(DEGREES * (DEGREES + 1) / 2) * angle).all()


@pytest.mark.parametrize("kind", KINDS)
def test_power_of_a_body_in_two_poses(kind: str) -> None:
    """The difference between poses is below a fifth of that to any other kind."""
    poses = [
        descriptor(body(kind, 0.055, rotation_of(s), np.full(3, 1e-3 * s)))["direction_power"] for s in (1, 2)
    ]
    others = [
        descriptor(body(k, 0.055, rotation_of(3), np.zeros(3)))["direction_power"] for k in KINDS if k != kind
    ]
    difference = np.linalg.norm(poses[0] - poses[1])
    assert difference < min(np.linalg.norm(poses[0] - other_power) for other_power in others) / 5


# -- octree ------------------------------------------------------------------------------------------------


def levels_of(shape: tuple[int, int, int], amplitude: float = 1.0) -> tuple[Float64s, Float64s]:
    grid = Grid((64, 64, 64), (1e-3,) * 3, (0, 0, 0))
    positions = np.argwhere(np.ones(shape)).astype(np.int32) + 3
    return octree_levels(
        grid, positions, np.full(len(positions), amplitude, np.float32), np.array([0.1, 2.0])
    )


@pytest.mark.parametrize(("shape", "dimension"), [((32, 32, 32), 3), ((32, 32, 1), 2), ((1, 32, 1), 1)])
def test_support_fraction_gives_the_dimension(shape: tuple[int, int, int], dimension: int) -> None:
    fractions, entropies = levels_of(shape)
    is_full = np.array([n == 32 for n in shape])
    assert is_full.sum() == dimension
    expected = 2.0 ** ((dimension - 3) * np.arange(1, LEVELS + 1))
    assert fractions == pytest.approx(expected)
    h2 = [0 if p == 1 else -p * math.log2(p) - (1 - p) * math.log2(1 - p) for p in expected]
    assert entropies == pytest.approx(h2), "one class of amplitude, and empty cells"


def test_levels_finer_than_the_lattice_repeat() -> None:
    fractions, entropies = levels_of((8, 8, 1))
    assert fractions == pytest.approx([0.5, 0.25, 0.125, 0.125, 0.125])
    assert entropies == pytest.approx([binary_entropy_bits(p) for p in fractions])


# -- shells ------------------------------------------------------------------------------------------------


def cloud(seed: int, count: int = 40) -> tuple[Float64s, Float64s]:
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, 3)) * (0.01, 0.02, 0.03), rng.uniform(0.05, 3, count)


@given(seeds, st.floats(0.01, 100))
def test_shells_are_invariant_to_pose_position_and_size(seed: int, factor: float) -> None:
    points, amplitudes = cloud(seed)
    plain = shell_power(points, amplitudes)
    moved = factor * points @ rotation_of(seed).T + (0.1, -0.2, 0.05)
    assert shell_power(moved, amplitudes) == pytest.approx(plain, abs=1e-9)
    assert shell_power(points * (1, 1, -1), amplitudes) == pytest.approx(plain, abs=1e-9), "its mirror image"


@given(seeds)
def test_shell_power_is_a_sum_over_pairs(seed: int) -> None:
    """The addition theorem, with all points on the sphere that is the middle of one shell."""
    unit = cloud(seed)[0]
    unit = np.concatenate([unit, -unit])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    found = shell_power(unit, np.ones(len(unit))) ** 2
    shell = SHELLS / REACH - 0.5  # of the radius 1
    fractions = [1 - (shell - int(shell)), shell - int(shell)]
    for degree in range(SHELL_DEGREE + 1):
        mean = special.eval_legendre(degree, np.clip(unit @ unit.T, -1, 1)).mean()
        expected = (2 * degree + 1) / (2 * SHELL_DEGREE + 1) * mean
        for n, fraction in enumerate(fractions):
            assert found[int(shell) + n, degree] == pytest.approx(fraction**2 * expected, abs=1e-9)


def test_shells_see_the_skin_and_survive_strong_forces() -> None:
    """A wall and a solid have one skin; forces far above SKIN_N have weights, too."""
    points, amplitudes = cloud(1)
    inside, deep = 0.3 * points, np.full(len(points), 12.0)
    skin = shell_power(points, amplitudes)
    solid = shell_power(np.concatenate([points, inside]), np.concatenate([amplitudes, deep]))
    assert solid == pytest.approx(skin, abs=1e-3)
    assert shell_power(points, amplitudes + 2000) == pytest.approx(skin, abs=1e-9)
    one = shell_power(np.zeros((1, 3)), np.ones(1))
    assert one[0, 0] == pytest.approx(13**-0.5) and np.count_nonzero(one) == 1


# -- invariances of the whole ------------------------------------------------------------------------------


def sheet(grid: Grid = GRID, shift: int = 0) -> ForceField:
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    depth = z - (14 + 3 * np.sin((x - shift) / 4) * np.cos(y / 5))
    inside = (depth > 0) & (depth < 4) & (x >= 4 + shift) & (x < 25 + shift) & (y >= 3) & (y < 20)
    amplitude = np.where(inside, 0.3 + depth / 4, 0)
    normal = np.stack([np.sin((x - shift) / 7), np.cos(y / 9), -np.ones_like(x)], axis=-1)
    return ForceField.from_dense(grid, (amplitude[..., None] * normal).astype(np.float32))


def test_descriptor_is_invariant_to_position_and_size() -> None:
    plain = descriptor(sheet())
    assert descriptor(sheet(shift=3)).values == pytest.approx(plain.values, abs=1e-6)
    twice = sheet().on_grid(GRID.moved(2.0, (0.3, 0.1, 0.0)))
    assert descriptor(twice).values == pytest.approx(plain.values, abs=1e-6)


def test_rotations_by_right_angles_change_only_directions() -> None:
    """x to y, y to z, z to x; a stiffer body has other amplitudes and classes."""
    field = sheet()
    dense = field.to_dense()
    rotated = ForceField.from_dense(GRID, dense.transpose(2, 0, 1, 3)[..., [2, 0, 1]])
    a, b = descriptor(field), descriptor(rotated)
    for part in PARTS:
        if part != "directions":
            assert b[part] == pytest.approx(a[part], abs=1e-6), part
    assert np.abs(a["directions"] - b["directions"]).max() > 0.05
    stiffer = descriptor(field.scaled(1.7))
    for part in ("directions", "direction_power", "support"):
        assert stiffer[part] == pytest.approx(a[part], abs=1e-6), part
    assert np.abs(stiffer["amplitude"] - a["amplitude"]).max() > 0.05


def test_forces_below_the_threshold_do_not_count() -> None:
    field = sheet()
    weak = np.where(field.to_dense() == 0, 0.02, field.to_dense())
    assert descriptor(ForceField.from_dense(GRID, weak.astype(np.float32))).values == pytest.approx(
        descriptor(field).values, abs=1e-6
    )


def test_amplitude_fractions_are_of_all_voxels() -> None:
    d = descriptor(sheet())
    for part in ("amplitude", "directions"):
        assert (d[part] ** 2).sum() == pytest.approx(1)
    between = math.sqrt(thresholds_n()[3] * thresholds_n()[4])
    alike = descriptor(ForceField.from_support(GRID, [[4, 5, 6]], [[0.0, between, 0.0]]))["amplitude"]
    assert alike == pytest.approx([math.sqrt(0.5) if n in (3, 4) else 0 for n in range(21)], abs=1e-3)


def test_level_entropies_are_normalised_by_the_number_of_classes() -> None:
    support = sheet().support()
    is_counted = support.amplitudes_n >= 0.05
    entropies = octree_levels(
        GRID, support.positions[is_counted], support.amplitudes_n[is_counted], thresholds_n()
    )[1]
    assert descriptor(sheet())["level_entropy"] == pytest.approx(entropies / math.log2(22))


# -- time --------------------------------------------------------------------------------------------------


def film(frames: list[ForceField], rate_hz: float) -> HapticMedium:
    return HapticMedium.from_frames(frames, rate_hz)


def test_change_in_time() -> None:
    static, moving = film([sheet()] * 3, 30), film([sheet(shift=s) for s in range(3)], 30)
    assert descriptor(static) == descriptor(sheet())
    assert (descriptor(static)["change"][0], descriptor(static)["turnover"][0]) == (0, 0)
    assert 0 < descriptor(moving)["turnover"][0] < descriptor(moving)["change"][0] < 1
    opposite = descriptor(film([sheet(), sheet().scaled(-1)], 30))
    assert (opposite["change"][0], opposite["turnover"][0]) == (1, 0)


def test_frames_count_together_and_their_changes_in_the_mean(monkeypatch: pytest.MonkeyPatch) -> None:
    first = sheet()
    second = ForceField.from_dense(GRID, 2 * first.to_dense() * (np.arange(32) < 14)[:, None, None, None])
    a, b, both, step = (
        descriptor(m) for m in (first, second, film([first, second, second], 30), film([first, second], 30))
    )
    counts = [
        int((np.linalg.norm(f.vectors_n().astype(float), axis=1) >= 0.05).sum()) for f in (first, second)
    ]
    assert both["amplitude"] ** 2 == pytest.approx(
        np.average([a["amplitude"] ** 2, b["amplitude"] ** 2], 0, counts)
    )
    assert both["support"] == pytest.approx((a["support"] + b["support"]) / 2)
    for part in ("change", "turnover"):
        assert step[part][0] > 0 and both[part][0] == pytest.approx(step[part][0] / 2)
    back = descriptor(film([second, first], 30))
    assert (back["change"], back["turnover"]) == (step["change"], step["turnover"])
    monkeypatch.setattr(sys.modules[descriptor.__module__], "_BRICKS", 1)
    assert descriptor(film([first, second], 30)).values == pytest.approx(step.values)


def test_change_does_not_depend_on_the_rate() -> None:
    frames = [sheet(shift=s) for s in range(4)]
    slow, fast = film(frames, 30), film([f for f in frames for _ in range(2)], 60)
    assert descriptor(fast, 100).values == pytest.approx(descriptor(slow, 100).values, abs=1e-6)


def test_few_frames_are_read() -> None:
    requested: list[int] = []

    def make(i: int) -> ForceField:
        requested.append(i)
        return sheet(shift=i % 5)

    descriptor(HapticMedium(GRID, 1000.0, 500, make), frames=3)
    assert requested == [0, 33, 233, 266, 466, 499]
    # two frames 20 ms apart; all frames of a shorter medium
    for rate_hz, count, expected in (
        (50.0, 9, [0, 2]),
        (1000.0, 4, [0, 3]),
    ):
        requested.clear()
        descriptor(HapticMedium(GRID, rate_hz, count, make), frames=1)
        assert requested == expected


# -- the record --------------------------------------------------------------------------------------------


def test_parts_fill_the_vector() -> None:
    assert sum(PARTS.values()) == DESCRIPTOR_LENGTH == len(descriptor(sheet()).values)


def test_invalid_arguments_are_refused() -> None:
    with pytest.raises(InvalidArgument, match=r"no force of 0\.05 N"):
        descriptor(ForceField.empty(GRID))
    with pytest.raises(InvalidArgument, match="frames"):
        descriptor(sheet(), 0)
    for values in (np.zeros(3), np.full(DESCRIPTOR_LENGTH, np.nan), np.full(DESCRIPTOR_LENGTH, 1.5)):
        with pytest.raises(InvalidArgument, match="descriptor"):
            Descriptor(values)
    with pytest.raises(InvalidArgument, match="amplitude"):
        descriptor(sheet())["colour"]

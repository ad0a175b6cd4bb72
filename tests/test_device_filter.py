"""The mapping M: placement, lattice, low-pass, resampling, and the device filter of both types."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray
from scipy import ndimage, signal

from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters import (
    LOW_PASSES,
    DeviceFilter,
    DeviceFilterSpec,
    Placement,
    device_grid,
    device_medium,
    frequency_response,
    limited,
    nyquist_per_m,
    resample,
)
from touchfield.filters.resample import axis_weights, grid_weights, low_pass
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.scene import CAMERA_AXES, UP_Y_AXES, UP_Z_AXES, Scene

Forces = Callable[[NDArray[np.float64], ForceProfile], NDArray[np.float64]]
OMNI = device("phantom-omni")
WALL = profile_of(LawSpec(), 0.0066)


class Formula(Scene):
    """A scene whose forces [..., 3] are a formula of points [..., 3], scene metres."""

    def __init__(self, forces: Forces, axes: str = UP_Y_AXES) -> None:
        self.forces, self.axes, self.asked = forces, axes, 0

    def bounds_m(self) -> NDArray[np.float64]:
        return np.array([[-1.0] * 3, [1.0] * 3])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        self.asked += 1
        points = grid.to_m(np.stack(np.indices(grid.shape), axis=-1))
        return ForceField.from_dense(grid, self.forces(points, profile))


def ball(radius_m: float) -> Formula:
    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        r = np.linalg.norm(points, axis=-1)
        return profile(r - radius_m)[..., None] * points / np.maximum(r, 1e-12)[..., None]

    return Formula(forces)


def floor_at(height_m: float) -> Formula:
    return Formula(lambda p, f: f(p[..., 1] - height_m)[..., None] * np.array([0.0, 1.0, 0.0]))


def random_field(grid: Grid, seed: int, share: float = 0.05) -> ForceField:
    rng = np.random.default_rng(seed)
    return ForceField.from_dense(
        grid, rng.normal(size=(*grid.shape, 3)) * (rng.random(grid.shape) < share)[..., None]
    )


def dense_resample(field: ForceField, grid: Grid, kernel: str) -> NDArray[np.float64]:
    weights = grid_weights(field.grid, grid, low_pass(kernel), nyquist_per_m(grid))
    x, y, z = (w.dense(n) for w, n in zip(weights, field.grid.shape, strict=True))
    return np.einsum("ia,jb,kc,abcd->ijkd", x, y, z, field.to_dense().astype(float), optimize=True)


def decibels(gain: NDArray[np.complex128]) -> NDArray[np.float64]:
    return 20 * np.log10(np.abs(gain))


# -- frequency response, equation 5 -----------------------------------------------------------------------------


def test_frequency_response_of_known_filters() -> None:
    assert decibels(frequency_response(np.ones(3) / 3, 0.9756)) == pytest.approx(-3.01, abs=0.005)
    fir = decibels(frequency_response(signal.firwin(31, 1 / 4), np.pi * np.array([0.25, 0.375])))
    assert fir == pytest.approx([-6.010, -54.5], abs=0.05)
    assert abs(frequency_response([-1, 2, -1], 0.0)) < 1e-15
    omega = (np.arange(4096) + 0.5) * 2 * np.pi / 4096
    for taps, bits in (([0.25, 0.5, 0.25], -2.0), (np.ones(3) / 3, -1.584963)):
        assert np.log2(np.abs(frequency_response(taps, omega))).mean() == pytest.approx(bits, abs=2e-3)


def test_frequency_response_in_two_and_three_dimensions() -> None:
    rng = np.random.default_rng(1)
    for taps in (rng.normal(size=(3, 5)), rng.normal(size=(2, 3, 4))):
        omegas = rng.uniform(-3, 3, (taps.ndim, 7, 2))
        places = np.stack(np.indices(taps.shape), axis=0).reshape(taps.ndim, -1)
        direct = np.exp(-1j * np.einsum("aij,an->ijn", omegas, places)) @ taps.reshape(-1)
        assert np.allclose(frequency_response(taps, *omegas), direct)
    with pytest.raises(InvalidArgument, match="one for each axis"):
        frequency_response(np.ones((3, 3)), 0.5)


@pytest.mark.parametrize(
    ("name", "minus_three", "at_cutoff", "at_stop", "overshoot"),
    [
        ("spline", 0.71, -6.0, -14.2, 0.0),
        ("gaussian", 0.71, -6.0, -13.5, 0.0),
        ("box", 0.89, -3.9, -10.5, 0.0),
        ("sinc", 0.90, -6.0, -54.0, 0.076),
    ],
)
def test_the_table_of_kernels_is_as_documented(
    name: str, minus_three: float, at_cutoff: float, at_stop: float, overshoot: float
) -> None:
    kernel, step = LOW_PASSES[name], 1e-3
    x = np.arange(-3, 3, step) + step / 2
    taps = kernel.shape(x, step) * (np.abs(x) <= kernel.half_width)
    taps /= taps.sum()
    gains = decibels(frequency_response(taps, 2 * np.pi * step * np.array([minus_three, 1.0, 1.5])))
    assert gains == pytest.approx([-3.01, at_cutoff, at_stop], abs=0.6)
    rise = np.cumsum(taps)
    assert rise.max() - 1 == pytest.approx(overshoot, abs=1e-3)
    assert np.allclose(taps[::-1], taps, atol=1e-12)
    assert (taps.min() >= 0) == (overshoot == 0)


# -- resampling -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize(
    ("shape", "target"),
    [
        ((20, 33, 41), (10, 11, 20)),
        ((16, 16, 16), (16, 16, 16)),
        ((30, 9, 1), (13, 20, 1)),
        ((12, 30, 17), (40, 11, 33)),
    ],
)
def test_resample_equals_the_dense_product(
    kernel: str, shape: tuple[int, int, int], target: tuple[int, int, int]
) -> None:
    field = random_field(Grid.over_box((0, 0, 0), (1, 1.3, 0.7), shape), 3)
    grid = Grid.over_box((-0.1, 0.2, 0), (0.9, 1.5, 0.7), target)
    made, expected = resample(field, grid, kernel), dense_resample(field, grid, kernel)
    assert np.abs(made.to_dense() - expected).max() < 1e-6
    assert np.abs(expected).max() > 0.1
    assert made == ForceField.from_dense(grid, made.to_dense())  # no empty brick, nothing beyond the grid


@given(
    st.tuples(*[st.integers(1, 20)] * 3), st.tuples(*[st.integers(1, 20)] * 3),
    st.tuples(*[st.floats(-0.6, 0.6)] * 3), st.integers(0, 99), st.sampled_from(sorted(LOW_PASSES)),
)  # fmt: skip
def test_resample_to_any_lattice_is_linear_and_equals_the_dense_product(
    shape: tuple[int, int, int],
    target: tuple[int, int, int],
    shift: tuple[float, float, float],
    seed: int,
    kernel: str,
) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), shape)
    grid = Grid.over_box(shift, np.add(shift, (1, 0.8, 1.2)), target)
    a, b = random_field(source, seed, 0.2), random_field(source, seed + 1, 0.2)
    made = resample(a, grid, kernel).to_dense()
    assert np.abs(made - dense_resample(a, grid, kernel)).max() < 3e-6
    both = resample(a + b.scaled(2), grid, kernel).to_dense()
    assert np.abs(both - made - 2 * resample(b, grid, kernel).to_dense()).max() < 2e-5


def test_resample_is_the_same_for_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    field = random_field(Grid.over_box((0, 0, 0), (1, 1, 1), (64, 64, 64)), 5, 0.01)
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (48, 48, 48))
    made = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        made.append(resample(field, grid))
    assert made[0] == made[1]


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize("factor", [1, 2, 3, 5])
def test_a_constant_passes_unchanged_in_the_interior(kernel: str, factor: int) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (50, 50, 50))
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (50 // factor,) * 3)
    force = np.array([1.0, -2.0, 0.5])
    dense = resample(ForceField.from_dense(source, np.broadcast_to(force, (50, 50, 50, 3))), grid, kernel).to_dense()
    rim = math.ceil(2 * LOW_PASSES[kernel].half_width)
    inner = dense[(slice(rim, -rim),) * 3]
    assert inner.size > 0
    assert np.abs(inner - force).max() < 2e-6


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_decimation_by_the_box_keeps_the_total(factor: int) -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (24, 24, 24))
    field = random_field(source, 7)
    small = resample(field, Grid.over_box((0, 0, 0), (1, 1, 1), (24 // factor,) * 3), "box")
    blocks = field.to_dense().reshape(24 // factor, factor, 24 // factor, factor, 24 // factor, factor, 3)
    assert np.abs(small.to_dense() - blocks.mean(axis=(1, 3, 5))).max() < 1e-6
    total = field.vectors_n().sum(axis=0, dtype=float)
    assert small.vectors_n().sum(axis=0, dtype=float) * factor**3 == pytest.approx(total, abs=1e-4)


def test_smoothing_at_the_same_rate_equals_scipy() -> None:
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (20, 21, 22))
    field = random_field(grid, 9)
    expected = field.to_dense().astype(float)
    for axis in range(3):
        weights = grid_weights(grid, grid, low_pass("gaussian"), nyquist_per_m(grid))[axis].weights[10]
        expected = ndimage.convolve1d(expected, weights.astype(float), axis=axis, mode="constant")
    assert np.abs(resample(field, grid, "gaussian").to_dense() - expected).max() < 1e-6


def test_a_kernel_does_not_shift_the_field() -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (60, 60, 60))
    points = source.to_m(np.stack(np.indices(source.shape), axis=-1))
    blob = np.exp(-((points - (0.47, 0.52, 0.55)) ** 2).sum(-1) / (2 * 0.08**2))
    field = ForceField.from_dense(source, blob[..., None] * np.array([0.0, 0.0, 1.0]))
    for count in (60, 30, 23):
        grid = Grid.over_box((0, 0, 0), (1, 1, 1), (count,) * 3)
        made = resample(field, grid)
        centre = np.average(grid.to_m(made.positions()), axis=0, weights=made.vectors_n()[:, 2])
        assert centre == pytest.approx((0.47, 0.52, 0.55), abs=2e-4)


@pytest.mark.parametrize("kernel", LOW_PASSES)
def test_a_wave_above_the_new_nyquist_rate_is_attenuated_as_designed(kernel: str) -> None:
    source = Grid((256, 1, 1), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    grid = Grid((64, 1, 1), (4.0, 1.0, 1.0), (1.5, 0.0, 0.0))
    weights = axis_weights((256, 1.0, 0.0), (64, 4.0, 1.5), low_pass(kernel), 1 / 8).weights[30]
    for frequency in (0.05, 0.1, 0.19, 0.23):  # the Nyquist rate of the target is 0.125
        wave = np.zeros((256, 1, 1, 3))
        wave[:, 0, 0, 0] = np.sin(2 * np.pi * frequency * np.arange(256))
        made = resample(ForceField.from_dense(source, wave), grid, kernel).to_dense()[8:-8, 0, 0, 0]
        designed = abs(frequency_response(weights, 2 * np.pi * frequency))
        assert np.sqrt(2 * np.mean(made**2)) == pytest.approx(designed, abs=0.03)
        if frequency > 0.18:
            assert designed < 0.35


def test_a_step_rings_only_where_the_kernel_has_negative_lobes() -> None:
    source = Grid((64, 4, 4), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    wall = np.zeros((64, 4, 4, 3))
    wall[20:44, ..., 0] = 1.0
    field, grid = ForceField.from_dense(source, wall), Grid((32, 1, 1), (2.0, 4.0, 4.0), (0.5, 1.5, 1.5))
    for kernel in LOW_PASSES:
        made = resample(field, grid, kernel).to_dense()[..., 0]
        assert (made.min() < -0.01) == (kernel == "sinc")
        if kernel != "sinc":
            assert made.max() <= 1.0 + 1e-6


def test_fields_that_cannot_be_resampled() -> None:
    source = Grid.over_box((0, 0, 0), (1, 1, 1), (8, 8, 8))
    field = random_field(source, 1, 1.0)
    assert resample(ForceField.empty(source), source).support_count == 0
    assert resample(field, Grid.over_box((5, 5, 5), (6, 6, 6), (8, 8, 8))).support_count == 0
    with pytest.raises(InvalidArgument, match="low_pass"):
        resample(field, source, "brick wall")
    with pytest.raises(InvalidArgument, match="cutoff_per_m"):
        resample(field, source, cutoffs_per_m=(0.0, 1.0, 1.0))
    with pytest.raises(InvalidArgument, match="bricks reached"):
        resample(field, Grid.over_box((0, 0, 0), (1, 1, 1), (1 << 14,) * 3))
    with pytest.raises(InvalidArgument, match="coarser source"):
        resample(field, source, cutoffs_per_m=(1e-9, 1.0, 1.0))


# -- placement and lattice --------------------------------------------------------------------------------------

boxes = st.tuples(*[st.floats(-50, 50)] * 3, *[st.floats(0, 30) | st.just(0.0)] * 3).filter(
    lambda b: max(b[3:]) > 1e-3
)


@given(boxes, st.tuples(*[st.floats(0.05, 2)] * 3), st.floats(0, 0.02))
def test_fit_fills_the_workspace_and_no_more(
    box: tuple[float, ...], workspace: tuple[float, float, float], margin: float
) -> None:
    low, extent = np.array(box[:3]), np.array(box[3:])
    placement = Placement.fit([low, low + extent], workspace, margin)
    corners = placement.scale * (np.array([low, low + extent]) - placement.offset_m)
    room = np.array(workspace) / 2 - margin
    assert (np.abs(corners) <= room * (1 + 1e-6) + 1e-9).all()
    assert np.isclose(np.abs(corners), room, rtol=1e-5).any()


def test_crop_and_scale_keep_the_centre_of_the_box() -> None:
    box = [[1.0, 2.0, 3.0], [2.0, 6.0, 3.0]]
    assert Placement.crop(box) == Placement(1.0, (1.5, 4.0, 3.0))
    assert Placement.scaled(box, 0.05) == Placement(0.05, (1.5, 4.0, 3.0))
    assert Placement.fit(box, (0.1, 0.1, math.inf)) == Placement(0.1 / 4, (1.5, 4.0, 3.0))
    grid = device_grid(OMNI, 5)
    placement = Placement.scaled(box, 0.05)
    there = placement.to_scene(grid)
    assert there.spacing_m == pytest.approx(np.array(grid.spacing_m) * 20)
    assert np.mean(there.box_m, axis=0) == pytest.approx((1.5, 4.0, 3.0))
    assert np.allclose(placement.to_hand(there).box_m, grid.box_m, atol=1e-15)


@pytest.mark.parametrize(
    "box",
    [
        [[0, 0, 0], [0, 0, 0]],
        [[0, 0, 0], [1, -1, 1]],
        [[0, 0, 0], [1, math.nan, 1]],
        [[0, 0, 0], [1, math.inf, 1]],
        [0, 1],
        [[-1e308] * 3, [1e308] * 3],
    ],
)
@pytest.mark.filterwarnings("ignore:overflow")
def test_a_box_that_is_none(box: list[list[float]]) -> None:
    with pytest.raises(InvalidArgument, match="scene_box_m"):
        Placement.fit(box, (1, 1, 1))


def test_placements_that_are_impossible() -> None:
    box = [[0, 0, 0], [1, 1, 1]]
    for margin in (0.5, -0.1, math.nan):
        with pytest.raises(InvalidArgument, match="margin_m"):
            Placement.fit(box, (1, 1, 1), margin)
    for workspace in ((1, 1), (1, 0, 1), (1, math.nan, 1), (math.inf,) * 3):
        with pytest.raises(InvalidArgument, match="workspace_m"):
            Placement.fit(box, workspace)
    for scale in (0.0, -1.0, math.inf, math.nan, 1e-320):
        with pytest.raises(InvalidArgument, match="scale"):
            Placement.scaled(box, scale)
    with pytest.raises(InvalidArgument, match="offset_m"):
        Placement(1.0, (0.0, math.nan, 0.0))


def test_the_lattice_fills_the_workspace() -> None:
    grid = device_grid(OMNI, 5)
    assert grid.shape == (32, 32, 32)
    assert np.allclose(grid.box_m, [(-0.08, -0.06, -0.035), (0.08, 0.06, 0.035)])
    nominal = device_grid(OMNI)
    assert nominal.shape == (2909, 2182, 1273)
    assert np.allclose(nominal.spacing_m, 55e-6, rtol=1e-3)
    for nw in (2, 11, -1, 5.5):
        with pytest.raises(InvalidArgument, match="nw"):
            device_grid(OMNI, nw)  # type: ignore[arg-type]


def test_an_array_has_its_own_lattice() -> None:
    pad = device("dotpad")
    grid = device_grid(pad, 7)
    assert grid.shape == (60, 40, 1)
    assert grid.spacing_m == pytest.approx((0.0025, 0.0025, 0.15))
    assert device_grid(pad, depth_m=0.5).spacing_m[2] == 0.5


# -- clip and floor ---------------------------------------------------------------------------------------------


@given(
    arrays(np.float32, (3, 2, 9, 3), elements=st.floats(-1e3, 1e3, width=32)), st.floats(1e-2, 50), st.floats(0, 0.9)
)
def test_limits_hold_keep_the_direction_and_do_nothing_twice(
    forces: NDArray[np.float32], force_max: float, share: float
) -> None:
    field = ForceField.from_dense(Grid((3, 2, 9), (1, 1, 1), (0, 0, 0)), forces)
    once = limited(field, force_max, share * force_max)
    before, after = field.to_dense().astype(float), once.to_dense().astype(float)
    long, short = np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1)
    assert (short <= force_max).all()
    assert not short[long < share * force_max * (1 - 1e-6)].any()
    assert short == pytest.approx(np.where(short > 0, np.minimum(long, force_max), 0), rel=1e-5, abs=1e-30)
    assert np.abs(np.cross(before, after)).max() <= 1e-5 * (long * short).max()
    assert limited(once, force_max, share * force_max) == once


# -- the device filter, type 1 ----------------------------------------------------------------------------------


def mapped(
    scene: Scene, spec: DeviceFilterSpec, placement: Placement, profile: ForceProfile = WALL, nw: int = 4
) -> ForceField:
    grid = device_grid(OMNI, nw)
    return DeviceFilter(OMNI, grid, placement, spec).frames(scene, profile)(0)


def test_the_wall_of_a_ball_is_felt_where_it_is_and_nowhere_else() -> None:
    thick = profile_of(LawSpec(stiffness_n_per_m=200.0), math.inf)
    field = mapped(ball(0.025), DeviceFilterSpec(), Placement(), thick, nw=5)
    r = np.linalg.norm(field.grid.to_m(field.positions()), axis=1)
    assert r.max() < 0.025 + 2 * max(field.grid.spacing_m)
    forces = field.vectors_n()
    outward = forces * field.grid.to_m(field.positions()) / r[:, None]
    inside = (r > 0.012) & (r < 0.018)
    assert inside.sum() > 50
    assert outward.sum(-1)[inside] == pytest.approx(thick(r[inside] - 0.025), rel=0.06)


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize("oversample", [1, 2, 3])
def test_no_force_is_above_f_max_or_below_the_floor(kernel: str, oversample: int) -> None:
    stiff = profile_of(LawSpec(stiffness_n_per_m=5000.0, force_max_n=12.0), math.inf)
    field = mapped(ball(0.02), DeviceFilterSpec(oversample, 0.02, kernel), Placement(), stiff)
    lengths = np.linalg.norm(field.vectors_n().astype(float), axis=1)
    assert lengths.max() <= OMNI.force_max_n
    assert lengths.max() > 0.999 * OMNI.force_max_n  # it did clip
    assert lengths.min() >= 0.02 * OMNI.force_max_n


def test_the_floor_keeps_tails_out_of_the_support() -> None:
    all_of_it = mapped(ball(0.025), DeviceFilterSpec(force_floor_share=0), Placement(), nw=5)
    kept = mapped(ball(0.025), DeviceFilterSpec(), Placement(), nw=5)
    assert 0 < kept.support_count < all_of_it.support_count
    assert limited(all_of_it, OMNI.force_max_n, 0.01 * OMNI.force_max_n) == kept


def test_scene_and_hand_metres_meet() -> None:
    small = mapped(ball(0.025), DeviceFilterSpec(), Placement())
    large = mapped(ball(2.5), DeviceFilterSpec(), Placement(0.01))
    assert np.abs(small.to_dense() - large.to_dense()).max() < 1e-5
    assert small.support_count > 100


def test_the_filter_is_linear_before_the_clip() -> None:
    soft = ForceProfile(tuple((a, b, c / 9, s / 9) for a, b, c, s in WALL.pieces))
    spec = DeviceFilterSpec(force_floor_share=0)
    one, nine = (mapped(ball(0.02), spec, Placement(), law) for law in (soft, WALL))
    assert np.abs(9 * one.to_dense() - nine.to_dense()).max() < 1e-5 * OMNI.force_max_n
    assert nine.support_count > 100


def test_nothing_fades_at_the_border_of_the_workspace() -> None:
    dense = mapped(floor_at(0.0), DeviceFilterSpec(), Placement(), profile_of(LawSpec(), math.inf)).to_dense()
    assert np.abs(dense - dense[8:9, :, 8:9]).max() < 1e-6
    assert dense[0, 0, 0, 1] == pytest.approx(OMNI.force_max_n, rel=1e-5)


def test_an_empty_scene_gives_an_empty_field() -> None:
    empty = Formula(lambda p, f: np.zeros(p.shape))
    assert mapped(empty, DeviceFilterSpec(), Placement()).support_count == 0


@pytest.mark.parametrize(
    "wrong",
    [
        {"oversample": 0}, {"oversample": 9}, {"oversample": 2.5}, {"force_floor_share": -0.1},
        {"force_floor_share": 1.0}, {"force_floor_share": math.nan}, {"low_pass": "wall"}, {"pool": "min"},
        {"cutoff": "high"},
    ],
)  # fmt: skip
def test_a_spec_that_is_impossible(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidArgument, match=next(iter(wrong))):
        DeviceFilterSpec(**wrong)  # type: ignore[arg-type]


# -- the device filter, type 2 ----------------------------------------------------------------------------------

PITCH_M = 0.0125
SHIRT = replace(  # a strip of the T-shirt, so that the formulas are cheap
    device("tshirt-32x32"), lattice=(32, 3, 1), workspace_mm=(400.0, 37.5, 60.0), force_max_n=10.0
)


def stripes(frequency_per_m: float) -> Formula:
    """A sheet at z = 0, 20 mm thick, whose force is 2 + cos along x: |F| is never zero."""

    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        amplitude = (2 + np.cos(2 * np.pi * frequency_per_m * points[..., 0])) * (np.abs(points[..., 2]) < 0.01)
        return amplitude[..., None] * np.array([0.6, 0.0, -0.8])

    return Formula(forces)


def on_array(scene: Scene, spec: DeviceFilterSpec, shirt: Device = SHIRT) -> ForceField:
    return DeviceFilter(shirt, device_grid(shirt), Placement(), spec).frames(scene, WALL)(0)


@pytest.mark.parametrize(("low_pass_name", "left"), [("spline", 0.16), ("sinc", 0.005)])
def test_the_literal_cutoff_aliases_and_the_corrected_one_does_not(low_pass_name: str, left: float) -> None:
    heard = {}
    for cutoff in ("literal", "nyquist"):
        field = on_array(stripes(0.8 / PITCH_M), DeviceFilterSpec(low_pass=low_pass_name, cutoff=cutoff))
        x = device_grid(SHIRT).axis_m(0)
        line = field.to_dense()[:, 1, 0, 2]
        heard[cutoff] = 2 * abs(np.mean(line[1:31] * np.exp(-2j * np.pi * 0.2 / PITCH_M * x[1:31])))
        assert line.mean() == pytest.approx(2, rel=0.1)
    assert heard["literal"] > 0.85  # felt as 0.2/d
    assert heard["nyquist"] < left


def test_an_actuator_renders_the_magnitude_along_its_normal() -> None:
    field = on_array(stripes(0.0), DeviceFilterSpec())
    dense = field.to_dense()
    assert dense.shape == (32, 3, 1, 3)
    assert not dense[..., :2].any()
    assert dense[..., 2] == pytest.approx(3.0, rel=1e-5)


def test_pooling_by_greatest_and_by_mean() -> None:
    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        z = points[..., 2]
        amplitude = np.where(np.abs(z) < 0.01, 1.0, 0.0) + np.where(np.abs(z - 0.02) < 0.005, 4.0, 0.0)
        return amplitude[..., None] * np.array([0.0, -1.0, 0.0])

    dense = {
        pool: on_array(Formula(forces), DeviceFilterSpec(pool=pool)).to_dense()[..., 2] for pool in ("max", "mean")
    }
    assert dense["max"] == pytest.approx(4.0, rel=1e-5)
    assert dense["mean"] == pytest.approx(2.0, rel=0.1)  # 20 mm of 1 N and 10 mm of 4 N


def test_the_third_axis_is_pooled_whatever_the_axes() -> None:
    made = []
    for axes in (UP_Y_AXES, UP_Z_AXES, CAMERA_AXES):
        scene = stripes(0.1 / PITCH_M)
        scene.axes = axes
        made.append(on_array(scene, DeviceFilterSpec()))
    assert made[0] == made[1] == made[2]


def test_an_array_clips_and_drops_too() -> None:
    shirt = replace(SHIRT, force_max_n=1.5)
    amplitudes = on_array(stripes(0.1 / PITCH_M), DeviceFilterSpec(), shirt).vectors_n()[:, 2]
    assert amplitudes.max() <= 1.5 and amplitudes.min() >= 0.015


def test_a_deep_array_is_pooled_in_slabs(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = stripes(0.1 / PITCH_M)
    whole = on_array(scene, DeviceFilterSpec())
    monkeypatch.setattr("touchfield.filters.device_filter.MAX_SLAB_SAMPLES", 1 << 16)
    before = scene.asked
    assert on_array(scene, DeviceFilterSpec()) == whole
    assert scene.asked - before > 5


def test_an_array_is_one_sample_deep() -> None:
    with pytest.raises(InvalidArgument, match="deep"):
        DeviceFilter(SHIRT, device_grid(OMNI, 3), Placement())


# -- the medium -------------------------------------------------------------------------------------------------


class Stored(Formula):
    """A scene that holds a medium, as a stored field does."""

    def __init__(self, medium: HapticMedium) -> None:
        super().__init__(lambda p, f: medium[0].sample_n(p).astype(float))
        self.medium, self.frame_count, self.rate_hz = medium, medium.frame_count, medium.rate_hz


def stored() -> Stored:
    field = random_field(device_grid(OMNI, 4), 3)
    medium = HapticMedium.from_frames([field, field.scaled(0.5)], 25.0)
    return Stored(replace(medium, friction=0.3, tags=("symbolic",), provenance={"from": "afar"}))


def test_a_medium_is_lazy_and_says_where_it_comes_from() -> None:
    scene = ball(0.02)
    medium = device_medium(scene, OMNI, device_grid(OMNI, 4), Placement(), WALL)
    assert scene.asked == 0
    assert medium[0] == mapped(scene, DeviceFilterSpec(), Placement())
    assert (medium.rate_hz, len(medium), medium.axes) == (scene.rate_hz, 1, UP_Y_AXES)
    assert medium.provenance["device"] == "phantom-omni"
    assert "spline" in medium.provenance["device_filter"] and "scale 1.0" in medium.provenance["placement"]


def test_a_stored_medium_on_the_same_lattice_passes_untouched() -> None:
    scene = stored()
    grid = scene.medium.grid
    assert device_medium(scene, OMNI, grid, Placement(), WALL) is scene.medium
    hand = Placement(0.5)
    relabelled = device_medium(scene, OMNI, hand.to_hand(grid), hand, WALL)
    assert np.array_equal(relabelled[1].forces_n, scene.medium[1].forces_n)
    assert relabelled.friction == 0.3 and scene.asked == 0


def test_a_stored_medium_on_another_lattice_is_filtered_and_keeps_what_travels_beside_it() -> None:
    scene = stored()
    grid = device_grid(OMNI, 3)
    medium = device_medium(scene, OMNI, grid, Placement(), WALL)
    assert medium[0].grid == grid and scene.asked == 1
    assert (medium.friction, medium.tags, len(medium)) == (0.3, ("symbolic",), 2)
    assert medium.provenance["from"] == "afar" and medium.provenance["device"] == "phantom-omni"

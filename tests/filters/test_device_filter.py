"""The device filter of both types: the mapping M, clip and floor, and a medium on a device's lattice."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from random_fields import OMNI, random_field
from touchfield.devices import Device, device
from touchfield.errors import InvalidArgument
from touchfield.filters import (
    LOW_PASSES,
    DeviceFilter,
    DeviceFilterSpec,
    Placement,
    device_grid,
    device_medium,
    limit_forces,
)
from touchfield.filters.point_filter import exact_forces
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.sources.laws import ForceProfile, LawSpec, profile_of
from touchfield.sources.scene import CAMERA_AXES, UP_Y_AXES, UP_Z_AXES, Scene
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere

Forces = Callable[[NDArray[np.float64], ForceProfile], NDArray[np.float64]]

WALL = profile_of(LawSpec(), 0.0066)


class Formula(Scene):
    """A scene whose forces [..., 3] are a function of points [..., 3] in scene metres."""

    def __init__(self, forces: Forces, axes: str = UP_Y_AXES) -> None:
        self.forces, self.axes, self.call_count = forces, axes, 0

    def bounds_m(self) -> NDArray[np.float64]:
        return np.array([[-1.0] * 3, [1.0] * 3])

    def field(self, frame: int, grid: Grid, profile: ForceProfile) -> ForceField:
        self.call_count += 1
        points = np.empty((*grid.shape, 3))
        for axis, along in enumerate(np.ix_(*(grid.axis_m(a) for a in range(3)))):
            points[..., axis] = along
        return ForceField.from_dense(grid, self.forces(points, profile))


def ball(radius_m: float) -> Formula:
    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        r = np.linalg.norm(points, axis=-1)
        return profile(r - radius_m)[..., None] * points / np.maximum(r, 1e-12)[..., None]

    return Formula(forces)


def floor_at(height_m: float) -> Formula:
    return Formula(lambda p, f: f(p[..., 1] - height_m)[..., None] * np.array([0.0, 1.0, 0.0]))


# -- clip and floor ----------------------------------------------------------------------------------------


@given(
    arrays(np.float32, (3, 2, 9, 3), elements=st.floats(-1e3, 1e3, width=32)),
    st.floats(1e-2, 50),
    st.floats(0, 0.9),
)
def test_limits_preserve_the_direction_and_are_idempotent(
    forces: NDArray[np.float32], force_max: float, floor_fraction: float
) -> None:
    field = ForceField.from_dense(Grid((3, 2, 9), (1, 1, 1), (0, 0, 0)), forces)
    limited = limit_forces(field, force_max, floor_fraction * force_max)
    before, after = field.to_dense().astype(float), limited.to_dense().astype(float)
    long, short = np.linalg.norm(before, axis=-1), np.linalg.norm(after, axis=-1)
    assert (short <= force_max).all()
    assert not short[long < floor_fraction * force_max * (1 - 1e-6)].any()
    assert short == pytest.approx(np.where(short > 0, np.minimum(long, force_max), 0), rel=1e-5, abs=1e-30)
    assert np.abs(np.cross(before, after)).max() <= 1e-5 * (long * short).max()
    assert limit_forces(limited, force_max, floor_fraction * force_max) == limited


# -- the device filter, type 1 -----------------------------------------------------------------------------


def mapped(
    scene: Scene, spec: DeviceFilterSpec, placement: Placement, profile: ForceProfile = WALL, nw: int = 4
) -> ForceField:
    grid = device_grid(OMNI, nw)
    return device_medium(scene, DeviceFilter(OMNI, grid, placement, profile, spec))[0]


def test_wall_of_a_ball_has_forces_inside_only() -> None:
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
def test_forces_are_within_floor_and_f_max(kernel: str, oversample: int) -> None:
    stiff = profile_of(LawSpec(stiffness_n_per_m=5000.0, force_max_n=12.0), math.inf)
    field = mapped(ball(0.02), DeviceFilterSpec(oversample, 0.02, kernel), Placement(), stiff)
    lengths = np.linalg.norm(field.vectors_n().astype(float), axis=1)
    assert lengths.max() <= OMNI.force_max_n
    assert lengths.max() > 0.999 * OMNI.force_max_n  # some forces were clipped
    assert lengths.min() >= 0.02 * OMNI.force_max_n


def test_floor_removes_tails_from_the_support() -> None:
    unfiltered = mapped(ball(0.025), DeviceFilterSpec(force_floor_share=0), Placement(), nw=5)
    floored = mapped(ball(0.025), DeviceFilterSpec(), Placement(), nw=5)
    assert 0 < floored.support_count < unfiltered.support_count
    assert limit_forces(unfiltered, OMNI.force_max_n, 0.01 * OMNI.force_max_n) == floored


def test_scene_and_hand_metres_are_related_by_the_placement() -> None:
    small = mapped(ball(0.025), DeviceFilterSpec(), Placement())
    large = mapped(ball(2.5), DeviceFilterSpec(), Placement(0.01))
    assert np.abs(small.to_dense() - large.to_dense()).max() < 1e-5
    assert small.support_count > 100


def test_filter_is_linear_before_the_clip() -> None:
    soft = ForceProfile(tuple((a, b, c / 9, s / 9) for a, b, c, s in WALL.pieces))
    spec = DeviceFilterSpec(force_floor_share=0)
    soft_field, stiff_field = (mapped(ball(0.02), spec, Placement(), law) for law in (soft, WALL))
    assert np.abs(9 * soft_field.to_dense() - stiff_field.to_dense()).max() < 1e-5 * OMNI.force_max_n
    assert stiff_field.support_count > 100


def test_forces_do_not_fade_at_the_border_of_the_workspace() -> None:
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
def test_invalid_specs_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InvalidArgument, match=next(iter(wrong))):
        DeviceFilterSpec(**wrong)  # type: ignore[arg-type]


# -- the device filter, type 2 -----------------------------------------------------------------------------

PITCH_M = 0.0125

SHIRT = replace(  # a strip of the T-shirt, to evaluate few points
    device("tshirt-32x32"), lattice=(32, 3, 1), workspace_mm=(400.0, 37.5, 60.0), force_max_n=10.0
)


def stripes(frequency_per_m: float) -> Formula:
    """A sheet at z = 0, 20 mm thick, with force 2 + cos along x: |F| is never zero."""

    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        amplitude = (2 + np.cos(2 * np.pi * frequency_per_m * points[:, :1, :1, 0])) * (
            np.abs(points[..., 2]) < 0.01
        )
        return amplitude[..., None] * np.array([0.6, 0.0, -0.8])

    return Formula(forces)


def on_array(scene: Scene, spec: DeviceFilterSpec, shirt: Device = SHIRT) -> ForceField:
    return device_medium(scene, DeviceFilter(shirt, device_grid(shirt), Placement(), WALL, spec))[0]


@pytest.mark.parametrize(("low_pass_name", "residual"), [("spline", 0.16), ("sinc", 0.005)])
def test_the_literal_cutoff_aliases_and_the_corrected_one_does_not(
    low_pass_name: str, residual: float
) -> None:
    alias_n = {}
    for cutoff in ("literal", "nyquist"):
        field = on_array(stripes(0.8 / PITCH_M), DeviceFilterSpec(low_pass=low_pass_name, cutoff=cutoff))
        x = device_grid(SHIRT).axis_m(0)
        line = field.to_dense()[:, 1, 0, 2]
        alias_n[cutoff] = 2 * abs(np.mean(line[1:31] * np.exp(-2j * np.pi * 0.2 / PITCH_M * x[1:31])))
        assert line.mean() == pytest.approx(2, rel=0.1)
    assert alias_n["literal"] > 0.85  # aliased to 0.2/d
    assert alias_n["nyquist"] < residual


def test_an_actuator_renders_the_magnitude_along_its_normal() -> None:
    field = on_array(stripes(0.0), DeviceFilterSpec())
    dense = field.to_dense()
    assert dense.shape == (32, 3, 1, 3)
    assert not dense[..., :2].any()
    assert dense[..., 2] == pytest.approx(3.0, rel=1e-5)


def test_pooling_by_maximum_and_by_mean() -> None:
    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        z = points[..., 2]
        amplitude = np.where(np.abs(z) < 0.01, 1.0, 0.0) + np.where(np.abs(z - 0.02) < 0.005, 4.0, 0.0)
        return amplitude[..., None] * np.array([0.0, -1.0, 0.0])

    dense = {
        pool: on_array(Formula(forces), DeviceFilterSpec(pool=pool)).to_dense()[..., 2]
        for pool in ("max", "mean")
    }
    assert dense["max"] == pytest.approx(4.0, rel=1e-5)
    assert dense["mean"] == pytest.approx(2.0, rel=0.1)  # 20 mm of 1 N and 10 mm of 4 N


# -- pins: what a finger meets from above
STEPS_M = (0.002, 0.03, 0.008, 0.024, 0.012)
"""Heights of five terraces along x; overall the lowest is 0.001 and the highest 0.031."""


def terraces(axes: str = UP_Z_AXES) -> Formula:
    """Solid terrain whose force is at its limit below most of its surface."""
    sign = -1.0 if axes == CAMERA_AXES else 1.0

    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        step_index = np.floor((points[:, :1, :1, 0] / PINS.pitch_mm * 1e3 + 15.0) / 6).astype(int)
        height = np.array([0.001, *STEPS_M, 0.031])[np.clip(step_index + 1, 0, 6)]
        depth = height - 0.016 - sign * points[..., 2]
        return np.clip(500.0 * depth, 0, 3.3)[..., None] * np.array([0.0, 0.0, sign])

    return Formula(forces, axes)


PINS = replace(device("graphiti"), lattice=(42, 3, 1), workspace_mm=(105.0, 7.5, 30.0))


@pytest.mark.parametrize("axes", [UP_Z_AXES, UP_Y_AXES, CAMERA_AXES])
@pytest.mark.parametrize("wall_m", [math.inf, 0.0066])
def test_pins_show_the_height_of_the_first_surface(axes: str, wall_m: float) -> None:
    law = profile_of(LawSpec(), wall_m)
    # margin of the lattice outside the terrain on both sides
    margin_m = 0.0 if math.isinf(wall_m) else wall_m
    mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03 + 2 * margin_m), Placement(), law)
    pin_forces = device_medium(terraces(axes), mapping)[0].to_dense()[:, 1, 0, 2]
    centres = [8 + 6 * n for n in range(5)]
    assert pin_forces[centres] / 3.3 == pytest.approx([(h - 0.001) / 0.03 for h in STEPS_M], abs=1 / 128)
    by_force = device_medium(terraces(axes), replace(mapping, spec=DeviceFilterSpec(pool="max")))[0]
    assert np.ptp(by_force.to_dense()[centres[1:], 1, 0, 2]) < 0.01, (
        "all that is deeper than 6.6 mm is alike by force"
    )


def plain(height_m: float, axes: str) -> Formula:
    """Solid terrain of constant height above the lattice's far end, 0 to 0.03 m."""
    sign = -1.0 if axes == CAMERA_AXES else 1.0

    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        is_solid = sign * points[..., 2] < height_m - 0.015
        return np.where(is_solid, 3.3, 0.0)[..., None] * np.array([0.0, 0.0, sign])

    return Formula(forces, axes)


@pytest.mark.parametrize("axes", [UP_Z_AXES, CAMERA_AXES])
@pytest.mark.parametrize("wall_m", [math.inf, 0.0066])
@pytest.mark.parametrize("is_stored", [False, True])
def test_pin_heights_are_unbiased(axes: str, wall_m: float, is_stored: bool) -> None:
    """Heights are quantised to a sample; over heights that sweep one sample, the errors must average out."""
    law, errors = profile_of(LawSpec(), wall_m), []
    margin_m = 0.0 if math.isinf(wall_m) else wall_m
    mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03 + 2 * margin_m), Placement(), law)
    step = 1 / 128  # as a fraction of the height range
    fine = Grid((210, 15, 90), (0.0005, 0.0005, 0.0005), (-0.05225, -0.0035, -0.02225))
    z = np.sort((-1.0 if axes == CAMERA_AXES else 1.0) * fine.axis_m(2))
    for n in range(16):
        height_m = 0.0121 + (n * 0.00083 if is_stored else n / 16 * 0.03 * step)
        scene = plain(height_m, axes)
        if is_stored:
            scene = Stored(HapticMedium.from_frames([scene.field(0, fine, law)], 30.0, axes))
            scene.axes = axes
            # interpolated linearly, it ends at the first zero sample
            height_m = z[np.searchsorted(z, height_m - 0.015)] + 0.015
        pin_force = device_medium(scene, mapping)[0].to_dense()[21, 1, 0, 2]
        errors.append(pin_force / 3.3 - height_m / 0.03)
    assert np.abs(errors).max() <= 0.6 * step and abs(np.mean(errors)) < 0.2 * step


def test_plateau_has_the_same_height_at_its_edge() -> None:
    def forces(points: NDArray[np.float64], profile: ForceProfile) -> NDArray[np.float64]:
        pin_position = points[..., 0] / PINS.pitch_mm * 1e3
        is_land = (pin_position < 6.2) & (points[..., 2] < np.where(pin_position < -12, 0.014, -0.005))
        return np.where(is_land, 3.3, 0.0)[..., None] * np.array([0.0, 0.0, 1.0])

    law = profile_of(LawSpec(), math.inf)
    mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03), Placement(), law)
    pin_forces = device_medium(Formula(forces, UP_Z_AXES), mapping)[0].to_dense()[:, 1, 0, 2]
    assert pin_forces[11:27] / 3.3 == pytest.approx(1 / 3, abs=1 / 64), "27 pins of the 42 are on land"
    assert pin_forces[27] < 0.5 * pin_forces[26] and not pin_forces[29:].any(), "beyond it nothing is lifted"


def test_pins_do_not_depend_on_the_stiffness() -> None:
    solid, pin_forces, sample_counts = ball(0.015), [], [0, 0]
    for n, wall_m in enumerate((0.0066, 0.00033)):
        law = profile_of(LawSpec(stiffness_n_per_m=3.3 / wall_m), wall_m)

        def forces(points: NDArray[np.float64], profile: ForceProfile, n: int = n) -> NDArray[np.float64]:
            sample_counts[n] += points.size
            return solid.forces(points, profile)

        mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03 + 2 * wall_m), Placement(), law)
        pin_forces.append(device_medium(Formula(forces, UP_Z_AXES), mapping)[0].to_dense()[..., 2])
    assert pin_forces[0].max() > 1
    assert np.abs(pin_forces[1] - pin_forces[0]).max() < 3.3 / 128
    assert sample_counts[1] <= sample_counts[0]


def test_pins_of_a_symbolic_scene_show_the_force() -> None:
    law, scene = profile_of(LawSpec(), math.inf), terraces()
    mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03), Placement(), law)
    relief = device_medium(scene, mapping)[0]
    scene.tags = ("symbolic",)
    by_force = device_medium(scene, replace(mapping, spec=DeviceFilterSpec(pool="max")))[0]
    assert device_medium(scene, mapping)[0] == by_force != relief


def test_pins_of_a_stored_field_and_of_an_image() -> None:
    law = profile_of(LawSpec(), math.inf)
    mapping = DeviceFilter(PINS, device_grid(PINS, depth_m=0.03), Placement(), law)
    fine = Grid((210, 15, 120), (0.0005, 0.0005, 0.00025), (-0.05225, -0.0035, -0.014875))
    for axes in (UP_Z_AXES, CAMERA_AXES):
        stored_terraces = Stored(HapticMedium.from_frames([terraces(axes).field(0, fine, law)], 30.0, axes))
        stored_terraces.axes = axes
        pin_forces = device_medium(stored_terraces, mapping)[0].to_dense()[..., 2]
        exact_forces_n = device_medium(terraces(axes), mapping)[0].to_dense()[..., 2]
        centres = [8 + 6 * n for n in range(5)]
        assert pin_forces[centres, 1] == pytest.approx(exact_forces_n[centres, 1], abs=3.3 / 120)
    image = ForceField.from_dense(
        mapping.grid, np.where(np.indices(mapping.grid.shape)[0] > 20, 2.0, 1.0)[..., None] * [0, 0, 1.0]
    )
    image_forces = device_medium(Stored(HapticMedium.from_frames([image], 30.0)), mapping)[0].to_dense()[
        ..., 2
    ]
    assert image_forces[[10, 30], 1, 0] == pytest.approx([1.0, 2.0], rel=0.05), (
        "an image for an array has no depth"
    )


def test_third_axis_is_pooled_for_any_axes() -> None:
    fields = []
    for axes in (UP_Y_AXES, UP_Z_AXES, CAMERA_AXES):
        scene = stripes(0.1 / PITCH_M)
        scene.axes = axes
        fields.append(on_array(scene, DeviceFilterSpec()))
    assert fields[0] == fields[1] == fields[2]


def test_arrays_clip_and_apply_the_floor() -> None:
    shirt = replace(SHIRT, force_max_n=1.5)
    amplitudes = on_array(stripes(0.1 / PITCH_M), DeviceFilterSpec(), shirt).vectors_n()[:, 2]
    assert amplitudes.max() <= 1.5 and amplitudes.min() >= 0.015


def test_a_deep_array_is_pooled_in_slabs(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = stripes(0.1 / PITCH_M)
    expected = on_array(scene, DeviceFilterSpec())
    monkeypatch.setattr("touchfield.filters.array_filter.MAX_SLAB_SAMPLES", 1 << 16)
    before = scene.call_count
    assert on_array(scene, DeviceFilterSpec()) == expected
    assert scene.call_count - before > 5


# -- the medium --------------------------------------------------------------------------------------------


class Stored(Formula):
    """A scene that contains a medium, as a stored field does."""

    def __init__(self, medium: HapticMedium) -> None:
        super().__init__(lambda p, f: medium[0].sample_n(p).astype(float))
        self.stored, self.frame_count, self.rate_hz = medium, medium.frame_count, medium.rate_hz


def stored() -> Stored:
    field = random_field(device_grid(OMNI, 4), 3)
    medium = HapticMedium.from_frames([field, field.scaled(0.5)], 25.0)
    return Stored(
        replace(medium, friction=0.3, tags=("symbolic",), provenance={"from": "afar", "device": "touch"})
    )


def test_medium_is_lazy_and_has_its_provenance() -> None:
    scene = ball(0.02)
    medium = device_medium(scene, DeviceFilter(OMNI, device_grid(OMNI, 4), Placement(), WALL))
    assert scene.call_count == 0
    assert medium[0] == mapped(scene, DeviceFilterSpec(), Placement())
    assert (medium.rate_hz, len(medium), medium.axes) == (scene.rate_hz, 1, UP_Y_AXES)
    assert medium.provenance["device"] == "phantom-omni"
    assert "spline" in medium.provenance["device_filter"] and "scale 1.0" in medium.provenance["placement"]


def test_stored_medium_on_the_same_lattice_is_unchanged() -> None:
    scene = stored()
    grid = scene.stored.grid
    assert device_medium(scene, DeviceFilter(OMNI, grid, Placement(), WALL)) is scene.stored
    hand = Placement(0.5)
    relabelled = device_medium(scene, DeviceFilter(OMNI, hand.to_hand(grid), hand, WALL))
    assert np.array_equal(relabelled[1].forces_n, scene.stored[1].forces_n)
    assert relabelled.friction == 0.3 and scene.call_count == 0
    wide = Grid.over_box(*grid.box_m, (8, 8, 8))
    low, high = wide.origin_m, wide.to_m((7, 7, 7))
    assert not wide.is_close(Grid((15, 15, 15), tuple((high - low) / 14), low))  # the same corners
    for offset_fraction, is_same in ((0.9e-6, True), (1.1e-6, False)):
        moved = tuple(o + offset_fraction * h for o, h in zip(grid.origin_m, grid.spacing_m))
        assert grid.is_close(Grid(grid.shape, grid.spacing_m, moved)) == is_same


def test_stored_medium_on_another_lattice_is_filtered_with_its_metadata() -> None:
    scene = stored()
    grid = device_grid(OMNI, 3)
    medium = device_medium(scene, DeviceFilter(OMNI, grid, Placement(), WALL))
    assert medium[0].grid == grid and scene.call_count == 1
    assert (medium.friction, medium.tags, len(medium)) == (0.3, ("symbolic",), 2)
    assert medium.provenance["from"] == "afar" and medium.provenance["device"] == "phantom-omni"


def test_provenance_has_the_numbers_of_the_mapping() -> None:
    spec = DeviceFilterSpec(
        oversample=3, force_floor_share=0.02, low_pass="box", pool="mean", cutoff="literal"
    )
    hand = Placement(0.5, (0.1, 0.2, 0.3))
    provenance = device_medium(
        ball(0.02), DeviceFilter(OMNI, device_grid(OMNI, 4), hand, WALL, spec)
    ).provenance
    assert dict(provenance) == {
        "device": "phantom-omni",
        "device_filter": "box, oversample 3, floor 0.02 of F_max",
        "placement": "scale 0.5, offset_m (0.1, 0.2, 0.3)",
    }
    vest = device("tshirt-32x32")
    provenance = device_medium(ball(0.02), DeviceFilter(vest, device_grid(vest), hand, WALL, spec)).provenance
    assert provenance["device_filter"] == "box, oversample 3, floor 0.02 of F_max, pool mean, cut-off literal"
    provenance = device_medium(ball(0.02), DeviceFilter(vest, device_grid(vest), hand, WALL)).provenance
    assert provenance["device_filter"].endswith("pool max, cut-off nyquist")  # the result of "auto"


def test_filtered_medium_has_all_metadata_of_its_source() -> None:
    scene = stored()
    source = replace(scene.stored, axes="x east, y north, z up", damping_n_s_per_m=2.5, rate_hz=17.0)
    scene.stored, scene.rate_hz = source, source.rate_hz
    medium = device_medium(scene, DeviceFilter(OMNI, device_grid(OMNI, 3), Placement(), WALL))
    assert medium.metadata == source.metadata
    assert medium.metadata == {
        "rate_hz": 17.0, "axes": "x east, y north, z up", "tags": ("symbolic",), "friction": 0.3,
        "damping_n_s_per_m": 2.5,
    }  # fmt: skip
    formula = ball(0.02)
    formula.axes, formula.tags, formula.rate_hz, formula.frame_count = UP_Z_AXES, ("symbolic",), 17.0, 3
    from_formula = device_medium(formula, DeviceFilter(OMNI, device_grid(OMNI, 3), Placement(), WALL))
    assert (from_formula.axes, from_formula.tags, from_formula.rate_hz, len(from_formula)) == (
        UP_Z_AXES,
        ("symbolic",),
        17.0,
        3,
    )


def test_exact_forces_are_those_of_the_placed_scene() -> None:
    """A ball, scaled by half and moved for the hand; the law uses metres of the hand."""
    hand, centre, stiffness = Placement(0.5, (0.1, -0.2, 0.3)), np.array([0.12, -0.21, 0.28]), 400.0
    scene = AnalyticScene([Sphere(tuple(centre.tolist()), 0.04)])
    law = profile_of(LawSpec(stiffness_n_per_m=stiffness, force_max_n=9.0), np.inf)
    points = 0.5 * (centre - hand.offset_m) + np.random.default_rng(2).normal(0, 0.01, (500, 3))
    offset_m = points - 0.5 * (centre - np.asarray(hand.offset_m))
    r = np.linalg.norm(offset_m, axis=1, keepdims=True)
    for limit_n in (9.0, 3.0):
        forces = exact_forces(scene, hand, law, limit_n)(points)
        expected = np.clip(stiffness * (0.02 - r), 0, limit_n) * offset_m / r
        np.testing.assert_allclose(forces, expected, atol=1e-9)
        assert np.isclose(np.linalg.norm(forces, axis=1), 3.0).any() == (limit_n == 3.0)


def test_options_of_the_filter_are_bounded_and_named() -> None:
    for spec in (
        {"oversample": 1},
        {"oversample": 8},
        {"force_floor_share": 0.0},
        {"force_floor_share": 0.999},
    ):
        assert DeviceFilterSpec(**spec)
    for wrong in (
        {"oversample": 0}, {"oversample": 9}, {"force_floor_share": 1.0}, {"force_floor_share": -0.01},
        {"low_pass": "lens"}, {"pool": "least"}, {"cutoff": "half"},
    ):  # fmt: skip
        with pytest.raises(InvalidArgument, match=next(iter(wrong))):
            DeviceFilterSpec(**wrong)
    pad, vest = device("dotpad"), device("tshirt-32x32")
    for profile, depth_m in ((pad, 0.5), (vest, 0.3)):
        grid = device_grid(profile, depth_m=depth_m)
        assert grid.shape == profile.lattice and grid.spacing_m[2] == pytest.approx(depth_m)
        np.testing.assert_allclose(np.mean(grid.box_m, axis=0), 0, atol=1e-12)

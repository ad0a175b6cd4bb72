"""One tick: the force of the field at the hand, mapping to the device, ramps, parameters."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st
from receiver_values import value_of
from tick_makers import OMNI, Bench, constant, linear, wall

from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render.block import Memory, layout
from touchfield.render.point_device import axes_matrix
from touchfield.render.spec import RenderSpec, write_parameters
from touchfield.sources.scene import CAMERA_AXES, UP_Z_AXES

FULL = np.array([[-60.0, 10, 5], [-3, -40, 8], [20, 2, -70]])


def test_a_hand_at_rest_gets_the_force_of_the_field() -> None:
    bench = Bench(wall(80.0))
    force = bench.settled(0.01, 0.02, -0.012)
    assert force == pytest.approx([0, 0, 0.96], abs=1e-6)
    assert bench.value("state.field_force_n") == pytest.approx(force)
    assert bench.value("state.position_m") == pytest.approx([0.01, 0.02, -0.012])
    assert not bench.value("state.velocity_m_s").any()
    assert bench.value("state.gain") == 1
    assert not bench.settled(0.0, 0.0, 0.02).any()
    assert not bench.settled(9e5, 0.0, -0.02).any()


# -- mapping -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "device_axes", ["x right, y away from the user, z up", "x towards the user, y right, z up"]
)
@pytest.mark.parametrize("field_axes", [CAMERA_AXES, UP_Z_AXES, "x right, y up, z forward"])
def test_axes_scale_clutch_and_gravity(device_axes: str, field_axes: str) -> None:
    spec = RenderSpec(scale=2.0, clutch_m=(0.01, -0.02, 0.005), force_scale=0.5, gravity_n=(0.1, 0.2, 0.3))
    bench = Bench(linear(FULL), spec, replace(OMNI, axes=device_axes), axes=field_axes)
    turn = axes_matrix(device_axes, field_axes, spec.up)
    for position in ([0.0, 0, 0], [0.003, 0.004, -0.006], [-0.005, 0.001, 0.002]):
        inside = np.array(spec.clutch_m) + 2.0 * turn @ position
        expected = 0.5 * turn.T @ (FULL @ inside) + spec.gravity_n
        assert bench.settled(*position) == pytest.approx(expected, abs=1e-6)
        assert bench.value("state.position_m") == pytest.approx(inside)


@given(
    st.floats(0.2, 5),
    st.floats(0.1, 3),
    st.sampled_from(["x right, y down, z forward", "x left, y up, z back"]),
)
def test_friction_and_damping_dissipate_in_any_axes(scale: float, force_scale: float, axes: str) -> None:
    spec = RenderSpec(scale=scale, force_scale=force_scale, friction=0.4, damping_n_s_per_m=1.0)
    bench = MAPPED
    bench.axes = axes
    bench.restart(spec)
    path = np.arange(60)[:, None] * np.array([1e-5, -2e-5, 3e-5])
    force = [f for _, f in bench.along(path)][-1]
    turn = axes_matrix(OMNI.axes, axes, "auto")
    field_force = force_scale * turn.T @ bench.value("state.field_force_n")
    assert (force - field_force) @ path[1] < 0


MAPPED = Bench(constant(0.0, 0.0, 0.5))


# -- ramps -------------------------------------------------------------------------------------------------


def test_the_force_rises_and_falls_within_the_ramp() -> None:
    spec = RenderSpec(gravity_n=(0.0, 0.5, 0.0))
    bench = Bench(constant(0.8, 0.0, 0.0), spec)
    rising = np.array([bench.tick(0, 0, 0) for _ in range(30)])
    assert rising[9] == pytest.approx([0.4, 0.25, 0])
    assert rising[19] == pytest.approx([0.8, 0.5, 0])
    away = np.array([bench.tick(0, 0, 0, is_there=False) for _ in range(30)])
    assert away[9] == pytest.approx([0.4, 0.25, 0])  # the full force, as before
    assert not away[20:].any()
    assert not bench.value("state.field_force_n").any()
    back = np.array([bench.tick(0, 0, 0) for _ in range(30)])
    assert back == pytest.approx(rising)


def test_a_stall_during_a_ramp_reverses_it() -> None:
    bench = Bench(constant(0.8, 0.0, 0.0))
    sizes = [bench.tick(0, 0, 0, is_there=n % 20 < 10)[0] for n in range(100)]
    assert max(sizes) == pytest.approx(0.4)
    assert np.abs(np.diff(sizes)).max() == pytest.approx(0.04)


@pytest.mark.parametrize("coordinate", [math.nan, math.inf, -math.inf, 1e7])
def test_an_invalid_position_is_treated_as_a_missing_frame(coordinate: float) -> None:
    bench = Bench(constant(0.8, 0.0, 0.0), damping=1.0)
    bench.settled(0, 0, 0)
    gone = np.array([bench.tick(0, coordinate, 0) for _ in range(25)])
    assert gone[9] == pytest.approx([0.4, 0, 0])
    assert not gone[20:].any()
    assert bench.settled(0, 0, 0) == pytest.approx([0.8, 0, 0])


def test_a_release_falls_linearly_and_stays_at_zero() -> None:
    bench = Bench(constant(0.8, -0.4, 0.0))
    bench.settled(0, 0, 0)
    forces = np.array([bench.release() for _ in range(40)])
    assert forces[9] == pytest.approx([0.4, -0.2, 0])
    assert forces[20:].tolist() == [[0, 0, 0]] * 20
    assert not np.signbit(forces[20:]).any()
    assert bench.settled(0, 0, 0) == pytest.approx([0.8, -0.4, 0])  # and up again


def test_a_release_respects_the_slew_limit() -> None:
    bench = Bench(constant(0.8, 0.0, 0.0), RenderSpec(slew_n_per_s=10.0))
    bench.settled(0, 0, 0, 100)
    sizes = [bench.release()[0] for _ in range(90)]
    assert 79 <= np.count_nonzero(sizes) <= 81
    assert sizes[-1] == 0


def test_a_tick_of_zero_duration_changes_nothing() -> None:
    bench = Bench(constant(0.8, 0.0, 0.0))
    force = bench.settled(0, 0, 0, 5)
    before = bench.value("state")
    for dt in (0.0, -0.001, math.nan, math.inf):
        assert (bench.tick(0.01, 0, 0, dt) == force).all()
        assert (bench.release(dt) == force).all()
    assert bench.value("state") == before


def test_the_same_ticks_give_the_same_forces() -> None:
    spec = RenderSpec(coupling_n_per_m=400.0, passivity=True, friction=0.3, damping_n_s_per_m=0.4)
    rng = np.random.default_rng(2)
    path = np.cumsum(rng.normal(0, 1e-4, (200, 3)), axis=0)
    bench = Bench(linear(FULL), spec)
    once = np.array([f for _, f in bench.along(path)])
    bench.restart(spec)
    assert (once == np.array([f for _, f in bench.along(path)])).all()


# -- parameters --------------------------------------------------------------------------------------------


def written(spec: RenderSpec, **device_changes: object) -> tuple[Memory, tuple[str, ...]]:
    """A block with parameters, and their notes."""
    memory = Memory.empty(layout.RECEIVER.itemsize)
    notes = write_parameters(memory, spec, replace(OMNI, **device_changes), 0.3, 0.7, "x right, y up, z back")
    return memory, notes


def coefficients(memory: Memory) -> tuple[float, float]:
    """Friction and damping in the settings."""
    settings = memory.receiver["settings"]
    return float(settings["friction"]), float(settings["damping_n_s_per_m"])


def test_limits_are_those_of_the_device_or_lower_requested_ones() -> None:
    memory, notes = written(RenderSpec())
    assert notes == ()
    assert value_of(memory, "settings.force_limits").tolist() == (4, 1, 800)
    assert coefficients(memory) == (0.3, 0.7)
    memory, _ = written(
        RenderSpec(peak_n=2.0, continuous_n=0.5, slew_n_per_s=50.0, friction=0.0, damping_n_s_per_m=0.1)
    )
    assert value_of(memory, "settings.force_limits").tolist() == (2, 0.5, 50)
    assert coefficients(memory) == (0, 0.1)
    for spec, changes in (
        (RenderSpec(), {"force_continuous_n": None}),
        (RenderSpec(peak_n=0.9), {}),  # the peak is below the continuous limit
    ):
        memory, _ = written(spec, **changes)
        assert value_of(memory, "settings.force_limits.continuous") == 0


@pytest.mark.parametrize(
    "spec",
    [
        RenderSpec(peak_n=4.1),
        RenderSpec(continuous_n=1.1),
        RenderSpec(peak_n=1e-9),
        RenderSpec(continuous_n=1e-9),
    ],
)
def test_limits_beyond_the_device_are_refused(spec: RenderSpec) -> None:
    with pytest.raises(InvalidArgument, match="phantom-omni"):
        written(spec)


def test_unsupported_devices_are_refused() -> None:
    with pytest.raises(DeviceError, match="type 2"):
        write_parameters(
            Memory.empty(layout.RECEIVER.itemsize), RenderSpec(), device("tactsuit-x40"), 0, 0, ""
        )
    for force in (0.0, math.nan, math.inf, 1e9):
        with pytest.raises(DeviceError, match="force_max_n"):
            written(RenderSpec(), force_max_n=force)
    for mu, b in ((-1.0, 0.0), (math.nan, 0.0), (0.0, math.inf)):
        with pytest.raises(InvalidArgument, match="of the medium"):
            write_parameters(Memory.empty(layout.RECEIVER.itemsize), RenderSpec(), OMNI, mu, b, "")


def test_a_weight_beyond_the_continuous_limit_is_noted() -> None:
    for weight, count in ((1.2, 1), (1.0, 1), (0.99, 0)):  # of the continuous limit of 1 N
        _, notes = written(RenderSpec(gravity_n=(0.0, weight, 0.0)))
        assert sum(f"{weight:g} N" in note for note in notes) == len(notes) == count


def test_a_block_without_parameters_gives_no_force() -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    assert native.tick(memory.bytes, 0, 0, 0.0, 0.01, 0.0, 0.0, 0.001) == (0, 0, 0)
    assert native.release(memory.bytes, 0.001) == (0, 0, 0)
    assert not memory.bytes.any()


def test_parameters_are_written_to_settings_state_grip_and_ramp_limit_only() -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    memory.array(np.int64, 0, memory.size_bytes // 8)[:] = 7
    write_parameters(memory, RenderSpec(), OMNI, 0, 0, "x right, y up, z back")
    for name in layout.RECEIVER.names:
        is_written = np.frombuffer(memory.receiver[name].tobytes(), np.int64) != 7
        if name == "layout":
            assert is_written.sum() == 1 and memory.receiver["layout"]["ramp_limit_ns"] != 7
        else:
            assert is_written.all() if name in ("settings", "state", "grip") else not is_written.any(), name

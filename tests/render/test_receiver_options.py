"""Options of a receiver are written where the ticks read them; notes of a session state the values in use."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from player_makers import laid_out
from receiver_values import differing, value_of
from tick_makers import GRID, OMNI, points, wall

from touchfield.devices import Device
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.block import Memory, layout, statistics_of
from touchfield.render.feeder import Feeder
from touchfield.render.material import Material, materials_json, read_materials
from touchfield.render.point_device import BOX_AXES, axes_matrix, axes_notes
from touchfield.render.spec import (
    RenderSpec,
    stability_of,
    stated_n_per_m,
    wall_of,
    write_delay,
    write_parameters,
)
from touchfield.render.tool import Tool

AXES = "x right, y up, z back"


def medium(stiffness_n_per_m: float = 300.0, frames: int = 1, axes: str = AXES) -> HapticMedium:
    forces = wall(stiffness_n_per_m, 9.0)(points()).astype(np.float32)
    return HapticMedium.from_frames([ForceField.from_dense(GRID, forces)] * frames, 20.0, axes)


# -- options
# ---------------------------------------------------------------------------------------------------------

OPTIONS = {
    "rate_hz": (2000.0, "settings.rate_hz", 2000.0),
    "friction": (0.21, "settings.friction", 0.21),
    "damping_n_s_per_m": (0.31, "settings.damping_n_s_per_m", 0.31),
    "coupling_n_per_m": (51.0, "settings.coupling_n_per_m", 51.0),
    "passivity": (True, "settings.is_passive", 1.0),
    "scale": (0.61, "settings.scale", 0.61),
    "force_scale": (0.71, "settings.force_scale", 0.71),
    "peak_n": (3.1, "settings.force_limits.peak", 3.1),
    "continuous_n": (0.81, "settings.force_limits.continuous", 0.81),
    "slew_n_per_s": (91.0, "settings.force_limits.slew_per_s", 91.0),
    "thermal_s": (1.1, "settings.thermal_s", 1.1),
    "ramp_s": (0.012, "settings.ramp_s", 0.012),
    "velocity_cutoff_hz": (13.0, "settings.velocity_cutoff_rad_s", 2 * math.pi * 13.0),
    "peak_nm": (0.14, "settings.torque_limits.peak", 0.14),
    "continuous_nm": (0.015, "settings.torque_limits.continuous", 0.015),
    "slew_nm_per_s": (1.6, "settings.torque_limits.slew_per_s", 1.6),
}
STICK = {"settings.stick_n_per_m", "settings.stick_n_s_per_m"}  # spring and damper of friction's anchor
TWISTING = replace(OMNI, torque_max_nm=0.2, torque_continuous_nm=0.05)


def empty() -> Memory:
    """A receiver of zeros."""
    return Memory.empty(layout.RECEIVER.itemsize)


def written(spec: RenderSpec) -> tuple[Memory, tuple[str, ...]]:
    memory = empty()
    return memory, write_parameters(memory, spec, TWISTING, 0.3, 0.7, AXES)


@pytest.mark.parametrize("name", OPTIONS)
def test_an_option_changes_only_its_setting(name: str) -> None:
    value, path, expected = OPTIONS[name]
    default, found = written(RenderSpec())[0], written(RenderSpec(**{name: value}))[0]
    assert value_of(found, path) == pytest.approx(expected)
    follow = {
        "friction": {"state.friction"},
        "peak_n": {
            "settings.force_limits.slew_per_s",
            "state.force.limit",
        },  # the slew limit reaches the peak in 5 ms
        "peak_nm": {"settings.torque_limits.slew_per_s", "state.torque.limit"},
        "rate_hz": {"settings.delay_ticks", *STICK},
        **dict.fromkeys(("scale", "force_scale", "velocity_cutoff_hz"), STICK),
        "damping_n_s_per_m": {"settings.stick_n_s_per_m"},
        **{key: {"layout.ramp_limit_ns"} for key in ("slew_n_per_s", "slew_nm_per_s", "ramp_s")},
    }.get(name, set())
    assert differing(default, found) - follow == {path}


def test_combined_options_equal_single_ones() -> None:
    spec = RenderSpec(
        **{name: value for name, (value, *_) in OPTIONS.items()},
        clutch_m=(0.1, -0.2, 0.3),
        gravity_n=(0.4, -0.5, 0.6),
    )
    memory, notes = written(spec)
    for name, (_, path, expected) in OPTIONS.items():
        assert value_of(memory, path) == pytest.approx(expected), name
    assert memory.receiver["settings"]["clutch_m"].tolist() == [0.1, -0.2, 0.3]
    assert memory.receiver["settings"]["gravity_n"].tolist() == [0.4, -0.5, 0.6]
    limits = [value_of(memory, f"state.{part}.limit") for part in ("force", "torque")]
    assert limits == [3.1, 0.14]
    weight = math.sqrt(0.4**2 + 0.5**2 + 0.6**2)
    assert notes == (
        f"the constant force of {weight:g} N leaves nothing of the limit of 0.81 N to the field",
    )


def test_spring_of_friction_is_that_of_a_fingertip_or_what_the_loop_renders_stably() -> None:
    """K is at most 1000 N/m of the device, and the damper 2 K (T/2 + d) - b, both in units of the field."""

    def stick_of(spec: RenderSpec, device: Device = TWISTING, damping: float = 0.0) -> tuple[float, float]:
        memory = empty()
        write_parameters(memory, spec, device, 0.3, damping, AXES)
        k, c = (float(memory.receiver["settings"][f"stick_n{unit}_per_m"]) for unit in ("", "_s"))
        return k, c

    slow = [stick_of(RenderSpec(), replace(OMNI, delay_ms=delay)) for delay in (0.0, 1.0, 2.0, 5.0, 20.0)]
    assert slow[0] == pytest.approx((1000.0, 1.0)) and slow[1] == pytest.approx((1000.0, 3.0))
    assert slow[2][0] == 1000.0 > slow[3][0] > slow[4][0] > 0
    for (k, c), delay_s in zip(slow, (0.0, 1e-3, 2e-3, 5e-3, 20e-3), strict=True):
        assert c == pytest.approx(2 * k * (0.0005 + delay_s))
    assert stick_of(RenderSpec(rate_hz=2000.0), replace(OMNI, delay_ms=1.0)) == pytest.approx((1000.0, 2.5))
    k, c = slow[3]
    delayed = replace(OMNI, delay_ms=5.0)
    scaled = stick_of(RenderSpec(scale=0.5, force_scale=3.0), delayed)
    assert scaled == pytest.approx((k / 1.5, c / 1.5))
    assert stick_of(RenderSpec(), delayed, damping=0.4 * c) == pytest.approx((k, 0.6 * c))
    assert stick_of(RenderSpec(damping_n_s_per_m=0.3 * c), delayed) == pytest.approx((k, 0.7 * c))
    assert stick_of(RenderSpec(damping_n_s_per_m=2 * c), delayed) == (pytest.approx(k), 0.0)
    stiffer, damper = stick_of(RenderSpec(), replace(delayed, damping_n_s_per_m=0.5))
    assert k < stiffer <= 1000 and damper == pytest.approx(2 * stiffer * 0.0055 - 0.5)
    memory = empty()
    write_parameters(memory, RenderSpec(), OMNI, 0.3, 0.0, AXES)
    write_delay(memory, RenderSpec(), delayed, 0.3, 0.0)  # while a servo ticks
    assert [value_of(memory, path) for path in sorted(STICK)] == pytest.approx([k, c])


def test_torque_limits_are_those_of_a_device_that_states_them() -> None:
    memory = written(RenderSpec())[0]
    limits = value_of(memory, "settings.torque_limits")
    assert (limits["peak"], limits["continuous"]) == (0.2, 0.05)
    assert value_of(memory, "state.torque.limit") == 0.2
    assert limits["slew_per_s"] == pytest.approx(0.2 / 0.005)
    for name, max_nm, message in (
        ("peak_nm", 0.2, "to 0.2 N m, the limit of"),
        ("continuous_nm", 0.05, "to 0.05 continuously, the limit of"),
    ):
        assert written(RenderSpec(**{name: max_nm}))
        with pytest.raises(InvalidArgument, match=f"{name}: found .*{message}"):
            written(RenderSpec(**{name: max_nm * 1.001}))
    for name in ("peak_nm", "continuous_nm", "slew_nm_per_s"):
        with pytest.raises(
            InvalidArgument, match=f"{name}: found a limit for phantom-omni; expected a device that states"
        ):
            write_parameters(empty(), RenderSpec(**{name: 0.01}), OMNI, 0, 0, AXES)
    silent = write_parameters(empty(), RenderSpec(tool=Tool.sphere(0.001, 10)), OMNI, 0, 0, AXES)
    assert silent == ("phantom-omni states no torque: only the tool's force is rendered",)


@pytest.mark.parametrize("name", [*OPTIONS, "wall_n_per_m"])
def test_an_option_that_is_not_positive_is_refused_by_name(name: str) -> None:
    if name == "passivity":
        return
    may_be_0 = name in ("friction", "damping_n_s_per_m", "coupling_n_per_m", "force_scale")
    for wrong in (-1.0, math.nan, math.inf, *(() if may_be_0 else (0.0,))):
        with pytest.raises(InvalidArgument, match=f"^{name}"):
            RenderSpec(**{name: wrong})
    if may_be_0:
        assert getattr(RenderSpec(**{name: 0.0}), name) == 0


def test_rates_and_vectors_out_of_range_are_refused() -> None:
    assert RenderSpec(rate_hz=10.0) and RenderSpec(rate_hz=20000.0)
    for rate_hz in (9.99, 20001.0):
        with pytest.raises(InvalidArgument, match="rate_hz"):
            RenderSpec(rate_hz=rate_hz)
    for name in ("clutch_m", "gravity_n"):
        for wrong in ((0.0, 1.0), (0.0, math.nan, 1.0), 3.0):
            with pytest.raises(InvalidArgument, match=f"{name}.*three finite numbers"):
                RenderSpec(**{name: wrong})


# -- notes
# ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("scale", [1.0, 3.0])
@pytest.mark.parametrize("stiffness", [0.0, 40.0, 900.0, 20_000.0])
def test_note_states_damping_and_coupling_in_units_of_the_device(scale: float, stiffness: float) -> None:
    device = replace(OMNI, damping_n_s_per_m=0.3, delay_ms=2.0)
    spec = RenderSpec(scale=scale, force_scale=0.5, rate_hz=500.0)
    found, factor = stability_of(device, spec, 0.1, stiffness), 0.5 * scale
    hold_s = 0.001 + 0.002
    of_device = factor * stiffness
    brake, coupling = factor * found.brake_n_s_per_m, factor * found.coupling_n_per_m
    rendered_n_per_m = 1 / (1 / of_device + 1 / coupling) if coupling else of_device
    start = (
        f"the medium's stiffest slope is {of_device:.0f} N/m, and the device alone can render "
        f"{0.3 / hold_s:.0f} N/m"
    )
    damped = f": damping in contact {brake:.2g} N s/m"
    coupled = (
        f", coupling {coupling:.0f} N/m, so that {rendered_n_per_m:.0f} N/m are rendered"
        if coupling
        else ", no coupling"
    )
    assert found.note == start + damped + coupled
    assert brake == pytest.approx(max(0.0, 2 * rendered_n_per_m * hold_s - 0.3 - factor * 0.1))
    damped_result = stability_of(device, replace(spec, damping_n_s_per_m=0.2), 0.1, stiffness)
    assert damped_result.note == start + coupled and damped_result.brake_n_s_per_m == 0
    coupled_result = stability_of(device, replace(spec, coupling_n_per_m=70.0), 0.1, stiffness)
    assert coupled_result.note.startswith(start + ": damping") and "coupling" not in coupled_result.note
    assert coupled_result.coupling_n_per_m == pytest.approx(70.0)


def stiffness_of(memory: Memory) -> float:
    return float(memory.receiver["settings"]["wall_n_per_m"])


def test_auto_states_why_it_has_no_proxy() -> None:
    def note_of(spec: RenderSpec, source: HapticMedium) -> str:
        player, memory = laid_out(source, spec)
        assert stiffness_of(memory) == 0
        return next((note for note in player.notes if note.startswith("no proxy")), "")

    grid = medium().grid
    pull = ForceField.from_dense(grid, np.tile(np.float32([0, 0, 1]), (*grid.shape, 1)))
    constant = HapticMedium.from_frames([pull], 20.0, AXES)
    assert "not those of walls" in note_of(RenderSpec(), constant)
    assert "coupling" in note_of(RenderSpec(coupling_n_per_m=300.0), medium())
    assert "tool" in note_of(RenderSpec(tool=Tool.sphere(0.004)), medium())
    assert note_of(RenderSpec(render="field"), constant) == ""  # requested


def test_note_states_the_wall_of_the_proxy_as_rendered() -> None:
    grid = Grid((33, 31, 65), (0.004, 0.006, 0.0025), (-0.064, -0.09, -0.08))
    for max_n, level_n in ((9.0, 0.05), (0.2, 0.02)):  # a tenth of a weak force
        field = ForceField.from_dense(grid, wall(30.0, max_n)(points(grid)).astype(np.float32))
        _, memory = laid_out(HapticMedium.from_frames([field], 20.0, AXES))
        settings = memory.receiver["settings"]
        assert settings["wall_n_per_m"] == pytest.approx(30, rel=0.01)
        assert settings["wall_level_n"] == pytest.approx(level_n)
        assert settings["wall_spacing_m"].tolist() == list(grid.spacing_m)
    usual, memory = laid_out(medium())
    found = wall_of(medium()[0])
    assert found is not None and stiffness_of(memory) == pytest.approx(found.stiffness_n_per_m)
    assert f"a proxy holds the hand at walls of {found.stiffness_n_per_m:.0f} N/m" in usual.notes
    softer, memory = laid_out(medium(), RenderSpec(wall_n_per_m=123.0))
    assert stiffness_of(memory) == 123 and "a proxy holds the hand at walls of 123 N/m" in softer.notes
    assert not any(note.startswith("no proxy") for note in usual.notes)
    plain, memory = laid_out(medium(), RenderSpec(render="field"))
    assert stiffness_of(memory) == 0 and not any("proxy" in note for note in plain.notes)


def test_note_quotes_assumed_axes() -> None:
    assert axes_notes("x left, y", AXES) == (
        f'axes of the device, "x left, y", cannot be read and are taken as {BOX_AXES}',
    )
    assert axes_notes(AXES, "x left, y") == (f'axes of the field, "x left, y", are placed along {BOX_AXES}',)
    assert axes_notes("p" * 99, "q" * 99) == (
        f'axes of the device, "{"p" * 80}", cannot be read and are taken as {BOX_AXES}',
        f'axes of the field, "{"q" * 80}", are placed along {BOX_AXES}',
    )
    session, memory = laid_out(medium(axes="x, y, z"))
    assert f'axes of the field, "x, y, z", are placed along {BOX_AXES}' in session.notes
    spec = RenderSpec(up="z")
    session, memory = laid_out(medium(axes="x, y, z"), spec)
    expected = axes_matrix(OMNI.axes, "x, y, z", "z")
    assert np.array_equal(memory.receiver["settings"]["axes"].reshape(3, 3), expected)
    assert not np.array_equal(expected, axes_matrix(OMNI.axes, "x, y, z", "auto"))
    assert not any("axes of the field" in note for note in session.notes)


def test_note_of_a_slow_feed_states_both_rates() -> None:
    session, memory = laid_out(medium(frames=4))
    feeder: Feeder = session.feeder(memory)
    memory.receiver["clock"]["speed"] = 1.0
    feeder._pace.frame_s = 0.08
    assert "This machine decodes 12.5 frames a second, and speed 1 needs 20:" in feeder.note
    feeder._pace.frame_s = 0.04  # 25 a second: enough at this speed, but not at twice the speed
    assert "had to be fetched" in feeder.note
    memory.receiver["clock"]["speed"] = 2.0
    assert "This machine decodes 25 frames a second, and speed 2 needs 40:" in feeder.note


@pytest.mark.parametrize(
    ("spec", "is_accepted"),
    [
        ({"law": "penalty", "stiffness_n_per_m": 1.0}, True),
        ({"law": "penalty", "stiffness_n_per_m": 5000.0}, True),
        ({"law": "penalty", "stiffness_n_per_m": 0.999}, False),
        ({"law": "penalty", "stiffness_n_per_m": 5001.0}, False),
        ({"law": "magnetic", "stiffness_n_per_m": 500.0}, False),
        ({"law": "penalty"}, False),
    ],
)
def test_a_stated_stiffness_is_accepted_within_bounds(spec: dict[str, object], is_accepted: bool) -> None:
    text = json.dumps(spec)
    assert stated_n_per_m({"spec": text}) == (spec["stiffness_n_per_m"] if is_accepted else None)
    assert stated_n_per_m({"spec": text, "edits": "gain 2"}) is None
    other = json.dumps({"law": "penalty", "stiffness_n_per_m": 77.0})
    assert stated_n_per_m({"spec": text, "source.spec": other}) == 77


# -- materials
# ------------------------------------------------------------------------------------------------------


def test_every_value_of_a_material_round_trips(tmp_path: Path) -> None:
    levels = tuple(
        tuple(tuple(0.01 * (s + 2 * f + 3 * b) for b in range(16)) for f in range(3)) for s in range(2)
    )
    material = Material(
        "a",
        0.31,
        0.41,
        0.0021,
        "body",
        ((0.1, 0.2, 0.3), (0.4, 0.5, 0.6)),
        (0.05, 0.1),
        (0.5, 1.0, 2.0),
        levels,
    )
    plain = Material("b")
    (tmp_path / "t.json").write_text(materials_json((material, plain)))
    found, other = read_materials(tmp_path / "t.json")
    np.testing.assert_allclose(found.levels_n, material.levels_n, rtol=1e-3)
    assert replace(found, texture_rms_n=material.texture_rms_n) == material and other == plain


def test_invalid_materials_are_refused_by_name() -> None:
    row = ((0.0,) * 16,)
    good = {"speeds_m_s": (0.1,), "forces_n": (1.0,), "texture_rms_n": (row,)}
    assert Material("a", 0.0, 0.0) and Material("a", **good) and Material("a", slip_length_m=1e-6)
    for name, wrong in (
        ("friction", {"friction": -0.1}),
        ("friction", {"friction": math.inf}),
        ("static_friction", {"friction": 0.4, "static_friction": 0.39}),
        ("static_friction", {"static_friction": 0.5}),
        ("slip_length_m", {"slip_length_m": 9e-7}),
        ("box_m", {"box_m": ((0.0, 0.0, 1.0), (1.0, 1.0, 0.9))}),
        ("box_m", {"box_m": ((0.0, 0.0), (1.0, 1.0))}),
        ("speeds_m_s", good | {"speeds_m_s": (0.0,)}),
        ("forces_n", good | {"forces_n": (1.0, 1.0), "texture_rms_n": (row * 2,)}),
        ("forces_n", good | {"forces_n": (-math.inf, -math.inf), "texture_rms_n": (row * 2,)}),
        ("texture_rms_n", good | {"texture_rms_n": ((row[0][:15],),)}),
        ("texture_rms_n", good | {"texture_rms_n": (((-0.1, *row[0][1:]),),)}),
        ("texture_rms_n", {"speeds_m_s": (0.1,), "forces_n": (1.0,)}),
    ):
        with pytest.raises(InvalidArgument, match=f"material 'a' {name}"):
            Material("a", **wrong)  # type: ignore[arg-type]


# -- statistics
# -----------------------------------------------------------------------------------------------------


def test_every_statistic_has_its_counter() -> None:
    memory = empty()
    counts = {
        "late": 11,
        "missed": 12,
        "underruns": 13,
        "stalled_ticks": 14,
        "waits": 15,
        "waiting_ticks": 16,
        "frames_used": 17,
        "ticks": 501,
        "played_ticks": 56,
        "first_ns": 2_000_000_000,
        "last_ns": 2_250_000_000,
        "worst_period_ns": 9_000_000,
        "worst_lateness_ns": 20_500,
    }
    for name, value in counts.items():
        memory.receiver["counts"][name] = value
    memory.receiver["settings"]["rate_hz"] = 2000.0
    memory.receiver["counts"]["periods"][[0, 5, 40, layout.TIME_BINS]] = [600, 389, 10, 1]
    memory.receiver["counts"]["latenesses"][[3, 20]] = [400, 600]
    assert statistics_of(memory) == {
        "ticks": 501,
        "seconds": pytest.approx(0.25),
        "rate_hz": 2000.0,
        "mean_rate_hz": pytest.approx(2000.0),
        "late_ticks": 11,
        "missed_ticks": 12,
        "underruns": 13,
        "stalled_ticks": 14,
        "waits": 15,
        "waiting_ticks": 16,
        "frames_used": 17,
        "stalled_share": 0.25,
        "jitter_p50_us": 1.0,
        "jitter_p99_us": 41.0,
        "jitter_p99_9_us": 41.0,
        "jitter_worst_us": 9000.0,
        "lateness_p50_us": 20.5,
        "lateness_p99_us": 20.5,
        "lateness_p99_9_us": 20.5,
        "lateness_worst_us": 20.5,
    }
    memory.receiver["counts"]["periods"][layout.TIME_BINS] = 2  # the open bin reports the maximum
    memory.receiver["counts"]["periods"][40] = 9
    assert statistics_of(memory)["jitter_p99_9_us"] == 9000.0
    nothing = statistics_of(empty())
    assert not any(nothing.values()) and nothing.keys() == statistics_of(memory).keys()

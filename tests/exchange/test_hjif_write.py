"""Written HJIF is valid under the published schemas, and within the limits of the reference decoder."""

from __future__ import annotations

import json
import math
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import RATES_HZ, effects, read_force, schema_errors
from touchfield.errors import InvalidArgument, SourceError
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.hjif_write import AMPLITUDE_STEP, MAX_SPAN_TICKS, write_hjif_array, write_hjif_force
from touchfield.exchange.symbolic import DEFAULT_CARRIER_HZ, ArrayEffect


@st.composite
def traces(draw: st.DrawFn) -> tuple[np.ndarray, int]:
    """Forces, one per tick, and ticks per second."""
    count = draw(st.integers(1, 40))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    max_n = draw(st.sampled_from((0.5, 1.0, 3.3, 10.0, 37.5)))
    forces = rng.uniform(-1, 1, (count, 3)) * max_n * draw(st.sampled_from((0, 0.1, 1)))
    return forces, draw(st.sampled_from((1, 2, 100, 1000, 5000, 48000)))


def load(path: Path) -> dict[str, Any]:
    loaded: dict[str, Any] = json.loads(path.read_text())
    return loaded


def bands_of(document: dict[str, Any]) -> list[dict[str, Any]]:
    return [
        band
        for perception in document["perceptions"]
        for channel in perception["channels"]
        for band in channel["bands"]
    ]


def check_reference_rules(document: dict[str, Any]) -> None:
    """Requirements of the public reference decoder in addition to the schemas."""
    assert document["version"] == "2023" and document["profile"] == "Main" and document["syncs"] == []
    assert type(document["timescale"]) is int and 1 <= document["timescale"] <= 48000
    for perception in document["perceptions"]:
        count = len(perception["channels"])
        assert document["level"] == (1 if count < 128 else 2) and count <= 65535
        assert perception["perception_modality"] != "Humidity" and "effect_semantic_scheme" not in perception
        assert [channel["id"] for channel in perception["channels"]] == list(range(count))
        for channel in perception["channels"]:
            assert type(channel["body_part_mask"]) is int
            for band in channel["bands"]:
                check_band(band, channel["gain"])


def check_band(band: dict[str, Any], gain: float) -> None:
    low, high = band["lower_frequency_limit"], band["upper_frequency_limit"]
    assert type(low) is int and type(high) is int and 0 <= low < high <= 10000
    assert ("curve_type" in band) == (band["band_type"] == "Curve")
    end = None
    for effect in band["effects"]:
        keyframes = effect["keyframes"]
        ticks = [keyframe["relative_position"] for keyframe in keyframes]
        assert effect["effect_type"] == "Basis" and type(effect["position"]) is int
        assert all(type(tick) is int for tick in ticks) and ticks[0] == 0 and ticks == sorted(set(ticks))
        assert ticks[-1] <= MAX_SPAN_TICKS
        assert all(abs(keyframe["amplitude_modulation"]) <= 1 for keyframe in keyframes) and gain >= 0
        assert end in (None, effect["position"])
        end = effect["position"] + ticks[-1]
        if band["band_type"] == "Curve":
            assert len(keyframes) >= 3 and effect["position"] == 0 and len(band["effects"]) == 1
        else:
            assert all(low <= keyframe["frequency_modulation"] <= high for keyframe in keyframes)
            assert all(type(keyframe["frequency_modulation"]) is int for keyframe in keyframes)


# -- arrays ------------------------------------------------------------------------------------------------


@given(effect=effects())
def test_array_round_trip_is_within_a_step(
    tmp_path_factory: pytest.TempPathFactory, effect: ArrayEffect
) -> None:
    path = tmp_path_factory.mktemp("hjif") / "a.hjif"
    write_hjif_array(path, effect)
    check_reference_rules(load(path))
    restored = read_hjif_array(path, effect.rate_hz).effect
    assert restored.rate_hz == effect.rate_hz and restored.lattice == effect.lattice
    frames = max(len(effect), 2)  # a single frame lasts for one frame time
    assert len(restored) == frames
    expected = effect.drives if len(effect) > 1 else np.repeat(effect.drives, 2, axis=0)
    # a frame between two ticks is stored at the nearer one: half a tick of the steepest line, in frames
    slip = 0.5 * effect.rate_hz / 1000 if 1000 % effect.rate_hz else 0.0
    steepest = np.abs(np.diff(expected.astype(np.float64), axis=0)).max() * slip * 2
    assert np.abs(restored.drives - expected).max() <= AMPLITUDE_STEP * 1.01 + steepest
    if effect.frequencies_hz is not None and effect.drives.any():
        expected_hz = (
            effect.frequencies_hz if len(effect) > 1 else np.repeat(effect.frequencies_hz, 2, axis=0)
        )
        assert restored.frequencies_hz is not None
        has_frequency = (expected_hz > 0) & (restored.drives > 0)
        if not slip:
            assert np.abs(restored.frequencies_hz - expected_hz)[has_frequency].max(initial=0) <= 1.01
    elif effect.drives.any():
        assert restored.frequencies_hz is not None
        assert set(restored.frequencies_hz[restored.drives > 0].tolist()) <= {DEFAULT_CARRIER_HZ}


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_effects_over_65535_ticks_are_split(tmp_path: Path, rate_hz: float) -> None:
    count = int(200 * rate_hz)
    wave = (0.5 + 0.5 * np.sin(np.arange(count) / 7)).astype(np.float32)
    hertz = np.full((count, 1, 1), 120.25, np.float32)
    write_hjif_array(tmp_path / "a.hjif", ArrayEffect(rate_hz, wave.reshape(-1, 1, 1), hertz))
    document = load(tmp_path / "a.hjif")
    check_reference_rules(document)
    effects_written = bands_of(document)[0]["effects"]
    assert len(effects_written) > 2
    for before, after in zip(effects_written, effects_written[1:]):
        last, first = before["keyframes"][-1], after["keyframes"][0]
        assert last["amplitude_modulation"] == first["amplitude_modulation"]
        cycles = last["relative_position"] / 1000 * 120
        phase = (after["phase"] - before["phase"] - 2 * math.pi * cycles) % (2 * math.pi)
        assert min(phase, 2 * math.pi - phase) < 1e-4
    restored = read_hjif_array(tmp_path / "a.hjif", rate_hz).effect
    slip = 0 if 1000 % rate_hz == 0 else rate_hz / 1000 / 7
    assert (
        len(restored) == count
        and np.abs(restored.drives[:, 0, 0] - wave).max() <= AMPLITUDE_STEP * 1.01 + slip
    )


def test_straight_lines_have_keyframes_at_their_ends_only(tmp_path: Path) -> None:
    ramp = np.concatenate([np.linspace(0, 1, 101), np.ones(50), np.zeros(50)]).astype(np.float32)
    write_hjif_array(tmp_path / "a.hjif", ArrayEffect(100.0, ramp.reshape(-1, 1, 1)))
    keyframes = bands_of(load(tmp_path / "a.hjif"))[0]["effects"][0]["keyframes"]
    assert [keyframe["relative_position"] for keyframe in keyframes] == [0, 1000, 1500, 1510, 2000]


def test_rows_and_columns_of_an_array(tmp_path: Path) -> None:
    drives = np.zeros((2, 5, 4), np.float32)
    drives[:, 0, 3] = 1  # top right
    write_hjif_array(tmp_path / "a.hjif", ArrayEffect(50.0, drives), "tactsuit-x40", panel="back")
    document = load(tmp_path / "a.hjif")
    channels = document["perceptions"][0]["channels"]
    loud = [
        entry for entry in channels if entry["bands"][0]["effects"][0]["keyframes"][0]["amplitude_modulation"]
    ]
    assert [entry["id"] for entry in loud] == [3] and loud[0]["actuator_target"] == [{"X": 3, "Y": 4, "Z": 0}]
    assert loud[0]["body_part_target"] == ["Chest", "Back"] and loud[0]["body_part_mask"] == 0x300
    assert document["level"] == 1
    assert abs(datetime.now(UTC) - datetime.fromisoformat(document["date"])) < timedelta(minutes=10)
    restored = read_hjif_array(tmp_path / "a.hjif", 50.0)
    assert restored.device_name == "tactsuit-x40" and np.array_equal(restored.effect.drives, drives)


def test_invalid_options_of_an_array_are_refused(tmp_path: Path) -> None:
    effect = ArrayEffect(100.0, np.zeros((2, 1, 1), np.float32))
    with pytest.raises(InvalidArgument, match="panel"):
        write_hjif_array(tmp_path / "a.hjif", effect, panel="left")
    for rate_hz in (0.01, 1001.0):
        with pytest.raises(InvalidArgument, match="ticks to a frame"):
            write_hjif_array(tmp_path / "a.hjif", ArrayEffect(rate_hz, effect.drives))
    with pytest.raises(InvalidArgument, match="127 columns"):
        write_hjif_array(tmp_path / "a.hjif", ArrayEffect(100.0, np.zeros((2, 1, 128), np.float32)))
    assert list(tmp_path.iterdir()) == []


# -- forces ------------------------------------------------------------------------------------------------


@given(trace=traces())
def test_trace_round_trip_is_within_a_step(
    tmp_path_factory: pytest.TempPathFactory, trace: tuple[np.ndarray, int]
) -> None:
    forces, timescale = trace
    path = tmp_path_factory.mktemp("hjif") / "f.hjif"
    write_hjif_force(path, forces, timescale)
    document = load(path)
    check_reference_rules(document)
    perception = document["perceptions"][0]
    assert perception["perception_unit_exponent"] == 0 and document["timescale"] == timescale
    greatest = np.abs(forces).max(axis=0)
    assert [channel["gain"] for channel in perception["channels"]] == pytest.approx(greatest)
    back_s, back_n = read_force(path)
    times_s = np.arange(len(forces)) / timescale
    found = np.stack([np.interp(times_s, back_s, back_n[:, axis]) for axis in range(3)], axis=1)
    assert np.abs(found - forces).max() <= greatest.max() * AMPLITUDE_STEP * 1.01


def test_small_forces_survive_eight_bit_quantisation(tmp_path: Path) -> None:
    forces = np.stack(
        [0.02 * np.sin(np.arange(200) / 9), np.zeros(200), 2 * np.cos(np.arange(200) / 30)], axis=1
    )
    write_hjif_force(tmp_path / "f.hjif", forces, 100)
    channels = load(tmp_path / "f.hjif")["perceptions"][0]["channels"]
    for axis, channel in enumerate(channels):
        keyframes = channel["bands"][0]["effects"][0]["keyframes"]
        amplitudes = np.array([frame["amplitude_modulation"] for frame in keyframes])
        steps = np.floor((amplitudes + 1) / 2 * 255)  # as the reference encoder does
        error_n = np.abs(steps / 255 * 2 - 1 - amplitudes).max() * channel["gain"]
        assert error_n <= 2 / 255 * np.abs(forces[:, axis]).max()  # 0 N where there is no force


def test_full_scale_prevents_clipping(tmp_path: Path) -> None:
    forces = np.outer(np.linspace(-3, 3, 50), [1, 0.5, 0])
    write_hjif_force(tmp_path / "f.hjif", forces, 100, full_scale_n=3.0)
    perception = load(tmp_path / "f.hjif")["perceptions"][0]
    unit = 10 ** perception["perception_unit_exponent"]
    assert (
        max(channel["gain"] for channel in perception["channels"]) * unit <= 1
        and "3 N" in perception["description"]
    )
    with pytest.raises(InvalidArgument, match="full_scale_n"):
        write_hjif_force(tmp_path / "f.hjif", forces, 100, full_scale_n=0.0)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_a_curve_never_has_two_keyframes(tmp_path: Path, count: int) -> None:
    for ticks in (1, 1000):
        forces = np.repeat(np.linspace(-1, 1, count), ticks)[:, None] * np.ones(3)
        write_hjif_force(tmp_path / "f.hjif", forces, 1000)
        check_reference_rules(load(tmp_path / "f.hjif"))
    straight = np.linspace(-1, 1, 1000 * count)[:, None] * np.ones(3)
    write_hjif_force(tmp_path / "f.hjif", straight, 1000)
    check_reference_rules(load(tmp_path / "f.hjif"))


def test_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises((SourceError, InvalidArgument)):
        write_hjif_force(tmp_path / "none" / "f.hjif", np.zeros((2, 3)), 1000)
    assert list(tmp_path.iterdir()) == []


# -- the published schemas ---------------------------------------------------------------------------------


@pytest.mark.shared
@given(effect=effects(), trace=traces())
def test_files_are_valid_against_the_schemas(
    tmp_path_factory: pytest.TempPathFactory,
    shared_data: Path,
    effect: ArrayEffect,
    trace: tuple[np.ndarray, int],
) -> None:
    folder, out = shared_data / "hjif_schemas", tmp_path_factory.mktemp("hjif")
    write_hjif_array(out / "a.hjif", effect, "tactsuit-x40")
    write_hjif_force(out / "f.hjif", *trace, device_name="phantom-omni")
    assert schema_errors(load(out / "a.hjif"), folder) == []
    assert schema_errors(load(out / "f.hjif"), folder) == []


@pytest.mark.shared
def test_array_of_1024_actuators_is_level_2_and_valid(tmp_path: Path, shared_data: Path) -> None:
    drives = np.random.default_rng(0).random((3, 32, 32)).astype(np.float32)
    write_hjif_array(tmp_path / "a.hjif", ArrayEffect(25.0, drives), "tshirt-32x32")
    document = load(tmp_path / "a.hjif")
    assert document["level"] == 2 and schema_errors(document, shared_data / "hjif_schemas") == []
    check_reference_rules(document)


@pytest.mark.shared
def test_schemas_refuse_invalid_documents(tmp_path: Path, shared_data: Path) -> None:
    write_hjif_force(tmp_path / "f.hjif", np.zeros((1, 3)), 1000)
    document = load(tmp_path / "f.hjif")
    document["perceptions"][0]["channels"][0]["bands"][0]["effects"][0]["keyframes"][0][
        "relative_position"
    ] = 0.5
    assert len(schema_errors(document, shared_data / "hjif_schemas")) == 1


# -- arrays whose force and vibration differ ----------------------------------------------------------------


@given(effect=effects(), seed=st.integers(0, 2**32 - 1), force_max_n=st.sampled_from([0.01, 1.0, 3.3, 40.0]))
def test_force_and_vibration_return_apart(
    tmp_path_factory: pytest.TempPathFactory, effect: ArrayEffect, seed: int, force_max_n: float
) -> None:
    rng = np.random.default_rng(seed)
    forces = (rng.random(effect.drives.shape) * (rng.random(effect.drives.shape) < 0.7)).astype(np.float32)
    forces[0, 0, 0] = 0.5
    both = ArrayEffect.from_parts(effect.rate_hz, forces, effect.drives, effect.frequencies_hz)
    path = tmp_path_factory.mktemp("parts") / "a.hjif"
    write_hjif_array(path, both, force_max_n=force_max_n)
    check_reference_rules(load(path))
    imported = read_hjif_array(path, effect.rate_hz)
    assert imported.force_max_n == pytest.approx(force_max_n) and imported.effect.parts is not None
    on_ticks = np.isclose(
        1000 * np.arange(len(effect)) / effect.rate_hz % 1, 0
    )  # others are between two ticks
    for found, part in zip(imported.effect.parts, (forces, effect.drives)):
        assert found[: len(part)][on_ticks] == pytest.approx(part[on_ticks], abs=1.01 * AMPLITUDE_STEP)
    known = effect.drives[on_ticks] > 1.1 * AMPLITUDE_STEP
    if effect.frequencies_hz is not None and known.any():
        assert imported.effect.frequencies_hz is not None
        found_hz = imported.effect.frequencies_hz[: len(effect)][on_ticks][known]
        stated = effect.frequencies_hz[on_ticks][known]
        assert found_hz[stated > 0] == pytest.approx(np.maximum(stated[stated > 0], 1), abs=1.01)


def test_parts_that_last_longer_than_a_curve_are_refused(tmp_path: Path) -> None:
    forces = np.random.default_rng(3).random((67, 1, 2)).astype(np.float32)
    effect = ArrayEffect.from_parts(1.0, forces, np.float32(0.5) * forces[::-1], None)
    with pytest.raises(InvalidArgument, match=r"66 s; expected at most 65\.535 s"):
        write_hjif_array(tmp_path / "a.hjif", effect)
    fits = ArrayEffect.from_parts(1.0, forces[:66], forces[:66] * 0, None)
    write_hjif_array(tmp_path / "a.hjif", fits, force_max_n=2.0)
    check_reference_rules(load(tmp_path / "a.hjif"))


@pytest.mark.shared
def test_two_perceptions_are_valid(tmp_path: Path, shared_data: Path) -> None:
    drives = np.random.default_rng(5).random((4, 5, 4)).astype(np.float32)
    effect = ArrayEffect.from_parts(20.0, drives, drives * np.float32(0.1), np.full_like(drives, 200))
    write_hjif_array(tmp_path / "a.hjif", effect, "tactsuit-x40", force_max_n=3.3)
    assert schema_errors(load(tmp_path / "a.hjif"), shared_data / "hjif_schemas") == []


def test_parts_that_do_not_make_the_drives_are_refused() -> None:
    half = np.full((2, 1, 1), 0.5, np.float32)
    for parts in ((half, half * 2), (half * 0, half * 0), (half[:1], half), (half, half.astype(float))):
        with pytest.raises(InvalidArgument, match="parts"):
            ArrayEffect(1.0, half, None, parts)  # type: ignore[arg-type]

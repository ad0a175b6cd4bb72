"""Clips of Meta and patterns of Apple follow the published rules of their formats."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given

from effect_makers import effects
from touchfield.exchange.ahap import read_ahap
from touchfield.exchange.effect_files import write_ahap, write_haptic
from touchfield.exchange.symbolic import ArrayEffect


def load(path: Path) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
    return found


def check_clip(document: dict[str, Any]) -> list[dict[str, Any]]:
    """Check the validation rules of data model 1.0.0; return the amplitude points."""
    assert document["version"] == {"major": 1, "minor": 0, "patch": 0}
    assert set(document["metadata"]) == {"editor", "author", "source", "project", "tags", "description"}
    envelopes = document["signals"]["continuous"]["envelopes"]
    assert envelopes["amplitude"]
    for name, points in envelopes.items():
        times = [point["time"] for point in points]
        assert times == sorted(set(times)) and times[0] == 0
        assert all(0 <= point[name] <= 1 for point in points)
    for point in envelopes["amplitude"]:
        if "emphasis" in point:
            assert point["amplitude"] <= point["emphasis"]["amplitude"] <= 1
            assert 0 <= point["emphasis"]["frequency"] <= 1
    return list(envelopes["amplitude"])


@given(effect=effects())
def test_any_effect_follows_the_rules(tmp_path_factory: pytest.TempPathFactory, effect: ArrayEffect) -> None:
    folder = tmp_path_factory.mktemp("clip")
    write_haptic(folder / "a.haptic", effect, "name", "what it is")
    check_clip(load(folder / "a.haptic"))
    write_ahap(folder / "a.ahap", effect)
    for entry in load(folder / "a.ahap")["Pattern"]:
        if "ParameterCurve" in entry:
            assert 1 <= len(entry["ParameterCurve"]["ParameterCurveControlPoints"]) <= 16
        elif entry["Event"]["EventType"] == "HapticContinuous":
            assert 0 < entry["Event"]["EventDuration"] <= 30


def track(drives: np.ndarray, hertz: float = 182.5, rate_hz: float = 100.0) -> ArrayEffect:
    array = drives.reshape(-1, 1, 1).astype(np.float32)
    return ArrayEffect(rate_hz, array, np.where(array > 0, np.float32(hertz), np.float32(0)))


def test_envelope_round_trip_through_a_clip(tmp_path: Path) -> None:
    drives = 0.5 + 0.5 * np.sin(np.arange(300) / 20)
    assert write_haptic(tmp_path / "a.haptic", track(drives)) == ()
    points = check_clip(load(tmp_path / "a.haptic"))
    times, amplitudes = [p["time"] for p in points], [p["amplitude"] for p in points]
    assert np.interp(np.arange(300) / 100, times, amplitudes) == pytest.approx(drives, abs=2e-4)
    frequency = load(tmp_path / "a.haptic")["signals"]["continuous"]["envelopes"]["frequency"]
    assert [point["frequency"] for point in frequency] == [0.5, 0.5]
    write_haptic(tmp_path / "one.haptic", track(np.full(1, 0.25)))  # a single frame lasts for one frame time
    envelopes = load(tmp_path / "one.haptic")["signals"]["continuous"]["envelopes"]
    assert envelopes["amplitude"] == [{"time": 0, "amplitude": 0.25}, {"time": 0.01, "amplitude": 0.25}]
    assert [point["time"] for point in envelopes["frequency"]] == [0, 0.01]


def test_tap_becomes_an_emphasis_and_a_transient(tmp_path: Path) -> None:
    drives = np.zeros(100)
    drives[[10, 50, 51]] = 0.4, 0.7, 0.9
    write_haptic(tmp_path / "a.haptic", track(drives))
    emphases = [p for p in check_clip(load(tmp_path / "a.haptic")) if "emphasis" in p]
    assert [(p["time"], p["amplitude"], p["emphasis"]["amplitude"]) for p in emphases] == [
        (0.1, 0, 0.4),
        (0.51, 0, 0.9),
    ]
    write_ahap(tmp_path / "a.ahap", track(drives))
    kinds = [entry["Event"]["EventType"] for entry in load(tmp_path / "a.ahap")["Pattern"]]
    assert kinds == ["HapticTransient"] * 2
    drives[99] = 0.5  # the effect ends before the tap does
    write_haptic(tmp_path / "b.haptic", track(drives))
    assert sum("emphasis" in p for p in check_clip(load(tmp_path / "b.haptic"))) == 2
    drives[70:90] = 0.2  # curves apply to all events: a tap within an envelope stays part of it
    write_ahap(tmp_path / "b.ahap", track(drives))
    read = read_ahap(tmp_path / "b.ahap").effect
    assert read.drives[:100, 0, 0] == pytest.approx(drives, abs=2e-4)


def test_pattern_round_trip_with_frequencies_and_long_events(tmp_path: Path) -> None:
    drives = np.random.default_rng(0).random(3500) * 0.9 + 0.05
    effect = track(drives, 120.0)
    write_ahap(tmp_path / "a.ahap", effect)
    read = read_ahap(tmp_path / "a.ahap").effect
    assert read.drives[:3500, 0, 0] == pytest.approx(drives, abs=2e-4)  # at 30 s one event follows another
    between = read_ahap(tmp_path / "a.ahap", 200.0).effect.drives[1:5999:2, 0, 0]
    # also across the curves' limits
    assert between == pytest.approx((drives[:2999] + drives[1:3000]) / 2, abs=2e-4)
    assert read.frequencies_hz is not None and read.frequencies_hz[5:3000] == pytest.approx(120, abs=0.1)


def test_notes_name_lost_information(tmp_path: Path) -> None:
    drives = np.random.default_rng(0).random((5, 2, 2)).astype(np.float32)
    notes = write_haptic(tmp_path / "a.haptic", ArrayEffect(50.0, drives, np.full_like(drives, 500)))
    assert "4 actuators become one" in notes[0] and "65 to 300 Hz" in notes[1]

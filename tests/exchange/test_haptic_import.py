"""Clips of Meta's Haptics Studio become drives: hand-written files, the export's own, and faulty ones."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import check_error, effects, key_paths, with_value, written
from touchfield.errors import InvalidArgument, SourceError
from touchfield.exchange.ahap import SHARPNESS_HZ
from touchfield.exchange.effect_files import write_haptic
from touchfield.exchange.haptic_read import read_haptic
from touchfield.exchange.symbolic import TRANSIENT_S, ArrayEffect, ImportedEffect

LOW, HIGH = SHARPNESS_HZ


def clip(
    amplitude: list[tuple[float, float] | tuple[float, float, float, float]],
    frequency: list[tuple[float, float]] | None = None,
    **more: Any,
) -> dict[str, Any]:
    points: list[dict[str, Any]] = []
    for time, value, *tap in amplitude:
        points.append({"time": time, "amplitude": value})
        if tap:
            points[-1]["emphasis"] = {"amplitude": tap[0], "frequency": tap[1]}
    envelopes: dict[str, Any] = {"amplitude": points}
    if frequency is not None:
        envelopes["frequency"] = [{"time": time, "frequency": value} for time, value in frequency]
    version = {"major": 1, "minor": 0, "patch": 0}
    metadata = {"editor": "Haptics Studio", "author": "", "tags": []}
    return {
        "version": version,
        "metadata": metadata,
        "signals": {"continuous": {"envelopes": envelopes}},
        **more,
    }


def read(folder: Path, document: Any, rate_hz: float = 100.0) -> ImportedEffect:
    return read_haptic(written(folder / "a.haptic", document), rate_hz)


def test_envelopes_are_linear_between_their_points(tmp_path: Path) -> None:
    imported = read(tmp_path, clip([(0, 0.2), (0.1, 1), (0.3, 0)], [(0.05, 0), (0.25, 1)]))
    effect = imported.effect
    assert effect.lattice == (1, 1, 1) and len(effect) == 31 and imported.notes == ()
    rising, falling = 0.2 + 0.8 * np.arange(11) / 10, 1 - np.arange(1, 21) / 20
    assert effect.drives[:, 0, 0] == pytest.approx([*rising, *falling], abs=1e-6)
    assert effect.frequencies_hz is not None
    expected = LOW + (HIGH - LOW) * np.clip((np.arange(31) - 5) / 20, 0, 1)
    assert effect.frequencies_hz[:-1, 0, 0] == pytest.approx(expected[:-1], abs=1e-3)
    late = read(tmp_path, clip([(0.1, 0.5), (0.2, 0.5)])).effect
    assert late.drives[:, 0, 0].tolist() == [0] * 10 + [0.5] * 11 and late.frequencies_hz is None


def test_an_emphasis_is_a_tap_in_place_of_the_envelope(tmp_path: Path) -> None:
    effect = read(tmp_path, clip([(0, 0.3), (0.1, 0.3, 0.8, 1.0), (0.2, 0.3)], [(0, 0)])).effect
    expected = np.full(21, 0.3)
    after_s = np.arange(3) / 100
    expected[10:13] = np.maximum(0.3, 0.8 * np.clip(1 - after_s / TRANSIENT_S, 0, 1))
    assert effect.drives[:, 0, 0] == pytest.approx(expected, abs=1e-6) and effect.frequencies_hz is not None
    assert effect.frequencies_hz[[9, 10, 11, 12], 0, 0].tolist() == [LOW, HIGH, HIGH, LOW]
    end = read(tmp_path, clip([(0, 0), (0.1, 0, 1, 0.5)])).effect.drives[:, 0, 0]
    assert end[10] == 1 and end[11] > 0 and end[-1] == 0  # the tap is not cut off
    for rate_hz in (10.0, 1000.0):
        at = read(tmp_path, clip([(0, 0), (0.1, 0, 0.7, 0)]), rate_hz).effect.drives[:, 0, 0]
        assert at.max() == pytest.approx(0.7) and int(np.argmax(at)) == round(0.1 * rate_hz)


def test_what_is_not_used_is_reported(tmp_path: Path) -> None:
    document = clip([(0, 1), (0.1, 1)], loop=True)
    document["signals"]["transient"] = []
    document["metadata"]["analysis"] = {}
    for point in document["signals"]["continuous"]["envelopes"]["amplitude"]:
        point["curve"] = "smooth"
    (note,) = read(tmp_path, document).notes
    assert note.startswith("Not used: loop, metadata.analysis, signals.transient")
    assert "signals.continuous.envelopes.amplitude[].curve (2 times)" in note


def without_taps(effect: ArrayEffect) -> ArrayEffect:
    """The effect without zeros, so that nothing in it is short enough for a tap."""
    return ArrayEffect(effect.rate_hz, np.maximum(effect.drives, np.float32(0.01)), effect.frequencies_hz)


@given(effect=effects())
def test_an_exported_clip_returns(tmp_path_factory: pytest.TempPathFactory, effect: ArrayEffect) -> None:
    effect = without_taps(effect)
    file = tmp_path_factory.mktemp("clip") / "a.haptic"
    write_haptic(file, effect)
    found = read_haptic(file, effect.rate_hz).effect
    drives = effect.drives.reshape(len(effect), -1)
    strongest = drives.argmax(axis=1)
    count = len(effect)
    assert len(found) == max(count, 2)  # a single frame lasts one frame period
    assert found.drives[:count, 0, 0] == pytest.approx(drives.max(axis=1), abs=1.01e-4)
    if effect.frequencies_hz is not None and found.frequencies_hz is not None:
        hertz = effect.frequencies_hz.reshape(count, -1)[np.arange(count), strongest]
        known = hertz > 0
        step_hz = 1.01e-4 * (HIGH - LOW)
        expected = np.clip(hertz, LOW, HIGH)
        assert found.frequencies_hz[:count, 0, 0][known] == pytest.approx(expected[known], abs=step_hz)


def test_taps_return_at_their_frame_with_their_peak(tmp_path: Path) -> None:
    drives = np.zeros((100, 1, 1), np.float32)
    drives[[10, 50, 51, 80]] = np.reshape([0.4, 0.7, 0.9, 1.0], (4, 1, 1))
    write_haptic(tmp_path / "a.haptic", ArrayEffect(100.0, drives, np.where(drives > 0, np.float32(100), 0)))
    found = read_haptic(tmp_path / "a.haptic").effect
    assert found.drives[[10, 51, 80], 0, 0] == pytest.approx([0.4, 0.9, 1.0], abs=1e-4)
    assert found.frequencies_hz is not None
    assert found.frequencies_hz[[10, 51, 80], 0, 0] == pytest.approx(100, abs=0.03)
    assert not found.drives[[9, 13, 49, 54, 79, 83], 0, 0].any()


FAULTS: list[tuple[Any, str]] = [
    ([], "$: found an array"),
    ({"version": {"major": 1}}, "no 'signals'"),
    (clip([(0, 1)]) | {"version": {"major": 2}}, "$.version.major: found version 2"),
    (clip([]), "amplitude: found no point"),
    (clip([(0, 1.5)]), "amplitude[0].amplitude"),
    (clip([(-1, 1)]), "amplitude[0].time"),
    (clip([(0.2, 1), (0.1, 1)]), "points in the order of time"),
    (clip([(0, 1, 2, 0)]), "amplitude[0].emphasis.amplitude"),
    (clip([(0, 1)], [(0, "high")]), "frequency[0].frequency"),  # type: ignore[list-item]
    (clip([(0, 1), (1e6, 1)]), "amplitude[1].time"),
]


@pytest.mark.parametrize(("document", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(SourceError) as caught:
        read(tmp_path, document)
    assert message in str(caught.value) and "a.haptic" in str(caught.value) and "\n" not in str(caught.value)


def test_long_clips_at_high_rates_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="drives"):
        read(tmp_path, clip([(0, 1), (3600, 1)]), rate_hz=10000.0)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        read(tmp_path, clip([(0, 1)]), rate_hz=0.0)


FULL = json.loads(json.dumps(clip([(0, 0.5), (0.1, 0.5, 1, 0.5), (0.2, 0)], [(0, 0), (0.2, 1)])))
VALUES = st.sampled_from([None, True, -1, 0, 0.5, 1e308, 10**30, "", "inf", [], {}, [{}]])


@given(keys=st.sampled_from(key_paths(FULL)), value=VALUES)
def test_only_named_errors_are_raised(
    tmp_path_factory: pytest.TempPathFactory, keys: tuple[Any, ...], value: Any
) -> None:
    document = with_value(FULL, keys, value)
    check_error(read_haptic, written(tmp_path_factory.mktemp("clip") / "a.haptic", document))

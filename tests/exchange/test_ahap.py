"""AHAP: intensity and sharpness over time as the drive and frequency of one actuator, and faulty files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import check_error, effects, key_paths, with_value, written
from touchfield.errors import InvalidArgument, SourceError
from touchfield.exchange.ahap import SHARPNESS_HZ, read_ahap
from touchfield.exchange.effect_files import write_ahap
from touchfield.exchange.symbolic import TRANSIENT_S, ArrayEffect


def event(
    kind: str, time_s: float = 0.0, duration_s: float | None = None, **parameters: Any
) -> dict[str, Any]:
    event_parameters = [{"ParameterID": name, "ParameterValue": value} for name, value in parameters.items()]
    length = {} if duration_s is None else {"EventDuration": duration_s}
    return {"Event": {"Time": time_s, "EventType": kind, "EventParameters": event_parameters, **length}}


def curve(name: str, time_s: float, *points: tuple[float, float]) -> dict[str, Any]:
    control_points = [{"Time": t, "ParameterValue": v} for t, v in points]
    return {
        "ParameterCurve": {"ParameterID": name, "Time": time_s, "ParameterCurveControlPoints": control_points}
    }


def read(path: Path, *entries: dict[str, Any], rate_hz: float = 100.0) -> ArrayEffect:
    return read_ahap(written(path / "a.ahap", {"Version": 1.0, "Pattern": list(entries)}), rate_hz).effect


def drives(path: Path, *entries: dict[str, Any], rate_hz: float = 100.0) -> np.ndarray:
    return read(path, *entries, rate_hz=rate_hz).drives[:, 0, 0]


def test_a_continuous_event_has_its_intensity_and_frequency(tmp_path: Path) -> None:
    result = read(tmp_path, event("HapticContinuous", 0.02, 0.1, HapticIntensity=0.5, HapticSharpness=0.4))
    assert result.lattice == (1, 1, 1) and result.frequencies_hz is not None
    assert result.drives[:, 0, 0].tolist() == [0, 0] + [0.5] * 11 + [0]
    low, high = SHARPNESS_HZ
    expected = np.where(result.drives > 0, low + 0.4 * (high - low), 0)
    assert result.frequencies_hz == pytest.approx(expected)


def test_defaults_and_clamping(tmp_path: Path) -> None:
    assert drives(tmp_path, event("HapticContinuous", -1.0, 0.02)).tolist() == [1, 1, 1, 0]
    # between two frames
    assert drives(tmp_path, event("HapticContinuous", 0.017, 0.001)).tolist() == [
        0,
        0,
        1,
        0,
    ]
    result = read(tmp_path, event("HapticContinuous", 0.0, 0.02, HapticIntensity=7, HapticSharpness=-3))
    assert (
        result.drives.max() == 1
        and result.frequencies_hz is not None
        and result.frequencies_hz[0] == SHARPNESS_HZ[0]
    )
    loud = event("HapticContinuous", 0, 0.1, HapticIntensity=7, HapticSharpness=9, Sustained=False)
    low = curve("HapticSharpnessControl", 0, (0, -0.5))
    result = read(tmp_path, loud, low)  # values are clamped before curves apply
    assert result.drives[5] == pytest.approx(0.5) and result.frequencies_hz is not None
    assert result.frequencies_hz[5] == pytest.approx(np.mean(SHARPNESS_HZ))
    half = event("HapticContinuous", 0, 0.1, HapticIntensity=0.5)
    for value, drive in ((7, 0.5), (-7, 0)):  # a control can neither amplify the drive nor make it negative
        assert read(tmp_path, half, curve("HapticIntensityControl", 0, (0, value))).drives.max() == drive


@pytest.mark.parametrize("rate_hz", [10.0, 100.0, 1000.0])
def test_transient_is_never_skipped(tmp_path: Path, rate_hz: float) -> None:
    found = drives(tmp_path, event("HapticTransient", 0.1678, HapticIntensity=0.8), rate_hz=rate_hz)
    first = round(0.1678 * rate_hz)
    assert found[first] == pytest.approx(0.8) and not found[:first].any() and found[-1] == 0
    assert (np.diff(found[first:]) <= 0).all()
    assert np.flatnonzero(found)[-1] <= first + TRANSIENT_S * rate_hz
    after = np.arange(len(found) - first) / rate_hz
    assert found[first:] == pytest.approx(0.8 * np.clip(1 - after / TRANSIENT_S, 0, 1))
    assert len(found) == first + int(TRANSIENT_S * rate_hz) + 2


def test_attack_release_and_sustained(tmp_path: Path) -> None:
    attack = drives(tmp_path, event("HapticContinuous", 0, 0.1, AttackTime=0.05))
    assert attack[:7] == pytest.approx([0, 0.2, 0.4, 0.6, 0.8, 1, 1])
    release = drives(tmp_path, event("HapticContinuous", 0, 0.1, ReleaseTime=0.05))
    assert release[10:] == pytest.approx([1, 0.8, 0.6, 0.4, 0.2, 0, 0], abs=1e-6)
    falling = drives(tmp_path, event("HapticContinuous", 0, 0.1, Sustained=False, ReleaseTime=0.05))
    assert falling == pytest.approx([*(1 - np.arange(11) / 10), 0], abs=1e-6)


def test_controls_multiply_intensity_and_add_to_sharpness(tmp_path: Path) -> None:
    result = read(
        tmp_path,
        event("HapticContinuous", 0, 0.4, HapticIntensity=0.8, HapticSharpness=0.5),
        {"Parameter": {"ParameterID": "HapticIntensityControl", "Time": 0.3, "ParameterValue": 0.25}},
        curve(
            "HapticIntensityControl", 0.1, (0, 1), (0.1, 0.5)
        ),  # neither the curves nor their points are ordered by time
        curve("HapticSharpnessControl", 0.0, (0.4, -0.4), (0, 0)),
        curve("AudioVolumeControl", 0.0, (0, 0)),
    )
    at = result.drives[[0, 10, 15, 25, 30, 40], 0, 0]
    assert at == pytest.approx([0.8, 0.8, 0.6, 0.4, 0.2, 0.2])
    low, high = SHARPNESS_HZ
    assert result.frequencies_hz is not None
    assert result.frequencies_hz[[0, 20, 40], 0, 0] == pytest.approx(
        [low + s * (high - low) for s in (0.5, 0.3, 0.1)]
    )


def test_overlapping_events_add_and_the_strongest_sets_the_frequency(tmp_path: Path) -> None:
    result = read(
        tmp_path,
        event("HapticContinuous", 0, 0.1, HapticIntensity=0.7, HapticSharpness=0),
        event("HapticContinuous", 0.05, 0.1, HapticIntensity=0.6, HapticSharpness=1),
    )
    assert (
        result.drives[[2, 7, 12], 0, 0] == pytest.approx([0.7, 1.0, 0.6])
        and result.frequencies_hz is not None
    )
    assert result.frequencies_hz[[2, 7, 12], 0, 0].tolist() == [65, 65, 300]


def test_frequency_is_that_of_the_strongest_event_and_not_of_a_sum(tmp_path: Path) -> None:
    weak = [event("HapticContinuous", 0, 0.1, HapticIntensity=0.3, HapticSharpness=0) for _ in range(2)]
    strong = event("HapticContinuous", 0, 0.1, HapticIntensity=0.35, HapticSharpness=1)
    for entries in ([*weak, strong], [strong, *weak], [weak[0], strong, weak[1]]):
        result = read(tmp_path, *entries)
        assert result.drives[5] == pytest.approx(0.95) and result.frequencies_hz is not None
        assert result.frequencies_hz[5] == SHARPNESS_HZ[1]


def test_a_tap_over_a_continuous_event_is_their_sum(tmp_path: Path) -> None:
    """Figures worked out by hand: a tap of 0.9 at 0.1 s over a rise to 0.6, sharpness raised by 0.3 there."""
    continuous = event("HapticContinuous", 0, 0.3, HapticIntensity=0.6, AttackTime=0.1, ReleaseTime=0.1)
    tap = event("HapticTransient", 0.1, HapticIntensity=0.9)
    sharper = {"Parameter": {"ParameterID": "HapticSharpnessControl", "Time": 0.1, "ParameterValue": 0.3}}
    path = written(tmp_path / "a.ahap", {"Pattern": [continuous, sharper, tap]})
    imported = read_ahap(path, 200.0)
    found = imported.effect.drives[:, 0, 0]
    assert found[[10, 19, 20, 23, 24, 25, 40, 60, 70, 80]] == pytest.approx(
        [0.3, 0.57, 1, 0.6 + 0.9 * 7 / 22, 0.6 + 0.9 * 2 / 22, 0.6, 0.6, 0.6, 0.3, 0], abs=1e-6
    )
    hertz = imported.effect.frequencies_hz
    assert hertz is not None and hertz[[10, 30], 0, 0] == pytest.approx([182.5, 253])
    # of 79 driven frames three are limited: 0.6 + 0.9, 0.6 + 0.9 * 17 / 22, 0.6 + 0.9 * 12 / 22
    (note,) = imported.notes
    assert note.startswith("In 3.8 % of the pattern the drives of overlapping events add up to more than 1")


def test_what_overlaps_lose_and_what_is_not_used_is_noted(tmp_path: Path) -> None:
    dull, sharp = (
        event("HapticContinuous", start, 0.1, HapticIntensity=0.4, HapticSharpness=value)
        for start, value in ((0, 0), (0.05, 1))
    )
    path = written(tmp_path / "a.ahap", {"Pattern": [dull, sharp]})
    (note,) = read_ahap(path).notes
    assert "overlapping events differ in sharpness" in note and note.startswith("In 37.5 %")  # 6 of 16
    decaying = event("HapticContinuous", 0, 0.1, DecayTime=0.1)
    tap = event("HapticTransient", 0.5, AttackTime=0.5, Flavour=1)
    slow = curve("HapticAttackTimeControl", 0, (0, 1))
    document = {"Pattern": [decaying, tap, slow, {"Smell": 1}], "Colour": 1}
    (note,) = read_ahap(written(tmp_path / "b.ahap", document)).notes
    assert note.startswith("Not used: ")
    for name in (
        "Colour", "Pattern[].Smell", "DecayTime of HapticContinuous", "AttackTime of HapticTransient",
        "Flavour of HapticTransient", "HapticAttackTimeControl",
    ):  # fmt: skip
        assert name in note


@given(effect=effects())
def test_an_exported_pattern_returns(tmp_path_factory: pytest.TempPathFactory, effect: ArrayEffect) -> None:
    drives = np.maximum(effect.drives, np.float32(0.01))  # without taps, which become transients
    path, count = tmp_path_factory.mktemp("ahap") / "a.ahap", len(effect)
    write_ahap(path, ArrayEffect(effect.rate_hz, drives, effect.frequencies_hz))
    found = read_ahap(path, effect.rate_hz).effect
    flat = drives.reshape(count, -1)
    assert found.drives[:count, 0, 0] == pytest.approx(flat.max(axis=1), abs=2e-4)
    assert not found.drives[max(count, 2) :].any()
    if effect.frequencies_hz is not None and found.frequencies_hz is not None:
        hertz = effect.frequencies_hz.reshape(count, -1)[np.arange(count), flat.argmax(axis=1)]
        low, high = SHARPNESS_HZ
        expected = np.clip(hertz, low, high)[hertz > 0]
        assert found.frequencies_hz[:count, 0, 0][hertz > 0] == pytest.approx(
            expected, abs=2e-4 * (high - low)
        )


def test_sounds_are_ignored(tmp_path: Path) -> None:
    sound, touch = event("AudioContinuous", 0, 1.0), event("HapticTransient", 0.0)
    result = read_ahap(
        written(tmp_path / "a.ahap", {"Pattern": [sound, touch, {"Other": 1}], "Metadata": {}})
    )
    assert "1 events of sound" in result.notes[0]
    with pytest.raises(SourceError, match="and no other"):
        read(tmp_path, sound)


FAULTS: list[tuple[Any, str]] = [
    ([], "$: found an array"),
    ({}, "no 'Pattern'"),
    ({"Pattern": {}}, "$.Pattern"),
    ({"Pattern": []}, "$.Pattern: found no event"),
    ({"Pattern": [3]}, "$.Pattern[0]"),
    ({"Pattern": [event("Smell")]}, "$.Pattern[0].Event.EventType"),
    ({"Pattern": [event("HapticTransient", "now")]}, "$.Pattern[0].Event.Time"),  # type: ignore[arg-type]
    ({"Pattern": [event("HapticContinuous", 0, 1e6)]}, "$.Pattern[0].Event.EventDuration"),
    ({"Pattern": [event("HapticContinuous", 3600, 3600)]}, "a pattern of 7200 s"),
    ({"Pattern": [event("HapticTransient", HapticIntensity="much")]}, "EventParameters[0].ParameterValue"),
    ({"Pattern": [curve("HapticIntensityControl", 0, (None, 1))]}, "ParameterCurveControlPoints[0].Time"),  # type: ignore[arg-type]
]


@pytest.mark.parametrize(("document", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(SourceError) as caught:
        read_ahap(written(tmp_path / "a.ahap", document))
    assert message in str(caught.value) and "a.ahap" in str(caught.value)


def test_small_files_with_huge_effects_are_refused(tmp_path: Path) -> None:
    many = [event("HapticContinuous", 0, 3600) for _ in range(1000)]
    with pytest.raises(SourceError, match="1000 events"):
        read(tmp_path, *many)
    with pytest.raises(InvalidArgument, match="rate_hz"):
        read(tmp_path, many[0], rate_hz=0.0)
    with pytest.raises(InvalidArgument, match="drives"):
        read(tmp_path, many[0], rate_hz=10000.0)


FULL = {
    "Version": 1.0,
    "Pattern": [
        event("HapticTransient", 0.1, HapticIntensity=1, Sustained=True),
        event("HapticContinuous", 0.1, 0.2, AttackTime=0.1),
        curve("HapticIntensityControl", 0.0, (0, 1), (0.1, 0.5)),
    ],
}
VALUES = st.sampled_from([None, True, -1, 0, 0.5, 1e308, 10**30, "", "HapticTransient", [], {}, [{}]])


@given(keys=st.sampled_from(key_paths(FULL)), value=VALUES)
def test_only_named_errors_are_raised(
    tmp_path_factory: pytest.TempPathFactory, keys: tuple[Any, ...], value: Any
) -> None:
    document = with_value(FULL, keys, value)
    check_error(read_ahap, written(tmp_path_factory.mktemp("ahap") / "a.ahap", document))

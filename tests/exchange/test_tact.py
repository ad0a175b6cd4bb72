"""Patterns of bHaptics vests: round trip within a hundredth, and no lost taps."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import TactSpan, read_tact
from touchfield.errors import InvalidArgument
from touchfield.exchange.effect_files import MIN_SPAN_MS, write_tact
from touchfield.exchange.symbolic import ArrayEffect


def intensities_at(spans: list[TactSpan], time_ms: float) -> np.ndarray:
    """Intensities at a time, float32 [5, 4]."""
    on = [span.intensities for span in spans if span.start_ms <= time_ms < span.end_ms]
    assert len(on) <= 1  # spans of one panel never meet
    return on[0] if on else np.zeros((5, 4), np.float32)


@given(
    rate_hz=st.sampled_from([5.0, 20.0, 30.0, 50.0]),
    count=st.integers(1, 20),
    seed=st.integers(0, 2**32 - 1),
    hold=st.integers(1, 3),
)
def test_pattern_round_trip_is_within_half_a_hundredth(
    tmp_path_factory: pytest.TempPathFactory, rate_hz: float, count: int, seed: int, hold: int
) -> None:
    rng = np.random.default_rng(seed)
    drives = (rng.random((count, 5, 4)) * (rng.random((count, 5, 4)) < 0.4)).astype(np.float32)
    drives = np.repeat(drives, hold, axis=0)
    path = tmp_path_factory.mktemp("tact") / "a.tact"
    write_tact(path, ArrayEffect(rate_hz, drives))
    spans = read_tact(path)
    assert all(span.position == "VestFront" and span.end_ms > span.start_ms for span in spans)
    for i, expected in enumerate(drives):
        assert intensities_at(spans, 1000 * (i + 0.5) / rate_hz) == pytest.approx(expected, abs=0.00501)
    assert not intensities_at(spans, 1000 * len(drives) / rate_hz + 1).any()


def test_short_frames_are_merged_and_the_maximum_is_kept(tmp_path: Path) -> None:
    drives = np.zeros((100, 5, 4), np.float32)
    drives[37, 2, 1] = 0.75  # a tap of 1 ms
    write_tact(tmp_path / "a.tact", ArrayEffect(1000.0, drives))
    (span,) = read_tact(tmp_path / "a.tact")
    assert (span.start_ms, span.end_ms) == (20, 20 + MIN_SPAN_MS)
    assert span.intensities[2, 1] == 0.75 and np.count_nonzero(span.intensities) == 1
    write_tact(tmp_path / "b.tact", ArrayEffect(4000.0, drives[37:38]))  # a tap of 0.25 ms
    (span,) = read_tact(tmp_path / "b.tact")
    assert (span.start_ms, span.end_ms) == (0, 1)
    assert json.loads((tmp_path / "b.tact").read_text())["durationMillis"] == 1


def test_structure_of_a_project(tmp_path: Path) -> None:
    drives = np.zeros((2, 5, 4), np.float32)
    drives[:, 4, 3] = 1
    write_tact(tmp_path / "wave.tact", ArrayEffect(20.0, drives), panel="back")
    document: dict[str, Any] = json.loads((tmp_path / "wave.tact").read_text())
    assert (document["size"], document["intervalMillis"], document["durationMillis"]) == (20, 20, 100)
    project = document["project"]
    assert project["name"] == "wave" and project["layout"]["type"] == "Tactot"
    assert project["mediaFileDuration"] == 1  # rounded up to whole seconds
    layout = project["layout"]["layouts"]["VestFront"]
    assert [entry["index"] for entry in layout] == list(range(20)) and layout[-1] == {
        "index": 19,
        "x": 1.0,
        "y": 1.0,
    }
    ((effect,),) = [track["effects"] for track in project["tracks"]]
    assert (effect["startTime"], effect["offsetTime"]) == (0, 100)
    back, front = effect["modes"]["VestBack"], effect["modes"]["VestFront"]
    assert back["mode"] == "DOT_MODE" and [entry["pointList"] for entry in front["dotMode"]["feedback"]] == [
        []
    ]
    assert back["dotMode"]["feedback"] == [
        {
            "startTime": 0,
            "endTime": 100,
            "playbackType": "NONE",
            "pointList": [{"index": 19, "intensity": 1.0}],
        }
    ]


def test_vests_with_fewer_rows_use_all_dots(tmp_path: Path) -> None:
    for rows, shows in ((4, [0, 1, 2, 3, 3]), (2, [0, 0, 1, 1, 1])):
        drives = np.broadcast_to((1 + np.arange(rows)[:, None]) / 10, (2, rows, 4)).astype(np.float32)
        write_tact(tmp_path / "a.tact", ArrayEffect(20.0, drives))
        (span,) = read_tact(tmp_path / "a.tact")
        assert span.intensities == pytest.approx(np.repeat((1 + np.array(shows)) / 10, 4).reshape(5, 4))


def test_arrays_that_are_no_vest_are_refused(tmp_path: Path) -> None:
    for rows, columns in ((8, 8), (5, 5), (3, 4), (1, 1)):
        with pytest.raises(InvalidArgument, match="tactsuit-x40"):
            write_tact(tmp_path / "a.tact", ArrayEffect(20.0, np.zeros((2, rows, columns), np.float32)))
    with pytest.raises(InvalidArgument, match="panel"):
        write_tact(tmp_path / "a.tact", ArrayEffect(20.0, np.zeros((2, 5, 4), np.float32)), panel="top")
    assert list(tmp_path.iterdir()) == []

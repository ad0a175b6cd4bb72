"""Projects of bHaptics' designer become drives: hand-written files, the export's own, and faulty ones."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from effect_makers import check_error, key_paths, with_value, written
from touchfield.errors import InvalidArgument, SourceError
from touchfield.exchange import ArrayEffect, ImportedEffect, read_tact, write_tact
from touchfield.exchange.effect_files import MIN_SPAN_MS


def span(start_ms: int, end_ms: int, dots: dict[int, Any], playback: str = "NONE") -> dict[str, Any]:
    points = [{"index": index, "intensity": intensity} for index, intensity in dots.items()]
    return {"startTime": start_ms, "endTime": end_ms, "playbackType": playback, "pointList": points}


def dots(*spans: dict[str, Any], connected: bool = False) -> dict[str, Any]:
    return {"mode": "DOT_MODE", "dotMode": {"dotConnected": connected, "feedback": list(spans)}}


def path(*points: tuple[Any, Any, Any, int], playback: str = "NONE") -> dict[str, Any]:
    entries = [{"x": x, "y": y, "intensity": value, "time": time} for x, y, value, time in points]
    way = {"movingPattern": "CONST_TDM", "playbackType": playback, "visible": True, "pointList": entries}
    return {"mode": "PATH_MODE", "pathMode": {"feedback": [way]}}


def effect(start_ms: int, length_ms: int, **modes: dict[str, Any]) -> dict[str, Any]:
    return {"name": "e", "startTime": start_ms, "offsetTime": length_ms, "modes": modes}


def project(*effects: dict[str, Any], **more: Any) -> dict[str, Any]:
    return {"project": {"tracks": [{"enable": True, "effects": list(effects)}], **more}}


def read(folder: Path, document: dict[str, Any], rate_hz: float = 50.0) -> ImportedEffect:
    return read_tact(written(folder / "a.tact", document), rate_hz)


def test_dots_of_a_span_are_driven_from_its_start_to_its_end(tmp_path: Path) -> None:
    front = dots(span(20, 60, {0: "0.700", 19: 0.5}), span(80, 100, {6: 1}))
    imported = read(tmp_path, project(effect(40, 100, VestFront=front)))
    drives = imported.effect.drives
    assert drives.shape == (7, 5, 4) and imported.effect.frequencies_hz is None
    expected = np.zeros((7, 5, 4))
    expected[3:5, 0, 0], expected[3:5, 4, 3] = 0.7, 0.5  # 60 to 100 ms: frames of 20 ms
    expected[6, 1, 2] = 1
    assert drives == pytest.approx(expected)
    assert imported.notes == () and imported.device_name == "tactsuit-x40"


@pytest.mark.parametrize(
    ("playback", "expected"),
    [
        ("NONE", [1, 1, 1, 1, 1]), ("FADE_IN", [0, 0.2, 0.4, 0.6, 0.8]),
        ("FADE_OUT", [1, 0.8, 0.6, 0.4, 0.2]),
        ("FADE_IN_OUT", [0, 0.4, 0.8, 0.8, 0.4]),
    ],
)  # fmt: skip
def test_spans_fade_linearly(tmp_path: Path, playback: str, expected: list[float]) -> None:
    for mode in (dots(span(0, 100, {0: 1}, playback)), path((0, 0, 1, 0), playback=playback)):
        found = read(tmp_path, project(effect(0, 100, VestFront=mode))).effect.drives
        assert found[:, 0, 0] == pytest.approx(expected, abs=1e-6)


def test_connected_dots_change_linearly_to_the_next_span(tmp_path: Path) -> None:
    """As the vendor's designer renders it: 100, 89, 80, ... for a dot that ends, 0, 10, 20 for the next."""
    spans = span(0, 200, {0: 1}), span(200, 400, {5: "1.000"}), span(400, 400, {5: 1, 7: 1})
    drives = read(tmp_path, project(effect(0, 400, VestFront=dots(*spans, connected=True)))).effect.drives
    ramp = np.arange(10) / 10
    assert drives.shape[0] == 20
    assert drives[:10, 0, 0] == pytest.approx(1 - ramp) and drives[:10, 1, 1] == pytest.approx(ramp)
    assert drives[10:, 1, 1] == pytest.approx(1) and drives[10:, 1, 3] == pytest.approx(ramp, abs=1e-6)


def test_a_path_moves_between_the_dots(tmp_path: Path) -> None:
    way = path(("0.000", "0.000", "1.000", 0), (1, 0, 1, 300), (1, 1, 0.5, 500))
    imported = read(tmp_path, project(effect(0, 500, VestBack=way)), rate_hz=100.0)
    drives = imported.effect.drives
    assert drives.shape == (50, 5, 4)
    for frame, row, column, value in (
        (0, 0, 0, 1),
        (10, 0, 1, 1),
        (20, 0, 2, 1),
        (30, 0, 3, 1),
        (40, 2, 3, 0.75),
    ):
        assert drives[frame, row, column] == pytest.approx(value, abs=1e-5)
        assert drives[frame].sum() == pytest.approx(value, abs=1e-5)
    assert drives[5, 0, :2] == pytest.approx([0.5, 0.5], abs=1e-5)
    assert drives[:30].sum(axis=(1, 2)) == pytest.approx(1, abs=1e-5)  # a point is shared, not multiplied
    assert any("VestBack" in note for note in imported.notes) and any(
        "path" in note for note in imported.notes
    )


def test_overlapping_effects_add_up_to_a_full_drive(tmp_path: Path) -> None:
    first, second = (effect(start, 100, VestFront=dots(span(0, 100, {0: 0.7}))) for start in (0, 60))
    found = read(tmp_path, project(first, second)).effect.drives[:, 0, 0]
    assert found == pytest.approx([0.7] * 3 + [1] * 2 + [0.7] * 3)


def test_a_short_span_is_placed_at_the_nearest_frame(tmp_path: Path) -> None:
    found = read(tmp_path, project(effect(0, 400, VestFront=dots(span(130, 140, {3: 0.9})))), rate_hz=10.0)
    assert found.effect.drives[:, 0, 3] == pytest.approx([0, 0.9, 0, 0])


def test_positions_are_placed_side_by_side(tmp_path: Path) -> None:
    layout = {"type": "Head", "layouts": {"Head": [{"index": n, "x": n / 5, "y": 0.5} for n in range(6)]}}
    modes = {"Head": dots(span(0, 20, {5: 1})), "VestBack": dots(span(0, 20, {4: 0.5}))}
    modes["VestFront"] = dots(span(0, 20, {}))  # nothing is driven
    imported = read(tmp_path, project(effect(0, 20, **modes), layout=layout))
    drives = imported.effect.drives
    assert drives.shape == (1, 5, 10) and drives[0, 1, 0] == 0.5 and drives[0, 0, 9] == 1
    assert drives.sum() == 1.5 and "VestBack, Head (side by side)" in imported.notes[0]
    assert imported.device_name == ""
    grid = [{"index": n, "x": "1.0" if n % 2 else 0, "y": n // 2} for n in range(6)]
    arm = read(
        tmp_path,
        project(effect(0, 20, ForearmL=dots(span(0, 20, {3: 1}))), layout={"layouts": {"ForearmL": grid}}),
    )
    assert np.argwhere(arm.effect.drives).tolist() == [[0, 1, 1]] and arm.effect.lattice == (2, 3, 1)


def test_what_is_not_used_is_reported(tmp_path: Path) -> None:
    document = project(
        effect(0, 20, VestFront=dots(span(0, 20, {0: 1})) | {"texture": 3, "wave": 1}), colour="red"
    )
    document["project"]["tracks"].append({"enable": False, "effects": []})
    document["project"]["tracks"][0]["effects"][0]["volume"] = 2
    notes = read(tmp_path, document).notes
    assert "Left out: 1 tracks that are not enabled." in notes
    (unused,) = [note for note in notes if note.startswith("Not used")]
    for name in ("project.colour", "volume", "texture", "wave"):
        assert name in unused
    assert read(tmp_path, document["project"]).effect.drives.any()  # a bare project, as SDKs register it


@given(
    rate_hz=st.sampled_from([1.0, 5.0, 20.0, 30.0, 50.0, 100.0, 1000 / 3]),
    count=st.integers(1, 20),
    seed=st.integers(0, 2**32 - 1),
    panel=st.sampled_from(["front", "back"]),
)
def test_an_exported_pattern_returns_within_half_a_hundredth(
    tmp_path_factory: pytest.TempPathFactory, rate_hz: float, count: int, seed: int, panel: str
) -> None:
    rng = np.random.default_rng(seed)
    drives = (rng.random((count, 5, 4)) * (rng.random((count, 5, 4)) < 0.4)).astype(np.float32)
    drives[-1, 0, 0] = 0.5  # the pattern is not silent
    file = tmp_path_factory.mktemp("tact") / "a.tact"
    write_tact(file, ArrayEffect(rate_hz, drives), panel=panel)
    imported = read_tact(file, rate_hz)
    stride = int(np.ceil(MIN_SPAN_MS * rate_hz / 1000 - 1e-9))  # frames that share one span
    blocks = np.repeat(np.maximum.reduceat(drives, np.arange(0, count, stride), axis=0), stride, axis=0)
    assert len(imported.effect) == count and imported.device_name == "tactsuit-x40"
    assert imported.effect.drives == pytest.approx(blocks[:count], abs=0.00501)
    assert ("VestBack" in "".join(imported.notes)) == (panel == "back")


HEAD = {"layouts": {"Head": [{"index": 1, "x": 0, "y": 0}]}}
FAULTS: list[tuple[Any, str]] = [
    ([], "$: found an array"),
    ({"project": {}}, "no 'tracks'"),
    (project(), "no dot that is driven"),
    (project(effect(0, 20, VestFront=dots(span(0, 20, {20: 1})))), "pointList[0].index"),
    (project(effect(0, 20, VestFront=dots(span(0, 20, {0: 1.5})))), "pointList[0].intensity"),
    (project(effect(0, 20, VestFront=dots(span(0, 20, {0: "loud"})))), "pointList[0].intensity"),
    (project(effect(0, 20, VestFront=dots(span(0, 20, {0: "nan"})))), "pointList[0].intensity"),
    (project(effect(0, 20, VestFront=dots(span(30, 20, {0: 1})))), "a time after startTime"),
    (project(effect(0, 20, VestFront=dots(span(0, 20, {0: 1}, "SLOWLY")))), "playbackType"),
    (project(effect(0, 20, VestFront=path((2, 0, 1, 0)))), "pointList[0].x"),
    (project(effect(0, 20, VestFront=path((0, 0, 1, 9), (1, 1, 1, 3)))), "points in the order of time"),
    (project(effect(0, 20, Cape=dots(span(0, 20, {0: 1})))), "position 'Cape'"),
    (project(effect(0, 20, Head=dots(span(0, 20, {0: 1}))), layout=HEAD), "indices from 0"),
    (project(effect(3_600_000, 3_600_000, VestFront=dots(span(0, 20, {0: 1})))), "a pattern of 7200 s"),
    (project(effect(0, 20, VestFront={"mode": "SING"})), "VestFront.mode"),
]


@pytest.mark.parametrize(("document", "message"), FAULTS)
def test_faults_are_named(tmp_path: Path, document: Any, message: str) -> None:
    with pytest.raises(SourceError) as caught:
        read(tmp_path, document)
    assert message in str(caught.value) and "a.tact" in str(caught.value) and "\n" not in str(caught.value)


def test_small_files_with_huge_patterns_are_refused(tmp_path: Path) -> None:
    hour = effect(0, 3_600_000, VestFront=dots(*[span(0, 3_600_000, dict.fromkeys(range(20), 1))] * 100))
    with pytest.raises(InvalidArgument, match="a lower rate"):
        read(tmp_path, project(hour), rate_hz=100.0)
    with pytest.raises(InvalidArgument, match="drives"):
        read(tmp_path, project(hour), rate_hz=10000.0)


FULL = project(
    effect(0, 100, VestFront=dots(span(0, 40, {0: "0.5"}), span(40, 90, {1: 1}), connected=True)),
    effect(50, 100, VestBack=path((0, 0, 1, 0), (1, 1, 1, 80))),
    effect(50, 100, Head=dots(span(0, 20, {0: 1}))),
    layout={"layouts": {"Head": [{"index": 0, "x": 0, "y": 0}, {"index": 1, "x": 1, "y": 0}]}},
)
VALUES = st.sampled_from([None, True, -1, 0, 0.5, 1e308, 10**30, "", "inf", "PATH_MODE", [], {}, [{}]])


@given(keys=st.sampled_from(key_paths(FULL)), value=VALUES)
def test_only_named_errors_are_raised(
    tmp_path_factory: pytest.TempPathFactory, keys: tuple[Any, ...], value: Any
) -> None:
    document = with_value(FULL, keys, value)

    def read_drives(file: Path) -> None:
        assert read_tact(file).effect.drives.any()

    check_error(read_drives, written(tmp_path_factory.mktemp("tact") / "a.tact", document))

"""The edit list of a movie's touch is applied exactly, and lists that do not fit end with one error."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import touchfield as tf
from timeline_makers import FORCE_MAX_N, LOSSLESS, picture_medium, sound_medium, write_movie
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters.strength import Strength, count_limited, scale_frames
from touchfield.network.demux import demux, demux_all
from touchfield.tasks.timeline import edit_timeline
from touchfield.tasks.touch_tracks import touch_tracks


def amplitudes_n(medium: tf.HapticMedium) -> NDArray[np.float32]:
    """The largest amplitude of each frame, of force and vibration."""
    forces = [float(frame.support().amplitudes_n.max(initial=0.0)) for frame in medium]
    band = medium.vibration
    bands = [
        0.0 if band is None else float(band(n).amplitudes_n.max(initial=0.0)) for n in range(len(medium))
    ]
    return np.maximum(forces, bands).astype(np.float32)


def runs_of(*runs: tuple[int, int, int]) -> list[dict[str, int]]:
    keys = ("first_frame", "stop_frame", "percent")
    return [dict(zip(keys, run, strict=True)) for run in runs]


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("av", reason="movies need the extra video")
    return write_movie(tmp_path_factory.mktemp("timeline"))


def edit_list(path: Path, movie: Path, folder: Path, **edits: dict[str, Any]) -> Path:
    """An edit list for the tracks of a movie as the page saves it, with edits by name."""
    tracks, _ = touch_tracks(movie, folder)
    rows = [
        {
            "name": track.name,
            "frames": track.frame_count,
            "rate_hz": track.rate_hz,
            "crc32": track.crc32,
            "is_muted": False,
            "offset_ms": 0,
            "strengths": [],
            **edits.get(track.name, {}),
        }
        for track in tracks
    ]
    document = {"format": "touchfield-timeline", "version": 1, "movie": movie.name, "tracks": rows}
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


# -- strengths ---------------------------------------------------------------------------------------------


def test_frames_without_a_strength_keep_their_bits() -> None:
    medium = picture_medium()
    edited = scale_frames(medium, [Strength(10, 20, 50), Strength(20, 22, 0)], FORCE_MAX_N)
    for n, (before, after) in enumerate(zip(medium, edited, strict=True)):
        factor = 0.5 if 10 <= n < 20 else 0 if 20 <= n < 22 else 1
        assert (after.to_dense() == before.to_dense() * np.float32(factor)).all()
    assert edited.tags == medium.tags and "10-20: 50 %" in edited.provenance["edits"]


def test_a_strength_above_100_percent_is_limited_to_the_device() -> None:
    medium, strengths = sound_medium(), [Strength(0, 300, 200)]
    edited = amplitudes_n(scale_frames(medium, strengths, FORCE_MAX_N))
    before = amplitudes_n(medium)
    is_driven = before[:300] > 0
    assert (edited[:300][is_driven] == np.float32(FORCE_MAX_N)).all() and (edited[300:] == before[300:]).all()
    assert count_limited(medium, strengths, FORCE_MAX_N) == is_driven.sum() > 0
    assert not amplitudes_n(scale_frames(medium, [Strength(0, 600, 0)], FORCE_MAX_N)).any()


@pytest.mark.parametrize("runs", [((0, 5, 10), (4, 6, 10)), ((4, 6, 10), (0, 2, 10)), ((0, 76, 10),)])
def test_runs_that_overlap_or_end_after_the_medium_are_refused(
    runs: tuple[tuple[int, int, int], ...],
) -> None:
    with pytest.raises(InvalidArgument):
        scale_frames(picture_medium(), [Strength(*run) for run in runs], FORCE_MAX_N)


# -- movies ------------------------------------------------------------------------------------------------


def test_the_command_applies_strength_mute_and_offset(
    movie: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Strengths are exact in mode lossless, and a track without them keeps its bytes."""
    edits = edit_list(
        tmp_path / "edits.json",
        movie,
        tmp_path,
        picture={"offset_ms": 120},
        sound={"strengths": runs_of((0, 200, 50), (300, 400, 0))},
    )
    out = tmp_path / "edited.mp4"
    command = ["edit", str(movie), str(out), "--timeline", str(edits), "--mode", "lossless", "--json"]
    assert _exit_code(command) == 0
    figures = json.loads(capsys.readouterr().out)
    assert not [note for note in figures["notes"] if "empty" in note], "it has vibrations, and no forces"
    assert [(row["name"], row["offset_ms"], row["regions"]) for row in figures["tracks"]] == [
        ("picture", 120, 0), ("sound", 0, 2),
    ]  # fmt: skip
    folder = tmp_path / "back"
    folder.mkdir()
    picture, sound = demux_all(out, folder)
    assert (picture.at_s, sound.at_s) == pytest.approx((0.12, 0.0), abs=1e-6)
    assert Path(picture.file).read_bytes() == (movie.parent / "picture.touch").read_bytes()
    expected = amplitudes_n(sound_medium())
    expected[:200] *= np.float32(0.5)
    expected[300:400] = 0
    assert (amplitudes_n(tf.decode(sound.file)) == expected).all()
    assert expected.any()


def test_a_muted_track_is_left_out_and_a_track_may_start_before_the_movie(
    movie: Path, tmp_path: Path
) -> None:
    edits = edit_list(
        tmp_path / "e.json", movie, tmp_path, picture={"is_muted": True}, sound={"offset_ms": -250}
    )
    out = tmp_path / "edited.mp4"
    done = edit_timeline(movie, out, edits)
    assert any("picture: muted" in note for note in done.notes)
    (sound,) = demux_all(out, tmp_path)
    assert sound.at_s == pytest.approx(-0.25, abs=1e-6)
    assert Path(sound.file).read_bytes() == (movie.parent / "sound.touch").read_bytes()


def test_a_touch_file_is_edited_without_a_movie(tmp_path: Path) -> None:
    source, out = tmp_path / "picture.touch", tmp_path / "edited.touch"
    tf.encode(picture_medium(), source, LOSSLESS)
    edits = edit_list(tmp_path / "e.json", source, tmp_path, picture={"strengths": runs_of((5, 60, 80))})
    edit_timeline(source, out, edits, LOSSLESS)
    expected = amplitudes_n(picture_medium())
    expected[5:60] *= np.float32(0.8)
    assert amplitudes_n(tf.decode(out)) == pytest.approx(expected, rel=1e-6)
    nothing = edit_list(tmp_path / "n.json", source, tmp_path, picture={"strengths": runs_of((0, 75, 0))})
    done = edit_timeline(source, tmp_path / "silent.touch", nothing)
    assert not amplitudes_n(tf.decode(tmp_path / "silent.touch")).any()
    assert any("The result is empty" in note for note in done.notes)
    shifted = edit_list(tmp_path / "s.json", source, tmp_path, picture={"offset_ms": 5})
    with pytest.raises(InvalidArgument, match="an offset of 5 ms"):
        edit_timeline(source, tmp_path / "new.touch", shifted)
    assert not (tmp_path / "new.touch").exists()


def test_several_tracks_need_a_movie(movie: Path, tmp_path: Path) -> None:
    edits = edit_list(tmp_path / "e.json", movie, tmp_path)
    with pytest.raises(InvalidArgument, match="2 tracks of touch"):
        edit_timeline(movie, tmp_path / "new.touch", edits)
    alone = edit_list(tmp_path / "a.json", movie, tmp_path, sound={"is_muted": True})
    edit_timeline(movie, tmp_path / "new.touch", alone)
    assert (tmp_path / "new.touch").read_bytes() == (movie.parent / "picture.touch").read_bytes()
    silent = edit_list(
        tmp_path / "m.json", movie, tmp_path, sound={"is_muted": True}, picture={"is_muted": True}
    )
    with pytest.raises(InvalidArgument, match="every track muted"):
        edit_timeline(movie, tmp_path / "silent.mp4", silent)


def test_edits_of_another_file_are_reported(movie: Path, tmp_path: Path) -> None:
    edits = edit_list(tmp_path / "e.json", movie, tmp_path, sound={"crc32": 1})
    document = json.loads(edits.read_text())
    document["tracks"] = document["tracks"][1:]
    edits.write_text(json.dumps(document))
    notes = edit_timeline(movie, tmp_path / "new.mp4", edits).notes
    assert any("another file of the same frames" in note for note in notes)
    assert any("picture: not in the edit list" in note for note in notes)


WRONG: list[tuple[dict[str, Any], str]] = [
    ({"frames": 601}, "601 frames at 200 Hz"),
    ({"rate_hz": 100}, "600 frames at 100 Hz"),
    ({"name": "smell"}, "one of picture, sound"),
    ({"name": "picture"}, "each track once"),
    ({"strengths": runs_of((0, 700, 50))}, "at most 600 frames"),
    ({"strengths": runs_of((0, 9, 50), (8, 12, 50))}, "without overlap"),
    ({"strengths": runs_of((0, 9, 201))}, "from 0 to 200"),
    ({"strengths": runs_of((9, 9, 50))}, "from 10 to"),
    ({"strengths": {"all": 50}}, "an array"),
    ({"offset_ms": 0.5}, "an integer"),
    ({"is_muted": "no"}, "true or false"),
    ({"loudness": 3}, "not known"),
]


@pytest.mark.parametrize(("values", "message"), WRONG)
def test_a_list_that_does_not_fit_is_one_error(
    values: dict[str, Any], message: str, movie: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    edits, out = edit_list(tmp_path / "e.json", movie, tmp_path, sound=values), tmp_path / "new.mp4"
    assert _exit_code(["edit", str(movie), str(out), "--timeline", str(edits)]) in (1, 2)
    error = capsys.readouterr().err
    assert message in error and "e.json" in error and len(error.strip().splitlines()) == 1
    assert not out.exists()


@pytest.mark.parametrize("text", ["", "[]", "{", '{"format": "other"}', '{"format": "touchfield-timeline"}'])
def test_another_file_is_no_edit_list(text: str, movie: Path, tmp_path: Path) -> None:
    (tmp_path / "e.json").write_text(text)
    with pytest.raises(SourceError):
        edit_timeline(movie, tmp_path / "new.mp4", tmp_path / "e.json")


def test_options_of_regions_are_refused_with_a_timeline(movie: Path, tmp_path: Path) -> None:
    edits = edit_list(tmp_path / "e.json", movie, tmp_path)
    command = ["edit", str(movie), str(tmp_path / "new.mp4"), "--timeline", str(edits)]
    assert _exit_code([*command, "--operator", "erase"]) == 2
    assert _exit_code([*command, "--frames", "0:2"]) == 2


def test_every_track_of_a_movie_is_extracted(movie: Path, tmp_path: Path) -> None:
    for n, name in enumerate(("picture", "sound"), 1):
        demux(movie, tmp_path / f"{name}.touch", name)
        assert (tmp_path / f"{name}.touch").read_bytes() == (movie.parent / f"{name}.touch").read_bytes()
        demux(movie, tmp_path / "number.touch", str(n))
        assert (tmp_path / "number.touch").read_bytes() == (movie.parent / f"{name}.touch").read_bytes()

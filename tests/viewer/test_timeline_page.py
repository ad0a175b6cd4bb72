"""The page of a movie's touch: edited by keys alone, saved, applied by the command, and played in time."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import ROOT, drive, needs_browser, step
from timeline_sync import measure_sync

import touchfield as tf
from timeline_makers import (
    BEATS_S,
    LOSSLESS,
    SECONDS,
    picture_medium,
    write_film,
    write_movie,
    write_sounding_film,
)
from touchfield.cli.main import _exit_code
from touchfield.codec.vibration import MAX_RELATIVE_ERROR
from touchfield.errors import InvalidArgument, SourceError
from touchfield.network.demux import demux_all
from touchfield.pipeline.array_medium import array_drives
from touchfield.pipeline.stream import stream_device
from touchfield.viewer.browser import empty_page
from touchfield.viewer.timeline import empty_timeline, timeline_page

_ACCESS = (ROOT / "tests" / "viewer" / "timeline_access.js").read_text(encoding="utf-8")
TIMES_S = tuple(0.0101 + 0.02 * n for n in range(140))


@pytest.fixture(scope="module")
def movie(tmp_path_factory: pytest.TempPathFactory) -> Path:
    pytest.importorskip("av", reason="movies need the extra video")
    return write_movie(tmp_path_factory.mktemp("timeline"))


def keys(*names: str) -> list[dict[str, Any]]:
    return [step("press", key=name) for name in names]


def focus(name: str) -> dict[str, Any]:
    return step("run", code=f"document.getElementById({name!r}).focus()")


LEVELS = f"{list(TIMES_S)}.map((t) => {{ const l = touchfield.levelAt(t); return [l.strong, l.weak]; }})"
EDITED = "JSON.stringify(touchfield.state().edits)"


# -- without a browser -------------------------------------------------------------------------------------


def test_a_movie_for_an_array_gets_the_timeline(movie: Path, tmp_path: Path) -> None:
    page = tf.view(movie)
    assert [(row["name"], row["frames"]) for row in page.figures["tracks"]] == [
        ("picture", 75), ("sound", 600),
    ]  # fmt: skip
    assert 'id="given-timeline">{"movie": "both.mp4"' in page.html
    assert "given-timeline" not in tf.view(movie, page="field").html
    matroska = write_movie(tmp_path, "both.mkv")
    figures = tf.view(matroska).figures
    assert len(figures["tracks"]) == 2 and "not every browser plays .mkv" in figures["movie_notes"][-1]
    stream = movie.parent / "picture.touch"
    assert tf.view(stream).html.count("given-timeline") == 0
    assert "given-timeline" in tf.view(stream, page="timeline").html
    for wrong in ({"page": "film"}, {"page": "timeline", "devices": ("tactsuit-x40",)}):
        with pytest.raises(InvalidArgument):
            tf.view(movie, **wrong)
    with pytest.raises(InvalidArgument, match="a medium in memory"):
        tf.view(picture_medium(), page="timeline")
    with pytest.raises(InvalidArgument, match="an address"):
        tf.view("https://example.org/both.mp4", page="timeline")
    golden = ROOT / "conformance" / "v1" / "touch-mask.touch"
    with pytest.raises(InvalidArgument, match="touch for an array"):
        tf.view(golden, page="timeline")


def test_a_movie_that_no_browser_opens_is_refused(movie: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.tasks.timeline_view.MAX_MOVIE_BYTES", movie.stat().st_size - 1)
    for page in ("timeline", "field"):
        with pytest.raises(SourceError, match="a movie that fits into a page"):
            tf.view(movie, page=page)


def test_foreign_texts_stay_within_their_element() -> None:
    given = {"movie": "</script><script>alert(1)</script>", "tracks": []}
    page = timeline_page(given, [np.zeros((2, 3), np.uint8)], (b"abc", '"><script>'))
    assert page.count("<script") == empty_timeline().count("<script")
    within = re.search(r'id="given-timeline">(.*?)</script>', page)
    assert within and json.loads(within[1]) == given


# -- in a browser ------------------------------------------------------------------------------------------


@needs_browser
def test_edits_by_keys_alone_are_what_the_command_writes(movie: Path, tmp_path: Path) -> None:
    """The levels that the page plays are those of the movie that the command makes of its edit list."""
    page = tf.view(movie).save(tmp_path / "both.html")
    select = [focus("strip-1"), *keys("Home", "PageDown", *["Shift+ArrowRight"] * 10)]
    result = drive(
        tmp_path,
        step("goto", url=page.as_uri()),
        step("until", code="document.getElementById('video').readyState > 1"),
        *select,
        *keys("ArrowDown", "ArrowDown", "ArrowDown", "Escape"),
        *[focus("strip-0"), *keys("ArrowDown", "m", "Control+z")],
        step("fill", id="offset-0", value="200"),
        *keys("Enter"),
        step("text", id="spoken"),
        focus("strip-2"),
        *keys("Home", "End", "Shift+PageUp", "ArrowUp", "Control+z", "Control+y", "t"),
        step("text", id="spoken"),
        step("run", code=EDITED),
        step("run", code=LEVELS),
        step("run", code=_ACCESS),
        step("download", id="save", key="Enter", path=str(tmp_path / "both.edits.json")),
        step("run", code="touchfield.state().isSaved"),
        step("text", id="command"),
        step("run", code="document.querySelectorAll('#edits tbody tr').length"),
    )
    assert result.errors == []
    assert [url for url in result.requests if not url.startswith(("file:", "blob:", "data:"))] == []
    spoken, here, edits, levels, access, name, is_saved, command, rows = (
        answer for answer in result.answers if answer is not None
    )
    assert spoken == "picture: 200 milliseconds" and "sound" in here and "percent" in here
    picture, sound = json.loads(edits)
    assert picture["offsetMs"] == 200 and not picture["isMuted"]
    assert {"first": 200, "stop": 280, "percent": 70} in sound["runs"]
    assert picture["runs"][0] == {"first": 0, "stop": picture["runs"][0]["stop"], "percent": 90}
    assert sound["runs"][-1]["percent"] == 110 and sound["runs"][-1]["stop"] == 600
    assert name == "both.edits.json" and is_saved
    assert rows == len(picture["runs"]) + len(sound["runs"]) + 1, "and the offset"
    assert command == "touchfield edit both.mp4 both-edited.mp4 --timeline both.edits.json"
    assert access["faint"] == access["unnamed"] == access["small"] == [] and access["controls"] > 25
    out = tmp_path / "both-edited.mp4"
    options = ["--timeline", str(tmp_path / "both.edits.json"), "--mode", "lossless"]
    assert _exit_code(["edit", str(movie), str(out), *options]) == 0
    (force, vibration), (written_force, written_vibration) = np.array(levels).T, levels_of(out, tmp_path).T
    assert force == pytest.approx(written_force, abs=0.003), "the page has 8 bits"
    assert vibration == pytest.approx(written_vibration, rel=MAX_RELATIVE_ERROR, abs=0.003)
    assert np.ptp(force) > 0.5 < np.ptp(vibration)


def levels_of(movie: Path, folder: Path) -> np.ndarray:
    """The strongest force and vibration of a movie at `TIMES_S`, as fractions of a full drive."""
    levels = np.zeros((len(TIMES_S), 2))
    for track in demux_all(movie, folder):
        with tf.open_stream(track.file) as opened:
            drives = array_drives(opened, stream_device(opened))
            for n, time_s in enumerate(TIMES_S):
                frame = int(np.floor((time_s - track.at_s) * drives.rate_hz + 1e-6))
                if 0 <= frame < len(drives):
                    levels[n] = np.maximum(levels[n], [part.max() for part in drives.parts(frame)])
    return levels


@needs_browser
def test_an_onset_of_the_movie_is_an_effect_of_the_pad(movie: Path, tmp_path: Path) -> None:
    """How late the effects are is printed; `bench/bench_timeline.py` has the limit."""
    errors = measure_sync(tmp_path, tf.view(movie).save(tmp_path / "both.html"), BEATS_S, SECONDS)
    late_ms = np.abs(errors.clock_ms)
    print(f"p95 {np.percentile(late_ms, 95):.1f} ms, worst {late_ms.max():.1f} ms")
    assert errors.missed == 0 and len(errors.clock_ms) == len(BEATS_S)


@needs_browser
def test_a_phone_in_the_dark_shows_everything(tmp_path: Path) -> None:
    """A ``.touch`` file alone plays without a movie."""
    tf.encode(picture_medium(), tmp_path / "picture.touch", LOSSLESS)
    page = tf.view(tmp_path / "picture.touch", page="timeline").save(tmp_path / "picture.html")
    phone = {"viewport": {"width": 390, "height": 844}, "hasTouch": True, "isMobile": True}
    result = drive(
        tmp_path,
        step("goto", url=page.as_uri()),
        step("run", code=_ACCESS),
        step("click", id="play"),
        step("until", code="touchfield.state().time > 0.3 && Math.max(...touchfield.state().drives) > 0"),
        colorScheme="dark",
        **phone,
    )
    access = result.answers[1]
    assert result.errors == [] and access["faint"] == access["unnamed"] == [] and access["excess"] <= 0


@needs_browser
def test_an_edit_list_is_opened_again_or_refused(movie: Path, tmp_path: Path) -> None:
    page = tf.view(movie).save(tmp_path / "both.html")
    rows = [
        {"name": "sound", "frames": 600, "rate_hz": 200, "crc32": 0, "is_muted": True, "offset_ms": -40,
         "strengths": [{"first_frame": 10, "stop_frame": 30, "percent": 150}]},
    ]  # fmt: skip
    good = {"format": "touchfield-timeline", "version": 1, "movie": "both.mp4", "tracks": rows}
    wrong = {**good, "tracks": [{**rows[0], "frames": 601}]}
    for name, document in (("good", good), ("wrong", wrong)):
        (tmp_path / f"{name}.json").write_text(json.dumps(document))
    opened = (
        "new Promise((done) => setTimeout(() => done([JSON.stringify(touchfield.state().edits), "
        "document.getElementById('fault').textContent]), 500))"
    )
    result = drive(
        tmp_path,
        step("goto", url=page.as_uri()),
        step("attach", id="file", file=str(tmp_path / "good.json")),
        step("run", code=opened),
        step("attach", id="file", file=str(tmp_path / "wrong.json")),
        step("run", code=opened),
    )
    (edits, fault), (same, refusal) = result.answers[2], result.answers[4]
    assert not fault and json.loads(edits)[1] == {
        "isMuted": True, "offsetMs": -40, "runs": [{"first": 10, "stop": 30, "percent": 150}],
    }  # fmt: skip
    assert same == edits and "wrong.json cannot be opened" in refusal and "601 frames" in refusal


@needs_browser
@pytest.mark.parametrize("has_sound", [True, False])
def test_a_picture_that_the_browser_lacks_is_stated_in_words(tmp_path: Path, has_sound: bool) -> None:
    """Chromium plays the sound of such a movie, without an error and without a picture."""
    pytest.importorskip("av", reason="movies need the extra video")
    write = write_sounding_film if has_sound else write_film
    movie = write_movie(tmp_path, film=write(tmp_path / "film.mp4", codec="mpeg4"))
    result = drive(
        tmp_path,
        step("goto", url=tf.view(movie).save(tmp_path / "both.html").as_uri()),
        step("until", code="!document.getElementById('notice').hidden"),
        step("text", id="notice"),
        step("text", id="pictureless"),
        step("run", code="getComputedStyle(document.getElementById('video')).display"),
        step("click", id="play"),
        step("until", code="touchfield.state().time > 0.3 && Math.max(...touchfield.state().drives) > 0"),
    )
    notice, instead, display = result.answers[2:5]
    assert "lacks the codec" in notice and "H.264" in notice and display == "none"
    assert instead.startswith(
        "No picture: sound and touch play" if has_sound else "No picture: the touch plays"
    )


@needs_browser
def test_a_picture_that_is_shown_has_no_notice(movie: Path, tmp_path: Path) -> None:
    result = drive(
        tmp_path,
        step("goto", url=tf.view(movie).save(tmp_path / "both.html").as_uri()),
        step("until", code="document.getElementById('video').readyState > 1"),
        step(
            "run",
            code="[document.getElementById('notice').hidden, document.getElementById('pictureless').hidden]",
        ),
    )
    assert result.answers[2] == [True, True]


def test_the_page_of_fields_is_another_one() -> None:
    assert "given-timeline" not in empty_page() and "decoder" not in empty_timeline()

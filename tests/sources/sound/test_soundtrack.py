"""The samples of a movie's sound are where its time stamps put them, whatever the movie holds."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from soundtrack_makers import pictures, strokes, write_movie
from touchfield.arrays import Float32s
from touchfield.errors import SourceError
from touchfield.sources.sound.analysis import RATE_HZ, sound_features
from touchfield.sources.sound.soundtrack import Soundtrack, movie_tracks

TIMES_S = (0.4, 1.1, 1.7)


def read(path: Path) -> tuple[Soundtrack, Float32s]:
    sound = Soundtrack(path)
    return sound, np.concatenate(list(sound.blocks()))


def onsets_s(samples: Float32s) -> list[float]:
    return [onset.time_s for onset in sound_features([samples]).onsets]


@pytest.mark.parametrize(
    ("suffix", "codec", "rate_hz", "layout", "channels"),
    [
        (".mp4", "aac", 48000, "stereo", 2),
        (".mkv", "pcm_s16le", 44100, "mono", 1),
        (".mkv", "flac", 192000, "stereo", 2),
        (".mkv", "pcm_s16le", 48000, "7.1", 8),
        (".avi", "pcm_s16le", 44100, "stereo", 2),
        (".mov", "pcm_s16le", 8000, "mono", 1),
    ],
)
def test_sound_is_read_at_its_time(
    suffix: str, codec: str, rate_hz: int, layout: str, channels: int, tmp_path: Path
) -> None:
    made = strokes(TIMES_S, 2.0, rate_hz, channels)
    path = write_movie(
        tmp_path / f"a{suffix}", pictures(50), made, sound_hz=rate_hz, codecs=("mpeg4", codec), layout=layout
    )
    sound, samples = read(path)
    found = [sound.start_s + time_s for time_s in onsets_s(samples)]
    assert found == pytest.approx(TIMES_S, abs=0.005)
    assert sound.duration_s == pytest.approx(2, abs=0.06) and sound.notes == ()


def test_channel_of_low_frequencies_counts(tmp_path: Path) -> None:
    made = np.zeros((6, 48000), np.float32)
    made[3] = 0.5 * np.sin(2 * np.pi * 60 * np.arange(48000) / 48000)
    path = write_movie(tmp_path / "a.mkv", (), made, codecs=("mpeg4", "pcm_s16le"), layout="5.1")
    assert sound_features([read(path)[1]]).levels.max() == pytest.approx(0.5 / 6, rel=0.2)


@pytest.mark.parametrize("sound_s", [0.7, -0.3])
def test_sound_with_another_start(sound_s: float, tmp_path: Path) -> None:
    """The picture starts at 2 s, as in a cut movie."""
    path = write_movie(
        tmp_path / "a.mkv", pictures(50), strokes(TIMES_S, 2.0), picture_s=2.0, sound_s=2.0 + sound_s
    )
    sound, _ = read(path)
    assert sound.start_s == pytest.approx(2.0 + sound_s, abs=0.03)


def test_gap_in_the_time_stamps_is_silent_and_noted(tmp_path: Path) -> None:
    path = write_movie(
        tmp_path / "a.mkv", pictures(25), strokes(TIMES_S, 2.0), codecs=("mpeg4", "pcm_s16le"), gap=(0.9, 1.5)
    )
    sound, samples = read(path)
    assert onsets_s(samples) == pytest.approx([0.4, 2.6, 3.2], abs=0.005)
    assert sound.notes == ("The sound has gaps of 1.5 s, silent in the touch.",)


def test_gap_that_the_sound_does_not_justify_is_an_error(tmp_path: Path) -> None:
    path = write_movie(
        tmp_path / "a.mkv", pictures(25), strokes(TIMES_S, 2.0), codecs=("mpeg4", "pcm_s16le"), gap=(0.9, 9e4)
    )
    with pytest.raises(SourceError, match=r"a\.mkv: found 9e\+04 s of gaps in 0\.\d+ s of sound"):
        read(path)


def test_samples_that_go_back_in_time_are_left_out_and_noted(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No writer makes such stamps, so frames of a good movie get them."""
    path = write_movie(tmp_path / "a.mkv", (), strokes(TIMES_S, 2.0), codecs=("mpeg4", "pcm_s16le"))
    frames = Soundtrack._frames

    def with_old_stamps(*arguments: Any) -> Iterator[Any]:
        for frame in frames(*arguments):
            if frame.pts * frame.time_base >= 0.9:
                frame.pts -= round(0.5 / frame.time_base)
            yield frame

    monkeypatch.setattr(Soundtrack, "_frames", with_old_stamps)
    sound, samples = read(path)
    assert len(sound.notes) == 1 and sound.notes[0].endswith(
        " s of the sound overlap others in time: left out."
    )
    assert len(samples) == sound.duration_s * RATE_HZ and sound.duration_s == pytest.approx(1.5, abs=0.06)


def test_damaged_packets_are_silent_and_counted(tmp_path: Path) -> None:
    path = write_movie(
        tmp_path / "a.mkv", (), strokes(TIMES_S, 2.0), codecs=("mpeg4", "flac"), layout="stereo"
    )
    data = bytearray(path.read_bytes())
    rng = np.random.default_rng(1)
    first = len(data) // 3
    data[first : first + 4000] = rng.integers(0, 256, 4000, np.uint8).tobytes()
    (tmp_path / "b.mkv").write_bytes(data)
    sound, samples = read(tmp_path / "b.mkv")
    assert any("damaged" in note or "gaps" in note for note in sound.notes), sound.notes
    assert 0 < len(samples) <= 2.1 * RATE_HZ


def test_movie_without_sound_is_an_error(tmp_path: Path) -> None:
    path = write_movie(tmp_path / "a.mp4", pictures(5))
    assert movie_tracks(path).sounds == 0
    with pytest.raises(SourceError, match="no sound in the file"):
        read(path)

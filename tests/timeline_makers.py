"""Movies with two tracks of touch for a vest: a picture that moves at 25 Hz, and beats at 200 Hz."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np

import touchfield as tf
from touchfield.medium.medium import VibrationFrame
from touchfield.network.mux import TimedStream, mux_streams

COLUMNS, ROWS = 4, 5
GRID: Final = tf.Grid((COLUMNS, ROWS, 1), (0.06, 0.06, 0.0252), (-0.09, -0.12, 0.0))
AXES: Final = "x right, y up, z towards the viewer"
FORCE_MAX_N: Final = 3.3
PICTURE_HZ, SOUND_HZ = 25.0, 200.0
BEATS_S: Final = (0.4, 0.9, 1.4, 1.9, 2.4)
BEAT_S: Final = 0.12
SECONDS: Final = 3.0
LOSSLESS: Final = tf.EncodeSpec(
    device="tactsuit-x40", touch=tf.codec.TouchSpec(mode="lossless", effort="fast"), allow_empty=True
)


def picture_medium(seconds: float = SECONDS) -> tf.HapticMedium:
    """A column of forces that goes from left to right, once a second, up to 2 N."""
    frames = round(seconds * PICTURE_HZ)
    forces_n = np.zeros((frames, *GRID.shape, 3), np.float32)
    for n in range(frames):
        forces_n[n, int(COLUMNS * n / PICTURE_HZ) % COLUMNS, :, 0, 2] = 1 + np.sin(n / 7)
    medium = tf.HapticMedium.from_array(forces_n, GRID, PICTURE_HZ, AXES)
    return replace(medium, tags=("symbolic", "picture"))


def sound_medium(seconds: float = SECONDS, beats_s: tuple[float, ...] = BEATS_S) -> tf.HapticMedium:
    """Beats of the two lower rows, 3 N at 70 Hz, and no force."""
    frames = round(seconds * SOUND_HZ)
    is_beat = np.zeros(frames, np.bool_)
    for beat_s in beats_s:
        is_beat[round(beat_s * SOUND_HZ) : round((beat_s + BEAT_S) * SOUND_HZ)] = True
    places = np.array([(x, y, 0) for x in range(COLUMNS) for y in range(2)], np.int32)
    beat = VibrationFrame(
        GRID, places, np.full(len(places), 3.0, np.float32), np.full(len(places), 70.0, np.float32)
    )
    still = VibrationFrame.empty(GRID)
    empty = tf.ForceField.empty(GRID)
    return tf.HapticMedium(
        GRID, SOUND_HZ, frames, lambda n: empty, AXES, tags=("symbolic", "sound"),
        vibration=lambda n: beat if is_beat[n] else still,
    )  # fmt: skip


def write_film(path: Path, seconds: float = SECONDS, codec: str = "libvpx-vp9") -> Path:
    """A movie whose picture is a bright square that moves once a second, and flashes at beats."""
    import av

    with av.open(str(path), "w") as sink:
        track: Any = sink.add_stream(codec, rate=25)
        track.width, track.height, track.pix_fmt = 160, 96, "yuv420p"
        for n in range(round(25 * seconds)):
            picture = np.full((96, 160, 3), 40, np.uint8)
            if any(beat_s <= n / 25 < beat_s + BEAT_S for beat_s in BEATS_S):
                picture[:] = 120
            left = int(120 * (n % 25) / 25)
            picture[30:66, left : left + 36] = (235, 160, 40)
            sink.mux(track.encode(av.VideoFrame.from_ndarray(picture)))
        sink.mux(track.encode(None))
    return path


def write_sounding_film(path: Path, codec: str) -> Path:
    """A movie of `write_film` with a track of sound beside the picture."""
    import av

    silent = write_film(path.with_stem("silent"), codec=codec)
    with av.open(str(silent)) as source, av.open(str(path), "w") as sink:
        picture = sink.add_stream_from_template(source.streams.video[0])
        sound: Any = sink.add_stream("aac", rate=48000, layout="mono")
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = picture
                sink.mux(packet)
        frame = av.AudioFrame.from_ndarray(
            np.sin(np.arange(round(48000 * SECONDS)) / 20, dtype=np.float32)[None],
            format="fltp",
            layout="mono",
        )
        frame.sample_rate = 48000
        sink.mux(sound.encode(frame))
        sink.mux(sound.encode(None))
    return path


def write_movie(
    folder: Path, name: str = "both.mp4", sound_at_s: float = 0.0, film: Path | None = None
) -> Path:
    """A movie of three seconds with the tracks picture and sound, of `film` or one whose picture is VP9."""
    film = film or write_film(folder / "film.mp4")
    for medium, stem in ((picture_medium(), "picture"), (sound_medium(), "sound")):
        tf.encode(medium, folder / f"{stem}.touch", LOSSLESS)
    streams = [
        TimedStream(folder / "picture.touch", 0.0, "picture"),
        TimedStream(folder / "sound.touch", sound_at_s, "sound"),
    ]
    mux_streams(film, streams, folder / name)
    return folder / name

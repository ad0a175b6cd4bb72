"""Movies with sound, made by PyAV: their pictures, sounds and time stamps are those that a test asks for."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

SOUND_HZ = 48000
CLOCK_HZ = 60000


def pictures(count: int, size: tuple[int, int] = (64, 48)) -> list[NDArray[np.uint8]]:
    """A bright square that moves over grey, uint8 [height, width, 3] each."""
    width, height = size
    frames = []
    for n in range(count):
        frame = np.full((height, width, 3), 90, np.uint8)
        left = 4 + 2 * n % (width - 16)
        frame[16:28, left : left + 10] = (250, 240, 60)
        frames.append(frame)
    return frames


def strokes(
    times_s: Sequence[float], seconds: float, rate_hz: int = SOUND_HZ, channels: int = 2
) -> NDArray[np.float32]:
    """Bursts of noise that decay in 40 ms, over a quiet hiss, float32 [channels, samples]."""
    rng = np.random.default_rng(3)
    out = 1e-4 * rng.normal(size=int(seconds * rate_hz))
    for time_s in times_s:
        start = round(time_s * rate_hz)
        length = min(int(0.3 * rate_hz), len(out) - start)
        out[start : start + length] += (
            0.2 * rng.normal(size=length) * np.exp(-np.arange(length) / (0.04 * rate_hz))
        )
    return np.repeat(np.clip(out, -1, 1)[None], channels, 0).astype(np.float32)


def write_movie(
    path: Path,
    frames: Sequence[NDArray[np.uint8]] = (),
    sound: NDArray[np.float32] | None = None,
    *,
    rate_hz: int = 25,
    picture_times_s: Sequence[float] | None = None,
    picture_s: float = 0.0,
    sound_s: float = 0.0,
    sound_hz: int = SOUND_HZ,
    codecs: tuple[str, str] = ("mpeg4", "aac"),
    layout: str = "stereo",
    gap: tuple[float, float] | None = None,
    has_b_frames: bool = False,
) -> Path:
    """Write a movie; `gap` (at, of) seconds is added to the time stamps of the sound from a time on."""
    av = pytest.importorskip("av")
    with av.open(str(path), "w") as container:
        picture = container.add_stream(codecs[0], rate=rate_hz) if frames else None
        track = container.add_stream(codecs[1], rate=sound_hz, layout=layout) if sound is not None else None
        if picture is not None:
            picture.height, picture.width = frames[0].shape[:2]
            picture.pix_fmt, picture.time_base = "yuv420p", Fraction(1, CLOCK_HZ)
            picture.codec_context.time_base = Fraction(1, CLOCK_HZ)
            picture.codec_context.max_b_frames = 2 if has_b_frames else 0
        for n, values in enumerate(frames):
            time_s = n / rate_hz if picture_times_s is None else picture_times_s[n]
            frame = av.VideoFrame.from_ndarray(values, format="rgb24")
            frame.pts, frame.time_base = round((picture_s + time_s) * CLOCK_HZ), Fraction(1, CLOCK_HZ)
            container.mux(picture.encode(frame))
        if picture is not None:
            container.mux(picture.encode(None))
        if track is not None and sound is not None:
            for packet in _sound_packets(av, track, sound, sound_hz, layout):
                shift_s = sound_s
                if gap is not None and packet.pts is not None and packet.pts * packet.time_base >= gap[0]:
                    shift_s += gap[1]
                packet.pts += round(shift_s / packet.time_base)
                packet.dts = packet.pts
                container.mux(packet)
    return path


def _sound_packets(av: Any, track: Any, sound: NDArray[np.float32], rate_hz: int, layout: str) -> list[Any]:
    fifo, packets = av.AudioFifo(), []
    form = track.codec_context.format.name
    interleaved = np.ascontiguousarray(sound.T).reshape(1, -1)
    frame = av.AudioFrame.from_ndarray(interleaved, format="flt", layout=layout)
    frame.sample_rate, frame.pts, frame.time_base = rate_hz, 0, Fraction(1, rate_hz)
    resampler = av.AudioResampler(format=form, layout=layout, rate=rate_hz)
    for resampled in resampler.resample(frame):
        fifo.write(resampled)
    size = track.codec_context.frame_size or 1024
    while (part := fifo.read(size, partial=True)) is not None:
        packets += track.encode(part)
        if fifo.samples == 0:
            break
    return [*packets, *track.encode(None)]

"""Measures touch from movies: onsets in the decoded file against what was mixed, time, memory and bytes.

    python bench/bench_watch.py [--quick] [--seconds S] [--seeds N] [--movie S]

Sounds with known onsets (``onset_signals.py``: clicks, drums, plucked notes over a chord, impacts in
speech-like noise) become the AAC sound of a movie of 64 x 48 pixels in MP4. `watch` makes its touch, `demux`
takes it out, and an onset in the file is the first of the frames in which the lowest row of the vest
vibrates. F-measures have a window of 50 ms; errors are those of the pairs within it. The baseline is a
threshold of the energy. librosa's `onset_detect`, with its default options, takes part if it is installed;
both read the sound before AAC.

The long movie is ffmpeg's `testsrc2`, 1920 x 1080 at 25 Hz, H.264 with B-frames, with impacts in noise.
`watch` runs in a process of its own: processor time of all its threads, wall-clock time, and peak memory,
also for a quarter of the movie, as memory must not grow.
"""

from __future__ import annotations

import subprocess
import sys
import time
from fractions import Fraction
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from shutil import which
from tempfile import TemporaryDirectory

import numpy as np

import onset_signals
from machine import Bar, Figures, at_least, at_most, bench, figure
from onset_signals import RATE_HZ, SIGNALS, Score, Signal, energy_onsets, score
from peak_memory import peak_bytes
from touchfield.arrays import Float64s
from touchfield.network.demux import demux
from touchfield.network.opening import open_stream
from touchfield.tasks.watch import watch

SIZE = (1920, 1080)
FIRST_SEED = 100  # the detector's numbers were chosen with seeds 0 and 1
TIMEOUT_S = 1800


def write_movie(path: Path, signal: Signal) -> None:
    """Write a small movie with a sound."""
    import av

    with av.open(str(path), "w") as container:
        picture = container.add_stream("mpeg4", rate=25)
        picture.width, picture.height, picture.pix_fmt = 64, 48, "yuv420p"
        track = container.add_stream("aac", rate=RATE_HZ, layout="mono")
        for n in range(round(len(signal.samples) / RATE_HZ * 25)):
            frame = av.VideoFrame.from_ndarray(np.full((48, 64, 3), n % 255, np.uint8), format="rgb24")
            container.mux(picture.encode(frame))
        container.mux(picture.encode(None))
        samples = np.clip(signal.samples, -1, 1).astype(np.float32)
        for start in range(0, len(samples), 1024):
            part = np.ascontiguousarray(samples[None, start : start + 1024])
            sound = av.AudioFrame.from_ndarray(part, format="fltp", layout="mono")
            sound.sample_rate, sound.pts, sound.time_base = RATE_HZ, start, Fraction(1, RATE_HZ)
            container.mux(track.encode(sound))
        container.mux(track.encode(None))


def onsets_in(movie: Path, folder: Path) -> Float64s:
    """Seconds after the first picture at which the lowest row begins to vibrate, in the movie with touch."""
    both, path = folder / "both.mp4", folder / "sound.touch"
    watch(movie, both)
    start_s = demux(both, path, "sound").at_s - demux(both, folder / "picture.touch", "picture").at_s
    with open_stream(path) as stream:
        medium = stream.medium
        assert medium.vibration is not None
        frames = (medium.vibration(i).positions for i in range(len(medium)))
        is_on = np.array([bool((positions[:, 1] == 0).any()) for positions in frames])
    starts = np.flatnonzero(is_on & ~np.concatenate([[False], is_on[:-1]]))
    return np.asarray(start_s + starts / medium.rate_hz)


def librosa_onsets(samples: Float64s) -> Float64s | None:
    """Seconds by librosa's defaults; None if it is not installed."""
    if find_spec("librosa") is None:
        return None
    librosa = import_module("librosa")
    half = librosa.resample(samples.astype(np.float32), orig_sr=RATE_HZ, target_sr=22050)
    return np.asarray(librosa.onset.onset_detect(y=half, sr=22050, units="time"))


def rates(scores: list[Score]) -> Figures:
    """Return means over the seeds, and the errors of all pairs."""
    errors_ms = 1e3 * np.abs(np.concatenate([one.errors_s for one in scores]))
    return {
        "F": float(np.mean([one.f_measure for one in scores])),
        "precision": float(np.mean([one.precision for one in scores])),
        "recall": float(np.mean([one.recall for one in scores])),
        "error median, ms": float(np.median(errors_ms)) if len(errors_ms) else None,
        "error p95, ms": float(np.percentile(errors_ms, 95)) if len(errors_ms) else None,
        "error max, ms": float(errors_ms.max()) if len(errors_ms) else None,
    }


def onsets(seconds: float, seeds: int) -> Figures:
    """Score each kind of sound by each method."""
    figures: Figures = {}
    for name, make in SIGNALS.items():
        scores: dict[str, list[Score]] = {"touch": [], "energy": [], "librosa": []}
        for seed in range(FIRST_SEED, FIRST_SEED + seeds):
            signal = make(np.random.default_rng(seed), seconds)
            with TemporaryDirectory() as folder:
                movie = Path(folder) / "movie.mp4"
                write_movie(movie, signal)
                scores["touch"].append(score(onsets_in(movie, Path(folder)), signal.onsets_s))
            scores["energy"].append(score(energy_onsets(signal.samples), signal.onsets_s))
            peer = librosa_onsets(signal.samples)
            if peer is not None:
                scores["librosa"].append(score(peer, signal.onsets_s))
        figures[name] = {method: rates(rows) for method, rows in scores.items() if rows}
    return figures


def long_movie(seconds: float) -> Figures:
    """Watch a long movie and a quarter of it, each in a process of its own; empty without ffmpeg."""
    if which("ffmpeg") is None:
        return {}
    figures: Figures = {"size": "{} x {}".format(*SIZE)}
    for title, duration_s in (("whole", seconds), ("quarter", seconds / 4)):
        with TemporaryDirectory() as folder:
            movie = Path(folder) / "movie.mp4"
            _write_long(movie, duration_s)
            command = [sys.executable, __file__, "--child", str(movie), str(Path(folder) / "both.mp4")]
            start_s = time.perf_counter()
            text = subprocess.run(
                command, check=True, capture_output=True, text=True, timeout=TIMEOUT_S
            ).stdout
            wall_s = time.perf_counter() - start_s
            spent_s, peak, picture, sound = map(float, text.split())
            figures[title] = {
                "movie, s": duration_s, "wall, s": wall_s, "processor, s": spent_s,
                "peak memory, MB": peak / 1e6, "picture, touch bytes": int(picture),
                "sound, touch bytes": int(sound),
            }  # fmt: skip
    return figures


def _write_long(movie: Path, seconds: float) -> None:
    signal = onset_signals.scene(np.random.default_rng(FIRST_SEED), seconds)
    sound = (np.clip(signal.samples, -1, 1) * 32767).astype("<i2").tobytes()
    source = "testsrc2=size={}x{}:rate=25:duration={}".format(*SIZE, seconds)
    subprocess.run(
        ["ffmpeg", "-v", "error", "-f", "s16le", "-ar", str(RATE_HZ), "-ac", "1", "-i", "-", "-f", "lavfi",
         "-i", source, "-map", "1:v", "-map", "0:a", "-c:v", "libx264", "-preset", "ultrafast", "-bf", "2",
         "-pix_fmt", "yuv420p", "-c:a", "aac", "-y", str(movie)],
        input=sound, check=True, timeout=TIMEOUT_S,
    )  # fmt: skip


def _child(movie: str, out: str) -> None:
    done = watch(movie, out)
    sizes = (done.figures["picture_touch_bytes"], done.figures["sound_touch_bytes"])
    print(time.process_time(), peak_bytes(), *sizes)


def measure(seconds: float, seeds: int, movie: float) -> Figures:
    """Measure onsets and a long movie."""
    return {"onsets": onsets(seconds, seeds), "movie": long_movie(movie)}


def bars(figures: Figures) -> list[Bar]:
    """Require onsets in time, and better ones than the baseline's."""
    rows = []
    for name in SIGNALS:
        ours = figure(figures, "onsets", name, "touch")
        rows.append(
            at_most(f"{name}: onset error in the file, p95", figure(ours, "error p95, ms"), 10.0, "ms")
        )
        baseline = figure(figures, "onsets", name, "energy", "F")
        rows.append(at_least(f"{name}: F-measure, against the energy's", figure(ours, "F"), baseline))
    if figures["movie"]:
        whole = figure(figures, "movie", "whole")
        spent = figure(whole, "processor, s") / figure(whole, "movie, s")
        quarter_mb = figure(figures, "movie", "quarter", "peak memory, MB")
        rows.append(at_most("processor time on two cores, over the duration", spent, 1.0))
        rows.append(
            at_most(
                "wall-clock time over the duration", figure(whole, "wall, s") / figure(whole, "movie, s"), 0.5
            )
        )
        rows.append(
            at_most("growth of memory from a quarter", figure(whole, "peak memory, MB") / quarter_mb, 1.1)
        )
    return rows


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        _child(*sys.argv[2:])
    else:
        bench(
            "watch", __doc__, measure, bars, without=("*wall*", "*processor*", "*memory*"),
            seconds=(40.0, 6.0), seeds=(3, 1), movie=(120.0, 4.0),
        )  # fmt: skip

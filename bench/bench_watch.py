"""Measures touch from movies: onsets in the decoded file against what was mixed, approaches in depth against
what was drawn, time, memory and bytes.

    python bench/bench_watch.py [--quick] [--seconds S] [--seeds N] [--movie S] [--scenes N]

Sounds with known onsets (``onset_signals.py``: clicks, drums, plucked notes over a chord, impacts in
speech-like noise) become the AAC sound of a movie of 64 x 48 pixels in MP4. `watch` makes its touch, `demux`
takes it out, and an onset in the file is the first of the frames in which the lowest row of the vest
vibrates. F-measures have a window of 50 ms; errors are those of the pairs within it. The baseline is a
threshold of the energy. librosa's `onset_detect`, with its default options, takes part if it is installed;
both read the sound before AAC.

The long movie is ffmpeg's `testsrc2`, 1920 x 1080 at 25 Hz, H.264 with B-frames, with impacts in noise.
`watch` runs in a process of its own: processor time of all its threads, wall-clock time, and peak memory,
also for a quarter of the movie, as memory must not grow.

Depth: scenes of four seconds with the noise of a Kinect (``approach_scenes.py``), seen by 4 x 4 motors. An
approach is felt if a motor where the thing is starts while the time to contact is 4 s or less. A false drive
is a start of a motor elsewhere, in a scene that stands or from which something goes away, and in one where
something passes or the camera turns a start above the strength of what is merely near. Such weak starts are
counted beside it (`near starts a minute`). The baseline is plain nearness: a motor is on while a twelfth of
its region is nearer than 2 m. The movie with depth is
`testsrc2`, 1280 x 720 at 25 Hz, H.264, with depth of the same size in FFV1 as of a renderer, four seconds of
a moving ramp that repeat. (With the noise of a sensor, decoding FFV1 alone took 55 to 95 ms of a processor
for a frame of that size; the bar cannot be met then.)
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
from approach_scenes import MAKERS, RATE_HZ as DEPTH_HZ, REGIONS, SIZE as DEPTH_SIZE, Scene
from machine import Bar, Figures, at_least, at_most, bench, figure, not_measured
from onset_signals import RATE_HZ, SIGNALS, Score, Signal, energy_onsets, score
from peak_memory import peak_bytes
from touchfield.arrays import Bools, Float32s, Float64s
from touchfield.medium import Grid
from touchfield.network.demux import demux
from touchfield.network.opening import open_stream
from touchfield.sources.depth.movie_depth import MovieDepth
from touchfield.tasks.watch import WatchSpec, watch
from touchfield.tasks.watch_depth import MAX_NEAR, depth_features

SIZE = (1920, 1080)
FIRST_SEED = 100  # the detector's numbers were chosen with seeds 0 and 1
TIMEOUT_S = 1800
DEPTH_MOVIE_SIZE = (1280, 720)
DEPTH_CLIP_S = 4.0
FIRST_SCENE = 1000  # the rule's numbers were chosen with scenes 0 to 19
BASELINE_M = 2.0


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
    """Watch a long movie and a quarter of it, each in a process of its own."""
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


def _write_long(movie: Path, seconds: float, size: tuple[int, int] = SIZE) -> None:
    signal = onset_signals.scene(np.random.default_rng(FIRST_SEED), seconds)
    sound = (np.clip(signal.samples, -1, 1) * 32767).astype("<i2").tobytes()
    source = "testsrc2=size={}x{}:rate=25:duration={}".format(*size, seconds)
    subprocess.run(
        ["ffmpeg", "-v", "error", "-f", "s16le", "-ar", str(RATE_HZ), "-ac", "1", "-i", "-", "-f", "lavfi",
         "-i", source, "-map", "1:v", "-map", "0:a", "-c:v", "libx264", "-preset", "ultrafast", "-bf", "2",
         "-pix_fmt", "yuv420p", "-c:a", "aac", "-y", str(movie)],
        input=sound, check=True, timeout=TIMEOUT_S,
    )  # fmt: skip


# -- depth -------------------------------------------------------------------------------------------------
def motor_drives(scene: Scene) -> Float32s:
    """Return the drives of the motors, float32 [frames, rows, columns]."""
    times_s = np.arange(len(scene.depths_m)) / DEPTH_HZ
    depth = MovieDepth("scene", DEPTH_SIZE, times_s, (), lambda n, v, u: scene.depths_m[n][v, u])
    rows, columns = REGIONS
    half = (DEPTH_SIZE[0] / 1000, DEPTH_SIZE[1] / 1000, 0.1)
    grid = Grid.over_box([-x for x in half], half, (columns, rows, 1))
    return depth_features(depth, grid, DEPTH_SIZE).drives


def baseline_drives(scene: Scene) -> Float32s:
    """Return plain nearness: 1 while a twelfth of a region is nearer than `BASELINE_M`."""
    (rows, columns), (width, height) = REGIONS, DEPTH_SIZE
    depths = np.stack(scene.depths_m)
    is_near = ((depths > 0) & (depths < BASELINE_M)).reshape(
        len(depths), rows, height // rows, columns, width // columns
    )
    return np.asarray(is_near.mean(axis=(2, 4)) >= 1 / 12, np.float32)


def starts(is_on: Bools) -> Bools:
    """Return where motors start, bool [frames, rows, columns]; what is on in frame 0 has not started."""
    return np.asarray(is_on & ~np.concatenate([is_on[:1], is_on[:-1]]))


def approaches(scenes: int) -> Figures:
    """Score the rule and the baseline on scenes of each kind."""
    figures: Figures = {}
    for method, make_drives in (("touch", motor_drives), ("nearness", baseline_drives)):
        felt, false, near, lags = 0, 0, 0, list[int]()
        kinds: Figures = {}
        for kind, make in MAKERS.items():
            before = false
            for seed in range(FIRST_SCENE, FIRST_SCENE + scenes):
                scene = make(np.random.default_rng(seed))
                drives = make_drives(scene)
                start = starts(drives > 0)
                if scene.regions is not None:
                    hits = np.flatnonzero((start & scene.regions)[scene.first_frame :].any(axis=(1, 2)))
                    felt += len(hits) > 0
                    lags += hits[:1].tolist()
                    false += int((start & ~scene.regions).sum())
                elif kind in ("passing", "turning"):
                    strong = starts(drives > MAX_NEAR)
                    false += int(strong.sum())
                    near += int(start.sum() - strong.sum())
                else:
                    false += int(start.sum())
            kinds[kind] = 60 * DEPTH_HZ * (false - before) / (scenes * len(scene.depths_m))
        minutes = len(MAKERS) * scenes * len(scene.depths_m) / DEPTH_HZ / 60
        figures[method] = {
            "approaches": scenes, "felt in their region": felt / scenes,
            "frames from 4 s to contact, median": float(np.median(lags)) if lags else None,
            "false drives a minute": false / minutes, "near starts a minute": near / minutes,
            "false drives a minute, by kind": kinds,
        }  # fmt: skip
    return figures


def depth_movie(seconds: float) -> Figures:
    """Watch a movie with depth in a process of its own."""
    with TemporaryDirectory() as folder:
        movie, depth = Path(folder) / "movie.mp4", Path(folder) / "depth.mkv"
        _write_depth_movie(movie, depth, seconds)
        command = [
            sys.executable,
            __file__,
            "--child",
            str(movie),
            str(Path(folder) / "both.mp4"),
            str(depth),
        ]
        start_s = time.perf_counter()
        text = subprocess.run(command, check=True, capture_output=True, text=True, timeout=TIMEOUT_S).stdout
        wall_s = time.perf_counter() - start_s
        spent_s, peak, _, _, touch = map(float, text.split())
        return {
            "size": "{} x {}".format(*DEPTH_MOVIE_SIZE), "movie, s": seconds, "wall, s": wall_s,
            "processor, s": spent_s, "peak memory, MB": peak / 1e6, "depth, touch bytes": int(touch),
        }  # fmt: skip


def _write_depth_movie(movie: Path, depth: Path, seconds: float) -> None:
    _write_long(movie, seconds, DEPTH_MOVIE_SIZE)
    width, height = DEPTH_MOVIE_SIZE
    ramp = np.tile(np.linspace(1500, 4000, width), (height, 1))
    counts = range(round(min(DEPTH_CLIP_S, seconds) * 25))
    frames = [(ramp + 200 * np.sin(n / 15)).astype("<u2").tobytes() for n in counts]
    clip = depth.with_name("clip.mkv")
    raw = ["-f", "rawvideo", "-pix_fmt", "gray16le", "-s", f"{width}x{height}", "-r", "25", "-i", "-"]
    code = ["-c:v", "ffv1", "-level", "3", "-slices", "4", "-y", str(clip)]
    subprocess.run(["ffmpeg", "-v", "error", *raw, *code], input=b"".join(frames), check=True,
                   timeout=TIMEOUT_S)  # fmt: skip
    repeats = ["-stream_loop", "-1", "-i", str(clip), "-t", str(seconds), "-c", "copy", "-y", str(depth)]
    subprocess.run(["ffmpeg", "-v", "error", *repeats], check=True, timeout=TIMEOUT_S)


def _child(movie: str, out: str, depth: str | None = None) -> None:
    done = watch(movie, out, WatchSpec(depth=depth))
    sizes = [done.figures[f"{name}_touch_bytes"] for name in done.figures["tags"]]
    print(time.process_time(), peak_bytes(), *sizes)


def measure(seconds: float, seeds: int, movie: float, scenes: int) -> Figures:
    """Measure onsets, approaches, a long movie, and one with depth; without ffmpeg no movies."""
    figures: Figures = {"onsets": onsets(seconds, seeds), "approaches": approaches(scenes)}
    if which("ffmpeg") is None:
        reason = not_measured("ffmpeg is missing: apt install ffmpeg, brew install ffmpeg")
        return figures | {"movie": reason, "depth movie": reason}
    return figures | {"movie": long_movie(movie), "depth movie": depth_movie(movie)}


def bars(figures: Figures) -> list[Bar]:
    """Require onsets in time, approaches in their region, and better ones than the baselines'."""
    rows = []
    for name in SIGNALS:
        ours = figure(figures, "onsets", name, "touch")
        rows.append(
            at_most(f"{name}: onset error in the file, p95", figure(ours, "error p95, ms"), 10.0, "ms")
        )
        baseline = figure(figures, "onsets", name, "energy", "F")
        rows.append(at_least(f"{name}: F-measure, against the energy's", figure(ours, "F"), baseline))
    ours, baseline = (figure(figures, "approaches", method) for method in ("touch", "nearness"))
    rows.append(at_least("approaches felt in their region", figure(ours, "felt in their region"), 0.95))
    rows.append(at_most("false drives a minute", figure(ours, "false drives a minute"), 1.0))
    rows.append(
        at_most(
            "false drives, against plain nearness",
            figure(ours, "false drives a minute"),
            figure(baseline, "false drives a minute"),
        )
    )
    if isinstance(figures["depth movie"], dict):
        wall_s = figure(figures, "depth movie", "wall, s") / figure(figures, "depth movie", "movie, s")
        rows.append(at_most("wall-clock time with depth over the duration", wall_s, 0.5))
    if isinstance(figures["movie"], dict):
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
            seconds=(40.0, 6.0), seeds=(3, 1), movie=(120.0, 4.0), scenes=(24, 2),
        )  # fmt: skip

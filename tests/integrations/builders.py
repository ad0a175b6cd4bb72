"""What the tests of `integrations/` share: their folder, the compilers, and forces as Python has them."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf

ROOT = Path(__file__).resolve().parents[2]
INTEGRATIONS, GOLDEN = ROOT / "integrations", ROOT / "conformance" / "v1"
FAULTY = ROOT / "conformance" / "faulty" / "cut-at-end.touch"
VOXELS = ("touch-block", "touch-lossless", "vibration-touch")
OBJECTS = ("objects-touch", "objects-touch-deforming")
ATOL_N = 1e-5


def needs(*programs: str) -> pytest.MarkDecorator:
    """Skips where a program of the system is absent, and says which."""
    absent = [name for name in programs if shutil.which(name) is None]
    return pytest.mark.skipif(bool(absent), reason=f"there is no {' and no '.join(absent)} here")


def made(name: str, folder: Path, *words: str) -> Path:
    """Builds an integration by its own Makefile, into another folder than its own."""
    command = ["make", "-C", str(INTEGRATIONS / name), f"BUILD={folder}", *words]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=plain())
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def plain() -> dict[str, str]:
    """The environment without what a `make` around this one left in it."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith("MAKE") and name != "MFLAGS"
    }


def run(*words: object, given: str = "") -> subprocess.CompletedProcess[str]:
    """A program and what it printed."""
    return subprocess.run([str(w) for w in words], input=given, capture_output=True, text=True, check=False)


def stream_of(name: str) -> Path:
    """A golden file."""
    return GOLDEN / f"{name}.touch"


def some_points(name: str, count: int) -> np.ndarray:
    """Points in and a little around the medium, float64 [count, 3]; the same every time."""
    with tf.open_stream(stream_of(name)) as stream:
        low, high = stream.grid.box_m
    around = 0.05 * (high - low)
    return np.random.default_rng(len(name)).uniform(low - around, high + around, (count, 3))


def python_forces(name: str, frames: np.ndarray, points: np.ndarray, most_n: float = np.inf) -> np.ndarray:
    """F at each point and its own frame, cut to what the medium says and to `most_n`."""
    with tf.open_stream(stream_of(name)) as stream:
        head = stream.reader.head
        sampler = tf.FieldSampler(stream.scene or stream.medium)
        forces = sampler.force_n(frames / head.rate_hz, points).astype(np.float64)
        limit = min(head.force_max_n, most_n)
    sizes = np.linalg.norm(forces, axis=-1, keepdims=True)
    return forces * np.minimum(1.0, limit / np.maximum(sizes, 1e-30))


def frame_count(name: str) -> int:
    """Frames of a golden file."""
    with tf.open_stream(stream_of(name)) as stream:
        return stream.reader.head.frame_count


def asked_at(name: str, program: list[object], count: int = 200) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Frames, points, and forces of a program that answers lines `seconds x y z`; a quarter of them at a
    frame.
    """
    places = np.random.default_rng(3).uniform(0, frame_count(name) - 1, count)
    places[::4] = np.round(places[::4])
    places.sort()
    points = some_points(name, count)
    with tf.open_stream(stream_of(name)) as stream:
        seconds = places / stream.reader.head.rate_hz
    lines = "".join(f"{t!r} {x!r} {y!r} {z!r}\n" for t, (x, y, z) in zip(seconds.tolist(), points.tolist()))
    done = run(*program, given=lines)
    assert done.returncode == 0, done.stderr
    return places, points, np.array([line.split() for line in done.stdout.splitlines()], np.float64)

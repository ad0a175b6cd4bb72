"""Helpers of the integration tests: folders, compilers, and reference forces from Python."""

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
    """Skip if a program of the system is missing, and name it."""
    absent = [name for name in programs if shutil.which(name) is None]
    return pytest.mark.skipif(bool(absent), reason=f"there is no {' and no '.join(absent)} here")


def build_integration(name: str, folder: Path, *arguments: str) -> Path:
    """Build an integration with its Makefile in another folder."""
    command = ["make", "-C", str(INTEGRATIONS / name), f"BUILD={folder}", *arguments]
    done = subprocess.run(command, capture_output=True, text=True, check=False, env=clean_environment())
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def clean_environment() -> dict[str, str]:
    """The environment without the variables of an outer `make`."""
    return {
        name: value for name, value in os.environ.items() if not name.startswith("MAKE") and name != "MFLAGS"
    }


def run(*arguments: object, stdin: str = "") -> subprocess.CompletedProcess[str]:
    """Run a program; return its result with its output."""
    return subprocess.run(
        [str(w) for w in arguments], input=stdin, capture_output=True, text=True, check=False
    )


def stream_of(name: str) -> Path:
    """A golden file."""
    return GOLDEN / f"{name}.touch"


def some_points(name: str, count: int) -> np.ndarray:
    """Reproducible random points in and slightly around the medium, float64 [count, 3]."""
    with tf.open_stream(stream_of(name)) as stream:
        low, high = stream.grid.box_m
    margin_m = 0.05 * (high - low)
    return np.random.default_rng(len(name)).uniform(low - margin_m, high + margin_m, (count, 3))


def python_forces(name: str, frames: np.ndarray, points: np.ndarray, max_n: float = np.inf) -> np.ndarray:
    """F at each point and frame, limited to the medium's maximum and to `max_n`."""
    with tf.open_stream(stream_of(name)) as stream:
        head = stream.reader.head
        sampler = tf.FieldSampler(stream.scene or stream.medium)
        forces = sampler.force_n(frames / head.rate_hz, points).astype(np.float64)
        limit = min(head.force_max_n, max_n)
    sizes = np.linalg.norm(forces, axis=-1, keepdims=True)
    return forces * np.minimum(1.0, limit / np.maximum(sizes, 1e-30))


def frame_count(name: str) -> int:
    """Frames of a golden file."""
    with tf.open_stream(stream_of(name)) as stream:
        return stream.reader.head.frame_count


def query_program(
    name: str, program: list[object], count: int = 200
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Query a program by lines `seconds x y z`; return frames (every fourth whole), points, forces."""
    frames = np.random.default_rng(3).uniform(0, frame_count(name) - 1, count)
    frames[::4] = np.round(frames[::4])
    frames.sort()
    points = some_points(name, count)
    with tf.open_stream(stream_of(name)) as stream:
        seconds = frames / stream.reader.head.rate_hz
    lines = "".join(f"{t!r} {x!r} {y!r} {z!r}\n" for t, (x, y, z) in zip(seconds.tolist(), points.tolist()))
    done = run(*program, stdin=lines)
    assert done.returncode == 0, done.stderr
    return frames, points, np.array([line.split() for line in done.stdout.splitlines()], np.float64)

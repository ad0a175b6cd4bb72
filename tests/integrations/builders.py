"""Helpers of the integration tests: folders, compilers, and reference forces from Python."""

from __future__ import annotations

import os
import runpy
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.medium.trace import Trace
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec

ROOT = Path(__file__).resolve().parents[2]
INTEGRATIONS, GOLDEN = ROOT / "integrations", ROOT / "conformance" / "v1"
FAULTY = ROOT / "conformance" / "faulty" / "cut-at-end.touch"
VOXELS = ("touch-block", "touch-lossless", "vibration-touch")
OBJECTS = ("objects-touch", "objects-touch-deforming")
ATOL_N = 1e-9
_PLATE = runpy.run_path(str(INTEGRATIONS / "plate.py"))
make_plate, press_plate = _PLATE["make_plate"], _PLATE["press_plate"]
TICKS = 300
ENGINE = {"loop": True, "wall_n_per_m": 800.0, "damping_n_s_per_m": 0.5, "coupling_n_per_m": 0.0}
"""Options of `player_forces` that are the same however far ahead an engine decodes.

The stable damping and coupling would follow the stiffest frame that is decoded so far.
"""


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


def slow_way(name: str, count: int) -> np.ndarray:
    """A polygon through points of the medium that returns to the middle after each, float64 [count, 3]."""
    corners = some_points(name, count // 50 + 2)
    corners[1::2] = some_points(name, 1000).mean(axis=0)
    at = np.linspace(0, len(corners) - 1, count)
    return np.stack([np.interp(at, np.arange(len(corners)), corners[:, n]) for n in range(3)], axis=1)


def ticks_of(*program: object, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Run a program that reads `x y z` a tick, and prints forces; then those on the way to zero.

    Returns both, newtons, float64 [count, 3] and [released, 3].
    """
    done = run(*program, stdin="".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in points.tolist()))
    assert done.returncode == 0, done.stderr
    forces_n = np.array([line.split() for line in done.stdout.splitlines()], np.float64)
    return forces_n[: len(points)], forces_n[len(points) :]


def player_forces(
    path: Path,
    positions_m: np.ndarray,
    peak_n: float | None = None,
    loop: bool = False,
    speed: float = 1.0,
    **options: object,
) -> tuple[np.ndarray, np.ndarray]:
    """Positions, metres, and forces, newtons, of the Python player, one a tick of 1 ms, float64 [n, 3].

    The positions differ from the given ones in their last digits: the simulated hand adds up its time.

    The device states its greatest force alone: that of the medium, or `peak_n`. `options` are those of
    `RenderSpec`.
    """
    with tf.open_stream(path) as stream:
        medium = stream.scene or stream.medium
        profile = replace(
            device("phantom-omni"),
            axes=medium.axes,
            force_max_n=peak_n or stream.reader.head.force_max_n,
            force_continuous_n=None,
            damping_n_s_per_m=None,
            friction_n=None,
            inertia_kg=None,
            delay_ms=None,
            resolution_mm=None,
        )
        trace = Trace(np.arange(len(positions_m)) * 1e-3, positions_m, None)
        spec = RenderSpec(up="lattice", **options)
        run = run_offline(
            medium,
            profile,
            lambda: SimHand(trace),
            spec,
            seconds=1e-3 * len(positions_m),
            loop=loop,
            speed=speed,
        )
    log = run.log[: len(positions_m)]
    return log["position_m"], log["force_n"]


def assert_resists(forces_n: np.ndarray, peak_n: float) -> None:
    """Check that the plate pushes the hand back, within the peak and the slew limit, from zero on."""
    sizes_n = np.linalg.norm(forces_n, axis=1)
    assert (forces_n[400:, 2] > 0.5).all()  # the field itself would push it down, or not at all
    assert sizes_n.max() <= peak_n
    assert np.linalg.norm(np.diff(forces_n, axis=0), axis=1).max() <= peak_n / 0.005 * 1e-3


def slide_on_plate() -> np.ndarray:
    """The hand of `press_plate`, which moves 10 mm along x from tick 500 on."""
    points = press_plate()
    points[500:, 0] += np.linspace(0, 0.01, 500)
    return points


def assert_has_friction(forces_n: np.ndarray, mu: float) -> None:
    """Check that friction resists the hand of `slide_on_plate`."""
    sliding_n = forces_n[600:1000]
    np.testing.assert_allclose(sliding_n[:, 0], -mu * sliding_n[:, 2], rtol=0.05)


def assert_is_released(forces_n: np.ndarray, last_n: np.ndarray, peak_n: float) -> None:
    """Check that a stop brings the force from `last_n` to zero, without a step."""
    steps_n = np.linalg.norm(np.diff(forces_n, axis=0, prepend=last_n[None]), axis=1)
    assert len(forces_n) > 2
    assert not forces_n[-1].any()
    assert steps_n.max() <= peak_n / 0.005 * 1e-3 * (1 + 1e-9)

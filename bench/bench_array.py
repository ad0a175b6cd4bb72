"""Frames of a stored field as an array of actuators shows them, and `FieldSampler.at` while frames go by.

    python bench/bench_array.py

The field is a wavy shell in a lattice of 64^3 that moves a little from frame to frame; conversion is from the decoded
field to the drives, on an array of 8 x 8 and on a pin display of 60 x 40. The sampler is asked at 1 kHz, as frames
of 64^3 go by at 30 a second; each takes several milliseconds to be made.
"""

from __future__ import annotations

import time
from types import SimpleNamespace
from typing import Any

import numpy as np

from machine import keep
from touchfield.devices import device
from touchfield.job.array_medium import array_medium
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.sampler import FieldSampler

FRAMES, RATE_HZ, N = 40, 30.0, 64
BARS_MS = {"tactile-vest-8x8": 5.0, "graphiti": 20.0}
BAR_CALL_MS = 1.0


def fields() -> list[ForceField]:
    """Frames of the shell."""
    grid = Grid((N, N, N), (0.002,) * 3, (-0.063,) * 3)
    x, y, z = np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij")
    made = []
    for frame in range(FRAMES):
        surface = 0.01 * np.sin(60 * x + 0.1 * frame) * np.cos(50 * y)
        depth = np.clip(1 - np.abs(z - surface) / 0.008, 0, None)
        made.append(ForceField.from_dense(grid, depth[..., None] * np.array([0.1, 0.2, 2.0])))
    return made


def conversion(made: list[ForceField], name: str) -> dict[str, Any]:
    """Milliseconds of a frame of drives."""
    medium = HapticMedium.from_frames(made, RATE_HZ, "x right, y up, z towards the viewer")
    stream: Any = SimpleNamespace(
        medium=medium, reader=SimpleNamespace(head=SimpleNamespace(device_type=1, force_max_n=3.0))
    )
    drives = array_medium(stream, device(name)).drives()
    drives.drives(0)
    times = []
    for frame in range(1, 21):
        began = time.perf_counter()
        drives.drives(frame)
        times.append(1e3 * (time.perf_counter() - began))
    median = float(np.median(times))
    return {"lattice": device(name).lattice, "median_ms": median, "worst_ms": max(times), "bar_ms": BARS_MS[name],
            "met": median <= BARS_MS[name]}  # fmt: skip


def calls(made: list[ForceField]) -> dict[str, Any]:
    """Milliseconds of `at`, called at 1 kHz while each frame is made in its turn."""

    def make(frame: int) -> ForceField:
        return ForceField.from_dense(made[frame].grid, made[frame].to_dense())

    sampler = FieldSampler(HapticMedium(made[0].grid, RATE_HZ, FRAMES, make, "x right, y up, z towards the viewer"))
    times, began, making = [], time.perf_counter(), time.perf_counter()
    make(1)
    making = time.perf_counter() - making
    sampler.at(0.0, 0.0, 0.0, 0.0)
    began = time.perf_counter()
    while (now := time.perf_counter() - began) < (FRAMES - 1) / RATE_HZ:
        sampler.at(now, 0.001, 0.002, 0.003)
        times.append(1e3 * (time.perf_counter() - began - now))
        time.sleep(0.001)
    worst = max(times)
    return {"calls": len(times), "median_ms": float(np.median(times)), "worst_ms": worst,
            "frame_made_in_ms": 1e3 * making,
            "bar_ms": BAR_CALL_MS, "met": worst <= BAR_CALL_MS}  # fmt: skip


def main() -> None:
    """Measure, print and keep."""
    made = fields()
    told: dict[str, Any] = {name: conversion(made, name) for name in BARS_MS}
    told["sampler_at"] = calls(made)
    for name, figures in told.items():
        print(name, figures)
    keep("array", told)


if __name__ == "__main__":
    main()

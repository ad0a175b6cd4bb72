"""Measures the time to convert fields to drives of actuators, and the latency of the force query
`FieldSampler.at`.

    python bench/bench_array.py [--quick] [--frames N]

The field is a wavy shell on a lattice of 64^3 samples that moves slightly from frame to frame. Conversion is
timed from the decoded field to the drives of an 8 x 8 tactile vest and of a 60 x 40 pin display. The latency
of `FieldSampler.at` is measured at 1 kHz while frames of 64^3 samples are produced at 30 per second;
producing one frame takes several milliseconds.
"""

from __future__ import annotations

from time import perf_counter, sleep
from types import SimpleNamespace
from typing import Any

import numpy as np

from machine import Bar, Figures, at_least, at_most, bench, figure, timed
from touchfield.devices import device
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline.array_medium import array_drives
from touchfield.render.sampler import FieldSampler

RATE_HZ, N = 30.0, 64
AXES = "x right, y up, z towards the viewer"
ARRAYS = ("tactile-vest-8x8", "graphiti")


def fields(count: int) -> list[ForceField]:
    """Return `count` frames of the moving shell."""
    grid = Grid((N, N, N), (0.002,) * 3, (-0.063,) * 3)
    x, y, z = np.meshgrid(*(grid.axis_m(n) for n in range(3)), indexing="ij")
    frames = []
    for frame in range(count):
        surface = 0.01 * np.sin(60 * x + 0.1 * frame) * np.cos(50 * y)
        depth = np.clip(1 - np.abs(z - surface) / 0.008, 0, None)
        frames.append(ForceField.from_dense(grid, depth[..., None] * np.array([0.1, 0.2, 2.0])))
    return frames


def conversion(frames: list[ForceField], name: str) -> Figures:
    """Time the conversion of one frame to drives, in milliseconds."""
    medium = HapticMedium.from_frames(frames, RATE_HZ, AXES)
    stream: Any = SimpleNamespace(
        medium=medium, reader=SimpleNamespace(head=SimpleNamespace(device_type=1, force_max_n=3.0))
    )
    drives = array_drives(stream, device(name))
    numbers = iter(range(len(frames)))
    return {
        "lattice": device(name).lattice,
        **timed(lambda: drives.drives(next(numbers)), runs=len(frames) - 1),
    }


def calls(frames: list[ForceField]) -> Figures:
    """Time each call of `at` at 1 kHz while frames are produced, in milliseconds."""

    def make(frame: int) -> ForceField:
        return ForceField.from_dense(frames[frame].grid, frames[frame].to_dense())

    sampler = FieldSampler(
        HapticMedium(frames[0].grid, RATE_HZ, len(frames), make, "x right, y up, z towards the viewer")
    )
    took_ms, making = [], timed(lambda: make(1), runs=3)["min_ms"]
    sampler.at(0.0, 0.0, 0.0, 0.0)
    began = perf_counter()
    while (now := perf_counter() - began) < (len(frames) - 1) / RATE_HZ:
        sampler.at(now, 0.001, 0.002, 0.003)
        took_ms.append(1e3 * (perf_counter() - began - now))
        sleep(0.001)
    percentiles = {f"p{q:g}_ms": float(np.percentile(took_ms, q)) for q in (50, 99.9)}
    return {"calls": len(took_ms), **percentiles, "worst_ms": max(took_ms), "frame_made_in_ms": making}


def measure(frames: int) -> Figures:
    """Measure the drives of both arrays, and the latency of the sampler in playback."""
    shell_frames = fields(frames)
    return {**{name: conversion(shell_frames, name) for name in ARRAYS}, "sampler_at": calls(shell_frames)}


def bars(figures: Figures) -> list[Bar]:
    """Require conversion in real time, and no call that waits for a frame."""
    vest, pins = (figure(figures, name, "median_ms") for name in ARRAYS)
    rate = None if pins is None else 1e3 / pins
    return [
        at_most("a frame of drives of 8 x 8, median", vest, 5.0, "ms"),
        at_most("a frame of drives of 60 x 40, median", pins, 20.0, "ms"),
        at_least("frames of 60 x 40", rate, RATE_HZ, "/s"),
        at_most(
            "a call of the sampler at 1 kHz, worst", figure(figures, "sampler_at", "worst_ms"), 1.0, "ms"
        ),
    ]


if __name__ == "__main__":
    bench("array", __doc__, measure, bars, frames=(40, 8))

"""Measures the time of a tick of the servo with a tool of many points in place of a single point.

    python bench/bench_tool.py [--quick] [--points N] [--seconds S]

The tool is a sphere of 20 mm radius with `--points` (10,000) points. It moves in a circle through a soft ball
and turns, with about half of its points in contact. There are three media: one frame of voxels, a blend of
two different frames, and a scene of four moving bodies.

The kernel `tick`, with all limits, is called at 1 kHz for `--seconds`. The program waits between the calls as
the servo does, so that caches are as cold as in use. Wall time and processor time are given, because other
work on the machine lengthens the wall time.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace

import numpy as np

from machine import Bar, Figures, at_most, bench
from touchfield.compute.native import native
from touchfield.devices import device
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
from touchfield.render.block import Memory, aligned, layout
from touchfield.render.block.frames import FramePart, field_bytes, frame_bytes, write_field, write_frame
from touchfield.render.spec import RenderSpec, write_parameters
from touchfield.render.tool import Tool, tool_bytes, write_tool

GRID = Grid((128, 128, 128), (0.00125,) * 3, (-0.08,) * 3)
AXES = "x right, y up, z towards the user"


def ball(radius: float, stiffness: float) -> ForceField:
    """Return a soft ball on the lattice."""
    axes = [GRID.origin_m[n] + GRID.spacing_m[n] * np.arange(128, dtype=np.float32) for n in range(3)]
    p = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    distance = np.maximum(np.linalg.norm(p, axis=-1, keepdims=True), 1e-6)
    return ForceField.from_dense(
        GRID, (stiffness * np.maximum(radius - distance, 0) * p / distance).astype(np.float32)
    )


def block(tool: Tool, fields: list[ForceField], parts: list[list[FramePart]]) -> tuple[Memory, list[int]]:
    """Return a memory block with fields, frames and the tool, and the frames' offsets.

    The parts of a frame refer to a field by its number.
    """
    pools = [CellPool.of(field) for field in fields]
    first = aligned(layout.RECEIVER.itemsize + tool_bytes(tool))
    starts = first + np.cumsum([0, *map(field_bytes, pools)])
    frame_size = frame_bytes(max(map(len, parts)))
    frames = [int(starts[-1]) + n * frame_size for n in range(len(parts))]
    memory = Memory.empty(frames[-1] + frame_size)
    for at, pool in zip(starts, pools, strict=False):
        write_field(memory, int(at), pool)
    for frame, frame_parts in zip(frames, parts, strict=True):
        placed = [replace(part, field_at=int(starts[part.field_at])) for part in frame_parts]
        write_frame(memory, frame, placed, math.inf if len(frame_parts) == 1 else 50.0)
    spec = RenderSpec(tool=tool)
    write_parameters(memory, spec, replace(device("sigma.7"), axes=AXES), 0.3, 0.5, AXES)
    write_tool(memory, layout.RECEIVER.itemsize, tool)
    return memory, frames


def run(memory: Memory, frames: list[int], blend: float, seconds: float) -> dict[str, float]:
    """Return percentiles of a tick at 1 kHz, in wall and processor milliseconds."""
    orientation, torque = memory.receiver["grip"]["orientation"], memory.receiver["state"]["torque"]["output"]
    count = round(1000 * seconds)
    took, spent = np.empty(count), np.empty(count)
    contact_ticks = 0
    deadline = time.perf_counter()
    for n in range(count):
        angle = 2 * math.pi * n / 1000
        half = 0.3 * angle
        orientation[:] = (
            math.cos(half),
            0.6 * math.sin(half),
            0.0,
            0.8 * math.sin(half),
        )
        x, y, z = 0.045 * math.cos(angle), 0.045 * math.sin(angle), 0.01 * math.sin(3 * angle)
        deadline += 0.001
        while (remaining_s := deadline - time.perf_counter()) > 0:
            time.sleep(remaining_s)
        began, began_thread = time.perf_counter_ns(), time.thread_time_ns()
        force = native.tick(memory.bytes, frames[0], frames[-1], blend, x, y, z, 0.001)
        spent[n], took[n] = time.thread_time_ns() - began_thread, time.perf_counter_ns() - began
        contact_ticks += force != (0.0, 0.0, 0.0) and bool(torque.any())
        deadline = max(deadline, time.perf_counter() - 0.001)
    assert contact_ticks > 0.8 * count, "the tool is to be in contact nearly all the while"
    figures = {}
    for name, times in (("clock", took), ("processor", spent)):
        for percent, quantile in (("p50", 0.5), ("p99", 0.99), ("p99_9", 0.999)):
            figures[f"{name}_{percent}_ms"] = 1e-6 * float(np.quantile(times, quantile))
    return figures


def measure(points: int, seconds: float) -> Figures:
    """Time the ticks of each medium."""
    tool = Tool.sphere(0.02, points)
    rng = np.random.default_rng(2)
    big, other = ball(0.05, 300.0), ball(0.052, 310.0)

    def body(shift: float) -> list[FramePart]:
        q = rng.normal(size=(4, 4))
        q /= np.linalg.norm(q, axis=1, keepdims=True)
        positions = [(0.01 * n - 0.015 + shift, 0.0, 0.0) for n in range(4)]
        return [FramePart(n % 2, tuple(q[n % 2]), positions[n % 2], (0.1, 0, 0, 0, 0, 1.0)) for n in range(4)]

    cases: dict[str, tuple[list[ForceField], list[list[FramePart]], float]] = {
        "one frame": ([big], [[FramePart.voxels(0)]], 0.0),
        "blend of two frames": ([big, other], [[FramePart.voxels(0)], [FramePart.voxels(1)]], 0.4),
        "four bodies that move": ([ball(0.04, 300.0), ball(0.038, 300.0)], [body(0.0), body(0.002)], 0.4),
    }
    rows: dict[str, dict[str, float]] = {}
    for name, (fields, parts, blend) in cases.items():
        memory, frames = block(tool, fields, parts)
        run(memory, frames, blend, 0.2)
        rows[name] = run(memory, frames, blend, seconds)
    return {"points": points, "seconds": seconds, "rows": rows}


def bars(figures: Figures) -> list[Bar]:
    """Limit a tick to half of the period of 1 kHz."""
    return [
        at_most(f"a tick, {name}, p99.9 {label}", row[f"{key}_p99_9_ms"], 0.5, "ms")
        for name, row in figures["rows"].items()
        for key, label in (("clock", "by the clock"), ("processor", "of the processor"))
    ]


if __name__ == "__main__":
    bench("tool", __doc__, measure, bars, points=(10_000, 2_000), seconds=(20.0, 1.0))

"""Segments that encoders are compared on: golden and random fields, each with the options to code them."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple

import numpy as np
from scipy.ndimage import uniform_filter1d
from second import make_golden

from touchfield.codec.objects.decoder import PoseSteps
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.support import Bricks
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid, PoseTrack
from touchfield.medium.field import brick_keys
from touchfield.medium.medium import VibrationFrame

GOLDEN = [name for name in make_golden.FIELDS if name.startswith("touch-")]


class Segment(NamedTuple):
    """Frames of a segment, and how to code them."""

    spec: TouchSpec
    frames: list[ForceField]

    @property
    def grid(self) -> Grid:
        """That of all frames."""
        return self.frames[0].grid


def golden_segments(name: str) -> Iterator[Segment]:
    """The segments of a golden file."""
    make, count, spec = make_golden.FIELDS[name]
    per = spec.segment_frames or count
    for first in range(0, count, per):
        yield Segment(spec, [make(t) for t in range(first, min(first + per, count))])


def _random_grid(rng: np.random.Generator) -> Grid:
    shape = tuple(int(n) for n in rng.integers(1, 34, 3))
    spacing = tuple(float(x) for x in rng.choice([0.001, 0.002, 0.0015], 3))
    return Grid(shape, spacing, tuple(float(x) for x in rng.normal(0, 0.01, 3)))


def _waves(rng: np.random.Generator, grid: Grid, frames: int, is_solid: bool) -> list[np.ndarray]:
    """A wall or a solid behind a wavy surface that moves along a random axis, with noise in some frames."""
    axes, sign = rng.permutation(3), int(rng.choice([-1, 1]))
    x, y, z = (np.indices(grid.shape)[a].astype(float) for a in axes)
    a, b, c, d = rng.uniform(2, 9, 4)
    fields = []
    for t in range(frames):
        surface = grid.shape[axes[2]] / 2 + np.sin((x + t) / a) * 2 + np.cos(y / b) * 2
        depth = sign * (surface - z)
        amplitude = np.where(depth > 0, np.minimum(depth / c, 2), 0)
        if not is_solid:
            amplitude = np.where(depth < 5, amplitude, 0)
        normal = np.zeros((*grid.shape, 3))
        normal[..., axes[0]], normal[..., axes[1]] = np.cos((x + t) / a) / d, np.sin(y / b) / d
        normal[..., axes[2]] = sign
        noise = 1 + rng.choice([0.0, 0.02, 0.3]) * rng.standard_normal((*grid.shape, 1))
        fields.append(amplitude[..., None] * normal * noise)
    return fields


def _ball(rng: np.random.Generator, grid: Grid, frames: int) -> list[np.ndarray]:
    """A soft ball that moves: the field of a penalty force, which is smooth."""
    metres = np.stack(
        [(np.arange(grid.shape[i]) * grid.spacing_m[i])[np.indices(grid.shape)[i]] for i in range(3)], -1
    )
    extent = np.array(grid.shape) * grid.spacing_m
    centre, radius = extent * rng.uniform(0.3, 0.7, 3), extent.max() * rng.uniform(0.4, 0.7)
    fields = []
    for t in range(frames):
        offset = metres - centre - t * 0.0004
        distance = np.linalg.norm(offset, axis=-1, keepdims=True)
        fields.append(np.clip(3 * (radius - distance) / radius, 0, 2) * offset / np.maximum(distance, 1e-9))
    return fields


def _steps(rng: np.random.Generator, grid: Grid, frames: int) -> list[np.ndarray]:
    """A solid with steps, after a low-pass that mixes the surfaces on both sides of a step."""
    _, axis, across = rng.permutation(3)
    indices, sign = np.indices(grid.shape), int(rng.choice([-1, 1]))
    fields = []
    for t in range(frames):
        step = rng.uniform(3, 7) * ((indices[across] + t) // 5 % 2)
        depth = sign * (
            indices[axis] - grid.shape[axis] / 2 - step + indices[across] * rng.uniform(-0.3, 0.3)
        )
        field = np.zeros((*grid.shape, 3))
        field[..., axis] = -sign * np.clip(depth / 4, 0, 1)
        field[..., across] = 0.2 * np.clip(depth / 4, 0, 1)
        fields.append(uniform_filter1d(field, 3, axis=int(across), mode="nearest"))
    return fields


def _noise(rng: np.random.Generator, grid: Grid, frames: int) -> list[np.ndarray]:
    """Forces of any size at some samples, some of them tiny, and frames that repeat."""
    fields: list[np.ndarray] = []
    for _ in range(frames):
        if fields and rng.random() < 0.3:
            fields.append(fields[-1])
            continue
        field = rng.standard_normal((*grid.shape, 3)) * np.exp(3 * rng.standard_normal((*grid.shape, 1)))
        field[rng.random(grid.shape) > rng.choice([0.02, 0.3, 0.9])] = 0
        fields.append(field)
    return fields


def random_frames(seed: int) -> list[ForceField]:
    """One to four frames on a grid of up to four bricks an axis."""
    rng = np.random.default_rng(seed)
    grid, frames, kind = _random_grid(rng), int(rng.integers(1, 5)), int(rng.integers(6))
    makers = {3: _noise, 4: _ball, 5: _steps}
    dense = makers[kind](rng, grid, frames) if kind in makers else _waves(rng, grid, frames, kind == 2)
    scale = 10.0 ** rng.integers(-3, 3)
    return [ForceField.from_dense(grid, (scale * field).astype(np.float32)) for field in dense]


MODES: dict[str, Callable[[np.random.Generator], dict[str, Any]]] = {
    "mask": lambda rng: {"k": rng.choice([0.02, 0.1, 0.3]), "f0_n": rng.choice([0.0, 0.01, 0.05, 0.5])},
    "exact-support": lambda rng: {"support": "exact", "f0_n": rng.choice([0.01, 0.2])},
    "mask-direction": lambda rng: {
        "mode": "mask-direction",
        "direction_jnd_deg": rng.choice([5.0, 18.4, 60.0]),
    },
    "nmse": lambda rng: {"mode": "nmse", "step_n": rng.choice([0.001, 0.05, 0.5])},
    "masking": lambda rng: {
        "masking": rng.choice([0.05, 0.5]),
        "masking_radius_m": rng.choice([0.0025, 0.01]),
    },
    "inter": lambda rng: {"interframe": rng.choice(["on", "off"]), "effort": "fast"},
}


def lossless_segment(seed: int) -> Segment:
    """Frames for the lossless mode: as they are, rounded, or products of levels and directions."""
    rng, frames = np.random.default_rng(2000 + seed), random_frames(seed)
    kind = seed % 4
    if kind == 1:
        frames = [ForceField.from_dense(f.grid, np.rint(f.to_dense() * 4) / np.float32(4)) for f in frames]
    if kind > 1:
        books = [Codebook.get(str(rng.choice(["ico5", "octa3", "ico1", "ico10"])))] * len(frames)
        levels = np.sort(rng.uniform(0.1, 5, int(rng.integers(1, 40)))).astype(np.float32)
        for i, frame in enumerate(frames):
            is_supported = frame.forces_n.any(axis=-1)
            level = levels[rng.integers(0, len(levels), is_supported.shape)][..., None]
            vertex = books[i].vertices_float32[books[i].nearest(frame.forces_n.reshape(-1, 3))]
            forces = level * vertex.reshape(*is_supported.shape, 3) * is_supported[..., None]
            if not (kind == 3 and i):  # of kind 3 only the first frame has a palette
                frames[i] = ForceField.from_bricks(frame.grid, frame.bricks, forces.astype(np.float32))
    interframe = "off" if seed % 5 == 4 else "auto"
    return Segment(TouchSpec(mode="lossless", interframe=interframe), frames)


def random_segment(mode: str, seed: int, **options: Any) -> Segment:
    """Frames of a seed, with random options of a mode."""
    values = MODES[mode](np.random.default_rng(1000 + seed))
    values = {key: value.item() if hasattr(value, "item") else value for key, value in values.items()}
    return Segment(TouchSpec(**values, **options), random_frames(seed))


def random_samples(frame: ForceField, rng: np.random.Generator) -> np.ndarray:
    """Some samples of a frame's bricks: 512 times the number of the brick plus the sample, ascending."""
    brick, sample = np.nonzero(rng.random((len(frame.bricks), 512)) < 0.02)
    positions = 8 * frame.bricks[brick] + np.stack(np.unravel_index(sample, (8, 8, 8)), axis=1)
    is_inside = (positions < frame.grid.shape).all(axis=1)
    numbers: np.ndarray = 512 * brick_keys(frame.grid, frame.bricks)[brick] + sample
    return numbers[is_inside]


def random_support(seed: int) -> tuple[Grid, list[Bricks]]:
    """Supports of frames, each bricks and the mask of their samples."""
    frames = random_frames(seed)
    supports = []
    for frame in frames:
        mask = frame.forces_n.any(axis=-1)
        has_any = mask.any(axis=(1, 2, 3))
        supports.append((frame.bricks[has_any], mask[has_any]))
    return frames[0].grid, supports


def random_vibration(seed: int) -> list[VibrationFrame]:
    """Frames in which some samples vibrate, many of them in several."""
    rng = np.random.default_rng(3000 + seed)
    grid, frames = _random_grid(rng), []
    level = rng.random(grid.shape) * rng.choice([1e-7, 1e-3, 1.0])
    for _ in range(int(rng.integers(1, 5))):
        places = np.argwhere(rng.random(grid.shape) < rng.choice([0.0, 0.1, 0.7])).astype(np.int32)
        amplitudes = (level[tuple(places.T)] * rng.uniform(0.9, 1.1, len(places)) + 1e-9).astype(np.float32)
        frames.append(
            VibrationFrame(grid, places, amplitudes, rng.uniform(0.1, 1000, len(places)).astype(np.float32))
        )
    return frames


def random_poses(seed: int) -> tuple[PoseTrack, PoseSteps]:
    """A body that rests, moves steadily, or trembles."""
    rng = np.random.default_rng(4000 + seed)
    count = int(rng.integers(1, 60))
    t = np.arange(count)[:, None]
    positions = rng.normal(0, 0.1, 3) + rng.choice([0.0, 0.001]) * t * rng.normal(0, 1, 3)
    positions = positions + rng.choice([0.0, 1e-4]) * rng.normal(0, 1, (count, 3)) + 1e-5 * (seed % 3) * t**2
    turns = rng.normal(0, 1, 4) + rng.choice([0.0, 0.01]) * t * rng.normal(0, 1, 4)
    track = PoseTrack(turns / np.linalg.norm(turns, axis=1, keepdims=True), positions)
    return track, PoseSteps(2.0 ** -int(rng.integers(8, 30)), 2.0 ** -int(rng.integers(4, 30)))

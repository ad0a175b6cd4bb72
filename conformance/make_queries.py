"""Writes `queries/NAME.csv`: points and times, and the force, its gradient and the vibration there.

    python conformance/make_queries.py [NAME ...]

The answers are those of `queries.py`, which follows docs/format/queries.md alone: no code of the package
computes them. README.md describes the files.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, Final

import numpy as np
from golden_content import WALL, bodies, wave
from make_golden import write_frames, write_scene
from queries import COLUMNS, Array, Bodies, Deformed, Queries, answer

from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.resample import pyramid

FOLDER: Final = Path(__file__).resolve().parent / "queries"
ROWS: Final = 100
MARGIN: Final = 1e-4
"""Samples: so near to a plane of a body's own or a bent lattice, rounding decides between two gradients."""


def write_clipped(path: Path) -> None:
    """Bodies that meet, tumble, deform and are damped, on a device much weaker than their forces."""
    scene = replace(bodies(5, 60.0, True, 0.5), force_max_n=0.5)
    write_scene(path, scene, TouchSpec(k=0.2, segment_frames=3))


def write_coarse(path: Path) -> None:
    """The coarse layer of v1/touch-mask."""
    write_frames(path, lambda t: pyramid(wave(t), 1)[1], 4, TouchSpec(segment_frames=3))


def write_deformation(path: Path) -> None:
    """Control points of six frames, in whole hundredths of a millimetre, that bend by up to a millimetre."""
    counts = (5, 6, 4)
    numbers = np.random.default_rng(3).integers(-80, 81, (6, *counts, 3))
    extent = np.array(WALL.spacing_m) * (np.array(WALL.shape) - 1)
    np.savez_compressed(
        path,
        displacement_m=numbers * 1e-5 * np.array([1.0, 0.5, 0.4]),
        corner_m=np.array(WALL.origin_m) + 0.1 * extent,
        spacing_m=0.8 * extent / (np.array(counts) - 3),
    )


CASES: Final[dict[str, dict[str, str]]] = {
    "voxels": {"stream": "../v1/touch-mask.touch"},
    "voxels-lossless": {"stream": "../v1/touch-lossless.touch"},
    "vibration": {"stream": "../v1/vibration-touch.touch"},
    "bodies": {"stream": "../v1/objects-touch.touch"},
    "bodies-deforming": {"stream": "../v1/objects-touch-deforming.touch"},
    "bodies-clipped": {"stream": "clipped.touch"},
    "coarse": {"stream": "coarse.touch", "lattice": " ".join(map(str, WALL.shape))},
    "deformed": {"stream": "../v1/vibration-touch.touch", "deformation": "deformed.npz"},
}
MADE: Final[dict[str, Callable[[Path], None]]] = {
    "clipped.touch": write_clipped,
    "coarse.touch": write_coarse,
    "deformed.npz": write_deformation,
}


def lattices(medium: Any) -> list[tuple[dict[str, Any], Array, Array]]:
    """Lattices of a medium, each with its rotation and position in frame 0."""
    if isinstance(medium, Bodies):
        poses = [(body.record, *medium.pose(body, 0, 0, 0.0)) for body in medium.scene.bodies]
        return [(medium.scene.head, np.eye(3), np.zeros(3)), *poses]
    head = medium.voxels.head if isinstance(medium, Deformed) else medium.head
    return [(head, np.eye(3), np.zeros(3))]


def candidates(medium: Any, rng: np.random.Generator, count: int) -> tuple[Array, Array]:
    """Times [n] and points [n, 3], anywhere and at edge cases.

    Times are on and between frames, before the first and after the last; points on samples, edges and faces
    of cells, halfway and anywhere, from before the lattice to behind it.
    """
    times, points = [], []
    for lattice, rotation, position in lattices(medium):
        shape = np.array(lattice["grid_shape"])
        index = rng.integers(-1, shape + 1, (count, 3)) + np.where(
            rng.random((count, 3)) < 0.5,
            np.round(rng.random((count, 3)), 3),
            rng.choice([0, 0, 0.5], (count, 3)),
        )
        local = np.array(lattice["origin_m"]) + index * np.array(lattice["spacing_m"])
        points.append(np.round(local @ rotation.T + position, 15))
        frame = rng.integers(0, medium.frame_count, count) + rng.choice([0, 0, 0.25, 0.5, 0.875], count)
        frame = np.where(rng.random(count) < 0.1, rng.choice([-1, medium.frame_count + 0.5], count), frame)
        times.append(frame / medium.rate_hz)
    return np.concatenate(times), np.concatenate(points)


def is_plain(medium: Any, time_s: float, point_m: Array) -> bool:
    """Whether the gradient at a point does not depend on rounding."""
    position = float(np.clip(time_s * medium.rate_hz, 0, medium.frame_count - 1))
    a = int(position + 1e-9)
    s = position - a if position - a > 1e-9 else 0.0
    b = a + (s > 0)
    if isinstance(medium, Deformed):
        index = (point_m - medium.corner_m) / medium.spacing_m
        bent_m = point_m + medium.bend(a, b, s, point_m)[0]
        own = (bent_m - np.array(medium.voxels.head["origin_m"])) / np.array(medium.voxels.head["spacing_m"])
        return all((np.abs(i - np.round(i)) > MARGIN).all() for i in (own, index))
    if not isinstance(medium, Bodies):
        return True
    for body in medium.scene.bodies:
        rotation, position_m = medium.pose(body, a, b, s)
        index = ((point_m - position_m) @ rotation - body.record["origin_m"]) / body.record["spacing_m"]
        if (np.abs(index - np.round(index)) < MARGIN).any():
            return False
    return True


def selected(medium: Any, rng: np.random.Generator) -> tuple[Array, Array]:
    """`ROWS` times and points: a tenth without an answer, the others with a force or a vibration, in turn."""
    times, points = candidates(medium, rng, 12 * ROWS)
    keep = np.array([is_plain(medium, t, p) for t, p in zip(times, points, strict=True)])
    times, points = times[keep], points[keep]
    found = answer(medium, times, points)
    has_force, vibrates = found.force.any(axis=1), found.vibration[:, 0] > 0
    rest = np.flatnonzero(~has_force & ~vibrates)[: ROWS // 10]
    pushing, vibrating = np.flatnonzero(has_force), np.flatnonzero(vibrates)
    half = min(len(vibrating), (ROWS - len(rest)) // 2)
    order = np.unique(np.concatenate([rest, vibrating[:half], pushing]), return_index=True)[1]
    order = np.concatenate([rest, vibrating[:half], pushing])[np.sort(order)][:ROWS]
    return times[np.sort(order)], points[np.sort(order)]


def text_of(number: float, digits: int | None = None) -> str:
    """A number as text: exactly, or with some digits."""
    text = repr(float(number)) if digits is None else f"{number:.{digits}g}"
    return "0" if float(text) == 0 else text.removesuffix(".0")


def write(name: str) -> Path:
    """Write a file, and what it needs."""
    path, stated = FOLDER / f"{name}.csv", CASES[name]
    for needed in stated.values():
        if needed in MADE:
            MADE[needed](FOLDER / needed)
    medium: Any = Queries(path, stated, np.empty((0, len(COLUMNS)))).medium
    times, points = selected(medium, np.random.default_rng(len(name)))
    force, gradient, vibration = answer(medium, times, points)
    sizes = (np.abs(force).max(), np.abs(gradient).max(), vibration[:, 0].max())
    limits = " ".join(f"{limit * size:.1e}" for limit, size in zip((1e-6, 1e-5, 1e-6), sizes, strict=True))
    lines = [f"# {key}: {value}" for key, value in {**stated, "tolerances": limits}.items()]
    lines.append(",".join(COLUMNS))
    for row in zip(times, points, force, gradient.reshape(-1, 9), vibration, strict=True):
        given, answers = np.hstack(row[:2]), np.hstack(row[2:])
        lines.append(",".join([*map(text_of, given), *(text_of(number, 10) for number in answers)]))
    path.write_text("\n".join(lines) + "\n", encoding="ascii")
    return path


def main() -> None:
    FOLDER.mkdir(exist_ok=True)
    for name in sys.argv[1:] or CASES:
        path = write(name)
        print(f"{path.name} {path.stat().st_size} bytes")


if __name__ == "__main__":
    main()

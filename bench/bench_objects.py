"""Measures fields of seven moving objects, against SciPy: a whole frame, one force query, many queries.

    python bench/bench_objects.py [--quick] [--queries N]

Seven rigid bodies tumble through a cube of 128 mm. Each has its own lattice of 30^3 to 64^3 samples. Three
things are timed: the voxel representation of a frame on 128^3 samples, one force query, and `--queries`
(10^6) queries at once. The peer is SciPy's `map_coordinates` (order 1) on the same fields as dense arrays,
with one call for each object and component; for a frame it evaluates only the samples within the box of each
object's lattice. Forces are compared.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from machine import Bar, Figures, at_least, at_most, bench, column, figure, timed
from touchfield.codec.objects.error_bound import ComposedRule, Moves, Pair
from touchfield.compute.threads import worker_count
from touchfield.medium import ForceField, Grid, HapticMedium, HapticObject, HapticScene, PoseTrack
from touchfield.sources.laws import LawSpec, penalty
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Sphere, Superquadric

Floats = NDArray[np.float64]
SIDES = (30, 36, 42, 48, 54, 60, 64)
SPACING_M = 0.001
FRAMES = 5


def scene() -> HapticScene:
    """Return balls, boxes and superquadrics that tumble through a cube of 128 mm.

    They have the default penalty wall.
    """
    rng = np.random.default_rng(0)
    law, origin = penalty(LawSpec(), LawSpec().saturation_m), (0.0, 0.0, 0.0)
    objects = []
    for n, side in enumerate(SIDES):
        half = (side - 6) * SPACING_M / 2
        shapes = (
            Sphere(origin, half),
            Box(origin, (half, 0.8 * half, 0.6 * half)),
            Superquadric(origin, (half,) * 3, (0.5, 1.0)),
        )
        grid = Grid((side,) * 3, (SPACING_M,) * 3, (-(side - 1) * SPACING_M / 2,) * 3)
        field = AnalyticScene([shapes[n % 3]]).field(0, grid, law)
        track = PoseTrack(
            Rotation.random(FRAMES, random_state=n).as_quat(), rng.uniform(0.03, 0.098, (FRAMES, 3))
        )
        objects.append(HapticObject(f"object {n}", HapticMedium.from_frames([field], 1000.0), track))
    return HapticScene(Grid((128,) * 3, (SPACING_M,) * 3, (0.0,) * 3), 1000.0, tuple(objects), 3.3)


class Scipy:
    """The same scene by `map_coordinates`."""

    def __init__(self, of: HapticScene) -> None:
        self.scene = of
        self.components = [np.moveaxis(body.field(0).to_dense(), 3, 0).copy() for body in of.objects]

    def forces_n(self, frame: int, points_m: Floats) -> Floats:
        """Return newtons at points [n, 3].

        Each object is evaluated only where a point may lie within its lattice.
        """
        total = np.zeros(points_m.shape)
        for body, components in zip(self.scene.objects, self.components):
            grid: Grid = body.medium.grid
            index = grid.to_index(body.track.to_body(points_m, frame))
            is_inside = ((index > -1) & (index < grid.shape)).all(axis=1)
            where = index[is_inside].T
            forces = [
                map_coordinates(c, where, np.float64, order=1, mode="grid-constant") for c in components
            ]
            total[is_inside] += np.stack(forces, axis=1) @ body.track.rotation(frame).T
        length = np.linalg.norm(total, axis=1, keepdims=True)
        limited: Floats = total * np.minimum(1.0, self.scene.force_max_n / np.maximum(length, 1e-300))
        return limited

    def frame(self, frame: int) -> ForceField:
        """Return the voxelised frame."""
        grid = self.scene.grid
        points = grid.to_m(np.moveaxis(np.indices(grid.shape), 0, -1)).reshape(-1, 3)
        return ForceField.from_dense(grid, self.forces_n(frame, points).reshape(*grid.shape, 3))


def kernel_us(medium: HapticScene, point: Floats) -> float:
    """Return the microseconds of a query without the interpreter, on one thread.

    One point is repeated in a batch.
    """
    many = np.repeat(point[None], 2000, axis=0)  # too few for a second thread
    return timed(lambda: medium.sample_n(0, many), runs=200)["min_ms"] / len(many) * 1e3


def measure(queries: int) -> Figures:
    """Measure frames and queries by touchfield and by SciPy."""
    composed = scene()
    peer, frames = Scipy(composed), composed.voxelise()
    points = np.random.default_rng(1).uniform(0, 0.128, (queries, 3))
    middle = composed.objects[0].track.to_scene((0.011, 0.0, 0.0), 0)
    turn = iter(range(10**9))

    differ = {
        "frame": float(np.abs(frames[1].to_dense() - peer.frame(1).to_dense()).max()),
        "queries": float(np.abs(composed.sample_n(1, points) - peer.forces_n(1, points)).max()),
    }
    jobs: dict[str, tuple[Any, int, Any, int]] = {
        "voxelised frame": (lambda n: frames[n], 41, peer.frame, 3),
        "one query": (
            lambda n: composed.sample_n(0, middle), 2001, lambda n: peer.forces_n(0, middle[None]), 201,
        ),
        "one query, next frame": (
            lambda n: composed.sample_n(n, middle), 2001, lambda n: peer.forces_n(n, middle[None]), 201,
        ),
        "10^6 queries": (lambda n: composed.sample_n(1, points), 9, lambda n: peer.forces_n(1, points), 3),
    }  # fmt: skip
    rows: dict[str, dict[str, float]] = {}

    def next_frame(job: Callable[[int], Any]) -> Any:
        return job(next(turn) % FRAMES)

    for name, (our_job, runs, peer_job, fewer) in jobs.items():
        rows[name] = timed(partial(next_frame, our_job), runs, warm=5)
        rows[name]["scipy_ms"] = timed(partial(next_frame, peer_job), fewer)["min_ms"]
        rows[name]["times"] = rows[name]["scipy_ms"] / rows[name]["min_ms"]
    pairs = [Pair(o.field(0), o.field(0).scaled(1.05)) for o in composed.objects]
    rule, moves = ComposedRule(composed, 0.1, 0.05), Moves.of(composed, [o.track for o in composed.objects])
    check = timed(lambda: rule.check(pairs, moves, range(FRAMES)))["min_ms"] / FRAMES
    settings = {
        "queries": queries,
        "support": frames[1].support_count,
        "threads": worker_count(),
        "rows": rows,
    }
    return settings | {
        "kernel_us": kernel_us(composed, middle),
        "check_ms_a_frame": check,
        "largest_difference_n": differ,
    }


def bars(figures: Figures) -> list[Bar]:
    """Limit frame and query time; require more speed than SciPy, and equal forces."""
    rows = figures["rows"]
    return [
        at_most("a voxelised frame; the prototype took 24 ms", rows["voxelised frame"]["min_ms"], 24.0, "ms"),
        at_most("a query, kernel alone", figures["kernel_us"], 2.0, "us"),
        at_least("time of scipy over ours, worst of all", min(column(rows, "times")), 10.0),
        at_most(
            "check of the composed promise, a frame", figure(figures, "check_ms_a_frame"), 1e3 / 30, "ms"
        ),
        at_most("largest difference to scipy", max(figures["largest_difference_n"].values()), 1e-5, "N"),
    ]


if __name__ == "__main__":
    bench("objects", __doc__, measure, bars, queries=(10**6, 10**4))

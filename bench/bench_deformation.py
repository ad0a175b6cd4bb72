"""Measures deformation at the receiver (paper section 6.3): error, size, time, stability.

    python bench/bench_deformation.py [--nw N] [--every N] [--quick]

There are two inputs: a capsule that bends, whose fields are known in closed form, and the fox of the Khronos
samples, with six frames on each side of a pose. The field of one pose is deformed by tracks of 8^3 control
points and compared with the field computed for each frame, over the samples at which either has a force. The
errors are:

* bent: the deformed field.
* still: the undeformed field of the pose.
* size kept: the deformed force rescaled to its original magnitude. Such a field has curl.
* half a sample: the mean of two lookups of the stored field, half a sample to either side, against the field
  itself. It is a lower limit for any lookup between samples.

The bytes are those of the file of tracks ("track"), of all frames coded by coder `touch` ("coded"), and of
their forces as float32 ("plain"), each per frame.

A query is one call of `FieldSampler.at` from Python. Loop work is the work around closed loops over the work
of |F| along them. It is computed by Gauss-Legendre quadrature, with each piece within one cell of the control
points, in a linear field that the sampler reproduces to float64 rounding.

Stability is tested with the hands of `bench_stability`, on walls that yield as far as the hand presses into
them. `--every N` takes every N-th case.
"""

from __future__ import annotations

import itertools
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import bench_stability as hands
from machine import SHARED, Bar, Figures, at_most, bench
from touchfield import EncodeSpec, encode, prepare
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.deformation import Deformation, fitted, read_deformation
from touchfield.pipeline.spec import Motion
from touchfield.render.sampler import FieldSampler
from touchfield.tasks.deformation import tracks_of

Float64s = NDArray[np.float64]
SIDE = 6  # frames on each side of the stored pose
QUERIES = 20_000
GIVE = 1.0  # compliance times stiffness
MATRIX = np.array([[80.0, 30, -20], [30, 120, 10], [-20, 10, 60]])


def db(error: NDArray[Any], force: NDArray[Any]) -> float:
    """Return the ratio of energies in dB, 10 log10; at least -300."""
    return float(10 * np.log10(max((error**2).sum() / (force**2).sum(), 1e-30)))


class Moving(NamedTuple):
    """Fields computed for each frame, the stored field of one pose, and its tracks."""

    frames: list[ForceField]
    rest: ForceField
    tracks: Deformation
    rms_m: float


def capsule() -> Moving:
    """Return a capsule of 80 x 20 mm that bends to 76 degrees in eight steps.

    Its stiffness is 400 N/m; samples are 0.5 mm apart.
    """
    half_m, radius_m = 0.03, 0.01
    grid = Grid((161, 65, 121), (0.0005,) * 3, (-0.04, -0.016, -0.016))
    at = np.stack(np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)

    def axis_m(s: Float64s, bend: float) -> Float64s:
        return np.stack([np.sin(bend * s) / bend, 0 * s, (1 - np.cos(bend * s)) / bend], axis=-1)

    def field(bend: float) -> ForceField:
        s = np.clip(np.arctan2(at[..., 0], 1 / bend - at[..., 2]) / bend, -half_m, half_m)
        away = at - axis_m(s, bend)
        distance_m = np.maximum(np.linalg.norm(away, axis=-1, keepdims=True), 1e-9)
        return ForceField.from_dense(
            grid, (np.maximum(400 * (radius_m - distance_m), 0) * away / distance_m).astype(np.float32)
        )

    def points(bend: float) -> Float64s:
        s, turn = np.meshgrid(
            np.linspace(-half_m, half_m, 41), np.linspace(0, 2 * np.pi, 24, False), indexing="ij"
        )
        out = [-np.sin(bend * s) * np.cos(turn), np.sin(turn), np.cos(bend * s) * np.cos(turn)]
        normal = np.stack(out, axis=-1)
        layers = [axis_m(s, bend) + (radius_m - depth) * normal for depth in (0.0, 0.004, 0.008)]
        return np.stack(layers).reshape(-1, 3)

    bends = np.linspace(1e-3, 22, 9).tolist()
    lattice = Deformation.at_rest((-0.042, -0.018, -0.018), (0.042, 0.018, 0.046), 8)
    tracks, rms_m = fitted(points(bends[0]), map(points, bends), lattice, 30.0)
    return Moving([field(bend) for bend in bends], field(bends[0]), tracks, rms_m)


def model(path: Path, rest: int, nw: int, folder: Path) -> Moving:
    """Return the fields of a skinned model at a pose and around it, and its tracks.

    Fields and tracks are made by the public functions.
    """
    first, stop = rest - SIDE, rest + SIDE + 1
    spec = EncodeSpec(nw=nw, representation="voxel", frames=(first, stop))
    medium, stream, out = prepare(str(path), spec).medium, folder / "rest.touch", folder / "tracks.npz"
    # encode the pose only, with the placement fitted to all frames
    encode(str(path), stream, replace(spec, frames=(rest, rest + 1), fit_frames=(first, stop)))
    tracks = tracks_of(stream, out, Motion(path, None, (first, stop), rest))
    return Moving(list(medium), medium[SIDE], read_deformation(out), tracks.figures["rms_mm"] / 1e3)


def deformation_errors(moving: Moving, folder: Path) -> Figures:
    """Compare the deformed field with that of each frame; return errors and bytes."""
    frames, rest, bent, rms_m = moving
    grid = rest.grid
    sampler = FieldSampler(HapticMedium.from_frames([rest], bent.rate_hz), deformation=bent)
    bent_error, rescaled_error, rest_error, force = ([] for _ in range(4))
    for n, new in enumerate(frames):
        indices = np.unique(np.concatenate([new.positions(), rest.positions()]), axis=0)
        at = np.asarray(grid.origin_m) + indices * np.asarray(grid.spacing_m)
        rendered = sampler.force_n(np.full(len(at), n / bent.rate_hz), at).astype(np.float64)
        flat, weights = bent.design(at)
        looked = at + np.einsum("nw,nwc->nc", weights, bent.displacement_m[n].reshape(-1, 3)[flat])
        rest_size = np.linalg.norm(rest.sample_n(looked), axis=1, keepdims=True)
        rescaled = rendered / np.maximum(np.linalg.norm(rendered, axis=1, keepdims=True), 1e-12) * rest_size
        truth = new.sample_n(at).astype(np.float64)
        bent_error.append(rendered - truth)
        rescaled_error.append(rescaled - truth)
        rest_error.append(rest.sample_n(at) - truth)
        force.append(truth)
    half = np.asarray(grid.spacing_m) / 2
    at = np.asarray(grid.origin_m) + rest.positions() * np.asarray(grid.spacing_m)
    all_forces, out = np.concatenate(force), folder / "tracks.npz"
    bent.write(out)
    coded = len(TouchEncoder(grid, TouchSpec()).encode_segment(frames).body)
    return {
        "frames": len(frames),
        "least_determinant": bent.min_determinant()[0],
        "rms_mm": 1e3 * rms_m,
        "still_db": db(np.concatenate(rest_error), all_forces),
        "bent_db": db(np.concatenate(bent_error), all_forces),
        "size_kept_db": db(np.concatenate(rescaled_error), all_forces),
        "worst_frame_db": max(db(e, f) for e, f in zip(bent_error, force, strict=True)),
        "half_a_sample_db": db(
            (rest.sample_n(at - half) + rest.sample_n(at + half)) / 2 - rest.sample_n(at),
            rest.sample_n(at),
        ),
        "track_bytes": out.stat().st_size / len(frames),
        "coded_bytes": coded / len(frames),
        "plain_bytes": 12 * float(np.mean([f.support_count for f in frames])),
    }


def random_map(size_m: float = 0.0008) -> Deformation:
    """Return control points with random displacements."""
    lattice = Deformation.at_rest((-0.02,) * 3, (0.02,) * 3)
    u = np.random.default_rng(3).normal(size=lattice.displacement_m.shape) * size_m
    return replace(lattice, displacement_m=u)


def spring() -> HapticMedium:
    """Return a field F = M x, whose potential is quadratic."""
    grid = Grid((61, 61, 61), (0.001,) * 3, (-0.03,) * 3)
    at = np.stack(np.meshgrid(*(grid.axis_m(a) for a in range(3)), indexing="ij"), axis=-1)
    return HapticMedium.from_frames([ForceField.from_dense(grid, (at @ MATRIX).astype(np.float32))], 1.0)


def loop_work(bent: Deformation) -> float:
    """Return the work around a rectangle over that of |F| along it, the worst of 20.

    The pieces of the quadrature end at the boundaries of cells.
    """
    rng, worst = np.random.default_rng(4), 0.0
    corner, cell = np.asarray(bent.corner_m), np.asarray(bent.spacing_m)
    nodes, weights = np.polynomial.legendre.leggauss(12)
    u = bent.displacement_m[0].reshape(-1, 3)

    def force(p: Float64s) -> Float64s:
        flat, point_weights = bent.design(p)
        moved = p + np.einsum("nw,nwc->nc", point_weights, u[flat])
        j = np.stack([slope(bent, p, a) for a in range(3)], axis=-1) + np.eye(3)
        bent_force: Float64s = np.einsum("nki,nk->ni", j, moved @ MATRIX)
        return bent_force

    for _ in range(20):
        axes, low, high = rng.permutation(3)[:2], *np.sort(rng.uniform(0, 5, (2, 3)), axis=0)
        corners = [low.copy() for _ in range(5)]
        for n, (i, j) in enumerate(((0, 0), (1, 0), (1, 1), (0, 1), (0, 0))):
            corners[n][axes[0]], corners[n][axes[1]] = (low, high)[i][axes[0]], (low, high)[j][axes[1]]
        work = size = 0.0
        for a, b in itertools.pairwise(corners):
            axis = int(np.abs(b - a).argmax())
            breaks = sorted(
                {a[axis], b[axis], *range(int(min(a[axis], b[axis])) + 1, int(max(a[axis], b[axis])) + 1)}
            )
            sign = 1.0 if b[axis] > a[axis] else -1.0
            for s, t in itertools.pairwise(breaks):
                p = np.repeat(a[None], len(nodes), axis=0)
                p[:, axis] = s + (t - s) * (nodes + 1) / 2
                along = force(corner + p * cell)[:, axis] * weights * (t - s) / 2 * cell[axis]
                work, size = work + sign * float(along.sum()), size + float(np.abs(along).sum())
        worst = max(worst, abs(work) / size)
    return worst


def slope(bent: Deformation, p: Float64s, axis: int) -> Float64s:
    """Return du/dx along an axis, by the sampler's own formula in NumPy."""
    from touchfield.medium.deformation import _basis

    shape = np.array(bent.displacement_m.shape[1:4])
    s = (p - np.asarray(bent.corner_m)) / np.asarray(bent.spacing_m)
    cell = np.clip(s.astype(np.int64), 0, shape - 4)
    both = [_basis(s[:, a] - cell[:, a]) for a in range(3)]
    w = [both[a][1] / bent.spacing_m[a] if a == axis else both[a][0] for a in range(3)]
    i, j, k = (cell[:, a, None] + np.arange(4) for a in range(3))
    flat = ((i[:, :, None, None] * shape[1] + j[:, None, :, None]) * shape[2] + k[:, None, None, :]).reshape(
        -1, 64
    )
    weights = (w[0][:, :, None, None] * w[1][:, None, :, None] * w[2][:, None, None, :]).reshape(-1, 64)
    change: Float64s = np.einsum("nw,nwc->nc", weights, bent.displacement_m[0].reshape(-1, 3)[flat])
    return change


def exact() -> Figures:
    """Return errors for the identity, an affine map and the formula, and loop work."""
    medium, bent = spring(), random_map()
    p = np.random.default_rng(5).uniform(-0.018, 0.018, (20_000, 3))
    zero = np.zeros(len(p))
    plain = FieldSampler(medium).force_n(zero, p)
    rest = FieldSampler(medium, deformation=Deformation.at_rest((-0.02,) * 3, (0.02,) * 3)).force_n(zero, p)
    a = np.array([[0.1, -0.05, 0.02], [0.03, -0.08, 0.04], [-0.02, 0.06, 0.12]])
    index = np.stack(np.meshgrid(*(np.arange(8),) * 3, indexing="ij"), axis=-1) - 1
    lattice = Deformation.at_rest((-0.02,) * 3, (0.02,) * 3)
    controls = np.asarray(lattice.corner_m) + index * np.asarray(lattice.spacing_m)
    affine = FieldSampler(medium, deformation=replace(lattice, displacement_m=(controls @ a.T)[None]))
    expected = (p @ (np.eye(3) + a).T) @ MATRIX @ (np.eye(3) + a)
    sampler = FieldSampler(medium, deformation=bent)
    flat, weights = bent.design(p)
    moved = p + np.einsum("nw,nwc->nc", weights, bent.displacement_m[0].reshape(-1, 3)[flat])
    j = np.stack([slope(bent, p, axis) for axis in range(3)], axis=-1) + np.eye(3)
    formula = np.einsum("nki,nk->ni", j, moved @ MATRIX)
    return {
        "identity_bits_off": int((plain.view(np.int32) != rest.view(np.int32)).sum()),
        "affine_off": float(np.abs(affine.force_n(zero, p) - expected).max() / np.abs(expected).max()),
        "formula_off": float(np.abs(sampler.force_n(zero, p) - formula).max() / np.abs(formula).max()),
        "loop_work": loop_work(bent),
    }


def queries() -> Figures:
    """Time a call from Python with and without deformation, microseconds."""
    p, rows = np.random.default_rng(6).uniform(-0.018, 0.018, (QUERIES, 3)).tolist(), {}
    for name, bent in (("plain", None), ("bent", random_map())):
        at = FieldSampler(spring(), deformation=bent).at
        for x, y, z in p[:200]:
            at(0.0, x, y, z)
        took = np.empty(QUERIES)
        for n, (x, y, z) in enumerate(p):
            began = time.perf_counter_ns()
            at(0.0, x, y, z)
            took[n] = time.perf_counter_ns() - began
        rows[name] = {
            "p50_us": float(np.quantile(took, 0.5)) / 1e3,
            "p99_9_us": float(np.quantile(took, 0.999)) / 1e3,
        }
    return rows


def press_cases(every: int) -> Figures:
    """Run the cases of `bench_stability` on walls that yield."""
    rows = []
    for stiffness in hands.WALLS:
        soft = Deformation.at_rest(
            (-0.07,) * 3, (0.07,) * 3, compliance_m_per_n=GIVE / stiffness, relax_s=0.05
        )
        block = hands.Bench(
            hands.wall(stiffness, hands.MAX_FORCE_N), device=hands.STRONG, grid=hands.GRID, deformation=soft
        )
        cases = [*itertools.product(hands.DAMPINGS, hands.DELAYS, hands.RESOLUTIONS, hands.HANDS)][::every]
        for b, delay, resolution, (kg, k) in cases:
            hands.auto(block, stiffness, b, delay, resolution)
            depth = hands.PRESS_N * (1 / stiffness + 1 / k)
            contact = hands.simulate(block, kg, k, b, depth, resolution, delay)
            rows.append((stiffness, b, delay, resolution, kg, k, *contact))
    summary = hands.summary_of(np.array(rows))
    return {
        key: summary[key] for key in ("cases", "cycles", "worst_rms_n", "drives", "gives", "worst_given_mj")
    }


def measure(nw: int, every: int) -> Figures:
    """Measure exactness, queries, stability and errors."""
    figures: dict[str, Any] = {
        "exact": exact(),
        "queries": queries(),
        "hands": press_cases(every),
        "carried": {},
    }
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        figures["carried"]["capsule that bends"] = deformation_errors(capsule(), folder)
        fox = SHARED / "meshes" / "fox" / "Fox.glb"
        if fox.is_file():
            for rest in (60, 120):
                figures["carried"][f"fox, about frame {rest}"] = deformation_errors(
                    model(fox, rest, nw, folder), folder
                )
    return figures


def bars(figures: Figures) -> list[Bar]:
    """Limit errors, query time, bytes, limit cycles and energy."""
    rows, contacts = figures["carried"].values(), figures["hands"]
    return [
        at_most("identity: values of other bits", figures["exact"]["identity_bits_off"], 0),
        at_most("affine map, error over the largest force", figures["exact"]["affine_off"], 1e-6),
        at_most("sampler beside the formula", figures["exact"]["formula_off"], 1e-6),
        at_most("work around loops, over that of the force along them", figures["exact"]["loop_work"], 1e-9),
        at_most("query, p99.9", figures["queries"]["bent"]["p99_9_us"], 5.0, "us"),
        at_most(
            "bent beside made anew, worst of the models", max(row["bent_db"] for row in rows), -20.0, "dB"
        ),
        at_most(
            "tracks over plain fields, bytes a frame, worst",
            max(row["track_bytes"] / row["plain_bytes"] for row in rows),
            0.01,
        ),
        at_most(
            "tracks over coded fields, bytes a frame, worst",
            max(row["track_bytes"] / row["coded_bytes"] for row in rows),
            0.01,
        ),
        at_most("hands on what yields: limit cycles", contacts["cycles"], 0),
        at_most("energy that came to a hand, cases", contacts["drives"] + contacts["gives"], 0),
    ]


if __name__ == "__main__":
    bench("deformation", __doc__, measure, bars, nw=(7, 6), every=(4, 60))

"""Force, gradient and vibration at a point agree between `c/touch.h`, the package and the format.

The third result is that of `conformance/queries.py`, in float64. Points are at edge cases: on samples, faces
and edges of cells, at the borders of bricks and of the lattice, next to samples without a force, where a sum
of forces is clipped, and at NaN.
"""

from __future__ import annotations

import importlib
import itertools
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from second import CONFORMANCE, decode_objects, decoder, make_golden
from test_c import COMPILER, built, run_with

import touchfield as tf
from object_makers import moving_scene
from touchfield.codec.touch.spec import TouchSpec
from touchfield.render.sampler import FieldSampler

pytestmark = pytest.mark.skipif(COMPILER is None, reason="there is no C compiler here")

FOLDER = Path(__file__).parent
V1 = CONFORMANCE / "v1"
POINTS = 1500
queries: Any = importlib.import_module("queries")
Answers: Any = queries.Answers  # here of all frames: [frames, points, ...]


def by_the_format(path: Path, points: np.ndarray) -> Any:
    """The result of the reference, for every frame."""
    medium = queries.medium_of(path)
    frames = [medium.answers(frame, frame, 0.0, points) for frame in range(medium.frame_count)]
    return Answers(*(np.stack(part) for part in zip(*frames, strict=True)))


# -- the other two -----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`query`, compiled with warnings as errors."""
    folder = CONFORMANCE.parent / "c"
    return built(tmp_path_factory.mktemp("c"), "query", "-O1", f"-I{folder}", source=FOLDER / "query.c")


def by_c(program: Path, path: Path, points: np.ndarray, folder: Path) -> Any:
    """The result of `touch.h`."""
    points.tofile(folder / "points")
    assert run_with(program, path, folder / "points", folder / "answers") == (0, "")
    rows = np.fromfile(folder / "answers").reshape(-1, len(points), 14)
    return Answers(rows[..., :3], rows[..., 3:12].reshape(*rows.shape[:2], 3, 3), rows[..., 12:])


def by_the_package(path: Path, points: np.ndarray) -> Any:
    """The result of `FieldSampler`, which does not accept NaN."""
    with tf.open_stream(path) as stream:
        medium = stream.medium if stream.scene is None else stream.scene
        sampler = FieldSampler(medium)
        times = np.arange(len(stream.medium)) / medium.rate_hz
        force = np.stack([sampler.force_n(t, points) for t in times])
        gradient = np.stack([sampler.gradient_n_per_m(t, points) for t in times])
        vibration = np.stack([np.stack(sampler.vibration(t, points), axis=-1) for t in times])
    return Answers(force, gradient, vibration)


# -- points ------------------------------------------------------------------------------------------------


def lattices_of(path: Path) -> list[tuple[dict[str, Any], np.ndarray, np.ndarray]]:
    """Lattices of a file, each with its rotation and position: HEAD's, and those of bodies at frame 0."""
    file = decoder.read_file(path.read_bytes())
    out = [(file.head, np.eye(3), np.zeros(3))]
    if file.objects:
        scene = decode_objects.decode_scene(file.head, file.objects, file.segments)
        for body in scene.bodies:
            out.append((body.record, decode_objects.rotation_of(body.quaternions[0]), body.positions_m[0]))
    return out


def edge_case_indices(shape: np.ndarray, rng: np.random.Generator, count: int) -> np.ndarray:
    """Indices [count, 3] in samples of a lattice, from one before the first to one past the last."""
    sample_indices = rng.integers(-1, shape + 1, (count, 3)).astype(float)
    bricks = 8.0 * rng.integers(0, shape // 8 + 1, (count, 3)) - rng.integers(0, 2, (count, 3))
    parts = rng.choice([0.0, 0.0, 0.5, 0.25, 1e-4, 1 - 1e-4], (count, 3))
    parts = np.where(rng.random((count, 3)) < 0.4, rng.random((count, 3)), parts)
    return np.where(rng.random((count, 3)) < 0.3, bricks, sample_indices) + parts


def points_of(path: Path) -> np.ndarray:
    """Points, float64 [n, 3], metres."""
    rng = np.random.default_rng(5)
    point_sets = []
    for record, rotation, position in lattices_of(path):
        shape, spacing = np.array(record["grid_shape"]), np.array(record["spacing_m"])
        indices = edge_case_indices(shape, rng, POINTS)
        indices[: POINTS // 3] = rng.uniform(-1.5, shape + 0.5, (POINTS // 3, 3))
        point_sets.append((np.array(record["origin_m"]) + indices * spacing) @ rotation.T + position)
    return np.concatenate(point_sets)


def is_plain(path: Path, points: np.ndarray) -> np.ndarray:
    """Where the gradient is unique: away from planes of rotated lattices, and from the edge of the support.

    On such a plane the rounding of a rotation decides which cell a point is in. Lattices without rotation
    have no such rounding, and a rule: the cell towards larger indices.
    """
    file = decoder.read_file(path.read_bytes())
    if not file.objects:
        return np.ones((file.head["frame_count"], len(points)), bool)
    scene = decode_objects.decode_scene(file.head, file.objects, file.segments)
    out = np.ones((file.head["frame_count"], len(points)), bool)
    for frame, body in itertools.product(range(len(out)), scene.bodies):
        rotation = decode_objects.rotation_of(body.quaternions[frame])
        indices = (points - body.positions_m[frame]) @ rotation - body.record["origin_m"]
        indices = indices / np.array(body.record["spacing_m"])
        out[frame] &= (np.abs(indices - np.round(indices)) > 1e-4).all(axis=1)
    return out


@cache
def clipped_scene(folder: Path) -> Path:
    """Bodies that meet, tumble, deform and are damped, on a device much weaker than their forces."""
    path = folder / "clipped.touch"
    make_golden.write_scene(
        path, replace(moving_scene(5, surface_damping=0.5), force_max_n=0.3), TouchSpec(segment_frames=3)
    )
    return path


NAMES = (
    "touch-mask",
    "touch-lossless",
    "vibration-touch",
    "objects-touch",
    "objects-touch-deforming",
    "clipped",
)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("streams")


@pytest.mark.parametrize("name", NAMES)
def test_three_implementations_agree_at_points(
    name: str, program: Path, folder: Path, tmp_path: Path
) -> None:
    path = clipped_scene(folder) if name == "clipped" else V1 / f"{name}.touch"
    points = points_of(path)
    expected = by_the_format(path, points)
    largest, steepest = np.abs(expected.force).max(), np.abs(expected.gradient).max()
    is_slope = is_plain(path, points)
    for found in (by_c(program, path, points, tmp_path), by_the_package(path, points)):
        np.testing.assert_allclose(found.force, expected.force, rtol=0, atol=2e-6 * largest)
        slopes, expected_slopes = found.gradient[is_slope], expected.gradient[is_slope]
        np.testing.assert_allclose(slopes, expected_slopes, rtol=0, atol=2e-5 * steepest)
        np.testing.assert_allclose(found.vibration[..., 0], expected.vibration[..., 0], rtol=1e-5, atol=1e-9)
        np.testing.assert_array_equal(found.vibration[..., 1], expected.vibration[..., 1])
    # the points cover samples with and without a force
    size = np.linalg.norm(expected.force, axis=-1)
    assert (size > 0).mean() > 0.02 and (size == 0).mean() > 0.05
    if name == "clipped":
        is_cut = (size > 0.3 - 1e-9) & is_slope & (np.abs(expected.gradient).max(axis=(-2, -1)) > 1)
        assert is_cut.sum() > 500
    if name.startswith("vibration"):
        assert (np.unique(expected.vibration[..., 1]).size > 20) and (
            expected.vibration[..., 0] == 0
        ).mean() > 0.1


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, 1e300, -1e300])
@pytest.mark.parametrize("name", ["vibration-touch", "objects-touch"])
def test_points_that_are_not_finite_give_zeros_in_c(
    name: str, bad: float, program: Path, tmp_path: Path
) -> None:
    path = V1 / f"{name}.touch"
    inside = np.array(lattices_of(path)[0][0]["origin_m"])
    points = np.tile(inside, (3, 1))
    points[np.arange(3), np.arange(3)] = bad
    for answer in by_c(program, path, points, tmp_path):
        assert not answer.any()

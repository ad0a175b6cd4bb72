"""The prototype of a base layer of planes (bench/source_layer.md): its bytes, fit and rule in integers."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield import EncodeSpec, prepare
from touchfield.codec.touch.body import BodyReader
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.filters.device_filter import device_medium
from touchfield.filters.device_spec import DeviceFilter
from touchfield.sources.camera import DepthSequence, Intrinsics
from touchfield.sources.depth.depth_scene import DepthScene
from touchfield.sources.laws import profile_of

BENCH = Path(__file__).resolve().parents[1] / "bench"
HEIGHT, WIDTH = 60, 80


def bench_module(name: str) -> Any:
    if str(BENCH) not in sys.path:
        sys.path.insert(0, str(BENCH))
    return importlib.import_module(name)


trees, rules = bench_module("source_layer_tree"), bench_module("source_layer_field")


def random_tree(seed: int) -> Any:
    rng = np.random.default_rng(seed)
    tree = trees.Tree.empty(HEIGHT, WIDTH)
    tree.split[:] = rng.random(tree.split.shape) < 0.4
    tree.modes[:] = rng.choice([0, 1, 4], tree.modes.shape)  # the others need two or three neighbours
    tree.residuals[:] = np.rint(rng.standard_cauchy(tree.residuals.shape) * 3).clip(-(1 << 20), 1 << 20)
    return tree


@given(st.integers(0, 10**6))
@settings(max_examples=10)
def test_a_tree_is_read_as_it_was_written(seed):
    data, planes = trees.write_tree(random_tree(seed))
    read = trees.read_tree(data, HEIGHT, WIDTH)
    assert (read.is_hole == planes.is_hole).all()
    assert (read.coefficients[~read.is_hole] == planes.coefficients[~planes.is_hole]).all()
    assert (~read.is_hole).any() or len(data) <= 60


def test_no_byte_of_a_tree_is_superfluous():
    data, planes = trees.write_tree(random_tree(1))
    shorter = trees.read_tree(data[:-1], HEIGHT, WIDTH)
    is_equal = (shorter.is_hole == planes.is_hole).all()
    assert not is_equal or not (shorter.coefficients == planes.coefficients).all()


# -- a scene of its own: a ball before a wall, seen from a camera ------------------------------------------


class BallAndWall(DepthSequence):
    """Depth of a ball of 0.25 m, 1.2 m away, before a slanted wall."""

    name, frame_count, width, height, rate_hz = "ball and wall", 1, WIDTH, HEIGHT, 30.0
    intrinsics = Intrinsics(70.0, 70.0, 39.5, 29.5)

    def depth_m(self, frame: int) -> np.ndarray:
        k = self.intrinsics
        x = (np.arange(WIDTH) - k.cx) / k.fx
        y = ((np.arange(HEIGHT) - k.cy) / k.fy)[:, None]
        wall = 2.0 / (1 + 0.2 * x + 0.1 * y)
        square, along = 1 + x * x + y * y, 1.2
        root = along * along - square * (1.2**2 - 0.25**2)
        ball = (along - np.sqrt(np.maximum(root, 0))) / square
        return np.where(root > 0, ball, wall).astype(np.float32)


class Scene:
    """The field of the scene, and what the rule needs."""

    def __init__(self) -> None:
        scene, spec = DepthScene(BallAndWall()), EncodeSpec(nw=5, thickness_m=0.008)
        at = prepare(DepthScene(BallAndWall()), spec)
        law = spec.law_spec(at.device.force_max_n)
        mapping = DeviceFilter(
            at.device, at.medium.grid, at.placement, profile_of(law, law.saturation_m), spec.device_filter
        )
        self.frame = device_medium(scene, mapping)[0]
        self.unit_n = bench_module("source_layer_pass").unit_n([self.frame])
        self.lattice = rules.lattice_of(
            mapping, scene.pose(0), BallAndWall.intrinsics, (HEIGHT, WIDTH), self.unit_n
        )
        self.surface = rules.surface_of(scene.planes(0), np.full((HEIGHT, WIDTH), 2.0))
        self.tolerance = trees.Tolerance(1e-4 / at.placement.scale, 0.2, 70.0, 70.0)

    def exact_planes(self) -> Any:
        """The planes of all pixels, rounded."""
        planes, (w, a, b, *_) = trees.Planes.empty(HEIGHT, WIDTH), self.surface
        a, b = (np.rint(slope * trees.UNIT).astype(np.int64) for slope in (a, b))
        c = np.rint(w * trees.UNIT).astype(np.int64) - a * np.arange(WIDTH) - b * np.arange(HEIGHT)[:, None]
        planes.coefficients[:], planes.is_hole[:] = np.stack([a, b, c], axis=-1), w == 0
        return planes

    def error(self, bricks: np.ndarray, vectors: np.ndarray) -> np.ndarray:
        """Difference of a base layer and the field, newtons, at the voxels where either has a force."""
        dense = np.zeros((*(8 * n for n in self.frame.grid.brick_shape), 3))
        for brick, own in zip(8 * bricks, vectors.reshape(-1, 8, 8, 8, 3)):
            x, y, z = brick
            dense[x : x + 8, y : y + 8, z : z + 8] = own * self.unit_n
        own = self.frame.to_dense()
        size = own.shape
        dense = dense[: size[0], : size[1], : size[2]]
        return np.linalg.norm(dense - own, axis=-1)[(dense != 0).any(axis=-1) | (own != 0).any(axis=-1)]


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene()


@pytest.mark.thorough
def test_the_rule_makes_the_field_of_the_package(scene):
    bricks, vectors = rules.field_of(scene.lattice, scene.exact_planes())
    error = scene.error(bricks, vectors)
    assert len(error) > 500
    assert np.mean(error < 0.01) > 0.99  # samples at the edge of a pixel may take the one beside it
    assert np.median(error) < 1e-3


@pytest.mark.thorough
def test_bricks_are_left_out_only_without_force(scene):
    bricks, _ = rules.field_of(scene.lattice, scene.exact_planes())
    axes, planes = rules.axes_of(scene.lattice.rule), scene.exact_planes()
    force, seen = np.zeros(3, np.int64), set()
    for at in np.ndindex(*(2 * n for n in scene.lattice.shape)):
        sample = scene.lattice.rule.lattice[0] + np.array(at) @ scene.lattice.rule.lattice[1:]
        if rules.force_at(scene.lattice.rule, axes, planes, sample, force) and abs(force).max() > 1 << 20:
            seen.add(tuple(n // 16 for n in at))
    assert len(seen) > 5
    assert seen <= set(map(tuple, bricks.tolist()))


@pytest.mark.thorough
def test_a_head_is_read_as_it_was_written(scene):
    read = rules.Lattice.read(scene.lattice.head(), scene.lattice.shape)
    assert read.size_px == scene.lattice.size_px
    for own, other in zip(read.rule, scene.lattice.rule):
        assert (own == other).all()


@pytest.mark.thorough
def test_the_fit_takes_few_squares_and_stays_near(scene):
    tree = trees.fit_tree(scene.surface, scene.tolerance)
    data, planes = trees.write_tree(tree)
    assert len(data) < HEIGHT * WIDTH // 8  # less than a bit for each pixel
    u, v = np.arange(WIDTH), np.arange(HEIGHT)[:, None]
    a, b, c = np.moveaxis(planes.coefficients, -1, 0)
    is_known = (scene.surface.inverse_m > 0) & ~planes.is_hole
    assert is_known.mean() > 0.8
    off = abs((a * u + b * v + c) / trees.UNIT - scene.surface.inverse_m)[is_known]
    assert np.median(off) < 2e-3


@pytest.mark.thorough
@pytest.mark.external
def test_a_better_base_layer_takes_fewer_corrections(scene):
    passes = bench_module("source_layer_pass")
    exact = rules.field_of(scene.lattice, scene.exact_planes())
    fitted = rules.field_of(
        scene.lattice, trees.write_tree(trees.fit_tree(scene.surface, scene.tolerance))[1]
    )
    costs = [passes.frame_costs([scene.frame], [passes.Layer(0, *layer)])[0] for layer in (exact, fitted)]
    assert costs[0].corrections < costs[1].corrections < costs[0].other
    assert costs[0].within_fraction > 0.98
    spec = TouchSpec(k=0.1, f0_n=0.05, guess="off")
    body = TouchEncoder(scene.frame.grid, spec).encode_segment([scene.frame]).body
    (record,) = BodyReader(body, scene.frame.grid, exact=False).records(1)
    assert not record.outliers
    assert costs[0].other == costs[1].other == len(record.payload)

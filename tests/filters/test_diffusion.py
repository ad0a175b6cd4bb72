"""Perona-Malik diffusion: properties, reference results, sparse against dense, and refused arguments."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import array_shapes, arrays
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.errors import InvalidArgument
from touchfield.filters.shading import DiffusionFilter, perona_malik
from touchfield.medium import ForceField, Grid


def by_the_formula(
    values: NDArray[np.float32], steps: int, kappa: float, where: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """The equation of the module in float64, edge by edge along each axis."""
    u, lam = values.astype(np.float64), 1 / (2 * where.ndim + 1)
    for _ in range(steps):
        change = np.zeros_like(u)
        for axis in range(where.ndim):
            low, high = [tuple(slice(*s) if a == axis else slice(None) for a in range(where.ndim))
                         for s in ((None, -1), (1, None))]  # fmt: skip
            d = u[high] - u[low]
            s = (d**2).sum(-1, keepdims=True) / kappa**2 if u.ndim > where.ndim else d**2 / kappa**2
            both = where[low] & where[high]
            flux = lam * np.exp(-s) * d * (both[..., None] if u.ndim > where.ndim else both)
            change[low] += flux
            change[high] -= flux
        u = u + change
    return u


def noisy(shape: tuple[int, ...], seed: int = 0) -> NDArray[np.float32]:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


# -- the equation ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [(21, 10, 17, 3), (40,), (9, 33), (17, 3, 9), (1, 8, 1, 3)])
def test_diffusion_agrees_with_the_equation(shape: tuple[int, ...]) -> None:
    values, space = noisy(shape), shape[:3]
    where = np.random.default_rng(1).random(space) < 0.8
    got = perona_malik(values, steps=4, kappa_n=1.2, where=where)
    assert got == pytest.approx(by_the_formula(values, 4, 1.2, where), abs=1e-5)
    assert np.abs(got - values).max() > 0.05
    assert np.array_equal(got[~where], values[~where])


@pytest.mark.parametrize("shape", [(50,), (20, 17), (9, 12, 17)])
def test_without_edges_diffusion_is_repeated_averaging(shape: tuple[int, ...]) -> None:
    values, lam = noisy(shape), 1 / (2 * len(shape) + 1)
    cross = lam * ndimage.generate_binary_structure(len(shape), 1).astype(np.float64)
    cross[(1,) * len(shape)] = 1 - 2 * len(shape) * lam
    expected = values.astype(np.float64)
    for _ in range(7):
        expected = ndimage.convolve(expected, cross, mode="reflect")
    for kappa in (math.inf, 1e6):
        assert perona_malik(values, steps=7, kappa_n=kappa) == pytest.approx(expected, abs=1e-5)


def test_blur_has_the_same_width_in_metres_along_each_axis() -> None:
    grid = Grid((61, 41, 31), (0.001, 0.002, 0.0015), (-0.03, -0.04, -0.0225))
    field = ForceField.from_support(grid, [[30, 20, 15]], [[0, 2.0, 0]])
    # diffusion in all of space
    everywhere = ForceField.from_dense(grid, field.to_dense() + np.float32([1e-30, 0, 0]))
    out = DiffusionFilter(math.inf, steps=25)(everywhere).to_dense()[..., 1].astype(np.float64)
    assert out.sum() == pytest.approx(2.0, rel=1e-6)
    for axis in range(3):
        line = out.sum(tuple(a for a in range(3) if a != axis)) / 2
        assert (line * grid.axis_m(axis) ** 2).sum() == pytest.approx(2 / 7 * 25 * 1e-6, rel=1e-3)


def test_edges_do_not_depend_on_the_spacing() -> None:
    grid = Grid((16, 16, 16), (0.001, 0.004, 0.001), (0, 0, 0))
    dense = np.zeros((16, 16, 16, 3), np.float32)
    dense[:, :8, :, 0], dense[:, 8:, :, 0] = 1, 2
    out = DiffusionFilter(0.2)(ForceField.from_dense(grid, dense)).to_dense()
    assert np.abs(out - dense).max() < 1e-6


def test_conductance_is_shared_by_the_components() -> None:
    rotation = np.linalg.qr(np.random.default_rng(4).normal(size=(3, 3)))[0]
    values = noisy((12, 9, 10, 3))
    rotated_first = perona_malik(values @ rotation.T, steps=5, kappa_n=1.0)
    rotated_last = perona_malik(values, steps=5, kappa_n=1.0) @ rotation.T
    assert rotated_first == pytest.approx(rotated_last, abs=1e-5)
    separate = np.stack([perona_malik(values[..., c], steps=5, kappa_n=1.0) for c in range(3)], axis=-1)
    assert np.abs(separate @ rotation.T - rotated_first).max() > 0.1


# -- laws --------------------------------------------------------------------------------------------------

numbers = st.floats(-1e3, 1e3, width=32)
shapes = array_shapes(min_dims=3, max_dims=3, max_side=10).map(lambda s: (*s, 3))


@given(arrays(np.float32, shapes, elements=numbers), st.sampled_from([1e-3, 0.3, 30.0, math.inf]))
def test_mean_and_maximum_principle(values: NDArray[np.float32], kappa: float) -> None:
    out = perona_malik(values, steps=3, kappa_n=kappa).astype(np.float64)
    before, size = values.astype(np.float64), float(np.abs(values).max())
    rounding = 3e-6 * size
    assert out.mean((0, 1, 2)) == pytest.approx(before.mean((0, 1, 2)), abs=rounding)
    assert (out.max((0, 1, 2)) <= before.max((0, 1, 2)) + rounding).all()
    assert (out.min((0, 1, 2)) >= before.min((0, 1, 2)) - rounding).all()
    assert np.linalg.norm(out, axis=-1).max() <= np.linalg.norm(before, axis=-1).max() + rounding


@given(
    arrays(np.float32, array_shapes(min_dims=1, max_dims=2, max_side=12), elements=numbers),
    st.floats(0.1, 100),
)
def test_mean_and_maximum_principle_of_images_and_lines(values: NDArray[np.float32], kappa: float) -> None:
    out = perona_malik(values, steps=5, kappa_n=kappa).astype(np.float64)
    rounding = 5e-6 * float(np.abs(values).max())
    assert out.mean() == pytest.approx(values.mean(dtype=np.float64), abs=rounding)
    assert values.min() - rounding <= out.min() and out.max() <= values.max() + rounding


def test_linear_step_diverges_beyond_its_limit() -> None:
    from touchfield.filters.shading import _diffuse

    start = noisy((1, 24, 24, 1))
    grid = Grid((1, 24, 24), (1.0, 1.0, 1.0), (0.0, 0.0, 0.0))
    field = ForceField.from_dense(grid, np.repeat(start, 3, axis=-1))
    max_n = {}
    for lam in (0.25, 0.6):
        law = DiffusionFilter(math.inf, steps=60)
        values = _diffuse(grid, field.bricks, field.mask, field.forces_n.copy(), [lam] * 3, law)
        max_n[lam] = float(np.abs(values).max())
    assert max_n[0.25] <= np.abs(start).max()
    assert max_n[0.6] > 1e20


def test_a_checkerboard_fades() -> None:
    board = ((np.indices((8, 8, 8)).sum(0) % 2) * 2 - 1).astype(np.float32)
    assert np.abs(perona_malik(board, steps=20, kappa_n=math.inf)).max() < 0.02


def test_edge_is_preserved_unlike_with_a_gaussian() -> None:
    clean = np.zeros((32, 24, 24, 3), np.float32)
    clean[16:, ..., 2] = 3.0
    noise = 0.05 * noisy(clean.shape)
    shaded = perona_malik(clean + noise, steps=20, kappa_n=0.5)
    sigma = math.sqrt(2 * 20 / 7)  # the blur of the same steps with g = 1
    blurred = np.stack([ndimage.gaussian_filter((clean + noise)[..., c], sigma) for c in range(3)], axis=-1)
    flat_region = slice(2, 10)
    assert shaded[flat_region].std() < 0.25 * noise[flat_region].std()
    across = {name: float((f[16] - f[15])[..., 2].mean()) for name, f in (("pm", shaded), ("gauss", blurred))}
    assert across["pm"] > 2.97
    assert across["gauss"] < 0.8


# -- sparse bricks -----------------------------------------------------------------------------------------


def test_sparse_agrees_with_dense(wavy_field: ForceField) -> None:
    field = wavy_field.on_grid(Grid(wavy_field.grid.shape, (0.001,) * 3, (0, 0, 0)))
    dense = field.to_dense()
    where = dense.any(axis=-1)
    expected = perona_malik(dense, steps=9, kappa_n=0.4, where=where)
    got = DiffusionFilter(0.4, 9)(field)
    assert np.array_equal(got.to_dense(), expected)
    assert got == ForceField.from_dense(field.grid, expected)  # no empty brick


def test_the_same_bits_for_any_number_of_threads(
    wavy_field: ForceField, monkeypatch: pytest.MonkeyPatch
) -> None:
    dense = noisy((70, 50, 41, 3))
    results = []
    for threads in ("1", "2", "5"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append((DiffusionFilter(0.4)(wavy_field), perona_malik(dense, steps=2, kappa_n=1.0)))
    for field, array in results[1:]:
        assert field == results[0][0] and np.array_equal(array, results[0][1])


def test_forces_do_not_diffuse_across_empty_space() -> None:
    grid = Grid((40, 20, 20), (0.001,) * 3, (0, 0, 0))
    dense = np.zeros((40, 20, 20, 3), np.float32)
    dense[3:9] = np.abs(noisy((6, 20, 20, 3))) + 0.1
    alone = ForceField.from_dense(grid, dense)
    dense[10:30] = 5.0
    both = ForceField.from_dense(grid, dense)
    step = DiffusionFilter(math.inf, 15)
    assert np.array_equal(step(alone).to_dense()[:10], step(both).to_dense()[:10])
    assert np.array_equal(step(both).mask, both.mask)
    assert step(both).to_dense()[10:30] == pytest.approx(5.0, rel=1e-5)


@given(st.integers(1, 12))
def test_claims_of_reach_support_and_mean(steps: int) -> None:
    grid = Grid((30, 30, 30), (0.001, 0.001, 0.002), (0, 0, 0))
    positions = [[14, 15, 15], [15, 15, 15], [15, 16, 15], [15, 16, 16]]
    forces = np.array([[1, 0, 0], [1, 0.2, 0], [0.8, 0, 0.1], [1, 1, 1]], np.float32)
    step = DiffusionFilter(0.7, steps)
    filtered = step(ForceField.from_support(grid, positions, forces))
    filtered_changed = step(
        ForceField.from_support(grid, positions, forces + np.float32([0, 0, 0.5]) * np.eye(4, 1))
    )
    reach, claims = (steps,) * 3, step.claims(grid)
    assert claims.reach == reach and claims.keeps_mean and claims.max_principle and not claims.linear
    assert claims.keeps_support
    assert np.abs(filtered.positions() - 15).max() <= 1
    changed = np.argwhere((filtered.to_dense() != filtered_changed.to_dense()).any(-1))
    assert np.abs(changed - [14, 15, 15]).max() <= steps
    assert filtered.vectors_n().sum(0, dtype=float) == pytest.approx(forces.sum(0), abs=1e-5)


def test_empty_fields_flat_grids_and_forces_that_cancel() -> None:
    flat = Grid((32, 20, 1), (0.01, 0.01, 0.001), (0, 0, 0))
    empty = ForceField.empty(flat)
    assert DiffusionFilter(1.0)(empty) == empty
    values = noisy((32, 20, 1, 3))
    got = DiffusionFilter(1.0, 3)(ForceField.from_dense(flat, values)).to_dense()
    assert got == pytest.approx(perona_malik(values, steps=3, kappa_n=1.0), abs=1e-6)
    corner = [[7, 7, 7], [8, 7, 7], [7, 8, 7], [7, 7, 8]]  # alone in its brick, adjacent to three others
    forces = [[3, 0, 0], [-4, 0, 0], [-4, 0, 0], [-4, 0, 0]]
    crossed = ForceField.from_support(Grid((16,) * 3, (1, 1, 1), (0, 0, 0)), corner, forces)
    gone = DiffusionFilter(math.inf, 1)(crossed)
    assert len(crossed.bricks) == 4 and gone.bricks.tolist() == [[0, 0, 1], [0, 1, 0], [1, 0, 0]]


# -- words and refusals ------------------------------------------------------------------------------------


def test_text_round_trip() -> None:
    assert DiffusionFilter.parse("steps=10,kappa=0.3") == DiffusionFilter(0.3, 10)
    older_text = "0.3, region=support,conductance=exponential"  # the notation of older streams
    assert DiffusionFilter.parse(older_text) == DiffusionFilter(0.3)
    for step in (DiffusionFilter(0.25, 3), DiffusionFilter(math.inf, 7)):
        assert DiffusionFilter.parse(step.text) == step
    with pytest.raises(InvalidArgument, match="each of kappa, steps at most once"):
        DiffusionFilter.parse("0.3,lam=0.1")
    with pytest.raises(InvalidArgument, match="no kappa"):
        DiffusionFilter.parse("steps=3")


@pytest.mark.parametrize(
    "wrong",
    [
        {"steps": 0}, {"steps": 1.5}, {"steps": True}, {"steps": 10_001}, {"kappa_n": 0.0}, {"kappa_n": -1.0},
        {"kappa_n": math.nan}, {"kappa_n": 1e-40},
    ],
)  # fmt: skip
def test_invalid_numbers_are_refused(wrong: dict[str, object]) -> None:
    name = next(iter(wrong))
    with pytest.raises(InvalidArgument, match=name):
        DiffusionFilter(**{"kappa_n": 1.0, **wrong})  # type: ignore[arg-type]
    with pytest.raises(InvalidArgument, match=name):
        perona_malik(np.zeros((4, 4, 4, 3)), **{"steps": 1, "kappa_n": 1.0, **wrong})  # type: ignore[arg-type]


def test_invalid_arrays_are_refused() -> None:
    for values in (np.zeros((2, 2, 2, 2)), np.zeros((2, 2, 2, 2, 3)), np.zeros((0, 3)), np.float32(3)):
        with pytest.raises(InvalidArgument, match="values"):
            perona_malik(values, steps=1, kappa_n=1.0)
    for bad in (math.nan, math.inf):
        with pytest.raises(InvalidArgument, match="finite"):
            perona_malik(np.float32([0, bad, 1]), steps=1, kappa_n=1.0)
    with pytest.raises(InvalidArgument, match="beyond float32"):
        perona_malik(np.float32([3e38, -3e38]), steps=1, kappa_n=1.0)
    for where in (np.ones(3, bool), np.ones((4, 4), bool), np.ones(4)):
        with pytest.raises(InvalidArgument, match="where"):
            perona_malik(np.zeros(4), steps=1, kappa_n=1.0, where=where)
    with pytest.raises(InvalidArgument, match="region=all"):
        DiffusionFilter.parse("0.3,region=all")
    positions, forces = [[0, 0, 0], [0, 0, 1]], [[3e38, 0, 0], [-3e38, 0, 0]]
    huge = ForceField.from_support(Grid((2, 2, 2), (1, 1, 1), (0, 0, 0)), positions, forces)
    with pytest.raises(InvalidArgument, match="beyond float32"):
        DiffusionFilter(1.0)(huge)

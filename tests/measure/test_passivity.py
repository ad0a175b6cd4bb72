"""Curl and the work around squares and loops, compared with fields of known curl and work."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from touchfield.codec.paper.directions import Codebook
from touchfield.errors import InvalidArgument
from touchfield.measure.passivity import loop_work_j, passivity
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.tasks.measure import MeasureSpec, measure_medium

Float64s = NDArray[np.float64]
GRID = Grid((21, 18, 17), (0.001, 0.002, 0.0015), (-0.01, 0.003, 0.02))
vectors = arrays(np.float64, 3, elements=st.floats(-100, 100))


def field_of(formula: Callable[[Float64s], Float64s], grid: Grid = GRID) -> ForceField:
    """The forces [..., 3] of a formula of points [..., 3], metres, on a whole grid."""
    return ForceField.from_dense(grid, formula(grid.to_m(np.stack(np.indices(grid.shape), axis=-1))))


def rotation(omega_n_per_m: Float64s, grid: Grid = GRID) -> ForceField:
    """F = omega x r, plus a constant force so that no sample of the grid is zero."""
    return field_of(lambda p: np.cross(omega_n_per_m, p) + 40.0, grid)


def shell(samples: int, stiffness_n_per_m: float = 500.0) -> ForceField:
    """A penalty sphere of 40 mm, from a radius of 25 mm, in a box of 100 mm with `samples` per edge."""
    grid = Grid.over_box((-0.05,) * 3, (0.05,) * 3, (samples,) * 3)

    def forces(p: Float64s) -> Float64s:
        r = np.linalg.norm(p, axis=-1, keepdims=True)
        is_inside = (r > 0.025) & (r < 0.04)
        return np.where(is_inside, stiffness_n_per_m * (0.04 - r), 0) * p / np.maximum(r, 1e-9)

    return field_of(forces, grid)


def with_directions(field: ForceField, name: str) -> ForceField:
    """The same amplitudes with directions from a codebook."""
    support, book = field.support(), Codebook.get(name)
    quantised = book.vertices[book.nearest(support.directions)] * support.amplitudes_n[:, None]
    return ForceField.from_support(field.grid, support.positions, quantised)


# -- curl --------------------------------------------------------------------------------------------------


@given(vectors)
def test_curl_of_a_rotation_is_twice_its_rate(omega: Float64s) -> None:
    found, rate = passivity(rotation(omega)), float(np.linalg.norm(omega))
    assert found.points == 19 * 16 * 15
    for curl in (found.rms_curl_n_per_m, found.worst_curl_n_per_m):
        assert curl == pytest.approx(2 * rate, abs=0.02 + 1e-4 * rate)


def test_relative_curl_of_a_rotation_is_one() -> None:
    found = passivity(rotation(np.array([30.0, -20.0, 60.0])))
    assert found.relative_curl == pytest.approx(1, abs=1e-5)
    assert found.rms_curl_n_per_m == pytest.approx(140, rel=1e-4)
    assert found.worst_curl_n_per_m == pytest.approx(140, rel=1e-3)
    assert found.rms_gradient_n_per_m == pytest.approx(70 * math.sqrt(2), rel=1e-4)


@given(arrays(np.float64, (3, 3), elements=st.floats(-100, 100)))
def test_gradient_of_a_potential_has_no_curl(matrix: Float64s) -> None:
    symmetric = matrix + matrix.T
    found = passivity(field_of(lambda p: p @ symmetric + 40.0))
    assert found.rms_curl_n_per_m < 0.01 + 1e-4 * np.abs(symmetric).max()
    assert found.rms_gradient_n_per_m == pytest.approx(np.linalg.norm(symmetric), rel=1e-3, abs=0.02)
    assert found.worst_square_j < 1e-7


def test_uniform_force_has_no_curl_and_work() -> None:
    found = passivity(field_of(lambda p: np.full(p.shape, 2.0)))
    assert (found.rms_curl_n_per_m, found.relative_curl, found.rms_square_j) == (0, 0, 0)


def dense_curl(field: ForceField) -> tuple[Float64s, Float64s]:
    """Samples with all neighbours in the support [m, 3], and the curl [x, y, z, 3] by numpy.gradient."""
    dense = field.to_dense().astype(float)
    supported = np.pad((dense != 0).any(axis=-1), 1)
    is_inner = supported.copy()
    for axis in range(3):
        is_inner &= np.roll(supported, 1, axis) & np.roll(supported, -1, axis)
    d = [np.gradient(dense, h, axis=a) for a, h in enumerate(field.grid.spacing_m)]
    curl = np.stack(
        [d[1][..., 2] - d[2][..., 1], d[2][..., 0] - d[0][..., 2], d[0][..., 1] - d[1][..., 0]], axis=-1
    )
    return np.argwhere(is_inner[1:-1, 1:-1, 1:-1]), curl


def test_curl_against_numpy_within_the_support(wavy_field: ForceField) -> None:
    for field in (wavy_field, shell(28), with_directions(shell(28), "ico3")):
        expected, curl = dense_curl(field)
        assert len(expected) > 50
        found = passivity(field)
        lengths = np.linalg.norm(curl[tuple(expected.T)], axis=1)
        assert found.points == len(expected)
        assert found.share_seen == len(expected) / field.support_count
        assert found.worst_curl_n_per_m == pytest.approx(lengths.max(), rel=1e-6)
        assert found.rms_curl_n_per_m == pytest.approx(np.sqrt((lengths**2).mean()), rel=1e-6)


# -- squares -----------------------------------------------------------------------------------------------


def square_works(field: ForceField) -> Float64s:
    """The work around every square of the support, with Python loops over dense arrays."""
    dense = field.to_dense().astype(float)
    supported = (dense != 0).any(axis=-1)
    works = []
    for a in range(3):
        b = (a + 1) % 3
        step_a, step_b = np.eye(3, dtype=int)[a], np.eye(3, dtype=int)[b]
        for p in np.argwhere(np.ones(field.grid.shape)):
            corners = [p, p + step_a, p + step_a + step_b, p + step_b]
            if (corners[2] >= field.grid.shape).any():
                continue
            if not all(supported[tuple(c)] for c in corners):
                continue
            f = [dense[tuple(c)] for c in corners]
            steps = [
                (np.array(v) - u) * field.grid.spacing_m for u, v in zip(corners, corners[1:] + corners[:1])
            ]
            works.append(sum((f[i] + f[(i + 1) % 4]) @ steps[i] / 2 for i in range(4)))
    return np.array(works)


def test_squares_one_by_one(wavy_field: ForceField) -> None:
    works = square_works(wavy_field)
    found = passivity(wavy_field)
    assert found.squares == len(works)
    assert found.rms_square_j == pytest.approx(np.sqrt((works**2).mean()), rel=1e-9)
    assert found.worst_square_j == pytest.approx(np.abs(works).max(), rel=1e-9)


def test_squares_of_a_rotation() -> None:
    grid = Grid((9, 9, 9), (0.01, 0.02, 0.03), (0, 0, 0))
    found = passivity(rotation(np.array([0, 0, 50.0]), grid))
    assert found.squares == 3 * 8 * 8 * 9
    assert found.worst_square_j == pytest.approx(2 * 50 * 0.01 * 0.02, rel=1e-4)
    assert found.rms_square_j == pytest.approx(2 * 50 * 0.01 * 0.02 / math.sqrt(3), rel=1e-4)


# -- loops -------------------------------------------------------------------------------------------------


def star(centre_m: Float64s, u: Float64s, v: Float64s, corners: int = 24) -> Float64s:
    turn = np.arange(corners) * 2 * np.pi / corners
    return centre_m + np.cos(turn)[:, None] * u + np.sin(turn)[:, None] * v


@given(vectors, vectors, vectors)
def test_loop_work_of_a_rotation_is_twice_rate_times_area(omega: Float64s, u: Float64s, v: Float64s) -> None:
    u, v = u * 6e-5, v * 6e-5  # within the box of the grid
    path = star(GRID.to_m([10, 8.5, 8]), u, v)
    area = 12 * math.sin(2 * math.pi / 24) * np.cross(u, v)  # area of the polygon, as a vector
    work = loop_work_j(rotation(omega), path)
    assert work == pytest.approx(2 * omega @ area, rel=1e-5, abs=1e-7)
    assert loop_work_j(rotation(omega), path[::-1]) == pytest.approx(-work, rel=1e-5, abs=1e-7)


@given(arrays(np.float64, (5, 3), elements=st.floats(-3, 20)))
def test_loop_work_is_exact_for_the_renderer(corners: Float64s) -> None:
    """Compared with 10,000 short steps through the same interpolated field, including its border."""
    rng = np.random.default_rng(3)
    field = ForceField.from_dense(GRID, rng.normal(size=(*GRID.shape, 3)))
    path = GRID.to_m(corners)
    fraction = (np.arange(10000) + 0.5)[:, None] / 10000
    total, length = 0.0, 0.0
    for a, b in zip(path, np.roll(path, -1, axis=0)):
        total += (field.sample_n(a + fraction * (b - a)).astype(float).mean(axis=0) * (b - a)).sum()
        length += float(np.linalg.norm(b - a))
    assert loop_work_j(field, path) == pytest.approx(total, abs=2e-5 * length)


def test_square_of_the_lattice_is_a_loop(wavy_field: ForceField) -> None:
    corners = wavy_field.grid.to_m([[10, 9, 9], [11, 9, 9], [11, 10, 9], [10, 10, 9]])
    dense = wavy_field.to_dense().astype(float)
    a, b, c, d = dense[10, 9, 9], dense[11, 9, 9], dense[11, 10, 9], dense[10, 10, 9]
    hx, hy, _ = wavy_field.grid.spacing_m
    expected = hx / 2 * (a + b - c - d)[0] + hy / 2 * (b + c - d - a)[1]
    assert expected != 0
    assert loop_work_j(wavy_field, corners) == pytest.approx(expected, rel=1e-5)


def test_long_paths_are_processed_in_chunks(monkeypatch: pytest.MonkeyPatch, wavy_field: ForceField) -> None:
    path = wavy_field.grid.to_m(np.random.default_rng(1).uniform(0, 16, (300, 3)))
    expected = loop_work_j(wavy_field, path)
    monkeypatch.setattr(sys.modules["touchfield.measure.passivity"], "_PIECES_AT_ONCE", 100)
    assert loop_work_j(wavy_field, path) == pytest.approx(expected, rel=1e-12)
    assert expected != 0


def test_path_outside_the_field_does_no_work() -> None:
    field = rotation(np.array([0, 0, 50.0]))
    assert loop_work_j(field, np.array([[1, 1, 1], [2, 1, 1], [2, 2, 1]])) == 0
    assert loop_work_j(field, 1e5 * np.array([[1, 1, 1], [2, 1, 1], [2, 2, 1]])) == 0
    assert loop_work_j(field, np.array([[0.001, 0.01, 0.03]] * 3)) == 0  # a hand at rest


# -- passive, and not --------------------------------------------------------------------------------------


def test_penalty_sphere_is_passive_within_the_lattice_error() -> None:
    coarse, fine = (passivity(shell(n)) for n in (48, 96))
    assert coarse.relative_curl < 0.01
    assert coarse.rms_curl_n_per_m / fine.rms_curl_n_per_m == pytest.approx(4, rel=0.25)  # second order
    assert coarse.rms_square_j / fine.rms_square_j == pytest.approx(16, rel=0.3)  # multiplied by the area
    assert fine.worst_square_j < coarse.worst_square_j / 10 < 1e-6  # compared with 7 N along 0.1 m


@pytest.mark.parametrize("book", ["ico1", "ico3", "ico5"])
def test_quantised_directions_are_not_passive(book: str) -> None:
    field = shell(48)
    smooth, quantised = passivity(field), passivity(with_directions(field, book))
    assert quantised.support_count == smooth.support_count
    assert quantised.relative_curl > 10 * smooth.relative_curl
    assert quantised.rms_square_j > 10 * smooth.rms_square_j
    assert quantised.worst_square_j > 20 * smooth.worst_square_j


def test_edge_of_a_wall_counts_only_for_paths_across_it() -> None:
    """A slab that ends within the grid is passive inside, but a path across its edge can gain energy."""

    def forces(p: Float64s) -> Float64s:
        inside = (np.abs(p[..., 0]) < 0.006) & (p[..., 2] < 0.035)
        return np.stack(
            [np.zeros(inside.shape), np.zeros(inside.shape), inside * 400 * (0.04 - p[..., 2])], axis=-1
        )

    field = field_of(forces)
    inner, low, high = passivity(field), *np.array([[0.0, 0.02, 0.021], [0.009, 0.02, 0.031]])
    loop_m = [low, [0, 0.02, high[2]], high, [high[0], 0.02, low[2]]]  # up inside the slab, and down outside
    assert inner.rms_curl_n_per_m < 1e-3 and inner.worst_square_j < 1e-8
    assert loop_work_j(field, loop_m) == pytest.approx(400 * (0.04 * 0.01 - 0.00026), rel=0.02)


def test_threads_do_not_change_a_bit(monkeypatch: pytest.MonkeyPatch) -> None:
    field = with_directions(shell(64), "ico3")
    monkeypatch.setenv("TOUCHFIELD_THREADS", "1")
    single_threaded = passivity(field)
    monkeypatch.setenv("TOUCHFIELD_THREADS", "3")
    assert passivity(field) == single_threaded


# -- little to see -----------------------------------------------------------------------------------------


def test_a_sheet_has_squares_and_no_curl() -> None:
    sheet = rotation(np.array([0, 0, 50.0]), Grid((12, 12, 1), (0.01,) * 3, (0, 0, 0)))
    found = passivity(sheet)
    assert found.points == 0 and math.isnan(found.rms_curl_n_per_m) and math.isnan(found.relative_curl)
    assert found.squares == 11 * 11 and found.rms_square_j == pytest.approx(2 * 50 * 1e-4, rel=1e-4)
    assert any("too thin (axis z has 1 samples)" in n for n in found.notes)
    pair = passivity(rotation(np.array([0, 0, 50.0]), Grid((6, 6, 2), (0.01,) * 3, (0, 0, 0))))
    assert any("too thin (axis z has 2 samples)" in n for n in pair.notes)


def test_single_force() -> None:
    found = passivity(ForceField.from_support(GRID, [[4, 4, 4]], [[1.0, 0, 0]]))
    assert (found.points, found.squares) == (0, 0) and math.isnan(found.worst_square_j)
    assert len(found.notes) == 2


def test_the_summary_is_json() -> None:
    found = passivity(shell(24))
    table = json.loads(json.dumps(found.summary()))
    assert table["worst_square_j"] == found.worst_square_j > 0 and table["notes"] == list(found.notes)
    sheet = rotation(np.ones(3), Grid((12, 12, 1), (0.01,) * 3, (0, 0, 0)))
    assert passivity(sheet).summary()["rms_curl_n_per_m"] is None


# -- bad input ---------------------------------------------------------------------------------------------


def test_passivity_of_a_medium_is_that_of_its_largest_frame(wavy_field: ForceField) -> None:
    small = ForceField.from_support(
        wavy_field.grid, wavy_field.positions()[:300], wavy_field.vectors_n()[:300]
    )
    medium = HapticMedium.from_frames([small, wavy_field, small], 30.0)
    found = measure_medium(medium, MeasureSpec(limits=False)).passivity
    assert (
        found is not None and found.summary() == passivity(wavy_field).summary() != passivity(small).summary()
    )


def test_an_empty_field_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="force_field: found a field without any force"):
        passivity(ForceField.empty(GRID))


@pytest.mark.parametrize(
    "path", [np.zeros((2, 3)), np.zeros((4, 2)), np.zeros(3), [[0, 0, 0], [0, 0, math.nan], [1, 1, 1]],
             [[0, 0, 0], [0, 0, math.inf], [1, 1, 1]], [[0, 0, 0], [0, 0, 1e308], [1, 1, 1]]],
)  # fmt: skip
def test_invalid_paths_are_refused(path: object) -> None:
    with pytest.raises(InvalidArgument, match="path_m"):
        loop_work_j(rotation(np.ones(3)), path)  # type: ignore[arg-type]

"""The direction codebooks: covering radii, symmetry, and the exact nearest vertex."""

from __future__ import annotations

import hashlib

import numpy as np
import pytest
from hypothesis import given, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import ConvexHull

from touchfield.codec.paper.directions import Codebook, codebook_names
from touchfield.codec.paper.quantisers import weber_ladder, weber_levels
from touchfield.errors import InvalidArgument

COVERING_DEG = {
    "ico1": 37.38,
    "ico2": 20.91,
    "ico5": 8.43,
    "octa3": 10.03,
    "ico8": 5.26,
}
CHORD_DB = {
    "ico1": -7.74,
    "ico2": -13.13,
    "ico3": -16.53,
    "ico5": -20.94,
    "octa3": -20.75,
}


def brute_force(codebook, vectors):
    x = vectors.astype(np.float64)
    pieces = [(x[i : i + 50_000] @ codebook.vertices.T).argmax(axis=1) for i in range(0, len(x), 50_000)]
    return np.concatenate(pieces)


def assert_nearest(codebook, vectors):
    found, best = codebook.nearest(vectors), brute_force(codebook, vectors)
    differs = found != best
    x = vectors[differs].astype(np.float64)
    found_dots, best_dots = (
        (x * codebook.vertices[vertices[differs]]).sum(axis=1) for vertices in (found, best)
    )
    assert (
        np.abs(found_dots - best_dots) <= 4e-16 * np.linalg.norm(x, axis=1)
    ).all()  # a tie, broken by rounding
    return found


def random_vectors(count, seed=0):
    return np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)


# -- the polyhedra -----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", codebook_names())
def test_every_codebook_has_its_count_unit_vectors_and_symmetry(name):
    codebook = Codebook.get(name)
    frequency = int("".join(c for c in name if c.isdigit()))
    assert len(codebook) == (10 * frequency**2 + 2 if name.startswith("ico") else 4 ** (frequency + 1) + 2)
    assert len(codebook.faces) == 2 * len(codebook) - 4  # Euler: a closed surface of triangles
    v = codebook.vertices
    np.testing.assert_allclose(np.linalg.norm(v, axis=1), 1, atol=2e-12)
    np.testing.assert_array_equal(v, -v[::-1])  # the opposite of i is N - 1 - i
    points = {tuple(p) for p in v.tolist()}
    assert points == {tuple(p) for p in v[:, [1, 2, 0]].tolist()}
    assert points == {tuple(p) for p in (v * [-1, 1, 1] + 0.0).tolist()}


@pytest.mark.parametrize(("name", "degrees"), COVERING_DEG.items())
def test_the_covering_radius_is_that_of_the_table(name, degrees):
    codebook = Codebook.get(name)
    hull = ConvexHull(codebook.vertices)
    measured = np.degrees(np.arccos(-hull.equations[:, 3].max()))
    assert measured == pytest.approx(degrees, abs=0.02)
    assert codebook.covering_radius_deg == pytest.approx(measured, abs=1e-4)


def test_the_covering_radius_of_the_icosahedron_is_exact():
    expected = np.degrees(np.arccos(np.sqrt((5 + 2 * np.sqrt(5)) / 15)))
    assert Codebook.get("ico1").covering_radius_deg == pytest.approx(expected, abs=1e-9)
    assert expected == pytest.approx(37.377, abs=5e-4)


@pytest.mark.parametrize(("name", "db"), CHORD_DB.items())
def test_the_mean_square_chord_is_that_of_the_table(name, db):
    codebook = Codebook.get(name)
    x = random_vectors(500_000)
    cosine = (codebook.vertices[codebook.nearest(x)] * x).sum(axis=1) / np.sqrt(
        (x.astype(float) ** 2).sum(axis=1)
    )
    assert 10 * np.log10(np.mean(2 - 2 * cosine)) == pytest.approx(db, abs=0.05)


PINNED = {
    "ico3": "081a31d353c11cb3",
    "ico5": "6b8be984e105f4c2",
    "ico20": "cbcc295109409d15",
    "octa3": "e56e1f150f110e0e",
}


def test_the_vertices_are_the_same_on_every_machine():
    """The codebooks' bits are part of the format: a change of a digest is a change of the format."""
    bits = {
        n: hashlib.sha256(Codebook.get(n).vertices.astype("<f8").tobytes()).hexdigest()[:16] for n in PINNED
    }
    assert bits == PINNED


@pytest.mark.parametrize(
    "name", ["ico", "ico0", "ico21", "ico05", "octa6", "ico2-flat", "octa3-flat", "", "ico5 ", 5]
)
def test_unknown_names_are_refused(name):
    with pytest.raises(InvalidArgument, match="directions"):
        Codebook.get(name)


# -- the nearest vertex ------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ico5", "octa3"])
def test_the_nearest_of_many_random_vectors(name):
    assert_nearest(Codebook.get(name), random_vectors(500_000, 1))


@pytest.mark.parametrize("name", ["ico1", "ico3", "ico8", "ico20", "octa1", "octa4"])
def test_the_nearest_of_random_vectors(name):
    found = assert_nearest(Codebook.get(name), random_vectors(60_000, 2))
    assert len(np.unique(found)) == len(Codebook.get(name))


@pytest.mark.parametrize("name", ["ico1", "ico5", "octa3", "ico20"])
def test_the_nearest_at_the_borders_of_voronoi_cells(name):
    codebook = Codebook.get(name)
    a, b, c = (codebook.vertices[codebook.faces[:, i]] for i in range(3))
    for at in (a + b, b + c, np.cross(b - a, c - a), 0.9 * a + 1.1 * b):
        for offset in (0.0, 1e-7):
            assert_nearest(codebook, (at + offset * (a - b)).astype(np.float32))


@given(arrays(np.float32, (20, 3), elements=st.floats(width=32, allow_nan=False, allow_infinity=False)))
def test_the_nearest_of_vectors_of_any_length(vectors):
    codebook = Codebook.get("ico5")
    scaled = vectors.astype(np.float64)
    size = np.abs(scaled).max(axis=1)
    nonzero = size > 0
    found = codebook.nearest(vectors)
    assert (found[~nonzero] == 0).all()
    dots = (scaled[nonzero] / size[nonzero, None]) @ codebook.vertices.T
    found_dots = np.take_along_axis(dots, found[nonzero, None].astype(np.int64), axis=1)[:, 0]
    assert (found_dots >= dots.max(axis=1) - 1e-15).all()


def test_a_vertex_is_nearest_to_itself():
    for name in ("ico5", "octa3", "ico20"):
        codebook = Codebook.get(name)
        np.testing.assert_array_equal(codebook.nearest(codebook.vertices_float32), np.arange(len(codebook)))


def test_vectors_that_are_not_finite_are_refused():
    codebook = Codebook.get("ico3")
    for bad in (np.nan, np.inf, -np.inf):
        with pytest.raises(InvalidArgument, match="finite"):
            codebook.nearest(np.array([[1, 0, 0], [0, bad, 0]], np.float32))
    with pytest.raises(InvalidArgument, match="shape"):
        codebook.nearest(np.zeros((3, 2), np.float32))
    assert codebook.nearest(np.zeros((0, 3), np.float32)).shape == (0,)


# -- amplitude and direction together ----------------------------------------------------------------------


@pytest.mark.parametrize(("name", "k"), [("ico3", 0.25), ("ico5", 0.1), ("octa3", 0.05)])
def test_the_error_of_amplitude_and_direction_together_is_bounded(name, k):
    """Relative error^2 <= e_r^2 + 2 (1 + k) (1 - cos theta_c), with the amplitude quantised separately."""
    codebook, table = Codebook.get(name), weber_levels(weber_ladder(k, 10.0))
    x = random_vectors(100_000, 5)
    size = np.sqrt((x.astype(np.float64) ** 2).sum(axis=1))
    amplitude = table.levels_n[table.encode(size.astype(np.float32))]
    decoded = amplitude[:, None] * codebook.vertices_float32[codebook.nearest(x)]
    above_floor = size > 0.031
    errors = ((decoded.astype(float) - x) ** 2).sum(axis=1)[above_floor] / size[above_floor] ** 2
    bound = k**2 + 2 * (1 + k) * (1 - np.cos(np.radians(codebook.covering_radius_deg)))
    assert 0.7 * bound < errors.max() <= bound * (1 + 1e-6)

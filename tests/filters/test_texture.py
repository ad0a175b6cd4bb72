"""The haptic texture: impulses compared with splitmix64 and a dense reference, and its limits."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy import ndimage, stats

from touchfield.errors import InvalidArgument
from touchfield.filters import contact
from touchfield.filters.contact import TextureFilter
from touchfield.filters.fir import frequency_response
from touchfield.filters.registry import filter_and_limit
from touchfield.measure.estimators import entropy_bits
from touchfield.medium import ForceField, Grid, HapticMedium

WORD = (1 << 64) - 1
GOLDEN = 0x9E3779B97F4A7C15


def mix64(z: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """splitmix64's output function, after its reference source in C."""
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def impulses(grains: tuple[NDArray[np.int64], ...], seed: int, density: float) -> NDArray[np.float64]:
    """+1, -1 or 0 at grains x, y, z, as defined in the docstring of the filter."""
    x, y, z = ((g + 1).astype(np.uint64) for g in grains)
    key = mix64(np.array([(seed + GOLDEN) & WORD], np.uint64))
    bits = mix64(key + ((x | y << np.uint64(21) | z << np.uint64(42)) + np.uint64(1)) * np.uint64(GOLDEN))
    drawn = (bits >> np.uint64(11)).astype(np.float64) / 2**53 < density
    return np.where(drawn, np.where(bits & np.uint64(1), 1.0, -1.0), 0.0)


def texture_gains(grid: Grid, texture: TextureFilter, grain: tuple[int, int, int]) -> NDArray[np.float64]:
    """The change at each sample as a fraction of |F|, dense, float64 [nx, ny, nz]."""
    half = [int(n > 1) for n in grid.shape]
    grain_indices = [
        np.arange(-h, (n - 1) // g + 1 + h) for n, g, h in zip(grid.shape, grain, half, strict=True)
    ]
    s = impulses(tuple(np.meshgrid(*grain_indices, indexing="ij")), texture.seed, texture.density)
    box = np.ones([2 * h + 1 for h in half])
    high = s - ndimage.correlate(s, box / box.size, mode="constant")
    inner = high[tuple(slice(h, len(p) - h) for h, p in zip(half, grain_indices, strict=True))]
    gain = texture.rms / np.sqrt(texture.density * (1 - 1 / box.size))
    of_sample = np.ix_(*[np.arange(n) // g for n, g in zip(grid.shape, grain, strict=True)])
    return np.clip(gain * inner[of_sample], -1, 1)


def cube(n: int) -> Grid:
    return Grid((n, n, n), (1e-3,) * 3, (0.0, 0.0, 0.0))


def noise(grid: Grid, seed: int, density: float = 0.3) -> ForceField:
    rng = np.random.default_rng(seed)
    supported = rng.random(grid.shape) < density
    return ForceField.from_dense(grid, rng.normal(size=(*grid.shape, 3)) * supported[..., None])


def constant(grid: Grid, force: tuple[float, float, float] = (0.3, -0.4, 1.2)) -> ForceField:
    return ForceField.from_dense(grid, np.broadcast_to(np.float32(force), (*grid.shape, 3)))


def amplitudes(field: ForceField) -> NDArray[np.float64]:
    return np.linalg.norm(field.to_dense().astype(float), axis=-1)


# -- salt and pepper ---------------------------------------------------------------------------------------


def test_hash_is_splitmix64() -> None:
    for seed, expected in (
        (0, [0xE220A8397B1DCDAF, 0x6E789E6AA1B965F4, 0x06C45D188009454F]),
        (1234567, [6457827717110365317, 3203168211198807973, 9817491932198370423]),
    ):
        states = [np.uint64((seed + n * GOLDEN) & WORD) for n in (1, 2, 3)]
        assert [int(contact.splitmix64(s)) for s in states] == expected
        assert mix64(np.array(states)).tolist() == expected


@settings(max_examples=25)
@given(
    st.tuples(*[st.integers(1, 20)] * 3).filter(lambda s: max(s) > 1),
    st.tuples(*[st.integers(1, 9)] * 3),
    st.integers(0, WORD),
    st.sampled_from([(0.05, 0.1), (0.5, 0.2), (1.0, 1.0)]),
)
def test_texture_agrees_with_the_dense_formula(
    shape: tuple[int, int, int], grain: tuple[int, int, int], seed: int, law: tuple[float, float]
) -> None:
    grain = tuple(min(g, n) for g, n in zip(grain, shape, strict=True))
    grid = Grid(shape, tuple(0.012 / g for g in grain), (0.0, 0.0, 0.0))
    texture = TextureFilter("salt-pepper", seed, law[0], law[1], 0.012)
    field = noise(grid, 1, 0.5)
    expected = field.to_dense() * (1 + texture_gains(grid, texture, grain))[..., None]
    assert np.abs(texture(field).to_dense() - expected).max() < 1e-6


def test_impulses_are_sparse_balanced_and_independent() -> None:
    grain_indices = np.meshgrid(*[np.arange(-1, 63)] * 3, indexing="ij")
    n = 64**3
    s = impulses(tuple(grain_indices), 7, 0.05)
    assert abs(np.count_nonzero(s) - 0.05 * n) < 4 * np.sqrt(0.05 * 0.95 * n)
    assert abs(s.sum()) < 4 * np.sqrt(0.05 * n)
    for variant in (
        np.roll(s, 1, 0),
        np.roll(s, 1, 1),
        np.roll(s, 1, 2),
        impulses(tuple(grain_indices), 8, 0.05),
    ):
        assert abs((s * variant).sum()) < 4 * 0.05 * np.sqrt(n)  # the product of two has variance density^2
    runs = [np.count_nonzero(block) for block in s.reshape(-1, 512)]
    assert stats.chisquare(runs).pvalue > 0.01


@pytest.mark.parametrize(
    "text", ["rms=0.1", "rms=0.2,density=0.2,seed=9", "rms=0.1,grain=2mm,seed=4", "rms=0"]
)
def test_texture_has_the_requested_rms_and_zero_mean(text: str) -> None:
    texture = TextureFilter.parse(text)
    grid = cube(64)
    fraction = amplitudes(texture(constant(grid))) / 1.3 - 1
    assert np.sqrt(np.mean(fraction**2)) == pytest.approx(texture.rms, rel=0.02, abs=1e-7)
    assert abs(fraction.mean()) < 0.01 * texture.rms + 1e-7


def test_high_pass_has_zero_dc() -> None:
    """DC = 0: an impulse far from the border does not change the sum."""
    h = -np.ones((3, 3, 3)) / 27
    h[1, 1, 1] += 1
    assert abs(frequency_response(h, 0.0, 0.0, 0.0)) < 1e-15
    texture = TextureFilter(density=1e-4, rms=0.01, seed=2)
    grid = cube(32)
    added = texture_gains(grid, texture, (1, 1, 1))
    inner = impulses(tuple(np.meshgrid(*[np.arange(32)] * 3, indexing="ij")), 2, 1e-4)
    impulse_positions = np.argwhere(inner)
    lone = next(
        p
        for p in impulse_positions
        if (np.abs(impulse_positions - p).max(1) < 4).sum() == 1 and p.min() > 1 and p.max() < 30
    )
    neighbourhood = tuple(slice(c - 1, c + 2) for c in lone)
    assert np.abs(added[neighbourhood]).max() > 0.9 and abs(added[neighbourhood].sum()) < 1e-12
    fraction = amplitudes(texture(constant(grid)))[neighbourhood] / 1.3 - 1
    assert fraction == pytest.approx(added[neighbourhood], abs=1e-6)


def test_forces_do_not_reverse_double_or_appear() -> None:
    field = noise(cube(20), 5)
    before = field.to_dense().astype(float)
    after = TextureFilter(density=0.1, rms=0.9)(field).to_dense().astype(float)
    assert ((before * after).sum(-1) >= 0).all()
    length, was = np.linalg.norm(after, axis=-1), np.linalg.norm(before, axis=-1)
    assert (length[was == 0] == 0).all()
    change = length[was > 0] / was[was > 0] - 1
    assert np.abs(change).max() == pytest.approx(1, abs=1e-6)
    assert np.abs(np.cross(before, after)).max() < 1e-6


def test_forces_do_not_exceed_the_device() -> None:
    field = noise(cube(20), 6)
    limited = filter_and_limit(
        HapticMedium.from_frames([field], 30.0), (TextureFilter(rms=0.5, density=0.5),), 0.75
    )[0]
    length = np.linalg.norm(limited.vectors_n().astype(float), axis=1)
    assert length.max() <= 0.75 and np.count_nonzero(length > 0.7499) > 100
    huge = constant(cube(9), (3e38, 0.0, 0.0))
    with pytest.raises(InvalidArgument, match="--texture forces"):
        TextureFilter(rms=0.5, density=0.5)(huge)


def test_texture_depends_on_the_position_only(monkeypatch: pytest.MonkeyPatch) -> None:
    grid, texture = cube(40), TextureFilter(grain_m=2e-3)
    field = noise(grid, 7)
    dense, textured = field.to_dense(), texture(field).to_dense()
    part = np.zeros(grid.shape, bool)
    part[3:9, 30:, 15:34] = True
    textured_part = texture(ForceField.from_dense(grid, dense * part[..., None]))
    assert np.array_equal(textured_part.to_dense(), textured * part[..., None])
    assert np.array_equal(texture(field.scaled(0.5)).to_dense(), textured / 2)
    other = noise(grid, 8)
    both = texture(field + other).to_dense()
    assert np.abs(both - textured - texture(other).to_dense()).max() < 2e-6
    larger = Grid((60, 40, 41), grid.spacing_m, grid.origin_m)
    grown = np.zeros((60, 40, 41, 3), np.float32)
    grown[:40, :, :40] = dense
    assert np.array_equal(texture(ForceField.from_dense(larger, grown)).to_dense()[:40, :, :40], textured)
    results = []
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        results.append(texture(field))
    assert results[0] == results[1]
    assert np.array_equal(results[0].to_dense(), textured)


def test_another_seed_is_another_texture() -> None:
    field = constant(cube(32))
    a, b = (amplitudes(TextureFilter(seed=s)(field)).ravel() for s in (1, WORD))
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(32**3)


def test_texture_raises_the_entropy() -> None:
    grid = cube(32)

    def bits(field: ForceField, inner: slice = slice(4, -4)) -> float:
        a = amplitudes(field)[inner, inner, inner]
        return entropy_bits(np.unique(np.round(a, 2), return_counts=True)[1])

    flat = constant(grid)
    assert bits(flat) == 0
    rising = [bits(TextureFilter(density=d)(flat)) for d in (0.001, 0.01, 0.1)]
    assert 0 < rising[0] < rising[1] < rising[2]
    assert rising[2] > 3


def test_texture_of_an_array_is_in_its_plane() -> None:
    grid = Grid((40, 30, 1), (1e-3,) * 3, (0.0, 0.0, 0.0))
    fraction = amplitudes(TextureFilter()(constant(grid))) / 1.3 - 1
    assert np.sqrt(np.mean(fraction**2)) == pytest.approx(0.1, rel=0.1)


def test_empty_field_stays_empty() -> None:
    assert TextureFilter()(ForceField.empty(cube(12))).support_count == 0


# -- claims, words, faults ---------------------------------------------------------------------------------


def test_claims() -> None:
    salt = TextureFilter().claims(cube(9))
    assert salt.reach == (0, 0, 0) and salt.linear and salt.keeps_support and salt.keeps_direction
    assert TextureFilter.name == "texture"


def test_text_round_trip() -> None:
    parsed = TextureFilter.parse("salt-pepper:seed=3,density=0.1,rms=0.2,grain=2mm")
    assert parsed == TextureFilter("salt-pepper", 3, 0.1, 0.2, 2e-3)
    assert TextureFilter.parse(f"{parsed.text},limit=1.0") == parsed  # the notation of older streams
    assert (
        TextureFilter.parse("") == TextureFilter.parse("salt-pepper") == TextureFilter.parse("salt-pepper:")
    )
    field = constant(cube(9))  # 1 mm spacing: a grain is rounded to whole samples
    assert TextureFilter(grain_m=1.9e-3)(field) == TextureFilter(grain_m=2e-3)(field)
    for texture in (parsed, TextureFilter(), TextureFilter(grain_m=1e-3)):
        assert TextureFilter.parse(texture.text) == texture


@pytest.mark.parametrize(
    "text",
    [
        "pepper",
        "salt:seed=1",
        "salt-pepper:0.5",
        "salt-pepper:kind=literal",
        "seed=1:rms=0.1",
        "seed=-1",
        "seed=1.5",
        "seed=18446744073709551616",
        "density=0",
        "density=1.1",
        "density=nan",
        "rms=-0.1",
        "rms=nan",
        "rms=1.1",
        "limit=0.5",
        "grain=0mm",
        "grain=-1mm",
        "grain=2",
        "force_max_n=1",
        "colour=red",
        "literal:grain=1mm",
    ],
)
def test_invalid_texts_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="texture"):
        TextureFilter.parse(text)


@pytest.mark.parametrize(
    ("grain_m", "shape"),
    [(0.4e-3, (9, 9, 9)), (10e-3, (20, 9, 20)), (1e300, (20, 9, 20)), (None, (1, 1, 1))],
)
def test_grains_that_do_not_fit_the_field_are_refused(
    grain_m: float | None, shape: tuple[int, int, int]
) -> None:
    grid = Grid(shape, (1e-3,) * 3, (0.0, 0.0, 0.0))
    texture = TextureFilter(grain_m=grain_m)
    for act in (lambda: texture(constant(grid)), lambda: texture.claims(grid)):
        with pytest.raises(InvalidArgument, match="texture"):
            act()

"""Force laws against their formulas, and the piecewise-linear profile that carries them."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.sources.laws import LAWS, ForceProfile, LawSpec, profile_of

stiffness = st.floats(10, 1e4)
force_max = st.floats(0.1, 40)
thickness = st.one_of(st.floats(1e-4, 0.5), st.just(math.inf))
phi = np.linspace(-0.6, 0.2, 4001)[1:] + 1e-9


@given(stiffness, force_max, thickness)
def test_penalty_is_a_spring_that_saturates_within_its_wall(k: float, f_max: float, wall_m: float) -> None:
    got = profile_of(LawSpec("penalty", k, f_max), wall_m)(phi)
    depth = -phi
    expected = np.where((depth >= 0) & (depth < wall_m), np.minimum(k * depth, f_max), 0)
    clear = np.abs(depth - wall_m) > 1e-8  # the far side of a wall is a jump
    np.testing.assert_allclose(got[clear], expected[clear], rtol=1e-9, atol=1e-9)


@given(stiffness, force_max, st.floats(1e-3, 0.1))
def test_proximity_guides_outside_only(k: float, f_max: float, band_m: float) -> None:
    profile = profile_of(LawSpec("proximity", k, f_max, band_m=band_m), 0.01)
    expected = np.where((phi > 0) & (phi < band_m), f_max / 4 * (1 - phi / band_m), 0)
    np.testing.assert_allclose(profile(phi), expected, atol=1e-9)
    assert profile.low_m == 0 and profile.high_m == band_m


@given(stiffness, force_max, st.floats(1e-3, 0.1))
def test_magnetic_pulls_from_both_sides_and_is_continuous(k: float, f_max: float, band_m: float) -> None:
    profile = profile_of(LawSpec("magnetic", k, f_max, band_m=band_m), 0.01)
    distances_m = np.linspace(-band_m, band_m, 2001)
    f = profile(distances_m)
    np.testing.assert_allclose(f, -f[::-1], atol=1e-9 * (1 + f_max))
    assert (f[distances_m > 0] <= 1e-12).all(), "outside, it pulls inwards"
    assert np.abs(f).max() <= f_max * (1 + 1e-9)
    steepest = max(k, 2 * f_max / band_m, k * band_m / band_m)
    assert np.abs(np.diff(f)).max() <= steepest * (distances_m[1] - distances_m[0]) * 1.01
    assert profile(band_m * 1.001) == 0


@given(st.sets(st.sampled_from(sorted(LAWS)), min_size=2), stiffness, force_max)
def test_sums_of_laws_are_sums(names: set[str], k: float, f_max: float) -> None:
    spec = LawSpec("+".join(sorted(names)), k, f_max)
    parts = sum(profile_of(LawSpec(name, k, f_max), 0.02)(phi) for name in names)
    np.testing.assert_allclose(profile_of(spec, 0.02)(phi), parts, atol=1e-8 * (1 + f_max))


@given(st.sampled_from(sorted(LAWS)), st.floats(1e-3, 1e3))
def test_a_law_in_other_metres_is_the_same_law(name: str, scale: float) -> None:
    profile = profile_of(LawSpec(name), 0.02)
    np.testing.assert_allclose(profile.rescaled(scale)(phi / scale), profile(phi), atol=1e-6)
    damped = ForceProfile(profile.pieces, 2.0)  # v is `scale` times smaller there
    assert damped.rescaled(scale).surface_damping_n_s_per_m == 2.0 * scale
    assert (profile + damped).surface_damping_n_s_per_m == 2.0


def test_the_natural_wall_reaches_the_limit_of_the_device() -> None:
    spec = LawSpec(stiffness_n_per_m=500, force_max_n=3.3)
    assert spec.saturation_m == pytest.approx(0.0066)
    profile = profile_of(spec, spec.saturation_m)
    assert profile(-0.0066 + 1e-9) == pytest.approx(3.3, rel=1e-5) and profile(-0.0067) == 0
    assert profile_of(LawSpec(thickness_m=0.001), math.inf).low_m == -0.001


@pytest.mark.parametrize(
    "bad",
    [
        {"law": "gravity"},
        {"law": "penalty+"},
        {"stiffness_n_per_m": 0},
        {"stiffness_n_per_m": math.nan},
        {"thickness_m": -1},
        {"thickness_m": math.nan},
        {"band_m": math.inf},
    ],
)
def test_bad_laws_are_refused(bad: dict) -> None:
    with pytest.raises(InvalidArgument):
        LawSpec(**bad)


def test_bad_profiles_are_refused() -> None:
    for pieces in (
        (),
        ((1.0, 0.0, 0.0, 0.0),),
        ((0.0, 2.0, 0, 0), (1.0, 3.0, 0, 0)),
        ((0.0, math.inf, 0, 0),),
    ):
        with pytest.raises(InvalidArgument):
            ForceProfile(pieces)

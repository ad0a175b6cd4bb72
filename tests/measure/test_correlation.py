"""An image and a haptic medium: contacts along rays, and significance of their mutual information."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray
from scipy import ndimage

from touchfield.errors import InvalidArgument
from touchfield.measure.similarity import (
    Contact,
    contact_along_rays,
    correlation_length_px,
    phase_surrogates,
    picture_correlation,
    quantile_classes,
)
from touchfield.medium import ForceField, Grid
from touchfield.medium.grid import Placement
from touchfield.pipeline.preparation import prepare
from touchfield.pipeline.spec import EncodeSpec

Float64s = NDArray[np.float64]


def smooth_noise(seed: int, shape: tuple[int, int] = (64, 64), sigma: float = 1.5) -> Float64s:
    image: Float64s = ndimage.gaussian_filter(
        np.random.default_rng(seed).normal(size=shape), sigma, mode="wrap"
    )
    return image


def contact_along_axis(
    field: ForceField, axis: int = 2, from_low: bool = True, reading: str = "first"
) -> Contact:
    """Follow the columns of the lattice along an axis, from their low or their high end."""
    grid = field.grid
    across = [np.arange(n) if a != axis else np.zeros(1, np.int64) for a, n in enumerate(grid.shape)]
    low = np.stack(np.meshgrid(*across, indexing="ij"), axis=-1)
    high = low.copy()
    high[..., axis] = grid.shape[axis] - 1
    endpoints = (grid.to_m(low), grid.to_m(high)) if from_low else (grid.to_m(high), grid.to_m(low))
    contact = contact_along_rays(field, endpoints[0], endpoints[1], reading)
    return Contact(contact.amplitudes_n.squeeze(axis), contact.distances_m.squeeze(axis))


# -- rays --------------------------------------------------------------------------------------------------


@given(st.integers(0, 200), st.integers(0, 2), st.booleans(), st.sampled_from(["first", "peak"]))
def test_columns_agree_with_the_dense_field(seed: int, axis: int, from_low: bool, reading: str) -> None:
    rng = np.random.default_rng(seed)
    grid = Grid((9, 5, 12), (0.001, 0.0013, 0.0017), (0.3, -0.2, 0.01))
    dense = rng.normal(size=(*grid.shape, 3)) * (rng.random(grid.shape) < 0.1)[..., None]
    field = ForceField.from_dense(grid, dense.astype(np.float32))
    found = contact_along_axis(field, axis, from_low, reading)
    amplitudes = np.moveaxis(np.linalg.norm(field.to_dense().astype(float), axis=-1), axis, -1)
    amplitudes = amplitudes if from_low else amplitudes[..., ::-1]
    index = (amplitudes > 0).argmax(axis=-1) if reading == "first" else amplitudes.argmax(axis=-1)
    expected = np.take_along_axis(amplitudes, index[..., None], axis=-1)[..., 0]
    has_contact = expected > 0
    assert np.array_equal(np.isnan(found.amplitudes_n), ~has_contact)
    assert found.amplitudes_n[has_contact] == pytest.approx(expected[has_contact])
    off = np.abs(found.distances_m - index * grid.spacing_m[axis])[has_contact]
    assert (off <= 0.51 * grid.spacing_m[axis]).all(), "the step at which the sample is the nearest"


def test_rays_of_a_camera_meet_a_tilted_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    """The distance to a plane along each ray, within a sample."""
    grid = Grid.over_box((-0.1, -0.1, 0.1), (0.1, 0.1, 0.3), (64, 64, 64))
    x, y, z = (grid.axis_m(a) for a in range(3))
    depth = z[None, None, :] - (0.2 + 0.3 * x[:, None, None] + 0 * y[None, :, None])
    dense = np.zeros((*grid.shape, 3), np.float32)
    dense[..., 2] = -np.clip(depth, 0, 0.02) * 100
    u, v = np.meshgrid(np.linspace(-0.3, 0.3, 9), np.linspace(-0.3, 0.3, 7))
    rays = np.stack([u, v, np.ones_like(u)], axis=-1)
    contact = contact_along_rays(ForceField.from_dense(grid, dense), (0.0, 0.0, 0.0), 0.3 * rays)
    expected = 0.2 / (1 - 0.3 * u) * np.linalg.norm(rays, axis=-1)
    assert contact.distances_m == pytest.approx(expected, abs=1.5 * grid.spacing_m[0])
    assert contact.amplitudes_n.shape == (7, 9)
    peak = contact_along_rays(ForceField.from_dense(grid, dense), (0.0, 0.0, 0.0), 0.3 * rays, "peak")
    assert peak.amplitudes_n == pytest.approx(2.0)
    monkeypatch.setattr(sys.modules[Contact.__module__], "_RAYS", 8)  # rays per chunk
    contact_in_chunks = contact_along_rays(ForceField.from_dense(grid, dense), (0.0, 0.0, 0.0), 0.3 * rays)
    assert np.array_equal(contact_in_chunks.distances_m, contact.distances_m)


def test_rays_outside_the_field_have_no_contact(wavy_field: ForceField) -> None:
    contact = contact_along_rays(wavy_field, (9.0, 9.0, 9.0), (9.0, 9.0, 9.01))
    assert math.isnan(contact.amplitudes_n) and math.isnan(contact.distances_m)
    assert np.isnan(contact_along_axis(ForceField.empty(wavy_field.grid)).amplitudes_n).all()


def test_invalid_rays_are_refused(wavy_field: ForceField, monkeypatch: pytest.MonkeyPatch) -> None:
    origin = (0.0, 0.0, 0.0)
    for starts, ends_m in ((origin, (0.0, math.nan, 0.0)), (np.zeros((2, 3)), np.zeros((4, 3))), (0.0, 1.0)):
        with pytest.raises(InvalidArgument, match="rays"):
            contact_along_rays(wavy_field, starts, ends_m)
    with pytest.raises(InvalidArgument, match="shorter rays"):
        contact_along_rays(wavy_field, origin, (0.0, 0.0, 1e9))
    monkeypatch.setattr(sys.modules[Contact.__module__], "MAX_LOOKUPS", 30)
    end_m = np.array([0.0, 0.0, 20 * min(wavy_field.grid.spacing_m) / 2])
    assert contact_along_rays(wavy_field, origin, end_m).amplitudes_n.shape == ()
    with pytest.raises(InvalidArgument, match="2 rays of 20 steps"):
        contact_along_rays(wavy_field, origin, [end_m, end_m])
    with pytest.raises(InvalidArgument, match="first or peak"):
        contact_along_rays(wavy_field, origin, (0.0, 0.0, 1.0), "mean")


# -- classes and lengths -----------------------------------------------------------------------------------


@given(st.integers(0, 500), st.integers(2, 9), st.integers(1, 400))
def test_classes_are_monotone_and_equally_filled(seed: int, count: int, size: int) -> None:
    rng = np.random.default_rng(seed)
    values = rng.integers(0, 40, size).astype(float)
    values[rng.random(size) < 0.1] = np.nan
    found = quantile_classes(values, count)
    assert np.array_equal(found == -1, np.isnan(values))
    is_known = ~np.isnan(values)
    order = np.argsort(values[is_known], kind="stable")
    assert (np.diff(found[is_known][order]) >= 0).all()
    for value in np.unique(values[is_known]):
        assert len(set(found[values == value])) == 1
    distinct = quantile_classes(rng.permutation(count * 10), count)
    assert (np.bincount(distinct) == 10).all()


def test_correlation_length_of_two_images() -> None:
    """White noise decorrelates at once with any other; exp(-d^2 / 4 s^2) at sqrt 2 s."""
    white, smooth = np.random.default_rng(0).normal(size=(256, 256)), smooth_noise(1, (256, 256), 5.0)
    assert correlation_length_px(white, smooth) == correlation_length_px(smooth, white) == 1
    assert correlation_length_px(smooth, smooth_noise(2, (256, 256), 5.0)) == pytest.approx(
        5 * 2**0.5, abs=1.5
    )
    ramp = np.arange(64.0) + np.zeros((64, 1))
    assert correlation_length_px(ramp, ramp) == 64, "along an axis where neither changes"
    for nothing in (np.full((64, 64), 3.0), np.full((64, 64), np.nan)):
        assert correlation_length_px(ramp, nothing) == 0


# -- the test against chance -------------------------------------------------------------------------------


def wall(depth: Float64s) -> ForceField:
    """A surface z = depth, in samples, with a guiding force in front of it that grows with the distance."""
    grid = Grid((*depth.shape, 32), (1e-3,) * 3, (0, 0, 0))
    z = np.arange(32)
    before = (z < depth[..., None]) & (z >= depth[..., None] - 3)
    force = np.where(before, 0.1 + 0.05 * z, 0)
    dense = np.zeros((*grid.shape, 3), np.float32)
    dense[..., 2] = -force
    return ForceField.from_dense(grid, dense)


def test_depth_correlates_with_its_field_and_noise_does_not() -> None:
    depth = 16 + 40 * smooth_noise(1)
    touched = contact_along_axis(wall(depth)).amplitudes_n
    related = picture_correlation(depth, touched)
    assert related.p == 1 / 200 and related.z > 10
    assert float(related.mutual) > 1
    assert related.mutual.interval is not None and related.mutual.interval.low > related.null_mean_bits
    unrelated = picture_correlation(smooth_noise(2), touched)
    assert unrelated.p > 0.05
    assert float(unrelated.mutual) < float(related.mutual) / 5


def test_depth_of_the_first_contact_is_the_surface() -> None:
    depth = 16 + 40 * smooth_noise(3)
    met: Contact = contact_along_axis(wall(depth))
    assert picture_correlation(depth, met.distances_m, classes=4).mutual.value > 1.5


@pytest.mark.parametrize("sigma", [1.5, 5.0])
def test_p_values_of_independent_images_are_calibrated(sigma: float) -> None:
    """30 pairs: 6 or more below p = 0.05 have a probability of 1/300."""
    rng = np.random.default_rng(round(10 * sigma))
    pairs = ndimage.gaussian_filter(rng.normal(size=(30, 2, 96, 96)), (0, 0, sigma, sigma))[..., 16:80, 16:80]
    found = [picture_correlation(a, b, surrogates=39, interval=False) for a, b in pairs]
    assert sum(math.isnan(f.p) for f in found) < 10
    assert sum(f.p <= 0.05 for f in found) < 6


def test_unknown_pixels_are_ignored() -> None:
    a = smooth_noise(5)
    b = a.copy()
    rng = np.random.default_rng(6)
    for m in (a, b):
        m[rng.random(m.shape) < 0.2] = np.nan
    found = picture_correlation(a, b, classes=4)
    assert found.share == pytest.approx(0.8**2, abs=0.05)
    assert found.mutual.samples == round(found.share * a.size)
    assert float(found.mutual) == pytest.approx(2, abs=0.1), "the same classes but at their borders"
    assert "64 blocks" in found.mutual.interval.method
    assert found.length_px == pytest.approx(correlation_length_px(smooth_noise(5), smooth_noise(5)), abs=1)


def test_correlation_is_seeded_and_has_a_summary() -> None:
    a, b = smooth_noise(7), smooth_noise(8)
    found, again = picture_correlation(a, b), picture_correlation(a, b)
    assert found.summary() == again.summary()
    assert picture_correlation(a, b, seed=1).p != found.p or picture_correlation(a, b, seed=1).z != found.z
    constant = picture_correlation(a, np.full_like(a, 2.0))
    assert (float(constant.mutual), constant.p) == (0, 1) and math.isnan(constant.z)
    assert constant.summary()["z"] is None


def test_p_of_pictures_that_are_too_smooth_is_refused() -> None:
    for a in (smooth_noise(9, (64, 64), 12.0), np.arange(64.0) + np.zeros((64, 1))):
        found = picture_correlation(a, a)
        assert math.isnan(found.p) and math.isnan(found.z) and float(found.mutual) > 2
        assert f"correlation length of {found.length_px:.3g} pixels" in found.mutual.notes[-2]
        assert found.summary()["p"] is None
    assert not any("no p" in note for note in picture_correlation(*[smooth_noise(9)] * 2).mutual.notes)


def test_invalid_images_are_refused() -> None:
    a = smooth_noise(1, (16, 16))
    unknown = np.full((16, 16), np.nan)
    for x, y in ((a, a[:8]), (a, unknown), (a[0], a[0]), (a, np.full((16, 16), np.inf))):
        with pytest.raises(InvalidArgument):
            picture_correlation(x, y)
    few = np.full((16, 16), np.nan)
    few[:2, :3] = 1.0
    with pytest.raises(InvalidArgument, match="groups of 2 x 2 pixels"):
        picture_correlation(a, few)
    for option in ({"classes": 1}, {"surrogates": 3}):
        with pytest.raises(InvalidArgument):
            picture_correlation(a, a, **option)


# -- a real scene ------------------------------------------------------------------------------------------


def to_hand(placement: Placement, points_m: Float64s) -> Float64s:
    return placement.scale * (points_m - np.asarray(placement.offset_m))


def test_the_motorcycle() -> None:
    """Rays of the pixels meet the surface at the depth of the map; luma is then compared with the field."""
    data = pytest.importorskip("skimage.data")
    from touchfield.sources.depth.inverse_depth import motorcycle_sequence

    sequence, stride = motorcycle_sequence(), 16
    prepared = prepare("sample:motorcycle", EncodeSpec(nw=6))
    pixels = slice(stride // 2, None, stride)
    depth = sequence.depth_m(0)[pixels, pixels].astype(float)
    depth[depth <= 0] = np.nan
    luma = (data.stereo_motorcycle()[0] @ [0.299, 0.587, 0.114])[pixels, pixels]
    v, u = np.mgrid[: depth.shape[0], : depth.shape[1]] * stride + stride // 2
    k = sequence.intrinsics
    rays = np.stack([(u - k.cx) / k.fx, (v - k.cy) / k.fy, np.ones(u.shape)], axis=-1)
    min_depth_m, max_depth_m = 0.9 * np.nanmin(depth), 1.1 * np.nanmax(depth)
    starts_m, ends_m = (to_hand(prepared.placement, z * rays) for z in (min_depth_m, max_depth_m))
    contact = contact_along_rays(prepared.medium[0], starts_m, ends_m)
    assert np.isfinite(contact.amplitudes_n).mean() > 0.5

    length = np.linalg.norm(rays, axis=-1) * prepared.placement.scale
    off = np.abs(contact.distances_m / length + min_depth_m - depth) * prepared.placement.scale
    assert np.nanmedian(off) < 1.5 * max(prepared.medium.grid.spacing_m), (
        "registered to within a sample or two"
    )
    depth_correlation = picture_correlation(depth, contact.distances_m, classes=4)
    assert depth_correlation.p == 1 / 200 and depth_correlation.z > 5
    peak = contact_along_rays(prepared.medium[0], starts_m, ends_m, "peak")
    of_luma = picture_correlation(luma, peak.amplitudes_n, classes=4)
    assert 0 < float(of_luma.mutual) < float(depth_correlation.mutual)


def miller_madow_bits(*columns: NDArray[np.int64]) -> float:
    """Plug-in entropy of the rows, plus (K - 1) / (2 n ln 2)."""
    counts = np.unique(np.stack(columns, axis=1), axis=0, return_counts=True)[1]
    p, n = counts / counts.sum(), counts.sum()
    return float(-(p * np.log2(p)).sum() + (len(counts) - 1) / (2 * n * math.log(2)))


def test_correlation_agrees_with_explicit_surrogates() -> None:
    rng, classes = np.random.default_rng(3), 5
    a = smooth_noise(11, (40, 58))
    b = a + 0.3 * smooth_noise(12, (40, 58))
    a[rng.random(a.shape) < 0.1] = np.nan
    found = picture_correlation(a, b, classes=classes, surrogates=19, seed=4)
    classes_a = quantile_classes(a, classes)

    def bits(other: Float64s) -> float:
        is_known = classes_a >= 0
        u, v = classes_a[is_known], quantile_classes(other, classes)[is_known]
        return miller_madow_bits(u) + miller_madow_bits(v) - miller_madow_bits(u, v)

    null = np.array([bits(other) for other in phase_surrogates(b, 19, 4)])
    assert float(found.mutual) == pytest.approx(bits(b))
    assert (found.null_mean_bits, found.null_spread_bits) == pytest.approx((null.mean(), null.std(ddof=1)))
    assert found.z == pytest.approx((bits(b) - null.mean()) / null.std(ddof=1))
    assert found.p == pytest.approx((1 + np.count_nonzero(null >= bits(b))) / 20)
    assert (found.surrogates, found.length_px) == (19, correlation_length_px(a, b))
    assert found.share == pytest.approx(np.count_nonzero(classes_a >= 0) / a.size)
    assert found.mutual.quantiser == "5 classes of equal share"
    assert found.mutual.notes[-1] == "5 classes of equal share each"


def test_surrogates_have_the_correlation_of_the_picture_and_its_unknown_pixels() -> None:
    picture = smooth_noise(13, (96, 80), 3.0)
    picture[10:30, 40:70] = np.nan
    length = correlation_length_px(picture, picture)
    drawn = list(phase_surrogates(picture, 8))
    for other in drawn:
        assert np.array_equal(np.isnan(other), np.isnan(picture))
        known = ~np.isnan(picture)
        assert abs(np.corrcoef(other[known], picture[known])[0, 1]) < 0.5
    assert np.mean([correlation_length_px(o, o) for o in drawn]) == pytest.approx(length, rel=0.35)

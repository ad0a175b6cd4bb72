"""Quincunx and FCC lifting in the frequency domain: responses, passbands, and preserved patterns."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from numpy.typing import NDArray

from lifting_makers import FORWARD, INVERSE, coarse_mask, coarse_only, stage_passband, stage_responses
from touchfield.filters.lifting import QUINCUNX, fcc_forward


def wave(shape: tuple[int, ...], frequency: tuple[float, ...]) -> NDArray[np.float64]:
    """cos(w . n), with the frequency in cycles over the whole array, so that it is one bin of the DFT."""
    phase = sum(2 * np.pi * f / n * i for f, n, i in zip(frequency, shape, np.indices(shape), strict=True))
    return np.asarray(np.cos(phase))


def frequencies(shape: tuple[int, ...]) -> list[NDArray[np.float64]]:
    """The frequencies of the DFT, radians per sample."""
    return list(np.meshgrid(*(2 * np.pi * np.fft.fftfreq(n) for n in shape), indexing="ij"))


def test_masked_spectrum_and_halfband_identity_of_the_quincunx() -> None:
    shape = (16, 12)
    image = np.random.default_rng(1).normal(size=shape)
    spectrum = np.fft.fft2(image)
    masked = np.fft.fft2(image * coarse_mask(shape, 1))
    assert np.allclose(masked, 0.5 * (spectrum + np.roll(spectrum, (8, 6), (0, 1))), atol=1e-12)
    w1, w2 = frequencies(shape)
    h0 = stage_responses(w1, w2)[1] / 2
    assert np.allclose(h0, 0.5 + 0.25 * (np.cos(w1) + np.cos(w2)), atol=1e-15)
    assert np.allclose(h0 + stage_responses(w1 + np.pi, w2 + np.pi)[1] / 2, 1, atol=1e-15)


def test_masked_spectrum_and_halfband_identity_of_the_fcc() -> None:
    shape = (8, 12, 10)
    volume = np.random.default_rng(1).normal(size=shape)
    spectrum = np.fft.fftn(volume)
    masked = np.fft.fftn(volume * coarse_mask(shape, 1))
    assert np.allclose(masked, 0.5 * (spectrum + np.roll(spectrum, (4, 6, 5), (0, 1, 2))), atol=1e-11)
    w = frequencies(shape)
    h0 = stage_responses(*w)[1] / 2
    assert np.allclose(h0 + stage_responses(*(x + np.pi for x in w))[1] / 2, 1, atol=1e-15)


@pytest.mark.parametrize("dimensions", [2, 3])
def test_documented_responses_agree_with_the_lifting(dimensions: int) -> None:
    """An impulse far from the border, at a coarse and at a detail site, forward and inverse."""
    shape, centre = ((17,) * dimensions, (8,) * dimensions)
    responses = {2: stage_responses, 3: stage_responses}[dimensions]
    w = frequencies(shape)
    analysis, synthesis = responses(*w)
    rows = np.zeros(shape)  # the coarse site in the centre as a function of the input
    for site in itertools.product(range(5, 12), repeat=dimensions):
        impulse = np.zeros(shape)
        impulse[site] = 1
        rows[site] = FORWARD[dimensions](impulse, 1)[centre]
    assert np.allclose(np.fft.fftn(np.fft.ifftshift(rows)), analysis, atol=1e-13)
    impulse = np.zeros(shape)
    impulse[centre] = 1
    spread = INVERSE[dimensions](impulse, 1)  # a single coarse value; its update subtracts no detail
    assert np.allclose(np.fft.fftn(np.fft.ifftshift(spread)), synthesis, atol=1e-13)


def test_the_passbands_are_half_of_the_cube_and_tile_it_with_their_image() -> None:
    rng = np.random.default_rng(9)
    w = rng.uniform(-np.pi, np.pi, (3, 400_000))
    for passband, d in ((stage_passband, 2), (stage_passband, 3)):
        inside = passband(*w[:d])
        assert inside.mean() == pytest.approx(0.5, abs=0.004)
        assert (inside ^ passband(*(w[:d] + np.pi))).all()
    cell = np.abs(w).sum(axis=0) <= 1.5 * np.pi
    assert np.array_equal(stage_passband(*w), cell)
    n = 200  # the volume again, by the midpoint rule
    axis = (np.arange(n) + 0.5) / n * np.pi
    volume = (axis[:, None, None] + axis[:, None] + axis <= 1.5 * np.pi).mean()
    assert volume == pytest.approx(0.5, abs=1e-4)


def test_pattern_aliased_by_separable_decimation_is_preserved() -> None:
    """0.75 pi along an axis: in the diamond, but above pi / 2; decimation by 2 aliases it to 0.25 pi."""
    image = wave((32, 32), (12.0, 0.0))
    separable = np.zeros_like(image)
    separable[::2, ::2] = image[::2, ::2]
    w1, w2 = frequencies((32, 32))
    slow = np.hypot(w1, w2) < np.pi / 2
    quincunx_samples = image * coarse_mask((32, 32), 1)
    assert stage_passband(0.75 * np.pi, 0.0) and not stage_passband(0.75 * np.pi, 0.5 * np.pi)
    assert np.abs(np.fft.fft2(separable))[slow].max() == pytest.approx(32 * 32 / 8)  # an alias at 0.25 pi
    assert np.abs(np.fft.fft2(quincunx_samples))[slow].max() < 1e-9
    rebuilt = np.abs(np.fft.fft2(coarse_only(image[:, :], QUINCUNX, 1)))
    assert rebuilt[12, 0] > 0.55 * 32 * 32 / 2  # the pattern itself is preserved
    assert rebuilt[12, 0] > 2 * rebuilt[slow].max()


def test_static_sequence_passes_the_second_stage_of_x_y_t() -> None:
    """x, y, t: after two stages every second frame is left, as a quincunx image."""
    static = np.repeat(np.random.default_rng(6).normal(size=(16, 16, 1)), 12, axis=2)
    mask = coarse_mask(static.shape, 2)
    assert not mask[:, :, 1::2].any()
    frames = fcc_forward(static, 2)[mask].reshape(-1, 6)  # raster order, t fastest
    assert np.allclose(frames, frames[:, :1], atol=1e-12)

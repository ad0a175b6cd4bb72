"""One battery for the stages of figure 4 that code whole fields: each keeps its claim, and bytes make it again."""

from __future__ import annotations

import contextlib
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.fft import dctn

from touchfield.codec.field_stage import PlainStage, RunStage, decode_field, encode_field, stage_kinds
from touchfield.codec.kernels import predictive as kernels
from touchfield.codec.numbers import LARGEST, decode_numbers, encode_numbers
from touchfield.codec.predictive import AdpcmSpec, DpcmSpec, DpcmStage
from touchfield.codec.spectral import DctSpec, DctStage, WaveletSpec, filled, wavelet_forward, wavelet_inverse
from touchfield.errors import CorruptFile, FormatError, InvalidArgument
from touchfield.medium import ForceField, Grid

STEP_N = 0.05


def stages(field: ForceField, step_n: float = STEP_N) -> list:
    """Every registered stage, fitted."""
    specs = [DpcmSpec(step_n), AdpcmSpec(step_n), WaveletSpec(step_n), DctSpec(step_n), DctSpec(step_n, 0.5)]
    made = [PlainStage(step_n), RunStage(step_n), *(spec.fit(field) for spec in specs)]
    assert {s.kind for s in made} == set(stage_kinds())
    return made


@st.composite
def fields(draw: st.DrawFn) -> ForceField:
    """Noise of any density, waves and constants, on grids that end within a brick."""
    shape = tuple(draw(st.lists(st.integers(1, 19), min_size=3, max_size=3)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    at = np.stack(np.indices(shape), axis=-1) / rng.uniform(1, 20, 3)
    kind = draw(st.sampled_from(["noise", "wave", "constant", "none"]))
    forces = {
        "noise": rng.normal(size=(*shape, 3)),
        "wave": np.sin(at + rng.uniform(0, 6, 3)),
        "constant": np.full((*shape, 3), 1.7),
        "none": np.zeros((*shape, 3)),
    }[kind]
    forces = np.where((rng.random(shape) < draw(st.sampled_from([0.02, 0.5, 1.0])))[..., None], forces, 0)
    return ForceField.from_dense(Grid(shape, (1e-3,) * 3, (0, 0, 0)), forces)


def on_bricks(decoded: ForceField, field: ForceField) -> np.ndarray:
    """Decoded forces of the supported samples of `field`."""
    return decoded.to_dense()[tuple(field.positions().T)]


@given(fields())
@settings(max_examples=30)
def test_each_stage_keeps_its_claim_and_the_support(field):
    for stage in stages(field):
        decoded = decode_field(encode_field(stage, field), field.grid)
        worst = stage.claim.worst(field.vectors_n().reshape(-1), on_bricks(decoded, field).reshape(-1))
        assert worst <= stage.claim.bound + 2.0**-22 * np.abs(field.forces_n).max(initial=0)
        assert not (decoded.to_dense().any(axis=-1) & ~field.to_dense().any(axis=-1)).any()


def test_claims_are_not_idle(wavy_field):
    rng = np.random.default_rng(0)
    noise = wavy_field.forces_n + rng.normal(0, 0.3, wavy_field.forces_n.shape) * wavy_field.mask[..., None]
    field = ForceField.from_bricks(wavy_field.grid, wavy_field.bricks, noise)
    for stage in stages(field)[:5]:  # the DCT's is for all coefficients at their worst
        decoded = decode_field(encode_field(stage, field), field.grid)
        assert stage.claim.worst(field.vectors_n().reshape(-1), on_bricks(decoded, field).reshape(-1)) > (
            0.7 * stage.claim.bound
        )


def test_plain_run_dpcm_and_wavelet_make_the_same_field(wavy_field):
    made = [decode_field(encode_field(s, wavy_field), wavy_field.grid) for s in stages(wavy_field)]
    assert made[0] == made[1] == made[2] == made[4]


def test_each_stage_is_worth_something_on_a_smooth_field(wavy_field):
    sizes = [len(encode_field(s, wavy_field)) for s in stages(wavy_field, 0.002)]
    assert max(sizes[2:4]) < sizes[0]
    still = ForceField.from_dense(wavy_field.grid, np.full((*wavy_field.grid.shape, 3), 0.7))
    assert len(encode_field(RunStage(STEP_N), still)) < len(encode_field(PlainStage(STEP_N), still))


def test_a_step_too_fine_is_refused(wavy_field):
    for step_n in (1e-9, 0.0, float("nan")):
        for spec in (DpcmSpec, AdpcmSpec, WaveletSpec, DctSpec):
            with pytest.raises(InvalidArgument, match="step_n"):
                encode_field(spec(step_n).fit(wavy_field), wavy_field)
    with pytest.raises(InvalidArgument, match="dead"):
        DctSpec(0.1, 0.7)


# -- prediction -------------------------------------------------------------------------------------------


def test_dpcm_decodes_as_its_formula_says():
    values, weight = [], 200
    for r in (residuals := np.random.default_rng(1).integers(-99, 99, 50)):
        values.append(((weight * (values[-1] if values else 0) + 128) >> 8) + int(r))
    np.testing.assert_array_equal(kernels.dpcm_decoded(residuals, weight), values)


def test_dpcm_fits_its_weight():
    grid = Grid((1, 1, 4096), (1e-3,) * 3, (0, 0, 0))
    rng, x = np.random.default_rng(2), np.zeros((4096, 3))
    for i in range(1, 4096):
        x[i] = 0.8 * x[i - 1] + rng.normal(size=3)
    stage = DpcmSpec(0.01).fit(ForceField.from_dense(grid, x[None, None]))
    assert stage.weight / 256 == pytest.approx(0.8, abs=0.02)


def test_adpcm_follows_with_its_step():
    """After a jump the residual's step grows; on a still signal it goes back to the finest."""
    values = np.r_[np.zeros(50), np.full(300, 5000)].astype(np.int64)
    wanted, residuals = values.copy(), np.zeros(350, np.int64)
    kernels.adpcm(values, residuals, kernels.ADPCM_STEPS, False)
    decoded = np.zeros(350, np.int64)
    kernels.adpcm(decoded, residuals, kernels.ADPCM_STEPS, True)
    np.testing.assert_array_equal(decoded, values)
    assert np.abs(values - wanted).max() <= kernels.ADPCM_STEPS[-1] / 2 + 1
    assert np.abs(values - wanted)[-100:].max() <= kernels.GRAIN / 2
    assert residuals[50] == 5000 // kernels.GRAIN + 1 and np.abs(residuals[60:]).max() < 20


# -- transforms -------------------------------------------------------------------------------------------


@given(st.lists(st.integers(1, 11), min_size=1, max_size=4), st.integers(0, 4), st.integers(0, 2**32 - 1))
def test_the_wavelet_comes_back_to_the_bit(shape, levels, seed):
    values = np.random.default_rng(seed).integers(-(2**29), 2**29, shape, np.int32)
    axes = tuple(range(min(3, len(shape))))
    made = wavelet_forward(values, levels, axes)
    assert made.dtype == np.int32
    np.testing.assert_array_equal(wavelet_inverse(made, levels, axes), values)


def test_the_wavelet_is_legalls():
    """Against the filters of ISO/IEC 15444-1: a line leaves no detail, and an impulse the 5/3 taps."""
    line = np.arange(0, 160, 10, dtype=np.int32)
    assert not wavelet_forward(line, 1, (0,))[8:-1].any()
    impulse = np.zeros(17, np.int32)
    impulse[8] = 800
    np.testing.assert_array_equal(wavelet_forward(impulse, 1, (0,))[3:6], [-100, 600, -100])
    np.testing.assert_array_equal(wavelet_forward(impulse, 1, (0,))[12:14], [-400, -400])


def test_the_dct_keeps_energy_and_its_noise_is_a_twelfth_of_the_step(wavy_field):
    rng = np.random.default_rng(3)
    dense = rng.normal(size=(16, 16, 16, 3))
    field = ForceField.from_dense(Grid((16, 16, 16), (1e-3,) * 3, (0, 0, 0)), dense)
    spectrum = dctn(field.forces_n.astype(np.float64), axes=(1, 2, 3), norm="ortho")
    assert (spectrum**2).sum() == pytest.approx((field.forces_n.astype(np.float64) ** 2).sum())
    decoded = decode_field(encode_field(DctSpec(STEP_N, 0.5).fit(field), field), field.grid)
    assert np.mean((decoded.to_dense() - field.to_dense()) ** 2) == pytest.approx(STEP_N**2 / 12, rel=0.05)


def test_filling_leaves_the_support_and_is_smooth(wavy_field):
    x = filled(wavy_field.forces_n, wavy_field.mask)
    held = wavy_field.mask
    np.testing.assert_array_equal(x[held].astype(np.float32), wavy_field.forces_n[held])
    steps = [np.abs(np.diff(v, axis=3)).mean() for v in (x, wavy_field.forces_n)]
    assert steps[0] < steps[1]
    assert len(encode_field(DctStage(STEP_N, 0.4), wavy_field)) > 0


# -- bytes ------------------------------------------------------------------------------------------------


@given(st.lists(st.integers(-LARGEST, LARGEST) | st.integers(-3, 3), max_size=200))
def test_numbers_come_back(numbers):
    array = np.array(numbers, np.int32)
    data = encode_numbers(array)
    np.testing.assert_array_equal(decode_numbers(data, len(array)), array)
    with pytest.raises(FormatError):
        decode_numbers(data + b"\1", len(array))


def test_a_number_too_large_is_refused():
    with pytest.raises(InvalidArgument, match="numbers"):
        encode_numbers(np.array([LARGEST + 1], np.int32))


def test_cut_or_changed_bytes_are_named(wavy_field):
    rng = np.random.default_rng(5)
    for stage in stages(wavy_field):
        data = encode_field(stage, wavy_field)
        for a, b in pairwise([0, *np.linspace(1, len(data) - 1, 25).astype(int)]):
            with pytest.raises(FormatError):
                decode_field(data[:a], wavy_field.grid)
            changed = bytearray(data)
            changed[b] = rng.integers(256)
            with contextlib.suppress(FormatError):
                decode_field(bytes(changed), wavy_field.grid)
    with pytest.raises(CorruptFile, match="kind"):
        decode_field(b"\7", wavy_field.grid)
    assert isinstance(DpcmStage.from_bytes(DpcmStage(0.1, 256).to_bytes()), DpcmStage)
    with pytest.raises(CorruptFile, match="weight"):
        DpcmStage.from_bytes(DpcmStage(0.1, 257).to_bytes())

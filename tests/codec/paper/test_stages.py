"""The stages of figure 4: error bound, round trip, and refusal of faulty bytes."""

from __future__ import annotations

import contextlib
import struct

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.fft import idctn

from touchfield.codec.paper.decoder import PaperDecoder, from_bricks
from touchfield.codec.paper.encoder import PaperEncoder, _fill_bricks, _to_wavelet
from touchfield.codec.paper.spec import STAGES, PaperSpec
from touchfield.codec.support import encode_numbers, encode_support
from touchfield.codec.varint import chunk
from touchfield.compute.native import native
from touchfield.errors import CorruptFile, FormatError, InvalidArgument
from touchfield.medium import ForceField, Grid

STEP_N = 0.05
NAMES = STAGES[1:]
MAX_ERROR_STEPS = {
    "dpcm": 0.5,
    "wavelet": 0.5,
    "runs": 0.5,
    "adpcm": 2 + 1 / 32,
    "dct": 512**0.5 * 2 / 3 + 1 / 64,
}
"""Maximum error of a component, in steps: half a step; half the coarsest; all coefficients at worst."""


def encode_body(frames: list[ForceField], stage: str, step_n: float = STEP_N) -> bytes:
    return PaperEncoder(frames[0].grid, PaperSpec(stage=stage, step_n=step_n)).encode_segment(frames).body


def encode_and_decode(frames: list[ForceField], stage: str, step_n: float = STEP_N) -> list[ForceField]:
    segment = PaperEncoder(frames[0].grid, PaperSpec(stage=stage, step_n=step_n)).encode_segment(frames)
    body = segment.body
    decoder = PaperDecoder(frames[0].grid, stage.encode())
    costs = decoder.costs(body, len(frames))
    assert [c.bits for c in costs] == [frame_record.bits for frame_record in segment.frames]
    assert sum(c.bits.total for c in costs) == 8 * (len(body) - 8), "all but the step belongs to a frame"
    return list(decoder.frames(body, len(frames)))


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


@given(fields(), st.sampled_from(NAMES))
@settings(max_examples=60)
def test_each_stage_is_within_its_error_and_has_the_support(field: ForceField, stage: str) -> None:
    frames = encode_and_decode([field, field.scaled(-1)], stage)
    for restored, original in zip(frames, (field, field.scaled(-1)), strict=True):
        x, y = original.to_dense().astype(float), restored.to_dense()
        supported = x.any(axis=-1)
        assert not y[~supported].any()
        assert np.abs(x - y)[supported].max(initial=0) <= MAX_ERROR_STEPS[stage] * STEP_N + 2.0**-22 * np.abs(
            x
        ).max(initial=0)


def test_dpcm_wavelet_and_runs_agree_and_adpcm_is_smaller(wavy_field: ForceField) -> None:
    decoded_fields = [encode_and_decode([wavy_field], stage)[0] for stage in ("dpcm", "wavelet", "runs")]
    assert (
        decoded_fields[0] == decoded_fields[1] == decoded_fields[2] and decoded_fields[0].support_count > 500
    )
    assert len(encode_body([wavy_field], "adpcm", 0.01)) < len(encode_body([wavy_field], "dpcm", 0.01))
    constant = ForceField.from_dense(wavy_field.grid, np.full((*wavy_field.grid.shape, 3), 0.7))
    assert len(encode_body([constant], "runs")) < 60


def test_a_step_too_fine_for_the_forces_is_refused(wavy_field: ForceField) -> None:
    for stage in NAMES:
        with pytest.raises(InvalidArgument, match="step_n"):
            encode_body([wavy_field.scaled(100)], stage, 1e-9)


# -- what the stages are -----------------------------------------------------------------------------------


def test_adpcm_adapts_its_step() -> None:
    """After a jump the step grows; on a constant signal it returns to the finest."""
    values = np.r_[np.zeros(50), np.full(300, 5000)].astype(np.int64)
    original, residuals, restored = values.copy(), np.zeros(350, np.int64), np.zeros(350, np.int64)
    native.adpcm(values, residuals, False)
    native.adpcm(restored, residuals, True)
    np.testing.assert_array_equal(restored, values)
    assert np.abs(values - original).max() <= 64 / 2 + 1
    assert np.abs(values - original)[-100:].max() <= 16 / 2
    assert residuals[50] == 5000 // 16 + 1 and np.abs(residuals[60:]).max() < 20


@given(st.integers(0, 2**32 - 1))
def test_wavelet_round_trip_is_exact(seed: int) -> None:
    values = np.random.default_rng(seed).integers(-(2**29), 2**29, (2, 8, 8, 8))
    np.testing.assert_array_equal(from_bricks("wavelet", _to_wavelet(values[..., None])[..., 0]), values)


def test_wavelet_is_the_5_3_of_jpeg_2000() -> None:
    """The 5/3 wavelet of ISO/IEC 15444-1: a ramp has detail only at its end; one detail has the 5/3 shape."""
    line = np.broadcast_to(np.arange(0, 80, 10)[:, None, None], (8, 8, 8))
    coefficients = _to_wavelet(line[None, ..., None])[0, ..., 0]
    assert not coefficients[4:7].any() and coefficients[7].any()
    detail = np.zeros((1, 8, 8, 8), np.int64)
    detail[0, 5, 0, 0] = 800
    np.testing.assert_array_equal(
        from_bricks("wavelet", detail)[0, :6, 0, 0], [0, -100, -200, 600, -200, -100]
    )


def test_dct_is_orthonormal_within_a_fraction_of_a_step() -> None:
    spectrum = np.random.default_rng(3).integers(-2000, 2000, (5, 8, 8, 8))
    exact = idctn(spectrum.astype(float), axes=(1, 2, 3), norm="ortho")
    assert np.abs(from_bricks("dct", spectrum) / 256 - exact).max() < 0.05  # of samples up to 9000 steps
    impulse = np.zeros((1, 8, 8, 8), np.int64)
    impulse[0, 0, 0, 0] = 8
    assert np.abs(from_bricks("dct", impulse) / 256 - 8 / 512**0.5).max() < 0.01


def test_filling_leaves_the_support_and_is_smooth(wavy_field: ForceField) -> None:
    x, mask = _fill_bricks(wavy_field), wavy_field.mask
    np.testing.assert_array_equal(x[mask].astype(np.float32), wavy_field.forces_n[mask])
    steps = [np.abs(np.diff(v, axis=3)).mean() for v in (x, wavy_field.forces_n)]
    assert steps[0] < steps[1]


# -- bytes of strangers ------------------------------------------------------------------------------------


@pytest.mark.parametrize("stage", NAMES)
def test_truncated_or_changed_bytes_raise_named_errors(stage: str, wavy_field: ForceField) -> None:
    rng, body = np.random.default_rng(5), encode_body([wavy_field], stage)
    decoder = PaperDecoder(wavy_field.grid, stage.encode())
    survived = 0
    for cut in np.linspace(0, len(body) - 1, 25).astype(int).tolist():
        with pytest.raises(FormatError):
            list(decoder.frames(body[:cut], 1))
        changed = bytearray(body)
        changed[cut] ^= int(rng.integers(1, 256))
        with contextlib.suppress(FormatError):
            survived += all(np.isfinite(f.forces_n).all() for f in decoder.frames(bytes(changed), 1))
    assert survived < 25


def test_contradictory_bodies_are_refused(wavy_field: ForceField) -> None:
    grid, count = wavy_field.grid, wavy_field.support_count
    support = chunk(encode_support(grid, wavy_field.bricks, wavy_field.mask))

    def assert_refused(stage: str, step_n: float, runs: bytes, numbers: list[int]) -> None:
        body = struct.pack("<d", step_n) + support + runs + chunk(encode_numbers(np.array(numbers, np.int32)))
        with pytest.raises(CorruptFile):
            list(PaperDecoder(grid, stage.encode()).frames(body, 1))

    nothing = [0] * (3 * count)
    for step_n in (0.0, -1.0, float("nan"), float("inf"), 1e7):
        assert_refused("dpcm", step_n, b"", nothing)
    assert_refused("dpcm", 1e6, b"", [2, *nothing[1:]])  # beyond 1e6 N
    assert_refused("runs", 0.1, b"\2", [count, -1, 0, 0, 0, 0, 0, 0])  # a run of no sample
    assert_refused("runs", 0.1, b"\1", [count, 0, 0, 0])  # a sample too many
    with pytest.raises(CorruptFile, match="stage"):
        PaperDecoder(grid, b"dst")

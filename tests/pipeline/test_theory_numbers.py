"""Numbers and identities of the theory that no other test checks, with touchfield's functions.

Paper sections 3 to 5, read precisely.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray
from scipy import signal, stats

from limits_makers import context_entropy
from touchfield import pipeline
from touchfield.codec.paper.directions import Codebook
from touchfield.codec.paper.encoder import fitted_code
from touchfield.codec.paper.field_quantiser import FieldQuantiserSpec
from touchfield.codec.paper.quantisers import lloyd_max_levels, uniform_levels, weber_levels
from touchfield.codec.segment import RAW_BITS_PER_VECTOR
from touchfield.devices import device
from touchfield.filters import LOW_PASSES, limit_forces, resample
from touchfield.filters.fir import fir_filter
from touchfield.measure import information as info
from touchfield.measure.capacity import capacity, codomain_bits
from touchfield.measure.counts import Counts
from touchfield.measure.estimators import binary_entropy_bits, estimate_bits
from touchfield.measure.field_symbols import FieldSymbols
from touchfield.measure.quantity import Quantity
from touchfield.medium import ForceField, Grid
from touchfield.perception.weber import WeberLadder, quantise_fixed_step, within_mask_from_n
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.tiny_scenes import tiny_scenes

pytestmark = pytest.mark.filterwarnings("ignore::touchfield.measure.quantity.FewSamplesWarning")

Symbols = NDArray[np.int64]
Floats = NDArray[np.float64]
Road = Callable[[Symbols, Symbols], float | Quantity]
KX, KY = 5, 3
GAUSSIAN_BITS = 0.5 * math.log2(2 * math.pi * math.e)

exact = Counts.of_probabilities


def on_a_line(symbols: NDArray[np.int64]) -> FieldSymbols:
    grid = Grid((1, 1, len(symbols)), (1, 1, 1), (0, 0, 0))
    return FieldSymbols.from_dense(grid, symbols.reshape(grid.shape), int(symbols.max()) + 1, "as given")


# -- Gaussian sources --------------------------------------------------------------------------------------


def rounded_pair(rho: float, step: float) -> Floats:
    """Distribution of two unit Gaussians of correlation rho, rounded to multiples of `step`, to 1e-12."""
    nodes, weight = np.polynomial.legendre.leggauss(12)
    centre = np.arange(-round(8 / step), round(8 / step) + 1) * step
    x = (centre[:, None] + step / 2 * nodes).ravel()
    edges = np.append(centre - step / 2, centre[-1] + step / 2)
    conditional = np.diff(stats.norm.cdf((edges - rho * x[:, None]) / math.sqrt(1 - rho**2)), axis=1)
    joint = (stats.norm.pdf(x) * np.tile(weight, len(centre)) * step / 2)[:, None] * conditional
    table = joint.reshape(len(centre), len(nodes), -1).sum(axis=1)
    return np.asarray(table / table.sum())


def test_a_rounded_gaussian_tends_to_its_differential_entropy() -> None:
    assert abs(GAUSSIAN_BITS - 2.047096) < 5e-7
    off = []
    for step, bits in ((1, 2.104833), (0.5, 3.061969), (0.25, 4.050843), (0.1, 5.369625)):
        found = float(info.entropy(exact(rounded_pair(0.0, step).sum(axis=1))))
        assert found == pytest.approx(bits, abs=6e-7)
        off.append(found + math.log2(step) - GAUSSIAN_BITS)
    assert 0 < off[3] < off[2] < off[1] < off[0]
    assert off[2] / off[3] == pytest.approx(6.25, rel=0.01)  # the step squared


@pytest.mark.parametrize(("rho", "bits"), [(0.6, 0.321928), (0.9, 1.197964)])
def test_rounding_loses_information_of_gaussians_and_fine_rounding_none(rho: float, bits: float) -> None:
    found = [
        float(info.mutual_information(exact(rounded_pair(rho, step)))) for step in (1, 0.5, 0.1, 0.05, 0.025)
    ]
    assert all(a < b < bits for a, b in itertools.pairwise(found))
    assert (4 * found[4] - found[3]) / 3 == pytest.approx(
        bits, abs=1e-6
    )  # the loss is proportional to the step squared


def test_a_step_of_prediction_gains_7_212_decibels() -> None:
    """AR(1), rho = 0.9: H(S) - H(S | previous sample) is half a bit for each 3.01 dB of prediction gain."""
    gains = []
    for step in (0.1, 0.05):
        table = rounded_pair(0.9, step)
        saved = float(info.entropy(exact(table.sum(axis=0)))) - float(
            info.conditional_entropy(exact(table), given=0)
        )
        gains.append(20 * math.log10(2) * saved)
    assert (4 * gains[1] - gains[0]) / 3 == pytest.approx(7.212, abs=5e-4)


def test_a_drawn_chain_has_the_rate_of_its_law() -> None:
    rng = np.random.default_rng(9)
    x = signal.lfilter([math.sqrt(1 - 0.81)], [1, -0.9], rng.standard_normal(300_100))[100:]
    drawn = np.round(quantise_fixed_step(x, 0.5) / 0.5).astype(np.int64)
    table = rounded_pair(0.9, 0.5)
    rate = float(info.conditional_entropy(exact(table), given=0))
    tolerance = {"abs": 6e-3, "rel": 0}
    assert float(info.entropy(drawn, interval=False)) == pytest.approx(
        float(info.entropy(exact(table.sum(axis=0)))), **tolerance
    )
    from_zero = drawn - drawn.min()
    assert float(context_entropy([on_a_line(from_zero)], "previous").per_voxel) == pytest.approx(
        rate, **tolerance
    )


# -- rate and distortion -----------------------------------------------------------------------------------


def test_even_steps_with_an_entropy_code_are_a_quarter_of_a_bit_from_the_bound() -> None:
    """D(R) = 2^-2R of a unit Gaussian; +0.2546 bit, 1.53 dB; Huffman's code takes less than 0.04 bit more."""
    x = np.random.default_rng(4).standard_normal(1_000_000)
    rounded = quantise_fixed_step(x, 0.1)
    distortion = float(np.mean((rounded - x) ** 2))
    drawn = np.round(rounded / 0.1).astype(np.int64)
    rate = float(info.entropy(drawn, interval=False))
    bound = -0.5 * math.log2(distortion / float(np.mean(x**2)))
    assert rate - bound == pytest.approx(0.2546, abs=2e-3)
    assert 10 * math.log10(distortion * 4**rate) == pytest.approx(1.53, abs=0.02)
    counts = Counts.of(drawn).weights
    code_bits = float(counts @ fitted_code(counts).lengths) / counts.sum()
    assert rate <= code_bits < rate + 0.04


def test_no_quantiser_beats_the_rate_distortion_bound() -> None:
    """Lloyd-Max on a Gaussian about 8 N: its error exceeds 2^-2R of the variance at entropy R."""
    x = stats.norm.ppf((np.arange(40_000) + 0.5) / 40_000, loc=8).astype(np.float32)
    for nq in (1, 2, 3, 4, 5, 6):
        table = lloyd_max_levels(x, nq)
        levels = table.encode(x)
        mse = float(np.mean((table.levels_n[levels].astype(float) - x) ** 2))
        rate = float(info.entropy(levels.astype(np.int64), interval=False))
        assert (
            4**-rate < mse < 2.8 * 4**-rate and rate <= nq
        )  # at most 4.35 dB worse (Panter and Dite), without the code
    two = lloyd_max_levels(x, 1).levels_n - 8
    assert two == pytest.approx([-math.sqrt(2 / math.pi), math.sqrt(2 / math.pi)], abs=1e-3)


def test_the_full_ratio_counts_every_bit_of_a_file(tmp_path: Path) -> None:
    """CR_full = file size: 8 bytes = CR_full 96 m V, for two frames; eq. 9 omits most side bits."""
    stream = tmp_path / "ramp.touch"
    scene = tiny_scenes()[0]
    encoded = pipeline.encode(scene, stream, EncodeSpec(nw=4)).summary()
    compared = pipeline.compare(scene, stream)
    with pipeline.open_file(stream) as opened:
        read = opened.summary()
        raw_bits = RAW_BITS_PER_VECTOR * len(opened.medium) * opened.grid.voxel_count
    file_bits = 8 * stream.stat().st_size
    assert raw_bits == 96 * 2 * 16**3
    for summary in (encoded, read, compared.summary()):
        assert summary["cr_full"] * raw_bits == pytest.approx(file_bits, rel=1e-12)
    assert compared.bits.total == file_bits
    literal = compared.bits.amplitude + compared.bits.direction
    assert read["cr_literal"] * raw_bits == pytest.approx(literal, rel=1e-12)
    assert literal < file_bits


def test_raw_sizes() -> None:
    """Three float32 a vector; 10^12 voxels are 12 TB a frame, computed and not allocated."""
    grid = Grid((10_000, 10_000, 10_000), (1e-4,) * 3, (0.0,) * 3)
    assert RAW_BITS_PER_VECTOR == 3 * 32
    assert grid.voxel_count * RAW_BITS_PER_VECTOR == 8 * 12 * 10**12
    omni = device("phantom-omni")
    assert math.prod(omni.lattice) == 8_080_288_574
    assert math.prod(omni.lattice) ** (1 / 3) == pytest.approx(2006, abs=1)


# -- the law of data processing ----------------------------------------------------------------------------


def joint_codes(frames: NDArray[np.generic]) -> Symbols:
    """One symbol for each distinct frame of [count, ...]; their entropy is the joint entropy."""
    return np.unique(frames.reshape(len(frames), -1), axis=0, return_inverse=True)[1].reshape(-1)


def per_frame(bits: Quantity) -> Quantity:
    return bits.times(1, "bit/frame", "H(W)")


def binary_frames(*shape: int) -> NDArray[np.float64]:
    return np.array(list(itertools.product((0.0, 1.0), repeat=math.prod(shape)))).reshape(-1, *shape)


def test_a_box_raises_the_bits_of_a_sample_and_lowers_those_of_a_field() -> None:
    """Item 11 and the data-processing number of a periodic 3 x 3 image: a sample has 2.630 bits
    instead of 1, the field 2.630 instead of 9.
    """
    images = binary_frames(3, 3)
    filtered = np.stack([fir_filter(i, np.ones((3, 3)), boundary="wrap") for i in images])
    sums = np.round(filtered).astype(np.int64)
    assert filtered == pytest.approx(sums, abs=1e-12)
    joint = info.joint_entropy(*sums.reshape(512, 9).T, interval=False)
    assert float(joint) == pytest.approx(2.629928, abs=6e-7)
    assert float(info.joint_entropy(*images.astype(np.int64).reshape(512, 9).T, interval=False)) == 9
    before, after = (info.entropy(f.astype(np.int64), interval=False) for f in (images, sums))
    assert float(before) == 1 and float(after) == pytest.approx(2.629928, abs=6e-7)
    of_frames = info.mutual_information(np.arange(512), joint_codes(sums), interval=False)
    assert float(of_frames) == pytest.approx(
        float(joint), abs=1e-12
    )  # I(W; M(W)) = H(M(W)), as M is deterministic
    found = capacity(Quantity("H(W)", 9.0, "bit/frame"), per_frame(joint), codomain_bits(9, 10))
    assert float(found.wmr) == pytest.approx(0.292214, abs=6e-7)
    assert float(found.hil) == pytest.approx(0.707786, abs=6e-7)


def test_a_box_within_an_image_and_its_decimation() -> None:
    images = binary_frames(4, 4)
    # the images are along the last axis, outside the reach of the taps
    filtered = np.round(fir_filter(np.moveaxis(images, 0, -1), np.ones((3, 3)))).astype(np.int64)
    inner = np.moveaxis(filtered[1:3, 1:3], -1, 0)
    joint = info.joint_entropy(*inner.reshape(-1, 4).T, interval=False)
    assert float(joint) == pytest.approx(8.786455, abs=6e-7)
    found = capacity(Quantity("H(W)", 16.0, "bit/frame"), per_frame(joint), codomain_bits(4, 10))
    assert float(found.wmr) == pytest.approx(8.786455 / 16, abs=5e-8)
    decimated = info.entropy(inner[:, 0, 0], interval=False)  # one sample in nine: 0.292 bits a sample
    assert float(decimated) == pytest.approx(2.629928, abs=6e-7) and float(decimated) / 9 < 1


@pytest.mark.parametrize("kernel", LOW_PASSES)
@pytest.mark.parametrize("shape", [(3, 3, 1), (6, 5, 1), (13, 12, 1)])
def test_the_mapping_adds_no_information(kernel: str, shape: tuple[int, int, int]) -> None:
    """M of paper section 3.1, low-pass, resample, limit, requantise, on all 2^7 fields, and on
    finer lattices.
    """
    grid = Grid((6, 6, 1), (0.001,) * 3, (0.0,) * 3)
    target = Grid(shape, (0.006 / shape[0], 0.006 / shape[1], 0.001), (0.0003, 0.0, 0.0))
    indices = np.array([[0, 0, 0], [1, 1, 0], [3, 3, 0], [4, 2, 0], [2, 4, 0], [5, 5, 0], [4, 4, 0]])
    forces = np.float32([[1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 1], [-1, 0, 0], [1, -1, 1], [0, 0, 3]])
    fields = [
        ForceField.from_support(grid, indices[np.flatnonzero(bits)], forces[np.flatnonzero(bits)])
        for bits in itertools.product((0, 1), repeat=7)
    ]
    linear = [resample(f, target, kernel) for f in fields]
    clipped = [limit_forces(f, 1.0, 0.05) for f in linear]
    first = joint_codes(np.stack([f.to_dense() for f in linear]))
    second = joint_codes(np.stack([f.to_dense() for f in clipped]))
    bits = [7.0] + [float(info.entropy(codes, interval=False)) for codes in (first, second)]
    assert bits[0] >= bits[1] - 1e-12 and bits[1] >= bits[2] - 1e-12
    for quantiser in ("weber:0.25/ico1", "uniform:0.3/none", "components:0.5", "lloyd-max:2/octa1"):
        quantise = FieldQuantiserSpec.parse(quantiser).fit(clipped)
        codes = joint_codes(np.stack([quantise(f).to_dense() for f in clipped]))
        rendered = info.entropy(codes, interval=False)
        assert 0 < float(rendered) <= bits[2] + 1e-12
        information = info.mutual_information(np.arange(128), codes, interval=False)
        assert float(information) == pytest.approx(float(rendered), abs=1e-12)
        codomain = codomain_bits(target.voxel_count, quantise.alphabet)
        found = capacity(Quantity("H(W)", 7.0, "bit/frame"), per_frame(rendered), codomain)
        assert float(found.wmr) == pytest.approx(float(rendered) / 7) and not found.notes
        assert float(found.wmr) + float(found.hil) == pytest.approx(1, abs=1e-15)


def test_voxel_entropies_that_the_object_entropies_of_the_paper_imply() -> None:
    """Tables 1 and 2: h2(p) + p H_object is far from the printed 1.2, 3.7 and 1.9 bits."""
    cases = ((1.8e5 / 8e9, 2.3, 0.00043, 1.2), (5.5e8 / 8e9, 5.2, 0.719, 3.7), (672 / 1024, 3.1, 2.96, 1.9))
    for p, on_object, implied, printed in cases:
        found = binary_entropy_bits(p) + p * on_object
        assert found == pytest.approx(implied, rel=8e-3)
        assert abs(found - printed) > 1
    for occupancy, on_object, printed in ((0.20, 2.3, 1.2), (0.52, 5.2, 3.7), (0.32, 3.1, 1.9)):
        assert binary_entropy_bits(occupancy) + occupancy * on_object == pytest.approx(printed, abs=0.025)
    assert 8e9 * binary_entropy_bits(1.8e5 / 8e9) == pytest.approx(3.0e6, rel=0.02)  # omitted by object mode


# -- the bias of counting ----------------------------------------------------------------------------------


@pytest.mark.parametrize("probability", [0.5, 0.3, 0.2])
def test_the_plug_in_is_low_by_half_a_nat_for_each_symbol_but_one(probability: float) -> None:
    """-(K - 1)/(2 n ln 2) for a coin, by a sum over all counts; Miller and Madow correct it."""
    bias = {}
    for n in (200, 800):
        k = np.arange(n + 1)
        chance = stats.binom.pmf(k, n, probability)
        for name in ("plug-in", "miller-madow"):
            mean = sum(c * estimate_bits([i, n - i], name) for i, c in zip(k.tolist(), chance) if c > 1e-18)
            bias[name, n] = float(mean) - binary_entropy_bits(probability)
        first_order = -1 / (2 * n * math.log(2))
        assert bias["plug-in", n] == pytest.approx(
            first_order, rel=2 / n + 1 / (n * probability * (1 - probability))
        )
        assert abs(bias["miller-madow", n]) < 0.04 * abs(first_order)
    assert bias["plug-in", 200] / bias["plug-in", 800] == pytest.approx(4, rel=0.02)
    assert bias["miller-madow", 200] / bias["miller-madow", 800] == pytest.approx(16, rel=0.05)


# -- quantisers and codebooks ------------------------------------------------------------------------------


@pytest.mark.parametrize(("k", "steps"), [(0.05, 1090), (0.10, 545)])
def test_even_steps_that_keep_the_mask_are_many(k: float, steps: int) -> None:
    """0.03 to 3.3 N; the Weber ladder takes 47 and 24."""
    step_n = 2 * k * 0.03
    assert within_mask_from_n(step_n, k) == pytest.approx(0.03)
    levels = uniform_levels(step_n, 3.3).levels_n
    assert np.count_nonzero(levels > 0.03 * (1 + 1e-6)) == steps
    assert WeberLadder.spanning(k, 0.03, 3.3).steps < steps / 20


def test_span_of_eighteen_bits() -> None:
    """Six bits for each signed component, 1 + 31 + 31 levels: 503:1 at k = 0.1; 63 amplitudes at
    0.05: 547:1.
    """
    ladder = WeberLadder(0.1, 3.3 / 503, 31)
    assert 2 * len(ladder.levels_n) - 1 == 1 + 31 + 31 < 1 << 6  # zero has no sign
    assert ladder.force_max_n / ladder.force_min_n == pytest.approx(503, abs=0.5)
    assert ladder.force_min_n == pytest.approx(0.0066, abs=5e-5)
    amplitudes = WeberLadder(0.05, 0.01, 63)
    assert len(amplitudes.levels_n) == 1 << 6
    assert amplitudes.force_max_n / amplitudes.force_min_n == pytest.approx(547, abs=0.5)
    assert len(Codebook.get("ico20")) == 4002 <= 1 << 12


@settings(max_examples=20)
@given(st.integers(0, 1000))
def test_components_within_the_mask_keep_the_vector_within_it(seed: int) -> None:
    """A Weber ladder on each component guarantees ||e|| <= k ||x|| above its threshold."""
    table = weber_levels(WeberLadder.spanning(0.1, 0.0066, 3.3))
    rng = np.random.default_rng(seed)
    size = np.exp(rng.uniform(math.log(0.0067), math.log(3.2), (400, 3))).astype(np.float32)
    decoded = table.levels_n[table.encode(size.ravel())].reshape(size.shape).astype(float)
    error = np.linalg.norm(decoded - size, axis=1)  # a component keeps its sign
    assert (error <= 0.1 * np.linalg.norm(size.astype(float), axis=1)).all()
    assert (error > 0.05 * np.linalg.norm(size.astype(float), axis=1)).any()


@pytest.mark.parametrize(("k", "vertices"), [(0.25, 92), (0.15, 252), (0.10, 642), (0.05, 2252)])
def test_the_next_smaller_icosahedron_exceeds_the_mask(k: float, vertices: int) -> None:
    """2 sin(theta / 2) <= k of neighbouring directions at equal amplitude."""

    def chord(codebook: Codebook) -> float:
        return 2 * math.sin(math.radians(codebook.covering_radius_deg) / 2)

    frequency = round(math.sqrt((vertices - 2) / 10))
    sufficient, smaller = Codebook.get(f"ico{frequency}"), Codebook.get(f"ico{frequency - 1}")
    assert len(sufficient) == vertices and chord(sufficient) <= k < chord(smaller)


def test_two_hundred_and_fifty_eight_directions_cost_a_bit_more_and_cover_worse() -> None:
    octahedral, icosahedral = Codebook.get("octa3"), Codebook.get("ico5")
    assert (len(octahedral), len(icosahedral)) == (4 * 8**2 + 2, 10 * 5**2 + 2)
    assert [(len(c) - 1).bit_length() for c in (octahedral, icosahedral)] == [9, 8]
    assert icosahedral.covering_radius_deg < octahedral.covering_radius_deg

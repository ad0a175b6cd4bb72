"""Sampling of a huge lattice, compared with lattices small enough to count completely."""

from __future__ import annotations

import math

import numpy as np
import pytest
from reproduction.lattice_sample import LatticeSample, sample_lattice

from touchfield.codec.paper.field_quantiser import FieldQuantiser, FieldQuantiserSpec
from touchfield.errors import InvalidArgument
from touchfield.measure.estimators import binary_entropy_bits, entropy_bits
from touchfield.medium import ForceField, Grid
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Box, Ellipsoid, Sphere

PROFILE = profile_of(LawSpec(), math.inf)
BODIES = AnalyticScene(
    (
        Ellipsoid((0.02, 0.03, 0.04), (0.012, 0.008, 0.009)),
        Box((0.045, 0.02, 0.015), (0.01, 0.006, 0.004), (20, 30, 10)),
    )
)
LATTICE = Grid.over_box((0, 0, 0), (0.06, 0.05, 0.06), (60, 50, 60))


def field(part: Grid) -> ForceField:
    return BODIES.field(0, part, PROFILE)


@pytest.fixture(scope="module")
def quantiser() -> FieldQuantiser:
    return FieldQuantiserSpec.parse("weber:0.25/ico1").fit([], 3.3)


def draw_sample(quantiser: FieldQuantiser, seed: int, per_axis: int = 20, starts: int = 16) -> LatticeSample:
    return sample_lattice(
        field, LATTICE, {"Q": quantiser.symbols_of}, per_axis=per_axis, starts=starts, seed=seed
    )


def test_small_lattice_is_counted_completely(quantiser: FieldQuantiser) -> None:
    sample = draw_sample(quantiser, 0, per_axis=64)
    symbols = quantiser(field(LATTICE))
    found = sample.entropies("Q")
    assert sample.is_whole and sample.count.interval is None and found.object.interval is None
    assert sample.count.value == field(LATTICE).support_count
    times = np.bincount(symbols.object_symbols)
    assert found.object.value == pytest.approx(entropy_bits(times), abs=1e-12)
    assert found.density.value == symbols.object_count / LATTICE.voxel_count
    all_counts = np.append(times[times > 0], LATTICE.voxel_count - symbols.object_count)
    assert found.voxel.value == pytest.approx(entropy_bits(all_counts), abs=1e-12)


def test_all_starts_together_cover_the_lattice() -> None:
    """Each sample of the lattice belongs to exactly one start, so the count is unbiased."""

    class Fixed:
        def __init__(self, first: tuple[int, int, int]) -> None:
            self.first = first

        def integers(self, low: int, high: object) -> np.ndarray:
            return np.array(self.first)

    ragged = Grid(tuple(n - 1 for n in LATTICE.shape), LATTICE.spacing_m, LATTICE.origin_m)  # type: ignore[arg-type]
    with pytest.MonkeyPatch.context() as patch:
        total = 0
        for first in np.ndindex(3, 3, 3):
            patch.setattr(np.random, "default_rng", lambda seed, first=first: Fixed(first))
            sample = sample_lattice(field, ragged, {}, per_axis=20, starts=8)
            assert sample.spread == (3, 3, 3) and len(set(sample.held.tolist())) == 1
            total += int(sample.held[0])
    assert total == field(ragged).support_count


def test_interval_coverage_is_nominal(quantiser: FieldQuantiser) -> None:
    symbols = quantiser(field(LATTICE))
    times = np.bincount(symbols.object_symbols)
    truths = np.array(
        [field(LATTICE).support_count, symbols.object_count / LATTICE.voxel_count, entropy_bits(times)]
    )
    truths = np.append(truths, binary_entropy_bits(truths[1]) + truths[1] * truths[2])
    draws = 40
    covered = np.zeros(4)
    counts = []
    for seed in range(draws):
        sample = draw_sample(quantiser, seed)
        found = sample.entropies("Q")
        counts.append(sample.count.value)
        for i, quantity in enumerate((sample.count, found.density, found.object, found.voxel)):
            assert quantity.interval is not None
            covered[i] += quantity.interval.low <= truths[i] <= quantity.interval.high
    assert (covered >= 0.85 * draws).all(), covered  # 95 % minus three standard deviations
    error = np.mean(counts) - truths[0]
    assert abs(error) < 4 * np.std(counts) / math.sqrt(draws)
    assert np.std(counts) < 0.02 * truths[0], "far less than independent samples would vary"


def test_objects_smaller_than_the_step_are_counted() -> None:
    """A ball of a few samples in a lattice of 10^9, smaller than the step of any start."""
    grid = Grid.over_box((0, 0, 0), (1, 1, 1), (1000, 1000, 1000))
    ball = AnalyticScene((Sphere((0.3217, 0.611, 0.4), 0.0061),))
    truth = 4 / 3 * math.pi * 6.1**3
    samples = [
        sample_lattice(lambda part: ball.field(0, part, PROFILE), grid, {}, per_axis=64, starts=24, seed=seed)
        for seed in range(12)
    ]
    counts = np.array([sample.count.value for sample in samples])
    assert abs(counts.mean() - truth) < 4 * counts.std() / math.sqrt(len(counts)) + 1e-9
    assert counts.std() > 0


def test_the_identity_of_voxels_and_objects_holds(quantiser: FieldQuantiser) -> None:
    found = draw_sample(quantiser, 3).entropies("Q")
    p = found.density.value
    assert found.voxel.value == pytest.approx(binary_entropy_bits(p) + p * found.object.value, abs=1e-12)
    assert (found.object.weighting, found.voxel.weighting) == ("object", "voxel")


def test_results_are_reproducible(quantiser: FieldQuantiser) -> None:
    assert draw_sample(quantiser, 5).count == draw_sample(quantiser, 5).count
    assert draw_sample(quantiser, 5).count != draw_sample(quantiser, 6).count


def test_few_samples_are_noted(quantiser: FieldQuantiser) -> None:
    fine = FieldQuantiserSpec.parse("weber:0.05/ico12").fit([], 3.3)
    sample = sample_lattice(field, LATTICE, {"fine": fine.symbols_of}, per_axis=10, starts=8)
    assert any("few samples" in note for note in sample.entropies("fine").object.notes)


def test_invalid_arguments_are_refused(quantiser: FieldQuantiser) -> None:
    with pytest.raises(InvalidArgument, match="per_axis"):
        sample_lattice(field, LATTICE, {}, per_axis=0)
    with pytest.raises(InvalidArgument, match="starts"):
        sample_lattice(field, LATTICE, {}, starts=3)
    with pytest.raises(InvalidArgument, match="quantiser"):
        draw_sample(quantiser, 0).entropies("another")
    empty = sample_lattice(ForceField.empty, LATTICE, {"Q": quantiser.symbols_of}, per_axis=20)
    assert empty.count.value == 0
    with pytest.raises(InvalidArgument, match="no force"):
        empty.entropies("Q")

"""Several contacts on one field at once: joint symbols, and what the contacts tell together."""

from __future__ import annotations

import math
import warnings

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from touchfield.errors import InvalidArgument
from touchfield.measure import (
    Counts,
    FieldSymbols,
    conditional_entropy,
    contact_counts,
    entropy,
    interaction_counts,
    mutual_information,
    tool_contacts,
    total_correlation,
)
from touchfield.measure.quantity import FewSamplesWarning
from touchfield.medium import Grid
from touchfield.medium.trace import Trace

GRID = Grid((4, 3, 2), (0.01, 0.02, 0.005), (-0.02, 0.1, 0.0))
WALLS = FieldSymbols.from_dense(
    GRID, np.broadcast_to(np.arange(4)[:, None, None], GRID.shape), 4, "the plane along x"
)
"""Each of four planes along x has a symbol of its own: the symbol is the plane that a contact is in."""
ERROR = 0.2


def paths(seed: int, samples: int, stay: float) -> NDArray[np.int64]:
    """Planes of three contacts [3, samples]: a Markov chain, and two noisy copies of it.

    The first stays in its plane with probability `stay`, else takes any at random. Each copy is in another
    plane with probability `ERROR`, independently.
    """
    rng = np.random.default_rng(seed)
    moves = rng.random(samples) >= stay
    moves[0] = True
    first = rng.integers(0, 4, samples)[np.maximum.accumulate(np.where(moves, np.arange(samples), 0))]
    wrong = rng.random((2, samples)) < ERROR
    copies = (first + wrong * rng.integers(1, 4, (2, samples))) % 4
    return np.stack([first, *copies])


def contacts_in(planes: NDArray[np.int64]) -> tuple[Trace, ...]:
    """A trace for each contact, at the centre of a cell of its plane."""
    indices = [np.stack([p, 0 * p + 1, 0 * p], axis=1).astype(float) for p in planes]
    return tuple(Trace.regular(GRID.to_m(index)) for index in indices)


def noise_bits() -> float:
    """H of a copy given the first contact: the entropy of a symmetric channel of four symbols."""
    return -(1 - ERROR) * math.log2(1 - ERROR) - ERROR * math.log2(ERROR / 3)


def pair_bits() -> float:
    """I of the two copies: two such channels one after the other."""
    q = 1 - ((1 - ERROR) ** 2 + ERROR**2 / 3)
    return 2 + (1 - q) * math.log2(1 - q) + q * math.log2(q / 3)


def test_contacts_tell_together_what_the_channel_between_them_says() -> None:
    counts = contact_counts(contacts_in(paths(0, 60_000, 0.0)), WALLS)
    assert counts.variables == ("S1", "S2", "S3") and counts.weighting == "interaction"
    expected = {
        entropy(counts): 2 + 2 * noise_bits(),
        total_correlation(counts): 2 * (2 - noise_bits()),
        conditional_entropy(counts, given=0): 2 * noise_bits(),
    }
    for quantity, truth in expected.items():
        assert quantity.value == pytest.approx(truth, abs=0.01), quantity.name
        assert quantity.interval is not None and quantity.interval.low <= truth <= quantity.interval.high
    assert total_correlation(counts).name == "T(S1;S2;S3)"
    two = contact_counts(contacts_in(paths(0, 60_000, 0.0)[1:]), WALLS)
    assert total_correlation(two).value == mutual_information(two).value
    assert mutual_information(two).value == pytest.approx(pair_bits(), abs=0.01)


def test_the_interval_allows_for_a_hand_that_stays() -> None:
    truth, covered, widths = 2 * (2 - noise_bits()), 0, []
    for seed in range(12):
        found = total_correlation(contact_counts(contacts_in(paths(seed, 4000, 0.95)), WALLS)).interval
        assert found is not None
        covered += found.low <= truth <= found.high
        widths.append(found.high - found.low)
    assert covered >= 9, "95 % intervals; fewer than 9 of 12 have a chance of 0.3 %"
    jumping = total_correlation(contact_counts(contacts_in(paths(0, 4000, 0.0)), WALLS)).interval
    assert jumping is not None and np.median(widths) > jumping.high - jumping.low


def test_independent_contacts_share_nothing_beyond_the_bias() -> None:
    rng = np.random.default_rng(3)
    n = 20_000
    counts = contact_counts(contacts_in(rng.integers(0, 4, (3, n))), WALLS)
    bias = (64 - 3 * 4 + 3 - 1) / (2 * n * math.log(2))
    found = total_correlation(counts)
    assert found.value == pytest.approx(bias, rel=0.5)
    assert found.interval is not None and found.interval.low == 0
    assert abs(total_correlation(counts, estimator="miller-madow", interval=False).value) < bias / 2


def test_given_probabilities_have_an_exact_total_correlation() -> None:
    same = np.zeros((2, 2, 2))
    same[0, 0, 0] = same[1, 1, 1] = 0.5
    assert total_correlation(Counts.of_probabilities(same)).value == 2.0
    parity = np.array([[[0.25, 0], [0, 0.25]], [[0, 0.25], [0.25, 0]]])  # pairs share nothing, all three do
    assert total_correlation(Counts.of_probabilities(parity)).value == pytest.approx(1.0, abs=1e-12)
    assert total_correlation(Counts.of_probabilities(parity.sum(axis=2))).value == 0.0


def test_a_sample_counts_only_with_all_contacts_inside_and_one_contact_is_the_interaction() -> None:
    planes = np.array([[0, 1, 2, 3, 0], [0, 1, 2, 4, -1]])  # the second leaves the box twice
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", FewSamplesWarning)
        both = contact_counts(contacts_in(planes), WALLS, interval=False)
        (first, _) = contacts_in(planes)
        alone = contact_counts((first,), WALLS, interval=False)
        usual = interaction_counts(first, WALLS, interval=False)
    assert both.cells.tolist() == [[0, 0], [1, 1], [2, 2]] and both.total == 3
    outside = "have a contact outside the box of the field and were left out"
    assert both.notes == (f"2 of 5 samples of the trace {outside}",)
    assert alone.cells.tolist() == usual.cells.tolist() and alone.variables == usual.variables == ("S",)
    assert both.alphabet == 16


def test_contacts_meet_the_frame_of_their_time() -> None:
    empty = FieldSymbols.from_dense(GRID, np.zeros(GRID.shape, int), 4, "the plane along x")
    contacts = contacts_in(np.array([[3, 3, 3, 3], [1, 1, 1, 1]]))
    counts = contact_counts(contacts, (WALLS, empty), interval=False, rate_hz=500.0)
    assert counts.cells.tolist() == [[0, 0], [3, 1]] and counts.weights.tolist() == [2, 2]


def test_points_of_a_tool_turn_with_it() -> None:
    rng = np.random.default_rng(1)
    turns = Rotation.random(20, random_state=2)
    quaternions = np.roll(turns.as_quat(), 1, axis=1)  # scipy's real part is the last
    trace = Trace(np.arange(20.0), rng.normal(size=(20, 3)), quaternions)
    points = rng.normal(size=(4, 3))
    for point, contact in zip(points, tool_contacts(trace, points), strict=True):
        np.testing.assert_allclose(contact.positions_m, trace.positions_m + turns.apply(point), atol=1e-12)
        assert contact.times_s.tolist() == trace.times_s.tolist()
    (moved,) = tool_contacts(Trace.regular(trace.positions_m), points[:1])
    assert moved.positions_m.tolist() == (trace.positions_m + points[0]).tolist()


def test_contacts_that_cannot_be_are_named() -> None:
    first, second = contacts_in(paths(0, 10, 0.0)[:2])
    later = Trace(second.times_s + 1, second.positions_m)
    with pytest.raises(InvalidArgument, match=r"contact 2: found 10 samples from 1 to 1.009 s"):
        contact_counts((first, later), WALLS)
    with pytest.raises(InvalidArgument, match="contacts: found no trace"):
        contact_counts((), WALLS)
    away = Trace(first.times_s, first.positions_m + 1)
    with pytest.raises(InvalidArgument, match="never all of them in the field"):
        contact_counts((first, away), WALLS)
    with pytest.raises(InvalidArgument, match=r"points_m: found shape \(3,\)"):
        tool_contacts(first, (0.0, 0.0, 0.0))

"""Fits of trials of an observer whose threshold is known, tests against chance, and the procedures."""

import math
from collections import Counter

import numpy as np
import pytest
from scipy.stats import binom

from touchfield.errors import InvalidArgument, MissingExtra
from touchfield.study import (
    Comparison,
    Psychometric,
    SimulatedObserver,
    StudyDesign,
    fit_psychometric,
    power_of,
    procedure_of,
)
from touchfield.study.analysis import level_tests, simulate
from touchfield.study.design import TASKS

LEVELS = (0.02, 0.04, 0.08, 0.16, 0.32, 0.64)
COMPARED = tuple(Comparison("x.touch", level) for level in LEVELS)


def design(**options):
    return StudyDesign("r.touch", COMPARED, **options)


@pytest.mark.parametrize(("task", "procedure"), [("3ifc", "staircase"), ("2ifc", "constant")])
def test_the_interval_contains_the_threshold_of_a_known_observer(task, procedure):
    function = Psychometric(0.12, 2.5, TASKS[task], 0.02)
    found = power_of(design(task=task, procedure=procedure, trials=60), function, runs=100)
    assert found["covered"] >= 0.95
    assert found["bias"] == pytest.approx(1, abs=0.15)
    assert found["closed"] > 0.9 and found["width"] < 4  # an interval of everything would contain it, too


def test_questplus_places_the_trials_around_the_threshold():
    pytest.importorskip("questplus")
    function = Psychometric(0.12, 2.5, 1 / 3, 0.0)
    own = design(procedure="questplus", trials=40)
    fits = []
    for seed in range(2):
        levels, correct = simulate(own, SimulatedObserver(function, seed))
        assert np.mean([0.04 <= level <= 0.32 for level in levels]) > 0.7
        fits.append(fit_psychometric(levels, correct, own.chance))
    assert np.median([fit.function.threshold for fit in fits]) == pytest.approx(0.12, rel=0.4)


def test_without_the_library_questplus_names_the_extra(monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "questplus", None)
    with pytest.raises(MissingExtra, match=r"touchfield\[study\]"):
        procedure_of(design(procedure="questplus"))


def test_more_trials_narrow_the_interval():
    function = Psychometric(0.12, 2.5, 1 / 3)
    few, many = (power_of(design(procedure="constant", trials=n), function, runs=10) for n in (48, 384))
    assert many["width"] < few["width"] / 1.5


def test_the_likelihood_of_the_fit_is_that_of_the_trials_and_the_highest():
    observer = SimulatedObserver(Psychometric(0.1, 3.0, 0.5), 4)
    levels, correct = simulate(design(task="2ifc", procedure="constant", trials=120), observer)
    fit = fit_psychometric(levels, correct, 0.5)

    def log_likelihood(function):
        p = function(levels)
        return float(np.log(np.where(correct, p, 1 - p)).sum())

    assert fit.log_likelihood == pytest.approx(log_likelihood(fit.function), abs=1e-9)
    assert log_likelihood(fit.function) >= log_likelihood(observer.function) - 0.1
    for end in (fit.low, fit.high):  # outside the interval no slope and lapse come within 1.92 of the best
        beyond = end / 1.05 if end == fit.low else end * 1.05
        best = max(
            log_likelihood(Psychometric(beyond, slope, 0.5, lapse))
            for slope in np.geomspace(0.5, 15, 60)
            for lapse in (0, 0.02, 0.04, 0.06)
        )
        assert best < fit.log_likelihood - 1.92 + 0.02


def test_all_correct_and_chance_leave_the_interval_open():
    perfect = fit_psychometric([0.1, 0.2] * 20, [True] * 40, 0.5)
    assert perfect.low is None and perfect.high is not None and perfect.high < 0.2
    guessing = fit_psychometric([0.1, 0.2] * 20, [True, True, False, False] * 10, 0.5)
    assert guessing.high is None and guessing.low is not None and guessing.low > 0.1
    with pytest.raises(InvalidArgument, match="trials"):
        fit_psychometric([], [], 0.5)


@pytest.mark.parametrize(
    ("rates", "expected"),
    [
        ((0.5, 0.5, 1, 1), {"slope"}),  # a step
        ((0.5, 0.75, 0.9, 0.9), {"lapse"}),
        ((1, 1, 1, 1), {"threshold"}),
        ((0.5, 0.65, 0.85, 0.98), set()),
    ],
)
def test_a_parameter_at_the_limit_of_the_fit_is_named(rates, expected):
    levels = [level for level in (0.1, 0.2, 0.4, 0.8) for _ in range(100)]
    correct = [i < 100 * rate for rate in rates for i in range(100)]
    assert set(fit_psychometric(levels, correct, 0.5).at_limit) == expected


def test_a_level_is_tested_by_the_binomial_law():
    (row,) = level_tests([0.1] * 20, [True] * 15 + [False] * 5, 0.5)
    assert row["p_value"] == pytest.approx(binom.sf(14, 20, 0.5))
    assert (row["trials"], row["correct"], row["rate"]) == (20, 15, 0.75)
    assert binom.sf(14, 20, row["low"]) == pytest.approx(0.025, abs=1e-6)


def test_the_function_is_weibulls():
    function = Psychometric(2.0, 3.0, 1 / 3, 0.05)
    assert function(2.0) == pytest.approx(1 / 3 + (2 / 3 - 0.05) * (1 - math.exp(-1)))
    np.testing.assert_allclose(function([0.0, 1e9]), [1 / 3, 0.95])
    for wrong in ({"threshold": 0.0}, {"slope": 0.0}, {"lapse": 0.6}, {"chance": 1.0}):
        with pytest.raises(InvalidArgument, match=next(iter(wrong))):
            Psychometric(**{"threshold": 1.0, **wrong})


def test_a_staircase_goes_down_after_three_and_up_after_one():
    procedure = procedure_of(design(procedure="staircase"))
    steps = []
    for is_correct in (1, 1, 1, 1, 1, 0, 1, 1, 1, 1, 1, 1):
        steps.append(procedure.next_index())
        procedure.update(steps[-1], bool(is_correct))
    assert steps == [5, 5, 5, 4, 4, 4, 5, 5, 5, 4, 4, 4]
    assert procedure.next_index() == 3


def test_constant_stimuli_are_balanced_and_in_another_order_for_another_seed():
    orders = []
    for seed in (1, 2):
        procedure = procedure_of(design(procedure="constant", seed=seed))
        order = []
        for _ in range(18):
            order.append(procedure.next_index())
            procedure.update(order[-1], True)
        assert set(Counter(order).values()) == {3}
        orders.append(order)
    assert orders[0] != orders[1]


@pytest.mark.parametrize("task", TASKS)
def test_the_answer_is_where_the_intervals_differ_and_positions_are_balanced(task):
    own, answers = design(task=task, seed=7), Counter()
    for trial in range(600):
        order, answer = own.order(trial), own.answer(trial)
        answers[answer] += 1
        if task == "3ifc":
            assert sum(order) == 1 and order[answer - 1] == 1
        elif task == "2ifc":
            assert order[0] == 0 and sum(order) == 1 and order[answer] == 1
        else:
            assert sum(order[:2]) == 1 and order[answer - 1] == order[2]
    assert set(answers) == set(range(1, own.answers + 1))
    assert min(answers.values()) > 0.8 * 600 / own.answers

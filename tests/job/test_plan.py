"""Planning for a bit rate: the frontier, the choice, and that it is what `encode` then makes."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.job import EncodeSpec, Plan, PlanGrid, PlanTrial, parse_rate, plan
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.shapes import Sphere

SPEC = EncodeSpec(thickness_m=0.01, oversample=1, touch=TouchSpec(effort="fast"))
SEARCH = PlanGrid(nw=(4, 5), k=(0.1, 0.4), step_n=(0.1, 0.4), directions=("ico3",))


@pytest.mark.parametrize(
    ("text", "bits"),
    [
        ("64kbit/s", 64e3),
        ("1.5 Mbit/s", 1.5e6),
        ("8kB/s", 64e3),
        ("100B/s", 800),
        (".5kbit/s", 500),
    ],
)
def test_rates_are_read(text: str, bits: float) -> None:
    assert parse_rate(text) == bits


@pytest.mark.parametrize(
    "text", ["", "64", "64kbit", "64kb/s", "-3kbit/s", "0bit/s", "1e3bit/s", "kbit/s", "1.2.3B/s"]
)
def test_other_rates_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="budget"):
        parse_rate(text)


@cache
def found() -> Plan:
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    return plan(scene, 900_000.0, SPEC, SEARCH)


def test_every_setting_is_tried_and_the_best_within_the_budget_taken() -> None:
    tried = found()
    assert len(tried.trials) == 2 * (2 * 2 + 2 + 1)
    within = [t for t in tried.trials if t.bits_per_s <= 900_000]
    assert tried.chosen.nmse == min(t.nmse for t in within)
    assert 0 < len(within) < len(tried.trials), "the budget cuts"
    finest = [t for t in tried.trials if t.spec.nw == 5 and t.spec.coder == "touch" and t.spec.touch.mode == "mask"]
    assert finest[0].mask_kept == 1, "the promise, where nothing is interpolated"
    coarse = [t for t in tried.trials if t.spec.nw == 4]
    assert all(t.mask_kept < 1 for t in coarse), "what a coarse lattice leaves out counts"


def test_the_rate_is_that_of_the_file(tmp_path: Path) -> None:
    from touchfield.job import encode

    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    chosen = found().chosen
    size = encode(scene, tmp_path / "s.touch", chosen.spec).file_bytes
    assert chosen.file_bytes == pytest.approx(size, abs=450), "head and provenance are a guess"


def test_the_summary_and_the_picture(tmp_path: Path) -> None:
    told = found().summary()
    assert told["trials"][told["chosen"]]["bits_per_s"] <= 900_000
    front = [told["trials"][i] for i in told["front"]]
    assert [t["bits_per_s"] for t in front] == sorted(t["bits_per_s"] for t in front)
    assert told["lambda_bits_per_s"] > 0 and told["encode_options"].startswith("--nw")
    found().draw(tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 5000


def test_too_little_names_the_least() -> None:
    with pytest.raises(InvalidArgument, match=r"--budget.*at least \d+ bit/s, the nearest"):
        plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), 10.0, SPEC, PlanGrid((4,), (0.4,), (), ()))


@given(st.lists(st.tuples(st.integers(1, 60), st.integers(0, 30)), min_size=1, max_size=20), st.integers(1, 60))
def test_lambda_makes_the_choice_where_it_lies_on_the_hull(rows: list[tuple[int, int]], budget: int) -> None:
    trials = tuple(PlanTrial(SPEC, size, 8, nmse / 30, 0.0, 1.0, 1.0) for size, nmse in rows)
    if all(t.bits_per_s > budget for t in trials):
        with pytest.raises(InvalidArgument, match="budget"):
            Plan(trials, 0.1, 0.05, budget, "x", 2)
        return
    made = Plan(trials, 0.1, 0.05, budget, "x", 2)
    chosen, multiplier = made.chosen, made.multiplier
    assert chosen.bits_per_s <= budget
    assert not any(t.bits_per_s <= budget and t.nmse < chosen.nmse for t in trials)
    if multiplier is not None:
        costs = [t.bits_per_s + multiplier * t.nmse for t in made.front]
        on_edge = [t for t, c in zip(made.front, costs, strict=True) if c <= min(costs) + 1e-6]
        assert on_edge[0].bits_per_s <= chosen.bits_per_s <= on_edge[-1].bits_per_s

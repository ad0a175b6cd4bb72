"""Planning for a bit rate: the frontier, the choice, and that `encode` gives the planned file."""

from __future__ import annotations

import math
import sys
from functools import cache
from pathlib import Path

import pytest
from hypothesis import given, strategies as st

from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.filters import rebuild_level
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import HapticMedium
from touchfield.pipeline import encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene
from touchfield.tasks.plan import Budget, Plan, PlanGrid, Trial, amount, parse_budget, plan

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
    assert parse_budget(text) == Budget(bits_per_s=bits)


@pytest.mark.parametrize(("text", "size"), [("60kB", 60e3), ("512 B", 512), ("1.5MB", 1.5e6)])
def test_sizes_are_read(text: str, size: float) -> None:
    assert parse_budget(text) == Budget(bytes=size)


@pytest.mark.parametrize("arguments", [(), (0.0,), (math.nan,), (1.0, 1.0), (None, -1.0), (math.inf,)])
def test_a_budget_is_either_a_rate_or_a_size(arguments: tuple[float, ...]) -> None:
    with pytest.raises(InvalidArgument, match="one of both, above 0"):
        Budget(*arguments)


@pytest.mark.parametrize(
    "text", ["", "64", "64kbit", "64kb/s", "-3kbit/s", "0bit/s", "1e3bit/s", "kbit/s", "1.2.3B/s"]
)
def test_other_rates_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="budget"):
        parse_budget(text)


@cache
def example_plan() -> Plan:
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    return plan(scene, Budget(bytes=3750), SPEC, SEARCH)


def test_every_setting_is_tried_and_the_best_within_the_budget_selected() -> None:
    tried = example_plan()
    assert len(tried.trials) == 2 * (2 * 2 + 2 + 1)
    within = [t for t in tried.trials if t.file_bytes <= 3750]
    assert tried.choice.nmse == min(t.nmse for t in within)
    assert 0 < len(within) < len(tried.trials), "the budget cuts"
    finest = [
        t for t in tried.trials if t.spec.nw == 5 and t.spec.coder == "touch" and t.spec.touch.mode == "mask"
    ]
    assert finest[0].mask_fraction == 1, "the promise, where nothing is interpolated"
    coarse = [t for t in tried.trials if t.spec.nw == 4]
    assert all(t.mask_fraction < 1 for t in coarse), "what a coarse lattice leaves out counts"


def test_the_rate_is_that_of_the_file(tmp_path: Path) -> None:
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    choice = example_plan().choice
    size = encode(scene, tmp_path / "s.touch", choice.spec).file_bytes
    assert choice.file_bytes == pytest.approx(size, abs=450), "head and provenance are a guess"


def test_the_summary_and_the_picture(tmp_path: Path) -> None:
    summary = example_plan().summary()
    assert summary["trials"][summary["chosen"]]["file_bytes"] <= 3750
    front = [summary["trials"][i] for i in summary["front"]]
    assert [t["file_bytes"] for t in front] == sorted(t["file_bytes"] for t in front)
    assert summary["lambda_bytes"] > 0 and summary["encode_options"].startswith("--nw")
    example_plan().draw(tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 5000


def test_error_of_a_small_budget_states_the_minimum() -> None:
    with pytest.raises(InvalidArgument, match=r"--budget.*at least \d+ bytes, the nearest"):
        plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), 10.0, SPEC, PlanGrid((4,), (0.4,), (), ()))


def test_a_scene_missed_by_the_coarsest_lattice_is_planned() -> None:
    scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.002),))
    spec = EncodeSpec(mapping="1", oversample=1, touch=TouchSpec(effort="fast"))
    assert not prepare(scene, EncodeSpec(mapping="1", oversample=1, nw=3)).medium[0].support_count
    tried = plan(scene, Budget(bytes=60000), spec, PlanGrid((3, 6), (0.1,), (), ()))
    assert tried.choice.spec.nw == 6
    with pytest.raises(InvalidArgument, match="frames without a force"):
        plan(scene, Budget(bytes=60000), spec, PlanGrid((3,), (0.1, 0.2), (), ()))


@given(
    st.lists(st.tuples(st.integers(1, 60), st.integers(0, 30)), min_size=1, max_size=20), st.integers(1, 60)
)
def test_lambda_gives_the_choice_on_the_hull(rows: list[tuple[int, int]], budget: int) -> None:
    trials = tuple(Trial(SPEC, size, 8, nmse / 30, 1.0, 1.0) for size, nmse in rows)
    if all(t.bits_per_s > budget for t in trials):
        with pytest.raises(InvalidArgument, match="budget"):
            Plan(trials, 0.1, 0.05, budget, "x", 2)
        return
    planned = Plan(trials, 0.1, 0.05, budget, "x", 2)
    choice, multiplier = planned.choice, planned.multiplier
    assert choice.bits_per_s <= budget
    assert not any(t.bits_per_s <= budget and t.nmse < choice.nmse for t in trials)
    if multiplier is not None:
        costs = [t.bits_per_s + multiplier * t.nmse for t in planned.front()]
        on_edge = [t for t, c in zip(planned.front(), costs, strict=True) if c <= min(costs) + 1e-6]
        assert on_edge[0].bits_per_s <= choice.bits_per_s <= on_edge[-1].bits_per_s


@given(st.lists(st.tuples(st.integers(1, 50), st.integers(0, 9)), min_size=1, max_size=30))
def test_a_front_is_a_pareto_front(rows: list[tuple[int, int]]) -> None:
    tried = Plan(tuple(Trial(SPEC, size, 2, nmse / 9) for size, nmse in rows), 0.1, 0.01, 1e9, "x", 2)
    front = tried.front()
    for a, b in zip(front, front[1:], strict=False):
        assert a.file_bytes < b.file_bytes and a.nmse > b.nmse
    for trial in tried.trials:
        assert [f for f in front if f.file_bytes <= trial.file_bytes and f.nmse <= trial.nmse]
        better = [
            t
            for t in tried.trials
            if (t.file_bytes < trial.file_bytes and t.nmse <= trial.nmse)
            or (t.file_bytes <= trial.file_bytes and t.nmse < trial.nmse)
        ]
        assert not (trial in front and better)


PAPER = PlanGrid((4, 5), (), (), ("ico1", "ico5"), (0.02, 0.25), (3, 6))


@cache
def of_the_paper() -> Plan:
    return plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), Budget(bytes=1e9), SPEC, PAPER)


def test_the_settings_of_the_paper_are_tried_in_order_and_reported() -> None:
    tried = [(s["nw"], s["k"], s["nq"], s["directions"]) for s in of_the_paper().summary()["trials"]]
    expected = [(w, k, q, d) for w in (4, 5) for k in (0.02, 0.25) for q in (3, 6) for d in ("ico1", "ico5")]
    assert tried == expected
    assert (
        of_the_paper().trials
        == plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), 1e9, SPEC, PAPER).trials
    )


def test_a_trial_equals_encode_and_a_meter(tmp_path: Path) -> None:
    ball = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    tried = of_the_paper()
    reference = prepare(ball, tried.trials[-1].spec).medium[0]
    for trial in (tried.trials[1], tried.trials[-1]):
        encoded = encode(ball, tmp_path / "one.touch", trial.spec)
        assert trial.frames == 1 and abs(encoded.file_bytes - trial.file_bytes) < 450
        meter = FidelityMeter(tried.k, tried.f0_n)
        with open_file(tmp_path / "one.touch") as opened:
            decoded = opened.medium[0]
        if trial.spec.nw == 4:
            decoded = rebuild_level(decoded, reference.grid)
        meter.add(reference, decoded)
        assert meter.nmse_db is not None
        assert trial.nmse == pytest.approx(10 ** (meter.nmse_db / 10))
        assert trial.mask_fraction == 1 - meter.mask_violation_share


def test_effects_of_the_settings() -> None:
    by_setting = {(s["nw"], s["k"], s["nq"], s["directions"]): s for s in of_the_paper().summary()["trials"]}
    for (nw, k, nq, directions), trial in by_setting.items():
        if nw == 4:  # a coarse lattice is small and loses detail between its samples
            fine = by_setting[5, k, nq, directions]
            assert trial["file_bytes"] < fine["file_bytes"] and trial["nmse"] > fine["nmse"]
        if directions == "ico1":
            assert trial["nmse"] > by_setting[nw, k, nq, "ico5"]["nmse"]
    smallest, best = of_the_paper().front()[0], of_the_paper().front()[-1]
    assert best.spec.nw == 5 and best.spec.paper.directions == "ico5" and best.spec.paper.k == 0.02
    assert smallest.spec.nw == 4 and smallest.spec.paper.nq == 3 and smallest.spec.paper.directions == "ico1"
    assert len(of_the_paper().front()) > 3


def test_an_array_keeps_its_lattice() -> None:
    ball = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))
    stored = StoredScene(prepare(ball, EncodeSpec(nw=4, thickness_m=math.inf)).medium)
    search = PlanGrid((4, 5), (), (), ("octa1",), (0.05, 0.25), (4,))
    steps: list[tuple[int, int]] = []
    tried = plan(
        stored, Budget(bytes=1e9), EncodeSpec(device="tshirt-32x32"), search, lambda *step: steps.append(step)
    )
    assert len(tried.trials) == 2 and steps == [(1, 2), (2, 2)]
    assert tried.front()[-1].nmse < 0.01


def test_impossible_plans_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="no setting to try"):
        PlanGrid(nw=())
    with pytest.raises(InvalidArgument, match="nw"):
        plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), 1e9, SPEC, PlanGrid(nw=(2,)))
    invisible = EncodeSpec(mapping="1e-6", oversample=1, thickness_m=1e-6)
    with pytest.raises(InvalidArgument, match="without a force"):
        plan(AnalyticScene((Sphere((0.0, 0.0, 0.0), 1e-9),)), 1e9, invisible, PlanGrid(nw=(3,)))


def drifting(frames: int = 6) -> StoredScene:
    """A growing ball on the lattice of the device."""
    grid = prepare(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),)), EncodeSpec(nw=5)).medium.grid
    fields = [
        prepare(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02 + 0.002 * t),)), EncodeSpec(nw=5, mapping="crop"))
        .medium[0]
        .on_grid(grid)
        for t in range(frames)
    ]
    return StoredScene(HapticMedium.from_frames(fields, 25.0))


def test_a_moving_medium_has_a_rate_and_a_size_is_converted(tmp_path: Path) -> None:
    scene, search = drifting(), PlanGrid((4, 5), (0.1,), (0.1,), ())
    by_rate = plan(scene, 400_000.0, SPEC, search)
    assert by_rate.unit == "bit/s" and by_rate.choice.bits_per_s <= 400_000
    assert "bits_per_s" in by_rate.summary()["trials"][0] and by_rate.frames_tried == 6
    by_size = plan(scene, Budget(bytes=400_000 / 8 * 6 / 25), SPEC, search)
    assert by_size.budget == pytest.approx(400_000) and by_size.choice == by_rate.choice
    trial = by_rate.trials[-1]
    size = encode(scene, tmp_path / "s.touch", trial.spec).file_bytes
    assert trial.frames == 6 and trial.file_bytes == pytest.approx(size, rel=0.2)


def test_pairs_of_frames_across_the_medium_are_tried() -> None:
    field, search = drifting(1).stored[0], PlanGrid((5,), (0.4,), (), ())
    for count, expected in ((2, [0, 1]), (5, [0, 1, 2, 3]), (20, [3, 4, 9, 10, 15, 16])):
        computed: list[int] = []
        medium = HapticMedium(
            field.grid, 25.0, count, lambda i, computed=computed: computed.append(i) or field
        )  # type: ignore[misc]
        assert plan(StoredScene(medium), 1e9, SPEC, search).frames_tried == len(expected)
        assert sorted(set(computed)) == expected


def test_the_budget_of_a_static_medium_is_one_second_of_the_rate() -> None:
    scene, search = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),)), PlanGrid((4,), (0.4,), (), ())
    planned = plan(scene, 64_000.0, SPEC, search)
    assert (planned.budget, planned.unit) == (8000, "bytes") and planned.choice.file_bytes <= 8000
    assert not any("bits_per_s" in key for key in (*planned.summary(), *planned.summary()["trials"][0]))


def test_an_impossible_budget_is_refused_before_the_finest_lattice(monkeypatch: pytest.MonkeyPatch) -> None:
    import touchfield.tasks.plan  # noqa: F401

    module, tried = sys.modules["touchfield.tasks.plan"], []
    was = module.prepare
    monkeypatch.setattr(module, "prepare", lambda scene, spec: tried.append(spec.nw) or was(scene, spec))
    with pytest.raises(InvalidArgument, match=r"at least \d+ bit/s, the nearest \(--nw 4"):
        plan(drifting(), 100.0, SPEC, PlanGrid((4, 5), (0.1, 0.4), (0.1, 0.4), ("ico3",)))
    assert tried == [4]


def test_a_choice_beyond_the_mask_is_noted() -> None:
    def trial(size: int, nmse: float, fraction_within_bound: float) -> Trial:
        return Trial(SPEC, size, 1, nmse, 30.0, fraction_within_bound)

    rows = (trial(10, 0.5, 0.08), trial(40, 0.1, 0.99), trial(60, 0.05, 1.0))
    (note,) = Plan(rows, 0.1, 0.05, 20, "x", 1, "bytes").notes
    assert "only 8 % of the voxels" in note and note.endswith("keeps it, for 40 bytes")
    assert Plan(rows, 0.1, 0.05, 40, "x", 1, "bytes").notes == ()
    costs = [(999.0, "999 bit/s"), (1e3, "1 kbit/s"), (999e3, "999 kbit/s"), (1e6, "1 Mbit/s")]
    assert [(cost, amount(cost, "bit/s")) for cost, _ in costs] == costs
    (note,) = Plan(rows[:1], 0.1, 0.05, 20, "x", 1, "bytes").notes
    assert "no setting that was tried keeps it" in note


def test_settings_for_pins_are_planned_in_steps() -> None:
    search = PlanGrid((5, 6), (0.1, 0.2), (), ())
    tried = plan("sample:terrain", "1MB", EncodeSpec(device="graphiti"), search).trials
    assert [trial.spec.touch.k * 35 for trial in tried[:2]] == pytest.approx([0.5, 1.0])
    assert not any("--nw" in trial.options for trial in tried)

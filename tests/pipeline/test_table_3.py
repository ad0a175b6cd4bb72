"""Table 3: the arithmetic of its trends, and its settings on small sequences."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given, strategies as st
from reproduction import table_3
from reproduction.coding import CodedScene
from reproduction.scenes import DepthInput, user_inputs
from reproduction.table_3_printed import FRACTIONS, FRAME_COUNTS, PRINTED, impossibility
from reproduction.table_3_runs import MOVING, NOISE, STILL, SequenceRuns, Settings, run_sequence, steps
from reproduction.trends import TRENDS, Case, Point, bounds, trends

from experiment_makers import Plane
from touchfield.codec.paper.spec import PaperSpec
from touchfield.errors import InvalidArgument
from touchfield.pipeline import compare, encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.depth_scene import DepthScene

SMALL = Settings(nw=4, nq=4, fractions=(0.1, 0.25), frame_counts=(1, 2))


@pytest.fixture(scope="module")
def plane() -> SequenceRuns:
    """All settings on a plane with a little noise."""
    counted: list[int] = []
    found = run_sequence(DepthInput("plane", Plane(3, noise_per_m=1e-3)), SMALL, lambda: counted.append(1))
    assert len(counted) == steps(SMALL, has_poses=True), "the bar ends where it said it would"
    return found


# -- arithmetic --------------------------------------------------------------------------------------------


def _orderly() -> dict[Case, Point]:
    """Figures that follow every trend and respect every bound."""
    return {
        Case(m, k, high): Point(0.1 * (1 - 0.01 * m) * (1 - k) + 0.001 * high, -20 + 10 * k - 3 * high)
        for m in FRAME_COUNTS
        for k in FRACTIONS
        for high in (True, False)
    }


def test_figures_in_order_follow_every_trend() -> None:
    found = trends(_orderly())
    assert [trend.name for trend in found] == list(TRENDS)
    assert all(trend.holds and trend.verdict == "holds" for trend in found)
    assert [trend.compared for trend in found] == [12, 12, 12, 12, 9]
    assert all(bound.is_possible for bound in bounds(_orderly()))


@pytest.mark.parametrize(
    ("case", "point", "failing"),
    [
        (Case(1, 0.25, True), Point(0.2, -20.5), {"CR falls with k": 1}),
        (
            Case(5, 0.1, False),
            Point(0.5, -19.0),
            {"CR falls with m": 1, "multi-frame CR below single-frame": 1, "CR falls with k": 1},
        ),
        (
            Case(2, 0.1, True),
            Point(0.0892, -17.0),
            {"NMSE worsens with k": 1, "high directions better than low": 1},
        ),
    ],
)
def test_one_figure_out_of_order_is_found(case: Case, point: Point, failing: dict[str, int]) -> None:
    found = trends({**_orderly(), case: point})
    assert {t.name: len(t.failures) for t in found if not t.holds} == failing
    assert all(case in pair for t in found for pair in t.failures)


def test_equal_figures_follow_no_trend() -> None:
    flat = dict.fromkeys(_orderly(), Point(0.01, -20.0))
    assert all(len(trend.failures) == trend.compared for trend in trends(flat))


@given(st.floats(0.01, 100), st.sampled_from(sorted(PRINTED)))
def test_the_bound_is_a_ratio(factor: float, case: Case) -> None:
    scaled = {c: p._replace(cr=p.cr * factor) for c, p in PRINTED.items()}
    for scaled_bound, printed_bound in zip(bounds(scaled), bounds(PRINTED), strict=True):
        assert scaled_bound.is_possible == printed_bound.is_possible
        assert scaled_bound.least_cr == pytest.approx(printed_bound.least_cr * factor)
    if case.m > 1:  # a figure at its bound is possible
        at = {**PRINTED, case: Point(PRINTED[case._replace(m=1)].cr / case.m, 0.0)}
        assert {b.case for b in bounds(at) if b.is_possible} == {case}


def test_what_the_paper_prints() -> None:
    assert len(PRINTED) == 18
    assert all(trend.holds for trend in trends(PRINTED)), "its figures follow its words"
    assert not any(bound.is_possible for bound in bounds(PRINTED)), "yet none of the multi-frame rows can be"
    text = impossibility()
    assert "12 printed multi-frame figures 12 are below" in text
    assert (
        "| m = 2, k = 0.01, high | 0.00710 | 0.03345 | 4.7 | not possible |" in text
    )  # 0.0669 / 2, theory section 3
    assert "from 0.00540 (m = 2) to 0.00478 (m = 5)" in text


# -- runs --------------------------------------------------------------------------------------------------


def test_a_run_is_the_main_job(tmp_path: Path) -> None:
    sequence = Plane(2, noise_per_m=1e-3)
    coded = CodedScene(DepthScene(sequence), 4).coded(PaperSpec(k=0.2, nq=3), 2)
    spec = EncodeSpec(
        nw=4, coder="paper", paper=PaperSpec(k=0.2, nq=3), representation="voxel", mapping="fill"
    )
    encode(DepthScene(sequence), tmp_path / "a.touch", spec)
    job = compare(DepthScene(sequence), tmp_path / "a.touch").summary()
    assert coded.cr_full == pytest.approx(
        job["cr_full"], rel=0.02
    )  # the provenance states the requested frames
    assert coded.cr_literal == pytest.approx(job["cr_literal"])
    assert coded.nmse_db == pytest.approx(job["nmse_db"])
    assert coded.decibels["20 log L"] == pytest.approx(job["nmse_literal_db"])
    assert coded.decibels["20 log NMSE"] == pytest.approx(job["nmse_forensic_db"])
    assert coded.beyond_mask == job["mask_violation_share"]
    assert len(coded.kinds) == 2 and coded.kinds[0] == "I"
    assert coded.cr_literal == pytest.approx((coded.bits(0) + coded.bits(1)) / (2 * coded.voxel_count * 96))
    assert coded.bits_per_sent * coded.sent_per_voxel == pytest.approx(96 * coded.cr_literal)
    with pytest.raises(InvalidArgument, match="1 to 2"):
        CodedScene(DepthScene(sequence), 4).coded(PaperSpec(), 3)


def test_every_setting_is_present_and_none_is_impossible(plane: SequenceRuns) -> None:
    assert [runs.variant for runs in plane.variants] == ["wall, world", "wall, camera", "solid, camera"]
    for runs in plane.variants:
        for reading, coded in runs.coded.items():
            assert set(coded) == set(SMALL.cases)
            assert all(
                bound.is_possible for bound in bounds({c: Point(v.cr_literal, 0) for c, v in coded.items()})
            )
            assert all(v.cr_full > v.cr_literal for v in coded.values())
            # without repeated samples these quantisers are at their best in a single frame
            for case in (c for c in coded if c.m == 1):
                assert coded[case].nmse_db >= runs.floors_db[reading][case.is_high] - 3


def test_a_static_view_adds_no_bits_to_the_open_difference(plane: SequenceRuns) -> None:
    causes = {cause.circumstance: cause for cause in plane.causes}
    rest, noise = causes[STILL], causes[NOISE]
    for k in SMALL.fractions:
        assert rest.cost["literal"][k] == 0
        assert rest.cost["literal"][k] < noise.cost["literal"][k]
    # at 0.1 the error of the quantiser exceeds the mask, and is corrected in any case
    assert rest.resent[0.25] < noise.resent[0.25] < 1
    # in camera coordinates the plane moves to and fro; in the world it rests
    assert {name for name in causes if name.startswith(MOVING)} == {
        f"{MOVING}, {c} coordinates" for c in ("world", "camera")
    }


def test_without_poses_there_are_no_world_coordinates() -> None:
    counted: list[int] = []
    few = Settings(nw=3, nq=3, fractions=(0.25,), frame_counts=(1,))
    found = run_sequence(DepthInput("bare", Plane(1, has_poses=False)), few, lambda: counted.append(1))
    assert [runs.variant for runs in found.variants] == ["wall, camera", "solid, camera"]
    assert not found.causes, "one frame has no second"
    assert len(counted) == steps(few, has_poses=False)


def test_the_page_has_a_row_for_each_setting(plane: SequenceRuns) -> None:
    text = table_3._page((plane,), is_quick=True)
    rows = [line for line in text.splitlines() if line.startswith(("| 1 |", "| 2 |"))]
    assert len(rows) == 3 * len(SMALL.cases)
    assert all(len(row.replace("\\|", "").split("|")) == 14 for row in rows)
    assert "quick trial" in text and "/somewhere" not in text
    assert "0.02600" in rows[0], "the printed figure stands beside ours"
    reasons = text.split("### Why trends fail")[1].split("###")[0]
    all_trends = [
        t for runs in plane.variants for c in runs.coded.values() for t in trends(table_3.points_of(c))
    ]
    failing = sum(not t.holds for t in all_trends if t.name != "multi-frame CR below single-frame")
    assert reasons.count("| plane |") == failing, "each failing trend has its reason"


# -- real inputs -------------------------------------------------------------------------------------------


@pytest.mark.shared
@pytest.mark.parametrize("name", ["rgbd_tum_fr1_rpy", "rgbd_iclnuim_livingroom1"])
def test_real_sequences(shared_data: Path, name: str) -> None:
    (depth_input,) = user_inputs((shared_data / name,))
    assert depth_input.name == name
    assert [two.name for two in user_inputs((shared_data / name,) * 2)] == [name, f"{name} (2)"]
    few = Settings(nw=4, nq=6, fractions=(0.01, 0.25), frame_counts=(1, 2))
    found = run_sequence(depth_input, few, lambda: None)
    assert str(shared_data) not in table_3._page((found,), is_quick=True)
    for runs in found.variants:
        assert runs.support_share > 0.01
        for coded in runs.coded.values():
            verdicts = {t.name: t.holds for t in trends(table_3.points_of(coded))}
            assert verdicts["CR falls with k"], "a wider deadband sends less"
            assert all(b.is_possible for b in bounds(table_3.points_of(coded)))
    causes = {cause.circumstance: cause for cause in found.causes}
    camera = causes[f"{MOVING}, camera coordinates"]
    assert causes[STILL].resent[0.25] < causes[NOISE].resent[0.25] < camera.resent[0.25]

"""Optimisation of the coder's settings: the front, the choice by lambda, and targets."""

from __future__ import annotations

import math
from functools import cache

import pytest
from hypothesis import given
from hypothesis import strategies as st

from touchfield.errors import InvalidArgument
from touchfield.filters import rebuilt
from touchfield.job import EncodeSpec, Optimisation, SearchGrid, Trial, encode, open_stream, optimise, prepare
from touchfield.job.settings import DISTORTIONS
from touchfield.measure.fidelity import FidelityMeter
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.shapes import Sphere
from touchfield.sources.stored import StoredScene

SEARCH = SearchGrid(nw=(4, 5), k=(0.02, 0.25), nq=(3, 6), directions=("ico1", "ico5"))
SPEC = EncodeSpec(thickness_m=0.01, oversample=1)


def ball() -> AnalyticScene:
    return AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.04),))


@cache
def found() -> Optimisation:
    return optimise(ball(), SPEC, SEARCH)


def made_up(rows: list[tuple[int, float, float]]) -> Optimisation:
    return Optimisation(tuple(Trial(SPEC, size, 2, nmse, beyond) for size, nmse, beyond in rows), 0.1, 0.01)


trials = st.lists(st.tuples(st.integers(1, 50), st.integers(0, 9), st.integers(0, 9)), min_size=1, max_size=30).map(
    lambda rows: made_up([(size, nmse / 9, beyond / 9) for size, nmse, beyond in rows])
)


@given(trials, st.sampled_from(DISTORTIONS))
def test_a_front_is_a_front(tried: Optimisation, by: str) -> None:
    front = tried.front(by)
    for a, b in zip(front, front[1:], strict=False):
        assert a.file_bytes < b.file_bytes and a.distortion(by) > b.distortion(by)
    for trial in tried.trials:
        beaten_by = [
            f for f in front if f.file_bytes <= trial.file_bytes and f.distortion(by) <= trial.distortion(by)
        ]
        assert beaten_by
        better = [
            t
            for t in tried.trials
            if (t.file_bytes < trial.file_bytes and t.distortion(by) <= trial.distortion(by))
            or (t.file_bytes <= trial.file_bytes and t.distortion(by) < trial.distortion(by))
        ]
        assert not (trial in front and better)


@given(trials, st.sampled_from(DISTORTIONS), st.floats(0, 1e6), st.floats(0, 1e6))
def test_lambda_goes_from_the_smallest_file_to_the_best_field(
    tried: Optimisation, by: str, first: float, second: float
) -> None:
    low, high = (tried.at(m, by) for m in sorted((first, second)))
    assert low.file_bytes <= high.file_bytes and low.distortion(by) >= high.distortion(by)
    for multiplier in (first, second):
        chosen = tried.at(multiplier, by)
        cost = chosen.bits_per_frame + multiplier * chosen.distortion(by)
        assert cost == min(t.bits_per_frame + multiplier * t.distortion(by) for t in tried.trials)
    assert tried.at(0.0, by).file_bytes == min(t.file_bytes for t in tried.trials)
    assert tried.at(math.inf, by).distortion(by) == min(t.distortion(by) for t in tried.trials)
    assert tried.at(1e9, by) == tried.at(math.inf, by)


@given(trials, st.sampled_from(DISTORTIONS), st.integers(0, 60), st.floats(0, 1))
def test_targets_are_kept_or_the_nearest_is_named(
    tried: Optimisation, by: str, most_bytes: int, most_distortion: float
) -> None:
    small = [t for t in tried.trials if t.file_bytes <= most_bytes]
    if small:
        chosen = tried.within_bytes(most_bytes, by)
        assert chosen in small and chosen.distortion(by) == min(t.distortion(by) for t in small)
    else:
        nearest = min(t.file_bytes for t in tried.trials)
        with pytest.raises(InvalidArgument, match=f"at least {nearest}, the nearest"):
            tried.within_bytes(most_bytes, by)
    good = [t for t in tried.trials if t.distortion(by) <= most_distortion]
    if good:
        chosen = tried.within_distortion(most_distortion, by)
        assert chosen in good and chosen.file_bytes == min(t.file_bytes for t in good)
    else:
        nearest_d = min(t.distortion(by) for t in tried.trials)
        with pytest.raises(InvalidArgument, match=f"at least {nearest_d:.6g}, the nearest"):
            tried.within_distortion(most_distortion, by)


# -- real files -----------------------------------------------------------------------------------------------------


def test_every_setting_is_tried_in_order_and_told() -> None:
    told: list[tuple[int, int]] = []
    again = optimise(ball(), SPEC, SEARCH, lambda done, total: told.append((done, total)))
    assert again == found()  # the same bytes, the same figures
    assert told == [(n, 16) for n in range(1, 17)]
    asked = [(s["nw"], s["k"], s["nq"], s["directions"]) for s in found().summary()["trials"]]
    expected = [(w, k, q, d) for w in (4, 5) for k in (0.02, 0.25) for q in (3, 6) for d in ("ico1", "ico5")]
    assert asked == expected


def test_a_trial_is_what_encode_and_a_meter_make(tmp_path) -> None:  # type: ignore[no-untyped-def]
    reference = prepare(ball(), found().trials[-1].spec).medium[0]
    for trial in (found().trials[1], found().trials[-1]):
        assert trial.frames == 1
        made = encode(ball(), tmp_path / "one.touch", trial.spec)
        assert abs(made.file_bytes - trial.file_bytes) < 200  # but for what the provenance tells
        meter = FidelityMeter(SPEC.paper.k, found().f0_n)
        with open_stream(tmp_path / "one.touch") as opened:
            decoded = opened.medium[0]
        if trial.spec.nw == 4:
            decoded = rebuilt(decoded, reference.grid)
        meter.add(reference, decoded)
        assert meter.nmse_db is not None
        assert trial.nmse == pytest.approx(10 ** (meter.nmse_db / 10))
        assert trial.beyond_mask == meter.mask_violations / reference.support_count


def test_what_the_settings_do() -> None:
    by_setting = {(s["nw"], s["k"], s["nq"], s["directions"]): s for s in found().summary()["trials"]}
    for (nw, k, nq, directions), one in by_setting.items():
        if nw == 4:  # a coarse lattice is small and loses what lies between its samples
            fine = by_setting[5, k, nq, directions]
            assert one["file_bytes"] < fine["file_bytes"] and one["nmse"] > fine["nmse"]
        if directions == "ico1":
            assert one["nmse"] > by_setting[nw, k, nq, "ico5"]["nmse"]
    best, smallest = found().at(math.inf), found().at(0.0)
    assert best.spec.nw == 5 and best.spec.paper.directions == "ico5" and best.spec.paper.k == 0.02
    assert smallest.spec.nw == 4 and smallest.spec.paper.nq == 3 and smallest.spec.paper.directions == "ico1"
    assert len(found().front()) > 3


def test_an_array_keeps_its_lattice() -> None:
    search = SearchGrid(nw=(4, 5), k=(0.05, 0.25), nq=(4,), directions=("octa1",))
    stored = StoredScene(prepare(ball(), EncodeSpec(nw=4, thickness_m=math.inf)).medium)
    made = optimise(stored, EncodeSpec(device="tshirt-32x32"), search)
    assert len(made.trials) == 2
    assert made.at(math.inf).nmse < 0.01


def test_what_cannot_be_optimised() -> None:
    with pytest.raises(InvalidArgument, match="search grid"):
        SearchGrid(nw=())
    with pytest.raises(InvalidArgument, match="search grid"):
        SearchGrid(k=tuple(n / 10000 for n in range(1, 5000)))
    with pytest.raises(InvalidArgument, match="lambda"):
        found().at(-1.0)
    with pytest.raises(InvalidArgument, match="distortion"):
        found().front("psnr")
    with pytest.raises(InvalidArgument, match="nw"):
        optimise(ball(), SPEC, SearchGrid(nw=(2,)))
    far = EncodeSpec(mapping="1e-6", oversample=1, thickness_m=1e-6)
    with pytest.raises(InvalidArgument, match="without a force"):
        optimise(AnalyticScene((Sphere((0.0, 0.0, 0.0), 1e-9),)), far, SearchGrid(nw=(3,)))

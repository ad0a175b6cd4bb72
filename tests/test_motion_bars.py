"""Bars of `bench_motion`: a coding error counts against the threshold, or against a source that is felt."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.fixture
def motion(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Modules of bench/ import each other by name."""
    monkeypatch.setattr(sys, "path", [str(BENCH), *sys.path])
    return importlib.import_module("bench_motion")


def row(**margins_db: float) -> dict[str, Any]:
    return {"field": "terrain", "nw": 7, "speed_mm_s": 50.0, **margins_db}


def test_below_the_threshold_of_a_source_that_is_not_felt_the_error_keeps_a_distance(motion: Any) -> None:
    near, far = (row(margin_db=db, source_margin_db=0.5, decoded_margin_db=-9.0) for db in (5.9, 6.1))
    assert [motion.threshold_bar(each)["met"] for each in (near, far)] == [False, True]


def test_above_the_threshold_the_decoded_field_may_not_be_felt_more_than_its_source(motion: Any) -> None:
    alike, more = (row(margin_db=-7.0, source_margin_db=-10.0, decoded_margin_db=db) for db in (-11.5, -11.7))
    assert [motion.threshold_bar(each)["met"] for each in (alike, more)] == [True, False]
    less = row(margin_db=-7.0, source_margin_db=-10.0, decoded_margin_db=-3.0)
    assert motion.threshold_bar(less)["met"]  # `level_change_db` limits what is lost


def test_results_without_the_margin_of_the_decoded_field_are_open(motion: Any) -> None:
    assert motion.threshold_bar(row(margin_db=-7.0, source_margin_db=-10.0))["met"] is None


def test_levels_that_nobody_feels_do_not_count_as_changed(motion: Any) -> None:
    threshold_mn = motion.vibration_threshold().force_rms_mn()
    assert motion.level_change_db(0.1 * threshold_mn, 0.9 * threshold_mn) == 0.0
    assert motion.level_change_db(2.0 * threshold_mn, 4.0 * threshold_mn) == pytest.approx(6.02, abs=0.01)
    assert motion.level_change_db(np.zeros_like(threshold_mn), 2.0 * threshold_mn) > 100

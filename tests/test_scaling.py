"""Exponents of `bench_scaling`: what they are of known growths, and that the media grow as they say."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from typing import Any

import pytest

BENCH = Path(__file__).resolve().parents[1] / "bench"


@pytest.fixture
def scaling(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Modules of bench/ import each other by name."""
    monkeypatch.setattr(sys, "path", [str(BENCH), *sys.path])
    return importlib.import_module("bench_scaling")


def figures(scaling: Any, name: str, power: float, constant_s: float) -> Any:
    """The figures of a row whose time and memory grow with a power of the size, beside a constant time."""
    (row,) = (row for row in scaling.ROWS if row.name == name)
    sizes = row.sizes(4, 1.0)
    cases = [{"size": s, "cpu_s": constant_s + 1e-3 * s**power, "peak_mb": 10 * s**power} for s in sizes]
    return scaling.figures_of(row, cases)


@pytest.mark.parametrize(("power", "least"), [(1.0, 1.0), (1.5, 1.4), (2.0, 1.8)])
def test_a_constant_part_does_not_flatter_an_exponent(scaling: Any, power: float, least: float) -> None:
    """Exact for linear growth. A faster one shows a little less: the small size is subtracted, too."""
    alone, beside = (figures(scaling, "search, media", power, constant_s) for constant_s in (0.0, 1e6))
    assert beside["time_exponent"] == pytest.approx(alone["time_exponent"], abs=1e-2)
    assert least - 1e-9 <= alone["time_exponent"] <= power + 1e-9
    assert alone["memory_exponent"] == pytest.approx(power)
    assert len(alone["sizes"]) == 5


def test_the_surface_in_a_box_is_not_subtracted(scaling: Any) -> None:
    assert figures(scaling, "encode, box", 1.0, 100.0)["time_exponent"] < 1e-3
    assert figures(scaling, "encode, box", 1.0, 0.0)["time_exponent"] == pytest.approx(1.0)


def test_bars_follow_the_row_and_what_was_not_measured_is_open(scaling: Any) -> None:
    rows = {"encode, box": {"time_exponent": 0.2, "memory_exponent": 0.0}}
    verdicts = {bar["bar"]: (bar["limit"], bar["met"]) for bar in scaling.bars({"rows": rows})}
    assert verdicts["encode, box: exponent of time"] == (0.1, False)
    assert verdicts["encode, box: exponent of memory"] == (0.1, True)
    assert verdicts["play, surface: exponent of time"] == (0.1, None)
    assert verdicts["play, surface: exponent of memory"] == (1.1, None)


def test_a_box_grows_around_its_surface_and_a_surface_with_its_box(scaling: Any, tmp_path: Path) -> None:
    settings = importlib.import_module("scaling_media").SETTINGS
    sides = [settings["box"](size).workspace for size in (1, 16)]
    voxels = [x * y * z for x, y, z in sides]
    assert voxels[1] / voxels[0] == pytest.approx(16, rel=0.1)
    assert all(b > a for a, b in zip(*sides, strict=True))
    low_m, high_m = settings["surface"](1 / 64).scene().bounds_m()
    setting = settings["surface"](1 / 64)
    fits = setting.scale * (high_m - low_m) < 1e-3 * scaling.np.array(setting.workspace)
    assert fits.all()


def test_each_row_of_bodies_adds_the_same_shapes_and_as_many_neighbours(scaling: Any) -> None:
    media = importlib.import_module("scaling_media")

    def pairs_and_shapes(count: int) -> tuple[int, list[str]]:
        bodies = media.bodies_in_rows(count, 1).bodies()
        places_m = scaling.np.array([body.track.positions_m[0] for body in bodies])
        apart_m = abs(places_m[:, None] - places_m).max(axis=-1)
        is_near = (apart_m > 0) & (apart_m < 1.5 * media.PITCH_M)
        return int(is_near.sum()) // 2, [type(body.scene.shapes[0]).__name__ for body in bodies[-3:]]

    counts, shapes = zip(*(pairs_and_shapes(3 * rows) for rows in range(1, 7)), strict=True)
    assert set(scaling.np.diff(counts)) == {9}  # two beside, three behind, four across
    assert all(len(set(row)) == 3 and row == shapes[0] for row in shapes)
    (row,) = (row for row in scaling.ROWS if row.name == "objects, bodies")
    assert all(size % media.BODIES_PER_ROW == 0 for part in (0.5, 1.0) for size in row.sizes(4, part))

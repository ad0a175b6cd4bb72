"""Target sizes and target errors, on small scenes."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import compare, encode, rate_control
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.rate_control import MAX_ENCODES, RootSearch, Target, encode_to_target
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.stored import StoredScene

FAST = TouchSpec(effort="fast", segment_frames=2)
SPEC = EncodeSpec(nw=5, touch=FAST)
NMSE = replace(SPEC, touch=replace(FAST, mode="nmse"))


def rough(frames: int) -> StoredScene:
    """A rough wavy sheet that drifts, on a lattice of the device's size."""
    grid = Grid((32, 32, 32), (0.005, 0.00375, 0.0021875), (-0.08, -0.06, -0.035))
    x, y, z = np.meshgrid(*(np.arange(n) for n in grid.shape), indexing="ij")
    random = np.random.default_rng(7)
    grain = random.normal(0, 0.25, (*grid.shape, 3))
    fields = []
    for t in range(frames):
        depth = z - (14 + 4 * np.sin((x + 0.4 * t) / 5) * np.cos(y / 6))
        size = np.where((depth > 0) & (depth < 5), 0.5 * depth, 0)
        normal = np.stack([np.sin(x / 7), np.cos(y / 9), -np.ones_like(x)], axis=-1) + grain
        fields.append(ForceField.from_dense(grid, (size[..., None] * normal).astype(np.float32)))
    return StoredScene(HapticMedium.from_frames(fields, 25.0))


@pytest.mark.parametrize("frames", [2, 12])
def test_the_bound_is_relaxed_until_the_file_fits_and_is_reported(frames: int, tmp_path: Path) -> None:
    source, out = rough(frames), tmp_path / "s.touch"
    full_bytes = encode(source, tmp_path / "whole.touch", SPEC).file_bytes
    target = round(0.75 * full_bytes)
    done = encode_to_target(source, out, SPEC, Target(bytes=target))
    summary = done.summary()
    assert out.stat().st_size == summary["file_bytes"]
    assert 0.97 * target <= summary["file_bytes"] <= target
    assert summary["k"] > 0.1 == summary["asked_k"] and summary["f0_n"] == pytest.approx(0.5 * summary["k"])
    assert summary["encodes"] <= MAX_ENCODES and summary["target_bytes"] == target
    assert any(f"raised from 0.1 to {summary['k']:.4g}" in note for note in done.notes)
    with open_file(out) as opened:
        assert opened.reader.head.weber_fraction == summary["k"]
        assert opened.summary()["promise_kept"]
    assert compare(source, out).summary()["mask_violations"] == 0


def test_a_bound_that_fits_is_unchanged(tmp_path: Path) -> None:
    summary = encode_to_target(rough(2), tmp_path / "s.touch", SPEC, Target(bytes=10**6)).summary()
    assert summary["k"] == 0.1 and summary["encodes"] == 1


@pytest.mark.parametrize("frames", [2, 12])
def test_a_mean_error_is_reached(frames: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, out, calls = rough(frames), tmp_path / "s.touch", list[int]()
    was = rate_control.encode_prepared
    monkeypatch.setattr(rate_control, "encode_prepared", lambda *args: calls.append(1) or was(*args))
    summary = encode_to_target(source, out, NMSE, Target(nmse_db=-24.0)).summary()
    found = compare(source, out).summary()
    assert found["nmse_db"] == pytest.approx(-24.0, abs=0.13)
    assert summary["nmse_db"] == pytest.approx(found["nmse_db"], abs=1e-6)
    assert summary["mode"] == "nmse" and summary["encodes"] == len(calls) <= MAX_ENCODES


def test_the_best_fitting_result_is_used(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    steps = iter((0.5, *np.linspace(0.2, 0.1, 20)))  # only the first one fits
    monkeypatch.setattr(RootSearch, "next_x", lambda search: next(map(math.log, steps), None))
    spec = replace(NMSE, touch=replace(NMSE.touch, step_n=0.8))
    summary = encode_to_target(rough(2), tmp_path / "s.touch", spec, Target(bytes=6000)).summary()
    assert summary["step_n"] == 0.5 and summary["encodes"] == MAX_ENCODES
    assert summary["file_bytes"] == (tmp_path / "s.touch").stat().st_size < 6000


def test_bytes_are_reached_by_the_step(tmp_path: Path) -> None:
    out = tmp_path / "s.touch"
    for target in (4000, 9000):
        encode_to_target(rough(2), out, NMSE, Target(bytes=target))
        assert 0.97 * target <= out.stat().st_size <= target


@pytest.mark.parametrize(
    ("spec", "target", "word"),
    [
        (SPEC, Target(bytes=300), r"--target-bytes: found 300; expected \d+ bytes, the nearest.*k was 0.99"),
        (NMSE, Target(bytes=10**7), r"--target-bytes: found 1e\+07; expected \d+ bytes, the nearest"),
        (NMSE, Target(nmse_db=3.0), r"--target-nmse-db: found 3; expected -?[\d.]+ dB, the nearest"),
        (replace(SPEC, touch=TouchSpec(mode="lossless")), Target(bytes=5000), "lossless"),
        (EncodeSpec(coder="paper", paper=PaperSpec()), Target(bytes=5000), "coder paper"),
    ],
)
def test_an_unreachable_target_is_one_error(
    spec: EncodeSpec, target: Target, word: str, tmp_path: Path
) -> None:
    with pytest.raises(InvalidArgument, match=word):
        encode_to_target(rough(1), tmp_path / "s.touch", spec, target)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("size", "nmse_db"), [(None, None), (5000, -20.0), (0, None), (None, math.nan), (None, math.inf)]
)
def test_a_target_is_one_number(size: int | None, nmse_db: float | None) -> None:
    with pytest.raises(InvalidArgument, match="target"):
        Target(size, nmse_db)

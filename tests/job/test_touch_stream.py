"""Coder `touch` through the main job: what is asked, what the file tells, and the promise kept."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument
from touchfield.job import EncodeSpec, compare, encode, open_stream, prepare
from touchfield.medium import HapticMedium
from touchfield.sources.analytic_scene import AnalyticScene
from touchfield.sources.shapes import Sphere
from touchfield.sources.stored import StoredScene

FAST = TouchSpec(effort="fast", segment_frames=2)
SPEC = EncodeSpec(nw=4, touch=FAST)


def breathing(frames: int = 7) -> StoredScene:
    """A stored medium on the lattice of the device: a ball that grows."""
    grid = prepare(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),)), SPEC).medium.grid
    made = []
    for t in range(frames):
        scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02 + 0.002 * t),))
        made.append(prepare(scene, replace(SPEC, mapping="crop")).medium[0].on_grid(grid))
    return StoredScene(HapticMedium.from_frames(made, 25.0, "x right, y up, z towards the viewer"))


def test_threads_change_no_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: dict[str, list[int]] = {}
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        told: list[int] = []
        encode(breathing(), tmp_path / f"{threads}.touch", SPEC, lambda n, total, told=told: told.append(n))
        done[threads] = told
        with open_stream(tmp_path / f"{threads}.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == [2, 2, 2, 1]
    assert (tmp_path / "1.touch").read_bytes() == (tmp_path / "3.touch").read_bytes()
    for told in done.values():
        assert told == sorted(told) and told[-1] == 7


def test_the_file_tells_the_promise_it_keeps(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    made = encode(breathing(), stream, replace(SPEC, touch=replace(FAST, k=0.2, f0_n=0.02))).summary()
    assert (made["coder"], made["mode"], made["k"], made["f0_n"]) == ("touch", "mask", 0.2, 0.02)
    with open_stream(stream) as opened:
        told = opened.summary()
        assert opened.reader.head.weber_fraction == 0.2 and opened.reader.head.force_threshold_n == 0.02
        decoded = list(opened.medium)
    assert told["mode"] == "mask" and told["promise_kept"] is True
    assert (
        sum(told[f"bits_{kind}"] for kind in ("support", "amplitude", "direction", "side")) == 8 * told["file_bytes"]
    )
    assert sum(told["frame_kinds"].values()) == 7 and told["guesses"] == 0
    # what the file says of its worst voxel is what a receiver finds there
    frame, voxel = told["worst_frame"], tuple(told["worst_voxel"])
    original = breathing().medium[frame].to_dense()[voxel].astype(float)
    error = np.linalg.norm(decoded[frame].to_dense()[voxel] - original)
    ratio = error / max(0.02, 0.2 * np.linalg.norm(original))
    assert told["worst_mask_ratio"] == pytest.approx(ratio, abs=2e-5)
    compared = compare(breathing(), stream).summary()
    assert compared["mask_violations"] == 0
    assert compared["worst_mask_ratio"] == pytest.approx(ratio, abs=1e-6)


def test_no_floor_can_be_compared_too(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encode(breathing(2), stream, replace(SPEC, touch=replace(FAST, f0_n=0.0)))
    assert compare(breathing(2), stream).summary()["mask_violations"] == 0


def test_a_mean_error_promises_nothing(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    made = encode(breathing(2), stream, replace(SPEC, touch=replace(FAST, mode="nmse", step_n=0.3))).summary()
    assert made["step_n"] == 0.3
    with open_stream(stream) as opened:
        told = opened.summary()
    assert told["mode"] == "nmse" and told["promise_kept"] is None and told["worst_voxel"] is None


def test_what_is_quantised_already_is_kept_exactly(tmp_path: Path) -> None:
    first, second = tmp_path / "a.touch", tmp_path / "b.touch"
    encode(breathing(3), first, SPEC)
    encode(first, second, EncodeSpec(touch=TouchSpec(mode="lossless", segment_frames=3)))
    with open_stream(first) as a, open_stream(second) as b:
        assert list(a.medium) == list(b.medium)
        assert b.summary()["worst_mask_ratio"] == 0


def test_both_coders_read_the_same_road(tmp_path: Path) -> None:
    stream = tmp_path / "p.touch"
    encode(breathing(2), stream, EncodeSpec(nw=4, coder="paper", paper=PaperSpec(k=0.2)))
    with open_stream(stream) as opened:
        told = opened.summary()
    assert told["coder"] == "paper" and told["k"] == 0.2 and "promise_kept" not in told
    assert compare(breathing(2), stream).summary()["k"] == 0.2


def test_a_provenance_holds_what_is_asked_of_its_coder_alone() -> None:
    spec = EncodeSpec(coder="paper", paper=PaperSpec(nq=5))
    assert EncodeSpec.from_json(spec.to_json()) == spec
    assert "touch" not in json.loads(spec.to_json()) and "paper" not in json.loads(EncodeSpec().to_json())
    new = EncodeSpec(touch=TouchSpec(k=0.25, mode="mask-direction"))
    assert EncodeSpec.from_json(new.to_json()) == new
    assert new.asked() == {"k": 0.25, "mode": "mask-direction"}


def test_what_a_coder_does_not_take_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="nq 5 works with coder paper, not with touch"):
        EncodeSpec(paper=PaperSpec(nq=5))
    with pytest.raises(InvalidArgument, match="effort 'fast' works with coder touch, not with paper"):
        EncodeSpec(coder="paper", touch=TouchSpec(effort="fast"))
    with pytest.raises(InvalidArgument, match="coder"):
        EncodeSpec(coder="mp3")

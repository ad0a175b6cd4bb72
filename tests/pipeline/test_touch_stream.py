"""Coder `touch` through the pipeline: its options, the metadata of its files, and its error bound."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from live_makers import HEAD
from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchWriter
from touchfield.errors import InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium, Segments
from touchfield.pipeline import compare, encode, prepare
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.stored import StoredScene

FAST = TouchSpec(effort="fast", segment_frames=2)
SPEC = EncodeSpec(nw=4, touch=FAST)


def breathing(frames: int = 7) -> StoredScene:
    """A stored medium on the lattice of the device: a ball that grows."""
    grid = prepare(AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02),)), SPEC).medium.grid
    fields = []
    for t in range(frames):
        scene = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.02 + 0.002 * t),))
        fields.append(prepare(scene, replace(SPEC, mapping="crop")).medium[0].on_grid(grid))
    return StoredScene(HapticMedium.from_frames(fields, 25.0, "x right, y up, z towards the viewer"))


def test_the_summary_of_a_stream_states_head_and_segments(tmp_path: Path) -> None:
    """All values differ from the defaults; only the second segment has forces."""
    grid = Grid((16, 8, 24), (0.01, 0.02, 0.005), (0.1, -0.2, 0.3))
    spec = TouchSpec(effort="fast", k=0.2, f0_n=0.07, masking=0.03, masking_radius_m=0.006)
    encoder, path, notes = TouchEncoder(grid, spec), tmp_path / "own.touch", list[tuple[int, int]]()
    dense = np.random.default_rng(1).normal(0, 1, (16, 8, 24, 3)).astype(np.float32)
    frames = [ForceField.empty(grid), ForceField.from_dense(grid, dense)]
    head = replace(
        HEAD,
        grid_shape=grid.shape,
        spacing_m=grid.spacing_m,
        origin_m=grid.origin_m,
        frame_count=5,
        axes="x y z",
        device_name="mine",
        device_type=2,
        force_max_n=7.0,
        mapping_scale=0.5,
        mapping_offset_m=(1.0, 2.0, 3.0),
        weber_fraction=0.2,
        force_threshold_n=0.07,
        friction=0.3,
        damping_n_s_per_m=0.4,
        tags=("direct", "mine"),
        coder_parameters=encoder.parameters,
    )
    with TouchWriter(path) as writer:
        writer.write_head(head, {"reference": "my own"})
        writer.write_segment(0, 3, encoder.encode_segment(frames[:1] * 3).body)
        writer.write_segment(3, 2, encoder.encode_segment(frames[1:] * 2).body)
    with open_file(path) as opened:
        summary, medium, device = opened.summary(), opened.medium, opened.declared_device
        assert opened.masking == (0.03, 0.006) and medium.segments == Segments((0, 3), 0.2, 0.07)
        supported = opened.supported_voxels(lambda *at: notes.append(at))
        size = 8 * path.stat().st_size
        assert opened.bits_of_voxels(supported)["bits_per_decoded_voxel"] == size / supported
        assert opened.bits_of_voxels(0)["bits_per_decoded_voxel"] is None
        assert supported == sum(field.support_count for field in medium) == 2 * medium[4].support_count > 0
    assert notes == [(i + 1, 5) for i in range(5)]
    for key, value in {
        "frames": 5,
        "seconds": 0.1,
        "segments": 2,
        "grid_shape": [16, 8, 24],
        "axes": "x y z",
        "device": "mine",
        "device_type": 2,
        "force_max_n": 7.0,
        "mapping_scale": 0.5,
        "mapping_offset_m": [1.0, 2.0, 3.0],
        "k": 0.2,
        "f0_n": 0.07,
        "tags": ["direct", "mine"],
        "promise_against": "my own",
        "provenance": {"reference": "my own"},
        "cr_full": size / (5 * 3072 * 96),
        "guesses": 0,
    }.items():
        assert summary[key] == value, key
    assert summary["spacing_mm"] == pytest.approx([10, 20, 5]) and summary["worst_frame"] == 3
    assert summary["cr_literal"] == (summary["bits_amplitude"] + summary["bits_direction"]) / (5 * 3072 * 96)
    assert (
        sum(summary[f"bits_{kind}"] for kind in ("support", "amplitude", "direction", "models", "side"))
        == size
    )
    kinds, each = summary["frame_kinds"], summary["bits_per_frame_by_kind"]
    assert (
        sum(kinds.values()) == 5 and size - 8 * 600 < sum(kinds[kind] * each[kind] for kind in kinds) < size
    )
    assert (medium.rate_hz, medium.axes, medium.friction, medium.damping_n_s_per_m) == (
        50.0,
        "x y z",
        0.3,
        0.4,
    )
    assert medium.tags == ("direct", "mine") and medium.provenance == {"reference": "my own"}
    assert (device.name, device.type, device.lattice, device.force_max_n) == ("mine", 2, (16, 8, 24), 7.0)
    assert device.workspace_mm == pytest.approx((160, 160, 120))


def test_threads_change_no_byte(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    done: dict[str, list[int]] = {}
    for threads in ("1", "3"):
        monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
        progress: list[int] = []
        encode(
            breathing(),
            tmp_path / f"{threads}.touch",
            SPEC,
            lambda n, total, progress=progress: progress.append(n),
        )
        done[threads] = progress
        with open_file(tmp_path / f"{threads}.touch") as opened:
            assert [s.frame_count for s in opened.reader.segments] == [2, 2, 2, 1]
    assert (tmp_path / "1.touch").read_bytes() == (tmp_path / "3.touch").read_bytes()
    for progress in done.values():
        assert progress == sorted(progress) and progress[-1] == 7


def test_the_file_states_its_error_bound(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encoded = encode(breathing(), stream, replace(SPEC, touch=replace(FAST, k=0.2, f0_n=0.02))).summary()
    assert (encoded["coder"], encoded["mode"], encoded["k"], encoded["f0_n"]) == ("touch", "mask", 0.2, 0.02)
    with open_file(stream) as opened:
        summary = opened.summary()
        assert opened.reader.head.weber_fraction == 0.2 and opened.reader.head.force_threshold_n == 0.02
        decoded = list(opened.medium)
    assert summary["mode"] == "mask" and summary["promise_kept"] is True
    assert (
        sum(summary[f"bits_{kind}"] for kind in ("support", "amplitude", "direction", "side"))
        == 8 * summary["file_bytes"]
    )
    assert sum(summary["frame_kinds"].values()) == 7 and summary["guesses"] == 0
    # the error of the worst voxel in the file equals that at the receiver
    frame, voxel = summary["worst_frame"], tuple(summary["worst_voxel"])
    original = breathing().stored[frame].to_dense()[voxel].astype(float)
    error = np.linalg.norm(decoded[frame].to_dense()[voxel] - original)
    ratio = error / max(0.02, 0.2 * np.linalg.norm(original))
    assert summary["worst_mask_ratio"] == pytest.approx(ratio, abs=2e-5)
    compared = compare(breathing(), stream).summary()
    assert compared["mask_violations"] == 0
    assert compared["worst_mask_ratio"] == pytest.approx(ratio, abs=1e-6)


def test_a_stream_without_a_floor_can_be_compared(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encode(breathing(2), stream, replace(SPEC, touch=replace(FAST, f0_n=0.0)))
    assert compare(breathing(2), stream).summary()["mask_violations"] == 0


def test_a_mean_error_gives_no_bound(tmp_path: Path) -> None:
    stream = tmp_path / "s.touch"
    encoded = encode(
        breathing(2), stream, replace(SPEC, touch=replace(FAST, mode="nmse", step_n=0.3))
    ).summary()
    assert encoded["step_n"] == 0.3
    with open_file(stream) as opened:
        summary = opened.summary()
    assert summary["mode"] == "nmse" and summary["promise_kept"] is None and summary["worst_voxel"] is None


def test_a_quantised_field_is_preserved_exactly(tmp_path: Path) -> None:
    first, second = tmp_path / "a.touch", tmp_path / "b.touch"
    encode(breathing(3), first, SPEC)
    encode(first, second, EncodeSpec(touch=TouchSpec(mode="lossless", segment_frames=3)))
    with open_file(first) as a, open_file(second) as b:
        assert list(a.medium) == list(b.medium)
        assert b.summary()["worst_mask_ratio"] == 0


def test_both_coders_share_the_pipeline(tmp_path: Path) -> None:
    stream = tmp_path / "p.touch"
    encode(breathing(2), stream, EncodeSpec(nw=4, coder="paper", paper=PaperSpec(k=0.2)))
    with open_file(stream) as opened:
        summary = opened.summary()
    assert summary["coder"] == "paper" and summary["k"] == 0.2 and "promise_kept" not in summary
    assert compare(breathing(2), stream).summary()["k"] == 0.2


def test_a_provenance_has_the_options_of_its_coder_alone() -> None:
    spec = EncodeSpec(coder="paper", paper=PaperSpec(nq=5))
    assert EncodeSpec.from_json(spec.to_json()) == spec
    assert "touch" not in json.loads(spec.to_json()) and "paper" not in json.loads(EncodeSpec().to_json())
    new = EncodeSpec(touch=TouchSpec(k=0.25, mode="mask-direction"))
    assert EncodeSpec.from_json(new.to_json()) == new
    assert new.changed_options() == {"k": 0.25, "mode": "mask-direction"}


def test_options_of_another_coder_are_refused() -> None:
    with pytest.raises(InvalidArgument, match="nq 5 works with coder paper, not with touch"):
        EncodeSpec(paper=PaperSpec(nq=5))
    with pytest.raises(InvalidArgument, match="effort 'fast' works with coder touch, not with paper"):
        EncodeSpec(coder="paper", touch=TouchSpec(effort="fast"))
    with pytest.raises(InvalidArgument, match="coder"):
        EncodeSpec(coder="mp3")

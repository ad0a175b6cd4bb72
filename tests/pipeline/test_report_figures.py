"""Figures in the reports of encode, compare, filter and play, each against an independent computation.

The medium has a different size, spacing and origin on each axis, several segments, and a distinct last frame,
so that a figure of the wrong axis, segment or frames differs.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from touchfield.codec.paper.spec import PaperSpec
from touchfield.codec.touch.spec import TouchSpec
from touchfield.devices import device
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.pipeline import compare, encode, prepare
from touchfield.pipeline.comparison import filter_report
from touchfield.pipeline.decoding import open_file, write_field
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.block import COLUMNS as ROW, FLAGS
from touchfield.render.spec import RenderSpec
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.sources.tiny_scenes import tiny_scenes
from touchfield.tasks.play import Played, PlaySpec, play
from touchfield.tasks.play_log import COLUMNS

GRID = Grid((24, 16, 8), (0.002, 0.003, 0.004), (-0.01, -0.03, -0.005))
SPEC = EncodeSpec(touch=TouchSpec(effort="fast", segment_frames=3))
COUNT = 7


def medium(scale: float = 1.0) -> HapticMedium:
    """A wall that rises from frame to frame; in the last frame it repeats its height and pushes aside."""
    frames = np.zeros((COUNT, *GRID.shape, 3), np.float32)
    x, y = np.meshgrid(np.arange(24.0), np.arange(16.0), indexing="ij")
    for n in range(COUNT):
        wave = scale * (1.0 + 0.1 * n + 0.3 * np.sin(0.4 * x + 0.7 * y + n))
        frames[n, :, :, : 1 + n // 2] = (wave[..., None] * [0.1, 0.2, 1.0])[:, :, None]
    frames[-1, :, :, :7] = np.roll(frames[-1, :, :, :1], 1, axis=-1)
    frames[2:5, 3:20, 2:9, 6] = 0.003  # below F_0, and dropped by coder `touch`
    return HapticMedium.from_array(frames, GRID, 20.0, "x right, y up, z towards the viewer")


def dense(fields: HapticMedium) -> np.ndarray:
    return np.stack([field.to_dense() for field in fields]).astype(np.float64)


def decibels(factor: float, ratio: float) -> float:
    return float(factor * np.log10(ratio))


@pytest.mark.parametrize("by", ["this thread", "workers"])
def test_figures_of_an_encoding(tmp_path: Path, by: str) -> None:
    out, source = tmp_path / "out.touch", write_field(tmp_path / "field.npz", medium())
    profile = device("omega.3")
    spec = replace(SPEC, device="omega.3", nw=4, mapping="crop", touch=replace(SPEC.touch, k=0.2, f0_n=0.07))
    with ThreadPoolExecutor(2) as pool:
        done = encode(source, out, spec, executor=pool if by == "workers" else None)
    prepared, summary = done.prepared.medium, done.summary()
    supported = int((dense(prepared) != 0).any(-1).sum())
    box = np.stack(medium().grid.box_m)
    bits = 8 * out.stat().st_size
    assert supported > 0
    for key, value in {
        "frames": COUNT, "rate_hz": 20.0, "grid_shape": [16, 16, 16], "device": "omega.3",
        "force_max_n": profile.force_max_n, "mapping_scale": 1.0, "axes": prepared.axes,
        "representation": "voxel", "coder": "touch", "k": 0.2, "f0_n": 0.07, "file_bytes": bits // 8,
        "supported_voxels": supported, "bits_per_supported_voxel": bits / supported,
        "cr_full": bits / (COUNT * 16**3 * 96), "promise_kept": True,
    }.items():  # fmt: skip
        assert summary[key] == value, key
    assert summary["spacing_mm"] == pytest.approx([side / 16 for side in profile.workspace_mm])
    assert summary["mapping_offset_m"] == pytest.approx(box.mean(axis=0).tolist())
    with open_file(out) as stream:
        info, head = stream.summary(), stream.reader.head
        assert (head.weber_fraction, head.force_threshold_n) == (0.2, 0.07)
        assert head.force_max_n == profile.force_max_n
        assert [entry.frame_count for entry in stream.reader.segments] == [3, 3, 1]
    both = info.keys() & summary.keys()
    assert len(both) > 20 and {key: info[key] for key in both} == {key: summary[key] for key in both}
    assert done.notes == done.prepared.notes, "every frame has a force that is kept"


def test_an_encoding_without_a_force_has_no_bits_per_voxel(tmp_path: Path) -> None:
    done = encode(ForceField.empty(GRID), tmp_path / "out.touch", replace(SPEC, allow_empty=True))
    assert done.supported_voxels == 0 and done.summary()["bits_per_supported_voxel"] is None
    assert "The result is empty: no sample has a force." in done.notes[-1]


@pytest.mark.parametrize("has_law", [True, False])
def test_note_of_a_frame_below_the_threshold_suggests_a_remedy(tmp_path: Path, has_law: bool) -> None:
    """A stiffness is no remedy where the forces come from the source."""
    scene = tmp_path / "ball.toml"
    scene.write_text('[[shape]]\nkind = "sphere"\ncenter_m = [0.0, 0.0, 0.0]\nradius_m = 0.02\n')
    weak = replace(SPEC, nw=4, mapping="crop", allow_empty=True, touch=replace(SPEC.touch, f0_n=9.0))
    done = encode(scene if has_law else medium()[:2], tmp_path / "out.touch", weak)
    (note_text,) = [note for note in done.notes if "decoded without any force" in note]
    assert note_text.startswith(f"{1 if has_law else 2} of {1 if has_law else 2} frames")
    assert ("--stiffness-n-per-m" in note_text) == has_law and ": all forces are below --f0-n" in note_text


def expected_of(original: np.ndarray, decoded: np.ndarray, k: float, f0_n: float) -> dict[str, Any]:
    """The figures of a comparison that follow from the forces."""
    force, error = np.linalg.norm(original, axis=-1), np.linalg.norm(decoded - original, axis=-1)
    is_compared = (original != 0).any(-1) | (decoded != 0).any(-1)
    ratio = error / np.maximum(f0_n, k * force)
    beyond = int((ratio[is_compared] > 1 + 1e-6).sum())
    return {
        "nmse_db": decibels(10, (error**2).sum() / (force**2).sum()),
        "nmse_literal_db": decibels(20, error.sum() / force.sum()),
        "nmse_forensic_db": decibels(20, (error**2).sum() / (force**2).sum()),
        "mask_violations": beyond,
        "mask_violation_share": beyond / is_compared.sum(),
        "worst_mask_ratio": ratio.max(),
        "supported_voxels": int((force > 0).sum()),
        "decoded_supported_voxels": int((decoded != 0).any(-1).sum()),
    }


@pytest.mark.filterwarnings("ignore::touchfield.errors.UnboundedError")
@pytest.mark.parametrize("coder", ["touch", "paper"])
def test_figures_of_a_comparison(tmp_path: Path, coder: str) -> None:
    out = tmp_path / "out.touch"
    spec = SPEC if coder == "touch" else EncodeSpec(coder="paper", paper=PaperSpec(segment_frames=3, nq=3))
    encode(medium(), out, spec)
    original = dense(medium())
    with open_file(out) as stream:
        decoded, info = dense(stream.medium), stream.summary()
    size, voxels = 8 * out.stat().st_size, COUNT * 24 * 16 * 8
    for mask in ({}, {"k": 0.01, "f0_n": 0.002}):
        summary = compare(medium(), out, **mask).summary()  # type: ignore[arg-type]
        k, f0_n = (mask[name] if mask else info[name] for name in ("k", "f0_n"))
        for key, value in expected_of(original, decoded, k, f0_n).items():
            assert summary[key] == pytest.approx(value, rel=1e-5), key
        assert (summary["mask_violations"] > 0) == bool(mask or coder == "paper")
        assert coder == "paper" or summary["decoded_supported_voxels"] < summary["supported_voxels"]
        assert (summary["k"], summary["f0_n"], summary["frames"], summary["device"]) == (
            k,
            f0_n,
            COUNT,
            "phantom-omni",
        )
        assert (summary["grid_shape"], summary["file_bytes"]) == ([24, 16, 8], size // 8)
        assert summary["bits_per_supported_voxel"] == size / summary["supported_voxels"]
        assert summary["bits_per_decoded_voxel"] == size / summary["decoded_supported_voxels"]
        assert summary["cr_full"] == info["cr_full"] == size / (96 * voxels)
        literal = summary["bits_amplitude"] + summary["bits_direction"]
        assert summary["cr_literal"] == info["cr_literal"] == literal / (96 * voxels)
        assert [summary[f"bits_{name}"] for name in ("support", "amplitude", "direction")] == [
            info[f"bits_{name}"] for name in ("support", "amplitude", "direction")
        ]
        assert summary["bits_side"] == info["bits_side"] + info["bits_models"] and summary["bits_poses"] == 0
        assert summary["bits_side"] == size - literal - summary["bits_support"]


def test_bits_of_a_model_count_as_side_bits(tmp_path: Path) -> None:
    """For a ball, whose field has few parameters, and a body in motion, which has bits for its poses."""
    ball, out = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),)), tmp_path / "out.touch"
    encode(ball, out, replace(SPEC, nw=5))
    parts = ("support", "amplitude", "direction", "side")
    for source, has_models in ((ball, True), (tiny_scenes()[-1], False)):
        encode(source, out, replace(SPEC, nw=4 + has_models))
        with open_file(out) as stream:
            info = stream.summary()
        summary = compare(source, out).summary()
        if has_models:
            assert info["guesses"] == 1 and info["bits_guesses"] == info["bits_models"] > 0
            assert summary["bits_poses"] == 0
        else:
            assert info["representation"] == "object" and summary["bits_poses"] == info["bits_poses"] > 0
            assert info["bits_fields"] > 0
        assert summary["bits_side"] == info["bits_side"] + info["bits_models"]
        assert sum(summary[f"bits_{part}"] for part in (*parts, "poses")) == 8 * out.stat().st_size
        total_bits = sum(info[f"bits_{part}"] for part in (*parts, "models"))
        assert total_bits + info.get("bits_poses", 0) == 8 * out.stat().st_size


def test_the_drawn_frame_of_a_comparison(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the figures of the report, and in units of its mask."""
    drawn: list[tuple[Any, ...]] = []
    module = import_module("touchfield.pipeline.comparison")  # the function has the same name
    monkeypatch.setattr(module, "draw_comparison", lambda *args: drawn.append(args))
    out = tmp_path / "out.touch"
    encode(medium(), out, SPEC)
    with open_file(out) as stream:
        decoded = list(stream.medium)
    for frame in (None, 0, COUNT - 1):
        compared = compare(medium(), out, frame=frame, k=0.01, f0_n=0.002)
        compared.draw(tmp_path / "x.png")
        path, before, after, title, axes, mask = drawn.pop()
        expected_frame = COUNT // 2 if frame is None else frame
        assert (path, before, after) == (
            tmp_path / "x.png",
            medium()[expected_frame],
            decoded[expected_frame],
        )
        assert (axes, mask) == ("x right, y up, z towards the viewer", (0.01, 0.002))
        summary = compared.summary()
        for text in (
            f"frame {expected_frame + 1} of {COUNT} for phantom-omni", f"{out.stat().st_size:,} bytes",
            f"{summary['bits_per_supported_voxel']:.3g} bits per supported voxel",
            f"CR {summary['cr_full']:.3g}",
            f"NMSE {summary['nmse_db']:.1f} dB",
            f"{100 * summary['mask_violation_share']:.1f} % of voxels beyond the mask",
        ):  # fmt: skip
            assert text in title, text
        representation = repr(compared)
        for key in ("frames", "file_bytes", "bits_per_supported_voxel", "nmse_db", "mask_violation_share"):
            assert f"{key} {summary[key]:.6g}" in representation


def test_figures_of_the_stages_of_a_filter() -> None:
    """Each stage against the field before any filter, over all frames."""
    spec = replace(SPEC, filters=(("gaussian", "2mm"), ("texture", "salt-pepper:seed=2,rms=0.2")))
    report = filter_report(medium(), spec).summary()["stages"]
    fields = [list(medium())]
    for step in spec.chain:
        fields.append([step(field) for field in fields[-1]])
    force_max_n = prepare(medium(), SPEC).device.force_max_n
    before = None
    for row, name, stage in zip(report, ("device filter", "gaussian", "texture"), fields, strict=True):
        forces = np.stack([field.to_dense() for field in stage]).astype(np.float64)
        size = np.linalg.norm(forces, axis=-1)
        forces *= np.minimum(1, force_max_n / np.maximum(size, force_max_n))[..., None]
        size = np.linalg.norm(forces, axis=-1)
        before = forces if before is None else before
        assert row["stage"] == name
        assert row["supported_voxels"] == (size > 0).sum()
        assert row["greatest_n"] == pytest.approx(size.max(), rel=1e-6)
        assert row["rms_n"] == pytest.approx(np.sqrt((size[size > 0] ** 2).mean()), rel=1e-6)
        assert row["entropy_bits_per_frame"] == pytest.approx(row["entropy_voxel_bits"] * GRID.voxel_count)
        if name == "device filter":
            assert row["nmse_db"] is None and row["mask_violation_share"] == 0
            continue
        expected = expected_of(before, forces, PaperSpec().k, EncodeSpec(coder="paper").f0_n)
        assert row["nmse_db"] == pytest.approx(expected["nmse_db"], rel=1e-5)
        assert row["mask_violation_share"] == pytest.approx(expected["mask_violation_share"], rel=1e-5)
    assert report[1]["entropy_object_bits"] < report[2]["entropy_object_bits"]


# -- a play ------------------------------------------------------------------------------------------------


def test_every_column_of_a_log_has_the_value_of_its_name(tmp_path: Path) -> None:
    """More rows than are written at once, with distinct values."""
    count = (1 << 14) + 3
    rows = np.zeros(count, ROW)
    n = np.arange(count)
    columns: dict[str, np.ndarray] = {}

    def fill(field: str, *names: str) -> None:
        for column, name in enumerate(names):
            columns[name] = n / 1024 + 100 * len(columns)
            (rows[field] if len(names) == 1 else rows[field][:, column])[:] = columns[name]

    fill("time_s", "t_s")
    fill("position_m", "x_m", "y_m", "z_m")
    fill("velocity_m_s", "vx_m_s", "vy_m_s", "vz_m_s")
    fill("field_force_n", "field_x_n", "field_y_n", "field_z_n")
    fill("friction_n", "friction_x_n", "friction_y_n", "friction_z_n")
    fill("force_n", "force_x_n", "force_y_n", "force_z_n")
    fill("orientation", "qw", "qx", "qy", "qz")
    fill("field_torque_nm", "field_torque_x_nm", "field_torque_y_nm", "field_torque_z_nm")
    fill("torque_nm", "torque_x_nm", "torque_y_nm", "torque_z_nm")
    fill("gripper_m", "gripper_m")
    fill("media_s", "media_s")
    rows["buttons"] = n % 5
    rows["flags"] = n % 128
    Played({}, rows, None, ()).write_log(tmp_path / "log.csv")
    names, *lines = (tmp_path / "log.csv").read_text().splitlines()
    cells = [line.split(",") for line in lines]
    assert tuple(names.split(",")) == COLUMNS == (*columns, "buttons", "state") and len(cells) == count
    for column, name in enumerate(columns):
        found = [float(row[column]) for row in cells]
        np.testing.assert_allclose(found, columns[name], rtol=1e-8, err_msg=name)
    assert [int(row[-2]) for row in cells] == (n % 5).tolist()
    for row, flags in zip(cells, (n % 128).tolist(), strict=True):
        states = [name for name, bit in FLAGS.items() if flags & bit]
        assert row[-1] == ("+".join(states) or "idle")


def test_figures_of_a_play_are_those_of_its_log(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For any log, including one that ends with a force; a run without a clock omits its figures of time."""
    out, error = tmp_path / "out.touch", CorruptFile("half way")
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[..., 2] = 1.0
    encode(HapticMedium.from_array(forces, GRID), out, SPEC)
    log = np.zeros(8, ROW)
    log["force_n"][1:5] = [[0.3, 0.4, 0.0], [0.0, 0.0, 2.0], [-2.0, 3.0, 6.0], [0.0, 0.6, 0.8]]
    log["force_n"][7] = 2.0, 0.0, 1.5
    log["field_force_n"][:3] = [[0.0, 0.0, 0.1], [0.0, -0.1, 0.0], [0.1, -0.1, 0.0]]
    statistics = {"ticks": 8, "jitter_p50_us": 3.0, "lateness_p50_us": 4.0, "stalled_share": 0.25}
    module = import_module("touchfield.tasks.play")
    for log_of_run, fault in ((log, None), (log, error), (log[:0], None)):
        done = SimpleNamespace(log=log_of_run, notes=("a note",), statistics=statistics, error=fault)
        monkeypatch.setattr(module, "run_offline", lambda *_, done=done, **__: done)
        played = play(out, PlaySpec(offline=True, seconds=0.1, render=RenderSpec(friction=0.3)))
        is_empty = not len(log_of_run)
        assert played.statistics == {
            "device": "sim", "profile": "phantom-omni", "friction": 0.3, "ticks": 8, "stalled_share": 0.25,
            "contact_share": 0.0 if is_empty else 3 / 8, "greatest_force_n": 0.0 if is_empty else 7.0,
            "last_force_n": 0.0 if is_empty else 2.5,
        }  # fmt: skip
        assert (played.notes, played.error, played.is_starved) == (("a note",), fault, True)
        assert played.rows is log_of_run and (played.view is None) == (fault is not None)
        if fault is None:
            assert played.checked() is played
        else:
            with pytest.raises(CorruptFile, match="half way"):
                played.checked()
    at_most = Played({"stalled_share": 0.01}, None, None, ())
    assert not at_most.is_starved and not Played({}, None, None, ()).is_starved
    for part in (at_most.write_log, at_most.draw):
        with pytest.raises(InvalidArgument, match="works with a point device"):
            part(tmp_path / "x.csv")

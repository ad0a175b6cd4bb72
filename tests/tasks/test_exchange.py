"""Export of streams to other formats and import of effects, end to end."""

from __future__ import annotations

import json
import wave
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from effect_makers import (
    band,
    channel,
    document,
    effect,
    keyframe,
    read_force,
    read_tact,
    schema_errors,
    written,
)
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.vibration import MAX_RELATIVE_ERROR
from touchfield.compute.threads import silent
from touchfield.devices import device
from touchfield.errors import InvalidArgument, SourceError, TouchfieldError
from touchfield.exchange.ahap import read_ahap
from touchfield.exchange.hjif_import import read_hjif_array
from touchfield.exchange.symbolic import DEFAULT_CARRIER_HZ
from touchfield.filters.device_spec import device_grid
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.grid import Placement
from touchfield.medium.medium import VibrationFrame
from touchfield.pipeline import encode
from touchfield.pipeline.decoding import open_file
from touchfield.pipeline.encoding import encode_prepared
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.exchange import export, import_effect

K = 0.02
FINE = EncodeSpec(touch=TouchSpec(k=K, f0_n=0.0, effort="fast"))


def stream(path: Path, medium: HapticMedium, name: str) -> Path:
    encode_prepared(Prepared(medium, device(name), Placement(), FINE, ()), path, {"source": "made.npz"})
    return path


def vest_stream(path: Path, name: str = "tactsuit-x40") -> tuple[Path, np.ndarray]:
    """A stream for a vest, and its drives [frames, rows, columns]."""
    profile = device(name)
    columns, rows, _ = profile.lattice
    drives = np.random.default_rng(3).random((6, rows, columns)) * (np.arange(columns) != 1)
    forces = np.zeros((6, columns, rows, 1, 3), np.float32)
    forces[..., 0, 2] = profile.force_max_n * drives[:, ::-1].transpose(0, 2, 1)
    grid = device_grid(profile)
    return stream(
        path, HapticMedium.from_frames([ForceField.from_dense(grid, f) for f in forces], 20.0), name
    ), drives


def wall_stream(path: Path) -> Path:
    """A stream for a point device: the force along z grows with depth, over two frames."""
    grid = Grid((8, 8, 8), (0.01, 0.01, 0.01), (-0.035, -0.035, -0.035))
    forces = np.zeros((8, 8, 8, 3), np.float32)
    forces[..., 2] = np.linspace(0, 3.5, 8)
    frames = [ForceField.from_dense(grid, forces), ForceField.from_dense(grid, 0.5 * forces)]
    return stream(path, HapticMedium.from_frames(frames, 10.0), "phantom-omni")


def probe(path: Path, rows: list[tuple[float, ...]]) -> Path:
    path.write_text("t_s,x_m,y_m,z_m\n" + "\n".join(",".join(map(str, row)) for row in rows) + "\n")
    return path


def test_a_stream_for_a_vest_as_hjif_and_back(tmp_path: Path) -> None:
    path, drives = vest_stream(tmp_path / "a.touch")
    done = export(path, tmp_path / "a.hjif")
    assert done.figures["device"] == "tactsuit-x40" and done.figures["seconds"] == pytest.approx(0.3)
    assert (
        done.summary()["columns"] == 4
        and done.summary()["file_bytes"] == (tmp_path / "a.hjif").stat().st_size
    )
    read = read_hjif_array(tmp_path / "a.hjif", 20.0)
    assert read.effect.drives == pytest.approx(drives, rel=K, abs=2e-5)
    import_effect(tmp_path / "a.hjif", tmp_path / "b.touch", FINE, rate_hz=20.0)
    with open_file(tmp_path / "b.touch") as opened:
        summary = opened.summary()
        assert (summary["device"], summary["device_type"], summary["tags"]) == (
            "tactsuit-x40",
            2,
            ["symbolic"],
        )
        assert summary["force_max_n"] == device("tactsuit-x40").force_max_n and summary["rate_hz"] == 20
    export(tmp_path / "b.touch", tmp_path / "b.hjif")
    back = read_hjif_array(tmp_path / "b.hjif", 20.0).effect
    assert back.drives == pytest.approx(drives, rel=MAX_RELATIVE_ERROR + 2 * K, abs=1e-4)
    assert (back.drives >= drives * (1 - 3 * K) - 1e-4).all()
    assert back.frequencies_hz is not None and set(back.frequencies_hz[back.drives > 0]) == {
        DEFAULT_CARRIER_HZ
    }


def test_a_stream_for_a_vest_as_a_pattern(tmp_path: Path) -> None:
    path, drives = vest_stream(tmp_path / "a.touch")
    for profile in (None, "tactsuit-x40"):  # one panel as stated by the stream, and both of the vest
        done = export(path, tmp_path / "a.tact", profile, panel="back")
        spans = read_tact(tmp_path / "a.tact")
        assert (
            done.figures["panel"] == "back"
            and len(spans) == 6
            and {span.position for span in spans} == {"VestBack"}
        )
        for span, drive in zip(spans, drives):
            assert span.intensities == pytest.approx(drive, abs=K + 0.0051)


def test_voxel_fields_are_pooled_onto_the_array(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    done = export(path, tmp_path / "a.tact")
    assert (
        done.figures["device"] == "tactsuit-x40" and read_tact(tmp_path / "a.tact")[0].intensities.max() > 0.9
    )
    assert export(path, tmp_path / "a.hjif", "tshirt-32x32").figures["columns"] == 32
    assert json.loads((tmp_path / "a.hjif").read_text())["level"] == 2


def test_exporting_heights_of_pins_as_vibration_is_noted(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    assert not any("pins" in note for note in export(path, tmp_path / "a.hjif", "tshirt-32x32").notes)
    assert any("knows no pins" in note for note in export(path, tmp_path / "a.hjif", "graphiti").notes)
    pins, _ = vest_stream(tmp_path / "pins.touch", "graphiti")
    assert any("knows no pins" in note for note in export(pins, tmp_path / "a.hjif", "tshirt-32x32").notes)


def test_a_force_along_a_trajectory(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    rows = [(0.0, 0, 0, -0.035), (0.05, 0, 0, 0.005), (0.1, 0, 0, 0.005), (0.2, 0, 0, 0.02), (0.3, 9, 9, 9)]
    done = export(path, tmp_path / "f.hjif", trajectory=probe(tmp_path / "p.csv", rows))
    times, forces = read_force(tmp_path / "f.hjif")
    expected = np.array(
        [0, 2.0 * 0.75, 2.0 * 0.5, 2.75 * 0.5, 0]
    )  # frame 1 has half the force of frame 0, from 0.1 s on
    found = np.interp([0, 0.05, 0.1, 0.2, 0.3], times, forces[:, 2])
    assert found == pytest.approx(expected, rel=2 * K, abs=1e-4) and np.abs(forces[:, :2]).max() < 0.01
    assert done.figures["samples"] == 301 and done.figures["greatest_n"] == pytest.approx(1.5, rel=2 * K)


def test_a_coarsely_sampled_probe_is_interpolated(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    fast = probe(tmp_path / "p.csv", [(0.0, 0, 0, -0.2), (0.04, 0, 0, 0.2)])  # both ends are outside
    export(path, tmp_path / "f.hjif", trajectory=fast)
    _, forces = read_force(tmp_path / "f.hjif")
    assert not forces[0].any() and not forces[-1].any() and forces[:, 2].max() > 2.5
    for rows, ticks in (([0.0, 0.0001], 1000), ([0.0, 131.07], 500), ([0.0, 100.0], 655), ([5.0], 1000)):
        slow = probe(tmp_path / "p.csv", [(t, 0, 0, 0) for t in rows])
        assert export(path, tmp_path / "f.hjif", trajectory=slow).figures["ticks_per_second"] == ticks


def test_clipping_of_newtons_above_one_is_noted(tmp_path: Path) -> None:
    path, probe_path = wall_stream(tmp_path / "a.touch"), tmp_path / "p.csv"
    probe(probe_path, [(0.0, 0, 0, 0.005), (0.1, 0, 0, 0.005)])  # 2 N
    done = export(path, tmp_path / "f.hjif", trajectory=probe_path)
    assert any("clip above 1 N" in note for note in done.notes)
    scaled = export(path, tmp_path / "g.hjif", trajectory=probe_path, full_scale_n=2.2)
    perception = json.loads((tmp_path / "g.hjif").read_text())["perceptions"][0]
    assert not scaled.notes and max(channel["gain"] for channel in perception["channels"]) <= 1


def test_sounds_clips_and_patterns(tmp_path: Path) -> None:
    path, drives = vest_stream(tmp_path / "a.touch")
    assert export(path, tmp_path / "a.wav").figures["seconds"] == pytest.approx(0.3)
    with wave.open(str(tmp_path / "a.wav")) as sound:
        assert (sound.getnchannels(), sound.getframerate(), sound.getsampwidth()) == (drives[0].size, 8000, 2)
    for name in ("a.haptic", "a.ahap"):
        done = export(path, tmp_path / name)
        assert "20 actuators become one" in done.notes[0]
    read = read_ahap(tmp_path / "a.ahap", 20.0).effect
    assert read.drives[:6, 0, 0] == pytest.approx(drives.max(axis=(1, 2)), abs=2 * K)
    wall = wall_stream(tmp_path / "w.touch")
    rows = [(0.0, 0, 0, 0.005), (0.05, 0, 0, 0.005)]
    exported = export(wall, tmp_path / "f.wav", trajectory=probe(tmp_path / "p.csv", rows))
    assert "Full scale is 2" in exported.notes[0]
    with wave.open(str(tmp_path / "f.wav")) as sound:
        samples = np.frombuffer(sound.readframes(500), "<i2").reshape(-1, 3)
    assert samples[:, 2].max() == 32767 and np.abs(samples[:, :2]).max() < 500 and len(samples) == 401


@pytest.mark.shared
def test_a_real_sequence_is_valid_against_the_schemas(tmp_path: Path, shared_data: Path) -> None:
    source, folder = shared_data / "rgbd_tum_fr1_rpy", shared_data / "hjif_schemas"
    for name, trajectory in (("tactsuit-x40", None), ("phantom-omni", [(0.0, 0, 0, 0), (0.1, 0, 0, 0.02)])):
        spec = EncodeSpec(device=name, nw=5, frames=(0, 4), touch=FINE.touch)
        encode(source, tmp_path / "a.touch", spec)
        path = None if trajectory is None else probe(tmp_path / "p.csv", trajectory)
        export(tmp_path / "a.touch", tmp_path / "a.hjif", trajectory=path)
        assert schema_errors(json.loads((tmp_path / "a.hjif").read_text()), folder) == []


def test_forces_above_the_peak_are_clipped(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    deep = probe(tmp_path / "p.csv", [(0.0, 0, 0, 0.035), (0.01, 0, 0, 0.035), (0.02, 0, 0, 0.0)])
    done = export(path, tmp_path / "f.hjif", trajectory=deep)
    _, forces = read_force(tmp_path / "f.hjif")
    peak_n = device("phantom-omni").force_max_n
    clipped = np.mean(np.linalg.norm(forces, axis=1) > peak_n * (1 - 1e-6))
    assert np.abs(forces).max() == pytest.approx(peak_n) and 0.5 < clipped < 1
    assert done.notes[0] == f"{100 * clipped:.3g} % of the samples exceed {peak_n:g} N and are clipped to it."
    other = export(path, tmp_path / "g.hjif", "novint-falcon", deep)
    assert other.figures["force_max_n"] == device("novint-falcon").force_max_n


LIMIT, SCALE, CLIP = "exceed 3.3 N and are clipped to it", "Full scale is", "clip above"
NOTHING, PINS, FEWER = "The result is empty", "knows no pins", "20 actuators become one"


@pytest.mark.parametrize(
    ("depth_m", "name", "full_scale_n", "expected"),
    [
        (0.035, "f.wav", 1.0, (LIMIT, SCALE)), (0.035, "f.hjif", 1.0, (LIMIT, CLIP)),
        (0.035, "f.hjif", 5.0, (LIMIT,)),
        (0.005, "f.wav", 1.0, (SCALE,)), (0.005, "f.hjif", 1.0, (CLIP,)), (0.005, "f.hjif", 5.0, ()),
        (0.3, "f.wav", 1.0, (NOTHING,)), (0.3, "f.hjif", 1.0, (NOTHING,)),
    ],
)  # fmt: skip
def test_notes_on_forces_are_combined(
    depth_m: float, name: str, full_scale_n: float, expected: tuple[str, ...], tmp_path: Path
) -> None:
    path = probe(tmp_path / "p.csv", [(t, 0, 0, depth_m) for t in (0.0, 0.05)])
    done = export(
        wall_stream(tmp_path / "a.touch"), tmp_path / name, trajectory=path, full_scale_n=full_scale_n
    )
    assert [text in note for text, note in zip(expected, done.notes, strict=True)] == [True] * len(expected)


@pytest.mark.parametrize("drive", [0.0, 0.5])
@pytest.mark.parametrize(
    ("name", "array", "kind", "expected"),
    [
        ("tactsuit-x40", None, "ahap", (FEWER,)),
        ("tactsuit-x40", None, "haptic", (FEWER,)),
        ("tactsuit-x40", None, "tact", ()),
        ("tactsuit-x40", None, "wav", ()),
        ("tactsuit-x40", None, "hjif", ()),
        ("graphiti", "tactsuit-x40", "ahap", (FEWER, PINS)),
        ("graphiti", "tactsuit-x40", "haptic", (FEWER, PINS)),
        ("graphiti", "tactsuit-x40", "hjif", (PINS,)),
        ("graphiti", None, "tact", (PINS,)),
    ],
)
def test_notes_on_drives_are_combined(
    name: str, array: str | None, kind: str, expected: tuple[str, ...], drive: float, tmp_path: Path
) -> None:
    profile = device(name)
    forces = np.zeros((*profile.lattice, 3), np.float32)
    forces[..., 2] = profile.force_max_n * drive
    field = ForceField.from_dense(device_grid(profile), forces)
    path = stream(tmp_path / "a.touch", HapticMedium.from_frames([field] * 2, 20.0), name)
    done = export(path, tmp_path / f"a.{kind}", array)
    expected = (*expected, *(() if drive else (NOTHING,)))
    assert [text in note for text, note in zip(expected, done.notes, strict=True)] == [True] * len(expected)


def test_effects_are_imported_as_streams(tmp_path: Path) -> None:
    wave = band("VectorialWave", effect([keyframe(0, 0.5, 100), keyframe(100, 0.5, 200)]))
    written(tmp_path / "e.hjif", document(channel(wave), channel(wave)))
    done = import_effect(tmp_path / "e.hjif", tmp_path / "e.touch", FINE, force_max_n=2.0)
    assert done.prepared.device.name == "array-2x1" and done.prepared.medium.vibration is not None
    with open_file(tmp_path / "e.touch") as opened:
        assert opened.summary()["force_max_n"] == 2 and len(opened.medium) == 11
        assert opened.medium[5].vectors_n()[:, 2] == pytest.approx([1, 1], rel=K)
        vibration = opened.medium.vibration
        assert vibration is not None and vibration(5).frequencies_hz.tolist() == [150, 150]
        assert vibration(5).amplitudes_n == pytest.approx([1, 1], rel=MAX_RELATIVE_ERROR)
    export(tmp_path / "e.touch", tmp_path / "f.hjif")
    again = read_hjif_array(tmp_path / "f.hjif").effect.frequencies_hz
    assert again is not None and again[:, 0, 1] == pytest.approx(np.arange(100, 201, 10), abs=1.01)
    import_effect(tmp_path / "e.hjif", tmp_path / "v.touch", replace(FINE, vibration="gain=0.1,frequency=77"))
    with open_file(tmp_path / "v.touch") as opened:
        assert opened.medium.vibration is not None and set(opened.medium.vibration(0).frequencies_hz) == {77}
    tap: dict[str, Any] = {"Event": {"Time": 0.1, "EventType": "HapticTransient"}}
    written(tmp_path / "t.ahap", {"Pattern": [tap]})
    import_effect(tmp_path / "t.ahap", tmp_path / "t.touch", FINE, rate_hz=200.0)
    with open_file(tmp_path / "t.touch") as opened:
        assert (opened.summary()["grid_shape"], opened.summary()["rate_hz"]) == ([1, 1, 1], 200)
        assert [opened.medium[i].support_count for i in (19, 20)] == [0, 1]


@pytest.mark.parametrize(("suffix", "step"), [(".tact", 0.00501), (".haptic", 1.01e-4)])
def test_a_pattern_of_a_vendor_is_exported_and_imported(tmp_path: Path, suffix: str, step: float) -> None:
    path, drives = vest_stream(tmp_path / "a.touch")
    export(path, tmp_path / f"a{suffix}")
    done = import_effect(tmp_path / f"a{suffix}", tmp_path / "b.touch", FINE, rate_hz=20.0)
    is_vest = suffix == ".tact"
    assert done.prepared.device.name == ("tactsuit-x40" if is_vest else "array-1x1")
    expected = drives if is_vest else drives.max(axis=(1, 2))[:, None, None]
    with open_file(tmp_path / "b.touch") as opened:
        assert len(opened.medium) == len(drives)
        for field, drive in zip(opened.medium, expected, strict=True):
            found = field.to_dense()[:, ::-1, 0, 2].T / opened.summary()["force_max_n"]
            assert (np.abs(found - drive) <= step + 2.1 * K * drive + 1e-4).all()  # coded twice


def vibrating_stream(path: Path, share: float) -> Path:
    """A vest whose vibration, 90 to 170 Hz, is a fraction of its force."""
    vest = replace(device("tactsuit-x40"), panels=1)
    grid = device_grid(vest)
    forces = np.zeros((*vest.lattice, 3), np.float32)
    forces[..., 2] = np.linspace(0.3, 3.2, 20).reshape(4, 5, 1)
    field = ForceField.from_dense(grid, forces)
    positions = np.argwhere(forces[..., 2] > 0).astype(np.int32)
    amplitudes_n = forces[..., 2].reshape(-1) * np.float32(share)
    hertz = np.linspace(90, 170, 20).round().astype(np.float32)
    medium = HapticMedium.from_frames([field] * 2, 20.0)
    medium = replace(medium, vibration=lambda _: VibrationFrame(grid, positions, amplitudes_n, hertz))
    return stream(path, medium, "tactsuit-x40")


@pytest.mark.parametrize("share", [0.1, 1.0, 2.0])
def test_force_and_vibration_return_as_they_were(tmp_path: Path, share: float) -> None:
    path = vibrating_stream(tmp_path / "a.touch", share)
    done = export(path, tmp_path / "a.hjif")
    assert any("two perceptions" in note for note in done.notes) == (share != 1)
    import_effect(tmp_path / "a.hjif", tmp_path / "b.touch", FINE, rate_hz=20.0)
    with open_file(path) as before, open_file(tmp_path / "b.touch") as after:
        assert after.summary()["force_max_n"] == before.summary()["force_max_n"]
        forces_n, found_n = (opened.medium[0].to_dense()[..., 2] for opened in (before, after))
        assert found_n == pytest.approx(forces_n, rel=2 * K, abs=1e-3)
        bands = [opened.medium.vibration for opened in (before, after)]
        assert bands[0] is not None and bands[1] is not None
        vibration, found = bands[0](0), bands[1](0)
        assert found.positions.tolist() == vibration.positions.tolist()
        # two codings, half a step each where the force is the vibration; else the very same step
        tolerance = 2 * MAX_RELATIVE_ERROR if share == 1 else 1e-3
        limit_n = np.minimum(vibration.amplitudes_n, before.summary()["force_max_n"])
        assert found.amplitudes_n == pytest.approx(limit_n, rel=max(tolerance, 0.07 * (share > 1)))
        assert found.frequencies_hz.tolist() == vibration.frequencies_hz.tolist()
    for suffix in (".wav", ".haptic", ".ahap", ".tact"):  # which have one signal
        notes = export(path, tmp_path / f"a{suffix}").notes
        assert any("become one drive" in note for note in notes) == (share != 1)


def test_an_exported_force_is_imported_as_one_actuator(tmp_path: Path) -> None:
    path = wall_stream(tmp_path / "a.touch")
    rows = [(0.0, 0, 0, 0.005), (0.1, 0, 0, 0.005)]
    export(path, tmp_path / "f.hjif", trajectory=probe(tmp_path / "p.csv", rows))
    done = import_effect(tmp_path / "f.hjif", tmp_path / "b.touch", FINE)
    assert done.prepared.device.force_max_n == pytest.approx(2.0, rel=2 * K)
    with open_file(tmp_path / "b.touch") as opened:
        assert opened.medium[0].vectors_n()[0, 2] == pytest.approx(2.0, rel=3 * K)


def test_frames_of_an_effect(tmp_path: Path) -> None:
    wave = band("VectorialWave", effect([keyframe(0, 0.0), keyframe(100, 1.0)]))
    written(tmp_path / "e.hjif", document(channel(wave)))
    spec = EncodeSpec(frames=(5, 8), touch=FINE.touch)
    import_effect(tmp_path / "e.hjif", tmp_path / "e.touch", spec)
    with open_file(tmp_path / "e.touch") as opened:
        assert [f.vectors_n()[0, 2] for f in opened.medium] == pytest.approx([1.65, 1.98, 2.31], rel=K)


def test_invalid_exchanges_are_one_line_and_leave_no_file(tmp_path: Path) -> None:
    wall = wall_stream(tmp_path / "a.touch")
    vest, _ = vest_stream(tmp_path / "v.touch")
    good = probe(tmp_path / "p.csv", [(0.0, 0, 0, 0), (0.1, 0, 0, 0)])
    bad = probe(tmp_path / "bad.csv", [(0.0, 0, 0, 0), (-0.1, 0, 0, 0)])
    long = probe(tmp_path / "long.csv", [(0.0, 0, 0, 0), (2000.0, 0, 0, 0)])
    before = sorted(tmp_path.iterdir())
    hjif, tact = tmp_path / "a.hjif", tmp_path / "a.tact"
    calls: list[tuple[type[TouchfieldError], str, tuple[Any, ...]]] = [
        (InvalidArgument, "ending", (wall, tmp_path / "a.mp3")),
        (InvalidArgument, "full_scale_n", (vest, hjif, None, None, "front", silent, 2.0)),
        (InvalidArgument, "--source", (wall, hjif, None, None, "front", silent, 1.0, wall)),
        (InvalidArgument, "--device", (wall, hjif)),
        (InvalidArgument, "array of actuators", (wall, hjif, "omega.3")),
        (InvalidArgument, "tactsuit-x40", (vest, tact, "tshirt-32x32")),
        (InvalidArgument, "panel", (vest, hjif, None, None, "left")),
        (InvalidArgument, "trajectory", (vest, tact, None, good)),
        (InvalidArgument, "at most 1048.58 s", (wall, tmp_path / "a.wav", None, long)),
        (InvalidArgument, "a point", (wall, hjif, "dotpad", good)),
        (SourceError, "bad.csv", (wall, hjif, None, bad)),
        (TouchfieldError, "none.touch", (tmp_path / "none.touch", hjif)),
    ]
    for kind, message, call in calls:
        with pytest.raises(kind) as caught:
            export(*call)
        assert message in str(caught.value) and "\n" not in str(caught.value)
    with pytest.raises(InvalidArgument, match="ending"):
        import_effect(wall, tmp_path / "b.touch")
    with pytest.raises(SourceError, match=r"none\.hjif"):
        import_effect(tmp_path / "none.hjif", tmp_path / "b.touch")
    for force_max_n in (-1.0, 0.0, 2e6):
        with pytest.raises(InvalidArgument, match="force_max_n"):
            import_effect(tmp_path / "none.hjif", tmp_path / "b.touch", force_max_n=force_max_n)
    assert sorted(tmp_path.iterdir()) == before

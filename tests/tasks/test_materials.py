"""Materials: recordings, tables, and the texture under a sliding hand (section 6.4)."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.io import wavfile

import touchfield as tf
from signal_makers import RATE_HZ, Float64s, db, noise
from touchfield.cli.main import _exit_code
from touchfield.devices import device
from touchfield.devices.drivers.registry import point_device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.errors import CorruptFile, InvalidArgument, SourceError
from touchfield.medium.trace import Trace
from touchfield.perception.vibrotactile import (
    BANDS_HZ,
    band_rms,
)
from touchfield.render.block.layout import MATERIAL_CREST
from touchfield.render.material import (
    Material,
    materials_json,
    read_materials,
    stored_json,
    stored_materials,
    write_table,
)
from touchfield.render.offline import run_offline
from touchfield.render.spec import RenderSpec
from touchfield.sources.recordings.recording import Recording, read_recording
from touchfield.tasks.texture import merge_materials, store_materials, texture_of

GRID = tf.Grid((65, 33, 33), (0.005,) * 3, (-0.16, -0.08, -0.08))

STRONG = replace(device("phantom-omni"), force_max_n=40.0, force_continuous_n=None)


# -- recordings --------------------------------------------------------------------------------------------


def wav(path: Path, samples: NDArray[Any], rate_hz: int = 5000) -> Path:
    wavfile.write(path, rate_hz, samples)
    return path


def csv(path: Path, head: str, rows: Float64s) -> Path:
    path.write_text(head + "\n" + "\n".join(",".join(f"{v:.9g}" for v in row) for row in rows) + "\n")
    return path


def test_recordings_are_read_from_sound_and_from_text(tmp_path: Path) -> None:
    a = np.clip(0.2 * noise(4000, 3), -1, 1)
    recording = read_recording(wav(tmp_path / "a.wav", np.round(a * 32767).astype(np.int16)), 20.0)
    assert recording.rate_hz == 5000
    np.testing.assert_allclose(recording.acceleration_m_s2, 20 * a, atol=20 / 16000)
    floats = read_recording(wav(tmp_path / "b.wav", a[:, 0].astype(np.float32)))
    np.testing.assert_allclose(floats.acceleration_m_s2[:, 0], 9.80665 * a[:, 0], rtol=1e-6)
    assert not floats.acceleration_m_s2[:, 1:].any()
    bytes_ = read_recording(wav(tmp_path / "c.wav", np.round(128 + 127 * a[:, 0]).astype(np.uint8)), 1.0)
    np.testing.assert_array_equal(bytes_.acceleration_m_s2[:, 0], np.round(127 * a[:, 0]) / 128)
    long = read_recording(wav(tmp_path / "d.wav", np.array([1 << 30, -(1 << 31)], np.int32)), 1.0)
    np.testing.assert_array_equal(long.acceleration_m_s2[:, 0], [0.5, -1.0])
    times = np.arange(4000) / 3200
    times[1:] += 1e-5  # the first step is longer
    table = csv(tmp_path / "a.csv", "t_s,temperature,ax_m_s2,ay_m_s2,az_m_s2", np.c_[times, times, a])
    text = read_recording(table)
    assert text.rate_hz == pytest.approx(3999 / times[-1], rel=1e-9)
    np.testing.assert_allclose(text.acceleration_m_s2, a, rtol=1e-7)
    single_axis = read_recording(csv(tmp_path / "b.csv", "t_s,a_m_s2", np.c_[times, a[:, 0]]))
    assert single_axis.rate_hz == text.rate_hz
    np.testing.assert_array_equal(single_axis.acceleration_m_s2[:, 0], text.acceleration_m_s2[:, 0])


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.wav", b"RIFF nothing", "a.wav: found what is no sound"),
        ("a.wav", b"", "a.wav: found what is no sound"),
        ("a.csv", b"", "a.csv: found 0 lines"),
        ("a.csv", b"t_s,a_m_s2\n0,1\n", "a.csv: found 2 lines"),
        (
            "a.csv",
            b"t_s,a_m_s2,ax_m_s2,ay_m_s2,az_m_s2\n" + 3 * b"0,1,1,1,1\n",
            "a.csv line 1: found 't_s,a_m_s2,ax",
        ),
        ("a.csv", b"\xff\xfe\x00", "a.csv: found bytes that are no text"),
        ("a.csv", b"t_s,ax_g\n0,1\n1,2\n", "a.csv line 1: found 't_s,ax_g'"),
        ("a.csv", b"t_s,a_m_s2\n0,1\n1,nan\n2,1\n", "a.csv line 3: found '1,nan'; expected finite numbers"),
        (
            "a.csv",
            b"t_s,a_m_s2\n0,1\n1\n",
            "a.csv line 3: found '1'; expected finite numbers, one in each column",
        ),
        ("a.csv", b"t_s,a_m_s2\n0,1\n1,1\n2,1\n2.5,1\n3.5,1\n", "a.csv line 5: found a step of 0.5 s"),
        ("a.csv", b"t_s,a_m_s2\n1,1\n1,1\n1,1\n", "a.csv line 3: found a step of 0 s"),
        ("a.mp3", b"x", "a.mp3: found a name that ends in '.mp3'"),
    ],
)
def test_error_of_an_invalid_recording_states_file_and_line(
    tmp_path: Path, name: str, content: bytes, message: str
) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(SourceError, match=re.escape(message)) as caught:
        read_recording(tmp_path / name)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)


def test_sounds_of_too_many_channels_and_missing_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="4 channels"):
        read_recording(wav(tmp_path / "a.wav", np.zeros((100, 4), np.int16)))
    with pytest.raises(SourceError, match=r"none\.csv: found"):
        read_recording(tmp_path / "none.csv")
    wrong = wav(tmp_path / "b.wav", np.array([0, np.nan], np.float32))
    with pytest.raises(SourceError, match=r"b\.wav sample 1"):
        read_recording(wrong)


# -- materials ---------------------------------------------------------------------------------------------


def oak(scale: float = 1.0, **others: Any) -> Material:
    """Three speeds at two forces, with different spectra."""
    shape = scale * 0.004 * np.exp(0.5 * noise(3, 2, 16, seed=3)) * np.array([1, 2, 3])[:, None, None]
    table = tuple(tuple(tuple(map(float, row)) for row in rows) for rows in shape)
    return Material(
        "oak", **({"speeds_m_s": (0.03, 0.06, 0.12), "forces_n": (0.5, 2.0), "texture_rms_n": table} | others)
    )


def field(stiffness_n_per_m: float = 300.0) -> tf.HapticMedium:
    """The force points up below z = 0."""
    force = np.zeros((1, *GRID.shape, 3))
    z = GRID.origin_m[2] + GRID.spacing_m[2] * np.arange(GRID.shape[2])
    force[..., 2] = np.maximum(-stiffness_n_per_m * z, 0)
    return tf.HapticMedium.from_array(force, GRID, 30.0)


def slide(
    medium: Any,
    speed: float,
    spec: RenderSpec,
    depth_m: float = 0.0025,
    profile: Any = STRONG,
    length_m: float = 0.28,
) -> NDArray[Any]:
    """Rows of the log of a hand that slides along x in the steady state."""
    at = np.array([[-length_m / 2, 0, -depth_m], [-length_m / 2, 0, -depth_m], [length_m / 2, 0, -depth_m]])
    trace = Trace(np.array([0, 0.1, 0.1 + length_m / speed]), at)
    run = run_offline(
        medium, profile, point_device("sim", trace).opener, spec, seconds=0.1 + length_m / speed
    )
    return run.log[int(0.25 * spec.rate_hz) : int((0.09 + length_m / speed) * spec.rate_hz)]


def vibration(rows: NDArray[Any], axis: int = 2) -> Float64s:
    signal = rows["force_n"][:, axis].astype(np.float64)
    return signal - signal.mean()


@pytest.mark.parametrize("render", ["field", "proxy"])
@pytest.mark.parametrize("speed", [0.03, 0.06, 0.09, 0.12])
def test_a_sliding_hand_gets_the_spectrum_of_the_table_within_1_db(speed: float, render: str) -> None:
    material, spec = oak(), RenderSpec(render=render, rate_hz=RATE_HZ, materials=(oak(),), force_scale=1.0)
    rows = slide(field(), speed, spec)
    force = float(np.linalg.norm(rows["field_force_n"][len(rows) // 2]))
    assert 0.5 < force < 2.0
    by_speed = [np.interp(speed, material.speeds_m_s, material.levels_n[:, 0, b]) for b in range(16)]
    pressed = [np.interp(speed, material.speeds_m_s, material.levels_n[:, 1, b]) for b in range(16)]
    weight = (force - 0.5) / 1.5
    expected = (1 - weight) * np.array(by_speed) + weight * np.array(pressed)
    assert np.abs(db(band_rms(vibration(rows), RATE_HZ) / expected)).max() < 1.0
    bare = slide(field(), speed, replace(spec, materials=()))
    assert np.abs(vibration(bare)).max() < 1e-3


def test_a_hand_at_rest_or_off_the_surface_gets_no_texture() -> None:
    spec = RenderSpec(render="field", rate_hz=RATE_HZ, materials=(oak(scale=20.0),))
    assert np.abs(vibration(slide(field(), 1e-5, spec, length_m=1e-5))).max() < 0.01
    assert np.abs(slide(field(), 0.1, spec, depth_m=-0.02)["force_n"]).max() == 0


def test_bands_above_the_rate_of_the_loop_are_dropped_and_noted() -> None:
    spec = RenderSpec(render="field", rate_hz=1000.0, materials=(oak(),))
    trace = Trace(np.array([0.0, 1.0]), np.array([[0, 0, -0.002], [0.1, 0, -0.002]]))
    run = run_offline(field(), STRONG, point_device("sim", trace).opener, spec, seconds=1.0)
    assert any("398 Hz" in note for note in run.notes) and "materials: oak" in run.notes
    high = np.abs(np.fft.rfft(np.hanning(600) * run.log["force_n"][350:950, 2]))[
        np.fft.rfftfreq(600, 1e-3) > 460
    ]
    assert high.max() < 0.01
    slow = replace(spec, slew_n_per_s=2.0)  # for the rendered bands alone
    notes = run_offline(field(), STRONG, point_device("sim", trace).opener, slow, seconds=0.01).notes
    turns = 2 * np.pi * np.array(BANDS_HZ)[:12] * oak().levels_n[..., :12]
    weaker = 20 * np.log10(MATERIAL_CREST * np.sqrt((turns**2).sum(axis=-1)).max() / 2)
    assert any(f"up to {weaker:.1f} dB" in note for note in notes)


@pytest.mark.parametrize("scale", [3.0, 100.0])
def test_the_limits_of_the_device_hold_and_the_spectrum_keeps_its_shape(scale: float) -> None:
    spec = RenderSpec(render="field", rate_hz=RATE_HZ, materials=(oak(scale),), slew_n_per_s=300.0)
    trace = Trace(np.array([0.0, 1.0]), np.zeros((2, 3)))
    notes = run_offline(field(), STRONG, point_device("sim", trace).opener, spec, seconds=0.01).notes
    assert not any("ticks a second" in note for note in notes)
    steepest = (
        MATERIAL_CREST
        * np.sqrt(((2 * np.pi * np.array(BANDS_HZ) * oak(scale).levels_n) ** 2).sum(axis=-1)).max()
    )
    weaker = f"oak is weaker by up to {20 * np.log10(steepest / 300):.1f} dB"
    assert any(weaker in note and "300 N/s" in note for note in notes)
    twice = replace(spec, force_scale=2.0)  # the limit of the device allows half the newtons of the field
    assert any("150 N/s" in n for n in run_offline(field(), STRONG, SimHand, twice, seconds=0.0).notes)
    rows = slide(field(), 0.12, spec)
    change = np.linalg.norm(np.diff(rows["force_n"].astype(np.float64), axis=0), axis=1) * RATE_HZ
    assert change.max() <= 300.0 * (1 + 1e-6)
    assert np.linalg.norm(rows["force_n"], axis=1).max() <= STRONG.force_max_n
    ratio = band_rms(vibration(rows), RATE_HZ) / band_rms(
        vibration(slide(field(), 0.12, replace(spec, materials=(oak(),), slew_n_per_s=None))), RATE_HZ
    )
    assert np.ptp(db(ratio)) < 0.5


def test_the_first_material_at_a_position_applies_with_its_friction() -> None:
    left_half = oak(friction=0.5, box_m=((-1, -1, -1), (0, 1, 1)))
    right_half = Material("ice", friction=0.05)
    rows = slide(
        field(),
        0.1,
        RenderSpec(render="field", friction=None, rate_hz=RATE_HZ, materials=(left_half, right_half)),
    )
    x, drag = rows["position_m"][:, 0], np.linalg.norm(rows["friction_n"], axis=1)
    push = np.linalg.norm(rows["field_force_n"], axis=1)
    np.testing.assert_allclose(drag / push, np.where(x <= 0, 0.5, 0.05), atol=1e-4)
    z = rows["force_n"][:, 2].astype(np.float64)
    assert z[x < -0.001].std() > 0.005 and z[x > 0.01].std() < 1e-4
    overridden = slide(
        field(),
        0.1,
        RenderSpec(render="field", friction=0.2, rate_hz=RATE_HZ, materials=(left_half, right_half)),
    )
    np.testing.assert_allclose(np.linalg.norm(overridden["friction_n"], axis=1), 0.2 * push, rtol=1e-4)


def test_stick_slip_is_a_dissipative_sawtooth_over_the_path() -> None:
    slips = Material("rubber", friction=0.4, static_friction=0.8, slip_length_m=0.002)
    rows = slide(field(), 0.05, RenderSpec(render="field", rate_hz=RATE_HZ, materials=(slips,)))
    mu = np.linalg.norm(rows["friction_n"], axis=1) / np.linalg.norm(rows["field_force_n"], axis=1)
    assert 0.4 <= mu.min() < 0.41 and 0.79 < mu.max() <= 0.8
    tones = np.abs(np.fft.rfft((mu - mu.mean()) * np.hanning(len(mu))))
    assert np.fft.rfftfreq(len(mu), 1 / RATE_HZ)[tones.argmax()] == pytest.approx(0.05 / 0.002, rel=0.02)
    assert ((rows["friction_n"] * rows["velocity_m_s"]).sum(axis=1) <= 1e-12).all()
    fast = slide(field(), 1.4, RenderSpec(render="field", rate_hz=1000.0, materials=(slips,)))
    quick = (
        np.linalg.norm(fast["friction_n"], axis=1)[-20:] / np.linalg.norm(fast["field_force_n"], axis=1)[-20:]
    )
    np.testing.assert_allclose(quick, 0.6, atol=1e-3)  # 700 slips a second at 1000 ticks: the mean force


def test_a_material_may_be_that_of_an_object() -> None:
    medium = field()
    count = 120
    bodies = [
        tf.medium.PoseTrack(np.tile([1.0, 0, 0, 0], (count, 1)), np.tile(at, (count, 1)))
        for at in ([0, 0, 0], [0, 0, -9])
    ]
    objects = [tf.medium.HapticObject(name, medium, track) for name, track in zip(("table", "floor"), bodies)]
    scene = tf.medium.HapticScene(GRID, 30.0, tuple(objects), 40.0)
    spec = RenderSpec(render="field", rate_hz=RATE_HZ, materials=(oak(object="table", friction=0.3),))
    rows = slide(scene, 0.1, spec)
    assert vibration(rows).std() > 0.005
    other = tf.medium.HapticScene(GRID, 30.0, tuple(objects[::-1]), 40.0)
    assert (
        vibration(slide(other, 0.1, replace(spec, materials=(oak(friction=0.3),)))).std() > 0.005
    )  # of any object
    below = slide(scene, 0.1, replace(spec, materials=(oak(object="floor"),)))
    assert vibration(below).std() < 1e-3
    with pytest.raises(InvalidArgument, match=r"'chair'; expected one of table, floor"):
        slide(scene, 0.1, replace(spec, materials=(oak(object="chair"),)))
    with pytest.raises(InvalidArgument, match="this medium is a field"):
        slide(medium, 0.1, spec)


def test_a_table_round_trips_through_a_file_and_a_stream(tmp_path: Path) -> None:
    both = (oak(friction=0.3, box_m=((-1.0, -1.0, -1.0), (0.0, 1.0, 1.0))), Material("ice", 0.05, 0.1, 0.002))
    write_table(tmp_path / "t.json", both)
    again = read_materials(tmp_path / "t.json")
    assert materials_json(again) == materials_json(both) and again[1] == both[1]
    np.testing.assert_allclose(again[0].levels_n, both[0].levels_n, rtol=1e-3)
    levels = tuple(0.1 * (n + 1) for n in range(32))  # as many levels and materials as allowed
    materials = (
        Material("slate", speeds_m_s=levels, forces_n=(1.0,), texture_rms_n=((((0.001,) * 16),),) * 32),
    ) * 64
    write_table(tmp_path / "most.json", materials)
    assert len(read_materials(tmp_path / "most.json")) == 64
    write_table(tmp_path / "more.json", (*materials, Material("one more")))
    with pytest.raises(SourceError, match="a list of at most 64"):
        read_materials(tmp_path / "more.json")
    tf.encode(field(), tmp_path / "a.touch")
    before = (tmp_path / "a.touch").read_bytes()
    store_materials(tmp_path / "a.touch", again, tmp_path / "b.touch")
    assert (tmp_path / "a.touch").read_bytes() == before
    plain, stored = tf.decode(tmp_path / "a.touch"), tf.decode(tmp_path / "b.touch")
    assert stored_materials(stored.provenance) == again and stored_materials(plain.provenance) == ()
    np.testing.assert_array_equal(plain[0].to_dense(), stored[0].to_dense())
    spec = RenderSpec(render="field", rate_hz=RATE_HZ)
    textured, smooth = slide(stored, 0.1, spec), slide(plain, 0.1, spec)
    x = textured["position_m"][:, 0]
    assert vibration(textured)[x < -0.01].std() > 10 * max(vibration(smooth)[x < -0.01].std(), 1e-6)
    with pytest.raises(InvalidArgument, match=r"characters; expected at most 4096\. Give it separately"):
        store_materials(
            tmp_path / "a.touch", [replace(oak(), name=str(n)) for n in range(9)], tmp_path / "c.touch"
        )
    capacity = 4097 - len(materials_json([Material("a")]))
    assert len(stored_json([Material("a" * capacity)])) == 4096
    with pytest.raises(InvalidArgument, match="a table of 4097 characters"):
        stored_json([Material("a" * (capacity + 1))])
    with pytest.raises(InvalidArgument, match=r"'\.json'; expected OUT\.touch"):
        store_materials(tmp_path / "a.touch", again, tmp_path / "c.json")
    with pytest.raises(InvalidArgument, match=r"'\.touch'; expected TABLE\.json"):
        write_table(tmp_path / "c.touch", again)
    assert not list(tmp_path.glob("c.*"))


BAD_TABLES = [
    ("nothing", "found text that is no table of materials"),
    ("[1]", "found text that is no table of materials"),
    ({"bands_hz": [1], "materials": []}, r"bands_hz: found \[1\]; expected thirds of an octave"),
    ({"materials": {}}, r"materials: found \{\}"),
    ({"materials": [{"friction": 1}]}, r"materials\[0\]: found"),
    ({"materials": [{"name": "a", "mu": 1}]}, r"materials\[0\]: found 'mu'"),
    ({"materials": [{"name": "a", "friction": -1}]}, r"materials\[0\] material 'a' friction: found -1"),
    ({"materials": [{"name": "a", "friction": "x"}]}, r"materials\[0\]: found a value of the wrong type"),
    ({"materials": [{"name": "a", "static_friction": 1}]}, "static_friction: found a value without friction"),
    (
        {"materials": [{"name": "a", "friction": 0.5, "static_friction": 0.4}]},
        "0.4; expected a finite number, 0.5",
    ),
    ({"materials": [{"name": "a", "speeds_m_s": list(range(1, 34))}]}, r"speeds_m_s: found .*at most 32"),
    ({"materials": [{"name": "a", "box_m": [[1, 1, 1], [0, 0, 0]]}]}, r"box_m: found"),
    ({"materials": [{"name": "a", "speeds_m_s": [2, 1]}]}, r"speeds_m_s: found \(2, 1\)"),
    (
        {"materials": [{"name": "a", "speeds_m_s": [1], "forces_n": [1]}]},
        r"texture_rms_n: found shape \(0,\)",
    ),
    (
        {
            "materials": [
                {"name": "a", "speeds_m_s": [1], "forces_n": [1], "texture_rms_n": [[[float("nan")] * 16]]}
            ]
        },
        "texture_rms_n: found a number below 0 or not finite",
    ),
    (
        {"materials": [{"name": "a", "speeds_m_s": [1], "forces_n": [1], "texture_rms_n": [[[1], [1, 2]]]}]},
        "texture_rms_n: found what is no array of numbers",
    ),
]


@pytest.mark.parametrize(("table", "message"), BAD_TABLES)
def test_error_of_an_invalid_table_states_file_and_field(tmp_path: Path, table: Any, message: str) -> None:
    path = tmp_path / "t.json"
    path.write_text(table if isinstance(table, str) else json.dumps({"bands_hz": list(BANDS_HZ)} | table))
    with pytest.raises(SourceError, match=message) as caught:
        read_materials(path)
    assert str(caught.value).startswith(str(path)) and "\n" not in str(caught.value)
    assert "expected" in str(caught.value)
    with pytest.raises(CorruptFile, match=r"PROV materials\.json"):
        stored_materials({"materials.json": path.read_text()})


def test_recordings_become_a_table(tmp_path: Path) -> None:
    t = np.arange(10_000) / 5000
    tones = [np.outer(size * np.sin(2 * np.pi * BANDS_HZ[8] * t), [0.6, 0.0, 0.8]) for size in (1, 2, 3, 4)]
    speeds, forces = [0.1, 0.05, 0.1, 0.05], [1.0, 1.0, 2.0, 2.0]
    material = texture_of([Recording(5000.0, tone) for tone in tones], speeds, forces, "rib", 0.2)
    assert (material.speeds_m_s, material.forces_n, material.friction) == ((0.05, 0.1), (1.0, 2.0), 0.2)
    ratio = material.levels_n[:, :, 8] / material.levels_n[1, 0, 8]
    np.testing.assert_allclose(ratio, [[2, 4], [1, 3]], rtol=1e-6)
    assert material.levels_n[:, :, 8].min() > 100 * np.delete(material.levels_n, 8, axis=2).max() / 4
    with pytest.raises(InvalidArgument, match="each speed at each force, once"):
        texture_of([Recording(5000.0, tone) for tone in tones[:3]], speeds[:3], forces[:3])
    with pytest.raises(InvalidArgument, match=r"0\.2 s; expected 0\.5 s or more"):
        texture_of([Recording(5000.0, tones[0][:1000])], [0.1], [1.0])
    assert merge_materials((oak(),), (material, replace(oak(), friction=1.0)))[0].friction == 1.0


# -- the command -------------------------------------------------------------------------------------------


def test_the_command_creates_stores_and_plays_a_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    for name, size in (("slow", 0.1), ("fast", 0.2)):
        wav(Path(f"{name}.wav"), np.round(32767 * np.clip(size * noise(10_000, 3), -1, 1)).astype(np.int16))
    command = (
        "texture slow.wav fast.wav -o oak.json --speed-m-s 0.05,0.1 --force-n 1 --name oak --friction 0.4 "
        "--json"
    )
    pytest.importorskip("matplotlib")
    assert _exit_code([*command.split(), "--plot", "oak.png"]) == 0
    assert json.loads(capsys.readouterr().out)["materials"] == ["oak"]
    assert Path("oak.png").stat().st_size > 10_000
    (material,) = read_materials("oak.json")
    assert material.friction == 0.4 and material.speeds_m_s == (0.05, 0.1)
    np.testing.assert_allclose(material.levels_n[1] / material.levels_n[0], 2, rtol=0.2)
    tf.encode(field(), "a.touch")
    assert _exit_code(["texture", "oak.json", "--into", "a.touch", "-o", "b.touch"]) == 0
    capsys.readouterr()
    for command in ("play b.touch --offline --json", "play a.touch --offline --materials oak.json --json"):
        assert _exit_code(command.split()) == 0
        assert "materials: oak" in json.loads(capsys.readouterr().out)["notes"]
    for code, command, message in (
        (2, "texture slow.wav -o x.json --force-n 1", "--speed-m-s: found nothing"),
        (2, "texture slow.wav -o x.json --speed-m-s a --force-n 1", "--speed-m-s: found 'a'"),
        (2, "texture oak.json -o x.json --name elm", "those of recordings"),
        (2, "texture oak.json -o oak.json", "the file that is read"),
        (1, "texture none.wav -o x.json --speed-m-s 1 --force-n 1", "none.wav: found"),
        (1, "play a.touch --offline --materials slow.wav", "slow.wav: found a file that is not text"),
    ):
        assert _exit_code(command.split()) == code, command
        stderr = capsys.readouterr().err
        assert message in stderr and stderr.count("\n") == 1
    assert not Path("x.json").exists()


def test_the_help_shows_an_example(capsys: pytest.CaptureFixture[str]) -> None:
    assert _exit_code(["texture", "--help"]) == 0
    assert "touchfield texture drag-50.wav" in capsys.readouterr().out

"""Public sets of textures and contacts are read in their own layouts (`touchfield data show NAME`)."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from scipy.signal import lfilter

from texture_makers import AR, GAIN, MA, variance, write_mat, write_models, write_slide, write_table
from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument, SourceError
from touchfield.perception.vibrotactile import BANDS_HZ, band_rms, dft321, handle_force_n
from touchfield.sources.recordings import matlab_contacts
from touchfield.sources.recordings.cluster_textures import KIND, read_slides
from touchfield.sources.recordings.contact_trace import ContactScene
from touchfield.sources.recordings.matlab_contacts import read_matlab_contacts
from touchfield.sources.recordings.penn_hatt import read_texture_models
from touchfield.sources.recordings.recording import STANDARD_GRAVITY_M_S2
from touchfield.sources.recordings.texture_sets import read_texture_recording
from touchfield.sources.registry import open_source
from touchfield.tasks.texture import texture_of_files, texture_of_models

# -- Penn Haptic Texture Toolkit ---------------------------------------------------------------------------


@pytest.mark.parametrize("has_ma", [True, False])
def test_levels_of_a_model_are_those_of_its_filtered_noise(tmp_path: Path, has_ma: bool) -> None:
    models = read_texture_models(write_models(tmp_path / "Models_Made Oak.xml", has_ma=has_ma))
    assert (models.name, models.friction, models.rate_hz) == ("Made Oak", 0.25, 1000.0)
    material = texture_of_models(models)
    assert material.speeds_m_s[-1] == pytest.approx(0.2) and material.forces_n[-1] == pytest.approx(4.0)
    noise = np.sqrt(variance(200, 4)) * np.random.default_rng(1).normal(size=200_000)
    numerator = np.array(MA) * GAIN if has_ma else np.ones(1)
    expected = band_rms(handle_force_n(lfilter(numerator, AR, noise), 1000.0), 1000.0)
    in_range = np.array(BANDS_HZ) * 10**0.05 <= 500
    off_db = 20 * np.log10(material.levels_n[-1, -1][in_range] / expected[in_range])
    assert np.abs(off_db).max() < 0.7 and not material.levels_n[..., ~in_range].any()
    # the model in the middle has a quarter of the variance
    assert (material.speeds_m_s[2], material.forces_n[1]) == pytest.approx((0.1, 2.0))
    np.testing.assert_allclose(material.levels_n[2, 1], material.levels_n[-1, -1] / 2, rtol=1e-9)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"SpeedUnits": "m/s"}, "SpeedUnits: found 'm/s'; expected mm/s"),
        ({"SampleRate": "fast"}, "SampleRate: found 'fast'; expected a number"),
        ({"numMod": "9"}, "found 5 elements model where numMod is 9"),
        ({"mu": "-1"}, "mu: found '-1'; expected a number, 0 or more"),
        ({"material": ""}, "material: found nothing"),
    ],
)
def test_errors_of_models_name_the_element(tmp_path: Path, changed: dict[str, str], message: str) -> None:
    path = write_models(tmp_path / "Models_A.xml", **changed)
    with pytest.raises(SourceError, match=re.escape(message)):
        read_texture_models(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<value>0.72</value>", "<value>1.72</value>", "model 1: ARcoeff: found an unstable filter"),
        ("<value>-1.2</value>", "<value>nan</value>", "model 1: ARcoeff: found a number that is not finite"),
        ("<value>1.0</value>", "<value>2.0</value>", "model 1: ARcoeff: found 2 as the first value"),
        ("<speedMod>0.0", "<speedMod>x", "model 1: speedMod: found 'x'"),
        ("</modelSet>", "", "found no XML"),
        (
            "<modelSet texture",
            "<!DOCTYPE a [<!ENTITY b 'c'>]><modelSet texture",
            "a document type declaration",
        ),
        ("modelSet", "models", "found the element 'models'"),
    ],
)
def test_damaged_models_are_refused(tmp_path: Path, old: str, new: str, message: str) -> None:
    path = write_models(tmp_path / "Models_A.xml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new))
    with pytest.raises(SourceError, match=re.escape(message)):
        read_texture_models(path)


def test_models_at_one_speed_make_no_table(tmp_path: Path) -> None:
    path = write_models(tmp_path / "Models_A.xml")
    path.write_text(re.sub(r"<speedMod>[\d.]*", "<speedMod>50", path.read_text()))
    with pytest.raises(InvalidArgument, match="at least four, of several speeds and forces"):
        texture_of_models(read_texture_models(path))


# -- accelerations -----------------------------------------------------------------------------------------


def test_accelerations_of_the_cluster_dataset_state_speed_and_force(tmp_path: Path) -> None:
    names = [write_slide(tmp_path, direction=d, speed=s) for d in (0, 90) for s in (20, 60)]
    files = [tmp_path / "accel" / name for name in names]
    read = read_texture_recording(files[0])
    assert (read.speed_m_s, read.force_n) == (0.02, 1.0)
    assert read.recording.rate_hz == pytest.approx(6000, rel=1e-3)
    assert abs(read.recording.acceleration_m_s2.mean(axis=0)).max() < 1e-9  # without gravity
    material, notes = texture_of_files(files, None, None, "three")
    assert material.speeds_m_s == (0.02, 0.06) and material.forces_n == (1.0,)
    # white noise, three times as strong at three times the speed
    ratio = material.levels_n[1, 0] / material.levels_n[0, 0]
    assert np.median(ratio) == pytest.approx(3, rel=0.1)
    a = read.recording
    alone = band_rms(handle_force_n(dft321(a.acceleration_m_s2), a.rate_hz), a.rate_hz)
    np.testing.assert_allclose(material.levels_n[0, 0], alone, rtol=0.5)
    assert any("they are averaged" in note for note in notes)
    assert any("resampled to" in note for note in notes)
    with pytest.raises(InvalidArgument, match="each speed at each force, once"):
        texture_of_files(files, (0.02, 0.06, 0.02, 0.06), (1.0,) * 4)


def test_a_recording_is_known_by_its_folder_although_the_path_has_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = Path(write_slide(tmp_path, speed=60))
    monkeypatch.chdir(tmp_path / "accel")
    assert read_texture_recording(name).speed_m_s == 0.06
    monkeypatch.chdir(tmp_path / "force")
    assert KIND.recognise(name)


def test_accelerations_of_the_lmt_database_take_a_scale(tmp_path: Path) -> None:
    path = tmp_path / "Training" / "Accel" / "G1Made_query0.txt"
    path.parent.mkdir(parents=True)
    values = 0.1 * np.random.default_rng(0).normal(size=8000)
    path.write_text("\n".join(f"{value:.6f}" for value in values))
    read = read_texture_recording(path, 2.0)
    assert read.recording.rate_hz == 10_000 and read.speed_m_s is None
    np.testing.assert_allclose(read.recording.acceleration_m_s2[:, 0], 2 * values, atol=2e-6)
    assert "states no unit" in read.notes[0] and STANDARD_GRAVITY_M_S2 > 9
    with pytest.raises(InvalidArgument, match="speed_m_s: found nothing, and none in the name G1M"):
        texture_of_files([path], None, (1.0,))
    assert _exit_code(["texture", str(path), "-o", str(tmp_path / "a.json"), "--force-n", "1"]) == 2
    assert not (tmp_path / "a.json").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time,X,Y\n0,1,2\n1,2,3\n", "line 1: found 'time,X,Y'; expected time,X,Y,Z"),
        ("time,X,Y,Z\n0,1,2,3\n", "found 1 rows of 4; expected 4 numbers on each line, 2 rows or more"),
        ("time,X,Y,Z\n0,1,2,x\n1,1,1,1\n", "found no table"),
        ("time,X,Y,Z\n0,1,2,3\n1,1,1\n", "found no table"),
        ("time,X,Y,Z\n0,1,2,nan\n1,1,1,1\n", "row 1: found a number that is not finite"),
        ("time,X,Y,Z\n1,1,2,3\n0,1,1,1\n", "row 2: found 0 s after 1 s; expected times that never fall"),
        ("time,X,Y,Z\n1,1,2,3\n1,1,1,1\n", "found times that are all equal"),
        ("time,X,Y,Z\n", "found 0 rows"),
    ],
)
def test_errors_of_a_table_name_the_row(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "accel" / "1_0_20_500_0.csv"
    path.parent.mkdir()
    path.write_text(text)
    with pytest.raises(SourceError, match=re.escape(message)):
        read_texture_recording(path)


# -- slides as contacts ------------------------------------------------------------------------------------


def test_slides_of_one_texture_and_force_are_contacts_on_a_plane(tmp_path: Path) -> None:
    folder = tmp_path / "texture_dataset" / "sensor_data"
    for direction in (0, 45, 90, 135):
        write_slide(folder, texture=3, direction=direction)
    write_slide(folder, texture=3, force=500)
    write_slide(folder, texture=10, force=1000)
    trace, notes = read_slides(tmp_path)
    assert np.ptp(trace.positions_m, axis=0) == pytest.approx([0.036, 0.036, 0], abs=2e-3)
    np.testing.assert_allclose(trace.forces_n, np.tile([0, 0, 1.0], (len(trace.forces_n), 1)), rtol=1e-9)
    assert notes[0].startswith("4 recordings of texture 3 at 1 N: heights were not recorded")
    assert "2 other combinations of texture and force are not read" in notes[1]
    light, _ = read_slides(folder / "force" / "3_0_40_500_0.csv")
    np.testing.assert_allclose(light.forces_n[:, 2], 0.5)
    assert np.ptp(light.positions_m[:, 0]) < 1e-9  # one direction only
    assert all(KIND.recognise(path) for path in (tmp_path, folder.parent, folder))
    assert not KIND.recognise(folder / "force")
    scene = open_source(folder / "position" / "10_0_40_1000_0.csv")
    assert isinstance(scene, ContactScene) and scene.notes[0].startswith("1 recording of texture 10")


def test_slides_are_encoded_from_their_folder(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_slide(tmp_path / "set" / "sensor_data", speed=60)
    arguments = ["encode", str(tmp_path / "set"), str(tmp_path / "a.touch"), "--nw", "4", "--json"]
    assert _exit_code(arguments) == 0
    notes = json.loads(capsys.readouterr().out)["notes"]
    assert any("1 recording of texture 3 at 1 N" in note for note in notes)


def test_a_slide_without_its_positions_is_refused(tmp_path: Path) -> None:
    name = write_slide(tmp_path)
    (tmp_path / "position" / name).unlink()
    with pytest.raises(SourceError, match=r"position.3_0_40_1000_0\.csv: found nothing; expected the pos"):
        open_source(tmp_path)
    write_table(tmp_path / "position" / name, "time,X,Y", np.array([[9.0, 1, 1], [9.1, 2, 2]]))
    with pytest.raises(SourceError, match="found no time of force/3_0_40_1000_0"):
        open_source(tmp_path)


# -- MATLAB ------------------------------------------------------------------------------------------------


def spiral(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    angle = np.linspace(0, 6 * np.pi, count)
    points = 0.02 * np.stack([np.cos(angle), np.sin(angle), angle / 20])
    return points, -50 * points


def test_contacts_of_a_matlab_file_are_those_of_its_first_recording(tmp_path: Path) -> None:
    points, forces = spiral()
    first = {"pos": points, "vel": 0 * points, "F": forces}
    path = write_mat(tmp_path / "symbol_data.mat", [first, {**first, "F": -forces}])
    trace, notes = read_matlab_contacts(path)
    np.testing.assert_array_equal(trace.positions_m, points.T)
    np.testing.assert_array_equal(trace.forces_n, forces.T)
    assert "Recording 1 of 2 is read" in notes[1]
    assert "symbol_data.vel" in notes[2] and "remark" in notes[2]
    scene = open_source(path)
    assert isinstance(scene, ContactScene) and scene.notes[:3] == notes


def test_matlab_files_of_other_contents_are_refused(tmp_path: Path) -> None:
    points, forces = spiral()
    path = tmp_path / "a.mat"
    for recording, message in (
        ({"pos": points.T, "F": forces}, r"symbol_data\(1\)\.pos: found float64 of shape \(60, 3\)"),
        ({"pos": points, "F": forces[:, 1:]}, r"symbol_data\(1\): found 60 positions and 59 forces"),
        ({"pos": points, "F": forces * np.nan}, r"symbol_data\(1\)\.F: found a number that is not finite"),
        ({"x": points}, r"a\.mat: found symbol_data, remark; expected a MATLAB 5 file"),
        ({"pos": "left", "F": forces}, r"symbol_data\(1\)\.pos: found str"),
    ):
        write_mat(path, [recording])
        with pytest.raises(SourceError, match=message):
            open_source(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(512))
    with pytest.raises(SourceError, match=r"found no MATLAB 5 file.*save\(FILE, '-v7'\)"):
        open_source(path)
    whole = write_mat(path, [{"pos": points, "F": forces}]).read_bytes()
    for end in range(128, len(whole), len(whole) // 23):
        path.write_bytes(whole[:end])
        with pytest.raises(SourceError, match=r"a\.mat"):
            open_source(path)


def test_a_matlab_file_that_unpacks_to_too_much_is_refused_before(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    points, forces = spiral(2000)
    path = write_mat(tmp_path / "a.mat", [{"pos": points, "F": 0 * forces}])
    unpacked = 2 * points.nbytes
    assert path.stat().st_size < unpacked
    monkeypatch.setattr(matlab_contacts, "_MAX_UNPACKED", unpacked)  # the heads of the arrays are on top
    monkeypatch.setattr(matlab_contacts, "_CHUNK", 1 << 10)
    with pytest.raises(SourceError, match=f"found more than {unpacked} bytes, unpacked"):
        read_matlab_contacts(path)
    monkeypatch.setattr(matlab_contacts, "_MAX_UNPACKED", unpacked + 4096)
    assert len(read_matlab_contacts(path)[0].positions_m) == 2000


@pytest.mark.shared
def test_the_real_recordings_are_read(shared_data: Path) -> None:
    trace, notes = read_matlab_contacts(shared_data / "force_panda_comanipulation" / "symbol_data.mat")
    assert trace.positions_m.shape == (5520, 3) and "Recording 1 of 6 is read" in notes[1]
    assert 3 < np.linalg.norm(trace.forces_n, axis=1).max() < 9


# -- sets of which no field can be made --------------------------------------------------------------------


def test_encode_names_the_command_for_textures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    models = write_models(tmp_path / "XML" / "Models_Made Oak.xml")
    lmt = tmp_path / "Training" / "Accel" / "G1Made_query0.txt"
    lmt.parent.mkdir(parents=True)
    lmt.write_text("0.1\n0.2\n")
    name = write_slide(tmp_path / "slides")
    accel = tmp_path / "slides" / "accel"
    for path, what in (
        (models, "'Models_Made Oak.xml'"),
        (models.parent, "Models_MATERIAL.xml"),
        (lmt.parents[1], "Accel/NAME.txt"),
        (lmt.parents[2], "Accel/NAME.txt"),
        (accel, "accel/NAME.csv"),
        (accel / name, name),
    ):
        assert _exit_code(["encode", str(path), str(tmp_path / "a.touch")]) == 1
        error = capsys.readouterr().err
        assert f"Make a material: touchfield texture {what} -o NAME.json" in error, error
        assert error.count("\n") == 1 and not (tmp_path / "a.touch").exists()


def test_texture_makes_a_table_of_models_and_names_what_it_assumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    models = write_models(tmp_path / "Models_Made Oak.xml")
    assert _exit_code(["texture", str(models), "-o", str(tmp_path / "oak.json"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["materials"] == ["Made Oak"]
    names = [write_slide(tmp_path / "set", speed=speed) for speed in (20, 60)]
    files = [str(tmp_path / "set" / "accel" / name) for name in names]
    assert _exit_code(["texture", *files, "-o", str(tmp_path / "three.json"), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["materials"] == ["three"] and len(answer["notes"]) == 3

"""Sessions of a study: levels measured on real encodings, resumed, blinded, checked, analysed from files."""

import csv
import json
import re
import shutil
import socket

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.devices.drivers.registry import PointChoice
from touchfield.errors import DeviceAbsent, DeviceError, InvalidArgument, SourceError
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
from touchfield.render.point_device import PointDevice
from touchfield.render.readiness import Readiness
from touchfield.sources.shapes.analytic_scene import AnalyticScene
from touchfield.sources.shapes.shapes import Sphere
from touchfield.study import read_design, read_trials
from touchfield.study.design import for_participant
from touchfield.tasks import study
from touchfield.tasks.study import SessionSpec, analyse_study, measured_levels_mn, run_session, start_study
from touchfield.viewer.page import is_our_picture

BALL = AnalyticScene((Sphere((0.0, 0.0, 0.0), 0.03),))
KS = (0.1, 0.6)
DESIGN = """
title = "Encodings of a ball"
task = "{task}"
procedure = "{procedure}"
trials = {trials}
seed = 3
interval_s = 0.1
reference = "fine.touch"
"""
SIMULATED = SessionSpec("sim", observer="threshold=40,slope=2")


@pytest.fixture(scope="module")
def streams(tmp_path_factory):
    """A medium in three encodings."""
    folder = tmp_path_factory.mktemp("streams")
    for name, k in (("fine", 0.01), *((f"k{k}", k) for k in KS)):
        encode(BALL, folder / f"{name}.touch", EncodeSpec(nw=4, touch=TouchSpec(k=k, f0_n=0.002)))
    return folder


@pytest.fixture
def folder(streams, tmp_path):
    for path in streams.iterdir():
        shutil.copy(path, tmp_path)
    return tmp_path


def write_design(folder, task="3ifc", procedure="staircase", trials=12, compared=None, levels=()):
    text = DESIGN.format(task=task, procedure=procedure, trials=trials)
    for i, name in enumerate(compared or [f"k{k}.touch" for k in KS]):
        text += f'[[comparison]]\nstream = "{name}"\n' + (f"level = {levels[i]}\n" if levels else "")
    path = folder / "design.toml"
    path.write_text(text)
    return path


def no_answer(question, answers):
    raise AssertionError("a simulated observer is not asked")


def test_levels_are_the_differences_of_the_rendered_forces(folder):
    levels = measured_levels_mn(read_design(write_design(folder)))
    assert 0 < levels[0] < levels[1] < 1000  # a coarser encoding differs more
    rendered = folder / "design.toml"
    rendered.write_text(
        DESIGN.format(task="3ifc", procedure="staircase", trials=3)
        + '[[comparison]]\nstream = "fine.touch"\nrender = { force_scale = 1.1 }\n'
    )
    (scaled,) = measured_levels_mn(read_design(rendered))  # one stream, two settings of the renderer
    assert scaled > 10


def test_a_comparison_without_a_difference_is_refused_and_nothing_is_written(folder):
    path = write_design(folder, compared=["k0.1.touch", "fine.touch"])
    with pytest.raises(InvalidArgument, match=r"fine\.touch: found the same forces"):
        run_session(path, folder / "out", SIMULATED, no_answer)
    assert not (folder / "out").exists()


def test_a_simulated_session_gives_trials_a_dictionary_and_a_fit(folder):
    done = run_session(write_design(folder, trials=40), folder / "out", SIMULATED, no_answer)
    assert (done.figures["trials"], done.figures["state"]) == (40, "complete")
    out = folder / "out"
    with (out / "sub-sim_trials.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    described = json.loads((out / "trials.json").read_text())
    assert list(rows[0]) == list(described) and len(rows) == 40
    assert {row["stimulus"] for row in rows} <= {f"k{k}.touch" for k in KS}
    session = json.loads((out / "session.json").read_text())
    assert {float(row["level"]) for row in rows} <= set(session["levels"])
    found = analyse_study(out, out / "fits.png")
    assert {row["answered_by"] for row in rows} == {"simulated: threshold=40,slope=2"}
    assert any("simulated observer" in note for note in found.notes)
    (fit,) = found.figures["participants"]
    assert fit["trials"] == 40 and fit["participant"] == "sim"
    assert (fit["low"] or 0) <= 40 <= (fit["high"] or np.inf)
    assert is_our_picture(out / "fits.png")


class Hand:
    """A participant whose answers are given, and a device that records what it plays."""

    def __init__(self, monkeypatch, design, stops_after=None, is_right=lambda trial: trial % 3 != 1):
        self.played, self.shown, self.trial = [], [], 0
        self.design, self.stops_after, self.is_right = design, stops_after, is_right
        monkeypatch.setattr(study, "play", self.play)

    def play(self, path, spec):
        self.played.append((path.rpartition("/")[2], spec.device, spec.seconds))
        return self

    def checked(self):
        return self

    def ask(self, question, answers):
        if self.trial == self.stops_after:
            return None
        right = self.design.answer(self.trial)
        self.trial += 1
        return right if self.is_right(self.trial) else right % answers + 1


@pytest.mark.parametrize("procedure", ["staircase", "constant"])
def test_a_session_that_stopped_continues_as_if_it_had_not(procedure, folder, monkeypatch):
    path = write_design(folder, procedure=procedure, levels=(0.1, 0.6))
    spec, own = SessionSpec("07", device="sim"), for_participant(read_design(path), "07")
    whole = Hand(monkeypatch, own)
    run_session(path, folder / "whole", spec, whole.ask)
    first = Hand(monkeypatch, own, stops_after=5)
    stopped = run_session(path, folder / "parts", spec, first.ask)
    assert stopped.figures["trials"] == 5 and "continues" in stopped.figures["state"]
    first.stops_after = None
    assert run_session(path, folder / "parts", spec, first.ask).figures["state"] == "complete"
    fixed = ("trial", "level", "stimulus", "order", "response", "correct", "design", "answered_by")
    files = [folder / part / "sub-07_trials.csv" for part in ("whole", "parts")]
    both = [[tuple(getattr(trial, n) for n in fixed) for trial in read_trials(file)] for file in files]
    assert both[0] == both[1] and len(both[0]) == 12
    assert sum(row[5] for row in both[0]) == 8


def test_intervals_are_played_in_the_order_of_the_trial_and_nothing_tells_which_is_which(folder, monkeypatch):
    path = write_design(folder, trials=6, levels=(0.1, 0.6))
    hand = Hand(monkeypatch, for_participant(read_design(path), "07"))
    run_session(path, folder / "out", SessionSpec("07", device="sim"), hand.ask, hand.shown.append)
    trials = read_trials(folder / "out" / "sub-07_trials.csv")
    expected = [
        (trial.stimulus if has_comparison == "1" else "fine.touch", "sim", 0.1)
        for trial in trials
        for has_comparison in trial.order
    ]
    assert hand.played == expected
    assert hand.shown.pop(0) == "Each trial: three intervals. One of them differs from the others."
    assert all(re.fullmatch(r"trial \d of 6: interval \d of 3", text) for text in hand.shown)


class Handle(PointDevice):
    """A point device whose states are given; it records what is done with it."""

    title = "handle"

    def __init__(self, *states):
        self.states, self.calls = list(states), []

    def open(self):
        self.calls.append("open")
        if self.states[0] is None:
            raise DeviceAbsent("handle", "not connected", "a connected one", "Plug it in.")

    def readiness(self):
        return self.states[0] if len(self.states) == 1 else self.states.pop(0)

    def position_m(self):
        raise AssertionError("no interval is presented")

    def put_force_n(self, x, y, z):
        raise AssertionError("no force is applied")

    def close(self):
        self.calls.append("close")


HANDLE = SessionSpec("07", device="handle", wait="200ms")


def with_handle(monkeypatch, handle):
    choice = PointChoice("handle", lambda: handle, None, False)
    monkeypatch.setattr(study, "point_device", lambda text: choice)


@pytest.mark.parametrize(
    ("state", "found"),
    [
        (None, "found not connected"),
        (Readiness(is_calibrated=False), "found a device that is not calibrated"),
    ],
)
def test_a_device_that_is_not_ready_is_found_before_the_first_trial(state, found, folder, monkeypatch):
    handle = Handle(state)
    with_handle(monkeypatch, handle)
    path, shown = write_design(folder, levels=(0.1, 0.6)), []
    hand = Hand(monkeypatch, for_participant(read_design(path), "07"))
    with pytest.raises(DeviceError, match=found):
        run_session(path, folder / "out", HANDLE, hand.ask, shown.append)
    assert not hand.played and not (folder / "out").exists()
    assert handle.calls[-1] == "close" and len(shown) == 1 and "waiting for" in shown[0]


def test_a_session_waits_for_its_device_and_releases_it_before_the_first_interval(folder, monkeypatch):
    handle = Handle(*[Readiness(is_powered=False)] * 2, Readiness(is_powered=True))
    with_handle(monkeypatch, handle)
    path = write_design(folder, levels=(0.1, 0.6))
    hand = Hand(monkeypatch, for_participant(read_design(path), "07"))
    spec, calls_at_interval = HANDLE, []
    monkeypatch.setattr(
        study, "play", lambda *options: calls_at_interval.append(list(handle.calls)) or hand.play(*options)
    )
    assert run_session(path, folder / "out", spec, hand.ask).figures["state"] == "complete"
    assert calls_at_interval[0] == ["open", "close"]
    handle.states = [None]
    again = run_session(path, folder / "out", spec, no_answer)
    assert again.figures["state"].startswith("already complete") and handle.calls == ["open", "close"]


def test_an_array_that_does_not_answer_and_a_stream_that_it_cannot_show(folder, monkeypatch, capsys):
    path, out = str(write_design(folder, levels=(0.1, 0.6))), str(folder / "out")
    with socket.socket() as taken:  # bound, and not listening: nothing answers there
        taken.bind(("127.0.0.1", 0))
        device = f"pins:127.0.0.1:{taken.getsockname()[1]}"
        session = ["study", "run", path, out, "--participant", "1", "--device", device]
        assert _exit_code([*session, "--wait", "0s"])
    message = capsys.readouterr().err
    assert "127.0.0.1" in message and "Traceback" not in message
    encode(BALL, folder / "fine.touch", EncodeSpec(device="tshirt-32x32"))
    assert _exit_code(["study", "run", path, out, "--participant", "1", "--device", "sim"])
    assert "fine.touch: found a stream for the array" in capsys.readouterr().err
    assert not (folder / "out").exists()


@pytest.mark.parametrize("wait", ["2h", "3601s", "soon"])
def test_a_wait_is_that_of_every_interval_and_at_most_an_hour(wait):
    assert SessionSpec("1", device="sim", wait="2min").playback(seconds=2.0).wait == "2min"
    with pytest.raises(InvalidArgument, match="wait: found"):
        SessionSpec("1", device="sim", wait=wait)
    with pytest.raises(InvalidArgument, match="--wait: found no device to wait for"):
        SessionSpec(observer="threshold=0.3", wait="1s")


def test_participants_have_orders_of_their_own(folder):
    own = read_design(write_design(folder))
    orders = [[for_participant(own, label).order(trial) for trial in range(20)] for label in ("01", "02")]
    assert orders[0] != orders[1]


def test_an_interval_is_rendered_on_the_simulated_device(folder):
    path = write_design(folder, trials=1, levels=(0.1, 0.6))
    asked = []
    spec = SessionSpec("07", device="sim")
    done = run_session(path, folder / "out", spec, lambda question, answers: asked.append(question) or 1)
    assert done.figures["state"] == "complete" and len(asked) == 1


@pytest.mark.parametrize(
    ("pattern", "replacement", "expected"),
    [
        (r"(?m)^3,(.*?),[\d.]+,", r"3,\1,0.25,", "line 5: found level"),
        (r"(?m)^(3,.*?,)([01]{3}),", r"\g<1>111,", "line 5: found order"),
        (r"(?m)^(3,.*),\d\.\d+,", r"\1,", "line 5: found 9 columns"),
        (r"(?m)^3,", "4,", "line 5: found trial 4"),
        (r"^trial", "number", "line 1"),
    ],
)
def test_trials_that_were_changed_are_refused_with_their_line(pattern, replacement, expected, folder):
    path, spec = write_design(folder, levels=(0.1, 0.6)), SessionSpec("1", observer="threshold=0.3")
    run_session(path, folder / "out", spec, no_answer)
    trials = folder / "out" / "sub-1_trials.csv"
    changed = re.sub(pattern, replacement, trials.read_text(), count=1)
    assert changed != trials.read_text()
    trials.write_text(changed)
    with pytest.raises(SourceError, match=expected):
        run_session(path, folder / "out", spec, no_answer)


def test_another_design_or_stream_is_refused_in_a_folder_with_a_session(folder):
    path, spec = write_design(folder, levels=(0.1, 0.6)), SessionSpec("1", observer="threshold=0.3")
    run_session(path, folder / "out", spec, no_answer)
    shutil.copy(folder / "k0.1.touch", folder / "k0.6.touch")
    with pytest.raises(InvalidArgument, match="other streams"):
        run_session(path, folder / "out", SessionSpec("2", observer="threshold=0.3"), no_answer)
    with pytest.raises(InvalidArgument, match="another design"):
        run_session(write_design(folder, levels=(0.1, 0.7)), folder / "out", spec, no_answer)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "reference: found nothing"),
        ('reference = "a"\ncomparison = []', "0 of them"),
        ('reference = "a"\ntask = "4ifc"\n[[comparison]]\nstream = "b"', "one of 2ifc, 3ifc, abx"),
        ('reference = "a"\nsteps = 3\n[[comparison]]\nstream = "b"', "steps: found an unknown field"),
        ('reference = "a"\ntrials = true\n[[comparison]]\nstream = "b"', "a whole number"),
        ('reference = "a"\ntrials = 0\n[[comparison]]\nstream = "b"', "trials"),
        ('reference = "a"\n[[comparison]]\nlevel = 1', "comparison 1.stream: found nothing"),
        ('reference = "a"\n[[comparison]]\nstream = "b"\nlevel = -1', "level"),
        ('reference = "a"\n[[comparison]]\nstream = "b"\nlevel = nan', "level"),
        (
            'reference = "a"\n[[comparison]]\nstream = "b"\nlevel = 1\n[[comparison]]\nstream = "c"',
            "for some",
        ),
        ('reference = "a"\ncomparison = [1]', "a table"),
        ("reference = ", "no TOML"),
    ],
)
def test_a_wrong_design_names_its_field(text, expected, tmp_path):
    (tmp_path / "design.toml").write_text(text)
    with pytest.raises(SourceError, match=re.escape(expected)) as caught:
        read_design(tmp_path / "design.toml")
    assert "design.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_an_unknown_option_of_the_renderer_is_named_before_anything_is_written(folder):
    path = write_design(folder, compared=["k0.1.touch"], levels=(1.0,))
    path.write_text(path.read_text() + "render = { speed = 3 }\n")
    with pytest.raises(
        SourceError, match=r"design\.toml: comparison 1\.render\.speed: found an unknown option"
    ):
        run_session(path, folder / "out", SIMULATED, no_answer)
    assert not (folder / "out").exists()


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        ({"clutch_mm": [0, 0, 5]}, {"clutch_m": (0.0, 0.0, 0.005)}),
        ({"no_blend": True}, {"blend": False}),
        ({"gravity_n": [0, 0, 1]}, {"gravity_n": (0, 0, 1)}),
    ],
)
def test_options_of_the_renderer_have_the_names_of_play(values, expected, capsys):
    made = study.render_spec(values)
    assert {name: getattr(made, name) for name in expected} == expected
    assert not _exit_code(["play", "--help"])
    assert all(f"--{name.replace('_', '-')}" in capsys.readouterr().out for name in values)


@pytest.mark.parametrize(
    "values",
    [
        {"clutch_m": [0, 0, 1]},
        {"clutch_mm": 5},
        {"gravity_n": [[1], [1, 2]]},
        {"clutch_mm": ["a", 0, 0]},
        {"no_blend": 1},
    ],
)
def test_an_unfit_option_of_the_renderer_is_named(values):
    with pytest.raises(InvalidArgument, match=f"^{next(iter(values))}: found"):
        study.render_spec(values)


def test_templates_make_a_design_that_can_be_read(tmp_path):
    files = start_study(tmp_path / "new").figures["files"]
    assert [name.rpartition("/")[2] for name in files] == ["design.toml", "consent.md", "device.md"]
    assert len(read_design(files[0]).comparisons) == 3
    with pytest.raises(InvalidArgument, match="no such file yet"):
        start_study(tmp_path / "new")


def test_the_commands_run_analyse_and_power(folder, capsys):
    path, out = str(write_design(folder, levels=(0.1, 0.6))), str(folder / "out")
    assert not _exit_code(["study", "run", path, out, "--observer", "threshold=0.2", "--json"])
    assert json.loads(capsys.readouterr().out)["trials"] == 12
    assert not _exit_code(["study", "analyse", out, "--json"])
    assert len(json.loads(capsys.readouterr().out)["levels"]) <= 2
    assert not _exit_code(["study", "power", path, "--observer", "threshold=0.2", "--runs", "10", "--json"])
    answer = json.loads(capsys.readouterr().out)
    power, explained = answer["power"], {note.partition(":")[0] for note in answer["notes"]}
    assert explained == set(power[0]) - {"trials", "runs"}
    assert [row["trials"] for row in power] == [3, 6, 12, 24, 48]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("go design.toml", "one of init, run, analyse, power"),
        ("run design.toml", "FOLDER"),
        ("run design.toml out", "--device, --observer: found neither"),
        ("run design.toml out --observer threshold=x", "--observer"),
        ("run design.toml out --observer threshold=-5", "--observer: found threshold -5.0"),
        ("run design.toml out --observer threshold=5,slope=nan", "--observer: found slope nan"),
        ("run design.toml out --observer threshold=5,threshold=6", "--observer"),
        ("run design.toml out --device sim", "--participant: found nothing"),
        ("run design.toml out --device nodevice --participant 1", "nodevice"),
        ("power design.toml --observer threshold=1,lapse=2", "--observer: found lapse 2.0"),
        (
            "power design.toml --observer threshold=1 --participant 2",
            "--participant is only for study run, not",
        ),
        ("power missing.toml --observer threshold=1", "missing.toml: found no such file"),
        ("run design.toml out --observer threshold=1 --participant a/b", "--participant"),
        ("power design.toml", "--observer"),
        ("power design.toml --observer threshold=1 --runs 5", "--runs"),
        ("analyse missing", "session.json: found no such file"),
        ("init new --observer threshold=1", "study run or power"),
    ],
)
def test_a_command_that_cannot_be_is_one_line_and_no_file(arguments, expected, folder, monkeypatch, capsys):
    write_design(folder, levels=(0.1, 0.6))
    monkeypatch.chdir(folder)
    before = sorted(folder.rglob("*"))
    assert _exit_code(["study", *arguments.split()])
    message = capsys.readouterr().err
    assert expected in message and message.count("\n") == 1
    assert sorted(folder.rglob("*")) == before


OBSERVERS = {
    "simulated": {"observer": "threshold=0.3,slope=2"},
    "another": {"observer": "threshold=0.1,slope=2"},
    "person": {"device": "sim"},
}


@pytest.mark.parametrize("trials", [5, 12])
@pytest.mark.parametrize(
    ("first", "second"), [("simulated", "another"), ("simulated", "person"), ("person", "simulated")]
)
def test_a_session_belongs_to_one_observer(first, second, trials, folder, monkeypatch):
    path, out = write_design(folder, levels=(0.1, 0.6)), folder / "out"
    hand = Hand(monkeypatch, for_participant(read_design(path), "7"))
    run_session(path, out, SessionSpec("7", **OBSERVERS[first]), hand.ask)
    file = out / "sub-7_trials.csv"
    file.write_bytes(b"".join(file.read_bytes().splitlines(keepends=True)[: trials + 1]))
    before = file.read_bytes()
    other = SessionSpec("7", **OBSERVERS[second])
    with pytest.raises(InvalidArgument, match="line 2: found an answer of") as caught:
        run_session(path, out, other, no_answer)
    assert SessionSpec("7", **OBSERVERS[first]).answered_by in str(caught.value)
    assert other.answered_by in str(caught.value)
    assert file.read_bytes() == before


def test_the_same_observer_written_otherwise_continues_and_a_complete_session_runs_nothing(folder):
    path, out = write_design(folder, levels=(0.1, 0.6)), folder / "out"
    run_session(path, out, SessionSpec(observer="threshold=0.3"), no_answer)
    file = out / "sub-sim_trials.csv"
    lines = file.read_bytes().splitlines(keepends=True)
    file.write_bytes(b"".join(lines[:6]))
    again = SessionSpec("sim", observer=" slope=3, threshold=0.30")
    assert run_session(path, out, again, no_answer).figures["state"] == "complete"
    before = file.read_bytes()
    assert run_session(path, out, again, no_answer).figures["state"] == "already complete, nothing was run"
    assert file.read_bytes() == before


def test_another_device_of_a_person_is_noted(folder, monkeypatch):
    path = write_design(folder, levels=(0.1, 0.6))
    hand = Hand(monkeypatch, for_participant(read_design(path), "7"), stops_after=3)
    assert not run_session(path, folder / "out", SessionSpec("7", device="sim"), hand.ask).notes
    hand.stops_after = 5
    done = run_session(path, folder / "out", SessionSpec("7", device="sim:spring"), hand.ask)
    assert done.figures["trials"] == 5
    assert done.notes == ("earlier trials have another device: person: sim; now person: sim:spring",)


@pytest.mark.parametrize("cut", [1, 2, 12, 60])
def test_a_cut_line_is_left_out_of_the_analysis_and_refused_by_a_session(cut, folder):
    path, out, spec = (
        write_design(folder, levels=(0.1, 0.6)),
        folder / "out",
        SessionSpec(observer="threshold=0.3"),
    )
    run_session(path, out, spec, no_answer)
    file = out / "sub-sim_trials.csv"
    file.write_bytes(file.read_bytes()[:-cut])
    found = analyse_study(out)
    assert found.figures["participants"][0]["trials"] == 11
    assert "participant sim: the last line of sub-sim_trials.csv is cut and left out" in found.notes
    assert "participant sim: 11 of 12 trials" in found.notes
    with pytest.raises(SourceError, match=r"line 13: found a line that is cut.*Delete the line"):
        run_session(path, out, spec, no_answer)


def test_the_analysis_notes_observers_that_are_mixed_and_limits_of_the_fit(folder):
    path, out = write_design(folder, levels=(0.1, 0.6)), folder / "out"
    run_session(path, out, SessionSpec(observer="threshold=0.001"), no_answer)
    notes = analyse_study(out).notes  # every answer is correct
    assert any("the threshold is at the limit of the fit" in note for note in notes)
    assert not any("of 12 trials" in note for note in notes)
    file = out / "sub-sim_trials.csv"
    first, changed = file.read_text().split("threshold=0.001", 1)
    file.write_text(
        first + "threshold=0.001" + changed.replace("threshold=0.001", "threshold=0.5"), newline=""
    )
    (note,) = [note for note in analyse_study(out).notes if "not of one observer" in note]
    assert "threshold=0.001" in note and "threshold=0.5" in note


def test_more_trials_than_the_design_has_are_refused(folder):
    path, out, spec = (
        write_design(folder, levels=(0.1, 0.6)),
        folder / "out",
        SessionSpec(observer="threshold=0.3"),
    )
    run_session(path, out, spec, no_answer)
    file = out / "sub-sim_trials.csv"
    lines = file.read_text().splitlines(keepends=True)
    file.write_text("".join([*lines, lines[-1].replace("11,", "12,", 1)]))
    with pytest.raises(SourceError, match="found 13 trials; expected at most 12"):
        run_session(path, out, spec, no_answer)

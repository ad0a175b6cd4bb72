"""Sessions of a study: levels measured on real encodings, resumed, blinded, checked, analysed from files."""

import csv
import json
import re
import shutil

import numpy as np
import pytest

from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import InvalidArgument, SourceError
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec
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
    assert all(re.fullmatch(r"trial \d of 6: interval \d of 3", text) for text in hand.shown)


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
    with pytest.raises(InvalidArgument, match=r"comparison\.render\.speed"):
        run_session(path, folder / "out", SIMULATED, no_answer)
    assert not (folder / "out").exists()


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
    power = json.loads(capsys.readouterr().out)["power"]
    assert [row["trials"] for row in power] == [3, 6, 12, 24, 48]


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("go design.toml", "one of init, run, analyse, power"),
        ("run design.toml", "FOLDER"),
        ("run design.toml out", "--device, --observer: found neither"),
        ("run design.toml out --observer threshold=x", "--observer"),
        ("run design.toml out --observer threshold=1 --participant a/b", "--participant"),
        ("power design.toml", "--observer"),
        ("power design.toml --observer threshold=1 --runs 5", "--runs"),
        ("analyse missing", "session.json"),
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

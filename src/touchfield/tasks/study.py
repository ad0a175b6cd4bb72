"""Runs forced-choice studies: presents streams on a device, or has a simulated observer answer, records every
trial, and analyses a folder of sessions.

    design -> levels (given, or measured) -> trials by a procedure -> sub-LABEL_trials.csv -> fits

A folder has ``session.json`` (levels and design of the study), ``trials.json`` (data dictionary) and one file
for each participant. A session that stops is continued by the same call. Nothing that is shown during a
session says what an interval has, or whether an answer is correct.
"""

from __future__ import annotations

import hashlib
import json
import tempfile
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, replace
from datetime import UTC, datetime
from importlib import resources
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield._version import __version__
from touchfield.atomic import atomic_path
from touchfield.compute.threads import Progress, silent
from touchfield.devices.drivers.registry import array_device, is_array_device, point_device
from touchfield.devices.drivers.touch_down import touch_down
from touchfield.errors import InvalidArgument, SourceError, as_source_error, is_finite
from touchfield.files import json_of, read_bytes, readable, require_plain
from touchfield.network.opening import open_stream
from touchfield.options import duration_s
from touchfield.pipeline.result import Result
from touchfield.render.readiness import Unit, open_when_ready
from touchfield.render.spec import RenderSpec
from touchfield.study.analysis import Fit, fit_psychometric, level_tests, power_of
from touchfield.study.design import (
    TASKS,
    StudyDesign,
    for_participant,
    read_design,
    with_levels,
)
from touchfield.study.procedures import procedure_of
from touchfield.study.psychometric import Psychometric, SimulatedObserver
from touchfield.study.trials import (
    Trial,
    append_trial,
    read_complete_trials,
    read_trials,
    trials_path,
    write_dictionary,
)
from touchfield.tasks.play import PlaySpec, play
from touchfield.viewer.study import draw_fits

TEMPLATES: Final = ("design.toml", "consent.md", "device.md")
SESSION: Final = "session.json"
_SIMULATED: Final = "simulated: "
_MAX_SESSION_BYTES: Final = 1 << 20
DEFAULT_WAIT: Final = PlaySpec.wait

Ask = Callable[[str, int], int | None]
"""``ask(question, answers) -> 1 to answers``, or None to stop."""

Show = Callable[[str], None]


# -- templates -------------------------------------------------------------------------------------------
def start_study(folder: str | Path) -> Result:
    """Write the templates of a study (design, consent, device) to a folder; none is overwritten.

    `InvalidArgument` if one exists.
    """
    folder = Path(folder)
    for name in TEMPLATES:
        if (folder / name).exists():
            raise InvalidArgument(str(folder / name), "a file", "no such file yet", "Name another folder.")
    folder.mkdir(parents=True, exist_ok=True)
    for name in TEMPLATES:
        text = (resources.files("touchfield.study") / "templates" / name).read_text("utf-8")
        with atomic_path(folder / name) as temporary:
            temporary.write_text(text, "utf-8")
    return Result({"files": [str(folder / name) for name in TEMPLATES]})


# -- levels ----------------------------------------------------------------------------------------------
def measured_levels_mn(design: StudyDesign, report: Progress = silent) -> tuple[float, ...]:
    """Difference in force between each comparison and the reference, millinewtons rms.

    Both are played offline along one path, which touches the reference (`touch_down`). Ticks count in which
    either has a force. `InvalidArgument` if a comparison does not differ.
    """
    with open_stream(design.reference) as stream, tempfile.TemporaryDirectory() as folder:
        path = touch_down(stream.scene or stream.medium)
        trajectory = Path(folder) / "path.csv"
        rows = np.column_stack([path.times_s, path.positions_m])
        np.savetxt(trajectory, rows, delimiter=",", header="t_s,x_m,y_m,z_m", comments="")
        reference_n = _forces_n(design.reference, trajectory, {})
        levels = []
        for i, compared in enumerate(design.comparisons):
            forces_n = _forces_n(compared.stream, trajectory, compared.render)
            count = min(len(forces_n), len(reference_n))
            a, b = reference_n[:count], forces_n[:count]
            has_force = a.any(axis=1) | b.any(axis=1)
            squares = ((a - b)[has_force] ** 2).sum(axis=1)
            levels.append(1e3 * float(np.sqrt(squares.mean())) if squares.size else 0.0)
            if not levels[-1] > 0:
                found, expected = "the same forces as of the reference", "a difference along the path"
                raise InvalidArgument(compared.stream, found, expected, "Take it out, or give levels.")
            report(i + 1, len(design.comparisons))
    return tuple(levels)


def _forces_n(stream: str, trajectory: Path, render: Mapping[str, Any]) -> Any:
    """Forces along a path, newtons float64 [ticks, 3]."""
    spec = PlaySpec(offline=True, is_logged=True, trajectory=trajectory, render=render_spec(render))
    rows = play(stream, spec).checked().rows
    assert rows is not None
    return np.asarray(rows["force_n"], np.float64)


def render_spec(values: Mapping[str, Any]) -> RenderSpec:
    """The spec of the renderer from a table of a design; `InvalidArgument` for an unknown or unfit option.

    Names are those of ``touchfield play``, with ``_`` for ``-``; three numbers are an array.
    """
    for name in values:
        if name not in _RENDER_OPTIONS:
            raise InvalidArgument(name, "an unknown option", f"one of {', '.join(_RENDER_OPTIONS)}")
    options: dict[str, Any] = dict(values)
    for name in values.keys() & {"clutch_mm", "gravity_n"}:
        value = values[name]
        if not (isinstance(value, list) and len(value) == 3 and all(map(is_finite, value))):
            raise InvalidArgument(name, repr(value)[:60], "three finite numbers")
        options[name] = tuple(value)
    if "clutch_mm" in options:
        options["clutch_m"] = tuple(v / 1000 for v in options.pop("clutch_mm"))
    if "no_blend" in options:
        if not isinstance(options["no_blend"], bool):
            raise InvalidArgument("no_blend", repr(options["no_blend"])[:60], "true or false")
        options["blend"] = not options.pop("no_blend")
    return RenderSpec(**options)


_RENDER_OPTIONS: Final = sorted(
    {item.name for item in fields(RenderSpec)} - {"tool", "materials", "deformation", "clutch_m", "blend"}
    | {"clutch_mm", "no_blend"}
)


def read_playable_design(path: str | Path) -> StudyDesign:
    """Read a design as `read_design`; `SourceError` also for an option that the renderer does not take."""
    design = read_design(path)
    for i, compared in enumerate(design.comparisons, 1):
        with as_source_error(f"{path}: comparison {i}.render."):
            render_spec(compared.render)
    return design


def resolved_design(design: StudyDesign, report: Progress = silent) -> StudyDesign:
    """The design with levels: its own, or measured ones in mN rms."""
    if not design.is_measured:
        return design
    return with_levels(design, measured_levels_mn(design, report), "mN")


# -- sessions --------------------------------------------------------------------------------------------
@dataclass(frozen=True)
class SessionSpec:
    """Who takes part, and how the intervals are presented.

    `observer`: a simulated observer, "threshold=20,slope=3,lapse=0.02", in the unit of the levels; `device`:
    as of `PlaySpec`. One of both. `participant` is the label of a person, and by default "sim" of a simulated
    observer. `wait`: duration, at most an hour, until the device must be ready, such as "2min"; None: 30 s.
    """

    participant: str | None = None
    device: str | None = None
    observer: str | None = None
    wait: str | None = None

    def __post_init__(self) -> None:
        if (self.device is None) == (self.observer is None):
            found = "neither" if self.device is None else "both"
            raise InvalidArgument("--device, --observer", found, "one of them: who answers?")
        if self.participant is None and self.observer is None:
            raise InvalidArgument("--participant", "nothing", "a label for the person, such as 01")
        if self.wait is not None and self.device is None:
            raise InvalidArgument("--wait", "no device to wait for", "--device", "Take --wait out.")
        self.playback()

    def playback(self, **options: Any) -> PlaySpec:
        """How an interval is played, with more options of `PlaySpec`; InvalidArgument for a wrong `wait`."""
        wait = DEFAULT_WAIT if self.wait is None else self.wait
        return PlaySpec(device=self.device or "sim", wait=wait, loop=True, **options)

    @property
    def label(self) -> str:
        """Label of the participant."""
        return "sim" if self.participant is None else self.participant

    @property
    def answered_by(self) -> str:
        """Who answers, for the record: a person at a device, or a simulated observer."""
        return f"person: {self.device}" if self.observer is None else f"{_SIMULATED}{self.observer}"


def run_session(
    design_path: str | Path,
    folder: str | Path,
    spec: SessionSpec,
    ask: Ask,
    show: Show = lambda text: None,
    report: Progress = silent,
) -> Result:
    """Run or continue the session of a participant, and return how far it came.

    A device must be ready before the first trial, and before anything is written. `InvalidArgument` or
    `SourceError` if the design is wrong, the folder has another design, earlier trials do not follow from
    it, somebody else answered them, or there is no such device; `DeviceError` if it is not ready in time.
    """
    design, folder = read_playable_design(design_path), Path(folder)
    path = trials_path(folder, spec.label)
    observer, unit = None, None
    if spec.observer is not None:  # before anything is written
        observer = SimulatedObserver.parse(spec.observer, design.chance, design.seed)
    else:
        unit = _unit_of(spec.device or "")
    earlier = read_trials(path) if path.exists() else ()
    _require_same_observer(path, earlier, spec, design.chance)
    if observer is None and len(earlier) < design.trials:
        _require_shown(design, spec.device or "")
        if unit is not None:
            _require_ready(unit, duration_s(spec.playback().wait, "wait"), show)
    design = for_participant(_session_design(design, folder, report), spec.label)
    if observer is not None:
        observer = replace(observer, seed=design.seed)
    procedure, done = _replayed(design, path, earlier), len(earlier)
    notes = _device_notes(earlier, spec)
    if done == design.trials:
        state = "already complete, nothing was run"
        return Result({"file": str(path), "trials": done, "of": design.trials, "state": state}, notes)
    session = _Session(design, spec, observer, ask, show)
    if observer is None:
        show(_INSTRUCTIONS[design.task])
    for trial in range(done, design.trials):
        index = procedure.next_index()
        answered = session.trial(trial, sorted(design.levels)[index])
        if answered is None:
            break
        append_trial(path, answered)
        procedure.update(index, bool(answered.correct))
        done = trial + 1
        report(done, design.trials)
    state = "complete" if done == design.trials else "stopped; the same command continues it"
    return Result({"file": str(path), "trials": done, "of": design.trials, "state": state}, notes)


def _unit_of(device: str) -> Unit | None:
    """The device of a session, not open; None for a simulated hand. `InvalidArgument` for an unknown one."""
    if is_array_device(device):
        return array_device(device)
    choice = point_device(device)
    return None if choice.is_simulated else choice.opener()


def _require_shown(design: StudyDesign, device: str) -> None:
    """`InvalidArgument` if a stream of the design is for an array and the device is a point."""
    if is_array_device(device):
        return
    for stream in dict.fromkeys((design.reference, *(compared.stream for compared in design.comparisons))):
        with open_stream(stream) as opened:
            head = opened.reader.head
        if head.device_type == 2:
            found, hint = f"a stream for the array {head.device_name}", "Name an array as the --device."
            raise InvalidArgument(stream, found, f"one in space, for --device {device}", hint)


def _require_ready(unit: Unit, wait_s: float, show: Show) -> None:
    """Open a device, wait until it is ready, and close it; `DeviceError` if it is not ready in time."""
    try:
        open_when_ready(unit, wait_s, on_note=show)
    finally:
        unit.close()


def _identity(answered_by: str, chance: float) -> Psychometric | str:
    """Who answers: the function of a simulated observer, or a person, whatever the device."""
    if not answered_by.startswith(_SIMULATED):
        return "a person"
    try:
        return SimulatedObserver.parse(answered_by.removeprefix(_SIMULATED), chance, 0).function
    except InvalidArgument:
        return answered_by


def _require_same_observer(path: Path, earlier: tuple[Trial, ...], spec: SessionSpec, chance: float) -> None:
    """`InvalidArgument` if another observer answered an earlier trial: a fit is that of one observer."""
    own = _identity(spec.answered_by, chance)
    for trial in earlier:
        if _identity(trial.answered_by, chance) != own:
            where, hint = f"{path}, line {trial.trial + 2}", "Take another --participant."
            raise InvalidArgument(
                where, f"an answer of {trial.answered_by!r}", f"{spec.answered_by!r}, which answers now", hint
            )


def _device_notes(earlier: tuple[Trial, ...], spec: SessionSpec) -> tuple[str, ...]:
    """A note if a person had other devices in earlier trials."""
    others = {trial.answered_by for trial in earlier} - {spec.answered_by}
    if not others or spec.observer is not None:
        return ()
    return (f"earlier trials have another device: {', '.join(sorted(others))}; now {spec.answered_by}",)


def _session_design(design: StudyDesign, folder: Path, report: Progress) -> StudyDesign:
    """The design with the levels that the folder has, or that are now measured and written there."""
    path = folder / SESSION
    if path.exists():
        stored = _read_session(path)
        if stored["design"] != design.digest:
            found, hint = "a session of another design", "Take another folder, or the design as it was."
            raise InvalidArgument(str(path), found, hint=hint)
        if stored.get("streams") != _digests(design):
            found, hint = "a session with other streams", "Take another folder, or the streams as they were."
            raise InvalidArgument(str(path), found, hint=hint)
        if len(stored["levels"]) != len(design.comparisons):
            raise SourceError(str(path), f"{len(stored['levels'])} levels", f"{len(design.comparisons)}")
        return with_levels(design, stored["levels"], stored["unit"])
    streams = _digests(design)
    is_measured, design = design.is_measured, resolved_design(design, report)
    procedure_of(design)  # MissingExtra before anything is written
    folder.mkdir(parents=True, exist_ok=True)
    write_dictionary(folder)
    session = {
        "title": design.title, "touchfield": __version__, "design": design.digest, "task": design.task,
        "procedure": design.procedure, "trials": design.trials, "seed": design.seed,
        "interval_s": design.interval_s, "reference": Path(design.reference).name,
        "comparisons": [Path(c.stream).name for c in design.comparisons], "levels": list(design.levels),
        "unit": design.unit, "is_measured": is_measured,
        "streams": streams,
    }  # fmt: skip
    with atomic_path(path) as temporary:
        temporary.write_text(json.dumps(session, indent=2) + "\n", "utf-8")
    return design


def _digests(design: StudyDesign) -> list[str]:
    """SHA-256 of the reference and of each comparison; `SourceError` if one is no file."""
    digests = []
    for stream in (design.reference, *(compared.stream for compared in design.comparisons)):
        require_plain(stream, "a stream of the design")
        with readable(Path(stream), "a stream of the design"), Path(stream).open("rb") as file:
            digests.append(hashlib.file_digest(file, "sha256").hexdigest())
    return digests


def _read_session(path: Path) -> dict[str, Any]:
    """The session of a folder; `SourceError` if it is not what `run_session` writes."""
    try:
        data = read_bytes(path, _MAX_SESSION_BYTES, "a folder of a study")
        values: dict[str, Any] = json_of(data.decode())
        levels = tuple(float(level) for level in values["levels"])
        known: dict[str, Any] = {name: str(values[name]) for name in ("design", "unit", "task", "title")}
        known["trials"] = int(values["trials"])
    except (ValueError, TypeError, KeyError, OverflowError, RecursionError):
        raise SourceError(str(path), "no session", "what `touchfield study run` writes") from None
    return {**values, **known, "levels": levels}


def _replayed(design: StudyDesign, path: Path, earlier: tuple[Trial, ...]) -> Any:
    """The procedure after the trials of a file; `SourceError` if they do not follow from the design."""
    procedure, ascending = procedure_of(design), sorted(design.levels)
    if len(earlier) > design.trials:
        found, hint = f"{len(earlier)} trials", "Restore the file, or take another participant."
        raise SourceError(str(path), found, f"at most {design.trials}, as in the design", hint)
    for trial in earlier:
        index = procedure.next_index()
        where = f"{path}, line {trial.trial + 2}"
        if trial.level != ascending[index]:
            found, expected = (
                f"level {trial.level}",
                f"{ascending[index]}, which follows from the answers before",
            )
            raise SourceError(where, found, expected, "Restore the file, or take another participant.")
        if trial.order != _text_of(design.order(trial.trial)):
            raise SourceError(where, f"order {trial.order}", _text_of(design.order(trial.trial)))
        procedure.update(index, bool(trial.correct))
    return procedure


def _text_of(order: tuple[int, ...]) -> str:
    return "".join(map(str, order))


@dataclass(frozen=True)
class _Session:
    """Presents trials and takes the answers."""

    design: StudyDesign
    spec: SessionSpec
    observer: SimulatedObserver | None
    ask: Ask
    show: Show

    def trial(self, number: int, level: float) -> Trial | None:
        """Present a trial; None if the participant stops."""
        design = self.design
        compared = next(c for c in design.comparisons if c.level == level)
        order, right = design.order(number), design.answer(number)
        start_s = 0.0
        if self.observer is not None:
            is_correct = self.observer.is_correct(level, number)
            response: int | None = right if is_correct else right % design.answers + 1
        else:
            self._present(number, order, compared.stream, compared.render)
            start_s = time.perf_counter()
            response = self.ask(_QUESTIONS[design.task], design.answers)
        if response is None:
            return None
        taken_s = round(time.perf_counter() - start_s, 3) if self.observer is None else 0.0
        now = datetime.now(UTC).isoformat(timespec="seconds")
        return Trial(
            number, now, level, Path(compared.stream).name, _text_of(order), response, int(response == right),
            taken_s, design.digest[:16], self.spec.answered_by,
        )  # fmt: skip

    def _present(self, number: int, order: tuple[int, ...], stream: str, render: Mapping[str, Any]) -> None:
        """Play the intervals of a trial on the device, one after the other."""
        for i, has_comparison in enumerate(order, 1):
            self.show(f"trial {number + 1} of {self.design.trials}: interval {i} of {len(order)}")
            rendering = render_spec(render if has_comparison else {})
            spec = self.spec.playback(seconds=self.design.interval_s, render=rendering)
            play(stream if has_comparison else self.design.reference, spec).checked()


_QUESTIONS: Final = {
    "2ifc": "Which of intervals 2 and 3 differs from the first? 1 (the second) or 2 (the third)",
    "3ifc": "Which interval differs from the others? 1, 2 or 3",
    "abx": "Is the last interval the first or the second? 1 or 2",
}

_INSTRUCTIONS: Final = {
    "2ifc": "Each trial: a reference, then two intervals. One of the two differs from the reference.",
    "3ifc": "Each trial: three intervals. One of them differs from the others.",
    "abx": "Each trial: three intervals. The last one is like the first or like the second.",
}


# -- analysis --------------------------------------------------------------------------------------------
def analyse_study(folder: str | Path, plot: Path | None = None) -> Result:
    """Fit the psychometric function of each participant of a folder.

    Each of ``participants`` has the threshold, its 95 % interval, slope, lapse, and trials; each of
    ``levels`` the rate of correct answers and the exact test against chance. Notes name what is missing or
    left out. `SourceError` if there is no session or no trial; with `plot` also a PNG (`MissingExtra`
    without matplotlib).
    """
    folder = Path(folder)
    session = _read_session(folder / SESSION)
    if session["task"] not in TASKS:
        raise SourceError(str(folder / SESSION), f"task {session['task']!r}", " or ".join(TASKS))
    chance, participants, levels, fits, notes = TASKS[session["task"]], [], [], {}, []
    for path in sorted(folder.glob("sub-*_trials.csv")):
        (trials, is_cut), label = read_complete_trials(path), path.name[4:].removesuffix("_trials.csv")
        if is_cut:
            notes.append(f"participant {label}: the last line of {path.name} is cut and left out")
        if not trials:
            notes.append(f"participant {label} has no trial")
            continue
        if any(trial.design != session["design"][:16] for trial in trials):
            raise SourceError(str(path), "trials of another design", "those of the design of the folder")
        of_trials = [trial.level for trial in trials], [bool(trial.correct) for trial in trials]
        fit = fits[label] = fit_psychometric(*of_trials, chance)
        rows = level_tests(*of_trials, chance)
        levels += [{"participant": label, **row} for row in rows]
        function = fit.function
        participants.append({
            "participant": label, "threshold": function.threshold, "low": fit.low, "high": fit.high,
            "slope": function.slope, "lapse": function.lapse, "trials": fit.trials,
        })  # fmt: skip
        found = _participant_notes(trials, fit, session["trials"], chance)
        notes += [f"participant {label}: {note}" for note in found]
    if not fits:
        raise SourceError(str(folder), "no trials", "sub-LABEL_trials.csv of `touchfield study run`")
    if plot is not None:
        draw_fits(plot, session["title"], session["unit"], fits, levels)
    figures = {"title": session["title"], "task": session["task"], "chance": chance, "unit": session["unit"]}
    return Result({**figures, "participants": participants, "levels": levels}, tuple(notes))


def _participant_notes(trials: tuple[Trial, ...], fit: Fit, planned: int, chance: float) -> list[str]:
    """What a reader of the fit of a participant has to know."""
    notes = []
    if len(trials) != planned:
        notes.append(f"{len(trials)} of {planned} trials")
    if len({_identity(trial.answered_by, chance) for trial in trials}) > 1:
        observers = ", ".join(dict.fromkeys(trial.answered_by for trial in trials))
        notes.append(f"the answers are not of one observer, and the fit is of none: {observers}")
    elif trials[0].answered_by.startswith(_SIMULATED):
        notes.append("answers of a simulated observer")
    if fit.low is None or fit.high is None:
        notes.append("the interval is open; more trials, or weaker and stronger levels")
    for name in fit.at_limit:
        value = getattr(fit.function, name)
        notes.append(f"the {name} is at the limit of the fit, {value:.3g}: the trials do not settle it")
    return notes


_POWER_LEGEND: Final = (
    "covered: fraction of the sessions whose 95 % interval contains the threshold of the observer",
    "closed: fraction of the sessions whose interval has both ends",
    "width: upper over lower end of the interval, median of the closed ones",
    "bias: estimated threshold over that of the observer, median",
    "detected: fraction of the sessions whose answers, all together, are above chance at 5 %",
)


def study_power(design_path: str | Path, observer: str, runs: int = 100, report: Progress = silent) -> Result:
    """Simulate the design of a study with an observer, for a quarter to four times its trials.

    The rows are those of `touchfield.study.power_of`; notes explain them. `InvalidArgument`
    if `runs` is not 10 to 1000.
    """
    if not 10 <= runs <= 1000:
        raise InvalidArgument("--runs", str(runs), "10 to 1000")
    design = read_playable_design(design_path)
    function: Psychometric = SimulatedObserver.parse(observer, design.chance, design.seed).function
    design = resolved_design(design, report)
    counts = sorted({max(round(design.trials * factor), 1) for factor in (0.25, 0.5, 1, 2, 4)})
    rows = []
    for i, trials in enumerate(counts):
        rows.append(power_of(replace(design, trials=trials), function, runs))
        report(i + 1, len(counts))
    figures = {"levels": list(design.levels), "unit": design.unit, "threshold": function.threshold}
    return Result(
        {**figures, "procedure": design.procedure, "task": design.task, "power": rows}, _POWER_LEGEND
    )

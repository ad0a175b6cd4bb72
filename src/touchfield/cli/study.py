"""Command `study`: forced-choice studies with people or a simulated observer."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Final

import typer

from touchfield import tasks
from touchfield.cli.main import command
from touchfield.cli.output import Answer, check_results, echo, progress
from touchfield.errors import InvalidArgument, require_one_of

_ACTIONS: Final = ("init", "run", "analyse", "power")
DEFAULT_RUNS: Final = 100


@command(
    "Study",
    "study init folder",
    "study run folder/design.toml results --participant 01 --device haply",
    "study run folder/design.toml results --participant sim --observer threshold=20,slope=3",
    "study analyse results --plot fits.png",
    "study power folder/design.toml --observer threshold=20",
)
def study(
    action: Annotated[str, typer.Argument(help="init, run, analyse or power.")],
    target: Annotated[Path, typer.Argument(help="init, analyse: a folder; run, power: the design, TOML.")],
    folder: Annotated[Path | None, typer.Argument(help="run: folder of the results.")] = None,
    participant: Annotated[
        str | None,
        "run: label of the participant, letters and digits: required for a person; with --observer: sim.",
    ] = None,
    device: Annotated[str | None, "run: device that presents the intervals, as of play."] = None,
    wait: Annotated[
        str | None, "run: how long to wait until the device is ready, as of play; default: 30s."
    ] = None,
    observer: Annotated[
        str | None, "run, power: simulated observer, threshold=T,slope=B,lapse=L in the unit of the levels."
    ] = None,
    runs: Annotated[int | None, "power: simulated sessions for each number of trials; default: 100."] = None,
    plot: Annotated[Path | None, "analyse: PNG to draw: rates, fits and intervals."] = None,
) -> Answer:
    """Find out which differences people notice: forced choice between streams, settings or renderers."""
    require_one_of("action", action, _ACTIONS)
    given = {
        "FOLDER": folder, "--participant": participant, "--device": device, "--wait": wait,
        "--observer": observer, "--runs": runs, "--plot": plot,
    }  # fmt: skip
    _require_fitting(action, {name for name, value in given.items() if value is not None})
    if action == "init":
        return Answer(tasks.study.start_study(target).summary(), str(target))
    if action == "analyse":
        check_results((target / tasks.study.SESSION,), plot=plot)
        done = tasks.study.analyse_study(target, plot)
        tables = {"participants": "psychometric fits", "levels": "levels"}
        return Answer(done.summary(), str(target), done.notes, tables)
    if action == "power":
        if observer is None:
            raise InvalidArgument("--observer", "nothing", "the observer to simulate, threshold=20,slope=3")
        with progress("power") as report:
            done = tasks.study.study_power(target, observer, DEFAULT_RUNS if runs is None else runs, report)
        return Answer(
            done.summary(),
            str(target),
            done.notes,
            {"power": f"{DEFAULT_RUNS if runs is None else runs} simulated sessions each"},
        )
    if folder is None:
        raise InvalidArgument("FOLDER", "nothing", "the folder of the results, after the design")
    spec = tasks.study.SessionSpec(participant, device, observer, wait)
    done = tasks.study.run_session(target, folder, spec, _ask, lambda text: echo(text, to_stderr=True))
    return Answer(done.summary(), str(folder), done.notes)


_OPTIONS: Final[dict[str, set[str]]] = {
    "init": set(), "run": {"FOLDER", "--participant", "--device", "--wait", "--observer"},
    "analyse": {"--plot"}, "power": {"--observer", "--runs"},
}  # fmt: skip


def _require_fitting(action: str, given: set[str]) -> None:
    """InvalidArgument for an argument without effect in this action."""
    for name in sorted(given - _OPTIONS[action]):
        users = [other for other, names in _OPTIONS.items() if name in names]
        usable = f"{name} is only for study {' or '.join(users)}, not for study {action}"
        raise InvalidArgument(usable, hint="Take it out.")


def _ask(question: str, answers: int) -> int | None:
    """Ask at the terminal until a possible answer comes; None at the end of the input, or for q."""
    choices = {str(i): i for i in range(1, answers + 1)}
    while True:
        try:
            text: Any = input(f"{question}; q stops: ").strip().lower()
        except (EOFError, KeyboardInterrupt):
            return None
        if text in ("q", "quit"):
            return None
        if text in choices:
            return choices[text]
        echo(f"Please answer {', '.join(choices)} or q.", to_stderr=True)

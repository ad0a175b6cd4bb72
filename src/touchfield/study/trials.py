"""Trials as comma-separated text with a data dictionary, as BIDS has it for events: ``sub-LABEL_trials.csv``,
and ``trials.json``, which describes each column.

Each trial is written as soon as it is answered, so that a session that stops can be continued.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Iterator
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, Final

from touchfield.atomic import atomic_path
from touchfield.errors import InvalidArgument, SourceError
from touchfield.files import read_bytes

_MAX_BYTES: Final = 16 << 20
_LABEL: Final = re.compile(r"[A-Za-z0-9]{1,32}")


@dataclass(frozen=True)
class Trial:
    """One trial; the columns of the text."""

    trial: int
    time_utc: str
    level: float
    stimulus: str
    order: str
    response: int
    correct: int
    response_s: float
    design: str
    answered_by: str


DICTIONARY: Final[dict[str, dict[str, Any]]] = {
    "trial": {"Description": "Number of the trial, from 0"},
    "time_utc": {"Description": "When the answer was given, ISO 8601, UTC"},
    "level": {"Description": "Level of the difference; its unit is in session.json"},
    "stimulus": {"Description": "File name of the comparison"},
    "order": {"Description": "What each interval had", "Levels": {"0": "reference", "1": "comparison"}},
    "response": {"Description": "The interval that differs (2ifc: of the last two); abx: 1 is A, 2 is B"},
    "correct": {"Description": "Whether the answer is correct", "Levels": {"0": "no", "1": "yes"}},
    "response_s": {"Description": "From the end of the last interval to the answer", "Units": "s"},
    "design": {"Description": "First 16 digits of the SHA-256 of the design"},
    "answered_by": {"Description": "person: with the device; simulated: with the observer's numbers"},
}
"""The data dictionary: a description of each column."""


def trials_path(folder: Path, participant: str) -> Path:
    """The file of a participant; `InvalidArgument` unless the label is 1 to 32 letters and digits."""
    if not _LABEL.fullmatch(participant):
        raise InvalidArgument("participant", repr(participant), "1 to 32 letters and digits, such as 01")
    return folder / f"sub-{participant}_trials.csv"


def append_trial(path: Path, trial: Trial) -> None:
    """Append a trial to its file, with the heading if it is the first."""
    is_new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        if is_new:
            writer.writerow(field.name for field in fields(Trial))
        writer.writerow(_text(getattr(trial, field.name)) for field in fields(Trial))


def _text(value: object) -> str:
    return repr(value) if isinstance(value, float) else str(value)


def read_trials(path: str | Path) -> tuple[Trial, ...]:
    """Read the trials of a participant, in order.

    `SourceError` names the line that is wrong. A last line that was cut is an error, too, with the fix.
    """
    trials, is_cut = read_complete_trials(path)
    if is_cut:
        where, hint = f"{path}, line {len(trials) + 2}", "Delete the line to repeat its trial."
        raise SourceError(where, "a line that is cut", "a line with its end", hint)
    return trials


def read_complete_trials(path: str | Path) -> tuple[tuple[Trial, ...], bool]:
    """Read the trials of a participant without a last line that was cut, and tell whether there is one.

    A line that ends without a line feed is cut: its last column may be shorter than it was. `SourceError`
    names any other line that is wrong.
    """
    path = Path(path)
    data = read_bytes(path, _MAX_BYTES, "trials of one participant, comma-separated text")
    try:
        complete, line_feed, rest = data.rpartition(b"\n")
        lines = io.StringIO((complete + line_feed).decode(), newline="")
        return tuple(_rows(path, lines)), bool(rest)
    except (UnicodeDecodeError, csv.Error) as error:
        raise SourceError(str(path), f"no trials ({error})", "comma-separated text") from None


def _rows(path: Path, file: Any) -> Iterator[Trial]:
    reader, names = csv.reader(file), [field.name for field in fields(Trial)]
    kinds = {"int": int, "float": float, "str": str}
    if next(reader, None) != names:
        raise SourceError(f"{path}, line 1", "another heading", ",".join(names))
    for count, row in enumerate(reader):
        where, hint = f"{path}, line {count + 2}", "Delete the line to repeat its trial."
        if len(row) != len(names):
            raise SourceError(where, f"{len(row)} columns", f"{len(names)}", hint)
        try:
            trial = Trial(*(kinds[str(f.type)](text) for f, text in zip(fields(Trial), row, strict=True)))
        except ValueError:
            raise SourceError(where, ",".join(row)[:60], "numbers as the heading says", hint) from None
        if trial.trial != count or trial.correct not in (0, 1) or not 0 < trial.level < float("inf"):
            found = f"trial {trial.trial}, level {trial.level}, correct {trial.correct}"
            raise SourceError(where, found, f"trial {count}, a level above 0, correct 0 or 1", hint)
        yield trial


def write_dictionary(folder: Path) -> None:
    """Write the data dictionary ``trials.json``."""
    with atomic_path(folder / "trials.json") as temporary:
        temporary.write_text(json.dumps(DICTIONARY, indent=2) + "\n", "utf-8")

"""The design of a study: the reference, what is compared with it, task and procedure, as a TOML file.

    title = "Weber fraction of a room"
    task = "3ifc"             # 2ifc, 3ifc or abx
    procedure = "staircase"   # constant, staircase or questplus
    trials = 60
    seed = 1
    interval_s = 3.0
    reference = "fine.touch"

    [[comparison]]
    stream = "k10.touch"
    level = 0.1               # optional, for all or for none: without, the difference in force is measured

    [[comparison]]
    stream = "fine.touch"
    level = 0.2
    render = { friction = 0.5 }   # of the renderer, in this interval

A level grows with the difference. Tasks:

2ifc   the reference, then two intervals: which of them differs from it? Chance 1/2.
3ifc   three intervals, of which one differs from the others: which? Chance 1/3.
abx    reference and comparison as A and B in random order, then X: is X A or B? Chance 1/2.
"""

from __future__ import annotations

import hashlib
import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Final

import numpy as np

from touchfield.errors import InvalidArgument, SourceError, require_between, require_one_of, require_positive
from touchfield.files import read_bytes

TASKS: Final = {"2ifc": 1 / 2, "3ifc": 1 / 3, "abx": 1 / 2}
"""Chance level of each task."""

PROCEDURES: Final = ("constant", "staircase", "questplus")
MAX_TRIALS: Final = 10_000
MAX_COMPARISONS: Final = 64
_MAX_BYTES: Final = 1 << 20


@dataclass(frozen=True)
class Comparison:
    """What is compared with the reference: a stream, its level, and options of the renderer."""

    stream: str
    level: float | None = None
    render: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class StudyDesign:
    """A design, checked; `InvalidArgument` names the field that is wrong."""

    reference: str
    comparisons: tuple[Comparison, ...]
    task: str = "3ifc"
    procedure: str = "staircase"
    trials: int = 60
    seed: int = 0
    interval_s: float = 3.0
    unit: str = "1"  # of the levels; of measured ones "mN"
    title: str = "Untitled study"
    digest: str = ""  # of the file, so that a session is only continued with the same design

    def __post_init__(self) -> None:
        require_one_of("task", self.task, TASKS)
        require_one_of("procedure", self.procedure, PROCEDURES)
        require_between(1, MAX_TRIALS, trials=self.trials)
        require_between(0.1, 600, interval_s=self.interval_s)
        require_between(0, 2**32 - 1, seed=self.seed)
        if not 1 <= len(self.comparisons) <= MAX_COMPARISONS:
            raise InvalidArgument("comparison", f"{len(self.comparisons)} of them", f"1 to {MAX_COMPARISONS}")
        levels = [comparison.level for comparison in self.comparisons]
        if None in levels and any(level is not None for level in levels):
            raise InvalidArgument("comparison.level", "a level for some", "one for every comparison, or none")
        if None not in levels:
            _require_levels([level for level in levels if level is not None])

    @property
    def chance(self) -> float:
        """The rate of correct answers of an observer who notices nothing."""
        return TASKS[self.task]

    @property
    def is_measured(self) -> bool:
        """Whether the levels are to be measured, because the design gives none."""
        return self.comparisons[0].level is None

    @property
    def levels(self) -> tuple[float, ...]:
        """The level of each comparison; only of a design that gives them."""
        return tuple(float(c.level) for c in self.comparisons if c.level is not None)

    def order(self, trial: int) -> tuple[int, ...]:
        """What the intervals of a trial have, 0 the reference and 1 the comparison; the same in each call."""
        rng = np.random.default_rng([self.seed, trial, 0])
        if self.task == "3ifc":
            odd = int(rng.integers(3))
            return tuple(int(i == odd) for i in range(3))
        first = int(rng.integers(2))
        if self.task == "2ifc":
            return (0, first, 1 - first)
        return (first, 1 - first, int(rng.integers(2)))

    def answer(self, trial: int) -> int:
        """The correct answer, from 1.

        It is the interval that differs (2ifc: of the last two); abx: 1 is A, 2 is B.
        """
        order = self.order(trial)
        if self.task == "3ifc":
            return order.index(1) + 1
        return order[1:].index(1) + 1 if self.task == "2ifc" else order.index(order[2]) + 1

    @property
    def answers(self) -> int:
        """The number of possible answers."""
        return 3 if self.task == "3ifc" else 2


def _require_levels(levels: list[float]) -> None:
    require_positive(**{"comparison.level": min(levels, default=1.0)})
    if not np.isfinite(levels).all() or len(set(levels)) != len(levels):
        raise InvalidArgument("comparison.level", str(levels), "finite numbers that differ")


def for_participant(design: StudyDesign, participant: str) -> StudyDesign:
    """The design with a seed of its own for a participant, so that orders differ between participants."""
    digest = hashlib.sha256(f"{design.seed}/{participant}".encode()).digest()
    return replace(design, seed=int.from_bytes(digest[:4], "big"))


def with_levels(design: StudyDesign, levels: tuple[float, ...], unit: str) -> StudyDesign:
    """The design with measured levels, one for each comparison."""
    compared = tuple(replace(c, level=level) for c, level in zip(design.comparisons, levels, strict=True))
    return replace(design, comparisons=compared, unit=unit)


def read_design(path: str | Path) -> StudyDesign:
    """Read a design from TOML; paths of streams are relative to its folder.

    `SourceError` names the file and the field that is missing, unknown or wrong.
    """
    path = Path(path)
    try:
        data = read_bytes(path, _MAX_BYTES, "the design of a study, TOML")
        values = tomllib.loads(data.decode())
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise SourceError(str(path), f"no TOML ({error})", "the design of a study") from None
    try:
        return _design_of(values, path.parent, hashlib.sha256(data).hexdigest())
    except InvalidArgument as error:
        raise SourceError(f"{path}: {error.where}", error.found, error.expected, error.hint) from None


_KINDS: Final = {
    "title": str, "task": str, "procedure": str, "trials": int, "seed": int, "interval_s": (int, float),
    "unit": str, "reference": str, "comparison": list,
}  # fmt: skip
_COMPARISON_KINDS: Final = {"stream": str, "level": (int, float), "render": dict}


def _design_of(values: Mapping[str, Any], folder: Path, digest: str) -> StudyDesign:
    _require_fields("", values, _KINDS, ("reference", "comparison"))
    compared = []
    for i, entry in enumerate(values["comparison"], 1):
        if not isinstance(entry, dict):
            raise InvalidArgument(f"comparison {i}", repr(entry), "a table, [[comparison]]")
        _require_fields(f"comparison {i}.", entry, _COMPARISON_KINDS, ("stream",))
        level = None if "level" not in entry else float(entry["level"])
        compared.append(Comparison(str(folder / entry["stream"]), level, entry.get("render", {})))
    options = {key: value for key, value in values.items() if key not in ("reference", "comparison")}
    return StudyDesign(str(folder / values["reference"]), tuple(compared), digest=digest, **options)


def _require_fields(
    where: str, values: Mapping[str, Any], kinds: Mapping[str, Any], required: tuple[str, ...]
) -> None:
    for name, value in values.items():
        if name not in kinds:
            raise InvalidArgument(where + name, "an unknown field", f"one of {', '.join(kinds)}")
        if not isinstance(value, kinds[name]) or isinstance(value, bool):
            expected = {str: "text", int: "a whole number", list: "tables [[comparison]]", dict: "a table"}
            raise InvalidArgument(where + name, repr(value)[:60], expected.get(kinds[name], "a number"))
    for name in required:
        if name not in values:
            raise InvalidArgument(where + name, "nothing", "it in the design")

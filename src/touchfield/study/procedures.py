"""Procedures: which level a trial has, given the answers so far.

constant    every level equally often, in random order;
staircase   three correct answers in a row lower the level by one, a wrong one raises it (Levitt 1971: it
            settles at 79.4 % correct); starts at the highest level;
questplus   the level that is expected to tell most about threshold and slope, by the library questplus
            (QUEST+, Watson 2017; extra `study`; its licence is GPL 3).

A procedure has no state besides its answers: a session is continued by giving it the earlier answers again.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from typing import Any, Final

import numpy as np

from touchfield.errors import import_extra
from touchfield.study.design import StudyDesign

CORRECT_TO_LOWER: Final = 3


class Procedure(ABC):
    """Chooses the level of each trial, as an index of the ascending levels."""

    @abstractmethod
    def next_index(self) -> int:
        """Index of the level of the next trial."""

    @abstractmethod
    def update(self, index: int, is_correct: bool) -> None:
        """Take the answer to a trial at the level with this index."""


class ConstantStimuli(Procedure):
    """Blocks of all levels, each in random order."""

    def __init__(self, level_count: int, seed: int) -> None:
        self._count, self._seed, self._trial = level_count, seed, 0

    def next_index(self) -> int:
        block, place = divmod(self._trial, self._count)
        return int(np.random.default_rng([self._seed, block, 2]).permutation(self._count)[place])

    def update(self, index: int, is_correct: bool) -> None:
        self._trial += 1


class Staircase(Procedure):
    """Three down, one up, from the highest level."""

    def __init__(self, level_count: int) -> None:
        self._top = level_count - 1
        self._index, self._correct = self._top, 0

    def next_index(self) -> int:
        return self._index

    def update(self, index: int, is_correct: bool) -> None:
        self._correct = self._correct + 1 if is_correct else 0
        if not is_correct:
            self._index = min(index + 1, self._top)
        elif self._correct == CORRECT_TO_LOWER:
            self._index, self._correct = max(index - 1, 0), 0


class QuestPlusProcedure(Procedure):
    """QUEST+ over threshold, slope and lapse; the prior is flat."""

    def __init__(self, levels: Sequence[float], chance: float) -> None:
        library = import_extra("questplus", "procedure questplus", "questplus", "study")
        self._logs = np.log10(levels)
        span = max(float(np.ptp(self._logs)), 0.3)
        thresholds = np.linspace(self._logs[0] - span / 4, self._logs[-1] + span / 4, 41)
        self._quest: Any = library.QuestPlus(
            stim_domain={"intensity": self._logs},
            param_domain={
                "threshold": thresholds, "slope": np.geomspace(0.7, 10, 8), "lower_asymptote": [chance],
                "lapse_rate": [0.0, 0.03],
            },
            outcome_domain={"response": ["correct", "wrong"]},
            func="weibull",
            stim_scale="log10",
        )  # fmt: skip

    def next_index(self) -> int:
        return int(np.abs(self._logs - self._quest.next_stim["intensity"]).argmin())

    def update(self, index: int, is_correct: bool) -> None:
        outcome = {"response": "correct" if is_correct else "wrong"}
        self._quest.update(stim={"intensity": self._logs[index]}, outcome=outcome)


def procedure_of(design: StudyDesign) -> Procedure:
    """The procedure of a design with levels, before its first trial.

    `MissingExtra` for "questplus" without that library.
    """
    levels = sorted(design.levels)
    if design.procedure == "constant":
        return ConstantStimuli(len(levels), design.seed)
    if design.procedure == "staircase":
        return Staircase(len(levels))
    return QuestPlusProcedure(levels, design.chance)

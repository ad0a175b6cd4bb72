"""The rows of command `guide`: a CSV file, and a picture."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Final, TextIO

import numpy as np

from touchfield.atomic import atomic_path
from touchfield.errors import SourceError
from touchfield.guidance.directions import DIRECTIONS
from touchfield.guidance.spec import GuideSpec
from touchfield.tasks.guide_output import Shown

MAX_ROWS: Final = 1 << 20
"""Rows of a log: nine hours."""


def columns(shape: tuple[int, int, int]) -> tuple[str, ...]:
    """Return the columns of a log for an array [panels, rows, columns].

    Seconds, frame (-1 before the first), reason of the warning or empty; for each direction its state
    (unknown, free, near), distance and time to contact; distances of step and drop; height of the camera
    above the ground, empty if it is assumed; and the drives, 0 to 1.
    """
    names = [name.replace(" ", "_") for name in DIRECTIONS]
    drives = [f"drive_{p}_{r}_{c}" for p in range(shape[0]) for r in range(shape[1]) for c in range(shape[2])]
    return (
        "t_s", "frame", "warning", *(f"{n}_state" for n in names), *(f"{n}_m" for n in names),
        *(f"{n}_contact_s" for n in names), "step_m", "drop_m", "camera_height_m", *drives,
    )  # fmt: skip


class GuideLog:
    """Writes rows to a file, at most `MAX_ROWS`; `notes` say how many are left out."""

    def __init__(self, file: TextIO, shape: tuple[int, int, int]) -> None:
        self._rows, self._count = csv.writer(file, lineterminator="\n"), 0
        self._rows.writerow(columns(shape))

    def add(self, time_s: float, shown: Shown) -> None:
        """Write a row."""
        self._count += 1
        if self._count <= MAX_ROWS:
            self._rows.writerow(_row(time_s, shown))

    @property
    def notes(self) -> tuple[str, ...]:
        """A note if rows were not written."""
        left_out = self._count - MAX_ROWS
        return (f"{left_out} rows after the first {MAX_ROWS} are not in the log.",) if left_out > 0 else ()


@contextmanager
def open_log(path: Path, shape: tuple[int, int, int]) -> Iterator[GuideLog]:
    """Yield a log; the file appears when the block ends."""
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="") as file:
        yield GuideLog(file, shape)


def _row(time_s: float, shown: Shown) -> list[object]:
    """Return a row of the log."""
    situation = shown.situation
    if situation is None:
        values: list[object] = [""] * 27
    else:
        numbers = (*situation.distances_m.tolist(), *situation.contact_s.tolist(), *situation.ahead)
        height = f"{situation.ground.height_m:.3f}" if situation.ground.is_seen else ""
        values = [state.name.lower() for state in situation.states]
        values += [f"{v:.3f}" if math.isfinite(v) else "" for v in numbers]
        values.append(height)
    drives = [f"{value:.2f}" for value in shown.drives.reshape(-1).tolist()]
    return [f"{time_s:.4f}", shown.frame, shown.warning, *values, *drives]


class Rows:
    """What was shown, for a picture: the first `MAX_DRAWN` rows."""

    MAX_DRAWN: Final = 1 << 15

    def __init__(self) -> None:
        self._rows: list[tuple[float, Shown]] = []

    def add(self, time_s: float, shown: Shown) -> None:
        """Add a row."""
        if len(self._rows) < self.MAX_DRAWN:
            self._rows.append((time_s, shown))

    def draw(self, path: Path, title: str, spec: GuideSpec) -> None:
        """Draw the rows; raises `SourceError` if there is none."""
        from touchfield.viewer.guidance import GuidanceRows, draw_guidance

        rows = [(time_s, shown, shown.situation) for time_s, shown in self._rows]
        known = [(time_s, shown, s) for time_s, shown, s in rows if s is not None]
        if not known:
            raise SourceError(str(path), "nothing to draw: no frame was evaluated", "frames")
        drawn = GuidanceRows(
            np.array([time_s for time_s, _, _ in known]),
            np.array([s.states for _, _, s in known], np.int64),
            np.array([s.distances_m for _, _, s in known]),
            np.array([s.ahead for _, _, s in known], np.float64),
            np.array([bool(shown.warning) for _, shown, _ in known], np.float64),
        )
        draw_guidance(path, drawn, DIRECTIONS, spec.warn_m, title)

"""Devices that write each call into a file, for tests in which the process of the device dies."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass
from pathlib import Path

from player_makers import RestingDevice

from touchfield.errors import DeviceError


class Recorded(RestingDevice):
    """Writes each opening, force and closing into a file, with time and process."""

    refusals = 0

    def __init__(self, path: Path) -> None:
        super().__init__()
        self._path = path

    def open(self) -> None:
        refused = sum(row.what == "refused" for row in records(self._path))
        if records(self._path) and refused < self.refusals:
            self._record("refused")
            raise DeviceError("fake device", "it is in use", "a free one")
        super().open()
        self._record("open")

    def put_force_n(self, x: float, y: float, z: float) -> None:
        self._record("force", x, y, z)
        super().put_force_n(x, y, z)

    def close(self) -> None:
        if self.is_open:
            self._record("close")
        super().close()

    def _record(self, what: str, *force_n: float) -> None:
        with open(self._path, "a") as file:
            file.write(" ".join(map(str, (time.perf_counter_ns(), os.getpid(), what, *force_n))) + "\n")


class Lasting(Recorded):
    """Has the force of a dead process when it is opened again."""

    has_force_at_open = True


class BusyAtFirst(Lasting):
    """Is released late by the dead process."""

    refusals = 5


class BusyForEver(Lasting):
    """Cannot be opened twice."""

    refusals = 10**9


@dataclass(frozen=True)
class Record:
    """One call of a `Recorded` device."""

    time_ns: int
    pid: int
    what: str
    force_n: tuple[float, ...]


def records(path: Path) -> list[Record]:
    """All calls so far, in order."""
    lines = [line.split() for line in path.read_text().splitlines()] if path.exists() else []
    return [Record(int(row[0]), int(row[1]), row[2], tuple(map(float, row[3:]))) for row in lines]

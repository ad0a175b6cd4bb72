"""`Trace`: the positions of a hand or probe over time, and the text file (comma-separated) that stores them.

There is no standard format, so the file is comma-separated text. Its first line names the columns, with
units, in any order; other columns are ignored::

    t_s,x_m,y_m,z_m,force_n
    0.000,0.0112,-0.0340,0.0051,0.42
    0.001,0.0113,-0.0341,0.0051,0.44

A recorded contact also has the force on the probe: ``fx_n``, ``force_x_n`` or ``field_x_n`` and so on, in N
or mN; if there are several, as in the log of a playback, ``field_...`` is used. Columns ``qw,qx,qy,qz``, all
four or none, are the orientation of the probe: a quaternion, normalised when read. ``x_mm``, ``x [mm]`` and
``x (mm)`` mean the same, as do ``t_s`` and ``time_s``; lengths in m, cm, mm or um, time in s, ms, us or ns.
Time may be left out. Semicolons or tabs may separate columns instead of commas; empty lines, and lines that
begin with ``#``, are skipped.
"""

from __future__ import annotations

import itertools
import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple, TextIO

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import EqualByValue, Float64s, Int64s
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.files import readable, require_plain
from touchfield.medium.field import frozen, numbers_of

Lines = Iterator[tuple[int, str]]

HAPTIC_RATE_HZ: Final = 1000.0  # usual rate of a haptic loop (paper section 4), and of a trace without times
MAX_SAMPLES: Final = 1 << 24  # of one file: 4.6 hours at 1 kHz, 512 MiB in memory
_MAX_LINE: Final = 1 << 16
_LINES_AT_ONCE: Final = 1 << 16
_FORCES: Final = ("fx", "fy", "fz")
_TURN: Final = ("qw", "qx", "qy", "qz")
_UNITS: Final = {
    "t": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    **{axis: {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6} for axis in "xyz"},
    **{axis: {"n": 1.0, "mn": 1e-3} for axis in _FORCES},
    **{part: {"": 1.0} for part in _TURN},
}
_COLUMN: Final = re.compile(r"(time|[txyz])(?:[_ \[(]+(s|ms|us|µs|ns|m|cm|mm|um|µm)[ \])]*)?")
_FORCE: Final = re.compile(r"(f|force|field)_?([xyz])(?:[_ \[(]+(m?n)[ \])]*)?")


@dataclass(frozen=True, eq=False)
class Trace(EqualByValue):
    """A probe's path over time, in the axes of the field.

    times_s : float64 [n]; seconds, not decreasing; 0 is the start of the medium.
    positions_m : float64 [n, 3]
    quaternions : float64 [n, 4] or None; orientation of the probe, unit quaternions (w, x, y, z); None if it
        is not rotated.
    Raises `InvalidArgument` if there is no sample, shapes differ, a number is out of range, or time
    decreases.
    """

    times_s: Float64s
    positions_m: Float64s
    quaternions: Float64s | None = None

    def __post_init__(self) -> None:
        t, p = (numbers_of(n, getattr(self, n)).copy() for n in ("times_s", "positions_m"))
        if p.ndim != 2 or p.shape[1] != 3 or not len(p):
            raise InvalidArgument("positions_m", f"shape {p.shape}", "[n, 3] with n at least 1")
        if t.shape != (len(p),):
            raise InvalidArgument("times_s", f"shape {t.shape}", f"({len(p)},), one time for each position")
        for where, values in (("times_s", t), ("positions_m", p)):
            wrong = np.argwhere(~np.isfinite(values))
            if len(wrong):
                raise InvalidArgument(
                    where, f"{values[tuple(wrong[0])]} at sample {wrong[0][0]}", "finite numbers"
                )
        fall = np.flatnonzero(t[1:] < t[:-1])
        if len(fall):
            n = int(fall[0])
            expected = "times that never fall"
            raise InvalidArgument("times_s", f"{t[n + 1]} s after {t[n]} s at sample {n + 1}", expected)
        if self.quaternions is not None:
            q = numbers_of("quaternions", self.quaternions).copy()
            if q.shape != (len(p), 4) or not (np.abs(np.linalg.norm(q, axis=1) - 1) < 1e-6).all():
                raise InvalidArgument("quaternions", f"shape {q.shape}", f"({len(p)}, 4), each of length 1")
            object.__setattr__(self, "quaternions", frozen(q))
        object.__setattr__(self, "times_s", frozen(t))
        object.__setattr__(self, "positions_m", frozen(p))

    @classmethod
    def regular(cls, positions_m: ArrayLike, rate_hz: float = HAPTIC_RATE_HZ) -> Trace:
        """Make a trace of positions [n, 3], metres, at a constant rate from 0 s on."""
        p = np.asarray(positions_m, np.float64)
        require_positive(rate_hz=rate_hz)
        return cls(np.arange(len(p)) / rate_hz, p)

    def __len__(self) -> int:
        return len(self.times_s)


class ContactTrace(NamedTuple):
    """Positions of a probe and the forces on it, float64 [n, 3] each."""

    positions_m: Float64s
    forces_n: Float64s


class _Columns(NamedTuple):
    """Column indices of t, x, y, z (and forces), and their unit factors; no t if the file has no time."""

    delimiter: str
    columns: tuple[int, ...]
    factors: tuple[float, ...]
    names: tuple[str, ...]


def read_trace(path: Path | str, rate_hz: float = HAPTIC_RATE_HZ) -> Trace:
    """Read a trace of the form above.

    rate_hz : float; samples per second of a file without a time column.
    Raises `SourceError` if the file cannot be read, a column or a unit is missing, a line contains anything
    but finite numbers or goes back in time, or there is no sample or more than 2^24. The error names the
    line.
    """
    where = Path(path)
    require_positive(rate_hz=rate_hz)
    rows, numbers, columns = _table(where, ())
    positions = rows[:, -3:] * columns.factors[-3:]
    quaternions = None
    if "qw" in columns.names:
        quaternions = rows[:, -7:-3]
        lengths = np.linalg.norm(quaternions, axis=1, keepdims=True)
        wrong = np.flatnonzero(~(np.abs(lengths[:, 0] - 1) < 0.1))
        if len(wrong):
            found = f"a quaternion of length {lengths[wrong[0], 0]:g}"
            raise SourceError(f"{where} line {numbers[wrong[0]]}", found, "one of length 1")
        quaternions = quaternions / lengths
    if "t" not in columns.names:
        return Trace(np.arange(len(positions)) / rate_hz, positions, quaternions)
    times = rows[:, 0] * columns.factors[0]
    fall = np.flatnonzero(times[1:] < times[:-1])
    if len(fall):
        n = int(fall[0])
        found = f"{times[n + 1]} s after {times[n]} s"
        raise SourceError(
            f"{where} line {numbers[n + 1]}", found, "times that never fall", "Sort the lines by time."
        )
    return Trace(times, positions, quaternions)


def read_contacts(path: Path | str) -> ContactTrace:
    """Read positions and forces of a trace of the form above; times are ignored.

    Raises `SourceError` as `read_trace` does, or if a column of force is missing.
    """
    rows, _, columns = _table(Path(path), _FORCES)
    values = rows * columns.factors
    return ContactTrace(values[:, -6:-3], values[:, -3:])


def has_forces(path: Path) -> bool:
    """Return True if the first line of a file names columns of positions and forces."""
    try:
        with path.open(encoding="utf-8-sig", errors="replace", newline=None) as file:
            _columns(next(_lines(file, str(path)), None), str(path), _FORCES)
    except (OSError, SourceError):
        return False
    return True


def _table(where: Path, forces: tuple[str, ...]) -> tuple[Float64s, Int64s, _Columns]:
    """Return the required columns, the line number of each row, and their description."""
    require_plain(where, "a trace file")
    with (
        readable(where, "a trace file"),
        where.open(encoding="utf-8-sig", errors="replace", newline=None) as file,
    ):
        lines = _lines(file, str(where))
        columns = _columns(next(lines, None), str(where), forces)
        parts, numbers = [], []
        while chunk := list(itertools.islice(lines, _LINES_AT_ONCE)):
            parts.append(_numbers(chunk, columns, str(where)))
            numbers += [number for number, _ in chunk]
            if len(numbers) > MAX_SAMPLES:
                found, expected = f"more than {MAX_SAMPLES} samples", f"at most {MAX_SAMPLES}"
                raise SourceError(str(where), found, expected, "Cut it in parts.")
    if not parts:
        raise SourceError(str(where), "a header and no sample", "at least one line of numbers")
    return np.concatenate(parts), np.array(numbers), columns


def _lines(file: TextIO, where: str) -> Lines:
    """Yield the lines that are neither empty nor comments, with their numbers; the length is limited."""
    for number in itertools.count(1):
        line = file.readline(_MAX_LINE)
        if not line:
            return
        if len(line) == _MAX_LINE and not line.endswith("\n"):
            raise SourceError(
                f"{where} line {number}", "a line without end", f"lines below {_MAX_LINE} characters"
            )
        text = line.strip()
        if text and not text.startswith("#"):
            yield number, text


def _columns(header: tuple[int, str] | None, where: str, forces: tuple[str, ...] = ()) -> _Columns:
    if header is None:
        expected = "a line of column names, such as t_s,x_m,y_m,z_m, and numbers below"
        raise SourceError(where, "an empty file", expected)
    number, text = header
    location = f"{where} line {number}"
    delimiter = max(",;\t", key=text.count)
    columns: dict[str, tuple[int, float]] = {}
    fields: dict[str, tuple[int, float]] = {}
    for column, name in enumerate(text.split(delimiter)):
        plain = name.strip().strip("\"'").strip().lower()
        force, match = _FORCE.fullmatch(plain) if forces else None, _COLUMN.fullmatch(plain)
        target = fields if force and force[1] == "field" else columns
        if force:
            axis, unit = "f" + force[2], force[3] or ""
        elif plain in _TURN and plain not in columns:
            axis, unit = plain, ""
        elif match:
            axis, unit = match[1][0], (match[2] or "").replace("µ", "u")
        elif plain.startswith("time"):
            axis, unit = "t", ""
        else:  # an unrelated column
            continue
        if unit not in _UNITS[axis]:
            raise SourceError(
                location, f"column {name.strip()!r}", f"{axis}_ and one of {', '.join(_UNITS[axis])}"
            )
        if axis in target:
            raise SourceError(location, f"two columns for {axis}", "one")
        target[axis] = (column, _UNITS[axis][unit])
    columns |= fields
    missing = [axis for axis in ("x", "y", "z", *forces) if axis not in columns]
    if missing:
        excerpt = text if len(text) <= 80 else f"{text[:80]} ..."
        example = ",".join(["t_s,x_m,y_m,z_m", *(f"{axis}_n" for axis in forces)])
        raise SourceError(
            location, f"no column for {', '.join(missing)} in {excerpt!r}", f"a header such as {example}"
        )
    turn = [name for name in _TURN if name in columns]
    if 0 < len(turn) < len(_TURN):
        raise SourceError(location, f"{', '.join(turn)} alone", f"all of {', '.join(_TURN)}, or none")
    names = tuple(axis for axis in ("t", *_TURN, "x", "y", "z", *forces) if axis in columns)
    column_indices, factors = zip(*(columns[axis] for axis in names), strict=True)
    return _Columns(delimiter, column_indices, factors, names)


def _numbers(chunk: list[tuple[int, str]], columns: _Columns, where: str) -> Float64s:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)
            texts, column_indices = [text for _, text in chunk], columns.columns
            rows = np.loadtxt(
                texts,
                delimiter=columns.delimiter,
                usecols=column_indices,
                comments=None,
                quotechar='"',
                ndmin=2,
            )
    except ValueError:
        rows = None
    if rows is None or len(rows) != len(chunk) or not np.isfinite(rows).all():
        raise _fault(chunk, columns, where)
    return rows


def _fault(chunk: list[tuple[int, str]], columns: _Columns, where: str) -> SourceError:
    """Return the error for the first invalid line of a chunk."""
    for number, text in chunk:
        location, cells = f"{where} line {number}", text.split(columns.delimiter)
        if len(cells) <= max(columns.columns):
            expected = f"at least {max(columns.columns) + 1}, as the header has"
            mend = "Copy the file again, or complete the line."
            return SourceError(location, f"{len(cells)} columns", expected, mend)
        for name, column in zip(columns.names, columns.columns, strict=True):
            cell = cells[column].strip().strip('"')
            try:
                finite = np.isfinite(float(cell)) and "_" not in cell
            except ValueError:
                finite = False
            if not finite:
                return SourceError(f"{location}, column {name}", repr(cell[:40]), "a finite number")
    last = chunk[-1][0]
    return SourceError(
        f"{where} lines {chunk[0][0]} to {last}", "something that is no table", "rows of numbers"
    )

"""Reads accelerations as public sets of textures store them, and knows speed and force where a file name
states them.

Cluster Haptic Texture Dataset: ``accel/TEXTURE_DIRECTION_SPEED_FORCE_REPEAT.csv`` with time,X,Y,Z in seconds
and g; speed in mm/s, force in mN. LMT Haptic Texture Database: ``Accel/*.txt`` and ``AccelScansDFT321/*.txt``
with one number on each line, 10 kHz, without a unit. `touchfield data show NAME` has the sources.
"""

from __future__ import annotations

import io
import re
import shlex
import warnings
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import SourceError
from touchfield.files import read_bytes
from touchfield.sources.recordings.penn_hatt import is_texture_models
from touchfield.sources.recordings.recording import STANDARD_GRAVITY_M_S2, Recording, read_recording

CLUSTER_NAME: Final = re.compile(r"(\d{1,6})_(\d{1,3})_(\d{1,4})_(\d{1,5})_(\d{1,4})\.csv")
LMT_FOLDERS: Final = ("Accel", "AccelScansDFT321")
LMT_RATE_HZ: Final = 10_000.0
_MAX_BYTES: Final = 1 << 26
_MIN_ROWS: Final = 2


class ClusterName(NamedTuple):
    """What the name of a recording of the Cluster dataset states."""

    texture: int
    direction_deg: int
    speed_m_s: float
    force_n: float
    repeat: int


class TextureRecording(NamedTuple):
    """A recording, and the speed and force that its file name states, if any."""

    recording: Recording
    speed_m_s: float | None
    force_n: float | None
    notes: tuple[str, ...]


def cluster_name(path: Path) -> ClusterName | None:
    """Return what a file name of the Cluster dataset states; None for another name."""
    match = CLUSTER_NAME.fullmatch(path.name)
    if match is None:
        return None
    texture, direction, speed, force, repeat = map(int, match.groups())
    return ClusterName(texture, direction, 1e-3 * speed, 1e-3 * force, repeat)


def read_texture_recording(path: Path, full_scale_m_s2: float = STANDARD_GRAVITY_M_S2) -> TextureRecording:
    """Read a recording of a known set, or one of the forms of `read_recording`.

    full_scale_m_s2 : float; acceleration of a full-scale sample of a ``.wav``, and of 1.0 of the LMT set.
    Raises `SourceError` as `read_recording`.
    """
    name = cluster_name(path) if folder_name(path) == "accel" else None
    if name is not None:
        rate_hz, values = _evenly_timed(path, read_columns(path, ("time", "X", "Y", "Z")))
        recording = Recording(rate_hz, STANDARD_GRAVITY_M_S2 * (values - values.mean(axis=0)))
        note = f"{path.name}: unevenly timed; resampled to {rate_hz:.0f} Hz, without its mean (gravity)."
        return TextureRecording(recording, name.speed_m_s, name.force_n, (note,))
    if path.suffix.lower() == ".txt" and folder_name(path) in LMT_FOLDERS:
        column = _numbers(path, read_bytes(path, _MAX_BYTES, "one number on each line"), 0, 1)
        values = np.zeros((len(column), 3))
        values[:, 0] = full_scale_m_s2 * column[:, 0]
        scale = f"{full_scale_m_s2:g} m/s^2 for 1.0 (--full-scale-m-s2)"
        note = f"{path.name}: taken as 10 kHz, and {scale}: the set states no unit."
        return TextureRecording(Recording(LMT_RATE_HZ, values), None, None, (note,))
    return TextureRecording(read_recording(path, full_scale_m_s2), None, None, ())


def read_columns(path: Path, names: tuple[str, ...]) -> Float64s:
    """Read comma-separated text whose first line is exactly `names`, float64 [n, columns].

    Raises `SourceError`, which names line or row, if the first line differs, a number is missing or not
    finite, times (the first column) fall, or there are fewer than two rows.
    """
    data = read_bytes(path, _MAX_BYTES, f"text with the columns {','.join(names)}")
    head = data.split(b"\n", 1)[0].decode("utf-8-sig", "replace").strip()
    if [name.strip() for name in head.split(",")] != list(names):
        raise SourceError(f"{path} line 1", repr(head[:60]), ",".join(names))
    rows = _numbers(path, data, 1, len(names))
    falls = np.flatnonzero(np.diff(rows[:, 0]) < 0)
    if len(falls):
        row = int(falls[0]) + 1
        found = f"{rows[row, 0]:g} s after {rows[row - 1, 0]:g} s"
        raise SourceError(f"{path} row {row + 1}", found, "times that never fall")
    return rows


def _numbers(path: Path, data: bytes, skipped: int, columns: int) -> Float64s:
    expected = f"{columns} number{'s' * (columns > 1)} on each line"
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # of no rows, which is an error below
            text = io.StringIO(data.decode("utf-8-sig"))
            rows: Float64s = np.loadtxt(text, delimiter=",", skiprows=skipped, ndmin=2)
    except (ValueError, UnicodeDecodeError) as error:
        raise SourceError(str(path), f"no table ({str(error)[:100]})", expected) from error
    if len(rows) < _MIN_ROWS or rows.shape[1] != columns:
        raise SourceError(
            str(path), f"{rows.shape[0]} rows of {rows.shape[1]}", f"{expected}, {_MIN_ROWS} rows or more"
        )
    wrong = np.flatnonzero(~np.isfinite(rows).all(axis=1))
    if len(wrong):
        raise SourceError(f"{path} row {wrong[0] + 1}", "a number that is not finite", "finite numbers")
    return rows


def _evenly_timed(path: Path, rows: Float64s) -> tuple[float, Float64s]:
    """Return the mean rate and the columns after the time, interpolated at even times."""
    times_s = rows[:, 0]
    length_s = float(times_s[-1] - times_s[0])
    if not length_s > 0:
        raise SourceError(str(path), "times that are all equal", "seconds that rise")
    even_s = np.linspace(times_s[0], times_s[-1], len(rows))
    values = np.stack([np.interp(even_s, times_s, column) for column in rows[:, 1:].T], axis=1)
    return (len(rows) - 1) / length_s, values


def texture_only(path: Path) -> SourceError | None:
    """Return the error for texture models and accelerations, of which no field can be made; else None."""
    found = _texture_files(path)
    if found is None:
        return None
    what, files = found
    fix = f"Make a material: touchfield texture {files} -o NAME.json"
    return SourceError(str(path), f"{what}, without positions", "forces at positions", fix)


def _texture_files(path: Path) -> tuple[str, str] | None:
    """Return what a path of textures is, and the files to name; None if it is none."""
    if path.is_file():
        if is_texture_models(path):
            return "texture models of the Penn Haptic Texture Toolkit", shlex.quote(path.name)
        is_acceleration = folder_name(path) == "accel" and cluster_name(path)
        return ("an acceleration of the Cluster dataset", shlex.quote(path.name)) if is_acceleration else None
    for folder in (path, path / "Training", path / "Testing"):
        if any(_has(folder / name, "*.txt") for name in LMT_FOLDERS):
            return "accelerations of the LMT Haptic Texture Database", "Accel/NAME.txt"
    if any(is_texture_models(file) for file in sorted(path.glob("Models_*.xml"))[:1]):
        return "texture models of the Penn Haptic Texture Toolkit", "Models_MATERIAL.xml"
    if path.name == "accel" and any(cluster_name(file) for file in path.glob("*.csv")):
        return "accelerations of the Cluster dataset", "accel/NAME.csv"
    return None


def _has(folder: Path, pattern: str) -> bool:
    return next(folder.glob(pattern), None) is not None


def folder_name(path: Path) -> str:
    """Return the name of a file's folder, also if the path does not name it."""
    return path.absolute().parent.name

"""Reads accelerations of a tool that slid along a surface, from ``.wav`` or comma-separated text. `touchfield
texture` makes materials of them.

Text names its columns in its first line: ``t_s``, evenly spaced, and one axis, ``a_m_s2``, or three,
``ax_m_s2,ay_m_s2,az_m_s2``. Other columns are ignored. Sound has one to three channels
and no unit: the caller gives its full scale.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from io import BytesIO
from pathlib import Path
from typing import Final

import numpy as np

from touchfield.arrays import Float64s
from touchfield.errors import InvalidArgument, SourceError, require_positive
from touchfield.files import library_faults, read_bytes
from touchfield.medium.field import frozen
from touchfield.sources.poses import read_text, split_lines

STANDARD_GRAVITY_M_S2: Final = 9.80665
_COLUMNS: Final = (("t_s", "a_m_s2"), ("t_s", "ax_m_s2", "ay_m_s2", "az_m_s2"))
_EXAMPLE: Final = "a first line such as t_s,ax_m_s2,ay_m_s2,az_m_s2 or t_s,a_m_s2"
_UNEVEN: Final = 0.05
_MAX_BYTES: Final = 1 << 28


@dataclass(frozen=True)
class Recording:
    """Accelerations over time.

    rate_hz : float; samples a second, positive.
    acceleration_m_s2 : float64 [n, 3]; for a recording of one axis the other two are zero.
    Raises `InvalidArgument` if the shape differs, there is no sample, or a number is not finite.
    """

    rate_hz: float
    acceleration_m_s2: Float64s

    def __post_init__(self) -> None:
        require_positive(rate_hz=self.rate_hz)
        a = np.array(self.acceleration_m_s2, np.float64)
        if a.ndim != 2 or a.shape[1] != 3 or not len(a):
            raise InvalidArgument("acceleration_m_s2", f"shape {a.shape}", "[n, 3], n at least 1")
        wrong = np.argwhere(~np.isfinite(a))
        if len(wrong):
            found = f"{a[tuple(wrong[0])]} at sample {wrong[0][0]}"
            raise InvalidArgument("acceleration_m_s2", found, "finite numbers")
        object.__setattr__(self, "acceleration_m_s2", frozen(a))


def read_recording(path: str | Path, full_scale_m_s2: float = STANDARD_GRAVITY_M_S2) -> Recording:
    """Read a recording of the form above, recognised by its name.

    full_scale_m_s2 : float; acceleration of a full-scale sample (1.0, or the largest integer) of a ``.wav``.
    Raises `SourceError`, which names the line, if the file cannot be read or has another content, a number is
    not finite, or its times are not evenly spaced.
    """
    where = Path(path)
    require_positive(full_scale_m_s2=full_scale_m_s2)
    kind = where.suffix.lower()
    if kind not in (".wav", ".csv", ".txt"):
        raise SourceError(
            str(where), f"a name that ends in {kind!r}", ".wav or .csv", "Export it as one of these."
        )
    rate_hz, samples = _read_wav(where) if kind == ".wav" else _read_csv(where)
    acceleration = np.zeros((len(samples), 3))
    acceleration[:, : samples.shape[1]] = samples * (full_scale_m_s2 if kind == ".wav" else 1.0)
    return Recording(rate_hz, acceleration)


def _read_wav(where: Path) -> tuple[float, Float64s]:
    from scipy.io import wavfile

    data = read_bytes(where, _MAX_BYTES, "a .wav file of some seconds")
    with library_faults(where, "what is no sound", "a .wav file of PCM or float"), warnings.catch_warnings():
        warnings.simplefilter("ignore", wavfile.WavFileWarning)
        rate_hz, stored = wavfile.read(BytesIO(data))  # of bytes, so that a stated size allocates nothing
    channels = stored.shape[1] if stored.ndim == 2 else 1
    if not (stored.size and 1 <= channels <= 3 and rate_hz > 0):
        found = f"{channels} channels of {len(stored)} samples at {rate_hz} Hz"
        raise SourceError(str(where), found, "1 to 3 channels of samples, the axes")
    samples = stored.reshape(len(stored), channels).astype(np.float64)
    if stored.dtype == np.uint8:
        samples = (samples - 128) / 128
    elif stored.dtype.kind == "i":
        samples = samples / -float(np.iinfo(stored.dtype).min)
    if not np.isfinite(samples).all():
        sample = np.flatnonzero(~np.isfinite(samples).all(axis=1))[0]
        raise SourceError(f"{where} sample {sample}", "a number that is not finite", "finite numbers")
    return float(rate_hz), samples


def _read_csv(where: Path) -> tuple[float, Float64s]:
    lines = split_lines(read_text(where), str(where), ",")
    if len(lines) < 3:
        raise SourceError(str(where), f"{len(lines)} lines", f"{_EXAMPLE}, and two samples or more")
    head, names = lines[0][0], [name.lower() for name in lines[0][1]]
    matching = [columns for columns in _COLUMNS if set(columns) <= set(names)]
    if len(matching) != 1:
        raise SourceError(head, repr(",".join(names)[:80]), _EXAMPLE, "Name the columns so.")
    indices = [names.index(name) for name in matching[0]]
    rows = np.zeros((len(lines) - 1, len(indices)))
    for row, (line, cells) in zip(rows, lines[1:]):
        try:
            row[:] = [float(cells[index]) for index in indices]
        except (ValueError, IndexError):
            row[:] = np.nan
        if not np.isfinite(row).all():
            raise SourceError(line, repr(",".join(cells)[:60]), "finite numbers, one in each column")
    steps = np.diff(rows[:, 0])
    step_s = float(np.median(steps))
    uneven = (
        np.flatnonzero(~(np.abs(steps - step_s) <= _UNEVEN * abs(step_s))) if step_s > 0 else np.array([0])
    )
    if len(uneven):
        step, mend = f"a step of {steps[uneven[0]]:g} s", "Resample it to a steady rate first."
        raise SourceError(lines[uneven[0] + 2][0], step, f"steps of about {step_s:g} s, as most are", mend)
    return 1 / float(steps.mean()), rows[:, 1:]

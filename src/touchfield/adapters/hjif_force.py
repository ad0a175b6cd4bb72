"""A force over time as HJIF (ISO/IEC 23090-31); the resolution is that of `hjif_format`.

One perception of force with three channels, along x, y and z, and in each one Curve, linear between its keyframes.
The reference decoder wants it as one effect at position 0, of three keyframes or more: a longer time takes fewer
ticks a second.

The gain of a channel is the greatest force of the trace along its axis: F = amplitude * gain newtons. The binary form
keeps an amplitude in steps of 2/255, so that it misses a small force by as little of it as a large one, and an axis
without force not at all. Readers that put newtons out as sound, the reference synthesiser among them, clip them at 1:
`full_scale_n` makes another force 1 to them, and the file then tells shares of it instead of newtons.
"""

from __future__ import annotations

import math
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.adapters.hjif_format import (
    AMPLITUDE_DIGITS,
    AMPLITUDE_STEP,
    DEFAULT_TIMESCALE,
    MAX_SPAN_TICKS,
    MAX_TIMESCALE,
    checked_timescale,
    thinned,
    write_document,
)
from touchfield.errors import InvalidArgument

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    Float64s = NDArray[np.float64]
    Int64s = NDArray[np.int64]

__all__ = ["write_hjif_force"]

_AXES: Final = ("X", "Y", "Z")
_LARGEST_FORCE_N: Final = 1e6


def write_hjif_force(
    path: str | Path,
    times_s: ArrayLike,
    forces_n: ArrayLike,
    force_max_n: float,
    *,
    device_name: str = "",
    timescale: int | None = None,
    full_scale_n: float = 1.0,
    description: str = "",
    date: datetime | None = None,
) -> int:
    """Write a force over time as ``.hjif``.

    Between samples the force is linear, and before the first it is as at the first. Of samples that fall on one tick
    the last is told.

    Parameters
    ----------
    path : Path
    times_s : float [n]
        Seconds from 0 on, never falling.
    forces_n : float [n, 3]
        Newtons along x, y, z.
    force_max_n : float
        The device's greatest force; no component may exceed it.
    device_name : str
        Goes in as the reference device.
    timescale : int, optional
        Ticks a second. None takes 1000, more (up to 48000) where samples lie closer, and fewer where the time would
        take more than 65535 ticks.
    full_scale_n : float
        Newtons that are told as 1; 1 tells newtons.
    description : str
    date : datetime, optional
        Of making; now, where it is not given.

    Returns
    -------
    int
        The ticks a second that were taken.

    Raises
    ------
    InvalidArgument
        If shapes differ, a number is out of range or not finite, or the time is longer than 65535 ticks.
    SourceError
        If the system refuses to write.
    """
    times, forces = np.asarray(times_s, np.float64), np.asarray(forces_n, np.float64)
    _check_trace(times, forces, force_max_n)
    if not 0 < full_scale_n <= _LARGEST_FORCE_N:
        raise InvalidArgument("full_scale_n", repr(full_scale_n), f"newtons above 0, up to {_LARGEST_FORCE_N:g}")
    chosen = _timescale(times) if timescale is None else checked_timescale(timescale)
    ticks = np.round(times * chosen)
    if ticks[-1] > MAX_SPAN_TICKS:
        found = f"{times[-1]:g} s, {ticks[-1]:.0f} ticks"
        raise InvalidArgument("times_s", found, f"at most {MAX_SPAN_TICKS} ticks", "Take a lower timescale.")
    last = np.flatnonzero(np.concatenate([np.diff(ticks) > 0, [True]]))
    peaks_n = np.abs(forces).max(axis=0)
    kept, shares = ticks[last].astype(np.int64), np.clip(forces[last] / np.where(peaks_n > 0, peaks_n, 1), -1, 1)
    if kept[0] > 0:
        kept, shares = np.concatenate([np.zeros(1, np.int64), kept]), np.concatenate([shares[:1], shares])
    channels = [
        {
            "description": f"force along {name.lower()}",
            "gain": float(peaks_n[axis]) / full_scale_n,
            "mixing_coefficient": 1.0,
            "body_part_mask": 0,
            "direction": {other: 127 * (other == name) for other in _AXES},
            "bands": [_curve(kept, shares[:, axis], chosen)],
        }
        for axis, name in enumerate(_AXES)
    ]
    write_document(
        Path(path),
        description=description or "force over time",
        date=date,
        timescale=chosen,
        perception={
            "perception_modality": "Force",
            "description": f"force at a point, in units of {full_scale_n:g} N",
        },
        device_name=device_name,
        channels=channels,
        channel_count=len(channels),
    )
    return chosen


def _check_trace(times: Float64s, forces: Float64s, force_max_n: float) -> None:
    if not 0 < force_max_n <= _LARGEST_FORCE_N:
        raise InvalidArgument("force_max_n", repr(force_max_n), f"newtons above 0, up to {_LARGEST_FORCE_N:g}")
    if forces.ndim != 2 or forces.shape[1] != 3 or not len(forces) or times.shape != (len(forces),):
        raise InvalidArgument("forces_n", f"{forces.shape} with times {times.shape}", "[n, 3] and [n], n at least 1")
    if not (np.isfinite(times).all() and np.isfinite(forces).all()):
        raise InvalidArgument("forces_n", "a number that is not finite", "finite seconds and newtons")
    if times[0] < 0 or (np.diff(times) < 0).any():
        raise InvalidArgument("times_s", "times below 0, or that fall", "seconds from 0 on, never falling")
    greatest = float(np.abs(forces).max())
    if greatest > force_max_n * (1 + 1e-6):
        raise InvalidArgument("forces_n", f"{greatest:g} N", f"at most {force_max_n:g} N, the device's greatest")


def _timescale(times: Float64s) -> int:
    """Ticks a second that tell the samples apart, as far as 65535 ticks reach."""
    gaps = np.diff(times)
    gaps = gaps[gaps > 0]
    closest = float(gaps.min()) if len(gaps) else 1.0
    wanted = round(min(max(1 / max(closest, 1e-9), DEFAULT_TIMESCALE), MAX_TIMESCALE))
    span = float(times[-1])
    if span * wanted > MAX_SPAN_TICKS:
        wanted = math.floor(MAX_SPAN_TICKS / span)
    if wanted < 1:
        raise InvalidArgument("times_s", f"{span:g} s", f"at most {MAX_SPAN_TICKS} s in one effect", "Cut the trace.")
    return wanted


def _curve(ticks: Int64s, shares: Float64s, timescale: int) -> dict[str, Any]:
    """The Curve of one axis."""
    amplitudes = np.round(shares, AMPLITUDE_DIGITS)
    kept = thinned(ticks, amplitudes[:, None], (AMPLITUDE_STEP / 2,))
    line = _three(ticks[kept].tolist(), amplitudes[kept].tolist())
    return {
        "band_type": "Curve",
        "curve_type": "Linear",
        "lower_frequency_limit": 0,
        "upper_frequency_limit": max(1, min(timescale // 2, 10000)),
        "effects": [
            {
                "effect_type": "Basis",
                "position": 0,
                "phase": 0.0,
                "base_signal": "Sine",
                "keyframes": [{"relative_position": t, "amplitude_modulation": a} for t, a in line],
            }
        ],
    }


def _three(ticks: list[int], shares: list[float]) -> list[tuple[int, float]]:
    """At least three keyframes of the same line: a Curve of two breaks the reference decoder."""
    line = list(zip(ticks, shares))
    if len(line) > 2:
        return line
    span = ticks[-1] - ticks[0]
    if span > 1:
        middle = span // 2
        share = shares[0] + (shares[-1] - shares[0]) * middle / span
        return [line[0], (ticks[0] + middle, share), line[-1]]  # not rounded: it is to be on the line
    more = [(ticks[-1] + n, shares[-1]) for n in range(1, 4 - len(line))]  # too short for one between: it is held
    return [*line, *more]

"""HJIF, the JSON of MPEG haptics (ISO/IEC 23090-31): what all our files of that format have in common.

Valid against the published schemas, and within what the public reference decoder takes: whole numbers wherever it
reads whole numbers, and keyframes within 65535 ticks of their effect.

**Resolution.** Times are whole ticks, amplitudes multiples of 1e-5 of full scale, frequencies whole hertz. Keyframes
are left out where a straight line between others passes within half such a step, so that a sample on a tick comes
back to within one step of amplitude and one hertz. A sample between two ticks is told at the nearer one. A thousand
ticks a second are the default, which a decoder that knows only milliseconds reads correctly, too.
"""

from __future__ import annotations

import json
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.atomic import atomic_path

if TYPE_CHECKING:
    from collections.abc import Iterable

    from numpy.typing import ArrayLike, NDArray

__all__ = [
    "AMPLITUDE_DIGITS",
    "AMPLITUDE_STEP",
    "DEFAULT_TIMESCALE",
    "MAX_CHANNELS",
    "MAX_SPAN_TICKS",
    "MAX_TIMESCALE",
    "checked_timescale",
    "thinned",
    "write_document",
]

AMPLITUDE_DIGITS: Final = 5
AMPLITUDE_STEP: Final = 1e-5
"""Of full scale."""

DEFAULT_TIMESCALE: Final = 1000
"""Ticks a second."""

MAX_TIMESCALE: Final = 48000
MAX_SPAN_TICKS: Final = 65535
"""From the beginning of an effect to its last keyframe."""

MAX_CHANNELS: Final = 65535
_LEVEL_1_CHANNELS: Final = 127


def checked_timescale(timescale: int) -> int:
    """Ticks a second that the format allows; else InvalidArgument."""
    if not (isinstance(timescale, int) and 1 <= timescale <= MAX_TIMESCALE):
        raise InvalidArgument("timescale", repr(timescale), f"1 to {MAX_TIMESCALE} ticks a second")
    return timescale


def write_document(
    path: Path,
    *,
    description: str,
    date: datetime | None,
    timescale: int,
    perception: dict[str, Any],
    device_name: str,
    channels: Iterable[dict[str, Any]],
    channel_count: int,
) -> None:
    """Write one perception, a channel at a time: a large array is never held as JSON as a whole.

    Parameters
    ----------
    path : Path
    description : str
    date : datetime or None
        Of making; None for now.
    timescale : int
    perception : dict
        What tells it from others: `perception_modality`, `description`, perhaps `perception_unit_exponent`.
    device_name : str
        The reference device of all channels; "" for none.
    channels : iterable of dict
        In order; each gets its number.
    channel_count : int

    Raises
    ------
    SourceError
        If the system refuses to write.
    """
    made = datetime.now(UTC) if date is None else date.astimezone(UTC)
    root: dict[str, Any] = {
        "version": "2023",
        "profile": "Main",
        "level": 1 if channel_count <= _LEVEL_1_CHANNELS else 2,
        "date": made.strftime("%Y-%m-%dT%H:%M:%SZ"),
        "description": description,
        "timescale": timescale,
        "avatars": [],
        "syncs": [],
    }
    devices = {"reference_devices": [{"id": 1, "name": device_name}]} if device_name else {}
    one = {"id": 0, "avatar_id": 0, "unit_exponent": -3, "perception_unit_exponent": 0, **perception, **devices}
    own = {"reference_device_id": 1} if device_name else {}
    with atomic_path(path) as temporary, temporary.open("w", encoding="utf-8", newline="\n") as file:
        file.write(json.dumps(root)[:-1] + ', "perceptions": [')
        file.write(json.dumps({**one, "effect_library": []})[:-1] + ', "channels": [')
        for n, channel in enumerate(channels):
            file.write(("" if n == 0 else ",") + "\n" + json.dumps({"id": n, **own, **channel}))
        file.write("]}]}\n")


def thinned(ticks: NDArray[np.int64], values: NDArray[np.float64], tolerances: ArrayLike) -> NDArray[np.int64]:
    """Which samples to keep so that straight lines between them miss no sample by more than the tolerance.

    The first and the last are always kept. Each line reaches as far as the tolerances allow (the cone of slopes that
    pass all samples on the way); one pass, in time proportional to the samples.

    Parameters
    ----------
    ticks : int64 [n]
        Ascending, n at least 1.
    values : float64 [n, m]
        Samples of m signals that share their keyframes.
    tolerances : float [m]
        Greatest distance of each signal from the lines.

    Returns
    -------
    int64 [k]
        Indices of the samples that are kept, ascending.
    """
    margin = np.asarray(tolerances, np.float64)
    inner = (values[1:-1] == values[:-2]).all(axis=1) & (values[1:-1] == values[2:]).all(axis=1)
    places = np.flatnonzero(np.concatenate([[True], ~inner, [True]])[: len(ticks)])
    if len(places) < 3:
        return places
    # a sample between two equal ones lies on any line that both tolerate
    times, points, kept = ticks[places].tolist(), values[places].tolist(), [0]
    margins = margin.tolist()
    signals = range(len(margins))
    low, high = [-np.inf] * len(margins), [np.inf] * len(margins)
    for i in range(1, len(times)):
        start = kept[-1]
        span = times[i] - times[start]
        rises = [(points[i][s] - points[start][s]) / span for s in signals]
        if not all(low[s] <= rises[s] <= high[s] for s in signals):
            start = i - 1
            kept.append(start)
            span = times[i] - times[start]
            rises = [(points[i][s] - points[start][s]) / span for s in signals]
            low, high = [-np.inf] * len(margins), [np.inf] * len(margins)
        for s in signals:
            low[s] = max(low[s], rises[s] - margins[s] / span)
            high[s] = min(high[s], rises[s] + margins[s] / span)
    kept.append(len(times) - 1)
    return places[kept]

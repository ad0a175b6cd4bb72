"""Plays the page of a movie's touch in a browser, with a recorder in place of the game pad, and compares the
times of its calls with the clock of the movie.

The clock is `currentTime` of the movie. Where the browser shows a picture near the call, the call is compared
with that as well: `requestVideoFrameCallback` gives the time at which a picture shows, and its second. A busy
machine without a graphics card shows few of them, and late.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from browser import ROOT, drive, step

from touchfield.arrays import Float64s

_RECORDER = ROOT / "tests" / "viewer" / "timeline_sync.js"
_END_S = 0.3  # after the last onset; some browsers stop a little before the end
_NEAR_MS = 20.0  # from a picture on the screen to a call that is compared with it


class SyncErrors(NamedTuple):
    """Times from the onset in the movie to the call, ms; `missed` onsets had no call within half a second.

    `clock_ms` is by the movie's own clock (`currentTime`), `picture_ms` by the pictures on the screen, for
    the calls that have one nearby.
    """

    clock_ms: Float64s
    picture_ms: Float64s
    missed: int


def measure_sync(folder: Path, page: Path, onsets_s: tuple[float, ...], seconds: float) -> SyncErrors:
    """Play a page once, and measure every onset of its weak motor."""
    result = drive(
        folder,
        step("goto", url=page.as_uri()),
        step("until", code="document.getElementById('video').readyState > 0"),
        step("run", code=_RECORDER.read_text(encoding="utf-8")),
        step("click", id="play"),
        step("until", code=f"touchfield.state().time > {seconds - _END_S}"),
        step("run", code="window.timelineCalls"),
    )
    assert result.errors == []
    recorded = result.answers[-1]
    calls = [call for call in recorded["calls"] if call["kind"] == "pad"]
    pictures = np.array(recorded["pictures"]).reshape(-1, 2)
    clock_ms, picture_ms = list[float](), list[float]()
    for onset_s in onsets_s:
        call = _first_call(calls, onset_s)
        if call is None:
            continue
        clock_ms.append(1e3 * (call["time"] - onset_s))
        away_ms = call["at"] - pictures[:, 0]
        for near in np.flatnonzero(np.abs(away_ms) < _NEAR_MS)[:1]:
            picture_ms.append(1e3 * (pictures[near, 1] - onset_s) + away_ms[near])
    return SyncErrors(np.array(clock_ms), np.array(picture_ms), len(onsets_s) - len(clock_ms))


def _first_call(calls: list[dict[str, Any]], onset_s: float) -> dict[str, Any] | None:
    """The first call that drives the weak motor after it was still, near an onset."""
    is_still = True
    for call in calls:
        is_driven = call["level"][1] > 0
        if is_driven and is_still and abs(call["time"] - onset_s) < 0.25:
            return call
        is_still = not is_driven
    return None

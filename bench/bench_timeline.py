"""Measures how late the page of a movie's touch drives a game pad, in headless Chromium, and its size.

    python bench/bench_timeline.py [--quick] [--rounds N]

A movie of three seconds with five beats is played `--rounds` times. A recorder in place of the game pad notes
the time of each effect and the movie's clock (`currentTime`) at that time; the error is the difference to the
onset of the beat in the touch. The path from the browser to a real pad, and the motor's start, come on top:
the field *Ahead* of the page is for these. Where Chromium shows a picture of the movie within 20 ms of an
effect, the effect is compared with that picture, too.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
from pathlib import Path

import numpy as np

from machine import Bar, Figures, at_most, bench, figure, leave_out
from touchfield.tasks.view import view
from touchfield.viewer.timeline import empty_timeline

ROOT = Path(__file__).resolve().parents[1]
sys.path[:0] = [str(ROOT / "tests" / "viewer"), str(ROOT / "tests")]
from browser import why_not  # noqa: E402
from timeline_sync import measure_sync  # noqa: E402

from timeline_makers import BEATS_S, SECONDS, write_movie  # noqa: E402


def measure(rounds: int) -> Figures:
    """Measure the size of the page, and the errors of its effects."""
    if why_not():
        leave_out(str(why_not()))
    clock_ms, picture_ms, missed = list[float](), list[float](), 0
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        page = view(write_movie(folder)).save(folder / "both.html")
        for _ in range(rounds):
            errors = measure_sync(folder, page, BEATS_S, SECONDS)
            clock_ms += errors.clock_ms.tolist()
            picture_ms += errors.picture_ms.tolist()
            missed += errors.missed
    late_ms, shown_ms = np.abs(clock_ms), np.abs(picture_ms)
    return {
        "timeline_gz_bytes": len(gzip.compress(empty_timeline().encode(), 9)),
        "onsets": rounds * len(BEATS_S),
        "missed_onsets": missed,
        "effect_p95_ms": float(np.percentile(late_ms, 95)),
        "effect_max_ms": float(late_ms.max()),
        "compared_pictures": len(picture_ms),
        "picture_p95_ms": float(np.percentile(shown_ms, 95)) if picture_ms else None,
        "picture_max_ms": float(shown_ms.max()) if picture_ms else None,
    }


def bars(figures: Figures) -> list[Bar]:
    """Require an effect within 30 ms of every onset, and a small page."""
    return [
        at_most("page, gzip", figures["timeline_gz_bytes"], 24_000, "bytes"),
        at_most("onsets without an effect", figures["missed_onsets"], 0, "onsets"),
        at_most("onset to effect, 95 %", figure(figures, "effect_p95_ms"), 30.0, "ms"),
        at_most("onset to effect, worst", figure(figures, "effect_max_ms"), 30.0, "ms"),
    ]


if __name__ == "__main__":
    bench("timeline", __doc__, measure, bars, rounds=(10, 1))

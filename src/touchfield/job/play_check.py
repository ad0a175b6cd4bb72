"""Whether this machine can decode a stream in time: a sample of its segments, decoded as the player does it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any, Final

from touchfield.errors import InvalidArgument
from touchfield.job.stream import open_stream
from touchfield.render.frame_source import FrameSource

__all__ = ["check_play"]

_SEGMENTS: Final = 8
_LONGEST_S: Final = 20.0
_SPARE: Final = 1.2
"""So much quicker than needed it must be, as the servo wants its share of the processor too."""


def check_play(path: str | Path, speed: float = 1.0, clock_s: Callable[[], float] = perf_counter) -> dict[str, Any]:
    """Decode up to 8 segments, evenly spread, for at most 20 s, and compare with the time that they last.

    Returns
    -------
    dict
        ``frames_decoded``, ``decode_s``, ``decoded_rate_hz``, ``needed_rate_hz``, ``greatest_speed`` that can be
        played in time, and ``can_play`` at the speed asked for.

    Raises
    ------
    InvalidArgument
        If the speed is not positive.
    TouchfieldError
        If the file cannot be read.
    """
    if not 0 < speed <= 100:
        raise InvalidArgument("--speed", repr(speed), "above 0, up to 100")
    with open_stream(path) as stream:
        source = FrameSource(stream.scene or stream.medium)
        count = source.frame_count
        starts = [*(source.starts or range(0, count, max(1, count // _SEGMENTS)))]
        chosen = sorted({starts[i * len(starts) // _SEGMENTS] for i in range(min(_SEGMENTS, len(starts)))})
        source.prepare(chosen[-1])  # code is loaded or compiled first, and is no part of it
        begun, frames = clock_s(), 0
        for first in chosen:
            stop = min((at for at in starts if at > first), default=count)
            for frame in range(first, stop):
                if frames and clock_s() - begun > _LONGEST_S:
                    break
                source.prepare(frame)
                frames += 1
        took_s = max(clock_s() - begun, 1e-9)
    needed_hz = source.rate_hz * speed if count > 1 else 0.0
    greatest = frames / took_s / source.rate_hz / _SPARE
    return {
        "frames_decoded": frames,
        "decode_s": took_s,
        "decoded_rate_hz": frames / took_s,
        "needed_rate_hz": needed_hz,
        "greatest_speed": greatest,
        "can_play": count == 1 or greatest >= speed,
    }

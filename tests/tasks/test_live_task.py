"""Frames sent by `live`: each frame of the source once, for any duration of the broadcast."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import touchfield as tf
from live_makers import GRID as LIVE_GRID, HEAD, field, medium
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.medium import ForceField
from touchfield.network.live import LiveSegment
from touchfield.tasks.live import (
    _REPEAT as REPEAT,
    MAX_DELAY_S,
    LiveSpec,
    _Layer,
    _Tick,
    broadcast,
    open_sender,
)

GRID = tf.Grid((8, 8, 8), (0.002,) * 3, (0.0,) * 3)


@pytest.mark.parametrize(
    ("spec", "frame_count"),
    [
        (LiveSpec(0.1), 7),
        (LiveSpec(0.1, seconds=10.0), 7),  # longer than the source
        (LiveSpec(0.1, seconds=0.2), 4),
        (LiveSpec(0.1, loop=True, seconds=0.5), 10),
    ],
)
def test_a_source_ends_unless_it_loops(spec: LiveSpec, frame_count: int, tmp_path: Path) -> None:
    forces_n = np.zeros((7, 8, 8, 8, 3))
    forces_n[:, 2:6, 2:6, 2:6, 2] = np.arange(1, 8)[:, None, None, None]
    path = tf.write_field(tmp_path / "seven.npz", tf.HapticMedium.from_array(forces_n, GRID, 20.0))
    prepared, sender = open_sender(str(path), tf.EncodeSpec(nw=3))
    clock_s = [0.0]
    wait = lambda seconds: clock_s.append(clock_s[-1] + seconds)  # noqa: E731
    sent = broadcast(prepared, sender.add, spec, clock_s=lambda: clock_s[-1], pause=wait)
    assert sent.frames + sent.left_out == frame_count  # frames that were encoded too late count as well


def until(condition: Callable[[], bool]) -> None:
    deadline_s = time.monotonic() + 30
    while not condition() and time.monotonic() < deadline_s:
        time.sleep(0.001)
    assert condition()


def decoded(segment: LiveSegment) -> list[ForceField]:
    return list(TouchDecoder(LIVE_GRID, HEAD.coder_parameters).frames(segment.body, segment.frame_count))


def test_a_slow_coder_gets_the_newest_frame_and_repeats_the_others() -> None:
    prepared, sender = open_sender(medium(), tf.EncodeSpec())
    gate, took, period_s = threading.Semaphore(0), list[LiveSegment](), 0.02

    def slow(frame: ForceField) -> ForceField:
        assert gate.acquire(timeout=30)
        return frame

    lane = _Layer(prepared, took.append, time.monotonic, slow)
    tick = lambda i, left_s=1.0, late_s=0.0: _Tick(i, i == 0, late_s, left_s)  # noqa: E731
    lane._latest_s.extend([0.08] * 3)
    queue = lane.start_segment(0, [])
    assert lane.wants_frame(tick(0), period_s)
    queue.put(prepared.medium[0])
    until(queue.empty)
    assert not lane.wants_frame(tick(1), period_s), "the first frame is being coded"
    queue.put(REPEAT)
    gate.release()
    until(lambda: queue.empty() and not lane._is_coding)
    lane._latest_s.extend([0.08] * 3)
    assert lane.wants_frame(tick(2), period_s)
    assert not lane.wants_frame(tick(2, left_s=0.07), period_s), "it would delay the segment"
    assert not lane.wants_frame(tick(2, late_s=0.03), period_s), "a newer one is due"
    queue.put(prepared.medium[7])
    assert not lane.wants_frame(tick(3), period_s)
    gate.release()
    queue.put(REPEAT)
    queue.put(None)
    lane.close()
    (segment,) = took
    supports = [f.support_count for f in decoded(segment)]
    assert supports == [field(n).support_count for n in (0, 0, 7, 7)]
    assert (lane.sent.frames, lane.sent.segments, sender.programme != "") == (2, 1, True)


def test_a_fast_coder_gets_every_frame() -> None:
    prepared, _ = open_sender(medium(), tf.EncodeSpec())
    lane = _Layer(prepared, lambda segment: None, time.monotonic)
    queue = lane.start_segment(0, [])
    lane._latest_s.extend([0.08, 0.019, 0.08])  # once in a while something else takes the processor
    for i in range(5):
        assert lane.wants_frame(_Tick(i, i == 0, 0.01, MAX_DELAY_S), 0.02)
    queue.put(None)
    lane.close()


def test_a_source_that_is_too_slow_leaves_no_gap_in_the_stream() -> None:
    now, took, notes = [0.0], list[LiveSegment](), list[str]()

    def slow(index: int) -> ForceField:
        until(lambda: len(took) >= index // 10)  # the coder keeps up
        now[0] += 0.045
        return field(index)

    def pause(seconds: float) -> None:
        now[0] += seconds

    slow_medium = tf.HapticMedium(
        grid=LIVE_GRID, rate_hz=50.0, axes=HEAD.axes, frame_count=50, make_frame=slow
    )
    prepared, _ = open_sender(slow_medium, tf.EncodeSpec())
    sent = broadcast(prepared, took.append, LiveSpec(0.2), notes.append, lambda: now[0], pause)
    assert [segment.first_frame for segment in took] == [0, 10, 20, 30, 40]
    assert sent.frames + sent.left_out == 50 and 10 < sent.left_out < 40
    assert any("cannot be made in time" in note for note in notes)
    supports = [f.support_count for segment in took for f in decoded(segment)]
    own = [field(n).support_count for n in range(50)]
    repeated = [n for n in range(50) if supports[n] != own[n]]
    assert len(repeated) == sent.left_out and all(supports[n] == supports[n - 1] for n in repeated)

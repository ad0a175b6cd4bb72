"""Frames by number, in sequence and at random, with segments decoded in advance."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

import touchfield.pipeline.decoded_frames as module
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField, Grid
from touchfield.pipeline.decoded_frames import SegmentFrames

GRID = Grid((8, 8, 8), (0.001,) * 3, (0.0,) * 3)
LENGTH, COUNT = 3, 7


def field(number: int) -> ForceField:
    return ForceField(GRID, np.zeros((1, 3), np.int32), np.full((1, 8, 8, 8, 3), number + 1, np.float32))


def number_of(frame: ForceField) -> int:
    return int(frame.forces_n[0, 0, 0, 0, 0]) - 1


def reader() -> Any:
    entries = [SimpleNamespace(first_frame=LENGTH * i, frame_count=LENGTH) for i in range(COUNT)]
    return SimpleNamespace(name="a.touch", segments=entries, segment_of=lambda frame: frame // LENGTH)


def frames_of(note: Callable[[int], None] = lambda _: None) -> SegmentFrames:
    def decode(segment: int) -> Iterator[ForceField]:
        note(segment)
        for i in range(LENGTH):
            yield field(LENGTH * segment + i)

    return SegmentFrames(reader(), decode)


@given(st.lists(st.integers(0, LENGTH * COUNT - 1), max_size=40), st.integers(0, 8))
def test_any_order_gives_the_right_frames(order: list[int], run: int) -> None:
    frames = frames_of()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("TOUCHFIELD_THREADS", "3")
        for start in order:
            for frame in range(start, min(start + run, LENGTH * COUNT - 1) + 1):
                assert number_of(frames(frame)) == frame


@pytest.mark.parametrize("threads", ["1", "2", "5"])
@pytest.mark.parametrize("max_bytes", [1, 1 << 28])
def test_in_sequence_every_segment_is_decoded_once(
    threads: str, max_bytes: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)
    monkeypatch.setattr(module, "MAX_LOOKAHEAD_BYTES", max_bytes)
    begun: list[int] = []
    frames = frames_of(begun.append)
    assert [number_of(frames(i)) for i in range(LENGTH * COUNT)] == list(range(LENGTH * COUNT))
    assert sorted(begun) == list(range(COUNT))
    assert number_of(frames(LENGTH * COUNT - 1)) == LENGTH * COUNT - 1 and len(begun) == COUNT, (
        "the latest is kept"
    )


def test_the_next_segments_are_decoded_by_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    next_decoded = threading.Event()

    def note(segment: int) -> None:
        if segment == 1:
            next_decoded.set()

    frames = frames_of(note)
    frames(0), frames(1)
    assert not frames._lookahead, "the first two frames come before any other"
    frames(2)
    assert next_decoded.wait(30)
    monkeypatch.setenv("TOUCHFIELD_THREADS", "1")
    begun: list[int] = []
    alone = frames_of(begun.append)
    assert [number_of(alone(i)) for i in range(LENGTH)] == list(range(LENGTH))
    time.sleep(0.02)
    assert begun == [0], "there is no other thread"


def test_only_the_first_frames_of_a_large_segment_are_decoded_in_advance(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    monkeypatch.setattr(module, "MAX_LOOKAHEAD_BYTES", field(0).forces_n.nbytes)
    decoded: list[int] = []

    def decode(segment: int) -> Iterator[ForceField]:
        for i in range(LENGTH * segment, LENGTH * (segment + 1)):
            decoded.append(i)
            yield field(i)

    frames = SegmentFrames(reader(), decode)
    frames(0), frames(1), frames(2)
    deadline_s = time.monotonic() + 30
    while 7 not in decoded and time.monotonic() < deadline_s:
        time.sleep(0.001)
    time.sleep(0.02)
    assert sorted(decoded) == [0, 1, 2, 3, 4, 6, 7], "as many as fit, and the one that does not"


@pytest.mark.parametrize("threads", ["1", "3"])
def test_a_damaged_segment_loses_its_frames_from_the_fault_on(
    threads: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", threads)

    def decode(segment: int) -> Iterator[ForceField]:
        for i in range(LENGTH):
            if (segment, i) == (2, 1):
                raise CorruptFile("body", "damage")
            yield field(LENGTH * segment + i)
        if segment == 4:
            raise CorruptFile("body", "damage behind the last frame")

    frames = SegmentFrames(reader(), decode)
    for i in range(LENGTH * COUNT):
        if i in (7, 8, 14):
            with pytest.raises(CorruptFile, match="damage"):
                frames(i)
        else:
            assert number_of(frames(i)) == i


class GatedDecoder:
    """A decoder whose other threads wait at the second frame of a segment; notes who decodes what."""

    def __init__(self) -> None:
        self.gate, self.is_waiting = threading.Event(), threading.Event()
        self.threads: dict[int, threading.Thread] = {}
        self._main = threading.current_thread()

    def __call__(self, segment: int) -> Iterator[ForceField]:
        for i in range(LENGTH):
            if i == 1 and threading.current_thread() is not self._main:
                self.is_waiting.set()
                assert self.gate.wait(30)
            self.threads[LENGTH * segment + i] = threading.current_thread()
            yield field(LENGTH * segment + i)


def test_after_a_jump_the_other_threads_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    decoder = GatedDecoder()
    frames = SegmentFrames(reader(), decoder)
    frames(0), frames(1), frames(2)
    ahead = list(frames._lookahead.values())
    assert decoder.is_waiting.wait(30)
    assert number_of(frames(LENGTH * 6)) == LENGTH * 6
    decoder.gate.set()
    for lookahead in ahead:
        if not lookahead._future.cancelled():
            lookahead._future.result(30)
    assert not {LENGTH + 2, 2 * LENGTH + 2} & decoder.threads.keys(), "nobody asks for these any more"


def test_who_reaches_a_segment_takes_it_over(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    decoder = GatedDecoder()
    frames = SegmentFrames(reader(), decoder)
    frames(0), frames(1), frames(2)
    assert decoder.is_waiting.wait(30)
    opener = threading.Timer(0.05, decoder.gate.set)
    opener.start()
    assert [number_of(frames(i)) for i in range(LENGTH, 2 * LENGTH)] == [3, 4, 5]
    assert decoder.threads[LENGTH] is not threading.current_thread()
    assert decoder.threads[LENGTH + 2] is threading.current_thread(), "it did not wait for the whole segment"


@pytest.mark.parametrize("segment", [2, COUNT - 1])
def test_behind_a_jump_to_a_last_frame_another_thread_decodes_one_frame(
    segment: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The frame after it, from which a loop goes on, is the first of another segment."""
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    decoder = GatedDecoder()
    decoder.gate.set()
    frames = SegmentFrames(reader(), decoder)
    last, following = LENGTH * (segment + 1) - 1, LENGTH * (segment + 1) % (LENGTH * COUNT)
    assert number_of(frames(last)) == last
    (ahead,) = frames._lookahead.values()
    ahead._future.result(30)
    assert decoder.threads[following] is not threading.current_thread()
    assert following + 1 not in decoder.threads, "nobody has asked for more"
    assert [number_of(frames(following + i)) for i in range(LENGTH)] == [following + i for i in range(LENGTH)]
    assert decoder.threads[following + 1] is threading.current_thread()


def test_a_jump_among_segments_of_one_frame_decodes_that_frame_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    """A file over the network is fetched no further than what is requested."""
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    decoded = list[int]()

    def decode(segment: int) -> Iterator[ForceField]:
        decoded.append(segment)
        yield field(segment)

    entries = [SimpleNamespace(first_frame=i, frame_count=1) for i in range(COUNT)]
    single = SimpleNamespace(name="a.touch", segments=entries, segment_of=lambda frame: frame)
    frames = SegmentFrames(single, decode)  # type: ignore[arg-type]
    for frame in (3, 5, 1):
        assert number_of(frames(frame)) == frame
    assert not frames._lookahead and decoded == [3, 5, 1]


def test_a_loop_is_a_sequence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TOUCHFIELD_THREADS", "2")
    frames = frames_of()
    for frame in range(LENGTH * COUNT):
        frames(frame)
    assert number_of(frames(0)) == 0
    assert frames._lookahead.keys() == {1, 2}, "decoding ahead goes on through the repeat"

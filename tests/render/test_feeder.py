"""The feeder: which frames lie in the block, in which order, and what it does not write over."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st
from player_makers import GRID, laid_out, telling, told

from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, HapticObject, HapticScene, PoseTrack
from touchfield.render.block import Memory, words as W
from touchfield.render.feeder import Feeder, FrameSource
from touchfield.render.kernels.frames import force_at
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec


def entry(session: Session, memory: Memory, frame: int) -> tuple[int, int]:
    """Tag and place of a frame's entry."""
    at = W.FREE + W.DIRECTORY_WORDS * (frame % session.layout.slots)
    return int(memory.i8[at]), int(memory.i8[at + 1])


def tag(generation: int, frame: int) -> int:
    return (generation << W.FRAME_BITS) | frame


def shown(session: Session, memory: Memory, generation: int, frame: int) -> float | None:
    """The force along z of a frame in the block."""
    found, place = entry(session, memory, frame)
    if found != tag(generation, frame):
        return None
    return float(force_at(*memory.views, place, place, 0.0, 0.0, 0.0, 0.0)[2])


def run_dry(feeder: Feeder) -> int:
    return sum(1 for _ in iter(feeder.step, False))


def test_frames_come_in_order_until_the_end() -> None:
    session, memory = laid_out(telling(5))
    feeder = session.feeder(memory)
    assert not feeder.is_preloaded
    assert run_dry(feeder) == 5 and feeder.is_preloaded
    assert [shown(session, memory, 1, n) for n in range(5)] == [0.5 + n / 64 for n in range(5)]
    assert shown(session, memory, 1, 5) is None


def test_a_loop_counts_on_and_begins_in_the_middle() -> None:
    session, memory = laid_out(telling(5), loop=True, start_s=13 / 50)  # the third time round
    feeder = session.feeder(memory)
    assert memory.f8[W.MEDIA_S] == pytest.approx(3 / 50)  # also before the first tick
    feeder.fill_lookahead(6)
    assert [shown(session, memory, 1, n) for n in range(3, 9)] == [0.5 + n % 5 / 64 for n in range(3, 9)]


def test_one_frame_is_written_once() -> None:
    session, memory = laid_out(telling(1), loop=True)
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 1 and shown(session, memory, 1, 0) == 0.5
    ends = session, laid_out(telling(10))[0]  # there is none, and there is one
    assert [one.media_time_s(7.0) for one in ends] == [0, 0.2]
    feeder.seek(2, 0)
    memory.i8[W.NEEDS] = tag(2, 0)
    assert run_dry(feeder) == 1 and shown(session, memory, 2, 0) == 0.5


@given(st.lists(st.integers(0, 12), max_size=30), st.integers(3, 9))
def test_what_the_servo_needs_is_never_written_over(steps: list[int], frames_of_room: int) -> None:
    words = FrameSource(telling()).prepare(0).word_count
    session, memory = laid_out(telling(7), loop=True, memory_bytes=8 * words * frames_of_room)
    feeder = session.feeder(memory)
    run_dry(feeder)
    needed, there = 0, lambda n: shown(session, memory, 1, n) == 0.5 + n % 7 / 64
    for step in steps:
        ahead = [n for n in range(needed, needed + 20) if there(n)]
        assert ahead and ahead == list(range(needed, needed + len(ahead)))
        needed += min(step, len(ahead) - 1)
        memory.i8[W.NEEDS] = tag(1, needed)
        run_dry(feeder)
        assert there(needed) and there(needed + 1)


def test_a_seek_waits_until_the_servo_has_taken_it_up() -> None:
    session, memory = laid_out(telling(20))
    feeder = session.feeder(memory)
    run_dry(feeder)
    feeder.seek(2, 11)
    assert run_dry(feeder) == 0  # decoded, and not shown
    assert [shown(session, memory, 1, n) for n in range(20)] == [0.5 + n / 64 for n in range(20)]
    memory.i8[W.NEEDS] = tag(2, 11)
    assert run_dry(feeder) == 9
    assert shown(session, memory, 2, 11) == 0.5 + 11 / 64


def test_a_seek_back_gives_the_room_of_later_frames_to_earlier_ones() -> None:
    session, memory = laid_out(
        telling(20), memory_bytes=4 * W.WORD * FrameSource(telling()).prepare(0).word_count
    )
    feeder = session.feeder(memory, is_timed=False)
    for generation, frame in ((1, 10), (2, 0)):
        feeder.seek(generation, frame)
        memory.i8[W.NEEDS] = tag(generation, frame)
        run_dry(feeder)
        assert (
            shown(session, memory, generation, frame + 2) == 0.5 + (frame + 2) / 64 and feeder.error is None
        )


def test_frames_that_are_past_are_not_decoded() -> None:
    session, memory = laid_out(telling(20))
    feeder = session.feeder(memory)
    feeder.step()
    memory.i8[W.NEEDS] = tag(1, 9)
    feeder.step()
    assert shown(session, memory, 1, 9) == 0.5 + 9 / 64 and shown(session, memory, 1, 1) is None
    assert feeder.dropped_frames == 8
    feeder.seek(2, 0)
    memory.i8[W.NEEDS] = tag(2, 3)
    feeder.step()
    assert feeder.dropped_frames == 8  # none of what comes before the first of a seek was to be shown


class Desk:
    """A servo of the plainest kind, which ticks on while frames are decoded, each in as many ticks as it
    takes.
    """

    def __init__(self, count: int, ticks: int, starts: tuple[int, ...] = (), room: float = 1000.0) -> None:
        self.count, self.ticks, self.now_s, self.late, self.decoded = (
            count,
            ticks,
            0.0,
            list[float | None](),
            list[int](),
        )
        medium = replace(telling(count), make_frame=self.make)
        words = FrameSource(telling()).prepare(0).word_count
        self.session, self.memory = laid_out(
            medium, RenderSpec(render="field"), memory_bytes=int(8 * room * words)
        )
        self.session.source.starts = starts
        self.memory.i8[W.MODE_NOW] = W.PLAYING
        self.memory.f8[W.SPEED_NOW] = 1.0
        self.feeder = Feeder(
            self.session.source, self.memory, self.session.layout, clock_s=lambda: self.now_s
        )
        self.at = -1

    def make(self, frame: int) -> ForceField:
        start = max((s for s in self.session.source.starts if s <= frame), default=frame)
        for one in range(self.at + 1 if start <= self.at < frame else start, frame + 1):
            self.decoded.append(one)
            for _ in range(self.ticks):
                self.tick()
        self.at = frame
        return told(frame)

    def tick(self) -> None:
        i8, f8 = self.memory.i8, self.memory.f8
        self.now_s += 0.001
        if i8[W.FEED] != W.RUNNING:
            return
        f8[W.MEDIA_S] += 0.001
        wanted = int(f8[W.MEDIA_S] * 50 + 1e-6)
        if wanted < self.count:
            found = [
                shown(self.session, self.memory, 1, min(n, self.count - 1)) for n in (wanted, wanted + 1)
            ]
            self.late.append(None if found[0] is None or found[1] is None else wanted - 64 * (found[0] - 0.5))
            i8[W.NEEDS] = tag(1, wanted)

    def play(self) -> None:
        for _ in range(4):
            self.feeder.step()
        self.memory.i8[W.FEED] = W.RUNNING
        while self.memory.f8[W.MEDIA_S] < self.count / 50 + 0.01:
            if not self.feeder.step():
                self.tick()
        assert self.feeder.error is None


@pytest.mark.parametrize(
    ("ticks", "starts"), [(50, ()), (200, ()), (30, tuple(range(0, 500, 5))), (60, tuple(range(0, 500, 10)))]
)
def test_a_stream_that_is_too_slow_is_thinned_out_and_keeps_time(ticks: int, starts: tuple[int, ...]) -> None:
    desk = Desk(496, ticks, starts, room=2.5)  # nothing that is held is written over
    desk.play()
    there = [late for late in desk.late if late is not None]
    assert len(desk.late) >= 9910 and len(there) > 0.95 * len(desk.late)
    assert min(there) == 0 and max(there) <= 2.5 * max(ticks / 20, 10)  # a late frame is one that is held
    assert desk.feeder.dropped_frames > 100 and desk.feeder.dropped_frames + len(set(desk.decoded)) == 496
    assert len(set(desk.decoded)) > 0.3 * 10_000 / ticks


def test_a_rate_that_suffices_is_not_told_as_the_cause() -> None:
    desk = Desk(500, 50, ())
    desk.play()
    assert "This machine decodes" in desk.feeder.note and "left out" in desk.feeder.note
    desk.feeder._pace.frame_s = 6.4e-6  # the latest frames were quick: something else held up the others
    assert "decodes" not in desk.feeder.note and "had to be fetched" in desk.feeder.note


def test_a_stream_that_is_quick_enough_loses_no_frame() -> None:
    desk = Desk(500, 15, tuple(range(0, 500, 10)))
    desk.play()
    assert desk.decoded == list(range(500)) and desk.feeder.dropped_frames == 0
    assert set(desk.late) == {0.0}


def test_where_nothing_can_be_in_time_nothing_is_held_for_it() -> None:
    desk = Desk(500, 50, (0,))
    desk.play()
    assert desk.late.count(None) > 5000


def test_a_frame_that_does_not_fit_is_one_clear_error() -> None:
    words = FrameSource(telling()).prepare(0).word_count
    for share, what in ((0.5, r"frame 0"), (1.5, r"room for two frames")):
        session, memory = laid_out(telling(3), memory_bytes=8 * int(words * share))
        feeder = session.feeder(memory)
        run_dry(feeder)
        assert isinstance(feeder.error, InvalidArgument)
        assert what in str(feeder.error) and "Ask for more memory" in str(feeder.error)
        assert memory.i8[W.FEED_FAILED]


def test_an_error_of_the_medium_is_kept() -> None:
    session, memory = laid_out(telling(9, corrupt_from=4))
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 4
    assert isinstance(feeder.error, CorruptFile) and memory.i8[W.FEED_FAILED]


def test_rigid_bodies_are_written_once() -> None:
    from touchfield.medium import HapticMedium

    track = PoseTrack([[1.0, 0, 0, 0]] * 4, [[0.0, 0, 0.01 * n] for n in range(4)])
    still = HapticObject("still", HapticMedium.from_frames([told(0)], 50.0), track)
    soft = HapticObject("soft", HapticMedium.from_frames([told(n) for n in range(4)], 50.0), track)
    scene = HapticScene(GRID, 50.0, (still, soft), 4.0)
    session, memory = laid_out(scene)  # type: ignore[arg-type]
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 4
    for n in range(4):
        place = entry(session, memory, n)[1]
        for z in (0.0, 0.033, -0.02):
            expected = scene.sample_n(n, [0.001, 0.002, z])
            found = force_at(*memory.views, place, place, 0.0, 0.001, 0.002, z)
            assert found == pytest.approx(expected, abs=1e-6)
    assert FrameSource(HapticScene(GRID, 50.0, (still,), 4.0)).prepare(2).word_count < 64


def test_the_thread_feeds_and_ends() -> None:
    session, memory = laid_out(telling(20))
    feeder = session.feeder(memory)
    feeder.start()
    ends = time.monotonic() + 20
    while not feeder.is_preloaded and time.monotonic() < ends:
        time.sleep(0.001)
    assert feeder.is_preloaded
    feeder.seek(2, 5)
    memory.i8[W.NEEDS] = tag(2, 5)
    while shown(session, memory, 2, 19) is None and time.monotonic() < ends:
        time.sleep(0.001)
    assert shown(session, memory, 2, 19) == 0.5 + 19 / 64
    for _ in range(2):
        feeder.close()
    assert feeder._thread is not None and not feeder._thread.is_alive()

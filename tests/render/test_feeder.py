"""The feeder: which frames are in the block, in which order, and which it must not overwrite."""

from __future__ import annotations

import time
from dataclasses import replace

import pytest
from hypothesis import given, strategies as st
from player_makers import GRID, laid_out, numbered_field, numbered_medium

from touchfield.compute.native import native
from touchfield.errors import CorruptFile, InvalidArgument
from touchfield.medium import ForceField, HapticObject, HapticScene, PoseTrack
from touchfield.render.block import Memory, aligned, layout
from touchfield.render.feeder import Feeder, FrameSource
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec


def entry(session: Session, memory: Memory, frame: int) -> tuple[int, int]:
    """Tag and offset of the entry of a frame."""
    entries = memory.array(layout.DIRECTORY_ENTRY, session.layout.directory, session.layout.slots)
    tag, offset = entries[frame % session.layout.slots]
    return int(tag), int(offset)


def tag(generation: int, frame: int) -> int:
    return (generation << layout.FRAME_BITS) | frame


def stored_force_z(session: Session, memory: Memory, generation: int, frame: int) -> float | None:
    """The force along z of a frame in the block."""
    found, address = entry(session, memory, frame)
    if found != tag(generation, frame):
        return None
    return native.force_at(memory.bytes, address, address, 0.0, 0.0, 0.0, 0.0)[2]


def run_dry(feeder: Feeder) -> int:
    return sum(1 for _ in iter(feeder.step, False))


def test_frames_are_written_in_order_until_the_end() -> None:
    session, memory = laid_out(numbered_medium(5))
    feeder = session.feeder(memory)
    assert not feeder.is_preloaded
    assert run_dry(feeder) == 5 and feeder.is_preloaded
    assert [stored_force_z(session, memory, 1, n) for n in range(5)] == [0.5 + n / 64 for n in range(5)]
    assert stored_force_z(session, memory, 1, 5) is None


def test_a_loop_continues_to_count_and_can_start_in_the_middle() -> None:
    session, memory = laid_out(numbered_medium(5), loop=True, start_s=13 / 50)  # the third time round
    feeder = session.feeder(memory)
    assert memory.receiver["clock"]["media_s"] == pytest.approx(3 / 50)  # also before the first tick
    feeder.fill_lookahead(6)
    assert [stored_force_z(session, memory, 1, n) for n in range(3, 9)] == [
        0.5 + n % 5 / 64 for n in range(3, 9)
    ]


def test_one_frame_is_written_once() -> None:
    session, memory = laid_out(numbered_medium(1), loop=True)
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 1 and stored_force_z(session, memory, 1, 0) == 0.5
    sessions = session, laid_out(numbered_medium(10))[0]  # without an end, and with one
    assert [either.media_time_s(7.0) for either in sessions] == [0, 0.2]
    feeder.seek(2, 0)
    memory.receiver["clock"]["needs"] = tag(2, 0)
    assert run_dry(feeder) == 1 and stored_force_z(session, memory, 2, 0) == 0.5


@given(st.lists(st.integers(0, 12), max_size=30), st.integers(3, 9))
def test_needed_frames_are_never_overwritten(steps: list[int], frames_of_room: int) -> None:
    size_bytes = aligned(FrameSource(numbered_medium()).prepare(0).size_bytes)
    session, memory = laid_out(numbered_medium(7), loop=True, memory_bytes=size_bytes * frames_of_room)
    feeder = session.feeder(memory)
    run_dry(feeder)
    needed, is_stored = 0, lambda n: stored_force_z(session, memory, 1, n) == 0.5 + n % 7 / 64
    for step in steps:
        stored = [n for n in range(needed, needed + 20) if is_stored(n)]
        assert stored and stored == list(range(needed, needed + len(stored)))
        needed += min(step, len(stored) - 1)
        memory.receiver["clock"]["needs"] = tag(1, needed)
        run_dry(feeder)
        assert is_stored(needed) and is_stored(needed + 1)


def test_a_seek_waits_for_the_servo() -> None:
    session, memory = laid_out(numbered_medium(20))
    feeder = session.feeder(memory)
    run_dry(feeder)
    feeder.seek(2, 11)
    assert run_dry(feeder) == 0  # decoded but not written
    assert [stored_force_z(session, memory, 1, n) for n in range(20)] == [0.5 + n / 64 for n in range(20)]
    memory.receiver["clock"]["needs"] = tag(2, 11)
    assert run_dry(feeder) == 9
    assert stored_force_z(session, memory, 2, 11) == 0.5 + 11 / 64


def test_a_seek_back_reuses_the_space_of_later_frames() -> None:
    session, memory = laid_out(
        numbered_medium(20), memory_bytes=4 * aligned(FrameSource(numbered_medium()).prepare(0).size_bytes)
    )
    feeder = session.feeder(memory, is_timed=False)
    for generation, frame in ((1, 10), (2, 0)):
        feeder.seek(generation, frame)
        memory.receiver["clock"]["needs"] = tag(generation, frame)
        run_dry(feeder)
        assert (
            stored_force_z(session, memory, generation, frame + 2) == 0.5 + (frame + 2) / 64
            and feeder.error is None
        )


def test_past_frames_are_not_decoded() -> None:
    session, memory = laid_out(numbered_medium(20))
    feeder = session.feeder(memory)
    feeder.step()
    memory.receiver["clock"]["needs"] = tag(1, 9)
    feeder.step()
    assert (
        stored_force_z(session, memory, 1, 9) == 0.5 + 9 / 64
        and stored_force_z(session, memory, 1, 1) is None
    )
    assert feeder.dropped_frames == 8
    feeder.seek(2, 0)
    memory.receiver["clock"]["needs"] = tag(2, 3)
    feeder.step()
    assert feeder.dropped_frames == 8  # the frames before the target of a seek were not due


class Desk:
    """A simulated servo that ticks while frames are decoded, each in `ticks` ticks."""

    def __init__(
        self, count: int, ticks: int, starts: tuple[int, ...] = (), capacity_frames: float = 1000.0
    ) -> None:
        self.count, self.ticks, self.now_s, self.late, self.decoded = (
            count,
            ticks,
            0.0,
            list[float | None](),
            list[int](),
        )
        medium = replace(numbered_medium(count), make_frame=self.make)
        size_bytes = aligned(FrameSource(numbered_medium()).prepare(0).size_bytes)
        self.session, self.memory = laid_out(
            medium, RenderSpec(render="field"), memory_bytes=int(capacity_frames * size_bytes)
        )
        self.session.source.starts = starts
        self.memory.receiver["clock"]["mode"] = layout.PLAYING
        self.memory.receiver["clock"]["speed"] = 1.0
        self.feeder = Feeder(
            self.session.source, self.memory, self.session.layout, clock_s=lambda: self.now_s
        )
        self.at = -1

    def make(self, frame: int) -> ForceField:
        start = max((s for s in self.session.source.starts if s <= frame), default=frame)
        for decoded in range(self.at + 1 if start <= self.at < frame else start, frame + 1):
            self.decoded.append(decoded)
            for _ in range(self.ticks):
                self.tick()
        self.at = frame
        return numbered_field(frame)

    def tick(self) -> None:
        clock = self.memory.receiver["clock"]
        self.now_s += 0.001
        if clock["feed"] != layout.RUNNING:
            return
        clock["media_s"] += 0.001
        due = int(clock["media_s"] * 50 + 1e-6)
        if due < self.count:
            found = [
                stored_force_z(self.session, self.memory, 1, min(n, self.count - 1)) for n in (due, due + 1)
            ]
            self.late.append(None if found[0] is None or found[1] is None else due - 64 * (found[0] - 0.5))
            clock["needs"] = tag(1, due)

    def play(self) -> None:
        for _ in range(4):
            self.feeder.step()
        self.memory.receiver["clock"]["feed"] = layout.RUNNING
        while self.memory.receiver["clock"]["media_s"] < self.count / 50 + 0.01:
            if not self.feeder.step():
                self.tick()
        assert self.feeder.error is None


@pytest.mark.parametrize(
    ("ticks", "starts"), [(50, ()), (200, ()), (30, tuple(range(0, 500, 5))), (60, tuple(range(0, 500, 10)))]
)
def test_a_slow_stream_drops_frames_and_keeps_time(ticks: int, starts: tuple[int, ...]) -> None:
    desk = Desk(496, ticks, starts, capacity_frames=2.5)  # frames in use are not overwritten
    desk.play()
    delays = [late for late in desk.late if late is not None]
    assert len(desk.late) >= 9910 and len(delays) > 0.95 * len(desk.late)
    assert min(delays) == 0 and max(delays) <= 2.5 * max(ticks / 20, 10)  # a late frame repeats
    assert desk.feeder.dropped_frames > 100 and desk.feeder.dropped_frames + len(set(desk.decoded)) == 496
    assert len(set(desk.decoded)) > 0.3 * 10_000 / ticks


def test_note_does_not_blame_a_sufficient_decoding_rate() -> None:
    desk = Desk(500, 50, ())
    desk.play()
    assert "This machine decodes" in desk.feeder.note and "left out" in desk.feeder.note
    desk.feeder._pace.frame_s = 6.4e-6  # the latest frames were quick: something else delayed the others
    assert "decodes" not in desk.feeder.note and "had to be fetched" in desk.feeder.note


def test_a_fast_stream_drops_no_frame() -> None:
    desk = Desk(500, 15, tuple(range(0, 500, 10)))
    desk.play()
    assert desk.decoded == list(range(500)) and desk.feeder.dropped_frames == 0
    assert set(desk.late) == {0.0}


def test_hopeless_frames_are_not_repeated() -> None:
    desk = Desk(500, 50, (0,))
    desk.play()
    assert desk.late.count(None) > 5000


def test_a_frame_that_does_not_fit_is_one_clear_error() -> None:
    size_bytes = FrameSource(numbered_medium()).prepare(0).size_bytes
    for factor, message in ((0.5, r"frame 0"), (1.5, r"room for two frames")):
        session, memory = laid_out(numbered_medium(3), memory_bytes=int(size_bytes * factor))
        feeder = session.feeder(memory)
        run_dry(feeder)
        assert isinstance(feeder.error, InvalidArgument)
        assert message in str(feeder.error) and "Ask for more memory" in str(feeder.error)
        assert memory.receiver["orders"]["has_feed_failed"]


def test_an_error_of_the_medium_is_stored() -> None:
    session, memory = laid_out(numbered_medium(9, corrupt_from=4))
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 4
    assert isinstance(feeder.error, CorruptFile) and memory.receiver["orders"]["has_feed_failed"]


def test_rigid_bodies_are_written_once() -> None:
    from touchfield.medium import HapticMedium

    track = PoseTrack([[1.0, 0, 0, 0]] * 4, [[0.0, 0, 0.01 * n] for n in range(4)])
    rigid = HapticObject("still", HapticMedium.from_frames([numbered_field(0)], 50.0), track)
    soft = HapticObject("soft", HapticMedium.from_frames([numbered_field(n) for n in range(4)], 50.0), track)
    scene = HapticScene(GRID, 50.0, (rigid, soft), 4.0)
    session, memory = laid_out(scene)  # type: ignore[arg-type]
    feeder = session.feeder(memory)
    assert run_dry(feeder) == 4
    for n in range(4):
        address = entry(session, memory, n)[1]
        for z in (0.0, 0.033, -0.02):
            expected = scene.sample_n(n, [0.001, 0.002, z])
            found = native.force_at(memory.bytes, address, address, 0.0, 0.001, 0.002, z)
            assert found == pytest.approx(expected, abs=1e-6)
    assert FrameSource(HapticScene(GRID, 50.0, (rigid,), 4.0)).prepare(2).size_bytes < 512


def test_the_thread_feeds_and_ends() -> None:
    session, memory = laid_out(numbered_medium(20))
    feeder = session.feeder(memory)
    feeder.start()
    deadline_s = time.monotonic() + 20
    while not feeder.is_preloaded and time.monotonic() < deadline_s:
        time.sleep(0.001)
    assert feeder.is_preloaded
    feeder.seek(2, 5)
    memory.receiver["clock"]["needs"] = tag(2, 5)
    while stored_force_z(session, memory, 2, 19) is None and time.monotonic() < deadline_s:
        time.sleep(0.001)
    assert stored_force_z(session, memory, 2, 19) == 0.5 + 19 / 64
    for _ in range(2):
        feeder.close()
    assert feeder._thread is not None and not feeder._thread.is_alive()

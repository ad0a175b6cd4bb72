"""The ring of frames: room is taken and given back in order, and never twice."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, strategies as st
from player_makers import telling

from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.render.block import PREFIX, Block, Layout, Memory, Ring, check_fits, shared_folder, words as W
from touchfield.render.feeder import FrameSource, arena_word_count
from touchfield.render.player import Session, ramp_limit_s
from touchfield.render.spec import RenderSpec


@given(st.integers(20, 60), st.lists(st.tuples(st.integers(1, 25), st.integers(0, 3)), max_size=40))
def test_what_is_held_never_overlaps(words: int, turns: list[tuple[int, int]]) -> None:
    ring, held = Ring(100, words), {}
    for frame, (size, kept) in enumerate(turns):
        ring.free_before(frame - kept)
        held = {n: piece for n, piece in held.items() if n >= frame - kept}
        at = ring.take(frame, size)
        if at is None:
            assert held or size > words  # an empty ring takes all that it can hold
            continue
        assert at >= 100 and at + size <= 100 + words
        for other, length in held.values():
            assert at + size <= other or other + length <= at
        held[frame] = at, size


def test_a_ring_of_three_frames_holds_two_for_ever() -> None:
    ring = Ring(0, 30)
    for frame in range(50):
        ring.free_before(frame - 1)
        assert ring.take(frame, 10) is not None


def test_a_cleared_ring_is_empty() -> None:
    ring = Ring(7, 10)
    assert ring.take(0, 10) == 7 and ring.take(1, 1) is None
    ring.clear()
    assert ring.take(2, 10) == 7


def test_parts_of_the_block_lie_one_behind_the_other() -> None:
    layout = Layout(1000, slots=16, log_rows=32)
    assert W.FREE < layout.log < layout.arena == layout.words - 1000
    memory = Memory.empty(layout.words)
    layout.write(memory, 7, 30.0, True, 500.0)
    assert memory.i8[W.TICK_NS] == 2_000_000 and memory.f8[W.FRAME_RATE_HZ] == 30.0
    assert (memory.i8[W.FREE : layout.log : W.DIRECTORY_WORDS] == -1).all()


def test_no_more_memory_than_the_medium_needs() -> None:
    few, many = FrameSource(telling(2)), FrameSource(telling(2000))
    assert arena_word_count(few, 1 << 40) < arena_word_count(many, 1 << 40)
    assert arena_word_count(many, 1 << 20) == 1 << 17
    slots = [
        Session(telling(2000), device("phantom-omni"), RenderSpec(), speed=s).layout.slots
        for s in (0.1, 1, 9)
    ]
    assert slots == [256, 256, 2048], "frames of four seconds of the hand, and no fewer than that"
    with pytest.raises(InvalidArgument, match=r"memory_bytes.*frame 3.*Ask for more memory"):
        check_fits(11, 10, "frame 3")


def test_a_ramp_is_given_up_at_last() -> None:
    assert ramp_limit_s(4.0, 800.0, 0.02) == pytest.approx(1.03)
    assert ramp_limit_s(4.0, 1e-9, 0.02) == 10.0


@pytest.mark.parametrize("slow", [{"slew_n_per_s": 25.0}, {"slew_nm_per_s": 0.5}])
def test_of_force_and_torque_the_slower_ramp_is_waited_for(slow: dict[str, float]) -> None:
    sigma = replace(device("sigma.7"), force_max_n=20.0, torque_max_nm=0.4)
    session = Session(telling(1), sigma, RenderSpec(**slow))  # type: ignore[arg-type]
    memory = Memory.empty(session.layout.words)
    session.set_up(memory)
    assert memory.i8[W.RAMP_LIMIT_NS] == pytest.approx(1e9 * (1.02 + 1.6))


def test_a_block_is_seen_by_both_and_leaves_nothing() -> None:
    before = set(shared_folder().glob(PREFIX + "*"))
    one = Block.create(W.FREE)
    one.reserve(W.FREE)
    other = Block.attach(one.path)
    one.unlink()
    one.memory.f8[17] = 2.5
    assert other.memory.f8[17] == 2.5 and other.memory.words == W.FREE
    view = other.memory.f8
    for _ in range(2):
        one.close()
        other.close()
    assert view[17] == 2.5  # whoever still looks at it can
    assert set(shared_folder().glob(PREFIX + "*")) == before


def test_a_block_without_room_is_one_clear_error() -> None:
    before = set(shared_folder().glob(PREFIX + "*"))

    def ask() -> None:
        block = Block.create(1 << 45)  # where such a file can be named, its room cannot be had
        try:
            block.reserve(1 << 45)
        finally:
            block.unlink()
            block.close()

    with pytest.raises(InvalidArgument, match="shared memory"):
        ask()
    assert set(shared_folder().glob(PREFIX + "*")) == before

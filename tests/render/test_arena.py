"""The ring of frames: space is allocated and freed in order, and never shared."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, strategies as st
from player_makers import numbered_medium

from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.render.block import (
    PREFIX,
    Block,
    Layout,
    Memory,
    Ring,
    aligned,
    check_fits,
    layout,
    shared_folder,
)
from touchfield.render.feeder import FrameSource, arena_bytes
from touchfield.render.player import Session
from touchfield.render.spec import RenderSpec, write_parameters

LINE = aligned(1)  # bytes of a cache line, where every frame starts


@given(st.integers(20, 60), st.lists(st.tuples(st.integers(1, 25), st.integers(0, 3)), max_size=40))
def test_allocations_never_overlap(line_count: int, turns: list[tuple[int, int]]) -> None:
    ring, allocated = Ring(100, LINE * line_count), {}
    for frame, (size, stored_frames) in enumerate(turns):
        ring.free_before(frame - stored_frames)
        allocated = {n: piece for n, piece in allocated.items() if n >= frame - stored_frames}
        size *= LINE
        at = ring.take(frame, size)
        if at is None:
            assert allocated or size > LINE * line_count  # an empty ring accepts anything up to its size
            continue
        assert at >= 100 and at + size <= 100 + LINE * line_count
        for other, length in allocated.values():
            assert at + size <= other or other + length <= at
        allocated[frame] = at, size


def test_a_ring_of_three_frames_stores_two_for_ever() -> None:
    ring = Ring(0, 3 * LINE)
    for frame in range(50):
        ring.free_before(frame - 1)
        assert ring.take(frame, LINE) is not None


def test_a_cleared_ring_is_empty() -> None:
    ring = Ring(7, LINE)
    assert ring.take(0, LINE) == 7 and ring.take(1, 1) is None
    ring.clear()
    assert ring.take(2, LINE) == 7


def test_parts_of_the_block_are_contiguous() -> None:
    block = Layout(8000, slots=16, log_rows=32)
    assert block.directory < block.log < block.arena == block.size_bytes - 8000
    memory = Memory.empty(block.size_bytes)
    block.write(memory, 7, 30.0, True, 500.0)
    written = memory.receiver["layout"]
    assert written["tick_ns"] == 2_000_000 and written["frame_rate_hz"] == 30.0
    assert (memory.array(layout.DIRECTORY_ENTRY, block.directory, 16)["tag"] == -1).all()


def test_the_block_is_no_larger_than_the_medium_needs() -> None:
    few, many = FrameSource(numbered_medium(2)), FrameSource(numbered_medium(2000))
    assert arena_bytes(few, 1 << 40) < arena_bytes(many, 1 << 40)
    assert arena_bytes(many, 1 << 20) == 1 << 20
    slots = [
        Session(numbered_medium(2000), device("phantom-omni"), RenderSpec(), speed=s).layout.slots
        for s in (0.1, 1, 9)
    ]
    assert slots == [256, 256, 2048], "frames of four seconds of the hand, and no fewer than that"
    with pytest.raises(InvalidArgument, match=r"memory_bytes.*frame 3.*Ask for more memory"):
        check_fits(11, 10, "frame 3")


@pytest.mark.parametrize(("slew_n_per_s", "limit_s"), [(800.0, 1.03), (1e-9, 10.0)])
def test_a_ramp_has_a_time_limit(slew_n_per_s: float, limit_s: float) -> None:
    strong = replace(device("sigma.7"), force_max_n=4.0, force_continuous_n=None, torque_max_nm=None)
    memory = Memory.empty(layout.RECEIVER.itemsize)
    write_parameters(memory, RenderSpec(ramp_s=0.02, slew_n_per_s=slew_n_per_s), strong, 0.0, 0.0, "")
    assert memory.receiver["layout"]["ramp_limit_ns"] == pytest.approx(1e9 * limit_s)


@pytest.mark.parametrize("slow", [{"slew_n_per_s": 25.0}, {"slew_nm_per_s": 0.5}])
def test_the_ramp_limit_is_that_of_the_slower_of_force_and_torque(slow: dict[str, float]) -> None:
    sigma = replace(device("sigma.7"), force_max_n=20.0, torque_max_nm=0.4)
    session = Session(numbered_medium(1), sigma, RenderSpec(**slow))  # type: ignore[arg-type]
    memory = Memory.empty(session.layout.size_bytes)
    session.set_up(memory)
    assert memory.receiver["layout"]["ramp_limit_ns"] == pytest.approx(1e9 * (1.02 + 1.6))


def test_a_block_is_shared_and_leaves_no_file() -> None:
    before = set(shared_folder().glob(PREFIX + "*"))
    size_bytes = layout.RECEIVER.itemsize
    created = Block.create(size_bytes)
    created.reserve(size_bytes)
    attached = Block.attach(created.path)
    created.unlink()
    created.memory.receiver["clock"]["media_s"] = 2.5
    assert attached.memory.receiver["clock"]["media_s"] == 2.5 and attached.memory.size_bytes == size_bytes
    view = attached.memory.receiver["clock"]
    for _ in range(2):
        created.close()
        attached.close()
    assert view["media_s"] == 2.5  # a remaining view stays valid
    assert set(shared_folder().glob(PREFIX + "*")) == before


def test_a_block_without_space_is_one_clear_error() -> None:
    before = set(shared_folder().glob(PREFIX + "*"))

    def ask() -> None:
        block = Block.create(1 << 45)  # where the file can be created, its space cannot be allocated
        try:
            block.reserve(1 << 45)
        finally:
            block.unlink()
            block.close()

    with pytest.raises(InvalidArgument, match="shared memory"):
        ask()
    assert set(shared_folder().glob(PREFIX + "*")) == before

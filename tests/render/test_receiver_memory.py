"""The compiled module on the memory of a receiver: what it refuses, and the check of its layout."""

from __future__ import annotations

import pytest
from tick_makers import Bench, constant

from touchfield.compute.native import native
from touchfield.errors import TouchfieldError
from touchfield.render.block import Memory, check_layout, layout

CALLS = {
    "tick": (0, 0, 0.0, 0.0, 0.0, 0.0, 0.001),
    "release": (0.001,),
    "cycle": (0.0, 0.0, 0.0, 1),
    "limited": (0.0, 0.0, 1.0, 0.001),
    "contact_force": (0, 0, 0.0, 0.0, 0.0, 0.0),
    "give_order": (1, 0.0, 1.0, 1, 0),
    "publish": (1, 0, 0),
}
"""Functions that take the memory of a receiver, and further arguments."""


@pytest.mark.parametrize("name", CALLS)
def test_memory_that_is_no_receiver_is_refused(name: str) -> None:
    function, size = getattr(native, name), layout.RECEIVER.itemsize
    for memory in (bytearray(size - 1), bytearray(0), Memory.empty(size + 8).bytes[4:]):
        with pytest.raises(ValueError, match="too small for a receiver, or not aligned"):
            function(memory, *CALLS[name])
    with pytest.raises((BufferError, ValueError)):
        function(bytes(size), *CALLS[name])  # a tick writes
    with pytest.raises(ValueError, match="another number of arguments"):
        function(Memory.empty(size).bytes, *CALLS[name], 0)
    with pytest.raises(TypeError):
        function(Memory.empty(size).bytes, *(None for _ in CALLS[name]))


@pytest.mark.parametrize("offset", [-8, 4, 1 << 40, layout.RECEIVER.itemsize])
def test_a_frame_outside_of_the_memory_is_refused(offset: int) -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    for before, after in ((offset, 0), (0, offset)):
        with pytest.raises(ValueError, match="outside of the memory"):
            native.tick(memory.bytes, before, after, 0.0, 0.0, 0.0, 0.0, 0.001)
    with pytest.raises(ValueError, match="outside of the memory"):
        native.publish(memory.bytes, 1, 0, offset)
    assert not memory.bytes.any()


def test_a_module_with_other_structs_is_refused() -> None:
    rows = native.receiver_layout()
    check_layout(rows)
    (index,) = (n for n, (name, _) in enumerate(rows) if name == "touch_settings.friction")
    moved = [*rows[:index], (rows[index][0], rows[index][1] + 8), *rows[index + 1 :]]
    for other in (moved, rows[1:], [("version", 0), *rows[1:]], [*rows, ("touch_settings.added", 8)]):
        with pytest.raises(TouchfieldError, match="other structs of a receiver"):
            check_layout(other)


def test_the_log_may_be_left_out() -> None:
    """A receiver of an engine without a log has no rows to write."""
    bench = Bench(constant(0.0, 0.0, 1.0))
    bench.memory.receiver["layout"]["tick_ns"] = 1_000_000
    bench.memory.receiver["layout"]["directory_slots"] = 1
    before = bench.memory.bytes[layout.RECEIVER.itemsize :].copy()
    native.cycle(bench.memory.bytes, 0.0, 0.0, 0.0, 1)
    assert bench.value("counts.ticks") == 1 and bench.value("clock.log_written") == 0
    assert (bench.memory.bytes[layout.RECEIVER.itemsize :] == before).all()

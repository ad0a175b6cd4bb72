"""The compiled module on the memory of a receiver: what it refuses, and the check of its layout."""

from __future__ import annotations

import numpy as np
import pytest
from tick_makers import Bench, constant

from touchfield.compute.native import native
from touchfield.errors import TouchfieldError
from touchfield.medium import ForceField, Grid
from touchfield.medium.cells import CellPool
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


def test_settings_of_another_size_are_refused() -> None:
    memory = Memory.empty(layout.RECEIVER.itemsize)
    options, stated = np.zeros((), layout.RENDER_OPTIONS), np.zeros((), layout.DEVICE)
    for wrong in ((options.tobytes()[:-8], stated), (options, stated.tobytes() + bytes(8))):
        with pytest.raises(ValueError, match="another size"):
            native.choose_settings(memory.bytes, *wrong, 0.0, 0.0)
        with pytest.raises(ValueError, match="another size"):
            native.choose_stability(*wrong, 0.0, 0.0)
    with pytest.raises(ValueError, match="too small for a receiver"):
        native.choose_settings(memory.bytes[8:], options, stated, 0.0, 0.0)
    assert not memory.bytes.any()


def test_cells_of_another_size_are_refused() -> None:
    field = ForceField.from_dense(Grid((9, 9, 9), (1e-3,) * 3, (0.0,) * 3), np.ones((9, 9, 9, 3), np.float32))
    pool = CellPool.of(field)
    edge_n_per_m = 1.0 / 1e-3
    assert native.stiffest_slope(pool.field_data, len(pool.bricks)) == pytest.approx(edge_n_per_m, rel=0.04)
    lattice = field.grid.spacing_m, field.grid.origin_m
    for data, count in (
        (pool.field_data[:-8], len(pool.bricks)),
        (pool.field_data, 1),
        (pool.field_data, -1),
    ):
        with pytest.raises(ValueError, match="cells of another size"):
            native.stiffest_slope(data, count)
        with pytest.raises(ValueError, match="cells of another size"):
            native.find_wall(field.bricks, field.forces_n, *lattice, data, count)


@pytest.mark.parametrize(
    ("spec", "stated_n_per_m"),
    [
        ('{"law": "penalty", "stiffness_n_per_m": 700}', 700.0),
        ('\n{"stiffness_n_per_m" : 7.5e2 ,"law":"penalty"} ', 750.0),
        ('{"law":"penalty","stiffness_n_per_m":0.1234567890123e4}', 1234.567890123),
        ('{"law":"penalty","stiffness_n_per_m":12345e-2,"other":[1,{"stiffness_n_per_m":9}]}', 123.45),
        ('{"other":{"law":"penalty"},"law":"constant","stiffness_n_per_m":700}', 0.0),
        ('{"a":"\\"law\\":\\"constant\\",","law":"penalty","stiffness_n_per_m":700,"b":"}"}', 700.0),
        ('{"law":"penalty","stiffness_n_per_m":1,"stiffness_n_per_m":800}', 800.0),  # as json.loads
        ('{"law":"penalty","stiffness_n_per_m":"700"}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":-700}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":7e400}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":NaN}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":7.}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":}', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":700', 0.0),
        ('{"law":"penalty","stiffness_n_per_m":700}}', 0.0),
        ('["law","penalty"]', 0.0),
        ('{"law":"pena\\', 0.0),
        ("[" * 5000, 0.0),
        ("", 0.0),
    ],
)
def test_a_specification_states_the_stiffness_of_walls(spec: str, stated_n_per_m: float) -> None:
    assert native.specified_wall(spec.encode()) == stated_n_per_m

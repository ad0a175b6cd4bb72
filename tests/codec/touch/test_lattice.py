"""The lattice of coder `touch`: integers near the values they represent, within the declared widths."""

from __future__ import annotations

from dataclasses import fields, replace
from typing import Any

import numpy as np
import pytest
from field_makers import GRID, field_of, round_trip
from hypothesis import given, strategies as st
from native_model import StepTable, axes_and_vector, lattice_for, root

from touchfield.codec.touch.body import MIN_FLOOR, MIN_RATE, BodyReader, Lattice, write_body
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.errors import CorruptFile
from touchfield.medium import ForceField

LATTICES = ((21, 0), (1, 64), (1, 131071), (700, 7405), (65535, 0), (65535, 131071), (37, 1))
SPECS = (
    TouchSpec(),
    TouchSpec(f0_n=0.0),
    TouchSpec(mode="mask-direction"),
    TouchSpec(k=0.001, f0_n=1e-6),
    TouchSpec(mode="nmse", step_n=0.02),
    TouchSpec(f0_n=100.0),
)


@given(st.integers(0, (1 << 52) - 1), st.integers(0, (1 << 26) - 1))
def test_roots_are_exact(n: int, s: int) -> None:
    for m in (n, s * s, max(0, s * s - 1), s * s + 2 * s):
        assert root(m) ** 2 <= m < (root(m) + 1) ** 2


@pytest.mark.parametrize(("floor", "rate"), LATTICES)
def test_lengths_round_trip_through_the_warp(floor: int, rate: int) -> None:
    """Lengths round-trip within 1/256 of a step; the map is odd; a step apart stays about a step apart."""
    table = StepTable(floor, rate)
    border = table.border
    assert border[0] == 0 and (np.diff(border) > 0).all() and border[-1] > 1 << 26
    rng = np.random.default_rng(floor)
    for a in (0, 1, 5, 31, 32, 1000, 65536, (1 << 18) - 1, *rng.integers(1 << 18, size=50).tolist()):
        level, step = table.level_of(a), max(floor, a * rate >> 16, 1)
        restored = table.length_of(level)
        assert abs(restored - a) <= step / 200 + 1
        assert table.length_of(-level) == -restored
        assert table.level_of(min(a + step, (1 << 18) - 1)) >= level
    assert abs(table.length_of(1 << 40)) <= border[-1] >> 8


@given(st.lists(st.integers(-(1 << 17) + 1, (1 << 17) - 1), min_size=3, max_size=3), st.integers(0, 17))
def test_axes_are_of_unit_length_and_across(vector: list[int], shift: int) -> None:
    p = np.array(vector, np.int64) >> shift
    if not p.any():
        p[2] = 1
    scaled, rebuilt = axes_and_vector(p.tolist(), 10_000, -300, 70)
    axes = scaled / 16384
    exact = p / np.linalg.norm(p)
    rough = 2e-4 + 1 / np.linalg.norm(p)  # the length is rounded to an integer
    assert np.abs(axes[0] - exact).max() < rough
    assert np.abs(axes @ axes.T - np.eye(3)).max() < 4 * rough
    assert np.abs(rebuilt - np.array([10_000, -300, 70]) @ axes).max() <= 0.5 + 1e-6
    _, largest = axes_and_vector(p.tolist(), 1 << 30, 1 << 30, -(1 << 30))
    assert np.abs(largest).max() < 1 << 17


@pytest.mark.parametrize("longest", [0.0, 1e-42, 1e-3, 3.3, 1e30])
@pytest.mark.parametrize("spec", SPECS)
def test_lattices_contain_the_longest_force(longest: float, spec: TouchSpec) -> None:
    lattice = lattice_for(spec, longest)
    assert lattice.unit_n == np.float32(lattice.unit_n) > 0
    assert longest <= lattice.unit_n * 65536 * (1 + 1e-6)
    body = TouchEncoder(GRID, spec).encode_segment([ForceField.empty(GRID)], longest_n=longest).body
    stored = BodyReader(body, GRID, exact=False).lattice  # the reader validates it
    assert stored == Lattice(*(getattr(lattice, field.name) for field in fields(Lattice)))


def test_lattices_fit_the_mask() -> None:
    lattice = lattice_for(SPECS[0], 3.3)
    # only a cell's corners may be outside the ball
    assert 0.95 < lattice.floor * lattice.unit_n * np.sqrt(3) / 2 / 0.05 < 1.05
    assert 0.95 < lattice.rate / 65536 * np.sqrt(3) / 2 / 0.1 < 1.05
    wide = lattice_for(SPECS[2], 3.3)
    assert 1.5 * lattice.rate < wide.rate < 65536 * 2 * 0.1
    assert 0.9 < wide.cross_rate / 65536 / np.sqrt(2) / np.sin(np.radians(18.4)) < 1


@pytest.mark.parametrize("longest", [1e-3, 3.3, 1e30])
@pytest.mark.parametrize(
    "options",
    [{"k": 0.001, "f0_n": 0.0}, {"k": 0.001, "f0_n": 0.0, "mode": "mask-direction"}, {"mode": "nmse"}],
)
def test_lattice_tables_are_short(options: dict[str, Any], longest: float) -> None:
    lattice = lattice_for(replace(TouchSpec(step_n=1e-9), **options), longest)
    assert 1000 < len(StepTable(lattice.floor, lattice.rate).border) <= 200_000
    for floor, rate in ((MIN_FLOOR, 0), (MIN_FLOOR, 3), (1, MIN_RATE)):
        assert len(StepTable(floor, rate).border) <= 200_000


def test_lattice_with_a_long_table_is_refused() -> None:
    decoder = round_trip([field_of("one", 1, GRID)], TouchSpec())[1]
    for floor, rate in ((MIN_FLOOR - 1, MIN_RATE - 1), (1, 0)):
        with pytest.raises(CorruptFile, match="a floor and a rate that are too fine"):
            list(decoder.frames(write_body(Lattice(1e-4, floor, rate, 1, 0), [], None), 0))
    assert list(decoder.frames(write_body(Lattice(1e-4, 1, MIN_RATE, 1, 0), [], None), 0)) == []

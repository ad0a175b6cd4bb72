"""The argument of --vibration, and vibrations of frames."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, strategies as st

from touchfield.devices import device
from touchfield.errors import InvalidArgument
from touchfield.filters.contact import VibrationRule, add_vibration
from touchfield.filters.device_filter import device_medium
from touchfield.filters.device_spec import DeviceFilter
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.grid import Placement
from touchfield.sources.laws import LawSpec, profile_of
from touchfield.sources.stored import StoredScene

GRID = Grid((3, 4, 5), (0.001, 0.002, 0.0015), (0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    ("text", "rule"),
    [
        ("", VibrationRule()),
        ("gain=0.2", VibrationRule(gain=0.2)),
        ("frequency=60", VibrationRule(low_hz=60, high_hz=60)),
        (" frequency = 80 .. 250 , gain = 1", VibrationRule(1, 80, 250)),
        ("frequency=250..80", VibrationRule(low_hz=250, high_hz=80)),
    ],
)
def test_texts_make_rules(text: str, rule: VibrationRule) -> None:
    assert VibrationRule.parse(text) == rule


@pytest.mark.parametrize(
    "text",
    [
        "0.1",
        "gain",
        "gain=x",
        "gain=0",
        "gain=-1",
        "gain=nan",
        "gain=inf",
        "gain=1,gain=2",
        "hz=3",
        "gain=1..2",
        "frequency=1..2..3",
        "frequency=0",
        "frequency=20000",
        "frequency=80..20000",
        "frequency=..",
        "frequency=nan",
    ],
)
def test_invalid_texts_are_refused(text: str) -> None:
    with pytest.raises(InvalidArgument, match="--vibration"):
        VibrationRule.parse(text)


@given(text=st.text(max_size=30))
def test_any_text_is_a_rule_or_an_error(text: str) -> None:
    try:
        rule = VibrationRule.parse(text)
    except InvalidArgument:
        return
    assert rule.gain > 0


def test_frequency_saturates_at_f_max_and_weak_forces_are_omitted() -> None:
    forces = np.zeros((*GRID.shape, 3), np.float32)
    forces[0, 0, :3, 2] = (1, 2, 4)
    forces[2, 3, 4, 0] = 1e-40
    field = ForceField.from_dense(GRID, forces)
    frame = VibrationRule(1e-6, 100, 200).of(field, 2.0)
    np.testing.assert_array_equal(frame.frequencies_hz, [150, 200, 200])
    np.testing.assert_allclose(frame.amplitudes_n, [1e-6, 2e-6, 4e-6], rtol=1e-6)


def test_each_frame_is_computed_once_for_force_and_vibration() -> None:
    calls = []

    def make(i: int) -> ForceField:
        calls.append(i)
        return ForceField.from_dense(GRID, np.full((*GRID.shape, 3), 1 + i, np.float32))

    medium = add_vibration(HapticMedium(GRID, 10.0, 3, make), VibrationRule(), 3.3)
    assert medium.vibration is not None
    for i in range(3):
        assert medium[i].support_count == len(medium.vibration(i)) == GRID.voxel_count
    assert calls == [0, 1, 2]


def test_lattice_that_differs_by_rounding_has_the_vibration() -> None:
    medium = add_vibration(HapticMedium.from_frames([ForceField.empty(GRID)], 10.0), VibrationRule(), 3.3)
    x, y, z = GRID.origin_m
    shifted = Grid(GRID.shape, GRID.spacing_m, (x + 1e-10, y, z))
    mapping = DeviceFilter(device("phantom-omni"), shifted, Placement(), profile_of(LawSpec(), 0.01))
    passed = device_medium(StoredScene(medium), mapping)
    assert passed.grid == shifted and passed.vibration is not None and passed.vibration(0).grid == shifted

"""An offline run: a row of the log for every tick, and frames that are ready at every tick."""

from __future__ import annotations

import numpy as np
import pytest

from touchfield.devices import device
from touchfield.devices.drivers.simulated import SimHand
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.render.offline import run_offline

GRID = Grid((8, 8, 8), (0.002,) * 3, (-0.007,) * 3)


def test_a_long_run_has_a_row_for_every_tick() -> None:
    """The log is a ring that is drained before it wraps; here it would wrap twice."""
    medium = HapticMedium.from_frames([ForceField.empty(GRID)], 60.0)
    run = run_offline(medium, device("phantom-omni"), SimHand, seconds=17.0)
    assert len(run.log) == 17_001  # the last tick sets the force to zero
    np.testing.assert_allclose(np.diff(run.log["time_s"]), 0.001, atol=1e-9)


@pytest.mark.parametrize("medium_hz", [30.0, 1000.0])
@pytest.mark.parametrize("speed", [0.3, 1.0, 5.0, 20.0])
def test_frames_are_ready_at_every_speed(medium_hz: float, speed: float) -> None:
    """Each tick renders the two frames around its time, of a force that increases frame by frame."""
    seconds, wide = 0.05, Grid((8, 8, 8), (0.02,) * 3, (-0.07,) * 3)
    newtons = np.linspace(0.1, 0.2, int(seconds * speed * medium_hz) + 3)
    frames = [
        ForceField.from_dense(wide, np.full((8, 8, 8, 3), [0, 0, force_n], np.float32)) for force_n in newtons
    ]
    medium = HapticMedium.from_frames(frames, medium_hz)
    run = run_offline(medium, device("phantom-omni"), SimHand, seconds=seconds, speed=speed)
    assert run.statistics["underruns"] == 0
    log = run.log[:50]
    assert log["media_s"][-1] == pytest.approx(0.049 * speed, abs=1e-9)
    expected = np.interp(log["media_s"] * medium_hz, np.arange(len(newtons)), newtons)
    np.testing.assert_allclose(log["field_force_n"][:, 2], expected, atol=1e-6)

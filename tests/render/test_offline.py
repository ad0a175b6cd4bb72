"""An offline run: the log has a row for every tick, for any duration."""

from __future__ import annotations

import numpy as np

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

"""One tick: the field's force where the hand is, effects, mapping to the device, ramps."""

from __future__ import annotations

import numpy as np
import pytest
from tick_makers import OMNI, Bench, constant, linear, wall

from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render import places
from touchfield.render.memory import Memory
from touchfield.render.parameters import write_parameters
from touchfield.render.spec import RenderSpec


def test_a_hand_at_rest_gets_the_force_of_the_field() -> None:
    bench = Bench(wall(100.0))
    force = bench.settled(0.01, 0.02, -0.012)
    assert force == pytest.approx([0, 0, 1.2], abs=1e-6)
    assert bench.state(places.FIELD_FORCE) == pytest.approx(force)
    assert bench.state(places.POSITION) == pytest.approx([0.01, 0.02, -0.012])
    assert not bench.state(places.VELOCITY).any()
    assert bench.word(places.GAIN) == 1
    assert not bench.settled(0.0, 0.0, 0.02).any()
    assert not bench.settled(9e9, 0.0, -0.02).any()


if __name__ == "__main__":
    pytest.main([__file__])

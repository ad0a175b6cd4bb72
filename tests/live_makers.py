"""Segments of a small live stream in which each field encodes its number."""

from __future__ import annotations

from functools import cache

import numpy as np

from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import Head
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.network.live import LiveSegment, LiveSender  # fmt: skip

GRID = Grid((16, 16, 16), (0.01,) * 3, (-0.075,) * 3)

ENCODER = TouchEncoder(GRID, TouchSpec(effort="fast"))

HEAD = Head(
    grid_shape=GRID.shape,
    spacing_m=GRID.spacing_m,
    origin_m=GRID.origin_m,
    rate_hz=50.0,
    frame_count=1,
    axes="x right, y up, z towards the user",
    device_name="phantom-omni",
    device_type=1,
    force_max_n=3.3,
    mapping_scale=1.0,
    mapping_offset_m=(0.0, 0.0, 0.0),
    weber_fraction=0.1,
    force_threshold_n=0.05,
    friction=0.0,
    damping_n_s_per_m=0.0,
    tags=("direct",),
    coder="touch",
    coder_parameters=ENCODER.parameters,
)


MODEL = """
<mujoco>
  <option timestep="0.001"/>
  <worldbody>
    <geom name="floor" type="plane" size="0.1 0.1 0.01"/>
    <body name="ball" pos="0 0 0.03" euler="10 0 0">
      <freejoint/>
      <geom type="sphere" size="0.02" density="500"/>
    </body>
    <body name="lever" pos="0.05 0 0.03" euler="0 0 20">
      <joint name="hinge" type="hinge" axis="0 1 0"/>
      <geom type="box" pos="0.01 0 0" size="0.015 0.008 0.008" density="500"/>
    </body>
  </worldbody>
  <actuator><motor joint="hinge" gear="1"/></actuator>
</mujoco>
"""
"""A MuJoCo model of a ball that falls onto a floor, and a lever that swings and has a motor."""


def field(number: int) -> ForceField:
    """A field whose height encodes its number."""
    dense = np.zeros((16, 16, 16, 3), np.float32)
    dense[:, :, : 2 + number % 12] = (0, 0, 2)
    return ForceField.from_dense(GRID, dense)


@cache
def segment(first: int, count: int = 5) -> LiveSegment:
    return LiveSegment(first, count, ENCODER.encode_segment([field(first + i) for i in range(count)]).body)


def sender_of(count: int) -> tuple[LiveSender, list[bytes]]:
    sender = LiveSender()
    sender.open(HEAD, {"source": "test"})
    return sender, [sender.opening, *(sender.add(segment(5 * i)) for i in range(count))]


class Hand:
    """A player with a simulated clock."""

    def __init__(self, media_s: float) -> None:
        self.media_s, self.speed = media_s, 1.0

    def seek(self, time_s: float) -> None:
        self.media_s = time_s

    def set_speed(self, speed: float) -> None:
        self.speed = speed


def medium() -> HapticMedium:
    return HapticMedium.from_frames([field(i) for i in range(50)], 50.0, HEAD.axes)

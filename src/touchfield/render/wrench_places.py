"""Where the words of a tool, of how the hand is turned, and of the torque lie in the block, as `places` for forces.

*set* before the servo begins; *device*: told by the device before each tick; *tick*: left by `kernels.tick`.
"""

from __future__ import annotations

from typing import Final

from touchfield.render.memory import WRENCH

# -- set ------------------------------------------------------------------------------------------------------

TOOL: Final = WRENCH
"""i8: the first word of the tool's numbers (`render.tool`)."""
TOOL_POINTS: Final = WRENCH + 1
"""i8: how many; 0: the hand is a point."""
TOOL_SHARE: Final = WRENCH + 2
"""What a point of the tool that faces its force adds of it."""
TOOL_REACH: Final = WRENCH + 3
"""The farthest of its points from the device's, metres."""
HANDEDNESS: Final = WRENCH + 4
"""1 or -1: of the matrix `places.AXES`; a torque changes its sign where an axis is mirrored."""
TORQUE_PEAK: Final = WRENCH + 5
"""Newton metres; 0: the device shows none."""
TORQUE_CONTINUOUS: Final = WRENCH + 6
"""0: none."""
TORQUE_SLEW: Final = WRENCH + 7

# -- device ---------------------------------------------------------------------------------------------------

ORIENTATION: Final = WRENCH + 12
"""Unit quaternion w, x, y, z: device's axes from the grip's."""
BUTTONS: Final = WRENCH + 16
"""i8: bit n is button n."""
GRIPPER_M: Final = WRENCH + 17
"""How far it is open."""

# -- tick -----------------------------------------------------------------------------------------------------

TURN: Final = WRENCH + 24
"""Nine words, row by row: what turns a vector of the tool into one of the field."""
FIELD_TORQUE: Final = WRENCH + 33
"""What the field gives about the device's point, newton metres, the field's axes."""
WANTED_TORQUE: Final = WRENCH + 36
"""The torque before gain and limits, newton metres, the device's axes."""
TORQUE: Final = WRENCH + 39
"""The torque handed out, newton metres, the device's axes."""
TORQUE_HEAT: Final = WRENCH + 42
TORQUE_LIMIT: Final = WRENCH + 43

WRENCH_WORDS: Final = 44

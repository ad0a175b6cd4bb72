"""Where parameters and state of one tick lie in the block: words of float64 (`touchfield.render.memory`).

Triples take three words each, x first. Plain numbers in a file without compiled code, so that who writes parameters
or reads the state for a log needs no compiler; `kernels` take them as constants.
"""

from __future__ import annotations

from typing import Final

from touchfield.render.memory import PARAMETERS, STATE

# -- parameters, written by `parameters.write_parameters` -----------------------------------------------------

RATE_HZ: Final = PARAMETERS
FRICTION: Final = PARAMETERS + 1
"""mu."""
DAMPING: Final = PARAMETERS + 2
"""b, N s/m."""
SLIP_SPEED: Final = PARAMETERS + 3
COUPLING: Final = PARAMETERS + 4
"""K, N/m; 0: none."""
BRAKE: Final = PARAMETERS + 5
"""Of the damper in contact, N s/m."""
PASSIVITY: Final = PARAMETERS + 6
"""1: controlled, 0: observed only."""
SCALE: Final = PARAMETERS + 7
CLUTCH: Final = PARAMETERS + 8
FORCE_SCALE: Final = PARAMETERS + 11
GRAVITY: Final = PARAMETERS + 12
AXES: Final = PARAMETERS + 15
"""Nine words, row by row: what turns a vector of the device into one of the field."""
PEAK: Final = PARAMETERS + 24
CONTINUOUS: Final = PARAMETERS + 25
"""0: none."""
SLEW: Final = PARAMETERS + 26
THERMAL_S: Final = PARAMETERS + 27
RAMP_S: Final = PARAMETERS + 28
CUTOFF: Final = PARAMETERS + 29
"""Of the velocity, rad/s."""
DELAY: Final = PARAMETERS + 30
"""After so many ticks what is put out acts on the hand; 0 to `MOST_DELAY`, perhaps between whole ones."""

MOST_DELAY: Final = 4.0
WALL: Final = PARAMETERS + 31
"""Stiffness of the walls that the proxy meets, N/m; 0: the field is rendered as it is."""
WALL_LEVEL: Final = PARAMETERS + 32
"""Force at which a surface lies, newtons."""
WALL_SPACING: Final = PARAMETERS + 33
"""Of the field's samples along x, y, z, metres."""

PARAMETER_WORDS: Final = 36

# -- state, left by `kernels.tick` ----------------------------------------------------------------------------

IS_STARTED: Final = STATE
"""1 once a position was seen."""
SINCE_S: Final = STATE + 1
"""Time since the latest position that could be used."""
DEVICE_POSITION: Final = STATE + 2
"""That position, metres, the device's axes."""
POSITION: Final = STATE + 5
"""The same in the field, metres."""
VELOCITY: Final = STATE + 8
"""In the field, m/s."""
FIELD_FORCE: Final = STATE + 11
"""What the field gives to the hand, newtons, the field's axes; with a coupling, what this gives."""
FRICTION_FORCE: Final = STATE + 14
"""Newtons, the field's axes, without damping."""
WANTED: Final = STATE + 17
"""The force before gain and limits, newtons, the device's axes."""
FORCE: Final = STATE + 20
"""The force handed out, newtons, the device's axes."""
GAIN: Final = STATE + 23
"""0 without frames, 1 with them, between on the way."""
HEAT: Final = STATE + 24
"""Of |F|^2, N^2."""
LIMIT: Final = STATE + 25
"""Of |F| at present, newtons."""
ENERGY: Final = STATE + 26
"""What the hand put into the device and did not get back, joules, without the steady force of gravity."""
PHASE: Final = STATE + 27
"""Of the vibration, radians."""
IS_COUPLED: Final = STATE + 28
"""1 while the proxy has a place."""
PROXY: Final = STATE + 29
"""Its place in the field, metres."""
PROXY_STEP: Final = STATE + 32
"""How far it went in the latest tick, metres."""
PROXY_PULL: Final = STATE + 35
"""What pulled it there, newtons."""
PROXY_STIFFNESS: Final = STATE + 38
"""What is added because the proxy went too far, N/m."""
PROXY_HAND: Final = STATE + 39
"""Where the hand was then, metres."""
BRAKE_NOW: Final = STATE + 42
"""The damper in contact on its way to `BRAKE`, N s/m."""
SOFTNESS: Final = STATE + 43
"""One by the coupling's stiffness on its way to `COUPLING`, m/N; 0: none."""
PAST_FORCES: Final = STATE + 44
"""The force handed out and the five before it, the latest first, without gravity, newtons, the device's axes."""

IS_HELD: Final = STATE + 62
"""1 while the proxy is at a surface and not at the hand."""
PROXY_PART: Final = STATE + 63
"""The part of the frame that carries it; -1: none."""
PROXY_LOCAL: Final = STATE + 64
"""Its place in the axes of that part, metres."""

STATE_WORDS: Final = 67

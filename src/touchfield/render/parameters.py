"""What one tick needs to know, written into the block before the servo starts: `RenderSpec`, device, medium.

Nothing here may be called while a servo runs: the state of the tick begins anew, and with it the last force.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.errors import DeviceError, InvalidArgument
from touchfield.render import places, wrench_places
from touchfield.render.axes import axes_matrix, axes_notes
from touchfield.render.memory import FREE, STATE, WRENCH
from touchfield.render.spec import PEAK_RISE_S
from touchfield.render.stability import delay_s

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.render.memory import Memory
    from touchfield.render.spec import RenderSpec

__all__ = ["write_parameters"]

_LEAST_N: Final = 1e-6
_MOST_N: Final = 1e6
"""A limit out of this range is a mistake; within it no square of a force or torque is lost."""


def write_parameters(
    memory: Memory,
    spec: RenderSpec,
    device: Device,
    medium_friction: float,
    medium_damping: float,
    field_axes: str,
) -> tuple[str, ...]:
    """Write the parameters of the ticks to come, and begin their state anew: no force, gain zero, no heat.

    Parameters
    ----------
    memory : Memory
        At least as long as its fixed places.
    spec : RenderSpec
    device : Device
        A point (type 1): its limits and axes.
    medium_friction, medium_damping : float
        mu, and b in N s/m, of the medium; taken where `spec` gives none.
    field_axes : str
        Of the medium.

    Returns
    -------
    tuple of str
        Notes for the user: on axes that could not be followed, on limits that cannot be held up.

    Raises
    ------
    InvalidArgument
        If a limit of `spec` is beyond the device's, or a coefficient of the medium is not finite or negative.
    DeviceError
        If the device is no point, or states no force.
    """
    if device.is_array:
        raise DeviceError(device.name, "a type 2 device", "a type 1 device: a point that the hand moves")
    if memory.words < FREE:
        raise InvalidArgument("memory", f"{memory.words} words", f"at least {FREE}")
    device_peak = float(device.force_max_n)
    if not _LEAST_N <= device_peak <= _MOST_N:
        raise DeviceError(f"{device.name}: force_max_n", f"{device_peak:g} N", f"{_LEAST_N:g} to {_MOST_N:g} N")
    peak = _limit("peak_n", spec.peak_n, device_peak, f"N, the limit of {device.name}")
    continuous = _continuous("continuous_n", spec.continuous_n, device.force_continuous_n, peak, device.name)
    mu = _coefficient("friction of the medium", spec.friction, medium_friction)
    damping = _coefficient("damping of the medium", spec.damping_n_s_per_m, medium_damping)
    words = memory.f8
    for place, value in (
        (places.RATE_HZ, spec.rate_hz),
        (places.FRICTION, mu),
        (places.DAMPING, damping),
        (places.SLIP_SPEED, spec.slip_speed_m_s),
        (places.PASSIVITY, float(spec.passivity)),
        (places.SCALE, spec.scale),
        (places.FORCE_SCALE, spec.force_scale),
        (places.PEAK, peak),
        (places.CONTINUOUS, continuous),
        (places.SLEW, spec.slew_n_per_s if spec.slew_n_per_s is not None else peak / PEAK_RISE_S),
        (places.THERMAL_S, spec.thermal_s),
        (places.RAMP_S, spec.ramp_s),
        (places.CUTOFF, 2 * math.pi * spec.velocity_cutoff_hz),
        (places.COUPLING, spec.coupling_n_per_m or 0.0),
        (places.BRAKE, 0.0),
        (places.DELAY, min(delay_s(device) * spec.rate_hz, places.MOST_DELAY)),
    ):
        words[place] = value
    words[places.WALL : places.WALL_SPACING + 3] = 0.0
    words[places.CLUTCH : places.CLUTCH + 3] = spec.clutch_m
    words[places.GRAVITY : places.GRAVITY + 3] = spec.gravity_n
    words[places.AXES : places.AXES + 9] = axes_matrix(device.axes, field_axes, spec.up).ravel()
    words[STATE : STATE + places.STATE_WORDS] = 0.0
    words[places.LIMIT] = peak
    notes = [] if device.axes == field_axes else list(axes_notes(device.axes, field_axes, spec.up))
    notes += _write_wrench(memory, spec, device)
    weight = float(np.linalg.norm(spec.gravity_n))
    if weight >= (continuous or peak):
        notes.append(f"the steady force of {weight:g} N leaves nothing of {continuous or peak:g} N to the field")
    return tuple(notes)


def _write_wrench(memory: Memory, spec: RenderSpec, device: Device) -> tuple[str, ...]:
    """Limits of the torque, and its state anew: the grip not turned, no torque, no heat, no tool."""
    words = memory.f8
    words[WRENCH : WRENCH + wrench_places.WRENCH_WORDS] = 0.0
    axes = words[places.AXES : places.AXES + 9].reshape(3, 3)
    words[wrench_places.HANDEDNESS] = np.sign(np.linalg.det(axes))
    words[wrench_places.ORIENTATION] = 1.0
    stated = device.torque_max_nm
    if stated is None:
        asked = [n for n in ("peak_nm", "continuous_nm", "slew_nm_per_s") if getattr(spec, n) is not None]
        if asked:
            raise InvalidArgument(asked[0], f"it with {device.name}", "a device that states a torque")
        return () if spec.tool is None else (f"{device.name} states no torque: the tool's force alone is felt",)
    peak = _limit("peak_nm", spec.peak_nm, stated, f"N m, the limit of {device.name}")
    words[wrench_places.TORQUE_PEAK] = words[wrench_places.TORQUE_LIMIT] = peak
    words[wrench_places.TORQUE_CONTINUOUS] = _continuous(
        "continuous_nm", spec.continuous_nm, device.torque_continuous_nm, peak, device.name
    )
    slew = spec.slew_nm_per_s
    words[wrench_places.TORQUE_SLEW] = peak / PEAK_RISE_S if slew is None else slew
    return ()


def _limit(name: str, asked: float | None, stated: float, whose: str) -> float:
    if asked is None:
        return stated
    if not _LEAST_N <= asked <= stated:
        raise InvalidArgument(name, f"{asked:g}", f"{_LEAST_N:g} to {stated:g} {whose}")
    return float(asked)


def _continuous(name: str, asked: float | None, stated: float | None, peak: float, device: str) -> float:
    """The continuous limit; 0 where there is none below the peak."""
    if asked is None and stated is None:
        return 0.0
    limit = _limit(
        name, asked, math.inf if stated is None else float(stated), f"in the long run, the limit of {device}"
    )
    return limit if limit < peak else 0.0


def _coefficient(name: str, asked: float | None, stated: float) -> float:
    value = float(stated if asked is None else asked)
    if not 0 <= value < math.inf:
        raise InvalidArgument(name, repr(value), "a finite number, 0 or more")
    return value

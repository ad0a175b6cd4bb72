"""Options of the renderer (effects, mapping from hand to field, limits of the force; paper section 3.2), and
their transfer into the memory that player and servo share.

`write_parameters` writes them to the block, together with the values of the device and the medium, before the
servo starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.arrays import lengths_of
from touchfield.compute.native import native
from touchfield.errors import (
    DeviceError,
    InvalidArgument,
    is_finite,
    require_between,
    require_kinds,
    require_not_negative,
    require_positive,
)
from touchfield.files import json_of
from touchfield.options import option
from touchfield.render.block import layout
from touchfield.render.point_device import UP_CHOICES, axes_matrix, axes_notes
from touchfield.render.tool import Tool

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from touchfield.devices import Device
    from touchfield.medium import ForceField
    from touchfield.medium.cells import CellPool
    from touchfield.medium.deformation import Deformation
    from touchfield.render.block import Memory
    from touchfield.render.material import Material


Triple = tuple[float, float, float]

PEAK_RISE_S: Final = 0.005
"""Time in which the default slew limit lets the force rise from zero to its peak."""

_MIN_LIMIT_N, _MAX_LIMIT_N = 1e-6, 1e6
"""Range of limits.

Values outside are mistakes; inside, the square of a force does not under- or overflow.
"""

_NON_NEGATIVE: Final = ("force_scale", "friction", "damping_n_s_per_m", "coupling_n_per_m")
_CHECKED_NUMBERS: Final = (
    *("rate_hz", "slip_speed_m_s", "scale", "thermal_s", "ramp_s", "velocity_cutoff_hz", "wall_n_per_m"),
    *("peak_n", "continuous_n", "slew_n_per_s", "peak_nm", "continuous_nm", "slew_nm_per_s"),
    *_NON_NEGATIVE,
)
"""Options that are finite numbers above 0 if given; those of `_NON_NEGATIVE` may be 0."""


@dataclass(frozen=True)
class RenderSpec:
    """Options of the renderer; every default is safe for a hand.

    Raises `InvalidArgument` if a number is out of range or not finite, or a tool is combined with a coupling.
    """

    rate_hz: float = option(1000.0, "Ticks of the servo a second.")
    friction: float | None = option(None, "mu; default: the stream's.")
    damping_n_s_per_m: float | None = option(
        None, "b everywhere; default: the stream's, and in contact the stable value."
    )
    slip_speed_m_s: float = 0.001  # v_s of `touchfield.filters.contact`
    coupling_n_per_m: float | None = option(
        None, "Stiffness of the virtual coupling; 0: none; default: the stable value."
    )
    passivity: bool = option(
        False, "Dissipate the energy that the loop generates (time-domain passivity control)."
    )
    scale: float = option(1.0, "Metres of the field for one metre of the device.")
    # point of the field at the device's origin, in the field's axes
    clutch_m: Triple = (0.0, 0.0, 0.0)
    force_scale: float = option(1.0, "Newtons of the device for one of the field.")
    # constant force for the weight of the handle, in the device's axes
    gravity_n: Triple = (0.0, 0.0, 0.0)
    peak_n: float | None = option(None, "Limit of |F|; default, and maximum: the device's.")
    continuous_n: float | None = option(None, "Continuous limit of |F|; default: the device's.")
    slew_n_per_s: float | None = option(None, "Limit of |dF/dt|; default: to the peak in 5 ms.")
    # time constant of the heat model that lets the force exceed the continuous limit for a while
    thermal_s: float = 1.0
    # time in which the force goes to zero when the feed stalls, and returns
    ramp_s: float = 0.02
    # cut-off of the low-pass on the velocity, which is estimated from positions
    velocity_cutoff_hz: float = 100.0
    # whether the segments of a stream are blended into each other (`render.segment_blend`)
    blend: bool = True
    render: str = option(
        "auto", "proxy (for thin walls), field (the stored force) or auto (proxy for fields with walls)."
    )
    wall_n_per_m: float | None = option(None, "Stiffness of the proxy's spring; default: the field's own.")
    # the tool in the hand; None: a point
    tool: Tool | None = None
    peak_nm: float | None = option(None, "Limit of the torque, N m; default, and maximum: the device's.")
    continuous_nm: float | None = option(None, "Continuous limit of the torque; default: the device's.")
    slew_nm_per_s: float | None = option(None, "Limit of the torque's change; default: to the peak in 5 ms.")
    up: str = option(
        "auto", "Up for the hand: x to -z; auto: as the stream states; lattice: y or -y, as stored."
    )
    # None: the materials stored with the medium
    materials: tuple[Material, ...] | None = None
    # deformation of the medium; it is then rendered as with "field"
    deformation: Deformation | None = None

    def __post_init__(self) -> None:
        require_kinds(self, render=("auto", "proxy", "field"), up=UP_CHOICES)
        for name in _CHECKED_NUMBERS:
            value = getattr(self, name)
            check = require_not_negative if name in _NON_NEGATIVE else require_positive
            if value is not None:
                check(**{name: value})
        if self.tool is not None and self.coupling_n_per_m:
            both = f"{self.coupling_n_per_m:g} N/m with {self.tool.name}"
            raise InvalidArgument("coupling_n_per_m", both, "0 with a tool: the coupling is that of a point")
        if self.tool is not None and self.render == "proxy":
            raise InvalidArgument(
                "render", f"'proxy' with {self.tool.name}", "field: the proxy is that of a point"
            )
        if self.deformation is not None and (self.tool is not None or self.render == "proxy"):
            raise InvalidArgument("deformation", "one with a tool or a proxy", "a point in the field itself")
        for name in ("clutch_m", "gravity_n"):
            values = getattr(self, name)
            if np.shape(values) != (3,) or not all(map(is_finite, values)):
                raise InvalidArgument(name, repr(values), "three finite numbers")
        require_between(10, 20000, rate_hz=self.rate_hz)


def write_parameters(
    memory: Memory,
    spec: RenderSpec,
    device: Device,
    medium_friction: float,
    medium_damping: float,
    field_axes: str,
) -> tuple[str, ...]:
    """Write the parameters for the servo and reset its state; return notes for the user.

    Must not be called while a servo runs. mu and b are those of the medium unless `spec` gives them. Raises
    `InvalidArgument` if a limit exceeds the device's, or a coefficient is negative or not finite;
    `DeviceError` if the device is not of type 1 or states no force.
    """
    if device.is_array:
        raise DeviceError(device.name, "a type 2 device", "a type 1 device: a point that the hand moves")
    receiver = memory.receiver
    for name in ("settings", "state", "grip"):
        receiver[name] = np.zeros((), receiver.dtype[name])
    settings, state = receiver["settings"], receiver["state"]
    _write_limits(receiver, spec, device)
    axes = axes_matrix(device.axes, field_axes, spec.up)
    for name, value in (
        ("rate_hz", spec.rate_hz),
        ("friction", _coefficient("friction of the medium", spec.friction, medium_friction)),
        ("damping_n_s_per_m", _coefficient("damping of the medium", spec.damping_n_s_per_m, medium_damping)),
        ("slip_speed_m_s", spec.slip_speed_m_s),
        ("coupling_n_per_m", spec.coupling_n_per_m or 0.0),
        ("is_passive", spec.passivity),
        ("scale", spec.scale),
        ("clutch_m", spec.clutch_m),
        ("force_scale", spec.force_scale),
        ("gravity_n", spec.gravity_n),
        ("axes", axes),
        ("handedness", np.sign(np.linalg.det(axes))),
        ("thermal_s", spec.thermal_s),
        ("ramp_s", spec.ramp_s),
        ("velocity_cutoff_rad_s", 2 * math.pi * spec.velocity_cutoff_hz),
        ("delay_ticks", min(delay_s(device) * spec.rate_hz, layout.MAX_DELAY)),
    ):
        settings[name] = value
    receiver["grip"]["orientation"][0] = 1.0
    state["friction"] = settings["friction"]
    notes = [] if device.axes == field_axes else list(axes_notes(device.axes, field_axes, spec.up))
    if spec.tool is not None and device.torque_max_nm is None:
        notes.append(f"{device.name} states no torque: only the tool's force is rendered")
    limits = settings["force_limits"]
    weight, limit_n = float(np.linalg.norm(spec.gravity_n)), float(limits["continuous"] or limits["peak"])
    if weight >= limit_n:
        notes.append(
            f"the constant force of {weight:g} N leaves nothing of the limit of {limit_n:g} N to the field"
        )
    return tuple(notes)


def _write_limits(receiver: Any, spec: RenderSpec, device: Device) -> None:
    """Write the limits of the force and, if the device states one, of the torque."""
    if not _MIN_LIMIT_N <= device.force_max_n <= _MAX_LIMIT_N:
        peak_n = f"{device.force_max_n:g} N"
        raise DeviceError(f"{device.name}: force_max_n", peak_n, f"{_MIN_LIMIT_N:g} to {_MAX_LIMIT_N:g} N")
    force = "force", device.force_max_n, device.force_continuous_n, "n", "N"
    torque = "torque", device.torque_max_nm, device.torque_continuous_nm, "nm", "N m"
    for part, stated, stated_long, unit, name in (force, torque):
        keys = f"peak_{unit}", f"continuous_{unit}", f"slew_{unit}_per_s"
        peak, continuous, slew = (getattr(spec, key) for key in keys)
        if stated is None:
            extra = [key for key in keys if getattr(spec, key) is not None]
            if extra:
                raise InvalidArgument(extra[0], f"a limit for {device.name}", "a device that states a torque")
            continue
        peak = _limit(keys[0], peak, stated, f"{name}, the limit of {device.name}")
        long = math.inf if stated_long is None else stated_long
        long = _limit(keys[1], continuous, long, f"continuously, the limit of {device.name}")
        limits = receiver["settings"][f"{part}_limits"]
        limits["peak"] = receiver["state"][part]["limit"] = peak
        limits["continuous"] = long if long < peak else 0.0
        limits["slew_per_s"] = peak / PEAK_RISE_S if slew is None else slew


def _limit(name: str, requested: float | None, stated: float, explanation: str) -> float:
    if requested is not None and not _MIN_LIMIT_N <= requested <= stated:
        raise InvalidArgument(name, f"{requested:g}", f"{_MIN_LIMIT_N:g} to {stated:g} {explanation}")
    return float(stated if requested is None else requested)


def _coefficient(name: str, requested: float | None, stated: float) -> float:
    value = float(stated if requested is None else requested)
    require_not_negative(**{name: value})
    return value


_DEFAULT_DELAY_S: Final = 1e-3
_MIN_INERTIA_KG: Final = 0.045
"""For a device that states none: one frame of USB; the smallest of the desktop devices. Damping: none."""

_HAND_KG: Final = 0.05
_SAFETY_FACTOR: Final = 2.0

_MAX_PHASE_SQUARED: Final = 0.4
"""Limit of (w L)^2, for the oscillation w of hand and wall, and the damper's lag L."""

_MAX_STEP_N: Final = 0.035

_MIN_STIFFNESS_FRACTION: Final = 0.92
"""Minimum rendered fraction of a stiffness that Colgate's rule allows for the bare device."""


# For slow movements, a force that is sampled, held and delayed by d equals -K x(t - T/2 - d): a spring with
# a negative damper of K (T/2 + d), which the device must compensate (Colgate and Schenkel 1997). In contact
# the renderer brakes with B = 2 K (T/2 + d) - b along the force, never with more than that force
# (`touch_damped` of ``c/touch_effects.h``). The damper lags by L: against a mass m (the device and a light
# hand), B is limited to m / 2L and K to 0.4 m / L^2. One step q of the encoder changes the force by q (K +
# B / T s), with s the weight of a new sample in the velocity filter; this is limited to 35 mN and twice the
# friction (Diolaiti 2006). A stiffer field is rendered through a coupling; but a stiffness that Colgate's
# rule allows for the bare device is rendered to within 8 %.


@dataclass(frozen=True)
class Stability:
    """Damper in contact and coupling for a medium on a device, with a note.

    Both are in the units of the field; 0 means none.
    """

    brake_n_s_per_m: float
    coupling_n_per_m: float
    note: str


def delay_s(device: Device) -> float:
    """Return the delay from a reported position to the resulting force, seconds.

    Sampling and hold are not included.
    """
    return _DEFAULT_DELAY_S if device.delay_ms is None else 1e-3 * device.delay_ms


def stability_of(
    device: Device, spec: RenderSpec, medium_damping: float, stiffest_n_per_m: float
) -> Stability:
    """Choose the damper in contact and the coupling for a field with this largest slope.

    Values that `spec` gives are not changed.
    """
    tick, delay = 1 / spec.rate_hz, delay_s(device)
    scale = spec.scale * spec.force_scale
    field_k, device_damping = scale * stiffest_n_per_m, device.damping_n_s_per_m or 0.0
    coupling = scale * spec.coupling_n_per_m if spec.coupling_n_per_m else 0.0
    lag = tick / 2 + delay
    if spec.coupling_n_per_m is None and field_k > 0:
        max_k = _max_stiffness(device, spec, field_k, lag)
        coupling = field_k * max_k / (field_k - max_k) if field_k > max_k else 0.0
    rendered_k = field_k
    if coupling > 0:
        rendered_k = 1 / (1 / field_k + 1 / coupling) if field_k > 0 else 0.0
    brake = 0.0
    if spec.damping_n_s_per_m is None:
        brake = max(0.0, _SAFETY_FACTOR * rendered_k * lag - device_damping - scale * medium_damping)
    note = f"the medium's stiffest slope is {field_k:.0f} N/m, and the device alone "
    note += f"can render {device_damping / lag:.0f} N/m"
    if spec.damping_n_s_per_m is None:
        note += f": damping in contact {brake:.2g} N s/m"
    if spec.coupling_n_per_m is None and coupling:
        note += f", coupling {coupling:.0f} N/m, so that {rendered_k:.0f} N/m are rendered"
    elif spec.coupling_n_per_m is None:
        note += ", no coupling"
    return Stability(brake / scale if scale else 0.0, coupling / scale if scale else 0.0, note)


def _max_stiffness(device: Device, spec: RenderSpec, k: float, lag: float) -> float:
    """Return the largest stable stiffness for a field of stiffness k, N/m of the device.

    It is limited by the stability that a damper gives, and by the vibration that the encoder's steps cause.
    """
    tick, device_damping = 1 / spec.rate_hz, device.damping_n_s_per_m or 0.0
    smoothing = -math.expm1(-2 * math.pi * spec.velocity_cutoff_hz * tick)
    damper_lag = lag + tick / 2 + tick * (1 - smoothing) / smoothing
    mass = _HAND_KG + (_MIN_INERTIA_KG if device.inertia_kg is None else device.inertia_kg)
    by_damper = min(
        (mass / (2 * damper_lag) + device_damping) / (_SAFETY_FACTOR * lag),
        _MAX_PHASE_SQUARED * mass / damper_lag**2,
    )
    by_steps = math.inf
    if device.resolution_mm:
        steps_n = _MAX_STEP_N + 2 * (device.friction_n or 0.0)
        by_steps = steps_n / (1e-3 * device.resolution_mm) + smoothing * device_damping / tick
        by_steps /= 1 + smoothing * _SAFETY_FACTOR * lag / tick
    return max(min(by_damper, by_steps), _MIN_STIFFNESS_FRACTION * k if k * lag < device_damping else 0.0)


# -- stiffness and walls of a field

_SLOPE_BINS: Final = 400  # of the histogram of c/touch_slopes.h
_SLOPE_BINS_PER_DOUBLING: Final = 20.0
_STEEP_FRACTION: Final = 1e-3
"""Fraction of the resisting cells that may be stiffer: edges, corners, noise."""


def stiffest_n_per_m(pools: Iterable[CellPool]) -> float:
    """Return the largest slope of a force against its own direction, N/m.

    One in a thousand of the resisting cells of a field may exceed it.
    """
    stiffest = 0.0
    for pool in pools:
        counts = np.zeros(_SLOPE_BINS, np.int64)
        native.count_slopes(pool.cells, pool.supported, tuple(1.0 / pool.lattices[0, :3]), counts)
        counts_above = np.cumsum(counts[::-1])[::-1]
        if counts.any():
            steepest = int(np.flatnonzero(counts_above > _STEEP_FRACTION * counts_above[0])[-1])
            stiffest = max(stiffest, 2.0 ** ((steepest + 1) / _SLOPE_BINS_PER_DOUBLING))
    return stiffest


# constants of `wall_of`
_MAX_SAMPLES: Final = 20_000
_LARGE_PERCENTILE: Final = 98.0  # percentile of a "large" force: near the limit, with few samples above
_RAMP_FRACTIONS: Final = (0.1, 0.85)  # fractions of a large force between the surface and the limit
_MIN_COSINE: Final = 0.8  # between the forces of a sample and of the point one sample farther out
_MAX_RATIO: Final = 0.97  # between the sizes of these two forces
_MIN_WALL_FRACTION: Final = 0.6  # samples that must look like a wall
_STIFFNESS_PERCENTILE: Final = 75.0  # percentile of the slopes that is the wall's stiffness
_MAX_LEVEL_N: Final = 0.05
_LEVEL_FRACTION: Final = 0.1  # level of the surface, over a large force

_STATED_RANGE_N_PER_M: Final = (1.0, 5000.0)
"""Stiffness that a file may state."""


@dataclass(frozen=True)
class Wall:
    """A wall: slope of the force, force at the surface, and spacing of the samples."""

    stiffness_n_per_m: float
    level_n: float
    spacing_m: tuple[float, float, float]


def wall_of(field: ForceField) -> Wall | None:
    """Return the wall in a field, or None.

    A field is a wall if the force of most samples decreases by K per metre outwards, and is nearly parallel
    to that of the next sample. A constant pull, for example, is not a wall. The stiffness is that of the
    steeper samples, because edges, thin walls and the low-pass decrease it.
    """
    sizes = lengths_of(field.forces_n)
    if not sizes.any():
        return None
    large = float(np.percentile(sizes[sizes > 0], _LARGE_PERCENTILE))
    brick, *local = np.nonzero((sizes > _RAMP_FRACTIONS[0] * large) & (sizes < _RAMP_FRACTIONS[1] * large))
    if not len(brick):
        return None
    subset = slice(None, None, -(-len(brick) // _MAX_SAMPLES))
    forces = field.forces_n[brick, *local][subset].astype(np.float64)
    size = lengths_of(forces)
    outwards = forces / size[:, None]
    spacing_m = np.array(field.grid.spacing_m)
    step_m = lengths_of(outwards * spacing_m)
    positions = 8 * field.bricks[brick[subset]] + np.stack(local, axis=-1)[subset]
    outer_forces = field.sample_n(field.grid.to_m(positions) + step_m[:, None] * outwards).astype(np.float64)
    outer_size = lengths_of(outer_forces)
    is_wall = (np.einsum("ij,ij->i", outer_forces, outwards) >= _MIN_COSINE * outer_size) & (
        outer_size < _MAX_RATIO * size
    )
    if np.mean(is_wall) < _MIN_WALL_FRACTION:
        return None
    stiffness = float(np.percentile(((size - outer_size) / step_m)[is_wall], _STIFFNESS_PERCENTILE))
    return Wall(stiffness, min(_MAX_LEVEL_N, _LEVEL_FRACTION * large), field.grid.spacing_m)


def stated_n_per_m(provenance: Mapping[str, str]) -> float | None:
    """Return the stiffness of walls in the provenance of a medium; None if none is valid.

    A stream that was encoded again has the stiffness of its source, and an edited one has none.
    """
    if "edits" in provenance:
        return None
    try:
        spec = json_of(provenance.get("source.spec", provenance.get("spec", "{}")))
        stated = float(spec["stiffness_n_per_m"]) if spec["law"] == "penalty" else math.nan
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    low, high = _STATED_RANGE_N_PER_M
    return stated if low <= stated <= high else None

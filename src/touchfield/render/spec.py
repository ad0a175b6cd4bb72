"""Wishes of a receiver: effects, mapping to the device, limits (paper section 3.2).

`write_parameters` puts it into the block, with what device and medium say, before the servo starts.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from touchfield.arrays import Float64s, lengths_of
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
from touchfield.render.block import words as W
from touchfield.render.point_device import UPS, axes_matrix, axes_notes
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

PEAK_RISE_S: Final = (
    0.005  # a slew limit that is not given lets the force rise from zero to its peak in this time
)
_LEAST_N: Final = 1e-6
_MOST_N: Final = (
    1e6  # A limit out of this range is a mistake; within it no square of a force or torque is lost
)
_FROM_ZERO: Final = ("force_scale", "friction", "damping_n_s_per_m", "coupling_n_per_m")
_NUMBERS: Final = (
    *("rate_hz", "slip_speed_m_s", "scale", "thermal_s", "ramp_s", "velocity_cutoff_hz", "wall_n_per_m"),
    *("peak_n", "continuous_n", "slew_n_per_s", "peak_nm", "continuous_nm", "slew_nm_per_s"),
    *_FROM_ZERO,
)
"""Finite numbers above 0 where they are given; some may be 0."""


@dataclass(frozen=True)
class RenderSpec:
    """Wishes of a receiver to the renderer; every default is safe for a hand.

    `InvalidArgument` if a number is out of range or not finite, or a tool is asked for together with a
    coupling.
    """

    rate_hz: float = option(1000.0, "Ticks of the servo a second.")
    friction: float | None = option(None, "mu; default: the stream's.")
    damping_n_s_per_m: float | None = option(
        None, "b everywhere; default: the stream's, in contact what is stable."
    )
    slip_speed_m_s: float = 0.001  # v_s of `touchfield.filters.contact`
    coupling_n_per_m: float | None = option(
        None, "A virtual coupling's stiffness; 0: none; default: what is stable."
    )
    passivity: bool = option(
        False, "Take out the energy that the loop makes (time-domain passivity control)."
    )
    scale: float = option(1.0, "Metres of the field for one metre of the device.")
    clutch_m: Triple = (
        0.0,
        0.0,
        0.0,
    )  # point of the field that lies at the device's origin, the field's axes
    force_scale: float = option(1.0, "Newtons of the device for one of the field.")
    gravity_n: Triple = (0.0, 0.0, 0.0)  # a steady force for the weight of the handle, the device's axes
    peak_n: float | None = option(None, "Limit of |F|; default: the device's, which it cannot pass.")
    continuous_n: float | None = option(None, "Limit of |F| in the long run; default: the device's.")
    slew_n_per_s: float | None = option(None, "Limit of |dF/dt|; default: to the peak in 5 ms.")
    thermal_s: float = (
        1.0  # time constant of the heat that lets the force exceed the continuous limit for a while
    )
    ramp_s: float = 0.02  # in which the force goes to zero when the feed stalls, and comes back
    velocity_cutoff_hz: float = 100.0  # of the low-pass on the velocity that is estimated from positions
    blend: bool = True  # whether one segment of a stream goes over into the next (`render.segment_blend`)
    render: str = option(
        "auto", "proxy (thin walls hold), field (the stored force) or auto (proxy where walls are)."
    )
    wall_n_per_m: float | None = option(None, "Stiffness of the proxy's spring; default: the field's own.")
    tool: Tool | None = None  # that the hand holds into the field; None: a point
    peak_nm: float | None = option(
        None, "Limit of the torque, N m; default: the device's, which it cannot pass."
    )
    continuous_nm: float | None = option(None, "Limit of the torque in the long run; default: the device's.")
    slew_nm_per_s: float | None = option(None, "Limit of its change; default: to the peak in 5 ms.")
    up: str = option(
        "auto", "Up for the hand: x to -z; auto: as the stream says; lattice: y or -y, as it was laid."
    )
    materials: tuple[Material, ...] | None = None  # None: those that travel with the medium
    deformation: Deformation | None = (
        None  # bends the medium, or lets it yield; it is rendered as a field then
    )

    def __post_init__(self) -> None:
        require_kinds(self, render=("auto", "proxy", "field"), up=UPS)
        for name in _NUMBERS:
            value, check = (
                getattr(self, name),
                require_not_negative if name in _FROM_ZERO else require_positive,
            )
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
            raise InvalidArgument("deformation", "it with a tool or a proxy", "a point in the field as it is")
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
    """Write the parameters of the ticks to come, and begin their state anew; notes for the user.

    Not while a servo runs; mu and b of the medium are taken where `spec` gives none. `InvalidArgument` if a
    limit is beyond the device's or a coefficient negative or not finite; `DeviceError` if it is no point, or
    states no force.
    """
    if device.is_array:
        raise DeviceError(device.name, "a type 2 device", "a type 1 device: a point that the hand moves")
    words = memory.f8
    memory.i8[[W.MATERIAL, W.MATERIAL_COUNT]] = 0
    words[W.STATE : W.STATE + W.STATE_WORDS] = 0.0
    words[W.WRENCH : W.WRENCH + W.WRENCH_WORDS] = 0.0
    _write_limits(words, spec, device)
    for place, value in (
        (W.RATE_HZ, spec.rate_hz),
        (W.FRICTION, _coefficient("friction of the medium", spec.friction, medium_friction)),
        (W.DAMPING, _coefficient("damping of the medium", spec.damping_n_s_per_m, medium_damping)),
        (W.SLIP_SPEED, spec.slip_speed_m_s),
        (W.PASSIVITY, float(spec.passivity)),
        (W.SCALE, spec.scale),
        (W.FORCE_SCALE, spec.force_scale),
        (W.THERMAL_S, spec.thermal_s),
        (W.RAMP_S, spec.ramp_s),
        (W.CUTOFF, 2 * math.pi * spec.velocity_cutoff_hz),
        (W.COUPLING, spec.coupling_n_per_m or 0.0),
        (W.BRAKE, 0.0),
        (W.DELAY, min(delay_s(device) * spec.rate_hz, W.MOST_DELAY)),
        (W.ORIENTATION, 1.0),
    ):
        words[place] = value
    words[W.FRICTION_NOW] = words[W.FRICTION]
    axes = axes_matrix(device.axes, field_axes, spec.up)
    words[W.WALL : W.WALL_SPACING + 3] = 0.0
    words[W.CLUTCH : W.CLUTCH + 3] = spec.clutch_m
    words[W.GRAVITY : W.GRAVITY + 3] = spec.gravity_n
    words[W.AXES : W.AXES + 9] = axes.ravel()
    words[W.HANDEDNESS] = np.sign(np.linalg.det(axes))
    notes = [] if device.axes == field_axes else list(axes_notes(device.axes, field_axes, spec.up))
    if spec.tool is not None and device.torque_max_nm is None:
        notes.append(f"{device.name} states no torque: the tool's force alone is felt")
    weight, most = float(np.linalg.norm(spec.gravity_n)), float(words[W.CONTINUOUS] or words[W.PEAK])
    if weight >= most:
        notes.append(f"the steady force of {weight:g} N leaves nothing of {most:g} N to the field")
    return tuple(notes)


def _write_limits(words: Float64s, spec: RenderSpec, device: Device) -> None:
    """Limits of the force and, where the device states one, of the torque."""
    if not _LEAST_N <= device.force_max_n <= _MOST_N:
        peak_n = f"{device.force_max_n:g} N"
        raise DeviceError(f"{device.name}: force_max_n", peak_n, f"{_LEAST_N:g} to {_MOST_N:g} N")
    force = device.force_max_n, device.force_continuous_n, (W.PEAK, W.CONTINUOUS, W.SLEW, W.LIMIT)
    places = W.TORQUE_PEAK, W.TORQUE_CONTINUOUS, W.TORQUE_SLEW, W.TORQUE_LIMIT
    torque = device.torque_max_nm, device.torque_continuous_nm, places
    for (stated, stated_long, at), unit, name in ((force, "n", "N"), (torque, "nm", "N m")):
        keys = f"peak_{unit}", f"continuous_{unit}", f"slew_{unit}_per_s"
        peak, continuous, slew = (getattr(spec, key) for key in keys)
        if stated is None:
            stray = [key for key in keys if getattr(spec, key) is not None]
            if stray:
                raise InvalidArgument(stray[0], f"it with {device.name}", "a device that states a torque")
            continue
        peak = _limit(keys[0], peak, stated, f"{name}, the limit of {device.name}")
        long = math.inf if stated_long is None else stated_long
        long = _limit(keys[1], continuous, long, f"in the long run, the limit of {device.name}")
        words[list(at)] = (
            peak,
            long if long < peak else 0.0,
            peak / PEAK_RISE_S if slew is None else slew,
            peak,
        )


def _limit(name: str, asked: float | None, stated: float, whose: str) -> float:
    if asked is not None and not _LEAST_N <= asked <= stated:
        raise InvalidArgument(name, f"{asked:g}", f"{_LEAST_N:g} to {stated:g} {whose}")
    return float(stated if asked is None else asked)


def _coefficient(name: str, asked: float | None, stated: float) -> float:
    value = float(stated if asked is None else asked)
    require_not_negative(**{name: value})
    return value


_DELAY_S: Final = 1e-3
_INERTIA_KG: Final = 0.045
"""Of a device that does not say: one frame of USB, and the least of the desktop devices. Damping: none."""

_HAND_KG: Final = 0.05
_MARGIN: Final = 2.0
_TURN: Final = 0.4  # (w L)^2 of the swing of hand and wall, in which the damper comes late by L
_STEP_N: Final = 0.035
_FELT: Final = 0.92  # Of what Colgate's rule allows the bare device: at least so much is felt


# A force that is sampled, held and late by d is -K x (t - T/2 - d) for slow movements: beside the spring a
# negative damper of K (T/2 + d), which the device must bear (Colgate and Schenkel 1997). The renderer brakes
# with B = 2 K (T/2 + d) - b in contact, along the force, never with more than that force
# (`kernels.effects.braked`). The damper lags by L: against a mass m (the device and a light hand) B is kept
# below m / 2L and K below 0.4 m / L^2. One step of the encoder moves the force by q (K + B / T share): below
# 35 mN and twice the friction (Diolaiti 2006). A stiffer field is felt through a coupling; but what Colgate's
# rule allows the bare device is felt within 8 %.


@dataclass(frozen=True)
class Stability:
    """Damper in contact and coupling of a medium on a device, in the units of the field, 0: none; and why."""

    brake_n_s_per_m: float
    coupling_n_per_m: float
    note: str


def delay_s(device: Device) -> float:
    """From a place that is told to a force that acts, beside sampling and holding, seconds."""
    return _DELAY_S if device.delay_ms is None else 1e-3 * device.delay_ms


def stability_of(
    device: Device, spec: RenderSpec, medium_damping: float, stiffest_n_per_m: float
) -> Stability:
    """Damper in contact and coupling for a field of this stiffest slope; what `spec` states stays as it is."""
    tick, late = 1 / spec.rate_hz, delay_s(device)
    scale = spec.scale * spec.force_scale
    k, own = scale * stiffest_n_per_m, device.damping_n_s_per_m or 0.0
    coupling = scale * spec.coupling_n_per_m if spec.coupling_n_per_m else 0.0
    hold = tick / 2 + late
    if spec.coupling_n_per_m is None and k > 0:
        most = _stiffest(device, spec, k, hold)
        coupling = k * most / (k - most) if k > most else 0.0
    felt = k
    if coupling > 0:
        felt = 1 / (1 / k + 1 / coupling) if k > 0 else 0.0
    brake = 0.0
    if spec.damping_n_s_per_m is None:
        brake = max(0.0, _MARGIN * felt * hold - own - scale * medium_damping)
    note = f"the medium's stiffest slope is {k:.0f} N/m, the device holds {own / hold:.0f} N/m by itself"
    if spec.damping_n_s_per_m is None:
        note += f": damping in contact {brake:.2g} N s/m"
    if spec.coupling_n_per_m is None:
        note += (
            f", coupling {coupling:.0f} N/m, so that {felt:.0f} N/m are felt" if coupling else ", no coupling"
        )
    return Stability(brake / scale if scale else 0.0, coupling / scale if scale else 0.0, note)


def _stiffest(device: Device, spec: RenderSpec, k: float, hold: float) -> float:
    """Most of a field of k that a damper makes stable and the encoder's steps let be still; N/m of the
    device.
    """
    tick, own = 1 / spec.rate_hz, device.damping_n_s_per_m or 0.0
    share = -math.expm1(-2 * math.pi * spec.velocity_cutoff_hz * tick)
    lag = hold + tick / 2 + tick * (1 - share) / share
    mass = _HAND_KG + (_INERTIA_KG if device.inertia_kg is None else device.inertia_kg)
    by_damper = min((mass / (2 * lag) + own) / (_MARGIN * hold), _TURN * mass / lag**2)
    by_steps = math.inf
    if device.resolution_mm:
        steps_n = _STEP_N + 2 * (device.friction_n or 0.0)
        by_steps = steps_n / (1e-3 * device.resolution_mm) + share * own / tick
        by_steps /= 1 + share * _MARGIN * hold / tick
    return max(min(by_damper, by_steps), _FELT * k if k * hold < own else 0.0)


# -- what a field tells
# ----------------------------------------------------------------------------------------

_SHARE: Final = 1e-3  # of the cells that push back may be stiffer: edges, corners, noise


def stiffest_n_per_m(pools: Iterable[CellPool]) -> float:
    """Growth of a force with a way against it, N/m: what one cell in a thousand of a field passes, at the
    most.
    """
    from touchfield.render.kernels.points import BINS, count_slopes, slope_of_bin

    stiffest = 0.0
    for pool in pools:
        counts = np.zeros(BINS, np.int64)
        count_slopes(pool.cells, pool.held, 1.0 / pool.lattices[0, :3], counts)
        beyond = np.cumsum(counts[::-1])[::-1]
        if counts.any():
            stiffest = max(stiffest, slope_of_bin(int(np.flatnonzero(beyond > _SHARE * beyond[0])[-1])))
    return stiffest


_LOOKED_AT: Final = 20_000  # samples
_LARGE: Final = 98.0  # percentile of the forces: their limit, or near it; a few overshoot it
_RAMP: Final = (0.1, 0.85)  # of a large force: neither at the surface nor at the limit
_ALIKE: Final = 0.8  # cosine of forces a sample apart
_LESS: Final = 0.97  # of a force, a sample farther out
_LEAST: Final = 0.6  # of the samples
_STEEPER: Final = 75.0  # percentile
_LEVEL_N: Final = 0.05
_STATED_N_PER_M: Final = (1.0, 5000.0)  # what a file may ask for
_LEVEL_SHARE: Final = 0.1  # of a large force


@dataclass(frozen=True)
class Wall:
    """Growth of the force behind the surface, the force at which this lies, and the spacing of the samples."""

    stiffness_n_per_m: float
    level_n: float
    spacing_m: tuple[float, float, float]


def wall_of(field: ForceField) -> Wall | None:
    """The wall that a field tells of; None where most of it does not grow against its force, as a steady
    pull.

    Where most samples are less by K for each metre farther out and point alike it is a wall's; its stiffness
    is that of the steeper ones, as edges, thin walls and the low-pass lessen it.
    """
    sizes = lengths_of(field.forces_n)
    if not sizes.any():
        return None
    large = float(np.percentile(sizes[sizes > 0], _LARGE))
    brick, *local = np.nonzero((sizes > _RAMP[0] * large) & (sizes < _RAMP[1] * large))
    if not len(brick):
        return None
    some = slice(None, None, -(-len(brick) // _LOOKED_AT))
    forces = field.forces_n[brick, *local][some].astype(np.float64)
    size = lengths_of(forces)
    outwards = forces / size[:, None]
    spacing_m = np.array(field.grid.spacing_m)
    way_m = lengths_of(outwards * spacing_m)
    at = 8 * field.bricks[brick[some]] + np.stack(local, axis=-1)[some]
    beyond = field.sample_n(field.grid.to_m(at) + way_m[:, None] * outwards).astype(np.float64)
    farther = lengths_of(beyond)
    is_wall = (np.einsum("ij,ij->i", beyond, outwards) >= _ALIKE * farther) & (farther < _LESS * size)
    if np.mean(is_wall) < _LEAST:
        return None
    stiffness = float(np.percentile(((size - farther) / way_m)[is_wall], _STEEPER))
    return Wall(stiffness, min(_LEVEL_N, _LEVEL_SHARE * large), field.grid.spacing_m)


def stated_n_per_m(provenance: Mapping[str, str]) -> float | None:
    """The stiffness that a medium's provenance states for its walls; None where it states none that could be.

    A stream that was coded anew has that of its source, one that was edited none.
    """
    if "edits" in provenance:
        return None
    try:
        spec = json_of(provenance.get("source.spec", provenance.get("spec", "{}")))
        stated = float(spec["stiffness_n_per_m"]) if spec["law"] == "penalty" else math.nan
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    low, high = _STATED_N_PER_M
    return stated if low <= stated <= high else None

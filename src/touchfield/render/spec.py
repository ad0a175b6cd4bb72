"""Options of the renderer (effects, mapping from hand to field, limits of the force; paper section 3.2), and
their transfer into the memory that player and servo share.

`write_parameters` checks them, and has ``c/touch_settings.h`` choose the settings of the receiver for the
device and the medium before the servo starts; damper in contact, coupling and walls are chosen there, too.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

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
from touchfield.medium.cells import CellPool
from touchfield.options import option
from touchfield.render.block import Memory, layout
from touchfield.render.point_device import UP_CHOICES, axes_matrix, axes_notes, axes_of_text, signed_axes
from touchfield.render.tool import Tool

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from touchfield.devices import Device
    from touchfield.medium import ForceField
    from touchfield.medium.deformation import Deformation
    from touchfield.render.material import Material


Triple = tuple[float, float, float]

_MIN_LIMIT_N, _MAX_LIMIT_N = 1e-6, 1e6
"""Range of limits.

Values outside are mistakes; inside, the square of a force does not under- or overflow.
"""

_NON_NEGATIVE: Final = ("force_scale", "friction", "damping_n_s_per_m", "coupling_n_per_m")
_CHECKED_NUMBERS: Final = (
    *("rate_hz", "scale", "thermal_s", "ramp_s", "velocity_cutoff_hz", "wall_n_per_m"),
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
    # whether the segments of a stream are blended into each other (`render.segment_blend`), and the force
    # fades over a seam: the end of a loop, a seek, late frames (`c/touch_seam.h`)
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
    axes: str | None = option(
        None, "Axes of the device: signed ones of its profile's, such as -x,y,z, or x right, y up, z towards."
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
        if self.axes is not None and signed_axes(self.axes) is None and axes_of_text(self.axes) is None:
            raise InvalidArgument("axes", repr(self.axes[:80]), _AXES_FORM)


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
    _check_limits(spec, device)
    friction = _coefficient("friction of the medium", spec.friction, medium_friction)
    damping = _coefficient("damping of the medium", spec.damping_n_s_per_m, medium_damping)
    device_axes = _device_axes(spec, device)[1]
    options = _options(spec, device_to_field(spec, device, field_axes))
    native.choose_settings(memory.bytes, options, _stated(device), friction, damping)
    notes = [] if device_axes == field_axes else list(axes_notes(device_axes, field_axes, spec.up))
    if spec.tool is not None and device.torque_max_nm is None:
        notes.append(f"{device.name} states no torque: only the tool's force is rendered")
    limits = memory.receiver["settings"]["force_limits"]
    weight, limit_n = float(np.linalg.norm(spec.gravity_n)), float(limits["continuous"] or limits["peak"])
    if weight >= limit_n:
        notes.append(
            f"the constant force of {weight:g} N leaves nothing of the limit of {limit_n:g} N to the field"
        )
    return tuple(notes)


_AXES_FORM: Final = (
    "each of x, y, z once, such as -x,y,z, or a text such as x right, y up, z towards the user"
)


def device_to_field(spec: RenderSpec, device: Device, field_axes: str) -> NDArray[np.float64]:
    """Return the signed permutation, float64 [3, 3], from vectors of the device to those of the field."""
    axes, device_axes = _device_axes(spec, device)
    return axes_matrix(device_axes, field_axes, spec.up) @ axes


def _device_axes(spec: RenderSpec, device: Device) -> tuple[NDArray[np.float64], str]:
    """Return the signed permutation from the device's axes to those of a text, and that text.

    The text is that of the profile, unless `spec` names other axes in words.
    """
    signed = None if spec.axes is None else signed_axes(spec.axes)
    if signed is not None:
        return signed, device.axes
    return np.eye(3), spec.axes or device.axes


_SAME_OPTIONS: Final = (
    *("rate_hz", "scale", "clutch_m", "force_scale", "gravity_n"),
    *("thermal_s", "ramp_s", "velocity_cutoff_hz"),
)
"""Options of the same name and meaning in `touch_render_options`."""


def _options(spec: RenderSpec, axes: NDArray[np.float64] | None = None) -> NDArray[np.void]:
    """Return the options as a `touch_render_options`; `axes`, float64 [3, 3], are those of `axes_matrix`."""
    options = np.zeros((), layout.RENDER_OPTIONS)
    for name in _SAME_OPTIONS:
        options[name] = getattr(spec, name)
    options["is_passive"] = spec.passivity
    options["axes"] = np.eye(3) if axes is None else axes
    for name in ("friction", "damping_n_s_per_m", "coupling_n_per_m"):
        value = getattr(spec, name)
        options[name] = _CHOSEN if value is None else value
    for limits, unit in (("force_limits", "n"), ("torque_limits", "nm")):
        options[limits]["peak"] = getattr(spec, f"peak_{unit}") or 0.0
        options[limits]["continuous"] = getattr(spec, f"continuous_{unit}") or 0.0
        options[limits]["slew_per_s"] = getattr(spec, f"slew_{unit}_per_s") or 0.0
    return options


def _stated(device: Device) -> NDArray[np.void]:
    """Return a device as a `touch_device`, in which 0 means "not stated"."""
    stated = np.zeros((), layout.DEVICE)
    stated["force_max_n"] = device.force_max_n
    for name in ("force_continuous_n", "torque_max_nm", "torque_continuous_nm"):
        stated[name] = getattr(device, name) or 0.0
    for name in ("damping_n_s_per_m", "friction_n"):
        stated[name] = getattr(device, name) or 0.0
    stated["resolution_m"] = 1e-3 * (device.resolution_mm or 0.0)
    if device.delay_ms is not None:
        stated["delay_s"] = 1e-3 * device.delay_ms or _NONE
    if device.inertia_kg is not None:
        stated["inertia_kg"] = device.inertia_kg or _NONE
    return stated


DEFAULT_DELAY_S: Final = 1e-3
"""``TOUCH_DEFAULT_DELAY_S``: the delay of a device that states none."""

_OF_DELAY: Final = ("delay_ticks", "stick_n_per_m", "stick_n_s_per_m")
"""Settings besides damper and coupling that depend on the delay of the device."""


def delay_s_of(device: Device) -> float:
    """Return the delay of a device from position to force, seconds, stated or assumed."""
    return DEFAULT_DELAY_S if device.delay_ms is None else 1e-3 * device.delay_ms


def write_delay(
    memory: Memory, spec: RenderSpec, device: Device, medium_friction: float, medium_damping: float
) -> None:
    """Write the settings that depend on the delay of `device`, perhaps while a servo ticks.

    The other arguments are those of `write_parameters`.
    """
    scratch = Memory.empty(layout.RECEIVER.itemsize)
    native.choose_settings(scratch.bytes, _options(spec), _stated(device), medium_friction, medium_damping)
    for name in _OF_DELAY:
        memory.receiver["settings"][name] = scratch.receiver["settings"][name]


_CHOSEN: Final = -1.0
"""``TOUCH_OF_MEDIUM`` and ``TOUCH_STABLE``: friction and damping of the medium, the stable coupling."""

_NONE: Final = -1.0
"""A delay or an inertia of `touch_device` that is stated as 0."""


def _check_limits(spec: RenderSpec, device: Device) -> None:
    """Raise an error unless the limits of force and torque are within those of the device."""
    if not _MIN_LIMIT_N <= device.force_max_n <= _MAX_LIMIT_N:
        peak_n = f"{device.force_max_n:g} N"
        raise DeviceError(f"{device.name}: force_max_n", peak_n, f"{_MIN_LIMIT_N:g} to {_MAX_LIMIT_N:g} N")
    force = device.force_max_n, device.force_continuous_n, "n", "N"
    torque = device.torque_max_nm, device.torque_continuous_nm, "nm", "N m"
    for stated, stated_long, unit, name in (force, torque):
        keys = f"peak_{unit}", f"continuous_{unit}", f"slew_{unit}_per_s"
        if stated is None:
            extra = [key for key in keys if getattr(spec, key) is not None]
            if extra:
                raise InvalidArgument(extra[0], f"a limit for {device.name}", "a device that states a torque")
            continue
        long = math.inf if stated_long is None else stated_long
        _check_limit(keys[0], getattr(spec, keys[0]), stated, f"{name}, the limit of {device.name}")
        _check_limit(keys[1], getattr(spec, keys[1]), long, f"continuously, the limit of {device.name}")


def _check_limit(name: str, requested: float | None, stated: float, explanation: str) -> None:
    if requested is not None and not _MIN_LIMIT_N <= requested <= stated:
        raise InvalidArgument(name, f"{requested:g}", f"{_MIN_LIMIT_N:g} to {stated:g} {explanation}")


def _coefficient(name: str, requested: float | None, stated: float) -> float:
    value = float(stated if requested is None else requested)
    require_not_negative(**{name: value})
    return value


# -- damper in contact and coupling: ``c/touch_settings.h`` explains them, with sources


@dataclass(frozen=True)
class Stability:
    """Damper in contact and coupling for a medium on a device, with a note.

    Both are in the units of the field; 0 means none.
    """

    brake_n_s_per_m: float
    coupling_n_per_m: float
    note: str


def stability_of(
    device: Device, spec: RenderSpec, medium_damping: float, stiffest_n_per_m: float
) -> Stability:
    """Choose the damper in contact and the coupling for a field with this largest slope.

    Values that `spec` gives are not changed.
    """
    brake, coupling, rendered_n_per_m, bare_n_per_m = native.choose_stability(
        _options(spec), _stated(device), medium_damping, stiffest_n_per_m
    )
    scale = spec.scale * spec.force_scale
    note = f"the medium's stiffest slope is {scale * stiffest_n_per_m:.0f} N/m, and the device alone "
    note += f"can render {bare_n_per_m:.0f} N/m"
    if spec.damping_n_s_per_m is None:
        note += f": damping in contact {scale * brake:.2g} N s/m"
    if spec.coupling_n_per_m is None and coupling:
        note += f", coupling {scale * coupling:.0f} N/m, so that {rendered_n_per_m:.0f} N/m are rendered"
    elif spec.coupling_n_per_m is None:
        note += ", no coupling"
    return Stability(brake, coupling, note)


# -- stiffness and walls of a field


def stiffest_n_per_m(pools: Iterable[CellPool]) -> float:
    """Return the largest slope of a force against its own direction, N/m, of pools of one field each.

    One in a thousand of the resisting cells of a field may exceed it.
    """
    return max((native.stiffest_slope(pool.field_data, len(pool.bricks)) for pool in pools), default=0.0)


@dataclass(frozen=True)
class Wall:
    """A wall: slope of the force, force at the surface, a large force, and spacing of the samples."""

    stiffness_n_per_m: float
    level_n: float
    large_n: float
    spacing_m: tuple[float, float, float]


def wall_of(field: ForceField) -> Wall | None:
    """Return the wall in a field, or None; ``c/touch_settings.h`` defines what a wall is.

    A constant pull, for example, is not a wall. The stiffness is that of the steeper samples.
    """
    grid, pool = field.grid, CellPool.of(field)
    lattice = grid.spacing_m, grid.origin_m
    found = native.find_wall(field.bricks, field.forces_n, *lattice, pool.field_data, len(pool.bricks))
    return Wall(*found, grid.spacing_m) if found[0] else None


def stated_n_per_m(provenance: Mapping[str, str]) -> float | None:
    """Return the stiffness of walls in the provenance of a medium; None if none is valid.

    A stream that was encoded again has the stiffness of its source, and an edited one has none.
    """
    if "edits" in provenance:
        return None
    spec = provenance.get("source.spec", provenance.get("spec", "{}"))
    return native.specified_wall(spec.encode(errors="replace")) or None

"""Walls: what a field tells of them, and what makes them stable on a device.

That is a damper in contact, and a virtual coupling where no damper can. A force that is sampled, held and late by d
is -K x (t - T/2 - d) for slow movements: beside the spring a negative damper of K (T/2 + d), which the device must
bear (Colgate and Schenkel 1997: b > K T/2, and K T for each sample of delay). Positions in steps of q give a spring
of up to 4/pi K, and no damper of the renderer is as good as its number, since its velocity lags. So
the renderer brakes with

    B = 2 K (T/2 + d) - b,

in contact alone, along the force, and never with more than that force (`kernels.effects.braked`). Two things bound K:

* the damper lags by L (hold, delay, the low-pass on the velocity). Against a mass m it drives above B L = m: B is
  kept below m / (2 L), and K below 0.4 m / L^2, m being that of the device and a light hand's 50 g;
* one step of the encoder moves the force by q (K + B / T share), share that of the low-pass on the velocity. A hand
  rests on such a step and goes to and fro over it, unless the device's own damping or friction holds it (Diolaiti et
  al. 2006). That step is kept below 35 mN and twice the friction.

A field that is stiffer than the lesser of both is felt through a coupling that makes it so soft; but what
Colgate's rule allows the bare device is felt within 8 %.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from touchfield.devices import Device
    from touchfield.medium import ForceField
    from touchfield.medium.cells import CellPool
    from touchfield.render.spec import RenderSpec

_DELAY_S: Final = 1e-3
_INERTIA_KG: Final = 0.045
"""Of a device that does not say: one frame of USB, and the least of the desktop devices. Damping: none."""

_HAND_KG: Final = 0.05
_MARGIN: Final = 2.0
_TURN: Final = 0.4
"""(w L)^2 of the swing of hand and wall, in which the damper comes late by L."""
_STEP_N: Final = 0.035
_FELT: Final = 0.92
"""Of what Colgate's rule allows the bare device: at least so much is felt."""


@dataclass(frozen=True)
class Stability:
    """Damper in contact and coupling of a medium on a device, in the units of the field, 0: none; and why."""

    brake_n_s_per_m: float
    coupling_n_per_m: float
    note: str


def delay_s(device: Device) -> float:
    """From a place that is told to a force that acts, beside sampling and holding, seconds."""
    return _DELAY_S if device.delay_ms is None else 1e-3 * device.delay_ms


def stability_of(device: Device, spec: RenderSpec, medium_damping: float, stiffest_n_per_m: float) -> Stability:
    """Damper in contact and coupling for a field of this stiffest slope; what `spec` states stays as it is.

    `medium_damping`, N s/m, is everywhere in the medium: so much less is needed in contact. The slope is along the
    field's force.
    """
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
        note += f", coupling {coupling:.0f} N/m, so that {felt:.0f} N/m are felt" if coupling else ", no coupling"
    return Stability(brake / scale if scale else 0.0, coupling / scale if scale else 0.0, note)


def _stiffest(device: Device, spec: RenderSpec, k: float, hold: float) -> float:
    """Most of a field of k that a damper makes stable and the encoder's steps let be still; N/m of the device."""
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


# -- what a field tells ----------------------------------------------------------------------------------------

_SHARE: Final = 1e-3  # of the cells that push back may be stiffer: edges, corners, noise


def stiffest_n_per_m(pools: Iterable[CellPool]) -> float:
    """Growth of a force with a way against it, N/m: what one cell in a thousand of a field passes, at the most.

    It is what a wall of the field asks of the loop. `pools` are of one field each, in their own frames.
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
    """The wall that a field tells of; None where most of it does not grow against its force, as a steady pull.

    A penalty force grows against itself: a sample farther out it is less by K for each metre, and points alike. Where
    most samples do so the field is a wall's; its stiffness is that of the steeper ones, as edges, thin walls and the
    low-pass lessen it.
    """
    sizes = np.linalg.norm(field.forces_n, axis=-1)
    if not sizes.any():
        return None
    large = float(np.percentile(sizes[sizes > 0], _LARGE))
    brick, *local = np.nonzero((sizes > _RAMP[0] * large) & (sizes < _RAMP[1] * large))
    if not len(brick):
        return None
    some = slice(None, None, -(-len(brick) // _LOOKED_AT))
    forces = field.forces_n[brick, *local][some].astype(np.float64)
    size = np.linalg.norm(forces, axis=1)
    outwards = forces / size[:, None]
    spacing_m = np.array(field.grid.spacing_m)
    way_m = np.linalg.norm(outwards * spacing_m, axis=1)
    at = 8 * field.bricks[brick[some]] + np.stack(local, axis=-1)[some]
    beyond = field.sample_n(field.grid.to_m(at) + way_m[:, None] * outwards).astype(np.float64)
    farther = np.linalg.norm(beyond, axis=1)
    is_wall = (np.einsum("ij,ij->i", beyond, outwards) >= _ALIKE * farther) & (farther < _LESS * size)
    if np.mean(is_wall) < _LEAST:
        return None
    stiffness = float(np.percentile(((size - farther) / way_m)[is_wall], _STEEPER))
    return Wall(stiffness, min(_LEVEL_N, _LEVEL_SHARE * large), field.grid.spacing_m)


def stated_n_per_m(provenance: Mapping[str, str]) -> float | None:
    """The stiffness that a medium's provenance states for its walls; None where it states none that could be.

    That is taken before what the field tells: a thin wall is as hard as a thick one.
    """
    try:
        spec = json.loads(provenance.get("spec", "{}"))
        stated = float(spec["stiffness_n_per_m"]) if spec["law"] == "penalty" else math.nan
    except (ValueError, KeyError, TypeError, RecursionError):
        return None
    low, high = _STATED_N_PER_M
    return stated if low <= stated <= high else None

"""What makes a wall stable on a device: a damper in contact, and a virtual coupling where no damper can.

A force that is sampled, held and late by d is -K x (t - T/2 - d) for slow movements: beside the spring a negative
damper of K (T/2 + d), which the device must bear (Colgate and Schenkel 1997: b > K T/2, and K T for each sample of
delay). Positions in steps of q give a spring of up to 4/pi K, and no damper of the renderer is as good as its number,
since its velocity lags. So the renderer brakes with

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

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from touchfield.devices import Device
    from touchfield.render.spec import RenderSpec

__all__ = ["Stability", "delay_s", "stability_of"]

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
    """What was chosen for a medium on a device.

    Attributes
    ----------
    brake_n_s_per_m, coupling_n_per_m : float
        Of the damper in contact and of the coupling, in the units of the field; 0: none.
    note : str
        What was chosen and why.
    """

    brake_n_s_per_m: float
    coupling_n_per_m: float
    note: str


def delay_s(device: Device) -> float:
    """From a place that is told to a force that acts, beside sampling and holding, seconds."""
    return _DELAY_S if device.delay_ms is None else 1e-3 * device.delay_ms


def stability_of(device: Device, spec: RenderSpec, medium_damping: float, stiffest_n_per_m: float) -> Stability:
    """Damper in contact and coupling for a field of this stiffest slope, N/m; what `spec` states stays as it is.

    Parameters
    ----------
    device : Device
    spec : RenderSpec
    medium_damping : float
        N s/m, everywhere in the medium: so much less is needed in contact.
    stiffest_n_per_m : float
        Of the field, along its force.
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
    told = f"the medium's stiffest slope is {k:.0f} N/m, the device holds {own / hold:.0f} N/m by itself"
    if spec.damping_n_s_per_m is None:
        told += f": damping in contact {brake:.2g} N s/m"
    if spec.coupling_n_per_m is None:
        told += f", coupling {coupling:.0f} N/m, so that {felt:.0f} N/m are felt" if coupling else ", no coupling"
    return Stability(brake / scale if scale else 0.0, coupling / scale if scale else 0.0, told)


def _stiffest(device: Device, spec: RenderSpec, k: float, hold: float) -> float:
    """What a damper can make stable, and the encoder's steps let be still, of a field of k; N/m of the device."""
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

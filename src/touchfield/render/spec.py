"""What a receiver asks of the renderer: effects, mapping to the device, limits (paper section 3.2)."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

from touchfield.errors import InvalidArgument
from touchfield.render.axes import UPS
from touchfield.render.tool import Tool

__all__ = ["RenderSpec"]

Triple = tuple[float, float, float]

PEAK_RISE_S: Final = 0.005
"""A slew limit that is not given lets the force rise from zero to its peak in this time."""


@dataclass(frozen=True)
class RenderSpec:
    """What was asked of the renderer; every default is safe for a hand.

    Parameters
    ----------
    rate_hz : float
        Ticks a second.
    friction, damping_n_s_per_m : float or None
        mu and b of paper 3.2; None takes those of the medium. With a b that is given there is no other damping.
    slip_speed_m_s : float
        v_s of `touchfield.filters.contact`.
    coupling_n_per_m : float or None
        Stiffness of a virtual coupling between hand and field; 0: none, the field acts on the hand directly. None
        chooses as `damping_n_s_per_m` does: what device and medium need to be stable (`render.stability`).
    passivity : bool
        Whether the time-domain passivity controller takes out what energy the loop made.
    scale : float
        Metres of the field for one metre of the device.
    clutch_m : (float, float, float)
        Point of the field that lies at the device's origin, metres, in the field's axes.
    force_scale : float
        Newtons of the device for one newton of the field.
    gravity_n : (float, float, float)
        A steady force added for the weight of the handle, newtons, in the device's axes.
    peak_n, continuous_n : float or None
        Limits of |F|; None takes those of the device (no continuous limit where it states none).
    slew_n_per_s : float or None
        Limit of |dF/dt|; None lets the force rise to its peak in 5 ms.
    thermal_s : float
        Time constant of the heat budget that lets the force exceed the continuous limit for a while, seconds.
    ramp_s : float
        In which the force goes to zero when the feed stalls, and comes back.
    velocity_cutoff_hz : float
        Of the low-pass on the velocity that is estimated from positions.
    blend : bool
        Whether one segment of a stream goes over into the next (`touchfield.render.segment_blend`).
    render : str
        "proxy": what the hand is pressed into holds, however thin (`touchfield.render.kernels.proxy`); "field": the
        force that is stored where the hand is; "auto": the proxy where the field is a wall's and no coupling is
        asked for (docs/decisions/0014).
    wall_n_per_m : float or None
        Stiffness of the proxy's spring; None takes that of the field.
    tool : Tool or None
        What the hand holds into the field; None: a point.
    peak_nm, continuous_nm, slew_nm_per_s : float or None
        Limits of the torque, as those of the force; a device that states none gets none.
    up : str
        Axis of the field that is up for the hand, one of `axes.UPS`.

    Raises
    ------
    InvalidArgument
        If a number is out of range or not finite, or a tool is asked for together with a coupling.
    """

    rate_hz: float = 1000.0
    friction: float | None = None
    damping_n_s_per_m: float | None = None
    slip_speed_m_s: float = 0.001
    coupling_n_per_m: float | None = None
    passivity: bool = False
    scale: float = 1.0
    clutch_m: Triple = (0.0, 0.0, 0.0)
    force_scale: float = 1.0
    gravity_n: Triple = (0.0, 0.0, 0.0)
    peak_n: float | None = None
    continuous_n: float | None = None
    slew_n_per_s: float | None = None
    thermal_s: float = 1.0
    ramp_s: float = 0.02
    velocity_cutoff_hz: float = 100.0
    blend: bool = True
    render: str = "auto"
    wall_n_per_m: float | None = None
    tool: Tool | None = None
    peak_nm: float | None = None
    continuous_nm: float | None = None
    slew_nm_per_s: float | None = None
    up: str = "auto"

    def __post_init__(self) -> None:
        for name in ("rate_hz", "slip_speed_m_s", "scale", "thermal_s", "ramp_s", "velocity_cutoff_hz"):
            _check(name, getattr(self, name), 0.0, open_low=True)
        _check("force_scale", self.force_scale, 0.0)
        for name in ("friction", "damping_n_s_per_m", "coupling_n_per_m"):
            if getattr(self, name) is not None:
                _check(name, getattr(self, name), 0.0)
        if self.tool is not None and self.coupling_n_per_m:
            found = f"{self.coupling_n_per_m:g} N/m with {self.tool.name}"
            raise InvalidArgument("coupling_n_per_m", found, "0 with a tool: the coupling is that of a point")
        if self.tool is not None and self.render == "proxy":
            raise InvalidArgument("render", f"'proxy' with {self.tool.name}", "field: the proxy is that of a point")
        above = "peak_n", "continuous_n", "slew_n_per_s", "peak_nm", "continuous_nm", "slew_nm_per_s", "wall_n_per_m"
        for name in above:
            if getattr(self, name) is not None:
                _check(name, getattr(self, name), 0.0, open_low=True)
        for name in ("clutch_m", "gravity_n"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(v) for v in values):
                raise InvalidArgument(name, repr(values), "three finite numbers")
        if self.render not in ("auto", "proxy", "field"):
            raise InvalidArgument("render", repr(self.render), "auto, proxy or field")
        if self.up not in UPS:
            raise InvalidArgument("up", repr(self.up), f"one of {', '.join(UPS)}")
        if not 10 <= self.rate_hz <= 20000:
            raise InvalidArgument("rate_hz", repr(self.rate_hz), "10 to 20000 ticks a second")


def _check(name: str, value: float, low: float, open_low: bool = False) -> None:
    if not (math.isfinite(value) and (value > low if open_low else value >= low)):
        raise InvalidArgument(name, repr(value), f"a finite number {'above' if open_low else 'of at least'} {low:g}")

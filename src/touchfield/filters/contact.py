"""Companions of a force: friction and damping (paper section 3.2), evaluated by the receiver, and vibration (6.4).

The coefficients mu and b travel beside the frames of a medium, and no frame changes. With the force F of the field
where the point is, and its velocity v::

    n = F / |F|,  v_t = v - (v . n) n,  F_t = -mu |F| v_t / max(|v_t|, v_s),      F_d = -b v

Our addition: below the slip speed v_s friction falls in proportion to v_t; without it the force would jump from one
side to the other as the hand rests. A loop of step dt that moves a mass m is steady if v_s >= mu |F| dt / m: 1 mm/s
is enough for 1 N, mu = 0.5 and 1 kHz from 0.5 kg on. Both take energy out, whatever F and v are: F_t . v <= 0,
F_d . v <= 0, and |F_t| <= mu |F|. Damping acts everywhere; friction needs a force.

How well F / |F| is the normal: between the samples of a sphere of 40 mm radius, 2 mm apart, it is off by 0.8 degrees
at most deeper than one sample; by 2.2 degrees in the first sample below the surface; and by 3.7 degrees in the rim
outside that interpolation adds. The error is in proportion to the spacing.

Vibration: a sine whose amplitude is a share of |F|, its frequency the same everywhere, or rising with |F| to F_max. It
stands behind the haptic filters, and is no filter itself: a filter makes a field of a field.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.medium.vibration import MAX_FREQUENCY_HZ, VibrationBand, VibrationFrame

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray

    from touchfield.medium import ForceField, HapticMedium

    Float64s = NDArray[np.float64]

SLIP_SPEED_M_S = 0.001


@dataclass(frozen=True)
class Contact:
    """The coefficients that the receiver renders beside the field.

    friction : float; mu, 0 or more.
    damping_n_s_per_m : float; b, 0 or more.
    slip_speed_m_s : float; v_s, metres a second, positive: from there on friction is whole.
    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    friction: float = 0.0
    damping_n_s_per_m: float = 0.0
    slip_speed_m_s: float = SLIP_SPEED_M_S

    def __post_init__(self) -> None:
        _not_negative("friction", self.friction)
        _not_negative("damping_n_s_per_m", self.damping_n_s_per_m)
        if not 0 < self.slip_speed_m_s < math.inf:
            raise InvalidArgument("slip_speed_m_s", repr(self.slip_speed_m_s), "a positive number of metres a second")

    @classmethod
    def of(cls, medium: HapticMedium, slip_speed_m_s: float = SLIP_SPEED_M_S) -> Contact:
        """The coefficients that travel with a medium."""
        return cls(medium.friction, medium.damping_n_s_per_m, slip_speed_m_s)


def friction_n(
    force_n: ArrayLike, velocity_m_s: ArrayLike, mu: float, slip_speed_m_s: float = SLIP_SPEED_M_S
) -> Float64s:
    """F_t = -mu |F| v_t / max(|v_t|, v_s): friction at a point of the field, against its motion along the surface.

    force_n : float [..., 3]; F, newtons; its direction is the normal. Where it is zero there is no friction.
    velocity_m_s : float [..., 3]; v of the interaction point, metres a second.
    mu : float; friction coefficient, 0 or more.
    slip_speed_m_s : float; v_s, metres a second, positive.
    Returns float64 [..., 3]: Newtons. Frictions below 1e-290 N are zero.
    Raises `InvalidArgument` if a number is not finite or out of range, the arrays do not fit each other, or mu |F| is
    beyond float64.
    """
    from touchfield.filters.kernels import forces as kernels

    Contact(mu, 0.0, slip_speed_m_s)
    force, velocity = _vectors("force_n", force_n), _vectors("velocity_m_s", velocity_m_s)
    try:
        force, velocity = np.broadcast_arrays(force, velocity)
    except ValueError:
        raise InvalidArgument("velocity_m_s", f"shape {velocity.shape}", f"one that fits {force.shape}") from None
    greatest = float(np.abs(force).max(initial=0.0))
    if not math.isfinite(greatest * 2 * max(1.0, float(mu))):
        raise InvalidArgument("mu |F|", f"{mu!r} times {greatest:g} N", "a force that float64 can hold")
    flat = [np.ascontiguousarray(a.reshape(-1, 3)) for a in (force, velocity)]
    out = np.empty_like(flat[0])
    kernels.frictions(flat[0], flat[1], float(mu), float(slip_speed_m_s), out)
    return out.reshape(force.shape)


def damping_n(velocity_m_s: ArrayLike, damping_n_s_per_m: float) -> Float64s:
    """F_d = -b v, newtons, float64 [..., 3], of velocities [..., 3] in metres a second.

    Raises `InvalidArgument` if b is negative, a number is not finite, or b |v| is beyond float64.
    """
    _not_negative("damping_n_s_per_m", damping_n_s_per_m)
    velocity = _vectors("velocity_m_s", velocity_m_s)
    fastest = float(np.abs(velocity).max(initial=0.0))
    if not math.isfinite(fastest * float(damping_n_s_per_m)):
        raise InvalidArgument(
            "b |v|", f"{damping_n_s_per_m!r} times {fastest:g} m/s", "a force that float64 can hold"
        )
    force: Float64s = -float(damping_n_s_per_m) * velocity
    return force


def rendered_n(field: ForceField, position_m: ArrayLike, velocity_m_s: ArrayLike, contact: Contact) -> Float64s:
    """The force of the device: the field at the point, friction and damping, newtons, float64 [..., 3].

    field : ForceField; the frame of now, ``medium[i]``.
    position_m, velocity_m_s : float [..., 3]; of the interaction point, in the metres of the field's grid.
    contact : Contact; ``Contact.of(medium)``.
    Raises `InvalidArgument` if a number is not finite or the arrays do not fit each other.
    """
    force = field.sample_n(_vectors("position_m", position_m)).astype(np.float64)
    friction = friction_n(force, velocity_m_s, contact.friction, contact.slip_speed_m_s)
    total: Float64s = force + friction + damping_n(velocity_m_s, contact.damping_n_s_per_m)
    return total


def _vectors(where: str, values: ArrayLike) -> Float64s:
    vectors = np.asarray(values, np.float64)
    if vectors.ndim < 1 or vectors.shape[-1] != 3:
        raise InvalidArgument(where, f"shape {vectors.shape}", "[..., 3]")
    if not np.isfinite(vectors).all():
        raise InvalidArgument(where, "a number that is not finite", "finite numbers")
    return vectors


def _not_negative(where: str, value: float) -> None:
    if not 0 <= value < math.inf:
        raise InvalidArgument(where, repr(value), "a finite number, 0 or more")


_OPTION = "--vibration"
_EXPECTED = "such as gain=0.1,frequency=150 or gain=0.1,frequency=80..250"


@dataclass(frozen=True)
class VibrationRule:
    """The rule of a vibration beside a force.

    gain : float; amplitude of the sine, as a share of |F|; above 0.
    low_hz, high_hz : float; frequency at no force, and at F_max; 1 to `MAX_FREQUENCY_HZ`.
    """

    gain: float = 0.1
    low_hz: float = 150.0
    high_hz: float = 150.0

    def __post_init__(self) -> None:
        if not 0 < self.gain < math.inf:
            raise InvalidArgument(f"{_OPTION} gain", repr(self.gain), "a share of |F| above 0")
        for hz in (self.low_hz, self.high_hz):
            if not 1 <= hz <= MAX_FREQUENCY_HZ:
                raise InvalidArgument(f"{_OPTION} frequency", f"{hz:g} Hz", f"1 to {MAX_FREQUENCY_HZ:g} Hz")

    @classmethod
    def parse(cls, text: str) -> VibrationRule:
        """A rule of words: "gain=0.1,frequency=150", "frequency=80..250"; what is not named is as by default.

        Raises `InvalidArgument` if a word is unknown, there twice, or has no number.
        """
        given: dict[str, float] = {}
        for part in (p for p in text.split(",") if p.strip()):
            name, _, value = (piece.strip() for piece in part.partition("="))
            names = {"gain": ("gain",), "frequency": ("low_hz", "high_hz")}.get(name, ())
            values = value.split("..") if name == "frequency" else [value]
            if not names or names[0] in given or len(values) > len(names):
                raise InvalidArgument(_OPTION, repr(part.strip()), _EXPECTED)
            try:
                numbers = [float(one) for one in values]
            except ValueError:
                raise InvalidArgument(f"{_OPTION} {name}", repr(value), _EXPECTED) from None
            given |= dict(zip(names, numbers * len(names) if len(numbers) == 1 else numbers))
        return cls(**given)

    def of(self, field: ForceField, force_max_n: float) -> VibrationFrame:
        """The vibration beside one field: all of its support, but for amplitudes too small for a number."""
        held = field.support()
        amplitudes = (self.gain * held.amplitudes_n.astype(np.float64)).astype(np.float32)
        share = np.minimum(held.amplitudes_n.astype(np.float64) / force_max_n, 1)
        hertz = (self.low_hz + (self.high_hz - self.low_hz) * share).astype(np.float32)
        kept = (amplitudes > 0) & np.isfinite(amplitudes)
        return VibrationFrame(field.grid, held.positions[kept], amplitudes[kept], hertz[kept])


def vibrating(medium: HapticMedium, rule: VibrationRule, force_max_n: float) -> HapticMedium:
    """The medium with a vibration by a rule beside it, in place of any that it has.

    force_max_n : float; F_max, at which the frequency is the highest, newtons.
    """
    latest = lru_cache(maxsize=1)(medium.__getitem__)  # its force and its vibration are asked for one after the other
    band = VibrationBand(medium.grid, medium.frame_count, lambda i: rule.of(latest(i), force_max_n))
    return replace(medium, make_frame=latest, vibration=band)

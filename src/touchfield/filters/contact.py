"""Effects that a surface adds to a force (paper section 3.2): friction, damping, texture; and vibration (6.4).

The coefficients mu and b travel beside the frames of a medium, and no frame changes. With the force F of the field
where the point is, and its velocity v::

    n = F / |F|,  v_t = v - (v . n) n,  F_t = -mu |F| v_t / max(|v_t|, v_s),      F_d = -b v

Our addition: below the slip speed v_s friction falls in proportion to v_t; without it the force would jump from one
side to the other as the hand rests. A loop of step dt that moves a mass m is steady if v_s >= mu |F| dt / m. Both
take energy out, whatever F and v are: F_t . v <= 0, F_d . v <= 0, and |F_t| <= mu |F|. Damping acts everywhere;
friction needs a force. F / |F| is the normal of a sphere to 0.8 degrees between samples, and to 3.7 at its rim.

Vibration: a sine whose amplitude is a share of |F|, its frequency the same everywhere, or rising with |F| up to
F_max. It stands behind the haptic filters, and is no filter itself: a filter makes a field of a field.

Texture: section 3.2, "convolving the force field with a high-pass kernel". ``literal`` is that sentence: y = h * x on
each component, h the impulse minus the mean of the box around it. Its gain at DC is 0: it amplifies edges.
``salt-pepper``, the default, is our reading of what was meant. Departure: the kernel takes impulses, not the field,
and what comes out is added to the amplitude along the force's own direction, where there is a force::

    y = x (1 + t),    t = clip(g (h * s), -limit, limit),    g = rms / sqrt(density (1 - 1/taps))

s is +1 or -1 at a share `density` of all grains and 0 at the others, drawn by a hash of the seed and the grain's
place in the lattice, like the grain of wood: the texture neither flickers from frame to frame nor moves when a brick
comes or goes. The clip acts from about rms > limit sqrt(density) on; what is added then has less than the RMS asked
for. limit <= 1 keeps a force from being turned round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np
from numpy.typing import ArrayLike

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import (
    InvalidArgument,
    require_between,
    require_not_negative,
    require_one_of,
    require_positive,
    require_up_to,
)
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.medium import BRICK, ForceField
from touchfield.medium.budget import zero_forces
from touchfield.medium.field import blocks_around, dilated, numbers_of
from touchfield.medium.medium import MAX_FREQUENCY_HZ, VibrationBand, VibrationFrame

if TYPE_CHECKING:
    from touchfield.medium import Grid, HapticMedium
Triple = tuple[int, int, int]

SLIP_SPEED_M_S = 0.001


@dataclass(frozen=True)
class Contact:
    """The coefficients that the receiver renders beside the field.

    Raises `InvalidArgument` if a number is out of range or not finite.
    """

    friction: float = 0.0  # mu, 0 or more
    damping_n_s_per_m: float = 0.0  # b, 0 or more
    slip_speed_m_s: float = SLIP_SPEED_M_S  # v_s, positive: from there on friction is whole

    def __post_init__(self) -> None:
        require_not_negative(friction=self.friction, damping_n_s_per_m=self.damping_n_s_per_m)
        require_positive(slip_speed_m_s=self.slip_speed_m_s)

    @classmethod
    def of(cls, medium: HapticMedium, slip_speed_m_s: float = SLIP_SPEED_M_S) -> Contact:
        """The coefficients that travel with a medium."""
        return cls(medium.friction, medium.damping_n_s_per_m, slip_speed_m_s)


def friction_n(
    force_n: ArrayLike, velocity_m_s: ArrayLike, mu: float, slip_speed_m_s: float = SLIP_SPEED_M_S
) -> Float64s:
    """F_t = -mu |F| v_t / max(|v_t|, v_s): friction at a point of the field, against its motion along the surface.

    force_n, velocity_m_s : float [..., 3]; F, newtons, and v of the interaction point.
    mu, slip_speed_m_s : float; friction coefficient, 0 or more, and v_s, positive.
    Returns float64 [..., 3]: Newtons; frictions below 1e-290 N are zero.
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
    require_not_negative(damping_n_s_per_m=damping_n_s_per_m)
    velocity = _vectors("velocity_m_s", velocity_m_s)
    fastest = float(np.abs(velocity).max(initial=0.0))
    if not math.isfinite(fastest * float(damping_n_s_per_m)):
        found = f"{damping_n_s_per_m!r} times {fastest:g} m/s"
        raise InvalidArgument("b |v|", found, "a force that float64 can hold")
    return np.asarray(-float(damping_n_s_per_m) * velocity)


def rendered_n(field: ForceField, position_m: ArrayLike, velocity_m_s: ArrayLike, contact: Contact) -> Float64s:
    """The force of the device: the field at the point, friction and damping, newtons, float64 [..., 3].

    position_m, velocity_m_s : float [..., 3]; of the interaction point, in the metres of the field's grid.
    Raises `InvalidArgument` if a number is not finite or the arrays do not fit each other.
    """
    force = field.sample_n(_vectors("position_m", position_m)).astype(np.float64)
    friction = friction_n(force, velocity_m_s, contact.friction, contact.slip_speed_m_s)
    return np.asarray(force + friction + damping_n(velocity_m_s, contact.damping_n_s_per_m))


def _vectors(where: str, values: ArrayLike) -> Float64s:
    vectors = numbers_of(where, values, is_finite=True)
    if vectors.ndim < 1 or vectors.shape[-1] != 3:
        raise InvalidArgument(where, f"shape {vectors.shape}", "[..., 3]")
    return vectors


_OPTION = "--vibration"
_EXPECTED = "such as gain=0.1,frequency=150 or gain=0.1,frequency=80..250"


@dataclass(frozen=True)
class VibrationRule:
    """The rule of a vibration beside a force."""

    gain: float = 0.1  # amplitude of the sine, as a share of |F|; above 0
    low_hz: float = 150.0  # frequency at no force, and at F_max; 1 to `MAX_FREQUENCY_HZ`
    high_hz: float = 150.0

    def __post_init__(self) -> None:
        require_positive(**{f"{_OPTION} gain": self.gain})
        for hz in (self.low_hz, self.high_hz):
            require_between(1, MAX_FREQUENCY_HZ, **{f"{_OPTION} frequency": hz})

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
        support = field.support()
        own = support.amplitudes_n.astype(np.float64)
        amplitudes, share = (self.gain * own).astype(np.float32), np.minimum(own / force_max_n, 1)
        hertz = (self.low_hz + (self.high_hz - self.low_hz) * share).astype(np.float32)
        kept = (amplitudes > 0) & np.isfinite(amplitudes)
        return VibrationFrame(field.grid, support.positions[kept], amplitudes[kept], hertz[kept])


def vibrating(medium: HapticMedium, rule: VibrationRule, force_max_n: float) -> HapticMedium:
    """The medium with a vibration by a rule beside it, in place of any that it has; F_max is in newtons."""
    latest = lru_cache(maxsize=1)(medium.__getitem__)  # its force and its vibration are asked for one after the other
    band = VibrationBand(medium.grid, medium.frame_count, lambda i: rule.of(latest(i), force_max_n))
    return replace(medium, make_frame=latest, vibration=band)


KINDS: Final = ("salt-pepper", "literal")
_MOST_SAMPLES: Final = 8  # of the literal kind: half a box is at most a brick
_BRICKS_AT_ONCE: Final = 256
_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)
_INSIDE: Final = 1 - 2.0**-22  # so that rounding to float32 never lifts a clipped force above the limit
_FLOAT32_MAX: Final = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class TextureFilter(FieldFilter):
    """A rough surface.

    grain_m : float, optional; width of a grain, metres, rounded to whole samples along each axis; by default one
        sample. Of the literal kind: half the width of the box, at most 8 samples.
    Raises `InvalidArgument` if a number is out of range; on a call, if the grain fits neither the samples nor the
    field.
    """

    kind: str = "salt-pepper"  # or "literal", which takes nothing of what follows but `grain_m` and `force_max_n`
    seed: int = 1  # 0 to 2^64 - 1
    density: float = 0.05  # share of the grains that hold an impulse, above 0, at most 1
    rms: float = 0.1  # root mean square of what is added, as a share of the local |F|; 0 to `limit`
    grain_m: float | None = None
    limit: float = 1.0  # the most that is added or taken away, as a share of the local |F|; above 0, at most 1
    force_max_n: float | None = None  # forces of the result are shortened to this

    name: ClassVar[str] = "texture"
    summary: ClassVar[str] = "rough surface, salt-pepper:seed=1,density=0.05,rms=0.1,grain=1mm, or literal:grain=1mm"
    example: ClassVar[str] = "salt-pepper:seed=1"

    def __post_init__(self) -> None:
        require_one_of("texture kind", self.kind, KINDS)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 1 << 64:
            raise InvalidArgument("texture seed", repr(self.seed), "a whole number from 0 to 2^64 - 1")
        require_up_to(1, **{"texture density": self.density, "texture limit": self.limit})
        require_between(0, self.limit, **{"texture rms": self.rms})
        for what, value in (("grain_m", self.grain_m), ("force_max_n", self.force_max_n)):
            if value is not None:
                require_positive(**{f"texture {what}": value})

    @classmethod
    def parse(cls, text: str) -> Self:
        """As `FieldFilter.parse`, and the kind may stand before a colon: ``salt-pepper:seed=1,rms=0.1``."""
        kind, colon, rest = text.partition(":")
        if colon and "=" not in kind:
            text = f"kind={kind},{rest}"
        return super().parse(text)

    def claims(self, grid: Grid) -> Claims:
        """Linear unless `force_max_n` is given; "salt-pepper" is a factor for each sample, "literal" a box."""
        grain, _ = self._grain_and_half(grid)
        linear = self.force_max_n is None
        if self.kind == "literal":
            return Claims(reach=grain, linear=linear, dc_gain=0.0)
        return Claims(reach=(0, 0, 0), linear=linear, keeps_support=True, keeps_direction=True)

    def __call__(self, field: ForceField) -> ForceField:
        """The field with its texture, newtons, on the same grid."""
        grain, half = self._grain_and_half(field.grid)
        ceiling_n = _FLOAT32_MAX if self.force_max_n is None else self.force_max_n
        if self.kind == "literal":
            return _high_passed(field, grain, ceiling_n)
        forces = zero_forces(len(field.bricks))
        for begin in range(0, len(forces), _BRICKS_AT_ONCE):
            some = slice(begin, begin + _BRICKS_AT_ONCE)
            factor = 1 + np.clip(self._shares(field.bricks[some], grain, half), -self.limit, self.limit)
            forces[some] = _shortened(field.forces_n[some] * factor[..., None], ceiling_n)
        return ForceField.from_bricks(field.grid, field.bricks, forces)

    def _shares(self, bricks: Int32s, grain: Triple, half: Triple) -> Float64s:
        """g (h * s) at the samples of some bricks, float64 [n, 8, 8, 8], not yet limited."""
        first = bricks.astype(np.int64) * BRICK // grain
        samples = bricks[:, :, None] * BRICK + np.arange(BRICK)
        x, y, z = (samples[:, a] // grain[a] - first[:, a, None] + half[a] for a in range(3))  # grains, from `first`
        # -1, 0 or 1 at grains -1 to 2^20: the splitmix64 stream of the seed, jumped into
        i, j, k = ((first[:, a, None] + np.arange(1, BRICK + 3) - half[a]).astype(np.uint64) for a in range(3))
        number = i[:, :, None, None] | j[:, None, :, None] << np.uint64(21) | k[:, None, None] << np.uint64(42)
        with np.errstate(over="ignore"):
            bits = mixed(mixed(np.uint64(self.seed) + _GOLDEN) + (number + np.uint64(1)) * _GOLDEN)
        is_there = (bits >> np.uint64(11)) * 2.0**-53 < self.density
        total = impulses = np.where(is_there, np.where(bits & np.uint64(1), 1, -1), 0)
        for axis in np.flatnonzero(half):
            total = total + np.roll(total, 1, axis + 1) + np.roll(total, -1, axis + 1)
        taps = 3 ** sum(half)
        gain = self.rms / math.sqrt(self.density * (1 - 1 / taps)) / taps
        n = np.arange(len(bricks))[:, None, None, None]
        values = impulses * taps - total
        return np.asarray(gain * values[n, x[:, :, None, None], y[:, None, :, None], z[:, None, None]])

    def _grain_and_half(self, grid: Grid) -> tuple[Triple, Triple]:
        """Samples to a grain, and 1 for each axis that the kernel runs along.

        Along an axis of one sample there is nothing to be rough; the literal kernel then has half a width of 0.
        """
        half = tuple(int(n > 1) for n in grid.shape)
        if not any(half):
            raise InvalidArgument("texture", "a field of one sample", "more samples than one")
        grain = [1, 1, 1]
        if self.grain_m is not None:
            grain = [max(round(min(self.grain_m / h, 1 << 21)), 0) for h in grid.spacing_m]
        for axis, (g, n) in enumerate(zip(grain, grid.shape, strict=True)):
            if not half[axis]:
                grain[axis] = 0 if self.kind == "literal" else 1
                continue
            widest = min((n - 1) // 2, _MOST_SAMPLES) if self.kind == "literal" else n
            if not 1 <= g <= widest:
                found = f"{self.grain_m!r}, {g} samples along axis {axis}, which has {n}"
                expected = (
                    f"1 to {widest} samples of {grid.spacing_m[axis]:g} m" if widest else "an axis of 3 samples"
                )
                raise InvalidArgument("texture grain_m", found, expected)
        return (grain[0], grain[1], grain[2]), (half[0], half[1], half[2])


def mixed(z: Any) -> Any:
    """The output function of splitmix64 (Steele, Lea and Flood 2014), uint64 to uint64, one to one."""
    with np.errstate(over="ignore"):  # products are meant to wrap round
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))


def _shortened(forces_n: Float64s, ceiling_n: float) -> Float64s:
    """Forces float64 [..., 3] no longer than a length."""
    squares = (forces_n * forces_n).sum(axis=-1, keepdims=True)
    is_longer = squares > ceiling_n * ceiling_n
    return np.where(is_longer, forces_n * (ceiling_n * _INSIDE / np.sqrt(np.where(is_longer, squares, 1))), forces_n)


def _high_passed(field: ForceField, half: Triple, ceiling_n: float) -> ForceField:
    """The impulse less the mean of the box of 2 half + 1 samples, over each component."""
    from scipy import ndimage

    taps = math.prod(2 * r + 1 for r in half)
    bricks = dilated(field.grid, field.bricks, half)
    forces = zero_forces(len(bricks))
    middle = (slice(None), *(slice(r, r + BRICK) for r in half))
    for span, blocks in blocks_around(field, field.forces_n, bricks, half, half):
        values = blocks.astype(np.float64)
        box = values
        for axis, r in enumerate(half):
            box = ndimage.correlate1d(box, np.ones(2 * r + 1), axis=axis + 1, mode="constant")
        # a constant is exact here: whole multiples of float32 below 2^13 in float64
        forces[span] = _shortened(((taps * values - box) / taps)[middle], ceiling_n)
    return ForceField.from_bricks(field.grid, bricks, forces)

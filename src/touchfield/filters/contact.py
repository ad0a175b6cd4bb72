"""Effects of contact: friction and damping, texture, and vibration (paper sections 3.2 and 6.4). Friction and
damping are stored as numbers with a medium, and the receiver applies them.

The coefficients mu and b are metadata of a medium and change no frame. With the force F of the field at the
point, and its velocity v, the receiver adds (``c/touch_friction.h``, ``c/touch_effects.h``) ::

    n = F / |F|,  s = anchor - point, along the surface,  |s| <= mu |F| / k
    F_t = k s - c (v - (v . n) n), at most mu |F|,        F_d = -b v

Friction has an anchor, the point that the hand stuck to last. A spring k pulls the hand back to it, and the
anchor slides after where the spring would pull by more than mu |F| (Hayward and Armstrong 2000, "A new
computational model of friction applied to haptic rendering"). F_t depends on positions, so that it is
constant while the hand rests. k is 1000 N/m of the device, or what its loop renders stably; c is the damper
that k needs there. Over a cycle friction removes energy: the spring gives back what stretched it, and what
slides is lost. Damping acts everywhere, with F_d . v <= 0; friction needs a force. F / |F| is the normal of a
sphere to within 0.8 degrees between samples, and 3.7 degrees at its rim.

Vibration: a sine whose amplitude is a fraction of |F|; its frequency is constant or rises with |F| up to
F_max. It is applied after the haptic filters and is no filter itself: a filter maps a field to a field.

Texture: section 3.2, "convolving the force field with a high-pass kernel". Departure: applied to a field, the
kernel would leave only its edges. Here the kernel filters impulses, and the result is added to the amplitude
along the force's own direction, where there is a force::

    y = x (1 + t),    t = clip(g (h * s), -1, 1),    g = rms / sqrt(density (1 - 1/taps))

s is +1 or -1 at a fraction `density` of all grains and 0 at the others, drawn by a hash of the seed and the
grain's index in the lattice, so that the texture neither flickers from frame to frame nor moves when a brick
appears or vanishes. The clip, which keeps a force from being reversed, acts from about rms > sqrt(density)
on; the added part then has less than the requested RMS.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, ClassVar, Final, Self

import numpy as np

from touchfield.arrays import Float64s, Int32s
from touchfield.errors import (
    InvalidArgument,
    require_between,
    require_one_of,
    require_positive,
    require_up_to,
)
from touchfield.filters.fir import without_overflow
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.medium import BRICK, ForceField
from touchfield.medium.budget import zero_forces
from touchfield.medium.medium import MAX_FREQUENCY_HZ, VibrationFrame

if TYPE_CHECKING:
    from touchfield.medium import Grid, HapticMedium
Triple = tuple[int, int, int]

_OPTION = "--vibration"
_EXPECTED = "such as gain=0.1,frequency=150 or gain=0.1,frequency=80..250"


@dataclass(frozen=True)
class VibrationRule:
    """The rule by which a vibration follows a force."""

    gain: float = 0.1  # amplitude of the sine, as a fraction of |F|; above 0
    low_hz: float = 150.0  # frequency at no force, and at F_max; 1 to `MAX_FREQUENCY_HZ`
    high_hz: float = 150.0

    def __post_init__(self) -> None:
        require_positive(**{f"{_OPTION} gain": self.gain})
        for hz in (self.low_hz, self.high_hz):
            require_between(1, MAX_FREQUENCY_HZ, **{f"{_OPTION} frequency": hz})

    @classmethod
    def parse(cls, text: str) -> VibrationRule:
        """Parse a rule such as "gain=0.1,frequency=150" or "frequency=80..250"; the rest takes its default.

        Raises `InvalidArgument` if a name is unknown or given twice, or has no number.
        """
        options: dict[str, float] = {}
        for part in (p for p in text.split(",") if p.strip()):
            name, _, value = (piece.strip() for piece in part.partition("="))
            names = {"gain": ("gain",), "frequency": ("low_hz", "high_hz")}.get(name, ())
            values = value.split("..") if name == "frequency" else [value]
            if not names or names[0] in options or len(values) > len(names):
                raise InvalidArgument(_OPTION, repr(part.strip()), _EXPECTED)
            try:
                numbers = [float(number) for number in values]
            except ValueError:
                raise InvalidArgument(f"{_OPTION} {name}", repr(value), _EXPECTED) from None
            options |= dict(zip(names, numbers * len(names) if len(numbers) == 1 else numbers))
        return cls(**options)

    def of(self, field: ForceField, force_max_n: float) -> VibrationFrame:
        """Return the vibration of one field, at all of its support except where the amplitude underflows."""
        support = field.support()
        forces_n = support.amplitudes_n.astype(np.float64)
        amplitudes, fraction = (
            (self.gain * forces_n).astype(np.float32),
            np.minimum(forces_n / force_max_n, 1),
        )
        hertz = (self.low_hz + (self.high_hz - self.low_hz) * fraction).astype(np.float32)
        is_audible = (amplitudes > 0) & np.isfinite(amplitudes)
        return VibrationFrame(
            field.grid, support.positions[is_audible], amplitudes[is_audible], hertz[is_audible]
        )


def add_vibration(medium: HapticMedium, rule: VibrationRule, force_max_n: float) -> HapticMedium:
    """Return the medium with a vibration by a rule, in place of any that it has; F_max is in newtons."""
    latest = lru_cache(maxsize=1)(medium.__getitem__)  # force and vibration are requested in turn
    return replace(medium, make_frame=latest, vibration=lambda i: rule.of(latest(i), force_max_n))


KINDS: Final = ("salt-pepper",)
_BRICKS_AT_ONCE: Final = 256
_GOLDEN: Final = np.uint64(0x9E3779B97F4A7C15)


@dataclass(frozen=True)
class TextureFilter(FieldFilter):
    """A rough surface.

    grain_m : float, optional; width of a grain, metres, rounded to whole samples along each axis; by default
        one sample.
    Raises `InvalidArgument` if a number is out of range; on a call, if the grain fits neither the samples nor
    the field.
    """

    kind: str = "salt-pepper"
    seed: int = 1  # 0 to 2^64 - 1
    density: float = 0.05  # fraction of the grains with an impulse, above 0, at most 1
    rms: float = 0.1  # root mean square of the added part, as a fraction of the local |F|; 0 to 1
    grain_m: float | None = None

    name: ClassVar[str] = "texture"
    summary: ClassVar[str] = "rough surface, salt-pepper:seed=1,density=0.05,rms=0.1,grain=1mm"
    example: ClassVar[str] = "salt-pepper:seed=1"

    def __post_init__(self) -> None:
        require_one_of("texture kind", self.kind, KINDS)
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 1 << 64:
            raise InvalidArgument("texture seed", repr(self.seed), "a whole number from 0 to 2^64 - 1")
        require_up_to(1, **{"texture density": self.density})
        require_between(0, 1, **{"texture rms": self.rms})
        if self.grain_m is not None:
            require_positive(**{"texture grain_m": self.grain_m})

    @classmethod
    def parse(cls, text: str) -> Self:
        """As `FieldFilter.parse`, and the kind may stand before a colon: ``salt-pepper:seed=1,rms=0.1``."""
        kind, colon, rest = text.partition(":")
        if colon and "=" not in kind:
            text = f"kind={kind},{rest}"
        return super().parse(text)

    def claims(self, grid: Grid) -> Claims:
        """Linear: one factor for each sample."""
        self._grain_and_half(grid)
        return Claims(reach=(0, 0, 0), linear=True, keeps_support=True, keeps_direction=True)

    def __call__(self, field: ForceField) -> ForceField:
        """The field with its texture, newtons, on the same grid."""
        grain, half = self._grain_and_half(field.grid)
        forces = zero_forces(len(field.bricks))
        for start in range(0, len(forces), _BRICKS_AT_ONCE):
            chunk = slice(start, start + _BRICKS_AT_ONCE)
            factor = 1 + np.clip(self._factors(field.bricks[chunk], grain, half), -1.0, 1.0)
            with np.errstate(over="ignore"):
                forces[chunk] = field.forces_n[chunk] * factor[..., None]
        without_overflow(forces, "--texture forces")
        return ForceField.from_bricks(field.grid, field.bricks, forces)

    def _factors(self, bricks: Int32s, grain: Triple, half: Triple) -> Float64s:
        """g (h * s) at the samples of some bricks, float64 [n, 8, 8, 8], not yet limited."""
        first = bricks.astype(np.int64) * BRICK // grain
        samples = bricks[:, :, None] * BRICK + np.arange(BRICK)
        x, y, z = (
            samples[:, a] // grain[a] - first[:, a, None] + half[a] for a in range(3)
        )  # grains, from `first`
        # -1, 0 or 1 at grains -1 to 2^20: the splitmix64 stream of the seed, jumped into
        i, j, k = (
            (first[:, a, None] + np.arange(1, BRICK + 3) - half[a]).astype(np.uint64) for a in range(3)
        )
        number = (
            i[:, :, None, None] | j[:, None, :, None] << np.uint64(21) | k[:, None, None] << np.uint64(42)
        )
        with np.errstate(over="ignore"):
            bits = splitmix64(splitmix64(np.uint64(self.seed) + _GOLDEN) + (number + np.uint64(1)) * _GOLDEN)
        is_impulse = (bits >> np.uint64(11)) * 2.0**-53 < self.density
        total = impulses = np.where(is_impulse, np.where(bits & np.uint64(1), 1, -1), 0)
        for axis in np.flatnonzero(half):
            total = total + np.roll(total, 1, axis + 1) + np.roll(total, -1, axis + 1)
        taps = 3 ** sum(half)
        gain = self.rms / math.sqrt(self.density * (1 - 1 / taps)) / taps
        n = np.arange(len(bricks))[:, None, None, None]
        values = impulses * taps - total
        return np.asarray(gain * values[n, x[:, :, None, None], y[:, None, :, None], z[:, None, None]])

    def _grain_and_half(self, grid: Grid) -> tuple[Triple, Triple]:
        """Return the samples per grain, and 1 for each axis with several samples, which the kernel covers."""
        half = tuple(int(n > 1) for n in grid.shape)
        if not any(half):
            raise InvalidArgument("texture", "a field of one sample", "more samples than one")
        grain = [1, 1, 1]
        if self.grain_m is not None:
            grain = [max(round(min(self.grain_m / h, 1 << 21)), 0) for h in grid.spacing_m]
        for axis, (g, n) in enumerate(zip(grain, grid.shape, strict=True)):
            if not half[axis]:
                grain[axis] = 1
            elif not 1 <= g <= n:
                found = f"{self.grain_m!r}, {g} samples along axis {axis}, which has {n}"
                expected = f"1 to {n} samples of {grid.spacing_m[axis]:g} m"
                raise InvalidArgument("texture grain_m", found, expected)
        return (grain[0], grain[1], grain[2]), (half[0], half[1], half[2])


def splitmix64(z: Any) -> Any:
    """The output function of splitmix64 (Steele, Lea and Flood 2014), uint64 to uint64, one to one."""
    with np.errstate(over="ignore"):  # products are meant to wrap round
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return z ^ (z >> np.uint64(31))

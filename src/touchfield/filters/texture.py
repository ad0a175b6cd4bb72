"""Salt-and-pepper texture: section 3.2, "convolving the force field with a high-pass kernel".

``literal`` is that sentence: y = h * x on each component, h the impulse minus the mean of the box around it. Its gain
at DC is 0, so that no surface is left of a surface: it amplifies the edges that are there.

``salt-pepper``, the default, is our reading of what was meant. Departure: the kernel takes impulses, not the field,
and what comes out is added to the amplitude along the force's own direction, where there is a force::

    y = x (1 + t),    t = clip(g (h * s), -limit, limit),    g = rms / sqrt(density (1 - 1/taps))

s is +1 or -1 at a share `density` of all grains and 0 at the others, each drawn by a hash of the seed and the grain's
place in the lattice. h * s has the variance density (1 - 1/taps): 27 taps in space, 9 in a plane, 3 on a line. So the
texture neither flickers from frame to frame nor moves when a brick comes or goes: t belongs to the place, like the
grain of wood. The clip acts from about rms > limit sqrt(density) on; what is added then has less than the RMS asked
for. limit <= 1 keeps a force from being turned round.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Self

import numpy as np

from touchfield.errors import InvalidArgument
from touchfield.filters.registry import Claims, FieldFilter
from touchfield.medium import ForceField
from touchfield.medium.field import brick_keys, dilated, neighbour_slots

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from touchfield.medium import Grid

KINDS: Final = ("salt-pepper", "literal")

_MOST_SAMPLES: Final = 8
"""Of the literal kind: half a box is at most a brick."""

_FLOAT32_MAX: Final = float(np.finfo(np.float32).max)


@dataclass(frozen=True)
class TextureFilter(FieldFilter):
    """A rough surface.

    kind : str; "salt-pepper" or "literal"; the latter takes nothing of what follows but `grain_m` and `force_max_n`.
    seed : int; 0 to 2^64 - 1; another seed, another texture.
    density : float; share of the grains that hold an impulse, above 0, at most 1.
    rms : float; root mean square of what is added, as a share of the local |F|; 0 to `limit`.
    grain_m : float, optional; width of a grain, metres, rounded to whole samples along each axis; by default one
        sample. Of the literal kind: half the width of the box, at most 8 samples.
    limit : float; the most that is added or taken away, as a share of the local |F|; above 0, at most 1.
    force_max_n : float, optional; forces of the result are shortened to this, newtons.
    Raises `InvalidArgument` if a number is out of range; on a call, if the grain fits neither the samples nor the
    field.
    """

    kind: str = "salt-pepper"
    seed: int = 1
    density: float = 0.05
    rms: float = 0.1
    grain_m: float | None = None
    limit: float = 1.0
    force_max_n: float | None = None

    name: ClassVar[str] = "texture"
    summary: ClassVar[str] = "rough surface, salt-pepper:seed=1,density=0.05,rms=0.1,grain=1mm, or literal:grain=1mm"
    example: ClassVar[str] = "salt-pepper:seed=1"

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise InvalidArgument("texture kind", repr(self.kind), " or ".join(KINDS))
        if isinstance(self.seed, bool) or not isinstance(self.seed, int) or not 0 <= self.seed < 1 << 64:
            raise InvalidArgument("texture seed", repr(self.seed), "a whole number from 0 to 2^64 - 1")
        if not 0 < self.density <= 1:
            raise InvalidArgument("texture density", repr(self.density), "a share above 0, at most 1")
        if not 0 < self.limit <= 1:
            raise InvalidArgument("texture limit", repr(self.limit), "a share above 0, at most 1")
        if not 0 <= self.rms <= self.limit:
            raise InvalidArgument("texture rms", repr(self.rms), f"a share from 0 to the limit, {self.limit:g}")
        for what, value in (("grain_m", self.grain_m), ("force_max_n", self.force_max_n)):
            if value is not None and not 0 < value < math.inf:
                raise InvalidArgument(f"texture {what}", repr(value), "a positive number, or none")

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
            return _literal(field, grain, ceiling_n)
        from touchfield.filters.kernels import forces as kernels

        taps = 3 ** sum(half)
        gain = self.rms / math.sqrt(self.density * (1 - 1 / taps)) / taps
        law = (self.seed, float(self.density), gain, float(self.limit), float(ceiling_n))
        forces, is_held = kernels.textured(field.bricks, field.forces_n, grain, half, law)
        return ForceField(field.grid, field.bricks[is_held], forces[is_held])

    def _grain_and_half(self, grid: Grid) -> tuple[tuple[int, int, int], tuple[int, int, int]]:
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
                raise InvalidArgument(
                    "texture grain_m",
                    f"{self.grain_m!r}, {g} samples along axis {axis}, which has {n}",
                    f"1 to {widest} samples of {grid.spacing_m[axis]:g} m" if widest else "an axis of 3 samples",
                )
        return (grain[0], grain[1], grain[2]), (half[0], half[1], half[2])


def _literal(field: ForceField, half: tuple[int, int, int], ceiling_n: float) -> ForceField:
    from touchfield.filters.kernels import forces as kernels

    bricks = dilated(field.grid, field.bricks, half)
    slots = neighbour_slots(field.grid, bricks)
    forces = kernels.high_passed(_stored(field, bricks, slots), field.forces_n, half, ceiling_n)
    return ForceField.from_bricks(field.grid, bricks, forces)


def _stored(field: ForceField, bricks: NDArray[np.int32], slots: NDArray[np.int32]) -> NDArray[np.int32]:
    """Places among `bricks` as places among the bricks of the field, -1 where it has none."""
    place = np.full(len(bricks) + 1, -1, np.int32)  # the last stands for -1
    keys = brick_keys(field.grid, bricks)
    place[np.searchsorted(keys, brick_keys(field.grid, field.bricks))] = np.arange(len(field.bricks))
    found: NDArray[np.int32] = place[slots]
    return found

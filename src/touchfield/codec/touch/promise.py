"""Promise of the coder `touch`, and how well a decoded frame keeps it (paper section 4.2, figure 2).

|F_dec - F| <= max(F_0, k |F|) for every voxel, those without force too, or the rule of mode "mask-direction". Held
against the decoder's own output in float64, as `touchfield.perception.mask` does.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from touchfield.codec.touch.kernels.compare import Compared
    from touchfield.codec.touch.lattice import FixedField
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField


@dataclass(frozen=True)
class Worst:
    """The voxel of a segment whose error is the largest share of what is allowed."""

    ratio: float  # that share, 0 to 1, rounded up to a multiple of 1/65535
    frame: int  # in the segment
    voxel: tuple[int, int, int]  # index into the grid


@dataclass(frozen=True)
class Promise:
    """Promise of a segment, and its worst voxel, found by the encoder on the decoder's own output."""

    mode: str  # see `TouchSpec`
    # k, f0_n: Weber fraction, and F_0 in newtons; None in a mode without them
    k: float | None
    f0_n: float | None
    direction_jnd_deg: float | None
    worst: Worst | None  # None in mode "nmse", which promises nothing. In mode "lossless" its ratio is 0

    @classmethod
    def of(cls, spec: TouchSpec, worst: Worst | None) -> Promise:
        """The promise of a mode."""
        masked = spec.mode in ("mask", "mask-direction")
        return cls(
            spec.mode,
            spec.k if masked else None,
            spec.f0_n if masked else None,
            spec.direction_jnd_deg if spec.mode == "mask-direction" else None,
            worst,
        )

    @property
    def worst_ratio(self) -> float | None:
        """The largest |error| / allowed."""
        return None if self.worst is None else self.worst.ratio

    def describe(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        worst = self.worst
        return {
            "mode": self.mode,
            "k": self.k,
            "f0_n": self.f0_n,
            "direction_jnd_deg": self.direction_jnd_deg,
            "worst_ratio": self.worst_ratio,
            "worst_frame": None if worst is None else worst.frame,
            "worst_voxel": None if worst is None else list(worst.voxel),
        }


def compared(original: ForceField, decoded: ForceField, spec: TouchSpec, within_step: bool = False) -> Compared:
    """How a decoded frame keeps what was asked for, or in mode "nmse" half a step."""
    from touchfield.codec.touch.kernels import compare as kernels

    rules = {
        "mask": kernels.MASK,
        "mask-direction": kernels.DIRECTION,
        "nmse": kernels.FREE,
        "lossless": kernels.EXACTLY,
    }
    angle = math.radians(spec.direction_jnd_deg)
    rule, k, f0_n = rules[spec.mode], spec.k, spec.f0_n
    if within_step:
        rule, k, f0_n = kernels.MASK, 0.0, spec.step_n / 2
    exact = spec.support == "exact" and not within_step
    mine, theirs = ((brick_keys(f.grid, f.bricks), f.forces_n) for f in (original, decoded))
    return kernels.compare(mine, theirs, rule, exact, (k, f0_n, math.sin(angle), angle))


def agreement(original: ForceField, guess: FixedField, unit_n: float, spec: TouchSpec) -> float:
    """The share of voxels with a force, here or in `guess`, at which `guess` keeps the rule; 1 where there is none.

    In mode "nmse" the rule is an error of at most half a step.
    """
    found = compared(original, guess.field(original.grid, unit_n), spec, within_step=spec.mode == "nmse")
    spurious = len(found.keys) - (found.supported - found.within)
    return found.within / (found.supported + spurious) if found.supported + spurious else 1.0

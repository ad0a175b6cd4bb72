"""Ways to code a frame: after the one before or alone, with a guess or without.

An effort is how many of them are tried; the fewest bytes win, or, where every error has its price, the best bargain.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, NamedTuple

from touchfield.codec.touch.frame import Known, Memory, fresh_memory
from touchfield.codec.touch.frame_encoder import CodedFrame, Sketch, encode_frame, sketch_of
from touchfield.codec.touch.guess_fit import fit
from touchfield.codec.touch.promise import agreement
from touchfield.codec.touch.rule import limits_for

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.kernels.choice import Limits
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField, Grid

__all__ = ["Chooser", "Way"]


class Way(NamedTuple):
    """How a frame is coded: whether the frame before is known, and a guess."""

    inter: bool
    guess: tuple[bytes, FixedField] | None


@dataclass(frozen=True)
class _Effort:
    """Trials of an effort.

    `alike` and `unlike` are shares of voxels at which the frame before keeps the rule: from the first on a frame is
    coded after it, below the second alone, and between them both ways are tried; `still` that share from which on no
    guess is looked for, and `trusted` the share at which a guess must keep the rule for nothing else to be tried. A
    guess that earns less than the share `earns` of a frame's bytes is not looked for in later frames of the segment.
    """

    alike: float
    unlike: float
    still: float
    trusted: float
    earns: float


_EFFORTS: Final = {
    "fast": _Effort(0.1, 0.1, 0.8, 0.85, 0.1),
    "default": _Effort(0.1, 0.02, 0.8, 0.85, 0.03),
    "max": _Effort(1.1, -1.0, 1.1, 1.1, -1.0),
}


@dataclass
class Chooser:
    """State of an encoder within a segment.

    Parameters
    ----------
    grid : Grid
    spec : TouchSpec
    lattice : Lattice
    """

    grid: Grid
    spec: TouchSpec
    lattice: Lattice

    def __post_init__(self) -> None:
        self._effort = _EFFORTS[self.spec.effort]
        self._limits: Limits = limits_for(self.spec, self.lattice)
        self._previous: FixedField | None = None
        self._memory: Memory = fresh_memory()
        self._looks = self.spec.guess == "auto"

    def add(self, frame: ForceField) -> tuple[CodedFrame, bool, bytes]:
        """Code the next frame; whether it knows the one before, and the bytes of its guess."""
        sketch = sketch_of(frame, self.lattice.unit_n, self._limits)
        limits = self._limits._replace(thorough=False)
        tried = [(self._coded(sketch, way, limits), way) for way in self._ways(frame, sketch)]
        worths = [self._worth(sketch, coded, way) for (coded, _), way in tried]
        (best, memory), way = tried[worths.index(min(worths))]
        if tried[0][1].guess is not None and len(tried) > 1:  # the guess stands first
            self._looks = worths[0] < (1 - self._effort.earns) * min(worths[1:])
        if self._limits.thorough:
            again, learnt = self._coded(sketch, way, self._limits)
            if self._worth(sketch, again, way) < self._worth(sketch, best, way):
                best, memory = again, learnt
        self._previous, self._memory = best.decoded, memory
        return best, way.inter, way.guess[0] if way.guess else b""

    def _ways(self, frame: ForceField, sketch: Sketch) -> list[Way]:
        effort, previous = self._effort, self._previous
        alike = 0.0
        if previous is not None and self.spec.interframe == "auto":
            alike = agreement(frame, previous, self.lattice.unit_n, self.spec)
        inters = [False, True]
        if previous is None or self.spec.interframe == "off":
            inters = [False]
        elif self.spec.interframe == "on" or alike >= effort.alike:
            inters = [True]
        elif alike < effort.unlike:
            inters = [False]
        guess, kept = None, 0.0
        if self._looks and alike < effort.still and len(sketch.bricks):
            guess, kept = fit(frame, self.lattice, self._limits, self.spec)
        ways = [Way(inter, None) for inter in inters]
        if guess is None or kept <= alike:
            return ways
        guessed = [Way(inters[-1], guess)]
        return guessed if kept >= effort.trusted and not self._limits.free else guessed + ways

    def _coded(self, sketch: Sketch, way: Way, limits: Limits) -> tuple[CodedFrame, Memory]:
        memory = self._memory.copy() if way.inter else fresh_memory()
        reference = self._previous if way.inter else None
        if way.guess is not None:
            reference = way.guess[1]
        return encode_frame(sketch, Known(self.grid, self.lattice, reference, memory), limits), memory

    def _worth(self, sketch: Sketch, coded: CodedFrame, way: Way) -> float:
        """Bytes; where every error has its price, what they and the errors come to."""
        size = len(coded.payload) + (len(way.guess[0]) if way.guess else 0)
        if not self._limits.free:
            return float(size)
        made = sketch.course.turned(coded.decoded.vectors, sketch.order)
        error = float(((made - sketch.forces) ** 2).sum()) / self.lattice.floor**2
        return error / (8 * self._limits.thrift) + size

"""Which way each frame is coded: alone or after the one before, with a guess or without; the fewest bytes win.

What is cheap decides first (`ways`): an effort codes a frame once or twice, and `max` tries all ways with the light
model and only the best of them with the heavy one. Both compete: a more thorough effort is never the larger one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from touchfield.codec.touch.body import FrameRecord, GuessKind, shares_of
from touchfield.codec.touch.exceptions import Exceptions
from touchfield.codec.touch.frame_model import Known, Rule
from touchfield.codec.touch.max_model import MaxModel
from touchfield.codec.touch.models import FAST, LIGHT, MAX, frame_model
from touchfield.codec.touch.post_filter import write_terms
from touchfield.codec.touch.post_filter_fit import error_of, fitted, worth
from touchfield.codec.touch.promise import agreement
from touchfield.codec.touch.ways import REACHING, Guess, Way, made, may_be_solid
from touchfield.medium.field import brick_keys

if TYPE_CHECKING:
    from touchfield.codec.touch.fixed_field import FixedField
    from touchfield.codec.touch.lattice import Lattice
    from touchfield.codec.touch.spec import TouchSpec
    from touchfield.medium import ForceField, Grid

__all__ = ["Chooser", "Chosen"]


@dataclass(frozen=True)
class _Effort:
    """What an effort tries.

    `model` codes the frames; where errors are free, at least the light one does, for the quick one knows thresholds
    and no prices: it took up to ten times the bytes there. `alike` and `unlike` are shares of voxels at which the
    previous frame keeps the rule: from the first on a frame is coded after it, below the second alone, and between
    them both ways are tried. A guess of motion is worth a trial where it keeps the rule at `motion_gain` more of the
    voxels than the previous frame does, and a surface where the previous frame does so at less than `still` of them.
    From `trusted` on a surface is not doubted, and it is sought where a share `solid` of the columns of bricks
    reaches the inner border. The post filter (of mode "nmse") looks at so many `neighbours`, none for no filter.
    """

    model: int
    alike: float
    unlike: float
    motion_gain: float | None
    still: float
    trusted: float
    solid: float = REACHING
    neighbours: int = 0


_EFFORTS: Final = {
    "fast": _Effort(FAST, 0.1, 0.1, None, 0.8, 0.9, solid=0.8),
    "default": _Effort(LIGHT, 0.1, 0.02, 0.1, 0.8, 0.85, neighbours=12),
    "max": _Effort(LIGHT, 1.1, -1.0, 0.01, 1.1, 1.1, neighbours=26),
}

_SECOND: Final = 1.05
"""The heavy model takes the second best way as well if the light one needs at most this much more for it."""


@dataclass(frozen=True)
class Chosen:
    """A frame's record, what the decoder will hold after it, the voxels sent apart, and what the model learnt."""

    record: FrameRecord
    decoded: FixedField
    exceptions: Exceptions
    memory: Any

    @property
    def size(self) -> int:
        """Bytes."""
        return len(self.record.to_bytes())


@dataclass
class Chooser:
    """The encoder's state within a segment."""

    grid: Grid
    spec: TouchSpec
    lattice: Lattice
    rule: Rule
    previous: FixedField | None = None
    _moves: bool = field(default=True)
    _memories: dict[int, Any] = field(default_factory=dict)

    def add(self, frame: ForceField) -> Chosen:
        """Code the next frame."""
        alike = 0.0 if self.previous is None else self._agreement(frame, self.previous)
        ways = self._ways(frame, alike)
        model = LIGHT if self.rule.free else self._effort.model
        candidates = [self._coded(frame, way, model) for way in ways]
        if self.spec.effort == "max" and MaxModel.takes(frame, self.rule):
            candidates += [self._coded(frame, way, MAX) for way in self._screened(ways, candidates)]
        best = self._best(frame, candidates)
        self.previous = best.decoded
        self._memories[best.record.model] = best.memory
        return self._filtered(frame, best)

    @property
    def _effort(self) -> _Effort:
        return _EFFORTS[self.spec.effort]

    def _agreement(self, frame: ForceField, guess: FixedField) -> float:
        return agreement(frame, guess, self.lattice.unit_n, self.spec)

    def _best(self, frame: ForceField, candidates: Sequence[Chosen]) -> Chosen:
        """The smallest; where errors are free, after what they are worth in bytes."""
        if not self.rule.free or len(candidates) == 1:
            return min(candidates, key=lambda c: c.size)
        errors = [error_of(frame, c.decoded, self.lattice) for c in candidates]
        gains = [worth(c.size, errors[0], error) for c, error in zip(candidates, errors, strict=True)]
        return candidates[min(range(len(candidates)), key=lambda i: candidates[i].size - gains[i])]

    def _filtered(self, frame: ForceField, chosen: Chosen) -> Chosen:
        """With the post filter, where it pays."""
        if not self.rule.free or not self._effort.neighbours:
            return chosen
        found = fitted(frame, chosen.decoded, self.lattice, chosen.size, self._effort.neighbours)
        if found is None:
            return chosen
        return replace(chosen, record=replace(chosen.record, filter=write_terms(found[0])), decoded=found[1])

    # -- the ways to try ----------------------------------------------------------------------------------

    def _ways(self, frame: ForceField, alike: float) -> list[Way]:
        surface, sure = self._surface(frame, alike)
        motion = self._motion(frame, alike) if not sure else None
        inters = self._inters(alike)
        of_surface = [Way(self.spec.interframe == "on" and self.previous is not None, surface)] if surface else []
        if surface and (sure or self.spec.surface == "on"):
            return of_surface
        if motion:
            moved = [Way(True, motion)]
            plain = self.spec.motion != "on" and self.spec.effort == "max"
            return of_surface + moved + (self._plain(inters) if plain else [])
        return of_surface + self._plain(inters)

    @staticmethod
    def _plain(inters: Sequence[bool]) -> list[Way]:
        return [Way(inter) for inter in inters]

    def _inters(self, alike: float) -> list[bool]:
        """Whether the model is to know the previous frame: the ways to try."""
        if self.previous is None or self.spec.interframe == "off":
            return [False]
        if self.spec.interframe == "on" or alike >= self._effort.alike:
            return [True]
        return [False] if alike < self._effort.unlike else [False, True]

    def _surface(self, frame: ForceField, alike: float) -> tuple[Guess | None, bool]:
        """A surface, and whether nothing else need be tried."""
        asked = self.spec.surface
        if asked == "off" or (
            asked == "auto" and (alike >= self._effort.still or not may_be_solid(frame, self._effort.solid))
        ):
            return None, False
        guess = made(GuessKind.SURFACE, "fit", frame, self._known(), self.rule)
        if guess is None or asked == "on":
            return guess, False
        kept = self._agreement(frame, guess.field)
        return (guess, kept >= self._effort.trusted) if kept > alike else (None, False)

    def _motion(self, frame: ForceField, alike: float) -> Guess | None:
        asked, gain = self.spec.motion, self._effort.motion_gain
        if self.previous is None or self.spec.interframe == "off" or asked == "off":
            return None
        if asked == "auto" and (gain is None or not self._moves or alike > 1 - gain):
            return None
        guess = made(GuessKind.MOTION, "find", frame, self._known())
        if asked == "auto" and gain is not None:
            # a scene whose blocks stand still is not searched again
            self._moves = guess is not None and self._agreement(frame, guess.field) >= alike + gain
            return guess if self._moves else None
        return guess

    def _screened(self, ways: Sequence[Way], light: Sequence[Chosen]) -> list[Way]:
        """Those of the ways that are worth the heavy model: two at most, by what the light one needs for them.

        One of them has no guess, and knows the frame before where there is one: of that the heavy model makes more,
        with all that it has learnt. In mode "nmse" a guess that is off costs it more than the light one.
        """
        order = sorted(range(len(ways)), key=lambda i: light[i].size)
        near = [ways[i] for i in order if light[i].size <= _SECOND * light[order[0]].size][:2]
        # beside a surface the frame before is of use, too, and what was learnt from it
        known = self.previous is not None and self.spec.interframe != "off"
        near = [Way(known, way.guess) if way.guess is not None else way for way in near]
        plain, forced = Way(known), "on" in (self.spec.motion, self.spec.surface)
        return near if plain in near or forced or not (known or self.rule.free) else [near[0], plain]

    # -- coding -------------------------------------------------------------------------------------------

    def _memory(self, number: int) -> Any:
        """What the frame model has learnt in the last frame that it coded."""
        return self._memories.get(number)

    def _known(self) -> Known:
        return Known(self.grid, self.lattice, self.previous)

    def _coded(self, frame: ForceField, way: Way, number: int) -> Chosen:
        guess = way.guess
        known = Known(
            self.grid,
            self.lattice,
            self.previous if way.inter else None,
            None if guess is None else guess.field,
            self._memory(number) if way.inter else None,
        )
        coded = frame_model(number).encode(frame, known, self.rule)
        slots = np.asarray(coded.misses, np.int64)
        keys = brick_keys(self.grid, coded.decoded.bricks)
        exceptions = Exceptions.of(frame, keys[slots // 512], slots % 512)
        kind, data = (GuessKind.NONE, b"") if guess is None else (guess.kind, guess.data)
        shares = shares_of(coded.bits)
        record = FrameRecord(number, way.inter, kind, data, coded.payload, shares, exceptions.to_bytes())
        return Chosen(record, coded.decoded, exceptions, coded.memory)

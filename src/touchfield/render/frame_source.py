"""Frames of a medium or of a scene as they are written into the block, ahead of their time.

Fields that all frames share, those of rigid objects, are written once; a frame is the fields of its own and, behind
them, the table of where all of them lie.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Final

from touchfield.errors import TouchfieldError
from touchfield.medium import HapticScene
from touchfield.medium.cells import CellPool
from touchfield.render.block.frames import VIBRATION, FieldName, FrameParts, field_words, write_fields
from touchfield.render.segment_blend import with_blends
from touchfield.render.walls import Wall, stated_n_per_m, stiffest_n_per_m, wall_of

if TYPE_CHECKING:
    from collections.abc import Mapping

    from touchfield.medium import Grid, HapticMedium
    from touchfield.medium.deformation import Deformation
    from touchfield.render.block.memory import Memory

_WORDS_PER_BRICK: Final = 1200
"""More than a brick takes in the block: cells, what is held, and its share of the hash table."""
_WORDS_BESIDE: Final = 1024


class Prepared:
    """A frame that is decoded: how many words it takes, how stiff it is, and how it is written.

    `pools` are of its own fields; `shared` tells where the fields lie that all frames share; `stretch` is how many
    times stiffer a deformation makes them at most.
    """

    def __init__(
        self,
        parts: FrameParts,
        frame: int,
        pools: Mapping[FieldName, CellPool],
        shared: Mapping[FieldName, int],
        stretch: float = 1.0,
    ) -> None:
        self._parts, self._frame, self._pools, self._shared = parts, frame, pools, shared
        self.words = sum(map(field_words, pools.values())) + parts.words
        self.stiffest_n_per_m = stretch * stiffest_n_per_m(pools.values())

    def write(self, memory: Memory, at: int) -> int:
        """Write it at a word; the place of the frame, behind its own fields."""
        places = dict(self._shared)
        at = write_fields(memory, at, self._pools, places)
        self._parts.write(memory, at, self._frame, places)
        return at


class FrameSource:
    """Frames by their number; with `is_blended` one segment goes over into the next (`segment_blend`).

    Attributes
    ----------
    starts : tuple of int
        Frames that need no frame before them to be decoded, ascending from 0; those after need all from there on.
        Empty where every frame stands alone.
    shared_words : int
        What all frames share takes so many words.
    stiffest_n_per_m : float
        Of the fields that all frames share.
    most_words : int
        No frame takes more words than so many beside that.
    """

    def __init__(
        self, medium: HapticMedium | HapticScene, is_blended: bool = True, deformation: Deformation | None = None
    ) -> None:
        self.axes = medium.axes
        self.friction, self.damping_n_s_per_m = medium.friction, medium.damping_n_s_per_m
        self.starts = _starts(medium)
        self._is_there = getattr(getattr(medium, "make_frame", None), "is_there", None)
        medium, self._blends = with_blends(medium) if is_blended else (medium, ())
        self._parts = FrameParts(medium, deformation)
        self.frame_count, self.rate_hz = self._parts.frame_count, self._parts.rate_hz
        self._stretch = 1.0 if deformation is None else deformation.most_stretch**2
        names = self._parts.names(0)
        self._rigid = {name: self._parts.cells(name) for name in names if self._parts.is_shared(name)}
        self._places: dict[FieldName, int] = {}
        self.shared_words = sum(map(field_words, self._rigid.values()))
        self.stiffest_n_per_m = self._stretch * stiffest_n_per_m(self._rigid.values())
        if isinstance(medium, HapticScene):
            own = [one.medium.grid for one in medium.objects if not one.is_rigid]
        else:
            own = [medium.grid] * len(names)
        self.most_words = sum(map(_most_words, own)) + self._parts.words

    def wall(self) -> Wall | None:
        """The wall that the first frame tells of, or else the middle one; of bodies the stiffest.

        None where they cannot be decoded: who plays them is told.
        """
        for frame in (0, self.frame_count // 2):
            names = [name for name in self._parts.names(frame) if name[0] != VIBRATION]
            try:
                walls = [wall for name in names if (wall := wall_of(self._parts.field(name))) is not None]
            except TouchfieldError:
                return None
            if walls:
                stated = stated_n_per_m(self._parts.medium.provenance)
                stiffness = stated or max(wall.stiffness_n_per_m for wall in walls)
                level = min(wall.level_n for wall in walls)
                if len(names) == 1:
                    return Wall(stiffness, level, walls[0].spacing_m)
                finest = min(min(wall.spacing_m) for wall in walls)  # bodies turn
                return Wall(stiffness, level, (finest, finest, finest))
        return None

    def yield_at(self, word: int) -> None:
        """Tell where in the block the displacements lie by which a deformation yields."""
        self._parts.yield_at = word

    def write_shared(self, memory: Memory, at: int) -> None:
        """Write what all frames share."""
        write_fields(memory, at, self._rigid, self._places)

    def is_there(self, frame: int) -> bool:
        """True where a frame can be prepared at once; of a live stream it may not have come yet."""
        return self._is_there is None or bool(self._is_there(frame))

    def forget(self) -> None:
        """Blend nothing into the frame that is prepared next: play goes on elsewhere."""
        for blend in self._blends:
            blend.forget()

    def prepare(self, frame: int) -> Prepared:
        """Decode a frame."""
        names = [name for name in self._parts.names(frame) if not self._parts.is_shared(name)]
        pools = {name: self._parts.cells(name) for name in names}
        return Prepared(self._parts, frame, pools, self._places, self._stretch)


def _starts(medium: HapticMedium | HapticScene) -> tuple[int, ...]:
    """Where segments begin; of a scene, those of the first object that changes: all are cut at the same frames."""
    if isinstance(medium, HapticScene):
        return next((_starts(one.medium) for one in medium.objects if not one.is_rigid), ())
    if medium.segments is not None:
        return medium.segments.starts
    return getattr(medium.make_frame, "starts", ())


def _most_words(grid: Grid) -> int:
    """Of a field on this lattice: its cells reach a brick before its first."""
    return _WORDS_BESIDE + _WORDS_PER_BRICK * math.prod(n + 1 for n in grid.brick_shape)

"""The feeder: frames are decoded ahead of the servo and written into the block, in order, as long as there is
room.

Frames are counted on where a medium is looped (*unrolled*), and begin anew with each seek (*generation*).
Nothing is written over that the servo has not given up, and nothing of a new generation before the servo has
taken it up.

Where frames take longer to be decoded than they last, those that could not be there in time are left out
(`Pace`): the frame before is held in their place, and the next one comes at its own time.
"""

from __future__ import annotations

import math
import threading
import time
from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from touchfield.errors import TouchfieldError
from touchfield.medium import HapticScene
from touchfield.render.block import Layout, Memory, Ring, check_fits, too_little
from touchfield.render.block import words as W
from touchfield.render.block.frames import (
    VIBRATION,
    FieldName,
    FrameParts,
    field_words,
    require_medium,
    write_fields,
)
from touchfield.render.segment_blend import with_blends
from touchfield.render.spec import Wall, stated_n_per_m, stiffest_n_per_m, wall_of

if TYPE_CHECKING:
    from touchfield.medium import Grid, HapticMedium
    from touchfield.medium.deformation import Deformation


FIRST_GENERATION: Final = 1  # of the frames before any seek
_FRAME: Final = (1 << W.FRAME_BITS) - 1
_SPARE: Final = 1.5  # A frame is begun where so many times what it should take is left
_LATEST: Final = 16
_MOST_TRIED: Final = 4096

_LONGEST_PAUSE_S: Final = 0.01
_SHORTEST_PAUSE_S: Final = 0.001


class Pace:
    """Cost of decoding on this machine, and the next frame that can be there in time.

    A frame in the middle of a segment costs every frame from the one decoded last, or from the segment's
    start (`starts`, as of `FrameSource`): where a frame takes longer than it lasts, the start of a segment to
    come can still be reached. `frame_s` is what a frame takes; 0 before the second, as the first one also
    loads or compiles code.
    """

    def __init__(self, starts: Sequence[int], frame_count: int, rate_hz: float) -> None:
        self._starts, self._count, self._rate_hz = starts, frame_count, rate_hz
        self._latest: int | None = None
        self._taken: deque[tuple[float, int]] = deque(maxlen=_LATEST)
        self.frame_s = 0.0

    def note(self, frame: int, seconds: float) -> None:
        """Take note of a frame that was decoded in so many seconds."""
        if self._latest is not None:
            self._taken.append((seconds, self._needed(frame)))
            self.frame_s = sum(s for s, _ in self._taken) / sum(n for _, n in self._taken)
        self._latest = frame

    def in_time(self, frame: int, stop: int, media_s: float, speed: float) -> int:
        """The first frame from `frame` on that can be ready at its time; else `stop`, or `frame` where it
        goes on.
        """
        for at in range(frame, min(stop, frame + _MOST_TRIED)):
            left_s = (at / self._rate_hz - media_s) / speed
            if _SPARE * self.frame_s * self._needed(at) <= left_s or not self.frame_s:
                return at
        return stop if stop == self._count else frame

    def _needed(self, frame: int) -> int:
        """Number of frames that must be decoded for one."""
        if not self._starts:
            return 1
        own = frame % self._count
        start = frame - own + self._starts[bisect_right(self._starts, own) - 1]
        latest = -1 if self._latest is None else self._latest
        return frame - (latest if start <= latest < frame else start - 1)


def arena_words(source: FrameSource, memory_bytes: int) -> int:
    """Words that the arena takes: what the bound allows, and not more than all frames need; an error if too
    few.
    """
    allowed = memory_bytes // W.WORD
    check_fits(source.shared_words, allowed, "the fields of the rigid objects")
    return min(allowed, source.shared_words + (source.frame_count + 2) * source.most_words)


class Feeder:
    """Writes frames ahead of the servo; by `step` in the caller's thread, or in a thread of its own after
    `start`.

    ``reserve(words)`` sees to it that so many words of the block can be written. With `is_timed` frames
    that come too late are left out. ``tell_stiffness(k)`` is told the stiffest slope
    of each frame, N/m. `error` is what ended the feed, `decode_s` what the latest frames took, `left_out` how
    many would have come too late.
    """

    def __init__(
        self,
        source: FrameSource,
        memory: Memory,
        layout: Layout,
        first_frame: int = 0,
        is_loop: bool = False,
        reserve: Callable[[int], None] | None = None,
        is_timed: bool = True,
        clock_s: Callable[[], float] = time.perf_counter,
        tell_stiffness: Callable[[float], None] | None = None,
    ) -> None:
        self._clock_s, self._pace = clock_s, Pace(source.starts, source.frame_count, source.rate_hz)
        self._tell_stiffness = tell_stiffness
        self.left_out = 0
        self._source, self._memory = source, memory
        self._is_loop = is_loop and source.frame_count > 1  # one that stays needs its frame once
        self._slots, self._reserve, self._is_timed = layout.slots, reserve, is_timed
        begin = layout.arena + source.shared_words
        if reserve is not None:
            reserve(begin)
        source.write_shared(memory, layout.arena)
        self._ring = Ring(begin, layout.words - begin)
        self._target = (FIRST_GENERATION, first_frame)
        self._generation, self._next = self._target
        memory.i8[W.NEEDS] = (FIRST_GENERATION << W.FRAME_BITS) | first_frame
        self._ready: Prepared | None = None
        self._is_published, self._place = False, 0
        self._wake, self._is_closing = threading.Event(), False
        self._thread: threading.Thread | None = None
        self.error: Exception | None = None
        self.decode_s: list[float] = []

    def seek(self, generation: int, frame: int) -> None:
        """Go on with an unrolled frame, as a generation of its own; returns at once."""
        self._target = generation, frame
        self._wake.set()

    def step(self) -> bool:
        """Decode and write one frame; False where there is nothing to be done now, or the feed has failed."""
        if self.error is not None:
            return False
        try:
            return self._step()
        except Exception as error:  # whatever it is: the servo goes to zero, and the player tells it
            self.error = error
            self._memory.i8[W.FEED_FAILED] = 1
            return False

    def _step(self) -> bool:
        generation, frame = self._target
        if generation != self._generation:
            self._generation, self._next, self._ready = generation, frame, None
            self._ring.clear()
            self._source.forget()
            self._is_published, self._place = False, 0
        source, count = self._source, self._source.frame_count
        needs = int(self._memory.i8[W.NEEDS])
        seen, needed = needs >> W.FRAME_BITS, needs & _FRAME
        is_taken_up = seen == generation
        if is_taken_up and needed > self._next:  # the servo is beyond it: what is past is not decoded
            self.left_out += needed - self._next if self._is_published else 0
            self._next, self._ready = needed, None
        is_over = not self._is_loop and self._next >= count
        if is_over or (is_taken_up and self._next >= needed + self._slots - 1):
            return False
        if self._ready is None:
            if not source.is_there(self._next % count):
                return False
            if is_taken_up and not self._leave_out(needed):
                return True
            began = self._clock_s()
            self._ready = source.prepare(self._next % count)
            self.decode_s = [*self.decode_s[-255:], self._clock_s() - began]
            self._pace.note(self._next, self.decode_s[-1])
        if not is_taken_up:
            return False
        return self._write(self._ready, needed)

    def _leave_out(self, needed: int) -> bool:
        """Hold the frame before in place of those that cannot be there in time; False where none is left."""
        from touchfield.render.kernels.tick import publish

        i8, f8 = self._memory.i8, self._memory.f8
        is_running = i8[W.FEED] in (W.RUNNING, W.STALLED) and i8[W.MODE_NOW] == W.PLAYING
        if not (self._is_timed and is_running):
            return True
        last = needed + self._slots - 1
        if not self._is_loop:
            last = min(last, self._source.frame_count)
        media_s, speed = float(f8[W.MEDIA_S]), float(f8[W.SPEED_NOW])
        frame = self._pace.in_time(self._next, last, media_s, speed)
        if frame > self._next:
            if self._place and self._ring.hold(frame - 1):
                for late in range(self._next, frame):
                    publish(i8, self._generation, late, self._place)
            self.left_out += frame - self._next
            self._next = frame
        return self._is_loop or frame < self._source.frame_count

    def _write(self, ready: Prepared, needed: int) -> bool:
        from touchfield.render.kernels.tick import publish

        check_fits(ready.words, self._ring.words, f"frame {self._next % self._source.frame_count}")
        self._ring.free_before(needed)
        at = self._ring.take(self._next, ready.words)
        if at is None:
            if self._next <= needed + 1:  # the servo cannot go on without it, and so gives nothing up
                size = f"{W.WORD * ready.words / 2**20:.2f} MiB"
                raise too_little(self._ring.words, f"room for two frames, of which one takes {size}")
            return False
        if self._reserve is not None:
            self._reserve(at + ready.words)
        self._place = place = ready.write(self._memory, at)
        if self._tell_stiffness is not None:
            self._tell_stiffness(ready.stiffest_n_per_m)
        publish(self._memory.i8, self._generation, self._next, place)
        self._next, self._ready, self._is_published = self._next + 1, None, True
        return True

    @property
    def note(self) -> str:
        """Note for the user where frames are left out."""
        wanted, most = self._source.rate_hz, 1 / max(self._pace.frame_s, 1e-6)
        why = (
            f"This machine decodes {most:.3g} frames a second at present, and {wanted:g} are needed at speed "
            "1"
        )
        if most >= wanted * float(self._memory.f8[W.SPEED_NOW]):
            why = (
                "Frames were not there in time, as they had to be fetched, or other work held up their "
                "decoding"
            )
        return f"{why}: frames that would come too late are left out, so that time is kept"

    @property
    def is_ahead(self) -> bool:
        """True if the first two frames are there, or all that there are."""
        wanted = (int(self._memory.i8[W.NEEDS]) & _FRAME) + 2
        return self._next >= (wanted if self._is_loop else min(wanted, self._source.frame_count))

    def keep_ahead(self, frames: int) -> None:
        """Step until so many frames are there from the first that the servo needs, or no more can be had now."""
        while self._next < (int(self._memory.i8[W.NEEDS]) & _FRAME) + frames and self.step():
            pass

    def start(self) -> None:
        """Feed from a thread until `close`."""
        self._thread = threading.Thread(target=self._run, name="touchfield-feeder", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        pause = _SHORTEST_PAUSE_S
        while not self._is_closing:
            self._wake.clear()  # before the step: what is told meanwhile is seen by the next one
            if self.step() or self._wake.wait(pause):
                pause = _SHORTEST_PAUSE_S
            else:
                pause = min(2 * pause, _LONGEST_PAUSE_S)

    def close(self, timeout_s: float = 10.0) -> None:
        """End the thread; what is being decoded is finished. May be called twice."""
        self._is_closing = True
        self._wake.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)


_WORDS_PER_BRICK: Final = 1200
"""More than a brick takes in the block: cells, what is held, and its share of the hash table."""
_WORDS_BESIDE: Final = 1024


@dataclass(frozen=True)
class Prepared:
    """A frame that is decoded: how many words it takes, how stiff it is, and how it is written at a word."""

    words: int
    stiffest_n_per_m: float
    write: Callable[[Memory, int], int]  # the place of the frame, behind its own fields


class FrameSource(FrameParts):
    """Frames by their number; with `is_blended` one segment goes over into the next (`segment_blend`).

    `starts` are frames that need no frame before them to be decoded, ascending from 0, those after need all
    from there on; empty where every frame stands alone. `shared_words` is what all frames share,
    `stiffest_n_per_m` of those fields, and beside that no frame takes more than `most_words`.
    """

    def __init__(
        self,
        medium: HapticMedium | HapticScene,
        is_blended: bool = True,
        deformation: Deformation | None = None,
    ) -> None:
        require_medium(medium)
        self.axes = medium.axes
        self.friction, self.damping_n_s_per_m = medium.friction, medium.damping_n_s_per_m
        self.starts = _starts(medium)
        self._is_there = getattr(getattr(medium, "make_frame", None), "is_there", None)
        medium, self._blends = with_blends(medium) if is_blended else (medium, ())
        super().__init__(medium, deformation)
        self._stretch = 1.0 if deformation is None else deformation.most_stretch**2
        names = self.names(0)
        self._rigid = {name: self.cells(name) for name in names if self.is_shared(name)}
        self._places: dict[FieldName, int] = {}
        self.shared_words = sum(map(field_words, self._rigid.values()))
        self.stiffest_n_per_m = self._stretch * stiffest_n_per_m(self._rigid.values())
        if isinstance(medium, HapticScene):
            own = [one.medium.grid for one in medium.objects if not one.is_rigid]
        else:
            own = [medium.grid] * len(names)
        self.most_words = sum(map(_most_words, own)) + self.words

    def wall(self) -> Wall | None:
        """The wall that the first frame tells of, or else the middle one; of bodies the stiffest.

        None where they cannot be decoded: who plays them is told.
        """
        for frame in (0, self.frame_count // 2):
            names = [name for name in self.names(frame) if name[0] != VIBRATION]
            try:
                walls = [wall for name in names if (wall := wall_of(self.field(name))) is not None]
            except TouchfieldError:
                return None
            if walls:
                stated = stated_n_per_m(self.medium.provenance)
                stiffness = stated or max(wall.stiffness_n_per_m for wall in walls)
                level = min(wall.level_n for wall in walls)
                if len(names) == 1:
                    return Wall(stiffness, level, walls[0].spacing_m)
                finest = min(min(wall.spacing_m) for wall in walls)  # bodies turn
                return Wall(stiffness, level, (finest, finest, finest))
        return None

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
        names = [name for name in self.names(frame) if not self.is_shared(name)]
        pools = {name: self.cells(name) for name in names}

        def write(memory: Memory, at: int) -> int:
            places = dict(self._places)
            at = write_fields(memory, at, pools, places)
            self.write(memory, at, frame, places)
            return at

        words = sum(map(field_words, pools.values())) + self.words
        return Prepared(words, self._stretch * stiffest_n_per_m(pools.values()), write)


def _starts(medium: HapticMedium | HapticScene) -> tuple[int, ...]:
    """Where segments begin; of a scene, those of the first object that changes: all are cut at the same
    frames.
    """
    if isinstance(medium, HapticScene):
        return next((_starts(one.medium) for one in medium.objects if not one.is_rigid), ())
    if medium.segments is not None:
        return medium.segments.starts
    return getattr(medium.make_frame, "starts", ())


def _most_words(grid: Grid) -> int:
    """Of a field on this lattice: its cells reach a brick before its first."""
    return _WORDS_BESIDE + _WORDS_PER_BRICK * math.prod(n + 1 for n in grid.brick_shape)

"""Decodes the frames of a medium shortly before the servo needs them, and writes them into the memory that
player and servo share.

In a loop, frame numbers continue through the repeats (*unrolled* frames). Each seek starts a new *generation*
of frames. A frame is overwritten only after the servo has released it, and the frames of a new generation are
written only after the servo has accepted that generation.

If decoding a frame takes longer than the frame lasts, frames that cannot be ready in time are dropped
(`Pace`): the previous frame is repeated instead, and the next one is shown at its own time.
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

from touchfield.compute.native import native
from touchfield.errors import TouchfieldError
from touchfield.medium import HapticScene
from touchfield.render.block import Layout, Memory, Ring, aligned, check_fits, layout, too_little
from touchfield.render.block.frames import (
    VIBRATION,
    FieldName,
    FrameParts,
    field_bytes,
    require_medium,
    write_fields,
)
from touchfield.render.segment_blend import with_blends
from touchfield.render.spec import Wall, stated_n_per_m, stiffest_n_per_m, wall_of

if TYPE_CHECKING:
    from touchfield.medium import Grid, HapticMedium
    from touchfield.medium.deformation import Deformation


FIRST_GENERATION: Final = 1  # of the frames before any seek
_FRAME: Final = (1 << layout.FRAME_BITS) - 1
_TIME_MARGIN: Final = 1.5  # time that must be left to start a frame, over its expected time
_DURATIONS: Final = 16  # latest frames in the mean decoding time
_MAX_SEARCH: Final = 4096

_LONGEST_PAUSE_S: Final = 0.01
_SHORTEST_PAUSE_S: Final = 0.001


class Pace:
    """Measures the cost of decoding, and finds the next frame that can be ready in time.

    To decode a frame in the middle of a segment, all frames from the latest one, or from the segment's start
    (`starts`, as in `FrameSource`), must be decoded. If decoding a frame takes longer than the frame lasts,
    the start of a later segment may therefore still be reached in time. `frame_s` is the mean time of a
    frame. It is 0 before the second frame, because the first one also loads or compiles code.
    """

    def __init__(self, starts: Sequence[int], frame_count: int, rate_hz: float) -> None:
        self._starts, self._count, self._rate_hz = starts, frame_count, rate_hz
        self._latest: int | None = None
        self._durations: deque[tuple[float, int]] = deque(maxlen=_DURATIONS)
        self.frame_s = 0.0

    def note(self, frame: int, seconds: float) -> None:
        """Record that a frame was decoded in so many seconds."""
        if self._latest is not None:
            self._durations.append((seconds, self._decode_count(frame)))
            self.frame_s = sum(s for s, _ in self._durations) / sum(n for _, n in self._durations)
        self._latest = frame

    def first_reachable(self, frame: int, stop: int, media_s: float, speed: float) -> int:
        """Return the first frame, from `frame` on, that can be ready at its time.

        If there is none before `stop`, returns `stop` if the medium ends there, else `frame`.
        """
        for candidate in range(frame, min(stop, frame + _MAX_SEARCH)):
            margin_s = (candidate / self._rate_hz - media_s) / speed
            is_in_time = _TIME_MARGIN * self.frame_s * self._decode_count(candidate) <= margin_s
            if is_in_time or not self.frame_s:
                return candidate
        return stop if stop == self._count else frame

    def _decode_count(self, frame: int) -> int:
        """Return the number of frames that must be decoded for a frame."""
        if not self._starts:
            return 1
        index = frame % self._count
        start = frame - index + self._starts[bisect_right(self._starts, index) - 1]
        latest = -1 if self._latest is None else self._latest
        return frame - (latest if start <= latest < frame else start - 1)


def arena_bytes(source: FrameSource, memory_bytes: int) -> int:
    """Return the size of the arena, bytes.

    It is what the bound allows, and at most what all frames need.

    Raises an error if the bound is too small for the shared fields.
    """
    check_fits(source.shared_bytes, memory_bytes, "the fields of the rigid objects")
    return min(memory_bytes, source.shared_bytes + (source.frame_count + 2) * aligned(source.max_bytes))


class Feeder:
    """Writes frames ahead of the servo.

    It works by calls of `step` in the caller's thread, or in its own thread after `start`.
    ``reserve(size_bytes)`` makes that many bytes of the block writable. With `is_timed`, frames that come too
    late are dropped.
    ``on_stiffness(k)`` is called with the largest slope of each frame, N/m. `error` is the error that ended
    the feed, `decode_s` holds the decoding times of the latest frames, and `dropped_frames` the number of
    frames that came too late.
    """

    def __init__(
        self,
        source: FrameSource,
        memory: Memory,
        block_layout: Layout,
        first_frame: int = 0,
        is_loop: bool = False,
        reserve: Callable[[int], None] | None = None,
        is_timed: bool = True,
        clock_s: Callable[[], float] = time.perf_counter,
        on_stiffness: Callable[[float], None] | None = None,
    ) -> None:
        self._clock_s, self._pace = clock_s, Pace(source.starts, source.frame_count, source.rate_hz)
        self._on_stiffness = on_stiffness
        self.dropped_frames = 0
        self._source, self._memory = source, memory
        self._is_loop = is_loop and source.frame_count > 1  # a single frame is written once
        self._slots, self._reserve, self._is_timed = block_layout.slots, reserve, is_timed
        ring_start = block_layout.arena + source.shared_bytes
        if reserve is not None:
            reserve(ring_start)
        source.write_shared(memory, block_layout.arena)
        self._ring = Ring(ring_start, block_layout.size_bytes - ring_start)
        self._target = (FIRST_GENERATION, first_frame)
        self._generation, self._next = self._target
        memory.receiver["clock"]["needs"] = (FIRST_GENERATION << layout.FRAME_BITS) | first_frame
        self._ready: PreparedFrame | None = None
        self._is_published, self._offset = False, 0
        self._wake, self._is_closing = threading.Event(), False
        self._thread: threading.Thread | None = None
        self.error: Exception | None = None
        self.decode_s: list[float] = []

    def seek(self, generation: int, frame: int) -> None:
        """Continue at an unrolled frame, as a new generation; returns at once."""
        self._target = generation, frame
        self._wake.set()

    def step(self) -> bool:
        """Decode and write one frame.

        Returns False if there is nothing to do now, or the feed has failed.
        """
        if self.error is not None:
            return False
        try:
            return self._step()
        except Exception as error:  # any error: the servo releases the force, the player reports it
            self.error = error
            self._memory.receiver["orders"]["has_feed_failed"] = 1
            return False

    def _step(self) -> bool:
        generation, frame = self._target
        if generation != self._generation:
            self._generation, self._next, self._ready = generation, frame, None
            self._ring.clear()
            self._source.forget()
            self._is_published, self._offset = False, 0
        source, count = self._source, self._source.frame_count
        needs = int(self._memory.receiver["clock"]["needs"])
        servo_generation, needed = needs >> layout.FRAME_BITS, needs & _FRAME
        is_accepted = servo_generation == generation
        if is_accepted and needed > self._next:  # the servo has passed these frames: do not decode them
            self.dropped_frames += needed - self._next if self._is_published else 0
            self._next, self._ready = needed, None
        is_over = not self._is_loop and self._next >= count
        if is_over or (is_accepted and self._next >= needed + self._slots - 1):
            return False
        if self._ready is None:
            if not source.is_there(self._next % count):
                return False
            if is_accepted and not self._drop_late_frames(needed):
                return True
            began = self._clock_s()
            self._ready = source.prepare(self._next % count)
            self.decode_s = [*self.decode_s[-255:], self._clock_s() - began]
            self._pace.note(self._next, self.decode_s[-1])
        if not is_accepted:
            return False
        return self._write(self._ready, needed)

    def _drop_late_frames(self, needed: int) -> bool:
        """Repeat the previous frame in place of those that cannot be ready in time.

        Returns False if no frame is left.
        """
        clock = self._memory.receiver["clock"]
        is_running = clock["feed"] in (layout.RUNNING, layout.STALLED) and clock["mode"] == layout.PLAYING
        if not (self._is_timed and is_running):
            return True
        limit = needed + self._slots - 1
        if not self._is_loop:
            limit = min(limit, self._source.frame_count)
        media_s, speed = float(clock["media_s"]), float(clock["speed"])
        frame = self._pace.first_reachable(self._next, limit, media_s, speed)
        if frame > self._next:
            if self._offset and self._ring.hold(frame - 1):
                for dropped in range(self._next, frame):
                    native.publish(self._memory.bytes, self._generation, dropped, self._offset)
            self.dropped_frames += frame - self._next
            self._next = frame
        return self._is_loop or frame < self._source.frame_count

    def _write(self, ready: PreparedFrame, needed: int) -> bool:
        check_fits(ready.size_bytes, self._ring.size_bytes, f"frame {self._next % self._source.frame_count}")
        self._ring.free_before(needed)
        start = self._ring.take(self._next, ready.size_bytes)
        if start is None:
            if self._next <= needed + 1:  # the servo waits for this frame and therefore releases none
                size = f"{ready.size_bytes / 2**20:.2f} MiB"
                raise too_little(self._ring.size_bytes, f"room for two frames, of which one takes {size}")
            return False
        if self._reserve is not None:
            self._reserve(start + ready.size_bytes)
        self._offset = offset = ready.write(self._memory, start)
        if self._on_stiffness is not None:
            self._on_stiffness(ready.stiffest_n_per_m)
        native.publish(self._memory.bytes, self._generation, self._next, offset)
        self._next, self._ready, self._is_published = self._next + 1, None, True
        return True

    @property
    def note(self) -> str:
        """Note for the user if frames were dropped."""
        speed, decode_hz = float(self._memory.receiver["clock"]["speed"]), 1 / max(self._pace.frame_s, 1e-6)
        needed_hz = self._source.rate_hz * speed
        if decode_hz >= needed_hz:
            reason = "Frames were late, because they had to be fetched or other work delayed their decoding"
        else:
            needed = f"speed {speed:g} needs {needed_hz:g}"
            reason = f"This machine decodes {decode_hz:.3g} frames a second, and {needed}"
        return f"{reason}: frames that would come too late are left out, to keep the timing"

    @property
    def is_preloaded(self) -> bool:
        """True if the first two frames are written, or all frames if there are fewer."""
        target = (int(self._memory.receiver["clock"]["needs"]) & _FRAME) + 2
        return self._next >= (target if self._is_loop else min(target, self._source.frame_count))

    def fill_lookahead(self, frames: int) -> None:
        """Step until `frames` frames, from the servo's current one on, are written.

        Stops earlier if no more can be written now.
        """
        while self._lacks(frames) and self.step():
            pass

    def _lacks(self, frames: int) -> bool:
        """Return whether fewer frames are written; none is of a seek that has just been ordered."""
        generation, frame = self._target
        following = self._next if generation == self._generation else frame
        return following < (int(self._memory.receiver["clock"]["needs"]) & _FRAME) + frames

    def start(self) -> None:
        """Feed from a thread until `close`."""
        self._thread = threading.Thread(target=self._run, name="touchfield-feeder", daemon=True)
        self._thread.start()

    def _run(self) -> None:
        pause = _SHORTEST_PAUSE_S
        while not self._is_closing:
            self._wake.clear()  # before the step, so that the next step sees a seek made during this one
            if self.step() or self._wake.wait(pause):
                pause = _SHORTEST_PAUSE_S
            else:
                pause = min(2 * pause, _LONGEST_PAUSE_S)

    def close(self, timeout_s: float = 10.0) -> None:
        """End the thread after the frame in progress. May be called twice."""
        self._is_closing = True
        self._wake.set()
        if self._thread is not None and self._thread is not threading.current_thread():
            self._thread.join(timeout_s)


_BYTES_PER_BRICK: Final = 9600
"""Upper limit of the bytes of a brick in the block: cells, support, part of the hash table."""
_BYTES_PER_FIELD: Final = 8192


@dataclass(frozen=True)
class PreparedFrame:
    """A decoded frame: its size, its largest slope, and a function that writes it."""

    size_bytes: int
    stiffest_n_per_m: float
    write: Callable[[Memory, int], int]  # returns the offset of the frame, which follows its own fields


class FrameSource(FrameParts):
    """Frames by number; with `is_blended`, segments blend into each other.

    The blend is that of `segment_blend`. `starts` are the frames that can be decoded without an earlier one,
    ascending from 0; a frame in between needs all frames from the start before it. It is empty if every frame
    stands alone. `shared_bytes` is the size of what all frames share, `stiffest_n_per_m` the largest
    slope of those fields, and `max_bytes` the limit for the rest of a frame.
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
        self.starts = _segment_starts(medium)
        frames = medium if isinstance(medium, HapticScene) else medium.make_frame
        self._is_there = getattr(frames, "is_there", None)
        self._is_seam = getattr(frames, "is_seam", None)
        medium, self._blends = with_blends(medium) if is_blended else (medium, ())
        super().__init__(medium, deformation)
        self._stretch = 1.0 if deformation is None else deformation.max_stretch**2
        names = self.names(0)
        self._rigid = {name: self.cells(name) for name in names if self.is_shared(name)}
        self._offsets: dict[FieldName, int] = {}
        self.shared_bytes = sum(map(field_bytes, self._rigid.values()))
        self.stiffest_n_per_m = self._stretch * stiffest_n_per_m(self._rigid.values())
        if isinstance(medium, HapticScene):
            changing = [body.medium.grid for body in medium.objects if not body.is_rigid]
        else:
            changing = [medium.grid] * len(names)
        self.max_bytes = sum(map(_max_field_bytes, changing)) + self.size_bytes

    def wall(self) -> Wall | None:
        """Return the wall of the first frame, else of the middle one; for bodies, the stiffest.

        Returns None if these frames have no wall or cannot be decoded; playback reports the error.
        """
        for frame in (0, self.frame_count // 2):
            names = [name for name in self.names(frame) if name[0] >= 0]
            try:
                found = [wall_of(self.field(name)) for name in names]
            except TouchfieldError:
                return None
            walls = [wall for wall in found if wall is not None]
            if walls:
                stated = stated_n_per_m(self.medium.provenance)
                stiffness = stated or max(wall.stiffness_n_per_m for wall in walls)
                forces = min(wall.level_n for wall in walls), max(wall.large_n for wall in walls)
                if len(names) == 1:
                    return Wall(stiffness, *forces, walls[0].spacing_m)
                finest = min(min(wall.spacing_m) for wall in walls)  # the finest axis, since bodies rotate
                return Wall(stiffness, *forces, (finest, finest, finest))
        return None

    def write_shared(self, memory: Memory, at: int) -> None:
        """Write the fields that all frames share."""
        write_fields(memory, at, self._rigid, self._offsets)

    def is_there(self, frame: int) -> bool:
        """Return True if a frame can be prepared now; a frame of a live stream may be missing."""
        return self._is_there is None or bool(self._is_there(frame))

    def forget(self) -> None:
        """Do not blend into the frame that is prepared next: playback jumps."""
        for blend in self._blends:
            blend.forget()

    def prepare(self, frame: int) -> PreparedFrame:
        """Decode a frame."""
        names = [name for name in self.names(frame) if not self.is_shared(name)]
        pools, poses = {name: self.cells(name) for name in names}, self.poses(frame)
        is_seam = self._is_seam is not None and bool(self._is_seam(frame))

        def write(memory: Memory, at: int) -> int:
            offsets = dict(self._offsets)
            at = write_fields(memory, at, pools, offsets)
            self.write(memory, at, frame, offsets, poses)
            memory.view(layout.FRAME_HEADER, at)["is_seam"] = is_seam
            return at

        size_bytes = sum(map(field_bytes, pools.values())) + self.size_bytes
        fields = [pool for name, pool in pools.items() if name[0] != VIBRATION]  # that one is no force
        return PreparedFrame(size_bytes, self._stretch * stiffest_n_per_m(fields), write)


def _segment_starts(medium: HapticMedium | HapticScene) -> tuple[int, ...]:
    """Return the first frames of the segments.

    For a scene, those of the first object that changes: all objects are segmented at the same frames.
    """
    if isinstance(medium, HapticScene):
        return next((_segment_starts(body.medium) for body in medium.objects if not body.is_rigid), ())
    if medium.segments is not None:
        return medium.segments.starts
    return getattr(medium.make_frame, "starts", ())


def _max_field_bytes(grid: Grid) -> int:
    """Return the upper limit of a field's size in bytes; its cells start one brick before its first."""
    return _BYTES_PER_FIELD + _BYTES_PER_BRICK * math.prod(n + 1 for n in grid.brick_shape)

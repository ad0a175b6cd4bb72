"""Gives programs a live stream as a medium. Access to a frame waits until it has arrived.

Frame 0 is the first frame of the segment with which the receiver joined. If playback falls behind the
segments that are kept, it continues with the newest segment. A lost frame has no force; the renderer's slew
limit makes the force fade out and in again. If a coarse layer is received as well, its frames replace frames
that are lost or late. Where a segment or another layer starts, or after a loss, the frames need not continue
(`LiveFrames.is_seam`), and the servo fades the force where they do not (``c/touch_seam.h``).
"""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Iterator
from threading import Condition
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any, Final, NamedTuple

from touchfield.codec.registry import coder
from touchfield.codec.segment import BitAccount
from touchfield.codec.vibration import decode_vibration
from touchfield.errors import FormatError, SourceError, TouchfieldError, UnsupportedVersion
from touchfield.filters.resample import half_grid, rebuild_level
from touchfield.medium import ForceField, Grid, HapticMedium, HapticScene
from touchfield.medium.medium import VibrationFrame
from touchfield.network.live import ENDLESS, Ended, Event, LiveSegment, Lost, Opened, Refused
from touchfield.pipeline.stream import OpenStream

if TYPE_CHECKING:
    from touchfield.codec.registry import FieldDecoder
    from touchfield.render.player import Player


MAX_SEGMENTS: Final = 4
"""Maximum number of decoded segments that are kept."""

MAX_BYTES: Final = 1 << 30
"""Maximum size of the fields that are kept; fewer segments are kept if they are larger."""

PATIENCE_S: Final = 60.0
"""Maximum wait for a segment: its sender may be starting or restarting."""

REPORT_AFTER_S: Final = 3.0
"""A wait longer than this, beyond the length of a segment, is reported."""

FORGETTING: Final = 0.2
"""Fraction of a delay that is forgotten with each earlier segment: a single late one has no lasting effect,
repeated delays do."""

RESET_BEYOND_S: Final = 1.0
"""The estimate is reset if a segment is this much earlier, after a jump of a clock or a stall."""

MARGIN_S: Final = 0.03
"""Jitter margin: how much later the next segment may come and still be in time."""

SEEK_BEYOND_S: Final = 0.25
"""Playback seeks if it lags by more; otherwise its speed is adjusted."""

SETTLING_S: Final = 0.8
"""Time from the start of playback in which the delay settles: delays are forgotten at once, since the first
segment was stored before it was sent, and opening a device slows its machine down."""

SEEK_WHILE_SETTLING_S: Final = 0.05
"""Playback seeks if it lags by more while the delay settles: at a tenth of speed, 0.25 s would take 2.5 s."""

MAX_SPEED_CHANGE: Final = 0.1

MAX_LAYER_LAG_S: Final = 0.25
"""Maximum lag of one layer behind the other for which playback waits."""

LAYER_LOST_S: Final = 1.0
"""A layer this far behind the other is ignored in the timing of playback."""

_MAX_LOOKAHEAD: Final = 1 << 12
"""Access to a frame this far after the newest raises an error."""


class LiveEnd(SourceError):
    """The sender has ended the stream."""


class _Decoded(NamedTuple):
    """A segment, possibly partly decoded; its frames are fields, or poses (`LivePoses`)."""

    first: int
    fields: list[Any]
    band: list[VibrationFrame]

    @property
    def size(self) -> int:
        """Size of its fields in bytes; that of poses is limited by the segment."""
        fields = {id(field): field for field in self.fields if isinstance(field, ForceField)}
        return sum(field.forces_n.nbytes for field in fields.values())


class _Part(NamedTuple):
    """Frames of a stream that continue each other: layer, first frame of the segment, -1 if the frames are
    lost, and by how much the stream's frame numbers exceed those of the medium.
    """

    is_fine: bool
    first: int
    offset: int


class LiveFrames:
    """Frames of a live stream, from events of a `LiveReceiver`; thread-safe.

    ``frames(i)`` returns the `ForceField` of frame i.

    Parameters
    ----------
    opened : Opened
        The programme that has started.
    report : callable ``report(note)`` is called with notes on frames and messages that were lost, refused or
        skipped.
    clock_s : callable
        Clock; returns seconds.
    coarse : LiveFrames, optional The coarse layer: the same frames on a lattice of half the resolution.

    Attributes
    ----------
    lost : int
        Number of frames that did not arrive, or could not be decoded.
    covered : int
        Number of frames that were replaced by the coarse layer.
    refused : int
        Number of messages that were refused.
    skipped : int
        Number of frames that playback skipped because it had fallen behind.
    received_s : float Time at which the latest segment arrived, seconds of the clock; before the first, the
        time at which waiting began.
    vibrates : bool
        True once a segment had a vibration.
    """

    def __init__(
        self,
        opened: Opened,
        report: Callable[[str], None] = lambda note: None,
        clock_s: Callable[[], float] = time.monotonic,
        coarse: LiveFrames | None = None,
    ) -> None:
        self.opened, head = opened, opened.head
        self.vibrates = False
        self.grid = Grid(head.grid_shape, head.spacing_m, head.origin_m)
        self._open_decoder()
        self._rate_hz: float = head.rate_hz
        if coarse is not None and (coarse.grid, coarse._rate_hz) != (half_grid(self.grid), head.rate_hz):
            found = f"{coarse.grid.shape} samples at {coarse._rate_hz:g} Hz"
            raise SourceError("coarse layer", found, f"half of {self.grid.shape} at {head.rate_hz:g} Hz")
        self._report, self._clock_s = report, clock_s
        self._coarse, self._rebuilt = coarse, (-1, ForceField.empty(self.grid))
        self._latest_part: _Part | None = None
        self._latest_seam = -1, False
        self._layers: tuple[LiveFrames, ...] = (self,) if coarse is None else (self, coarse)
        self._news: Condition = Condition() if coarse is None else coarse._news
        self._segments: deque[_Decoded] = deque()
        self._base: int | None = None
        self._fine: LiveFrames | None = None
        self._programmes = self._started_programmes = 0  # of this layer, and in those of both that are kept
        self._error: TouchfieldError | None = None
        self.lost = self.refused = self.skipped = self.covered = 0
        self.received_s, self._reported_s = clock_s(), -math.inf
        self._start_s: float | None = None
        self._played, self._capacity = (math.inf, 0.0), MAX_SEGMENTS
        self._settled_s = math.inf
        if coarse is not None:
            coarse._fine, coarse._capacity = (
                self,
                2 * MAX_SEGMENTS,
            )  # the fine layer may be that much later

    def _open_decoder(self) -> None:
        head = self.opened.head
        if coder(head.coder).spec is None:
            raise UnsupportedVersion("live stream", f"coder {head.coder}", "a coder of fields, such as touch")
        self._decoder: FieldDecoder = coder(head.coder).decoder_class(self.grid, head.coder_parameters)

    def _decoded(self, segment: LiveSegment) -> Iterator[Any]:
        """Yield the frames of a segment, each once it is decoded."""
        return self._decoder.frames(segment.body, segment.frame_count)

    @property
    def scene(self) -> HapticScene | None:
        """The bodies of a stream of coder `objects`; None for a stream of fields."""
        return None

    def take(self, event: Event) -> None:
        """Take an event; a segment is decoded in this (the receiving) thread."""
        if isinstance(event, LiveSegment):
            self._take_segment(event)
        elif isinstance(event, Lost):
            self._lose(event.frame_count, "did not come")
        elif isinstance(event, Refused):
            self.refused += 1
            self._report(f"a message was of no use: {event.reason}")
        elif isinstance(event, Ended):
            self.fail(LiveEnd("the sender has ended the stream"))

    def start_programme(self) -> None:
        """Start another programme on the same lattice.

        Its frames follow the latest one received.
        """
        self._programmes += 1

    def fail(self, error: TouchfieldError) -> None:
        """Mark that no more frames will arrive; waiting for a frame then raises the error."""
        self._error = self._error or error

    def _lose(self, frames: int, reason: str) -> None:
        """Count lost frames, and report each time that their number has doubled."""
        before, self.lost = self.lost, self.lost + frames
        if self.lost.bit_length() > before.bit_length():
            self._report(f"{frames} frames {reason}; {self.lost} are lost so far")

    def _take_segment(self, segment: LiveSegment) -> None:
        """Decode a segment frame by frame, so that the first can be played before the last is decoded."""
        received_s, first, fields = self._clock_s(), segment.first_frame, list[Any]()
        self.vibrates |= segment.vibration is not None
        start_s = received_s - first / self._rate_hz  # time at which frame 0 would have been on time
        try:
            band = (
                decode_vibration(segment.vibration, self.grid, segment.frame_count)
                if segment.vibration
                else []
            )
            for field in self._decoded(segment):
                fields.append(field)
                with self._news:
                    if len(fields) == 1:
                        self._report_arrival(received_s)
                        self._keep(_Decoded(first, fields, band))
                    start_s = max(start_s, self._clock_s() - (first + len(fields) - 1) / self._rate_hz)
                    self._news.notify_all()
        except FormatError as error:
            self._lose(segment.frame_count - len(fields), f"could not be decoded: {error}")
        with self._news:
            before_s = start_s if self._start_s is None else self._start_s
            is_anew = before_s - start_s > RESET_BEYOND_S or self.is_settling
            self._start_s = start_s if is_anew else max(start_s, before_s + FORGETTING * (start_s - before_s))

    def _report_arrival(self, received_s: float) -> None:
        """Record the time of a segment; report it if a wait for it was reported."""
        if self._segments and self._reported_s == self.received_s:
            self._report(f"segments come again, after {received_s - self.received_s:.0f} s")
        self.received_s = received_s

    def _keep(self, segment: _Decoded) -> None:
        """Keep a segment whose first frame is decoded; drop the oldest ones beyond the capacity."""
        fine = self._fine or self
        if (
            self._programmes > fine._started_programmes
        ):  # the segments that are kept have frame numbers of the previous programme
            fine._base = None if fine._base is None else segment.first + fine._base - fine._newest_stop
            for layer in fine._layers:
                layer._segments.clear()
                layer._start_s = None
            fine._started_programmes, fine._rebuilt = self._programmes, (-1, fine._rebuilt[1])
        self._segments.append(segment)
        while len(self._segments) > 1 and (
            len(self._segments) > self._capacity
            or sum(segment.size for segment in self._segments) > MAX_BYTES
        ):
            self._segments.popleft()
        if self._base is None:
            self._base = segment.first

    def due_s(self, rate_hz: float) -> float | None:
        """Return the time of the medium that is due now, seconds.

        Returns None before the first segment. Segments that arrive late delay it.
        """
        with self._news:
            start_s = self._zero_s
            if start_s is None or self._base is None:
                return None
            due_s = (
                min(self._clock_s() - start_s - MARGIN_S, self._newest_stop / rate_hz) - self._base / rate_hz
            )
            return due_s if self._coarse is None else max(0.0, due_s)  # a layer may have started later

    @property
    def _zero_s(self) -> float | None:
        """Clock time of the stream's frame 0: that of the later layer, if it is not far behind the other."""
        own_start_s, coarse = self._start_s, self._coarse
        coarse_start_s = coarse._start_s if coarse else None
        if coarse is None or own_start_s is None or coarse_start_s is None:
            return coarse_start_s if own_start_s is None else own_start_s
        lead_s = (self._stop - coarse._stop) / self._rate_hz
        if abs(lead_s) > LAYER_LOST_S:
            return own_start_s if lead_s > 0 else coarse_start_s
        return min(max(own_start_s, coarse_start_s), min(own_start_s, coarse_start_s) + MAX_LAYER_LAG_S)

    @property
    def _stop(self) -> int:
        """The frame of the stream after the newest decoded one; 0 before the first."""
        return self._segments[-1].first + len(self._segments[-1].fields) if self._segments else 0

    @property
    def _newest_stop(self) -> int:
        """The frame after the newest one in any layer."""
        return max(layer._stop for layer in self._layers)

    def _segment_with(self, frame: int) -> _Decoded | None:
        """Return the segment that contains a frame of the stream, or None if it is not kept."""
        return next(
            (
                segment
                for segment in self._segments
                if segment.first <= frame < segment.first + len(segment.fields)
            ),
            None,
        )

    def _is_settled(self, frame: int) -> bool:
        """Return True if a frame has arrived in the layer to be played, or will arrive in none."""
        coarse, is_past = self._coarse, frame < self._stop
        if coarse is None or self._segment_with(frame) is not None:
            return is_past
        is_past |= frame < coarse._stop - LAYER_LOST_S * self._rate_hz
        if coarse._segment_with(frame) is not None:
            return is_past or self._error is not None or self._is_due(frame)
        return is_past and (frame < coarse._stop or self._is_due(frame))

    def _is_due(self, frame: int) -> bool:
        """Return True if the player, or a player that is on time, needs the frame now."""
        start_s, now, needed_s = self._zero_s, self._clock_s(), (frame - 1) / self._rate_hz
        noted_s, media_s = self._played
        is_needed = media_s + (self._base or 0) / self._rate_hz + now - noted_s + MARGIN_S >= needed_s
        return is_needed or (start_s is not None and now - start_s >= needed_s)

    @property
    def is_settling(self) -> bool:
        """True before playback starts and in its first moments."""
        return self._clock_s() < (self._fine or self)._settled_s

    def set_played_time(self, media_s: float) -> None:
        """Record the time of the medium that is played now."""
        self._played = self._clock_s(), media_s
        self._settled_s = min(self._settled_s, self._clock_s() + SETTLING_S)

    def stream_frame(self, index: int) -> int | None:
        """Return the sender's current number of frame `index`; None before the first segment."""
        return None if self._base is None else self._base + index

    def __call__(self, index: int) -> ForceField:
        """Wait for a frame and return it; a lost frame has no force.

        Raises LiveEnd if the sender ended the stream before it; SourceError if nothing arrived for a minute,
        or the frame is far after the newest.
        """
        frame, segment = self._find_frame(index)
        coarse = None
        if segment is None and self._coarse is not None:
            with self._news:
                coarse = self._coarse._segment_with(frame)
        self._note_part(index, frame, segment, coarse)
        if segment is not None:
            field: ForceField = segment.fields[frame - segment.first]
            return field
        if coarse is None:
            return ForceField.empty(self.grid)
        if self._rebuilt[0] != frame:
            self._rebuilt = frame, rebuild_level(coarse.fields[frame - coarse.first], self.grid)
            self.covered += 1
        return self._rebuilt[1]

    def _note_part(self, index: int, frame: int, fine: _Decoded | None, coarse: _Decoded | None) -> None:
        """Record the part of the stream that a frame is from, and whether it continues the previous one."""
        found = fine or coarse
        part = _Part(fine is not None, -1 if found is None else found.first, frame - index)
        if self._latest_seam[0] != index:
            self._latest_seam = index, part != self._latest_part
        self._latest_part = part

    def is_seam(self, index: int) -> bool:
        """Return True if frame `index`, the latest returned, need not continue the previous one.

        It is the first of a segment or of another layer, or frames are missing before it.
        """
        return self._latest_seam == (index, True)

    def is_there(self, index: int) -> bool:
        """Return True if `__call__` returns or raises without waiting."""
        with self._news:
            is_settled = (
                self._base is not None and self._newest_stop > 0 and self._is_settled(self._base + index)
            )
            return is_settled or self._is_over or self._is_silent

    @property
    def _latest_s(self) -> float:
        """Time of the latest segment in any layer, seconds of the clock."""
        return max(layer.received_s for layer in self._layers)

    @property
    def _is_silent(self) -> bool:
        """True if the wait for a segment has timed out; a long wait is reported once."""
        limit_s = REPORT_AFTER_S + (len(self._segments[-1].fields) / self._rate_hz if self._segments else 0.0)
        now = self._clock_s()
        if now - self.received_s > limit_s and self._reported_s != self.received_s:
            self._reported_s = self.received_s
            is_alone = now - self._latest_s < limit_s
            status = "its coarse layer is rendered" if is_alone else f"waiting, for {PATIENCE_S:g} s in all"
            self._report(f"nothing has come for {now - self.received_s:.0f} s: {status}")
        return now - self._latest_s > PATIENCE_S

    @property
    def _is_over(self) -> bool:
        """True if no more frames will arrive in any layer."""
        return all(layer._error is not None for layer in self._layers)

    def vibration(self, index: int) -> VibrationFrame:
        """Return the vibration of a frame; see `__call__`."""
        frame, segment = self._find_frame(index)
        return (
            segment.band[frame - segment.first]
            if segment is not None and segment.band
            else VibrationFrame.empty(self.grid)
        )

    def _find_frame(self, index: int) -> tuple[int, _Decoded | None]:
        """Wait until a frame is settled; return its number in the stream and its segment, or None if lost."""
        with self._news:
            while True:
                segments = self._segments or self._layers[-1]._segments
                if segments and self._base is not None:
                    frame = self._base + index
                    if frame > self._newest_stop + _MAX_LOOKAHEAD:
                        raise SourceError("live stream", f"frame {index}, far ahead", "one that comes soon")
                    if frame < segments[0].first and not self._layers[-1]._segment_with(frame):
                        missed = segments[-1].first - frame
                        self.skipped, self._base = self.skipped + missed, self._base + missed
                        self._report(f"play had fallen behind, and goes on {missed} frames later")
                        continue
                    if self._is_settled(frame):
                        return frame, self._segment_with(frame)
                if self._error is not None and self._is_over:
                    raise self._error
                if self._is_silent:
                    raise SourceError(
                        "live stream", f"no segment for {PATIENCE_S:g} s", "one that comes in time"
                    )
                self._news.wait(MARGIN_S)  # polls, since no notification is sent when a frame becomes due


class LiveStream(OpenStream):
    """A live stream as an open stream; its medium has no end.

    Attributes
    ----------
    frames : LiveFrames
    """

    is_live = True

    def __init__(self, name: str, frames: LiveFrames) -> None:
        reader: Any = SimpleNamespace(name=name, has_vibration=False, size=0, **frames.opened.__dict__)
        super().__init__(reader)  # the attributes of a reader that a stream without an end has
        self.frames = frames

    @property
    def scene(self) -> HapticScene | None:
        return self.frames.scene

    def keep_up(self, player: Player) -> bool:
        """Keep a player at the due time; return True if it had to seek.

        Call this method a few times a second.
        """
        due_s = self.frames.due_s(self.reader.head.rate_hz)
        if due_s is None:
            return False
        lag_s = due_s - player.media_s
        seek_beyond_s = SEEK_WHILE_SETTLING_S if self.frames.is_settling else SEEK_BEYOND_S
        if abs(lag_s) > seek_beyond_s:
            self.frames.skipped += max(0, round(lag_s * self.reader.head.rate_hz))
            player.seek(due_s)
            lag_s = 0.0
        self.frames.set_played_time(due_s - lag_s)
        player.set_speed(1 + max(-MAX_SPEED_CHANGE, min(MAX_SPEED_CHANGE, lag_s)))
        return lag_s == 0.0

    @property
    def medium(self) -> HapticMedium:
        """The medium; access to a frame waits until it has arrived."""
        vibration = self.frames.vibration if self.frames.vibrates else None
        return HapticMedium(
            grid=self.grid, frame_count=ENDLESS, make_frame=self.frames, vibration=vibration, **self._metadata
        )

    @property
    def bits(self) -> BitAccount:
        raise SourceError(self.reader.name, "a live stream", "a file, whose bits and symbols can be counted")

    @property
    def bound_rule(self) -> Any:
        return self.bits

    @property
    def max_error_summary(self) -> Any:
        return self.bits

    def _coder(self) -> Any:
        return self.bits

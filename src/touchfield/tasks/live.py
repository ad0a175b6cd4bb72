"""A source, live: frames are made as their time comes, coded in segments, and sent to whoever is there.

What a segment takes until it can be felt is its own length, and the coding of its last frame. Where making or
coding frames cannot keep up, frames are left out and told; time goes on. A coarse layer is a stream of its
own beside: the same frames on half the lattice, within a mask twice as wide, a seventh of the bytes. What the
fine one is beyond it, coded as a difference, would take half as many again as the fine one alone.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from itertools import chain
from queue import SimpleQueue
from typing import Any, Final

from touchfield.codec.registry import field_encoder
from touchfield.codec.segment import Worst, bound_keys
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import CODER
from touchfield.codec.vibration import encode_vibration
from touchfield.errors import InvalidArgument, require_between, require_kinds, require_one_of, warn_unbounded
from touchfield.filters.resample import pyramid, rebuilt
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField
from touchfield.medium.medium import VibrationFrame
from touchfield.network.live import ENDLESS, LiveSegment, LiveSender
from touchfield.pipeline.encoding import provenance_of
from touchfield.pipeline.preparation import Prepared, Source, as_source, prepare
from touchfield.pipeline.segments import head_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.capture import CaptureEnd, captured
from touchfield.tasks.editing import detail_level

Send = Callable[[LiveSegment], bytes | None]

_MOST_UNDER_WAY: Final = 2
"""Segments that are coded, or whose last frames are."""


@dataclass(frozen=True)
class LiveSpec:
    """How a source goes on the air; InvalidArgument if a value is out of range.

    `segment_s`, the length of a segment, is what the delay is, and what a receiver that joins waits for at
    most; `loop` begins again at the end of the source; `seconds` None is to the end of the source.
    """

    segment_s: float = 0.25
    loop: bool = False
    seconds: float | None = None

    def __post_init__(self) -> None:
        require_kinds(self)
        require_between(0.01, 10, segment_s=self.segment_s)
        if self.seconds is not None and not self.seconds > 0:
            raise InvalidArgument("--on-air-s", f"{self.seconds:g}", "above 0")


@dataclass
class Sent:
    """Counts of a broadcast; `left_out` are frames that came too late to be made or coded.

    All but `coarse_bytes` are without a coarse layer. `worst_mask_ratio` is the largest error of all voxels
    sent, in units of the error bound; None where the mode has none, or nothing was sent.
    """

    frames: int = 0
    segments: int = 0
    sent_bytes: int = 0
    left_out: int = 0
    coarse_bytes: int = 0
    worst_mask_ratio: float | None = None

    def add(self, segment: LiveSegment, worst: Worst | None) -> None:
        """Count a segment that was sent."""
        self.sent_bytes += len(segment.body) + len(segment.vibration or b"")
        self.segments, self.frames = self.segments + 1, self.frames + segment.frame_count
        if worst is not None:
            self.worst_mask_ratio = max(worst.ratio, self.worst_mask_ratio or 0.0)

    def leave_out(self, frames: int, why: str, tell: Callable[[str], None]) -> None:
        """Count frames that are left out, and tell each time that they have become twice as many."""
        before, self.left_out = self.left_out, self.left_out + frames
        if self.left_out.bit_length() > before.bit_length():
            tell(f"{why}: {self.left_out} frames are left out so far")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return dict(self.__dict__)

    def error_bound(self, prepared: Prepared) -> dict[str, Any]:
        """Keys of the error bound that was proved of what was sent."""
        is_known = self.worst_mask_ratio is not None
        keys = bound_keys(CODER.bound_rule(prepared.coding), {"promise_kept": is_known})
        if not self.segments:
            keys = {"error_bound": None, "error_bound_note": "no error bound is proved: no segment was sent"}
        return {**keys, "promise_kept": True if is_known else None}


def opened_sender(source: Source, spec: EncodeSpec) -> tuple[Prepared, LiveSender]:
    """A source that is prepared as voxels, and a sender that has its opening; InvalidArgument for another
    coder.
    """
    require_one_of("coder of a live stream", spec.coder, ("touch",))
    # what is live has no time for a search
    spec = replace(spec, representation="voxel", touch=replace(spec.touch, effort="fast"))
    prepared = prepare(captured(source, spec.source) or as_source(source, spec.device), spec)
    rule = CODER.bound_rule(prepared.coding)
    warn_unbounded(None if rule.text else f"no error bound is proved: {rule.reason}")
    return prepared, _sender(source, prepared)


def _sender(source: Source, prepared: Prepared, **told: str) -> LiveSender:
    sender, encoder = LiveSender(), field_encoder(prepared.medium.grid, prepared.coding)
    sender.open(head_of(prepared, encoder), {**provenance_of(source, prepared), **told})
    return sender


def coarse_layer(source: Source, prepared: Prepared) -> tuple[Prepared, LiveSender]:
    """The coarse layer of a source that is prepared, and a sender that has its opening.

    Its provenance tells what a receiver of it alone lacks, on the first frame. InvalidArgument where the
    lattice cannot be halved.
    """
    fine, spec = prepared.medium, prepared.spec
    if max(fine.grid.shape) < 2:
        raise InvalidArgument("--coarse", f"a lattice of {fine.grid.shape} samples", "one that can be halved")
    meter, first = FidelityMeter(spec.k, spec.f0_n or EncodeSpec().f0_n), fine[0]
    meter.add(first, rebuilt(_coarse(first), fine.grid))
    k, f0_n = min(2 * spec.touch.k, 0.5), 2 * spec.touch.f0_n
    spec = replace(spec, touch=replace(spec.touch, k=k, f0_n=f0_n, mode="mask"))
    coarse = replace(prepared, medium=detail_level(fine, 1), spec=spec, scene=None, exact=None, source=None)
    layer = f"half of {fine.grid.words}; NMSE of the first frame {meter.nmse_db:.1f} dB"
    layer += "; the vibration is left out" if fine.vibration is not None else ""
    return coarse, _sender(source, coarse, layer=layer)


def _coarse(field: ForceField) -> ForceField:
    return pyramid(field, 1)[-1]


def broadcast(
    prepared: Prepared,
    send: Send,
    spec: LiveSpec,
    tell: Callable[[str], None] = lambda note: None,
    clock_s: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
    coarse: tuple[Prepared, Send] | None = None,
    ready: Callable[[], None] = lambda: None,
) -> Sent:
    """Make, code and send frames in time, until the source or the time is over, or an interrupt comes.

    ``send(segment) -> message`` must not wait for anyone; ``tell(note)`` gets what could not keep up.
    `coarse` is a coarse layer (`coarse_layer`) and who sends its segments. ``ready()`` is called where time
    begins.
    """
    lanes = [_Lane(prepared, send, clock_s)]
    if coarse is not None:
        lanes.append(_Lane(*coarse, clock_s, _coarse))
    sent = lanes[0].sent
    try:
        for lane in lanes:  # code is loaded or compiled first, and is no part of the time
            lane.warm(prepared.medium[0])
        began = clock_s()
        frame, rate_hz = prepared.medium[0], prepared.medium.rate_hz
        most = 1 / max(clock_s() - began, *(lane.warm(frame) for lane in lanes), 1e-9)
        if most < rate_hz:
            mend = "a lower --rate-hz or a smaller --nw keeps up"
            tell(
                f"this machine makes some {most:.2g} frames a second, and the medium has {rate_hz:g}: {mend}"
            )
        ready()
        for first, frames, band in _groups(prepared, spec, sent, tell, clock_s, pause):
            begun = [lane.begin(first, band if lane is lanes[0] else []) for lane in lanes]
            count, is_over = 0, False
            try:
                for frame in frames:
                    for coming in begun:
                        coming.put(frame)
                    count += 1
            except CaptureEnd as error:
                tell(f"{error.where}: {error.found}")
                is_over = True
            finally:
                for coming in begun:
                    coming.put(None)
            for lane, what in zip(lanes, ("coding", "coding the coarse layer")):
                if lane.is_late:
                    lane.sent.leave_out(count, f"{what} cannot keep up", tell)
            if is_over:
                break
    except KeyboardInterrupt:
        tell("interrupted: the stream ends here")
    finally:
        for lane in lanes:
            lane.close()
    sent.coarse_bytes = sum(lane.sent.sent_bytes for lane in lanes[1:])
    return sent


class _Lane:
    """A layer on its way: frames in, segments out, coded in a thread of its own.

    ``make(frame)`` is the layer's frame of one that comes. `is_late`: the segment begun last is left out.
    """

    def __init__(
        self,
        prepared: Prepared,
        send: Send,
        clock_s: Callable[[], float],
        make: Callable[[ForceField], ForceField] = lambda frame: frame,
    ) -> None:
        self.sent, self.is_late = Sent(), False
        self._send, self._clock_s, self._make = send, clock_s, make
        self._encoder = TouchEncoder(prepared.medium.grid, prepared.coding)
        self._force_max_n = prepared.device.force_max_n
        self._anchor: ForceField | None = None
        self._under_way: deque[Future[None]] = deque()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="touchfield-live")

    def warm(self, frame: ForceField) -> float:
        """Code two frames that nobody gets; seconds of one."""
        began, frames = self._clock_s(), [self._make(frame)] * 2
        self._encoder.encode_segment(frames, self._encoder.anchor(*frames), self._force_max_n)
        return (self._clock_s() - began) / 2

    def begin(self, first: int, band: list[VibrationFrame]) -> SimpleQueue[ForceField | None]:
        """Begin a segment; its frames, and a None behind them, are put into the queue. Raises what has
        failed.
        """
        while self._under_way and self._under_way[0].done():
            self._under_way.popleft().result()
        coming: SimpleQueue[ForceField | None] = SimpleQueue()
        self.is_late = len(self._under_way) >= _MOST_UNDER_WAY
        if not self.is_late:
            self._under_way.append(self._pool.submit(self._deliver, first, coming, band))
        return coming

    def _deliver(
        self, first: int, coming: SimpleQueue[ForceField | None], band: list[VibrationFrame]
    ) -> None:
        """Code and send the frames that come; nothing where there are none, as the source ended before."""
        frames = map(self._make, iter(coming.get, None))
        start = next(frames, None)
        if start is None:
            return
        self._anchor = self._encoder.anchor(start, self._anchor)  # of a world that stands
        coded = self._encoder.encode_segment(chain([start], frames), self._anchor, self._force_max_n)
        count, beside, sent = len(coded.frames), encode_vibration(band) if band else None, self.sent
        segment = LiveSegment(first, count, coded.body, beside)
        self._send(segment)
        sent.add(segment, coded.worst)

    def close(self) -> None:
        """Wait for what is under way; raises what has failed."""
        with self._pool:
            while self._under_way:
                self._under_way.popleft().result()


def _groups(
    prepared: Prepared,
    spec: LiveSpec,
    sent: Sent,
    tell: Callable[[str], None],
    clock_s: Callable[[], float],
    pause: Callable[[float], None],
) -> Iterator[tuple[int, Iterator[ForceField], list[VibrationFrame]]]:
    """Each segment as its time comes: number of its first frame, its frames in time, and a list for
    vibrations.
    """
    medium, count = prepared.medium, len(prepared.medium)
    length = max(1, min(round(spec.segment_s * medium.rate_hz), 4096))
    last = ENDLESS - 1 if spec.loop else count
    if spec.seconds is not None:
        last = min(last, max(1, round(spec.seconds * medium.rate_hz)))
    began = clock_s()

    def frames(first: int, band: list[VibrationFrame]) -> Iterator[ForceField]:
        for i in range(first, min(first + length, last)):
            early_s = began + (i + 1) / medium.rate_hz - clock_s()
            if early_s > 0:
                pause(early_s)
            if medium.vibration is not None:
                band.append(medium.vibration(i % count))
            yield medium[i % count]

    first = 0
    while first < last:
        late_s = clock_s() - began - (first + 1) / medium.rate_hz
        if late_s > 2 * length / medium.rate_hz:
            missed = min(int(late_s * medium.rate_hz), last - first)
            sent.leave_out(missed, "frames cannot be made in time", tell)
            first += missed
            continue
        band: list[VibrationFrame] = []
        yield first, frames(first, band), band
        first += length

"""Sends a source live: makes, codes and sends its frames in real time.

Frames are coded in segments, which are sent to all receivers. The delay of a segment is its length plus the
coding time of its last frame. If making or coding frames is too slow, frames are skipped and counted; the
clock does not wait. A coarse layer is a separate stream with the same frames on half the lattice, within a
mask twice as wide, in a seventh of the bytes. (Coding the fine stream as the difference to the coarse one
would take half as many bytes again as the fine stream alone.)
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

from numpy.typing import ArrayLike

from touchfield.codec.registry import field_encoder
from touchfield.codec.segment import MaxError, bound_keys
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import CODER
from touchfield.codec.vibration import encode_vibration
from touchfield.errors import InvalidArgument, require_between, require_kinds, require_one_of, warn_unbounded
from touchfield.filters.resample import pyramid, rebuild_level
from touchfield.measure.fidelity import FidelityMeter
from touchfield.medium import ForceField, Grid
from touchfield.medium.medium import VibrationFrame
from touchfield.network.live import ENDLESS, LiveSegment, LiveSender
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.segments import file_head
from touchfield.pipeline.source import Source
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.capture import CaptureEnd, open_capture
from touchfield.tasks.editing import detail_level

Send = Callable[[LiveSegment], bytes | None]

_MAX_PENDING: Final = 2
"""Maximum number of segments in progress at a time."""


@dataclass(frozen=True)
class LiveSpec:
    """Options of a live stream; InvalidArgument if a value is out of range.

    `segment_s` is the length of a segment, which is the delay, and the longest wait of a receiver that joins.
    `loop` restarts the source at its end; `seconds` None streams to the end of the source.
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
    """Counts of a broadcast.

    `left_out` counts frames that were too late to be made or coded.

    Only `coarse_bytes` counts the coarse layer. `worst_mask_ratio` is the largest error of all voxels sent,
    in units of the error bound; None if the mode has no bound, or nothing was sent.
    """

    frames: int = 0
    segments: int = 0
    sent_bytes: int = 0
    left_out: int = 0
    coarse_bytes: int = 0
    worst_mask_ratio: float | None = None

    def add(self, segment: LiveSegment, max_error: MaxError | None) -> None:
        """Count a segment that was sent."""
        self.sent_bytes += len(segment.body) + len(segment.vibration or b"")
        self.segments, self.frames = self.segments + 1, self.frames + segment.frame_count
        if max_error is not None:
            self.worst_mask_ratio = max(max_error.ratio, self.worst_mask_ratio or 0.0)

    def skip(self, frames: int, reason: str, on_note: Callable[[str], None]) -> None:
        """Count skipped frames, and report each time that their number has doubled."""
        before, self.left_out = self.left_out, self.left_out + frames
        if self.left_out.bit_length() > before.bit_length():
            on_note(f"{reason}: {self.left_out} frames are skipped so far")

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary; its keys are stable."""
        return dict(self.__dict__)

    def error_bound(self, prepared: Prepared) -> dict[str, Any]:
        """Return the keys of the error bound of all segments that were sent."""
        has_bound = self.worst_mask_ratio is not None
        keys = bound_keys(CODER.bound_rule(prepared.coding), {"promise_kept": has_bound})
        if not self.segments:
            keys = {"error_bound": None, "error_bound_note": "no error bound is proved: no segment was sent"}
        return {**keys, "promise_kept": True if has_bound else None}


def open_sender(
    source: Source | ArrayLike, spec: EncodeSpec, grid: Grid | None = None
) -> tuple[Prepared, LiveSender]:
    """Prepare a source as voxels, and open its sender.

    Sources are those of `touchfield.encode`, an array of newtons on `grid` as well, and those of
    `open_capture`. Raises InvalidArgument for a coder other than `touch`.
    """
    require_one_of("coder of a live stream", spec.coder, ("touch",))
    captured = open_capture(source, spec.source)
    # a live stream has no time for a search
    spec = replace(spec, representation="voxel", touch=replace(spec.touch, effort="fast"))
    prepared = prepare(source if captured is None else captured, spec, grid)
    rule = CODER.bound_rule(prepared.coding)
    warn_unbounded(None if rule.text else f"no error bound is proved: {rule.reason}")
    return prepared, _sender(source, prepared)


def _sender(source: Source | ArrayLike, prepared: Prepared, **extra_provenance: str) -> LiveSender:
    sender, encoder = LiveSender(), field_encoder(prepared.medium.grid, prepared.coding)
    sender.open(file_head(prepared, encoder), {**file_provenance(source, prepared), **extra_provenance})
    return sender


def coarse_layer(source: Source | ArrayLike, prepared: Prepared) -> tuple[Prepared, LiveSender]:
    """Prepare the coarse layer of a prepared source, and open its sender.

    Its provenance states the error of the layer alone on the first frame. Raises InvalidArgument if the
    lattice cannot be halved.
    """
    fine, spec = prepared.medium, prepared.spec
    if max(fine.grid.shape) < 2:
        raise InvalidArgument("--coarse", f"a lattice of {fine.grid.shape} samples", "one that can be halved")
    meter, first = FidelityMeter(spec.weber, spec.f0_n or EncodeSpec().f0_n), fine[0]
    meter.add(first, rebuild_level(_coarse(first), fine.grid))
    k, f0_n = min(2 * spec.k, 0.5), 2 * spec.touch.f0_n
    spec = replace(spec, touch=replace(spec.touch, k=k, f0_n=f0_n, k_by_force=(), mode="mask"))
    coarse = replace(prepared, medium=detail_level(fine, 1), spec=spec, objects=None, exact=None, source=None)
    layer = f"half of {fine.grid.description}; NMSE of the first frame {meter.nmse_db:.1f} dB"
    layer += "; the vibration is left out" if fine.vibration is not None else ""
    return coarse, _sender(source, coarse, layer=layer)


def _coarse(field: ForceField) -> ForceField:
    return pyramid(field, 1)[-1]


def broadcast(
    prepared: Prepared,
    send: Send,
    spec: LiveSpec,
    on_note: Callable[[str], None] = lambda note: None,
    clock_s: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
    coarse: tuple[Prepared, Send] | None = None,
    on_start: Callable[[], None] = lambda: None,
) -> Sent:
    """Make, code and send frames in real time.

    Ends with the source, after the requested time, or at an interrupt.

    ``send(segment) -> message`` must not block; ``on_note(note)`` is called with notes on skipped frames.
    `coarse` is a coarse layer (`coarse_layer`) and the function that sends its segments. ``on_start()`` is
    called when the clock starts.
    """
    lanes = [_Layer(prepared, send, clock_s)]
    if coarse is not None:
        lanes.append(_Layer(*coarse, clock_s, _coarse))
    sent = lanes[0].sent
    try:
        for lane in lanes:  # load or compile code before the clock starts
            lane.warm(prepared.medium[0])
        start_s = clock_s()
        frame, rate_hz = prepared.medium[0], prepared.medium.rate_hz
        max_rate_hz = 1 / max(clock_s() - start_s, *(lane.warm(frame) for lane in lanes), 1e-9)
        if max_rate_hz < rate_hz:
            hint = "a lower --rate-hz or a smaller --nw keeps up"
            rates = f"some {max_rate_hz:.2g} frames a second, and the medium has {rate_hz:g}"
            on_note(f"this machine makes {rates}: {hint}")
        on_start()
        for first, frames, band in _timed_segments(prepared, spec, sent, on_note, clock_s, pause):
            queues = [lane.start_segment(first, band if lane is lanes[0] else []) for lane in lanes]
            count, is_over = 0, False
            try:
                for frame in frames:
                    for queue in queues:
                        queue.put(frame)
                    count += 1
            except CaptureEnd as error:
                on_note(f"{error.where}: {error.found}")
                is_over = True
            finally:
                for queue in queues:
                    queue.put(None)
            for lane, work in zip(lanes, ("coding", "coding the coarse layer")):
                if lane.is_late:
                    lane.sent.skip(count, f"{work} cannot keep up", on_note)
            if is_over:
                break
    except KeyboardInterrupt:
        on_note("interrupted: the stream ends here")
    finally:
        for lane in lanes:
            lane.close()
    sent.coarse_bytes = sum(lane.sent.sent_bytes for lane in lanes[1:])
    return sent


class _Layer:
    """One layer: frames in, segments out, coded in its own thread.

    ``make(frame)`` makes the layer's frame of an incoming frame. `is_late` is True if the latest segment is
    skipped.
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
        self._key_frame: ForceField | None = None
        self._pending: deque[Future[None]] = deque()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="touchfield-live")

    def warm(self, frame: ForceField) -> float:
        """Code two frames that are not sent; return the seconds that one takes."""
        start_s, frames = self._clock_s(), [self._make(frame)] * 2
        self._encoder.encode_segment(frames, self._encoder.key_frame(*frames), self._force_max_n)
        return (self._clock_s() - start_s) / 2

    def start_segment(self, first: int, band: list[VibrationFrame]) -> SimpleQueue[ForceField | None]:
        """Start a segment; return the queue for its frames and a final None.

        Raises the error of an earlier segment.
        """
        while self._pending and self._pending[0].done():
            self._pending.popleft().result()
        queue: SimpleQueue[ForceField | None] = SimpleQueue()
        self.is_late = len(self._pending) >= _MAX_PENDING
        if not self.is_late:
            self._pending.append(self._pool.submit(self._deliver, first, queue, band))
        return queue

    def _deliver(self, first: int, queue: SimpleQueue[ForceField | None], band: list[VibrationFrame]) -> None:
        """Code and send the frames of a queue.

        Sends nothing if the queue has no frame, because the source has ended.
        """
        frames = map(self._make, iter(queue.get, None))
        first_frame = next(frames, None)
        if first_frame is None:
            return
        self._key_frame = self._encoder.key_frame(first_frame, self._key_frame)  # of a static world
        coded = self._encoder.encode_segment(chain([first_frame], frames), self._key_frame, self._force_max_n)
        count, vibration, sent = len(coded.frames), encode_vibration(band) if band else None, self.sent
        segment = LiveSegment(first, count, coded.body, vibration)
        self._send(segment)
        sent.add(segment, coded.max_error)

    def close(self) -> None:
        """Wait for the pending segments; raises their error."""
        with self._pool:
            while self._pending:
                self._pending.popleft().result()


def _timed_segments(
    prepared: Prepared,
    spec: LiveSpec,
    sent: Sent,
    on_note: Callable[[str], None],
    clock_s: Callable[[], float],
    pause: Callable[[float], None],
) -> Iterator[tuple[int, Iterator[ForceField], list[VibrationFrame]]]:
    """Yield each segment at its time.

    Each item is the index of the first frame, an iterator of the frames in real time, and the vibrations.
    """
    medium, count = prepared.medium, len(prepared.medium)
    length = max(1, min(round(spec.segment_s * medium.rate_hz), 4096))
    last = ENDLESS - 1 if spec.loop else count
    if spec.seconds is not None:
        last = min(last, max(1, round(spec.seconds * medium.rate_hz)))
    start_s = clock_s()

    def frames(first: int, band: list[VibrationFrame]) -> Iterator[ForceField]:
        for i in range(first, min(first + length, last)):
            early_s = start_s + (i + 1) / medium.rate_hz - clock_s()
            if early_s > 0:
                pause(early_s)
            if medium.vibration is not None:
                band.append(medium.vibration(i % count))
            yield medium[i % count]

    first = 0
    while first < last:
        late_s = clock_s() - start_s - (first + 1) / medium.rate_hz
        if late_s > 2 * length / medium.rate_hz:
            missed = min(int(late_s * medium.rate_hz), last - first)
            sent.skip(missed, "frames cannot be made in time", on_note)
            first += missed
            continue
        band: list[VibrationFrame] = []
        yield first, frames(first, band), band
        first += length

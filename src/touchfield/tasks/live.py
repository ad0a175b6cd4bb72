"""Sends a source live: makes, codes and sends its frames in real time.

Frames are coded in segments, which are sent to all receivers. The delay of a segment is its length plus the
coding time of its last frame. The clock does not wait: while a frame is being coded for longer than a frame
lasts, the next ones are not made but repeat it, and the first one that finds the coder idle shows the newest
picture. A frame that would delay its segment by more than `MAX_DELAY_S` is not started. Without a coarse
layer, one frame at a time is then made or coded, on one core. Frames that are left out are counted.

Of rigid bodies, segments have only the poses (`touchfield.tasks.live_bodies`); a model of MuJoCo is simulated
meanwhile. A coarse layer is a separate stream with the same frames on half the lattice, within a mask twice
as wide, in a seventh of the bytes. (Coding the fine stream as the difference to the coarse one would take
half as many bytes again as the fine stream alone.)
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from queue import SimpleQueue
from typing import Any, Final, NamedTuple

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
from touchfield.pipeline.encoding import record_of
from touchfield.pipeline.preparation import Prepared, prepare
from touchfield.pipeline.provenance import file_provenance
from touchfield.pipeline.segments import file_head
from touchfield.pipeline.source import Source, scene_of
from touchfield.pipeline.spec import EncodeSpec
from touchfield.sources.depth.capture import CaptureEnd, open_capture
from touchfield.sources.physics.body_scene import BodyScene
from touchfield.sources.physics.live_simulation import Control
from touchfield.tasks.editing import detail_level
from touchfield.tasks.live_bodies import MAX_OVERLAP, LiveBodies

Send = Callable[[LiveSegment], bytes | None]

_WARM_POSES: Final = 64

_MAX_PENDING: Final = 2
"""Maximum number of segments in progress at a time."""

MAX_DELAY_S: Final = 0.1
"""Time behind the end of a segment by which a frame that is started should be coded."""

_MAKING_IS_LATE: Final = "frames cannot be made in time"

_REPEAT: Final = object()
"""In place of a frame: the frame before is repeated."""


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

    `left_out` counts frames that were too late to be made or coded, whether the frame before is repeated in
    their place or nothing is sent; `coarse_left_out` counts those of the coarse layer. `frames` are the
    others.

    `unbounded_segments` counts segments that state no error bound. Only `coarse_bytes` counts the coarse
    layer. `worst_mask_ratio` is the largest error of all voxels sent, in units of the error bound; None if
    the mode has no bound, or nothing was sent.
    """

    frames: int = 0
    segments: int = 0
    sent_bytes: int = 0
    left_out: int = 0
    coarse_bytes: int = 0
    worst_mask_ratio: float | None = None
    unbounded_segments: int = 0
    coarse_left_out: int = 0

    def add(self, segment: LiveSegment, max_error: MaxError | None, repeats: int = 0) -> None:
        """Count a segment that was sent, of whose frames `repeats` only repeat the one before."""
        self.sent_bytes += len(segment.body) + len(segment.vibration or b"")
        self.segments, self.frames = self.segments + 1, self.frames + segment.frame_count - repeats
        if max_error is None:
            self.unbounded_segments += 1
        else:
            self.worst_mask_ratio = max(max_error.ratio, self.worst_mask_ratio or 0.0)

    def leave_out(self, frames: int, reason: str, on_note: Callable[[str], None]) -> None:
        """Count frames that are left out, and report each time that their number has doubled."""
        before, self.left_out = self.left_out, self.left_out + frames
        if self.left_out.bit_length() > before.bit_length():
            on_note(f"{reason}: {self.left_out} frames are left out so far")

    def summary(self) -> dict[str, Any]:
        """Return the counts as a dictionary; its keys are stable. A note reports the unbounded segments."""
        return {name: value for name, value in vars(self).items() if name != "unbounded_segments"}

    def error_bound(self, prepared: Prepared) -> dict[str, Any]:
        """Return the keys of the error bound of all segments that were sent."""
        has_bound = self.worst_mask_ratio is not None and not self.unbounded_segments
        rule = CODER.bound_rule(prepared.coding)
        if isinstance(prepared, PreparedBodies):
            rule = prepared.bodies.encoder.bound_rule
        keys = bound_keys(rule, {"promise_kept": has_bound})
        if not self.segments:
            keys = {"error_bound": None, "error_bound_note": "no error bound is proved: no segment was sent"}
        elif has_bound and self.left_out:
            absent = f"{self.left_out} of {self.frames + self.left_out} frames were left out"
            keys["error_bound_note"] = f"it holds for the frames that were sent; {absent}"
        return {**keys, "promise_kept": True if has_bound else None}


@dataclass(frozen=True, repr=False)
class PreparedBodies(Prepared):
    """A source whose bodies are sent, with `bodies`, which has their poses."""

    bodies: LiveBodies = field(kw_only=True)


def open_sender(
    source: Source | ArrayLike, spec: EncodeSpec, grid: Grid | None = None, control: Control | None = None
) -> tuple[Prepared, LiveSender]:
    """Prepare a source as voxels, or as bodies if `spec` has the representation "object"; open its sender.

    Sources are those of `touchfield.encode`, an array of newtons on `grid` as well, and those of
    `open_capture`. ``control(model, data)`` is called before each frame of a simulation of bodies. Raises
    InvalidArgument for a coder other than `touch`, or objects of a source that has none.
    """
    require_one_of("coder of a live stream", spec.coder, ("touch",))
    if spec.representation == "object":
        return _open_bodies(source, spec, control)
    if control is not None:
        raise InvalidArgument("control", "a stream of voxels", "representation='object'")
    captured = open_capture(source, spec.source)
    # a live stream has no time for a search
    spec = replace(spec, representation="voxel", touch=replace(spec.touch, effort="fast"))
    prepared = prepare(source if captured is None else captured, spec, grid)
    rule = CODER.bound_rule(prepared.coding)
    warn_unbounded(None if rule.text else f"no error bound is proved: {rule.reason}")
    return prepared, _sender(source, prepared)


def _open_bodies(
    source: Source | ArrayLike, spec: EncodeSpec, control: Control | None
) -> tuple[Prepared, LiveSender]:
    scene = scene_of(source, spec)
    if not isinstance(scene, BodyScene):
        expected = "rigid bodies: a model of MuJoCo, a robot, or a scene of bodies"
        raise InvalidArgument(
            "--representation", "object for another source", expected, "Take voxel or auto."
        )
    if scene.simulation is not None:
        scene = scene.freed()
    prepared = prepare(scene, spec)
    bodies = LiveBodies(scene, prepared, control)
    encoder: Any = bodies.encoder  # the head has its name and its parameters
    sender, records = LiveSender(), [record_of(coded) for coded in bodies.encoder.objects]
    sender.open(file_head(prepared, encoder), file_provenance(source, prepared), records)
    return PreparedBodies(**vars(prepared), bodies=bodies), sender


def _sender(source: Source | ArrayLike, prepared: Prepared, **extra_provenance: str) -> LiveSender:
    sender, encoder = LiveSender(), field_encoder(prepared.medium.grid, prepared.coding)
    sender.open(file_head(prepared, encoder), {**file_provenance(source, prepared), **extra_provenance})
    return sender


def coarse_layer(source: Source | ArrayLike, prepared: Prepared) -> tuple[Prepared, LiveSender]:
    """Prepare the coarse layer of a prepared source, and open its sender.

    Its provenance states the error of the layer alone on the first frame. Raises InvalidArgument if the
    lattice cannot be halved, or for bodies.
    """
    fine, spec = prepared.medium, prepared.spec
    if isinstance(prepared, PreparedBodies):
        raise InvalidArgument(
            "--coarse", "a stream of bodies", "one of fields", "Add --representation voxel."
        )
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

    ``send(segment) -> message`` must not block; ``on_note(note)`` is called with notes on frames left out.
    `coarse` is a coarse layer (`coarse_layer`) and the function that sends its segments. ``on_start()`` is
    called when the clock starts.
    """
    lanes, make, rate_hz = list[_Lane](), _frames_of(prepared, on_note), prepared.medium.rate_hz
    if isinstance(prepared, PreparedBodies):
        lanes.append(_BodiesLayer(prepared.bodies, send, clock_s))
    else:
        lanes.append(_Layer(prepared, send, clock_s))
    if coarse is not None:
        lanes.append(_Layer(*coarse, clock_s, _coarse, "coding the coarse layer"))
    sent = lanes[0].sent
    try:
        for lane in lanes:  # load or compile code before the clock starts
            lane.warm(make(0))
        start_s = clock_s()
        frame = make(0)
        max_rate_hz = 1 / max(clock_s() - start_s, *(lane.warm(frame) for lane in lanes), 1e-9)
        if max_rate_hz < rate_hz:
            hint = "a lower --rate-hz or a smaller --nw keeps up"
            rates = f"some {max_rate_hz:.2g} frames a second, and the medium has {rate_hz:g}"
            on_note(f"this machine makes {rates}: {hint}")
        on_start()
        for first, ticks, band in _timed_segments(prepared, spec, sent, on_note, clock_s, pause):
            queues = [lane.start_segment(first, band if lane is lanes[0] else []) for lane in lanes]
            count, is_over = 0, False
            try:
                for tick in ticks:
                    _put_frame(tick, prepared, make, list(zip(lanes, queues, strict=True)), on_note)
                    count += 1
            except CaptureEnd as error:
                on_note(f"{error.where}: {error.found}")
                is_over = True
            finally:
                for queue in queues:
                    queue.put(None)
            for lane in lanes:
                if lane.is_late:
                    lane.sent.leave_out(count, f"{lane.work} cannot keep up", on_note)
            if is_over:
                break
    except KeyboardInterrupt:
        on_note("interrupted: the stream ends here")
    finally:
        for lane in lanes:
            lane.close()
    sent.coarse_bytes = sum(lane.sent.sent_bytes for lane in lanes[1:])
    sent.coarse_left_out = sum(lane.sent.left_out for lane in lanes[1:])
    if isinstance(prepared, PreparedBodies) and sent.unbounded_segments:
        on_note(
            f"{sent.unbounded_segments} segments state no error bound: more than {MAX_OVERLAP} bodies overlap"
        )
    return sent


def _put_frame(
    tick: _Tick,
    prepared: Prepared,
    make: Callable[[int], Any],
    lanes: list[tuple[_Lane, SimpleQueue[Any]]],
    on_note: Callable[[str], None],
) -> None:
    """Make a frame for the lanes that want it; the others repeat the one before and count it."""
    period_s = 1 / prepared.medium.rate_hz
    wanting = [lane for lane, _ in lanes if lane.wants_frame(tick, period_s)]
    frame = make(tick.frame) if wanting else None
    if frame is None and prepared.source is not None:
        prepared.source.skip_frame(tick.frame)
    for lane, queue in lanes:
        queue.put(frame if lane in wanting else _REPEAT)
        if lane not in wanting and not lane.is_late:  # of a late segment, all frames are counted
            reason = _MAKING_IS_LATE if tick.late_s > period_s else f"{lane.work} cannot keep up"
            lane.sent.leave_out(1, reason, on_note)


def _frames_of(prepared: Prepared, on_note: Callable[[str], None]) -> Callable[[int], Any]:
    """Return the function that makes a frame: a field, or the poses of bodies."""
    if isinstance(prepared, PreparedBodies):
        return partial(prepared.bodies.poses, on_note=on_note)
    return prepared.medium.__getitem__


class _Tick(NamedTuple):
    """A frame of a segment that is due.

    `late_s` is the time since it was due, `left_s` that until its segment should be sent.
    """

    frame: int
    is_first: bool
    late_s: float
    left_s: float


class _Lane(ABC):
    """Frames in, segments out, coded in a thread of its own.

    `is_late` is True if the latest segment is skipped. `work` describes the lane in notes.
    """

    def __init__(self, send: Send, clock_s: Callable[[], float], work: str = "coding") -> None:
        self.sent, self.is_late, self.work = Sent(), False, work
        self._send, self._clock_s = send, clock_s
        self._queue: SimpleQueue[Any] = SimpleQueue()
        self._latest_s: deque[float] = deque(maxlen=3)  # seconds that frames took, without repetitions
        self._is_coding, self._repeats = False, 0
        self._pending: deque[Future[None]] = deque()
        self._pool = ThreadPoolExecutor(1, thread_name_prefix="touchfield-live")

    @abstractmethod
    def warm(self, frame: Any) -> float:
        """Code some frames that are not sent; return the seconds that one takes."""

    @abstractmethod
    def _encode(self, frames: Iterator[Any]) -> tuple[int, bytes, MaxError | None]:
        """Code frames as they come; return their number, the body of their segment and its largest error."""

    def wants_frame(self, tick: _Tick, period_s: float) -> bool:
        """Return False if the frame before should be repeated in place of the frame of `tick`.

        The first frame of a segment is never left out.
        """
        if self.is_late or tick.is_first:
            return not self.is_late
        if tick.late_s > period_s:
            return False
        frame_s = min(self._latest_s) if len(self._latest_s) == self._latest_s.maxlen else 0.0
        if frame_s <= period_s:
            return True
        self._check_pending()
        is_idle = not self._is_coding and self._queue.empty() and len(self._pending) == 1
        return is_idle and frame_s <= tick.left_s

    def _check_pending(self) -> None:
        """Forget the segments that are sent; raises the error of one that is not."""
        while self._pending and self._pending[0].done():
            self._pending.popleft().result()

    def start_segment(self, first: int, band: list[VibrationFrame]) -> SimpleQueue[Any]:
        """Start a segment; return the queue for its frames and a final None.

        Raises the error of an earlier segment.
        """
        self._check_pending()
        self._queue = SimpleQueue()
        self.is_late = len(self._pending) >= _MAX_PENDING
        if not self.is_late:
            self._pending.append(self._pool.submit(self._deliver, first, self._queue, band))
        return self._queue

    def _deliver(self, first: int, queue: SimpleQueue[Any], band: list[VibrationFrame]) -> None:
        """Code and send the frames of a queue.

        Sends nothing if the queue has no frame, because the source has ended.
        """
        self._repeats = 0
        count, body, max_error = self._encode(self._frames(queue))
        if not count:
            return
        segment = LiveSegment(first, count, body, encode_vibration(band) if band else None)
        self._send(segment)
        self.sent.add(segment, max_error, self._repeats)

    def _frames(self, queue: SimpleQueue[Any]) -> Iterator[Any]:
        """Yield the frames of a queue; a repetition is the same object again."""
        frame = None
        while (item := queue.get()) is not None:
            self._is_coding, start_s = True, time.perf_counter()
            frame = frame if item is _REPEAT else item
            self._repeats += item is _REPEAT
            yield frame
            if item is not _REPEAT:
                self._latest_s.append(time.perf_counter() - start_s)
            self._is_coding = False

    def close(self) -> None:
        """Wait for the pending segments; raises their error."""
        with self._pool:
            while self._pending:
                self._pending.popleft().result()


class _Layer(_Lane):
    """A layer of fields; ``make(frame)`` makes its field of that of an incoming frame."""

    def __init__(
        self,
        prepared: Prepared,
        send: Send,
        clock_s: Callable[[], float],
        make: Callable[[ForceField], ForceField] = lambda frame: frame,
        work: str = "coding",
    ) -> None:
        super().__init__(send, clock_s, work)
        self._make, self._encoder = make, TouchEncoder(prepared.medium.grid, prepared.coding)
        self._force_max_n = prepared.device.force_max_n
        self._key_frame: ForceField | None = None

    def _encode(self, frames: Iterator[Any]) -> tuple[int, bytes, MaxError | None]:
        fields = self._fields(frames)
        first_field = next(fields, None)
        if first_field is None:
            return 0, b"", None
        self._key_frame = self._encoder.key_frame(first_field, self._key_frame)  # of a static world
        coded = self._encoder.encode_segment(chain([first_field], fields), self._key_frame, self._force_max_n)
        return len(coded.frames), coded.body, coded.max_error

    def _fields(self, frames: Iterator[Any]) -> Iterator[ForceField]:
        """Yield the field of each frame, and the same one where a frame is repeated."""
        latest: Any = None
        for frame in frames:
            if frame is not latest:
                field, latest = self._make(frame), frame
            yield field

    def warm(self, frame: Any) -> float:
        start_s, frames = self._clock_s(), [self._make(frame)] * 2
        self._encoder.encode_segment(frames, self._encoder.key_frame(*frames), self._force_max_n)
        return (self._clock_s() - start_s) / 2


class _BodiesLayer(_Lane):
    """The poses of rigid bodies, which are coded once a segment is complete."""

    def __init__(self, bodies: LiveBodies, send: Send, clock_s: Callable[[], float]) -> None:
        super().__init__(send, clock_s)
        self._bodies = bodies

    def wants_frame(self, tick: _Tick, period_s: float) -> bool:
        return not self.is_late

    def _encode(self, frames: Iterator[Any]) -> tuple[int, bytes, MaxError | None]:
        poses = list(frames)
        if not poses:
            return 0, b"", None
        coded = self._bodies.encoder.encode_frames(poses)
        return len(poses), coded.body, coded.max_error

    def warm(self, frame: Any) -> float:
        start_s = self._clock_s()
        self._bodies.encoder.encode_frames([frame] * _WARM_POSES)
        return (self._clock_s() - start_s) / _WARM_POSES


def _timed_segments(
    prepared: Prepared,
    spec: LiveSpec,
    sent: Sent,
    on_note: Callable[[str], None],
    clock_s: Callable[[], float],
    pause: Callable[[float], None],
) -> Iterator[tuple[int, Iterator[_Tick], list[VibrationFrame]]]:
    """Yield each segment at its time.

    Each item is the index of the first frame, an iterator of the frames in real time, and the vibrations.
    """
    medium, count = prepared.medium, len(prepared.medium)
    longest, is_endless = 4096, False
    if isinstance(prepared, PreparedBodies):
        longest, is_endless = prepared.bodies.max_segment_frames, not prepared.bodies.has_end
    length = max(1, min(round(spec.segment_s * medium.rate_hz), longest))
    last = ENDLESS - 1 if spec.loop or is_endless else count
    if is_endless and not spec.loop:
        count = last  # a simulation goes on
    if spec.seconds is not None:
        last = min(last, max(1, round(spec.seconds * medium.rate_hz)))
    start_s = clock_s()

    def ticks(first: int, band: list[VibrationFrame]) -> Iterator[_Tick]:
        stop = min(first + length, last)
        for i in range(first, stop):
            early_s = start_s + (i + 1) / medium.rate_hz - clock_s()
            if early_s > 0:
                pause(early_s)
            if medium.vibration is not None:
                band.append(medium.vibration(i % count))
            late_s = max(0.0, -early_s)
            left_s = (stop - i - 1) / medium.rate_hz + MAX_DELAY_S - late_s
            yield _Tick(i % count, i == first, late_s, left_s)

    first = 0
    while first < last:
        late_s = clock_s() - start_s - (first + 1) / medium.rate_hz
        if late_s > 2 * length / medium.rate_hz:
            missed = min(int(late_s * medium.rate_hz), last - first)
            sent.leave_out(missed, _MAKING_IS_LATE, on_note)
            first += missed
            continue
        band: list[VibrationFrame] = []
        yield first, ticks(first, band), band
        first += length

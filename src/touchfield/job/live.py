"""A source, live: frames are made as their time comes, coded in segments, and sent to whoever is there.

What a segment takes until it can be felt is its own length, and what coding and sending take beside it. Where making
or coding frames cannot keep up, frames are left out and told; time goes on.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from touchfield.codec.registry import AnchoringEncoder, coder, field_encoder
from touchfield.codec.vibration import encode_vibration
from touchfield.errors import InvalidArgument
from touchfield.job.encode import head_of, provenance_of
from touchfield.job.prepare import prepare
from touchfield.job.spec import EncodeSpec
from touchfield.job.stream_scene import as_source
from touchfield.stream.live import ENDLESS, LiveSegment, LiveSender

if TYPE_CHECKING:
    from touchfield.job.prepare import Prepared
    from touchfield.job.stream_scene import Source
    from touchfield.medium import ForceField
    from touchfield.medium.vibration import VibrationFrame

__all__ = ["LiveSpec", "Sent", "broadcast", "opened_sender"]


@dataclass(frozen=True)
class LiveSpec:
    """How a source goes on the air.

    Parameters
    ----------
    segment_s : float
        Seconds of a segment: what the delay is, and what a receiver that joins waits for at most.
    loop : bool
        Whether the source begins again at its end.
    seconds : float or None
        How long; None: to the end of the source.

    Raises
    ------
    InvalidArgument
        If a value is out of range.
    """

    segment_s: float = 0.25
    loop: bool = False
    seconds: float | None = None

    def __post_init__(self) -> None:
        if not 0.01 <= self.segment_s <= 10:
            raise InvalidArgument("--segment-s", f"{self.segment_s:g}", "0.01 to 10 seconds")
        if self.seconds is not None and not self.seconds > 0:
            raise InvalidArgument("--on-air-s", f"{self.seconds:g}", "above 0")


@dataclass
class Sent:
    """What went on the air.

    Attributes
    ----------
    frames, segments, sent_bytes : int
    left_out : int
        Frames that came too late to be made or coded.
    slowest_encode_s : float
        Of a segment.
    """

    frames: int = 0
    segments: int = 0
    sent_bytes: int = 0
    left_out: int = 0
    slowest_encode_s: float = 0.0

    def leave_out(self, frames: int, why: str, tell: Callable[[str], None]) -> None:
        """Count frames that are left out, and tell each time that they have become twice as many."""
        before, self.left_out = self.left_out, self.left_out + frames
        if self.left_out.bit_length() > before.bit_length():
            tell(f"{why}: {self.left_out} frames are left out so far")

    def summary(self) -> dict[str, Any]:
        """Stable keys for people and programs."""
        return dict(self.__dict__)


def opened_sender(source: Source, spec: EncodeSpec) -> tuple[Prepared, LiveSender]:
    """A source that is prepared as voxels, and a sender that has its opening.

    Raises
    ------
    TouchfieldError
        If the source or an option is at fault.
    """
    if spec.coder == "touch":  # what is live has no time for a search
        spec = replace(spec, touch=replace(spec.touch, effort="fast"))
    spec = replace(spec, representation="voxel")
    given = as_source(source, spec.device)
    prepared = prepare(given, spec)
    encoder = field_encoder(prepared.medium.grid, _coding(prepared))
    sender = LiveSender()
    name = given if isinstance(given, str | Path) else "scene"
    sender.open(head_of(prepared, encoder), provenance_of(name, prepared))
    return prepared, sender


def broadcast(
    prepared: Prepared,
    send: Callable[[LiveSegment], int],
    spec: LiveSpec,
    tell: Callable[[str], None] = lambda note: None,
    clock_s: Callable[[], float] = time.monotonic,
    pause: Callable[[float], None] = time.sleep,
) -> Sent:
    """Make, code and send frames in time, until the source or the time is over.

    Parameters
    ----------
    prepared : Prepared
    send : callable
        ``send(segment) -> bytes``; must not wait for anyone.
    spec : LiveSpec
    tell : callable
        ``tell(note)``: what could not keep up.
    clock_s, pause : callable
    """
    sent = Sent()
    encoder = field_encoder(prepared.medium.grid, _coding(prepared))
    anchor: ForceField | None = None

    def coded(first: int, frames: list[ForceField], band: list[VibrationFrame]) -> LiveSegment:
        nonlocal anchor
        began = clock_s()
        if isinstance(encoder, AnchoringEncoder):
            anchor = encoder.anchor(frames[0], anchor)
            body = encoder.encode_segment(frames, anchor).body
        else:
            body = encoder.encode_segment(frames).body
        sent.slowest_encode_s = max(sent.slowest_encode_s, clock_s() - began)
        return LiveSegment(first, len(frames), body, encode_vibration(band) if band else None)

    def delivered(segment: Future[LiveSegment]) -> None:
        sent.sent_bytes += send(segment.result())
        sent.segments, sent.frames = sent.segments + 1, sent.frames + segment.result().frame_count

    encoder.encode_segment([prepared.medium[0]] * 2)  # code is loaded or compiled first, and is no part of the time
    waiting: Future[LiveSegment] | None = None
    with ThreadPoolExecutor(1, thread_name_prefix="touchfield-live") as pool:
        for first, frames, band in _groups(prepared, spec, sent, tell, clock_s, pause):
            if waiting is not None and not waiting.done():
                sent.leave_out(len(frames), "coding cannot keep up", tell)
                continue
            if waiting is not None:
                waiting.result()
            waiting = pool.submit(coded, first, frames, band)
            waiting.add_done_callback(lambda done: None if done.exception() else delivered(done))
        if waiting is not None:
            waiting.result()
    return sent


def _groups(
    prepared: Prepared,
    spec: LiveSpec,
    sent: Sent,
    tell: Callable[[str], None],
    clock_s: Callable[[], float],
    pause: Callable[[float], None],
) -> Iterator[tuple[int, list[ForceField], list[VibrationFrame]]]:
    """The frames of each segment as their time comes: number of the first, fields, vibrations."""
    medium, count = prepared.medium, len(prepared.medium)
    length = max(1, min(round(spec.segment_s * medium.rate_hz), 4096))
    last = ENDLESS - 1 if spec.loop else count
    if spec.seconds is not None:
        last = min(last, max(1, round(spec.seconds * medium.rate_hz)))
    began = clock_s()
    first, fields, band = 0, list[Any](), list[Any]()
    i = 0
    while i < last:
        late_s = clock_s() - began - (i + 1) / medium.rate_hz
        if late_s < 0:
            pause(-late_s)
        elif late_s > 2 * length / medium.rate_hz and not fields:
            missed = int(late_s * medium.rate_hz)
            sent.leave_out(missed, "frames cannot be made in time", tell)
            i += missed
            first = i
            continue
        fields.append(medium[i % count])
        if medium.vibration is not None:
            band.append(medium.vibration[i % count])
        i += 1
        if len(fields) == length or i >= last:
            yield first, fields, band
            first, fields, band = i, [], []


def _coding(prepared: Prepared) -> Any:
    return coder(prepared.spec.coder).resolve(prepared.spec.coding, prepared.device.is_array)

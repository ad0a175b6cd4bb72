"""A live stream without a network and without waiting: the messages of a sender, and when they arrive.

`recorded` broadcasts a medium in simulated time; `Arrivals` gives its messages to a receiver at their time of
the ticks.
"""

from __future__ import annotations

import time
from collections.abc import Container
from dataclasses import dataclass

from touchfield.medium import HapticMedium
from touchfield.network.live import ENDLESS, LiveReceiver, LiveSegment, Lost, Opened
from touchfield.network.live_medium import LiveFrames
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.live import LiveSpec, broadcast, coarse_layer, open_sender

AHEAD_S, MAX_WAIT_S = 0.1, 60.0
"""How long before its first frame is due a message arrives; and how long a segment may take to be coded."""


@dataclass(frozen=True)
class Layer:
    """One layer of a stream: its opening, and the messages of its segments."""

    opening: bytes
    messages: list[bytes]


def recorded(medium: HapticMedium, spec: EncodeSpec, frames: int, segment_frames: int) -> tuple[Layer, Layer]:
    """Broadcast a medium, looped, and return the stream and its coarse layer."""
    prepared, sender = open_sender(medium, spec)
    coarse, coarse_sender = coarse_layer(medium, prepared)
    took: tuple[list[bytes], list[bytes]] = ([], [])
    now_s = 0.0

    def pause(seconds: float) -> None:
        """Go on in time once all segments so far are coded: a slow machine leaves no frame out."""
        nonlocal now_s
        complete = round(medium.rate_hz * now_s) // segment_frames
        deadline_s = time.monotonic() + MAX_WAIT_S
        while any(len(messages) < complete for messages in took) and time.monotonic() < deadline_s:
            time.sleep(0.001)
        now_s += seconds

    def send_fine(segment: LiveSegment) -> None:
        took[0].append(sender.add(segment))

    def send_coarse(segment: LiveSegment) -> None:
        took[1].append(coarse_sender.add(segment))

    live = LiveSpec(segment_frames / medium.rate_hz, loop=True, seconds=frames / medium.rate_hz)
    sent = broadcast(
        prepared, send_fine, live, clock_s=lambda: now_s, pause=pause, coarse=(coarse, send_coarse)
    )
    if sent.left_out:
        raise RuntimeError(f"{sent.left_out} frames were not coded in {MAX_WAIT_S:g} s")
    return Layer(sender.opening, took[0]), Layer(coarse_sender.opening, took[1])


class Arrivals:
    """A receiver of a recorded stream; `medium` has the frames that have arrived.

    Segments numbered in `lost` do not arrive; with `coarse`, its frames replace them.
    """

    def __init__(self, fine: Layer, coarse: Layer | None, lost: Container[int], segment_s: float) -> None:
        self._now_s, self._segment_s, self._next = 0.0, segment_s, 0
        self._layers = [fine] if coarse is None else [fine, coarse]
        self._receivers = [LiveReceiver() for _ in self._layers]
        self._lost = lost
        opened = [
            event
            for layer, receiver in zip(self._layers, self._receivers)
            for event in receiver.receive(layer.opening)
            if isinstance(event, Opened)
        ]
        clock_s = lambda: self._now_s  # noqa: E731
        under = None if coarse is None else LiveFrames(opened[1], clock_s=clock_s)
        self.frames = LiveFrames(opened[0], clock_s=clock_s, coarse=under)
        self._taken = [self.frames] if under is None else [self.frames, under]
        head = opened[0].head
        self.medium = HapticMedium(
            self.frames.grid,
            head.rate_hz,
            ENDLESS,
            self.frames,
            axes=head.axes,
            provenance=opened[0].provenance,
        )
        self(0)

    def __call__(self, tick: int) -> None:
        """Let arrive what has come at a tick."""
        self._now_s = AHEAD_S + 1e-3 * tick
        while self._next * self._segment_s <= self._now_s:
            for n, layer in enumerate(self._layers):
                is_lost = n == 0 and self._next in self._lost
                if self._next < len(layer.messages) and not is_lost:
                    for event in self._receivers[n].receive(layer.messages[self._next]):
                        if isinstance(event, LiveSegment | Lost):
                            self._taken[n].take(event)
            self._next += 1

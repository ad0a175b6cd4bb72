"""A coarse layer beside a live stream: what a hand feels where the stream has lost a segment or is late."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Sized
from contextlib import ExitStack
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from live_makers import GRID, HEAD, Hand, field, medium, segment
from touchfield.codec.registry import field_encoder
from touchfield.codec.touch.decoder import TouchDecoder
from touchfield.codec.touch.encoder import TouchEncoder
from touchfield.codec.touch.spec import TouchSpec
from touchfield.codec.vibration import decode_vibration
from touchfield.errors import InvalidArgument, SourceError
from touchfield.filters.resample import half_grid, interpolate, pyramid, rebuild_level
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.medium.medium import VibrationFrame
from touchfield.network.live import ENDLESS, Ended, LiveReceiver, LiveSegment, Lost, Opened
from touchfield.network.live_medium import MAX_LAYER_LAG_S, LiveEnd, LiveFrames, LiveStream
from touchfield.pipeline.preparation import Prepared
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.live import LiveSpec, broadcast, coarse_layer, open_sender

HALF = half_grid(GRID)
UNDER = TouchEncoder(HALF, TouchSpec(k=0.2, f0_n=0.1, effort="fast"))
UNDER_HEAD = replace(
    HEAD, grid_shape=HALF.shape, spacing_m=HALF.spacing_m, origin_m=HALF.origin_m, frame_count=ENDLESS,
    coder_parameters=UNDER.parameters,
)  # fmt: skip
OPENED = Opened(replace(HEAD, frame_count=ENDLESS), {})
FINE = {5 * i: segment(5 * i) for i in range(8)}
COARSE = {
    5 * i: LiveSegment(
        5 * i, 5, UNDER.encode_segment([pyramid(field(5 * i + n), 1)[-1] for n in range(5)]).body
    )
    for i in range(8)
}


@cache
def expected_forces(number: int) -> dict[str, np.ndarray]:
    """Forces of a frame from the stream, from its coarse layer, and where both are missing."""
    coarse = rebuild_level(pyramid(field(number), 1)[-1], GRID)
    fields = {"fine": field(number), "coarse": coarse, "nothing": ForceField.empty(GRID)}
    return {name: dense_field.to_dense() for name, dense_field in fields.items()}


class Pair:
    """A stream and its coarse layer, their clock, and the notes of the stream."""

    def __init__(self) -> None:
        self.now_s, self.notes = 0.0, list[str]()
        self.under = LiveFrames(Opened(UNDER_HEAD, {}), clock_s=lambda: self.now_s)
        self.frames = LiveFrames(OPENED, self.notes.append, lambda: self.now_s, self.under)

    def kind(self, index: int) -> str:
        """The layer that answers the query of a frame."""
        if not self.frames.is_there(index):
            return "waits"
        forces = self.frames(index).to_dense()
        number = self.frames.stream_frame(index) or 0
        for name, other in expected_forces(number).items():
            if np.abs(forces - other).max() < 0.45:
                return name
        return "something else"


def test_the_layers_differ_by_more_than_their_masks() -> None:
    coarse, fine = rebuild_level(pyramid(field(1), 1)[-1], GRID).to_dense(), field(1).to_dense()
    assert np.abs(coarse - fine).max() > 0.9


def test_the_coarse_layer_replaces_lost_segments() -> None:
    pair = Pair()
    for event in (COARSE[0], COARSE[5], COARSE[15]):
        pair.under.take(event)
    for fine_event in (FINE[0], Lost(5, 10), FINE[15]):
        pair.frames.take(fine_event)
    assert [pair.kind(i) for i in (4, 5, 9, 10, 14, 15)] == [
        "fine",
        "coarse",
        "coarse",
        "nothing",
        "nothing",
        "fine",
    ]
    assert pair.frames.covered == 2 and pair.frames.lost == 10
    kinds = [(pair.kind(i), pair.frames.is_seam(i)) for i in (4, 5, 6, 9, 10)]
    assert [is_seam for _, is_seam in kinds] == [True, True, False, False, True]


def test_the_coarse_layer_replaces_late_segments_until_they_arrive() -> None:
    pair = Pair()
    for step in range(20):
        pair.now_s = 0.1 * (step + 1)
        pair.under.take(replace(COARSE[0], first_frame=5 * step))
        if step < 10:
            pair.frames.take(replace(FINE[0], first_frame=5 * step))
    due_s = pair.frames.due_s(50.0)
    assert due_s is not None and 1.8 < due_s < 2.0, "the clock goes on with the coarse layer"
    np.testing.assert_allclose(pair.frames(49).to_dense(), field(4).to_dense(), atol=0.3)
    assert pair.frames.is_there(90) and not pair.frames.is_there(99), "what is not needed yet is waited for"
    pair.now_s += 0.1
    assert pair.frames.is_there(99)
    pair.frames.take(replace(FINE[0], first_frame=95))
    np.testing.assert_allclose(pair.frames(97).to_dense(), field(2).to_dense(), atol=0.3)


def test_a_stream_that_is_always_too_late_delays_nothing() -> None:
    pair = Pair()
    for step in range(40):
        pair.now_s = 0.1 * (step + 1)
        pair.under.take(replace(COARSE[0], first_frame=5 * step))
        if step >= 6:  # 0.6 s behind
            pair.frames.take(replace(FINE[0], first_frame=5 * (step - 6)))
    due_s = pair.frames.due_s(50.0)
    assert due_s is not None and pair.now_s - due_s < 0.1 + MAX_LAYER_LAG_S + 0.05


def test_a_stream_that_fails_goes_on_coarse_until_both_have_ended() -> None:
    pair = Pair()
    pair.under.take(COARSE[0])
    pair.under.take(COARSE[5])
    pair.frames.take(FINE[0])
    pair.frames.fail(SourceError("live stream", "cut", "on"))
    assert pair.kind(7) == "coarse" and not pair.frames.is_there(10)
    pair.under.take(Ended())
    assert pair.frames.is_there(10)
    with pytest.raises(SourceError, match="cut"):
        pair.frames(10)
    both = Pair()
    both.frames.take(FINE[0])
    both.under.take(Ended())
    both.frames.take(Ended())
    with pytest.raises(LiveEnd):
        both.frames(5)


@pytest.mark.parametrize("comes", ["coarse alone", "coarse first", "fine first"])
def test_another_programme_whose_coarse_layer_comes_first_or_alone(comes: str) -> None:
    pair = Pair()
    pair.now_s = 2.2
    for first in (100, 105):
        pair.under.take(replace(COARSE[0], first_frame=first))
        pair.frames.take(replace(FINE[0], first_frame=first))
    fine = (pair.frames, FINE), (pair.under, COARSE)
    for step in range(8):
        pair.now_s = 5.0 + 0.1 * step
        for layer, events in fine if comes == "fine first" else fine[::-1]:
            if layer is pair.frames and (comes == "coarse alone" or (comes == "coarse first" and step < 2)):
                continue
            if step == 0 or (step == 2 and layer is pair.frames and comes == "coarse first"):
                layer.start_programme()
            layer.take(events[5 * step])
    assert pair.frames.stream_frame(10) == 0, "what comes next is behind what was there"
    pair.now_s = 5.65
    assert [pair.kind(10 + number) for number in (8, 31)] == [
        "coarse",
        "coarse" if comes == "coarse alone" else "fine",
    ]
    due_s = pair.frames.due_s(50.0)
    assert due_s == pytest.approx(5.65 - 5.0 - 0.03 + 0.2, abs=0.03)
    pair.now_s = 7.0
    assert not pair.frames.is_there(10 + 40) and pair.frames.skipped == 0


def test_frames_that_both_layers_lost_are_empty() -> None:
    """A hand that queries frame by frame, as an array does, does not wait for ever."""
    pair = Pair()
    pair.frames.take(FINE[0])
    for event in (COARSE[0], COARSE[10], replace(COARSE[0], first_frame=65)):
        pair.under.take(event)
    assert [pair.kind(i) for i in (4, 7, 10, 16, 21)] == ["fine", "nothing", "coarse", "nothing", "waits"]
    pair.under.take(replace(COARSE[0], first_frame=10_000))
    pair.now_s = 200.0
    assert pair.frames(10_001).support_count, "the coarse layer alone has been felt for minutes"
    pair.under.take(replace(COARSE[0], first_frame=10_005))
    assert not pair.frames.is_there(10_010) and pair.notes == [
        "nothing has come for 200 s: its coarse layer is rendered"
    ]


def test_a_layer_of_another_lattice_is_refused() -> None:
    for head in (OPENED.head, replace(UNDER_HEAD, rate_hz=25.0)):
        with pytest.raises(SourceError, match="half of"):
            LiveFrames(OPENED, coarse=LiveFrames(Opened(head, {})))


class Layers(RuleBasedStateMachine):
    """Segments of both layers arrive, or do not, at any time: the finest one is played without waiting."""

    def __init__(self) -> None:
        super().__init__()
        self.pair = Pair()
        self.next = [0, 0]
        self.arrived: list[set[int]] = [set(), set()]

    @rule(layer=st.integers(0, 1), lost=st.integers(0, 2))
    def arrive(self, layer: int, lost: int) -> None:
        frames = (self.pair.frames, self.pair.under)[layer]
        first = self.next[layer] + (5 * lost if self.next[layer] else 0)
        if first > 35 or (layer == 0 and first == 0 and self.next[1] > 15):
            return
        frames.take((FINE, COARSE)[layer][first])
        self.next[layer] = first + 5
        self.arrived[layer].add(first)

    @rule(seconds=st.floats(0, 0.3))
    def wait(self, seconds: float) -> None:
        self.pair.now_s += seconds

    @invariant()
    def the_finest_is_played(self) -> None:
        frames, under = self.pair.frames, self.pair.under
        if not self.arrived[0] or frames.stream_frame(0) is None:
            return
        oldest = min([*sorted(self.arrived[0])[-4:], *sorted(self.arrived[1])[-8:]])
        for number in range(max(oldest, 0), 40, 3):
            first = number - number % 5
            is_stored = [
                first in sorted(numbers)[-n:] for numbers, n in zip(self.arrived, (4, 8), strict=True)
            ]
            if number < min(sorted(self.arrived[0])[-4:]) and not is_stored[1]:
                continue  # play would be moved on
            kind = self.pair.kind(number)
            if is_stored[0]:
                assert kind == "fine"
            elif is_stored[1]:
                is_lost = number < self.next[0]
                assert kind == "coarse" or (kind == "waits" and not is_lost and not frames._is_due(number))
            else:
                assert kind == "waits" or (kind == "nothing" and number < self.next[0])
        assert frames.skipped == under.skipped == 0


TestLayers = Layers.TestCase
TestLayers.settings = settings(max_examples=30, stateful_step_count=25, deadline=None)


@settings(max_examples=60, deadline=None)
@given(st.tuples(*[st.integers(1, 20)] * 3), st.integers(0, 2**32 - 1), st.floats(0, 1))
def test_a_doubled_lattice_equals_interpolation(
    shape: tuple[int, int, int], seed: int, density: float
) -> None:
    rng = np.random.default_rng(seed)
    fine = Grid(shape, (0.002, 0.003, 0.001), (0.1, 0.2, -0.3))
    dense = rng.normal(size=(*half_grid(fine).shape, 3)) * (rng.random((*half_grid(fine).shape, 1)) < density)
    level = ForceField.from_dense(half_grid(fine), dense.astype(np.float32))
    expected = interpolate(level, fine, border="cell").to_dense()
    np.testing.assert_allclose(rebuild_level(level, fine).to_dense(), expected, atol=2e-6)


# -- the sending end ---------------------------------------------------------------------------------------


class Paced:
    """A clock that advances with `pause`, once the encoder has sent all complete segments."""

    def __init__(self, frames: int, *sent: Sized) -> None:
        self.now_s, self._frames, self._sent = 0.0, frames, sent

    def pause(self, seconds: float) -> None:
        complete, deadline_s = round(50 * self.now_s) // self._frames, time.monotonic() + 30
        while any(len(segments) < complete for segments in self._sent) and time.monotonic() < deadline_s:
            time.sleep(0.001)
        self.now_s += seconds


def test_both_layers_are_broadcast() -> None:
    index, unit = np.ones((1, 3), np.int32), np.ones(1, np.float32)
    shaken = replace(medium(), vibration=lambda i: VibrationFrame(GRID, index, unit, (100 + i) * unit))
    prepared, _ = open_sender(shaken, EncodeSpec())
    assert prepared.spec.touch.effort == "fast"
    coarse, under = coarse_layer(shaken, prepared)
    took: tuple[list[LiveSegment], list[LiveSegment]] = ([], [])
    paced, spec = Paced(5, *took), LiveSpec(0.1, loop=True, seconds=2.0)
    layer = (coarse, took[1].append)
    sent = broadcast(
        prepared, took[0].append, spec, clock_s=lambda: paced.now_s, pause=paced.pause, coarse=layer
    )
    assert sent.segments == len(took[0]) == len(took[1]) == 20 and sent.left_out == 0
    assert sent.coarse_bytes == sum(len(segment.body) for segment in took[1]) > 0
    assert sent.sent_bytes == sum(len(segment.body) + len(segment.vibration or b"") for segment in took[0])
    assert not any(segment.vibration for segment in took[1]), "what vibrates is in the fine layer"
    last = took[0][-1]  # the medium has begun again
    assert last.vibration is not None
    band = [float(f.frequencies_hz[0]) for f in decode_vibration(last.vibration, GRID, 5)]
    assert band == [145, 146, 147, 148, 149]
    decoder = TouchDecoder(GRID, field_encoder(GRID, prepared.coding).parameters)
    assert [f.support_count for f in decoder.frames(last.body, 5)] == [
        field(45 + i).support_count for i in range(5)
    ]
    receiver = LiveReceiver()
    (opened,) = receiver.receive(under.opening)
    assert isinstance(opened, Opened) and "NMSE" in opened.provenance["layer"]
    assert opened.head.weber_fraction == 2 * prepared.spec.k
    assert opened.head.force_threshold_n == 2 * prepared.spec.f0_n
    frames = LiveFrames(opened)
    frames.take(took[1][0])
    number = took[1][0].first_frame
    expected = pyramid(medium()[number], 1)[-1].to_dense()
    np.testing.assert_array_less(np.abs(frames(0).to_dense() - expected), 0.11 + 0.2 * np.abs(expected).max())


def sent_messages(with_layer: bool) -> list[bytes]:
    prepared, sender = open_sender(medium(), EncodeSpec())
    messages, under = list[bytes](), list[LiveSegment]()
    paced = Paced(25, messages, *([under] if with_layer else []))
    coarse = (coarse_layer(medium(), prepared)[0], under.append) if with_layer else None

    def send(segment: LiveSegment) -> None:
        messages.append(sender.add(segment))

    broadcast(prepared, send, LiveSpec(0.5), clock_s=lambda: paced.now_s, pause=paced.pause, coarse=coarse)
    return [sender.opening, *messages]


def test_a_coarse_layer_changes_no_byte_of_the_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("touchfield.network.live.secrets.token_hex", lambda count: "the same word")
    alone = sent_messages(False)
    assert len(alone) == 3 and sent_messages(True) == alone


def test_a_lattice_that_cannot_be_halved_is_refused() -> None:
    grid = Grid((1, 1, 1), (0.01,) * 3, (0.0,) * 3)
    medium_of_one = HapticMedium.from_frames(
        [ForceField.from_dense(grid, np.ones((1, 1, 1, 3), np.float32))], 30.0, HEAD.axes
    )
    prepared, _ = open_sender(medium_of_one, EncodeSpec())
    with pytest.raises(InvalidArgument, match="halved"):
        coarse_layer(medium_of_one, prepared)


# -- through a network -------------------------------------------------------------------------------------

pytest.importorskip("raptorq", reason="datagrams need the extra broadcast")
from tests.network.test_datagrams import free_port  # noqa: E402

from touchfield.network import live_client  # noqa: E402
from touchfield.network.access import Access  # noqa: E402
from touchfield.network.datagrams import Datagrams, Gathering  # noqa: E402
from touchfield.network.live_server import LiveServer  # noqa: E402
from touchfield.network.opening import open_stream  # noqa: E402
from touchfield.network.udp import REPAIR, UdpSender  # noqa: E402
from touchfield.tasks.play import PlaySpec, play  # noqa: E402


def test_the_coarse_layer_survives_bursts_that_the_fine_one_does_not() -> None:
    """5 % of losses in bursts of five (Gilbert), seeded; in time, with 30 % more bytes than both layers."""
    rng, is_bad, sent_bytes, count = np.random.default_rng(5), False, 0, 400
    sizes, bodies = (20_000, 2_800), rng.bytes(20_000)
    links = [
        (Datagrams(1, REPAIR["fine"]), Gathering(max_open=11)),
        (Datagrams(2, REPAIR["coarse"]), Gathering(max_open=11)),
    ]
    arrivals: tuple[dict[int, int], dict[int, int]] = ({}, {})
    for slot in range(count + 1):
        for (sending, gathering), size, got in zip(links, sizes, arrivals, strict=True):
            message = slot.to_bytes(4, "big") + bodies[: size - 4]
            for datagram in sending.add(message) if slot < count else sending.flush():
                sent_bytes += len(datagram)
                is_bad = rng.random() > 1 / 5 if is_bad else rng.random() < 0.05 / (0.95 * 5)
                for received in [] if is_bad else gathering.receive(datagram):
                    got[int.from_bytes(received[:4], "big")] = slot
    in_time = [{number for number, slot in got.items() if slot <= number + 8} for got in arrivals]
    assert len(in_time[0]) < 0.995 * count, "the fine layer loses something, or nothing is shown"
    assert len(in_time[0] | in_time[1]) >= 0.999 * count and len(in_time[1]) >= 0.995 * count
    assert sent_bytes <= 1.3 * count * sum(sizes)


def rough() -> HapticMedium:
    """At least 2 N towards the user everywhere; a segment of its coarse layer takes several datagrams."""
    rng = np.random.default_rng(3)
    noise = rng.uniform(0, 0.8, (25, *GRID.shape, 3)) + np.array([0, 0, 2.0])
    return HapticMedium.from_frames(
        [ForceField.from_dense(GRID, frame.astype(np.float32)) for frame in noise], 50.0, HEAD.axes
    )


def played_fraction(has_layer: bool, segments: int = 150) -> float:
    """Fraction of the time with a force at the hand, with bursts of lost datagrams, on a simulated clock."""
    source, now, rng, is_bad = rough(), [0.0], np.random.default_rng(11), False
    fine, sender = open_sender(source, EncodeSpec())
    _, under = coarse_layer(source, fine)
    layers = []
    for layer_sender, layer in ((under, "coarse"), (sender, "fine"))[not has_layer :]:
        bodies = coded_rough()[layer]
        (opened,) = LiveReceiver().receive(layer_sender.opening)
        assert isinstance(opened, Opened)
        frames = LiveFrames(opened, clock_s=lambda: now[0], coarse=layers[0][0] if layers else None)
        repair = REPAIR[layer if has_layer else "alone"]  # type: ignore[index]
        link = Datagrams(7, repair), Gathering(max_open=11 if has_layer else 24), LiveReceiver()
        layers.append((frames, layer_sender, bodies, *link))
    frames, hand = layers[-1][0], Hand(0.0)
    live, ticks, played = LiveStream("live", frames), 0, 0
    for step in range(10 * segments):
        now[0] = 0.01 * step
        number = step // 10
        for layer_frames, layer_sender, bodies, sending, gathering, receiver in (
            layers if step % 10 == 0 else []
        ):
            message = layer_sender.add(LiveSegment(5 * number, 5, bodies[number % 5]))
            for datagram in (sending.add(layer_sender.opening) if number % 4 == 0 else []) + sending.add(
                message
            ):
                is_bad = rng.random() > 1 / 5 if is_bad else rng.random() < 0.05 / (0.95 * 5)
                for received in [] if is_bad else gathering.receive(datagram):
                    for event in receiver.receive(received):
                        layer_frames.take(event)
        if step % 10 == 0:
            live.keep_up(hand)
        if step > 200:
            index, ticks = int(hand.media_s * 50) + 1, ticks + 1
            played += frames.is_there(index) and frames(index).support_count > 0
        if frames.stream_frame(0) is not None:
            hand.media_s += 0.01 * hand.speed
    return played / ticks


def test_a_coarse_layer_raises_the_played_fraction_under_bursts_of_losses(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    decode, decoded = TouchDecoder.frames, dict[tuple[Grid, bytes], list[ForceField]]()

    def frames(decoder: TouchDecoder, body: bytes, count: int) -> list[ForceField]:
        """The frames of one of the five segments of the layer, decoded before."""
        key = decoder._grid, body
        if key not in decoded:
            decoded[key] = list(decode(decoder, body, count))
        return decoded[key]

    monkeypatch.setattr(TouchDecoder, "frames", frames)
    alone, layered = played_fraction(False), played_fraction(True)
    assert layered > 0.99 and layered >= alone, (alone, layered)


def bodies_of(prepared: Prepared) -> list[bytes]:
    """The bodies of all segments of five frames."""
    source = prepared.medium
    encoder = TouchEncoder(source.grid, prepared.coding)
    return [encoder.encode_segment([source[i + n] for n in range(5)]).body for i in range(0, len(source), 5)]


@cache
def coded_rough() -> dict[str, list[bytes]]:
    """The bodies of both layers of `rough`."""
    prepared, _ = open_sender(rough(), EncodeSpec())
    return {"fine": bodies_of(prepared), "coarse": bodies_of(coarse_layer(rough(), prepared)[0])}


class OnAir:
    """A medium with its coarse layer on a server and by datagrams at two ports; encoded beforehand.

    The fine layer is no longer sent half a second after `keep_back` has been called.
    """

    def __init__(self, port: int | None = None) -> None:
        source = medium() if port is None else rough()
        prepared, self._sender = open_sender(source, EncodeSpec())
        coarse, self._under = coarse_layer(source, prepared)
        self._bodies = (
            (bodies_of(prepared), bodies_of(coarse)) if port is None else tuple(coded_rough().values())
        )
        self.server = LiveServer(self._sender, Access(port=0), coarse=self._under)
        self._port, self._sent, self._last = port, 0, math.inf
        self._thread, self._is_over = threading.Thread(target=self._run, daemon=True), threading.Event()

    def stop_fine(self) -> None:
        self._last = min(self._last, self._sent + 5)

    @property
    def has_stopped_fine(self) -> bool:
        """Whether every segment of the fine layer has arrived or is lost."""
        return self._sent > self._last + 20

    def _run(self) -> None:
        with ExitStack() as stack:
            by_datagrams = []
            if self._port is not None:
                to = f"127.0.0.1:{self._port}"
                by_datagrams.append(stack.enter_context(UdpSender(self._sender, to, "fine")))
                by_datagrams.append(stack.enter_context(UdpSender(self._under, to, "coarse")))
            began = time.monotonic()
            while not self._is_over.wait(max(0.0, began + 0.1 * (self._sent + 1) - time.monotonic())):
                fine, coarse = (
                    LiveSegment(5 * self._sent, 5, bodies[self._sent % len(bodies)])
                    for bodies in self._bodies
                )
                messages = [self.server.add(fine), self.server.add(coarse, is_coarse=True)]
                for link, message in zip(by_datagrams, messages, strict=False):
                    if message is messages[1] or self._sent < self._last:
                        link.add(message)
                self._sent += 1

    def __enter__(self) -> OnAir:
        self.server.__enter__()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._is_over.set()
        self._thread.join(10)
        self.server.__exit__()


@pytest.mark.parametrize("form", ["ws://{}/coarse/live", "http://{}/coarse/live.json"])
def test_a_receiver_with_low_bandwidth_takes_the_coarse_layer_alone(form: str) -> None:
    with OnAir() as air, open_stream(form.format(air.server.address)) as stream:
        assert stream.grid == HALF
        frames = stream.medium
        number = frames.make_frame.stream_frame(0)  # type: ignore[attr-defined]
        expected = pyramid(medium()[number % 50], 1)[-1].to_dense()
        np.testing.assert_allclose(frames[0].to_dense(), expected, atol=0.45)


def test_play_continues_with_the_coarse_layer_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    hand, port, notes = tmp_path / "hand.csv", free_port(), list[str]()
    hand.write_text("t_s,x_m,y_m,z_m\n0,0,0,-0.07\n60,0,0,-0.07\n")
    spec = PlaySpec(
        "sim", seconds=60.0, trajectory=hand, is_logged=True, coarse=f"udp://127.0.0.1:{port + 1}"
    )
    alone: list[
        tuple[float, int]
    ] = []  # play position, and frames from the coarse layer, once the fine layer has stopped
    with OnAir(port) as air:
        keep_up = LiveStream.keep_up

        def played_already(live: LiveStream, player: Any) -> bool:
            air.stop_fine()
            if air.has_stopped_fine and not alone:
                alone.append((player.media_s, live.frames.covered))
            if alone and live.frames.covered >= alone[0][1] + 50:
                raise KeyboardInterrupt  # as a user does
            return keep_up(live, player)

        monkeypatch.setattr(LiveStream, "keep_up", played_already)
        played = play(f"udp://127.0.0.1:{port}", spec, on_note=notes.append)
    assert played.error is None and played.rows is not None, notes
    assert alone, (played.statistics, notes)
    force_n = np.linalg.norm(played.rows["force_n"][played.rows["media_s"] > alone[0][0]], axis=1)
    assert (force_n > 0.5).sum() > 100, (played.statistics, notes)  # without data the force is zero


def test_a_missing_coarse_layer_is_reported_and_one_of_a_file_is_refused(tmp_path: Path) -> None:
    notes: list[str] = []
    with OnAir() as air:
        address = air.server.address
        opened = open_stream(f"ws://{address}/live", notes.append, f"ws://{address}/nothing")
        with opened as stream:
            assert stream.medium[0].support_count
    assert "without its coarse layer" in notes[0]
    with (
        pytest.raises(InvalidArgument, match="coarse"),
        open_stream(tmp_path / "a.touch", coarse="ws://x/coarse"),
    ):
        pass


def test_a_silent_coarse_layer_delays_the_start_by_seconds_only(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Not by the minute that the first segment may take; the segments of the stream itself are played."""
    assert live_client._COARSE_WAIT_S <= 5
    monkeypatch.setattr(live_client, "_COARSE_WAIT_S", 0.1)
    notes, port, began = list[str](), free_port(), time.monotonic()
    with (
        OnAir(port),
        open_stream(f"udp://127.0.0.1:{port}", notes.append, f"udp://127.0.0.1:{free_port()}") as stream,
    ):
        assert stream.medium[0].support_count and time.monotonic() - began < 20
    assert any("without its coarse layer" in note and "nothing in time" in note for note in notes), notes


def test_an_invalid_coarse_address_is_an_error() -> None:
    with (
        OnAir() as air,
        pytest.raises(InvalidArgument, match="coarse: found 'here'"),
        open_stream(f"ws://{air.server.address}/live", coarse="udp://here"),
    ):
        pass

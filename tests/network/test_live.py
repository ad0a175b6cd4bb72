"""The core of live streams without sockets: messages in, events out, for any input."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, precondition, rule

from live_makers import HEAD, segment, sender_of
from touchfield.container.records import Vibration
from touchfield.container.wire import encode_record
from touchfield.container.writer import opening_of
from touchfield.errors import InvalidArgument
from touchfield.network import live
from touchfield.network.live import (  # fmt: skip
    END,
    ENDLESS,
    Ended,
    LiveReceiver,
    LiveSegment,
    LiveSender,
    Lost,
    Opened,
    Refused,
    _parse_opening,
)


def test_messages_decode_to_events() -> None:
    _, messages = sender_of(3)
    receiver = LiveReceiver()
    opened, *events = [event for message in [*messages, END] for event in receiver.receive(message)]
    assert isinstance(opened, Opened) and opened.head == replace(HEAD, frame_count=ENDLESS)
    assert opened.provenance["source"] == "test" and events == [*(segment(5 * i) for i in range(3)), Ended()]
    assert [type(e) for e in receiver.receive(messages[1])] == [Refused]


def test_a_lost_late_repeated_or_damaged_message_loses_only_itself() -> None:
    _, (opening, *segments) = sender_of(6)
    receiver = LiveReceiver()
    assert isinstance(receiver.receive(segments[0])[0], Refused)  # no opening yet
    assert isinstance(receiver.receive(opening)[0], Opened) and receiver.receive(opening) == []
    assert receiver.receive(segments[0]) == [segment(0)]
    assert isinstance(receiver.receive(segments[0])[0], Refused)
    assert receiver.receive(segments[2]) == [Lost(5, 5), segment(10)]
    assert "late" in receiver.receive(segments[1])[0].reason  # type: ignore[union-attr]
    half = sender_of(1)[0].add(replace(segment(0), first_frame=14))  # one of its frames has been played
    assert "late" in receiver.receive(half)[0].reason  # type: ignore[union-attr]
    damaged = bytearray(segments[3])
    damaged[40] ^= 1
    assert isinstance(receiver.receive(bytes(damaged))[0], Refused)
    assert receiver.receive(segments[4]) == [Lost(15, 5), segment(20)]
    for garbage in (
        b"x",
        segments[5][:-1],
        segments[5] + b"x",
        opening[:-3],
        opening + segments[5],
        bytes(100),
    ):
        assert [type(e) for e in receiver.receive(garbage)] == [Refused]
    assert receiver.receive(segments[5]) == [segment(25)]


def test_a_vibration_of_other_frames_is_refused() -> None:
    sender, (opening,) = sender_of(0)
    message = sender.add(replace(segment(0), vibration=b"beside"))
    receiver = LiveReceiver()
    receiver.receive(opening)
    for first, count in ((0, 4), (1, 5)):
        other = encode_record("VIBR", Vibration(first_frame=first, frame_count=count, body=b"beside"))
        (refused,) = receiver.receive(other + message[len(other) :])
        assert isinstance(refused, Refused) and "VIBR of other frames" in refused.reason
    assert receiver.receive(message) == [replace(segment(0), vibration=b"beside")]


def test_stored_streams_and_too_long_messages_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    sender, messages = sender_of(1)
    file = b"".join(opening_of(replace(HEAD, frame_count=500), {}))
    (refused,) = LiveReceiver().receive(file)
    assert isinstance(refused, Refused) and "HEAD.frame_count: found 500" in refused.reason
    with pytest.raises(InvalidArgument, match="a second call"):
        sender.open(HEAD)
    with pytest.raises(InvalidArgument, match="frames from 4; expected 5 or later"):
        sender.add(replace(segment(0), first_frame=4))
    receiver, following = LiveReceiver(), replace(segment(0), first_frame=5)
    receiver.receive(messages[0])
    monkeypatch.setattr(live, "MAX_BYTES", len(messages[1]))
    with pytest.raises(InvalidArgument, match="shorter segments"):
        sender.add(replace(following, vibration=b""))
    assert receiver.receive(messages[1]) == [segment(0)] and receiver.receive(sender.add(following)) == [
        following
    ]
    monkeypatch.setattr(live, "MAX_BYTES", len(messages[1]) - 1)
    (refused,) = LiveReceiver().receive(messages[0])
    assert isinstance(refused, Refused) and "bytes; expected at most" in refused.reason


def test_a_restarted_sender_begins_a_new_programme() -> None:
    (_, before), (sender, again) = sender_of(4), sender_of(2)
    retold = LiveSender()
    retold.open(HEAD, {"source": "test", "programme": _parse_opening(sender.opening).provenance["programme"]})
    assert retold.opening != sender.opening, "a live stream that is sent on is another programme"
    receiver = LiveReceiver()
    for message in before:
        receiver.receive(message)
    events = [
        event for message in (again[0], again[1], again[0], again[2]) for event in receiver.receive(message)
    ]
    assert isinstance(events[0], Opened) and events[1:] == [segment(0), segment(5)]


@settings(max_examples=200, deadline=None)
@given(
    st.lists(st.one_of(st.binary(max_size=200), st.integers(0, 6).map(lambda i: _MESSAGES[i])), max_size=12)
)
def test_any_message_is_an_event_and_no_error(messages: list[bytes]) -> None:
    receiver = LiveReceiver()
    for message in messages:
        for event in receiver.receive(message):
            assert isinstance(event, Opened | LiveSegment | Lost | Refused | Ended)


_MESSAGES = [*sender_of(5)[1], END]


class Broadcast(RuleBasedStateMachine):
    """Receivers join and read at different speeds: each gets its segments in order; queues stay short."""

    def __init__(self) -> None:
        super().__init__()
        self.sender, self.bodies = LiveSender(), 0
        self.sender.open(HEAD)
        self.receivers: dict[int, tuple[object, LiveReceiver, list[int]]] = {}
        self.is_over = False

    @precondition(lambda self: not self.is_over)
    @rule(gap=st.sampled_from([0, 0, 0, 5]))
    def send(self, gap: int) -> None:
        self.bodies += gap
        self.sender.add(LiveSegment(self.bodies, 5, b"body"))
        self.bodies += 5

    @precondition(lambda self: len(self.receivers) < 4)
    @rule()
    def join(self) -> None:
        self.receivers[len(self.receivers)] = (self.sender.joined(), LiveReceiver(), [])

    @precondition(lambda self: self.receivers)
    @rule(pick=st.integers(0, 3), count=st.integers(1, 6))
    def read(self, pick: int, count: int) -> None:
        subscriber, receiver, received = self.receivers[pick % len(self.receivers)]
        for _ in range(count):
            message = self.sender.next(subscriber)  # type: ignore[arg-type]
            if message is None:
                break
            for event in receiver.receive(message):
                assert not isinstance(event, Refused)
                if isinstance(event, LiveSegment):
                    received.append(event.first_frame)

    @precondition(lambda self: not self.is_over)
    @rule()
    def end(self) -> None:
        self.sender.end()
        self.is_over = True
        with pytest.raises(InvalidArgument):
            self.sender.add(LiveSegment(self.bodies, 5, b"body"))

    @invariant()
    def in_order_and_bounded(self) -> None:
        for subscriber, _, received in self.receivers.values():
            assert received == sorted(set(received))
            assert subscriber.skipped + len(received) <= self.bodies // 5 + 1  # type: ignore[attr-defined]
        assert len(self.sender.manifest()["segments"]) <= 4


TestBroadcast = Broadcast.TestCase

TestBroadcast.settings = settings(max_examples=60, stateful_step_count=30, deadline=None)


def test_a_late_receiver_begins_with_the_newest_segment() -> None:
    sender, (opening, *_, newest) = sender_of(3)
    receiver = sender.joined()
    assert [sender.next(receiver) for _ in range(3)] == [opening, newest, None] and receiver.skipped == 0


def test_a_slow_receiver_skips_to_the_newest_segment() -> None:
    sender, _ = sender_of(1)
    slow = sender.joined()
    assert sender.next(slow) == sender.opening
    for i in range(1, 20):
        sender.add(segment(5 * i))
    receiver = LiveReceiver()
    receiver.receive(sender.opening)
    message = sender.next(slow)
    assert message is not None and receiver.receive(message) == [segment(95)] and slow.skipped == 19
    assert sender.next(slow) is None
    entry = {"number": 19, "first_frame": 95, "frames": 5, "bytes": len(message)}
    assert (
        sender.manifest()["segments"][-1] == entry
        and sender.message(19) == message
        and sender.message(15) is None
    )

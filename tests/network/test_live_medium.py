"""A live stream played as a medium: frames that arrive, are lost or late, and clocks that jump."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np
import pytest
from tests.network.test_layers import COARSE, UNDER_HEAD

from live_makers import GRID, HEAD, Hand, field, segment
from touchfield.codec.touch.body import BodyReader, write_body
from touchfield.codec.vibration import encode_vibration
from touchfield.errors import SourceError, UnsupportedVersion
from touchfield.medium.medium import VibrationFrame
from touchfield.network.live import ENDLESS, Ended, LiveSegment, Lost, Opened, Refused  # fmt: skip
from touchfield.network.live_medium import LiveEnd, LiveFrames, LiveStream


def frames_of(*events: LiveSegment | Lost) -> LiveFrames:
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}))
    for event in events:
        frames.take(event)
    return frames


def test_sent_frames_are_played_and_lost_ones_are_empty() -> None:
    frames = frames_of(segment(10), Lost(15, 5), segment(20))
    for i in (0, 4, 10, 14):
        np.testing.assert_allclose(frames(i).to_dense(), field(10 + i).to_dense(), atol=0.2)
    assert not frames(7).support_count and frames.lost == 5
    assert frames.is_there(14) and not frames.is_there(15)


def test_seams_are_where_segments_start_and_frames_are_missing() -> None:
    frames = frames_of(segment(10), segment(15), Lost(20, 5), segment(25))
    seams = []
    for i in range(20):
        frames(i), frames(i)  # a second query changes nothing
        seams += [i] if frames.is_seam(i) else []
    assert seams == [0, 5, 10, 15]
    assert not frames.is_seam(15), "only the latest frame is known"


def test_vibration_belongs_to_its_frame_and_useless_messages_are_counted() -> None:
    index, unit = np.zeros((1, 3), np.int32), np.ones(1, np.float32)
    bands = [VibrationFrame(GRID, index + i, unit, (90 + i) * unit) for i in range(5)]
    frames = frames_of(segment(0))
    assert not frames.vibrates and LiveStream("live", frames).medium.vibration is None
    frames.take(replace(segment(5), vibration=encode_vibration(bands)))
    assert frames.vibrates and LiveStream("live", frames).medium.vibration == frames.vibration
    assert [len(frames.vibration(i)) for i in (0, 4)] == [0, 0]
    assert [frames.vibration(5 + i).frequencies_hz.tolist() for i in (4, 0)] == [[94], [90]]
    for _ in range(3):
        frames.take(Refused("no segment"))
    assert frames.refused == 3


def test_a_lagging_player_continues_with_the_newest_frames() -> None:
    notes: list[str] = []
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}), notes.append)
    for i in range(8):
        frames.take(segment(5 * i))
    np.testing.assert_allclose(frames(3).to_dense(), field(35).to_dense(), atol=0.2)
    assert frames.skipped == 32 and frames.stream_frame(3) == 35 and "behind" in notes[0]


@pytest.mark.parametrize("start_s", [-1.5, -0.2, 0.0, 0.2, 4.0])
def test_play_stays_at_the_due_frame(start_s: float) -> None:
    """Segments of a tenth of a second arrive up to 30 ms late; soon the lag behind the latest is small."""
    now, rng = [0.0], np.random.default_rng(4)
    opened = Opened(replace(HEAD, frame_count=ENDLESS), {})
    frames = LiveFrames(opened, clock_s=lambda: now[0])
    live, hand, waits, skipped = LiveStream("live", frames), Hand(start_s), 0, 0
    late, sent = rng.uniform(0, 0.03, 60), 0
    bodies = [segment(5 * i) for i in range(12)]
    for step in range(500):
        now[0] = 0.01 * step
        while now[0] >= 0.1 * sent + late[sent]:
            frames.take(replace(bodies[sent % 12], first_frame=5 * sent))
            sent += 1
        if step % 10 == 0:
            before = hand.media_s
            went = live.keep_up(hand)
            assert (went and hand.speed == 1) or (hand.media_s == before and 0.9 <= hand.speed <= 1.1)
            skipped += max(0, round(50 * (hand.media_s - before)))
        if step > 300:
            waits += hand.media_s * 50 > 5 * sent
            assert -0.06 < now[0] - hand.media_s < 0.08
        hand.media_s += 0.01 * hand.speed
    assert waits == 0 and frames.skipped == skipped


@pytest.mark.parametrize("join_s", [0.005, 0.1, 0.245])
@pytest.mark.parametrize("open_s", [0.0, 1.3])
def test_the_delay_has_settled_after_a_second(join_s: float, open_s: float) -> None:
    """A receiver that joins gets a segment that was sent up to its length ago, and is busy while its device
    opens: neither delay stays. Segments of a quarter of a second arrive up to 20 ms late.
    """
    now, rng = 0.0, np.random.default_rng(5)
    rate_hz, length_s, seeks = 20.0, 0.25, 0
    opened = Opened(replace(HEAD, rate_hz=rate_hz, frame_count=ENDLESS), {})
    frames = LiveFrames(opened, clock_s=lambda: now)
    live, hand, bodies = LiveStream("live", frames), Hand(0.0), [segment(5 * i) for i in range(12)]
    now, sent, late = 4.0 + join_s, 16, rng.uniform(0, 0.02, 100)
    frames.take(replace(bodies[3], first_frame=75))
    start_s = now + open_s
    for step in range(500):
        now = 4.0 + join_s + 0.01 * step
        is_busy = now < start_s
        while now >= length_s * (sent + 1) + late[sent] + 0.2 * is_busy:
            frames.take(replace(bodies[sent % 12], first_frame=5 * sent))
            sent += 1
        if not is_busy and step % 5 == 0:
            seeks += live.keep_up(hand)
            base = frames.stream_frame(0)
            assert base is not None
            delay_s = now - base / rate_hz - hand.media_s - length_s
            assert now < start_s + 1.0 or -1e-9 < delay_s < 0.1, (now, delay_s)
        hand.media_s += 0.01 * hand.speed * (not is_busy)
    assert seeks <= 3


@pytest.mark.parametrize(("receiver_s", "sender_s"), [(1000.0, 0.0), (0.0, 60.0), (-300.0, 0.0)])
def test_a_clock_that_jumps_is_followed(receiver_s: float, sender_s: float) -> None:
    """The clock of the receiver or the sender jumps after two seconds; half a second later play has
    recovered.
    """
    now, sent = 0.0, 0
    frames = LiveFrames(
        Opened(replace(HEAD, frame_count=ENDLESS), {}), clock_s=lambda: now + receiver_s * (now >= 2)
    )
    live, hand = LiveStream("live", frames), Hand(0.0)
    bodies = [segment(5 * i) for i in range(12)]
    for step in range(500):
        now = 0.01 * step
        while now >= 0.1 * (sent + 1):
            skipped = round(sender_s * 50) * (now >= 2)
            frames.take(replace(bodies[sent % 12], first_frame=5 * sent + skipped))
            sent += 1
        if step % 10 == 0:
            live.keep_up(hand)
        if step > 260 or 150 < step < 199:
            assert -0.02 < now + sender_s * (now >= 2) - hand.media_s - 0.1 < 0.1
            assert frames.is_there(int(hand.media_s * 50))
        hand.media_s += 0.01 * hand.speed


def test_an_undecodable_segment_loses_only_itself() -> None:
    bad = LiveSegment(5, 5, b"\0" * 50)
    frames = frames_of(segment(0), bad, segment(10))
    assert frames.lost == 5 and not frames(5).support_count and frames(10).support_count
    original = segment(5)
    reader = BodyReader(original.body, GRID, exact=False)
    records = reader.records(5)
    records[3] = replace(
        records[3], payload=records[3].payload + bytes(99)
    )  # the records before it can be decoded
    frames = frames_of(
        segment(0), replace(original, body=write_body(reader.lattice, records, reader.max_error)), segment(10)
    )
    assert [i for i in range(5, 11) if not frames(i).support_count] == [8, 9] and frames.lost == 2


def test_fewer_large_segments_are_stored_but_at_least_one(monkeypatch: pytest.MonkeyPatch) -> None:
    size = sum(frames_of(segment(5))(i).forces_n.nbytes for i in range(5))
    for max_bytes, oldest in ((1, 25), (2 * size, 20), (1 << 30, 10)):
        monkeypatch.setattr("touchfield.network.live_medium.MAX_BYTES", max_bytes)
        frames = frames_of(*(replace(segment(5), first_frame=5 * i) for i in range(6)))
        assert frames(oldest).support_count and frames.skipped == 0
        assert frames(oldest - 1).support_count and frames.skipped == 26 - oldest


@pytest.mark.parametrize("is_layered", [False, True])
def test_another_programme_continues_after_the_previous_one(is_layered: bool) -> None:
    opened = Opened(replace(HEAD, frame_count=ENDLESS), {})
    now = [2.2]
    under = LiveFrames(Opened(UNDER_HEAD, {}), clock_s=lambda: now[0]) if is_layered else None
    frames = LiveFrames(opened, clock_s=lambda: now[0], coarse=under)
    frames.take(segment(100))
    frames.take(segment(105))
    if under is not None:
        under.take(COARSE[5])  # its numbers are useless after those of the other programme
    frames.start_programme()
    assert frames(9).support_count and not frames.is_there(10)  # the frames stay until more arrive
    now[0] = 5.0
    frames.take(segment(0))
    for i in range(5):
        np.testing.assert_allclose(frames(10 + i).to_dense(), field(i).to_dense(), atol=0.2)
    assert frames.stream_frame(10) == 0 and not frames.is_there(15)
    now[0] = 5.1
    assert frames.due_s(50) == pytest.approx(0.27) and frames.skipped == 0


def test_the_end_and_silence_are_reported() -> None:
    frames = frames_of(segment(0))
    with pytest.raises(SourceError, match="far ahead"):
        frames(100_000)
    frames.take(Ended())
    assert frames(4).support_count and frames.is_there(5)
    frames.fail(SourceError("a connection", "its end behind that"))
    with pytest.raises(LiveEnd):
        frames(5)


def test_play_waits_for_a_frame_that_is_due_and_objects_are_not_live() -> None:
    frames, next_segment = frames_of(segment(0)), segment(5)
    threading.Timer(0.02, frames.take, [next_segment]).start()
    assert frames(9).support_count
    with pytest.raises(UnsupportedVersion, match="coder objects; expected a coder of fields"):
        LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS, coder="objects"), {}))


@pytest.mark.parametrize("length", [5, 60])
def test_silence_is_reported_once_and_ends_after_a_minute(length: int) -> None:
    now, notes, usual_s = [0.0], list[str](), length / 50
    frames = LiveFrames(Opened(replace(HEAD, frame_count=ENDLESS), {}), notes.append, clock_s=lambda: now[0])
    now[0] = 61.0
    assert frames.is_there(0) and notes.pop(), "to be told that no first one has come"
    now[0] = 100.0
    frames.take(segment(0, length))
    for silent_s in (0.0, usual_s + 2.9, usual_s + 3.1, 40.0, 59.0):
        now[0] = 100.0 + silent_s
        assert not frames.is_there(length) and len(notes) == (silent_s > usual_s + 3)
    frames.take(replace(segment(0, length), first_frame=length))
    assert frames.is_there(length) and not frames.is_there(2 * length)
    assert notes.pop() == "segments come again, after 59 s"
    now[0] = 218.0
    assert not frames.is_there(2 * length) and len(notes) == 2
    now[0] = 220.0
    assert frames.is_there(2 * length)
    with pytest.raises(SourceError, match="no segment for 60 s"):
        frames(2 * length)

"""Datagrams: what a network loses, bursts, repeats, mixes up, damages or forges, and what comes out all the
same.
"""

from __future__ import annotations

import asyncio
import socket
import struct
import threading
import time
import zlib
from contextlib import suppress
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from touchfield.errors import InvalidArgument
from touchfield.network.live import Ended, LiveReceiver, LiveSegment, LiveSender, Lost, Opened

pytest.importorskip("raptorq", reason="datagrams need the extra broadcast")
from live_makers import HEAD, field, segment, sender_of
from touchfield.network import datagrams as datagrams_module, udp
from touchfield.network.datagrams import MAX_DATAGRAM, Datagrams, Gathering
from touchfield.network.live_client import open_live
from touchfield.network.udp import UdpSender, _parse_address, listen

MESSAGES = [
    np.random.default_rng(i).bytes(n) for i, n in enumerate((300, 40_000, 1, 5_000, 70_000, 128, 12_345, 20))
]


def sent(messages: list[bytes]) -> list[bytes]:
    datagrams = Datagrams(7)
    return [one for message in messages for one in datagrams.add(message)] + datagrams.flush()


def received(datagrams: list[bytes]) -> tuple[list[bytes], Gathering]:
    gathering = Gathering()
    return [message for one in datagrams for message in gathering.receive(one)], gathering


def test_without_loss_all_comes_in_order() -> None:
    out, gathering = received(sent(MESSAGES))
    assert out == MESSAGES and gathering.lost == gathering.refused == 0
    assert max(map(len, sent(MESSAGES))) <= MAX_DATAGRAM


@pytest.mark.parametrize("burst", [1.0, 5.0])
def test_five_per_cent_of_losses_cost_hardly_a_message(burst: float) -> None:
    """Seeded; losses alone, and in bursts of five (Gilbert); at most 30 % more bytes than the messages."""
    rng = np.random.default_rng(8)
    messages = [rng.bytes(48_000) for _ in range(20)] * 20
    datagrams = sent(messages)
    kept, is_bad = [], False
    for one in datagrams:
        is_bad = rng.random() > 1 / burst if is_bad else rng.random() < 0.05 / (0.95 * burst)
        kept += [] if is_bad else [one]
    assert 0.93 < len(kept) / len(datagrams) < 0.97
    out, gathering = received(kept)
    assert len(out) >= 0.995 * len(messages) and gathering.lost == len(messages) - len(out)
    assert sum(map(len, datagrams)) < 1.3 * sum(map(len, messages))


def test_repeated_mixed_up_damaged_and_foreign_datagrams() -> None:
    rng = np.random.default_rng(1)
    own = sent(MESSAGES)
    mixed = [own[i] for i in np.argsort(np.arange(len(own)) + rng.uniform(0, 12, len(own)))]
    bad = [bytes(b ^ (i == len(one) // 2) for i, b in enumerate(one)) for one in own[::7]]
    foreign = Datagrams(8).add(MESSAGES[1])
    gathering = Gathering()
    out = [m for one in (*bad, mixed[0], *foreign, *mixed[1:], *own[::3]) for m in gathering.receive(one)]
    assert (
        len(out) >= 7 and out == MESSAGES[-len(out) :] and gathering.refused >= len(bad) + len(foreign) > 20
    )


def test_a_sender_that_is_started_again_takes_the_place_of_the_one_before() -> None:
    """Once that one has been silent for two seconds; pieces of its opening are not taken for the other's."""
    now, (_, before), (_, again) = [0.0], sender_of(2), sender_of(3)
    first, second, gathering = Datagrams(7), Datagrams(8), Gathering(clock_s=lambda: now[0])
    out = [whole for m in before for one in first.add(m) for whole in gathering.receive(one)]
    now[0] = 1.9
    assert not any(gathering.receive(one) for one in Datagrams(9).add(again[0])) and gathering.refused
    assert out == before[: len(out)] and out
    now[0] = 4.0
    assert [
        whole
        for one in [*(one for m in again for one in second.add(m)), *second.flush()]
        for whole in gathering.receive(one)
    ] == again


def test_an_opening_that_is_told_again_holds_up_no_short_segment() -> None:
    """One datagram of it is enough; another message of its length is not taken for it."""
    sender = LiveSender()
    sender.open(HEAD, {"source": "".join(map(str, range(300)))})
    opening = sender.opening
    datagrams, gathering, out, late = Datagrams(7), Gathering(), list[bytes](), list[int]()
    messages = [
        opening,
        *(bytes([i]) * 200 for i in range(20)),
        opening,
        *(bytes([i]) * 200 for i in range(20, 28)),
    ]
    for message in messages:
        out += [whole for one in datagrams.add(message) for whole in gathering.receive(one)]
        late.append(len(late) + 1 - len(out))
    assert max(late[12:]) <= 1 < late[3], "the first opening takes its time"
    other = bytes(len(opening))
    out += [
        whole
        for part in (datagrams.add(other), datagrams.flush())
        for one in part
        for whole in gathering.receive(one)
    ]
    assert out == [*messages, other] and gathering.lost == 0


def test_what_is_lost_is_counted_and_the_rest_goes_on() -> None:
    numbered = [
        (int.from_bytes(one[6:10], "little"), one) for one in sent([bytes([i]) * 3000 for i in range(60)])
    ]
    out, gathering = received([one for number, one in numbered if number not in (5, 6, 30)])
    assert [m[0] for m in out] == [i for i in range(60) if i not in (5, 6, 30)] and gathering.lost == 3
    silence = [one for number, one in numbered if number == 0 or number >= 36]
    out, gathering = received(silence)
    assert [m[0] for m in out] == [0, *range(36, 60)] and gathering.lost == 35


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=300), st.integers(0, 400)), max_size=60))
def test_whatever_comes_nothing_is_raised(coming: list[bytes | int]) -> None:
    own = sent(MESSAGES[:4])
    gathering = Gathering()
    out = [
        m for one in coming for m in gathering.receive(one if isinstance(one, bytes) else own[one % len(own)])
    ]
    assert all(m in MESSAGES for m in out)


def test_a_forged_number_of_a_block_or_size_of_a_symbol_is_refused() -> None:
    """RaptorQ's decoder would end the thread that receives."""
    head = struct.Struct("<2sIIIHI")
    for block, symbol in ((1, 128), (255, 1152), (0, 8)):
        forged = bytes([block, 0, 0, 0]) + bytes(symbol)
        told = (b"TF", 7, 0, 4096, symbol)
        crc = zlib.crc32(forged, zlib.crc32(head.pack(*told, 0)))
        gathering = Gathering()
        assert gathering.receive(head.pack(*told, crc) + forged) == [] and gathering.refused == 1


def test_no_more_datagrams_of_a_message_are_looked_at_than_it_can_need() -> None:
    gathering, first = Gathering(), Datagrams(7).add(bytes(100_000))[0]
    for _ in range(1000):
        assert gathering.receive(first) == []
    assert 600 < gathering.refused < 1000


@pytest.mark.parametrize("repair", [-0.1, 4.1, float("nan")])
def test_repair_that_cannot_be(repair: float) -> None:
    with pytest.raises(InvalidArgument, match="repair"):
        Datagrams(1, repair)


def numbered(number: int, stream: int = 7) -> bytes:
    """A datagram that has all of a message, which is the stream and the number."""
    datagrams = Datagrams(stream)
    datagrams._number = number
    return datagrams.add(b"%d.%d" % (stream, number))[0]


def test_numbers_that_are_near_enough() -> None:
    """At most eight above the newest, and 24 below; the number after the last is 0."""
    gathering = Gathering()
    assert gathering.receive(numbered(0)) == [b"7.0"]
    assert gathering.receive(numbered(8)) == [] and gathering.refused == 0, "those between are waited for"
    assert gathering.receive(numbered(17)) == [] and gathering.refused == 1
    assert gathering.receive(numbered(16)) == gathering.receive(numbered(24)) == [] and gathering.lost == 0
    assert gathering.receive(numbered(0)) == [] and gathering.refused == 1, "late, and no more than that"
    assert gathering.receive(numbered(25)) == [] and gathering.lost == 1, "24 are waited for, from 2 on"
    last = Datagrams(7)
    last._number = (1 << 32) - 1
    assert len(last.add(b"x")) == 1 and len(last.add(b"y")) == 2 and last._number == 1
    assert len(sent([b"x"])) == 4, "of one symbol, and three of repair"


def test_messages_of_a_length_that_cannot_be(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datagrams_module, "MAX_BYTES", 3000)
    for message in (b"", bytes(3001)):
        with pytest.raises(InvalidArgument, match="bytes; expected 1 to 3000"):
            Datagrams(7).add(message)
    twice = [one for one in sent([bytes(3000)]) for _ in range(2)]
    assert received(twice)[0] == [bytes(3000)], "what a network repeats is not too much"
    monkeypatch.setattr(datagrams_module, "MAX_BYTES", 2999)
    assert received(twice)[1].refused == len(twice)


def test_two_datagrams_bear_out_another_stream_once_the_first_is_silent() -> None:
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0])

    def at(time_s: float, *coming: bytes) -> list[bytes]:
        now[0] = time_s
        return [message for one in coming for message in gathering.receive(one)]

    assert at(0.0, numbered(0)) == [b"7.0"] and at(1.5, numbered(8)) == []
    assert at(3.5, numbered(5, 8), numbered(6, 8)) == [], "no more than two seconds of silence"
    assert at(3.6, numbered(5, 9)) == [], "of two streams, one each"
    assert at(3.6, numbered(14, 9), numbered(14, 9)) == [], "one too far off, and the same again"
    assert gathering.refused == 5 and at(3.6, numbered(6, 9)) == [b"9.6"], "it goes on from the lower number"
    assert at(3.7, numbered(0, 11), numbered(1, 11)) == [], "nor is this one silent"
    assert at(3.8, *(numbered(number, 9) for number in range(7, 14))) == [b"9.%d" % n for n in range(7, 15)]


@pytest.mark.parametrize(
    "text", ["", "host", "host:", ":9", "host:0", "host:99999", "host:x", "a..b:9", f"{'x' * 64}:9"]
)
def test_addresses_that_are_none(text: str) -> None:
    with pytest.raises(InvalidArgument, match="a host and a port from 1 to 65535"):
        _parse_address(text)
    assert (
        _parse_address(f"udp://[::1]:{1}/") == ("::1", 1)
        and _parse_address("HOST.example.:65535")[0] == "host.example."
    )


def free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        port: int = link.getsockname()[1]
        return port


def lossy(to: int, share: float, done: threading.Event) -> int:
    """The port of a relay that loses a share of what it gets, repeats some, and damages some."""
    link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    link.bind(("127.0.0.1", 0))
    link.settimeout(0.05)
    rng = np.random.default_rng(6)

    def run() -> None:
        with link:
            while not done.is_set():
                with suppress(TimeoutError):
                    data = link.recv(4096)
                    chance = rng.random()
                    if chance < share:
                        continue
                    if chance > 0.98:
                        link.sendto(data[:-1] + b"x", ("127.0.0.1", to))
                    for _ in range(1 + (chance > 0.95)):
                        link.sendto(data, ("127.0.0.1", to))

    threading.Thread(target=run, daemon=True).start()
    port: int = link.getsockname()[1]
    return port


def test_a_hand_feels_what_is_live_through_a_network_that_loses() -> None:
    done, port, notes = threading.Event(), free_port(), list[str]()
    relay = lossy(port, 0.05, done)
    sender, _ = sender_of(0)

    def send() -> None:
        with UdpSender(sender, f"127.0.0.1:{relay}") as link:
            for i in range(60):
                link.add(sender.add(segment(5 * i)))
                if done.wait(0.05):
                    return

    thread = threading.Thread(target=send, daemon=True)
    with suppress(Exception):
        thread.start()
    time.sleep(0.1)
    with open_live(f"udp://127.0.0.1:{port}", notes.append) as live:
        begins = live.frames.stream_frame(0)
        assert begins is not None
        felt = [live.medium[i] for i in range(60)]
    done.set()
    thread.join()
    shown = [i for i, one in enumerate(felt) if one.support_count]
    assert len(shown) >= 50
    jumped = live.frames.skipped
    for i in shown if not jumped else ():
        np.testing.assert_allclose(felt[i].to_dense(), field(begins + i).to_dense(), atol=0.2)


def test_the_opening_is_told_again_before_every_fourth_segment() -> None:
    sender, (opening, *told) = sender_of(9)
    gathering, out = Gathering(), list[bytes]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(5)
        with UdpSender(sender, f"udp://127.0.0.1:{link.getsockname()[1]}/") as sending:
            for message in told:
                sending.add(message)
        while b"\0" not in out:
            out += gathering.receive(link.recv(2048))
    assert out == [opening, *told[:4], opening, *told[4:8], opening, told[8], b"\0"]


@pytest.mark.parametrize(("layer", "count"), [("alone", 44), ("fine", 41), ("coarse", 50)])
def test_a_layer_has_its_share_of_parity_and_its_port(layer: udp.Layer, count: int) -> None:
    """36 pieces of a thousand bytes, which all have come once the sender has ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.setblocking(False)
        port = link.getsockname()[1] - (layer == "coarse")
        with UdpSender(sender_of(0)[0], f"127.0.0.1:{port}", layer) as sending:
            sending.add(bytes(36_000))
        coming = list[bytes]()
        with suppress(BlockingIOError):
            while True:
                coming.append(link.recv(2048))
    assert sum(len(one) > 1000 for one in coming) == count


def test_messages_of_a_whole_stream_by_datagrams() -> None:
    sender, messages = sender_of(9)
    assert isinstance(sender, LiveSender)
    out, _ = received(sent(messages))
    receiver = LiveReceiver()
    events = [event for message in out for event in receiver.receive(message)]
    assert isinstance(events[0], Opened) and not any(isinstance(e, Lost | Ended) for e in events)
    assert sum(isinstance(e, LiveSegment) for e in events) == 9


FORGED = {
    "a near number": (7, 5), "the next number": (7, 21), "a far number": (7, 100),
    "the farthest number": (7, 2**32 - 1), "a number before all": (7, 0), "another stream": (9, 20),
}  # fmt: skip


@pytest.mark.parametrize("claim", FORGED)
@pytest.mark.parametrize("length", [1, 3000, 1 << 26])
@pytest.mark.parametrize("place", [0, 1, 100])
def test_one_forged_datagram_costs_one_message_at_most(claim: str, length: int, place: int) -> None:
    """Told twice by the network; where it is the first of all, a window. Numbers of the messages begin
    at 101.
    """
    own, forger, messages = Datagrams(7), Datagrams(FORGED[claim][0]), [bytes([i]) * 3000 for i in range(60)]
    own._number, forger._number = 100, 100 + FORGED[claim][1] & 0xFFFFFFFF
    forger._number = forger._number if FORGED[claim][1] else 0
    datagrams = [one for message in messages for one in own.add(message)] + own.flush()
    head = struct.Struct("<2sIIIHI")
    told, packet = (b"TF", forger._stream, forger._number, length, 1152), bytes(4 + 1152)
    forged = head.pack(*told, zlib.crc32(packet, zlib.crc32(head.pack(*told, 0)))) + packet
    now, out = [0.0], list[bytes]()
    gathering = Gathering(clock_s=lambda: now[0])
    for one in (*datagrams[:place], forged, forged, *datagrams[place:]):
        now[0] += 0.01
        out += gathering.receive(one)
    rest = [message for message in messages if message in out]
    assert [message for message in out if message in messages] == rest
    assert len(rest) >= (59 if place or claim.startswith(("a far", "the far")) else 60 - 24)


def test_a_forged_opening_or_segment_far_off_is_not_believed() -> None:
    """Each in one datagram, as whole as any."""
    _, (opening, *segments) = sender_of(9)
    other = LiveSender()
    other.open(HEAD)
    for forged in (
        other.opening,
        sender_of(0)[0].add(LiveSegment(1 << 30, 5, b"")),
        sender_of(0)[0].add(LiveSegment(25, 4096, b"")),
    ):
        datagrams, receiver = Datagrams(7), LiveReceiver(is_open=True)
        messages = [opening, *segments[:5], forged, *segments[5:]]
        sent_all = [one for message in messages for one in datagrams.add(message)] + datagrams.flush()
        out, _ = received(sent_all)
        events = [event for message in out for event in receiver.receive(message)]
        assert [e.first_frame for e in events if isinstance(e, LiveSegment)] == [5 * i for i in range(9)]
        assert sum(isinstance(e, Opened) for e in events) == 1 and not any(
            isinstance(e, Lost) for e in events
        )


def test_after_a_long_outage_the_second_segment_bears_out_the_first() -> None:
    _, (opening, *segments) = sender_of(40)
    receiver = LiveReceiver(is_open=True)
    events = [
        event for message in (opening, *segments[:2], segments[30]) for event in receiver.receive(message)
    ]
    assert events[1:] == [segment(0), segment(5)]
    assert receiver.receive(segments[31]) == [Lost(10, 140), segment(150), segment(155)]
    assert receiver.receive(segments[33]) == [Lost(160, 5), segment(165)]
    far, farther = (replace(segment(0), first_frame=first) for first in (5000, 9000))
    sender = sender_of(0)[0]
    messages = [sender.add(one) for one in (far, farther)]
    assert receiver.receive(messages[0]) == []
    assert receiver.receive(segments[34]) == [segment(170)]  # which clears the doubt
    assert receiver.receive(messages[1]) == []
    other = sender_of(9)[1]
    events = [event for message in (*other[:2], messages[1]) for event in receiver.receive(message)]
    assert [type(event) for event in events] == [Opened, LiveSegment]
    assert receiver.receive(other[9]) == [Lost(5, 35), segment(40)], "no more than eight segments ahead"


def test_the_end_is_told_by_datagrams_too_and_is_none_where_more_follows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(udp, "_LAST_S", 1.6)
    port, sender, taken = free_port(), sender_of(0)[0], list[bytes]()
    first, second = (sender.add(segment(5 * i)) for i in range(2))

    def send() -> None:
        with UdpSender(sender, f"127.0.0.1:{port}") as link:
            link.add(first)
            link.__exit__()
            time.sleep(0.1)
            link._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.add(second)

    def take(message: bytes) -> bool:
        taken.append(message)
        return message == b""

    async def received_all() -> None:
        await asyncio.wait_for(listen(f"udp://127.0.0.1:{port}", take), 20)
        await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.bind(("127.0.0.1", port))  # which is free again

    threading.Timer(0.3, send).start()
    asyncio.run(received_all())
    assert taken == [sender.opening, first, second, b""]

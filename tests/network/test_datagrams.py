"""Datagrams through a network that loses, repeats, reorders, damages or forges them, and what is received."""

from __future__ import annotations

import asyncio
import hashlib
import hmac
import re
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

from touchfield.cli.main import _exit_code
from touchfield.container.records import MAGIC
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
    return [datagram for message in messages for datagram in datagrams.add(message)] + datagrams.flush()


def received(datagrams: list[bytes]) -> tuple[list[bytes], Gathering]:
    gathering = Gathering()
    return [message for datagram in datagrams for message in gathering.receive(datagram)], gathering


def test_without_loss_all_messages_arrive_in_order() -> None:
    out, gathering = received(sent(MESSAGES))
    assert out == MESSAGES and gathering.lost == gathering.refused == 0
    assert max(map(len, sent(MESSAGES))) <= MAX_DATAGRAM


@pytest.mark.parametrize("burst", [1.0, 5.0])
def test_five_per_cent_of_losses_lose_hardly_a_message(burst: float) -> None:
    """Seeded; single losses, and bursts of five (Gilbert); at most 30 % more bytes than the messages."""
    rng = np.random.default_rng(8)
    messages = [rng.bytes(48_000) for _ in range(20)] * 20
    datagrams = sent(messages)
    delivered, is_bad = [], False
    for datagram in datagrams:
        is_bad = rng.random() > 1 / burst if is_bad else rng.random() < 0.05 / (0.95 * burst)
        delivered += [] if is_bad else [datagram]
    assert 0.93 < len(delivered) / len(datagrams) < 0.97
    out, gathering = received(delivered)
    assert len(out) >= 0.995 * len(messages) and gathering.lost == len(messages) - len(out)
    assert sum(map(len, datagrams)) < 1.3 * sum(map(len, messages))


def test_repeated_reordered_damaged_and_foreign_datagrams() -> None:
    rng = np.random.default_rng(1)
    originals = sent(MESSAGES)
    mixed = [originals[i] for i in np.argsort(np.arange(len(originals)) + rng.uniform(0, 12, len(originals)))]
    bad = [
        bytes(b ^ (i == len(datagram) // 2) for i, b in enumerate(datagram)) for datagram in originals[::7]
    ]
    foreign = Datagrams(8).add(MESSAGES[1])
    gathering = Gathering()
    out = [
        m
        for datagram in (*bad, mixed[0], *foreign, *mixed[1:], *originals[::3])
        for m in gathering.receive(datagram)
    ]
    assert (
        len(out) >= 7 and out == MESSAGES[-len(out) :] and gathering.refused >= len(bad) + len(foreign) > 20
    )


def test_a_restarted_sender_replaces_the_silent_one() -> None:
    """It does once the first one has been silent for two seconds; parts of the two openings are not mixed."""
    now, (_, before), (_, again) = [0.0], sender_of(2), sender_of(3)
    first, second, gathering = Datagrams(7), Datagrams(8), Gathering(clock_s=lambda: now[0])
    out = [message for m in before for datagram in first.add(m) for message in gathering.receive(datagram)]
    now[0] = 1.9
    assert (
        not any(gathering.receive(datagram) for datagram in Datagrams(9).add(again[0])) and gathering.refused
    )
    assert out == before[: len(out)] and out
    now[0] = 4.0
    assert [
        message
        for datagram in [*(datagram for m in again for datagram in second.add(m)), *second.flush()]
        for message in gathering.receive(datagram)
    ] == again


def test_a_repeated_opening_delays_no_short_segment() -> None:
    """One datagram of it is enough; another message of its length is not mistaken for it."""
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
        out += [
            received_message
            for datagram in datagrams.add(message)
            for received_message in gathering.receive(datagram)
        ]
        late.append(len(late) + 1 - len(out))
    assert max(late[12:]) <= 1 < late[3], "the first opening takes its time"
    other = bytes(len(opening))
    out += [
        received_message
        for part in (datagrams.add(other), datagrams.flush())
        for datagram in part
        for received_message in gathering.receive(datagram)
    ]
    assert out == [*messages, other] and gathering.lost == 0


def test_losses_are_counted_and_later_messages_arrive() -> None:
    numbered = [
        (int.from_bytes(datagram[6:10], "little"), datagram)
        for datagram in sent([bytes([i]) * 3000 for i in range(60)])
    ]
    out, gathering = received([datagram for number, datagram in numbered if number not in (5, 6, 30)])
    assert [m[0] for m in out] == [i for i in range(60) if i not in (5, 6, 30)] and gathering.lost == 3
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0])
    out = [m for number, datagram in numbered if number == 0 for m in gathering.receive(datagram)]
    now[0] = 2.1
    out += [m for number, datagram in numbered if number >= 36 for m in gathering.receive(datagram)]
    assert [m[0] for m in out] == [0, *range(36, 60)] and gathering.lost == 35


@settings(max_examples=100, deadline=None)
@given(st.lists(st.one_of(st.binary(max_size=300), st.integers(0, 400)), max_size=60))
def test_no_datagram_raises(datagrams: list[bytes | int]) -> None:
    valid = sent(MESSAGES[:4])
    gathering = Gathering()
    out = [
        m
        for datagram in datagrams
        for m in gathering.receive(datagram if isinstance(datagram, bytes) else valid[datagram % len(valid)])
    ]
    assert all(m in MESSAGES for m in out)


def test_a_forged_block_number_or_symbol_size_is_refused() -> None:
    """RaptorQ's decoder would end the receiving thread."""
    head = struct.Struct("<2sIIIHI")
    for block, symbol in ((1, 128), (255, 1152), (0, 8)):
        forged = bytes([block, 0, 0, 0]) + bytes(symbol)
        header = (b"TF", 7, 0, 4096, symbol)
        crc = zlib.crc32(forged, zlib.crc32(head.pack(*header, 0)))
        gathering = Gathering()
        assert gathering.receive(head.pack(*header, crc) + forged) == [] and gathering.refused == 1


def test_a_repeated_datagram_takes_the_place_of_no_other() -> None:
    """Of a message, as many datagrams are accepted as it may have; repetitions do not count."""
    first, *others = sent([bytes(100_000)])
    gathering = Gathering()
    assert not any(gathering.receive(datagram) for datagram in (first, others[0], *[first] * 1000))
    assert [m for datagram in others for m in gathering.receive(datagram)] == [bytes(100_000)]
    assert gathering.refused == 0


@pytest.mark.parametrize("repair", [-0.1, 4.1, float("nan")])
def test_invalid_repair_fractions_are_refused(repair: float) -> None:
    with pytest.raises(InvalidArgument, match="repair"):
        Datagrams(1, repair)


def numbered(number: int, stream: int = 7) -> bytes:
    """A datagram with a complete message, which is the stream and the number."""
    datagrams = Datagrams(stream)
    datagrams._number = number
    return datagrams.add(b"%d.%d" % (stream, number))[0]


def pair(number: int, stream: int = 7) -> list[bytes]:
    """Two datagrams of a complete message."""
    datagrams = Datagrams(stream)
    datagrams._number = number
    return [*datagrams.add(b"%d.%d" % (stream, number)), *datagrams.flush()][:2]


def test_message_numbers_outside_the_window_are_refused() -> None:
    """At most eight above the newest, and 24 below; further on only after two seconds of silence."""
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0])
    first, second = pair(0)
    assert gathering.receive(first) == [] and gathering.receive(second) == [b"7.0"]
    assert gathering.receive(numbered(8)) == [] and gathering.refused == 0, "those between are waited for"
    assert gathering.receive(numbered(17)) == [] and gathering.refused == 1
    assert gathering.receive(numbered(16)) == [] and gathering.lost == 0
    assert gathering.receive(numbered(25)) == gathering.receive(numbered(26)) == [] and gathering.refused == 3
    now[0] = 2.1
    assert gathering.receive(numbered(27)) == [] and gathering.refused == 3, "which 25 and 26 confirm"
    assert gathering.lost == 3, "24 are waited for, from 4 on"
    assert gathering.receive(numbered(3)) == [] and gathering.refused == 3, "late, and no more than that"
    now[0] = 9.9
    old = [*pair(0), numbered(1), numbered(0), numbered(1)]
    assert not any(gathering.receive(datagram) for datagram in old) and gathering.refused == 8, "too old"


@pytest.mark.parametrize(("token", "following"), [(None, 8), ("a long word", 9)])
def test_another_stream_follows_the_last_number(token: str | None, following: int) -> None:
    last = Datagrams(7, token=token)
    last._number = datagrams_module.MAX_NUMBER
    assert len(last.add(b"x")) == 1 and len(last.add(b"y")) == 2
    assert (last._number, last._stream) == (1, following)
    assert len(sent([b"x"])) == 4, "of one symbol, and three of repair"


def test_messages_of_invalid_lengths_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(datagrams_module, "MAX_BYTES", 3000)
    for message in (b"", bytes(3001)):
        with pytest.raises(InvalidArgument, match="bytes; expected 1 to 3000"):
            Datagrams(7).add(message)
    twice = [datagram for datagram in sent([bytes(3000)]) for _ in range(2)]
    assert received(twice)[0] == [bytes(3000)], "what a network repeats is not too much"
    monkeypatch.setattr(datagrams_module, "MAX_BYTES", 2999)
    assert received(twice)[1].refused == len(twice)


def test_two_datagrams_confirm_another_stream_once_the_first_is_silent() -> None:
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0])

    def at(time_s: float, *datagrams: bytes) -> list[bytes]:
        now[0] = time_s
        return [message for datagram in datagrams for message in gathering.receive(datagram)]

    assert at(0.0, *pair(0)) == [b"7.0"] and at(1.5, numbered(8)) == []
    assert at(3.5, numbered(5, 8), numbered(6, 8)) == [], "no more than two seconds of silence"
    assert at(3.6, numbered(5, 9)) == [], "of two streams, one each"
    assert at(3.6, numbered(14, 9), numbered(14, 9)) == [], "one too far off, and the same again"
    assert gathering.refused == 5 and at(3.6, numbered(6, 9)) == [b"9.5", b"9.6"], "from the lower number on"
    assert at(3.7, numbered(0, 11), numbered(1, 11)) == [], "nor is this one silent"
    assert at(3.8, *(numbered(number, 9) for number in range(7, 15))) == [b"9.%d" % n for n in range(7, 15)]
    assert at(6.0, *pair(0)) == [], "a stream that was left goes on where it was"
    assert at(6.0, numbered(9), numbered(10)) == [b"7.9", b"7.10"]
    assert at(9.0, numbered(14, 9), numbered(13, 9)) == [] == at(9.0, *pair(14, 9))
    assert at(9.0, *pair(15, 9)) == [b"9.15"]


def replayed(kind: str, token: str | None, messages: list[bytes]) -> tuple[list[bytes], Gathering]:
    """What is received if someone repeats datagrams of an earlier second between those of a sender."""
    now, out, rng = [0.0], list[bytes](), np.random.default_rng(3)
    gathering, datagrams = Gathering(clock_s=lambda: now[0], token=token), Datagrams(7, token=token)
    history = list[bytes]()
    for i, message in enumerate(messages):
        for datagram in datagrams.add(message):
            now[0] += 0.004
            history.append(datagram)
            again = {
                "a pair, twice a second": history[-400:-398] if i % 10 == 5 else [],
                "three of all": [history[k] for k in rng.integers(len(history), size=3)],
                "three of the last": [
                    history[-k] for k in rng.integers(1, min(len(history), 99) + 1, size=3)
                ],
                "all at once": history[:-1] if (i, datagram) == (120, history[-1]) else [],
            }[kind]
            out += [m for received_one in (datagram, *again) for m in gathering.receive(received_one)]
    out += [m for datagram in datagrams.flush() for m in gathering.receive(datagram)]
    now[0] += 10
    assert not any(gathering.receive(datagram) for datagram in history), "nor once the sender is silent"
    return out, gathering


@pytest.mark.parametrize("token", [None, "a long word"])
@pytest.mark.parametrize(
    "kind", ["a pair, twice a second", "three of all", "three of the last", "all at once"]
)
def test_replayed_datagrams_have_no_effect(kind: str, token: str | None) -> None:
    rng = np.random.default_rng(2)
    messages = [rng.bytes(int(n)) for n in rng.integers(300, 6000, 150)]
    out, gathering = replayed(kind, token, messages)
    assert out == messages and gathering.lost == 0


def test_replays_keep_no_restarted_sender_waiting() -> None:
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0])
    old, new, messages = sent(MESSAGES), Datagrams(8), [bytes([i]) * 999 for i in range(60)]
    out = [m for datagram in old for m in gathering.receive(datagram)]
    for i, message in enumerate(messages):
        for datagram in (*old[-5:], *new.add(message)):
            now[0] = 0.5 * i
            out += gathering.receive(datagram)
    out += [m for datagram in new.flush() for m in gathering.receive(datagram)]
    assert out[:8] == MESSAGES and out[8:] == messages[-len(out[8:]) :] and len(out) > 8 + 50


def test_with_a_token_only_its_datagrams_are_received() -> None:
    """Of a stranger, neither forged nor altered datagrams, nor any without a code, have an effect."""
    sender, stranger = Datagrams(100, token="a long word"), Datagrams(100, token="another word")
    plain, gathering, out = Datagrams(100), Gathering(token="a long word"), list[bytes]()
    rng = np.random.default_rng(5)
    for message in MESSAGES:
        genuine, forged = sender.add(message), [*stranger.add(message[::-1]), *plain.add(message[::-1])]
        for datagram in genuine:
            altered = bytearray(datagram)
            altered[int(rng.integers(len(datagram)))] ^= 1 << int(rng.integers(8))
            forged.append(bytes(altered))
        for datagram in (*forged, *genuine):
            out += gathering.receive(datagram)
    refused = gathering.refused
    out += [m for datagram in sender.flush() for m in gathering.receive(datagram)]
    assert out == MESSAGES and gathering.lost == 0 and gathering.refused == refused > 100
    assert max(map(len, genuine)) <= MAX_DATAGRAM < 1200


def test_with_a_token_a_later_stream_replaces_an_earlier_one_at_once() -> None:
    """Never the other way, nor across layers; a gap needs no silence."""
    first, second, third = (
        datagrams_module.stream_of_time(time_ns, is_coarse)
        for time_ns, is_coarse in ((10**18, False), (10**18 + 2000, True), (10**18 + 4000, False))
    )
    assert (first, second, third) == (10**15, 10**15 + 3, 10**15 + 4)
    now = [0.0]
    gathering = Gathering(clock_s=lambda: now[0], token="a long word")

    def at(stream: int, number: int) -> list[bytes]:
        datagrams = Datagrams(stream, token="a long word")
        datagrams._number = number
        return gathering.receive(datagrams.add(b"%d.%d" % (stream, number))[0])

    assert at(first, 0) == [b"%d.0" % first] and at(second, 0) == []
    assert at(first, 99) == [] and gathering.lost == 75
    assert at(third, 5) == [b"%d.5" % third] and at(first, 100) == []
    now[0] = 60.0
    assert at(first, 101) == at(second, 1) == at(third, 5) == [] and at(third, 6) == [b"%d.6" % third]
    assert len(gathering.notes) == 1 and "earlier stream" in gathering.notes[0]


def test_a_missing_or_wrong_token_is_reported_once() -> None:
    """To a receiver that has no stream yet; a key is not made of a short word."""
    keyed, other, plain = (
        Datagrams(7, token=token).add(MESSAGES[0]) for token in ("a long word", "another word", None)
    )
    for token, datagrams, note in (
        (None, keyed, "add [?]token=WORD"), ("a long word", other, "another token|other"),
        ("a long word", plain, "without a token"),
    ):  # fmt: skip
        gathering = Gathering(token=token)
        assert not any(gathering.receive(datagram) for datagram in (*datagrams, b"TF", bytes(99)))
        assert len(gathering.notes) == 1 and re.search(note, gathering.notes[0])
    with pytest.raises(InvalidArgument, match="5 characters; expected 8 or more"):
        Gathering(token="short")


@pytest.mark.parametrize("query", ["?token", "?", "?x=a", "?token=a&token=b", "?token=a&x=b", "?token="])
def test_invalid_queries_of_an_address_are_refused(query: str) -> None:
    with pytest.raises(InvalidArgument, match=r"[?]token=WORD"):
        udp.token_of(f"udp://127.0.0.1:9000{query}")
    assert udp.token_of("udp://127.0.0.1:9000") is None
    assert udp.token_of("udp://127.0.0.1:9000?token=a%20Long+w%FFrd") == "a Long w\udcffrd"


def test_the_code_of_a_datagram_is_that_of_its_documentation() -> None:
    """docs/format/live.md, with the standard library alone."""
    datagram = Datagrams(0x0102030405060708, token="a long word").add(b"x" * 300)[0]
    key = hashlib.pbkdf2_hmac("sha256", b"a long word", b"touchfield datagrams", 600_000)
    assert datagram[:20] == b"TK" + struct.pack("<QIIH", 0x0102030405060708, 0, 300, 128)
    unsigned = datagram[:20] + bytes(16) + datagram[36:]
    assert (
        datagram[20:36] == hmac.new(key, unsigned, "sha256").digest()[:16] and len(datagram) == 36 + 4 + 128
    )


def test_live_with_a_token_sends_datagrams_with_codes(capfd: pytest.CaptureFixture[str]) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(20)
        udp_to = f"127.0.0.1:{link.getsockname()[1]}"
        options = "--nw 3 --rate-hz 20 --on-air-s 0.3 --port 0 --token a-long-word --udp"
        assert _exit_code(["live", "sample:falling-4", *options.split(), udp_to]) == 0
        gathering, out = Gathering(token="a-long-word"), list[bytes]()
        while not out:
            out += gathering.receive(link.recv(2048))
    assert out[0].startswith(MAGIC) and gathering.refused == 0
    assert f"udp://{udp_to}?token=..." in capfd.readouterr().err


def test_a_stream_with_a_token_is_received_with_it() -> None:
    """Of two senders to one port, only that with the token is heard; a receiver without it gets a note."""
    port, wrong_port, notes = free_port(), free_port(), list[str]()
    sender, (opening, *segments) = sender_of(3)
    messages = list[bytes]()

    def take(message: bytes) -> bool:
        messages.append(message)
        return message == segments[-1]

    async def received_all() -> None:
        heard = asyncio.ensure_future(listen(f"UDP://127.0.0.1:{port}?token=A+long+word", take))
        deaf = asyncio.ensure_future(
            listen(f"udp://127.0.0.1:{wrong_port}", lambda m: True, report=notes.append)
        )
        await asyncio.sleep(0.1)
        with (
            UdpSender(sender_of(0)[0], f"127.0.0.1:{port}") as stranger,
            UdpSender(sender, f"127.0.0.1:{port}", token="A long word") as link,
            UdpSender(sender, f"127.0.0.1:{wrong_port}", token="A long word") as unheard,
        ):
            for message in segments:
                for each in (stranger, link, unheard):
                    each.add(message)
        await asyncio.wait_for(heard, 20)
        for _ in range(1000):
            if notes:
                break
            await asyncio.sleep(0.01)
        deaf.cancel()

    asyncio.run(received_all())
    assert messages == [opening, *segments] and len(notes) == 1 and "?token=WORD" in notes[0]


@pytest.mark.parametrize(
    "text", ["", "host", "host:", ":9", "host:0", "host:99999", "host:x", "a..b:9", f"{'x' * 64}:9"]
)
def test_invalid_addresses_are_refused(text: str) -> None:
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


def lossy(to: int, loss_fraction: float, done: threading.Event) -> int:
    """The port of a relay that drops a fraction of its datagrams, repeats some and damages some."""
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
                    if chance < loss_fraction:
                        continue
                    if chance > 0.98:
                        link.sendto(data[:-1] + b"x", ("127.0.0.1", to))
                    for _ in range(1 + (chance > 0.95)):
                        link.sendto(data, ("127.0.0.1", to))

    threading.Thread(target=run, daemon=True).start()
    port: int = link.getsockname()[1]
    return port


@pytest.mark.parametrize("token", [None, "a long word"])
def test_a_live_stream_is_received_through_a_lossy_network(token: str | None) -> None:
    done, port, notes = threading.Event(), free_port(), list[str]()
    relay = lossy(port, 0.05, done)
    sender, _ = sender_of(0)

    def send() -> None:
        with UdpSender(sender, f"127.0.0.1:{relay}", token=token) as link:
            for i in range(60):
                link.add(sender.add(segment(5 * i)))
                if done.wait(0.05):
                    return

    thread = threading.Thread(target=send, daemon=True)
    thread.start()
    time.sleep(0.1)
    query = "" if token is None else "?token=a+long+word"
    with open_live(f"udp://127.0.0.1:{port}{query}", notes.append) as live:
        # the sender's number of a frame is known once it is read: play may move on over frames
        received_frames = [(live.medium[i], live.frames.stream_frame(i)) for i in range(60)]
    done.set()
    thread.join()
    nonempty = [(frame, number) for frame, number in received_frames if frame.support_count]
    assert len(nonempty) >= 50
    for frame, number in nonempty:
        assert number is not None
        np.testing.assert_allclose(frame.to_dense(), field(number).to_dense(), atol=0.2)


def test_the_opening_is_repeated_before_every_fourth_segment() -> None:
    sender, (opening, *segments) = sender_of(9)
    gathering, out = Gathering(), list[bytes]()
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.settimeout(5)
        with UdpSender(sender, f"udp://127.0.0.1:{link.getsockname()[1]}/") as sending:
            for message in segments:
                sending.add(message)
        while b"\0" not in out:
            out += gathering.receive(link.recv(2048))
    assert out == [opening, *segments[:4], opening, *segments[4:8], opening, segments[8], b"\0"]


@pytest.mark.parametrize(("layer", "count"), [("alone", 44), ("fine", 41), ("coarse", 50)])
def test_a_layer_has_its_parity_fraction_and_its_port(layer: udp.Layer, count: int) -> None:
    """36 packets of a thousand bytes; all have arrived once the sender has ended."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        link.setblocking(False)
        port = link.getsockname()[1] - (layer == "coarse")
        with UdpSender(sender_of(0)[0], f"127.0.0.1:{port}", layer) as sending:
            sending.add(bytes(36_000))
        arrived = list[bytes]()
        with suppress(BlockingIOError):
            while True:
                arrived.append(link.recv(2048))
    assert sum(len(datagram) > 1000 for datagram in arrived) == count


def test_a_complete_stream_by_datagrams() -> None:
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
@pytest.mark.parametrize("index", [0, 1, 100])
def test_one_forged_datagram_loses_at_most_one_message(claim: str, length: int, index: int) -> None:
    """The network repeats it. As the first of all it costs at most a window. Message numbers start at 101."""
    sender, forger, messages = (
        Datagrams(7),
        Datagrams(FORGED[claim][0]),
        [bytes([i]) * 3000 for i in range(60)],
    )
    sender._number, forger._number = 100, 100 + FORGED[claim][1] & 0xFFFFFFFF
    forger._number = forger._number if FORGED[claim][1] else 0
    datagrams = [datagram for message in messages for datagram in sender.add(message)] + sender.flush()
    head = struct.Struct("<2sIIIHI")
    header, packet = (b"TF", forger._stream, forger._number, length, 1152), bytes(4 + 1152)
    forged = head.pack(*header, zlib.crc32(packet, zlib.crc32(head.pack(*header, 0)))) + packet
    now, out = [0.0], list[bytes]()
    gathering = Gathering(clock_s=lambda: now[0])
    for datagram in (*datagrams[:index], forged, forged, *datagrams[index:]):
        now[0] += 0.01
        out += gathering.receive(datagram)
    rest = [message for message in messages if message in out]
    assert [message for message in out if message in messages] == rest
    assert len(rest) >= (59 if index or claim.startswith(("a far", "the far")) else 60 - 24)


def test_a_forged_opening_or_distant_segment_is_ignored() -> None:
    """Each is complete in one datagram."""
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
        sent_all = [
            datagram for message in messages for datagram in datagrams.add(message)
        ] + datagrams.flush()
        out, _ = received(sent_all)
        events = [event for message in out for event in receiver.receive(message)]
        assert [e.first_frame for e in events if isinstance(e, LiveSegment)] == [5 * i for i in range(9)]
        assert sum(isinstance(e, Opened) for e in events) == 1 and not any(
            isinstance(e, Lost) for e in events
        )


def test_after_a_long_outage_the_second_segment_confirms_the_first() -> None:
    _, (opening, *segments) = sender_of(40)
    receiver = LiveReceiver(is_open=True)
    events = [
        event for message in (opening, *segments[:2], segments[30]) for event in receiver.receive(message)
    ]
    assert events[1:] == [segment(0), segment(5)]
    assert receiver.receive(segments[31]) == [Lost(10, 140), segment(150), segment(155)]
    assert receiver.receive(segments[33]) == [Lost(160, 5), segment(165)]
    distant, more_distant = (replace(segment(0), first_frame=first) for first in (5000, 9000))
    sender = sender_of(0)[0]
    messages = [sender.add(datagram) for datagram in (distant, more_distant)]
    assert receiver.receive(messages[0]) == []
    assert receiver.receive(segments[34]) == [segment(170)]  # which settles the doubt
    assert receiver.receive(messages[1]) == []
    other = sender_of(9)[1]
    events = [event for message in (*other[:2], messages[1]) for event in receiver.receive(message)]
    assert [type(event) for event in events] == [Opened, LiveSegment]
    assert receiver.receive(other[9]) == [Lost(5, 35), segment(40)], "no more than eight segments ahead"


def test_datagrams_announce_the_end_unless_more_segments_follow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(udp, "_LAST_S", 1.6)
    port, sender, messages = free_port(), sender_of(0)[0], list[bytes]()
    first, second = (sender.add(segment(5 * i)) for i in range(2))

    def send() -> None:
        with UdpSender(sender, f"127.0.0.1:{port}") as link:
            link.add(first)
            link.__exit__()
            time.sleep(0.1)
            link._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
            link.add(second)

    def take(message: bytes) -> bool:
        messages.append(message)
        return message == b""

    async def received_all() -> None:
        await asyncio.wait_for(listen(f"udp://127.0.0.1:{port}", take), 20)
        await asyncio.sleep(0)
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
            link.bind(("127.0.0.1", port))  # which is free again

    threading.Timer(0.3, send).start()
    asyncio.run(received_all())
    assert messages == [sender.opening, first, second, b""]

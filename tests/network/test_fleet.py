"""A live stream under attack, with real sockets and a server in a process of its own: a thousand connections
of every bad kind, forged datagrams, a server that is killed, and a cache in front of it.
"""

from __future__ import annotations

import asyncio
import base64
import http.client
import json
import os
import random
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from tests.network.test_datagrams import free_port

from live_makers import MODEL, field, segment, sender_of
from touchfield.container.records import MAGIC
from touchfield.devices import device
from touchfield.devices.drivers.registry import point_device
from touchfield.medium.trace import Trace
from touchfield.network.datagrams import Datagrams, stream_of_time
from touchfield.network.live import LiveReceiver, LiveSegment, Lost, Refused
from touchfield.network.live_client import open_live
from touchfield.network.live_medium import LiveStream
from touchfield.network.udp import UdpSender
from touchfield.render.player import Player
from touchfield.render.spec import RenderSpec

pytestmark = pytest.mark.thorough

TOKEN = "a long secret word"
SERVER = Path(__file__).with_name("fleet_server.py")
NGINX = shutil.which("nginx") or "/usr/sbin/nginx"


class Server(NamedTuple):
    """A server in a process of its own."""

    process: subprocess.Popen[str]
    address: str

    @property
    def port(self) -> int:
        return int(self.address.rpartition(":")[2])

    def status(self, key: str) -> int:
        """A number of /proc/PID/status, such as VmRSS in KiB or Threads."""
        text = Path(f"/proc/{self.process.pid}/status").read_text()
        return int(next(line for line in text.splitlines() if line.startswith(f"{key}:")).split()[1])

    @property
    def open_files(self) -> int:
        return len(os.listdir(f"/proc/{self.process.pid}/fd"))

    def kill(self) -> None:
        """End the process at once, as a crash does."""
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


def lasting_port() -> int:
    """A free port that the system gives to no connection: it is there again for a second server."""
    for port in random.Random(os.getpid()).sample(range(20_000, 30_000), 100):
        with suppress(OSError), socket.create_server(("127.0.0.1", port)):
            return port
    pytest.fail("no free port")


@contextmanager
def server(port: int = 0, token: str | None = None) -> Iterator[Server]:
    command = [sys.executable, str(SERVER), str(port), *([token] if token else [])]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            address = process.stdout.readline().strip()
            assert address, "the server does not start"
            yield Server(process, address)
        finally:
            process.kill()


def require_frames(live: LiveStream, count: int) -> None:
    """Require frames that have arrived to be those that were sent; a busy machine may lose some."""
    arrived = 0
    for i in range(10 * count):
        got, number = live.medium[i], live.frames.stream_frame(i)
        assert number is not None
        if got.support_count:
            np.testing.assert_allclose(got.to_dense(), field(number % 60).to_dense(), atol=0.2)
            arrived += 1
        if arrived == count:
            return
    pytest.fail(f"{arrived} of {10 * count} frames have arrived")


# -- a thousand connections --------------------------------------------------------------------------------
def handshake(path: str) -> bytes:
    key = base64.b64encode(os.urandom(16)).decode()
    lines = (
        "Upgrade: websocket",
        "Connection: Upgrade",
        f"Sec-WebSocket-Key: {key}",
        "Sec-WebSocket-Version: 13",
    )
    return "\r\n".join([f"GET {path} HTTP/1.1", "Host: 127.0.0.1", *lines, "", ""]).encode()


def opened(address: str) -> socket.socket:
    host, port = address.split(":")
    link = socket.socket()
    link.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
    link.settimeout(10)
    link.connect((host, int(port)))
    return link


def garbage(kind: int, noise: random.Random) -> bytes:
    """What one of the crowd sends; it reads nothing."""
    path = f"/live?token={TOKEN.replace(' ', '%20')}"
    return (
        noise.randbytes(300),
        handshake(path),  # subscribers that never read
        handshake("/live?token=another+secret+word"),
        handshake(path) + noise.randbytes(2000),  # frames of garbage behind a good handshake
        handshake(path) + b"\x82\xff" + (1 << 62).to_bytes(8, "big") + bytes(4),  # a frame without end
        f"GET /live.json?token={'x' * 60} HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n".encode(),
        b"GET /live.json HTTP/1.1\r\nHost: 127.0.0.1\r\nX: ",  # a request that does not end
        b"",
    )[kind % 8]


async def follow(address: str, seconds: float) -> list[tuple[int, int, int]]:
    """Segments, frames that were skipped, and refused messages of twenty receivers."""
    import aiohttp

    async def receive(session: aiohttp.ClientSession) -> tuple[int, int, int]:
        receiver, stop_s = LiveReceiver(), time.monotonic() + seconds
        segments = lost = refused = 0
        async with session.ws_connect(f"ws://{address}/live", params={"token": TOKEN}) as link:
            while time.monotonic() < stop_s:
                for event in receiver.receive((await link.receive()).data):
                    segments += isinstance(event, LiveSegment)
                    lost += event.frame_count if isinstance(event, Lost) else 0
                    refused += isinstance(event, Refused)
        return segments, lost, refused

    async with aiohttp.ClientSession() as session:
        return await asyncio.gather(*(receive(session) for _ in range(20)))


def test_receivers_play_on_beside_a_thousand_bad_connections() -> None:
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(4096, hard), hard))
    noise, links = random.Random(4), list[socket.socket]()
    try:
        with server(token=TOKEN) as live:
            before = live.status("VmRSS"), live.open_files
            crowd_is_over = threading.Event()

            def crowd() -> None:
                for i in range(1000):
                    links.append(opened(live.address))
                    with suppress(OSError):
                        links[-1].sendall(garbage(i, noise))
                crowd_is_over.set()

            thread = threading.Thread(target=crowd)
            thread.start()
            heard = asyncio.run(follow(live.address, 25.0))
            thread.join()
            assert crowd_is_over.is_set() and len(links) == 1000
            for segments, lost, refused in heard:  # a machine that is busy with the crowd may skip some
                assert segments > 50 and lost < segments and not refused, heard
            assert live.status("Threads") < 40
            assert live.status("VmRSS") - before[0] < 96 << 10, "KiB of memory"
            # the silent and the wrong ones were left; those that do not read stay while their buffers take it
            assert live.open_files - before[1] < 600
            for link in links:
                link.close()
            deadline_s = time.monotonic() + 30
            while live.open_files - before[1] > 10 and time.monotonic() < deadline_s:
                time.sleep(0.2)
            assert live.open_files - before[1] <= 10
    finally:
        for link in links:
            link.close()
        resource.setrlimit(resource.RLIMIT_NOFILE, (soft, hard))


# -- datagrams ---------------------------------------------------------------------------------------------
def attacks(datagram: bytes, past: list[bytes], noise: random.Random, forged: list[bytes]) -> list[bytes]:
    """Datagrams of someone on the network, beside a good one."""
    flipped = bytearray(datagram)
    flipped[noise.randrange(len(flipped))] ^= 1 << noise.randrange(8)
    replays = noise.choices(past, k=3) if past else []
    return [
        datagram,
        *replays,
        bytes(flipped),
        noise.randbytes(noise.randrange(1, 1400)),
        noise.choice(forged),
    ]


def forgeries() -> list[bytes]:
    """Datagrams of other tokens, of none, and of a later stream."""
    opening, message = sender_of(1)[1]
    streams = [
        Datagrams(stream_of_time(time.time_ns() + 10**12, False), token="some other secret"),
        Datagrams(7),
    ]
    return [datagram for stream in streams for m in (opening, message) for datagram in stream.add(m)]


def test_attacks_on_datagrams_with_a_token_change_nothing() -> None:
    """Repeated, reordered, forged, damaged and foreign datagrams, six for each good one."""
    noise, forged, sent = random.Random(6), forgeries(), list[bytes]()
    port, done = free_port(), threading.Event()
    relay = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
    relay.bind(("127.0.0.1", 0))
    relay.settimeout(0.05)

    def attack() -> None:
        window = list[bytes]()
        while not done.is_set():
            with suppress(TimeoutError):
                window.append(relay.recv(2048))
                if len(window) < 6:
                    continue
            noise.shuffle(window)  # reordered
            for datagram in window:
                for hostile in attacks(datagram, sent, noise, forged):
                    relay.sendto(hostile, ("127.0.0.1", port))
            sent.extend(window)
            window.clear()

    def send() -> None:
        sender, bodies = sender_of(0)[0], [segment(5 * i) for i in range(12)]
        with UdpSender(sender, f"127.0.0.1:{relay.getsockname()[1]}", token=TOKEN) as link:
            for i in range(400):
                link.add(sender.add(replace(bodies[i % 12], first_frame=5 * i)))
                if done.wait(0.05):
                    return

    notes, threads = list[str](), [threading.Thread(target=attack), threading.Thread(target=send)]
    try:
        for thread in threads:
            thread.start()
        with open_live(f"udp://127.0.0.1:{port}?token={TOKEN}", notes.append) as live:
            require_frames(live, 150)
            assert 10 * live.frames.lost < 150, notes  # a busy machine drops some
    finally:
        done.set()
        for thread in threads:
            thread.join()
        relay.close()
    assert len(sent) > 100


# -- a server that is killed -------------------------------------------------------------------------------
def wait_until(condition: Any, what: str, seconds: float = 60.0) -> None:
    deadline_s = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline_s, what
        time.sleep(0.02)


@pytest.mark.parametrize("form", ["ws://{}/live", "http://{}/live.json"])
def test_no_force_stands_while_a_killed_server_is_away(form: str) -> None:
    """The hand stays where every frame pushes it. Receivers report the loss and the return."""
    place = np.tile([0.0, 0.0, -0.07], (2, 1))
    still, notes = Trace(np.array([0.0, 1e3]), place), list[str]()
    with ExitStack() as stack:
        first = stack.enter_context(server(lasting_port()))
        live = stack.enter_context(open_live(form.format(first.address), notes.append))
        profile = replace(device("phantom-omni"), axes=live.medium.axes)
        spec = RenderSpec(up="lattice", render="field")
        player = stack.enter_context(Player(live.medium, profile, point_device("sim", still).opener, spec))
        player.play()

        def force_n() -> float:
            live.keep_up(player)
            rows = player.log()
            return float(np.linalg.norm(rows["force_n"][-1])) if len(rows) else 0.0

        wait_until(lambda: force_n() > 0.5, "no force at first")
        first.kill()
        wait_until(lambda: force_n() == 0.0, "the force stands")
        wait_until(lambda: any(note.startswith("connection lost, retrying") for note in notes), f"{notes}")
        for _ in range(20):
            assert force_n() == 0.0
            time.sleep(0.05)
        stack.enter_context(server(first.port))
        wait_until(lambda: force_n() > 0.5, f"no force again: {notes}")
        assert player.error is None
        reported = list(notes)
    lost = next(i for i, note in enumerate(reported) if note.startswith("connection lost, retrying"))
    assert "reconnected" in reported[lost:] and "another programme begins" in reported[lost:], reported
    assert sum(note.startswith("connection lost") for note in reported) == 1, reported


@contextmanager
def simulation(model: Path, port: int) -> Iterator[subprocess.Popen[str]]:
    """The command that simulates a model in real time and sends its bodies."""
    program = [sys.executable, "-m", "touchfield", "live", str(model), "--representation", "object"]
    command = [*program, "--nw", "4", "--seconds", "0.5", "--port", str(port)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        try:
            assert process.stderr is not None
            lines = list[str]()
            for line in process.stderr:
                lines.append(line)
                if line.startswith("ws://"):
                    break
            else:
                pytest.fail("".join(lines))
            threading.Thread(target=process.stderr.read, daemon=True).start()
            yield process
        finally:
            process.kill()


def test_a_killed_simulation_leaves_no_force_and_is_played_again(tmp_path: Path) -> None:
    """Bodies at 1 kHz: the hand stays in the floor, whose field is in the opening."""
    pytest.importorskip("mujoco", reason="simulated bodies need the extra physics")
    (tmp_path / "model.xml").write_text(MODEL)
    port, notes = lasting_port(), list[str]()
    with ExitStack() as stack:
        first = stack.enter_context(simulation(tmp_path / "model.xml", port))
        live = stack.enter_context(open_live(f"ws://127.0.0.1:{port}/live", notes.append))
        scene = live.scene
        assert scene is not None and [body.name for body in scene.objects] == ["world", "ball", "lever"]
        floor = scene.objects[0].field(0)
        points_m = floor.grid.to_m(floor.positions())
        place = points_m[np.argmax(np.linalg.norm(floor.sample_n(points_m), axis=1))]
        hand = point_device("sim", Trace(np.array([0.0, 1e3]), np.tile(place, (2, 1))))
        profile = replace(device("phantom-omni"), axes=scene.axes)
        player = stack.enter_context(
            Player(scene, profile, hand.opener, RenderSpec(up="lattice", render="field"))
        )
        player.play()

        def force_n() -> float:
            live.keep_up(player)
            rows = player.log()
            return float(np.linalg.norm(rows["force_n"][-1])) if len(rows) else 0.0

        wait_until(lambda: force_n() > 0.2, f"no force at first: {notes}")
        first.kill()
        first.wait()
        wait_until(lambda: force_n() == 0.0, "the force stands")
        stack.enter_context(simulation(tmp_path / "model.xml", port))
        wait_until(lambda: force_n() > 0.2, f"no force again: {notes}")
        assert player.error is None
        reported = list(notes)
    assert "reconnected" in reported and "another programme begins" in reported, reported


# -- nginx -------------------------------------------------------------------------------------------------
CONFIG = r"""
daemon off; pid {folder}/pid; error_log {folder}/error.log; worker_processes 1; {user}
events {{ worker_connections 512; }}
http {{
  access_log {folder}/access.log combined;
  client_body_temp_path {folder}/body; proxy_temp_path {folder}/proxy;
  fastcgi_temp_path {folder}/f; uwsgi_temp_path {folder}/u; scgi_temp_path {folder}/s;
  proxy_cache_path {folder}/cache keys_zone=live:1m;
  upstream sender {{ server {address}; keepalive 8; }}
  server {{
    listen 127.0.0.1:{port};
    proxy_http_version 1.1; proxy_set_header Connection ""; proxy_set_header Host 127.0.0.1;
    proxy_cache live;
    add_header X-Cached $upstream_cache_status always;
    location / {{ proxy_pass http://sender; proxy_cache_lock on; }}
    location ~ /live\.json$ {{ proxy_pass http://sender; }}
  }}
}}
"""


@contextmanager
def nginx(folder: Path, address: str) -> Iterator[str]:
    """A caching proxy in front of a server."""
    if not os.access(NGINX, os.X_OK):
        pytest.skip("nginx is not installed")
    port, user = free_port(), "user root;" if os.geteuid() == 0 else ""
    config = folder / "nginx.conf"
    config.write_text(CONFIG.format(folder=folder, port=port, address=address, user=user))
    with subprocess.Popen(
        [NGINX, "-c", str(config), "-p", str(folder)], stderr=subprocess.DEVNULL
    ) as process:
        try:
            wait_until(lambda: socket.socket().connect_ex(("127.0.0.1", port)) == 0, "nginx does not start")
            yield f"127.0.0.1:{port}"
        finally:
            process.terminate()


def test_a_caching_proxy_serves_receivers_and_no_segment_of_an_earlier_programme(tmp_path: Path) -> None:
    notes = list[str]()
    with ExitStack() as stack:
        first = stack.enter_context(server(lasting_port()))
        address = stack.enter_context(nginx(tmp_path, first.address))
        url = f"http://{address}/live.json"
        streams = [stack.enter_context(open_live(url, notes.append)) for _ in range(3)]

        for live in streams:
            require_frames(live, 20)
        with urlopen(url) as answer:
            manifest = json.load(answer)
        number, programme = manifest["segments"][-1]["number"], manifest["programme"]
        for expected in ({"HIT", "MISS"}, {"HIT"}):
            with urlopen(f"http://{address}/live/{number}?programme={programme}") as answer:
                assert answer.headers["X-Cached"] in expected and answer.headers["X-Cached"]
        for path in ("live.json", "live/opening", f"live/{number}"):  # without the programme: never stored
            for _ in range(2):
                with urlopen(f"http://{address}/{path}") as answer:
                    assert answer.headers["X-Cached"] != "HIT", path
        first.kill()
        stack.enter_context(server(first.port))
        bases = [live.frames.stream_frame(0) for live in streams]
        wait_until(
            lambda: all(live.frames.stream_frame(0) != base for live, base in zip(streams, bases)),
            f"receivers stay with the earlier programme: {notes}",
        )
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"http://{address}/live/opening?programme={'0' * 16}")
    assert "another programme begins" in notes, notes


def test_a_token_keeps_answers_out_of_shared_caches(tmp_path: Path) -> None:
    with server(token=TOKEN) as live, nginx(tmp_path, live.address) as address:
        link = http.client.HTTPConnection(*address.split(":"))

        def answer_of(path: str, has_token: bool) -> tuple[int, str | None, bytes]:
            link.request("GET", path, headers={"Authorization": f"Bearer {TOKEN}"} if has_token else {})
            answer = link.getresponse()
            return answer.status, answer.headers["X-Cached"], answer.read()

        programme = json.loads(answer_of("/live.json", True)[2])["programme"]
        for has_token in (True, False, True):
            status, cached, data = answer_of(f"/live/opening?programme={programme}", has_token)
            assert status == (200 if has_token else 401) and cached != "HIT"
            assert data.startswith(MAGIC) == has_token
        link.close()


def test_one_connection_is_kept_for_many_requests() -> None:
    with server() as live:
        link = http.client.HTTPConnection(*live.address.split(":"), timeout=10)
        link.connect()
        own_port = link.sock.getsockname()[1]
        before = live.open_files
        for _ in range(50):
            for path, status in (("/live.json", 200), ("/live/999999999", 404), ("/live/opening", 200)):
                link.request("GET", path)
                answer = link.getresponse()
                data = answer.read()
                assert answer.status == status and len(data) == int(answer.headers["Content-Length"])
        assert link.sock.getsockname()[1] == own_port and live.open_files <= before + 1
        link.close()

"""The page given by a server: a file by its name, and a live stream followed segment by segment."""

from __future__ import annotations

import asyncio
import base64
import json
import re
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from types import SimpleNamespace
from typing import Any, Self
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from browser import ROOT, drive, needs_browser

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.network.access import Access, Pages, run
from touchfield.network.bridge import Bridge
from touchfield.network.live_server import LiveServer
from touchfield.network.server import application
from touchfield.pipeline.spec import EncodeSpec
from touchfield.tasks.live import LiveSpec, broadcast, open_sender
from touchfield.tasks.play import MAX_STALLED_FRACTION
from touchfield.viewer.browser import empty_page, served_page

PAGES = Pages(served_page(), empty_page())
INNER = "document.querySelector('iframe').contentWindow.touchfield"


def rising() -> tf.HapticMedium:
    """A rising floor, five frames a second, whose force grows with its height."""
    dense = np.zeros((20, 16, 16, 16, 3), np.float32)
    for i in range(20):
        dense[i, :, : 6 + i // 2] = (0, 0.5 + 0.1 * i, 0)
    return tf.HapticMedium.from_array(dense, tf.Grid((16, 16, 16), (0.005,) * 3, (-0.0375,) * 3), 20.0)


@contextmanager
def served(folder: Path, access: Access) -> Iterator[str]:
    """The address of a folder."""
    loop, address, is_ready, over = asyncio.new_event_loop(), list[str](), threading.Event(), asyncio.Event()

    def ready(line: str) -> None:
        address.append(line)
        is_ready.set()

    thread = threading.Thread(
        target=lambda: loop.run_until_complete(run(application(folder, access, PAGES), access, ready, over)),
        daemon=True,
    )
    thread.start()
    assert is_ready.wait(10)
    yield address[0]
    loop.call_soon_threadsafe(over.set)
    thread.join(10)


def test_the_outer_page_allows_only_its_script_and_its_server() -> None:
    page = served_page()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None and "connect-src 'self'" in policy[1] and "default-src 'none'" in policy[1]
    assert "unsafe" not in policy[1] and "@" not in policy[1] and "http" not in policy[1]


@needs_browser
def test_a_file_of_a_folder_is_opened_by_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "streams"
    (folder / "a room").mkdir(parents=True)
    tf.encode(rising(), folder / "a room" / "rise.touch")
    with served(folder, Access(port=0, token="a-long-word")) as address:
        page = f"http://{address}/view/a%20room/rise.touch"
        result = drive(
            tmp_path,
            {"do": "goto", "url": page + "?token=a-long-word"},
            {"do": "run", "code": f"{INNER}.state()"},
            {"do": "run", "code": f"{INNER}.feel([0, -0.035, 0])"},
            offline=False,
        )
    assert result.errors == [] and {
        url.split("/")[2] for url in result.requests if url.startswith("http")
    } == {address}
    assert result.answers[1]["state"] == "ready" and result.answers[1]["name"] == "a room/rise.touch"
    assert result.answers[2][1] == pytest.approx(0.5, abs=0.06)


def noise(count: int) -> tf.HapticMedium:
    """Frames of many bytes each."""
    rng = np.random.default_rng(7)
    dense = rng.normal(0, 1, (count, 16, 16, 16, 3)).astype(np.float32)
    dense[:, :, 12:] = 0
    return tf.HapticMedium.from_array(dense, tf.Grid((16, 16, 16), (0.005,) * 3, (-0.0375,) * 3), 10.0)


class _Ranges(ThreadingHTTPServer):
    """One file served by ranges, and the pages; requested ranges are recorded, and `spoil` may
    change a response.
    """

    def __init__(self, data: bytes, spoil: Callable[[int, bytes], bytes] = lambda start, data: data) -> None:
        self.data, self.spoil, self.requested = data, spoil, list[tuple[int, int]]()
        super().__init__(("127.0.0.1", 0), _Answers)

    def __enter__(self) -> Self:
        threading.Thread(target=self.serve_forever, daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self.shutdown()
        self.server_close()

    @property
    def view(self) -> str:
        """The address of the page."""
        return f"http://127.0.0.1:{self.server_address[1]}/view/a.touch"


class _Answers(BaseHTTPRequestHandler):
    server: _Ranges

    def log_message(self, *_: object) -> None:
        """Nothing."""

    def do_GET(self) -> None:
        """A page, or a range of the file."""
        pages = {"/view/a.touch": PAGES.outer, "/view-page.html": PAGES.inner}
        match = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if self.path in pages:
            self._send(200, pages[self.path].encode(), "text/html")
        elif self.path == "/a.touch" and match is not None:
            start, end = int(match[1]), min(int(match[2]) + 1, len(self.server.data))
            self.server.requested.append((start, end))
            data = self.server.spoil(start, self.server.data[start:end])
            self._send(
                206, data, "haptics/vnd.touchfield", f"bytes {start}-{end - 1}/{len(self.server.data)}"
            )
        else:
            self._send(404, b"no such file", "text/plain")

    def _send(self, status: int, data: bytes, kind: str, content_range: str = "") -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(data)))
        if content_range:
            self.send_header("Content-Range", content_range)
        self.end_headers()
        with suppress(ConnectionError):
            self.wfile.write(data)


def _forces_n(medium: tf.HapticMedium, time_s: float, points: np.ndarray) -> np.ndarray:
    return np.asarray(tf.FieldSampler(medium).force_n(time_s, points))


@needs_browser
def test_only_played_parts_of_a_large_file_are_fetched(tmp_path: Path) -> None:
    """Head and index, the first segment, and the target of the seek; forces equal those of Python."""
    tf.encode(noise(160), tmp_path / "a.touch", EncodeSpec(touch=tf.codec.TouchSpec(segment_frames=8)))
    data = (tmp_path / "a.touch").read_bytes()
    assert len(data) > 1 << 20
    points = np.random.default_rng(1).uniform(-0.035, 0.01, (40, 3))
    feel = {"do": "run", "code": f"{INNER}.feel({points.reshape(-1).tolist()})"}
    between = 7.95  # the last frame of a segment, and the first of the next one
    with _Ranges(data) as server:
        result = drive(
            tmp_path,
            {"do": "goto", "url": server.view},
            {"do": "run", "code": f"{INNER}.state()"},
            feel,
            {"do": "run", "code": f"{INNER}.seek({between})"},
            feel,
            offline=False,
        )
        first_requested = list(server.requested)
        played = drive(
            tmp_path, {"do": "goto", "url": server.view},
            {"do": "run", "code": f"{INNER}.seek(1).then(() => "
                                  "[...document.querySelector('iframe').contentDocument"
             ".querySelectorAll('button')].find((b) => b.id == 'play').click())"},
            {"do": "until", "code": f"{INNER}.state().time > 2"}, {"do": "run", "code": f"{INNER}.state()"},
            offline=False,
        )  # fmt: skip
    assert result.errors == played.errors == []
    assert result.answers[1]["state"] == played.answers[3]["state"] == "ready"
    assert result.answers[1]["name"] == "a.touch" and result.answers[1]["head"]["frames"] == 160
    assert len(set(first_requested)) == len(first_requested)
    assert sum(end - start for start, end in first_requested) < 0.4 * len(data)
    with tf.open_stream(tmp_path / "a.touch") as opened:
        for answer, time_s in ((result.answers[2], 0.0), (result.answers[4], between)):
            got = np.array(answer).reshape(-1, 5)[:, :3]
            np.testing.assert_allclose(got, _forces_n(opened.medium, time_s, points), atol=1e-5)
            assert np.abs(got).max() > 0.5
        assert any(s.first_frame == 80 for s in opened.reader.segments)


GOLDEN = ROOT / "conformance" / "v1"


def _in_parts(data: str) -> str:
    """Code that opens a file, base64, by reading parts of it."""
    return (
        f"(async () => {{ const all = Uint8Array.from(atob('{data}'), (c) => c.charCodeAt(0));"
        "await touchfield.read(all.length, 'parts', async (from, to) => all.subarray(from, to)); return 0; "
        "})()"
    )


@needs_browser
@pytest.mark.parametrize(
    "name", ["objects-touch", "objects-touch-deforming", "vibration-touch", "touch-solid"]
)
def test_files_in_parts_are_the_same_files(tmp_path: Path, name: str) -> None:
    """Bodies and vibrations too: reading in parts gives the same result as the complete file."""
    file_name, parts = f"{name}.touch", base64.b64encode((GOLDEN / f"{name}.touch").read_bytes()).decode()
    (tmp_path / "page.html").write_text(empty_page(), encoding="utf-8")
    with tf.open_stream(GOLDEN / file_name) as opened:
        low, high = opened.grid.box_m
    points = np.random.default_rng(2).uniform(low, high, (80, 3)).reshape(-1).tolist()
    looks = [
        step
        for time_s in (0.0, 0.0004, 0.05, 9.0)
        for step in ({"do": "seek", "time": time_s}, {"do": "feel", "points": points})
    ]
    result = drive(
        tmp_path,
        {"do": "goto", "url": (tmp_path / "page.html").as_uri()},
        {"do": "open", "file": GOLDEN / file_name},
        *looks,
        {"do": "run", "code": _in_parts(parts)},
        *looks,
        {"do": "state"},
    )
    assert (
        result.errors == []
        and result.answers[-1]["name"] == "parts"
        and result.answers[-1]["state"] == "ready"
    )
    count = len(looks)
    assert result.answers[3 : 2 + count : 2] == result.answers[4 + count : 3 + 2 * count : 2]
    assert np.abs(result.answers[3]).max() > 0


def _cut(start: int, data: bytes) -> bytes:
    return data[:-1] if start else data


def _flipped(start: int, data: bytes) -> bytes:
    return data[:-10] + bytes([data[-10] ^ 1]) + data[-9:] if start else data


def _longer(start: int, data: bytes) -> bytes:
    return data + b"0" if start else data


@needs_browser
@pytest.mark.parametrize(
    ("spoil", "message"), [(_cut, "other bytes"), (_flipped, "corrupt"), (_longer, "more than")]
)
def test_invalid_responses_of_a_server_are_refused(
    tmp_path: Path, spoil: Callable[[int, bytes], bytes], message: str
) -> None:
    tf.encode(noise(40), tmp_path / "a.touch", EncodeSpec(touch=tf.codec.TouchSpec(segment_frames=8)))
    with _Ranges((tmp_path / "a.touch").read_bytes(), spoil) as server:
        fault = "document.querySelector('iframe').contentDocument.getElementById('fault').textContent"
        result = drive(
            tmp_path,
            {"do": "goto", "url": server.view},
            {"do": "run", "code": f"{INNER}.state().state"},
            {"do": "run", "code": fault},
            offline=False,
        )
    assert result.answers[1] == "fault" and (
        message in result.answers[2] or "cut short" in result.answers[2]
    ), result.answers


@needs_browser
def test_faulty_files_in_parts_are_refused(tmp_path: Path) -> None:
    """No file that a reader must refuse opens and plays completely in parts."""
    (tmp_path / "page.html").write_text(empty_page(), encoding="utf-8")
    steps: list[dict[str, Any]] = [{"do": "goto", "url": (tmp_path / "page.html").as_uri()}]
    names = sorted(path.name for path in (ROOT / "conformance" / "faulty").glob("*.touch"))
    for name in names:
        data = base64.b64encode((ROOT / "conformance" / "faulty" / name).read_bytes()).decode()
        steps += [{"do": "run", "code": _in_parts(data)}, {"do": "through"}, {"do": "state"}]
    result = drive(tmp_path, *steps)
    assert result.errors == []
    assert [
        name for name, state in zip(names, result.answers[3::3], strict=True) if state["state"] != "fault"
    ] == []


@needs_browser
def test_a_live_stream_is_followed(tmp_path: Path) -> None:
    prepared, sender = open_sender(rising(), EncodeSpec())
    stop = threading.Event()

    def pause(seconds: float) -> None:
        if stop.wait(seconds):
            raise KeyboardInterrupt

    with LiveServer(sender, Access(port=0), PAGES) as server:

        def send() -> None:
            with suppress(KeyboardInterrupt):
                broadcast(prepared, server.add, LiveSpec(0.5, loop=True), pause=pause)

        thread = threading.Thread(target=send, daemon=True)
        thread.start()
        look = {"do": "run", "code": f"{INNER}.state()"}
        wait = {"do": "wait", "ms": 1500}
        result = drive(
            tmp_path,
            {"do": "goto", "url": f"http://{server.address}/view"},
            look,
            wait,
            look,
            wait,
            look,
            offline=False,
        )
        stop.set()
        thread.join(10)
    names = [result.answers[n]["name"] for n in (1, 3, 5)]
    numbers = [int(name.removeprefix("live, frame ")) for name in names]
    assert result.errors == [] and 0 <= numbers[0] < numbers[1] < numbers[2]
    assert all(result.answers[n]["state"] == "ready" and result.answers[n]["playing"] for n in (3, 5))


@needs_browser
def test_the_hand_on_a_device_is_drawn_at_its_position(tmp_path: Path) -> None:
    """A hand that is high, then low: the page shows its position and the force given by Python."""
    tf.encode(rising(), tmp_path / "rise.touch")

    class Hand:
        media_s, position_m = 0.0, (0.01, 0.02, 0.0)

    read_position = {
        "do": "run",
        "code": f"[...{INNER}.state().point, ...{INNER}.state().force, {INNER}.state().time]",
    }
    with Bridge(tmp_path / "rise.touch", Access(port=0), PAGES) as bridge:
        bridge.follow(Hand())
        low = threading.Timer(
            6.0, lambda: (setattr(Hand, "position_m", (0.0, -0.03, 0.01)), setattr(Hand, "media_s", 0.5))
        )
        low.start()
        result = drive(tmp_path, {"do": "goto", "url": bridge.page}, {"do": "wait", "ms": 1500},
                       read_position, {"do": "wait", "ms": 6000}, read_position, offline=False)  # fmt: skip
        low.join()
    first, last = result.answers[2], result.answers[4]
    assert result.errors == [] and {
        url.split("/")[2] for url in result.requests if url.startswith("http")
    } == {bridge.address}
    assert first[:3] == pytest.approx([0.01, 0.02, 0.0]) and first[3:6] == [0, 0, 0] and first[-1] == 0
    assert last[:3] == pytest.approx([0.0, -0.03, 0.01]) and last[-1] == pytest.approx(0.5)
    with tf.open_stream(tmp_path / "rise.touch") as stream:
        expected = stream.medium.sample_n(np.array([[0.0, -0.03, 0.01]]), 0.5)[0]
    np.testing.assert_allclose(last[3:6], expected, atol=1e-5)


def test_a_file_of_any_name_is_fetched_by_the_page_of_a_hand(tmp_path: Path) -> None:
    path = tmp_path / "50 % {of} it.touch"
    path.write_bytes(b"touch")
    with Bridge(path, Access(port=0), PAGES) as bridge:
        assert bridge.page.endswith("/view/50%20%25%20%7Bof%7D%20it.touch#hand")
        with urlopen(bridge.page.partition("#")[0].replace("/view/", "/")) as answer:
            assert answer.read() == b"touch" and answer.headers["Content-Type"] == "haptics/vnd.touchfield"
        with pytest.raises(HTTPError, match="404"):
            urlopen(f"http://{bridge.address}/other.touch")


def test_play_shows_its_hand_in_the_page(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tf.encode(rising(), tmp_path / "rise.touch")
    code = _exit_code(["play", str(tmp_path / "rise.touch"), "--bridge", "--seconds", "0.5", "--json"])
    out, report = capsys.readouterr()
    assert code == (json.loads(out)["stalled_share"] > MAX_STALLED_FRACTION)  # on a busy machine
    assert "/view/rise.touch#hand in a browser" in report
    assert _exit_code(["play", "http://127.0.0.1:9/rise.touch", "--bridge"]) == 2
    assert "a .touch file on this machine" in capsys.readouterr().err


def test_an_open_page_does_not_delay_the_end_of_play(tmp_path: Path) -> None:
    """Its connection is closed cleanly, not cut after some seconds."""
    tf.encode(rising(), tmp_path / "rise.touch")
    codes, is_drawn = list[int | None](), threading.Event()

    async def show(address: str) -> None:
        import aiohttp

        async with aiohttp.ClientSession() as session, session.ws_connect(f"ws://{address}/hand") as link:
            async for _ in link:
                is_drawn.set()
        codes.append(link.close_code)

    with Bridge(tmp_path / "rise.touch", Access(port=0), PAGES) as bridge:
        bridge.follow(SimpleNamespace(media_s=0.0, position_m=(0.01, 0.02, 0.0)))
        page = threading.Thread(target=asyncio.run, args=(show(bridge.address),))
        page.start()
        assert is_drawn.wait(30)
    page.join(30)
    assert codes == [1000]

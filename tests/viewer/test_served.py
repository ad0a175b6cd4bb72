"""The page that a server gives: a file by its name, and what is live, followed segment by segment."""

from __future__ import annotations

import asyncio
import re
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from browser import drive, needs_browser

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.job import EncodeSpec
from touchfield.job.live import LiveSpec, broadcast, opened_sender
from touchfield.viewer.browser import empty_page, served_page

pytest.importorskip("aiohttp", reason="servers need the extra broadcast")
from touchfield.stream.access import Access, Pages, run
from touchfield.stream.bridge import Bridge
from touchfield.stream.live_server import LiveServer
from touchfield.stream.server import application

PAGES = Pages(served_page(), empty_page())
INNER = "document.querySelector('iframe').contentWindow.touchfield"


def rising() -> tf.HapticMedium:
    """A floor that comes up, five frames a second, and pushes the stronger the higher it is."""
    dense = np.zeros((20, 16, 16, 16, 3), np.float32)
    for i in range(20):
        dense[i, :, : 6 + i // 2] = (0, 0.5 + 0.1 * i, 0)
    return tf.HapticMedium.from_array(dense, tf.Grid((16, 16, 16), (0.005,) * 3, (-0.0375,) * 3), 20.0)


@contextmanager
def served(folder: Path, access: Access) -> Iterator[str]:
    """The address of a folder."""
    loop, address, there, over = asyncio.new_event_loop(), list[str](), threading.Event(), asyncio.Event()

    def ready(told: str) -> None:
        address.append(told)
        there.set()

    thread = threading.Thread(
        target=lambda: loop.run_until_complete(run(application(folder, access, PAGES), access, ready, over)),
        daemon=True,
    )
    thread.start()
    assert there.wait(10)
    yield address[0]
    loop.call_soon_threadsafe(over.set)
    thread.join(10)


def test_the_page_around_lets_no_other_script_run_and_asks_its_own_server_alone() -> None:
    page = served_page()
    policy = re.search(r'Content-Security-Policy" content="([^"]+)"', page)
    assert policy is not None and "connect-src 'self'" in policy[1] and "default-src 'none'" in policy[1]
    assert "unsafe" not in policy[1] and "@" not in policy[1] and "http" not in policy[1]


@needs_browser
def test_a_file_of_a_folder_is_shown_by_its_name(tmp_path: Path) -> None:
    folder = tmp_path / "streams"
    (folder / "a room").mkdir(parents=True)
    tf.encode(rising(), folder / "a room" / "rise.touch")
    with served(folder, Access(port=0, token="a-long-word")) as address:
        page = f"http://{address}/view/a%20room/rise.touch"
        told = drive(
            tmp_path, {"do": "goto", "url": page + "?token=a-long-word"}, {"do": "run", "code": f"{INNER}.state()"},
            {"do": "run", "code": f"{INNER}.feel([0, -0.035, 0])"}, offline=False,
        )  # fmt: skip
    assert told.errors == [] and {url.split("/")[2] for url in told.requests if url.startswith("http")} == {address}
    assert told.answers[1]["state"] == "ready" and told.answers[1]["name"] == "a room/rise.touch"
    assert told.answers[2][1] == pytest.approx(0.5, abs=0.06)


@needs_browser
def test_what_is_live_is_followed(tmp_path: Path) -> None:
    prepared, sender = opened_sender(rising(), EncodeSpec())
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
        told = drive(tmp_path, {"do": "goto", "url": f"http://{server.address}/view"}, look, wait, look, wait, look,
                     offline=False)  # fmt: skip
        stop.set()
        thread.join(10)
    names = [told.answers[n]["name"] for n in (1, 3, 5)]
    numbers = [int(name.removeprefix("live, frame ")) for name in names]
    assert told.errors == [] and 0 <= numbers[0] < numbers[1] < numbers[2]
    assert all(told.answers[n]["state"] == "ready" and told.answers[n]["playing"] for n in (3, 5))


@needs_browser
def test_a_hand_on_a_device_is_shown_where_it_is(tmp_path: Path) -> None:
    """A hand that stands high, then low: the page shows its place, and feels there what Python says."""
    tf.encode(rising(), tmp_path / "rise.touch")

    class Hand:
        media_s, position_m = 0.0, (0.01, 0.02, 0.0)

    place = {"do": "run", "code": f"[...{INNER}.state().point, ...{INNER}.state().force, {INNER}.state().time]"}
    with Bridge(tmp_path / "rise.touch", Access(port=0), PAGES) as bridge:
        bridge.follow(Hand())
        low = threading.Timer(
            6.0, lambda: (setattr(Hand, "position_m", (0.0, -0.03, 0.01)), setattr(Hand, "media_s", 0.5))
        )
        low.start()
        told = drive(tmp_path, {"do": "goto", "url": bridge.page}, {"do": "wait", "ms": 1500}, place,
                     {"do": "wait", "ms": 6000}, place, offline=False)  # fmt: skip
        low.join()
    first, last = told.answers[2], told.answers[4]
    assert told.errors == [] and {url.split("/")[2] for url in told.requests if url.startswith("http")} == {
        bridge.address
    }
    assert first[:3] == pytest.approx([0.01, 0.02, 0.0]) and first[3:6] == [0, 0, 0] and first[-1] == 0
    assert last[:3] == pytest.approx([0.0, -0.03, 0.01]) and last[-1] == pytest.approx(0.5)
    with tf.open_stream(tmp_path / "rise.touch") as stream:
        expected = stream.medium.sample_n(np.array([[0.0, -0.03, 0.01]]), 0.5)[0]
    np.testing.assert_allclose(last[3:6], expected, atol=1e-5)


def test_play_has_its_hand_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    tf.encode(rising(), tmp_path / "rise.touch")
    assert _exit_code(["play", str(tmp_path / "rise.touch"), "--bridge", "--seconds", "0.5"]) in (0, 1)
    assert "/view/rise.touch#hand in a browser" in capsys.readouterr().err
    assert _exit_code(["play", "http://127.0.0.1:9/rise.touch", "--bridge"]) == 2
    assert "a .touch file on this machine" in capsys.readouterr().err

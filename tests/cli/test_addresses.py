"""A wrong address is refused when options are parsed: before a source is read, or anybody is waited for."""

from __future__ import annotations

from pathlib import Path

import pytest

from touchfield.cli.main import _exit_code
from touchfield.errors import InvalidArgument
from touchfield.network.access import Access
from touchfield.network.live_client import require_live

REFUSED = {
    "live missing.stl --udp host": "--udp: found 'host'; expected a host and a port from 1 to 65535",
    "live missing.stl --udp 127.0.0.1:65535 --coarse": "--udp: found port 65535, with --coarse",
    f"live missing.stl --udp {'x' * 64}:9": "--udp: found ",
    **{
        f"live missing.stl - --{option}": f"--{option.split()[0]}: found a pipe beside it; expected a server"
        for option in (
            "udp 127.0.0.1:9",
            "coarse",
            "token a-long-word",
            "open",
            "cors *",
            "host localhost",
            "port 8077",
        )
    },
    "live missing.stl --cors example.org": "--cors: found 'example.org'; expected an origin",
    "live missing.stl --port 65536": "--port: found 65536",
    "serve . --cors https://example.org/page": "--cors: found 'https://example.org/page'",
    "play udp://here": "address of a live stream: found 'here'; expected a host and a port",
    "play ws://127.0.0.1:65536/live": "address of a live stream: found 'ws://127.0.0.1:65536/live'",
    "play http:///live.json": "address of a live stream: found 'http:///live.json'; expected a host",
    "play udp://127.0.0.1:9?word=long": "address of a live stream: found another query",
    "play ws://127.0.0.1:9/live --coarse udp://here": "--coarse: found 'here'",
    "play ws://127.0.0.1:9/live --coarse coarse.touch": "--coarse: found 'coarse.touch'; expected ws://",
    "play ws://127.0.0.1:9/live --device osc:here": "osc:HOST:PORT: found 'here'",
    "play ws://127.0.0.1:9/live --device pins:127.0.0.1:99999": "pins:",
    "play ws://127.0.0.1:9/live --device haply:here:x": "haply:HOST:PORT",
    "doctor --device osc:here": "osc:HOST:PORT: found 'here'",
    "play ws://127.0.0.1:9/live --device bhaptics:0:0": "bhaptics[:HOST:PORT]: found '0:0'",
}


@pytest.mark.parametrize("words", REFUSED)
def test_a_wrong_address_is_refused_at_once(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert _exit_code(words.split()) == 2
    stderr = capsys.readouterr().err
    assert stderr.startswith(f"touchfield: {REFUSED[words]}") and stderr.count("\n") == 1, stderr


@pytest.mark.parametrize(
    "url",
    ["ws://host/live", "WSS://[::1]:8076/live?token=x", "http://h:1/live.json", "udp://h:9?token=x", "-"],
)
def test_addresses_of_live_streams_are_accepted(url: str) -> None:
    require_live(url, "stream")


@pytest.mark.parametrize("words", ["info {}", "compare sample:shapes {}", "play {}", "view {}"])
def test_an_address_that_is_none_is_one_clear_line(words: str, capsys: pytest.CaptureFixture[str]) -> None:
    for url in ("https://[::1/x.touch", "https://127.0.0.1:99999/x.touch"):
        assert _exit_code(words.format(url).split()) == 1
        stderr = capsys.readouterr().err
        assert stderr.startswith(f"touchfield: {url}: found ") and stderr.count("\n") == 1, stderr


def test_origins_that_a_browser_sends_are_accepted() -> None:
    origins = ("*", "null", "https://example.org", "http://127.0.0.1:8000", "http://[::1]:80")
    assert Access(origins=origins).origins == origins
    for origin in ("https://Example.org", "https://example.org/", "https://", "https://h:99999", ""):
        with pytest.raises(InvalidArgument, match="--cors"):
            Access(origins=(origin,))

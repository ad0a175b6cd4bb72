"""Remote streams: the bytes that are fetched, and what a server cannot do to a receiver."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np
import pytest
from aiohttp import web

import touchfield as tf
from touchfield.cli.main import _exit_code
from touchfield.codec.touch.spec import TouchSpec
from touchfield.container import TouchReader, remote
from touchfield.errors import SourceError, TouchfieldError
from touchfield.medium import ForceField, Grid, HapticMedium
from touchfield.network import file_response, server
from touchfield.network.access import Access, Pages
from touchfield.network.server import application
from touchfield.pipeline import encode
from touchfield.pipeline.spec import EncodeSpec


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a stream of 24 frames in 8 segments, as large as a few requests, and one of bodies."""
    folder = tmp_path_factory.mktemp("streams")
    rng = np.random.default_rng(2)
    grid = Grid((20, 20, 20), (0.006,) * 3, (-0.057,) * 3)
    frames = [
        ForceField.from_dense(grid, rng.normal(0, 1, (20, 20, 20, 3)).astype(np.float32)) for _ in range(24)
    ]
    medium = HapticMedium.from_frames(frames, 30.0, "x right, y up, z towards the user")
    encode(medium, folder / "noise.touch", EncodeSpec(touch=TouchSpec(segment_frames=3, effort="fast")))
    encode("sample:falling-4", folder / "bodies.touch", EncodeSpec(nw=5, frames=(0, 8)))
    (folder / "notes.txt").write_text("private")
    (folder / ".hidden.touch").write_bytes((folder / "bodies.touch").read_bytes())
    return folder


@contextmanager
def served(folder: Path, access: Access = Access()) -> Iterator[str]:
    """The address of a server that runs in a thread."""
    loop, started, address = asyncio.new_event_loop(), threading.Event(), []

    async def run() -> None:
        runner = web.AppRunner(application(folder, access), access_log=None)
        await runner.setup()
        site = web.TCPSite(runner, access.host, 0)
        await site.start()
        address.append(f"http://127.0.0.1:{runner.addresses[0][1]}")
        started.set()
        while not done.is_set():
            await asyncio.sleep(0.01)
        await runner.cleanup()

    done = threading.Event()
    thread = threading.Thread(target=lambda: loop.run_until_complete(run()), daemon=True)
    thread.start()
    assert started.wait(10)
    yield address[0]
    done.set()
    thread.join(10)
    loop.close()


@contextmanager
def answering(*answers: Callable[[socket.socket], None] | bytes) -> Iterator[str]:
    """The address of a server that gives these answers in turn and repeats the last one."""
    listener = socket.create_server(("127.0.0.1", 0))
    listener.settimeout(0.05)
    done = threading.Event()

    def run() -> None:
        count = 0
        while not done.is_set():
            try:
                link, _ = listener.accept()
            except TimeoutError:
                continue
            with link:
                link.settimeout(20)
                try:
                    while link.recv(65536):
                        answer = answers[min(count, len(answers) - 1)]
                        count += 1
                        if isinstance(answer, bytes):
                            link.sendall(answer)
                        else:
                            answer(link)
                            break
                except OSError:
                    continue

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{listener.getsockname()[1]}/x.touch"
    done.set()
    thread.join(10)
    assert not thread.is_alive(), "nobody has hung up"
    listener.close()


def partial(data: bytes, at: int, total: int, tag: str = '"a"') -> bytes:
    head = f"HTTP/1.1 206 Partial Content\r\nContent-Length: {len(data)}\r\nETag: {tag}\r\n"
    return f"{head}Content-Range: bytes {at}-{at + len(data) - 1}/{total}\r\n\r\n".encode() + data


def test_a_stream_opens_in_three_requests_and_fetches_segments_on_demand(folder: Path) -> None:
    with served(folder) as address, TouchReader(f"{address}/noise.touch") as remote_file:
        source = remote_file._source.remote
        assert source is not None and source.requests <= 3 and source.received < 65536 < remote_file.size
        with TouchReader(folder / "noise.touch") as local_file:
            assert (remote_file.head, remote_file.segments, remote_file.provenance) == (
                local_file.head,
                local_file.segments,
                local_file.provenance,
            )
            before = source.requests, source.received
            assert remote_file.read_segment(5) == local_file.read_segment(5)
            assert source.requests - before[0] == 1
            assert source.received - before[1] == remote_file.segments[5].length
            assert [remote_file.read_segment(i) for i in range(8)] == [
                local_file.read_segment(i) for i in range(8)
            ]
        assert source.requests <= 3 + 8


def test_the_cache_of_a_remote_file_is_bounded(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with served(folder) as address, TouchReader(f"{address}/noise.touch") as remote_file:
        source = remote_file._source.remote
        assert source is not None
        longest = max(entry.length for entry in remote_file.segments)
        monkeypatch.setattr(remote, "_MAX_CACHED", 2 * longest)
        for i in range(8):
            remote_file.read_segment(i)
            assert sum(map(len, source._cache.values())) <= 2 * longest
        before = source.requests
        remote_file.read_segment(7)
        assert source.requests == before
        remote_file.read_segment(0)
        assert source.requests == before + 1
        remote_file.read_segment(7)  # used last, so that another one is evicted
        remote_file.read_segment(1)
        before = source.requests
        remote_file.read_segment(7)
        assert source.requests == before
        remote_file.read_segment(0)
        assert source.requests == before + 1


@pytest.mark.parametrize("name", ["noise.touch", "bodies.touch"])
def test_remote_forces_equal_those_of_the_file(folder: Path, name: str) -> None:
    with (
        served(folder) as address,
        tf.open_stream(f"{address}/{name}") as remote_file,
        tf.open_stream(folder / name) as local_file,
    ):
        for i in (7, 0, 3):
            assert remote_file.medium[i] == local_file.medium[i]


def records_of(stream: str | Path) -> tuple[object, ...]:
    """All that a reader returns of a stream, the segments from the last to the first."""
    with TouchReader(stream) as reader:
        order = range(len(reader.segments))[::-1]
        bodies = [reader.read_segment(i) for i in order]
        vibrations = [reader.read_vibration(i) for i in order] if reader.has_vibration else []
        objects = [reader.read_object(i) for i in range(reader.object_count)]
        return reader.head, dict(reader.provenance), reader.segments, bodies, vibrations, objects


def test_remote_records_equal_those_of_the_file(tmp_path: Path) -> None:
    """Of all golden streams, and of one with a vibration in each of three segments."""
    golden = Path(__file__).parents[2] / "conformance" / "v1"
    for path in golden.glob("*.touch"):
        (tmp_path / path.name).write_bytes(path.read_bytes())
    grid, rng = Grid((8, 8, 8), (0.006,) * 3, (0.0,) * 3), np.random.default_rng(3)
    frames = [ForceField.from_dense(grid, rng.normal(size=(8, 8, 8, 3)).astype(np.float32)) for _ in range(6)]
    spec = EncodeSpec(vibration="frequency=80..250", touch=TouchSpec(segment_frames=2, effort="fast"))
    encode(HapticMedium.from_frames(frames, 30.0), tmp_path / "hum.touch", spec)
    vibrations = records_of(tmp_path / "hum.touch")[4]
    assert isinstance(vibrations, list) and len(vibrations) == 3 and all(vibrations)
    with served(tmp_path) as address:
        for path in sorted(tmp_path.glob("*.touch")):
            assert records_of(f"{address}/{path.name}") == records_of(path), path.name


def test_commands_take_an_address(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "field.npz"
    with served(folder) as address:
        url = f"{address}/noise.touch"
        assert _exit_code(["decode", url, str(out)]) == 0 and out.exists()
        assert _exit_code(["play", url, "--offline", "--seconds", "0.2"]) == 0
        assert _exit_code(["info", url]) == 0
        page = tmp_path / "page.html"
        assert _exit_code(["view", url, "--no-open", "--out", str(page)]) == 0 and page.exists()
        assert _exit_code(["info", f"{address}/absent.touch"]) == 1
    stderr = capsys.readouterr().err
    assert "404" in stderr and "Traceback" not in stderr


def test_an_object_store_is_read_by_ranges(folder: Path) -> None:
    pytest.importorskip("obstore", reason="needs the extra remote")
    with (
        TouchReader((folder / "noise.touch").as_uri()) as remote_file,
        TouchReader(folder / "noise.touch") as local_file,
    ):
        assert remote_file._source.remote is not None and remote_file._source.remote.requests <= 3
        assert remote_file.read_segment(6) == local_file.read_segment(6)
    with pytest.raises(SourceError, match=r"absent\.touch"):
        TouchReader((folder / "absent.touch").as_uri())


def test_a_result_is_sent_to_an_object_store(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The bytes are those of a local file; a result that cannot be sent stays in the working folder."""
    pytest.importorskip("obstore", reason="needs the extra remote")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "store").mkdir()
    options = ["--nw", "4", "--coder", "touch"]
    assert _exit_code(["encode", "sample:shapes", "own.touch", *options]) == 0
    assert _exit_code(["encode", "sample:shapes", (tmp_path / "store/far.touch").as_uri(), *options]) == 0
    assert (tmp_path / "store/far.touch").read_bytes() == (tmp_path / "own.touch").read_bytes()
    assert not list(tmp_path.glob("*.unsent"))
    capsys.readouterr()
    assert _exit_code(["encode", "sample:shapes", "https://127.0.0.1:9/far.touch", *options]) == 2
    assert "only read" in capsys.readouterr().err
    (tmp_path / "file").touch()
    assert _exit_code(["encode", "sample:shapes", (tmp_path / "file/far.touch").as_uri(), *options]) == 1
    assert (tmp_path / "far.touch.unsent").read_bytes() == (tmp_path / "own.touch").read_bytes()
    assert "Traceback" not in capsys.readouterr().err


def _drip(link: socket.socket) -> None:
    link.sendall(b"HTTP/1.1 206 x\r\nContent-Length: 4096\r\nContent-Range: bytes 0-4095/100000\r\n\r\n")
    for _ in range(40):
        link.sendall(b"x")
        threading.Event().wait(0.05)


def _drip_head(link: socket.socket) -> None:
    link.sendall(b"HTTP/1.1 206 x\r\n")
    for _ in range(100):
        link.sendall(b"x")
        threading.Event().wait(0.05)


def _go_on(link: socket.socket) -> None:
    for _ in range(100):
        link.sendall(b"HTTP/1.1 100 Continue\r\n\r\n")
        threading.Event().wait(0.05)


def _flood(link: socket.socket) -> None:
    link.sendall(b"HTTP/1.1 206 x\r\nContent-Range: bytes 0-4095/100000\r\n\r\n")
    for _ in range(10_000):
        link.sendall(bytes(65536))


OPENING = b"\x89TOUCH\r\n\x1a\n\x01\x00\x00\x00"


@pytest.mark.parametrize(
    ("answers", "message"),
    [
        ((b"HTTP/1.1 200 OK\r\nContent-Length: 3\r\n\r\nabc",), "does not answer ranges"),
        ((b"HTTP/1.1 416 Range Not Satisfiable\r\nContent-Length: 0\r\n\r\n",), "416"),
        ((b"HTTP/1.1 206 x\r\nContent-Length: 3\r\n\r\nabc",), "206"),
        ((partial(bytes(4096), 7, 9000),), "bytes 7 to"),
        ((partial(bytes(8192), 0, 9000),), "bytes 0 to 8191"),
        ((b"HTTP/1.1 302 x\r\nContent-Length: 0\r\nLocation: /x.touch\r\n\r\n",), "redirections"),
        ((b"HTTP/1.1 302 x\r\nContent-Length: 0\r\nLocation: file:///etc/passwd\r\n\r\n",), "not http"),
        ((b"nonsense\r\n\r\n",), "nonsense"),
        ((partial(OPENING.ljust(4096), 0, 1 << 50),), "bytes 0 to 4095"),
        ((partial(OPENING + bytes(4082), 0, 20000), partial(bytes(4096), 15904, 30000)), "bytes 15904"),
        (
            (partial(OPENING + bytes(4082), 0, 20000), partial(bytes(15904), 4096, 20000, '"b"')),
            "another file now",
        ),
        ((partial(OPENING + bytes(4082), 0, 20000)[:900],), "timed out|Incomplete|expected"),
        ((lambda link: None,), "closed"),
        ((_drip,), "stalled"),
        ((_drip_head,), "stalled"),
        ((_go_on,), "stalled"),
        ((b"HTTP/1.1 404 \x1b[2J\x07\r\nContent-Length: 0\r\n\r\n",), r"404 \\x1b\[2J\\x07"),
        ((_flood,), "bytes 0 to 4095|HEAD"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else "x",
)
def test_a_misbehaving_server_is_an_error_at_once(
    answers: tuple[Callable[[socket.socket], None] | bytes, ...],
    message: str,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote, "_TIMEOUT_S", 0.5)
    with answering(*answers) as url, pytest.raises(TouchfieldError, match=message) as caught:
        TouchReader(url)
    assert url in str(caught.value)


def test_an_ended_connection_is_renewed(folder: Path) -> None:
    data = (folder / "noise.touch").read_bytes()

    def once(link: socket.socket, start: int, stop: int) -> None:
        answer = partial(data[start:stop], start, len(data))
        link.sendall(answer)

    size = len(data)
    tail = max(4096, size - 16384)
    first = (lambda link: once(link, 0, 4096)), (lambda link: once(link, tail, size))
    with answering(*first) as url:
        remote_file = remote.RemoteFile(url)
        assert (
            remote_file.read_at(100, 50) == data[100:150] and remote_file.read_at(size - 60, 60) == data[-60:]
        )


def test_errors_contain_no_secrets(folder: Path) -> None:
    with served(folder, Access(token="long enough")) as address:
        assert TouchReader(f"{address}/noise.touch?token=long%20enough").name == f"{address}/noise.touch"
        with pytest.raises(SourceError, match="401") as caught:
            TouchReader(f"{address}/noise.touch?token=another-word")
        assert "another-word" not in str(caught.value)


def raw_response(address: str, line: str, *headers: str) -> str:
    """The response to a request that is sent verbatim."""
    host, port = address.removeprefix("http://").split(":")
    with socket.create_connection((host, int(port)), timeout=5) as link:
        header_lines = (
            headers if any(h.startswith("Host") for h in headers) else (f"Host: {host}:{port}", *headers)
        )
        link.sendall("\r\n".join([f"{line} HTTP/1.1", *header_lines, "Connection: close", "", ""]).encode())
        parts = []
        while part := link.recv(65536):
            parts.append(part)
    return b"".join(parts).decode("latin-1")


@pytest.mark.parametrize(
    "name",
    [
        "/",
        "/notes.txt",
        "/.hidden.touch",
        "/../x.touch",
        "/%2e%2e/x.touch",
        "/a/..%2f..%2fx.touch",
        "/out.touch",
        "/noise.touch/",
        "//noise.touch",
        "/noise.touch%00",
        "/..\\x.touch",
        "/absent.touch",
        "/ring.touch",
    ],
)
def test_nothing_but_the_streams_of_the_folder_is_served(folder: Path, name: str, tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    for file in folder.iterdir():
        (inside / file.name).write_bytes(file.read_bytes())
    (tmp_path / "x.touch").write_bytes(b"secret")
    (inside / "out.touch").symlink_to(tmp_path / "x.touch")
    (inside / "ring.touch").symlink_to(inside / "ring.touch")
    with served(inside) as address:
        answer = raw_response(address, f"GET {name}")
        assert answer.startswith("HTTP/1.1 4") and "secret" not in answer and "private" not in answer
        assert raw_response(address, "GET /noise.touch").startswith("HTTP/1.1 200")


def test_only_allowed_origins_read_a_folder(folder: Path) -> None:
    with served(folder, Access(origins=("https://a.example",))) as address:
        good = raw_response(address, "GET /noise.touch", "Origin: https://a.example", "Range: bytes=0-3")
        assert "Access-Control-Allow-Origin: https://a.example" in good and good.startswith("HTTP/1.1 206")
        assert "Access-Control" not in raw_response(address, "GET /noise.touch", "Origin: https://b.example")
        assert "Allow-Headers: Range" in raw_response(
            address, "OPTIONS /noise.touch", "Origin: https://a.example"
        )
        assert raw_response(address, "GET /noise.touch", "Host: evil.example").startswith("HTTP/1.1 403")
        assert raw_response(address, "POST /noise.touch", "Content-Length: 0").startswith("HTTP/1.1 405")


def test_addresses_of_a_folder_are_printed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    async def run(served: object, access: Access, ready: Callable[[str], None], until: object) -> None:
        ready("[::1]:80")

    monkeypatch.setattr(server, "run", run)
    lines: list[str] = []
    server.serve(tmp_path, Access(), lines.append)
    assert lines.pop() == f"{tmp_path} holds no .touch file yet"
    for n in range(22):
        (tmp_path / f"{n:02d} a.touch").touch()
    server.serve(tmp_path, Access(token="a long word"), lines.append, Pages("", ""))
    assert lines[:20] == [f"http://[::1]:80/{n:02d}%20a.touch?token=..." for n in range(20)]
    assert lines[20:] == ["in a browser: http://[::1]:80/view/00%20a.touch?token=...", "and 2 more"]


def test_a_public_address_needs_a_token(folder: Path) -> None:
    with pytest.raises(TouchfieldError, match="--token"):
        Access("0.0.0.0")
    assert (
        Access("0.0.0.0", token="12345678") and Access("::", is_open=True) and Access("localhost", port=65535)
    )
    for port in (-1, 65536):
        with pytest.raises(TouchfieldError, match="0 to 65535"):
            Access(port=port)
    with served(folder, Access(token="a long word")) as address:
        for word, status in (("Bearer a long word", 206), ("Bearer a long", 401), ("", 401)):
            answer = raw_response(address, "GET /noise.touch", f"Authorization: {word}", "Range: bytes=0-3")
            assert answer.startswith(f"HTTP/1.1 {status}")
    with pytest.raises(TouchfieldError, match="8 or more"):
        Access(token="short")
    with pytest.raises(TouchfieldError, match="no folder"):
        application(folder / "absent", Access())


def test_a_client_that_does_not_read_is_dropped(
    folder: Path, client_dropped: threading.Event, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(file_response, "_PATIENCE_S", 0.3)
    monkeypatch.setattr(file_response, "_SLOWEST", 1 << 40)
    (folder / "large.touch").write_bytes(bytes(1 << 25))
    with served(folder) as address:
        host, port = address.removeprefix("http://").split(":")
        with socket.create_connection((host, int(port)), timeout=5) as link:
            link.sendall(f"GET /large.touch HTTP/1.1\r\nHost: {host}:{port}\r\n\r\n".encode())
            assert client_dropped.wait(30)
            received = 0
            with suppress(ConnectionError):
                while part := link.recv(1 << 20):
                    received += len(part)
        assert received < 1 << 25
        assert raw_response(address, "GET /noise.touch", "Range: bytes=0-3").startswith("HTTP/1.1 206")
    (folder / "large.touch").unlink()


def test_ranges_are_served_on_one_connection(folder: Path) -> None:
    with served(folder) as address, TouchReader(f"{address}/noise.touch") as remote_file:
        link = remote_file._source.remote._store._link  # type: ignore[union-attr]
        for i in (0, 5, 2):
            remote_file.read_segment(i)
        assert link is not None and remote_file._source.remote._store._link is link  # type: ignore[union-attr]

"""Hostile requests: whatever the header, name or method, the answer is that to a client, and no traceback."""

from __future__ import annotations

import logging
import os
import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

import pytest

from live_makers import sender_of
from touchfield.network import file_response, server
from touchfield.network.access import Access, Background, Pages, web
from touchfield.network.bridge import Bridge
from touchfield.network.file_response import parse_ranges
from touchfield.network.live_server import LiveServer
from touchfield.network.server import application

PAGES = Pages("<p>outer</p>", "<p>inner</p>")
TOKEN = "a long word"
ORIGINS = ("https://a.example", "*")
FILE = bytes(range(200))

needs_pipes = pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="this system has no named pipes")

UPGRADE = (
    b"Upgrade: websocket", b"Connection: Upgrade", b"Sec-WebSocket-Version: 13",
    b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
)  # fmt: skip

WORDS = (
    b"", b"x", b"\xff\xfe", b"\xed\xa0\x80", "٣".encode(), b"[", b"http://[x", b"http://[::1", b"0" * 5000,
    b"9" * 5000, b"-1", b"99999999999999999999", b",,,", b'"', b"%ff%fe", b"a=b; c", b"\t", b"*", b"null",
)  # fmt: skip
"""Values that are tried in every header."""

VALUES: dict[bytes, tuple[bytes, ...]] = {
    b"Host": (
        b"127.0.0.1:99999999", b"127.0.0.1:-1", b"127.0.0.1:x", b"[::1", b"::1", b"[::1]:80", b"[fe80::1%x]",
        b"evil.example", b"a@127.0.0.1", b"127.0.0.1/x", b"127.0.0.1?x", b"127.0.0.1#x", b"xn--\xff", b"a..b",
        b"127.0.0.1 x", b"1" * 300, b"0x7f.1", b"127.1",
    ),
    b"Origin": (b"http://[x]", b"http://evil.example", b"https://a.example", b"http://a:99999999"),
    b"Authorization": (
        b"Bearer", b"Bearer \xff\xfe", b"Bearer \xed\xa0\x80", b"Basic Og==", b"bearer a long word",
    ),
    b"Range": (
        b"bytes=-0", b"bytes=0-", b"bytes=-", b"bytes=5-2", b"bytes=0-1,4-5", b"bytes=-" + b"9" * 5000,
        b"bytes=" + b"9" * 5000 + b"-", b"items=0-1", b"bytes 0-1", b"BYTES=0-1", b"bytes=\xff-\xfe",
        "bytes=٣-٤".encode(), b"bytes=200-", b"bytes=0-0,", b"bytes=" + b"0-1," * 1500, b"=", b"bytes=1--1",
    ),
    b"If-Range": (b'"x"', b'W/"x"', b"Mon, 01 Jan 0000 00:00:00 GMT"),
    b"If-Modified-Since": (
        b"Mon, 99999999999999999999 Jan 2000 00:00:00 GMT", b"Mon, 01 Jan 0001 00:00:00 GMT",
        b"Fri, 31 Dec 9999 23:59:59 GMT", b"Mon, 01 Jan 2000 99:99:99 GMT", b"1 1 1 1 1 1",
        b"Mon, 1 Jan " + b"9" * 5000,
    ),
    b"If-Unmodified-Since": (
        b"Mon, 99999999999999999999 Jan 2000 00:00:00 GMT", b"Mon, 01 Jan 0001 00:00:00 GMT",
    ),
    b"If-Match": (b"*", b'"x"', b'W/"x"', b'"x', b'"\xff"'),
    b"If-None-Match": (b"*", b'"x"', b'W/"x"', b'"x', b'"\xff"'),
    b"Accept-Encoding": (b"gzip", b"br", b"gzip;q=x", b"identity;q=0, *;q=0"),
    b"Upgrade": (b"websocket", b"h2c", b"WebSocket, x"),
    b"Connection": (b"Upgrade", b"close, keep-alive", b"x" * 300),
    b"Sec-WebSocket-Key": (b"x", b"dGhl"),
    b"Sec-WebSocket-Version": (b"99", b"12, 13"),
    b"Sec-WebSocket-Extensions": (
        b"permessage-deflate; server_max_window_bits=99", b"permessage-deflate;" * 99,
    ),
    b"Sec-WebSocket-Protocol": (b"a, b", b"\xff, a"),
    b"Content-Length": (b"0", b"5", b"1e3", b"+1"),
    b"Transfer-Encoding": (b"chunked", b"gzip, x", b"chunked, chunked"),
    b"Content-Encoding": (b"gzip", b"zstd"),
    b"Content-Type": (b"multipart/form-data; boundary=", b"text/plain; charset=\xff"),
    b"Expect": (b"100-continue", b"200-ok"),
    b"Cookie": (b"a=\xff; =; ;", b"$Version=1; a"),
    b"Forwarded": (b"for=[::1;host=[x", b'by="'),
    b"X-Forwarded-Host": (b"[x",),
    b"Access-Control-Request-Method": (b"GET",),
    b"Te": (b"trailers",),
}  # fmt: skip

NAMES = (
    b"/%ff%fe", b"/%ed%a0%80", b"/%00", b"/%0a", b"/x%0ay.touch", b"//", b"/..", b"/%2e%2e/%2e%2e/etc/passwd",
    b"/\xff\xfe.touch", b"/live/999999999", b"/live/9999999999", b"/live/%D9%A3", b"/live/%C2%B2.touch",
    b"/live/-1", b"/live/0/", b"/coarse/live", b"/view/%ff", b"/view//", b"/?token=%ff%fe",
    b"/x.touch?token=%ed%a0%80",
    b"/live.json?token=%ff&token=x", b"/live?token", b"/x.touch?%", b"*", b"http://[::1/x.touch",
    b"http://a:99999999/",
    b"http://evil.example/live.json", b"evil.example:80", b"/" + b"a" * 20_000, b"/" + b"a/" * 3000, b"/%",
    b"/%zz",
    b"/x.touch;x", b"/x.touch#x", b"/con", b"/" + b"a" * 300 + b".touch", b"",
)  # fmt: skip

METHODS = (
    b"HEAD", b"POST", b"PUT", b"DELETE", b"OPTIONS", b"TRACE", b"CONNECT", b"PATCH", b"PRI", b"get",
    b"G\xff", b"A" * 9000,
)  # fmt: skip

ENDPOINTS = {
    "folder": (b"/x.touch", b"/view/x.touch", b"/view-page.html", b"/absent.touch"),
    "live": (
        b"/live",
        b"/live.json",
        b"/live/opening",
        b"/live/0",
        b"/live/0.touch",
        b"/view",
        b"/coarse/live.json",
    ),
    "bridge": (b"/hand", b"/x.touch", b"/view/x.touch", b"/absent"),
}


class FolderServer(Background):
    """The server of a folder in a thread."""

    def __init__(self, folder: Path, access: Access, pages: Pages | None = None) -> None:
        super().__init__(access, pages)
        self._folder = folder

    def _application(self) -> web.Application:
        return application(self._folder, self._access, self._pages)


@contextmanager
def serving(kind: str, folder: Path, token: str | None = None) -> Iterator[str]:
    """The address of a server of this kind, which has `x.touch` or a live stream with a coarse layer."""
    access = Access(port=0, token=token, origins=ORIGINS)
    (folder / "x.touch").write_bytes(FILE)
    server: Background
    if kind == "live":
        server = LiveServer(sender_of(1)[0], access, PAGES, coarse=sender_of(1)[0])
    else:
        server = (
            FolderServer(folder, access, PAGES)
            if kind == "folder"
            else Bridge(folder / "x.touch", access, PAGES)
        )
    with server:
        yield server.address


def response_to(address: str, line: bytes, *headers: bytes) -> bytes:
    """The first bytes of the response to a request, and all of them if the connection is to be closed.

    A Host is added unless the headers have one.
    """
    host, port = address.rsplit(":", 1)
    if not any(header.startswith(b"Host:") for header in headers):
        headers = (b"Host: " + address.encode(), *headers)
    with socket.create_connection((host, int(port)), timeout=10) as link:
        link.sendall(b"\r\n".join((line + b" HTTP/1.1", *headers, b"", b"")))
        if b"Connection: close" not in headers:
            return link.recv(65536)
        return b"".join(iter(lambda: link.recv(65536), b""))


def is_answered(response: bytes) -> bool:
    """True if the status is that of a success, of a fault of the client, or of a changed protocol."""
    status = int(response.split(b" ", 2)[1]) if response.startswith(b"HTTP/1.") else 0
    return status in (101, 304) or 200 <= status < 300 or 400 <= status < 500


@pytest.mark.parametrize("token", [None, TOKEN])
@pytest.mark.parametrize("kind", ENDPOINTS)
def test_every_header_gets_an_answer(
    kind: str, token: str | None, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """Each hostile value at each address, as a plain request and as a WebSocket's."""
    caplog.set_level(logging.WARNING)
    query = b"" if token is None else b"?token=a%20long%20word"
    refused = []
    with serving(kind, tmp_path, token) as address:
        requests = [
            (b"GET " + path + query, (*others, name + b": " + value))
            for path in ENDPOINTS[kind]
            for others in ((), UPGRADE)[: 1 + path.endswith((b"live", b"hand"))]
            for name, values in VALUES.items()
            for value in (*WORDS, *values)
        ]
        requests += [(b"GET " + name, ()) for name in NAMES]
        requests += [(method + b" " + path + query, ()) for method in METHODS for path in ENDPOINTS[kind]]
        for line, headers in requests:
            response = response_to(address, line, *headers)
            if not is_answered(response):
                refused.append((line[:80], headers[-1:], response[:80]))
        usual = b"/live.json" if kind == "live" else b"/x.touch"
        assert response_to(address, b"GET " + usual + query).startswith(b"HTTP/1.1 200")
    assert not refused
    faults = [record for record in caplog.records if record.exc_info or record.levelno >= logging.ERROR]
    assert [record.getMessage() for record in faults] == []


def test_requests_that_name_another_host_or_token_are_refused(tmp_path: Path) -> None:
    with serving("folder", tmp_path, "ä long word") as address:
        for headers, status in (
            ((b"Host: 127.0.0.1:99999999",), b"400"),
            ((b"Host: evil.example",), b"403"),
            ((b"Authorization: Bearer \xff\xfe",), b"401"),
            (("Authorization: Bearer ä long word".encode(),), b"200"),
            ((*UPGRADE, b"Origin: http://[x"), b"403"),
            ((*UPGRADE, b"Origin: http://evil.\xff"), b"403"),
        ):
            assert response_to(address, b"GET /x.touch", *headers).split(b" ")[1] == status
        good = response_to(address, b"GET /x.touch?token=%C3%A4+long+word", b"Origin: http://other.example")
        assert b"Access-Control-Allow-Origin: http://other.example" in good


def body_of(response: bytes) -> tuple[int, bytes]:
    head, _, body = response.partition(b"\r\n\r\n")
    return int(head.split(b" ")[1]), body


@pytest.mark.parametrize("kind", ["folder", "bridge"])
def test_ranges_and_conditions_follow_rfc_9110(kind: str, tmp_path: Path) -> None:
    with serving(kind, tmp_path) as address:

        def get(*headers: str, method: str = "GET") -> tuple[int, bytes, bytes]:
            lines = [header.encode() for header in ("Connection: close", *headers)]
            data = response_to(address, method.encode() + b" /x.touch", *lines)
            return (*body_of(data), data.partition(b"\r\n\r\n")[0])

        status, body, head = get()
        assert (status, body) == (200, FILE) and b"Accept-Ranges: bytes" in head
        fields = dict(line.split(": ", 1) for line in head.decode().split("\r\n")[1:])
        tag, date = fields["Etag"], fields["Last-Modified"]
        for headers, expected in (
            (("Range: bytes=2-4",), (206, FILE[2:5])),
            (("Range: bytes=-3",), (206, FILE[-3:])),
            (("Range: bytes=190-999",), (206, FILE[190:])),
            (("Range: bytes=-0",), (416, b"")),
            (("Range: bytes=200-",), (416, b"")),
            (("Range: items=0-1",), (200, FILE)),
            (("Range: bytes=5-2",), (200, FILE)),
            (("Range: bytes=0-1,4-5",), (200, FILE)),
            (("Range: bytes=0-1", f"If-Range: {tag}"), (206, FILE[:2])),
            (("Range: bytes=0-1", f"If-Range: {date}"), (206, FILE[:2])),
            (("Range: bytes=0-1", 'If-Range: "other"'), (200, FILE)),
            (("Range: bytes=0-1", f"If-Range: W/{tag}"), (200, FILE)),
            (("Range: bytes=0-1", "If-Range: Mon, 01 Jan 2001 00:00:00 GMT"), (200, FILE)),
            (("If-None-Match: " + tag, "Range: bytes=0-1"), (304, b"")),
            (("If-Modified-Since: " + date,), (304, b"")),
            (("If-Modified-Since: " + date, 'If-None-Match: "other"'), (200, FILE)),
            (("If-Match: " + tag, "If-Unmodified-Since: Mon, 01 Jan 2001 00:00:00 GMT"), (200, FILE)),
            (('If-Match: "other"',), (412, b"")),
            (("If-Unmodified-Since: Mon, 01 Jan 2001 00:00:00 GMT",), (412, b"")),
            (("Accept-Encoding: gzip, br",), (200, FILE)),
        ):
            assert get(*headers)[:2] == expected, headers
        assert b"Content-Range: bytes 2-4/200" in get("Range: bytes=2-4")[2]
        assert b"Content-Range: bytes */200" in get("Range: bytes=-0")[2]
        status, body, head = get("Range: bytes=2-4", method="HEAD")
        assert (status, body) == (200, b"") and b"Content-Length: 200" in head
        (tmp_path / "x.touch").write_bytes(b"")
        assert get()[:2] == (200, b"") and get("Range: bytes=0-")[0] == get("Range: bytes=-5")[0] == 416


def test_several_ranges_are_parsed() -> None:
    assert parse_ranges("bytes=0-1, 4-, -2,", 10) == [(0, 1), (4, 9), (8, 9)]
    assert parse_ranges("bytes=20-,-0,9-30", 10) == [(9, 9)]
    assert parse_ranges(f"bytes=-{'9' * 5000}", 10) == [(0, 9)] and parse_ranges("bytes=007-", 10) == [(7, 9)]


def test_a_file_that_shrinks_ends_the_connection(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A client never takes a part for the whole."""
    monkeypatch.setattr(file_response, "_CHUNK", 10)
    opened = file_response._open_plain

    def shortened(path: Path) -> object:
        file = opened(path)
        real_size = os.fstat(file.fileno()).st_size  # type: ignore[union-attr]
        assert real_size == len(FILE)

        class Short:
            """A file of which 50 bytes are left once it is read."""

            def __enter__(self) -> Short:
                return self

            def __exit__(self, *_: object) -> None:
                file.close()  # type: ignore[union-attr]

            def fileno(self) -> int:
                return file.fileno()  # type: ignore[union-attr]

            def seek(self, offset: int) -> int:
                os.truncate(path, 50)
                return file.seek(offset)  # type: ignore[union-attr]

            def read(self, count: int) -> bytes:
                return file.read(count)  # type: ignore[union-attr]

        return Short()

    monkeypatch.setattr(file_response, "_open_plain", shortened)
    with serving("folder", tmp_path) as address:
        host, port = address.rsplit(":", 1)
        with socket.create_connection((host, int(port)), timeout=10) as link:
            link.sendall(f"GET /x.touch HTTP/1.1\r\nHost: {address}\r\n\r\n".encode())
            data = b""
            try:
                while part := link.recv(65536):
                    data += part
            except ConnectionError:
                pass
    assert b"Content-Length: 200" in data and len(body_of(data)[1]) <= 50


HOSTILE_FILES = (
    "a/ok.touch",
    "UPPER.TOUCH",
    "a b+%41.touch",
    "line\nfeed.touch",
    "r\u202etl.touch",
    "zw\u200cnj.touch",
)
"""Names that are listed and sent."""


@needs_pipes
def test_what_is_listed_is_what_is_sent(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Hidden files, FIFOs, links that lead outside and names without an address are neither, and counted."""
    root = tmp_path / "streams"
    for name in (*HOSTILE_FILES, ".hidden.touch", ".git/x.touch", "back\\slash.touch", "view/x.touch"):
        (root / name).parent.mkdir(parents=True, exist_ok=True)
        (root / name).write_bytes(name.encode())
    (root / ".left.0123abcd.touch").write_bytes(b"left by a run that was killed")
    (root / "folder.touch").mkdir()
    (tmp_path / "outside.touch").write_bytes(b"outside")
    (root / "outside.touch").symlink_to(tmp_path / "outside.touch")
    (root / "inside.touch").symlink_to(root / "a/ok.touch")
    (root / "ok.touch.gz").write_bytes(b"stale")
    (root / "a/ok.touch.gz").write_bytes(b"stale")
    os.mkfifo(root / "pipe.touch")
    with ExitStack() as stack:
        try:
            (root / os.fsdecode(b"\xff.touch")).write_bytes(b"x")
            count = 8
        except OSError:  # a file system of Unicode names
            count = 7
        lines = list[str]()

        async def run(served: object, access: Access, ready: object, until: object) -> None:
            ready(address)  # type: ignore[operator]

        address = stack.enter_context(FolderServer(root, Access(port=0), PAGES)).address
        monkeypatch.setattr(server, "run", run)
        server.serve(root, Access(port=0), lines.append, PAGES)
        links = [line for line in lines if line.startswith("http://")]
        assert len(links) == len(HOSTILE_FILES) + 1
        for link in links:
            path = link.removeprefix(f"http://{address}").encode()
            status, body = body_of(
                response_to(address, b"GET " + path, b"Accept-Encoding: gzip, br", b"Connection: close")
            )
            assert status == 200 and body != b"stale" and body.decode() in HOSTILE_FILES
        assert f"not served: {count} .touch files" in lines[-1] and "0123abcd" not in "".join(lines)
        for name in (
            b".hidden",
            b".git/x",
            b"back%5Cslash",
            b"folder",
            b"outside",
            b"pipe",
            b"%FF",
            b".left.0123abcd",
        ):
            assert body_of(response_to(address, b"GET /" + name + b".touch"))[0] == 404


@needs_pipes
def test_a_path_that_becomes_a_pipe_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "x.touch")
    assert file_response._open_plain(tmp_path / "x.touch") is None
    assert file_response._open_plain(tmp_path / "absent") is None

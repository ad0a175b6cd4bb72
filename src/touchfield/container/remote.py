"""Reads ``.touch`` files over HTTP or from an object store, by requests for the byte ranges that are needed.

The files lie on a web server or in an object store. Opening takes three requests: the head together with the
length of the file, the end with the index, and any part of the index that lies before. Servers are not
trusted: only requested bytes are read, no answer may take longer than its size justifies, and a file that
changes while it is read is an error.
"""

from __future__ import annotations

import http.client
import io
import re
import time
from collections import OrderedDict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from threading import Lock
from typing import Any, Final, NamedTuple
from urllib.parse import urljoin, urlsplit

from touchfield.errors import InvalidArgument, SourceError, import_extra
from touchfield.files import is_remote as is_remote, url_path, without_secret as without_secret

_HEAD: Final = 1 << 12
_TAIL: Final = 1 << 14
_MIN_REQUEST: Final = 1 << 12
"""Smallest request in bytes, enough for a few records and their frames."""

_MAX_CACHED: Final = 1 << 25
_MAX_REDIRECTS: Final = 5
_TIMEOUT_S: Final = 10.0
_MIN_RATE: Final = 1 << 14
"""Slowest accepted answer in bytes per second, in addition to `_TIMEOUT_S`."""

_CHUNK: Final = 1 << 16
_RANGE: Final = re.compile(r"bytes (\d{1,18})-(\d{1,18})/(\d{1,18})")


class _Part(NamedTuple):
    """Part of a file.

    `size` is the length of the whole file, `tag` identifies its version.
    """

    data: bytes
    size: int
    tag: str


def is_live(name: object) -> bool:
    """True for the address of a live stream.

    These are ws://HOST:PORT/live, http://HOST:PORT/live.json, udp://HOST:PORT, and - for a pipe.
    """
    return isinstance(name, str) and (
        name == "-"
        or name.lower().startswith(("ws://", "wss://", "udp://"))
        or (name.lower().startswith(("http://", "https://")) and url_path(name).endswith("/live.json"))
    )


def sender(url: str) -> Callable[[Path], None]:
    """A function that puts a file into an object store (extra ``remote``).

    The file appears there only when it is complete. InvalidArgument for a web server, which cannot be written
    to; SourceError, now or when the function is called, if the store refuses.
    """
    return _writable_store(url).put


def folder_sender(url: str, last: str) -> Callable[[Path], None]:
    """A function that puts all files of a folder into an object store, below an address (extra ``remote``).

    The file `last`, without which the folder cannot be opened, goes last. Errors are those of `sender`; also
    InvalidArgument if something is there already.
    """
    store = _writable_store(f"{url.rstrip('/')}/{last}")
    store.require_empty_folder()

    def put(folder: Path) -> None:
        files = sorted(file for file in folder.rglob("*") if file.is_file())
        for file in sorted(files, key=lambda file: file == folder / last):
            store.put(file, file.relative_to(folder).as_posix())

    return put


def _writable_store(url: str) -> _ObjectStore:
    if url.lower().startswith(("http://", "https://")) or is_live(url):
        raise InvalidArgument(
            without_secret(url), "an address that is only read", "s3://, gs://, az://, or a path"
        )
    return _ObjectStore(url)


class RemoteFile:
    """Random access to a remote file, with a cache of the latest 32 MiB; thread-safe.

    `url` is http or https; s3, gs, az and others need the extra ``remote``. `size` is the length of the file
    in bytes; `requests` and `received` count requests and bytes so far. `SourceError` if there is no such
    file, the server does not answer ranges, or it takes too long.
    """

    def __init__(self, url: str) -> None:
        self.name, self.requests, self.received = without_secret(url), 0, 0
        self._lock = Lock()
        self._cache: OrderedDict[int, bytes] = OrderedDict()
        self._store: _Http | _ObjectStore
        self._store = (
            _Http(url, self.name) if url.lower().startswith(("http://", "https://")) else _ObjectStore(url)
        )
        first = self._store.get(0, _HEAD)
        self.size, self._tag = first.size, first.tag
        self._store_part(0, first)
        if self.size > _HEAD:
            self.fetch(max(_HEAD, self.size - _TAIL), self.size)

    def fetch(self, start: int, stop: int) -> None:
        """Fetch bytes `start` to `stop` in one request, unless they are cached."""
        with self._lock:
            self._part(start, min(stop, self.size) - start)

    def read_at(self, offset: int, size: int) -> bytes:
        """`size` bytes from `offset` on, all within the file."""
        with self._lock:
            return self._part(offset, size)

    def close(self) -> None:
        """Close the connection."""
        self._store.close()

    def _part(self, offset: int, size: int) -> bytes:
        for start, data in reversed(self._cache.items()):
            if start <= offset and offset + size <= start + len(data):
                self._cache.move_to_end(start)
                return data[offset - start : offset - start + size]
        if size <= 0:
            return b""
        part = self._store.get(offset, min(max(size, _MIN_REQUEST), self.size - offset))
        if part.size != self.size or part.tag != self._tag:
            self.close()
            was, now = f"{self.size} bytes {self._tag}".strip(), f"{part.size} bytes {part.tag}".strip()
            raise SourceError(self.name, f"another file now: {now}", f"{was}, as before", "Open it again.")
        self._store_part(offset, part)
        if len(part.data) < size:
            raise SourceError(
                self.name, f"{len(part.data)} bytes at byte {offset}", f"{size} bytes", "Open it again."
            )
        return part.data[:size]

    def _store_part(self, offset: int, part: _Part) -> None:
        self.requests, self.received = self.requests + 1, self.received + len(part.data)
        self._cache[offset] = part.data
        while len(self._cache) > 1 and sum(map(len, self._cache.values())) > _MAX_CACHED:
            self._cache.popitem(last=False)


class _Timely(io.RawIOBase):
    """Raw stream of a connection that raises TimeoutError after a deadline."""

    def __init__(self, raw: io.RawIOBase, deadline: float) -> None:
        self._raw, self._deadline = raw, deadline

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int | None:
        if time.monotonic() > self._deadline:
            raise TimeoutError("an answer that began, and then stalled")
        return self._raw.readinto(buffer)

    def close(self) -> None:
        self._raw.close()
        super().close()


class _Answer(http.client.HTTPResponse):
    """An HTTP response with a deadline, which also applies to its head."""

    def __init__(self, deadline: float, *args: Any, **more: Any) -> None:
        super().__init__(*args, **more)
        self.fp = io.BufferedReader(_Timely(self.fp.detach(), deadline))


class _Http:
    """A file on a web server, read by ranges over one persistent connection."""

    def __init__(self, url: str, name: str) -> None:
        self._url, self._name = url, name
        self._link: http.client.HTTPConnection | None = None

    def get(self, offset: int, size: int) -> _Part:
        """Fetch at most `size` bytes from `offset` on."""
        for _ in range(_MAX_REDIRECTS + 1):
            try:
                with self._request(offset, size) as answer:
                    if answer.status not in (301, 302, 303, 307, 308):
                        return self._part(answer, offset, size)
                self._url = urljoin(self._url, answer.getheader("Location") or "")
                self.close()
            except (OSError, http.client.HTTPException, ValueError) as error:
                self.close()
                raise self._error(str(error) or type(error).__name__) from None
        raise self._error(f"more than {_MAX_REDIRECTS} redirections")

    def close(self) -> None:
        """Close the connection."""
        if self._link is not None:
            self._link.close()
            self._link = None

    def _request(self, offset: int, size: int) -> http.client.HTTPResponse:
        """Request a range on the current connection or, if it has ended, on a new one."""
        to = urlsplit(self._url)
        if to.scheme not in ("http", "https") or not to.hostname:
            raise self._error("an address that is not http or https")
        path = (to.path or "/") + (f"?{to.query}" if to.query else "")
        headers = {"Range": f"bytes={offset}-{offset + size - 1}", "Accept-Encoding": "identity"}
        while True:
            is_new = self._link is None
            if self._link is None:
                link = http.client.HTTPSConnection if to.scheme == "https" else http.client.HTTPConnection
                self._link = link(to.hostname, to.port, timeout=_TIMEOUT_S)
            deadline = time.monotonic() + _TIMEOUT_S + size / _MIN_RATE
            self._link.response_class = partial(_Answer, deadline)  # type: ignore[assignment]
            try:
                self._link.request("GET", path, headers=headers)
                return self._link.getresponse()
            except (ConnectionError, http.client.CannotSendRequest):
                self.close()
                if is_new:
                    raise

    def _part(self, answer: http.client.HTTPResponse, offset: int, size: int) -> _Part:
        content = _RANGE.fullmatch(answer.getheader("Content-Range") or "")
        if answer.status == 200:
            mend = "Serve it with one that does, such as: touchfield serve FOLDER."
            raise self._error("a server that does not answer ranges", mend)
        if answer.status != 206 or content is None:
            mend = "Check the address." if answer.status in (403, 404, 410) else ""
            raise self._error(f"{answer.status} {answer.reason}"[:80], mend)
        start, last, size_of_file = map(int, content.groups())
        if start != offset or not start <= last < min(start + size, size_of_file):
            raise self._error(
                f"bytes {start} to {last} of {size_of_file}, where {size} from {offset} were requested"
            )
        data = bytearray()
        while len(data) <= last - start:
            more = answer.read1(min(_CHUNK, last - start + 1 - len(data)))
            if not more:
                break
            data += more
        if answer.length != 0:  # close rather than read what was not requested; otherwise keep the connection
            self.close()
        return _Part(
            bytes(data), size_of_file, answer.getheader("ETag") or answer.getheader("Last-Modified") or ""
        )

    def _error(self, found: str, mend: str = "") -> SourceError:
        self.close()
        return SourceError(self._name, found, "a .touch file on a server that answers ranges", mend)


class _ObjectStore:
    """A file in an object store supported by obstore."""

    def __init__(self, url: str) -> None:
        self._name = without_secret(url)
        self._ask = import_extra("obstore", self._name, "obstore", "remote")
        folder, _, self._path = url.rpartition("/")
        with self._translated_errors():
            self._store = self._ask.store.from_url(folder)

    def get(self, offset: int, size: int) -> _Part:
        """Fetch at most `size` bytes from `offset` on."""
        with self._translated_errors():
            answer = self._ask.get(self._store, self._path, options={"range": (offset, offset + size)})
            data, meta = bytes(answer.bytes()), answer.meta
            if answer.range != (offset, min(offset + size, meta["size"])):
                raise ValueError(f"bytes {answer.range}, where {size} from {offset} were requested")
        return _Part(data, meta["size"], str(meta.get("e_tag") or ""))

    def put(self, file: Path, name: str | None = None) -> None:
        """Write a file, in parts if it is large; `name` is its path in the folder of the address."""
        with self._translated_errors("a store that can be written"):
            self._ask.put(self._store, name or self._path, file)

    def require_empty_folder(self) -> None:
        """InvalidArgument if the folder of the address has a file."""
        with self._translated_errors("a store that can be listed"):
            first = next(iter(self._ask.list(self._store, chunk_size=1)), None)
        if first:
            folder = self._name.rpartition("/")[0]
            raise InvalidArgument(
                folder, "something there already", "a new name", "Remove it, or take another name."
            )

    def close(self) -> None:
        """Do nothing: obstore has no connection that must be closed."""

    @contextmanager
    def _translated_errors(
        self, expected: str = "a .touch file in a store that can be read"
    ) -> Iterator[None]:
        try:
            yield
        except Exception as error:  # errors of obstore and of each kind of store
            found = str(error).partition("\n")[0][:200]
            raise SourceError(self._name, found, expected) from None

"""Answers a request with a plain file or one range of its bytes, by the rules of RFC 9110.

Nothing but the file itself is sent: no compressed neighbour takes its place, as `aiohttp.web.FileResponse`
has it. Conditions (section 13) are evaluated before the range (section 14), of the file that was opened.
"""

from __future__ import annotations

import asyncio
import os
import re
import stat
from collections.abc import Callable, Mapping
from contextlib import suppress
from datetime import datetime
from pathlib import Path
from typing import BinaryIO, Final, NamedTuple

from touchfield.network.access import dropped_unless_read, web

_PATIENCE_S: Final = 30.0
_SLOWEST: Final = 1 << 14
"""Minimum rate of a client in bytes a second, in addition to the patience."""

_CHUNK: Final = 1 << 18
_MAX_DIGITS: Final = 18
"""Digits of a position that is converted; a longer one lies behind the end of any file."""


class _Version(NamedTuple):
    """What a client may ask about the opened file."""

    size: int
    modified_s: int
    etag: str


async def send_file(request: web.Request, path: Path, headers: Mapping[str, str]) -> web.StreamResponse:
    """Send a plain file, or the range that the request asks for; return the response.

    A client that reads more slowly than `_SLOWEST` after `_PATIENCE_S` is dropped. Raises HTTPNotFound if the
    path is no plain file, or cannot be opened.
    """
    file = await asyncio.to_thread(_open_plain, path)
    if file is None:
        raise web.HTTPNotFound(text="no such file")
    with file:
        information = os.fstat(file.fileno())
        modified_s, size = int(information.st_mtime), information.st_size
        version = _Version(size, modified_s, f"{information.st_mtime_ns:x}-{size:x}")
        response = web.StreamResponse(headers={**headers, "Accept-Ranges": "bytes"})
        response.etag, response.last_modified = version.etag, modified_s
        status = _failed_condition(request, version)
        if status is not None:
            return web.Response(status=status, headers=response.headers)
        first, count = _select(request, version, response)
        response.content_length = count
        with suppress(ConnectionError):  # the client has left, or was dropped
            async with dropped_unless_read(request, _PATIENCE_S + count / _SLOWEST):
                await response.prepare(request)
                if request.method != "HEAD" and count:
                    await _write(request, response, file, first, count)
                await response.write_eof()
    return response


def _open_plain(path: Path) -> BinaryIO | None:
    """Open a plain file; None for anything else. Opening a FIFO does not wait for its writer."""
    flags = os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    try:
        handle = os.open(path, flags)
    except OSError:
        return None
    if stat.S_ISREG(os.fstat(handle).st_mode):
        return os.fdopen(handle, "rb")
    os.close(handle)
    return None


async def _write(
    request: web.Request, response: web.StreamResponse, file: BinaryIO, first: int, count: int
) -> None:
    """Write bytes of the file; end the connection if the file is now shorter than was announced."""
    file.seek(first)
    while count:
        chunk = await asyncio.to_thread(file.read, min(count, _CHUNK))
        if not chunk:
            if request.transport is not None:
                request.transport.abort()
            raise ConnectionResetError("the file has become shorter")
        await response.write(chunk)
        count -= len(chunk)


def _failed_condition(request: web.Request, version: _Version) -> int | None:
    """Return the status of a condition that does not hold (RFC 9110, section 13.2.2); None if all hold."""
    match, none_match = request.if_match, request.if_none_match
    if match is not None:
        if not any(tag.value in ("*", version.etag) and not tag.is_weak for tag in match):
            return 412
    else:
        unmodified = _date(lambda: request.if_unmodified_since)
        if unmodified is not None and version.modified_s > unmodified:
            return 412
    if none_match is not None:
        return 304 if any(tag.value in ("*", version.etag) for tag in none_match) else None
    modified = _date(lambda: request.if_modified_since)
    return 304 if modified is not None and version.modified_s <= modified else None


def _date(header: Callable[[], datetime | None]) -> float | None:
    """Return the date of a header, seconds; None if there is none, or no such date."""
    with suppress(ValueError, OverflowError):
        date = header()
        return None if date is None else date.timestamp()
    return None


def _select(request: web.Request, version: _Version, response: web.StreamResponse) -> tuple[int, int]:
    """Return the first byte and the number of bytes to send; set status and Content-Range of the response."""
    text = request.headers.get("Range")
    if text is None or request.method != "GET" or not _is_range_valid(request, version):
        return 0, version.size
    ranges = parse_ranges(text, version.size)
    if ranges is None or len(ranges) > 1:  # the whole file, which a client that asks for several accepts
        return 0, version.size
    if not ranges:
        response.set_status(416)
        response.headers["Content-Range"] = f"bytes */{version.size}"
        return 0, 0
    first, last = ranges[0]
    response.set_status(206)
    response.headers["Content-Range"] = f"bytes {first}-{last}/{version.size}"
    return first, last - first + 1


def _is_range_valid(request: web.Request, version: _Version) -> bool:
    """Return True unless If-Range names another version of the file (section 13.1.5)."""
    text = request.headers.get("If-Range")
    if text is None:
        return True
    if '"' in text:
        return text.strip() == f'"{version.etag}"'
    return _date(lambda: request.if_range) == version.modified_s


def parse_ranges(text: str, size: int) -> list[tuple[int, int]] | None:
    """Return the satisfiable ranges of a Range header, each as its first and its last byte.

    None means that the header is to be ignored: its unit is unknown, or it is no valid set of ranges. An
    empty list means that no range can be satisfied (status 416). Source: RFC 9110, sections 14.1.2 and 14.2.

    >>> parse_ranges("bytes=0-3", 10), parse_ranges("bytes=-4", 10), parse_ranges("bytes=-0", 10)
    ([(0, 3)], [(6, 9)], [])
    """
    unit, _, texts = text.partition("=")
    specs = [part.strip(" \t") for part in texts.split(",") if part.strip(" \t")]
    if unit.strip(" \t").lower() != "bytes" or not specs:
        return None
    ranges = []
    for spec in specs:
        match = re.fullmatch(r"([0-9]*)-([0-9]*)", spec)
        if match is None or spec == "-":
            return None
        first, last = (_position(digits) if digits else None for digits in match.groups())
        if first is None:
            first, last = max(0, size - (last or 0)), size - 1
        elif last is not None and last < first:
            return None
        if first < size:
            ranges.append((first, size - 1 if last is None else min(last, size - 1)))
    return ranges


def _position(digits: str) -> int:
    significant = digits.lstrip("0") or "0"
    return int(significant) if len(significant) <= _MAX_DIGITS else 10**_MAX_DIGITS

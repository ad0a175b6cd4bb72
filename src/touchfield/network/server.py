"""Web server of a folder of ``.touch`` files: serves whole files and ranges of bytes.

Requests are untrusted. Only plain files of known types within the folder are served; there is no listing; a
client that reads too slowly is dropped.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import quote

from aiohttp.abc import AbstractStreamWriter

from touchfield.errors import InvalidArgument
from touchfield.network.access import Access, Pages, add_pages, dropped_unless_read, guarded, run, web
from touchfield.network.live import MEDIA_TYPE

_TYPES: Final = {
    ".touch": MEDIA_TYPE, ".html": "text/html", ".mp4": "video/mp4", ".ts": "video/mp2t",
    ".webm": "video/webm",
    ".mpd": "application/dash+xml",
}  # fmt: skip
_PATIENCE_S: Final = 30.0
_SLOWEST: Final = 1 << 14
"""Minimum rate of a client in bytes a second, in addition to the patience."""

_MAX_NAMED: Final = 20


class _Answer(web.FileResponse):
    """A file or ranges of it, with a time limit that grows with its size."""

    async def prepare(self, request: web.BaseRequest) -> AbstractStreamWriter | None:
        """Send the file; drop a client that does not read."""
        async with dropped_unless_read(request, _PATIENCE_S + self._path.stat().st_size / _SLOWEST):
            return await super().prepare(request)


def application(folder: Path, access: Access, pages: Pages | None = None) -> web.Application:
    """Return the web application of a folder, with `pages` for browsers.

    Raises InvalidArgument if there is no such folder.
    """
    if not folder.is_dir():
        raise InvalidArgument(str(folder), "no folder", "a folder with .touch files")
    root = folder.resolve()

    async def file(request: web.Request) -> web.StreamResponse:
        path = await asyncio.to_thread(_plain_file, root, request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound(text="no such file")
        headers = {**access.cors(request), "X-Content-Type-Options": "nosniff", "Cache-Control": "no-cache"}
        return _Answer(path, headers={**headers, "Content-Type": _TYPES[path.suffix.lower()]})

    served = guarded(access)
    add_pages(served, "/{name:.*}", pages)
    served.router.add_get("/{name:.*}", file)
    return served


def serve(
    folder: Path,
    access: Access,
    report: Callable[[str], None] = lambda note: None,
    pages: Pages | None = None,
) -> None:
    """Serve a folder until interrupted.

    `report` is called with the address of each stream once the server listens. Raises InvalidArgument if
    there is no such folder, or the server cannot listen at the address.
    """
    served = application(folder, access, pages)

    def ready(address: str) -> None:
        names = sorted(p.relative_to(folder).as_posix() for p in folder.rglob("*.touch"))
        if not names:
            report(f"{folder} holds no .touch file yet")
        for name in names[:_MAX_NAMED]:
            report(f"http://{address}/{quote(name)}" + ("?token=..." if access.token else ""))
        if names and pages:
            report(
                f"in a browser: http://{address}/view/{quote(names[0])}"
                + ("?token=..." if access.token else "")
            )
        if len(names) > _MAX_NAMED:
            report(f"and {len(names) - _MAX_NAMED} more")

    asyncio.run(run(served, access, ready, asyncio.Event()))


def _plain_file(root: Path, name: str) -> Path | None:
    """Return the path of a file that may be served: plain, of a known type, in the folder, not hidden."""
    if (
        "\0" in name
        or "\\" in name
        or any(part in ("", "..") or part.startswith(".") for part in name.split("/"))
    ):
        return None
    try:
        path = (root / name).resolve()
        is_ours = path.is_relative_to(root) and path.suffix.lower() in _TYPES and path.is_file()
    except (OSError, ValueError, RuntimeError):  # an invalid name, or a cycle of links
        return None
    return path if is_ours else None

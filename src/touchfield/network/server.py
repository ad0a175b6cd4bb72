"""Web server of a folder of ``.touch`` files: serves whole files and ranges of bytes.

Requests are untrusted. Only plain files of known types within the folder are served; there is no listing; a
client that reads too slowly is dropped.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable
from pathlib import Path
from typing import Final
from urllib.parse import quote

from touchfield.atomic import is_temporary
from touchfield.errors import InvalidArgument
from touchfield.network.access import Access, Pages, add_get, add_pages, guarded, is_utf8, run, web
from touchfield.network.file_response import send_file
from touchfield.network.live import MEDIA_TYPE

_TYPES: Final = {
    ".touch": MEDIA_TYPE, ".html": "text/html", ".mp4": "video/mp4", ".ts": "video/mp2t",
    ".webm": "video/webm",
    ".mpd": "application/dash+xml",
}  # fmt: skip
_MAX_NAMED: Final = 20
_REFUSED: Final = (
    "hidden, links out of the folder, unreadable, no plain files, or names that no address can have"
)


def application(folder: Path, access: Access, pages: Pages | None = None) -> web.Application:
    """Return the web application of a folder, with `pages` for browsers.

    Raises InvalidArgument if there is no such folder.
    """
    if not folder.is_dir():
        raise InvalidArgument(str(folder), "no folder", "a folder with .touch files", "Check the path.")
    root = folder.resolve()

    async def file(request: web.Request) -> web.StreamResponse:
        path = await asyncio.to_thread(_served_file, root, request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound(text="no such file")
        headers = {**access.cors(request), "X-Content-Type-Options": "nosniff", "Cache-Control": "no-cache"}
        return await send_file(request, path, {**headers, "Content-Type": _TYPES[path.suffix.lower()]})

    served = guarded(access)
    add_pages(served, "/{name:(?s:.*)}", pages)
    add_get(served, "/{name:(?s:.*)}", file)
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
        names, refused = _streams(folder, has_pages=pages is not None)
        query = "?token=..." if access.token else ""
        if not names:
            report(f"{folder} holds no .touch file yet")
        for name in names[:_MAX_NAMED]:
            report(f"http://{address}/{quote(name)}{query}")
        if names and pages:
            report(f"in a browser: http://{address}/view/{quote(names[0])}{query}")
        if len(names) > _MAX_NAMED:
            report(f"and {len(names) - _MAX_NAMED} more")
        if refused:
            report(f"not served: {len(refused)} .touch files, such as {refused[0]!a} ({_REFUSED})")

    asyncio.run(run(served, access, ready, asyncio.Event()))


def _streams(folder: Path, has_pages: bool) -> tuple[list[str], list[str]]:
    """Return the names of the .touch files of a folder that are sent, and of those that are not.

    Temporary files of interrupted runs are hidden, and are in neither list.
    """
    root = folder.resolve()
    paths = (path for path in folder.rglob("*") if path.suffix.lower() == ".touch")
    names = sorted(path.relative_to(folder).as_posix() for path in paths if not is_temporary(path.name))
    is_page = {name: has_pages and name.startswith("view/") for name in names}
    sent = {name for name in names if not is_page[name] and _served_file(root, name) is not None}
    return [name for name in names if name in sent], [name for name in names if name not in sent]


def _served_file(root: Path, name: str) -> Path | None:
    """Return the path of a file that is listed and sent; None for any other name.

    It is plain, of a known type, in the folder, readable and not hidden; an address can name it.
    """
    if (
        "\0" in name
        or "\\" in name
        or not is_utf8(name)
        or any(part in ("", "..") or part.startswith(".") for part in name.split("/"))
    ):
        return None
    try:
        path = (root / name).resolve()
        is_ours = path.is_relative_to(root) and path.suffix.lower() in _TYPES and path.is_file()
    except (OSError, ValueError, RuntimeError):  # an invalid name, or a cycle of links
        return None
    return path if is_ours and os.access(path, os.R_OK) else None

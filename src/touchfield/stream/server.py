"""A folder of streams on the web, for people without a server: ranges of plain files, and nothing else.

What comes from the network is a stranger's. A name in a request is compared with the files that may be served and
never becomes a path by itself; there is no listing; a client that does not read is left after what its bytes justify.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
from collections.abc import Awaitable, Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import quote

from touchfield.errors import InvalidArgument, MissingExtra

try:
    from aiohttp import web
except ImportError:
    raise MissingExtra("serve", "aiohttp", "broadcast") from None

__all__ = ["MEDIA_TYPE", "ServeSpec", "application", "serve"]

MEDIA_TYPE: Final = "haptics/vnd.touchfield"
"""Of a ``.touch`` file (RFC 9695 makes the tree; haptics/hmpg is MPEG's)."""

_TYPES: Final = {
    ".touch": MEDIA_TYPE, ".html": "text/html", ".mp4": "video/mp4", ".ts": "video/mp2t", ".webm": "video/webm",
    ".mpd": "application/dash+xml",
}  # fmt: skip
_PATIENCE_S: Final = 30.0
_SLOWEST: Final = 1 << 14
"""Bytes a second of a client that reads, beyond the patience."""

_MOST_BUSY: Final = 1024
"""Answers at once; who comes beyond is told to come again."""


@dataclass(frozen=True)
class ServeSpec:
    """What is served, where, and to whom.

    Parameters
    ----------
    folder : Path
    host : str
        Address to listen at; beyond loopback only with a token, or open to all.
    port : int
        0 takes a free one.
    token : str or None
        Word that a client must bring: ``?token=WORD``, or as a bearer.
    is_open : bool
        Whether anyone who reaches the address may read, without a token.
    origins : tuple of str
        Web pages elsewhere that may read too (CORS), such as https://example.org; "*" for all.
    """

    folder: Path
    host: str = "127.0.0.1"
    port: int = 8075
    token: str | None = None
    is_open: bool = False
    origins: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not self.folder.is_dir():
            raise InvalidArgument(str(self.folder), "no folder", "a folder with .touch files")
        if not 0 <= self.port <= 65535:
            raise InvalidArgument("--port", f"{self.port}", "0 to 65535")
        if self.token is not None and len(self.token) < 8:
            raise InvalidArgument("--token", f"{len(self.token)} characters", "8 or more, that nobody guesses")
        if not (self.is_loopback or self.token or self.is_open):
            mend = "Add --token WORD, or --open if anyone may read."
            raise InvalidArgument("--host", f"{self.host}, which others reach", "a token", mend)

    @property
    def is_loopback(self) -> bool:
        """True where only this machine reaches the address."""
        return _is_loopback(self.host)


def application(spec: ServeSpec) -> web.Application:
    """The web application of a folder."""
    root = spec.folder.resolve()
    busy = 0

    @web.middleware
    async def guard(
        request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        nonlocal busy
        if busy >= _MOST_BUSY:
            return web.Response(status=503, text="busy", headers={"Retry-After": "1"})
        if spec.is_loopback and not _is_loopback(request.url.host or ""):
            return web.Response(status=403, text="this name is not that of this machine")  # a name bound anew
        busy += 1
        try:
            answer = _preflight(request) if request.method == "OPTIONS" else await handler(request)
        finally:
            busy -= 1
        return answer

    def allowed(request: web.Request) -> dict[str, str]:
        origin = request.headers.get("Origin", "")
        if not origin or not ({origin, "*"} & set(spec.origins)):
            return {}
        return {
            "Access-Control-Allow-Origin": origin,
            "Access-Control-Allow-Headers": "Range, Authorization",
            "Access-Control-Expose-Headers": "Content-Range, ETag",
            "Vary": "Origin",
        }

    def _preflight(request: web.Request) -> web.Response:
        return web.Response(status=204, headers=allowed(request))

    async def file(request: web.Request) -> web.StreamResponse:
        if not _knows(request, spec.token):
            return web.Response(status=401, text="a token is needed", headers={"WWW-Authenticate": "Bearer"})
        path = await asyncio.to_thread(_plain_file, root, request.match_info["name"])
        if path is None:
            raise web.HTTPNotFound(text="no such file")
        headers = {**allowed(request), "X-Content-Type-Options": "nosniff", "Cache-Control": "no-cache"}
        answer = web.FileResponse(path, headers={**headers, "Content-Type": _TYPES[path.suffix.lower()]})
        patience = _PATIENCE_S + path.stat().st_size / _SLOWEST
        try:
            async with asyncio.timeout(patience):
                await answer.prepare(request)
        except TimeoutError:
            if request.transport is not None:
                request.transport.abort()
        return answer

    served = web.Application(middlewares=[guard], client_max_size=1 << 10)
    served.router.add_get("/{name:.*}", file)
    served.router.add_route("OPTIONS", "/{name:.*}", file)
    return served


def serve(spec: ServeSpec, tell: Callable[[str], None] = lambda note: None) -> None:
    """Serve until interrupted; `tell` gets the address of each stream once they can be read.

    Raises
    ------
    InvalidArgument
        If the address cannot be listened at.
    """

    async def run() -> None:
        runner = web.AppRunner(application(spec), access_log=None, keepalive_timeout=15.0)
        await runner.setup()
        try:
            site = web.TCPSite(runner, spec.host, spec.port, backlog=1024)
            try:
                await site.start()
            except OSError as error:
                found = f"{spec.host}:{spec.port}: {error.strerror or error}"
                raise InvalidArgument("--port", found, "an address that is free", "Take another --port.") from None
            host, port = runner.addresses[0][:2]
            shown = f"[{host}]" if ":" in host else host
            names = sorted(p.relative_to(spec.folder).as_posix() for p in spec.folder.rglob("*.touch"))
            if not names:
                tell(f"{spec.folder} holds no .touch file yet")
            for name in names[:20]:
                tell(f"http://{shown}:{port}/{quote(name)}" + ("?token=..." if spec.token else ""))
            if len(names) > 20:
                tell(f"and {len(names) - 20} more")
            await asyncio.Event().wait()
        finally:
            await runner.cleanup()

    asyncio.run(run())


def _plain_file(root: Path, name: str) -> Path | None:
    """The file of a name, if it is one that may be served: plain, of a known kind, in the folder and not hidden."""
    if "\0" in name or "\\" in name or any(part in ("", "..") or part.startswith(".") for part in name.split("/")):
        return None
    try:
        path = (root / name).resolve()
        is_ours = path.is_relative_to(root) and path.suffix.lower() in _TYPES and path.is_file()
    except (OSError, ValueError, RuntimeError):  # a name that is none, or links in a ring
        return None
    return path if is_ours else None


def _knows(request: web.Request, token: str | None) -> bool:
    if token is None:
        return True
    told = request.query.get("token") or request.headers.get("Authorization", "").removeprefix("Bearer ")
    return hmac.compare_digest(told.encode(), token.encode())


def _is_loopback(host: str) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False

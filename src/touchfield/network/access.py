"""What all web servers of the package share: who may connect (address, token), limits on clients, and running
in a thread."""

from __future__ import annotations

import asyncio
import errno
import hmac
import ipaddress
import logging
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from dataclasses import dataclass
from threading import Event as Flag, Thread
from typing import Final, NamedTuple, Self
from urllib.parse import urlsplit
from weakref import WeakSet

from aiohttp import web as web
from aiohttp.http import HttpProcessingError

from touchfield.errors import InvalidArgument, reason

_PAGE_HEADERS: Final = {
    "X-Content-Type-Options": "nosniff",
    "Cache-Control": "no-cache",
    "X-Frame-Options": "SAMEORIGIN",
}
_HANDSHAKE: Final = ("upgrade", "connection", "sec-websocket-")
_PATIENCE_S: Final = 10.0
_ENDING_S: Final = 2.0  # half of the time that running answers may take when a server ends
_CONNECTION_LIMIT: Final = 1 << 15
_MAX_BUSY: Final = 4096
"""Maximum number of concurrent answers and live receivers; further requests get status 503."""


def _is_fault(record: logging.LogRecord) -> bool:
    """Return False for what a client did: a malformed request, or a connection that it ended."""
    error = record.exc_info[1] if record.exc_info else None
    return not isinstance(error, HttpProcessingError | ConnectionError)


_LOGGER: Final = logging.getLogger(__name__)
_LOGGER.addFilter(_is_fault)


@dataclass(frozen=True)
class Access:
    """Address of a server, and the clients that may read.

    Raises InvalidArgument if a non-loopback address requires no token, or a value is out of range.

    Parameters
    ----------
    host : str
        Address to listen at. An address that is not loopback needs a token or `is_open`.
    port : int
        Port; 0 selects a free one.
    token : str or None
        Secret that a client must send, as ``?token=WORD`` or as a bearer token.
    is_open : bool
        Whether anyone who reaches the address may read, without a token.
    origins : tuple of str
        Origins whose web pages may also read (CORS), such as https://example.org; "*" for all.
    """

    host: str = "127.0.0.1"
    port: int = 8075
    token: str | None = None
    is_open: bool = False
    origins: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if not 0 <= self.port <= 65535:
            raise InvalidArgument("--port", f"{self.port}", "0 to 65535")
        if self.token is not None and len(self.token) < 8:
            raise InvalidArgument(
                "--token", f"{len(self.token)} characters", "8 or more, that nobody guesses"
            )
        if not (_is_loopback(self.host) or self.token or self.is_open):
            hint = "Add --token WORD, or --open if anyone may read."
            raise InvalidArgument("--host", f"{self.host}, which others reach", "a token", hint)

        for origin in self.origins:
            _require_origin(origin)

    def is_authorised(self, request: web.Request) -> bool:
        """Return True if no token is required, or the request has it."""
        if self.token is None:
            return True
        token = request.query.get("token") or request.headers.get("Authorization", "").removeprefix("Bearer ")
        return hmac.compare_digest(_bytes(token), _bytes(self.token))

    def cors(self, request: web.Request) -> dict[str, str]:
        """Return the CORS headers for a page of an allowed origin."""
        origin = request.headers.get("Origin", "")
        is_sendable = origin.isascii() and origin.isprintable()  # it becomes a header of the answer
        if not origin or not is_sendable or not ({origin, "*"} & set(self.origins)):
            return {}
        return {
            "Access-Control-Allow-Origin": origin,
            "Access-Control-Allow-Headers": "Range, Authorization",
            "Access-Control-Expose-Headers": "Content-Range, ETag",
            "Vary": "Origin",
        }

    def is_stranger(self, request: web.Request) -> bool:
        """Return True for a WebSocket request of an origin that may not read.

        The check is needed because CORS does not cover WebSockets.
        """
        origin = request.headers.get("Origin", "")
        try:
            netloc = urlsplit(origin).netloc
        except ValueError:  # no address of a page
            return True
        return bool(origin) and netloc != request.host and not self.cors(request)


def _require_origin(text: str) -> None:
    """Raise InvalidArgument unless a browser may send this text as an origin, or it is "*".

    An origin has no path, and a browser writes it in small letters: others would never be matched.
    """
    try:
        parts = urlsplit(text)
        is_origin = bool(parts.hostname) and parts.port != 0 and text == f"{parts.scheme}://{parts.netloc}"
    except ValueError:
        is_origin = False
    if text not in ("*", "null") and not (is_origin and text == text.lower()):
        raise InvalidArgument("--cors", repr(text[:80]), "an origin such as https://example.org, or *")


def guarded(access: Access) -> web.Application:
    """Return a web application that checks access and limits concurrent answers."""
    busy = 0

    @web.middleware
    async def guard(
        request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        nonlocal busy
        if busy >= _MAX_BUSY:
            return web.Response(status=503, text="busy", headers={"Retry-After": "1"})
        host = _named_host(request)
        if host is None:
            return web.Response(status=400, text="a Host that is no address")
        if _is_loopback(access.host) and not _is_loopback(host):
            return web.Response(status=403, text="this name is not that of this machine")  # DNS rebinding
        if "Upgrade" in request.headers and access.is_stranger(request):
            return web.Response(status=403, text="a page elsewhere, which may not read")
        if request.method == "OPTIONS":
            return web.Response(status=204, headers=access.cors(request))
        if not access.is_authorised(request):
            return web.Response(status=401, text="a token is needed", headers={"WWW-Authenticate": "Bearer"})
        busy += 1
        try:
            return await handler(request)
        finally:
            busy -= 1

    return web.Application(middlewares=[guard], client_max_size=1 << 10)


def add_get(
    application: web.Application, path: str, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
) -> None:
    """Add a handler of GET and HEAD requests; one that expects anything unknown gets status 417."""
    application.router.add_get(path, handler, expect_handler=_refuse_expectation)


async def _refuse_expectation(request: web.Request) -> web.StreamResponse | None:
    """Check the header Expect (RFC 9110, section 10.1.1).

    The final response comes at once: no handler reads content. The default handler of aiohttp repeats the
    header in its answer, which fails if the header is no UTF-8.
    """
    is_known = request.headers.get("Expect", "").strip().lower() == "100-continue"
    return None if is_known else web.Response(status=417, text="an unknown expectation")


async def _refuse(request: web.Request) -> web.StreamResponse:
    """Answer a request that no other handler takes."""
    if request.method not in ("GET", "HEAD"):
        raise web.HTTPMethodNotAllowed(request.method, ("GET", "HEAD", "OPTIONS"))
    raise web.HTTPNotFound(text="nothing here")


async def open_socket(request: web.Request, heartbeat_s: float | None = None) -> web.WebSocketResponse:
    """Accept the WebSocket of a request; return it.

    Raises HTTPBadRequest if the request is no valid handshake. Headers that are no UTF-8 are refused here, as
    aiohttp repeats them in its answers, which fails.
    """
    handshake = [v for k, v in request.headers.items() if k.lower().startswith(_HANDSHAKE)]
    if not all(map(is_utf8, handshake)):
        raise web.HTTPBadRequest(text="a header of the handshake that is no UTF-8")
    socket = web.WebSocketResponse(heartbeat=heartbeat_s, max_msg_size=1 << 10, compress=False)
    await socket.prepare(request)
    return socket


@asynccontextmanager
async def dropped_unless_read(request: web.BaseRequest, seconds: float) -> AsyncIterator[None]:
    """Disconnect a client that takes longer than `seconds` to read what the block sends.

    Raises `ClientDropped` in that case.
    """
    try:
        async with asyncio.timeout(seconds):
            yield
    except TimeoutError:
        if request.transport is not None:
            request.transport.abort()
        raise ClientDropped from None


class ClientDropped(ConnectionResetError):
    """A client was disconnected because it did not read."""


class Pages(NamedTuple):
    """Pages for a browser.

    `outer` fetches data from its server, and `inner`, in a frame of it, shows them.
    """

    outer: str
    inner: str


def add_pages(application: web.Application, pattern: str, pages: Pages | None) -> None:
    """Serve the pages, if any, at /view and `pattern` below it."""
    if pages is None:
        return

    def add(path: str, text: str) -> None:
        async def answer(request: web.Request) -> web.Response:
            return web.Response(text=text, content_type="text/html", headers=_PAGE_HEADERS)

        add_get(application, path, answer)

    add("/view-page.html", pages.inner)
    add(f"/view{pattern}", pages.outer)


async def run(
    application: web.Application, access: Access, ready: Callable[[str], None], stop: asyncio.Event
) -> None:
    """Run a web application until the event `stop`; `ready` is called with its address.

    A connection without a request within ten seconds is closed. At most seven eighths of the file descriptors
    of the process are used; further connections are closed immediately.

    Raises InvalidArgument if the server cannot listen at the address.
    """
    loop, active = asyncio.get_running_loop(), WeakSet[object]()

    @web.middleware
    async def hear(
        request: web.Request, handler: Callable[[web.Request], Awaitable[web.StreamResponse]]
    ) -> web.StreamResponse:
        active.add(request.transport)
        return await handler(request)

    application.middlewares.insert(0, hear)
    application.router.add_route("*", "/{name:(?s:.*)}", _refuse, expect_handler=_refuse_expectation)
    runner = web.AppRunner(
        application, access_log=None, keepalive_timeout=15.0, shutdown_timeout=_ENDING_S, logger=_LOGGER
    )
    await runner.setup()
    assert runner.server is not None
    answering, max_connections, newcomers = runner.server, _max_connections(), deque[web.RequestHandler]()

    def leave(connection: web.RequestHandler) -> None:
        if connection.transport is not None and connection.transport not in active:
            connection.transport.abort()

    def connected() -> asyncio.Protocol:
        if len(answering.connections) + len(newcomers) >= max_connections:
            return _Refusal()
        connection = answering()
        newcomers.append(connection)
        loop.call_soon(newcomers.popleft)  # by then the connection is in `answering.connections`
        loop.call_later(_PATIENCE_S, leave, connection)
        return connection

    listening = None
    try:
        try:
            listening = await loop.create_server(connected, access.host, access.port, backlog=4096)
        except (OSError, UnicodeError) as error:
            raise _listen_error(access, error) from None
        host, port = listening.sockets[0].getsockname()[:2]
        ready(f"[{host}]:{port}" if ":" in host else f"{host}:{port}")
        await stop.wait()
    finally:
        if listening is not None:
            listening.close()
        await runner.cleanup()


def _listen_error(access: Access, error: Exception) -> InvalidArgument:
    """The error of a server that cannot listen."""
    causes = {errno.EADDRINUSE: "in use by another program", errno.EACCES: "not allowed for this user"}
    causes[errno.EADDRNOTAVAIL] = "no address of this machine"
    cause = causes.get(getattr(error, "errno", None) or 0) or reason(error)
    found = f"{access.host}:{access.port}: {cause}"
    return InvalidArgument("--port", found, "an address that is free", "Take another --port or --host.")


def require_free(access: Access) -> None:
    """Raise InvalidArgument, before long work, if a server cannot listen at the address now."""

    async def listen() -> None:
        server = await asyncio.get_running_loop().create_server(asyncio.Protocol, access.host, access.port)
        server.close()
        await server.wait_closed()

    try:
        asyncio.run(listen())
    except (OSError, UnicodeError) as error:
        raise _listen_error(access, error) from None


class Background(ABC):
    """A web application that runs in its own thread; a context manager.

    Attributes
    ----------
    address : str
        Host and port, once the context is entered.
    """

    def __init__(self, access: Access, pages: Pages | None = None) -> None:
        self._access, self._pages, self.address = access, pages, ""
        self._loop, self._is_over, self._ready = asyncio.new_event_loop(), asyncio.Event(), Flag()
        self._error: Exception | None = None
        self._thread = Thread(target=self._run, name="touchfield-server", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        self._ready.wait()
        if self._error is not None:
            raise self._error
        return self

    def __exit__(self, *_: object) -> None:
        with suppress(RuntimeError):
            self._loop.call_soon_threadsafe(self._is_over.set)
        self._thread.join(10)

    @abstractmethod
    def _application(self) -> web.Application:
        """Return the web application."""

    def _run(self) -> None:
        try:
            self._loop.run_until_complete(run(self._application(), self._access, self._at, self._is_over))
        except Exception as error:
            self._error = error
        finally:
            self._loop.run_until_complete(_cancel_others())
            self._loop.close()
            self._ready.set()

    def _at(self, address: str) -> None:
        self.address = address
        self._ready.set()


async def _cancel_others() -> None:
    """Cancel the tasks of the running loop that are left, such as those that wait for a client's content."""
    others = asyncio.all_tasks() - {asyncio.current_task()}
    for task in others:
        task.cancel()
    await asyncio.gather(*others, return_exceptions=True)


class _Refusal(asyncio.Protocol):
    """A connection that exceeds the limit."""

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        """Close it."""
        assert isinstance(transport, asyncio.Transport)
        transport.abort()


def _max_connections() -> int:
    """Return the maximum number of connections: seven eighths of the open files that a process may have."""
    try:
        import resource
    except ImportError:  # Windows has no such limit
        return 8192
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    unbounded = resource.RLIM_INFINITY
    soft, max_files = (
        _CONNECTION_LIMIT if n == unbounded else min(n, _CONNECTION_LIMIT) for n in (soft, hard)
    )
    if soft < max_files:
        with suppress(OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_NOFILE, (max_files, hard))
            soft = max_files
    return max(8, soft * 7 // 8)


def _named_host(request: web.Request) -> str | None:
    """Return the host that a request names, without its port; None if its Host header is invalid."""
    try:
        return request.url.host or ""
    except ValueError:
        return None


def is_utf8(name: str) -> bool:
    """Return True if an address can have this name: it is no name of other bytes (single surrogates)."""
    try:
        name.encode()
    except UnicodeEncodeError:
        return False
    return True


def _bytes(word: str) -> bytes:
    """Return a word as bytes; bytes of a header that are no UTF-8 are single surrogates in it."""
    return word.encode("utf-8", "surrogatepass")


def _is_loopback(host: str) -> bool:
    """Return True if only this machine reaches the address."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False

"""Server of the page: one process, its files read once, computing in threads of its own, nothing from or to any other machine."""

import asyncio
import contextlib
import secrets
import socket
import sys
import threading
from collections.abc import Awaitable, Callable, Mapping, MutableMapping
from dataclasses import replace
from importlib.resources import files
from types import MappingProxyType
from typing import Any
from urllib.parse import parse_qs

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket
from uvicorn.protocols.http.h11_impl import H11Protocol

from ..errors import GainroomError
from .bench import Bench
from .lanes import Lane
from .messages import LONGEST
from .session import Session

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[Any]]
Send = Callable[[Any], Awaitable[None]]
App = Callable[[Scope, Receive, Send], Awaitable[None]]

LOOPBACK = ("127.0.0.1", "localhost", "[::1]")
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; base-uri 'none'; "
    "form-action 'none'; frame-ancestors 'none'"
)
HEADERS = (
    (b"content-security-policy", POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
)
STATIC = files("gainroom") / "app" / "static"
TYPES = {"js": "text/javascript", "css": "text/css"}
Examples = Mapping[str, Callable[[], Bench]]
"""Examples by name, opened when they are asked for."""
NONE: Examples = MappingProxyType({})
MOST_PAGES = 32
"""Maximum number of pages open at the same time."""
PATIENCE = 1
"""Time for connections to end by themselves [s]."""
HEADERS_WITHIN = 10.0
"""Time for a request [s], from the connection, or from its first byte on one that has had an answer."""
MOST_UNASKED = 64
"""Maximum number of connections without a request; beyond it the oldest is closed. A browser opens six to a server."""


def application(bench: Bench, port: int, token: str = "", examples: Examples = NONE) -> App:
    """ASGI application; `examples`: benches that replace `bench`, by the name behind ?example=."""
    newest = _Newest(bench)
    benches = {"": newest.bench, **examples}

    def asked(given: HTTPConnection) -> str:
        return given.query_params.get("example", "")

    static = _static()
    page = (STATIC / "index.html").read_text("utf-8")
    lanes = {name: Lane(name) for name in ("quick", "curves", "full", "text", "long")}
    open_pages: set[int] = set()

    async def index(request: Request) -> Response:
        if asked(request) not in benches:
            return PlainTextResponse(f"no such example; there are: {', '.join(examples) or 'none'}\n", 404)
        return HTMLResponse(page)

    async def file(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in static:  # a name of a list, not a path: there is nothing to climb out of
            return PlainTextResponse("not found\n", 404)
        return Response(static[name], media_type=TYPES[name.rpartition(".")[2]])

    async def mesh(request: Request) -> Response:
        opener = benches.get(asked(request))
        found = None if opener is None else (await asyncio.to_thread(opener)).mesh(request.path_params["place"])
        return PlainTextResponse("not found\n", 404) if found is None else Response(found, media_type="application/octet-stream")

    async def speak(socket: WebSocket) -> None:
        if len(open_pages) >= MOST_PAGES or asked(socket) not in benches:
            await socket.close(1013, "too many pages are open, or no such example")
            return
        open_pages.add(id(socket))
        try:
            await Session(socket, await asyncio.to_thread(benches[asked(socket)]), lanes, list(examples)).run()
        finally:
            open_pages.discard(id(socket))

    routes = [Route("/", index), Route("/static/{name:path}", file), Route("/mesh/{place:int}", mesh), WebSocketRoute("/ws", speak)]
    return Guard(Starlette(routes=routes), port, token)


class _Newest:
    """Bench for newly opened pages: if a page has saved, one of the saved file."""

    def __init__(self, bench: Bench) -> None:
        self._bench, self._lock = bench, threading.Lock()

    def bench(self) -> Bench:
        """Bench of the saved file; the previous one if the saved file cannot be opened."""
        with self._lock:
            opened = self._bench.opened
            if opened.stored != opened.text:
                with contextlib.suppress(GainroomError):
                    self._bench = type(self._bench)(replace(opened, text=opened.stored, saved=None))
            return self._bench


def _static() -> dict[str, bytes]:
    """Static files of the page by their path below static."""
    found = {}
    for folder in ("", "vendor/"):
        for entry in (STATIC / folder if folder else STATIC).iterdir():
            if entry.name.rpartition(".")[2] in TYPES:
                found[folder + entry.name] = entry.read_bytes()
    return found


def listening(host: str, port: int) -> socket.socket:
    """Listening socket that nobody else uses; port 0: any. Raises GainroomError."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        # Named, as asyncio sends at once (TCP_NODELAY) only where it is: else a part waits 40 ms for the receipt of the one before
        found = socket.socket(family, socket.SOCK_STREAM, socket.IPPROTO_TCP)
        found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        found.bind((host.strip("[]"), port))
    except (OSError, OverflowError, UnicodeError) as error:
        raise GainroomError(f"--host {host} --port {port}: cannot be listened on: {error}") from error
    found.listen(128)
    return found


def serve(bench: Bench, host: str, port: int, ready: Callable[[str], None], examples: Examples = NONE) -> None:
    """Serves the page until a signal ends it.

    `ready` gets the page's address; `examples` as in application.

    Raises GainroomError where the address cannot be listened on.
    """
    sys.setswitchinterval(1e-3)  # a search in the other thread must not hold up what follows the pointer
    listener = listening(host, port)
    port = listener.getsockname()[1]
    here = host in LOOPBACK or host == "::1"
    token = "" if here else secrets.token_urlsafe(24)
    config = configured(application(bench, port, token, examples))
    name = f"[{host}]" if ":" in host and not host.startswith("[") else host
    server = uvicorn.Server(config)
    with contextlib.closing(listener):
        ready(f"http://{name}:{port}/" + (f"?token={token}" if token else ""))
        server.run(sockets=[listener])


def configured(app: App) -> uvicorn.Config:
    """Configuration of uvicorn for the application."""
    return uvicorn.Config(
        app,
        http=PatientProtocol,
        ws="wsproto",
        ws_max_size=LONGEST,
        ws_per_message_deflate=False,  # this machine alone: packing costs more than it saves
        lifespan="off",
        log_level="error",
        access_log=False,
        server_header=False,
        date_header=False,
        timeout_graceful_shutdown=PATIENCE,
        limit_concurrency=256,
    )


class Guard:
    """Wrapper of an application that refuses a foreign Host (a name that points here), a foreign Origin, and a missing token.

    port    of the server
    token   "" on this machine alone; else it must be in the query, and any Host will do
    """

    def __init__(self, app: App, port: int, token: str = "") -> None:
        self._app, self._token = app, token
        self._hosts = {f"{name}:{port}" for name in LOOPBACK} | ({*LOOPBACK} if port == 80 else set())

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        reason = self._refusal(scope)
        if reason:
            await _refuse(scope, receive, send, reason)
            return

        async def with_headers(message: Any) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", []), *HEADERS]}
            await send(message)

        await self._app(scope, receive, with_headers)

    def _refusal(self, scope: Scope) -> str:
        """Reason for the refusal; "" if access is granted."""
        names = [value.decode("latin-1").lower() for name, value in scope["headers"] if name == b"host"]
        if len(names) != 1 or (not self._token and names[0] not in self._hosts):
            return "foreign Host"
        origins = [value.decode("latin-1").lower() for name, value in scope["headers"] if name == b"origin"]
        own = {f"http://{names[0]}", f"https://{names[0]}"}
        if any(origin not in own for origin in origins) or (scope["type"] == "websocket" and len(origins) != 1):
            return "foreign Origin"
        if self._token and not scope["path"].startswith("/static/"):
            given = parse_qs(scope["query_string"].decode("latin-1")).get("token", [""])[-1]
            if not secrets.compare_digest(given.encode(), self._token.encode()):
                return "token missing or wrong"
        return ""


async def _refuse(scope: Scope, receive: Receive, send: Send, reason: str) -> None:
    if scope["type"] == "websocket":
        await receive()
        await send({"type": "websocket.close", "code": 1008, "reason": reason})  # before it is accepted: status 403
        return
    body = f"gainroom: refused: {reason}\n".encode()
    headers = [(b"content-type", b"text/plain; charset=utf-8"), (b"content-length", str(len(body)).encode()), *HEADERS]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": body})


class PatientProtocol(H11Protocol):
    """Protocol of uvicorn with time limits; uvicorn's own waits for a request without limit."""

    _deadline: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(transport)
        self._wait()
        unasked = [(each._deadline.when(), each) for each in self.connections if isinstance(each, PatientProtocol) and each._deadline]
        if len(unasked) > MOST_UNASKED:
            min(unasked, key=lambda one: one[0])[1]._give_up()

    def connection_lost(self, exc: Exception | None) -> None:
        self._asked()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        upgraded = self.transport.get_protocol() is not self  # to a WebSocket, which asks when it likes
        if upgraded or self.transport.is_closing() or (self.cycle is not None and not self.cycle.response_complete):
            self._asked()
        else:
            self._wait()

    def handle_websocket_upgrade(self, event: object) -> None:
        self._asked()  # from here on the connection is another protocol's
        super().handle_websocket_upgrade(event)  # type: ignore[arg-type]

    def on_response_complete(self) -> None:
        self._asked()  # for the next request uvicorn waits by itself, until it begins
        super().on_response_complete()
        if self.conn.trailing_data[0]:
            self._wait()

    def _wait(self) -> None:
        if self._deadline is None:
            self._deadline = self.loop.call_later(HEADERS_WITHIN, self._give_up)

    def _asked(self) -> None:
        if self._deadline is not None:
            self._deadline.cancel()
            self._deadline = None

    def _give_up(self) -> None:
        self._asked()
        self.transport.abort()

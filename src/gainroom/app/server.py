"""Server of the page: one process, its files read once, computing in threads of its own, nothing from or to any other machine."""

import asyncio
import contextlib
import secrets
import socket
import sys
import threading
from collections.abc import Callable, Mapping
from dataclasses import replace
from importlib.resources import files
from types import MappingProxyType

import uvicorn
from starlette.applications import Starlette
from starlette.requests import HTTPConnection, Request
from starlette.responses import HTMLResponse, PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket

from ..errors import GainroomError
from .access import LOOPBACK, App, Guard
from .bench import Bench
from .lanes import Lane
from .messages import LONGEST
from .patience import PatientProtocol
from .session import Session

STATIC = files("gainroom") / "app" / "static"
TYPES = {"js": "text/javascript", "css": "text/css"}
Examples = Mapping[str, Callable[[], Bench]]
"""Examples by name, opened when they are asked for."""
NONE: Examples = MappingProxyType({})
MOST_PAGES = 32
"""Maximum number of pages open at the same time."""
PATIENCE = 1
"""Time for connections to end by themselves [s]."""


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

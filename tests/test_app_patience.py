"""Connections that ask for nothing, or for half of something, keep nobody away from the page."""

import contextlib
import socket
import threading
from collections.abc import Iterator

import pytest

from app_pages import PATIENCE

uvicorn = pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
from gainroom.app import patience  # noqa: E402
from gainroom.app.server import application, configured, listening  # noqa: E402
from gainroom.cli.app import examples  # noqa: E402

WHOLE = "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\n\r\n"
HALVES = {
    "nothing": "",
    "a part of a line": "GET / HT",
    "headers without an end": "GET / HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nX: ",
    "a whole one, then half of one": WHOLE + "GET / HTTP/1.1\r\nHos",
    "half of a handshake": "GET /ws HTTP/1.1\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n",
}


@contextlib.contextmanager
def served(monkeypatch: pytest.MonkeyPatch, within: float) -> Iterator[int]:
    """The port of an application as it is served, which gives requests so long [s]."""
    monkeypatch.setattr(patience, "HEADERS_WITHIN", within)
    listener = listening("127.0.0.1", 0)
    port = listener.getsockname()[1]
    server = uvicorn.Server(configured(application(examples()["testbed"](), port)))
    thread = threading.Thread(target=server.run, kwargs={"sockets": [listener]})
    thread.start()
    try:
        yield port
    finally:
        server.should_exit = True
        thread.join()
        listener.close()


def connected(port: int, text: str = "") -> socket.socket:
    line = socket.create_connection(("127.0.0.1", port), PATIENCE)
    line.sendall(text.format(port=port).encode())
    return line


def closed(line: socket.socket) -> bool:
    """Once the other side has ended it; whatever it says before is read."""
    with contextlib.suppress(ConnectionError):
        while line.recv(65536):
            pass
    return True


def answers(port: int) -> bool:
    with connected(port, WHOLE) as line:
        return line.recv(64).startswith(b"HTTP/1.1 200")


@pytest.mark.parametrize("half", HALVES)
def test_half_a_request_is_waited_for_no_longer_than_that(monkeypatch: pytest.MonkeyPatch, half: str):
    with served(monkeypatch, 0.2) as port, connected(port, HALVES[half]) as line:
        assert closed(line)
        assert answers(port)


def test_a_request_byte_by_byte_gains_no_time(monkeypatch: pytest.MonkeyPatch):
    """A byte now and then for ever: the time runs from the first."""
    with served(monkeypatch, 0.3) as port, connected(port) as line:
        line.settimeout(0.02)
        sent, over = 0, False
        while not over:
            try:
                line.sendall(b"X" if sent else b"GET / HTTP/1.1\r\nX: ")
                sent += 1
                over = line.recv(1) == b""
            except TimeoutError:
                pass
            except ConnectionError:
                over = True
        assert sent > 1
        assert answers(port)


def test_hundreds_of_half_requests_lock_nobody_out(monkeypatch: pytest.MonkeyPatch):
    """More than the server takes at all; the oldest are closed, the page is there at once, and a page that is open stays."""
    with served(monkeypatch, PATIENCE) as port, contextlib.ExitStack() as lines:
        slow = [lines.enter_context(connected(port, HALVES["headers without an end"])) for _ in range(300)]
        assert answers(port)
        assert closed(slow[0])
        assert answers(port)


def test_who_asks_in_time_is_answered_for_as_long_as_he_asks(monkeypatch: pytest.MonkeyPatch):
    """Several whole requests on one connection, one in two parts."""
    with served(monkeypatch, PATIENCE) as port, connected(port) as line:
        for part in (1, 25):
            for _ in range(3):
                text = WHOLE.format(port=port).encode()
                line.sendall(text[:part])
                line.sendall(text[part:])
                found = b""
                while b"</html>" not in found:
                    found += line.recv(65536)
                assert found.startswith(b"HTTP/1.1 200")

"""Who may speak with the page's server, what it takes, and that nothing foreign harms it."""

import contextlib
import json
import socket
import urllib.error
import urllib.request
from itertools import islice
from pathlib import Path
from typing import Any

import pytest

from app_pages import PATIENCE, Served, serve
from gainroom.app.messages import LONGEST
from gainroom.cli import main

pytest.importorskip("uvicorn", reason="the extra gainroom[app] is not installed")
client = pytest.importorskip("websockets.sync.client")
exceptions = pytest.importorskip("websockets.exceptions")


def get(address: str, **headers: str) -> tuple[int, dict[str, str], str]:
    try:
        with urllib.request.urlopen(urllib.request.Request(address, headers=headers), timeout=PATIENCE) as answer:
            return answer.status, {key.lower(): value for key, value in answer.headers.items()}, answer.read().decode()
    except urllib.error.HTTPError as error:
        with error:
            return error.code, {}, error.read().decode()


def raw(served: Served, request: str) -> str:
    """Bytes as no browser would send them."""
    port = int(served.address.rstrip("/").rsplit(":", 1)[1])
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as line:
        line.sendall(request.encode())
        line.settimeout(PATIENCE)
        return line.recv(65536).decode("utf-8", "replace")


def speak(served: Served, **options: Any) -> Any:
    address = served.address.replace("http://", "ws://") + "ws"
    return client.connect(address, origin=options.pop("origin", served.address.rstrip("/")), open_timeout=PATIENCE, proxy=None, **options)


def answers_still(served: Served) -> None:
    with speak(served) as line:
        assert json.loads(line.recv(PATIENCE))["part"] == "opening"
        line.send('{"ask": "look", "key": 7}')
        assert any(json.loads(line.recv(PATIENCE)).get("key") == 7 for _ in range(100))


def test_the_page_has_a_strict_policy(served: Served):
    status, headers, text = get(served.address)
    assert status == 200
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert "*" not in policy
    assert 'src="http' not in text
    assert 'href="http' not in text
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("host", ["evil.example", "evil.example:80", "127.0.0.1.evil.example", "localhost:1"])
def test_a_foreign_host_is_refused(served: Served, host: str):
    """A name that was made to point to this machine (DNS rebinding)."""
    assert get(served.address, Host=host)[0] == 403
    upgrade = "Connection: Upgrade\r\nUpgrade: websocket\r\nSec-WebSocket-Version: 13\r\nSec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ=="
    assert raw(served, f"GET /ws HTTP/1.1\r\nHost: {host}\r\nOrigin: http://{host}\r\n{upgrade}\r\n\r\n").split()[1] == "403"


def test_a_foreign_origin_is_refused(served: Served):
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1", None):
        with pytest.raises(exceptions.InvalidStatus, match="403"), speak(served, origin=origin):
            pass
    assert get(served.address, Origin="http://evil.example")[0] == 403


CLIMBING = (
    "/static/../server.py",
    "/static/%2e%2e/server.py",
    "/static/..%2fserver.py",
    "/static//etc/passwd",
    "/static/vendor/../../server.py",
)


@pytest.mark.parametrize("path", [*CLIMBING, "/etc/passwd"])
def test_no_other_file_is_served(served: Served, path: str):
    port = served.address.rstrip("/").rsplit(":", 1)[1]
    answer = raw(served, f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nConnection: close\r\n\r\n")
    assert answer.split()[1] == "404"
    assert "import" not in answer


def test_what_is_too_long_or_no_message_does_no_harm(served: Served):
    with speak(served) as line:
        line.recv(PATIENCE)
        for text in ("no json", "[1]", '{"ask": "look", "key": 1, "view": {"gains": {"<script>": 1}}}'):
            line.send(text)
        line.send(b"\x00\xff")
        told = (json.loads(line.recv(PATIENCE))["part"] for _ in range(100))
        found = list(islice((part for part in told if part != "progress"), 4))
        assert found == ["refused"] * 4
    with speak(served) as line:
        line.recv(PATIENCE)
        line.send("x" * (LONGEST + 1000))
        with pytest.raises(exceptions.ConnectionClosed):
            line.recv(PATIENCE)
    assert raw(served, "GET / HTTP/1.1\r\nHost: a\r\nHost: b\r\n\r\n").split()[1] in ("400", "403")
    assert raw(served, "\x00\x01\x02 nonsense\r\n\r\n").split()[1] == "400"
    answers_still(served)


def test_a_thousand_connections_leave_it_answering(served: Served):
    port = int(served.address.rstrip("/").rsplit(":", 1)[1])
    lines = []
    for _ in range(1000):
        with contextlib.suppress(OSError):
            lines.append(socket.create_connection(("127.0.0.1", port), 2))
    pages = []
    for line in lines:
        line.close()
    with contextlib.ExitStack() as stack:
        for _ in range(40):
            with contextlib.suppress(exceptions.WebSocketException, OSError):
                pages.append(stack.enter_context(speak(served)))
        assert 1 <= len(pages) <= 32
    answers_still(served)


def test_elsewhere_than_here_it_takes_a_token(tmp_path: Path):
    """Checked at the application, as a test should not listen on other interfaces."""
    import asyncio

    from gainroom.app.server import Guard

    reached = []

    async def inner(scope: Any, receive: Any, send: Any) -> None:
        reached.append(scope["path"])

    async def ask(path: str, query: str) -> None:
        scope = {"type": "http", "path": path, "query_string": query.encode(), "headers": [(b"host", b"robot.local:80")]}
        guard = Guard(inner, 80, "secret")

        async def send(message: Any) -> None:
            pass

        await guard(scope, None, send)  # type: ignore[arg-type]

    for path, query in (("/a", ""), ("/b", "token=wrong"), ("/c", "token=secret"), ("/d", "token=")):
        asyncio.run(ask(path, query))
    assert reached == ["/c"]


def test_a_taken_port_is_one_line(served: Served, capfd: pytest.CaptureFixture[str]):
    port = served.address.rstrip("/").rsplit(":", 1)[1]
    assert main(["app", str(served.file), "--no-browser", "--port", port]) == 2
    assert "cannot be listened on" in capfd.readouterr().err


@pytest.mark.slow
def test_ctrl_c_ends_it_cleanly_with_a_page_open(served: Served, tmp_path: Path):
    import signal

    own = serve(served.file)
    with speak(own) as line:
        line.recv(PATIENCE)
        line.send('{"ask": "look", "key": 1}')
        own.process.send_signal(signal.SIGINT)
        assert own.process.wait(PATIENCE) == 130
    _, error = own.process.communicate()
    assert "Traceback" not in error

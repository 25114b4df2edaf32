"""A page's WebSocket asks when it likes: the time in which a request has to come is over with its upgrade."""

import time

import pytest

from app_pages import serving
from gainroom.app.server import HEADERS_WITHIN

websockets = pytest.importorskip("websockets.sync.client")


@pytest.mark.slow
def test_a_page_that_asks_for_nothing_keeps_its_connection():
    """For half as long again as a connection without a request is kept."""
    with serving(None) as served:
        origin = served.address.rstrip("/")
        with websockets.connect(f"ws{origin.removeprefix('http')}/ws", origin=origin, max_size=None) as socket:
            assert '"part":"opening"' in socket.recv()
            time.sleep(1.5 * HEADERS_WITHIN)
            socket.ping().wait(10.0)
            socket.send('{"view":{},"ask":"look","key":1}')
            assert '"part"' in socket.recv(60.0)

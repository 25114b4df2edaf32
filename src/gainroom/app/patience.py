"""Time limits of connections: one that does not send a request in time is closed, so that nobody blocks the page by waiting."""

import asyncio

from uvicorn.protocols.http.h11_impl import H11Protocol

HEADERS_WITHIN = 10.0
"""Time for a request [s], from the connection, or from its first byte on one that has had an answer."""
MOST_UNASKED = 64
"""Maximum number of connections without a request; beyond it the oldest is closed. A browser opens six to a server."""


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

"""Requests that do not come to their end are closed: headers and each part of a body have a time in which they must arrive."""

from __future__ import annotations

import asyncio
from typing import Any

import h11
from uvicorn.protocols.http.h11_impl import H11Protocol

#: Seconds for the headers of a request, and for the next part of its body.
HEADER_SECONDS, BODY_SECONDS = 10.0, 30.0


class DeadlineProtocol(H11Protocol):
    """HTTP/1.1 as uvicorn speaks it, which waits only so long for the rest of a request's headers."""

    _waiting: asyncio.TimerHandle | None = None

    def connection_made(self, transport: Any) -> None:
        """A connection, whose first request is awaited."""
        super().connection_made(transport)
        self._await_headers()

    def data_received(self, data: bytes) -> None:
        """Handle the bytes `data`; the time limit for headers starts with each request, and is not extended by each byte."""
        super().data_received(data)
        if self.conn.their_state is not h11.IDLE:
            self._stop_waiting()
        elif self._waiting is None:
            self._await_headers()

    def connection_lost(self, exc: Exception | None) -> None:
        """The end of a connection."""
        self._stop_waiting()
        super().connection_lost(exc)

    def _await_headers(self) -> None:
        self._stop_waiting()
        self._waiting = self.loop.call_later(HEADER_SECONDS, self._close_where_waiting)

    def _stop_waiting(self) -> None:
        if self._waiting is not None:
            self._waiting.cancel()
            self._waiting = None

    def _close_where_waiting(self) -> None:
        """Close the connection when the time limit for headers has passed, unless a response is still being sent."""
        self._waiting = None
        is_answering = self.cycle is not None and not self.cycle.response_complete
        if not (is_answering or self.transport.is_closing()):
            self.transport.close()

"""Connections of a listener: how many there may be, and how long one may take to say what it wants.

uvicorn waits for a request's first line for ever. Here a request has to be complete within some seconds; where there is
no room for another connection, the one goes that has been waiting for longest without having asked for anything, so
that half-open ones shut nobody out. Connections whose request is being answered stay.
"""

from __future__ import annotations

import asyncio
import math
from typing import Any

from uvicorn.protocols.http.h11_impl import H11Protocol, RequestResponseCycle

WHOLE_REQUEST_S = 10.0  # for head and body; a configuration is 1 MB at most
STALLED_S = 20.0  # for taking some of an answer; a page whose computer sleeps asks again when it wakes


class BoundedProtocol(H11Protocol):
    """most: connections at a time."""

    def __init__(self, most: int, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self._most = most
        self._overdue: asyncio.TimerHandle | None = None
        self._stalled: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Make room, or close at once."""
        super().connection_made(transport)
        self._wait_for_request()
        if len(self.connections) > self._most and not self._make_room():
            transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is waited for any more."""
        self._wait_no_more()
        self._take_again()
        super().connection_lost(exc)

    def data_received(self, data: bytes) -> None:
        """Bytes of a request: from its first one it has its time."""
        if self._overdue is None and not self._answering():
            self._wait_for_request()
        super().data_received(data)
        if self._answering() and not self.cycle.more_body:
            self._wait_no_more()

    def on_response_complete(self) -> None:
        """A request that came meanwhile is answered next; else uvicorn waits some seconds for another one."""
        self._wait_no_more()
        super().on_response_complete()
        if self._answering() and self.cycle.more_body:
            self._wait_for_request()

    def pause_writing(self) -> None:
        """Whoever asked does not take the answer."""
        super().pause_writing()
        self._stalled = self.loop.call_later(STALLED_S, self._drop)

    def resume_writing(self) -> None:
        """It is taken."""
        self._take_again()
        super().resume_writing()

    def _take_again(self) -> None:
        if self._stalled is not None:
            self._stalled.cancel()
            self._stalled = None

    def _answering(self) -> bool:
        cycle: RequestResponseCycle | None = self.cycle  # none before the first request
        return cycle is not None and not cycle.response_complete

    def _wait_for_request(self) -> None:
        self._wait_no_more()
        self._overdue = self.loop.call_later(WHOLE_REQUEST_S, self._drop)

    def _wait_no_more(self) -> None:
        if self._overdue is not None:
            self._overdue.cancel()
            self._overdue = None

    def _drop(self) -> None:
        self._overdue = None
        if self.transport is not None:
            self.transport.abort()

    def _make_room(self) -> bool:
        """Drop the connection that has been waiting for longest, of all but this one; False where none is."""
        waiting: list[BoundedProtocol] = [
            one
            for one in self.connections
            if isinstance(one, BoundedProtocol) and one is not self and not one._answering()
        ]
        if not waiting:
            return False
        oldest = min(waiting, key=lambda one: one._overdue.when() if one._overdue is not None else math.inf)
        self.connections.discard(oldest)  # its end is told later; the room is there now
        oldest._drop()
        return True


def bounded(most: int) -> type[asyncio.Protocol]:
    """The protocol as uvicorn makes it, with a bound on its connections."""

    class Bounded(BoundedProtocol):
        def __init__(self, *given: Any, **named: Any) -> None:
            super().__init__(most, *given, **named)

    return Bounded

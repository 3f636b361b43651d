"""One HTTP request to a bench, and its answer as JSON, within a time for all of it. The protocol is h11's."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import ssl
from typing import Any, NamedTuple
from urllib.parse import urlsplit

import h11

LARGEST = 2_000_000  # bytes of an answer; a state takes two thousand
AT_ONCE = 65_536  # bytes


class Unanswered(Exception):
    """No answer, or none that can be read."""


class Place(NamedTuple):
    """Where a bench listens. secure: None for plain HTTP."""

    host: str
    port: int
    secure: ssl.SSLContext | None

    @property
    def name(self) -> str:
        """For the Host header."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"


def place_of(address: str) -> Place:
    """The place that an http or https address names."""
    parts = urlsplit(address)
    secure = ssl.create_default_context() if parts.scheme == "https" else None
    return Place(str(parts.hostname), parts.port or (443 if secure else 80), secure)


async def exchange(
    place: Place, method: str, path: str, token: str | None, body: Any, within_s: float
) -> tuple[int, Any]:
    """(status, JSON) of a request on a connection of its own. Raises Unanswered."""
    try:
        async with asyncio.timeout(within_s):
            reader, writer = await asyncio.open_connection(place.host, place.port, ssl=place.secure)
            try:
                return await _exchange(reader, writer, _request(place, method, path, token, body))
            finally:
                writer.close()
    except TimeoutError:
        raise Unanswered(f"no answer within {within_s:g} s") from None
    except OSError as error:
        raise Unanswered(_in_words(error)) from None
    except (h11.RemoteProtocolError, ValueError, RecursionError) as error:
        raise Unanswered(f"what answers there is no bench: {error}") from None


def _in_words(error: OSError) -> str:
    """Why nothing could be sent; asyncio's own words leave out the cause."""
    if error.errno is not None and error.errno > 0:
        return os.strerror(error.errno).lower()
    return error.strerror or str(error) or type(error).__name__


def _request(place: Place, method: str, path: str, token: str | None, body: Any) -> tuple[h11.Request, bytes]:
    content = b"" if method == "GET" else json.dumps(body).encode()
    headers = [("Host", place.name), ("Connection", "close"), ("Accept", "application/json")]
    if method != "GET":
        length = ("Content-Length", str(len(content)))
        headers += [("Content-Type", "application/json"), ("X-Peltier", "1"), length]
    if token is not None:
        headers.append(("Authorization", f"Bearer {token}"))
    return h11.Request(method=method, target=path, headers=headers), content


async def _exchange(
    reader: asyncio.StreamReader, writer: asyncio.StreamWriter, request: tuple[h11.Request, bytes]
) -> tuple[int, Any]:
    connection = h11.Connection(h11.CLIENT)
    head, content = request
    parts = [connection.send(head), connection.send(h11.Data(content)), connection.send(h11.EndOfMessage())]
    writer.write(b"".join(part for part in parts if part))
    status, found = 0, bytearray()
    while True:
        event = connection.next_event()
        if event is h11.NEED_DATA:
            connection.receive_data(await reader.read(AT_ONCE))
        elif isinstance(event, h11.Response):
            status = event.status_code
        elif isinstance(event, h11.Data):
            found += event.data
            if len(found) > LARGEST:
                raise ValueError(f"an answer of more than {LARGEST} bytes")
        elif isinstance(event, (h11.EndOfMessage, h11.ConnectionClosed)):
            return status, json.loads(found) if found else None


async def first_success(*ways: Any) -> tuple[int, Any]:
    """The first answer of several requests that is a success; else the last that was none. Raises Unanswered.

    The others are left to end by themselves: each of them is a STOP that may still be needed.
    """
    tasks = [asyncio.ensure_future(way) for way in ways]
    refused: tuple[int, Any] | None = None
    silent = Unanswered("nowhere to ask")
    for done in asyncio.as_completed(tasks):
        try:
            status, answer = await done
        except Unanswered as error:
            silent = error
            continue
        if status == 200:
            _let_end([task for task in tasks if not task.done()])
            return status, answer
        refused = status, answer
    if refused is None:
        raise silent
    return refused


def _let_end(tasks: list[asyncio.Future[Any]]) -> None:
    """What comes of them is of no interest any more, a failure included."""
    for task in tasks:
        _kept.add(task)
        task.add_done_callback(_ended)


def _ended(task: asyncio.Future[Any]) -> None:
    _kept.discard(task)
    with contextlib.suppress(asyncio.CancelledError):
        task.exception()


_kept: set[asyncio.Future[Any]] = set()  # a task that nobody holds may be collected before it has ended

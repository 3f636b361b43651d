"""Who may ask what: names of this host, the same origin, the header that no form can set, the token, the body's size.

Host      one of ours: another name that leads here (DNS rebinding) is refused
Origin    where it is there, this very host
X-Peltier and application/json on whatever changes something: another site's page can send neither unasked
token     beyond the loopback, compared in constant time; as Bearer or as the session's cookie
body      1 MB
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from http.cookies import CookieError, SimpleCookie
from typing import Any

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

LARGEST_BODY = 1_000_000  # bytes
LOOPBACK = {"127.0.0.1", "localhost", "::1", "[::1]"}
COOKIE = "peltier_session"
SAFE = {"GET", "HEAD"}
MOST_SESSIONS = 1000
HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"SAMEORIGIN"),
    (b"referrer-policy", b"no-referrer"),
]


class Sessions:
    """Cookies that stand for the token, until the process ends."""

    def __init__(self, token: str | None) -> None:
        self._token = token
        self._open: dict[str, None] = {}

    def begin(self, token: object) -> str | None:
        """A new session's name for who knows the token."""
        if self._token is None or not isinstance(token, str) or not same(token, self._token):
            return None
        name = secrets.token_urlsafe(32)
        self._open[name] = None
        while len(self._open) > MOST_SESSIONS:
            self._open.pop(next(iter(self._open)))
        return name

    def knows(self, headers: Headers) -> bool:
        """Whether the request brings the token or a session's cookie."""
        if self._token is None:
            return True
        kind, _, given = headers.get("authorization", "").partition(" ")
        if kind.lower() == "bearer" and same(given.strip(), self._token):
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            return False
        return cookie is not None and any(same(cookie.value, name) for name in self._open)


def same(one: str, other: str) -> bool:
    """Whether two secrets are the same, in a time that does not tell where they differ."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))


class Protection:
    """The outermost layer. needs_token: beyond the loopback, where the host's numbers are accepted as its name, too,
    because no other site's name is a number; hosts: names by which this host is reached."""

    def __init__(self, app: ASGIApp, hosts: set[str], needs_token: bool, sessions: Sessions) -> None:
        self._app, self._hosts, self._needs_token, self._sessions = app, hosts, needs_token, sessions

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            elif scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008})
            return
        status, text = self._refused(scope)
        if status:
            await _answer(status, text)(scope, receive, send)
            return
        body = _Body(receive)
        try:
            await self._app(scope, body.receive, _with_headers(send))
        except TooLarge:
            await _answer(413, f"body: expected at most {LARGEST_BODY} bytes")(scope, receive, send)

    def _refused(self, scope: Scope) -> tuple[int, str]:
        headers = Headers(scope=scope)
        host = _host(headers.get("host", ""))
        if host not in self._hosts and not (self._needs_token and _is_number(host)):
            return 403, "host: expected a name of this bench (serve.hosts)"
        origin = headers.get("origin")
        if origin is not None and origin.rpartition("://")[2].lower() != headers.get("host", "").lower():
            return 403, "origin: expected this bench's own page"
        path = str(scope["path"])
        if self._needs_token and _secret(path) and not self._sessions.knows(headers):
            return 401, "token: missing or wrong; expected Authorization: Bearer TOKEN"
        if scope["method"] not in SAFE:
            if headers.get("x-peltier") != "1":
                return 403, "x-peltier: missing; expected X-Peltier: 1"
            if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
                return 415, "content-type: expected application/json"
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit()):
            return 400, "content-length: expected a number"
        if int(length) > LARGEST_BODY:
            return 413, f"body: expected at most {LARGEST_BODY} bytes"
        return 0, ""


class TooLarge(Exception):
    """A body without a length, longer than is read."""


class _Body:
    """Counts the bytes of a body as they come."""

    def __init__(self, receive: Receive) -> None:
        self._receive, self._seen = receive, 0

    async def receive(self) -> Message:
        message = await self._receive()
        self._seen += len(message.get("body", b""))
        if self._seen > LARGEST_BODY:
            raise TooLarge
        return message


def _secret(path: str) -> bool:
    return path.startswith(("/api/", "/runs/", "/metrics")) and path != "/api/session"


def _host(text: str) -> str:
    """The name in a Host header, without its port."""
    if text.startswith("["):
        return text.partition("]")[0].lower() + "]"
    return text.partition(":")[0].lower()


def _is_number(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True


def _answer(status: int, text: str) -> Any:
    more = {"WWW-Authenticate": "Bearer"} if status == 401 else {}
    return JSONResponse({"faults": [text]}, status, headers=more)


def _with_headers(send: Send) -> Send:
    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *HEADERS]
        await send(message)

    return sending

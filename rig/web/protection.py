"""Who may ask: names of this host, the same origin, a header that no form can set, the token, the size of the body.

address   valid Unicode
Host      one of ours: another name that leads here (DNS rebinding) is refused
Origin    if there is one, one of ours, with its scheme (`Names`)
X-Peltier and application/json on every request that changes something: another site's page cannot send them unasked
token     wherever one is set, compared in constant time; as Bearer or as the session's cookie
body      1 MB

Origins by which this bench may be asked:

the bench's own address, the loopback's names     http, at the port that was asked
numbers, if it listens beyond the loopback        the same; no other site's name is a number
"bench.lab.example" in serve.hosts                http or https, at the port that was asked
"https://bench.lab.example" in serve.hosts        exactly this origin, whatever Host its proxy sends
"""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Iterable
from http.cookies import CookieError, SimpleCookie
from typing import Any
from urllib.parse import unquote_to_bytes

from starlette.datastructures import Headers
from starlette.responses import JSONResponse
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from rig.core.json_text import usable

LARGEST_BODY = 1_000_000  # bytes
METRICS = "/metrics"
COOKIE = "peltier_session"
SAFE = {"GET", "HEAD"}
FORBIDDEN = 403  # HTTP's status
MOST_SESSIONS = 1000  # of browsers; the oldest goes, and its browser asks for the token again
HEADERS = [
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"SAMEORIGIN"),
    (b"referrer-policy", b"no-referrer"),
]
LOOPBACK = {"127.0.0.1", "localhost", "::1", "[::1]"}
EVERYWHERE = {"0.0.0.0", "::"}


class Names:
    """Names of this bench. address, hosts: of [serve]. page_port: the port of the page's origin if it differs from the
    one asked, as for STOP's own listener; 0: any."""

    def __init__(self, address: str, hosts: Iterable[str], page_port: int | None = None) -> None:
        self._numbers = address not in LOOPBACK
        self._page_port = page_port
        self._own = LOOPBACK | ({address.lower()} if address not in EVERYWHERE else set())
        given = [host.lower() for host in hosts]
        self._origins = {host for host in given if "://" in host}
        self._named = {host_name(host) for host in given if "://" not in host}
        self._reached = self._own | self._named | {host_name(host.partition("://")[2]) for host in self._origins}

    def reach(self, host: str) -> bool:
        """Return True if a Host header is one of this bench's."""
        name = host_name(host)
        return name in self._reached or (self._numbers and _is_number(name))

    def allow(self, origin: str, host: str) -> bool:
        """Return True if a page of an origin may send a request to `host`."""
        origin, name = origin.lower(), host_name(host)
        if origin in self._origins:
            return True
        scheme, _, place = origin.partition("://")
        schemes = {"http", "https"} if name in self._named else {"http"} if self._is_own(name) else set()
        if scheme not in schemes:
            return False
        if self._page_port is None:
            return place == host.lower()
        port = place[len(name) :]
        return host_name(place) == name and (not self._page_port or port in (f":{self._page_port}", ""))

    def _is_own(self, name: str) -> bool:
        return name in self._own or (self._numbers and _is_number(name))


def host_name(text: str) -> str:
    if text.startswith("["):
        return text.partition("]")[0].lower() + "]"
    return text.partition(":")[0].lower()


def _is_number(host: str) -> bool:
    try:
        ipaddress.ip_address(host.strip("[]"))
    except ValueError:
        return False
    return True


class Sessions:
    """Cookies in place of the token, until the process ends."""

    def __init__(self, token: str | None, metrics_token: str | None = None) -> None:
        self._token, self._metrics_token = token, metrics_token
        self._open: dict[str, None] = {}

    def begin(self, token: object) -> str | None:
        """Return a new session's name for the right token."""
        if self._token is None or not isinstance(token, str) or not same(token, self._token):
            return None
        name = secrets.token_urlsafe(32)
        self._open[name] = None
        while len(self._open) > MOST_SESSIONS:
            self._open.pop(next(iter(self._open)))
        return name

    def needed(self, path: str) -> bool:
        """Return True if a path requires a token."""
        if path == METRICS:
            return self._token is not None or self._metrics_token is not None
        return self._token is not None and path.startswith(("/api/", "/runs/")) and path != "/api/session"

    def knows(self, path: str, headers: Headers) -> bool:
        """Return True if the request has the token or a session's cookie; for the metrics also their token."""
        kind, _, given = headers.get("authorization", "").partition(" ")
        known = [self._token, self._metrics_token] if path == METRICS else [self._token]
        if kind.lower() == "bearer" and any(same(given.strip(), token) for token in known if token is not None):
            return True
        try:
            cookie = SimpleCookie(headers.get("cookie", "")).get(COOKIE)
        except CookieError:
            return False
        return cookie is not None and any(same(cookie.value, name) for name in self._open)


def same(one: str, other: str) -> bool:
    """Return True if two secrets are equal, in a time that does not depend on where they differ."""
    return hmac.compare_digest(one.encode("utf-8", "surrogatepass"), other.encode("utf-8", "surrogatepass"))


class Protection:
    """The outermost layer. elsewhere: True if pages of this bench's other addresses may read the answers (CORS)."""

    def __init__(self, app: ASGIApp, names: Names, sessions: Sessions, elsewhere: bool = False) -> None:
        self._app, self._names, self._sessions, self._elsewhere = app, names, sessions, elsewhere

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] != "http":
            if scope["type"] == "lifespan":
                await self._app(scope, receive, send)
            elif scope["type"] == "websocket":
                await receive()
                await send({"type": "websocket.close", "code": 1008})
            return
        status, text = self._refused(scope)
        origin = Headers(scope=scope).get("origin") if self._elsewhere else None
        send_with = _with_headers(send, origin if status != FORBIDDEN else None)
        if status:
            await _answer(status, text)(scope, receive, send_with)
            return
        body = _Body(receive)
        try:
            await self._app(scope, body.receive, send_with)
        except TooLarge:
            await _answer(413, f"body: expected at most {LARGEST_BODY} bytes")(scope, receive, send)

    def _refused(self, scope: Scope) -> tuple[int, str]:
        headers = Headers(scope=scope)
        host = headers.get("host", "")
        if not self._names.reach(host):
            return FORBIDDEN, "host: expected a name of this bench (serve.hosts)"
        origin = headers.get("origin")
        if origin is not None and not self._names.allow(origin, host):
            return FORBIDDEN, "origin: expected this bench's own page, or an origin of serve.hosts"
        if not (_is_text(scope.get("raw_path", b"")) and _is_text(scope["query_string"])):
            return 400, "address: expected valid Unicode"
        if self._elsewhere and scope["method"] == "OPTIONS":
            return 0, ""  # a browser that asks whether it may ask; it brings no token
        path = str(scope["path"])
        if self._sessions.needed(path) and not self._sessions.knows(path, headers):
            return 401, "token: missing or wrong; expected Authorization: Bearer TOKEN"
        if scope["method"] not in SAFE:
            if headers.get("x-peltier") != "1":
                return FORBIDDEN, "x-peltier: missing; expected X-Peltier: 1"
            if headers.get("content-type", "").partition(";")[0].strip().lower() != "application/json":
                return 415, "content-type: expected application/json"
        length = headers.get("content-length", "0")
        if not (length.isascii() and length.isdigit() and len(length) < 20):
            return 400, "content-length: expected a number"
        if int(length) > LARGEST_BODY:
            return 413, f"body: expected at most {LARGEST_BODY} bytes"
        return 0, ""


class TooLarge(Exception):
    """A body without a length, and too long."""


class _Body:
    """Counts the bytes of a body."""

    def __init__(self, receive: Receive) -> None:
        self._receive, self._seen = receive, 0

    async def receive(self) -> Message:
        message = await self._receive()
        self._seen += len(message.get("body", b""))
        if self._seen > LARGEST_BODY:
            raise TooLarge
        return message


def _is_text(quoted: bytes) -> bool:
    """Return True if a part of an address is text once its percent signs are resolved."""
    try:
        return usable(unquote_to_bytes(quoted).decode("utf-8"))
    except UnicodeDecodeError:
        return False


def _answer(status: int, text: str) -> Any:
    more = {"WWW-Authenticate": "Bearer"} if status == 401 else {}
    return JSONResponse({"faults": [text]}, status, headers=more)


def _with_headers(send: Send, origin: str | None) -> Send:
    """Add headers to the answer. origin: of a page elsewhere that may read it."""
    more = [(b"access-control-allow-origin", origin.encode("latin-1")), (b"vary", b"origin")] if origin else []

    async def sending(message: Message) -> None:
        if message["type"] == "http.response.start":
            message["headers"] = [*message.get("headers", []), *HEADERS, *more]
        await send(message)

    return sending

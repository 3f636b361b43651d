"""Replies as JSON, and the bench process's answer as one."""

from __future__ import annotations

import json
from typing import Any

from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect, Request
from starlette.responses import Response

from rig.core.json_text import finite, parsed_json
from rig.web.bench_link import BenchGone, BenchLink

SERVER_FAULT = 500  # HTTP's status, where the bench process gives none
LONGEST_NAME = 80  # characters of a press or an address, which go into the log


class Refusal(Exception):
    """A request that gets another answer than the one it asked for."""

    def __init__(self, status: int, *lines: str, **headers: str) -> None:
        self.status, self.lines, self.headers = status, lines, headers
        super().__init__("; ".join(lines))


def said(value: Any, status: int = 200) -> Response:
    """A value as JSON, whatever is in it: what was kept before the door refused broken text is shown with a ?."""
    return Response(encoded(value), status, media_type="application/json")


def encoded(value: Any) -> bytes:
    """JSON as UTF-8; it knows neither infinity nor not-a-number nor half a surrogate pair."""
    try:
        text = json.dumps(value, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    except ValueError:
        text = json.dumps(finite(value), ensure_ascii=False, separators=(",", ":"))
    return text.encode("utf-8", "replace")


def failed(status: int, *lines: str, **headers: str) -> Response:
    """A refusal with its reasons."""
    response = said({"faults": list(lines)}, status)
    response.headers.update({name.replace("_", "-"): text for name, text in headers.items()})
    return response


async def asked(link: BenchLink, do: str, **more: Any) -> dict[str, Any]:
    """The bench process's answer without what only its socket needs. Raises Refusal."""
    try:
        answer = await link.ask(do, **more)
    except BenchGone as error:
        raise Refusal(503, str(error)) from None
    if not answer.get("ok"):
        raise Refusal(int(answer.get("status", SERVER_FAULT)), *map(str, answer.get("faults", [])))
    return {key: value for key, value in answer.items() if key != "ok"}


async def given(request: Request) -> dict[str, Any]:
    """The object in a request's body. Raises Refusal."""
    try:
        body = parsed_json(await request.body())
    except ValueError as error:
        raise Refusal(400, f"body: {error}") from None
    except ClientDisconnect:
        raise Refusal(400, "body: it ended early") from None
    if not isinstance(body, dict):
        raise Refusal(422, "body: expected an object")
    return body


async def stopped(link: BenchLink, request: Request) -> Response:
    """The output off."""
    more = {"press": press} if (press := await _press(request)) is not None else {}
    return said(await asked(link, "stop", by=f"the page ({client(request)})", **more))


async def _press(request: Request) -> str | None:
    """Which press of STOP this is, where its body says so; a STOP is taken whatever its body is."""
    try:
        press = (await given(request)).get("press")
    except Refusal:
        return None
    return press[:LONGEST_NAME] if isinstance(press, str) else None


def client(request: Request) -> str:
    """Who asks, as far as the connection, or the proxy on this computer, says so."""
    return request.client.host[:LONGEST_NAME] if request.client is not None else "somewhere"


async def refused(request: Request, error: Exception) -> Response:
    """What becomes of a Refusal, for starlette, and of an address or a method that there is not."""
    if isinstance(error, HTTPException):
        line = f"{request.method} {request.url.path[:LONGEST_NAME]}: {error.detail}"
        return failed(error.status_code, line, **dict(error.headers or {}))
    assert isinstance(error, Refusal)
    return failed(error.status, *error.lines, **error.headers)

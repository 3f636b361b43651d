"""Announce what happens: server-sent events to local listeners, a trip to another machine by a webhook."""

from __future__ import annotations

import contextlib
import http.client
import json
import queue
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rig.core.json_text import finite

MOST_WAITING = 500  # events for one listener
TIMEOUT_S = 5.0  # a webhook's server that is there answers within one
WAITS_S = (0.0, 1.0, 5.0, 30.0)  # before each try of a webhook


class Announcer:
    """Passes events from any thread to every listener's queue; a listener that is too slow is dropped."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listeners: list[queue.Queue[bytes | None]] = []

    def listen(self) -> queue.Queue[bytes | None]:
        """Return a queue of the events from now on. None in it: the listener was too slow, or the daemon ends."""
        listener: queue.Queue[bytes | None] = queue.Queue(MOST_WAITING)
        with self._lock:
            self._listeners.append(listener)
        return listener

    def leave(self, listener: queue.Queue[bytes | None]) -> None:
        with self._lock, contextlib.suppress(ValueError):
            self._listeners.remove(listener)

    def announce(self, event: str, data: Any) -> None:
        """Put an event into every queue; never waits."""
        with self._lock:
            if not self._listeners:
                return
            line = sent_event(event, data)
            for listener in list(self._listeners):
                try:
                    listener.put_nowait(line)
                except queue.Full:
                    self._listeners.remove(listener)
                    with contextlib.suppress(queue.Empty):
                        listener.get_nowait()
                    listener.put_nowait(None)

    def close(self) -> None:
        with self._lock:
            for listener in self._listeners:
                with contextlib.suppress(queue.Full):
                    listener.put_nowait(None)
            self._listeners.clear()


def sent_event(event: str, data: Any) -> bytes:
    """Return one server-sent event."""
    return b"event: " + event.encode() + b"\ndata: " + encoded(data) + b"\n\n"


def encoded(value: Any) -> bytes:
    """Return JSON in one line. Not-a-number and infinity are null, a path is text, half a surrogate pair is a ?."""
    how: Any = {"ensure_ascii": False, "separators": (",", ":"), "default": _plain}
    try:
        text = json.dumps(value, allow_nan=False, **how)
    except ValueError:
        text = json.dumps(finite(value), **how)
    return text.encode("utf-8", "replace")


def _plain(value: Any) -> Any:
    if hasattr(value, "item"):  # numpy's numbers
        return finite(value.item())
    return str(value) if isinstance(value, Path) else repr(value)


def post_webhook(
    url: str, document: dict[str, Any], report: Callable[[str], None], waits_s: tuple[float, ...] = WAITS_S
) -> threading.Thread:
    """POST a document as JSON in a thread, with several tries; `report` gets a line if all of them failed, without the
    address, which is a secret."""
    thread = threading.Thread(target=_post, args=(url, document, report, waits_s), name="webhook", daemon=True)
    thread.start()
    return thread


def _post(url: str, document: dict[str, Any], report: Callable[[str], None], waits_s: tuple[float, ...]) -> None:
    body, failure = json.dumps(document).encode(), ""
    for wait_s in waits_s:
        time.sleep(wait_s)
        request = urllib.request.Request(url, body, {"Content-Type": "application/json"}, method="POST")
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S):
                return
        except (OSError, ValueError) as error:  # URLError and time-outs are OSErrors
            failure = str(error).replace(url, "its address")
        except http.client.HTTPException as error:  # no HTTP; its text may contain the address
            failure = type(error).__name__
    report(f"webhook: {failure} ({len(waits_s)} tries)")

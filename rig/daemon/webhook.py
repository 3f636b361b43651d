"""A trip told to another machine: POST with JSON, in a thread of its own, tried again a few times."""

from __future__ import annotations

import http.client
import json
import threading
import time
import urllib.error
import urllib.request
from collections.abc import Callable
from typing import Any

TIMEOUT_S = 5.0  # a server that is there answers within one
WAITS_S = (0.0, 1.0, 5.0, 30.0)  # before each try


def post(
    url: str, document: dict[str, Any], told: Callable[[str], None], waits_s: tuple[float, ...] = WAITS_S
) -> threading.Thread:
    """Send it in the background; `told` gets a line where every try failed, without the address, which is a secret."""
    thread = threading.Thread(target=_send, args=(url, document, told, waits_s), name="webhook", daemon=True)
    thread.start()
    return thread


def _send(url: str, document: dict[str, Any], told: Callable[[str], None], waits_s: tuple[float, ...]) -> None:
    body = json.dumps(document).encode()
    failure = ""
    for wait_s in waits_s:
        time.sleep(wait_s)
        request = urllib.request.Request(url, body, {"Content-Type": "application/json"}, method="POST")
        try:
            with urllib.request.urlopen(request, timeout=TIMEOUT_S):
                return
        except (OSError, ValueError) as error:  # URLError and time-outs are OSErrors
            failure = str(error).replace(url, "its address")
        except http.client.HTTPException as error:  # no HTTP; its text may show the address
            failure = type(error).__name__
    told(f"webhook: {failure} ({len(waits_s)} tries)")

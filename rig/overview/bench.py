"""One bench as the overview knows it: asked for its state about once a second, and stopped when somebody presses STOP.

Each bench is asked in a task of its own, so that one that does not answer holds up no other.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Any

from rig.overview.configuration import BenchTable
from rig.overview.exchange import Unanswered, exchange, first_success, place_of

# A bench that falls silent right after an answer is asked again a second later, and shown as silent when that has had
# no answer for as long as stands here: 2.5 s in all.
PERIOD_S, ANSWER_S = 1.0, 1.5
STOP_S = 15.5  # a bench waits 15 s for its instruments
SHOWN = ("state", "output", "output_confirmed", "trip", "stop", "job", "queue", "reading", "limits", "drive_unit")
SHOWN_TOO = ("time_s", "ticks", "warnings", "version")


class Bench:
    """changed: called when what is known of it has changed."""

    def __init__(self, table: BenchTable, changed: Callable[[], None]) -> None:
        self.name, self.address = table.name, table.address
        self._token = table.token.get_secret_value() if table.token is not None else None
        self._place = place_of(table.address)
        self._changed = changed
        self._state: dict[str, Any] = {}
        self._stop_port: int | None = None
        self._heard_s: float | None = None  # time.monotonic()
        self._trouble: str | None = "not asked yet"

    async def watch(self) -> None:
        """Ask for ever."""
        while True:
            began_s = time.monotonic()
            await self._look()
            self._changed()
            await asyncio.sleep(max(0.0, began_s + PERIOD_S - time.monotonic()))

    async def _look(self) -> None:
        try:
            status, answer = await exchange(self._place, "GET", "/api/state", self._token, None, ANSWER_S)
        except Unanswered as error:
            self._trouble = str(error)
            return
        if status != 200 or not isinstance(answer, dict):
            self._trouble = _in_words(status, answer)
            return
        self._state = {key: answer.get(key) for key in SHOWN + SHOWN_TOO}
        port = answer.get("stop_port")
        self._stop_port = port if isinstance(port, int) else None
        self._heard_s, self._trouble = time.monotonic(), None

    def shown(self) -> dict[str, Any]:
        """For the page. state: the last one known, null before the first; trouble: null while it answers."""
        silent_s = None if self._heard_s is None else time.monotonic() - self._heard_s
        known = {"name": self.name, "address": self.address, "trouble": self._trouble, "silent_s": silent_s}
        return {**known, "state": self._state or None}

    async def stop(self, press: str) -> tuple[int, Any]:
        """STOP to the bench's page and to STOP's own listener at once; the first success counts. Raises Unanswered."""
        body = {"press": press}
        places = [self._place]
        if self._stop_port is not None and self._place.secure is None:  # behind a proxy the page's address has to do
            places.append(self._place._replace(port=self._stop_port))
        ways = [exchange(place, "POST", "/api/stop", self._token, body, STOP_S) for place in places]
        return await first_success(*ways)


def _in_words(status: int, answer: Any) -> str:
    """What a bench said in the place of its state."""
    if status == 401:
        return "the bench does not take the token of this overview"
    faults = answer.get("faults") if isinstance(answer, dict) else None
    return "; ".join(map(str, faults))[:300] if isinstance(faults, list) and faults else f"the bench answers {status}"

"""The page's questions to the history: in threads with deadlines, and the film in the (T, R) plane.

A query over a month takes one processor for a moment; forty at once would hold up everybody. Here they wait in line,
which costs nothing, and one that would wait for too long is refused. The memory of the film is the model's, driven by
the temperatures in the history since the film was last saturated; each request brings it up to date. numba is imported
when there is a model, and not before.
"""

from __future__ import annotations

import asyncio
import sqlite3
import threading
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from rig.history.reading import loop_points, temperatures
from rig.records.film_output import output_to_ohm

AT_ONCE = 2  # queries: each takes a thread and a read of the disk
MOST_WAITING = 60  # with figures of a month, some 60 ms each, the last one is answered in time
DEADLINE_S = 8.0  # in line and in work; the page waits for 30 s


class Busy(Exception):
    """Too many queries wait."""


class TooLong(Exception):
    """A query was not answered within the deadline."""


class HistoryQueries:
    """Answers queries in threads of its own."""

    def __init__(self, deadline_s: float = DEADLINE_S, at_once: int = AT_ONCE) -> None:
        self._deadline_s, self._most = deadline_s, at_once + MOST_WAITING
        self._threads = ThreadPoolExecutor(at_once, "history")
        self._waiting = 0

    async def answer(self, query: Callable[[float], Any]) -> Any:
        """Return the result of a query, which gets the time.monotonic at which it has to end.

        Raises Busy, TooLong, and the query's exceptions.
        """
        if self._waiting >= self._most:
            raise Busy
        ends_s = time.monotonic() + self._deadline_s
        self._waiting += 1
        try:
            task = asyncio.get_running_loop().run_in_executor(self._threads, _result, query, ends_s)
            task.add_done_callback(self._one_less)
        except BaseException:
            self._waiting -= 1
            raise
        try:
            async with asyncio.timeout(self._deadline_s + 0.5):
                return await asyncio.shield(task)
        except TimeoutError:
            raise TooLong from None

    def _one_less(self, task: asyncio.Future[Any]) -> None:
        self._waiting -= 1
        if not task.cancelled():
            task.exception()  # retrieved, even if nobody waits for it any more

    def close(self) -> None:
        """Let the threads end."""
        self._threads.shutdown(wait=False, cancel_futures=True)


def _result(query: Callable[[float], Any], ends_s: float) -> Any:
    if time.monotonic() >= ends_s:
        raise TooLong
    try:
        return query(ends_s)
    except sqlite3.OperationalError:
        if time.monotonic() >= ends_s:
            raise TooLong from None
        raise


HOUR_S = 3600.0  # of points shown: some cycles of the film
POINTS = 1500  # more overlap on a figure of 600 pixels
CURVE_POINTS = 121  # over the limits' range, some 0.8 K apart, drawn with straight lines
TURN_K = 0.1  # a reversal by less is noise
MOST_ROWS = 500_000  # that one request catches up with; a week at 10 Hz takes twelve


class LoopPlane:
    """Answers `GET /api/loop` from a history; safe for several threads."""

    def __init__(self, history: Path) -> None:
        self._history = history
        self._lock = threading.Lock()
        self._key: tuple[object, ...] = ()
        self._film: _FollowedFilm | None = None

    def document(
        self, model: str | None, memory_since_s: float | None, limits_degC: list[float], now_s: float
    ) -> dict[str, Any]:
        """Return the answer. memory_since_s: Unix s since when the film's memory is known; None: it is not. Raises
        sqlite3.Error."""
        points = loop_points(self._history, now_s - HOUR_S, POINTS)
        found: dict[str, Any] = {
            "temperature_degC": [point[1] for point in points],
            "resistance_ohm": [point[2] for point in points],
            "model": None,
            "memory": None,
        }
        with self._lock:
            key = (model, memory_since_s, tuple(limits_degC))
            if key != self._key:
                self._key, self._film = key, _followed(model, memory_since_s, limits_degC)
            if self._film is not None:
                found["model"] = self._film.curves
                found["memory"] = self._film.memory(self._history)
        return found


def _followed(model: str | None, since_s: float | None, limits_degC: list[float]) -> _FollowedFilm | None:
    """Return the film of a model file; None if there is no such file, or no film with a resistance in it."""
    if model is None or not Path(model).is_file():
        return None
    from rig.config.model_file import read_model
    from rig.core.faults import Faults

    try:
        known = read_model(Path(model))
        falls = known.film is not None and known.film.output == "minus_log10_ohm"
        return _FollowedFilm(known, since_s, limits_degC) if falls else None
    except (Faults, OSError, ValueError):
        return None


class _FollowedFilm:
    """A film model, its major loop, and its memory as far as the history was followed."""

    def __init__(self, known: Any, since_s: float | None, limits_degC: list[float]) -> None:
        import numpy as np

        low, high = limits_degC
        film = known.film
        self._model, self._mixing, self._limits = film, known.mixing, (low, high)
        self._at_s, self._memory, self._turn_degC, self._branch = since_s, None, 0.0, "falling"
        up = np.linspace(low, high, CURVE_POINTS)
        rising, _ = film.simulate(up, film.initial_memory(low, "heated"))
        falling, _ = film.simulate(up[::-1], film.initial_memory(high, "cooled"))
        self.curves = {
            "temperature_degC": up.tolist(),
            "rising_ohm": (10.0 ** -self._mixed(rising)).tolist(),
            "falling_ohm": (10.0 ** -self._mixed(falling[::-1])).tolist(),
        }

    def _mixed(self, outputs: Any) -> Any:
        """Return the film's outputs from the sums of its operators."""
        return outputs if self._mixing is None else self._mixing.mixed(outputs)

    def memory(self, history: Path) -> dict[str, Any] | None:
        """Return the film's present state; None if it is not known."""
        import numpy as np

        from compensator.inverse.inverse import Inverse

        if self._at_s is None:
            return None
        rows = temperatures(history, self._at_s, MOST_ROWS)
        if rows:
            self._at_s = rows[-1][0]
            values = np.array([row[1] for row in rows])
            if self._memory is None:
                self._memory = self._model.initial_memory(float(values[0]), "cooled")
                self._turn_degC = float(values[0])
            self._memory = self._model.simulate(values, self._memory)[1]
            for value in values:
                self._follow_branch(float(value))
        if self._memory is None or len(rows) == MOST_ROWS:  # there are more: the memory is that of an earlier time
            return None
        interval = Inverse(self._model, *self._limits).solve(1e6, self._memory).interval
        reachable = None
        if interval is not None:
            reachable = sorted(output_to_ohm(output) for output in self._mixed(np.array(interval)).tolist())
        return {"temperature_degC": self._memory.input_degC, "branch": self._branch, "reachable_ohm": reachable}

    def _follow_branch(self, degC: float) -> None:
        """Follow the farthest temperature on the branch, and the reversals."""
        forward = degC - self._turn_degC if self._branch == "rising" else self._turn_degC - degC
        if forward > 0.0:
            self._turn_degC = degC
        elif forward < -TURN_K:
            self._turn_degC = degC
            self._branch = "falling" if self._branch == "rising" else "rising"

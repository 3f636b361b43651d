"""Read the history: rows of a span of time, thinned to the points that a figure needs."""

from __future__ import annotations

import json
import math
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

from rig.core.json_text import finite
from rig.core.reading import KEPT
from rig.history.store import BUCKETS_S, connect_to_read

MOST_POINTS = 5000  # of a curve: more than a screen has pixels side by side
SHOWN = tuple(name for name in KEPT if name != "meter_current_A")
MOST_RAW = 200_000  # rows that are averaged for one answer; for more the roll-ups are read
FEW_RAW = 20_000  # the same if the roll-ups are as fine as the figure
LONGEST_STEP_S = 5.0  # between rows that a line in the (T, R) plane may join
STEPS_BETWEEN_LOOKS = 20_000  # of SQLite's virtual machine, about a millisecond
ROUND_S = (1, 2, 5, 10, 15, 30, 60, 120, 300, 600, 900, 1800, 3600)


@contextmanager
def _reading(path: Path, ends_s: float = math.inf) -> Iterator[sqlite3.Connection]:
    """Open the history for reading; from ends_s (time.monotonic) on a query raises sqlite3.OperationalError."""
    connection = connect_to_read(path)
    connection.set_progress_handler(lambda: time.monotonic() >= ends_s, STEPS_BETWEEN_LOOKS)
    try:
        yield connection
    finally:
        connection.close()


def check_span(from_s: float, to_s: float) -> None:
    """Raise ValueError unless two times are finite and in order."""
    if not (math.isfinite(from_s) and math.isfinite(to_s) and from_s < to_s):
        raise ValueError("expected two finite times, from < to")


def span(path: Path, from_s: float, to_s: float, points: int, ends_s: float = math.inf) -> dict[str, Any]:
    """Return the columns from `from_s` to `to_s` (Unix seconds) in at most `points` buckets.

    They are raw rows (bucket_s 0) if these are few enough, else mean, low and high of buckets of `bucket_s` seconds,
    from raw rows or from the roll-ups. Raises sqlite3.Error, also if it is not done at `ends_s` (time.monotonic), and
    ValueError for an empty span.
    """
    check_span(from_s, to_s)
    points = max(2, min(points, MOST_POINTS))
    with _reading(path, ends_s) as connection:
        first = connection.execute(
            "SELECT min(s) FROM (SELECT min(time_s) AS s FROM raw UNION ALL SELECT min(start_s) FROM hour)"
        )
        from_s = max(from_s, min(first.fetchone()[0] or from_s, to_s - 1.0))  # no points for a time without rows
        rows = connection.execute(
            "SELECT count(*) FROM (SELECT 1 FROM raw WHERE time_s >= ? AND time_s <= ? LIMIT ?)",
            (from_s, to_s, MOST_RAW + 1),
        ).fetchone()[0]
        oldest = connection.execute("SELECT min(time_s) FROM raw").fetchone()[0]
        has_raw = oldest is not None and (oldest <= from_s or _rolled_before(connection, oldest) is None)
        if rows <= points and has_raw:
            return _raw(connection, from_s, to_s)
        width = (to_s - from_s) / points
        rolled = width >= BUCKETS_S["minute"] and _rolled_until(connection, to_s)
        if has_raw and rows <= (FEW_RAW if rolled else MOST_RAW):
            return _averaged(connection, from_s, to_s, _rounded(width))
        table = "minute" if width <= 1200.0 else "hour"
        return _rolled(connection, table, from_s, to_s, max(BUCKETS_S[table], _rounded(width)))


def _rounded(width_s: float) -> int:
    """Return a round width, at least as wide."""
    for width in ROUND_S:
        if width >= width_s:
            return width
    return math.ceil(width_s / 3600.0) * 3600


def _rolled_before(connection: sqlite3.Connection, time_s: float) -> int | None:
    row = connection.execute("SELECT 1 FROM minute WHERE start_s < ? LIMIT 1", (time_s - 60.0,)).fetchone()
    return row[0] if row else None


def _rolled_until(connection: sqlite3.Connection, to_s: float) -> bool:
    """Return True if the roll-ups contain all rows before a time, except for the last minutes."""
    last, newest = connection.execute(
        "SELECT (SELECT max(start_s) FROM minute), (SELECT max(time_s) FROM raw WHERE time_s <= ?)", (to_s,)
    ).fetchone()
    return last is not None and (newest is None or newest - last <= 3 * BUCKETS_S["minute"])


def _raw(connection: sqlite3.Connection, from_s: float, to_s: float) -> dict[str, Any]:
    found = connection.execute(
        f"SELECT time_s, {', '.join(SHOWN)} FROM raw WHERE time_s >= ? AND time_s <= ? ORDER BY time_s", (from_s, to_s)
    ).fetchall()
    columns: dict[str, Any] = {}
    for k, name in enumerate(SHOWN):
        values = [finite(row[k + 1]) for row in found]
        columns[name] = {"mean": values, "low": values, "high": values}
    return {"time_s": [row[0] for row in found], "columns": columns, "bucket_s": 0}


def _averaged(connection: sqlite3.Connection, from_s: float, to_s: float, width_s: int) -> dict[str, Any]:
    parts = ", ".join(f"avg({q}), min({q}), max({q})" for q in SHOWN)
    found = connection.execute(
        f"SELECT cast(time_s / {width_s} AS INTEGER) * {width_s} AS start, {parts} FROM raw "
        "WHERE time_s >= ? AND time_s <= ? GROUP BY start ORDER BY start",
        (from_s, to_s),
    ).fetchall()
    return _buckets(found, width_s)


def _rolled(connection: sqlite3.Connection, table: str, from_s: float, to_s: float, width_s: int) -> dict[str, Any]:
    parts = ", ".join(
        f"sum({q}_mean * count) / sum(CASE WHEN {q}_mean IS NULL THEN NULL ELSE count END), min({q}_low), max({q}_high)"
        for q in SHOWN
    )
    found = connection.execute(
        f"SELECT start_s / {width_s} * {width_s} AS start, {parts} FROM {table} "
        "WHERE start_s >= ? AND start_s <= ? GROUP BY start ORDER BY start",
        (from_s - BUCKETS_S[table], to_s),
    ).fetchall()
    return _buckets(found, width_s)


def _buckets(found: list[tuple[Any, ...]], width_s: int) -> dict[str, Any]:
    columns = {
        name: {of: [finite(row[3 * k + j + 1]) for row in found] for j, of in enumerate(("mean", "low", "high"))}
        for k, name in enumerate(SHOWN)
    }
    return {"time_s": [row[0] + width_s / 2.0 for row in found], "columns": columns, "bucket_s": width_s}


Point = tuple[float, float | None, float | None]  # time s, temperature degC, resistance ohm


def loop_points(path: Path, from_s: float, points: int) -> list[Point]:
    """Return about `points` points of the (T, R) plane since a time; a gap is a point (time, None, None)."""
    with _reading(path) as connection:
        found = connection.execute(
            "SELECT time_s, temperature_degC, resistance_ohm FROM raw WHERE time_s >= ? "
            "AND temperature_degC IS NOT NULL AND resistance_ohm > 0 AND resistance_ohm < 1e30 ORDER BY time_s",
            (from_s,),
        ).fetchall()
    step = max(1, math.ceil(len(found) / points))
    out: list[Point] = []
    for rows in _without_gaps(found):
        if out:
            out.append((rows[0][0], None, None))
        out += rows[:-1:step] + rows[-1:]
    return out


def _without_gaps(rows: list[tuple[float, float, float]]) -> Iterator[list[tuple[float, float, float]]]:
    """Yield the rows between gaps. A gap is longer than 5 s and than three of the steps on either side of it."""
    steps = [after[0] - before[0] for before, after in pairwise(rows)]
    first = 0
    for k, step_s in enumerate(steps):
        beside_s = max(steps[k - 1] if k > 0 else 0.0, steps[k + 1] if k + 1 < len(steps) else 0.0)
        if step_s > max(LONGEST_STEP_S, 3.0 * beside_s):
            yield rows[first : k + 1]
            first = k + 1
    if rows:
        yield rows[first:]


def trips(path: Path, count: int = 50) -> list[dict[str, Any]]:
    """Return the last trips with their rows and how they were cleared, the newest first."""
    with _reading(path) as connection:
        found = connection.execute("SELECT document FROM trip ORDER BY id DESC LIMIT ?", (count,)).fetchall()
    return [document for row in found if (document := _document(row[0])) is not None]


def _document(text: str) -> dict[str, Any] | None:
    """Return a JSON object; None if the file was damaged there since it was opened."""
    try:
        found = json.loads(text)
    except ValueError:
        return None
    return found if isinstance(found, dict) else None


def temperatures(path: Path, after_s: float, most: int) -> list[tuple[float, float]]:
    """Return (time s, temperature degC) after a time, in order."""
    with _reading(path) as connection:
        return connection.execute(
            "SELECT time_s, temperature_degC FROM raw WHERE time_s > ? AND temperature_degC IS NOT NULL "
            "ORDER BY time_s LIMIT ?",
            (after_s, most),
        ).fetchall()

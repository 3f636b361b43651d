"""A synthetic bench without instruments: months of history by formula, live rows, a film with a loop."""

from __future__ import annotations

import math
import time
from collections import deque

import numpy as np
from numpy.typing import NDArray

PERIOD_S = 0.1
DAYS = 120
COLUMNS = ("temperature_degC", "setpoint_degC", "current_A", "resistance_ohm", "target_ohm")
Array = NDArray[np.float64]


def branch_ohm(temperature_degC: Array, rising: Array) -> Array:
    """Resistance on a branch: three decades, 8 K between heating and cooling."""
    middle = np.where(rising, 60.0, 52.0)
    share = 1 / (1 + np.exp(-(temperature_degC - middle) / 2.2))
    return np.asarray(10 ** (5.0 - 0.012 * (temperature_degC - 25) - 2.2 * share), dtype=float)


def past(time_s: Array) -> dict[str, Array]:
    """What the bench did before it was started: sessions of loops on working days, else idle at 25 degC."""
    weekday = np.floor(time_s / 86400) % 7
    hour = (time_s / 3600) % 24
    active = (weekday < 5) & (hour > 7.5) & (hour < 17.0 + np.sin(np.floor(time_s / 86400) * 5.1) * 2)
    phase = 2 * math.pi * time_s / 1500
    swing = 24 + 5 * np.sin(2 * math.pi * time_s / 86400 / 3)
    noise = np.random.default_rng(1).normal(size=time_s.size)
    drift = 1.5 * np.sin(2 * math.pi * (hour - 9) / 24)
    temperature = np.where(active, 55 - swing * np.cos(phase), 23.5 + drift) + 0.02 * noise
    current = np.where(active, 0.045 * (temperature - 25) + 0.9 * np.sin(phase), 0.0)
    resistance = branch_ohm(temperature, np.sin(phase) > 0) * 10 ** (0.01 * noise)
    setpoint = np.where(active, 55 - swing * np.cos(phase + 0.02), np.nan)
    return dict(zip(COLUMNS, (temperature, setpoint, current, resistance, np.full_like(time_s, np.nan)), strict=True))


class FakeRig:
    """The plate and the film now; `step` makes a row."""

    def __init__(self, now_s: float | None = None) -> None:
        self.start_s = time.time() if now_s is None else now_s
        self.first_s = self.start_s - DAYS * 86400
        self.rows: deque[dict[str, float | None]] = deque(maxlen=40_000)
        self.frozen = False
        self.temperature_degC = 24.0
        self.rising = True
        self.run_since_s: float | None = None
        self._noise = np.random.default_rng(2)

    def step(self, now_s: float) -> dict[str, float | None]:
        """One committed row."""
        before = self.temperature_degC
        wanted: float | None = None
        target: float | None = None
        if self.run_since_s is not None:
            at = now_s - self.run_since_s
            wanted = 56 - 26 * math.cos(2 * math.pi * at / 90)
            target = float(branch_ohm(np.array([wanted]), np.array([self.rising]))[0])
        aim = 24.0 if wanted is None else wanted
        self.temperature_degC += (aim - self.temperature_degC) * 0.1 + 0.006 * float(self._noise.normal())
        speed = self.temperature_degC - before
        if abs(speed) > 0.02:
            self.rising = speed > 0
        ohm = float(branch_ohm(np.array([self.temperature_degC]), np.array([self.rising]))[0])
        ohm *= 10 ** (0.004 * float(self._noise.normal()))
        current = 0.0 if wanted is None else 0.045 * (self.temperature_degC - 25) + 4 * speed
        values = (self.temperature_degC, wanted, current, ohm, target)
        row: dict[str, float | None] = {"time_s": now_s, **dict(zip(COLUMNS, values, strict=True))}
        self.rows.append(row)
        return row

    def backfill(self, seconds: float) -> None:
        """Rows of a run that began some time ago, as if they had been live."""
        self.run_since_s = self.start_s - seconds
        for k in range(int(seconds / PERIOD_S)):
            self.step(self.run_since_s + k * PERIOD_S)
        self.start_s = self.run_since_s

    def history(self, from_s: float, to_s: float, points: int) -> dict[str, object]:
        """Raw rows where they are few, else mean, lowest and highest of buckets."""
        from_s = max(from_s, self.first_s)
        to_s = min(to_s, time.time())
        live = [row for row in self.rows if from_s <= float(row["time_s"] or 0) <= to_s]
        count_before = max(0, int((min(to_s, self.start_s) - from_s) / PERIOD_S))
        if count_before + len(live) <= points:
            times = from_s + PERIOD_S * np.arange(count_before)
            bucket_s = 0.0
        else:
            bucket_s = max(1.0, (to_s - from_s) / points)
            times = from_s + bucket_s / 6 * np.arange(max(0, int((min(to_s, self.start_s) - from_s) / bucket_s * 6)))
        columns = past(times) if times.size else {name: np.empty(0) for name in COLUMNS}
        all_times = np.concatenate([times, [float(row["time_s"] or 0) for row in live]])
        values = {
            name: np.concatenate([columns[name], [math.nan if row[name] is None else row[name] for row in live]])
            for name in COLUMNS
        }
        if bucket_s == 0:
            plain = {name: _listed(one) for name, one in values.items()}
            same = {name: {"mean": one, "low": one, "high": one} for name, one in plain.items()}
            return {"time_s": all_times.tolist(), "columns": same, "bucket_s": 0}
        slot = np.floor((all_times - from_s) / bucket_s)
        starts = np.flatnonzero(np.diff(slot, prepend=-1))
        out = {}
        for name, one in values.items():
            size = np.diff(np.append(starts, one.size))
            mean = np.add.reduceat(one, starts) / size if starts.size else one
            low = np.minimum.reduceat(one, starts) if starts.size else one
            high = np.maximum.reduceat(one, starts) if starts.size else one
            out[name] = {"mean": _listed(mean), "low": _listed(low), "high": _listed(high)}
        return {"time_s": (from_s + (slot[starts] + 0.5) * bucket_s).tolist(), "columns": out, "bucket_s": bucket_s}

    def loop(self, known: bool) -> dict[str, object]:
        """The last hour in the (T, R) plane, with the model and the memory where they are known."""
        rows = list(self.rows)[-36_000:][:: max(1, len(self.rows) // 1500)]
        answer: dict[str, object] = {
            "temperature_degC": [row["temperature_degC"] for row in rows],
            "resistance_ohm": [row["resistance_ohm"] for row in rows],
            "model": None,
            "memory": None,
        }
        if known:
            axis = np.linspace(28, 84, 120)
            answer["model"] = {
                "temperature_degC": axis.tolist(),
                "rising_ohm": (0.85 * branch_ohm(axis - 0.8, np.full(axis.size, True))).tolist(),
                "falling_ohm": (0.85 * branch_ohm(axis + 0.6, np.full(axis.size, False))).tolist(),
            }
            answer["memory"] = {
                "temperature_degC": self.temperature_degC,
                "branch": "rising" if self.rising else "falling",
                "reachable_ohm": [118.0, 88_000.0],
            }
        return answer


def _listed(values: Array) -> list[float | None]:
    return [None if math.isnan(one) else float(one) for one in values]

"""The wanted course of an experiment: a CSV file (time_s with target_ohm, setpoint_degC or current_A), or words.

    "start 80 kohm"                      where it begins; "start 40 degC", "start 0 A"
    "hold 20 s"                          stay
    "ramp to 5 kohm at 0.1 dec/s"        or "in 30 s"; degC with K/s, A with A/s
    "step to 1 A"                        at once
    "sine 0.4 dec period 40 s for 80 s"  about the value where it stands; amplitude in dec, K or A

A resistance is interpolated on the log scale.
"""

from __future__ import annotations

import math
import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compensator.functions import Array
from rig.faults import Faults
from rig.files.record_file import read_record
from rig.files.toml_text import shown

COLUMNS = {"resistance": "target_ohm", "temperature": "setpoint_degC", "current": "current_A"}
VALUE_UNITS = {
    "resistance": {"ohm": 1.0, "kohm": 1e3, "Mohm": 1e6},
    "temperature": {"degC": 1.0},
    "current": {"A": 1.0, "mA": 1e-3},
}
CHANGE_UNITS = {"resistance": {"dec": 1.0}, "temperature": {"K": 1.0}, "current": {"A": 1.0, "mA": 1e-3}}
TIME_UNITS = {"s": 1.0, "min": 60.0, "h": 3600.0}
SINE_STEPS = 64
LONGEST_S = 366 * 86400.0  # nobody waits for longer, and a slip of the pen can say 1e300 s
MOST_POINTS = 1_000_000
NUMBER = r"([-+]?[0-9.]+(?:[eE][-+]?[0-9]+)?)"


@dataclass(frozen=True, eq=False)
class Target:
    """Times (s, from 0) and values: -log10(R / 1 ohm) for a resistance, else degC or A; linear in between."""

    quantity: str
    times_s: Array
    values: Array

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def at(self, time_s: float | Array) -> Array:
        """The value at a time; before the first and after the last it holds."""
        return np.asarray(np.interp(time_s, self.times_s, self.values), dtype=np.float64)


def read_target(path: Path, quantity: str) -> Target:
    """A target from a CSV file. Raises Faults."""
    column = COLUMNS[quantity]
    record = read_record(path, needs=(column,))
    values = record[column]
    faults = [
        f"{path}: row {k + 1}: {column}: expected a finite number" for k in np.flatnonzero(~np.isfinite(values))[:5]
    ]
    if quantity == "resistance":
        faults += [f"{path}: row {k + 1}: {column}: expected > 0" for k in np.flatnonzero(values <= 0.0)[:5]]
    if faults:
        raise Faults(faults)
    return Target(quantity, record["time_s"] - record["time_s"][0], _internal(values, quantity))


def _internal(values: Array, quantity: str) -> Array:
    return -np.log10(values) if quantity == "resistance" else values


def target_in_words(words: list[str], quantity: str, where: str) -> Target:
    """A target from sentences. Raises Faults, a line for each sentence that is not understood."""
    times, values, faults = [0.0], [math.nan], []
    for k, sentence in enumerate(words):
        try:
            _append(sentence.strip(), quantity, times, values)
        except ValueError as error:
            faults.append(f"{where}[{k}]: {shown(sentence)}: {error}")
    if not faults and (not words or math.isnan(values[0])):
        faults.append(f"{where}: expected a first sentence such as {_example(quantity)!r}")
    if not faults and times[-1] <= 0.0:
        faults.append(f"{where}: lasts 0 s: expected a hold, a ramp or a sine")
    if faults:
        raise Faults(faults)
    return Target(quantity, np.array(times), np.array(values))


def _example(quantity: str) -> str:
    return {"resistance": "start 80 kohm", "temperature": "start 40 degC", "current": "start 0 A"}[quantity]


def _value(number: str, unit: str, quantity: str) -> float:
    if unit not in VALUE_UNITS[quantity]:
        raise ValueError(f"unit {unit!r}: expected {', '.join(VALUE_UNITS[quantity])}")
    value = float(number) * VALUE_UNITS[quantity][unit]
    if not math.isfinite(value):
        raise ValueError("expected a finite number")
    if quantity == "resistance":
        if value <= 0.0:
            raise ValueError("a resistance is > 0")
        return -math.log10(value)
    return value


def _change(number: str, unit: str, quantity: str) -> float:
    if unit not in CHANGE_UNITS[quantity]:
        raise ValueError(f"unit {unit!r}: expected {', '.join(CHANGE_UNITS[quantity])}")
    value = float(number) * CHANGE_UNITS[quantity][unit]
    if not 0.0 < value < math.inf:
        raise ValueError(f"{number}: expected a finite number > 0")
    return value


def _time(number: str, unit: str) -> float:
    if unit not in TIME_UNITS or float(number) <= 0.0:
        raise ValueError(f"{number} {unit}: expected a time > 0 in {', '.join(TIME_UNITS)}")
    return float(number) * TIME_UNITS[unit]


def _steps(length_s: float, period_s: float) -> int:
    """Of a sine."""
    if not SINE_STEPS * length_s <= MOST_POINTS * period_s:
        raise ValueError(f"expected at most {MOST_POINTS // SINE_STEPS} periods")
    return max(2, math.ceil(SINE_STEPS * length_s / period_s))


def _append(sentence: str, quantity: str, times: list[float], values: list[float]) -> None:
    unit = r"([A-Za-z]+)"
    now, value = times[-1], values[-1]
    if match := re.fullmatch(rf"start {NUMBER} *{unit}", sentence):
        if not math.isnan(value):
            raise ValueError("'start' comes once, first")
        values[0] = _value(match[1], match[2], quantity)
        return
    if math.isnan(value):
        raise ValueError(f"comes before a first sentence such as {_example(quantity)!r}")
    if match := re.fullmatch(rf"hold {NUMBER} *{unit}", sentence):
        times.append(now + _time(match[1], match[2]))
        values.append(value)
    elif match := re.fullmatch(rf"ramp to {NUMBER} *{unit} at {NUMBER} *{unit}/s", sentence):
        end = _value(match[1], match[2], quantity)
        times.append(now + abs(end - value) / _change(match[3], match[4], quantity))
        values.append(end)
    elif match := re.fullmatch(rf"ramp to {NUMBER} *{unit} in {NUMBER} *{unit}", sentence):
        times.append(now + _time(match[3], match[4]))
        values.append(_value(match[1], match[2], quantity))
    elif match := re.fullmatch(rf"step to {NUMBER} *{unit}", sentence):
        times.append(now + 1e-6)
        values.append(_value(match[1], match[2], quantity))
    elif match := re.fullmatch(rf"sine {NUMBER} *{unit} period {NUMBER} *{unit} for {NUMBER} *{unit}", sentence):
        amplitude = _change(match[1], match[2], quantity)
        period, length = _time(match[3], match[4]), _time(match[5], match[6])
        steps = _steps(length, period)
        for k in range(1, steps + 1):
            t = length * k / steps
            times.append(now + t)
            values.append(value + amplitude * math.sin(2.0 * math.pi * t / period))
    else:
        raise ValueError("expected start, hold, ramp to .. at/in .., step to .., or sine .. period .. for ..")
    if not times[-1] <= LONGEST_S:
        raise ValueError(f"ends after {times[-1]:g} s: expected a profile of a year at most")
    if times[-1] <= times[-2]:
        times[-1] = times[-2] + 1e-6

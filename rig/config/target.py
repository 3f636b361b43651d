"""The wanted course of an experiment: a CSV file (time_s with target_ohm, setpoint_degC or current_A), or words.

Of another quantity that a meter reads, such as curvature_per_m, the column is target_curvature_per_m, and the unit of
values and changes is that of its name: "ramp to 800 per_m at 5 per_m/s".

    "start 80 kohm"                      where it begins; "start 40 degC", "start 0 A"
    "hold 20 s"                          stay
    "ramp to 5 kohm at 0.1 dec/s"        or "in 30 s"; degC with K/s, A with A/s
    "step to 1 A"                        at once
    "sine 0.4 dec period 40 s for 80 s"  about the value where it stands; amplitude in dec, K or A

A resistance is interpolated on the log scale. Units are read as people write them (kOhm, kΩ, decades/s, K/min); a
value without a unit is in ohm, degC or A. Of a file too the units may be others, where its names say them: time_min,
target_kohm.
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.film_output import unit_of
from rig.records.record_file import read_record
from rig.records.units import UNITS, normalize_text, parse_unit

COLUMNS = {"resistance": "target_ohm", "temperature": "setpoint_degC", "current": "current_A"}
ENDINGS = {"resistance": "ohm", "temperature": "degC", "current": "A"}
EXPECTED_UNITS = {"resistance": "ohm, kohm, Mohm", "temperature": "degC, K", "current": "A, mA"}
EXAMPLES = {"resistance": "start 80 kohm", "temperature": "start 40 degC", "current": "start 0 A"}
NO_AMPERES = ("duty", "percent", "pwm255")
CHANGES = {  # what a value changes by, in the target's own unit
    "resistance": {"dec": 1.0, "decade": 1.0, "decades": 1.0, "decs": 1.0},
    "temperature": {"K": 1.0, "kelvin": 1.0, "degC": 1.0, "°C": 1.0, "mK": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
}
# seconds of each word for a unit of time
PER_S = {"s": 1.0, "sec": 1.0, "second": 1.0, "min": 60.0, "minute": 60.0, "h": 3600.0, "hr": 3600.0, "hour": 3600.0}
SINE_STEPS = 64  # a period: straight lines between them are within 0.12 % of the amplitude
MOST_SINE_STEPS = 1_000_000  # 16 MB of a target; a sine with more periods is a slip of the pen
LONGEST_S = 1e8  # three years: beyond it somebody mistyped
NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
UNIT = r"\s*([^\s\d.,+\-][^\s]*)?"
MEASURE = NUMBER + UNIT
LONGEST_SENTENCE = 500  # characters: a profile in words, not a text


@dataclass(frozen=True, eq=False)
class Target:
    """Times (s, from 0) and values, linear in between.

    quantity: "resistance" (values are -log10(R / 1 ohm)), "temperature" (degC), "current" (A), or the column of another
    quantity that a meter reads, in the unit of its name.
    """

    quantity: str
    times_s: Array
    values: Array
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def at(self, time_s: float | Array) -> Array:
        """The value at a time; before the first and after the last it holds."""
        return np.asarray(np.interp(time_s, self.times_s, self.values), dtype=np.float64)


def column_of_target(quantity: str) -> str:
    """The column of a wanted quantity."""
    return COLUMNS.get(quantity, f"target_{quantity}")


def example_of(quantity: str) -> str:
    """A first sentence."""
    return EXAMPLES.get(quantity, f"start 800 {unit_of(quantity)}")


def change_of(quantity: str) -> str:
    """The unit of a change."""
    return next(iter(CHANGES[quantity])) if quantity in CHANGES else unit_of(quantity)


def read_target(path: Path, quantity: str) -> Target:
    """A target from a CSV file. Raises Faults."""
    column = column_of_target(quantity)
    record = read_record(path, needs=(column,) if quantity in COLUMNS else (), options=False)
    if not record.has(column):
        raise fault(path, column, f"missing; there are {', '.join(record.columns)}")
    values = record[column]
    faults = [
        f"{path}: row {k + 1}: {column}: expected a finite number" for k in np.flatnonzero(~np.isfinite(values))[:5]
    ]
    if quantity == "resistance":
        faults += [f"{path}: row {k + 1}: {column}: expected > 0" for k in np.flatnonzero(values <= 0.0)[:5]]
    times = record["time_s"]
    if not float(times[-1]) - float(times[0]) <= LONGEST_S:
        faults.append(f"{path}: time_s: from {times[0]:g} to {times[-1]:g}: expected a profile of three years at most")
    if faults:
        raise Faults(faults)
    notes = tuple(f"{path}: {line}" for line in record.notes)
    return Target(quantity, times - times[0], _internal(values, quantity), notes)


def _internal(values: Array, quantity: str) -> Array:
    return -np.log10(values) if quantity == "resistance" else values


def target_in_words(words: list[str], quantity: str, where: str) -> Target:
    """A target from sentences. Raises Faults, a line for each sentence that is not understood."""
    times, values, faults = [0.0], [math.nan], []
    steps: list[tuple[int, str, Step]] = []
    for k, sentence in enumerate(words):
        try:
            steps.append((k, sentence, _read(sentence.strip(), quantity)))
        except ValueError as error:
            faults.append(f"{where}[{k}]: {sentence[:80]!r}: {error}")
    if faults:
        raise Faults(faults)
    for k, sentence, step in steps:
        try:
            step(times, values)
        except ValueError as error:
            raise Faults([f"{where}[{k}]: {sentence[:80]!r}: {error}"]) from None
    if not words or math.isnan(values[0]):
        faults.append(f"{where}: expected a first sentence such as {example_of(quantity)!r}")
    elif times[-1] <= 0.0:
        faults.append(f"{where}: lasts 0 s: expected a hold, a ramp or a sine")
    elif times[-1] > LONGEST_S:
        faults.append(f"{where}: lasts {times[-1]:.3g} s: expected at most {LONGEST_S:g} s")
    if faults:
        raise Faults(faults)
    return Target(quantity, np.array(times), np.array(values))


Step = Callable[[list[float], list[float]], None]  # what a sentence adds to the course: times and values


def _read(sentence: str, quantity: str) -> Step:
    """What a sentence says, without a look at the others. Raises ValueError, with what is expected."""
    if len(sentence) > LONGEST_SENTENCE:
        raise ValueError(f"{len(sentence)} characters: expected a sentence such as {example_of(quantity)!r}")
    if re.search(r"\d,\d", sentence):
        raise ValueError("expected numbers with a decimal point")
    sentence = " ".join(normalize_text(sentence).split())
    match = partial(_match, sentence)
    if found := match(rf"start(?: at)? {MEASURE}"):
        return partial(_start, quantity, _value(found[1], found[2], quantity))
    if found := match(rf"hold(?: for)? {MEASURE}"):
        return partial(_hold, quantity, _time(found[1], found[2]))
    if found := match(rf"ramp to {MEASURE} at {NUMBER}\s*([^\d\s].*)"):
        end, rate = _value(found[1], found[2], quantity), _rate(found[3], found[4], quantity)
        return partial(_ramp_at, quantity, end, rate)
    if found := match(rf"ramp to {MEASURE} in {MEASURE}"):
        return partial(_ramp_in, quantity, _value(found[1], found[2], quantity), _time(found[3], found[4]))
    if found := match(rf"step to {MEASURE}"):
        return partial(_ramp_in, quantity, _value(found[1], found[2], quantity), 1e-6)
    if found := match(rf"sine {MEASURE} period {MEASURE} for {MEASURE}"):
        amplitude = _change(found[1], found[2], quantity)
        period, length = _time(found[3], found[4]), _time(found[5], found[6])
        if SINE_STEPS * length / period > MOST_SINE_STEPS:
            raise ValueError(f"{length / period:.3g} periods: expected at most {MOST_SINE_STEPS // SINE_STEPS}")
        return partial(_sine, quantity, amplitude, period, length)
    raise ValueError(_what_would_be_read(sentence, quantity))


def _what_would_be_read(sentence: str, quantity: str) -> str:
    """For a sentence that is none: how one with its first word is written, or how all of them are."""
    value, change = example_of(quantity).removeprefix("start "), change_of(quantity)
    forms = {
        "start": [f"start {value}"],
        "hold": ["hold 20 s"],
        "ramp": [f"ramp to {value} at 0.1 {change}/s", f"ramp to {value} in 30 s"],
        "step": [f"step to {value}"],
        "sine": [f"sine 0.4 {change} period 40 s for 80 s"],
    }
    first = sentence.partition(" ")[0].lower()
    near = difflib.get_close_matches(first, forms, n=1)
    meant = forms[near[0]] if near else [text for texts in forms.values() for text in texts]
    return "expected " + " or ".join(repr(text) for text in meant)


def _match(sentence: str, pattern: str) -> re.Match[str] | None:
    return re.fullmatch(pattern, sentence, re.IGNORECASE)


def _start(quantity: str, value: float, times: list[float], values: list[float]) -> None:
    if not math.isnan(values[-1]):
        raise ValueError("'start' comes once, first")
    values[0] = value


def _begun(quantity: str, values: list[float]) -> float:
    """The value where the course stands."""
    if math.isnan(values[-1]):
        raise ValueError(f"comes before a first sentence such as {example_of(quantity)!r}")
    return values[-1]


def _to(time_s: float, value: float, times: list[float], values: list[float]) -> None:
    """A further point; two of them are never at one time."""
    times.append(max(time_s, times[-1] + 1e-6))
    values.append(value)


def _hold(quantity: str, length_s: float, times: list[float], values: list[float]) -> None:
    _to(times[-1] + length_s, _begun(quantity, values), times, values)


def _ramp_at(quantity: str, end: float, rate_per_s: float, times: list[float], values: list[float]) -> None:
    _to(times[-1] + abs(end - _begun(quantity, values)) / rate_per_s, end, times, values)


def _ramp_in(quantity: str, end: float, length_s: float, times: list[float], values: list[float]) -> None:
    _begun(quantity, values)
    _to(times[-1] + length_s, end, times, values)


def _sine(
    quantity: str, amplitude: float, period_s: float, length_s: float, times: list[float], values: list[float]
) -> None:
    now, value = times[-1], _begun(quantity, values)
    steps = max(2, math.ceil(SINE_STEPS * length_s / period_s))
    for k in range(1, steps + 1):
        t = length_s * k / steps
        _to(now + t, value + amplitude * math.sin(2.0 * math.pi * t / period_s), times, values)


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number[:20]}: expected a finite number")
    return value


def _value(number: str, unit: str | None, quantity: str) -> float:
    if quantity not in ENDINGS:
        if unit and unit != unit_of(quantity):
            raise ValueError(f"unit {unit!r}: expected {unit_of(quantity)}, as in {quantity}")
        return _finite(number)
    ending, name = ENDINGS[quantity], ENDINGS[quantity]
    if unit:
        found = parse_unit(unit)
        if found is not None and found[0] == ending and found[1] is None:
            raise ValueError(f"unit {unit!r} can be milliohms or megohms: expected mOhm or Mohm")
        if found is None or found[0] != ending or found[1] in NO_AMPERES:
            raise ValueError(f"unit {unit!r}: expected {EXPECTED_UNITS[quantity]}")
        name = str(found[1])
    value = float(UNITS[ending][name](np.array([_finite(number)]))[0])
    if quantity == "resistance":
        if not 0.0 < value < math.inf:
            raise ValueError("a resistance is > 0")
        return -math.log10(value)
    return value


def _change(number: str, unit: str | None, quantity: str) -> float:
    known = CHANGES.get(quantity, {unit_of(quantity): 1.0})
    factor = known.get(unit or "", known.get((unit or "").lower()))
    if factor is None:
        raise ValueError(f"unit {unit or 'missing'!r}: expected {', '.join(known)}")
    value = _finite(number) * factor
    if value <= 0.0:
        raise ValueError(f"{number}: expected > 0")
    return value


def _rate(number: str, text: str, quantity: str) -> float:
    """A change per time: 'dec/s', 'decades per second', 'K/min'."""
    match = re.fullmatch(r"(\S+?)(?:\s*/\s*|\s+per\s+)(\S+)", text.strip())
    per_s = PER_S.get(match[2].lower()) if match is not None else None
    if match is None or per_s is None:
        example = change_of(quantity)
        raise ValueError(f"rate {text[:40]!r}: expected {example}/s, {example}/min or {example}/h")
    return _change(number, match[1], quantity) / per_s


def _time(number: str, unit: str | None) -> float:
    found = parse_unit(unit) if unit else None
    if found is None or found[0] != "s":
        shown = f"unit {unit!r}" if unit else f"{number[:20]} without a unit"
        raise ValueError(f"{shown}: expected a time > 0 in s, min, h, as in '{number[:20]} s'")
    value = float(UNITS["s"][str(found[1])](np.array([_finite(number)]))[0])
    if not 0.0 < value <= LONGEST_S:
        raise ValueError(f"{number[:20]} {unit}: expected a time > 0, and at most {LONGEST_S:g} s")
    return value

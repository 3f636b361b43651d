"""The target of an experiment: a CSV file (time_s with target_ohm, setpoint_degC or current_A), or a profile in words.

    "start 80 kohm"                      the first value; "start 40 degC", "start 0 A"
    "hold 20 s"                          stay
    "ramp to 5 kohm at 0.1 dec/s"        or "in 30 s"; degC with K/s, A with A/s
    "step to 1 A"                        at once
    "sine 0.4 dec period 40 s for 80 s"  about the value before; amplitude in dec, K or A

A resistance is interpolated on the log scale. Units may be spelled in any usual way (kOhm, kΩ, decades/s, K/min); a
value without a unit is in ohm, degC or A. The column of another quantity that a meter reads, such as curvature_per_m,
is target_curvature_per_m, and its values and changes have the unit of its name: "ramp to 800 per_m at 5 per_m/s".
"""

from __future__ import annotations

import difflib
import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from compensator.hysteresis.functions import Array
from rig.core.faults import Faults, fault
from rig.records.film_output import unit_of
from rig.records.numbers import DRIVE_SHARES, UNITS, normalize_text, parse_unit
from rig.records.record_file import read_record

COLUMNS = {"resistance": "target_ohm", "temperature": "setpoint_degC", "current": "current_A"}
ENDINGS = {"resistance": "ohm", "temperature": "degC", "current": "A"}
EXPECTED_UNITS = {"resistance": "ohm, kohm, Mohm", "temperature": "degC, K", "current": "A, mA"}
EXAMPLES = {"resistance": "start 80 kohm", "temperature": "start 40 degC", "current": "start 0 A"}
CHANGE_UNITS = {  # of a change, in the target's own unit
    "resistance": {"dec": 1.0, "decade": 1.0, "decades": 1.0, "decs": 1.0},
    "temperature": {"K": 1.0, "kelvin": 1.0, "degC": 1.0, "°C": 1.0, "mK": 1e-3},
    "current": {"A": 1.0, "mA": 1e-3},
}
# seconds of each word for a unit of time in a rate
PER_S = {"s": 1.0, "sec": 1.0, "second": 1.0, "min": 60.0, "minute": 60.0, "h": 3600.0, "hr": 3600.0, "hour": 3600.0}
SINE_STEPS = 64  # a period: straight lines between them are within 0.12 % of the amplitude
MOST_SINE_STEPS = 1_000_000  # 16 MB of a target
LONGEST_S = 1e8  # three years
SHORTEST_S = 1e-6  # between two points
LONGEST_SENTENCE = 500  # characters
NUMBER = r"([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)"
MEASURE = NUMBER + r"\s*([^\s\d.,+\-][^\s]*)?"  # a number and a unit


@dataclass(frozen=True, eq=False)
class Target:
    """Times (s, from 0) and values, linear in between.

    quantity: "resistance" (values are -log10(R / 1 ohm)), "temperature" (degC), "current" (A), or the column of another
    quantity that a meter reads, in the unit of its name. notes: which columns of the file were taken.
    """

    quantity: str
    times_s: Array
    values: Array
    notes: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        return float(self.times_s[-1])

    def at(self, time_s: float | Array) -> Array:
        """Return the value at a time; before the first and after the last time it is constant."""
        return np.asarray(np.interp(time_s, self.times_s, self.values), dtype=np.float64)


def target_column(quantity: str) -> str:
    return COLUMNS.get(quantity, f"target_{quantity}")


def read_target(path: Path, quantity: str) -> Target:
    """Return the target in a CSV file. Raises Faults."""
    column = target_column(quantity)
    record = read_record(path, needs=(column,) if quantity in COLUMNS else (), options=False)
    if not record.has(column):
        raise fault(path, column, f"missing; there are {', '.join(record.columns)}")
    values, times = record[column], record["time_s"]
    wrong = [(k, "a finite number") for k in np.flatnonzero(~np.isfinite(values))[:5]]
    if quantity == "resistance":
        wrong += [(k, "> 0") for k in np.flatnonzero(values <= 0.0)[:5]]
    faults = [f"{path}: row {k + 1}: {column}: expected {expected}" for k, expected in wrong]
    if not float(times[-1]) - float(times[0]) <= LONGEST_S:
        faults.append(f"{path}: time_s: from {times[0]:g} to {times[-1]:g}: expected a profile of three years at most")
    if faults:
        raise Faults(faults)
    notes = tuple(f"{path}: {line}" for line in record.notes)
    return Target(quantity, times - times[0], -np.log10(values) if quantity == "resistance" else values, notes)


def parse_profile(sentences: list[str], quantity: str, where: str) -> Target:
    """Return the target that sentences describe; where: for messages. Raises Faults, a line for each sentence that is
    not understood."""
    language, course, faults = _Language(quantity), _Course(), []
    steps: list[tuple[str, Step]] = []
    for k, sentence in enumerate(sentences):
        place = f"{where}[{k}]: {sentence[:80]!r}"
        try:
            steps.append((place, language.parse(sentence.strip())))
        except ValueError as error:
            faults.append(f"{place}: {error}")
    if faults:
        raise Faults(faults)
    for place, step in steps:
        try:
            step(course)
        except ValueError as error:
            raise Faults([f"{place}: {error}"]) from None
    duration_s = course.times[-1] if course.times else math.nan
    if math.isnan(duration_s):
        raise Faults([f"{where}: expected a first sentence such as {language.example!r}"])
    if duration_s <= 0.0:
        raise Faults([f"{where}: lasts 0 s: expected a hold, a ramp or a sine"])
    if duration_s > LONGEST_S:
        raise Faults([f"{where}: lasts {duration_s:.3g} s: expected at most {LONGEST_S:g} s"])
    return Target(quantity, np.array(course.times), np.array(course.values))


class _Course:
    """The points of a profile so far."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.values: list[float] = []

    def add(self, after_s: float, value: float) -> None:
        self.times.append(max(self.times[-1] + after_s, self.times[-1] + SHORTEST_S))
        self.values.append(value)


Step = Callable[[_Course], None]  # adds a sentence's points to the course


class _Language:
    """The sentences about one quantity."""

    def __init__(self, quantity: str) -> None:
        self.quantity = quantity
        self.example = EXAMPLES.get(quantity, f"start 800 {unit_of(quantity)}")
        self.change_units = CHANGE_UNITS.get(quantity, {unit_of(quantity): 1.0})

    def parse(self, sentence: str) -> Step:
        """Return what a sentence adds. Raises ValueError with what is expected."""
        if len(sentence) > LONGEST_SENTENCE:
            raise ValueError(f"{len(sentence)} characters: expected a sentence such as {self.example!r}")
        if re.search(r"\d,\d", sentence):
            raise ValueError("expected numbers with a decimal point")
        sentence = " ".join(normalize_text(sentence).split())

        def match(pattern: str) -> re.Match[str] | None:
            return re.fullmatch(pattern, sentence, re.IGNORECASE)

        if found := match(rf"start(?: at)? {MEASURE}"):
            return self._start(self._value(found[1], found[2]))
        if found := match(rf"hold(?: for)? {MEASURE}"):
            length_s = _seconds(found[1], found[2])
            return self._continue(lambda course: course.add(length_s, course.values[-1]))
        if found := match(rf"ramp to {MEASURE} at {NUMBER}\s*([^\d\s].*)"):
            end, rate = self._value(found[1], found[2]), self._rate(found[3], found[4])
            return self._continue(lambda course: course.add(abs(end - course.values[-1]) / rate, end))
        if (found := match(rf"ramp to {MEASURE} in {MEASURE}")) or (found := match(rf"step to {MEASURE}")):
            end = self._value(found[1], found[2])
            ramp_s = _seconds(found[3], found[4]) if found.re.groups > 2 else SHORTEST_S
            return self._continue(lambda course: course.add(ramp_s, end))
        if found := match(rf"sine {MEASURE} period {MEASURE} for {MEASURE}"):
            amplitude = self._change(found[1], found[2])
            return self._sine(amplitude, _seconds(found[3], found[4]), _seconds(found[5], found[6]))
        raise ValueError(self._expected(sentence))

    def _start(self, value: float) -> Step:
        def step(course: _Course) -> None:
            if course.times:
                raise ValueError("'start' comes once, first")
            course.times, course.values = [0.0], [value]

        return step

    def _continue(self, add: Step) -> Step:
        def step(course: _Course) -> None:
            if not course.times:
                raise ValueError(f"comes before a first sentence such as {self.example!r}")
            add(course)

        return step

    def _sine(self, amplitude: float, period_s: float, length_s: float) -> Step:
        if SINE_STEPS * length_s / period_s > MOST_SINE_STEPS:
            raise ValueError(f"{length_s / period_s:.3g} periods: expected at most {MOST_SINE_STEPS // SINE_STEPS}")

        def add(course: _Course) -> None:
            begin_s, middle = course.times[-1], course.values[-1]
            steps = max(2, math.ceil(SINE_STEPS * length_s / period_s))
            for k in range(1, steps + 1):
                t = length_s * k / steps
                value = middle + amplitude * math.sin(2.0 * math.pi * t / period_s)
                course.add(begin_s + t - course.times[-1], value)

        return self._continue(add)

    def _expected(self, sentence: str) -> str:
        """Return how a sentence with this first word is written, or how all are."""
        value, change = self.example.removeprefix("start "), next(iter(self.change_units))
        forms = {
            "start": [f"start {value}"],
            "hold": ["hold 20 s"],
            "ramp": [f"ramp to {value} at 0.1 {change}/s", f"ramp to {value} in 30 s"],
            "step": [f"step to {value}"],
            "sine": [f"sine 0.4 {change} period 40 s for 80 s"],
        }
        near = difflib.get_close_matches(sentence.partition(" ")[0].lower(), forms, n=1)
        meant = forms[near[0]] if near else [text for texts in forms.values() for text in texts]
        return "expected " + " or ".join(map(repr, meant))

    def _value(self, number: str, unit: str | None) -> float:
        if self.quantity not in ENDINGS:
            if unit and unit != unit_of(self.quantity):
                raise ValueError(f"unit {unit!r}: expected {unit_of(self.quantity)}, as in {self.quantity}")
            return _finite(number)
        ending = ENDINGS[self.quantity]
        found = parse_unit(unit) if unit else (ending, ending)
        if found == (ending, None):
            raise ValueError(f"unit {unit!r} can be milliohms or megohms: expected mOhm or Mohm")
        if found is None or found[0] != ending or found[1] in DRIVE_SHARES:
            raise ValueError(f"unit {unit!r}: expected {EXPECTED_UNITS[self.quantity]}")
        value = float(UNITS[ending][str(found[1])](np.array([_finite(number)]))[0])
        if self.quantity != "resistance":
            return value
        if not 0.0 < value < math.inf:
            raise ValueError("a resistance is > 0")
        return -math.log10(value)

    def _change(self, number: str, unit: str | None) -> float:
        factor = self.change_units.get(unit or "", self.change_units.get((unit or "").lower()))
        if factor is None:
            raise ValueError(f"unit {unit or 'missing'!r}: expected {', '.join(self.change_units)}")
        value = _finite(number) * factor
        if value <= 0.0:
            raise ValueError(f"{number}: expected > 0")
        return value

    def _rate(self, number: str, text: str) -> float:
        """Return a change per second of 'dec/s', 'decades per second', 'K/min'."""
        match = re.fullmatch(r"(\S+?)(?:\s*/\s*|\s+per\s+)(\S+)", text.strip())
        per_s = PER_S.get(match[2].lower()) if match is not None else None
        if match is None or per_s is None:
            example = next(iter(self.change_units))
            raise ValueError(f"rate {text[:40]!r}: expected {example}/s, {example}/min or {example}/h")
        return self._change(number, match[1]) / per_s


def _finite(number: str) -> float:
    value = float(number)
    if not math.isfinite(value):
        raise ValueError(f"{number[:20]}: expected a finite number")
    return value


def _seconds(number: str, unit: str | None) -> float:
    found = parse_unit(unit) if unit else None
    if found is None or found[0] != "s":
        shown = f"unit {unit!r}" if unit else f"{number[:20]} without a unit"
        raise ValueError(f"{shown}: expected a time > 0 in s, min, h, as in '{number[:20]} s'")
    value = float(UNITS["s"][str(found[1])](np.array([_finite(number)]))[0])
    if not 0.0 < value <= LONGEST_S:
        raise ValueError(f"{number[:20]} {unit}: expected a time > 0, and at most {LONGEST_S:g} s")
    return value

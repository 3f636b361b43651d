"""The one record that `files` writes in forty ways, and how closely each way's digits hold it.

It knows nothing of the program's reader: units are converted here by factors of its own.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

Values = np.ndarray

# unit in the file -> (from ours to it, from it to ours)
UNITS: dict[str, tuple[Callable[[Values], Values], Callable[[Values], Values]]] = {
    "as ours": (lambda x: x, lambda x: x),
    "ms": (lambda x: x * 1e3, lambda x: x / 1e3),
    "min": (lambda x: x / 60.0, lambda x: x * 60.0),
    "K": (lambda x: x + 273.15, lambda x: x - 273.15),
    "degF": (lambda x: x * 1.8 + 32.0, lambda x: (x - 32.0) / 1.8),
    "kohm": (lambda x: x / 1e3, lambda x: x * 1e3),
    "Mohm": (lambda x: x / 1e6, lambda x: x * 1e6),
    "log10ohm": (np.log10, lambda x: 10.0**x),
    "uS": (lambda x: 1e6 / x, lambda x: 1e6 / x),
    "mA": (lambda x: x * 1e3, lambda x: x / 1e3),
    "percent": (lambda x: x * 100.0, lambda x: x / 100.0),
}


@dataclass(frozen=True)
class Truth:
    """What was measured: seconds from 0, degC, ohm, A, and the sink's degC."""

    time_s: Values
    temperature_degC: Values
    resistance_ohm: Values
    current_A: Values
    sink_degC: Values

    def of(self, ours: str) -> Values:
        values: Values = getattr(self, ours)
        return values


@dataclass
class Way:
    """A file as somebody writes it. expected: our column -> (values, what the digits leave open); drive: whether
    current_A is a share of full drive; units: what whoever wrote it knows of the units, for a reader who has to ask."""

    name: str
    file: str
    content: bytes
    expected: dict[str, tuple[Values, Values]]
    units: dict[str, str] = field(default_factory=dict)
    drive: bool = False


def truth_of(seed: int, rows: int = 240, step_s: float = 0.5) -> Truth:
    """A film taken once round its loop by a plate, with noise; another seed is another film, another evening."""
    random = np.random.default_rng(seed)
    time = np.arange(rows) * step_s
    phase = np.arange(rows) / (rows - 1)
    top, bottom = random.uniform(84.0, 94.0), random.uniform(22.0, 28.0)
    temperature = bottom + (top - bottom) * (1.0 - np.abs(2.0 * phase - 1.0)) + random.normal(0.0, 0.02, rows)
    middle = np.where(phase < 0.5, 66.0, 59.0) + random.normal(0.0, 1.0)
    decades = random.uniform(2.2, 3.0)
    log = 5.4 - decades * 0.5 * (1.0 + np.tanh((temperature - middle) / 4.0)) - 0.006 * (temperature - bottom)
    resistance = 10.0 ** (log + random.normal(0.0, 0.002, rows))
    current = np.where(phase < 0.5, 0.6 + 2.4 * phase, 0.4 - 2.6 * (phase - 0.5)) + random.normal(0.0, 0.03, rows)
    sink = 24.0 + 3.0 * phase + random.normal(0.0, 0.05, rows)
    return Truth(time, temperature, resistance, current, sink)


def written(truth: Truth, ours: str, unit: str, form: str) -> tuple[list[str], tuple[Values, Values]]:
    """A column's fields in a unit, by a format such as '.3f', and what a reader must find, with the digits' slack."""
    to_file, to_ours = UNITS[unit]
    values = truth.of(ours)
    texts = [format(float(v), form) for v in to_file(values)]
    low, high = [], []
    for text in texts:
        half = 0.5001 * last_place(text)
        low.append(float(text) - half)
        high.append(float(text) + half)
    ends = to_ours(np.array(low)), to_ours(np.array(high))
    slack = np.maximum(np.abs(ends[0] - values), np.abs(ends[1] - values)) + 1e-12 * np.abs(values)
    return texts, (values, slack)


def last_place(text: str) -> float:
    """The worth of a number's last written digit: 0.01 of '3.14', 1e2 of '3.1e3'."""
    match = re.fullmatch(r"[-+]?\d+(?:\.(\d*))?(?:[eE]([-+]?\d+))?", text)
    assert match is not None, text
    return math.pow(10.0, int(match[2] or 0) - len(match[1] or ""))

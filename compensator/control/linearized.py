"""The control law at an operating point as a linear system: `Law.step` differentiated numerically.

    x' = A x + B (dT, dy),   du = C x + D (dT, dy)

dT, dy: of the two readings (K, the film's output unit); u: the current (A), or the setpoint (degC) of a law that sends
one. x are the numbers of the law's state that a reading can reach, and that can reach the command, so that a clock or a
counter of the state is no mode of it. What the estimator has learned of noise and of the model's error is held: it
changes over hundreds of readings, and its gains are those of the operating point.

A step is smooth at a point where the film moves one way and the current is within its limits; `linearized` differs by
steps small beside a period's own move, both ways.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from compensator.control.estimate import Estimate
from compensator.control.law import Law
from compensator.control.law_step import INSTRUMENT_PID, Inputs, LawState
from compensator.hysteresis.functions import Array

SMALL: float = 1e-6  # K and decades: a period moves the film by a thousand times as much, its inverse errs by 1e-12


@dataclass(frozen=True, eq=False)
class LinearLaw:
    """x' = a x + b (dT, dy), du = c x + d (dT, dy): shapes (n, n), (n, 2), (1, n), (1, 2)."""

    a: Array
    b: Array
    c: Array
    d: Array

    def response(self, z: Array) -> Array:
        """du over (dT, dy) at points z of the plane, shape (points, 2)."""
        n = self.a.shape[0]
        inside = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a, np.broadcast_to(self.b, (z.size, n, 2)))
        return np.asarray((self.c @ inside + self.d)[:, 0, :])


def linearized(law: Law, state: LawState, inputs: Inputs) -> LinearLaw:
    """The law at this state and these inputs.

    Raises ValueError where a step changes what the state is made of, as when a command of a late driver comes due.
    """
    _, after = law.step(state, inputs)
    before, following = np.array(list(numbers(state))), np.array(list(numbers(after)))
    if before.size != following.size:
        raise ValueError("the law's state has other parts after a step than before it")
    count = before.size

    def at(values: Array, degC: float, output: float) -> Array:
        reading = inputs._replace(temperature_degC=inputs.temperature_degC + degC, output=inputs.output + output)
        command, end = law.step(with_numbers(state, values), reading)
        sent = command.setpoint_degC if law.rule.name == INSTRUMENT_PID else command.current_A
        return np.array([*numbers(end), sent])

    columns = []
    for k in range(count + 2):
        up, down = np.zeros(count + 2), np.zeros(count + 2)
        up[k], down[k] = SMALL, -SMALL
        ends = [at(before + off[:count], float(off[count]), float(off[count + 1])) for off in (up, down)]
        columns.append((ends[0] - ends[1]) / (2.0 * SMALL))
    whole = np.nan_to_num(np.array(columns).T)  # a number that is none yet (nan) carries nothing
    a, b, c, d = whole[:count, :count], whole[:count, count:], whole[count:, :count], whole[count:, count:]
    kept = reached(a, b) & reached(a.T, c.T)
    return LinearLaw(a[np.ix_(kept, kept)], b[kept], c[:, kept], d)


def reached(a: Array, b: Array) -> Any:
    """Which states an input can reach, shape (n,), by which elements are not 0."""
    found = np.any(b != 0.0, axis=1)
    while True:
        more = found | np.any(a[:, found] != 0.0, axis=1)
        if np.array_equal(more, found):
            return found
        found = more


def numbers(value: Any) -> Iterator[float]:
    """The numbers of a state, one after the other: of its named tuples, dataclasses, tuples and arrays."""
    if isinstance(value, Estimate):
        yield value.drift_K_per_s
    elif isinstance(value, np.ndarray):
        yield from (float(each) for each in value.ravel())
    elif isinstance(value, tuple):
        for part in value:
            yield from numbers(part)
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            yield from numbers(getattr(value, each.name))
    elif isinstance(value, float):
        yield value


def with_numbers(value: Any, values: Array) -> Any:
    """The same state with other numbers, in the order of `numbers`."""
    return _rebuilt(value, iter(values))


def _rebuilt(value: Any, values: Iterator[Any]) -> Any:
    if isinstance(value, Estimate):
        return value._replace(drift_K_per_s=float(next(values)))
    if isinstance(value, np.ndarray):
        made = np.array([next(values) for _ in range(value.size)], dtype=np.float64).reshape(value.shape)
        made.setflags(write=value.flags.writeable)
        return made
    if isinstance(value, tuple):
        parts = [_rebuilt(part, values) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if is_dataclass(value) and not isinstance(value, type):
        names = [each.name for each in fields(value)]
        return replace(value, **{name: _rebuilt(getattr(value, name), values) for name in names})
    return float(next(values)) if isinstance(value, float) else value

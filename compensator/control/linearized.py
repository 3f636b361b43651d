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

from collections.abc import Callable, Iterator
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
    """The law at this state and these inputs. Raises ValueError as `differentiated` does."""

    def step(values: Array, off: Array) -> Array:
        reading = inputs._replace(
            temperature_degC=inputs.temperature_degC + float(off[0]), output=inputs.output + float(off[1])
        )
        command, end = law.step(with_numbers(state, values), reading)
        sent = command.setpoint_degC if law.rule.name == INSTRUMENT_PID else command.current_A
        return np.array([*numbers(end), sent])

    return LinearLaw(*differentiated(step, np.array(list(numbers(state))), 2))


def differentiated(
    step: Callable[[Array, Array], Array], before: Array, inputs: int
) -> tuple[Array, Array, Array, Array]:
    """(a, b, c, d) of a step that takes a state's numbers and its inputs' changes, and gives the next ones and outputs.

    Only numbers that an input can reach are changed: to change a time would make a command come due. Raises ValueError
    where a step changes what the state is made of.
    """
    count, still = before.size, np.zeros(inputs)
    outputs = step(before, still).size - count
    if outputs < 1:
        raise ValueError("the law's state has other parts after a step than before it")
    a, b = np.zeros((count + outputs, count)), np.empty((count + outputs, inputs))
    for k in range(inputs):
        off = np.zeros(inputs)
        off[k] = SMALL
        b[:, k] = (step(before, off) - step(before, -off)) / (2.0 * SMALL)
    b = np.nan_to_num(b)  # a number that is none yet (nan) carries nothing
    known = np.zeros(count, dtype=bool)
    moved = np.any(b[:count] != 0.0, axis=1)
    while np.any(moved & ~known):
        for n in np.flatnonzero(moved & ~known):
            off = np.zeros(count)
            off[n] = SMALL
            a[:, n] = np.nan_to_num((step(before + off, still) - step(before - off, still)) / (2.0 * SMALL))
            known[n] = True
        moved = known | np.any(a[:count] != 0.0, axis=1)
    kept = known & reached(a[:count].T, a[count:].T)
    return a[:count][np.ix_(kept, kept)], b[:count][kept], a[count:][:, kept], b[count:]


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

"""What a law sees of the bench at an operating point: a linear system from one reading of the thermometer to the next.

    x' = A x + B u,   (dT, dy) = C x

u: current (A) or setpoint (degC); dT: thermometer (K); dy: the film's output, of a film as steep as the law's model. A
command acts some time after the thermometer's reading, the ohmmeter is read some time before it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compensator.control.linearized import differentiated, numbers, with_numbers
from compensator.control.observer import Observer
from compensator.control.own_pid import OwnPid
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel


@dataclass(frozen=True)
class Timing:
    """Of a period, s. output_age_s: the ohmmeter is read by so much before the thermometer; acts_after_s: a command
    acts by so much after it; the law is told both. late_s: by how much it acts later still, which nobody tells."""

    period_s: float
    output_age_s: float = 0.0
    acts_after_s: float = 0.0
    late_s: float = 0.0


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """x' = a x + b u, (dT, dy) = c x: shapes (n, n), (n, 1), (2, n)."""

    a: Array
    b: Array
    c: Array

    def response(self, z: Array) -> Array:
        """(dT, dy) over u at points z of the plane, shape (points, 2)."""
        n = self.a.shape[0]
        inside = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a, np.broadcast_to(self.b, (z.size, n, 1)))
        return np.asarray((self.c @ inside)[:, :, 0])

    def steeper(self, ratio: float) -> LinearPlant:
        """The same with a film whose slope is `ratio` times as large."""
        return replace(self, c=self.c * np.array([[1.0], [ratio]]))

    def stronger(self, gain: float) -> LinearPlant:
        """The same with all that a command does multiplied."""
        return replace(self, b=gain * self.b)

    def later(self, periods: int) -> LinearPlant:
        """The same with commands that act whole periods later."""
        plant = self
        for _ in range(periods):
            n = plant.a.shape[0]
            a = np.block([[plant.a, plant.b], [np.zeros((1, n + 1))]])
            b = np.vstack([np.zeros((n, 1)), [[1.0]]])
            plant = LinearPlant(a, b, np.hstack([plant.c, np.zeros((2, 1))]))
        return plant


def course(pole_per_s: float, gain: float, span_s: float) -> tuple[float, float]:
    """(what is left of a temperature, what a current makes of it) after a span with the current held."""
    if abs(pole_per_s * span_s) < 1e-9:
        return 1.0, gain * span_s
    left = math.exp(-pole_per_s * span_s)
    return left, gain * (1.0 - left) / pole_per_s


def plate_plant(plate: PlateModel, degC: float, current_A: float, slope: float, timing: Timing) -> LinearPlant:
    """A plate and a film without effects, told currents. slope: of the film's output, per K."""
    gain, pole = plate.linearized(degC, current_A)
    h = timing.period_s
    delay_s = timing.acts_after_s + timing.late_s
    whole, into_s = divmod(delay_s, h)

    def after(span_s: float) -> tuple[float, float, float]:
        """Temperature, and the currents before and after the one that begins to act within the period."""
        if span_s <= into_s:
            return (*course(pole, gain, span_s), 0.0)
        left, made = course(pole, gain, span_s - into_s)
        first_left, first_made = course(pole, gain, into_s)
        return left * first_left, left * first_made, made

    then, before = after(h), after(h - timing.output_age_s)
    a = np.array([[then[0], 0.0, then[1]], [before[0], 0.0, before[1]], [0.0, 0.0, 0.0]])
    b = np.array([[then[2]], [before[2]], [1.0]])
    c = np.array([[1.0, 0.0, 0.0], [0.0, slope, 0.0]])
    return LinearPlant(a, b, c).later(int(whole))


def observed_plant(observer: Observer, state: Any, timing: Timing) -> LinearPlant:
    """A chain with effects, as the law's observer knows it, from this state of it; all at the moment of the reading."""
    current_A = float(state.acting_A)

    def step(values: Array, off: Array) -> Array:
        now = observer.predicted(observer.sent(with_numbers(state, values), current_A + float(off[0])))
        end = observer.followed(now, now.plate_degC, now.thermometer_degC)
        return np.array([*numbers(end), end.thermometer_degC, end.shown_output])

    a, b, shown_a, shown_b = differentiated(step, np.array(list(numbers(state))), 1)
    n = a.shape[0]
    # the readings are of the period's end: they are states of their own
    a = np.block([[a, np.zeros((n, 2))], [shown_a, np.zeros((2, 2))]])
    plant = LinearPlant(a, np.vstack([b, shown_b]), np.hstack([np.zeros((2, n)), np.eye(2)]))
    return plant.later(round((timing.acts_after_s + timing.late_s) / timing.period_s))


def regulated_plant(
    plate: PlateModel, degC: float, current_A: float, slope: float, own: OwnPid, timing: Timing
) -> LinearPlant:
    """A plate under its controller's own PID, told setpoints.

    The controller looks at its thermometer every `own.tick_s`, in step with the readings.
    """
    gain, pole = plate.linearized(degC, current_A)
    ticks = max(1, round(timing.period_s / own.tick_s))
    span_s = timing.period_s / ticks
    left, made = course(pole, gain, span_s)
    acts = min(round((timing.acts_after_s + timing.late_s) / span_s), ticks)
    aged = min(max(round((timing.period_s - timing.output_age_s) / span_s), 0), ticks)
    degrees, integral, slower, last, sent, seen = range(6)

    def one(x: Array, u: float) -> Array:
        """A period, from the state and the setpoint that comes in it."""
        y = x.copy()
        for k in range(ticks):
            setpoint = u if k >= acts else x[sent]
            slope_K_per_s = (y[degrees] - y[last]) / span_s
            y[slower] += (1.0 - own.damping) * (slope_K_per_s - y[slower])
            y[last] = y[degrees]
            error = setpoint - y[degrees]
            if own.ti_s > 0.0:
                y[integral] += own.kp_A_per_K * error * span_s / own.ti_s
            amount = own.kp_A_per_K * (error - own.td_s * y[slower]) + y[integral]
            y[degrees] = left * y[degrees] + made * amount
            if k + 1 == aged:
                y[seen] = y[degrees]
        y[sent] = u
        return y

    a = np.array([one(each, 0.0) for each in np.eye(6)]).T
    b = one(np.zeros(6), 1.0)[:, None]
    c = np.zeros((2, 6))
    c[0, degrees], c[1, seen] = 1.0, slope
    return LinearPlant(a, b, c)

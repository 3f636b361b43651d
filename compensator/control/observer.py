"""The law on a chain with effects: the same parts as in `law_step`, with plate and film predicted by an observer.

    predicted   driver, plate and thermometer over a period, with the unknown heating that the law has learned
    corrected   by the law's own estimator: thermometer, plate and unknown heating, from the thermometer's reading
    followed    film and ohmmeter over the corrected course; the ohmmeter's reading corrects the disturbance
    ahead       plate and film when the command acts (after a driver's delay): the reference is planned from there
    warming     of the film at its next output, by test current and drift: the plate goes to where it, with this and
                through the film's lag, brings the film to its reference; the rate of warming is the difference of two

The target is what the ohmmeter shall show, so that its lag is made up for too.
"""

from __future__ import annotations

import math
from typing import Any, Protocol

import numpy as np

from compensator.control.estimator import Estimate, Predicted, disturbance_of
from compensator.control.law_step import (
    TEMPERATURE,
    Command,
    Inputs,
    LawState,
    Rule,
    driven,
    memories_after,
    passed_s,
    planned,
    read_output,
    read_temperature,
    reference_at,
)
from compensator.control.reference_shaping import FilmNow, Reference, direction_after
from compensator.control.unknown_memory import taken_along
from compensator.hysteresis.film import Memory, Packed
from compensator.hysteresis.functions import Array
from compensator.inverse.solve import Settings
from compensator.thermal.plate import PlateModel, with_drive


class Observer(Protocol):
    """Prediction of a chain with effects, a period at a time; each method is a function of its arguments alone.

    Times in s: thermometer_lag_s, film_lag_s: of first-order lags; lead_s: lag of the ohmmeter; delay_s: of the driver.
    A state is never changed; it has plate_degC, film_degC (without a film the same), thermometer_degC (without noise),
    output (of the film itself) and shown_output (at the ohmmeter; nan without a film), warming_K (of the film above
    what its lag makes of the plate), driven_K_per_s (heating by the model's drive over the last period) and film_memory
    (None without a film). `sim.model.observer.Observer` is one.
    """

    thermometer_lag_s: float
    film_lag_s: float
    lead_s: float
    delay_s: float

    def start(self, plate_degC: float, memory: Memory | None = None, test_current_A: float = 0.0) -> Any:
        """Return the state of a chain at rest."""
        ...

    def sent(self, state: Any, current_A: float) -> Any:
        """Return the state with a current commanded at its time."""
        ...

    def predicted(
        self, state: Any, unknown_K_per_s: float = 0.0, elapsed_s: float = math.nan, drive_error: float = 0.0
    ) -> Any:
        """Return the state a period (or elapsed_s) later in driver, plate and thermometer.

        unknown_K_per_s: heating that is not in the model. drive_error: share by which the drive exceeds the model's.
        """
        ...

    def followed(self, state: Any, plate_degC: float, thermometer_degC: float, test_current_A: float = 0.0) -> Any:
        """Return the state with plate and thermometer corrected, then film and ohmmeter over the same period."""
        ...

    def remembering(self, state: Any, memory: Memory) -> Any:
        """Return the state of a film with this memory, at its own temperature."""
        ...

    def ahead(
        self, state: Any, test_current_A: float = 0.0, unknown_K_per_s: float = 0.0, drive_error: float = 0.0
    ) -> Any:
        """Return the state at which a command of now acts."""
        ...

    def plate_now(self, state: Any) -> PlateModel:
        """Return a plate without effects that heats and cools as this one does now."""
        ...

    def own(self, output: Array | float) -> Array:
        """Return the film's own output for what the ohmmeter shows of it, lags left aside."""
        ...

    def warming_K(self, state: Any, output: float, test_current_A: float = 0.0, later_s: float = 0.0) -> float:
        """Return the warming of the film if its own output were this, later_s after the state's time."""
        ...


def observed_step(
    rule: Rule, film: Packed, inverse: Settings, observer: Observer, state: LawState, inputs: Inputs
) -> tuple[Command, LawState]:
    """Return the command and the state after one period of a law with an observer: see the module."""
    seen, estimate, errors, heats, possible = observed(rule, film, observer, state, inputs)
    test = inputs.test_current_A
    there = observer.ahead(seen, test, estimate.drift_K_per_s, estimate.drive_error)
    plate = with_drive(observer.plate_now(there).numbers, 1.0 + estimate.drive_error)
    memory = there.film_memory
    if memory is None:
        memory = Memory(there.film_degC, np.zeros(1))
    there_now = FilmNow(there.film_degC, memory.plays.copy(), film, inverse)
    wanted = inputs.targets if rule.name == TEMPERATURE else observer.own(inputs.targets)
    here = Reference(there.film_degC, there.plate_degC + there.warming_K)
    left, reference = Reference(*state.left), Reference(*state.reference)
    before = reference_at(rule.period_s, inputs.elapsed_s, left, reference, here)
    lag_s, (disturbance, doubt) = observer.film_lag_s, disturbance_of(errors)
    targets, noise = wanted - disturbance, estimate.output.variance
    plan = planned(rule, plate, there.plate_degC, lag_s, there_now, before, state.toward, doubt, noise, targets)
    next_output = there.output if math.isnan(plan.output) else plan.output + disturbance
    warming_K = observer.warming_K(there, next_output, test, rule.period_s) if math.isfinite(next_output) else 0.0
    now_K = warming_K if math.isnan(state.warming_K) else state.warming_K
    now_degC, next_degC = before.plate_degC - now_K, plan.reference.plate_degC - warming_K
    current, pid = driven(rule, plate, there.plate_degC, now_degC, next_degC, state.pid)
    command = Command(current, plan.reference.film_degC, before.film_degC, seen.output, plan.reached)
    return command, LawState(
        seen.plate_degC,
        seen.thermometer_degC,
        before,
        Reference(*plan.reference),
        memory.input_degC,
        memory.plays,
        pid,
        current,
        direction_after(state.toward, before, plan),
        plan.move,
        warming_K,
        estimate,
        possible,
        errors,
        heats,
        seen,
    )


def observed(
    rule: Rule, film: Packed, observer: Observer, state: LawState, inputs: Inputs
) -> tuple[Any, Estimate, Array, Array, Array]:
    """Return the observer's state after both readings, estimate, errors of the film model, unknown heats, memories."""
    before, possible, known = observer.sent(state.observer, state.current_A), state.possible, state.estimate
    now = observer.predicted(before, known.drift_K_per_s, inputs.elapsed_s, known.drive_error)
    predicted = Predicted(
        now.thermometer_degC, now.plate_degC, before.thermometer_degC, before.plate_degC, now.driven_K_per_s
    )
    lag_s = observer.thermometer_lag_s
    shown, plate, estimate, heats = read_temperature(rule, known, state.heats, predicted, lag_s, inputs)
    heats.setflags(write=False)
    now = observer.followed(now, plate, shown, inputs.test_current_A)
    if possible.size > 0:
        possible = possible.copy()
        taken_along(possible, now.film_degC, before.film_degC, film)
    if not rule.has_film:
        return now, estimate, state.errors, heats, possible
    expected, last = (float(observer.own(each.shown_output)) for each in (now, before))
    output = float(observer.own(inputs.output))
    passed = (expected - last) / passed_s(rule.period_s, inputs.elapsed_s) * (inputs.output_age_s + inputs.acts_after_s)
    off = output + (passed if math.isfinite(passed) else 0.0) - expected
    known, errors = read_output(rule, estimate, state.errors.copy(), off, state.moved, inputs)
    if possible.size > 0:
        plays = np.array(now.film_memory.plays)
        possible, plays, errors = memories_after(
            rule, state.errors.copy(), errors, known, possible, plays, off, state.moved, film, inputs
        )
        now = observer.remembering(now, Memory(now.film_degC, plays))
    possible.setflags(write=False)
    errors.setflags(write=False)
    return now, known, errors, heats, possible

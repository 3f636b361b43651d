"""Policies: what decides the current at each tick of the loop."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final

import numpy as np

from compensator.control.law import Law
from compensator.control.law_step import Inputs, LawState
from compensator.control.reference_shaping import Reference
from compensator.hysteresis.film import Memory
from rig.config.target import Target
from rig.control.decision import AT_THE_TICK, Decision, ReadAt
from rig.control.law_units import LawUnits, plain_units
from rig.control.loop import Loop
from rig.records.film_output import output_to_ohm

SAME_READING_S: Final = 1e-6  # between the stamps of one reading that is given twice: rounding
LATEST_S: Final = 10.0  # that a command acts after it was to: output and line are given up before, so no time is right
SOONEST: Final = 0.05  # of a period, from one command to the next: a late tick is followed by one in time
LEAST_WAY_K: Final = 0.2  # of a plan over the preview: less is a dwell, on which the nearest temperature is right


class CurrentProfile:
    """Policy of a current over time; it ends early if the temperature leaves a range."""

    def __init__(self, target: Target, low_degC: float = -math.inf, high_degC: float = math.inf) -> None:
        self._target = target
        self._low, self._high = low_degC, high_degC

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        if temperature_degC < self._low or temperature_degC > self._high:
            return Decision(0.0, done=True)
        return Decision(float(self._target.at(time_s)))


@dataclass(frozen=True, eq=False)
class Branches:
    """Laws that head up or down, for a target with several temperatures.

    planned: temperatures over the time of the target, degC.
    """

    planned: Target
    up: Law
    down: Law

    def law(self, nearest: Law, from_s: float, to_s: float) -> Law:
        """Return the law for the coming targets; `nearest` where the plan stands still."""
        ahead = float(self.planned.at(to_s)) - float(self.planned.at(from_s))
        if abs(ahead) < LEAST_WAY_K:
            return nearest
        return self.up if ahead > 0.0 else self.down


class Follow:
    """Policy that follows a target with a law; it holds the law's state between ticks and gives it to the next phase.

    The target's quantity is a temperature for the law "temperature", else the meter's. units: of the law's output, by
    default those of its film. setpoints: the reference goes to the controller's own PID instead of a current to its
    output. branches: for a target with several temperatures.

    To be set afterwards: model_lacks, the model's error that earlier runs have learned, on -log10 R
    (`rig.experiment.repetitions`); the recorded target stays as it is. estimates_memory: True if the film's memory is
    unknown at the start and estimated from the readings.
    """

    def __init__(
        self,
        law: Law,
        target: Target,
        memory: Memory | None = None,
        state: LawState | None = None,
        setpoints: bool = False,
        units: LawUnits | None = None,
        branches: Branches | None = None,
    ) -> None:
        self.law = law
        self.target = target
        self.state = state
        self.setpoints = setpoints
        self.units, self.branches = units or plain_units(law.film), branches
        self.model_lacks: Target | None = None
        self.estimates_memory = False
        self._memory = memory
        self._tick_s, self._acted_s = math.inf, math.nan  # the tick before, and when its command acted, in the phase
        self._before_A = 0.0  # in force until it acted
        self._read_s = math.nan  # the same of the output before
        self._ahead = law.preview_times_s()

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        law = self.law
        at_s = time_s + read.after_s
        if self.model_lacks is not None:  # the law goes by a film without it
            output -= float(self.model_lacks.at(at_s - read.output_age_s))
        if self._given_before(at_s - read.output_age_s):
            output = math.nan
        if self.state is None:
            if math.isnan(temperature_degC):
                return Decision(0.0, wait=True)  # nothing is known yet
            if self.estimates_memory and math.isnan(output):
                return Decision(0.0, wait=True)
            self.state = self._started(temperature_degC, self.units.law(output), read.test_current_A)
            self._tick_s, self._acted_s = -math.inf, at_s  # no period has passed since it was read
        metered, units = self.target.quantity != "temperature", self.units
        now = float(self.target.at(at_s))
        ahead_s = at_s + read.acts_after_s + self._ahead
        asked, coming = now, np.asarray(self.target.at(ahead_s), dtype=np.float64)
        if self.model_lacks is not None:
            asked, coming = now - float(self.model_lacks.at(at_s)), coming - self.model_lacks.at(ahead_s)
        since_s = self._since_s(time_s, at_s + read.acts_after_s)
        read_so = read.output_age_s, read.acts_after_s, read.test_current_A, since_s
        if metered:
            asked, coming = units.law(asked), units.law(coming)
        if self.branches is not None and metered:
            law = self.branches.law(law, at_s, float(ahead_s[-1]))
        self._before_A = self.state.current_A
        command, self.state = law.step(self.state, Inputs(temperature_degC, units.law(output), asked, coming, *read_so))
        ohms = units.quantity == "resistance"
        wanted = math.nan if not metered else output_to_ohm(now) if ohms else now
        predicted = units.shown(command.output_model) if math.isfinite(command.output_model) else math.nan
        return Decision(
            current_A=command.current_A,
            setpoint_degC=command.setpoint_degC if self.setpoints else math.nan if metered else now,
            use_setpoint=self.setpoints,
            reference_degC=command.reference_degC,
            target_ohm=wanted if ohms else math.nan,
            predicted_ohm=predicted if ohms else math.nan,
            target_output=math.nan if ohms else wanted,
            predicted_output=math.nan if ohms else predicted,
        )

    def acted(self, acts_s: float) -> None:
        """Take the time at which the last command acted: until then plate and film went on with the current before."""
        late_s = acts_s - self._acted_s
        if self.state is not None and not self.setpoints and abs(late_s) <= LATEST_S:
            self.state, moved_s = self.law.late(self.state, self._before_A, late_s)
            self._acted_s += moved_s

    def held(self, current_A: float) -> None:
        """Take the current (A; nan: unknown) with which plate and film go on after an unacknowledged command."""
        if self.state is not None and not math.isnan(current_A):
            self.state = self.state._replace(current_A=current_A)

    def _given_before(self, read_s: float) -> bool:
        """Return True if the output that was read then is the one of the tick before."""
        again = abs(read_s - self._read_s) < SAME_READING_S
        self._read_s = read_s
        return again

    def _since_s(self, tick_s: float, acts_s: float) -> float:
        """Return the time from when the command before acted until then; nan at the first tick of a phase."""
        since_s = acts_s - self._acted_s if tick_s > self._tick_s else math.nan
        if since_s < SOONEST * self.law.settings.period_s:
            since_s = SOONEST * self.law.settings.period_s
            acts_s = self._acted_s + since_s
        self._tick_s, self._acted_s = tick_s, acts_s
        return since_s

    def _started(self, temperature_degC: float, output: float, test_current_A: float) -> LawState:
        """Return the law's state at the first readings."""
        if self.estimates_memory:
            return self.law.start_anywhere(temperature_degC, output, test_current_A)
        return self.law.start(temperature_degC, self._memory, test_current_A=test_current_A)


class Setpoints:
    """Policy of a temperature over time as setpoints for the controller's own PID: it needs no model."""

    def __init__(self, target: Target) -> None:
        self._target = target

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        return Decision(setpoint_degC=float(self._target.at(time_s)), use_setpoint=True)


class Look:
    """Policy that sends nothing and reads the temperature."""

    def __init__(self) -> None:
        self.temperature_degC = math.nan

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        self.temperature_degC = temperature_degC
        return Decision(wait=True, done=not math.isnan(temperature_degC))


def temperature_now(loop: Loop, name: str, period_s: float) -> float:
    """Return the next credible temperature (degC), in a short phase. Raises Tripped if there is none for too long."""
    look = Look()
    loop.phase(name, look, 2.0 * loop.limits.stale_s + period_s, period_s)
    return look.temperature_degC


def handed_over(state: LawState, law: Law) -> LawState:
    """Return the state of one law as the start of another: the estimates stay, the correction begins anew."""
    fresh, known, seen = (
        law.start(state.temperature_degC, state.memory, state.current_A),
        state.estimate,
        state.observer,
    )
    if law.observer is not None and seen is not None:
        now = Reference(seen.film_degC, seen.plate_degC + seen.warming_K)
        fresh = fresh._replace(left=now, reference=now, warming_K=seen.warming_K, observer=seen)
    if law.settings.name == "feedforward":  # its own prediction is all that it goes by
        return fresh._replace(estimate=known._replace(drift_K_per_s=0.0, drive_error=0.0))
    errors = state.errors if state.errors.size > 0 else fresh.errors  # a law of temperatures has none
    return fresh._replace(estimate=known, possible=state.possible, errors=errors, heats=state.heats)


def warmed_up(law: Law) -> Law:
    """Return the law after some steps, so that all is compiled before a loop waits for it."""
    state, wanted = law.start(25.0, None), np.full(law.preview_times_s().size, 25.0)
    if law.film is not None:
        law.start_anywhere(25.0, law.film.output_at(law.film.initial_memory(25.0)))
    for output in (math.nan, 4.0, 4.0):
        _, state = law.step(state, Inputs(25.0, output, 25.0, wanted, test_current_A=1e-4))
    return law

"""The control law as one step: readings and coming targets in, a current out, state in and state out.

    target -> minus the estimated output disturbance -> inverse, from the present memory, with preview
           -> temperature reference, shaped to what the plate can do
           -> heating rate: the reference's own rate + PID on the temperature
           -> current, through the plate's inverse

The film's memory is driven by the temperature of a state observer (plate model corrected by the reading), never by
the noisy reading itself, which would ratchet the play operators. What the model gets wrong of the resistance is
estimated as a disturbance on the output and taken off the target: feedback of the resistance through the inverse.

    law                 film inverse   plate inverse   feedback of T   feedback of R
    "full"              yes            yes             PID             disturbance estimate
    "feedforward"       yes            yes             none            none
    "pid"               no             no              none            PID on the output, in A
    "instrument_pid"    yes            no              the controller  disturbance estimate
    "temperature"       no             yes             PID             none          (wanted temperature, not output)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from compensator.film import FilmModel, Memory
from compensator.functions import Array
from compensator.inverse import Inverse
from compensator.pid import PidGains, PidState, pid_integrate, pid_output
from compensator.plate import PlateModel
from compensator.reference import next_reference, next_temperature

LawName = Literal["full", "feedforward", "pid", "instrument_pid", "temperature"]


@dataclass(frozen=True)
class LawSettings:
    """What the law needs to know.

    period_s: of the loop. preview: number of coming targets that a step is given, preview_spacing_s apart, the first
    one period ahead. band: outputs this near to the target ask for no move (about twice the meter's noise).
    observer_gain: share of a reading's innovation taken into the temperature. disturbance_time_s: of the estimate
    of what the film model gets wrong. rate_share: share of the plate's fastest rates that the reference may use.
    """

    name: LawName
    period_s: float
    current_limit_A: float
    low_degC: float
    high_degC: float
    gains: PidGains
    preview: int = 8
    preview_spacing_s: float = 0.3
    band: float = 0.003
    observer_gain: float = 0.3
    disturbance_time_s: float = 1.0
    rate_share: float = 0.9


@dataclass(frozen=True, eq=False)
class LawState:
    """Temperature estimate and reference (degC), film memory, output disturbance, PID and the current in force."""

    temperature_degC: float
    reference_degC: float
    memory: Memory
    disturbance: float = 0.0
    pid: PidState = PidState()
    current_A: float = 0.0


@dataclass(frozen=True)
class Command:
    """What a step asks of the bench: the current (A), or for "instrument_pid" the setpoint (degC).

    reference_degC: where the plate should be now. output_model: the film model's output now. reachable: whether the
    target one period ahead can be reached from here.
    """

    current_A: float
    setpoint_degC: float
    reference_degC: float
    output_model: float
    reachable: bool


class Law:
    """Parameters of one law, bound to a film and a plate model. It remembers nothing: see `LawState`."""

    def __init__(self, settings: LawSettings, plate: PlateModel, film: FilmModel | None) -> None:
        if film is None and settings.name not in ("temperature",):
            raise ValueError(f"law {settings.name!r}: needs a film model")
        self.settings = settings
        self.plate = plate
        self.film = film
        self.inverse = Inverse(film, settings.low_degC, settings.high_degC) if film is not None else None

    def start(self, temperature_degC: float, memory: Memory | None, current_A: float = 0.0) -> LawState:
        """State at the first reading; memory None: as after cooling down from the hot end."""
        if memory is None:
            if self.film is None:
                memory = Memory(temperature_degC, np.zeros(1))
            else:
                memory = self.film.initial_memory(temperature_degC)
        integral = current_A if self.settings.name == "pid" else 0.0
        return LawState(temperature_degC, temperature_degC, memory, 0.0, PidState(integral=integral), current_A)

    def preview_times_s(self) -> Array:
        """How far ahead of a step each target lies that it is given."""
        s = self.settings
        return s.period_s + s.preview_spacing_s * np.arange(s.preview)

    def step(
        self, state: LawState, temperature_degC: float, output: float, target_now: float, targets: Array
    ) -> tuple[Command, LawState]:
        """One period. Readings are nan where there is none; targets: shape (preview,), see `preview_times_s`.

        For the law "temperature" targets are degC, else in the film's output unit.
        """
        s = self.settings
        state = self._observed(state, temperature_degC, output)
        if s.name == "pid":
            return self._output_pid(state, output, target_now)
        here = state.temperature_degC
        cooling, heating = self.plate.rate_range_K_per_s(here, s.current_limit_A)
        cooling, heating = min(s.rate_share * cooling, -1e-6), max(s.rate_share * heating, 1e-6)
        reachable = True
        if s.name == "temperature":
            following = next_temperature(
                targets, s.preview_spacing_s, s.period_s, state.reference_degC, cooling, heating
            )
        else:
            reachable, following = self._plan(state, targets - state.disturbance, cooling, heating)
        following = min(max(following, s.low_degC), s.high_degC)
        rate = (following - state.reference_degC) / s.period_s
        pid = state.pid
        if s.name in ("full", "temperature"):
            correction, pid = pid_output(s.gains, pid, state.reference_degC, here, s.period_s)
            rate += correction
        current = self.plate.current_for_rate_A(here, rate, s.current_limit_A)
        if s.name in ("full", "temperature"):
            shortfall = self.plate.rate_K_per_s(here, current) - rate
            if abs(shortfall) < 1e-12:
                shortfall = 0.0
            pid = pid_integrate(s.gains, pid, state.reference_degC, here, shortfall, s.period_s)
        model = self.film.output_at(state.memory) if self.film is not None else math.nan
        command = Command(current, following, state.reference_degC, model, reachable)
        return command, replace(state, reference_degC=following, pid=pid, current_A=current)

    def _observed(self, state: LawState, temperature_degC: float, output: float) -> LawState:
        """The state brought to this sample: temperature, memory, and what the film model gets wrong."""
        s = self.settings
        predicted = self.plate.step(state.temperature_degC, state.current_A, s.period_s)
        if s.name == "instrument_pid" and not math.isnan(temperature_degC):
            predicted = temperature_degC  # the current is the controller's own
        elif s.name != "feedforward" and not math.isnan(temperature_degC):
            predicted += s.observer_gain * (temperature_degC - predicted)
        if self.film is None:
            return replace(state, temperature_degC=predicted)
        expected, memory = self.film.step(predicted, state.memory)
        disturbance = state.disturbance
        if s.name in ("full", "instrument_pid") and math.isfinite(output):
            share = min(s.period_s / s.disturbance_time_s, 1.0)
            disturbance += share * (output - expected - disturbance)
        return replace(state, temperature_degC=predicted, memory=memory, disturbance=disturbance)

    def _plan(self, state: LawState, targets: Array, slowest: float, fastest: float) -> tuple[bool, float]:
        inverse, s = self.inverse, self.settings
        assert inverse is not None
        reached, following = next_reference(
            targets,
            s.band if s.name != "feedforward" else 0.0,
            state.memory.input_degC,
            state.memory.plays.copy(),
            inverse.model.packed,
            inverse.low_degC,
            inverse.high_degC,
            inverse.least_slope,
            inverse.tolerance,
            s.preview_spacing_s,
            s.period_s,
            state.reference_degC,
            slowest,
            fastest,
        )
        return bool(reached), float(following)

    def _output_pid(self, state: LawState, output: float, target: float) -> tuple[Command, LawState]:
        """PID on the film's output alone, in A; the last current holds while there is no reading."""
        s = self.settings
        measured = output if math.isfinite(output) else math.nan
        if math.isnan(measured):
            command = Command(state.current_A, math.nan, math.nan, math.nan, True)
            return command, state
        wanted, pid = pid_output(s.gains, state.pid, target, measured, s.period_s)
        low, high = self.plate.current_range_A(state.temperature_degC, s.current_limit_A)
        current = min(max(wanted, low), high)
        pid = pid_integrate(s.gains, pid, target, measured, current - wanted, s.period_s)
        command = Command(current, math.nan, math.nan, math.nan, True)
        return command, replace(state, pid=pid, current_A=current)

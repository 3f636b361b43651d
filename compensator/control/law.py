"""The control law as one step: readings and coming targets in, a current out, state in and state out.

    target -> minus the estimated output disturbance -> inverse, from the present memory, with preview
           -> temperature reference, shaped to what the plate can do
           -> heating rate: the reference's own rate + PID on the temperature
           -> current, through the plate's inverse

The film's memory is driven by the temperature of a state observer (plate model corrected by the reading), never by the
noisy reading itself, which would ratchet the play operators. What the model gets wrong of the resistance is estimated
as a disturbance on the output and taken off the target: feedback of the resistance through the inverse. Both estimates
weigh readings by their noise: `compensator.control.estimate`. A step stands for the moment at which its command acts;
the thermometer was read some time before, the ohmmeter before that.

    law                 film inverse   plate inverse   feedback of T   feedback of R
    "full"              yes            yes             PID             disturbance estimate
    "feedforward"       yes            yes             none            none
    "pid"               no             no              none            PID on the output, in A
    "instrument_pid"    yes            no              the controller  disturbance estimate
    "temperature"       no             yes             PID             none          (wanted temperature, not output)
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from math import nan
from typing import Final, Literal

import numpy as np
from numba import njit

from compensator.control.estimate import (
    DOUBT,
    DRIFT,
    MOVED,
    TOWARD,
    Estimate,
    corrected_disturbance,
    corrected_temperature,
)
from compensator.control.pid import PidGains, PidState, integral_of, output_of
from compensator.control.reference_shaping import next_reference, next_temperature
from compensator.hysteresis.film import IDENTITY, FilmModel, Memory, Packed, memory_owning
from compensator.hysteresis.functions import Array, memoryless_value
from compensator.hysteresis.play import advance, weighted_sum
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel, current_for_rate, current_range, rate
from compensator.thermal.plate import step as plate_step

LawName = Literal["full", "feedforward", "pid", "instrument_pid", "temperature"]


@dataclass(frozen=True)
class LawSettings:
    """What the law needs to know.

    period_s: of the loop. preview: number of coming targets that a step is given, preview_spacing_s apart, the first
    one period ahead. reversal: the output turns round for a difference of so many standard deviations of the estimate,
    and of band at the least; it goes on its way for any. trusts_model: whether the plate model predicts the temperature
    (otherwise the reading is all that is known). rate_share: share of the plate's fastest rates that the reference may
    use.
    """

    name: LawName
    period_s: float
    current_limit_A: float
    low_degC: float
    high_degC: float
    gains: PidGains
    preview: int = 8
    preview_spacing_s: float = 0.3
    band: float = 0.0
    reversal: float = 3.0
    trusts_model: bool = True
    rate_share: float = 0.9
    fastest_K_per_s: float = math.inf


@dataclass(frozen=True, eq=False)
class LawState:
    """Temperature estimate and reference (degC), film memory, output disturbance, PID, the current in force, and what
    the estimates know of noise and model."""

    temperature_degC: float
    reference_degC: float
    memory: Memory
    disturbance: float = 0.0
    pid: PidState = field(default_factory=PidState)
    current_A: float = 0.0
    estimate: Estimate = field(default_factory=Estimate)


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


NAMES: Final = ("full", "feedforward", "pid", "instrument_pid", "temperature")
FULL, FEEDFORWARD, PID, INSTRUMENT_PID, TEMPERATURE = range(5)
# places in a law's numbers
LAW, PERIOD, LIMIT, LOW, HIGH, SPACING, BAND, REVERSAL, TRUSTS, SHARE, HAS_FILM, FASTEST = range(12)
# places in a state's numbers, then in a command's; then those of the estimate
T, REF, DISTURBANCE, INTEGRAL, DERIVATIVE, ERROR, CURRENT, INPUT, SETPOINT, REF_NOW, MODEL, REACHED = range(12)


@njit(cache=True)
def law_step(
    law: Array,
    plate: Array,
    gains: Array,
    film: Packed,
    limits: Array,
    table: Array,
    state: Array,
    plays: Array,
    targets: Array,
    reading: float,
    output: float,
    target_now: float,
    output_age: float,
    acts_after: float,
) -> None:
    """One period of the law: `state` and `plays` are brought to this sample, the command stands behind the state."""
    name, period, limit = law[LAW], law[PERIOD], law[LIMIT]
    envelopes, radii, weights, code, par = film
    here = plate_step(plate, state[T], state[CURRENT], period) + state[DRIFT] * period
    if not math.isnan(reading) and (name == INSTRUMENT_PID or law[TRUSTS] == 0.0):
        here = reading  # the current is the controller's own
    elif not math.isnan(reading) and name != FEEDFORWARD:
        ahead = (rate(plate, here, state[CURRENT]) + state[DRIFT]) * acts_after
        here = corrected_temperature(state, here - ahead, reading, period) + ahead
    model = math.nan
    if law[HAS_FILM] > 0.0:
        advance(here, state[INPUT], envelopes, radii, plays)
        state[INPUT] = here
        model = memoryless_value(code, par, here) + weighted_sum(weights, plays)
        if name in (FULL, INSTRUMENT_PID) and math.isfinite(output):
            off = output + state[MOVED] / period * (output_age + acts_after) - model
            state[DISTURBANCE] = corrected_disturbance(state, state[DISTURBANCE], off, output, period)
    state[T] = here
    if name == PID:  # on the film's output alone, in A; the last current holds while there is no reading
        if math.isfinite(output):
            wanted, state[DERIVATIVE], state[ERROR] = output_of(
                gains, state[INTEGRAL], state[DERIVATIVE], state[ERROR], target_now, output, period
            )
            low, high = current_range(plate, here, limit)
            state[CURRENT] = min(max(wanted, low), high)
            shortfall = state[CURRENT] - wanted
            state[INTEGRAL] = integral_of(gains, state[INTEGRAL], target_now, output, shortfall, period)
        return
    low, high = current_range(plate, here, limit)
    cooling = min(max(law[SHARE] * rate(plate, here, low), -law[FASTEST]), -1e-6)
    heating = max(min(law[SHARE] * rate(plate, here, high), law[FASTEST]), 1e-6)
    reference, reached = state[REF], True
    if name == TEMPERATURE:
        following = next_temperature(targets, law[SPACING], period, reference, cooling, heating)
    else:
        band = max(law[BAND], law[REVERSAL] * math.sqrt(state[DOUBT])) if name != FEEDFORWARD else 0.0
        reached, following, state[MOVED] = next_reference(
            targets - state[DISTURBANCE],
            band,
            state[TOWARD],
            state[INPUT],
            plays,
            film,
            limits,
            table,
            law[SPACING],
            period,
            reference,
            cooling,
            heating,
        )
        if following != reference and state[MOVED] != 0.0:
            state[TOWARD] = math.copysign(1.0, state[MOVED])
    following = min(max(following, law[LOW]), law[HIGH])
    wanted_rate = (following - reference) / period
    feedback = name in (FULL, TEMPERATURE)
    if feedback:
        correction, state[DERIVATIVE], state[ERROR] = output_of(
            gains, state[INTEGRAL], state[DERIVATIVE], state[ERROR], reference, here, period
        )
        wanted_rate += correction
    state[CURRENT] = current_for_rate(plate, here, wanted_rate, limit)
    if feedback:
        shortfall = rate(plate, here, state[CURRENT]) - wanted_rate
        if abs(shortfall) < 1e-12:
            shortfall = 0.0
        state[INTEGRAL] = integral_of(gains, state[INTEGRAL], reference, here, shortfall, period)
    state[SETPOINT], state[REF_NOW], state[REF], state[MODEL] = following, reference, following, model
    state[REACHED] = 1.0 if reached else 0.0


class Law:
    """Parameters of one law, bound to a film and a plate model. It remembers nothing: see `LawState`."""

    def __init__(self, settings: LawSettings, plate: PlateModel, film: FilmModel | None) -> None:
        if film is None and settings.name not in ("temperature",):
            raise ValueError(f"law {settings.name!r}: needs a film model")
        self.settings = settings
        self.plate = plate
        self.film = film
        self.inverse = Inverse(film, settings.low_degC, settings.high_degC) if film is not None else None
        s = settings
        numbers = (s.period_s, s.current_limit_A, s.low_degC, s.high_degC, s.preview_spacing_s, s.band)
        shares = (s.reversal, float(s.trusts_model), s.rate_share, float(film is not None), s.fastest_K_per_s)
        self._numbers = np.array([float(NAMES.index(s.name)), *numbers, *shares])
        self._gains = s.gains.array()
        stand_in = FilmModel(np.zeros(1), np.zeros(1), IDENTITY, IDENTITY)  # the same types for every law
        inverse = self.inverse or Inverse(stand_in, s.low_degC, s.high_degC)
        self._film = inverse.model.packed
        self._limits, self._table = inverse.settings()

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
        return s.period_s + s.preview_spacing_s * np.arange(s.preview, dtype=np.float64)

    def step(
        self,
        state: LawState,
        temperature_degC: float,
        output: float,
        target_now: float,
        targets: Array,
        output_age_s: float = 0.0,
        acts_after_s: float = 0.0,
    ) -> tuple[Command, LawState]:
        """One period. Readings are nan where there is none; targets: shape (preview,), see `preview_times_s`.

        output_age_s: by how much the output was read before the temperature. acts_after_s: by how much the command acts
        after the temperature was read, at which moment the targets begin; target_now is of the reading. For the law
        "temperature" targets are degC, else in the film's output unit.
        """
        pid = state.pid
        plays = state.memory.plays.copy()
        numbers = np.array(
            (
                state.temperature_degC,
                state.reference_degC,
                state.disturbance,
                pid.integral,
                pid.derivative,
                pid.weighted_error,
                state.current_A,
                state.memory.input_degC,
                nan,
                nan,
                nan,
                1.0,
                *state.estimate,
            )
        )
        if not targets.flags.writeable:
            targets = targets.copy()
        law_step(
            self._numbers,
            self.plate.numbers,
            self._gains,
            self._film,
            self._limits,
            self._table,
            numbers,
            plays,
            targets,
            temperature_degC,
            output,
            target_now,
            output_age_s,
            acts_after_s,
        )
        t, r, d, i, derivative, error, current, v, setpoint, reference, model, reached, *known = numbers.tolist()
        pid = PidState(i, derivative, error)
        following = LawState(t, r, memory_owning(v, plays), d, pid, current, Estimate(*known))
        return Command(current, setpoint, reference, model, reached > 0.0), following

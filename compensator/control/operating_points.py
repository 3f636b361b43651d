"""Where a law is linearized: on its way through the film's range, both ways, and at rest.

The law is run there by its own model, without readings, until reference and current have settled; what the estimator
believes is set: a thermometer with a given noise, known for long, and an ohmmeter that counts for as much as the law
ever lets it (`LawSettings.most_share`), which is the largest gain of the resistance's feedback.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal

import numpy as np

from compensator.control.disturbance import one_error
from compensator.control.estimate import Noise
from compensator.control.law import Law
from compensator.control.law_step import Inputs, LawState
from compensator.control.linear_plant import LinearPlant, Timing, observed_plant, plate_plant, regulated_plant
from compensator.control.linearized import LinearLaw, linearized
from compensator.control.observer import Observer
from compensator.control.own_pid import OwnPid
from compensator.control.unknown_heat import UNSTEADY_K_PER_S2, Foretold, corrected_temperature, unknown_heats

Way = Literal["heating", "cooling", "at rest"]
DEC_PER_S = 0.01  # of a usual ramp; the margins hardly depend on it, as long as the plate can follow
LEVELS = (0.1, 0.5, 0.9)  # of the film's range of output
QUIET = 1e-16, 1e-8  # variance of an ohmmeter, and of the disturbance, by which a reading counts in full
REST = 1e-3  # of output, within which a film at rest need not turn round
SETTLED = 400  # readings after which the thermometer's estimator is


@dataclass(frozen=True, eq=False)
class Point:
    """A law and its plant, linear at one operating point; slope: of the model's film there, per K; noise_K: of the
    thermometer, as the law knows it; setpoints: the law sends them to a controller's own PID."""

    way: Way
    degC: float
    slope: float
    law: LinearLaw
    plant: LinearPlant
    period_s: float
    noise_K: float
    setpoints: bool = False


def operating_points(
    law: Law, timing: Timing, noise_K: float, own: OwnPid | None = None, levels: Sequence[float] = LEVELS
) -> list[Point]:
    """The law in the midst of both branches of the film's major loop, and at rest in its middle.

    noise_K: of the thermometer, one standard deviation. own: of a controller that the law sends setpoints to. Raises
    ValueError where the film does not move at all between the law's limits.
    """
    points = [
        _point(law, timing, noise_K, own, way, degC) for way in (1, -1) for degC in temperatures(law, way, levels)
    ]
    middle = temperatures(law, 1, (0.5,))[0]
    return [*points, _point(law, timing, noise_K, own, 0, middle)]


def temperatures(law: Law, way: int, levels: Sequence[float]) -> list[float]:
    """Where the film has gone through these shares of its range, on its way up or down (degC)."""
    film, s = law.film, law.settings
    assert film is not None
    grid = np.linspace(s.low_degC, s.high_degC, 801)[::way]
    outputs, _ = film.simulate(grid, film.initial_memory(float(grid[0]), "heated" if way > 0 else "cooled"))
    gone = np.abs(outputs - outputs[0])
    if not gone[-1] > 0.0:
        raise ValueError(f"the film's output is the same from {s.low_degC:g} to {s.high_degC:g} degC")
    return [float(grid[int(np.argmax(gone >= level * gone[-1]))]) for level in levels]


def believed(law: Law, noise_K: float, state: LawState) -> LawState:
    """The same, the noise of the thermometer known for long, and the ohmmeter taken at its word: of the sizes that the
    model's error may have one is left, the drive is known, and a reading counts in full."""
    lag_s = law.observer.thermometer_lag_s if law.observer is not None else 0.0
    known, heats = state.estimate._replace(degC=Noise(noise_K**2)), unknown_heats(UNSTEADY_K_PER_S2[-1:], (0.0,), 0.0)
    there = Foretold(0.0, 0.0, 0.0, 0.0)
    for _ in range(SETTLED):
        heats = corrected_temperature(known, heats, there, 0.0, law.settings.period_s, 0.0, lag_s)[-1]
        heats.setflags(write=False)  # as the law hands it over: compiled for one type
    output = state.estimate.output._replace(variance=QUIET[0])
    return state._replace(
        estimate=known._replace(output=output), errors=one_error(state.disturbance, QUIET[1]), heats=heats
    )


def _point(law: Law, timing: Timing, noise_K: float, own: OwnPid | None, way: int, degC: float) -> Point:
    if way == 0:
        law = Law(replace(law.settings, band=max(law.settings.band, REST)), law.plate, law.film, law.observer)
    film, h = law.film, timing.period_s
    assert film is not None
    low, high = law.settings.low_degC, law.settings.high_degC
    memory = film.initial_memory(low, "heated") if way >= 0 else film.initial_memory(high, "cooled")
    output, memory = film.step(degC, memory)
    rise = float(np.sign(film.step(degC + (1e-3 if way >= 0 else -1e-3), memory)[0] - output)) or 1.0
    speed = rise * DEC_PER_S * abs(way)
    held_A = law.plate.current_for_rate_A(degC, 0.0, law.settings.current_limit_A)
    state = law.start(degC, memory, held_A)
    if law.observer is not None:
        state = state._replace(observer=_held(law.observer, state.observer, degC, held_A, h))
    state = believed(law, noise_K, state)
    settled, heats = state.estimate, state.heats
    lag_s = law.observer.film_lag_s + law.observer.delay_s if law.observer is not None else 0.0
    steps, ahead = max(20, math.ceil(5.0 * lag_s / h)), law.preview_times_s()
    aged = timing.output_age_s, timing.acts_after_s
    for k in range(steps):
        wanted = output + speed * (k * h + aged[1] + ahead)
        degC_read = _unread(law, state)
        _, state = law.step(state, Inputs(degC_read, math.nan, output + speed * k * h, wanted, *aged))
        state = state._replace(estimate=settled, errors=one_error(state.disturbance, QUIET[1]), heats=heats)
    inputs = _read(law, state, steps * h, output, speed, aged)
    linear = linearized(law, state, inputs)
    slope = _slope(law, state, way)
    here, current_A = state.temperature_degC, state.current_A
    if own is not None:
        plant = regulated_plant(law.plate, here, current_A, slope, own, timing)
    elif law.observer is not None:
        plant = observed_plant(law.observer, state.observer, timing)
    else:
        plant = plate_plant(law.plate, here, current_A, slope, timing)
    name: Way = "heating" if way > 0 else "cooling" if way < 0 else "at rest"
    return Point(name, here, slope, linear, plant, h, noise_K, own is not None)


def _held(observer: Observer, state: Any, degC: float, current_A: float, period_s: float) -> Any:
    """The observer when the plate has been at a temperature for long, by this current."""
    for _ in range(1 + math.ceil(observer.delay_s / period_s + 5.0 * observer.thermometer_lag_s / period_s)):
        state = observer.followed(observer.predicted(observer.sent(state, current_A)), degC, degC)
    return state


def _unread(law: Law, state: LawState) -> float:
    """What a law goes by that reads nothing, degC: nan, its model; one that leaves the current to the controller, where
    the controller is to be by then."""
    own = law.settings.name == "instrument_pid" or not law.settings.trusts_model
    return state.reference_degC if own else math.nan


def _read(law: Law, state: LawState, now_s: float, output: float, speed: float, aged: tuple[float, float]) -> Inputs:
    """Readings that the law expects, and the targets of then; at rest the wanted output lies on the far side of the
    film's last move, where the law lets it stand."""
    ahead = law.preview_times_s()
    wanted = output + speed * (now_s + aged[1] + ahead)
    blind = Inputs(_unread(law, state), math.nan, output + speed * now_s, wanted, *aged)
    command, after = law.step(state, blind)
    moving = (after.temperature_degC - state.temperature_degC) / law.settings.period_s
    shown = after.observer.thermometer_degC if after.observer is not None else after.temperature_degC
    read = after.observer.shown_output if after.observer is not None else command.output_model
    if speed == 0.0:
        wanted = np.full(ahead.size, command.output_model - 0.5 * state.toward * REST)
    return blind._replace(
        temperature_degC=shown - moving * aged[1],
        output=read + state.disturbance - state.moved / law.settings.period_s * (aged[0] + aged[1]),
        targets=wanted,
    )


def _slope(law: Law, state: LawState, way: int) -> float:
    """Of the film's output (per K), on its way."""
    assert law.film is not None
    memory = state.memory
    small = 1e-4 if way >= 0 else -1e-4
    outputs = [law.film.step(memory.input_degC + small * k, memory)[0] for k in (0.0, 1.0)]
    return float((outputs[1] - outputs[0]) / small)

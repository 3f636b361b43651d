"""The control law: its state, what it cannot reach, how far it looks ahead, how it arrives at a target that stays."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.control.reference_shaping import (
    CAUTION,
    CLOSES_S,
    LONGEST_S,
    POINTS,
    FilmNow,
    crossing_s,
    held_temperature,
    preview,
    stop_short_by,
)
from compensator.hysteresis.film import IDENTITY, FilmModel
from compensator.hysteresis.play import output_of
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)


def full() -> Law:
    return Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0)), PLATE, FILM)


def test_the_state_is_a_value() -> None:
    law = full()
    state = law.start(50.0, None)
    targets = np.full(8, -2.9)
    targets.setflags(write=False)
    inputs = Inputs(50.1, -3.4, -2.9, targets)
    first, again = law.step(state, inputs), law.step(state, inputs)
    assert first[0] == again[0]
    for one, other in zip(first[1], again[1], strict=True):
        assert np.array_equal(np.ravel(flat(one)), np.ravel(flat(other)), equal_nan=True)
    for plays in (first[1].plays, first[1].memory.plays, state.plays):
        with pytest.raises(ValueError, match="read-only"):
            plays[0] = 0.0
    with pytest.raises(AttributeError):
        first[1].current_A = 1.0  # type: ignore[misc]


def flat(part: object) -> list[float]:
    """All numbers of a part of a state, in order."""
    if isinstance(part, tuple):
        return [number for each in part for number in flat(each)]
    return [] if part is None else list(np.ravel(np.asarray(part, dtype=np.float64)))


def test_an_output_that_cannot_be_reached_is_told() -> None:
    law = full()
    command, _ = law.step(law.start(50.0, None), Inputs(50.0, math.nan, -20.0, np.full(8, -20.0)))
    assert not command.reachable
    assert law.start(50.0, None).integral == 0.0


def test_a_law_of_the_resistance_needs_a_film() -> None:
    with pytest.raises(ValueError, match="film model"):
        Law(LawSettings("full", 0.1, 4.0, 10.0, 95.0, PidGains(1.0, 0.1)), PLATE, None)


PERIOD_S, NOISE = 0.1, 0.002
SETTINGS = LawSettings("full", PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0))


def film_at(degC: float) -> FilmNow:
    """After heating to it, and a kelvin back."""
    memory = FILM.step(degC, FILM.step(degC + 1.0, FILM.initial_memory(50.0))[1])[1]
    return FilmNow(degC, memory.plays.copy(), FILM.packed, Inverse(FILM, 10.0, 95.0).settings())


@pytest.mark.parametrize("drift_K", [0.02, -0.02])
@pytest.mark.parametrize("beyond", [0.001, -0.001])
def test_a_film_at_rest_goes_back_to_its_reference_not_away_from_its_target(drift_K: float, beyond: float) -> None:
    film = film_at(60.0)
    target = output_of(film.model, film.degC, film.plays) - beyond  # a warmer film has a larger output
    towards = drift_K * beyond > 0.0  # what the drift did is undone where that is towards the target
    held = held_temperature(target, film, 60.0 - drift_K)
    assert held == (60.0 - drift_K if towards else 60.0)


def test_a_target_that_goes_on_is_followed_as_it_is() -> None:
    assert stop_short_by(np.array([-3.0, -3.0, -2.99]), 1e-6, film_at(60.0), -1.0, PERIOD_S) == 0.0


def test_a_film_stops_short_of_a_target_that_stays_and_goes_on_slowly_but_turns_round_at_once() -> None:
    film, doubt = film_at(60.0), 1e-6
    here, rest = output_of(film.model, film.degC, film.plays), math.exp(-PERIOD_S / CLOSES_S)
    assert stop_short_by(np.full(3, here - 0.5), doubt, film, -1.0, PERIOD_S) == pytest.approx(-CAUTION * 1e-3)
    assert stop_short_by(np.full(3, here + 0.5), doubt, film, 1.0, PERIOD_S) == pytest.approx(CAUTION * 1e-3)
    assert stop_short_by(np.full(3, here - 1e-4), doubt, film, -1.0, PERIOD_S) == pytest.approx(-rest * 1e-4)
    assert stop_short_by(np.full(3, here + 0.5), doubt, film, -1.0, PERIOD_S) == 0.0


def test_steps_with_noise_and_a_heat_that_nobody_told_hardly_overshoot() -> None:
    law, rng, plate_degC, current = Law(SETTINGS, PLATE, FILM), np.random.default_rng(3), 50.0, 0.0
    memory = FILM.initial_memory(50.0)
    state, beyond = law.start(50.0, memory), []
    ahead = law.preview_times_s().size
    for k in range(3000):
        target = -3.0 + 0.4 * (k // 300 % 2)
        heat = 0.0004 * math.sin(0.02 * k)  # K a period
        plate_degC = PLATE.step(plate_degC, current, PERIOD_S) + heat
        output, memory = FILM.step(plate_degC, memory)
        readings = plate_degC + 0.01 * rng.normal(), output + NOISE * rng.normal()
        command, state = law.step(state, Inputs(*readings, target, np.full(ahead, target)))
        current = command.current_A
        if k >= 300:
            before = -3.0 + 0.4 * ((k // 300 + 1) % 2)
            beyond.append(math.copysign(1.0, target - before) * (output - target))
    assert max(beyond) < 1.1 * NOISE
    assert abs(float(np.median(beyond[-100:]))) < 0.5 * NOISE


WIDE = FilmModel(np.array([2.0]), np.array([1.0]), IDENTITY, IDENTITY)  # one play operator: a loop 4 K wide
SYMMETRIC = PlateModel(1.0 / 300.0, 0.0, 0.0, 25.0)  # no heat of its own, no loss: rates by the Seebeck term alone


@pytest.mark.parametrize("limit_A", [1.0, 4.0])
def test_it_is_the_loop_s_width_over_the_plate_s_slowest_rate(limit_A: float) -> None:
    slowest = limit_A * (20.0 + 273.15) / 300.0
    assert crossing_s(WIDE, SYMMETRIC, limit_A, 10.0, 90.0) == pytest.approx(4.0 / slowest, rel=0.03)


def test_a_film_without_a_loop_needs_none_and_a_plate_that_does_not_cool_has_an_end() -> None:
    line = FilmModel(np.array([0.0]), np.array([1.0]), IDENTITY, IDENTITY)
    assert crossing_s(line, SYMMETRIC, 4.0, 10.0, 90.0) == 0.0
    heater = PlateModel(0.0, 0.0, 1e-9, 25.0, 1.0, "heater")
    assert crossing_s(WIDE, heater, 1.0, 30.0, 90.0) == LONGEST_S


def test_targets_are_no_closer_than_a_period() -> None:
    assert preview(12.0, 0.1) == (POINTS, 1.0)
    assert preview(0.5, 0.1) == (5, 0.1)
    assert preview(0.0, 0.1) == (2, 0.1)

"""A target that stays: the film arrives from the near side, and a drift of the plate does not take it along."""

from __future__ import annotations

import math

import numpy as np
import pytest

from compensator.control.law import Law, LawSettings
from compensator.control.law_step import Inputs
from compensator.control.pid import PidGains
from compensator.control.reference_shaping import CAUTION, CLOSES_S, FilmNow, held_temperature, stop_short_by
from compensator.hysteresis.play import output_of
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from tests.compensator.film_models import THIRTY_OPERATORS as FILM

PERIOD_S, NOISE = 0.1, 0.002
PLATE = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
SETTINGS = LawSettings("full", PERIOD_S, 4.0, 10.0, 95.0, PidGains(1.2, 0.3, 1.0))


def film_at(degC: float) -> FilmNow:
    """After heating to it, and a kelvin back."""
    memory = FILM.step(degC, FILM.step(degC + 1.0, FILM.initial_memory(50.0))[1])[1]
    return FilmNow(degC, memory.plays.copy(), FILM.packed, Inverse(FILM, 10.0, 95.0).settings())


@pytest.mark.parametrize("drift_K", [0.02, -0.02])
@pytest.mark.parametrize("beyond", [0.001, -0.001])
def test_a_film_that_asks_for_no_move_goes_back_to_its_reference_but_not_further_from_its_target(
    drift_K: float, beyond: float
) -> None:
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

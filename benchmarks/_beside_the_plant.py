"""A law beside a benchmark's plant, without bench and interlock, with the emulated instruments' moments.

Thermometer and command come 4 and 14 ms after each tick; the ohmmeter integrates twice before the next, and its reading
is the mean of both (`rig.control.meter_readings`). What a rig that is wrong by a fifth does to a law can only be seen
so: a run on it is ended, rightly, by the watch over the plate.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks._hidden_effects import EffectPlant
from benchmarks._tracked_plant import TrackedPlant
from compensator.control.law import Law
from compensator.control.law_step import Inputs, LawState
from compensator.hysteresis.film import FilmModel
from compensator.inverse.inverse import Inverse

PERIOD_S, THERMOMETER_S, COMMAND_S = 0.1, 0.0044, 0.0143
OHMMETER_S = 0.0485, 0.0725  # the middles of its integrations
AGES_S = PERIOD_S + THERMOMETER_S - sum(OHMMETER_S) / len(OHMMETER_S), COMMAND_S - THERMOMETER_S


def placed(plant: TrackedPlant, law: Law, film: FilmModel, log_ohm: float, hot_degC: float) -> LawState:
    """Film and plate where the model has that resistance on the way down from the hot end, and the law there."""
    hot = film.initial_memory(hot_degC, "heated")
    first_degC = Inverse(film, 10.0, 95.0).solve(-log_ohm, hot).temperature_degC
    for degC in (*np.arange(25.0, hot_degC, 0.1), *np.arange(hot_degC, first_degC, -0.02)):
        plant.log_ohm = plant.film.log_ohm(float(degC))
    plant.degC = first_degC
    if isinstance(plant, EffectPlant):
        plant.shown_degC = plant.lagged_degC = first_degC
    return law.start(first_degC, film.step(first_degC, hot)[1])


def driven(
    plant: TrackedPlant,
    law: Law,
    state: LawState,
    wanted: Callable[[Any], Any],
    duration_s: float,
    at_tick: Callable[[int], None] | None = None,
) -> None:
    """The law on the plant; wanted: log10 R at times (s); at_tick: called at each tick."""
    ahead_s, output = law.preview_times_s(), math.nan
    for k in range(round(duration_s / PERIOD_S)):
        tick_s = k * PERIOD_S
        plant.advance_to(tick_s)
        if at_tick is not None:
            at_tick(k)
        plant.advance_to(tick_s + THERMOMETER_S)
        reading = plant.read_temperature_degC()
        now, coming = -float(wanted(tick_s + THERMOMETER_S)), -np.asarray(wanted(tick_s + COMMAND_S + ahead_s))
        command, state = law.step(state, Inputs(reading, output, now, coming, *AGES_S))
        plant.advance_to(tick_s + COMMAND_S)
        plant.set_current_A(command.current_A)
        ohms = []
        for ohmmeter_s in OHMMETER_S:
            plant.advance_to(tick_s + ohmmeter_s)
            ohms.append(plant.read_resistance_ohm(0.0))
        output = -math.log10(sum(ohms) / len(ohms))

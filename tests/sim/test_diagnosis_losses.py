"""A plate's losses: a descent finds its way back from a conductance of next to nothing and a room that none is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.data.noise_model import NoiseModel
from sim.diagnosis.data.record import read_columns
from sim.diagnosis.fit.temperature_channel import TemperatureChannel
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from tests.diagnosis.cases import case

STEPS = 20  # along log g and T_a it took 160 of these to come half of the way


def test_a_few_steps_lead_back_from_next_to_no_conductance() -> None:
    made = case("one", 3, effect="actuator_delay", rows=600)
    columns = {name: made.columns[name] for name in ("time_s", "temperature_degC", "current_A")}
    record = read_columns(columns, held_out=False)
    channel = TemperatureChannel(record, np.ones(600, np.bool_), NoiseModel.white(made.noise["temperature_K"]))
    effects = catalogue()
    true = made.hidden["actuator_delay"]["delay_s"]
    begin = channel.start(
        "peltier", np.array([1.6e-3, 0.06, 3e-4, -108.0]), [switched(effects["actuator_delay"], [0.3])]
    )
    fit = channel.descend(replace(begin, first_degC=record.temperature_degC[:1].copy()), STEPS)
    assert abs(float(fit.effects[0].par[0]) - true) < 0.1 * true
    assert 2.0 * fit.minus_log < 1.3 * record.rows

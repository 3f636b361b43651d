"""The film of a diagnosis told by further records, each taken back to what the film itself went through.

Film, drift, leads and heat are written here, apart from what they test.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from sim.diagnosis.data.record import Record, read_columns
from sim.diagnosis.diagnose import diagnose
from sim.diagnosis.extended_model import ExtendedModel, extended_model
from sim.diagnosis.fit.film_readings import film_went_through, readings_of_the_film
from sim.effects.catalogue import catalogue
from sim.effects.effect import switched
from sim.model.chain import NO_PLATE, ChainModel

RADII, WEIGHTS = (0.1, 0.35, 0.6), (0.5, 0.4, 0.3)
NOISE_DEC = 0.002


def film(degC: np.ndarray) -> np.ndarray:
    """-log10 R of three plays between two tanh, from the cold end."""
    up, down = np.tanh(0.16 * (degC - 64.0)), np.tanh(0.16 * (degC - 58.0))
    output = np.full(degC.size, -5.0)
    for radius, weight in zip(RADII, WEIGHTS, strict=True):
        play = -1.0 + radius
        for k in range(degC.size):
            play = max(up[k] - radius, min(down[k] + radius, play))
            output[k] += weight * play
    return output


def turned(turns_degC: list[float], rate_K_per_s: float, step_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Time and temperature from turn to turn."""
    at = np.cumsum([0.0, *(abs(b - a) / rate_K_per_s for a, b in pairwise(turns_degC))])
    time = np.arange(0.0, at[-1], step_s)
    return time, np.interp(time, at, turns_degC)


def test_readings_are_taken_back_to_the_film() -> None:
    time, degC = turned([40.0, 80.0, 50.0, 75.0, 45.0], 0.5, 0.5)
    theta, drift, leads, current = 100.0, 3.0, 40.0, 1e-4
    own, output = degC.copy(), film(degC)
    for _ in range(30):  # the film's own resistance heats it
        own = degC + drift * time / 3600.0 + theta * current**2 * 10.0**-output
        output = film(own)
    shown = 10.0**-output + leads
    shown[100:140] = np.nan  # rows without a reading, as of a block that is held out
    columns = {
        "time_s": time,
        "temperature_degC": degC,
        "resistance_ohm": shown,
        "meter_current_A": np.full(time.size, current),
    }
    known = catalogue()
    effects = (
        switched(known["self_heating"], {"theta_K_per_W": theta}),
        switched(known["film_drift"], {"drift_K_per_h": drift}),
        switched(known["series_resistance"], {"series_ohm": leads}),
    )
    model, record = ChainModel(NO_PLATE, None, effects), read_columns(columns, held_out=False)
    (found,) = readings_of_the_film(record, film_went_through(model, record), model.links, "record")
    read = np.isfinite(np.asarray(found.output))
    there = np.isfinite(shown)
    assert np.sum(read) == np.sum(there)
    assert np.max(np.diff(np.asarray(found.time_s))) < 0.6  # no gap: the temperature is known there
    assert np.asarray(found.output)[read] == pytest.approx(output[there], abs=1e-5)
    assert np.asarray(found.temperature_degC)[read] == pytest.approx(own[there], abs=2e-3)  # self-heating up to 1.6 K


def drifting(turns_degC: list[float], seed: int) -> dict[str, np.ndarray]:
    """Columns of a record in which the transition walks by 3 K an hour."""
    time, degC = turned(turns_degC, 0.1, 2.0)
    rng = np.random.default_rng(seed)
    output = film(degC + 3.0 * time / 3600.0) + NOISE_DEC * rng.standard_normal(time.size)
    shown = degC + 0.01 * rng.standard_normal(time.size)
    return {"time_s": time, "temperature_degC": shown, "resistance_ohm": 10.0**-output}


def test_what_a_run_did_not_show_of_its_film_is_told_by_the_record_before() -> None:
    run = drifting([56.0, 66.0, 58.0, 67.0, 57.0, 64.0, 56.0, 66.0, 58.0, 65.0, 57.0, 66.5], 1)
    before = read_columns(drifting([30.0, 85.0, 40.0, 64.0, 30.0], 2), held_out=False)
    diagnosis = diagnose(run)
    assert [found.name for found in diagnosis.findings] == ["film_drift"]
    both = extended_model(diagnosis, None, [before])
    assert both.others == 1
    assert off(both, before) < 1.3 * NOISE_DEC  # told by the run alone: 0.01 to 0.05
    assert off(both, read_columns(run, held_out=False)) < 1.3 * NOISE_DEC


def off(extended: ExtendedModel, record: Record) -> float:
    """RMS error in decades over a record whose film began at the cold end, its temperature without noise."""
    assert extended.film is not None
    effects = tuple(
        switched(catalogue()[str(e["name"])], {k: float(v) for k, v in e.items() if k != "name"})
        for e in extended.effects
    )
    model = ChainModel(NO_PLATE, None, effects)
    (found,) = readings_of_the_film(record, film_went_through(model, record), model.links, "record")
    degC, output = np.asarray(found.temperature_degC), np.asarray(found.output)
    begin = extended.film.initial_memory(30.0, "heated")
    shown, _ = extended.film.simulate(np.insert(degC, 0, 30.0), begin)
    left = (output - shown[1:])[np.isfinite(output)]
    return float(np.sqrt(np.mean(left**2)))

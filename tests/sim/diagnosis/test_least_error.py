"""A model that lacks something is written with the numbers that predict best, not with the likeliest ones."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from rig.analysis.diagnosed import model_of
from rig.analysis.prediction import predicted
from rig.records.record import Record
from sim.diagnosis.extended_model import ExtendedModel, extended_model, plate_model
from sim.inference.joint.starts import base_fit
from sim.inference.record.record import read_columns

Columns = dict[str, NDArray[np.float64]]
STEP_S, SEEDS = 2.0, 3


def two_bodies(seed: int, room_degC: float, share: float = 1.0) -> Columns:
    """A heater in random steps of a minute, after 20 s of rest, whose plate loses a share of its heat to a body of four
    times its heat capacity."""
    rng, time_s = np.random.default_rng(seed), STEP_S * np.arange(600)
    drive = np.repeat(rng.uniform(0.1, 1.0, 20), 30)
    drive[:10] = 0.0
    plate, body = room_degC, room_degC
    shown = np.empty(time_s.size)
    for k, u in enumerate(drive):
        shown[k] = plate
        for _ in range(4):
            lost = 0.012 * (plate - share * body - (1.0 - share) * room_degC)
            plate += 0.25 * STEP_S * (0.8 * u - lost)
            body += 0.25 * STEP_S * (lost - 0.02 * (body - room_degC)) / 4.0
    noise_K = 0.05 * rng.standard_normal(time_s.size)
    return {"time_s": time_s, "temperature_degC": shown + noise_K, "current_A": drive}


def error_K(model: ExtendedModel, columns: Columns) -> float:
    """Return the error of a model on another record, run as `predict --initial fitted` runs it."""
    found = predicted(model_of(model), Record(columns, "other"), "model", initial="fitted")
    assert found.temperature_degC is not None
    left = found.temperature_degC - columns["temperature_degC"]
    return float(np.sqrt(np.mean(left[~found.fitted_rows] ** 2)))


def test_another_day_is_predicted_by_the_least_error_of_simulation() -> None:
    """Numbers of the largest likelihood leave to the discrepancy what is slow, and are 3 to 14 K off on another day."""
    before, after = [], []
    for seed in range(SEEDS):
        record = read_columns(two_bodies(seed, 22.0))
        fit = base_fit(record, ("heater",))
        other = two_bodies(100 + seed, 20.0)
        before.append(error_K(ExtendedModel(None, plate_model(fit), ()), other))
        after.append(error_K(extended_model(fit, record), other))
    assert np.median(after) < 0.5 * np.median(before)


def test_a_model_that_lacks_nothing_keeps_its_numbers() -> None:
    """Of the plate alone: its intervals are those of the likelihood, and its numbers have to be."""
    fit = base_fit(read_columns(two_bodies(1, 22.0, share=0.0)), ("heater",))
    assert fit.for_simulation is fit

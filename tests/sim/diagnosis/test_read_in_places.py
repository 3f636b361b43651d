"""A film that was read in no row that is held out: what its other rows show is told, and no gain of it."""

from __future__ import annotations

import numpy as np

from rig.notebook.analysis import diagnose
from sim.inference.record.record import held_out_rows
from tests.sim.diagnosis.test_noisy_path import FINE_S, NOISE_DEC, NOISE_K, course, film


def test_no_gain_is_told_of_what_was_read_in_no_held_out_row() -> None:
    rng, degC = np.random.default_rng(5), course(5)
    rows = np.arange(0, degC.size, round(10.0 / FINE_S))
    ohm = 10.0 ** (film(degC)[rows] + NOISE_DEC * rng.standard_normal(rows.size))
    ohm[held_out_rows(rows.size)] = np.nan
    read = degC[rows] + NOISE_K * rng.standard_normal(rows.size)
    found = diagnose({"time_s": rows * FINE_S, "temperature_degC": read, "resistance_ohm": ohm}, budget_s=60.0)
    assert found.document["channels"]["resistance_dec"] is None
    assert found.lines

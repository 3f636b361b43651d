"""Numbers that are none, or that the quantity cannot have, are refused in a line with what is expected."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

import rig
from compensator.thermal.plate import PlateModel
from rig.config import configuration, model_file
from rig.config import tables as configuration_tables
from rig.config.model_file import Model
from rig.config.schema import Table
from rig.core.faults import Faults
from rig.records.conversion import record_from_arrays
from sim.inference.film.fit import identify_film
from sim.inference.readings.temperature_path import temperature_path
from sim.world.plant import World
from tests.sim.inference.identification_films import decaying_profile, is_prandtl_ishlinskii

Peltier = Callable[..., tuple[int, str, str]]

NONE = (math.nan, -0.01, math.inf, -math.inf)


def film_record(rows: int = 400) -> tuple[np.ndarray, ...]:
    v = decaying_profile(rows)
    film = is_prandtl_ishlinskii(0)
    return np.arange(float(rows)), v, film.simulate(v, film.initial_memory(float(v[0]), "cooled"))[0]


@pytest.mark.parametrize("noise_K", NONE)
def test_a_thermometers_noise_is_a_number_of_kelvins(noise_K: float) -> None:
    time, v, y = film_record()
    with pytest.raises(ValueError, match=r"temperature_noise_K: .*: expected K, 0 .* or more, or None"):
        identify_film(time, v, y, temperature_noise_K=noise_K)
    with pytest.raises(ValueError, match="temperature_noise_K"):
        temperature_path(time, v, noise_K=noise_K)


def test_a_predictions_noise_too() -> None:
    time, v, y = film_record()
    fit = identify_film(time, v, y, kind="generalized_pi")
    for noise_K in NONE:
        with pytest.raises(ValueError, match="temperature_noise_K"):
            fit.predict(time, v, temperature_noise_K=noise_K)


@pytest.mark.parametrize("first_s", [*NONE, 0.0])
def test_seconds_of_first_rows(first_s: float) -> None:
    time, v, y = film_record()
    record = record_from_arrays({"time_s": time, "temperature_degC": v, "resistance_ohm": 10.0**-y})
    with pytest.raises(Faults, match=r"first_s=.*: expected a number of seconds > 0"):
        rig.predict(Model(is_prandtl_ishlinskii(0), None), record, initial="fitted", first_s=first_s)


@pytest.mark.parametrize("key", ["thermometer_noise_K", "ohmmeter_noise_dec"])
def test_a_simulated_reading_has_a_noise(key: str) -> None:
    for noise in NONE:
        with pytest.raises(ValueError, match=f"{key}: .*: expected a finite number >= 0"):
            World(PlateModel(1.6e-3, 0.06, 0.018, 25.0), is_prandtl_ishlinskii(0), **{key: noise})


@pytest.mark.parametrize("seconds", ["nan", "-1", "0"])
def test_seconds_to_watch_for(peltier: Peltier, seconds: str) -> None:
    status, _, stderr = peltier("watch", f"--seconds={seconds}")
    assert status == 2
    assert f"--seconds: {seconds}: expected a number of seconds > 0" in stderr


def test_no_key_of_any_file_takes_what_is_no_number() -> None:
    modules = (configuration, model_file, configuration_tables)
    tables = {t for m in modules for t in vars(m).values() if isinstance(t, type) and issubclass(t, Table)}
    looked_at = 0
    for table in tables - {Table}:
        for key, field in table.model_fields.items():
            if "float" not in str(field.annotation):
                continue
            for bad in (math.nan, math.inf, -math.inf):
                for value in (bad, [bad], [bad, 1.0], [1.0, bad], {"x": bad}, {"x": [bad, 1.0]}, {"x": [1.0, bad]}):
                    with pytest.raises(ValidationError) as found:
                        table.model_validate({key: value})
                    assert any(error["loc"][0] == key for error in found.value.errors()), (table, key, value)
            looked_at += 1
    assert looked_at > 50

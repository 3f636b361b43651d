"""What a model says of a record: temperatures from the current, and with effects the readings from either column."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np

from compensator.hysteresis.film import IDENTITY, FilmModel
from compensator.hysteresis.functions import Array
from compensator.identification.rows import gap_threshold
from compensator.thermal.plate import PlateModel
from rig.core.faults import fault
from rig.files.film_output import RISING_RESISTANCE, in_decades
from rig.files.model_file import Model
from rig.files.record_file import Record
from sim.chain import World
from sim.effects.effect import Switched, Warming, of_resistances
from sim.films.rising import film_of_world
from sim.open_loop import film_readings, simulate_record

NO_PLATE = PlateModel(1.0, 0.0, 0.0, 25.0)  # stands where the temperature is given


def plate_temperatures(model: Model, record: Record) -> Array:
    """The thermometer's temperature from the current, with the model's effects on driver, plate and thermometer.

    It begins with the first reading, and after a gap with the next one.
    """
    assert model.plate is not None
    effects = tuple(e for e in model.switched() if e.effect.link in ("driver", "plate", "thermometer"))
    if effects:
        film = FilmModel(np.zeros(1), np.zeros(1), IDENTITY, IDENTITY)  # stands where no film is asked for
        simulated = _from_current(replace(model, film=film), record, effects, None).temperature_degC
        return np.where(_covered(record), simulated, math.nan)
    time, current = record["time_s"], np.nan_to_num(record["current_A"])
    simulated = np.full(time.size, math.nan)
    for start, end in _stretches(record):
        first = float(record["temperature_degC"][start])
        simulated[start:end] = model.plate.simulate(first, time[start:end], current[start:end])
    return simulated


def with_effects(model: Model, record: Record, memory: Any, where: object) -> tuple[Array, Array | None, str]:
    """(the film's output, the thermometer's temperature, "current" or "temperature"): what drives the film.

    The temperature is None where it was given. Raises Faults for an effect that the film's output cannot have.
    """
    assert model.film is not None
    effects = model.switched()
    sense = -1.0 if model.film.output == RISING_RESISTANCE else 1.0  # a world's output is -log10 R
    if not in_decades(model.film.output):
        for e in effects:
            if of_resistances(e.effect):
                text = f"{e.name}: has no meaning for the film output {model.film.output!r}"
                raise fault(where, "effects", text)
    if model.plate is not None and record.has("current_A"):
        readings = _from_current(model, record, effects, memory)
        known = _covered(record)
        output = np.where(known, sense * readings.output, math.nan)
        return output, np.where(known, readings.temperature_degC, math.nan), "current"
    effects = tuple(e for e in effects if e.effect.link in ("film", "ohmmeter"))
    film = film_of_world(model.film)
    world = World(NO_PLATE, film, thermometer_noise_K=0.0, ohmmeter_noise_dec=0.0, effects=effects)
    temperature = record["temperature_degC"]
    readings = film_readings(world, record["time_s"], temperature, memory=memory, **_meter(record))
    return np.where(np.isfinite(temperature), sense * readings.output, math.nan), None, "temperature"


def needs_test_current(effects: tuple[Switched, ...]) -> bool:
    """Whether the ohmmeter's power in the film matters."""
    return any(isinstance(e.effect.form, Warming) and e.effect.form.heated for e in effects)


def _from_current(model: Model, record: Record, effects: Any, memory: Any) -> Any:
    assert model.plate is not None
    assert model.film is not None
    time, temperature = record["time_s"], record["temperature_degC"]
    restart = np.full(time.size, math.nan)
    for start, _ in _stretches(record):
        restart[start] = temperature[start]
    begin = int(np.flatnonzero(np.isfinite(restart))[0])
    world = World(
        model.plate,
        film_of_world(model.film),
        first_degC=float(temperature[begin]),
        thermometer_noise_K=0.0,
        ohmmeter_noise_dec=0.0,
        current_limit_A=math.inf,
        effects=effects,
    )
    current = np.nan_to_num(record["current_A"])
    return simulate_record(world, time, current, restart_degC=restart, memory=memory, **_meter(record))


def _meter(record: Record) -> dict[str, Any]:
    """Test current and times of the resistances, as far as the record has them."""
    given: dict[str, Any] = {}
    if record.has("meter_current_A"):
        given["meter_current_A"] = np.nan_to_num(record["meter_current_A"])
    if record.has("resistance_time_s"):
        given["resistance_time_s"] = record["resistance_time_s"]
    return given


def _stretches(record: Record) -> list[tuple[int, int]]:
    """Rows from the first temperature after each gap to the next gap."""
    time, temperature = record["time_s"], record["temperature_degC"]
    breaks = np.flatnonzero(np.diff(time) > gap_threshold(np.diff(time))) + 1
    found = []
    for begin, end in zip([0, *breaks], [*breaks, time.size], strict=True):
        known = np.flatnonzero(np.isfinite(temperature[begin:end]))
        if known.size:
            found.append((int(begin + known[0]), int(end)))
    return found


def _covered(record: Record) -> Any:
    """Rows that are inside a stretch."""
    inside = np.zeros(record["time_s"].size, dtype=bool)
    for start, end in _stretches(record):
        inside[start:end] = True
    return inside

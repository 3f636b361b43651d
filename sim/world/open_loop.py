"""A whole record from a current over time, or the film's side of it from a temperature over time: no instruments.

Rows come in with what was commanded, readings at these rows come out. The current of a row holds from its time to the
next row's; before the first it was 0. The ohmmeter's test current of a row flows since the row before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from sim.model.inputs import NOTHING, Inputs
from sim.model.meter_power import since_the_row_before
from sim.model.record_own import FilmStart, RecordOwn
from sim.model.record_run import RecordRun, straight_path
from sim.model.recorded import Rows
from sim.world.plant import World


@dataclass(frozen=True, eq=False)
class Readings:
    """What the instruments show, one of each a row: degC and ohm; and the memory of the film at the end.

    output: -log10 of the resistance, or whatever else the film's output is.
    """

    temperature_degC: Array
    resistance_ohm: Array
    output: Array
    film_memory: Any


@dataclass(frozen=True, eq=False)
class Commanded:
    """Rows without gaps, as `sim.model.recorded.Recorded`."""

    time_s: Array
    current_A: Array
    taken_s: Array
    test_current_A: Array
    inputs: Inputs = NOTHING

    @property
    def first_rows(self) -> Rows:
        """One stretch."""
        return np.zeros(1, dtype=np.int64)

    @property
    def test_on_s(self) -> Array:
        """Since the row before."""
        return since_the_row_before(self.time_s)

    @property
    def commands(self) -> tuple[Array, Array]:
        """A current a row."""
        return self.time_s, self.current_A


def simulate_record(
    world: World,
    time_s: Array,
    current_A: Array,
    *,
    meter_current_A: ArrayLike = 0.0,
    resistance_time_s: Array | None = None,
    memory: Any = None,
) -> Readings:
    """Return readings of the rows, with the world's noise.

    resistance_time_s: what the resistances are stamped with, by default the rows' times. memory: the film's at the
    first row, by default the world's. Raises ValueError for effects that clash.
    """
    rows = _rows(time_s, np.clip(current_A, -world.current_limit_A, world.current_limit_A), resistance_time_s)
    record = _with_test(rows, meter_current_A)
    chain, own = RecordRun(world.model), _beginning(world, world.first_degC)
    plate = chain.plate(record, own)
    return _read(world, chain, record, plate.path, plate.shown_degC, own, memory)


def film_readings(
    world: World,
    time_s: Array,
    temperature_degC: Array,
    *,
    meter_current_A: ArrayLike = 0.0,
    resistance_time_s: Array | None = None,
    memory: Any = None,
) -> Readings:
    """Return the same where the plate's course is what a thermometer read, straight between rows: film and ohmmeter
    alone."""
    record = _with_test(_rows(time_s, np.zeros(np.size(time_s)), resistance_time_s), meter_current_A)
    known = np.isfinite(temperature_degC)
    read = np.asarray(temperature_degC, dtype=np.float64)
    plate = np.interp(record.time_s, record.time_s[known], read[known])
    chain, own = RecordRun(world.model), _beginning(world, float(plate[0]))
    path = straight_path(record.time_s, plate, chain.spacing.longest_s)
    return _read(world, chain, record, path, plate, own, memory)


def _rows(time_s: Array, current_A: Array, stamps: Array | None) -> Commanded:
    rows = np.asarray(time_s, dtype=np.float64) - float(time_s[0])
    taken = rows if stamps is None else np.where(np.isfinite(stamps), stamps - float(time_s[0]), rows)
    return Commanded(rows, np.asarray(current_A, dtype=np.float64), taken, np.zeros(rows.size))


def _with_test(rows: Commanded, meter_current_A: ArrayLike) -> Commanded:
    test = np.broadcast_to(np.asarray(meter_current_A, dtype=np.float64), rows.time_s.shape)
    return Commanded(rows.time_s, rows.current_A, rows.taken_s, test)


def _beginning(world: World, first_degC: float) -> RecordOwn:
    """Return the beginning of a record with all at rest."""
    initial = "heated" if world.film_initial == "heated" else "cooled"
    film = FilmStart(initial, (first_degC,))  # type: ignore[arg-type]
    return RecordOwn(world.plate.ambient_degC, np.array([first_degC]), film=film)


def _read(
    world: World, chain: RecordRun, record: Commanded, path: Any, shown_degC: Array, own: RecordOwn, memory: Any
) -> Readings:
    """Return what the instruments make of the values, with the noise of `SimulatedPlant`'s seed."""
    film = chain.film(record, path, own, memory)
    thermometer, ohmmeter = np.random.default_rng(world.seed).spawn(2)
    rows = record.time_s.size
    degC = chain.links.shown_degC(shown_degC + world.thermometer_noise_K * thermometer.standard_normal(rows))
    output = film.output - world.ohmmeter_noise_dec * ohmmeter.standard_normal(rows)
    return Readings(degC, 10.0**-output, output, film.memory)

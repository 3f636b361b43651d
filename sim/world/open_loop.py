"""A whole record from a current over time, without instruments.

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
from sim.model.record_run import RecordRun
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
    sent_A = np.clip(current_A, -world.current_limit_A, world.current_limit_A)
    record = commanded(time_s, sent_A, meter_current_A, resistance_time_s)
    chain, own = RecordRun(world.model), at_rest(world, world.first_degC)
    plate = chain.plate(record, own)
    film = chain.film(record, plate.path, own, memory)
    thermometer, ohmmeter = np.random.default_rng(world.seed).spawn(2)  # with the noise of `SimulatedPlant`'s seed
    noise_K = world.thermometer_noise_K * thermometer.standard_normal(record.time_s.size)
    output = film.output - world.ohmmeter_noise_dec * ohmmeter.standard_normal(record.time_s.size)
    return Readings(chain.links.shown_degC(plate.shown_degC + noise_K), 10.0**-output, output, film.memory)


def commanded(
    time_s: Array, current_A: Array, meter_current_A: ArrayLike = 0.0, stamps_s: Array | None = None
) -> Commanded:
    """Return rows whose times count from the first. stamps_s: of the resistances, by default the rows' times."""
    rows = np.asarray(time_s, dtype=np.float64) - float(time_s[0])
    taken = rows if stamps_s is None else np.where(np.isfinite(stamps_s), stamps_s - float(time_s[0]), rows)
    test = np.broadcast_to(np.asarray(meter_current_A, dtype=np.float64), rows.shape)
    return Commanded(rows, np.asarray(current_A, dtype=np.float64), taken, test)


def at_rest(world: World, first_degC: float) -> RecordOwn:
    """Return the beginning of a record with all at rest."""
    initial = "heated" if world.film_initial == "heated" else "cooled"
    film = FilmStart(initial, (first_degC,))  # type: ignore[arg-type]
    return RecordOwn(world.plate.ambient_degC, np.array([first_degC]), film=film)

"""The chain over a record, for a model that is known: plate and thermometer from the current, film and ohmmeter from
the plate's course.

The plate's side is that of the fits (`plate_path`), the film's that of the simulator (`film_side`), on the same nodes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from compensator.hysteresis.functions import Array
from compensator.thermal.plate import AMBIENT
from sim.model.chain import ChainModel
from sim.model.film_nodes import plate_at_film_nodes
from sim.model.film_side import FilmSide
from sim.model.links import Links
from sim.model.meter_power import MeterCurrent, MeterPower
from sim.model.plate_path import PlatePath, PlateRun, plate_nodes, simulate_plate
from sim.model.record_own import RecordOwn, anew_rows
from sim.model.recorded import EVENTS, FINE, Recorded, Rows, Spacing

BLOCK = 4096  # nodes of a film that are solved together: a heated one needs passes over all of them


@dataclass(frozen=True, eq=False)
class FilmRun:
    """output: -log10 of the resistance shown in each row, without noise; own_output: of the film's own, both (rows,);
    memory: the film's after the last row. time_s, film_degC: the film's own course, (nodes,); taken: the node at which
    each row's resistance was read, (rows,)."""

    output: Array
    own_output: Array
    memory: Any
    time_s: Array
    film_degC: Array
    taken: Rows


class RecordRun:
    """A model to be run over records."""

    def __init__(self, model: ChainModel, spacing: Spacing | None = None) -> None:
        """spacing: of the nodes; None: fine where anything lags or the heat balance has effects. Raises ValueError for
        effects that clash."""
        self.model, self.links = model, model.links
        self.spacing = spacing if spacing is not None else FINE if self.links.fine else EVENTS

    @property
    def ambient_degC(self) -> float:
        """The room's temperature, as the model has it."""
        return self.model.plate.ambient_degC

    def plate(self, record: Recorded, own: RecordOwn) -> PlateRun:
        """Return the plate's path, and what an ideal thermometer shows in each row."""
        return run_plate(record, self.links, self.model.plate.numbers, own, self.spacing, dict(self.model.plate.inputs))

    def shown(self, record: Recorded, path: PlatePath, own: RecordOwn, read: Array | None = None) -> Array:
        """Return -log10 of the resistance shown in each row, without noise. read: as in `film`."""
        return self.film(record, path, own, read=read).output

    def film(
        self, record: Recorded, path: PlatePath, own: RecordOwn, memory: Any = None, read: Array | None = None
    ) -> FilmRun:
        """Return the run of film and ohmmeter on a course of the plate. memory: the film's, before its first
        temperature; None: that of `own`. read: -log10 of a resistance in each row by which an ohmmeter heats the film;
        None: of the film's own, which goes with that heat, and takes a hundred times as long."""
        film, links = self.model.film, self.links
        assert film is not None
        test = record.test_current_A if record.test_current_A is not None else np.zeros(record.time_s.size)
        meter = MeterCurrent(record.time_s, test, record.test_on_s)
        jumps = meter.jumps_s() if links.heated else np.empty(0)
        time, place, plate = plate_at_film_nodes(record, path, links, jumps, own.film, self.spacing)
        test = test[meter.row_at(time)]
        power_W = MeterPower(meter, read).at(time) if links.heated and read is not None else None
        side = FilmSide(film, links)
        state = side.start(own.film.memory(film) if memory is None else memory, own.late)
        film_degC, output, own_output = np.empty((3, time.size))
        for begin in range(0, max(time.size - 1, 1), BLOCK):  # a block begins with the last node of the one before
            part = slice(begin, min(begin + BLOCK + 1, time.size))
            film_degC[part], own_output[part], output[part], state = side.advance(
                state, time[part], plate[part], test[part], None if power_W is None else power_W[part]
            )
        shown = output[place]
        if links.readings:
            shown = -np.log10(links.shown_ohm(10.0**-shown))
        return FilmRun(shown, own_output[place], state.memory, time, film_degC, place)


def run_plate(
    record: Recorded, links: Links, par: Array, own: RecordOwn, spacing: Spacing, inputs: Mapping[str, float]
) -> PlateRun:
    """Return the run of driver, plate and thermometer over a record. par: as for `simulate_plate`; the room is that of
    `own`. inputs: how fast one unit of each heats, K/s, by name (`sim.model.inputs`)."""
    anew, par = anew_rows(record), par.copy()
    par[AMBIENT] = own.ambient_degC
    at_rest, none = np.full(anew.size, np.nan), np.zeros(anew.size)
    at_rest[0] = own.ambient_degC
    bodies = np.array([own.bodies_degC.get(e.name, at_rest) for e in links.plate]).reshape(-1, anew.size)
    late = np.array([own.thermometer_late_K.get(e.name, none) for e in links.thermometer]).reshape(-1, anew.size)
    nodes = plate_nodes(record, links, spacing)
    heats = record.inputs.coefficients(inputs)
    return simulate_plate(record, nodes, par, links, own.plate_degC, anew, bodies.T, late.T, spacing, None, heats)


def straight_path(time_s: Array, plate_degC: Array, longest_s: float = np.inf) -> PlatePath:
    """Return a course of the plate that is straight between given nodes, cut into parts of at most longest_s."""
    time = time_s
    if np.isfinite(longest_s):
        count = np.maximum(np.ceil(np.diff(time_s) / longest_s - 1e-9).astype(np.int64), 1)
        length = np.repeat(np.diff(time_s) / count, count)
        within = np.arange(length.size) - np.repeat(np.cumsum(count) - count, count)
        time = np.append(np.repeat(time_s[:-1], count) + within * length, time_s[-1])
    plate = np.interp(time, time_s, plate_degC)
    slope = np.diff(plate) / np.diff(time)
    slopes = np.column_stack((np.append(slope, 0.0), np.insert(slope, 0, 0.0)))
    return PlatePath(time, plate, slopes)

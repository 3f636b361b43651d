"""What a film went through in a record: its own temperature, and its own output wherever that was read.

    T_f   from the plate's path through what acts on the film's temperature
    y     from what the ohmmeter showed, back through leads, shunt and ranges

Plate and effects are known. Filters of the film's output or of log R are not taken back: that would make noise of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from sim.diagnosis.data.record import Record, told_of
from sim.diagnosis.fit.path_estimate import corrected_path, measured_path
from sim.inference.film.rows import FilmRecord
from sim.inference.nuisance import fit_own
from sim.model.chain import ChainModel
from sim.model.film_nodes import FilmNodes, film_nodes
from sim.model.links import Links
from sim.model.meter_power import MeterCurrent, MeterPower
from sim.model.own_output import own_output
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart
from sim.model.record_run import RecordRun


def can_be_taken_back(links: Links) -> bool:
    """Whether the film's own output follows from each reading alone."""
    return not links.hysteretic_part and not links.meter_lags


def film_went_through(model: ChainModel, record: Record) -> FilmNodes:
    """The film's temperature in a record that a model's plate and effects are known for; the room, first temperatures
    and what the plate's model is slowly off by are fitted to the thermometer. Raises ValueError without readings."""
    run = RecordRun(model)
    links, path = run.links, _path(run, record)
    power = None
    if links.heated and record.test_current_A is not None and record.output is not None:
        rows = np.flatnonzero(record.output_used)
        shown = np.interp(np.arange(record.rows), rows, record.output[rows])
        meter = MeterCurrent(record.time_s, record.test_current_A, record.test_on_s)
        own = own_output(links, shown)
        power = MeterPower(meter, -own if record.quantity.rises else own)
    return film_nodes(record, path, links, [0.0] * len(links.film_lags), power, FilmStart(), run.spacing)


def readings_of_the_film(record: Record, nodes: FilmNodes, links: Links, name: str) -> list[FilmRecord]:
    """As an identification takes it: a row for each of the record's, also without a reading, as there the temperature
    is known, and for each turn between them; and each of the records that were joined by itself."""
    assert record.output is not None
    read = np.flatnonzero(record.output_used)
    slope = np.sign(np.diff(nodes.film_degC))
    turns = np.flatnonzero(slope[1:] * slope[:-1] < 0.0) + 1
    after = np.searchsorted(record.time_s, nodes.time_s[turns])
    turns = turns[~np.isin(after, record.after_gaps)]  # what a simulation does in a gap is made up
    kept = np.union1d(nodes.taken, turns)
    output = np.full(kept.size, np.nan)
    output[np.searchsorted(kept, nodes.taken[read])] = own_output(links, record.output[read])
    time = nodes.time_s[kept]
    begins = np.searchsorted(time, record.time_s[record.joined])
    parts = np.split(np.arange(kept.size), begins)
    return [FilmRecord(time[part], nodes.film_degC[kept[part]], output[part], name) for part in parts]


def _path(run: RecordRun, record: Record) -> PlatePath:
    """The plate's path: simulated from the record's commands and corrected by the thermometer, or measured."""
    if record.current_A is None:
        return measured_path(record)
    plate = run.model.plate
    told = replace(told_of(record), output=None, error_K=plate.error_K, error_time_s=plate.error_time_s)
    own, _ = fit_own(run, record, told, FilmStart())
    found = run.plate(record, own)
    rows = np.flatnonzero(record.temperature_used)
    residual = record.temperature_degC[rows] - run.links.shown_degC(found.shown_degC)[rows]
    return corrected_path(record, found.path, residual, rows)

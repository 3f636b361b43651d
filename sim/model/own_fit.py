"""The one fit of what belongs to a record: the room, first temperatures and the film's memory, the model held.

    least  sum_rows ((T - T_shown) / sigma_K)^2 + sum_k ((u_k - u_k0) / spread_k)^2,    u: RecordOwn's temperatures
    least  sum_rows ((y - y_shown) / sigma_dec)^2 + ...                                 memory, and how far filters are

over rows that the caller chooses: all of them, or a record's first ones (`told_rows`), by which a prediction begins.
The temperatures enter next to linearly: Gauss-Newton. A memory is one of those of a film that was saturated and turned
round at most once; another than the model's own has to bring `WORTH` of log-likelihood.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import HeatFlow
from sim.model.links import Links
from sim.model.plate_path import PlatePath, PlateRun
from sim.model.record_own import FilmStart, RecordOwn, anew_rows
from sim.model.recorded import Mask, Recorded, driven_from_s

FIRST_S, FIRST_ROWS = 30.0, 20  # of each stretch: what a prediction is told of a record's beginning
MOST_TOLD = 0.5  # of a record: what is left is to be predicted
ROOM_SPREAD_K = 3.0  # of a room about what it was when the model was made: another day, the same laboratory
APART_K = 10.0  # spread of bodies about the room, and of filters about what they follow, where nothing is known
LATE_SPREAD = 0.5  # K and decades: of how far a filter of the film or of the ohmmeter is behind
SEVERAL = 10  # turning points before the first row that are tried, on either side
MARGIN = 0.25  # of the range of temperatures: so far beyond them may a film have turned round
WORTH = 3.0  # log-likelihood that another memory than the model's own has to bring
LEAST_NOISE_K, LEAST_NOISE_DEC = 1e-3, 1e-4  # an instrument's last digit: nothing is known better
STEP_K, STEP_LATE = 0.01, 1e-3  # of difference quotients: rounding is 1e-11
STEPS = 3  # of Gauss-Newton, from the first readings


class Forward(Protocol):
    """A chain that runs over records: a known model, or a fit with its own film."""

    @property
    def links(self) -> Links: ...

    @property
    def ambient_degC(self) -> float: ...

    def plate(self, record: Recorded, own: RecordOwn) -> PlateRun: ...

    def shown(self, record: Recorded, path: PlatePath, own: RecordOwn) -> Array: ...


@dataclass(frozen=True, eq=False)
class Told:
    """The readings that count, nan elsewhere, (rows,): degC and -log10 R; None where a record has none; and their
    noise. error_K: by how much a model is off besides in each row since a current first drove the plate."""

    temperature_degC: Array
    output: Array | None
    sigma_K: float
    sigma_dec: float
    error_K: float = 0.0

    def only(self, rows: Mask) -> Told:
        """Those of some rows."""
        output = np.where(rows, self.output, np.nan) if self.output is not None else None
        return replace(self, temperature_degC=np.where(rows, self.temperature_degC, np.nan), output=output)


def told_rows(record: Recorded, first_s: float | None = None) -> Mask:
    """The first rows of each stretch: first_s seconds; None: 30 s or 20 rows, whichever is more; of a short stretch
    its first half."""
    time, told = record.time_s, np.zeros(record.time_s.size, dtype=np.bool_)
    for begin, end in zip(record.first_rows, [*record.first_rows[1:], time.size], strict=True):
        seconds = FIRST_S if first_s is None else first_s
        count = int(np.searchsorted(time[begin:end], time[begin] + seconds, side="right"))
        count = max(count, FIRST_ROWS) if first_s is None else max(count, 1)
        told[begin : begin + max(1, min(count, int(MOST_TOLD * (end - begin))))] = True
    return told


def first_readings(record: Recorded, temperature_degC: Array) -> Array:
    """The first reading of each stretch; of one without readings, the nearest one: degC, (stretches,)."""
    used, found = np.flatnonzero(np.isfinite(temperature_degC)), []
    for begin, end in zip(record.first_rows, [*record.first_rows[1:], record.time_s.size], strict=True):
        inside = used[(used >= begin) & (used < end)]
        row = inside[0] if inside.size else used[np.argmin(np.abs(used - begin))]
        found.append(float(temperature_degC[row]))
    return np.array(found)


def fit_own(
    chain: Forward, record: Recorded, told: Told, film: FilmStart, path: PlatePath | None = None
) -> tuple[RecordOwn, PlatePath]:
    """(what belongs to the record, the plate's path with it). film: the model's own memory; path: of the plate, where
    it is measured; None: it is simulated from the record's commands, its temperatures fitted to the thermometer's.
    Raises ValueError where no temperature was read."""
    if not np.any(np.isfinite(told.temperature_degC)):
        raise ValueError("temperature_degC: no finite number in the first rows")
    own = RecordOwn(chain.ambient_degC, first_readings(record, told.temperature_degC), film=film)
    if path is None:
        own = _temperatures(chain, record, told, own)
        path = chain.plate(record, own).path
    if told.output is not None and np.any(np.isfinite(told.output)):
        own = _film(chain, record, told, own, path)
    return own, path


def _temperatures(chain: Forward, record: Recorded, told: Told, own: RecordOwn) -> RecordOwn:
    """Room, bodies, filters and plate."""
    anew, links = anew_rows(record).size, chain.links
    bodies = [e.name for e in links.plate if isinstance(e.effect.form, HeatFlow) and e.effect.form.own_rate is not None]
    lags, room = [e.name for e in links.thermometer], own.ambient_degC
    shared = 1 + anew * (len(bodies) + len(lags))  # the plate's own follow them in the vector

    def own_of(u: Array) -> RecordOwn:
        each = u[1:shared].reshape(-1, anew)
        ambient = room + float(u[0])
        warm = {name: ambient + each[k] for k, name in enumerate(bodies)}
        late = {name: each[len(bodies) + k] for k, name in enumerate(lags)}
        return replace(
            own, ambient_degC=ambient, bodies_degC=warm, thermometer_late_K=late, plate_degC=own.plate_degC + u[shared:]
        )

    rows = np.flatnonzero(np.isfinite(told.temperature_degC))
    stretch = np.searchsorted(record.first_rows, rows, side="right") - 1

    driven = record.time_s[rows] > driven_from_s(record)
    sigma_K = np.hypot(told.sigma_K, np.where(driven, told.error_K, 0.0))

    def residual(u: Array) -> Array:
        return (told.temperature_degC - chain.plate(record, own_of(u)).shown_degC)[rows] / sigma_K

    u = np.zeros(shared + own.plate_degC.size)
    spread = np.concatenate(([ROOM_SPREAD_K], np.full(shared - 1, APART_K), np.full(own.plate_degC.size, math.inf)))
    for _ in range(STEPS):
        left = residual(u)
        columns = [(residual(_moved(u, slice(k, k + 1), STEP_K)) - left) / -STEP_K for k in range(shared)]
        by_plate = (residual(_moved(u, slice(shared, None), STEP_K)) - left) / -STEP_K  # each acts on its own stretch
        columns += [np.where(stretch == k, by_plate, 0.0) for k in range(own.plate_degC.size)]
        u = u + _step(np.stack(columns, axis=1), left, u, spread)
    return own_of(u)


def _film(chain: Forward, record: Recorded, told: Told, own: RecordOwn, path: PlatePath) -> RecordOwn:
    """Memory, and how far filters of film and ohmmeter are behind."""
    assert told.output is not None
    rows, output = np.flatnonzero(np.isfinite(told.output)), told.output

    def residual(of: RecordOwn) -> Array:
        return (output - chain.shown(record, path, of))[rows] / told.sigma_dec

    def cost(of: RecordOwn) -> float:
        return 0.5 * float(np.sum(residual(of) ** 2))

    own = _remembered(own, path, float(record.time_s[0]), cost)
    names = [e.name for e in (*chain.links.film_lags, *chain.links.hysteretic_part, *chain.links.meter_lags)]
    if not names:
        return own

    def own_of(u: Array) -> RecordOwn:
        return replace(own, late=dict(zip(names, u.tolist(), strict=True)))

    u, spread = np.zeros(len(names)), np.full(len(names), LATE_SPREAD)
    for _ in range(STEPS):
        left = residual(own_of(u))
        moved = [residual(own_of(_moved(u, slice(k, k + 1), STEP_LATE))) for k in range(u.size)]
        u = u + _step(np.stack([(m - left) / -STEP_LATE for m in moved], axis=1), left, u, spread)
    return own_of(u)


def _remembered(own: RecordOwn, path: PlatePath, begin_s: float, cost: Callable[[RecordOwn], float]) -> RecordOwn:
    """With the memory that suits best, the model's own if none is clearly better."""
    best, least = own, cost(own) - WORTH
    for start in beginnings(path, begin_s, own.film):
        other = replace(own, film=start)
        value = cost(other)
        if value < least:
            best, least = other, value
    return best


def beginnings(path: PlatePath, begin_s: float, start: FilmStart) -> list[FilmStart]:
    """What a film may remember at the first row: saturated, or turned round once since; the gaps' as in `start`."""
    low, high = float(np.min(path.plate_degC)), float(np.max(path.plate_degC))
    first, margin = float(path.at(np.array([begin_s]))[0]), MARGIN * (high - low)
    there = replace(start, initial="heated", previous_degC=None)
    found = [there, replace(there, initial="cooled")]
    for t in np.linspace(low - margin, first, SEVERAL)[:-1]:
        found.append(replace(there, initial="cooled", previous_degC=float(t)))
    for t in np.linspace(first, high + margin, SEVERAL)[1:]:
        found.append(replace(there, previous_degC=float(t)))
    return found


def _moved(u: Array, places: slice, by: float) -> Array:
    out = u.copy()
    out[places] += by
    return out


def _step(columns: Array, left: Array, u: Array, spread: Array) -> Array:
    """Of Gauss-Newton with normal priors about 0."""
    within = np.diag(1.0 / spread)
    both, right = np.vstack((columns, within)), np.concatenate((left, -u / spread))
    return np.asarray(np.linalg.lstsq(both, right, rcond=1e-12)[0], dtype=np.float64)

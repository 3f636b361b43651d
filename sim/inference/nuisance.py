"""The one fit of what belongs to a record: the room, first temperatures and the film's memory, the model held.

    least  sum_rows ((T - T_shown) / sigma_K)^2 + sum_k ((u_k - u_k0) / spread_k)^2,    u: RecordOwn's temperatures
    least  sum_rows ((y - y_shown) / sigma_dec)^2 + ...                                 memory, and how far filters are

over rows that the caller chooses: all of them, or a record's first ones (`told_rows`), by which a prediction begins.
The temperatures enter next to linearly. A memory is one of those of a film that was saturated and turned
round at most once; another than the model's own has to bring `WORTH` of log-likelihood. So has each temperature that
the film went to in a long gap, beyond its ends.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from compensator.hysteresis.functions import Array
from sim.effects.effect import HeatFlow
from sim.inference.levenberg_marquardt import Damping, Linearized, descend
from sim.inference.memory import begun, gaps_of, through_gaps
from sim.inference.noise import Readings
from sim.model.links import Links
from sim.model.plate_path import PlatePath, PlateRun
from sim.model.record_own import FilmStart, RecordOwn, anew_rows
from sim.model.recorded import Mask, Recorded, Rows, driven_rows

FIRST_S, FIRST_ROWS = 30.0, 20  # of each stretch: what a prediction is told of a record's beginning
MOST_TOLD = 0.5  # of a record: what is left is to be predicted
ROOM_SPREAD_K = 3.0  # of a room about what it was when the model was made: another day, the same laboratory
REST_K = 1.0  # spread of bodies about the room, and of filters about what they follow: a rig that has rested
SHARE = 0.5  # of how far the plate is from the room, as far may they be, too: a record may begin while a rig runs
LATE_SPREAD = 0.5  # K and decades: of how far a filter of the film or of the ohmmeter is behind
WORTH = 3.0  # log-likelihood that each temperature of another memory than the model's own has to bring
LEAST_NOISE_K, LEAST_NOISE_DEC = 1e-3, 1e-4  # an instrument's last digit: nothing is known better
STEP_K, STEP_LATE = 0.01, 1e-3  # of difference quotients: rounding is 1e-11
SETTLED = 1e-5  # log-likelihood that one more step gains: values are then within 0.005 deviations
TINY = 1e-30  # of a diagonal: an unknown on which nothing depends
STEPS = 4  # of a descent from the first readings, next to linear: the second brings little, the third nothing
DAMPING = Damping(first=1e-12, more=100.0, least_after_failure=1e-4, trials=4)  # undamped as long as that gains
Tried = tuple[Array, Array, float]  # unknowns, what they leave over the noise, and half the sum of its squares


class Forward(Protocol):
    """A chain that runs over records: a known model, or a fit with its own film."""

    @property
    def links(self) -> Links: ...

    @property
    def ambient_degC(self) -> float: ...

    def plate(self, record: Recorded, own: RecordOwn) -> PlateRun: ...

    def shown(self, record: Recorded, path: PlatePath, own: RecordOwn, read: Array | None = None) -> Array: ...


@dataclass(frozen=True, eq=False)
class Told:
    """The readings that count, nan elsewhere, (rows,): degC and -log10 R; None where a record has none; and their
    noise. error_K: by how much a model is off besides since a current first drove the plate, for error_time_s (0: from
    row to row)."""

    temperature_degC: Array
    output: Array | None
    sigma_K: float
    sigma_dec: float
    error_K: float = 0.0
    error_time_s: float = 0.0

    def only(self, rows: Mask) -> Told:
        """Return the readings of some rows."""
        output = np.where(rows, self.output, np.nan) if self.output is not None else None
        return replace(self, temperature_degC=np.where(rows, self.temperature_degC, np.nan), output=output)


def resting_K(first_K: float) -> float:
    """Spread of a body's first temperature about the room's, K. first_K: of the plate's own about the room's."""
    return math.hypot(REST_K, SHARE * first_K)


def told_rows(record: Recorded, first_s: float | None = None) -> Mask:
    """Return the first rows of each stretch: first_s seconds; None: 30 s or 20 rows, whichever is more; of a short
    stretch its first half."""
    time, told = record.time_s, np.zeros(record.time_s.size, dtype=np.bool_)
    for begin, end in zip(record.first_rows, [*record.first_rows[1:], time.size], strict=True):
        seconds = FIRST_S if first_s is None else first_s
        count = int(np.searchsorted(time[begin:end], time[begin] + seconds, side="right"))
        count = max(count, FIRST_ROWS) if first_s is None else max(count, 1)
        told[begin : begin + max(1, min(count, int(MOST_TOLD * (end - begin))))] = True
    return told


def first_readings(record: Recorded, temperature_degC: Array) -> Array:
    """Return the first reading of each stretch; of one without readings, the nearest one: degC, (stretches,)."""
    used, found = np.flatnonzero(np.isfinite(temperature_degC)), []
    for begin, end in zip(record.first_rows, [*record.first_rows[1:], record.time_s.size], strict=True):
        inside = used[(used >= begin) & (used < end)]
        row = inside[0] if inside.size else used[np.argmin(np.abs(used - begin))]
        found.append(float(temperature_degC[row]))
    return np.array(found)


def fit_own(
    chain: Forward, record: Recorded, told: Told, film: FilmStart, path: PlatePath | None = None
) -> tuple[RecordOwn, PlatePath]:
    """Return (what belongs to the record, the plate's path with it). film: the model's own memory; path: of the plate,
    where it is measured; None: it is simulated from the record's commands, its temperatures fitted to the
    thermometer's. Raises ValueError where no temperature was read."""
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
    """Return the record's own with room, bodies, filters and plate fitted."""
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
    noise = _noise(record, told, rows)

    def residual(u: Array) -> Array:
        return (told.temperature_degC - chain.plate(record, own_of(u)).shown_degC)[rows] / noise

    def slopes(u: Array, left: Array) -> Array:
        columns = [(left - residual(_moved(u, slice(k, k + 1), STEP_K))) / STEP_K for k in range(shared)]
        by_plate = (left - residual(_moved(u, slice(shared, None), STEP_K))) / STEP_K  # each acts on its own stretch
        columns += [np.where(stretch == k, by_plate, 0.0) for k in range(own.plate_degC.size)]
        return np.stack(columns, axis=1)

    begins = own.plate_degC[np.searchsorted(record.first_rows, anew_rows(record))] - room
    resting = np.tile([resting_K(float(first)) for first in begins], len(bodies) + len(lags))
    spread = np.concatenate(([ROOM_SPREAD_K], resting, np.full(own.plate_degC.size, math.inf)))
    return own_of(_least(residual, slopes, spread))


def _noise(record: Recorded, told: Told, rows: Rows) -> Array:
    """Of the readings in some rows, K: the thermometer's until a current first drove the plate, with what the model
    lacks from then on. That is slow, and room and bodies are slower still: white noise of its density at low
    frequencies tells as little of them, and asks nothing of a model's first seconds that no slow process would have."""
    step_s = Readings.at(record.time_s[rows]).step_s()
    error_K = told.error_K * math.sqrt(1.0 + told.error_time_s / step_s)
    return np.hypot(told.sigma_K, np.where(driven_rows(record)[rows], error_K, 0.0))


def _film(chain: Forward, record: Recorded, told: Told, own: RecordOwn, path: PlatePath) -> RecordOwn:
    """Return the record's own with memory, and how far filters of film and ohmmeter are behind, fitted."""
    assert told.output is not None
    rows, output = np.flatnonzero(np.isfinite(told.output)), told.output
    read = np.interp(np.arange(output.size), rows, output[rows]) if rows.size else output

    def residual(of: RecordOwn) -> Array:
        return (output - chain.shown(record, path, of, read))[rows] / told.sigma_dec

    def cost(film: FilmStart) -> float:
        return 0.5 * float(np.sum(residual(replace(own, film=film)) ** 2))

    first_degC = float(path.at(record.time_s[:1])[0])
    start = begun(own.film, first_degC, path.plate_degC, cost, WORTH)
    own = replace(own, film=through_gaps(start, gaps_of(record, path), path.plate_degC, cost, WORTH))
    names = [e.name for e in (*chain.links.film_lags, *chain.links.hysteretic_part, *chain.links.meter_lags)]
    if not names:
        return own

    def own_of(u: Array) -> RecordOwn:
        return replace(own, late=dict(zip(names, u.tolist(), strict=True)))

    def left_of(u: Array) -> Array:
        return residual(own_of(u))

    def slopes(u: Array, left: Array) -> Array:
        moved = [left_of(_moved(u, slice(k, k + 1), STEP_LATE)) for k in range(u.size)]
        return np.stack([(left - m) / STEP_LATE for m in moved], axis=1)

    return own_of(_least(left_of, slopes, np.full(len(names), LATE_SPREAD)))


def _moved(u: Array, places: slice, by: float) -> Array:
    out = u.copy()
    out[places] += by
    return out


def _least(residual: Callable[[Array], Array], slopes: Callable[[Array, Array], Array], spread: Array) -> Array:
    """Return the u of least squares with normal priors about 0, from there. residual: over the noise, (rows,); slopes:
    by how much it falls with each unknown, (rows, unknowns), from u and its residual; spread: of each prior."""
    width = 1.0 / spread

    def tried(u: Array) -> Tried:
        left = np.concatenate((residual(u), u * width))
        return u, left, 0.5 * float(left @ left)

    def linearized(at: Tried) -> Linearized[Tried]:
        u, left, _ = at
        columns = np.vstack((-slopes(u, left[: -u.size]), np.diag(width)))
        normal = columns.T @ columns
        scale = np.maximum(np.diag(normal), TINY)
        return Linearized(normal, -columns.T @ left, scale, lambda step: tried(u + step))

    def settled(before: float, after: float) -> bool:
        return before - after < SETTLED * (1.0 + SETTLED * before)

    return descend(tried(np.zeros(spread.size)), STEPS, lambda at: at[2], linearized, settled, DAMPING)[0]

"""The film's temperature over a record, at the times at which it turns round, is read, or its output is followed by a
lag.

A lag of the temperature itself follows the plate at times much closer to each other: a current that acts between two
rows bends the plate's course there, and what lags remembers it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.effects.effect import Filter, Switched
from sim.model.links import Links, followed, warmed
from sim.model.meter_power import MeterPower
from sim.model.plate_path import PlatePath, turns_between
from sim.model.record_own import FilmStart
from sim.model.recorded import COARSE, Mask, Recorded, Spacing


@dataclass(frozen=True, eq=False)
class FilmNodes:
    """The film's temperature on the times at which it is needed.

    time_s, film_degC: (nodes,); side: the direction of each step, with the memory at the first node; taken: the node
    at which each row's resistance was read; points: the nodes at which the film's output is needed, rising (all of
    them where a filter follows it); rows: the point of each row.
    """

    time_s: Array
    film_degC: Array
    side: NDArray[np.int8]
    taken: NDArray[np.int64]
    turned_degC: tuple[float, ...]
    points: NDArray[np.int64]
    rows: NDArray[np.int64]

    def everywhere(self) -> FilmNodes:
        """Return the same with the film's output at all nodes."""
        return replace(self, points=np.arange(self.time_s.size), rows=self.taken)

    def at_points(self, signal: Array) -> Array:
        """Return a signal of the rows at the points, straight between them."""
        order = np.argsort(self.taken, kind="stable")
        return np.interp(self.points_s, self.time_s[self.taken[order]], signal[order])

    def of_rows(self, columns: Array) -> Array:
        """Return what was computed at the points, in every row; not a copy where a row has a point of its own."""
        n = self.points.size
        own = self.rows.size == n and bool(np.all(self.rows == np.arange(n)))
        return columns if own else np.asarray(columns[self.rows], dtype=np.float64)

    @property
    def points_s(self) -> Array:
        """Times of the points."""
        return self.time_s[self.points]


def film_nodes(
    record: Recorded,
    path: PlatePath,
    links: Links,
    late_K: Sequence[float],
    power: MeterPower | None,
    start: FilmStart,
    spacing: Spacing = COARSE,
) -> FilmNodes:
    """Return the film's temperature. late_K: how far each filter of it is behind at the first row; power: of the
    ohmmeter, if it heats."""
    late, effects = iter(late_K), links.film_temperature
    course = path.finer(_begins(record, path), spacing.parts(path.time_s)) if links.film_lags else None
    turning_s = path.turning_s
    if course is not None:
        time, temperature = course
        _through_gaps(record, path, start, time, temperature)
        while any(isinstance(e.effect.form, Filter) for e in effects):
            temperature = _after(effects[0], time, temperature, power, late)
            effects = effects[1:]
        course = time, temperature
        turning_s = time[turns_between(temperature, np.empty(0, dtype=np.int64))]
    jumps_s = power.meter.jumps_s() if power is not None else np.empty(0)
    time, place = _nodes(record, path, links, (turning_s, jumps_s), start, spacing)
    if course is None:
        temperature = path.at(time)
        _through_gaps(record, path, start, time, temperature)
    else:
        temperature = np.interp(time, *course)
    for effect in effects:
        temperature = _after(effect, time, temperature, power, late)
    side = np.empty(time.size, dtype=np.int8)
    side[0] = -2 if start.initial == "cooled" else 2
    side[1:] = np.sign(np.diff(temperature))
    if links.hysteretic_part or links.meter_lags:
        return FilmNodes(time, temperature, side, place, start.turned_degC, np.arange(time.size), place)
    if np.all(place[1:] >= place[:-1]):
        points, rows = place, np.arange(place.size)
    else:
        points, rows = np.unique(place, return_inverse=True)
    return FilmNodes(time, temperature, side, place, start.turned_degC, points, rows)


def plate_at_film_nodes(
    record: Recorded, path: PlatePath, links: Links, jumps_s: Array, start: FilmStart, spacing: Spacing
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return (times at which the film's temperature is needed and followed, the one at which each row's resistance was
    read, the plate's temperature at them, or what a film went through in a gap). jumps_s: when the ohmmeter's power
    changes at once."""
    closer = path.finer(_begins(record, path), spacing.parts(path.time_s))[0] if links.film_lags else np.empty(0)
    time, place = _nodes(record, path, links, (path.turning_s, jumps_s, closer), start, spacing)
    temperature = path.at(time)
    _through_gaps(record, path, start, time, temperature)
    return time, place, temperature


def _after(effect: Switched, time: Array, temperature: Array, power: MeterPower | None, late: Iterator[float]) -> Array:
    """The film's temperature behind one of the effects on it."""
    if isinstance(effect.effect.form, Filter):
        return followed(effect, time, temperature, np.full(1, np.nan), next(late))[0]
    heated = power is not None and effect.effect.form.heated  # type: ignore[union-attr]
    return warmed(effect, time, temperature, power.at(time) if heated and power is not None else np.zeros(time.size))


def _begins(record: Recorded, path: PlatePath) -> Mask:
    """The nodes of a path at which a stretch begins."""
    begins = np.zeros(path.time_s.size, dtype=np.bool_)
    begins[np.searchsorted(path.time_s, record.time_s[record.first_rows])] = True
    return begins


def _nodes(
    record: Recorded, path: PlatePath, links: Links, times: Sequence[Array], start: FilmStart, spacing: Spacing
) -> tuple[Array, NDArray[np.int64]]:
    """(Times of the film's nodes: the rows, when their resistances were read, what it went through in gaps, and others;
    the node at which each row's was read). What a simulation of the plate does in a gap is made up."""
    taken = links.taken(record.taken_s)
    if links.meter_lags or (links.hysteretic_part and spacing.creep):
        times = (*times, path.time_s)
    more = np.concatenate([some for some in times if some.size] or [np.empty(0)])
    more = more[_gap_of(more, *_gaps(record)) < 0]
    more = np.concatenate((more, _passed(record, start)[0]))
    if more.size == 0 and np.array_equal(taken, record.time_s):
        return record.time_s, np.arange(taken.size)
    return path.together(np.concatenate((record.time_s, more)), np.clip(taken, 0.0, None))


def _passed(record: Recorded, start: FilmStart) -> tuple[Array, Array]:
    """When a film turned round in gaps, evenly apart in each, and its temperatures there."""
    after, degC = start.turned_in_gaps(record.time_s)
    number = 1 + np.arange(after.size) - np.searchsorted(after, after)  # of its gap
    share = number / (1 + np.searchsorted(after, after, side="right") - np.searchsorted(after, after))
    return record.time_s[after - 1] + share * (record.time_s[after] - record.time_s[after - 1]), degC


def _through_gaps(record: Recorded, path: PlatePath, start: FilmStart, time: Array, temperature: Array) -> None:
    """Write into a plate's temperature what a film goes through in the gaps: straight from one end to the other, by the
    temperatures at which it turned round."""
    begin, end = _gaps(record)
    if not begin.size:
        return
    gap, (passed_s, passed_degC) = _gap_of(time, begin, end), _passed(record, start)
    known_s = np.concatenate((begin, end, passed_s))
    known = np.concatenate((path.at(np.stack((begin, end))).ravel(), passed_degC))
    order = np.argsort(known_s, kind="stable")
    inside = gap >= 0
    temperature[inside] = np.interp(time[inside], known_s[order], known[order])


def _gaps(record: Recorded) -> tuple[Array, Array]:
    """When the gaps of a record begin and end."""
    return record.time_s[record.first_rows[1:] - 1], record.time_s[record.first_rows[1:]]


def _gap_of(time: Array, begin: Array, end: Array) -> NDArray[np.int64]:
    """Return the gap that each time is inside of, -1 for none."""
    gap = np.searchsorted(begin, time) - 1
    return np.where(time < np.append(end, -np.inf)[gap], gap, -1)

"""The film's temperature over a record, at the times at which it turns round, is read, or is followed by a lag."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.effects.effect import Filter
from sim.model.links import Links, followed, warmed
from sim.model.meter_power import MeterPower
from sim.model.plate_path import PlatePath
from sim.model.record_own import FilmStart
from sim.model.recorded import COARSE, Recorded, Spacing


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
    jumps_s = power.meter.jumps_s() if power is not None else np.empty(0)
    time, place, temperature = plate_at_film_nodes(record, path, links, jumps_s, start, spacing)
    late = iter(late_K)
    for effect in links.film_temperature:
        if isinstance(effect.effect.form, Filter):
            temperature, _ = followed(effect, time, temperature, np.full(1, np.nan), next(late))
        else:
            heated = power is not None and effect.effect.form.heated  # type: ignore[union-attr]
            power_W = power.at(time) if heated and power is not None else np.zeros(time.size)
            temperature = warmed(effect, time, temperature, power_W)
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
    record: Recorded,
    path: PlatePath,
    links: Links,
    jumps_s: Array,
    start: FilmStart,
    spacing: Spacing = COARSE,
) -> tuple[Array, NDArray[np.int64], Array]:
    """Return (times at which the film's temperature is needed, the one at which each row's resistance was read, the
    plate's temperature at them, or what a film went through in a gap). jumps_s: when the ohmmeter's power changes at
    once."""
    taken = links.taken(record.taken_s)
    turns = np.concatenate((path.turning_s, jumps_s)) if jumps_s.size else path.turning_s
    gaps = record.first_rows[1:]
    begin, end = record.time_s[gaps - 1], record.time_s[gaps]
    turns = turns[_gap_of(turns, begin, end) < 0]  # what a simulation does there is made up
    after, passed_degC = start.turned_in_gaps(record.time_s)
    number = 1 + np.arange(after.size) - np.searchsorted(after, after)  # of its gap, evenly apart in time
    share = number / (1 + np.searchsorted(after, after, side="right") - np.searchsorted(after, after))
    within = record.time_s[after - 1] + share * (record.time_s[after] - record.time_s[after - 1])
    turns = np.concatenate((turns, within))
    if spacing.film_parts == 1:
        turns = np.concatenate((turns, path.time_s))
    elif links.film_lags or links.meter_lags:
        turns = np.concatenate((turns, 0.5 * (record.time_s[1:] + record.time_s[:-1])))
    same = turns.size == 0 and np.array_equal(taken, record.time_s)
    time, place = record.time_s, np.arange(taken.size)
    if not same:
        time, place = path.together(np.concatenate((time, turns)), np.clip(taken, 0.0, None))
    temperature = path.at(time)
    if gaps.size and not same:  # what is read there is on the way from one end to the other
        gap = _gap_of(time, begin, end)
        inside = gap >= 0
        ends, gap = path.at(np.stack((begin, end))), gap[inside]
        way = (time[inside] - begin[gap]) / (end - begin)[gap]
        temperature[inside] = ends[0, gap] + way * (ends[1] - ends[0])[gap]
    temperature[np.searchsorted(time, within)] = passed_degC
    return time, place, temperature


def _gap_of(time: Array, begin: Array, end: Array) -> NDArray[np.int64]:
    """Return the gap that each time is inside of, -1 for none."""
    gap = np.searchsorted(begin, time) - 1
    return np.where(time < np.append(end, -np.inf)[gap], gap, -1)

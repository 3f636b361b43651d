"""From the recorded current to the plate's and the thermometer's temperature: one simulation of the first links."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import AMBIENT
from sim.model.links import Links, followed
from sim.model.plate_balance import heat_flows, run
from sim.model.recorded import COARSE, Mask, Recorded, Rows, Spacing

MOST_NODES = 3_000_000  # beyond them rows and commands alone are nodes: 24 MB an array


@dataclass(frozen=True, eq=False)
class PlatePath:
    """Plate temperature: time_s, plate_degC of shape (nodes,), slopes (nodes, 2) after and before each node. known: the
    times that were asked for last, and the temperatures then: a film is followed at the same ones again and again.
    joined: what was `together` last, of which it is the same."""

    time_s: Array
    plate_degC: Array
    slopes: Array
    turning_s: Array = field(default_factory=lambda: np.empty(0))
    known: deque[tuple[Array, Array]] = field(default_factory=lambda: deque(maxlen=2), init=False)
    joined: deque[tuple[Array, Array, Rows]] = field(default_factory=lambda: deque(maxlen=1), init=False)

    def at(self, time: Array) -> Array:
        """Return the plate's temperature at any times: cubic between nodes, constant slope beyond the ends."""
        found = next((degC for asked, degC in self.known if np.array_equal(asked, time)), None)
        if found is None:
            found = self._at(time)
            self.known.append((time.copy(), found))
        return found.copy()

    def raised(self, time_s: Array, by_K: Array) -> PlatePath:
        """Return the path with something added that is straight between some times."""
        more = np.interp(self.time_s, time_s, by_K)
        slope = np.diff(more) / np.maximum(np.diff(self.time_s), 1e-9)
        slopes = self.slopes + np.column_stack((np.append(slope, 0.0), np.append(0.0, slope)))
        return PlatePath(self.time_s, self.plate_degC + more, slopes, self.turning_s)

    def together(self, times: Array, taken: Array) -> tuple[Array, Rows]:
        """Return all of some times, each once, rising, and the places of those at which rows were taken, (rows,):
        the same for every size of a lag."""
        asked = np.concatenate((times, taken))
        if not self.joined or not np.array_equal(self.joined[0][0], asked):
            time = np.unique(asked)
            self.joined.append((asked, time, np.searchsorted(time, taken)))
        return self.joined[0][1:]

    def _at(self, time: Array) -> Array:
        k = np.clip(np.searchsorted(self.time_s, time, side="right") - 1, 0, self.time_s.size - 2)
        t0, h = self.time_s[k], self.time_s[k + 1] - self.time_s[k]
        x = np.clip((time - t0) / np.maximum(h, 1e-12), 0.0, 1.0)
        a, b = self.plate_degC[k], self.plate_degC[k + 1]
        cubic = _cubic(x, a, b - a, h * self.slopes[k, 0], h * self.slopes[k + 1, 1])
        late = np.maximum(time - self.time_s[-1], 0.0)
        return np.asarray(cubic + late * self.slopes[-1, 1], dtype=np.float64)

    def finer(self, begins: Mask, parts: int) -> tuple[Array, Array]:
        """Return times and temperatures at so many times as many nodes: what a lag follows bends between two. begins:
        where a stretch does, shape (nodes,); before those straight."""
        count = parts * (self.time_s.size - 1) + 1
        time, temperature = np.empty(count), np.empty(count)
        _finer(self.time_s, self.plate_degC, self.slopes, begins, parts, time, temperature)
        return time, temperature


@njit
def _cubic(x: Any, begin: Any, change: Any, p: Any, q: Any) -> Any:
    """Return the cubic between two nodes, x from 0 to 1, with slopes p and q over the whole at its ends (Hermite);
    numbers or arrays. Compiled, it does not warn where a trial's steps are without an end."""
    bend = 3.0 * change - 2.0 * p - q
    return begin + x * (p + x * (bend + x * (p + q - 2.0 * change)))


@njit
def _finer(
    time: Array, plate: Array, slopes: Array, begins: Mask, parts: int, finer_time: Array, finer_plate: Array
) -> None:
    """Cubics between every two nodes, into finer_time and finer_plate."""
    for k in range(time.size - 1):
        h, change = time[k + 1] - time[k], plate[k + 1] - plate[k]
        p, q = (change, change) if begins[k + 1] else (h * slopes[k, 0], h * slopes[k + 1, 1])
        for j in range(parts):
            finer_time[parts * k + j] = time[k] + j / parts * h
            finer_plate[parts * k + j] = _cubic(j / parts, plate[k], change, p, q)
    finer_time[-1], finer_plate[-1] = time[-1], plate[-1]


@dataclass(frozen=True, eq=False)
class Nodes:
    """Times at which the current may change, or is read: time_s, current_A (nodes,), rows: which node a row is; inputs:
    what else heats the plate, until the next node, (nodes, inputs)."""

    time_s: Array
    current_A: Array
    rows: NDArray[np.int64]
    inputs: Array


def plate_nodes(record: Recorded, links: Links, spacing: Spacing = COARSE) -> Nodes:
    """Return the record's rows, the moments at which its commands act, and times between them."""
    acts, amounts = links.sent(*record.commands)
    time = np.union1d(record.time_s, acts[(acts >= record.time_s[0]) & (acts <= record.time_s[-1])])
    if float(np.max(np.diff(time), initial=0.0)) > 1.01 * spacing.longest_s:
        count = np.ceil(np.diff(time) / spacing.longest_s - 1e-6).astype(np.int64)
        if np.sum(count) < MOST_NODES:
            inside = [
                time[:-1][count > j] + np.diff(time)[count > j] * j / count[count > j] for j in range(1, count.max())
            ]
            time = np.unique(np.concatenate([time, *inside]))
    place = np.searchsorted(acts, time, side="right") - 1
    current = np.where(place >= 0, amounts[np.maximum(place, 0)], 0.0)
    inputs = record.inputs.between(record.time_s, time)
    return Nodes(time, current, np.searchsorted(time, record.time_s), inputs)


@dataclass(frozen=True, eq=False)
class PlateRun:
    """One simulation: the plate's path, and what an ideal thermometer behind the thermometer's filters shows in each
    row, degC, shape (rows,)."""

    path: PlatePath
    shown_degC: Array


def simulate_plate(
    record: Recorded,
    nodes: Nodes,
    plate: Array,
    links: Links,
    first_degC: Array,
    anew: Rows,
    own_degC: Array,
    late_K: Array,
    spacing: Spacing = COARSE,
    rooms_K: Array | None = None,
    inputs_K_per_s: Array | None = None,
) -> PlateRun:
    """plate: (s, r, g, q, T_a, slope of s, slope of r), as `PlateModel.numbers` begins. first_degC: plate temperature
    at the beginning of each stretch. anew: the first row, and others of those that begin stretches. own_degC: there, of
    the effects on the plate, nan: as it was before, (anew, effects). late_K: by how much each thermometer filter is
    behind there, (anew, filters). rooms_K: by how much the room is warmer from there on than T_a, (anew,); None: by
    nothing. inputs_K_per_s: how fast one unit of each of the record's inputs heats, (inputs,); None: not at all."""
    heat = heat_flows(links.plate)
    n = nodes.time_s.size
    reset = np.full(n, np.nan)
    reset[nodes.rows[record.first_rows]] = first_degC
    temperature, slopes = np.empty(n), np.empty((n, 2))
    begins, bodies = nodes.rows[anew], own_degC[0]
    rooms = np.zeros(begins.size) if rooms_K is None else rooms_K
    heating = np.zeros(n) if inputs_K_per_s is None else nodes.inputs @ inputs_K_per_s
    for begin, end, own, room in zip(begins, [*begins[1:] + 1, n], own_degC, rooms, strict=True):
        part = slice(begin, end)  # up to the next begin, whose slope before it is kept
        before, bodies = slopes[begin, 1], np.where(np.isnan(own), bodies, own)
        par = plate.copy()
        par[AMBIENT] += room
        run(
            par,
            heat.terms,
            heat.values,
            nodes.time_s[part],
            nodes.current_A[part],
            heating[part],
            reset[part],
            bodies,
            temperature[part],
            slopes[part],
        )
        if begin > 0:
            slopes[begin, 1] = before
    path = PlatePath(nodes.time_s, temperature, slopes, _turning(nodes, temperature))
    return PlateRun(path, behind_thermometer(record, nodes, links, anew, late_K, path, spacing))


def behind_thermometer(
    record: Recorded, nodes: Nodes, links: Links, anew: Rows, late_K: Array, path: PlatePath, spacing: Spacing = COARSE
) -> Array:
    """Return what an ideal thermometer behind the thermometer's filters shows of a plate's path in each row, degC,
    (rows,). anew, late_K: as of `simulate_plate`."""
    shown, begins = path.plate_degC, nodes.rows[anew]
    if not links.thermometer:
        return np.asarray(shown[nodes.rows], dtype=np.float64)
    parts, time = spacing.parts(nodes.time_s), nodes.time_s
    if parts > 1:
        resets = np.zeros(time.size, dtype=np.bool_)
        resets[nodes.rows[record.first_rows]] = True
        time, shown = path.finer(resets, parts)
    for lag, behind in zip(links.thermometer, late_K.T, strict=True):
        out = np.empty(time.size)
        for begin, end, late in zip(parts * begins, [*parts * begins[1:], time.size], behind, strict=True):
            part = slice(begin, end)
            out[part], _ = followed(lag, time[part], shown[part], np.array([shown[begin] - late]))
        shown = out
    return np.asarray(shown[parts * nodes.rows], dtype=np.float64)


def _turning(nodes: Nodes, temperature: Array) -> Array:
    """Return times between the rows at which the temperature turns round: the film remembers them."""
    if nodes.time_s.size == nodes.rows.size:
        return np.empty(0)
    return nodes.time_s[turns_between(temperature, nodes.rows)]


@njit
def turns_between(temperature: Array, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the nodes besides these, rising ones, at which the temperature turns round; a trial's may be without an
    end."""
    found, count, row = np.empty(temperature.size, dtype=np.int64), 0, 0
    for k in range(1, temperature.size - 1):
        while row < rows.size and rows[row] < k:
            row += 1
        before, after = temperature[k] - temperature[k - 1], temperature[k + 1] - temperature[k]
        turns = (before > 0.0 and after < 0.0) or (before < 0.0 and after > 0.0)
        if turns and not (row < rows.size and rows[row] == k):
            found[count] = k
            count += 1
    return found[:count]

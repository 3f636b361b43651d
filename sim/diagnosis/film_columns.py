"""The film and the ohmmeter as a linear problem: what each coefficient adds to the output, row by row.

With the temperature of the film given, the output is linear in the weights of the play operators and in the
coefficients of D; filters (creep, a meter's lag) act on each column alone. Only the envelopes and the effects' own
parameters are not linear.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial.legendre import legval
from numpy.typing import NDArray
from scipy.interpolate import BSpline

from compensator.hysteresis.film import Initial
from compensator.hysteresis.functions import Array
from compensator.identification.operator_outputs import envelope_values, operator_outputs
from sim.diagnosis.film_power import MeterPower
from sim.diagnosis.plate_path import PlatePath
from sim.diagnosis.record import Record
from sim.effects.effect import Filter, Reading, ReadingTime, Switched, Warming, at_the_terminals, filters

KNOTS = 7
SIMPLE = 3  # degree of what D has of simple form
GRID = 400
FOLLOWING = ("log_resistance", "hysteretic_part")  # what filters of these follow is needed at all nodes
CURVED = ("log_resistance", "film_temperature")  # what a filter follows there bends from row to row


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
    previous_degC: float | None
    points: NDArray[np.int64]
    rows: NDArray[np.int64]

    def everywhere(self) -> FilmNodes:
        """The same with the film's output at all nodes."""
        return replace(self, points=np.arange(self.time_s.size), rows=self.taken)

    def same_film(self, other: FilmNodes) -> bool:
        """Whether the film goes through the same temperatures, and is read at the same of them."""
        return (
            self.previous_degC == other.previous_degC
            and np.array_equal(self.film_degC, other.film_degC)
            and np.array_equal(self.side, other.side)
            and np.array_equal(self.taken, other.taken)
        )

    def at_points(self, signal: Array) -> Array:
        """A signal of the rows at the points, straight between them."""
        order = np.argsort(self.taken, kind="stable")
        return np.interp(self.points_s, self.time_s[self.taken[order]], signal[order])

    def of_rows(self, columns: Array) -> Array:
        """What was computed at the points, in every row; not a copy where a row has a point of its own."""
        n = self.points.size
        own = self.rows.size == n and bool(np.all(self.rows == np.arange(n)))
        return columns if own else np.asarray(columns[self.rows], dtype=np.float64)

    @property
    def points_s(self) -> Array:
        """Times of the points."""
        return self.time_s[self.points]


@dataclass(frozen=True)
class FilmStart:
    """What the film remembers at the first row: saturation at one end, and the turning point since, if any; and what
    it went through in each gap of the rows, up to two temperatures one after the other (nan: nothing beyond the ends).
    """

    initial: Initial = "heated"
    previous_degC: float | None = None
    passed_degC: tuple[tuple[float, float], ...] = ()


def taken_s(record: Record, effects: Sequence[Switched]) -> Array:
    """When each row's resistance was read."""
    taken = record.taken_s
    for effect in effects:
        if isinstance(effect.effect.form, ReadingTime):
            taken = effect.effect.form.taken(effect.par, taken)
    return taken


def film_nodes(
    record: Record,
    path: PlatePath,
    effects: Sequence[Switched],
    behind_K: Sequence[float],
    power: MeterPower | None,
    start: FilmStart,
) -> FilmNodes:
    """The film's temperature. behind_K: of each filter at the first row; power: of the ohmmeter, if it heats."""
    taken = taken_s(record, effects)
    turns = path.turning_s if power is None else np.concatenate((path.turning_s, power.jumps_s()))
    gaps = record.first_rows[1:]
    begin, end = record.time_s[gaps - 1], record.time_s[gaps]
    turns = turns[_gap_of(turns, begin, end) < 0]  # what a simulation does there is made up
    passed = np.asarray(start.passed_degC, dtype=np.float64).reshape(-1, 2)
    known = np.isfinite(passed)
    within = np.stack((begin + (end - begin) / 3.0, end - (end - begin) / 3.0), axis=1) if np.any(known) else passed
    turns = np.concatenate((turns, within[known]))
    if filters(effects, *CURVED):
        turns = np.concatenate((turns, 0.5 * (record.time_s[1:] + record.time_s[:-1])))
    same = turns.size == 0 and np.array_equal(taken, record.time_s)
    time = record.time_s
    if not same:
        time = np.union1d(np.concatenate((time, turns)), np.clip(taken, 0.0, None))
    place = np.arange(taken.size) if same else np.searchsorted(time, np.clip(taken, 0.0, None))
    temperature, k = path.at(time), 0
    if gaps.size and not same:  # what is read there is on the way from one end to the other
        gap = _gap_of(time, begin, end)
        inside = gap >= 0
        ends, gap = path.at(np.stack((begin, end))), gap[inside]
        way = (time[inside] - begin[gap]) / (end - begin)[gap]
        temperature[inside] = ends[0, gap] + way * (ends[1] - ends[0])[gap]
    if np.any(known):
        temperature[np.searchsorted(time, within[known])] = passed[known]
    for effect in effects:
        form = effect.effect.form
        if isinstance(form, Filter) and form.target == "film_temperature":
            out = np.empty(time.size)
            form.run(effect.par, time, temperature, np.array([temperature[0] - behind_K[k]]), out)
            temperature, k = out, k + 1
        elif isinstance(form, Warming):
            power_W = power.at(time) if form.heated and power is not None else np.zeros(time.size)
            temperature = temperature + form.add(effect.par, time, power_W)
    side = np.empty(time.size, dtype=np.int8)
    side[0] = -2 if start.initial == "cooled" else 2
    side[1:] = np.sign(np.diff(temperature))
    if filters(effects, *FOLLOWING):
        return FilmNodes(time, temperature, side, place, start.previous_degC, np.arange(time.size), place)
    if np.all(place[1:] >= place[:-1]):
        points, rows = place, np.arange(place.size)
    else:
        points, rows = np.unique(place, return_inverse=True)
    return FilmNodes(time, temperature, side, place, start.previous_degC, points, rows)


def _gap_of(time: Array, begin: Array, end: Array) -> NDArray[np.int64]:
    """The gap that each time is inside of, -1 for none."""
    gap = np.searchsorted(begin, time) - 1
    return np.where(time < np.append(end, -np.inf)[gap], gap, -1)


def operator_columns(nodes: FilmNodes, shape: Array, radii: Array) -> Array:
    """Output of each operator at the points, shape (points, operators); shape: (log a_R, c_R, log a_L, c_L)."""
    inputs, side = nodes.film_degC, nodes.side
    if nodes.previous_degC is not None:
        inputs = np.concatenate(([nodes.previous_degC], inputs))
        turn = np.int8(np.sign(inputs[1] - inputs[0]))
        side = np.concatenate((side[:1], [turn], side[1:])).astype(np.int8)
    gamma = envelope_values(inputs, side, shape[None, :])
    rows = nodes.points + (inputs.size - nodes.time_s.size)
    out = np.empty((rows.size, radii.size))
    operator_outputs(gamma, side, radii, np.zeros(radii.size, dtype=np.int64), 1.0, rows, out)
    return out


def play_outputs(nodes: FilmNodes, half_width_K: Array) -> Array:
    """Classical play operators F_h[T] at the rows' readings, degC, shape (rows, operators)."""
    side, inputs = nodes.side, nodes.film_degC
    if nodes.previous_degC is not None:
        inputs = np.concatenate(([nodes.previous_degC], inputs))
        side = np.concatenate((side[:1], [np.int8(np.sign(inputs[1] - inputs[0]))], side[1:])).astype(np.int8)
    plays = np.empty((nodes.taken.size, half_width_K.size))
    order = np.argsort(nodes.taken, kind="stable")
    rows = nodes.taken[order] + (inputs.size - nodes.time_s.size)
    part = np.empty_like(plays)
    group = np.zeros(half_width_K.size, dtype=np.int64)
    operator_outputs(np.ascontiguousarray(inputs[:, None]), side, half_width_K, group, np.inf, rows, part)
    plays[order] = part
    return plays


def classical_columns(nodes: FilmNodes, centre: Array, slope: Array, half_width_K: Array) -> Array:
    """tanh(slope (F_h[T] - centre)) at the rows' readings, shape (rows, operators): relays spread over the plane."""
    widths, place = np.unique(half_width_K, return_inverse=True)
    return np.asarray(np.tanh(slope * (play_outputs(nodes, widths)[:, place] - centre)), dtype=np.float64)


@dataclass(frozen=True, eq=False)
class SmoothCurve:
    """Any smooth D(T) on a range: cubic splines, as many as tell any of the named forms within 1e-4 of its span.

    Its columns are Legendre's polynomials of degree 1 to 3 over the range, and then what else the splines can do, each
    of mean square 1 about: a curve of simple form has coefficients of the first few only. mix: from these to splines.
    """

    knots: Array
    mix: Array

    @classmethod
    def over(cls, low: float, high: float, count: int = KNOTS) -> SmoothCurve:
        inner = np.linspace(low, high, count)
        knots = np.concatenate(([low] * 3, inner, [high] * 3))
        design = _splines(knots, np.linspace(low, high, GRID))
        x = np.linspace(-1.0, 1.0, GRID)
        simple = np.stack([legval(x, [0.0] * k + [1.0]) for k in range(SIMPLE + 1)], axis=1)
        simple = np.linalg.qr(simple)[0] * np.sqrt(GRID)
        others = np.linalg.svd(design - simple @ (simple.T @ design) / GRID, full_matrices=False)[0]
        wanted = np.concatenate((simple[:, 1:], np.sqrt(GRID) * others[:, : design.shape[1] - SIMPLE]), axis=1)
        mix = np.linalg.lstsq(np.column_stack((design, np.ones(GRID))), wanted, rcond=None)[0][:-1]
        return cls(knots, np.asarray(mix, dtype=np.float64))

    @property
    def count(self) -> int:
        return self.knots.size - 5

    def columns(self, temperature: Array) -> Array:
        """Shape (samples, count): without the constant."""
        return np.asarray(_splines(self.knots, temperature) @ self.mix, dtype=np.float64)

    def values(self, temperature: Array, coefficients: Array) -> Array:
        """The columns times coefficients, shape (samples,)."""
        inside = np.clip(temperature, self.knots[0], self.knots[-1])
        of_splines = self.mix @ coefficients
        spline = BSpline(self.knots, np.concatenate(([0.0], of_splines)), 3)
        return np.asarray(spline(inside) - float(np.sum(of_splines)) / (self.count + 1), dtype=np.float64)


def _splines(knots: Array, temperature: Array) -> Array:
    """Cubic B-splines but the first, less their mean; beyond the ends constant."""
    inside = np.clip(temperature, knots[0], knots[-1])
    count = knots.size - 4
    design = BSpline(knots, np.eye(count), 3)(inside)
    return np.asarray(design[:, 1:] - 1.0 / count, dtype=np.float64)


def filtered(columns: Array, time: Array, effect: Switched) -> Array:
    """Each column through a filter that was at rest before the first node."""
    form = effect.effect.form
    assert isinstance(form, Filter)
    out = np.empty_like(columns.T)
    for k, column in enumerate(np.ascontiguousarray(columns.T)):
        form.run(effect.par, time, column, np.array([column[0]]), out[k])
    return np.ascontiguousarray(out.T)


def transfer(effects: Sequence[Switched], output: Array) -> tuple[Array, Array]:
    """Series resistances and shunts: the output at the terminals for the film's own, and its derivative."""
    shown, slope = output, np.ones_like(output)
    for effect in effects:
        form = effect.effect.form
        if at_the_terminals(effect.effect):
            assert isinstance(form, Reading)
            h = 1e-5
            within = np.clip(shown, -15.0, 15.0)
            up = -np.log10(form.read(effect.par, 10.0 ** -(within + h)))
            down = -np.log10(form.read(effect.par, 10.0 ** -(within - h)))
            slope = slope * (up - down) / (2.0 * h)
            shown = 0.5 * (up + down)
    return shown, slope

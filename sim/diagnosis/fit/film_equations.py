"""The equations of the last links: plate temperature -> film -> ohmmeter, for given parameters and coefficients.

    y = D(T_f) + B(step(T_f) (c + sum_j p_j F_j[T_f] + sum_k n_k N_k[T_f]))        then the ohmmeter's effects

F_j are play operators with one pair of envelopes (the model's class), N_k relays spread over the Preisach plane: they
stand for whatever a film of another kind does besides. step and B are how the phases of such a film mix
(`sim.model.film_mixing`), 1 and the identity for any other. Nothing here knows of noise, or of how well a reading is
met.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record
from sim.diagnosis.fit.film_basis import ENVELOPES, SHAPE, FilmBasis
from sim.diagnosis.fit.film_point import Point
from sim.diagnosis.fit.preisach_density import Relays, followed_by, same_effects
from sim.diagnosis.fit.resistance_fit import FilmParameters, ResistanceFit
from sim.diagnosis.fit.unknowns import (
    Unknown,
    envelope_unknowns,
    mixing_unknowns,
    unknowns_of,
    values_inside,
    with_values,
)
from sim.effects.effect import Switched
from sim.model.film_columns import operator_columns, operator_signal
from sim.model.film_mixing import PhaseMixing
from sim.model.film_nodes import FilmNodes, film_nodes
from sim.model.links import Effects, Links, behind, columns_followed, links_of
from sim.model.meter_power import MeterCurrent, MeterPower
from sim.model.ohmmeter import shown_in_rows
from sim.model.operator_outputs import radius_floor
from sim.model.plate_path import PlatePath
from sim.model.recorded import Spacing

FAR_BEHIND = 20.0  # K: of a filter at the first row, more than a plate moves in its time constant
STEP_BEHIND = 1e-2  # K, the same of a difference quotient


def straight_readings(record: Record) -> Array:
    """The film's output in each row, (rows,): as it was read, straight between readings where there is none."""
    assert record.output is not None
    used = np.flatnonzero(record.output_used)
    return np.interp(np.arange(record.rows), used, record.output[used])


@dataclass(frozen=True, eq=False)
class Signals:
    """Columns at the points (`FilmEquations._signals`), and what they hang on: envelopes and change of the phases'
    step, the film's nodes, the filters of its hysteretic part."""

    columns: Array
    shape: Array
    is_mixed: bool
    nodes: FilmNodes
    creeps: Effects

    def serve(self, p: FilmParameters, x: Array, nodes: FilmNodes, creeps: Effects) -> bool:
        """Whether they would come out the same."""
        return (
            self.is_mixed == p.is_mixed
            and np.array_equal(self.shape, x[: ENVELOPES + 1])
            and nodes.same_film(self.nodes)
            and np.array_equal(nodes.points, self.nodes.points)
            and same_effects(self.creeps, creeps)
            and (not creeps or np.array_equal(nodes.time_s, self.nodes.time_s))
        )


@dataclass(frozen=True, eq=False)
class FilmEquations:
    """On one record and one path of the plate's temperature. readings: the film's output as far as it is known before a
    fit, (rows,), by whose resistance the ohmmeter heats; relays: whether the film may be of another kind; signals: of
    the last point, which are the same for other sizes of an effect of the ohmmeter's."""

    record: Record
    path: PlatePath
    basis: FilmBasis
    readings: Array
    relays: bool
    spacing: Spacing
    signals: deque[Signals] = field(default_factory=lambda: deque(maxlen=1), init=False)

    def on(self, path: PlatePath) -> Self:
        """The same rows on another path."""
        return replace(self, path=path)

    def elsewhere(self, record: Record) -> FilmEquations:
        """The same film over another record, its path to be given yet."""
        return FilmEquations(record, self.path, self.basis, straight_readings(record), self.relays, self.spacing)

    @staticmethod
    def filters_behind(effects: Sequence[Switched]) -> int:
        """How many of x, at its end, say how far the film's own filters are behind at the first row."""
        return len(links_of(effects).film_lags)

    def extended(self, p: FilmParameters, effects: Sequence[Switched]) -> FilmParameters:
        """The same film with these effects."""
        x = np.concatenate((p.x[:SHAPE], values_inside(effects), np.zeros(self.filters_behind(effects))))
        return replace(p, effects=tuple(effects), x=x)

    def split(self, p: FilmParameters, x: Array) -> tuple[list[Switched], Array]:
        """Effects with their values, and how far the film's filters are behind (K)."""
        count = self.filters_behind(p.effects)
        return with_values(p.effects, x[SHAPE : x.size - count]), x[x.size - count :]

    def nodes(self, p: FilmParameters, x: Array) -> tuple[Links, FilmNodes]:
        """The effects with their values in the chain's order, and the film's temperature."""
        effects, late = self.split(p, x)
        test, power, links = self.record.test_current_A, None, links_of(effects)
        if test is not None and links.heated:
            own = self._at_rows_s(links, self._film_output(p))
            meter = MeterCurrent(self.record.time_s, test, self.record.test_on_s)
            power = MeterPower(meter, -own if self.record.quantity.rises else own)
        return links, film_nodes(self.record, self.path, links, late.tolist(), power, p.start, self.spacing)

    def heated_by(self, p: FilmParameters, point: Point) -> Array:
        """The film's own output with which the ohmmeter heats it from now on, rows: a part of the way from what it was
        taken for to what the fit has. Resistance falls as the film is heated, and with it the heat: all of the way, a
        film that is heated by 1.8 K on a flank of 0.4 decades/K would be taken for too warm and too cold in turns, by
        1.6 times as much each time. The part is that of the steepest flank, so that no row goes beyond."""
        before, after = self._film_output(p), self.film_output(p, point)
        links, nodes = self.nodes(p, point.x)
        _, late = self.split(p, point.x)
        cold = film_nodes(self.record, self.path, links, late.tolist(), None, p.start, self.spacing)
        degC = nodes.film_degC[nodes.taken]
        heated_K, moved_K = degC - cold.film_degC[cold.taken], np.abs(np.diff(degC))
        far = moved_K > 0.5 * float(np.median(moved_K))  # beside a turn what moved is a quotient of two small numbers
        steepest = float(np.max(np.abs(np.diff(after))[far] / moved_K[far], initial=0.0))
        return np.asarray(before + (after - before) / (1.0 + math.log(10.0) * steepest * np.maximum(heated_K, 0.0)))

    def film_degC(self, fit: ResistanceFit) -> Array:
        """The film's temperature when each row was read, (rows,)."""
        _, nodes = self.nodes(fit.parameters, fit.parameters.x)
        return nodes.film_degC[nodes.taken]

    def phases(self, p: FilmParameters, x: Array) -> PhaseMixing:
        """How the film's phases add up."""
        return self.basis.mixing.phases(*(_mixing(x) if p.is_mixed else (0.0, 0.0)))

    def film_output(self, p: FilmParameters, point: Point) -> Array:
        """The film's own output in all rows, its phases mixed."""
        film, c = point.problem.film, point.coefficients
        return self._mixed(p, point.x, self._curve(film, c), point.unmixed)[0]

    def _curve(self, columns: Array, c: Array) -> Array:
        """D of the film's columns times their coefficients."""
        return np.asarray(columns[:, 1 : self.basis.free] @ c[1 : self.basis.free], dtype=np.float64)

    def _mixed(self, p: FilmParameters, x: Array, curve: Array, whole: Array) -> tuple[Array, Array | None]:
        """The film's own output where its columns add up to `whole`, D among them (`curve`); by how much it changes
        with all but D, None: by as much."""
        if not p.is_mixed:
            return whole, None
        phases = self.phases(p, x)
        inside = phases.mixed(whole - curve)
        return curve + inside, phases.slope(inside)

    def step(self, p: FilmParameters, x: Array, film_degC: Array) -> Array | None:
        """What the operators are multiplied by at temperatures of the film; None: by 1."""
        return self.basis.mixing.step(float(x[ENVELOPES]), film_degC) if p.is_mixed else None

    def _film_output(self, p: FilmParameters) -> Array:
        """The film's own output as far as it is known before a fit; rows."""
        return self.readings if p.film_output is None else p.film_output

    def _at_rows_s(self, links: Links, output: Array) -> Array:
        """What was taken for the rows' readings, at the rows' own times: they may be stamped too early or too late."""
        taken, time = links.taken(self.record.taken_s), self.record.time_s
        if np.array_equal(taken, time):
            return output
        order = np.argsort(taken, kind="stable")
        return np.interp(time, taken[order], output[order])

    def _signals(self, p: FilmParameters, links: Links, nodes: FilmNodes, x: Array) -> Array:
        """Columns at the points before the phases mix: constant, D, operators; creep included."""
        if not self.signals or not self.signals[0].serve(p, x, nodes, links.hysteretic_part):
            columns = self._columns(p, links, nodes, x)
            self.signals.append(Signals(columns, x[: ENVELOPES + 1].copy(), p.is_mixed, nodes, links.hysteretic_part))
        return self.signals[0].columns

    def _columns(self, p: FilmParameters, links: Links, nodes: FilmNodes, x: Array) -> Array:
        operators = operator_columns(nodes, x[:ENVELOPES], self._radii(x))
        step = self.step(p, x, nodes.film_degC[nodes.points])
        if step is not None:
            operators *= step[:, None]
        parts = [np.ones((nodes.points.size, 1)) if step is None else step[:, None]]
        if self.basis.curve is not None:
            parts.append(self.basis.curve.columns(nodes.film_degC[nodes.points]))
        extra = []
        for effect in links.hysteretic_part:
            operators = columns_followed(effect, nodes.points_s, operators)
            extra.append(behind(effect, nodes.points_s))
        return np.concatenate([*parts, operators, *extra], axis=1)

    def _radii(self, x: Array) -> Array:
        """Of the operators, from the smallest one on that keeps the envelopes in order."""
        floor, _ = radius_floor(x[:ENVELOPES])
        return np.asarray(floor + (1.0 - floor) * self.basis.fractions, dtype=np.float64)

    def _output(
        self,
        p: FilmParameters,
        links: Links,
        nodes: FilmNodes,
        x: Array,
        c: Array,
        late_dec: Sequence[float],
        of_relays: Array,
    ) -> Array:
        """The film's own output at the points: the columns of `_signals` times c, its coefficients, and what the relays
        add, mixed. late_dec: how far each filter of the hysteretic part is behind."""
        signal = operator_signal(nodes, x[:ENVELOPES], self._radii(x), c[self.basis.free : self.basis.columns])
        step = self.step(p, x, nodes.film_degC[nodes.points])
        if step is not None:
            signal *= step
        for effect, late in zip(links.hysteretic_part, late_dec, strict=True):
            signal = columns_followed(effect, nodes.points_s, signal[:, None])[:, 0]
            signal = signal + late * behind(effect, nodes.points_s)[:, 0]
        curve = np.zeros(signal.size)
        if self.basis.curve is not None:
            curve = self.basis.curve.values(nodes.film_degC[nodes.points], c[1 : self.basis.free])
        constant = c[0] if step is None else c[0] * step
        return self._mixed(p, x, curve, curve + constant + signal + of_relays)[0]

    def of_relays(self, p: FilmParameters, x: Array, point: Point) -> tuple[Links, FilmNodes, Array]:
        """Effects and film at another x, and what the relays add: all that the envelopes leave alone."""
        links, nodes = self.nodes(p, x)
        first = point.coefficients.size - self.relay_count(p)
        return links, nodes, self._signal_of(p, x, links, nodes, point.coefficients[first:], point.problem.relays)

    def predict(
        self, p: FilmParameters, x: Array, point: Point, relays: tuple[Links, FilmNodes, Array] | None = None
    ) -> Array:
        """What is shown at another x with the point's coefficients. relays: as `of_relays` has them, where known."""
        links, nodes, of_relays = self.of_relays(p, x, point) if relays is None else relays
        c = point.coefficients
        creeps, lags = len(links.hysteretic_part), len(links.meter_lags)
        late = c[self.basis.columns : self.basis.columns + creeps + lags].tolist()
        signal = self._output(p, links, nodes, x, c, late[:creeps], of_relays)
        return shown_in_rows(links, nodes, signal, point.problem.range_of, late[creeps:])

    def predict_from(
        self, p: FilmParameters, fit: ResistanceFit, late: Mapping[str, float] | None = None, near: Relays | None = None
    ) -> tuple[Array, Array]:
        """What is shown, and the film's own output, with p's effects and the coefficients of a fit that has all of them
        but one; rows. late: how far each filter of the hysteretic part and of log R is behind at the first row, by
        effect; one that is not named, by nothing; None: as in the fit. near: the fit's relays, if known."""
        links, nodes = self.nodes(p, p.x)
        c = fit.coefficients
        late = self.late_dec(fit) if late is None else late
        relays = c[c.size - self.relay_count(fit.parameters) :]
        crept = [late.get(e.name, 0.0) for e in links.hysteretic_part]
        signal = self._output(p, links, nodes, p.x, c, crept, self._signal_of(p, p.x, links, nodes, relays, near))
        shown = shown_in_rows(links, nodes, signal, None, [late.get(e.name, 0.0) for e in links.meter_lags])
        return shown, nodes.of_rows(signal)

    def _signal_of(
        self, p: FilmParameters, x: Array, links: Links, nodes: FilmNodes, coefficients: Array, near: Relays | None
    ) -> Array:
        """What the relays add to the film's output at the points, before its phases mix. near: those of a fit, which
        may be at the same temperature of the film."""
        if not coefficients.size:
            return np.zeros(nodes.points.size)
        if near is not None and near.nodes is not None and nodes.same_film(near.nodes):
            signal = near.columns @ coefficients
        else:
            signal = self.basis.plane.signal(nodes, coefficients)
        step = self.step(p, x, nodes.film_degC[nodes.taken])
        if step is not None:
            signal = step * signal
        return nodes.at_points(followed_by(links.hysteretic_part, self.record.taken_s, signal[:, None])[:, 0])

    def late_dec(self, fit: ResistanceFit) -> dict[str, float]:
        """How far a fit has each filter of the hysteretic part and of log R behind at the first row."""
        links, place = links_of(fit.effects), self.basis.columns
        names = [e.name for e in (*links.hysteretic_part, *links.meter_lags)]
        return dict(zip(names, fit.coefficients[place : place + len(names)].tolist(), strict=True))

    def relay_count(self, p: FilmParameters) -> int:
        """How many coefficients the relays have; none where their prior's width is 0."""
        return self.basis.plane.count if self.relays and p.has_relays else 0

    def bounds(self, p: FilmParameters) -> tuple[Array, Array, Array]:
        """Least, largest and step of each of x."""
        unknowns = self.unknowns(p)
        behind = p.x.size - len(unknowns)
        low = np.array([u.low for u in unknowns] + [-FAR_BEHIND] * behind)
        high = np.array([u.high for u in unknowns] + [FAR_BEHIND] * behind)
        return low, high, np.array([u.step for u in unknowns] + [STEP_BEHIND] * behind)

    def unknowns(self, p: FilmParameters) -> list[Unknown]:
        """Of the envelopes and of the effects."""
        mixing = mixing_unknowns(p.is_mixed)
        return [*envelope_unknowns(self.path.plate_degC), *mixing, *unknowns_of(p.effects)]


def _mixing(x: Array) -> tuple[float, float]:
    """Exponent and percolation of how the phases mix."""
    return float(x[ENVELOPES + 1]), float(x[ENVELOPES + 2])

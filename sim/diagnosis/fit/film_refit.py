"""The diagnosis' film as a model that others can run: weights >= 0 and D(T) in one of its named forms.

While it searches, the diagnosis gives D any smooth shape and the film any weights. Here the same temperatures of the
film and the same effects are kept, and what lies between the film's output y and the ohmmeter is taken at its
derivative, so that the weights are again a linear problem with p >= 0. How the phases mix (`PhaseMixing`) stands
between y and the ohmmeter, D(T) and all: there is one output of a model to invert. That the step between the phases
changes with temperature is left out: a model file has no place for it.

    shown(y) ~ shown(y0) + L[d shown / d y (y - y0)],   L the ohmmeter's and the creep's filters
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from compensator.hysteresis.film import Envelope, FilmModel
from compensator.hysteresis.functions import Array
from sim.diagnosis.fit.film_basis import ENVELOPES
from sim.diagnosis.fit.mixed_envelopes import Dictionary
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.inference.film.memoryless_forms import Form
from sim.inference.nnls import solve_triangle
from sim.inference.triangle import triangle
from sim.model.film_columns import classical_columns, operator_columns
from sim.model.links import behind, columns_followed
from sim.model.ohmmeter import Ohmmeter, shown_in_rows
from sim.model.operator_outputs import Integers, radius_floor

OPERATORS = 80  # places on the grid of radii; few of them get weight
LEAST_WEIGHT = 1e-6  # of all weights


@dataclass(frozen=True, eq=False)
class Refit:
    """One solution: residual (rows,), weights, D's coefficients and offset; theta: envelopes (4) and D's shape, or
    D's shape alone with a dictionary."""

    form: Form
    theta: Array
    weights: Array
    coefficients: Array
    offset: float
    residual: Array
    operators: Dictionary | None = None

    @property
    def active(self) -> Integers:
        """Which operators have weight."""
        found = np.flatnonzero(self.weights > LEAST_WEIGHT * float(np.sum(self.weights)))
        return found if found.size else np.array([0], dtype=np.int64)

    def model(self, initial: str) -> FilmModel:
        """As a film model; operators without weight are left out."""
        kept, start = self.active, "heated" if initial == "heated" else "cooled"
        if self.operators is not None:
            o, w = self.operators.only(kept), self.weights[kept]
            rows = [(float(a), float(c), float(h)) for c, a, h in zip(o.centre, o.slope, o.half_width, strict=True)]
            up = tuple(Envelope("tanh", a, -a * (c + h)) for a, c, h in rows)
            down = tuple(Envelope("tanh", a, -a * (c - h)) for a, c, h in rows)
            d = self.form.memoryless(self.coefficients, self.theta, self.offset)
            return FilmModel(np.zeros(kept.size), w, up, down, d, "mixed_envelopes", "minus_log10_ohm", start)  # type: ignore[arg-type]
        log_r, c_r, log_l, c_l = (float(v) for v in self.theta[:ENVELOPES])
        return FilmModel(
            radii_of(self.theta[:ENVELOPES])[kept],
            self.weights[kept],
            Envelope("tanh", math.exp(log_r), -math.exp(log_r) * c_r),
            Envelope("tanh", math.exp(log_l), -math.exp(log_l) * c_l),
            self.form.memoryless(self.coefficients, self.theta[ENVELOPES:], self.offset),
            "generalized_pi" if self.form.name == "none" else "extended_generalized_pi",
            "minus_log10_ohm",
            start,  # type: ignore[arg-type]
        )


def radii_of(shape: Array) -> Array:
    """The grid of radii, from the smallest that the order condition allows to below 1."""
    floor, _ = radius_floor(shape)
    return np.asarray(floor + (1.0 - floor) * np.arange(OPERATORS) / OPERATORS, dtype=np.float64)


class FilmRefit:
    """Solutions on the film's temperature and with the effects of one fit of the last links. target: what columns are
    to add up to, (rows,); own: what the fit's film has in the rows; free: the constant, and what filters were behind by
    at the first row, (rows, 1 + filters); mixing: of the film's phases, None: in their logarithms."""

    def __init__(self, channel: ResistanceChannel, fit: ResistanceFit, signal: Array | None = None) -> None:
        """signal: the film's output at the nodes, about which the derivative is taken; None: that of the fit."""
        self.channel, self.fit = channel, fit
        p = fit.parameters
        links, found = channel.nodes(p, p.x)
        quantity = channel.record.quantity
        falls = quantity.is_resistance and not quantity.rises  # a model file has a mixing of no other output
        self.mixing = channel.phases(p, p.x) if p.is_mixed and falls else None
        first = () if self.mixing is None else (self.mixing.reading(),)
        self.links = replace(links, ohmmeter=(*first, *links.ohmmeter))
        self.own = fit.film_output if self.mixing is None else self.mixing.unmixed(fit.film_output)
        self.nodes = nodes = found.everywhere()
        time = nodes.time_s
        self.every = replace(nodes, taken=np.arange(time.size))
        if signal is None:
            order = np.argsort(nodes.taken, kind="stable")
            signal = np.interp(np.arange(time.size), nodes.taken[order], self.own[order])
        self._ohmmeter = Ohmmeter(self.links, nodes, signal)
        shown = shown_in_rows(self.links, nodes, signal)
        self.target = channel.output - (shown - self.through(signal[:, None])[:, 0])
        parts = [np.ones((time.size, 1)), *(behind(e, time) for e in self.links.hysteretic_part)]
        self.free = np.concatenate([*(self.through(part) for part in parts), self._ohmmeter.late], axis=1)

    def about(self, signal: Array) -> FilmRefit:
        """The same about another output of the film."""
        return FilmRefit(self.channel, self.fit, signal)

    def through(self, columns: Array) -> Array:
        """Parts of the film's output (nodes, k) as the ohmmeter shows them (rows, k)."""
        return self._ohmmeter.plain(columns)

    def crept(self, columns: Array) -> Array:
        """Parts of the hysteretic output at the nodes, creep included."""
        for creep in self.links.hysteretic_part:
            columns = columns_followed(creep, self.nodes.time_s, columns)
        return columns

    def plays(self, shape: Array) -> Array:
        """Operators of one pair of envelopes as the ohmmeter shows them, (rows, operators)."""
        return self.through(self.crept(operator_columns(self.every, shape, radii_of(shape))))

    def relays(self, o: Dictionary) -> Array:
        """Operators of a dictionary, (rows, operators)."""
        return self.through(self.crept(classical_columns(self.every, o.centre, o.slope, o.half_width)))

    def solve(
        self, rows: Integers, form: Form, theta: Array, operators: Array, dictionary: Dictionary | None = None
    ) -> Refit:
        """The best weights and coefficients over some rows."""
        shape = theta if dictionary is not None else theta[ENVELOPES:]
        d = self.through(form.columns(self.nodes.film_degC, shape)) if form.name != "none" else self.free[:, :0]
        free = np.concatenate((self.free[:, 1:], d), axis=1)
        columns = np.concatenate((free, operators, self.target[:, None]), axis=1)[rows]
        one = self.free[rows, 0]
        share = one @ columns / float(one @ one)
        columns = columns - one[:, None] * share
        x, _ = solve_triangle(triangle(columns), free.shape[1])
        residual = columns[:, -1] - columns[:, :-1] @ x
        offset = float(share[-1] - share[:-1] @ x)
        behind = self.free.shape[1] - 1
        k = free.shape[1]
        return Refit(form, theta, x[k:], x[behind:k], offset, residual, dictionary)

    def signal(self, fit: Refit) -> Array:
        """The film's output at the nodes, as a solution has it."""
        nodes, o = self.nodes, fit.operators
        if o is None:
            envelopes, shape = fit.theta[:ENVELOPES], fit.theta[ENVELOPES:]
            columns = operator_columns(self.every, envelopes, radii_of(envelopes))
        else:
            columns, shape = classical_columns(self.every, o.centre, o.slope, o.half_width), fit.theta
        d = fit.form.columns(nodes.film_degC, shape) @ fit.coefficients
        return np.asarray(fit.offset + d + self.crept(columns) @ fit.weights, dtype=np.float64)

    def residual(self, rows: Integers, fit: Refit, operators: Array) -> Array:
        """What a solution leaves in other rows, without what filters were behind by."""
        shape = fit.theta if fit.operators is not None else fit.theta[ENVELOPES:]
        d = self.through(fit.form.columns(self.nodes.film_degC, shape)) if fit.form.name != "none" else None
        shown = fit.offset * self.free[rows, 0] + operators[rows] @ fit.weights
        if d is not None:
            shown = shown + d[rows] @ fit.coefficients
        return np.asarray(self.target[rows] - shown, dtype=np.float64)

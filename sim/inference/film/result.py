"""The result of the fit of a film: the model, how each record began, and how sure all of it is.

A prediction is linearized in everything that was fitted: outer parameters, D's coefficients, the offset and the weights
that are not at their bound 0. Their covariance is that of `sim.inference.covariance`. Where a path has moved in a sense
whose envelope the records do not fix, the band is infinite: the fitted envelope may be far from where the film's is,
and its derivatives there say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95, Covariance, block_sandwich
from sim.inference.joint.films import PIFilm, PreisachFilm
from sim.inference.joint.likelihood import Fit
from sim.inference.readings.checked_columns import check_noise, checked_columns
from sim.inference.readings.temperature_path import temperature_path
from sim.model.film_columns import film_path
from sim.model.film_nodes import FilmNodes
from sim.model.record_own import FilmStart


@dataclass(frozen=True)
class Candidate:
    """One model that was tried: errors in the output's unit, on the rows fitted and on the rows held out."""

    kind: str
    form: str
    operators: int
    rmse: float
    held_out_rmse: float


def along(degC: Array, start: FilmStart) -> FilmNodes:
    """Return a course of the film's temperature, (rows,), as a film is simulated over it. start: its memory before."""
    side = np.sign(np.diff(degC, prepend=degC[0])).astype(np.int8)
    side[0] = -2 if start.initial == "cooled" else 2
    rows = np.arange(degC.size)
    return FilmNodes(rows.astype(np.float64), degC, side, rows, start.turned_degC, rows, rows)


@dataclass(frozen=True, eq=False)
class FittedFilm:
    """A fitted film with the covariance of all k fitted parameters; the outer ones come first. Output = centre + size *
    the fit's decades."""

    fit: Fit
    centre: float
    size: float

    @property
    def film(self) -> PIFilm | PreisachFilm:
        film = self.fit.joint.film
        assert isinstance(film, PIFilm | PreisachFilm)
        return film

    @property
    def outer_names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters: the first columns of `jacobian`."""
        names = (unknown.name for unknown in self.film.unknowns)
        return tuple("log_" + name.replace("_log", "") if name.endswith("ing_log_slope") else name for name in names)

    @property
    def outer_values(self) -> Array:
        return self.fit.at.x[self.fit.joint.is_film]

    def at(self, nodes: FilmNodes) -> Array:
        """Return the output at the points of a course, (points,)."""
        own = self.film.columns(self.outer_values, nodes) @ self.fit.at.coefficients
        return np.asarray(self.centre + self.size * own, dtype=np.float64)

    def jacobian(self, nodes: FilmNodes) -> Array:
        """Return the derivatives of the output by all that was fitted, (points, k)."""
        at, values = self.fit.at, self.outer_values
        columns = self.film.columns(values, nodes)
        own, outer = columns @ at.coefficients, []
        for k, unknown in enumerate(self.film.unknowns):
            moved = values.copy()
            moved[k] += unknown.step
            outer.append((self.film.columns(moved, nodes) @ at.coefficients - own) / unknown.step)
        return np.asarray(self.size * np.column_stack((*outer, columns[:, at.active])), dtype=np.float64)

    @cached_property
    def covariance(self) -> Covariance:
        """Of all that was fitted, in the fit's decades."""
        fit, joint = self.fit, self.fit.joint
        outer = joint.jacobian(fit.at, fit.metric)[joint.rows_K.size :, joint.is_film]
        prior = np.append(np.zeros(outer.shape[1]), self.film.precision[fit.at.active])
        design = np.column_stack((outer, fit.at.design[:, fit.at.active]))
        return block_sandwich(design, fit.at.white_dec, precision=np.diag(prior))

    @property
    def outer_standard_errors(self) -> Array:
        """Shape (outer,); inf where the records do not determine a parameter."""
        return self.covariance.standard_errors[: len(self.outer_names)]

    @cached_property
    def parameters(self) -> float:
        """How many numbers the readings determine, the outer ones included."""
        at, precision = self.fit.at, self.film.precision
        inner = at.design[:, at.active] / np.sqrt(precision[at.active])
        known = np.maximum(np.linalg.eigvalsh(inner.T @ inner), 0.0)
        return len(self.outer_names) + float(np.sum(known / (1.0 + known)))

    @cached_property
    def open_sides(self) -> frozenset[int]:
        """What of `FilmNodes.side` the records do not fix: 1 and -1, rows that the temperature rose or fell to; 2 and
        -2, first rows of a film heated or cooled."""
        nodes = self.fit.at.run.nodes
        assert nodes is not None
        taken = {int(side) for side in np.unique(film_path(nodes)[1])}
        unfixed = set()
        for sense, word in ((1, "rising"), (-1, "falling")):
            names = zip(self.outer_names, self.covariance.undetermined, strict=False)
            if sense not in taken or any(lost and name.startswith(("log_" + word, word)) for name, lost in names):
                unfixed |= {sense, 2 * sense} - ({2 * sense} & taken)
        return frozenset(unfixed)

    def half_width(self, nodes: FilmNodes) -> Array:
        """Return half the width of the 95 % band of the model's own curve at the points of a course, (points,); inf
        where the path has moved in a sense that the records do not fix, until it has gone beyond all of it in the
        other."""
        jacobian = self.jacobian(nodes)
        square = np.sum((jacobian @ self.covariance.matrix) * jacobian, axis=1)
        inputs, side = film_path(nodes)
        astray = _astray(inputs, side, self.open_sides)[inputs.size - nodes.time_s.size :]
        return np.where(astray[nodes.points], np.inf, NORMAL_95 * np.sqrt(np.maximum(square, 0.0)))


def _astray(inputs: Array, side: NDArray[np.int8], open_sides: frozenset[int]) -> NDArray[np.bool_]:
    """Return rows at which the film remembers a move that the records do not fix, shape (rows of the path,).

    Beyond the furthest that it came in the other sense a film forgets all that was in between.
    """
    found = np.zeros(inputs.size, dtype=np.bool_)
    if not open_sides:
        return found
    astray, forgets, low, high = False, 0, 0.0, 0.0
    for row, (v, way) in enumerate(zip(inputs.tolist(), side.tolist(), strict=True)):
        if abs(way) == 2:
            astray, forgets, low, high = way in open_sides, int(np.sign(way)), v, v
            forgets = 0 if astray else forgets
        elif way in open_sides:
            astray = True
        elif way == forgets and (v >= high if way > 0 else v <= low):
            astray = False
        found[row], low, high = astray, min(low, v), max(high, v)
    return found


@dataclass(frozen=True, eq=False)
class Prediction:
    """Output, shape (samples,), and half the width of its 95 % bands: of the model's curve, and of a reading; inf where
    the records do not fix the branch that the film is on."""

    output: Array
    half_width: Array
    half_width_reading: Array


@dataclass(frozen=True, eq=False)
class FilmFit:
    """The identified film.

    model; starts and memories: what each film remembered at its first row, and starts: what it went through in gaps;
    rmse, max_abs: over all trusted readings; held_out_rmse: of the same kind of model fitted without the held-out rows;
    candidates: what was tried; fitted: the fit, with the covariance of all that was fitted; temperature_noise_K: of
    each record's thermometer; outliers: indices of readings left out, of each record; identifiability: in plain words
    what these records cannot fix; course_degC: the temperature that drove the film in each row of each record.
    """

    model: FilmModel
    starts: tuple[FilmStart, ...]
    memories: tuple[Memory, ...]
    rmse: float
    max_abs: float
    held_out_rmse: float
    candidates: tuple[Candidate, ...]
    fitted: FittedFilm
    temperature_noise_K: tuple[float, ...]
    outliers: tuple[NDArray[np.int64], ...]
    identifiability: tuple[str, ...]
    course_degC: tuple[Array, ...] = ()

    @property
    def active_operators(self) -> int:
        """How many operators have weight."""
        return int(np.sum(self.model.weights > 0.0))

    def along(self, number: int, time_s: Array, path_degC: Array | None = None) -> Array:
        """Return the model's output in the rows of one of the records that were fitted, with what its film went through
        in gaps, shape (samples,). path_degC: the film's temperature there, None: that of the fit."""
        path_degC = self.course_degC[number] if path_degC is None else path_degC
        output, _ = through_gaps(self.model, self.starts[number], time_s, path_degC, self.memories[number])
        return output

    @property
    def outer_names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters, with units; none with mixed envelopes."""
        return self.fitted.outer_names

    @property
    def outer_values(self) -> Array:
        """Their values, shape (outer,)."""
        return self.fitted.outer_values

    @property
    def outer_standard_errors(self) -> Array:
        """Their standard errors, shape (outer,); inf where a record does not determine one."""
        return self.fitted.outer_standard_errors

    def predict(
        self,
        time_s: ArrayLike,
        temperature_degC: ArrayLike,
        *,
        start: FilmStart | None = None,
        temperature_noise_K: float | None = None,
    ) -> Prediction:
        """Return the output over a record, driven by the path behind its temperature; `start` defaults to the model's.

        time_s (increasing), temperature_degC (nan: no reading): shape (samples,). Raises ValueError with one line for
        columns that cannot be used, or a noise that is none.
        """
        check_noise(temperature_noise_K)
        time = checked_columns({"time_s": time_s, "temperature_degC": temperature_degC})["time_s"]
        if not np.any(np.isfinite(np.asarray(temperature_degC, dtype=np.float64))):
            raise ValueError(f"temperature_degC: no finite number in {time.size} rows, expected degC")
        v = temperature_path(time_s, temperature_degC, noise_K=temperature_noise_K).temperature_degC
        start = start or FilmStart(self.model.initial)
        output, _ = self.model.simulate(v, memory_at_start(self.model, start, float(v[0])))
        half_width = self.fitted.half_width(along(v, start))
        return Prediction(output, half_width, np.hypot(half_width, NORMAL_95 * self.held_out_rmse))


def through_gaps(
    model: FilmModel, start: FilmStart, time_s: Array, degC: Array, memory: Memory
) -> tuple[Array, Memory]:
    """Return a model's output in the rows of a record, with what its film went through in gaps, and its memory."""
    rows, passed_degC = start.turned_in_gaps(time_s)
    output, memory = model.simulate(np.insert(degC, rows, passed_degC), memory)
    return np.asarray(np.delete(output, rows + np.arange(rows.size)), dtype=np.float64), memory


def memory_at_start(model: FilmModel, start: FilmStart, first_degC: float) -> Memory:
    """Return the film's memory at a record's first row (degC)."""
    first, *rest = (*start.turned_degC, first_degC)
    memory = model.initial_memory(first, start.initial)
    for degC in rest:
        memory = model.step(degC, memory)[1]
    return memory

"""The result of the fit of a film: the model, how each record began, and how sure all of it is.

A prediction is linearized in everything that was fitted: outer parameters, D's coefficients, the offset and the weights
that are not at their bound 0. Their covariance is that of `sim.inference.covariance`. Where a path has moved in a sense
whose envelope the records do not fix, the band is infinite: the fitted envelope may be far from where the film's is,
and its derivatives there say nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95, Covariance, block_sandwich
from sim.inference.film.rows import Path, Prepared, build_path
from sim.inference.film.selection import Candidate
from sim.inference.readings.checked_columns import check_noise, checked_columns
from sim.inference.readings.temperature_path import temperature_path
from sim.model.record_own import FilmStart


class Linearized(Protocol):
    """A fitted film that can give its prediction and the derivatives by its parameters along a path."""

    @property
    def outer_names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters: the first columns of `jacobian`."""
        ...

    @property
    def outer_values(self) -> Array:
        """Their values, shape (outer,)."""
        ...

    @property
    def parameters(self) -> float:
        """How many numbers the readings determine, the outer ones included."""
        ...

    def at(self, path: Path) -> Array:
        """Return the prediction at the path's readings, shape (readings,)."""
        ...

    def play_outputs(self, path: Path) -> Array:
        """Return operator outputs at the path's readings, shape (readings, operators)."""
        ...

    @property
    def precision(self) -> Array | None:
        """Of the parameters' normal priors, over that of the readings, (parameters, parameters); None: no prior."""
        ...

    def jacobian(self, path: Path) -> Array:
        """Return d prediction / d parameters at the path's readings, shape (readings, parameters)."""
        ...


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """Covariance of all k fitted parameters; the outer ones come first. open_sides: what of `Path.side` the records do
    not fix: 1 and -1, rows that the temperature rose or fell to; 2 and -2, first rows of a film heated or cooled."""

    fitted: Linearized
    covariance: Covariance
    open_sides: frozenset[int] = frozenset()

    @property
    def outer_standard_errors(self) -> Array:
        """Shape (outer,); inf where the records do not determine a parameter."""
        count = len(self.fitted.outer_names)
        return self.covariance.standard_errors[:count]

    def half_width(self, path: Path) -> Array:
        """Return half the width of the 95 % band of the model's own curve at the path's readings, shape (readings,);
        inf where the path has moved in a sense that the records do not fix, until it has gone beyond all of it in the
        other."""
        jacobian = self.fitted.jacobian(path)
        square = np.sum((jacobian @ self.covariance.matrix) * jacobian, axis=1)
        half = NORMAL_95 * np.sqrt(np.maximum(square, 0.0))
        return np.where(_astray(path, self.open_sides)[path.rows], np.inf, half)


def uncertainty(fitted: Linearized, path: Path, residual: Array) -> Uncertainty:
    """Return the uncertainty of a fit, from its rows and their residuals."""
    covariance = block_sandwich(fitted.jacobian(path), residual, precision=fitted.precision)
    taken = {int(side) for side in np.unique(path.side)}
    unfixed = set()
    for sense, word in ((1, "rising"), (-1, "falling")):
        names = zip(fitted.outer_names, covariance.undetermined, strict=False)
        if sense not in taken or any(lost and name.startswith(("log_" + word, word)) for name, lost in names):
            unfixed |= {sense, 2 * sense} - ({2 * sense} & taken)
    return Uncertainty(fitted, covariance, frozenset(unfixed))


def _astray(path: Path, open_sides: frozenset[int]) -> NDArray[np.bool_]:
    """Return rows at which the film remembers a move that the records do not fix, shape (rows of the path,).

    Beyond the furthest that it came in the other sense a film forgets all that was in between.
    """
    found = np.zeros(path.inputs.size, dtype=np.bool_)
    if not open_sides:
        return found
    astray, forgets, low, high = False, 0, 0.0, 0.0
    for row, (v, side) in enumerate(zip(path.inputs.tolist(), path.side.tolist(), strict=True)):
        if abs(side) == 2:
            astray, forgets, low, high = side in open_sides, int(np.sign(side)), v, v
            forgets = 0 if astray else forgets
        elif side in open_sides:
            astray = True
        elif side == forgets and (v >= high if side > 0 else v <= low):
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
    candidates: what was tried; active_operators: those with weight > 0; uncertainty: covariance of all that was fitted;
    temperature_noise_K: of each record's thermometer; outliers: indices of readings left out, of each record;
    identifiability: in plain words what these records cannot fix; course_degC: the temperature that drove the film in
    each row of each record.
    """

    model: FilmModel
    starts: tuple[FilmStart, ...]
    memories: tuple[Memory, ...]
    rmse: float
    max_abs: float
    held_out_rmse: float
    candidates: tuple[Candidate, ...]
    active_operators: int
    uncertainty: Uncertainty
    temperature_noise_K: tuple[float, ...]
    outliers: tuple[NDArray[np.int64], ...]
    identifiability: tuple[str, ...]
    course_degC: tuple[Array, ...] = ()

    def along(self, number: int, time_s: Array, path_degC: Array | None = None) -> Array:
        """Return the model's output in the rows of one of the records that were fitted, with what its film went through
        in gaps, shape (samples,). path_degC: the film's temperature there, None: that of the fit."""
        path_degC = self.course_degC[number] if path_degC is None else path_degC
        rows, passed_degC = self.starts[number].turned_in_gaps(time_s)
        output, _ = self.model.simulate(np.insert(path_degC, rows, passed_degC), self.memories[number])
        return np.asarray(np.delete(output, rows + np.arange(rows.size)), dtype=np.float64)

    @property
    def outer_names(self) -> tuple[str, ...]:
        """Names of the nonlinear parameters, with units; none with mixed envelopes."""
        return self.uncertainty.fitted.outer_names

    @property
    def outer_values(self) -> Array:
        """Their values, shape (outer,)."""
        return self.uncertainty.fitted.outer_values

    @property
    def outer_standard_errors(self) -> Array:
        """Their standard errors, shape (outer,); inf where a record does not determine one."""
        return self.uncertainty.outer_standard_errors

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
        path = temperature_path(time_s, temperature_degC, noise_K=temperature_noise_K)
        v = path.temperature_degC
        start = start or FilmStart(self.model.initial)
        output, _ = self.model.simulate(v, memory_at_start(self.model, start, float(v[0])))
        every = np.ones(v.size, dtype=np.bool_)
        none = np.empty(0, dtype=np.int64)
        record = Prepared("record", time, path, np.zeros(v.size), every, none, none, none, np.empty(0), none)
        half_width = self.uncertainty.half_width(build_path([record], [start]))
        return Prediction(output, half_width, np.hypot(half_width, NORMAL_95 * self.held_out_rmse))


def memory_at_start(model: FilmModel, start: FilmStart, first_degC: float) -> Memory:
    """Return the film's memory at a record's first row (degC)."""
    first, *rest = (*start.turned_degC, first_degC)
    memory = model.initial_memory(first, start.initial)
    for degC in rest:
        memory = model.step(degC, memory)[1]
    return memory

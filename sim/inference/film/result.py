"""What the identification of a film gives: the model, what each record began with, and how sure all of it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import Array
from sim.inference.covariance import NORMAL_95
from sim.inference.film.prediction_bands import Uncertainty
from sim.inference.film.rows import Prepared, Start, build_path
from sim.inference.film.selection import Candidate
from sim.inference.readings.checked_columns import check_noise, checked_columns
from sim.inference.readings.temperature_path import temperature_path


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
    starts: tuple[Start, ...]
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
        start: Start | None = None,
        temperature_noise_K: float | None = None,
    ) -> Prediction:
        """The output over a record, driven by the path behind its temperature; `start` defaults to the model's.

        time_s (increasing), temperature_degC (nan: no reading): shape (samples,). Raises ValueError with one line for
        columns that cannot be used, or a noise that is none.
        """
        check_noise(temperature_noise_K)
        time = checked_columns({"time_s": time_s, "temperature_degC": temperature_degC})["time_s"]
        if not np.any(np.isfinite(np.asarray(temperature_degC, dtype=np.float64))):
            raise ValueError(f"temperature_degC: no finite number in {time.size} rows, expected degC")
        path = temperature_path(time_s, temperature_degC, noise_K=temperature_noise_K)
        v = path.temperature_degC
        start = start or Start(self.model.initial)
        output, _ = self.model.simulate(v, memory_at_start(self.model, start, float(v[0])))
        every = np.ones(v.size, dtype=np.bool_)
        none = np.empty(0, dtype=np.int64)
        record = Prepared("record", time, path, np.zeros(v.size), every, none, none, none, np.empty(0), none)
        half_width = self.uncertainty.half_width(build_path([record], [start]))
        return Prediction(output, half_width, np.hypot(half_width, NORMAL_95 * self.held_out_rmse))


def memory_at_start(model: FilmModel, start: Start, first_degC: float) -> Memory:
    """The film's memory at a record's first row (degC)."""
    if start.previous_degC is None:
        return model.initial_memory(first_degC, start.initial)
    memory = model.initial_memory(start.previous_degC, start.initial)
    return model.step(first_degC, memory)[1]

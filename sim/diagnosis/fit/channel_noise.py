"""The noise of both instruments, as what a fit leaves shows it."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any, Final

import numpy as np
from scipy.optimize import minimize

from compensator.hysteresis.functions import KELVIN, Array
from sim.diagnosis.data.likelihood import lattice_noise, noise_where_little_lies, quick_noise
from sim.diagnosis.data.noise_estimate import noise_of
from sim.diagnosis.data.noise_model import NoiseModel, by_reading, root_mean_square
from sim.diagnosis.data.path_error import PathError, SeenPathError, WhiteningOfTurns
from sim.diagnosis.data.record import Mask, Rows
from sim.diagnosis.data.unlogged_walk import noise_beside, unlogged_walk
from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.seen_path import seen_path, steepness
from sim.diagnosis.fit.temperature_channel import TemperatureChannel, TemperatureFit

DITHERED = 2.0  # steps of quantization over the noise, below which the noise spreads rounding evenly over the rows
FEWEST_SHOWN: Final = 50  # rows in which a path's error shows, or does not: the median of as many is known to a tenth
LEAST_K: Final = 1e-6  # of a path's error: less than any shows
MOST_ROUGH: Final = 2.0  # of the readings' noise, which a smoother takes for less than it is where rows share it
MOST_TOGETHER: Final = 0.92  # correlation from row to row: what hangs together over more than ten rows is a misfit
ROUGH_TO: Final[Any] = {"xatol": 0.02, "fatol": 0.1, "maxiter": 200}  # as well as a noise is known
NO_MISFIT = 1.1  # of what changes from row to row, what is left at all where the fit leaves nothing but noise


def thermometer_noise(
    channel: TemperatureChannel, fit: TemperatureFit, least_K: float, coloured: bool = False
) -> NoiseModel:
    """Of the thermometer. One beneath the quantization is white, as far as anybody can tell. coloured: as `noise_of`
    has it."""
    record, rows = channel.record, channel.rows
    step, residual = record.step_K, record.temperature_degC - fit.shown_degC
    if record.early > 0.0 and record.current_A is not None:
        walk = _unlogged(channel, fit)
        sigma_K = max(noise_beside(walk, residual[rows], rows), step / math.sqrt(12.0), least_K)
        return replace(NoiseModel.white(sigma_K), wandering=walk)
    most_K = 0.5 * step
    if step <= DITHERED * quick_noise(residual[rows]):
        used, readings = record.temperature_used, record.temperature_degC
        model = noise_of(residual, readings, used, channel.fitted, least_K, stepped=False, coloured=coloured)
        if not model.plain or step == 0.0:
            return model
        if root_mean_square(residual[rows]) < NO_MISFIT * model.level:  # else a plate's own misfit would pass for it
            most_K = max(most_K, math.sqrt(max(model.level**2 - step**2 / 12.0, 0.0)))
    sigma_K = lattice_noise(record.temperature_degC[rows], fit.shown_degC[rows], step, most_K)
    return NoiseModel.white(max(sigma_K, least_K))


def _unlogged(channel: TemperatureChannel, fit: TemperatureFit) -> Wandering:
    """For currents that changed between the rows."""
    record = channel.record
    assert record.current_A is not None
    s, r, g, q, _ = (float(v) for v in fit.parameters.plate())
    per_A = s * (fit.path.at(record.time_s) + KELVIN) + r * np.abs(record.current_A) + q
    return unlogged_walk(record.time_s, record.current_A, record.early, record.first_rows, per_A, g)


def ohmmeter_noise(
    channel: ResistanceChannel,
    fit: ResistanceFit,
    least_dec: float,
    unsure: PathError | float | None,
    coloured: bool = False,
) -> NoiseModel:
    """Of the ohmmeter. Where it is not the same everywhere it may be far below what the path is uncertain by on a
    flank: a film is no better a thermometer than the plate's own, until both channels are fitted as one. unsure: a
    standard deviation of the path (K), or of a measured one what it is off by; None: nothing."""
    used, residual = channel.record.output_used, channel.output - fit.shown
    if fit.parameters.has_relays and channel.basis.plane.count > channel.rows.size:
        used = used & channel.fitted  # between these a film with a column for each is off by more than noise
    noise = noise_of(residual, channel.output, used, channel.fitted, least_dec, coloured=coloured)
    if unsure is None or noise.colour is not None:
        return noise
    if not isinstance(unsure, PathError):
        return noise.with_floor(unsure * steepness(channel, fit))
    return _beside_the_path(channel, residual, seen_path(channel, fit, unsure), least_dec)


def _beside_the_path(channel: ResistanceChannel, residual: Array, seen: SeenPathError, least_dec: float) -> NoiseModel:
    """Of an ohmmeter alone, from rows in which the path's error does not show, and that error: as the readings' own
    scatter has it, with a rough part besides where the film, the better thermometer, shows one."""
    used, rows, output = channel.record.output_used, channel.rows, channel.output

    def likelihood(model: NoiseModel) -> float:
        return _log_likelihood(model, residual[rows], rows, output[rows])

    most = seen.per_K * seen.path.noise_K
    found = noise_where_little_lies(most[rows][1:-1] ** 2, residual[rows])
    quiet, own = used & (most < found), NoiseModel.white(max(found, least_dec))
    if np.sum(quiet & channel.fitted) >= FEWEST_SHOWN:
        own = noise_of(residual, output, quiet, quiet & channel.fitted, least_dec)
    shows = channel.fitted & (most > own.at(output))
    if np.sum(shows) < FEWEST_SHOWN:
        return _with_path(own, seen, output, used)
    rougher = seen.rougher(*_rough(own, seen, residual[rows], rows, output[rows]))
    return max((_with_path(own, each, output, used) for each in (seen, rougher)), key=likelihood)


def _with_path(own: NoiseModel, seen: SeenPathError, output: Array, used: Mask) -> NoiseModel:
    """used: rows with a reading, (rows,)."""
    return replace(own, path=seen, wanders=by_reading(output[used], seen.deviation[used]))


def _log_likelihood(model: NoiseModel, residual: Array, rows: Rows, readings: Array) -> float:
    """Of a residual in some rows, (rows,)."""
    whitening = model.on(rows, readings)
    assert isinstance(whitening, WhiteningOfTurns)
    return whitening.log_likelihood(residual)


def _rough(own: NoiseModel, seen: SeenPathError, residual: Array, rows: Rows, readings: Array) -> tuple[float, float]:
    """How much a path is off by besides, K, and the correlation of that from row to row: the likeliest of a residual in
    some rows, (rows,)."""

    def minus(x: Array) -> float:
        return -_log_likelihood(replace(own, path=seen.rougher(math.exp(x[0]), x[1])), residual, rows, readings)

    most = math.log(MOST_ROUGH * seen.path.noise_K)
    bounds = [(math.log(LEAST_K), most), (0.0, MOST_TOGETHER)]
    found = minimize(minus, np.array([most - 1.0, 0.5]), method="Nelder-Mead", bounds=bounds, options=ROUGH_TO)
    return math.exp(float(found.x[0])), float(found.x[1])

"""The noise of both instruments, as what a fit leaves shows it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from compensator.hysteresis.functions import KELVIN, Array
from sim.diagnosis.data.likelihood import lattice_noise, quick_noise
from sim.diagnosis.data.noise_estimate import noise_of
from sim.diagnosis.data.noise_model import NoiseModel, root_mean_square
from sim.diagnosis.data.unlogged_walk import noise_beside, unlogged_walk
from sim.diagnosis.data.wandering import Wandering
from sim.diagnosis.fit.resistance_channel import ResistanceChannel
from sim.diagnosis.fit.resistance_fit import ResistanceFit
from sim.diagnosis.fit.temperature_channel import TemperatureChannel, TemperatureFit

DITHERED = 2.0  # steps of quantization over the noise, below which the noise spreads rounding evenly over the rows
NO_MISFIT = 1.1  # of what changes from row to row, what is left at all where the fit leaves nothing but noise
STEEPNESS_ROWS = 15  # about a row
LEAST_MOVED_K = 0.01  # over them: a plate that stands tells no slope


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
    channel: ResistanceChannel, fit: ResistanceFit, least_dec: float, path_K: float, coloured: bool = False
) -> NoiseModel:
    """Of the ohmmeter. Where it is not the same everywhere it may be far below what the path is uncertain by (path_K)
    on a flank: a film is no better a thermometer than the plate's own, until both channels are fitted as one."""
    used, residual = channel.record.output_used, channel.output - fit.shown
    noise = noise_of(residual, channel.output, used, channel.fitted, least_dec, coloured=coloured)
    return noise.with_floor(path_K * steepness(channel, fit))


def steepness(channel: ResistanceChannel, fit: ResistanceFit) -> Array:
    """By how much what is shown changes with the plate's temperature about each row, decades / K, (rows,)."""
    around = np.ones(STEEPNESS_ROWS)
    moved = np.abs(np.gradient(channel.path.at(channel.record.time_s)))
    shown = np.abs(np.gradient(fit.shown))
    per = np.convolve(shown, around, "same") / np.maximum(np.convolve(moved, around, "same"), LEAST_MOVED_K)
    return np.asarray(per, dtype=np.float64)

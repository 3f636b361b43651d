"""The plate's temperature for the film: the simulated one, and what the simulation is slowly off by.

A model of the plate that is right needs no correction. Where something is left, the residual of the thermometer is
smoothed over the time that predicts left-out readings best (generalized cross-validation: P. Craven, G. Wahba, Numer.
Math. 31 (1979) 377), so that a fault of the plate's model does not become one of the film.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.path_error import PathError
from sim.diagnosis.data.record import Record
from sim.inference.readings.temperature_path import TemperaturePath, temperature_path
from sim.model.plate_path import PlatePath

WIDTHS_ROWS = (2.0, 5.0, 15.0, 50.0, 150.0, 500.0)  # standard deviation of the kernel
MOST_KEPT = 0.9  # of the value itself: a kernel as short as the noise hangs together tells nothing
MOST_TURNS = 60  # whose errors are followed, each by two simulations
WORTH = 12.0  # log-likelihood that a correction has to bring


def corrected_path(
    record: Record, path: PlatePath, residual_K: Array, rows: NDArray[np.int64], correlation: float = 0.0
) -> PlatePath:
    """A simulated path with the slow part of the residual added. residual_K: in the rows, (rows,); correlation: of the
    thermometer's noise from row to row, of which the neighbours' readings tell as they tell of the path."""
    if rows.size < 50:  # too few to tell of a misfit that is slow beside them
        return path
    residual = np.interp(np.arange(record.rows), rows, residual_K)
    residual = np.clip(residual, *np.percentile(residual, [0.2, 99.8]))  # what went astray bends no path
    n = residual.size * (1.0 - correlation) / (1.0 + correlation)  # as many independent readings tell as much
    none = n * math.log(float(np.mean(residual**2)) + 1e-30)  # of a simulated record the residual is 0
    best, correction = none - 2.0 * WORTH, None
    for width in WIDTHS_ROWS:
        smooth, keep = _smooth(residual, width, correlation)
        left = float(np.mean(((residual - smooth) / (1.0 - keep)) ** 2))
        value = n * math.log(left + 1e-30)  # as above
        if value < best:
            best, correction = value, smooth
    if correction is None:
        return path
    return moved_path(record, path, correction)


def moved_path(record: Record, path: PlatePath, correction: Array) -> PlatePath:
    """With what is added in each row, K, (rows,)."""
    added = np.interp(path.time_s, record.time_s, correction)
    slope = np.gradient(correction, record.time_s)
    slopes = path.slopes + np.interp(path.time_s, record.time_s, slope)[:, None]
    return PlatePath(path.time_s, path.plate_degC + added, slopes, path.turning_s)


def _smooth(values: Array, width: float, correlation: float) -> tuple[Array, float]:
    """A local line under a Gaussian kernel of this width (rows), and the weight of the value itself, with what its
    noise has in common with its neighbours'."""
    reach = int(4 * width) + 1  # 6e-5 of the kernel is beyond
    offset = np.arange(-reach, reach + 1, dtype=np.float64)
    kernel = np.exp(-0.5 * (offset / width) ** 2)
    one = np.ones(values.size)
    s0 = np.convolve(one, kernel, "same") if reach * 2 + 1 <= values.size else np.full(values.size, kernel.sum())
    if reach * 2 + 1 > values.size:
        return np.full(values.size, float(np.mean(values))), 1.0 / values.size
    s1 = np.convolve(one, -offset * kernel, "same")
    s2 = np.convolve(one, offset**2 * kernel, "same")
    t0 = np.convolve(values, kernel, "same")
    t1 = np.convolve(values, -offset * kernel, "same")
    smooth = (s2 * t0 - s1 * t1) / (s0 * s2 - s1 * s1)
    kept = float(np.sum(kernel * np.where(offset == 0.0, 1.0, correlation ** np.abs(offset))))
    return np.asarray(smooth, dtype=np.float64), min(kept / float(kernel.sum()), MOST_KEPT)


def measured_path(record: Record) -> PlatePath:
    """The path behind the thermometer's readings, where the record has no current."""
    return straight_path(record.time_s, np.asarray(_behind(record).temperature_degC, dtype=np.float64))


def measured_path_error(record: Record) -> PathError | None:
    """What that path is off by; None where the readings are taken as they are."""
    found = _behind(record)
    if found.density is None:
        return None
    read = record.temperature_used.copy()
    read[found.outliers] = False
    return PathError.of(record.time_s, read, found.density, found.noise_K, _largest_turns(found))


def _largest_turns(path: TemperaturePath) -> NDArray[np.int64]:
    """The rows of those turns whose smaller swing is largest: a film remembers them longest."""
    swing_K = np.abs(np.diff(path.temperature_degC[path.turning]))
    smaller_K = np.minimum(swing_K[:-1], swing_K[1:])
    return np.sort(path.turning[1:-1][np.argsort(-smaller_K, kind="stable")[:MOST_TURNS]])


def _behind(record: Record) -> TemperaturePath:
    """The smoother's path behind the readings that count."""
    return temperature_path(record.time_s, np.where(record.temperature_used, record.temperature_degC, np.nan))


def straight_path(time_s: Array, degC: Array) -> PlatePath:
    """A path that is straight between its nodes, (nodes,)."""
    slope = np.diff(degC) / np.diff(time_s)
    return PlatePath(time_s, degC, np.column_stack((np.append(slope, slope[-1]), np.insert(slope, 0, slope[0]))))

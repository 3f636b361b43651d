"""Noise as real instruments have it: it hangs together from row to row, has heavy tails, goes with the range; rounded.

The ohmmeter has ranges of a decade, each with a noise of its own: a share of the reading, and one of the range's full
scale, so that it grows towards the range's lower end. Both instruments' noise is an autoregression of first order whose
innovations are Student's t with 4 degrees, and both show so many digits and no more. Noise of another colour is normal
and the same at all readings: white with 1/f noise, a mean over the last few rows, or behind two poles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.signal import lfilter

from tests.sim.diagnosis.truth.readings import rounded
from tests.sim.diagnosis.truth.rig import Rig, Schedule, simulate

Array = NDArray[np.float64]
DEGREES = 4.0
CORRELATION = (0.5, 0.85)
SHARE = ((6e-4, 4e-3), (2e-5, 2e-4))  # of the reading: on the range of 100 ohm, and of 1 Mohm; between them alike
BESIDES = 0.5  # logarithm of what a range is off that, at most
OF_FULL_SCALE = 0.1  # the other part, of the share
DIGITS = 2e5  # counts of a range
COLOURS = ("flicker", "moving_mean", "two_poles")
FLICKER = (0.3, 1.0)  # of the deviation of noise that is white besides
MEAN_OVER = (2, 6)  # rows
POLE = (0.3, 0.7)
STEPS_K = (0.0, 0.001, 0.01)  # last digits of a thermometer


@dataclass(frozen=True)
class Thermometer:
    """deviation_K: of its noise; correlation: of neighbouring rows; step_K: its last digit, 0 for none."""

    deviation_K: float
    correlation: float
    step_K: float


@dataclass(frozen=True, eq=False)
class Meter:
    """full_ohm: of its ranges, rising; share: the noise over the reading on each; correlation: of neighbouring rows."""

    full_ohm: Array
    share: Array
    correlation: float


def drawn_instruments(rng: np.random.Generator, deviation_K: float) -> tuple[Thermometer, Meter]:
    """Both of them."""
    thermometer = Thermometer(deviation_K, rng.uniform(*CORRELATION), float(rng.choice(STEPS_K)))
    full = rng.uniform(1.0, 10.0) * 10.0 ** np.arange(-1.0, 9.0)
    low, high = (rng.uniform(*np.log(ends)) for ends in SHARE)
    place = np.clip((np.log10(full) - 2.0) / 4.0, 0.0, 1.0)
    share = np.exp(low + (high - low) * place + rng.uniform(-BESIDES, BESIDES, full.size))
    return thermometer, Meter(full, share, rng.uniform(*CORRELATION))


def hanging_together(rng: np.random.Generator, rows: int, correlation: float) -> Array:
    """An autoregression of variance 1 with heavy tails, (rows,)."""
    before = 200
    innovations = rng.standard_t(DEGREES, rows + before) * np.sqrt((DEGREES - 2.0) / DEGREES)
    innovations *= np.sqrt(1.0 - correlation**2)
    return np.asarray(lfilter([1.0], [1.0, -correlation], innovations)[before:])


def coloured(rng: np.random.Generator, rows: int, colour: str) -> Array:
    """Noise of variance 1 and of this colour, (rows,)."""
    before = 200
    white = rng.standard_normal(rows + before)
    if colour == "flicker":
        f = np.fft.rfftfreq(white.size)
        f[0] = f[1]
        slow = np.fft.irfft(np.fft.rfft(rng.standard_normal(white.size)) / np.sqrt(f), white.size)
        share = rng.uniform(*FLICKER)
        out = share * slow / np.std(slow) + np.sqrt(1.0 - share**2) * white
    elif colour == "moving_mean":
        out = lfilter(np.ones(int(rng.integers(*MEAN_OVER, endpoint=True))), [1.0], white)
    else:
        pole = rng.uniform(*POLE)
        out = lfilter([1.0], [1.0, -2.0 * pole, pole**2], white)
    return np.asarray(out[before:] / np.std(out[before:]))


def coloured_record(rig: Rig, schedule: Schedule, rng: np.random.Generator, colour: str) -> dict[str, Array]:
    """The columns of a record whose instruments' noise has this colour."""
    rows = schedule.time.size
    noise_K = rig.noise_K * coloured(rng, rows, colour)
    clean = simulate(rig, schedule, noise_K)
    return {
        "time_s": schedule.time.copy(),
        "temperature_degC": rounded(clean.temperature + noise_K, rig.get("thermometer_quantization", "step_K")),
        "resistance_ohm": 10.0 ** (clean.log_ohm + rig.noise_dec * coloured(rng, rows, colour)),
        "current_A": clean.current.copy(),
        "meter_current_A": schedule.meter_A.copy(),
    }


def record_of(
    rig: Rig, schedule: Schedule, rng: np.random.Generator, thermometer: Thermometer, meter: Meter
) -> dict[str, Array]:
    """The columns of a record with these instruments; a rounding that is hidden in the rig is the thermometer's."""
    rows = schedule.time.size
    noise_K = thermometer.deviation_K * hanging_together(rng, rows, thermometer.correlation)
    clean = simulate(rig, schedule, noise_K)
    ohm = 10.0**clean.log_ohm
    place = np.minimum(np.searchsorted(meter.full_ohm, ohm), meter.full_ohm.size - 1)
    full, share = meter.full_ohm[place], meter.share[place]
    deviation_ohm = share * np.hypot(ohm, OF_FULL_SCALE * full)
    ohm = ohm + deviation_ohm * hanging_together(rng, rows, meter.correlation)
    step = full / DIGITS
    step_K = rig.get("thermometer_quantization", "step_K", thermometer.step_K)
    return {
        "time_s": schedule.time.copy(),
        "temperature_degC": rounded(clean.temperature + noise_K, step_K),
        "resistance_ohm": step * np.maximum(np.round(ohm / step), 1.0),
        "current_A": clean.current.copy(),
        "meter_current_A": schedule.meter_A.copy(),
    }

"""What the law takes for the plate's temperature and for the error of the film model, out of noisy readings.

temperature   the plate model's prediction and a heating rate d that it does not know of, corrected by the reading: a
              Kalman filter of (thermometer s, plate p, d), the thermometer behind the plate by its lag tau
                  p' = p + h d,   s' = s + a (p - s) + (h - tau a) d,   d' = d + h w,   a = 1 - exp(-h / tau)
              w: white, `UNSTEADY_K_PER_S2`. Without a lag s is p, and the gains settle at those of the alpha-beta
              filter: P. R. Kalata, IEEE Trans. Aerosp. Electron. Syst. AES-20 (1984) 174, eqs (14), (17)
disturbance   reading minus film model, as a Kalman filter knows it: the film model's error is a random walk along the
              course of the output (a film that stands still does not change its model's error, one that moves by
              `LENGTH` changes it by about `model_error`) and creeps a little in time
model error   from how much the disturbance has changed over each `LENGTH` of the course, less what is noise of it
noise         of both readings, from their second differences: white noise on a smooth course

So nothing of this has to be set: a model that is exact is believed more and more, and one that is off is followed.
Every function takes an estimate and returns the next one; none is changed.
"""

from __future__ import annotations

import math
from math import nan
from typing import Final, NamedTuple

from numba import njit

UNSTEADY_K_PER_S2: Final = 0.003  # of unknown heat, a sink, a draught: from 0.001 to 0.03 hardly anything changes
LENGTH: Final = 0.05  # of the output's course, in its unit: about a fifth of the width of one operator of a film
CREEP_PER_ROOT_S: Final = 3e-5  # 0.0002 in a minute, 0.002 in an hour: a film that drifts by 0.01 K an hour
FEW, MANY = 3.0, 20.0  # lengths that the first guess of the model error counts for, and that count at most
LEAST_ERROR: Final = 1e-4
NOISE_FIRST, NOISE_MANY = 20.0, 300.0  # the same, of readings
TINY: Final = 1e-12


class Noise(NamedTuple):
    """Of one instrument: the variance of its readings, the last two of them, how many have counted."""

    variance: float
    last: float = nan
    before: float = nan
    readings: float = 0.0


class Covariance(NamedTuple):
    """Of thermometer s (K), plate p (K) and unknown heating rate d (K/s). At first the temperature is as uncertain as a
    reading, the heat by what plate models are wrong by at rest (0.02 K/s)."""

    ss: float = 1e-4
    sp: float = 1e-4
    sd: float = 0.0
    pp: float = 1e-4
    pd: float = 0.0
    dd: float = 4e-4


class Estimate(NamedTuple):
    """What is known beside the temperature and the disturbance themselves.

    drift_K_per_s: heating that the plate model does not know of. covariance: of thermometer, plate and drift. degC,
    output: the noise of the two readings. doubt: variance of the disturbance. model_error2: of the film model, along
    LENGTH. course: of the output since its mark; mark: the disturbance there; lengths: how many have come.
    """

    drift_K_per_s: float = 0.0
    covariance: Covariance = Covariance()
    degC: Noise = Noise(1e-4)
    output: Noise = Noise(4e-6)
    doubt: float = 1e-4
    model_error2: float = 9e-6
    course: float = 0.0
    mark: float = nan
    lengths: float = 0.0


@njit(cache=True)
def learned_noise(noise: Noise, value: float) -> Noise:
    """One more reading: its noise's variance from its second difference, over some hundred readings."""
    variance, readings = noise.variance, noise.readings
    if not math.isnan(noise.before):
        bend = value - 2.0 * noise.last + noise.before
        readings = min(readings + 1.0, NOISE_MANY)
        variance += (bend * bend / 6.0 - variance) / (readings + NOISE_FIRST)
    return Noise(variance, value, noise.last, readings)


@njit(cache=True)
def passed(c: Covariance, period_s: float, lag_s: float) -> Covariance:
    """The covariance a period later, before a reading."""
    h = period_s
    a = 1.0 - math.exp(-h / lag_s) if lag_s > 0.0 else 1.0
    b = h - lag_s * a
    # F P: rows s, p, d
    ss, sp = (1.0 - a) * c.ss + a * c.sp + b * c.sd, (1.0 - a) * c.sp + a * c.pp + b * c.pd
    sd = (1.0 - a) * c.sd + a * c.pd + b * c.dd
    pp, pd = c.pp + h * c.pd, c.pd + h * c.dd
    w_s, w_p, w_d = 0.5 * h * h - lag_s * b, 0.5 * h * h, h  # of a heat that changes evenly by one
    q = UNSTEADY_K_PER_S2**2
    return Covariance(
        (1.0 - a) * ss + a * sp + b * sd + q * w_s * w_s,
        sp + h * sd + q * w_s * w_p,
        sd + q * w_s * w_d,
        pp + h * pd + q * w_p * w_p,
        pd + q * w_p * w_d,
        c.dd + q * w_d * w_d,
    )


@njit(cache=True)
def corrected_temperature(
    estimate: Estimate, shown_degC: float, plate_degC: float, reading_degC: float, period_s: float, lag_s: float
) -> tuple[float, float, Estimate]:
    """(thermometer, plate, both in degC, the estimate) after a reading.

    shown_degC, plate_degC: as predicted, with the drift. lag_s: of the thermometer behind the plate.
    """
    noise = learned_noise(estimate.degC, reading_degC)
    c = passed(estimate.covariance, period_s, lag_s)
    whole = c.ss + noise.variance + TINY
    on_s, on_p, on_d = c.ss / whole, c.sp / whole, c.sd / whole
    innovation = reading_degC - shown_degC
    after = Covariance(
        c.ss - on_s * c.ss,
        c.sp - on_s * c.sp,
        c.sd - on_s * c.sd,
        c.pp - on_p * c.sp,
        c.pd - on_p * c.sd,
        c.dd - on_d * c.sd,
    )
    e = estimate
    drift = e.drift_K_per_s + on_d * innovation
    known = Estimate(drift, after, noise, e.output, e.doubt, e.model_error2, e.course, e.mark, e.lengths)
    return shown_degC + on_s * innovation, plate_degC + on_p * innovation, known


@njit(cache=True)
def grown_doubt(estimate: Estimate, moved: float, period_s: float) -> float:
    """The variance of the disturbance a period later, before a reading."""
    return estimate.doubt + 2.0 * estimate.model_error2 * abs(moved) / LENGTH + CREEP_PER_ROOT_S**2 * period_s


@njit(cache=True)
def corrected_disturbance(
    estimate: Estimate,
    disturbance: float,
    off: float,
    output: float,
    moved: float,
    period_s: float,
    most_share: float,
) -> tuple[float, Estimate]:
    """The disturbance after a reading that is `off` the film model, and the estimate.

    output: the reading itself, for its noise. moved: by how much the output was to move since the reading before.
    most_share: of `off` that one reading counts for at the most, whatever the model's error.
    """
    e = estimate
    noise = learned_noise(e.output, output)
    walked = abs(moved)
    doubt = grown_doubt(e, moved, period_s)
    share = doubt / (doubt + noise.variance + TINY)
    if share <= most_share:
        doubt *= 1.0 - share
    else:
        share = most_share
        doubt = (1.0 - share) ** 2 * doubt + share**2 * (noise.variance + TINY)  # of any share, P. D. Joseph's form
    found = disturbance + share * (off - disturbance)
    course, mark, lengths, error2 = e.course + walked, e.mark, e.lengths, e.model_error2
    if course >= LENGTH:
        if not math.isnan(mark):
            change2 = 0.5 * (found - mark) ** 2 * LENGTH / course
            error2 = max(error2 + (change2 - doubt - error2) / (min(lengths, MANY) + FEW), LEAST_ERROR**2)
            lengths += 1.0
        course, mark = 0.0, found
    return found, Estimate(e.drift_K_per_s, e.covariance, e.degC, noise, doubt, error2, course, mark, lengths)

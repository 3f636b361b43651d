"""What the law takes for the plate's temperature, out of noisy readings, on a plate whose heat is not all known.

The plate model's prediction and a heating rate d that it does not know of, corrected by the reading: a Kalman filter of
(thermometer s, plate p, d), the thermometer behind the plate by its lag tau

    p' = p + h d,   s' = s + a (p - s) + (h - tau a) d,   d' = d + h w,   a = 1 - exp(-h / tau)

w is white: of a sink that warms up, a draught, a plate that the model has wrong. How large it is nobody knows: next to
nothing on a calibrated plate, where each reading that is believed makes the film tremble. So sizes are supposed, each
a filter of its own, weighed by how well it foretells the readings (D. T. Magill, IEEE Trans. Autom. Control AC-10
(1965) 434), and what is told is their mean. Larger sizes than these follow a plate that is off by a fifth still better,
and one whose thermometer is behind it, which nobody knows, worse: they take the lag for heat. A filter of one size
settles without a lag at the gains of the alpha-beta filter (P. R. Kalata, IEEE Trans. Aerosp. Electron. Syst. AES-20
(1984) 174, eqs (14), (17)).

    heats    a row for each size: the numbers of `Heat`, shape (sizes, HEAT)
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from compensator.control.estimate import TINY, Estimate, learned_noise, less_likely
from compensator.control.packing import flattener, packed, unpacked
from compensator.hysteresis.functions import Array

UNSTEADY_K_PER_S2: Final = 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3  # w, of an exact plate, to one that is off by a fifth
REMEMBERED_S: Final = 30.0  # of how well each foretold: a draught comes and goes


class Covariance(NamedTuple):
    """Of thermometer s (K), plate p (K) and unknown heating rate d (K/s). At first the temperature is as uncertain as a
    reading, the heat by what plate models are wrong by at rest (0.02 K/s)."""

    ss: float = 1e-4
    sp: float = 1e-4
    sd: float = 0.0
    pp: float = 1e-4
    pd: float = 0.0
    dd: float = 4e-4


class Heat(NamedTuple):
    """One filter: unsteady_K_per_s2: its w; thermometer_K, plate_K, drift_K_per_s: what it says over what is told;
    log_weight: of its likelihood."""

    unsteady_K_per_s2: float
    thermometer_K: float = 0.0
    plate_K: float = 0.0
    drift_K_per_s: float = 0.0
    covariance: Covariance = Covariance()
    log_weight: float = 0.0


HEAT: Final = len(flattener(Heat)(Heat(0.0)))  # numbers of one
WEIGHT: Final = HEAT - 1


def unknown_heats(sizes_K_per_s2: tuple[float, ...] = UNSTEADY_K_PER_S2) -> Array:
    """Before any reading."""
    heats = np.array([flattener(Heat)(Heat(size)) for size in sizes_K_per_s2])
    heats.setflags(write=False)
    return heats


@njit(cache=True)
def passed(heat: Heat, period_s: float, lag_s: float) -> Heat:
    """A period later, before a reading."""
    h, c = period_s, heat.covariance
    a = 1.0 - math.exp(-h / lag_s) if lag_s > 0.0 else 1.0
    b = h - lag_s * a
    # F P: rows s, p, d
    ss, sp = (1.0 - a) * c.ss + a * c.sp + b * c.sd, (1.0 - a) * c.sp + a * c.pp + b * c.pd
    sd = (1.0 - a) * c.sd + a * c.pd + b * c.dd
    pp, pd = c.pp + h * c.pd, c.pd + h * c.dd
    w_s, w_p, w_d = 0.5 * h * h - lag_s * b, 0.5 * h * h, h  # of a heat that changes evenly by one
    q = heat.unsteady_K_per_s2**2
    later = Covariance(
        (1.0 - a) * ss + a * sp + b * sd + q * w_s * w_s,
        sp + h * sd + q * w_s * w_p,
        sd + q * w_s * w_d,
        pp + h * pd + q * w_p * w_p,
        pd + q * w_p * w_d,
        c.dd + q * w_d * w_d,
    )
    s, p, d = heat.thermometer_K, heat.plate_K, heat.drift_K_per_s
    weight = heat.log_weight * math.exp(-h / REMEMBERED_S)
    return Heat(heat.unsteady_K_per_s2, s + a * (p - s) + b * d, p + h * d, d, later, weight)


@njit(cache=True)
def corrected(heat: Heat, off_K: float, variance_K2: float) -> Heat:
    """After a reading that is off what was told, with noise of that variance."""
    c = heat.covariance
    whole = c.ss + variance_K2 + TINY
    on_s, on_p, on_d = c.ss / whole, c.sp / whole, c.sd / whole
    innovation = off_K - heat.thermometer_K
    after = Covariance(
        c.ss - on_s * c.ss,
        c.sp - on_s * c.sp,
        c.sd - on_s * c.sd,
        c.pp - on_p * c.sp,
        c.pd - on_p * c.sd,
        c.dd - on_d * c.sd,
    )
    return Heat(
        heat.unsteady_K_per_s2,
        heat.thermometer_K + on_s * innovation,
        heat.plate_K + on_p * innovation,
        heat.drift_K_per_s + on_d * innovation,
        after,
        less_likely(heat.log_weight, innovation, whole),
    )


@njit(cache=True)
def corrected_temperature(
    estimate: Estimate,
    heats: Array,
    shown_degC: float,
    plate_degC: float,
    reading_degC: float,
    period_s: float,
    lag_s: float,
) -> tuple[float, float, Estimate, Array]:
    """(thermometer, plate, both in degC, the estimate, heats) after a reading.

    shown_degC, plate_degC: as predicted, with the drift. lag_s: of the thermometer behind the plate.
    """
    noise = learned_noise(estimate.degC, reading_degC)
    after = np.empty_like(heats)
    for k in range(after.shape[0]):
        one = corrected(passed(unpacked(heats[k], Heat), period_s, lag_s), reading_degC - shown_degC, noise.variance)
        after[k] = packed(one, HEAT)
    after[:, WEIGHT] -= np.max(after[:, WEIGHT])
    weights = np.exp(after[:, WEIGHT])
    weights /= np.sum(weights)
    told = np.zeros(3)
    for k in range(after.shape[0]):
        told += weights[k] * after[k, 1:4]
    after[:, 1:4] -= told
    known = Estimate(estimate.drift_K_per_s + told[2], noise, estimate.output)
    return shown_degC + told[0], plate_degC + told[1], known, after

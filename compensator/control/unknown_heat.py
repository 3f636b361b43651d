"""What the law takes for the plate's temperature, out of noisy readings, where its model lacks something.

The plate model's prediction, with a heating rate d that it does not know of, corrected by the reading: a Kalman filter
of (thermometer s, plate p, d), the thermometer behind the plate by a lag L

    p' = p + h d,   s' = s + a (p - s) + (h - L a) d,   d' = d + h w,   a = 1 - exp(-h / L)

w is white: of a sink that warms up, a draught, a plate that the model has wrong. How large it is nobody knows: next to
nothing on a calibrated plate, where each reading that is believed makes the film tremble. Nor is L known: a thermometer
glued beside the plate is seconds behind, and who takes that for heat swings. So sizes and lags are supposed, each pair
a filter of its own, weighed by how well it foretells the readings (D. T. Magill, IEEE Trans. Autom. Control AC-10
(1965) 434), and what is told is their mean. What is known of a size fades, as a draught comes and goes; what is known
of a lag does not. A filter of one size settles without a lag at the gains of the alpha-beta filter (P. R. Kalata, IEEE
Trans. Aerosp. Electron. Syst. AES-20 (1984) 174, eqs (14), (17)).

Every s, p and d is over what the law takes for it. So a filter that supposes more lag than the model has (l) is driven
by how the plate moved, M, and by how far its thermometer was behind, B, of which the model lets the thermometer move S

    s' = ... + a B + (h - L a) M / h - S        L > l; a lag of the model's or less changes nothing

    heats    a row for each pair, those of a lag together: the numbers of `Heat`, shape (lags * sizes, HEAT)
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
LAGS_S: Final = 0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6  # by the root of 2: none is off by more than a fifth
REMEMBERED_S: Final = 30.0  # of how well each size foretold


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
    """One filter: unsteady_K_per_s2: its w; lag_s: its L, where the model's is not longer; thermometer_K, plate_K,
    drift_K_per_s: what it says over what is told; log_weight: of its likelihood."""

    unsteady_K_per_s2: float
    lag_s: float = 0.0
    thermometer_K: float = 0.0
    plate_K: float = 0.0
    drift_K_per_s: float = 0.0
    covariance: Covariance = Covariance()
    log_weight: float = 0.0


HEAT: Final = len(flattener(Heat)(Heat(0.0)))  # numbers of one
LAG: Final = Heat._fields.index("lag_s")
OVER: Final = Heat._fields.index("thermometer_K")  # the first of the three that are over what is told
WEIGHT: Final = HEAT - 1
LEAST_LIKELY: Final = 1e-300  # so that a lag that is out of the question has a logarithm


def unknown_heats(sizes_K_per_s2: tuple[float, ...] = UNSTEADY_K_PER_S2, lags_s: tuple[float, ...] = LAGS_S) -> Array:
    """Before any reading."""
    heats = np.array([flattener(Heat)(Heat(size, lag)) for lag in lags_s for size in sizes_K_per_s2])
    heats.setflags(write=False)
    return heats


class Foretold(NamedTuple):
    """What the plate model, with the drift as told, foretells from what was told a period before (degC)."""

    shown_degC: float
    plate_degC: float
    shown_before_degC: float
    plate_before_degC: float


class Passage(NamedTuple):
    """A period h of a filter with one lag: a, h - L a, and what the thermometer moves by beside what is foretold (K);
    shown_s2, plate_s2: how far both get by a heat that grows evenly by one."""

    period_s: float
    taken: float
    late_s: float
    forced_K: float
    shown_s2: float
    plate_s2: float


@njit(cache=True)
def passage(lag_s: float, known_lag_s: float, period_s: float, told: Foretold) -> Passage:
    """Of a filter that supposes that lag, where the model has known_lag_s."""
    h, lag = period_s, max(lag_s, known_lag_s)
    a = 1.0 - math.exp(-h / lag) if lag > 0.0 else 1.0
    b, forced = h - lag * a, 0.0
    if lag > known_lag_s:
        behind, moved = told.plate_before_degC - told.shown_before_degC, told.plate_degC - told.plate_before_degC
        forced = a * behind + b * moved / h - (told.shown_degC - told.shown_before_degC)
    return Passage(h, a, b, forced, 0.5 * h * h - lag * b, 0.5 * h * h)


@njit(cache=True)
def passed(heat: Heat, by: Passage) -> Heat:
    """A period later, before a reading."""
    h, a, b, c = by.period_s, by.taken, by.late_s, heat.covariance
    # F P: rows s, p, d
    ss, sp = (1.0 - a) * c.ss + a * c.sp + b * c.sd, (1.0 - a) * c.sp + a * c.pp + b * c.pd
    sd = (1.0 - a) * c.sd + a * c.pd + b * c.dd
    pp, pd = c.pp + h * c.pd, c.pd + h * c.dd
    q, w_s, w_p = heat.unsteady_K_per_s2**2, by.shown_s2, by.plate_s2
    later = Covariance(
        (1.0 - a) * ss + a * sp + b * sd + q * w_s * w_s,
        sp + h * sd + q * w_s * w_p,
        sd + q * w_s * h,
        pp + h * pd + q * w_p * w_p,
        pd + q * w_p * h,
        c.dd + q * h * h,
    )
    s, p, d = heat.thermometer_K, heat.plate_K, heat.drift_K_per_s
    shown = s + a * (p - s) + b * d + by.forced_K
    return Heat(heat.unsteady_K_per_s2, heat.lag_s, shown, p + h * d, d, later, heat.log_weight)


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
        heat.lag_s,
        heat.thermometer_K + on_s * innovation,
        heat.plate_K + on_p * innovation,
        heat.drift_K_per_s + on_d * innovation,
        after,
        less_likely(heat.log_weight, innovation, whole),
    )


@njit(cache=True)
def weighed(heats: Array, period_s: float) -> Array:
    """How likely each filter is, shape (lags * sizes,); the weights of a lag's sizes are then faded, in heats, without
    the lag's own weight changing."""
    count, best, total = heats.shape[0], -math.inf, 0.0
    likely = np.empty(count)
    for k in range(count):
        best = max(best, heats[k, WEIGHT])
    for k in range(count):
        likely[k] = math.exp(heats[k, WEIGHT] - best)
        total += likely[k]
    kept, first = math.exp(-period_s / REMEMBERED_S), 0
    while first < count:
        last, best, whole, faded = first, -math.inf, 0.0, 0.0
        while last < count and heats[last, LAG] == heats[first, LAG]:
            best = max(best, heats[last, WEIGHT])
            likely[last] /= total
            whole += likely[last]
            last += 1
        for k in range(first, last):
            heats[k, WEIGHT] = kept * (heats[k, WEIGHT] - best)
            faded += math.exp(heats[k, WEIGHT])
        for k in range(first, last):
            heats[k, WEIGHT] += math.log((whole + LEAST_LIKELY) / faded)
        first = last
    return likely


@njit(cache=True)
def corrected_temperature(
    estimate: Estimate,
    heats: Array,
    told: Foretold,
    reading_degC: float,
    period_s: float,
    acts_after_s: float,
    lag_s: float,
) -> tuple[float, float, Estimate, Array]:
    """(thermometer, plate, both in degC, the estimate, heats) after a reading that was taken acts_after_s before the
    moment that is told. lag_s: of the thermometer behind the plate, as the model has it."""
    noise = learned_noise(estimate.degC, reading_degC, period_s)
    after = np.empty_like(heats)
    by = passage(-1.0, lag_s, period_s, told)
    for k in range(after.shape[0]):
        before = unpacked(heats[k], Heat)
        if k == 0 or before.lag_s != heats[k - 1, LAG]:
            by = passage(before.lag_s, lag_s, period_s, told)
        now = passed(before, by)
        moved = told.shown_degC - told.shown_before_degC + now.thermometer_K - before.thermometer_K
        since_K = moved * acts_after_s / period_s
        row = packed(corrected(now, reading_degC + since_K - told.shown_degC, noise.variance), HEAT)
        for j in range(HEAT):  # a whole row at once would compile numpy's broadcasting, 8 s
            after[k, j] = row[j]
    likely, s, p, d = weighed(after, period_s), 0.0, 0.0, 0.0
    for k in range(likely.size):
        s += likely[k] * after[k, OVER]
        p += likely[k] * after[k, OVER + 1]
        d += likely[k] * after[k, OVER + 2]
    for k in range(likely.size):
        after[k, OVER] -= s
        after[k, OVER + 1] -= p
        after[k, OVER + 2] -= d
    known = Estimate(estimate.drift_K_per_s + d, noise, estimate.output)
    return told.shown_degC + s, told.plate_degC + p, known, after

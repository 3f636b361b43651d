"""What the law takes for the plate's temperature, out of noisy readings, where its model lacks something.

The plate model's prediction, with a heating rate d that it does not know of and a drive that heats by a share e more
than it says, corrected by the reading: a Kalman filter of (thermometer s, plate p, d, e), the thermometer behind the
plate by a lag L

    p' = p + h (d + u e),   s' = s + a (p - s) + (h - L a) (d + u e),   d' = d + h w,   e' = e,   a = 1 - exp(-h / L)

u is what the drive gives (K/s): a module that moves less heat than its model errs by as much each time that the current
changes, and who takes that for heat that comes and goes is late each time. w is white: of a sink that warms up, a
draught, a plate that the model has wrong. How large it is nobody knows: next to nothing on a calibrated plate, where
each reading that is believed makes the film tremble. Nor is L known: a thermometer
glued beside the plate is seconds behind, and who takes that for heat swings. So sizes and lags are supposed, each pair
a filter of its own, weighed by how well it foretells the readings (D. T. Magill, IEEE Trans. Autom. Control AC-10
(1965) 434), and what is told is their mean. What is known of a size fades, as a draught comes and goes; what is known
of a lag does not. A filter of one size settles without a lag at the gains of the alpha-beta filter (P. R. Kalata, IEEE
Trans. Aerosp. Electron. Syst. AES-20 (1984) 174, eqs (14), (17)).

Every s, p, d and e is over what the law takes for it. So a filter that supposes more lag than the model has (l) is
driven by how the plate moved, M, and by how far its thermometer was behind, B, of which the model lets the thermometer
move S

    s' = ... + a B + (h - L a) M / h - S        L > l; a lag of the model's or less changes nothing

    heats    a row for each pair, those of a lag together: the numbers of `Heat`, shape (lags * sizes, HEAT)
"""

from __future__ import annotations

import math
from typing import Final, NamedTuple

import numpy as np

from compensator.compiled import njit
from compensator.control.estimate import TINY, Estimate, learned_noise, less_likely
from compensator.control.packing import flattener, stored, unpacked
from compensator.hysteresis.functions import Array

UNSTEADY_K_PER_S2: Final = 1e-5, 3e-5, 1e-4, 3e-4, 1e-3, 3e-3  # w, of an exact plate, to one that is off by a fifth
LAGS_S: Final = 0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6  # by the root of 2: none is off by more than a fifth
REMEMBERED_S: Final = 30.0  # of how well each size foretold
DRIVE_DOUBT: Final = 0.05  # before any reading. A fifth is learned as fast, and 0.2 takes a lag for a drive at first
LARGEST_DRIVE_ERROR: Final = 0.5  # that is told: a plate whose drive does half of it has another fault, and is watched


class Covariance(NamedTuple):
    """Of thermometer s (K), plate p (K), unknown heating rate d (K/s) and the drive's share e. At first the temperature
    is as uncertain as a reading, the heat by what plate models are wrong by at rest (0.02 K/s)."""

    ss: float = 1e-4
    sp: float = 1e-4
    sd: float = 0.0
    pp: float = 1e-4
    pd: float = 0.0
    dd: float = 4e-4
    se: float = 0.0
    pe: float = 0.0
    de: float = 0.0
    ee: float = DRIVE_DOUBT**2


class Heat(NamedTuple):
    """One filter: unsteady_K_per_s2: its w; lag_s: its L, where the model's is not longer; thermometer_K, plate_K,
    drift_K_per_s, drive_error: what it says over what is told; log_weight: of its likelihood."""

    unsteady_K_per_s2: float
    lag_s: float = 0.0
    thermometer_K: float = 0.0
    plate_K: float = 0.0
    drift_K_per_s: float = 0.0
    drive_error: float = 0.0
    covariance: Covariance = Covariance()
    log_weight: float = 0.0


HEAT: Final = len(flattener(Heat)(Heat(0.0)))  # numbers of one
LAG: Final = Heat._fields.index("lag_s")
OVER: Final = Heat._fields.index("thermometer_K")  # the first of the four that are over what is told
WEIGHT: Final = HEAT - 1
LEAST_LIKELY: Final = 1e-300  # so that a lag that is out of the question has a logarithm


def unknown_heats(
    sizes_K_per_s2: tuple[float, ...] = UNSTEADY_K_PER_S2,
    lags_s: tuple[float, ...] = LAGS_S,
    drive_doubt: float = DRIVE_DOUBT,
) -> Array:
    """Before any reading. drive_doubt: of the drive's share, one standard deviation."""
    doubt = Covariance(ee=drive_doubt**2)
    each = [Heat(size, lag, covariance=doubt) for lag in lags_s for size in sizes_K_per_s2]
    heats = np.array([flattener(Heat)(heat) for heat in each])
    heats.setflags(write=False)
    return heats


class Foretold(NamedTuple):
    """What the plate model, with drift and drive as told, foretells from what was told a period before (degC).
    driven_K_per_s: what the model's drive gave of it, on the average (`compensator.thermal.plate.drive_rate`)."""

    shown_degC: float
    plate_degC: float
    shown_before_degC: float
    plate_before_degC: float
    driven_K_per_s: float = 0.0


class Passage(NamedTuple):
    """A period h of a filter with one lag: a, h - L a, and what the thermometer moves by beside what is foretold (K);
    shown_s2, plate_s2: how far both get by a heat that grows evenly by one; driven_K_per_s: u."""

    period_s: float
    taken: float
    late_s: float
    forced_K: float
    shown_s2: float
    plate_s2: float
    driven_K_per_s: float


@njit
def passage(lag_s: float, known_lag_s: float, period_s: float, told: Foretold) -> Passage:
    """Of a filter that supposes that lag, where the model has known_lag_s."""
    h, lag = period_s, max(lag_s, known_lag_s)
    a = 1.0 - math.exp(-h / lag) if lag > 0.0 else 1.0
    b, forced = h - lag * a, 0.0
    if lag > known_lag_s:
        behind, moved = told.plate_before_degC - told.shown_before_degC, told.plate_degC - told.plate_before_degC
        forced = a * behind + b * moved / h - (told.shown_degC - told.shown_before_degC)
    return Passage(h, a, b, forced, 0.5 * h * h - lag * b, 0.5 * h * h, told.driven_K_per_s)


@njit
def passed(heat: Heat, by: Passage) -> Heat:
    """A period later, before a reading."""
    h, a, b, u, c = by.period_s, by.taken, by.late_s, by.driven_K_per_s, heat.covariance
    # with f = d + u e, all the heat that is unknown
    sf, pf, df, ef = c.sd + u * c.se, c.pd + u * c.pe, c.dd + u * c.de, c.de + u * c.ee
    # F P: rows s, p
    ss, sp = (1.0 - a) * c.ss + a * c.sp + b * sf, (1.0 - a) * c.sp + a * c.pp + b * pf
    sd, se = (1.0 - a) * c.sd + a * c.pd + b * df, (1.0 - a) * c.se + a * c.pe + b * ef
    pp, pd, pe = c.pp + h * pf, c.pd + h * df, c.pe + h * ef
    q, w_s, w_p = heat.unsteady_K_per_s2**2, by.shown_s2, by.plate_s2
    later = Covariance(
        (1.0 - a) * ss + a * sp + b * (sd + u * se) + q * w_s * w_s,
        sp + h * (sd + u * se) + q * w_s * w_p,
        sd + q * w_s * h,
        pp + h * (pd + u * pe) + q * w_p * w_p,
        pd + q * w_p * h,
        c.dd + q * h * h,
        se,
        pe,
        c.de,
        c.ee,
    )
    s, p, d, e = heat.thermometer_K, heat.plate_K, heat.drift_K_per_s, heat.drive_error
    f = d + u * e
    shown = s + a * (p - s) + b * f + by.forced_K
    return Heat(heat.unsteady_K_per_s2, heat.lag_s, shown, p + h * f, d, e, later, heat.log_weight)


@njit
def corrected(heat: Heat, off_K: float, variance_K2: float) -> Heat:
    """After a reading that is off what was told, with noise of that variance."""
    c = heat.covariance
    whole = c.ss + variance_K2 + TINY
    on_s, on_p, on_d, on_e = c.ss / whole, c.sp / whole, c.sd / whole, c.se / whole
    innovation = off_K - heat.thermometer_K
    after = Covariance(
        c.ss - on_s * c.ss,
        c.sp - on_s * c.sp,
        c.sd - on_s * c.sd,
        c.pp - on_p * c.sp,
        c.pd - on_p * c.sd,
        c.dd - on_d * c.sd,
        c.se - on_s * c.se,
        c.pe - on_p * c.se,
        c.de - on_d * c.se,
        c.ee - on_e * c.se,
    )
    return Heat(
        heat.unsteady_K_per_s2,
        heat.lag_s,
        heat.thermometer_K + on_s * innovation,
        heat.plate_K + on_p * innovation,
        heat.drift_K_per_s + on_d * innovation,
        heat.drive_error + on_e * innovation,
        after,
        less_likely(heat.log_weight, innovation, whole),
    )


@njit
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
        lag = math.log((whole + LEAST_LIKELY) / faded)
        for k in range(first, last):
            heats[k, WEIGHT] += lag
        first = last
    return likely


@njit
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
        stored(corrected(now, reading_degC + since_K - told.shown_degC, noise.variance), after[k])
    likely, s, p, d, e = weighed(after, period_s), 0.0, 0.0, 0.0, 0.0
    for k in range(likely.size):
        s += likely[k] * after[k, OVER]
        p += likely[k] * after[k, OVER + 1]
        d += likely[k] * after[k, OVER + 2]
        e += likely[k] * after[k, OVER + 3]
    e = min(max(estimate.drive_error + e, -LARGEST_DRIVE_ERROR), LARGEST_DRIVE_ERROR) - estimate.drive_error
    for k in range(likely.size):
        after[k, OVER] -= s
        after[k, OVER + 1] -= p
        after[k, OVER + 2] -= d
        after[k, OVER + 3] -= e
    known = Estimate(estimate.drift_K_per_s + d, estimate.drive_error + e, noise, estimate.output)
    return told.shown_degC + s, told.plate_degC + p, known, after

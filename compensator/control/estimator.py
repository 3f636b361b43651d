"""Estimates of the law from its readings: noise, the plate's temperature and unknown heat, the error of the film model.

How large the errors of the models are is unknown beforehand. So several sizes are assumed at once, each in a Kalman
filter of its own, weighted by the likelihood of the readings (D. T. Magill, IEEE Trans. Autom. Control AC-10 (1965)
434); the estimate is the weighted mean. Nothing has to be set: a model that is exact is soon trusted, and the error of
one that is not is followed.

**Noise** of both readings: from their distance to the line through the two before it, white, on a smooth course.

**Error of the film model**, reading less model: a random walk along the course of the output, because a film that
stands still does not change it. Its size E, over the output's whole range Y, is that of an exact model up to ten times
that of a film outside the model's class.

    at first    variance P = E^2
    a period    P' = P + E^2 (|moved| / Y + period / `STANDS_S`)
    a reading   innovation nu = off - value, S = P + noise;  value' = value + P / S nu;  ln weight' = ln weight -
                (ln S + nu^2 / S) / 2

    errors      rows of E, value, P and ln weight, one for each of `ERROR_SIZES`; no row if the law has no film

What a filter has learned of its size is forgotten over a course of `ERROR_MEMORY`: a film's lower half may be modelled
better than its upper one.

**Plate**: a Kalman filter of thermometer s, plate p, an unknown heating rate d, and the share e by which the drive
heats more than its model, the thermometer behind the plate by a lag L

    p' = p + h (d + u e),   s' = s + a (p - s) + (h - L a) (d + u e),   d' = d + h w,   e' = e,   a = 1 - exp(-h / L)

u is the drive's heating (K/s): a module that moves less heat than its model errs by as much at each change of the
current, and if that were taken for heat that comes and goes, the estimate would be late each time. w is white: a sink
that warms up, a draught, a wrong plate model; its size is unknown. So is L: a thermometer glued beside the plate is
seconds behind. Each pair of a size and a lag is a filter. What is known of a size fades, as a draught comes and goes;
what is known of a lag does not. A filter of one size settles without a lag at the gains of the alpha-beta filter (P. R.
Kalata, IEEE Trans. Aerosp. Electron. Syst. AES-20 (1984) 174, eqs (14), (17)).

All s, p, d and e are differences from the estimate so far. A filter with more lag than the model's l is also driven by
the plate's motion M, and by the distance B of its thermometer; the model lets the thermometer move by S

    s' = ... + a B + (h - L a) M / h - S        L > l; a lag of the model's or less changes nothing

    heats       rows of w, L, ln weight, (s, p, d, e) and their covariance, those of a lag together
"""

from __future__ import annotations

import math
from math import nan
from typing import Final, NamedTuple

import numpy as np
from scipy.optimize import minimize_scalar

from compensator.compiled import njit
from compensator.hysteresis.film import FilmModel, Packed
from compensator.hysteresis.functions import Array, lean
from compensator.hysteresis.play import advance, output_of, weighted_sum

TINY: Final = 1e-12  # of a variance: an instrument without noise
LARGEST_SQUARE: Final = 16.0  # of an innovation over its deviation that counts: an outlier says no more than 4 of them

# ---- noise ------------------------------------------------------------------------------------------

NOISE_FIRST, NOISE_MANY = 20.0, 300.0  # readings that the first guess of the noise counts for, and that count at most


class Noise(NamedTuple):
    """Noise of one instrument.

    variance: of its readings. last, before: the last two. readings: how many have counted. apart_s: time between the
    last two; ago_s: since the last.
    """

    variance: float
    last: float = nan
    before: float = nan
    readings: float = 0.0
    apart_s: float = nan
    ago_s: float = 0.0


class Estimate(NamedTuple):
    """Estimates in addition to temperature and output.

    drift_K_per_s: heating that is not in the plate model. drive_error: share by which the drive heats and cools more
    than its model. degC, output: the noise of the two readings.
    """

    drift_K_per_s: float = 0.0
    drive_error: float = 0.0
    degC: Noise = Noise(1e-4)
    output: Noise = Noise(4e-6)


@njit
def updated_noise(noise: Noise, value: float, since_s: float) -> Noise:
    """Return the noise with a reading since_s later; nan: none.

    The variance follows from the distance to the straight line through the two readings before (at even times their
    second difference), over some hundred readings.
    """
    variance, readings, ago_s = noise.variance, noise.readings, noise.ago_s + since_s
    if math.isnan(value):
        return Noise(variance, noise.last, noise.before, readings, noise.apart_s, ago_s)
    if not math.isnan(noise.before):
        ratio = ago_s / noise.apart_s
        bend = value - noise.last - ratio * (noise.last - noise.before)
        readings = min(readings + 1.0, NOISE_MANY)
        own = bend * bend / (1.0 + (1.0 + ratio) ** 2 + ratio * ratio)
        variance += (own - variance) / (readings + NOISE_FIRST)
    return Noise(variance, value, noise.last, readings, ago_s, 0.0)


@njit
def log_likelihood(innovation: float, variance: float) -> float:
    """Return the log-likelihood of an innovation with that variance."""
    return -0.5 * (math.log(variance) + min(innovation * innovation / variance, LARGEST_SQUARE))


# ---- error of the film model ------------------------------------------------------------------------

ERROR_SIZES: Final = 1e-4 * 2.0 ** np.arange(11)  # E over Y: of an exact model, to one that is off by a tenth
STANDS_S: Final = 1e6  # of standing still, that changes the error by E too: a fortnight
ERROR_MEMORY: Final = 0.5  # of the range: with 2 a model whose error begins late is followed by a quarter worse
SIZE, VALUE, VARIANCE, LOG_WEIGHT = range(4)  # columns of errors
NO_ERRORS: Final = np.zeros((0, 4))
NO_ERRORS.setflags(write=False)


def initial_errors(output_range: float) -> Array:
    """Return the filters before any reading."""
    errors = np.zeros((ERROR_SIZES.size, 4))
    errors[:, SIZE] = ERROR_SIZES * output_range
    errors[:, VARIANCE] = errors[:, SIZE] ** 2
    errors.setflags(write=False)
    return errors


def constant_error(disturbance: float, variance: float) -> Array:
    """Return one filter alone, whose error does not grow."""
    errors = np.array([[0.0, disturbance, variance, 0.0]])
    errors.setflags(write=False)
    return errors


@njit
def disturbance_of(errors: Array) -> tuple[float, float]:
    """Return (disturbance, its variance): the weighted mean, and the variances with the spread of the means."""
    if errors.shape[0] == 0:
        return 0.0, 0.0
    best, total, mean, square = -math.inf, 0.0, 0.0, 0.0
    for row in errors:
        best = max(best, row[LOG_WEIGHT])
    for row in errors:
        total += math.exp(row[LOG_WEIGHT] - best)
    for row in errors:
        mean += math.exp(row[LOG_WEIGHT] - best) / total * row[VALUE]
    for row in errors:
        square += math.exp(row[LOG_WEIGHT] - best) / total * (row[VARIANCE] + (row[VALUE] - mean) ** 2)
    return mean, square


@njit
def errors_later(errors: Array, output_range: float, moved: float, period_s: float) -> Array:
    """Return the filters a period later, in which the output was to move by `moved`."""
    later = errors.copy()
    share = abs(moved) / output_range
    for row in later:
        row[VARIANCE] += row[SIZE] ** 2 * (share + period_s / STANDS_S)
        row[LOG_WEIGHT] *= math.exp(-share / ERROR_MEMORY)
    return later


@njit
def errors_after(errors: Array, off: float, noise: float, most_share: float) -> Array:
    """Return the filters after a reading that is `off` the film model; noise: its variance.

    most_share: largest share of an innovation by which one reading may change a value.
    """
    after, best = errors.copy(), -math.inf
    for row in after:
        innovation, whole = off - row[VALUE], row[VARIANCE] + noise + TINY
        share = min(row[VARIANCE] / whole, most_share)
        row[VALUE] += share * innovation
        # for any share: P. D. Joseph's form
        row[VARIANCE] = (1.0 - share) ** 2 * row[VARIANCE] + share**2 * (noise + TINY)
        row[LOG_WEIGHT] += log_likelihood(innovation, whole)
        best = max(best, row[LOG_WEIGHT])
    for row in after:
        row[LOG_WEIGHT] -= best
    return after


@njit
def with_disturbance(errors: Array, disturbance: float) -> Array:
    """Return the filters with another mean and the same spread."""
    after = errors.copy()
    after[:, VALUE] += disturbance - disturbance_of(errors)[0]
    return after


# ---- plate ------------------------------------------------------------------------------------------

UNSTEADY_K_PER_S2: Final = 3e-5, 3e-4, 3e-3  # w, of an exact plate, to one that is off by a fifth; six track no better
LAGS_S: Final = 0.0, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0, 5.6  # by the root of 2: none is off by more than a fifth
HEAT_MEMORY_S: Final = 30.0  # of the likelihood of each size
# standard deviations before any reading: the temperature's is a reading's, the heat's what plate models lack at rest
FIRST_K, FIRST_K_PER_S = 0.01, 0.02
DRIVE_DOUBT: Final = 0.05  # a fifth is learned as fast, and 0.2 takes a lag for a drive at first
LARGEST_DRIVE_ERROR: Final = 0.5  # a plate whose drive does half of its model has another fault, and is watched
LEAST_WEIGHT: Final = 1e-300  # so that a lag that is out of the question has a logarithm
UNSTEADY, LAG, WEIGHT, STATE, COVARIANCE = 0, 1, 2, 3, 7  # first columns of heats; the state s, p, d, e has 4


class Predicted(NamedTuple):
    """Temperatures (degC) by the plate model, with drift and drive as estimated, now and a period before.

    driven_K_per_s: mean heating by the model's drive in between (`compensator.thermal.plate.drive_rate`).
    """

    shown_degC: float
    plate_degC: float
    shown_before_degC: float
    plate_before_degC: float
    driven_K_per_s: float = 0.0


def initial_heats(
    sizes_K_per_s2: tuple[float, ...] = UNSTEADY_K_PER_S2,
    lags_s: tuple[float, ...] = LAGS_S,
    drive_doubt: float = DRIVE_DOUBT,
) -> Array:
    """Return the filters before any reading. drive_doubt: standard deviation of the drive's share."""
    covariance = np.diag([FIRST_K, FIRST_K, FIRST_K_PER_S, drive_doubt]) ** 2
    covariance[0, 1] = covariance[1, 0] = FIRST_K**2
    rows = [[size, lag, 0.0, *np.zeros(4), *covariance.ravel()] for lag in lags_s for size in sizes_K_per_s2]
    heats = np.array(rows)
    heats.setflags(write=False)
    return heats


@lean
def _heat_later(heats: Array, n: int, known_lag_s: float, a: float, b: float, h: float, by: Predicted) -> None:
    """Take filter n to a period h later; a, b: 1 - exp(-h / L), h - L a; known_lag_s: L of the model."""
    u, q = by.driven_K_per_s, heats[n, UNSTEADY] ** 2
    s, p, f = heats[n, STATE], heats[n, STATE + 1], heats[n, STATE + 2] + u * heats[n, STATE + 3]
    heats[n, STATE], heats[n, STATE + 1] = s + a * (p - s) + b * f, p + h * f
    if heats[n, LAG] > known_lag_s:
        behind, moved = by.plate_before_degC - by.shown_before_degC, by.plate_degC - by.plate_before_degC
        heats[n, STATE] += a * behind + b * moved / h - (by.shown_degC - by.shown_before_degC)
    for step, other in ((1, 4), (4, 1)):  # F P, whose rows d and e are those of P; then (F P) F^T, by its columns
        for k in range(COVARIANCE, COVARIANCE + 4 * step, step):
            s, p, f = heats[n, k], heats[n, k + other], heats[n, k + 2 * other] + u * heats[n, k + 3 * other]
            heats[n, k], heats[n, k + other] = s + a * (p - s) + b * f, p + h * f
    by_heat = 0.5 * h * h - max(heats[n, LAG], known_lag_s) * b, 0.5 * h * h, h  # of s, p, d: a heat that grows by one
    for i in range(3):
        for j in range(3):
            heats[n, COVARIANCE + 4 * i + j] += q * by_heat[i] * by_heat[j]


@lean
def _heat_after(heats: Array, n: int, off_K: float, noise: float) -> None:
    """Correct filter n by a reading that is off the prediction; noise: its variance."""
    k = COVARIANCE
    first = heats[n, k], heats[n, k + 1], heats[n, k + 2], heats[n, k + 3]
    whole, innovation = first[0] + noise + TINY, off_K - heats[n, STATE]
    for i in range(4):
        gain = first[i] / whole
        heats[n, STATE + i] += gain * innovation
        for j in range(4):
            heats[n, k + 4 * i + j] -= gain * first[j]
    heats[n, WEIGHT] += log_likelihood(innovation, whole)


@njit
def _shares(heats: Array, period_s: float) -> Array:
    """Return each filter's share, shape (lags * sizes,), and fade the weights of a lag's sizes, not of the lag."""
    # loops throughout: the law's step is timed in microseconds, and slices would be a tenth of it
    count, best, total, kept = heats.shape[0], -math.inf, 0.0, math.exp(-period_s / HEAT_MEMORY_S)
    shares = np.empty(count)
    for k in range(count):
        best = max(best, heats[k, WEIGHT])
    for k in range(count):
        shares[k] = math.exp(heats[k, WEIGHT] - best)
        total += shares[k]
    first = 0
    while first < count:
        last, best, whole, faded = first, -math.inf, LEAST_WEIGHT, 0.0
        while last < count and heats[last, LAG] == heats[first, LAG]:
            best = max(best, heats[last, WEIGHT])
            shares[last] /= total
            whole += shares[last]
            last += 1
        for k in range(first, last):
            heats[k, WEIGHT] = kept * (heats[k, WEIGHT] - best)
            faded += math.exp(heats[k, WEIGHT])
        for k in range(first, last):
            heats[k, WEIGHT] += math.log(whole / faded)
        first = last
    return shares


@njit
def corrected_temperature(
    estimate: Estimate,
    heats: Array,
    predicted: Predicted,
    reading_degC: float,
    period_s: float,
    acts_after_s: float,
    lag_s: float,
) -> tuple[float, float, Estimate, Array]:
    """Return thermometer and plate (degC), estimate and filters after a reading.

    The reading was taken acts_after_s before the moment of the prediction. lag_s: of the thermometer in the model.
    """
    noise, after = updated_noise(estimate.degC, reading_degC, period_s), heats.copy()
    a = b = 0.0
    for k in range(after.shape[0]):
        if k == 0 or after[k, LAG] != after[k - 1, LAG]:
            lag = max(after[k, LAG], lag_s)
            a = 1.0 - math.exp(-period_s / lag) if lag > 0.0 else 1.0
            b = period_s - lag * a
        before_K = after[k, STATE]
        _heat_later(after, k, lag_s, a, b, period_s, predicted)
        moved_K = predicted.shown_degC - predicted.shown_before_degC + after[k, STATE] - before_K
        since_K = moved_K * acts_after_s / period_s
        _heat_after(after, k, reading_degC + since_K - predicted.shown_degC, noise.variance)
    shares, mean = _shares(after, period_s), np.zeros(4)
    for k in range(shares.size):
        for i in range(4):
            mean[i] += shares[k] * after[k, STATE + i]
    drive_error = min(max(estimate.drive_error + mean[3], -LARGEST_DRIVE_ERROR), LARGEST_DRIVE_ERROR)
    mean[3] = drive_error - estimate.drive_error
    for k in range(shares.size):
        for i in range(4):
            after[k, STATE + i] -= mean[i]
    known = Estimate(estimate.drift_K_per_s + mean[2], drive_error, noise, estimate.output)
    return predicted.shown_degC + mean[0], predicted.plate_degC + mean[1], known, after


# ---- a film with an unknown memory -------------------------------------------------------------------
#
# The memories that it may have, each weighted by the likelihood of the readings:
#
#     possible   rows of play operators' outputs, a disturbance and a log-likelihood: shape (memories, operators + 2)
#
# Each is left by a random course from one end of the loop, whose last turning point is such that the output is the
# first reading. All follow the temperature; a reading corrects each memory's own disturbance as it corrects the law's,
# and reduces its likelihood by the remaining difference, so that memories with the same output stay alike. The law uses
# their mean, which is a memory too: play operators' outputs lie between bounds. It never moves the film in order to
# learn its memory: what matters of it shows as the film moves. When all likely memories are the same, one remains.

COUNT: Final = 400  # memories: some hundred are still likely after minutes, so that their mean is smooth
TURNS: Final = 4  # turning points before the last, at most: of nested loops the outermost decide
OFF_DEC: Final = 0.005  # of the first reading: what a model is usually off
EDGE: Final = 4.0 * OFF_DEC  # by which a reading may be off the loop itself
TRIES: Final = 20  # courses for each memory; of some no turn leads to the reading
HALVINGS: Final = 20  # of the last turning point's interval: to a ten-thousandth of a kelvin
UNLIKELY: Final = 20.0  # of log-likelihood below the best: such a memory is dropped
LIKELY: Final = 4.5  # three standard deviations
ALIKE: Final = 2e-4  # of the output, over all operators: memories that differ by less are one
NONE: Final = np.zeros((0, 0))
NONE.setflags(write=False)


@njit
def _returned(v: float, turn: float, film: Packed, before: Array, plays: Array) -> float:
    """Return the output at v after an excursion to `turn` and back, from `before`; plays: the memory then."""
    plays[:] = before
    advance(turn, v, film[0], film[1], plays)
    advance(v, turn, film[0], film[1], plays)
    return output_of(film, v, plays)


@njit
def _one(output: float, v: float, ends: Array, film: Packed, chance: Array, plays: Array) -> bool:
    """Find a memory at v with that output, into `plays`; return False if this course leads to none.

    plays: as they are at the end that chance[0] says. chance: TURNS + 2 numbers.
    """
    low, high = ends[0], ends[1]
    at = low if chance[0] < 0.5 else high
    for k in range(int(chance[1] * (TURNS + 1))):
        toward = low + (high - low) * chance[2 + k]
        advance(toward, at, film[0], film[1], plays)
        at = toward
    advance(v, at, film[0], film[1], plays)
    before = plays.copy()
    rest = output_of(film, v, before)
    end = high if output > rest else low
    left = output - _returned(v, end, film, before, plays)
    if left * (output - rest) > 0.0:  # the film is at the edge of its loop, or this course leads elsewhere
        return abs(left) <= EDGE
    near, far = v, end
    for _ in range(HALVINGS):
        middle = 0.5 * (near + far)
        if (_returned(v, middle, film, before, plays) < output) == (output > rest):
            near = middle
        else:
            far = middle
    return True


@njit
def _drawn(output: float, v: float, ends: Array, film: Packed, chances: Array, noise: Array, start: Array) -> Array:
    """Return the memories that were found, as `possible`; start: the plays at the ends, shape (2, operators)."""
    operators = film[1].size
    rows, found, tried = np.zeros((noise.size, operators + 2)), 0, 0
    while found < noise.size and tried < chances.shape[0]:
        chance = chances[tried]
        plays = start[0 if chance[0] < 0.5 else 1].copy()
        if _one(output + noise[found], v, ends, film, chance, plays):
            rows[found, :operators] = plays
            rows[found, operators] = output - output_of(film, v, plays)
            found += 1
        tried += 1
    return rows[:found]


def possible_memories(film: FilmModel, degC: float, output: float, low_degC: float, high_degC: float) -> Array:
    """Return memories with which a film at that temperature (degC) may show that output, reproducibly.

    low_degC, high_degC: the film has been at one of them. No row if no course leads to the output.
    """
    rng = np.random.default_rng(0)
    chances, noise = rng.random((TRIES * COUNT, TURNS + 2)), OFF_DEC * rng.standard_normal(COUNT)
    ends = np.array([low_degC, high_degC])
    start = np.array([film.initial_memory(low_degC, "heated").plays, film.initial_memory(high_degC, "cooled").plays])
    rows = _drawn(output, degC, ends, film.packed, chances, noise, start)
    return rows if rows.shape[0] > 0 else NONE


@njit
def mean_of(possible: Array, plays: Array) -> float:
    """Put the weighted mean memory into `plays`, and return the mean disturbance."""
    operators = plays.size
    best, total, disturbance = np.max(possible[:, operators + 1]), 0.0, 0.0
    plays[:] = 0.0
    for row in possible:
        weight = math.exp(row[operators + 1] - best)
        total += weight
        disturbance += weight * row[operators]
        for j in range(operators):
            plays[j] += weight * row[j]
    plays /= total
    return disturbance / total


@njit
def taken_along(possible: Array, v: float, v_before: float, film: Packed) -> None:
    """Move all memories to a temperature, in place."""
    for row in possible:
        advance(v, v_before, film[0], film[1], row[: film[1].size])


@njit
def weighed(possible: Array, plays: Array, off: float, share: float, variance: float, film: Packed) -> Array:
    """Return the memories after a reading, without the unlikely ones; one alone if all likely ones are alike.

    off: reading minus output of the memory `plays`. share: of it that corrects a disturbance; variance: of it.
    """
    weights, operators = film[2], plays.size
    mean = weighted_sum(weights, plays)
    for row in possible:
        innovation = off - (weighted_sum(weights, row[:operators]) - mean) - row[operators]
        row[operators + 1] -= 0.5 * innovation * innovation / variance
        row[operators] += share * innovation
    best = np.max(possible[:, operators + 1])
    possible[:, operators + 1] -= best
    kept = possible[possible[:, operators + 1] > -UNLIKELY]
    for row in kept:
        if row[operators + 1] > -LIKELY:
            apart = 0.0
            for j in range(operators):
                apart += weights[j] * abs(row[j] - kept[0, j])
            if apart > ALIKE:
                return kept
    return kept[:1]


# ---- repetition: the error of the film model along a course, from the readings of one run --------------
#
#     error' = error + w,   variance of w: q |step of the course| + CREEP r,   reading - model = error + noise
#
# A film outside the model's class is off by a random walk along the output's course, and takes the same walk whenever
# it takes the same course. During a run only the past is known; after it the readings of both sides are, and this is
# their best estimate: a Kalman filter, and back (H. E. Rauch, F. Tung, C. T. Striebel, AIAA J. 3 (1965) 1445). q
# maximizes the likelihood of the readings; their noise r comes from second differences.

FEWEST: Final = 64  # readings; of fewer neither noise nor error can be told
CREEP: Final = 2e-5  # of the noise's variance, a reading: a film that stands still creeps by next to nothing
MEDIAN: Final = 0.6745  # of the absolute value of a normal variable, in standard deviations
WALKS: Final = (-6.0, 2.0)  # log10 of the walk's variance over the noise's, a mean step: from none to no smoothing


@njit
def _filtered(off: Array, variances: Array, noise: float) -> tuple[float, Array, Array]:
    """Return (log-likelihood, estimates, their variances); variances: of each step; off: nan if there is no reading."""
    found, doubts = np.empty(off.size), np.empty(off.size)
    here, doubt, likelihood, begun = 0.0, 0.0, 0.0, False
    for i in range(off.size):
        doubt += variances[i]
        if not math.isnan(off[i]):
            if begun:
                whole, innovation = doubt + noise, off[i] - here
                likelihood -= 0.5 * (math.log(whole) + innovation * innovation / whole)
                here += doubt / whole * innovation
                doubt *= noise / whole
            else:
                here, doubt, begun = off[i], noise, True
        found[i], doubts[i] = here, doubt
    return likelihood, found, doubts


@njit
def _back(found: Array, doubts: Array, variances: Array) -> Array:
    """Return the estimates with the readings after them."""
    smooth = found.copy()
    for i in range(found.size - 2, -1, -1):
        whole = doubts[i] + variances[i + 1]
        if whole > 0.0:
            smooth[i] += doubts[i] / whole * (smooth[i + 1] - found[i])
    return smooth


def model_error(off: Array, steps: Array) -> Array:
    """Return the error of the model at each row, shape (rows,): 0 if there are too few readings.

    off: readings less the model, nan if there is none. steps: of the course since the row before, >= 0.
    """
    good = np.isfinite(off)
    bends = np.diff(off, 2)
    bends = bends[np.isfinite(bends)]
    if int(np.sum(good)) < FEWEST or bends.size < FEWEST // 2:
        return np.zeros(off.size)
    noise = max(float(np.median(np.abs(bends))) / MEDIAN, 1e-12) ** 2 / 6.0
    course, mean = np.abs(steps), float(np.mean(np.abs(steps)))

    def variances(walk: float) -> Array:
        return np.asarray(noise * (CREEP + (10.0**walk * course / mean if mean > 0.0 else 0.0 * course)))

    walk = minimize_scalar(
        lambda walk: -_filtered(off, variances(walk), noise)[0], bounds=WALKS, method="bounded", options={"xatol": 0.05}
    ).x
    _, found, doubts = _filtered(off, variances(walk), noise)
    first = int(np.argmax(good))
    found[:first] = found[first]
    return _back(found, doubts, variances(walk))

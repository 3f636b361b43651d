"""The noise of an instrument out of what a fit leaves, without taking the fit's own misfit for noise.

What a model is off by changes slowly beside noise. So nothing here looks at the residual itself: its size comes from
second differences, how it hangs together from how these grow with the distance they are taken over (a slow misfit makes
them grow with its square, noise that hangs together makes them saturate), its tails from what stands out of the six
rows around. White noise, the same everywhere and normal, is what a record is taken to have until it shows otherwise:
each of the three has to bring `SURE` of log-likelihood.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaln

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.likelihood import quick_noise
from sim.diagnosis.data.noise_colour import noise_colour
from sim.diagnosis.data.noise_model import NoiseModel, root_mean_square
from sim.diagnosis.data.noise_steps import stairs
from sim.diagnosis.data.wandering import Rows

SURE = 12.0  # log-likelihood: one record in some ten thousand by chance, with what was chosen (ranges, degrees)
FEWEST = 100  # readings from which more than one number can be told
LAGS = (1, 2, 3, 4, 6)
PRODUCTS = np.arange(5)  # rows apart
WHITE = (0.0, 1.0)  # no correlation, in all of the variance
RESOLVED = 0.2  # of the noise: a last digit that does not matter
MOST_CORRELATED = 0.92  # from which rows hang together over more than ten: what a fit is off by does
CORRELATIONS = np.arange(0.0, 0.97, 0.01)
SLOW = np.concatenate(([0.0], np.geomspace(1e-5, 10.0, 25)))  # a misfit's second difference over the noise, squared
SPREAD = 10.3  # of log s^2 of n second differences, s from their median, times n: normal ones, each row in three
WINDOW = 20  # rows on either side whose mean is taken off: a misfit slower than some eighty rows is no correlation
UNDERSTOOD = 2.5  # noises that a fit is off by, beyond which all but the noise's size would be told by its misfit
WINSOR = 5.0  # robust deviations beyond which a reading counts as one just there
DEGREES = (2.5, 3.0, 4.0, 5.0, 7.0, 10.0, 15.0)
BULK = 6.0  # robust deviations: that tails are heavy has to show in what is no outlier, too
ALIKE = 9  # decimals in which readings are the same: converted ones differ in the last of sixteen digits
OF_MEDIAN = 1.13  # of a reading less the median of the six around it over its own: mean square weighed, 4 degrees
MAD = 1.4826


def noise_of(
    residual: Array,
    readings: Array,
    used: NDArray[np.bool_],
    fitted: NDArray[np.bool_],
    least: float,
    stepped: bool = True,
    coloured: bool = False,
) -> NoiseModel:
    """Of one channel. residual, readings: in the record's rows, (rows,); used: where they count; fitted: of these, the
    rows of which white noise is told; least: the deviation at least, in their unit; stepped: whether it may be another
    one at other readings; coloured: whether it may hang together otherwise than neighbouring rows share a part."""
    white = NoiseModel.white(max(_level(residual[fitted], readings[fitted], np.flatnonzero(fitted)), least))
    rows, record_rows = np.flatnonzero(used), used.size
    if rows.size < FEWEST:
        return white
    residual, readings = residual[rows], readings[rows]
    edges, deviations = np.empty(0), white.deviations
    if stepped:
        edges, deviations = stairs(readings, _second(residual, rows, 1), least, SURE)
    model = NoiseModel(white.level, edges, deviations) if edges.size else white
    jitter = _jitter(readings, white.level)
    colour = noise_colour(residual / model.at(readings), rows) if coloured else None
    if colour is None:
        correlation, shared = _correlation(residual / model.at(readings), jitter / model.at(readings), rows)
        model = replace(model, correlation=correlation, shared=shared)
    else:
        model = replace(model, colour=colour)
    whitening = model.on(rows, readings)
    if not model.plain:
        model = _scaled(model, _deviation(whitening.over(residual), whitening.over(residual + jitter), rows), least)
    whitening = model.on(rows, readings)
    model = _with_tails(model, whitening.over(residual), whitening.over(residual + jitter), rows, least, record_rows)
    away = np.clip(residual / model.marginal(readings), -WINSOR, WINSOR)
    if root_mean_square(away) > UNDERSTOOD:
        return white
    return replace(model, level=model.rms(readings))


def _level(residual: Array, readings: Array, rows: Rows) -> float:
    """Of white noise. Where rounded readings hardly move, second differences come in few sizes, and their median jumps
    from one to the next: from 0.9 to 1.2 of a noise of 0.7 steps."""
    quick = quick_noise(residual)
    jitter = _jitter(readings, quick)
    if residual.size < FEWEST or not np.any(jitter):
        return quick
    return _deviation(residual, residual + jitter, rows)


def _jitter(readings: Array, level: float) -> Array:
    """What spreads readings on a lattice evenly over its steps: equal neighbours are no sign of little noise."""
    values = np.unique(np.round(readings, ALIKE))
    step = float(np.min(np.diff(values))) if values.size > 1 else 0.0
    if step < RESOLVED * level:
        return np.zeros(readings.size)
    return step * (np.random.default_rng(0).random(readings.size) - 0.5)


def _second(values: Array, rows: Rows, lag: int) -> Array:
    """Second differences over so many rows, nan where a row is missing: about each row, (rows,)."""
    out = np.full(values.size, np.nan)
    if values.size > 2 * lag:
        whole = rows[2 * lag :] - rows[: -2 * lag] == 2 * lag
        found = values[: -2 * lag] - 2.0 * values[lag:-lag] + values[2 * lag :]
        out[lag:-lag] = np.where(whole, found, np.nan)
    return out


def _deviation(u: Array, spread: Array, rows: Rows, lag: int = 1) -> float:
    """Of independent noise, from the median of its second differences; where readings had to be spread over their
    lattice's steps, of which a median knows nothing, from their mean square, those far out apart."""
    median = MAD * float(np.nanmedian(np.abs(_second(spread, rows, lag))))
    if np.array_equal(u, spread):
        return median / math.sqrt(6.0)
    second = _second(u, rows, lag)
    return root_mean_square(np.clip(second[np.isfinite(second)], -WINSOR * median, WINSOR * median)) / math.sqrt(6.0)


def _correlation(x: Array, jitter: Array, rows: Rows) -> tuple[float, float]:
    """Of neighbouring rows of a residual over its deviation, and the share that hangs together; 0 and 1 where it may be
    white."""
    counts = np.array([np.sum(np.isfinite(_second(x, rows, lag))) for lag in LAGS])
    if counts[0] < FEWEST or np.min(counts) < FEWEST // 2:
        return WHITE
    log_s2 = np.array([2.0 * math.log(_deviation(x, x + jitter, rows, lag) + 1e-300) for lag in LAGS])
    lags = np.array(LAGS, dtype=np.float64)
    shared = CORRELATIONS[:, None, None] ** lags
    log_g = np.log(6.0 - 8.0 * shared + 2.0 * shared**2 + SLOW[:, None] * lags**4)
    away = log_s2 - log_g
    weight = counts / SPREAD
    away -= (away @ weight)[..., None] / np.sum(weight)
    chi2 = np.min(away**2 @ weight, axis=1)  # the slow misfit at its best
    if 0.5 * (chi2[0] - float(np.min(chi2))) < SURE:
        return WHITE
    rough = float(CORRELATIONS[int(np.argmin(chi2))])
    found = _refined(x, rows, rough)
    return found if found[0] < MOST_CORRELATED else WHITE


def _refined(x: Array, rows: Rows, rough: float) -> tuple[float, float]:
    """From products of rows up to four apart, of what is left off the mean of the rows around; `rough` where a record
    is too often interrupted for that."""
    width = 2 * WINDOW + 1
    if x.size <= width + PRODUCTS.size:
        return rough, 1.0
    clipped = np.clip(x, *(np.median(x) + np.array([-1.0, 1.0]) * WINSOR * MAD * np.median(np.abs(x - np.median(x)))))
    total = np.concatenate(([0.0], np.cumsum(clipped)))
    off = clipped[WINDOW:-WINDOW] - (total[width:] - total[:-width]) / width
    whole = rows[2 * WINDOW :] - rows[: -2 * WINDOW] == 2 * WINDOW
    found = []
    for lag in PRODUCTS:
        first, second = slice(None, off.size - lag), slice(lag, None)
        both = whole[first] & whole[second]
        if np.sum(both) < FEWEST:
            return rough, 1.0
        found.append(float(np.mean((off[first] * off[second])[both])))
    kernel = np.full(width, -1.0 / width)
    kernel[WINDOW] += 1.0
    product, apart = np.correlate(kernel, kernel, "full"), np.arange(-width + 1, width)
    white = np.array([float(np.sum(product[apart == -lag])) for lag in PRODUCTS])
    best, least = (rough, 1.0), math.inf
    for c in CORRELATIONS[1:]:
        together = np.array([float(product @ c ** np.abs(apart + lag)) for lag in PRODUCTS])
        two = np.stack((together, white), axis=1)
        sizes = np.linalg.lstsq(two, np.array(found))[0]
        if sizes[0] <= 0.0 or sizes[1] < 0.0:
            sizes = np.array([float(together @ found) / float(together @ together), 0.0])
        left = float(np.sum((two @ sizes - found) ** 2))
        if left < least:
            best, least = (float(c), float(sizes[0] / np.sum(sizes))), left
    return best


def _with_tails(model: NoiseModel, u: Array, spread: Array, rows: Rows, least: float, record_rows: int) -> NoiseModel:
    """With weights of Student's t, where the record shows its tails. u: the residual over the noise; spread: the same
    of readings spread over their lattice's steps."""
    stands_out = spread - _around(spread)
    size = MAD * float(np.median(np.abs(stands_out))) + 1e-300
    bulk = stands_out[np.abs(stands_out) < BULK * size]
    normal = _log_likelihood(bulk, math.inf, root_mean_square(bulk))
    best, degrees, scale = normal + SURE, math.inf, 1.0
    for nu in DEGREES:
        s = _t_scale(bulk, nu, size)
        value = _log_likelihood(bulk, nu, s)
        if value > best:
            best, degrees, scale = value, nu, s
    if math.isinf(degrees):
        return model
    of_rows = (degrees + 1.0) / (degrees + (stands_out / scale) ** 2)
    weights = np.ones(record_rows)
    weights[rows] = of_rows
    times = root_mean_square(np.sqrt(of_rows) * (u - _around(u))) / math.sqrt(OF_MEDIAN)
    return _scaled(replace(model, weights=weights, degrees=degrees), times, least)


def _around(u: Array) -> Array:
    """The median of the three rows on either side."""
    padded = np.pad(u, 3, mode="reflect")
    return np.asarray(np.median([padded[k : k + u.size] for k in (0, 1, 2, 4, 5, 6)], axis=0), dtype=np.float64)


def _t_scale(values: Array, nu: float, begin: float) -> float:
    """Of largest likelihood."""
    s = begin
    for _ in range(20):
        s = root_mean_square(np.sqrt((nu + 1.0) / (nu + (values / s) ** 2)) * values)
    return s


def _log_likelihood(values: Array, nu: float, scale: float) -> float:
    z2 = (values / scale) ** 2
    if math.isinf(nu):
        return float(-0.5 * np.sum(z2)) - values.size * (math.log(scale) + 0.5 * math.log(2.0 * math.pi))
    one = float(gammaln(0.5 * (nu + 1.0)) - gammaln(0.5 * nu)) - 0.5 * math.log(nu * math.pi) - math.log(scale)
    return values.size * one - 0.5 * (nu + 1.0) * float(np.sum(np.log1p(z2 / nu)))


def _scaled(model: NoiseModel, times: float, least: float) -> NoiseModel:
    """With larger or smaller deviations."""
    return replace(model, level=max(times * model.level, least), deviations=np.maximum(times * model.deviations, least))

"""What the ohmmeter shows over what the film model says, as the law takes it: the disturbance, out of noisy readings.

The model's error is a random walk along the course of the output: a film that stands still does not change it, one that
moves does. How large it is nobody knows: an exact model has none, and a film outside the model's class ten times that
of one of it. So several sizes are supposed at once, each a Kalman filter of its own, and each weighed by how well it
foretells the readings (D. T. Magill, IEEE Trans. Autom. Control AC-10 (1965) 434):

    supposed    the model's error changes by E over a course of the output's whole range Y: doubt P, at first E^2
    a period    P' = P + E^2 (|moved| / Y + period / `STANDS_S`)
    a reading   innovation nu = off - value, S = P + noise;  value' = value + P / S nu;  ln weight' = ln weight -
                (ln S + nu^2 / S) / 2
    told        the mean of the values by their weights; its variance: of each, and of the values about their mean

So nothing of this has to be set: a model that is exact is soon believed, and one that is off is followed. Sizes are
shares of the output's range, whatever its unit. What a filter knew of its size is forgotten over a course of
`REMEMBERED`, as a film's lower half may be told better than its upper.

    errors      rows of E, value, doubt and ln weight, one for each of `SIZES`, shape (sizes, 4); no row where the law
                has no film
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from compensator.compiled import njit
from compensator.control.estimate import TINY, less_likely
from compensator.hysteresis.functions import Array

SIZES: Final = 1e-4 * 2.0 ** np.arange(11)  # E over Y: of an exact model, to one that is off by a tenth
STANDS_S: Final = 1e6  # of standing still, that changes the error by E too: a fortnight
REMEMBERED: Final = 0.5  # of the range: with 2 a model that goes off late is followed by a quarter worse
SIZE, VALUE, DOUBT, WEIGHT = range(4)  # columns
NONE: Final = np.zeros((0, 4))
NONE.setflags(write=False)


def unknown_errors(output_range: float) -> Array:
    """Before any reading."""
    errors = np.zeros((SIZES.size, 4))
    errors[:, SIZE] = SIZES * output_range
    errors[:, DOUBT] = errors[:, SIZE] ** 2
    errors.setflags(write=False)
    return errors


def one_error(disturbance: float, doubt: float) -> Array:
    """Of one size alone, which does not grow, with this variance."""
    errors = np.array([[0.0, disturbance, doubt, 0.0]])
    errors.setflags(write=False)
    return errors


@njit
def told(errors: Array) -> tuple[float, float]:
    """(disturbance, its variance), of all sizes."""
    if errors.shape[0] == 0:
        return 0.0, 0.0
    best, total, mean, square = -math.inf, 0.0, 0.0, 0.0
    for row in errors:
        best = max(best, row[WEIGHT])
    for row in errors:
        total += math.exp(row[WEIGHT] - best)
    for row in errors:
        mean += math.exp(row[WEIGHT] - best) / total * row[VALUE]
    for row in errors:
        square += math.exp(row[WEIGHT] - best) / total * (row[DOUBT] + (row[VALUE] - mean) ** 2)
    return mean, square


@njit
def grown(errors: Array, output_range: float, moved: float, period_s: float) -> Array:
    """A period later, in which the output was to move by that, before a reading."""
    later = errors.copy()
    share = abs(moved) / output_range
    for row in later:
        row[DOUBT] += row[SIZE] ** 2 * (share + period_s / STANDS_S)
        row[WEIGHT] *= math.exp(-share / REMEMBERED)
    return later


@njit
def corrected(errors: Array, off: float, variance: float, most_share: float) -> Array:
    """After a reading that is `off` the film model, with noise of that variance.

    most_share: of what it is off that one reading counts for at the most, whatever the model's error.
    """
    after, best = errors.copy(), -math.inf
    for row in after:
        innovation, whole = off - row[VALUE], row[DOUBT] + variance + TINY
        share = row[DOUBT] / whole
        if share > most_share:
            share = most_share
        row[VALUE] += share * innovation
        row[DOUBT] = (1.0 - share) ** 2 * row[DOUBT] + share**2 * (variance + TINY)  # of any share: P. D. Joseph's form
        row[WEIGHT] = less_likely(row[WEIGHT], innovation, whole)
        best = max(best, row[WEIGHT])
    for row in after:
        row[WEIGHT] -= best
    return after


@njit
def moved_to(errors: Array, disturbance: float) -> Array:
    """The same with that mean: where something else has told it."""
    after, off = errors.copy(), disturbance - told(errors)[0]
    for row in after:
        row[VALUE] += off
    return after

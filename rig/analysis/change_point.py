"""Whether a quantity that was measured night after night has changed, and since when.

A night has a value with its standard error, or no value (the effect was not seen). Two tests, each over every possible
night of the change k and, after it, at least `FEWEST` nights:

value    z = (mean after - mean before) / sqrt(s^2 (1/W_after + 1/W_before)),  means weighted by W = sum of 1/error^2,
         s^2 the scatter about the means in units of the errors, at least 1: nights scatter more than one night's errors
         say. Held against Student's t with the nights' degrees of freedom.
seen     Fisher's exact test of how often the effect was seen before and after: it appears, or it is gone.

A change is reported where the test's probability, corrected for how often it was tried, is below `false_alarm`: at
most so often a series without a change has one. It is looked for every night anew, and at every night until then: n
nights have n^2 / 2 tests of the value. (Tests of what was seen are fewer, because only so many tables can come out,
and exact, which a discrete test is only from above: they are corrected by n.) Of several changes the latest counts:
what holds from then on until now is judged by itself, so that a second change is found, and an old one is not
reported again.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.stats import fisher_exact, t

from compensator.hysteresis.functions import Array

FEWEST = 2  # nights on either side: of one alone nobody knows whether the night or the rig was another
FALSE_ALARM = 0.05  # of a series


@dataclass(frozen=True)
class Change:
    """since: the first night (index) of the new state. before, after: (mean, standard error), nan where not seen;
    kind: "value", "appears" or "gone"; probability: of such a difference by chance, corrected for the search."""

    since: int
    kind: str
    before: tuple[float, float]
    after: tuple[float, float]
    probability: float


def latest_change(value: Array, error: Array, false_alarm: float = FALSE_ALARM) -> Change | None:
    """The latest change of a series; None where there is none.

    value: shape (nights,), nan where the effect was not seen; error: standard errors, > 0, nan where unknown.
    """
    begin, found = 0, None
    while True:
        change = _strongest(value[begin:], error[begin:], false_alarm)
        if change is None:
            return found
        found = Change(begin + change.since, change.kind, change.before, change.after, change.probability)
        begin += change.since


def _strongest(value: Array, error: Array, false_alarm: float) -> Change | None:
    trials = [*_by_value(value, error), *_by_sight(value)]
    if not trials:
        return None
    corrected, since, kind = min(trials)
    if corrected > false_alarm:
        return None
    return Change(
        since, kind, _mean(value[:since], error[:since])[:2], _mean(value[since:], error[since:])[:2], corrected
    )


def _by_value(value: Array, error: Array) -> list[tuple[float, int, str]]:
    """(corrected probability, night, "value") for every night at which the value may have changed."""
    seen = np.flatnonzero(np.isfinite(value) & np.isfinite(error))
    found = []
    for k in range(FEWEST, seen.size - FEWEST + 1):
        sides = seen[:k], seen[k:]
        (a, a_error, a_square), (b, b_error, b_square) = (_mean(value[side], error[side]) for side in sides)
        freedom = seen.size - 2
        scatter = max(1.0, (a_square + b_square) / freedom) if freedom > 0 else 1.0
        z = abs(b - a) / math.sqrt(scatter * (a_error**2 + b_error**2))
        tests = max(1.0, 0.5 * seen.size**2)
        found.append((min(1.0, tests * 2.0 * float(t.sf(z, max(freedom, 1)))), int(seen[k]), "value"))
    return found


def _by_sight(value: Array) -> list[tuple[float, int, str]]:
    """(corrected probability, night, "appears" or "gone") for every night from which on it was seen more, or less."""
    seen = np.isfinite(value)
    if np.all(seen) or not np.any(seen):
        return []
    found = []
    for k in range(FEWEST, seen.size - FEWEST + 1):
        before, after = int(np.sum(seen[:k])), int(np.sum(seen[k:]))
        table = [[before, k - before], [after, seen.size - k - after]]
        kind = "appears" if after / (seen.size - k) > before / k else "gone"
        found.append((min(1.0, seen.size * float(fisher_exact(np.array(table))[1])), k, kind))
    return found


def _mean(value: Array, error: Array) -> tuple[float, float, float]:
    """(weighted mean, its standard error, sum of squares about it in units of the errors)."""
    good = np.isfinite(value) & np.isfinite(error)
    if not np.any(good):
        return math.nan, math.nan, 0.0
    weight = 1.0 / error[good] ** 2
    mean = float(np.sum(weight * value[good]) / np.sum(weight))
    return mean, 1.0 / math.sqrt(float(np.sum(weight))), float(np.sum(weight * (value[good] - mean) ** 2))

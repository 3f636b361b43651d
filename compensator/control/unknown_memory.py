"""A film with an unknown memory: the memories that it may have, each weighted by the likelihood of the readings.

    possible   rows of play operators' outputs, a disturbance and a log-likelihood: shape (memories, operators + 2)

Each memory is left by a random course from one end of the loop, whose last turning point is such that the output is the
first reading. All follow the temperature; a reading corrects each memory's own disturbance as it corrects the law's
(`compensator.control.estimator`), and reduces its likelihood by the remaining difference, so that memories with the
same output stay alike. The law uses their mean, which is a memory too: play operators' outputs lie between bounds. It
never moves the film in order to learn its memory: what matters of it shows as the film moves. When all likely memories
are the same, one remains and is no longer weighted.
"""

from __future__ import annotations

import math
from typing import Final

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.film import FilmModel, Packed
from compensator.hysteresis.functions import Array
from compensator.hysteresis.play import advance, output_of, weighted_sum

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

"""Is anything left? Residuals in units of the noise against what white noise would do.

Each question groups the residuals and asks whether the groups' means are further from 0 than chance makes them:
consecutive rows (blocks of 4, 12, ... rows), temperature and direction, the resistance, the test current. Q = sum over
groups of n m^2 is chi-square with as many degrees of freedom as groups where nothing is left; the excess share
(Q - groups) / rows says how large what is left is beside the noise. Where a film switches in steps, one more question
is whether the rows in which it does not have a period (`a_period`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.record import Record, Rows

LEAST_SHARE = 0.02  # of the noise's variance: less is no matter
SURE = 1e-6  # probability of so much by chance, over all questions
FIRST_LINE = 4  # periods in a record: fewer are a trend
FINER = 2  # lines as many times as close as the record tells apart: a period between two shows 0.8 of itself, else 0.4
ROWS_OF_A_PERIOD = 100  # at least, to ask for one: a line is a few of their hundredths
PER_ROW = 20  # places of the even grid at most: a record that pauses for days is no grid


@dataclass(frozen=True)
class Question:
    """One grouping: its name, the probability of its Q by chance (log10), the excess share of the variance."""

    name: str
    log10_p: float
    share: float


@dataclass(frozen=True)
class Adequacy:
    """All questions; `left`: those that find something, the surest first."""

    questions: tuple[Question, ...]
    mean_square: float

    @property
    def left(self) -> tuple[Question, ...]:
        limit = math.log10(SURE / max(len(self.questions), 1))
        found = [q for q in self.questions if q.log10_p < limit and q.share > LEAST_SHARE]
        return tuple(sorted(found, key=lambda q: q.log10_p))

    @property
    def clean(self) -> bool:
        return not self.left


def _grouped(name: str, z: Array, group: NDArray[np.int64], spent: float = 0.0) -> Question:
    count = np.bincount(group)
    total = np.bincount(group, z)
    used = count > 0
    q = float(np.sum(total[used] ** 2 / count[used]))
    k = int(np.sum(used))
    p = float(chdtrc(k, max(q - spent, 0.0)))  # that a chi-square of k is larger by chance; 0 below all numbers
    log_p = math.log10(p) if p > 0.0 else -math.inf
    return Question(name, log_p, (q - k) / z.size)


def a_period(z: Array, time_s: Array) -> Question | None:
    """Whether the largest line of the periodogram is more than chance: of white noise each line over the mean square is
    exponential (A. Schuster, Terr. Magn. 3 (1898) 13; R. A. Fisher, Proc. R. Soc. A 125 (1929) 54), wherever rows are
    missing. z, time_s: of some rows, (rows,). None of too few rows, or of times that are on no grid."""
    if z.size < ROWS_OF_A_PERIOD:
        return None
    place = np.round((time_s - time_s[0]) / float(np.median(np.diff(time_s)))).astype(np.int64)
    if place[-1] > PER_ROW * z.size:
        return None
    off = z - np.mean(z)
    grid = np.bincount(place, off)
    lines = np.abs(np.fft.rfft(grid, FINER * grid.size))[FINER * FIRST_LINE :] ** 2 / float(np.sum(off * off))
    largest = float(np.max(lines))
    log_p = min(math.log10(lines.size) - largest * math.log10(math.e), 0.0)
    return Question("a period", log_p, 2.0 * (largest - 1.0) / z.size)


def adequacy(
    z: Array,
    time_s: Array,
    temperature_degC: Array | None,
    state: dict[str, Array],
    still: NDArray[np.bool_] | None = None,
) -> Adequacy:
    """z: residuals over noise (rows,). temperature_degC: None where what is left may hang on it, as on the domains that
    switch there. state: other columns by name, grouped by their quantiles. still: rows in which none of such domains
    switch, (rows,).

    Under closed-loop control the current of a row answers to the row's own noise: give that of the row before."""
    z = np.clip(z, -6.0, 6.0)  # a reading further off went astray
    n = z.size
    scale = float(np.mean(z * z))
    if 0.85 < scale < 1.15:  # the noise itself is known this well only
        z = z / math.sqrt(scale)
    questions = []
    size = 4
    while n // size >= 6:  # blocks: with fewer, one is the record's whole trend
        questions.append(_grouped(f"blocks of {size} rows", z, (np.arange(n) // size).astype(np.int64)))
        size *= 3  # what shows at one size and not at the next lasts for no longer
    if temperature_degC is not None:
        rising = np.diff(temperature_degC, prepend=temperature_degC[0]) > 0.0  # the next step answers to this noise
        # 30 bins of temperature: a tenth of a loop's flank each, and enough readings
        bins = np.clip(
            np.searchsorted(np.quantile(temperature_degC, np.linspace(0, 1, 31)[1:-1]), temperature_degC), 0, 29
        )
        questions.append(_grouped("temperature", z, (2 * bins + rising).astype(np.int64)))
    for name, values in state.items():
        levels = np.unique(values)
        if levels.size <= 12:  # a few commands or ranges, not a continuum
            group = np.searchsorted(levels, values)
        else:
            group = np.searchsorted(np.quantile(values, np.linspace(0, 1, 41)[1:-1]), values)  # 40 of them
        questions.append(_grouped(name, z, group.astype(np.int64)))
    period = None if still is None else a_period(z[still], time_s[still])
    if period is not None:
        questions.append(period)
    return Adequacy(tuple(questions), scale)


def describe(z: Array, record: Record, rows: Rows, left: tuple[Question, ...]) -> str:
    """What is left in words: its period, its direction, its range of temperature, when. z: residuals over noise in
    these rows of the record, (rows,)."""
    parts, time_s, temperature_degC = [], record.time_s[rows], record.temperature_degC[rows]
    period = main_period_s(z, time_s)
    if period is not None:
        parts.append(f"period {period:.3g} s")
    rising = np.gradient(temperature_degC) > 0.0
    up, down = float(np.mean(z[rising] ** 2)), float(np.mean(z[~rising] ** 2)) if np.any(~rising) else 0.0
    if up > 2.0 * down:  # twice the mean square: for most of what is left
        parts.append("mostly while heating")
    elif down > 2.0 * up:
        parts.append("mostly while cooling")
    edges = np.quantile(temperature_degC, np.linspace(0.0, 1.0, 13))  # twelve places
    square = [
        float(np.mean(z[(temperature_degC >= a) & (temperature_degC <= b)] ** 2)) for a, b in itertools.pairwise(edges)
    ]
    k = int(np.argmax(square))
    if square[k] > 2.5 * float(np.mean(square)):  # a fifth of all in a twelfth of the rows
        parts.append(f"between {edges[k]:.1f} and {edges[k + 1]:.1f} degC")
    if (place := onset(z)) is not None:
        row = int(rows[place])
        of = f" of record {record.number_of(row)}" if record.joined.size else ""
        parts.append(f"from {record.file_s[row]:.0f} s{of} on")
    return ", ".join(parts) if parts else f"structure in {left[0].name}" if left else "structure"


def main_period_s(z: Array, time_s: Array) -> float | None:
    """The period that stands out of the residual's spectrum, None where none does."""
    step = float(np.median(np.diff(time_s)))
    count = int((time_s[-1] - time_s[0]) / step) + 1
    even = np.interp(time_s[0] + step * np.arange(count), time_s, z)
    power = np.abs(np.fft.rfft(even * np.hanning(count))) ** 2
    power[:3] = 0.0  # a trend
    k = int(np.argmax(power))
    around = np.median(power[max(3, k - 60) : k + 60])  # lines enough for a median
    if power[k] < 40.0 * around or k < 4:  # of noise, one line in 1e12; and three periods are a trend, too
        return None
    return count * step / k


def onset(z: Array) -> int | None:
    """The place from which on the residual is several times larger, None where there is none."""
    n = z.size
    total = np.cumsum(z * z)
    k = np.arange(n // 10, n - n // 10)  # with a tenth of the record at least on either side
    before, after = total[k] / (k + 1), (total[-1] - total[k]) / (n - k - 1)
    ratio = after / np.maximum(before, 0.5)
    best = int(np.argmax(ratio * np.minimum(k, n - k)))
    sudden = ratio[best] > 4.0 and before[best] < 1.5  # four times the mean square, and about the noise's before
    return int(k[best]) if sudden else None

"""The colour of an instrument's noise: its spectrum, as what a fit leaves shows it, and the filter that turns it white.

The spectrum is told from stretches of `STRETCH` rows, a line through each taken off (P. D. Welch, IEEE Trans. Audio
Electroacoust. 15 (1967) 70). What is slower is not read line by line from what a fit leaves, since what a model is off
by is slow: it is that of 1/f noise and of white noise behind a filter, c / f + w - b f^2, as stretches of `LONG` rows
show them. So a digital filter, two poles or the 1/f noise of a film and of an amplifier have a colour, and whatever
else is slow is left over.

The filter is the causal one whose inverse is causal too, |H|^2 = 1 / S, by the cepstrum (A. V. Oppenheim, R. W.
Schafer, Discrete-Time Signal Processing, on the minimum-phase system of a magnitude).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import fft
from scipy.optimize import nnls

from compensator.hysteresis.functions import Array
from sim.diagnosis.data.wandering import Rows

STRETCH = 128  # rows: four periods of the slowest that is read
LONG = 512  # rows: over two octaves more, 1/f noise and a filter differ
SLOWEST = 4 / STRETCH  # 1 / row: at the second line a window still lets a line's trend through
FEWEST = 7  # of the long ones: 2048 rows
MANY = 16  # stretches, each half over the next: a band of three lines to a fifth
BANDS = np.concatenate((np.arange(4, 10), np.arange(10, STRETCH // 2 + 2, 3))) - 0.5  # edges, lines: as wide as a
# filter's notches allow, and single ones where 1/f noise is steep
SLOW_LINES = (2 / LONG, 1 / 12)  # 1 / row: where white and 1/f are told from each other; filters are even in f there
ROUNDS = 4  # of the slow shares and the power that they have, by which lines are weighed
TAPS = 1024  # of the filter: of 1/f noise they fall off as k^-1.5, and all behind are a fortieth
GRID = 16384  # frequencies: 1/f noise goes on to periods of so many rows
LEAST = 0.01  # of a line's power that the slow shares have: they may fall below 0 at the fastest
SURE = 2.0  # log-likelihood that 1/f noise has to bring, one of white noise in forty by chance: a little becomes much
OF_MEDIAN = float(np.log(2.0))  # of a line's power over its mean, which few stretches that went astray would be
AT_ONCE = 32  # columns: of 50,000 rows they take 50 MB


@dataclass(frozen=True, eq=False)
class NoiseColour:
    """taps: of the filter, (taps,), that makes white noise of variance 1 of this noise of variance 1; spread: of what
    it makes of rows before which nothing is known, (taps,), the deviation by their place; rows_alike: how many rows
    tell of a mean over very many as much as a single independent one would."""

    taps: Array
    spread: Array
    rows_alike: float

    def alike(self, other: NoiseColour, share: float) -> bool:
        """Whether another one leaves about as much of the noise: to this share of a deviation."""
        return bool(abs(np.log(self.taps[0] / other.taps[0])) < share)

    def white(self, values: Array) -> Array:
        """Of consecutive rows, (rows, columns), over the deviation of what is made of them."""
        rows = values.shape[0]
        taps = self.taps[: min(rows, TAPS)]
        size = fft.next_fast_len(rows + taps.size - 1, real=True)
        response = fft.rfft(taps, size)[:, None]
        out = np.empty(values.shape)
        for first in range(0, values.shape[1], AT_ONCE):
            some = slice(first, first + AT_ONCE)
            out[:, some] = fft.irfft(fft.rfft(values[:, some], size, axis=0) * response, size, axis=0)[:rows]
        return out / self.spread[np.minimum(np.arange(rows), TAPS - 1)][:, None]


@dataclass(frozen=True, eq=False)
class ColouredWhitening:
    """Values of some rows over their noise. scale: one over its deviation, (rows,); begins: rows that hang together
    with none before; root: of the rows' weights."""

    scale: Array
    colour: NoiseColour
    begins: Rows
    root: Array

    def over(self, values: Array) -> Array:
        """(rows,) or (rows, columns)."""
        table = values.reshape(values.shape[0], -1) * self.scale[:, None]
        out = np.empty(table.shape)
        ends = np.append(self.begins[1:], table.shape[0])
        for first, end in zip(self.begins, ends, strict=True):
            out[first:end] = self.colour.white(table[first:end])
        return (out * self.root[:, None]).reshape(values.shape)


def noise_colour(x: Array, rows: Rows) -> NoiseColour | None:
    """As a residual over its deviation shows it, (rows,), in these rows of the record; None of too few together."""
    power, stretches = _spectrum(x, rows, STRETCH)
    slow_power, long_ones = _spectrum(x, rows, LONG)
    if stretches < MANY or long_ones < FEWEST or not (np.all(power[1:] > 0.0) and np.all(slow_power[1:] > 0.0)):
        return None
    lines, slow_lines = np.arange(power.size) / STRETCH, np.arange(slow_power.size) / LONG
    band = np.searchsorted(BANDS, np.arange(power.size), side="right") - 1
    centre = np.array([float(np.mean(lines[band == k])) for k in range(BANDS.size)])
    height = np.array([float(np.log(np.mean(power[band == k]))) for k in range(BANDS.size)])
    told = (slow_lines >= SLOW_LINES[0]) & (slow_lines <= SLOW_LINES[1])
    shares = _slow_shares(slow_lines[told], slow_power[told], 0.5 * long_ones)
    f = np.maximum(np.arange(GRID // 2 + 1), 1) / GRID
    density = np.exp(np.interp(f, centre, height))
    slow = np.flatnonzero(f <= SLOWEST)
    continued = _slow_shapes(f[slow]) @ shares
    density[slow] = continued * density[slow[-1]] / continued[-1]
    return _whitening(density)


def _slow_shares(lines: Array, power: Array, independent: float) -> Array:
    """Of each of the slow shapes, (3,); no 1/f where it is not sure, by as many independent periodograms (P. Whittle,
    Ark. Mat. 2 (1953) 423)."""
    shapes, found, minus_log = _slow_shapes(lines), [], []
    for first in (0, 1):
        shares, seen = np.zeros(shapes.shape[1]), np.full(power.size, float(np.mean(power)))
        for _ in range(ROUNDS):
            shares[first:] = nnls(shapes[:, first:] / seen[:, None], power / seen)[0]
            seen = np.maximum(shapes @ shares, LEAST * power)
        found.append(shares)
        minus_log.append(independent * float(np.sum(np.log(seen) + power / seen)))
    return found[0] if minus_log[0] < minus_log[1] - SURE else found[1]


def _slow_shapes(f: Array) -> Array:
    """1/f, white, and what a filter takes off it, (frequencies, 3)."""
    return np.stack((1.0 / f, np.ones(f.size), -(f**2)), axis=1)


def _spectrum(x: Array, rows: Rows, stretch: int) -> tuple[Array, int]:
    """The power at 0, 1, ... periods a stretch, and of how many stretches without a missing row, each half over the
    next. By its median over them: what went astray, and where the model is off, is in few."""
    window = np.hanning(stretch + 2)[1:-1]
    line = np.arange(stretch) - 0.5 * (stretch - 1)
    found = []
    for first in range(0, x.size - stretch + 1, stretch // 2):
        if rows[first + stretch - 1] - rows[first] != stretch - 1:
            continue
        part = x[first : first + stretch]
        part = part - np.mean(part) - line * (float(line @ part) / float(line @ line))
        found.append(np.abs(np.fft.rfft(part * window)) ** 2 / float(window @ window))
    if not found:
        return np.zeros(stretch // 2 + 1), 0
    return np.asarray(np.median(found, axis=0) / OF_MEDIAN, dtype=np.float64), len(found)


def _whitening(density: Array) -> NoiseColour:
    """Of noise of this density at the grid's frequencies from 0 to half a line a row, at whatever size."""
    two_sided = np.concatenate((density, density[-2:0:-1]))
    two_sided = two_sided / float(np.mean(two_sided))
    cepstrum = np.fft.ifft(-0.5 * np.log(two_sided)).real
    cepstrum[1 : GRID // 2] *= 2.0
    cepstrum[GRID // 2 + 1 :] = 0.0
    taps = np.fft.ifft(np.exp(np.fft.fft(cepstrum))).real[:TAPS]
    together = np.fft.ifft(two_sided).real[:TAPS]  # covariance of rows so far apart
    so_far = np.convolve(taps, together)[:TAPS]
    variance = np.cumsum(taps * (2.0 * so_far - taps * together[0]))
    return NoiseColour(taps, np.sqrt(variance), float(two_sided[0]))

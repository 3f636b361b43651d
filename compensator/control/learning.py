"""Iterative learning: what one repetition of a course missed is added to the reference of the next.

    c_(k+1) = c_k + W e_k,      e = wanted - measured output, c on the reference, both over the course

W is a Wiener filter of zero phase, made from the error itself: where its spectrum P stands above the floor N that the
meter's noise leaves, W = 1 - N / P; where it does not, W = 0, and nothing is learned. So noise is not learned, and no
cut-off has to be chosen: what repeats from run to run is slow, because the plate is. The floor is the median of the
upper half of the frequencies over ln 2 (a periodogram of noise is exponentially distributed, whose median is ln 2 of
its mean); P is the periodogram averaged over neighbours.

Source: D. A. Bristow, M. Tharayil, A. G. Alleyne, A survey of iterative learning control, IEEE Control Systems 26
(2006) 96, on the Q filter; N. Wiener, Extrapolation, Interpolation, and Smoothing of Stationary Time Series (1949).
"""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.functions import Array

AVERAGED = 9  # neighbouring frequencies: P is then known to a third, and still follows an error that lives below 0.1 Hz
FEWEST = 64  # readings; of fewer no floor can be told
BEYOND = 2.0  # of N: an average over nine exponentially distributed values is above it once in a hundred times


def learned(correction: Array, error: Array) -> Array:
    """The next correction, shape (rows,), rows evenly spaced in time; error: nan where there was no reading."""
    return np.asarray(correction + kept(error), dtype=np.float64)


def kept(error: Array) -> Array:
    """W e: the part of an error that stands above the noise. Shape (rows,)."""
    good = np.isfinite(error)
    if int(np.sum(good)) < FEWEST:
        return np.zeros(error.size)
    rows = np.arange(error.size)
    whole = np.interp(rows, rows[good], error[good])
    mirrored = np.concatenate((whole, whole[::-1]))  # its ends meet: no jump that a spectrum would spread
    spectrum = np.fft.rfft(mirrored)
    power = np.abs(spectrum) ** 2
    floor = float(np.median(power[power.size // 2 :])) / math.log(2.0)
    padded = np.pad(power, AVERAGED // 2, mode="reflect")
    smooth = np.convolve(padded, np.full(AVERAGED, 1.0 / AVERAGED), mode="valid")
    share = np.where(smooth > BEYOND * floor, 1.0 - floor / np.maximum(smooth, 1e-300), 0.0)
    share[_first_lost(share) :] = 0.0
    return np.asarray(np.fft.irfft(share * spectrum, mirrored.size)[: error.size], dtype=np.float64)


def _first_lost(share: Array) -> int:
    """The first frequency from which on a whole neighbourhood is noise: beyond it a peak is chance."""
    lost = np.convolve(share <= 0.0, np.ones(AVERAGED), mode="valid") >= AVERAGED
    return int(np.argmax(lost)) if np.any(lost) else share.size

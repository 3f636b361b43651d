"""Kalman filter and smoother of a process with a value and a rate, of which the value is read.

    x_k = F_k x_k-1 + w_k,  <w_k w_k'> = Q_k;     y_k = (1, 0) x_k + e_k,  <e_k^2> = v_k

F and Q of each row stand in `moves`, (rows, 7): F row by row, then Q as (value, both, rate). Where F is 0 a process
begins anew. A reading of infinite variance is none. The smoother is the adjoint of the filter (J. Durbin, S. J.
Koopman, Time Series Analysis by State Space Methods (Oxford 2012), sec. 4.4).
"""

from __future__ import annotations

import math

import numpy as np

from compensator.compiled import njit
from compensator.hysteresis.functions import Array


@njit
def filter_gains(moves: Array, variance: Array) -> Array:
    """Return of each row the gains of value and rate, 1 / standard deviation of the reading's innovation, and the
    covariance (value, both, rate) before the reading, (rows, 6)."""
    out = np.empty((moves.shape[0], 6))
    p0 = p1 = p2 = 0.0
    for k in range(moves.shape[0]):
        a, b, c, e, q0, q1, q2 = moves[k]
        p0, p1, p2 = (
            a * a * p0 + 2.0 * a * b * p1 + b * b * p2 + q0,
            a * c * p0 + (a * e + b * c) * p1 + b * e * p2 + q1,
            c * c * p0 + 2.0 * c * e * p1 + e * e * p2 + q2,
        )
        total = p0 + variance[k]
        gain, gain_rate = p0 / total, p1 / total
        out[k, 0], out[k, 1], out[k, 2] = gain, gain_rate, 1.0 / math.sqrt(total)
        out[k, 3], out[k, 4], out[k, 5] = p0, p1, p2
        p2 -= gain_rate * p1
        p1 *= 1.0 - gain
        p0 *= 1.0 - gain
    return out


@njit
def whitened(moves: Array, gains: Array, columns: Array) -> Array:
    """Return the innovations of each column over their standard deviation, (rows, columns)."""
    rows, count = columns.shape
    out = np.empty((rows, count))
    value, rate = np.zeros(count), np.zeros(count)
    for k in range(rows):
        a, b, c, e = moves[k, 0], moves[k, 1], moves[k, 2], moves[k, 3]
        gain, gain_rate, scale = gains[k, 0], gains[k, 1], gains[k, 2]
        for j in range(count):
            ahead, ahead_rate = a * value[j] + b * rate[j], c * value[j] + e * rate[j]
            innovation = columns[k, j] - ahead
            value[j] = ahead + gain * innovation
            rate[j] = ahead_rate + gain_rate * innovation
            out[k, j] = innovation * scale
    return out


@njit
def smoothed(moves: Array, gains: Array, readings: Array) -> Array:
    """Return value, rate and variance of the value of each row given all readings, (rows, 3)."""
    n = readings.size
    out = np.empty((n, 3))
    innovation = np.empty(n)
    value = rate = 0.0
    for k in range(n):
        a, b, c, e = moves[k, 0], moves[k, 1], moves[k, 2], moves[k, 3]
        value, rate = a * value + b * rate, c * value + e * rate
        out[k, 0], out[k, 1] = value, rate
        innovation[k] = readings[k] - value
        value += gains[k, 0] * innovation[k]
        rate += gains[k, 1] * innovation[k]
    r0 = r1 = n0 = n1 = n2 = 0.0  # slope and curvature of the log-likelihood of all later readings by the state
    for k in range(n - 1, -1, -1):
        gain, gain_rate, scale, p0, p1, p2 = gains[k]
        n0, n1 = n0 * (1.0 - gain) - n1 * gain_rate, n1  # through the reading: (1 - gain, 0; -gain_rate, 1)
        both = n1 * (1.0 - gain) - n2 * gain_rate
        n0 = n0 * (1.0 - gain) - both * gain_rate + scale * scale
        n1 = both
        r0 = r0 * (1.0 - gain) - r1 * gain_rate + innovation[k] * scale * scale
        out[k, 0] += p0 * r0 + p1 * r1
        out[k, 1] += p1 * r0 + p2 * r1
        out[k, 2] = p0 - p0 * p0 * n0 - 2.0 * p0 * p1 * n1 - p1 * p1 * n2
        a, b, c, e = moves[k, 0], moves[k, 1], moves[k, 2], moves[k, 3]
        r0, r1 = a * r0 + c * r1, b * r0 + e * r1
        n0, n1, n2 = (
            a * a * n0 + 2.0 * a * c * n1 + c * c * n2,
            a * b * n0 + (a * e + b * c) * n1 + c * e * n2,
            b * b * n0 + 2.0 * b * e * n1 + e * e * n2,
        )
    return out

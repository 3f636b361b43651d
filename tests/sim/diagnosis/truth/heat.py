"""Driver, plate, thermometer and the film's own lag: one system of equations, Dormand-Prince of order 5 on fine steps.

Every instant at which something jumps or is read (a row, a current that arrives late, a reading taken at another time
than its stamp) is an end of a step, so delays and skews are exact whatever the sampling. States: plate, sink,
thermometer, lagged film. Per heat capacity: a = S/C, b = R_e/C, g = G/C.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit

Array = NDArray[np.float64]
# plate: a, b, g, T_a, plate at start, I_max, gain, integral gain
# effects: delay, dead band, sink ratio, sink conductance, eps/C, drift K/s, thermometer tau, film tau, reading's step
# outside: room K, period, phase; share of g left, from, to; saturation A; bump K, at degC, width; sticking K
STAGE = np.array(
    [
        [1 / 5, 0, 0, 0, 0],
        [3 / 40, 9 / 40, 0, 0, 0],
        [44 / 45, -56 / 15, 32 / 9, 0, 0],
        [19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729, 0],
        [9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656],
    ]
)
NODE = np.array([0.0, 1 / 5, 3 / 10, 4 / 5, 8 / 9, 1.0])
LAST = np.array([35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84])


@njit(error_model="numpy")
def _slope(t: float, x: Array, current: float, p: Array, e: Array, o: Array, out: Array) -> None:
    ambient = p[3] + e[5] * t
    if o[0] != 0.0:
        ambient += o[0] * np.sin(2.0 * np.pi * t / o[1] + o[2])
    g = p[2] * o[3] if o[4] <= t < o[5] else p[2]
    far = x[1] if e[2] > 0.0 else ambient
    joule = 0.5 * p[1] * current * current
    out[0] = p[0] * current * (x[0] + 273.15) + joule - g * (x[0] - far)
    if e[4] > 0.0:
        out[0] -= e[4] * ((x[0] + 273.15) ** 4 - (ambient + 273.15) ** 4)
    out[1] = out[2] = out[3] = 0.0
    if e[2] > 0.0:
        back = -p[0] * current * (x[1] + 273.15) + joule + g * (x[0] - x[1]) - e[3] * (x[1] - ambient)
        out[1] = back / e[2]
    if e[6] > 0.0:
        out[2] = (x[0] - x[2]) / e[6]
    if e[7] > 0.0:
        out[3] = (x[0] - x[3]) / e[7]


@njit(error_model="numpy")
def _step(t: float, h: float, x: Array, current: float, p: Array, e: Array, o: Array, k: Array, trial: Array,
          order: int) -> None:  # fmt: skip
    """One step in place; order 1 is explicit Euler, for the negative control."""
    _slope(t, x, current, p, e, o, k[0])
    if order == 1:
        for m in range(4):
            x[m] += h * k[0, m]
    else:
        for i in range(5):
            for m in range(4):
                total = 0.0
                for j in range(i + 1):
                    total += STAGE[i, j] * k[j, m]
                trial[m] = x[m] + h * total
            _slope(t + NODE[i + 1] * h, trial, current, p, e, o, k[i + 1])
        for m in range(4):
            total = 0.0
            for j in range(6):
                total += LAST[j] * k[j, m]
            x[m] += h * total
    if e[2] <= 0.0:
        x[1] = p[3]
    if e[6] <= 0.0:
        x[2] = x[0]
    if e[7] <= 0.0:
        x[3] = x[0]


@njit(error_model="numpy")
def march(
    time: Array, setpoint: Array, current: Array, closed: bool, noise_K: Array, reading_time: Array, p: Array, e: Array,
    o: Array, longest_step: float, order: int,
) -> tuple[Array, Array, Array, Array, Array, Array, Array]:  # fmt: skip
    """(currents, thermometer at rows without noise, fine times, lagged film, plate, row of each fine step, fine step of
    each reading). With `closed` a PI law with feedforward of `current` makes the currents, else they are `current`.
    """
    rows = time.size
    h_max = longest_step
    for tau in (e[6], e[7]):
        if tau > 0.0:
            h_max = min(h_max, 1.5 * tau)
    room = int((max(time[-1], reading_time[-1]) - time[0]) / h_max) + 5 * rows + 100
    fine, film, plate = np.empty(room), np.empty(room), np.empty(room)
    row_of, taken = np.empty(room, np.int64), np.zeros(rows, np.int64)
    used, seen = np.empty(rows), np.empty(rows)
    x = np.array([p[4], p[3], p[4], p[4]])
    k, trial = np.empty((6, 4)), np.empty(4)
    t, n, row, acting, reading, integral, stuck = time[0], 0, 0, -1, 0, 0.0, p[4]
    live = 0.0
    fine[0], film[0], plate[0], row_of[0] = t, x[3], x[0], 0
    while True:
        while reading < rows and reading_time[reading] <= t + 1e-9:
            taken[reading] = n
            reading += 1
        if row < rows and time[row] <= t + 1e-9:
            value = x[2]
            if o[7] != 0.0:
                value += o[7] * np.exp(-0.5 * ((value - o[8]) / o[9]) ** 2)
            if o[10] > 0.0:
                stuck = min(value + o[10], max(value - o[10], stuck))
                value = stuck
            seen[row] = value
            used[row] = current[row]
            if closed:
                measured = value + noise_K[row]
                if e[8] > 0.0:
                    measured = e[8] * np.floor(measured / e[8] + 0.5)
                error = setpoint[row] - measured
                wanted = current[row] + p[6] * error + integral
                used[row] = min(p[5], max(-p[5], wanted))
                if wanted == used[row] and row > 0:
                    integral += p[7] * error * (time[row] - time[row - 1])
            row += 1
        while acting + 1 < row and time[acting + 1] + e[0] <= t + 1e-9:
            acting += 1
            live = used[acting]
            if abs(live) < e[1]:
                live = 0.0
            if o[6] > 0.0:
                live = o[6] * np.tanh(live / o[6])
        if row >= rows and reading >= rows:
            break
        until = 1e300
        if row < rows:
            until = time[row]
        if acting + 1 < row:
            until = min(until, time[acting + 1] + e[0])
        if reading < rows:
            until = min(until, reading_time[reading])
        count = max(1, int(np.ceil((until - t) / h_max - 1e-9)))
        h = (until - t) / count
        start = t
        for i in range(count):
            _step(start + i * h, h, x, live, p, e, o, k, trial, order)
            n += 1
            fine[n], film[n], plate[n], row_of[n] = start + (i + 1) * h, x[3], x[0], min(row, rows - 1)
        t = until
        fine[n] = until
    return used, seen, fine[: n + 1], film[: n + 1], plate[: n + 1], row_of[: n + 1], taken

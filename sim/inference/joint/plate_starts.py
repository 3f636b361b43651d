"""Starts for the fit of a plate: the heat balance integrated over windows, a linear regression that noise biases.

T(b) - T(a) = s K + 1/2 r Q - g Z + q U + h (b - a)
K, Q, Z, U: integrals of I (T + 273.15), I^2, T, I from a to b;  h = g T_a
"""

from __future__ import annotations

from typing import Final

import numpy as np
from scipy.optimize import nnls

from compensator.hysteresis.functions import KELVIN, Array
from compensator.thermal.plate import Kind
from sim.inference.joint.likelihood import TwoChannels

WINDOWS: Final = (0.01, 0.03, 0.1)  # of the longest stretch: long against its noise, short against its time constants
RATES_PER_S: Final = (0.003, 0.02, 0.1)  # of loss of usual plates, tried besides
SMALLEST: Final = 1e-9  # of a rate: a millionth of any plate's


def rough_balances(record: TwoChannels, kind: Kind) -> list[Array]:
    """Return (s, r, g, q, T_a) by windows of several lengths, and of a few usual plates. Raises ValueError where no
    stretch between gaps has three readings."""
    time, degC, current, read = record.time_s, record.temperature_degC, record.current_A, record.temperature_used
    assert current is not None
    stretches = [rows for rows in np.split(np.arange(time.size), record.first_rows[1:]) if np.sum(read[rows]) > 2]
    if not stretches:
        raise ValueError("records: no stretch of readings between gaps is long enough, expected at least 3 rows")
    chosen = [0, 1, 2, 4, 5] if kind == "peltier" else [3, 2, 4, 5]  # of s, r, g, q, h, -h: h may have either sign
    ambient = float(np.median([degC[rows][read[rows]][0] for rows in stretches]))
    longest = max(rows.size for rows in stretches)
    starts = []
    for share in WINDOWS:
        window = max(2, round(share * longest))
        columns, changes = [], []
        for rows in stretches:
            used = rows[read[rows]]
            t = np.interp(time[rows], time[used], degC[used])
            i, dt = current[rows][:-1], np.diff(time[rows])
            mean = 0.5 * (t[1:] + t[:-1])
            rates = np.column_stack((i * (mean + KELVIN), 0.5 * i * i, -mean, i, np.ones_like(i), -np.ones_like(i)))
            total = np.vstack((np.zeros(6), np.cumsum(rates * dt[:, None], axis=0)))
            first = np.arange(0, t.size - window, max(1, window // 4))
            columns.append(total[first + window] - total[first])
            changes.append(t[first + window] - t[first])
        m, y = np.concatenate(columns)[:, chosen], np.concatenate(changes)
        if y.size < 2 * len(chosen):
            continue
        norm = np.sqrt(np.sum(m**2, axis=0)) + 1e-300
        x = np.zeros(6)
        x[chosen] = nnls(m / norm, y)[0] / norm
        g = max(x[2], SMALLEST)
        heat = x[4] - x[5]
        starts.append(np.array([x[0], x[1], g, x[3], heat / g if abs(heat) < 1e4 * g else ambient]))
    for rate in RATES_PER_S:
        peltier, heater = (1.6e-3, 0.06, rate, 0.0, ambient), (0.0, 0.0, rate, 30.0 * rate, ambient)
        starts.append(np.array(peltier if kind == "peltier" else heater))
    for start in starts:
        place = 0 if kind == "peltier" else 3
        start[place] = max(start[place], SMALLEST)
    return starts

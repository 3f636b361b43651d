"""Kinds of hysteretic film as compiled steps: share of the transition, in decades, at a new film temperature.

kind 0, play operators with tanh envelopes.  table[0] radii, table[1] weights, table[2, :4] a_R, b_R, a_L, b_L.
kind 1, a Preisach plane with bell-shaped density: relays of half-width w whose centres are normal about mu(w) with
        spread sigma(w). All relays of one width switch as one play of T with radius w, so the integral over their
        centres is closed: table[0] w, table[1] decades, table[2] mu, table[3] sigma.
kind 2, first-order-reversal curves by interpolation between the last turning point and the one before it, along the
        major branch; its exponent grows with the distance from that branch and with the place of the reversal, so it
        does not factorize into a Preisach density. table[0] rising branch, table[1] falling branch
        (c1, k1, c2, k2, share), table[2, :3] decades, exponent, its change with the place.
kind 3, the relays of kind 1 in the mean field of all others: what has switched helps the rest to. Relays see T and
        table[4, 0] kelvin times the share that is metal, less a half (E. Della Torre's moving model, IEEE Trans. Audio
        Electroacoust. 14 (1966) 86, with temperature for the field).
kind 4, the relays of kind 1 as grains of metal in an insulator, 10^decades times less conductive, of which Bruggeman's
        effective medium of table[4, 0] dimensions conducts (D. Stroud, Phys. Rev. B 12 (1975) 3368): it percolates.
kind 5, the relays of kind 1 as a share s of metal, R^p = (1 - s) R_i(T)^p + s R_m^p with p = table[4, 0] (0: logarithms
        add) and an insulator that is table[5, 0] / T[K] decades above the metal, and sum(table[1]) at MIDDLE.
"""

from __future__ import annotations

from math import erf, sqrt, tanh

import numpy as np
from numpy.typing import NDArray

from compensator.compiled import njit

Array = NDArray[np.float64]
PLAY, PREISACH, REVERSAL, MOVING, MEDIUM, MIXED = 0, 1, 2, 3, 4, 5
MIDDLE = 60.0  # degC
DEEPEST = 400  # turning points that a reversal film can remember
COLD, HOT = -60.0, 200.0


@njit(error_model="numpy")
def _branch(x: float, c: Array) -> float:
    """A major branch: two smooth steps, from 0 at COLD to 1 at HOT."""
    low = c[4] * tanh((COLD - c[0]) * c[1]) + (1.0 - c[4]) * tanh((COLD - c[2]) * c[3])
    high = c[4] * tanh((HOT - c[0]) * c[1]) + (1.0 - c[4]) * tanh((HOT - c[2]) * c[3])
    return (c[4] * tanh((x - c[0]) * c[1]) + (1.0 - c[4]) * tanh((x - c[2]) * c[3]) - low) / (high - low)


@njit(error_model="numpy")
def _curve(table: Array, v0: float, m0: float, v1: float, m1: float, x: float) -> float:
    """The share at x on the curve from the turning point (v0, m0) back to (v1, m1)."""
    if abs(v1 - v0) < 1e-10:
        return m1
    c = table[0] if v1 > v0 else table[1]
    start = _branch(v0, c)
    span = _branch(v1, c) - start
    if abs(span) < 1e-13:
        return m0 + (m1 - m0) * (x - v0) / (v1 - v0)
    u = min(1.0, max(0.0, (_branch(x, c) - start) / span))
    q = 1.0 + table[2, 1] * abs(m0 - start) * (1.0 + table[2, 2] * (2.0 * m0 - 1.0))
    return m0 + (m1 - m0) * u**q


@njit(error_model="numpy")
def _reversal_film(table: Array, state: Array, x: float, after: Array) -> float:
    """State: count of turning points, T, share, then (T, share) of each turning point, the oldest first."""
    n, v, m = int(state[0]), state[1], state[2]
    if x == v:
        return table[2, 0] * m
    if (x > v) != (state[3 + 2 * (n - 2)] > state[3 + 2 * (n - 1)]):  # turned round here
        if n >= DEEPEST - 1:
            n -= 2
        state[3 + 2 * n], state[4 + 2 * n] = v, m
        n += 1
    rising = x > v
    while n > 2 and (x >= state[3 + 2 * (n - 2)] if rising else x <= state[3 + 2 * (n - 2)]):
        n -= 2  # a loop is closed and forgotten
    if n < 2:
        n = 2
    here = _curve(
        table, state[3 + 2 * (n - 1)], state[4 + 2 * (n - 1)], state[3 + 2 * (n - 2)], state[4 + 2 * (n - 2)], x
    )
    after[0], after[1], after[2] = float(n), x, here
    return table[2, 0] * here


@njit(error_model="numpy")
def _relays(table: Array, state: Array, x: float, after: Array) -> float:
    """Decades of all relays that see x, degC."""
    total = 0.0
    for j in range(state.size):
        z = min(x + table[0, j], max(x - table[0, j], state[j]))
        after[j] = z
        total += table[1, j] * 0.5 * (1.0 + erf((z - table[2, j]) / (sqrt(2.0) * table[3, j])))
    return total


@njit(error_model="numpy")
def _seen(table: Array, state: Array, x: float, decades: float) -> float:
    """What relays see at x in the mean field of all of them: a fixed point, since the field is weak."""
    shift, after = 0.0, np.empty(state.size)
    for _ in range(100):
        before = shift
        shift = table[4, 0] * (_relays(table, state, x + before, after) / decades - 0.5)
        if abs(shift - before) < 1e-10:
            break
    return x + shift


@njit(error_model="numpy")
def _medium(metal: float, decades: float, dimensions: float) -> float:
    """Decades by which the mixture conducts better than the insulator."""
    good = 10.0**decades
    b = (dimensions * metal - 1.0) * good + dimensions * (1.0 - metal) - 1.0
    return np.log10((b + sqrt(b * b + 4.0 * (dimensions - 1.0) * good)) / (2.0 * (dimensions - 1.0)))


@njit(error_model="numpy")
def _mixed(metal: float, decades: float, exponent: float, activation: float, x: float) -> float:
    """Decades by which the mixture conducts better than the insulator at MIDDLE."""
    gap = decades + activation * (1.0 / (x + 273.15) - 1.0 / (MIDDLE + 273.15))
    if abs(exponent) < 1e-9:
        return decades - (1.0 - metal) * gap
    return decades - np.log10((1.0 - metal) * 10.0 ** (exponent * gap) + metal) / exponent


@njit(error_model="numpy")
def share(kind: int, table: Array, state: Array, x: float, after: Array) -> float:
    """Decades of the transition at film temperature x, degC; `after` gets the memory there, and may be `state`
    itself. (With a flag in its place each of its values would be compiled apart.)"""
    if kind == REVERSAL:
        return _reversal_film(table, state, x, after)
    total = 0.0
    if kind == PLAY:
        upper = tanh(table[2, 2] * x + table[2, 3])  # gamma_L
        lower = tanh(table[2, 0] * x + table[2, 1])  # gamma_R
        for j in range(state.size):
            w = min(upper + table[0, j], max(lower - table[0, j], state[j]))
            after[j] = w
            total += table[1, j] * w
        return total
    if kind == PREISACH:
        return _relays(table, state, x, after)
    decades = np.sum(table[1])
    if kind == MOVING:
        return _relays(table, state, _seen(table, state, x, decades), after)
    if kind == MIXED:
        metal = _relays(table, state, x, after) / decades
        return _mixed(metal, decades, table[4, 0], table[5, 0], x)
    return _medium(_relays(table, state, x, after) / decades, decades, table[4, 0])


@njit(error_model="numpy")
def memoryless(form: int, d: Array, x: float) -> float:
    """D(T) in decades: 0 none, 1 linear a T, 2 arrhenius a / T[K], 3 a tanh(b T + c); plus the offset d[3]."""
    if form == 1:
        return d[0] * x + d[3]
    if form == 2:
        return d[0] / (x + 273.15) + d[3]
    if form == 3:
        return d[0] * tanh(d[1] * x + d[2]) + d[3]
    return d[3]


@njit(error_model="numpy")
def _heated(
    kind: int, table: Array, state: Array, form: int, d: Array, base: float, q: float, creep_share: float, slow: float,
    scratch: Array,
) -> float:  # fmt: skip
    """The film temperature x with x = base + q R(x), where R falls with x: one root, by a bracketed secant."""
    low, high, f_low, f_high = base, 0.0, 0.0, 0.0
    x = base
    for k in range(80):
        h = share(kind, table, state, x, scratch)
        ohm = 10.0 ** -((1.0 - creep_share) * h + creep_share * slow + memoryless(form, d, x))
        f = x - base - q * ohm
        if k == 0:
            f_low = f
            high = base + 1e-9 - f
            x = high
        elif k == 1:
            f_high = f
        elif f > 0.0:
            high, f_high, f_low = x, f, 0.5 * f_low
        else:
            low, f_low, f_high = x, f, 0.5 * f_high
        if k >= 1:
            if abs(f) < 1e-8 or high - low < 1e-8:
                return x
            x = low + (high - low) * f_low / (f_low - f_high)
    return x


@njit(error_model="numpy")
def film_path(
    kind: int, table: Array, state: Array, form: int, d: Array, time: Array, base_degC: Array, heat_K_per_ohm: Array,
    creep_share: float, creep_tau_s: float,
) -> Array:  # fmt: skip
    """log10 R along the fine path. Self-heating is solved implicitly at every step; creep is an exact lag of ramps."""
    out, scratch = np.empty(time.size), np.empty(state.size)
    slow = share(kind, table, state, base_degC[0], scratch)
    before = slow
    for i in range(time.size):
        keep = weight = 0.0
        gap = time[i] - time[i - 1] if i > 0 else 0.0
        if creep_share > 0.0 and gap > 0.0:
            keep = np.exp(-gap / creep_tau_s)
            weight = (1.0 - keep) * creep_tau_s / gap  # what the start of the ramp still weighs
        x = base_degC[i]
        q = heat_K_per_ohm[i]
        if q > 0.0:
            x = _heated(kind, table, state, form, d, x, q, creep_share, slow, scratch)
        h = share(kind, table, state, x, state)
        if creep_share > 0.0 and gap > 0.0:
            slow = keep * slow + h * (1.0 - weight) + before * (weight - keep)
        before = h
        out[i] = -((1.0 - creep_share) * h + creep_share * slow + memoryless(form, d, x))
    return out

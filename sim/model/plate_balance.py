"""The plate's heat balance with any effects of form `HeatFlow`, node by node.

    dT_p/dt = s I (T_p + 273.15) + 1/2 r I^2 + q I - g (T_p - T_a(t)) + h(t) + sum of the effects' terms

s and r are those at T_p; a body with a balance of its own gets s at its own temperature, for the current passes from
one material to the other there (`compensator.thermal.plate` has the plate's array and the slopes of s and r).

From a node until the next one the current is known, and the heating h by what else a record has (`inputs`). Without
effects a step is exact (`compensator.thermal.plate.after`); with effects it is the classical Runge-Kutta method in
steps of at most `LONGEST_STEP_S`, whose error is below 1e-8 K at the rates met. Times count from the record's first
row, so that what drifts can do so.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from llvmlite import ir  # type: ignore[import-untyped]
from numba import types
from numba.extending import intrinsic
from numpy.typing import NDArray

from compensator.compiled import njit
from compensator.hysteresis.functions import KELVIN, Array
from compensator.thermal.plate import AMBIENT, after, balance, balanced_rate, resistance, seebeck
from sim.effects.effect import HeatFlow, Switched
from sim.effects.heat_term import ARGUMENTS, SIGNATURE, heat_term

LONGEST_STEP_S = 0.5  # see above: an error below 1e-8 K


@intrinsic
def _call(typing_context: Any, address: Any, p0: Any, p1: Any, s: Any, r: Any, g: Any, a: Any, t: Any, plate: Any,
          own: Any, current: Any) -> Any:  # fmt: skip
    """Call the heat term at an address."""
    signature = types.float64(types.int64, *SIGNATURE.args)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        function = ir.FunctionType(ir.DoubleType(), [ir.DoubleType()] * ARGUMENTS)
        return builder.call(builder.inttoptr(arguments[0], function.as_pointer()), arguments[1:])

    return signature, generate


call: Any = _call


@njit
def _rates(
    par: Array,
    terms: NDArray[np.int64],
    values: Array,
    t: float,
    plate: float,
    own: Array,
    current: float,
    heating: float,
    out: Array,
) -> float:
    """Return dT_p/dt; the rates of the effects' own temperatures into out."""
    s, r, g, q = seebeck(par, plate), resistance(par, plate), par[2], par[3]
    ambient = par[AMBIENT]
    for k in range(terms.shape[0]):
        if terms[k, 2] != 0:
            ambient += call(terms[k, 2], values[k, 0], values[k, 1], s, r, g, par[AMBIENT], t, plate, own[k], current)
    driven = s * current * (plate + KELVIN) + 0.5 * r * current * current + q * current
    rate = driven - g * (plate - ambient) + heating
    for k in range(terms.shape[0]):
        out[k] = 0.0
        if terms[k, 0] != 0:
            rate += call(terms[k, 0], values[k, 0], values[k, 1], s, r, g, ambient, t, plate, own[k], current)
        if terms[k, 1] != 0:
            out[k] = call(terms[k, 1], values[k, 0], values[k, 1], s, r, g, ambient, t, plate, own[k], current)
    return float(rate)


@njit
def run(
    par: Array,
    terms: NDArray[np.int64],
    values: Array,
    time: Array,
    current: Array,
    heating: Array,
    reset: Array,
    own: Array,
    plate: Array,
    slopes: Array,
) -> None:
    """Plate temperature at the nodes, into plate (nodes,).

    par: of the plate, the slopes of s and r included. terms, values: (effects, 3), (effects, 2). time, current, heating
    (K/s, until the next): (nodes,). reset: (nodes,), where not nan the plate's temperature begins anew there (the first
    must). own: (effects,), the effects' own temperatures, at the first node, at the last on return. slopes: (nodes, 2),
    dT/dt after the node and before it, K/s.
    """
    m = terms.shape[0]
    a, b, c, d, at = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(m)
    t = reset[0]
    for k in range(time.size):
        if k > 0:
            i, known, dt = current[k - 1], heating[k - 1], time[k] - time[k - 1]
            if m == 0:
                constant, linear, square = balance(par, i)
                constant += known
                slopes[k - 1, 0] = balanced_rate(constant, linear, square, t)
                t = after(constant, linear, square, t, dt)
                slopes[k, 1] = balanced_rate(constant, linear, square, t)
            elif dt > 0.0:
                count = max(1, math.ceil(dt / LONGEST_STEP_S - 1e-9))
                h, now = dt / count, time[k - 1]
                for part in range(count):
                    e = _rates(par, terms, values, now, t, own, i, known, a)
                    if part == 0:
                        slopes[k - 1, 0] = e
                    for j in range(m):
                        at[j] = own[j] + 0.5 * h * a[j]
                    f = _rates(par, terms, values, now + 0.5 * h, t + 0.5 * h * e, at, i, known, b)
                    for j in range(m):
                        at[j] = own[j] + 0.5 * h * b[j]
                    u = _rates(par, terms, values, now + 0.5 * h, t + 0.5 * h * f, at, i, known, c)
                    for j in range(m):
                        at[j] = own[j] + h * c[j]
                    w = _rates(par, terms, values, now + h, t + h * u, at, i, known, d)
                    t += h * (e + 2.0 * f + 2.0 * u + w) / 6.0
                    for j in range(m):
                        own[j] += h * (a[j] + 2.0 * b[j] + 2.0 * c[j] + d[j]) / 6.0
                    now += h
                slopes[k, 1] = _rates(par, terms, values, time[k], t, own, i, known, a)
            else:
                slopes[k - 1, 0] = slopes[k, 1] = 0.0
            if not math.isnan(reset[k]):
                t = reset[k]
        plate[k] = t
    slopes[0, 1] = slopes[0, 0]
    slopes[time.size - 1, 0] = slopes[time.size - 1, 1]


@dataclass(frozen=True, eq=False)
class HeatFlows:
    """Effects on the plate as the compiled loop takes them."""

    terms: NDArray[np.int64]
    values: Array

    @property
    def count(self) -> int:
        return int(self.terms.shape[0])

    def also(self, heating_K_per_s: float) -> HeatFlows:
        """Return the same with a constant heating of the plate besides, last of them."""
        terms = np.vstack((self.terms, np.array([[_constant.address, 0, 0]], dtype=np.int64)))
        return HeatFlows(terms, np.vstack((self.values, np.array([[heating_K_per_s, 0.0]]))))


@heat_term
def _constant(
    heating: float, unused: float, s: float, r: float, g: float, ambient: float, time: float, plate: float, own: float,
    current: float,
) -> float:  # fmt: skip
    return heating


def heat_flows(effects: Sequence[Switched]) -> HeatFlows:
    """Return the effects of form `HeatFlow` among those given."""
    chosen = [(e.effect.form, e.par) for e in effects if isinstance(e.effect.form, HeatFlow)]
    terms = np.zeros((len(chosen), 3), dtype=np.int64)
    values = np.zeros((len(chosen), 2))
    for k, (form, par) in enumerate(chosen):
        if par.size > 2:
            raise ValueError("an effect on the heat balance has at most two parameters")
        values[k, : par.size] = par
        for place, term in enumerate((form.plate_rate, form.own_rate, form.ambient)):
            terms[k, place] = 0 if term is None else term.address
    return HeatFlows(terms, values)


def rate_K_per_s(
    par: Array, heat: HeatFlows, time_s: float, plate_degC: float, own_degC: Array, current: float
) -> float:
    """Return dT_p/dt with the effects at one moment; par: of the plate, the slopes included."""
    return float(_rates(par, heat.terms, heat.values, time_s, plate_degC, own_degC, current, 0.0, np.empty(heat.count)))

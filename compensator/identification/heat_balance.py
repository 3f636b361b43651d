"""The simulation error of a plate's heat balance, its derivatives, and the descent to its minimum.

    dT/dt = s I (T + 273.15) + 1/2 r I^2 + q I - g T + h

A heater has s = r = 0, a Peltier plate q = 0. A thermometer that lags by tau shows dM/dt = (T - M) / tau instead of T;
at the first row of a stretch the two are the same. The simulation runs over each stretch between gaps from a first
temperature of its own, which enters linearly and is projected out (variable projection: G. Golub, V. Pereyra, Inverse
Problems 19 (2003) R1). Starts come from the balance integrated over windows, a linear regression that noise biases.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import nnls

from compensator.compiled import njit
from compensator.hysteresis.functions import KELVIN, Array
from compensator.identification.levenberg_marquardt import Linearized, descend, held_at_bounds

Kind = Literal["peltier", "heater"]
PLACES: Final = {"peltier": (0, 1, 2, 4), "heater": (3, 2, 4)}  # fitted ones of (s, r, g, q, h, tau)
LAG_PLACE: Final = 5
SMALLEST: Final = 1e-9  # of the rates s (1/(A s)) and q (K/s): a millionth of any plate's, and no division by zero
LEAST: Final = np.array([SMALLEST, 0.0, 0.0, SMALLEST, -math.inf, 0.0])  # of par; h is free
NO_MOST: Final = np.full(6, math.inf)
SETTLED: Final = 1e-9  # of the cost: a step that gains less is the last
USUAL_AMBIENT_DEGC: Final = (25.0, 15.0)  # and its spread
USUAL_SHARE: Final = (0.4, 0.3)  # r I_max / (300 K s), and its spread


@njit
def simulate_with_slopes(par: Array, first: float, steps: Array, current: Array, out: Array, slopes: Array) -> None:
    """Readings (n,) and slopes (n, 7): d/d(s, r, g, q, h, tau) and d/d(first); par = (s, r, g, q, h, tau).

    The plate's steps are exact; behind a lag its course within a step is taken as straight.
    """
    s, r, g, q, h, tau = par[0], par[1], par[2], par[3], par[4], par[5]
    t = shown = first
    d = np.zeros(7)
    d[6] = 1.0
    ds = d.copy()
    before = d.copy()
    for k in range(out.size):
        out[k] = shown
        for j in range(7):
            slopes[k, j] = ds[j]
        if k + 1 < out.size:
            i, dt, t_before = current[k], steps[k], t
            before[:] = d
            decay = g - s * i
            forcing = s * KELVIN * i + 0.5 * r * i * i + q * i + h
            x = decay * dt
            keep = math.exp(-x)
            if abs(x) < 1e-4:
                rest = dt * (1.0 - 0.5 * x + x * x / 6.0)
                rest_slope = -dt * dt * (0.5 - x / 3.0 + 0.125 * x * x)
            else:
                rest = -math.expm1(-x) / decay
                rest_slope = (dt * keep - rest) / decay
            by_decay = -dt * keep * t + forcing * rest_slope
            t = t * keep + forcing * rest
            for j in range(7):
                d[j] *= keep
            d[0] += rest * KELVIN * i - by_decay * i
            d[1] += rest * 0.5 * i * i
            d[2] += by_decay
            d[3] += rest * i
            d[4] += rest
            if tau <= 0.0:
                shown = t
                ds[:] = d
                continue
            share, fade = tau / dt, math.exp(-dt / tau)
            behind = shown - t_before + share * (t - t_before)
            for j in range(7):
                ds[j] = d[j] - share * (d[j] - before[j]) + fade * (ds[j] - before[j] + share * (d[j] - before[j]))
            ds[5] += (fade - 1.0) * (t - t_before) / dt + behind * fade * dt / (tau * tau)
            shown = t - share * (t - t_before) + behind * fade


@dataclass(frozen=True, eq=False)
class Stretch:
    """Rows between two gaps: of which record, first row, steps (s), current (A), temperature (degC), which are used."""

    record: int
    first: int
    steps: Array
    current: Array
    temperature: Array
    used: NDArray[np.bool_]


@dataclass(frozen=True, eq=False)
class Trial:
    """par = (s, r, g, q, h, tau); residual, Huber weights and projected jacobian over the used readings."""

    par: Array
    firsts: Array
    cost: float
    residual: Array
    weights: Array
    jacobian: Array


def rough_balances(stretches: Sequence[Stretch], kind: Kind) -> list[Array]:
    """(s, r, g, q, h, 0) from the balance integrated over windows of several lengths, and a few typical plates."""
    starts = []
    longest = max(stretch.used.size for stretch in stretches)
    places = PLACES[kind]
    ambient = float(np.median([stretch.temperature[stretch.used][0] for stretch in stretches]))
    for share in (0.01, 0.03, 0.1):
        window = max(2, round(share * longest))
        columns, targets = [], []
        for stretch in stretches:
            rows = np.flatnonzero(stretch.used)
            clock = np.concatenate(([0.0], np.cumsum(stretch.steps)))
            t = np.interp(clock, clock[rows], stretch.temperature[rows])
            i, dt = stretch.current[:-1], stretch.steps
            mean = 0.5 * (t[1:] + t[:-1])
            rates = np.column_stack((i * (mean + KELVIN), 0.5 * i * i, -mean, i, np.ones_like(i), -np.ones_like(i)))
            total = np.vstack((np.zeros(6), np.cumsum(rates * dt[:, None], axis=0)))
            first = np.arange(0, t.size - window, max(1, window // 4))
            columns.append(total[first + window] - total[first])
            targets.append(t[first + window] - t[first])
        m, y = np.concatenate(columns), np.concatenate(targets)
        chosen = [*places, 5]
        if y.size < 2 * len(chosen):
            continue
        norm = np.sqrt(np.sum(m[:, chosen] ** 2, axis=0)) + 1e-300
        x = np.zeros(6)
        x[chosen] = nnls(m[:, chosen] / norm, y)[0] / norm
        starts.append(np.append(x[:4], x[4] - x[5]))
    for rate in (0.003, 0.02, 0.1):
        typical = np.array([1.6e-3, 0.06, rate, 0.0, rate * ambient])
        starts.append(typical if kind == "peltier" else np.array([0.0, 0.0, rate, 30.0 * rate, rate * ambient]))
    least = np.zeros(4)
    least[places[0]] = SMALLEST
    return [np.concatenate((np.maximum(start[:4], least), [start[4], 0.0])) for start in starts]


class SimulationError:
    """The simulation error as a function of (s, r, g, q, h, tau), of which `places` are fitted."""

    def __init__(
        self,
        stretches: Sequence[Stretch],
        places: tuple[int, ...],
        limit: float = math.inf,
        one_reading: float = 0.0,
    ) -> None:
        """limit: Huber's, K. one_reading: the weight of what plates have in common, K^2."""
        self.stretches, self.places, self.limit, self.one_reading = stretches, list(places), limit, one_reading
        self.largest = max(float(np.max(np.abs(stretch.current))) for stretch in stretches)

    def usual(self, par: Array) -> tuple[Array, Array]:
        """How far par is from usual plates, in spreads, and the derivatives by the fitted parameters."""
        s, r, g, _, h, _ = par
        values, slopes = [], np.zeros((2, 6))
        loss = max(float(g), 1e-7)
        values.append((h / loss - USUAL_AMBIENT_DEGC[0]) / USUAL_AMBIENT_DEGC[1])
        slopes[0, 4] = 1.0 / (loss * USUAL_AMBIENT_DEGC[1])
        slopes[0, 2] = -h / (loss * loss * USUAL_AMBIENT_DEGC[1])
        if 0 not in self.places:
            return np.array(values), slopes[:1, self.places]
        pump = 300.0 * max(float(s), 1e-7) / self.largest
        values.append((r / pump - USUAL_SHARE[0]) / USUAL_SHARE[1])
        slopes[1, 1] = 1.0 / (pump * USUAL_SHARE[1])
        slopes[1, 0] = -r / (pump * max(float(s), 1e-7) * USUAL_SHARE[1])
        return np.array(values), slopes[:, self.places]

    def evaluate(self, par: Array) -> Trial:
        """Residuals and derivatives, each stretch's first temperature at its best."""
        residuals, weights, jacobians, firsts = [], [], [], []
        for stretch in self.stretches:
            used = stretch.used
            out, slopes = np.empty(used.size), np.empty((used.size, 7))
            simulate_with_slopes(par, 0.0, stretch.steps, stretch.current, out, slopes)
            e, away = slopes[used, 6], stretch.temperature[used] - out[used]
            w = np.ones_like(e)
            if not np.all(np.isfinite(away)):
                return Trial(par, np.empty(0), math.inf, np.empty(0), np.empty(0), np.empty((0, 0)))
            for _ in range(1 if self.limit == math.inf else 4):
                first = float((w * e) @ away) / max(float((w * e) @ e), 1e-300)
                residual = away - first * e
                w = np.minimum(1.0, self.limit / np.maximum(np.abs(residual), 1e-300))
            simulate_with_slopes(par, first, stretch.steps, stretch.current, out, slopes)
            jacobian = slopes[used][:, self.places]
            jacobian -= np.outer(e, (w * e) @ jacobian) / max(float((w * e) @ e), 1e-300)
            residuals.append(residual)
            weights.append(w)
            jacobians.append(jacobian)
            firsts.append(first)
        residual, w = np.concatenate(residuals), np.concatenate(weights)
        size = np.abs(residual)
        beyond = self.limit * (2.0 * size - self.limit) if self.limit < math.inf else size
        cost = float(np.sum(np.where(w < 1.0, beyond, size * size)))
        if self.one_reading > 0.0:
            cost += self.one_reading * float(np.sum(self.usual(par)[0] ** 2))
        return Trial(par, np.array(firsts), cost, residual, w, np.concatenate(jacobians))

    def descend(self, best: Trial, steps: int) -> Trial:
        """The minimum reached from a trial; rates stay >= 0, h is free."""
        if best.cost == math.inf:
            return best

        def settled(before: float, after: float) -> bool:
            return not after < before * (1.0 - SETTLED)

        return descend(best, steps, lambda at: at.cost, self._linearized, settled)

    def _linearized(self, at: Trial) -> Linearized[Trial]:
        weighted = at.weights[:, None] * at.jacobian
        normal, gradient = weighted.T @ at.jacobian, weighted.T @ at.residual
        if self.one_reading > 0.0:
            away, slopes = self.usual(at.par)
            normal += self.one_reading * slopes.T @ slopes
            gradient -= self.one_reading * slopes.T @ away
        now, least = at.par[self.places], LEAST[self.places]
        held_at_bounds(normal, gradient, now, least, NO_MOST[self.places])

        def moved(step: Array) -> Trial:
            par = at.par.copy()
            par[self.places] = np.maximum(now + step, least)
            return self.evaluate(par)

        return Linearized(normal, gradient, np.diag(normal) + (np.diag(normal) <= 0.0), moved)

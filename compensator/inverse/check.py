"""What a film model lets one expect of its inverse, checked before anything is commanded: `check_model`.

Each finding says what, where, and what to do about it. Behind the kinds:

    order               gamma_R(v) - r <= gamma_L(v) + r for every operator of positive weight (below paper eq (6));
                        where it fails the output jumps at every reversal. Smallest allowed radius:
                        max over v of (gamma_R - gamma_L) / 2.
    not_monotone        along a branch the output's slope D' + sum of the moving p_j gamma' can be negative: certain
                        where D' < 0, as right after a reversal operators stand still; on the major loop it is
                        where all move.
    stands_still        after a reversal from the major loop every operator stands still over this interval: only D
                        moves the output there, and the iteration (20) cannot converge, however small D is.
    iteration           eqs (21), (26), (27) with |dD/dv|, which they need: the paper's fixed point contracts by
                        q = max |dD/dv| / (p(r_0) min(gamma_R', gamma_L')) where q < 1. What is left when
                        |v_n - v_(n-1)| < sigma is at most sigma q / (1 - q), not sigma.
    iteration_undefined p(r_0) is the weight of radius 0 and divides: without it there is no eq (15). With
                        gamma_R != gamma_L eq (14) needs the memory of eq (6), not one of its own.

None of these limits `compensator.inverse.inverse`, except that outputs inside a jump cannot be reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from compensator.hysteresis.film import LEAST_JUMP, FilmModel
from compensator.hysteresis.functions import Array, envelope, envelope_inverse, memoryless
from compensator.inverse.inverse import Inverse

Kind = Literal["order", "not_monotone", "stands_still", "iteration", "iteration_undefined"]
GRID: Final = 20001  # temperatures: 5 mK apart over 100 K, finer than any envelope bends
ROUNDING: Final = 1e-12  # of slopes and margins that are 0 but for the last bits of their sums


@dataclass(frozen=True)
class Finding:
    """Finding about a film model: what in words with numbers, where_degC (None: everywhere), operators by index."""

    kind: Kind
    what: str
    where_degC: tuple[float, float] | None
    operators: tuple[int, ...]
    advice: str


@dataclass(frozen=True)
class Contraction:
    """Convergence of the paper's iteration on a temperature range, with |dD/dv| for dD/dv: eqs (21), (26).

    q: contraction factor over the whole range, inf if an envelope is flat or p(r_0) is missing. converges_degC: the
    longest interval in which q < 1; None if there is none.
    """

    q: float
    converges_degC: tuple[float, float] | None

    def error_bound_K(self, sigma_K: float) -> float:
        """Return the bound of the error when two iterates differ by less than sigma: sigma q / (1 - q)."""
        return sigma_K * self.q / (1.0 - self.q) if self.q < 1.0 else math.inf


@dataclass(frozen=True)
class ModelCheck:
    """Findings on a film model.

    order_margin: shape (operators,), negative where the order condition fails. least_radius: the smallest allowed
    radius of each operator, in the unit of the envelopes' values. output_range: of the major loop, in the output's
    unit.
    """

    findings: tuple[Finding, ...]
    order_margin: Array
    least_radius: Array
    contraction: Contraction
    output_range: tuple[float, float]

    def kinds(self) -> tuple[Kind, ...]:
        """Return the kinds of findings, in order."""
        return tuple(finding.kind for finding in self.findings)


def check_model(model: FilmModel, low_degC: float, high_degC: float) -> ModelCheck:
    """Return every finding on a film model between two temperatures. ValueError unless low < high, both finite."""
    inverse = Inverse(model, low_degC, high_degC)
    v = np.linspace(low_degC, high_degC, GRID)
    excess, worst = _excess(model, v)
    margin, least = 2.0 * (model.radii - 0.5 * excess), np.maximum(0.5 * excess, 0.0)
    contraction = _contraction(model, v)
    findings = [
        *_order(model, margin, least, worst),
        *_not_monotone(model, inverse, v),
        *_stands_still(model, low_degC, high_degC),
        *_iteration(model, contraction, excess),
    ]
    return ModelCheck(tuple(findings), margin, least, contraction, _major_loop(model, inverse))


def _rows(model: FilmModel) -> Array:
    return np.asarray(np.broadcast_to(model.envelopes, (model.operators, 6)))


def _excess(model: FilmModel, v: Array) -> tuple[Array, Array]:
    """Return max over v of gamma_R - gamma_L for each operator, and where (degC)."""
    most, where = np.empty(len(model.envelopes)), np.empty(len(model.envelopes))
    for k, row in enumerate(model.envelopes):
        difference = _values(row[:3], v)[0] - _values(row[3:], v)[0]
        most[k], where[k] = difference.max(), v[int(difference.argmax())]
    shape = (model.operators,)
    return np.array(np.broadcast_to(most, shape)), np.array(np.broadcast_to(where, shape))


def _values(row: Array, v: Array) -> tuple[Array, Array]:
    """Return values and slopes of an envelope (code, a, b)."""
    pairs = np.array([envelope(row[0], row[1], row[2], float(x)) for x in v])
    return pairs[:, 0], pairs[:, 1]


def _order(model: FilmModel, margin: Array, least: Array, worst: Array) -> list[Finding]:
    failing = np.flatnonzero((margin < -ROUNDING) & (model.weights > 0.0))
    if not failing.size:
        return []
    jump = float(np.sum(model.weights[failing] * -margin[failing]))
    if jump <= LEAST_JUMP * float(np.sum(model.weights)):
        return []
    k = int(failing[np.argmin(margin[failing])])
    what = (
        f"{failing.size} operators of positive weight violate the order condition, radius {model.radii[k]:g} by most "
        f"({-margin[k]:.3g} at {worst[k]:.1f} degC): the output jumps by up to {jump:.3g} at a reversal, and targets "
        "inside a jump cannot be reached"
    )
    where = float(worst[failing].min()), float(worst[failing].max())
    advice = f"use radii from {least[failing].max():.3f} on, or envelopes that lie closer together"
    return [Finding("order", what, where, tuple(int(j) for j in failing), advice)]


def _not_monotone(model: FilmModel, inverse: Inverse, v: Array) -> list[Finding]:
    slope = np.array([memoryless(model.memoryless.code, model.memoryless_array, float(x))[1] for x in v])
    falling = np.flatnonzero(slope < -ROUNDING)
    if inverse.least_slope >= 0.0 or not falling.size:
        return []
    where = float(v[falling[0]]), float(v[falling[-1]])
    all_moving = slope + min(
        (_moving_slope(model, v, first) for first in (0, 3)), key=lambda s: float((s + slope).min())
    )
    down = np.flatnonzero(all_moving < -ROUNDING)
    loop = "; not on the major loop, where all operators move"
    if down.size:
        loop = f", and on the major loop between {v[down[0]]:.1f} and {v[down[-1]]:.1f} degC"
    what = (
        f"D(T) falls by up to {-slope.min():.2g} per K: after a reversal the output moves against the temperature{loop}"
    )
    advice = "a target can have several temperatures, or none: choose one by `Inverse.choice`, or narrow the limits"
    return [Finding("not_monotone", what, where, (), advice)]


def _moving_slope(model: FilmModel, v: Array, first: int) -> Array:
    """Return sum_j p_j gamma_j' on one branch if every operator moves."""
    if len(model.envelopes) == 1:
        return np.asarray(float(model.weights.sum()) * _values(model.envelopes[0, first : first + 3], v)[1])
    total = np.zeros(v.size)
    for weight, row in zip(model.weights, model.envelopes, strict=True):
        total += weight * _values(row[first : first + 3], v)[1]
    return total


def _stands_still(model: FilmModel, low: float, high: float) -> list[Finding]:
    """Find the longest interval over which no operator of positive weight moves after a reversal on the major loop."""
    longest: tuple[float, float] = (0.0, 0.0)
    moving = [(r, row) for r, p, row in zip(model.radii, model.weights, _rows(model), strict=True) if p > 0.0]
    for turn in np.linspace(low, high, 201):
        ends = []
        for radius, (code_r, a_r, b_r, code_l, a_l, b_l) in moving:
            risen = envelope(code_r, a_r, b_r, float(turn))[0] - radius  # turned down here, it waits for this value
            ends.append(envelope_inverse(code_l, a_l, b_l, risen - radius))
        end = max(min(max(ends, default=low), float(turn)), low)
        if turn - end > longest[1] - longest[0]:
            longest = end, float(turn)
    width = longest[1] - longest[0]
    if width <= 1e-9 * (high - low):
        return []
    what = f"turned down at {longest[1]:.1f} degC, all operators stand still for {width:.2g} K: only D moves the output"
    advice = "expect no response to small reversals there; the iteration (20) cannot converge, `Inverse` does"
    return [Finding("stands_still", what, longest, (), advice)]


def _contraction(model: FilmModel, v: Array) -> Contraction:
    at_zero = np.flatnonzero(model.radii == 0.0)
    slope_d = np.array([abs(memoryless(model.memoryless.code, model.memoryless_array, float(x))[1]) for x in v])
    if not at_zero.size or float(model.weights[at_zero].sum()) == 0.0 or len(model.envelopes) > 1:
        return Contraction(math.inf if slope_d.max() > 0.0 else 0.0, None)
    row = model.envelopes[0]
    flattest = np.minimum(_values(row[:3], v)[1], _values(row[3:], v)[1])
    p_0 = float(model.weights[at_zero].sum())
    with np.errstate(divide="ignore"):
        local = np.where(slope_d > 0.0, slope_d / np.maximum(p_0 * flattest, 1e-300), 0.0)
    q = float(slope_d.max() / max(p_0 * float(flattest.min()), 1e-300)) if slope_d.max() > 0.0 else 0.0
    good = np.concatenate([[False], local < 1.0, [False]])
    starts, stops = np.flatnonzero(good[1:] & ~good[:-1]), np.flatnonzero(~good[1:] & good[:-1])
    if not starts.size:
        return Contraction(q, None)
    k = int(np.argmax(stops - starts))
    return Contraction(q, (float(v[starts[k]]), float(v[stops[k] - 1])))


def _iteration(model: FilmModel, contraction: Contraction, excess: Array) -> list[Finding]:
    advice = "`compensator.inverse.inverse` needs none of this"
    findings = []
    if not np.any((model.radii == 0.0) & (model.weights > 0.0)):
        what = f"the smallest radius is {model.radii.min():g}: p(r_0), by which eq (15) divides, is undefined"
        findings.append(Finding("iteration_undefined", what, None, (), advice))
    elif len(model.envelopes) > 1:
        what = "operators have different envelopes: eqs (12), (14) need one pair for all"
        findings.append(Finding("iteration_undefined", what, None, (), advice))
    elif not np.array_equal(model.envelopes[0, :3], model.envelopes[0, 3:]):
        size = float(excess.max())
        what = f"the envelopes differ (by up to {size:.3g}): eq (12) fails, and eq (14) needs the memory of eq (6)"
        findings.append(Finding("iteration_undefined", what, None, (), advice))
    if contraction.q >= 1.0:
        where = contraction.converges_degC
        text = f"only between {where[0]:.1f} and {where[1]:.1f} degC" if where else "nowhere"
        what = f"the fixed point contracts {text} (q < 1, with |dD/dv|)"
        findings.append(Finding("iteration", what, where, (), advice))
    elif contraction.q > 0.5:
        what = (
            f"q = {contraction.q:.3g}: stopped at sigma, the error is up to {contraction.error_bound_K(1.0):.3g} sigma"
        )
        findings.append(Finding("iteration", what, None, (), f"stop at a smaller sigma, or {advice}"))
    return findings


def _major_loop(model: FilmModel, inverse: Inverse) -> tuple[float, float]:
    hot = inverse.reachable_interval(model.initial_memory(inverse.high_degC, "cooled"))
    cold = inverse.reachable_interval(model.initial_memory(inverse.low_degC, "heated"))
    return min(hot[0], cold[0]), max(hot[1], cold[1])

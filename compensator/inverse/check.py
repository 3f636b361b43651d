"""What a film model lets one expect of its inverse, checked before anything is commanded: `check_model`.

Each finding says what, where, and what to do about it. Behind the kinds:

    order               gamma_R(v) - r <= gamma_L(v) + r for every operator of positive weight (below paper eq (6));
                        where it fails the output jumps at every reversal. Smallest allowed radius:
                        max over v of (gamma_R - gamma_L) / 2.
    not_monotone        along a branch the output's slope D' + sum of the moving p_j gamma' can be negative: certain
                        where D' < 0, as right after a reversal operators stand still; on the major loop it is
                        where all move.
    stands_still        after a reversal from the major loop every operator stands still over this interval: only D,
                        if the film has one, moves the output there.

None of these limits `compensator.inverse.inverse`, except that outputs inside a jump cannot be reached.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from compensator.hysteresis.film import FilmModel, reversal_jumps
from compensator.hysteresis.functions import Array, envelope, envelope_inverse, memoryless
from compensator.inverse.inverse import Inverse

Kind = Literal["order", "not_monotone", "stands_still"]
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


def check_model(model: FilmModel, low_degC: float, high_degC: float) -> tuple[Finding, ...]:
    """Return every finding on a film model between two temperatures. ValueError unless low < high, both finite."""
    inverse = Inverse(model, low_degC, high_degC)
    return (
        *_order(model, low_degC, high_degC),
        *_not_monotone(model, inverse, np.linspace(low_degC, high_degC, GRID)),
        *_stands_still(model, low_degC, high_degC),
    )


def _order(model: FilmModel, low_degC: float, high_degC: float) -> list[Finding]:
    count, jump = reversal_jumps(model, low_degC, high_degC)
    if count == 0:
        return []
    margin = np.where(model.weights > 0.0, model.order_margin(low_degC, high_degC), math.inf)
    failing = np.flatnonzero(margin < 0.0)
    k = int(np.argmin(margin))
    what = (
        f"{count} operators of positive weight violate the order condition, radius {model.radii[k]:g} by most "
        f"({-margin[k]:.3g}): the output jumps by up to {jump:.3g} at a reversal, and targets inside a jump cannot be "
        "reached"
    )
    least = float(np.max((model.radii - 0.5 * margin)[failing]))
    advice = f"use radii from {least:.3f} on, or envelopes that lie closer together"
    return [Finding("order", what, None, tuple(int(j) for j in failing), advice)]


def _not_monotone(model: FilmModel, inverse: Inverse, v: Array) -> list[Finding]:
    slope = np.array([memoryless(model.memoryless.code, model.memoryless_array, float(x))[1] for x in v])
    falling = np.flatnonzero(slope < -ROUNDING)
    if inverse.least_slope >= 0.0 or not falling.size:
        return []
    where = float(v[falling[0]]), float(v[falling[-1]])
    up, _ = model.simulate(v, model.initial_memory(float(v[0]), "heated"))
    down, _ = model.simulate(v[::-1], model.initial_memory(float(v[-1]), "cooled"))
    steps = np.minimum(np.diff(up), np.diff(down[::-1]))
    at = v[:-1][steps < -ROUNDING * float(np.max(np.abs(up)))]
    loop = (
        f", and on the major loop between {at[0]:.1f} and {at[-1]:.1f} degC" if at.size else "; not on the major loop"
    )
    what = (
        f"D(T) falls by up to {-slope.min():.2g} per K: after a reversal the output moves against the temperature{loop}"
    )
    advice = "the film model is poor there, as after a fit to a film or a thermometer that lags: a target there can "
    advice += "have several temperatures, or none; calibrate with slower ramps, or keep targets out of there"
    return [Finding("not_monotone", what, where, (), advice)]


def _stands_still(model: FilmModel, low: float, high: float) -> list[Finding]:
    """Find the longest interval over which no operator of positive weight moves after a reversal on the major loop."""
    longest: tuple[float, float] = (0.0, 0.0)
    rows = np.broadcast_to(model.envelopes, (model.operators, 6))
    moving = [(r, row) for r, p, row in zip(model.radii, model.weights, rows, strict=True) if p > 0.0]
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
    moved = "does not change" if model.memoryless.function == "none" else "changes by D(T) only, without hysteresis,"
    what = f"after a turn from heating to cooling at {longest[1]:.1f} degC the model's output {moved} for {width:.2g} K"
    advice = "expect no response to small reversals there"
    return [Finding("stands_still", what, longest, (), advice)]

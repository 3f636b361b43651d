"""What papers on such films report: where it switches on heating and on cooling, how sharply, how wide the loop is.

    transition temperature   where |d log10 R / dT| is largest, on the major branch of each sense
    width                    full width at half maximum of that peak
    hysteresis               difference of both transition temperatures
    midpoint                 where log10 R is halfway between its values at the ends of what both branches have
    decades                  change of log10 R between these ends
    activation energy        of the insulating side (`activation`)

Of another output than a resistance the same is reported. Each number comes with a 95 % interval that
holds the noise of both instruments with its memory, as the record shows it (`branch_shape`, `local_fit`), and not what
shifts a whole branch: a thermometer that lags behind the film shows what the film had before, so that heating moves
down and cooling up by the rate times its lag; a film that lags behind the thermometer, the other way. Where the record
does not determine a number, it says why.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from compensator.hysteresis.functions import Array
from sim.inference.quantity import Quantity, told, untold
from sim.inference.transition.activation import Activation, activation_of
from sim.inference.transition.branch_shape import BranchShape, shape_of
from sim.inference.transition.major_branch import WHOLE, MajorBranch, Sense, major_branches

SENSES: Final[tuple[Sense, Sense]] = ("heating", "cooling")
NOT_ASKED: Final = "the output is no resistance"


@dataclass(frozen=True, eq=False)
class Transition:
    """The numbers of a record's major loop by name (unit at its end), and the branches that they were read off.

    in_decades: the output is -log10(R / 1 ohm), so that slopes and changes are decades.
    """

    quantities: dict[str, Quantity]
    shapes: dict[Sense, BranchShape]
    activation: Activation | None
    in_decades: bool
    range_degC: tuple[float, float]

    def rates_K_per_s(self) -> dict[Sense, float]:
        """The median rate of each branch, > 0."""
        return {sense: shape.branch.rate_K_per_s for sense, shape in self.shapes.items()}

    def shift_K(self, lag_s: float) -> float:
        """By how much a thermometer's lag behind the film makes the loop look narrower; a film's behind it, wider."""
        return lag_s * sum(self.rates_K_per_s().values())


def transition(
    time_s: ArrayLike, temperature_degC: ArrayLike, output: ArrayLike, *, in_decades: bool = True, seed: int = 0
) -> Transition:
    """Of a record: arrays of shape (rows,), s, degC, and -log10(R / 1 ohm) or (not in_decades) another output; nan
    where there is none. seed: of the draws that give the intervals."""
    branches = major_branches(time_s, temperature_degC, output)
    shapes = {sense: shape_of(branch, seed + k) for k, (sense, branch) in enumerate(branches.items())}
    found: dict[str, Quantity] = {}
    for sense in SENSES:
        missing = untold(_no_branch(sense))
        shape = shapes.get(sense)
        found[f"{sense}_degC"] = shape.steepest_degC if shape else missing
        found[f"width_{sense}_K"] = shape.width_K if shape else missing
    low, high = _common(list(branches.values()))
    found["hysteresis_K"] = _between(found, shapes, "heating_degC", "cooling_degC")
    for sense in SENSES:
        shape = shapes.get(sense)
        found[f"midpoint_{sense}_degC"] = shape.crossing(low, high) if shape else untold(_no_branch(sense))
    found["hysteresis_at_midpoint_K"] = _difference(found["midpoint_heating_degC"], found["midpoint_cooling_degC"])
    found["change_dec" if in_decades else "change"] = _change(shapes, low, high)
    activation = None
    if in_decades and shapes:
        logs = [-shape.branch.output for shape in shapes.values()]
        activation = activation_of(list(shapes.values()), logs, seed)
    reason = "there is no major branch" if in_decades else NOT_ASKED
    found["activation_energy_eV"] = activation.energy_eV if activation else untold(reason)
    return Transition(found, shapes, activation, in_decades, (low, high))


def _no_branch(sense: Sense) -> str:
    return f"no run of {sense} goes through {WHOLE:.0%} of the record's range at once"


def _common(branches: list[MajorBranch]) -> tuple[float, float]:
    """The range that all branches have, degC."""
    if not branches:
        return float("nan"), float("nan")
    low = max(float(branch.temperature_degC.min()) for branch in branches)
    return low, min(float(branch.temperature_degC.max()) for branch in branches)


def _between(found: dict[str, Quantity], shapes: dict[Sense, BranchShape], above: str, below: str) -> Quantity:
    """The difference of both steepest places: their draws are independent."""
    one, other = found[above].value, found[below].value
    if one is None or other is None:
        return untold(found[above].reason or found[below].reason)
    return told(one - other, shapes["heating"].steepest_draws - shapes["cooling"].steepest_draws)


def _difference(one: Quantity, other: Quantity) -> Quantity:
    """Of two numbers with independent errors."""
    if one.value is None or other.value is None or one.ci95 is None or other.ci95 is None:
        return untold(one.reason or other.reason)
    half = float(np.hypot(one.ci95[1] - one.value, other.ci95[1] - other.value))
    value = one.value - other.value
    return Quantity(value, (value - half, value + half))


def _change(shapes: dict[Sense, BranchShape], low: float, high: float) -> Quantity:
    """By how much the output changes over the range: decades that R falls by (below 0 where it rises), or the output's
    own rise. The mean over the branches."""
    if not shapes:
        return untold("there is no major branch")
    values, draws = [], []
    for shape in shapes.values():
        (cold, cold_draws), (hot, hot_draws) = shape.at(low), shape.at(high)
        values.append(hot - cold)
        draws.append(hot_draws - cold_draws)
    value, drawn = float(np.mean(values)), np.mean(draws, axis=0)
    return told(value, drawn)


def slope_curve(shape: BranchShape, in_decades: bool) -> tuple[Array, Array, Array]:
    """(degC, d log10 R / dT or d output / dT, half its 95 % band): the derivative as papers draw it."""
    return shape.degC, (-shape.slope if in_decades else shape.slope), shape.slope_half_width

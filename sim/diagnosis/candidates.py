"""Candidates of a search: effects at several starting sizes, ranked by the gain that each promises.

A score test (C. R. Rao, Proc. Camb. Phil. Soc. 44 (1948) 50) with secants: one simulation with the effect at a size
gives its direction in both channels; whitened, and with all free parameters and the film's weights projected off, it
promises a gain of log-likelihood. A derivative at nothing would not do: a dead band has none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from compensator.hysteresis.functions import Array
from sim.effects.effect import Effect, Reading, pinned
from sim.inference.joint.likelihood import BESIDE, Fit, Joint, Point
from sim.inference.noise import Metric

SIZES: Final = 4  # starting sizes of a parameter, over its typical range
SIZES_OF_SEVERAL: Final = 3  # the same of each parameter where there are several
RIDGE: Final = 1e-9  # relative: of what the record does not determine
LEAST: Final = 1e-6  # of a whitened change's square: rounding
MOST_SCALED: Final = 3.0  # factor by which a promising size may be moved at once
AT_END: Final = 0.01  # of the range of a fit: so close to its end a size would go on
SMALLEST_SHARE: Final = 0.5  # of the smallest typical size, below which an effect has no physical meaning


@dataclass(frozen=True)
class Start:
    """An effect (with the choice of its discrete parameters made) at a size; promised: gain of log-likelihood;
    amplitude: how many times this size the score asks for."""

    effect: Effect
    values: tuple[float, ...]
    promised: float = 0.0
    amplitude: float = 1.0

    @property
    def free(self) -> int:
        """How many parameters a fit moves."""
        return sum(len(p.choices) != 1 for p in self.effect.parameters)

    def scaled(self) -> Start:
        """At the size that the score asks for, if the effect has a single one."""
        sizes = [k for k, p in enumerate(self.effect.parameters) if len(p.choices) != 1]
        if len(sizes) != 1 or not math.isfinite(self.amplitude):
            return self
        by = math.copysign(float(np.clip(abs(self.amplitude), 1.0 / MOST_SCALED, MOST_SCALED)), self.amplitude)
        k, p = sizes[0], self.effect.parameters[sizes[0]]
        by = by if p.signed else abs(by)
        values = list(self.values)
        values[k] = values[k] / by if self.effect.inverse else values[k] * by
        return replace(self, values=tuple(values))


def possible(effects: Sequence[Effect], joint: Joint) -> list[Effect]:
    """The effects that a record of these channels can show."""
    out = []
    for effect in effects:
        if isinstance(effect.form, Reading) and effect.form.rounding:
            continue  # read off the lattice of the readings
        thermal = effect.link in ("driver", "plate", "thermometer")
        if thermal and not joint.driven:
            continue
        if not thermal and joint.film is None:
            continue
        heated = getattr(effect.form, "heated", False)
        test = joint.record.test_current_A
        if heated and (test is None or not np.any(test > 0.0)):
            continue
        if thermal and joint.record.current_A is not None and np.ptp(joint.record.current_A) == 0.0:
            continue  # a constant drive tells nothing of the plate
        out.append(effect)
    return out


def starts(effect: Effect) -> Iterator[Start]:
    """The effect at its starting sizes, over its typical range, of either sign where it has one."""
    choices = [p.choices if len(p.choices) > 1 else (None,) for p in effect.parameters]
    free = sum(len(p.choices) == 0 for p in effect.parameters)
    count = SIZES if free == 1 else SIZES_OF_SEVERAL
    for chosen in itertools.product(*choices):
        fixed = {p.name: c for p, c in zip(effect.parameters, chosen, strict=True) if c is not None}
        made = pinned(effect, fixed) if fixed else effect
        ranges = []
        for p in made.parameters:
            if len(p.choices) == 1:
                ranges.append([p.choices[0]])
                continue
            sizes = p.smallest * (p.largest / p.smallest) ** ((np.arange(count) + 0.5) / count)
            ranges.append([*sizes.tolist(), *(-sizes).tolist()] if p.signed else sizes.tolist())
        for values in itertools.product(*ranges):
            yield Start(made, tuple(values))


class Directions:
    """What effects change in a fit's readings, once its parameters and the film's weights follow."""

    def __init__(self, fit: Fit, metric: Metric, at: Point) -> None:
        """at: the fit's point in that metric."""
        self.joint, self.metric, self.at = fit.joint, metric, at
        self._jacobian = fit.joint.jacobian(at, metric)

    def falls(self, points: Sequence[Array]) -> Array:
        """By how much the log-likelihood is smaller at other values of what no descent moves, all else following,
        (points,)."""
        square, along = self.left([self.joint.change(self.at, self.metric, x, True) for x in points])
        return np.asarray(0.5 * square - along)

    def along(self, starts: Sequence[Start], since: Array | float = 0.0) -> tuple[Array, Array]:
        """`left` of what effects change. since: another `change`, from which these are counted."""
        return self.left([self.change(start) - since for start in starts])

    def left(self, changes: Sequence[Array]) -> tuple[Array, Array]:
        """(squares of changes in units of the noise, their products with the residual), (changes,), once all else has
        followed: nan where a change is not known, 0 where nothing of it is left: parameters or film can do the same."""
        found = np.zeros((2, len(changes)))
        found[:, [not np.all(np.isfinite(column)) for column in changes]] = np.nan
        made = [k for k, column in enumerate(changes) if np.all(np.isfinite(column)) and np.any(column != 0.0)]
        if not made:
            return found[0], found[1]
        joint, n = self.joint, len(self.joint.unknowns)
        white = joint.whitened(self.at, self.metric, np.column_stack([changes[k] for k in made]))
        inner = joint.projected(self.at, np.column_stack([self._jacobian, white]))
        normal = inner[:n, :n] + np.diag(joint.prior_deviation**-2.0)
        scale = 1.0 / np.sqrt(np.maximum(np.diag(normal), 1e-300))
        normal = normal * np.outer(scale, scale)
        normal[np.diag_indices_from(normal)] += RIDGE
        mixed = inner[:n, n:] * scale[:, None]
        left = inner[n:, n:] - mixed.T @ cho_solve(cho_factor(normal), mixed)
        square = np.diag(left)[:-1]
        found[:, made] = np.where(square > LEAST, (square, left[:-1, -1]), 0.0)
        return found[0], found[1]

    def change(self, start: Start) -> Array:
        """What an effect changes in the readings, nan where it cannot be beside the others."""
        joint = self.joint
        try:
            other = joint.having((*joint.effects, start.effect))
        except ValueError:
            return np.full(joint.rows_K.size + joint.rows_dec.size, np.nan)
        x = other.with_effect(other.from_other(joint, self.at.x), start.effect, start.values)
        return joint.change(self.at, self.metric, x, start.effect.before_film, other)


def scores(fit: Fit, effects: Sequence[Effect], metric: Metric, at: Point) -> list[Start]:
    """All starts with what they promise in one metric, the best first. at: the fit's point in that metric."""
    tried = [start for effect in effects for start in starts(effect)]
    found = []
    for start, size, slope in zip(tried, *Directions(fit, metric, at).along(tried), strict=True):
        if not size > 0.0:
            continue
        linear = any(p.signed for p in start.effect.parameters)
        promised = 0.5 * slope**2 / size if slope > 0.0 or linear else 0.0
        found.append(replace(start, promised=float(promised), amplitude=float(slope / size)))
    return sorted(found, key=lambda start: -start.promised)


def is_sizeable(effect: Effect, values: Sequence[float]) -> bool:
    """Return False if a fitted size has no physical meaning: below half of the smallest that real rigs have, or at an
    end of what a fit may make of it, where the effect stands in for something else."""
    for k, (p, value) in enumerate(zip(effect.parameters, values, strict=True)):
        if len(p.choices) == 1:
            continue
        if not p.signed and not p.smallest < value * BESIDE * (1.0 - AT_END) < p.largest * BESIDE**2 * (
            1.0 - 2 * AT_END
        ):
            return False
        if effect.inverse and value > p.largest / SMALLEST_SHARE:
            return False
        if not effect.inverse and k == 0 and abs(value) < SMALLEST_SHARE * p.smallest:
            return False
    return True

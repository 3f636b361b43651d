"""Temperatures for a wanted resistance, row after row, with the memory of the film."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import NDArray

from compensator.hysteresis.film import FilmModel, Memory, reversal_jumps
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse, Solution
from rig.core.faults import Faults
from rig.records.film_output import column_of, in_decades, output_to_quantity, sign_of

if TYPE_CHECKING:
    from sim.model.film_mixing import PhaseMixing


MOST_FAULTS = 10  # of a target: more of the same line say nothing more


@dataclass(frozen=True, eq=False)
class Inversion:
    """Temperatures for targets; arrays of shape (rows,).

    temperature_degC: nan until the first target that can be reached. achieved: the film's value at that temperature;
    nearest: the value nearest to the target that it could have, both in the quantity's own unit (ohm, or that of the
    record's column); nearest_degC: the temperature for it. evaluations: of the model. output: its name.
    """

    temperature_degC: Array
    reachable: NDArray[np.bool_]
    achieved: Array
    nearest: Array
    nearest_degC: Array
    evaluations: NDArray[np.int64]
    output: str

    @property
    def asked_degC(self) -> Array:
        """Temperatures of the targets that can be reached, shape (targets,)."""
        return self.temperature_degC[self.reachable]

    def columns(self) -> dict[str, Any]:
        """Return the columns that `peltier invert` writes: temperature_degC, reachable, resistance_ohm, nearest_ohm,
        nearest_degC."""
        name = column_of(self.output)
        last = "nearest_ohm" if name == "resistance_ohm" else f"nearest_{name}"
        return {
            "temperature_degC": self.temperature_degC,
            "reachable": self.reachable.astype(np.int64),
            name: self.achieved,
            last: self.nearest,
            "nearest_degC": self.nearest_degC,
        }


def target_name(output: str) -> str:
    """Return the name of the column for a target of this output."""
    name = column_of(output)
    return "target_ohm" if name == "resistance_ohm" else f"target_{name}"


def inverted(
    film: FilmModel,
    target: Array,
    where: object,
    limits_degC: tuple[float, float] = (-50.0, 200.0),
    initial: Literal["cooled", "heated"] | None = None,
    mixing: PhaseMixing | None = None,
) -> Inversion:
    """Return temperatures for a target, shape (rows,), in the quantity's own unit.

    initial: the film's memory, None: the model's. mixing: of the film's phases, as in its model. Of several
    temperatures the nearest to the row before is taken, in the first row the lowest. A target that cannot be reached
    within limits_degC leaves temperature and memory as they are. Raises Faults for values that are no target.
    """
    _require_targets(target, film.output, where)
    inverse, memory = Inverse(film, *limits_degC), None
    rows: list[tuple[float, bool, float, float, float, int]] = []
    outputs = sign_of(film.output) * (np.log10(target) if in_decades(film.output) else target)
    for wanted in outputs if mixing is None else mixing.unmixed(outputs):
        solution = _solved(inverse, float(wanted), memory, initial)
        near = solution if solution.reachable else _solved(inverse, solution.nearest, memory, initial)
        if solution.reachable:
            memory = solution.memory
        achieved = _shown(film.output_at(memory) if memory is not None else math.nan, film.output, mixing)
        nearest = achieved if solution.reachable else _shown(solution.nearest, film.output, mixing)
        degC = memory.input_degC if memory is not None else math.nan
        near_degC = near.temperature_degC if near.reachable else math.nan
        rows.append((degC, solution.reachable, achieved, nearest, near_degC, solution.evaluations))
    return Inversion(
        np.array([row[0] for row in rows]),
        np.array([row[1] for row in rows], dtype=np.bool_),
        np.array([row[2] for row in rows]),
        np.array([row[3] for row in rows]),
        np.array([row[4] for row in rows]),
        np.array([row[5] for row in rows], dtype=np.int64),
        film.output,
    )


def _solved(
    inverse: Inverse, wanted: float, memory: Memory | None, initial: Literal["cooled", "heated"] | None
) -> Solution:
    """Solve from a memory; None: of a first target, with the film's initial memory."""
    return inverse.first(wanted, initial) if memory is None else inverse.solve(wanted, memory)


def _shown(own: float, output: str, mixing: PhaseMixing | None) -> float:
    """Return an output in the quantity's own unit."""
    return output_to_quantity(own if mixing is None else float(mixing.mixed(np.array([own]))[0]), output)


def order_warning(film: FilmModel, where: object, limits_degC: tuple[float, float] | None = None) -> str | None:
    """Return a warning if the model violates the order condition, else None. limits_degC: of an inversion, which finds
    no temperature for targets inside a jump."""
    violating, _ = reversal_jumps(film, *(limits_degC or ()))
    if not violating:
        return None
    who = "1 operator of positive weight violates"
    if violating > 1:
        who = f"{violating} operators of positive weight violate"
    text = f"{where}: film.radii: {who} gamma_R - r <= gamma_L + r; the output jumps at reversals"
    return text if limits_degC is None else f"{text}, and targets inside a jump are reported as not reachable"


def _require_targets(target: Array, output: str, where: object) -> None:
    """Raise Faults for values that are no target."""
    decades, name = in_decades(output), target_name(output)
    expected = "a finite number > 0" if decades else "a finite number"
    bad = np.flatnonzero(~(np.isfinite(target) & ((target > 0.0) | (not decades))))
    if target.size and bad.size == target.size:
        raise Faults([f"{where}: {name}: {float(target[0])!r} in every row; expected {expected}"])
    if bad.size:
        raise Faults(
            f"{where}: row {k + 1}: {name}: {float(target[k])!r}: expected {expected}" for k in bad[:MOST_FAULTS]
        )

"""What can be known before anything is switched on: can the film reach the target, can the plate reach the film."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from compensator.hysteresis.film import FilmModel, Memory, reversal_jumps
from compensator.hysteresis.functions import Array
from compensator.inverse.branch_plan import branch_plan
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from rig.config.configuration import Configuration
from rig.config.target import Target
from rig.control.law_units import LawUnits
from rig.core.faults import Faults, fault
from rig.drivers.controller import OF_FULL_DRIVE

UNKNOWN_DEC = 0.01  # of memory that the conditioning may leave open; of two decades, whatever the output
USUAL_K_PER_S = 1.0  # of a plate that nobody has measured yet
POINTS = 400  # of a course: two or three seconds apart in an experiment of a quarter of an hour
BEHIND_K = 0.5  # of a target, from which a plate that cannot follow is seen in any record
SHARE_BEHIND = 0.1  # of the time; crossing a loop at each turn takes some: 6 s of each 150 s on a sine of 300 s
LEAST_RATE_K_PER_S = 0.005  # that must be left at a temperature for it to be reached in a sensible time


def check_within_limits(target: Target, configuration: Configuration, where: str) -> None:
    """Refuse a wanted temperature or current at which the interlock would switch off. Raises Faults: the first."""
    limits = configuration.limits
    if target.quantity == "temperature":
        (low, high), unit, name = limits.temperature_degC, "degC", "temperature_degC"
    elif target.quantity == "current":
        low, high, unit, name = -limits.current_A, limits.current_A, "A", "current_A"
    else:
        return
    beyond = np.flatnonzero((target.values < low) | (target.values > high))
    if beyond.size:
        value, at_s = float(target.values[beyond[0]]), float(target.times_s[beyond[0]])
        text = f"{value:g} {unit} is outside limits.{name}; expected {low:g} to {high:g} {unit}"
        raise fault(where, f"at {at_s:g} s", text)


def check_plate(
    plate: PlateModel, temperatures_degC: list[float], configuration: Configuration, where: str, what: str
) -> None:
    """Refuse temperatures that the plate cannot hold within the current limit. Raises Faults: the current needed."""
    limit = configuration.limits.current_A
    for temperature in temperatures_degC:
        cooling, heating = plate.rate_range_K_per_s(temperature, limit)
        if heating < LEAST_RATE_K_PER_S or (plate.kind == "peltier" and cooling > -LEAST_RATE_K_PER_S):
            needed = plate.current_for_rate_A(temperature, math.copysign(LEAST_RATE_K_PER_S, heating), 1e3)
            unit = "A" if plate.kind == "peltier" else OF_FULL_DRIVE
            raise fault(
                where,
                what,
                f"the plate does not reach {temperature:.1f} degC within limits.current_A = {limit:g} {unit}; "
                f"by its model it takes {abs(needed):.2g} {unit}",
            )


def behind_warning(plate: PlateModel, course: Course, configuration: Configuration) -> str | None:
    """A line where the plate cannot follow a course: at the current limit all the time it would still be behind."""
    limit = configuration.limits.current_A
    temperature, behind_s, most_K = float(course.temperatures_degC[0]), 0.0, 0.0
    for step_s, wanted in zip(np.diff(course.times_s), course.temperatures_degC[1:], strict=True):
        cooling, heating = plate.rate_range_K_per_s(temperature, limit)
        temperature += min(max(float(wanted) - temperature, cooling * step_s), heating * step_s)
        away = abs(float(wanted) - temperature)
        behind_s += step_s if away > BEHIND_K else 0.0
        most_K = max(most_K, away)
    share = behind_s / max(float(course.times_s[-1] - course.times_s[0]), 1e-9)
    if share < SHARE_BEHIND:
        return None
    unit = "A" if plate.kind == "peltier" else OF_FULL_DRIVE
    return (
        f"the target is faster than the plate: by its model it will be more than {BEHIND_K:g} K behind for "
        f"{100.0 * share:.0f} % of the time, by up to {most_K:.1f} K, with limits.current_A = {limit:g} {unit}"
    )


@dataclass(frozen=True, eq=False)
class Course:
    """Temperatures (degC) of a film at times of its target (s), shapes (points,). planned: not those nearest to each
    other, which would leave a later part of the target out of reach."""

    times_s: Array
    temperatures_degC: Array
    planned: bool = False


def grid(target: Target) -> Array:
    """The times of a course: a target's own, and some between."""
    return np.unique(np.concatenate((target.times_s, np.linspace(0.0, target.duration_s, POINTS))))


def check_target(
    target: Target,
    film: FilmModel,
    plate: PlateModel | None,
    configuration: Configuration,
    hot_degC: float,
    where: str,
    units: LawUnits,
) -> Course:
    """Temperatures at the target's points, down from hot_degC as the experiment comes. Raises Faults.

    target, film: in the law's units. A point that the film cannot have there, from where the points before have left
    it, is a fault with its time. Of several temperatures the nearest are taken, unless they lead to where a later point
    has none: then those of a plan of the whole target (`compensator.inverse.branch_plan`).
    """
    inverse = Inverse(film, *configuration.limits.temperature_degC)
    memory = film.initial_memory(hot_degC, "cooled")
    times = grid(target)
    wanted = target.at(times)
    nearest = _nearest(wanted, inverse, memory)
    found = nearest
    if nearest.size < times.size and inverse.least_slope < 0.0:
        plan = branch_plan(inverse, times, wanted, memory, *_slowest_rates(plate, configuration))
        found = max(nearest, plan.temperatures_degC, key=np.size)
    if found.size < times.size:
        raise _unreachable(float(times[found.size]), float(wanted[found.size]), inverse, memory, found, where, units)
    return Course(times, found, planned=found is not nearest)


def _nearest(wanted: Array, inverse: Inverse, memory: Memory) -> Array:
    """Temperatures of the wanted outputs, each the nearest, up to the first that has none."""
    temperatures: list[float] = []
    for value in wanted:
        solution = inverse.solve(float(value), memory)
        if not solution.reachable:
            break
        memory = solution.memory
        temperatures.append(solution.temperature_degC)
    return np.array(temperatures)


def _unreachable(
    time_s: float, value: float, inverse: Inverse, memory: Memory, before_degC: Array, where: str, units: LawUnits
) -> Faults:
    """What to say of the first value that is out of reach, after these temperatures."""
    _, memory = inverse.model.simulate(before_degC, memory)
    solution = inverse.solve(value, memory)
    low, high = solution.interval or (math.nan, math.nan)
    least, most = sorted((low, high), key=units.shown)
    text = f"{units.in_words(value)} is outside the film's range within limits.temperature_degC "
    text += f"({inverse.low_degC:g} to {inverse.high_degC:g} degC), coming from {memory.input_degC:.1f} degC; "
    text += f"expected {units.shown(least):.6g} to {units.in_words(most)}"
    return fault(where, f"at {time_s:g} s", text)


def _slowest_rates(plate: PlateModel | None, configuration: Configuration) -> tuple[float, float]:
    """(cooling, heating) in K/s that the plate has anywhere within its limits; of an unknown plate `USUAL_K_PER_S`."""
    if plate is None:
        return USUAL_K_PER_S, USUAL_K_PER_S
    limit = configuration.limits.current_A
    rates = [plate.rate_range_K_per_s(degC, limit) for degC in configuration.limits.temperature_degC]
    return max(min(-cool for cool, _ in rates), LEAST_RATE_K_PER_S), max(
        min(heat for _, heat in rates), LEAST_RATE_K_PER_S
    )


def order_warning(film: FilmModel, where: object) -> str | None:
    """A line where the model violates the order condition: the output jumps at reversals."""
    violating, _ = reversal_jumps(film)
    if not violating:
        return None
    who = (
        "1 operator of positive weight violates"
        if violating == 1
        else f"{violating} operators of positive weight violate"
    )
    return f"{where}: film.radii: {who} gamma_R - r <= gamma_L + r; the output jumps at reversals"


def memory_warning(film: FilmModel, hot_degC: float, where: object, units: LawUnits) -> str | None:
    """A line where the hot end does not saturate the film: its memory stays unknown after the conditioning.

    film: in the law's units.
    """
    cooled, heated = film.initial_memory(hot_degC, "cooled"), film.initial_memory(hot_degC, "heated")
    apart = float(film.weights @ np.abs(cooled.plays - heated.plays))
    if apart < UNKNOWN_DEC:
        return None
    in_ohm = units.quantity == "resistance"
    told = f"{apart:.2g} decades" if in_ohm else f"{apart / abs(units.factor):.2g} {units.unit}"
    return (
        f"{where}: film: at {hot_degC:g} degC, where the film is conditioned, {told} still depend on what "
        "was before; expected calibration.temperature_degC to reach above the transition"
    )


def check_cooling(plate: PlateModel, target: Target, configuration: Configuration, where: str) -> str | None:
    """Beyond I = S T / R_e more current cools less: a target beyond is refused, a limit beyond is told.

    Raises Faults.
    """
    if plate.kind != "peltier":
        return None
    low, limit = configuration.limits.temperature_degC[0], configuration.limits.current_A
    most_A = -plate.current_range_A(low, math.inf)[0]
    if target.quantity == "current" and float(target.values.min()) < -most_A:
        text = f"{float(target.values.min()):g} A: beyond -{most_A:.3g} A more current cools less "
        text += f"(I = S T / R_e at {low:g} degC, by the plate model); expected a current above that"
        raise fault(where, "its lowest current", text)
    if limit > most_A:
        return (
            f"limits.current_A = {limit:g} A: when cooling, no more than {most_A:.3g} A is used, because beyond "
            "I = S T / R_e of the plate model more current cools less"
        )
    return None

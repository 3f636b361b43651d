"""What can be known before anything is switched on: can the film reach the target, can the plate reach the film."""

from __future__ import annotations

import math

import numpy as np

from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from rig.core.faults import fault
from rig.drivers.heater_drive import OF_FULL_DRIVE
from rig.files.configuration import Configuration
from rig.files.film_output import ohm
from rig.files.target import Target

UNKNOWN_DEC = 0.01  # of memory that the conditioning may leave open
LEAST_RATE_K_PER_S = 0.005  # that must be left at a temperature for it to be reached in a sensible time


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


def check_target(target: Target, film: FilmModel, configuration: Configuration, hot_degC: float, where: str) -> Array:
    """Temperatures at the target's points, down from hot_degC as the experiment comes. Raises Faults.

    A point that the film cannot have there, from where the points before have left it, is a fault with its time.
    """
    inverse = Inverse(film, *configuration.limits.temperature_degC)
    memory = film.initial_memory(hot_degC, "cooled")
    course = np.unique(np.concatenate((target.times_s, np.linspace(0.0, target.duration_s, 400))))
    temperatures = []
    for time in course:
        value = float(target.at(time))
        solution = inverse.solve(value, memory)
        if not solution.reachable:
            low, high = solution.interval or (math.nan, math.nan)
            least, most = sorted((ohm(high, film.output), ohm(low, film.output)))
            limits = "{:g} to {:g} degC".format(*configuration.limits.temperature_degC)
            text = f"{ohm(value, film.output):.6g} ohm is outside the film's range within limits.temperature_degC "
            text += f"({limits}), coming from {memory.input_degC:.1f} degC; expected {least:.6g} to {most:.6g} ohm"
            raise fault(where, f"at {time:g} s", text)
        memory = solution.memory
        temperatures.append(solution.temperature_degC)
    return np.array(temperatures)


def order_warning(film: FilmModel, where: object) -> str | None:
    """A line where the model violates the order condition: the output jumps at reversals."""
    violating = int(np.sum((film.order_margin() < -1e-12) & (film.weights > 0.0)))
    if not violating:
        return None
    return (
        f"{where}: film.radii: {violating} operators of positive weight violate gamma_R - r <= gamma_L + r; "
        "the output jumps at reversals"
    )


def memory_warning(film: FilmModel, hot_degC: float, where: object) -> str | None:
    """A line where the hot end does not saturate the film: its memory stays unknown after the conditioning."""
    cooled, heated = film.initial_memory(hot_degC, "cooled"), film.initial_memory(hot_degC, "heated")
    apart = float(film.weights @ np.abs(cooled.plays - heated.plays))
    if apart < UNKNOWN_DEC:
        return None
    return (
        f"{where}: film: at {hot_degC:g} degC, where the film is conditioned, {apart:.2g} decades still depend on what "
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

"""Target and model of a configured experiment, checked before any port is opened and anything is switched on.

Can the film reach the target, within the limits, and can the plate take the film there?
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any, cast

import numpy as np

from compensator.hysteresis.film import FilmModel, Memory
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse, branch_plan
from compensator.thermal.plate import PlateModel
from rig.analysis.film_records import beyond_seen
from rig.analysis.inversion import order_warning
from rig.analysis.prediction import needs_test_current
from rig.config.configuration import Configuration, ConfigurationFile
from rig.config.model_file import Model, read_model
from rig.config.target import Target, parse_profile, read_target
from rig.control.decision import Phases, Policy
from rig.control.law_units import LawUnits, in_law_units, law_units, own_target
from rig.control.policies import CurrentProfile
from rig.core.faults import Faults, fault
from rig.drivers.controller import OF_FULL_DRIVE
from rig.experiment.calibration import PULSE_S, calibration_range, fitted_and_checked, minor_turning_points
from rig.experiment.repetitions import check_repeatable
from rig.records.film_output import FALLING_RESISTANCE, in_decades, other_sign


@dataclass(frozen=True)
class Kind:
    """Experiment kind. quantity: of its target ("" for that of the meter).

    target: of a kind with keys of its own, how the target follows from them; None: it is experiment.target. policy: of
    a kind that commands a current by a policy instead of a law, how the policy is made of target and configuration.
    """

    quantity: str
    target: Callable[[ConfigurationFile], Target] | None = None
    policy: Callable[[Target, Configuration], Policy] | None = None


KINDS: Mapping[str, Kind] = {
    "track_resistance": Kind("resistance"),
    "track_output": Kind(""),
    "temperature_profile": Kind("temperature"),
    "current_profile": Kind("current", policy=lambda target, configuration: CurrentProfile(target)),
    "hold": Kind("temperature"),
}
TRACKING = ("track_resistance", "track_output")

UNKNOWN_DEC = 0.01  # of memory that the conditioning may leave open; of two decades, whatever the output
USUAL_K_PER_S = 1.0  # of a plate that nobody has measured yet
POINTS = 400  # of a course: two or three seconds apart in an experiment of a quarter of an hour
BEHIND_K = 0.5  # of a target, from which a plate that cannot follow is seen in any record
SHARE_BEHIND = 0.1  # of the time; crossing a loop at each turn takes some: 6 s of each 150 s on a sine of 300 s
LEAST_RATE_K_PER_S = 0.005  # that must be left at a temperature for it to be reached in a sensible time


def check_within_limits(target: Target, configuration: Configuration, where: str) -> None:
    """Raise Faults for the first temperature or current of a target at which the interlock would switch off."""
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
    """Raise Faults, with the current needed, for temperatures that the plate cannot hold within the current limit."""
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
    """Return a warning if the plate cannot follow a course even at the current limit, else None."""
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
        f"parts of the target are faster than the plate with limits.current_A = {limit:g} {unit}: by its model it will "
        f"be more than {BEHIND_K:g} K behind for {100.0 * share:.0f} % of the time, by up to {most_K:.1f} K"
    )


@dataclass(frozen=True, eq=False)
class Course:
    """Temperatures (degC) of a film at times of its target (s), shapes (points,). planned: not those nearest to each
    other, which would leave a later part of the target out of reach."""

    times_s: Array
    temperatures_degC: Array
    planned: bool = False


def grid(target: Target) -> Array:
    """Return the times of a course (s): a target's own, and some between."""
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
    """Return temperatures at the target's points, coming down from hot_degC as the experiment does. Raises Faults.

    target, film: in the law's units. A point that the film cannot have there, from where the points before have left
    it, is a fault with its time. Of several temperatures the nearest are taken, unless they lead to where a later point
    has none: then those of a plan of the whole target (`compensator.inverse.inverse`).
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
    """Return temperatures of the wanted outputs, each the nearest, up to the first that has none."""
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
    """Return the fault of the first value that is out of reach, after these temperatures."""
    _, memory = inverse.model.simulate(before_degC, memory)
    solution = inverse.solve(value, memory)
    low, high = solution.interval or (math.nan, math.nan)
    least, most = sorted((low, high), key=units.shown)
    text = f"{units.in_words(value)} is outside the film's range within limits.temperature_degC "
    text += f"({inverse.low_degC:g} to {inverse.high_degC:g} degC), coming from {memory.input_degC:.1f} degC; "
    text += f"expected {units.shown(least):.6g} to {units.in_words(most)}"
    return fault(where, f"at {time_s:g} s", text)


def _slowest_rates(plate: PlateModel | None, configuration: Configuration) -> tuple[float, float]:
    """Return the slowest (cooling, heating) of a plate within its limits, K/s; of an unknown plate `USUAL_K_PER_S`."""
    if plate is None:
        return USUAL_K_PER_S, USUAL_K_PER_S
    limit = configuration.limits.current_A
    rates = [plate.rate_range_K_per_s(degC, limit) for degC in configuration.limits.temperature_degC]
    return max(min(-cool for cool, _ in rates), LEAST_RATE_K_PER_S), max(
        min(heat for _, heat in rates), LEAST_RATE_K_PER_S
    )


def memory_warning(film: FilmModel, hot_degC: float, where: object, units: LawUnits) -> str | None:
    """Return a warning if the hot end does not saturate the film, so that its memory stays unknown after the
    conditioning, else None. film: in the law's units."""
    cooled, heated = film.initial_memory(hot_degC, "cooled"), film.initial_memory(hot_degC, "heated")
    apart = float(film.weights @ np.abs(cooled.plays - heated.plays))
    if apart < UNKNOWN_DEC:
        return None
    in_ohm = units.quantity == "resistance"
    unknown = f"{apart:.2g} decades" if in_ohm else f"{apart / abs(units.factor):.2g} {units.unit}"
    return (
        f"{where}: film: at {hot_degC:g} degC, where the film is conditioned, the film model still remembers what "
        f"was before ({unknown}); raise the upper calibration.temperature_degC above the transition"
    )


def check_cooling(plate: PlateModel, target: Target, configuration: Configuration, where: str) -> str | None:
    """Return a warning for a limit beyond I = S T / R_e, where more current cools less, else None. Raises Faults for a
    target beyond it."""
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


def quantity_of(configuration: Configuration) -> str:
    """Return the quantity of the target, as in `rig.config.target.Target`."""
    meter = configuration.bench.meter
    return KINDS[configuration.experiment.kind].quantity or str(meter and meter.output)


def follows_a_law(configuration: Configuration) -> bool:
    """Return True if a law of this program commands the current, by the model of a plate."""
    e = configuration.experiment
    return e.law != "instrument_pid" and KINDS[e.kind].policy is None


def target_of(file: ConfigurationFile) -> Target:
    """Return the target. Raises Faults."""
    e = file.content.experiment
    quantity, own = quantity_of(file.content), KINDS[e.kind].target
    if own is not None:
        return own(file)
    if e.target is None:
        raise fault(file.path, "experiment.target", f"missing; kind {e.kind!r} needs a CSV file or a profile in words")
    if isinstance(e.target, str):
        return read_target(file.beside(e.target), quantity)
    return parse_profile(e.target, quantity, f"{file.path}: experiment.target")


def target_and_model(file: ConfigurationFile, say: Callable[[str], None]) -> tuple[Target, Model | None]:
    """Return target and model of the configured experiment, checked. Raises Faults."""
    e = file.content.experiment
    target, model = _read_both(file)
    for line in target.notes:
        say(line)
    if e.kind not in TRACKING and model is None and follows_a_law(file.content):
        expected = "needs a model with [plate], or law = 'instrument_pid' (the controller's own PID)"
        raise fault(file.path, "experiment.model", f"missing; kind {e.kind!r} {expected}")
    check_repeatable(file, model)
    if model is not None:
        check_feasible(file, target, model, say)
    return target, model


def _read_both(file: ConfigurationFile) -> tuple[Target, Model | None]:
    """Read both files, and check the target against the limits. Raises the Faults of both."""
    e, lines = file.content.experiment, list[str]()
    target, model = None, None
    try:
        target = target_of(file)
        check_within_limits(target, file.content, f"{file.path}: experiment.target")
    except Faults as faults:
        lines += faults.lines
    try:
        if e.model is not None:
            needs = ("film", "plate") if e.kind in TRACKING else ("plate",)
            model = read_model(file.beside(e.model), needs=cast(Any, needs))
    except Faults as faults:
        lines += faults.lines
    if lines or target is None:
        raise Faults(lines)
    return target, model


def check_feasible(file: ConfigurationFile, target: Target, model: Model, say: Callable[[str], None]) -> None:
    """Raise Faults for what film or plate cannot do; say what else to know."""
    c, where, whose = file.content, f"{file.path}: experiment.target", file.content.experiment.model or str(file.path)
    hot, kind = calibration_range(c)[1], file.content.experiment.kind
    warnings = [check_cooling(model.plate, target, c, where) if model.plate is not None else None]
    by_a_law = model.plate is not None and follows_a_law(c)
    if kind in TRACKING:
        assert model.film is not None
        _check_output(model, whose, quantity_of(c))
        units = law_units(model.film, c.limits.temperature_degC)
        film = in_law_units(model.film, units)
        warnings += [order_warning(film, whose), memory_warning(film, hot, whose, units)]
        own = own_target(target, film, model.switched(), units)
        course = check_target(own, film, model.plate, c, hot, where, units)
        if course.planned:
            warnings.append(
                "the target has several temperatures: not always the nearest is taken, so that all of it is reached"
            )
        warnings.append(beyond_seen(model, course.temperatures_degC, whose))
        if by_a_law and model.plate is not None:
            check_plate(model.plate, [hot], c, f"{file.path}: calibration.temperature_degC", "its hot end")
    else:
        times = grid(target)
        course = Course(times, target.at(times))
    if by_a_law and model.plate is not None:
        ends = [float(course.temperatures_degC.min()), float(course.temperatures_degC.max())]
        check_plate(model.plate, ends, c, where, "its range")
        warnings.append(behind_warning(model.plate, course, c))
    for warning in warnings:
        if warning is not None:
            say(warning)


def _check_output(model: Model, where: object, quantity: str) -> None:
    """Raise Faults for a film with which the quantity cannot be tracked."""
    assert model.film is not None
    output = model.film.output
    if quantity == "resistance" and not in_decades(output):
        raise fault(where, "film.output", f"{output!r}; expected a resistance to track one")
    if quantity != "resistance" and output not in (quantity, other_sign(quantity)):
        raise fault(where, "film.output", f"{output!r}; expected {quantity!r}, which the meter reads, to track it")
    on_readings = [e for e in model.switched() if e.effect.link == "ohmmeter" or needs_test_current((e,))]
    if output != FALLING_RESISTANCE and on_readings:
        what = "whose resistance rises" if quantity == "resistance" else "of which no resistance is read"
        name = on_readings[0].name
        raise fault(where, "effects", f"{name}: has no meaning for a film {what} (film.output {output!r})")


# ---- the phases to come, each with its seconds: what is not known yet is guessed, until the phase begins -----

POLARITY_S = 5.0  # of a plate whose thermometer answers at once
ROOM_DEGC = 25.0
TRANSITION_SHARE = 0.4  # of the range that a calibration goes through


def still_to_come(phases: Phases, name: str) -> Phases:
    """Return the phases that are expected after the one of this name, which begins; all if none has this name."""
    names = [expected for expected, _ in phases]
    return phases[names.index(name) + 1 :] if name in names else phases


def expected_calibration(configuration: Configuration) -> Phases:
    """Return the phases of a calibration, with their seconds."""
    c = configuration.calibration
    low, high = calibration_range(configuration)
    rate, width = c.rate_K_per_s, TRANSITION_SHARE * (high - low)
    middle = 0.5 * (low + high)
    span = c.transition_degC or (middle - 0.5 * width, middle + 0.5 * width)
    fitted, checked = fitted_and_checked(minor_turning_points(span, (low, high), c.minor_loops, c.seed))

    def along(points: list[float]) -> float:
        return sum(abs(b - a) / rate + c.dwell_s for a, b in pairwise(points)) + c.dwell_s

    return [
        ("polarity", POLARITY_S),
        *[("pulse", seconds) for seconds in (2.0, PULSE_S, PULSE_S, PULSE_S, PULSE_S)],
        ("condition", along([ROOM_DEGC, high])),
        ("major", along([high, low, high, low])),
        ("minor", along([low, *fitted])),
        ("check", along([fitted[-1], *checked])),
    ]


def expected_run(configuration: Configuration, target: Target, model: Model | None) -> Phases:
    """Return the phases of a run: a calibration if there is no model, then each law."""
    e = configuration.experiment
    plate = model.plate if model is not None else None
    if e.kind not in TRACKING:
        approach = [("approach", e.settle_s)] if follows_a_law(configuration) else []
        return [("polarity", POLARITY_S), *approach, ("profile", target.duration_s)]
    low, high = calibration_range(configuration)
    rate = _rate(plate, configuration, high)
    way_s = 0.5 * (high - low) / rate
    first = [("polarity", POLARITY_S)] if model is not None else expected_calibration(configuration)
    each = [("condition", way_s), ("approach", way_s + e.settle_s)] if e.memory == "condition" else []
    each = [*each, ("settle", e.settle_s)]
    runs = len(e.laws) + e.repeat - 1
    return [*first, *[phase for _ in range(runs) for phase in (*each, ("track", target.duration_s))]]


def _rate(plate: PlateModel | None, configuration: Configuration, high_degC: float) -> float:
    """Return the rate of the plate on the way to its conditioning and back (K/s)."""
    if plate is None:
        return USUAL_K_PER_S
    cool, heat = plate.rate_range_K_per_s(high_degC, configuration.limits.current_A)
    return max(configuration.control.rate_share * min(heat, abs(cool)), 0.01)

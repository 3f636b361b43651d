"""Tracking a wanted resistance with one law: condition the film, go to the first target, follow it.

condition  to the hot end, so that the film's memory is known (after an outage it is not)
approach   down to the first target, the same for every law, so that laws are compared from the same place
           (neither where `experiment.memory` says to begin where the film is)
settle     the law itself on the first target
track      the target
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from compensator.control.law import Law, LawSettings, Observer
from compensator.control.law_step import LawName, LawState
from compensator.control.margins import Timing
from compensator.control.pid import Design, design_log_resistance, design_temperature
from compensator.control.reference_shaping import crossing_s, preview
from compensator.hysteresis.film import FilmModel
from compensator.inverse.inverse import Inverse
from compensator.thermal.plate import PlateModel
from rig.analysis.error import Score, score
from rig.config.configuration import Configuration
from rig.config.model_file import Model
from rig.config.target import Target
from rig.control.law_units import COMPENSATED, LawUnits, chain_observer, in_law_units, law_units, own_target
from rig.control.loop import Loop
from rig.control.policies import Branches, Follow, handed_over, temperature_now, warmed_up
from rig.core.faults import fault
from rig.experiment.calibration import calibration_range
from rig.experiment.feasibility import Course, check_target

HOT_DWELL_S = 3.0  # at the hot end, until film and thermometer have followed
OUTPUT_AGE_S, ACTS_AFTER_S = 0.044, 0.010  # of a Keithley 2000 at 19200 Bd, and of a controller at 57600 Bd
USUAL_PREVIEW_S = 4.0  # of a temperature, which no loop makes jump


def timing_of(
    configuration: Configuration, output_age_s: float | None = None, acts_after_s: float | None = None
) -> Timing:
    """Return when a period's readings are taken and its command acts; by default as typical instruments have it.

    A dead time that is configured beyond a period is taken for one that no stamp shows.
    """
    period = configuration.experiment.period_s
    age = min(OUTPUT_AGE_S, 0.44 * period) if output_age_s is None else output_age_s
    acts = min(ACTS_AFTER_S, 0.1 * period) if acts_after_s is None else acts_after_s
    late = max((configuration.control.dead_time_s or 0.0) - period, 0.0)
    return Timing(period, age, acts, late)


def law_and_design(
    name: LawName,
    configuration: Configuration,
    film: FilmModel,
    plate: PlateModel,
    observer: Observer | None = None,
    fastest_K_per_s: float = math.inf,
) -> tuple[Law, Design]:
    """Return a law with its gains, designed to the configured Ms with the bench's dead time, and compiled.

    observer: of the model's effects, for the laws that gain from them. fastest_K_per_s: of the reference.
    """
    if name not in COMPENSATED:
        observer = None
    e, control = configuration.experiment, configuration.control
    dead_time = control.dead_time_s if control.dead_time_s is not None else e.period_s
    dead_time += observer.delay_s if observer is not None else 0.0
    low, high = configuration.limits.temperature_degC
    limit = configuration.limits.current_A
    if name == "pid":
        design = design_log_resistance(film, plate, low, high, limit, e.period_s, dead_time, control.ms)
    else:
        design = design_temperature(e.period_s, dead_time, control.ms)
    horizon_s = control.preview_s
    if horizon_s is None:
        horizon_s = USUAL_PREVIEW_S if name == "temperature" else crossing_s(film, plate, limit, low, high)
    count, spacing_s = preview(horizon_s, e.period_s, observer.film_lag_s if observer is not None else 0.0)
    settings = LawSettings(
        name=name,
        period_s=e.period_s,
        current_limit_A=limit,
        low_degC=low,
        high_degC=high,
        gains=design.gains,
        preview=count,
        preview_spacing_s=spacing_s,
        rate_share=control.rate_share if name == "temperature" else control.resistance_rate_share,
        fastest_K_per_s=fastest_K_per_s,
        most_share=control.most_share,
    )
    return warmed_up(Law(settings, plate, film, observer)), design


def design_document(design: Design) -> dict[str, Any]:
    """Return a design as plain values, for run.json, JSON and report."""
    return {
        "gains": design.gains._asdict(),
        "margins": dict(design.margins.__dict__),
        "closed_loop_time_s": design.closed_loop_time_s,
        "process_gain": design.process_gain,
        "process_pole_per_s": design.process_pole_per_s,
        "dead_time_s": design.dead_time_s,
        "period_s": design.period_s,
    }


@dataclass(frozen=True, eq=False)
class Plan:
    """What a tracking run needs, made before anything is switched on.

    law: the one that tracks, with its design; mover: for the way to the first target. own: the target as the film's own
    output, inverse: of the film, both in the law's units. branches: the way to go, where a target has several
    temperatures and the nearest is not the one. model_lacks: the model's known error along the target, by
    `rig.experiment.repetitions`.
    """

    name: LawName
    law: Law
    design: Design
    mover: Law
    inverse: Inverse
    target: Target
    own: Target
    setpoints: bool
    units: LawUnits
    branches: Branches | None = None
    model_lacks: Target | None = None


def plan_tracking(
    configuration: Configuration, target: Target, model: Model, name: LawName, fastest_K_per_s: float
) -> Plan:
    """Design and compile the laws for one run. fastest_K_per_s: of the reference."""
    plate, effects, e = model.plate, model.switched(), configuration.experiment
    assert model.film is not None
    assert plate is not None
    limits_degC, hot = configuration.limits.temperature_degC, calibration_range(configuration)[1]
    units = law_units(model.film, limits_degC)
    film = in_law_units(model.film, units)
    observer = chain_observer(effects, plate, film, e.period_s) if name in COMPENSATED else None
    law, design = law_and_design(name, configuration, film, plate, observer, fastest_K_per_s)
    setpoints = name == "instrument_pid"
    mover, _ = law_and_design("temperature", configuration, film, plate, observer, fastest_K_per_s)
    if setpoints:  # the current is the controller's own: the reading is all that is known of the temperature
        mover = Law(replace(mover.settings, trusts_model=False), plate, film)
    own = own_target(target, film, effects if observer is not None else (), units)
    inverse = Inverse(film, *limits_degC)
    inverse.solve(float(own.values[0]), film.initial_memory(hot, "heated"))
    branches = None
    if inverse.least_slope < 0.0 and name != "pid":
        course = check_target(own, film, plate, configuration, hot, "experiment.target", units)
        branches = branches_of(law, course) if course.planned else None
    return Plan(name, law, design, mover, inverse, target, own, setpoints, units, branches)


def branches_of(law: Law, course: Course) -> Branches:
    """Return the law heading either way, and the course that decides which."""
    up, down = (
        warmed_up(Law(replace(law.settings, heading=way), law.plate, law.film, law.observer)) for way in (1, -1)
    )
    return Branches(Target("temperature", course.times_s, course.temperatures_degC), up, down)


def track(loop: Loop, configuration: Configuration, plan: Plan) -> Score:
    """Begin as the configuration says, and follow the target with one law; the rows are in the loop's folder
    afterwards."""
    e, target, setpoints = configuration.experiment, plan.target, plan.setpoints
    units = plan.units
    first_target = replace(target, times_s=np.array([0.0]), values=target.values[:1])
    follow = Follow(plan.law, first_target, setpoints=setpoints, units=units)
    if e.memory == "condition":
        follow.state = handed_over(conditioned(loop, configuration, plan), plan.law)
    follow.estimates_memory = e.memory == "estimate"
    if plan.model_lacks is not None:
        follow.model_lacks = replace(plan.model_lacks, times_s=np.zeros(1), values=plan.model_lacks.values[:1])
    if e.settle_s > 0.0:
        loop.phase("settle", follow, e.settle_s, e.period_s)
    follow.target, follow.model_lacks, follow.branches = target, plan.model_lacks, plan.branches
    loop.phase("track", follow, target.duration_s, e.period_s)
    found = score(loop.folder, plan.name, configuration.limits.current_A)
    if found is None:
        raise fault("the run", "track", "expected rows with a reading in this phase")
    return found


def conditioned(loop: Loop, configuration: Configuration, plan: Plan) -> LawState:
    """Take the film to the hot end, and from there to the target's first value."""
    hot, units, setpoints = calibration_range(configuration)[1], plan.units, plan.setpoints
    state = to_temperature(loop, plan.mover, None, hot, HOT_DWELL_S, "condition", setpoints, units)
    if state.state is None:  # of a record: a loop waits for a reading
        raise fault("the run", "condition", "expected rows with a reading in this phase")
    wanted = float(plan.own.values[0])
    first = plan.inverse.solve(wanted, state.state.memory)
    if not first.reachable:
        low, high = sorted(first.interval or (math.nan, math.nan), key=units.shown)
        raise fault(
            "experiment.target",
            "its first value",
            f"{units.in_words(units.law(float(plan.target.values[0])))} cannot be reached on the way down from {hot:g} "
            f"degC; expected {units.shown(low):.6g} to {units.in_words(high)}",
        )
    first_degC = first.temperature_degC
    if plan.branches is not None:  # of several, the one that the plan begins with
        several, _ = plan.inverse.solutions(wanted, state.state.memory)
        planned_degC = float(plan.branches.planned.values[0])
        first_degC = float(min(several, key=lambda degC: abs(degC - planned_degC)))
    settle_s = configuration.experiment.settle_s
    approach = to_temperature(loop, plan.mover, state, first_degC, settle_s, "approach", setpoints, units)
    if approach.state is None:
        raise fault("the run", "approach", "expected rows with a reading in this phase")
    return approach.state


def to_temperature(
    loop: Loop,
    law: Law,
    before: Follow | None,
    temperature_degC: float,
    dwell_s: float,
    name: str,
    setpoints: bool,
    units: LawUnits | None = None,
) -> Follow:
    """Ramp to a temperature as fast as the plate can, and dwell there."""
    period = law.settings.period_s
    if before is None:
        start, state = temperature_now(loop, name, period), None
        memory = law.film.initial_memory(start) if law.film is not None else None
    else:
        if before.state is None:
            raise fault("the run", name, "expected rows with a reading in the phase before")
        start, state, memory = before.state.reference_degC, before.state, None
    limit = law.settings.current_limit_A
    rates = [law.plate.rate_range_K_per_s(t, limit) for t in (start, temperature_degC)]
    up = temperature_degC > start
    rate = law.settings.rate_share * min(heat if up else -cool for cool, heat in rates)
    rate = min(rate, law.settings.fastest_K_per_s)
    ramp_s = abs(temperature_degC - start) / max(rate, 0.01) + period
    times = np.array([0.0, ramp_s, ramp_s + max(dwell_s, period)])
    target = Target("temperature", times, np.array([start, temperature_degC, temperature_degC]))
    follow = Follow(law, target, memory, state, setpoints, units)
    loop.phase(name, follow, target.duration_s, period)
    return follow

"""Calibration: condition the film, run a profile that fixes film and plate, identify, check on held-out rows.

pulse      two pulses of current: the model of the plate that the profile is driven with, and whether a current heats
condition  to the hot end: whatever the film was, it is saturated now
major      down to the cold end and back: the major loop, and with it where the transition lies
minor      nested and crossing minor loops inside the transition with dwells: what fixes the weights
check      minor loops that no fit has seen: the model is simulated over them, never one step ahead
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from compensator.control.design import design_temperature
from compensator.control.law import Law, LawSettings
from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.inverse.check import Finding, check_model
from compensator.thermal.plate import Kind
from rig.analysis.film_numbers import FilmNumbers, believed_degC, doubted, numbers_of_run, plate_course
from rig.config.configuration import Configuration
from rig.config.model_file import Model, write_model
from rig.config.target import Target
from rig.control.loop import Loop
from rig.control.policies import Follow, temperature_now, warmed_up
from rig.core.faults import fault
from rig.core.outcome import Tripped
from rig.drivers.controller import cools
from rig.experiment.extended_model import plate_observer
from rig.experiment.minor_loops import fitted_and_checked, minor_turning_points, transition_range
from rig.experiment.pulses import check_same_plate, heat_by_pulses, plate_of_pulses
from rig.records.film_output import FALLING_RESISTANCE, RISING_RESISTANCE, sign_of
from rig.records.run_folder import RunFolder, final_path
from rig.safety.first_plate import KnownPlate
from rig.safety.plate_watch import watchable_rate_K_per_s
from sim.effects.actuator_delay import EFFECT as ACTUATOR_DELAY
from sim.effects.effect import Switched, switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.film.fit import FilmFit, identify_film
from sim.inference.plate.fit import PlateFit, identify_plate
from sim.inference.readings.output_sense import output_falls
from sim.inference.readings.temperature_path import temperature_path
from sim.model.gaps import rows_after_gaps

LEAST_RATE_K_PER_S = 0.03  # of the profile: a plate that can do less has not been seen as it is, or needs hours
LEAST_COOLING_K_PER_S = 0.03  # of a heater at the cold end: the profile would take hours


@dataclass(frozen=True, eq=False)
class Calibration:
    """What came out: the fits, the check on held-out rows, the model and where it was written; predicted_output:
    -log10(R / 1 ohm) of each row by the model; numbers: what the rows tell of the film without a model; findings: what
    to know of the film model before it is used; left_out: a line on each run of rows in which the thermometer was not
    believed."""

    film: FilmFit
    plate: PlateFit
    model: Model
    model_path: Path
    transition_degC: tuple[float, float]
    rows_fitted: int
    rows_checked: int
    check_rmse_dec: float
    check_max_dec: float
    check_rmse_K: float
    predicted_output: Array
    numbers: FilmNumbers | None = None
    findings: tuple[Finding, ...] = ()
    left_out: tuple[str, ...] = ()


def calibration_range(configuration: Configuration) -> tuple[float, float]:
    """The range of the profile: as configured, else 5 K inside the limits."""
    if configuration.calibration.temperature_degC is not None:
        return configuration.calibration.temperature_degC
    low, high = configuration.limits.temperature_degC
    inset = min(5.0, 0.1 * (high - low))
    return low + inset, high - inset


def record_calibration(loop: Loop, configuration: Configuration) -> None:
    """Run the whole profile; the rows are in the loop's folder afterwards."""
    c = configuration.calibration
    low, high = calibration_range(configuration)
    heat_by_pulses(loop, configuration)
    with loop.resting("plate from the pulses, gains"):
        first = loop.watch.plate.known
        kind: Kind = "peltier" if cools(loop.bench.controller) else "heater"
        known = plate_of_pulses(loop.folder, kind, first.delay_s if first is not None else 0.0)
        if first is not None:
            check_same_plate(first, known, loop.elapsed_s())
        loop.know_plate(known)
        law = warmed_up(_temperature_law(configuration, known, c.period_s))
        rate = min(c.rate_K_per_s, _fastest(known, configuration, low, high))
    now = temperature_now(loop, "look", c.period_s)
    condition = _temperature_target([now, high], rate, c.dwell_s, hold_first=False)
    follow = Follow(law, condition)
    loop.phase("condition", follow, condition.duration_s, c.period_s)
    major = _temperature_target([high, low, high, low], rate, c.dwell_s)
    follow.target = major
    loop.phase("major", follow, major.duration_s, c.period_s)
    span = c.transition_degC or transition_range(loop.folder, known.lag_s)
    fitted, checked = fitted_and_checked(minor_turning_points(span, (low, high), c.minor_loops, c.seed))
    for name, points in (("minor", [low, *fitted]), ("check", [fitted[-1], *checked])):
        follow.target = _temperature_target(points, rate, c.dwell_s)
        loop.phase(name, follow, follow.target.duration_s, c.period_s)


def _temperature_law(configuration: Configuration, known: KnownPlate, period_s: float) -> Law:
    control = configuration.control
    dead_time = control.dead_time_s if control.dead_time_s is not None else period_s + known.delay_s
    design = design_temperature(period_s, dead_time, control.ms)
    low, high = configuration.limits.temperature_degC
    settings = LawSettings(
        "temperature", period_s, configuration.limits.current_A, low, high, design.gains, rate_share=control.rate_share
    )
    return Law(settings, known.plate, None, plate_observer(_behind(known), known.plate, period_s))


def _behind(known: KnownPlate) -> list[Switched]:
    """The driver's delay and the thermometer's lag as effects of the model."""
    effects = []
    if known.delay_s > 0.0:
        effects.append(switched(ACTUATOR_DELAY, {"delay_s": known.delay_s}))
    if known.lag_s > 0.0:
        effects.append(switched(SENSOR_LAG, {"tau_s": known.lag_s}))
    return effects


def _fastest(known: KnownPlate, configuration: Configuration, low: float, high: float) -> float:
    """The rate that the plate can keep, up and down, over the whole range, and at which heat does not go unseen."""
    limit = configuration.limits.current_A
    rates = [known.plate.rate_range_K_per_s(t, limit) for t in (low, high)]
    share = configuration.control.rate_share
    slowest = rates[0][0]
    if known.plate.kind == "heater" and slowest > -LEAST_COOLING_K_PER_S:
        text = f"by the first pulses the room has {known.plate.ambient_degC:.1f} degC, and a heater cools no faster "
        text += f"than {max(-slowest, 0.0):.3f} K/s at {low:g} degC; expected a higher cold end"
        raise fault("calibration.temperature_degC", f"[{low:g}, {high:g}]", text)
    fastest = min(share * min(min(-cool, heat) for cool, heat in rates), watchable_rate_K_per_s(known))
    if fastest < LEAST_RATE_K_PER_S:
        text = (
            f"by its pulses the plate can heat and cool by no more than {max(fastest, 0.0):.3f} K/s between {low:g} "
            f"and {high:g} degC within {limit:g} A; expected {LEAST_RATE_K_PER_S:g} K/s: a narrower range, more "
            "current, or a thermometer that is not on the plate?"
        )
        raise Tripped("too_slow", text, 0.0)
    return fastest


def _temperature_target(points: list[float], rate: float, dwell_s: float, hold_first: bool = True) -> Target:
    """Straight ramps between turning points, with a dwell at each."""
    times, values = [0.0], [points[0]]
    if hold_first and dwell_s > 0.0:
        times.append(dwell_s)
        values.append(points[0])
    for before, after in pairwise(points):
        times.append(times[-1] + max(abs(after - before) / rate, 1e-3))
        values.append(after)
        if dwell_s > 0.0:
            times.append(times[-1] + dwell_s)
            values.append(after)
    return Target("temperature", np.array(times), np.array(values))


def own_pauses(time_s: Array, current_A: Array, tick: Array, used: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Return the rows, of those that are used, after pauses of the program's own: between two phases, with the current
    at 0 before."""
    time, current, first = time_s[used], current_A[used], tick[used] == 0
    after = rows_after_gaps(time)
    return np.asarray(after[first[after] & (current[after - 1] == 0.0)], dtype=np.int64)


def through_pauses(
    after: NDArray[np.int64], time_s: Array, degC: Array, output: Array, read_s: Array
) -> tuple[Array, Array, Array, Array]:
    """Return the columns with rows at the usual pace in each pause, on the straight line from its begin to its end and
    without an output: 0 A were commanded and held, so the plate has not turned round. Without these rows there is a gap
    in which the film's memory is unknown. after: the row after each pause."""
    step_s = float(np.median(np.diff(time_s)))
    for k in after[::-1]:
        within_s = np.arange(time_s[k - 1] + step_s, time_s[k] - 0.5 * step_s, step_s)
        known = np.isfinite(degC)
        degC = np.insert(degC, k, np.interp(within_s, time_s[known], degC[known]))
        time_s = np.insert(time_s, k, within_s)
        output, read_s = (np.insert(values, k, np.full(within_s.size, math.nan)) for values in (output, read_s))
    return time_s, degC, output, read_s


def identify_calibration(
    folder: RunFolder, configuration: Configuration, model_path: Path, kind: Kind = "peltier"
) -> Calibration:
    """Fit film and plate to all phases but "check", predict "check" in a simulation over the whole record."""
    time = folder.column("time_s")
    temperature, left_out = believed_degC(folder)
    current, resistance = folder.column("current_A"), folder.column("resistance_ohm")
    output = np.where(np.isfinite(resistance) & (resistance > 0.0), -np.log10(np.maximum(resistance, 1e-12)), math.nan)
    name = FALLING_RESISTANCE
    if output_falls([(temperature, output)]):
        name, output = RISING_RESISTANCE, -output
    checked = folder.column("phase") == "check"
    fitted = ~checked
    plate_fit = identify_plate(time[fitted], temperature[fitted], current[fitted], kind=kind, lag=True)
    read_s = folder.column("resistance_time_s")
    plate_degC = plate_course(time, temperature, plate_fit.lag_s)
    if not plate_fit.far_off:
        course_degC = np.full(time.size, math.nan)
        course_degC[fitted] = plate_fit.course_degC[0]
        plate_degC = np.where(np.isfinite(course_degC), course_degC, plate_degC)
    pauses = own_pauses(time, current, folder.column("tick"), fitted)
    *rows, output_time_s = through_pauses(pauses, *(column[fitted] for column in (time, plate_degC, output, read_s)))
    seed = configuration.calibration.seed
    film_fit = identify_film(*rows, output_time_s=output_time_s, output_name=name, seed=seed)
    film: FilmModel = film_fit.model
    path = temperature_path(time, plate_degC).temperature_degC
    when_read = np.interp(np.where(np.isfinite(read_s), read_s, time), time, path)
    predicted, _ = film.simulate(when_read, film_fit.memories[0])
    error = (predicted - output)[checked]
    error = error[np.isfinite(error)]
    simulated = plate_fit.model.simulate(plate_fit.first_degC[0], time, current)
    error_K = (simulated - plate_degC)[checked]
    records, seen_degC = (str(final_path(folder.path / "record.csv")),), (np.nanmin(plate_degC), np.nanmax(plate_degC))
    model = Model(film, plate_fit.model, film_records=records, film_seen_degC=seen_degC)
    if plate_fit.lag_s > 0.0:
        model = replace(model, effects=({"name": SENSOR_LAG.name, "tau_s": plate_fit.lag_s},))
    rmse = float(np.sqrt(np.mean(error**2)))
    write_model(
        model_path,
        model,
        f"from {int(fitted.sum())} rows of a calibration; RMSE on {int(checked.sum())} held-out rows {rmse:.4f} dec",
    )
    span = configuration.calibration.transition_degC or transition_range(folder, plate_fit.lag_s)
    return Calibration(
        film=film_fit,
        plate=plate_fit,
        model=model,
        model_path=model_path,
        transition_degC=span,
        rows_fitted=int(fitted.sum()),
        rows_checked=int(checked.sum()),
        check_rmse_dec=rmse,
        check_max_dec=float(np.max(np.abs(error))),
        check_rmse_K=float(np.sqrt(np.nanmean(error_K**2))),
        predicted_output=sign_of(name) * -predicted,
        numbers=doubted(numbers_of_run(folder, folder.path.name, plate_fit.lag_s), predicted[fitted], output[fitted]),
        findings=check_model(film, float(np.nanmin(temperature)), float(np.nanmax(temperature))).findings,
        left_out=tuple(left_out),
    )

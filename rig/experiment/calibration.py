"""Calibration: condition the film, run a profile that fixes film and plate, identify, check on held-out rows.

pulse      three current pulses: the plate's first model, and whether the current heats when it should
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

from compensator.design import design_temperature
from compensator.film import FilmModel
from compensator.functions import Array
from compensator.identify_balance import Kind
from compensator.identify_film import FilmFit, identify_film
from compensator.identify_plate import PlateFit, identify_plate
from compensator.law import Law, LawSettings
from compensator.temperature_path import temperature_path
from rig.drivers.heater_drive import cools
from rig.experiment.extended_model import ExtendedLaw, plate_extension
from rig.experiment.film_numbers import FilmNumbers, numbers_of_run
from rig.experiment.policies import CurrentProfile, Follow, temperature_now, warmed_up
from rig.faults import fault
from rig.files.configuration import Configuration
from rig.files.film_output import FALLING_RESISTANCE, RISING_RESISTANCE, sign_of
from rig.files.model_file import Model, write_model
from rig.files.run_folder import RunFolder
from rig.files.target import Target
from rig.loop import Loop
from rig.outcome import Tripped
from rig.safety.first_plate import OF_A_PULSE, OF_PULSES, KnownPlate
from rig.safety.plate_watch import watchable_rate_K_per_s
from sim.effects.effect import Switched, switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG

PULSE_SHARE = 0.5  # of the current limit, at most
PULSE_S, PULSE_K = 8.0, 10.0  # how long, and by how much a pulse is to heat
LONG_LAG_S = 5.0  # beyond it, pulses do not tell a thermometer's lag from the plate's own time constant
OTHER_PLATE = 1.7  # times the gain of the first pulse, or one over that: pulse and pulses agree within 1.3
OTHER_PLATE_BEHIND = 4.0  # behind a long lag, which one pulse hardly tells from a low gain
OTHER_LAG_S, OTHER_LAG = 3.0, 2.0
UNLIKE_A_PLATE = 0.03  # of the pulses' span: effects of the catalogue leave less than 0.02
LEAST_RATE_K_PER_S = 0.03  # of the profile: a plate that can do less has not been seen as it is, or needs hours
LEAST_RISE_K = 0.3  # that a heating pulse must give
LEAST_COOLING_K_PER_S = 0.03  # of a heater at the cold end: the profile would take hours
MEAN_ROWS = 17  # of a lagging thermometer, before its slope is taken
LEAST_LOOP_DEC = 0.02  # between heating and cooling, for there to be a transition


@dataclass(frozen=True, eq=False)
class Calibration:
    """What came out: the fits, the check on held-out rows, the model and where it was written; predicted_output:
    -log10(R / 1 ohm) of each row by the model; numbers: what the rows tell of the film without a model."""

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
    _pulses(loop, configuration)
    with loop.resting("plate from the pulses, gains, compiled loops"):
        first = loop.watch.plate.known
        kind: Kind = "peltier" if cools(loop.bench.controller) else "heater"
        known = _plate_of_pulses(loop.folder, kind, first.delay_s if first is not None else 0.0)
        if first is not None:
            _check_same_plate(first, known, loop.elapsed_s())
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
    turns = minor_turning_points(span, c.minor_loops, c.seed)
    fitted = turns[: max(2, (3 * len(turns)) // 4)]
    checked = turns[len(fitted) :]
    for name, points in (("minor", [low, *fitted]), ("check", [fitted[-1], *checked])):
        follow.target = _temperature_target(points, rate, c.dwell_s)
        loop.phase(name, follow, follow.target.duration_s, c.period_s)


def _pulses(loop: Loop, configuration: Configuration) -> None:
    """Pulses of current of both signs, no larger than what the first plate may take unseen. Raises Tripped where a
    heating current does not heat."""
    known = loop.watch.plate.known
    behind_s = known.behind_s if known is not None else 0.0
    current = PULSE_SHARE * configuration.limits.current_A
    low, high = configuration.limits.temperature_degC
    if known is not None:
        at_room = known.plate.ambient_degC  # where nothing is lost
        current = min(current, current * PULSE_K / (PULSE_S * known.plate.rate_K_per_s(at_room, current)))
    inset = 0.05 * (high - low)  # a pulse ends before the interlock has to end it
    period = configuration.calibration.period_s
    rest_s = PULSE_S + behind_s
    other = -current if cools(loop.bench.controller) else 0.5 * current
    steps = [(0.0, 2.0), (current, PULSE_S), (0.0, rest_s), (other, PULSE_S), (0.0, rest_s)]
    before = len(loop.folder.rows)
    for k, (value, length) in enumerate(steps):
        profile = Target("current", np.array([0.0, length]), np.array([value, value]))
        loop.phase("pulse", CurrentProfile(profile, low + inset, high - inset), length, period)
        if k == 2:
            rise = loop.folder.column("temperature_degC")[before:]
            change = float(np.nanmax(rise) - rise[np.isfinite(rise)][0])
            if not change > LEAST_RISE_K:
                text = (
                    f"{current:g} A for {PULSE_S:g} s changed the temperature by {change:+.2f} K; expected a rise of "
                    f"more than {LEAST_RISE_K:g} K: is the Peltier connected, and with the right polarity?"
                )
                raise Tripped("polarity", text, loop.elapsed_s())


def _plate_of_pulses(folder: RunFolder, kind: Kind, delay_s: float) -> KnownPlate:
    """Plate and the thermometer's lag from all rows so far; the first pulse has told by how much currents come late.

    Raises Tripped where no plate answers as the readings do.
    """
    time, degC, current = (folder.column(name) for name in ("time_s", "temperature_degC", "current_A"))
    acting = np.searchsorted(time, time - delay_s + 1e-6, "right") - 1
    fit = identify_plate(time, degC, np.where(acting >= 0, current[np.maximum(acting, 0)], 0.0), kind=kind, lag=True)
    span_K = float(np.nanmax(degC) - np.nanmin(degC))
    steps = np.abs(np.diff(degC[np.isfinite(degC)]))
    step_K = float(np.min(steps[steps > 0.0], initial=0.5))
    if fit.rmse_K > UNLIKE_A_PLATE * span_K + 3.0 * fit.noise_K + step_K:
        text = (
            f"no plate answers to the pulses as the readings do: the best fit is off by {fit.rmse_K:.2f} K (RMS) over "
            f"{span_K:.1f} K: is the thermometer still on it?"
        )
        raise Tripped("other_plate", text, float(time[-1]))
    doubt = OF_PULSES if fit.lag_s < LONG_LAG_S else OF_A_PULSE
    return KnownPlate(fit.model, fit.lag_s, delay_s, doubt=doubt)


def _check_same_plate(first: KnownPlate, now: KnownPlate, time_s: float) -> None:
    """Raises Tripped where the plate answers to the pulses in another way than to the first one: its thermometer may
    have come off in between, and the fit would take that for the plate."""
    if now.lag_s > OTHER_LAG_S + OTHER_LAG * first.behind_s:
        text = f"it shows a current {now.lag_s:.1f} s late now, {first.behind_s:.1f} s at the most at the first pulse"
        raise Tripped("other_plate", f"the thermometer is not as it was: {text}; is it still on the plate?", time_s)
    then, after = (p.plate.seebeck_over_capacity_per_A_s or p.plate.drive_over_capacity_K_per_s for p in (first, now))
    other = OTHER_PLATE if max(first.behind_s, now.behind_s) < LONG_LAG_S else OTHER_PLATE_BEHIND
    if not 1.0 / other < after / then < other:
        text = (
            f"the pulses of the calibration heat the plate {after / then:.2f} times as fast as the first one did: is "
            "the thermometer still on it?"
        )
        raise Tripped("other_plate", text, time_s)


def _temperature_law(configuration: Configuration, known: KnownPlate, period_s: float) -> Law:
    control = configuration.control
    dead_time = control.dead_time_s if control.dead_time_s is not None else period_s
    design = design_temperature(period_s, dead_time, control.ms)
    low, high = configuration.limits.temperature_degC
    settings = LawSettings(
        "temperature", period_s, configuration.limits.current_A, low, high, design.gains, rate_share=control.rate_share
    )
    if known.lag_s == 0.0:
        return Law(settings, known.plate, None)
    extension = plate_extension([lagging(known.lag_s)], known.plate, period_s)
    assert extension is not None
    return ExtendedLaw(settings, known.plate, None, extension)


def lagging(lag_s: float) -> Switched:
    """A thermometer's lag as an effect of the model."""
    return switched(SENSOR_LAG, {"tau_s": lag_s})


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


def transition_range(folder: RunFolder, lag_s: float = 0.0) -> tuple[float, float]:
    """Where the heating and the cooling branch of the major loop part: by more than 4 % of their largest distance.

    In degC. lag_s: of the thermometer behind the plate; a plain mean over some rows does here, where a current flows
    and nothing may be waited for. Raises Tripped where the film shows no loop in the range.
    """
    major = folder.column("phase") == "major"
    temperature = folder.column("temperature_degC")[major]
    if lag_s > 0.0:
        known = np.isfinite(temperature)
        time = folder.column("time_s")[major]
        filled = np.interp(time, time[known], temperature[known])
        smooth = np.convolve(np.pad(filled, MEAN_ROWS // 2, "edge"), np.ones(MEAN_ROWS) / MEAN_ROWS, "valid")
        temperature = smooth + lag_s * np.gradient(smooth, time)
    resistance = folder.column("resistance_ohm")[major]
    good = np.isfinite(resistance) & (resistance > 0.0) & np.isfinite(temperature)
    temperature, output = temperature[good], -np.log10(resistance[good])
    grid = np.linspace(temperature.min(), temperature.max(), 400)
    rising = np.gradient(temperature) > 0.0
    distance = _branch(temperature, output, ~rising, grid) - _branch(temperature, output, rising, grid)
    if np.corrcoef(temperature, output)[0, 1] < 0.0:  # a film whose resistance rises
        distance = -distance
    if float(np.max(distance)) < LEAST_LOOP_DEC:
        text = (
            f"heating and cooling differ by less than {LEAST_LOOP_DEC:g} decades anywhere between {grid[0]:.1f} and "
            f"{grid[-1]:.1f} degC: is the film connected, and does calibration.temperature_degC span its transition?"
        )
        raise Tripped("no_transition", text, float(folder.column("time_s")[-1]))
    inside = grid[distance > 0.04 * float(np.max(distance))]
    return float(inside[0]), float(inside[-1])


def _branch(temperature: Array, output: Array, rows: Array, grid: Array) -> Array:
    """Mean output of the chosen rows over the grid."""
    order = np.argsort(temperature[rows], kind="stable")
    found: Array = np.interp(grid, temperature[rows][order], output[rows][order])
    return found


def minor_turning_points(span: tuple[float, float], loops: int, seed: int) -> list[float]:
    """Turning points of minor loops in the transition, high and low by turns, from the cold end.

    Nested loops first, shrinking as the damped oscillations of the paper's figure 2; then random ones, so that loops
    begin and end everywhere.
    """
    low, high = span
    width = high - low
    random = np.random.default_rng(seed)
    points: list[float] = []
    nested = max(2, loops // 3)
    for k in range(nested):
        share = 1.0 - k / nested
        middle = low + width * (0.5 + 0.15 * float(random.uniform(-1.0, 1.0)))
        points += [middle + 0.5 * share * width, middle - 0.5 * share * width]
    for _ in range(loops - nested):
        for sign in (1.0, -1.0):
            room = (high - points[-1]) if sign > 0.0 else (points[-1] - low)
            step = float(random.uniform(min(0.15 * width, room), max(room, 0.15 * width)))
            points.append(points[-1] + sign * min(step, max(room, 0.15 * width)))
    return points


def _plate_course(time_s: Array, temperature_degC: Array, lag_s: float) -> Array:
    """The plate's temperature behind a thermometer that lags: T + lag dT/dt, on the smoothed course."""
    if lag_s == 0.0:
        return temperature_degC
    path = temperature_path(time_s, temperature_degC).temperature_degC
    course: Array = path + lag_s * np.gradient(path, time_s)
    return course


def identify_calibration(
    folder: RunFolder, configuration: Configuration, model_path: Path, kind: Kind = "peltier"
) -> Calibration:
    """Fit film and plate to all phases but "check", predict "check" in a simulation over the whole record."""
    time, temperature = folder.column("time_s"), folder.column("temperature_degC")
    current, resistance = folder.column("current_A"), folder.column("resistance_ohm")
    output = np.where(np.isfinite(resistance) & (resistance > 0.0), -np.log10(np.maximum(resistance, 1e-12)), math.nan)
    known = np.isfinite(output) & np.isfinite(temperature)
    name = FALLING_RESISTANCE
    if np.corrcoef(temperature[known], output[known])[0, 1] < 0.0:
        name, output = RISING_RESISTANCE, -output
    checked = folder.column("phase") == "check"
    fitted = ~checked
    plate_fit = identify_plate(time[fitted], temperature[fitted], current[fitted], kind=kind, lag=True)
    read_s = folder.column("resistance_time_s")
    plate_degC = _plate_course(time, temperature, plate_fit.lag_s)
    film_fit = identify_film(
        time[fitted],
        plate_degC[fitted],
        output[fitted],
        output_time_s=read_s[fitted],
        output_name=name,
        seed=configuration.calibration.seed,
    )
    film: FilmModel = film_fit.model
    path = temperature_path(time, plate_degC).temperature_degC
    when_read = np.interp(np.where(np.isfinite(read_s), read_s, time), time, path)
    predicted, _ = film.simulate(when_read, film_fit.memories[0])
    error = (predicted - output)[checked]
    error = error[np.isfinite(error)]
    simulated = plate_fit.model.simulate(plate_fit.first_degC[0], time, current)
    error_K = (simulated - plate_degC)[checked]
    model = Model(film, plate_fit.model)
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
        numbers=numbers_of_run(folder, plate_degC, plate_fit.lag_s),
    )

"""Calibration: condition the film, run a profile that determines film and plate, identify, check on held-out rows.

pulse      two pulses of current: the model of the plate that the profile is driven with, and whether a current heats
condition  to the hot end: whatever the film was, it is saturated now
major      down to the cold end and back: the major loop, and with it the range of the transition
minor      nested and crossing minor loops inside the transition with dwells, which determine the weights
check      minor loops that no fit has seen: the model is simulated over them, never one step ahead

The pulses are one current of each sign (a heater: two sizes), each with a rest, bounded by what the first plate says of
the heat that has not shown yet. One plate has to answer to them, and the same as to the polarity pulse: a thermometer
that came off in between would look like another plate.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from compensator.control.law import Law, LawSettings
from compensator.control.pid import design_temperature
from compensator.hysteresis.film import FilmModel
from compensator.hysteresis.functions import Array
from compensator.inverse.check import Finding, check_model
from compensator.thermal.plate import Kind
from rig.analysis.error import OF_MODEL, in_brackets, judgement, percent
from rig.analysis.identification import finding_documents, finding_notes, plate_notes
from rig.analysis.transition import FilmNumbers, at_own_times, believed_degC, doubted, film_numbers, fresh, plate_course
from rig.config.configuration import Configuration
from rig.config.model_file import Model, write_model
from rig.config.target import Target
from rig.control.law_units import plate_observer
from rig.control.loop import Loop
from rig.control.policies import CurrentProfile, Follow, temperature_now, warmed_up
from rig.core.faults import fault
from rig.core.outcome import Tripped, Unsuitable
from rig.drivers.controller import cools
from rig.records.film_output import FALLING_RESISTANCE, RISING_RESISTANCE, sign_of
from rig.records.run_folder import RunFolder, final_path
from rig.safety.plate_watch import OF_A_PULSE, OF_PULSES, KnownPlate, watchable_rate_K_per_s
from sim.effects.actuator_delay import EFFECT as ACTUATOR_DELAY
from sim.effects.effect import Switched, switched
from sim.effects.sensor_lag import EFFECT as SENSOR_LAG
from sim.inference.film.fit import FilmFit, identify_film
from sim.inference.plate.fit import PlateFit, identify_plate
from sim.inference.readings.output_sense import output_falls
from sim.inference.readings.temperature_path import temperature_path
from sim.model.gaps import rows_after_gaps

PULSE_SHARE = 0.5  # of the current limit, at most
PULSE_S, PULSE_K = 8.0, 10.0  # how long, and by how much a pulse is to heat
LONG_LAG_S = 5.0  # beyond it, pulses do not separate a thermometer's lag from the plate's own time constant
OTHER_PLATE = 1.7  # times the gain of the first pulse, or one over that: 1.5 apart at most, in steps of 0.25 K
OTHER_PLATE_BEHIND = 4.0  # behind a long lag, which one pulse hardly separates from a low gain
OTHER_LAG_S, OTHER_LAG = 3.0, 2.0
UNLIKE_A_PLATE = 0.03  # of the pulses' span: effects of the catalogue leave less than 0.02
LEAST_RISE_K = 0.3  # that a heating pulse must give
MEAN_ROWS = 17  # of a lagging thermometer, before its slope is taken
LEAST_LOOP_DEC = 0.02  # between heating and cooling, for there to be a transition
ASIDE = 0.15  # of the transition's width, by which a nested loop's middle lies off its middle: no two about one point
LEAST_STEP = 0.15  # of the transition's width, between two turns: less moves few play operators
LEAST_RATE_K_PER_S = 0.03  # of the profile: a plate that can do less has not been seen as it is, or needs hours
LEAST_COOLING_K_PER_S = 0.03  # of a heater at the cold end: the profile would take hours
# What comes after it frightens whoever only wants to track, and mostly need not: the demo's heat sink puts its plate's
# model off by 49 times the noise, and its law with feedback holds the film all the same.
FAR_OFF_IN_A_RUN: Final = (
    "If the cause is slow, as a heat sink is, the laws with feedback (full, pid) are hardly affected; if the "
    "thermometer lags, all are. `peltier diagnose` on the record looks for the cause."
)


@dataclass(frozen=True, eq=False)
class Calibration:
    """Result of a calibration: the fits, the check on held-out rows, the model and its file.

    predicted_output: -log10(R / 1 ohm) of each row by the model. numbers: the transition of the film.
    findings: what to know of the film model before it is used. left_out: a line on each run of rows in which the
    thermometer was not believed. intended: the effects of a simulated rig that the plate's model does not have.
    """

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
    intended: tuple[str, ...] = ()

    def lines(self, whole: bool) -> list[str]:
        """Return the lines for the terminal: the check, the transition, and what is not determined. whole: with all
        numbers of the transition, which a run that only tracks leaves to the calibration's report."""
        film = [*self.film.identifiability, *finding_notes(self.findings)]
        return [
            f"calibration: film model: RMS error {self.check_rmse_dec:.4f} dec"
            f"{in_brackets(percent(self.check_rmse_dec), judgement(self.check_rmse_dec, 'dec', OF_MODEL))} on "
            f"{self.rows_checked} held-out rows",
            f"calibration: plate model: RMS error {self.check_rmse_K:.3g} K"
            f"{in_brackets(judgement(self.check_rmse_K, 'K', OF_MODEL))} on the same rows",
            *(self.numbers.lines(whole) if self.numbers is not None else ()),
            *self.left_out,
            *(f"film: {note}" for note in film),
            *(f"plate: {note}" for note in self._plate_notes(film)),
        ]

    def for_run_json(self) -> dict[str, Any]:
        """Return the result as run.json keeps it: all that the report needs."""
        film, plate = self.film, self.plate
        parameters = zip(plate.names, plate.values, plate.standard_errors, strict=True)
        return {
            **self._check(),
            "rmse_dec": film.rmse,
            "memoryless": film.model.memoryless.function,
            "operators": int((film.model.weights > 0.0).sum()),
            "plate": [{"name": name, "value": value, "standard_error": error} for name, value, error in parameters],
            "transition": self.numbers.shown() if self.numbers is not None else None,
        }

    def document(self) -> dict[str, Any]:
        """Return the JSON of `peltier calibrate`."""
        return {
            "format": "peltier-calibration/1",
            "folder": self.model_path.parent,
            "model": self.model_path,
            **self._check(),
            "rows_fitted": self.rows_fitted,
            "check": finding_documents(self.findings),
            "transition": [self.numbers.document()] if self.numbers is not None else [],
        }

    def _check(self) -> dict[str, Any]:
        notes = self.film.identifiability
        return {
            "check_rmse_dec": self.check_rmse_dec,
            "check_max_dec": self.check_max_dec,
            "check_rmse_K": self.check_rmse_K,
            "rows_checked": self.rows_checked,
            "transition_degC": list(self.transition_degC),
            "identifiability": [*self.left_out, *notes, *self._plate_notes(notes)],
        }

    def _plate_notes(self, known: Iterable[str]) -> list[str]:
        """Return the notes on the plate's fit; the first, on a large model error, with what it means for a run, or that
        it is intended."""
        notes = plate_notes(self.plate, known)
        if not self.plate.far_off:
            return notes
        if not self.intended:
            return [notes[0], FAR_OFF_IN_A_RUN, *notes[1:]]
        text = f"The plate's model is off by {self.plate.rmse_K:.2g} K (RMS), as intended: in this simulated rig "
        text += f"{' and '.join(self.intended)}, which the controller's model does not know. So its parameters may "
        return [text + "be off by more than their intervals.", *notes[1:]]


def heat_by_pulses(loop: Loop, configuration: Configuration) -> None:
    """Send pulses of current of both signs, no larger than what the first plate may take unseen. Raises Tripped if a
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


def plate_of_pulses(folder: RunFolder, kind: Kind, delay_s: float) -> KnownPlate:
    """Fit the plate and the thermometer's lag to all rows so far; delay_s: of the current, from the first pulse.

    Raises Tripped if no plate answers as the readings do.
    """
    time, degC, current = (folder.column(name) for name in ("time_s", "temperature_degC", "current_A"))
    acting = np.searchsorted(time, time - delay_s + 1e-6, "right") - 1
    acted_A = np.where(acting >= 0, current[np.maximum(acting, 0)], 0.0)
    fit = identify_plate(time, degC, acted_A, kind=kind, lag=True, slopes=False)  # two pulses span some kelvin
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


def check_same_plate(first: KnownPlate, now: KnownPlate, time_s: float) -> None:
    """Raise Tripped if the plate answers to the pulses in another way than to the first one: its thermometer may have
    come off in between, and the fit would take that for the plate."""
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


def transition_range(folder: RunFolder, lag_s: float = 0.0) -> tuple[float, float]:
    """Return the range (degC) in which heating and cooling branch of the major loop differ, by more than 4 % of their
    largest distance.

    lag_s: of the thermometer behind the plate; a plain mean over some rows does here, where a current flows
    and nothing may be waited for. Raises Unsuitable if the film shows no loop in the range.
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
    if output_falls([(temperature, output)]):  # a film whose resistance rises
        distance = -distance
    if float(np.max(distance)) < LEAST_LOOP_DEC:
        text = (
            f"heating and cooling differ by less than {LEAST_LOOP_DEC:g} decades anywhere between {grid[0]:.1f} and "
            f"{grid[-1]:.1f} degC: is the film connected, and does calibration.temperature_degC span its transition?"
        )
        raise Unsuitable("no_transition", text)
    inside = grid[distance > 0.04 * float(np.max(distance))]
    return float(inside[0]), float(inside[-1])


def _branch(temperature: Array, output: Array, rows: Array, grid: Array) -> Array:
    """Return the mean output of the chosen rows over the grid."""
    order = np.argsort(temperature[rows], kind="stable")
    found: Array = np.interp(grid, temperature[rows][order], output[rows][order])
    return found


def minor_turning_points(span: tuple[float, float], within: tuple[float, float], loops: int, seed: int) -> list[float]:
    """Return turning points of minor loops about the transition, high and low by turns, from the cold end.

    Nested loops first, shrinking as the damped oscillations of the paper's figure 2; then random ones, so that loops
    begin and end everywhere. The widest may turn beyond an end of the transition, by `ASIDE` of its width, but none
    outside of `within`, where the plate is let go: with loops that all end inside, feedforward predicted a film of
    relays two to three times worse.
    """
    low, high = span
    width = high - low
    random = np.random.default_rng(seed)
    points: list[float] = []
    nested = max(2, loops // 3)
    for k in range(nested):
        share = 1.0 - k / nested
        middle = low + width * (0.5 + ASIDE * float(random.uniform(-1.0, 1.0)))
        points += [min(middle + 0.5 * share * width, within[1]), max(middle - 0.5 * share * width, within[0])]
    for _ in range(loops - nested):
        for sign in (1.0, -1.0):
            room = (high - points[-1]) if sign > 0.0 else (points[-1] - low)  # the step before left its own length
            points.append(points[-1] + sign * float(random.uniform(min(LEAST_STEP * width, room), room)))
    return points


def fitted_and_checked(turns: list[float]) -> tuple[list[float], list[float]]:
    """Return the turning points of the loops for the fit, three quarters of all, and of those after them that no fit
    sees."""
    fitted = max(2, (3 * len(turns)) // 4)
    return turns[:fitted], turns[fitted:]


def calibration_range(configuration: Configuration) -> tuple[float, float]:
    """Return the range of the profile (degC): as configured, else 5 K inside the limits."""
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
    """Return the driver's delay and the thermometer's lag as effects of the model."""
    effects = []
    if known.delay_s > 0.0:
        effects.append(switched(ACTUATOR_DELAY, {"delay_s": known.delay_s}))
    if known.lag_s > 0.0:
        effects.append(switched(SENSOR_LAG, {"tau_s": known.lag_s}))
    return effects


def _fastest(known: KnownPlate, configuration: Configuration, low: float, high: float) -> float:
    """Return the rate (K/s) that the plate can keep, up and down, over the whole range, slow enough for the watch."""
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
    """Return straight ramps between turning points, with a dwell at each."""
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
    film_fit = identify_film(*rows, output_time_s=output_time_s, output_name=name)
    film: FilmModel = film_fit.model
    shown = at_own_times(rows[0], fresh(rows[2]), output_time_s)
    numbers = film_numbers(rows[0], rows[1], shown, name, folder.path.name, plate_fit.lag_s, film_fit)
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
        numbers=doubted(numbers, predicted[fitted], output[fitted]),
        findings=check_model(film, float(np.nanmin(temperature)), float(np.nanmax(temperature))),
        left_out=tuple(left_out),
    )

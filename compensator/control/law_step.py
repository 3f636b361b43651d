"""One period of the control law, compiled, and the parts that it is made of: see `compensator.control.law`.

The parts take and give named tuples. They are called by `law_step` for a plate and a film without effects, and one
after the other by `compensator.control.observer` for a chain with effects. `law_step` itself takes and gives arrays of
the tuples' numbers (`compensator.control.packing`).
"""

from __future__ import annotations

import math
from math import nan
from typing import Any, Final, Literal, NamedTuple

import numpy as np

from compensator.compiled import njit
from compensator.control.disturbance import NONE as NO_ERRORS
from compensator.control.disturbance import corrected, grown, moved_to, told
from compensator.control.estimate import Estimate, learned_noise
from compensator.control.packing import numbers_of, packed, unpacked
from compensator.control.pid import PidGains, PidState, pid_integrate, pid_output
from compensator.control.reference_shaping import (
    FilmNow,
    Planned,
    Reach,
    Reference,
    Turn,
    headed,
    left_for_later,
    limited,
    next_reference,
    next_temperature,
)
from compensator.control.unknown_heat import Foretold, corrected_temperature, unknown_heats
from compensator.control.unknown_memory import NONE, mean_of, taken_along, weighed
from compensator.hysteresis.film import Memory, Packed, memory_owning
from compensator.hysteresis.functions import Array
from compensator.hysteresis.play import advance, output_of
from compensator.inverse.solve import Settings
from compensator.thermal.plate import current_for_rate, current_range, drive_rate, rate, with_drive
from compensator.thermal.plate import step as plate_step

LawName = Literal["full", "feedforward", "pid", "instrument_pid", "temperature"]
NAMES: Final = ("full", "feedforward", "pid", "instrument_pid", "temperature")
FULL, FEEDFORWARD, PID, INSTRUMENT_PID, TEMPERATURE = range(5)  # places in NAMES, for compiled code
STALLED: Final = 2.1  # periods from one command to the next beyond which some were missed, not one late
SLOWEST_K_PER_S: Final = 1e-6  # a reference that can move either way, however little the plate can


class Inputs(NamedTuple):
    """What a step is given. Readings are nan where there is none.

    output, target_now: in the film's output unit, as read and as wanted then. targets: shape (preview,), at
    `Law.preview_times_s` after the command acts; for the law "temperature" targets are degC. output_age_s: by how much
    the output was read before the temperature. acts_after_s: by how much the command acts after the temperature was
    read. test_current_A: of the ohmmeter, while it read. elapsed_s: between the command before and this one, as they
    act; nan: a period.
    """

    temperature_degC: float
    output: float
    target_now: float
    targets: Array
    output_age_s: float = 0.0
    acts_after_s: float = 0.0
    test_current_A: float = 0.0
    elapsed_s: float = nan


class Command(NamedTuple):
    """What a step commands: the current (A), or for "instrument_pid" the setpoint (degC).

    reference_degC: where the film should be now. output_model: the film model's output now. reachable: whether the
    target one period ahead can be reached from here.
    """

    current_A: float
    setpoint_degC: float
    reference_degC: float
    output_model: float
    reachable: bool


class LawState(NamedTuple):
    """All that a law carries from one step to the next; no step changes it.

    temperature_degC, thermometer_degC: of the plate and of its thermometer, as estimated. left, reference: where film
    and plate were to be as the last command acted, and where they should be a period later. input_degC, plays: the
    film's memory. current_A: in force. toward: sign of the output's last move;
    moved: what the last step planned. warming_K: of the film above the plate, as last planned (nan: not yet). possible:
    the memories that the film may have, where nobody knows it (`compensator.control.unknown_memory`), plays then their
    mean; no rows where it is known. errors: what the film model may lack (`compensator.control.disturbance`). heats:
    how unsteady the plate's unknown heat may be, and how late its thermometer (`compensator.control.unknown_heat`).
    observer: the state of the law's observer as the last command acts, not told of it yet; None without one.
    """

    temperature_degC: float
    thermometer_degC: float
    left: Reference
    reference: Reference
    input_degC: float
    plays: Array
    pid: PidState = PidState()
    current_A: float = 0.0
    toward: float = 0.0
    moved: float = 0.0
    warming_K: float = nan
    estimate: Estimate = Estimate()
    possible: Array = NONE
    errors: Array = NO_ERRORS
    heats: Array = unknown_heats()
    observer: Any = None

    @property
    def memory(self) -> Memory:
        """The film's memory."""
        return memory_owning(self.input_degC, self.plays)

    @property
    def disturbance(self) -> float:
        """Reading minus film model, in the output's unit."""
        return float(told(self.errors)[0])

    @property
    def reference_degC(self) -> float:
        """Where the film should be now."""
        return self.reference.film_degC


Known: Any = numbers_of(LawState, "Known", __name__)


class Rule(NamedTuple):
    """A law's parameters as the compiled loops take them, all of them numbers: see `LawSettings`; name is a place in
    `NAMES`, what is true or false 1 or 0."""

    name: float
    period_s: float
    current_limit_A: float
    low_degC: float
    high_degC: float
    spacing_s: float
    band: float
    reversal: float
    trusts_model: float
    rate_share: float
    fastest_K_per_s: float
    most_share: float
    has_film: float
    output_range: float
    folds: float
    gains: PidGains


@njit
def passed_s(period_s: float, elapsed_s: float) -> float:
    """Time since the command before acted. elapsed_s: nan: a period."""
    return period_s if math.isnan(elapsed_s) else elapsed_s


@njit
def led(period_s: float, elapsed_s: float, left: Reference, reference: Reference, here: Reference) -> Reference:
    """Where film and plate should be as a command acts: on the way from where they were to be at the command before,
    `left`, to where they were led in a period, `reference`; where they are, `here`, after periods without a command:
    nobody led them in those. elapsed_s: nan: a period."""
    if math.isnan(elapsed_s):
        return reference
    if elapsed_s > STALLED * period_s:
        return here
    share = elapsed_s / period_s
    film_K, plate_K = reference.film_degC - left.film_degC, reference.plate_degC - left.plate_degC
    return Reference(left.film_degC + share * film_K, left.plate_degC + share * plate_K)


@njit
def read_temperature(
    rule: Rule, estimate: Estimate, heats: Array, told: Foretold, lag_s: float, inputs: Inputs
) -> tuple[float, float, Estimate, Array]:
    """(thermometer, plate, both in degC as the command acts, the estimate, heats) after the thermometer's reading.

    told: foretold for then; lag_s: of the thermometer behind the plate, as the model has it.
    """
    reading, since_s = inputs.temperature_degC, passed_s(rule.period_s, inputs.elapsed_s)
    own = rule.name == INSTRUMENT_PID or not rule.trusts_model  # the current is the controller's own: not foretold
    if math.isnan(reading) or rule.name == FEEDFORWARD:
        noise = learned_noise(estimate.degC, nan, since_s)
        known = Estimate(estimate.drift_K_per_s, estimate.drive_error, noise, estimate.output)
        if own:
            return told.shown_before_degC, told.plate_before_degC, known, heats
        return told.shown_degC, told.plate_degC, known, heats
    if own:
        return reading, reading, estimate, heats
    return corrected_temperature(estimate, heats, told, reading, since_s, inputs.acts_after_s, lag_s)


@njit
def read_output(
    rule: Rule, estimate: Estimate, errors: Array, off: float, moved: float, inputs: Inputs
) -> tuple[Estimate, Array]:
    """(estimate, what the film model may lack) after the ohmmeter's reading, which is `off` the film model; nan: there
    was none. moved: by how much the output was to move since the reading before."""
    if rule.name not in (FULL, INSTRUMENT_PID):
        return estimate, errors
    since_s = passed_s(rule.period_s, inputs.elapsed_s)
    errors = grown(errors, rule.output_range, moved, since_s)
    noise = learned_noise(estimate.output, inputs.output if math.isfinite(off) else nan, since_s)
    known = Estimate(estimate.drift_K_per_s, estimate.drive_error, estimate.degC, noise)
    if not math.isfinite(off):
        return known, errors
    return known, corrected(errors, off, noise.variance, rule.most_share)


@njit
def remembered(
    rule: Rule,
    before: Array,
    errors: Array,
    known: Estimate,
    possible: Array,
    plays: Array,
    off: float,
    moved: float,
    film: Packed,
    inputs: Inputs,
) -> tuple[Array, Array, Array]:
    """(possible memories, their mean, errors) after a reading, which is `off` the mean memory's output.

    possible: at the temperature of now, changed. before, errors: what the film model may lack, before and after the
    reading. Without a reading the likelihoods stay.
    """
    mean = np.empty(plays.size)
    if rule.name in (FULL, INSTRUMENT_PID) and math.isfinite(off):
        doubt = told(grown(before, rule.output_range, moved, passed_s(rule.period_s, inputs.elapsed_s)))[1]
        variance = doubt + known.output.variance
        possible = weighed(possible, plays, off, doubt / variance, variance, film)
        errors = moved_to(errors, mean_of(possible, mean))
        return (possible[:0] if possible.shape[0] == 1 else possible), mean, errors
    mean_of(possible, mean)
    return possible, mean, errors


@njit
def planned(
    rule: Rule,
    plate: Array,
    plate_degC: float,
    lag_s: float,
    film: FilmNow,
    now: Reference,
    toward: float,
    doubt: float,
    noise: float,
    targets: Array,
) -> Planned:
    """Where film and plate should be a period after the command acts. targets: without the disturbance; doubt, noise:
    variances of the output's estimate and of a reading."""
    low, high = current_range(plate, plate_degC, rule.current_limit_A)
    cooling = max(rule.rate_share * rate(plate, plate_degC, low), -rule.fastest_K_per_s)
    heating = min(rule.rate_share * rate(plate, plate_degC, high), rule.fastest_K_per_s)
    slowest, fastest = min(cooling, -SLOWEST_K_PER_S), max(heating, SLOWEST_K_PER_S)
    reach = Reach(rule.spacing_s, rule.period_s, slowest, fastest, lag_s)
    if rule.name == TEMPERATURE:
        found = Planned(next_temperature(targets, now, reach), nan, 0.0, True)
    else:
        band = max(rule.band, rule.reversal * math.sqrt(doubt)) if rule.name != FEEDFORWARD else 0.0
        stays_degC = film.degC if rule.folds else now.film_degC  # another branch may lie between them where D folds
        if rule.name == FULL and not rule.folds:
            targets = targets - left_for_later(targets, min(doubt, noise), film, toward, rule.period_s)
        found = next_reference(targets, Turn(band, toward, stays_degC), film, now, reach)
    film_degC = limited(found.reference.film_degC, rule.low_degC, rule.high_degC)
    own_degC = limited(found.reference.plate_degC, rule.low_degC, rule.high_degC)
    return Planned(Reference(film_degC, own_degC), found.output, found.move, found.reached)


@njit
def driven(
    rule: Rule, plate: Array, plate_degC: float, now_degC: float, next_degC: float, pid: PidState
) -> tuple[float, PidState]:
    """(current, the PID's state) that takes the plate from where it should be now to where it should be next.

    Without feedback it goes from where the model says that it is.
    """
    feedback = rule.name in (FULL, TEMPERATURE)
    wanted = (next_degC - (now_degC if feedback else plate_degC)) / rule.period_s
    if feedback:
        correction, pid = pid_output(rule.gains, pid, now_degC, plate_degC, rule.period_s)
        wanted += correction
    current = current_for_rate(plate, plate_degC, wanted, rule.current_limit_A)
    if feedback:
        shortfall = rate(plate, plate_degC, current) - wanted
        if abs(shortfall) < 1e-12:
            shortfall = 0.0
        pid = pid_integrate(rule.gains, pid, now_degC, plate_degC, shortfall, rule.period_s)
    return current, pid


@njit
def on_the_output(
    rule: Rule, plate: Array, here: float, pid: PidState, current: float, inputs: Inputs
) -> tuple[float, PidState]:
    """(current, the PID's state) of the law "pid": the last current holds while there is no reading."""
    if not math.isfinite(inputs.output):
        return current, pid
    wanted, pid = pid_output(rule.gains, pid, inputs.target_now, inputs.output, rule.period_s)
    low, high = current_range(plate, here, rule.current_limit_A)
    current = limited(wanted, low, high)
    pid = pid_integrate(rule.gains, pid, inputs.target_now, inputs.output, current - wanted, rule.period_s)
    return current, pid


Answer = tuple[float, float, float, float, bool]  # what a `Command` is made of


@njit
def law_step(
    ruled: Array,
    film: Packed,
    inverse: Settings,
    plate: Array,
    numbers: Array,
    plays: Array,
    possible: Array,
    errors: Array,
    heats: Array,
    inputs: Inputs,
) -> tuple[Answer, Array, Array, Array, Array, Array]:
    """One period of a law whose plate and film have no effects on them: (the command's numbers; the next state's
    numbers, play operators, possible memories, errors of the film model, unknown heats). ruled: the numbers of `Rule`;
    numbers: of `Known`."""
    rule, s = unpacked(ruled, Rule), unpacked(numbers, Known)
    period, drift = rule.period_s, s.estimate.drift_K_per_s
    since_s = passed_s(period, inputs.elapsed_s)
    driven_K_per_s = drive_rate(plate, s.temperature_degC, s.current_A)
    plate = with_drive(plate, 1.0 + s.estimate.drive_error)
    here = plate_step(plate, s.temperature_degC, s.current_A, since_s) + drift * since_s
    foretold = Foretold(here, here, s.thermometer_degC, s.temperature_degC, driven_K_per_s)
    shown, here, known, heats = read_temperature(rule, s.estimate, heats, foretold, 0.0, inputs)
    plays, possible, errors, output, v = plays.copy(), possible.copy(), errors.copy(), nan, s.input_degC
    envelopes, radii, _, _, _ = film
    if rule.has_film:
        if possible.shape[0] > 0:
            taken_along(possible, here, v, film)
            mean_of(possible, plays)
        else:
            advance(here, v, envelopes, radii, plays)
        v, output = here, output_of(film, here, plays)
        off = inputs.output + s.moved / period * (inputs.output_age_s + inputs.acts_after_s) - output
        before = errors
        known, errors = read_output(rule, known, errors, off, s.moved, inputs)
        if possible.shape[0] > 0:
            possible, plays, errors = remembered(
                rule, before, errors, known, possible, plays, off, s.moved, film, inputs
            )
            output = output_of(film, here, plays)
    disturbance, doubt = told(errors)
    if rule.name == PID:
        current, pid = on_the_output(rule, plate, here, s.pid, s.current_A, inputs)
        after = Known(here, shown, s.left, s.reference, v, pid, current, s.toward, s.moved, nan, known)
        return (current, nan, nan, nan, True), packed(after, numbers.size), plays, possible, errors, heats
    there = FilmNow(v, plays, film, inverse)
    targets = inputs.targets - disturbance
    now = led(period, inputs.elapsed_s, s.left, s.reference, Reference(here, here))
    plan = planned(rule, plate, here, 0.0, there, now, s.toward, doubt, known.output.variance, targets)
    now_degC, next_degC = now.film_degC, plan.reference.film_degC
    current, pid = driven(rule, plate, here, now_degC, next_degC, s.pid)
    toward = headed(s.toward, now, plan)
    after = Known(here, shown, now, plan.reference, v, pid, current, toward, plan.move, nan, known)
    answer = current, next_degC, now_degC, output, plan.reached
    return answer, packed(after, numbers.size), plays, possible, errors, heats

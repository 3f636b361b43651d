"""One period of the control law, compiled, and the parts that it is made of: see `compensator.control.law`.

The parts take and give named tuples. They are called by `law_step` for a plate and a film without effects, and one
after the other by `compensator.control.law` for a chain with effects. `law_step` itself takes and gives arrays of
the tuples' numbers (`compensator.control.law_step`).
"""

from __future__ import annotations

import math
from collections import namedtuple
from collections.abc import Callable
from functools import cache
from math import nan
from typing import Any, Final, Literal, NamedTuple, TypeVar, cast, get_type_hints

import numpy as np
from numba import types
from numba.extending import intrinsic

from compensator.compiled import njit
from compensator.control.estimator import (
    NO_ERRORS,
    NONE,
    Estimate,
    Predicted,
    corrected_temperature,
    disturbance_of,
    errors_after,
    errors_later,
    initial_heats,
    mean_of,
    taken_along,
    updated_noise,
    weighed,
    with_disturbance,
)
from compensator.control.pid import PidGains, pi_integrated, pi_output
from compensator.control.reference_shaping import (
    FilmNow,
    Planned,
    Reach,
    Reference,
    Turn,
    direction_after,
    limited,
    next_reference,
    next_temperature,
    stop_short_by,
)
from compensator.hysteresis.film import Memory, Packed, memory_owning
from compensator.hysteresis.functions import Array
from compensator.hysteresis.play import advance, output_of
from compensator.inverse.search import Settings
from compensator.thermal.plate import current_for_rate, current_range, drive_rate, rate, with_drive
from compensator.thermal.plate import step as plate_step

# ---- named tuples of numbers as one array, and back: a compiled loop takes an array in a tenth of the time ----
#
# A tuple whose fields are floats, or such tuples, is the same memory as an array of its numbers in order. `flattener`
# and `rebuilder` are for Python, `packed` and `unpacked` for compiled loops; all go by the tuple's own fields.

Numbers = TypeVar("Numbers")


@cache
def fields_of(kind: type) -> dict[str, type]:
    """Return the fields of a named tuple that are numbers: floats, and named tuples of such."""
    hints = get_type_hints(kind)
    return {name: hints[name] for name in kind._fields if _is_number(hints[name])}  # type: ignore[attr-defined]


def _is_number(kind: Any) -> bool:
    return kind is float or (isinstance(kind, type) and issubclass(kind, tuple) and hasattr(kind, "_fields"))


def numbers_of(kind: type, name: str, module: str) -> Any:
    """Return a named tuple of those fields of another that are numbers."""
    made = namedtuple(name, fields_of(kind), module=module)  # type: ignore[misc]
    made.__annotations__ = dict(fields_of(kind))
    made.__doc__ = f"The numbers of `{kind.__name__}`, in its order."
    return made


@cache
def flattener(kind: type) -> Callable[[Any], tuple[float, ...]]:
    """Return a function that takes all numbers out of a tuple of that kind, in order.

    It is one expression, made of the fields as `namedtuple` makes a class: a walk through them takes four times as
    long.
    """

    def taken(one: type, place: str) -> list[str]:
        each = [(f"{place}.{name}", inside) for name, inside in fields_of(one).items()]
        return [t for at, inside in each for t in ([at] if inside is float else taken(inside, at))]

    made: Callable[[Any], tuple[float, ...]] = eval(f"lambda whole: ({', '.join(taken(kind, 'whole'))},)")
    return made


@cache
def rebuilder(kind: type) -> Callable[..., Any]:
    """Return a function that makes a tuple of that kind of a list of its numbers, and of its other fields."""
    names: dict[str, Any] = {"new": tuple.__new__}
    others: list[str] = []

    def made(one: type, first: int) -> tuple[str, int]:
        parts, numbers, names[one.__name__] = [], fields_of(one), one
        for name in one._fields:  # type: ignore[attr-defined]
            if name not in numbers:
                part, others[len(others) :] = name, [name]
            elif numbers[name] is float:
                part, first = f"v[{first}]", first + 1
            else:
                part, first = made(numbers[name], first)
            parts.append(part)
        return f"new({one.__name__}, ({', '.join(parts)},))", first

    body, _ = made(kind, 0)
    rebuilt: Callable[..., Any] = eval(f"lambda {', '.join(['v', *others])}: {body}", names)
    return rebuilt


def _compiled_type(kind: type) -> Any:
    """Return numba's type of such a tuple."""
    inside = [types.float64 if each is float else _compiled_type(each) for each in fields_of(kind).values()]
    if all(each == inside[0] for each in inside):
        return types.NamedUniTuple(inside[0], len(inside), kind)  # type: ignore[no-untyped-call]
    return types.NamedTuple(inside, kind)  # type: ignore[no-untyped-call]


@intrinsic
def _load(typingctx: Any, array: Any, kind: Any) -> Any:
    """See `unpacked`."""
    whole = _compiled_type(kind.instance_class)

    def load(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[0])(context, builder, arguments[0]).data
        return builder.load(builder.bitcast(data, context.get_value_type(whole).as_pointer()))

    return whole(array, kind), load


unpacked: Callable[[Array, type[Numbers]], Numbers] = cast(Any, _load)
"""The tuple of that kind (the class itself) that an array has the numbers of; for compiled loops."""


@intrinsic
def _store(typingctx: Any, numbers: Any, array: Any) -> Any:
    def store(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        data = context.make_array(signature.args[1])(context, builder, arguments[1]).data
        builder.store(arguments[0], builder.bitcast(data, context.get_value_type(numbers).as_pointer()))
        return context.get_dummy_value()

    return types.void(numbers, array), store


stored: Callable[[Any, Array], None] = cast(Any, _store)
"""A tuple's numbers into an array that has room for them, a row of another as well; for compiled loops."""


@njit
def packed(numbers: Any, count: int) -> Array:
    """Return a tuple's count numbers in a new array; for compiled loops."""
    array = np.empty(count)
    stored(numbers, array)
    return array


LawName = Literal["full", "feedforward", "pid", "instrument_pid", "temperature"]
NAMES: Final = ("full", "feedforward", "pid", "instrument_pid", "temperature")
FULL, FEEDFORWARD, PID, INSTRUMENT_PID, TEMPERATURE = range(5)  # places in NAMES, for compiled code
STALLED: Final = 2.1  # periods from one command to the next beyond which some were missed, not one late
SLOWEST_K_PER_S: Final = 1e-6  # a reference that can move either way, however little the plate can


class Inputs(NamedTuple):
    """Inputs of a step; readings are nan if there is none.

    output, target_now: reading and target at its time, in the film's output unit. targets: shape (preview,), at
    `Law.preview_times_s` after the command acts; for the law "temperature" in degC. output_age_s: from the output's
    reading to the temperature's. acts_after_s: from the temperature's reading until the command acts. test_current_A:
    of the ohmmeter, while it read. elapsed_s: from the command before until this one acts; nan: a period.
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
    """Command of a step: a current (A), or for "instrument_pid" a setpoint (degC).

    reference_degC: reference of the film now. output_model: output of the film model now. reachable: True if the target
    one period ahead can be reached from here.
    """

    current_A: float
    setpoint_degC: float
    reference_degC: float
    output_model: float
    reachable: bool


class LawState(NamedTuple):
    """State of a law between two steps; no step changes it.

    temperature_degC, thermometer_degC: estimates of the plate and its thermometer. left, reference: reference as the
    last command acted, and a period later. input_degC, plays: the film's memory. current_A: in force. toward: sign of
    the output's last move; moved: move that the last step planned. warming_K: of the film above the plate, as last
    planned (nan: not yet). possible: memories that the film may have, if it is unknown
    (`compensator.control.estimator`), with plays their mean; else no rows. errors, heats: filters of the film
    model's error and of the plate (`compensator.control.estimator`). observer: its state as the last command acts,
    before that command; None without one.
    """

    temperature_degC: float
    thermometer_degC: float
    left: Reference
    reference: Reference
    input_degC: float
    plays: Array
    integral: float = 0.0
    current_A: float = 0.0
    toward: float = 0.0
    moved: float = 0.0
    warming_K: float = nan
    estimate: Estimate = Estimate()
    possible: Array = NONE
    errors: Array = NO_ERRORS
    heats: Array = initial_heats()
    observer: Any = None

    @property
    def memory(self) -> Memory:
        """Return the film's memory."""
        return memory_owning(self.input_degC, self.plays)

    @property
    def disturbance(self) -> float:
        """Return the estimated reading minus film model, in the output's unit."""
        return float(disturbance_of(self.errors)[0])

    @property
    def reference_degC(self) -> float:
        """Return the film's reference now."""
        return self.reference.film_degC


Known: Any = numbers_of(LawState, "Known", __name__)


class Rule(NamedTuple):
    """Settings of a law as the compiled loops take them, all numbers: see `LawSettings`.

    name is a place in `NAMES`; True and False are 1 and 0.
    """

    name: float
    period_s: float
    current_limit_A: float
    low_degC: float
    high_degC: float
    spacing_s: float
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
    """Return the time since the command before acted. elapsed_s: nan: a period."""
    return period_s if math.isnan(elapsed_s) else elapsed_s


@njit
def reference_at(
    period_s: float, elapsed_s: float, left: Reference, reference: Reference, here: Reference
) -> Reference:
    """Return the reference as a command acts, elapsed_s (nan: a period) after the one before.

    It lies on the way from the reference at that command, `left`, to the one a period later, `reference`; after periods
    without a command it is where film and plate are, `here`: they were not controlled in between.
    """
    if math.isnan(elapsed_s):
        return reference
    if elapsed_s > STALLED * period_s:
        return here
    share = elapsed_s / period_s
    film_K, plate_K = reference.film_degC - left.film_degC, reference.plate_degC - left.plate_degC
    return Reference(left.film_degC + share * film_K, left.plate_degC + share * plate_K)


@njit
def read_temperature(
    rule: Rule, estimate: Estimate, heats: Array, predicted: Predicted, lag_s: float, inputs: Inputs
) -> tuple[float, float, Estimate, Array]:
    """Return thermometer and plate (degC) as the command acts, the estimate and heats, after the thermometer's reading.

    predicted: for that moment. lag_s: of the thermometer behind the plate in the model.
    """
    reading, since_s = inputs.temperature_degC, passed_s(rule.period_s, inputs.elapsed_s)
    own = rule.name == INSTRUMENT_PID or not rule.trusts_model  # the current is the controller's own: not foretold
    if math.isnan(reading) or rule.name == FEEDFORWARD:
        noise = updated_noise(estimate.degC, nan, since_s)
        known = Estimate(estimate.drift_K_per_s, estimate.drive_error, noise, estimate.output)
        if own:
            return predicted.shown_before_degC, predicted.plate_before_degC, known, heats
        return predicted.shown_degC, predicted.plate_degC, known, heats
    if own:
        return reading, reading, estimate, heats
    return corrected_temperature(estimate, heats, predicted, reading, since_s, inputs.acts_after_s, lag_s)


@njit
def read_output(
    rule: Rule, estimate: Estimate, errors: Array, off: float, moved: float, inputs: Inputs
) -> tuple[Estimate, Array]:
    """Return the estimate and the film model's errors after the ohmmeter's reading.

    off: reading minus film model; nan if there was none. moved: planned move of the output since the reading before.
    """
    if rule.name not in (FULL, INSTRUMENT_PID):
        return estimate, errors
    since_s = passed_s(rule.period_s, inputs.elapsed_s)
    errors = errors_later(errors, rule.output_range, moved, since_s)
    noise = updated_noise(estimate.output, inputs.output if math.isfinite(off) else nan, since_s)
    known = Estimate(estimate.drift_K_per_s, estimate.drive_error, estimate.degC, noise)
    if not math.isfinite(off):
        return known, errors
    return known, errors_after(errors, off, noise.variance, rule.most_share)


@njit
def memories_after(
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
    """Return the possible memories, their mean, and the errors after a reading, which is `off` the mean memory's
    output.

    possible: at the present temperature; changed in place. before, errors: of the film model, before and after the
    reading. Without a reading the likelihoods stay.
    """
    mean = np.empty(plays.size)
    if rule.name in (FULL, INSTRUMENT_PID) and math.isfinite(off):
        doubt = disturbance_of(
            errors_later(before, rule.output_range, moved, passed_s(rule.period_s, inputs.elapsed_s))
        )[1]
        variance = doubt + known.output.variance
        possible = weighed(possible, plays, off, doubt / variance, variance, film)
        errors = with_disturbance(errors, mean_of(possible, mean))
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
    """Return the reference a period after the command acts.

    targets: without the disturbance. doubt, noise: variances of the output's estimate and of a reading.
    """
    low, high = current_range(plate, plate_degC, rule.current_limit_A)
    cooling = max(rule.rate_share * rate(plate, plate_degC, low), -rule.fastest_K_per_s)
    heating = min(rule.rate_share * rate(plate, plate_degC, high), rule.fastest_K_per_s)
    slowest, fastest = min(cooling, -SLOWEST_K_PER_S), max(heating, SLOWEST_K_PER_S)
    reach = Reach(rule.spacing_s, rule.period_s, slowest, fastest, lag_s)
    if rule.name == TEMPERATURE:
        found = Planned(next_temperature(targets, now, reach), nan, 0.0, True)
    else:
        band = rule.reversal * math.sqrt(doubt) if rule.name != FEEDFORWARD else 0.0
        stays_degC = film.degC if rule.folds else now.film_degC  # another branch may lie between them where D folds
        if rule.name == FULL and not rule.folds:
            targets = targets - stop_short_by(targets, min(doubt, noise), film, toward, rule.period_s)
        found = next_reference(targets, Turn(band, toward, stays_degC), film, now, reach)
    film_degC = limited(found.reference.film_degC, rule.low_degC, rule.high_degC)
    own_degC = limited(found.reference.plate_degC, rule.low_degC, rule.high_degC)
    return Planned(Reference(film_degC, own_degC), found.output, found.move, found.reached)


@njit
def driven(
    rule: Rule, plate: Array, plate_degC: float, now_degC: float, next_degC: float, integral: float
) -> tuple[float, float]:
    """Return the current that takes the plate from its reference now to the next one, and the PID's integral.

    Without feedback it starts from the plate's temperature by the model.
    """
    feedback = rule.name in (FULL, TEMPERATURE)
    wanted = (next_degC - (now_degC if feedback else plate_degC)) / rule.period_s
    if feedback:
        wanted += pi_output(rule.gains, integral, now_degC, plate_degC)
    current = current_for_rate(plate, plate_degC, wanted, rule.current_limit_A)
    if feedback:
        shortfall = rate(plate, plate_degC, current) - wanted
        if abs(shortfall) < 1e-12:
            shortfall = 0.0
        integral = pi_integrated(rule.gains, integral, now_degC, plate_degC, shortfall, rule.period_s)
    return current, integral


@njit
def on_the_output(
    rule: Rule, plate: Array, here: float, integral: float, current: float, inputs: Inputs
) -> tuple[float, float]:
    """Return the current and the integral of the law "pid": the last current holds while there is no reading."""
    if not math.isfinite(inputs.output):
        return current, integral
    wanted = pi_output(rule.gains, integral, inputs.target_now, inputs.output)
    low, high = current_range(plate, here, rule.current_limit_A)
    current = limited(wanted, low, high)
    integral = pi_integrated(rule.gains, integral, inputs.target_now, inputs.output, current - wanted, rule.period_s)
    return current, integral


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
    """Do one period of a law whose plate and film have no effects.

    Returns the command's numbers, and the next state's numbers, play operators, possible memories, errors of the film
    model and heats. ruled: the numbers of `Rule`; numbers: of `Known`.
    """
    rule, s = unpacked(ruled, Rule), unpacked(numbers, Known)
    period, drift = rule.period_s, s.estimate.drift_K_per_s
    since_s = passed_s(period, inputs.elapsed_s)
    driven_K_per_s = drive_rate(plate, s.temperature_degC, s.current_A)
    plate = with_drive(plate, 1.0 + s.estimate.drive_error)
    here = plate_step(plate, s.temperature_degC, s.current_A, since_s) + drift * since_s
    predicted = Predicted(here, here, s.thermometer_degC, s.temperature_degC, driven_K_per_s)
    shown, here, known, heats = read_temperature(rule, s.estimate, heats, predicted, 0.0, inputs)
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
            possible, plays, errors = memories_after(
                rule, before, errors, known, possible, plays, off, s.moved, film, inputs
            )
            output = output_of(film, here, plays)
    disturbance, doubt = disturbance_of(errors)
    if rule.name == PID:
        current, integral = on_the_output(rule, plate, here, s.integral, s.current_A, inputs)
        after = Known(here, shown, s.left, s.reference, v, integral, current, s.toward, s.moved, nan, known)
        return (current, nan, nan, nan, True), packed(after, numbers.size), plays, possible, errors, heats
    there = FilmNow(v, plays, film, inverse)
    targets = inputs.targets - disturbance
    now = reference_at(period, inputs.elapsed_s, s.left, s.reference, Reference(here, here))
    plan = planned(rule, plate, here, 0.0, there, now, s.toward, doubt, known.output.variance, targets)
    now_degC, next_degC = now.film_degC, plan.reference.film_degC
    current, integral = driven(rule, plate, here, now_degC, next_degC, s.integral)
    toward = direction_after(s.toward, now, plan)
    after = Known(here, shown, now, plan.reference, v, integral, current, toward, plan.move, nan, known)
    answer = current, next_degC, now_degC, output, plan.reached
    return answer, packed(after, numbers.size), plays, possible, errors, heats

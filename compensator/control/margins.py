"""Margins of the whole law: estimator, resistance feedback through the inverse, temperature PID, delays, plate, film.

    L = -K P        K: the law linearized at an operating point, (dT, dy) -> du;  P: plate and film, u -> (dT, dy)

With one command there is one loop to break, and it is broken there: S = 1 / (1 + L) says what all of them together do
to an error of the plant, Ms = max |S|, the least distance of L from -1 is 1 / Ms (Astrom and Hagglund, Advanced PID
Control, ISA 2006, ch. 4). The film's slope over the model's runs over a range, as a real film's does on minor loops:
no inverse is right about it.

A law that sends setpoints to a controller's own PID is broken at the ohmmeter instead: at the setpoint the controller's
integral is inside the plant, so that an offset would count as an error.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any, Literal

import numpy as np

from compensator.control.estimator import (
    UNSTEADY_K_PER_S2,
    Estimate,
    Noise,
    Predicted,
    constant_error,
    corrected_temperature,
    initial_heats,
)
from compensator.control.law import Law, Observer
from compensator.control.law_step import INSTRUMENT_PID, Inputs, LawState
from compensator.control.pid import SPLINE, OwnPid
from compensator.hysteresis.functions import Array
from compensator.thermal.plate import PlateModel

# ---- law and plant, linear at an operating point -----------------------------------------------------
#
#     plant   x' = A x + B u,          (dT, dy) = C x
#     law     x' = A x + B (dT, dy),   du = C x + D (dT, dy)
#
# from one reading of the thermometer to the next. u: current (A), or the setpoint (degC) of a law that sends one; dT:
# thermometer (K); dy: the film's output, of a film as steep as the law's model. A command acts some time after the
# thermometer's reading, the ohmmeter is read some time before it.
#
# The law is `Law.step` differentiated numerically, both ways, by steps small beside a period's own move; x are the
# numbers of its state that a reading can reach and that can reach the command, so that a clock or a counter is no mode
# of it. What the estimator has learned of noise and of the model's error is held: it changes over hundreds of readings.
#
# Operating points: the law on its way through the film's range, both ways, and at rest. It is run there by its own
# model, without readings, until reference and current have settled; the estimator is set to a thermometer with a given
# noise, known for long, and to an ohmmeter that counts for as much as the law ever lets it (`LawSettings.most_share`),
# which is the largest gain of the resistance's feedback.
#
# ---- the plant --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Timing:
    """Moments within a period, s.

    output_age_s: the ohmmeter is read by so much before the thermometer; acts_after_s: a command acts by so much after
    it; the law knows both. late_s: further delay of a command, which the law does not know.
    """

    period_s: float
    output_age_s: float = 0.0
    acts_after_s: float = 0.0
    late_s: float = 0.0


@dataclass(frozen=True, eq=False)
class LinearPlant:
    """Linear plant x' = a x + b u, (dT, dy) = c x: shapes (n, n), (n, 1), (2, n)."""

    a: Array
    b: Array
    c: Array

    def response(self, z: Array) -> Array:
        """Return (dT, dy) over u at points z of the plane, shape (points, 2)."""
        n = self.a.shape[0]
        inside = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a, np.broadcast_to(self.b, (z.size, n, 1)))
        return np.asarray((self.c @ inside)[:, :, 0])

    def steeper(self, ratio: float) -> LinearPlant:
        """Return the plant with a film whose slope is `ratio` times as large."""
        return replace(self, c=self.c * np.array([[1.0], [ratio]]))

    def stronger(self, gain: float) -> LinearPlant:
        """Return the plant with the effect of every command multiplied by `gain`."""
        return replace(self, b=gain * self.b)

    def later(self, periods: int) -> LinearPlant:
        """Return the plant with commands that act whole periods later."""
        plant = self
        for _ in range(periods):
            n = plant.a.shape[0]
            a = np.block([[plant.a, plant.b], [np.zeros((1, n + 1))]])
            b = np.vstack([np.zeros((n, 1)), [[1.0]]])
            plant = LinearPlant(a, b, np.hstack([plant.c, np.zeros((2, 1))]))
        return plant


def course(pole_per_s: float, gain: float, span_s: float) -> tuple[float, float]:
    """Return (share of a temperature that remains, temperature per ampere) after a span with the current held."""
    if abs(pole_per_s * span_s) < 1e-9:
        return 1.0, gain * span_s
    left = math.exp(-pole_per_s * span_s)
    return left, gain * (1.0 - left) / pole_per_s


def plate_plant(plate: PlateModel, degC: float, current_A: float, slope: float, timing: Timing) -> LinearPlant:
    """Return the plant of a plate and a film without effects, from currents. slope: of the film's output, per K."""
    gain, pole = plate.linearized(degC, current_A)
    h = timing.period_s
    delay_s = timing.acts_after_s + timing.late_s
    whole, into_s = divmod(delay_s, h)

    def after(span_s: float) -> tuple[float, float, float]:
        """Return the factors of temperature, of the current before and of the one that begins within the period."""
        if span_s <= into_s:
            return (*course(pole, gain, span_s), 0.0)
        left, made = course(pole, gain, span_s - into_s)
        first_left, first_made = course(pole, gain, into_s)
        return left * first_left, left * first_made, made

    then, before = after(h), after(h - timing.output_age_s)
    a = np.array([[then[0], 0.0, then[1]], [before[0], 0.0, before[1]], [0.0, 0.0, 0.0]])
    b = np.array([[then[2]], [before[2]], [1.0]])
    c = np.array([[1.0, 0.0, 0.0], [0.0, slope, 0.0]])
    return LinearPlant(a, b, c).later(int(whole))


def observed_plant(observer: Observer, state: Any, timing: Timing) -> LinearPlant:
    """Return the plant of a chain with effects, as the law's observer knows it, linear at this state of it."""
    current_A = float(state.acting_A)

    def step(values: Array, off: Array) -> Array:
        now = observer.predicted(observer.sent(with_numbers(state, values), current_A + float(off[0])))
        end = observer.followed(now, now.plate_degC, now.thermometer_degC)
        return np.array([*numbers(end), end.thermometer_degC, end.shown_output])

    a, b, shown_a, shown_b = differentiated(step, np.array(list(numbers(state))), 1)
    n = a.shape[0]
    # the readings are of the period's end: they are states of their own
    a = np.block([[a, np.zeros((n, 2))], [shown_a, np.zeros((2, 2))]])
    plant = LinearPlant(a, np.vstack([b, shown_b]), np.hstack([np.zeros((2, n)), np.eye(2)]))
    return plant.later(round((timing.acts_after_s + timing.late_s) / timing.period_s))


def regulated_plant(
    plate: PlateModel, degC: float, current_A: float, slope: float, own: OwnPid, timing: Timing
) -> LinearPlant:
    """Return the plant of a plate under its controller's own PID, which takes setpoints.

    The controller reads its thermometer every `own.tick_s`, in step with the readings.
    """
    gain, pole = plate.linearized(degC, current_A)
    ticks = max(1, round(timing.period_s / own.tick_s))
    span_s = timing.period_s / ticks
    left, made = course(pole, gain, span_s)
    acts = min(round((timing.acts_after_s + timing.late_s) / span_s), ticks)
    aged = min(max(round((timing.period_s - timing.output_age_s) / span_s), 0), ticks)
    degrees, integral, slower, last, sent, seen = range(6)

    def one(x: Array, u: float) -> Array:
        """Return the state after a period, from the state and the setpoint that comes in it."""
        y = x.copy()
        for k in range(ticks):
            setpoint = u if k >= acts else x[sent]
            slope_K_per_s = (y[degrees] - y[last]) / span_s
            y[slower] += (1.0 - own.damping) * (slope_K_per_s - y[slower])
            y[last] = y[degrees]
            error = setpoint - y[degrees]
            if own.ti_s > 0.0:
                y[integral] += own.kp_A_per_K * error * span_s / own.ti_s
            amount = own.kp_A_per_K * (error - own.td_s * y[slower]) + y[integral]
            y[degrees] = left * y[degrees] + made * amount
            if k + 1 == aged:
                y[seen] = y[degrees]
        y[sent] = u
        return y

    a = np.array([one(each, 0.0) for each in np.eye(6)]).T
    b = one(np.zeros(6), 1.0)[:, None]
    c = np.zeros((2, 6))
    c[0, degrees], c[1, seen] = 1.0, slope
    return LinearPlant(a, b, c)


# ---- the law ----------------------------------------------------------------------------------------


SMALL: float = 1e-6  # K and decades: a period moves the film by a thousand times as much, its inverse errs by 1e-12


@dataclass(frozen=True, eq=False)
class LinearLaw:
    """Linear law x' = a x + b (dT, dy), du = c x + d (dT, dy): shapes (n, n), (n, 2), (1, n), (1, 2)."""

    a: Array
    b: Array
    c: Array
    d: Array

    def response(self, z: Array) -> Array:
        """Return du over (dT, dy) at points z of the plane, shape (points, 2)."""
        n = self.a.shape[0]
        inside = np.linalg.solve(z[:, None, None] * np.eye(n) - self.a, np.broadcast_to(self.b, (z.size, n, 2)))
        return np.asarray((self.c @ inside + self.d)[:, 0, :])


def linearized(law: Law, state: LawState, inputs: Inputs) -> LinearLaw:
    """Return the law linear at this state and these inputs. Raises ValueError as `differentiated` does."""

    def step(values: Array, off: Array) -> Array:
        reading = inputs._replace(
            temperature_degC=inputs.temperature_degC + float(off[0]), output=inputs.output + float(off[1])
        )
        command, end = law.step(with_numbers(state, values), reading)
        sent = command.setpoint_degC if law.rule.name == INSTRUMENT_PID else command.current_A
        return np.array([*numbers(end), sent])

    return LinearLaw(*differentiated(step, np.array(list(numbers(state))), 2))


def differentiated(
    step: Callable[[Array, Array], Array], before: Array, inputs: int
) -> tuple[Array, Array, Array, Array]:
    """Return (a, b, c, d) of a step from a state's numbers and its inputs' changes to the next numbers and outputs.

    Only numbers that an input can reach are changed: to change a time would make a command come due. Raises ValueError
    if a step changes what the state is made of.
    """
    count, still = before.size, np.zeros(inputs)
    outputs = step(before, still).size - count
    if outputs < 1:
        raise ValueError("the law's state has other parts after a step than before it")
    a, b = np.zeros((count + outputs, count)), np.empty((count + outputs, inputs))
    for k in range(inputs):
        off = np.zeros(inputs)
        off[k] = SMALL
        b[:, k] = (step(before, off) - step(before, -off)) / (2.0 * SMALL)
    b = np.nan_to_num(b)  # a number that is none yet (nan) carries nothing
    known = np.zeros(count, dtype=bool)
    moved = np.any(b[:count] != 0.0, axis=1)
    while np.any(moved & ~known):
        for n in np.flatnonzero(moved & ~known):
            off = np.zeros(count)
            off[n] = SMALL
            a[:, n] = np.nan_to_num((step(before + off, still) - step(before - off, still)) / (2.0 * SMALL))
            known[n] = True
        moved = known | np.any(a[:count] != 0.0, axis=1)
    kept = known & reached(a[:count].T, a[count:].T)
    return a[:count][np.ix_(kept, kept)], b[:count][kept], a[count:][:, kept], b[count:]


def reached(a: Array, b: Array) -> Any:
    """Return which states an input can reach, shape (n,), by which elements are not 0."""
    found = np.any(b != 0.0, axis=1)
    while True:
        more = found | np.any(a[:, found] != 0.0, axis=1)
        if np.array_equal(more, found):
            return found
        found = more


def numbers(value: Any) -> Iterator[float]:
    """Yield the numbers of a state: of its named tuples, dataclasses, tuples and arrays."""
    if isinstance(value, Estimate):
        yield value.drift_K_per_s
    elif isinstance(value, np.ndarray):
        yield from (float(each) for each in value.ravel())
    elif isinstance(value, tuple):
        for part in value:
            yield from numbers(part)
    elif is_dataclass(value) and not isinstance(value, type):
        for each in fields(value):
            yield from numbers(getattr(value, each.name))
    elif isinstance(value, float):
        yield value


def with_numbers(value: Any, values: Array) -> Any:
    """Return the same state with other numbers, in the order of `numbers`."""
    return _rebuilt(value, iter(values))


def _rebuilt(value: Any, values: Iterator[Any]) -> Any:
    if isinstance(value, Estimate):
        return value._replace(drift_K_per_s=float(next(values)))
    if isinstance(value, np.ndarray):
        made = np.array([next(values) for _ in range(value.size)], dtype=np.float64).reshape(value.shape)
        made.setflags(write=value.flags.writeable)
        return made
    if isinstance(value, tuple):
        parts = [_rebuilt(part, values) for part in value]
        return type(value)(*parts) if hasattr(value, "_fields") else tuple(parts)
    if is_dataclass(value) and not isinstance(value, type):
        names = [each.name for each in fields(value)]
        return replace(value, **{name: _rebuilt(getattr(value, name), values) for name in names})
    return float(next(values)) if isinstance(value, float) else value


# ---- operating points -------------------------------------------------------------------------------


Way = Literal["heating", "cooling", "at rest"]
DEC_PER_S = 0.01  # of a usual ramp; the margins hardly depend on it, as long as the plate can follow
LEVELS = (0.1, 0.5, 0.9)  # of the film's range of output
QUIET = 1e-16, 1e-8  # variance of an ohmmeter, and of the disturbance, by which a reading counts in full
REST = 1e-4  # of output: less than `LawSettings.reversal` deviations of QUIET, for which no film turns round
SETTLED = 400  # readings after which the thermometer's estimator is


@dataclass(frozen=True, eq=False)
class Point:
    """Operating point: a law and its plant, linear there.

    slope: of the model's film, per K. noise_K: of the thermometer, as the law knows it. setpoints: True if the law
    sends setpoints to a controller's own PID.
    """

    way: Way
    degC: float
    slope: float
    law: LinearLaw
    plant: LinearPlant
    period_s: float
    noise_K: float
    setpoints: bool = False


def operating_points(
    law: Law, timing: Timing, noise_K: float, own: OwnPid | None = None, levels: Sequence[float] = LEVELS
) -> list[Point]:
    """Return the law in the midst of both branches of the film's major loop, and at rest in its middle.

    noise_K: of the thermometer, one standard deviation. own: PID of a controller that the law sends setpoints to.
    Raises ValueError if the film does not move at all between the law's limits.
    """
    points = [
        _point(law, timing, noise_K, own, way, degC) for way in (1, -1) for degC in temperatures(law, way, levels)
    ]
    middle = temperatures(law, 1, (0.5,))[0]
    return [*points, _point(law, timing, noise_K, own, 0, middle)]


def temperatures(law: Law, way: int, levels: Sequence[float]) -> list[float]:
    """Return where the film has gone through these shares of its range, on its way up or down (degC)."""
    film, s = law.film, law.settings
    assert film is not None
    grid = np.linspace(s.low_degC, s.high_degC, 801)[::way]
    outputs, _ = film.simulate(grid, film.initial_memory(float(grid[0]), "heated" if way > 0 else "cooled"))
    gone = np.abs(outputs - outputs[0])
    if not gone[-1] > 0.0:
        raise ValueError(f"the film's output is the same from {s.low_degC:g} to {s.high_degC:g} degC")
    return [float(grid[int(np.argmax(gone >= level * gone[-1]))]) for level in levels]


def believed(law: Law, noise_K: float, state: LawState) -> LawState:
    """Return the state with an estimator that has settled, and that takes the ohmmeter at its word.

    The thermometer's noise is known for long; of the model's error one size is left, the drive is known, and a reading
    counts in full.
    """
    lag_s = law.observer.thermometer_lag_s if law.observer is not None else 0.0
    known, heats = state.estimate._replace(degC=Noise(noise_K**2)), initial_heats(UNSTEADY_K_PER_S2[-1:], (0.0,), 0.0)
    there = Predicted(0.0, 0.0, 0.0, 0.0)
    for _ in range(SETTLED):
        heats = corrected_temperature(known, heats, there, 0.0, law.settings.period_s, 0.0, lag_s)[-1]
        heats.setflags(write=False)  # as the law hands it over: compiled for one type
    output = state.estimate.output._replace(variance=QUIET[0])
    return state._replace(
        estimate=known._replace(output=output), errors=constant_error(state.disturbance, QUIET[1]), heats=heats
    )


def _point(law: Law, timing: Timing, noise_K: float, own: OwnPid | None, way: int, degC: float) -> Point:
    film, h = law.film, timing.period_s
    assert film is not None
    low, high = law.settings.low_degC, law.settings.high_degC
    memory = film.initial_memory(low, "heated") if way >= 0 else film.initial_memory(high, "cooled")
    output, memory = film.step(degC, memory)
    rise = float(np.sign(film.step(degC + (1e-3 if way >= 0 else -1e-3), memory)[0] - output)) or 1.0
    speed = rise * DEC_PER_S * abs(way)
    held_A = law.plate.current_for_rate_A(degC, 0.0, law.settings.current_limit_A)
    state = law.start(degC, memory, held_A)
    if law.observer is not None:
        state = state._replace(observer=_held(law.observer, state.observer, degC, held_A, h))
    state = believed(law, noise_K, state)
    settled, heats = state.estimate, state.heats
    lag_s = law.observer.film_lag_s + law.observer.delay_s if law.observer is not None else 0.0
    steps, ahead = max(20, math.ceil(5.0 * lag_s / h)), law.preview_times_s()
    aged = timing.output_age_s, timing.acts_after_s
    for k in range(steps):
        wanted = output + speed * (k * h + aged[1] + ahead)
        degC_read = _unread(law, state)
        _, state = law.step(state, Inputs(degC_read, math.nan, output + speed * k * h, wanted, *aged))
        state = state._replace(estimate=settled, errors=constant_error(state.disturbance, QUIET[1]), heats=heats)
    inputs = _read(law, state, steps * h, output, speed, aged)
    linear = linearized(law, state, inputs)
    slope = _slope(law, state, way)
    here, current_A = state.temperature_degC, state.current_A
    if own is not None:
        plant = regulated_plant(law.plate, here, current_A, slope, own, timing)
    elif law.observer is not None:
        plant = observed_plant(law.observer, state.observer, timing)
    else:
        plant = plate_plant(law.plate, here, current_A, slope, timing)
    name: Way = "heating" if way > 0 else "cooling" if way < 0 else "at rest"
    return Point(name, here, slope, linear, plant, h, noise_K, own is not None)


def _held(observer: Observer, state: Any, degC: float, current_A: float, period_s: float) -> Any:
    """Return the observer's state after the plate has been at a temperature for long, by this current."""
    for _ in range(1 + math.ceil(observer.delay_s / period_s + 5.0 * observer.thermometer_lag_s / period_s)):
        state = observer.followed(observer.predicted(observer.sent(state, current_A)), degC, degC)
    return state


def _unread(law: Law, state: LawState) -> float:
    """Return the temperature reading of a law without a thermometer: nan, or a controller's reference."""
    own = law.settings.name == "instrument_pid" or not law.settings.trusts_model
    return state.reference_degC if own else math.nan


def _read(law: Law, state: LawState, now_s: float, output: float, speed: float, aged: tuple[float, float]) -> Inputs:
    """Return the readings that the law expects, and the targets.

    At rest the wanted output lies on the far side of the film's last move, where the law lets it stand.
    """
    ahead = law.preview_times_s()
    wanted = output + speed * (now_s + aged[1] + ahead)
    blind = Inputs(_unread(law, state), math.nan, output + speed * now_s, wanted, *aged)
    command, after = law.step(state, blind)
    moving = (after.temperature_degC - state.temperature_degC) / law.settings.period_s
    shown = after.observer.thermometer_degC if after.observer is not None else after.temperature_degC
    read = after.observer.shown_output if after.observer is not None else command.output_model
    if speed == 0.0:
        wanted = np.full(ahead.size, command.output_model - 0.5 * state.toward * REST)
    return blind._replace(
        temperature_degC=shown - moving * aged[1],
        output=read + state.disturbance - state.moved / law.settings.period_s * (aged[0] + aged[1]),
        targets=wanted,
    )


def _slope(law: Law, state: LawState, way: int) -> float:
    """Return the slope of the film's output (per K) on its way."""
    assert law.film is not None
    memory = state.memory
    small = 1e-4 if way >= 0 else -1e-4
    outputs = [law.film.step(memory.input_degC + small * k, memory)[0] for k in (0.0, 1.0)]
    return float((outputs[1] - outputs[0]) / small)


RATIOS = (0.6, 0.8, 1.0, 1.2, 1.5, 1.8, 2.2)  # the film's slope over the model's
FAR = 1.5  # ratio beyond which a larger sensitivity is borne
ASKED_MS, ASKED_FAR_MS = 1.6, 2.0  # 2.0: the loop's gain may still be twice as large as it is
NOISES_K = (0.01, 0.001)  # of a usual thermometer and of the best: the estimator's gains follow from it


@dataclass(frozen=True)
class LoopMargins:
    """Margins at one operating point and one ratio of slopes.

    stable: of the closed loop. gain_margin, phase_margin_deg: at the crossings of phase and |L|. ms, at_thermometer,
    at_ohmmeter: largest sensitivities where the law is judged and at each reading (nan if the law sends setpoints: that
    loop is the controller's). disk_margin, disk_gain, disk_phase_deg: gain factor and phase that may change together.
    """

    stable: bool
    gain_margin: float
    phase_margin_deg: float
    ms: float
    at_thermometer: float
    at_ohmmeter: float
    disk_margin: float
    disk_gain: float
    disk_phase_deg: float
    crossover_rad_per_s: float


def frequencies(period_s: float, count: int = 1200) -> Array:
    """Return frequencies up to Nyquist's, rad/s."""
    return np.logspace(-3.0, math.log10(0.9999 * math.pi / period_s), count)


def loops(point: Point, ratio: float, omega: Array) -> tuple[Array, Array]:
    """Return the parts of L (through the thermometer, through the ohmmeter), shape (frequencies,) each."""
    z = np.exp(1j * omega * point.period_s)
    parts = -point.law.response(z) * point.plant.steeper(ratio).response(z)
    return parts[:, 0], parts[:, 1]


def judged(point: Point, ratio: float, omega: Array) -> Array:
    """Return L where the law is judged."""
    by_degC, by_output = loops(point, ratio, omega)
    return np.asarray(by_output / (1.0 + by_degC) if point.setpoints else by_degC + by_output)


def open_loop(point: Point, ratio: float) -> tuple[Array, Array, Array, Array]:
    """Return L as matrices of a state space: plant, then law."""
    plant, k = point.plant.steeper(ratio), point.law
    if point.setpoints:
        degC, output = plant.c[:1], plant.c[1:]
        a = np.block([[plant.a + plant.b @ k.d[:, :1] @ degC, plant.b @ k.c], [k.b[:, :1] @ degC, k.a]])
        b = np.vstack([plant.b @ k.d[:, 1:], k.b[:, 1:]])
        return a, b, -np.hstack([output, np.zeros((1, k.a.shape[0]))]), np.zeros((1, 1))
    a = np.block([[plant.a, np.zeros((plant.a.shape[0], k.a.shape[0]))], [k.b @ plant.c, k.a]])
    b = np.vstack([plant.b, np.zeros((k.a.shape[0], 1))])
    return a, b, -np.hstack([k.d @ plant.c, k.c]), np.zeros((1, 1))


def slowest_root(point: Point, plant: LinearPlant) -> float:
    """Return the largest magnitude of the closed loop's roots: below 1 it is stable."""
    a, b, c, _ = open_loop(replace(point, plant=plant), 1.0)
    whole = a - b @ c
    return float(np.max(np.abs(np.linalg.eigvals(whole))))


def loop_margins_at(point: Point, ratio: float) -> LoopMargins:
    """Return the margins at a point, the film steeper than the model by a ratio."""
    import control

    omega = frequencies(point.period_s)
    by_degC, by_output = loops(point, ratio, omega)
    loop = judged(point, ratio, omega)
    if slowest_root(point, point.plant.steeper(ratio)) >= 1.0 - 1e-9:
        return LoopMargins(False, 0.0, 0.0, math.inf, math.inf, math.inf, 0.0, 1.0, 0.0, math.nan)
    response = control.frd(loop[::SPLINE], omega[::SPLINE], smooth=True)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        gain, phase, _, crossover = control.margin(response)
        disk = control.disk_margins(control.ss(*open_loop(point, ratio), point.period_s), omega[::12])
    return LoopMargins(
        True,
        float(gain),
        float(phase),
        _largest(loop),
        math.nan if point.setpoints else _largest(by_degC / (1.0 + by_output)),
        _largest(by_output / (1.0 + by_degC)),
        float(disk[0]),
        float(10.0 ** (float(disk[1]) / 20.0)),
        float(disk[2]),
        float(crossover),
    )


def least(margins: Sequence[LoopMargins]) -> LoopMargins:
    """Return the worst of each margin, with the crossover of the largest Ms."""
    worst = max(margins, key=lambda m: m.ms)
    return LoopMargins(
        all(m.stable for m in margins),
        min(m.gain_margin for m in margins),
        min(m.phase_margin_deg for m in margins),
        worst.ms,
        max(m.at_thermometer for m in margins),
        max(m.at_ohmmeter for m in margins),
        min(m.disk_margin for m in margins),
        min(m.disk_gain for m in margins),
        min(m.disk_phase_deg for m in margins),
        worst.crossover_rad_per_s,
    )


def _largest(loop: Array) -> float:
    return float(np.max(1.0 / np.abs(1.0 + loop)))


def largest_stable(holds: Callable[[float], bool], most: float) -> float:
    """Return the largest number up to `most` below which it holds, to a thousandth; inf if it holds at `most`."""
    if holds(most):
        return math.inf
    low, high = 1e-3, most
    while high / low > 1.001:
        middle = math.sqrt(low * high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low


def critical_ratio(point: Point, most: float = 100.0) -> float:
    """Return the film's slope over the model's from which the loop oscillates by itself; inf: none up to `most`."""
    return largest_stable(lambda ratio: slowest_root(point, point.plant.steeper(ratio)) < 1.0, most)


def critical_gain(point: Point, ratio: float = 1.0, most: float = 100.0) -> float:
    """Return the plate's response over the model's from which the loop oscillates by itself."""
    plant = point.plant.steeper(ratio)
    return largest_stable(lambda gain: slowest_root(point, plant.stronger(gain)) < 1.0, most)


def bearable_ms(ratio: float) -> float:
    """Return the largest Ms that is allowed at a ratio of slopes."""
    return ASKED_MS if ratio <= FAR else ASKED_FAR_MS


def worst_ms(points: Sequence[Point], ratio: float, count: int = 300) -> float:
    """Return the largest Ms of the points at a ratio; inf if one is not stable."""
    if any(slowest_root(point, point.plant.steeper(ratio)) >= 1.0 - 1e-9 for point in points):
        return math.inf
    omega = frequencies(points[0].period_s, count)
    return max(_largest(judged(point, ratio, omega)) for point in points)


def share_within(law: Law, timing: Timing, own: OwnPid | None = None) -> float:
    """Return the largest `LawSettings.most_share` for which Ms is within its bound at every ratio of slopes.

    The law is taken without its observer: effects make it later, not steeper, and its own delays are in `timing`.
    """

    def holds(share: float) -> bool:
        tried = Law(replace(law.settings, most_share=share), law.plate, law.film)
        for noise_K in NOISES_K if own is None else NOISES_K[:1]:  # a law of setpoints takes the reading as it is
            points = operating_points(tried, timing, noise_K, own, LEVELS[::2] if own is None else LEVELS)
            points = [point for point in points if point.way != "at rest"]  # the resistance is not fed back there
            if any(worst_ms(points, ratio) > bearable_ms(ratio) for ratio in (RATIOS[0], FAR, RATIOS[-1])):
                return False
        return True

    if holds(1.0):
        return 1.0
    low, high = 0.0, 1.0
    while high - low > 0.01:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if holds(middle) else (low, middle)
    return low

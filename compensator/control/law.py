"""The control law as one step: readings and coming targets in, a current out, state in and state out.

    target -> minus the estimated output disturbance -> inverse, from the present memory, with preview
           -> reference of film and plate, shaped to what the plate can do
           -> heating rate: the plate reference's own rate + PID on the temperature
           -> current, through the plate's inverse

The film's memory is driven by the temperature of a state observer (plate model corrected by the reading), never by
the noisy reading itself, which would ratchet the play operators. What the model gets wrong of the resistance is
estimated as a disturbance on the output and taken off the target: feedback of the resistance through the inverse. Both
estimates weigh readings by their noise: `compensator.control.estimator`. A step stands for the moment at which its
command acts; the thermometer was read some time before, the ohmmeter before that.

Without an observer the law predicts plate and film by their models alone, and its step is one compiled loop
(`compensator.control.law_step`). A chain with effects (a lag, a delay, a sink that warms up) is predicted by the
observer that the law is given, and the same parts are called one after the other (`compensator.control.law`).

    law                 film inverse   plate inverse   feedback of T   feedback of R
    "full"              yes            yes             PID             disturbance estimate
    "feedforward"       yes            yes             none            none
    "pid"               no             no              none            PID on the output, in A
    "instrument_pid"    yes            no              the controller  disturbance estimate
    "temperature"       no             yes             PID             none          (wanted temperature, not output)
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Protocol

import numpy as np

from compensator.control.estimator import (
    NO_ERRORS,
    Estimate,
    Predicted,
    disturbance_of,
    initial_errors,
    mean_of,
    possible_memories,
    taken_along,
    with_disturbance,
)
from compensator.control.law_step import (
    NAMES,
    TEMPERATURE,
    Command,
    Inputs,
    LawName,
    LawState,
    Rule,
    driven,
    flattener,
    law_step,
    memories_after,
    passed_s,
    planned,
    read_output,
    read_temperature,
    rebuilder,
    reference_at,
)
from compensator.control.pid import PidGains
from compensator.control.reference_shaping import FilmNow, Reference, direction_after
from compensator.hysteresis.film import IDENTITY, FilmModel, Memory, Packed
from compensator.hysteresis.functions import Array
from compensator.inverse.inverse import Inverse
from compensator.inverse.search import Settings
from compensator.thermal.plate import PlateModel, with_drive
from compensator.thermal.plate import step as plate_step

# ---- the law on a chain with effects: the parts of `law_step`, plate and film predicted by an observer -----
#
#     predicted   driver, plate and thermometer over a period, with the unknown heating that the law has learned
#     corrected   by the law's own estimator: thermometer, plate and unknown heating, from the thermometer's reading
#     followed    film and ohmmeter over the corrected course; the ohmmeter's reading corrects the disturbance
#     ahead       plate and film when the command acts (after a driver's delay): the reference is planned from there
#     warming     of the film at its next output, by test current and drift: the plate goes to where it, with this and
#                 through the film's lag, brings the film to its reference; the rate of warming is the difference of two
#
# The target is what the ohmmeter shall show, so that its lag is made up for too.


class Observer(Protocol):
    """Prediction of a chain with effects, a period at a time; each method is a function of its arguments alone.

    Times in s: thermometer_lag_s, film_lag_s: of first-order lags; lead_s: lag of the ohmmeter; delay_s: of the driver.
    A state is never changed; it has plate_degC, film_degC (without a film the same), thermometer_degC (without noise),
    output (of the film itself) and shown_output (at the ohmmeter; nan without a film), warming_K (of the film above
    what its lag makes of the plate), driven_K_per_s (heating by the model's drive over the last period) and film_memory
    (None without a film). `sim.model.observer.Observer` is one.
    """

    thermometer_lag_s: float
    film_lag_s: float
    lead_s: float
    delay_s: float

    def start(self, plate_degC: float, memory: Memory | None = None, test_current_A: float = 0.0) -> Any:
        """Return the state of a chain at rest."""
        ...

    def sent(self, state: Any, current_A: float) -> Any:
        """Return the state with a current commanded at its time."""
        ...

    def predicted(
        self, state: Any, unknown_K_per_s: float = 0.0, elapsed_s: float = math.nan, drive_error: float = 0.0
    ) -> Any:
        """Return the state a period (or elapsed_s) later in driver, plate and thermometer.

        unknown_K_per_s: heating that is not in the model. drive_error: share by which the drive exceeds the model's.
        """
        ...

    def followed(self, state: Any, plate_degC: float, thermometer_degC: float, test_current_A: float = 0.0) -> Any:
        """Return the state with plate and thermometer corrected, then film and ohmmeter over the same period."""
        ...

    def remembering(self, state: Any, memory: Memory) -> Any:
        """Return the state of a film with this memory, at its own temperature."""
        ...

    def ahead(
        self, state: Any, test_current_A: float = 0.0, unknown_K_per_s: float = 0.0, drive_error: float = 0.0
    ) -> Any:
        """Return the state at which a command of now acts."""
        ...

    def plate_now(self, state: Any) -> PlateModel:
        """Return a plate without effects that heats and cools as this one does now."""
        ...

    def own(self, output: Array | float) -> Array:
        """Return the film's own output for what the ohmmeter shows of it, lags left aside."""
        ...

    def warming_K(self, state: Any, output: float, test_current_A: float = 0.0, later_s: float = 0.0) -> float:
        """Return the warming of the film if its own output were this, later_s after the state's time."""
        ...


def observed_step(
    rule: Rule, film: Packed, inverse: Settings, observer: Observer, state: LawState, inputs: Inputs
) -> tuple[Command, LawState]:
    """Return the command and the state after one period of a law with an observer: see the module."""
    seen, estimate, errors, heats, possible = observed(rule, film, observer, state, inputs)
    test = inputs.test_current_A
    there = observer.ahead(seen, test, estimate.drift_K_per_s, estimate.drive_error)
    plate = with_drive(observer.plate_now(there).numbers, 1.0 + estimate.drive_error)
    memory = there.film_memory
    if memory is None:
        memory = Memory(there.film_degC, np.zeros(1))
    there_now = FilmNow(there.film_degC, memory.plays.copy(), film, inverse)
    wanted = inputs.targets if rule.name == TEMPERATURE else observer.own(inputs.targets)
    here = Reference(there.film_degC, there.plate_degC + there.warming_K)
    left, reference = Reference(*state.left), Reference(*state.reference)
    before = reference_at(rule.period_s, inputs.elapsed_s, left, reference, here)
    lag_s, (disturbance, doubt) = observer.film_lag_s, disturbance_of(errors)
    targets, noise = wanted - disturbance, estimate.output.variance
    plan = planned(rule, plate, there.plate_degC, lag_s, there_now, before, state.toward, doubt, noise, targets)
    next_output = there.output if math.isnan(plan.output) else plan.output + disturbance
    warming_K = observer.warming_K(there, next_output, test, rule.period_s) if math.isfinite(next_output) else 0.0
    now_K = warming_K if math.isnan(state.warming_K) else state.warming_K
    now_degC, next_degC = before.plate_degC - now_K, plan.reference.plate_degC - warming_K
    current, integral = driven(rule, plate, there.plate_degC, now_degC, next_degC, state.integral)
    command = Command(current, plan.reference.film_degC, before.film_degC, seen.output, plan.reached)
    return command, LawState(
        seen.plate_degC,
        seen.thermometer_degC,
        before,
        Reference(*plan.reference),
        memory.input_degC,
        memory.plays,
        integral,
        current,
        direction_after(state.toward, before, plan),
        plan.move,
        warming_K,
        estimate,
        possible,
        errors,
        heats,
        seen,
    )


def observed(
    rule: Rule, film: Packed, observer: Observer, state: LawState, inputs: Inputs
) -> tuple[Any, Estimate, Array, Array, Array]:
    """Return the observer's state after both readings, estimate, errors of the film model, unknown heats, memories."""
    before, possible, known = observer.sent(state.observer, state.current_A), state.possible, state.estimate
    now = observer.predicted(before, known.drift_K_per_s, inputs.elapsed_s, known.drive_error)
    predicted = Predicted(
        now.thermometer_degC, now.plate_degC, before.thermometer_degC, before.plate_degC, now.driven_K_per_s
    )
    lag_s = observer.thermometer_lag_s
    shown, plate, estimate, heats = read_temperature(rule, known, state.heats, predicted, lag_s, inputs)
    heats.setflags(write=False)
    now = observer.followed(now, plate, shown, inputs.test_current_A)
    if possible.size > 0:
        possible = possible.copy()
        taken_along(possible, now.film_degC, before.film_degC, film)
    if not rule.has_film:
        return now, estimate, state.errors, heats, possible
    expected, last = (float(observer.own(each.shown_output)) for each in (now, before))
    output = float(observer.own(inputs.output))
    passed = (expected - last) / passed_s(rule.period_s, inputs.elapsed_s) * (inputs.output_age_s + inputs.acts_after_s)
    off = output + (passed if math.isfinite(passed) else 0.0) - expected
    known, errors = read_output(rule, estimate, state.errors.copy(), off, state.moved, inputs)
    if possible.size > 0:
        plays = np.array(now.film_memory.plays)
        possible, plays, errors = memories_after(
            rule, state.errors.copy(), errors, known, possible, plays, off, state.moved, film, inputs
        )
        now = observer.remembering(now, Memory(now.film_degC, plays))
    possible.setflags(write=False)
    errors.setflags(write=False)
    return now, known, errors, heats, possible


NUMBERS, STATE = flattener(LawState), rebuilder(LawState)
GRID: Final = 101  # temperatures on which a film's range is looked at
FOLD: Final = 0.01  # of the output's range that it turns back by: less is the slope of a film beyond its transition
TINY: Final = 1e-9  # of an output: a film that does not move at all has sizes of error too
LEAVES_EARLIER: Final = 2.0  # lags of the film by which the preview is longer: to speed up, and to brake


@dataclass(frozen=True)
class LawSettings:
    """Settings of a law.

    name, period_s, current_limit_A, gains: of the loop. low_degC, high_degC: limits of the temperature. preview: number
    of coming targets that a step takes, preview_spacing_s apart, the first one period ahead. reversal: standard
    deviations of the estimate by which the output has to differ before it turns round; it goes on its way for any
    difference (without that, noise in a dwell would change the current by up to thirty times as much). trusts_model:
    True if the plate model predicts the temperature (else only the reading is used). rate_share: share of the plate's
    fastest rates that the reference may use, fastest_K_per_s: its fastest rate.
    most_share: largest share of an innovation of the ohmmeter by which one reading may change the disturbance
    (`compensator.control.margins.share_within`). heading: of several temperatures for an output the nearest is taken
    (0), or the next one up (1) or down (-1), if there is one.
    """

    name: LawName
    period_s: float
    current_limit_A: float
    low_degC: float
    high_degC: float
    gains: PidGains
    preview: int = 8
    preview_spacing_s: float = 0.3
    reversal: float = 3.0
    trusts_model: bool = True
    rate_share: float = 0.9
    fastest_K_per_s: float = math.inf
    most_share: float = 1.0
    heading: int = 0


class Law:
    """Law bound to a film and a plate model; it keeps no state itself: see `LawState`.

    observer: prediction of a chain with effects (`compensator.control.law.Observer`); None if there are none.
    Raises ValueError for a law of the output without a film.
    """

    def __init__(
        self, settings: LawSettings, plate: PlateModel, film: FilmModel | None, observer: Observer | None = None
    ) -> None:
        if film is None and settings.name not in ("temperature",):
            raise ValueError(f"law {settings.name!r}: needs a film model")
        self.settings = settings
        self.plate = plate
        self.film = film
        self.observer = observer
        s = settings
        stand_in = FilmModel(np.zeros(1), np.zeros(1), IDENTITY, IDENTITY)  # the same types for every law
        inverse = Inverse(film if film is not None else stand_in, s.low_degC, s.high_degC)
        self.rule = Rule(
            float(NAMES.index(s.name)),
            s.period_s,
            s.current_limit_A,
            s.low_degC,
            s.high_degC,
            s.preview_spacing_s,
            s.reversal,
            float(s.trusts_model),
            s.rate_share,
            s.fastest_K_per_s,
            s.most_share,
            float(film is not None),
            *self._output_range(),
            s.gains,
        )
        self.ruled = np.array(flattener(Rule)(self.rule))
        self.packed_film, self.inverse = inverse.model.packed, inverse.settings(s.heading)

    def _output_range(self) -> tuple[float, float]:
        """Return the film's range within the law's limits, in the output's unit, and 1 if the output turns back on that
        way.

        The second is else 0; (1, 0) without a film.
        """
        if self.film is None:
            return 1.0, 0.0
        grid = np.linspace(self.settings.low_degC, self.settings.high_degC, GRID)
        outputs, _ = self.film.simulate(grid, self.film.initial_memory(self.settings.low_degC, "heated"))
        whole, steps = float(np.ptp(outputs)), np.diff(outputs)
        back = min(float(np.sum(np.maximum(steps, 0.0))), float(np.sum(np.maximum(-steps, 0.0))))
        return max(whole, TINY), float(back > FOLD * whole)

    def start(
        self, temperature_degC: float, memory: Memory | None, current_A: float = 0.0, test_current_A: float = 0.0
    ) -> LawState:
        """Return the state at the first reading; memory None: the film's default there. test_current_A: of the
        ohmmeter."""
        observer, t = None, temperature_degC
        now = Reference(t, t)
        if memory is None and self.film is not None:
            memory = self.film.initial_memory(t)
        if self.observer is not None:
            observer = self.observer.start(t, memory, test_current_A)
            now = Reference(observer.film_degC, observer.plate_degC + observer.warming_K)
        memory = memory if memory is not None else Memory(t, np.zeros(1))
        integral = current_A if self.settings.name == "pid" else 0.0
        errors = initial_errors(self.rule.output_range) if self.film is not None else NO_ERRORS
        known = memory.input_degC, memory.plays, integral, current_A
        return LawState(t, t, now, now, *known, errors=errors, observer=observer)

    def start_anywhere(self, temperature_degC: float, output: float, test_current_A: float = 0.0) -> LawState:
        """Return the state at the first readings of a film with an unknown memory; output: as read, in the film's unit.

        The film has been at one of the law's limits, or beyond, at some time: see `compensator.control.estimator`.
        """
        if self.film is None:
            raise ValueError(f"law {self.settings.name!r}: has no film whose memory it could estimate")
        s, own = self.settings, output
        if self.observer is not None:
            own = float(self.observer.own(output))
        possible = possible_memories(self.film, temperature_degC, own, s.low_degC, s.high_degC)
        if possible.shape[0] == 0:
            return self.start(temperature_degC, None, test_current_A=test_current_A)
        plays = np.empty(self.film.operators)
        disturbance = mean_of(possible, plays)
        possible.setflags(write=False)
        state = self.start(temperature_degC, Memory(temperature_degC, plays), test_current_A=test_current_A)
        errors = with_disturbance(state.errors, disturbance)
        errors.setflags(write=False)
        return state._replace(possible=possible, errors=errors)

    def preview_times_s(self) -> Array:
        """Return how far ahead of a step each of its targets lies, s.

        They are later by a driver's delay and an ohmmeter's lag, and reach further for a lagging film, which has to
        leave earlier.
        """
        s, o = self.settings, self.observer
        first = s.period_s + (o.delay_s + o.lead_s if o is not None else 0.0)
        further = math.ceil(LEAVES_EARLIER * o.film_lag_s / s.preview_spacing_s) if o is not None else 0
        return first + s.preview_spacing_s * np.arange(s.preview + further, dtype=np.float64)

    def late(self, state: LawState, before_A: float, late_s: float) -> tuple[LawState, float]:
        """Return the state after a step whose command acted late_s later than assumed (< 0: earlier), and the time it
        moved.

        before_A: current until then. An observer cannot go back, and under a controller's own regulation the current is
        unknown: in these cases the state stays.
        """
        if self.settings.name == "instrument_pid" or not self.settings.trusts_model:
            return state, 0.0
        drift, error = state.estimate.drift_K_per_s, state.estimate.drive_error
        if self.observer is None:
            plate = with_drive(self.plate.numbers, 1.0 + error)
            there = float(plate_step(plate, state.temperature_degC, before_A, late_s)) + drift * late_s
            moved_K = there - state.temperature_degC
            return state._replace(temperature_degC=there, thermometer_degC=state.thermometer_degC + moved_K), late_s
        if late_s <= 0.0:
            return state, 0.0
        seen = self.observer.predicted(state.observer, drift, late_s, error)
        shown_degC = seen.thermometer_degC
        return state._replace(temperature_degC=seen.plate_degC, thermometer_degC=shown_degC, observer=seen), late_s

    def step(self, state: LawState, inputs: Inputs) -> tuple[Command, LawState]:
        """Return the command and the state after one period. The same arguments give the same bits."""
        if not inputs.targets.flags.writeable:  # another type to the compiled loops
            inputs = inputs._replace(targets=inputs.targets.copy())
        if self.observer is not None:
            return observed_step(self.rule, self.packed_film, self.inverse, self.observer, state, inputs)
        numbers = np.array(NUMBERS(state))
        answer, after, plays, possible, errors, heats = law_step(
            self.ruled,
            self.packed_film,
            self.inverse,
            self.plate.numbers,
            numbers,
            state.plays,
            state.possible,
            state.errors,
            state.heats,
            inputs,
        )
        plays.setflags(write=False)
        possible.setflags(write=False)
        errors.setflags(write=False)
        heats.setflags(write=False)
        following: LawState = STATE(after.tolist(), plays, possible, errors, heats, None)
        return Command(*answer), following

"""Polarity and a first plate, before anything else is sent: one small pulse, and what it does.

rest    no current for a moment: how the temperature drifts by itself
pulse   a share of the current limit (limits.polarity_share), until the temperature has left its drift clearly, or the
        charge is used up that may be put in unseen; the way that it left says the polarity. Hot plates are cooled.
quiet   0 A, until the temperature has stopped going that way: a thermometer that lags, a current that comes late show
        themselves here, and where nothing has left its drift yet, it may do so now
again   where it left the wrong way, the opposite current: polarity is wrong only if that moves it the wrong way too;
        a plate that still drifts from what was before (a long delay, a slow thermometer) goes one way with either

From rest, pulse and quiet comes the plate that the run is watched by (`rig.safety.plate_watch`).
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from compensator.thermal.plate import PlateModel
from rig.config.configuration import Configuration
from rig.control.decision import AT_THE_TICK, Decision, ReadAt
from rig.control.loop import Loop
from rig.core.outcome import Tripped
from rig.core.reading import Reading
from rig.drivers.controller import cools
from rig.safety.bench_watch import OFF, BenchWatch, Limits, Sent
from rig.safety.plate_watch import KnownPlate, first_plate

REST_S = 1.5  # of readings at rest, from which noise and drift are estimated: fifteen at ten a second
FEWEST = 5  # readings at rest
CLEARLY_K, STEPS, SIGMAS = 0.4, 3.0, 6.0
CURVED_PER_S = 0.015  # a drift's own change of rate, over the drift: a plate's time constant is a minute or more
CHARGE_A_S, CHARGE_S = 10.0, 5.0  # put in unseen: 15 K into 10 J/K; for small modules, so long at their limit
DOUBLED_S = 10.0  # a pulse that has decided nothing by then goes on with twice the current
RATE_S, QUIET_SHARE, LONGEST_QUIET_S = 2.0, 0.3, 60.0  # quiet where it goes that way at a share of its fastest
NEAR_LIMIT_K = 5.0
TRIALS = 3  # a pulse may have met a plate that somebody else's heat moved
LATER_S, LATER_SHARE = 1.0, 0.5  # than the model says, for the pulse's own lag to be believed instead


class Rest:
    """Policy for a controller that takes no current: nothing is sent, and the temperature drifts by itself."""

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        return Decision(wait=True)


class PolarityPulse:
    """The policy of the phase. current_A: of the pulse, its sign the way that it is to go.

    left_K: by how much the temperature has left its drift in that way, nan before that is clear.
    """

    def __init__(self, current_A: float, limit_A: float, period_s: float) -> None:
        self.current_A = current_A
        self.left_K = math.nan
        self.rest_s = max(REST_S, FEWEST * period_s)
        self._strong_A = math.copysign(min(2.0 * abs(current_A), limit_A), current_A)
        self._charge_A_s = min(CHARGE_A_S, CHARGE_S * limit_A)
        self._period_s = period_s
        self._put_in_A_s = 0.0
        self._times: list[float] = []
        self._values: list[float] = []
        self._drift: tuple[float, float, float] | None = None
        self._quiet_since_s = math.nan
        self._fastest_K_per_s = 0.0

    @property
    def duration_s(self) -> float:
        """Longest that it takes, s."""
        return self.rest_s + DOUBLED_S + self._charge_A_s / abs(self._strong_A) + LONGEST_QUIET_S

    def decide(self, time_s: float, temperature_degC: float, output: float, read: ReadAt = AT_THE_TICK) -> Decision:
        known = not math.isnan(temperature_degC)
        if known:
            self._times.append(time_s)
            self._values.append(temperature_degC)
        if time_s < self.rest_s - 1e-9 or len(self._values) < FEWEST:
            return Decision(0.0)
        if self._drift is None:
            self._drift = self._fit()
        if known and self._clearly() and math.isnan(self._quiet_since_s):
            self._quiet_since_s = time_s
        if math.isnan(self._quiet_since_s):
            if self._put_in_A_s < self._charge_A_s:
                current_A = self.current_A if time_s < self.rest_s + DOUBLED_S else self._strong_A
                self._put_in_A_s += abs(current_A) * self._period_s
                return Decision(current_A)
            self._quiet_since_s = time_s
        quiet_s = time_s - self._quiet_since_s
        settled = not math.isnan(self.left_K) and quiet_s >= RATE_S + self._period_s and self._is_quiet()
        return Decision(0.0, done=settled or quiet_s >= LONGEST_QUIET_S)

    def _fit(self) -> tuple[float, float, float]:
        """Fit a line to the drift at rest; return its value at the end, its slope, and the scatter of readings about
        it."""
        times, values = np.array(self._times) - self._times[-1], np.array(self._values)
        slope, value = np.polyfit(times, values, 1)
        return float(value), float(slope), float(np.std(values - (value + slope * times)))

    def _clearly(self) -> bool:
        """Return True if the temperature has left its drift clearly, now or before."""
        assert self._drift is not None
        value, slope, scatter_K = self._drift
        if not math.isnan(self.left_K):
            return True
        age_s = self._times[-1] - self.rest_s
        left_K = self._values[-1] - (value + slope * age_s)
        steps = np.abs(np.diff(self._values))
        step_K = float(np.min(steps[steps > 0.0], initial=math.inf))
        coarse_K = STEPS * step_K if math.isfinite(step_K) else 0.0
        if abs(left_K) < max(CLEARLY_K, coarse_K, SIGMAS * scatter_K) + CURVED_PER_S * abs(slope) * age_s**2:
            return False
        self.left_K = math.copysign(1.0, self.current_A) * left_K
        return True

    def _is_quiet(self) -> bool:
        """Return True if it has nearly stopped going the way that it left, beyond its drift at rest."""
        assert self._drift is not None
        lately = [k for k, when in enumerate(self._times) if when >= self._times[-1] - RATE_S]
        first = min(lately[0], len(self._times) - FEWEST)
        times, values = np.array(self._times[first:]), np.array(self._values[first:])
        way = math.copysign(1.0, self.current_A * self.left_K)
        rate = way * (float(np.polyfit(times - times[0], values, 1)[0]) - self._drift[1])
        self._fastest_K_per_s = max(self._fastest_K_per_s, rate)
        curved = CURVED_PER_S * abs(self._drift[1]) * (self._times[-1] - self.rest_s)
        return rate <= QUIET_SHARE * self._fastest_K_per_s + curved


def simulate_pulse(limits: Limits, period_s: float) -> None:
    """Run a pulse, its judgement and some ticks of the watch on a plate that is not there, so that what has to be
    imported and compiled is, before anything is switched on."""
    plate = PlateModel(1.6e-3, 0.06, 0.018, 25.0)
    watch, pulse = BenchWatch(limits, 0.0, True), PolarityPulse(0.25 * limits.current_A, limits.current_A, period_s)
    rows: list[tuple[float, float, float]] = []
    time_s, degC, sent, done = 0.0, 25.0, OFF, False
    while not done and time_s < pulse.duration_s:
        watch.judge(time_s, time_s, sent, Reading(degC + 1e-3 * (len(rows) % 3), time_s), Reading(1e4, time_s))
        decision = pulse.decide(time_s, degC + 1e-3 * (len(rows) % 3), -4.0)
        sent, done = Sent(decision.current_A, armed=True), decision.done
        watch.allow(time_s, degC, decision.current_A)
        rows.append((time_s, degC, decision.current_A))
        time_s, degC = time_s + period_s, plate.step(degC, decision.current_A, period_s)
    time, temperature, current = np.array(rows).T
    known = first_plate(time, temperature, current, limits.current_A)
    if known is not None:
        watch.know(known)
    for _ in range(8):
        time_s += period_s
        watch.judge(time_s, time_s, sent, Reading(degC, time_s), Reading(1e4, time_s))


def check_polarity(
    loop: Loop, configuration: Configuration, period_s: float, model: KnownPlate | None = None
) -> KnownPlate | None:
    """Pulse, judge, and let the loop know the plate: the model's, or the pulse's if there is none.

    Returns what the loop knows now. Raises Tripped("polarity") or Tripped("no_response").
    """
    limits = configuration.limits
    with loop.resting("simulation of the pulse"):
        simulate_pulse(loop.limits, period_s)
    if limits.polarity_share == 0.0 or not loop.bench.controller.commands_current:
        loop.folder.event(loop.elapsed_s(), "polarity", "not checked")
        if not loop.bench.controller.commands_current:  # how it drifts is all that is known of such a plate
            loop.phase("rest", Rest(), max(REST_S, FEWEST * period_s), period_s)
        if model is not None:
            loop.know_plate(model)
        return model
    can_cool = cools(loop.bench.controller)
    now = loop.bench.controller.read_temperature()
    hot = can_cool and now.is_number and now.value > limits.temperature_degC[1] - NEAR_LIMIT_K
    current_A = (-1.0 if hot else 1.0) * limits.polarity_share * limits.current_A
    said = 0.0
    for _ in range(TRIALS):
        first = len(loop.folder.rows)
        pulse = _pulsed(loop, current_A, limits.current_A, period_s)
        if pulse.left_K > 0.0:
            text = f"{current_A:g} A {'heats' if current_A > 0.0 else 'cools'}"
            loop.folder.event(loop.elapsed_s(), "polarity", text, moved_K=pulse.left_K)
            return _known(loop, model, first, limits.current_A)
        said = pulse.left_K
        if not can_cool or _pulsed(loop, -current_A, limits.current_A, period_s).left_K < 0.0:
            break  # either current moves it the wrong way; otherwise it drifts by itself, and has settled some more
    text = (
        f"{current_A:g} A should {'heat' if current_A > 0.0 else 'cool'}, and moved the temperature by "
        f"{abs(said):.2f} K the other way, {-current_A:g} A as well: the Peltier is connected with the wrong polarity"
    )
    raise Tripped("polarity", text, loop.elapsed_s())


def _pulsed(loop: Loop, current_A: float, limit_A: float, period_s: float) -> PolarityPulse:
    """Send one pulse. Raises Tripped("no_response")."""
    pulse = PolarityPulse(current_A, limit_A, period_s)
    loop.phase("polarity", pulse, pulse.duration_s, period_s)
    if math.isnan(pulse.left_K):
        text = (
            f"{current_A:g} A, then twice that, {pulse._put_in_A_s:.3g} A s in all, and a wait did not "
            f"{'heat' if current_A > 0.0 else 'cool'} the plate: is the Peltier connected, and the thermometer on it?"
        )
        raise Tripped("no_response", text, loop.elapsed_s())
    return pulse


def _known(loop: Loop, model: KnownPlate | None, first: int, limit_A: float) -> KnownPlate | None:
    """Return the model's plate, with the pulse's lag if that is longer than likely; without a model the pulse's
    plate."""
    with loop.resting("a first plate from the pulse"):
        folder = loop.folder
        time, degC, current = (folder.column(name)[first:] for name in ("time_s", "temperature_degC", "current_A"))
        seen = first_plate(time, degC, current, limit_A, "peltier" if cools(loop.bench.controller) else "heater")
        known = seen if model is None else model
        if model is not None and seen is not None and seen.least_lag_s > LATER_S + (1.0 + LATER_SHARE) * model.behind_s:
            behind_s = seen.lag_s + seen.delay_s
            text = f"heat shows {behind_s:.2g} s after the current, the model says {model.behind_s:.2g} s"
            folder.event(loop.elapsed_s(), "lag", text)
            known = replace(model, lag_s=seen.lag_s, delay_s=seen.delay_s)
        if known is not None:
            loop.know_plate(known)
            folder.event(loop.elapsed_s(), "first_plate", _in_words(known), behind_s=known.behind_s)
    return known


def _in_words(known: KnownPlate) -> str:
    plate, loss_per_s = known.plate, known.plate.conductance_over_capacity_per_s
    drive = "full drive" if plate.kind == "heater" else "1 A"
    rate = plate.rate_K_per_s(plate.ambient_degC, 1.0)
    constant = f"time constant {1.0 / loss_per_s:.3g} s" if loss_per_s > 0.0 else "no loss to the room"
    return f"{drive} heats by {rate:.3g} K/s, {constant}, lag {known.lag_s:g} s, delay {known.delay_s:g} s"

"""Runaway, in both directions: the plate does not do what the current tells it to.

With a plate model, over windows that end now (the current sent is known, the model is run from the window's first
reading):

departs   the temperature departs from the prediction by more than all of this together can explain: a model that is
          half wrong about the current, a heat sink `SINK_K` from the model's ambient, a thermometer that lags `LAG_S`
against   strong current of one sign for a whole window, and the plate has done less than `LEAST_SHARE` of what it
          should, in the whole window and in its later half: it does not respond (open heater, thermometer that fell
          off), or goes the other way (polarity, a heat sink that is saturated)

Without one, coarsely: strong cooling while it gets hotter from where it is hot already, strong heating while it gets
colder from where it is cold already, and no answer at all to a current that has come on. Under the instrument's own
regulation no current is known: the temperature has to come nearer to a setpoint that is far away.

A law that is wrong cannot argue with this: it sees readings and the commands that were sent, and raises `Tripped`.
"""

from __future__ import annotations

import math
from collections import deque
from dataclasses import dataclass

import numpy as np

from compensator.functions import KELVIN, Array
from compensator.plate import PlateModel
from rig.outcome import Tripped

LOOK_EVERY_S = 0.5
SINK_K, LAG_S, WRONG_SHARE, ROUGH_K = 40.0, 3.0, 0.5, 2.0
STRONG = 0.5  # of the current that is useful
WEAK = 0.25
LEAST_SHARE, LEAST_PREDICTED_K = 0.1, 3.0
HOT_DEGC, COLD_DEGC, AGAINST_K, ANSWER_K = 35.0, 15.0, 1.0, 0.5
FAR_K, NEARER_K = 5.0, 0.3
ONE_STEP_S = 5.0  # from weak to strong within that: a current that has come on


@dataclass(frozen=True)
class Span:
    """What happened from `length_s` ago until now, and what the plate model makes of the first temperature (degC)."""

    length_s: float
    first_degC: float
    modelled_degC: float
    last_degC: float

    @property
    def predicted_K(self) -> float:
        return self.modelled_degC - self.first_degC

    @property
    def done_K(self) -> float:
        return self.last_degC - self.first_degC


class RunawayWatch:
    """Readings (degC) and the currents sent (A) of one run. limit_A: of the current; window_s: limits.runaway_s."""

    def __init__(self, limit_A: float, window_s: float, plate: PlateModel | None = None) -> None:
        self.plate = plate
        self._limit_A, self._window_s = limit_A, window_s
        self._rows: deque[tuple[float, float, float, float]] = deque()  # time, reading; current, setpoint until then
        self._looked_s = -math.inf
        self._strong_sign = 0.0
        self._strong_s = self._weak_s = -math.inf
        self._strong_low = self._strong_high = self._strong_first = math.nan

    def forget(self) -> None:
        """The time before now says nothing any more: the output was off, or nothing is known of it."""
        self._rows.clear()
        self._strong_sign = 0.0

    def look(self, now_s: float, temperature_degC: float, current_A: float, setpoint_degC: float) -> None:
        """A reading (nan: none), and the current (nan: not known) or setpoint sent until now. Raises Tripped."""
        rows = self._rows
        rows.append((now_s, temperature_degC, current_A, setpoint_degC))
        while len(rows) > 1 and now_s - rows[1][0] >= self._window_s:
            rows.popleft()
        if self.plate is None:
            self._note_strong(now_s, temperature_degC, current_A)
        if now_s - self._looked_s < LOOK_EVERY_S or math.isnan(temperature_degC):
            return
        self._looked_s = now_s
        if not math.isnan(setpoint_degC):
            self._look_at_setpoint(now_s)
        elif self.plate is not None:
            self._look_with(self.plate, now_s, temperature_degC)
        else:
            self._look_coarsely(now_s, temperature_degC)

    def check_cooling(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        """Raises Tripped where a current lies beyond that of largest cooling, where more of it cools less."""
        if self.plate is None or math.isnan(temperature_degC):
            return
        least_A, _ = self.plate.current_range_A(temperature_degC, math.inf)
        if current_A < least_A - 1e-6 - 0.02 * abs(least_A):
            text = (
                f"{current_A:g} A at {temperature_degC:.1f} degC: beyond {least_A:.3g} A more current cools less "
                "(I = S T / R_e of the plate model)"
            )
            raise Tripped("cooling_limit", text, now_s)

    def _look_with(self, plate: PlateModel, now_s: float, temperature_degC: float) -> None:
        table = np.array(self._rows)
        times, temperatures = table[:, 0], table[:, 1]
        currents = np.append(table[1:, 2], 0.0)  # a row's current is the one sent from then on
        if np.isnan(currents).any():
            return
        against: list[Span] = []
        for share in (0.25, 0.5, 1.0):
            first = int(np.searchsorted(times, now_s - share * self._window_s + 1e-6, "right")) - 1
            if first < 0 or math.isnan(temperatures[first]):
                return
            course = plate.simulate(float(temperatures[first]), times[first:], currents[first:])
            span = Span(now_s - float(times[first]), float(course[0]), float(course[-1]), temperature_degC)
            sent, steps = currents[first:-1], np.diff(times[first:])
            _check_departure(plate, now_s, span, sent, steps)
            if share > 0.25 and self._is_against(plate, span, sent):
                against.append(span)
        if len(against) == 2:
            self._trip_against(now_s, against[1], float(currents[-2]))

    def _is_against(self, plate: PlateModel, span: Span, sent: Array) -> bool:
        """Strong current of one sign all the time, which should have done something, and did not."""
        low, high = plate.current_range_A(span.last_degC, self._limit_A)
        if not (np.all(sent >= STRONG * high) or (low < 0.0 and np.all(sent <= STRONG * low))):
            return False
        sign = math.copysign(1.0, float(sent[-1]))
        least_K = LEAST_PREDICTED_K * span.length_s / self._window_s
        return sign * span.predicted_K >= least_K and sign * span.done_K < LEAST_SHARE * sign * span.predicted_K

    def _trip_against(self, now_s: float, span: Span, current_A: float) -> None:
        text = (
            f"the current {'heats' if current_A > 0.0 else 'cools'} (last {current_A:+.3g} A), which should have moved "
            f"the plate by {span.predicted_K:+.1f} K in {span.length_s:.0f} s; it went from {span.first_degC:.2f} to "
            f"{span.last_degC:.2f} degC: "
        )
        if math.copysign(1.0, current_A) * span.done_K < 0.0:
            raise Tripped("runaway", text + "polarity, or a saturated heat sink?", now_s)
        raise Tripped("no_response", text + "open, fallen off, or a saturated heat sink?", now_s)

    def _note_strong(self, now_s: float, temperature_degC: float, current_A: float) -> None:
        if not abs(current_A) >= STRONG * self._limit_A:
            self._strong_sign = 0.0
            if abs(current_A) <= WEAK * self._limit_A:
                self._weak_s = now_s
            return
        sign = math.copysign(1.0, current_A)
        if sign != self._strong_sign:
            self._strong_sign, self._strong_s = sign, now_s
            self._strong_low = self._strong_high = self._strong_first = temperature_degC
        self._strong_low = min(self._strong_low, temperature_degC)
        self._strong_high = max(self._strong_high, temperature_degC)

    def _look_coarsely(self, now_s: float, temperature_degC: float) -> None:
        if not self._strong_sign or now_s - self._strong_s < self._window_s:
            return
        age_s = now_s - self._strong_s
        rise, fall = temperature_degC - self._strong_low, self._strong_high - temperature_degC
        text = f"{'heated' if self._strong_sign > 0 else 'cooled'} strongly for {age_s:.0f} s, "
        if self._strong_sign < 0.0 and temperature_degC >= HOT_DEGC and rise >= AGAINST_K:
            text += f"and {rise:.2f} K hotter, {temperature_degC:.2f} degC: polarity, or a saturated heat sink?"
            raise Tripped("runaway", text, now_s)
        if self._strong_sign > 0.0 and temperature_degC <= COLD_DEGC and fall >= AGAINST_K:
            text += f"and {fall:.2f} K colder, {temperature_degC:.2f} degC: polarity, or a thermometer that fell off?"
            raise Tripped("runaway", text, now_s)
        moved = max(self._strong_high - self._strong_first, self._strong_first - self._strong_low)
        if self._strong_s - self._weak_s <= ONE_STEP_S and moved < ANSWER_K:
            text += f"and the temperature has moved by {moved:.2f} K: is the plate connected, the thermometer on it?"
            raise Tripped("no_response", text, now_s)

    def _look_at_setpoint(self, now_s: float) -> None:
        table = np.array(self._rows)
        times, temperatures, setpoints = table[:, 0], table[:, 1], table[:, 3]
        left = (setpoints - temperatures)[1:]
        left = left[np.isfinite(left)]
        if now_s - times[0] < self._window_s or not left.size or math.isnan(temperatures[0]):
            return
        sign = math.copysign(1.0, float(left[-1]))
        first, last = float(temperatures[0]), float(temperatures[-1])
        if float(np.min(sign * left)) >= FAR_K and sign * (last - first) < NEARER_K:
            text = (
                f"{first:.2f} degC became {last:.2f} degC in {now_s - times[0]:.0f} s, no nearer to the setpoint of "
                f"{setpoints[-1]:.2f} degC: polarity, thermometer, or more than the plate can do?"
            )
            raise Tripped("runaway", text, now_s)


def _check_departure(plate: PlateModel, now_s: float, span: Span, sent: Array, steps: Array) -> None:
    """Raises Tripped where nothing that may be wrong with model, sink and thermometer explains the temperature."""
    s, r, g, q = plate.array()[:4]
    drive = s * sent * (span.first_degC + KELVIN) + 0.5 * r * sent**2 + q * sent
    explained_K = ROUGH_K + WRONG_SHARE * float(np.abs(drive) @ steps) + g * SINK_K * span.length_s
    explained_K += LAG_S * float(np.max(np.abs(drive)))
    if abs(span.last_degC - span.modelled_degC) > explained_K:
        text = (
            f"{span.first_degC:.2f} degC became {span.last_degC:.2f} degC in {span.length_s:.1f} s, where the plate "
            f"model gives {span.modelled_degC:.2f} degC for the current that was sent "
            f"(mean {float(sent @ steps) / span.length_s:+.3g} A)"
        )
        raise Tripped("runaway", text, now_s)

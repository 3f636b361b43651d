"""Runaway, coarsely: where no plate is known, or no current.

Without a known plate: strong cooling while it gets hotter from where it is hot already, strong heating while it gets
colder from where it is cold already, and no answer at all to a current that has come on. Under the instrument's own
regulation, where it does not tell its current: the temperature has to come nearer to a setpoint that is far away.
With a known plate `rig.safety.plate_watch` sees all of this, sooner.
"""

from __future__ import annotations

import math
from collections import deque

import numpy as np

from rig.core.outcome import Tripped

LOOK_EVERY_S = 0.5  # a plate moves by less than its noise in between
STRONG = 0.5  # of the current that is useful
WEAK = 0.25
# beyond any room's temperature; beyond noise and a pulse's overshoot; beyond noise
HOT_DEGC, COLD_DEGC, AGAINST_K, ANSWER_K = 35.0, 15.0, 1.0, 0.5
FAR_K, NEARER_K = 5.0, 0.3  # from a setpoint, and the least that it comes nearer by within the window
ONE_STEP_S = 5.0  # from weak to strong within that: a current that has come on


class RunawayWatch:
    """Readings (degC) and the currents sent (A) of one run. limit_A: of the current; window_s: limits.runaway_s."""

    def __init__(self, limit_A: float, window_s: float) -> None:
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
        self._note_strong(now_s, temperature_degC, current_A)
        if now_s - self._looked_s < LOOK_EVERY_S or math.isnan(temperature_degC):
            return
        self._looked_s = now_s
        if not math.isnan(setpoint_degC):
            self._look_at_setpoint(now_s)
        else:
            self._look_coarsely(now_s, temperature_degC)

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

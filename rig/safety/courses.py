"""What the thermometer would show after the output goes off, from what is known while it is on.

of_a_plate    a known plate, and the current that was on: without it, ending as late as a current may end here (a
              driver's delay, a thermometer's lag that is not quite known), and with it still flowing
HeldSetpoint  a controller that shows no current and regulates by itself: its setpoint, once the plate is held there,
              against the slowest way in which a plate would leave it. What is known of that is the rest before the
              output was armed: at T the plate then leaves by (T - T_rest) loss - drift, whatever the room has
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from itertools import pairwise
from typing import Final

from rig.safety.after_off import Courses
from rig.safety.plate_watch import PlateWatch

EVERY_S: Final = 0.25  # of a course: within that any plate's is straight
LOOK_S, LATEST_S = 12.0, 8.0  # 1 A moves a plate of 30 J/K by 3 K in 8 s; LATEST_S: more, where a current may end late
APART_K, STEPS = 2.5, 3.0  # that the courses have to be, at least, before the reading can choose
LOSSES_PER_S: Final = (0.003, 0.08)  # 60 J/K with 0.2 W/K, to 10 J/K with 0.8 W/K
SLOW_S = 10.0  # a thermometer's lag; one that is slower shows less than this says, and is not believed to be held
HELD_LOOK_S, HELD_S, HELD_K, HELD_APART_K = 20.0, 5.0, 1.0, 0.5
REST_S, FEWEST = 1.5, 5  # of readings
COARSE_K = 0.1  # the step of a thermometer that was not seen to make one


def of_a_plate(watch: PlateWatch, current_A: float, within_s: float | None = None) -> Courses | None:
    """None where no plate is known, or no reading could choose in time.

    current_A: what was on since the last look. within_s: by default `LOOK_S`, and more where a current may end late.
    """
    looked_s, late_s = watch.looked_s, watch.late_s
    if math.isnan(looked_s) or not math.isfinite(current_A) or not current_A:
        return None
    seconds = LOOK_S + min(late_s, LATEST_S) if within_s is None else within_s
    off, on = watch.copy(), watch.copy()
    times = [EVERY_S * k for k in range(math.ceil(seconds / EVERY_S) + 1)]
    without = tuple(off.run_on(looked_s + t, current_A if t <= late_s else 0.0) for t in times)
    going_on = tuple(on.run_on(looked_s + t, current_A) for t in times)
    apart_K = APART_K + STEPS * watch.step_K + watch.late_K + watch.off_K
    courses = Courses(EVERY_S, without, going_on, apart_K, f"the last one ({current_A:+.3g} A)")
    return courses if courses.tell else None


class HeldSetpoint:
    """Readings at rest, before the output was on for the first time, and of the last `HELD_S` under regulation."""

    def __init__(self) -> None:
        self._rest: list[tuple[float, float]] = []
        self._was_on = False
        self._held: deque[tuple[float, float]] = deque()
        self._setpoint_degC = math.nan

    def look(self, now_s: float, temperature_degC: float, setpoint_degC: float, armed: bool) -> None:
        """A reading (nan: none), and what the controller was told since the one before (nan: no setpoint)."""
        self._was_on = self._was_on or armed
        if not armed or math.isnan(setpoint_degC) or setpoint_degC != self._setpoint_degC:
            self._held.clear()
        self._setpoint_degC = setpoint_degC
        if math.isnan(temperature_degC):
            return
        if not self._was_on:
            self._rest.append((now_s, temperature_degC))
        elif armed:
            self._held.append((now_s, temperature_degC))
            while now_s - self._held[0][0] > HELD_S + 1.0:
                self._held.popleft()

    def courses(self, within_s: float | None = None) -> Courses | None:
        """None where the plate is not held at its setpoint, or would not leave it for certain in time."""
        values = [degC for _, degC in self._held]
        if not values or self._held[-1][0] - self._held[0][0] < HELD_S:
            return None
        if max(abs(degC - self._setpoint_degC) for degC in values) > HELD_K:
            return None
        held_degC = sum(values) / len(values)
        rate = self._least_rate_K_per_s(held_degC)
        if rate == 0.0:
            return None
        seconds = HELD_LOOK_S if within_s is None else within_s
        times = [EVERY_S * k for k in range(math.ceil(seconds / EVERY_S) + 1)]
        without = tuple(held_degC + rate * (t + SLOW_S * math.expm1(-t / SLOW_S)) for t in times)
        apart_K = HELD_APART_K + max(values) - min(values)
        last = f"its setpoint of {self._setpoint_degC:g} degC still held"
        courses = Courses(EVERY_S, without, (held_degC,) * len(times), apart_K, last)
        return courses if courses.tell else None

    def _least_rate_K_per_s(self, degC: float) -> float:
        """At which a plate of any loss at least leaves a temperature; 0 where it may stay."""
        if len(self._rest) < FEWEST or self._rest[-1][0] - self._rest[0][0] < REST_S:
            return 0.0
        times, values = zip(*self._rest, strict=True)
        time_s, value_degC = sum(times) / len(times), sum(values) / len(values)
        weights = [t - time_s for t in times]
        drift = sum(w * v for w, v in zip(weights, values, strict=True)) / sum(w * w for w in weights)
        off_K = max(abs(v - value_degC - drift * w) for w, v in zip(weights, values, strict=True))
        step_K = _step_K(values, [degC for _, degC in self._held])
        unsure = 2.0 * max(off_K, step_K) / (times[-1] - times[0])
        rates = [drift - loss * (degC - value_degC) for loss in LOSSES_PER_S]
        if rates[0] * rates[1] <= 0.0:
            return 0.0
        least = min(rates, key=abs)
        return math.copysign(max(abs(least) - unsure, 0.0), least)


def _step_K(*runs: Sequence[float]) -> float:
    """The smallest step between two readings in sequence."""
    steps = [abs(b - a) for values in runs for a, b in pairwise(values) if a != b]
    return min(steps, default=COARSE_K)

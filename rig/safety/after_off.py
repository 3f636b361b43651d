"""Whether the temperature agrees that the output is off.

A controller may say "off, 0 A" while a current flows. So the temperature is looked at for some time more, and held
against two courses, from where plate and thermometer were: with a current that ended as late as one may here (a
driver's delay, a thermometer's lag that is not quite known), and with the last one still flowing. Where the two have
parted, the reading is on one side or on the other. Only what has changed since the output went off counts, and a
thermometer that a run has tripped on (`NO_VOICE`) has no voice.
"""

from __future__ import annotations

import math

from rig.core.clock import Clock
from rig.core.errors import InstrumentError
from rig.drivers.controller import TemperatureController
from rig.safety.plate_watch import PlateWatch
from rig.safety.switching_off import MARGIN_S

LOOK_S, LATEST_S, EVERY_S = 8.0, 8.0, 0.25  # LATEST_S: more, where a current may end late
APART_K, STEPS = 2.5, 3.0  # that the courses have to be, at least, before the reading can choose
NO_VOICE = ("unseen_heat", "disturbed", "hidden_heat", "thermometer_stale", "runaway", "no_response", "other_plate")
OFF_SHARE, ON_SHARE, THRICE = 0.4, (0.7, 1.6), 3  # of the way from one course to the other; so many readings alike


class AfterOff:
    """Readings (degC) after the output went off. current_A: the last one that was sent; off_s: when it went off.

    agrees: None until the reading has chosen; text: what it says against "off".
    """

    def __init__(self, watch: PlateWatch, current_A: float, off_s: float) -> None:
        self.agrees: bool | None = None
        self.text = ""
        self._apart_K = _apart_K(watch)
        self._current_A, self._off_s = current_A, off_s
        self._off, self._on = watch.copy(), watch.copy()
        self._ended_s = off_s + watch.late_s
        self._against, self._more_K = 0, math.nan

    def take(self, now_s: float, temperature_degC: float) -> None:
        """A reading; nan: none."""
        if self.agrees is not None:
            return
        with_degC = self._on.run_on(now_s, self._current_A)
        without_degC = self._off.run_on(now_s, self._current_A if now_s <= self._ended_s else 0.0)
        apart_K = with_degC - without_degC
        if math.isnan(self._more_K):
            self._more_K = temperature_degC - without_degC
        if math.isnan(temperature_degC) or abs(apart_K) < self._apart_K:
            return
        share = (temperature_degC - self._more_K - without_degC) / apart_K
        self._against = self._against + 1 if ON_SHARE[0] < share < ON_SHARE[1] else 0
        if share < OFF_SHARE:
            self.agrees = True
        elif self._against >= THRICE:
            self.agrees = False
            self.text = (
                f"{now_s - self._off_s:.1f} s after the controller confirmed that its output is off the thermometer "
                f"shows {temperature_degC:.2f} degC, where it would show {without_degC:.2f} degC without a "
                f"current and at {with_degC:.2f} degC with the last one ({self._current_A:+.3g} A)"
            )


def _apart_K(watch: PlateWatch) -> float:
    """By how much the courses have to be apart."""
    return APART_K + STEPS * watch.step_K + watch.late_K


def after_off(watch: PlateWatch, current_A: float, off_s: float, within_s: float) -> AfterOff | None:
    """The look after an output went off; None where no reading could choose within that time."""
    return AfterOff(watch, current_A, off_s) if watch.tells_within(within_s, current_A, _apart_K(watch)) else None


def contradiction(watch: PlateWatch, current_A: float, controller: TemperatureController, clock: Clock) -> str | None:
    """What the temperature says against "off", in words; None where it agrees, or cannot tell in time.

    Between the first reading and the others nothing is asked for the dead man's time: where the controller was lying,
    it may act.
    """
    begin_s, within_s = clock.now_s(), LOOK_S + min(watch.late_s, LATEST_S)
    look = after_off(watch, current_A, begin_s, within_s)
    dead_man_s = float(getattr(controller, "dead_man_s", 0.0)) if controller.has_dead_man else 0.0
    silent_s = dead_man_s + MARGIN_S if 0.0 < dead_man_s < 0.75 * within_s else 0.0
    wait_s = 0.0
    while look is not None and look.agrees is None and clock.now_s() - begin_s < within_s:
        clock.sleep_until_s(clock.now_s() + wait_s)
        wait_s, silent_s = max(silent_s, EVERY_S), 0.0
        try:
            reading = controller.read_temperature()
        except InstrumentError:
            continue
        look.take(clock.now_s(), reading.value if reading.is_number else math.nan)
    return look.text or None if look is not None else None

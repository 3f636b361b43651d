"""Whether the temperature agrees that the output is off.

A controller may say "off, 0 A" while a current flows. So the temperature is looked at for some time more, and held
against two courses, from where plate and thermometer were (`rig.safety.courses`): with the output off, and with what
was on going on. Where the two have parted, the reading is on one side or on the other. Only what has changed since the
output went off counts, and a thermometer that a run has tripped on (`NO_VOICE`) has no voice.

The working process, the daemon and the guard judge by this. The guard has no arrays and no plate: the courses come to
it as numbers, while all is well.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any

from rig.core.clock import Clock
from rig.core.errors import InstrumentError
from rig.drivers.controller import TemperatureController
from rig.safety.switching_off import MARGIN_S

EVERY_S = 0.25  # between two readings
SILENT_SHARE = 0.75  # of the look, that a silence for the dead man may take
NO_VOICE = ("unseen_heat", "disturbed", "hidden_heat", "thermometer_stale", "runaway", "no_response", "other_plate")
OFF_SHARE, ON_SHARE, THRICE = 0.4, (0.7, 1.6), 3  # of the way from one course to the other; so many readings alike
DIGITS = 3  # mK


@dataclass(frozen=True)
class Courses:
    """What the thermometer would show, degC, every `every_s` from the moment when the output goes off.

    without: with the output off. going_on: with what was on going on. apart_K: by how much the two have to differ
    before a reading can choose. last: what was on, in words.
    """

    every_s: float
    without: tuple[float, ...]
    going_on: tuple[float, ...]
    apart_K: float
    last: str

    @property
    def lasts_s(self) -> float:
        """How far they reach."""
        return self.every_s * (len(self.without) - 1)

    @property
    def tell(self) -> bool:
        """Whether a reading can choose before they end."""
        return abs(self.going_on[-1] - self.without[-1]) > self.apart_K

    def at(self, seconds: float) -> tuple[float, float]:
        """Without and going on, so long after the output went off."""
        place = min(max(seconds / self.every_s, 0.0), len(self.without) - 1.0)
        k = min(int(place), len(self.without) - 2)
        share = place - k
        without, going_on = (c[k] + share * (c[k + 1] - c[k]) for c in (self.without, self.going_on))
        return without, going_on

    def table(self) -> dict[str, Any]:
        """As JSON takes it."""
        short = {name: [round(v, DIGITS) for v in getattr(self, name)] for name in ("without", "going_on")}
        return {**asdict(self), **short}


def courses_of(table: dict[str, Any]) -> Courses:
    """From what `Courses.table` gave."""
    return Courses(**{**table, "without": tuple(table["without"]), "going_on": tuple(table["going_on"])})


class AfterOff:
    """Readings (degC) after the output went off, at `off_s`.

    agrees: None until the reading has chosen; text: what it says against "off".
    """

    def __init__(self, courses: Courses, off_s: float) -> None:
        self.agrees: bool | None = None
        self.text = ""
        self._courses, self._off_s = courses, off_s
        self._against, self._more_K = 0, math.nan

    @property
    def over(self) -> bool:
        """Whether it has chosen."""
        return self.agrees is not None

    @property
    def ends_s(self) -> float:
        """From when on no reading can tell any more."""
        return self._off_s + self._courses.lasts_s

    def take(self, now_s: float, temperature_degC: float) -> None:
        """A reading; nan: none."""
        if self.over or math.isnan(temperature_degC) or now_s > self.ends_s:
            return
        after_s = now_s - self._off_s
        without_degC, going_on_degC = self._courses.at(after_s)
        if math.isnan(self._more_K):
            self._more_K = temperature_degC - without_degC
        apart_K, least_K = going_on_degC - without_degC, self._courses.apart_K
        gone_K = math.copysign(1.0, apart_K) * (going_on_degC + self._more_K - temperature_degC)
        if gone_K > (1.0 - OFF_SHARE) * max(abs(apart_K), least_K):
            self.agrees = True
        if abs(apart_K) < least_K or self.agrees:
            return
        share = 1.0 - gone_K / abs(apart_K)
        self._against = self._against + 1 if ON_SHARE[0] < share < ON_SHARE[1] else 0
        if self._against >= THRICE:
            self.agrees = False
            off_degC, on_degC = without_degC + self._more_K, going_on_degC + self._more_K
            self.text = (
                f"{after_s:.1f} s after the controller confirmed that its output is off the thermometer "
                f"shows {temperature_degC:.2f} degC, where it would show {off_degC:.2f} degC without a current and "
                f"{on_degC:.2f} degC with {self._courses.last}"
            )


def looked_at(
    courses: Courses, controller: TemperatureController, clock: Clock, off_s: float, dead_man_s: float = 0.0
) -> AfterOff:
    """Read the temperature until it has chosen, or until the courses end.

    Between the first reading and the others nothing is asked for the dead man's time (s, 0 for none): where the
    controller was lying, it may act.
    """
    look = AfterOff(courses, off_s)
    silent_s = dead_man_s + MARGIN_S if 0.0 < dead_man_s < SILENT_SHARE * courses.lasts_s else 0.0
    wait_s = 0.0
    while not look.over and clock.now_s() < look.ends_s:
        clock.sleep_until_s(clock.now_s() + wait_s)
        wait_s, silent_s = max(silent_s, EVERY_S), 0.0
        try:
            reading = controller.read_temperature()
        except InstrumentError:
            continue
        look.take(clock.now_s(), reading.value if reading.is_number else math.nan)
    return look

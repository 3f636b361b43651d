"""The meter's readings: begun so early that each is there when a tick has read the temperature, and as long as fits.

A meter takes most of a period for a reading: the question's bytes, the integration, the answer's bytes. So it is asked
before a tick, and the tick fetches what has come in. The film is then read as late as can be, and the tick waits for
nobody; when it was read, the reading's own time says.

    tick        thermometer . fetch [begin] decide, command                    [begin]                      next tick
                                     if there is no time for it later          so that it is there as the thermometer is

Where the period has room for more integrations than one, a reading is the mean of several, by the meter's own filter
(`rig.drivers.meter`): a meter that idles for a half of the period measures in it, and its readings' noise falls.
"""

from __future__ import annotations

import math
from contextlib import suppress

from rig.core.clock import Clock
from rig.core.errors import Disconnected, InstrumentError, Refused
from rig.core.faults import Faults
from rig.core.reading import Reading
from rig.drivers.meter import Averaging, Meter, average, settled_reading

ROOM = 0.9  # of a period, that a reading may take: the rest is for a host that is late, and for the decision
LONGEST_S = 0.1  # of averaging: the law weighs readings over half a second, so that it loses nothing by that
MOST = 100  # integrations that the filters take
MARGIN = 0.05  # of a period, by which a reading is to be there early
WAITED_S = 0.001  # for a reading: then it is known how long it took
USUAL = 0.1  # share by which a new duration counts, and by which a reading's goes back to what it was at rest


class MeterReadings:
    """Readings of one meter by one loop; meter: None if the bench has none.

    count: integrations of a reading; None: as many as the period has room for.
    """

    def __init__(self, meter: Meter | None, clock: Clock, count: int | None = None) -> None:
        self._meter, self._clock, self._count = meter, clock, count
        self._period_s, self._is_fitted = math.nan, False
        self._at_rest_s = self._takes_s = 0.0  # how long a reading takes: at rest, and now
        self._thermometer_s = self._rest_of_tick_s = 0.0  # how long a tick needs before and after it
        self._begun_s: float | None = None
        self._why_not: InstrumentError | None = None  # it could not be begun
        self._answers = True  # the last one came

    def fit(self, period_s: float) -> str:
        """Choose the number of integrations of a reading for a period, and measure how long a reading takes.

        Returns a sentence about it, empty if nothing has changed. Raises Disconnected; Faults for a configured number
        that the meter does not take. After any other fault readings are single ones until the next fit, and the first
        tick reports the fault.
        """
        if self._meter is None or (self._is_fitted and period_s == self._period_s):
            return ""
        self.leave()
        self._period_s = self._at_rest_s = self._takes_s = period_s
        self._is_fitted = False
        try:
            averaging = self._fitted(self._meter, period_s)
        except Disconnected:
            raise
        except InstrumentError:
            self._at_rest_s = self._takes_s = period_s
            with suppress(InstrumentError):
                self._averages(self._meter, Averaging())
            return ""
        self._is_fitted = True
        mean = f"the mean of {averaging.count} integrations" if averaging.count > 1 else "one integration"
        return f"each reading is {mean} and takes {self._at_rest_s:.3f} s of a period of {period_s:g} s"

    def _fitted(self, meter: Meter, period_s: float) -> Averaging:
        one = Averaging()
        self._averages(meter, one)
        settled_reading(meter)
        single_s, longest_s = self._timed(meter)
        self._at_rest_s = self._takes_s = longest_s
        room_s = ROOM * period_s - longest_s
        if self._count == 1 or (self._count is None and room_s <= 0.0):
            return one
        count, each_s = self._count or 2, math.nan
        while count > 1 and self._averages(meter, Averaging(count, each_s)):
            shortest_s, longest_s = self._timed(meter)
            known, each_s = not math.isnan(each_s), max((shortest_s - single_s) / (count - 1), 1e-4)
            if known and (self._count is not None or longest_s <= ROOM * period_s):
                self._at_rest_s = self._takes_s = longest_s
                return Averaging(count, each_s)
            if self._count is None:
                most = min(1 + int(room_s / each_s), int(LONGEST_S / each_s), MOST)
                count = min(most, count - 1) if known else most
        self._averages(meter, one)
        return one

    def _averages(self, meter: Meter, averaging: Averaging) -> bool:
        """Return True if the meter takes that filter. Raises Faults if it does not, and the filter is the configured
        one."""
        try:
            average(meter, averaging)
        except Refused as error:
            if self._count is not None and averaging.count > 1:
                raise Faults([f"bench.meter.average: {self._count}: {error}; expected 1, or nothing"]) from None
            return False
        return True

    def _timed(self, meter: Meter) -> tuple[float, float]:
        """Return how long a reading takes, s: the shorter of two, which no late host has lengthened, and the longer."""
        took_s = []
        for _ in range(2):
            begin_s = self._clock.now_s()
            meter.read()
            took_s.append(self._clock.now_s() - begin_s)
        return min(took_s), max(took_s)

    # ---- tick by tick ---------------------------------------------------------------------------

    def ready(self) -> None:
        """Wait, before a phase's first tick, until a reading will be there after the temperature's."""
        if self._meter is None or not self._answers:
            return
        if self._begun_s is not None and self._clock.now_s() - self._begun_s > self._takes_s + self._period_s:
            self.leave()
        if self._begun_s is None and self._answers:
            self._begin(self._meter)
        if self._begun_s is not None:
            there_s = self._begun_s + self._takes_s - self._thermometer_s
            self._clock.sleep_until_s(min(there_s, self._clock.now_s() + self._period_s))  # a current may flow

    def begin_for(self, due_s: float) -> None:
        """Wait until the reading of the tick due then has to begin, and begin it.

        Not with a meter that has just failed: bringing its line in step may take a second and more. That is done in a
        tick, which reads the temperature before and after, so that the program is not late.
        """
        if self._meter is not None and self._answers and self._begun_s is None:
            self._clock.sleep_until_s(min(self._begins_s(due_s), due_s))
            self._begin(self._meter)

    def begin_before_the_command(self, due_s: float) -> None:
        """Begin the next reading at once if there is no time for it after the command."""
        after_it_s = self._clock.now_s() + self._rest_of_tick_s
        if self._meter is not None and self._answers and self._begins_s(due_s) < after_it_s:
            self._begin(self._meter)

    def fetch(self) -> Reading | None:
        """Return the reading that was begun; None without a meter. Raises InstrumentError."""
        if self._meter is None:
            return None
        if self._begun_s is None:
            self._begin(self._meter)
        begun_s, why_not = self._begun_s or 0.0, self._why_not
        self._begun_s = self._why_not = None
        self._answers = False
        if why_not is not None:
            raise why_not
        asked_s = self._clock.now_s()
        reading = self._meter.finish_reading()
        now_s, self._answers = self._clock.now_s(), True
        waited = now_s - asked_s > WAITED_S
        self._takes_s = now_s - begun_s if waited else _toward(self._takes_s, self._at_rest_s, USUAL)
        return reading

    def leave(self) -> None:
        """Discard the reading that is under way."""
        pending, self._begun_s = self._begun_s is not None and self._why_not is None, None
        self._why_not = None
        if pending and self._meter is not None:
            try:
                self._meter.finish_reading()
            except InstrumentError:  # who wants the next one is told
                self._answers = False

    def thermometer_took(self, took_s: float) -> None:
        """Learn how long a tick's temperature reading took."""
        self._thermometer_s = _toward(self._thermometer_s, took_s, USUAL)

    def rest_took(self, took_s: float) -> None:
        """Learn how long the rest of a tick, from both readings to the command, took."""
        self._rest_of_tick_s = _toward(self._rest_of_tick_s, took_s, USUAL)

    def _begins_s(self, due_s: float) -> float:
        return due_s + self._thermometer_s - self._takes_s - MARGIN * self._period_s

    def _begin(self, meter: Meter) -> None:
        try:
            meter.start_reading()
        except Disconnected:
            raise
        except InstrumentError as error:
            self._why_not = error
        self._begun_s = self._clock.now_s()  # what had to be brought in step before is no part of the reading


def _toward(old: float, new: float, share: float) -> float:
    return old + share * (new - old) if old > 0.0 else new

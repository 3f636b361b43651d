"""Measurements of a SCPI instrument: begun at once or by a question, integrated, sampled in the middle, given out.

Source: SCPI-1999 volume 2, 24 (trigger model), as far as one layer of it goes.

A reading integrates for its aperture and samples the film in the middle; `overhead_s` later it is there. Where the
instrument finds that it needs another range, it measures again. A reading may be the mean of several integrations, one
after the other, as a repeating filter has it; in a new range the filter begins anew.
"""

from __future__ import annotations

from math import inf, isfinite

from sim.instruments.instrument import Plant
from sim.instruments.scpi_instrument import ScpiInstrument


class TriggeredInstrument(ScpiInstrument):
    """overhead_s: from the end of an integration until its reading is there."""

    def __init__(
        self,
        plant: Plant,
        *,
        byte_s: float,
        terminator: bytes,
        command_s: float,
        overhead_s: float,
        start_s: float,
    ) -> None:
        super().__init__(plant, byte_s=byte_s, terminator=terminator, command_s=command_s, start_s=start_s)
        self._overhead_s = overhead_s
        self._sample_s = inf
        self._wanted: list[str] = []
        self._remaining = 0
        self._stack: list[float] = []  # of the filter: the integrations of this reading
        self._last = ""
        self._fresh = False

    def aperture_s(self) -> float:
        """How long a reading integrates, s."""
        raise NotImplementedError

    def trigger_delay_s(self) -> float:
        """From the trigger to the beginning of the integration, s."""
        raise NotImplementedError

    def averaged(self) -> int:
        """Of how many integrations a reading is the mean."""
        return 1

    def digitize(self) -> str:
        """What is measured now, as text; empty where the range has changed and it must measure again."""
        raise NotImplementedError

    def filtered(self, value: float) -> float:
        """The mean of this reading's integrations so far, this one among them; one beyond the range is told as such."""
        self._stack.append(value)
        return next((each for each in self._stack if not isfinite(each)), sum(self._stack) / len(self._stack))

    @property
    def measuring(self) -> bool:
        """Whether a measurement is on its way."""
        return self._remaining > 0

    def initiate(self, count: int = 1) -> None:
        """Begin `count` readings."""
        self.abort()
        self._remaining = count
        self._wanted = []
        self._integrate(self._now_s + self.trigger_delay_s())

    def read(self, count: int) -> None:
        """`READ?`: begin `count` readings, and let the message wait for them."""
        self.initiate(count)
        self._waiting = True

    def fetch(self, fresh: bool) -> str | None:
        """The last reading, after those that are on their way; `fresh`: one that was not given out before."""
        if self.measuring or (fresh and not self._fresh) or not self._last:
            if not self.measuring:
                self.initiate()
            self._waiting = True
            return None
        self._fresh = False
        return self._last

    def abort(self) -> None:
        """Back to idle, without a reading."""
        self._remaining = 0
        self._waiting = False
        self._sample_s = inf

    def _integrate(self, begin_s: float) -> None:
        """Integrate from `begin_s`, for a reading of its own."""
        self._stack = []
        self._integrate_once(begin_s)

    def _integrate_once(self, begin_s: float) -> None:
        aperture_s = self.aperture_s()
        self._sample_s = begin_s + 0.5 * aperture_s
        self._ready_s = begin_s + aperture_s + self._overhead_s
        self._plant.schedule(self._sample_s, self._sample)

    def _sample(self, time_s: float) -> None:
        if time_s < self._sample_s:  # of a measurement that was aborted
            return
        self._sample_s = inf
        text = self.digitize()
        if not text:  # another range
            self._integrate(self._ready_s)
            return
        if 0 < len(self._stack) < self.averaged():
            self._integrate_once(self._ready_s)
            return
        self._wanted.append(text)
        self._remaining -= 1
        if self._remaining:
            self._integrate(self._ready_s + self.trigger_delay_s())
            return
        self._last, self._fresh = ",".join(self._wanted), True
        self._free_s = self._ready_s
        self._finished()
        if self._waiting:
            self._waiting = False
            self._fresh = False
            self._answers.append(self._last)
            if not self._calls:
                self._reply(self._ready_s)
        self._work(time_s)

    def _finished(self) -> None:
        """All readings are there."""

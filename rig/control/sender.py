"""Commands to the controller, and what is on.

One that the controller does not acknowledge ends nothing at once, as one reading that fails does not: it may have
arrived or not, the output holds the last current or this one, and both were allowed. The next tick's command makes it
certain again. How long that may go on is what a reading may be old (`limits.stale_s`), and less where the controller's
own dead man acts sooner. A refusal, and a port that is gone, end a run as ever.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace

from rig.bench.assembly import Bench
from rig.control.decision import Decision
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, TimedOut, of_whom
from rig.ports.transport import fallen_silent
from rig.safety.bench_watch import OFF, BenchWatch, Limits, Sent

MEASURED_EVERY_S = 0.25  # the current under the controller's own regulation
MAY_HAVE_ARRIVED = (TimedOut, Corrupt, OutOfStep)


class Sender:
    """Commands of one loop. sent: what is on; why: the last command was not acknowledged."""

    def __init__(self, bench: Bench, limits: Limits, watch: BenchWatch) -> None:
        self.sent = OFF
        self.why = ""
        self._bench, self._watch = bench, watch
        self._measured_s = -math.inf
        self._unacknowledged_s: float | None = None  # since when
        dead_man_s = float(getattr(bench.controller, "dead_man_s", 0.0)) if bench.controller.has_dead_man else 0.0
        self._longest_s = min(limits.stale_s, dead_man_s) if dead_man_s > 0.0 else limits.stale_s

    def rests(self) -> None:
        """Forget what is on, after an off or a time without a current: the next command arms the output anew."""
        self.sent, self._unacknowledged_s = OFF, None

    def measured(self, now_s: float) -> Sent:
        """Return what is on; under the controller's own regulation with the current that it measures, if it can."""
        controller = self._bench.controller
        if self._measures and now_s - self._measured_s >= MEASURED_EVERY_S:
            self._measured_s = now_s
            with suppress(InstrumentError):
                reading = controller.read_current()
                self.sent = replace(self.sent, current_A=reading.value if reading.is_number else math.nan)
        return self.sent

    def apply(self, decision: Decision, now_s: float, degC: float) -> float:
        """Send a decision, arm the output first if needed, and return about when it acts, on the bench's clock.

        nan: it was not acknowledged. Raises Tripped for what may not be sent, and InstrumentError.
        """
        controller = self._bench.controller
        if decision.use_setpoint:
            self._arm(now_s, math.isnan(self.sent.setpoint_degC), controller.arm_setpoint)
            current_A = self.sent.current_A if self._measures else math.nan
            wanted, value = Sent(current_A, decision.setpoint_degC, True), decision.setpoint_degC
            return self._send(controller.set_setpoint_degC, value, wanted)
        self._watch.allow(now_s, degC, decision.current_A)
        armed = self.sent.armed and math.isnan(self.sent.setpoint_degC)
        self._arm(now_s, not armed, controller.arm_current)
        return self._send(controller.set_current_A, decision.current_A, Sent(decision.current_A, armed=True))

    def _arm(self, now_s: float, needed: bool, arm: Callable[[], None]) -> None:
        """Arm the output; every question of it has to be answered."""
        if not needed:
            return
        self._bench.guard.busy()
        try:
            arm()
        except InstrumentError as error:
            of_whom(error, self._called)
            raise
        self._watch.armed(now_s)
        self.sent = replace(self.sent, armed=True)

    def _send(self, command: Callable[[float], None], value: float, wanted: Sent) -> float:
        clock = self._bench.clock
        before_s = clock.now_s()
        try:
            command(value)
        except MAY_HAVE_ARRIVED as error:
            self._doubt(error, before_s, wanted)
            return math.nan
        except InstrumentError as error:
            of_whom(error, self._called)
            raise
        self.sent, self._unacknowledged_s = wanted, None
        return 0.5 * (before_s + clock.now_s())

    def _doubt(self, error: InstrumentError, before_s: float, wanted: Sent) -> None:
        """Note a command without acknowledgement; raise the error if that has gone on for too long."""
        of_whom(error, self._called)
        since_s = before_s if self._unacknowledged_s is None else self._unacknowledged_s
        self._unacknowledged_s, self.why = since_s, str(error)
        now_s = self._bench.clock.now_s()
        unacknowledged_s = now_s - since_s
        if unacknowledged_s > self._longest_s:
            expected = f"expected one every {self._longest_s:g} s{fallen_silent(self._bench.controller, now_s)}"
            error.args = (f"{error}; no command was acknowledged for {unacknowledged_s:.2f} s, {expected}",)
            raise error
        if not self.sent.heats_or_cools or math.isnan(self.sent.setpoint_degC) != math.isnan(wanted.setpoint_degC):
            self.sent = wanted  # something may flow, and is watched as if it did

    @property
    def _called(self) -> str:
        return self._bench.called.get("controller", "the controller")

    @property
    def _measures(self) -> bool:
        """Return True if the controller regulates by itself and reports the current."""
        return not math.isnan(self.sent.setpoint_degC) and self._bench.controller.commands_current

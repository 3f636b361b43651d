"""The fixed-period loop: readings -> policy -> interlock -> controller -> one row a tick.

A tick reads the temperature, fetches the reading that the meter was asked for before (`rig.control.meter_readings`),
asks the policy, and sends the command; the row's time is that of the temperature's reading, a few milliseconds before
its current acts. Ticks lie on a fixed grid of the bench's clock; one that is missed is counted and not made up for.

A reading that is frozen, jumps or is missing is none (`rig.safety.bench_watch`): the policy is given nan, and goes on
without it until the interlock finds that too long. A trip latches: a loop that has tripped runs no further phase.

Nothing is computed with the output on: what takes longer than a tick is done before the first phase, or inside
`resting`, with the output off and the guard idle. A program that is late all the same says so, and counts it.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace

from rig.bench.assembly import Bench
from rig.control.decision import Decision, Onlooker, Policy, Predicts, Tick, Ticks, kept_law, read_at
from rig.control.meter_readings import MeterReadings
from rig.core.errors import Corrupt, Disconnected, InstrumentError, OutOfStep, TimedOut, of_whom
from rig.core.outcome import NotConfirmedOff, Tripped
from rig.core.reading import Quality, Reading, missing
from rig.drivers.meter import LOG_RESISTANCE, film_output, on_since_s
from rig.ports.transport import fallen_silent
from rig.records.run_folder import RunFolder
from rig.safety.bench_watch import (
    OFF,
    BenchWatch,
    Limits,
    Sent,
    check_test_current,
    is_reading,
    status_in_words,
    status_of,
)
from rig.safety.plate_watch import KnownPlate
from rig.safety.signals import SignalStop
from rig.safety.switching_off import ExpectedCurves, switch_off

# ---- commands to the controller, and what is on ------------------------------------------------------
#
# One that the controller does not acknowledge ends nothing at once, as one reading that fails does not: it may have
# arrived or not, the output holds the last current or this one, and both were allowed. The next tick's command makes it
# certain again. How long that may go on is what a reading may be old (`limits.stale_s`), and less where the
# controller's own dead man acts sooner. A refusal, and a port that is gone, end a run as ever.

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


GAP_S = 0.5  # without a reading while a current flows: that is counted and told
TOLD_EVERY_S = 0.5  # to the guard, what the temperature would do after an off: a millisecond of computing


class Loop:
    """Loop of one bench and one run folder, phase after phase.

    tripped: the trip that ended this loop, which runs no further phase. rejected: number of readings of each instrument
    that were not credible. signals: looked at before anything is sent. averaged: integrations of a meter's reading;
    None: as many as a period has room for.
    """

    def __init__(
        self,
        bench: Bench,
        limits: Limits,
        folder: RunFolder,
        signals: SignalStop,
        onlooker: Onlooker,
        averaged: int | None = None,
    ) -> None:
        self.bench = bench
        self.limits = limits
        self.folder = folder
        self.ticks = Ticks()
        self.tripped: Tripped | None = None
        self.status_at_trip = ""
        self.rejected = {"thermometer": 0, "ohmmeter": 0}
        self._acts_after_s = 0.0
        self._onlooker = onlooker
        self._signals = signals
        self._start_s = bench.clock.now_s()
        self._output = bench.meter.output if bench.meter is not None else LOG_RESISTANCE
        self.watch = BenchWatch(limits, self._start_s, self._output == LOG_RESISTANCE)
        self._sender = Sender(bench, limits, self.watch)
        self._readings = MeterReadings(bench.meter, bench.clock, averaged)
        self._read_s: float | None = None  # the last reading with a current on
        self._told_s = -math.inf

    def after_off(self) -> ExpectedCurves | None:
        """Return the expected temperatures if the output went off now; None if no reading could tell on from off."""
        return self.watch.after_off(self.sent.current_A)

    @property
    def sent(self) -> Sent:
        """Return what is on."""
        return self._sender.sent

    def elapsed_s(self) -> float:
        """Return the time of the run, s."""
        return self.bench.clock.now_s() - self._start_s

    def know_plate(self, known: KnownPlate) -> None:
        """Judge readings by this plate's model from now on."""
        self.watch.know(known)

    def phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        """Run a policy for a time, or until it says that it is done. Raises what ends an experiment.

        The last command stays on: the next phase follows at once, or `resting` does.
        """
        if self.tripped is not None:
            raise self.tripped
        try:
            self._phase(name, policy, duration_s, period_s)
        except Tripped as trip:
            self.tripped = trip
            self._note_status()
            raise

    @contextmanager
    def resting(self, why: str) -> Iterator[None]:
        """Keep the output off and the guard idle while something is computed; the next phase arms it anew.

        Raises NotConfirmedOff.
        """
        self.bench.guard.alive()
        if self.sent.armed:
            if not math.isnan(self.sent.current_A):
                self.bench.controller.set_current_A(0.0)
            verdict = switch_off(self.bench.controller, alive=self.bench.guard.alive)
            if not verdict.confirmed:
                raise NotConfirmedOff(verdict.text)
        self._signals.look()
        self._sender.rests()
        self._read_s = None
        self.watch.rests()
        self.bench.guard.idle()
        self._readings.leave()
        begin_s = self.elapsed_s()
        yield
        self.folder.event(begin_s, "rest", why, duration_s=self.elapsed_s() - begin_s)

    def leave_meter(self) -> None:
        """Let a reading that is under way come in: the meter is used by somebody else from now on."""
        self._readings.leave()

    def _phase(self, name: str, policy: Policy, duration_s: float, period_s: float) -> None:
        clock = self.bench.clock
        if not self.sent.armed:
            fitted = self._readings.fit(period_s)
            if fitted:
                self.folder.event(self.elapsed_s(), "meter", fitted)
        self._readings.ready()
        own = kept_law(policy)
        if own.file:
            self.folder.keep(own.file, own.text)
        begin = clock.now_s()
        if not self.sent.heats_or_cools and self.watch.unwatched_s(begin) > 0.5 * self.limits.stale_s:
            self._begin_anew(begin)
        times = {"duration_s": duration_s, "period_s": period_s}
        self.folder.event(begin - self._start_s, "phase", name, **times, **own.entries)
        self._onlooker.phase(name, 0.0, duration_s)
        count = max(1, math.ceil(duration_s / period_s - 1e-9))
        k = 0
        while k < count:
            due = begin + k * period_s
            self._readings.begin_for(due)
            clock.sleep_until_s(due)
            late = clock.now_s() - due
            self.ticks.latest_s = max(self.ticks.latest_s, late)
            if late > period_s:
                missed = int(late / period_s)
                self.ticks.missed += missed
                k += missed
                due = begin + k * period_s
            if self._tick(name, policy, begin - self._start_s, k, period_s):
                break
            if k % 16 == 15:
                self._onlooker.phase(name, (k + 1) * period_s, duration_s)
            k += 1
        end = begin + min(k, count) * period_s
        self._readings.begin_for(end)
        clock.sleep_until_s(end)
        self._onlooker.phase(name, duration_s, duration_s)

    def _begin_anew(self, now: float) -> None:
        """Arm the output anew after a while without a current and without a reading.

        The controller's own dead man may have switched it off.
        """
        self.watch.begin_anew(now)
        self._sender.rests()
        self._read_s = None

    def _tick(self, name: str, policy: Policy, begin_s: float, k: int, period_s: float) -> bool:
        self._signals.look()
        asked = self.bench.clock.now_s()
        temperature, resistance, of_meter = self._read_both(self._start_s + begin_s + (k + 1) * period_s, period_s)
        test_current_A, test_on_s = of_meter
        now = self.bench.clock.now_s()
        self._count_gap(now)
        sent = self._sender.measured(now)
        temperature, resistance, reasons = self.watch.judge(asked, now, sent, temperature, resistance)
        self._note_rejected(now, reasons, temperature, resistance)
        known = temperature.is_number
        degC = temperature.value if known else math.nan
        output = film_output(self._output, resistance)
        good = resistance is not None and not math.isnan(output)
        value = resistance.value if resistance is not None and (good or is_reading(resistance)) else math.nan
        row_s = (temperature.time_s if known else now) - self._start_s
        output_s = resistance.time_s - self._start_s if good and resistance is not None else math.nan
        acts_after_s = self._acts_after_s
        read = read_at(begin_s, k * period_s, row_s, output_s, acts_after_s, test_current_A)
        decision = policy.decide(k * period_s, degC, output, read)
        current_time_s = math.nan  # as before
        if not decision.wait and (not decision.done or math.isfinite(decision.current_A)):
            armed = self.sent.armed
            current_time_s = self._apply(policy, decision, now, degC, begin_s) - self._start_s
            if armed and not math.isnan(current_time_s):  # to arm it takes longer than the next one will
                self._acts_after_s = min(max(current_time_s - row_s, 0.0), period_s)
        self.watch.look_at_status(now, self.sent, self.bench.controller)
        ohms = self._output == LOG_RESISTANCE
        self.folder.row(
            (
                row_s,
                degC,
                value if ohms else math.nan,
                self.sent.current_A,
                test_current_A,
                output_s,
                current_time_s,
                test_on_s,
                decision.setpoint_degC,
                decision.reference_degC,
                decision.target_ohm,
                decision.predicted_ohm if ohms else math.nan,
                acts_after_s,
                k,
                name,
                *([] if ohms else [decision.target_output, decision.predicted_output, value]),
            )
        )
        if not self.bench.virtual:
            self.folder.flush()
        self.ticks.done += 1
        self._tell_guard(now)
        seen = temperature, resistance, test_current_A
        self._onlooker.tick(Tick(now - self._start_s, name, *seen, self.sent.current_A, decision, self.watch))
        self._readings.rest_took(self.bench.clock.now_s() - now)
        return decision.done

    def _tell_guard(self, now: float) -> None:
        """Tell the guard that the loop lives, and the expected temperatures if it stops."""
        guard = self.bench.guard
        guard.alive()
        if guard.guarding and now - self._told_s >= TOLD_EVERY_S:
            self._told_s = now
            guard.expects(self.after_off())

    def _count_gap(self, now: float) -> None:
        """Measure the time without a reading while a current is on."""
        if self._read_s is not None and self.sent.heats_or_cools:
            unwatched_s = now - self._read_s
            self.ticks.unwatched_s = max(self.ticks.unwatched_s, unwatched_s)
            if unwatched_s > GAP_S:
                self.ticks.gaps += 1
                self.folder.event(now - self._start_s, "gap", f"no reading for {unwatched_s:.2f} s with a current on")
        self._read_s = now

    def _note_rejected(
        self, now: float, reasons: dict[str, str], temperature: Reading, resistance: Reading | None
    ) -> None:
        for name, reading in (("thermometer", temperature), ("ohmmeter", resistance)):
            if name in reasons and reading is not None and reading.quality is not Quality.OVERRANGE:
                self.rejected[name] += 1
                if reading.quality is not Quality.MISSING:  # that was told when it was asked for
                    self.folder.event(now - self._start_s, "no_reading", f"{name}: {reasons[name]}")

    def _apply(self, policy: Policy, decision: Decision, now: float, degC: float, begin_s: float) -> float:
        """Send a decision, and return about when it acts, on the bench's clock; nan if it was not acknowledged.

        The policy, whose phase began at begin_s, is told either.
        """
        acts_s = self._sender.apply(decision, now, degC)
        if math.isnan(acts_s):
            self.ticks.unacknowledged += 1
            self.folder.event(now - self._start_s, "unacknowledged", self._sender.why)
            if isinstance(policy, Predicts):
                policy.held(self.sent.current_A)
        elif isinstance(policy, Predicts):
            policy.acted(acts_s - self._start_s - begin_s)
        return acts_s

    def _note_status(self) -> None:
        """Note the controller's status at a trip."""
        try:
            status = status_of(self.bench.controller)
        except Disconnected as error:
            self.status_at_trip = f"the controller is gone: {error}"
        else:
            self.status_at_trip = "the controller does not answer" if status is None else status_in_words(status)
        self.folder.event(self.elapsed_s(), "status", f"controller: {self.status_at_trip}")

    def _read_both(self, next_due_s: float, period_s: float) -> tuple[Reading, Reading | None, tuple[float, float]]:
        """Read the temperature and fetch the meter's reading; return both, and its test current (A) and since when (s).

        If there is no time for it after the command, the meter's next reading is begun here.
        """
        asked_s = self.bench.clock.now_s()
        temperature, known_s = self._read_temperature(), self.bench.clock.now_s()
        self._readings.thermometer_took(known_s - asked_s)
        resistance = self._read_resistance()
        meter = self.bench.meter  # before the next reading is begun, in another range maybe
        current_A = meter.test_current_A if meter is not None else math.nan
        of_meter = (current_A, on_since_s(meter) - self._start_s)
        self._readings.begin_before_the_command(next_due_s)
        if self.bench.clock.now_s() - known_s > period_s:  # the meter was long about it: that one is of before
            temperature = self._read_temperature()
        return temperature, resistance, of_meter

    def _read_temperature(self) -> Reading:
        try:
            return self.bench.controller.read_temperature()
        except Disconnected:
            raise
        except InstrumentError as error:
            return self._no_reading("thermometer", "controller", error)

    def _read_resistance(self) -> Reading | None:
        try:
            reading = self._readings.fetch()
        except Disconnected:
            raise
        except InstrumentError as error:
            return self._no_reading("ohmmeter", "meter", error)
        if self.bench.meter is not None:
            check_test_current(self.limits, self.bench.clock.now_s(), self.bench.meter.test_current_A)
        return reading

    def _no_reading(self, name: str, role: str, error: InstrumentError) -> Reading:
        now = self.bench.clock.now_s()
        of_whom(error, self.bench.called.get(role, role))
        self.folder.event(now - self._start_s, "no_reading", f"{name}: {error}")
        return missing(now, f"{error}{fallen_silent(getattr(self.bench, role), now)}")

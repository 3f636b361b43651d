"""The bench process's main thread: holds the ports, reads the instruments while nothing runs, starts what waits.

The output is commanded off before anything else and after everything else. While the instruments are away it asks for
them again every few seconds, and arrives with the output off.
"""

from __future__ import annotations

import gc
import math
import signal
import threading
from collections.abc import Callable
from typing import NamedTuple

from rig.bench.assembly import Bench, open_bench
from rig.core.errors import Disconnected, InstrumentError, PortHeld, RigError
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff, Stopped
from rig.core.reading import Quality, Reading, missing
from rig.daemon.bench_state import no_job_because
from rig.daemon.desk import Desk
from rig.daemon.ended_before import OFF_CONTRADICTED
from rig.daemon.job_run import JobRun
from rig.daemon.row import row_of
from rig.daemon.systemd import EndTold, Notifier
from rig.daemon.worker import Worker
from rig.drivers.controller import TemperatureController, drive_unit
from rig.files.configuration import ConfigurationFile
from rig.guard.line import UNGUARDED, Guard, say_who_died
from rig.safety.signals import SignalStop
from rig.safety.switching_off import BY_ITS_DEAD_MAN, MARGIN_S, confirmed_by, looks_off

TRY_AGAIN_S = 3.0  # between attempts to open the ports
SILENT_TICKS = 5  # without any answer, before the ports are opened anew
CHECK_OUTPUT_TICKS = 10
CONTRADICTED = "the temperature contradicted its controller's 'off', and nobody has reset that"  # of the last line
JOB_ENDS_S = 10.0  # for a job's thread to notice that the gate is closed


class _Running(NamedTuple):
    """The job that runs. over: set when its thread has done with it."""

    job: JobRun
    over: threading.Event


class Keeper:
    """Keeps the bench until a signal ends it."""

    def __init__(self, file: ConfigurationFile, desk: Desk, notifier: Notifier, guard: Guard = UNGUARDED) -> None:
        self._file, self._desk, self._notifier, self._guard = file, desk, notifier, guard
        self._idling = threading.RLock()
        self._worker = Worker("job")
        self._running: _Running | None = None
        self._opened = False
        self._not_off: NotConfirmedOff | None = None  # how the bench was let go of last, where it had to be opened anew
        self._signals = SignalStop()
        self._ending = False

    def keep(self) -> None:
        """Hold the bench for ever. Raises Stopped on a signal, or NotConfirmedOff where the output is not known to be
        off then; PortHeld and Faults at the first opening."""
        desk = self._desk
        with EndTold(self._notifier, self._file.content.bench.controller.dead_man_s) as signals:
            self._signals = signals
            desk.writer.start()
            try:
                while True:
                    news = self._once()
                    self._see_whether_to_end()  # at once: what came while the output was switched off has waited
                    if news:
                        desk.enter_in_log(f"offline, tried again every {TRY_AGAIN_S:g} s: {desk.offline_because}")
                    self._wait_to_try_again()
                    self._see_whether_to_end()
            except Stopped as stopped:
                say_who_died(self._guard, stopped)
                if text := self._why_not_off():
                    raise NotConfirmedOff(text) from stopped
                raise
            finally:
                desk.online = False
                desk.close()

    def _why_not_off(self) -> str:
        """Why the output is not known to be off, with the controller's port in front; "" where it is."""
        if self._not_off is not None:
            return str(self._not_off)
        port = self._file.content.bench.controller.port
        return f"{port}: {CONTRADICTED}" if self._desk.contradicted else ""

    def end(self) -> None:
        """End as on SIGTERM, from another thread."""
        self._ending = True
        self._desk.wake.set()

    def _see_whether_to_end(self) -> None:
        """Raises Stopped: for a signal that came while the output was being switched off, or for `end`."""
        self._signals.expose()
        if self._ending:
            raise Stopped(signal.SIGTERM)

    def _once(self) -> bool:
        """Open the bench and keep it until it is lost; whether it was not known to be lost before."""
        desk = self._desk
        try:
            with open_bench(self._file, self._guard) as bench:
                self._opened, self._not_off = True, None
                self._attach(bench)
                try:  # from here on an end is known to the desk: a stop may come with the first word of being ready
                    self._notifier.ready("the bench is held, the output is off")
                    desk.changed()
                    self._hold(bench)
                except BaseException as error:
                    self._release(error)
                    raise
        except (PortHeld, Faults) as error:  # Faults: what has come back is another instrument
            if not self._opened:
                raise
            news = self._lost(error)
        except NotConfirmedOff as error:
            self._not_off = error
            desk.output_now("off", confirmed=False)
            news = self._lost(error)
            if isinstance(error.__cause__, Stopped):
                raise
        except RigError as error:
            news = self._lost(error)
        return news

    def _attach(self, bench: Bench) -> None:
        desk = self._desk
        desk.gate.attach(bench.controller)
        desk.identities = dict(bench.identities)
        desk.has_dead_man = bench.controller.has_dead_man
        desk.confirms_off_by, desk.drive_unit = confirmed_by(bench.controller), drive_unit(bench.controller)
        desk.output_now("off")  # the bench opens with it
        if desk.offline_because:
            desk.enter_in_log("the bench is held again, the output is off")
        desk.online, desk.offline_because = True, ""
        desk.live_by(bench.clock)

    def _release(self, error: BaseException) -> None:
        """The output off and the job over, before the ports are closed; signals wait meanwhile."""
        self._signals.shield()
        desk = self._desk
        off = desk.gate.stop(error)
        if not off.confirmed:
            desk.output_now("off", confirmed=False)
        if self._running is not None:
            if not self._running.over.wait(JOB_ENDS_S):
                self._worker.abandon()
                self._running.job.abandon(error, off.confirmed)
            self._running = None
        desk.gate.attach(None)

    def _lost(self, error: BaseException) -> bool:
        """Whether that is news: what was offline is offline still."""
        desk = self._desk
        news = desk.online or not desk.offline_because
        desk.online, desk.offline_because = False, str(error)
        desk.memory_since_s = None
        if news:
            desk.changed()
        return news

    def _hold(self, bench: Bench) -> None:
        """Tick after tick, until the bench is lost (RigError) or a signal comes (Stopped)."""
        desk, clock = self._desk, bench.clock
        period = self._file.content.serve.idle_period_s
        controller = desk.gate.controller_for_idling(bench.controller)
        dead_man_s = self._file.content.bench.controller.dead_man_s if controller.has_dead_man else 0.0
        idle = _Idle(bench, controller, desk, dead_man_s)
        due = clock.now_s()
        while True:
            self._see_whether_to_end()
            if self._jobs(bench, controller):
                due = clock.now_s()
            busy = desk.in_loop or (bench.virtual and self._running is not None)
            if clock.now_s() >= due:
                if not busy:
                    with self._idling:
                        if not desk.in_loop:
                            idle.tick(clock.now_s() - due)
                missed = int((clock.now_s() - due) / period)
                desk.ticks.missed += 0 if busy else missed
                due += (missed + 1) * period
            if clock.now_s() - desk.last_cycle_s < 2.0 * period + 1.0:
                self._notifier.cycle()
            if not bench.virtual:
                self._pause(due - clock.now_s())
            elif self._running is None:
                clock.sleep_until_s(due)
            else:
                self._pause(0.02)

    def _wait_to_try_again(self) -> None:
        desk = self._desk
        if desk.virtual:
            desk.clock.sleep_until_s(desk.clock.now_s() + TRY_AGAIN_S)
        else:
            self._pause(TRY_AGAIN_S)

    def _pause(self, seconds: float) -> None:
        """Sleep, or until somebody asks for something."""
        if self._desk.wake.wait(max(0.0, seconds)):
            self._desk.wake.clear()

    def _jobs(self, bench: Bench, controller: TemperatureController) -> bool:
        """See to the job that ended, and start the next where nothing is latched; whether one ended."""
        desk, ended = self._desk, self._running is not None
        if self._running is not None:
            if not self._running.over.is_set():
                return False
            self._running = None
            self._tidy()
            limits = self._file.content.limits
            dead_man_s = self._file.content.bench.controller.dead_man_s
            with self._idling:
                controller.configure(limits.current_A, limits.temperature_degC, dead_man_s)
        with desk.lock:
            if no_job_because(desk):
                return ended
            desk.gate.open()
            job = desk.queue.next()
        if job is not None:
            run = JobRun(desk, bench, job, self._idling)
            self._running = _Running(run, self._worker.begin(run.work))
        return ended

    def _tidy(self) -> None:
        """Collect what a job leaves in cycles, before it piles up: a collection of all objects is due only when a
        quarter of them is new. What is there after the first job is there for good and need not be looked at again."""
        gc.collect()
        if not gc.get_freeze_count():
            gc.freeze()


class _Idle:
    """Reading both instruments while nothing runs, and seeing that the output is off."""

    def __init__(self, bench: Bench, controller: TemperatureController, desk: Desk, dead_man_s: float) -> None:
        self._bench, self._controller, self._desk, self._dead_man_s = bench, controller, desk, dead_man_s
        self._silent = self._count = 0
        self._look_s: float | None = None  # when to look what silence has done

    def tick(self, late_s: float) -> None:
        """One control cycle. Raises Disconnected where the instruments are gone or silent."""
        desk, bench = self._desk, self._bench
        desk.ticks.latest_s = max(desk.ticks.latest_s, late_s)
        if self._look_s is not None and bench.clock.now_s() < self._look_s:
            return  # every question would feed the dead man of a controller that did not obey
        self._see_that_it_is_off()
        temperature = self._reading(self._controller.read_temperature)
        self._ask_the_temperature(temperature)
        resistance, test_current_A = None, math.nan
        if bench.meter is not None:
            resistance, test_current_A = self._reading(bench.meter.read), bench.meter.test_current_A
        self._silent = self._silent + 1 if temperature.quality is Quality.MISSING else 0
        if self._silent >= SILENT_TICKS:
            raise Disconnected(f"no answer of the controller in {self._silent} ticks")
        desk.row({**row_of(desk.label_s(), temperature, resistance, 0.0, test_current_A), "phase": "idle"})

    def _see_that_it_is_off(self) -> None:
        """Now and then, and until it is confirmed: at every tick, or after each silence for the dead man."""
        desk = self._desk
        self._count += 1
        if desk.confirmed:
            self._look_s = None  # somebody else's "off" was obeyed meanwhile
        if desk.confirmed and self._count % CHECK_OUTPUT_TICKS:
            return
        if desk.confirmed:
            try:
                if not self._controller.status().output_is_on:
                    return
            except Disconnected:
                raise
            except InstrumentError:
                return
            desk.note("the output was on though nothing ran, by somebody else's hand; it was switched off")
        confirmed = self._silence_did_it() or self._controller.off()
        self._look_s = None
        if not confirmed and self._dead_man_s > 0.0:
            self._look_s = self._bench.clock.now_s() + self._dead_man_s + MARGIN_S
        desk.output_now("off", confirmed)
        desk.changed()

    def _silence_did_it(self) -> bool:
        """Whether the controller's own dead man has switched the output off meanwhile."""
        if self._look_s is None or not looks_off(self._controller)[0]:
            return False
        self._desk.note(BY_ITS_DEAD_MAN)
        return True

    def _ask_the_temperature(self, temperature: Reading) -> None:
        """After a job: a temperature that keeps answering to the last current withdraws the confirmation."""
        desk, look = self._desk, self._desk.after_off
        if look is None:
            return
        look.take(self._bench.clock.now_s(), temperature.value if temperature.is_number else math.nan)
        if look.over:
            desk.after_off = None
        if look.agrees is False:
            desk.contradicted = True
            desk.output_now("off", confirmed=False)
            desk.trip(OFF_CONTRADICTED, look.text)

    def _reading(self, read: Callable[[], Reading]) -> Reading:
        try:
            return read()
        except Disconnected:
            raise
        except InstrumentError:
            return missing(self._bench.clock.now_s())

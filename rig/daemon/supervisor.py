"""The bench supervisor, main thread of the process that holds the ports: reads while idle, starts jobs, reconnects.

The output is commanded off before anything else and after everything else. While the instruments are away it tries to
open them again every few seconds, with the output off.
"""

from __future__ import annotations

import gc
import math
import signal
import threading
from collections.abc import Callable
from queue import SimpleQueue

from rig.bench.assembly import Bench, open_bench
from rig.config.configuration import ConfigurationFile
from rig.core.errors import Disconnected, InstrumentError, PortHeld, RigError
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff, Stopped
from rig.core.reading import Quality, Reading, missing
from rig.daemon.command_queue import CommandQueue, history_row
from rig.daemon.job_run import JobRun
from rig.daemon.latch import OFF_CONTRADICTED
from rig.daemon.systemd import Notifier, SignalStopWithNotice
from rig.drivers.controller import TemperatureController, drive_unit
from rig.guard.pipe import UNGUARDED, Guard, add_guard_death
from rig.safety.signals import SignalStop
from rig.safety.switching_off import BY_ITS_DEAD_MAN, MARGIN_S, command_off, confirmed_by, looks_off

TRY_AGAIN_S = 3.0  # between attempts to open the ports
SILENT_TICKS = 5  # without any answer, before the ports are opened again
CHECK_OUTPUT_TICKS = 10
JOB_ENDS_S = 10.0  # for a job's thread to notice that the output lock is closed
CONTRADICTED = "the temperature contradicted the controller's 'off', and nobody has reset that"


class Worker:
    """A thread that does one task after the other. It outlives its tasks: libraries cache data for each thread (fonts
    among it), which would grow with a thread for each task. name: of the thread."""

    def __init__(self, name: str) -> None:
        self._name = name
        self.renew()

    def begin(self, task: Callable[[], None]) -> None:
        """Do a task after those before it."""
        if not self._thread.is_alive():
            self.renew()
        self._tasks.put(task)

    def renew(self) -> None:
        """Take a new thread; a task that does not end is left to itself."""
        self._tasks: SimpleQueue[Callable[[], None]] = SimpleQueue()
        self._thread = threading.Thread(target=_work, args=(self._tasks,), name=self._name, daemon=True)
        self._thread.start()


def _work(tasks: SimpleQueue[Callable[[], None]]) -> None:
    while True:
        task = tasks.get()
        task()
        del task  # no reference to a task is kept while the next one is waited for


class Supervisor:
    """Keeps the bench until a signal ends it."""

    def __init__(
        self, file: ConfigurationFile, commands: CommandQueue, notifier: Notifier, guard: Guard = UNGUARDED
    ) -> None:
        self._file, self._commands, self._notifier, self._guard = file, commands, notifier, guard
        self._idle_lock = threading.RLock()
        self._worker = Worker("job")
        self._running: JobRun | None = None
        self._opened = False
        self._not_off: NotConfirmedOff | None = None  # of the last closing, if the bench was not opened since
        self._signals = SignalStop()
        self._ending = False

    def keep(self) -> None:
        """Hold the bench for ever. Raises Stopped on a signal, or NotConfirmedOff if the output is then not known to be
        off; PortHeld and Faults at the first opening."""
        commands = self._commands
        with SignalStopWithNotice(self._notifier, self._file.content.bench.controller.dead_man_s) as signals:
            self._signals = signals
            commands.writer.start()
            try:
                while True:
                    news = self._once()
                    self._raise_if_ending()  # at once: a signal that came while the output was switched off has waited
                    if news:
                        text = f"offline, tried again every {TRY_AGAIN_S:g} s: {commands.offline_because}"
                        commands.enter_in_log(text)
                    self._pause(TRY_AGAIN_S)
                    self._raise_if_ending()
            except Stopped as stopped:
                add_guard_death(self._guard, stopped)
                if text := self._why_not_off():
                    raise NotConfirmedOff(text) from stopped
                raise
            finally:
                commands.online = False
                commands.close()

    def _why_not_off(self) -> str:
        """Return why the output is not known to be off, after the controller's port; "" if it is off."""
        if self._not_off is not None:
            return str(self._not_off)
        port = self._file.content.bench.controller.port
        return f"{port}: {CONTRADICTED}" if self._commands.contradicted else ""

    def end(self) -> None:
        """End as on SIGTERM, from another thread."""
        self._ending = True
        self._commands.wake.set()

    def _raise_if_ending(self) -> None:
        """Raise Stopped for a signal that came while the output was being switched off, or for `end`."""
        self._signals.expose()
        if self._ending:
            raise Stopped(signal.SIGTERM)

    def _once(self) -> bool:
        """Open the bench and keep it until it is lost; True if it was not known to be lost before."""
        commands = self._commands
        try:
            with open_bench(self._file, self._guard) as bench:
                self._opened, self._not_off = True, None
                self._attach(bench)
                try:  # from here on the command queue hears of an end: a stop may come with the first word of READY
                    self._notifier.ready("the bench is held, the output is off")
                    commands.changed()
                    self._hold(bench)
                except BaseException as error:
                    self._release(error)
                    raise
        except (PortHeld, Faults) as error:  # Faults: another instrument has come back
            if not self._opened:
                raise
            return self._lost(error)
        except NotConfirmedOff as error:
            self._not_off = error
            commands.output_now("off", confirmed=False)
            news = self._lost(error)
            if isinstance(error.__cause__, Stopped):
                raise
            return news
        except RigError as error:
            return self._lost(error)
        return False

    def _attach(self, bench: Bench) -> None:
        commands = self._commands
        commands.output_lock.attach(bench.controller)
        commands.identities = dict(bench.identities)
        commands.has_dead_man = bench.controller.has_dead_man
        commands.confirms_off_by, commands.drive_unit = confirmed_by(bench.controller), drive_unit(bench.controller)
        commands.output_now("off")  # the bench opens with it
        if commands.offline_because:
            commands.enter_in_log("the bench is held again, the output is off")
        commands.online, commands.offline_because = True, ""
        commands.last_cycle_s = commands.clock.now_s()

    def _release(self, error: BaseException) -> None:
        """Switch the output off and end the job before the ports are closed; signals wait meanwhile."""
        self._signals.shield()
        commands = self._commands
        off = commands.output_lock.stop(error)
        if not off.confirmed:
            commands.output_now("off", confirmed=False)
        if self._running is not None:
            if not self._running.over.wait(JOB_ENDS_S):
                self._worker.renew()
                self._running.abandon(error, off.confirmed)
            self._running = None
        commands.output_lock.attach(None)

    def _lost(self, error: BaseException) -> bool:
        """Note that the bench is offline; True if it went offline just now."""
        commands = self._commands
        news = commands.online or not commands.offline_because
        commands.online, commands.offline_because = False, str(error)
        commands.memory_since_s = None
        if news:
            commands.changed()
        return news

    def _hold(self, bench: Bench) -> None:
        """Tick until the bench is lost (RigError) or a signal comes (Stopped)."""
        commands, clock = self._commands, bench.clock
        period = self._file.content.serve.idle_period_s
        controller = commands.output_lock.controller_when_idle(bench.controller)
        dead_man_s = self._file.content.bench.controller.dead_man_s if controller.has_dead_man else 0.0
        idle = _IdleLoop(bench, controller, commands, dead_man_s)
        due = clock.now_s()
        while True:
            self._raise_if_ending()
            if self._jobs(bench, controller):
                due = clock.now_s()
            busy = commands.in_loop
            if clock.now_s() >= due:
                if not busy:
                    with self._idle_lock:
                        if not commands.in_loop:
                            idle.tick(clock.now_s() - due)
                missed = int((clock.now_s() - due) / period)
                commands.ticks.missed += 0 if busy else missed
                due += (missed + 1) * period
            if clock.now_s() - commands.last_cycle_s < 2.0 * period + 1.0:
                self._notifier.cycle()
            self._pause(due - clock.now_s())

    def _pause(self, seconds: float) -> None:
        if self._commands.wake.wait(max(0.0, seconds)):
            self._commands.wake.clear()

    def _jobs(self, bench: Bench, controller: TemperatureController) -> bool:
        """Finish a job that has ended, and start the next unless something prevents it; True if one ended."""
        commands, ended = self._commands, self._running is not None
        if self._running is not None:
            if not self._running.over.is_set():
                return False
            self._running = None
            # Collect a job's reference cycles before they pile up: a full collection is due only when a quarter of all
            # objects is new. The objects after the first job stay for good and are not looked at again.
            gc.collect()
            if not gc.get_freeze_count():
                gc.freeze()
            limits = self._file.content.limits
            dead_man_s = self._file.content.bench.controller.dead_man_s
            with self._idle_lock:
                controller.configure(limits.current_A, limits.temperature_degC, dead_man_s)
        with commands.lock:
            if commands.no_job_because():
                return ended
            commands.output_lock.open()
            job = commands.queue.next()
        if job is not None:
            self._running = JobRun(commands, bench, job, self._idle_lock)
            self._worker.begin(self._running.work)
        return ended


class _IdleLoop:
    """Reads both instruments while nothing runs, and makes sure that the output is off."""

    def __init__(
        self, bench: Bench, controller: TemperatureController, commands: CommandQueue, dead_man_s: float
    ) -> None:
        self._bench, self._controller, self._commands = bench, controller, commands
        self._dead_man_s = dead_man_s
        self._silent = self._count = 0
        self._look_s: float | None = None  # when to look at the result of the silence

    def tick(self, late_s: float) -> None:
        """Do one control cycle. Raises Disconnected if the instruments are gone or silent."""
        commands, bench = self._commands, self._bench
        commands.ticks.latest_s = max(commands.ticks.latest_s, late_s)
        if self._look_s is not None and bench.clock.now_s() < self._look_s:
            return  # every frame would feed the dead man of a controller that did not obey
        self._ensure_off()
        temperature = self._reading(self._controller.read_temperature)
        self._check_temperature(temperature)
        resistance, test_current_A = None, math.nan
        if bench.meter is not None:
            resistance, test_current_A = self._reading(bench.meter.read), bench.meter.test_current_A
        self._silent = self._silent + 1 if temperature.quality is Quality.MISSING else 0
        if self._silent >= SILENT_TICKS:
            raise Disconnected(f"no answer of the controller in {self._silent} ticks")
        row = history_row(commands.label_s(), temperature, resistance, 0.0, test_current_A)
        commands.row({**row, "phase": "idle"})

    def _ensure_off(self) -> None:
        """Check the output from time to time; if not confirmed off, at every tick or after a dead man's silence."""
        commands = self._commands
        self._count += 1
        if commands.confirmed:
            self._look_s = None  # another "off" was obeyed meanwhile
        if commands.confirmed and self._count % CHECK_OUTPUT_TICKS:
            return
        if commands.confirmed:
            try:
                if not self._controller.status().output_is_on:
                    return
            except Disconnected:
                raise
            except InstrumentError:
                return
            commands.note("the output was on although nothing ran: not by this program; it is being switched off")
        confirmed = self._off_by_silence() or command_off(self._controller)[0]
        self._look_s = None
        if not confirmed and self._dead_man_s > 0.0:
            self._look_s = self._bench.clock.now_s() + self._dead_man_s + MARGIN_S
        commands.output_now("off", confirmed)
        commands.changed()

    def _off_by_silence(self) -> bool:
        """Return True if the controller's own dead man has switched the output off meanwhile."""
        if self._look_s is None or not looks_off(self._controller)[0]:
            return False
        self._commands.note(BY_ITS_DEAD_MAN)
        return True

    def _check_temperature(self, temperature: Reading) -> None:
        """Withdraw the confirmation of "off" if the temperature after a job goes on as with the last current."""
        commands, check = self._commands, self._commands.off_check
        if check is None:
            return
        check.add(self._bench.clock.now_s(), temperature.value if temperature.is_number else math.nan)
        if check.decided:
            commands.off_check = None
        if check.agrees is False:
            commands.contradicted = True
            commands.output_now("off", confirmed=False)
            commands.trip(OFF_CONTRADICTED, check.text)

    def _reading(self, read: Callable[[], Reading]) -> Reading:
        try:
            return read()
        except Disconnected:
            raise
        except InstrumentError:
            return missing(self._bench.clock.now_s())

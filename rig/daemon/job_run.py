"""One job on the bench, in the worker's thread: `peltier run` or `calibrate` on ports that are open, observed."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rig.bench.assembly import Bench
from rig.control.decision import Onlooker, Phases, Tick, Ticks
from rig.core.errors import RigError
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff, OfOutput, Stopped, Tripped, Unsuitable
from rig.daemon.client import CALIBRATION
from rig.daemon.command_queue import CommandQueue, Job, JobStopped, history_row, report_of
from rig.daemon.configurations import model_of
from rig.daemon.output_lock import JobPass, StoppableClock
from rig.experiment.calibration import Calibration
from rig.experiment.feasibility import expected_calibration, expected_run, still_to_come, target_and_model
from rig.experiment.run_record import Session
from rig.experiment.session import calibrate, run_on
from rig.records.run_folder import part_of, prepared_folder
from rig.report.run import write_live_report, write_missing_reports
from rig.safety.bench_watch import BenchWatch
from rig.safety.signals import SignalStop
from rig.safety.switching_off import UNTRUSTED_THERMOMETER, OffCheck

CONDITION = "condition"  # the phase of a run that drives the film to its hot end
LOOK_S = 30.0  # for which the temperature is compared after a job


@dataclass(frozen=True)
class _End:
    """End of a job: its state, reason and exit status; trip: the cause of a trip, None if it is none; trip_text: its
    text, if that says more than the reason."""

    state: str
    reason: str | None
    exit_status: int
    trip: str | None = None
    trip_text: str | None = None


def _end_by(error: BaseException) -> _End:
    if isinstance(error, JobStopped):
        return _End("stopped", str(error), error.exit_status)
    if isinstance(error, Stopped):
        return _End("stopped", f"the daemon was {error}", error.exit_status)
    if isinstance(error, Unsuitable):
        return _End("failed", str(error), error.exit_status)
    if isinstance(error, Tripped):
        return _End("tripped", str(error), error.exit_status, error.cause)
    if isinstance(error, NotConfirmedOff):
        return _End("tripped", str(error), error.exit_status, "not_confirmed_off")
    if isinstance(error, Faults):
        return _End("failed", "; ".join(error.lines), 2)
    if isinstance(error, RigError):
        return _End("failed", str(error), 1, type(error).__name__.lower(), f"the run lost an instrument: {error}")
    notes = [note for note in getattr(error, "__notes__", []) if not isinstance(note, OfOutput)]  # reported elsewhere
    return _End("failed", "; ".join([f"{type(error).__name__}: {error}", *notes]), 1, "program_fault")


def _is_folder(path: Path) -> bool:
    """Return True for a folder; a disk that fails keeps no job from ending."""
    try:
        return path.is_dir()
    except OSError:
        return False


class JobRun(Onlooker):
    """A job, the bench it runs on, and the lock that keeps the idle loop off it meanwhile. over: its thread has ended
    it."""

    def __init__(self, commands: CommandQueue, bench: Bench, job: Job, idle_lock: threading.RLock) -> None:
        self._commands, self._job, self._idle_lock = commands, job, idle_lock
        self._raw = bench
        lock = commands.output_lock
        self._pass = by = JobPass(lock)
        self._lock, self._concluded, self.over = threading.Lock(), False, threading.Event()
        clock = StoppableClock(bench.clock, lock, by)
        self._clock = clock
        self._bench = replace(
            bench,
            clock=clock,
            controller=lock.controller_for_job(bench.controller, by),
            meter=lock.meter_for_job(bench.meter, by) if bench.meter is not None else None,
            guard=lock.guard_for_job(bench.guard, by),
            watched_after=True,
        )
        self._conditioning = False
        self._coming: Phases = []
        self._last: tuple[BenchWatch, float] | None = None  # of the last tick: its watch, and the current

    def work(self) -> None:
        """Do the job from its begin to its end, whatever that is."""
        try:
            self._work()
        finally:
            self.over.set()

    def _work(self) -> None:
        commands, job = self._commands, self._job
        job.started_s, job.folder, job.began_s = commands.label_s(), part_of(job.out), commands.clock.now_s()
        commands.job_changed(job)
        commands.model = model_of(job.file) or commands.model
        try:
            self._do()
        except BaseException as error:
            self._conclude(_end_by(error))
        else:
            self._conclude(_End("done", None, 0))

    def abandon(self, why: BaseException, off_confirmed: bool) -> None:
        """End the job without its thread, which does not end: whatever that one does later has no effect."""
        with self._lock:  # a thread that begins its loop has done so before, or finds its pass void
            self._pass.off_confirmed, self._pass.void = off_confirmed, why
            self._leave_loop(off_confirmed)
        self._conclude(_end_by(why))

    def _leave_loop(self, off_confirmed: bool) -> None:
        commands = self._commands
        if commands.in_loop:
            commands.in_loop, self._job.phase = False, None
            commands.output_now("off", off_confirmed)

    def _do(self) -> None:
        """Do the job's work; the model of its calibration is the bench's from then on."""
        job, file = self._job, self._job.file
        if lines := file.strangers(self._raw.identities):  # the bench may have come back as another one
            raise Faults(lines)
        self._configure(file.content)
        session = Session(self._bench, file, SignalStop(), self._say, self, write_live_report)
        calibration: Calibration | None
        if job.kind == CALIBRATION:
            self._expect(expected_calibration(file.content))
            with prepared_folder(job.out):
                calibration = calibrate(session, job.out)
            job.folder, job.result = calibration.model_path.parent, calibration.document()
        else:
            target, model = target_and_model(file, self._say)
            self._expect(expected_run(file.content, target, model))
            with prepared_folder(job.out):
                result = run_on(session, job.out, target, model)
            job.folder, job.result, calibration = result.folder, result.document(), result.calibration
        if calibration is not None and self._pass.void is None:
            self._commands.model = calibration.model_path

    def _conclude(self, end: _End) -> None:
        """End the job, once: its trip, if it is one, is on disk before anybody hears of the end."""
        with self._lock:
            if self._concluded:
                return
            self._concluded = True
        commands, job = self._commands, self._job
        if end.trip == "not_confirmed_off":
            commands.output_now("off", confirmed=False)
        # still in its loop: the end could not be written down; but the output is off, or the error would say so
        self._leave_loop(end.exit_status != NotConfirmedOff.exit_status)
        commands.ticks.latest_s = max(commands.ticks.latest_s, self._clock.latest_s)
        if end.trip is not None:
            commands.trip(end.trip, end.trip_text or end.reason or end.trip)
            if end.trip in UNTRUSTED_THERMOMETER:
                commands.off_check = None
        not_off = end.exit_status == NotConfirmedOff.exit_status  # then nobody waits for a report
        if end.exit_status != 0 and not not_off:
            self._write_reports()
        if end.state != "done":
            job.folder = part_of(job.out) if _is_folder(part_of(job.out)) else None
        job.report = report_of(job.id, str(job.folder) if job.folder is not None else None)
        job.reason, job.exit_status = end.reason, end.exit_status
        job.state, job.ended_s = end.state, commands.label_s()  # last: who asks meanwhile sees a whole end, or none
        commands.queue.keep(job)
        commands.job_changed(job)
        commands.wake.set()
        if not_off:
            self._write_reports()
            commands.look_for_report(job.table())
        self._bench.guard.records("")

    def _write_reports(self) -> None:
        part = part_of(self._job.out)
        if self._pass.void is None and _is_folder(part):
            write_missing_reports(part)

    def _configure(self, content: Any) -> None:
        """Set the job's limits and integration time; the output stays off."""
        dead_man_s = content.bench.controller.dead_man_s  # at most the bench's: see rig.daemon.configurations
        with self._idle_lock:
            self._bench.controller.configure(content.limits.current_A, content.limits.temperature_degC, dead_man_s)
            table = content.bench.meter
            if self._bench.meter is not None and table is not None:
                self._bench.meter.configure(table.four_wire, table.nplc, content.limits.meter_current_A)

    def _say(self, text: str) -> None:
        if self._pass.void is not None:
            return
        self._job.messages.append(text)
        self._commands.announcer.announce("say", {"id": self._job.id, "text": text})

    # -- reports of the run --------------------------------------------------------------------------------------

    def began(self) -> None:
        """Note that a loop has the bench; the idle loop releases it."""
        with self._idle_lock, self._lock:
            self._pass.check_void()
            self._commands.in_loop = True
            self._commands.output_now("on")
        self._commands.changed()

    def _expect(self, phases: Phases) -> None:
        """Set the phases to come, each with its seconds."""
        self._pass.check_void()
        self._coming = phases
        self._job.coming_s = sum(seconds for _, seconds in phases)

    def phase(self, name: str, done_s: float, of_s: float) -> None:
        """Note the beginning of a phase.

        With the first one after `condition`, which may come in parts, the film's memory is known: the conditioning has
        ended, at its hot end.
        """
        if done_s > 0.0:
            return
        commands = self._commands
        if self._conditioning and name != CONDITION and commands.memory_since_s is None:
            commands.memory_since_s = commands.label_s()
        self._conditioning = name == CONDITION
        self._expect(still_to_come(self._coming, name))
        self._job.phase = (name, commands.clock.now_s(), of_s)
        commands.changed()

    def tick(self, tick: Tick) -> None:
        """Write a completed control cycle into the history, with the time of day in place of the run's."""
        self._pass.check_void()
        commands, decision = self._commands, tick.decision
        self._last = (tick.watch, tick.current_A)
        current_A = 0.0 if decision.done else tick.current_A
        commands.ticks.latest_s = max(commands.ticks.latest_s, self._clock.latest_s)
        columns = ("setpoint_degC", "reference_degC", "target_ohm", "predicted_ohm")
        commands.row(
            {
                **history_row(commands.label_s(), tick.temperature, tick.resistance, current_A, tick.test_current_A),
                **{name: getattr(decision, name) for name in columns},
                "phase": tick.phase,
                "job": self._job.id,
            }
        )

    def ended(self, off_confirmed: bool, ticks: Ticks) -> None:
        """Note that the loop is over and the output was commanded off; ticks: how punctual it was."""
        commands = self._commands
        if self._pass.void is not None:
            return
        commands.output_now("off", off_confirmed)
        if off_confirmed and self._last is not None:
            watch, current_A = self._last
            curves = watch.after_off(current_A, LOOK_S)
            commands.off_check = OffCheck(curves, self._bench.clock.now_s()) if curves is not None else None
        commands.ticks.missed += ticks.missed
        commands.ticks.unwatched_s = max(commands.ticks.unwatched_s, ticks.unwatched_s)
        commands.in_loop, self._job.phase = False, None
        commands.changed()

"""One job on the bench, in the worker's thread: what `peltier run` does, watched."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from rig.bench.assembly import Bench
from rig.bench.serial_numbers import strangers
from rig.control.tick import Tick
from rig.core.errors import RigError
from rig.core.faults import Faults
from rig.core.outcome import NotConfirmedOff, OfOutput, Stopped, Tripped, Unsuitable
from rig.daemon.client import CALIBRATION
from rig.daemon.configured_paths import model_of
from rig.daemon.desk import Desk
from rig.daemon.experiment import Watcher, calibrate_watched, run_watched
from rig.daemon.gate import Pass, StoppableClock
from rig.daemon.job import Job, JobStopped, report_of
from rig.daemon.row import row_of
from rig.experiment.calibration import Calibration
from rig.experiment.expected import Phases, still_to_come
from rig.experiment.summaries import calibration_summary, summary
from rig.records.run_folder import part_of
from rig.safety.after_off import NO_VOICE, AfterOff
from rig.safety.bench_watch import BenchWatch

CONDITION = "condition"  # the phase of a run that drives the film to its hot end
LOOK_S = 30.0  # that the temperature is looked at after a job


@dataclass(frozen=True)
class _End:
    """How a job ended: its state, why, its exit status; trip: the cause of a trip, None where it is none.

    trip_text: what the trip says, where that is more than the job's reason.
    """

    state: str
    reason: str | None
    exit_status: int
    trip: str | None = None
    trip_text: str | None = None


def _end_by(error: BaseException) -> _End:
    """How a job ends that something ended."""
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
    beside = [note for note in getattr(error, "__notes__", []) if not isinstance(note, OfOutput)]  # told elsewhere
    return _End("failed", "; ".join([f"{type(error).__name__}: {error}", *beside]), 1, "program_fault")


def _is_folder(path: Path) -> bool:
    """Whether it is there; a disk that fails keeps no job from ending."""
    try:
        return path.is_dir()
    except OSError:
        return False


class JobRun(Watcher):
    """A job, the bench it runs on, and the lock that keeps the idle loop off it meanwhile."""

    def __init__(self, desk: Desk, bench: Bench, job: Job, idling: threading.RLock) -> None:
        self._desk, self._job, self._idling = desk, job, idling
        self._raw = bench
        self._pass = by = Pass(desk.gate)
        self._lock, self._over = threading.Lock(), False
        clock = StoppableClock(bench.clock, desk.gate, by, not bench.virtual)
        self._clock = clock
        self._bench = replace(
            bench,
            clock=clock,
            controller=desk.gate.controller_for_jobs(bench.controller, by),
            meter=desk.gate.meter_for_jobs(bench.meter, by) if bench.meter is not None else None,
            guard=desk.gate.guard_for_jobs(bench.guard, by),
            watched_after=True,
        )
        self._conditioning = False
        self._coming: Phases = []
        self._last: tuple[BenchWatch, float] | None = None  # of the last tick: what watches, and the current

    def work(self) -> None:
        """The job from its beginning to its end, whatever that is."""
        desk, job = self._desk, self._job
        job.state, job.started_s, job.folder = "running", desk.label_s(), part_of(job.out)
        desk.job_began_s, desk.coming_s = desk.clock.now_s(), 0.0
        desk.job_changed(job)
        desk.model = model_of(job.file) or desk.model
        try:
            self._do()
        except BaseException as error:
            self._conclude(_end_by(error))
        else:
            self._conclude(_End("done", None, 0))

    def abandon(self, why: BaseException, off_confirmed: bool) -> None:
        """End the job without its thread, which does not end: what that one still does is nobody's any more."""
        desk = self._desk
        with self._lock:  # a thread that begins its loop has done so before, or finds its pass void
            self._pass.off_confirmed, self._pass.void = off_confirmed, why
            if desk.in_loop:
                desk.in_loop, desk.phase = False, None
                desk.output_now("off", off_confirmed)
        self._conclude(_end_by(why))

    def _do(self) -> None:
        """The job's work; its calibration's model is the bench's from then on."""
        if lines := strangers(self._job.file, self._raw.identities):  # the bench may have come back as another one
            raise Faults(lines)
        self._configure(self._job.file.content)
        calibration = self._done()
        if calibration is not None and self._pass.void is None:
            self._desk.model = calibration.model_path

    def _done(self) -> Calibration | None:
        """The job's work to its end: its calibration, where it made one."""
        job = self._job
        if job.kind == CALIBRATION:
            calibration = calibrate_watched(self._bench, job.file, job.out, self._say, self)
            job.folder, job.result = calibration.model_path.parent, calibration_summary(calibration)
            return calibration
        result = run_watched(self._bench, job.file, job.out, self._say, self)
        job.folder, job.result = result.folder, summary(result)
        return result.calibration

    def _conclude(self, end: _End) -> None:
        """The trip, if it was one, before anybody is told how the job ended: it is on disk first. A job ends once."""
        with self._lock:
            if self._over:
                return
            self._over = True
        desk, job = self._desk, self._job
        if end.trip == "not_confirmed_off":
            desk.output_now("off", confirmed=False)
        if desk.in_loop:  # its end could not be written down; but the output is off, or that would have been told
            desk.in_loop, desk.phase = False, None
            desk.output_now("off", end.exit_status != NotConfirmedOff.exit_status)
        desk.ticks.latest_s = max(desk.ticks.latest_s, self._clock.latest_s)
        if end.trip is not None:
            desk.trip(end.trip, end.trip_text or end.reason or end.trip)
            if end.trip in NO_VOICE:
                desk.after_off = None
        told_first = end.exit_status == NotConfirmedOff.exit_status  # nobody waits for a report with the heater on
        if end.exit_status != 0 and not told_first:
            self._report()
        job.state, job.reason, job.exit_status = end.state, end.reason, end.exit_status
        job.ended_s = desk.label_s()
        if end.state != "done":
            job.folder = part_of(job.out) if _is_folder(part_of(job.out)) else None
        job.report = report_of(job.id, str(job.folder) if job.folder is not None else None)
        desk.queue.keep(job)
        desk.job_changed(job)
        desk.wake.set()
        if told_first:
            self._report()
            desk.look_for_report(job.table())
        self._bench.guard.records("")

    def _report(self) -> None:
        """The reports of what was recorded until it ended early."""
        part = part_of(self._job.out)
        if self._pass.void is None and _is_folder(part):
            from rig.report.run import write_missing_reports

            write_missing_reports(part)

    def _configure(self, content: Any) -> None:
        """The job's limits and integration time; the output stays off."""
        dead_man_s = content.bench.controller.dead_man_s  # no longer than the bench's: see rig.daemon.admission
        with self._idling:
            self._bench.controller.configure(content.limits.current_A, content.limits.temperature_degC, dead_man_s)
            table = content.bench.meter
            if self._bench.meter is not None and table is not None:
                self._bench.meter.configure(table.four_wire, table.nplc, content.limits.meter_current_A)

    def _say(self, text: str) -> None:
        if self._pass.void is not None:
            return
        self._job.said.append(text)
        self._desk.announcer.tell("say", {"id": self._job.id, "text": text})

    # -- told by the run -----------------------------------------------------------------------------------------

    def began(self) -> None:
        """The idle loop lets go of the bench."""
        with self._idling, self._lock:
            self._pass.check_void()
            self._desk.in_loop = True
            self._desk.output_now("on")
        self._desk.changed()

    def expect(self, phases: Phases) -> None:
        """The phases to come."""
        self._pass.check_void()
        self._coming = phases
        self._desk.coming_s = sum(seconds for _, seconds in phases)

    def phase(self, name: str, duration_s: float) -> None:
        """A phase begins. With the first that follows `condition`, which may come in parts, the film's memory is known:
        the conditioning has ended, at its hot end."""
        desk = self._desk
        if self._conditioning and name != CONDITION and desk.memory_since_s is None:
            desk.memory_since_s = desk.label_s()
        self._conditioning = name == CONDITION
        self.expect(still_to_come(self._coming, name))
        desk.phase = (name, desk.clock.now_s(), duration_s)
        desk.changed()

    def tick(self, tick: Tick) -> None:
        """To the history, with the time of day in place of the run's."""
        self._pass.check_void()
        desk, decision = self._desk, tick.decision
        self._last = (tick.watch, tick.current_A)
        current_A = 0.0 if decision.done else tick.current_A
        desk.ticks.latest_s = max(desk.ticks.latest_s, self._clock.latest_s)
        desk.row(
            {
                **row_of(desk.label_s(), tick.temperature, tick.resistance, current_A, tick.test_current_A),
                "setpoint_degC": decision.setpoint_degC,
                "reference_degC": decision.reference_degC,
                "target_ohm": decision.target_ohm,
                "predicted_ohm": decision.predicted_ohm,
                "phase": tick.phase,
                "job": self._job.id,
            }
        )

    def ended(self, confirmed: bool | None, ticks: Mapping[str, Any]) -> None:
        """The bench belongs to the idle loop again."""
        desk = self._desk
        if self._pass.void is not None:
            return
        desk.output_now("off", bool(confirmed))
        if confirmed and self._last is not None:
            watch, current_A = self._last
            courses = watch.after_off(current_A, LOOK_S)
            desk.after_off = AfterOff(courses, self._bench.clock.now_s()) if courses is not None else None
        desk.ticks.missed += int(ticks.get("missed", 0))
        desk.ticks.unwatched_s = max(desk.ticks.unwatched_s, float(ticks.get("unwatched_s", 0.0)))
        desk.in_loop, desk.phase = False, None
        desk.changed()

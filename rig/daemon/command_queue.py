"""The command queue: commands to the bench, its jobs, latch and history, between its threads and everybody else.

Its methods may be called from any thread, and none but `stop` and `cancel` waits for an instrument.
A job is an experiment that was submitted.
"""

from __future__ import annotations

import math
import secrets
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal

from rig.config.configuration import ConfigurationFile
from rig.control.decision import Ticks
from rig.core.clock import RealClock
from rig.core.errors import PortHeld
from rig.core.faults import Faults
from rig.core.outcome import Outcome, Tripped
from rig.core.reading import Identity, Quality, Reading
from rig.daemon.announcer import Announcer, post_webhook
from rig.daemon.configurations import admit, history_folder, model_of
from rig.daemon.latch import LATCH, OFF_CONTRADICTED, STOPPED, Latch, LatchStore, latch_at_start, tripped
from rig.daemon.output_lock import Off, OutputLock
from rig.daemon.status_text import job_in_words, span
from rig.guard.stale_run import draw_missing_reports, why_not_confirmed_off
from rig.history.store import Retention, Store
from rig.history.writer import Writer
from rig.records.run_folder import check_free, default_folder
from rig.safety.switching_off import OffCheck
from rig.version import __version__

KEPT = 200  # ended jobs in the list
FOLLOWED = 8  # of them with all messages and results, which are large
MOST_QUEUED = 100
WAITING, RUNNING, TAKEN_OUT = "queued", "running", "stopped"


class JobStopped(Outcome):
    """Somebody stopped the job; the output is off."""

    exit_status = 1
    cause = "stopped"


@dataclass
class Job:
    """One experiment. Times are Unix seconds, but began_s and those of the phase the clock's.

    report: its address on the page. phase: name, begin and duration (s). coming_s: expected duration of later phases.
    """

    id: str
    name: str
    kind: str
    file: ConfigurationFile
    out: Path
    queued_s: float
    state: str = WAITING
    started_s: float | None = None
    ended_s: float | None = None
    reason: str | None = None
    folder: Path | None = None
    report: str | None = None
    exit_status: int | None = None
    result: dict[str, Any] | None = None
    messages: list[str] = field(default_factory=list)
    began_s: float = 0.0
    phase: tuple[str, float, float] | None = None
    coming_s: float = 0.0

    def table(self) -> dict[str, Any]:
        """Return the job as JSON. Reads no disk: the loop's thread calls it, too."""
        names = ("id", "name", "kind", "state", "queued_s", "started_s", "ended_s", "reason")
        folder = str(self.folder) if self.folder is not None else None
        table = {name: getattr(self, name) for name in names}
        return {**table, "folder": folder, "report": self.report, "exit_status": self.exit_status}

    def progress(self, now_s: float) -> dict[str, Any]:
        """Return how far the job is at the clock's now_s."""
        phase, begin_s, total_s = self.phase or ("working", now_s, 0.0)
        done_s = min(now_s - begin_s, total_s)
        return {
            "id": self.id,
            "name": self.name,
            "kind": self.kind,
            "phase": phase,
            "done_s": done_s,
            "total_s": total_s,
            "elapsed_s": now_s - self.began_s,
            "to_go_s": total_s - done_s + self.coming_s,
        }


def report_of(number: str, folder: str | None) -> str | None:
    """Return the page's address of the report in a job's folder; None if there is none yet."""
    try:
        there = folder is not None and (Path(folder) / "report.html").is_file()
    except OSError:  # a folder that does not answer
        return None
    return f"/runs/{number}/report.html" if there else None


class JobQueue:
    """Jobs that wait, the one that runs, and the last that ended; safe for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._jobs: dict[str, Job] = {}  # in the order of their submission; the last that ended among them
        self._ended: dict[str, dict[str, Any]] = {}  # as JSON, in the order of their ends
        self.running: Job | None = None

    def _waiting(self) -> list[Job]:
        return [job for job in self._jobs.values() if job.state == WAITING]

    def __len__(self) -> int:
        with self._lock:
            return len(self._waiting())

    def add(self, job: Job) -> bool:
        """Append a job; False if too many wait."""
        with self._lock:
            if len(self._waiting()) >= MOST_QUEUED:
                return False
            self._jobs[job.id] = job
            return True

    def remember(self, ended: list[dict[str, Any]]) -> None:
        """Add jobs that ended before this start, the oldest first."""
        with self._lock:
            every = [*ended, *self._ended.values()][-KEPT:]
            self._ended = {job["id"]: job for job in every}

    def next(self) -> Job | None:
        """Return the job that is to begin now; None if none waits, or one runs."""
        with self._lock:
            if self.running is None and (waiting := self._waiting()):
                self.running = waiting[0]
                self.running.state = RUNNING
                return self.running
            return None

    def take_out(self, number: str | None = None) -> list[Job]:
        """Take the job of this number out if it waits; without a number all that wait."""
        with self._lock:
            taken = [job for job in self._waiting() if number in (None, job.id)]
            for job in taken:
                job.state = TAKEN_OUT
            return taken

    def find(self, number: str) -> Job | None:
        """Return a job that waits, runs, or was among the last that ended."""
        return self._jobs.get(number)

    def keep(self, job: Job) -> None:
        """Move a job to those that ended."""
        with self._lock:
            if self.running is job:
                self.running = None
            self._ended[job.id] = job.table()
            while len(self._ended) > KEPT:
                del self._ended[next(iter(self._ended))]
            for number in [number for number in self._jobs if number in self._ended][:-FOLLOWED]:
                del self._jobs[number]

    def reported(self, number: str, report: str) -> dict[str, Any] | None:
        """Note that an ended job has a report by now, and return it; None if that is known, or there is no such job."""
        with self._lock:
            table = self._ended.get(number)
            if table is None or table.get("report"):
                return None
            self._ended[number] = {**table, "report": report}
            return self._ended[number]

    def tables(self) -> list[dict[str, Any]]:
        """Return all jobs, the newest first: those that wait, the one that runs, those that ended."""
        with self._lock:
            running = [self.running] if self.running is not None else []
            return [job.table() for job in [*self._waiting()[::-1], *running]] + [*self._ended.values()][::-1]

    def last_ended(self) -> dict[str, Any] | None:
        """Return the job that ended last; None if none has."""
        with self._lock:
            return next(reversed(self._ended.values()), None)


HISTORY = "history.sqlite"
ENDED = "the daemon ended; nothing resumes by itself"
SHOWN = ("time_s", "temperature_degC", "setpoint_degC", "current_A", "resistance_ohm", "target_ohm", "quality")
RECENT_ROWS, NOTES = 200, 10  # kept in memory: for a trip's rows and the page; warnings


class Gaps:
    """Counts the gaps between completed control cycles since `begin_s`, by a clock that does not jump."""

    def __init__(self, begin_s: float) -> None:
        self._last_s = begin_s
        self._count, self._longest_s, self._total_s = 0, 0.0, 0.0

    def cycle(self, now_s: float, longest_s: float) -> None:
        """Take a completed cycle; more than longest_s since the one before is a gap."""
        between_s, self._last_s = now_s - self._last_s, now_s
        if between_s > longest_s:
            self._count += 1
            self._total_s += between_s
            self._longest_s = max(self._longest_s, between_s)

    def table(self) -> dict[str, Any]:
        return {"count": self._count, "longest_s": self._longest_s, "total_s": self._total_s}


class CommandQueue:
    """State of the bench, jobs, latch and history.

    take_folder: locks the bench's folder for this process, or raises PortHeld or OSError. log: takes a line for people.
    """

    def __init__(
        self,
        file: ConfigurationFile,
        notes: list[str],
        take_folder: Callable[[], None] = lambda: None,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        serve = file.content.serve
        self.file, self.clock = file, RealClock()
        self.folder = history_folder(file)
        self.configurations = file.beside(serve.configurations)
        self.announcer = Announcer()
        self.output_lock = OutputLock(self.clock.now_s)
        self.notes = list(notes)
        self.queue = JobQueue()
        self._take_folder, self._log = take_folder, log
        self.recent: deque[dict[str, Any]] = deque(maxlen=RECENT_ROWS)
        self.wake = threading.Event()
        self.ticks = Ticks()
        self.output: Literal["on", "off", "unknown"] = "unknown"  # one word: no thread sees half of a change
        self.off_check: OffCheck | None = None  # of the temperature, after a job
        self._not_off: str | None = None  # the guard's text for the job that ran when the daemon's process died
        self.online, self.offline_because = False, ""
        self.in_loop = False
        self.memory_since_s: float | None = None
        self.model = model_of(file)
        self.identities: dict[str, Identity] = {}
        self.has_dead_man = False
        self.confirms_off_by: str | None = None  # the evidence of the controller's "off"
        self.drive_unit = "A"
        self.stop_port: int | None = None  # of STOP's own listener
        self.began_s = self.last_cycle_s = self.clock.now_s()
        self.gaps = Gaps(self.began_s)
        self.live: dict[str, Any] = {}
        self.lock = threading.RLock()
        self.had_history = False  # was opened: the jobs before this start are known
        history_was_there = any(self.folder.glob(f"{HISTORY}*"))  # one that was put aside counts as well
        callbacks = self._published, self._history_failed, self._clock_jumped, self._after_rows, self._history_reports
        self.writer = Writer(self.folder / HISTORY, self._open_history, *callbacks)
        found = latch_at_start(self.folder / LATCH, history_was_there, self.label_s())
        self.latch_store = LatchStore(self.folder / LATCH, found, self.label_s())
        self.writer.open()
        self._latch_not_off()
        # True: the temperature has contradicted an "off"; none is believed until a reset
        self.contradicted = self.latch is not None and self.latch.cause == OFF_CONTRADICTED

    @property
    def latch(self) -> Latch | None:
        """Return the latch that keeps jobs from starting until a reset; None if there is none."""
        return self.latch_store.held

    def label_s(self) -> float:
        """Return Unix seconds: a label, never a basis of control."""
        return time.time()

    # -- history -------------------------------------------------------------------------------------------------

    def _open_history(self) -> Store:
        """Open the history, but no new one before the latch is on disk. Raises sqlite3.Error or OSError."""
        if not self.had_history and (trouble := self.latch_store.trouble()) is not None:
            raise OSError(trouble)
        try:
            self._take_folder()
        except PortHeld as error:
            raise OSError(str(error)) from None
        serve, was_there = self.file.content.serve, (self.folder / HISTORY).exists()
        store = Store(self.folder / HISTORY, Retention(serve.raw_days, serve.minute_days, serve.hour_days))
        ours = self.queue.tables()[::-1]  # if the history is begun again, or has come back, while the daemon runs
        try:
            before, unfinished = self._jobs_before(store, {job["id"] for job in ours})
            self.queue.remember(before)
            for job in ours:
                store.save_job(job)
        except BaseException:
            store.close()
            raise
        threading.Thread(target=self._find_reports, args=(before, unfinished), name="reports", daemon=True).start()
        if self.had_history and not was_there:
            self.note(f"history: {store.path} was moved or deleted while the daemon ran; a new one was begun")
        self.had_history = True
        if store.damage:
            self.notes = [*self.notes, store.damage]
        return store

    def _jobs_before(self, store: Store, ours: set[str]) -> tuple[list[dict[str, Any]], list[str]]:
        """Return the jobs before this start, and the folders of those that the daemon's end has stopped."""
        unfinished: list[str] = []
        jobs = [job for job in store.jobs() if job["id"] not in ours]
        for job in jobs:
            if job["state"] in ("queued", "running"):
                self._not_off = self._not_off or why_not_confirmed_off(job["folder"])
                unfinished += [job["folder"]] if job["folder"] is not None else []
                job |= {"state": "stopped", "ended_s": self.label_s(), "reason": ENDED}
                store.save_job(job)
        return jobs, unfinished

    def _find_reports(self, jobs: list[dict[str, Any]], unfinished: list[str]) -> None:
        """Find reports that were written since, and draw missing ones; in a thread, because disks may hang."""
        for job in jobs:
            self.look_for_report(job)
        if unfinished:
            draw_missing_reports(unfinished)
            for job in jobs:
                self.look_for_report(job)

    def look_for_report(self, job: dict[str, Any]) -> None:
        """Save and announce that an ended job has a report by now; reads the disk."""
        report = report_of(job["id"], job["folder"]) if not job.get("report") else None
        if report is not None and (table := self.queue.reported(job["id"], report)) is not None:
            self.writer.do(lambda store: store.save_job(table))
            self.announcer.announce("job", table)

    def _published(self, row: dict[str, Any]) -> None:
        """Take a row that was committed, or has to wait for that (writer's thread)."""
        self.recent.append(row)
        latch = self.latch_store.reported
        if latch is not None and latch.state != STOPPED and latch.add_row(row):
            self.writer.do(lambda store: self._save_trip(store, latch))
        self.announcer.announce("row", row)

    def _after_rows(self, store: Store) -> None:
        """Save the trip that rows follow; latch a late finding (writer's thread)."""
        latch = self.latch_store.reported
        if latch is not None and latch.state != STOPPED and latch.number is None:
            self._save_trip(store, latch)  # it came from the latch's file, or the history had no room for it
        if self._not_off is not None:
            self.contradicted = True
            self.output_now("off", confirmed=False)
            self._latch_not_off()

    def _latch_not_off(self) -> None:
        """Latch an output that the guard could not confirm off when the daemon's process died."""
        if self._not_off is not None:
            self.latch_store.hold(tripped(OFF_CONTRADICTED, self._not_off, self.label_s(), self.recent))
            self.latch_store.save()
        self._not_off = None

    def _save_trip(self, store: Store, latch: Latch) -> None:
        """Save a trip with its rows, new or changed (writer's thread)."""
        last = store.last_trip() if latch.number is None else None
        if last is not None and last[1].get("at_s") == latch.at_s:
            latch.recall(*last)
        latch.number = store.save_trip(latch.document(), latch.number)

    def _clock_jumped(self, seconds: float) -> None:
        """Report a jump of the time of day (writer's thread)."""
        by = f"{'forward' if seconds > 0.0 else 'back'} by {span(abs(seconds))}"
        now = self._time_of_day()
        self.note(f"the time of day jumped {by}, it is now {now}; nothing is deleted for that; check the clock")

    def _history_failed(self, text: str) -> None:
        """Switch the output off, then report; write the latch again, which lies beside it (writer's thread)."""
        text = f"the history cannot be written: {text}"
        if self.in_loop:
            self.output_lock.stop(Tripped("history", text, self.clock.now_s()))
        else:
            self.enter_in_log(text)
        self.latch_store.save_again()
        self.changed()

    def _history_reports(self, line: str, stays: bool) -> None:
        """Report a line about the history (writer's thread)."""
        if stays:
            self.note(line)
        else:
            self.enter_in_log(line)
            self.changed()

    def close(self) -> None:
        """Write everything to disk, or report what is missing."""
        if lacks := self.writer.stop():
            self.enter_in_log(f"{lacks}; run folders are in {self.folder}")
        self.latch_store.close()
        self.announcer.close()

    # -- events on the bench -------------------------------------------------------------------------------------

    @property
    def confirmed(self) -> bool:
        return self.output != "unknown"

    def output_now(self, word: Literal["on", "off"], confirmed: bool = True) -> None:
        """Set the state of the output, and whether the controller confirmed it. An "off" is not believed after the
        temperature has contradicted one, until a reset."""
        believed = confirmed and not (word == "off" and self.contradicted)
        self.output = word if believed else "unknown"

    def row(self, row: dict[str, Any]) -> None:
        """Take the row of a completed control cycle: into the history, and published when it is committed there."""
        self.ticks.done += 1
        now_s = self.last_cycle_s = self.clock.now_s()
        self.gaps.cycle(now_s, self._longest_between_s())
        self.live = row
        self.writer.row(row, now_s)

    def _longest_between_s(self) -> float:
        """Return the time between two cycles beyond which there is a gap: of the idle loop, or of the job's own."""
        job, period_s = self.queue.running, self.file.content.serve.idle_period_s
        if job is not None:
            period_s = max(period_s, job.file.content.experiment.period_s)
        return 2.0 * period_s + 1.0

    def trip(self, cause: str, text: str) -> None:
        """Latch a trip with the rows around it, report it once it is on disk, hold the queue."""
        latch = tripped(cause, text, self.label_s(), self.recent)
        with self.lock:
            if not self.latch_store.hold(latch):
                return
        self.latch_store.save()
        self.writer.do(lambda store: self._save_trip(store, latch))
        self.enter_in_log(f"TRIPPED, {cause}: {text}")
        self.announcer.announce("trip", latch.table())
        self.changed()
        serve = self.file.content.serve
        if serve.webhook is not None:
            document = {"event": "trip", "name": serve.name, **latch.table(), "output": self.output}
            post_webhook(serve.webhook.get_secret_value(), document, self.note)

    def note(self, text: str) -> None:
        """Add a warning; the last ten stay."""
        self.notes = [*[note for note in self.notes if note != text], text][-NOTES:]
        self._log(text)
        self.changed()

    def enter_in_log(self, text: str) -> None:
        self._log(f"{self._time_of_day()} {text}")

    def _time_of_day(self) -> str:
        return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.label_s()))

    def job_changed(self, job: Job) -> None:
        table = job.table()
        self.writer.do(lambda store: store.save_job(table))
        self.enter_in_log(job_in_words(table))
        self.announcer.announce("job", table)
        self.changed()

    def changed(self) -> None:
        self.announcer.announce("state", self.state())

    # -- commands ------------------------------------------------------------------------------------------------

    def stop(self, by: str) -> Off:
        """Switch the output off at once, end the running job, take the waiting ones out of the queue, and begin none
        until a reset. A job that was submitted before the stop begins only when it is submitted again."""
        with self.lock:  # first, so that no job starts in between; nothing before "off" touches a disk
            self.latch_store.hold(Latch(STOPPED, "stop", f"stopped by {by}", self.label_s()))
        off = self._switched_off(JobStopped(f"stopped by {by}"))
        waited = self.queue.take_out()
        self.latch_store.save()
        reason = f"it waited when the bench was stopped by {by}: submit it again after `peltier reset`"
        for job in waited:
            self._taken_out(job, reason)
        result = f"output off, confirmed in {1e3 * off.took_s:.0f} ms" if off.confirmed else "OUTPUT NOT CONFIRMED OFF"
        self.enter_in_log(f"STOP by {by}: {result}; {len(waited)} jobs that waited are out of the queue")
        self.wake.set()
        self.changed()
        return off

    def _switched_off(self, why: JobStopped) -> Off:
        off = self.output_lock.stop(why)
        self.output_now("off", off.confirmed)
        return off

    def reset(self, reason: str) -> bool:
        """Clear the latch, on disk first; False if nothing is latched. Raises NotCleared if it stays latched."""
        latch = self.latch_store.clear(reason, self.label_s())
        if latch is None:
            return False
        latch.cleared_s, latch.cleared_because = self.label_s(), reason
        self.contradicted = False
        if latch.state != STOPPED:
            self.writer.do(lambda store: self._save_trip(store, latch))
        self.enter_in_log(f"reset: {reason}")
        self.wake.set()
        self.changed()
        return True

    def submit(
        self, file: ConfigurationFile, name: str | None = None, out: Path | None = None, kind: str | None = None
    ) -> Job:
        """Put an experiment (kind "calibration": its calibration) into the queue. Raises Faults."""
        admit(file, self.file, self.identities)
        e = file.content.experiment
        if out is not None:
            check_free(out)
        folder = out if out is not None else default_folder(kind or e.name, self.folder)
        number = secrets.token_hex(4)
        job = Job(number, name or kind or e.name, kind or e.kind, file, folder, self.label_s())
        job.began_s = self.clock.now_s()
        with self.lock:  # so that nobody hears of its beginning before
            if not self.queue.add(job):
                raise Faults(["queue: full; expected fewer waiting jobs"])
            self.job_changed(job)
        self.wake.set()
        return job

    def cancel(self, number: str, by: str) -> Job | None:
        """Take a job out of the queue, or end it if it runs; None if there is no such job."""
        for job in self.queue.take_out(number):
            self._taken_out(job, f"taken out of the queue by {by}")
            return job
        with self.lock:  # no other job starts in between
            running = self.queue.running
            if running is None or running.id != number:
                return None
            self._switched_off(JobStopped(f"ended by {by}"))
        self.wake.set()
        return running

    def _taken_out(self, job: Job, reason: str) -> None:
        job.reason, job.ended_s = reason, self.label_s()
        job.exit_status = JobStopped.exit_status
        self.queue.keep(job)
        self.job_changed(job)

    # -- state ---------------------------------------------------------------------------------------------------

    def is_idle(self) -> bool:
        """Return True if nothing runs, and nothing is about to."""
        return self.queue.running is None and (len(self.queue) == 0 or bool(self.no_job_because()))

    def no_job_because(self) -> list[str]:
        """Return the reasons that keep the next job from starting; none if it may."""
        held, reported, trouble = self.latch_store.held, self.latch_store.reported, self.latch_store.trouble()
        found = []
        if reported is not None:
            found.append(f"{reported.state}: {reported.text}")
        elif held is not None:
            found.append("a stop or a trip is being written to disk")
        if trouble is not None:
            found.append(f"the latch cannot be written: {trouble}")
        if self.writer.failure is not None:
            found.append(f"the history cannot be written: {self.writer.failure}")
        elif not self.had_history and self.writer.trouble is not None:
            found.append(f"the history cannot be read yet: {self.writer.trouble.text}")
        if (not_off := self._not_off) is not None:  # and is latched soon
            found.append(f"an earlier job ended with its output not confirmed off: {not_off}")
        if not self.confirmed:
            found.append("the output is not confirmed off")
        return found

    def warnings(self) -> list[str]:
        found = list(self.notes)
        if (trouble := self.latch_store.trouble()) is not None:
            found.append(f"the latch cannot be written, no job starts: {trouble}")
        if not self.online and self.offline_because:
            found.append(f"offline: {self.offline_because}")
        if (why := self.writer.delay()) is not None:
            what = "has to wait" if self.writer.failure is None else "cannot be written, no job starts"
            found.append(f"the history {what}: {why}")
        if self.online and not self.has_dead_man:
            found.append("the controller has no dead man of its own")
        return found

    def state(self) -> dict[str, Any]:
        """Return the bench at this moment (docs/bench_api.md)."""
        limits, latch = self.file.content.limits, self.latch_store.reported
        job = self.queue.running  # once: it may end meanwhile, and the word and the job have to agree
        word = latch.state if latch is not None else "running" if job is not None else "idle"
        if not self.online:
            word = "offline" if word in ("idle", "running") else word
        waits = self.writer.trouble is not None and self.writer.delay() is not None
        row = self.live if waits or not self.recent else self.recent[-1]
        reading = {name: row.get(name) for name in SHOWN}
        if waits:
            reading["quality"] = "not recorded" if self.writer.failure is not None else "not recorded yet"
        now_s = self.clock.now_s()
        return {
            "time_s": self.label_s(),
            "version": __version__,
            "name": self.file.content.serve.name,
            "uptime_s": now_s - self.began_s,
            "state": word,
            "output": self.output,
            "output_confirmed": self.confirmed,
            "output_confirmed_by": self.confirms_off_by if self.output == "off" else None,
            "trip": latch.table() if latch is not None and latch.state != STOPPED else None,
            "stop": latch.table() if latch is not None and latch.state == STOPPED else None,
            "job": job.progress(now_s) if job is not None else None,
            "last_job": self.queue.last_ended(),
            "queue": len(self.queue),
            "no_job_because": self.no_job_because(),
            "reading": reading,
            "limits": {"temperature_degC": list(limits.temperature_degC), "current_A": limits.current_A},
            "drive_unit": self.drive_unit,
            "dead_man_s": self.file.content.bench.controller.dead_man_s if self.has_dead_man else None,
            "instruments": {role: str(identity) for role, identity in self.identities.items()},
            "ticks": {name: getattr(self.ticks, name) for name in ("done", "missed", "latest_s", "unwatched_s")},
            "gaps": self.gaps.table(),
            "memory_known": self.memory_since_s is not None,
            "viewers": 0,
            "stop_port": self.stop_port,
            "warnings": self.warnings(),
            "cycle_age_s": now_s - self.last_cycle_s,
        }


def history_row(
    time_s: float, temperature: Reading, resistance: Reading | None, current_A: float, test_current_A: float
) -> dict[str, Any]:
    """Return the columns that every row has; nan if there is nothing to show, inf for a resistance beyond the range."""
    counts = resistance is not None and (resistance.is_number or resistance.quality is Quality.OVERRANGE)
    quality = "good"
    for reading in (temperature, resistance):
        if reading is not None and not reading.is_number:
            quality = "overrange" if reading.quality is Quality.OVERRANGE else str(reading.quality.value)
            break
    return {
        "time_s": time_s,
        "temperature_degC": temperature.value if temperature.is_number else math.nan,
        "resistance_ohm": resistance.value if counts and resistance is not None else math.nan,
        "current_A": current_A,
        "meter_current_A": test_current_A,
        "quality": quality,
    }

"""What the bench shows and what it is told: the desk between the bench's threads and everybody else.

Its methods may be called from any thread and never wait for an instrument, but for `stop`.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from rig.config.configuration import ConfigurationFile
from rig.control.tick import Ticks
from rig.core.clock import Clock
from rig.core.errors import PortHeld
from rig.core.faults import Faults
from rig.core.outcome import Tripped
from rig.daemon.admission import admit
from rig.daemon.announce import Announcer
from rig.daemon.bench_state import bench_state, no_job_because
from rig.daemon.configured_paths import history_folder, model_of
from rig.daemon.ended_before import OFF_CONTRADICTED, not_confirmed_off, report_left_behind
from rig.daemon.gaps import Gaps
from rig.daemon.gate import Gate, Off
from rig.daemon.job import Job, JobStopped, Queue, new_id, report_of
from rig.daemon.latch import STOPPED, Latch, tripped
from rig.daemon.latch_file import LATCH
from rig.daemon.latch_found import found_at_start
from rig.daemon.latching import Latching
from rig.daemon.webhook import post
from rig.daemon.words import job_in_words, span
from rig.drivers.identity import Identity
from rig.history.store import Retention, Store
from rig.history.writer import Writer
from rig.records.run_folder import check_free, default_folder
from rig.safety.after_off import AfterOff

HISTORY = "history.sqlite"
ENDED = "the daemon ended; nothing resumes by itself"


class Desk:
    """The bench's state, its queue, its latch and its history.

    take_folder: makes the bench's folder this process's own, or raises PortHeld or OSError; log: where a line for
    people goes beside the warnings.
    """

    def __init__(
        self,
        file: ConfigurationFile,
        clock: Clock,
        notes: list[str],
        take_folder: Callable[[], None] = lambda: None,
        log: Callable[[str], None] = lambda line: None,
    ) -> None:
        serve = file.content.serve
        self.file, self.clock = file, clock
        self.folder = history_folder(file)
        self.configurations = file.beside(serve.configurations)
        self.virtual = file.content.virtual_time
        self._epoch_s = time.time() - clock.now_s()  # of simulated time alone
        self.announcer = Announcer()
        self.gate = Gate(clock.now_s if not self.virtual else time.monotonic)
        self.notes = list(notes)
        self.queue = Queue()
        self._take_folder, self._log = take_folder, log
        self.recent: deque[dict[str, Any]] = deque(maxlen=200)
        self.wake = threading.Event()
        self.ticks = Ticks()
        self.output: Literal["on", "off", "unknown"] = "unknown"  # one word: no thread sees half of a change
        self.after_off: AfterOff | None = None  # what the temperature says of an output that went off
        self.not_off: str | None = None  # what the guard wrote of the job that ran when the daemon's process died
        self.online = False
        self.offline_because = ""
        self.in_loop = False
        self.memory_since_s: float | None = None
        self.model = model_of(file)
        self.identities: dict[str, Identity] = {}
        self.has_dead_man = False
        self.confirms_off_by: str | None = None  # what the controller's "off" rests on
        self.drive_unit = "A"
        self.stop_port: int | None = None  # of STOP's own listener
        self.phase: tuple[str, float, float] | None = None  # name, began (clock's s), lasts s
        self.job_began_s = clock.now_s()
        self.coming_s = 0.0  # that the job's phases after this one are expected to last
        self.last_cycle_s = clock.now_s()
        self.gaps = Gaps(self.steady_s())
        self.began_s = self.steady_s()
        self.live: dict[str, Any] = {}
        self.lock = threading.RLock()
        self.had_history = False  # was opened: what it says of the jobs of before is known
        history = self.folder / HISTORY
        was_there = any(self.folder.glob(f"{HISTORY}*"))  # one that was put aside is one, too
        told = self._shown, self._history_failed, self._clock_jumped, self._keep_beside, self._history_says
        self.writer = Writer(history, self._open_history, *told)
        self.writer.open()
        found = found_at_start(self.folder / LATCH, was_there, self.writer.store, self.label_s())
        self.latching = Latching(self.folder / LATCH, *found)
        self._hold_not_off()
        # whether the temperature says that the output is not off: nobody is believed until a reset
        self.contradicted = self.latch is not None and self.latch.cause == OFF_CONTRADICTED

    @property
    def latch(self) -> Latch | None:
        """What keeps jobs from starting until a reset."""
        return self.latching.held

    def label_s(self) -> float:
        """Unix seconds now: a label, never a basis of control."""
        return self._epoch_s + self.clock.now_s() if self.virtual else time.time()

    def steady_s(self) -> float:
        """Seconds of a clock that never jumps, by which time spans are measured; it begins anywhere."""
        return self._epoch_s + self.clock.now_s() if self.virtual else self.clock.now_s()

    def live_by(self, clock: Clock) -> None:
        """The clock of a bench that was opened; simulated time goes on where it was."""
        label_s = self.label_s()
        self.clock = clock
        self._epoch_s = label_s - clock.now_s()
        self.last_cycle_s = clock.now_s()

    def _open_history(self) -> Store:
        """Raises sqlite3.Error or OSError where there is no room for it."""
        try:
            self._take_folder()
        except PortHeld as error:
            raise OSError(str(error)) from None
        serve, was_there = self.file.content.serve, (self.folder / HISTORY).exists()
        store = Store(self.folder / HISTORY, Retention(serve.raw_days, serve.minute_days, serve.hour_days))
        ours = self.queue.tables()[::-1]  # where it is begun anew, or has come back, while the daemon runs
        try:
            before, left = self._jobs_of_before(store, {job["id"] for job in ours})
            self.queue.remember(before)
            for job in ours:
                store.save_job(job)
        except BaseException:
            store.close()
            raise
        threading.Thread(target=self._reports_of_before, args=(before, left), name="reports", daemon=True).start()
        if self.had_history and not was_there:
            self.note(f"history: {store.path} was moved or deleted while the daemon ran; a new one was begun")
        self.had_history = True
        if store.damage:
            self.notes = [*self.notes, store.damage]
        return store

    def _jobs_of_before(self, store: Store, ours: set[str]) -> tuple[list[dict[str, Any]], list[str]]:
        """Those that are not ours. What waited or ran when the daemon ended does not go on: the folders of these."""
        left: list[str] = []
        jobs = [job for job in store.jobs() if job["id"] not in ours]
        for job in jobs:
            if job["state"] in ("queued", "running"):
                self.not_off = self.not_off or not_confirmed_off(job["folder"])
                left += [job["folder"]] if job["folder"] is not None else []
                job |= {"state": "stopped", "ended_s": self.label_s(), "reason": ENDED}
                store.save_job(job)
        return jobs, left

    def _reports_of_before(self, jobs: list[dict[str, Any]], left: list[str]) -> None:
        """In a thread of its own, as disks may hang: what was written since the daemon ended, and what nobody wrote."""
        for job in jobs:
            self.look_for_report(job)
        if left:
            report_left_behind(left)
            for job in jobs:
                self.look_for_report(job)

    def look_for_report(self, job: dict[str, Any]) -> None:
        """Keep and tell that an ended job has a report by now; asks the disk."""
        report = report_of(job["id"], job["folder"]) if not job.get("report") else None
        if report is not None and (table := self.queue.reported(job["id"], report)) is not None:
            self.writer.do(lambda store: store.save_job(table))
            self.announcer.tell("job", table)

    # -- what happens on the bench -------------------------------------------------------------------------------

    @property
    def confirmed(self) -> bool:
        """Whether it is known what the output does."""
        return self.output != "unknown"

    def output_now(self, word: Literal["on", "off"], confirmed: bool = True) -> None:
        """What the controller was told to do with the output, and whether it confirmed that. An "off" that the
        temperature has contradicted is not believed until a reset."""
        believed = confirmed and not (word == "off" and self.contradicted)
        self.output = word if believed else "unknown"

    def row(self, row: dict[str, Any]) -> None:
        """A completed control cycle: to the history, and published when it is committed there."""
        now_s = self.steady_s()
        self.ticks.done += 1
        self.last_cycle_s = self.clock.now_s()
        self.gaps.cycle(now_s, self._longest_between_s())
        self.live = row
        self.writer.row(row, now_s)

    def _longest_between_s(self) -> float:
        """Between two cycles that belong together: of the idle loop, or of the job's own."""
        job, period_s = self.queue.running, self.file.content.serve.idle_period_s
        if job is not None:
            period_s = max(period_s, job.file.content.experiment.period_s)
        return 2.0 * period_s + 1.0

    def _shown(self, row: dict[str, Any]) -> None:
        """In the writer's thread: a row that was committed, or waits for that."""
        self.recent.append(row)
        latch = self.latching.told
        if latch is not None and latch.state != STOPPED and latch.take(row):
            self.writer.do(lambda store: self._save_trip(store, latch))
        self.announcer.tell("row", row)

    def _keep_beside(self, store: Store) -> None:
        """In the writer's thread: with rows go the trip that they follow, and, once, that the latch has a file of its
        own; and what is found of jobs only when a history can be opened at last."""
        if not store.has_latch and self.latching.on_disk:
            store.mark_latch()
        latch = self.latching.told
        if latch is not None and latch.state != STOPPED and latch.number is None:
            self._save_trip(store, latch)  # it came from the latch's file, or the history had no room for it
        if self.not_off is not None:
            self.contradicted = True
            self.output_now("off", confirmed=False)
            self._hold_not_off()

    def _hold_not_off(self) -> None:
        """Latch what the guard wrote of a job that ran when the daemon's process died, where it was not known off."""
        if self.not_off is not None:
            self.latching.hold(tripped(OFF_CONTRADICTED, self.not_off, self.label_s(), self.recent))
            self.latching.keep()
        self.not_off = None

    def _save_trip(self, store: Store, latch: Latch) -> None:
        """In the writer's thread: the trip with its rows, new or as it has become."""
        last = store.last_trip() if latch.number is None else None
        if last is not None and last[1].get("at_s") == latch.at_s:
            latch.recall(*last)
        latch.number = store.save_trip(latch.document(), latch.number)

    def _clock_jumped(self, seconds: float) -> None:
        """In the writer's thread."""
        by = f"{'forward' if seconds > 0.0 else 'back'} by {span(abs(seconds))}"
        now = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(self.label_s()))
        self.note(f"the time of day jumped {by}, it is now {now}; nothing is deleted for that; check the clock")

    def _history_failed(self, text: str) -> None:
        """In the writer's thread: the output off first, then told. What is latched is written again: it lies beside."""
        text = f"the history cannot be written: {text}"
        if self.in_loop:
            self.gate.stop(Tripped("history", text, self.clock.now_s()))
        else:
            self.enter_in_log(text)
        self.latching.keep_again()
        self.changed()

    def _history_says(self, line: str, stays: bool) -> None:
        """In the writer's thread."""
        if stays:
            self.note(line)
        else:
            self.enter_in_log(line)
            self.changed()

    def close(self) -> None:
        """The end: what was said and measured is on disk, or it is told that it is not."""
        if lacks := self.writer.stop():
            self.enter_in_log(f"{lacks}; run folders are in {self.folder}")
        self.latching.close()
        self.announcer.close()

    def trip(self, cause: str, text: str) -> None:
        """Latch a trip with the rows around it, tell everybody once it is on disk, hold the queue."""
        latch = tripped(cause, text, self.label_s(), self.recent)
        with self.lock:
            if not self.latching.hold(latch):
                return
        self.latching.keep()
        self.writer.do(lambda store: self._save_trip(store, latch))
        self.enter_in_log(f"TRIPPED, {cause}: {text}")
        self.announcer.tell("trip", latch.table())
        self.changed()
        webhook = self.file.content.serve.webhook
        if webhook is not None:
            told = {"name": self.file.content.serve.name, **latch.table(), "output": self.output}
            post(webhook.get_secret_value(), {"event": "trip", **told}, self.note)

    def note(self, text: str) -> None:
        """Something that people should know, among the warnings; the last ten stay."""
        self.notes = [*[note for note in self.notes if note != text], text][-10:]
        self._log(text)
        self.changed()

    def enter_in_log(self, text: str) -> None:
        """To the log, with the time of day."""
        self._log(f"{time.strftime('%Y-%m-%d %H:%M:%S', time.localtime(self.label_s()))} {text}")

    def job_changed(self, job: Job) -> None:
        """Keep, tell and log what became of a job."""
        table = job.table()
        self.writer.do(lambda store: store.save_job(table))
        self.enter_in_log(job_in_words(table))
        self.announcer.tell("job", table)
        self.changed()

    def changed(self) -> None:
        """Tell the state."""
        self.announcer.tell("state", self.state())

    # -- what people ask for -------------------------------------------------------------------------------------

    def stop(self, by: str) -> Off:
        """Switch the output off at once, end the running job, take those that wait out of the queue, and begin none
        until a reset. What was asked for before the stop begins only when somebody asks for it again."""
        with self.lock:  # first, so that no job starts in between; nothing before "off" asks a disk
            self.latching.hold(Latch(STOPPED, "stop", f"stopped by {by}", self.label_s()))
        off = self._switched_off(JobStopped(f"stopped by {by}"))
        waited = self.queue.take_waiting()
        self.latching.keep()
        reason = f"it waited when the bench was stopped by {by}: ask for it again after `peltier reset`"
        for job in waited:
            self._taken_out(job, reason)
        said = f"output off, confirmed in {1e3 * off.took_s:.0f} ms" if off.confirmed else "OUTPUT NOT CONFIRMED OFF"
        self.enter_in_log(f"STOP by {by}: {said}; {len(waited)} jobs that waited are out of the queue")
        self.wake.set()
        self.changed()
        return off

    def _switched_off(self, why: JobStopped) -> Off:
        off = self.gate.stop(why)
        self.output_now("off", off.confirmed)
        return off

    def reset(self, reason: str) -> bool:
        """Clear what is latched, on disk first; False where nothing is. Raises NotCleared where it stays latched."""
        latch = self.latching.clear(reason, self.label_s())
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
        """Put an experiment into the queue, or, with a kind of "calibration", its calibration. Raises Faults."""
        admit(file, self.file, self.identities)
        e = file.content.experiment
        if out is not None:
            check_free(out)
        folder = out if out is not None else default_folder(kind or e.name, self.folder)
        job = Job(new_id(), name or kind or e.name, kind or e.kind, file, folder, self.label_s())
        if not self.queue.add(job):
            raise Faults(["queue: full; expected fewer jobs that wait"])
        self.job_changed(job)
        self.wake.set()
        return job

    def cancel(self, number: str, by: str) -> Job | None:
        """Take a job out of the queue, or end it when it runs; None where there is no such job."""
        job = self.queue.remove(number)
        if job is not None:
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
        """End a job that waited."""
        job.state, job.reason, job.ended_s = "stopped", reason, self.label_s()
        job.exit_status = JobStopped.exit_status
        self.queue.keep(job)
        self.job_changed(job)

    # -- what people see -----------------------------------------------------------------------------------------

    def state(self) -> dict[str, Any]:
        """The bench at this moment (docs/bench_api.md)."""
        return bench_state(self)

    def is_idle(self) -> bool:
        """Whether nothing runs, and nothing is about to."""
        return self.queue.running is None and (len(self.queue) == 0 or bool(no_job_because(self)))

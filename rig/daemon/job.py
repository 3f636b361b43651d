"""A job, an experiment that was submitted, and the queue of jobs."""

from __future__ import annotations

import secrets
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.config.configuration import ConfigurationFile
from rig.core.outcome import Outcome

KEPT = 200  # ended jobs in the list
FOLLOWED = 8  # of them with all messages and results, which are large
MOST_QUEUED = 100
WAITING, RUNNING = "queued", "running"


class JobStopped(Outcome):
    """Somebody stopped the job; the output is off."""

    exit_status = 1
    cause = "stopped"


@dataclass
class Job:
    """One experiment. Times are Unix seconds; report: its address on the page."""

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

    def table(self) -> dict[str, Any]:
        """Return the job as JSON. Reads no disk: the loop's thread calls it, too."""
        names = ("id", "name", "kind", "state", "queued_s", "started_s", "ended_s", "reason")
        folder = str(self.folder) if self.folder is not None else None
        table = {name: getattr(self, name) for name in names}
        return {**table, "folder": folder, "report": self.report, "exit_status": self.exit_status}


def report_of(number: str, folder: str | None) -> str | None:
    """Return the page's address of the report in a job's folder; None if there is none yet."""
    try:
        there = folder is not None and (Path(folder) / "report.html").is_file()
    except OSError:  # a folder that does not answer
        return None
    return f"/runs/{number}/report.html" if there else None


def new_id() -> str:
    """Return a new job's id."""
    return secrets.token_hex(4)


class JobQueue:
    """Jobs that wait, the one that runs, and the last that ended; safe for any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._waiting: list[Job] = []
        self._ended: list[dict[str, Any]] = []
        self._known: dict[str, Job] = {}
        self._followed: list[str] = []
        self.running: Job | None = None

    def __len__(self) -> int:
        return len(self._waiting)

    def add(self, job: Job) -> bool:
        """Append a job; False if too many wait."""
        with self._lock:
            if len(self._waiting) >= MOST_QUEUED:
                return False
            self._waiting.append(job)
            self._known[job.id] = job
            return True

    def remember(self, ended: list[dict[str, Any]]) -> None:
        """Add jobs that ended before this start, the oldest first."""
        with self._lock:
            self._ended = [*ended, *self._ended][-KEPT:]

    def next(self) -> Job | None:
        """Take the job that is to begin now; None if none waits, or one runs."""
        with self._lock:
            if self.running is not None or not self._waiting:
                return None
            self.running = self._waiting.pop(0)
            return self.running

    def remove(self, number: str) -> Job | None:
        """Take a waiting job out; None if it does not wait."""
        with self._lock:
            for k, job in enumerate(self._waiting):
                if job.id == number:
                    return self._waiting.pop(k)
        return None

    def take_waiting(self) -> list[Job]:
        """Take all waiting jobs out, the oldest first."""
        with self._lock:
            waited, self._waiting = self._waiting, []
            return waited

    def find(self, number: str) -> Job | None:
        """Return a job that waits, runs, or was among the last that ended."""
        return self._known.get(number)

    def keep(self, job: Job) -> None:
        """Keep a job that has ended."""
        with self._lock:
            if self.running is job:
                self.running = None
            self._ended = [*self._ended, job.table()][-KEPT:]
            self._followed.append(job.id)
            while len(self._followed) > FOLLOWED:
                self._known.pop(self._followed.pop(0), None)

    def reported(self, number: str, report: str) -> dict[str, Any] | None:
        """Note that an ended job has a report by now, and return it; None if that is known, or there is no such job."""
        with self._lock:
            for k, table in enumerate(self._ended):
                if table["id"] == number and not table.get("report"):
                    self._ended[k] = {**table, "report": report}
                    return self._ended[k]
        return None

    def tables(self) -> list[dict[str, Any]]:
        """Return all jobs, the newest first: those that wait, the one that runs, those that ended."""
        with self._lock:
            running = [self.running] if self.running is not None else []
            return [job.table() for job in [*self._waiting[::-1], *running]] + self._ended[::-1]

    def last_ended(self) -> dict[str, Any] | None:
        """Return the job that ended last; None if none has."""
        with self._lock:
            return self._ended[-1] if self._ended else None

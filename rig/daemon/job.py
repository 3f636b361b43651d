"""A job: an experiment that somebody asked for, and what became of it; the queue of those that wait."""

from __future__ import annotations

import secrets
import threading
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rig.config.configuration import ConfigurationFile
from rig.core.outcome import Outcome

KEPT = 200  # ended jobs that are told of
FOLLOWED = 8  # of them with all that they said and gave, which is much
MOST_QUEUED = 100
WAITING, RUNNING = "queued", "running"


class JobStopped(Outcome):
    """Somebody stopped the job; the output is off."""

    exit_status = 1
    cause = "stopped"


@dataclass
class Job:
    """One experiment. Times are Unix seconds."""

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
    report: str | None = None  # where the page has it
    exit_status: int | None = None
    result: dict[str, Any] | None = None
    said: list[str] = field(default_factory=list)

    def table(self) -> dict[str, Any]:
        """As others see it. No disk is asked: the loop's thread tells this, too."""
        return {
            "id": self.id,
            "name": self.name,
            "kind": self.kind,
            "state": self.state,
            "queued_s": self.queued_s,
            "started_s": self.started_s,
            "ended_s": self.ended_s,
            "reason": self.reason,
            "folder": str(self.folder) if self.folder is not None else None,
            "report": self.report,
            "exit_status": self.exit_status,
        }


def report_of(number: str, folder: str | None) -> str | None:
    """Where the page has the report of a job's folder; None where there is none yet."""
    try:
        there = folder is not None and (Path(folder) / "report.html").is_file()
    except OSError:  # a folder that does not answer
        return None
    return f"/runs/{number}/report.html" if there else None


def new_id() -> str:
    """A name for a job that is in no other's way."""
    return secrets.token_hex(4)


class Queue:
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
        """Put a job at the end; False where too many wait."""
        with self._lock:
            if len(self._waiting) >= MOST_QUEUED:
                return False
            self._waiting.append(job)
            self._known[job.id] = job
            return True

    def remember(self, ended: list[dict[str, Any]]) -> None:
        """Jobs of before, the oldest first."""
        with self._lock:
            self._ended = [*ended, *self._ended][-KEPT:]

    def next(self) -> Job | None:
        """The job that is to begin now, taken out of the queue; None where none waits, or one runs."""
        with self._lock:
            if self.running is not None or not self._waiting:
                return None
            self.running = self._waiting.pop(0)
            return self.running

    def remove(self, number: str) -> Job | None:
        """A waiting job, taken out."""
        with self._lock:
            for k, job in enumerate(self._waiting):
                if job.id == number:
                    return self._waiting.pop(k)
        return None

    def take_waiting(self) -> list[Job]:
        """All that wait, taken out, the oldest first."""
        with self._lock:
            waited, self._waiting = self._waiting, []
            return waited

    def find(self, number: str) -> Job | None:
        """A job that waits, runs, or was among the last that ended."""
        return self._known.get(number)

    def keep(self, job: Job) -> None:
        """A job that has ended."""
        with self._lock:
            if self.running is job:
                self.running = None
            self._ended = [*self._ended, job.table()][-KEPT:]
            self._followed.append(job.id)
            while len(self._followed) > FOLLOWED:
                self._known.pop(self._followed.pop(0), None)

    def reported(self, number: str, report: str) -> dict[str, Any] | None:
        """An ended job whose report was written since, as it is now; None where that is known, or there is none."""
        with self._lock:
            for k, table in enumerate(self._ended):
                if table["id"] == number and not table.get("report"):
                    self._ended[k] = {**table, "report": report}
                    return self._ended[k]
        return None

    def tables(self) -> list[dict[str, Any]]:
        """All of them, the newest first: those that wait, the one that runs, those that ended."""
        with self._lock:
            running = [self.running] if self.running is not None else []
            return [job.table() for job in [*self._waiting[::-1], *running]] + self._ended[::-1]

    def last_ended(self) -> dict[str, Any] | None:
        """The job that ended last; None where none has."""
        with self._lock:
            return self._ended[-1] if self._ended else None

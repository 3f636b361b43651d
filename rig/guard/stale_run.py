"""The run folder of a process that died: the guard writes its end, others read it, and its report is drawn.

A run folder whose run.json has a `stop`, or that is gone, is left alone; a full disk changes nothing. Import-light.
"""

from __future__ import annotations

import contextlib
import datetime
import json
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.core.file_writing import replacing

DIED = "process_died"  # the reason of a stop that the guard wrote
REPORT_S = 60.0  # loading what draws takes some seconds on a small computer, drawing hours of rows some more
LOOK_AGAIN_S = 0.2  # for the guard's entry


def write_end(folder: str, text: str, confirmed: bool) -> bool:
    """Write why a run ended, and whether its output is confirmed off, into its run.json. Never raises an OSError.

    Returns True for a run that had not ended, whether that could be written or not.
    """
    path = Path(folder) / "run.json"
    unfinished = False
    with contextlib.suppress(OSError, ValueError):
        document = json.loads(path.read_text(encoding="utf-8"))
        if "stop" in document:
            return False
        unfinished = True
        at = datetime.datetime.now(datetime.UTC).isoformat()
        document["stop"] = {"at": at, "reason": DIED, "text": text, "output_off_confirmed": confirmed}
        with replacing(path) as new:
            new.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    return unfinished


def begin_report(folder: str) -> subprocess.Popen[bytes] | None:
    """Start drawing the run's report in a process that may outlive this one; None if none can be started.

    The guard stays small that way, and a report that fails does no harm.
    """
    quiet = subprocess.DEVNULL
    command = [sys.executable, "-P", "-m", "rig", "report", folder]
    try:
        return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    except (OSError, subprocess.SubprocessError):
        return None


def draw_missing_reports(folders: list[str]) -> None:
    """Draw the reports that the guard has not drawn within its time: it may have died as well."""
    time.sleep(REPORT_S)
    for folder in folders:
        with contextlib.suppress(OSError):
            if not (Path(folder) / "report.html").exists() and (process := begin_report(folder)) is not None:
                try:
                    process.wait(REPORT_S)
                except subprocess.TimeoutExpired:
                    process.kill()
                    process.wait()


def why_not_confirmed_off(folder: str | None) -> str | None:
    """Return the guard's text for an output that it could not confirm off; None if it did, or wrote nothing.

    folder: a job's, with the runs inside it.
    """
    for run in _runs(folder):
        stop = run.get("stop")
        if isinstance(stop, dict) and stop.get("reason") == DIED and not stop.get("output_off_confirmed"):
            return str(stop.get("text"))
    return None


def end_of_last_run(folder: str, within_s: float) -> tuple[bool, str] | None:
    """Return whether the output is confirmed off by the last run in a job's folder, and the text of its end.

    Waits until every run has an entry, by itself or by the guard; None if one has none in time. The time of day may
    have jumped between two runs, so that "last" is a guess: an output that is not confirmed off comes first.
    """
    until_s = time.monotonic() + within_s
    while True:
        runs = list(_runs(folder))
        ends = [
            (not stop.get("output_off_confirmed"), str(run.get("start", {}).get("at", "")), stop)
            for run in runs
            if isinstance(stop := run.get("stop"), dict)
        ]
        if runs and len(ends) == len(runs):
            *_, stop = max(ends, key=lambda end: end[:2])
            text, confirmed = stop.get("text") or stop.get("reason"), bool(stop.get("output_off_confirmed"))
            if stop.get("reason") == DIED:
                return confirmed, f"its guard: {text}"
            return confirmed, f"its run: {text}; output {'off, confirmed' if confirmed else 'not confirmed off'}"
        if time.monotonic() >= until_s:
            return None
        time.sleep(LOOK_AGAIN_S)


def _runs(folder: str | None) -> Iterator[dict[str, Any]]:
    """Yield the documents of the runs in a folder; one that cannot be read is left out."""
    for path in sorted(Path(folder).rglob("run.json")) if folder is not None else ():
        try:
            run = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(run, dict) and isinstance(run.get("start", {}), dict):
            yield run

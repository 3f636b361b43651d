"""What is written of a job that was running when the daemon's process ended: whether its "off" can be believed.

Import-light.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from rig.guard.left_behind import DIED, REPORT_S, begin_report

OFF_CONTRADICTED = "off_contradicted"  # the trip of a temperature that goes on as if the output were on


GUARD_S = REPORT_S  # for the guard of the daemon that ended, which has looked at the temperature before
LOOK_AGAIN_S = 0.2  # for what the guard writes


def not_confirmed_off(folder: str | None) -> str | None:
    """Why the output of a job is not confirmed off, in words; None where it is, or where nobody says.

    folder: the job's, with the runs inside it.
    """
    return next((text for confirmed, text in _ends(folder) if not confirmed), None)


def end_of_the_last_run(folder: str, within_s: float) -> tuple[bool, str] | None:
    """Whether the output is off, confirmed, by the run in a job's folder that began last, and what is written of its
    end: by the run itself, or by the guard, who is waited for; None where nothing is written in time."""
    until_s = time.monotonic() + within_s
    while True:
        last = max(_runs(folder), key=lambda run: str(run.get("start", {}).get("at", "")), default={})
        if isinstance(last.get("stop"), dict):
            stop = last["stop"]
            text, confirmed = stop.get("text") or stop.get("reason"), bool(stop.get("output_off_confirmed"))
            if stop.get("reason") == DIED:
                return confirmed, f"its guard: {text}"
            return confirmed, f"its run: {text}; output {'off, confirmed' if confirmed else 'not confirmed off'}"
        if time.monotonic() >= until_s:
            return None
        time.sleep(LOOK_AGAIN_S)


def report_left_behind(folders: list[str]) -> None:
    """Write the reports of jobs that ran when the daemon ended, where their guard has not: it may have died, too."""
    time.sleep(GUARD_S)
    for folder in folders:
        with contextlib.suppress(OSError):
            if not (Path(folder) / "report.html").exists() and (draws := begin_report(folder)) is not None:
                try:
                    draws.wait(REPORT_S)
                except subprocess.TimeoutExpired:
                    draws.kill()
                    draws.wait()


def _ends(folder: str | None) -> Iterator[tuple[bool, str]]:
    """(output off confirmed, text) of each run in a folder whose end the guard wrote."""
    for run in _runs(folder):
        stop = run.get("stop")
        if isinstance(stop, dict) and stop.get("reason") == DIED:
            yield bool(stop.get("output_off_confirmed")), str(stop.get("text"))


def _runs(folder: str | None) -> Iterator[dict[str, Any]]:
    """The documents of the runs in a folder; one that cannot be read is left out."""
    for path in sorted(Path(folder).rglob("run.json")) if folder is not None else ():
        try:
            run = json.loads(path.read_text(encoding="utf-8"))
        except (OSError, ValueError):
            continue
        if isinstance(run, dict) and isinstance(run.get("start", {}), dict):
            yield run

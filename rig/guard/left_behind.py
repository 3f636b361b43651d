"""The end of a run whose process has died, in the run folder that it left behind: its run.json gets its `stop`.

A folder that has one, or is gone, is left alone; a disk that is full changes nothing.
"""

from __future__ import annotations

import datetime
import json
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

from rig.core.file_writing import replacing

DIED = "process_died"
REPORT_S = 60.0  # loading what draws takes some seconds on a small computer, drawing hours of rows some more


@dataclass(frozen=True)
class Left:
    """folder: where the run that was going on was written, the one that is not whole."""

    folder: str


def write_end(left: Left | None, text: str, confirmed: bool) -> str:
    """Why it ended, and whether its output is confirmed off. Never raises an OSError.

    The folder of a run that had not ended, whether that could be written down or not; empty where there is none.
    """
    if left is None:
        return ""
    path = Path(left.folder) / "run.json"
    unfinished = ""
    try:
        document = json.loads(path.read_text(encoding="utf-8"))
        if "stop" in document:
            return ""
        unfinished = left.folder
        at = datetime.datetime.now(datetime.UTC).isoformat()
        document["stop"] = {"at": at, "reason": DIED, "text": text, "output_off_confirmed": confirmed}
        with replacing(path) as new:
            new.write_text(json.dumps(document, indent=2) + "\n", encoding="utf-8")
    except (OSError, ValueError):
        return unfinished
    return unfinished


def begin_report(folder: str) -> subprocess.Popen[bytes] | None:
    """Begin to draw the report of a run that was left behind, in a process of its own that may outlive this one: the
    guard stays small, and a report that fails fails nobody else. None where no process can be begun."""
    quiet = subprocess.DEVNULL
    command = [sys.executable, "-P", "-m", "rig", "report", folder]
    try:
        return subprocess.Popen(command, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True)
    except (OSError, subprocess.SubprocessError):
        return None

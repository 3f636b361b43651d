"""`peltier trend` over the bench's runs each night, in a process of lowest priority, never during a run.

Its results are in the bench's folder, trend/, with trend/report.html. A new change becomes one of the bench's warnings.
A run that begins ends the process; finished diagnoses are kept, and the others are done when the bench is idle again.
"""

from __future__ import annotations

import csv
import json
import shutil
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

from rig.daemon.web_process import end_process

NIGHT_H = 6  # hours after serve.diagnose_hour in which it may begin: then people come to work
LOOK_EVERY_S = 10.0
CHECK_EVERY_S = 0.2  # for a run that begins
ENDS_S = 5.0
OUT = "trend"
REPORTED = "told.json"  # changes that are warnings already


class Nightly:
    """Diagnoses the runs in a folder, from an hour of the local day on.

    may: returns True while the bench is idle; note: adds a warning; command: by default this Python's `peltier trend`.
    """

    def __init__(
        self,
        folder: Path,
        hour: int,
        may: Callable[[], bool],
        note: Callable[[str], None],
        local_time: Callable[[], time.struct_time] = time.localtime,
        command: Sequence[str] | None = None,
    ) -> None:
        self._folder, self._hour, self._may, self._note, self._local_time = folder, hour, may, note, local_time
        words = [sys.executable, "-m", "rig", "trend", str(folder), "--out", str(folder / OUT), "--workers", "1"]
        nice = shutil.which("nice")
        self._command = list(command) if command is not None else [*([nice, "-n", "19"] if nice else []), *words]
        self._done: tuple[int, int] | None = None  # year and day of the last night that is done
        self._ending = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Start a thread that begins the diagnosis when it is time."""
        self._thread = threading.Thread(target=self._keep, name="nightly", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        self._ending.set()
        if self._thread is not None:
            self._thread.join(ENDS_S)

    @property
    def due(self) -> bool:
        """True if it is night, this night is not done, and the bench is idle."""
        now = self._local_time()
        return 0 <= now.tm_hour - self._hour < NIGHT_H and (now.tm_year, now.tm_yday) != self._done and self._may()

    def _keep(self) -> None:
        while not self._ending.wait(LOOK_EVERY_S):
            if self.due and next(self._folder.rglob("run.json"), None) is not None:
                self.once()

    def once(self) -> bool:
        """Run one process; True if it ended by itself."""
        now = self._local_time()
        quiet = subprocess.DEVNULL
        try:
            process = subprocess.Popen(self._command, stdin=quiet, stdout=quiet, stderr=subprocess.PIPE)
        except OSError as error:
            self._note(f"the nightly diagnosis cannot be started: {error}")
            self._done = (now.tm_year, now.tm_yday)
            return False
        lines: list[bytes] = []
        with process:
            reader = threading.Thread(target=lambda: lines.extend(process.stderr or []), daemon=True)
            reader.start()
            while process.poll() is None:
                if self._ending.wait(CHECK_EVERY_S) or not self._may():
                    end_process(process, ENDS_S)
                    return False
            reader.join(ENDS_S)
        self._done = (now.tm_year, now.tm_yday)
        if process.returncode != 0:
            last = lines[-1].decode("utf-8", "replace").strip() if lines else "without a message"
            self._note(f"the nightly diagnosis ended with status {process.returncode}: {last}")
            return True
        for line in self._news():
            self._note(line)
        return True

    def _news(self) -> list[str]:
        """Return a line for each change that is not a warning yet."""
        out = self._folder / OUT
        try:
            with (out / "effects.csv").open(encoding="utf-8", newline="") as file:
                rows = [row for row in csv.DictReader(file) if row.get("since")]
        except OSError as error:
            return [f"the nightly diagnosis left no table: {error}"]
        known = _reported(out / REPORTED)
        lines = []
        for row in rows:
            key = " ".join(row.get(name) or "" for name in ("rig", "effect", "parameter", "since", "change"))
            if key not in known:
                known.append(key)
                lines.append(_in_words(row))
        try:
            (out / REPORTED).write_text(json.dumps(known) + "\n", encoding="utf-8")
        except OSError as error:  # such as a full disk; the changes are reported all the same
            lines.append(f"trend: the list of reported changes cannot be written, they will be reported again: {error}")
        return lines


def _reported(path: Path) -> list[str]:
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return []
    return [str(key) for key in known] if isinstance(known, list) else []


def _in_words(row: dict[str, str]) -> str:
    what = f"{row['effect']} {row['parameter']}"
    sizes = {name: f"{float(row[name]):.4g}" for name in ("before", "after") if row.get(name)}
    if row.get("change") == "value":
        text = f"{what} went from {sizes.get('before')} to {sizes.get('after')}"
    elif row.get("change") == "appears":
        text = f"{what} has appeared, {sizes.get('after')}"
    else:
        text = f"{what} is gone"
    return f"trend: {text} since {row['since'][:10]} (trend/report.html)"

"""`peltier trend` over the bench's runs each night, in a process of lowest priority, never while a run is on.

What it finds stays in the bench's folder, trend/: its page is trend/report.html. A change that was not told before
becomes a line among the bench's warnings. A run that begins ends the process; what is diagnosed by then is kept, and
the rest is done when the bench is idle again.
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

NIGHT_H = 6  # hours after the hour that was asked for, in which it may begin: then people come to work
LOOK_EVERY_S = 10.0
SEE_EVERY_S = 0.2  # whether a run has begun
ENDS_S = 5.0
OUT = "trend"
TOLD = "told.json"


class Nightly:
    """folder: with the run folders; hour: of the local day; may: whether the bench is idle; note: tells people.

    local_time: of now; command: what is begun, the present Python's `peltier trend` by default.
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
        """Look now and then whether it is time, in a thread."""
        self._thread = threading.Thread(target=self._keep, name="nightly", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End, with the process."""
        self._ending.set()
        if self._thread is not None:
            self._thread.join(ENDS_S)

    @property
    def due(self) -> bool:
        """Whether it is night, this one is not done, and the bench is idle."""
        now = self._local_time()
        return 0 <= now.tm_hour - self._hour < NIGHT_H and (now.tm_year, now.tm_yday) != self._done and self._may()

    def _keep(self) -> None:
        while not self._ending.wait(LOOK_EVERY_S):
            if self.due and next(self._folder.rglob("run.json"), None) is not None:
                self.once()

    def once(self) -> bool:
        """One process from its beginning to its end; whether it came to that by itself."""
        now = self._local_time()
        quiet = subprocess.DEVNULL
        try:
            process = subprocess.Popen(self._command, stdin=quiet, stdout=quiet, stderr=subprocess.PIPE)
        except OSError as error:
            self._note(f"the nightly diagnosis cannot be begun: {error}")
            self._done = (now.tm_year, now.tm_yday)
            return False
        said: list[bytes] = []
        with process:
            reader = threading.Thread(target=lambda: said.extend(process.stderr or []), daemon=True)
            reader.start()
            while process.poll() is None:
                if self._ending.wait(SEE_EVERY_S) or not self._may():
                    _end(process)
                    return False
            reader.join(ENDS_S)
        self._done = (now.tm_year, now.tm_yday)
        if process.returncode != 0:
            last = said[-1].decode("utf-8", "replace").strip() if said else "it said nothing"
            self._note(f"the nightly diagnosis ended with status {process.returncode}: {last}")
            return True
        for line in self._news():
            self._note(line)
        return True

    def _news(self) -> list[str]:
        """A line for each change that was not told before."""
        out = self._folder / OUT
        try:
            with (out / "effects.csv").open(encoding="utf-8", newline="") as file:
                rows = [row for row in csv.DictReader(file) if row.get("since")]
        except OSError as error:
            return [f"the nightly diagnosis left no table: {error}"]
        known = _told(out / TOLD)
        lines = []
        for row in rows:
            key = " ".join(row.get(name) or "" for name in ("rig", "effect", "parameter", "since", "change"))
            if key not in known:
                known.append(key)
                lines.append(_in_words(row))
        try:
            (out / TOLD).write_text(json.dumps(known) + "\n", encoding="utf-8")
        except OSError as error:  # such as a full disk; what was found is told all the same
            lines.append(f"trend: what was told is not kept, so that it is told again: {error}")
        return lines


def _told(path: Path) -> list[str]:
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


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(ENDS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()

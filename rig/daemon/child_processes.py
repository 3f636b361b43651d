"""The processes that the bench process starts: the web processes, restarted when they die and ended last; and each
night `peltier trend`.

There are two web processes: one serves the page and its interface; the other takes STOP and nothing else, at a TCP port
of its own with connections of its own, so that STOP gets through whatever is done to the first. Their listening sockets
are created here: callers wait, without a refusal, while a process is restarted.
"""

from __future__ import annotations

import csv
import json
import shutil
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Sequence
from pathlib import Path

# before a restart, doubled each time: a process that cannot live must not take the bench's processor
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 30.0
SAME_SIGNAL_S = 0.2  # a signal to the whole process group reaches it first; that is not reported
LONG_LIFE_S = 60.0  # a process that lived longer has not died of its start
ENDS_S = 2.0  # it has nothing to save; then it is killed
CALLERS = 128  # that wait to be accepted


def listening(address: str, port: int) -> socket.socket:
    """Return a socket that listens at an address (port 0: any free one). Raises OSError; `why_not` gives the reason."""
    family = socket.AF_INET6 if ":" in address else socket.AF_INET
    return socket.create_server((address, port), family=family, backlog=CALLERS)


def why_not(error: OSError) -> str:
    """Return the reason alone, without the address that Python appends."""
    return (error.strerror or str(error)).partition(" (while attempting")[0]


def stop_listener(address: str, port: int, stop_port: int | None) -> socket.socket:
    """Return a listening socket for STOP: at the given port (OSError if it is taken), else at the one after the page's,
    or any free one."""
    if stop_port is not None:
        return listening(address, stop_port)
    try:
        return listening(address, port + 1 if 0 < port < 65535 else 0)
    except OSError:
        return listening(address, 0)


class WebProcess:
    """`python -m rig.web.serving SOCKET LISTENER page|stop`, kept alive from `start` to `stop`.

    page: address and port to listen at for the page; listener: the socket of STOP's own process. note: takes a line for
    people.
    """

    def __init__(
        self, place: Path, note: Callable[[str], None], page: tuple[str, int], listener: socket.socket | None = None
    ) -> None:
        self._place, self._note, self._page, self._listener = place, note, page, listener
        self._what, self._name = ("page", "page") if listener is None else ("stop", "STOP's own listener")
        self._process: subprocess.Popen[bytes] | None = None
        self._ending = threading.Event()
        self._starting = threading.Lock()  # so that `stop` also ends a process that is being started

    def start(self) -> None:
        """Start the process, in a thread that waits for its end."""
        threading.Thread(target=self._keep, name=self._name, daemon=True).start()

    def _keep(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._ending.is_set():
            began = time.monotonic()
            try:
                process = self._begin(self._listen())
            except OSError as error:
                self._note(f"the {self._name} cannot be served: {error}")
            else:
                if process is None:
                    return
                status = process.wait()
                if self._ending.wait(SAME_SIGNAL_S):
                    return
                self._note(f"the process of the {self._name} ended with status {status} and is started again")
            wait_s = FIRST_WAIT_S if time.monotonic() - began > LONG_LIFE_S else min(2.0 * wait_s, LONGEST_WAIT_S)
            self._ending.wait(wait_s)

    def _listen(self) -> int:
        """Return the descriptor of the listening socket. Raises OSError if the page's address is taken."""
        if self._listener is None:
            address, port = self._page
            try:
                self._listener = listening(address, port)
            except OSError as error:
                place = f"{address}:{port} (serve.address, serve.port)"
                raise OSError(f"{place}: {why_not(error)}: tried again until it can") from None
        return self._listener.fileno()

    def _begin(self, listener: int) -> subprocess.Popen[bytes] | None:
        """Start a process; None if `stop` has come already. Raises OSError."""
        command = [sys.executable, "-m", "rig.web.serving", str(self._place), str(listener), self._what]
        with self._starting:
            if self._ending.is_set():
                return None
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=(listener,))
            return self._process

    def stop(self) -> None:
        self._ending.set()
        with self._starting:
            process = self._process
        if self._listener is not None:
            self._listener.close()
        if process is not None:
            end_process(process, ENDS_S)


def end_process(process: subprocess.Popen[bytes], patience_s: float) -> None:
    """Ask a process to end, and end it by force if it does not in time."""
    process.terminate()
    try:
        process.wait(patience_s)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()


# ---- each night ---------------------------------------------------------------------------------------

NIGHT_H = 6  # hours after serve.diagnose_hour in which it may begin: then people come to work
LOOK_EVERY_S = 10.0
CHECK_EVERY_S = 0.2  # for a run that begins
TREND_ENDS_S = 5.0
OUT = "trend"
REPORTED = "told.json"  # changes that are warnings already


class Nightly:
    """Diagnoses the runs in a folder, from an hour of the local day on: `peltier trend` in a process of lowest
    priority, never during a run.

    Its results are in the bench's folder, trend/, with trend/report.html. A new change becomes one of the bench's
    warnings. A run that begins ends the process; finished diagnoses are kept, and the others are done when the bench is
    idle again.

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
            self._thread.join(TREND_ENDS_S)

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
                    end_process(process, TREND_ENDS_S)
                    return False
            reader.join(TREND_ENDS_S)
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

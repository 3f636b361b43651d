"""The web processes as the bench process sees them: begun, begun again when they die, ended last. They hold no port.

Two of them: one serves the page and its interface, the other takes STOP and nothing else, at a TCP port of its own with
connections of its own, so that whatever is done to the first, STOP still gets through. The second one's listening
socket is made here, so that its port is known at once and its callers wait, unrefused, while it is begun again.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

from rig.daemon.listening import listening, why_not

# until it is begun again, doubled each time: one that cannot live must not take the bench's processor
FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 30.0
SAME_SIGNAL_S = 0.2  # a signal to the whole process group reaches it first: nothing that anybody should be told
LONG_LIFE_S = 60.0  # one that lived longer has not died of its start
ENDS_S = 2.0  # it has nothing to put away; then it is killed


class WebProcess:
    """`python -m rig.web SOCKET`, kept alive from `start` to `stop`; with a listener the one that takes STOP."""

    def __init__(
        self, place: Path, note: Callable[[str], None], door: tuple[str, int], listener: socket.socket | None = None
    ) -> None:
        """door: address and port that it opens where it is given no listener."""
        self._place, self._note, self._door, self._listener = place, note, door, listener
        self._name = "page" if listener is None else "STOP's own listener"
        self._process: subprocess.Popen[bytes] | None = None
        self._ending = threading.Event()
        self._beginning = threading.Lock()  # a process that is being begun when `stop` comes is ended, too

    def start(self) -> None:
        """Begin, in a thread that waits for its end."""
        threading.Thread(target=self._keep, name=self._name, daemon=True).start()

    def _keep(self) -> None:
        wait_s = FIRST_WAIT_S
        command = [sys.executable, "-m", "rig.web", str(self._place)]
        files = [] if self._listener is None else [self._listener.fileno()]
        while not self._ending.is_set():
            began = time.monotonic()
            try:
                process = self._begin([*command, *map(str, files)], files)
            except OSError as error:
                self._note(f"the {self._name} cannot be served: {error}")
            else:
                if process is None:
                    return
                status = process.wait()
                if self._ending.wait(SAME_SIGNAL_S):
                    return
                self._note(self._why(status))
            wait_s = FIRST_WAIT_S if time.monotonic() - began > LONG_LIFE_S else min(2.0 * wait_s, LONGEST_WAIT_S)
            self._ending.wait(wait_s)

    def _why(self, status: int) -> str:
        """Why it may have ended: its address is the one thing that somebody else can take."""
        address, port = self._door
        try:
            if self._listener is None:
                listening(address, port).close()
        except OSError as error:
            why = f"{address}:{port}: {why_not(error)} (serve.address, serve.port)"
            return f"there is no page at {why}: tried again until there is"
        return f"the process of the {self._name} ended with status {status} and is begun again"

    def _begin(self, command: list[str], files: list[int]) -> subprocess.Popen[bytes] | None:
        """A process, for `stop` to end; None where that has come already. Raises OSError."""
        with self._beginning:
            if self._ending.is_set():
                return None
            self._process = subprocess.Popen(command, stdin=subprocess.DEVNULL, pass_fds=tuple(files))
            return self._process

    def stop(self) -> None:
        """End it; what it leaves open is closed by force."""
        self._ending.set()
        with self._beginning:
            process = self._process
        if process is None:
            return
        process.terminate()
        try:
            process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

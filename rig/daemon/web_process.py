"""The web processes as the bench process sees them: started, restarted when they die, ended last.

There are two: one serves the page and its interface; the other takes STOP and nothing else, at a TCP port of its own
with connections of its own, so that STOP gets through whatever is done to the first. Their listening sockets are
created here: callers wait, without a refusal, while a process is restarted.
"""

from __future__ import annotations

import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable
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

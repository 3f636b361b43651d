"""The web process as the bench process sees it: begun, begun again when it dies, ended last. It holds no port."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

FIRST_WAIT_S, LONGEST_WAIT_S = 0.5, 30.0
LONG_LIFE_S = 60.0
ENDS_S = 2.0


class WebProcess:
    """`python -m rig.web SOCKET`, kept alive from `start` to `stop`."""

    def __init__(self, socket: Path, note: Callable[[str], None]) -> None:
        self._socket, self._note = socket, note
        self._process: subprocess.Popen[bytes] | None = None
        self._ending = threading.Event()

    def start(self) -> None:
        """Begin, in a thread that waits for its end."""
        threading.Thread(target=self._keep, name="web process", daemon=True).start()

    def _keep(self) -> None:
        wait_s = FIRST_WAIT_S
        while not self._ending.is_set():
            began = time.monotonic()
            try:
                self._process = subprocess.Popen(
                    [sys.executable, "-m", "rig.web", str(self._socket)], stdin=subprocess.DEVNULL
                )
            except OSError as error:
                self._note(f"the page cannot be served: {error}")
            else:
                status = self._process.wait()
                if self._ending.is_set():
                    return
                self._note(f"the web process ended with status {status} and is begun again")
            wait_s = FIRST_WAIT_S if time.monotonic() - began > LONG_LIFE_S else min(2.0 * wait_s, LONGEST_WAIT_S)
            self._ending.wait(wait_s)

    def stop(self) -> None:
        """End it; what it leaves open is closed by force."""
        self._ending.set()
        process = self._process
        if process is None:
            return
        process.terminate()
        try:
            process.wait(ENDS_S)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()

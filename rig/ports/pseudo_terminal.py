"""Simulated instruments on pseudo-terminals, in real time, for programs that open a port by themselves.

POSIX only. One thread serves all instruments that share a plant, so that the plant sees one history. It keeps the far
end of each pseudo-terminal open, because otherwise the near end reports an error between two clients' sessions.
"""

from __future__ import annotations

import os
import pty
import selectors
import threading
import time
import tty
from collections.abc import Mapping

from sim.instruments.instrument import Instrument

LONGEST_WAIT_S = 0.02  # the plant's own events (regulation, watchdog) run at least this often, in real time
CHUNK = 4096


class PseudoTerminals:
    """Serve `instruments`, by name, from `start` until `stop`, or within a with block.

    speed: simulated seconds a second. paths: the names to open, such as /dev/pts/3. heard_s: when each was written to
    last (time.monotonic). failure: what ended the serving. Bytes that nobody reads are lost when the terminal's buffer
    is full, as on a wire.
    """

    def __init__(self, instruments: Mapping[str, Instrument], *, speed: float = 1.0) -> None:
        if not speed > 0.0:
            raise ValueError(f"a speed of {speed} is not positive")
        self._instruments, self._speed = dict(instruments), speed
        self._names: dict[int, str] = {}  # by the descriptor of the terminal's far end
        self._near_ends: list[int] = []
        self.paths: dict[str, str] = {}
        self.heard_s: dict[str, float] = {}
        self.failure: BaseException | None = None
        self._stopping = threading.Event()
        for name in self._instruments:
            far, near = pty.openpty()
            tty.setraw(near)
            os.set_blocking(far, False)
            self._names[far] = name
            self._near_ends.append(near)
            self.paths[name] = os.ttyname(near)

    def start(self) -> None:
        """Serve in a thread of its own."""
        self._began_s = time.monotonic()
        self._thread = threading.Thread(target=self._serve_safely, name="pseudo-terminals", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the terminals; raise what the emulators raised, if they did."""
        self._stopping.set()
        self._thread.join()
        for descriptor in (*self._names, *self._near_ends):
            os.close(descriptor)
        if self.failure is not None:
            raise self.failure

    def __enter__(self) -> PseudoTerminals:
        self.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()

    def now_s(self) -> float:
        """Return the simulated time, s."""
        return (time.monotonic() - self._began_s) * self._speed

    def _serve_safely(self) -> None:
        try:
            self._serve()
        except BaseException as failure:  # handed to the thread that calls stop
            self.failure = failure

    def _serve(self) -> None:
        with selectors.DefaultSelector() as selector:
            for far in self._names:
                selector.register(far, selectors.EVENT_READ)
            while not self._stopping.is_set():
                for key, _ in selector.select(self._patience_s()):
                    self._take(key.fd)
                self._give()

    def _patience_s(self) -> float:
        due = [due_s for one in self._instruments.values() if (due_s := one.next_transmit_s()) is not None]
        if not due:
            return LONGEST_WAIT_S
        return min(max((min(due) - self.now_s()) / self._speed, 0.0), LONGEST_WAIT_S)

    def _take(self, far: int) -> None:
        try:
            data = os.read(far, CHUNK)
        except OSError:  # nobody at the other end just now
            return
        if data:
            self.heard_s[self._names[far]] = time.monotonic()
            self._instruments[self._names[far]].receive(data, self.now_s())

    def _give(self) -> None:
        now_s = self.now_s()
        for far, name in self._names.items():
            if data := self._instruments[name].transmit(now_s):
                try:
                    os.write(far, data)
                except OSError:  # buffer full: lost
                    continue

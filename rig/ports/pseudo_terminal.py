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
from types import TracebackType

from sim.instruments.instrument import Instrument

LONGEST_WAIT_S = 0.02  # the plant's own events (regulation, watchdog) run at least this often, in real time
CHUNK = 4096


class PseudoTerminals:
    """Serve `instruments`, by name, from `start` until `stop`, or within a with block.

    speed: simulated seconds a second. start_s: simulated time at the beginning. paths: the names to open, such as
    /dev/pts/3. heard_s: when each was written to last (time.monotonic). Bytes that nobody reads are lost when the
    terminal's buffer is full, as on a wire.
    """

    def __init__(self, instruments: Mapping[str, Instrument], *, speed: float = 1.0, start_s: float = 0.0) -> None:
        if not speed > 0.0:
            raise ValueError(f"a speed of {speed} is not positive")
        self._instruments = dict(instruments)
        self._speed, self._start_s = speed, start_s
        self._masters: dict[int, Instrument] = {}
        self._slaves: list[int] = []
        self.paths: dict[str, str] = {}
        self.heard_s: dict[str, float] = {}
        self._names: dict[int, str] = {}
        self.failure: BaseException | None = None
        self._wake_reader, self._wake_writer = os.pipe()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        for name, instrument in self._instruments.items():
            master, slave = pty.openpty()
            tty.setraw(slave)
            os.set_blocking(master, False)
            self._masters[master], self._names[master] = instrument, name
            self._slaves.append(slave)
            self.paths[name] = os.ttyname(slave)
        self._began_s = time.monotonic()

    def now_s(self) -> float:
        return self._start_s + (time.monotonic() - self._began_s) * self._speed

    def start(self) -> None:
        self._began_s = time.monotonic()
        self._thread = threading.Thread(target=self._serve_safely, name="pseudo-terminals", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End the thread and close the terminals; raise what the emulators raised, if they did."""
        self._stopping.set()
        if self._wake_writer >= 0:
            os.write(self._wake_writer, b"x")
        if self._thread is not None:
            self._thread.join()
            self._thread = None
        self._close()
        if self.failure is not None:
            failure, self.failure = self.failure, None
            raise failure

    def serve(self) -> None:
        """Serve in this thread until another calls `stop`, or an exception ends it."""
        self._began_s = time.monotonic()
        selector = selectors.DefaultSelector()
        try:
            selector.register(self._wake_reader, selectors.EVENT_READ)
            for master in self._masters:
                selector.register(master, selectors.EVENT_READ)
            while not self._stopping.is_set():
                for key, _ in selector.select(self._patience_s()):
                    instrument = self._masters.get(key.fd)
                    if instrument is not None:
                        self._take(key.fd, instrument)
                self._give()
        finally:
            selector.close()

    def _patience_s(self) -> float:
        due = [due_s for one in self._instruments.values() if (due_s := one.next_transmit_s()) is not None]
        if not due:
            return LONGEST_WAIT_S
        return min(max((min(due) - self.now_s()) / self._speed, 0.0), LONGEST_WAIT_S)

    def _take(self, master: int, instrument: Instrument) -> None:
        try:
            data = os.read(master, CHUNK)
        except OSError:  # nobody at the other end just now
            return
        if data:
            self.heard_s[self._names[master]] = time.monotonic()
            instrument.receive(data, self.now_s())

    def _give(self) -> None:
        now_s = self.now_s()
        for master, instrument in self._masters.items():
            data = instrument.transmit(now_s)
            if data:
                try:
                    os.write(master, data)
                except OSError:  # buffer full: lost
                    continue

    def _serve_safely(self) -> None:
        try:
            self.serve()
        except BaseException as failure:  # handed to the thread that calls stop
            self.failure = failure

    def _close(self) -> None:
        for descriptor in (*self._masters, *self._slaves, self._wake_reader, self._wake_writer):
            if descriptor >= 0:
                os.close(descriptor)
        self._masters, self._slaves = {}, []
        self._wake_reader = self._wake_writer = -1

    def __enter__(self) -> PseudoTerminals:
        self.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        problem: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.stop()

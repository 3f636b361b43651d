"""Signals become an exception in the main thread, once; while the output is being switched off they only wait."""

from __future__ import annotations

import signal
import threading
from types import FrameType, TracebackType

from rig.outcome import Stopped

CAUGHT = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))


class SignalStop:
    """Context in which INT, TERM, HUP and QUIT raise `Stopped`; `shield` holds them back from then on."""

    def __init__(self) -> None:
        self.received: int | None = None
        self._shielded = False
        self._before: dict[int, object] = {}

    def __enter__(self) -> SignalStop:
        if threading.current_thread() is threading.main_thread():
            for number in CAUGHT:
                self._before[number] = signal.signal(number, self._handle)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def shield(self) -> None:
        """From now on signals are noted, not raised: the output is being switched off."""
        self._shielded = True

    def expose(self) -> None:
        """Signals raise again; one that came meanwhile raises now."""
        self._shielded = False
        if self.received is not None:
            raise Stopped(self.received)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        first = self.received is None
        if first:
            self.received = number
        if first and not self._shielded:
            self._shielded = True
            raise Stopped(number)

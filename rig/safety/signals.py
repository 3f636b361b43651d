"""Signals become an exception in the main thread, once; while the output is being switched off they only wait."""

from __future__ import annotations

import _thread
import signal
import threading
import time
from types import FrameType, TracebackType

from rig.core.outcome import Stopped

CAUGHT = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))
COMPILERS = ("numba", "llvmlite")  # they take exceptions for their own: one raised inside is lost, or breaks them
# Where Python takes and gives back locks: an exception raised between a lock and its `with` leaves it taken for good,
# and whoever asks for it next waits for ever (a daemon that did not end, with its output off).
LOCKING = ("threading", "queue", "contextlib", "concurrent", "importlib")
AGAIN_S = 0.02  # until a signal that came while something was compiled, or a lock was taken, is tried again


class SignalStop:
    """Context in which INT, TERM, HUP and QUIT raise `Stopped`; `shield` holds them back from then on.

    While a loop is being compiled they wait for its end: seconds, before anything is switched on (`policies.tried`).
    While a lock is being taken or given back they wait for that: microseconds, tried again after AGAIN_S.
    """

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
            raise self.outcome(self.received)

    def look(self) -> None:
        """Raises what came and was lost on its way: what switches an output off goes on after any error, and a signal
        that came just then was one for it."""
        if self.received is not None:
            raise self._ended(self.received)

    @staticmethod
    def outcome(number: int) -> BaseException:
        """What a signal becomes."""
        return Stopped(number)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.received = number if self.received is None else self.received
        if self._shielded:
            return
        if _compiling(frame) or _locking(frame):
            # not a `threading.Thread`, whose own locks may be those that are being taken
            _thread.start_new_thread(_raise_again, (number,))
            return
        raise self._ended(self.received)

    def _ended(self, number: int) -> BaseException:
        """Once: from then on the output is being switched off."""
        self._shielded = True
        return self.outcome(number)


class NotebookStop(SignalStop):
    """The same for a block of the user's own code: what is raised passes every `except Exception`, and is raised each
    time, because that code may catch it and go on."""

    @staticmethod
    def outcome(number: int) -> BaseException:
        """KeyboardInterrupt for INT, else SystemExit with the status 128 + number."""
        return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)

    def _ended(self, number: int) -> BaseException:
        self.received = None
        return self.outcome(number)


def _raise_again(number: int) -> None:
    """In the main thread, so that what it waits for is interrupted: raised in this one, it would be noticed at the
    wait's end."""
    time.sleep(AGAIN_S)
    ident = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and ident is not None:
        signal.pthread_kill(ident, number)
    else:  # Windows: at the end of the wait
        signal.raise_signal(number)


def _compiling(frame: FrameType | None) -> bool:
    """Whether a signal came in the middle of the compilation of a loop."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in COMPILERS:
            return True
        frame = frame.f_back
    return False


def _locking(frame: FrameType | None) -> bool:
    """Whether a signal came where a lock may be taken that no `with` gives back yet; not where one is waited for."""
    if frame is None or str(frame.f_globals.get("__name__")).partition(".")[0] not in LOCKING:
        return False
    return not _waiting(frame)


def _waiting(frame: FrameType) -> bool:
    """Whether it came in a wait that an exception may end: in `threading.Condition.wait` from where `gotit` is there,
    its lock given back until a `finally` takes it, or in a thread's `join`."""
    name = frame.f_code.co_name
    return (name == "wait" and "gotit" in frame.f_locals) or name in ("_wait_for_tstate_lock", "join")

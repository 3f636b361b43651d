"""Turn signals into one exception in the main thread; hold them back while the output is being switched off."""

from __future__ import annotations

import _thread
import signal
import threading
import time
from types import FrameType

from rig.core.outcome import Stopped

CAUGHT = tuple(getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGQUIT") if hasattr(signal, name))
COMPILERS = ("numba", "llvmlite")  # an exception raised inside them is lost, or breaks them
# Modules that take locks: an exception between the acquisition of a lock and its `with` leaves it locked for ever, and
# the next thread that needs it hangs (a daemon that did not end, with its output off).
LOCKING = ("threading", "queue", "contextlib", "concurrent", "importlib")
AGAIN_S = 0.02  # until a signal that came during a compilation, or while a lock was taken, is raised again


class SignalStop:
    """Context in which INT, TERM, HUP and QUIT raise `Stopped`; `shield` holds them back from then on.

    During a compilation they wait for its end: seconds, before anything is switched on (`policies.tried`). While a lock
    is being taken or released they wait for that: microseconds, raised again after AGAIN_S.
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

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)  # type: ignore[arg-type]

    def shield(self) -> None:
        """Note signals without raising them from now on: the output is being switched off."""
        self._shielded = True

    def expose(self) -> None:
        """Raise signals again, one that came meanwhile at once."""
        self._shielded = False
        if self.received is not None:
            raise self.outcome(self.received)

    def look(self) -> None:
        """Raise a signal that came but was swallowed: code that switches an output off goes on after any error."""
        if self.received is not None:
            raise self._ended(self.received)

    @staticmethod
    def outcome(number: int) -> BaseException:
        """Return KeyboardInterrupt for INT, else SystemExit with the status 128 + number."""
        return Stopped(number)

    def _handle(self, number: int, frame: FrameType | None) -> None:
        self.received = number if self.received is None else self.received
        if self._shielded:
            return
        if _compiling(frame) or _locking(frame):
            # not a `threading.Thread`: its locks may be the ones being taken
            _thread.start_new_thread(_raise_again, (number,))
            return
        raise self._ended(self.received)

    def _ended(self, number: int) -> BaseException:
        """Return the exception, and hold further signals back: the output is being switched off."""
        self._shielded = True
        return self.outcome(number)


class NotebookStop(SignalStop):
    """A SignalStop for a block of the user's code: the exception passes every `except Exception`, and each signal
    raises one, because that code may catch it and go on."""

    @staticmethod
    def outcome(number: int) -> BaseException:
        """Return KeyboardInterrupt for INT, else SystemExit with the status 128 + number."""
        return KeyboardInterrupt() if number == signal.SIGINT else SystemExit(128 + number)

    def _ended(self, number: int) -> BaseException:
        self.received = None
        return self.outcome(number)


def _raise_again(number: int) -> None:
    """Send the signal to the main thread, which interrupts its wait; sent to this one it would not."""
    time.sleep(AGAIN_S)
    ident = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and ident is not None:
        signal.pthread_kill(ident, number)
    else:  # Windows: noticed at the end of the wait
        signal.raise_signal(number)


def _compiling(frame: FrameType | None) -> bool:
    """Return True if the signal came during the compilation of a loop."""
    while frame is not None:
        if str(frame.f_globals.get("__name__")).partition(".")[0] in COMPILERS:
            return True
        frame = frame.f_back
    return False


def _locking(frame: FrameType | None) -> bool:
    """Return True if a lock may be taken that no `with` releases yet; False while a thread waits for one."""
    if frame is None or str(frame.f_globals.get("__name__")).partition(".")[0] not in LOCKING:
        return False
    return not _waiting(frame)


def _waiting(frame: FrameType) -> bool:
    """Return True in a wait that an exception may end: a thread's `join`, or `threading.Condition.wait` once `gotit`
    exists, when its lock is released until a `finally` takes it again."""
    name = frame.f_code.co_name
    return (name == "wait" and "gotit" in frame.f_locals) or name in ("_wait_for_tstate_lock", "join")

"""Signals stop a run once, wherever they come: not while the output is switched off, nor while a loop is compiled."""

from __future__ import annotations

import signal
import threading
import time
from typing import Any

import pytest

from rig.core.outcome import Stopped
from rig.safety.signals import SignalStop

SOON_S = 20.0
COMPILER = '''
def compiled(interrupt):
    """Takes every exception for its own, as numba does."""
    try:
        interrupt()
    except Exception:
        return "swallowed"
    return "compiled"
'''


def test_a_signal_raises_at_once() -> None:
    with SignalStop(), pytest.raises(Stopped, match="SIGTERM"):
        signal.raise_signal(signal.SIGTERM)


def test_a_signal_in_a_compilation_raises_behind_it() -> None:
    names: dict[str, Any] = {"__name__": "numba.core.compiler"}
    exec(COMPILER, names)
    with SignalStop() as signals:
        assert names["compiled"](lambda: signal.raise_signal(signal.SIGHUP)) == "compiled"
        assert signals.received == signal.SIGHUP
        begun_s = time.monotonic()
        with pytest.raises(Stopped, match="SIGHUP"):
            threading.Event().wait(SOON_S)
        assert time.monotonic() - begun_s < SOON_S  # it ends the wait, and is not noticed at its end


def test_a_shielded_signal_waits_until_it_is_exposed() -> None:
    with SignalStop() as signals:
        signals.shield()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Stopped, match="SIGINT"):
            signals.expose()

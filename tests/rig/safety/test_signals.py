"""Signals stop a run once, wherever they come: not while the output is switched off, nor while a loop is compiled."""

from __future__ import annotations

import os
import queue
import signal
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from rig.core.outcome import Stopped
from rig.drivers.meerstetter import MeerstetterController
from rig.safety.signals import SignalStop
from tests.peltier import Peltier
from tests.rig.small import write_bench

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


def again_and_again(work: Callable[[], object], until_s: float) -> None:
    """Until a signal comes that late."""
    sent = threading.Thread(target=lambda: (time.sleep(until_s), os.kill(os.getpid(), signal.SIGTERM)))
    with SignalStop():
        sent.start()
        while True:
            work()


@pytest.mark.parametrize("use", [threading.Event.clear, lambda event: event.wait(1e-5)], ids=["clear", "wait"])
def test_a_signal_leaves_no_lock_taken(use: Callable[[threading.Event], object]) -> None:
    """Whoever asked for it then would wait for ever. Of ten signals in the midst of `clear` three would leave one."""
    for round_ in range(15):
        event = threading.Event()
        with pytest.raises(Stopped, match="SIGTERM"):
            again_and_again(partial(use, event), 5e-5 * round_)
        other = threading.Thread(target=event.set, daemon=True)
        other.start()
        other.join(SOON_S)
        assert not other.is_alive(), f"round {round_}"


def test_a_signal_while_a_thread_is_begun_raises_behind_it() -> None:
    """`threading` has locks that all threads share: what is done with a signal must not need them."""
    for round_ in range(15):
        with pytest.raises(Stopped, match="SIGTERM"):
            again_and_again(lambda: threading.Thread(target=int).start(), 5e-5 * round_)


@pytest.mark.parametrize("wait", [threading.Event().wait, queue.Queue[int]().get])
def test_a_signal_ends_a_wait_at_once(wait: Callable[..., object]) -> None:
    threading.Timer(0.05, lambda: os.kill(os.getpid(), signal.SIGTERM)).start()
    begun_s = time.monotonic()
    with pytest.raises(Stopped, match="SIGTERM"), SignalStop():
        wait(timeout=SOON_S)
    assert time.monotonic() - begun_s < SOON_S


def test_a_shielded_signal_waits_until_it_is_exposed() -> None:
    with SignalStop() as signals:
        signals.shield()
        signal.raise_signal(signal.SIGINT)
        with pytest.raises(Stopped, match="SIGINT"):
            signals.expose()


@pytest.mark.parametrize(("number", "phases"), [(1, set()), (2, {"polarity"})])
def test_a_signal_in_the_middle_of_an_off_ends_the_run(
    monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path, number: int, phases: set[str]
) -> None:
    """When the bench is opened, and while the first plate is reckoned: the off goes on after whatever goes wrong in it,
    and takes the signal for that."""
    whole, looked = MeerstetterController._reads_off, []

    def reads_off(self: MeerstetterController) -> bool:
        looked.append(self)
        if len(looked) == number:
            signal.raise_signal(signal.SIGINT)
        return whole(self)

    monkeypatch.setattr(MeerstetterController, "_reads_off", reads_off)
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=130)
    assert "stopped by SIGINT" in err
    assert "output off, confirmed by the controller" in err
    rows = [row for path in tmp_path.glob("run*/record.csv") for row in path.read_text().splitlines()[1:]]
    assert {row.rsplit(",", 1)[1] for row in rows} == phases


def test_a_signal_while_the_film_is_fitted(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    """The evening's rows are whole by then: it says where they are, and they have a report."""
    calibration = """
[calibration]
temperature_degC = [45, 75]
rate_K_per_s = 1.5
dwell_s = 0.0
minor_loops = 2
"""
    monkeypatch.setattr("rig.experiment.session.identify_calibration", lambda *_: signal.raise_signal(signal.SIGINT))
    status, _, err = peltier("calibrate", write_bench(tmp_path, more=calibration), "--out", tmp_path / "film")
    part = tmp_path / "film.part"
    assert status == 130
    assert "stopped by SIGINT; output off, confirmed by the controller" in err
    assert f"; what was recorded is in {part}" in err
    assert peltier("report", part) == (0, f"{part / 'report.html'}\n", "")
    assert "all recorded, and nothing fitted" in (part / "report.html").read_text()


def test_a_signal_while_a_report_is_written(monkeypatch: pytest.MonkeyPatch, peltier: Peltier, tmp_path: Path) -> None:
    monkeypatch.setattr("rig.report.run.write_live_report", lambda *_: signal.raise_signal(signal.SIGTERM))
    err = peltier.fails("run", write_bench(tmp_path), "--out", tmp_path / "run", status=143)
    assert f"; what was recorded is in {tmp_path / 'run.part'}" in err

"""Every case comes back once, whatever becomes of the processes; what was shared is read once a worker."""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import signal
import threading
import time
from pathlib import Path

import pytest

from rig.batch import Case, Ended, EngineChoice, each_ended, opened
from rig.core.faults import Faults
from rig.core.outcome import Stopped
from rig.safety.signals import SignalStop
from tests.rig.batch.work import doubled, ends, fails, kills_itself, read_from, size_of, slow

pytestmark = pytest.mark.skipif(os.name == "nt", reason="kills processes")


def _all(cases: list[Case], workers: int = 2) -> dict[int, Ended]:
    with opened(EngineChoice(workers=workers), len(cases)) as engine:
        ended = list(each_ended(cases, engine))
    assert sorted(e.number for e in ended) == [case.number for case in cases]
    return {e.number: e for e in ended}


def test_what_fails_and_what_dies_stops_nothing_else() -> None:
    cases = [Case(k, doubled, (k,)) for k in range(12)]
    cases[3] = Case(3, fails, (3,))
    cases[5] = Case(5, kills_itself, (5,))
    ended = _all(cases)
    assert {k: e.value for k, e in ended.items() if k not in (3, 5)} == {k: 2 * k for k in range(12) if k not in (3, 5)}
    assert ended[3].fault.startswith("ValueError: no value for 3")
    assert "died" in ended[5].fault
    assert ended[5].value is None


def test_a_worker_that_is_killed_loses_nothing(tmp_path: Path) -> None:
    cases = [Case(k, slow, (k, 0.15, tmp_path)) for k in range(16)]
    killed: list[int] = []

    def kill() -> None:
        while len(killed) < 3:
            time.sleep(0.4)
            marks = sorted(tmp_path.iterdir(), key=lambda mark: mark.stat().st_mtime_ns)
            if marks and (worker := int(marks[-1].name.split("_")[1])) not in killed:
                with contextlib.suppress(ProcessLookupError):  # it may have done its last case meanwhile
                    os.kill(worker, signal.SIGKILL)
                killed.append(worker)

    killer = threading.Thread(target=kill, daemon=True)
    killer.start()
    ended = _all(cases)
    killer.join(timeout=1)
    assert killed
    assert {k: e.value for k, e in ended.items()} == {k: 2 * k for k in range(16)}


@pytest.mark.parametrize("dies", [False, True], ids=["side by side", "alone after a worker died"])
def test_a_signal_ends_it_wherever_it_waits(tmp_path: Path, dies: bool) -> None:
    """It is raised once: taken for what a case came to, it would be gone, and all the others computed."""
    cases = [Case(0, kills_itself if dies else doubled, (0,)), Case(1, slow, (1, 60.0, tmp_path))]

    def interrupt() -> None:
        while not list(tmp_path.iterdir()):  # one worker: the second begins when the first has ended
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(Stopped), SignalStop():
        _all(cases, workers=1)


@pytest.mark.parametrize("dies", [False, True], ids=["side by side", "alone after a worker died"])
def test_a_signal_that_another_thread_was_handed_ends_it_too(tmp_path: Path, dies: bool) -> None:
    """The main thread's wait is not interrupted by it: it raises when it wakes by itself."""
    cases = [Case(0, kills_itself if dies else doubled, (0,)), Case(1, ends, (tmp_path, 15.0))]

    def interrupt() -> None:
        while not list(tmp_path.iterdir()):
            time.sleep(0.05)
        time.sleep(0.2)  # until the main thread waits again
        signal.pthread_kill(threading.get_ident(), signal.SIGINT)

    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(Stopped), SignalStop():
        _all(cases, workers=1)
    assert [mark.name for mark in tmp_path.iterdir()] == ["begun"]


def test_a_process_of_the_callers_own_outlives_the_cases() -> None:
    own = multiprocessing.get_context("spawn").Process(target=time.sleep, args=(600.0,))
    own.start()
    try:
        with opened(EngineChoice(workers=1), 1) as engine:
            assert next(each_ended([Case(0, doubled, (1,))], engine)).value == 2
            workers = [process for process in multiprocessing.active_children() if process.pid != own.pid]
        assert len(workers) == 1
        workers[0].join(60.0)
        ends_s = time.monotonic() + 60.0  # the pool's thread waits for it, too: who is second is told a moment later
        while workers[0].is_alive() and time.monotonic() < ends_s:
            time.sleep(0.01)
        assert not workers[0].is_alive()
        own.join(0.5)  # time for a kill to arrive
        assert own.is_alive()
    finally:
        own.kill()
        own.join()


def test_what_is_shared_is_read_once_a_worker() -> None:
    value = list(range(1000))
    with opened(EngineChoice(workers=1), 4) as engine:
        shared = [engine.share(value), engine.share(list(value))]
        assert shared[0] == shared[1]  # by content
        assert next(each_ended([Case(0, size_of, (shared[0],))], engine)).value == 1000
        read = {e.value for e in each_ended([Case(k, read_from, (shared[k % 2],)) for k in range(4)], engine)}
    assert len(read) == 1


def test_a_choice_that_cannot_be_is_refused() -> None:
    for words in ({"name": "ray"}, {"workers": 0}, {"address": "tcp://localhost:1"}):
        with pytest.raises(Faults, match="expected"):
            EngineChoice(**words)  # type: ignore[arg-type]


@pytest.mark.long
def test_the_same_on_a_dask_cluster(tmp_path: Path) -> None:
    pytest.importorskip("distributed")
    cases = [Case(k, doubled, (k,)) for k in range(6)] + [Case(6, fails, (6,)), Case(7, size_of, ())]
    with opened(EngineChoice("dask", 2), len(cases)) as engine:
        cases[7] = Case(7, size_of, (engine.share([1, 2, 3]),))
        ended = {e.number: e for e in each_ended(cases, engine)}
    assert {k: ended[k].value for k in range(6)} == {k: 2 * k for k in range(6)}
    assert ended[6].fault.startswith("ValueError: no value for 6")
    assert ended[7].value == 3


@pytest.mark.long
def test_what_a_killed_dask_worker_held_is_given_to_the_next(tmp_path: Path) -> None:
    """What is shared is computed by nobody, so that the cluster cannot make it anew."""
    pytest.importorskip("distributed")
    with opened(EngineChoice("dask", 1), 8) as engine:
        shared = engine.share(list(range(1000)))
        process, _ = next(each_ended([Case(0, read_from, (shared,))], engine)).value
        os.kill(process, signal.SIGKILL)
        ended = list(each_ended([Case(k, size_of, (shared,)) for k in range(1, 6)], engine))
    assert [(e.value, e.fault) for e in ended] == [(1000, "")] * 5

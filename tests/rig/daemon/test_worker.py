"""The thread that all jobs run in."""

from __future__ import annotations

import threading

import pytest

from rig.daemon.supervisor import Worker


def test_tasks_run_one_after_the_other_in_one_thread() -> None:
    worker, seen = Worker("job"), []
    first, second = (worker.begin(lambda: seen.append(threading.get_ident())) for _ in range(2))
    assert first.wait(5.0)
    assert second.wait(5.0)
    assert len(seen) == 2
    assert len(set(seen)) == 1
    assert seen[0] != threading.get_ident()


def test_a_task_that_does_not_end_holds_up_nobody_once_it_is_abandoned() -> None:
    worker, gate = Worker("job"), threading.Event()
    stuck = worker.begin(lambda: gate.wait(30.0) and None)
    assert not stuck.wait(0.05)
    worker.abandon()
    assert worker.begin(lambda: None).wait(5.0)
    gate.set()
    assert stuck.wait(5.0)


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_task_that_raises_is_over_and_the_next_one_runs() -> None:
    worker = Worker("job")

    def broken() -> None:
        raise RuntimeError("broken")

    assert worker.begin(broken).wait(5.0)
    worker._thread.join(5.0)
    assert worker.begin(lambda: None).wait(5.0)

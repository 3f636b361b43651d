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


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_task_that_raises_is_over_and_the_next_one_runs() -> None:
    worker = Worker("job")

    def broken() -> None:
        raise RuntimeError("broken")

    assert worker.begin(broken).wait(5.0)
    worker._thread.join(5.0)
    assert worker.begin(lambda: None).wait(5.0)

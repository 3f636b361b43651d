"""STOP and the job's own end both switch off; a controller that does not obey hears of it once, so that its dead man
is not fed."""

from __future__ import annotations

import threading
from typing import Any
from unittest.mock import Mock

import pytest

from rig.daemon.command_queue import JobStopped
from rig.daemon.output_lock import JobPass, Off, OutputLock
from tests.rig.daemon.benches import until


def attached() -> tuple[OutputLock, Mock, Any]:
    """The lock, its controller, and that controller as a job has it."""
    lock, controller = OutputLock(lambda: 0.0), Mock(confirms_off_by="its status")
    lock.attach(controller)
    return lock, controller, lock.controller_for_job(controller, JobPass(lock))


@pytest.mark.parametrize("obeys", [True, False])
def test_a_job_that_is_first_at_the_lock_switches_off_for_stop_too(obeys: bool) -> None:
    """STOP waits for the job's exchange; the job finds the lock closed and is at its "off" before STOP has the lock."""
    lock, controller, locked = attached()
    controller.off.return_value = obeys
    offs: list[Off] = []
    stop = threading.Thread(target=lambda: offs.append(lock.stop(JobStopped("stopped"))))

    def exchange() -> Any:
        stop.start()
        until(lambda: lock.closed is not None, "STOP, which waits for the lock")
        return locked.off()  # still with the lock: nobody can be before

    controller.read_temperature.side_effect = exchange
    assert locked.read_temperature() is obeys
    stop.join()
    assert [off.confirmed for off in offs] == [obeys]
    assert controller.off.call_count == 1


def test_a_stop_that_comes_while_the_job_switches_off_is_that_off() -> None:
    """A job that ends by itself is at its "off", which a controller that is deaf takes 0.7 s for."""
    lock, controller, locked = attached()
    offs: list[Off] = []
    stop = threading.Thread(target=lambda: offs.append(lock.stop(JobStopped("stopped"))))

    def off() -> bool:
        if controller.off.call_count == 1:
            stop.start()
            until(lambda: lock.closed is not None, "STOP, which waits for the lock")
        return False

    controller.off.side_effect = off
    assert not locked.off()
    stop.join()
    assert [one.confirmed for one in offs] == [False]
    assert controller.off.call_count == 1


def test_an_off_that_came_late_to_a_gate_that_was_opened_is_none_for_the_next_job() -> None:
    """STOP waits for the lock while somebody resets the bench, and the supervisor opens the lock for the next job."""
    lock, controller, locked = attached()
    controller.off.return_value = True
    stop = threading.Thread(target=lambda: lock.stop(JobStopped("stopped")))

    def exchange() -> None:
        stop.start()
        until(lambda: lock.closed is not None, "STOP, which waits for the lock")
        lock.open()

    controller.status.side_effect = exchange
    locked.status()
    stop.join()
    assert controller.off.call_count == 1
    assert locked.off()
    assert controller.off.call_count == 2
    assert lock.stop(JobStopped("another")).confirmed
    assert controller.off.call_count == 3


def test_a_job_is_told_what_the_off_of_stop_gave_and_a_second_stop_commands_it_again() -> None:
    lock, controller, locked = attached()
    controller.off.side_effect = [False, True, True]
    assert not lock.stop(JobStopped("stopped")).confirmed
    assert not locked.off()
    assert controller.off.call_count == 1
    assert lock.stop(JobStopped("stopped again")).confirmed
    assert locked.off()
    assert controller.off.call_count == 2
    lock.open()
    assert locked.off()
    assert controller.off.call_count == 3


def test_a_driver_whose_off_raises_ends_stop_and_job_with_an_output_that_is_not_confirmed_off() -> None:
    """A user-defined driver may raise anything: STOP must go on to hold the queue, and the daemon to say what is on."""
    lock, controller = OutputLock(lambda: 0.0), Mock(confirms_off_by="its status")
    controller.off.side_effect = ZeroDivisionError("of the driver's own")
    lock.attach(controller)
    locked = lock.controller_for_job(controller, JobPass(lock))
    assert not lock.stop(JobStopped("stopped")).confirmed
    lock.open()
    assert not locked.off()

"""STOP and the job's own end both switch off; a controller that does not obey hears of it once, so that its dead man
is not fed."""

from __future__ import annotations

import threading
from typing import Any
from unittest.mock import Mock

import pytest

from rig.daemon.gate import Gate, Off, Pass
from rig.daemon.job import JobStopped
from tests.daemon.benches import until


@pytest.mark.parametrize("obeys", [True, False])
def test_a_job_that_is_first_at_the_lock_switches_off_for_stop_too(obeys: bool) -> None:
    """STOP waits for the job's exchange; the job finds the gate closed and is at its "off" before STOP has the lock."""
    gate, controller = Gate(lambda: 0.0), Mock(confirms_off_by="its status")
    controller.off.return_value = obeys
    gate.attach(controller)
    gated = gate.controller_for_jobs(controller, Pass(gate))
    offs: list[Off] = []
    stop = threading.Thread(target=lambda: offs.append(gate.stop(JobStopped("stopped"))))

    def exchange() -> Any:
        stop.start()
        until(lambda: gate.closed is not None, "STOP, which waits for the lock")
        return gated.off()  # still with the lock: nobody can be before

    controller.read_temperature.side_effect = exchange
    assert gated.read_temperature() is obeys
    stop.join()
    assert [off.confirmed for off in offs] == [obeys]
    assert controller.off.call_count == 1


def test_a_job_is_told_what_the_off_of_stop_gave_and_a_second_stop_commands_it_again() -> None:
    gate, controller = Gate(lambda: 0.0), Mock(confirms_off_by="its status")
    controller.off.side_effect = [False, True, True]
    gate.attach(controller)
    gated = gate.controller_for_jobs(controller, Pass(gate))
    assert not gate.stop(JobStopped("stopped")).confirmed
    assert not gated.off()
    assert controller.off.call_count == 1
    assert gate.stop(JobStopped("stopped again")).confirmed
    assert gated.off()
    assert controller.off.call_count == 2
    gate.open()
    assert gated.off()
    assert controller.off.call_count == 3

"""`off` of every controller: never raises, ends in time, and is True only when the instrument has said so."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected, TimedOut
from rig.drivers.controller import OFF_S
from rig.drivers.registry import open_controller
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from tests.rig.drivers.far_ends import Answering
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, Case, controller_on

Attach = Callable[[Instrument], str]


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_a_silent_device(attach: Attach, clock: VirtualClock, case: Case) -> None:
    controller = open_controller(case.driver, attach(Answering()), clock, **case.options)
    with pytest.raises(TimedOut):
        controller.read_temperature()
    begin_s = clock.now_s()
    assert controller.off() is False
    assert clock.now_s() - begin_s < OFF_S + 0.15  # with one time-out more, as docs/safety.md says


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_an_unplugged_device(attach: Attach, clock: VirtualClock, plant: StillPlant, case: Case) -> None:
    controller, wire = controller_on(attach, clock, case, plant, 1, ())
    if controller.commands_current:
        controller.set_current_A(case.strong)
    protocol_sim.unregister("test-0")
    with pytest.raises(Disconnected):
        controller.read_temperature()
    assert controller.off() is False
    protocol_sim.register("test-0", wire, clock)
    assert controller.off() is True
    assert plant.current_A == 0.0


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_a_closed_port(attach: Attach, clock: VirtualClock, plant: StillPlant, case: Case) -> None:
    controller, _ = controller_on(attach, clock, case, plant, 1, ())
    if controller.commands_current:
        controller.set_current_A(case.strong)
    controller.close()
    controller.close()
    assert controller.off() is True
    assert plant.current_A == 0.0

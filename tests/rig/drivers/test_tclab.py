"""The TCLab's driver: options, the second heater, later firmware, a board that listens late."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Disconnected
from rig.drivers.controller import OFF_S
from rig.drivers.registry import open_controller
from rig.ports import protocol_sim
from sim.instruments.instrument import Instrument
from sim.instruments.tclab import DEGC_PER_STEP, TcLab
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


@pytest.fixture
def board(plant: StillPlant) -> TcLab:
    return TcLab(plant)


@pytest.mark.parametrize("options", [{"heater": 3}, {"boot_s": -1.0}])
def test_options_that_it_does_not_take(attach: Attach, clock: VirtualClock, board: TcLab, options: Any) -> None:
    with pytest.raises(ValueError, match="is expected"):
        open_controller("tclab", attach(board), clock, **options)


def test_the_second_heater(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    board = TcLab(plant, heater=2)
    driver = open_controller("tclab", attach(board), clock, heater=2)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(1.0)
    assert board.heaters == {1: 0.0, 2: 100.0}
    assert plant.current_A == pytest.approx(1.0)
    assert board.power_limits[1] <= 100.0  # the fence never raises a limit above the firmware's own
    assert driver.off()
    assert plant.current_A == 0.0


def test_a_stop_does_not_wait_for_a_start(attach: Attach, clock: VirtualClock, board: TcLab, plant: StillPlant) -> None:
    """A board that listens at once (a Leonardo, or one whose port was opened long ago) is off at once."""
    driver = open_controller("tclab", attach(board), clock, boot_s=9.0)
    assert driver.off() is True
    assert clock.now_s() < OFF_S
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(0.5)
    protocol_sim.unregister("test-0")
    with pytest.raises(Disconnected):
        driver.read_temperature()
    protocol_sim.register("test-0", board, clock)
    driver.link.doubt()
    begin_s = clock.now_s()
    driver.read_temperature()  # a STOP may be behind this exchange, which opens the port anew
    assert driver.off() is True
    assert clock.now_s() - begin_s < OFF_S
    assert plant.current_A == 0.0


def test_a_board_that_was_opened_just_now_is_asked_once_more(attach: Attach, clock: VirtualClock, board: TcLab) -> None:
    """An Uno, which the opening has restarted, listens two seconds later; without that no start would come about."""
    heard = board.receive
    board.receive = lambda data, time_s: heard(data, time_s) if time_s > 2.0 else None  # type: ignore[method-assign]
    driver = open_controller("tclab", attach(board), clock)
    assert driver.off() is True
    assert 2.0 < clock.now_s() < 2.0 + OFF_S


def test_a_limit_beyond_full_drive_is_refused(attach: Attach, clock: VirtualClock, board: TcLab) -> None:
    with pytest.raises(ValueError, match="share of full drive"):
        open_controller("tclab", attach(board), clock).configure(1.5, (10.0, 90.0), 5.0)


def test_later_firmware(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    driver = open_controller("tclab", attach(TcLab(plant, version="2.0.1")), clock)
    plant.temperature_degC = 61.7
    assert driver.read_temperature().value == pytest.approx(61.7, abs=DEGC_PER_STEP)
    driver.configure(1.0, (10.0, 90.0), 5.0)
    driver.arm_current()
    driver.set_current_A(0.5)
    assert driver.status().text == "heater 1 at 50 %, heater 2 at 0 %"

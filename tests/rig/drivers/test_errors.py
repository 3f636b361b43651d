"""Errors in words, with what clears them; arming clears what the controller's own dead man left, and nothing else."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Refused
from rig.drivers.meerstetter import meaning_of
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument
from sim.instruments.meerstetter import MeerstetterTec
from sim.instruments.srs_ldc500 import SrsLdc500
from sim.instruments.te_technology import TeTechnology
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
DEAD_MAN_S = 2.0


def configured(attach: Attach, clock: VirtualClock, emulator: Any, driver: str = "meerstetter") -> Any:
    controller = open_controller(driver, attach(emulator), clock)
    controller.configure(2.0, (10.0, 95.0), DEAD_MAN_S)
    return controller


@pytest.mark.parametrize("number", [183, 60])  # 60: as some firmware shows it
@pytest.mark.parametrize("arm", ["arm_current", "arm_setpoint"])
def test_arming_after_the_dead_man_has_fired(attach: Attach, clock: VirtualClock, number: int, arm: str) -> None:
    plant = StillPlant()
    controller = configured(attach, clock, MeerstetterTec(plant, watchdog_error=number))
    controller.arm_current()
    controller.set_current_A(1.0)
    clock.sleep_until_s(clock.now_s() + 3.0 * DEAD_MAN_S)
    status = controller.status()
    assert (status.is_error, status.code, plant.current_A) == (True, number, 0.0)
    assert status.meaning
    assert "--clear" in status.remedy
    getattr(controller, arm)()
    assert controller.status().output_is_on
    limits = controller.own_limits()  # a reset forgets them
    assert (limits.current_A, limits.high_degC, limits.dead_man_s) == (2.0, 95.0, DEAD_MAN_S)


@pytest.mark.parametrize("number", [11, 104, 138])
def test_arming_clears_no_other_error(attach: Attach, clock: VirtualClock, number: int) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator.trip(number)
    with pytest.raises(Refused, match="does not come on") as refused:
        controller.arm_current()
    assert refused.value.code == number
    assert meaning_of(number)[0] in str(refused.value)
    assert emulator.status_until_reset is not None


def test_a_device_that_is_too_hot_is_not_reset(attach: Attach, clock: VirtualClock) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator._measured[1063] = lambda: 71.0
    emulator.trip(60)
    with pytest.raises(Refused, match="too hot"):
        controller.arm_current()
    assert emulator.status_until_reset is not None


def test_clearing_an_error_of_the_device(attach: Attach, clock: VirtualClock) -> None:
    emulator = MeerstetterTec(StillPlant())
    controller = configured(attach, clock, emulator)
    emulator.trip(104)
    controller.clear_error()
    assert not controller.status().is_error
    assert controller.own_limits().dead_man_s == DEAD_MAN_S
    ready = emulator._ready

    def ready_and_tripped(time_s: float) -> None:
        ready(time_s)
        emulator.trip(104)

    emulator._ready = ready_and_tripped  # type: ignore[method-assign]
    with pytest.raises(Refused, match="did not clear"):
        controller.clear_error()


def test_an_unknown_number_is_told_as_one() -> None:
    assert meaning_of(999)[0] == "see the manual"
    assert "shorted" in meaning_of(133)[0]
    assert "open" in meaning_of(134)[0]


def test_srs_forgets_what_was_read(attach: Attach, clock: VirtualClock) -> None:
    controller = configured(attach, clock, SrsLdc500(StillPlant()), "srs_ldc500")
    controller.link.shout("NONSENSE 1")
    clock.sleep_until_s(clock.now_s() + 0.1)
    controller.link.start("TEON?")  # resynchronised, which forgets as well
    controller.link.finish()
    controller.transport.send(b"NONSENSE 1\n")
    clock.sleep_until_s(clock.now_s() + 0.1)
    status = controller.status()
    assert (status.is_error, status.code, status.meaning) == (True, 2, "undefined command")
    assert "forgot it" in status.remedy
    controller.clear_error()
    assert not controller.status().is_error


def test_te_technology_resets_its_latches(attach: Attach, clock: VirtualClock) -> None:
    plant = StillPlant()
    emulator = TeTechnology(plant)
    controller = configured(attach, clock, emulator, "te_technology")
    emulator.values["alarm latch"] = 1
    plant.temperature_degC = 99.0
    clock.sleep_until_s(clock.now_s() + 0.5)
    status = controller.status()
    assert status.is_error
    assert "alarm: high" in status.meaning
    assert "below the high alarm" in status.remedy
    with pytest.raises(Refused, match="did not clear"):
        controller.clear_error()
    plant.temperature_degC = 30.0
    clock.sleep_until_s(clock.now_s() + 0.5)
    controller.clear_error()
    assert not emulator._tripped


def test_a_driver_that_cannot_clear_says_so(attach: Attach, clock: VirtualClock) -> None:
    emulator = TeTechnology(StillPlant(), model="tc-48-20")
    controller = open_controller("te_technology", attach(emulator), clock, model="tc-48-20", units="degC")
    with pytest.raises(Refused, match="at the instrument"):
        controller.clear_error()

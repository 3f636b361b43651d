"""The LDC501's driver: lines of 64 bytes without an end, words and numbers, settings that are refused."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import OutOfStep, Refused
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument
from sim.instruments.srs_ldc500 import SrsLdc500
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]


def test_an_instrument_without_line_ends_is_told_to_use_them(
    plant: StillPlant, attach: Attach, clock: VirtualClock
) -> None:
    for term in (0, 1):
        tec = SrsLdc500(plant, start_s=clock.now_s())
        tec.values["TERM"] = term
        assert open_controller("srs_ldc500", attach(tec), clock).read_temperature().value == 25.0
        assert tec.values["TERM"] == 3


def test_messages_fit_into_the_buffer(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    longest = 0

    class Listener(SrsLdc500):
        def receive(self, data: bytes, time_s: float) -> None:
            nonlocal longest
            longest = max(longest, *(len(line) + 1 for line in data.split(b"\n")))
            super().receive(data, time_s)

    controller = open_controller("srs_ldc500", attach(Listener(plant)), clock, first_token=200)
    controller.identify()
    controller.configure(4.321, (-100.125, 149.125), 0.0)
    controller.arm_current()
    controller.set_current_A(-4.321)
    controller.arm_setpoint()
    controller.set_setpoint_degC(149.123)
    controller.status()
    assert controller.off()
    assert 30 < longest <= 64
    with pytest.raises(ValueError, match="64"):
        controller.link.ask("TTRD?;" * 10)  # type: ignore[attr-defined]


@pytest.fixture
def tec(plant: StillPlant) -> SrsLdc500:
    return SrsLdc500(plant)


@pytest.fixture
def controller(attach: Attach, clock: VirtualClock, tec: SrsLdc500) -> Any:
    return open_controller("srs_ldc500", attach(tec), clock)


def test_positive_heats_however_it_is_wired(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    tec = SrsLdc500(plant, heating_sign=-1)
    controller = open_controller("srs_ldc500", attach(tec), clock, heating_sign=-1)
    controller.configure(2.0, (10.0, 95.0), 5.0)
    controller.arm_current()
    controller.set_current_A(1.5)
    assert (plant.current_A, tec.output_A, controller.read_current().value) == (1.5, -1.5, 1.5)


def test_a_setting_that_is_refused_or_not_kept(controller: Any, tec: SrsLdc500) -> None:
    with pytest.raises(Refused, match="execution error: TMAX") as refused:
        controller.configure(2.0, (10.0, 1000.0), 0.0)
    assert refused.value.code == 1
    tec.change_current_limit = lambda limit_A: None  # type: ignore[method-assign]
    with pytest.raises(Refused, match=r"TILM was set to 3\.0000 and reads 2"):
        controller.configure(3.0, (10.0, 95.0), 0.0)


def test_words_are_understood(controller: Any, tec: SrsLdc500) -> None:
    controller.configure(2.0, (10.0, 95.0), 5.0)
    tec.values["TOKN"] = 1
    controller.arm_setpoint()
    assert controller.status().text == "on, own regulation"
    assert controller.off()
    assert not controller.status().output_is_on


def test_one_that_restarted_is_found_out_by_its_register(controller: Any, tec: SrsLdc500) -> None:
    controller.configure(2.0, (10.0, 95.0), 5.0)
    controller.arm_current()
    tec.switch(0.0)
    tec.values["*ESE"] = 0
    with pytest.raises(OutOfStep):
        controller.set_current_A(1.0)
    with pytest.raises(Refused, match="armed"):
        controller.set_current_A(1.0)

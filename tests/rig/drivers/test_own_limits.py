"""What the instruments hold to by themselves comes through: limits, dead man, ramp; readings that become numbers."""

from __future__ import annotations

import math
from collections.abc import Callable

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, Overrange, Refused, TimedOut
from rig.core.reading import Quality, Reading, missing
from rig.drivers.controller import OwnLimits
from rig.drivers.registry import open_controller
from sim.instruments.instrument import Instrument
from sim.instruments.registry import emulated_controller
from tests.rig.drivers.conversation import Conversation
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import CONTROLLERS, Case

Attach = Callable[[Instrument], str]
NAN = math.nan


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("meerstetter", OwnLimits(3.5, 12.0, 85.0, 4.0, 0.0)),
        ("srs_ldc500", OwnLimits(3.5, 12.0, 85.0)),
        ("te_technology", OwnLimits(low_degC=12.0, high_degC=85.0)),
    ],
)
def test_what_was_configured_is_read_back(
    attach: Attach, clock: VirtualClock, plant: StillPlant, name: str, expected: OwnLimits
) -> None:
    controller = open_controller(name, attach(emulated_controller(name, plant)), clock)
    controller.configure(3.5, (12.0, 85.0), 4.0)
    found = controller.own_limits()
    assert repr(found) == repr(expected)
    assert found.faults(3.5, (12.0, 85.0), 4.0) == []
    assert len(found.faults(3.0, (11.0, 86.0), 5.0)) == sum(
        not math.isnan(value) for value in (found.current_A, found.low_degC, found.high_degC, found.dead_man_s)
    )


def test_a_limit_that_somebody_changed_is_told(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    controller = open_controller("meerstetter", attach(emulated_controller("meerstetter", plant)), clock)
    controller.configure(3.5, (12.0, 85.0), 4.0)
    controller.link.write_float(2060, 0.0)  # type: ignore[attr-defined]
    assert controller.own_limits().faults(3.5, (12.0, 85.0), 4.0) == ["dead man: reads back 0 s, 4 s is configured"]


def test_ramp(attach: Attach, clock: VirtualClock, plant: StillPlant) -> None:
    controller = open_controller("meerstetter", attach(emulated_controller("meerstetter", plant)), clock)
    assert controller.has_ramp
    controller.set_ramp_K_per_s(0.5)
    assert controller.own_limits().ramp_K_per_s == 0.5
    for bad in (-1.0, NAN):
        with pytest.raises(ValueError, match="ramp"):
            controller.set_ramp_K_per_s(bad)
    for name in ("srs_ldc500", "te_technology"):
        other = open_controller(name, attach(emulated_controller(name, plant)), clock)
        assert not other.has_ramp
        with pytest.raises(Refused, match="no ramp"):
            other.set_ramp_K_per_s(0.5)


@pytest.mark.parametrize(
    ("reading", "error"),
    [
        (Reading(math.inf, 0.0, Quality.OVERRANGE), Overrange),
        (missing(0.0), TimedOut),
        (Reading(1.0, 0.0, Quality.STALE), TimedOut),
        (Reading(-1.0, 0.0, Quality.INVALID), Corrupt),
    ],
)
def test_no_number_is_an_error_of_the_tree(reading: Reading, error: type[InstrumentError]) -> None:
    with pytest.raises(error):
        reading.number()
    assert issubclass(error, InstrumentError)


def test_a_number() -> None:
    assert Reading(2.0, 0.0).number() == Reading(2.0, 0.0, Quality.SETTLING).number() == 2.0


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_limits_that_cannot_be_send_nothing(attach: Attach, clock: VirtualClock, case: Case) -> None:
    """A controller with half of a wrong configuration would guard the plate by the limits of somebody else."""
    controller = open_controller(case.driver, attach(silent := Conversation([])), clock, **case.options)
    for current_A, limits_degC in ((0.0, (10.0, 95.0)), (NAN, (10.0, 95.0)), (1.0, (95.0, 10.0)), (1.0, (NAN, 9.0))):
        with pytest.raises(ValueError, match="expected"):
            controller.configure(current_A, limits_degC, 0.0)
    silent.assert_over()


@pytest.mark.parametrize("case", CONTROLLERS, ids=str)
def test_nothing_is_commanded_before_it_is_configured_and_armed(
    attach: Attach, clock: VirtualClock, plant: StillPlant, case: Case
) -> None:
    """Else a current could flow, or a setpoint be held, without limits."""
    emulator = emulated_controller(case.driver, plant, **case.emulator)
    controller = open_controller(case.driver, attach(emulator), clock, **case.options)
    current, setpoint = (lambda: controller.set_current_A(0.1)), (lambda: controller.set_setpoint_degC(30.0))
    for act in (current, setpoint, controller.arm_current, controller.arm_setpoint):
        with pytest.raises((Refused, ValueError)):
            act()
    controller.configure(0.8, (10.0, 95.0), 0.0)
    for act in (current, setpoint):
        with pytest.raises(Refused):
            act()
    assert plant.current_A == 0.0

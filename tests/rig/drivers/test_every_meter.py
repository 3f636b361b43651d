"""What every ohmmeter keeps to: test currents, ranges over a transition, off, settings after a restart."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import InstrumentError, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.registry import open_meter
from sim.instruments.instrument import Instrument
from sim.instruments.registry import emulated_meter
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import METERS, Case

Attach = Callable[[Instrument], str]
pytestmark = pytest.mark.parametrize("case", METERS, ids=str)


@pytest.fixture
def emulator(case: Case, plant: StillPlant) -> Any:
    return emulated_meter(case.driver, plant, **case.emulator)


@pytest.fixture
def meter(case: Case, emulator: Any, attach: Attach, clock: VirtualClock) -> Any:
    return open_meter(case.driver, attach(emulator), clock, **case.options)


def sweep(meter: Any, plant: StillPlant, decades: list[float]) -> None:
    """Read each resistance twice, so that the range has followed."""
    for decade in decades:
        plant.resistance_ohm = 10.0**decade
        assert meter.read().value == pytest.approx(plant.resistance_ohm, rel=1e-6)
        meter.read()


def kept(emulator: Any) -> dict[str, Any]:
    """The settings that stay over a measurement: not the range, and not the token of the line."""
    return {name: value for name, value in emulator.settings.items() if not name.endswith(("RANG", "*ESE"))}


@pytest.mark.parametrize("max_current_A", [1e-3, 1e-4, 1e-5, 5e-6, 1e-6])
def test_the_test_current_never_exceeds_what_is_allowed(meter: Any, plant: StillPlant, max_current_A: float) -> None:
    """A film that takes ten microamperes would be heated, or burnt, by a milliampere."""
    seen: list[float] = []
    plant.set_test_current_A = seen.append  # type: ignore[method-assign]
    meter.configure(True, 0.2, max_current_A)
    if meter.test_current_A in seen:  # before that a meter comes up in its own range
        del seen[: seen.index(meter.test_current_A) + 1]
    for exponent in range(0, 90, 5):
        plant.resistance_ohm = 10.0 ** (8.0 - exponent / 10.0)
        meter.read()
    assert all(current_A <= max_current_A for current_A in seen)
    assert 0.0 < meter.test_current_A <= max_current_A


def test_ranges_follow_the_film_over_its_transition(meter: Any, plant: StillPlant, case: Case) -> None:
    """Else a reading in mid transition is missing, or has three digits."""
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = 1e6
    meter.read()
    decades = [exponent / 10.0 for exponent in range(60, 25, -1)]
    sweep(meter, plant, decades + decades[::-1])
    if "output_between_readings" not in case.options:
        assert plant.test_current_A == meter.test_current_A
    plant.resistance_ohm = math.inf
    assert meter.read().quality is Quality.OVERRANGE


def test_a_meter_that_was_switched_off_gets_its_settings_again(meter: Any, plant: StillPlant, emulator: Any) -> None:
    """It comes back in volts, where a reading would be a number too."""
    meter.configure(True, 0.2, 1e-3)
    assert meter.read().is_number
    before = kept(emulator)
    emulator.reset()
    emulator.remote = False
    with pytest.raises(InstrumentError):
        meter.read()
    assert meter.read().value == pytest.approx(1e4)
    assert kept(emulator) == before


def test_off_takes_the_test_current_away_and_the_next_reading_brings_it_back(meter: Any, plant: StillPlant) -> None:
    meter.configure(True, 0.2, 1e-3)
    meter.read()
    assert meter.off() is True
    assert plant.test_current_A == 0.0
    assert meter.read().value == pytest.approx(1e4)


@pytest.mark.parametrize("nplc", [0.0001, 1e4, math.nan])
def test_an_integration_time_or_a_test_current_that_cannot_be(meter: Any, nplc: float) -> None:
    with pytest.raises(ValueError, match="power line cycles"):
        meter.configure(True, nplc, 1e-3)
    for current_A in (1e-9, math.nan):
        with pytest.raises(ValueError, match="test current"):
            meter.configure(True, 1.0, current_A)


def test_another_instrument_is_refused(meter: Any, emulator: Any) -> None:
    meter.identify()
    emulator.identity = "SOMEBODY ELSE,MODEL 9999,1,2"
    with pytest.raises((Refused, OutOfStep), match="9999"):
        meter.identify()

"""What every ohmmeter keeps to: test currents, ranges over a transition, overrange, the time of a reading, off."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt, InstrumentError, OutOfStep, Refused
from rig.core.reading import Quality
from rig.drivers.meter import on_since_s, reading_in_words
from rig.drivers.registry import open_meter
from sim.instruments.instrument import Instrument, emulated
from tests.rig.drivers.faulty_wire import FaultyWire
from tests.rig.drivers.still_plant import StillPlant
from tests.rig.drivers.wire_cases import METERS, Case

Attach = Callable[[Instrument], str]
pytestmark = pytest.mark.parametrize("case", METERS, ids=str)


@pytest.fixture
def emulator(case: Case, plant: StillPlant) -> Any:
    return emulated(case.driver, plant, **case.emulator)


@pytest.fixture
def meter(case: Case, emulator: Any, attach: Attach, clock: VirtualClock) -> Any:
    return open_meter(case.driver, attach(emulator), clock, **case.options)


def settle(meter: Any) -> None:
    """Read until the range has been found."""
    for _ in range(3):
        meter.read()


def sweep(meter: Any, plant: StillPlant, decades: list[float]) -> None:
    """Read each resistance twice, so that the range has followed."""
    for decade in decades:
        plant.resistance_ohm = 10.0**decade
        assert meter.read().value == pytest.approx(plant.resistance_ohm, rel=1e-6)
        meter.read()


class Rewritten(FaultyWire):
    """A wire on which "beyond the range" is written in other digits."""

    def __init__(self, meter: Any, text: str) -> None:
        super().__init__(meter, seed=0, rate=0.0, foreign=b"", faults=())
        self._text = text.encode()

    def _damage(self, data: bytes, time_s: float) -> None:
        self._send(time_s, re.sub(rb"\+?9\.90*E\+37", self._text, data))


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


IDENTITIES = {
    "keithley2000": "Keithley 2000, serial number 1234567, firmware A20  /A02",
    "hp34401a": "HP 34401A, serial number 0, firmware 11-5-2",
    "keithley2400": "Keithley 2400, serial number 1234567, firmware C30",
    "keithley2450": "Keithley 2450, serial number 04096331, firmware 1.7.0e",
}


def test_it_says_who_it_is_and_another_instrument_is_refused(meter: Any, emulator: Any, case: Case) -> None:
    assert str(meter.identify()).startswith(IDENTITIES.get(case.driver, ""))
    emulator.identity = "SOMEBODY ELSE,MODEL 9999,1,2"
    with pytest.raises((Refused, OutOfStep), match="9999"):
        meter.identify()


@pytest.mark.parametrize("four_wire", [True, False])
def test_it_is_configured_as_it_was_asked_to_be(meter: Any, emulator: Any, plant: StillPlant, four_wire: bool) -> None:
    meter.configure(four_wire, 0.2, 1e-3)
    settings, source = emulator.settings, "OUTP" in emulator.settings
    function = "RES" if source or not four_wire else "FRES"
    assert settings.get(f"{function}:NPLC", settings.get("NPLC")) == 0.2
    assert settings[f"{function}:RANG:AUTO"] == 0
    if source:
        assert settings.get("RES:RSEN", settings.get("RSEN")) == int(four_wire)
        assert (plant.test_current_A, settings["OUTP"]) == (0.0, 0)
    else:
        assert emulator.function == function


def test_the_first_reading_after_a_change_of_range_is_settling(meter: Any, plant: StillPlant) -> None:
    """Its test current has just changed, and the film's self-heating with it."""
    meter.configure(True, 1.0, 1e-3)
    settle(meter)
    plant.resistance_ohm = meter.full_scale / 20
    assert [meter.read().quality for _ in range(3)] == [Quality.OK, Quality.SETTLING, Quality.OK]
    plant.resistance_ohm = 3 * meter.full_scale
    reading = meter.read()
    assert (reading.value, reading.quality) == (math.inf, Quality.OVERRANGE)
    assert "the next one is tried" in reading_in_words(reading, meter)
    assert meter.read().value == pytest.approx(plant.resistance_ohm)


@pytest.mark.parametrize("resistance_ohm", [-5.0, 0.0, math.nan])
def test_an_impossible_resistance_is_invalid(meter: Any, plant: StillPlant, resistance_ohm: float) -> None:
    meter.configure(True, 1.0, 1e-3)
    settle(meter)
    plant.resistance_ohm = resistance_ohm
    reading = meter.read()
    if "34401" in meter.NAME and math.isnan(resistance_ohm):
        assert reading.quality is Quality.OVERRANGE  # it has one text for both
        return
    assert reading.quality is Quality.INVALID
    assert "invalid" in reading_in_words(reading, meter)


@pytest.mark.parametrize("text", ["+9.9E37", "9.9E37", "+9.9E+37", "+9.900000e+37", "-9.90000000E+37", "+9.9X37"])
def test_an_open_film_is_told_as_that_in_whatever_digits(
    case: Case, emulator: Any, attach: Attach, clock: VirtualClock, plant: StillPlant, text: str
) -> None:
    meter = open_meter(case.driver, attach(Rewritten(emulator, text)), clock, **case.options)
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = math.inf
    if "X" in text:
        with pytest.raises(Corrupt):
            meter.read()
        return
    for _ in range(8):
        reading = meter.read()
        assert reading.quality is Quality.OVERRANGE
        assert reading.value == (-math.inf if text.startswith("-") else math.inf)
    assert "the film is open or not connected" in reading_in_words(reading, meter)


def test_its_time_is_the_middle_of_the_integration(meter: Any, plant: StillPlant, clock: VirtualClock) -> None:
    meter.configure(True, 1.0, 1e-3)
    settle(meter)
    clock.sleep_until_s(10.0)
    reading = meter.read()
    assert reading.time_s == pytest.approx(plant.sampled_s, abs=2e-3)
    assert 10.01 < reading.time_s < 10.07


@pytest.mark.parametrize("later_s", [0.2, 5.0])
def test_a_reading_waits_for_whoever_has_other_things_to_do(meter: Any, clock: VirtualClock, later_s: float) -> None:
    """A controller that is silent keeps the loop from its meter for longer than an answer may take."""
    meter.configure(True, 1.0, 1e-3)
    settle(meter)
    begin_s = clock.now_s()
    meter.start_reading()
    assert clock.now_s() - begin_s < (0.2 if hasattr(meter, "_stays_on") else 1e-9)
    clock.sleep_until_s(begin_s + later_s)
    assert meter.finish_reading().value == pytest.approx(1e4)
    assert clock.now_s() == begin_s + later_s


def test_readings_cannot_be_mixed_up(meter: Any) -> None:
    meter.configure(True, 1.0, 1e-3)
    with pytest.raises(OutOfStep):
        meter.finish_reading()
    meter.start_reading()
    with pytest.raises(OutOfStep):
        meter.start_reading()
    assert meter.read().is_number


def test_it_is_known_since_when_the_test_current_of_a_new_range_is_on(meter: Any, plant: StillPlant) -> None:
    meter.configure(True, 1.0, 1e-3)
    settle(meter)
    plant.resistance_ohm = meter.full_scale / 20
    meter.off()
    meter.read()
    assert math.isnan(on_since_s(meter))
    changed = meter.read()
    on_s = on_since_s(meter)
    assert changed.time_s - on_s == pytest.approx(0.01)  # half of a line's period: the integration begins with it
    meter.read()
    assert on_since_s(meter) == on_s


class AlwaysOn(dict[str, Any]):
    """Settings of a meter whose output stays on."""

    def __setitem__(self, name: str, value: Any) -> None:
        super().__setitem__(name, 1 if name == "OUTP" else value)


def test_off_is_not_confirmed_by_a_meter_that_goes_on(meter: Any, emulator: Any) -> None:
    meter.configure(True, 0.2, 1e-3)
    meter.read()
    if "OUTP" in emulator.settings:
        emulator.settings = AlwaysOn(emulator.settings, OUTP=1)
    else:
        emulator.choose_function = lambda function: None
    assert meter.off() is False

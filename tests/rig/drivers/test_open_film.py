"""A film that is open or not connected is told as that, in whatever digits the meter writes "beyond the range"."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import pytest

from rig.core.clock import VirtualClock
from rig.core.errors import Corrupt
from rig.core.reading import Quality, Reading
from rig.drivers.meter import reading_in_words
from rig.drivers.registry import open_meter
from sim.instruments.instrument import Instrument
from sim.instruments.registry import emulated_meter
from tests.rig.drivers.still_plant import StillPlant

Attach = Callable[[Instrument], str]
METERS = ("keithley2000", "hp34401a", "keithley2400")
BEYOND = ("+9.9E37", "+9.90000000E+37", "9.9E37", "+9.9E+37", "+9.900000e+37", "-9.9E37", "-9.90000000E+37")


class Rewritten:
    """A meter that writes "beyond the range" in other digits."""

    def __init__(self, meter: Any, text: str) -> None:
        self._meter, self._text = meter, text.encode()

    def receive(self, data: bytes, time_s: float) -> None:
        self._meter.receive(data, time_s)

    def transmit(self, time_s: float) -> bytes:
        data: bytes = self._meter.transmit(time_s)
        for usual in (b"+9.90000000E+37", b"+9.900000E+37", b"+9.9E37"):
            data = data.replace(usual, self._text)
        return data

    def next_transmit_s(self) -> float | None:
        due: float | None = self._meter.next_transmit_s()
        return due


@pytest.mark.parametrize("text", BEYOND)
@pytest.mark.parametrize("driver", METERS)
def test_an_open_film_is_told_as_that(attach: Attach, clock: VirtualClock, driver: str, text: str) -> None:
    plant = StillPlant()
    meter = open_meter(driver, attach(Rewritten(emulated_meter(driver, plant), text)), clock)
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = math.inf
    for _ in range(8):
        reading = meter.read()
        assert reading.quality is Quality.OVERRANGE
        assert reading.value == (-math.inf if text.startswith("-") else math.inf)
    assert "the film is open or not connected" in reading_in_words(reading, meter)


@pytest.mark.parametrize("driver", METERS)
def test_garbage_is_still_none(attach: Attach, clock: VirtualClock, driver: str) -> None:
    plant = StillPlant()
    meter = open_meter(driver, attach(Rewritten(emulated_meter(driver, plant), "+9.9X37")), clock)
    meter.configure(True, 1.0, 1e-3)
    plant.resistance_ohm = math.inf
    with pytest.raises(Corrupt):
        meter.read()


def test_words_for_readings(attach: Attach, clock: VirtualClock) -> None:
    plant = StillPlant()
    meter = open_meter("keithley2000", attach(emulated_meter("keithley2000", plant)), clock)
    meter.configure(True, 1.0, 1e-3)
    assert reading_in_words(meter.read(), meter) == ""
    plant.resistance_ohm = 3e6
    assert "the next one is tried" in reading_in_words(meter.read(), meter)
    assert "invalid" in reading_in_words(Reading(math.nan, 0.0, Quality.INVALID), meter)

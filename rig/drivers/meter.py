"""What every driver of a meter provides, whatever its protocol; and what its numbers mean.

A meter reads the film's resistance, or a voltage that stands for another quantity: a position-sensitive detector's for
a cantilever's curvature (`rig.drivers.formula_meter`). Either way it has one film output, as a film model names it.
"""

from __future__ import annotations

from math import copysign, inf, isfinite, log10, nan
from typing import ClassVar, Protocol

from rig.core.reading import Quality, Reading
from rig.drivers.identity import Identity
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

OVERFLOW = 9.8e37  # SCPI's sentinels are 9.9E37 (infinity) and 9.91E37 (not a number)
NOT_A_NUMBER = 9.905e37
LINE_PERIOD_S = 1.0 / 50.0  # of the power line, in which integrations are told: the longer of 50 and 60 Hz
LOG_RESISTANCE = "minus_log10_ohm"  # the film's output where the meter reads ohms: -log10(R / 1 ohm)
MOST_RANGES = 8  # of a meter: none has more


class Meter(Protocol):
    """Reads what the film shows.

    output: the film's output that it reads, by its name and unit in a model file; "minus_log10_ohm" where readings
    are in ohm, otherwise readings are in the unit that the name ends with. test_current_A: of the range in use, nan
    where it is not known. full_scale: of the range in use, in the unit of what is measured (ohm or V), nan before
    `configure`. All methods but `off` and `close` raise `rig.core.errors.InstrumentError`.
    """

    LINE: ClassVar[LineSettings]
    transport: Transport

    @property
    def output(self) -> str:
        """Name and unit of the film's output."""

    @property
    def test_current_A(self) -> float:
        """Current that the last reading was taken with, A."""

    @property
    def full_scale(self) -> float:
        """Of the range that the last reading was taken in, ohm or V."""

    def identify(self) -> Identity:
        """Who it is; Refused where it is no instrument of this driver's family."""

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Function, integration time in power line cycles, ranges by test current; Refused."""

    def start_reading(self) -> None:
        """Begin a reading; returns before it is there."""

    def finish_reading(self) -> Reading:
        """The reading that was begun."""

    def read(self) -> Reading:
        """Begin a reading and wait for it."""

    def off(self) -> bool:
        """Stop the test current until the next reading; True only if the meter reads back that it has. Never raises."""

    def close(self) -> None:
        """Let go of the port; a meter that sources its test current stops it first. Never raises."""


ResistanceMeter = Meter  # what reads ohms


def column_of(output: str) -> str:
    """The record's column that holds a meter's readings."""
    return "resistance_ohm" if output == LOG_RESISTANCE else output


def film_output(output: str, reading: Reading | None) -> float:
    """The film's output that a reading stands for; nan where it is no number, or a resistance that is not positive."""
    if reading is None or not reading.is_number:
        return nan
    if output != LOG_RESISTANCE:
        return reading.value
    return -log10(reading.value) if reading.value > 0.0 else nan


def on_since_s(meter: Meter | None) -> float:
    """When the test current of the range in use came on, where the driver knows it (ranges that it changed itself); nan
    where it does not."""
    return float(getattr(meter, "test_current_on_s", nan))


def settled_reading(meter: Meter) -> Reading:
    """A reading after the meter has found its range, or that none is high enough."""
    for _ in range(MOST_RANGES):
        if meter.read().is_number:
            break
    return meter.read()


def reading_in_words(reading: Reading, meter: Meter) -> str:
    """What is wrong with a meter's reading, for people; empty where it is a number.

    What is beyond the highest range of an ohmmeter is named as what it is: a film that is open or not connected.
    """
    if reading.is_number:
        return ""
    if reading.quality is not Quality.OVERRANGE:
        return f"the meter's reading is {reading.quality}"
    if meter.output != LOG_RESISTANCE:
        return f"beyond the meter's range of {meter.full_scale:g} V"
    if getattr(meter, "in_highest_range", True):
        return f"the film is open or not connected: beyond the highest range, {meter.full_scale:g} ohm"
    return f"beyond the range of {meter.full_scale:g} ohm; the next one is tried"


def resistance_reading(value_ohm: float, time_s: float, largest_ohm: float) -> Reading:
    """A resistance from a meter: as `voltage_reading`, and nothing or less is `INVALID`."""
    reading = voltage_reading(value_ohm, time_s, largest_ohm)
    return Reading(value_ohm, time_s, Quality.INVALID) if reading.is_number and value_ohm <= 0.0 else reading


def voltage_reading(value_V: float, time_s: float, largest_V: float) -> Reading:
    """A number from a meter, judged by magnitude and sign.

    SCPI's +-9.9E37 is beyond the range (+-inf, `OVERRANGE`); its 9.91E37, any nan, and more than the range can show
    are `INVALID`.
    """
    if OVERFLOW <= abs(value_V) < NOT_A_NUMBER:
        return Reading(copysign(inf, value_V), time_s, Quality.OVERRANGE)
    if not isfinite(value_V) or abs(value_V) >= NOT_A_NUMBER:
        return Reading(nan, time_s, Quality.INVALID)
    return Reading(value_V, time_s, Quality.OK if abs(value_V) <= largest_V else Quality.INVALID)

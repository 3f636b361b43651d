"""A meter: what the rig asks of every driver, and what its numbers mean.

A meter reads the film's resistance, or a voltage that stands for another quantity, such as a position-sensitive
detector's for a cantilever's curvature (`rig.drivers.formula`). Either way it has one film output, as a film model
names it.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import copysign, inf, isfinite, isnan, log10, nan
from typing import Any, ClassVar

from rig.core.errors import Refused
from rig.core.reading import Quality, Reading
from rig.drivers.identity import Identity
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

OVERFLOW = 9.8e37  # SCPI's sentinels are 9.9E37 (infinity) and 9.91E37 (not a number)
NOT_A_NUMBER = 9.905e37
LINE_PERIOD_S = 1.0 / 50.0  # of the power line, in which integrations are counted: the longer of 50 and 60 Hz
LOG_RESISTANCE = "minus_log10_ohm"  # the film's output if the meter reads ohms: -log10(R / 1 ohm)
MOST_RANGES = 8  # of a meter: none has more


@dataclass(frozen=True)
class Averaging:
    """A meter's own repeating filter: a reading is the mean of `count` integrations, one after the other.

    Such a filter fills its stack anew for every reading, so that no reading has a share of the one before. The mean of
    k has 1 / sqrt(k) of the noise and takes k times as long. each_s: from the beginning of one integration to that of
    the next, as it was measured, s; nan: not known, and taken for the integration alone.
    """

    count: int = 1
    each_s: float = nan

    def middle_s(self, aperture_s: float) -> float:
        """Return the time from the beginning of the first integration, of aperture_s, to the middle of all, s."""
        each_s = aperture_s if isnan(self.each_s) else max(self.each_s, aperture_s)
        return 0.5 * (aperture_s + (self.count - 1) * each_s)


class Meter:
    """A driver that reads the film's output.

    output: the film's output that it reads, by its name and unit in a model file; "minus_log10_ohm" if readings are in
    ohm, otherwise readings are in the unit that the name ends with. test_current_A: of the range in use, nan if it is
    not known. full_scale: of the range in use, in ohm or V, nan before `configure`. All methods but `off` and `close`
    raise `rig.core.errors.InstrumentError`. A user-defined driver need not inherit from this class.
    """

    LINE: ClassVar[LineSettings]
    transport: Transport

    @property
    def output(self) -> str:
        """Return name and unit of the film's output."""
        raise NotImplementedError

    @property
    def test_current_A(self) -> float:
        """Return the current that the last reading was taken with, A."""
        raise NotImplementedError

    @property
    def full_scale(self) -> float:
        """Return the full scale of the range that the last reading was taken in, ohm or V."""
        raise NotImplementedError

    def identify(self) -> Identity:
        """Return the identity; Refused if it is no instrument of this driver's family."""
        raise NotImplementedError

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Set function, integration time in power line cycles, and ranges by test current; Refused."""
        raise NotImplementedError

    def start_reading(self) -> None:
        """Begin a reading; return before it is there."""
        raise NotImplementedError

    def finish_reading(self) -> Reading:
        """Return the reading that was begun."""
        raise NotImplementedError

    def read(self) -> Reading:
        """Begin a reading and wait for it."""
        self.start_reading()
        return self.finish_reading()

    def off(self) -> bool:
        """Stop the test current until the next reading; return True only if that reads back. Never raises."""
        raise NotImplementedError

    def close(self) -> None:
        """Let go of the port; a meter that sources its test current stops it first. Never raises."""
        self.transport.close()


ResistanceMeter = Meter  # that reads ohms


def average(meter: Any, averaging: Averaging) -> None:
    """Let every reading of the meter be such a mean from now on; Refused if it has no filter; InstrumentError."""
    own = getattr(meter, "average", None)
    if own is None:
        raise Refused(None, "the meter does not average its readings itself")
    own(averaging)


def column_of(output: str) -> str:
    """Return the record's column that holds a meter's readings."""
    return "resistance_ohm" if output == LOG_RESISTANCE else output


def film_output(output: str, reading: Reading | None) -> float:
    """Return the film's output of a reading; nan if it is no number, or a resistance that is not positive."""
    if reading is None or not reading.is_number:
        return nan
    if output != LOG_RESISTANCE:
        return reading.value
    return -log10(reading.value) if reading.value > 0.0 else nan


def on_since_s(meter: Meter | None) -> float:
    """Return when the test current of the range in use came on; nan if the driver does not know it.

    A driver knows it of ranges that it changed itself.
    """
    return float(getattr(meter, "test_current_on_s", nan))


def settled_reading(meter: Meter) -> Reading:
    """Return a reading after the meter has found its range, or that no range is high enough."""
    for _ in range(MOST_RANGES):
        if meter.read().is_number:
            break
    return meter.read()


def reading_in_words(reading: Reading, meter: Meter) -> str:
    """Return in words why a meter's reading is no number; empty if it is one.

    Beyond the highest range of an ohmmeter the words name the cause: a film that is open or not connected.
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
    """Return a reading of a resistance, judged as by `voltage_reading`; 0 or less is `INVALID`."""
    reading = voltage_reading(value_ohm, time_s, largest_ohm)
    return Reading(value_ohm, time_s, Quality.INVALID) if reading.is_number and value_ohm <= 0.0 else reading


def voltage_reading(value_V: float, time_s: float, largest_V: float) -> Reading:
    """Return a reading of a meter's number, judged by magnitude and sign.

    SCPI's +-9.9E37 is beyond the range (+-inf, `OVERRANGE`); its 9.91E37, any nan, and more than the range can show
    are `INVALID`.
    """
    if OVERFLOW <= abs(value_V) < NOT_A_NUMBER:
        return Reading(copysign(inf, value_V), time_s, Quality.OVERRANGE)
    if not isfinite(value_V) or abs(value_V) >= NOT_A_NUMBER:
        return Reading(nan, time_s, Quality.INVALID)
    return Reading(value_V, time_s, Quality.OK if abs(value_V) <= largest_V else Quality.INVALID)

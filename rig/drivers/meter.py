"""What the rig asks of an ohmmeter, whatever its protocol; and what its numbers mean."""

from __future__ import annotations

from math import inf, isfinite, nan
from typing import ClassVar, Protocol

from rig.drivers.identity import Identity
from rig.ports.open import LineSettings
from rig.ports.transport import Transport
from rig.reading import Quality, Reading

OVERFLOW_OHM = 9.8e37  # SCPI's sentinels are 9.9E37 (infinity) and 9.91E37 (not a number)
NOT_A_NUMBER_OHM = 9.905e37


class ResistanceMeter(Protocol):
    """Reads the film's resistance.

    test_current_A: of the range in use, nan where it is not known. All methods but `off` and `close` raise
    `rig.errors.InstrumentError`. A meter of another quantity (a voltage that stands for a curvature) is another
    protocol, which `Reading` can carry as well: its unit is that of the method.
    """

    LINE: ClassVar[LineSettings]
    transport: Transport

    @property
    def test_current_A(self) -> float:
        """Current that the last reading was taken with, A."""

    def identify(self) -> Identity:
        """Who it is; Refused where it is no instrument of this driver's family."""

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Function, integration time in power line cycles, ranges by test current; Refused."""

    def start_reading(self) -> None:
        """Begin a reading; returns before it is there."""

    def finish_reading(self) -> Reading:
        """The reading that was begun, ohm."""

    def read_resistance(self) -> Reading:
        """Begin a reading and wait for it, ohm."""

    def off(self) -> bool:
        """Stop the test current until the next reading; True only if the meter reads back that it has. Never raises."""

    def close(self) -> None:
        """Let go of the port; a meter that sources its test current stops it first. Never raises."""


def resistance_reading(value_ohm: float, time_s: float, largest_ohm: float) -> Reading:
    """A number from a meter, judged by magnitude and sign.

    SCPI's +9.9E37 is beyond the range (inf, `OVERRANGE`); its 9.91E37, any nan, nothing or less, and more
    than the range can show are `INVALID`.
    """
    if OVERFLOW_OHM <= value_ohm < NOT_A_NUMBER_OHM:
        return Reading(inf, time_s, Quality.OVERRANGE)
    if not isfinite(value_ohm) or abs(value_ohm) >= NOT_A_NUMBER_OHM:
        return Reading(nan, time_s, Quality.INVALID)
    if not 0.0 < value_ohm <= largest_ohm:
        return Reading(value_ohm, time_s, Quality.INVALID)
    return Reading(value_ohm, time_s)

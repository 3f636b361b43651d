"""A meter whose voltage stands for another quantity, such as a position-sensitive detector's for a curvature.

Its readings are the quantity's, in the unit that the output's name ends with; time and quality are the voltage's, and a
voltage to which the formula gives no value is `INVALID`. Beyond the meter's range the quantity is nan: the formula need
not be monotone, so that not even its sign is known.
"""

from __future__ import annotations

import re
from math import isnan, nan
from typing import ClassVar, Protocol

from rig.core.reading import Quality, Reading
from rig.drivers.averaging import Averaging, average
from rig.drivers.formula import Formula, formula
from rig.drivers.identity import Identity
from rig.drivers.meter import LOG_RESISTANCE, Meter
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

OUTPUT_NAME = re.compile(r"[a-z][a-z0-9]*(_[A-Za-z0-9]+)+")
TAKEN = ("minus_log10_ohm", "resistance_ohm", "temperature_degC", "current_A", "meter_current_A", "time_s")


class VoltageMeter(Meter, Protocol):
    """A meter that reads volts as well."""

    def configure_voltage(self, nplc: float, range_V: float, four_wire: bool = False) -> None:
        """DC volts in a range that has `range_V`."""


class FormulaMeter:
    """See `rig.drivers.meter.Meter`. output: the quantity's name and unit; text: its formula; range_V: the meter's."""

    LINE: ClassVar[LineSettings] = LineSettings()

    def __init__(self, meter: VoltageMeter, output: str, text: str, range_V: float = 10.0) -> None:
        check_output(output)
        self.meter = meter
        self.transport: Transport = meter.transport
        self.formula: Formula = formula(text)
        self._output, self._range_V = output, range_V

    @property
    def output(self) -> str:
        """Name and unit of the quantity."""
        return self._output

    @property
    def test_current_A(self) -> float:
        """None flows, A."""
        return self.meter.test_current_A

    @property
    def full_scale(self) -> float:
        """Of the voltage range, V."""
        return self.meter.full_scale

    def identify(self) -> Identity:
        """Who the meter is."""
        return self.meter.identify()

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """DC volts in the given range, with this integration time; wires and test current do not matter."""
        self.meter.configure_voltage(nplc, self._range_V)

    def average(self, averaging: Averaging) -> None:
        """Every reading is the formula of such a mean of voltages. Refused by a meter that has no filter."""
        average(self.meter, averaging)

    def start_reading(self) -> None:
        """Begin a reading."""
        self.meter.start_reading()

    def finish_reading(self) -> Reading:
        """The quantity that the voltage stands for, in the output's unit."""
        voltage = self.meter.finish_reading()
        value = self.formula(voltage.value) if voltage.is_number else nan
        return Reading(
            value, voltage.time_s, Quality.INVALID if voltage.is_number and isnan(value) else voltage.quality
        )

    def read(self) -> Reading:
        """Begin a reading and wait for it."""
        self.start_reading()
        return self.finish_reading()

    def off(self) -> bool:
        """There is no test current; the meter is asked all the same."""
        return self.meter.off()

    def close(self) -> None:
        """Let go of the port."""
        self.meter.close()


def check_output(output: str) -> None:
    """ValueError where `output` is no name with a unit, or that of something else."""
    if output in TAKEN or output == LOG_RESISTANCE or OUTPUT_NAME.fullmatch(output) is None:
        raise ValueError(f"output {output!r}: a name and its unit are expected, as in 'curvature_per_m'")

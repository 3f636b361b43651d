"""Keithley 2000 multimeter as an ohmmeter on its RS-232 port.

Source: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63. Test currents are NOT verified on an instrument.

The instrument's own autorange would pick the test current by itself; here the driver picks the range, so
that the test current never exceeds what was allowed and is known for every reading. A reading asks for its
value twice (`READ?` and `FETCh?`): where there is no checksum, repetition has to do, and a flipped digit is
no wrong number.

Set the instrument to RS-232 at 19200 Bd with LF (or CRLF) at its front panel; from the factory it listens
to GPIB.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from math import isfinite, nan
from types import MappingProxyType
from typing import ClassVar

from rig.drivers.identity import Identity
from rig.drivers.meter import resistance_reading
from rig.drivers.scpi import ScpiLink
from rig.errors import Corrupt, OutOfStep, Refused
from rig.ports.open import LineSettings
from rig.ports.transport import Transport
from rig.reading import Quality, Reading

# full scale, ohm -> test current, A; not verified on an instrument
TEST_CURRENTS_A: Mapping[float, float] = MappingProxyType(
    {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 1e-5, 1e7: 0.7e-6, 1e8: 0.7e-6}
)
OVERRANGE = 1.2  # a range shows up to 120 % of its full scale
RANGE_UP, RANGE_DOWN = 0.95, 0.08  # of full scale, where the driver changes the range, ahead of the overrange
LINE_PERIOD_S = 1.0 / 50.0  # the longer of 50 and 60 Hz
COMMAND_S = 0.002  # from the terminator to the beginning of the integration, nominal
APERTURES, MARGIN_S = 4.0, 0.3  # an answer may take as many integrations (auto-zero adds some), and the rest
NUMBER = re.compile(r"[+-]\d\.\d{4,10}E[+-]\d\d")


class Keithley2000Meter:
    """See `rig.drivers.meter.ResistanceMeter`. first_range_ohm: where ranging begins."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=19200)

    def __init__(
        self,
        transport: Transport,
        *,
        test_currents_A: Mapping[float, float] = TEST_CURRENTS_A,
        first_range_ohm: float = 1e5,
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self.link = ScpiLink(
            transport,
            baudrate=self.LINE.baudrate,
            first_token=first_token,
            after_resynchronisation=self._look_after_doubt,
        )
        self._test_currents_A = dict(sorted(test_currents_A.items()))
        self._first_range_ohm = first_range_ohm
        self._ranges: list[float] = []
        self._index = 0
        self._chosen = 0
        self._function = ""
        self._nplc = nan
        self._settling = False
        self._looking = False

    @property
    def test_current_A(self) -> float:
        """Of the range that the last reading was taken in, A; nan before `configure`."""
        return self._test_currents_A[self._ranges[self._index]] if self._ranges else nan

    @property
    def range_ohm(self) -> float:
        """Full scale of that range, ohm."""
        return self._ranges[self._index] if self._ranges else nan

    def identify(self) -> Identity:
        """`*IDN?`; Refused where it is no Keithley 2000."""
        maker, model, serial_number, firmware = (
            part.strip() for part in (self.link.ask_alone("*IDN?") + ",,,").split(",")[:4]
        )
        if "KEITHLEY" not in maker.upper() or "2000" not in model:
            raise Refused(None, f"{maker!r} {model!r} is no Keithley 2000")
        return Identity("Keithley", model.removeprefix("MODEL").strip(), serial_number, firmware)

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Function, NPLC 0.01..10, ranges whose test current is allowed; Refused if it reads back else."""
        if not 0.01 <= nplc <= 10.0:
            raise ValueError(f"{nplc} power line cycles: 0.01 to 10 is expected")
        allowed = [ohm for ohm, current_A in self._test_currents_A.items() if current_A <= max_test_current_A]
        if not allowed:
            least_A = min(self._test_currents_A.values())
            raise ValueError(f"a test current of {max_test_current_A} A is below the least, {least_A} A")
        self._ranges = []
        if self.link.in_doubt:
            self.link.resynchronise()
        self._function = "FRES" if four_wire else "RES"
        self._nplc = nplc
        self._ranges = allowed
        self._index = self._chosen = min(
            range(len(allowed)), key=lambda index: abs(allowed[index] - self._first_range_ohm)
        )
        try:
            self._apply()
        except BaseException:
            self._ranges = []  # half configured is not configured
            raise

    def start_reading(self) -> None:
        """Begin a reading; where the last one asked for another range, change it first."""
        if not self._ranges:
            raise Refused(None, "the meter is not configured yet")
        message = ":READ?;:FETC?"
        self._settling = self._chosen != self._index
        if self._settling:
            full_scale_ohm = self._ranges[self._chosen]
            header = f":SENS:{self._function}:RANG"
            message = f"{header} {full_scale_ohm:.0f};{header}?;{message}"
        self.link.start(message, APERTURES * self._nplc * LINE_PERIOD_S + MARGIN_S)
        self._index = self._chosen

    def finish_reading(self) -> Reading:
        """The reading that was begun, ohm; `time_s` is the middle of the integration."""
        time_s = self.link.arrived_s + COMMAND_S + 0.5 * self._nplc * LINE_PERIOD_S
        *before, first, second = ("", *self.link.finish().split(";"))
        if first != second or NUMBER.fullmatch(first) is None:
            self.link.doubt()
            raise Corrupt(f"{first!r} and {second!r} are not twice the same reading")
        full_scale_ohm = self._ranges[self._index]
        if self._settling and (len(before) != 2 or not _is(before[1], full_scale_ohm)):
            self.link.doubt()
            raise OutOfStep(f"range {full_scale_ohm:g} ohm was asked for, and {before[1:]} came back")
        reading = resistance_reading(float(first), time_s, 1.05 * OVERRANGE * full_scale_ohm)
        self._choose_next_range(reading)
        if self._settling and reading.quality is Quality.OK:
            return Reading(reading.value, time_s, Quality.SETTLING)
        return reading

    def read_resistance(self) -> Reading:
        """Begin a reading and wait for it, ohm."""
        self.start_reading()
        return self.finish_reading()

    def close(self) -> None:
        """Let go of the port."""
        self.transport.close()

    def _choose_next_range(self, reading: Reading) -> None:
        index = self._index
        if reading.quality is Quality.OVERRANGE:
            self._chosen = min(index + 1, len(self._ranges) - 1)
        elif reading.quality is Quality.OK:
            value_ohm = reading.value
            while index + 1 < len(self._ranges) and value_ohm > RANGE_UP * self._ranges[index]:
                index += 1
            while index > 0 and value_ohm < RANGE_DOWN * self._ranges[index]:
                index -= 1
            self._chosen = index

    def _apply(self) -> None:
        """Send all settings and read them back."""
        sense = f":SENS:{self._function}"
        full_scale_ohm = self._ranges[self._chosen]
        self.link.command(f":CONF:{self._function};:INIT:CONT 0;:TRIG:COUN 1;{sense}:NPLC {self._nplc:g}")
        self.link.command(f"{sense}:RANG:AUTO 0;{sense}:RANG {full_scale_ohm:.0f}")
        self._index = self._chosen
        settings = self._settings()
        if not self._as_configured(settings):
            raise Refused(None, f"the meter reads back {settings}")

    def _settings(self) -> list[str]:
        sense = f":SENS:{self._function}"
        return self.link.ask(f":SENS:FUNC?;{sense}:NPLC?;{sense}:RANG:AUTO?;{sense}:RANG?").split(";")

    def _as_configured(self, settings: list[str]) -> bool:
        if len(settings) != 4:
            return False
        function, nplc, automatic, full_scale_ohm = settings
        return (
            function.strip("\"'") == self._function
            and _is(nplc, self._nplc)
            and _is(automatic, 0.0)
            and _is(full_scale_ohm, self._ranges[self._index])
        )

    def _look_after_doubt(self) -> None:
        """A meter that was switched off in between has forgotten its settings: give them again."""
        if not self._ranges or self._looking:
            return
        self._looking = True
        try:
            if not self._as_configured(self._settings()):
                self._apply()
        finally:
            self._looking = False


def _is(text: str, value: float) -> bool:
    """Whether `text` is the number `value`, to the digits in which instruments answer."""
    try:
        number = float(text)
    except ValueError:
        return False
    return isfinite(number) and abs(number - value) <= 1e-3 * abs(value) + 1e-9

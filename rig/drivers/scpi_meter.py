"""What SCPI meters have in common: resistance ranges by test current, a voltage range, a reading that is given twice.

The instrument's own autorange would pick the test current by itself; here the driver picks the range, so
that the test current never exceeds what was allowed and is known for every reading. A reading asks for its
value twice: where there is no checksum, repetition has to do, and a flipped digit is no wrong number.

Residual: a corruption that changes both copies alike, and leaves the token as it is. For bursts shorter than the
distance of the copies (a dozen characters) two of them are needed, with the same change at the same place: for random
bursts at a share p of the answers, less than p^2 / 16 / 256, 16 for the place and 256 for the new character.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from math import isfinite, isnan, nan
from typing import Any, ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused
from rig.core.reading import Quality, Reading
from rig.drivers.asked_again import asked_again
from rig.drivers.averaging import Averaging
from rig.drivers.confirmed import confirmed
from rig.drivers.identity import Identity
from rig.drivers.meter import LINE_PERIOD_S, LOG_RESISTANCE, resistance_reading, voltage_reading
from rig.drivers.scpi import ScpiLink
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

RANGE_UP, RANGE_DOWN = 0.95, 0.08  # of full scale, where the driver changes the range, ahead of the overrange
RESOLVED = 300.0  # of a range's full scale: below that share bench meters are sure of a reading to 0.3 % at best
COMMAND_S = 0.002  # from the terminator to the beginning of the integration, nominal
APERTURES, MARGIN_S = 4.0, 0.3  # an answer may take as many integrations (auto-zero adds some), and the rest
OFF_ATTEMPTS = 3
BEYOND = re.compile(r"[+-]?9\.9\d*[Ee]\+?37")  # 9.9E37 and 9.91E37 with as many digits as an instrument likes


class ScpiMeter:
    """See `rig.drivers.meter.Meter`. A meter says in class attributes and hooks how it is spoken to.

    line: settings that the port was opened with. test_currents_A: full scale, ohm -> test current, A.
    first_range_ohm: where ranging begins. What is None is as the class says: LINK, how it is spoken to; OVERRANGE: of
    full scale, what a range still shows; VOLTS: its name for DC volts; READ: the two questions of a reading; NUMBER:
    how a reading is written; AVERAGE: header of its filter, with its {function}; empty: it has none.
    """

    LINE: ClassVar[LineSettings]
    LINK: ClassVar[Mapping[str, Any]] = {}
    NAME: ClassVar[str]
    TEST_CURRENTS_A: ClassVar[Mapping[float, float]]
    FIRST_RANGE_OHM: ClassVar[float] = 1e5
    VOLTAGE_RANGES_V: ClassVar[Sequence[float]] = (0.1, 1.0, 10.0, 100.0, 1000.0)
    OVERRANGE: ClassVar[float] = 1.2
    VOLTS: ClassVar[str] = "VOLT"
    QUOTE: ClassVar[str] = '"'
    READ: ClassVar[str] = ":READ?;:FETC?"
    SENSE: ClassVar[str] = ":SENS:"
    AVERAGE: ClassVar[str] = ""
    NUMBER: ClassVar[re.Pattern[str]] = re.compile(r"[+-]\d\.\d{4,10}E[+-]\d\d")

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings | None = None,
        test_currents_A: Mapping[float, float] | None = None,
        first_range_ohm: float | None = None,
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self.link = ScpiLink(
            transport,
            byte_s=(self.LINE if line is None else line).byte_s,
            first_token=first_token,
            after_resynchronisation=self._look_after_doubt,
            **self.LINK,
        )
        if first_range_ohm is not None and first_range_ohm <= 0.0:
            raise ValueError(f"first_range_ohm {first_range_ohm}: more than 0 is expected")
        currents_A = self.TEST_CURRENTS_A if test_currents_A is None else test_currents_A
        self._test_currents_A = dict(sorted(currents_A.items()))
        self._first_range_ohm = self.FIRST_RANGE_OHM if first_range_ohm is None else first_range_ohm
        self._reads_volts = False
        self._ranges: list[float] = []
        self._index = 0
        self._chosen = 0
        self._function = ""
        self._four_wire = True
        self._nplc = nan
        self.averaging = Averaging()
        self.most_test_current_A = nan  # that `configure` allowed
        self.test_current_on_s = nan  # since when that of the range in use has been on
        self._message = ""
        self._settling = False
        self._looking = False
        self._rests = False

    # ---- what a meter says of itself ------------------------------------------------------------

    def _is_mine(self, maker: str, model: str) -> bool:
        """Whether `*IDN?` names an instrument of this driver's family."""
        raise NotImplementedError

    def _check_nplc(self, nplc: float) -> None:
        """ValueError where the meter has no such integration time."""
        if not 0.01 <= nplc <= 10.0:
            raise ValueError(f"{nplc} power line cycles: 0.01 to 10 is expected")

    def _function_for(self, four_wire: bool) -> str:
        return "FRES" if four_wire else "RES"

    def _setting_messages(self) -> list[str]:
        """Commands that bring all settings about, the range among them."""
        raise NotImplementedError

    def _settings_message(self) -> str:
        """A question for all settings."""
        sense = self.SENSE + self._function
        return f"{self.SENSE}FUNC?;{sense}:NPLC?;{sense}:RANG:AUTO?;{sense}:RANG?"

    def _as_configured(self, settings: list[str]) -> bool:
        """Whether the answers to `_settings_message` are what is configured."""
        if len(settings) != 4:
            return False
        function, nplc, automatic, full_scale = settings
        return (
            function.strip("\"'") == self._function
            and is_number(nplc, self._nplc)
            and is_number(automatic, 0.0)
            and is_number(full_scale, self._ranges[self._index])
        )

    def _rest(self) -> bool:
        """Stop the test current; whether the meter says that it has stopped. By default: read volts."""
        volts = f"{self.SENSE}FUNC {self.QUOTE}{self.VOLTS}{self.QUOTE};{self.SENSE}FUNC?"
        return self.link.ask(volts).strip("\"'").startswith("VOLT")

    def _range_text(self, index: int) -> str:
        full_scale = self._ranges[index]
        return f"{full_scale:.0f}" if full_scale >= 1.0 else f"{full_scale:g}"

    def _value(self, text: str) -> float:
        """The number in a reading's text. Corrupt where it is none; beyond the range is one, however it is written."""
        if self.NUMBER.fullmatch(text) is None and BEYOND.fullmatch(text) is None:
            raise Corrupt(f"{text!r} is no reading")
        return float(text)

    # ---- what the rig asks for ------------------------------------------------------------------

    @property
    def output(self) -> str:
        """Readings are resistances, in ohm, unless `configure_voltage` was called."""
        return "voltage_V" if self._reads_volts else LOG_RESISTANCE

    @property
    def test_current_A(self) -> float:
        """Of the range that the last reading was taken in, A; none flows for volts; nan before `configure`."""
        if not self._ranges:
            return nan
        return 0.0 if self._reads_volts else self._test_currents_A[self._ranges[self._index]]

    @property
    def full_scale(self) -> float:
        """Full scale of that range, ohm or V."""
        return self._ranges[self._index] if self._ranges else nan

    @property
    def in_highest_range(self) -> bool:
        """Whether that is the highest range that may be used, so that what is beyond it is beyond all of them."""
        return self._index == len(self._ranges) - 1

    def steady_test_current_A(self, least_ohm: float, largest_ohm: float, most_A: float) -> float:
        """The largest test current (A), up to most_A, with which all resistances between these are read; nan: none."""
        allowed_A = {ohm: current_A for ohm, current_A in self._test_currents_A.items() if current_A <= most_A}
        first = next((ohm for ohm in allowed_A if largest_ohm <= RANGE_UP * ohm), nan)
        if self._reads_volts or isnan(first):
            return nan
        lowest = min(ohm for ohm, current_A in allowed_A.items() if current_A <= allowed_A[first])
        return allowed_A[first] if lowest <= RESOLVED * least_ohm else nan

    @asked_again
    def identify(self) -> Identity:
        """`*IDN?`; Refused where it is another instrument."""
        maker, model, serial_number, firmware = (
            part.strip() for part in (self.link.ask_alone("*IDN?") + ",,,").split(",")[:4]
        )
        if not self._is_mine(maker.upper(), model):
            raise Refused(None, f"{maker!r} {model!r} is no {self.NAME}")
        return Identity(self.NAME.split()[0], model.removeprefix("MODEL").strip(), serial_number, firmware)

    @asked_again
    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Function, integration time, ranges whose test current is allowed; Refused if it reads back else."""
        self._check_nplc(nplc)
        allowed = [ohm for ohm, current_A in self._test_currents_A.items() if current_A <= max_test_current_A]
        if not allowed:
            least_A = min(self._test_currents_A.values())
            raise ValueError(f"a test current of {max_test_current_A} A is below the least, {least_A} A")
        nearest = min(allowed, key=lambda ohm: abs(ohm - self._first_range_ohm))
        self._configure(self._function_for(four_wire), four_wire, nplc, allowed, nearest)
        self.most_test_current_A = max_test_current_A

    @asked_again
    def configure_voltage(self, nplc: float, range_V: float, four_wire: bool = False) -> None:
        """DC volts in the lowest range that has `range_V`, which is kept; no test current. ValueError, Refused."""
        self._check_nplc(nplc)
        full_V = next((full for full in self.VOLTAGE_RANGES_V if range_V <= full), nan)
        if not (range_V > 0.0 and isfinite(full_V)):
            raise ValueError(
                f"a range of {range_V} V: more than 0 and at most {self.VOLTAGE_RANGES_V[-1]:g} is expected"
            )
        self._configure(self.VOLTS, four_wire, nplc, [full_V], full_V)

    def _configure(self, function: str, four_wire: bool, nplc: float, ranges: list[float], first: float) -> None:
        self._ranges = []
        if self.link.in_doubt:
            self.link.resynchronise()
        self._reads_volts = function == self.VOLTS
        self._function, self._four_wire, self._nplc = function, four_wire, nplc
        self._ranges = ranges
        self._index = self._chosen = ranges.index(first)
        try:
            self._apply()
        except BaseException:
            self._ranges = []  # half configured is not configured
            raise

    @asked_again
    def average(self, averaging: Averaging) -> None:
        """Every reading is from now on such a mean. Refused where the meter has no filter for that, or reads back
        another: readings are single ones then."""
        self.averaging = Averaging()
        if not self.AVERAGE:
            raise Refused(None, f"{self.NAME}: it has no filter that averages")
        if not self._ranges:
            raise Refused(None, f"{self.NAME}: it is not configured yet")
        averaging.apply(self.link, self._filter())
        self.averaging = averaging

    def _filter(self) -> str:
        return self.AVERAGE.format(function=self._function)

    def start_reading(self) -> None:
        """Begin a reading; where the last one asked for another range, change it first."""
        if not self._ranges:
            raise Refused(None, "the meter is not configured yet")
        if self._rests:
            self._apply()
        message = self.READ
        self._settling = self._chosen != self._index
        if self._settling:
            header = f"{self.SENSE}{self._function}:RANG"
            message = f"{header} {self._range_text(self._chosen)};{header}?;{message}"
        self._message = message
        self.link.start(message, APERTURES * self.averaging.count * self._nplc * LINE_PERIOD_S + MARGIN_S)
        self._index = self._chosen

    def finish_reading(self) -> Reading:
        """The reading that was begun, ohm or V; `time_s` is the middle of the integration, or of all of them."""
        time_s = self.link.arrived_s + COMMAND_S + self.averaging.middle_s(self._nplc * LINE_PERIOD_S)
        *before, first, second = ("", *self.link.finish().split(";"))
        try:
            if first != second:
                raise Corrupt(f"{first!r} and {second!r} are not twice the same reading")
            value = self._value(first)
        except Corrupt:
            self.link.doubt()
            raise
        full_scale = self._ranges[self._index]
        if self._settling and (len(before) != 2 or not is_number(before[1], full_scale)):
            self.link.doubt()
            raise OutOfStep(f"range {full_scale:g} ohm was asked for, and {before[1:]} came back")
        if self._settling:
            self.test_current_on_s = self.link.arrived_s + COMMAND_S
        judged = voltage_reading if self._reads_volts else resistance_reading
        reading = judged(value, time_s, 1.05 * self.OVERRANGE * full_scale)
        self._choose_next_range(reading)
        if self._settling and reading.quality is Quality.OK:
            return Reading(reading.value, time_s, Quality.SETTLING)
        return reading

    def read(self) -> Reading:
        """Begin a reading and wait for it, ohm or V."""
        self.start_reading()
        return self.finish_reading()

    def off(self) -> bool:
        """Stop the test current until the next reading; True only if the meter reads back that it has. Never raises."""
        self._rests = True
        self.link.forget()
        return confirmed(lambda _: self._rest(), OFF_ATTEMPTS, self.link.doubt)

    def close(self) -> None:
        """Let go of the port."""
        self.transport.close()

    # ---- ranges and settings --------------------------------------------------------------------

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
        self._rests = False
        self.test_current_on_s = nan
        for message in self._setting_messages():
            self.link.command(message)
        self._index = self._chosen
        settings = self._settings()
        if not self._as_configured(settings):
            raise Refused(None, f"the meter reads back {settings}")
        if self.averaging.count > 1:
            self.averaging.apply(self.link, self._filter())

    def _settings(self) -> list[str]:
        return self.link.ask(self._settings_message()).split(";")

    def _look_after_doubt(self) -> None:
        """A meter that was switched off in between has forgotten its settings: give them again."""
        if not self._ranges or self._looking or self._rests:
            return
        self._looking = True
        try:
            if not self._as_configured(self._settings()):
                self._apply()
        finally:
            self._looking = False


def is_number(text: str, value: float) -> bool:
    """Whether `text` is the number `value`, to the digits in which instruments answer."""
    try:
        number = float(text)
    except ValueError:
        return False
    return isfinite(number) and abs(number - value) <= 1e-3 * abs(value) + 1e-9

"""SCPI meters: Keithley 2000, HP 34401A, Keithley 2400 and 2450, and what they share.

Resistance ranges go by test current; there is a voltage range, too; a reading is asked for twice.

The instrument's own autorange would pick the test current by itself; here the driver picks the range, so that the test
current never exceeds what was allowed and is known for every reading. A reading asks for its value twice: without a
checksum, repetition has to do, so that a flipped digit is no wrong number.

Residual: two bursts that change both copies alike, and leave the token as it is; at a share p of the answers less than
p^2 / 16 / 256, 16 for the place and 256 for the new character (docs/instruments.md, "What remains").

Its filter: Model 2000 User's Manual rev J chapter 5, 2400 series manual chapter 18, Model 2450 reference manual section
6, SENSe subsystem, AVERage.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from math import isfinite, isnan, nan
from types import MappingProxyType
from typing import ClassVar, NamedTuple

from rig.core.errors import Corrupt, OutOfStep, Refused, TimedOut
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.in_step import retry_once
from rig.drivers.meter import (
    LINE_PERIOD_S,
    LOG_RESISTANCE,
    OVERFLOW,
    Averaging,
    Meter,
    resistance_reading,
    voltage_reading,
)
from rig.drivers.scpi import ScpiLink
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

RANGE_UP, RANGE_DOWN = 0.95, 0.08  # of full scale, where the driver changes the range, ahead of the overrange
RESOLVED = 300.0  # of a range's full scale: below that share bench meters are sure of a reading to 0.3 % at best
COMMAND_S = 0.002  # from the terminator to the beginning of the integration, nominal
APERTURES, MARGIN_S = 4.0, 0.3  # an answer may take as many integrations (auto-zero adds some), and the rest
OFF_ATTEMPTS = 3
CURRENT_TOLERANCE = 0.05  # of a source meter's test current, between the table and the reply
BEYOND = re.compile(r"[+-]?9\.9\d*[Ee]\+?37")  # 9.9E37 and 9.91E37 with as many digits as an instrument likes
Expected = float | str | Callable[[str], bool]  # answer to a question for a setting


class Setting(NamedTuple):
    """A setting by its header; value: what it is set to ("": the header alone is sent, None: nothing); reads: what then
    reads back (None: it is not asked for)."""

    header: str
    value: str | None
    reads: Expected | None = None


class ScpiMeter(Meter):
    """A `rig.drivers.meter.Meter`; the class attributes and hooks of each meter say how to speak to it.

    line: settings that the port was opened with.

    LINK: how it is spoken to. MAKERS, MODELS: one of each is in the identity. TEST_CURRENTS_A: full scale, ohm -> test
    current, A, in rising order. FIRST_RANGE_OHM: where ranging begins. OVERRANGE: share of full scale that a range
    still shows. VOLTS: its name for DC volts. READ: the two questions of a reading. NUMBER: form of a reading. AVERAGE:
    header of its filter, with its {function}; empty if it has none.
    """

    LINE: ClassVar[LineSettings]
    LINK: ClassVar[type[ScpiLink]] = ScpiLink
    NAME: ClassVar[str]
    MAKERS: ClassVar[tuple[str, ...]] = ("KEITHLEY",)
    MODELS: ClassVar[tuple[str, ...]]
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
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self.link = self.LINK(
            transport,
            byte_s=(self.LINE if line is None else line).byte_s,
            first_token=first_token,
            after_resynchronisation=self._check_after_doubt,
        )
        self._reads_volts = False
        self._ranges: list[float] = []  # full scales that may be used, ohm or V; empty before `configure`
        self._index = self._chosen = 0  # of the last reading's range, and of the next one's
        self._function = ""
        self._four_wire = True
        self._nplc = nan
        self.averaging = Averaging()
        self.most_test_current_A = nan  # that `configure` allowed
        self.test_current_on_s = nan  # since when that of the range in use has been on
        self._message = ""
        self._settling = False  # the range changes with this reading
        self._checking = False
        self._rests = False  # without a test current, until the next reading

    # ---- hooks ----------------------------------------------------------------------------------

    def _check_nplc(self, nplc: float) -> None:
        """Raise ValueError for an integration time that the meter does not have."""
        if not 0.01 <= nplc <= 10.0:
            raise ValueError(f"{nplc} power line cycles: 0.01 to 10 is expected")

    def _function_for(self, four_wire: bool) -> str:
        return "FRES" if four_wire else "RES"

    def _settings(self, index: int) -> list[list[Setting]]:
        """Return all settings in a range, message by message, in the order in which they are sent and asked for."""
        raise NotImplementedError

    def _of_function(self, name: str, value: str | None, reads: Expected | None = None) -> Setting:
        return Setting(f"{self.SENSE}{self._function}:{name}", value, reads)

    def _of_range(self, index: int) -> list[Setting]:
        fixed = self._of_function("RANG:AUTO", "0", 0.0)
        return [fixed, self._of_function("RANG", self._range_text(index), self._ranges[index])]

    def _rest(self) -> bool:
        """Stop the test current and return True if the meter says that it has stopped. By default: read volts."""
        volts = f"{self.SENSE}FUNC {self.QUOTE}{self.VOLTS}{self.QUOTE};{self.SENSE}FUNC?"
        return self.link.ask(volts).strip("\"'").startswith("VOLT")

    def _value(self, text: str) -> float:
        """Return the number in a reading's text; beyond the range is one, however it is written. Corrupt."""
        if self.NUMBER.fullmatch(text) is None and BEYOND.fullmatch(text) is None:
            raise Corrupt(f"{text!r} is no reading")
        return float(text)

    # ---- the meter's protocol -------------------------------------------------------------------

    @property
    def output(self) -> str:
        """See `Meter`: resistances, in ohm, unless `configure_voltage` was called."""
        return "voltage_V" if self._reads_volts else LOG_RESISTANCE

    @property
    def test_current_A(self) -> float:
        """Return the test current of the last reading's range, A; none flows for volts; nan before `configure`."""
        if not self._ranges:
            return nan
        return 0.0 if self._reads_volts else self.TEST_CURRENTS_A[self._ranges[self._index]]

    @property
    def full_scale(self) -> float:
        """Return the full scale of that range, ohm or V."""
        return self._ranges[self._index] if self._ranges else nan

    @property
    def in_highest_range(self) -> bool:
        """Return True if that is the highest range that may be used: a value beyond it is beyond all of them."""
        return self._index == len(self._ranges) - 1

    def steady_test_current_A(self, least_ohm: float, largest_ohm: float, most_A: float) -> float:
        """Return the largest test current up to most_A that reads all resistances between these, A; nan for none."""
        allowed_A = {ohm: current_A for ohm, current_A in self.TEST_CURRENTS_A.items() if current_A <= most_A}
        first = next((ohm for ohm in allowed_A if largest_ohm <= RANGE_UP * ohm), nan)
        if self._reads_volts or isnan(first):
            return nan
        lowest = min(ohm for ohm, current_A in allowed_A.items() if current_A <= allowed_A[first])
        return allowed_A[first] if lowest <= RESOLVED * least_ohm else nan

    @retry_once
    def identify(self) -> Identity:
        """Ask `*IDN?`; Refused if it is another instrument."""
        found = Identity.of_idn(self.link.ask_alone("*IDN?"))
        maker, model = found.maker.upper(), found.model
        if not (any(one in maker for one in self.MAKERS) and any(one in model for one in self.MODELS)):
            raise Refused(None, f"{maker!r} {model!r} is no {self.NAME}")
        model = model.removeprefix("MODEL").strip()
        return Identity(self.NAME.split()[0], model, found.serial_number, found.firmware)

    @retry_once
    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Set function, integration time, and ranges whose test current is allowed; Refused if it reads back else."""
        self._check_nplc(nplc)
        allowed = [ohm for ohm, current_A in self.TEST_CURRENTS_A.items() if current_A <= max_test_current_A]
        if not allowed:
            least_A = min(self.TEST_CURRENTS_A.values())
            raise ValueError(f"a test current of {max_test_current_A} A is below the least, {least_A} A")
        nearest = min(allowed, key=lambda ohm: abs(ohm - self.FIRST_RANGE_OHM))
        self._configure(self._function_for(four_wire), four_wire, nplc, allowed, nearest)
        self.most_test_current_A = max_test_current_A

    @retry_once
    def configure_voltage(self, nplc: float, range_V: float, four_wire: bool = False) -> None:
        """Set DC volts in the lowest range that has `range_V`, and keep it; no test current. ValueError, Refused."""
        self._check_nplc(nplc)
        full_V = next((full for full in self.VOLTAGE_RANGES_V if range_V <= full), nan)
        if not (range_V > 0.0 and isfinite(full_V)):
            most_V = self.VOLTAGE_RANGES_V[-1]
            raise ValueError(f"a range of {range_V} V: more than 0 and at most {most_V:g} is expected")
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

    @retry_once
    def average(self, averaging: Averaging) -> None:
        """Let every reading be such a mean from now on.

        Refused if the meter has no filter for that, or reads back another: readings are single ones then.
        """
        self.averaging = Averaging()
        if not self.AVERAGE:
            raise Refused(None, f"{self.NAME}: it has no filter that averages")
        if not self._ranges:
            raise Refused(None, f"{self.NAME}: it is not configured yet")
        set_filter(self.link, self._filter(), averaging.count)
        self.averaging = averaging

    def start_reading(self) -> None:
        """Begin a reading; if the last one asked for another range, change it first."""
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
        """Return the reading that was begun, ohm or V; `time_s` is the middle of the integration, or of all of them."""
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

    def off(self) -> bool:
        """Stop the test current until the next reading; return True only if that reads back. Never raises."""
        self._rests = True
        self.link.forget()
        for _ in range(OFF_ATTEMPTS):
            try:
                if self._rest():
                    return True
            except Exception:  # whatever it was, the next attempt matters more
                self.link.doubt()
        return False

    # ---- ranges and settings --------------------------------------------------------------------

    def _range_text(self, index: int) -> str:
        full_scale = self._ranges[index]
        return f"{full_scale:.0f}" if full_scale >= 1.0 else f"{full_scale:g}"

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
        self._rests = False
        self.test_current_on_s = nan
        for message in self._settings(self._chosen):
            sent = (f"{one.header} {one.value}".strip() for one in message if one.value is not None)
            self.link.command(";".join(sent))
        self._index = self._chosen
        kept, answers = self._keeps_settings()
        if not kept:
            raise Refused(None, f"the meter reads back {answers}")
        if self.averaging.count > 1:
            set_filter(self.link, self._filter(), self.averaging.count)

    def _keeps_settings(self) -> tuple[bool, list[str]]:
        """Return whether the settings read back as they were set, and the answers."""
        asked = [one for message in self._settings(self._index) for one in message if one.reads is not None]
        answers = self.link.ask(";".join(f"{one.header}?" for one in asked)).split(";")
        agree = (_agrees(text, one.reads) for text, one in zip(answers, asked, strict=False))
        return len(answers) == len(asked) and all(agree), answers

    def _filter(self) -> str:
        return self.AVERAGE.format(function=self._function)

    def _check_after_doubt(self) -> None:
        """Give the settings again to a meter that was switched off in between and has forgotten them."""
        if not self._ranges or self._checking or self._rests:
            return
        self._checking = True
        try:
            if not self._keeps_settings()[0]:
                self._apply()
        finally:
            self._checking = False


def is_number(text: str, value: float) -> bool:
    """Return True if `text` is the number `value`, to the digits in which instruments answer."""
    try:
        number = float(text)
    except ValueError:
        return False
    return isfinite(number) and abs(number - value) <= 1e-3 * abs(value) + 1e-9


def _agrees(text: str, expected: Expected | None) -> bool:
    if isinstance(expected, str):
        return text.strip("\"'") == expected
    return expected(text) if callable(expected) else is_number(text, expected or 0.0)


def set_filter(link: ScpiLink, header: str, count: int) -> None:
    """Set the filter whose header that is, and read it back.

    Refused if that is something else: the filter is switched off then, as far as the meter obeys.
    """
    if count == 1:
        link.command(f"{header}:STAT OFF")
        answers, expected = link.answers(f"{header}:STAT?", 1), ["0"]
    else:
        link.command(f"{header}:TCON REP;{header}:COUN {count};{header}:STAT ON")
        answers = link.answers(f"{header}:TCON?;{header}:COUN?;{header}:STAT?", 3)
        expected = ["REP", f"{count}", "1"]
    answers = [answer.strip().lstrip("+").upper() for answer in answers]
    try:
        numbers = [f"{float(answer):.0f}" for answer in answers[1:]]
    except ValueError:
        link.doubt()
        raise Corrupt(f"{answers} is not how a filter is set") from None
    if not answers[0].startswith(expected[0]) or numbers != expected[1:]:
        if count > 1:
            with suppress(Refused):
                set_filter(link, header, 1)
        raise Refused(None, f"the meter's filter reads back {answers}, {expected} is expected")


# ---- multimeters: the test current flows as long as a resistance function is chosen ------------------


class Keithley2000Meter(ScpiMeter):
    """Keithley 2000 multimeter as an ohmmeter on its RS-232 port; options as in `ScpiMeter`.

    Source: Model 2000 User's Manual rev J p. 4-6, 4-38, 5-63. Set it to RS-232 at 19200 Bd with LF (or CRLF) at its
    front panel; from the factory it listens to GPIB.
    """

    LINE = LineSettings(baudrate=19200)
    NAME = "Keithley 2000"
    MODELS = ("2000",)
    AVERAGE = ":SENS:{function}:AVER"
    # not verified on an instrument
    TEST_CURRENTS_A = MappingProxyType(
        {1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 1e-5, 1e7: 0.7e-6, 1e8: 0.7e-6}
    )
    VOLTS = "VOLT:DC"
    QUOTE = "'"

    def _settings(self, index: int) -> list[list[Setting]]:
        function = [
            Setting(f":CONF:{self._function}", ""),
            Setting(":INIT:CONT", "0"),
            Setting(":TRIG:COUN", "1"),
            Setting(":SENS:FUNC", None, self._function),
            self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
        ]
        return [function, self._of_range(index)]


class Hp34401ALink(ScpiLink):
    """The line of an HP 34401A."""

    END = b"\n"
    ABORT = b"\x03"
    CLEAR_S = 0.05
    WAKE = b"SYST:REM"


class Hp34401AMeter(ScpiMeter):
    """HP / Agilent 34401A multimeter as an ohmmeter on its RS-232 port; options as in `ScpiMeter`.

    Source: 34401A User's Guide, RS-232 section p. 149 to 152. NOT verified on an instrument: its framing as shipped (7
    bits, even parity); two stop bits are fixed.

    It holds its sender off by DTR, of which a serial port on Linux takes no notice. So there is one outstanding
    question at any time, no message is longer than 100 characters, and after ^C there is a pause. It wants to be in
    remote mode first (SYSTem:REMote), and forgets that when it is switched off. `READ?` does not keep its readings:
    here they are initiated, and fetched twice. At 9600 Bd the 70 characters of a reading take 80 ms: with NPLC 1 a
    period of 0.2 s is right.
    """

    LINE = LineSettings(baudrate=9600, bytesize=7, parity="E", stopbits=2)
    LINK = Hp34401ALink
    NAME = "HP 34401A"
    MAKERS = ("HEWLETT", "AGILENT", "KEYSIGHT")
    MODELS = ("34401",)
    # not verified on an instrument
    TEST_CURRENTS_A = MappingProxyType({1e2: 1e-3, 1e3: 1e-3, 1e4: 1e-4, 1e5: 1e-5, 1e6: 5e-6, 1e7: 5e-7, 1e8: 5e-7})
    READ = "INIT;FETC?;FETC?"
    SENSE = ":"
    NPLCS = (0.02, 0.2, 1.0, 10.0, 100.0)  # that it has

    def _check_nplc(self, nplc: float) -> None:
        if nplc not in self.NPLCS:
            choice = ", ".join(f"{one:g}" for one in self.NPLCS)
            raise ValueError(f"{nplc} power line cycles: one of {choice} is expected")

    def _settings(self, index: int) -> list[list[Setting]]:
        function = [
            Setting(f":CONF:{self._function}", ""),
            Setting(":TRIG:COUN", "1"),
            Setting(":SAMP:COUN", "1"),
            Setting(":FUNC", None, self._function),
            self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
        ]
        automatic, in_range = self._of_range(index)
        return [function, [automatic._replace(value=None), in_range]]  # a range ends the automatic one here


# ---- source meters: the test current flows as long as the output is on -------------------------------


class SourceMeter(ScpiMeter):
    """An ohmmeter that sources its test current through the film while its output is on.

    Only ranges whose current is allowed are used (100 mA in the lowest!), and every reply carries the current that was
    sourced, which has to be the range's. `off` and `close` switch the output off. If it is found off, switched by hand
    or by an interlock, a reading is Refused with the instrument's own error, and the next one switches it on again. For
    volts it sources 0 A.
    """

    # in auto-ohms (2400 series manual p. 4-14); not verified for the 2450, where one that differs is an error
    TEST_CURRENTS_A = MappingProxyType(
        {20.0: 100e-3, 200.0: 10e-3, 2e3: 1e-3, 2e4: 100e-6, 2e5: 10e-6, 2e6: 1e-6, 2e7: 1e-6, 2e8: 100e-9}
    )
    FIRST_RANGE_OHM = 2e5
    VOLTAGE_RANGES_V = (0.2, 2.0, 20.0, 200.0)
    OVERRANGE = 1.05
    _stays_on = True  # between readings
    _output_is_on = False

    def start_reading(self) -> None:
        """Begin a reading; switch the output on if it has to be."""
        if self._ranges:
            self.link.be_in_step()
            if self._rests:
                self._apply()
            if self._stays_on and not self._output_is_on:
                self.link.command(":OUTP ON")
                self._output_is_on = True
        super().start_reading()

    def finish_reading(self) -> Reading:
        """Return the reading that was begun, ohm. Refused, from the error queue, if there was none."""
        try:
            return super().finish_reading()
        except TimedOut:
            self.link.explain_silence(self._message)
            raise

    def off(self) -> bool:
        """Switch the output off until the next reading; return True only if that reads back. Never raises."""
        self._output_is_on = False
        return super().off()

    def close(self) -> None:
        """Switch the output off, as well as that can be done, and let go of the port. Never raises."""
        self.off()
        super().close()

    def _function_for(self, four_wire: bool) -> str:
        return "RES"

    def _apply(self) -> None:
        self._output_is_on = False
        super()._apply()

    def _rest(self) -> bool:
        return is_number(self.link.ask(":OUTP OFF;:OUTP?"), 0.0)

    def _value(self, text: str) -> float:
        if self._reads_volts:
            return super()._value(text)
        current_text, _, resistance_text = text.partition(",")
        current_A, resistance_ohm = super()._value(current_text), super()._value(resistance_text)
        if resistance_ohm >= OVERFLOW:  # into an open film it cannot source its current
            return resistance_ohm
        expected_A = self.test_current_A
        if abs(current_A - expected_A) > CURRENT_TOLERANCE * expected_A:
            self.link.doubt()
            raise OutOfStep(f"the meter sourced {current_A:g} A, and {expected_A:g} A belong to its range")
        return resistance_ohm


class Keithley2400Meter(SourceMeter):
    """Keithley 2400 SourceMeter as an ohmmeter on its RS-232 port.

    Sources: 2400 series manual p. 4-4, 4-14 (auto-ohms, four wires), 14-14, 18-51 (elements of a reply, and the numbers
    for overflow and for not measured), 18-61. Set it to RS-232 at 57600 Bd with LF (or CRLF) at its front panel; from
    the factory it has 9600 Bd, at which the 90 characters of a reading take 94 ms (option `baud`).

    output_between_readings: whether the output stays on from the first reading (and the film's self-heating with it) or
    is on during a reading only.
    """

    LINE = LineSettings(baudrate=57600)
    NAME = "Keithley 2400"
    MODELS = ("2400", "2401")
    AVERAGE = ":SENS:AVER"

    def __init__(
        self,
        transport: Transport,
        *,
        output_between_readings: bool = True,
        line: LineSettings | None = None,
        first_token: int | None = None,
    ) -> None:
        super().__init__(transport, line=line, first_token=first_token)
        self._stays_on = output_between_readings

    def _settings(self, index: int) -> list[list[Setting]]:
        name, elements = self._function, "VOLT" if self._reads_volts else "CURR,RES"
        source = [Setting(":SOUR:FUNC", "CURR", "CURR"), Setting(":SOUR:CURR", "0")] if self._reads_volts else []
        limit = [self._of_function("PROT", f"{1.05 * self._ranges[index]:g}")] if self._reads_volts else []
        mode = [] if self._reads_volts else [self._of_function("MODE", "AUTO", "AUTO")]
        return [
            [Setting("*RST", "")],
            [
                *source,
                # others are measured, too
                Setting(":SENS:FUNC", f'"{name}"', lambda text: f'"{name}' in text.replace("'", '"')),
                *mode,
                self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
                Setting(":SYST:RSEN", "ON" if self._four_wire else "OFF", float(self._four_wire)),
            ],
            [*limit, *self._of_range(index)],
            [
                Setting(":FORM:ELEM", elements, lambda text: text.replace(" ", "") == elements),
                Setting(":SOUR:CLE:AUTO", f"{0 if self._stays_on else 1}", float(not self._stays_on)),
                Setting(":OUTP", None, float(self._output_is_on)),
            ],
        ]


class Keithley2450Link(ScpiLink):
    """The line of a Keithley 2450."""

    END = b"\n"
    ABORT = b""


class Keithley2450Meter(SourceMeter):
    """Keithley 2450 SourceMeter as an ohmmeter, on its network socket, on USB or on GPIB; options as in `ScpiMeter`.

    Sources: Model 2450 reference manual 2450-901-01, section 6 (:READ? p. 6-6, :FORMat p. 6-28, :SENSe p. 6-50 on,
    :OUTPut) and appendix B (*ESE). Port: `socket://HOST:5025`, or `visa://USB0::...::INSTR` and
    `visa://GPIB0::18::INSTR` with the extra `visa`. Its command set has to be SCPI (from the factory), not that of the
    2400. Not verified on an instrument: the error of an output that is off.
    """

    LINE = LineSettings(baudrate=115200)  # no line of its own has a baud rate
    LINK = Keithley2450Link
    NAME = "Keithley 2450"
    MODELS = ("2450",)
    AVERAGE = ":SENS:{function}:AVER"
    ELEMENTS = '"defbuffer1",SOUR,READ'
    READ = f":READ? {ELEMENTS};:FETC? {ELEMENTS}"
    NUMBER = re.compile(r"[+-]?\d\.\d{4,10}E[+-]\d\d")
    DIGITS = 8  # significant ones of a number

    def _settings(self, index: int) -> list[list[Setting]]:
        name, limit_V = self._function, f"{1.05 * self._ranges[index]:g}"
        source = [
            Setting(":SOUR:FUNC", "CURR", "CURR"),
            Setting(":SOUR:CURR", "0"),
            Setting(":SOUR:CURR:VLIM", limit_V),
        ]
        return [
            [Setting("*RST", "")],
            *([source] if self._reads_volts else []),
            [
                Setting(":SENS:FUNC", f'"{name}"', lambda text: text.strip("\"'").partition(":")[0] == name),
                self._of_function("NPLC", f"{self._nplc:g}", self._nplc),
                self._of_function("RSEN", f"{int(self._four_wire)}", float(self._four_wire)),
            ],
            [
                *self._of_range(index),
                Setting(":FORM:ASC:PREC", f"{self.DIGITS}", self.DIGITS),
                Setting(":OUTP", None, float(self._output_is_on)),
            ],
        ]

    def _value(self, text: str) -> float:
        source, comma, reading = (part.strip() for part in text.partition(","))
        if self._reads_volts and comma:
            return super()._value(reading)
        return super()._value(f"{source}{comma}{reading}")

"""A meter: what the rig asks of every driver, and what its numbers mean.

A meter reads the film's resistance, or a voltage that stands for another quantity, such as a position-sensitive
detector's for a cantilever's curvature, by a formula that a configuration gives:

    (voltage_V - 0.131) * 22.4
    10 ** ((voltage_V - 1.2) / 0.35)

Either way it has one film output, as a film model names it.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, inf, isfinite, isnan, log10, nan
from typing import Any, ClassVar

from rig.core.errors import Refused
from rig.core.reading import Identity, Quality, Reading
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


# ---- a voltage that stands for another quantity ------------------------------------------------------

NAME = "voltage_V"
LONGEST = 200  # characters
FUNCTIONS: dict[str, Callable[[float], float]] = {"log10": math.log10, "exp": math.exp, "sqrt": math.sqrt}
OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
ALLOWED = f"numbers, {NAME}, + - * / **, parentheses, {', '.join(FUNCTIONS)}"
OUTPUT_NAME = re.compile(r"[a-z][a-z0-9]*(_[A-Za-z0-9]+)+")
TAKEN = (LOG_RESISTANCE, "resistance_ohm", "temperature_degC", "current_A", "meter_current_A", "time_s")
Value = Callable[[float], float]


@dataclass(frozen=True)
class Formula:
    """The quantity that a voltage stands for. Build it with `formula`."""

    text: str
    value: Value

    def __call__(self, voltage_V: float) -> float:
        """Return the quantity at a voltage, V; nan if the formula has no value there."""
        try:
            found = self.value(voltage_V)
        except (ArithmeticError, ValueError):
            return nan
        return found if math.isfinite(found) else nan


def formula(text: str) -> Formula:
    """Return the formula that a text says; ValueError if it is none."""
    if len(text) > LONGEST:
        raise ValueError(f"a formula of {len(text)} characters: at most {LONGEST} are expected")
    try:
        tree = ast.parse(text.strip(), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise ValueError(f"formula {text!r} cannot be read; expected {ALLOWED}") from None
    value = _value(tree.body)
    if not any(isinstance(node, ast.Name) and node.id == NAME for node in ast.walk(tree)):
        raise ValueError(f"formula {text!r} does not depend on {NAME}")
    return Formula(text.strip(), value)


def _value(node: ast.expr) -> Value:
    if isinstance(node, ast.Constant) and type(node.value) in (int, float):
        constant = float(node.value)  # type: ignore[arg-type]
        return lambda _: constant
    if isinstance(node, ast.Name) and node.id == NAME:
        return lambda voltage_V: voltage_V
    if isinstance(node, ast.UnaryOp) and isinstance(node.op, (ast.UAdd, ast.USub)):
        inner, sign = _value(node.operand), -1.0 if isinstance(node.op, ast.USub) else 1.0
        return lambda voltage_V: sign * inner(voltage_V)
    if isinstance(node, ast.BinOp) and type(node.op) in OPERATORS:
        left, right, combine = _value(node.left), _value(node.right), OPERATORS[type(node.op)]
        return lambda voltage_V: combine(left(voltage_V), right(voltage_V))
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and len(node.args) == 1 and not node.keywords:
        argument, function = _value(node.args[0]), FUNCTIONS.get(node.func.id)
        if function is not None:
            return lambda voltage_V: function(argument(voltage_V))
    raise ValueError(f"formula: {ast.unparse(node)!r} is not allowed; expected {ALLOWED}")


def check_output(output: str) -> None:
    """Raise ValueError for an output that is no name with a unit, or that of something else."""
    if output in TAKEN or OUTPUT_NAME.fullmatch(output) is None:
        raise ValueError(f"output {output!r}: a name and its unit are expected, as in 'curvature_per_m'")


class FormulaMeter(Meter):
    """A `Meter` of the quantity `output`, by the formula `text` of another meter's voltage; range_V: of that meter.

    Time and quality are the voltage's. A voltage to which the formula gives no value is `INVALID`. Beyond the meter's
    range the quantity is nan: the formula need not be monotone, so that not even its sign is known.
    """

    LINE: ClassVar[LineSettings] = LineSettings()

    def __init__(self, meter: Any, output: str, text: str, range_V: float = 10.0) -> None:
        check_output(output)
        self.meter: Meter = meter
        self._configure_voltage = meter.configure_voltage
        self.transport: Transport = meter.transport
        self.formula: Formula = formula(text)
        self._output, self._range_V = output, range_V

    @property
    def output(self) -> str:
        return self._output

    @property
    def test_current_A(self) -> float:
        return self.meter.test_current_A

    @property
    def full_scale(self) -> float:
        return self.meter.full_scale

    def identify(self) -> Identity:
        return self.meter.identify()

    def configure(self, four_wire: bool, nplc: float, max_test_current_A: float) -> None:
        """Set DC volts in the given range, with this integration time; wires and test current do not matter."""
        self._configure_voltage(nplc, self._range_V)

    def average(self, averaging: Averaging) -> None:
        """Let every reading be the formula of such a mean of voltages; Refused by a meter that has no filter."""
        average(self.meter, averaging)

    def start_reading(self) -> None:
        self.meter.start_reading()

    def finish_reading(self) -> Reading:
        """Return the quantity that the voltage stands for, in the output's unit."""
        voltage = self.meter.finish_reading()
        value = self.formula(voltage.value) if voltage.is_number else nan
        quality = Quality.INVALID if voltage.is_number and isnan(value) else voltage.quality
        return Reading(value, voltage.time_s, quality)

    def off(self) -> bool:
        return self.meter.off()

    def close(self) -> None:
        self.meter.close()

"""A meter whose voltage stands for another quantity, by a formula that a configuration gives.

    (voltage_V - 0.131) * 22.4
    10 ** ((voltage_V - 1.2) / 0.35)

A formula has numbers, voltage_V, + - * / **, parentheses, log10, exp and sqrt. Python's own parser takes the text
apart, and it is put together again from the pieces that are allowed here; nothing in it is ever run. A division by
zero, or the logarithm of nothing, is nan and not an error.
"""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable
from dataclasses import dataclass
from math import isnan, nan
from typing import Any, ClassVar

from rig.core.reading import Quality, Reading
from rig.drivers.identity import Identity
from rig.drivers.meter import LOG_RESISTANCE, Averaging, Meter, average
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

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

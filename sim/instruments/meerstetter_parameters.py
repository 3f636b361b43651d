"""Parameters of the Meerstetter TEC family: number, type, access and limits.

Source: "Communication Protocol TEC Controller" 5136AL; 2020, 2021 and 50000 to 50012 from Meerstetter's C
header. Limits that the document leaves open are wide; defaults are this emulator's, not the factory's.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf

# largest output current, A, and voltage, V, by device type (5136AL, parameters 2030 and 2031)
LARGEST_CURRENT_A: Mapping[int, float] = {
    1089: 10.0,
    1090: 16.0,
    1091: 4.0,
    1092: 1.2,
    1122: 10.0,
    1123: 16.0,
    1161: 16.0,
}
LARGEST_VOLTAGE_V: Mapping[int, float] = {1091: 21.0}  # by device type
WIDE = 2**31 - 1  # the largest INT32


@dataclass(frozen=True, slots=True)
class Parameter:
    """One parameter. `kind` is "F" (FLOAT32) or "I" (INT32); a volatile one is never written to flash."""

    number: int
    name: str
    kind: str
    default: float
    minimum: float
    maximum: float
    read_only: bool = False
    volatile: bool = False

    def allows(self, value: float) -> bool:
        """Whether `value` lies within the limits; nan does not. 2060 (watchdog) is 0 or at least 0.1 s."""
        return self.minimum <= value <= self.maximum and not (self.number == 2060 and 0.0 < value < 0.1)


def _reading(number: int, name: str, kind: str = "F") -> Parameter:
    low, high = (-inf, inf) if kind == "F" else (-WIDE - 1, WIDE)
    return Parameter(number, name, kind, 0, low, high, read_only=True, volatile=True)


def _setting(number: int, name: str, kind: str, default: float, minimum: float, maximum: float) -> Parameter:
    return Parameter(number, name, kind, default, minimum, maximum)


def _live(number: int, name: str, kind: str, default: float, minimum: float, maximum: float) -> Parameter:
    return Parameter(number, name, kind, default, minimum, maximum, volatile=True)


def table(device_type: int) -> dict[int, Parameter]:
    """All parameters of a device type, by number."""
    amps = LARGEST_CURRENT_A.get(device_type, 16.0)
    volts = LARGEST_VOLTAGE_V.get(device_type, 21.0)
    parameters = [
        _reading(100, "device type", "I"),
        _reading(101, "hardware version x100", "I"),
        _reading(102, "serial number", "I"),
        _reading(103, "firmware version x100", "I"),
        _reading(104, "device status", "I"),
        _reading(105, "error number", "I"),
        _reading(106, "error instance", "I"),
        _reading(107, "error parameter", "I"),
        _live(108, "automatic save to flash: 0 on, 1 off", "I", 0, 0, 1),
        _reading(109, "flash state", "I"),
        _reading(1000, "object temperature, degC"),
        _reading(1001, "sink temperature, degC"),
        _reading(1010, "target object temperature, degC"),
        _reading(1011, "ramped nominal object temperature, degC"),
        _reading(1012, "thermal power model current, A"),
        _reading(1020, "actual output current, A"),
        _reading(1021, "actual output voltage, V"),
        _reading(1032, "PID control variable, %"),
        _reading(1063, "device temperature, degC"),
        _reading(1200, "temperature is stable", "I"),
        _setting(2000, "output stage input: 0 static, 1 live, 2 temperature controller", "I", 2, 0, 2),
        _setting(2010, "output stage: 0 off, 1 on, 2 live off/on, 3 hardware pin", "I", 0, 0, 3),
        _setting(2020, "static current, A", "F", 0.0, -amps, amps),
        _setting(2021, "static voltage, V", "F", volts, -volts, volts),
        _setting(2030, "current limitation, A", "F", amps, 0.0, amps),
        _setting(2031, "voltage limitation, V", "F", volts, 0.0, volts),
        _setting(2032, "current error threshold, A", "F", 1.2 * amps, 0.0, 1.5 * amps),
        _setting(2033, "voltage error threshold, V", "F", 1.2 * volts, 0.0, 1.5 * volts),
        _setting(2040, "general operating mode", "I", 0, 0, 2),
        _setting(2050, "base baud rate, 1/s", "I", 57600, 4800, 1000000),
        _setting(2051, "device address", "I", 1, 0, 254),
        _setting(2052, "response delay, us", "I", 0, 0, 1000000),
        _setting(2060, "communication watchdog, s; 0 is off", "F", 0.0, 0.0, 600.0),
        _setting(3000, "target object temperature, degC", "F", 25.0, -273.0, 1000.0),
        _setting(3002, "proximity width, degC", "F", 0.0, 0.0, 1000.0),
        _setting(3003, "coarse temperature ramp, degC/s; 0 is at once", "F", 0.0, 0.0, 1000.0),
        _setting(3010, "Kp, %/degC", "F", 10.0, 0.0, 1000.0),
        _setting(3011, "Ti, s; 0 is no integral part", "F", 30.0, 0.0, 10000.0),
        _setting(3012, "Td, s", "F", 0.0, 0.0, 1000.0),
        _setting(3013, "damping of the D part", "F", 0.3, 0.0, 1.0),
        _setting(3020, "thermal regulation mode", "I", 0, 0, 2),
        _setting(3034, "positive current is: 0 cooling, 1 heating", "I", 1, 0, 1),
        _setting(4010, "object temperature lower error limit, degC", "F", -50.0, -273.0, 1000.0),
        _setting(4011, "object temperature upper error limit, degC", "F", 200.0, -273.0, 1000.0),
        _setting(4012, "largest object temperature change, degC/s", "F", 1000.0, 0.0, 1000.0),
        _setting(4034, "object sensor type", "I", 1, 0, 7),
        _live(50000, "live enable", "I", 0, 0, 1),
        _live(50001, "live current, A", "F", 0.0, -amps, amps),
        _live(50002, "live voltage, V", "F", volts, -volts, volts),
        _live(50012, "live target object temperature, degC", "F", 25.0, -273.0, 1000.0),
        _live(52200, "external object temperature, degC", "F", 0.0, -273.0, 1000.0),
    ]
    return {parameter.number: parameter for parameter in parameters}

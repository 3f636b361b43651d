"""Meerstetter TEC controller, one channel, over MeCom.

Sources: "MeCom Protocol Specification" 5117C (frame, CRC), "Communication Protocol TEC Controller" 5136AL (parameters),
Meerstetter's C header for 2020, 2021 and 500xx, `error_numbers.txt` of pyMeComTEC for error numbers.

    request   #  address(2)  sequence(4)  payload  crc(4)  CR
    reply     !  address(2)  sequence(4)  payload  crc(4)  CR      payload `+` and two digits: an error
    ACK       !  address(2)  sequence(4)           crc(4)  CR      the crc is that of the request

All numbers are upper-case hexadecimal. The CRC is CRC-16/XMODEM over everything before it. `#` restarts a frame, so
that garbage before it is dropped.

A request takes effect when its last character has arrived; its reply begins after the response time. Not specified by
the maker, and assumed here:

* a wrong CRC is answered with silence, as every known client expects;
* the watchdog (2060) sets 2010 and 50000 to 0, so that renewed traffic does not turn the output on again; every valid
  frame for this device feeds it; it raises no device error, unless `watchdog_error` says which;
* an error (104 = 3) latches until a reset (`RS`); limits and sensor are judged on the conversions of the control loop,
  and trip after several in a row, so that one outlier does not;
* while it restarts, the device is silent;
* the load is a constant resistance, which turns voltage limits into current limits.
"""

from __future__ import annotations

import struct
from binascii import crc_hqx, unhexlify
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import copysign, inf, isfinite, isnan, nan
from typing import ClassVar

from sim.instruments.instrument import TICK_S, Instrument, Plant, Regulator, Ticking

READY, RUN, ERROR, RESETTING = 1, 2, 3, 5  # of parameter 104
EMERGENCY_STOP, SENSOR_OPEN, BELOW_LIMIT, ABOVE_LIMIT, CHANGED_TOO_FAST = 11, 134, 137, 138, 139  # device errors
UNKNOWN_COMMAND, FORMAT, UNKNOWN_PARAMETER, READ_ONLY, OUT_OF_RANGE, UNKNOWN_INSTANCE = 1, 4, 5, 6, 7, 8  # of MeCom
TRIP_AFTER = 3  # conversions in a row (assumed, see above)
MOVES_OUTPUT = frozenset({2000, 2010, 2020, 2021, 2030, 2031, 3034, 50000, 50001, 50002})
SHORTEST_REQUEST = 13  # '#', address, sequence, two characters of payload, crc
READ, SET = b"?VR", b"VS"
REPLY_LENGTH = {True: 20, False: 12}  # characters that are expected, by whether something is read
# largest output current, A, and voltage, V, by device type (5136AL, parameters 2030 and 2031)
LARGEST_CURRENT_A = {1089: 10.0, 1090: 16.0, 1091: 4.0, 1092: 1.2, 1122: 10.0, 1123: 16.0, 1161: 16.0}
LARGEST_VOLTAGE_V = 21.0  # the same, of each type
WIDE = 2**31 - 1  # the largest INT32
FIRMWARE = b"8065-TEC SW G01     "
LOAD_OHM = 2.0  # of the Peltier element, for 1021 and the voltage limits
STABLE_K, STABLE_S = 0.1, 10.0  # within the one for the other parameter 1200 reads 2

_float32 = struct.Struct(">f")
_int32 = struct.Struct(">i")


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter: kind "F" (FLOAT32) or "I" (INT32). A volatile one is never written to flash."""

    number: int
    kind: str
    default: float = 0
    minimum: float = -inf
    maximum: float = inf
    read_only: bool = False
    volatile: bool = False

    def allows(self, value: float) -> bool:
        """Return True if the value lies within the limits, which nan does not. 2060 is 0 or at least 0.1 s."""
        return self.minimum <= value <= self.maximum and not (self.number == 2060 and 0.0 < value < 0.1)


def table(device_type: int) -> dict[int, Parameter]:
    """Return all parameters of a device type by number. Defaults, and limits that the maker leaves open, are ours."""
    amps, volts = LARGEST_CURRENT_A.get(device_type, 16.0), LARGEST_VOLTAGE_V
    whole_readings = (100, 101, 102, 103, 104, 105, 106, 107, 109, 1200)
    real_readings = (1000, 1001, 1010, 1011, 1012, 1020, 1021, 1032, 1063)
    parameters = [Parameter(number, "I", 0, -WIDE - 1, WIDE, True, True) for number in whole_readings]
    parameters += [Parameter(number, "F", read_only=True, volatile=True) for number in real_readings]
    parameters += [
        Parameter(2000, "I", 2, 0, 2),  # output stage input: 0 static, 1 live, 2 temperature controller
        Parameter(2010, "I", 0, 0, 3),  # output stage: 0 off, 1 on, 2 live off/on, 3 hardware pin
        Parameter(2020, "F", 0.0, -amps, amps),  # static current, A
        Parameter(2021, "F", volts, -volts, volts),  # static voltage, V
        Parameter(2030, "F", amps, 0.0, amps),  # current limitation, A
        Parameter(2031, "F", volts, 0.0, volts),  # voltage limitation, V
        Parameter(2032, "F", 1.2 * amps, 0.0, 1.5 * amps),  # current error threshold, A
        Parameter(2033, "F", 1.2 * volts, 0.0, 1.5 * volts),  # voltage error threshold, V
        Parameter(2040, "I", 0, 0, 2),  # general operating mode
        Parameter(2050, "I", 57600, 4800, 1000000),  # base baud rate, 1/s
        Parameter(2051, "I", 1, 0, 254),  # device address
        Parameter(2052, "I", 0, 0, 1000000),  # response delay, us
        Parameter(2060, "F", 0.0, 0.0, 600.0),  # communication watchdog, s; 0 is off
        Parameter(3000, "F", 25.0, -273.0, 1000.0),  # target object temperature, degC
        Parameter(3003, "F", 0.0, 0.0, 1000.0),  # coarse temperature ramp, degC/s; 0 is at once
        Parameter(3010, "F", 10.0, 0.0, 1000.0),  # Kp, %/degC
        Parameter(3011, "F", 30.0, 0.0, 10000.0),  # Ti, s; 0 is no integral part
        Parameter(3012, "F", 0.0, 0.0, 1000.0),  # Td, s
        Parameter(3013, "F", 0.3, 0.0, 1.0),  # damping of the D part
        Parameter(3020, "I", 0, 0, 2),  # thermal regulation mode
        Parameter(3034, "I", 1, 0, 1),  # positive current is: 0 cooling, 1 heating
        Parameter(4010, "F", -50.0, -273.0, 1000.0),  # object temperature lower error limit, degC
        Parameter(4011, "F", 200.0, -273.0, 1000.0),  # object temperature upper error limit, degC
        Parameter(4012, "F", 1000.0, 0.0, 1000.0),  # largest object temperature change, degC/s
        Parameter(4034, "I", 1, 0, 7),  # object sensor type
        Parameter(108, "I", 0, 0, 1, volatile=True),  # automatic save to flash: 0 on, 1 off
        Parameter(50000, "I", 0, 0, 1, volatile=True),  # live enable
        Parameter(50001, "F", 0.0, -amps, amps, volatile=True),  # live current, A
        Parameter(50002, "F", volts, -volts, volts, volatile=True),  # live voltage, V
    ]
    return {parameter.number: parameter for parameter in parameters}


class MeerstetterTec(Instrument, Ticking):
    """One-channel TEC controller of the 1089 to 1161 family.

    address: 1..254. response_s: from the request's last character to the reply's first. baudrate: of the line, 1/s; inf
    takes no time. heating_sign: +1 if positive output current heats as it is wired, else -1 (parameter 3034 only says
    what the firmware believes). watchdog_error: device error that the watchdog raises, which stays until a reset (183
    by the manual's table); 0 for none.
    """

    ENDS: ClassVar[tuple[bytes, ...]] = (b"\r",)

    def __init__(
        self,
        plant: Plant,
        *,
        device_type: int = 1091,
        serial_number: int = 112,
        address: int = 1,
        baudrate: float = 57600.0,
        response_s: float = 0.002,
        heating_sign: int = 1,
        watchdog_error: int = 0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, byte_s=10.0 / baudrate, start_s=start_s)
        self._response_s = response_s
        self._requests: deque[tuple[bytes, bytes, bytes, float]] = deque()
        self._parameters = table(device_type)
        self._values: dict[int, float] = {number: p.default for number, p in self._parameters.items()}
        self._values.update({100: device_type, 101: 120, 102: serial_number, 103: 610, 2051: address})
        self._own_address = b"%02X" % address
        self._flash = dict(self._values)
        self.flash_writes = 0
        self._heating_sign, self._watchdog_error = heating_sign, watchdog_error
        self._measured = self._measured_parameters(plant)
        self._descriptions = {READ: self._value_text, b"?VL": self._limits_text}
        self._reads: dict[bytes, Callable[[], bytes]] = {}
        self._sets: dict[bytes, Parameter] = {}
        self.status_until_reset: int | None = None
        self.output_A = 0.0
        self._regulator = Regulator()
        self._last_degC = nan
        self._stable_since_s = start_s
        self._strikes: dict[int, int] = {}  # conversions in a row out of bounds, by device error
        self._unsaved = False
        self._fed_s = start_s
        self._look_s = nan
        self._restarting = False
        self._start_ticking(start_s)

    def _measured_parameters(self, plant: Plant) -> dict[int, Callable[[], float]]:
        """Return what reads each parameter that is measured, by its number."""
        return {
            104: lambda: self.status,
            109: lambda: 2 if self._values[108] else int(self._unsaved),
            1000: plant.read_temperature_degC,
            1001: plant.sink_temperature_degC,
            1010: lambda: self._values[3000],
            1011: lambda: self._nominal_degC,
            1020: lambda: self.output_A,
            1021: lambda: self.output_A * LOAD_OHM,
            1032: lambda: self._regulator.output_percent,
            1063: lambda: 35.0,
            1200: self._stability,
        }

    # ---- commands -------------------------------------------------------------------------------

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        start = line.rfind(b"#")
        body, crc = line[start:-4], line[-4:]
        if start < 0 or len(line) - start < SHORTEST_REQUEST or b"%04X" % crc_hqx(body, 0) != crc:
            return
        begin_s = max(arrival_s + self._response_s + self._values[2052] * 1e-6, self._sending_until_s)
        self._sending_until_s = begin_s + REPLY_LENGTH[body[7:8] == b"?"] * self._byte_s
        self._requests.append((body[1:7], body[7:], crc, self._sending_until_s))
        self._plant.schedule(arrival_s, self._act)

    def _next_reply_s(self) -> float | None:
        return self._requests[0][-1] if self._requests else None

    def _act(self, time_s: float) -> None:
        head, payload, crc, due_s = self._requests.popleft()
        address = head[:2]
        if address not in (b"00", b"FF", self._own_address) or self._restarting:
            return
        self._now_s = self._fed_s = time_s
        if isnan(self._look_s) and self._values[2060] > 0.0:
            self._watch()
        reply = self._answer(head, payload, crc)
        if address != b"FF":
            self._replies.append((due_s, reply))

    def _answer(self, head: bytes, payload: bytes, crc: bytes) -> bytes:
        read = self._reads.get(payload)
        if read is not None:
            return _frame(head, read())
        acknowledgement = b"!%b%b\r" % (head, crc)
        if payload[:2] == SET:
            code = self._set(payload)
            return _error(head, code) if code else acknowledgement
        if payload in (b"RS", b"ES"):
            self._reset() if payload == b"RS" else self._emergency_stop()
            return acknowledgement
        if payload[:3] == b"?IF" and len(payload) in (3, 5):  # mecompyapi appends an instance
            return _frame(head, FIRMWARE)
        describe = self._descriptions.get(payload[:3])
        if describe is None:
            return _error(head, UNKNOWN_COMMAND)
        parameter = self._parameter(payload[3:])
        if isinstance(parameter, int):
            return _error(head, parameter)
        if payload[:3] == READ:
            self._reads[payload] = lambda: self._value_text(parameter)
        return _frame(head, describe(parameter))

    def _parameter(self, text: bytes) -> Parameter | int:
        """Return the parameter that number and instance (6 digits) name, or an error code."""
        if len(text) != 6 or any(digit not in b"0123456789ABCDEF" for digit in text):
            return FORMAT
        parameter = self._parameters.get(int(text[:4], 16))
        if parameter is None:
            return UNKNOWN_PARAMETER
        return parameter if text[4:] == b"01" else UNKNOWN_INSTANCE

    def _value_text(self, parameter: Parameter) -> bytes:
        measure = self._measured.get(parameter.number)
        value = self._values[parameter.number] if measure is None else measure()
        return _float32_text(value) if parameter.kind == "F" else _int32_text(value)

    def _limits_text(self, parameter: Parameter) -> bytes:
        if parameter.kind == "F":
            return b"00" + _float32_text(parameter.minimum) + _float32_text(parameter.maximum)
        return b"01" + _int32_text(parameter.minimum) + _int32_text(parameter.maximum)

    def _set(self, payload: bytes) -> int:
        parameter = self._sets.get(payload[:8])
        if parameter is None:
            named = self._parameter(payload[2:8])
            if isinstance(named, int):
                return named
            if named.read_only:
                return READ_ONLY
            parameter = self._sets[payload[:8]] = named
        try:
            if len(payload) != 16:
                return FORMAT
            value = (_float32 if parameter.kind == "F" else _int32).unpack(unhexlify(payload[8:]))[0]
        except ValueError:
            return FORMAT
        if not parameter.allows(value):
            return OUT_OF_RANGE
        number = parameter.number
        self._values[number] = value
        if number in MOVES_OUTPUT:
            self._move_output()
        elif number == 2060:
            self._watch()
        elif number == 2051:
            self._own_address = b"%02X" % int(value)
        if not (parameter.volatile or self._unsaved or self._values[108]):
            self._unsaved = True
            self._plant.schedule(self._now_s + 0.5, self._save)
        return 0

    # ---- output ---------------------------------------------------------------------------------

    @property
    def status(self) -> int:
        """Return parameter 104: 1 ready, 2 run, 3 error, 5 resets within 200 ms."""
        if self.status_until_reset is not None:
            return self.status_until_reset
        return RUN if self._enabled() else READY

    def _enabled(self) -> bool:
        if self.status_until_reset is not None:
            return False
        enable = self._values[2010]  # 3: the hardware's pin, which nothing drives here
        return enable == 1 or (enable == 2 and self._values[50000] == 1)

    def _regulating(self) -> bool:
        return self._values[2000] == 2 and self._enabled()

    @property
    def _nominal_degC(self) -> float:
        return self._regulator.nominal_degC if self._regulating() else self._values[3000]

    def _move_output(self) -> None:
        values = self._values
        current_A = 0.0
        limit_A = min(values[2030], values[2031] / LOAD_OHM)
        if not self._regulating():
            self._regulator.start()
            self._stable_since_s = self._now_s
        if self._enabled():
            if values[2000] == 2:
                heating_A = self._regulator.output_percent / 100.0 * values[2030]
                current_A = heating_A if values[3034] == 1 else -heating_A
            else:
                number = 2020 if values[2000] == 0 else 50001
                current_A = values[number]
                limit_A = min(limit_A, abs(values[number + 1]) / LOAD_OHM)
        if abs(current_A) > limit_A:
            current_A = copysign(limit_A, current_A)
        if current_A != self.output_A:
            self.output_A = current_A
            self._plant.set_current_A(self._heating_sign * current_A)

    def _control(self) -> None:
        temperature_degC = self._plant.read_temperature_degC()
        if self.status_until_reset is None:
            self._judge(temperature_degC)
        self._last_degC = temperature_degC
        if not self._regulating() or isnan(temperature_degC):
            return
        values = self._values
        if abs(temperature_degC - values[3000]) > STABLE_K:
            self._stable_since_s = self._now_s
        self._regulator.step(
            values[3000],
            temperature_degC,
            ramp_K_per_s=values[3003],
            gain_percent_per_K=values[3010],
            integral_time_s=values[3011],
            derivative_time_s=values[3012],
            damping=values[3013],
        )
        self._move_output()

    def _judge(self, temperature_degC: float) -> None:
        """Trip on a conversion that is out of bounds or changes too fast, `TRIP_AFTER` times in a row."""
        values = self._values
        for number, wrong in (
            (SENSOR_OPEN, not isfinite(temperature_degC)),
            (BELOW_LIMIT, temperature_degC < values[4010]),
            (ABOVE_LIMIT, temperature_degC > values[4011]),
            (CHANGED_TOO_FAST, abs(temperature_degC - self._last_degC) > values[4012] * TICK_S),
        ):
            self._strikes[number] = self._strikes.get(number, 0) + 1 if wrong else 0
            if self._strikes[number] >= TRIP_AFTER:
                self.trip(number)
                return

    def _stability(self) -> int:
        if not self._regulating():
            return 0
        return 2 if self._now_s - self._stable_since_s >= STABLE_S else 1

    # ---- protection -----------------------------------------------------------------------------

    def trip(self, number: int) -> None:
        """Raise a device error: status 3 and output off until a reset."""
        self.status_until_reset = ERROR
        self._values.update({105: number, 106: 1, 107: 0})
        self._move_output()

    def _emergency_stop(self) -> None:
        self.trip(EMERGENCY_STOP)

    def _watch(self) -> None:
        """Look at the watchdog again when it would run out; one look is pending at most."""
        if self._values[2060] > 0.0:
            self._look_s = self._fed_s + self._values[2060]
            self._plant.schedule(self._look_s, self._look)
        else:
            self._look_s = nan

    def _look(self, time_s: float) -> None:
        if not time_s >= self._look_s:  # an earlier setting's look, or watching has ended
            return
        self._now_s = time_s
        if time_s - self._fed_s >= self._values[2060] - 1e-9:
            self._values[2010] = self._values[50000] = 0
            self._move_output()
            if self._watchdog_error:
                self.trip(self._watchdog_error)
            self._look_s = nan  # the next valid frame starts it again
        else:
            self._watch()

    # ---- flash and reset ------------------------------------------------------------------------

    def _save(self, _: float) -> None:
        """Write the settings to flash: the automatic save is due."""
        if self._unsaved:
            self._unsaved = False
            self._flash = dict(self._values)
            self.flash_writes += 1

    def _reset(self) -> None:
        self.status_until_reset = RESETTING
        self._move_output()
        self._plant.schedule(self._now_s + 0.2, self._restart)

    def _restart(self, time_s: float) -> None:
        self._now_s = time_s
        self._restarting = True
        self._plant.schedule(time_s + 0.3, self._ready)

    def _ready(self, time_s: float) -> None:
        self._now_s = self._fed_s = time_s
        self._restarting = False
        self._unsaved = False
        self.status_until_reset = None
        for number, parameter in self._parameters.items():
            self._values[number] = parameter.default if parameter.volatile else self._flash[number]
        for number in (100, 101, 102, 103):
            self._values[number] = self._flash[number]
        self._strikes = {}
        self._own_address = b"%02X" % int(self._values[2051])
        self._move_output()
        self._watch()


def _frame(head: bytes, payload: bytes) -> bytes:
    """Return a reply with its CRC; `head` is the request's address and sequence number, which the device echoes."""
    body = b"!" + head + payload
    return b"%b%04X\r" % (body, crc_hqx(body, 0))


def _error(head: bytes, code: int) -> bytes:
    return _frame(head, b"+%02X" % code)


def _float32_text(value: float) -> bytes:
    """Return 8 hexadecimal digits; what is beyond the range of a FLOAT32 becomes infinite."""
    try:
        return _float32.pack(value).hex().upper().encode()
    except OverflowError:
        return b"7F800000" if value > 0 else b"FF800000"


def _int32_text(value: float) -> bytes:
    return _int32.pack(int(value)).hex().upper().encode()

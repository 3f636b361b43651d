"""Meerstetter TEC controller, byte by byte: bytes and times in, bytes and times out.

Sources: "MeCom Protocol Specification" 5117C, "Communication Protocol TEC Controller" 5136AL, Meerstetter's
C header for 2020, 2021 and 500xx, `error_numbers.txt` of pyMeComTEC for error numbers.

A request takes effect when its last character has arrived; its reply reaches the host after the response
time and its own length on the wire. Not specified by the maker, and assumed here:

* the watchdog (2060) sets 2010 and 50000 to 0, so that renewed traffic does not turn the output on again;
  every valid frame for this device feeds it; it raises no device error, unless `watchdog_error` says which;
* an error (104 = 3) latches until a reset (`RS`); limits and sensor are judged on conversions of the own 10
  Hz tick, and trip after several of them in a row, so that one outlier does not (`meerstetter_strikes`);
* while it restarts, the device is silent;
* without a voltage measurement the load is a constant resistance, which turns voltage limits into current
  limits.
"""

from __future__ import annotations

from collections.abc import Callable
from math import copysign, isnan, nan

from sim.instruments import mecom
from sim.instruments.instrument import Plant
from sim.instruments.mecom_line import MeComLine
from sim.instruments.meerstetter_parameters import Parameter, table
from sim.instruments.meerstetter_strikes import Strikes
from sim.instruments.regulator import Regulator

INIT, READY, RUN, ERROR, BOOTLOADER, RESETTING = range(6)  # of parameter 104
TICK_S = 0.1  # of its control loop (not specified, see above)
EMERGENCY_STOP = 11  # device error
MOVES_OUTPUT = frozenset({2000, 2010, 2020, 2021, 2030, 2031, 3034, 50000, 50001, 50002})
READ, SET = b"?VR", b"VS"


class MeerstetterTec(MeComLine):
    """One-channel TEC controller of the 1089 to 1161 family.

    address: 1..254. response_s: from the request's last character to the reply's first. baudrate: of the
    line, 1/s; inf takes no time. heating_sign: +1 if positive output current heats as it is wired, else -1
    (parameter 3034 only says what the firmware believes). load_ohm: of the Peltier element, for 1021 and
    the voltage limits. stable_within_K, stable_for_s: when 1200 reads 2. watchdog_error: device error that the
    watchdog raises, which stays until a reset (183 by the manual's table); 0 for none.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        device_type: int = 1091,
        serial_number: int = 112,
        address: int = 1,
        firmware_text: str = "8065-TEC SW G01",
        baudrate: float = 57600.0,
        response_s: float = 0.002,
        heating_sign: int = 1,
        load_ohm: float = 2.0,
        stable_within_K: float = 0.1,
        stable_for_s: float = 10.0,
        watchdog_error: int = 0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, baudrate=baudrate, response_s=response_s, start_s=start_s)
        self._parameters = table(device_type)
        self._values: dict[int, float] = {number: p.default for number, p in self._parameters.items()}
        self._values.update({100: device_type, 101: 120, 102: serial_number, 103: 610, 2051: address})
        self._own_address = b"%02X" % address
        self._flash = dict(self._values)
        self.flash_writes = 0
        self._firmware = firmware_text.ljust(20)[:20].encode("ascii")
        self._heating_sign = heating_sign
        self._load_ohm = load_ohm
        self._stable_within_K, self._stable_for_s = stable_within_K, stable_for_s
        self._watchdog_error = watchdog_error
        self.hardware_enable = False
        self._measured = self._measured_parameters(plant)
        self._descriptions = {READ: self._value_text, b"?VM": self._metadata_text, b"?VL": self._limits_text}
        self._reads: dict[bytes, Callable[[], bytes]] = {}
        self._sets: dict[bytes, Parameter] = {}
        self._now_s = start_s
        self.status_until_reset: int | None = None
        self.output_A = 0.0
        self._regulator = Regulator()
        self._target_degC = self._values[3000]
        self._external_s = start_s - 10.0
        self._last_degC = nan
        self._stable_since_s = start_s
        self._strikes = Strikes()
        self._unsaved = False
        self._fed_s = start_s
        self._look_s = nan
        self._restarting = False
        self._ticks, self._start_s = 0, start_s
        plant.schedule(start_s + TICK_S, self._tick)

    def _measured_parameters(self, plant: Plant) -> dict[int, Callable[[], float]]:
        """What a parameter that is measured reads now, by its number."""
        return {
            104: lambda: self.status,
            109: lambda: 2 if self._values[108] else int(self._unsaved),
            1000: plant.read_temperature_degC,
            1001: plant.sink_temperature_degC,
            1010: lambda: self._target_degC,
            1011: lambda: self._nominal_degC,
            1020: lambda: self.output_A,
            1021: lambda: self.output_A * self._load_ohm,
            1032: lambda: self._regulator.output_percent,
            1063: lambda: 35.0,
            1200: self._stability,
            52200: lambda: self._values[52200] if self._now_s - self._external_s <= 5.0 else nan,
        }

    # ---- commands -------------------------------------------------------------------------------

    def _later_s(self) -> float:
        return self._values[2052] * 1e-6

    def _reply_to(self, head: bytes, payload: bytes, crc: bytes, time_s: float) -> bytes:
        address = head[:2]
        if address not in (b"00", b"FF", self._own_address) or self._restarting:
            return b""
        self._now_s = self._fed_s = time_s
        if isnan(self._look_s) and self._values[2060] > 0.0:
            self._watch()
        reply = self._answer(head, payload, crc)
        return b"" if address == b"FF" else reply

    def _answer(self, head: bytes, payload: bytes, crc: bytes) -> bytes:
        read = self._reads.get(payload)
        if read is not None:
            return mecom.reply(head, read())
        if payload[:2] == SET:
            code = self._set(payload)
            return mecom.error(head, code) if code else mecom.acknowledgement(head, crc)
        if payload in (b"RS", b"ES", b"SP"):
            {b"RS": self._reset, b"ES": self._emergency_stop, b"SP": self._save}[payload]()
            return mecom.acknowledgement(head, crc)
        if payload[:3] == b"?IF" and len(payload) in (3, 5):  # mecompyapi appends an instance
            return mecom.reply(head, self._firmware)
        describe = self._descriptions.get(payload[:3])
        if describe is None:
            return mecom.error(head, mecom.UNKNOWN_COMMAND)
        parameter = self._parameter(payload[3:])
        if isinstance(parameter, int):
            return mecom.error(head, parameter)
        if payload[:3] == READ:
            self._reads[payload] = lambda: self._value_text(parameter)
        return mecom.reply(head, describe(parameter))

    def _parameter(self, text: bytes) -> Parameter | int:
        """The parameter that `text` (number and instance, 6 digits) names, or an error code."""
        if len(text) != 6 or any(digit not in b"0123456789ABCDEF" for digit in text):
            return mecom.FORMAT
        parameter = self._parameters.get(int(text[:4], 16))
        if parameter is None:
            return mecom.UNKNOWN_PARAMETER
        return parameter if text[4:] == b"01" else mecom.UNKNOWN_INSTANCE

    def _value_text(self, parameter: Parameter) -> bytes:
        measure = self._measured.get(parameter.number)
        value = self._values[parameter.number] if measure is None else measure()
        return mecom.float32_text(value) if parameter.kind == "F" else mecom.int32_text(value)

    def _limits_text(self, parameter: Parameter) -> bytes:
        if parameter.kind == "F":
            return b"00" + mecom.float32_text(parameter.minimum) + mecom.float32_text(parameter.maximum)
        return b"01" + mecom.int32_text(parameter.minimum) + mecom.int32_text(parameter.maximum)

    def _metadata_text(self, parameter: Parameter) -> bytes:
        """Type, flags (1 readable, 2 writable), instances, elements, minimum, maximum, value."""
        limits = self._limits_text(parameter)
        flags = b"01" if parameter.read_only else b"03"
        return limits[:2] + flags + b"01" + b"00000001" + limits[2:] + self._value_text(parameter)

    def _set(self, payload: bytes) -> int:
        parameter = self._sets.get(payload[:8])
        if parameter is None:
            named = self._parameter(payload[2:8])
            if isinstance(named, int):
                return named
            if named.read_only:
                return mecom.READ_ONLY
            parameter = self._sets[payload[:8]] = named
        try:
            value = (mecom.float32_value if parameter.kind == "F" else mecom.int32_value)(payload[8:])
        except ValueError:
            return mecom.FORMAT
        if not parameter.allows(value):
            return mecom.OUT_OF_RANGE
        number = parameter.number
        self._values[number] = value
        if number in MOVES_OUTPUT:
            self._move_output()
        elif number in (3000, 50012):
            self._target_degC = value
        elif number == 2060:
            self._watch()
        elif number == 2051:
            self._own_address = b"%02X" % int(value)
        elif number == 52200:
            self._external_s = self._now_s
        if not (parameter.volatile or self._unsaved or self._values[108]):
            self._unsaved = True
            self._plant.schedule(self._now_s + 0.5, self._save)
        return 0

    # ---- output ---------------------------------------------------------------------------------

    @property
    def status(self) -> int:
        """Parameter 104: 0 init, 1 ready, 2 run, 3 error, 5 resets within 200 ms."""
        if self.status_until_reset is not None:
            return self.status_until_reset
        return RUN if self._enabled() else READY

    def _enabled(self) -> bool:
        if self.status_until_reset is not None:
            return False
        enable = self._values[2010]
        if enable == 2:
            return self._values[50000] == 1
        return enable == 1 or (enable == 3 and self.hardware_enable)

    def _regulating(self) -> bool:
        return self._values[2000] == 2 and self._enabled()

    @property
    def _nominal_degC(self) -> float:
        return self._regulator.nominal_degC if self._regulating() else self._target_degC

    def _move_output(self) -> None:
        values = self._values
        current_A = 0.0
        limit_A = min(values[2030], values[2031] / self._load_ohm)
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
                limit_A = min(limit_A, abs(values[number + 1]) / self._load_ohm)
        if abs(current_A) > limit_A:
            current_A = copysign(limit_A, current_A)
        if current_A != self.output_A:
            self.output_A = current_A
            self._plant.set_current_A(self._heating_sign * current_A)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._now_s = time_s
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        temperature_degC = self._plant.read_temperature_degC()
        if self.status_until_reset is None:
            error = self._strikes.judged(temperature_degC, self._last_degC, self._values, TICK_S)
            if error is not None:
                self.trip(error)
        self._last_degC = temperature_degC
        if not self._regulating() or isnan(temperature_degC):
            return
        values = self._values
        if abs(temperature_degC - self._target_degC) > self._stable_within_K:
            self._stable_since_s = time_s
        self._regulator.step(
            self._target_degC,
            temperature_degC,
            TICK_S,
            ramp_K_per_s=values[3003],
            gain_percent_per_K=values[3010],
            integral_time_s=values[3011],
            derivative_time_s=values[3012],
            damping=values[3013],
        )
        self._move_output()

    def _stability(self) -> int:
        if not self._regulating():
            return 0
        return 2 if self._now_s - self._stable_since_s >= self._stable_for_s else 1

    # ---- protection -----------------------------------------------------------------------------

    def trip(self, number: int) -> None:
        """Device error `number`: status 3 and output off until a reset."""
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

    def _save(self, time_s: float | None = None) -> None:
        """Write to flash what is not volatile; `time_s` is given where the automatic save is due."""
        if time_s is not None and not self._unsaved:
            return
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
        self._strikes = Strikes()
        self._own_address = b"%02X" % int(self._values[2051])
        self._target_degC = self._values[3000]
        self._move_output()
        self._watch()

"""Meerstetter TEC controllers 1089 to 1161 over MeCom.

Sources: "Communication Protocol TEC Controller" 5136AL (parameter numbers in the code), "MeCom Protocol Specification"
5117C and the receiver's rule in Meerstetter's own C code, its C header for 2020, 2021 and the live parameters 500xx,
"TEC-Family User Manual" 5216G (table of error numbers, also as `api/error_numbers.txt` in pyMeComTEC).

Every new command gets the next sequence number (random at first); a command that is sent again after silence keeps its
number. An answer counts if address, sequence number and CRC are right; for a set it must also carry the CRC of that
set. Anything else on the line is skipped, so late, foreign, repeated and garbled frames cost time but never a value.

The output is enabled through the volatile parameter 50000 (2010 = 2), so that a device that restarts comes back with
its output off. Automatic saving (108) is off before anything is set, because flash endures some 100000 writes.
"""

from __future__ import annotations

import contextlib
import random
import struct
from binascii import crc_hqx, unhexlify
from collections.abc import Iterator, Mapping
from math import isfinite
from typing import Any, ClassVar

from rig.core.errors import Corrupt, InstrumentError, Refused, TimedOut
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import (
    CURRENTS,
    OFF_S,
    SETPOINTS,
    STATUS_S,
    OwnField,
    OwnLimits,
    Status,
    TemperatureController,
    check_within,
    confirmed_off,
    packed,
    wait_until,
    wait_until_on,
)
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

TRIALS = 3  # one frame may be hurt, and its repetition by the same disturbance
TRIAL_S = 0.1  # beyond the time on the wire
PATIENT_S = 0.6  # the same while nothing is controlled yet: an adapter may hand over half an answer 0.4 s late
LONGEST_FRAME = 40
STATES = {0: "starting", 1: "ready", 2: "running", 3: "error", 4: "in its bootloader", 5: "about to reset"}
READY, RUNNING, IN_ERROR = 1, 2, 3  # of parameter 104, device status
OUT_OF_RANGE = 7  # a device's answer to a value that it does not take
LIVE_SOURCE = 1  # of parameter 2000
SOURCES = {CURRENTS: LIVE_SOURCE, SETPOINTS: 2}  # of the same
TARGETS = {CURRENTS: 50001, SETPOINTS: 3000}  # parameter that holds the current, and the setpoint
NO_OUTPUT_A = 0.1  # a current-measurement offset is no output
ZERO_S = 0.52  # until when 0 A is tried, before the emergency stop: a late answer (0.4 s) is no disobedience
RESET_S = 0.25  # from the acknowledgement of a reset (200 ms) until it is worth asking again
RESTARTED_S = 5.0  # until a device that was reset answers
COOL_DEGC = 50.0  # a device below that is not too hot, whatever error it shows
TOO_HOT, WATCHDOG = 60, 183  # device errors (parameter 105)

_float32 = struct.Struct(">f")
_int32 = struct.Struct(">i")
MEANINGS = {  # of protocol errors
    1: "command unknown",
    2: "device busy",
    3: "general error",
    4: "format error",
    5: "parameter unknown",
    6: "parameter is read-only",
    7: "value out of range",
    8: "instance unknown",
    9: "parameter failure",
}


class MecomLink:
    """A device on a MeCom line. address: its own, or 0 for the only one on the line. baudrate: of the line, 1/s."""

    def __init__(
        self,
        transport: Transport,
        *,
        address: int = 0,
        instance: int = 1,
        baudrate: float = 57600.0,
        first_token: int | None = None,
        trial_s: float = TRIAL_S,
    ) -> None:
        check_within(address=(address, 0, 254), instance=(instance, 1, 255))
        self.transport = transport
        self._address = b"%02X" % address
        self.instance = b"%02X" % instance
        self._sequence = random.randrange(0x10000) if first_token is None else first_token
        self._trial_s = trial_s + 2 * LONGEST_FRAME * 10.0 / baudrate
        self._byte_s = 10.0 / baudrate
        self._read_payloads: dict[int, bytes] = {}
        self.sent_s = 0.0

    def be_in_step(self) -> None:
        """Do nothing: the number of an answer proves what it belongs to."""

    @contextlib.contextmanager
    def patiently(self) -> Iterator[None]:
        """Wait longer for each answer inside this context: for a start, and never while something is controlled."""
        before, self._trial_s = self._trial_s, self._trial_s + PATIENT_S - TRIAL_S
        try:
            yield
        finally:
            self._trial_s = before

    def shout(self, payload: bytes) -> None:
        """Send a command at once, and wait for no acknowledgement."""
        body = self._next_body(payload)
        self.transport.send(b"%b%04X\r" % (body, crc_hqx(body, 0)))

    def query(self, payload: bytes, trials: int = TRIALS) -> bytes:
        """Return the data that answer `payload`. TimedOut, Corrupt (all trials garbled), Refused, Disconnected."""
        return self._exchange(payload, False, trials)

    def command(self, payload: bytes, trials: int = TRIALS) -> None:
        self._exchange(payload, True, trials)

    def read_float(self, parameter: int, trials: int = TRIALS) -> float:
        """Return a FLOAT32 parameter, in its unit; nan is possible."""
        value: float = _float32.unpack(self._read(parameter, trials))[0]
        return value

    def read_int(self, parameter: int, trials: int = TRIALS) -> int:
        value: int = _int32.unpack(self._read(parameter, trials))[0]
        return value

    def write_float(self, parameter: int, value: float, trials: int = TRIALS) -> None:
        self._exchange(self._setting(parameter, _float32, value), True, trials)

    def write_int(self, parameter: int, value: int, trials: int = TRIALS) -> None:
        self._exchange(self._setting(parameter, _int32, value), True, trials)

    def _setting(self, parameter: int, form: struct.Struct, value: float) -> bytes:
        """Return the payload that sets a parameter. ValueError for a value that does not fit."""
        number = packed(value, form, f"parameter {parameter}").hex().upper().encode()
        return b"VS%04X%b%b" % (parameter, self.instance, number)

    def _read(self, parameter: int, trials: int) -> bytes:
        payload = self._read_payloads.get(parameter)
        if payload is None:
            payload = self._read_payloads[parameter] = b"?VR%04X%b" % (parameter, self.instance)
        text = self._exchange(payload, False, trials)
        try:
            if len(text) != 8:
                raise ValueError
            return unhexlify(text)
        except ValueError:
            raise Corrupt(f"parameter {parameter}: {text!r} is no 32-bit value") from None

    def _next_body(self, payload: bytes) -> bytes:
        self._sequence = (self._sequence + 1) & 0xFFFF
        return b"#%b%04X%b" % (self._address, self._sequence, payload)

    def _exchange(self, payload: bytes, is_set: bool, trials: int) -> bytes:
        body = self._next_body(payload)
        crc = b"%04X" % crc_hqx(body, 0)
        frame = body + crc + b"\r"
        head = b"!" + body[1:7]
        transport = self.transport
        clock = transport.clock
        garbled = 0
        for _ in range(trials):
            transport.send(frame)
            sent_s = clock.now_s()
            deadline_s = sent_s + self._trial_s
            self.sent_s = sent_s + len(frame) * self._byte_s
            try:
                while True:
                    line = transport.receive_line(b"\r", deadline_s)
                    start = line.rfind(b"!")
                    if start:
                        line = line[start:] if start > 0 else b""
                    if len(line) == 11:
                        if is_set and line == head + crc:
                            return b""
                        continue
                    if crc_hqx(line[:-4], 0) != _number(line[-4:]) or len(line) < 11:
                        garbled += 1
                        continue
                    if line[:7] != head and not self._is_broadcast_answer(line, head):
                        continue
                    answer = line[7:-4]
                    if answer[:1] == b"+":
                        code = _number(answer[1:])
                        raise Refused(code, MEANINGS.get(code, "device error") + f": {payload.decode()}")
                    if not is_set:
                        return answer
            except TimedOut:
                continue
        if garbled:
            raise Corrupt(transport.named(f"{garbled} garbled frames and no answer to {payload.decode()}"))
        expected = f"expected one within {self._trial_s:.2g} s of one of {trials} trials"
        raise TimedOut(transport.named(f"no answer to {payload.decode()}; {expected}"))

    def _is_broadcast_answer(self, line: bytes, head: bytes) -> bool:
        """Return True for an answer to address 0: with 00 or, by the specification's prose, the device's own."""
        return self._address == b"00" and line[3:7] == head[3:7] and line[:1] == b"!"


def _number(text: bytes) -> int:
    """Return the value of hexadecimal digits; -1 if they are none."""
    try:
        return int.from_bytes(unhexlify(text), "big")
    except ValueError:
        return -1


# ---- errors of a device -----------------------------------------------------------------------------

RESET = "`peltier check CONFIG --clear` resets the device"
BROKEN = "if it comes back, the device is broken"
LOAD = "load its parameter file with the maker's program"
WAIT = "wait until the plate is within limits.temperature_degC"
# Every error takes the output off and stays until the device is reset (`RS`).
# first and last number: meaning, what has to be done before the reset
KINDS: tuple[tuple[int, int, str, str], ...] = (
    (1, 10, "its processor has failed", f"switch its supply off and on; {BROKEN}"),
    (11, 11, "emergency stop", "this program sent it, as the output did not go off: find out why before the next run"),
    (12, 12, "a hand terminal that released it has fallen silent", "release it again"),
    (20, 21, "its parameters are damaged inside", LOAD),
    (22, 24, "its parameters are empty, damaged or of another firmware", LOAD),
    (25, 29, "its firmware read a parameter that it cannot use", LOAD),
    (30, 30, "supply voltage too low", "check the supply's voltage and its current limit"),
    (31, 31, "supply voltage too high", "check the supply's voltage"),
    (32, 37, "one of its internal supplies is out of range", f"check the supply; {BROKEN}"),
    (50, 52, "its flash memory fails", BROKEN),
    (53, 53, "it could not send the answer", "look for another program on the same line"),
    (60, 60, "device too hot", "let it cool down: check its airflow, its mounting and the current"),
    (61, 61, "it cannot talk to its input and output hardware", BROKEN),
    (100, 103, "over-current at its output", "check the element and its cables for a short, and the threshold 2032"),
    (104, 105, "over-voltage at its output", "check the element and its cables for a break, and the threshold 2033"),
    (106, 106, "current leaks away at its output", "check the cables' insulation"),
    (107, 107, "over-current, switched off at once", "check the element and its cables for a short"),
    (108, 108, "its output stage is at its end", "lower the current or voltage limit, or raise the supply voltage"),
    (109, 109, "the currents of its two output drivers differ", f"check the cables for a leak; {BROKEN}"),
    (110, 110, "its largest output power is reached", "lower the current limit"),
    (111, 111, "the element's resistance is too low for this supply", "lower the current limit or the supply voltage"),
    (120, 123, "its current measurement is off at the start", f"nothing may drive its output from outside; {BROKEN}"),
    (130, 132, "its thermometer circuit has failed", BROKEN),
    (133, 133, "object sensor out of range (too low: shorted, or of another type)", "check the sensor and its cable"),
    (134, 134, "object sensor out of range (too high: open, or of another type)", "check the sensor and its cable"),
    (137, 137, "object temperature below its error limit (4010)", WAIT),
    (138, 138, "object temperature above its error limit (4011)", WAIT),
    (139, 139, "object temperature changes too fast (4012)", "check the sensor's contact and cable"),
    (140, 141, "sink sensor out of range", "check the sink sensor and its cable"),
    (142, 143, "sink temperature beyond its error limits", "let the heat sink cool down: check its fan"),
    (144, 144, "sink temperature changes too fast", "check the sink sensor's contact and cable"),
    (150, 153, "its thermometer circuit gives impossible values", f"check the sensor; {BROKEN}"),
    (160, 165, "its link to another board fails", "check the cable between the boards, and their firmware"),
    (170, 173, "its tuning of itself has failed", "start it again when the temperature rests, or not at all"),
    (175, 176, "its fan does not turn as fast as it should", "check the fan"),
    (180, 181, "a lookup table in it cannot be read", "load the table again with the maker's program"),
    (182, 182, "the temperature did not become stable in its own time", "check its stability settings"),
    (183, 183, "communication watchdog: nothing was heard from the program for the dead man's time", ""),
    (184, 184, "its display's text cannot be read", "set the display again with the maker's program"),
)


def meaning_of(number: int) -> tuple[str, str]:
    """Return the meaning of a device error, and what to do about it, in words."""
    for first, last, meaning, first_of_all in KINDS:
        if first <= number <= last:
            return meaning, f"{first_of_all}; {RESET}" if first_of_all else RESET
    return "see the manual", f"see the manual's table of error numbers; {RESET}"


class MeerstetterController(TemperatureController):
    """One channel of a Meerstetter TEC controller; see `rig.drivers.controller.TemperatureController`.

    line: settings that the port was opened with. address: the device's, or 0 for the only one on the line.
    instance: the output channel, from 1. kp_percent_per_K, ti_s, td_s: of the device's own regulation (3010 to 3012,
    % of the current limit), as `peltier tune` prints them; None leaves them as they are.
    """

    NAME = "a Meerstetter controller"
    LINE: ClassVar[LineSettings] = LineSettings(baudrate=57600)
    ON_VISA: ClassVar[bool] = False  # its lines do not end in LF
    commands_current: ClassVar[bool] = True
    has_dead_man: ClassVar[bool] = True
    has_ramp: ClassVar[bool] = True
    _regulates = True
    confirms_off_by: ClassVar[str] = "its status, and the current that it measures"
    link: MecomLink

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        address: int = 0,
        instance: int = 1,
        kp_percent_per_K: float | None = None,
        ti_s: float | None = None,
        td_s: float | None = None,
        first_token: int | None = None,
    ) -> None:
        self.transport = transport
        self.link = MecomLink(
            transport,
            address=address,
            instance=instance,
            baudrate=line.baudrate,
            first_token=first_token,
        )
        check_within(kp_percent_per_K=(kp_percent_per_K, 0.0, 1e3), ti_s=(ti_s, 0.0, 1e4), td_s=(td_s, 0.0, 1e3))
        self._own_gains = {3010: kp_percent_per_K, 3011: ti_s, 3012: td_s}
        self._heating_sign = 1.0

    @staticmethod
    def own_fields(_: Mapping[str, Any], kp_A_per_K: float, ti_s: float, td_s: float, limit: float) -> list[OwnField]:
        values = (
            ("kp_percent_per_K", round(100.0 * kp_A_per_K / limit, 2), 3010, "%/K"),
            ("ti_s", round(ti_s, 2), 3011, "s"),
            ("td_s", round(td_s, 2), 3012, "s"),
        )
        return [OwnField(name, value, f"parameter {number} = {value:g}", unit) for name, value, number, unit in values]

    @staticmethod
    def own_pid(limit: float, kp_percent_per_K: float, ti_s: float, td_s: float) -> tuple[float, float, float]:
        return kp_percent_per_K * limit / 100.0, ti_s, td_s

    def identify(self) -> Identity:
        """Ask for device type, serial number and firmware (100, 102, 103). Refused if it is no TEC controller."""
        with self.link.patiently():
            firmware_text = self.link.query(b"?IF").decode("latin-1").strip()
            device_type, number, firmware = (self.link.read_int(parameter) for parameter in (100, 102, 103))
        if not 1089 <= device_type <= 1161:
            raise Refused(None, f"device type {device_type} is no TEC controller of the 1089 to 1161 family")
        return Identity("Meerstetter", f"TEC-{device_type}", str(number), f"{firmware / 100.0:.2f} ({firmware_text})")

    def _configure(self, current_limit_A: float, limits_degC: tuple[float, float], dead_man_s: float) -> None:
        """Set output off (2010), no flash (108), 2030, 4010, 4011, watchdog 2060 (0 is none); read back each."""
        if not (dead_man_s == 0.0 or 0.1 <= dead_man_s <= 600.0):
            raise ValueError(f"dead man {dead_man_s} s: 0 (none) or 0.1 to 600 s is expected")
        with self.link.patiently():
            self._set_int(108, 1)
            self._set_int(2010, 0)
            self._set_int(50000, 0)
            self._set_current_limit(current_limit_A)
            self._set_float(4010, limits_degC[0])
            self._set_float(4011, limits_degC[1])
            self._set_float(2060, dead_man_s)
            for parameter, gain in self._own_gains.items():
                if gain is not None:
                    self._set_float(parameter, gain)
            self._heating_sign = 1.0 if self.link.read_int(3034) == 1 else -1.0
        self.dead_man_s = dead_man_s

    def _set_current_limit(self, current_limit_A: float) -> None:
        """Set 2030, read back. ValueError with both numbers if it is more than the device can (`?VL`)."""
        try:
            self._set_float(2030, current_limit_A)
        except Refused as error:
            if error.code != OUT_OF_RANGE:
                raise
            text = self.link.query(b"?VL07EE%b" % self.link.instance)
            try:
                (most_A,) = _float32.unpack(bytes.fromhex(text[-8:].decode()))
            except (ValueError, struct.error):
                raise error from None
            asked = f"current limit {current_limit_A:g} A: this device takes at most {most_A:g} A"
            raise ValueError(f"{asked}; expected limits.current_A of the Peltier element, within that") from None

    def own_limits(self) -> OwnLimits:
        """Read 2030, 4010, 4011, 2060 and 3003."""
        return OwnLimits(*(self.link.read_float(parameter) for parameter in (2030, 4010, 4011, 2060, 3003)))

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Set 3003, read back; 0 for none."""
        if not ramp_K_per_s >= 0.0:
            raise ValueError(f"ramp {ramp_K_per_s} K/s: 0 (none) or a positive number is expected")
        self._set_float(3003, ramp_K_per_s)

    def read_temperature(self) -> Reading:
        """Read the object temperature (1000), degC; `time_s` is when the request had arrived."""
        value_degC = self.link.read_float(1000)
        quality = Quality.OK if -273.15 <= value_degC <= 1000.0 else Quality.INVALID
        return Reading(value_degC, self.link.sent_s, quality)

    def read_current(self) -> Reading:
        """Read the actual output current (1020), A, positive heats by parameter 3034."""
        value_A = self._heating_sign * self.link.read_float(1020)
        return Reading(value_A, self.link.sent_s, Quality.OK if isfinite(value_A) else Quality.INVALID)

    def status(self) -> Status:
        """Read the device status (104) and, in an error, its number (105)."""
        state = self.link.read_int(104)
        if state != IN_ERROR:
            return Status(STATES.get(state, f"state {state}"), state > IN_ERROR, state == RUNNING)
        code = self.link.read_int(105)
        meaning, remedy = meaning_of(code)
        return Status(f"error {code}: {meaning}", True, False, code, meaning, remedy)

    def clear_error(self) -> None:
        """Reset (RS), wait for an answer without an error, and configure anew: a reset forgets the settings."""
        self._armed = None
        clock = self.transport.clock
        with self.link.patiently():
            self.link.command(b"RS")
        clock.sleep_until_s(clock.now_s() + RESET_S)
        if not wait_until(clock, self._is_ready, RESTARTED_S):
            status = self.status()
            raise Refused(status.code or None, f"a reset did not clear it: {status.text}")
        if isfinite(self.current_limit_A):
            self.configure(self.current_limit_A, self.temperature_limits_degC, self.dead_man_s)

    def off(self) -> bool:
        """Set 2010 = 0 and 50000 = 0; then 0 A (50001, by the live source); then the emergency stop (ES). Never raises.

        Return True if 2010, the status and the current read back off.
        """
        self._armed = None
        ways = ((self._plainly_off, STATUS_S), (self._off_and_zero, ZERO_S), (self._emergency_stop, OFF_S))
        return confirmed_off(self.transport, ways)

    def _plainly_off(self) -> bool:
        self.link.write_int(2010, 0, trials=1)
        self.link.write_int(50000, 0, trials=1)
        return self._reads_off()

    def _off_and_zero(self) -> bool:
        """Wait for no acknowledgements: the device may hear although its answers are lost."""
        for parameter, value in ((2010, 0), (50000, 0), (50001, 0), (2000, LIVE_SOURCE)):  # 0 is 0.0 A as well
            self.link.shout(b"VS%04X%b%08X" % (parameter, self.link.instance, value))
        return self._reads_off()

    def _emergency_stop(self) -> bool:
        self.link.shout(b"ES")
        return self._off_and_zero()

    def _reads_off(self) -> bool:
        """Return True if it is set to off and not running, or in an error (an emergency stop), and no current flows."""
        set_off = self.link.read_int(2010, trials=1) == 0
        state = self.link.read_int(104, trials=1)
        return (
            state != RUNNING
            and (set_off or state == IN_ERROR)
            and abs(self.link.read_float(1020, trials=1)) <= NO_OUTPUT_A
        )

    def _choose(self, commands: str) -> None:
        """Take the live source (2000 = 1) with the voltage limit as its voltage, or own regulation (2000 = 2)."""
        if commands == CURRENTS:
            self._set_float(50002, self.link.read_float(2031))
        self._set_int(2000, SOURCES[commands])

    def _send(self, commands: str, value: float, arming: bool) -> None:
        """Set 50001 or 3000; read back while arming."""
        if commands == CURRENTS:
            value *= self._heating_sign
        (self._set_float if arming else self.link.write_float)(TARGETS[commands], value)

    def _switch_on(self, commands: str) -> None:
        self._set_int(50000, 1)
        self._set_int(2010, 2)
        wait_until_on(self.transport.clock, self.status)

    def _make_ready(self) -> None:
        """Clear the error that the device's own dead man leaves: this program fell silent itself."""
        status = self.status()
        if status.is_error and self._is_the_dead_mans(status.code):
            self.clear_error()

    def _is_the_dead_mans(self, code: int) -> bool:
        """Return True for 183, and for 60 of a cool device: some firmware shows "too hot" for the dead man, too."""
        if code == WATCHDOG:
            return True
        return code == TOO_HOT and self.dead_man_s > 0.0 and self.link.read_float(1063) < COOL_DEGC

    def _is_ready(self) -> bool:
        try:
            return self.link.read_int(104, trials=1) in (READY, RUNNING)
        except InstrumentError:
            return False

    def _set_int(self, parameter: int, value: int) -> None:
        self.link.write_int(parameter, value)
        read_back = self.link.read_int(parameter)
        if read_back != value:
            raise Refused(None, f"parameter {parameter} was set to {value} and reads {read_back}")

    def _set_float(self, parameter: int, value: float) -> None:
        self.link.write_float(parameter, value)
        read_back = self.link.read_float(parameter)
        if read_back != _float32.unpack(_float32.pack(value))[0]:
            raise Refused(None, f"parameter {parameter} was set to {value} and reads {read_back}")

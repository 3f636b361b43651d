"""Meerstetter TEC controllers 1089 to 1161 over MeCom.

Sources: "Communication Protocol TEC Controller" 5136AL (parameter numbers in the code), "MeCom Protocol
Specification" 5117C, Meerstetter's C header for 2020, 2021 and the live parameters 500xx.

The output is enabled through the volatile parameter 50000 (2010 = 2), so a device that restarts comes back
with its output off; automatic saving (108) is off before anything is set, because flash endures some 100000
writes.
"""

from __future__ import annotations

import struct
from math import isfinite, nan
from typing import ClassVar

from rig.core.errors import InstrumentError, Refused
from rig.core.reading import Quality, Reading
from rig.drivers.confirmed import OFF_S, STATUS_S, comes_on, confirmed_off, waited_for
from rig.drivers.controller import OwnLimits, Status
from rig.drivers.identity import Identity
from rig.drivers.mecom import MecomLink
from rig.drivers.meerstetter_errors import TOO_HOT, WATCHDOG, meaning_of
from rig.drivers.option_kinds import check_gains
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

STATES = {0: "starting", 1: "ready", 2: "running", 3: "error", 4: "in its bootloader", 5: "about to reset"}
READY, RUNNING, IN_ERROR = 1, 2, 3  # of parameter 104, device status
OUT_OF_RANGE = 7  # what a device says to a value that it does not take
LIVE_SOURCE, OWN_REGULATION = 1, 2
NO_OUTPUT_A = 0.1  # a current-measurement offset is no output
ZERO_S = 0.52  # until when 0 A is tried, before the emergency stop: a late answer (0.4 s) is no disobedience
RESET_S = 0.25  # from the acknowledgement of a reset (200 ms) until it is worth asking again
RESTARTED_S = 5.0  # until a device that was reset answers
COOL_DEGC = 50.0  # a device below that is not too hot, whatever error it shows

_float32 = struct.Struct(">f")


class MeerstetterController:
    """One channel of a Meerstetter TEC controller; see `rig.drivers.controller.TemperatureController`.

    line: settings that the port was opened with. address: the device's, or 0 for the only one on the line.
    instance: the output channel, from 1. kp_percent_per_K, ti_s, td_s: of the device's own regulation (3010 to 3012,
    % of the current limit), as `peltier tune` prints them; None leaves them as they are.
    """

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=57600)
    commands_current: ClassVar[bool] = True
    has_dead_man: ClassVar[bool] = True
    has_ramp: ClassVar[bool] = True
    confirms_off_by: ClassVar[str] = "its status, and the current that it measures"

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
        first_sequence: int | None = None,
    ) -> None:
        self.transport = transport
        self.link = MecomLink(
            transport,
            address=address,
            instance=instance,
            baudrate=line.baudrate,
            first_sequence=first_sequence,
        )
        self.current_limit_A = nan
        self.temperature_limits_degC = (nan, nan)
        self.dead_man_s = 0.0
        check_gains(kp_percent_per_K=(kp_percent_per_K, 0.0, 1e3), ti_s=(ti_s, 0.0, 1e4), td_s=(td_s, 0.0, 1e3))
        self._own_gains = {3010: kp_percent_per_K, 3011: ti_s, 3012: td_s}
        self._heating_sign = 1.0
        self._armed_source: int | None = None

    def identify(self) -> Identity:
        """Device type, serial number and firmware (100, 102, 103). Refused where it is no TEC controller."""
        with self.link.patiently():
            firmware_text = self.link.query(b"?IF").decode("latin-1").strip()
            device_type, number, firmware = (self.link.read_int(parameter) for parameter in (100, 102, 103))
        if not 1089 <= device_type <= 1161:
            raise Refused(None, f"device type {device_type} is no TEC controller of the 1089 to 1161 family")
        return Identity("Meerstetter", f"TEC-{device_type}", str(number), f"{firmware / 100.0:.2f} ({firmware_text})")

    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Output off (2010), no flash (108), 2030, 4010, 4011, watchdog 2060 (0 is none); each read back."""
        low_degC, high_degC = temperature_limits_degC
        if not (isfinite(current_limit_A) and current_limit_A > 0.0):
            raise ValueError(f"current limit {current_limit_A} A: a positive number is expected")
        if not (isfinite(low_degC) and isfinite(high_degC) and low_degC < high_degC):
            raise ValueError(f"temperature limits {low_degC}, {high_degC} degC: two rising numbers are expected")
        if not (dead_man_s == 0.0 or 0.1 <= dead_man_s <= 600.0):
            raise ValueError(f"dead man {dead_man_s} s: 0 (none) or 0.1 to 600 s is expected")
        self._armed_source = None
        with self.link.patiently():
            self._set_int(108, 1)
            self._set_int(2010, 0)
            self._set_int(50000, 0)
            self._set_current_limit(current_limit_A)
            self._set_float(4010, low_degC)
            self._set_float(4011, high_degC)
            self._set_float(2060, dead_man_s)
            for parameter, gain in self._own_gains.items():
                if gain is not None:
                    self._set_float(parameter, gain)
            self._heating_sign = 1.0 if self.link.read_int(3034) == 1 else -1.0
        self.current_limit_A = current_limit_A
        self.temperature_limits_degC = (low_degC, high_degC)
        self.dead_man_s = dead_man_s

    def _set_current_limit(self, current_limit_A: float) -> None:
        """2030, read back. ValueError with both numbers where it is more than the device can (`?VL`)."""
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
        """2030, 4010, 4011, 2060 and 3003."""
        return OwnLimits(*(self.link.read_float(parameter) for parameter in (2030, 4010, 4011, 2060, 3003)))

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """3003, read back; 0 for none."""
        if not (isfinite(ramp_K_per_s) and ramp_K_per_s >= 0.0):
            raise ValueError(f"ramp {ramp_K_per_s} K/s: 0 (none) or a positive number is expected")
        self._set_float(3003, ramp_K_per_s)

    def arm_current(self) -> None:
        """Live source (2000 = 1) at 0 A with the voltage limit as its voltage, enabled by 50000."""
        self._make_ready()
        self._set_float(50001, 0.0)
        self._set_float(50002, self.link.read_float(2031))
        self._enable(LIVE_SOURCE)

    def set_current_A(self, current_A: float) -> None:
        """Parameter 50001; outside the configured limit is a ValueError."""
        if not abs(current_A) <= self.current_limit_A:
            raise ValueError(f"{current_A} A is outside the configured +-{self.current_limit_A} A")
        if self._armed_source != LIVE_SOURCE:
            raise Refused(None, "the output is not armed for currents")
        self.link.write_float(50001, self._heating_sign * current_A)

    def arm_setpoint(self) -> None:
        """The device's own regulation (2000 = 2), target (3000) at the object's temperature of now."""
        self._make_ready()
        now = self.read_temperature()
        low_degC, high_degC = self.temperature_limits_degC
        if not (now.is_number and low_degC <= now.value <= high_degC):
            raise Refused(None, f"object temperature {now.value} degC is not within {low_degC} to {high_degC} degC")
        self._set_float(3000, now.value)
        self._enable(OWN_REGULATION)

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Parameter 3000; outside the configured limits is a ValueError."""
        low_degC, high_degC = self.temperature_limits_degC
        if not low_degC <= setpoint_degC <= high_degC:
            raise ValueError(f"{setpoint_degC} degC is outside the configured {low_degC} to {high_degC} degC")
        if self._armed_source != OWN_REGULATION:
            raise Refused(None, "the output is not armed for setpoints")
        self.link.write_float(3000, setpoint_degC)

    def read_temperature(self) -> Reading:
        """Object temperature (1000), degC; `time_s` is when the request had arrived."""
        value_degC = self.link.read_float(1000)
        quality = Quality.OK if -273.15 <= value_degC <= 1000.0 else Quality.INVALID
        return Reading(value_degC, self.link.sent_s, quality)

    def read_current(self) -> Reading:
        """Actual output current (1020), A, positive heats by parameter 3034."""
        value_A = self._heating_sign * self.link.read_float(1020)
        return Reading(value_A, self.link.sent_s, Quality.OK if isfinite(value_A) else Quality.INVALID)

    def status(self) -> Status:
        """Device status (104) and, in an error, its number (105)."""
        state = self.link.read_int(104)
        if state != IN_ERROR:
            return Status(STATES.get(state, f"state {state}"), state > IN_ERROR, state == RUNNING)
        code = self.link.read_int(105)
        meaning, remedy = meaning_of(code)
        return Status(f"error {code}: {meaning}", True, False, code, meaning, remedy)

    def clear_error(self) -> None:
        """Reset (RS), wait until it answers without an error, and configure it anew: a reset forgets the settings."""
        self._armed_source = None
        clock = self.transport.clock
        with self.link.patiently():
            self.link.command(b"RS")
        clock.sleep_until_s(clock.now_s() + RESET_S)
        if not waited_for(clock, self._is_ready, RESTARTED_S):
            status = self.status()
            raise Refused(status.code or None, f"a reset did not clear it: {status.text}")
        if isfinite(self.current_limit_A):
            self.configure(self.current_limit_A, self.temperature_limits_degC, self.dead_man_s)

    def off(self) -> bool:
        """2010 = 0 and 50000 = 0; then 0 A (50001, by the live source); then the emergency stop (ES). Never raises.

        True if 2010, the status and the current say so.
        """
        self._armed_source = None
        ways = ((self._plainly_off, STATUS_S), (self._off_and_zero, ZERO_S), (self._emergency_stop, OFF_S))
        return confirmed_off(self.transport, ways)

    def _plainly_off(self) -> bool:
        self.link.write_int(2010, 0, trials=1)
        self.link.write_int(50000, 0, trials=1)
        return self._reads_off()

    def _off_and_zero(self) -> bool:
        """Nobody waits for acknowledgements: it may hear, and its answers be lost."""
        for parameter, value in ((2010, 0), (50000, 0), (50001, 0), (2000, LIVE_SOURCE)):  # 0 is 0.0 A as well
            self.link.shout_int(parameter, value)
        return self._reads_off()

    def _emergency_stop(self) -> bool:
        self.link.shout(b"ES")
        return self._off_and_zero()

    def _reads_off(self) -> bool:
        """Told to be off and not running; or in an error, such as that of an emergency stop. And no current flows."""
        told = self.link.read_int(2010, trials=1) == 0
        state = self.link.read_int(104, trials=1)
        return (
            state != RUNNING
            and (told or state == IN_ERROR)
            and abs(self.link.read_float(1020, trials=1)) <= NO_OUTPUT_A
        )

    def close(self) -> None:
        """Let go of the port; the output stays as it is."""
        self.transport.close()

    def _enable(self, source: int) -> None:
        self._armed_source = None
        self._set_int(2000, source)
        self._set_int(50000, 1)
        self._set_int(2010, 2)
        comes_on(self.transport.clock, self.status)
        self._armed_source = source

    def _make_ready(self) -> None:
        """Configured, and without the error that the device's own dead man leaves: this program fell silent itself."""
        if not isfinite(self.current_limit_A):
            raise Refused(None, "limits are not configured yet")
        self._armed_source = None
        status = self.status()
        if status.is_error and self._is_the_dead_mans(status.code):
            self.clear_error()

    def _is_the_dead_mans(self, code: int) -> bool:
        """183 says so. Some firmware shows 60, which means too hot as well: then the device's temperature decides."""
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

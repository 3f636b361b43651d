"""TE Technology TC-36-25 RS232 and TC-48-20 temperature controllers.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50 (codes are hexadecimal); TC-48-20 manual, Appendix B p. 48 to 54.

They command power in percent, never amperes, so the current is unknown: `commands_current` is False, `arm_current` and
`set_current_A` are Refused, `read_current` is no number, and the rig falls back to setpoints for the instrument's own
regulation. The current limit cannot be set either (the supply's voltage over the element's resistance is what it is).
There is no dead man.

TC-36-25: writing to its EEPROM (some 1e6 times) is switched off (34) before anything else is written; the working units
(4b) are read before a temperature is trusted; the number that fences (`rig.drivers.te_link`) goes to the control
deadband (25), which only the deadband type of control uses, and the driver chooses PID (2b). Not verified: that alarm
type 2 is fixed alarms, that the deadband takes 0.01 to 99.99.
TC-48-20: no code is known that reads its units (`units` has to be given), switches its EEPROM off or sets its alarms;
its output enable reads back by code 64 (not verified: `power_read_code`); the model number (00) is its fence.

A temperature is read twice between fences. Two readings within `SAME_K` of each other count; otherwise three are made,
of which two have to be within `agreement_K` (by default 0.14 K, less than the 15 units by which a corruption that the
sum misses changes a value), and the middle one counts: a single one that is wrong is never it. Residual: two of them
hurt alike. A plate faster than 3 K/s moves by more than the agreement between two readings at 9600 Bd, and is never
read.

At 9600 Bd an exchange takes 45 ms, a temperature three of them, a setpoint three: a period of 0.5 s is right.
"""

from __future__ import annotations

import re
from math import isfinite, nan
from typing import ClassVar

from rig.core.errors import Corrupt, Refused, TimedOut
from rig.core.reading import Quality, Reading
from rig.drivers.asked_again import asked_again
from rig.drivers.confirmed import OFF_S, STARTED_S, STATUS_S, comes_on, confirmed_off, waited_for
from rig.drivers.controller import OwnLimits, Status
from rig.drivers.identity import Identity
from rig.drivers.option_kinds import check_gains
from rig.drivers.setpoint_only import SetpointOnly
from rig.drivers.te_link import Request, TeLink
from rig.drivers.te_models import MODEL_CODE, MODELS, model_of, status_of
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

LONGEST_PAUSE_S = 60.0  # of silence on a line; the slowest of these controllers needs 2.5 s
TRIALS = 3
CONTROL_SENSOR: Request = (b"01", None)
GAIN_UNITS = 100  # of a repeat per minute, and of a minute
LARGEST_FIELD = 32767  # of 16 bits with a sign
SAME_K = 0.02  # two readings that are the same but for noise
LOWEST_DEGC, HIGHEST_DEGC = -200.0, 600.0  # a reading beyond is an open sensor


class TeTechnologyController(SetpointOnly):
    """See `rig.drivers.controller.TemperatureController`.

    model: "tc-36-25" or "tc-48-20". address: 0, or that of an RS-485 model. gap_s: from a reply to the next request
    (the manual advises a delay; not verified how long). drain_s: how long the line has to be silent after doubt.
    units: "degC" or "degF" where the model cannot be asked. alarm_type: None leaves the alarms as they are.
    bandwidth_K, integral_per_min, derivative_min: of its own regulation (1d, 1e, 1f), as `peltier tune` prints them;
    None leaves them as they are.
    """

    LINE: ClassVar[LineSettings] = MODELS["tc-36-25"].line
    confirms_off_by: ClassVar[str] = "its power switch read back; it shows no current"

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings | None = None,
        model: str = "tc-36-25",
        address: int = 0,
        gap_s: float = 0.01,
        drain_s: float | None = None,
        agreement_K: float = 0.14,
        units: str | None = None,
        alarm_type: int | None = 2,
        power_read_code: str | None = None,
        bandwidth_K: float | None = None,
        integral_per_min: float | None = None,
        derivative_min: float | None = None,
        first_token: int | None = None,
    ) -> None:
        if not 0 <= address <= 255:
            raise ValueError(f"address {address}: 0 to 255 is expected")
        if units not in (None, "degC", "degF"):
            raise ValueError(f"units {units!r}: 'degC' or 'degF' is expected")
        if agreement_K <= 0.0:
            raise ValueError(f"agreement_K {agreement_K}: more than 0 is expected")
        for name, pause_s in (("gap_s", gap_s), ("drain_s", drain_s or 0.0)):
            if not 0.0 <= pause_s <= LONGEST_PAUSE_S:
                raise ValueError(f"{name} {pause_s}: 0 to {LONGEST_PAUSE_S:g} is expected")
        if alarm_type is not None and not 0 <= alarm_type <= 9:
            raise ValueError(f"alarm_type {alarm_type}: 0 to 9 is expected")
        if power_read_code is not None and not re.fullmatch("[0-9a-z]{2}", power_read_code):
            raise ValueError(f"power_read_code {power_read_code!r}: two digits of a command are expected")
        self._model = table = model_of(model)
        self.NAME = f"a {table.name}"
        self.transport = transport
        self.link = TeLink(
            transport,
            table.dialect,
            address=address,
            byte_s=(table.line if line is None else line).byte_s,
            gap_s=gap_s,
            drain_s=table.drain_s if drain_s is None else drain_s,
            first_token=first_token,
        )
        self.temperature_limits_degC = (nan, nan)
        self._agreement_K = agreement_K
        self._fahrenheit: bool | None = None if units is None else units == "degF"
        self._given_units = units is not None
        self._alarm_type = alarm_type
        self._power_read = table.power_read if power_read_code is None else power_read_code.encode("ascii")
        largest = LARGEST_FIELD / GAIN_UNITS
        check_gains(
            bandwidth_K=(bandwidth_K, 1.0 / table.per_degC, LARGEST_FIELD / table.per_degC),
            integral_per_min=(integral_per_min, 0.0, largest),
            derivative_min=(derivative_min, 0.0, largest),
        )
        self._own_gains = bandwidth_K, integral_per_min, derivative_min
        self._armed = False
        self._looked_after = 0

    @classmethod
    def line_for(cls, **options: object) -> LineSettings:
        """Line settings of the model that the options name. ValueError where there is none."""
        return model_of(options.get("model", "tc-36-25")).line

    @asked_again
    def identify(self) -> Identity:
        """The TC-36-25 has no identification: its sensor type (43) has to be 0 to 5. Refused."""
        if self._model.dialect.fence_read:
            (number,) = self._exchange((self._model.dialect.fence_read, None))
            wrong = number != MODEL_CODE
        else:
            (number,) = self._exchange((b"43", None))
            wrong = not 0 <= number <= 5
        if wrong:
            raise Refused(None, f"what answers reads {number}, and is no {self._model.name}")
        return Identity("TE Technology", self._model.name, "", "")

    @asked_again
    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Output off, EEPROM off, own regulation by setpoints from here, alarms that shut down; each read back.

        Neither the current limit nor a dead man can be set.
        """
        low_degC, high_degC = temperature_limits_degC
        if not (isfinite(current_limit_A) and current_limit_A > 0.0):
            raise ValueError(f"current limit {current_limit_A} A: a positive number is expected")
        if not (isfinite(low_degC) and isfinite(high_degC) and low_degC < high_degC):
            raise ValueError(f"temperature limits {low_degC}, {high_degC} degC: two rising numbers are expected")
        self._armed = False
        model = self._model
        self._set(model.power_write, self._power_read, 0)
        for write, read, value in model.settings:
            self._set(write, read, value)
        self._learn_units()
        self._set_own_gains()
        if model.limits and self._alarm_type is not None:
            for (write, read), limit_degC in zip(model.limits, temperature_limits_degC, strict=True):
                self._set(write, read, self._fixed(limit_degC))
            self._set(*model.alarm_type, self._alarm_type)
        self.temperature_limits_degC = (low_degC, high_degC)

    def _set_own_gains(self) -> None:
        """Proportional band in its own degrees, repeats per minute, minutes: those that were given."""
        band_K, integral, derivative = self._own_gains
        if band_K is not None:
            self._set(b"1d", b"51", round(band_K * (1.8 if self._fahrenheit else 1.0) * self._model.per_degC))
        for write, read, gain in ((b"1e", b"52", integral), (b"1f", b"53", derivative)):
            if gain is not None:
                self._set(write, read, round(gain * GAIN_UNITS))

    def own_limits(self) -> OwnLimits:
        """Low and high alarm (58, 57), where the model is known to have them."""
        if not self._model.limits or self._alarm_type is None:
            return OwnLimits()
        self._learn_units()
        low, high = self._exchange(*((read, None) for _, read in self._model.limits))
        return OwnLimits(low_degC=self._degC(low), high_degC=self._degC(high))

    def arm_setpoint(self) -> None:
        """Output on under the instrument's own regulation, held at the temperature of now."""
        low_degC, high_degC = self.temperature_limits_degC
        if not isfinite(low_degC):
            raise Refused(None, "limits are not configured yet")
        self._armed = False
        now = self.read_temperature()
        if not (now.is_number and low_degC <= now.value <= high_degC):
            raise Refused(None, f"temperature {now.value} degC is not within {low_degC} to {high_degC} degC")
        self._set(b"1c", b"50", self._fixed(now.value))
        self._set(self._model.power_write, self._power_read, 1)
        comes_on(self.transport.clock, self.status)
        self._armed = True

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Set temperature (1c), read back. ValueError outside the configured limits: nothing is sent."""
        low_degC, high_degC = self.temperature_limits_degC
        if not low_degC <= setpoint_degC <= high_degC:
            raise ValueError(f"{setpoint_degC} degC is outside the configured {low_degC} to {high_degC} degC")
        if self.link.in_doubt:
            self.link.resynchronise()
            self._look_after_doubt()
        if not self._armed:
            raise Refused(None, "the output is not armed for setpoints")
        self._set(b"1c", b"50", self._fixed(setpoint_degC))

    def read_temperature(self) -> Reading:
        """Control sensor (01), degC; `time_s` is when the last of two requests had arrived, or the second of three."""
        self._learn_units()
        per_K = self._model.per_degC * (1.8 if self._fahrenheit else 1.0)
        for _ in range(TRIALS):
            first, second = self._exchange(CONTROL_SENSOR, CONTROL_SENSOR)
            time_s = self.link.arrivals_s[-1]
            if abs(first - second) <= SAME_K * per_K:
                return self._temperature(second, time_s)
            readings = sorted(self._exchange(CONTROL_SENSOR, CONTROL_SENSOR, CONTROL_SENSOR))
            time_s = self.link.arrivals_s[1]
            if min(readings[1] - readings[0], readings[2] - readings[1]) <= self._agreement_K * per_K:
                return self._temperature(readings[1], time_s)
        self.link.doubt()
        raise Corrupt(f"three readings one after the other are {readings}")

    def _temperature(self, fixed: int, time_s: float) -> Reading:
        value_degC = self._degC(fixed)
        quality = Quality.OK if LOWEST_DEGC <= value_degC <= HIGHEST_DEGC else Quality.INVALID
        return Reading(value_degC if quality is Quality.OK else nan, time_s, quality)

    def read_power_percent(self) -> Reading:
        """Power output (02), % of full power, positive heats as far as the instrument's polarity is set so."""
        (value,) = self._exchange((b"02", None))
        return Reading(value / 511.0 * 100.0, self.link.arrived_s, Quality.OK if abs(value) <= 511 else Quality.INVALID)

    def status(self) -> Status:
        """Alarms (05, on the TC-48-20 03) and whether power is on (46)."""
        alarms, on = self._exchange((self._model.alarms, None), (self._power_read, None))
        return status_of(self._model, alarms, on == 1)

    def clear_error(self) -> None:
        """Reset the latches (33). Refused where an alarm stays, or where no code for it is known (TC-48-20)."""
        if not self._model.reset_latches:
            super().clear_error()
        self._exchange((self._model.reset_latches, 1))
        found: list[Status] = []

        def is_clear() -> bool:
            found[:] = [self.status()]
            return not found[0].is_error

        if not waited_for(self.transport.clock, is_clear, STARTED_S):
            raise Refused(found[0].code, f"resetting the latches did not clear it: {found[0].meaning}")

    def off(self) -> bool:
        """Power off; then again and again, without waiting for acknowledgements. True if it reads back so twice (46).

        It takes no current, and the manual knows no emergency stop. A line in doubt has to be drained before an answer
        proves anything: then it takes `drain_s` longer where the instrument answers. Never raises.
        """
        self._armed = False
        ways = ((self._off_once, STATUS_S), (self._shout_off, OFF_S))
        return confirmed_off(self.transport, ways, self.link.doubt)

    def _off_once(self) -> bool:
        if self.link.in_doubt:
            return self._shout_off()
        off, read = (self._model.power_write, 0), (self._power_read, None)
        return self.link.sequence(off, read, read, trials=1)[1:] == [0, 0]

    def _shout_off(self) -> bool:
        self.link.shout(self._model.power_write, 0)
        if not self.link.answers():
            raise TimedOut(self.transport.told("no answer to a switch of its output"))
        off, read = (self._model.power_write, 0), (self._power_read, None)
        return self.link.sequence(off, read, read, trials=1)[1:] == [0, 0]

    def _exchange(self, *requests: Request) -> list[int]:
        replies, arrivals_s = self.link.sequence(*requests), self.link.arrivals_s
        self._look_after_doubt()
        self.link.arrivals_s = arrivals_s
        return replies

    def _set(self, write: bytes, read: bytes, value: int) -> None:
        _, read_back = self.link.sequence((write, value), (read, None))
        if read_back != value:
            raise Refused(
                None, f"{value} was written by code {write.decode()}, and code {read.decode()} reads {read_back}"
            )

    def _learn_units(self) -> None:
        if self._fahrenheit is not None:
            return
        if not self._model.units:
            raise Refused(None, f"a {self._model.name} does not report its working units: the option `units` is needed")
        (units,) = self.link.sequence((self._model.units, None))
        if units not in (0, 1):
            raise Refused(None, f"working units read {units}")
        self._fahrenheit = units == 0

    def _look_after_doubt(self) -> None:
        """After the line was in doubt the instrument may have restarted: units and power are asked for again."""
        if self.link.resynchronised == self._looked_after:
            return
        self._looked_after = self.link.resynchronised
        if self._model.units and not self._given_units and self._fahrenheit is not None:
            self._fahrenheit = None
            self._learn_units()
        if self._armed:
            (on,) = self.link.sequence((self._power_read, None))
            self._armed = on == 1

    def _fixed(self, temperature_degC: float) -> int:
        value = temperature_degC * 1.8 + 32.0 if self._fahrenheit else temperature_degC
        return round(value * self._model.per_degC)

    def _degC(self, fixed: int) -> float:
        value = fixed / self._model.per_degC
        return (value - 32.0) / 1.8 if self._fahrenheit else value

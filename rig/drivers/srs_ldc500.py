"""SRS LDC501, the temperature controller in it, on its RS-232 port.

Sources: LDC500 series manual, remote chapter p. 4-10, 4-16, 4-37, 4-38, 4-47, 4-54. Not verified on an instrument: the
sign of the current that heats (`heating_sign`: check with a small pulse), `*ESE`, how a number is written.

There is no checksum. A reading is asked for twice in one line, with a token between and one behind
(`rig.drivers.srs_line`), and counts if both are alike; a setting is read back in the line that sets it. Residual: a
corruption that changes both copies of a reading alike and leaves the tokens as they are; for random bursts at a share p
of the answers less than p^2 / 8 / 256 (8 places, 256 characters). A setting garbled on its way acts until the read-back
has shown it, some 50 ms at 9600 Bd; the instrument's own limits (TILM, TMIN, TMAX) hold meanwhile.

It has no dead man: when the host falls silent the output stays as it is. At 9600 Bd a temperature takes 63 ms and a
current 58 ms: with both, a period of 0.2 s is right.
"""

from __future__ import annotations

import contextlib
import re
from math import isfinite, nan
from typing import ClassVar

from rig.core.errors import Corrupt, InstrumentError, Refused
from rig.core.reading import Quality, Reading
from rig.drivers.asked_again import asked_again
from rig.drivers.confirmed import OFF_S, STARTED_S, STATUS_S, confirmed_off, waited_for
from rig.drivers.controller import OwnLimits, Status
from rig.drivers.identity import Identity
from rig.drivers.option_kinds import check_gains
from rig.drivers.srs_line import COMMAND_ERRORS, SrsLink
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

CURRENT_MODE, TEMPERATURE_MODE = 0, 1  # of TMOD
WORDS = {"OFF": 0, "ON": 1, "CC": CURRENT_MODE, "CT": TEMPERATURE_MODE}
LARGEST_CURRENT_A = 4.5  # of the LDC500 series' temperature controller
RESOLUTION_A, RESOLUTION_K = 2e-3, 2e-3  # a setting that reads back within this is the one that was set
NO_OUTPUT_A = 0.05  # a current-measurement offset is no output
TRIALS = 3
OFF_ANSWER_S = 0.1  # until an answer to "off" begins, beyond the time on the wire
NUMBER = re.compile(r"[+-]?\d{1,6}(\.\d{0,9})?([eE][+-]?\d{1,2})?")


class SrsLdc500Controller:
    """See `rig.drivers.controller.TemperatureController`.

    line: settings that the port was opened with. heating_sign: +1 if positive current heats as the element is wired,
    -1 if it cools. p_A_per_K, i_per_s, d_s: of its own regulation (TPGN, TIGN, TDGN), as `peltier tune` prints them;
    None leaves them as they are.
    """

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=9600)
    commands_current: ClassVar[bool] = True
    has_dead_man: ClassVar[bool] = False
    has_ramp: ClassVar[bool] = False
    confirms_off_by: ClassVar[str] = "its switch read back twice, and the current that it measures"
    dead_man_s = 0.0

    def __init__(
        self,
        transport: Transport,
        *,
        line: LineSettings = LINE,
        heating_sign: int = 1,
        p_A_per_K: float | None = None,
        i_per_s: float | None = None,
        d_s: float | None = None,
        first_token: int | None = None,
    ) -> None:
        if heating_sign not in (1, -1):
            raise ValueError(f"heating sign {heating_sign}: 1 or -1 is expected")
        self.transport = transport
        self.link = SrsLink(
            transport, byte_s=line.byte_s, first_token=first_token, after_resynchronisation=self._look_after_doubt
        )
        self.current_limit_A = nan
        self.temperature_limits_degC = (nan, nan)
        self._heating_sign = heating_sign
        check_gains(p_A_per_K=(p_A_per_K, -1e3, 1e3), i_per_s=(i_per_s, 0.0, 1e3), d_s=(d_s, 0.0, 1e3))
        self._own_gains = {"TPGN": p_A_per_K, "TIGN": i_per_s, "TDGN": d_s}
        self._armed_mode: int | None = None

    @asked_again
    def identify(self) -> Identity:
        """`*IDN?`. Refused where it is no LDC501 (or 500, 502, which have the same temperature controller)."""
        maker, model, number, firmware = (
            part.strip() for part in (self.link.ask_alone("*IDN?") + ",,,").split(",")[:4]
        )
        if "STANFORD" not in maker.upper() or not model.startswith("LDC50"):
            raise Refused(None, f"{maker!r} {model!r} is no LDC500 series controller")
        return Identity("SRS", model, number.removeprefix("s/n"), firmware.removeprefix("ver"))

    @asked_again
    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Output off, current mode at 0 A, TILM, TMIN, TMAX; each read back. There is no dead man to be set."""
        low_degC, high_degC = temperature_limits_degC
        if not 0.0 < current_limit_A <= LARGEST_CURRENT_A:
            raise ValueError(
                f"current limit {current_limit_A} A: more than 0 and at most {LARGEST_CURRENT_A} is expected"
            )
        if not (isfinite(low_degC) and isfinite(high_degC) and low_degC < high_degC):
            raise ValueError(f"temperature limits {low_degC}, {high_degC} degC: two rising numbers are expected")
        self._armed_mode = None
        self._set("TEON", 0)
        self._set("TMOD", CURRENT_MODE)
        self._set("TCUR", 0.0)
        self._set("TILM", current_limit_A, RESOLUTION_A)
        self._set("TMIN", low_degC, RESOLUTION_K)
        self._set("TMAX", high_degC, RESOLUTION_K)
        for name, gain in self._own_gains.items():
            if gain is not None:
                self._set(name, gain, 1e-3 * max(abs(gain), 1.0))
        self.current_limit_A = current_limit_A
        self.temperature_limits_degC = (low_degC, high_degC)

    def own_limits(self) -> OwnLimits:
        """TILM, TMIN and TMAX, each asked for twice."""
        return OwnLimits(*(self._read_twice(name) for name in ("TILM", "TMIN", "TMAX")))

    def set_ramp_K_per_s(self, ramp_K_per_s: float) -> None:
        """Refused: it has no ramp of its own."""
        raise Refused(None, "this controller has no ramp of its own")

    def arm_current(self) -> None:
        """Current mode (TMOD CC) at 0 A, output on."""
        self._require_configured()
        self._armed_mode = None
        self._set("TMOD", CURRENT_MODE)
        self._set("TCUR", 0.0)
        self._enable(CURRENT_MODE)

    def set_current_A(self, current_A: float) -> None:
        """TCUR, read back. ValueError outside the configured limit: nothing is sent."""
        if not abs(current_A) <= self.current_limit_A:
            raise ValueError(f"{current_A} A is outside the configured +-{self.current_limit_A} A")
        self._require_step()
        if self._armed_mode != CURRENT_MODE:
            raise Refused(None, "the output is not armed for currents")
        self._set_fast("TCUR", self._heating_sign * current_A, RESOLUTION_A)

    def arm_setpoint(self) -> None:
        """The instrument's own regulation (TMOD CT), held at the temperature of now; output on."""
        self._require_configured()
        self._armed_mode = None
        now = self.read_temperature()
        low_degC, high_degC = self.temperature_limits_degC
        if not (now.is_number and low_degC <= now.value <= high_degC):
            raise Refused(None, f"temperature {now.value} degC is not within {low_degC} to {high_degC} degC")
        self._set("TMOD", TEMPERATURE_MODE)
        self._set("TEMP", now.value, RESOLUTION_K)
        self._enable(TEMPERATURE_MODE)

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """TEMP, read back. ValueError outside the configured limits: nothing is sent."""
        low_degC, high_degC = self.temperature_limits_degC
        if not low_degC <= setpoint_degC <= high_degC:
            raise ValueError(f"{setpoint_degC} degC is outside the configured {low_degC} to {high_degC} degC")
        self._require_step()
        if self._armed_mode != TEMPERATURE_MODE:
            raise Refused(None, "the output is not armed for setpoints")
        self._set_fast("TEMP", setpoint_degC, RESOLUTION_K)

    def read_temperature(self) -> Reading:
        """Temperature (TTRD), degC; `time_s` is when the question had arrived."""
        value_degC = self._read_twice("TTRD")
        quality = Quality.OK if -273.15 <= value_degC <= 1000.0 else Quality.INVALID
        return Reading(value_degC, self.link.arrived_s, quality)

    def read_current(self) -> Reading:
        """Current that flows (TIRD), A, positive heats by `heating_sign`."""
        value_A = self._heating_sign * self._read_twice("TIRD")
        return Reading(value_A, self.link.arrived_s, Quality.OK if isfinite(value_A) else Quality.INVALID)

    def status(self) -> Status:
        """Output and mode (TEON, TMOD), and errors since they were last asked for (LEXE, LCME)."""
        on_text, mode_text, execution, command = self.link.answers("TEON?;TMOD?;LEXE?;LCME?", 4)
        on, mode = _number(on_text), _number(mode_text)
        if not all(text.isascii() and text.strip().isdigit() for text in (execution, command)):
            self.link.doubt()
            raise Corrupt(f"{execution!r} and {command!r} are no error numbers")
        codes = [code for code in (int(execution), int(command)) if code]
        words = f"{'on' if on else 'off'}, {'own regulation' if mode == TEMPERATURE_MODE else 'current'}"
        if not codes:
            return Status(words, False, on == 1)
        meaning = COMMAND_ERRORS.get(int(command), "command error") if int(command) else "execution error"
        remedy = "it was forgotten as it was read; where it comes again, another program speaks on the line"
        return Status(f"{words}, error {codes[0]}: {meaning}", True, on == 1, codes[0], meaning, remedy)

    def clear_error(self) -> None:
        """It forgets an error when it is read (LEXE, LCME). Refused where there is a new one."""
        self.status()
        status = self.status()
        if status.is_error:
            raise Refused(status.code, f"reading it did not clear it: {status.meaning}")

    def off(self) -> bool:
        """TEON 0; then TEON 0 and 0 A (TMOD CC, TCUR 0). True if TEON and the current that flows say so. Never raises.

        The manual knows no emergency stop.
        """
        self._armed_mode = None
        ways = ((self._plainly_off, STATUS_S), (self._off_and_zero, OFF_S))
        return confirmed_off(self.transport, ways, self.link.doubt)

    def _plainly_off(self) -> bool:
        if self.link.in_doubt:
            with contextlib.suppress(InstrumentError):
                self.link.shout("TEON 0")
        return self._reads_off()

    def _off_and_zero(self) -> bool:
        with contextlib.suppress(InstrumentError):
            self.link.shout("TEON 0;TMOD 0;TCUR 0")
            self.link.shout("TERM 3")  # it may have been set to end its answers otherwise
        return self._reads_off()

    def _reads_off(self) -> bool:
        self.link.start("TEON 0;TEON?;TEON?;TIRD?", OFF_ANSWER_S, trials=1)
        on, again, current_A = self.link.finish().split(";")
        return on == again and _number(on) == 0.0 and abs(_number(current_A)) <= NO_OUTPUT_A

    def close(self) -> None:
        """Let go of the port; the output stays as it is."""
        self.transport.close()

    def _enable(self, mode: int) -> None:
        self._set("TEON", 1)
        found: list[Status] = []

        def runs() -> bool:
            found[:] = [self.status()]
            return found[0].output_is_on

        waited_for(self.transport.clock, runs, STARTED_S)
        status = found[0]
        if not status.output_is_on:
            raise Refused(status.code or None, f"the output does not come on: {status.text}")
        self._armed_mode = mode

    def _require_step(self) -> None:
        """In step, so that it is known whether the output is still armed."""
        if self.link.in_doubt:
            self.link.resynchronise()

    def _require_configured(self) -> None:
        if not isfinite(self.current_limit_A):
            raise Refused(None, "limits are not configured yet")

    def _set(self, name: str, value: float, resolution: float = 0.0) -> None:
        """Set, read back, and ask for errors."""
        self._set_fast(name, value, resolution)
        self.link.check(f"{name} {value:g}")

    def _set_fast(self, name: str, value: float, resolution: float = 0.0) -> None:
        """Set and read back in one line. What reads back right was taken; otherwise errors are asked for."""
        text = f"{value:.4f}" if resolution else f"{value:g}"
        (read_back,) = self.link.answers(f"{name} {text};{name}?", 1)
        if not abs(_number(read_back) - value) <= resolution:
            self.link.check(f"{name} {text}")
            raise Refused(None, f"{name} was set to {text} and reads {read_back}")

    def _read_twice(self, name: str) -> float:
        """A number that the instrument says twice in one line, the token between. Corrupt where they differ, again and
        again: a stale pair before the token of a question that did not arrive whole is none."""
        for _ in range(TRIALS):
            first, token, second = self.link.answers(f"{name}?;*ESE?;{name}?", 3)
            if first == second and self.link.is_token(token):
                return _number(first)
        self.link.doubt()
        raise Corrupt(f"{first!r}, {token!r}, {second!r} are not twice the same {name} about a token")

    def _look_after_doubt(self) -> None:
        """A controller that was switched off in between comes back with its output off: it is no longer armed."""
        if self._armed_mode is not None:
            mode, self._armed_mode = self._armed_mode, None
            on, now = (_number(text) for text in self.link.answers("TEON?;TMOD?", 2))
            if on == 1 and now == mode:
                self._armed_mode = mode


def _number(text: str) -> float:
    """A number, or a token's word as a number; nan where it is neither."""
    text = text.strip()
    if text in WORDS:
        return float(WORDS[text])
    return float(text) if NUMBER.fullmatch(text) else nan

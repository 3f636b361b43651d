"""Julabo circulator bath with the FP50's command set, on RS-232."""

from math import isfinite, nan
from typing import ClassVar

from rig.core.errors import Corrupt, OutOfStep, Refused, TimedOut
from rig.core.reading import Identity, Quality, Reading
from rig.drivers.controller import OFF_S, OwnLimits, Status, TemperatureController, confirmed_off
from rig.ports.open import LineSettings
from rig.ports.transport import Transport

ANSWER_S = 0.5
RESOLUTION_K = 0.01


class JulaboBath(TemperatureController):
    """A bath. line: settings of its port; drain_s: how long a line in doubt has to be silent."""

    LINE: ClassVar[LineSettings] = LineSettings(baudrate=4800, bytesize=7, parity="E")
    NAME = "a Julabo bath"

    def __init__(self, transport: Transport, *, line: LineSettings = LINE, drain_s: float = 0.5) -> None:
        self.transport = transport
        self._byte_s, self._drain_s = line.byte_s, drain_s
        self._version = ""
        self._in_doubt = True
        self._limits_degC = (nan, nan)

    # ---- the line -------------------------------------------------------------------------------

    def _line(self) -> str:
        """Return the next answer; some baths answer a setting with an empty line."""
        clock = self.transport.clock
        deadline_s = clock.now_s() + ANSWER_S + 60 * self._byte_s
        while True:
            text = self.transport.receive_line(b"\r\n", deadline_s).decode("latin-1").strip()
            if text:
                return text

    def _settle(self) -> None:
        """Listen until the line is silent; then the fence must come back."""
        clock = self.transport.clock
        for _ in range(10):
            clock.sleep_until_s(clock.now_s() + self._drain_s)
            if not self.transport.drain():
                break
        self.transport.send(b"VERSION\r")
        version = self._line()
        if self._version and version != self._version:
            raise OutOfStep(f"{version!r} answers where {self._version!r} did")
        self._version = version

    def _ask(self, question: str) -> str:
        """Return an answer, proven by the fence behind it."""
        if self._in_doubt:
            self._settle()
        self._in_doubt = True
        self.transport.send(question.encode("ascii") + b"\r")
        answer = self._line()
        self.transport.send(b"VERSION\r")
        fence = self._line()
        if fence != self._version:
            raise OutOfStep(f"{fence!r} came back where {self._version!r} was expected")
        self._in_doubt = False
        return answer

    def _number(self, question: str) -> float:
        """Return a number that the bath gives twice alike: nothing else protects it."""
        first, second = self._ask(question), self._ask(question)
        try:
            if abs(float(first) - float(second)) <= 0.1:
                return float(second)
        except ValueError:
            pass
        self._in_doubt = True
        raise Corrupt(f"{first!r} and {second!r} are not twice the same number")

    def _set(self, write: str, read: str, value: float) -> None:
        self.transport.send(f"OUT_{write} {value:g}\r".encode("ascii"))
        if abs(self._number(f"IN_{read}") - value) > RESOLUTION_K:
            raise Refused(None, f"{write} was set to {value:g} and reads otherwise")

    # ---- what the rig asks for ------------------------------------------------------------------

    def identify(self) -> Identity:
        """Return its version, which is the fence as well; Refused if it is no Julabo."""
        self._version, self._in_doubt = "", True
        self._ask("STATUS")
        if "JULABO" not in self._version.upper():
            raise Refused(None, f"{self._version!r} is no Julabo bath")
        return Identity("Julabo", self._version, "", "")

    def configure(
        self, current_limit_A: float, temperature_limits_degC: tuple[float, float], dead_man_s: float
    ) -> None:
        """Switch off; its own limits are set at its front panel, and `own_limits` reads them."""
        if not self.off():
            raise TimedOut("the bath does not switch off")
        self._limits_degC = temperature_limits_degC

    def own_limits(self) -> OwnLimits:
        """Return its low and high limit, degC."""
        return OwnLimits(low_degC=self._number("IN_SP_02"), high_degC=self._number("IN_SP_01"))

    def arm_setpoint(self) -> None:
        """Circulate and regulate at the present temperature."""
        now = self.read_temperature()
        self._set("SP_00", "SP_00", round(now.number(), 2))
        self._set("MODE_05", "MODE_05", 1)

    def set_setpoint_degC(self, setpoint_degC: float) -> None:
        """Set a temperature within the configured limits."""
        low_degC, high_degC = self._limits_degC
        if not (isfinite(setpoint_degC) and low_degC <= setpoint_degC <= high_degC):
            raise ValueError(f"{setpoint_degC} degC is outside the configured {low_degC} to {high_degC} degC")
        self._set("SP_00", "SP_00", round(setpoint_degC, 2))

    def read_temperature(self) -> Reading:
        """Read the bath, degC."""
        value_degC = self._number("IN_PV_00")
        return Reading(value_degC, self.transport.clock.now_s(), Quality.OK)

    def status(self) -> Status:
        """Return its status; some baths report an error as a negative number."""
        text = self._ask("STATUS")
        return Status(text, text.startswith("-"), self._number("IN_MODE_05") == 1.0)

    def off(self) -> bool:
        """Switch off at once, and read back."""
        return confirmed_off(self.transport, ((self._off_once, OFF_S),), self._doubt)

    def _off_once(self) -> bool:
        self._set("MODE_05", "MODE_05", 0)
        return True

    def _doubt(self) -> None:
        self._in_doubt = True

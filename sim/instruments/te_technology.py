"""TE Technology temperature controllers TC-36-25 RS232 and TC-48-20.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50; TC-48-20 manual, Appendix B p. 48 to 54.

    TC-36-25   request  *  address(2)  code(2)  data(8)  sum(2)  CR       reply  *  data(8)  sum(2)  ^
               short    *  address(2)  code(2)           sum(2)  CR       (reads only)
    TC-48-20   request  *              code(2)  data(4)  sum(2)  CR       reply  *  data(4)  sum(2)  ^
               read     *              code(2)           sum(2)  CR

All numbers are lower-case hexadecimal, data in two's complement. The sum is the low 8 bits of the sum of the characters
between `*` and itself. Nothing in a reply says which request it answers.

A request takes effect when its last character has arrived; its reply reaches the host after the response time and its
own length on the wire. Not specified by the maker, and assumed here:

* commands that begin before the reply to the one before has been sent, and `deaf_s` beyond, are lost (the manual warns
  of sending too fast); a request without `*`, or for another address, is answered with silence; an unknown code and a
  wrong length are answered like a wrong sum;
* a value outside its limits is acknowledged, as every write is, and not kept;
* alarms are judged in the control loop; with `shutdown if alarm` they take the output away, for good if they latch;
* an open sensor reads as the largest positive number;
* it regulates by PID, whatever type of control is set.

Not verified: the code that reads the TC-48-20's output enable back (here 64). Limits that the manuals leave open are
wide; defaults are this emulator's, not the factory's.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isnan
from typing import ClassVar

from sim.instruments.instrument import Instrument, Plant, Regulator, Ticking

FULL_POWER = 511  # of the power's scale, 100 %
HIGH, LOW, OPEN_1, OPEN_2 = 1, 2, 16, 32  # bits of the alarms
MODEL_CODE = 9613  # a TC-48-20's answer to code 00
PER_GAIN = 100  # fixed point of the gains
RESPONSE_S = 0.005  # from a request's last character to the first of its reply
HEXADECIMAL = frozenset(b"0123456789abcdef")
WIDE = 2**31 - 1  # the largest that eight hexadecimal digits hold, with a sign
SHORT = 2**15 - 1  # the same of four digits


@dataclass(frozen=True, slots=True)
class Setting:
    """A value by name: codes to write and read it (empty: none), its default and limits as they go over the wire."""

    name: str
    write: bytes
    read: bytes
    default: int
    minimum: int = -WIDE
    maximum: int = WIDE


@dataclass(frozen=True, slots=True)
class Model:
    """A controller: digits of its data, whether a request has an address, fixed point of a temperature, settings, and
    the codes that read what is measured."""

    digits: int
    has_address: bool
    baudrate: int
    per_degC: int
    settings: tuple[Setting, ...]
    measured: dict[bytes, str]


MODELS = {
    "tc-36-25": Model(
        8,
        True,
        9600,
        100,
        (
            Setting("setpoint", b"1c", b"50", 2500),
            Setting("bandwidth", b"1d", b"51", 1000, 1),
            Setting("integral", b"1e", b"52", 100, 0),
            Setting("derivative", b"1f", b"53", 0, 0),
            Setting("high alarm", b"23", b"57", 12500),
            Setting("low alarm", b"24", b"58", -2000),
            Setting("control deadband", b"25", b"59", 100, 0),
            Setting("alarm type", b"28", b"41", 0, 0, 3),
            Setting("setpoint source", b"29", b"42", 0, 0, 4),
            Setting("sensor type", b"2a", b"43", 1, 0, 5),
            Setting("control type", b"2b", b"44", 1, 0, 2),
            Setting("power on", b"2d", b"46", 0, 0, 1),
            Setting("shutdown if alarm", b"2e", b"47", 0, 0, 1),
            Setting("alarm latch", b"2f", b"48", 0, 0, 1),
            Setting("units", b"32", b"4b", 1, 0, 1),
            Setting("reset latches", b"33", b"", 0, 0, 1),
            Setting("EEPROM", b"34", b"4c", 1, 0, 1),
        ),
        {b"01": "input 1", b"06": "input 2", b"05": "alarms"},
    ),
    "tc-48-20": Model(
        4,
        False,
        115200,
        10,
        (
            Setting("setpoint", b"1c", b"50", 250, -SHORT - 1, SHORT),
            Setting("bandwidth", b"1d", b"51", 100, 1, SHORT),
            Setting("integral", b"1e", b"52", 100, 0, SHORT),
            Setting("derivative", b"1f", b"53", 0, 0, SHORT),
            Setting("power on", b"30", b"64", 0, 0, 1),
        ),
        {b"00": "model", b"01": "input 1", b"03": "alarms", b"04": "input 2"},
    ),
}


class TeTechnology(Instrument, Ticking):
    """One controller. model: "tc-36-25" or "tc-48-20".

    full_power_A: current at 100 % (supply voltage over the element's resistance). heating_sign: +1 if positive power
    heats as it is wired. baudrate: of the line, 1/s; None: the model's own; inf takes no time.
    """

    ENDS: ClassVar[tuple[bytes, ...]] = (b"\r", b"^")  # the manual's alarm examples end with `^`
    LONGEST_PARTIAL: ClassVar[int] = 64

    def __init__(
        self,
        plant: Plant,
        *,
        model: str = "tc-36-25",
        address: int = 0,
        baudrate: float | None = None,
        deaf_s: float = 0.0,
        full_power_A: float = 4.0,
        heating_sign: int = 1,
        start_s: float = 0.0,
    ) -> None:
        self._model = table = MODELS[model]
        super().__init__(plant, byte_s=10.0 / (table.baudrate if baudrate is None else baudrate), start_s=start_s)
        self.values = {setting.name: setting.default for setting in table.settings}
        self._writes = {setting.write: setting for setting in table.settings}
        self._reads: dict[bytes, Callable[[], int]] = {}
        for setting in table.settings:
            if setting.read:
                self._reads[setting.read] = lambda name=setting.name: self.values[name]  # type: ignore[misc]
        measured: dict[str, Callable[[], int]] = {
            "input 1": lambda: self._fixed(plant.read_temperature_degC()),
            "input 2": lambda: self._fixed(plant.sink_temperature_degC()),
            "alarms": lambda: self.alarms,
            "model": lambda: MODEL_CODE,
        }
        self._reads |= {code: measured[name] for code, name in table.measured.items()}
        self._own_address = b"%02x" % address
        self._deaf_s, self._full_power_A, self._heating_sign = deaf_s, full_power_A, heating_sign
        self._requests: deque[tuple[bytes, float]] = deque()
        self._busy_until_s = -inf
        self.power = 0  # -511 to 511
        self.alarms = 0
        self.eeprom_writes = 0
        self.lost_commands = 0
        self._tripped = False
        self._regulator = Regulator()
        self._start_ticking(start_s)

    # ---- the line -------------------------------------------------------------------------------

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        start = line.rfind(b"*")
        if start < 0:
            return
        if arrival_s - (len(line) + 1) * self._byte_s < self._busy_until_s + self._deaf_s - 1e-9:
            self.lost_commands += 1
            return
        self._busy_until_s = arrival_s + RESPONSE_S + (self._model.digits + 4) * self._byte_s
        self._requests.append((line[start + 1 :], self._busy_until_s))
        self._plant.schedule(arrival_s, self._act)

    def _next_reply_s(self) -> float | None:
        return self._requests[0][1] if self._requests else None

    def _act(self, time_s: float) -> None:
        line, due_s = self._requests.popleft()
        data = self._answer(line)
        if data is not None:
            self._replies.append((due_s, b"*%b%02x^" % (data, sum(data) & 0xFF)))

    # ---- commands -------------------------------------------------------------------------------

    def _answer(self, line: bytes) -> bytes | None:
        """Return the data of the reply; None for a request to another address."""
        digits, has_address = self._model.digits, self._model.has_address
        head, body = 4 if has_address else 2, line[:-2]
        wrong = b"X" * digits  # the reply's data if the sum is wrong
        if len(body) not in (head, head + digits) or not HEXADECIMAL.issuperset(line):
            return wrong
        if b"%02x" % (sum(body) & 0xFF) != line[-2:]:
            return wrong
        if has_address and body[:2] not in (b"00", self._own_address):
            return None
        code, data = body[head - 2 : head], body[head:]
        if code in self._reads:
            return b"%0*x" % (digits, self._reads[code]() & (16**digits - 1))
        if not data or code not in self._writes:
            return wrong
        value = int(data, 16)
        self._write(code, value - 16**digits if value >= 16**digits // 2 else value)
        return data

    def _write(self, code: bytes, value: int) -> None:
        setting = self._writes[code]
        if not setting.minimum <= value <= setting.maximum:
            return
        self.eeprom_writes += self.values.get("EEPROM", 1)
        self.values[setting.name] = value
        if setting.name == "reset latches":
            self._tripped = False
        if setting.name in ("power on", "reset latches"):
            self._regulator.start()
            self._drive(0.0)

    def _fixed(self, temperature_degC: float) -> int:
        if isnan(temperature_degC):
            return int(16**self._model.digits // 2) - 1
        if self.values.get("units", 1) == 0:
            temperature_degC = temperature_degC * 1.8 + 32.0
        return round(temperature_degC * self._model.per_degC)

    def _degC(self, fixed: int) -> float:
        value = fixed / self._model.per_degC
        return value if self.values.get("units", 1) else (value - 32.0) / 1.8

    # ---- output ---------------------------------------------------------------------------------

    def _drive(self, percent: float) -> None:
        """Drive at this power, %, from now on, as far as the output may be on."""
        may = self.values["power on"] == 1 and not self._tripped and not self.alarms & OPEN_1
        self.power = round(percent / 100.0 * FULL_POWER) if may else 0
        current_A = self._heating_sign * self.power / FULL_POWER * self._full_power_A
        if current_A != self._plant.current_A:
            self._plant.set_current_A(current_A)

    def _control(self) -> None:
        temperature_degC = self._plant.read_temperature_degC()
        self._judge(temperature_degC)
        values, percent = self.values, 0.0
        if values["power on"] == 1 and not isnan(temperature_degC):
            integral_per_s = values["integral"] / PER_GAIN / 60.0
            percent = self._regulator.step(
                self._degC(values["setpoint"]),
                temperature_degC,
                gain_percent_per_K=100.0 * self._model.per_degC / values["bandwidth"],
                integral_time_s=1.0 / integral_per_s if integral_per_s else 0.0,
                derivative_time_s=values["derivative"] / PER_GAIN * 60.0,
            )
        self._drive(percent)

    def _judge(self, temperature_degC: float) -> None:
        """Set the alarm bits; what latches stays until the latches are reset."""
        values = self.values
        alarms = OPEN_1 if isnan(temperature_degC) else 0
        alarms |= OPEN_2 if isnan(self._plant.sink_temperature_degC()) else 0
        if values.get("alarm type", 0) == 2 and not isnan(temperature_degC):
            alarms |= HIGH if temperature_degC > self._degC(values["high alarm"]) else 0
            alarms |= LOW if temperature_degC < self._degC(values["low alarm"]) else 0
        self.alarms = alarms
        stops = bool(values.get("shutdown if alarm", 0) and alarms & ~OPEN_2)
        self._tripped = stops or bool(self._tripped and values.get("alarm latch", 0))

"""TE Technology temperature controller, byte by byte: bytes and times in, bytes and times out.

Sources: TC-36-25 RS232 manual, Appendix C p. 42 to 50; TC-48-20 manual, Appendix B p. 48 to 54.

A request takes effect when its last character has arrived; its reply reaches the host after the response time and its
own length on the wire. Not specified by the maker, and assumed here:

* commands that begin before the reply to the one before has been sent, and `deaf_s` beyond, are lost (the manual warns
  of sending too fast); a request without `*`, or for another address, is met with silence; an unknown code and a wrong
  length are met like a wrong sum;
* a value outside its limits is acknowledged, as every write is, and not kept;
* alarms are judged on the own 10 Hz tick; with `shutdown if alarm` they take the output away, for good if they latch;
* an open sensor reads as the largest positive number.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from math import inf, isnan

from sim.instruments.instrument import Plant
from sim.instruments.regulator import Regulator
from sim.instruments.serial_line import SerialLine
from sim.instruments.te_codes import MODELS

TICK_S = 0.1  # of its control loop and its alarms (assumed, see above)
FULL_POWER = 511  # of the power's scale, 100 %
DEADBAND, PID, COMPUTER = 0, 1, 2
HIGH, LOW, OPEN_1, OPEN_2 = 1, 2, 16, 32  # bits of the alarms
MODEL_CODE = 9613  # what a TC-48-20 answers to code 00
AMPS_PER_COUNT = 2.5  # of the current count, by the manual


class TeTechnology(SerialLine):
    """One controller. model: "tc-36-25" or "tc-48-20".

    full_power_A: current at 100 % (supply voltage over the element's resistance). heating_sign: +1 if positive power
    heats as it is wired. baudrate: of the line, 1/s, the model's own where it is None; inf takes no time.
    """

    def __init__(
        self,
        plant: Plant,
        *,
        model: str = "tc-36-25",
        address: int = 0,
        baudrate: float | None = None,
        response_s: float = 0.005,
        deaf_s: float = 0.0,
        full_power_A: float = 4.0,
        heating_sign: int = 1,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant)
        self._model = table = MODELS[model]
        self.values = {setting.name: setting.default for setting in table.settings}
        self._writes = {setting.write: setting for setting in table.settings}
        self._reads: dict[bytes, Callable[[], int]] = {}
        for setting in table.settings:
            if setting.read:
                self._reads[setting.read] = lambda name=setting.name: self.values[name]  # type: ignore[misc]
        measured: dict[str, Callable[[], int]] = {
            "input 1": lambda: self._fixed(plant.read_temperature_degC()),
            "input 2": lambda: self._fixed(plant.sink_temperature_degC()),
            "power": lambda: self.power,
            "effective setpoint": lambda: self.values["setpoint"],
            "alarms": lambda: self.alarms,
            "current count": lambda: round(abs(self.power) / FULL_POWER * full_power_A / AMPS_PER_COUNT),
            "model": lambda: MODEL_CODE,
        }
        self._reads |= {code: measured[name] for code, name in table.measured.items()}
        self._own_address = b"%02x" % address
        self._byte_s = 10.0 / (table.baudrate if baudrate is None else baudrate)
        self._response_s, self._deaf_s = response_s, deaf_s
        self._full_power_A, self._heating_sign = full_power_A, heating_sign
        # the line
        self._requests: deque[tuple[bytes, float]] = deque()
        self._receiving_until_s = start_s
        self._busy_until_s = -inf
        # the device
        self.power = 0  # -511 to 511
        self.alarms = 0
        self.eeprom_writes = 0
        self.lost_commands = 0
        self._tripped = False
        self._regulator = Regulator()
        self._ticks, self._start_s = 0, start_s
        plant.schedule(start_s + TICK_S, self._tick)

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. A request ends with CR; the manual's alarm examples end with `^`."""
        begin_s = max(time_s, self._receiving_until_s)
        self._receiving_until_s = begin_s + len(data) * self._byte_s
        lines = (self._partial + data).replace(b"^", b"\r").split(b"\r")
        already = len(self._partial)
        self._partial = lines.pop()[-64:]
        length = self._model.framing.digits + 4
        for line in lines:
            arrival_s = begin_s + (len(line) + 1 - already) * self._byte_s
            first_s = arrival_s - (len(line) + 1) * self._byte_s
            begin_s, already = arrival_s, 0
            start = line.rfind(b"*")
            if start < 0:
                continue
            if first_s < self._busy_until_s + self._deaf_s - 1e-9:
                self.lost_commands += 1
                continue
            due_s = arrival_s + self._response_s + length * self._byte_s
            self._busy_until_s = due_s
            self._requests.append((line[start + 1 :], due_s))
            self._plant.schedule(arrival_s, self._act)

    def _next_reply_s(self) -> float | None:
        return self._requests[0][1] if self._requests else None

    # ---- commands -------------------------------------------------------------------------------

    def _act(self, time_s: float) -> None:
        line, due_s = self._requests.popleft()
        framing = self._model.framing
        request = framing.request(line)
        reply = framing.bad_sum()
        if request is not None:
            address, code, value = request
            if address not in (b"00", self._own_address):
                return
            read = self._reads.get(code)
            if read is not None:
                reply = framing.reply(read())
            elif value is not None and code in self._writes:
                self._write(code, value)
                reply = framing.reply(value)
        self._replies.append((due_s, reply))

    def _write(self, code: bytes, value: int) -> None:
        setting = self._writes[code]
        if not setting.minimum <= value <= setting.maximum:
            return
        self.eeprom_writes += self.values.get("EEPROM", 1)
        self.values[setting.name] = value
        if setting.name == "reset latches":
            self._tripped = False
        if setting.name in ("power on", "control type", "reset latches") or self._control_type == COMPUTER:
            self._regulator.start()
            self._drive(0.0)

    def _fixed(self, temperature_degC: float) -> int:
        if isnan(temperature_degC):
            return int(16**self._model.framing.digits // 2) - 1
        if self.values.get("units", 1) == 0:
            temperature_degC = temperature_degC * 1.8 + 32.0
        return round(temperature_degC * self._model.per_degC)

    def _degC(self, fixed: int) -> float:
        value = fixed / self._model.per_degC
        return value if self.values.get("units", 1) else (value - 32.0) / 1.8

    # ---- output ---------------------------------------------------------------------------------

    @property
    def _control_type(self) -> int:
        return self.values.get("control type", PID)

    def _drive(self, percent: float) -> None:
        """Power in % from now on, as far as it may be on."""
        if self._control_type == COMPUTER:
            percent = min(FULL_POWER, max(-FULL_POWER, self.values["setpoint"])) / FULL_POWER * 100.0
        multiplier = self.values.get("heat multiplier" if percent > 0.0 else "cool multiplier", 100) / 100.0
        percent = min(100.0, max(-100.0, percent * multiplier))
        may = self.values["power on"] == 1 and not self._tripped and not self.alarms & OPEN_1
        self.power = round(percent / 100.0 * FULL_POWER) if may else 0
        current_A = self._heating_sign * self.power / FULL_POWER * self._full_power_A
        if current_A != self._plant.current_A:
            self._plant.set_current_A(current_A)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        temperature_degC = self._plant.read_temperature_degC()
        self._judge(temperature_degC)
        values, percent = self.values, 0.0
        if values["power on"] == 1 and not isnan(temperature_degC) and self._control_type != COMPUTER:
            setpoint_degC = self._degC(values["setpoint"])
            if self._control_type == PID:
                per_gain = self._model.per_gain
                integral_per_s = values["integral"] / per_gain / 60.0
                percent = self._regulator.step(
                    setpoint_degC,
                    temperature_degC,
                    TICK_S,
                    ramp_K_per_s=0.0,
                    gain_percent_per_K=100.0 * self._model.per_degC / values["bandwidth"],
                    integral_time_s=1.0 / integral_per_s if integral_per_s else 0.0,
                    derivative_time_s=values["derivative"] / per_gain * 60.0,
                    damping=0.3,
                )
            else:
                error_K = setpoint_degC - temperature_degC
                percent = 0.0 if abs(error_K) < values["control deadband"] / 200.0 else 100.0 if error_K > 0 else -100.0
        self._drive(percent)

    def _judge(self, temperature_degC: float) -> None:
        """The alarm bits; what latches stays until the latches are reset."""
        values = self.values
        alarms = OPEN_1 if isnan(temperature_degC) else 0
        alarms |= OPEN_2 if isnan(self._plant.sink_temperature_degC()) else 0
        if values.get("alarm type", 0) == 2 and not isnan(temperature_degC):
            alarms |= HIGH if temperature_degC > self._degC(values["high alarm"]) else 0
            alarms |= LOW if temperature_degC < self._degC(values["low alarm"]) else 0
        self.alarms = alarms
        stops = bool(values.get("shutdown if alarm", 0) and alarms & ~OPEN_2)
        self._tripped = stops or bool(self._tripped and values.get("alarm latch", 0))

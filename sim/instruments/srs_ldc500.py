"""SRS LDC501, the temperature controller in it, byte by byte: bytes and times in, bytes and times out.

Sources: LDC500 series manual, remote chapter p. 4-10 (lines, 64-byte input buffer, TERM), 4-16, 4-37, 4-38, 4-47, 4-54;
behaviour seen on hardware from PyMeasure's tests of it. The laser half is not emulated.

A line acts when its terminator (CR or LF) has arrived; its answers reach the host after the response time and their own
length, each with the terminator that TERM has chosen. Not verified, and assumed here: the factory's TERM (CR and LF)
and TOKN (numbers); that the answers of one line come one by one (`joined` gives one line with `;` instead), as in other
instruments of this maker; `*ESE`; the numbers of execution errors; the text of a number (6 digits); TIGN and TDGN
(1/s, s); that an open sensor turns the output off; that one line's questions see one conversion of the sensor.

A limit that is lowered drags the current setpoint along; changing the mode is bumpless; a setpoint outside TMIN and
TMAX is rejected. A negative TPGN regulates, a positive one runs away.
"""

from __future__ import annotations

from collections import deque
from math import copysign, isnan, nan

from sim.instruments.instrument import Plant
from sim.instruments.regulator import Regulator
from sim.instruments.serial_line import SerialLine
from sim.instruments.srs_commands import BUFFER_OVERFLOW, CommandError, ExecutionError, answers, default_values

TICK_S = 0.1  # of its control loop (not specified, see above)
LONGEST_INPUT, LONGEST_OUTPUT = 64, 256  # bytes of its buffers
TERMINATORS = (b"", b"\r", b"\n", b"\r\n", b"\n\r")
INPUT_ERROR, QUERY_ERROR, EXECUTION_ERROR, COMMAND_ERROR = 2, 4, 16, 32  # bits of the event status register
CURRENT_MODE, TEMPERATURE_MODE = 0, 1


class SrsLdc500(SerialLine):
    """One controller.

    baudrate: of the line, 1/s; inf takes no time. response_s: from a line's end to its first answer. error_s: until an
    error can be asked for. heating_sign: +1 if positive current heats as it is wired. load_ohm: of the element.
    """

    identity: str
    output_A: float

    def __init__(
        self,
        plant: Plant,
        *,
        serial_number: str = "s/n098023",
        firmware: str = "ver2.00",
        baudrate: float = 9600.0,
        response_s: float = 0.003,
        error_s: float = 0.01,
        joined: bool = False,
        heating_sign: int = 1,
        load_ohm: float = 2.0,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant)
        self.identity = f"Stanford Research Systems,LDC501,{serial_number},{firmware}"
        self.values: dict[str, float] = default_values()
        self._byte_s = 10.0 / baudrate
        self._response_s, self._error_s, self._joined = response_s, error_s, joined
        self._heating_sign, self._load_ohm = heating_sign, load_ohm
        # the line
        self._lines: deque[tuple[bytes, float]] = deque()
        self._receiving_until_s = self._sending_until_s = start_s
        # the device
        self._now_s = start_s
        self._command_error, self._execution_error = (0, start_s), (0, start_s)
        self.event_status = 0
        self._regulator = Regulator()
        self.output_A = 0.0
        self._conversion_s, self._conversion_degC = nan, nan
        self._ticks, self._start_s = 0, start_s
        plant.schedule(start_s + TICK_S, self._tick)

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. More than 64 bytes that wait discard all of them."""
        begin_s = max(time_s, self._receiving_until_s)
        self._receiving_until_s = begin_s + len(data) * self._byte_s
        *lines, rest = (self._partial + data).replace(b"\n", b"\r").split(b"\r")
        already = len(self._partial)
        for line in lines:
            arrival_s = begin_s + (len(line) + 1 - already) * self._byte_s
            begin_s, already = arrival_s, 0
            if len(line) + 1 > LONGEST_INPUT:
                self._overflow()
            elif line:
                self._lines.append((line, arrival_s))
                self._plant.schedule(arrival_s, self._act)
        if len(rest) > LONGEST_INPUT:
            self._overflow()
            rest = b""
        self._partial = rest

    def _overflow(self) -> None:
        self.event_status |= INPUT_ERROR
        self._command_error = (BUFFER_OVERFLOW, self._now_s)

    def _next_reply_s(self) -> float | None:
        return self._lines[0][1] + self._response_s if self._lines else None

    def _act(self, time_s: float) -> None:
        line = self._lines.popleft()[0]
        self._now_s = time_s
        texts: list[str] = []
        for unit in line.decode("latin-1").split(";"):
            try:
                texts.extend(answers(self, unit))
            except CommandError as error:
                self._command_error = (error.code, time_s + self._error_s)
                self.event_status |= COMMAND_ERROR
            except ExecutionError as error:
                self._execution_error = (error.code, time_s + self._error_s)
                self.event_status |= EXECUTION_ERROR
        if not texts:
            return
        end = TERMINATORS[int(self.values["TERM"])]
        data = b"".join(text.encode("latin-1") + end for text in ([";".join(texts)] if self._joined else texts))
        if len(data) > LONGEST_OUTPUT:
            self.event_status |= QUERY_ERROR
            return
        due_s = max(time_s + self._response_s, self._sending_until_s) + len(data) * self._byte_s
        self._sending_until_s = due_s
        self._replies.append((due_s, data))

    # ---- errors ---------------------------------------------------------------------------------

    def take_command_error(self) -> int:
        """`LCME?`: the last command error that has been logged by now; it is forgotten."""
        code, logged_s = self._command_error
        if logged_s > self._now_s:
            return 0
        self._command_error = (0, self._now_s)
        return code

    def take_execution_error(self) -> int:
        """`LEXE?`: the last execution error that has been logged by now; it is forgotten."""
        code, logged_s = self._execution_error
        if logged_s > self._now_s:
            return 0
        self._execution_error = (0, self._now_s)
        return code

    # ---- what is measured -----------------------------------------------------------------------

    def temperature_degC(self) -> float:
        """The sensor's temperature; questions of one line see one conversion."""
        if self._conversion_s != self._now_s:
            self._conversion_s, self._conversion_degC = self._now_s, self._plant.read_temperature_degC()
        return self._conversion_degC

    def voltage_V(self) -> float:
        """Over the element."""
        return self.output_A * self._load_ohm

    # ---- output ---------------------------------------------------------------------------------

    def change_mode(self, mode: float) -> None:
        """TMOD: the setpoint of the new mode is what is measured now."""
        if mode == self.values["TMOD"]:
            return
        if mode == CURRENT_MODE:
            self.values["TCUR"] = self.output_A
        else:
            measured_degC = self.temperature_degC()
            if not isnan(measured_degC):
                self.values["TEMP"] = min(self.values["TMAX"], max(self.values["TMIN"], measured_degC))
            self._regulator.start()
        self.values["TMOD"] = mode
        self.drive()

    def change_current_limit(self, limit_A: float) -> None:
        """TILM: the current setpoint is dragged along."""
        self.values["TILM"] = abs(limit_A)
        if abs(self.values["TCUR"]) > abs(limit_A):
            self.values["TCUR"] = copysign(limit_A, self.values["TCUR"])
        self.drive()

    def switch(self, on: float) -> None:
        """TEON."""
        self.values["TEON"] = on
        self._regulator.start()
        self.drive()

    def drive(self) -> None:
        """The current that follows from the settings, from now on."""
        values, current_A = self.values, 0.0
        limit_A = min(values["TILM"], abs(values["TVLM"]) / self._load_ohm)
        if values["TEON"]:
            if values["TMOD"] == CURRENT_MODE:
                current_A = values["TCUR"]
            else:
                regulates = 1.0 if values["TPGN"] < 0.0 else -1.0
                current_A = regulates * self._heating_sign * self._regulator.output_percent / 100.0 * values["TILM"]
        current_A = min(limit_A, max(-limit_A, current_A))
        if current_A != self.output_A:
            self.output_A = current_A
            self._plant.set_current_A(self._heating_sign * current_A)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._now_s = time_s
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        values = self.values
        if not values["TEON"] or values["TMOD"] == CURRENT_MODE:
            return
        temperature_degC = self.temperature_degC()
        if isnan(temperature_degC):
            self.switch(0)
            return
        self._regulator.step(
            values["TEMP"],
            temperature_degC,
            TICK_S,
            ramp_K_per_s=0.0,
            gain_percent_per_K=100.0 * abs(values["TPGN"]) / max(values["TILM"], 1e-3),
            integral_time_s=1.0 / values["TIGN"] if values["TIGN"] > 0.0 else 0.0,
            derivative_time_s=values["TDGN"],
            damping=0.3,
        )
        self.drive()

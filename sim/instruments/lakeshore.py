"""Lake Shore 335 or 336 temperature controller, byte by byte: bytes and times in, bytes and times out.

Source: Model 335 and 336 user's manuals, chapter 6 (interface commands, formats of answers, status system). NOT
verified on an instrument: how long a command takes, the law of the control loop (here the textbook PID with
I in 1000/s, sampled ten times a second), how many decimals TLIMIT keeps.

One output heats the plant, and one sensor is on it; the other sensors show the heat sink. Full power of an output is
that of its "high" range, a tenth and a hundredth are the others'.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import ClassVar

from sim.instruments.instrument import Plant
from sim.instruments.lakeshore_commands import KELVIN, define_commands
from sim.instruments.regulator import Regulator
from sim.instruments.scpi_instrument import ScpiInstrument

TICK_S = 0.1  # of its control loop (not verified, see above)
OFF, CLOSED_LOOP, ZONE, OPEN_LOOP = 0, 1, 2, 3  # of OUTMODE
POWER = {0: 0.0, 1: 0.01, 2: 0.1, 3: 1.0}  # of full power, by range
INPUTS = {"335": "AB", "336": "ABCD"}
KELVIN_UNITS = 1  # of INTYPE
COMMAND_ERROR, EXECUTION_ERROR, POWER_ON = 32, 16, 128  # bits of the event status register
INVALID = 1  # of a reading's status


@dataclass
class Output:
    """One heater output, as its commands set it. setup: HTRSET without the output's number."""

    setup: list[float]
    mode: int = OFF
    input: int = 1
    stays_on: int = 0
    range: int = 0
    manual_percent: float = 0.0
    setpoint: float = 0.0
    gains: tuple[float, float, float] = (50.0, 20.0, 0.0)
    ramps: int = 0
    ramp_K_per_min: float = 0.1
    percent: float = 0.0
    heater_error: int = 0
    regulator: Regulator = field(default_factory=Regulator)


class LakeShore(ScpiInstrument):
    """One controller. model: "335" or "336". full_drive_A: what the plant gets at full power.

    input, output: the sensor and the heater that are on the plate. update_s: how long a reading stays. baudrate: of the
    line, 1/s; inf takes no time.
    """

    ABORTS: ClassVar[tuple[bytes, ...]] = ()
    DROPS_REST: ClassVar[bool] = False  # its maker's package asks for the error in the same line

    def __init__(
        self,
        plant: Plant,
        *,
        model: str = "335",
        serial_number: str = "335A123",
        input: str = "A",
        output: int = 1,
        full_drive_A: float = 1.0,
        update_s: float = TICK_S,
        baudrate: float = 57600.0,
        command_s: float = 0.002,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, byte_s=10.0 / baudrate, terminator=b"\r\n", command_s=command_s, start_s=start_s)
        self.identity = f"LSCI,MODEL{model},{serial_number}/#######,1.5"
        self.inputs = INPUTS[model]
        self._plate_input, self._plate_output, self._full_drive_A = input, output, full_drive_A
        setup = [0.0, 1.0, 0.0, 1.0, 1.0] if model == "335" else [1.0, 0.0, 1.0, 1.0]
        self.outputs = {number: Output(list(setup)) for number in ((1, 2) if model == "335" else (1, 2, 3, 4))}
        self.limits_K = dict.fromkeys(self.inputs, 0.0)
        self._update_s = update_s
        self._readings: dict[str, tuple[float, float]] = {}  # until when, K
        self.input_types = {name: [2, 0, 1, 0, KELVIN_UNITS] for name in self.inputs}
        self.event_enable, self.event_status = 0, POWER_ON
        self._ticks, self._start_s = 0, start_s
        define_commands(self._tree, self)
        plant.schedule(start_s + TICK_S, self._tick)

    # ---- errors ---------------------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        """Into the event status register; there is no queue."""
        unknown = text.startswith("-1")
        self.event_status |= COMMAND_ERROR if unknown else EXECUTION_ERROR

    # ---- sensors --------------------------------------------------------------------------------

    def reading_K(self, name: str) -> float:
        """What an input shows, K, until its next reading; nan where its sensor is open."""
        until_s, shown_K = self._readings.get(name, (-inf, nan))
        if self._now_s >= until_s:
            plant = self._plant
            on_plate = name == self._plate_input
            shown_K = (plant.read_temperature_degC() if on_plate else plant.sink_temperature_degC()) + KELVIN
            self._readings[name] = self._now_s + self._update_s, shown_K
        return shown_K

    def reading_status(self, name: str) -> int:
        """Bits of RDGST."""
        return INVALID if isnan(self.reading_K(name)) else 0

    def setpoint_K(self, output: Output) -> float:
        """An output's setpoint, from the units of its input."""
        kelvin = self.input_types[self.inputs[max(output.input, 1) - 1]][-1] == KELVIN_UNITS
        return output.setpoint if kelvin else output.setpoint + KELVIN

    # ---- outputs --------------------------------------------------------------------------------

    def changed(self, output: Output) -> None:
        """What was set acts at once, but for the control loop, which acts at its next sample."""
        if output.range == 0 or output.mode == OFF:
            output.percent = 0.0
            output.regulator.start()
        elif output.mode == OPEN_LOOP:
            output.percent = output.manual_percent
        self._drive()

    def _drive(self) -> None:
        output = self.outputs[self._plate_output]
        current_A = output.percent / 100.0 * POWER.get(output.range, 1.0) * self._full_drive_A
        if current_A != self._plant.current_A:
            self._plant.set_current_A(current_A)

    def _tick(self, time_s: float) -> None:
        self._ticks += 1
        self._now_s = time_s
        self._plant.schedule(self._start_s + (self._ticks + 1) * TICK_S, self._tick)
        readings_K = {name: self.reading_K(name) for name in self.inputs}
        if any(limit_K and readings_K[name] > limit_K for name, limit_K in self.limits_K.items()):
            for output in self.outputs.values():
                output.range = 0
        for output in self.outputs.values():
            if output.mode == CLOSED_LOOP and output.range and output.input:
                self._regulate(output, readings_K[self.inputs[output.input - 1]])
            else:
                self.changed(output)
        self._drive()

    def _regulate(self, output: Output, reading_K: float) -> None:
        if isnan(reading_K):
            output.percent = 0.0
            return
        gain, integral, derivative = output.gains
        output.percent = output.regulator.step(
            self.setpoint_K(output),
            reading_K,
            TICK_S,
            ramp_K_per_s=output.ramp_K_per_min / 60.0 if output.ramps else 0.0,
            gain_percent_per_K=gain,
            integral_time_s=1000.0 / integral if integral else 0.0,
            derivative_time_s=derivative / 100.0,
            damping=0.3,
            lowest_percent=0.0,
        )

    def reset(self) -> None:
        """`*RST`: outputs off, as after power on; limits stay."""
        for output in self.outputs.values():
            output.mode, output.range, output.manual_percent = OFF, 0, 0.0
            self.changed(output)

"""Lake Shore 335 or 336 temperature controller.

Source: Model 335 and 336 user's manuals, chapter 6 (interface commands, formats of answers, status system), as far as
our driver, QCoDeS and the maker's own package use it. NOT verified on an instrument: how long a command takes, the law
of the control loop (here the textbook PID with I in 1000/s), how many decimals TLIMIT keeps.

One output heats the plant, and one sensor is on it; the other sensors show the heat sink. Full power of an output is
that of its "high" range, a tenth and a hundredth are the others'. There is no error queue: errors set bits of the event
status register.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import ClassVar

from sim.instruments.instrument import TICK_S, Plant, Regulator, Ticking
from sim.instruments.scpi import DATA_OUT_OF_RANGE, MISSING_PARAMETER, Parameters, ScpiError, ScpiInstrument

KELVIN = 273.15  # 0 degC in K
OFF, CLOSED_LOOP, OPEN_LOOP = 0, 1, 3  # of OUTMODE
POWER = {0: 0.0, 1: 0.01, 2: 0.1, 3: 1.0}  # of full power, by range
INPUTS = {"335": "AB", "336": "ABCD"}
KELVIN_UNITS = 1  # of INTYPE
COMMAND_ERROR, EXECUTION_ERROR, POWER_ON = 32, 16, 128  # bits of the event status register
USED_BITS = 0b10110101  # of the event status enable register
INVALID = 1  # of a reading's status
IGNORED = ("EMUL", "MODE", "LOCK", "BRIGT", "LEDS", "DISPLAY", "FILTER", "INCRV", "*CLS", "*SRE", "*OPC")


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


class LakeShore(ScpiInstrument, Ticking):
    """One controller. model: "335" or "336". full_drive_A: current into the plant at full power.

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
        input: str = "A",
        output: int = 1,
        full_drive_A: float = 1.0,
        update_s: float = TICK_S,
        baudrate: float = 57600.0,
        command_s: float = 0.002,
        start_s: float = 0.0,
    ) -> None:
        super().__init__(plant, byte_s=10.0 / baudrate, terminator=b"\r\n", command_s=command_s, start_s=start_s)
        self.identity = f"LSCI,MODEL{model},335A123/#######,1.5"
        self.inputs = INPUTS[model]
        self._plate_input, self._plate_output, self._full_drive_A = input, output, full_drive_A
        setup = [0.0, 1.0, 0.0, 1.0, 1.0] if model == "335" else [1.0, 0.0, 1.0, 1.0]
        self.outputs = {number: Output(list(setup)) for number in ((1, 2) if model == "335" else (1, 2, 3, 4))}
        self.limits_K = dict.fromkeys(self.inputs, 0.0)
        self._update_s = update_s
        self._readings: dict[str, tuple[float, float]] = {}  # until when, K
        self.input_types = {name: [2, 0, 1, 0, KELVIN_UNITS] for name in self.inputs}
        self.event_enable, self.event_status = 0, POWER_ON
        self._define_common()
        self._define_inputs()
        self._define_outputs()
        self._start_ticking(start_s)

    # ---- commands -------------------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        self.event_status |= COMMAND_ERROR if text.startswith("-1") else EXECUTION_ERROR

    def _define_common(self) -> None:
        def enable(parameters: Parameters) -> None:
            self.event_enable = int(_numbers(parameters, (0, 255))[0]) & USED_BITS

        def status(_: Parameters) -> str:
            found, self.event_status = self.event_status, 0
            return f"{found:03d}"

        def reset(_: Parameters) -> None:
            self.reset()

        define = self._tree.define
        define("*IDN", ask=lambda _: self.identity)
        define("*RST", set=reset)
        define("*ESE", set=enable, ask=lambda _: f"{self.event_enable:03d}")
        define("*ESR", ask=status)
        define("*OPC", ask=lambda _: "1")
        define("*TST", ask=lambda _: "0")
        define("*STB", ask=lambda _: "000")
        for word in IGNORED:
            define(word, set=lambda _: None)

    def _input(self, parameters: Parameters) -> str:
        name = parameters[0].strip().upper() if parameters else ""
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        if name not in self.inputs:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        return name

    def _define_inputs(self) -> None:
        def shown(value: float) -> str:
            return "+000.000" if isnan(value) else f"{value:+08.3f}"

        def limit(parameters: Parameters) -> None:
            (self.limits_K[self._input(parameters)],) = _numbers(parameters[1:], (0.0, 9999.0))

        def kind(parameters: Parameters) -> None:
            values = _numbers(parameters[1:], (0, 4), (0, 1), (0, 8), (0, 1), (1, 3))
            self.input_types[self._input(parameters)] = [int(value) for value in values]

        define, named = self._tree.define, self._input
        define("KRDG", ask=lambda p: shown(self.reading_K(named(p))))
        define("CRDG", ask=lambda p: shown(self.reading_K(named(p)) - KELVIN))
        define("SRDG", ask=lambda p: shown(self.reading_K(named(p))))
        define("RDGST", ask=lambda p: f"{INVALID if isnan(self.reading_K(named(p))) else 0:03d}")
        define("TLIMIT", set=limit, ask=lambda p: f"{self.limits_K[named(p)]:+09.3f}")
        define("INTYPE", set=kind, ask=lambda p: ",".join(map(str, self.input_types[named(p)])))
        define("INNAME", ask=lambda p: f"Input {named(p)}       ")

    def _output(self, parameters: Parameters) -> Output:
        if not parameters or not parameters[0].strip().isascii() or not parameters[0].strip().isdigit():
            raise ScpiError(*MISSING_PARAMETER)
        output = self.outputs.get(int(parameters[0]))
        if output is None:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        return output

    def _define_outputs(self) -> None:
        def define(
            word: str, take: Callable[[Output, list[float]], None], text: Callable[[Output], str], *spans: Span
        ) -> None:
            def change(parameters: Parameters) -> None:
                output = self._output(parameters)
                take(output, _numbers(parameters[1:], *spans))
                self.changed(output)

            self._tree.define(word, set=change, ask=lambda p: text(self._output(p)))

        def mode(output: Output, values: list[float]) -> None:
            output.mode, output.input, output.stays_on = (int(value) for value in values)

        def gains(output: Output, values: list[float]) -> None:
            output.gains = (values[0], values[1], values[2])

        def ramp(output: Output, values: list[float]) -> None:
            output.ramps, output.ramp_K_per_min = int(values[0]), values[1]

        def keep(name: str) -> Callable[[Output, list[float]], None]:
            return lambda output, values: setattr(output, name, values[0])

        def setup(output: Output, values: list[float]) -> None:
            output.setup = values

        kind = ((0.0, 1.0),) if len(self.outputs[1].setup) == 5 else ()  # the 335 has the output's type in front
        define("HTRSET", setup, _setup_text, *kind, (1, 2), (0, 4), (0.0, 2.0), (1, 2))
        inputs = (0, len(self.inputs))
        define("OUTMODE", mode, lambda o: f"{o.mode},{o.input},{o.stays_on}", (0, 5), inputs, (0, 1))
        define("RANGE", keep("range"), lambda o: f"{o.range:.0f}", (0, 3))
        define("MOUT", keep("manual_percent"), lambda o: f"{o.manual_percent:+06.2f}", (0.0, 100.0))
        define("SETP", keep("setpoint"), lambda o: f"{o.setpoint:+08.3f}", (-1e4, 1e4))
        pid = (0.1, 1000.0), (0.0, 1000.0), (0.0, 200.0)
        define("PID", gains, lambda o: ",".join(f"{value:+07.1f}" for value in o.gains), *pid)
        define("RAMP", ramp, lambda o: f"{o.ramps},{o.ramp_K_per_min:+06.2f}", (0, 1), (0.0, 100.0))
        self._tree.define("HTR", ask=lambda p: f"{self._output(p).percent:+06.1f}")
        self._tree.define("HTRST", ask=lambda p: f"{self._output(p).heater_error}")
        self._tree.define("RAMPST", ask=lambda _: "0")

    # ---- sensors --------------------------------------------------------------------------------

    def reading_K(self, name: str) -> float:
        """Return the reading that an input shows, K, until its next one; nan if its sensor is open."""
        until_s, shown_K = self._readings.get(name, (-inf, nan))
        if self._now_s >= until_s:
            plant = self._plant
            on_plate = name == self._plate_input
            shown_K = (plant.read_temperature_degC() if on_plate else plant.sink_temperature_degC()) + KELVIN
            self._readings[name] = self._now_s + self._update_s, shown_K
        return shown_K

    def setpoint_K(self, output: Output) -> float:
        """Return an output's setpoint, which counts in the units of its input, in K."""
        kelvin = self.input_types[self.inputs[max(output.input, 1) - 1]][-1] == KELVIN_UNITS
        return output.setpoint if kelvin else output.setpoint + KELVIN

    # ---- outputs --------------------------------------------------------------------------------

    def changed(self, output: Output) -> None:
        """Let a setting act, at once but for the control loop, which acts at its next sample."""
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

    def _control(self) -> None:
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
            ramp_K_per_s=output.ramp_K_per_min / 60.0 if output.ramps else 0.0,
            gain_percent_per_K=gain,
            integral_time_s=1000.0 / integral if integral else 0.0,
            derivative_time_s=derivative / 100.0,
            lowest_percent=0.0,
        )

    def reset(self) -> None:
        """Switch the outputs off, as after power on; limits stay."""
        for output in self.outputs.values():
            output.mode, output.range, output.manual_percent = OFF, 0, 0.0
            self.changed(output)


Span = tuple[float, float]


def _numbers(parameters: Parameters, *spans: Span) -> list[float]:
    """Return as many numbers as there are spans, each within its own."""
    if len(parameters) != len(spans):
        raise ScpiError(*MISSING_PARAMETER)
    found = []
    for text, (low, high) in zip(parameters, spans, strict=True):
        try:
            value = float(text)
        except ValueError:
            raise ScpiError(*MISSING_PARAMETER) from None
        if not low <= value <= high:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        found.append(value)
    return found


def _setup_text(output: Output) -> str:
    *front, user_A, shows = output.setup
    return ",".join([*(f"{value:.0f}" for value in front), f"{user_A:+.3f}", f"{shows:.0f}"])

"""Lake Shore 335 or 336 temperature controller.

Source: Model 335 and 336 user's manuals, chapter 6 (interface commands, formats of answers, status system), as far as
our driver, QCoDeS and the maker's own package use it. NOT verified on an instrument: how long a command takes, the law
of the control loop (here the textbook PID with I in 1000/s), how many decimals TLIMIT keeps.

One output heats the plant, and one sensor is on it; the other sensors show the heat sink. Full power of an output is
that of its "high" range, a tenth and a hundredth are the others'. There is no error queue: errors set bits of the event
status register.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from math import inf, isnan, nan
from typing import ClassVar, NamedTuple

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


Span = tuple[float, float]


class Command(NamedTuple):
    """A row of the command table: numbers of an input or output that are set, kept and answered.

    text: their % format; spans: of each.
    """

    default: tuple[float, ...]
    text: str
    spans: tuple[Span, ...]


OF_INPUTS = {
    "TLIMIT": Command((0.0,), "%+09.3f", ((0.0, 9999.0),)),
    "INTYPE": Command((2, 0, 1, 0, KELVIN_UNITS), "%d,%d,%d,%d,%d", ((0, 4), (0, 1), (0, 8), (0, 1), (1, 3))),
}
OF_OUTPUTS = {
    "HTRSET": Command((1, 0, 1.0, 1), "%.0f,%.0f,%+.3f,%.0f", ((1, 2), (0, 4), (0.0, 2.0), (1, 2))),
    "OUTMODE": Command((OFF, 1, 0), "%d,%d,%d", ((0, 5), (0, 4), (0, 1))),
    "RANGE": Command((0,), "%d", ((0, 3),)),
    "MOUT": Command((0.0,), "%+06.2f", ((0.0, 100.0),)),
    "SETP": Command((0.0,), "%+08.3f", ((-1e4, 1e4),)),
    "PID": Command((50.0, 20.0, 0.0), "%+07.1f,%+07.1f,%+07.1f", ((0.1, 1000.0), (0.0, 1000.0), (0.0, 200.0))),
    "RAMP": Command((0, 0.1), "%d,%+06.2f", ((0, 1), (0.0, 100.0))),
}
OF_335 = {  # it has the output's type in front, and two inputs
    "HTRSET": Command((0, 1, 0, 1.0, 1), "%.0f,%.0f,%.0f,%+.3f,%.0f", ((0, 1), (1, 2), (0, 4), (0.0, 2.0), (1, 2))),
    "OUTMODE": Command((OFF, 1, 0), "%d,%d,%d", ((0, 5), (0, 2), (0, 1))),
}


@dataclass
class Output:
    """What a heater output does."""

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
        self.outputs = {number: Output() for number in ((1, 2) if model == "335" else (1, 2, 3, 4))}
        self.values: dict[tuple[str, str | int], tuple[float, ...]] = {}
        self._update_s = update_s
        self._readings: dict[str, tuple[float, float]] = {}  # until when, K
        self.event_enable, self.event_status = 0, POWER_ON
        self._define_common()
        self._define_readings()
        for word, command in OF_INPUTS.items():
            self._define_numbers(word, command, self._input, self.inputs)
        for word, command in (OF_OUTPUTS | OF_335 if model == "335" else OF_OUTPUTS).items():
            self._define_numbers(word, command, self._output, self.outputs)
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

        define = self._tree.define
        define("*IDN", ask=lambda _: self.identity)
        define("*RST", set=lambda _: self.reset())
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

    def _define_readings(self) -> None:
        def shown(value: float) -> str:
            return "+000.000" if isnan(value) else f"{value:+08.3f}"

        define, named, output = self._tree.define, self._input, self._output
        define("KRDG", ask=lambda p: shown(self.reading_K(named(p))))
        define("CRDG", ask=lambda p: shown(self.reading_K(named(p)) - KELVIN))
        define("SRDG", ask=lambda p: shown(self.reading_K(named(p))))
        define("RDGST", ask=lambda p: f"{INVALID if isnan(self.reading_K(named(p))) else 0:03d}")
        define("INNAME", ask=lambda p: f"Input {named(p)}       ")

        define("HTR", ask=lambda p: f"{self.outputs[output(p)].percent:+06.1f}")
        define("HTRST", ask=lambda p: f"{self.outputs[output(p)].heater_error}")
        define("RAMPST", ask=lambda _: "0")

    def _output(self, parameters: Parameters) -> int:
        if not parameters or not parameters[0].strip().isascii() or not parameters[0].strip().isdigit():
            raise ScpiError(*MISSING_PARAMETER)
        if int(parameters[0]) not in self.outputs:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        return int(parameters[0])

    def _define_numbers(
        self, word: str, command: Command, named: Callable[[Parameters], str | int], all_of_them: Iterable[str | int]
    ) -> None:
        """Define a row of the command table. named: returns the input or output that a command is for."""

        def change(parameters: Parameters) -> None:
            self.values[word, named(parameters)] = _numbers(parameters[1:], *command.spans)
            self.changed()

        self.values |= {(word, one): command.default for one in all_of_them}
        self._tree.define(word, set=change, ask=lambda p: command.text % self.values[word, named(p)])

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

    def setpoint_K(self, number: int) -> float:
        """Return an output's setpoint, which counts in the units of its input, in K."""
        (setpoint,), (_, source, _) = self.values["SETP", number], self.values["OUTMODE", number]
        units = self.values["INTYPE", self.inputs[max(int(source), 1) - 1]][-1]
        return setpoint if units == KELVIN_UNITS else setpoint + KELVIN

    # ---- outputs --------------------------------------------------------------------------------

    def changed(self) -> None:
        """Let the settings act, at once but for the control loop, which acts at its next sample."""
        for number, output in self.outputs.items():
            mode = self.values["OUTMODE", number][0]
            if self.values["RANGE", number][0] == 0 or mode == OFF:
                output.percent = 0.0
                output.regulator.start()
            elif mode == OPEN_LOOP:
                output.percent = self.values["MOUT", number][0]
        power = (
            self.outputs[self._plate_output].percent / 100.0 * POWER[int(self.values["RANGE", self._plate_output][0])]
        )
        if power * self._full_drive_A != self._plant.current_A:
            self._plant.set_current_A(power * self._full_drive_A)

    def _control(self) -> None:
        readings_K = {name: self.reading_K(name) for name in self.inputs}
        limits_K = {name: self.values["TLIMIT", name][0] for name in self.inputs}
        if any(limits_K[name] and reading_K > limits_K[name] for name, reading_K in readings_K.items()):
            self.values |= {("RANGE", number): (0,) for number in self.outputs}
        for number, output in self.outputs.items():
            mode, source, _ = self.values["OUTMODE", number]
            if mode == CLOSED_LOOP and self.values["RANGE", number][0] and source:
                reading_K = readings_K[self.inputs[int(source) - 1]]
                output.percent = 0.0 if isnan(reading_K) else self._regulated(number, output, reading_K)
        self.changed()

    def _regulated(self, number: int, output: Output, reading_K: float) -> float:
        (gain, integral, derivative), (ramps, ramp_K_per_min) = self.values["PID", number], self.values["RAMP", number]
        return output.regulator.step(
            self.setpoint_K(number),
            reading_K,
            ramp_K_per_s=ramp_K_per_min / 60.0 if ramps else 0.0,
            gain_percent_per_K=gain,
            integral_time_s=1000.0 / integral if integral else 0.0,
            derivative_time_s=derivative / 100.0,
            lowest_percent=0.0,
        )

    def reset(self) -> None:
        """Switch the outputs off, as after power on; limits stay."""
        for word in ("OUTMODE", "RANGE", "MOUT"):
            self.values |= {(word, number): OF_OUTPUTS[word].default for number in self.outputs}
        self.changed()


def _numbers(parameters: Parameters, *spans: Span) -> tuple[float, ...]:
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
    return tuple(found)

"""The Lake Shore 335's and 336's commands: which word does what to the emulated controller.

Source: Model 335 and 336 user's manuals, section 6.6 (interface commands), as far as remote clients use them.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.instruments.scpi import DATA_OUT_OF_RANGE, MISSING_PARAMETER, CommandTree, ScpiError

if TYPE_CHECKING:
    from sim.instruments.lakeshore import LakeShore, Output

KELVIN = 273.15  # 0 degC in K
IGNORED = ("EMUL", "MODE", "LOCK", "BRIGT", "LEDS", "DISPLAY", "FILTER", "INCRV", "*CLS", "*SRE", "*OPC")
Parameters = tuple[str, ...]


def define_commands(tree: CommandTree, instrument: LakeShore) -> None:
    """Fill `tree` with the commands of `instrument`."""
    _define_common(tree, instrument)
    _define_inputs(tree, instrument)
    _define_outputs(tree, instrument)


def _numbers(parameters: Parameters, *spans: tuple[float, float]) -> list[float]:
    """As many numbers as there are spans, each within its own."""
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


def _define_common(tree: CommandTree, instrument: LakeShore) -> None:
    def enable(parameters: Parameters) -> None:
        (value,) = _numbers(parameters, (0, 255))
        instrument.event_enable = int(value) & 0b10110101  # the bits that are used

    def status(_: Parameters) -> str:
        found, instrument.event_status = instrument.event_status, 0
        return f"{found:03d}"

    tree.define("*IDN", ask=lambda _: instrument.identity)
    tree.define("*RST", set=lambda _: instrument.reset())
    tree.define("*ESE", set=enable, ask=lambda _: f"{instrument.event_enable:03d}")
    tree.define("*ESR", ask=status)
    tree.define("*OPC", ask=lambda _: "1")
    tree.define("*TST", ask=lambda _: "0")
    tree.define("*STB", ask=lambda _: "000")
    for word in IGNORED:
        tree.define(word, set=lambda _: None)


def _define_inputs(tree: CommandTree, instrument: LakeShore) -> None:
    def named(parameters: Parameters, count: int = 1) -> str:
        if len(parameters) != count:
            raise ScpiError(*MISSING_PARAMETER)
        name = parameters[0].strip().upper()
        if name not in instrument.inputs:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        return name

    def shown(value: float) -> str:
        return "+000.000" if value != value else f"{value:+08.3f}"

    def limit(parameters: Parameters) -> None:
        name = named(parameters, 2)
        (instrument.limits_K[name],) = _numbers(parameters[1:], (0.0, 9999.0))

    def kind(parameters: Parameters) -> None:
        name = named(parameters, 6)
        spans = ((0, 4), (0, 1), (0, 8), (0, 1), (1, 3))
        instrument.input_types[name] = [int(value) for value in _numbers(parameters[1:], *spans)]

    tree.define("KRDG", ask=lambda p: shown(instrument.reading_K(named(p))))
    tree.define("CRDG", ask=lambda p: shown(instrument.reading_K(named(p)) - KELVIN))
    tree.define("SRDG", ask=lambda p: shown(instrument.reading_K(named(p))))
    tree.define("RDGST", ask=lambda p: f"{instrument.reading_status(named(p)):03d}")
    tree.define("TLIMIT", set=limit, ask=lambda p: f"{instrument.limits_K[named(p)]:+09.3f}")
    tree.define("INTYPE", set=kind, ask=lambda p: ",".join(map(str, instrument.input_types[named(p)])))
    tree.define("INNAME", ask=lambda p: f"Input {named(p)}       ")


def _define_outputs(tree: CommandTree, instrument: LakeShore) -> None:
    def of(parameters: Parameters) -> Output:
        if not parameters or not parameters[0].strip().isascii() or not parameters[0].strip().isdigit():
            raise ScpiError(*MISSING_PARAMETER)
        output = instrument.outputs.get(int(parameters[0]))
        if output is None:
            raise ScpiError(*DATA_OUT_OF_RANGE)
        return output

    def define(word: str, spans: tuple[tuple[float, float], ...], take: Take, text: Callable[[Output], str]) -> None:
        def change(parameters: Parameters) -> None:
            output = of(parameters)
            take(output, _numbers(parameters[1:], *spans))
            instrument.changed(output)

        tree.define(word, set=change, ask=lambda p: text(of(p)))

    def setup(output: Output, values: list[float]) -> None:
        output.setup = values

    def mode(output: Output, values: list[float]) -> None:
        output.mode, output.input, output.stays_on = (int(value) for value in values)

    def in_range(output: Output, values: list[float]) -> None:
        output.range = int(values[0])

    def manual(output: Output, values: list[float]) -> None:
        output.manual_percent = values[0]

    def setpoint(output: Output, values: list[float]) -> None:
        output.setpoint = values[0]

    def gains(output: Output, values: list[float]) -> None:
        output.gains = (values[0], values[1], values[2])

    def ramp(output: Output, values: list[float]) -> None:
        output.ramps, output.ramp_K_per_min = int(values[0]), values[1]

    kinds = ((0.0, 1.0),) if len(instrument.outputs[1].setup) == 5 else ()
    define("HTRSET", (*kinds, (1, 2), (0, 4), (0.0, 2.0), (1, 2)), setup, _setup_text)
    inputs = (0, len(instrument.inputs))
    define("OUTMODE", ((0, 5), inputs, (0, 1)), mode, lambda o: f"{o.mode},{o.input},{o.stays_on}")
    define("RANGE", ((0, 3),), in_range, lambda o: f"{o.range}")
    define("MOUT", ((0.0, 100.0),), manual, lambda o: f"{o.manual_percent:+06.2f}")
    define("SETP", ((-1e4, 1e4),), setpoint, lambda o: f"{o.setpoint:+08.3f}")
    define(
        "PID",
        ((0.1, 1000.0), (0.0, 1000.0), (0.0, 200.0)),
        gains,
        lambda o: ",".join(f"{value:+07.1f}" for value in o.gains),
    )
    define("RAMP", ((0, 1), (0.0, 100.0)), ramp, lambda o: f"{o.ramps},{o.ramp_K_per_min:+06.2f}")
    tree.define("HTR", ask=lambda p: f"{of(p).percent:+06.1f}")
    tree.define("HTRST", ask=lambda p: f"{of(p).heater_error}")
    tree.define("RAMPST", ask=lambda p: "0")


def _setup_text(output: Output) -> str:
    *front, user_A, shows = output.setup
    return ",".join([*(f"{value:.0f}" for value in front), f"{user_A:+.3f}", f"{shows:.0f}"])


Take = Callable[["Output", list[float]], None]

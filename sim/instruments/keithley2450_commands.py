"""The Keithley 2450's commands: which header does what to the emulated meter.

Source: Model 2450 reference manual 2450-901-01, section 6, as far as remote clients (PyMeasure, QCoDeS) use it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.instruments.meter_commands import Settings, define_system
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, CommandTree, ScpiError, boolean, number
from sim.instruments.scpi_settings import Parameters, define_number, define_switch, define_word, unquoted

if TYPE_CHECKING:
    from sim.instruments.keithley2450 import Keithley2450

Elements = Callable[[Parameters], tuple[str, ...]]

# short name -> (as the instrument answers it, its header)
FUNCTIONS = {
    "VOLT": ("VOLT:DC", "VOLTage[:DC]"),
    "CURR": ("CURR:DC", "CURRent[:DC]"),
    "RES": ("RES", "RESistance"),
}
ELEMENTS = {"SOURCE": "SOUR", "READING": "READ", "RELATIVE": "REL", "STATUS": "STAT"}
ELEMENTS |= {short: short for short in ELEMENTS.values()}
SOURCES = (("CURRent", "SOUR:CURR", 1.05, "VLIMit", 210.0), ("VOLTage", "SOUR:VOLT", 210.0, "ILIMit", 1.05))
NUMBERS: tuple[tuple[str, str, str, float, float, float], ...] = (
    (":FORMat:ASCii:PRECision", "PREC", "%d", 0, 0, 16),
    ("[:SENSe#]:COUNt", "COUN", "%d", 1, 1, 300000),
    ("*ESE", "*ESE", "%d", 0, 0, 255),
    ("*SRE", "*SRE", "%d", 0, 0, 255),
)
SWITCHES = ((":DISPlay:READing:FORMat", "DISP", 0),)
WORDS = ((":ROUTe:TERMinals", "TERM", "FRON"), (":FORMat[:DATA]", "FORM", "ASC"))
SILENT = (":ABORt", "*WAI", "*OPC", "*LANG", ":SYSTem:CLEar", ":TRACe:CLEar")
SETTINGS = Settings(NUMBERS, SWITCHES, WORDS, SILENT, ("*ESE", "*SRE"))


def default_settings() -> dict[str, float | str]:
    """Every setting at its `*RST` value, by short name."""
    settings = SETTINGS.defaults()
    for function in FUNCTIONS:
        settings |= {f"{function}:NPLC": 1.0, f"{function}:RSEN": 0, f"{function}:AZER": 1}
        settings |= {f"{function}:AVER": 0, f"{function}:AVER:COUN": 10, f"{function}:AVER:TCON": "REP"}
        settings |= {f"{function}:RANG:AUTO": 1, f"{function}:RANG": 0.0}
    for _, name, _, _, _ in SOURCES:
        settings |= {name: 0.0, f"{name}:LIM": 0.0, f"{name}:RANG": 0.0, f"{name}:AUTO": 1}
    return settings | {"SOUR:FUNC": "VOLT", "VOLT:RANG": 20.0, "CURR:RANG": 1e-4}


def define_commands(tree: CommandTree, meter: Keithley2450) -> None:
    """Fill `tree` with the commands of `meter`."""
    SETTINGS.define(tree, meter)
    for function, (_, header) in FUNCTIONS.items():
        sense = f"[:SENSe#]:{header}"
        define_number(tree, meter, f"{sense}:NPLCycles", f"{function}:NPLC", "%g", 1.0, 0.01, 10.0)
        define_switch(tree, meter, f"{sense}:RSENse", f"{function}:RSEN")
        define_switch(tree, meter, f"{sense}:AZERo", f"{function}:AZER")
        define_number(tree, meter, f"{sense}:AVERage:COUNt", f"{function}:AVER:COUN", "%d", 10, 1, 100)
        define_switch(tree, meter, f"{sense}:AVERage[:STATe]", f"{function}:AVER")
        define_word(tree, meter, f"{sense}:AVERage:TCONtrol", f"{function}:AVER:TCON")
        define_switch(tree, meter, f"{sense}:RANGe:AUTO", f"{function}:RANG:AUTO")
        _define_range(tree, meter, function, f"{sense}:RANGe[:UPPer]")
    _define_source(tree, meter)
    _define_functions(tree, meter)
    _define_readings(tree, meter)
    tree.define("*LANG", ask=lambda _: "SCPI")
    tree.define(":SYSTem:LFRequency", ask=lambda _: "50")
    tree.define(":TRACe:POINts", set=lambda _: None, ask=lambda _: "100000")
    define_system(tree, meter, SETTINGS, version="1999.0")


def _define_range(tree: CommandTree, meter: Keithley2450, function: str, header: str) -> None:
    largest = {"RES": 200e6, "VOLT": 200.0, "CURR": 1.0}[function]

    def change(parameters: Parameters) -> None:
        value = number(parameters, 0.0, largest, largest)
        meter.settings[f"{function}:RANG:AUTO"] = 0
        if function == "RES":
            meter.choose_range(value)
        else:
            meter.settings[f"{function}:RANG"] = meter.voltage_range_V(value) if function == "VOLT" else value

    def text(_: Parameters) -> str:
        return f"{meter.full_scale_ohm if function == 'RES' else float(meter.settings[f'{function}:RANG']):g}"

    tree.define(header, set=change, ask=text)


def _define_source(tree: CommandTree, meter: Keithley2450) -> None:
    def output(parameters: Parameters) -> None:
        meter.switch_output(boolean(parameters))

    def source(parameters: Parameters) -> None:
        word = parameters[0].upper()[:4] if parameters else ""
        if word not in ("CURR", "VOLT"):
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        meter.settings["SOUR:FUNC"] = word
        meter.tell_test_current()

    tree.define(":OUTPut#[:STATe]", set=output, ask=lambda _: str(int(meter.output_is_on)))
    tree.define(":SOURce#:FUNCtion[:MODE]", set=source, ask=lambda _: str(meter.settings["SOUR:FUNC"]))
    for word, name, largest, limit, most in SOURCES:
        _define_level(tree, meter, f":SOURce#:{word}", name, largest)
        define_number(tree, meter, f":SOURce#:{word}:{limit}[:LEVel]", f"{name}:LIM", "%.6E", 0.0, 0.0, most)
        define_number(tree, meter, f":SOURce#:{word}:RANGe", f"{name}:RANG", "%.6E", 0.0, -largest, largest)
        define_switch(tree, meter, f":SOURce#:{word}:RANGe:AUTO", f"{name}:AUTO")


def _define_level(tree: CommandTree, meter: Keithley2450, header: str, name: str, largest: float) -> None:
    def change(parameters: Parameters) -> None:
        meter.settings[name] = number(parameters, -largest, largest, 0.0)
        meter.tell_test_current()

    tree.define(f"{header}[:LEVel][:IMMediate][:AMPLitude]", set=change, ask=lambda _: f"{meter.settings[name]:.6E}")


def _define_functions(tree: CommandTree, meter: Keithley2450) -> None:
    def choose(parameters: Parameters) -> None:
        name = unquoted(parameters)
        meter.choose_function(
            next((short for short, (_, header) in FUNCTIONS.items() if tree.spells(name, header)), name)
        )

    tree.define("[:SENSe#]:FUNCtion[:ON]", set=choose, ask=lambda _: f'"{FUNCTIONS[meter.function][0]}"')


def _define_readings(tree: CommandTree, meter: Keithley2450) -> None:
    def elements(parameters: Parameters) -> tuple[str, ...]:
        """Behind the buffer's name; the reading alone where there is none."""
        try:
            return tuple(ELEMENTS[word.upper()] for word in parameters[1:]) or ("READ",)
        except KeyError:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE) from None

    tree.define(":READ", ask=lambda p: meter.ask_reading(elements(p)))
    tree.define(":MEASure", ask=lambda p: meter.ask_reading(elements(p)))
    tree.define(":FETCh", ask=lambda p: meter.ask_again(elements(p)))
    for function, (_, header) in FUNCTIONS.items():
        _define_measuring_of(tree, meter, function, header, elements)


def _define_measuring_of(
    tree: CommandTree, meter: Keithley2450, function: str, header: str, elements: Elements
) -> None:
    def measure(parameters: Parameters) -> None:
        meter.choose_function(function)
        meter.ask_reading(elements(parameters))

    tree.define(":MEASure:" + header, ask=measure)

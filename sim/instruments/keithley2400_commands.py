"""The Keithley 2400's commands: which header does what to the emulated meter.

Source: 2400 series manual chapter 18 (SCPI reference), as far as remote clients (PyMeasure's among them) use it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sim.instruments.meter_commands import Settings, define_system
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, MISSING_PARAMETER, CommandTree, ScpiError, boolean, number
from sim.instruments.scpi_settings import Parameters, define_number

if TYPE_CHECKING:
    from sim.instruments.keithley2400 import Keithley2400

# short name -> (as the instrument answers it, its header)
FUNCTIONS = {
    "VOLT": ("VOLT:DC", "VOLTage[:DC]"),
    "CURR": ("CURR:DC", "CURRent[:DC]"),
    "RES": ("RES", "RESistance"),
}
ELEMENT_WORDS = {
    "VOLT": "VOLT",
    "VOLTAGE": "VOLT",
    "CURR": "CURR",
    "CURRENT": "CURR",
    "RES": "RES",
    "RESISTANCE": "RES",
    "TIME": "TIME",
    "STAT": "STAT",
    "STATUS": "STAT",
}
NUMBERS: tuple[tuple[str, str, str, float, float, float], ...] = (
    (":TRIGger[:SEQuence#]:COUNt", "TRIG:COUN", "%d", 1, 1, 2500),
    (":TRIGger[:SEQuence#]:DELay", "TRIG:DEL", "%.4f", 0.0, 0.0, 999.9999),
    (":ARM[:SEQuence#][:LAYer#]:COUNt", "ARM:COUN", "%d", 1, 1, 2500),
    (":ARM[:SEQuence#][:LAYer#]:TIMer", "ARM:TIM", "%.3f", 0.1, 0.001, 99999.99),
    (":TRIGger[:SEQuence#]:ILINe", "TRIG:ILIN", "%d", 1, 1, 4),
    (":TRIGger[:SEQuence#]:OLINe", "TRIG:OLIN", "%d", 2, 1, 4),
    (":ARM[:SEQuence#][:LAYer#]:ILINe", "ARM:ILIN", "%d", 1, 1, 4),
    (":ARM[:SEQuence#][:LAYer#]:OLINe", "ARM:OLIN", "%d", 2, 1, 4),
    ("[:SENSe#]:AVERage:COUNt", "AVER:COUN", "%d", 10, 1, 100),
    ("[:SENSe#]:CURRent[:DC]:RANGe[:UPPer]", "CURR:RANG", "%+.6E", 1.05e-4, -1.05, 1.05),
    ("[:SENSe#]:CURRent[:DC]:PROTection[:LEVel]", "CURR:PROT", "%+.6E", 1.05e-4, -1.05, 1.05),
    ("[:SENSe#]:VOLTage[:DC]:RANGe[:UPPer]", "VOLT:RANG", "%+.6E", 21.0, -210.0, 210.0),
    ("[:SENSe#]:VOLTage[:DC]:PROTection[:LEVel]", "VOLT:PROT", "%+.6E", 21.0, -210.0, 210.0),
    (":SOURce#:CURRent:RANGe", "SOUR:CURR:RANG", "%+.6E", 1.05e-4, -1.05, 1.05),
    (":SOURce#:VOLTage:RANGe", "SOUR:VOLT:RANG", "%+.6E", 21.0, -210.0, 210.0),
    (":SOURce#:DELay", "SOUR:DEL", "%.5f", 0.0, 0.0, 999.9999),
    (":TRACe:POINts", "TRAC:POIN", "%d", 100, 1, 2500),
    (":STATus:MEASurement:ENABle", "STAT:MEAS", "%d", 0, 0, 65535),
    ("*ESE", "*ESE", "%d", 0, 0, 255),
    ("*SRE", "*SRE", "%d", 0, 0, 255),
)
SOURCE_LEVELS = (("CURRent", "SOUR:CURR", 1.05), ("VOLTage", "SOUR:VOLT", 210.0))
SWITCHES = (
    (":SYSTem:RSENse", "RSEN", 0),
    (":SYSTem:AZERo[:STATe]", "AZER", 1),
    (":SYSTem:BEEPer:STATe", "BEEP", 1),
    (":DISPlay:ENABle", "DISP", 1),
    (":SOURce#:CLEar:AUTO", "SOUR:CLE", 0),
    (":SOURce#:DELay:AUTO", "SOUR:DEL:AUTO", 1),
    (":SOURce#:CURRent:RANGe:AUTO", "SOUR:CURR:AUTO", 1),
    (":SOURce#:VOLTage:RANGe:AUTO", "SOUR:VOLT:AUTO", 1),
    ("[:SENSe#]:FUNCtion:CONCurrent", "CONC", 1),
    ("[:SENSe#]:CURRent[:DC]:RANGe:AUTO", "CURR:RANG:AUTO", 1),
    ("[:SENSe#]:VOLTage[:DC]:RANGe:AUTO", "VOLT:RANG:AUTO", 1),
    ("[:SENSe#]:RESistance:RANGe:AUTO", "RES:RANG:AUTO", 1),
    ("[:SENSe#]:RESistance:OCOMpensated", "RES:OCOM", 0),
    ("[:SENSe#]:AVERage[:STATe]", "AVER", 0),
)
WORDS = (
    (":TRIGger[:SEQuence#]:SOURce", "TRIG:SOUR", "IMM"),
    (":ARM[:SEQuence#][:LAYer#]:SOURce", "ARM:SOUR", "IMM"),
    (":TRIGger[:SEQuence#]:OUTPut", "TRIG:OUTP", "NONE"),
    (":ARM[:SEQuence#][:LAYer#]:OUTPut", "ARM:OUTP", "NONE"),
    (":OUTPut#:SMODe", "SMOD", "NORM"),
    (":ROUTe:TERMinals", "TERM", "FRON"),
    (":TRACe:FEED", "TRAC:FEED", "SENS"),
    (":TRACe:FEED:CONTrol", "TRAC:CONT", "NEV"),
    (":FORMat[:DATA]", "FORM", "ASC"),
    (":CALCulate3:FORMat", "CALC3:FORM", "MEAN"),
    ("[:SENSe#]:AVERage:TCONtrol", "AVER:TCON", "REP"),
)
SILENT = (
    ":SYSTem:LOCal",
    ":SYSTem:REMote",
    ":SYSTem:RWLock",
    ":SYSTem:BEEPer[:IMMediate]",
    ":STATus:PRESet",
    ":TRACe:CLEar",
    ":TRIGger:CLEar",
    "*OPC",
    "*WAI",
    "*TRG",
)
SETTINGS = Settings(NUMBERS, SWITCHES, WORDS, SILENT, ("*ESE", "*SRE", "STAT:MEAS"))


def default_settings() -> dict[str, float | str]:
    """Every setting at its `*RST` value, by short name."""
    settings = SETTINGS.defaults()
    settings |= {name: 0.0 for _, name, _ in SOURCE_LEVELS}
    settings |= {"NPLC": 1.0, "RES:MODE": "MAN", "SOUR:FUNC": "VOLT"}
    return settings


def define_commands(tree: CommandTree, meter: Keithley2400) -> None:
    """Fill `tree` with the commands of `meter`."""
    SETTINGS.define(tree, meter)
    for function, (_, header) in FUNCTIONS.items():
        define_number(tree, meter, f"[:SENSe#]:{header}:NPLCycles", "NPLC", "%.2f", 1.0, 0.01, 10.0)
        _define_measuring_of(tree, meter, function, header)
    _define_source(tree, meter)
    _define_functions(tree, meter)
    _define_resistance(tree, meter)
    _define_readings(tree, meter)
    _define_common(tree, meter)


def _define_source(tree: CommandTree, meter: Keithley2400) -> None:
    def output(parameters: Parameters) -> None:
        meter.switch_output(boolean(parameters))

    def source(parameters: Parameters) -> None:
        word = parameters[0].upper() if parameters else ""
        if word not in ("CURR", "CURRENT", "VOLT", "VOLTAGE"):
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        meter.settings["SOUR:FUNC"] = word[:4]
        meter.tell_test_current()

    tree.define(":OUTPut#[:STATe]", set=output, ask=lambda _: str(int(meter.output_is_on)))
    tree.define(":SOURce#:FUNCtion[:MODE]", set=source, ask=lambda _: str(meter.settings["SOUR:FUNC"]))
    for word, name, largest in SOURCE_LEVELS:
        _define_level(tree, meter, f":SOURce#:{word}[:LEVel][:IMMediate][:AMPLitude]", name, largest)


def _define_level(tree: CommandTree, meter: Keithley2400, header: str, name: str, largest: float) -> None:
    def change(parameters: Parameters) -> None:
        meter.settings[name] = number(parameters, -largest, largest, 0.0)
        meter.tell_test_current()

    tree.define(header, set=change, ask=lambda _: f"{float(meter.settings[name]):+.6E}")


def _define_functions(tree: CommandTree, meter: Keithley2400) -> None:
    def named(parameters: Parameters) -> set[str]:
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        names = set()
        for quoted in parameters:
            word = quoted.strip("\"'")
            if word == quoted:
                raise ScpiError(-141, "Invalid character data")
            name = next((short for short, (_, header) in FUNCTIONS.items() if tree.spells(word, header)), word)
            names.add(name)
        return names

    def on(parameters: Parameters) -> None:
        meter.choose_functions(named(parameters), True)

    def off(parameters: Parameters) -> None:
        meter.choose_functions(named(parameters), False)

    def text(_: Parameters) -> str:
        return ",".join(f'"{answer}"' for short, (answer, _) in FUNCTIONS.items() if short in meter.enabled)

    tree.define("[:SENSe#]:FUNCtion[:ON]", set=on, ask=text)
    tree.define("[:SENSe#]:FUNCtion:OFF", set=off)
    tree.define("[:SENSe#]:FUNCtion[:ON]:ALL", set=lambda _: meter.choose_functions(set(FUNCTIONS), True))
    tree.define("[:SENSe#]:FUNCtion:OFF:ALL", set=lambda _: meter.choose_functions(set(FUNCTIONS), False))


def _define_resistance(tree: CommandTree, meter: Keithley2400) -> None:
    def mode(parameters: Parameters) -> None:
        word = parameters[0].upper() if parameters else ""
        if word not in ("AUTO", "MAN", "MANUAL"):
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE)
        meter.settings["RES:MODE"] = word if word == "AUTO" else "MAN"
        meter.tell_test_current()

    def change_range(parameters: Parameters) -> None:
        value = number(parameters, 0.0, 210e6, 210e3)
        meter.settings["RES:RANG:AUTO"] = 0
        meter.choose_range(value)

    tree.define("[:SENSe#]:RESistance:MODE", set=mode, ask=lambda _: str(meter.settings["RES:MODE"]))
    tree.define("[:SENSe#]:RESistance:RANGe[:UPPer]", set=change_range, ask=lambda _: f"{meter.full_scale_ohm:+.6E}")


def _define_measuring_of(tree: CommandTree, meter: Keithley2400, function: str, header: str) -> None:
    def configure(_: Parameters) -> None:
        meter.configure(function)

    def measure(_: Parameters) -> None:
        meter.configure(function)
        meter.read(1)

    tree.define(":CONFigure:" + header, set=configure)
    tree.define(":MEASure:" + header, ask=measure)


def _define_readings(tree: CommandTree, meter: Keithley2400) -> None:
    def count() -> int:
        return int(meter.settings["TRIG:COUN"]) * int(meter.settings["ARM:COUN"])

    def elements(parameters: Parameters) -> None:
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        try:
            wanted = {ELEMENT_WORDS[word.upper()] for word in parameters}
        except KeyError:
            raise ScpiError(*ILLEGAL_PARAMETER_VALUE) from None
        meter.elements = tuple(word for word in ("VOLT", "CURR", "RES", "TIME", "STAT") if word in wanted)

    tree.define(":FORMat:ELEMents[:SENSe#]", set=elements, ask=lambda _: ",".join(meter.elements))
    tree.define(":READ", ask=lambda _: meter.read(count()))
    tree.define(":MEASure", ask=lambda _: meter.read(1))
    tree.define(":FETCh", ask=lambda _: meter.fetch(fresh=False))
    tree.define("[:SENSe#]:DATA[:LATest]", ask=lambda _: meter.fetch(fresh=False))
    tree.define(":INITiate[:IMMediate]", set=lambda _: meter.initiate(count()))
    tree.define(":ABORt", set=lambda _: meter.abort())
    tree.define(":CALCulate3:DATA", ask=lambda _: "+0.000000E+00,+0.000000E+00,+0.000000E+00")


def _define_common(tree: CommandTree, meter: Keithley2400) -> None:
    def azero(parameters: Parameters) -> None:
        once = len(parameters) == 1 and parameters[0].upper() == "ONCE"
        meter.settings["AZER"] = 0 if once else int(boolean(parameters))

    tree.define(":SYSTem:AZERo[:STATe]", set=azero)
    define_system(tree, meter, SETTINGS, version="1996.0", more_errors=":STATus:QUEue")

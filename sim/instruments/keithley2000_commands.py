"""The Keithley 2000's commands: which header does what to the emulated meter.

Source: Model 2000 User's Manual rev J chapter 5 (SCPI reference), as far as remote clients of an ohmmeter
use it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.instruments.meter_commands import Settings, define_choice, define_range, define_system
from sim.instruments.scpi import CommandTree
from sim.instruments.scpi_settings import Parameters, define_number, define_switch, define_word

if TYPE_CHECKING:
    from sim.instruments.keithley2000 import Keithley2000

# name as the instrument answers it -> its header
FUNCTIONS = {
    "VOLT:DC": "VOLTage[:DC]",
    "VOLT:AC": "VOLTage:AC",
    "CURR:DC": "CURRent[:DC]",
    "CURR:AC": "CURRent:AC",
    "RES": "RESistance",
    "FRES": "FRESistance",
    "PER": "PERiod",
    "FREQ": "FREQuency",
    "TEMP": "TEMPerature",
    "DIOD": "DIODe",
    "CONT": "CONTinuity",
}
# header under a function, short name, how it is answered, default, limits
FUNCTION_NUMBERS: tuple[tuple[str, str, str, float, float, float], ...] = (
    (":NPLCycles", "NPLC", "%.2f", 1.0, 0.01, 10.0),
    (":DIGits", "DIG", "%d", 7, 4, 7),
    (":REFerence", "REF", "%+.8E", 0.0, -1e9, 1e9),
    (":AVERage:COUNt", "AVER:COUN", "%d", 10, 1, 100),
    (":APERture", "APER", "%.3f", 0.1, 0.01, 1.0),
    (":DETector:BANDwidth", "DET:BAND", "%+.8E", 30, 3, 3e5),
    (":THReshold:VOLTage:RANGe", "THR", "%+.8E", 10, 0, 1010),
)
FUNCTION_SWITCHES = ((":REFerence:STATe", "REF:STAT", 0), (":AVERage[:STATe]", "AVER:STAT", 0))
NUMBERS: tuple[tuple[str, str, str, float, float, float], ...] = (
    (":TRIGger[:SEQuence#]:COUNt", "TRIG:COUN", "%d", 1, 1, 9999),
    (":TRIGger[:SEQuence#]:DELay", "TRIG:DEL", "%.3f", 0.0, 0.0, 999999.999),
    (":SAMPle:COUNt", "TRIG:SAMP", "%d", 1, 1, 1024),
    (":TRACe:POINts", "TRAC:POIN", "%d", 100, 2, 1024),
    (":STATus:MEASurement:ENABle", "STAT:MEAS", "%d", 0, 0, 65535),
    (":STATus:QUEStionable:ENABle", "STAT:QUES", "%d", 0, 0, 65535),
    (":STATus:OPERation:ENABle", "STAT:OPER", "%d", 0, 0, 65535),
    ("*ESE", "*ESE", "%d", 0, 0, 255),
    ("*SRE", "*SRE", "%d", 0, 0, 255),
)
SWITCHES = (
    (":INITiate:CONTinuous", "TRIG:CONT", 0),
    (":SYSTem:BEEPer:STATe", "BEEP", 1),
    (":SYSTem:AZERo[:STATe]", "AZER", 1),
    (":DISPlay:ENABle", "DISP", 1),
)
WORDS = (
    (":TRIGger[:SEQuence#]:SOURce", "TRIG:SOUR", "IMM"),
    (":TRACe:FEED", "TRAC:FEED", "SENS"),
    (":TRACe:FEED:CONTrol", "TRAC:CONT", "NEV"),
    (":FORMat[:DATA]", "FORM", "ASC"),
    (":FORMat:ELEMents", "ELEM", "READ"),
)
SILENT = (
    ":SYSTem:LOCal",
    ":SYSTem:REMote",
    ":SYSTem:RWLock",
    ":SYSTem:PRESet",
    ":SYSTem:BEEPer[:IMMediate]",
    ":STATus:PRESet",
    ":TRACe:CLEar",
    "*OPC",
    "*WAI",
)
SETTINGS = Settings(NUMBERS, SWITCHES, WORDS, SILENT, ("*ESE", "*SRE", "STAT:MEAS", "STAT:QUES", "STAT:OPER"))


def default_settings() -> dict[str, float | str]:
    """Every setting at its `*RST` value, by short name."""
    settings = SETTINGS.defaults()
    for function in FUNCTIONS:
        settings |= {f"{function}:{name}": default for _, name, _, default, _, _ in FUNCTION_NUMBERS}
        settings |= {f"{function}:{name}": default for _, name, default in FUNCTION_SWITCHES}
        settings |= {f"{function}:RANG:AUTO": 1, f"{function}:RANG": 1000.0, f"{function}:TCON": "REP"}
    return settings


def define_commands(tree: CommandTree, meter: Keithley2000) -> None:
    """Fill `tree` with the commands of `meter`."""
    SETTINGS.define(tree, meter)
    for function, header in FUNCTIONS.items():
        _define_function(tree, meter, function, header)
    define_choice(tree, meter, FUNCTIONS)
    define_system(tree, meter, SETTINGS, version="1991.0", more_errors=":STATus:QUEue")
    _define_measuring(tree, meter)


def _define_function(tree: CommandTree, meter: Keithley2000, function: str, header: str) -> None:
    sense = "[:SENSe#]:" + header
    for tail, name, text, default, minimum, maximum in FUNCTION_NUMBERS:
        define_number(tree, meter, sense + tail, f"{function}:{name}", text, default, minimum, maximum)
    for tail, name, _ in FUNCTION_SWITCHES:
        define_switch(tree, meter, sense + tail, f"{function}:{name}")
    define_word(tree, meter, sense + ":AVERage:TCONtrol", f"{function}:TCON")
    define_switch(tree, meter, sense + ":RANGe:AUTO", f"{function}:RANG:AUTO")
    tree.define(sense + ":REFerence:ACQuire", set=lambda _: None)

    def configure(_: Parameters) -> None:
        meter.configure(function)

    define_range(tree, meter, function, sense, 120e6)
    tree.define(":CONFigure:" + header, set=configure)


def _define_measuring(tree: CommandTree, meter: Keithley2000) -> None:
    def count() -> int:
        return int(meter.settings["TRIG:COUN"]) * int(meter.settings["TRIG:SAMP"])

    def read(_: Parameters) -> None:
        meter.read(count())

    def initiate(_: Parameters) -> None:
        meter.initiate(count())

    def measure(function: str) -> Callable[[Parameters], None]:
        def act(_: Parameters) -> None:
            meter.configure(function)
            meter.read(1)

        return act

    def abort(_: Parameters) -> None:
        meter.abort()

    tree.define(":CONFigure", ask=lambda _: f'"{meter.function}"')
    tree.define(":READ", ask=read)
    for function, header in FUNCTIONS.items():
        tree.define(":MEASure:" + header, ask=measure(function))
    tree.define(":FETCh", ask=lambda _: meter.fetch(fresh=False))
    tree.define("[:SENSe#]:DATA[:LATest]", ask=lambda _: meter.fetch(fresh=False))
    tree.define("[:SENSe#]:DATA:FRESh", ask=lambda _: meter.fetch(fresh=True))
    tree.define(":INITiate[:IMMediate]", set=initiate)
    tree.define(":ABORt", set=abort)

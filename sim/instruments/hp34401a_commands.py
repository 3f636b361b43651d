"""The 34401A's commands: which header does what to the emulated meter.

Source: 34401A User's Guide, as far as remote clients of an ohmmeter (PyMeasure's among them) use it.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

from sim.instruments.meter_commands import Settings, define_choice, define_range, define_system
from sim.instruments.ohmmeter import RESISTANCES
from sim.instruments.scpi import CommandTree, boolean, number
from sim.instruments.scpi_settings import Parameters, define_number, define_switch

if TYPE_CHECKING:
    from sim.instruments.hp34401a import Hp34401A

# name as the instrument answers it -> its header, under [:SENSe], CONFigure and MEASure
FUNCTIONS = {
    "VOLT": "VOLTage[:DC]",
    "VOLT:RAT": "VOLTage[:DC]:RATio",
    "VOLT:AC": "VOLTage:AC",
    "CURR": "CURRent[:DC]",
    "CURR:AC": "CURRent:AC",
    "RES": "RESistance",
    "FRES": "FRESistance",
    "FREQ": "FREQuency",
    "PER": "PERiod",
    "CONT": "CONTinuity",
    "DIOD": "DIODe",
}
INTEGRATING = ("VOLT", "CURR", "RES", "FRES")
NPLCS = (0.02, 0.2, 1.0, 10.0, 100.0)  # those that it has
FREQUENCIES = ("FREQ", "PER")
NUMBERS: tuple[tuple[str, str, str, float, float, float], ...] = (
    (":TRIGger:COUNt", "TRIG:COUN", "%+.8E", 1, 1, 50000),
    (":TRIGger:DELay", "TRIG:DEL", "%+.8E", 0.0, 0.0, 3600.0),
    (":SAMPle:COUNt", "SAMP:COUN", "%+d", 1, 1, 50000),
    ("[:SENSe]:DETector:BANDwidth", "DET:BAND", "%+.8E", 20, 3, 200),
    ("*ESE", "*ESE", "%+d", 0, 0, 255),
    ("*SRE", "*SRE", "%+d", 0, 0, 255),
)
SWITCHES = (
    (":TRIGger:DELay:AUTO", "TRIG:AUTO", 1),
    (":SYSTem:BEEPer:STATe", "BEEP", 1),
    (":DISPlay[:WINDow#][:STATe]", "DISP", 1),
    (":INPut:IMPedance:AUTO", "IMP", 0),
)
WORDS = ((":TRIGger:SOURce", "TRIG:SOUR", "IMM"), (":DISPlay[:WINDow#]:TEXT[:DATA]", "TEXT", '""'))
SILENT = (":SYSTem:BEEPer[:IMMediate]", ":DISPlay[:WINDow#]:TEXT:CLEar", "*OPC", "*WAI", "*TRG")
SETTINGS = Settings(NUMBERS, SWITCHES, WORDS, SILENT, ("*ESE", "*SRE"))


def default_settings() -> dict[str, float | str]:
    """Every setting at its `*RST` value, by short name."""
    settings = SETTINGS.defaults()
    settings |= {"AZER": 1}
    for function in FUNCTIONS:
        settings |= {f"{function}:RANG:AUTO": 1, f"{function}:RANG": 1000.0, f"{function}:APER": 0.1}
        settings |= {f"{function}:RES": 1e-3}
    settings |= {f"{function}:NPLC": 10.0 for function in INTEGRATING}
    return settings


def define_commands(tree: CommandTree, meter: Hp34401A) -> None:
    """Fill `tree` with the commands of `meter`."""
    SETTINGS.define(tree, meter)
    for function, header in FUNCTIONS.items():
        _define_function(tree, meter, function, header)
    _define_autozero(tree, meter)
    define_choice(tree, meter, FUNCTIONS)
    _define_measuring(tree, meter)
    _define_system(tree, meter)


def _define_function(tree: CommandTree, meter: Hp34401A, function: str, header: str) -> None:
    sense = "[:SENSe]:" + header + (":VOLTage" if function in FREQUENCIES else "")
    define_switch(tree, meter, sense + ":RANGe:AUTO", f"{function}:RANG:AUTO")
    define_number(tree, meter, sense + ":RESolution", f"{function}:RES", "%+.8E", 1e-3, 0.0, 1e9)
    define_number(tree, meter, "[:SENSe]:" + header + ":APERture", f"{function}:APER", "%+.8E", 0.1, 0.01, 1.0)
    define_range(tree, meter, function, sense, 1000.0)

    def change_nplc(parameters: Parameters) -> None:
        value = number(parameters, NPLCS[0], NPLCS[-1], 10.0)
        meter.settings[f"{function}:NPLC"] = next(nplc for nplc in NPLCS if value <= nplc)

    if function in INTEGRATING:
        tree.define(
            sense + ":NPLCycles", set=change_nplc, ask=lambda _: f"{float(meter.settings[function + ':NPLC']):+.8E}"
        )


def _define_autozero(tree: CommandTree, meter: Hp34401A) -> None:
    def change(parameters: Parameters) -> None:
        once = len(parameters) == 1 and parameters[0].upper() == "ONCE"
        meter.settings["AZER"] = 0 if once else int(boolean(parameters))

    tree.define("[:SENSe]:ZERO:AUTO", set=change, ask=lambda _: str(meter.settings["AZER"]))


def _define_measuring(tree: CommandTree, meter: Hp34401A) -> None:
    def count() -> int:
        return int(meter.settings["TRIG:COUN"]) * int(meter.settings["SAMP:COUN"])

    def read(_: Parameters) -> None:
        meter.read(count())

    def initiate(_: Parameters) -> None:
        meter.store(count())

    def configured(function: str, then_read: bool) -> Callable[[Parameters], None]:
        """CONFigure and MEASure: the first parameter is a range, the second a resolution, which is not kept."""

        def act(parameters: Parameters) -> None:
            meter.configure(function)
            if parameters and parameters[0].upper() not in ("DEF", "DEFAULT", "AUTO") and function in RESISTANCES:
                value = number(parameters[:1], 0.0, 120e6, 1000.0)
                meter.settings[f"{function}:RANG:AUTO"] = 0
                meter.choose_range(value)
            if then_read:
                meter.read(1)

        return act

    tree.define(":CONFigure", ask=lambda _: f'"{meter.function} {meter.full_scale_ohm:+.6E},+1.000000E-03"')
    for function, header in FUNCTIONS.items():
        tree.define(":CONFigure:" + header, set=configured(function, False))
        tree.define(":MEASure:" + header, ask=configured(function, True))
    tree.define(":READ", ask=read)
    tree.define(":FETCh", ask=lambda _: meter.fetch(fresh=False))
    tree.define(":INITiate[:IMMediate]", set=initiate)
    tree.define(":ABORt", set=lambda _: meter.abort())
    tree.define(":DATA:POINts", ask=lambda _: "+0" if meter.stored is None else f"{meter.stored.count(',') + 1:+d}")
    tree.define(":ROUTe:TERMinals", ask=lambda _: "FRON")


def _define_system(tree: CommandTree, meter: Hp34401A) -> None:
    def remote(_: Parameters) -> None:
        meter.remote = True

    def local(_: Parameters) -> None:
        meter.remote = False

    tree.define(":SYSTem:REMote", set=remote)
    tree.define(":SYSTem:RWLock", set=remote)
    tree.define(":SYSTem:LOCal", set=local)
    everywhere = define_system(tree, meter, SETTINGS, version="1991.0", sign="+")
    meter.local_handlers = everywhere | {remote, local}

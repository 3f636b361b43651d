"""Commands that the emulated SCPI meters have in common: settings in tables, ranges, functions, `*` commands, errors.

Source: IEEE 488.2-1992 chapter 10 (common commands), SCPI-1999 volume 2, 21 (SYSTem). What differs from meter to meter
(headers, defaults, texts of numbers) is in each meter's own tables.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from sim.instruments.multimeter import VOLTAGES, Multimeter
from sim.instruments.ohmmeter import RESISTANCES, Ohmmeter
from sim.instruments.scpi import ILLEGAL_PARAMETER_VALUE, CommandTree, Handler, ScpiError, number
from sim.instruments.scpi_settings import Parameters, define_number, define_switch, define_word, unquoted

NumberRow = tuple[str, str, str, float, float, float]  # header, short name, its text, default, least, largest
SwitchRow = tuple[str, str, int]
WordRow = tuple[str, str, str]


@dataclass(frozen=True)
class Settings:
    """Settings that are only kept and answered, and commands that do nothing here (silent).

    persistent: names of those that `*RST` leaves as they are.
    """

    numbers: Sequence[NumberRow]
    switches: Sequence[SwitchRow]
    words: Sequence[WordRow]
    silent: Sequence[str]
    persistent: Sequence[str]

    def defaults(self) -> dict[str, float | str]:
        """Every one of them at its `*RST` value, by short name."""
        settings: dict[str, float | str] = {name: default for _, name, _, default, _, _ in self.numbers}
        settings |= {name: default for _, name, default in self.switches}
        settings |= {name: default for _, name, default in self.words}
        return settings

    def define(self, tree: CommandTree, meter: Ohmmeter) -> None:
        """Into the meter's commands."""
        for header, name, text, default, minimum, maximum in self.numbers:
            define_number(tree, meter, header, name, text, default, minimum, maximum)
        for header, name, _ in self.switches:
            define_switch(tree, meter, header, name)
        for header, name, _ in self.words:
            define_word(tree, meter, header, name)
        for header in self.silent:
            tree.define(header, set=lambda _: None)


def define_range(tree: CommandTree, meter: Ohmmeter, function: str, sense: str, default: float) -> None:
    """RANGe of a function: of resistance the meter picks the next one up, of voltage as well; others are kept."""

    def change(parameters: Parameters) -> None:
        value = number(parameters, 0.0, 120e6, default)
        meter.settings[f"{function}:RANG:AUTO"] = 0
        meter.settings[f"{function}:RANG"] = meter.voltage_range_V(value) if function in VOLTAGES else value
        if function in RESISTANCES:
            meter.choose_range(value)

    def text(_: Parameters) -> str:
        kept = float(meter.settings[f"{function}:RANG"])
        return f"{meter.full_scale_ohm if function in RESISTANCES else kept:+.8E}"

    tree.define(sense + ":RANGe[:UPPer]", set=change, ask=text)


def define_choice(tree: CommandTree, meter: Multimeter, headers: Mapping[str, str]) -> None:
    """SENSe:FUNCtion: one function by its name, in quotes. headers: its keywords by that name."""

    def choose(parameters: Parameters) -> None:
        name = unquoted(parameters)
        for function, header in headers.items():
            if tree.spells(name, header):
                meter.choose_function(function)
                return
        raise ScpiError(*ILLEGAL_PARAMETER_VALUE)

    tree.define("[:SENSe#]:FUNCtion", set=choose, ask=lambda _: f'"{meter.function}"')


def define_system(
    tree: CommandTree, meter: Ohmmeter, settings: Settings, *, version: str, sign: str = "", more_errors: str = ""
) -> frozenset[Handler]:
    """`*` commands and the error queue. sign: before a number. Returns those that a meter takes in any mode."""

    def reset(_: Parameters) -> None:
        kept = {name: meter.settings[name] for name in settings.persistent}
        meter.reset()
        meter.settings.update(kept)

    def clear(_: Parameters) -> None:
        meter.errors.clear()

    def identity(_: Parameters) -> str:
        return meter.identity

    def next_error(_: Parameters) -> str:
        return meter.next_error()

    tree.define("*IDN", ask=identity)
    tree.define("*RST", set=reset)
    tree.define("*CLS", set=clear)
    tree.define("*OPC", ask=lambda _: "1")
    tree.define("*ESR", ask=lambda _: sign + "0")
    tree.define("*TST", ask=lambda _: sign + "0")
    tree.define("*STB", ask=lambda _: sign + ("4" if meter.errors else "0"))
    tree.define(":SYSTem:VERSion", ask=lambda _: version)
    tree.define(":SYSTem:ERRor[:NEXT]", ask=next_error)
    if more_errors:
        tree.define(f"{more_errors}[:NEXT]", ask=next_error)
        tree.define(f"{more_errors}:CLEar", set=clear)
        tree.define(":SYSTem:CLEar", set=clear)
    return frozenset({identity, next_error, clear})

"""Settings of an emulated SCPI instrument that are only kept and answered: numbers, switches and words."""

from __future__ import annotations

from typing import Protocol

from sim.instruments.scpi import INVALID_CHARACTER_DATA, MISSING_PARAMETER, CommandTree, ScpiError, boolean, number

Parameters = tuple[str, ...]


class HasSettings(Protocol):
    """An instrument with settings by short name."""

    settings: dict[str, float | str]


def define_number(
    tree: CommandTree,
    instrument: HasSettings,
    header: str,
    name: str,
    text: str,
    default: float,
    minimum: float,
    maximum: float,
) -> None:
    """`header` sets and answers the number `name`, written as `text` (a % format) says."""

    def change(parameters: Parameters) -> None:
        instrument.settings[name] = number(parameters, minimum, maximum, default)

    tree.define(header, set=change, ask=lambda _: text % instrument.settings[name])


def define_switch(tree: CommandTree, instrument: HasSettings, header: str, name: str) -> None:
    """`header` sets and answers the switch `name`, as 0 or 1."""

    def change(parameters: Parameters) -> None:
        instrument.settings[name] = int(boolean(parameters))

    tree.define(header, set=change, ask=lambda _: str(instrument.settings[name]))


def define_word(tree: CommandTree, instrument: HasSettings, header: str, name: str) -> None:
    """`header` sets and answers the word `name`, in capitals."""

    def change(parameters: Parameters) -> None:
        if not parameters:
            raise ScpiError(*MISSING_PARAMETER)
        instrument.settings[name] = ",".join(parameters).upper()

    tree.define(header, set=change, ask=lambda _: str(instrument.settings[name]))


def unquoted(parameters: Parameters) -> str:
    """The one parameter, a word within double or single quotes. ScpiError where it has none."""
    if not parameters:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0]
    if len(word) < 2 or word[0] not in "\"'" or word[-1] != word[0]:
        raise ScpiError(*INVALID_CHARACTER_DATA)
    return word[1:-1]

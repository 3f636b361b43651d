"""The LDC501's commands: four letters, a value or a question mark, words or numbers for tokens.

Source: LDC500 series manual, remote chapter p. 4-10 to 4-54 (syntax, LCME numbers, TERM, TOKN, temperature commands).
Not verified: numbers of execution errors, TIGN and TDGN, `*ESE`, limits other than those of TILM and TVLM.
"""

from __future__ import annotations

import re
from collections.abc import Callable
from math import isfinite
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sim.instruments.srs_ldc500 import SrsLdc500

# command errors, LCME (p. 4-38)
ILLEGAL, UNDEFINED, ILLEGAL_QUERY, ILLEGAL_SET, MISSING, EXTRA, NULL, BUFFER_OVERFLOW, BAD_FLOAT = range(1, 10)
BAD_INTEGER, BAD_TOKEN, BAD_TOKEN_VALUE, BAD_HEXADECIMAL, UNKNOWN_TOKEN = range(10, 15)  # the same
OUT_OF_RANGE, MODE_IS_LOCKED = 1, 2  # execution errors, LEXE: numbers not verified

SWITCH = ("OFF", "ON")
# mnemonic -> its words, by number
TOKENS: dict[str, tuple[str, ...]] = {
    "TERM": ("NONE", "CR", "LF", "CRLF", "LFCR"),
    "TOKN": SWITCH,
    "TEON": SWITCH,
    "TMOD": ("CC", "CT"),
    "TMLK": SWITCH,
    "TSNR": ("NTC10UA", "NTC100UA", "NTC1MA", "NTCAUTO", "RTD", "LM335", "AD590"),
    "ULOC": SWITCH,
}
# mnemonic -> default, limits
NUMBERS: dict[str, tuple[float, float, float]] = {
    "TEMP": (25.0, -273.15, 250.0),
    "TMIN": (-50.0, -273.15, 250.0),
    "TMAX": (150.0, -273.15, 250.0),
    "TCUR": (0.0, -4.5, 4.5),
    "TILM": (4.5, -4.5, 4.5),
    "TVLM": (8.5, -8.5, 8.5),
    "TPGN": (-1.0, -1000.0, 1000.0),
    "TIGN": (0.03, 0.0, 1000.0),
    "TDGN": (0.0, 0.0, 1000.0),
    "TRTH": (10.0, 0.0, 1000.0),
    "TRMN": (0.1, 0.0, 1000.0),
    "TRMX": (300.0, 0.0, 1000.0),
}
# default, least and largest of each
INTEGERS: dict[str, tuple[int, int, int]] = {"*ESE": (0, 0, 255), "*SRE": (0, 0, 255), "TUNE": (0, 0, 5)}
UNIT = re.compile(r"(\*[A-Z]{3}|[A-Z]{4})(\?)?(.*)")


class CommandError(Exception):
    """What LCME tells."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


class ExecutionError(Exception):
    """What LEXE tells."""

    def __init__(self, code: int) -> None:
        super().__init__(code)
        self.code = code


def default_values() -> dict[str, float]:
    """Everything that can be set, by mnemonic; tokens by number. TERM 3 is CR and LF."""
    values: dict[str, float] = {name: default for name, (default, _, _) in NUMBERS.items()}
    values |= {name: default for name, (default, _, _) in INTEGERS.items()}
    return values | dict.fromkeys(TOKENS, 0.0) | {"TERM": 3.0, "TSNR": 3.0}


def answers(controller: SrsLdc500, unit: str) -> list[str]:
    """Do one command of a line: its answer, if it is a question. CommandError, ExecutionError."""
    text = "".join(unit.split()).upper()  # white space is ignored
    if not text:
        return []
    parsed = UNIT.fullmatch(text)
    if parsed is None:
        raise CommandError(ILLEGAL)
    name, question, rest = parsed.groups()
    if question:
        if name not in QUERIES and name not in controller.values:
            raise CommandError(ILLEGAL_QUERY if name in COMMANDS else UNDEFINED)
        if rest:
            raise CommandError(EXTRA)
        return [QUERIES[name](controller) if name in QUERIES else _value_text(controller, name)]
    if name in COMMANDS:
        if rest:
            raise CommandError(EXTRA)
        COMMANDS[name](controller)
    elif name not in controller.values:
        raise CommandError(ILLEGAL_SET if name in QUERIES else UNDEFINED)
    else:
        _set(controller, name, rest)
    return []


def number_text(value: float) -> str:
    """A number as the instrument writes it (6 digits: not verified)."""
    return "%.6g" % value  # noqa: UP031 - half the time of an f-string


def _value_text(controller: SrsLdc500, name: str) -> str:
    value = controller.values[name]
    if name in TOKENS and controller.values["TOKN"]:
        return TOKENS[name][int(value)]
    return number_text(value)


def _set(controller: SrsLdc500, name: str, text: str) -> None:
    if not text:
        raise CommandError(MISSING)
    if "," in text:
        raise CommandError(EXTRA)
    values = controller.values
    if name in TOKENS:
        value = float(_token(text, TOKENS[name]))
    elif name in INTEGERS:
        value = float(_integer(text, *INTEGERS[name][1:]))
    else:
        value = _float(text, *NUMBERS[name][1:])
    if name == "TEMP" and not values["TMIN"] <= value <= values["TMAX"]:
        raise ExecutionError(OUT_OF_RANGE)
    if name == "TCUR" and abs(value) > values["TILM"]:
        raise ExecutionError(OUT_OF_RANGE)
    if name == "TMOD" and values["TMLK"] and values["TEON"] and value != values["TMOD"]:
        raise ExecutionError(MODE_IS_LOCKED)
    special = SPECIAL.get(name)
    if special is not None:
        special(controller, value)
        return
    values[name] = value
    if name in ("TCUR", "TVLM", "TPGN"):
        controller.drive()


def _float(text: str, minimum: float, maximum: float) -> float:
    try:
        value = float(text)
    except ValueError:
        raise CommandError(BAD_FLOAT) from None
    if not isfinite(value):
        raise CommandError(BAD_FLOAT)
    if not minimum <= value <= maximum:
        raise ExecutionError(OUT_OF_RANGE)
    return value


def _integer(text: str, minimum: int, maximum: int) -> int:
    try:
        value = int(text)
    except ValueError:
        raise CommandError(BAD_INTEGER) from None
    if not minimum <= value <= maximum:
        raise ExecutionError(OUT_OF_RANGE)
    return value


def _token(text: str, words: tuple[str, ...]) -> int:
    if text in words:
        return words.index(text)
    if not (text.isascii() and text.isdigit()):
        raise CommandError(UNKNOWN_TOKEN)
    if int(text) >= len(words):
        raise CommandError(BAD_TOKEN_VALUE)
    return int(text)


def _tune(controller: SrsLdc500, value: float) -> None:
    """Autotune turns the output on; the tuning itself is not emulated."""
    controller.values["TUNE"] = value
    if value:
        controller.switch(1.0)


def _clear(controller: SrsLdc500) -> None:
    controller.event_status = 0
    controller.take_command_error()
    controller.take_execution_error()


def _take_event_status(controller: SrsLdc500) -> str:
    status, controller.event_status = controller.event_status, 0
    return str(status)


QUERIES: dict[str, Callable[[SrsLdc500], str]] = {
    "*IDN": lambda controller: controller.identity,
    "*ESR": _take_event_status,
    "*OPC": lambda _: "1",
    "*STB": lambda _: "0",
    "LCME": lambda controller: str(controller.take_command_error()),
    "LEXE": lambda controller: str(controller.take_execution_error()),
    "TTRD": lambda controller: number_text(controller.temperature_degC()),
    "TRAW": lambda _: "10",
    "TIRD": lambda controller: number_text(controller.output_A),
    "TVRD": lambda controller: number_text(controller.voltage_V()),
}
COMMANDS: dict[str, Callable[[SrsLdc500], None]] = {"*CLS": _clear, "*OPC": lambda _: None, "*WAI": lambda _: None}
SPECIAL: dict[str, Callable[[SrsLdc500, float], None]] = {
    "TMOD": lambda controller, value: controller.change_mode(value),
    "TILM": lambda controller, value: controller.change_current_limit(value),
    "TEON": lambda controller, value: controller.switch(value),
    "TUNE": _tune,
}

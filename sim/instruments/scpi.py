"""SCPI program messages: a tree of commands, and messages taken apart into calls.

Source: IEEE 488.2-1992 chapters 7 and 8 and SCPI-1999 volume 1 (syntax and style): keywords in their long
or short form and any case, optional keywords, `;` between units, a leading colon from the root, otherwise
from where the unit before ended; `*` commands belong to no path. Where a unit is found neither there nor
below, the root is tried, as lenient instruments do.

A pattern is written as in the manuals: "[:SENSe#]:FRESistance:RANGe[:UPPer]"; capitals are the short form,
brackets enclose optional keywords, `#` allows the suffix 1.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import product

SET, ASK = "", "?"


class ScpiError(Exception):
    """What goes into an instrument's error queue: a number and its text (SCPI-1999 volume 2, 21.8)."""

    def __init__(self, code: int, text: str) -> None:
        super().__init__(f'{code},"{text}"')
        self.code = code
        self.text = text


UNDEFINED_HEADER = (-113, "Undefined header")
MISSING_PARAMETER = (-109, "Missing parameter")
DATA_OUT_OF_RANGE = (-222, "Parameter data out of range")
INVALID_CHARACTER_DATA = (-141, "Invalid character data")
NUMERIC_DATA_ERROR = (-120, "Numeric data error")
ILLEGAL_PARAMETER_VALUE = (-224, "Illegal parameter value")

Handler = Callable[[tuple[str, ...]], str | None]


@dataclass(frozen=True, slots=True)
class Call:
    """A unit of a message: what to call with which parameters; an unknown header raises when called."""

    handler: Handler
    parameters: tuple[str, ...]

    def __call__(self) -> str | None:
        return self.handler(self.parameters)


def _undefined(_: tuple[str, ...]) -> str | None:
    raise ScpiError(*UNDEFINED_HEADER)


class CommandTree:
    """All commands of an instrument."""

    def __init__(self) -> None:
        self._handlers: dict[tuple[tuple[str, ...], str], Handler] = {}
        self._short: dict[str, str] = {}
        self._parsed: dict[str, tuple[Call, ...]] = {}

    def define(self, pattern: str, *, set: Handler | None = None, ask: Handler | None = None) -> None:
        """Add a command in its two forms, `HEADER parameters` and `HEADER?`."""
        for path in self._paths(pattern):
            for form, handler in ((SET, set), (ASK, ask)):
                if handler is not None:
                    self._handlers[path, form] = handler

    def _paths(self, pattern: str) -> list[tuple[str, ...]]:
        choices: list[list[tuple[str, ...]]] = []
        for piece in pattern.replace("[", " [").replace("]", "] ").split():
            optional = piece.startswith("[")
            nodes = tuple(self._node(node) for node in piece.strip("[]").split(":") if node)
            choices.append([nodes, ()] if optional else [nodes])
        return [tuple(node for nodes in combination for node in nodes) for combination in product(*choices)]

    def _node(self, node: str) -> str:
        word = node.rstrip("#")
        long = word.upper()
        short = "".join(character for character in word if not character.islower())
        for suffix in ("", "1") if node.endswith("#") else ("",):
            self._short[short + suffix] = self._short[long + suffix] = short
        return short

    def spells(self, text: str, pattern: str) -> bool:
        """Whether `text` is a way to write the keywords of `pattern`, which has been defined before."""
        words = tuple(self._short.get(word, word) for word in text.strip().upper().strip(":").split(":"))
        return words in self._paths(pattern)

    def parse(self, message: str) -> tuple[Call, ...]:
        """The units of a program message without its terminator; remembers the messages it has seen."""
        calls = self._parsed.get(message)
        if calls is None:
            if len(self._parsed) > 2048:
                self._parsed.clear()
            calls = self._parsed[message] = tuple(self._calls(message))
        return calls

    def _calls(self, message: str) -> list[Call]:
        calls: list[Call] = []
        path: tuple[str, ...] = ()
        for unit in split_outside_quotes(message, ";"):
            unit = unit.strip()
            if not unit:
                continue
            header, _, rest = unit.partition(" ")
            parameters = tuple(part.strip() for part in split_outside_quotes(rest, ",")) if rest.strip() else ()
            form = ASK if header.endswith("?") else SET
            header = header.rstrip("?").upper()
            if header.lstrip(":").startswith("*"):
                calls.append(Call(self._handlers.get(((header.lstrip(":"),), form), _undefined), parameters))
                continue
            words = tuple(self._short.get(word, word) for word in header.lstrip(":").split(":"))
            relative = words if header.startswith(":") else (*path, *words)
            where = relative if (relative, form) in self._handlers else words
            path = where[:-1]
            calls.append(Call(self._handlers.get((where, form), _undefined), parameters))
        return calls


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """`text` split at a separator that is not inside a pair of double or single quotes."""
    if '"' not in text and "'" not in text:
        return text.split(separator)
    pieces, quote, begin = [], "", 0
    for position, character in enumerate(text):
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character == separator:
            pieces.append(text[begin:position])
            begin = position + 1
    return [*pieces, text[begin:]]


def number(parameters: tuple[str, ...], minimum: float, maximum: float, default: float) -> float:
    """The one numeric parameter, within its limits; MINimum, MAXimum and DEFault are words for numbers."""
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0].upper()
    words = {
        "MIN": minimum,
        "MINIMUM": minimum,
        "MAX": maximum,
        "MAXIMUM": maximum,
        "DEF": default,
        "DEFAULT": default,
    }
    try:
        value = words[word] if word in words else float(word)
    except ValueError:
        raise ScpiError(*NUMERIC_DATA_ERROR) from None
    if not minimum <= value <= maximum:
        raise ScpiError(*DATA_OUT_OF_RANGE)
    return value


def boolean(parameters: tuple[str, ...]) -> bool:
    """ON, OFF, or a number that is 0 or not."""
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0].upper()
    if word in ("ON", "OFF"):
        return word == "ON"
    return number(parameters, -1e9, 1e9, 0.0) != 0.0

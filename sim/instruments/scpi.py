"""SCPI on the instrument's side: messages taken apart into calls, answers put on the line, an error queue.

Sources: IEEE 488.2-1992 chapters 7, 8 and 10, SCPI-1999 volume 1 (syntax and style) and volume 2, 21.8 (error queue).
Keywords come in their long or short form and in any case, some are optional. `;` separates the units of a message; a
unit with a leading colon counts from the root, another from where the unit before it ended, and if it is not found
there, from the root, as lenient instruments do. `*` commands belong to no path.

A pattern is written as in the manuals: "[:SENSe#]:FRESistance:RANGe[:UPPer]"; capitals are the short form, brackets
enclose optional keywords, `#` allows the suffix 1.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from functools import partial
from itertools import product
from math import inf
from typing import ClassVar

from sim.instruments.instrument import Instrument, Plant

SET, ASK = "", "?"


class ScpiError(Exception):
    """An entry of an instrument's error queue: a number and its text."""

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

Parameters = tuple[str, ...]
Handler = Callable[[Parameters], str | None]
Call = partial[str | None]  # a unit of a message: its command's handler with the parameters


def _undefined(_: Parameters) -> str | None:
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
        """Return True if `text` is a way to write the keywords of `pattern`, which has been defined before."""
        words = tuple(self._short.get(word, word) for word in text.strip().upper().strip(":").split(":"))
        return words in self._paths(pattern)

    def parse(self, message: str) -> tuple[Call, ...]:
        """Return the units of a message without its terminator; cache them."""
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
                calls.append(partial(self._handlers.get(((header.lstrip(":"),), form), _undefined), parameters))
                continue
            words = tuple(self._short.get(word, word) for word in header.lstrip(":").split(":"))
            relative = words if header.startswith(":") else (*path, *words)
            where = relative if (relative, form) in self._handlers else words
            path = where[:-1]
            calls.append(partial(self._handlers.get((where, form), _undefined), parameters))
        return calls


def split_outside_quotes(text: str, separator: str) -> list[str]:
    """Split `text` at each separator outside double and single quotes."""
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


def number(parameters: Parameters, minimum: float, maximum: float, default: float) -> float:
    """Return the one numeric parameter, within its limits; MINimum, MAXimum and DEFault are words for numbers."""
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    try:
        value = float(parameters[0])
    except ValueError:
        words = {"MIN": minimum, "MAX": maximum, "DEF": default}
        words |= {"MINIMUM": minimum, "MAXIMUM": maximum, "DEFAULT": default}
        word = parameters[0].upper()
        if word not in words:
            raise ScpiError(*NUMERIC_DATA_ERROR) from None
        value = words[word]
    if not minimum <= value <= maximum:
        raise ScpiError(*DATA_OUT_OF_RANGE)
    return value


def boolean(parameters: Parameters) -> bool:
    if len(parameters) != 1:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0].upper()
    return word == "ON" if word in ("ON", "OFF") else number(parameters, -1e9, 1e9, 0.0) != 0.0


def unquoted(parameters: Parameters) -> str:
    """Return the first parameter, a word within double or single quotes."""
    if not parameters:
        raise ScpiError(*MISSING_PARAMETER)
    word = parameters[0]
    if len(word) < 2 or word[0] not in "\"'" or word[-1] != word[0]:
        raise ScpiError(*INVALID_CHARACTER_DATA)
    return word[1:-1]


class ScpiInstrument(Instrument):
    """An instrument that takes messages in turn; its commands are in `_tree`.

    A message acts `command_s` after its terminator has arrived; messages wait while one of them waits for a
    measurement. The class attributes say which characters abort, how the error queue speaks, and whether an error drops
    the rest of its message.
    """

    ABORTS: ClassVar[tuple[bytes, ...]] = (b"\x03", b"\x18")
    QUEUE_LENGTH: ClassVar[int] = 10
    QUEUE_OVERFLOW: ClassVar[str] = '350,"Queue Overflow"'
    NO_ERROR: ClassVar[str] = '0,"No error"'
    DROPS_REST: ClassVar[bool] = True

    def __init__(self, plant: Plant, *, byte_s: float, terminator: bytes, command_s: float, start_s: float) -> None:
        super().__init__(plant, byte_s=byte_s, start_s=start_s)
        self._terminator = terminator
        self._command_s = command_s
        self._messages: deque[tuple[float, str]] = deque()
        self._calls: deque[Call] = deque()  # of the message at work
        self._answers: list[str] = []
        self._waiting = False  # for a measurement
        self._free_s = start_s
        self._ready_s = start_s
        self._tree = CommandTree()
        self.errors: deque[str] = deque()

    # ---- the line -------------------------------------------------------------------------------

    def receive(self, data: bytes, time_s: float) -> None:
        """See `Instrument.receive`. A character that aborts discards all that is under way."""
        for character in self.ABORTS:
            if character in data:
                self._clear_device()
                data = data[data.rfind(character) + 1 :]
        super().receive(data, time_s)

    def _take_line(self, line: bytes, arrival_s: float) -> None:
        if line:
            self._messages.append((arrival_s + self._command_s, line.decode("latin-1")))
            self._plant.schedule(arrival_s + self._command_s, self._work)

    def _next_reply_s(self) -> float | None:
        if self._waiting:
            return self._ready_s
        if self._calls:
            return self._free_s
        return self._messages[0][0] if self._messages else None

    def _clear_device(self) -> None:
        self._partial = b""
        for waiting in (self._messages, self._replies, self._calls, self._answers):
            waiting.clear()
        self.abort()
        self._free_s = self._sending_until_s = self._receiving_until_s = -inf

    def abort(self) -> None:
        """Return to idle, without a reading."""
        self._waiting = False

    # ---- messages -------------------------------------------------------------------------------

    def _work(self, time_s: float) -> None:
        """Go on with what has arrived, as far as it can be done at `time_s`."""
        self._now_s = time_s
        while not self._waiting:
            if time_s < self._free_s:
                if self._calls or self._messages:
                    self._plant.schedule(self._free_s, self._work)
                return
            if self._calls:
                self._run(self._calls.popleft())
            elif self._messages and self._messages[0][0] <= time_s:
                self._calls.extend(self._tree.parse(self._messages.popleft()[1]))
            else:
                return
            if not (self._calls or self._waiting):
                self._reply(time_s)

    def _run(self, call: Call) -> None:
        try:
            answer = call()
        except ScpiError as error:
            self.push_error(str(error))
            if self.DROPS_REST:
                self._calls.clear()
            return
        if answer is not None:
            self._answers.append(answer)

    def _reply(self, time_s: float) -> None:
        if self._answers:
            self._send(";".join(self._answers).encode("latin-1") + self._terminator, time_s)
            self._answers.clear()

    # ---- errors ---------------------------------------------------------------------------------

    def push_error(self, text: str) -> None:
        """Append to the error queue; an entry that no longer fits turns the last one into an overflow."""
        if len(self.errors) < self.QUEUE_LENGTH:
            self.errors.append(text)
        else:
            self.errors[-1] = self.QUEUE_OVERFLOW

    def next_error(self) -> str:
        """Return the oldest entry of the error queue and remove it."""
        return self.errors.popleft() if self.errors else self.NO_ERROR

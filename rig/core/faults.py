"""Faults in what the user gave, one line each: file, place, what is expected. They end with exit status 2.

Faults            a list of lines; str() joins them with newlines

They speak the command line, and Python to whoever called it from there: `--column 'a=b'` is `column="a=b"`.
"""

from __future__ import annotations

import re
from contextlib import contextmanager

TYPE_CHECKING = False  # import-light, for `peltier off`: no `typing`, no pattern that is compiled before it is needed
if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

KEYWORDS = {
    "first": "first_s",
    "budget": "budget_s",
    "period": "period_s",
    "effect": "effects",
    "effect-file": "effect_files",
}
CHOICES = ("cooled", "heated", "fitted", "current", "temperature")  # words that are an option's value, and no prose
FLAGS = ("reversed", "branches")
_OPTION = r"(?<![\w-])--([a-z][a-z-]*)(: (?=[^:]*: )|:)?(?:[= ]?('(?:[^']|'\"'\"')*'|[^\s']\S*))?"
_TWICE = r'\b(\w+)=("[^"]*")((?: (?:and )?\1="[^"]*")+)'


class Faults(Exception):
    """Bad usage, configuration or data: every fault that was found, a line each."""

    def __init__(self, lines: Iterable[str]) -> None:
        self.lines = [line for line in lines if line]
        super().__init__("\n".join(self.lines))


def fault(where: object, place: str, expected: str) -> Faults:
    """Return one fault as `Faults`."""
    return Faults([f"{where}: {place}: {expected}" if place else f"{where}: {expected}"])


# ---- in Python's words ------------------------------------------------------------------------------


def python_words(text: str) -> str:
    """Return a message with keyword arguments in place of the command line's options."""

    def keyword(found: re.Match[str]) -> str:
        name, colon, raw = found.group(1), found.group(2) or "", found.group(3) or ""
        own = KEYWORDS.get(name, name.replace("-", "_"))
        value, rest = _value(name, raw, bool(colon.strip() and colon.endswith(" ")))
        if value is not None:
            return f"{own}={value}{rest}"
        return (f"{own}=True" if name in FLAGS else own) + found.group(0).removeprefix(f"--{name}")

    def listed(found: re.Match[str]) -> str:
        values = re.findall(r'"[^"]*"', found.group(0))
        return f"{found.group(1)}=[{', '.join(values)}]"

    return re.sub(_TWICE, listed, re.sub(_OPTION, keyword, text))


def _value(name: str, raw: str, named: bool) -> tuple[str | None, str]:
    """Return an option's value as Python has it, and what follows it; None where the next word is prose. named: it
    stands between colons, behind the option that is at fault."""
    if raw.startswith("'"):
        import shlex

        return _quoted("".join(shlex.split(raw))), ""
    if name == "decimal" and raw in (",", "."):
        return _quoted(raw), ""
    word = raw.rstrip(",;:.)") if "..." not in raw else raw.rstrip(",;:)")
    rest = raw[len(word) :]
    if re.fullmatch(r"[+-]?\d+(\.\d*)?(e[+-]?\d+)?", word):
        return word, rest
    if word and (named or "=" in word or word in CHOICES):
        return _quoted(word), rest
    return None, ""


def _quoted(text: str) -> str:
    return '"' + text.replace("\\", "\\\\").replace('"', '\\"') + '"'


@contextmanager
def in_python() -> Iterator[None]:
    """Context, and decorator: Faults that are raised in it speak Python."""
    try:
        yield
    except Faults as faults:
        raise Faults(python_words(line) for line in faults.lines) from None
